"""Runs of repeated rows that are too long for chance.

Coarse readings repeat, and a quantized gyro at a steady rate repeats for long: the recording itself gives the limit. A
run counts only if it is longer than repeats as frequent as those next to it form by chance, and twice as long as the
runs of the other windows (or rotations).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from srt.diagnosis.evidence import Evidence
    from srt.recording.recording import Recording
    from srt.types import Indices, Mask


FALSE_ALARM: Final = 5e-7
"""Probability of one false run in a recording, for each of nine kinds of run and two of single repeats, if repeats are
independent. Pulses of a steady input come evenly, so the true probability is smaller."""
_LONGER: Final = 2.0
"""Ratio of a run to those of the other windows (or rotations) from which it counts: rotations of 180° and 360° last
times a factor 2 apart, and in readings without noise a whole rotation is one run."""
_QUANTILE: Final = 0.9
"""Quantile of the longest runs of windows (or rotations) that is ordinary."""
_FEWEST: Final = 3
"""Windows (or rotations), fewer of which allow no comparison."""
_BESIDE: Final = (1, 3)
_LEAST_BESIDE: Final = 100
"""Rows counted on either side of a run: once its length, where readings coarser than their noise start and stop to
repeat, and three times its length, at least a hundred."""
_PULSES: Final = 8.0
"""Ratio of a run to those next to it from which it counts: where the pulses of a changing rate pass a whole number for
each sample, they pause for up to five times as long as before and after."""
_SUPPORT: Final = 3
"""Repeats added to those counted: with none seen, their rate may still be three over the number of rows."""
_CHUNK: Final = 50
"""Rows over which a share of repeats is taken: a pause between rotations is as short."""
_SHORT: Final = 3
"""Longest run of repeats that is a sample written twice, or a few times."""
_MOVED: Final = 0.25
"""Noise of a sample in pulses, above which a steady input does not repeat: 50 equal readings have p = 1e-7."""
_BESIDE_PULSES: Final = 10
"""Samples on either side of a run that tell the rate before and after it."""
_IN_PART: Final = 0.9
"""Share of a run in a window or rotation, from which it is one of this part."""
_STEADY: Final = 1.5
"""Pulses by which a steady rate differs from one sample to the next at most: one, and rounding."""
_GOES_ON: Final = 0.9
"""Share of the other sensor's rows that repeat, above which that sensor is frozen, too."""

_COMPANIONS: Final = (None, 2, 1, 1, 1, 1, 2, 2, 2)
"""For each row of :func:`_repeats`, the row that must change meanwhile: the other sensor; of a channel, its triad."""
_FIRST_CHANNEL: Final = 3
"""First row of a single channel."""


@dataclass(frozen=True, slots=True)
class RepeatRun:
    """Run of repeated rows: ``count`` samples equal sample ``first``."""

    first: int
    count: int


def repeated_runs(evidence: Evidence) -> list[list[RepeatRun]]:
    """Runs too long for chance, a list for each row of :func:`_repeats`: all, gyros, accelerometers, single channels.

    A run of one sensor is given only where the other sensor changes, that of one channel where its triad changes and
    not at the channel's extremes, where it saturates. Without windows there are none.
    """
    found: list[list[RepeatRun]] = [[] for _ in _COMPANIONS]
    if evidence.data is None:
        return found
    data, windows = evidence.data, evidence.data.windows.samples
    runs: list[list[RepeatRun]] = [[] for _ in _COMPANIONS]
    likes = np.zeros((len(_COMPANIONS), 3, data.K), dtype=np.intp)
    for k, (s, e) in enumerate(zip(data.start.tolist(), data.end.tolist(), strict=True)):
        first, edges = int(windows[s, 0]), (int(windows[s, 1]), int(windows[e, 0]), int(windows[e, 1]))
        rows = _repeats(evidence.recording, first, edges[2])
        found_here = zip(*(x.tolist() for x in _longest(rows)), _COMPANIONS, strict=True)
        for which, (start, count, companion) in enumerate(found_here):
            alike = companion is not None and rows[companion, start : start + count]
            both = count > 0 and np.mean(alike) >= _GOES_ON
            runs[which].append(RepeatRun(first + start, 0 if both else count))
        parts = np.split(rows, [edge - first - 1 for edge in edges[:2]], axis=1)
        likes[:, :, k] = np.stack([_longest(part)[1] for part in parts], axis=1)
    total = int((windows[data.end, 1] - windows[data.start, 0]).sum())
    for which, longest in enumerate(runs):
        like = max(_ordinary(likes[which, (0, 2)].ravel()), _ordinary(likes[which, 1]))
        found[which].extend(
            run
            for run in longest
            if run.count > like
            and run.count > _by_chance(evidence, which, run, total)
            and not _at_extreme(evidence, which, run)
            and not _goes_on(evidence, which, run)
        )
    return found


