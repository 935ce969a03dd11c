"""Solver result: the common form in which every estimator hands over its solution."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.estimation import g_sensitivity_report, measurement_covariance
from srt.estimation.drift_search import estimates, possible_drift_covariance
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.estimation.g_sensitivity import RestRates
from srt.estimation.goodness_of_fit import chi_square, is_misfit
from srt.estimation.leave_one_out import second_order_variance, sequence_diagnostics
from srt.estimation.unmodelled_errors import fit_to_sensor_noise
from srt.result.calibration import Residual
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.estimation.drift_model import DriftEstimate
    from srt.estimation.error_sources import UnmodelledErrors
    from srt.estimation.iteration import Solution
    from srt.estimation.leave_one_out import LeaveOneOutEstimator, SequenceDiagnostics
    from srt.estimation.options import Options
    from srt.estimation.unmodelled_errors import Fitted
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


_SOLVED_EXACTLY: Final = 1e-6
"""Residual sigma over measurement sigma below which a component is solved exactly and its residual sigma is zero."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SolverResult:
    """Solution of an estimator, complete enough to build a calibration.

    Attributes
    ----------
    errors : SensorErrors
    U : ndarray, shape (3, 3)
        T to MARS components; ignored without a fixture.
    covariance : mapping of str to ndarray, shape (27, 27)
        By source of error.
    corrections : tuple of float
        Largest correction of each iteration.
    status, message : str
    residuals : tuple of Residual
    chi_square : float
        Smallest weighted square sum of the residuals.
    degrees_of_freedom : int
    sensor_noise_fit : tuple of float and int
        Chi-square and degrees of freedom with the noise of the sensors alone.
    unmodelled : UnmodelledErrors
        Unmodelled errors that were added to the noise.
    integrated : tuple of int
        Windows whose attitude was integrated.
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test (sensor axes).
    bias_by_sequence : ndarray, shape (K, 3), rad/s
    end_attitude : ndarray, shape (K, 3, 3)
        C_End of every sequence as the gyros measured it.
    total : ndarray, shape (27, 27), optional
        Covariance as the estimator itself computes it; default the sum over the sources.
    diagnostics : mapping
        Further output of the estimator, as JSON values.
    sequences : tuple of SequenceDiagnostics
        Leave-one-out diagnostics of every sequence, where the estimator computes them.
    drift : tuple of DriftEstimate
        Bias drift within the recording that the residuals show.
    notes : tuple of str
        Warnings on effects beyond the 27 errors, for a usable result.
    """

    errors: SensorErrors
    U: Array
    covariance: Mapping[str, Array]
    corrections: tuple[float, ...]
    status: str
    message: str
    residuals: tuple[Residual, ...]
    chi_square: float
    degrees_of_freedom: int
    sensor_noise_fit: tuple[float, int]
    unmodelled: UnmodelledErrors
    integrated: tuple[int, ...]
    wander: Array
    bias_by_sequence: Array
    end_attitude: Array
    total: Array | None = None
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    sequences: tuple[SequenceDiagnostics, ...] = ()
    drift: tuple[DriftEstimate, ...] = ()
    notes: tuple[str, ...] = ()


