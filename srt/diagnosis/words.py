"""Words of a logger: readings that overflow and wrap around, misread signs, and words of one polarity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.constants import MICRO_G
from srt.diagnosis.findings import check, finding
from srt.diagnosis.rotation_readings import computed_once
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices, Mask


_WRAP_JUMP: Final = 0.9
"""Smallest jump of a wrapping reading between two samples, relative to its range."""
_WRAP_STEP: Final = 0.6
"""The same before the slope of a ramp is added to it."""
_WRAP_SLOPE: Final = 0.35
"""Largest change of a ramp from sample to sample, relative to the range."""
_SIGN_EDGE: Final = 0.1
"""Share of the range next to zero, and next to its end, in which small readings of a misread sign lie."""
_SIGN_SHARE: Final = 0.01
"""Share of the readings at either."""
_SIGN_FLIPS: Final = 5
"""Jumps between the two for each window, by noise about zero, from which the sign is misread."""
_SIGN_STAYS: Final = 10
"""Jumps after which the accelerometers stay."""
_BEYOND: Final = 1.3
"""Range of readings that continue without their jumps over the range of the word, from which they wrap."""
_CONTINUES: Final = 0.2
"""Share of that rate of change from which readings that continue tell: single pulses at rest jump, too."""
_SAME_RANGE: Final = 0.05
"""Median deviation of the ranges by single jumps, relative to the range: noise, and slopes that change."""
_WRAPPED_SEQUENCES: Final = {"gyro": 2, "accel": 3}
"""Sequences with such readings at least."""
_WRAP_SYMMETRY: Final = 0.02
"""Largest distance of the middle of that range from zero, relative to the range: words are signed."""
_WRAP_SAMPLES: Final = 5
"""Samples on both sides of a jump, whose medians must lie on both sides of zero: a shock swings back at once."""
_WRAP_MOTION: Final = {"gyro": 50.0, "accel": 500.0}
"""Rate of change, rad/s² and m/s³, above which a jump is no motion on a fixture or in a hand."""
_ONE_POLARITY: Final = 0.05
"""Share of the readings that are zero, from which words hold no other sign."""
_MANY: Final = 30
"""Readings just beyond a dead band: as many are expected inside it, and none is by chance with p = 1e-13."""
_ZEROS: Final = 0.3
"""Zeros over those readings, from which the readings inside are zero: a slow motion may spend less time there."""
_BESIDE: Final = 1.5
"""Median size of the readings after zeros over the threshold, below which slow motion passes the band."""
_BAND_STEPS: Final = 2.5
"""Smallest reading other than zero over the quantization step: one without a dead band."""
_FREQUENT: Final = 0.3
"""Readings of one value over those of the most frequent one, from which a value is frequent."""
_NEAR: Final = 10.0
"""Readings over the smallest one up to which a grid of pulses is sought: noise in a window may lie between them."""
_SAMPLES: Final = 20_000
"""Readings from which the quantization step is taken, and in which a bit is sought first."""
_WHOLE: Final = 1e-3
"""Distance of readings from multiples of the step, in steps, that rounding leaves."""
_ROUNDING: Final = 1e-9
"""Difference of readings that rounding leaves, relative to the largest."""
_BITS: Final = 16
"""Bits of a word."""
_PASSED: Final = 20
"""Values of the bits from a bit on, all with it set: p = 1e-6 for readings without relation, as in single poses, and
far less for rotations, in which the readings pass all values between."""
_HALF_TURN: Final = 0.5
"""Smallest rotation of a label in rad, and part of gravity in a pose, that must be read with its sign."""


@check("gyro_wrapped", "accel_wrapped")
def wrapped_words(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that jump between their two extremes, or between zero and one; the message gives the first."""
    for sensor, (axis, jumps) in wrapped_readings(evidence).items():
        column = (evidence.rate if sensor == "gyro" else evidence.force)[:, axis]
        yield finding(
            f"{sensor}_wrapped",
            channel=f"{sensor}_{AXES[axis]}",
            low=float(column.min()),
            high=float(column.max()),
            count=len(jumps),
            time=float(evidence.recording.time[jumps[0]]),
        )


