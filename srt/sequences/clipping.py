"""Clipping: readings at which channels reach their limits, as stated and as the readings show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.constants import STANDARD_GRAVITY_M_S2
from srt.noise.allan import CHANNELS
from srt.noise.quantization import smallest_step
from srt.recording.readings import derived

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.types import Array, Mask

_NO_NOISE: Final = 1e-7
"""Ratio of the second difference of successive readings to the largest reading, below which readings are noise-free:
the Earth rate in a rotation of 1 rad/s makes 1e-8 at 100 Hz, the noise of a navigation-grade unit 1e-5."""

_HELD: Final = 50
"""Number of equal readings of a pulse output in a row from which an extreme is held: by chance at 4 % of the rates."""

_WANDERS: Final = 0.6
"""Wander of running sums over so many samples, in pulses, above which noise moves a reading: a quarter of a pulse for
each sample leaves so many equal ones the probability 1e-7; without noise the pulses alone wander by 0.3."""

_WANDER_PIECES: Final = 200
"""Number of pieces of a recording that show this wander."""

_MOSTLY_NOISY: Final = 0.5
"""Share of repeated extreme readings with noise in another channel of the triad, above which they are clipped."""

_IN_A_ROW: Final = 3
"""Smallest number of extreme readings in a row that are clipped."""

_LARGEST: Final = 2000
"""Number of largest readings of a channel, which tell how often they repeat."""

_CHANCE: Final = 1e-6
"""Probability that the extreme of a channel repeats in a row by chance: 1.2e-5 for the twelve extremes."""

_PILE: Final = 23
"""Number of readings at an extreme from which they are clipped. In the tail of noise each reading is one step inside
with at least the same probability, so that 23 of 23 at the extreme have 1.2e-7, 1.4e-6 for the twelve extremes."""

_PILE_RATIO: Final = 5
"""Ratio of that number to the number one step inside."""

_NOISY: Final = 0.5
"""Ratio of the resolution to the noise below which equal readings are not explained by the resolution."""

_LEAST_GYRO_RAD_S: Final = 0.2
_LEAST_ACCEL_M_S2: Final = 0.5 * STANDARD_GRAVITY_M_S2
"""Smallest accepted range limits, rad/s and m/s²: an output fixed at zero (dead band) is another fault."""

_RANGE_MARGIN: Final = 0.999
"""Ratio of the largest count to the rounded range of the data sheet."""

_BEYOND: Final = 1.001
"""Ratio of a reading to the stated range above which the range is wrong, because it did not limit the reading."""

_LARGEST_COUNT: Final = 2 ** np.array([12, 14, 16, 18, 20, 24]) // 2
"""Full scale of signed converters, counts."""

_MEDIAN_OF_DIFFERENCES: Final = 0.954
"""Median absolute difference of two readings with normal noise, in sigma of one reading: 0.6745 √2."""

_STRETCHES: Final = 8
_STRETCH: Final = 1000
"""Number of stretches of readings, and their length in samples, from which resolution and noise are estimated."""

_REPEATS: Final = 0.2
"""Share of readings equal to the one before, above which the resolution is coarse (pulses, or a unit at rest)."""


@dataclass(frozen=True, slots=True)
class ClippingLevels:
    """Readings beyond which a channel is clipped, in the units of the recording's columns.

    Attributes
    ----------
    low, high : ndarray, shape (6,)
        gyro x, y, z, accelerometer x, y, z; infinite where no limit is known or seen.
    """

    low: Array
    high: Array


@dataclass(frozen=True, slots=True)
class Clipping:
    """One channel that reached its limit.

    Attributes
    ----------
    channel : str
        Name of the column.
    count : int
        Samples at the limit.
    first_s : float
        Time of the first of them, s.
    """

    channel: str
    count: int
    first_s: float

    def __str__(self) -> str:
        return f"{self.channel} is at the limit of its range in {self.count} samples, from {self.first_s:.6g} s"


@derived
def clipping_levels(recording: Recording) -> ClippingLevels:
    """Find the readings at which channels are clipped, from the stated range and from the readings.

    A noisy channel does not repeat its extreme reading. Clipped, whatever range is stated, are three equal readings in
    a row at the extreme, or more where large readings repeat by chance; many more readings there than one step inside;
    several at the full scale of a converter with fewer beside them. Pulses are clipped where several axes or senses
    hold one extreme. Other coarse, and noise-free readings repeat at any value: clipping is then found by the stated
    range only.
    """
    dt, per_sample = recording.nominal_interval_s, 1.0 / recording.rates_factor
    low, high, noise = np.empty(6), np.empty(6), recording.noise
    sensors = (
        (recording.gyro, noise.gyro_range, noise.gyro_quantization, _LEAST_GYRO_RAD_S),
        (recording.accel, noise.accel_range, noise.accel_quantization, _LEAST_ACCEL_M_S2),
    )
    for s, (values, stated, pulse, least) in enumerate(sensors):
        triad, channels = _Triad.of(values), slice(3 * s, 3 * s + 3)
        limits = [_limits_seen(triad, least * per_sample)]
        if stated is not None:
            limit = np.full(3, _RANGE_MARGIN * stated * per_sample)
            # A pulse output adds the remainder of the previous sample.
            beyond = (_BEYOND * stated + 2.0 * (pulse or 0.0) / dt) * per_sample
            if limit[0] <= triad.peak <= beyond:
                limits.append((-limit, limit))
        if pulse is not None:
            limits.append(_held_pulses(triad, least * per_sample, pulse * per_sample / dt))
        low[channels] = np.max([bottom for bottom, _ in limits], axis=0)
        high[channels] = np.min([top for _, top in limits], axis=0)
    return ClippingLevels(low, high)


class _Triad(NamedTuple):
    """Readings of a triad, (n, 3), its channels one after the other, (3, n), and their smallest and largest readings.

    A reduction over the rows of three readings takes ten times as long as one over a channel.
    """

    rows: Array
    channels: Array
    smallest: Array
    largest: Array

    @classmethod
    def of(cls, rows: Array) -> _Triad:
        channels = np.ascontiguousarray(rows.T)
        return cls(rows, channels, channels.min(axis=1), channels.max(axis=1))

    @property
    def peak(self) -> float:
        """Largest size of a reading."""
        return float(max(self.largest.max(), -self.smallest.min()))


def _limits_seen(triad: _Triad, least: float) -> tuple[Array, Array]:
    """Lowest and highest readings of the channels of a triad if they are range limits; otherwise infinite."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    smallest, largest = triad.smallest, triad.largest
    starts = np.linspace(0, max(len(triad.rows) - _STRETCH, 0), _STRETCHES).astype(int)
    some = np.concatenate([triad.rows[a : a + _STRETCH] for a in starts.tolist()])
    smooth = _NO_NOISE * triad.peak
    for axis, channel in enumerate(triad.channels):
        ends = ((-1.0, low, smallest[axis]), (1.0, high, largest[axis]))
        # A channel is not clipped at an extreme that it reads once.
        repeated = [(sign, limits) for sign, limits, end in ends if np.count_nonzero(channel == end) > 1]
        if not repeated:
            continue
        inner = (some[:, axis] > smallest[axis]) & (some[:, axis] < largest[axis])
        differences = np.abs(np.diff(some[:, axis]))[inner[1:] & inner[:-1]]
        if not differences.size or np.mean(differences == 0.0) > _REPEATS:
            continue
        step = float(smallest_step(some[inner, axis][:, None])[0])
        noise = float(np.median(differences)) / _MEDIAN_OF_DIFFERENCES
        if step > _NOISY * noise:
            continue
        for sign, limits in repeated:
            extreme = float(largest[axis] if sign > 0.0 else -smallest[axis])
            if extreme > least and _is_limit(sign * channel, (extreme, step, noise), triad.rows, axis, smooth):
                limits[axis] = sign * extreme
    return low, high


