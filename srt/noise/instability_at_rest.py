"""Bias instability that the stationary windows of a recording show, or cannot exclude.

Type-II discrete cosines of the readings of a window of n samples are nearly independent. Coefficient j, at the
frequency f = j / (2 n dt), has the variance::

    λ = N²/dt + q² · 4 sin²(π f dt)/dt² + B²/(4 ln 2 · f dt)

for white noise N, an error q of every reading of the integral, and bias instability B. In octaves of f, the median over
the windows is robust against single windows with motion. The three terms are fitted to it by least squares, N and q for
each channel, B for the three channels of a sensor together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.noise.nonnegative import nonnegative_least_squares

if TYPE_CHECKING:
    from srt.types import Array, Indices

_FEWEST_SAMPLES: Final = 16
"""Samples of a window from which it is used."""
_MEDIAN: Final = math.pi / 2.0
"""Variance of a median over that of the mean, of normal numbers."""
_SIGNIFICANT: Final = 3.09
"""B² over its 1-sigma from which B counts as shown: p = 1e-3."""
_PASSES: Final = 3
"""Fits with the weights of the fit before."""


@dataclass(frozen=True, slots=True, eq=False)
class InstabilityAtRest:
    """Bias instability of a sensor from its stationary windows.

    Attributes
    ----------
    shown : bool
        True if the windows show it (p < 1e-3).
    value : float
        Allan floor in units of the readings; zero if it is not shown.
    bound : float
        Allan floor that the windows cannot exclude: the square of the estimate, plus its 1-sigma.
    white : ndarray, shape (3,)
        White noise of the same fit, in units of the readings times √s.
    """

    shown: bool
    value: float
    bound: float
    white: Array


def instability_at_rest(readings: Array, windows: Indices, dt_s: float) -> InstabilityAtRest | None:
    """Bias instability of a sensor from its stationary windows; None if these are too short.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)
        Means over the sampling interval.
    windows : ndarray of int, shape (W, 2)
        First sample and one past the last.
    dt_s : float
        Sampling interval, s.
    """
    lengths = np.diff(windows, axis=1)[:, 0]
    longest = int(lengths.max(initial=0))
    if longest < _FEWEST_SAMPLES:
        return None
    octaves = int(math.log2(longest))
    power = np.full((len(windows), octaves, 3), np.nan)
    count = np.zeros((len(windows), octaves))
    design = np.zeros((len(windows), octaves, 3))
    from scipy.fft import dct  # on use: labelled recordings with stated noise do without

    for w in np.flatnonzero(lengths >= _FEWEST_SAMPLES).tolist():
        n = int(lengths[w])
        square = dct(readings[windows[w, 0] : windows[w, 1]], axis=0, norm="ortho")[1:] ** 2
        f_dt = np.arange(1, n) / (2.0 * n)
        octave = np.minimum(np.log2(2.0 * longest * f_dt).astype(np.intp), octaves - 1)
        terms = np.stack([np.full(n - 1, 1.0 / dt_s), 4.0 * np.sin(math.pi * f_dt) ** 2 / dt_s**2], axis=1)
        terms = np.concatenate([terms, 1.0 / (4.0 * math.log(2.0) * f_dt)[:, None]], axis=1)
        number = np.bincount(octave, minlength=octaves)
        there = number > 0
        for target, values in ((power, square), (design, terms)):
            sums = np.stack([np.bincount(octave, column, octaves) for column in values.T], axis=1)
            target[w, there] = sums[there] / number[there, None]
        # The median of a mean of k squares is smaller than its expected value.
        power[w, there] /= (chdtri(number[there], 0.5) / number[there])[:, None]
        count[w] = number
    used = count.sum(axis=0) > 0
    freedom = count.sum(axis=0)[used]
    observed = np.nanmedian(power[:, used], axis=0)
    mean = np.stack([np.sum(design[:, used, i] * count[:, used], axis=0) / freedom for i in range(3)], axis=1)
    return _fitted(observed, mean, freedom)


def _fitted(observed: Array, design: Array, freedom: Array) -> InstabilityAtRest | None:
    """Fit of N² and q² of each channel and the common B² to medians of shape (octaves, 3)."""
    if not np.all(observed.max(axis=0) > 0.0):
        return None  # a constant channel
    rows = len(observed)
    by_axis = np.zeros((3, rows, 7))
    for axis in range(3):
        by_axis[axis][:, [axis, 3 + axis, 6]] = design
    A = by_axis.reshape(-1, 7)
    y = observed.T.ravel()
    relative = np.tile(np.sqrt(2.0 * _MEDIAN / freedom), 3)
    expected = y
    for _ in range(_PASSES):
        sigma = np.maximum(expected, 1e-9 * y.max()) * relative
        weighted = A / sigma[:, None]
        scale = np.linalg.norm(weighted, axis=0)
        solution = nonnegative_least_squares(weighted / scale, y / sigma) / scale
        expected = A @ solution
    information = (weighted / scale).T @ (weighted / scale)
    doubt = float(np.sqrt(np.linalg.pinv(information)[6, 6]) / scale[6])
    square = float(solution[6])
    shown = square > _SIGNIFICANT * doubt
    return InstabilityAtRest(
        shown=shown,
        value=math.sqrt(square) if shown else 0.0,
        bound=math.sqrt(square + doubt),
        white=np.sqrt(solution[:3]),
    )
