"""Kalman filter (filterpy) over the sequences of a linearised recording, and its use as a solver.

State: sensor errors, gyro bias with a random walk between sequences, levelling and north of the base, orientation of
MARS on the table, non-orthogonality of the fixture's axes, gravity, the error of a rate table, the unknown part of the
Earth's rate, and what one sequence hands on to the next: the states of the bias instability and, in a free recording,
the end attitude from which the next sequence starts. Their number does not change during the test. Every iteration
restarts from the prior and keeps only the linearisation point; otherwise the data would count twice.

The state is in units in which the prior is white. Forms of the filter: square-root
(:mod:`estimators.square_root_filter`) or covariance (:mod:`estimators.covariance_filter`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import solve_triangular

from estimators.accuracy_targets import targets_met
from estimators.nuisance_elimination import eliminate_nuisances, smoothed
from estimators.square_root_filter import SquareRootFilter
from srt.estimation.goodness_of_fit import chi_square_probability
from srt.joint.linear_system import FIXTURE, N_ERRORS, global_columns
from srt.joint.solver import JointSolver, LinearSolution
from srt.result.diagnostics import Diagnostics, Innovation
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from estimators.covariance_filter import CovarianceFilter
    from estimators.nuisance_elimination import SequenceEquations
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import JointState
    from srt.joint.linear_system import LinearSystem
    from srt.joint.linearisation import Linearisation
    from srt.model.prior import Prior
    from srt.types import Array, Indices


_MEAN: Final = 3
"""Number of states of the mean gyro bias of the sequences so far, if the bias is a random walk."""


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
    shared, parts = global_columns(system), eliminate_nuisances(system)
    L, start = prior_root(system, state, prior, shared)
    n, handed = len(shared), max(len(part.after) for part in parts)
    walk = joint.bias_walk_sigma() if joint.bias_walks else None
    size = n + handed + (0 if walk is None else _MEAN)
    inverse = solve_triangular(L, np.eye(n), lower=True)
    root = np.zeros((size, size))
    root[:n, :n] = np.eye(n)
    ekf = form(np.concatenate([inverse @ start, np.zeros(size - n)]), root)
    bias = np.flatnonzero((shared >= system.columns["bias"].start) & (shared < system.columns["bias"].stop))
    axes = shared[bias] - system.columns["bias"].start
    E = _report_map(shared, axes, L, size, bias if walk is None else None)
    innovations, history = [], []
    for i, part in enumerate(parts):
        if i and walk is not None:
            step = np.zeros((size, len(axes)))
            step[:n] = inverse[:, bias] * walk[i - 1][axes]
            # The bias states are corrections to the bias deviation at which a sequence was linearised.
            shift = np.zeros(size)
            before, after = parts[i - 1].sequence, part.sequence
            change = state.bias_deviation[after] - state.bias_deviation[before]
            shift[:n] = -inverse[:, bias] @ change[axes]
            ekf.propagate(np.eye(size), shift, noise_root=step)
        ekf.correct(-part.b, padded(np.concatenate([part.H @ L, part.H_handed], axis=1), size))
        innovations.append(ekf.whitened)
        if handed and i + 1 < len(parts):
            hand_on(ekf, part, L, handed)
        if walk is not None:
            _take_mean(ekf, L[bias], axes, i, n + handed)
        covariance = ekf.project(E)
        history.append(np.sqrt(np.diag(covariance)))
    delta = _all_columns(system, parts, L @ ekf.x[:n])
    correction = E @ ekf.x
    delta[system.columns["bias"]].reshape(-1, 3)[:] = correction[N_ERRORS:]
    return FilterRun(
        delta,
        correction,
        covariance,
        tuple(part.sequence for part in parts),
        tuple(innovations),
        np.array(history),
    )


def padded(H: Array, size: int) -> Array:
    """Matrix with columns of zeros up to a number of columns."""
    return np.pad(H, ((0, 0), (0, size - H.shape[1])))


def _all_columns(system: LinearSystem, parts: list[SequenceEquations], g: Array) -> Array:
    """Correction of all columns: that of the shared ones is g, that of the nuisance parameters follows from g."""
    delta = np.zeros(system.columns.count)
    delta[global_columns(system)] = g
    handed_in = np.zeros(0)
    for part, handed_on in zip(parts, smoothed(parts, g), strict=True):
        delta[part.local[0]] = part.nuisances(g, handed_in, handed_on)
        delta[part.after] = handed_in = handed_on
    return delta


def prior_root(system: LinearSystem, state: JointState, prior: Prior, shared: Indices) -> tuple[Array, Array]:
    """Cholesky factor of the prior covariance of the shared columns, and the prior mean minus the state."""
    n = system.columns["attitude"].start  # the columns of the whole recording come first
    P, mean = np.zeros((n, n)), np.zeros(n)
    at = np.concatenate([system.columns.of("errors"), system.columns.of("bias")[:3]])
    P[np.ix_(at, at)] = prior.covariance
    mean[at] = prior.mean.vector - state.errors.vector
    # The priors of fixture and site are whitened rows of the system; their blocks are square.
    named = {*FIXTURE, "gravity", "table_rate", "drift_form"}
    groups = [rows.index.ravel() for rows in system.rows if rows.kind in named or rows.kind.startswith("earth_rate")]
    members = np.concatenate([np.empty(0, dtype=np.intp), *groups])
    block = system.A[members].toarray()[:, :n]
    columns = np.flatnonzero(block.any(axis=0))
    inverse = np.linalg.inv(block[:, columns])
    P[np.ix_(columns, columns)] = inverse @ inverse.T
    mean[columns] = -inverse @ system.b[members]
    return np.asarray(np.linalg.cholesky(P[np.ix_(shared, shared)]), dtype=np.float64), mean[shared]


def _report_map(shared: Indices, axes: Indices, L: Array, size: int, bias: Indices | None) -> Array:
    """Matrix from the state to the reported parameters, shape (27, size).

    ``bias`` are the states of a constant gyro bias; None for a random walk, of which the mean over the sequences, in
    the last states, is reported.
    """
    E = np.zeros((N_PARAMETERS, size))
    errors = np.flatnonzero(shared < N_ERRORS)
    E[shared[errors], : len(shared)] = L[errors]
    if bias is None:
        E[N_ERRORS + axes, size - _MEAN + axes] = 1.0
    else:
        E[N_ERRORS + axes, : len(shared)] = L[bias]
    return E


def hand_on(ekf: SquareRootFilter | CovarianceFilter, part: SequenceEquations, L: Array, handed: int) -> None:
    """Replace what the previous sequence handed on by what this one hands on.

    Parameters
    ----------
    ekf : SquareRootFilter or CovarianceFilter
    part : SequenceEquations
        The sequence.
    L : ndarray, shape (n, n)
        Cholesky factor of the prior covariance of the global columns, the first n states.
    handed : int
        Number of states that hold what is handed on.
    """
    by_g, by_p, constant, noise_root = part.advance()
    n, after, before = len(L), len(by_p), by_p.shape[1]
    F = np.eye(len(ekf.x))
    F[n : n + handed] = 0.0
    F[n : n + after, :n], F[n : n + after, n : n + before] = by_g @ L, by_p
    noise, shift = np.zeros((len(ekf.x), noise_root.shape[1])), np.zeros(len(ekf.x))
    noise[n : n + after], shift[n : n + after] = noise_root, constant
    ekf.propagate(F, shift, noise_root=noise)


def _take_mean(ekf: SquareRootFilter | CovarianceFilter, bias: Array, axes: Indices, count: int, first: int) -> None:
    """Update the mean gyro bias of the sequences processed so far, in the states from ``first`` on."""
    F = np.eye(len(ekf.x))
    at = first + axes
    F[at, at] = count / (count + 1.0)
    F[at, : bias.shape[1]] = bias / (count + 1.0)
    ekf.propagate(F)


class KalmanSolver(JointSolver):
    """Kalman filter as a solver: passes over all sequences, each from the prior."""

    name = "ekf"

    def __init__(self, prior: Prior, form: type[SquareRootFilter | CovarianceFilter] = SquareRootFilter) -> None:
        self.prior: Prior = prior
        self.form = form
        self.last: FilterRun | None = None

    def solve(self, point: Linearisation) -> LinearSolution:
        """Run the filter over all sequences."""
        found = run_filter(point.joint, point.system, point.state, self.prior, self.form)
        self.last = found
        return LinearSolution(found.delta, found.correction, found.covariance)

    def diagnostics(self, joint: JointModel) -> Diagnostics:
        """Innovations and standard deviations by sequence."""
        return filter_diagnostics(joint, self.last)


def filter_diagnostics(joint: JointModel, found: FilterRun | None) -> Diagnostics:
    """Innovations and standard deviations by sequence, and the targets met."""
    if found is None:
        return Diagnostics()
    targets, ids = joint.options.targets, [joint.data.ids[k] for k in found.sequences]
    return Diagnostics(
        filter=history(joint, found), targets=targets_met(ids, found.sigma, targets) if targets else None
    )


def history(joint: JointModel, found: FilterRun) -> tuple[Innovation, ...]:
    """Innovations and standard deviations after every sequence."""
    data, rows = joint.data, []
    for i, k in enumerate(found.sequences):
        nis, freedom = float(found.nis[i]), len(found.innovations[i])
        rows.append(
            Innovation(
                sequence=data.ids[k],
                occurrence=data.occurrences[k],
                nis=nis,
                degrees_of_freedom=freedom,
                probability=chi_square_probability(nis, freedom),
                innovations=found.innovations[i],
                sigma=found.sigma[i],
            )
        )
    return tuple(rows)