def _held_pulses(triad: _Triad, least: float, pulse: float) -> tuple[Array, Array]:
    """Lowest and highest readings of channels with pulses if they are range limits; otherwise infinite.

    The remainder of a pulse is carried to the next sample, so that readings stay equal only where a sample has a whole
    number of pulses: for n samples, within 1/n of it. Two axes, or senses of one, do so at the largest reading of the
    triad only if it is clipped there; a channel whose noise adds up to pulses does so at its largest reading.
    """
    size = np.stack([-triad.smallest, triad.largest])
    ends = ((channel == end for channel, end in zip(triad.channels, e, strict=True)) for e in triad[2:])
    held = np.array([[_longest_run(at_end) >= _HELD for at_end in each] for each in ends]) & (size > least)
    if held.any():
        at_peak = held & (size == triad.peak)
        adds_up = _wander_of_sums(triad.channels) > _WANDERS * pulse
        held = (at_peak & (at_peak.sum() > 1)) | (held & adds_up)
    low, high = np.where(held, size, np.inf)
    return -low, high


def _wander_of_sums(channels: Array) -> Array:
    """Standard deviation of running sums about a line, over as many samples as count as held, by channel; typical."""
    n = channels.shape[1]
    starts = np.linspace(0, n - _HELD, _WANDER_PIECES).astype(int) if n > _HELD else np.zeros(0, int)
    if not starts.size:
        return np.zeros(3)
    pieces = channels[:, starts[:, None] + np.arange(_HELD)]
    sums = np.cumsum(pieces - pieces.mean(axis=2, keepdims=True), axis=2)
    return np.asarray(np.median(sums.std(axis=2), axis=1))


