"""Linearisation of a joint model about a state: measurements and priors as rows of a linear system."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array, vstack

from srt.estimation.error_sources import shared_edges
from srt.joint.linear_system import FIXTURE, N_ERRORS, Columns, LinearSystem, RowGroup, total, whiten
from srt.joint.measurement_kinds import alignment_covariances, fixed_headings, measurement_kinds
from srt.model.rotations import inverse_right_jacobian, rotation_vector
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import CompensatedData, JointState
    from srt.joint.measurement_kinds import MeasurementKind
    from srt.model.prior import Prior
    from srt.types import Array, Indices, Mask

    Block = tuple[str, Indices | int, Array]
    """Name of the columns, number of each member within them (−1: none), Jacobian (n or 1, d, width)."""

_RECORDING = np.array([-1], dtype=np.intp)
"""Owner of rows that belong to no sequence."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Joint model about a state; solvers that assemble the model by themselves need no more than the columns.

    Attributes
    ----------
    joint : JointModel
    state : JointState
        State, with its attitudes.
    compensated : CompensatedData
        Data compensated with ``state``.
    free : ndarray of bool, shape (27,)
        Sensor errors to estimate; the others are fixed.
    """

    joint: JointModel
    state: JointState
    compensated: CompensatedData
    free: Mask

    @cached_property
    def columns(self) -> Columns:
        """Columns of the corrections."""
        return _columns(self.joint, self.compensated)

    @cached_property
    def system(self) -> LinearSystem:
        """Rows over the columns, without a prior of the sensor errors."""
        return linearise(self.joint, self.state, self.compensated, self.free)


def linearise(
    joint: JointModel, state: JointState, compensated: CompensatedData, free: Mask, prior: Prior | None = None
) -> LinearSystem:
    """Linearise a joint model about a state.

    Parameters
    ----------
    joint : JointModel
    state : JointState
        State, with its attitudes.
    compensated : CompensatedData
        Data compensated with ``state``.
    free : ndarray of bool, shape (27,)
        Sensor errors to estimate; the others are fixed.
    prior : Prior, optional
        Prior of the sensor errors.
    """
    builder = _Builder(joint, state, compensated)
    builder.add_measurements()
    builder.add_drift()
    builder.add_alignment()
    builder.add_site()
    builder.add_drift_forms()
    builder.add_bias_walk()
    builder.add_edges()
    active = _active_columns(joint, builder.columns, free)
    system = LinearSystem(
        A=builder.matrix(),
        b=np.concatenate(builder.b),
        columns=builder.columns,
        active=active,
        rows=tuple(builder.rows),
        free=free,
        whitening=builder.whitening,
        compensated=compensated,
        order=joint.order,
    )
    return with_prior(system, joint, state, prior)


def with_prior(system: LinearSystem, joint: JointModel, state: JointState, prior: Prior | None) -> LinearSystem:
    """System with the rows of a prior of the sensor errors; the same system without one.

    Parameters
    ----------
    system : LinearSystem
        Linearised about ``state`` without a prior.
    joint : JointModel
    state : JointState
    prior : Prior or None
    """
    if prior is None:
        return system
    builder = _Builder(joint, state, system.compensated)
    builder.add_prior(prior)
    return replace(
        system,
        A=vstack([system.A, builder.matrix()], format="csr"),
        b=np.concatenate([system.b, *builder.b]),
        rows=(*system.rows, *(replace(rows, first=len(system.b)) for rows in builder.rows)),
        whitening=system.whitening | builder.whitening,
    )


def _columns(joint: JointModel, compensated: CompensatedData) -> Columns:
    """Columns of the system by name."""
    sizes = {
        "errors": N_ERRORS,
        "bias": 3 * (joint.data.K if joint.bias_walks else 1),
        **FIXTURE,
        "gravity": 1,
        "table_rate": 1 if joint.steady.rated.size else 0,
        "earth_rate": 3 * len(joint.level_frames),
        "drift_form": joint.choice.drift.size,
        "attitude": 3 * len(compensated.force),
        "edge": 3 * compensated.edges.unknowns,
    }
    for sensor in ("gyro", "accel"):
        drift = compensated.drift.get(sensor)
        sizes[f"{sensor}_drift"] = joint.data.K * drift.states if drift else 0
        sizes[f"{sensor}_drift_noise"] = joint.data.K * drift.unknowns if drift else 0
    return Columns(sizes)


def _active_columns(joint: JointModel, columns: Columns, free: Mask) -> Mask:
    """Mask of the columns that are estimated."""
    active = np.ones(columns.count, dtype=np.bool_)
    active[columns["errors"]] = free[:N_ERRORS]
    active[columns["bias"]] = np.tile(free[N_ERRORS:], len(columns.of("bias")) // 3)
    active[columns["earth_rate"]] = np.concatenate([frame.unknown_sigma > 0.0 for frame in joint.level_frames])
    for name in FIXTURE:
        active[columns[name]] = joint.fixture_states
    # Gravity is also estimated without a fixture.
    active[columns["gravity"]] = joint.options.fixture_states
    active[columns["attitude"].start + 3 * fixed_headings(joint) + 2] = False
    return active


class _Builder:
    """Rows of a linear system, group by group."""

    def __init__(self, joint: JointModel, state: JointState, compensated: CompensatedData) -> None:
        self.joint, self.state, self.compensated = joint, state, compensated
        self.columns = _columns(joint, compensated)
        self.entries: list[tuple[Indices, Indices, Array]] = []
        self.b: list[Array] = []
        self.rows: list[RowGroup] = []
        self.whitening: dict[str, Array] = {}
        self.m = 0

    def matrix(self) -> Any:
        """Jacobian of all rows, sparse."""
        row, column, value = (np.concatenate(part) for part in zip(*self.entries, strict=True))
        return csr_array((value, (row, column)), shape=(self.m, self.columns.count))

    def add(
        self,
        kind: str,
        owner: Indices,
        residual: Array,
        noise: dict[str, Array],
        blocks: list[Block],
        step: Indices | None = None,
    ) -> None:
        """Add a group of rows with their sequences, residuals (n, d), covariances by source and blocks of Jacobians.

        ``step`` is the step of the elimination of each member; default that of its sequence.
        """
        if len(residual) == 0:
            return
        W = whiten(total(noise))
        shares = {s: W @ R @ np.swapaxes(W, 1, 2) for s, R in noise.items() if np.any(R)}
        if step is None:
            step = np.where(np.asarray(owner) >= 0, self.joint.rank[owner], -1)
        whitened = [(name, number, W @ jacobian) for name, number, jacobian in blocks]
        self._append(kind, (owner, step), np.einsum("nij,nj->ni", W, residual), whitened, (W, shares))

    def _append(
        self,
        kind: str,
        place: tuple[Indices, Indices],
        residual: Array,
        blocks: list[Block],
        noise: tuple[Array, dict[str, Array]],
    ) -> None:
        """Append whitened rows with their sequences and steps, whitening matrices and shares of the sources."""
        count, size = residual.shape
        index = self.m + np.arange(count * size).reshape(count, size, 1)
        for name, number, jacobian in blocks:
            width = jacobian.shape[2]
            if width == 0:  # no drift is modelled
                continue
            shape = count, size, width
            columns = self.columns[name].start + width * np.reshape(number, (-1, 1, 1)) + np.arange(width)
            entries = tuple(np.broadcast_to(part, shape) for part in (index, columns, jacobian))
            if np.any(np.asarray(number) < 0):
                entries = tuple(part[np.asarray(number) >= 0] for part in entries)
            row, column, value = (part.ravel() for part in entries)
            self.entries.append((row, column, value))
        self.b.append(residual.ravel())
        self.whitening[kind] = noise[0]
        self.rows.append(RowGroup(kind, self.m, np.asarray(place[0]), place[1], noise[1], size))
        self.m += count * size

    def add_white(self, kind: str, name: str, source: str, place: tuple[Indices, Indices], size: int) -> None:
        """Add the prior of unknowns with mean zero and unit variance, ``size`` for each sequence and step of ``place``.

        They are the first columns ``name``.
        """
        count = len(place[0])
        unknowns: Indices = np.arange(count * size)
        self.entries.append((self.m + unknowns, self.columns[name].start + unknowns, np.ones(len(unknowns))))
        unit = np.broadcast_to(np.eye(size), (count, size, size))
        self._append(kind, place, np.zeros((count, size)), [], (unit, {source: unit}))

    def add_prior_of(self, name: str, number: int, value: Array, covariance: dict[str, Array], kind: str = "") -> None:
        """Add the prior of one unknown of columns ``name``, with mean zero."""
        unit = np.eye(len(value))[None]
        self.add(kind or name, _RECORDING, value[None], covariance, [(name, number, unit)])

    def add_measurements(self) -> None:
        """Measurements of all kinds, and the prior of the error of a rate table."""
        joint, state = self.joint, self.state
        assert state.attitude is not None
        values = {
            "attitude": state.attitude,
            "earth_rate": np.stack([frame.earth_rate for frame in joint.level_frames]) + state.earth_rate,
            "base": state.base[None],
            "mounting": state.U[None],
            "gravity": np.array([[state.gravity]]),
            "non_orthogonality": np.array([[state.non_orthogonality]]),
            "table_rate": np.array([[state.table_rate]]),
        }
        for kind in measurement_kinds(joint, state, self.compensated):
            at = (values[name][number] for name, number in kind.unknowns)
            residual, derivatives = kind.evaluate(np.arange(len(kind.owner)), *at)
            blocks: list[Block] = []
            for (name, number), J in zip(kind.unknowns, derivatives, strict=False):
                turned = J @ np.swapaxes(state.attitude[number], 1, 2) if name == "attitude" else J
                blocks.append((name, number, turned))
            if kind.by_errors is not None:
                blocks += self.reading_blocks(kind, derivatives[-1] if kind.scaled else -1.0)
            self.add(kind.name, kind.owner, residual, kind.noise, blocks)
        if self.compensated.stated.sequences.size:
            self.add_prior_of("table_rate", 0, np.array([state.table_rate]), {"stated_rate": np.ones((1, 1, 1))})

    def reading_blocks(self, kind: MeasurementKind, by_quantity: Array | float) -> list[Block]:
        """Blocks of what acts on the readings: sensor errors, bias, errors at window edges, and drift."""
        assert kind.by_errors is not None
        by_errors, key, members = _product(by_quantity, kind.by_errors), kind.quantity, kind.readings
        blocks: list[Block] = [("errors", 0, by_errors[:, :, :N_ERRORS])]
        if kind.sensor == "gyro":
            blocks.append(("bias", kind.owner if self.joint.bias_walks else 0, by_errors[:, :, N_ERRORS:]))
        blocks.append(("drift_form", 0, _product(by_quantity, self.compensated.drift_form[key][members])))
        blocks += self.edge_blocks(key, by_quantity, members)
        return blocks + self.drift_blocks(kind.sensor, key, by_quantity, members)

    def edge_blocks(self, kind: str, by_effect: Array | float, members: Indices) -> list[Block]:
        """Blocks of the errors at window edges; ``by_effect`` is the derivative of the residual by their effect."""
        return [
            ("edge", number[members], _product(by_effect, J if len(J) == 1 else J[members]))
            for number, J in self.compensated.edges.shared.get(kind, ())
        ]

    def drift_blocks(self, sensor: str, kind: str, by_drift: Array | float, members: Indices) -> list[Block]:
        """Blocks of the drift of a sensor; ``by_drift`` is the derivative of the residual by the drift's effect."""
        drift = self.compensated.drift.get(sensor)
        if drift is None:
            return []
        effects = (f"{sensor}_drift", drift.by_state[kind]), (f"{sensor}_drift_noise", drift.by_noise[kind])
        return [(name, drift.steps[kind][members], _product(by_drift, J[members])) for name, J in effects]

    def add_drift(self) -> None:
        """States of the bias instability: their distribution at the start, white unknowns, and transitions."""
        for sensor, drift in self.compensated.drift.items():
            K, name, source = self.joint.data.K, f"{sensor}_drift", f"{sensor}_bias_instability"
            steps, nobody = np.arange(K), np.full(K, -1)
            self.add_white(f"{name}_start", name, source, (nobody[:1], steps[:1]), drift.states)
            self.add_white(f"{name}_noise", f"{name}_noise", source, (nobody, steps), drift.unknowns)
            unit = np.broadcast_to(np.eye(drift.states), (K - 1, drift.states, drift.states))
            place, zero = (nobody[:-1], steps[:-1]), np.zeros((K - 1, drift.states))
            self._append(f"{name}_step", place, zero, self._transition(sensor), (unit, {source: unit}))

    def _transition(self, sensor: str) -> list[Block]:
        drift = self.compensated.drift[sensor]
        now = np.arange(self.joint.data.K - 1)
        name, ends = f"{sensor}_drift", [drift.states, drift.states + drift.unknowns]
        by_state, by_noise, by_next = np.split(drift.transition, ends, axis=2)
        return [(name, now, by_state), (f"{name}_noise", now, by_noise), (name, now + 1, by_next)]

    def add_alignment(self) -> None:
        """Priors of base, mounting and non-orthogonality."""
        joint, state = self.joint, self.state
        if not joint.fixture_states:
            return
        covariance = {source: R[None] for source, R in alignment_covariances(joint, 3).items()}
        for name, rotation in (("base", state.base), ("mounting", joint.choice.U_prior.T @ state.U)):
            v = rotation_vector(rotation[None])
            self.add(name, _RECORDING, v, covariance, [(name, 0, inverse_right_jacobian(v))])
        covariance = {source: R[None] for source, R in alignment_covariances(joint, 1).items()}
        self.add_prior_of("non_orthogonality", 0, np.array([state.non_orthogonality]), covariance)

    def add_site(self) -> None:
        """Priors of gravity and of the unknown part of the Earth's rate."""
        joint, state = self.joint, self.state
        if joint.options.fixture_states:
            variance = joint.data.recording.site.gravity_sigma_m_s2**2
            self.add_prior_of("gravity", 0, np.array([state.gravity]), {"gravity": np.array([[[variance]]])})
        for number, frame in enumerate(joint.level_frames):
            if frame.unknown_sigma.any():
                sigma = np.where(frame.unknown_sigma > 0.0, frame.unknown_sigma, 1.0)
                covariance = {"earth_rate_alignment": np.diag(sigma**2)[None]}
                self.add_prior_of("earth_rate", number, state.earth_rate[number], covariance, f"earth_rate:{number}")

    def add_drift_forms(self) -> None:
        """Prior of the coefficients of the modelled drift; wide but for random walks."""
        joint = self.joint
        if joint.choice.drift.size:
            self.add_prior_of("drift_form", 0, self.state.drift, {"drift": np.diag(joint.choice.drift.sigma**2)[None]})

    def add_bias_walk(self) -> None:
        """Steps of the gyro bias between sequences."""
        joint, deviation = self.joint, self.state.bias_deviation
        if not joint.bias_walks:
            return
        before, after = joint.order[:-1], joint.order[1:]
        unit = np.broadcast_to(np.eye(3), (len(before), 3, 3))
        covariance = {"gyro_bias_instability": (joint.bias_walk_sigma() ** 2)[:, :, None] * np.eye(3)}
        blocks: list[Block] = [("bias", after, unit), ("bias", before, -unit)]
        nobody = np.full(len(before), -1)
        self.add("walk", nobody, deviation[after] - deviation[before], covariance, blocks, np.arange(len(before)))

    def add_edges(self) -> None:
        """Unknowns of the quantization at window edges: independent, with unit variance."""
        data, count = self.joint.data, self.compensated.edges.unknowns
        owner, step = np.empty((2, count), dtype=np.intp)
        if count:
            # Rotation and window share an edge; its prior belongs to the earlier of the two.
            edges, first = shared_edges(data), self.joint.rank[self.joint.window_sequence]
            for windows, side in ((data.end, 0), (data.start, 1)):
                owner[edges[windows, side]] = np.arange(data.K)
                step[edges[windows, side]] = np.minimum(self.joint.rank, first[windows])
            self.add_white("edge", "edge", "gyro_quantization", (owner, step), 3)

    def add_prior(self, prior: Prior) -> None:
        """Add the prior of the sensor errors; the prior of the gyro bias applies to its mean over the sequences."""
        difference = self.state.errors.vector - prior.mean.vector
        number = self.joint.data.K if self.joint.bias_walks else 1
        E = np.eye(N_PARAMETERS)[None]
        blocks: list[Block] = [("errors", 0, E[:, :, :N_ERRORS])]
        blocks += [("bias", i, E[:, :, N_ERRORS:] / number) for i in range(number)]
        self.add("prior", _RECORDING, difference[None], {"prior": prior.covariance[None]}, blocks)


def _product(by_effect: Array | float, J: Array) -> Array:
    return by_effect * J if isinstance(by_effect, float) else np.asarray(by_effect @ J)
