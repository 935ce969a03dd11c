"""Gauss-Newton iteration of the joint model, and the calibration from its solution.

It solves for the attitudes of the windows together with the sensor errors. The iteration of the closed form and of
least squares, which solves for the sensor errors alone, is :mod:`srt.estimation.iteration`.

Each iteration re-processes (plays back, Savage 2020, §8) the recorded data. Kalman filter and factor graph differ only
in their :class:`~estimators.solver.JointSolver`: compensation, observability, convergence, goodness of fit and the
result are the same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.sparse import hstack
from threadpoolctl import threadpool_limits

from estimators.accuracy_targets import PARAMETER_UNITS
from estimators.block_solution import BlockSolution, eliminate
from estimators.drift_terms import DriftTerms, search, shows_instability
from estimators.elimination_steps import global_columns
from estimators.initial_attitudes import initial_attitudes
from estimators.joint_state import NO_ERRORS
from estimators.linear_system import N_ERRORS, total
from estimators.linearisation import linearise
from estimators.residual_analysis import contradictions, unmodelled_noise
from estimators.solution_analysis import (
    FixedParameters,
    analyse_solution,
    goodness_of_fit,
    make_calibration,
    whole_solution,
)
from estimators.solver import IterationState, JointSolver
from srt.estimation.drift_model import MOST_TERMS
from srt.estimation.fixed_parameters import (
    fixed_sigma,
    reason_not_observed,
    reason_on_request,
    seen_by_earth_rate_alone,
)
from srt.estimation.g_sensitivity_report import significant_g_sensitivity
from srt.estimation.goodness_of_fit import contradicting_group, is_misfit, one_group_explains
from srt.estimation.iteration import CONVERGED_CORRECTION, CONVERGED_SIGMAS
from srt.estimation.move_checks import contradicting_move
from srt.estimation.observability import OBSERVED_BELOW, admission_sigma, admit
from srt.model.prior import Prior
from srt.model.rotations import rotation_matrix, rotation_vector
from srt.model.sensor_model import outside_model
from srt.noise.drift_forms import WALK
from srt.sensor_errors import NAMES, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.joint_model import JointModel
    from estimators.joint_state import CompensatedData, JointState
    from estimators.linear_system import LinearSystem
    from srt.estimation.drift_model import DriftTerm
    from srt.estimation.registry import Progress
    from srt.result.calibration import Calibration
    from srt.types import Array, Mask


_MAX_STEP: Final = 0.7
"""Largest correction (dimensionless, rad, bias in g) per iteration. Only the direction of larger ones is meaningful."""
_ROUNDS: Final = 6
"""Maximum number of rounds; a change of the noise model or of the free parameters starts a new round."""
_SCATTER_UPDATES: Final = 2
"""Number of updates of the bias scatter. Further updates could alternate between zero and a small scatter."""
_INDEPENDENT: Final = 1e-10
"""Columns are scaled to norm 1. A smaller diagonal element of R marks a linearly dependent column."""
_NEAR: Final = 1e-2
"""The noise is assessed once the correction (dimensionless, rad, bias in g) is below this."""
_SAME_NOISE: Final = (0.1, 1e-6)
"""Relative and absolute (rad, m/s², rad/s) change of the unmodelled error that is negligible."""


def apply_correction(state: JointState, system: LinearSystem, delta: Array) -> JointState:
    """Apply a correction of the columns to a state.

    Raises
    ------
    InputError
        If the correction is not finite.
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
    # Columns are rotations about the axes of L; attitudes are corrected from the right, in B.
    in_body = np.einsum("wba,wb->wa", state.attitude, delta[c["attitude"]].reshape(-1, 3))
    return replace(
        state,
        errors=SensorErrors(vector),
        bias_deviation=deviation,
        base=state.base @ rotation_matrix(delta[c["base"]]),
        U=state.U @ rotation_matrix(delta[c["mounting"]]),
        non_orthogonality=state.non_orthogonality + float(delta[c["non_orthogonality"]][0]),
        gravity=state.gravity + float(delta[c["gravity"]][0]),
        earth_rate=state.earth_rate + delta[c["earth_rate"]].reshape(-1, 3),
        drift=state.drift + delta[c["drift_form"]],
        attitude=state.attitude @ rotation_matrix(in_body),
        table_rate=state.table_rate + float(delta[c["table_rate"]].sum()),
    )


