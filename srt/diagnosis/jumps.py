"""Readings that jump: spikes, and binary words that wrap around or whose sign is misread.

A spike is one reading, or a burst of up to five, that deviates from its neighbours by far more than the noise around
it. A cubic through the two readings before and the two readings after predicts each reading. If the slopes between
these four readings differ much, the unit moves abruptly, and the reading is not a spike. A bump that rotates the unit
within one sample looks like a spike of the gyros, but the direction of gravity stays rotated by its angle. A hand
shakes the unit, and sets it down: in its rotations and next to them, a spike is one of a single channel, whose other
channels move far less; in rotations, the turns must not contradict it (:mod:`srt.joint.replaced_readings`).
Accelerometer readings of rotations enter no result, and are not accused: a knock as a hand takes the unit, or sets it
down. A large spike cuts a stationary window in two, with a part between them in which the unit does not rotate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.false_alarms import limit, robust_freedom, robust_sigma
from srt.diagnosis.rotation_readings import BESIDE, ROUNDING, SLOWEST_RAD_S

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask

_JERK: Final = 3.0
"""Smallest deviation of a spike that also exceeds the limit of false alarms, in units of the range of the slopes of its
neighbours; a step or a kink of the motion gives at most 1."""
_OF_ONE_SAMPLE: Final = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0
"""Deviations of a sample that deviates by one, and of the samples beside it."""
_OF_DEVIATION: Final = math.sqrt(35.0 / 18.0)
"""Standard deviation of the deviation of a reading, in units of that of a reading."""
_LONGEST: Final = 5
"""Largest number of readings of a burst."""
_ALONE: Final = 7.0
"""Smallest ratio of a spike in a rotation by hand to the other deviations at its sample, in units of the noise. If the
unit is shaken or set down, the other channels and the next samples deviate, too: in 130 such jumps of the gyros in real
recordings, the largest ratio is 4.5."""
_QUIET: Final = 5.0
"""Deviation at the sample of a spike, in units of the noise, that is not called motion: 20 normal values exceed it with
p = 1e-5."""
_FOR_NOISE: Final = 200
"""Number of readings from which the noise of a window or rotation is taken: in 10 s at 100 Hz, their deviations have no
reading in common."""
_QUANTILE: Final = 0.7
"""Quantile of the magnitudes of the deviations from which the noise is taken, as larger ones may be spikes."""
_TAILS: Final = 2.0
"""Largest ratio of that noise to the one by the median, which is 1.1 for Laplace's distribution: spikes in a tenth of
the readings make two fifths of the deviations larger."""


@dataclass(frozen=True, slots=True, eq=False)
class Spikes:
    """Spikes of one sequence or of a recording, arrays of shape (n,)."""

    sample: Indices
    channel: Indices  # 0 to 5: gyro x, y, z, accelerometer x, y, z
    jump: Array  # reading less its prediction, in the units of the stored values
    first: Indices  # first sample of its burst: its own, if it is alone
    alone: Array  # deviation over the largest one of other readings at the same time, or over the noise

    def __getitem__(self, chosen: Mask | Indices) -> Spikes:
        return Spikes(*(getattr(self, name)[chosen] for name in self.__slots__))

    def __add__(self, other: Spikes) -> Spikes:
        both = [np.concatenate([getattr(self, name), getattr(other, name)]) for name in self.__slots__]
        return Spikes(*both)[np.lexsort(both[:2])]

    @property
    def number(self) -> Indices:
        """Number of the burst of each reading."""
        return np.asarray(np.unique(np.stack([self.channel, self.first]), axis=1, return_inverse=True)[1].ravel())

    def of_repeats(self, same: Mask) -> Mask:
        """True for spikes whose sample equals the previous or the next one in all channels; ``same`` is (N - 1,)."""
        return np.asarray(same[self.sample - 1] | same[self.sample])


_NONE: Final = np.array([], dtype=np.intp)
NO_SPIKES: Final = Spikes(_NONE, _NONE, np.array([]), _NONE, np.array([]))


class Jumps(NamedTuple):
    """Readings that jump: spikes, gyro readings in turns by hand that may be spikes, and spikes of no effect.

    ``noise`` is the standard deviation of a reading at rest, by channel, shape (6,).
    """

    spikes: Spikes = NO_SPIKES
    suspects: Spikes = NO_SPIKES
    unused: Spikes = NO_SPIKES
    noise: Array = np.zeros(6)


def find_jumps(columns: Array, data: PreparedRecording, contiguous: Mask, step: Array) -> Jumps:
    """Readings that jump inside the sequences without a gap, which are the true ones of a mask; bumps are excluded.

    ``columns`` are the readings of all channels, shape (6, N), and ``step`` are their quantization steps. Statistic:
    deviation over its standard deviation in the window or rotation. Distribution: t, with the degrees of freedom of a
    quantile of 200 magnitudes.
    """
    x, turns = columns, data.rotation[np.flatnonzero(contiguous)]
    # The deviation from the cubic is the fourth difference over 6, of the sample two later than its first one.
    off = np.diff(x, 4) / 6.0
    size = np.abs(off)
    spans, noise, least = _noise(x, off, data, contiguous, step)
    if not len(spans):
        return Jumps()
    factor = limit("t", robust_freedom(_FOR_NOISE, _QUANTILE), tests=x.size, both_sides=True)
    found = [
        np.argwhere(size[:, a:b] > own[:, None]) + np.array([0, a + 2])
        for (a, b), own in zip(spans.tolist(), factor * noise, strict=True)
    ]
    channel, sample = np.unique(np.concatenate(found), axis=0).T  # rotations share windows
    level = off / np.where(least > 0.0, least, 1.0)[:, None]  # an empty column has none
    jump, jerk = off[channel, sample - 2], np.ptp(_slopes(x, channel, sample, 1), axis=1)
    there = Spikes(sample, channel, jump, sample, _alone(level, sample, channel))
    spiky = np.abs(jump) > _JERK * jerk
    there = there[spiky] + _bursts(x, there[~spiky], least, factor)
    bump = [_is_bump(columns, data, int(i), there) for i in there.sample]
    there = there[~np.array(bump, dtype=np.bool_)]
    rest = np.median(data.windows.gyro_mean, axis=0)[:, None]
    rate = [np.abs(x[:3, a:b] * data.recording.rates_factor - rest).max(initial=0.0) for a, b in turns.tolist()]
    moving = turns[np.array(rate) > SLOWEST_RAD_S]
    used = (there.channel < 3) | ~_inside(there.sample, moving[:, 0] - 1, moving[:, 1])
    there, unused, noise = there[used], there[~used], least / _OF_DEVIATION
    if data.recording.fixture is not None:
        return Jumps(there, unused=unused, noise=noise)
    suspected = _inside(there.sample, turns[:, 0] - 1, turns[:, 1]) & (there.channel < 3)
    near = _inside(there.sample, turns[:, 0] - 1 - BESIDE, turns[:, 1] + BESIDE)
    burst, alone = np.bincount(there.number)[there.number] > 1, there.alone > _ALONE
    # A hand that sets the unit down rocks it for some samples.
    return Jumps(there[~suspected & (~near | (alone & ~burst))], there[suspected & alone], unused, noise)


def _noise(x: Array, off: Array, data: PreparedRecording, contiguous: Mask, step: Array) -> tuple[Array, Array, Array]:
    """Spans of deviations, (n, 2), their noise, (n, 6), and the noise at rest, (6,), of windows and rotations."""
    windows, sequences = data.windows.samples, np.flatnonzero(contiguous)
    start, end = windows[data.start[sequences]], windows[data.end[sequences]]
    spans = np.concatenate([start - np.array([0, 2]), end - np.array([2, 4]), data.rotation[sequences] - 2])
    length = np.diff(spans, axis=1)
    long = length[:, 0] >= 4
    if not long.any():
        return spans[long], np.zeros((0, 6)), np.zeros(6)
    some = np.clip(spans[:, :1] + length * np.arange(_FOR_NOISE) // _FOR_NOISE, 0, off.shape[1] - 1)
    noise, median = (robust_sigma(off[:, some], axis=2, quantile=q).T.reshape(3, -1, 6) for q in (_QUANTILE, 0.5))
    noise = np.where(median > 0.0, np.minimum(noise, _TAILS * median), noise)
    # In rotations, saturated readings or evenly spaced pulses hardly scatter. The median excludes disturbed windows.
    least = np.maximum(np.median(noise[:2], axis=(0, 1)), step)
    least = np.maximum(least, ROUNDING * np.abs(x).max(axis=1))
    noise[2] = noise.max(axis=0)  # the noise of a window reaches into the rotation beside it
    return spans[long], np.maximum(noise, least).reshape(-1, 6)[long], least


def largest_shift(spikes: Spikes, noise: Array, data: PreparedRecording) -> float | None:
    """Largest shift of a sensor error by spikes of the accelerometers, in its sigma; None with spikes of the gyros.

    The spikes change each window mean by their share in it. In its own metric, the least-squares solution moves by no
    more than the norm of this change over the noise of the means. ``noise`` is that of :class:`Jumps`.
    """
    if np.any(spikes.channel < 3):
        return None
    windows, factor = data.windows, data.recording.rates_factor
    first, last = windows.samples.T
    inside = (first[:, None] <= spikes.sample) & (spikes.sample < last[:, None])
    jump = np.where(spikes.channel[:, None] == np.arange(3, 6), spikes.jump[:, None], 0.0)
    share = (inside @ jump) * factor / (last - first)[:, None]
    # Counts of pulses that hold the remainder of the count before scatter less in a mean than one by one.
    single = noise[3:] * factor / np.sqrt(last - first)[:, None]
    sigma = np.minimum(single, data.noise.accel_white / np.sqrt(windows.duration_s)[:, None])
    return float(np.linalg.norm(np.divide(share, sigma, out=np.zeros_like(share), where=share != 0.0)))


def false_in_turns(recording: Recording, options: Options, suspects: Spikes) -> Spikes:
    """Suspects in turns by hand that the turns do not show as motion."""
    if not suspects.sample.size:
        return suspects
    from srt.joint.replaced_readings import Suspects, false_readings  # heavy, and few recordings have suspects

    own = Suspects(suspects.sample, suspects.channel, suspects.number, suspects.jump)
    return suspects[false_readings(recording, options, own)[own.number]]


def _slopes(x: Array, channel: Indices, first: Indices, count: int) -> Array:
    """Slopes between the two readings before ``count`` ones and the two readings after them, shape (n, 3)."""
    beside = x[channel[:, None], first[:, None] + np.array([-2, -1, count, count + 1])]
    return np.asarray(np.diff(beside) / np.array([1.0, count + 1.0, 1.0]))


def _bursts(x: Array, edges: Spikes, noise: Array, factor: float) -> Spikes:
    """Bursts of two to five readings of one channel that deviate alone, among those that begin at ``edges``.

    ``noise`` is that of the deviations of all channels, and ``factor`` its multiple that is the limit of one reading.
    """
    found = NO_SPIKES
    edges = edges[(edges.sample > 1) & (edges.sample < x.shape[1] - _LONGEST - 1)]
    channel, first = edges.channel, edges.sample
    for count in range(2, _LONGEST + 1) if first.size else ():
        own, nodes = np.arange(count), np.array([-2, -1, count, count + 1])
        # Cubic through the readings beside the burst.
        weights = np.linalg.solve(np.vander(nodes, increasing=True).T, np.vander(own, 4, increasing=True).T)
        every = x[:, first[:, None] + own] - x[:, first[:, None] + nodes] @ weights
        jump = every[channel, np.arange(len(first))]
        limits = factor * noise[channel, None] * np.sqrt(1.0 + np.sum(weights**2, axis=0)) / _OF_DEVIATION
        least = np.abs(jump).min(axis=1)
        others = np.abs(every).max(axis=2) / np.where(noise > 0.0, noise, 1.0)[:, None]
        others[channel, np.arange(len(first))] = 0.0
        alone = _over_others(least / noise[channel], others.max(axis=0))
        jerk = np.ptp(_slopes(x, channel, first, count), axis=1)
        chosen = np.all(np.abs(jump) > limits, axis=1) & (least > _JERK * jerk) & (alone > _ALONE)
        sample, which = (first[:, None] + own)[chosen].ravel(), np.repeat(np.flatnonzero(chosen), count)
        found += Spikes(sample, channel[which], jump[chosen].ravel(), first[which], alone[which])
    return found


def _alone(level: Array, sample: Indices, channel: Indices) -> Array:
    """Ratio of deviations to others that motion would cause, as of :class:`Spikes`.

    ``level`` (6, N - 4) are the deviations in units of their noise at rest.
    """
    at = np.clip(sample[:, None] + np.arange(-4, 1), 0, level.shape[1] - 1)
    own = level[channel[:, None], at]
    beside = np.abs(level[:, at[:, 1:4]]).max(axis=2)
    beside[channel, np.arange(len(at))] = np.abs(own - own[:, 2:3] * _OF_ONE_SAMPLE).max(axis=1)
    return _over_others(np.abs(own[:, 2]), beside.max(axis=0))


def _over_others(level: Array, others: Array) -> Array:
    """Ratio of deviations to others, in units of the noise; to the noise, where the others are not above it."""
    return np.asarray(level / np.where(others < _QUIET, 1.0, others))


def _is_bump(columns: Array, data: PreparedRecording, at: int, there: Spikes) -> bool:
    """True if a spike of the gyros in a window is a bump: gravity stays rotated (several gyros, if unknown)."""
    own = there.sample == at
    window = next((w for w in data.windows.samples.tolist() if w[0] <= at < w[1]), None)
    if window is None or np.any(there.channel[own] >= 3):
        return False
    before, after = columns[3:, window[0] : at], columns[3:, at + 1 : window[1]]
    fewest = min(before.shape[1], after.shape[1])
    several = len(np.unique(there.channel[own])) > 1
    if fewest < 2:
        return several
    mean, angle = before.mean(axis=1), np.zeros(3)
    change = after.mean(axis=1) - mean
    noise = np.std(np.diff(before), axis=1) / np.sqrt(fewest)
    angle[there.channel[own]] = there.jump[own] * data.recording.rates_factor * data.recording.nominal_interval_s
    turned = np.cross(mean, angle)
    square = float(turned @ turned)
    if square < limit("normal") * float(np.linalg.norm(noise * turned)):
        return several
    return bool(change @ turned > 0.5 * square)


_MOTION: Final = {"gyro": 10.0, "accel": 100.0}
"""Largest rate of change over the whole range of a channel in a motion on a fixture or by hand, rad/s² and m/s³."""
_EDGE: Final = 0.1
"""Largest deviation of a jump from the range, and of the range from symmetry, and width of the bands between which a
misread sign makes readings jump, relative to the range: noise, and readings missing at a jump."""
_FLIPS: Final = 5
"""Fewest jumps per window, as noise about zero makes them if the sign is misread."""


def wrapped_readings(
    columns: Array, extremes: tuple[Array, Array], recording: Recording, data: PreparedRecording | None
) -> dict[str, tuple[int, Indices]]:
    """First axis of a triad that wraps, and the numbers of the samples after its jumps, by sensor."""
    found: dict[str, tuple[int, Indices]] = {}
    for channel, (column, low, high) in enumerate(zip(columns, *(x.tolist() for x in extremes), strict=True)):
        sensor = ("gyro", "accel")[channel // 3]
        if sensor not in found and (jumps := _jumps(column, (low, high), recording, data, sensor)).size:
            found[sensor] = channel % 3, jumps
    return found


def _jumps(
    column: Array, extremes: tuple[float, float], recording: Recording, data: PreparedRecording | None, sensor: str
) -> Indices:
    """Samples after a jump by the whole range against the slope, or between zero and one of the extremes.

    Signed words that are read as unsigned ones, or words of sign and magnitude as two's complement, show small values
    of one sign at an extreme: noise about zero at rest makes them jump.
    """
    (low, high), step = extremes, np.diff(column)
    large = np.flatnonzero(np.abs(step) > 0.5 * max(-low, high)) + 1
    fastest = _MOTION[sensor] * recording.nominal_interval_s / recording.rates_factor
    for a, b in ((0.0, low), (0.0, high), (low, high)):
        size = abs(b - a)
        if large.size == 0 or size < fastest or size < (1.0 - _EDGE) * max(-low, high):
            continue
        wraps = a != 0.0 and abs(high + low) <= _EDGE * size
        if wraps:
            # The reading continues at its slope after the jump. A spike deviates by 1.5 times its size from the slope.
            jump = np.abs(step[1:-1] - 0.5 * (step[:-2] + step[2:]))
            inner = large[(large > 1) & (large < len(step))]
            inner = inner[np.abs(jump[inner - 2] - size) < _EDGE * size]
            # One reading between two that agree is a spike, unless it jumps from one end of the range to the other.
            alone = np.abs(column[inner[:, None] + np.array([1, 0])] - column[inner[:, None] - np.array([1, 2])])
            ends = np.abs(np.sort(column[inner[:, None] - np.array([1, 0])], axis=1) - np.array([a, b]))
            word: Mask = np.all(alone > _EDGE * size, axis=1) | np.all(ends < _EDGE * size, axis=1)
            inner = inner[word]
            # Vibration that reaches the extremes jumps everywhere.
            beside = np.clip(inner[:, None] - 2 + np.arange(-BESIDE, BESIDE + 1), 0, len(jump) - 1)
            usual: Array = limit("normal", tests=len(column), both_sides=True) * robust_sigma(jump[beside], axis=1)
            jumps = inner[size > usual]
        else:
            apart = np.abs(column[large[:, None] + np.array([-1, 0])][:, :, None] - np.array([a, b]))
            jumps = large[np.all(apart.min(axis=2) < _EDGE * size, axis=1)]
            jumps = jumps[np.abs(step[jumps - 1]) > 0.5 * size]
        jumps = jumps[~np.isin(jumps, recording.gaps)]
        if data is not None:
            windows = data.windows.samples
            jumps = jumps[_inside(jumps, windows[data.start, 0], windows[data.end, 1])]
        if wraps and len(jumps) >= 2:
            return jumps
        if wraps or data is None:
            continue
        if np.count_nonzero(_inside(jumps, *windows.T)) >= _FLIPS * len(windows):
            return jumps
    return np.zeros(0, dtype=np.intp)


def _inside(samples: Indices, first: Indices, last: Indices) -> Mask:
    """True for samples after the first one of some part of the recording, and before its last one."""
    return np.asarray(np.any((first < samples[:, None]) & (samples[:, None] < last), axis=1))
