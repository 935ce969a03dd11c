"""Forms of a bias drift within a recording, as functions of time, and the test that selects them.

A form is a function s(t) with a mean of zero over the stationary windows, scaled to a range of one:

- linear in time;
- warm-up: ``exp(−t / τ)``, with τ an eighth or a third of the recording;
- linear in temperature;
- random walk: the first functions of its Karhunen-Loève expansion, ``sin((k − 1/2) π t / T)``.

The bias of a channel is ``b + a s(t)``; its constant part b is the mean bias over the windows, and a is its change over
the recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtrc, fdtrc

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.types import Array


FALSE_ALARM: Final = 1e-4
"""Probability that any form of any sensor is selected in a recording without drift."""
WALK: Final = "random walk"
_WALK_TERMS: Final = 12
"""Terms of the random walk; the omitted ones have at most 2 / (12 π²), 1.7 %, of its variance at the end."""
TESTED_TERMS: Final = 3
"""Terms of the random walk in its test: they have 93 % of its variance."""
_WARM_UP: Final = {"fast warm-up": 1.0 / 8.0, "warm-up": 1.0 / 3.0}
"""Time constants of the warm-up by name, as a share of the recording."""
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
    values = {"linear": 0.5 * (a + b)[:, None]}
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
class DriftTest:
    """Result of the test of one form.

    Attributes
    ----------
    p_value : float
    amplitude : ndarray, shape (n,)
        Least-squares estimate of the coefficients.
    """

    p_value: float
    amplitude: Array


def drift_tests(z: Array, H: Array, candidates: Mapping[str, Array]) -> dict[str, DriftTest]:
    """Test of each candidate against the model without it.

    The ratio of the decrease of chi-square per coefficient to the remaining chi-square per degree of freedom has
    Fisher's distribution, whatever the common scale of the noise is. The decrease itself must be significant, too:
    residuals far below the noise, as those of a noise-free recording, have systematic parts.

    Parameters
    ----------
    z : ndarray, shape (n,)
        Measurements with white noise of unit variance.
    H : ndarray, shape (n, p)
        Derivative with respect to the parameters of the model; columns that are zero are ignored.
    candidates : mapping of str to ndarray, shape (n, q)
        Derivative with respect to the coefficients of each candidate.
    """
    norm = np.linalg.norm(H, axis=0)
    Q, T = np.linalg.qr(H[:, norm > 0.0] / norm[norm > 0.0])
    Q = Q[:, np.abs(np.diag(T)) > 1e-10]
    r = z - Q @ (Q.T @ z)
    out = {}
    for name, Z in candidates.items():
        U, size, V = np.linalg.svd((Z - Q @ (Q.T @ Z)) / np.linalg.norm(Z, axis=0), full_matrices=False)
        # Coefficients that the parameters of the model explain are not testable.
        seen = size > 1e-6
        q, freedom = int(seen.sum()), len(z) - Q.shape[1] - int(seen.sum())
        if q == 0 or freedom < 1:
            continue
        found = U[:, seen].T @ r
        explained = float(found @ found)
        left = max(float(r @ r) - explained, 1e-300)
        p_value = max(float(fdtrc(q, freedom, explained / q / (left / freedom))), float(chdtrc(q, explained)))
        out[name] = DriftTest(p_value, V[seen].T @ (found / size[seen]) / np.linalg.norm(Z, axis=0))
    return out