def iterate(
    joint: JointModel,
    solver: JointSolver,
    iteration: IterationState,
    *,
    requested: Mask,
    progress: Progress | None = None,
    converged: tuple[float, float] = (CONVERGED_CORRECTION, CONVERGED_SIGMAS),
    max_step: float = _MAX_STEP,
) -> IterationState:
    """Compensate, linearise and solve until the correction is negligible.

    Parameters
    ----------
    joint : JointModel
    solver : JointSolver
    iteration : IterationState
        Initial state and free parameters.
    requested : ndarray of bool, shape (27,)
        Parameters fixed on request.
    progress : callable, optional
    converged : (float, float)
        Corrections below either limit are negligible: absolute, and in sigmas.
    max_step : float
        Longest step; longer ones are shortened to it.
    """
    corrections: list[float] = [] if iteration.corrections is None else iteration.corrections
    iteration.corrections = corrections
    scatter_updates = 0
    observability_known = not np.array_equal(iteration.free, ~requested)
    for _ in range(joint.options.max_playbacks):
        near = bool(corrections) and corrections[-1] < _NEAR
        state, compensated = _compensate(joint, iteration.state, scatter_updates if near else None)
        scatter_updates += near
        system = linearise(joint, state, compensated, iteration.free)
        if near and not observability_known and solver.prior is None:
            observability_known = True
            if not np.array_equal(observable_parameters(system, requested), iteration.free):
                # A wide prior is added. Parameters whose sigma remains near that of the prior are fixed at the end.
                solver.prior = default_prior()
        solver.observability_pending = not observability_known
        correction = _correct(joint, solver, iteration, (state, system), max_step, progress)
        if correction is None:
            break
        assert iteration.covariance is not None
        sigma = np.sqrt(np.maximum(np.diag(iteration.covariance), 0.0))
        if joint.tie_ends(sigma):
            continue
        negligible = np.maximum(converged[0] * PARAMETER_UNITS, converged[1] * sigma)
        if (
            np.all(np.abs(correction) <= negligible)
            and _neglected_tilt(state, iteration.state) <= converged[1] * _least_tilt_sigma(joint, compensated)
            and solver.settled
            and (observability_known or solver.prior is not None)
        ):
            iteration.status, iteration.message = "converged", f"Converged after {len(corrections)} iterations."
            break
    else:
        iteration.status = "not_converged"
        iteration.message = (
            f"Not converged after {len(corrections)} iterations: the last correction was {corrections[-1]:.2e} "
            "(largest component: ratios, rad; accelerometer bias in g)."
        )
    return iteration


def _neglected_tilt(before: JointState, after: JointState) -> float:
    """Largest tilt that the linearisation of the attitudes left out in the last correction, rad.

    It is the product of tilt and heading, which for milliradians exceeds the noise of the accelerometers; a change of
    heading alone leaves nothing out.
    """
    assert before.attitude is not None
    assert after.attitude is not None
    turned = rotation_vector(after.attitude @ np.swapaxes(before.attitude, 1, 2))
    return float(np.max(np.hypot(turned[:, 0], turned[:, 1]) * np.linalg.norm(turned, axis=1)))


def _least_tilt_sigma(joint: JointModel, compensated: CompensatedData) -> float:
    """Smallest standard deviation of the tilt that the mean force of a window shows, rad."""
    variance = np.einsum("waa->wa", total(compensated.force_noise))
    return float(np.sqrt(variance.min())) / joint.data.gravity


def _compensate(
    joint: JointModel, state: JointState, scatter_updates: int | None
) -> tuple[JointState, CompensatedData]:
    """Compensate the data; close to the solution, also update the priors that are estimated from the data.

    ``scatter_updates`` is the number of updates so far; None while the state is far from the solution.
    """
    compensated = joint.compensate(state)
    if state.attitude is None:
        state = initial_attitudes(joint, state, compensated)
    if scatter_updates is None:
        return state, compensated
    if scatter_updates == 0:
        joint.update_mounting_prior(state)
    if scatter_updates < _SCATTER_UPDATES:
        joint.update_bias_scatter(state, compensated)
        if not joint.bias_walks and state.bias_deviation.any():  # a fault of one sequence caused the scatter
            state = replace(state, bias_deviation=np.zeros_like(state.bias_deviation))
            compensated = joint.compensate(state)
    return state, compensated


