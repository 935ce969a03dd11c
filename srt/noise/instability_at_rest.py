"""Bias instability that the stationary windows of a recording show, or cannot exclude.

Type-II discrete cosines of the readings of a window of n samples are nearly independent. Coefficient j, at the
frequency f = j / (2 n dt), has the variance::

    λ = N²/dt + q² · 4 sin²(π f dt)/dt² + B² λ_B

for white noise N, an error q of every reading of the integral, and bias instability B, whose λ_B is that of the
Gauss-Markov processes of :mod:`srt.noise.bias_instability`: near 1/(4 ln 2 f dt), but a quarter less at j = 1, where
slower processes leak. In octaves of f, the median over the windows is robust against single windows with motion. The
terms are fitted to it by least squares, N and q for each channel, B for the three channels of a sensor together. The
fastest process has a size of its own: at its frequencies, a sensor may have less noise or more than flicker noise.
Behind a low-pass filter only frequencies far below its corner are used, where the errors of readings do not show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.noise.bias_instability import CORRELATION_TIMES_S, PROCESS_VARIANCE, flicker_covariance
from srt.noise.nonnegative import nonnegative_least_squares
from srt.noise.random_walk import MEDIAN, SIGNIFICANT

if TYPE_CHECKING:
    from srt.types import Array, Indices

_FEWEST_SAMPLES: Final = 16
"""Samples of a window from which it is used."""
_PARTS: Final = 64
"""Parts of a window whose means give the first cosine coefficients: an eighth, of which averages lose below 2 %."""
_PIECE: Final = 1 << 13
"""Samples of windows that are transformed together: they fit into a processor's cache."""
_PASSES: Final = 3
"""Fits with the weights of the fit before."""
_PASSED: Final = 0.125
"""Highest frequency used behind a filter, times the averaging time from which the filter does not show. At it, the
memory of the filter is a radian at most."""
_FEWEST_OCTAVES: Final = 3
"""Octaves of frequency that are used behind a filter at least."""


@dataclass(frozen=True, slots=True)
class InstabilityAtRest:
    """Bias instability of a sensor from its stationary windows.

    Attributes
    ----------
    value : float
        Allan floor in units of the readings; zero if the windows do not show it (p = 1e-3).
    bound, limit : float
        Allan floor whose square is that of the estimate plus 1 sigma, and the largest that the windows cannot exclude
        (p = 1e-3).
    square, doubt : float
        Estimate of the square of the Allan floor, negative where noise happens to be small, and its 1-sigma.
    """

    value: float = 0.0
    bound: float = 0.0
    limit: float = 0.0
    square: float = 0.0
    doubt: float = 0.0


