"""Time stamps: unit, jitter, drift, and gaps inside a sequence."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault
from srt.diagnosis.fitness import at_rest
from srt.diagnosis.scale_causes import TIME_UNITS, USUAL_S
from srt.diagnosis.units import scale_findings
from srt.recording.timing import ROUNDING_FRACTION
from srt.sequences.manoeuvres import MOVING
from srt.sequences.plausibility import LONGEST_INTERVAL_S, SHORTEST_INTERVAL_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding

_PARTS: Final = 10
"""Number of parts of a recording whose mean intervals are compared."""
_LEAST_DRIFT: Final = 1e-3
"""Smallest relative change of the interval for a finding: crystals are stable to 1e-4 over all temperatures."""
_SAME_UNIT: Final = math.log(2.0)
"""Largest logarithm of the ratio of rotation angles with the declared unit of time: others differ by 60 or more."""
_SLOW: Final = (
    "The samples are {interval:.3g} s apart, but at most {longest:g} s is expected, and no rotation shows another time "
    "unit{rest}: record at 10 Hz or more; if the stamps are in another unit, correct time_unit in recording.toml."
)
_BURSTS: Final = 0.05
"""Share of long steps above which these are not gaps, but pauses between bursts of samples."""


def time_unit(evidence: Evidence) -> Iterator[Finding]:
    """Test the time unit: the interval is impossible, or all integrals over time are wrong by the same factor."""
    interval = evidence.dt
    if SHORTEST_INTERVAL_S <= interval <= LONGEST_INTERVAL_S:
        yield from scale_findings(evidence, {TIME_UNIT.name: TIME_UNIT})
        return
    scales = evidence.gyro_scales if evidence.recording.kind == "rate" else evidence.accel_scales
    # Without rotation angles, or where they agree with the stamps, nothing shows a wrong unit: the log is slow.
    if interval > LONGEST_INTERVAL_S and not (scales.known and abs(math.log(scales.typical)) > _SAME_UNIT):
        rest = at_rest(evidence)
        rest = "" if rest is None else f" ({rest}, which shows no scale factor at any rate)"
        slow = replace(TIME_UNIT, title="The log is too slow to follow a rotation", message=_SLOW)
        yield slow.found(interval=interval, longest=LONGEST_INTERVAL_S, rest=rest)
        return
    _, unit, declared = _unit(evidence)
    why = f"but {SHORTEST_INTERVAL_S:g} to {LONGEST_INTERVAL_S:g} s is expected"
    yield TIME_UNIT.found(interval=interval, why=why, unit=unit, declared=declared)


TIME_UNIT: Final = Fault(
    "time_unit",
    "Wrong time unit",
    "the sampling interval, which is 5 µs to 0.5 s for an IMU; rotation angles or gravity, if they are wrong by the "
    "same factor",
    "The samples are {interval:.3g} s apart, {why}: the time stamps look like {unit}, declared as {declared}; correct "
    "time_unit (key of recording.toml, or argument).",
    "exit 1",
    time_unit,
)


def _unit(evidence: Evidence) -> tuple[float, str, str]:
    """Row of ``TIME_UNITS`` for the time unit with which the interval is a usual one.

    If several units give a usual interval, the ratio of the rotation angles (for increments: of gravity) decides. If no
    unit does, the unit with the interval nearest to the usual ones is returned.
    """
    usual = [row for row in TIME_UNITS if USUAL_S[0] <= evidence.dt * row[0] <= USUAL_S[1]]
    rates = evidence.recording.kind == "rate"
    ratio = (evidence.gyro_scales if rates else evidence.accel_scales).typical
    if len(usual) > 1 and ratio > 0.0:
        factor = 1.0 / ratio if rates else ratio
    else:
        factor = math.sqrt(USUAL_S[0] * USUAL_S[1]) / evidence.dt
    return min(usual or TIME_UNITS, key=lambda row: abs(math.log(row[0] / factor)))


def _jitter(evidence: Evidence) -> tuple[float, float]:
    """Standard deviation of the stamps about an even rate, and the interval of that rate, s.

    The standard deviation is 0 for stamps that are evenly spaced within their rounding.
    """
    recording, gaps = evidence.recording, evidence.recording.gaps
    bursts = gaps.size > _BURSTS * (len(recording.time) - 1)
    if recording.sample_rate_hz is not None or (isinstance(recording.interval_s, float) and not bursts):
        return 0.0, evidence.dt
    steps, even = np.diff(recording.time), evidence.dt
    # Stamps that are set on the arrival of packets come in bursts. The long steps between the bursts are jitter, not
    # gaps. As the median step is one inside a burst, the interval is the mean step.
    if bursts:
        even = float(recording.time[-1] - recording.time[0]) / steps.size
    else:
        steps = np.delete(steps, gaps - 1)
    # Second differences of the stamps exclude a slow drift. For white jitter, their variance is six times that of the
    # jitter.
    changes = np.diff(steps)
    return float(np.sqrt(changes @ changes / (6.0 * max(1, len(changes))))), even


def stamp_jitter(evidence: Evidence) -> Iterator[Finding]:
    """Find stamps that scatter by more than rounding: each stamp is used as it is, so that angles have its error."""
    sigma, interval = _jitter(evidence)
    if sigma > 0.5 * ROUNDING_FRACTION * interval:
        yield STAMP_JITTER.found(jitter=sigma / interval, interval=interval)


STAMP_JITTER: Final = Fault(
    "stamp_jitter",
    "The time stamps have jitter",
    "scatter of the steps of the time stamps about an even rate",
    "The time stamps have a jitter of {jitter:.2g} sampling intervals (rms; interval {interval:.4g} s), which causes "
    "errors of all rotation angles: state sample_rate_hz if the unit samples evenly, or log the clock of the unit.",
    "warning",
    stamp_jitter,
)


def clock_drift(evidence: Evidence) -> Iterator[Finding]:
    """Find stamps whose mean interval changes steadily from the first part of the recording to the last.

    Statistic: slope of the mean intervals over its standard deviation, which is from their second differences.
    Distribution: nearly t with half as many degrees of freedom as there are second differences, which are correlated.
    """
    recording = evidence.recording
    steps = np.delete(np.diff(recording.time), recording.gaps - 1)
    if recording.sample_rate_hz is not None or len(steps) < _PARTS:
        return
    means = np.array([part.mean() for part in np.array_split(steps, _PARTS)])
    place = np.arange(_PARTS) - 0.5 * (_PARTS - 1)
    slope = float(place @ means) / float(place @ place)
    # Second differences of the means exclude the drift. For white noise, their variance is six times that of the means.
    sigma = float(np.diff(means, 2).std()) / math.sqrt(6.0 * float(place @ place))
    change = slope * (_PARTS - 1) / float(means.mean())
    if abs(change) > _LEAST_DRIFT and abs(slope) > limit("t", 0.5 * (_PARTS - 2), both_sides=True) * sigma:
        yield CLOCK_DRIFT.found(change=100.0 * change, first=1e3 * float(means[0]), last=1e3 * float(means[-1]))


CLOCK_DRIFT: Final = Fault(
    "clock_drift",
    "The clock of the time stamps drifts",
    "change of the mean step of the time stamps over ten parts of the recording",
    "The steps of the time stamps change by {change:+.2g} % during the recording, from {first:.6g} to {last:.6g} ms, "
    "which causes errors of all rotation angles: state sample_rate_hz if the unit samples evenly, or log the clock of "
    "the unit.",
    "warning",
    clock_drift,
)


def gap_in_sequence(evidence: Evidence) -> Iterator[Finding]:
    """Find gaps of the time stamps between the first and the last sample of a sequence.

    Without labels, gaps at rest may lie between sequences: only gaps with rotation on both sides are found. Statistic:
    deviation of a step over the jitter. Distribution: normal.
    """
    time, gaps, gyro = evidence.recording.time, evidence.recording.gaps, evidence.recording.gyro
    if gaps.size == 0:
        return
    missing = time[gaps] - time[gaps - 1] - evidence.dt
    gaps = gaps[missing > limit("normal", tests=len(time)) * _jitter(evidence)[0]]
    title = "a rotation"
    if not evidence.has_labels:
        some = np.linalg.norm(evidence.some[0], axis=1)
        rest, fastest = np.median(some), some.max()
        size = np.linalg.norm(np.stack([gyro[gaps - 1], gyro[gaps]]), axis=2).min(axis=0)
        rows = gaps[size - rest > MOVING * (fastest - rest)]
    elif evidence.data is None:
        return
    else:
        data = evidence.data
        first = np.searchsorted(gaps, data.windows.samples[data.start, 0], side="right")
        void = np.flatnonzero(first < np.searchsorted(gaps, data.windows.samples[data.end, 1], side="left"))
        rows = gaps[first[void]]
        title = evidence.title(int(void[0])) if void.size else title
    if rows.size:
        more = rows.size - 1
        yield GAP_IN_SEQUENCE.found(
            title=title[0].upper() + title[1:],
            duration=float(time[rows[0]] - time[rows[0] - 1]) - evidence.dt,
            time=float(time[rows[0]]),
            more=f" (and inside {more} other{'s' if more > 1 else ''})" if more else "",
        )


GAP_IN_SEQUENCE: Final = Fault(
    "gap_in_sequence",
    "Samples are missing inside a sequence",
    "steps of the time stamps between the first and the last sample of a sequence",
    "{title}: samples are missing for {duration:.3g} s before {time:.6g} s, inside the sequence{more}: with a gap it "
    "cannot be used; repeat it.",
    "warning",
    gap_in_sequence,
)