@computed_once
def wrapped_readings(evidence: Evidence) -> dict[str, tuple[int, Indices]]:
    """First axis of a triad that wraps, and the samples before which it jumps, by sensor."""
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
    """True for samples after neither a gap nor a change of sequence, where the unit may have moved unrecorded."""
    inside = ~np.isin(samples, evidence.recording.gaps)
    if evidence.data is not None:
        sequences = [(evidence.sequence_at(i - 1), evidence.sequence_at(i)) for i in samples.tolist()]
        inside &= np.array([before is not None and before == after for before, after in sequences], dtype=np.bool_)
    return np.asarray(inside)


def _wraps(column: Array, low: float, high: float) -> Indices:
    """Samples before which a reading jumps from one of its extremes to the other, and goes on as before or stays."""
    n, size, step = _WRAP_SAMPLES, high - low, np.diff(column)
    large = np.abs(step) > _WRAP_STEP * size
    if not high > 0.0 or abs(high + low) > _WRAP_SYMMETRY * size:
        return np.zeros(0, dtype=np.intp)
    jumps = np.flatnonzero(large) + 1
    jumps = jumps[(jumps >= n) & (jumps <= len(column) - n)]
    before, after = (np.median(column[jumps[:, None] + np.arange(a, a + n)], axis=1) for a in (-n, 0))
    stays = (before * after < 0.0) & (np.minimum(np.abs(before), np.abs(after)) > 0.25 * size)
    stays &= np.abs(step[jumps - 1]) > _WRAP_JUMP * size
    # A ramp goes on at its slope: the jump is the whole range against it.
    jump, slopes = step[jumps - 1], np.stack([step[jumps - 2], step[jumps]])
    slope = slopes.mean(axis=0)
    ramp = (np.abs(jump - slope) > _WRAP_JUMP * size) & (jump * slope < 0.0)
    ramp &= np.all((np.abs(slopes) < _WRAP_SLOPE * size) & (slopes * slope > 0.0), axis=0)
    ramp &= np.abs(jump - slope) < size / _WRAP_JUMP
    return np.asarray(jumps[stays | ramp], dtype=np.intp)


def _of_wrong_sign(evidence: Evidence, sensor: str, column: Array, low: float, high: float) -> Indices:
    """Samples before which a reading jumps between zero and one of its extremes.

    Signed words read as unsigned ones put small negative values at the upper end; those of sign and magnitude at the
    lower one, if they are read as two's complement, or the reverse. Noise about zero makes gyros jump at rest, and
    gravity that passes zero makes accelerometers jump in rotations.
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
        inside = np.searchsorted(windows[:, 0], jumps, side="left") - 1  # a jump before a first sample is outside
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
    """Samples of the jumps without which the readings of sequences continue far beyond their range.

    A gyro returns to rest: its jumps up and down are as many.
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
    """Range of a word by the jumps against a slope that goes on before and after them; None if they disagree."""
    step, seen = np.diff(column), float(np.ptp(column))
    at = np.flatnonzero(np.abs(step[1:-1]) > 0.5 * seen) + 1
    slope = 0.5 * (step[at - 1] + step[at + 1])
    against = (slope * step[at] < 0.0) & (step[at - 1] * step[at + 1] > 0.0) & (np.abs(slope) < 0.5 * seen)
    sizes = np.abs(step[at] - slope)[against]
    if len(sizes) < _WRAP_SAMPLES:
        return None
    size = float(np.median(sizes))
    return size if float(np.median(np.abs(sizes - size))) < _SAME_RANGE * size and size > _WRAP_JUMP * seen else None


