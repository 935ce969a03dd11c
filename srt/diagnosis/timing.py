"""Time stamps: their unit, their scatter, and samples missing inside a sequence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import check, finding
from srt.diagnosis.units import accel_scale_ratios, gyro_scale_ratios
from srt.recording.timing import ROUNDING_FRACTION
from srt.sequences.plausibility import LEGAL_RATIO, LONGEST_INTERVAL_S, SHORTEST_INTERVAL_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Indices

_UNITS: Final = (
    (1e-3, "milliseconds", "seconds"),
    (1e-6, "microseconds", "seconds"),
    (1e-9, "nanoseconds", "seconds"),
    (1e3, "seconds", "milliseconds"),
    (1e6, "seconds", "microseconds"),
    (1e9, "seconds", "nanoseconds"),
)
"""Factor that sets stamps right, what they are, and what they are declared as."""
_USUAL_S: Final = (1e-4, 0.11)
"""Intervals at which units are logged: 10 kHz to a little less than 10 Hz."""
_ALIKE: Final = math.log(1.8)
"""Half of a thousand-fold is far outside what an uncalibrated unit explains."""
_FEW_STEPS: Final = 100
_BURSTS: Final = 0.05
"""Share of steps that are long, above which these are no interruptions."""
_TURNING: Final = 0.2
"""Share of the fastest rate above which the unit turns."""
_SAMPLES: Final = 20_000
"""Rows looked at where all would tell no more."""
_NO_GAP: Final = 8.0
"""Sigmas of jitter that no step reaches by chance: 1e-15 each."""


def _unit(interval: float) -> tuple[float, str, str]:
    """Unit that brings an interval among the usual ones, else the nearest to them."""
    middle = math.sqrt(_USUAL_S[0] * _USUAL_S[1])
    usual = [row for row in _UNITS if _USUAL_S[0] <= interval * row[0] <= _USUAL_S[1]]
    return usual[0] if usual else min(_UNITS, key=lambda row: abs(math.log(interval * row[0] / middle)))


@check("time_unit")
def time_unit(evidence: Evidence) -> Iterator[Finding]:
    """A time unit is off by thousands: the interval is impossible, or all that is summed over time is off likewise."""
    interval = evidence.dt
    factor, unit, declared = _unit(interval)
    if not SHORTEST_INTERVAL_S <= interval <= LONGEST_INTERVAL_S:
        why = f"but {SHORTEST_INTERVAL_S:g} to {LONGEST_INTERVAL_S:g} s is expected"
        yield finding("time_unit", interval=interval, why=why, unit=unit, declared=declared)
        return
    if _USUAL_S[0] <= interval <= _USUAL_S[1] or not _USUAL_S[0] <= interval * factor <= _USUAL_S[1]:
        return
    # Summed rates go with the interval, and so do increments that are divided by it.
    turned, rest = gyro_scale_ratios(evidence).typical, accel_scale_ratios(evidence).typical
    rates = evidence.recording.kind == "rate"
    off, other = (1.0 / turned if rates else rest, rest if rates else turned) if turned > 0.0 else (math.nan, math.nan)
    if off > 0.0 and LEGAL_RATIO[0] < other < LEGAL_RATIO[1] and abs(math.log(off / factor)) < _ALIKE:
        what = "turns come out" if rates else "gravity comes out"
        why = f"and {what} {(turned if rates else rest):.3g} times as large as it is"
        yield finding("time_unit", interval=interval, why=why, unit=unit, declared=declared)


def _jitter(evidence: Evidence) -> tuple[float, float]:
    """One sigma of a stamp about an even rate, and its interval, s; sigma 0 where stamps are even or merely rounded."""
    recording = evidence.recording
    if recording.sample_rate_hz is not None or len(recording.time) < _FEW_STEPS:
        return 0.0, evidence.dt
    gaps, even = recording.gaps, evidence.dt
    bursts = gaps.size > _BURSTS * (len(recording.time) - 1)
    if isinstance(recording.interval_s, float) and not bursts:
        return 0.0, even
    steps = np.diff(recording.time)
    # Stamps set when a packet arrives come in bursts with long steps between them, which belong to the jitter; the
    # median step is then one inside a burst.
    if bursts:
        even = float(recording.time[-1] - recording.time[0]) / steps.size
    else:
        steps = np.delete(steps, gaps - 1)
    # Differences of steps, as a rate that wanders slowly is no jitter; of a white scatter they have six variances.
    return float(np.sqrt(np.mean(np.diff(steps) ** 2) / 6.0)), even


@check("stamp_jitter")
def stamp_jitter(evidence: Evidence) -> Iterator[Finding]:
    """Stamps that scatter by more than rounding are believed one by one, and turns take their scatter in."""
    sigma, interval = _jitter(evidence)
    if sigma > 0.5 * ROUNDING_FRACTION * interval:
        yield finding("stamp_jitter", jitter=sigma / interval, interval=interval)


@check("gap_in_sequence")
def gap_in_sequence(evidence: Evidence) -> Iterator[Finding]:
    """Steps of the stamps that are too long, between the first and the last sample of a sequence."""
    time, gaps = evidence.recording.time, evidence.recording.gaps
    if gaps.size == 0:
        return
    sigma, _ = _jitter(evidence)
    gaps = gaps[time[gaps] - time[gaps - 1] - evidence.dt > _NO_GAP * sigma]
    rows, title, more = _inside_labelled(evidence, gaps) if evidence.has_labels else _inside_turns(evidence, gaps)
    if rows.size:
        yield finding(
            "gap_in_sequence",
            title=title,
            duration=float(time[rows[0]] - time[rows[0] - 1]) - evidence.dt,
            time=float(time[rows[0]]),
            more=f" (and inside {more} other{'s' if more > 1 else ''})" if more else "",
        )


def _inside_labelled(evidence: Evidence, gaps: Indices) -> tuple[Indices, str, int]:
    """Gaps of the first sequence that has any, its name, and how many others have some."""
    data = evidence.data
    if data is None:
        return gaps[:0], "", 0
    first, last = data.windows.samples[data.start, 0], data.windows.samples[data.end, 1]
    inside = [gaps[(gaps > a) & (gaps < b)] for a, b in zip(first.tolist(), last.tolist(), strict=True)]
    void = [k for k, rows in enumerate(inside) if rows.size]
    if not void:
        return gaps[:0], "", 0
    title = evidence.title(void[0])
    return inside[void[0]], title[0].upper() + title[1:], len(void) - 1


def _inside_turns(evidence: Evidence, gaps: Indices) -> tuple[Indices, str, int]:
    """Gaps on both sides of which the unit turns; without labels, others may lie between sequences."""
    gyro = evidence.recording.gyro
    some = np.linalg.norm(gyro[:: max(1, len(gyro) // _SAMPLES)], axis=1)
    rest, fastest = np.median(some), some.max()
    size = np.linalg.norm(np.stack([gyro[gaps - 1], gyro[gaps]]), axis=2).min(axis=0)
    rows = gaps[size - rest > _TURNING * (fastest - rest)]
    return rows, "A turn", max(0, rows.size - 1)
