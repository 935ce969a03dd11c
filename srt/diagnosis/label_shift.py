"""Labels that are late or early: stationary windows in the samples, and rotation at the edges of labelled windows.

A unit at rest begins to rotate within one or two samples. Samples of a rotation at the edge of a window therefore
differ clearly from the others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.rotation_readings import MAD, cross, median, rates_factor
from srt.exceptions import DataError
from srt.sequences.rest_detection import BLOCK_S
from srt.sequences.stationary_windows import find_windows

if TYPE_CHECKING:
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_BESIDE_S: Final = 2.0 * BLOCK_S
"""Largest error of the edges of the stationary windows found in the samples, s: one or two blocks."""
_SLACK_S: Final = 0.03
"""Stationary time per window, s, by which a smaller shift may be worse than the best shift and still be preferred."""
_SOME_WINDOWS: Final = 40
"""Largest number of windows for which the stationary time after a common shift is computed."""
_FEW_WINDOWS: Final = 8
"""Number of windows whose edges give the candidates for the common shift, which is the same for all windows."""
_STILL: Final = 0.9
"""Smallest share of the labelled time that is stationary after a common shift."""
_SIGMAS: Final = 8.0
"""Smallest rate of a rotation, in sigma of the samples about the median of the window: p = 1e-15."""
_SHARE_OF_TURN: Final = 0.01
"""Smallest rate of a rotation, relative to the rate of the sequence: slower motion is a disturbance of a window whose
label is right."""
_FEWEST: Final = 2
"""Fewest samples of rotation in a window: a single one may be due to a channel that is sampled early or late."""
_LEAST_RAD: Final = 1e-3
"""Smallest angle of a rotation in a window, rad: the accuracy of a fixture."""
_MOST: Final = 0.5
"""Share of the sequences with rotation in a window, above which the labels are shifted: a lagging channel affects only
a third of them."""
_IN_A_ROW: Final = 5
"""Number of successive sequences with rotation in a window, from which the labels are also shifted: the clock of the
labels may drift relative to that of the samples."""
_REACH_S: Final = 0.5
"""Time in the window next to the rotation that is searched, s; block means show larger shifts."""
_ONE_SENSE: Final = 0.8
"""Smallest ratio of net angle to path for a rotation: an oscillating fixture swings back."""
_SEEN: Final = 0.5
"""Smallest share of the angle that the direction of gravity must confirm, if the axis is not vertical: a low-pass
filter of the gyros also makes their readings end late."""


class LabelShift(NamedTuple):
    """Time by which the labels are late, s (negative: early), and the number of windows affected."""

    late_s: float
    windows: int


def label_shift(data: PreparedRecording, contiguous: Mask, turning: Mask) -> LabelShift | None:
    """Shift of the labels; None if they are not shifted.

    Parameters
    ----------
    data : PreparedRecording
    contiguous : ndarray of bool, shape (K,)
        True for each sequence without a gap.
    turning : ndarray of bool, shape (W,)
        True for each window in which the unit rotates.
    """
    found = _block_shift(data, turning)
    return _rotation_at_edges(data, contiguous) if found is None else found


def _block_shift(data: PreparedRecording, turning: Mask) -> LabelShift | None:
    """Shift of the labels from block means, a coarse search; None if the labels are not shifted."""
    recording = data.recording
    if not turning.any():
        return None
    try:
        still = find_windows(recording)
    except DataError:
        return None
    time, dt, samples = recording.time, recording.nominal_interval_s, data.windows.samples
    rest = np.stack([time[still[:, 0]] - dt, time[still[:, 1] - 1]], axis=1)
    labelled = np.stack([time[samples[:, 0]] - dt, time[samples[:, 1] - 1]], axis=1)
    shift = _common_shift(labelled, rest)
    if shift is not None:
        return LabelShift(shift, int(turning.sum()))
    single = _intrusions(labelled[turning], rest)
    single = single[np.abs(single) > _BESIDE_S]
    return LabelShift(float(np.median(single)), int(single.size)) if single.size else None


def _common_shift(labelled: Array, rest: Array) -> float | None:
    """Smallest common time by which all labels are late, s, whose correction makes the windows stationary."""
    some = labelled[np.unique(np.linspace(0, len(labelled) - 1, _SOME_WINDOWS).astype(int))]
    # The best shift is one of those that move an edge of a label to an edge of a stationary window.
    late = np.unique(np.append((some[:_FEW_WINDOWS, None, :, None] - rest[None, :, None, :]).ravel(), 0.0))
    edges = rest.ravel()
    still_until = np.repeat(np.concatenate([[0.0], np.cumsum(rest[:, 1] - rest[:, 0])]), 2)[1:-1]
    until = np.interp(some[None] - late[:, None, None], edges, still_until)
    at_rest = np.sum(until[:, :, 1] - until[:, :, 0], axis=1)
    enough = late[at_rest >= at_rest.max() - _SLACK_S * len(some)]
    best = float(enough[np.argmin(np.abs(enough))])
    if at_rest.max() < _STILL * float(np.sum(some[:, 1] - some[:, 0])) or abs(best) <= _BESIDE_S:
        return None
    return best


def _intrusions(labelled: Array, rest: Array) -> Array:
    """Time by which each label is late (negative: early), s, relative to the stationary window it overlaps most."""
    out = []
    for a, b in labelled.tolist():
        shared = np.minimum(b, rest[:, 1]) - np.maximum(a, rest[:, 0])
        low, high = rest[int(np.argmax(shared))].tolist()
        late, early = max(0.0, b - high), max(0.0, low - a)
        # The label is not wrong if its window has a bump in it, or if it is too long on both sides.
        beside = np.clip(np.minimum(b, rest[:, 1]) - np.maximum(a, rest[:, 0]), 0.0, None).sum() - shared.max()
        if shared.max() > 0.0 and min(late, early) <= _BESIDE_S and beside < 0.5 * max(late, early):
            out.append(late if late > early else -early)
    return np.array(out)


def _rotation_at_edges(data: PreparedRecording, contiguous: Mask) -> LabelShift | None:
    """Rotation at the inner edges of most start windows or of most end windows; None if there is none."""
    turns = np.flatnonzero(contiguous)
    found = [_edge(data, k, sense) for sense in (1, -1) for k in turns.tolist()]
    duration = np.array([one[0] for one in found]).reshape(2, -1)
    if duration.size == 0:
        return None
    both = duration > 0.0
    angle, change = (np.array([one[i] for one in found]).reshape(2, -1, 3) for i in (1, 2))
    shown = np.einsum("skc,skc->s", angle, change)
    expected = np.einsum("skc,skc->s", angle, angle)
    common = (both.mean(axis=1) > _MOST) | (_longest_runs(both) >= _IN_A_ROW)
    real = common & ((shown > _SEEN * expected) | (expected == 0.0))
    if not real.any():
        return None
    side = int(np.argmax(np.where(real, both.sum(axis=1), 0)))
    late = float(np.median(duration[side][both[side]])) * (1.0, -1.0)[side]
    return LabelShift(late, int(both[real].sum()))


def _longest_runs(rows: Mask) -> Array:
    """Length of the longest run of True in each row."""
    out = []
    for row in rows:
        ends = np.flatnonzero(np.diff(np.concatenate(([False], row, [False]))))
        out.append(np.diff(ends)[::2].max(initial=0))
    return np.array(out)


def _edge(data: PreparedRecording, sequence: int, sense: int) -> tuple[float, Array, Array]:
    """Duration of rotation at the inner edge of a window, and the expected and measured change of specific force.

    The window is the start window for ``sense`` 1, the end window for -1. All values are zero if the angle is less than
    the smallest one.
    """
    nothing = 0.0, np.zeros(3), np.zeros(3)
    recording, factor = data.recording, rates_factor(data.recording)
    dt = recording.nominal_interval_s
    a, b = data.windows.samples[(data.start if sense > 0 else data.end)[sequence]].tolist()
    first, stop = data.rotation[sequence].tolist()
    most = min((b - a) // 4, round(_REACH_S / dt))
    if most <= _FEWEST or stop <= first:
        return nothing
    rate = recording.gyro[a:b] * factor
    middle = median(rate.T)
    off = (rate[-most:][::-1] if sense > 0 else rate[:most]) - middle  # from the rotation into the window
    fastest = float(np.quantile(np.abs(recording.gyro[first:stop] * factor).max(axis=1), 0.9))
    if not np.all(np.abs(off[:_FEWEST]).max(axis=1) > _SHARE_OF_TURN * fastest):
        return nothing
    sigma = MAD * median(np.abs(rate - middle).T)
    loud = np.any(np.abs(off) > np.maximum(_SIGMAS * sigma, _SHARE_OF_TURN * fastest), axis=1)
    count = most if loud.all() else int(np.argmin(loud))
    turned = off[:count].sum(axis=0) * dt
    path = float(np.linalg.norm(off[:count], axis=1).sum()) * dt
    size = float(np.linalg.norm(turned))
    if count < _FEWEST or size < _LEAST_RAD or size < _ONE_SENSE * path:
        return nothing
    force = recording.accel[a:b] * factor
    rest = median(force.T)
    at_edge = force[-1] if sense > 0 else force[0]
    return count * dt, -sense * cross(turned, rest), at_edge - rest
