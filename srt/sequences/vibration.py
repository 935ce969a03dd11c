"""Vibration in the stationary windows: a line of the spectrum at one frequency, and its effect on means and rotations.

A vibrating unit is stationary on average. Three effects remain. The attitude at the edge of a window, where a rotation
begins or ends, differs from the mean attitude of the window by the angle of the vibration at that time. A window does
not hold whole periods. And asymmetry rectifies the vibration of a channel that is otherwise at rest: the mean of
``|m + A sin u|`` exceeds ``|m|`` if A does. They follow from amplitude and phase in the windows, and are removed. In
the rotations every sample is compensated by its sign; changes of sign within a sample are neglected.

Detection: a bin of the spectrum stands out in a window if the power of a channel over the mean power of the
neighbouring bins is large. Means of both sides are taken and the larger one counts, so that the slopes of filtered
readings are no lines. The ratio to one side is an F-ratio with 2 and 2 n degrees of freedom, and that to the larger one
does not exceed it. It is a line if it stands out in more than half of the windows, or further in more than a quarter.
The probability of that for any bin and sensor of a recording with smooth spectra is at most :data:`FALSE_ALARM`
(Bonferroni's inequality and the binomial distribution).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import betaincinv, fdtri

from srt.noise.quantization import smallest_step, thinned
from srt.recording.readings import six_channels
from srt.sequences.window_means import averaging_weights

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.model.sensor_model import Triad
    from srt.noise.noise_model import NoiseModel
    from srt.recording.recording import Recording
    from srt.sequences.window_means import Average
    from srt.types import Array, Indices


FALSE_ALARM: Final = 4e-6
"""Probability of a line in a recording without vibration: one of the tests that make 1e-4 together."""
_NEIGHBOURS: Final = 8
"""Bins on one side whose mean is the power without a line: few, as filtered readings have lobes of 20 bins."""
_LOWEST: Final = 10
"""Lowest bin that is tested: slower motion is drift or creep."""
_SHARES: Final = (2, 4)
"""Windows of which more than one has the line: what runs for a time only is in some of them."""
_FEWEST_SAMPLES: Final = 256
"""Samples of a window from which the spectrum of its second half has enough bins."""
_FEWEST_WINDOWS: Final = 4
"""Windows from which a line is told."""
_REFINED: Final = 81
_REFINED_BINS: Final = 2.0
"""Number of frequencies tried, and bins on either side of the line; that with the most power is taken."""
_DITHERED: Final = 2.0
"""Random walk over a window, in quantization steps, from which pulses have no line: it would be 20 bins wide. Pulses of
a quieter unit at rest are periodic, with an amplitude of less than one step."""
_PERIODS: Final = 3.0
"""Periods next to an edge that give the amplitude there, and its growth. Their noise is 0.3 / √(f T) of that of a
rotation by angle random walk."""
_BESIDE: Final = np.array([-6, -5, -4, -3, 3, 4, 5, 6])
"""Bins beside the line whose mean power is that of the noise: those next to it have a part of the line."""
_SEEN: Final = 1e-3
"""Probability that the noise of a triad passes for a line at the frequency of one that was found."""
_ONE: Final = 0.9
"""Share of the power from which a line has one direction in the unit: over the poses of a test, a direction in the room
has two thirds at most."""
_PIECE: Final = 1 << 13
"""Samples of windows whose spectra are computed together: they fit into a processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Vibration:
    """Line at one frequency.

    Attributes
    ----------
    gyro, accel : ndarray of complex, shape (W, 3), rad/s and m/s²
        Amplitude of the raw channels in every window, with the phase at the first sample.
    edges : ndarray of complex, shape (W, 2, 3), rad/s
        That of the gyros at the first and at the last edge of every window: a line may grow, decay or pause.
    beside : ndarray, shape (6,)
        Mean power of the six channels at the neighbouring frequencies, as squared amplitude: their noise.
    interval_s : float
        Sampling interval. Readings are means over it, which attenuates the amplitude.
    """

    frequency_hz: float
    gyro: Any
    accel: Any
    edges: Any
    beside: Array
    interval_s: float

    @property
    def _half_step(self) -> float:
        """Half the phase of a sampling interval, rad."""
        return float(np.pi * self.frequency_hz * self.interval_s)

    def amplitude(self, sensor: str, triad: Triad) -> Array:
        """Amplitude of the compensated channels, not attenuated by the sampling, shape (W, 3), rad/s or m/s²."""
        raw = self.gyro if sensor == "gyro" else self.accel
        attenuation = np.sinc(self._half_step / np.pi)
        return np.asarray(np.abs(raw @ triad.inverse.T) / attenuation)

    def of_unit(self, force: Array) -> tuple[str, Array] | None:
        """Sensor that alone shows the line, and in one direction of the unit, with the share of each channel, (3,).

        None if both sensors show it, or if its direction in the unit changes. Motion of what carries the unit keeps its
        direction in the room, and tilts the accelerometers against gravity. Statistic: power of a triad over that
        beside the line. Distribution: F.

        Parameters
        ----------
        force : ndarray, shape (W, 3), m/s²
            Mean specific force: where gravity has one direction in the unit, too, all windows have one attitude.
        """
        count = len(force)
        limit = fdtri(6 * count, 6 * count * len(_BESIDE), 1.0 - _SEEN)
        noise = np.maximum(self.beside, np.finfo(float).tiny)
        power = np.mean(np.abs(np.hstack([self.gyro, self.accel])) ** 2, axis=0)
        by_gyros, by_accels = (power / noise).reshape(2, 3).mean(axis=1) > limit
        if by_gyros == by_accels or _has_one_direction(force.T @ force):
            return None
        sensor, line, at = ("gyro", self.gyro, slice(3)) if by_gyros else ("accel", self.accel, slice(3, 6))
        if not _has_one_direction(line.conj().T @ line / count - np.diag(noise[at])):
            return None
        own = np.maximum(power[at] - noise[at], 0.0)
        return sensor, own / own.sum()

    def angles(self, samples: Indices) -> Array:
        """Raw angle at the first and last edge of every window less its mean over the window, shape (W, 2, 3), rad."""
        step = 2.0 * self._half_step
        n = samples[:, 1] - samples[:, 0]
        # θ(k) − θ(k−1) is the increment of sample k, Re(Z exp(i step (k − 1)) dt) with k = 1 the first sample.
        per_rate = self.interval_s / (2j * np.sin(0.5 * step)) * np.exp(-0.5j * step)
        edges = np.exp(1j * step * np.stack([np.zeros(len(n)), n], axis=1))
        # The mean over the window of exp(i step k) for k from 0 to n, between the edges.
        mean = np.exp(0.5j * step * n) * np.sinc(0.5 * step * n / np.pi)
        angle = edges[:, :, None] * self.edges - (mean[:, None] * self.gyro)[:, None]
        return np.asarray((angle * per_rate).real)

    def removed(self, recording: Recording, samples: Indices) -> Recording:
        """Recording whose windows lack the line, shape (W, 2) of ``samples``: what is left of them is noise."""
        gyro, accel = recording.gyro.copy(), recording.accel.copy()
        for (a, b), of_gyro, of_accel in zip(samples.tolist(), self.gyro, self.accel, strict=True):
            turns = np.exp(2j * self._half_step * np.arange(b - a))[:, None] / recording.rates_factor
            gyro[a:b] -= (turns * of_gyro).real
            accel[a:b] -= (turns * of_accel).real
        return replace(recording, gyro=gyro, accel=accel)

    def means(self, samples: Indices, average: Average) -> tuple[Array, Array]:
        """Mean of the raw line over every window, (W, 3): gyros, and accelerometers by the averaging algorithm.

        It is small, but not zero unless the window holds whole periods.
        """
        step, out = 2.0 * self._half_step, np.empty((2, len(samples)), dtype=np.complex128)
        for w, n in enumerate((samples[:, 1] - samples[:, 0]).tolist()):
            turns = np.exp(1j * step * np.arange(n))
            out[:, w] = turns.mean(), averaging_weights(n, average) @ turns
        return (out[0][:, None] * self.gyro).real, (out[1][:, None] * self.accel).real


