"""Extended Kalman filter (filterpy) over the sequences of a recording: one pass, and its use as a solver.

State: sensor errors, gyro bias with a random walk between sequences, levelling and north of the base, orientation of
MARS on the table, gravity, the Earth's rate where it is unknown, in a free recording the attitude of the pose that one
turn hands on to the next, and the draws of a stated drift up to the present sequence. Every iteration restarts from the
prior: only the point of linearisation is kept, or the data would count twice.

The filter's coordinates are those in which the prior is white, and it is a square-root filter
(:mod:`estimators.square_root_filter`).
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
from estimators.solver import LinearSolution, Solver
from estimators.square_root_filter import SquareRootFilter
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from estimators.joint_model import JointModel
    from estimators.joint_state import JointState
    from estimators.linear_system import LinearSystem
    from estimators.nuisance_elimination import SequenceEquations
    from srt.model.prior import Prior
    from srt.types import Array, Indices


_PASSES: Final = 8

_NEAR: Final = 1e-5

_SETTLED_SIGMAS: Final = 1e-3

_POSE: Final = 3

_MEAN: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class FilterRun:
    """One pass of the filter.

    Attributes
    ----------
    delta : ndarray, shape (n,)
        Correction of the system's columns: every bias gets the mean, attitudes go with the last state.
    correction : ndarray, shape (27,)
        Of the reported parameters.
    covariance : ndarray, shape (27, 27)
    sequences : tuple of int
        In the order of processing.
    innovations : tuple of ndarray
        Of every sequence, normalised and decorrelated: white with unit variance if the model holds.
    sigma : ndarray, shape (number of sequences, 27)
        After every sequence; the prior's for what is not yet seen.
    """

    delta: Array
    correction: Array
    covariance: Array
    sequences: tuple[int, ...]
    innovations: tuple[Array, ...]
    sigma: Array

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of every sequence."""
        return np.array([float(v @ v) for v in self.innovations])


def run_filter(joint: JointModel, system: LinearSystem, state: JointState, prior: Prior) -> FilterRun:
    """Run the filter once over a linearised problem.

    Parameters
    ----------
    problem : Problem
    system : System
        Linearised at ``point``, without a prior of the sensor errors.
    point : Point
    prior : Prior
    """
    everything = global_columns(system)
    # The draws of the drift join the state with the sequence that needs them first; until then they change nothing.
    shared = everything[everything < system.columns["instability"].start]
    L, start = _prior_root(system, state, prior, shared)
    n = len(shared)
    size = n + _POSE + _MEAN
    inverse = solve_triangular(L, np.eye(n), lower=True)
    root = np.zeros((size, size))
    root[:n, :n] = np.eye(n)
    ekf = SquareRootFilter(np.concatenate([inverse @ start, np.zeros(_POSE + _MEAN)]), root)
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
            # The state is the bias less what the sequence was linearised at.
            instability = np.zeros(len(ekf.x))
            before, after = parts[i - 1].sequence, part.sequence
            change = state.bias_deviation[after] - state.bias_deviation[before]
            instability[:n] = -inverse[:, bias] @ change[axes]
            ekf.propagate(np.eye(len(ekf.x)), instability, noise_root=step)
        needed = np.flatnonzero(part.H[:, n:].any(axis=0))
        ekf.grow(max(0, size + int(needed.max(initial=-1)) + 1 - len(ekf.x)))
        by_drift = part.H[:, n : n + len(ekf.x) - size]
        H = np.concatenate([part.H[:, :n] @ L, part.H_pose, np.zeros((len(part.b), _MEAN)), by_drift], axis=1)
        ekf.correct(-part.b, H)
        innovations.append(ekf.whitened)
        if part.pose is not None:
            _hand_on(ekf, part, L, n)
        if walk is not None:
            _take_mean(ekf, L[bias], axes, i, n)
        spread = E @ ekf.root[:size]
        history.append(np.sqrt(np.einsum("pi,pi->p", spread, spread)))
    delta = np.zeros(system.A.shape[1])
    g = np.zeros(len(everything))
    g[:n], g[n : n + len(ekf.x) - size] = L @ ekf.x[:n], ekf.x[size:]
    delta[everything] = g
    handed_in = np.zeros(_POSE)
    for part in parts:
        values, handed_on = part.nuisances(g, handed_in)
        delta[part.local[0]], delta[part.pose_columns] = values, handed_on[part.pose_active]
        handed_in = handed_on
    correction = E @ ekf.x[:size]
    delta[system.columns["bias"]].reshape(-1, 3)[:] = correction[N_ERRORS:]
    return FilterRun(
        delta,
        correction,
        spread @ spread.T,
        tuple(part.sequence for part in parts),
        tuple(innovations),
        np.array(history),
    )


