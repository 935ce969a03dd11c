"""Binary words of a logger: readings that wrap around, misread signs, missing signs and stuck bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.channels import MOVED, SAMPLES, unread
from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.rotation_readings import ROUNDING
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array


_ONE_POLARITY: Final = 0.05
"""Smallest share of zeros in the readings of a channel without one of the signs."""
WHOLE: Final = 1e-3
"""Largest distance of a reading from a multiple of the step, in steps: rounding leaves less."""
_BITS: Final = 32
"""Largest number of bits of a word."""
_PASSED: Final = 20
"""Fewest values of the bits from the stuck bit upwards: for independent readings, such as those of static poses, all of
them have the bit set with p = 1e-6. For rotations, in which the readings pass all values between, p is far smaller."""


def wrapped_words(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that jump between their two extremes, or between zero and an extreme; report the first channel."""
    for sensor, (axis, jumps) in evidence.wrapped_readings.items():
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


def words_of_one_polarity(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that often read zero, and never a sign that some labelled rotation or pose requires."""
    turned, poses = evidence.labelled_inputs
    missed, read = evidence.missed_rotations
    turned = np.concatenate([turned, np.where(unread(missed, read), missed, read)])
    for sensor, table, inputs in zip(ONE_POLARITY, (evidence.rate, evidence.force), (turned, poses), strict=True):
        if sensor in evidence.wrapped_readings:
            continue  # signed words that are read as unsigned ones have no negative values either
        both = np.any(inputs > MOVED, axis=0) & np.any(inputs < -MOVED, axis=0)
        for axis in np.flatnonzero(both & (table[:: len(table) // SAMPLES + 1] == 0.0).any(axis=0)).tolist():
            column, share = table[:, axis], float(np.mean(table[:, axis] == 0.0))
            low, high = float(column.min()), float(column.max())
            if share >= _ONE_POLARITY and low * high == 0.0 and low != high:
                missing = "negative" if low == 0.0 else "positive"
                channel = f"{sensor}_{AXES[axis]}"
                yield ONE_POLARITY[sensor].found(channel=channel, missing=missing, share=100.0 * share)
                return


ONE_POLARITY: Final = by_sensor(
    "one_polarity",
    "[A gyro|An accelerometer] reads values of only one sign",
    "zeros, and no reading of a sign that some [rotation of gravity|labelled pose] requires",
    "{channel} has no {missing} reading, and reads zero in {share:.3g} % of the samples, but the sequences require "
    "both signs: {missing} values are cut off (by an unsigned word, or a unipolar converter); read signed words.",
    "exit 1",
    words_of_one_polarity,
)


def bit_stuck(evidence: Evidence) -> Iterator[Finding]:
    """Find a bit that is set in all words of an axis; the axes of a triad have the same count value."""
    for sensor, table in (("gyro", evidence.recording.gyro), ("accel", evidence.recording.accel)):
        some = table[:: max(1, len(table) // SAMPLES)]
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
        gaps = np.unique(np.diff(column))
        steps, largest = np.concatenate([gaps, np.diff(gaps)]), float(np.abs(column).max())
        step = float(steps[steps > ROUNDING * largest].min())
        # The largest reading, a whole number of counts, gives the count value without the rounding of a difference.
        least.append(largest / max(1, round(largest / step)))
    return min(least) if least else None


def _stuck_bit(counts: Array) -> int | None:
    """Lowest bit that is set in all words; None if there is none, or if the readings are not whole numbers."""
    words = np.rint(counts)
    if float(np.abs(counts - words).max()) > WHOLE or float(np.abs(words).max()) >= 2.0**_BITS:
        return None
    whole = words.astype(np.int64)
    common = int(np.bitwise_and.reduce(whole))
    bit = (common & -common).bit_length() - 1
    return bit if 0 <= bit < _BITS and len(np.unique(whole >> bit)) >= _PASSED else None
