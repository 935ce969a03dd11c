"""Solver of the joint model by a batch factor graph (gtsam), and the estimator ``graph``.

Factors: mean specific force and mean rate of every window, the rotation between the windows of a sequence from the
gyros, and the attitude of the fixture at the start of each sequence (:mod:`estimators.factor_graph`). Residuals and
Jacobians are those of :mod:`srt.model.measurement_model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import gtsam
import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from estimators.factor_graph import FactorGraph
from srt.estimation.observability import default_prior
from srt.joint.calibration_run import run
from srt.joint.recording_opening import open_joint_model
from srt.joint.solver import JointSolver, LinearSolution
from srt.result.diagnostics import Diagnostics, SequenceWeight

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.joint.joint_model import JointModel
    from srt.joint.linearisation import Linearisation
    from srt.model.prior import Prior
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.types import Array

    Linearised = tuple[Array, list[Array]]
    ErrorFunction = Callable[[Any, Any, Any], Array]

ROBUST: Final[dict[str, Callable[[float], Any]]] = {
    "huber": gtsam.noiseModel.mEstimator.Huber.Create,
    "cauchy": gtsam.noiseModel.mEstimator.Cauchy.Create,
}
"""Robust losses by name. Scale: 95 % quantile of the norm of the whitened residuals of a sequence.

With this scale Cauchy's loss of twelve components is 98 % efficient on data without outliers.
"""
_OUTLIER_PROBABILITY: Final = 0.05
"""Probability that the residuals of a sequence without outliers exceed the scale of its loss."""
_SETTLED_WEIGHT: Final = 1e-3
"""The weights have converged if none changes by more than this."""
_STEPS: Final = {"squared": 1, "huber": 30, "cauchy": 30}
"""Largest number of relinearisations per iteration: squares wait for data compensated anew, weights converge first."""
_SETTLED_SIGMAS: Final = 1e-3
"""The reweighting has converged if the correction, in sigmas, is below this."""
_ATTITUDE_ROWS: Final = 6.0
"""Degrees of freedom used by the two attitudes of a sequence."""
_LEAST_FREEDOM: Final = 3.0
"""Degrees of freedom of a sequence if another one starts from its end attitude."""


@dataclass(frozen=True, slots=True, eq=False)
class GraphSolution:
    """Solution of a linearised graph.

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


def solve_linear(built: FactorGraph, values: Any) -> GraphSolution:
    """Linearise and solve by multifrontal QR elimination, of which the root has the marginals of the reported keys."""
    linear, last = built.graph.linearize(values), built.reported_keys()
    # A row of zeros ties these variables together, so that one clique, the root, contains all of them.
    tie, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(1)
    for key in last:
        tie.add(gtsam.JacobianFactor(key, np.zeros((1, len(values.atVector(key)))), np.zeros(1), unit))
    if last:
        linear.add(gtsam.JacobianFactor(tie))
    tree = linear.eliminateMultifrontal(built.elimination_order, gtsam.EliminateQR)
    delta = tree.optimize()
    # Without a pose of known attitude, the fixture's angles are a tree of their own.
    roots = (clique.conditional() for clique in tree.roots())
    root = next(conditional for conditional in roots if not last or last[-1] in list(conditional.keys()))
    keys = list(root.keys())[root.size() - len(last) :]
    n = sum(len(delta.at(key)) for key in keys)
    R = root.R()
    R = R[len(R) - n :, len(R) - n :]
    if not np.all(np.isfinite(R)):
        raise np.linalg.LinAlgError("the eliminated graph is not finite")
    inverse = solve_triangular(R, np.eye(n))
    return GraphSolution(delta, inverse @ inverse.T, keys)