def _has_one_direction(power: Any) -> bool:
    """True if the largest eigenvalue of the power of three channels, (3, 3), has nearly all of it."""
    size = np.maximum(np.linalg.eigvalsh(power), 0.0)
    return bool(size[-1] > _ONE * size.sum())


def rectified(mean: Array, amplitude: Array) -> Array:
    """Mean of ``|m + A sin u|`` over u less ``|m|``, elementwise."""
    size = np.maximum(amplitude, np.finfo(float).tiny)
    x = np.minimum(np.abs(mean) / size, 1.0)
    return np.asarray(size * (2.0 / np.pi * (np.sqrt(1.0 - x**2) + x * np.arcsin(x)) - x))


def vibration(recording: Recording, samples: Indices, noise: Callable[[], NoiseModel]) -> Vibration | None:
    """Find the strongest line in the windows; None if there is none.

    Parameters
    ----------
    samples : ndarray of int, shape (W, 2)
        First sample of every window and one past the last.
    noise : callable
        Gives the noise of the unit, if a line is found: one below one quantization step may be that of the pulses.
    """
    length = samples[:, 1] - samples[:, 0]
    chosen = samples[length >= max(_FEWEST_SAMPLES, int(np.median(length)) // 2)]
    if len(chosen) < _FEWEST_WINDOWS:
        return None
    # The second halves: what decays after a rotation is no vibration.
    n, dt = int((chosen[:, 1] - chosen[:, 0]).min()) // 2, recording.nominal_interval_s
    found = []
    for sensor in ("gyro", "accel"):
        table = getattr(recording, sensor)
        # Some windows after the others: spectra of all at once would take more memory than the recording.
        ends, together = chosen[:, 1].tolist(), max(1, _PIECE // n)
        groups = (ends[i : i + together] for i in range(0, len(ends), together))
        each = [_spectra(np.stack([table[b - n : b] for b in group]) * recording.rates_factor) for group in groups]
        power, ratio = (np.concatenate(spectra) for spectra in zip(*each, strict=True))
        tests = 2 * len(_SHARES) * (ratio.shape[1] - _LOWEST)
        ratio, power = np.sort(ratio, axis=0), np.sort(power, axis=0)
        rows = np.array([-(len(chosen) // share + 1) for share in _SHARES])
        beyond = ratio[rows] / np.array([[_limit(len(chosen), tests, share)] for share in _SHARES])
        # The share of the windows by which a bin exceeds its limit the furthest.
        stands_out, row = beyond.max(axis=0) > 1.0, rows[np.argmax(beyond, axis=0)]
        stands_out[:_LOWEST] = False
        if not stands_out.any():
            continue
        # Amplitude of the integral, angle or velocity, of all channels.
        bins = np.arange(ratio.shape[1])
        size = np.sqrt(power[row, bins]) * 2.0 / n / (2.0 * np.pi * np.maximum(bins, 1) / (n * dt))
        walk, step = getattr(noise(), f"{sensor}_white") * np.sqrt(n * dt), _step(recording, sensor, chosen)
        stands_out &= size > np.where(walk < _DITHERED * step, step, 0.0).max()
        if stands_out.any():
            score = np.where(stands_out, ratio[row, bins], 0.0)
            found.append((float(score.max()), int(np.argmax(score))))
    if not found:
        return None
    frequency = _refined(recording, chosen, 2 * n, 2 * max(found)[1])
    return Vibration(frequency, *_fitted(recording, samples, frequency), dt)


def _step(recording: Recording, sensor: str, windows: Indices) -> Array:
    """Quantization step of angle or velocity, as stated or else the smallest between readings at rest, shape (3,)."""
    stated = getattr(recording.noise, f"{sensor}_quantization")
    if stated is not None:
        return np.full(3, stated)
    step = smallest_step(thinned(getattr(recording, sensor), windows))
    return step * recording.nominal_interval_s * recording.rates_factor


def _limit(windows: int, tests: int, one_in: int) -> float:
    """F-ratio above which a bin stands out in a window, for a false-alarm probability over all windows and tests."""
    # More than k of the windows: the tail of the binomial distribution is an incomplete beta function.
    k = windows // one_in
    each = float(betaincinv(k + 1, windows - k, FALSE_ALARM / tests))
    # Any of the three channels of a window. With 2 and 2 m degrees of freedom, P(F > t) = (1 + t / m)^−m.
    single, m = each / 3.0, float(_NEIGHBOURS)
    return float(m * (single ** (-1.0 / m) - 1.0))


def _spectra(x: Array) -> tuple[Array, Array]:
    """Power of detrended windows (..., n, 3), all channels together, and its largest ratio to neighbours, (..., F)."""
    x = np.ascontiguousarray(np.swapaxes(x, -1, -2))
    n = x.shape[-1]
    time = np.arange(n) - 0.5 * (n - 1)
    x -= x.mean(axis=-1, keepdims=True)
    x -= (x @ (time / (time @ time)))[..., None] * time
    spectrum = np.fft.rfft(x)
    power = spectrum.real**2 + spectrum.imag**2
    # The spectrum of sampled readings is even about its end; bins 0 and 1 lost their power with the trend.
    mirrored = np.concatenate([power, power[..., -2 : -2 - _NEIGHBOURS - 1 : -1]], axis=-1)
    total = np.zeros((*mirrored.shape[:-1], mirrored.shape[-1] + 1))
    np.cumsum(mirrored, axis=-1, out=total[..., 1:])
    k = np.arange(power.shape[-1])
    sides = []
    # The line itself reaches into the next bins.
    for first, last in ((np.maximum(k - 1 - _NEIGHBOURS, 2), k - 1), (k + 2, k + 2 + _NEIGHBOURS)):
        sides.append((total[..., np.maximum(last, first)] - total[..., first]) / np.maximum(last - first, 1))
    level = np.maximum(*sides)
    ratio = np.divide(power, level, out=np.zeros_like(power), where=level > 0.0)
    if n % 2 == 0:
        ratio[..., -1] = 0.0  # half the sampling rate: one degree of freedom, and no phase
    return power.sum(axis=-2), ratio.max(axis=-2)


def _refined(recording: Recording, windows: Indices, n: int, k: int) -> float:
    """Frequency near bin k of windows of n samples with the most power in all channels, each over its own, Hz."""
    f = (k + np.linspace(-_REFINED_BINS, _REFINED_BINS, _REFINED)) / n
    turns = np.exp(-2j * np.pi * np.multiply.outer(f, np.arange(n)))
    total = np.zeros(_REFINED)
    for a, _ in windows.tolist():
        x = six_channels(recording, slice(a, a + n))
        x = x - x.mean(axis=0)
        own = np.maximum(np.sum(x**2, axis=0), np.finfo(float).tiny)
        total += np.sum(np.abs(turns @ x) ** 2 / own, axis=1)
    # The top of the parabola through the three largest: the step between frequencies would leave part of the line.
    top = int(np.clip(np.argmax(total), 1, _REFINED - 2))
    before, at, after = total[top - 1 : top + 2]
    curvature = min(before - 2.0 * at + after, -np.finfo(float).tiny)
    beside = float(np.clip(0.5 * (before - after) / curvature, -1.0, 1.0))
    return float((f[top] + beside * (f[1] - f[0])) / recording.nominal_interval_s)


def _fitted(recording: Recording, samples: Indices, frequency_hz: float) -> tuple[Any, Any, Any, Array]:
    """Complex amplitude of the raw channels in every window, (W, 3), of the gyros at its edges, (W, 2, 3), and noise.

    The noise is the mean power of the six channels beside the line, (6,).
    """
    step = 2.0 * np.pi * frequency_hz * recording.nominal_interval_s
    out, edges = np.empty((len(samples), 6), dtype=np.complex128), np.empty((len(samples), 2, 3), dtype=np.complex128)
    near, power = int(np.ceil(_PERIODS * 2.0 * np.pi / step)), np.zeros(6)
    for w, (a, b) in enumerate(samples.tolist()):
        x, phase = six_channels(recording, slice(a, b)), step * np.arange(b - a)
        out[w] = _amplitude(x, phase)
        others = phase + np.multiply.outer(2.0 * np.pi * _BESIDE, np.arange(b - a) / (b - a))
        power += np.mean([np.abs(_amplitude(x, other)) ** 2 for other in others], axis=0) / len(samples)
        if 2 * near > b - a:
            edges[w] = out[w, :3]
            continue
        away = np.arange(near) / near
        edges[w, 0] = _amplitude(x[:near, :3], phase[:near], away)
        edges[w, 1] = _amplitude(x[-near:, :3], phase[-near:], away[::-1])
    return out[:, :3], out[:, 3:], edges, power


def _amplitude(x: Array, phase: Array, growth: Array | None = None) -> Any:
    """Complex amplitude of columns (n, c) by least squares with a constant and a trend; where ``growth`` is 0, (c,)."""
    wave, trend = np.column_stack([np.cos(phase), np.sin(phase)]), np.linspace(-0.5, 0.5, len(x))
    growing = () if growth is None else (growth[:, None] * wave,)
    c = np.linalg.lstsq(np.column_stack([wave, np.ones(len(x)), trend, *growing]), x)[0]
    return c[0] - 1j * c[1]
