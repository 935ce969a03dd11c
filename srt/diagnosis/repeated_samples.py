"""Runs of repeated samples that are longer than by chance.

Sound readings repeat, too: coarse readings often, and those of a quantized gyro at a steady rate for long. The limit
therefore follows from the recording itself. A run counts only if it is longer than the runs expected by chance at the
frequency of repeats next to it, and more than twice as long as the longest runs of the other windows (or rotations).
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
"""False-alarm probability for one recording, for each of nine kinds of run and two kinds of single repeats. It assumes
independent repeats. The pulses of a steady input are evenly spaced, so that the true probability is smaller."""
_LONGER: Final = 2.0
"""Smallest ratio of a run to the ordinary runs of the other windows (or rotations) for a finding. In noise-free
readings a whole rotation is one run, and a rotation of 360° lasts twice as long as one of 180°."""
_QUANTILE: Final = 0.9
"""Quantile of the longest runs of the windows (or rotations) that is taken as the ordinary run."""
_FEWEST: Final = 3
"""Fewest windows (or rotations) for a comparison of their runs."""
_BESIDE: Final = (1, 3)
_LEAST_BESIDE: Final = 100
"""Numbers of samples on each side of a run in which repeats are counted, relative to the length of the run. The shorter
span shows where readings coarser than their noise begin to repeat; the longer one has at least 100 samples."""
_PULSES: Final = 8.0
"""Smallest ratio of a run to the longest run next to it for a finding: where a changing rate passes a whole number of
pulses per sample, sound readings repeat for up to five times as long as before and after."""
_SUPPORT: Final = 3
"""Number of repeats added to those counted: if none is counted, the frequency of repeats may still be 3 divided by the
number of samples (95 % upper limit)."""
_CHUNK: Final = 50
"""Number of samples over which the frequency of repeats is averaged: a pause between rotations is as short."""
_SHORT: Final = 3
"""Largest number of repeats in a row for a sample that was written twice or a few times."""
_MOVED: Final = 0.25
"""Noise of a sample, in pulses, above which the readings of a steady input change: 50 equal readings have p = 1e-7."""
_BESIDE_PULSES: Final = 10
"""Number of samples on each side of a run from which the rate before and after it is taken."""
_IN_PART: Final = 0.9
"""Smallest share of a run that must lie in a window or rotation for a comparison with this part alone."""
_STEADY: Final = 1.5
"""Largest difference of successive readings at a steady rate, in pulses: one pulse, and a margin for rounding."""
_GOES_ON: Final = 0.9
"""Share of repeated samples of the other sensor from which that sensor counts as frozen, too."""

_COMPANIONS: Final = (None, 2, 1, 1, 1, 1, 2, 2, 2)
"""Row of :func:`_repeats` that must change during a run, for each row: the other sensor, or the triad of a channel."""
_FIRST_CHANNEL: Final = 3
"""Number of the first row of :func:`_repeats` that is for a single channel."""


@dataclass(frozen=True, slots=True)
class RepeatRun:
    """Run of repeated samples: the ``count`` samples after sample ``first`` equal it."""

    first: int
    count: int


def repeated_runs(evidence: Evidence) -> list[list[RepeatRun]]:
    """Runs longer than by chance: a list for all channels, the gyros, the accelerometers, and each single channel.

    A run of one triad is listed only if the other triad changes meanwhile, a run of one channel only if its triad
    changes. Runs at the largest or smallest reading are left out, as the channel saturates there. Without stationary
    windows, the lists are empty.
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
    """True if a run of one channel, or of all channels of a triad, is at their largest or smallest readings."""
    if which == 0:
        return False
    channel = which - _FIRST_CHANNEL
    sensor, axes = (which - 1, slice(None)) if channel < 0 else (channel // 3, slice(channel % 3, channel % 3 + 1))
    columns = (evidence.recording.gyro, evidence.recording.accel)[sensor][:, axes]
    held = columns[run.first]
    return bool(np.all((held == columns.min(axis=0)) | (held == columns.max(axis=0))))


def _goes_on(evidence: Evidence, which: int, run: RepeatRun) -> bool:
    """True if the pulses of one channel continue before and after a run as in the run: the channel is not frozen.

    A steady input near a whole number of pulses per sample repeats for any time if the noise is small, so that the
    length of a run does not show a freeze. A freeze ends with a jump of the reading, but a changing rate changes no
    faster at the end of the run than at the next sample. If most of the run lies in one window or rotation, only
    samples of that part are compared.
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
        # The median, because the edge of a window may lie within a sample.
        steady = len(part) == 0 or abs(float(np.median(part)) - value) < most
        if not (steady or (len(changes) == 2 and changes[0] <= changes[1] + most)):
            return False
    return True


def _ordinary(longest: Indices) -> float:
    """Longest run that is ordinary, by the longest runs of the windows or of the rotations."""
    return _LONGER * float(np.quantile(longest, _QUANTILE)) if len(longest) >= _FEWEST else math.inf


def _repeats(recording: Recording, a: int, b: int) -> Mask:
    """True for each of the samples a + 1 to b - 1 that equals the previous sample, shape (9, b - a - 1).

    The rows are for all channels, the gyros, the accelerometers, and each of the six channels.
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
    # All rows are joined into one, with a False between them.
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
    """Longest run expected by chance at the frequency of repeats next to a run, on the side with more repeats."""
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
    """Samples that repeat the previous one in all channels, in runs of at most three, and their number by chance.

    One pair is for the windows, the other for the rotations, in which pulses hardly repeat. The expected number assumes
    that gyros and accelerometers repeat independently: it is the product of both frequencies, summed over chunks, as
    both frequencies are higher at rest.
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
