"""From a solution to a calibration: covariance by source, residuals, and every sequence against the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.dense_solution import apply_weights, covariance_by_source, solve
from estimators.linear_system import N_ERRORS, linearise
from estimators.residual_analysis import contradiction_warnings, contradictions, deletion_table, evidence, residuals
from srt.estimation.calibration_builder import build_calibration
from srt.estimation.observability import OBSERVED_BELOW, admission_sigma
from srt.estimation.solver_result import SolverResult
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from estimators.dense_solution import DenseSolution
    from estimators.joint_model import JointModel
    from estimators.linear_system import LinearSystem
    from estimators.solver import IterationState, Solver
    from srt.estimation.leave_one_out import SequenceDiagnostics
    from srt.estimation.options import Options
    from srt.result.calibration import Calibration, Residual
    from srt.types import Array, Mask


_GROSS_RATIO: Final = 100.0
_GROSS_G: Final = 0.01


def make_calibration(
    joint: JointModel,
    solver: Solver,
    options: Options,
    iteration: IterationState,
    held: dict[str, str],
    uncertain: Array,
    diagnostics: dict[str, Any],
) -> Calibration:
    """Put the calibration together."""
    data = joint.data
    warnings = [joint.U_note] if joint.U_note and joint.fixture_states else []
    if iteration.system is not None and iteration.covariance is not None:
        sigma = np.sqrt(np.maximum(np.diag(iteration.covariance), 0.0))
        weak = ~iteration.free | (sigma > OBSERVED_BELOW * admission_sigma())
        for i in np.flatnonzero(weak):
            held.setdefault(NAMES[i], "the sequences of this recording do not show it apart from the others")
    judged = analyse_solution(joint, solver, iteration, uncertain)
    warnings += contradiction_warnings(judged.table)
    if any(joint.unmodelled_sigma):
        rotation, force, rate = joint.unmodelled_sigma
        warnings.append(
            f"Residuals are larger than the sensors' noise explains: {np.degrees(rotation):.2g}° per rotation, "
            f"{force:.2g} m/s² and {rate:.2g} rad/s per pose were added, and the sigmas include them."
        )
    # What is not observed keeps the first estimate's value, whatever a prior and its neighbours made of it.
    unseen = np.array([name in held for name in NAMES])
    outcome = SolverResult(
        errors=joint.with_initial_values(iteration.state, unseen).errors,
        U=iteration.state.U,
        covariance=judged.covariance,
        corrections=tuple(iteration.corrections or ()),
        status=iteration.status,
        message=iteration.message,
        residuals=judged.residuals,
        chi_square=judged.statistic,
        degrees_of_freedom=judged.freedom,
        gross_misfit=judged.gross,
        integrated=tuple(np.flatnonzero(joint.integrated).tolist()),
        wander=joint.bias_scatter,
        bias_by_sequence=iteration.state.bias_deviation + judged.instability,
        end_attitude=np.tile(np.eye(3), (data.K, 1, 1))
        if iteration.compensated is None
        else iteration.compensated.rotation,
        total=judged.total,
        diagnostics={"sequences": list(judged.table)} | solver.diagnostics(joint) | diagnostics,
        sequences=judged.evidence,
    )
    return build_calibration(solver.name, data, options, outcome, held, warnings=tuple(warnings))


@dataclass(frozen=True, slots=True, eq=False)
class SolutionAnalysis:
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
    evidence: tuple[SequenceDiagnostics, ...] = ()
    instability: Array | float = 0.0


def analyse_solution(
    joint: JointModel, solver: Solver, iteration: IterationState, uncertain: Array
) -> SolutionAnalysis:
    """Work out the statistics of the solution that an iteration ended with."""
    nothing = np.zeros((N_PARAMETERS, N_PARAMETERS))
    if iteration.system is None or iteration.covariance is None or iteration.status == "outside_model":
        return SolutionAnalysis({"none": nothing}, nothing)
    system = with_prior(joint, solver, iteration)
    try:
        solution = solve(system)
    except np.linalg.LinAlgError:
        return SolutionAnalysis({"none": nothing}, iteration.covariance)
    against = contradictions(joint, system, solution)
    table = tuple(deletion_table(joint, system, solution, against))
    if solver.weights():
        system = apply_weights(system, solver.weights())
        solution = solve(system)
    covariance = covariance_by_source(system, solution)
    covariance["held_values"] = _held_values(system, solution, uncertain, iteration.free)
    total = iteration.covariance + covariance["held_values"]
    # Under "per-sequence" the wander is a freedom, and no figure of the unit; a stated drift is in the solution.
    if joint.data.noise.gyro_flicker is None and joint.options.gyro_bias != "per-sequence":
        at = np.arange(N_PARAMETERS)[GROUP_SLICES["gyro_bias"]]
        part = covariance.setdefault("gyro_bias_instability", nothing.copy())
        # The bias reported is the unit's; that of this test is one draw of it.
        part[at, at] += joint.bias_scatter**2
        total[at, at] += joint.bias_scatter**2
    left = system.b + system.A @ solution.delta
    spread = system.A @ solution.root
    measured = np.ones(len(left), dtype=np.bool_)
    if solver.prior is not None:  # what a prior costs in degrees of freedom is no whole number
        measured[system.rows_of("prior").index.ravel()] = False
    statistic = float(left[measured] @ left[measured])
    number = round(float(measured.sum()) - float(np.sum(spread[measured] ** 2)))
    force = system.rows_of("force").index
    raw = np.linalg.solve(system.whitening["force"], left[force][..., None])
    gross = statistic > _GROSS_RATIO * max(number, 1) and float(np.sqrt(np.mean(raw**2))) > (
        _GROSS_G * joint.data.gravity
    )
    return SolutionAnalysis(
        covariance,
        total,
        residuals=residuals(joint, system, solution),
        table=table,
        statistic=statistic,
        freedom=number,
        gross=gross,
        evidence=evidence(joint, system, solution, against),
        instability=joint.instability_by_sequence(system.compensated, solution.delta[system.columns["instability"]]),
    )


def with_prior(joint: JointModel, solver: Solver, iteration: IterationState) -> LinearSystem:
    """The last linearisation, the prior of the sensor errors among its rows."""
    assert iteration.system is not None
    if solver.prior is None:
        return iteration.system
    assert iteration.linearisation_point is not None
    assert iteration.compensated is not None
    return linearise(joint, iteration.linearisation_point, iteration.compensated, iteration.free, solver.prior)


def _held_values(system: LinearSystem, solution: DenseSolution, uncertain: Array, free: Mask) -> Array:
    """Covariance that the errors of held values bring into what is estimated with them."""
    E = system.parameter_map()
    effect = system.A @ E.T * np.where(free, 0.0, uncertain)
    bias = system.columns["bias"]
    # The map averages the biases; held ones are off by the same in every sequence.
    effect[:, N_ERRORS:] *= (bias.stop - bias.start) // 3
    brought = (E @ solution.root) @ (solution.root.T @ (system.A.T @ effect))
    return np.asarray(brought @ brought.T)
