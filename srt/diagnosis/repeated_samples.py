"""Repeated samples: runs that are longer than by chance, and single repeats that are more frequent.

Sound readings repeat, too: coarse readings often, and those of a quantized gyro at a steady rate for long. A run
therefore counts only if it is longer than by chance at the frequency of repeats next to it, and more than twice as long
as the longest runs of the other windows (or rotations).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.false_alarms import FALSE_ALARM
from srt.diagnosis.rotation_readings import BESIDE

if TYPE_CHECKING:
    from srt.diagnosis.evidence import Evidence
    from srt.types import Indices

BY_CHANCE: Final = 0.5 * FALSE_ALARM
"""False-alarm probability of all runs, and of all single repeats. It assumes independent repeats. The pulses of a
steady input are evenly spaced, so that the true probability is smaller."""
_LONGER: Final = 2.0
"""Smallest ratio of a run to the ordinary runs of the other windows (or rotations) for a finding. In noise-free
readings a whole rotation is one run, and a rotation of 360° lasts twice as long as one of 180°."""
PULSES: Final = 8.0
"""Smallest ratio of a run to the longest run next to it for a finding: where a changing rate passes a whole number of
pulses per sample, sound readings repeat for up to five times as long as before and after."""
_CHUNK: Final = 50
"""Fewest samples over which the frequency of repeats is averaged: a pause between rotations is as short."""
_SHORT: Final = 3
"""Largest number of repeats in a row for a sample that was written twice or a few times."""
_FROZEN: Final = 0.9
"""Share of repeated samples of the other sensor from which that sensor counts as frozen, too."""


def repeated_runs(evidence: Evidence) -> list[tuple[int, int] | None]:
    """First sample, and number of repeats, of the longest run that chance does not explain, by row of the repeats.

    A run of one triad is found only if the other triad changes meanwhile, a run of one channel only if its triad
    changes, and none at the largest or smallest reading, where the channel saturates.
    """
    data = evidence.data
    found: list[tuple[int, int] | None] = [None] * len(evidence.repeats)
    if data is None:
        return found
    same, windows, columns = evidence.repeats, data.windows.samples, evidence.columns
    parts = np.concatenate([windows[data.start], windows[data.end], data.rotation])
    turning = np.arange(len(parts)) >= 2 * data.K
    parts, turning = (x[parts[:, 1] - parts[:, 0] > 1] for x in (parts, turning))
    # Number of repeats up to each sample. A run is cut where a window or rotation begins.
    place = np.arange(same.shape[1] + 1, dtype=np.int32)
    cut = np.pad(~same, ((0, 0), (0, 1)), constant_values=True)
    cut[:, parts[parts[:, 0] > 0, 0] - 1] = True
    count = place - np.maximum.accumulate(np.where(cut, place, np.int32(-1)), axis=1)
    pairs = np.stack([parts[:, 0], parts[:, 1] - 1], axis=1)
    longest = np.maximum.reduceat(count, pairs.ravel(), axis=1)[:, ::2]
    total = int((pairs[:, 1] - pairs[:, 0]).sum())
    ordinary = [np.quantile(longest[:, kind], 0.9, axis=1) for kind in (turning, ~turning) if kind.any()]
    for row, k in np.argwhere(longest > _LONGER * np.max([np.zeros(9), *ordinary], axis=0)[:, None]).tolist():
        n, (a, b), best = int(longest[row, k]), pairs[k].tolist(), found[row]
        other = 3 - row if row < 3 else row // 3  # the other sensor, or the triad of a channel
        first = a + int(np.argmax(count[row, a:b])) - n + 1
        own = columns[row - 3 : row - 2] if row > 2 else columns[3 * row - 3 : 3 * row]
        span = max(_CHUNK, 2 * n)
        beside = np.r_[max(a, first - span) : first, first + n : min(b, first + n + span)]
        frequency = (np.count_nonzero(same[row, beside]) + 1) / (len(beside) + 1)
        if (
            (best is None or n > best[1])
            and n * math.log(frequency) < math.log(BY_CHANCE / (len(same) * total))
            and n > PULSES * count[row, beside].max(initial=0)
            and (row == 0 or np.mean(same[other, first : first + n]) < _FROZEN)
            and not (row and np.all((own[:, first] == own.min(axis=1)) | (own[:, first] == own.max(axis=1))))
            and not (row > 2 and _goes_on(evidence, row - 3, (a, first, first + n, b + 1)))
        ):
            found[row] = first, n
    return found


def _goes_on(evidence: Evidence, channel: int, bounds: tuple[int, int, int, int]) -> bool:
    """True if the pulses of one channel continue before and after a run as in the run: the channel is not frozen.

    The pulses of a steady input may repeat for any time. A freeze ends with a jump, but a changing rate changes no
    faster at the end of the run than at the next sample. ``bounds`` are those of the run (inclusive) in those of its
    window or rotation.
    """
    recording, data = evidence.recording, evidence.data
    sensor, axis = ("gyro", "accel")[channel // 3], channel % 3
    pulse, (a, first, last, b) = getattr(recording.noise, f"{sensor}_quantization"), bounds
    assert data is not None
    if pulse is None:
        return False
    # White noise makes a random walk of the counted angle, which stays within one pulse over n samples with
    # p = exp(−n (π σ)² / 2), for a noise σ of a sample in pulses.
    sigma = getattr(data.noise, f"{sensor}_white")[axis] * math.sqrt(evidence.dt) / pulse
    if 0.5 * (last - first) * (math.pi * sigma) ** 2 > -math.log(BY_CHANCE):
        return False
    column = evidence.columns[channel]
    value, unit = float(column[first]), pulse / (evidence.dt * evidence.per_rate)
    for beside in (column[max(a, first - BESIDE) : first][::-1], column[last + 1 : min(b, last + 1 + BESIDE)]):
        changes = np.abs(np.diff(beside[:2], prepend=value))
        # Evenly spaced pulses differ by one. The median, because the edge of a window may lie within a sample.
        steady = len(beside) == 0 or round(abs(float(np.median(beside)) - value) / unit) <= 1
        if not (steady or (len(changes) == 2 and round((changes[0] - changes[1]) / unit) <= 1)):
            return False
    return True


def single_repeats(evidence: Evidence) -> list[tuple[Indices, float]]:
    """Samples that repeat the previous one in all channels, at most three times, and their number by chance.

    One pair is for the windows, the other for the rotations, in which pulses hardly repeat. By chance, gyros and
    accelerometers repeat independently: the product of both frequencies, which vary from chunk to chunk.
    """
    found: list[tuple[Indices, float]] = []
    for parts in () if evidence.data is None else (evidence.data.windows.samples, evidence.data.rotation):
        at = np.concatenate([np.arange(a, b - 1) for a, b in parts.tolist()])
        if at.size == 0:
            continue
        every, gyro, accel = evidence.repeats[:3, at]
        by_gyro, by_accel = (
            np.add.reduceat(x.astype(np.float64), np.arange(0, at.size, _CHUNK)) for x in (gyro, accel)
        )
        edges = np.flatnonzero(np.diff(np.concatenate(([False], every, [False]))))
        rows = at[edges[::2][np.diff(edges)[::2] <= _SHORT]] + 1
        found.append((rows, float(by_gyro @ by_accel) / _CHUNK))
    return found
