"""Batch factor graph (gtsam), relinearised by play-back.

Variables: sensor errors ``x``, gyro bias of every sequence ``b`` joined by a random walk, levelling and north of the
base ``f``, orientation of MARS on the table ``u``, gravity ``g``, the Earth's rate where it is unknown ``e``, the
attitude of every stationary window ``a``, and the reading errors at the windows' edges ``q``. Factors: mean specific
force and mean rate of every window, the rotation that the gyros integrated between the windows of a sequence, and the
fixture's attitude at its start. Residuals and Jacobians are those of :mod:`srt.measurement_model`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, E, F, G, Q, U, X
from scipy.linalg import block_diag, solve_triangular
from scipy.special import chdtri

from estimators.driver import Solved, Step, run
from estimators.problem import open_problem
from estimators.system import N_ERRORS, edge_numbers, fixed_headings, fixture_starts, total, whiten
from srt import measurement_model as model
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from estimators.problem import Played, Point, Problem
    from estimators.system import System
    from srt.calibration import Calibration
    from srt.estimation import Progress
    from srt.options import Options
    from srt.prior import Prior
    from srt.recording import Recording

    Array = NDArray[np.float64]
    Linearised = tuple[Array, list[Array]]
    ErrorFunction = Callable[[Any, Any, Any], Array]

ROBUST: Final[dict[str, Callable[[float], Any]]] = {
    "huber": gtsam.noiseModel.mEstimator.Huber.Create,
    "cauchy": lambda size: gtsam.noiseModel.mEstimator.Cauchy.Create(1.5 * size),
}
"""Losses on the norm of a factor's whitened residuals; ``size`` is what that norm stays under in 95 of 100."""
_STEPS: Final = {"squared": 8, "huber": 30, "cauchy": 30}
_NEAR: Final = 1e-5
_SETTLED_SIGMAS: Final = 1e-3
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
    loss : "squared", "huber" or "cauchy"
    """

    def __init__(
        self,
        problem: Problem,
        point: Point,
        played: Played,
        free: NDArray[np.bool_],
        *,
        prior: Prior | None = None,
        loss: str = "squared",
    ) -> None:
        assert point.attitude is not None
        self.problem, self.point, self.played = problem, point, played
        self.errors = np.flatnonzero(free[:N_ERRORS])
        self.axes = np.flatnonzero(free[N_ERRORS:])
        self.losses: dict[int, Any] = {}
        if loss != "squared":
            self.losses = {n: ROBUST[loss](math.sqrt(chdtri(n, 0.05))) for n in (3, 6)}
        self.gravity = problem.options.fixture_states
        self.edges = edge_numbers(problem, played)
        self.graph: Any = gtsam.NonlinearFactorGraph()
        self.values: Any = gtsam.Values()
        self.measured: list[tuple[str, int]] = []
        """Kind and number of each robust factor, which come first in the graph."""
        self._variables()
        self._windows()
        self._turns()
        self._starts()
        self._priors(prior)

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
        for c in range(len(problem.chains)):
            if self.earth_key(c) is not None:
                self.values.insert(E(c), point.earth_rate[c])
        if problem.fixture_states:
            self.values.insert(F(0), gtsam.Rot3(point.base))
            self.values.insert(U(0), gtsam.Rot3(point.U))
        if self.gravity:
            self.values.insert(G(0), np.array([point.gravity]))

    def _add(self, kind: str, number: int, covariance: Array, terms: _Terms) -> None:
        """Add a measurement factor; held variables are left out of it."""
        noise = _gaussian(covariance)
        if self.losses:
            noise = gtsam.noiseModel.Robust.Create(self.losses[len(covariance)], noise)
        self.measured.append((kind, number))
        self.graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))

    def _linear(self, jacobian: Array, sequence: int | None) -> list[tuple[int, Array]]:
        """Terms of sensor errors and bias, constant between play-backs."""
        out = []
        if len(self.errors):
            out.append((int(X(0)), jacobian[:, self.errors]))
        if sequence is not None and len(self.axes):
            out.append((self.bias_key(sequence), jacobian[:, N_ERRORS + self.axes]))
        return out

    def _windows(self) -> None:
        """One factor for the force and the rate of a window: what is wrong with a window is wrong with both."""
        problem, played = self.problem, self.played
        T = problem.data.windows.duration_s
        force_noise, rate_noise = total(played.force_noise), total(played.rate_noise)
        known = np.stack([c.earth_rate for c in problem.chains])
        for w in range(len(T)):
            chain = int(problem.window_chain[w])
            jacobian = -np.concatenate([played.force_jacobian[w], played.rate_jacobian[w]])
            linear = self._linear(jacobian, int(problem.window_sequence[w]))
            slope = played.edge_slope / T[w]
            linear += [
                (int(Q(number)), np.concatenate([np.zeros((3, 3)), sign * slope]))
                for number, sign in zip(self.edges[w].tolist(), (1.0, -1.0), strict=True)
                if number >= 0
            ]
            earth = self.earth_key(chain)
            others = [int(A(w))] + ([int(G(0))] if self.gravity else []) + ([earth] if earth is not None else [])
            function = _pose(
                played.force[w], played.rate[w], problem.data.gravity, known[chain], gravity_free=self.gravity
            )
            self._add("window", w, block_diag(force_noise[w], rate_noise[w]), _Terms(linear, others, function))

    def _turns(self) -> None:
        problem, played = self.problem, self.played
        data, noise = problem.data, total(played.turned_noise)
        known = np.stack([c.earth_rate for c in problem.chains])
        for k in range(data.K):
            start, end = int(data.start[k]), int(data.end[k])
            chain = int(problem.sequence_chain[k])
            linear = self._linear(played.turned_jacobian[k], k)
            if self.edges[start, 1] >= 0:
                linear.append((int(Q(self.edges[start, 1])), -played.edge_slope))
            if self.edges[end, 0] >= 0:
                linear.append((int(Q(self.edges[end, 0])), played.turned[k] @ played.edge_slope))
            earth = self.earth_key(chain)
            self._add(
                "turn",
                k,
                noise[k],
                _Terms(
                    linear,
                    [int(A(start)), int(A(end))] + ([earth] if earth is not None else []),
                    _turn(played.turned[k], known[chain], float(played.duration_s[k])),
                    scaled=True,
                ),
            )

    def _starts(self) -> None:
        problem = self.problem
        if not problem.fixture_states:
            return
        variance = np.diag(problem.start_sigma**2)
        for _, window, nominal in fixture_starts(problem):
            keys = [int(A(window)), int(F(0)), int(U(0))]
            self._add("start", window, variance, _Terms([], keys, _start(nominal, problem.heading_rad)))

    def _priors(self, prior: Prior | None) -> None:
        problem, graph = self.problem, self.graph

        def isotropic(size: int, sigma: float) -> Any:
            return _gaussian(sigma**2 * np.eye(size))

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
                graph.add(gtsam.PriorFactorVector(E(c), np.zeros(3), _gaussian(np.diag(sigmas**2))))
        for w in fixed_headings(problem).tolist():
            keep = np.array(self.values.atRot3(A(w)).matrix())
            noise = isotropic(1, _HEADING_SIGMA)
            graph.add(gtsam.CustomFactor(noise, [A(w)], _Terms([], [int(A(w))], _heading(keep)).function))
        for number in range(int(self.edges.max()) + 1):
            graph.add(gtsam.PriorFactorVector(Q(number), np.zeros(3), isotropic(3, 1.0)))
        if problem.walks and len(self.axes):
            step = problem.walk_sigma()[:, self.axes]
            for i, (before, after) in enumerate(
                zip(problem.order[:-1].tolist(), problem.order[1:].tolist(), strict=True)
            ):
                done = self.point.bias_deviation[after] - self.point.bias_deviation[before]
                noise = _gaussian(np.diag(step[i] ** 2))
                graph.add(gtsam.BetweenFactorVector(B(before), B(after), -done[self.axes], noise))
        if prior is not None:
            self._error_prior(prior)

    def _error_prior(self, prior: Prior) -> None:
        """Prior of the sensor errors: of the mean bias where it walks."""
        problem = self.problem
        away = self.point.errors.vector - prior.mean.vector
        unit = np.eye(N_PARAMETERS)
        linear = [(int(X(0)), unit[:, self.errors])]
        number = problem.data.K if problem.walks else 1
        linear += [(int(B(k)), unit[:, N_ERRORS + self.axes] / number) for k in range(number)]
        noise = _gaussian(prior.covariance)
        terms = _Terms(linear, [], lambda *_: (away, []))
        self.graph.add(gtsam.CustomFactor(noise, terms.keys, terms.function))


def _gaussian(covariance: Array) -> Any:
    """Noise model by its square root, the upper triangle of which is what gtsam reads.

    Neither by the covariance, which gtsam inverts (a start attitude's spans eight decades), nor as a diagonal one,
    which it takes for a hard constraint where a sigma is below 1e-8 (as gyro biases in rad/s are).
    """
    return gtsam.noiseModel.Gaussian.SqrtInformation(np.linalg.qr(whiten(covariance[None])[0], mode="r"), False)


class _Terms:
    """Residual of a factor: constant Jacobians of some variables, and a function of the others.

    Parameters
    ----------
    linear : list of (key, ndarray)
        Variables that enter linearly, as a correction.
    keys : list of key
        The others.
    function : callable
        ``(values, keys) -> (residual, Jacobians)`` without the linear terms; with ``scaled`` its last Jacobian
        multiplies the linear ones.
    """

    def __init__(
        self, linear: list[tuple[int, Array]], keys: list[int], function: Callable[..., Any], *, scaled: bool = False
    ) -> None:
        self.linear, self.others, self.evaluate, self.scaled = linear, keys, function, scaled
        self.keys = [key for key, _ in linear] + keys

    def function(self, this: Any, values: Any, jacobians: Any) -> Array:  # noqa: ARG002 - gtsam's signature
        residual, by_others = self.evaluate(values, self.others)
        scale = by_others.pop() if self.scaled else None
        for i, (key, J) in enumerate(self.linear):
            J_now = J if scale is None else scale @ J
            residual = residual + J_now @ values.atVector(key)
            if jacobians is not None:
                jacobians[i] = np.asfortranarray(J_now)
        if jacobians is not None:
            for i, J in enumerate(by_others):
                jacobians[len(self.linear) + i] = np.asfortranarray(J)
        return np.ascontiguousarray(residual)


def _pose(force: Array, rate: Array, gravity: float, known: Array, *, gravity_free: bool) -> Callable[..., Linearised]:
    def evaluate(values: Any, keys: list[int]) -> Linearised:
        others = list(keys[1:])
        g = gravity + (float(values.atVector(others.pop(0))[0]) if gravity_free else 0.0)
        earth = known + values.atVector(others[0]) if others else known
        attitude = values.atRot3(keys[0]).matrix()[None]
        r_force, force_by_attitude, by_gravity = model.pose_force(force[None], attitude, g)
        r_rate, rate_by_attitude, by_earth = model.pose_rate(rate[None], attitude, earth[None])
        jacobians = [np.concatenate([force_by_attitude[0], rate_by_attitude[0]])]
        if gravity_free:
            jacobians.append(np.concatenate([by_gravity[0], np.zeros(3)])[:, None])
        if others:
            jacobians.append(np.concatenate([np.zeros((3, 3)), by_earth[0]]))
        return np.concatenate([r_force[0], r_rate[0]]), jacobians

    return evaluate


def _turn(turned: Array, known: Array, duration_s: float) -> Callable[..., Linearised]:
    T = np.array([duration_s])

    def evaluate(values: Any, keys: list[int]) -> Linearised:
        earth = known + values.atVector(keys[2]) if len(keys) > 2 else known
        start, end = (values.atRot3(key).matrix()[None] for key in keys[:2])
        r, by_start, by_end, by_turned, by_earth = model.turn(turned[None], start, end, earth[None], T)
        return r[0], [*[by_start[0], by_end[0], by_earth[0]][: len(keys)], by_turned[0]]

    return evaluate


def _start(nominal: Array, heading_rad: float) -> Callable[..., Linearised]:
    def evaluate(values: Any, keys: list[int]) -> Linearised:
        attitude, base, mounting = (values.atRot3(key).matrix() for key in keys)
        r, *jacobians = model.start_attitude(attitude[None], nominal[None], base, mounting, heading_rad)
        return r[0], [J[0] for J in jacobians]

    return evaluate


def _heading(keep: Array) -> Callable[..., Linearised]:
    """Turn about the vertical since an attitude."""

    def evaluate(values: Any, keys: list[int]) -> Linearised:
        now = values.atRot3(keys[0]).matrix()
        turn = keep @ now.T
        return np.array([0.5 * (turn[0, 1] - turn[1, 0])]), [now[2][None]]

    return evaluate


@dataclass(frozen=True, slots=True, eq=False)
class GraphSolution:
    """One linear solution of a graph.

    Attributes
    ----------
    delta : gtsam.VectorValues
    covariance : ndarray
        Marginal covariance of the variables of ``keys``, in their order.
    keys : list of key
    """

    delta: Any
    covariance: Array
    keys: list[int]


def solve_linear(graph: Any, values: Any, last: list[int]) -> GraphSolution:
    """Linearise and solve by QR elimination, the variables of interest last: their marginals then are at hand."""
    linear = graph.linearize(values)
    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, last)
    net = linear.eliminateSequential(ordering, gtsam.EliminateQR)
    tail = [net.at(i) for i in range(net.size() - len(last), net.size())]
    keys = [int(c.firstFrontalKey()) for c in tail]
    sizes = [c.R().shape[0] for c in tail]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    R = np.zeros((int(starts[-1]), int(starts[-1])))
    place = {key: slice(int(starts[i]), int(starts[i + 1])) for i, key in enumerate(keys)}
    for key, conditional in zip(keys, tail, strict=True):
        R[place[key], place[key]] = conditional.R()
        S, at = conditional.S(), 0
        for parent in list(conditional.keys())[1:]:
            width = place[int(parent)].stop - place[int(parent)].start
            R[place[key], place[int(parent)]] = S[:, at : at + width]
            at += width
    inverse = solve_triangular(R, np.eye(len(R)))
    return GraphSolution(net.optimize(), inverse @ inverse.T, keys)


class GraphStep(Step):
    """One relinearisation of the graph; with a robust loss, reweighted until it settles."""

    name = "graph"

    def __init__(self, loss: str, prior: Prior | None) -> None:
        self.loss, self.prior = loss, prior
        # A robust loss is approached by way of the squares and of Huber's, which has one minimum alone.
        self.stages = {"squared": ["squared"], "huber": ["squared", "huber"], "cauchy": ["squared", "huber", "cauchy"]}[
            loss
        ]
        self.calls = 0
        self.robust_weights: dict[tuple[str, int], float] = {}

    @property
    def settled(self) -> bool:
        """Whether the loss asked for has been reached."""
        return self.calls >= len(self.stages)

    def solve(self, problem: Problem, system: System, point: Point) -> Solved:
        """Relinearise the attitudes until they settle, once the sensor errors are near, and reweight with them."""
        loss = self.stages[min(self.calls, len(self.stages) - 1)]
        self.calls += 1
        built = GraphBuilder(problem, point, system.played, system.free, prior=self.prior, loss=loss)
        last = built.reported_keys()
        values = built.values
        solution = None
        for _ in range(_STEPS[loss]):
            try:
                solution = solve_linear(built.graph, values, last)
            except RuntimeError as error:  # gtsam's indeterminate linear system
                raise np.linalg.LinAlgError(str(error).strip().split("\n")[0]) from None
            values = values.retract(solution.delta)
            step = np.concatenate([solution.delta.at(key) for key in solution.keys])
            far = loss == "squared" and np.abs(step).max() > _NEAR
            if far or np.all(np.abs(step) <= _SETTLED_SIGMAS * np.sqrt(np.diag(solution.covariance))):
                break
        assert solution is not None
        self._weigh(built, values)
        delta = _columns(built, system, values)
        E = system.parameter_map()
        spread = np.zeros((N_PARAMETERS, len(solution.covariance)))
        at = 0
        for key in solution.keys:
            columns = _columns_of(built, system, key)
            spread[:, at : at + len(columns)] = E[:, columns]
            at += len(columns)
        return Solved(point, system, delta, E @ delta, spread @ solution.covariance @ spread.T)

    def _weigh(self, built: GraphBuilder, values: Any) -> None:
        """Keep the weight that the loss gave each measurement."""
        if not built.losses:
            self.robust_weights = {}
            return
        for i, key in enumerate(built.measured):
            factor: Any = built.graph.at(i)
            residual = factor.noiseModel().noise().whiten(factor.unwhitenedError(values))
            self.robust_weights[key] = float(built.losses[len(residual)].weight(float(np.linalg.norm(residual))))

    def restart(self) -> None:
        """Approach the loss by its stages again."""
        self.calls = 0

    def weights(self) -> dict[tuple[str, int], float]:
        """Weights by kind and number of measurement; empty for squares."""
        return self.robust_weights

    def diagnostics(self, problem: Problem) -> dict[str, Any]:
        """Weights of the sequences under a robust loss."""
        if not self.robust_weights:
            return {}
        data = problem.data
        least = np.ones(data.K)
        for (kind, number), weight in self.robust_weights.items():
            k = number if kind == "turn" else int(problem.window_sequence[number])
            least[k] = min(least[k], weight)
        return {
            "loss": self.loss,
            "weights": [
                {"sequence": data.ids[k], "occurrence": data.occurrences[k], "smallest_weight": float(least[k])}
                for k in problem.order.tolist()
            ],
        }


def _columns_of(built: GraphBuilder, system: System, key: int) -> NDArray[np.intp]:
    """Columns of the system that a variable of sensor errors or bias stands for."""
    if key == X(0):
        return np.asarray(system.of("errors")[built.errors])
    return np.asarray(system.of("bias").reshape(-1, 3)[gtsam.symbolIndex(key)][built.axes])


def _columns(built: GraphBuilder, system: System, values: Any) -> Array:
    """Correction of all columns of the system from the graph's values."""
    from srt.quaternion import rotation_vector

    problem, point = built.problem, built.point
    delta = np.zeros(system.A.shape[1])
    for key in built.reported_keys():
        delta[_columns_of(built, system, key)] = values.atVector(key)
    assert point.attitude is not None
    now = np.stack([values.atRot3(A(w)).matrix() for w in range(len(point.attitude))])
    turned = rotation_vector(np.swapaxes(point.attitude, 1, 2) @ now)
    delta[system.columns["attitude"]] = np.einsum("wab,wb->wa", point.attitude, turned).ravel()
    if problem.fixture_states:
        for name, key, before in (("base", F(0), point.base), ("mounting", U(0), point.U)):
            delta[system.columns[name]] = rotation_vector((before.T @ values.atRot3(key).matrix())[None])[0]
    if built.gravity:
        delta[system.columns["gravity"]] = values.atVector(G(0)) - point.gravity
    for c in range(len(problem.chains)):
        earth = built.earth_key(c)
        if earth is not None:
            delta[system.of("earth_rate").reshape(-1, 3)[c]] = values.atVector(earth) - point.earth_rate[c]
    edges = system.of("edge").reshape(-1, 3)
    for number in range(len(edges)):
        delta[edges[number]] = values.atVector(Q(number))
    return delta


def estimate(recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
    """Calibrate by the batch factor graph.

    Raises
    ------
    DataError
        As :func:`srt.session.open_session`.
    """
    options.refuse(("live", "targets"), "The factor graph")
    return run(open_problem(recording, options), GraphStep(options.loss, options.prior), options, progress)
