"""Difference of two calibrations of one recording, and its expected covariance.

Two estimates x and x_opt of the same parameters from the same data share most of their noise, so the root sum of
squares of their sigmas says nothing about their difference d = x − x_opt. If x_opt is efficient, d is uncorrelated with
x_opt (otherwise a combination of both would have a smaller variance), and::

    cov(d) = P − P_opt

(Hausman 1978, Econometrica 46, 1251). The diagonal of that matrix tests every parameter; its inverse tests all of them
together. Where P is smaller than P_opt, the roles are exchanged: the absolute value is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtrc, ndtri

from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.result.calibration import Calibration
    from srt.types import Array, Mask


FALSE_ALARM: Final = 0.01
"""False-alarm probability of a comparison: half of it for the largest difference of any one parameter, half for the
joint tests."""

EXPECTED_SIGMA_FLOOR: Final = 0.05
"""Floor of an expected sigma, as a fraction of the larger sigma of the two estimates. The expected difference of two
efficient estimators is zero; they still differ by their stopping rules (0.01 sigma), by terms of second order and by
the treatment of shared noise. Differences below a twentieth of sigma do not matter."""

DRIFT_MODEL_ERROR: Final = 0.11
"""Variance by which two models of the same bias instability may differ, as a fraction of the variance by drift: closed
form and least squares have its covariance over the windows, filter and graph Markov states. The spectrum of either
ripples by 5.5 %. Where both estimates are nearly efficient, that is more than the variance of their difference."""

CLEARLY_SMALLER: Final = 0.9
"""Ratio of variances below which the reference is not the efficient estimate of a parameter: 5 % of a sigma."""

_NAMED: Final = 3
"""Number of parameters that a sentence names; the others are counted."""


@dataclass(frozen=True, slots=True, eq=False)
class EstimateDifference:
    """Difference of one estimator from the reference.

    Attributes
    ----------
    estimator, reference : str
    compared : ndarray of bool, shape (27,)
        Parameters that both observed.
    difference : ndarray, shape (27,), SI
        Estimator less reference; NaN where not compared, as in the next three.
    expected_sigma : ndarray, shape (27,), SI
        Expected 1-sigma of the difference.
    normalised : ndarray, shape (27,)
        Difference over expected sigma.
    sigma_ratio : ndarray, shape (27,)
        Sigma of the estimator over that of the reference.
    limit : float
        Limit of a normalised difference, by :data:`FALSE_ALARM`.
    chi_square, p_value : float
        Chi-square of all differences, with one degree of freedom per compared parameter. The floor on the
        expected sigma can only raise the p-value.
    least_p_value : float
        Limit of the p-value, by :data:`FALSE_ALARM`.
    """

    estimator: str
    reference: str
    compared: Mask
    difference: Array
    expected_sigma: Array
    normalised: Array
    sigma_ratio: Array
    limit: float
    chi_square: float
    p_value: float
    least_p_value: float

    @property
    def differing(self) -> Mask:
        """Parameters that differ by more than the limit, shape (27,)."""
        out: Mask = self.compared & ~(np.abs(self.normalised) <= self.limit)
        return out

    @property
    def agrees(self) -> bool:
        """True if no difference is significant, alone or together; False if nothing is compared."""
        return bool(self.compared.any()) and not self.differing.any() and self.p_value >= self.least_p_value

    @property
    def largest(self) -> int | None:
        """Index of the parameter with the largest normalised difference."""
        return int(np.nanargmax(np.abs(self.normalised))) if self.compared.any() else None

    @property
    def efficiency(self) -> float:
        """Root mean square of the ratio of sigmas to the reference's; NaN if nothing is compared."""
        ratio = self.sigma_ratio[self.compared]
        return float(np.sqrt(np.mean(ratio**2))) if ratio.size else math.nan

    @property
    def smaller_sigma(self) -> tuple[str, ...]:
        """Parameters for which the reference is not efficient: its variance is significantly larger."""
        return _names(self.compared & (self.sigma_ratio**2 < CLEARLY_SMALLER))

    def as_dict(self) -> dict[str, Any]:
        """The JSON form; arrays in SI, None where not compared."""
        return {
            "reference": self.reference,
            "agrees": self.agrees,
            "compared": int(self.compared.sum()),
            "sigma_ratio_rms": self.efficiency if self.compared.any() else None,
            "difference": finite(self.difference),
            "spread": finite(self.expected_sigma),
            "normalised": finite(self.normalised),
            "limit": self.limit,
            "differing": list(_names(self.differing)),
            "smaller_sigma": list(self.smaller_sigma),
            "chi_square": self.chi_square,
            "p_value": self.p_value,
            "least_p_value": self.least_p_value,
        }

    def sentence(self) -> str:
        """Clause on the agreement of the two estimates, without a full stop."""
        if not self.compared.any():
            return f"{self.estimator} and {self.reference} observed no parameter in common"
        if self.agrees:
            return f"{self.estimator} agrees with {self.reference}"
        differing = np.flatnonzero(self.differing)
        if not differing.size:
            return (
                f"{self.estimator} differs from {self.reference} in all parameters together, though in none alone "
                f"(chi-square {self.chi_square:.0f} for {int(self.compared.sum())}, p = {self.p_value:.1g})"
            )
        worst = differing[np.argsort(-np.abs(self.normalised[differing]), kind="stable")]
        named = listing([f"{NAMES[i]} by {abs(self.normalised[i]):.1f}" for i in worst])
        limit = f"(limit {self.limit:.1f})"
        return f"{self.estimator} differs from {self.reference}: {named} times the expected standard deviation {limit}"