def _correct(
    joint: JointModel,
    solver: JointSolver,
    iteration: IterationState,
    linearisation: tuple[JointState, LinearSystem],
    max_step: float,
    progress: Progress | None,
) -> Array | None:
    """Solve the linearised model and correct the state; None if there is no valid correction, with the status set."""
    state, system = linearisation
    iteration.status = "outside_model"  # the caller overwrites this status after a valid correction
    try:
        solved = solver.solve(joint, system, state)
    except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises ValueError for numbers that are not finite
        iteration.message = f"The equations cannot be solved ({error})."
        return None
    delta, correction = solved.delta, solved.correction
    if not np.all(np.isfinite(delta)) or not np.all(np.isfinite(solved.covariance)):
        iteration.message = "The correction is not finite."
        return None
    size = float(np.max(np.abs(correction) / PARAMETER_UNITS))
    if size > max_step:
        delta, correction = delta * (max_step / size), correction * (max_step / size)
    assert iteration.corrections is not None
    iteration.corrections.append(size)
    if progress is not None:
        progress(len(iteration.corrections), size)
    iteration.state = apply_correction(state, system, delta)
    iteration.linearisation_point, iteration.system = state, system
    iteration.compensated, iteration.covariance = system.compensated, solved.covariance
    reason = outside_model(iteration.state.errors)
    if reason is not None:
        iteration.message = f"After iteration {len(iteration.corrections)} {reason}."
        return None
    return correction


def default_prior() -> Prior:
    """Wide prior with negligible information: 1-sigma of a third of full scale, 1 % asymmetry."""
    return Prior.from_sigma(admission_sigma())


def observable_parameters(system: LinearSystem, requested: Mask) -> Mask:
    """Mask of the sensor errors that are observable if all other unknowns are estimated, too, shape (27,)."""
    bias = system.columns["bias"]
    number = (bias.stop - bias.start) // 3
    active = system.active.copy()
    active[system.columns["errors"]] = True
    A = system.A
    if number > 1:  # the biases are re-parametrised as their mean, in the columns of the first, and K − 1 deviations
        mean = sum(A[:, bias.start + 3 * k : bias.start + 3 * k + 3] for k in range(number))
        A = hstack([A[:, : bias.start], mean, A[:, bias.start + 3 :]]).tocsr()
    active[bias.start : bias.start + 3] = True
    again = replace(system, A=A, active=active)
    columns = global_columns(again)
    R = eliminate(again, columns)[2][:, :-1]
    parameters = np.concatenate([system.of("errors"), system.of("bias")[:3]])
    others = R[:, ~np.isin(columns, parameters)]
    wanted = R[:, np.searchsorted(columns, parameters)]
    Q, T = np.linalg.qr(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))
    Q = Q[:, np.abs(np.diag(T)) > _INDEPENDENT]  # dependent columns add rounding errors only
    left = wanted - Q @ (Q.T @ wanted)
    return admit(left * admission_sigma(), ~requested)


def run(joint: JointModel, solver: JointSolver, progress: Progress | None) -> Calibration:
    """Calibrate with a solver.

    Linear algebra runs in one thread: with matrices of a few hundred rows, more threads give no gain, and on a busy
    machine they were ten times slower.

    Raises
    ------
    InputError
        If an option does not apply to joint estimation.
    """
    joint.options.refuse(("step", "down", "measured_vertical"), "Joint estimation")
    with threadpool_limits(limits=1, user_api="blas"):
        return _run(joint, solver, progress)


