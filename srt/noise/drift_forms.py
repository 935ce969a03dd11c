"""Forms of a bias drift within a recording, as functions of time, and the test that selects them.

A form is a function s(t) with a mean of zero over the stationary windows, scaled to a range of one:

- linear in time;
- warm-up: ``exp(−t / τ)``, with τ a twelfth, a sixth or two fifths of the recording;
- linear in temperature;
- random walk: the first functions of its Karhunen-Loève expansion, ``sin((k − 1/2) π t / T)``.

The bias of a channel is ``b + a s(t)``; its constant part b is the mean bias over the windows, and a is its change over
the recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

if TYPE_CHECKING:
    from srt.types import Array


FALSE_ALARM: Final = 2e-5
"""Probability that any form of any sensor is selected in a recording without drift.

It is part of the 1e-4 that all checks share, see ``srt.diagnosis.findings``. With 41 degrees of freedom, a
drift of 7.9 sigma is selected in 90 % of the recordings; at 1e-4 a drift of 7.3 sigma would be.
"""
LINEAR: Final = "linear"
WALK: Final = "random walk"
_WALK_TERMS: Final = 12
"""Terms of the random walk; the omitted ones have at most 2 / (12 π²), 1.7 %, of its variance at the end."""
TESTED_TERMS: Final = 3
"""Terms of the random walk in its test: they have 93 % of its variance."""
_WARM_UP: Final = {"fast warm-up": 1.0 / 12.0, "warm-up": 1.0 / 6.0, "slow warm-up": 0.4}
"""Time constants of the warm-up by name, as a share of the recording."""
_SEEN: Final = 1e-10
"""Eigenvalue of the information, relative to the largest, below which a coefficient is not testable."""
_LEAST_TEMPERATURE_RANGE: Final = 0.1
"""Range of the window temperatures, K, below which a drift with temperature is not tested."""


@dataclass(frozen=True, slots=True, eq=False)
class DriftShape:
    """Means of the n functions of a form.

    Attributes
    ----------
    windows : ndarray, shape (W, n)
    parts : ndarray, shape (K, P, n)
        Over the equal parts of every rotation.
    """

    windows: Array
    parts: Array


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Windows and parts of rotations.

    Attributes
    ----------
    start, end : ndarray, shape (W + K P,), s
        Windows first.
    windows : int
    parts : (int, int)
        K and P.
    temperature : ndarray, shape (W + K P,), °C, or None
        Mean temperatures.
    """

    start: Array
    end: Array
    windows: int
    parts: tuple[int, int]
    temperature: Array | None


def drift_shapes(intervals: Intervals) -> dict[str, DriftShape]:
    """Shapes of all forms by name."""
    begin = float(intervals.start.min())
    T = float(intervals.end.max()) - begin
    a, b = (intervals.start - begin) / T, (intervals.end - begin) / T
    values = {LINEAR: 0.5 * (a + b)[:, None]}
    for name, share in _WARM_UP.items():
        values[name] = _mean(-share * np.exp(-a / share), -share * np.exp(-b / share), b - a)[:, None]
    order = (np.arange(_WALK_TERMS) + 0.5) * math.pi
    begins, ends = (np.cos(t[:, None] * order) * (-math.sqrt(2.0) / order**2) for t in (a, b))
    values[WALK] = _mean(begins, ends, (b - a)[:, None])
    if intervals.temperature is not None:
        own = intervals.temperature
        if np.ptp(own[: intervals.windows]) > _LEAST_TEMPERATURE_RANGE:
            values["temperature"] = own[:, None]
    return {name: _centred(value, intervals, scaled=name != WALK) for name, value in values.items()}


def _mean(begin: Array, end: Array, width: Array) -> Array:
    """Mean of a function over intervals, from its antiderivative at both ends; zero for intervals without length."""
    return np.asarray((end - begin) / np.where(width > 0.0, width, 1.0))


