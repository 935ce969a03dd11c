"""Iteration by play-back around a solver of the linearised joint problem, and the calibration made of it.

Kalman filter and factor graph differ in :class:`Step` alone: play-back, choice of parameters that the data show,
convergence, statistics and the result are the same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.accuracy_targets import PARAMETER_UNITS
from estimators.dense_solution import solve
from estimators.linear_system import N_ERRORS, linearise
from estimators.residual_analysis import deletion_table, unmodelled_noise
from estimators.solution_analysis import analyse_solution, make_calibration, with_prior
from estimators.solver import IterationState, Solver
from srt.estimation.fixed_parameters import fixed_sigma, reason_on_request
from srt.estimation.goodness_of_fit import is_misfit
from srt.estimation.iteration import CONVERGED_CORRECTION, CONVERGED_SIGMAS
from srt.estimation.observability import OBSERVED_BELOW, admission_sigma, admit
from srt.model.prior import Prior
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import outside_model
from srt.sensor_errors import NAMES, SensorErrors

if TYPE_CHECKING:
    from estimators.joint_model import JointModel
    from estimators.joint_state import JointState
    from estimators.linear_system import LinearSystem
    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.result.calibration import Calibration
    from srt.types import Array, Mask


_MAX_STEP: Final = 0.7
_ROUNDS: Final = 6
_RENEWALS: Final = 2
_INDEPENDENT: Final = 1e-10
_ONE_FAULT: Final = 0.05
_NEAR: Final = 1e-2


def apply_correction(state: JointState, system: LinearSystem, delta: Array) -> JointState:
    """Apply a correction of the columns to a point.

    Raises
    ------
    InputError
        A correction that is not finite.
    """
    c = system.columns
    bias = delta[c["bias"]].reshape(-1, 3)
    common = bias.mean(axis=0)
    vector = state.errors.vector.copy()
    vector[:N_ERRORS] += delta[c["errors"]]
    deviation = state.bias_deviation
    if len(bias) > 1:
        deviation = deviation + bias - common
        shift = deviation.mean(axis=0)
        deviation, common = deviation - shift, common + shift
    vector[N_ERRORS:] += common
    assert state.attitude is not None
    turn = delta[c["attitude"]].reshape(-1, 3)
    in_body = np.einsum("wba,wb->wa", state.attitude, turn)
    return replace(
        state,
        errors=SensorErrors(vector),
        bias_deviation=deviation,
        base=state.base @ rotation_matrix(delta[c["base"]]),
        U=state.U @ rotation_matrix(delta[c["mounting"]]),
        gravity=state.gravity + float(delta[c["gravity"]][0]),
        earth_rate=state.earth_rate + delta[c["earth_rate"]].reshape(-1, 3),
        attitude=state.attitude @ rotation_matrix(in_body),
    )


def iterate(
    joint: JointModel,
    solver: Solver,
    iteration: IterationState,
    *,
    requested: Mask,
    progress: Progress | None = None,
    converged: tuple[float, float] = (CONVERGED_CORRECTION, CONVERGED_SIGMAS),
    max_step: float = _MAX_STEP,
) -> IterationState:
    """Play back, linearise and solve until the correction is negligible.

    Parameters
    ----------
    problem : Problem
    step : Step
    state : State
        Where to begin: point and free parameters.
    requested : ndarray of bool, shape (27,)
        Parameters held on request.
    progress : callable, optional
    converged : (float, float)
        Largest negligible correction, absolute and in sigmas.
    max_step : float
        Longest step; longer ones are shortened, as far from the solution they mean nothing but a direction.
    """
    corrections: list[float] = [] if iteration.corrections is None else iteration.corrections
    renewed = 0
    selected = not np.array_equal(iteration.free, ~requested)
    for _ in range(joint.options.max_playbacks):
        compensated = joint.compensate(iteration.state)
        state = iteration.state
        if state.attitude is None:
            state = joint.initial_attitudes(state, compensated)
        near = bool(corrections) and corrections[-1] < _NEAR
        if near and not renewed:
            joint.update_mounting_prior(state)
        if near and renewed < _RENEWALS:  # no more, or a scatter on the border of being noise would go on and off
            joint.update_bias_scatter(state, compensated)
            renewed += 1
            if not joint.bias_walks and state.bias_deviation.any():  # it was a fault's, and there is one bias after all
                state = replace(state, bias_deviation=np.zeros_like(state.bias_deviation))
                compensated = joint.compensate(state)
        system = linearise(joint, state, compensated, iteration.free)
        if near and not selected and solver.prior is None:
            selected = True
            if not np.array_equal(observable_parameters(system, requested), iteration.free):
                # Too little is seen to do without one; what it does not narrow down is held in the end.
                solver.prior = default_prior()
        solver.leaning = not selected
        try:
            solved = solver.solve(joint, system, state)
        except (np.linalg.LinAlgError, ValueError) as error:  # scipy's word for numbers that are not finite
            iteration.status, iteration.message = "outside_model", f"The equations are singular ({error})."
            break
        delta, correction, covariance = solved.delta, solved.correction, solved.covariance
        if not np.all(np.isfinite(delta)) or not np.all(np.isfinite(covariance)):
            iteration.status, iteration.message = "outside_model", "The correction is not finite."
            break
        size = float(np.max(np.abs(correction) / PARAMETER_UNITS))
        if size > max_step:
            delta, correction = delta * (max_step / size), correction * (max_step / size)
        corrections.append(size)
        if progress is not None:
            progress(len(corrections), size)
        iteration.state = apply_correction(solved.state, solved.system, delta)
        iteration.linearisation_point, iteration.compensated, iteration.system = (
            solved.state,
            compensated,
            solved.system,
        )
        iteration.covariance = covariance
        reason = outside_model(iteration.state.errors)
        if reason is not None:
            iteration.status, iteration.message = "outside_model", f"After play-back {len(corrections)} {reason}."
            break
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        if np.all(np.abs(correction) <= np.maximum(converged[0] * PARAMETER_UNITS, converged[1] * sigma)) and (
            solver.settled and (selected or solver.prior is not None)
        ):
            iteration.status, iteration.message = "converged", f"Converged after {len(corrections)} play-backs."
            break
    else:
        iteration.status = "not_converged"
        iteration.message = (
            f"Not converged after {len(corrections)} play-backs: the last correction was {corrections[-1]:.2e} "
            "(largest parameter, accelerometer bias in g)."
        )
    iteration.corrections = corrections
    return iteration


def default_prior() -> Prior:
    """Next to no knowledge: a third of full scale, 1 % of asymmetry."""
    return Prior.from_sigma(admission_sigma())


def observable_parameters(system: LinearSystem, requested: Mask) -> Mask:
    """Which sensor errors the data determine, all other unknowns being estimated with them."""
    E = system.parameter_map()
    A = system.A
    bias = system.columns["bias"]
    number = (bias.stop - bias.start) // 3
    mean = A[:, bias].reshape(len(A), number, 3).sum(axis=1)
    wanted = np.concatenate([A[:, system.columns["errors"]], mean], axis=1)
    others = system.active.copy()
    others[: bias.start + 3] = False  # with the mean, the biases but one are deviations
    B = A[:, others]
    Q, R = np.linalg.qr(B / np.maximum(np.linalg.norm(B, axis=0), 1e-300))
    Q = Q[:, np.abs(np.diag(R)) > _INDEPENDENT]  # of dependent columns the last ones bring nothing but rounding
    left = wanted - Q @ (Q.T @ wanted)
    assert E.shape[0] == wanted.shape[1]
    return admit(left * admission_sigma(), ~requested)


def run(joint: JointModel, solver: Solver, options: Options, progress: Progress | None) -> Calibration:
    """Calibrate: iterate, judge what the data show, and put the result together.

    In one thread of linear algebra: matrices of a few hundred rows gain nothing from more, and on a busy machine
    threads that wait for each other made it ten times slower.

    Raises
    ------
    InputError
        Options that do not go with joint estimation.
    """
    options.refuse(("step", "down", "measured_vertical"), "Joint estimation")
    with threadpool_limits(limits=1, user_api="blas"):
        return _run(joint, solver, options, progress)


def _run(joint: JointModel, solver: Solver, options: Options, progress: Progress | None) -> Calibration:
    requested = np.array([name in options.fixed_names for name in NAMES])
    uncertain = fixed_sigma(joint.data, options)
    held = {name: reason_on_request(name, uncertain) for name in options.fixed_names}
    iteration = IterationState(joint.start, ~requested)
    diagnostics: dict[str, Any] = {}
    for _ in range(_ROUNDS):
        iteration = iterate(joint, solver, iteration, requested=requested, progress=progress)
        if iteration.compensated is None or iteration.covariance is None or iteration.status == "outside_model":
            break
        if iteration.status == "converged" and _add_unmodelled_noise(joint, solver, iteration):
            continue
        # A window that moved may be what keeps the iteration from resting.
        moving_windows = joint.moving_windows(iteration.state, iteration.compensated)
        if moving_windows.any():
            diagnostics["held"] = {"sequences": list(analyse_solution(joint, solver, iteration, uncertain).table)}
            diagnostics["held"] |= solver.diagnostics(joint)
            joint.integrate_windows(moving_windows)
            solver.restart()
            continue
        if iteration.status != "converged":
            break
        sigma = np.sqrt(np.maximum(np.diag(iteration.covariance), 0.0))
        weak = iteration.free & (sigma > OBSERVED_BELOW * admission_sigma())
        if not weak.any() or solver.prior is not None:
            break
        iteration.free = iteration.free & ~weak
        iteration.state = joint.with_initial_values(iteration.state, weak)
    return make_calibration(joint, solver, options, iteration, held, uncertain, diagnostics)


def _add_unmodelled_noise(joint: JointModel, solver: Solver, iteration: IterationState) -> bool:
    """Noise beyond the sensors' where the residuals of many sequences ask for it; True if there is more of it.

    What one sequence alone contradicts is a fault of that one, to be named and not to be spread over all; a robust loss
    has its own way with it.
    """
    system = with_prior(joint, solver, iteration)
    if solver.weights():
        return False
    solution = solve(system)
    left = system.b + system.A @ solution.delta
    statistic, freedom = float(left @ left), len(left) - int(system.active.sum())
    # Once some is added it may prove too much, as when a window that moved is released.
    if not any(joint.unmodelled_sigma):
        if not is_misfit(statistic, freedom):
            return False
        # Chi-square of all is that without one sequence, and what this one adds to it.
        without = [
            (statistic - row["chi_square"], freedom - row["degrees_of_freedom"])
            for row in deletion_table(joint, system, solution)
        ]
        # Of a gross fault the linearisation leaves something, too.
        if any(rest < _ONE_FAULT * statistic or not is_misfit(rest, number) for rest, number in without):
            return False
    new = unmodelled_noise(joint, system)
    if np.allclose(new, joint.unmodelled_sigma, rtol=0.1, atol=1e-6):
        return False
    joint.unmodelled_sigma = new
    return True