@check("gyro_one_polarity", "accel_one_polarity")
def words_of_one_polarity(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that read zero often, and never the sign that the labels state for some rotation or pose."""
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
            continue  # signed words read as unsigned ones hold no negative value either
        for axis in range(3):
            column, expected = table[:, axis], stated[sensor][:, axis]
            share = float(np.mean(column == 0.0))
            if share < _ONE_POLARITY or not np.any(expected > _HALF_TURN) or not np.any(expected < -_HALF_TURN):
                continue
            for sign, missing in ((1.0, "negative"), (-1.0, "positive")):
                if np.all(sign * column >= 0.0) and np.any(column != 0.0):
                    channel = f"{sensor}_{AXES[axis]}"
                    yield finding(f"{sensor}_one_polarity", channel=channel, missing=missing, share=100.0 * share)
                    return


@check("accel_dead_band")
def accel_dead_band(evidence: Evidence) -> Iterator[Finding]:
    """Find accelerometers that read zero, and never between zero and a threshold, which gravity passes in rotations."""
    found = suppressed_readings(evidence, "accel")
    if found is not None:
        yield finding(
            "accel_dead_band",
            channel=f"accel_{AXES[found.axis]}",
            count=found.zeros,
            threshold_ug=found.threshold / MICRO_G,
            step_ug=found.step / MICRO_G,
        )


class SuppressedReadings(NamedTuple):
    """Readings of one axis, none of which lies between zero and a threshold.

    Attributes
    ----------
    axis, zeros : int
        Axis, and number of its readings that are zero.
    threshold, step : float
        Smallest other reading and quantization step, rad/s or m/s².
    """

    axis: int
    zeros: int
    threshold: float
    step: float


def suppressed_readings(evidence: Evidence, sensor: str) -> SuppressedReadings | None:
    """First axis of a triad, "gyro" or "accel", whose readings pass through zero and show none near it."""
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
            continue  # the threshold is the step of the readings, some of which were filled in between
        grid = max(float(step[axis]), pulse / evidence.dt, _grid(size[(size > 0.0) & (size < _NEAR * threshold)]))
        # Zeros of samples that were lost lie among any readings.
        beside = size[np.minimum(np.flatnonzero(size == 0.0) + 1, len(size) - 1)]
        passing = zeros >= _ZEROS * beyond or float(np.median(beside)) < _BESIDE * threshold
        if beyond >= _MANY and passing and threshold > _BAND_STEPS * grid:
            return SuppressedReadings(axis, zeros, threshold, grid)
    return None


def _grid(small: Array) -> float:
    """Smallest frequent one of small readings, of which most are multiples; 0 if they are not."""
    values, counts = np.unique(small, return_counts=True)
    common = float(values[np.argmax(counts >= _FREQUENT * counts.max())])
    multiple = small / common
    return common if np.mean(np.abs(multiple - np.rint(multiple)) < _WHOLE) > 0.5 else 0.0


@check("bit_stuck")
def bit_stuck(evidence: Evidence) -> Iterator[Finding]:
    """Find a bit that is set in all words of an axis; the axes of a triad share the value of a count."""
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
            yield finding("bit_stuck", bit=bit, channel=channel, count=len(table), periods=periods)
            return


def _count_value(table: Array) -> float | None:
    """Value of a count, common to the axes, from the differences of distinct readings and of these; None for no words.

    Pulses that take several counts each do not leave single ones between them.
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
    """Lowest bit that is set in all words; None if there is none, or if the readings are no words."""
    words = np.rint(counts)
    if float(np.abs(counts - words).max()) > _WHOLE or float(np.abs(words).max()) >= 2.0**_BITS:
        return None
    whole = words.astype(np.int64)
    common = int(np.bitwise_and.reduce(whole))
    bit = (common & -common).bit_length() - 1
    return bit if 0 <= bit < _BITS and len(np.unique(whole >> bit)) >= _PASSED else None
