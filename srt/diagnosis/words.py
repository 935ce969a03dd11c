"""Binary words of a logger: readings that wrap around, misread signs, missing signs, dead bands and stuck bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.constants import MICRO_G
from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.rotation_readings import computed_once
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices, Mask


_WRAP_JUMP: Final = 0.9
"""Smallest jump of a wrapping reading between two samples, relative to the range of the channel."""
_WRAP_STEP: Final = 0.6
"""Smallest jump of a wrapping reading before the slope is subtracted, relative to the range."""
_WRAP_SLOPE: Final = 0.35
"""Largest slope of the reading next to a jump, per sample and relative to the range."""
_SIGN_EDGE: Final = 0.1
"""Width of the bands next to zero and next to an extreme in which small readings with a misread sign lie, relative to
that extreme."""
_SIGN_SHARE: Final = 0.01
"""Smallest share of the readings in each of these bands."""
_SIGN_FLIPS: Final = 5
"""Smallest number of jumps between both bands per window, as noise about zero makes them if the sign is misread."""
_SIGN_STAYS: Final = 10
"""Smallest number of jumps after which the readings of an accelerometer stay in the other band."""
_BEYOND: Final = 1.3
"""Smallest range of the unwrapped readings relative to the range of the word, for readings that wrap."""
_CONTINUES: Final = 0.2
"""Smallest rate of change at a jump for a search by unwrapping, relative to _WRAP_MOTION: single pulses at rest are
jumps, too."""
_SAME_RANGE: Final = 0.05
"""Largest median deviation of the ranges from single jumps, relative to the range: due to noise and changing slopes."""
_WRAPPED_SEQUENCES: Final = {"gyro": 2, "accel": 3}
"""Fewest sequences with unwrapped readings beyond the range of the word."""
_WRAP_SYMMETRY: Final = 0.02
"""Largest distance of the middle of the range from zero, relative to the range: the range of signed words is
symmetric."""
_WRAP_SAMPLES: Final = 5
"""Number of samples on each side of a jump whose medians must have different signs: a shock swings back at once."""
_WRAP_MOTION: Final = {"gyro": 50.0, "accel": 500.0}
"""Largest rate of change in a motion on a fixture or by hand, rad/s² and m/s³."""
_ONE_POLARITY: Final = 0.05
"""Smallest share of zeros in the readings of a channel without one of the signs."""
_MANY: Final = 30
"""Fewest readings just outside a dead band: without a dead band, as many are expected inside it, and the probability of
none is 1e-13."""
_ZEROS: Final = 0.3
"""Smallest ratio of zeros to the readings just outside a dead band: the motion may be faster inside the band."""
_BESIDE: Final = 1.5
"""Largest median size of the readings after zeros, relative to the threshold, if a slow motion passes the dead band."""
_BAND_STEPS: Final = 2.5
"""Smallest ratio of the smallest nonzero reading to the quantization step for a dead band; without one, it is 1."""
_FREQUENT: Final = 0.3
"""Smallest count of a frequent value, relative to that of the most frequent value."""
_NEAR: Final = 10.0
"""Largest reading, relative to the smallest nonzero one, in the search for a grid of pulses."""
_SAMPLES: Final = 20_000
"""Number of readings from which the quantization step is taken, and in which a stuck bit is searched first."""
_WHOLE: Final = 1e-3
"""Largest distance of a reading from a multiple of the step, in steps: rounding leaves less."""
_ROUNDING: Final = 1e-9
"""Smallest difference between two readings that is not rounding, relative to the largest reading."""
_BITS: Final = 16
"""Number of bits of a word."""
_PASSED: Final = 20
"""Fewest values of the bits from the stuck bit upwards: for independent readings, such as those of static poses, all of
them have the bit set with p = 1e-6. For rotations, in which the readings pass all values between, p is far smaller."""
_HALF_TURN: Final = 0.5
"""Smallest labelled rotation, rad, and smallest gravity component of a pose, g, whose sign the readings must show."""


def wrapped_words(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that jump between their two extremes, or between zero and an extreme; report the first channel."""
    for sensor, (axis, jumps) in wrapped_readings(evidence).items():
        column = (evidence.rate if sensor == "gyro" else evidence.force)[:, axis]
        yield WRAPPED[sensor].found(
            channel=f"{sensor}_{AXES[axis]}",
            low=float(column.min()),
            high=float(column.max()),
            count=len(jumps),
            time=float(evidence.recording.time[jumps[0]]),
        )


