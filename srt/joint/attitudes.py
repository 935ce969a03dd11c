"""Attitudes: the nominal ones on the fixture, the prior of the mounting, and those from which the solution starts."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.rotations import rotation_matrix, rotation_vector, smallest_rotation
from srt.sequences.preparation import nominal_attitude, sequence_of_label

if TYPE_CHECKING:
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import CompensatedData, JointState
    from srt.model.table1 import RotationSequence
    from srt.recording.recording import Fixture, SequenceLabel
    from srt.types import Array


_ALONG: Final = 1e-9
"""Largest component of a nominal rotation axis across an axis of the fixture: rounding of products of rotations."""
_MOUNTING_LIMIT: Final = 5.0
"""If MARS is rotated from its stated mounting by more sigmas of the fixture than this, the prior follows the data."""


def pose_nominal(label: SequenceLabel) -> Array:
    """Nominal start attitude C_nom of a label."""
    sequence = sequence_of_label(label)
    assert sequence is not None
    return nominal_attitude(sequence)


def nominal_start(sequence: RotationSequence | None) -> Array | None:
    """Nominal start attitude C_nom; None if it needs IMU z along the outer axis, which the fixture cannot do."""
    if sequence is None or sequence.along_outer[-1] == "z":
        return None
    return nominal_attitude(sequence)


@cache
def nominal_end(sequence: RotationSequence | None) -> Array | None:
    """Nominal attitude after the rotations of a sequence, if all are about an axis of the fixture."""
    C = nominal_start(sequence)
    if C is None or sequence is None:
        return None
    for axis, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        across = np.cross(axis, np.stack([[0.0, 0.0, 1.0], C[1]]))  # inner and outer axis
        if np.linalg.norm(across, axis=1).min() > _ALONG:
            return None
        C = C @ rotation_matrix(axis * angle)
    return C


def mounting_limit(fixture: Fixture) -> float:
    """Largest rotation of U by the errors of the fixture's axes and verticals, rad."""
    return _MOUNTING_LIMIT * math.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad)


def mounting_prior(fixture: Fixture | None, U: Array) -> tuple[Array, str]:
    """Prior mean of U (nominal, or the estimate if MARS is clearly rotated from the mounting), and a warning."""
    if fixture is None:
        return U, ""
    rotation = float(np.linalg.norm(rotation_vector(U[None])))
    if rotation <= mounting_limit(fixture):
        return np.eye(3), ""
    return U, (
        f"The gyro axes are rotated by {rotation * 1e3:.3g} mrad from the stated mounting: the prior of the "
        "mounting was centred on the orientation estimated from the rotations."
    )


def placed(joint: JointModel, state: JointState) -> tuple[JointState, CompensatedData]:
    """State with attitudes from the data, and the data compensated with it."""
    compensated = joint.compensate(state)
    return initial_attitudes(joint, state, compensated), compensated


def initial_attitudes(joint: JointModel, state: JointState, compensated: CompensatedData) -> JointState:
    """Attitudes from the data: level from the specific force, heading from the fixture or along the rotations."""
    data = joint.data
    attitude = np.tile(np.eye(3), (len(data.windows.duration_s), 1, 1))
    placed = np.zeros(len(attitude), dtype=np.bool_)
    down = -compensated.force / np.linalg.norm(compensated.force, axis=1, keepdims=True)
    earth = joint.earth_rate(state)
    heading = rotation_matrix(np.array([0.0, 0.0, joint.heading_rad]))

    def level(A: Array, w: int) -> Array:
        return np.asarray(A @ smallest_rotation(down[w][None], A[2][None])[0])

    def from_fixture(nominal: Array) -> Array:
        # R_y(outer) R_x(ε) R_z(inner): the nominal attitude turned by ε about the horizontal axis across the outer.
        tilted = rotation_matrix(state.non_orthogonality * np.cross([0.0, 1.0, 0.0], nominal[:, 2])) @ nominal
        return np.asarray(heading @ state.base @ tilted @ state.U.T)

    for label, w in data.poses:
        attitude[w] = level(from_fixture(pose_nominal(label)), w)
    for k in joint.order.tolist():
        s, e = int(data.start[k]), int(data.end[k])
        nominal = joint.nominal[k]
        if not placed[s]:
            A = from_fixture(nominal) if nominal is not None else _any_level_attitude(down[s])
            attitude[s], placed[s] = level(A, s), True
        if not placed[e]:
            earth_rotation = rotation_matrix(-earth[s] * compensated.duration_s[k])
            attitude[e], placed[e] = level(earth_rotation @ attitude[s] @ compensated.rotation[k], e), True
    return replace(state, attitude=attitude)


def _any_level_attitude(down: Array) -> Array:
    """Arbitrary attitude, B to L, with a given down vector."""
    first = np.cross(down, np.eye(3)[np.argmin(np.abs(down))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first), down])