def _prior_root(system: LinearSystem, state: JointState, prior: Prior, shared: Indices) -> tuple[Array, Array]:
    """Cholesky factor of the prior covariance of the shared columns, and the prior's mean less the point."""
    n = system.A.shape[1]
    P, mean = np.zeros((n, n)), np.zeros(n)
    at = np.concatenate([system.of("errors"), system.of("bias")[:3]])
    P[np.ix_(at, at)] = prior.covariance
    mean[at] = prior.mean.vector - state.errors.vector
    # The priors of the fixture and the site are rows of the system: white, and square on their own columns.
    for rows in system.rows:
        if rows.kind in {"base", "mounting", "gravity"} or rows.kind.startswith("earth_rate"):
            members = rows.index.ravel()
            columns = np.flatnonzero(system.A[members].any(axis=0))
            inverse = np.linalg.inv(system.A[np.ix_(members, columns)])
            P[np.ix_(columns, columns)] = inverse @ inverse.T
            mean[columns] = -inverse @ system.b[members]
    return np.asarray(np.linalg.cholesky(P[np.ix_(shared, shared)]), dtype=np.float64), mean[shared]


def _report_map(shared: Indices, axes: Indices, L: Array, bias: Indices | None) -> Array:
    """Reported parameters from the filter's state, shape (27, n + 6): a bias that walks is the mean of the sequences.

    ``bias`` is where the state has one that does not walk.
    """
    E = np.zeros((N_PARAMETERS, len(shared) + _POSE + _MEAN))
    errors = np.flatnonzero(shared < N_ERRORS)
    E[shared[errors], : len(shared)] = L[errors]
    if bias is None:
        E[N_ERRORS + axes, len(shared) + _POSE + axes] = 1.0
    else:
        E[N_ERRORS + axes, : len(shared)] = L[bias]
    return E


def _hand_on(ekf: SquareRootFilter, part: SequenceEquations, L: Array, n: int) -> None:
    """The attitude handed on takes the place of the one handed in."""
    assert part.pose is not None
    R, G, G_pose, c = part.pose
    inverse = np.linalg.inv(R)
    at = n + np.flatnonzero(part.pose_active)
    instability = n + _POSE + _MEAN
    F = np.eye(len(ekf.x))
    F[n : n + _POSE] = 0.0
    F[at, :n] = -inverse @ G[:, :n] @ L
    F[at, instability:] = -inverse @ G[:, n : n + len(ekf.x) - instability]
    F[np.ix_(at, np.arange(n, n + _POSE))] = -inverse @ G_pose
    noise, constant = np.zeros((len(ekf.x), len(at))), np.zeros(len(ekf.x))
    noise[at], constant[at] = inverse, -inverse @ c
    ekf.propagate(F, constant, noise_root=noise)


def _take_mean(ekf: SquareRootFilter, bias: Array, axes: Indices, count: int, n: int) -> None:
    """Keep the mean of the biases of the sequences so far."""
    F = np.eye(len(ekf.x))
    at = n + _POSE + axes
    F[at, at] = count / (count + 1.0)
    F[at, :n] = bias / (count + 1.0)
    ekf.propagate(F)


class KalmanSolver(Solver):
    """One iteration of the filter: a pass from the prior over the sequences, linearised anew."""

    name = "ekf"

    def __init__(self, prior: Prior) -> None:
        self.prior: Prior = prior
        self.last: FilterRun | None = None

    def solve(self, joint: JointModel, system: LinearSystem, state: JointState) -> LinearSolution:
        """Run the filter; once the sensor errors are near, again with the attitudes it found, until these settle.

        A heading of milliradians times a lean of milliradians is more than the accelerometers' noise: where the first
        pass was linearised matters, and a play-back is not needed to find out.
        """
        found = run_filter(joint, system, state, self.prior)
        for _ in range(_PASSES - 1):
            if np.abs(found.correction).max() > _NEAR:
                break
            better = apply_correction(state, system, np.where(attitude_columns(system), found.delta, 0.0))
            again = linearise(joint, better, system.compensated, system.free)
            before, found = found, run_filter(joint, again, better, self.prior)
            state, system = better, again
            sigma = np.sqrt(np.diag(found.covariance))
            if np.all(np.abs(found.correction - before.correction) <= _SETTLED_SIGMAS * sigma):
                break
        self.last = found
        return LinearSolution(state, system, found.delta, found.correction, found.covariance)

    def diagnostics(self, joint: JointModel) -> dict[str, Any]:
        """Innovations and sigmas, sequence by sequence."""
        if self.last is None:
            return {}
        out: dict[str, Any] = {"filter": history(joint, self.last)}
        targets = joint.options.targets
        if targets:
            ids = [joint.data.ids[k] for k in self.last.sequences]
            out["targets"] = targets_met(ids, self.last.sigma, targets)
        return out


def history(joint: JointModel, found: FilterRun) -> list[dict[str, Any]]:
    """What the filter reports after every sequence, as JSON values."""
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
