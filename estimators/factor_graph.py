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
- ``t``: correction to the error of the rate table, in sigmas.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, D, E, F, G, L, N, Q, S, T, U, X

from estimators import factors
from srt.joint.drift import combined
from srt.joint.linear_system import N_ERRORS, total
from srt.joint.measurement_kinds import (
    fixed_headings,
    fixture_attitudes,
    rotation_kinds,
    rotation_noise,
    start_covariances,
)
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from srt.joint.linearisation import Linearisation
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
        self._windows()
        self._rotations()
        self._stated_rates()
        self._fixture_attitudes()
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
        if joint.drift.size:
            self.values.insert(S(0), np.zeros(joint.drift.size))
        if self.compensated.stated.sequences.size:
            self.values.insert(T(0), np.zeros(1))

    def _noise(self, covariance: Array, sequence: Sequence[int] | Indices) -> list[Any]:
        """Noise models of measurements, with the weights of their sequences."""
        return factors.gaussians(covariance / self.weights[sequence][:, None, None])

    def _add(self, kind: str, number: int, sequence: int, noise: Any, terms: factors.ErrorFunction) -> None:
        """Add a measurement factor of a sequence."""
        self.measured.append((kind, number, sequence))
        step = int(self.joint.rank[sequence])
        self.last_step.update({key: max(step, self.last_step.get(key, 0)) for key in terms.keys})
        self.graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))

    def _linear(self, jacobian: Array, sequence: int | None) -> list[tuple[int, Array]]:
        """Linear terms of sensor errors and bias."""
        out = []
        if len(self.errors):
            out.append((int(X(0)), jacobian[:, self.errors]))
        if sequence is not None and len(self.axes):
            out.append((self.bias_key(sequence), jacobian[:, N_ERRORS + self.axes]))
        return out

    def _forms(self, jacobian: Array) -> list[tuple[int, Array]]:
        """Linear term of the modelled drift."""
        return [(int(S(0)), jacobian)] if self.joint.drift.size else []

    def _drift(self, kind: str, number: int, sign: float = 1.0) -> list[tuple[int, Array]]:
        """Linear terms of the bias instability in a measurement, if specified."""
        if kind not in self.drift.steps:
            return []
        step, effects = int(self.drift.steps[kind][number]), (self.drift.by_state[kind], self.drift.by_noise[kind])
        return [(int(key(step)), sign * J[number]) for key, J in zip((D, N), effects, strict=True)]

    def _edges(self, kind: str, number: int) -> list[tuple[int, Array]]:
        """Linear terms of the errors at window edges that a window or rotation shares."""
        shared = self.compensated.edges.shared.get(kind, ())
        return [(int(Q(own[number])), J[number % len(J)]) for own, J in shared if own[number] >= 0]

    def _windows(self) -> None:
        """Add one factor per window for force and rate together, as a disturbance affects both."""
        joint, compensated = self.joint, self.compensated
        T = joint.data.windows.duration_s
        force_noise, rate_noise = total(compensated.force_noise), total(compensated.rate_noise)
        covariance = np.zeros((len(T), 6, 6))
        covariance[:, :3, :3], covariance[:, 3:, 3:] = force_noise, rate_noise
        noise = self._noise(covariance, joint.window_sequence)
        windows = factors.WindowFactors(
            compensated.force,
            compensated.rate,
            np.array([A(w) for w in range(len(T))], dtype=np.intp),
            joint.data.gravity,
            int(G(0)) if self.gravity else None,
            self._earth_rates(joint.window_frame),
        )
        self.kinds.append(windows)
        for w in range(len(T)):
            jacobian = -np.concatenate([compensated.force_jacobian[w], compensated.rate_jacobian[w]])
            linear = self._linear(jacobian, int(joint.window_sequence[w]))
            linear += self._drift("window", w, -1.0)
            linear += self._forms(-np.concatenate([compensated.drift_form[kind][w] for kind in ("force", "rate")]))
            linear += [(key, -np.concatenate([np.zeros((3, 3)), J])) for key, J in self._edges("rate", w)]
            owner = int(joint.window_sequence[w])
            self._add(
                "window", w, owner, noise[w], factors.ErrorFunction(linear, windows.keys(w), partial(windows.at, w))
            )

    def _earth_rates(self, frames: Indices) -> factors.EarthRate:
        """Earth's rate in the level frames of some factors."""
        known = np.stack([frame.earth_rate for frame in self.joint.level_frames])
        return factors.EarthRate(known[frames], [self.earth_key(frame) for frame in frames.tolist()])

    def _rotations(self) -> None:
        joint, compensated, data = self.joint, self.compensated, self.joint.data
        for kind, members in rotation_kinds(joint):
            covariances = rotation_noise(joint, self.state, compensated.rotation_noise, kind)
            noise = self._noise(total(covariances), members)
            starts, ends = (np.array([A(w) for w in at[members].tolist()], np.intp) for at in (data.start, data.end))
            rotations = factors.RotationFactors(
                compensated.rotation[members],
                starts,
                ends,
                self._earth_rates(joint.sequence_frame[members]),
                np.asarray(compensated.duration_s)[members],
                heading=kind == "heading",
            )
            self.kinds.append(rotations)
            for i, k in enumerate(members.tolist()):
                linear = self._linear(compensated.rotation_jacobian[k], k) + self._drift("turn", k)
                linear += self._forms(compensated.drift_form["turn"][k])
                linear += self._edges("turn", k)
                terms = factors.ErrorFunction(linear, rotations.keys(i), partial(rotations.at, i), scaled=True)
                self._add(kind, k, k, noise[i], terms)

    def _stated_rates(self) -> None:
        """Add the runs at a stated rate, and the prior of the error of the table's rate."""
        joint, compensated, runs = self.joint, self.compensated, self.compensated.stated
        if not runs.sequences.size:
            return
        windows = joint.data.start[runs.sequences]
        starts = np.array([A(w) for w in windows.tolist()], np.intp)
        earth = self._earth_rates(joint.window_frame[windows])
        kind = factors.StatedRateFactors(runs, starts, earth, self.state.table_rate)
        noise = self._noise(total(runs.noise), runs.sequences)
        self.kinds.append(kind)
        for r, k in enumerate(runs.sequences.tolist()):
            linear = self._linear(-runs.jacobian[r], k)
            linear += self._drift("stated_rate", r, -1.0)
            linear += self._forms(-compensated.drift_form["stated_rate"][r])
            linear.append((int(T(0)), runs.by_table_rate[r]))
            self._add("stated_rate", k, k, noise[r], factors.ErrorFunction(linear, kind.keys(r), partial(kind.at, r)))

    def _fixture_attitudes(self) -> None:
        joint = self.joint
        if not joint.fixture_states:
            return
        for name, poses, components in fixture_attitudes(joint):
            variance = np.tile(total(start_covariances(joint, components)), (len(poses), 1, 1))
            noises = self._noise(variance, [owner for owner, _, _ in poses])
            kind = factors.FixtureAttitudeFactors(
                np.stack([nominal for _, _, nominal in poses]),
                np.array([A(window) for _, window, _ in poses], dtype=np.intp),
                (int(F(0)), int(U(0)), int(L(0))),
                joint.heading_rad,
                components,
            )
            self.kinds.append(kind)
            for i, ((owner, window, _), noise) in enumerate(zip(poses, noises, strict=True)):
                self._add(name, window, owner, noise, factors.ErrorFunction([], kind.keys(i), partial(kind.at, i)))

    def _priors(self, prior: Prior | None) -> None:
        joint, graph = self.joint, self.graph

        def isotropic(size: int, sigma: float) -> Any:
            return factors.gaussian(sigma**2 * np.eye(size))

        if joint.fixture_states:
            tight = isotropic(3, joint.alignment_sigma)
            graph.add(gtsam.PriorFactorRot3(F(0), gtsam.Rot3(), tight))
            graph.add(gtsam.PriorFactorRot3(U(0), gtsam.Rot3(joint.U_prior), tight))
            graph.add(gtsam.PriorFactorVector(L(0), np.zeros(1), isotropic(1, joint.alignment_sigma)))
        if self.gravity:
            sigma = joint.data.recording.site.gravity_sigma_m_s2
            graph.add(gtsam.PriorFactorVector(G(0), np.zeros(1), isotropic(1, sigma)))
        for c, frame in enumerate(joint.level_frames):
            if self.earth_key(c) is not None:
                sigmas = np.where(
                    frame.unknown_sigma > 0.0, frame.unknown_sigma, _FIXED_RATE * frame.unknown_sigma.max()
                )
                graph.add(gtsam.PriorFactorVector(E(c), np.zeros(3), factors.gaussian(np.diag(sigmas**2))))
        for w in fixed_headings(joint).tolist():
            keep = np.array(self.values.atRot3(A(w)).matrix())
            noise = isotropic(1, _HEADING_SIGMA)
            terms = factors.ErrorFunction([], [int(A(w))], factors.heading(keep, int(A(w))))
            graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))
        unit = isotropic(3, 1.0)
        for number in range(self.compensated.edges.unknowns):
            graph.add(gtsam.PriorFactorVector(Q(number), np.zeros(3), unit))
        if self.compensated.drift:
            self._drift_chain()
        if self.compensated.stated.sequences.size:
            graph.add(gtsam.PriorFactorVector(T(0), np.full(1, -self.state.table_rate), isotropic(1, 1.0)))
        if joint.drift.size:
            wide = factors.gaussian(np.diag(joint.drift.sigma**2))
            graph.add(gtsam.PriorFactorVector(S(0), -self.state.drift, wide))
        if joint.bias_walks and len(self.axes):
            step = joint.bias_walk_sigma()[:, self.axes]
            for i, (before, after) in enumerate(zip(joint.order[:-1].tolist(), joint.order[1:].tolist(), strict=True)):
                done = self.state.bias_deviation[after] - self.state.bias_deviation[before]
                noise = factors.gaussian(np.diag(step[i] ** 2))
                graph.add(gtsam.BetweenFactorVector(B(before), B(after), -done[self.axes], noise))
        if prior is not None:
            self._error_prior(prior)

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
        unit = np.eye(N_PARAMETERS)
        linear = [(int(X(0)), unit[:, self.errors])] if len(self.errors) else []
        number = joint.data.K if joint.bias_walks else 1
        if len(self.axes):
            linear += [(int(B(k)), unit[:, N_ERRORS + self.axes] / number) for k in range(number)]
        if not linear:
            return
        noise = factors.gaussian(prior.covariance)
        terms = factors.ErrorFunction(linear, [], lambda _: (away, []))
        self.graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))
