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
from estimators.residual_analysis import deletion_table, excess_noise
from estimators.result import calibration_of, judge, with_prior
from estimators.step import State, Step
from srt.estimation.assembly import is_misfit
from srt.estimation.fixed_parameters import held_sigma, request_reason
from srt.estimation.iteration import CONVERGED_CORRECTION, CONVERGED_SIGMAS
from srt.estimation.observability import OBSERVED_BELOW, admission_sigma, admit
from srt.model.prior import Prior
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import outside_model
from srt.sensor_errors import NAMES, SensorErrors

if TYPE_CHECKING:
    from estimators.joint_problem import Problem
    from estimators.linear_system import System
    from estimators.linearisation_point import Point
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


def corrected(point: Point, system: System, delta: Array) -> Point:
    """Apply a correction of the columns to a point.

    Raises
    ------
    InputError
        A correction that is not finite.
    """
    c = system.columns
    bias = delta[c["bias"]].reshape(-1, 3)
    common = bias.mean(axis=0)
    vector = point.errors.vector.copy()
    vector[:N_ERRORS] += delta[c["errors"]]
    deviation = point.bias_deviation
    if len(bias) > 1:
        deviation = deviation + bias - common
        shift = deviation.mean(axis=0)
        deviation, common = deviation - shift, common + shift
    vector[N_ERRORS:] += common
    assert point.attitude is not None
    turn = delta[c["attitude"]].reshape(-1, 3)
    in_body = np.einsum("wba,wb->wa", point.attitude, turn)
    return replace(
        point,
        errors=SensorErrors(vector),
        bias_deviation=deviation,
        base=point.base @ rotation_matrix(delta[c["base"]]),
        U=point.U @ rotation_matrix(delta[c["mounting"]]),
        gravity=point.gravity + float(delta[c["gravity"]][0]),
        earth_rate=point.earth_rate + delta[c["earth_rate"]].reshape(-1, 3),
        attitude=point.attitude @ rotation_matrix(in_body),
    )


def iterate(
    problem: Problem,
    step: Step,
    state: State,
    *,
    requested: Mask,
    progress: Progress | None = None,
    converged: tuple[float, float] = (CONVERGED_CORRECTION, CONVERGED_SIGMAS),
    max_step: float = _MAX_STEP,
) -> State:
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
    corrections: list[float] = [] if state.corrections is None else state.corrections
    renewed = 0
    selected = not np.array_equal(state.free, ~requested)
    for _ in range(problem.options.max_playbacks):
        played = problem.play(state.point)
        point = state.point
        if point.attitude is None:
            point = problem.place(point, played)
        near = bool(corrections) and corrections[-1] < _NEAR
        if near and not renewed:
            problem.update_mounting(point)
        if near and renewed < _RENEWALS:  # no more, or a scatter on the border of being noise would go on and off
            problem.update_wander(point, played)
            renewed += 1
            if not problem.walks and point.bias_deviation.any():  # it was a fault's, and there is one bias after all
                point = replace(point, bias_deviation=np.zeros_like(point.bias_deviation))
                played = problem.play(point)
        system = linearise(problem, point, played, state.free)
        if near and not selected and step.prior is None:
            selected = True
            if not np.array_equal(admitted(system, requested), state.free):
                # Too little is seen to do without one; what it does not narrow down is held in the end.
                step.prior = default_prior()
        step.leaning = not selected
        try:
            solved = step.solve(problem, system, point)
        except (np.linalg.LinAlgError, ValueError) as error:  # scipy's word for numbers that are not finite
            state.status, state.message = "outside_model", f"The equations are singular ({error})."
            break
        delta, correction, covariance = solved.delta, solved.correction, solved.covariance
        if not np.all(np.isfinite(delta)) or not np.all(np.isfinite(covariance)):
            state.status, state.message = "outside_model", "The correction is not finite."
            break
        size = float(np.max(np.abs(correction) / PARAMETER_UNITS))
        if size > max_step:
            delta, correction = delta * (max_step / size), correction * (max_step / size)
        corrections.append(size)
        if progress is not None:
            progress(len(corrections), size)
        state.point = corrected(solved.point, solved.system, delta)
        state.linearised_at, state.played, state.system = solved.point, played, solved.system
        state.covariance = covariance
        reason = outside_model(state.point.errors)
        if reason is not None:
            state.status, state.message = "outside_model", f"After play-back {len(corrections)} {reason}."
            break
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        if np.all(np.abs(correction) <= np.maximum(converged[0] * PARAMETER_UNITS, converged[1] * sigma)) and (
            step.settled and (selected or step.prior is not None)
        ):
            state.status, state.message = "converged", f"Converged after {len(corrections)} play-backs."
            break
    else:
        state.status = "not_converged"
        state.message = (
            f"Not converged after {len(corrections)} play-backs: the last correction was {corrections[-1]:.2e} "
            "(largest parameter, accelerometer bias in g)."
        )
    state.corrections = corrections
    return state