def solver_result(
    fitted: Fitted, options: Options, fixed_reasons: Mapping[str, str], leave_one_out: LeaveOneOutEstimator
) -> SolverResult:
    """Solver result of an iterated solution.

    Parameters
    ----------
    fitted : Fitted
    options : Options
    fixed_reasons : mapping of str to str
        Parameters not observed, with the reason.
    leave_one_out : LeaveOneOutEstimator
        Leave-one-out estimator of the solver.
    """
    data, solution, unmodelled = fitted.data, fitted.solution, fitted.unmodelled
    fixed = np.array([name in fixed_reasons for name in NAMES])
    statistic, freedom = chi_square(solution, fixed)
    if is_misfit(statistic, freedom):
        R = solution.measurement_covariance
        with_squares = chi_square(solution, fixed, R + np.diag(second_order_variance(data, len(R))))[0]
        statistic = statistic if is_misfit(with_squares, freedom) else with_squares
    outside = solution.status == "outside_model"
    drift: tuple[DriftEstimate, ...] = ()
    if solution.status == "converged":
        drift = estimates(data, options, solution, fixed, fitted.unmodelled_drift.terms)
    covariance = dict(solution.covariance)
    covariance["accel_bias_instability"] = covariance["accel_bias_instability"] + possible_drift_covariance(
        data, options, solution, fitted.unmodelled_drift
    )
    diagnostics, notes = _g_sensitivity(data, solution, automatic=options.gyro_bias != G_SENSITIVE)
    if drift:
        diagnostics = {**diagnostics, "drift": [term.as_dict() for term in drift]}
    diagnostics = {**diagnostics, **fitted.unmodelled_drift.diagnostics()}
    return SolverResult(
        errors=solution.errors,
        U=solution.U,
        covariance=covariance,
        corrections=solution.corrections,
        status=solution.status,
        message=solution.message,
        residuals=_residuals(data, solution),
        chi_square=statistic,
        degrees_of_freedom=freedom,
        sensor_noise_fit=fit_to_sensor_noise(solution, data, fixed, unmodelled)
        if any(unmodelled)
        else (statistic, freedom),
        unmodelled=unmodelled,
        integrated=solution.integrated,
        wander=solution.wander,
        bias_by_sequence=solution.bias_by_sequence,
        end_attitude=solution.measurements.integrals.C_end,
        diagnostics=diagnostics,
        drift=drift,
        sequences=() if outside else sequence_diagnostics(leave_one_out, data, options, solution, fixed),
        notes=notes,
    )


def _g_sensitivity(
    data: PreparedRecording, solution: Solution, *, automatic: bool
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Diagnostics of the g-sensitivity of the gyros, and warnings."""
    m = solution.measurements
    if m.poses is None:
        size = g_sensitivity_report.significant_g_sensitivity(data, m.force, m.rest_rate, m.integrated)
        return {}, g_sensitivity_report.warnings(None, size, automatic=automatic)
    rest = RestRates(m.poses, m.force, m.rest_rate, m.pool, m.window_sequence, m.gyro)
    by_source = measurement_covariance.disturbances(m, data, solution.wander).values()
    disturbed = np.concatenate([source.rate for source in by_source if source.rate is not None], axis=2)
    by_draw = np.einsum("ab,bcs->acs", m.gyro.matrix, m.poses.fit(disturbed)).reshape(9, -1)
    found = g_sensitivity_report.diagnostics(data, rest, solution.g_sensitivity, by_draw @ by_draw.T, solution.wander)
    return found, g_sensitivity_report.warnings(m.poses.unobserved, None, automatic=automatic)


def _residuals(data: PreparedRecording, solution: Solution) -> tuple[Residual, ...]:
    """Residuals after the last iteration with their predicted sigma, zero where a component is solved exactly."""
    z, sigma = solution.measurements.z, np.sqrt(np.maximum(np.diag(solution.residual_covariance), 0.0))
    measurement_sigma = np.sqrt(np.diag(solution.measurement_covariance))
    sigma[sigma < _SOLVED_EXACTLY * measurement_sigma] = 0.0
    rows = []
    for k, name in enumerate(data.ids):
        sequence = data.catalogue[k]
        horizontal = ("1", "2") if sequence is None else sequence.horizontal
        for j, axis in enumerate(horizontal):
            rows.append((name, data.occurrences[k], f"horizontal_{axis}", 2 * k + j))
        for label, w in (("start_down", data.start[k]), ("end_down", data.end[k])):
            rows.append((name, data.occurrences[k], label, 2 * data.K + int(w)))
    return tuple(Residual(n, o, c, float(z[i]), float(sigma[i])) for n, o, c, i in rows)
