"""Averages of the stationary windows, computed once, and the weights of the two averaging algorithms.

Only means are compensated: compensation of single samples would rectify their noise through the asymmetry term. If the
attitude is constant in the windows, the iterations need no other data of the windows than these means.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from srt.exceptions import DataError
from srt.recording.readings import of_each, side_by_side

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.recording.recording import Recording, SequenceLabel
    from srt.types import Array, Indices


LEAST_SAMPLES: Final = 2
"""Samples that a stationary window needs."""
PARTS: Final = 16
"""Parts of a window from whose means its noise is estimated."""
MEDIAN_OF_SQUARE: Final = 0.4549
"""Median of chi-square with one degree of freedom."""
_LOUD: Final = 8.0
"""Ratio of the noise variance of a window to that of the others from which it is its own, with p < 1e-7 otherwise."""
_ROUNDED: Final = 2.5
"""Range of readings in their smallest steps up to which a window may be louder than others by rounding alone."""
_SAME: Final = 1e-9
"""Difference of equal readings over the largest reading: rounding of what was computed from counts."""
_FEWEST: Final = 4
"""Windows from which the noise of one is compared with that of the others."""

Average = Literal["linear", "overlapping"]
"""Plain mean, or mean of overlapping half-window means (Savage 2020, after eq. 1: linear, average of averages)."""


def averaging_weights(n: int, algorithm: Average) -> Array:
    """Weights of n samples, which sum to 1.

    "linear" is the plain mean; "overlapping" the mean of all means over half the window, which is a triangle (a
    trapezoid for odd n). The weighted mean of a unit ramp is F_Meas = 1/2 with both (Savage 2020, after eq. 22).
    """
    if algorithm == "linear" or n < 2:
        return np.full(n, 1.0 / n)
    half = n // 2
    return np.convolve(np.full(half, 1.0 / half), np.full(n - half + 1, 1.0 / (n - half + 1)))


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Averages of W stationary windows, raw readings as rates.

    Attributes
    ----------
    samples : ndarray of int, shape (W, 2)
        First sample and one past the last.
    duration_s : ndarray, shape (W,)
    gyro_mean : ndarray, shape (W, 3), rad/s
        Linear mean.
    gyro_halves, accel_halves : ndarray, shape (W, 2, 3), rad/s and m/s²
        Means of the first and the second half, for the test of stillness.
    accel_mean : ndarray, shape (W, 3), m/s²
        By the averaging algorithm.
    gyro_excess, accel_excess : ndarray, shape (W, 3), rad²/s and m²/s³
        Squared random walk of windows that are noisier than the others, beyond that of the others; else zero.
    white_factor : ndarray, shape (W,), 1/s
        Variance of the accelerometer mean over squared random walk.
    edge_factor : ndarray, shape (W,), 1/s²
        Variance of the accelerometer mean over the variance of one quantization error.
    """

    samples: Indices
    duration_s: Array
    gyro_mean: Array
    gyro_halves: Array
    accel_halves: Array
    accel_mean: Array
    gyro_excess: Array
    accel_excess: Array
    white_factor: Array
    edge_factor: Array


def windows_of_labels(recording: Recording, labels: Sequence[SequenceLabel]) -> tuple[Indices, Indices]:
    """Samples of the windows of sequences, (W, 2), and the number of the start and of the end window, (2, K).

    Raises
    ------
    DataError
        If a window holds less than 2 samples.
    """
    limits = [bounds for label in labels for bounds in (label.start_static_s, label.end_static_s)]
    slices: dict[tuple[int, int], int] = {}
    ends = np.empty(len(limits), dtype=np.intp)
    for number, (bounds, s) in enumerate(zip(limits, recording.windows(limits), strict=True)):
        if s.stop - s.start < LEAST_SAMPLES:
            raise DataError(
                f"The window from {bounds[0]:g} s to {bounds[1]:g} s of sequence "
                f"{labels[number // 2].id or 'without id'} holds {s.stop - s.start} samples; a stationary window needs "
                f"at least {LEAST_SAMPLES}: correct its times."
            )
        ends[number] = slices.setdefault((s.start, s.stop), len(slices))
    return np.array(list(slices), dtype=np.intp), ends.reshape(-1, 2).T