def _run(joint: JointModel, solver: JointSolver, progress: Progress | None) -> Calibration:
    joint, found = _with_sound_moves(joint, solver, progress)
    options = joint.options
    uncertain = fixed_sigma(joint.data, options)
    reasons = {name: reason_on_request(name, uncertain, joint.data) for name in options.fixed_names}
    reasons = _not_shown_by_poses(joint, reasons) | reasons
    fixed = FixedParameters(reasons, uncertain)
    requested = np.array([name in reasons for name in NAMES])
    iteration = IterationState(joint.start, ~requested) if found is None else found
    diagnostics: dict[str, Any] = {}
    for _ in range(_ROUNDS * (1 + MOST_TERMS)):
        iteration = iterate(joint, solver, iteration, requested=requested, progress=progress)
        if iteration.compensated is None or iteration.covariance is None or iteration.status == "outside_model":
            break
        # Motion in a window can prevent convergence, and would pass for noise or drift of the sensors.
        moving_windows = joint.moving_windows(iteration.state, iteration.compensated)
        if moving_windows.any():
            diagnostics["held"] = {"sequences": list(analyse_solution(joint, solver, iteration, uncertain).table)}
            diagnostics["held"] |= solver.diagnostics(joint)
            joint.integrate_windows(moving_windows)
            solver.restart()
            continue
        if iteration.status != "converged":
            break
        if any(
            add(joint, solver, iteration)
            for add in (_add_g_sensitivity, _add_instability, _add_unmodelled_noise, _add_drift)
        ):
            continue
        sigma = np.sqrt(np.maximum(np.diag(iteration.covariance), 0.0))
        weak = iteration.free & (sigma > OBSERVED_BELOW * admission_sigma())
        if not weak.any() or solver.prior is not None:
            break
        iteration.free = iteration.free & ~weak
        iteration.state = joint.with_initial_values(iteration.state, weak)
    return make_calibration(joint, solver, iteration, fixed, diagnostics)


def _not_shown_by_poses(joint: JointModel, requested: Mapping[str, str]) -> dict[str, str]:
    """Parameters that a test of poses and stated rates does not show, with reasons; none if there are other rotations.

    They are fixed from the start. With a wide prior, the square of a misalignment of a third would become a scale
    error, and the iteration would wander.
    """
    by_earth_rate = seen_by_earth_rate_alone(joint.data)
    if not by_earth_rate:
        return {}
    wanted = np.array([name not in by_earth_rate and name not in requested for name in NAMES])
    system = linearise(joint, *joint.placed(joint.start), wanted)
    observable = observable_parameters(system, ~wanted)
    others = [name for name, lost in zip(NAMES, wanted & ~observable, strict=True) if lost]
    return by_earth_rate | {name: reason_not_observed(name) for name in others}


def _with_sound_moves(
    joint: JointModel, solver: JointSolver, progress: Progress | None
) -> tuple[JointModel, IterationState | None]:
    """Leave out the moves that contradict the other measurements, one after the other.

    Returns the model without them, and its solution if one was found.
    """
    requested = np.array([name in joint.options.fixed_names for name in NAMES])
    while joint.data.moves:
        start = IterationState(joint.start, ~requested)
        iteration = iterate(joint, solver, start, requested=requested, progress=progress)
        if iteration.status != "converged":
            solver.restart()
            break
        if _add_g_sensitivity(joint, solver, iteration):
            joint.start = replace(joint.start, drift=iteration.state.drift)
            continue
        against = contradictions(joint, whole_solution(joint, solver, iteration))
        tests = [(against[step].chi_square, against[step].degrees_of_freedom) for step in joint.rank.tolist()]
        reasons = contradicting_move(tests, joint.data.is_move)
        if not reasons:
            return joint, iteration
        joint = joint.without_moves(reasons)
        solver.restart()
    return joint, None


def _add_g_sensitivity(joint: JointModel, solver: JointSolver, iteration: IterationState) -> bool:
    """Model gyro g-sensitivity if the residuals exceed the noise and the rates at rest show it; True if so."""
    if joint.options.gyro_bias != "auto" or joint.drift.force_axes is not None or solver.weights():
        return False
    solution = whole_solution(joint, solver, iteration)
    if any(joint.unmodelled_sigma) or not is_misfit(*goodness_of_fit(joint, solver, solution, solution.system)):
        return False
    state, compensated = iteration.linearisation_point, iteration.compensated
    assert state is not None
    assert compensated is not None
    rest = joint.rest_rate(state, compensated)
    if significant_g_sensitivity(joint.data, compensated.force, rest, joint.integrated) is None:
        return False
    iteration.state = joint.with_g_sensitivity(iteration.state)
    solver.restart()
    return True


