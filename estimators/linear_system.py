"""The joint problem linearised: white rows over named columns, solved at once or sequence by sequence.

Rows are measurements and priors, each whitened by its own noise, so that a correction δ minimises ``|A δ + b|²``.
Attitudes are corrected by small rotations about the axes of the level frame L, two tilts and the heading. What two
measurements share, a reading at a window's edge or a drift of the bias, is an unknown of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model import measurement_model as model
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from estimators.joint_model import JointModel
    from estimators.joint_state import CompensatedData, JointState
    from srt.model.prior import Prior
    from srt.types import Array, Indices, Mask


N_ERRORS: Final = GROUP_SLICES["gyro_bias"].start
"""Sensor errors without the gyro bias, which comes per sequence."""


@dataclass(frozen=True, slots=True, eq=False)
class RowGroup:
    """A group of like rows, three for each of n windows, turns or sequences.

    Attributes
    ----------
    kind : str
    first : int
        Row of A that the group begins at.
    owner : ndarray of int, shape (n,)
        Sequence that each member belongs to; −1 for priors of the recording.
    sources : dict of str to ndarray, shape (n, d, d)
        Share of every source of error in the members' unit covariance.
    size : int
        Rows of a member, d.
    """

    kind: str
    first: int
    owner: Indices
    sources: dict[str, Array]
    size: int = 3

    @property
    def index(self) -> Indices:
        """Rows of A by member, shape (n, d)."""
        return self.first + np.arange(len(self.owner) * self.size).reshape(-1, self.size)


@dataclass(frozen=True, slots=True, eq=False)
class LinearSystem:
    """Linearised problem: minimise ``|A δ + b|²`` over the active columns.

    Attributes
    ----------
    A : ndarray, shape (m, n)
    b : ndarray, shape (m,)
    columns : dict of str to slice
        "errors" (24), "bias" (3, or 3 per sequence), "base", "mounting", "gravity", "earth_rate" (3 per level frame),
        "instability" (:attr:`BiasInstability.size`), "attitude" (3 per window), "edge" (3 per edge that is an unknown).
    active : ndarray of bool, shape (n,)
        Columns that are estimated.
    rows : tuple of Rows
    free : ndarray of bool, shape (27,)
        Sensor errors that are estimated.
    whitening : dict of str to ndarray, shape (n, d, d)
        By kind of rows: what turned residuals into rows.
    played : Played
        The play-back that was linearised.
    """

    A: Array
    b: Array
    columns: dict[str, slice]
    active: Mask
    rows: tuple[RowGroup, ...]
    free: Mask
    whitening: dict[str, Array]
    compensated: CompensatedData

    def of(self, name: str) -> Indices:
        """Column numbers of a name."""
        return np.arange(self.columns[name].start, self.columns[name].stop)

    def rows_of(self, kind: str) -> RowGroup:
        """The group of a kind."""
        return next(r for r in self.rows if r.kind == kind)

    def parameter_map(self) -> Array:
        """Reported parameters from the columns, shape (27, n): the gyro bias is the mean over the sequences."""
        E = np.zeros((N_PARAMETERS, self.A.shape[1]))
        E[:N_ERRORS, self.columns["errors"]] = np.eye(N_ERRORS)
        bias = self.columns["bias"]
        number = (bias.stop - bias.start) // 3
        E[N_ERRORS:, bias] = np.tile(np.eye(3), number) / number
        return E


def attitude_columns(system: LinearSystem) -> Mask:
    """Columns of fixture, site and attitudes: what a play-back does not depend on, shape (n,)."""
    out = np.zeros(system.A.shape[1], dtype=np.bool_)
    for name in ("base", "mounting", "gravity", "earth_rate", "attitude"):
        out[system.columns[name]] = True
    return out


def whiten(covariance: Array) -> Array:
    """Matrices W with ``W R Wᵀ = I`` of covariances R, (n, d, d)."""
    scale = np.sqrt(np.einsum("naa->na", covariance))
    unit = covariance / (scale[:, :, None] * scale[:, None, :])
    return np.asarray(np.linalg.inv(np.linalg.cholesky(unit)) / scale[:, None, :])


def total(noise: dict[str, Array]) -> Array:
    """Sum of the covariances of all sources."""
    return np.asarray(sum(noise.values()))


class _Builder:
    """Collects the rows."""

    def __init__(self, columns: dict[str, slice]) -> None:
        self.columns, self.n = columns, max(c.stop for c in columns.values())
        self.A: list[Array] = []
        self.b: list[Array] = []
        self.rows: list[RowGroup] = []
        self.whitening: dict[str, Array] = {}
        self.m = 0

    def add(
        self,
        kind: str,
        owner: Indices,
        residual: Array,
        noise: dict[str, Array],
        eliminate_nuisances: list[tuple[str, Indices | int, Array]],
    ) -> None:
        """Add a group: residuals (n, d), covariances by source, and blocks (column name, number within it, Jacobian).

        Where a member has no such block its number is −1.
        """
        count, size = residual.shape
        if count == 0:
            return
        W = whiten(total(noise))
        J = np.zeros((count, size, self.n))
        for name, number, jacobian in eliminate_nuisances:
            width = jacobian.shape[2]
            at = np.broadcast_to(np.asarray(number), count)
            members = np.flatnonzero(at >= 0)
            columns = self.columns[name].start + width * at[members, None] + np.arange(width)
            J[members[:, None, None], np.arange(size)[:, None], columns[:, None, :]] += (W @ jacobian)[members]
        self.A.append(J.reshape(count * size, -1))
        self.b.append(np.einsum("nij,nj->ni", W, residual).ravel())
        self.whitening[kind] = W
        shares = {s: W @ R @ np.swapaxes(W, 1, 2) for s, R in noise.items() if np.any(R)}
        self.rows.append(RowGroup(kind, self.m, np.asarray(owner), shares, size))
        self.m += count * size


def linearise(
    joint: JointModel, state: JointState, compensated: CompensatedData, free: Mask, prior: Prior | None = None
) -> LinearSystem:
    """Linearise the joint problem.

    Parameters
    ----------
    problem : Problem
    point : Point
        With its attitudes.
    played : Played
        The data played back at it.
    free : ndarray of bool, shape (27,)
        Sensor errors to estimate; the others stay.
    prior : Prior, optional
    """
    data = joint.data
    W, K, C = len(compensated.force), data.K, len(joint.level_frames)
    assert state.attitude is not None
    edges = edge_numbers(joint, compensated)
    sizes = {
        "errors": N_ERRORS,
        "bias": 3 * (K if joint.bias_walks else 1),
        "base": 3,
        "mounting": 3,
        "gravity": 1,
        "earth_rate": 3 * C,
        "instability": compensated.instability.size,
        "attitude": 3 * W,
        "edge": 3 * int(edges.max() + 1),
    }
    stops = np.cumsum(list(sizes.values())).tolist()
    columns = {name: slice(stop - size, stop) for (name, size), stop in zip(sizes.items(), stops, strict=True)}
    build = _Builder(columns)
    _windows(build, joint, state, compensated, edges)
    _turns(build, joint, state, compensated, edges)
    _fixture(build, joint, state)
    _drift(build, compensated)
    _priors(build, joint, state, edges, prior)
    active = np.ones(stops[-1], dtype=np.bool_)
    active[columns["errors"]] = free[:N_ERRORS]
    active[columns["bias"]] = np.tile(free[N_ERRORS:], sizes["bias"] // 3)
    active[columns["earth_rate"]] = np.concatenate([c.unknown_sigma > 0.0 for c in joint.level_frames])
    if not joint.fixture_states:
        for name in ("base", "mounting", "gravity"):
            active[columns[name]] = False
    if data.recording.fixture is None:
        active[columns["base"]] = active[columns["mounting"]] = False
        active[columns["gravity"]] = joint.options.fixture_states
    active[columns["attitude"].start + 3 * fixed_headings(joint) + 2] = False
    A, b = np.concatenate(build.A), np.concatenate(build.b)
    return LinearSystem(A, b, columns, active, tuple(build.rows), free, build.whitening, compensated)


def edge_numbers(joint: JointModel, compensated: CompensatedData) -> Indices:
    """Number of the unknown reading error at both edges of every window, (W, 2); −1 where it is none of its own."""
    shared = np.stack([joint.is_end, joint.is_start], axis=1) & bool(compensated.edge_slope.any())
    numbers = np.cumsum(shared.ravel()).reshape(shared.shape) - 1
    return np.where(shared, numbers, -1)


def fixed_headings(joint: JointModel) -> Indices:
    """Windows whose heading is given: of a free chain the first, without fixture states every start."""
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


def _windows(
    build: _Builder, joint: JointModel, state: JointState, compensated: CompensatedData, edges: Indices
) -> None:
    """Specific force and rate of every window."""
    assert state.attitude is not None
    A, gravity = state.attitude, joint.data.gravity + state.gravity
    to_body = np.swapaxes(A, 1, 2)
    windows, sequence = np.arange(len(A)), joint.window_sequence
    bias_number = sequence if joint.bias_walks else np.zeros_like(sequence)
    residual, by_attitude, by_gravity = model.specific_force_residual(compensated.force, A, gravity)
    build.add(
        "force",
        sequence,
        residual,
        compensated.force_noise,
        [
            ("errors", 0, -compensated.force_jacobian[:, :, :N_ERRORS]),
            ("attitude", windows, by_attitude @ to_body),
            ("gravity", 0, by_gravity[:, :, None]),
            ("instability", 0, -compensated.instability.force),
        ],
    )
    residual, by_attitude, by_earth = model.angular_rate_residual(compensated.rate, A, joint.earth_rate(state))
    per_rate = compensated.edge_slope / joint.data.windows.duration_s[:, None, None]
    build.add(
        "rate",
        sequence,
        residual,
        compensated.rate_noise,
        [
            ("errors", 0, -compensated.rate_jacobian[:, :, :N_ERRORS]),
            ("bias", bias_number, -compensated.rate_jacobian[:, :, N_ERRORS:]),
            ("attitude", windows, by_attitude @ to_body),
            ("earth_rate", joint.window_frame, by_earth),
            ("edge", edges[:, 0], per_rate),
            ("edge", edges[:, 1], -per_rate),
            ("instability", 0, -compensated.instability.rate),
        ],
    )


def _turns(build: _Builder, joint: JointModel, state: JointState, compensated: CompensatedData, edges: Indices) -> None:
    """Rotation between the windows of every sequence."""
    assert state.attitude is not None
    data, sequences = joint.data, np.arange(joint.data.K)
    A = state.attitude
    earth = joint.earth_rate(state)[data.start]
    residual, by_start, by_end, by_turned, by_earth = model.rotation_residual(
        compensated.rotation, A[data.start], A[data.end], earth, compensated.duration_s
    )
    by_errors = by_turned @ compensated.rotation_jacobian
    build.add(
        "turn",
        sequences,
        residual,
        compensated.rotation_noise,
        [
            ("errors", 0, by_errors[:, :, :N_ERRORS]),
            ("bias", sequences if joint.bias_walks else 0, by_errors[:, :, N_ERRORS:]),
            ("attitude", data.start, by_start @ np.swapaxes(A[data.start], 1, 2)),
            ("attitude", data.end, by_end @ np.swapaxes(A[data.end], 1, 2)),
            ("earth_rate", joint.sequence_frame, by_earth),
            ("edge", edges[data.start, 1], -by_turned @ compensated.edge_slope),
            ("edge", edges[data.end, 0], by_turned @ compensated.rotation @ compensated.edge_slope),
            ("instability", 0, by_turned @ compensated.instability.rotation),
        ],
    )


def _fixture(build: _Builder, joint: JointModel, state: JointState) -> None:
    """Start attitudes against the fixture's, executed angles being known to their sigma."""
    found = fixture_starts(joint)
    if not joint.fixture_states or not found:
        return
    assert state.attitude is not None
    owner, windows = (np.array(x, dtype=np.intp) for x in ([f[0] for f in found], [f[1] for f in found]))
    A = state.attitude[windows]
    residual, by_attitude, by_base, by_U = model.start_attitude_residual(
        A, np.stack([f[2] for f in found]), state.base, state.U, joint.heading_rad
    )
    variance = np.diag(joint.start_sigma**2)
    build.add(
        "start",
        owner,
        residual,
        {"earth_rate_alignment": np.broadcast_to(variance, residual.shape[:1] + variance.shape)},
        [
            ("attitude", windows, by_attitude @ np.swapaxes(A, 1, 2)),
            ("base", 0, by_base),
            ("mounting", 0, by_U),
        ],
    )


