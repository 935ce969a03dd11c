"""Kinds of measurements of the joint model: members, residuals and noise, for the rows and the factors of the graph."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation import error_sources
from srt.joint.nominal_attitudes import pose_nominal
from srt.model import measurement_model as model

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import CompensatedData, JointState
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


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementKind:
    """One kind of measurement of a recording: its n members, residual with derivatives, and noise.

    Least squares and Kalman filter take the kinds as rows (:mod:`srt.joint.linearisation`). The factor graph evaluates
    the same residuals and keeps its own assembly of variables, signs and noise.

    Attributes
    ----------
    name : str
    owner, number : ndarray of int, shape (n,)
        Sequence of each member; window or sequence that tells it from the others.
    noise : dict of str to ndarray, shape (n, d, d)
        Covariance by source.
    unknowns : tuple of (str, ndarray of int, shape (n,))
        Unknowns that enter the residual besides errors of the readings: name of the columns, number for each member.
    evaluate : callable
        ``(members, *values) -> (residual (m, d), derivatives (m, d, w))``, of m members with the values of their
        unknowns, a derivative for each. Those with respect to attitudes are by small rotations behind them.
    quantity : str
        "force", "rate", "turn" or "stated_rate": what errors of the readings act on. Empty: they do not.
    sensor : str
        "gyro" or "accel": of whose readings the quantity is made.
    readings : ndarray of int, shape (n,)
        Place of each member among the members of the quantity.
    by_errors : ndarray, shape (n, d, 27), or None
        Effect of the sensor errors on the quantity.
    scaled : bool
        ``evaluate`` gives one more derivative, that by the quantity; where False it is −1.
    """

    name: str
    owner: Indices
    number: Indices
    noise: dict[str, Array]
    unknowns: tuple[tuple[str, Indices], ...]
    evaluate: Callable[..., tuple[Array, list[Array]]]
    quantity: str = ""
    readings: Indices = field(default_factory=lambda: np.zeros(0, np.intp))
    by_errors: Array | None = None
    scaled: bool = False
    sensor: str = "gyro"


def measurement_kinds(joint: JointModel, state: JointState, compensated: CompensatedData) -> list[MeasurementKind]:
    """All kinds of measurements with members, those of the windows, force and rate, first.

    ``compensated`` is the data at ``state``, whose attitudes project the noise of headings.
    """
    kinds = [_forces(joint, compensated), _rates(joint, compensated)]
    # A run at a stated rate has many revolutions. It gives the component about the vertical alone: the "heading" of the
    # end attitude, which the specific force does not show.
    rated = joint.steady.rated
    kinds.append(_rotations(joint, compensated, np.setdiff1d(np.arange(joint.data.K), rated)))
    kinds += [_headings(joint, state, compensated, rated), _stated_rates(joint, compensated)]
    kinds += _fixture_attitudes(joint) if joint.fixture_states else []
    return [kind for kind in kinds if kind.owner.size]


def _forces(joint: JointModel, data: CompensatedData) -> MeasurementKind:
    """Mean specific force of every window."""
    windows = np.arange(len(data.force))

    def evaluate(members: Indices, attitude: Array, gravity: Array) -> tuple[Array, list[Array]]:
        size = joint.data.gravity + float(gravity[0, 0])
        found = model.specific_force_residual(data.force[members], attitude, size)
        return found.residual, [found.by_attitude, found.by_gravity[:, :, None]]

    unknowns = ("attitude", windows), ("gravity", np.zeros_like(windows))
    return MeasurementKind(
        "force", joint.window_sequence, windows, data.force_noise, unknowns, evaluate, "force", windows,
        data.force_jacobian, sensor="accel",
    )  # fmt: skip


def _rates(joint: JointModel, data: CompensatedData) -> MeasurementKind:
    """Mean rate of every window."""
    windows, frames = np.arange(len(data.rate)), joint.window_frame

    def evaluate(members: Indices, attitude: Array, earth_rate: Array) -> tuple[Array, list[Array]]:
        found = model.angular_rate_residual(data.rate[members], attitude, earth_rate)
        return found.residual, [found.by_attitude, found.by_earth_rate]

    unknowns = ("attitude", windows), ("earth_rate", frames)
    return MeasurementKind(
        "rate", joint.window_sequence, windows, data.rate_noise, unknowns, evaluate, "rate", windows, data.rate_jacobian
    )


def _rotations(joint: JointModel, data: CompensatedData, members: Indices) -> MeasurementKind:
    """Rotation between the windows of sequences."""
    first, last, frames = joint.data.start[members], joint.data.end[members], joint.sequence_frame[members]

    def evaluate(rows: Indices, start: Array, end: Array, earth_rate: Array) -> tuple[Array, list[Array]]:
        at = members[rows]
        duration_s = np.asarray(data.duration_s)[at]
        found = model.rotation_residual(data.rotation[at], start, end, earth_rate, duration_s)
        return found.residual, [found.by_start, found.by_end, found.by_earth_rate, found.by_rotation]

    noise = {source: R[members] for source, R in data.rotation_noise.items()}
    unknowns = ("attitude", first), ("attitude", last), ("earth_rate", frames)
    return MeasurementKind(
        "turn",
        members,
        members,
        noise,
        unknowns,
        evaluate,
        "turn",
        members,
        data.rotation_jacobian[members],
        scaled=True,
    )


def _headings(joint: JointModel, state: JointState, data: CompensatedData, members: Indices) -> MeasurementKind:
    """Component about the vertical of the rotations of sequences."""
    whole = _rotations(joint, data, members)
    assert state.attitude is not None
    down = state.attitude[joint.data.start[members], 2:]

    def evaluate(rows: Indices, start: Array, end: Array, earth_rate: Array) -> tuple[Array, list[Array]]:
        residual, (by_start, by_end, by_earth, by_rotation) = whole.evaluate(rows, start, end, earth_rate)
        rotation = model.RotationResidual(residual, by_start, by_end, by_rotation, by_earth)
        found = model.heading_residual(rotation, start)
        return found.residual, [found.by_start, found.by_end, found.by_earth_rate, found.by_rotation]

    noise = {source: down @ R @ np.swapaxes(down, 1, 2) for source, R in whole.noise.items()}
    return replace(whole, name="heading", noise=noise, evaluate=evaluate)


def _stated_rates(joint: JointModel, data: CompensatedData) -> MeasurementKind:
    """Mean rates of runs at a stated rate, in the halves of their steady windows."""
    runs, windows = data.stated, joint.data.start[data.stated.sequences]
    frames = joint.window_frame[windows]

    def evaluate(members: Indices, start: Array, earth: Array, table_rate: Array) -> tuple[Array, list[Array]]:
        residual, *derivatives = runs.residual(members, start, earth, float(table_rate[0, 0]))
        return residual, derivatives

    unknowns = ("attitude", windows), ("earth_rate", frames), ("table_rate", np.zeros_like(windows))
    return MeasurementKind(
        "stated_rate", runs.sequences, runs.sequences, runs.noise, unknowns, evaluate, "stated_rate",
        np.arange(len(windows)), runs.jacobian,
    )  # fmt: skip


def _fixture_attitudes(joint: JointModel) -> list[MeasurementKind]:
    """Attitudes that the fixture determines: of starts, angles and non-orthogonality; of ends, the latter alone.

    The angles of an end are measured by the gyros alone, whatever rotation was executed, but its axes are those of the
    start.
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
    kinds = ("start", starts, slice(0, 3)), ("end", ends, slice(2, 3))
    return [_fixture_attitude(joint, *kind) for kind in kinds if kind[1]]


