"""Averages inside the stationary windows: block means, noise of single samples, and variance at the start.

All values are rates (rad/s, m/s²) of the six uncompensated channels, gyros first. No check uses the stated noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.false_alarms import limit, robust_sigma
from srt.diagnosis.triad_fits import LEAST_FREEDOM
from srt.noise.noise_model import ACCEL_FLOOR, GYRO_FLOOR
from srt.noise.quantization import quantization_step, single_precision_step

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask

GYRO: Final = slice(3)
ACCEL: Final = slice(3, None)
"""Columns of the gyros and of the accelerometers."""
_BLOCKS: Final = 80
"""Number of blocks in a window of median length: a block is 0.125 s in a window of 10 s, about as long as a bump."""
_HEADS_S: Final = (0.25, 1.0)
"""Lengths of the part at the start of a window that is searched for an oscillation of the fixture, s."""
_SOME_WINDOWS: Final = 6
"""Number of windows from which quantization step and autocorrelation are taken."""
NOISY: Final = 2.25
"""Smallest ratio of variances of different noise, 1.5 times the standard deviation: less does not matter."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowAverages:
    """Averages of the V windows that are long enough."""

    window: Indices  # number of each window in the prepared data, (V,)
    size: int  # number of samples of a block
    step_s: float  # length of a block
    groups: tuple[tuple[Indices, Array], ...]  # windows with B blocks: numbers from 0 to V - 1, (g,); means (g, B, 6)
    blocks: Indices  # number of blocks of each window, (V,)
    count: Indices  # number of its samples, (V,)
    sigma: Array  # standard deviation of a block mean, (V, 6): median over the windows, or that of the window if larger
    sample_variance: Array  # variance of single samples, from first differences, (V, 6)
    block_variance: Array  # variance of block means, from first differences, (V, 6)
    late_variance: Array  # variance of the second half of the window about its own mean, (V, 6)
    heads: Indices  # numbers of samples of the H start parts, ascending
    head_power: Array  # variance of each start part about its own mean, not to count a later tilt, (V, H, 6)
    head_sign: Array  # share of the excess of the gyros' power in each start part that has one sign per axis, (V, H)
    head_freedom: Array  # its degrees of freedom, averaged over the axes of gyros and of accelerometers, (H, 2)
    step: Array  # quantization step of the readings, (6,)
    pulses: Mask  # True for pulse counts, whose errors do not add up, (6,)
    least_variance: Array  # variance of a sample due to quantization and rounding only, (6,)
    block_doubt: Array  # largest error of a block mean due to pulses or coarse quantization only, (6,)

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


