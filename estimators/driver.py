"""Iteration by play-back around a solver of the linearised joint problem, and the calibration made of it.

Kalman filter and factor graph differ in :class:`Step` alone: play-back, choice of parameters that the data show,
convergence, statistics and the result are the same.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.statistics import deletion_table, excess_noise, residuals, suspects
from estimators.system import N_ERRORS, by_source, linearise, solve, weighted
from estimators.targets import PARAMETER_UNITS
from srt.assembly import Outcome, assemble, is_misfit
from srt.compensation import outside_model
from srt.held import held_sigma, request_reason
from srt.iteration import CONVERGED_CORRECTION, CONVERGED_SIGMAS
from srt.least_squares_estimator import OBSERVED_BELOW, admission_sigma, admit
from srt.quaternion import rotation_matrix
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES, SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.problem import Played, Point, Problem
    from estimators.system import BatchSolution, System
    from srt.calibration import Calibration, Residual
    from srt.estimation import Progress
    from srt.options import Options
    from srt.prior import Prior

    Array = NDArray[np.float64]

_MAX_STEP: Final = 0.7
_ROUNDS: Final = 5
_RENEWALS: Final = 2
_NEAR: Final = 1e-2
_GROSS_RATIO: Final = 100.0
_GROSS_G: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """A solution of the linearised problem.

    Attributes
    ----------
    point : Point
        What the correction is to be applied to: the point of linearisation, or one with better attitudes.
    system : System
        Linearised there.
    delta : ndarray, shape (n,)
        Correction of all columns.
    correction : ndarray, shape (27,)
    covariance : ndarray, shape (27, 27)
        Of the reported parameters.
    """

    point: Point
    system: System
    delta: Array
    correction: Array
    covariance: Array


class Step(ABC):
    """One solution of the linearised problem.

    Attributes
    ----------
    name : str
        Of the estimator.
    prior : Prior or None
        Of the sensor errors; with one every parameter can be estimated.
    """

    name: str
    prior: Prior | None = None

    @property
    def settled(self) -> bool:
        """Whether it may end here, if the correction is negligible."""
        return True

    def weights(self) -> dict[tuple[str, int], float]:
        """Weight of each measurement, by kind and number, where it is not one."""
        return {}

    def restart(self) -> None:  # noqa: B027 - most have nothing to do
        """Begin anew, the measurements having changed."""

    @abstractmethod
    def solve(self, problem: Problem, system: System, point: Point) -> Solved:
        """Solve a problem linearised at a point."""

    def diagnostics(self, problem: Problem) -> dict[str, Any]:  # noqa: ARG002 - for those that have some
        """What else the estimator reports, as JSON values."""
        return {}


@dataclass(slots=True, eq=False)
class State:
    """Where an iteration stands.

    Attributes
    ----------
    point : Point
        The estimate.
    linearised_at, played, system : Point, Played, System
        The last linearisation.
    free : ndarray of bool, shape (27,)
    covariance : ndarray, shape (27, 27)
    corrections : list of float
    status, message : str
    """

    point: Point
    free: NDArray[np.bool_]
    linearised_at: Point | None = None
    played: Played | None = None
    system: System | None = None
    covariance: Array | None = None
    corrections: list[float] | None = None
    status: str = "not_converged"
    message: str = ""


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
    requested: NDArray[np.bool_],
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
    selected = not state.free.all() or bool(requested.any() and not (state.free | requested).all())
    for _ in range(problem.options.max_playbacks):
        played = problem.play(state.point)
        point = state.point
        if point.attitude is None:
            point = problem.place(point, played)
        near = bool(corrections) and corrections[-1] < _NEAR
        if near and renewed < _RENEWALS:  # no more, or a scatter on the border of being noise would go on and off
            problem.update_wander(point, played)
            renewed += 1
        system = linearise(problem, point, played, state.free)
        if near and not selected and step.prior is None:
            state.free = admitted(system, requested)
            selected = True
            system = linearise(problem, point, played, state.free)
        try:
            solved = step.solve(problem, system, point)
        except np.linalg.LinAlgError as error:
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


def admitted(system: System, requested: NDArray[np.bool_]) -> NDArray[np.bool_]:
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
    Q, _ = np.linalg.qr(B / np.maximum(np.linalg.norm(B, axis=0), 1e-300))
    left = wanted - Q @ (Q.T @ wanted)
    assert E.shape[0] == wanted.shape[1]
    return admit(left * admission_sigma(), ~requested)


def run(problem: Problem, step: Step, options: Options, progress: Progress | None) -> Calibration:
    """Calibrate: iterate, judge what the data show, and put the result together.

    Raises
    ------
    InputError
        Options that do not go with joint estimation.
    """
    options.refuse(("step", "down", "measured_vertical"), "Joint estimation")
    requested = np.array([name in options.held_names for name in NAMES])
    uncertain = held_sigma(problem.data, options)
    held = {name: request_reason(name, uncertain) for name in options.held_names}
    state = State(problem.start, ~requested)
    diagnostics: dict[str, Any] = {}
    for _ in range(_ROUNDS):
        state = iterate(problem, step, state, requested=requested, progress=progress)
        if state.status != "converged" or state.system is None or state.covariance is None:
            break
        if _add_excess(problem, step, state):
            continue
        moved = problem.moved(state.point, state.played) if state.played is not None else None
        if moved is not None and moved.any():
            held_before = _judge(problem, step, state, uncertain)
            diagnostics["held"] = {"sequences": list(held_before.table)} | step.diagnostics(problem)
            problem.release(moved)
            step.restart()
            continue
        sigma = np.sqrt(np.maximum(np.diag(state.covariance), 0.0))
        weak = state.free & (sigma > OBSERVED_BELOW * admission_sigma())
        if not weak.any() or step.prior is not None:
            break
        state.free = state.free & ~weak
    return _result(problem, step, options, state, held, uncertain, diagnostics)


def _add_excess(problem: Problem, step: Step, state: State) -> bool:
    """In a free recording, noise beyond the sensors' where the residuals ask for it; True if there is more of it."""
    if problem.data.recording.fixture is not None:
        return False  # there a misfit is a fault to be named, not the hand's
    system = _with_prior(problem, step, state)
    left = system.b + system.A @ solve(system).delta
    if not is_misfit(float(left @ left), len(left) - int(system.active.sum())):
        return False
    new = excess_noise(problem, system)
    if np.allclose(new, problem.excess, rtol=0.1, atol=1e-6):
        return False
    problem.excess = new
    return True