class GraphSolver(JointSolver):
    """Relinearised factor graph; with a robust loss, iteratively reweighted."""

    name = "graph"

    def __init__(self, loss: str, prior: Prior | None) -> None:
        self.loss, self.prior = loss, prior
        # Cauchy's loss has several minima. Squares and Huber's loss have one, from which Cauchy's iteration starts.
        self.stages = {"squared": ["squared"], "huber": ["squared", "huber"], "cauchy": ["squared", "huber", "cauchy"]}[
            loss
        ]
        self.calls = 0
        self.measured: list[tuple[str, int, float]] = []
        self.sequence_weights = np.ones(0)

    @property
    def settled(self) -> bool:
        """True if the requested loss is in use."""
        return self.calls >= len(self.stages)

    def solve(self, point: Linearisation) -> LinearSolution:
        """Solve once; with a robust loss, relinearise and update the weights until both converge."""
        loss = self.stages[min(self.calls, len(self.stages) - 1)]
        self.calls += 1
        prior, columns = self.prior, point.columns
        weights = np.ones(point.joint.data.K)
        built = FactorGraph(point, prior=prior)
        values, solution = built.values, None
        for i in range(_STEPS[loss]):
            if i:
                built = FactorGraph(point, prior=prior, weights=weights)
            try:
                with built.evaluated(values):
                    solution = solve_linear(built, values)
            except RuntimeError as error:  # gtsam's indeterminate linear system
                raise np.linalg.LinAlgError(str(error).strip().split("\n")[0]) from None
            values = values.retract(solution.delta)
            step = np.concatenate([np.zeros(0), *(solution.delta.at(key) for key in solution.keys)])
            before = weights
            if loss != "squared":
                weights = sequence_weights(built, values, loss)
            settled = np.all(np.abs(step) <= _SETTLED_SIGMAS * np.sqrt(np.diag(solution.covariance)))
            # The first weights were set before any residuals were known.
            if i and settled and np.abs(weights - before).max() < _SETTLED_WEIGHT:
                break
        assert solution is not None
        self.measured = [(kind, number, float(weights[k])) for kind, number, k in built.measured]
        self.sequence_weights = weights
        delta, correction = np.zeros(columns.count), built.values.localCoordinates(values)
        for key in list(built.values.keys()):
            delta[built.columns_of(key)] = correction.at(key)
        # Attitudes are corrected in B, their columns are rotations about the axes of L.
        assert point.state.attitude is not None
        in_body = delta[columns["attitude"]].reshape(-1, 3)
        delta[columns["attitude"]] = np.einsum("wab,wb->wa", point.state.attitude, in_body).ravel()
        E = columns.parameter_map()
        reported = np.concatenate([np.zeros(0, np.intp), *map(built.columns_of, solution.keys)])
        return LinearSolution(delta, E @ delta, E[:, reported] @ solution.covariance @ E[:, reported].T)

    def restart(self) -> None:
        """Restart with the first loss."""
        self.calls = 0

    def weights(self) -> dict[tuple[str, int], float]:
        """Weights by kind and number of measurement; empty without a robust loss."""
        return {} if self.loss == "squared" else {(kind, number): weight for kind, number, weight in self.measured}

    def diagnostics(self, joint: JointModel) -> Diagnostics:
        """Weights of the sequences under a robust loss."""
        if self.loss == "squared" or not self.measured:
            return Diagnostics()
        ids, occurrences, weights = joint.data.ids, joint.data.occurrences, self.sequence_weights
        rows = (
            SequenceWeight(sequence=ids[k], occurrence=occurrences[k], weight=float(weights[k]))
            for k in joint.order.tolist()
        )
        return Diagnostics(loss=self.loss, weights=tuple(rows))


def sequence_weights(built: FactorGraph, values: Any, loss: str) -> Array:
    """Weights of the sequences from a robust loss of the norm of their whitened residuals, shape (K,).

    One loss applies to all residuals of a sequence. A contradiction shows as a change of horizontal force, which either
    window or the rotation can cause; separate losses would distribute the residual over them.
    """
    squares, rows = np.zeros(built.joint.data.K), np.zeros(built.joint.data.K)
    with built.evaluated(values):
        for i, (_, _, k) in enumerate(built.measured):
            factor: Any = built.graph.at(i)
            residual = factor.noiseModel().whiten(factor.unwhitenedError(values))
            squares[k] += float(residual @ residual) / built.weights[k]
            rows[k] += len(residual)
    freedom = np.maximum(rows - _ATTITUDE_ROWS, _LEAST_FREEDOM)
    limits = np.sqrt(chdtri(freedom, _OUTLIER_PROBABILITY))
    sizes = np.sqrt(squares)
    return np.array([ROBUST[loss](float(limit)).weight(float(s)) for limit, s in zip(limits, sizes, strict=True)])


def estimate(recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
    """Calibrate by the batch factor graph.

    Raises
    ------
    DataError
        As :func:`srt.sequences.checked_preparation.prepare_checked`.
    """
    options.refuse(("live", "targets", "filter"), "The factor graph")
    return run(
        open_joint_model(recording, options), GraphSolver(options.loss, options.prior or default_prior()), progress
    )
