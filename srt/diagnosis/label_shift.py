"""Labels that are late or early: stationary windows in the samples, and rotation at the edges of labelled windows.

A unit at rest begins to rotate within one or two samples. Samples of a rotation at the edge of a window therefore
differ clearly from the others.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.cause_comparison import CLOSE, Cause, compare
from srt.diagnosis.rotation_readings import ROTATING, cross, rates_factor
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
_STILL: Final = 0.9
"""Smallest share of the labelled time that is stationary after a common shift."""
_SIGMAS: Final = 8.0
"""Smallest rate of a rotation, in sigma of the samples of the window: p = 1e-15."""
_FEWEST: Final = 2
"""Fewest samples of rotation in a window: a single one may be due to a channel that is sampled early or late."""
_LEAST_RAD: Final = 1e-3
"""Smallest angle of a rotation in a window, rad: the accuracy of a fixture."""
_CORRELATED_S: Final = 0.05
"""Lag of the autocorrelation that shows a low-pass filter, s: shorter responses do not reach into a window."""
_CORRELATED: Final = 0.3
"""Autocorrelation at that lag from which a filter counts: white noise of 100 samples exceeds it with p = 0.001, and
that of a fifth of the windows and of all channels does not."""
_IN_A_ROW: Final = 5
"""Number of successive sequences with rotation in a window, from which the labels are shifted, as they are with more
than half of all sequences: the clock of the labels may drift relative to that of the samples."""


class LabelShift(NamedTuple):
    """Time by which the labels are late, s (negative: early), and the number of windows affected."""

    late_s: float
    windows: int


def label_shift(data: PreparedRecording, seen: RawIntegrals, contiguous: Mask, turning: Mask) -> LabelShift | None:
    """Shift of the labels; None if they are not shifted.

    ``contiguous`` (K,) is true for the sequences without a gap, ``turning`` (W,) for the windows with a rotation.
    """
    found = _block_shift(data, turning) if turning.any() else None
    found = _rotation_at_edges(data, seen, contiguous) if found is None else found
    return None if found is None or abs(found.late_s) < _filter_tail(data, seen) else found


def lost_samples(data: PreparedRecording) -> tuple[int, float] | None:
    """Window from which the labels are late, and the time, s; None if all are late alike, or ever later.

    Samples that are lost without a gap in the stamps shift the labels after them; a clock shifts them in proportion.
    Residuals: times of the inner edges of the labels, less those of the stationary windows that they overlap most.
    """
    try:
        rest = find_windows(data.recording)
    except DataError:
        return None
    time, windows = data.recording.time, data.windows.samples
    number = np.concatenate([data.start, data.end])
    side = np.repeat([1, 0], data.K)
    order = np.argsort(windows[number, 0])
    number, side = number[order], side[order]
    own = windows[number]
    shared = np.minimum(own[:, 1, None], rest[:, 1]) - np.maximum(own[:, 0, None], rest[:, 0])
    found = rest[np.argmax(shared, axis=1)]
    rows = np.arange(len(own))
    last = len(time) - 1
    late = time[np.minimum(own[rows, side], last)] - time[np.minimum(found[rows, side], last)]
    causes = [Cause("", np.zeros((len(late), 0)), {}), Cause("labels_shifted", time[own[:, 0], None], {})]
    causes += [
        Cause("samples_lost", (rows >= m)[:, None].astype(np.float64), {"window": number[m]}, len(late))
        for m in range(2, len(late) - 1)
    ]
    ranked = compare(late, causes, np.stack([side, 1 - side], axis=1).astype(np.float64))
    best = ranked[0]
    other = next(e for e in ranked if e.cause.fault != "samples_lost")
    if best.cause.fault != "samples_lost" or best.score - other.score < CLOSE or best.value[0] < _BESIDE_S:
        return None
    return int(best.cause.details["window"]), float(best.value[0])


def _filter_tail(data: PreparedRecording, seen: RawIntegrals) -> float:
    """Time after a rotation, s, in which a filter's response falls below the noise; zero without a filter.

    A low-pass filter of all channels correlates their noise: that of one pole, with the time constant τ, by
    ``exp(-t/τ)``, as it does the end of a rotation. The least correlated channel and windows count, as vibration and
    rotations correlate others.
    """
    recording, factor = data.recording, rates_factor(data.recording)
    reach = max(1, round(_CORRELATED_S / recording.nominal_interval_s))
    inner = [(a + (b - a) // 4, b - (b - a) // 4) for a, b in data.windows.samples.tolist() if b - a > 8 * reach]
    rho, scatter = np.zeros((2, len(inner), 6))
    for w, (a, b) in enumerate(inner):
        x = np.hstack([recording.gyro[a:b], recording.accel[a:b]])
        x = x - x.mean(axis=0)
        power = np.maximum(np.mean(x**2, axis=0), np.finfo(float).tiny)
        rho[w], scatter[w] = np.mean(x[reach:] * x[:-reach], axis=0) / power, np.sqrt(power) * factor
    least = float(np.quantile(rho, 0.2, axis=0).min()) if inner else 0.0
    if least <= _CORRELATED:
        return 0.0
    decays = math.log(max(math.e, float(seen.speed.max()) / float(np.median(scatter[:, :3]))))
    return _CORRELATED_S / -math.log(min(least, 0.99)) * decays + _BESIDE_S


def _block_shift(data: PreparedRecording, turning: Mask) -> LabelShift | None:
    """Shift of the labels from block means, a coarse search; None if the labels are not shifted."""
    time, dt = data.recording.time, data.recording.nominal_interval_s
    try:
        rest, labelled = (
            np.stack([time[rows[:, 0]] - dt, time[rows[:, 1] - 1]], axis=1)
            for rows in (find_windows(data.recording), data.windows.samples)
        )
    except DataError:
        return None
    some = labelled[np.unique(np.linspace(0, len(labelled) - 1, _SOME_WINDOWS).astype(int))]
    # The best shift is one of those that move an edge of a label to an edge of a stationary window.
    late = np.unique(np.append((some[:, None, :, None] - rest[None, :, None, :]).ravel(), 0.0))
    still_until = np.repeat(np.concatenate([[0.0], np.cumsum(rest[:, 1] - rest[:, 0])]), 2)[1:-1]
    until = np.interp(some[None] - late[:, None, None], rest.ravel(), still_until)
    at_rest = np.sum(until[:, :, 1] - until[:, :, 0], axis=1)
    enough = late[at_rest >= at_rest.max() - _SLACK_S * len(some)]
    best = float(enough[np.argmin(np.abs(enough))])
    if at_rest.max() >= _STILL * np.sum(some[:, 1] - some[:, 0]) and abs(best) > _BESIDE_S:
        return LabelShift(best, int(turning.sum()))
    single = _intrusions(labelled[turning], rest)
    return LabelShift(float(np.median(single)), int(single.size)) if single.size else None


def _intrusions(labelled: Array, rest: Array) -> Array:
    """Time by which single labels are late (negative: early), s, against the stationary window they overlap most."""
    shared = np.minimum(labelled[:, 1, None], rest[:, 1]) - np.maximum(labelled[:, 0, None], rest[:, 0])
    best = np.argmax(shared, axis=1)
    most = shared.max(axis=1)
    late, early = np.maximum(labelled[:, 1] - rest[best, 1], 0.0), np.maximum(rest[best, 0] - labelled[:, 0], 0.0)
    # The label is not wrong if its window has a bump in it, or if it is too long on both sides.
    beside = np.maximum(shared, 0.0).sum(axis=1) - most
    size = np.maximum(late, early)
    wrong = (most > 0.0) & (np.minimum(late, early) <= _BESIDE_S) & (beside < 0.5 * size) & (size > _BESIDE_S)
    return np.asarray(np.where(late > early, late, -early)[wrong])


def _rotation_at_edges(data: PreparedRecording, seen: RawIntegrals, contiguous: Mask) -> LabelShift | None:
    """Rotation at the inner edges of most start windows or of most end windows; None if there is none."""
    turns = np.flatnonzero(contiguous)
    found = np.array([[_edge(data, seen, k, sense) for k in turns.tolist()] for sense in (1, -1)]).reshape(2, -1, 7)
    duration, angle, change = found[:, :, 0], found[:, :, 1:4], found[:, :, 4:]
    if duration.size == 0:
        return None
    both = duration > 0.0
    runs = np.array([np.diff(np.flatnonzero(np.concatenate([[True], ~row, [True]]))).max() - 1 for row in both])
    common = (both.mean(axis=1) > 0.5) | (runs >= _IN_A_ROW)
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

    The window is the start window for ``sense`` 1, the end window for -1. All values are zero if the angle is less than
    the smallest one.
    """
    recording, factor = data.recording, rates_factor(data.recording)
    dt = recording.nominal_interval_s
    a, b = data.windows.samples[(data.start if sense > 0 else data.end)[sequence]].tolist()
    most = (b - a) // 4
    nothing = np.zeros(7)
    if most <= _FEWEST or seen.speed[sequence] == 0.0:
        return nothing
    inner = slice(a + most, b - most)
    rest = recording.gyro[inner].mean(axis=0)
    near = recording.gyro[b - most : b][::-1] if sense > 0 else recording.gyro[a : a + most]
    off = (near - rest) * factor  # from the rotation into the window
    # Slower motion is a disturbance of a window whose label is right.
    slowest = ROTATING * seen.speed[sequence]
    if np.abs(off[:_FEWEST]).max(axis=1).min() <= slowest:
        return nothing
    least = np.maximum(_SIGMAS * recording.gyro[inner].std(axis=0) * factor, slowest)
    loud = np.any(np.abs(off) > least, axis=1)
    count = most if loud.all() else int(np.argmin(loud))
    turned = off[:count].sum(axis=0) * dt
    if count < _FEWEST or np.linalg.norm(turned) < _LEAST_RAD:
        return nothing
    force = recording.accel[inner].mean(axis=0) * factor
    at_edge = recording.accel[b - 1 if sense > 0 else a] * factor
    return np.concatenate([[count * dt], -sense * cross(turned, force), at_edge - force])
