"""Averages inside the stationary windows: block means, noise of single samples, and variance at the start.

All values are rates (rad/s, m/s²) of the six uncompensated channels, gyros first. The checks compare each window with
the other windows; they do not use the stated noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.false_alarms import limit
from srt.diagnosis.rotation_readings import MAD, rates_factor
from srt.noise.noise_model import ACCEL_FLOOR, GYRO_FLOOR
from srt.noise.quantization import quantization_step

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask

GYRO: Final = slice(3)
ACCEL: Final = slice(3, None)
"""Columns of the gyros and of the accelerometers."""
_BLOCKS: Final = 80
"""Number of blocks in a window of median length: a block is 0.125 s in a window of 10 s, about as long as a bump."""
_FEWEST_BLOCKS: Final = 12
"""Fewest blocks of a window that is compared with the others."""
_HEADS_S: Final = (0.25, 1.0)
"""Lengths of the part at the start of a window that is searched for an oscillation of the fixture, s."""
_SOME_WINDOWS: Final = 6
"""Number of windows from which quantization step and autocorrelation are taken."""
NOISY: Final = 2.25
"""Smallest ratio of variances of different noise, 1.5 times the standard deviation: less does not matter."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowAverages:
    """Averages of the V windows that are long enough.

    Attributes
    ----------
    window : ndarray of int, shape (V,)
        Number of each window in the prepared data.
    size : int
        Number of samples of a block.
    step_s : float
        Length of a block.
    groups : tuple of (ndarray of int, shape (g,), and ndarray, shape (g, B, 6))
        Windows with the same number B of blocks: their numbers from 0 to V - 1, and their block means.
    blocks, count : ndarray of int, shape (V,)
        Number of blocks and of samples of each window.
    sigma : ndarray, shape (V, 6)
        Standard deviation of a block mean: the median over the windows, or that of the window if it is larger.
    sample_variance, block_variance : ndarray, shape (V, 6)
        Variance of single samples and of block means, from first differences.
    late_variance : ndarray, shape (V, 6)
        Variance of the second half of the window about its own mean.
    heads : ndarray of int, shape (H,)
        Numbers of samples of the start parts, ascending.
    head_power : ndarray, shape (V, H, 6)
        Variance of each start part about its own mean, so that a later tilt does not count as an oscillation.
    head_freedom : ndarray, shape (H, 2)
        Degrees of freedom of that variance, averaged over the three axes of gyros and of accelerometers.
    step : ndarray, shape (6,)
        Quantization step of the readings; at least one pulse for pulse counts.
    pulses : ndarray of bool, shape (6,)
        True for pulse counts, whose errors do not add up.
    least_variance : ndarray, shape (6,)
        Variance of a sample due to quantization and rounding only.
    block_doubt : ndarray, shape (6,)
        Largest error of a block mean due to pulses or coarse quantization only.
    """

    window: Indices
    size: int
    step_s: float
    groups: tuple[tuple[Indices, Array], ...]
    blocks: Indices
    count: Indices
    sigma: Array
    sample_variance: Array
    block_variance: Array
    late_variance: Array
    heads: Indices
    head_power: Array
    head_freedom: Array
    step: Array
    pulses: Mask
    least_variance: Array
    block_doubt: Array

    def relative_noise(self) -> tuple[Array, Array]:
        """Variance of samples and of blocks, by gyros and accelerometers, relative to the other windows; its limit.

        Statistic: variance from first differences, averaged over three axes, over its median, shape (2, 2, V).
        Distribution: chi-square over its degrees of freedom, two for each value (2/3 for each axis); limit (2, 1, V).
        """
        variance = np.stack([self.sample_variance, self.block_variance])
        floor = np.stack([2.0 * self.least_variance, self.least_variance / self.size**2 + self.block_doubt**2])
        ratio = variance / np.maximum(np.median(variance, axis=1), floor)[:, None]
        power = np.swapaxes(ratio.reshape(2, -1, 2, 3).mean(axis=3), 1, 2)
        freedom = 2.0 * np.stack([self.count, self.blocks])[:, None]
        return power, np.maximum(NOISY, limit("chi-square", freedom, tests=power.size) / freedom)