def _longest_run(at: Mask) -> int:
    rows = np.flatnonzero(at)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(rows) > 1) + 1, [len(rows)]])
    return int(np.diff(edges).max())


def _is_limit(channel: Array, levels: tuple[float, float, float], triad: Array, axis: int, smooth: float) -> bool:
    """Return True if noisy readings are clipped at their largest value; ``levels`` are that, their step and noise.

    A noise-free rotation at a constant rate also repeats its extreme, but then the other axes are ``smooth`` too.
    """
    extreme, step, noise = levels
    # Only readings close to the extreme matter, and there are few.
    close = np.flatnonzero(channel >= extreme - max(1.5 * step, noise))
    below = extreme - channel[close]
    at = close[below == 0.0]
    held = at[:-2][at[2:] - at[:-2] == 2]
    others = np.delete(triad, axis, axis=1)
    # An axis that is clipped, too, shows no noise.
    shows = (others[held + 1] > others.min(axis=0)) & (others[held + 1] < others.max(axis=0))
    held = held[shows.any(axis=1)]
    if held.size:
        roughness = np.abs(others[held + 2] - 2.0 * others[held + 1] + others[held])
        noisy = float(np.mean(np.any(roughness > smooth, axis=1))) > _MOSTLY_NOISY
        if not noisy or _longest_run(channel == extreme) >= _fewest_in_a_row(channel, extreme):
            return noisy
    # Pulses that were corrected repeat a reading with those of the other axes: such rows count once.
    count = len(np.unique(triad[at], axis=0))
    inside = int(np.count_nonzero((below < 1.5 * step) & (below > 0.5 * step)))
    # Normal noise has many readings in the sigma below its largest; a shake that reaches the limit has few.
    tail = int(np.count_nonzero((below < noise) & (below > 0.0)))
    # Two's complement: the negative full scale is one count larger.
    full_scale = step > 0.0 and bool(np.any(np.abs(extreme / step - _LARGEST_COUNT + 0.5) <= 0.51))
    return (count >= _PILE and count >= _PILE_RATIO * inside) or (full_scale and count > max(1, tail))


def _fewest_in_a_row(channel: Array, extreme: float) -> int:
    """Number of extreme readings in a row that chance does not make, by how often large readings repeat.

    Filtered readings repeat where the sample that enters the filter equals the one that leaves it.
    """
    below = channel[:-1] < extreme
    large = below & (channel[:-1] >= np.partition(channel, -min(len(channel), _LARGEST))[-min(len(channel), _LARGEST)])
    repeats = np.count_nonzero(channel[1:][large] == channel[:-1][large])
    rate = (repeats + 1.0) / (np.count_nonzero(large) + 2.0)
    return max(_IN_A_ROW, 1 + math.ceil(math.log(_CHANCE) / math.log(rate)))


def clipped_samples(recording: Recording, part: slice) -> tuple[Clipping, ...]:
    """Find the channels that are clipped in a part of a recording; a sequence with any of them is void.

    Parameters
    ----------
    part : slice
        Samples to look at.

    Returns
    -------
    tuple of Clipping
        Empty: nothing is clipped.
    """
    levels, found = clipping_levels(recording), []
    limited = np.isfinite(levels.low) | np.isfinite(levels.high)
    for c in np.flatnonzero(limited).tolist():
        readings = (recording.gyro, recording.accel)[c // 3][part, c % 3]
        at = np.flatnonzero((readings >= levels.high[c]) | (readings <= levels.low[c]))
        if at.size:
            found.append(Clipping(CHANNELS[c], int(at.size), float(recording.time[part][at[0]])))
    return tuple(found)