def _add_instability(joint: JointModel, solver: JointSolver, iteration: IterationState) -> bool:
    """Use a smooth drift, or the largest bias instability not excluded, if either explains the residuals."""
    data, state = joint.data, iteration.linearisation_point
    if solver.weights() or any(joint.unmodelled_sigma) or np.all(data.noise.accel_limit <= data.noise.accel_flicker):
        return False
    solution = whole_solution(joint, solver, iteration)
    fit = goodness_of_fit(joint, solver, solution, solution.system)
    if not is_misfit(*fit):
        if not shows_instability(joint, iteration, solution, fit[1]):
            return False
        tests = [(test.chi_square, test.degrees_of_freedom) for test in contradictions(joint, solution)]
        if contradicting_group(tests, *fit) is not None:
            return False
    assert state is not None
    found = search(joint, iteration, solution, fit[1])
    smooth = tuple(term for term in found.terms if term.sensor == "accel" and term.form != WALK)
    drift = joint.drift
    if smooth:
        after = _with_drift(joint, iteration.state, smooth)[1]
        joint.drift, before = _with_drift(joint, state, smooth)
        if _explains(joint, solver, iteration, before):
            iteration.state = after
            return True
        joint.drift = drift
    joint.data = replace(data, noise_at_limit=True)
    if _explains(joint, solver, iteration, state):
        return True
    joint.data = data
    return False


def _explains(joint: JointModel, solver: JointSolver, iteration: IterationState, state: JointState) -> bool:
    """True if the model as it is now explains the residuals at a state, and no sequence contradicts the others."""
    system = linearise(joint, state, joint.compensate(state), iteration.free, solver.prior)
    solution = BlockSolution(system)
    fit = goodness_of_fit(joint, solver, solution, system)
    tests = [(test.chi_square, test.degrees_of_freedom) for test in contradictions(joint, solution)]
    return not is_misfit(*fit) and contradicting_group(tests, *fit) is None


def _with_drift(joint: JointModel, state: JointState, terms: tuple[DriftTerm, ...]) -> tuple[DriftTerms, JointState]:
    """Terms of drift beside those of a model that lacks them, and a state with their coefficients, zero."""
    drift = DriftTerms(joint.data, (*joint.drift.terms, *terms), joint.drift.force_axes)
    return drift, replace(state, drift=np.append(state.drift, np.zeros(drift.size - len(state.drift))))


def _add_unmodelled_noise(joint: JointModel, solver: JointSolver, iteration: IterationState) -> bool:
    """Estimate unmodelled errors if the residuals of several sequences exceed their noise; True if the noise changed.

    If one sequence explains the misfit, that sequence is faulty: a warning names it, and no noise is added. A robust
    loss reduces the weight of such a sequence; this function then changes nothing.
    """
    if solver.weights():
        return False
    solution = whole_solution(joint, solver, iteration)
    system = solution.system
    statistic, freedom = goodness_of_fit(joint, solver, solution, system)
    # Unmodelled noise from an earlier round is always estimated again: it may be too large now.
    if not any(joint.unmodelled_sigma):
        if not is_misfit(statistic, freedom):
            return False
        tests = [(test.chi_square, test.degrees_of_freedom) for test in contradictions(joint, solution)]
        if one_group_explains(tests, statistic, freedom):
            return False
    new = unmodelled_noise(system)
    if np.allclose(new, joint.unmodelled_sigma, *_SAME_NOISE):
        return False
    joint.unmodelled_sigma = new
    return True


def _add_drift(joint: JointModel, solver: JointSolver, iteration: IterationState) -> bool:
    """Model the most significant form of drift of each triad that the residuals show; True if there is one.

    The unmodelled noise is then estimated again. A robust loss reduces the weight of sequences instead.
    """
    if solver.weights() or len(joint.drift.terms) >= MOST_TERMS:
        return False
    solution = whole_solution(joint, solver, iteration)
    system = solution.system
    iteration.unmodelled_drift = search(joint, iteration, solution, goodness_of_fit(joint, solver, solution, system)[1])
    if not iteration.unmodelled_drift.terms:
        return False
    joint.drift, iteration.state = _with_drift(joint, iteration.state, iteration.unmodelled_drift.terms)
    joint.unmodelled_sigma = NO_ERRORS
    return True
