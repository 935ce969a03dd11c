"""Spikes: single readings that deviate from their neighbours by far more than the noise around them.

A cubic through the two readings before and the two readings after predicts each reading. If the slopes between these
four readings differ much, the unit moves abruptly, and the reading is not a spike. A bump that rotates the unit within
one sample looks like a spike of the gyros, but the direction of gravity stays rotated by its angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import maximum_filter1d

from srt.diagnosis.rotation_readings import ROUNDING, rates_factor
from srt.noise.noise_model import smallest_step
from srt.noise.quantization import quantization_step

if TYPE_CHECKING:
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_SIGMAS: Final = 7.5
"""Smallest deviation of a spike, in sigma. p = 6e-14 for a known sigma, and p = 2e-11 for a sigma from 500 readings
(known to 10 %): the false-alarm probability is 5e-6 for 300 000 readings, 4e-4 for twenty million."""
_JERK: Final = 3.0
"""Smallest deviation of a spike, in units of the range of the slopes of its neighbours; a step or a kink of the motion
gives at most 1."""
_QUANTILE: Final = (0.9, 1.6449)
"""Quantile of the magnitudes of the deviations from which the noise is taken, as larger ones may be spikes, and that of
a normal distribution, in sigma."""
_FOR_NOISE: Final = 500
"""Number of readings from which the noise of a window or rotation is taken."""
_FEW: Final = 8
"""Number of windows from which the quantization step is taken."""
MISPLACED: Final = 2
"""Fewest windows with rotation from which the labels are wrong, and not the unit disturbed."""
_MEAN_S: Final = 4.0
"""Longest time over which the specific force is averaged before and after a bump, s."""
_SEEN: Final = 3.0
"""Smallest change of gravity due to a bump, in sigma, that the accelerometers can confirm or disprove."""


@dataclass(frozen=True, slots=True, eq=False)
class Spikes:
    """Spikes of one sequence or of a recording.

    Attributes
    ----------
    sample, channel : ndarray of int, shape (n,)
        Number of the sample, and of the channel from 0 to 5: gyro x, y, z, accelerometer x, y, z.
    jump : ndarray, shape (n,)
        Reading less its prediction, in the units of the stored values.
    """

    sample: Indices
    channel: Indices
    jump: Array

    def __getitem__(self, chosen: Mask) -> Spikes:
        return Spikes(self.sample[chosen], self.channel[chosen], self.jump[chosen])

    def of_repeats(self, same: Mask) -> Mask:
        """True for spikes whose sample equals the previous or the next one in all channels; ``same`` is (N - 1,)."""
        return np.asarray(same[self.sample - 1] | same[self.sample])


NO_SPIKES: Final = Spikes(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp), np.zeros(0))


def find_spikes(columns: Array, data: PreparedRecording, contiguous: Mask) -> Spikes:
    """Spikes inside the sequences without a gap, which are the true ones of a mask; bumps are excluded.

    ``columns`` are the readings of all channels, shape (6, N).
    """
    x = columns
    off = np.zeros_like(x)
    inner = off[:, 2:-2]
    np.add(x[:, 1:-3], x[:, 3:-1], out=inner)
    inner *= -4.0
    inner += x[:, :-4]
    inner += x[:, 4:]
    inner /= 6.0
    inner += x[:, 2:-2]
    size, windows, sequences = np.abs(off), data.windows.samples, np.flatnonzero(contiguous)
    start, end = windows[data.start[sequences]], windows[data.end[sequences]]
    spans = np.concatenate([start + np.array([2, 0]), end - np.array([0, 2]), data.rotation[sequences]])
    spans = spans[spans[:, 1] - spans[:, 0] >= 4]
    if len(spans) == 0:
        return NO_SPIKES
    noise = np.array([_noise(size[:, a:b]) for a, b in spans.tolist()])
    # In rotations, saturated readings or evenly spaced pulses hardly scatter. The median excludes disturbed windows.
    least = np.maximum(np.median(noise[: 2 * len(sequences)], axis=0), _step(columns, data))
    limits = _SIGMAS * np.maximum(noise, np.maximum(least, ROUNDING * np.abs(x).max(axis=1)))
    found = [
        np.argwhere(size[:, a:b] > own[:, None]) + np.array([0, a])
        for (a, b), own in zip(spans.tolist(), limits, strict=True)
    ]
    channel, sample = np.concatenate(found).T
    alone = np.ones(len(sample), dtype=np.bool_)
    if data.recording.fixture is None:
        # Rotations by hand include bumps, as when the unit is set down, but those move more than one channel.
        loud, turning = np.zeros(x.shape, dtype=np.bool_), np.zeros(x.shape[1], dtype=np.bool_)
        loud[channel, sample] = True
        for a, b in data.rotation[sequences].tolist():
            turning[a:b] = True
        alone = ~turning[sample] | (maximum_filter1d(loud, 5, axis=1)[:, sample].sum(axis=0) == 1)
    slopes = np.diff(x[channel[:, None], sample[:, None] + (-2, -1, 1, 2)]) * (1.0, 0.5, 1.0)
    jump = off[channel, sample]
    keep = alone & (np.abs(jump) > _JERK * np.ptp(slopes, axis=1))
    there = Spikes(sample[keep], channel[keep], jump[keep])
    bump = [_is_bump(columns, data, int(i), there) for i in there.sample]
    return there[~np.array(bump, dtype=np.bool_)]


def _noise(size: Array) -> Array:
    """Standard deviation of each channel, from a quantile of the magnitudes ``size``."""
    some = size[:, :: max(1, size.shape[1] // _FOR_NOISE)]
    rank = int(_QUANTILE[0] * (some.shape[1] - 1))
    return np.asarray(np.partition(some, rank, axis=1)[:, rank] / _QUANTILE[1])


def _step(columns: Array, data: PreparedRecording) -> Array:
    """Quantization step of each channel, shape (6,): as stated, and as shown by some windows or the whole recording.

    Corrected readings have finer steps, as the correction mixes the pulses of the axes: a stated pulse is used.
    """
    noise, windows = data.recording.noise, data.windows.samples
    per_pulse = 1.0 / (data.recording.nominal_interval_s * rates_factor(data.recording))
    stated = np.repeat([noise.gyro_quantization or 0.0, noise.accel_quantization or 0.0], 3) * per_pulse
    some = [columns[:, a : min(b, a + _FOR_NOISE)].T for a, b in windows[:: max(1, len(windows) // _FEW)].tolist()]
    shown = np.median([quantization_step(part) for part in some], axis=0)
    return np.asarray(np.max([stated, shown, smallest_step(columns[:, :: columns.shape[1] // 4000 + 1].T)], axis=0))


def _is_bump(columns: Array, data: PreparedRecording, at: int, there: Spikes) -> bool:
    """True if a spike of the gyros in a window is a bump: gravity stays rotated by its angle.

    If the accelerometers cannot measure this angle, a spike of several gyros counts as a bump.
    """
    own = there.sample == at
    window = next((w for w in data.windows.samples.tolist() if w[0] <= at < w[1]), None)
    if window is None or np.any(there.channel[own] >= 3):
        return False
    dt = data.recording.nominal_interval_s
    most = max(1, round(_MEAN_S / dt))
    before, after = columns[3:, max(window[0], at - most) : at], columns[3:, at + 1 : min(window[1], at + 1 + most)]
    fewest = min(before.shape[1], after.shape[1])
    several = len(np.unique(there.channel[own])) > 1
    if fewest < 2:
        return several
    mean, angle = before.mean(axis=1), np.zeros(3)
    change = after.mean(axis=1) - mean
    noise = np.std(np.diff(before), axis=1) / np.sqrt(fewest)
    angle[there.channel[own]] = there.jump[own] * rates_factor(data.recording) * dt
    turned = np.cross(mean, angle)
    square = float(turned @ turned)
    if square < _SEEN * float(np.linalg.norm(noise * turned)):
        return several
    return bool(change @ turned > 0.5 * square)
