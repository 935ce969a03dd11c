"""Quantization steps of the readings of a recording, and of readings that a correction has mixed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import STANDARD_GRAVITY_M_S2

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.types import Array, Indices


_SAMPLES: Final = 4000
"""Number of samples from which the step of the readings is taken."""
_GAP: Final = 20.0
"""Ratio of two successive sorted differences that separates noise from steps."""
_FEWEST_SMALL: Final = 10
"""Smallest number of differences below the gap; normal noise has such a gap with a probability of 1e-13."""
_FEWEST_LARGE: Final = 3
"""Smallest number of differences above the gap."""
_BULK: Final = (0.25, 0.8)
"""Quantiles of the differences that single outlying readings hardly change; of normal noise, their ratio is 4."""


def smallest_step(values: Array) -> Array:
    """Smallest difference between distinct readings, per column of an (n, c) table; 0 where readings hardly repeat."""
    gaps = np.diff(np.sort(np.ascontiguousarray(values.T), axis=1), axis=1)
    step, distinct = np.zeros(values.shape[1]), 1 + np.count_nonzero(gaps, axis=1)
    for axis in np.flatnonzero((distinct > 1) & (distinct <= 0.5 * len(values))).tolist():
        own = gaps[axis]
        step[axis] = own[own > 1e-9 * np.abs(values[:, axis]).max()].min(initial=np.inf)
    step[~np.isfinite(step)] = 0.0
    return step


def thinned(table: Array, windows: Indices | None = None) -> Array:
    """Some thousand readings that show the steps of a table, (n, 3), spread over it or over windows of it, (W, 2)."""
    spans = [(0, len(table))] if windows is None else windows.tolist()
    stride = max(1, sum(b - a for a, b in spans) // _SAMPLES)
    return np.concatenate([table[a:b:stride] for a, b in spans])


def single_precision_step(table: Array, windows: Indices) -> Array:
    """Step of numbers in single precision at the largest readings of windows and of all, (2, 3); 0: not stored so.

    Readings of a log in °/s or g are single-precision numbers after the conversion back.
    """
    some, size = (
        thinned(table),
        np.stack([np.abs(part).max(axis=0) for part in (thinned(table, windows), thinned(table))]),
    )
    for unit in (1.0, math.pi / 180.0, STANDARD_GRAVITY_M_S2):
        stored = some / unit
        apart = np.abs(stored - stored.astype(np.float32))
        if np.all(apart <= 4.0 * np.finfo(float).eps * np.abs(stored)):
            return np.asarray(unit * np.spacing((size / unit).astype(np.float32)), dtype=np.float64)
    return np.zeros((2, 3))


def reading_steps(recording: Recording) -> Array:
    """Smallest step between distinct readings, as angle (rad) and velocity (m/s), gyros then accelerometers.

    Returns
    -------
    ndarray, shape (6,)
        Zero for channels whose readings hardly repeat.
    """
    step = np.concatenate([smallest_step(thinned(table)) for table in (recording.gyro, recording.accel)])
    return step * recording.nominal_interval_s * recording.rates_factor


def quantization_step(readings: Array) -> Array:
    """Step between readings, by column.

    Compensation mixes the steps of three axes and rounds, so that the smallest difference of corrected readings is not
    a step. Sorted by size, the differences have a wide gap; those above it are steps. Where nine of ten differences
    scatter like noise, or by few steps, larger ones are outlying readings, whatever their number.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)

    Returns
    -------
    ndarray, shape (3,)
        Smallest difference if there is no gap; zero for constant columns.
    """
    step = smallest_step(readings)
    size = np.sort(np.abs(np.diff(readings, axis=0)), axis=0)
    lower, upper = size[_FEWEST_SMALL - 1 : -_FEWEST_LARGE], size[_FEWEST_SMALL : len(size) - _FEWEST_LARGE + 1]
    low, high = np.quantile(size, _BULK, axis=0) if len(size) else np.zeros((2, size.shape[1]))
    noisy = (high > 0.0) & (high < _GAP * np.maximum(low, step))
    for column in np.flatnonzero(~noisy).tolist():
        above = upper[upper[:, column] > _GAP * lower[:, column], column]
        if above.size:
            step[column] = max(float(step[column]), float(above[-1]))
    return step
