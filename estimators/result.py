"""From a solution to a calibration: covariance by source, residuals, and every sequence against the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.dense_solution import by_source, solve, weighted
from estimators.linear_system import N_ERRORS, linearise
from estimators.residual_analysis import contradictions, deletion_table, evidence, residuals, suspects
from srt.estimation.assembly import Outcome, assemble
from srt.estimation.observability import OBSERVED_BELOW, admission_sigma
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from estimators.dense_solution import BatchSolution
    from estimators.joint_problem import Problem
    from estimators.linear_system import System
    from estimators.step import State, Step
    from srt.estimation.leave_one_out import Evidence
    from srt.estimation.options import Options
    from srt.result.calibration import Calibration, Residual
    from srt.types import Array, Mask


_GROSS_RATIO: Final = 100.0
_GROSS_G: Final = 0.01


def calibration_of(
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
    judged = judge(problem, step, state, uncertain)
    warnings += suspects(judged.table)
    if any(problem.excess):
        warnings.append(
            f"Residuals are larger than the sensors' noise explains: {np.degrees(problem.excess[0]):.2g}° per turn, "
            f"{problem.excess[1]:.2g} m/s² and {problem.excess[2]:.2g} rad/s per pose were added, and the sigmas "
            "include them."
        )
    # What is not observed keeps the first estimate's value, whatever a prior and its neighbours made of it.
    unseen = np.array([name in held for name in NAMES])
    outcome = Outcome(
        errors=problem.at_start(state.point, unseen).errors,
        U=state.point.U,
        covariance=judged.covariance,
        corrections=tuple(state.corrections or ()),
        status=state.status,
        message=state.message,
        residuals=judged.residuals,
        statistic=judged.statistic,
        freedom=judged.freedom,
        gross=judged.gross,
        integrated=tuple(np.flatnonzero(problem.integrated).tolist()),
        wander=problem.wander,
        bias_by_sequence=state.point.bias_deviation + judged.drift,
        turned=np.tile(np.eye(3), (data.K, 1, 1)) if state.played is None else state.played.turned,
        total=judged.total,
        diagnostics={"sequences": list(judged.table)} | step.diagnostics(problem) | diagnostics,
        evidence=judged.evidence,
    )
    return assemble(step.name, data, options, outcome, held, warnings=tuple(warnings))


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Statistics of a solution: covariance by source and in all, residuals, every sequence against the others.

    ``drift`` is that of the gyros by sequence, about its mean, rad/s.
    """

    covariance: dict[str, Array]
    total: Array
    residuals: tuple[Residual, ...] = ()
    table: tuple[dict[str, Any], ...] = ()
    statistic: float = 0.0
    freedom: int = 0
    gross: bool = False
    evidence: tuple[Evidence, ...] = ()
    drift: Array | float = 0.0


def judge(problem: Problem, step: Step, state: State, uncertain: Array) -> Judgement:
    """Work out the statistics of the solution that an iteration ended with."""
    nothing = np.zeros((N_PARAMETERS, N_PARAMETERS))
    if state.system is None or state.covariance is None or state.status == "outside_model":
        return Judgement({"none": nothing}, nothing)
    system = with_prior(problem, step, state)
    try:
        solution = solve(system)
    except np.linalg.LinAlgError:
        return Judgement({"none": nothing}, state.covariance)
    against = contradictions(problem, system, solution)
    table = tuple(deletion_table(problem, system, solution, against))
    if step.weights():
        system = weighted(system, step.weights())
        solution = solve(system)
    covariance = by_source(system, solution)
    covariance["held_values"] = _held_values(system, solution, uncertain, state.free)
    total = state.covariance + covariance["held_values"]
    # Under "per-sequence" the wander is a freedom, and no figure of the unit; a stated drift is in the solution.
    if problem.data.noise.gyro_flicker is None and problem.options.gyro_bias != "per-sequence":
        at = np.arange(N_PARAMETERS)[GROUP_SLICES["gyro_bias"]]
        part = covariance.setdefault("gyro_bias_instability", nothing.copy())
        # The bias reported is the unit's; that of this test is one draw of it.
        part[at, at] += problem.wander**2
        total[at, at] += problem.wander**2
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
        residuals=residuals(problem, system, solution),
        table=table,
        statistic=statistic,
        freedom=number,
        gross=gross,
        evidence=evidence(problem, system, solution, against),
        drift=problem.drift_by_sequence(system.played, solution.delta[system.columns["drift"]]),
    )


def with_prior(problem: Problem, step: Step, state: State) -> System:
    """The last linearisation, the prior of the sensor errors among its rows."""
    assert state.system is not None
    if step.prior is None:
        return state.system
    assert state.linearised_at is not None
    assert state.played is not None
    return linearise(problem, state.linearised_at, state.played, state.free, step.prior)


def _held_values(system: System, solution: BatchSolution, uncertain: Array, free: Mask) -> Array:
    """Covariance that the errors of held values bring into what is estimated with them."""
    E = system.parameter_map()
    effect = system.A @ E.T * np.where(free, 0.0, uncertain)
    bias = system.columns["bias"]
    # The map averages the biases; held ones are off by the same in every sequence.
    effect[:, N_ERRORS:] *= (bias.stop - bias.start) // 3
    brought = (E @ solution.root) @ (solution.root.T @ (system.A.T @ effect))
    return np.asarray(brought @ brought.T)
