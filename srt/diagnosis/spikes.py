"""Spikes: single readings that deviate from their neighbours by far more than the noise around them.

A cubic through the two readings before and the two readings after predicts each reading. If the slopes between these
four readings differ much, the unit moves abruptly, and the reading is not a spike. A bump that rotates the unit within
one sample looks like a spike of the gyros, but the direction of gravity stays rotated by its angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.rotation_readings import ROUNDING, rates_factor
from srt.noise.quantization import quantization_step

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_SIGMAS: Final = 7.5
"""Smallest deviation of a spike, in sigma. p = 6e-14 for a known sigma, and p = 2e-11 for a sigma from 500 readings
(known to 10 %): the false-alarm probability is 5e-6 for 300 000 readings, 4e-4 for twenty million."""
_JERK: Final = 3.0
"""Smallest deviation of a spike, in units of the range of the slopes of its neighbours; a step or a kink of the motion
gives at most 1."""
_QUANTILE: Final = 0.9
"""Quantile of the magnitudes of the deviations from which the noise is taken: larger ones may be spikes."""
_NORMAL: Final = 1.6449
"""The same quantile for a normal distribution, in sigma."""
_FOR_NOISE: Final = 500
"""Number of readings from which the noise of a window or rotation is taken."""
_FEW: Final = 8
"""Number of windows from which the quantization step is taken."""
_FOR_STEP: Final = 4000
"""Number of readings of the whole recording from which the step is taken if the windows do not show it."""
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

    def of_repeats(self, recording: Recording) -> Mask:
        """True for spikes whose sample equals the previous or the next one in all channels, shape (n,)."""
        same = np.all(np.diff(recording.gyro, axis=0) == 0.0, axis=1)
        same &= np.all(np.diff(recording.accel, axis=0) == 0.0, axis=1)
        return np.asarray(same[self.sample - 1] | same[self.sample])


NO_SPIKES: Final = Spikes(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp), np.zeros(0))


def find_spikes(data: PreparedRecording, contiguous: Mask) -> Spikes:
    """Spikes inside the sequences without a gap, which are the true ones of a mask; bumps are excluded."""
    parts = [NO_SPIKES]
    least, windows = _least_noise(data), data.windows.samples
    for k in np.flatnonzero(contiguous).tolist():
        (a, turn), (still, b) = windows[data.start[k]].tolist(), windows[data.end[k]].tolist()
        parts.append(_in_sequence(data.recording, (a, turn, still, b), least))
    return Spikes(
        np.concatenate([part.sample for part in parts]),
        np.concatenate([part.channel for part in parts]),
        np.concatenate([part.jump for part in parts]),
    )


def _least_noise(data: PreparedRecording) -> Array:
    """Lower limit of the noise of each channel, shape (6,): stationary noise, quantization step, or rounding.

    It is needed in rotations, in which saturated readings or evenly spaced pulses hardly scatter.
    """
    windows = [(a, min(b, a + _FOR_NOISE)) for a, b in data.windows.samples.tolist() if b - a > 8]
    if not windows:
        return np.full(6, np.inf)
    lengths = sorted({b - a for a, b in windows})
    groups = [[(a, b) for a, b in windows if b - a == length] for length in lengths]
    out = []
    recording, stated = data.recording, data.recording.noise
    per_pulse = 1.0 if recording.kind == "increment" else 1.0 / recording.nominal_interval_s
    for table, pulse in (
        (recording.gyro, stated.gyro_quantization),
        (recording.accel, stated.accel_quantization),
    ):
        # The median excludes disturbed windows.
        noise = np.median(np.concatenate([_noise_of_windows(table, alike) for alike in groups]), axis=0)
        some = table[:: max(1, len(table) // _FOR_STEP)]
        # Corrected readings have finer steps, as the correction mixes the pulses of the axes: a stated pulse is used.
        step = np.maximum(_step(table, windows, some), (pulse or 0.0) * per_pulse)
        out.append(np.maximum(np.maximum(noise, step), ROUNDING * np.abs(some).max()))
    return np.concatenate(out)


def _noise_of_windows(table: Array, windows: list[tuple[int, int]]) -> Array:
    """Standard deviation of the readings in g windows of one length, shape (g, 3)."""
    together = np.stack([table[a:b] for a, b in windows], axis=1)
    return _noise(np.abs(_off(together.reshape(len(together), -1)))).reshape(-1, 3)


def _step(table: Array, windows: list[tuple[int, int]], some: Array) -> Array:
    """Quantization step: median over a few windows; from ``some`` for channels that are constant in the windows."""
    few = windows[:: max(1, len(windows) // _FEW)]
    steps = np.array([quantization_step(table[a:b]) for a, b in few])
    seen = np.array([np.median(s[s > 0.0]) if np.any(s > 0.0) else 0.0 for s in steps.T])
    return seen if np.all(seen > 0.0) else np.where(seen > 0.0, seen, quantization_step(some))


def _off(x: Array) -> Array:
    """Readings less their predictions, without the first two and the last two readings, shape (n - 4, 3)."""
    beside = x[1:-3] + x[3:-1]
    beside *= 4.0
    beside -= x[:-4]
    beside -= x[4:]
    beside /= 6.0
    return np.asarray(x[2:-2] - beside)


def _noise(size: Array) -> Array:
    """Standard deviation of each column, from a quantile of the magnitudes ``size``."""
    some = size[:: max(1, len(size) // _FOR_NOISE)].T.copy()
    rank = int(_QUANTILE * (some.shape[1] - 1))
    return np.asarray(np.partition(some, rank, axis=1)[:, rank] / _NORMAL)


def _in_sequence(recording: Recording, bounds: tuple[int, int, int, int], least: Array) -> Spikes:
    """Spikes of one sequence with the windows [a, turn) and [still, b) and the rotation between them."""
    a, turn, still, b = bounds
    if b - a < 8:
        return NO_SPIKES
    tables = (recording.gyro, recording.accel)
    off = np.concatenate([_off(table[a:b]) for table in tables], axis=1)
    suspects = []
    edges = np.array([0, turn - a - 2, still - a - 2, b - a - 4]).clip(0, b - a - 4)
    by_hand = recording.fixture is None  # rotations by hand include bumps, as when the unit is set down
    for part_of, (lo, hi) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        if hi - lo < 4 or (by_hand and part_of == 1):
            continue
        part = np.abs(off[lo:hi])
        rows, channels = np.nonzero(part > _SIGMAS * np.maximum(_noise(part), least))
        suspects.append((rows + lo, channels))
    rows = np.concatenate([r for r, _ in suspects]) if suspects else np.zeros(0, dtype=np.intp)
    channels = np.concatenate([c for _, c in suspects]) if suspects else np.zeros(0, dtype=np.intp)
    sample = a + 2 + rows
    around = np.array(
        [[tables[c // 3][i + j, c % 3] for j in (-2, -1, 1, 2)] for i, c in zip(sample, channels, strict=True)]
    ).reshape(-1, 4)
    slopes = np.stack(
        [around[:, 1] - around[:, 0], 0.5 * (around[:, 2] - around[:, 1]), around[:, 3] - around[:, 2]], axis=1
    )
    jump = off[rows, channels]
    keep = np.abs(jump) > _JERK * np.ptp(slopes, axis=1)
    sample, channels, jump = sample[keep], channels[keep], jump[keep]
    sound = np.array([not _is_bump(recording, bounds, i, sample, channels, off) for i in sample.tolist()], dtype=bool)
    return Spikes(sample[sound], channels[sound], jump[sound])


def _is_bump(
    recording: Recording,
    bounds: tuple[int, int, int, int],
    at: int,
    sample: Indices,
    channels: Indices,
    off: Array,
) -> bool:
    """True if a spike of the gyros in a window is a bump: gravity stays rotated by its angle.

    If the accelerometers cannot measure this angle, a spike of several gyros counts as a bump.
    """
    a, turn, still, b = bounds
    together = channels[sample == at]
    if np.any(together >= 3) or turn <= at < still:
        return False
    first, last = (a, turn) if at < turn else (still, b)
    most = max(1, round(_MEAN_S / recording.nominal_interval_s))
    before, after = slice(max(first, at - most), at), slice(at + 1, min(last, at + 1 + most))
    fewest = min(before.stop - before.start, after.stop - after.start)
    if fewest < 2:
        return len(together) > 1
    force = recording.accel
    mean = force[before].mean(axis=0)
    change = force[after].mean(axis=0) - mean
    noise = np.std(np.diff(force[before], axis=0), axis=0) / np.sqrt(fewest)
    angle = off[at - a - 2, :3] * rates_factor(recording) * recording.nominal_interval_s
    turned = np.cross(mean, angle)
    sigma = float(np.linalg.norm(noise * turned)) / max(float(np.linalg.norm(turned)), 1e-300)
    if np.linalg.norm(turned) < _SEEN * sigma:
        return len(together) > 1
    return bool(change @ turned > 0.5 * (turned @ turned))