def instability_at_rest(readings: Array, windows: Indices, dt_s: float, filter_s: float = 0.0) -> InstabilityAtRest:
    """Bias instability of a sensor from its stationary windows; zeros if these are too short.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)
        Means over the sampling interval.
    windows : ndarray of int, shape (W, 2)
        First sample and one past the last.
    dt_s : float
        Sampling interval, s.
    filter_s : float
        Averaging time beyond which a low-pass filter of the sensor does not show, s; zero without a filter.
    """
    lengths = np.diff(windows, axis=1)[:, 0]
    longest = int(lengths.max(initial=0))
    if longest < _FEWEST_SAMPLES:
        return InstabilityAtRest()
    octaves = int(math.log2(longest))
    if filter_s > 0.0:
        octaves = min(octaves, max(int(math.log2(2.0 * longest * dt_s * _PASSED / filter_s)), _FEWEST_OCTAVES))
    power = np.full((len(windows), octaves, 3), np.nan)
    count = np.zeros((len(windows), octaves))
    design = np.zeros((len(windows), octaves, 4))
    from scipy.fft import dct  # on use: labelled recordings with stated noise do without

    for n in np.unique(lengths[lengths >= _FEWEST_SAMPLES]).tolist():
        f_dt = np.arange(1, n) / (2.0 * n)
        octave = np.log2(2.0 * longest * f_dt).astype(np.intp)
        # The highest octave contains all that is above it, unless a filter hides that.
        octave = octave[octave < octaves] if filter_s > 0.0 else np.minimum(octave, octaves - 1)
        if not octave.size:
            continue
        terms = np.stack([np.full(n - 1, 1.0 / dt_s), 4.0 * np.sin(math.pi * f_dt) ** 2 / dt_s**2], axis=1)
        terms = np.concatenate([terms, _drift_variances(n, dt_s)], axis=1)[: len(octave)]
        first, number = np.unique(octave, return_index=True, return_counts=True)[1:]
        there = octave[first]
        own, together = np.flatnonzero(lengths == n), max(1, _PIECE // n)
        design[own[:, None], there] = np.add.reduceat(terms, first) / number[:, None]
        count[own[:, None], there] = number
        # The median of a sum of k squares is smaller than its expected value.
        median = chdtri(number, 0.5)[:, None]
        for some in (own[i : i + together] for i in range(0, len(own), together)):
            part = dct(np.stack([readings[a : a + n] for a in windows[some, 0]]), axis=1, norm="ortho")
            square = part[:, 1 : len(octave) + 1] ** 2
            power[some[:, None], there] = np.add.reduceat(square, first, axis=1) / median
    used = count.sum(axis=0) > 0
    freedom = count.sum(axis=0)[used]
    observed = np.nanmedian(power[:, used], axis=0)
    mean = np.stack([np.sum(design[:, used, i] * count[:, used], axis=0) / freedom for i in range(4)], axis=1)
    return _fitted(observed, mean, freedom, filtered=filter_s > 0.0)


@lru_cache(maxsize=8)
def _drift_variances(n: int, dt_s: float) -> Array:
    """Variance of the cosine coefficients 1 to n − 1 of a window by the fastest and by all other processes, (n − 1, 2).

    For bias instability of one.
    """
    from scipy.fft import dct

    omega, tau = math.pi * np.arange(1, n) / (n * dt_s), np.array(CORRELATION_TIMES_S)
    processes = PROCESS_VARIANCE / dt_s * 2.0 * tau / (1.0 + (omega[:, None] * tau) ** 2)
    out = np.stack([processes[:, 0], processes[:, 1:].sum(axis=1)], axis=1)
    # Processes slower than the window leak; the first coefficients are those of the means over parts of it.
    parts = min(n, _PARTS)
    start = np.asarray(n * dt_s / parts * np.arange(parts), dtype=np.float64)
    covariance = flicker_covariance(start, start + n * dt_s / parts, CORRELATION_TIMES_S[1:])
    exact = np.diag(dct(dct(covariance, axis=0, norm="ortho"), axis=1, norm="ortho")) * n / parts
    first = parts // 8
    out[:first, 1] = exact[1 : first + 1]
    return out


def _fitted(observed: Array, design: Array, freedom: Array, *, filtered: bool) -> InstabilityAtRest:
    """Fit of N² and, unless filtered, q² of each channel, and the common B², to medians of shape (octaves, 3)."""
    if not np.all(observed.max(axis=0) > 0.0):
        return InstabilityAtRest()  # a constant channel
    rows = len(observed)
    by_axis = np.zeros((3, rows, 8))
    for axis in range(3):
        by_axis[axis][:, [axis, 3 + axis, 6, 7]] = design
    A = by_axis.reshape(-1, 8)
    if filtered:
        A = np.delete(A, slice(3, 6), axis=1)
    y = observed.T.ravel()
    relative = np.tile(np.sqrt(2.0 * MEDIAN / freedom), 3)
    square, doubt, free = _least_squares(A, y, relative)
    # Without instability, both processes vanish: their sum has more power in a test of that.
    tied, tied_doubt, _ = _least_squares(np.column_stack([A[:, :-2], A[:, -2] + A[:, -1]]), y, relative)
    shown = tied > SIGNIFICANT * tied_doubt
    return InstabilityAtRest(
        value=math.sqrt(max(square, tied)) if shown else 0.0,
        bound=math.sqrt(max(square, tied) + doubt),
        limit=math.sqrt(max(square, tied) + SIGNIFICANT * doubt),
        square=free,
        doubt=doubt,
    )


def _least_squares(A: Array, y: Array, relative: Array) -> tuple[float, float, float]:
    """Last unknown of a fit without negative unknowns, its 1-sigma, and its value in a fit of any signs."""
    expected = y
    for _ in range(_PASSES):
        sigma = np.maximum(expected, 1e-9 * y.max()) * relative
        weighted = A / sigma[:, None]
        solution = nonnegative_least_squares(weighted, y / sigma)
        expected = A @ solution
    scale = np.linalg.norm(weighted, axis=0)
    unit = weighted / scale
    inverse = np.linalg.pinv(unit.T @ unit)
    free = inverse[-1] @ (unit.T @ (y / sigma)) / scale[-1]
    return float(solution[-1]), float(np.sqrt(inverse[-1, -1]) / scale[-1]), float(free)