def _at_extreme(evidence: Evidence, which: int, run: RepeatRun) -> bool:
    """True for a run of one channel, or of all of a triad, at its largest or smallest reading."""
    if which == 0:
        return False
    channel = which - _FIRST_CHANNEL
    sensor, axes = (which - 1, slice(None)) if channel < 0 else (channel // 3, slice(channel % 3, channel % 3 + 1))
    columns = (evidence.recording.gyro, evidence.recording.accel)[sensor][:, axes]
    held = columns[run.first]
    return bool(np.all((held == columns.min(axis=0)) | (held == columns.max(axis=0))))


def _goes_on(evidence: Evidence, which: int, run: RepeatRun) -> bool:
    """True for pulses of one channel that are as many before and after a run as in it, or fill its window or rotation.

    A steady input near a whole number of pulses for each sample repeats for any time, unless noise moves it: no length
    tells a freeze from it. A run in one window or rotation, whose edges are known to some samples, is compared with it
    alone. Where the rate changes from a run on, it does so by no more than from the next sample on; a freeze ends with
    a jump.
    """
    channel, data = which - _FIRST_CHANNEL, evidence.data
    noise = evidence.recording.noise
    pulse = (noise.gyro_quantization, noise.accel_quantization)[channel // 3] if channel >= 0 else None
    if pulse is None or data is None:
        return False
    white = (data.noise.gyro_white, data.noise.accel_white)[channel // 3]
    if float(white[channel % 3]) * math.sqrt(evidence.dt) > _MOVED * pulse:
        return False
    recording = evidence.recording
    column = (recording.gyro, recording.accel)[channel // 3][:, channel % 3]
    step = pulse if recording.kind == "increment" else pulse / evidence.dt
    last = run.first + run.count + 1
    windows = data.windows.samples
    parts = np.concatenate([windows, np.stack([windows[data.start, 1], windows[data.end, 0]], axis=1)])
    common = np.minimum(parts[:, 1], last) - np.maximum(parts[:, 0], run.first)
    within = parts[common >= _IN_PART * (last - run.first)]
    a, b = within[0].tolist() if len(within) else (0, len(column))
    value, most = float(column[run.first]), _STEADY * step
    for part in (
        column[max(a, run.first - _BESIDE_PULSES) : run.first][::-1],
        column[last : min(b, last + _BESIDE_PULSES)],
    ):
        changes = np.abs(np.diff(part[:2], prepend=value))
        # The median: an edge may lie within a sample.
        steady = len(part) == 0 or abs(float(np.median(part)) - value) < most
        if not (steady or (len(changes) == 2 and changes[0] <= changes[1] + most)):
            return False
    return True


def _ordinary(longest: Indices) -> float:
    """Longest ordinary run of windows, or of rotations."""
    return _LONGER * float(np.quantile(longest, _QUANTILE)) if len(longest) >= _FEWEST else math.inf


def _repeats(recording: Recording, a: int, b: int) -> Mask:
    """True for each of the rows a + 1 to b - 1 that equals the row before it, shape (9, b - a - 1).

    In all channels, in those of the gyros, in those of the accelerometers, and in each of the six.
    """
    out = np.empty((9, max(b - a - 1, 0)), dtype=np.bool_)
    every, gyro, accel = out[:_FIRST_CHANNEL]
    for triad, x, single in ((gyro, recording.gyro, out[3:6]), (accel, recording.accel, out[6:])):
        np.equal(x[a + 1 : b].T, x[a : b - 1].T, out=single)
        np.logical_and.reduce(single, axis=0, out=triad)
    np.logical_and(gyro, accel, out=every)
    return out


def _longest(same: Mask) -> tuple[Indices, Indices]:
    """Starts and lengths of the longest runs of True in the rows of an array (R, n), shape (R,) each."""
    rows, n = same.shape
    # All rows as one, with a False between them.
    padded = np.zeros((rows, n + 1), dtype=np.bool_)
    padded[:, :n] = same
    joined = np.concatenate(([False], padded.ravel()))
    edges = np.flatnonzero(joined[1:] != joined[:-1])
    begins, lengths = edges[::2], edges[1::2] - edges[::2]
    borders = np.searchsorted(begins, np.arange(rows + 1) * (n + 1)).tolist()
    starts, counts = np.zeros(rows, dtype=np.intp), np.zeros(rows, dtype=np.intp)
    for row, (a, b) in enumerate(pairwise(borders)):
        if b > a:
            k = a + int(np.argmax(lengths[a:b]))
            starts[row], counts[row] = begins[k] - row * (n + 1), lengths[k]
    return starts, counts


def _by_chance(evidence: Evidence, which: int, run: RepeatRun, total: int) -> float:
    """Length of the runs that repeats as frequent as those next to a run form by chance, by the more frequent side."""
    recording = evidence.recording
    n, after = len(recording.time), run.first + run.count + 1
    rate, longest = 0.0, 0
    for beside in (_BESIDE[0] * run.count, max(_LEAST_BESIDE, _BESIDE[1] * run.count)):
        for a, b in ((max(0, run.first - beside), run.first), (after, min(n, after + beside))):
            if b - a < 2:
                continue
            same = _repeats(recording, a, b)[which : which + 1]
            repeats = np.count_nonzero(same)
            longest = max(longest, int(_longest(same)[1][0]))
            if repeats or beside >= _LEAST_BESIDE:
                rate = max(rate, (repeats + _SUPPORT) / (same.shape[1] + _SUPPORT))
    if not 0.0 < rate < 1.0:
        return math.inf
    return max(math.log(FALSE_ALARM / total) / math.log(rate), _PULSES * longest)


def single_repeats(evidence: Evidence) -> list[tuple[Indices, float]]:
    """Rows that repeat the row before them in all channels, in runs of at most three, and how many chance explains.

    In the windows, and in the rotations, where pulses hardly repeat. Where gyros and accelerometers repeat
    independently, rows repeat as often as the product of both shares says, chunk by chunk: both repeat at rest.
    """
    data = evidence.data
    if data is None:
        return []
    windows = data.windows.samples
    found: list[tuple[list[Indices], list[float]]] = [([], []), ([], [])]
    for s, e in zip(data.start.tolist(), data.end.tolist(), strict=True):
        for part, (a, b) in enumerate(pairwise([*windows[s].tolist(), *windows[e].tolist()])):
            if b - a < _LEAST_BESIDE:
                continue
            rows, expected = found[part % 2]
            every, gyro, accel = _repeats(evidence.recording, a, b)[:_FIRST_CHANNEL]
            borders = np.arange(0, len(every), _CHUNK)
            repeats = (np.add.reduceat(x.astype(np.float64), borders) for x in (gyro, accel, np.ones(len(every))))
            by_gyro, by_accel, rows_there = repeats
            expected.append(float(np.sum(by_gyro * by_accel / rows_there)))
            edges = np.flatnonzero(np.diff(np.concatenate(([False], every, [False]))))
            rows.append(a + 1 + edges[::2][np.diff(edges)[::2] <= _SHORT])
    return [(np.concatenate(rows), sum(expected)) for rows, expected in found if rows]
