"""Difference of two calibrations of one recording, and its expected covariance.

One matrix, :func:`expected_covariance`, tests every parameter by its diagonal and all of them together by its inverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtrc, ndtri

from srt.result.verdict import DOUBTFUL, SOUND
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from srt.result.calibration import Calibration
    from srt.types import Array, Mask


FALSE_ALARM: Final = 0.01
"""False-alarm probability of a comparison: half of it for the largest difference of any one parameter, half for the
joint tests."""

EXPECTED_SIGMA_FLOOR: Final = 0.05
"""Floor of an expected sigma, as a fraction of the larger sigma of the two estimates. The expected difference of two
efficient estimators is zero; they still differ by their stopping rules (0.01 sigma), by terms of second order and by
the treatment of shared noise. Differences below a twentieth of sigma do not matter, of estimates or of sigmas."""

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
        Chi-square of all differences, with one degree of freedom per compared parameter.
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
        return _names(self.compared & (self.sigma_ratio < 1.0 - EXPECTED_SIGMA_FLOOR))

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
    spread = np.full(len(NAMES), np.nan)
    difference = np.where(shared, other.errors.vector - reference.errors.vector, np.nan)
    covariance = expected_covariance(other, reference, shared)
    spread[shared] = np.sqrt(np.diag(covariance))
    normalised = difference / spread
    correlation = covariance / np.outer(spread[shared], spread[shared])
    statistic = float(normalised[shared] @ np.linalg.solve(correlation, normalised[shared]))
    return EstimateDifference(
        estimator=name,
        reference=reference_name,
        compared=shared,
        difference=difference,
        expected_sigma=spread,
        normalised=normalised,
        sigma_ratio=np.where(shared, ratio_of(other.sigma, reference.sigma), np.nan),
        limit=_limit(tests),
        chi_square=statistic,
        p_value=float(chdtrc(max(int(shared.sum()), 1), statistic)),
        least_p_value=0.5 * FALSE_ALARM / estimators,
    )


def expected_covariance(a: Calibration, b: Calibration, compared: Mask) -> Array:
    """Expected covariance of the difference of two estimates from the same data.

    Parameters
    ----------
    a, b : Calibration
        In either order.
    compared : ndarray of bool, shape (27,)
        n parameters that both observed.

    Returns
    -------
    ndarray, shape (n, n), SI
        Positive definite.

    Notes
    -----
    The estimates share most of their noise, so the sum of their covariances Pa and Pb says nothing about their
    difference. Let x be an estimate with a covariance P that neither exceeds. If x is efficient, xa − x and xb − x are
    uncorrelated with x (otherwise a combination would have a smaller variance), so that their covariances are Pa − P
    and Pb − P (Hausman 1978, Econometrica 46, 1251). Without a correlation between the two::

        C = (Pa − P) + (Pb − P) = |Pa − Pb|,    P = (Pa + Pb − |Pa − Pb|) / 2

    P is the largest such covariance: in each eigenvector of Pa − Pb the estimate with the smaller variance is
    efficient. If b is efficient, then P = Pb and C = Pa − Pb. Errors that both covariances contain, such as those of
    gravity and of the time base, cancel. The eigenvectors are those in units of the larger sigma of each parameter, and
    the floor on the eigenvalues is the square of :data:`EXPECTED_SIGMA_FLOOR`.

    Where the residuals of an estimate, with ν degrees of freedom, have set the scale of its covariance, by a factor on
    all sigmas or by added noise, this covariance is itself uncertain by √(2/ν) of it. That may exceed Pa − Pb, and is
    added. Estimates that have enlarged the same kinds of noise share this uncertainty, and nothing is added.
    """
    scale = np.fmax(a.sigma, b.sigma)[compared]
    units = np.outer(scale, scale)
    Pa, Pb = (calibration.covariance[np.ix_(compared, compared)] / units for calibration in (a, b))
    eigenvalues, vectors = np.linalg.eigh(Pa - Pb)
    variance = np.maximum(np.abs(eigenvalues), EXPECTED_SIGMA_FLOOR**2)
    C = (vectors * variance) @ vectors.T
    by_a, by_b = modelled_effects(a), modelled_effects(b)
    if by_a.enlarged != by_b.enlarged:
        C = C + by_a.relative_uncertainty * Pa + by_b.relative_uncertainty * Pb
    return np.asarray(C * units)


def _limit(count: int) -> float:
    """Two-sided normal quantile that the largest of ``count`` draws exceeds with half of FALSE_ALARM (Šidák).

    Exact for independent draws; correlated ones exceed it more rarely.
    """
    alone = -math.expm1(math.log1p(-0.5 * FALSE_ALARM) / max(count, 1))
    return float(-ndtri(0.5 * alone))


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


_SENSORS: Final = {"gyro": "the gyros", "accel": "the accelerometers"}
_ADDED: Final = {
    "rotation_rad": "the rotations",
    "force_m_s2": "the specific forces",
    "rate_rad_s": "the rates at rest",
    "wobble_rad": "the wobble of the axes",
    "start_angle_rad": "the start angles",
    "alignment_rad": "the alignment of the fixture",
}
"""Measurements whose noise is enlarged, by the kind of added noise."""


@dataclass(frozen=True, slots=True)
class ModelledEffects:
    """Effects in the model of one calibration."""

    names: tuple[str, ...]  # bias drifts, g-sensitivity and added noise, as a sentence names them
    unused_moves: int  # recorded moves between the sequences that the estimator does not use
    # kinds of noise that the residuals have enlarged; "all" for a factor on all sigmas (Birge ratio)
    enlarged: frozenset[str]
    freedom: int  # degrees of freedom of the residuals

    @property
    def relative_uncertainty(self) -> float:
        """1-sigma of the covariance over the covariance, √(2/ν), if the residuals have set its scale; else zero."""
        return float((2.0 / max(self.freedom, 1)) ** 0.5) if self.enlarged else 0.0


def modelled_effects(calibration: Calibration) -> ModelledEffects:
    """Effects in the model of a calibration."""
    diagnostics, noise, evidence = calibration.diagnostics, calibration.noise, calibration.consistency
    drift = [term for term in diagnostics.drift or () if term.modelled]
    by_kind = {} if evidence is None or evidence.added_noise is None else evidence.added_noise
    added = {kind for kind, size in by_kind.items() if size.added > 0.0 and kind in _ADDED}
    names = [f"a bias drift of {_SENSORS[term.sensor]} ({term.form})" for term in drift]
    names += ["the g-sensitivity of the gyros"] * (diagnostics.g_sensitivity is not None)
    names += [f"added noise of {measured}" for kind, measured in _ADDED.items() if kind in added]
    return ModelledEffects(
        names=tuple(names),
        unused_moves=diagnostics.unused_moves or 0,
        enlarged=frozenset(added | ({"all"} if (noise.sigma_inflation or 1.0) > 1.0 else set())),
        freedom=noise.degrees_of_freedom or 0,
    )


def verdicts_differ(calibrations: Mapping[str, Calibration]) -> str:
    """Sentence on calibrations of which some are doubtful and others sound, with what only some of them model.

    Parameters
    ----------
    calibrations : mapping of str to Calibration
        Usable ones, by name. Those that do not say how well their measurements agree are not judged.

    Returns
    -------
    str
        Empty if all have the same verdict.
    """
    judged = {name: c for name, c in calibrations.items() if c.consistency}
    doubtful = [name for name, c in judged.items() if c.judgement.word == DOUBTFUL]
    sound = [name for name in judged if name not in doubtful]
    if not doubtful or not sound:
        return ""
    others = "the others" if len(sound) > 1 else sound[0]
    word = "sound" if all(judged[name].judgement.word == SOUND for name in sound) else "not"
    found = "; ".join(_differences({name: modelled_effects(c) for name, c in judged.items()}))
    return (
        f"{joined(doubtful)} {'are' if len(doubtful) > 1 else 'is'} doubtful, {others} {word}"
        f"{f': {found}.' if found else ', though all model the same effects.'}"
    )


def _differences(effects: Mapping[str, ModelledEffects]) -> Iterable[str]:
    """Clauses on the effects that only some of the estimators model, and on moves that some do not use."""
    by_estimators: dict[tuple[str, ...], list[str]] = {}
    for effect in dict.fromkeys(effect for own in effects.values() for effect in own.names):
        having = tuple(name for name, own in effects.items() if effect in own.names)
        by_estimators.setdefault(having, []).append(effect)
    for having, found in by_estimators.items():
        lacking = [name for name in effects if name not in having]
        if lacking:
            models, does = ("models", "model")[len(having) > 1], ("does", "do")[len(lacking) > 1]
            yield f"{joined(having)} {models} {joined(found)}, {joined(lacking)} {does} not"
    for name, own in effects.items():
        if own.unused_moves:
            yield f"{name} does not use the {own.unused_moves} recorded moves"


def joined(names: Iterable[str]) -> str:
    """Names as a sentence lists them: "a, b and c"."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
