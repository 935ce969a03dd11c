"""Kinds of measurements of the joint model: their members and noise, for the rows and for the factors of the graph."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation import error_sources
from srt.joint.nominal_attitudes import pose_nominal

if TYPE_CHECKING:
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import JointState
    from srt.types import Array, Indices

_LEAST_WOBBLE: Final = 1e-4
"""Least axis wobble, relative to the sigma of the fixture's angles: the covariance of an attitude must be regular."""


def fixed_headings(joint: JointModel) -> Indices:
    """Windows with a fixed heading: the first window of a free level frame; without fixture states, every start."""
    data, fixed = joint.data, []
    seen: set[int] = set()
    for k in joint.order.tolist():
        frame = int(joint.sequence_frame[k])
        if joint.level_frames[frame].fixture:
            if not joint.fixture_states:
                fixed.append(int(data.start[k]))
        elif frame not in seen:
            seen.add(frame)
            fixed.append(int(data.start[k]))
    if not joint.fixture_states:
        fixed += [w for _, w in data.poses]
    return np.array(sorted(set(fixed)), dtype=np.intp)


def rotation_kinds(joint: JointModel) -> list[tuple[str, Indices]]:
    """Kinds of rows of the rotations, and their sequences.

    "turn" are all three components. Of a run at a stated rate, many revolutions, only the component about the vertical
    is used: the "heading" of the end attitude, which the specific force does not show.
    """
    rated = joint.steady.rated
    kinds = ("turn", np.setdiff1d(np.arange(joint.data.K), rated)), ("heading", rated)
    return [kind for kind in kinds if kind[1].size]


def rotation_noise(joint: JointModel, state: JointState, noise: dict[str, Array], kind: str) -> dict[str, Array]:
    """Covariances by source, (n, d, d), of the rows of a kind of rotations from those of all rotations, (K, 3, 3)."""
    assert state.attitude is not None
    members = dict(rotation_kinds(joint))[kind]
    if kind == "turn":
        return {source: R[members] for source, R in noise.items()}
    down = state.attitude[joint.data.start[members], 2:]
    return {source: down @ R[members] @ np.swapaxes(down, 1, 2) for source, R in noise.items()}


def fixture_attitudes(joint: JointModel) -> list[tuple[str, list[tuple[int, int, Array]], slice]]:
    """Attitudes that the fixture determines.

    Returns
    -------
    list of (str, list, slice)
        Kind, "start" or "end"; sequence, window and nominal attitude of each; components of the residual. The angles of
        an end are measured by the gyros alone, whatever rotation was executed, but its axes are those of the start.
    """
    data = joint.data
    on_fixture = [k for k in joint.order.tolist() if joint.nominal[k] is not None]
    starts = [(k, int(data.start[k]), nominal) for k in on_fixture if (nominal := joint.nominal[k]) is not None]
    starts += [(int(joint.window_sequence[w]), w, pose_nominal(label)) for label, w in data.poses]
    known = {window for _, window, _ in starts}
    ends = [
        (k, int(data.end[k]), nominal)
        for k in on_fixture
        if joint.choice.ends_tied and int(data.end[k]) not in known and (nominal := joint.nominal_ends[k]) is not None
    ]
    kinds = (("start", starts, slice(0, 3)), ("end", ends, slice(2, 3)))
    return [(kind, poses, components) for kind, poses, components in kinds if poses]


def start_covariances(joint: JointModel, components: slice) -> dict[str, Array]:
    """Covariance of components of a start by source of error: as stated, and what the residuals show beyond it."""
    excess = joint.choice.unmodelled_sigma
    inner, outer, wobble = error_sources.start_sigma(joint.data.recording).tolist()
    sigmas = {
        "earth_rate_alignment": np.array([inner, outer, math.hypot(_LEAST_WOBBLE * inner, wobble)]),
        "wobble_excess": np.array([0.0, 0.0, excess.wobble]),
        "angle_excess": np.array([excess.angle, excess.angle, 0.0]),
    }
    return {source: np.diag(sigma[components] ** 2) for source, sigma in sigmas.items()}


def alignment_covariances(joint: JointModel, size: int) -> dict[str, Array]:
    """Covariance of ``size`` components of the alignment by source of error, as :func:`start_covariances`."""
    stated, excess = error_sources.alignment_sigma(joint.data.recording), joint.choice.unmodelled_sigma.alignment
    sigmas = {"earth_rate_alignment": stated, "alignment_excess": excess}
    return {source: sigma**2 * np.eye(size) for source, sigma in sigmas.items()}
