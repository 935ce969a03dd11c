"""How long each sample lasts, read from time stamps that loggers round, jitter and interrupt.

A gyro scale factor is an integral over time, so an interval taken from the difference of two rounded stamps
turns the rounding into noise of that scale factor. Stamps that lie on a straight line to within their own
rounding therefore give *one* interval, the slope of that line; only stamps that scatter more than that are
believed one by one.

A *gap* is where the recording was interrupted: the first sample of a new contiguous piece. The slope is
common to all pieces, the start of each piece is its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError

if TYPE_CHECKING:
    from srt.types import Array, Indices

GAP_STEPS: Final = 1.5
"""A step longer than this many intervals is a gap."""

ROUNDING_FRACTION: Final = 0.02
"""Deviation from a straight line, in intervals, up to which stamps count as merely rounded."""

_BURST_SAMPLES = 32  # host-stamped samples arrive in bursts of up to this many
_MANY_GAPS = 0.05  # a share of long steps above which they are no interruptions
_FEW_STEPS = 100  # too few to tell rounding from interruptions
_ROUNDING_UNITS = 0.6  # rounding moves a stamp by half a unit either way; some more for the fit
_RATE_MISMATCH = 0.2  # MEMS oscillators are off by up to 10 %; more is a wrong number in the file


@dataclass(frozen=True, slots=True)
class SampleTiming:
    """Intervals and gaps of one recording.

    Attributes
    ----------
    interval_s : float or ndarray, shape (n,), s
        Duration that each sample covers: one number where the recording is uniform.
    nominal_interval_s : float
        The typical interval, s.
    gaps : ndarray of int
        Indices of the samples that start a new contiguous piece (never 0).
    """

    interval_s: float | Array
    nominal_interval_s: float
    gaps: Indices


def sample_timing(time: Array, sample_rate_hz: float | None = None) -> SampleTiming:
    """Find intervals and gaps.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Strictly increasing stamps, n >= 2.
    sample_rate_hz : float, optional
        A rate that overrides the spacing of the stamps.

    Returns
    -------
    SampleTiming

    Raises
    ------
    InputError
        If the given rate contradicts the stamps by more than a fifth.
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
        # Stamps rounded to nearly an interval (800 Hz in whole milliseconds) step by one unit or by two, and
        # keep to their line all the same.
        resolution = stamp_resolution(time)
        fewer = np.flatnonzero(steps > max(GAP_STEPS * typical, typical + 1.01 * resolution)) + 1
        slope, deviation = _common_line(time, fewer, typical)
        if deviation <= _ROUNDING_UNITS * resolution:
            return SampleTiming(slope, slope, _read_only(fewer))
    slope, deviation = _common_line(time, gaps, typical)
    if deviation <= ROUNDING_FRACTION * slope or deviation <= _ROUNDING_UNITS * stamp_resolution(time):
        return SampleTiming(slope, slope, _read_only(gaps))
    interval_s = np.empty(time.size)
    interval_s[1:] = steps
    interval_s[0] = slope
    interval_s[gaps] = slope
    interval_s.flags.writeable = False
    return SampleTiming(interval_s, slope, _read_only(gaps))


def stamp_resolution(time: Array) -> float:
    """Find the coarsest decimal unit (1 s ... 1 ns) of which all stamps are whole multiples.

    Parameters
    ----------
    time : ndarray, shape (n,), s

    Returns
    -------
    float
        s; the floating-point spacing of the stamps where there is no such unit.
    """
    floor = float(np.spacing(max(abs(time[0]), abs(time[-1]))))
    probe = time[:: max(1, time.size // 1000)]
    for decimals in range(10):
        unit = 10.0**-decimals
        if unit < 1e3 * floor:
            break
        # Cheap look at a few stamps first: nearly every unit is ruled out there.
        if _are_multiples(probe, unit, floor) and _are_multiples(time, unit, floor):
            return unit
    return floor


def _are_multiples(time: Array, unit: float, floor: float) -> bool:
    remainder = time / unit
    remainder -= np.rint(remainder)
    return bool(max(-remainder.min(), remainder.max()) * unit <= 4.0 * floor + 1e-6 * unit)


def _gaps_at_known_interval(time: Array, steps: Array, interval: float) -> Indices:
    """Find gaps when the rate is known: a late stamp is one only if the stamps after it stay late.

    Stamps set by the host come in bursts; the long step before one is made up for by the short ones in it.
    """
    late = np.flatnonzero(steps > GAP_STEPS * interval) + 1
    if late.size == 0:
        return late
    before = np.full(late.size, -np.inf)
    after = np.full(late.size, np.inf)
    for k in range(_BURST_SAMPLES):
        i = np.maximum(late - 1 - k, 0)
        np.maximum(before, time[i] - i * interval, out=before)
        i = np.minimum(late + k, time.size - 1)
        np.minimum(after, time[i] - i * interval, out=after)
    lasting: Indices = late[after - before > (GAP_STEPS - 1.0) * interval]
    return lasting


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
    """Fit the interval common to all pieces; return it and half the largest range of deviations in a piece.

    Sums run over indices and times relative to the start of each piece: with gaps of hours, sums over
    absolute ones would lose the interval in rounding.
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
    spread = np.maximum.reduceat(deviation, starts) - np.minimum.reduceat(deviation, starts)
    return typical + correction, 0.5 * float(spread.max())


def _read_only(indices: Indices) -> Indices:
    indices.flags.writeable = False
    return indices