def fixture_starts(joint: JointModel) -> list[tuple[int, int, Array]]:
    """Sequence, window and nominal attitude of every start on the fixture, poses without their turn included."""
    from estimators.joint_model import pose_nominal

    data = joint.data
    found = []
    for k in joint.order.tolist():
        nominal = joint.nominal[k]
        if nominal is not None:
            found.append((k, int(data.start[k]), nominal))
    found += [(int(joint.window_sequence[w]), w, pose_nominal(label)) for label, w in data.poses]
    return found


def _drift(build: _Builder, compensated: CompensatedData) -> None:
    """The draws of the drift, by sensor: independent and of unit variance."""
    for sensor, numbers in (
        ("gyro", np.flatnonzero(compensated.instability.is_gyro)),
        ("accel", np.flatnonzero(~compensated.instability.is_gyro)),
    ):
        unit = np.broadcast_to(np.eye(3), (len(numbers), 3, 3))
        none = np.full(len(numbers), -1, dtype=np.intp)
        sources = {f"{sensor}_bias_instability": unit}
        build.add(f"{sensor}_instability", none, np.zeros((len(numbers), 3)), sources, [("instability", numbers, unit)])


def _priors(build: _Builder, joint: JointModel, state: JointState, edges: Indices, prior: Prior | None) -> None:
    """What is known before the data: alignments, gravity, Earth's rate, bias walk, edges, sensor errors."""
    from srt.model.rotations import inverse_right_jacobian, rotation_vector

    one = np.array([-1], dtype=np.intp)
    if joint.fixture_states:
        for name, rotation in (("base", state.base), ("mounting", joint.U_prior.T @ state.U)):
            v = rotation_vector(rotation[None])
            build.add(
                name,
                one,
                v,
                {"earth_rate_alignment": joint.alignment_sigma**2 * np.eye(3)[None]},
                [(name, 0, inverse_right_jacobian(v))],
            )
    if joint.options.fixture_states:
        sigma = joint.data.recording.site.gravity_sigma_m_s2
        build.add(
            "gravity",
            one,
            np.array([[state.gravity]]),
            {"gravity": np.array([[[sigma**2]]])},
            [("gravity", 0, np.ones((1, 1, 1)))],
        )
    for c, frame in enumerate(joint.level_frames):
        unknown = frame.unknown_sigma
        if unknown.any():
            sigma3 = np.where(unknown > 0.0, unknown, 1.0)
            build.add(
                f"earth_rate:{c}",
                one,
                state.earth_rate[c][None],
                {"earth_rate_alignment": np.diag(sigma3**2)[None]},
                [("earth_rate", c, np.eye(3)[None])],
            )
    if joint.bias_walks:
        before, after = joint.order[:-1], joint.order[1:]
        step = state.bias_deviation[after] - state.bias_deviation[before]
        unit = np.broadcast_to(np.eye(3), (len(step), 3, 3))
        variance = joint.bias_walk_sigma() ** 2
        build.add(
            "walk",
            np.full(len(step), -1),
            step,
            {"gyro_bias_instability": variance[:, :, None] * np.eye(3)},
            [("bias", after, unit), ("bias", before, -unit)],
        )
    count = int(edges.max() + 1)
    unit = np.broadcast_to(np.eye(3), (count, 3, 3))
    owner = np.empty(count, dtype=np.intp)
    if count:
        owner[edges[joint.data.end, 0]] = np.arange(joint.data.K)
        owner[edges[joint.data.start, 1]] = np.arange(joint.data.K)
    build.add("edge", owner, np.zeros((count, 3)), {"gyro_quantization": unit}, [("edge", np.arange(count), unit)])
    if prior is not None:
        away = state.errors.vector - prior.mean.vector
        away[N_ERRORS:] += state.bias_deviation.mean(axis=0)
        number = joint.data.K if joint.bias_walks else 1
        E = np.eye(N_PARAMETERS)
        eliminate_nuisances: list[tuple[str, Indices | int, Array]] = [("errors", 0, E[None, :, :N_ERRORS])]
        eliminate_nuisances += [("bias", i, E[None, :, N_ERRORS:] / number) for i in range(number)]
        build.add("prior", one, away[None], {"prior": prior.covariance[None]}, eliminate_nuisances)