def window_averages(data: PreparedRecording, columns: Array, quantum: Array) -> WindowAverages | None:
    """Averages of the windows; None if fewer than four are long enough to be compared.

    ``columns`` (6, N) are the stored values of all channels, and ``quantum`` (6,) their quantization steps.
    """
    recording, samples = data.recording, data.windows.samples
    dt, per_rate = recording.nominal_interval_s, recording.rates_factor
    lengths = samples[:, 1] - samples[:, 0]
    size = max(1, int(np.median(lengths)) // _BLOCKS)
    chosen = np.flatnonzero(lengths >= LEAST_FREEDOM * size)
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
    power, sign = np.empty((V, len(heads), 6)), np.empty((V, len(heads)))
    for v, (a, b) in enumerate(samples[chosen].tolist()):
        blocks, sample[v], late[v], power[v], sign[v] = _one_window(columns[:, a:b] * per_rate, size, heads)
        means.append(blocks)
    number = np.array([len(m) for m in means])
    groups = tuple(
        (np.flatnonzero(number == n), np.stack([m for m in means if len(m) == n])) for n in np.unique(number)
    )
    for g, table in groups:
        between = np.diff(table, axis=1)
        block[g] = 0.5 * np.mean(between**2, axis=1)
        # The median of the differences is hardly affected by a drift or by a single step.
        sigma[g] = robust_sigma(between, axis=1) / np.sqrt(2.0)
    pulses = np.repeat([bool(data.noise.gyro_edge.any()), bool(data.noise.accel_edge.any())], 3)
    some = samples[chosen][:: max(1, V // _SOME_WINDOWS)]
    step = quantum * per_rate
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
        head_sign=sign,
        head_freedom=_freedom(recording, some, heads),
        step=step,
        pulses=pulses,
        least_variance=least,
        # The error of a sum of pulse counts is at most one pulse. If the quantization step is larger than the noise,
        # the error of each sample is at most half a step.
        block_doubt=np.where(pulses, step / size, np.where(typical < step, 0.5 * step, 0.0)),
    )


def _one_window(x: Array, size: int, heads: Indices) -> tuple[Array, Array, Array, Array, Array]:
    """Block means of readings (6, n), variance of samples, of the second half and of the start parts, and their sign.

    The variance of the start parts has shape (H, 6). The sign is the share of their excess power in the gyros that has
    one sign per axis, (H,).
    """
    n = x.shape[1]
    means = x[:, : n // size * size].reshape(6, -1, size).mean(axis=2).T
    change, second = np.diff(x), x[:, n // 2 :]
    # A start part is at most half a window.
    parts = [x[:, :length] for length in np.minimum(heads, n // 2).tolist()]
    power, late = np.array([part.var(axis=1) for part in parts]), second.var(axis=1)
    left = [part[GYRO] - second[GYRO].mean(axis=1, keepdims=True) for part in parts]
    signed = np.array([np.abs(np.mean(part * np.abs(part), axis=1)).sum() for part in left])
    excess = np.array([np.mean(part**2, axis=1).sum() for part in left]) - late[GYRO].sum()
    sign = np.divide(signed, excess, out=np.zeros_like(signed), where=excess > 0.0)
    return means, 0.5 * np.einsum("cn,cn->c", change, change) / (n - 1), late, power, sign


def _freedom(recording: Recording, samples: Indices, heads: Indices) -> Array:
    """Degrees of freedom of the variance of the start parts, averaged over three axes, shape (H, 2).

    For values with autocorrelations ρ(k), as behind a filter, Bartlett's formula divides their number by
    1 + 2 Σ (1 − k/n) ρ(k)², here the median over the windows, as only few windows have a disturbance.
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


def quantization(data: PreparedRecording, least: Array) -> Array:
    """Quantization step of each channel in stored values, (6,): as stated, and as shown by some windows.

    ``least`` are the smallest steps of all readings. Corrected readings have finer steps than a pulse, as the
    correction mixes the pulses of the axes: a stated pulse is used.
    """
    recording, windows, noise = data.recording, data.windows.samples, data.recording.noise
    parts = [slice(a, (3 * a + b) // 4) for a, b in windows[:: max(1, len(windows) // _SOME_WINDOWS)].tolist()]
    steps = np.array([[*quantization_step(recording.gyro[p]), *quantization_step(recording.accel[p])] for p in parts])
    # The median over the windows: a disturbed window may show finer steps, a window with spikes coarser ones, and a
    # window of constant readings no step.
    seen = np.sort(steps, axis=0)[::-1]
    changes = [np.any(np.diff(np.hstack([recording.gyro[p], recording.accel[p]]), axis=0), axis=0) for p in parts]
    shown = np.maximum(np.count_nonzero(changes, axis=0), 1)
    stated = np.repeat([noise.gyro_quantization or 0.0, noise.accel_quantization or 0.0], 3)
    per_pulse = recording.nominal_interval_s * recording.rates_factor
    single = [single_precision_step(table, windows)[1] for table in (recording.gyro, recording.accel)]
    own = seen[shown // 2, np.arange(6)]
    return np.asarray(np.max([own, stated / per_pulse, least.ravel(), np.concatenate(single)], axis=0))
