"""Readings of binary words that wrap around, or whose sign is misread."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_WRAP_JUMP: Final = 0.9
"""Smallest jump of a wrapping reading between two samples, relative to the range of the channel."""
_WRAP_STEP: Final = 0.6
"""Smallest jump of a wrapping reading before the slope is subtracted, relative to the range."""
_WRAP_SLOPE: Final = 0.35
"""Largest slope of the reading next to a jump, per sample and relative to the range."""
_SIGN_EDGE: Final = 0.1
"""Width of the bands next to zero and next to an extreme in which small readings with a misread sign lie, relative to
that extreme."""
_SIGN_SHARE: Final = 0.01
"""Smallest share of the readings in each of these bands."""
_SIGN_FLIPS: Final = 5
"""Smallest number of jumps between both bands per window, as noise about zero makes them if the sign is misread."""
_SIGN_STAYS: Final = 10
"""Smallest number of jumps after which the readings of an accelerometer stay in the other band."""
_BEYOND: Final = 1.3
"""Smallest range of the unwrapped readings relative to the range of the word, for readings that wrap."""
_CONTINUES: Final = 0.2
"""Smallest rate of change at a jump for a search by unwrapping, relative to _WRAP_MOTION: single pulses at rest are
jumps, too."""
_SAME_RANGE: Final = 0.05
"""Largest median deviation of the ranges from single jumps, relative to the range: due to noise and changing slopes."""
_WRAPPED_SEQUENCES: Final = {"gyro": 2, "accel": 3}
"""Fewest sequences with unwrapped readings beyond the range of the word."""
_WRAP_SYMMETRY: Final = 0.02
"""Largest distance of the middle of the range from zero, relative to the range: the range of signed words is
symmetric."""
_WRAP_SAMPLES: Final = 5
"""Number of samples on each side of a jump whose medians must have different signs: a shock swings back at once."""
_WRAP_MOTION: Final = {"gyro": 50.0, "accel": 500.0}
"""Largest rate of change in a motion on a fixture or by hand, rad/s² and m/s³."""


def wrapped_readings(
    tables: Mapping[str, Array],
    recording: Recording,
    data: PreparedRecording | None,
    contiguous: Mask,
    sequence_at: Callable[[int], int | None],
) -> dict[str, tuple[int, Indices]]:
    """First axis of a triad that wraps, and the numbers of the samples after its jumps, by sensor.

    Parameters
    ----------
    tables : mapping of str to ndarray
        Readings of "gyro" and "accel" as rates, shape (n, 3), rad/s and m/s².
    recording : Recording
    data : PreparedRecording or None
    contiguous : ndarray of bool, shape (K,)
        True for each sequence without a gap.
    sequence_at : callable
        Number of the sequence that contains a sample.
    """
    dt = recording.nominal_interval_s
    found: dict[str, tuple[int, Indices]] = {}
    for sensor, table in tables.items():
        for axis, column in enumerate(np.ascontiguousarray(table.T)):
            low, high = float(column.min()), float(column.max())
            jumps = np.zeros(0, dtype=np.intp)
            if (high - low) / dt > _WRAP_MOTION[sensor]:
                jumps = np.union1d(_wraps(column, low, high), _of_wrong_sign(data, sensor, column, low, high))
                jumps = jumps[_within_sequences(recording, data, sequence_at, jumps)]
            if len(jumps) < 2:
                jumps = _continuous_beyond(data, contiguous, sensor, column)
            if len(jumps) >= 2:
                found[sensor] = axis, jumps
                break
    return found


def _within_sequences(
    recording: Recording, data: PreparedRecording | None, sequence_at: Callable[[int], int | None], samples: Indices
) -> Mask:
    """True for samples in the same sequence as the previous sample, without a gap between both."""
    inside = ~np.isin(samples, recording.gaps)
    if data is not None:
        sequences = [(sequence_at(i - 1), sequence_at(i)) for i in samples.tolist()]
        inside &= np.array([before is not None and before == after for before, after in sequences], dtype=np.bool_)
    return np.asarray(inside)


def _wraps(column: Array, low: float, high: float) -> Indices:
    """Samples after a jump from one extreme to the other, if the reading continues at its slope or stays there."""
    n, size, step = _WRAP_SAMPLES, high - low, np.diff(column)
    large = np.abs(step) > _WRAP_STEP * size
    if not high > 0.0 or abs(high + low) > _WRAP_SYMMETRY * size:
        return np.zeros(0, dtype=np.intp)
    jumps = np.flatnonzero(large) + 1
    jumps = jumps[(jumps >= n) & (jumps <= len(column) - n)]
    before, after = (np.median(column[jumps[:, None] + np.arange(a, a + n)], axis=1) for a in (-n, 0))
    stays = (before * after < 0.0) & (np.minimum(np.abs(before), np.abs(after)) > 0.25 * size)
    stays &= np.abs(step[jumps - 1]) > _WRAP_JUMP * size
    # The reading continues at its slope, and the jump is the whole range in the opposite direction.
    jump, slopes = step[jumps - 1], np.stack([step[jumps - 2], step[jumps]])
    slope = slopes.mean(axis=0)
    ramp = (np.abs(jump - slope) > _WRAP_JUMP * size) & (jump * slope < 0.0)
    ramp &= np.all((np.abs(slopes) < _WRAP_SLOPE * size) & (slopes * slope > 0.0), axis=0)
    ramp &= np.abs(jump - slope) < size / _WRAP_JUMP
    return np.asarray(jumps[stays | ramp], dtype=np.intp)


def _of_wrong_sign(data: PreparedRecording | None, sensor: str, column: Array, low: float, high: float) -> Indices:
    """Samples after a jump between zero and one of the extremes of a channel.

    If signed words are read as unsigned ones, small negative values appear at the upper end of the range. If words of
    sign and magnitude are read as two's complement, or the reverse, they appear at the lower end. Noise about zero then
    makes gyros jump at rest. A change of sign of the gravity component makes accelerometers jump in rotations.
    """
    for end in (low, high):
        size = abs(end)
        if data is None or size < _WRAP_JUMP * max(-low, high):
            continue
        at_zero, at_end = np.abs(column) < _SIGN_EDGE * size, np.abs(column - end) < _SIGN_EDGE * size
        if min(np.count_nonzero(at_zero), np.count_nonzero(at_end)) < _SIGN_SHARE * len(column):
            continue
        jumps = np.flatnonzero((at_zero[1:] & at_end[:-1]) | (at_end[1:] & at_zero[:-1])) + 1
        windows = data.windows.samples
        inside = np.searchsorted(windows[:, 0], jumps, side="left") - 1  # a jump to the first sample is not inside
        at_rest = (inside >= 0) & (jumps < windows[np.maximum(inside, 0), 1])
        if np.count_nonzero(at_rest) >= _SIGN_FLIPS * len(windows):
            return np.asarray(jumps)
        n = _WRAP_SAMPLES
        far = jumps[(jumps >= n) & (jumps <= len(column) - n)]
        before, after = (np.median(column[far[:, None] + np.arange(a, a + n)], axis=1) for a in (-n, 0))
        if sensor == "accel" and np.count_nonzero(np.abs(after - before) > _WRAP_STEP * size) >= _SIGN_STAYS:
            return np.asarray(jumps)
    return np.zeros(0, dtype=np.intp)


def _continuous_beyond(data: PreparedRecording | None, contiguous: Mask, sensor: str, column: Array) -> Indices:
    """Samples after the jumps of a word, if the readings of sequences extend far beyond its range once unwrapped.

    As the unit is at rest before and after a sequence, a gyro must have as many jumps up as down.
    """
    size = _word_range(column)
    if data is None or size is None or size / data.recording.nominal_interval_s < _CONTINUES * _WRAP_MOTION[sensor]:
        return np.zeros(0, dtype=np.intp)
    found = []
    for k in np.flatnonzero(contiguous).tolist():
        first, last = int(data.windows.samples[data.start[k], 0]), int(data.windows.samples[data.end[k], 1])
        part = column[first:last]
        wraps = np.rint(np.diff(part) / size)
        if np.count_nonzero(wraps) < 2 or (sensor == "gyro" and wraps.sum() != 0.0):
            continue
        whole = part.copy()
        whole[1:] -= size * np.cumsum(wraps)
        ends = np.partition(whole, (_WRAP_SAMPLES, len(whole) - 1 - _WRAP_SAMPLES))
        if ends[-1 - _WRAP_SAMPLES] - ends[_WRAP_SAMPLES] > _BEYOND * size:
            found.append(first + 1 + np.flatnonzero(wraps))
    return np.concatenate(found) if len(found) >= _WRAPPED_SEQUENCES[sensor] else np.zeros(0, dtype=np.intp)


def _word_range(column: Array) -> float | None:
    """Range of a word from the jumps against the slope before and after them; None if the jumps differ in size."""
    step, seen = np.diff(column), float(np.ptp(column))
    at = np.flatnonzero(np.abs(step[1:-1]) > 0.5 * seen) + 1
    slope = 0.5 * (step[at - 1] + step[at + 1])
    against = (slope * step[at] < 0.0) & (step[at - 1] * step[at + 1] > 0.0) & (np.abs(slope) < 0.5 * seen)
    sizes = np.abs(step[at] - slope)[against]
    if len(sizes) < _WRAP_SAMPLES:
        return None
    size = float(np.median(sizes))
    return size if float(np.median(np.abs(sizes - size))) < _SAME_RANGE * size and size > _WRAP_JUMP * seen else None