WRAPPED: Final = by_sensor(
    "wrapped",
    "[A gyro|An accelerometer] reading overflows and wraps around",
    "jumps from one extreme to the other, or between zero and an extreme, that are no motion",
    "{channel} jumps from one sample to the next, first at {time:.6g} s and {count} times in all (lowest reading "
    "{low:.4g}, highest {high:.4g} [rad/s|m/s²]): the reading overflows and wraps around; choose a wider range or "
    "format[, or rotate more slowly|].",
    "exit 1",
    wrapped_words,
)


@computed_once
def wrapped_readings(evidence: Evidence) -> dict[str, tuple[int, Indices]]:
    """First axis of a triad that wraps, and the numbers of the samples after its jumps, by sensor."""
    found: dict[str, tuple[int, Indices]] = {}
    for sensor, table in (("gyro", evidence.rate), ("accel", evidence.force)):
        for axis in range(3):
            column = table[:, axis]
            low, high = float(column.min()), float(column.max())
            jumps = np.zeros(0, dtype=np.intp)
            if (high - low) / evidence.dt > _WRAP_MOTION[sensor]:
                jumps = np.union1d(_wraps(column, low, high), _of_wrong_sign(evidence, sensor, column, low, high))
                jumps = jumps[_within_sequences(evidence, jumps)]
            if len(jumps) < 2:
                jumps = _continuous_beyond(evidence, sensor, column)
            if len(jumps) >= 2:
                found[sensor] = axis, jumps
                break
    return found


def _within_sequences(evidence: Evidence, samples: Indices) -> Mask:
    """True for samples in the same sequence as the previous sample, without a gap between both."""
    inside = ~np.isin(samples, evidence.recording.gaps)
    if evidence.data is not None:
        sequences = [(evidence.sequence_at(i - 1), evidence.sequence_at(i)) for i in samples.tolist()]
        inside &= np.array([before is not None and before == after for before, after in sequences], dtype=np.bool_)
    return np.asarray(inside)


def _wraps(column: Array, low: float, high: float) -> Indices:
    """Samples after a jump from one extreme to the other, if the reading continues at its slope or stays there."""
    n, size, step = _WRAP_SAMPLES, high - low, np.diff(column)
    large = np.abs(step) > _WRAP_STEP * size
    if not high > 0.0 or abs(high + low) > _WRAP_SYMMETRY * size:
        return np.zeros(0, dtype=np.intp)
    jumps = np.flatnonzero(large) + 1
    jumps = jumps[(jumps >= n) & (jumps <= len(column) - n)]
    before, after = (np.median(column[jumps[:, None] + np.arange(a, a + n)], axis=1) for a in (-n, 0))
    stays = (before * after < 0.0) & (np.minimum(np.abs(before), np.abs(after)) > 0.25 * size)
    stays &= np.abs(step[jumps - 1]) > _WRAP_JUMP * size
    # The reading continues at its slope, and the jump is the whole range in the opposite direction.
    jump, slopes = step[jumps - 1], np.stack([step[jumps - 2], step[jumps]])
    slope = slopes.mean(axis=0)
    ramp = (np.abs(jump - slope) > _WRAP_JUMP * size) & (jump * slope < 0.0)
    ramp &= np.all((np.abs(slopes) < _WRAP_SLOPE * size) & (slopes * slope > 0.0), axis=0)
    ramp &= np.abs(jump - slope) < size / _WRAP_JUMP
    return np.asarray(jumps[stays | ramp], dtype=np.intp)


