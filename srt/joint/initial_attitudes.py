"""First attitudes of all windows, from which the joint solution starts."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from srt.joint.nominal_attitudes import pose_nominal
from srt.model.rotations import rotation_matrix, smallest_rotation
from srt.ranking import rounded

if TYPE_CHECKING:
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import CompensatedData, JointState
    from srt.types import Array


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
    """Arbitrary attitude, B to L, shape (3, 3), with a given down vector (3,)."""
    first = np.cross(down, np.eye(3)[np.argmin(rounded(np.abs(down)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first), down])