def default_prior() -> Prior:
    """Next to no knowledge: a third of full scale, 1 % of asymmetry."""
    return Prior.from_sigma(admission_sigma())


def admitted(system: System, requested: Mask) -> Mask:
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


def run(problem: Problem, step: Step, options: Options, progress: Progress | None) -> Calibration:
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
        return _run(problem, step, options, progress)


def _run(problem: Problem, step: Step, options: Options, progress: Progress | None) -> Calibration:
    requested = np.array([name in options.held_names for name in NAMES])
    uncertain = held_sigma(problem.data, options)
    held = {name: request_reason(name, uncertain) for name in options.held_names}
    state = State(problem.start, ~requested)
    diagnostics: dict[str, Any] = {}
    for _ in range(_ROUNDS):
        state = iterate(problem, step, state, requested=requested, progress=progress)
        if state.played is None or state.covariance is None or state.status == "outside_model":
            break
        if state.status == "converged" and _add_excess(problem, step, state):
            continue
        # A window that moved may be what keeps the iteration from resting.
        moved = problem.moved(state.point, state.played)
        if moved.any():
            diagnostics["held"] = {"sequences": list(judge(problem, step, state, uncertain).table)}
            diagnostics["held"] |= step.diagnostics(problem)
            problem.release(moved)
            step.restart()
            continue
        if state.status != "converged":
            break
        sigma = np.sqrt(np.maximum(np.diag(state.covariance), 0.0))
        weak = state.free & (sigma > OBSERVED_BELOW * admission_sigma())
        if not weak.any() or step.prior is not None:
            break
        state.free = state.free & ~weak
        state.point = problem.at_start(state.point, weak)
    return calibration_of(problem, step, options, state, held, uncertain, diagnostics)


def _add_excess(problem: Problem, step: Step, state: State) -> bool:
    """Noise beyond the sensors' where the residuals of many sequences ask for it; True if there is more of it.

    What one sequence alone contradicts is a fault of that one, to be named and not to be spread over all; a robust loss
    has its own way with it.
    """
    system = with_prior(problem, step, state)
    if step.weights():
        return False
    solution = solve(system)
    left = system.b + system.A @ solution.delta
    statistic, freedom = float(left @ left), len(left) - int(system.active.sum())
    # Once some is added it may prove too much, as when a window that moved is released.
    if not any(problem.excess):
        if not is_misfit(statistic, freedom):
            return False
        # Chi-square of all is that without one sequence, and what this one adds to it.
        without = [
            (statistic - row["chi_square"], freedom - row["degrees_of_freedom"])
            for row in deletion_table(problem, system, solution)
        ]
        # Of a gross fault the linearisation leaves something, too.
        if any(rest < _ONE_FAULT * statistic or not is_misfit(rest, number) for rest, number in without):
            return False
    new = excess_noise(problem, system)
    if np.allclose(new, problem.excess, rtol=0.1, atol=1e-6):
        return False
    problem.excess = new
    return True