def _of_wrong_sign(evidence: Evidence, sensor: str, column: Array, low: float, high: float) -> Indices:
    """Samples after a jump between zero and one of the extremes of a channel.

    If signed words are read as unsigned ones, small negative values appear at the upper end of the range. If words of
    sign and magnitude are read as two's complement, or the reverse, they appear at the lower end. Noise about zero then
    makes gyros jump at rest. A change of sign of the gravity component makes accelerometers jump in rotations.
    """
    data = evidence.data
    for end in (low, high):
        size = abs(end)
        if data is None or size < _WRAP_JUMP * max(-low, high):
            continue
        at_zero, at_end = np.abs(column) < _SIGN_EDGE * size, np.abs(column - end) < _SIGN_EDGE * size
        if min(np.count_nonzero(at_zero), np.count_nonzero(at_end)) < _SIGN_SHARE * len(column):
            continue
        jumps = np.flatnonzero((at_zero[1:] & at_end[:-1]) | (at_end[1:] & at_zero[:-1])) + 1
        windows = data.windows.samples
        inside = np.searchsorted(windows[:, 0], jumps, side="left") - 1  # a jump to the first sample is not inside
        at_rest = (inside >= 0) & (jumps < windows[np.maximum(inside, 0), 1])
        if np.count_nonzero(at_rest) >= _SIGN_FLIPS * len(windows):
            return np.asarray(jumps)
        n = _WRAP_SAMPLES
        far = jumps[(jumps >= n) & (jumps <= len(column) - n)]
        before, after = (np.median(column[far[:, None] + np.arange(a, a + n)], axis=1) for a in (-n, 0))
        if sensor == "accel" and np.count_nonzero(np.abs(after - before) > _WRAP_STEP * size) >= _SIGN_STAYS:
            return np.asarray(jumps)
    return np.zeros(0, dtype=np.intp)


def _continuous_beyond(evidence: Evidence, sensor: str, column: Array) -> Indices:
    """Samples after the jumps of a word, if the readings of sequences extend far beyond its range once unwrapped.

    As the unit is at rest before and after a sequence, a gyro must have as many jumps up as down.
    """
    data, size = evidence.data, _word_range(column)
    if data is None or size is None or size / evidence.dt < _CONTINUES * _WRAP_MOTION[sensor]:
        return np.zeros(0, dtype=np.intp)
    found = []
    for k in np.flatnonzero(evidence.contiguous).tolist():
        first, last = int(data.windows.samples[data.start[k], 0]), int(data.windows.samples[data.end[k], 1])
        part = column[first:last]
        wraps = np.rint(np.diff(part) / size)
        if np.count_nonzero(wraps) < 2 or (sensor == "gyro" and wraps.sum() != 0.0):
            continue
        whole = part.copy()
        whole[1:] -= size * np.cumsum(wraps)
        ends = np.partition(whole, (_WRAP_SAMPLES, len(whole) - 1 - _WRAP_SAMPLES))
        if ends[-1 - _WRAP_SAMPLES] - ends[_WRAP_SAMPLES] > _BEYOND * size:
            found.append(first + 1 + np.flatnonzero(wraps))
    return np.concatenate(found) if len(found) >= _WRAPPED_SEQUENCES[sensor] else np.zeros(0, dtype=np.intp)


def _word_range(column: Array) -> float | None:
    """Range of a word from the jumps against the slope before and after them; None if the jumps differ in size."""
    step, seen = np.diff(column), float(np.ptp(column))
    at = np.flatnonzero(np.abs(step[1:-1]) > 0.5 * seen) + 1
    slope = 0.5 * (step[at - 1] + step[at + 1])
    against = (slope * step[at] < 0.0) & (step[at - 1] * step[at + 1] > 0.0) & (np.abs(slope) < 0.5 * seen)
    sizes = np.abs(step[at] - slope)[against]
    if len(sizes) < _WRAP_SAMPLES:
        return None
    size = float(np.median(sizes))
    return size if float(np.median(np.abs(sizes - size))) < _SAME_RANGE * size and size > _WRAP_JUMP * seen else None


