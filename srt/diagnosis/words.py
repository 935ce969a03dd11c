"""Binary words of a logger: readings that wrap around, misread signs, missing signs, dead bands and stuck bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.constants import MICRO_G
from srt.diagnosis.findings import Fault, by_sensor
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array


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
    data = evidence.data
    if data is None or evidence.recording.fixture is None:
        return
    turned = [s.axes * s.angles_rad[:, None] for s in data.catalogue if s is not None]
    stated = {
        "gyro": np.concatenate(turned) if turned else np.zeros((0, 3)),
        "accel": evidence.poses[0] / evidence.recording.site.gravity_m_s2,
    }
    for sensor, table in (("gyro", evidence.rate), ("accel", evidence.force)):
        if sensor in evidence.wrapped_readings:
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
    if sensor in evidence.wrapped_readings:
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
