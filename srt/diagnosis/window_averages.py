"""Averages inside the stationary windows: block means, noise of single samples, and variance at the start.

All values are rates (rad/s, m/s²) of the six uncompensated channels, gyros first. The checks compare each window with
the other windows; they do not use the stated noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.rotation_readings import MAD, invert_readings, nominal_end_attitude, rates_factor, robust_fit
from srt.noise.noise_model import ACCEL_FLOOR, GYRO_FLOOR
from srt.noise.quantization import quantization_step

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


BLOCKS: Final = 80
"""Number of blocks in a window of median length: a block is 0.125 s in a window of 10 s, about as long as a bump."""
FEWEST_BLOCKS: Final = 12
"""Fewest blocks of a window that is compared with the others."""
HEADS_S: Final = (0.25, 0.5, 1.0, 2.0)
"""Lengths of the part at the start of a window that is searched for an oscillation of the fixture, s."""
GYRO: Final = slice(0, 3)
ACCEL: Final = slice(3, 6)
"""Columns of the gyros and of the accelerometers."""
_SOME_WINDOWS: Final = 6
"""Number of windows from which quantization step and autocorrelation are taken."""
_ENOUGH_HEADS: Final = 4
"""Number of samples used for the autocorrelation in each of these windows, in lengths of the longest start part."""
_RESOLUTION_SAMPLES: Final = 200
"""Number of samples used for the quantization step in each of these windows."""


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
    blocks : ndarray of int, shape (V,)
        Number of blocks of each window.
    count : ndarray of int, shape (V,)
        Number of samples of each window.
    sample_variance : ndarray, shape (V, 6)
        Variance of single samples, from first differences.
    late_variance : ndarray, shape (V, 6)
        Variance of the second half of the window about its own mean.
    heads : ndarray of int, shape (H,)
        Numbers of samples of the start parts, ascending.
    head_power : ndarray, shape (V, H, 6)
        Variance of each start part about its own mean, so that a later tilt does not count as an oscillation.
    head_freedom : ndarray, shape (H, 2)
        Degrees of freedom of that variance, averaged over the three axes of gyros and of accelerometers.
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
    sample_variance: Array
    late_variance: Array
    heads: Indices
    head_power: Array
    head_freedom: Array
    least_variance: Array
    block_doubt: Array


def window_averages(data: PreparedRecording) -> WindowAverages | None:
    """Averages of the windows; None if fewer than four are long enough to be compared."""
    recording, samples = data.recording, data.windows.samples
    dt, per_rate = recording.nominal_interval_s, rates_factor(recording)
    lengths = samples[:, 1] - samples[:, 0]
    size = max(1, int(np.median(lengths)) // BLOCKS)
    chosen = np.flatnonzero(lengths >= FEWEST_BLOCKS * size)
    if len(chosen) < 4:
        return None
    longest = int(np.median(lengths[chosen])) // 4
    heads = np.unique([min(longest, round(head / dt)) for head in HEADS_S])
    heads = heads[heads >= 4]
    if len(heads) == 0:
        return None
    V = len(chosen)
    means: list[Array] = []
    sample, late, power = np.empty((V, 6)), np.empty((V, 6)), np.empty((V, len(heads), 6))
    for v, (a, b) in enumerate(samples[chosen].tolist()):
        n = b - a
        count = n // size
        x = np.empty((n, 6))
        x[:, GYRO], x[:, ACCEL] = recording.gyro[a:b], recording.accel[a:b]
        x *= per_rate
        means.append(np.einsum("bsc->bc", x[: count * size].reshape(count, size, 6)) / size)
        step = x[1:] - x[:-1]
        sample[v] = 0.5 * np.einsum("nc,nc->c", step, step) / (n - 1)
        rest = x[n // 2 :]
        middle = np.einsum("nc->c", rest) / len(rest)
        rest -= middle
        late[v] = np.einsum("nc,nc->c", rest, rest) / len(rest)
        own = np.minimum(heads, n // 2)[:, None]  # a start part is at most half a window
        start = x[: int(own[-1, 0])] - middle
        square, total = (np.cumsum(values, axis=0)[own[:, 0] - 1] for values in (start**2, start))
        power[v] = (square - total**2 / own) / own
    number = np.array([len(m) for m in means])
    pulses = np.repeat([bool(data.noise.gyro_edge.any()), bool(data.noise.accel_edge.any())], 3)
    resolution = _resolution(recording, samples[chosen], pulses)
    floor = np.repeat([GYRO_FLOOR, ACCEL_FLOOR], 3) / np.sqrt(dt)
    typical = np.sqrt(np.median(late, axis=0))
    # The error of a sum of pulse counts is at most one pulse. If the quantization step is larger than the noise, the
    # error of each sample is at most half a step.
    coarse = np.where(pulses, resolution / size, np.where(typical < resolution, 0.5 * resolution, 0.0))
    return WindowAverages(
        window=chosen,
        size=size,
        step_s=size * dt,
        groups=tuple(
            (np.flatnonzero(number == n), np.stack([m for m in means if len(m) == n])) for n in np.unique(number)
        ),
        blocks=number,
        count=lengths[chosen],
        sample_variance=sample,
        late_variance=late,
        heads=heads,
        head_power=power,
        head_freedom=_freedom(recording, samples[chosen], heads),
        least_variance=np.maximum(floor, 0.5 * resolution) ** 2,
        block_doubt=coarse,
    )


def _freedom(recording: Recording, samples: Indices, heads: Indices) -> Array:
    """Degrees of freedom of the variance of the start parts, averaged over three axes, shape (H, 2).

    The variance of n white values has n degrees of freedom. If a filter correlates the values, with autocorrelations
    ρ(k), this number is divided by 1 + 2 Σ (1 − k/n) ρ(k)² (Bartlett's formula). The median of this sum over the
    windows is used, as only few windows have a disturbance.
    """
    some = samples[:: max(1, len(samples) // _SOME_WINDOWS)]
    sums = np.empty((len(some), len(heads), 2))
    for v, (a, b) in enumerate(some.tolist()):
        part = slice(max(a + (b - a) // 2, b - _ENOUGH_HEADS * int(heads[-1])), b)
        x = np.hstack([recording.gyro[part], recording.accel[part]])
        n = len(x)
        spectrum = np.fft.rfft(x - x.mean(axis=0), 2 * n, axis=0)
        covariance = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n, axis=0)[:n]
        rho = covariance[1:] / np.maximum(covariance[0], np.finfo(float).tiny)
        lag_samples = np.arange(1, n)[:, None]
        # For white values, the expected value of ρ(k)² is (n − k) / n².
        square = (rho**2 - (n - lag_samples) / n**2).reshape(n - 1, 2, 3).mean(axis=2)
        sums[v] = np.maximum(1.0 - lag_samples.T / heads[:, None], 0.0) @ square
    return np.asarray(3.0 * heads[:, None] / (1.0 + 2.0 * np.maximum(np.median(sums, axis=0), 0.0)))


def _resolution(recording: Recording, samples: Indices, pulses: Mask) -> Array:
    """Quantization step of the stationary readings as a rate, shape (6,); at least one pulse for pulse counts."""
    some = samples[:: max(1, len(samples) // _SOME_WINDOWS)]
    steps = np.zeros((len(some), 6))
    for v, (a, b) in enumerate(some.tolist()):
        part = slice(a, min(b, a + _RESOLUTION_SAMPLES))
        steps[v] = *quantization_step(recording.gyro[part]), *quantization_step(recording.accel[part])
    # The median over the windows: a disturbed window may show finer steps, and a window of constant readings no step.
    seen = np.where(steps > 0.0, steps, np.nan)
    shown = np.isfinite(seen).any(axis=0)
    out = np.zeros(6)
    out[shown] = np.nanmedian(seen[:, shown], axis=0)
    out *= rates_factor(recording)
    # Corrected readings have finer steps than a pulse, as the correction mixes the pulses of the axes.
    noise = recording.noise
    pulse = (
        np.repeat([noise.gyro_quantization or 0.0, noise.accel_quantization or 0.0], 3) / recording.nominal_interval_s
    )
    return np.where(pulses, np.maximum(out, pulse), out)


def block_sigma(averages: WindowAverages) -> Array:
    """Standard deviation of a block mean, (V, 6): the median over the windows, or that of the window if it is larger.

    It is computed from the median of the differences between successive blocks, which is hardly affected by a drift or
    by a single step.
    """
    own = np.empty((len(averages.window), 6))
    for v, means in averages.groups:
        own[v] = MAD / np.sqrt(2.0) * np.median(np.abs(np.diff(means, axis=1)), axis=1)
    floor = np.sqrt(averages.least_variance) / averages.size
    return np.maximum(np.maximum(own, np.median(own, axis=0)), floor)


def stationary_rate_residual(data: PreparedRecording, gyro: Array) -> Array:
    """Stationary rates less Earth rate, bias and g-sensitivity, the last two fitted; (W, 3), rad/s, B.

    ``gyro`` is the raw matrix of the gyros, shape (3, 3).
    """
    rate = data.windows.gyro_mean - data.noise.gyro_rounding - _earth(data) @ gyro.T
    design = np.hstack([data.windows.accel_mean / data.gravity, np.ones((len(rate), 1))])
    return invert_readings(gyro, rate - design @ robust_fit(design, rate))


def _earth(data: PreparedRecording) -> Array:
    """Earth rate in the nominal attitude of each window, (W, 3), rad/s; zero if the attitude is not known."""
    out = np.zeros((len(data.windows.samples), 3))
    if data.nominal is None:
        return out
    at_start = np.swapaxes(data.nominal, 1, 2) @ data.earth_rate_base() * data.placed[:, None]
    out[data.start] = at_start
    for k, sequence in enumerate(data.catalogue):
        if sequence is not None:
            out[data.end[k]] = nominal_end_attitude(sequence).T @ at_start[k]
    return out
