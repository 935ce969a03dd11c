"""Factor graph of a joint model: variables, factors and priors.

Variables:

- ``x``: sensor errors;
- ``b``: gyro bias of each sequence, a random walk;
- ``f``: levelling and north of the fixture's base;
- ``u``: orientation of MARS on the table;
- ``l``: non-orthogonality of the fixture's axes;
- ``g``: correction to gravity;
- ``e``: unknown part of the Earth's rate in each level frame;
- ``a``: attitude in each stationary window;
- ``q``: quantization error at each window edge;
- ``d``, ``n``: states and white unknowns of the bias instability of all sensors, by step;
- ``s``: correction to the coefficients of the modelled drift;
- ``t``: error of the rate table, in sigmas.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, D, E, F, G, L, N, Q, S, T, U, X

from estimators import factors
from srt.joint.drift import combined
from srt.joint.linear_system import N_ERRORS, total
from srt.joint.measurement_kinds import alignment_covariances, fixed_headings, measurement_kinds
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.joint.linearisation import Linearisation
    from srt.joint.measurement_kinds import MeasurementKind
    from srt.model.prior import Prior
    from srt.types import Array, Indices


_LOCAL: Final = "aqnd"
"""Variables of one step, in the order of their elimination."""
_COLUMNS: Final = {
    "x": ("errors", N_ERRORS), "b": ("bias", 3), "a": ("attitude", 3), "f": ("base", 3), "u": ("mounting", 3),
    "l": ("non_orthogonality", 1), "g": ("gravity", 1), "e": ("earth_rate", 3), "q": ("edge", 3),
    "s": ("drift_form", 0), "t": ("table_rate", 1),
}  # fmt: skip
"""Columns of the joint model that the variables stand for, and how many each takes; 0: all."""
_DRIFT: Final = {"d": "drift", "n": "drift_noise"}
_HEADING_SIGMA: Final = 1e-8
"""Standard deviation of a fixed heading, rad; its effect via the Earth's rate is far below any noise."""
_FIXED_RATE: Final = 1e-6
"""Standard deviation of known components of the Earth's rate, relative to that of the unknown ones."""


