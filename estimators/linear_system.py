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
    from estimators.joint_problem import Problem
    from estimators.linearisation_point import Played, Point
    from srt.model.prior import Prior
    from srt.types import Array, Indices, Mask


N_ERRORS: Final = GROUP_SLICES["gyro_bias"].start
"""Sensor errors without the gyro bias, which comes per sequence."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
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
class System:
    """Linearised problem: minimise ``|A δ + b|²`` over the active columns.

    Attributes
    ----------
    A : ndarray, shape (m, n)
    b : ndarray, shape (m,)
    columns : dict of str to slice
        "errors" (24), "bias" (3, or 3 per sequence), "base", "mounting", "gravity", "earth_rate" (3 per chain), "drift"
        (3 per window and turn of a sensor that drifts), "attitude" (3 per window), "edge" (3 per edge that counts).
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
    rows: tuple[Rows, ...]
    free: Mask
    whitening: dict[str, Array]
    played: Played

    def of(self, name: str) -> Indices:
        """Column numbers of a name."""
        return np.arange(self.columns[name].start, self.columns[name].stop)

    def rows_of(self, kind: str) -> Rows:
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


def attitude_columns(system: System) -> Mask:
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
        self.rows: list[Rows] = []
        self.whitening: dict[str, Array] = {}
        self.m = 0

    def add(
        self,
        kind: str,
        owner: Indices,
        residual: Array,
        noise: dict[str, Array],
        blocks: list[tuple[str, Indices | int, Array]],
    ) -> None:
        """Add a group: residuals (n, d), covariances by source, and blocks (column name, number within it, Jacobian).

        Where a member has no such block its number is −1.
        """
        count, size = residual.shape
        if count == 0:
            return
        W = whiten(total(noise))
        J = np.zeros((count, size, self.n))
        for name, number, jacobian in blocks:
            width = jacobian.shape[2]
            at = np.broadcast_to(np.asarray(number), count)
            members = np.flatnonzero(at >= 0)
            columns = self.columns[name].start + width * at[members, None] + np.arange(width)
            J[members[:, None, None], np.arange(size)[:, None], columns[:, None, :]] += (W @ jacobian)[members]
        self.A.append(J.reshape(count * size, -1))
        self.b.append(np.einsum("nij,nj->ni", W, residual).ravel())
        self.whitening[kind] = W
        shares = {s: W @ R @ np.swapaxes(W, 1, 2) for s, R in noise.items() if np.any(R)}
        self.rows.append(Rows(kind, self.m, np.asarray(owner), shares, size))
        self.m += count * size


