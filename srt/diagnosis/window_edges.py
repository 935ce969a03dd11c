"""Rotation in the labelled windows, next to the rotation of their sequence: labels that are too long or shifted.

A unit at rest begins to rotate within one or two samples. Samples of a rotation at the edge of a window therefore
differ clearly from the others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.rotation_readings import computed_once, cross
from srt.diagnosis.window_averages import MAD

if TYPE_CHECKING:
    from srt.diagnosis.evidence import Evidence
    from srt.types import Array, Mask

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


class WindowEdges(NamedTuple):
    """Rotation in windows: median duration, s (positive: the labels are late), and number of windows."""

    late_s: float
    windows: int


@computed_once
def rotation_at_edges(evidence: Evidence) -> WindowEdges | None:
    """Rotation at the inner edges of most start windows or of most end windows; None if there is none."""
    data = evidence.data
    if data is None or not evidence.has_labels:
        return None
    turns = np.flatnonzero(evidence.contiguous)
    found = [_edge(evidence, k, sense) for sense in (1, -1) for k in turns.tolist()]
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
    return WindowEdges(late, int(both[real].sum()))


def _longest_runs(rows: Mask) -> Array:
    """Length of the longest run of True in each row."""
    out = []
    for row in rows:
        ends = np.flatnonzero(np.diff(np.concatenate(([False], row, [False]))))
        out.append(np.diff(ends)[::2].max(initial=0))
    return np.array(out)


def _edge(evidence: Evidence, sequence: int, sense: int) -> tuple[float, Array, Array]:
    """Duration of rotation at the inner edge of a window, and the expected and measured change of specific force.

    The window is the start window for ``sense`` 1, the end window for -1. All values are zero if the angle is less than
    the smallest one.
    """
    nothing = 0.0, np.zeros(3), np.zeros(3)
    data, dt = evidence.data, evidence.dt
    assert data is not None
    a, b = data.windows.samples[(data.start if sense > 0 else data.end)[sequence]].tolist()
    first, stop = data.rotation[sequence].tolist()
    most = min((b - a) // 4, round(_REACH_S / dt))
    if most <= _FEWEST or stop <= first:
        return nothing
    rate = evidence.rate[a:b]
    middle = np.median(rate, axis=0)
    off = (rate[-most:][::-1] if sense > 0 else rate[:most]) - middle  # from the rotation into the window
    sigma = MAD * np.median(np.abs(rate - middle), axis=0)
    fastest = float(np.quantile(np.abs(evidence.rate[first:stop]).max(axis=1), 0.9))
    loud = np.any(np.abs(off) > np.maximum(_SIGMAS * sigma, _SHARE_OF_TURN * fastest), axis=1)
    count = most if loud.all() else int(np.argmin(loud))
    turned = off[:count].sum(axis=0) * dt
    path = float(np.linalg.norm(off[:count], axis=1).sum()) * dt
    size = float(np.linalg.norm(turned))
    if count < _FEWEST or size < _LEAST_RAD or size < _ONE_SENSE * path:
        return nothing
    force = evidence.force[a:b]
    rest = np.median(force, axis=0)
    at_edge = force[-1] if sense > 0 else force[0]
    return count * dt, -sense * cross(turned, rest), at_edge - rest