def _result(
    problem: Problem,
    step: Step,
    options: Options,
    state: State,
    held: dict[str, str],
    uncertain: Array,
    diagnostics: dict[str, Any],
) -> Calibration:
    """Put the calibration together."""
    data = problem.data
    warnings = [problem.U_note] if problem.U_note and problem.fixture_states else []
    if state.system is not None and state.covariance is not None:
        sigma = np.sqrt(np.maximum(np.diag(state.covariance), 0.0))
        weak = ~state.free | (sigma > OBSERVED_BELOW * admission_sigma())
        for i in np.flatnonzero(weak):
            held.setdefault(NAMES[i], "the sequences of this recording do not show it apart from the others")
    judged = _judge(problem, step, state, uncertain)
    warnings += suspects(judged.table)
    if any(problem.excess):
        warnings.append(
            f"Residuals are larger than the sensors' noise explains: {np.degrees(problem.excess[0]):.2g}° per turn "
            f"and {problem.excess[1]:.2g} m/s² per pose were added, and the sigmas include them."
        )
    outcome = Outcome(
        state.point.errors,
        state.point.U,
        judged.covariance,
        tuple(state.corrections or ()),
        state.status,
        state.message,
        judged.residuals,
        judged.statistic,
        judged.freedom,
        judged.gross,
        tuple(np.flatnonzero(problem.integrated).tolist()),
        problem.wander,
        state.point.bias_deviation,
        np.tile(np.eye(3), (data.K, 1, 1)) if state.played is None else state.played.turned,
        judged.total,
        {"sequences": list(judged.table)} | step.diagnostics(problem) | diagnostics,
    )
    return assemble(step.name, data, options, outcome, held, warnings=tuple(warnings))


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Statistics of a solution: covariance by source and in all, residuals, every sequence against the others."""

    covariance: dict[str, Array]
    total: Array
    residuals: tuple[Residual, ...] = ()
    table: tuple[dict[str, Any], ...] = ()
    statistic: float = 0.0
    freedom: int = 0
    gross: bool = False


def _judge(problem: Problem, step: Step, state: State, uncertain: Array) -> Judgement:
    nothing = np.zeros((N_PARAMETERS, N_PARAMETERS))
    if state.system is None or state.covariance is None or state.status == "outside_model":
        return Judgement({"none": nothing}, nothing)
    system = _with_prior(problem, step, state)
    try:
        solution = solve(system)
    except np.linalg.LinAlgError:
        return Judgement({"none": nothing}, state.covariance)
    table = tuple(deletion_table(problem, system, solution))
    if step.weights():
        system = weighted(system, step.weights())
        solution = solve(system)
    covariance = by_source(system, solution)
    covariance["held_values"] = _held_values(system, solution, uncertain, state.free)
    total = state.covariance + covariance["held_values"]
    for group, wander in (("gyro_bias", problem.wander), ("accel_bias", problem.data.noise.accel_wander)):
        at = np.arange(N_PARAMETERS)[GROUP_SLICES[group]]
        part = covariance.setdefault(f"{group}_instability", nothing.copy())
        # The bias reported is the unit's; that of this test is one draw of it.
        part[at, at] += wander**2
        total[at, at] += wander**2
    left = system.b + system.A @ solution.delta
    spread = system.A @ solution.root
    measured = np.ones(len(left), dtype=np.bool_)
    if step.prior is not None:  # what a prior costs in degrees of freedom is no whole number
        measured[system.rows_of("prior").index.ravel()] = False
    statistic = float(left[measured] @ left[measured])
    number = round(float(measured.sum()) - float(np.sum(spread[measured] ** 2)))
    force = system.rows_of("force").index
    raw = np.linalg.solve(system.whitening["force"], left[force][..., None])
    gross = statistic > _GROSS_RATIO * max(number, 1) and float(np.sqrt(np.mean(raw**2))) > (
        _GROSS_G * problem.data.gravity
    )
    return Judgement(
        covariance,
        total,
        residuals(problem, system, solution),
        table,
        statistic,
        number,
        gross,
    )


def _with_prior(problem: Problem, step: Step, state: State) -> System:
    """The last linearisation, the prior of the sensor errors among its rows."""
    assert state.system is not None
    if step.prior is None:
        return state.system
    assert state.linearised_at is not None
    assert state.played is not None
    return linearise(problem, state.linearised_at, state.played, state.free, step.prior)


def _held_values(system: System, solution: BatchSolution, uncertain: Array, free: NDArray[np.bool_]) -> Array:
    """Covariance that the errors of held values bring into what is estimated with them."""
    E = system.parameter_map()
    effect = system.A @ E.T * np.where(free, 0.0, uncertain)
    bias = system.columns["bias"]
    # The map averages the biases; held ones are off by the same in every sequence.
    effect[:, N_ERRORS:] *= (bias.stop - bias.start) // 3
    brought = (E @ solution.root) @ (solution.root.T @ (system.A.T @ effect))
    return np.asarray(brought @ brought.T)
