"""Labels that are late or early: stationary windows in the samples, and rotation at the edges of labelled windows.

A unit begins to rotate within one or two samples, which therefore differ clearly from those at rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.cause_comparison import CLOSE, Cause, compare
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.rotation_readings import ROTATING, cross
from srt.exceptions import DataError
from srt.sequences.rest_detection import BLOCK_S
from srt.sequences.stationary_windows import find_windows

if TYPE_CHECKING:
    from srt.diagnosis.rotation_readings import RawIntegrals
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_BESIDE_S: Final = 2.0 * BLOCK_S
"""Largest error of the edges of the stationary windows found in the samples, s: one or two blocks."""
_SLACK_S: Final = 0.03
"""Stationary time per window, s, by which a smaller shift may be worse than the best shift and still be preferred."""
_SOME_WINDOWS: Final = 16
"""Largest number of windows whose edges give the candidates for the common shift, which is the same for all windows."""


class LabelShift(NamedTuple):
    """Time by which the labels are late, s (negative: early), and the number of windows affected."""

    late_s: float
    windows: int


def label_shift(data: PreparedRecording, seen: RawIntegrals, contiguous: Mask, turning: Mask) -> LabelShift | None:
    """Shift of the labels; None if they are not shifted.

    ``contiguous`` (K,) is true for the sequences without a gap, ``turning`` (W,) for the windows with a rotation.
    """
    found = _block_shift(data, turning) if turning.any() else None
    found = found or _rotation_at_edges(data, seen, contiguous)
    if found is None or found.late_s > 0.0:
        return found
    labelled, rest = _spans(data)
    if len(rest) == 0:
        return found
    # A low-pass filter makes rotations end late, but not begin late.
    later = (rest[_shared(labelled, rest).argmax(axis=1), 1] - labelled[:, 1])[data.start]
    return found if np.median(later) > -0.5 * found.late_s else None


def lost_samples(data: PreparedRecording) -> tuple[int, float] | None:
    """Window from which the labels are late, and the time, s; None if all are late alike, or ever later.

    Samples lost without a gap in the stamps shift the labels after them; a clock shifts them in proportion.
    """
    labelled, rest = _spans(data)
    if len(rest) == 0:
        return None
    number, side = np.concatenate([data.start, data.end]), np.repeat([1, 0], data.K)
    order = np.argsort(labelled[number, 0])
    number, side = number[order], side[order]
    own = labelled[number]
    late, rows = own[np.arange(len(own)), side] - rest[_shared(own, rest).argmax(axis=1), side], np.arange(len(own))
    causes = [Cause("", np.zeros((len(own), 0)), {}), Cause("labels_shifted", own[:, :1], {})]
    causes += [
        Cause("samples_lost", (rows >= m)[:, None].astype(np.float64), {"window": number[m]}, len(own))
        for m in range(2, len(own) - 1)
    ]
    best, *others = compare(late, causes, np.stack([side, 1 - side], axis=1).astype(np.float64))
    other = next((e for e in others if e.cause.fault != "samples_lost"), best)
    if best.cause.fault != "samples_lost" or best.score - other.score < CLOSE or best.value[0] < _BESIDE_S:
        return None
    return int(best.cause.details["window"]), float(best.value[0])


def _spans(data: PreparedRecording) -> tuple[Array, Array]:
    """Start and end of the labelled windows, and of the windows found in the samples, s; (n, 2) each."""
    time, dt = data.recording.time, data.recording.nominal_interval_s
    try:
        rest = find_windows(data.recording)
    except DataError:
        rest = np.zeros((0, 2), dtype=np.intp)
    parts = (data.windows.samples, rest)
    spans = [np.stack([time[rows[:, 0]] - dt, time[rows[:, 1] - 1]], axis=1) for rows in parts]
    return spans[0], spans[1]


def _shared(labelled: Array, rest: Array) -> Array:
    """Time that each label shares with each stationary window, s; negative if they are apart."""
    return np.asarray(np.minimum(labelled[:, 1, None], rest[:, 1]) - np.maximum(labelled[:, 0, None], rest[:, 0]))


def _block_shift(data: PreparedRecording, turning: Mask) -> LabelShift | None:
    """Shift of the labels from block means, a coarse search; None if the labels are not shifted."""
    labelled, rest = _spans(data)
    if len(rest) == 0:
        return None
    some = labelled[np.unique(np.linspace(0, len(labelled) - 1, _SOME_WINDOWS).astype(int))]
    # The best shift is one of those that move an edge of a label to an edge of a stationary window.
    late = np.unique(np.append((some[:, None, :, None] - rest[None, :, None, :]).ravel(), 0.0))
    still_until = np.repeat(np.concatenate([[0.0], np.cumsum(rest[:, 1] - rest[:, 0])]), 2)[1:-1]
    until = np.interp(some[None] - late[:, None, None], rest.ravel(), still_until)
    at_rest = np.sum(until[:, :, 1] - until[:, :, 0], axis=1)
    enough = late[at_rest >= at_rest.max() - _SLACK_S * len(some)]
    best = float(enough[np.argmin(np.abs(enough))])
    if abs(best) > _BESIDE_S:
        return LabelShift(best, int(turning.sum()))
    # Shifts of single labels, against the stationary window that they overlap most.
    labelled = labelled[turning]
    shared = _shared(labelled, rest)
    nearest, most = rest[shared.argmax(axis=1)], shared.max(axis=1)
    late, early = np.maximum(labelled[:, 1] - nearest[:, 1], 0.0), np.maximum(nearest[:, 0] - labelled[:, 0], 0.0)
    # The label is not wrong if it is too long on both sides.
    wrong = (most > 0.0) & (np.minimum(late, early) <= _BESIDE_S) & (np.maximum(late, early) > _BESIDE_S)
    return LabelShift(float(np.median((late - early)[wrong])), int(wrong.sum())) if wrong.any() else None


def _rotation_at_edges(data: PreparedRecording, seen: RawIntegrals, contiguous: Mask) -> LabelShift | None:
    """Rotation at the inner edges of most start windows or of most end windows; None if there is none."""
    turns = np.flatnonzero(contiguous).tolist()
    found = np.array([[_edge(data, seen, k, sense) for k in turns] for sense in (1, -1)]).reshape(2, -1, 7)
    if found.size == 0:
        return None
    duration, angle, change = found[:, :, 0], found[:, :, 1:4], found[:, :, 4:]
    both = duration > 0.0
    common = both.mean(axis=1) > 0.5
    # The direction of gravity must confirm half of the angle, if the axis is not vertical: a low-pass filter of the
    # gyros also makes their readings end late.
    shown, expected = np.einsum("skc,skc->s", angle, change), np.einsum("skc,skc->s", angle, angle)
    real = common & ((shown > 0.5 * expected) | (expected == 0.0))
    if not real.any():
        return None
    side = int(np.argmax(np.where(real, both.sum(axis=1), 0)))
    late = float(np.median(duration[side][both[side]])) * (1.0, -1.0)[side]
    return LabelShift(late, int(both[real].sum()))


def _edge(data: PreparedRecording, seen: RawIntegrals, sequence: int, sense: int) -> Array:
    """Duration of rotation at the inner edge of a window, and the expected and measured change of specific force, (7,).

    ``sense`` is 1 for the start window, -1 for the end window. Statistic: rate over its standard deviation.
    Distribution: normal.
    """
    recording, factor = data.recording, data.recording.rates_factor
    dt = recording.nominal_interval_s
    a, b = data.windows.samples[(data.start if sense > 0 else data.end)[sequence]].tolist()
    most = (b - a) // 4
    if most <= 2 or seen.speed[sequence] == 0.0:
        return np.zeros(7)
    inner = slice(a + most, b - most)
    near = recording.gyro[b - most : b][::-1] if sense > 0 else recording.gyro[a : a + most]
    off = (near - recording.gyro[inner].mean(axis=0)) * factor  # from the rotation into the window
    # Slower motion is a disturbance of a window whose label is right. A single sample may be due to a channel that is
    # sampled early or late.
    slowest = ROTATING * seen.speed[sequence]
    if np.abs(off[:2]).max(axis=1).min() <= slowest:
        return np.zeros(7)
    tests = 3 * most * len(data.windows.samples)
    noise = limit("normal", tests=tests, both_sides=True) * recording.gyro[inner].std(axis=0) * factor
    loud = np.any(np.abs(off) > np.maximum(noise, slowest), axis=1)
    count = most if loud.all() else int(np.argmin(loud))
    if count < 2:
        return np.zeros(7)
    turned = off[:count].sum(axis=0) * dt
    force = recording.accel[inner].mean(axis=0) * factor
    at_edge = recording.accel[b - 1 if sense > 0 else a] * factor
    return np.concatenate([[count * dt], -sense * cross(turned, force), at_edge - force])