def words_of_one_polarity(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that often read zero, and never a sign that some labelled rotation or pose requires."""
    data = evidence.data
    if data is None or evidence.recording.fixture is None:
        return
    turned = [s.axes * s.angles_rad[:, None] for s in data.catalogue if s is not None]
    stated = {
        "gyro": np.concatenate(turned) if turned else np.zeros((0, 3)),
        "accel": evidence.poses[0] / evidence.recording.site.gravity_m_s2,
    }
    for sensor, table in (("gyro", evidence.rate), ("accel", evidence.force)):
        if sensor in wrapped_readings(evidence):
            continue  # signed words that are read as unsigned ones have no negative values either
        for axis in range(3):
            column, expected = table[:, axis], stated[sensor][:, axis]
            share = float(np.mean(column == 0.0))
            if share < _ONE_POLARITY or not np.any(expected > _HALF_TURN) or not np.any(expected < -_HALF_TURN):
                continue
            for sign, missing in ((1.0, "negative"), (-1.0, "positive")):
                if np.all(sign * column >= 0.0) and np.any(column != 0.0):
                    channel = f"{sensor}_{AXES[axis]}"
                    yield ONE_POLARITY[sensor].found(channel=channel, missing=missing, share=100.0 * share)
                    return


ONE_POLARITY: Final = by_sensor(
    "one_polarity",
    "[A gyro|An accelerometer] reads values of only one sign",
    "zeros, and no reading of a sign that some labelled [rotation|pose] requires",
    "{channel} has no {missing} reading, and reads zero in {share:.3g} % of the samples, but the sequences require "
    "both signs: {missing} values are cut off (by an unsigned word, or a unipolar converter); read signed words.",
    "exit 1",
    words_of_one_polarity,
)


def accel_dead_band(evidence: Evidence) -> Iterator[Finding]:
    """Find accelerometers that read zero, but nothing between zero and a threshold, although gravity passes it."""
    found = suppressed_readings(evidence, "accel")
    if found is not None:
        yield ACCEL_DEAD_BAND.found(
            channel=f"accel_{AXES[found.axis]}",
            count=found.zeros,
            threshold_ug=found.threshold / MICRO_G,
            step_ug=found.step / MICRO_G,
        )


ACCEL_DEAD_BAND: Final = Fault(
    "accel_dead_band",
    "The accelerometers suppress small readings",
    "zeros, but no other reading below a threshold far above the quantization step",
    "{channel} reads zero {count} times, and otherwise at least {threshold_ug:.3g} µg, but its quantization step is "
    "{step_ug:.2g} µg: the unit suppresses small readings; switch off its dead band.",
    "warning",
    accel_dead_band,
)


class SuppressedReadings(NamedTuple):
    """Axis without readings between zero and a threshold.

    Attributes
    ----------
    axis, zeros : int
        Number of the axis, and number of its readings that are zero.
    threshold, step : float
        Magnitude of the smallest nonzero reading, and quantization step, rad/s or m/s².
    """

    axis: int
    zeros: int
    threshold: float
    step: float


def suppressed_readings(evidence: Evidence, sensor: str) -> SuppressedReadings | None:
    """First axis of a triad ("gyro" or "accel") whose readings pass through zero, but are never small and nonzero."""
    if sensor in wrapped_readings(evidence):
        return None
    table = evidence.rate if sensor == "gyro" else evidence.force
    step = smallest_step(table[:: max(1, len(table) // _SAMPLES)])
    noise = evidence.recording.noise
    pulse = (noise.gyro_quantization if sensor == "gyro" else noise.accel_quantization) or 0.0
    for axis in range(3):
        size = np.abs(table[:, axis])
        zeros = int(np.count_nonzero(size == 0.0))
        if zeros < _ZEROS * _MANY or zeros == len(size):
            continue
        threshold = float(size[size > 0.0].min())
        beyond = int(np.count_nonzero((size > 0.0) & (size < 2.0 * threshold)))
        multiple = size[size > 0.0] / threshold
        if np.mean(np.abs(multiple - np.rint(multiple)) < _WHOLE) > 0.5:
            continue  # the threshold is the step of most readings; the others were interpolated
        grid = max(float(step[axis]), pulse / evidence.dt, _grid(size[(size > 0.0) & (size < _NEAR * threshold)]))
        # Zeros that stand for lost samples have neighbours of any size.
        beside = size[np.minimum(np.flatnonzero(size == 0.0) + 1, len(size) - 1)]
        passing = zeros >= _ZEROS * beyond or float(np.median(beside)) < _BESIDE * threshold
        if beyond >= _MANY and passing and threshold > _BAND_STEPS * grid:
            return SuppressedReadings(axis, zeros, threshold, grid)
    return None


def _grid(small: Array) -> float:
    """Smallest of the frequent values of small readings; 0 if most readings are not multiples of it."""
    values, counts = np.unique(small, return_counts=True)
    common = float(values[np.argmax(counts >= _FREQUENT * counts.max())])
    multiple = small / common
    return common if np.mean(np.abs(multiple - np.rint(multiple)) < _WHOLE) > 0.5 else 0.0


def bit_stuck(evidence: Evidence) -> Iterator[Finding]:
    """Find a bit that is set in all words of an axis; the axes of a triad have the same count value."""
    for sensor, table in (("gyro", evidence.recording.gyro), ("accel", evidence.recording.accel)):
        some = table[:: max(1, len(table) // _SAMPLES)]
        lsb = _count_value(some)
        if lsb is None:
            continue
        for axis in range(3):
            bit = _stuck_bit(some[:, axis] / lsb)
            if bit is None or _stuck_bit(table[:, axis] / lsb) != bit:
                continue
            periods = float(np.ptp(table[:, axis])) / (lsb * 2.0**bit)
            channel = f"{sensor}_{AXES[axis]}"
            yield BIT_STUCK.found(bit=bit, channel=channel, count=len(table), periods=periods)
            return


BIT_STUCK: Final = Fault(
    "bit_stuck",
    "One bit of a converter is stuck",
    "a bit that is set in all readings of an axis, although their range is many times its value",
    "Bit {bit} of {channel} is set in all {count} readings, although their range is {periods:.3g} times the value of "
    "the bit: one bit of the converter or of its bus is stuck; repair it, and record again.",
    "warning",
    bit_stuck,
)


def _count_value(table: Array) -> float | None:
    """Count value of a triad, from first and second differences of its sorted readings; None if it has no step.

    The second differences are needed if all readings are several counts apart.
    """
    least = []
    for axis in np.flatnonzero(smallest_step(table) > 0.0).tolist():
        column = np.unique(table[:, axis])
        gaps = np.diff(column)
        gaps = np.unique(gaps[gaps > _ROUNDING * np.abs(column).max()])
        finer = np.diff(gaps)
        finer = finer[finer > _ROUNDING * np.abs(column).max()]
        least.append(float(np.concatenate([gaps, finer]).min()))
    return min(least) if least else None


def _stuck_bit(counts: Array) -> int | None:
    """Lowest bit that is set in all words; None if there is none, or if the readings are not whole numbers."""
    words = np.rint(counts)
    if float(np.abs(counts - words).max()) > _WHOLE or float(np.abs(words).max()) >= 2.0**_BITS:
        return None
    whole = words.astype(np.int64)
    common = int(np.bitwise_and.reduce(whole))
    bit = (common & -common).bit_length() - 1
    return bit if 0 <= bit < _BITS and len(np.unique(whole >> bit)) >= _PASSED else None
