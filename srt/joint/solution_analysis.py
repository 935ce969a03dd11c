"""Analysis of a joint solution: covariance by source, residuals, goodness of fit, contradictions between sequences."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation import g_sensitivity_report
from srt.estimation.calibration_builder import build_calibration
from srt.estimation.error_sources import accel_drift, by_drift, latitude_error
from srt.estimation.fixed_parameters import determined_by_fixture, reason_not_observed, value_of_fixed
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.estimation.observability import finest_sigma, observed_limit
from srt.estimation.scale_changes import most_likely_change, scale_effects
from srt.estimation.solver_result import SolverResult
from srt.joint.block_solution import BlockSolution, apply_weights, covariance_by_source
from srt.joint.linear_system import N_ERRORS
from srt.joint.linearisation import linearise, with_prior
from srt.joint.residual_analysis import contradictions, deletion_table, residuals, sequence_diagnostics
from srt.model.rotations import rotation_matrix
from srt.noise.drift_forms import LINEAR, Statistics
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from srt.estimation.drift_model import DriftSearch
    from srt.estimation.leave_one_out import SequenceDiagnostics
    from srt.estimation.scale_changes import ScaleChange
    from srt.joint.joint_model import JointModel
    from srt.joint.linear_system import LinearSystem
    from srt.joint.solver import IterationState, JointSolver
    from srt.result.calibration import Calibration, Residual
    from srt.result.consistency import SequenceTest
    from srt.result.diagnostics import Diagnostics, GSensitivity
    from srt.types import Array, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class FixedParameters:
    """Parameters that are not estimated.

    Attributes
    ----------
    reasons : dict of str to str
        Reason by name of the parameter.
    sigma : ndarray, shape (27,)
        Standard deviation of the fixed values; zero if unknown, and zero for estimated parameters.
    """

    reasons: dict[str, str]
    sigma: Array


def make_calibration(
    solver: JointSolver,
    iteration: IterationState,
    fixed: FixedParameters,
    before: Diagnostics | None,
) -> Calibration:
    """Calibration from the final solution of an iteration."""
    joint, data, reasons = iteration.joint, iteration.joint.data, dict(fixed.reasons)
    warnings = [joint.choice.U_note] if joint.choice.U_note and joint.fixture_states else []
    analysis = analyse_solution(solver, iteration, fixed.sigma)
    if iteration.point is not None and iteration.covariance is not None:
        admission = joint.choice.admission
        limit = observed_limit(admission, finest_sigma(iteration.covariance))
        # Beside a fixture, the sigma by fixed values is that of its angles.
        vague = np.sqrt(np.diag(analysis.total)) > (limit if data.nominal is None else observed_limit(admission))
        weak = ~iteration.free | (iteration.sigma > limit) | vague
        for i in np.flatnonzero(weak):
            value = value_of_fixed(NAMES[i], fixed.sigma, data, joint.options)
            reasons.setdefault(NAMES[i], f"{reason_not_observed(NAMES[i])}; {value}")
    # Parameters that are not observable have their fixed value, not the one from a wide prior and correlations.
    supported = joint.relies_on_fixture & determined_by_fixture(data)
    not_observed = np.array([name in reasons for name in NAMES]) & ~supported
    drift = joint.choice.drift.estimates(iteration.state.drift)
    followed, notes = _g_sensitivity(iteration, analysis.g_sensitivity_covariance)
    result = SolverResult(
        errors=joint.with_fixed_values(iteration.state, not_observed).errors,
        U=iteration.state.U,
        covariance=analysis.covariance,
        corrections=tuple(iteration.corrections or ()),
        refits=tuple(iteration.refits),
        status=iteration.status,
        message=iteration.message,
        residuals=analysis.residuals,
        chi_square=analysis.chi_square,
        degrees_of_freedom=analysis.degrees_of_freedom,
        sensor_noise_fit=analysis.sensor_noise_fit,
        unmodelled=joint.choice.unmodelled_sigma,
        integrated=tuple(np.flatnonzero(joint.choice.integrated).tolist()),
        wander=joint.choice.bias_scatter,
        bias_by_sequence=iteration.state.bias_deviation + analysis.instability,
        end_attitude=_end_attitude(iteration),
        total=analysis.total,
        diagnostics=replace(
            solver.diagnostics(joint),
            sequences=analysis.table,
            g_sensitivity=followed,
            possible_accel_drift_sigma_m_s2=iteration.unmodelled_drift.possible or None,
            drift=tuple(term.result for term in drift) or None,
            before_integration=before,
        ),
        sequences=analysis.sequences,
        drift=drift,
        scale_change=analysis.scale_change,
        notes=notes,
    )
    return build_calibration(solver.name, data, joint.options, result, reasons, warnings=tuple(warnings))


def _end_attitude(iteration: IterationState) -> Array:
    """C_End of every sequence as the gyros measured it, relative to the Earth, shape (K, 3, 3)."""
    joint = iteration.joint
    if iteration.point is None or iteration.point.state.attitude is None:
        return np.tile(np.eye(3), (joint.data.K, 1, 1))
    state, compensated, start = iteration.point.state, iteration.point.compensated, joint.data.start
    earth = np.einsum("kba,kb->ka", iteration.point.state.attitude[start], joint.earth_rate(state)[start])
    # Over the half minute of a rotation with its windows, the Earth turns by a milliradian.
    return np.asarray(rotation_matrix(-earth * np.asarray(compensated.duration_s)[:, None]) @ compensated.rotation)


@dataclass(frozen=True, slots=True, eq=False)
class SolutionAnalysis:
    """Analysis of a joint solution.

    Attributes
    ----------
    covariance : dict of str to ndarray, shape (27, 27)
        Covariance of the reported parameters by source of error.
    total : ndarray, shape (27, 27)
        Covariance of the reported parameters.
    residuals : tuple of Residual
    table : tuple of SequenceTest
        Chi-square of every sequence as predicted from the others; see :func:`deletion_table`.
    chi_square, degrees_of_freedom : float, int
        Goodness of fit.
    sensor_noise_fit : tuple of float and int
        Goodness of fit with the noise of the sensors alone.
    sequences : tuple of SequenceDiagnostics
    instability : ndarray, shape (K, 3), rad/s
        Bias instability of the gyros by sequence, minus its mean.
    g_sensitivity_covariance : ndarray, shape (9, 9), or None
        Covariance of the elements of Γ by rows; None if it is not estimated.
    scale_change : ScaleChange or None
        Most likely change of scale factors, where the residuals do not agree.
    """

    covariance: dict[str, Array]
    total: Array
    residuals: tuple[Residual, ...] = ()
    table: tuple[SequenceTest, ...] = ()
    chi_square: float = 0.0
    degrees_of_freedom: int = 0
    sensor_noise_fit: tuple[float, int] = (0.0, 0)
    sequences: tuple[SequenceDiagnostics, ...] = ()
    instability: Array | float = 0.0
    g_sensitivity_covariance: Array | None = None
    scale_change: ScaleChange | None = None


def analyse_solution(solver: JointSolver, iteration: IterationState, uncertain: Array) -> SolutionAnalysis:
    """Analyse the final solution of an iteration; ``uncertain`` is the sigma of the fixed values."""
    joint, nothing = iteration.joint, np.zeros((N_PARAMETERS, N_PARAMETERS))
    if iteration.point is None or iteration.covariance is None or iteration.status == "outside_model":
        return SolutionAnalysis({"none": nothing}, nothing)
    try:
        solution = whole_solution(solver, iteration)
    except np.linalg.LinAlgError:
        return SolutionAnalysis({"none": nothing}, iteration.covariance)
    system = solution.system
    against = contradictions(joint, solution)
    table = deletion_table(joint, solution, against)
    if solver.weights():
        system = apply_weights(system, solver.weights())
        solution = BlockSolution(system)
    covariance = covariance_by_source(solution)
    covariance["held_values"] = _fixed_values(solution, uncertain, iteration.free)
    total = iteration.covariance + covariance["held_values"]
    by_unseen = _unseen_drift(joint, solution, iteration.unmodelled_drift)
    if by_unseen.any():
        part = covariance.setdefault("accel_bias_instability", nothing.copy())
        covariance["accel_bias_instability"] = part + by_unseen
        total = total + by_unseen
    by_latitude = _latitude(joint, solution)
    if by_latitude.any():
        covariance["latitude"] = np.outer(by_latitude, by_latitude)
        total = total + covariance["latitude"]
    # With "per-sequence" the scatter is no property of the unit; an instability as specified is in the solution.
    if joint.data.noise.gyro_flicker is None and joint.options.gyro_bias != "per-sequence":
        at = np.arange(N_PARAMETERS)[GROUP_SLICES["gyro_bias"]]
        part = covariance.setdefault("gyro_bias_instability", nothing.copy())
        # The bias of this test is one sample of the bias of the unit, which is reported.
        part[at, at] += joint.choice.bias_scatter**2
        total[at, at] += joint.choice.bias_scatter**2
    chi_square, freedom = goodness_of_fit(joint, solver, solution)
    by_noise = _with_sensor_noise(solver, iteration)
    fit = (chi_square, freedom) if by_noise is None else goodness_of_fit(joint, solver, by_noise)
    return SolutionAnalysis(
        covariance,
        total,
        residuals=residuals(joint, solution),
        table=table,
        chi_square=chi_square,
        degrees_of_freedom=freedom,
        sensor_noise_fit=fit,
        sequences=sequence_diagnostics(joint, solution, against),
        instability=_instability_by_sequence(joint, system, solution.delta),
        g_sensitivity_covariance=_g_sensitivity_covariance(joint, solution),
        scale_change=None if solver.weights() else scale_change(joint, by_noise or solution, fit[1]),
    )


def _instability_by_sequence(joint: JointModel, system: LinearSystem, delta: Array) -> Array:
    """Bias instability of the raw gyros in the windows of each sequence, minus its mean, shape (K, 3), rad/s."""
    compensated, K = system.compensated, joint.data.K
    drift = compensated.drift.get("gyro")
    if drift is None:
        return np.zeros((K, 3))
    x, u = (delta[system.columns[name]].reshape(K, -1) for name in ("gyro_drift", "gyro_drift_noise"))
    raw = np.linalg.solve(compensated.slopes.rate, drift.effect("rate", x, u)[:, :, None])[:, :, 0]
    own = joint.rest_rate_weights @ raw
    return np.asarray(own - own.mean(axis=0))


def _g_sensitivity_covariance(joint: JointModel, solution: BlockSolution) -> Array | None:
    if joint.choice.drift.force_axes is None:
        return None
    columns = solution.system.columns["drift_form"].start + np.r_[joint.choice.drift.of_force]
    combinations = np.zeros((len(solution.delta), 9))
    combinations[columns] = joint.choice.drift.g_sensitivity_map.T
    return np.asarray(combinations.T @ solution.with_columns(combinations))


def _g_sensitivity(iteration: IterationState, covariance: Array | None) -> tuple[GSensitivity | None, tuple[str, ...]]:
    """Estimated g-sensitivity of the gyros, and warnings."""
    joint = iteration.joint
    data, automatic = joint.data, joint.options.gyro_bias != G_SENSITIVE
    if iteration.point is None:
        return None, ()
    state, compensated = iteration.point.state, iteration.point.compensated
    rate = joint.rest_rate(state, compensated)
    if covariance is None:
        size = g_sensitivity_report.significant_g_sensitivity(data, compensated.force, rate, joint.choice.integrated)
        return None, g_sensitivity_report.warnings(None, size, automatic=automatic)
    rest = joint.rest_rates(state, rate)
    matrix = joint.choice.drift.g_sensitivity(iteration.state.drift)
    return (
        g_sensitivity_report.estimated_g_sensitivity(data, rest, matrix, covariance, joint.choice.bias_scatter),
        g_sensitivity_report.warnings(rest.poses.unobserved, None, automatic=automatic),
    )


def goodness_of_fit(joint: JointModel, solver: JointSolver, solution: BlockSolution) -> tuple[float, int]:
    """Chi-square of the residuals and its degrees of freedom."""
    residual, system = solution.residual, solution.system
    measured = np.ones(len(residual), dtype=np.bool_)
    prior_leverage = 0.0
    if solver.prior is not None:  # a prior takes a non-integer number of degrees of freedom
        prior = system.rows_of("prior").index.ravel()
        measured[prior] = False
        prior_leverage = float(np.sum(solution.rows_with_parameters[prior] * system.whitening["prior"][0]))
    chi_square = float(residual[measured] @ residual[measured])
    freedom = round(float(measured.sum()) - float(system.active.sum()) + prior_leverage)
    return chi_square, freedom - joint.choice.drift.freely_estimated


def _with_sensor_noise(solver: JointSolver, iteration: IterationState) -> BlockSolution | None:
    """Solution without unmodelled errors of the unit; None if there are none, or the system is singular."""
    unmodelled = iteration.joint.choice.unmodelled_sigma
    if not any(unmodelled.of_unit):
        return None
    assert iteration.point is not None
    whole = iteration.point.compensated
    force, rate, rotation = (
        {source: R for source, R in noise.items() if not source.endswith("excess")}
        for noise in (whole.force_noise, whole.rate_noise, whole.rotation_noise)
    )
    compensated = replace(whole, force_noise=force, rate_noise=rate, rotation_noise=rotation)
    own = iteration.joint.with_choice(unmodelled_sigma=unmodelled.of_fixture)
    system = linearise(own, iteration.point.state, compensated, iteration.free, solver.prior)
    try:
        return BlockSolution(system)
    except np.linalg.LinAlgError:
        return None


def whole_solution(solver: JointSolver, iteration: IterationState) -> BlockSolution:
    """Solution of all columns of the last linearised system, with the rows of the sensor errors' prior.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the active columns are linearly dependent.
    """
    point, prior = iteration.point, solver.prior
    assert point is not None
    if iteration.whole is not None and iteration.whole[0] is point and iteration.whole[1] is prior:
        return iteration.whole[2]
    complete = with_prior(point.system, point.joint, point.state, prior)
    iteration.whole = point, prior, BlockSolution(complete)
    return iteration.whole[2]


def accel_instability(joint: JointModel, solution: BlockSolution) -> tuple[float, float]:
    """Expected bias instability of the accelerometers, and the part of it that the weights lack, m/s²."""
    effect = accel_drift(joint.data, solution.system.compensated.slopes.force, np.ones(3))
    return joint.data.noise.expected_accel_instability(force_statistics(solution, [effect], 0)[0])


def force_statistics(solution: BlockSolution, effects: list[Array], freedom: int) -> list[Statistics]:
    """Statistics of groups of coefficients with ``effects`` on the specific forces of the windows, (W, 3, q) each."""
    rows = solution.system.rows_of("force").index.ravel()
    white = [(-solution.system.whitening["force"] @ effect).reshape(len(rows), -1) for effect in effects]
    return _statistics(solution, rows, white, freedom)


def _statistics(solution: BlockSolution, rows: Indices, effects: list[Array], freedom: int) -> list[Statistics]:
    """Statistics of groups of coefficients whose ``effects`` on some rows, whitened, are (rows, q) each."""
    if not effects:
        return []
    residual, white = solution.residual, np.concatenate(effects, axis=1)
    by_columns = np.asarray(solution.system.A[rows].T @ white)
    information = white.T @ white - by_columns.T @ solution.with_columns(by_columns)
    gradient, square = white.T @ residual[rows], float(residual @ residual)
    ends = np.cumsum([0, *(effect.shape[1] for effect in effects)]).tolist()
    at = [slice(a, b) for a, b in pairwise(ends)]
    return [Statistics(gradient[own], information[own, own], square, freedom) for own in at]


def scale_change(joint: JointModel, solution: BlockSolution, freedom: int) -> ScaleChange | None:
    """Change of scale factors within the recording that explains the residuals best."""
    system, data = solution.system, joint.data
    owner = np.full(len(system.b), -1, dtype=np.intp)
    for rows in system.rows:
        owner[rows.index] = rows.owner[:, None]
    effects = scale_effects(-system.A[:, system.columns["errors"]].toarray(), owner, joint.order)
    found = _statistics(solution, np.arange(len(owner)), list(effects.values()), freedom)
    titles = [data.ids[k] for k in joint.order.tolist()]
    return most_likely_change(dict(zip(effects, found, strict=True)), joint.times[joint.order], titles)


def _unseen_drift(joint: JointModel, solution: BlockSolution, found: DriftSearch) -> Array:
    """Covariance of the parameters by drift of the accelerometers that is not modelled, shape (27, 27).

    It is the expected bias instability beyond that of the weights, and a possible linear drift.
    """
    system, data = solution.system, joint.data
    slope = system.compensated.slopes.force
    sources = []
    if data.noise.accel_unseen.any():
        sources.append(accel_drift(data, slope, np.full(3, accel_instability(joint, solution)[1])))
    if found.possible > 0.0:
        sources.append(by_drift(slope * found.possible, data.drift_shapes[LINEAR].windows))
    if not sources:
        return np.zeros((N_PARAMETERS, N_PARAMETERS))
    effect = system.whitening["force"] @ np.concatenate(sources, axis=2)
    rows = system.rows_of("force").index
    root = np.einsum("wap,was->ps", solution.rows_with_parameters[rows], effect)
    return np.asarray(root @ root.T)


def _latitude(joint: JointModel, solution: BlockSolution) -> Array:
    """Effect on the parameters of one sigma of the latitude, which counts as known, shape (27,)."""
    system, recording = solution.system, joint.data.recording
    error = np.concatenate([latitude_error(recording, placed=frame.fixture) for frame in joint.level_frames])
    effect = np.zeros(len(system.b))
    for group in system.rows if error.any() else ():
        if not group.kind.startswith("earth_rate"):  # the prior of its unknown part
            rows = group.index.ravel()
            effect[rows] = system.A[rows][:, system.columns.of("earth_rate")] @ error
    return np.asarray(-solution.rows_with_parameters.T @ effect)


def _fixed_values(solution: BlockSolution, uncertain: Array, free: Mask) -> Array:
    """Covariance (27, 27) of the estimated parameters due to errors of the fixed values with sigma ``uncertain``."""
    system = solution.system
    E = system.columns.parameter_map()
    effect = system.A @ E.T * np.where(free, 0.0, uncertain)
    bias = system.columns["bias"]
    # The map averages the biases, but a fixed bias has the same error in every sequence.
    effect[:, N_ERRORS:] *= (bias.stop - bias.start) // 3
    root = solution.rows_with_parameters.T @ effect
    return np.asarray(root @ root.T)