class FactorGraph:
    """Factor graph of a joint model about a state.

    Parameters
    ----------
    point : Linearisation
    prior : Prior, optional
    weights : ndarray, shape (K,), optional
        Weights of the sequences from a robust loss.
    """

    def __init__(self, point: Linearisation, *, prior: Prior | None = None, weights: Array | None = None) -> None:
        joint, compensated = point.joint, point.compensated
        self.point, self.joint, self.state, self.compensated = point, joint, point.state, compensated
        self.errors = np.flatnonzero(point.free[:N_ERRORS])
        self.axes = np.flatnonzero(point.free[N_ERRORS:])
        self.weights = np.ones(joint.data.K) if weights is None else weights
        self.gravity = joint.options.fixture_states
        self.graph: Any = gtsam.NonlinearFactorGraph()
        self.values: Any = gtsam.Values()
        self.kinds: list[factors.FactorGroup] = []
        self.measured: list[tuple[str, int, int]] = []
        """Kind, number and sequence of each measurement factor. These factors are the first in the graph."""
        self.last_step: dict[int, int] = {}
        """Last step in time that measures each variable."""
        self.drift = combined(compensated.drift)
        """Bias instability of gyros and accelerometers as one process: half the variables and Jacobians for gtsam."""
        self._variables()
        self._linear_variables()
        self._measurements()
        self._priors(prior)

    @contextmanager
    def evaluated(self, values: Any) -> Iterator[None]:
        """Context that evaluates all factors at given values; inside it, they are valid at these values only."""
        for kind in self.kinds:
            kind.prepare(values)
        try:
            yield
        finally:
            for kind in self.kinds:
                kind.forget()

    def bias_key(self, sequence: int) -> int:
        """Variable of the gyro bias of a sequence."""
        return int(B(sequence if self.joint.bias_walks else 0))

    def earth_key(self, frame: int) -> int | None:
        """Variable of the Earth's rate of a level frame, if unknown."""
        return int(E(frame)) if self.joint.level_frames[frame].unknown_sigma.any() else None

    def reported_keys(self) -> list[int]:
        """Variables of the reported parameters: biases, then errors."""
        biases = range(self.joint.data.K if self.joint.bias_walks else 1)
        return [int(B(k)) for k in biases if len(self.axes)] + ([int(X(0))] if len(self.errors) else [])

    def columns_of(self, key: int) -> Indices:
        """Columns of the joint model that stand for a variable; those of an attitude are in L, not in B."""
        columns, letter, number = self.point.columns, chr(gtsam.symbolChr(key)), gtsam.symbolIndex(key)
        if letter in _DRIFT:
            sensors = [columns.of(f"{sensor}_{_DRIFT[letter]}") for sensor in self.compensated.drift]
            return np.concatenate([of.reshape(self.joint.data.K, -1)[number] for of in sensors])
        name, width = _COLUMNS[letter]
        own: Indices = columns.of(name).reshape(-1, width or columns.of(name).size)[number]
        return np.asarray(own[{"x": self.errors, "b": self.axes}.get(letter, slice(None))])

    @cached_property
    def elimination_order(self) -> Any:
        """Variables step by step in time, then those of the whole recording, the reported ones last.

        With bias instability, minimum degree (COLAMD) makes a third more cliques and takes a third longer.
        """
        reported, K = self.reported_keys(), self.joint.data.K

        def place(key: int) -> tuple[int, int]:
            letter = _LOCAL.find(chr(gtsam.symbolChr(key)))
            step = self.last_step.get(key, gtsam.symbolIndex(key))
            return (K, int(key in reported)) if letter < 0 else (step, letter)

        out = gtsam.Ordering()
        for key in sorted(self.values.keys(), key=place):
            out.push_back(key)
        return out

    def _variables(self) -> None:
        joint, state = self.joint, self.state
        if len(self.errors):
            self.values.insert(X(0), np.zeros(len(self.errors)))
        if len(self.axes):
            for k in range(joint.data.K if joint.bias_walks else 1):
                self.values.insert(B(k), np.zeros(len(self.axes)))
        assert state.attitude is not None
        for w, attitude in enumerate(state.attitude):
            self.values.insert(A(w), gtsam.Rot3(attitude))
        for c in range(len(joint.level_frames)):
            if self.earth_key(c) is not None:
                self.values.insert(E(c), state.earth_rate[c])
        if joint.fixture_states:
            self.values.insert(F(0), gtsam.Rot3(state.base))
            self.values.insert(U(0), gtsam.Rot3(state.U))
            self.values.insert(L(0), np.array([state.non_orthogonality]))
        if self.gravity:
            self.values.insert(G(0), np.array([state.gravity]))

    def _linear_variables(self) -> None:
        """Add the variables that are corrections, with linear terms alone."""
        joint = self.joint
        for number in range(self.compensated.edges.unknowns):
            self.values.insert(Q(number), np.zeros(3))
        if self.compensated.drift:
            for key, size in ((D, self.drift.states), (N, self.drift.unknowns)):
                for step in range(joint.data.K):
                    self.values.insert(key(step), np.zeros(size))
        if joint.choice.drift.size:
            self.values.insert(S(0), np.zeros(joint.choice.drift.size))
        if self.compensated.stated.sequences.size:
            self.values.insert(T(0), np.full(1, self.state.table_rate))

    def _add(self, kind: str, numbers: Indices, owners: Indices, covariance: Array, group: factors.FactorGroup) -> None:
        """Add measurements of a kind by number, with their sequences, whose weights apply to their covariances."""
        noises = factors.gaussians(covariance / self.weights[owners][:, None, None])
        self.kinds.append(group)
        for row, (number, owner, noise) in enumerate(zip(numbers.tolist(), owners.tolist(), noises, strict=True)):
            factor, step = group.factor(row, noise), int(self.joint.rank[owner])
            self.measured.append((kind, number, owner))
            self.last_step.update({key: max(step, self.last_step.get(key, 0)) for key in list(factor.keys())})
            self.graph.add(factor)

    def _linear(self, J: Array, owners: Indices, kind: str, by_form: Array, sign: float) -> list[factors.Term]:
        """Linear terms of sensor errors and bias (n, d, 27), of modelled drift, and of bias instability and edges."""
        n, errors, axes = len(owners), self.errors, N_ERRORS + self.axes
        out: list[factors.Term] = [([X(0)] * n, sign * J[:, :, errors])] if len(errors) else []
        if len(axes):
            out.append(([self.bias_key(k) for k in owners.tolist()], sign * J[:, :, axes]))
        if self.joint.choice.drift.size:
            out.append(([S(0)] * n, sign * by_form))
        if kind in self.drift.steps:
            steps = self.drift.steps[kind].tolist()
            for key, effect in ((D, self.drift.by_state[kind]), (N, self.drift.by_noise[kind])):
                out.append(([key(step) for step in steps], sign * effect))
        for own, shared in self.compensated.edges.shared.get({"window": "rate"}.get(kind, kind), ()):
            lacking = np.zeros((n, J.shape[1] - shared.shape[1], 3))  # of a window, its force
            by_edge = np.concatenate([lacking, np.broadcast_to(shared, (n, *shared.shape[1:]))], axis=1)
            out.append(([Q(number) if number >= 0 else None for number in own.tolist()], sign * by_edge))
        return out

    def _keys(self, name: str, numbers: Indices) -> factors.Keys:
        """Variables of unknowns of the joint model; None where they are known."""
        if name == "earth_rate":
            return [self.earth_key(frame) for frame in numbers.tolist()]
        if name == "gravity" and not self.gravity:
            return [None] * len(numbers)
        letter = next(letter for letter, (columns, _) in _COLUMNS.items() if columns == name)
        return [int(gtsam.symbol(letter, number)) for number in numbers.tolist()]

    def _evaluate(self, kind: MeasurementKind, values: Any, rows: Indices) -> factors.Linearised:
        """Residuals and derivatives of members of a kind at gtsam's values."""
        at = []
        for name, numbers in kind.unknowns:
            keys = self._keys(name, numbers[rows])
            if name in ("attitude", "base", "mounting"):
                at.append(factors.matrices(values, np.array(keys)))
                continue
            size = 3 if name == "earth_rate" else 1
            found = np.stack([np.zeros(size) if key is None else values.atVector(key) for key in keys])
            if name == "earth_rate":
                found += np.stack([frame.earth_rate for frame in self.joint.level_frames])[numbers[rows]]
            at.append(found)
        return kind.evaluate(rows, *at)

    def _measurements(self) -> None:
        """Add a factor for each measurement; of a window one for force and rate, as a disturbance affects both."""
        force, rate, *others = measurement_kinds(self.joint, self.state, self.compensated)
        self._add_windows(force, rate)
        for kind in others:
            self._add_kind(kind)

    def _add_windows(self, force: MeasurementKind, rate: MeasurementKind) -> None:
        (attitude, windows), gravity = force.unknowns
        earth = rate.unknowns[1]
        covariance = np.zeros((len(windows), 6, 6))
        covariance[:, :3, :3], covariance[:, 3:, 3:] = total(force.noise), total(rate.noise)

        def evaluate(values: Any, rows: Indices) -> factors.Linearised:
            (f, by_force), (w, by_rate) = (self._evaluate(kind, values, rows) for kind in (force, rate))
            by_gravity, by_earth = (np.zeros((len(rows), 6, width)) for width in (1, 3))
            by_gravity[:, :3], by_earth[:, 3:] = by_force[1], by_rate[1]
            by_attitude = np.concatenate([by_force[0], by_rate[0]], axis=1)
            return np.concatenate([f, w], axis=1), [by_attitude, by_gravity, by_earth]

        jacobian, by_form = np.concatenate([force.by_errors, rate.by_errors], axis=1), self.compensated.drift_form
        by_form_of_both = np.concatenate([by_form["force"], by_form["rate"]], axis=1)
        linear = self._linear(jacobian, force.owner, "window", by_form_of_both, -1.0)
        keys = [self._keys(*unknown) for unknown in ((attitude, windows), gravity, earth)]
        self._add("window", force.number, force.owner, covariance, factors.FactorGroup(keys, evaluate, linear))

    def _add_kind(self, kind: MeasurementKind) -> None:
        """Add one factor for each member of a kind."""

        def evaluate(values: Any, rows: Indices) -> factors.Linearised:
            return self._evaluate(kind, values, rows)

        linear: list[factors.Term] = []
        if kind.by_errors is not None:
            key, members, sign = kind.quantity, kind.readings.tolist(), 1.0 if kind.scaled else -1.0
            whole = np.zeros((len(self.compensated.drift_form[key]), *kind.by_errors.shape[1:]))
            whole[kind.readings] = kind.by_errors
            owners = np.zeros(len(whole), dtype=np.intp)
            owners[kind.readings] = kind.owner
            linear = self._linear(whole, owners, key, self.compensated.drift_form[key], sign)
            linear = [([keys[k] for k in members], J[kind.readings]) for keys, J in linear]
        keys = [self._keys(*unknown) for unknown in kind.unknowns]
        group = factors.FactorGroup(keys, evaluate, linear, scaled=kind.scaled)
        self._add(kind.name, kind.number, kind.owner, total(kind.noise), group)

    def _priors(self, prior: Prior | None) -> None:
        joint, graph = self.joint, self.graph

        def isotropic(size: int, sigma: float) -> Any:
            return factors.gaussian(sigma**2 * np.eye(size))

        if joint.fixture_states:
            of_axes, of_angle = (factors.gaussian(total(alignment_covariances(joint, size))) for size in (3, 1))
            graph.add(gtsam.PriorFactorRot3(F(0), gtsam.Rot3(), of_axes))
            graph.add(gtsam.PriorFactorRot3(U(0), gtsam.Rot3(joint.choice.U_prior), of_axes))
            graph.add(gtsam.PriorFactorVector(L(0), np.zeros(1), of_angle))
        if self.gravity:
            sigma = joint.data.recording.site.gravity_sigma_m_s2
            graph.add(gtsam.PriorFactorVector(G(0), np.zeros(1), isotropic(1, sigma)))
        for c, frame in enumerate(joint.level_frames):
            if self.earth_key(c) is not None:
                sigmas = np.where(
                    frame.unknown_sigma > 0.0, frame.unknown_sigma, _FIXED_RATE * frame.unknown_sigma.max()
                )
                graph.add(gtsam.PriorFactorVector(E(c), np.zeros(3), factors.gaussian(np.diag(sigmas**2))))
        self._fixed_headings(isotropic(1, _HEADING_SIGMA))
        unit = isotropic(3, 1.0)
        for number in range(self.compensated.edges.unknowns):
            graph.add(gtsam.PriorFactorVector(Q(number), np.zeros(3), unit))
        if self.compensated.drift:
            self._drift_chain()
        if self.compensated.stated.sequences.size:
            graph.add(gtsam.PriorFactorVector(T(0), np.zeros(1), isotropic(1, 1.0)))
        if joint.choice.drift.size:
            wide = factors.gaussian(np.diag(joint.choice.drift.sigma**2))
            graph.add(gtsam.PriorFactorVector(S(0), -self.state.drift, wide))
        if joint.bias_walks and len(self.axes):
            step = joint.bias_walk_sigma()[:, self.axes]
            for i, (before, after) in enumerate(zip(joint.order[:-1].tolist(), joint.order[1:].tolist(), strict=True)):
                done = self.state.bias_deviation[after] - self.state.bias_deviation[before]
                noise = factors.gaussian(np.diag(step[i] ** 2))
                graph.add(gtsam.BetweenFactorVector(B(before), B(after), -done[self.axes], noise))
        if prior is not None:
            self._error_prior(prior)

    def _fixed_headings(self, noise: Any) -> None:
        """Keep the headings that are given: rotations about the vertical since the attitudes of the state."""
        windows = fixed_headings(self.joint)
        attitudes = _attitudes(windows)
        assert self.state.attitude is not None
        kept = self.state.attitude[windows]

        def evaluate(values: Any, rows: Indices) -> factors.Linearised:
            now = factors.matrices(values, attitudes[rows])
            turned = kept[rows] @ np.swapaxes(now, 1, 2)
            return 0.5 * (turned[:, 0, 1] - turned[:, 1, 0])[:, None], [now[:, 2:]]

        group = factors.FactorGroup([attitudes.tolist()], evaluate, [])
        for row in range(len(windows)):
            self.graph.add(group.factor(row, noise))

    def _drift_chain(self) -> None:
        """Add the distribution of the states at the start, that of the white unknowns, and the transitions."""
        X, U, K = self.drift.states, self.drift.unknowns, self.joint.data.K
        white, unit = gtsam.noiseModel.Unit.Create(X), gtsam.noiseModel.Unit.Create(U)
        self.graph.add(gtsam.PriorFactorVector(D(0), np.zeros(X), white))
        for i in range(K):
            self.graph.add(gtsam.PriorFactorVector(N(i), np.zeros(U), unit))
        for i, coefficients in enumerate(self.drift.transition):
            now = D(i), coefficients[:, :X], N(i), coefficients[:, X : X + U]
            linear = gtsam.JacobianFactor(*now, D(i + 1), coefficients[:, X + U :], np.zeros(X), white)
            self.graph.add(gtsam.LinearContainerFactor(linear, self.values))

    def _error_prior(self, prior: Prior) -> None:
        """Add the prior of the sensor errors; with one gyro bias per sequence, the prior applies to their mean."""
        joint = self.joint
        away = self.state.errors.vector - prior.mean.vector
        unit, number = np.eye(N_PARAMETERS)[None], joint.data.K if joint.bias_walks else 1
        linear: list[factors.Term] = [([X(0)], unit[:, :, self.errors])] if len(self.errors) else []
        if len(self.axes):
            linear += [([B(k)], unit[:, :, N_ERRORS + self.axes] / number) for k in range(number)]
        if linear:
            group = factors.FactorGroup([], lambda *_: (away[None], []), linear)
            self.graph.add(group.factor(0, factors.gaussian(prior.covariance)))


def _attitudes(windows: Indices) -> Indices:
    """Variables of the attitudes of windows."""
    return np.array([A(w) for w in windows.tolist()], dtype=np.intp)
