"""Sampling intervals and gaps, from time stamps with rounding, jitter and interruptions.

A gyro scale factor is an integral over time, so the difference of two rounded stamps as an interval would turn the
rounding into scale-factor noise. Stamps that lie on a straight line to within their rounding therefore give *one*
interval, the slope of that line. Other stamps give one interval per sample.

A *gap* is an interruption of the recording; its index is that of the first sample of the next contiguous piece. All
pieces have the same slope; each has its own start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import stdtrit

from srt.exceptions import InputError

if TYPE_CHECKING:
    from srt.types import Array, Indices

GAP_STEPS: Final = 1.5
"""Shortest step that is a gap, in intervals."""

ROUNDING_FRACTION: Final = 0.02
"""Largest deviation of rounded stamps from a straight line, in intervals."""

_BURST_SAMPLES = 32  # largest burst of samples that a host stamps at once
_MANY_GAPS = 0.05  # fraction of long steps above which they are rounding, not gaps
_FEW_STEPS = 100  # number of steps up to which rounding and gaps cannot be told apart
_ROUNDING_UNITS = 0.6  # largest deviation of rounded stamps, in units of their last digit: 0.5, and 0.1 for the fit
_TICK_ERROR = 0.01  # largest distance of steps from whole ticks, in ticks, by rounding
_TICK_SHARE = 0.1  # least distance of the interval from whole ticks, in ticks: a burst then shows all delays
_PARTS = 10  # parts of a recording whose intervals show the precision of its stamps
_CHANCE = 1e-6  # probability of an error of their mean interval beyond its precision
_CLOCK_ROUNDS = 3  # rounds of gaps and of the interval between them
_RATE_MISMATCH = 0.2  # relative; MEMS oscillators deviate by up to 10 %, so more is a wrong number in the file


@dataclass(frozen=True, slots=True)
class SampleTiming:
    """Intervals and gaps of one recording."""

    interval_s: float | Array  # duration of each sample, shape (n,), s; one number for a uniform recording
    nominal_interval_s: float  # the typical interval, s
    gaps: Indices  # first samples of contiguous pieces, without the first piece


def sample_timing(time: Array, sample_rate_hz: float | None = None) -> SampleTiming:
    """Sampling intervals and gaps of strictly increasing stamps, shape (n,), s, n >= 2.

    A given rate overrides the spacing of the stamps; InputError if it differs from theirs by more than 20 %.
    """
    steps = np.diff(time)
    if sample_rate_hz is not None:
        interval = 1.0 / sample_rate_hz
        gaps = _gaps_at_known_interval(time, steps, interval)
        _check_rate(time, steps, gaps, sample_rate_hz)
        return SampleTiming(interval, interval, _read_only(gaps))

    typical = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP_STEPS * typical) + 1
    if gaps.size > _MANY_GAPS * steps.size and steps.size > _FEW_STEPS:
        # Stamps rounded to nearly an interval (800 Hz in whole milliseconds) have steps of one or two units, but lie
        # on a straight line.
        resolution = stamp_resolution(time)
        fewer = np.flatnonzero(steps > max(GAP_STEPS * typical, typical + 1.01 * resolution)) + 1
        slope, deviation = _common_line(time, fewer, typical)
        if deviation <= _ROUNDING_UNITS * resolution and fewer.size <= _MANY_GAPS * steps.size:
            return SampleTiming(slope, slope, _read_only(fewer))
        coarse = _coarse_clock(time, steps)
        if coarse is not None:
            return coarse
    slope, deviation = _common_line(time, gaps, typical)
    if deviation <= ROUNDING_FRACTION * slope or deviation <= _ROUNDING_UNITS * stamp_resolution(time):
        return SampleTiming(slope, slope, _read_only(gaps))
    coarse = _coarse_clock(time, steps)
    if coarse is not None:
        return coarse
    interval_s = np.concatenate(([slope], steps))
    interval_s[gaps] = slope
    interval_s.flags.writeable = False
    return SampleTiming(interval_s, slope, _read_only(gaps))


def stamp_resolution(time: Array) -> float:
    """Coarsest decimal unit (1 s ... 1 ns) of which all stamps, shape (n,), s, are multiples; else their spacing."""
    floor = float(np.spacing(max(abs(time[0]), abs(time[-1]))))
    probe = time[:: max(1, time.size // 1000)]
    for decimals in range(10):
        unit = 10.0**-decimals
        if unit < 1e3 * floor:
            break
        # A few stamps first, which exclude nearly every unit.
        if _are_multiples(probe, unit, floor) and _are_multiples(time, unit, floor):
            return unit
    return floor


def _are_multiples(time: Array, unit: float, floor: float) -> bool:
    remainder = time / unit
    remainder -= np.rint(remainder)
    return bool(max(-remainder.min(), remainder.max()) * unit <= 4.0 * floor + 1e-6 * unit)


def _gaps_at_known_interval(time: Array, steps: Array, interval: float) -> Indices:
    """Gaps for a known rate: a late stamp is a gap only if the stamps after it are late too.

    A host stamps samples in bursts; the long step before a burst is compensated by the short steps in it.
    """
    late = np.flatnonzero(steps > GAP_STEPS * interval) + 1
    return _lasting_delays(time, late, interval, (GAP_STEPS - 1.0) * interval)


def _lasting_delays(time: Array, late: Indices, interval: float, least_s: float) -> Indices:
    """Late stamps of which all in the burst from there on are later than all in the burst before, by a time at least.

    Beside one of a coarse clock a sample may be told twice, which makes a piece of one sample.
    """
    if late.size == 0:
        return late
    before = np.full(late.size, -np.inf)
    after = np.full(late.size, np.inf)
    for k in range(_BURST_SAMPLES):
        i = np.maximum(late - 1 - k, 0)
        np.maximum(before, time[i] - i * interval, out=before)
        i = np.minimum(late + k, time.size - 1)
        np.minimum(after, time[i] - i * interval, out=after)
    lasting: Indices = late[after - before > least_s]
    return lasting


def _coarse_clock(time: Array, steps: Array) -> SampleTiming | None:
    """Timing of even samples with stamps of a coarse clock, as 4 or 8 ms for 5 ms; None if they are no such ones.

    The stamps are late by up to one tick. All of that shows within a burst if the interval is no multiple of the tick;
    from a gap on, the stamps are later by another interval.
    """
    tick = float(steps.min())
    if np.abs(steps / tick - np.rint(steps / tick)).max() > _TICK_ERROR or steps.size <= _BURST_SAMPLES:
        return None
    # Most pieces of this length have no gap.
    interval = float(np.median(time[_BURST_SAMPLES:] - time[:-_BURST_SAMPLES])) / _BURST_SAMPLES
    if abs(interval / tick - round(interval / tick)) < _TICK_SHARE:
        return None
    for _ in range(_CLOCK_ROUNDS):
        gaps = _lasting_delays(time, np.flatnonzero(steps > interval) + 1, interval, 0.5 * interval - tick)
        interval, deviation = _common_line(time, gaps, interval)
    return SampleTiming(interval, interval, _read_only(gaps)) if deviation <= _ROUNDING_UNITS * tick else None


def _check_rate(time: Array, steps: Array, gaps: Indices, sample_rate_hz: float) -> None:
    contiguous = steps.size - gaps.size
    if contiguous >= gaps.size:
        found = (float(time[-1] - time[0]) - float(steps[gaps - 1].sum())) / contiguous
    else:
        found = float(np.median(steps))
    if abs(found * sample_rate_hz - 1.0) > _RATE_MISMATCH:
        raise InputError(
            f"sample_rate_hz is {sample_rate_hz:g}, an interval of {1.0 / sample_rate_hz:.6g} s, but the "
            f"time stamps advance by {found:.6g} s per sample: correct the rate or the time unit, "
            "or leave the rate out.",
            fault="rate_contradicts_stamps",
        )


def _common_line(time: Array, gaps: Indices, typical: float) -> tuple[float, float]:
    """Interval common to all pieces by least squares, and half the largest range of deviations in a piece.

    Indices and times are relative to the start of each piece: with gaps of hours, the rounding of absolute times would
    exceed the interval's accuracy.
    """
    starts = np.concatenate(([0], gaps))
    lengths = np.diff(np.append(starts, time.size))
    local = np.arange(time.size, dtype=np.float64)
    if gaps.size:
        local -= np.repeat(starts, lengths)
        deviation = time - np.repeat(time[starts], lengths)
    else:
        deviation = time - time[0]
    deviation -= typical * local
    m = lengths.astype(np.float64)
    # sum of (i - mean i) d, and of (i - mean i)² = m (m² - 1) / 12 per piece
    cross = np.add.reduceat(local * deviation, starts) - 0.5 * (m - 1.0) * np.add.reduceat(deviation, starts)
    correction = float(cross.sum() / (m * (m * m - 1.0) / 12.0).sum())
    deviation -= correction * local
    ranges = np.maximum.reduceat(deviation, starts) - np.minimum.reduceat(deviation, starts)
    return typical + correction, 0.5 * float(ranges.max())


def stamped_interval(time: Array, gaps: Indices) -> tuple[float, float]:
    """Sampling interval by the time stamps, shape (n,), s, and the largest error by their scatter; inf for too few.

    The scatter is that of the intervals of ten parts: it holds jitter, bursts, and a drift of the clock.
    """
    typical = float(np.median(np.diff(time)))
    if time.size < _FEW_STEPS:
        return typical, math.inf
    edges = np.linspace(0, time.size, _PARTS + 1).astype(int).tolist()
    slopes = np.array(
        [_common_line(time[a:b], gaps[(gaps > a) & (gaps < b)] - a, typical)[0] for a, b in pairwise(edges)]
    )
    sigma = float(slopes.std(ddof=1)) / math.sqrt(_PARTS)
    return float(slopes.mean()), float(-stdtrit(_PARTS - 1, 0.5 * _CHANCE)) * sigma


def _read_only(indices: Indices) -> Indices:
    indices.flags.writeable = False
    return indices