def _fixture_attitude(
    joint: JointModel, name: str, poses: list[tuple[int, int, Array]], components: slice
) -> MeasurementKind:
    owner, windows = (np.array([pose[i] for pose in poses], dtype=np.intp) for i in (0, 1))
    nominal, zero = np.stack([pose[2] for pose in poses]), np.zeros_like(owner)

    def evaluate(
        members: Indices, attitude: Array, base: Array, U: Array, non_orthogonality: Array
    ) -> tuple[Array, list[Array]]:
        angles = joint.heading_rad, float(non_orthogonality[0, 0])
        residual, *derivatives = model.start_attitude_residual(attitude, nominal[members], base[0], U[0], *angles)
        return residual[:, components], [part[:, components] for part in derivatives]

    noise = {s: np.tile(R, (len(owner), 1, 1)) for s, R in start_covariances(joint, components).items()}
    unknowns = ("attitude", windows), ("base", zero), ("mounting", zero), ("non_orthogonality", zero)
    return MeasurementKind(name, owner, windows, noise, unknowns, evaluate)


def start_covariances(joint: JointModel, components: slice) -> dict[str, Array]:
    """Covariance (d, d) of components of a start by source: as stated, and what the residuals show beyond it."""
    excess = joint.choice.unmodelled_sigma
    inner, outer, wobble = error_sources.start_sigma(joint.data.recording).tolist()
    sigmas = {
        "earth_rate_alignment": np.array([inner, outer, math.hypot(_LEAST_WOBBLE * inner, wobble)]),
        "wobble_excess": np.array([0.0, 0.0, excess.wobble]),
        "angle_excess": np.array([excess.angle, excess.angle, 0.0]),
    }
    return {source: np.diag(sigma[components] ** 2) for source, sigma in sigmas.items()}


def alignment_covariances(joint: JointModel, size: int) -> dict[str, Array]:
    """Covariance (size, size) of components of the alignment by source of error, as :func:`start_covariances`."""
    stated, excess = error_sources.alignment_sigma(joint.data.recording), joint.choice.unmodelled_sigma.alignment
    sigmas = {"earth_rate_alignment": stated, "alignment_excess": excess}
    return {source: sigma**2 * np.eye(size) for source, sigma in sigmas.items()}
