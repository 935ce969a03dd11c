"""Unscented filter (filterpy) over the sequences of a recording, for comparison with the extended filters.

The measurement function of a sequence compensates its data with a sigma point and returns the whitened residuals
without the directions of the nuisance parameters. The bias instability enters linearly. Sigma points are those of
van der Merwe with α = 1e-3, β = 2, κ = 0, in units in which the prior is white. filterpy's filter is unchanged; loss
of positive definiteness is reported.

Limits: those of :mod:`estimators.sequential_filter`; in addition, poses whose rotation is incomplete are not used.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.linalg import solve_triangular

from estimators.iteration import apply_correction
from estimators.joint_model import JointModel
from estimators.kalman_filter import prior_root
from estimators.linearisation import linearise
from estimators.nuisance_elimination import global_columns
from estimators.sequential_filter import SequenceUpdate, SequentialFilter, require_valid
from srt.sequences.preparation import prepare_checked

if TYPE_CHECKING:
    from estimators.joint_state import JointState
    from estimators.linear_system import LinearSystem
    from srt.model.prior import Prior
    from srt.types import Array, Mask


ALPHA: Final = 1e-3
"""Relative spread of the sigma points about the mean: small, as the model is nonlinear over sigmas of 1/3."""
BETA: Final = 2.0
"""Optimal value for a Gaussian distribution."""
KAPPA: Final = 0.0
"""Secondary scaling, by convention zero."""


class UnscentedFilter(SequentialFilter):
    """filterpy's unscented filter, one sequence after the other.

    Parameters
    ----------
    joint : JointModel
    prior : Prior
    free : ndarray of bool, shape (27,)
        Parameters that are estimated.
    """

    error_source = "errors of the unscented transform, or rounding errors of its covariance"

    def __init__(self, joint: JointModel, prior: Prior, free: Mask) -> None:
        super().__init__(joint, prior, "unscented", free)
        self.filter: UnscentedKalmanFilter | None = None

    def update(
        self, joint: JointModel, state: JointState, number: int, previous: SequenceUpdate | None
    ) -> SequenceUpdate:
        """Update the estimate with a sequence by the unscented transform."""
        model = SequenceModel(joint, state, int(joint.order[number]), self.free)
        if previous is None:
            self.origin = state
            self.root = prior_root(model.system, state, self.prior, model.columns)[0]
            n = len(model.columns) + model.by_instability.shape[1]
            points = MerweScaledSigmaPoints(n, ALPHA, BETA, KAPPA)
            self.filter = UnscentedKalmanFilter(n, 1, 1.0, None, lambda x, _: x, points)
            self.filter.Q = np.zeros((n, n))
        assert self.filter is not None
        ukf, L, n = self.filter, self.root, len(model.columns)
        before = ukf.x.copy()
        known: dict[bytes, Array] = {}  # most sigma points differ only in the bias instability

        def measurement(x: Array) -> Array:
            key = x[:n].tobytes()
            if key not in known:
                known[key] = model.residual(model.at(self.origin, L @ x[:n]))
            return np.asarray(known[key] + model.by_instability @ x[n:])

        ukf.predict()
        m = len(model.by_instability)
        ukf.update(np.zeros(m), R=np.eye(m), hx=measurement)
        E = model.system.parameter_map()[:, model.columns] @ L
        covariance = E @ ukf.P[:n, :n] @ E.T
        if not np.all(np.diag(covariance) >= 0.0):
            raise np.linalg.LinAlgError("the covariance of the unscented filter lost positive definiteness")
        innovations = solve_triangular(np.linalg.cholesky(ukf.S), ukf.y, lower=True)
        updated = model.at(self.origin, L @ ukf.x[:n])
        found = replace(updated, bias_deviation=state.bias_deviation, attitude=None)
        return SequenceUpdate(found, ukf.x, L, E @ (ukf.x - before)[:n], covariance, innovations)


class SequenceModel:
    """Measurement function of one sequence.

    Parameters
    ----------
    joint : JointModel
        Model of the whole recording.
    state : JointState
        Reference state. The directions of its nuisance parameters are removed from the residuals.
    k : int
        Sequence.
    free : ndarray of bool, shape (27,)
        Parameters that are estimated.
    """

    def __init__(self, joint: JointModel, state: JointState, k: int, free: Mask) -> None:
        label = joint.data.labels[k]
        data = prepare_checked(joint.data.recording.with_sequences((label,)), (label,), joint.options.average)
        self.joint, self.free = JointModel(data, joint.options, (state.errors, state.U)), free
        self.joint.U_prior = joint.U_prior
        self.system = self._linearise(replace(state, bias_deviation=np.zeros((1, 3)), attitude=None))
        shared = global_columns(self.system)
        self.columns = shared[shared < self.system.columns["instability"].start]
        self.rows = np.concatenate([rows.index.ravel() for rows in self.system.rows if np.all(rows.owner >= 0)])
        self.basis = self._complement(self.system)
        # The bias instability is correlated between sequences: its states come from the model of the whole recording.
        whole = linearise(joint, *joint.placed(replace(state, attitude=None)), free)
        windows = [int(joint.data.start[k]), int(joint.data.end[k])]
        rows = [whole.rows_of(kind).index[windows].ravel() for kind in ("force", "rate")]
        rows.append(whole.rows_of("turn").index[k])
        # The rows of starts and edges, which follow, do not depend on the bias instability.
        affected = slice(0, sum(len(r) for r in rows))
        effect = whole.A[np.concatenate(rows)][:, whole.columns["instability"]]
        self.by_instability = self.basis[affected].T @ effect

    def at(self, origin: JointState, delta: Array) -> JointState:
        """State at a correction of the filter's columns from ``origin``, without attitudes.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the state is outside the sensor model.
        """
        windows = len(self.joint.data.windows.duration_s)
        origin = replace(origin, bias_deviation=np.zeros((1, 3)), attitude=np.broadcast_to(np.eye(3), (windows, 3, 3)))
        columns = np.zeros(self.system.A.shape[1])
        columns[self.columns] = delta
        state = replace(apply_correction(origin, self.system, columns), attitude=None)
        require_valid(state)
        return state

    def residual(self, state: JointState) -> Array:
        """Whitened residuals at a state without the nuisance directions, in the basis of the reference state."""
        system = self._linearise(state)
        Q = self._complement(system)
        return np.asarray(self.basis.T @ (Q @ (Q.T @ system.b[self.rows])))

    def _linearise(self, state: JointState) -> LinearSystem:
        return linearise(self.joint, *self.joint.placed(state), self.free)

    def _complement(self, system: LinearSystem) -> Array:
        """Orthonormal basis of the residuals that nuisance parameters do not affect, shape (rows, m)."""
        A = system.A[self.rows]
        nuisance = np.flatnonzero(A.any(axis=0) & system.active)
        nuisance = nuisance[nuisance >= system.columns["attitude"].start]
        Q: Array = np.linalg.qr(A[:, nuisance], mode="complete")[0]
        return Q[:, len(nuisance) :]
