"""Unscented filter (filterpy) over the sequences of a recording, for comparison with the extended filters.

The measurement function of a sequence compensates its data with a sigma point and returns the whitened residuals
without the directions of the nuisance parameters. Sigma points are those of van der Merwe with α = 1e-3, β = 2, κ = 0,
in units in which the prior is white. The filter is used as it is; loss of positive definiteness is reported.

Limits, besides those of :mod:`estimators.sequential_filter`: the bias instability is noise of each sequence, and not
correlated between sequences; poses without their rotation are not used.
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
"""Spread of the sigma points about the mean, relative to that of a Gaussian: small, as sigmas of 1/3 are nonlinear."""
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
            n = len(model.columns)
            points = MerweScaledSigmaPoints(n, ALPHA, BETA, KAPPA)
            self.filter = UnscentedKalmanFilter(n, 1, 1.0, None, lambda x, _: x, points)
            self.filter.Q = np.zeros((n, n))
        assert self.filter is not None
        ukf, L = self.filter, self.root
        before = ukf.x.copy()
        ukf.predict()
        ukf.update(np.zeros(len(model.noise)), R=model.noise, hx=lambda x: model.residual(model.at(self.origin, L @ x)))
        E = model.system.parameter_map()[:, model.columns] @ L
        covariance = E @ ukf.P @ E.T
        if not np.all(np.diag(covariance) >= 0.0):
            raise np.linalg.LinAlgError("the covariance of the unscented filter lost positive definiteness")
        innovations = solve_triangular(np.linalg.cholesky(ukf.S), ukf.y, lower=True)
        updated = model.at(self.origin, L @ ukf.x)
        found = replace(updated, bias_deviation=state.bias_deviation, attitude=None)
        return SequenceUpdate(found, ukf.x, L, E @ (ukf.x - before), covariance, innovations)


class SequenceModel:
    """Measurement function of one sequence.

    Parameters
    ----------
    joint : JointModel
        Model of the whole recording.
    state : JointState
        Reference state, whose nuisance directions are removed from the residuals.
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
        by_instability = self.basis.T @ self.system.A[self.rows][:, self.system.columns["instability"]]
        self.noise = np.eye(self.basis.shape[1]) + by_instability @ by_instability.T

    def at(self, origin: JointState, delta: Array) -> JointState:
        """State at a correction of the filter's columns from ``origin``, without attitudes.

        Raises
        ------
        numpy.linalg.LinAlgError
            If it is outside the sensor model.
        """
        windows = len(self.joint.data.windows.duration_s)
        origin = replace(origin, bias_deviation=np.zeros((1, 3)), attitude=np.broadcast_to(np.eye(3), (windows, 3, 3)))
        columns = np.zeros(self.system.A.shape[1])
        columns[self.columns] = delta
        state = replace(apply_correction(origin, self.system, columns), attitude=None)
        require_valid(state)
        return state

    def residual(self, state: JointState) -> Array:
        """Whitened residuals at a state: the part that no nuisance parameter explains, in the reference's basis."""
        system = self._linearise(state)
        Q = self._complement(system)
        return np.asarray(self.basis.T @ (Q @ (Q.T @ system.b[self.rows])))

    def _linearise(self, state: JointState) -> LinearSystem:
        compensated = self.joint.compensate(state)
        return linearise(self.joint, self.joint.initial_attitudes(state, compensated), compensated, self.free)

    def _complement(self, system: LinearSystem) -> Array:
        """Orthonormal basis of the residuals that nuisance parameters do not affect, shape (rows, m)."""
        A = system.A[self.rows]
        nuisance = np.flatnonzero(A.any(axis=0) & system.active)
        nuisance = nuisance[nuisance >= system.columns["attitude"].start]
        Q: Array = np.linalg.qr(A[:, nuisance], mode="complete")[0]
        return Q[:, len(nuisance) :]