def estimate_difference(
    name: str,
    other: Calibration,
    reference_name: str,
    reference: Calibration,
    *,
    shared: Mask,
    tests: int,
    estimators: int,
) -> EstimateDifference:
    """Difference of an estimate from the reference in the ``shared`` parameters.

    ``tests`` counts the compared parameters of all ``estimators``, which share the false-alarm probability.
    """
    scale = np.where(shared, np.fmax(other.sigma, reference.sigma), np.nan)
    difference = np.where(shared, other.errors.vector - reference.errors.vector, np.nan)
    excess = other.covariance - reference.covariance
    uncertain = DRIFT_MODEL_ERROR * np.maximum(_drift_variance(other), _drift_variance(reference))
    spread = np.maximum(np.sqrt(np.abs(np.diag(excess)) + uncertain), EXPECTED_SIGMA_FLOOR * scale)
    statistic, p_value = _joint(
        (difference / scale)[shared],
        (excess / np.outer(scale, scale))[np.ix_(shared, shared)],
        float(np.max((uncertain / scale**2)[shared], initial=0.0)),
    )
    return EstimateDifference(
        estimator=name,
        reference=reference_name,
        compared=shared,
        difference=difference,
        expected_sigma=spread,
        normalised=difference / spread,
        sigma_ratio=np.where(shared, ratio_of(other.sigma, reference.sigma), np.nan),
        limit=_limit(tests),
        chi_square=statistic,
        p_value=p_value,
        least_p_value=0.5 * FALSE_ALARM / estimators,
    )


def _drift_variance(calibration: Calibration) -> Array:
    """Part of the variance that bias instability causes, shape (27,); zero where none is modelled."""
    parts = (
        calibration.contributions.get(f"{sensor}_bias_instability", np.zeros(len(NAMES)))
        for sensor in ("gyro", "accel")
    )
    return np.asarray(sum(part**2 for part in parts))


def _limit(count: int) -> float:
    """Two-sided normal quantile that the largest of ``count`` draws exceeds with half of FALSE_ALARM (Šidák).

    Exact for independent draws; correlated ones exceed it more rarely.
    """
    alone = -math.expm1(math.log1p(-0.5 * FALSE_ALARM) / max(count, 1))
    return float(-ndtri(0.5 * alone))


def _joint(difference: Array, covariance: Array, uncertain: float) -> tuple[float, float]:
    """Chi-square of differences in units of sigma, and its p-value.

    Parameters
    ----------
    difference : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
        Expected covariance. The magnitude of its eigenvalues is used, with a floor: if the two estimates are equal,
        both consist of rounding.
    uncertain : float
        Variance by which the expected one may be wrong.
    """
    if not difference.size:
        return 0.0, 1.0
    eigenvalues, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    variance = np.maximum(np.abs(eigenvalues) + uncertain, EXPECTED_SIGMA_FLOOR**2)
    statistic = float(np.sum((vectors.T @ difference) ** 2 / variance))
    return statistic, float(chdtrc(difference.size, statistic))


def listing(names: Sequence[str]) -> str:
    """Listing of the first few names and the number of the others."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"


def finite(values: Array) -> list[float | None]:
    """Numbers, and None for values that JSON does not have."""
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _names(mask: Mask) -> tuple[str, ...]:
    return tuple(name for name, chosen in zip(NAMES, mask, strict=True) if chosen)


def ratio_of(a: Array, b: Array) -> Array:
    """a/b, NaN where b is not positive."""
    out: Array = np.divide(a, b, out=np.full(a.shape, np.nan), where=b > 0.0)
    return out
