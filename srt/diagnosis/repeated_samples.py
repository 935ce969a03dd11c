"""Runs of repeated rows that are too long for chance.

Coarse readings repeat, and a quantized gyro at a steady rate repeats for long: the recording itself gives the limit. A
run counts only if it is longer than repeats as frequent as those next to it form by chance, and twice as long as the
runs of the other windows (or rotations).
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
"""Probability of one false run in a recording, if repeats are independent. Pulses of a steady input come evenly, so the
true probability is smaller."""
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
_GOES_ON: Final = 0.9
"""Share of the other sensor's rows that repeat, above which that sensor is frozen, too."""


@dataclass(frozen=True, slots=True)
class RepeatRun:
    """Run of repeated rows: ``count`` samples equal sample ``first``."""

    first: int
    count: int


def repeated_runs(evidence: Evidence) -> tuple[list[RepeatRun], list[RepeatRun], list[RepeatRun]]:
    """Runs too long for chance: of all six channels, of the gyros, and of the accelerometers.

    A run of one sensor is given only where the other sensor changes. Without windows there are none.
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
            both = other is not None and count > 0 and other[start : start + count].mean() >= _GOES_ON
            runs[which].append(RepeatRun(first + start, 0 if both else count))
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
    """Longest ordinary run of windows, or of rotations."""
    return _LONGER * float(np.quantile(longest, _QUANTILE)) if len(longest) >= _FEWEST else math.inf


def _repeats(table: Array, a: int, b: int) -> Mask:
    """True for each of the rows a + 1 to b - 1 that equals the row before it."""
    same: Mask = table[a + 1 : b, 0] == table[a : b - 1, 0]
    if same.any():  # rare with noise
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
    """Length of the runs that repeats as frequent as those next to a run form by chance, by the more frequent side."""
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