def average_windows(recordings: Sequence[Recording], samples: Sequence[Indices], algorithm: Average) -> list[Windows]:
    """Average all windows once.

    Parameters
    ----------
    recordings : sequence of Recording
        With samples of one duration, or at the same times.
    samples : sequence of ndarray of int, shape (W, 2)
        Windows of each recording, of equal lengths in all.
    algorithm : "linear" or "overlapping"
    """
    W, columns = len(samples[0]), 3 * len(recordings)
    duration, white, edge = np.empty(W), np.empty(W), np.empty(W)
    gyro, accel, halves = np.empty((W, columns)), np.empty((W, columns)), np.empty((2, W, 2, columns))
    # The motion of a hand is no noise that decreases with the length of a window.
    fixed, density = recordings[0].fixture is not None, np.zeros((2, 2, W, columns))
    rates = recordings[0].kind == "rate"
    interval = recordings[0].interval_s
    both = (side_by_side([getattr(own, sensor) for own in recordings], samples) for sensor in ("gyro", "accel"))
    for (which, gyros), (_, forces) in zip(*both, strict=True):
        n = gyros.shape[1]
        if fixed:
            density[:, :, which] = np.stack([_noise_density(readings) for readings in (gyros, forces)])
        if isinstance(interval, float):
            each = [(slice(None), _weights(np.full(n, interval), algorithm, rates=rates))]
        else:
            steps = (interval[a:b] for a, b in samples[0][which].tolist())
            each = [(slice(w, w + 1), _weights(own, algorithm, rates=rates)) for w, own in enumerate(steps)]
        for part, own in each:
            w = which[part]
            duration[w], white[w], edge[w] = own.duration, own.white, own.edge
            accel[w] = own.mean @ forces[part]
            for h, half in enumerate((slice(None, n // 2), slice(n // 2, None))):
                halves[0, w, h] = own.halves[h] @ gyros[part, half]
                halves[1, w, h] = own.halves[h] @ forces[part, half]
            gyro[w] = own.shares @ halves[0, w]
    per_step = duration / np.diff(samples[0], axis=1)[:, 0]
    density *= (per_step if rates else 1.0 / per_step)[:, None]
    by_unit = (gyro, *halves, accel, *(_excess(*each) for each in density))
    return [
        Windows(own, duration, rate, rates, forces, force, of_gyro, of_accel, white, edge)
        for own, rate, rates, forces, force, of_gyro, of_accel in zip(samples, *map(of_each, by_unit), strict=True)
    ]


def _noise_density(readings: Array) -> Array:
    """Squared random walk of equally long windows, per sample, (w, n, c) to (2, w, c); 0: too few samples.

    It is the median of the squared second differences of means of parts: neither a drift nor a step changes it. The
    second is zero where readings differ by no more than two of their steps, which may be those of rounding.
    """
    count = readings.shape[1] // PARTS
    if count == 0:
        return np.zeros((2, *readings.shape[::2]))
    parts = readings[:, : count * PARTS].reshape(len(readings), PARTS, count, -1).mean(axis=2)
    along = np.ascontiguousarray(np.swapaxes(readings, 1, 2))  # extremes along contiguous axes take a third of the time
    steps, highest, lowest = np.abs(np.diff(along)), along.max(axis=2), along.min(axis=2)
    rounding = _SAME * np.maximum(highest, -lowest).max(axis=0)
    steps[steps <= rounding[:, None]] = np.inf
    bend = np.median(np.diff(parts, n=2, axis=1) ** 2, axis=1)
    density = np.where(bend > rounding**2, bend * count / (6.0 * MEDIAN_OF_SQUARE), 0.0)
    return np.stack([density, np.where(highest - lowest > _ROUNDED * steps.min(axis=2), density, 0.0)])


def _excess(density: Array, dithered: Array) -> Array:
    """Squared random walk of windows beyond the typical one, (W, 3 units); 0 where chance or rounding explains it."""
    few = np.sum(density > 0.0, axis=0) < _FEWEST
    typical = np.nanmedian(np.where(density > 0.0, density, np.where(few, 1.0, np.nan)), axis=0)
    ratio = np.where(few | (dithered == 0.0), 1.0, dithered / typical).reshape(len(density), -1, 3)
    loud = np.repeat(ratio.mean(axis=2) > _LOUD, 3, axis=1)
    return np.where(loud & (ratio.reshape(density.shape) > 1.0), dithered - typical, 0.0)


class _Weights(NamedTuple):
    """Weights of the samples of a window in its mean and in the means of its halves, and figures of the window."""

    mean: Array
    halves: tuple[Array, Array]
    shares: Array
    duration: float
    white: float
    edge: float


def _weights(steps: Array, algorithm: Average, *, rates: bool) -> _Weights:
    average = averaging_weights(len(steps), algorithm)
    # The mean is the integral of density times reading: weights belong to time, not to samples.
    density = average / float(average @ steps)
    parts = steps[: len(steps) // 2], steps[len(steps) // 2 :]
    first, second = ((s if rates else np.ones(len(s))) / s.sum() for s in parts)
    duration = float(steps.sum())
    return _Weights(
        density * steps if rates else density,
        (first, second),
        np.array([s.sum() for s in parts]) / duration,
        duration,
        float(density**2 @ steps),
        float(np.sum(np.diff(density, prepend=0.0, append=0.0) ** 2)),
    )
