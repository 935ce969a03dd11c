"""How often rows of readings repeat, and which runs of repeats are more than chance.

Coarse readings repeat by nature, and a quantised gyro that turns steadily repeats for long: what is too long a run is
therefore told by the recording itself. A run counts only if it is longer than repeats as frequent as those right
before or right after it ever form, and twice as long as the runs of the other windows (or turns).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from srt.diagnosis.evidence import Evidence
    from srt.types import Array, Indices, Mask


FALSE_ALARM: Final = 1e-6
"""Of one run in one recording, taking repeats as independent. They are less clustered than that (pulses of a steady
input come evenly), so that the true one is smaller."""
_LONGER: Final = 2.0
"""A run must exceed those of its like by this factor: turns of 180° and 360° run for times a factor 2 apart, and in
readings without noise a whole turn is one run."""
_QUANTILE: Final = 0.9
_FEWEST: Final = 3
"""Windows (or turns), with fewer of which there is nothing to compare with."""
_BESIDE: Final = (1, 3)
_LEAST_BESIDE: Final = 100
"""Rows looked at on either side of a run: once its length, where readings coarser than their noise change into and out
of rows that repeat, and three times its length, at least a hundred."""
_PULSES: Final = 8.0
"""A run must exceed those beside it by this factor: where the pulses of a rate that changes pass through a whole number
for each sample, they pause for up to five times as long as before and after."""
_SUPPORT: Final = 3
"""Repeats added to those counted there: with none seen the rate may still be three over their number."""
_GOES_ON: Final = 0.9
"""Share of the other sensor's rows that may repeat in the run, if that sensor is to be going on."""


@dataclass(frozen=True, slots=True)
class RepeatRun:
    """Rows that repeat: ``count`` samples hold what sample ``first`` reads."""

    first: int
    count: int


def repeated_runs(evidence: Evidence) -> tuple[list[RepeatRun], list[RepeatRun], list[RepeatRun]]:
    """Runs too long for chance, of rows in all six channels, in the gyros and in the accelerometers.

    Runs of one sensor are given only where the other goes on. Nothing is found without windows.
    """
    if evidence.data is None:
        return [], [], []
    data, windows = evidence.data, evidence.data.windows.samples
    runs: tuple[list[RepeatRun], list[RepeatRun], list[RepeatRun]] = ([], [], [])
    likes = np.zeros((3, 3, data.K), dtype=np.intp)
    for k, (s, e) in enumerate(zip(data.start.tolist(), data.end.tolist(), strict=True)):
        first, edges = int(windows[s, 0]), (int(windows[s, 1]), int(windows[e, 0]), int(windows[e, 1]))
        gyro, accel = (
            _repeats(table, first, edges[2]) for table in (evidence.recording.gyro, evidence.recording.accel)
        )
        for which, same in enumerate((gyro & accel, gyro, accel)):
            start, count = _longest(same)
            other = (None, accel, gyro)[which]
            held = other is not None and count > 0 and other[start : start + count].mean() >= _GOES_ON
            runs[which].append(RepeatRun(first + start, 0 if held else count))
            if same.any():
                parts = np.split(same, [edge - first - 1 for edge in edges[:2]])
                likes[which, :, k] = [_longest(part)[1] for part in parts]
    total = int((windows[data.end, 1] - windows[data.start, 0]).sum())
    found: tuple[list[RepeatRun], list[RepeatRun], list[RepeatRun]] = ([], [], [])
    for which, longest in enumerate(runs):
        like = max(_ordinary(likes[which, (0, 2)].ravel()), _ordinary(likes[which, 1]))
        found[which].extend(
            run for run in longest if run.count > like and run.count > _by_chance(evidence, which, run, total)
        )
    return found


def _ordinary(longest: Indices) -> float:
    """Length of run that is not out of the ordinary for windows, or for turns."""
    return _LONGER * float(np.quantile(longest, _QUANTILE)) if len(longest) >= _FEWEST else math.inf


def _repeats(table: Array, a: int, b: int) -> Mask:
    """Whether each of the rows a + 1 to b - 1 is the one before it."""
    same: Mask = table[a + 1 : b, 0] == table[a : b - 1, 0]
    if same.any():  # of readings with noise nearly none is
        same &= np.all(table[a + 1 : b, 1:] == table[a : b - 1, 1:], axis=1)
    return same


def _longest(same: Mask) -> tuple[int, int]:
    """Start and length of the longest run of True."""
    if not same.any():
        return 0, 0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False]))))
    lengths = edges[1::2] - edges[::2]
    k = int(np.argmax(lengths))
    return int(edges[2 * k]), int(lengths[k])


def _by_chance(evidence: Evidence, which: int, run: RepeatRun, total: int) -> float:
    """Repeats in a row that rows like those beside a run form once in so many recordings, by the more frequent side."""
    recording = evidence.recording
    n, after = len(recording.time), run.first + run.count + 1
    rate, longest = 0.0, 0
    for beside in (_BESIDE[0] * run.count, max(_LEAST_BESIDE, _BESIDE[1] * run.count)):
        for a, b in ((max(0, run.first - beside), run.first), (after, min(n, after + beside))):
            if b - a < 2:
                continue
            gyro, accel = _repeats(recording.gyro, a, b), _repeats(recording.accel, a, b)
            same = (gyro & accel, gyro, accel)[which]
            repeats = np.count_nonzero(same)
            longest = max(longest, _longest(same)[1])
            if repeats or beside >= _LEAST_BESIDE:
                rate = max(rate, (repeats + _SUPPORT) / (len(same) + _SUPPORT))
    if not 0.0 < rate < 1.0:
        return math.inf
    return max(math.log(FALSE_ALARM / total) / math.log(rate), _PULSES * longest)