def _centred(values: Array, intervals: Intervals, *, scaled: bool) -> DriftShape:
    W = intervals.windows
    weight = intervals.end[:W] - intervals.start[:W]
    values = values - weight @ values[:W] / weight.sum()
    if scaled:
        values = values / np.ptp(values[:W], axis=0)
    return DriftShape(values[:W], values[W:].reshape(*intervals.parts, values.shape[1]))


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Information that the whitened residuals of a model contain on additional coefficients, which it lacks.

    Attributes
    ----------
    gradient : ndarray, shape (q,)
        Zᵀ r, with the residuals r and their derivative Z with respect to the coefficients.
    information : ndarray, shape (q, q)
        Zᵀ M Z with the projection M onto the residuals.
    chi_square : float
        rᵀ r.
    freedom : int
        Degrees of freedom of the residuals.
    """

    gradient: Array
    information: Array
    chi_square: float
    freedom: int


@dataclass(frozen=True, slots=True, eq=False)
class DriftTest:
    """Result of the test of one form.

    Attributes
    ----------
    p_value : float
    amplitude : ndarray, shape (q,)
        Least-squares estimate of the tested coefficients.
    """

    p_value: float
    amplitude: Array


def residual_statistics(z: Array, H: Array, *effects: Array) -> list[Statistics]:
    """Statistics of measurements with white noise of unit variance, for each of several sets of coefficients.

    Parameters
    ----------
    z : ndarray, shape (n,)
    H : ndarray, shape (n, p)
        Derivative with respect to the parameters of the model; columns that are zero are ignored.
    *effects : ndarray, shape (n, q)
        Derivative with respect to the coefficients of a set.
    """
    norm = np.linalg.norm(H, axis=0)
    Q, T = np.linalg.qr(H[:, norm > 0.0] / norm[norm > 0.0])
    Q = Q[:, np.abs(np.diag(T)) > 1e-10]
    r = z - Q @ (Q.T @ z)
    chi_square, freedom = float(r @ r), len(z) - Q.shape[1]
    left = (Z - Q @ (Q.T @ Z) for Z in effects)
    return [Statistics(Z.T @ r, Z.T @ Z, chi_square, freedom) for Z in left]


def drift_test(found: Statistics) -> DriftTest | None:
    """Test of a form against the model without it; None if the residuals do not depend on it.

    F test: the decrease of chi-square per coefficient, over the remaining chi-square per degree of freedom. The ratio
    does not depend on the scale of the noise. The decrease must also be significant by itself: residuals far below the
    stated noise, as in a noise-free recording, are systematic and would pass the F test alone.
    """
    tested = slice(3 * TESTED_TERMS)
    information, gradient = found.information[tested, tested], found.gradient[tested]
    values, vectors = np.linalg.eigh(information)
    seen = values > _SEEN * values[-1]
    q, along = int(seen.sum()), vectors[:, seen].T @ gradient
    freedom = found.freedom - q
    if values[-1] <= 0.0 or freedom < 1:
        return None
    explained = float(np.sum(along**2 / values[seen]))
    left = max(found.chi_square - explained, 1e-300)
    p_value = max(float(fdtrc(q, freedom, explained / q / (left / freedom))), float(chdtrc(q, explained)))
    return DriftTest(p_value, vectors[:, seen] @ (along / values[seen]))


class VarianceComponent(NamedTuple):
    """Common variance of a set of coefficients by restricted maximum likelihood.

    Attributes
    ----------
    sigma : float
        Standard deviation.
    p_value : float
        Of the likelihood ratio, if the variance is zero: half that of chi-square with one degree of freedom, because a
        variance is not negative (Self and Liang 1987).
    """

    sigma: float
    p_value: float


def variance_component(found: Statistics) -> VarianceComponent:
    """Estimate the common variance of coefficients, and test it.

    With the eigenvalues λ of the information and the gradient g along its eigenvectors the log likelihood of a variance
    v is ``½ Σ [v g² / (1 + v λ) − log(1 + v λ)]``.
    """
    from scipy.optimize import minimize_scalar  # heavy, and few calibrations have such a drift

    values, vectors = np.linalg.eigh(found.information)
    values, along = np.maximum(values, 0.0), (vectors.T @ found.gradient) ** 2

    def cost(log_variance: float) -> float:
        v = math.exp(log_variance)
        return float(np.sum(np.log1p(v * values) - v * along / (1.0 + v * values)))

    size = -math.log(float(values[-1]))
    # From a hundredth of the sigma of the best-known coefficient to a million times that sigma.
    best = minimize_scalar(cost, bounds=(size - 9.2, size + 27.6), method="bounded")
    return VarianceComponent(math.exp(0.5 * float(best.x)), 0.5 * float(chdtrc(1, max(-float(best.fun), 0.0))))