def window_averages(data: PreparedRecording) -> WindowAverages | None:
    """Averages of the windows; None if fewer than four are long enough to be compared."""
    recording, samples = data.recording, data.windows.samples
    dt, per_rate = recording.nominal_interval_s, rates_factor(recording)
    lengths = samples[:, 1] - samples[:, 0]
    size = max(1, int(np.median(lengths)) // _BLOCKS)
    chosen = np.flatnonzero(lengths >= _FEWEST_BLOCKS * size)
    if len(chosen) < 4:
        return None
    quarter = int(np.median(lengths[chosen])) // 4
    heads = np.unique([min(quarter, round(head / dt)) for head in _HEADS_S])
    heads = heads[heads >= 4]
    if len(heads) == 0:
        return None
    V = len(chosen)
    means: list[Array] = []
    sample, block, late, sigma = np.empty((4, V, 6))
    power = np.empty((V, len(heads), 6))
    for v, (a, b) in enumerate(samples[chosen].tolist()):
        x = np.concatenate([recording.gyro[a:b], recording.accel[a:b]], axis=1)
        x *= per_rate
        blocks, sample[v], late[v], power[v] = _one_window(x, size, heads)
        means.append(blocks)
    number = np.array([len(m) for m in means])
    groups = tuple(
        (np.flatnonzero(number == n), np.stack([m for m in means if len(m) == n])) for n in np.unique(number)
    )
    for g, table in groups:
        between = np.diff(table, axis=1)
        block[g] = 0.5 * np.mean(between**2, axis=1)
        # The median of the differences is hardly affected by a drift or by a single step.
        sigma[g] = MAD / np.sqrt(2.0) * np.median(np.abs(between), axis=1)
    pulses = np.repeat([bool(data.noise.gyro_edge.any()), bool(data.noise.accel_edge.any())], 3)
    some = samples[chosen][:: max(1, V // _SOME_WINDOWS)]
    step = _quantization(recording, some, quarter, pulses)
    typical = np.sqrt(np.median(late, axis=0))
    least = np.maximum(np.repeat([GYRO_FLOOR, ACCEL_FLOOR], 3) / np.sqrt(dt), 0.5 * step) ** 2
    return WindowAverages(
        window=chosen,
        size=size,
        step_s=size * dt,
        groups=groups,
        blocks=number,
        count=lengths[chosen],
        sigma=np.maximum(np.maximum(sigma, np.median(sigma, axis=0)), np.sqrt(least) / size),
        sample_variance=sample,
        block_variance=block,
        late_variance=late,
        heads=heads,
        head_power=power,
        head_freedom=_freedom(recording, some, heads),
        step=step,
        pulses=pulses,
        least_variance=least,
        # The error of a sum of pulse counts is at most one pulse. If the quantization step is larger than the noise,
        # the error of each sample is at most half a step.
        block_doubt=np.where(pulses, step / size, np.where(typical < step, 0.5 * step, 0.0)),
    )


def _one_window(x: Array, size: int, heads: Indices) -> tuple[Array, Array, Array, Array]:
    """Block means of readings (n, 6), variance of samples, of the second half, and of the start parts (H, 6)."""
    n = len(x)
    means = np.einsum("bsc->bc", x[: n // size * size].reshape(-1, size, 6)) / size
    change = x[1:] - x[:-1]
    x = x - np.einsum("nc->c", x[n // 2 :]) / (n - n // 2)
    power = np.empty((len(heads), 6))
    for h, length in enumerate(np.minimum(heads, n // 2).tolist()):  # a start part is at most half a window
        start = x[:length]
        square, total = np.einsum("nc,nc->c", start, start), np.einsum("nc->c", start)
        power[h] = (square - total**2 / length) / length
    late = np.einsum("nc,nc->c", x[n // 2 :], x[n // 2 :]) / (n - n // 2)
    return means, 0.5 * np.einsum("nc,nc->c", change, change) / (n - 1), late, power


def _freedom(recording: Recording, samples: Indices, heads: Indices) -> Array:
    """Degrees of freedom of the variance of the start parts, averaged over three axes, shape (H, 2).

    The variance of n white values has n degrees of freedom. If a filter correlates the values, with autocorrelations
    ρ(k), this number is divided by 1 + 2 Σ (1 − k/n) ρ(k)² (Bartlett's formula). The median of this sum over the
    windows is used, as only few windows have a disturbance.
    """
    sums = np.empty((len(samples), len(heads), 2))
    for v, (a, b) in enumerate(samples.tolist()):
        part = slice((a + b) // 2, b)
        x = np.hstack([recording.gyro[part], recording.accel[part]])
        n = len(x)
        spectrum = np.fft.rfft(x - x.mean(axis=0), 2 * n, axis=0)
        covariance = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n, axis=0)[:n]
        rho = covariance[1:] / np.maximum(covariance[0], np.finfo(float).tiny)
        lag = np.arange(1, n)[:, None]
        # For white values, the expected value of ρ(k)² is (n − k) / n².
        square = (rho**2 - (n - lag) / n**2).reshape(n - 1, 2, 3).mean(axis=2)
        sums[v] = np.maximum(1.0 - lag.T / heads[:, None], 0.0) @ square
    return np.asarray(3.0 * heads[:, None] / (1.0 + 2.0 * np.maximum(np.median(sums, axis=0), 0.0)))


def _quantization(recording: Recording, samples: Indices, most: int, pulses: Mask) -> Array:
    """Quantization step of the first readings of windows as a rate, shape (6,); at least one pulse for pulse counts."""
    parts = [slice(a, min(b, a + most)) for a, b in samples.tolist()]
    steps = np.array([[*quantization_step(recording.gyro[p]), *quantization_step(recording.accel[p])] for p in parts])
    # The median over the windows: a disturbed window may show finer steps, and a window of constant readings no step.
    seen = np.sort(steps, axis=0)[::-1]
    shown = np.maximum(np.count_nonzero(steps, axis=0), 1)
    found: Array = seen[shown // 2, np.arange(6)] * rates_factor(recording)
    # Corrected readings have finer steps than a pulse, as the correction mixes the pulses of the axes.
    stated = np.repeat([recording.noise.gyro_quantization or 0.0, recording.noise.accel_quantization or 0.0], 3)
    return np.where(pulses, np.maximum(found, stated / recording.nominal_interval_s), found)
