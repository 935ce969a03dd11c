"""The factor graph of a joint problem: its variables, factors and priors.

Variables: sensor errors ``x``, gyro bias of every sequence ``b`` joined by a random walk, levelling and north of the
base ``f``, orientation of MARS on the table ``u``, gravity ``g``, the Earth's rate where it is unknown ``e``, the
attitude of every stationary window ``a``, the reading errors at the windows' edges ``q``, and the draws of the drift
``d``, one variable as every window tells of all.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, D, E, F, G, Q, U, X

from estimators import factors
from estimators.linear_system import N_ERRORS, edge_numbers, fixed_headings, fixture_starts, total
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.joint_problem import Problem
    from estimators.linearisation_point import Played, Point
    from srt.model.prior import Prior
    from srt.types import Array, Indices, Mask


_HEADING_SIGMA: Final = 1e-8
"""One sigma, rad, of a heading that is given: across the Earth's rate far below any noise."""


class GraphBuilder:
    """The factor graph of a joint problem at a play-back.

    Parameters
    ----------
    problem : Problem
    point : Point
        Values that the data were played back with, attitudes included.
    played : Played
    free : ndarray of bool, shape (27,)
        Sensor errors that are estimated.
    prior : Prior, optional
    weights : ndarray, shape (K,), optional
        Of every sequence's measurements, from a robust loss.
    """

    def __init__(
        self,
        problem: Problem,
        point: Point,
        played: Played,
        free: Mask,
        *,
        prior: Prior | None = None,
        weights: Array | None = None,
    ) -> None:
        assert point.attitude is not None
        self.problem, self.point, self.played = problem, point, played
        self.errors = np.flatnonzero(free[:N_ERRORS])
        self.axes = np.flatnonzero(free[N_ERRORS:])
        self.weights = np.ones(problem.data.K) if weights is None else weights
        self.gravity = problem.options.fixture_states
        self.edges = edge_numbers(problem, played)
        self.graph: Any = gtsam.NonlinearFactorGraph()
        self.values: Any = gtsam.Values()
        self.kinds: list[factors.Kind] = []
        self.measured: list[tuple[str, int, int]] = []
        """Kind, number and sequence of the measurement factors, which come first in the graph."""
        self._variables()
        self._windows()
        self._turns()
        self._starts()
        self._priors(prior)

    @contextmanager
    def evaluated(self, values: Any) -> Iterator[None]:
        """Compute all factors at some values, the only ones that they may be asked for within."""
        for kind in self.kinds:
            kind.prepare(values)
        try:
            yield
        finally:
            for kind in self.kinds:
                kind.forget()

    def bias_key(self, sequence: int) -> int:
        """Variable of the gyro bias of a sequence."""
        return int(B(sequence if self.problem.walks else 0))

    def earth_key(self, chain: int) -> int | None:
        """Variable of the Earth's rate of a chain, if it is unknown."""
        return int(E(chain)) if self.problem.chains[chain].unknown_sigma.any() else None

    def reported_keys(self) -> list[int]:
        """Variables that the reported parameters come from: biases, then errors."""
        biases = range(self.problem.data.K if self.problem.walks else 1)
        return [int(B(k)) for k in biases if len(self.axes)] + ([int(X(0))] if len(self.errors) else [])

    def _variables(self) -> None:
        problem, point = self.problem, self.point
        if len(self.errors):
            self.values.insert(X(0), np.zeros(len(self.errors)))
        if len(self.axes):
            for k in range(problem.data.K if problem.walks else 1):
                self.values.insert(B(k), np.zeros(len(self.axes)))
        assert point.attitude is not None
        for w, attitude in enumerate(point.attitude):
            self.values.insert(A(w), gtsam.Rot3(attitude))
        for number in range(int(self.edges.max()) + 1):
            self.values.insert(Q(number), np.zeros(3))
        if self.played.drift.size:
            self.values.insert(D(0), np.zeros(self.played.drift.size))
        for c in range(len(problem.chains)):
            if self.earth_key(c) is not None:
                self.values.insert(E(c), point.earth_rate[c])
        if problem.fixture_states:
            self.values.insert(F(0), gtsam.Rot3(point.base))
            self.values.insert(U(0), gtsam.Rot3(point.U))
        if self.gravity:
            self.values.insert(G(0), np.array([point.gravity]))

    def _noise(self, covariance: Array, sequence: Sequence[int] | Indices) -> list[Any]:
        """Noise models of measurements of sequences, with the weights of these."""
        return factors.gaussians(covariance / self.weights[sequence][:, None, None])

    def _add(self, kind: str, number: int, sequence: int, noise: Any, terms: factors.Terms) -> None:
        """Add a measurement factor of a sequence; held variables are left out of it."""
        self.measured.append((kind, number, sequence))
        self.graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))

    def _linear(self, jacobian: Array, sequence: int | None) -> list[tuple[int, Array]]:
        """Terms of sensor errors and bias, constant between play-backs."""
        out = []
        if len(self.errors):
            out.append((int(X(0)), jacobian[:, self.errors]))
        if sequence is not None and len(self.axes):
            out.append((self.bias_key(sequence), jacobian[:, N_ERRORS + self.axes]))
        return out

    def _drift(self, effect: Array) -> list[tuple[int, Array]]:
        """Term of the draws of the drift, if there is one."""
        return [(int(D(0)), effect)] if self.played.drift.size else []

    def _windows(self) -> None:
        """One factor for the force and the rate of a window: what is wrong with a window is wrong with both."""
        problem, played = self.problem, self.played
        T = problem.data.windows.duration_s
        force_noise, rate_noise = total(played.force_noise), total(played.rate_noise)
        known = np.stack([c.earth_rate for c in problem.chains])
        covariance = np.zeros((len(T), 6, 6))
        covariance[:, :3, :3], covariance[:, 3:, 3:] = force_noise, rate_noise
        noise = self._noise(covariance, problem.window_sequence)
        poses = factors.Poses(
            played.force,
            played.rate,
            np.array([A(w) for w in range(len(T))], dtype=np.intp),
            problem.data.gravity,
            int(G(0)) if self.gravity else None,
            known[problem.window_chain],
            [self.earth_key(int(chain)) for chain in problem.window_chain],
        )
        self.kinds.append(poses)
        for w in range(len(T)):
            jacobian = -np.concatenate([played.force_jacobian[w], played.rate_jacobian[w]])
            linear = self._linear(jacobian, int(problem.window_sequence[w]))
            linear += self._drift(-np.concatenate([played.drift.force[w], played.drift.rate[w]]))
            slope = played.edge_slope / T[w]
            linear += [
                (int(Q(number)), np.concatenate([np.zeros((3, 3)), sign * slope]))
                for number, sign in zip(self.edges[w].tolist(), (1.0, -1.0), strict=True)
                if number >= 0
            ]
            owner = int(problem.window_sequence[w])
            self._add("window", w, owner, noise[w], factors.Terms(linear, poses.keys(w), partial(poses.at, w)))

    def _turns(self) -> None:
        problem, played = self.problem, self.played
        data, noise = problem.data, self._noise(total(played.turned_noise), np.arange(problem.data.K))
        known = np.stack([c.earth_rate for c in problem.chains])
        earth_keys = [self.earth_key(int(chain)) for chain in problem.sequence_chain]
        starts, ends = (np.array([A(int(w)) for w in which], dtype=np.intp) for which in (data.start, data.end))
        turns = factors.Turns(
            played.turned, starts, ends, known[problem.sequence_chain], earth_keys, np.asarray(played.duration_s)
        )
        self.kinds.append(turns)
        for k in range(data.K):
            start, end = int(data.start[k]), int(data.end[k])
            linear = self._linear(played.turned_jacobian[k], k) + self._drift(played.drift.turned[k])
            if self.edges[start, 1] >= 0:
                linear.append((int(Q(self.edges[start, 1])), -played.edge_slope))
            if self.edges[end, 0] >= 0:
                linear.append((int(Q(self.edges[end, 0])), played.turned[k] @ played.edge_slope))
            terms = factors.Terms(linear, turns.keys(k), partial(turns.at, k), scaled=True)
            self._add("turn", k, k, noise[k], terms)

    def _starts(self) -> None:
        problem = self.problem
        if not problem.fixture_states:
            return
        starts = fixture_starts(problem)
        if not starts:
            return
        variance = np.tile(np.diag(problem.start_sigma**2), (len(starts), 1, 1))
        noises = self._noise(variance, [owner for owner, _, _ in starts])
        kind = factors.Starts(
            np.stack([nominal for _, _, nominal in starts]),
            np.array([A(window) for _, window, _ in starts], dtype=np.intp),
            int(F(0)),
            int(U(0)),
            problem.heading_rad,
        )
        self.kinds.append(kind)
        for i, ((owner, window, _), noise) in enumerate(zip(starts, noises, strict=True)):
            self._add("start", window, owner, noise, factors.Terms([], kind.keys(i), partial(kind.at, i)))

    def _priors(self, prior: Prior | None) -> None:
        problem, graph = self.problem, self.graph

        def isotropic(size: int, sigma: float) -> Any:
            return factors.gaussian(sigma**2 * np.eye(size))

        if problem.fixture_states:
            tight = isotropic(3, problem.alignment_sigma)
            graph.add(gtsam.PriorFactorRot3(F(0), gtsam.Rot3(), tight))
            graph.add(gtsam.PriorFactorRot3(U(0), gtsam.Rot3(problem.U_prior), tight))
        if self.gravity:
            sigma = problem.data.recording.site.gravity_sigma_m_s2
            graph.add(gtsam.PriorFactorVector(G(0), np.zeros(1), isotropic(1, sigma)))
        for c, chain in enumerate(problem.chains):
            if self.earth_key(c) is not None:
                # Known components stay by a sigma a million times below the unknown ones.
                sigmas = np.where(chain.unknown_sigma > 0.0, chain.unknown_sigma, 1e-6 * chain.unknown_sigma.max())
                graph.add(gtsam.PriorFactorVector(E(c), np.zeros(3), factors.gaussian(np.diag(sigmas**2))))
        for w in fixed_headings(problem).tolist():
            keep = np.array(self.values.atRot3(A(w)).matrix())
            noise = isotropic(1, _HEADING_SIGMA)
            terms = factors.Terms([], [int(A(w))], factors.heading(keep, int(A(w))))
            graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))
        unit = isotropic(3, 1.0)
        for number in range(int(self.edges.max()) + 1):
            graph.add(gtsam.PriorFactorVector(Q(number), np.zeros(3), unit))
        if self.played.drift.size:
            graph.add(
                gtsam.PriorFactorVector(D(0), np.zeros(self.played.drift.size), isotropic(self.played.drift.size, 1.0))
            )
        if problem.walks and len(self.axes):
            step = problem.walk_sigma()[:, self.axes]
            for i, (before, after) in enumerate(
                zip(problem.order[:-1].tolist(), problem.order[1:].tolist(), strict=True)
            ):
                done = self.point.bias_deviation[after] - self.point.bias_deviation[before]
                noise = factors.gaussian(np.diag(step[i] ** 2))
                graph.add(gtsam.BetweenFactorVector(B(before), B(after), -done[self.axes], noise))
        if prior is not None:
            self._error_prior(prior)

    def _error_prior(self, prior: Prior) -> None:
        """Prior of the sensor errors: of the mean bias where it walks."""
        problem = self.problem
        away = self.point.errors.vector - prior.mean.vector
        unit = np.eye(N_PARAMETERS)
        linear = [(int(X(0)), unit[:, self.errors])] if len(self.errors) else []
        number = problem.data.K if problem.walks else 1
        if len(self.axes):
            linear += [(int(B(k)), unit[:, N_ERRORS + self.axes] / number) for k in range(number)]
        if not linear:
            return
        noise = factors.gaussian(prior.covariance)
        terms = factors.Terms(linear, [], lambda _: (away, []))
        self.graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))
