"""Kalman filter (filterpy) over the sequences of a linearised recording, and its use as a solver.

State: sensor errors, gyro bias with a random walk between sequences, levelling and north of the base, orientation of
MARS on the table, gravity, the unknown part of the Earth's rate, the end attitude from which the next sequence of a
free recording starts, and the bias instability up to the present sequence. Every iteration restarts from the prior and
keeps only the linearisation point; otherwise the data would count twice.

The state is in units in which the prior is white. Forms of the filter: square-root
(:mod:`estimators.square_root_filter`) or covariance (:mod:`estimators.covariance_filter`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

from estimators.accuracy_targets import targets_met
from estimators.iteration import apply_correction
from estimators.linear_system import N_ERRORS, attitude_columns
from estimators.linearisation import linearise
from estimators.nuisance_elimination import eliminate_nuisances, global_columns
from estimators.solver import JointSolver, LinearSolution
from estimators.square_root_filter import SquareRootFilter
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from estimators.covariance_filter import CovarianceFilter
    from estimators.joint_model import JointModel
    from estimators.joint_state import JointState
    from estimators.linear_system import LinearSystem
    from estimators.nuisance_elimination import SequenceEquations
    from srt.model.prior import Prior
    from srt.types import Array, Indices


_PASSES: Final = 8
"""Largest number of passes per iteration, each with relinearised attitudes."""
_NEAR: Final = 1e-5
"""Correction (SI units) below which the attitudes are relinearised without new compensation of the data."""
_SETTLED_SIGMAS: Final = 1e-3
"""The relinearisation has converged if the correction, in sigmas, is below this."""
_POSE: Final = 3
"""Number of states of an end attitude."""
_MEAN: Final = 3
"""Number of states of the mean gyro bias of the sequences so far."""


@dataclass(frozen=True, slots=True, eq=False)
class FilterRun:
    """One pass of the filter.

    Attributes
    ----------
    delta : ndarray, shape (n,)
        Correction of the columns of the system. Every bias has the correction of the mean; attitudes are computed from
        the final estimate.
    correction : ndarray, shape (27,)
        Correction of the reported parameters.
    covariance : ndarray, shape (27, 27)
    sequences : tuple of int
        In the order of processing.
    innovations : tuple of ndarray
        Innovations by sequence, normalised and decorrelated: white with unit variance if the model is right.
    sigma : ndarray, shape (number of sequences, 27)
        Standard deviations after every sequence.
    """

    delta: Array
    correction: Array
    covariance: Array
    sequences: tuple[int, ...]
    innovations: tuple[Array, ...]
    sigma: Array

    @property
    def nis(self) -> Array:
        """Normalised innovation squared (NIS) by sequence."""
        return np.array([float(v @ v) for v in self.innovations])


def run_filter(
    joint: JointModel,
    system: LinearSystem,
    state: JointState,
    prior: Prior,
    form: type[SquareRootFilter | CovarianceFilter] = SquareRootFilter,
) -> FilterRun:
    """Run the filter once over the sequences of a linearised recording.

    Parameters
    ----------
    joint : JointModel
    system : LinearSystem
        Linearised about ``state``, without a prior of the sensor errors.
    state : JointState
    prior : Prior
    form : SquareRootFilter or CovarianceFilter

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance form loses positive definiteness.
    """
    everything = global_columns(system)
    # States of the bias instability are appended with the first sequence that depends on them.
    shared = everything[everything < system.columns["instability"].start]
    L, start = prior_root(system, state, prior, shared)
    n = len(shared)
    size = n + _POSE + _MEAN
    inverse = solve_triangular(L, np.eye(n), lower=True)
    root = np.zeros((size, size))
    root[:n, :n] = np.eye(n)
    ekf = form(np.concatenate([inverse @ start, np.zeros(_POSE + _MEAN)]), root)
    bias = np.flatnonzero((shared >= system.columns["bias"].start) & (shared < system.columns["bias"].stop))
    axes = shared[bias] - system.columns["bias"].start
    walk = joint.bias_walk_sigma() if joint.bias_walks else None
    E = _report_map(shared, axes, L, bias if walk is None else None)
    parts = eliminate_nuisances(joint, system)
    innovations, history = [], []
    for i, part in enumerate(parts):
        if i and walk is not None:
            step = np.zeros((len(ekf.x), len(axes)))
            step[:n] = inverse[:, bias] * walk[i - 1][axes]
            # The bias states are corrections to the bias deviation at which a sequence was linearised.
            shift = np.zeros(len(ekf.x))
            before, after = parts[i - 1].sequence, part.sequence
            change = state.bias_deviation[after] - state.bias_deviation[before]
            shift[:n] = -inverse[:, bias] @ change[axes]
            ekf.propagate(np.eye(len(ekf.x)), shift, noise_root=step)
        needed = np.flatnonzero(part.H[:, n:].any(axis=0))
        ekf.grow(max(0, size + int(needed.max(initial=-1)) + 1 - len(ekf.x)))
        by_instability = part.H[:, n : n + len(ekf.x) - size]
        H = np.concatenate([part.H[:, :n] @ L, part.H_pose, np.zeros((len(part.b), _MEAN)), by_instability], axis=1)
        ekf.correct(-part.b, H)
        innovations.append(ekf.whitened)
        if part.pose is not None:
            _hand_on(ekf, part, L, n)
        if walk is not None:
            _take_mean(ekf, L[bias], axes, i, n)
        covariance = ekf.project(E)
        history.append(np.sqrt(np.diag(covariance)))
    g = np.zeros(len(everything))
    g[:n], g[n : n + len(ekf.x) - size] = L @ ekf.x[:n], ekf.x[size:]
    delta = _all_columns(system, parts, g)
    correction = E @ ekf.x[:size]
    delta[system.columns["bias"]].reshape(-1, 3)[:] = correction[N_ERRORS:]
    return FilterRun(
        delta,
        correction,
        covariance,
        tuple(part.sequence for part in parts),
        tuple(innovations),
        np.array(history),
    )


def _all_columns(system: LinearSystem, parts: list[SequenceEquations], g: Array) -> Array:
    """Correction of all columns: that of the shared ones is g, that of the nuisance parameters follows from g."""
    delta = np.zeros(system.A.shape[1])
    delta[global_columns(system)] = g
    previous = np.zeros(_POSE)
    for part in parts:
        nuisances, end = part.nuisances(g, previous)
        delta[part.local[0]], delta[part.pose_columns] = nuisances, end[part.pose_active]
        previous = end
    return delta


def prior_root(system: LinearSystem, state: JointState, prior: Prior, shared: Indices) -> tuple[Array, Array]:
    """Cholesky factor of the prior covariance of the shared columns, and the prior mean minus the state."""
    n = system.A.shape[1]
    P, mean = np.zeros((n, n)), np.zeros(n)
    at = np.concatenate([system.of("errors"), system.of("bias")[:3]])
    P[np.ix_(at, at)] = prior.covariance
    mean[at] = prior.mean.vector - state.errors.vector
    # The priors of fixture and site are whitened rows of the system; their blocks are square.
    for rows in system.rows:
        if rows.kind in {"base", "mounting", "gravity"} or rows.kind.startswith("earth_rate"):
            members = rows.index.ravel()
            columns = np.flatnonzero(system.A[members].any(axis=0))
            inverse = np.linalg.inv(system.A[np.ix_(members, columns)])
            P[np.ix_(columns, columns)] = inverse @ inverse.T
            mean[columns] = -inverse @ system.b[members]
    return np.asarray(np.linalg.cholesky(P[np.ix_(shared, shared)]), dtype=np.float64), mean[shared]


def _report_map(shared: Indices, axes: Indices, L: Array, bias: Indices | None) -> Array:
    """Matrix from the state to the reported parameters, shape (27, n + 6).

    ``bias`` are the states of a constant gyro bias; None for a random walk, of which the mean over the sequences is
    reported.
    """
    E = np.zeros((N_PARAMETERS, len(shared) + _POSE + _MEAN))
    errors = np.flatnonzero(shared < N_ERRORS)
    E[shared[errors], : len(shared)] = L[errors]
    if bias is None:
        E[N_ERRORS + axes, len(shared) + _POSE + axes] = 1.0
    else:
        E[N_ERRORS + axes, : len(shared)] = L[bias]
    return E


def _hand_on(ekf: SquareRootFilter | CovarianceFilter, part: SequenceEquations, L: Array, n: int) -> None:
    """Replace the previous end attitude by that of this sequence."""
    assert part.pose is not None
    R, G, G_pose, c = part.pose
    inverse = np.linalg.inv(R)
    at = n + np.flatnonzero(part.pose_active)
    first = n + _POSE + _MEAN
    F = np.eye(len(ekf.x))
    F[n : n + _POSE] = 0.0
    F[at, :n] = -inverse @ G[:, :n] @ L
    F[at, first:] = -inverse @ G[:, n : n + len(ekf.x) - first]
    F[np.ix_(at, np.arange(n, n + _POSE))] = -inverse @ G_pose
    noise, constant = np.zeros((len(ekf.x), len(at))), np.zeros(len(ekf.x))
    noise[at], constant[at] = inverse, -inverse @ c
    ekf.propagate(F, constant, noise_root=noise)


def _take_mean(ekf: SquareRootFilter | CovarianceFilter, bias: Array, axes: Indices, count: int, n: int) -> None:
    """Update the mean gyro bias of the sequences processed so far."""
    F = np.eye(len(ekf.x))
    at = n + _POSE + axes
    F[at, at] = count / (count + 1.0)
    F[at, :n] = bias / (count + 1.0)
    ekf.propagate(F)


class KalmanSolver(JointSolver):
    """Kalman filter as a solver: passes over all sequences, each from the prior."""

    name = "ekf"

    def __init__(self, prior: Prior, form: type[SquareRootFilter | CovarianceFilter] = SquareRootFilter) -> None:
        self.prior: Prior = prior
        self.form = form
        self.last: FilterRun | None = None

    def solve(self, joint: JointModel, system: LinearSystem, state: JointState) -> LinearSolution:
        """Run the filter; close to the solution, repeat it with relinearised attitudes until these converge.

        The product of a heading and a tilt of milliradians exceeds the accelerometer noise, so that the linearisation
        point of the attitudes matters. Relinearising them needs no new compensation of the data.
        """
        found = run_filter(joint, system, state, self.prior, self.form)
        for _ in range(_PASSES - 1):
            if np.abs(found.correction).max() > _NEAR:
                break
            better = apply_correction(state, system, np.where(attitude_columns(system), found.delta, 0.0))
            again = linearise(joint, better, system.compensated, system.free)
            before, found = found, run_filter(joint, again, better, self.prior, self.form)
            state, system = better, again
            sigma = np.sqrt(np.diag(found.covariance))
            if np.all(np.abs(found.correction - before.correction) <= _SETTLED_SIGMAS * sigma):
                break
        self.last = found
        return LinearSolution(state, system, found.delta, found.correction, found.covariance)

    def diagnostics(self, joint: JointModel) -> dict[str, Any]:
        """Innovations and standard deviations by sequence."""
        return {} if self.last is None else filter_diagnostics(joint, self.last)


def filter_diagnostics(joint: JointModel, found: FilterRun) -> dict[str, Any]:
    """Innovations and standard deviations by sequence, and the targets met, as JSON values."""
    out: dict[str, Any] = {"filter": history(joint, found)}
    targets = joint.options.targets
    if targets:
        ids = [joint.data.ids[k] for k in found.sequences]
        out["targets"] = targets_met(ids, found.sigma, targets)
    return out


def history(joint: JointModel, found: FilterRun) -> list[dict[str, Any]]:
    """Innovations and standard deviations after every sequence, as JSON values."""
    data, rows = joint.data, []
    for i, k in enumerate(found.sequences):
        nis, freedom = float(found.nis[i]), len(found.innovations[i])
        rows.append(
            {
                "sequence": data.ids[k],
                "occurrence": data.occurrences[k],
                "nis": nis,
                "degrees_of_freedom": freedom,
                "probability": float(chdtrc(freedom, nis)),
                "innovations": found.innovations[i].tolist(),
                "sigma": found.sigma[i].tolist(),
            }
        )
    return rows
