"""Averages of the stationary windows, computed once, and the weights of the two averaging algorithms.

Only means are compensated: compensation of single samples would rectify their noise through the asymmetry term. If the
attitude is constant in the windows, the iterations need no other data of the windows than these means.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.types import Array, Indices


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
    white_factor: Array
    edge_factor: Array


def average_windows(recording: Recording, samples: Indices, algorithm: Average) -> Windows:
    """Average all windows once.

    Parameters
    ----------
    recording : Recording
    samples : ndarray of int, shape (W, 2)
    algorithm : "linear" or "overlapping"
    """
    W = len(samples)
    duration, white, edge = np.empty(W), np.empty(W), np.empty(W)
    gyro, accel, halves = np.empty((W, 3)), np.empty((W, 3)), np.empty((2, W, 2, 3))
    rates = recording.kind == "rate"
    interval = recording.interval_s
    cache: dict[int, Array] = {}
    for w, (a, b) in enumerate(samples.tolist()):
        n, middle = b - a, (a + b) // 2
        steps = np.full(n, interval) if isinstance(interval, float) else interval[a:b]
        duration[w] = steps.sum()
        if n not in cache:
            cache[n] = averaging_weights(n, algorithm)
        # The mean is the integral of density times reading: weights belong to time, not to samples.
        density = cache[n] / float(cache[n] @ steps)
        accel[w] = (density * steps if rates else density) @ recording.accel[a:b]
        first, second = steps[: middle - a], steps[middle - a :]
        for h, (lo, hi, s) in enumerate(((a, middle, first), (middle, b, second))):
            per_sample = (s if rates else np.ones(hi - lo)) / s.sum()
            halves[0, w, h] = per_sample @ recording.gyro[lo:hi]
            halves[1, w, h] = per_sample @ recording.accel[lo:hi]
        gyro[w] = (halves[0, w, 0] * first.sum() + halves[0, w, 1] * second.sum()) / duration[w]
        white[w] = float(density**2 @ steps)
        edge[w] = float(np.sum(np.diff(density, prepend=0.0, append=0.0) ** 2))
    return Windows(samples, duration, gyro, halves[0], halves[1], accel, white, edge)