def linearise(problem: Problem, point: Point, played: Played, free: Mask, prior: Prior | None = None) -> System:
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
    data = problem.data
    W, K, C = len(played.force), data.K, len(problem.chains)
    assert point.attitude is not None
    edges = edge_numbers(problem, played)
    sizes = {
        "errors": N_ERRORS,
        "bias": 3 * (K if problem.walks else 1),
        "base": 3,
        "mounting": 3,
        "gravity": 1,
        "earth_rate": 3 * C,
        "drift": played.drift.size,
        "attitude": 3 * W,
        "edge": 3 * int(edges.max() + 1),
    }
    stops = np.cumsum(list(sizes.values())).tolist()
    columns = {name: slice(stop - size, stop) for (name, size), stop in zip(sizes.items(), stops, strict=True)}
    build = _Builder(columns)
    _windows(build, problem, point, played, edges)
    _turns(build, problem, point, played, edges)
    _fixture(build, problem, point)
    _drift(build, played)
    _priors(build, problem, point, edges, prior)
    active = np.ones(stops[-1], dtype=np.bool_)
    active[columns["errors"]] = free[:N_ERRORS]
    active[columns["bias"]] = np.tile(free[N_ERRORS:], sizes["bias"] // 3)
    active[columns["earth_rate"]] = np.concatenate([c.unknown_sigma > 0.0 for c in problem.chains])
    if not problem.fixture_states:
        for name in ("base", "mounting", "gravity"):
            active[columns[name]] = False
    if data.recording.fixture is None:
        active[columns["base"]] = active[columns["mounting"]] = False
        active[columns["gravity"]] = problem.options.fixture_states
    active[columns["attitude"].start + 3 * fixed_headings(problem) + 2] = False
    A, b = np.concatenate(build.A), np.concatenate(build.b)
    return System(A, b, columns, active, tuple(build.rows), free, build.whitening, played)


def edge_numbers(problem: Problem, played: Played) -> Indices:
    """Number of the unknown reading error at both edges of every window, (W, 2); −1 where it is none of its own."""
    shared = np.stack([problem.is_end, problem.is_start], axis=1) & bool(played.edge_slope.any())
    numbers = np.cumsum(shared.ravel()).reshape(shared.shape) - 1
    return np.where(shared, numbers, -1)


def fixed_headings(problem: Problem) -> Indices:
    """Windows whose heading is given: of a free chain the first, without fixture states every start."""
    data, fixed = problem.data, []
    seen: set[int] = set()
    for k in problem.order.tolist():
        chain = int(problem.sequence_chain[k])
        if problem.chains[chain].fixture:
            if not problem.fixture_states:
                fixed.append(int(data.start[k]))
        elif chain not in seen:
            seen.add(chain)
            fixed.append(int(data.start[k]))
    if not problem.fixture_states:
        fixed += [w for _, w in data.poses]
    return np.array(sorted(set(fixed)), dtype=np.intp)


def _windows(build: _Builder, problem: Problem, point: Point, played: Played, edges: Indices) -> None:
    """Specific force and rate of every window."""
    assert point.attitude is not None
    A, gravity = point.attitude, problem.data.gravity + point.gravity
    to_body = np.swapaxes(A, 1, 2)
    windows, sequence = np.arange(len(A)), problem.window_sequence
    bias_number = sequence if problem.walks else np.zeros_like(sequence)
    residual, by_attitude, by_gravity = model.pose_force(played.force, A, gravity)
    build.add(
        "force",
        sequence,
        residual,
        played.force_noise,
        [
            ("errors", 0, -played.force_jacobian[:, :, :N_ERRORS]),
            ("attitude", windows, by_attitude @ to_body),
            ("gravity", 0, by_gravity[:, :, None]),
            ("drift", 0, -played.drift.force),
        ],
    )
    residual, by_attitude, by_earth = model.pose_rate(played.rate, A, problem.earth_rate(point))
    per_rate = played.edge_slope / problem.data.windows.duration_s[:, None, None]
    build.add(
        "rate",
        sequence,
        residual,
        played.rate_noise,
        [
            ("errors", 0, -played.rate_jacobian[:, :, :N_ERRORS]),
            ("bias", bias_number, -played.rate_jacobian[:, :, N_ERRORS:]),
            ("attitude", windows, by_attitude @ to_body),
            ("earth_rate", problem.window_chain, by_earth),
            ("edge", edges[:, 0], per_rate),
            ("edge", edges[:, 1], -per_rate),
            ("drift", 0, -played.drift.rate),
        ],
    )


def _turns(build: _Builder, problem: Problem, point: Point, played: Played, edges: Indices) -> None:
    """Rotation between the windows of every sequence."""
    assert point.attitude is not None
    data, sequences = problem.data, np.arange(problem.data.K)
    A = point.attitude
    earth = problem.earth_rate(point)[data.start]
    residual, by_start, by_end, by_turned, by_earth = model.turn(
        played.turned, A[data.start], A[data.end], earth, played.duration_s
    )
    by_errors = by_turned @ played.turned_jacobian
    build.add(
        "turn",
        sequences,
        residual,
        played.turned_noise,
        [
            ("errors", 0, by_errors[:, :, :N_ERRORS]),
            ("bias", sequences if problem.walks else 0, by_errors[:, :, N_ERRORS:]),
            ("attitude", data.start, by_start @ np.swapaxes(A[data.start], 1, 2)),
            ("attitude", data.end, by_end @ np.swapaxes(A[data.end], 1, 2)),
            ("earth_rate", problem.sequence_chain, by_earth),
            ("edge", edges[data.start, 1], -by_turned @ played.edge_slope),
            ("edge", edges[data.end, 0], by_turned @ played.turned @ played.edge_slope),
            ("drift", 0, by_turned @ played.drift.turned),
        ],
    )


def _fixture(build: _Builder, problem: Problem, point: Point) -> None:
    """Start attitudes against the fixture's, executed angles being known to their sigma."""
    found = fixture_starts(problem)
    if not problem.fixture_states or not found:
        return
    assert point.attitude is not None
    owner, windows = (np.array(x, dtype=np.intp) for x in ([f[0] for f in found], [f[1] for f in found]))
    A = point.attitude[windows]
    residual, by_attitude, by_base, by_U = model.start_attitude(
        A, np.stack([f[2] for f in found]), point.base, point.U, problem.heading_rad
    )
    variance = np.diag(problem.start_sigma**2)
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


def fixture_starts(problem: Problem) -> list[tuple[int, int, Array]]:
    """Sequence, window and nominal attitude of every start on the fixture, poses without their turn included."""
    from estimators.joint_problem import pose_nominal

    data = problem.data
    found = []
    for k in problem.order.tolist():
        nominal = problem.nominal[k]
        if nominal is not None:
            found.append((k, int(data.start[k]), nominal))
    found += [(int(problem.window_sequence[w]), w, pose_nominal(label)) for label, w in data.poses]
    return found


def _drift(build: _Builder, played: Played) -> None:
    """The draws of the drift, by sensor: independent and of unit variance."""
    for sensor, numbers in (
        ("gyro", np.flatnonzero(played.drift.is_gyro)),
        ("accel", np.flatnonzero(~played.drift.is_gyro)),
    ):
        unit = np.broadcast_to(np.eye(3), (len(numbers), 3, 3))
        none = np.full(len(numbers), -1, dtype=np.intp)
        sources = {f"{sensor}_bias_instability": unit}
        build.add(f"{sensor}_drift", none, np.zeros((len(numbers), 3)), sources, [("drift", numbers, unit)])


def _priors(build: _Builder, problem: Problem, point: Point, edges: Indices, prior: Prior | None) -> None:
    """What is known before the data: alignments, gravity, Earth's rate, bias walk, edges, sensor errors."""
    from srt.model.rotations import inverse_right_jacobian, rotation_vector

    one = np.array([-1], dtype=np.intp)
    if problem.fixture_states:
        for name, rotation in (("base", point.base), ("mounting", problem.U_prior.T @ point.U)):
            v = rotation_vector(rotation[None])
            build.add(
                name,
                one,
                v,
                {"earth_rate_alignment": problem.alignment_sigma**2 * np.eye(3)[None]},
                [(name, 0, inverse_right_jacobian(v))],
            )
    if problem.options.fixture_states:
        sigma = problem.data.recording.site.gravity_sigma_m_s2
        build.add(
            "gravity",
            one,
            np.array([[point.gravity]]),
            {"gravity": np.array([[[sigma**2]]])},
            [("gravity", 0, np.ones((1, 1, 1)))],
        )
    for c, chain in enumerate(problem.chains):
        unknown = chain.unknown_sigma
        if unknown.any():
            sigma3 = np.where(unknown > 0.0, unknown, 1.0)
            build.add(
                f"earth_rate:{c}",
                one,
                point.earth_rate[c][None],
                {"earth_rate_alignment": np.diag(sigma3**2)[None]},
                [("earth_rate", c, np.eye(3)[None])],
            )
    if problem.walks:
        before, after = problem.order[:-1], problem.order[1:]
        step = point.bias_deviation[after] - point.bias_deviation[before]
        unit = np.broadcast_to(np.eye(3), (len(step), 3, 3))
        variance = problem.walk_sigma() ** 2
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
        owner[edges[problem.data.end, 0]] = np.arange(problem.data.K)
        owner[edges[problem.data.start, 1]] = np.arange(problem.data.K)
    build.add("edge", owner, np.zeros((count, 3)), {"gyro_quantization": unit}, [("edge", np.arange(count), unit)])
    if prior is not None:
        away = point.errors.vector - prior.mean.vector
        away[N_ERRORS:] += point.bias_deviation.mean(axis=0)
        number = problem.data.K if problem.walks else 1
        E = np.eye(N_PARAMETERS)
        blocks: list[tuple[str, Indices | int, Array]] = [("errors", 0, E[None, :, :N_ERRORS])]
        blocks += [("bias", i, E[None, :, N_ERRORS:] / number) for i in range(number)]
        build.add("prior", one, away[None], {"prior": prior.covariance[None]}, blocks)
