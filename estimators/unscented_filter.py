"""Unscented filter (filterpy) over the sequences of a recording, for comparison with the extended filters.

The measurement function of a sequence compensates its data with a sigma point and returns the whitened residuals
without the directions of the nuisance parameters. The bias instability enters linearly: its states and its white
unknowns of the present sequence are states of the filter. Sigma points are those of
van der Merwe with α = 1e-3, β = 2, κ = 0, in units in which the prior is white. filterpy's filter is unchanged; loss
of positive definiteness is reported.

Limits: those of :mod:`estimators.sequential_filter`; in addition, poses whose rotation is incomplete are not used.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.linalg import block_diag, solve_triangular

from estimators.kalman_filter import prior_root
from estimators.sequential_filter import SequenceUpdate, SequentialFilter, require_valid
from srt.joint.initial_attitudes import placed
from srt.joint.iteration import apply_correction
from srt.joint.joint_model import JointModel
from srt.joint.linear_system import global_columns
from srt.joint.linearisation import linearise
from srt.sequences.checked_preparation import prepare_checked

if TYPE_CHECKING:
    from srt.joint.drift import DriftStates
    from srt.joint.joint_state import JointState
    from srt.joint.linear_system import LinearSystem
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
            size = len(model.columns) + model.by_drift.shape[1]
            points = MerweScaledSigmaPoints(size, ALPHA, BETA, KAPPA)
            self.filter = UnscentedKalmanFilter(size, 1, 1.0, None, None, points)
            self.F, self.filter.Q = np.eye(size), np.zeros((size, size))
        assert self.filter is not None
        ukf, L, n = self.filter, self.root, len(model.columns)
        transition = self.F
        ukf.fx = lambda x, _: transition @ x
        before = ukf.x.copy()
        known: dict[bytes, Array] = {}  # most sigma points differ only in the drift

        def measurement(x: Array) -> Array:
            key = x[:n].tobytes()
            if key not in known:
                known[key] = model.residual(model.at(self.origin, L @ x[:n]))
            return np.asarray(known[key] + model.by_drift @ x[n:])

        ukf.predict()
        m = len(model.by_drift)
        ukf.update(np.zeros(m), R=np.eye(m), hx=measurement)
        E = model.system.columns.parameter_map()[:, model.columns] @ L
        covariance = E @ ukf.P[:n, :n] @ E.T
        if not np.all(np.diag(covariance) >= 0.0):
            raise np.linalg.LinAlgError("the covariance of the unscented filter lost positive definiteness")
        innovations = solve_triangular(np.linalg.cholesky(ukf.S), ukf.y, lower=True)
        updated = model.at(self.origin, L @ ukf.x[:n])
        F, Q = model.next_drift
        self.F, ukf.Q = block_diag(np.eye(n), F), block_diag(np.zeros((n, n)), Q)
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
        own, choice = JointModel(data, joint.options, (state.errors, state.U)), joint.choice
        own = own.with_choice(U_prior=choice.U_prior, ends_tied=choice.ends_tied)
        if choice.drift.force_axes is not None:  # two windows alone would show one direction
            own = own.with_force_axes(choice.drift.force_axes)
        self.joint, self.free = own, free
        self.system = self._linearise(replace(state, bias_deviation=np.zeros((1, 3)), attitude=None))
        self.columns = global_columns(self.system)
        self.rows = np.concatenate([rows.index.ravel() for rows in self.system.rows if np.all(rows.owner >= 0)])
        self.basis = self._complement(self.system)
        # The drift is correlated between sequences: its states come from the model of the whole recording.
        whole = linearise(joint, *placed(joint, replace(state, attitude=None)), free)
        windows = [int(joint.data.start[k]), int(joint.data.end[k])]
        rows = [whole.rows_of(kind).index[windows].ravel() for kind in ("force", "rate")]
        rows.append(whole.rows_of("turn").index[k])
        # The rows of starts and edges, which follow, do not depend on the drift.
        affected = slice(0, sum(len(r) for r in rows))
        step, drift = int(joint.rank[k]), whole.compensated.drift
        names = [f"{sensor}_drift" for sensor in drift] + [f"{sensor}_drift_noise" for sensor in drift]
        columns = [whole.columns.of(name).reshape(joint.data.K, -1)[step] for name in names]
        at = np.concatenate([*columns, np.empty(0, dtype=np.intp)])
        self.by_drift = self.basis[affected].T @ whole.A[np.concatenate(rows)][:, at].toarray()
        self.next_drift = _next_drift(list(drift.values()), min(step, joint.data.K - 2))

    def at(self, origin: JointState, delta: Array) -> JointState:
        """State at a correction of the filter's columns from ``origin``, without attitudes.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the state is outside the sensor model.
        """
        windows = len(self.joint.data.windows.duration_s)
        origin = replace(origin, bias_deviation=np.zeros((1, 3)), attitude=np.broadcast_to(np.eye(3), (windows, 3, 3)))
        columns = np.zeros(self.system.columns.count)
        columns[self.columns] = delta
        state = replace(apply_correction(origin, self.system.columns, columns), attitude=None)
        require_valid(state)
        return state

    def residual(self, state: JointState) -> Array:
        """Whitened residuals at a state without the nuisance directions, in the basis of the reference state."""
        system = self._linearise(state)
        Q = self._complement(system)
        return np.asarray(self.basis.T @ (Q @ (Q.T @ system.b[self.rows])))

    def _linearise(self, state: JointState) -> LinearSystem:
        return linearise(self.joint, *placed(self.joint, state), self.free)

    def _complement(self, system: LinearSystem) -> Array:
        """Orthonormal basis of the residuals that nuisance parameters do not affect, shape (rows, m)."""
        A = system.A[self.rows].toarray()
        nuisance = np.concatenate([system.columns.of("attitude"), system.columns.of("edge")])
        nuisance = nuisance[A[:, nuisance].any(axis=0) & system.active[nuisance]]
        Q: Array = np.linalg.qr(A[:, nuisance], mode="complete")[0]
        return Q[:, len(nuisance) :]


def _next_drift(drifts: list[DriftStates], step: int) -> tuple[Array, Array]:
    """Matrix from states and white unknowns of the drift to those of the next sequence, and their new covariance.

    The states of all sensors come first, then their unknowns, which are new in every sequence.
    """
    X, U = sum(d.states for d in drifts), sum(d.unknowns for d in drifts)
    F, Q = np.zeros((X + U, X + U)), np.zeros((X + U, X + U))
    Q[X:, X:] = np.eye(U)
    x, u = 0, X
    for drift in drifts if step >= 0 else []:
        n, m = drift.states, drift.unknowns
        by_state, by_noise, by_next = np.split(drift.transition[step], [n, n + m], axis=1)
        inverse = np.linalg.inv(by_next)
        F[x : x + n, x : x + n], F[x : x + n, u : u + m] = -inverse @ by_state, -inverse @ by_noise
        Q[x : x + n, x : x + n] = inverse @ inverse.T
        x, u = x + n, u + m
    return F, Q
