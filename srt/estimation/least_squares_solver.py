"""Least-squares solver: weighted least squares on the shared measurement model, for any manoeuvres.

All measurements z of all sequences have the weight R⁻¹ of their full covariance, shared terms included. One iteration
solves ``δ = (Hᵀ R⁻¹ H)⁻¹ Hᵀ R⁻¹ z`` for the free parameters. Parameters that the recording does not determine are
fixed and reported. If the residuals are larger than the sensor noise explains, an unmodelled rotation error and an
unmodelled specific-force error are estimated from them by restricted maximum likelihood and added to R; a misfit that
remains multiplies all sigmas by ``√(chi-square / degrees of freedom)`` (Birge ratio).

Leave-one-out removes the rows of a sequence from the information matrix. The measurements z are split into u (the rows
of horizontal and down components) and the pooled rate p. The information is ``I(u) + I(p | u)``, so the inverse of R
is computed once, for u.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from srt.estimation import measurement_covariance
from srt.estimation.calibration_builder import build_calibration
from srt.estimation.drift_search import used_bias_gain
from srt.estimation.fixed_parameters import (
    fixed_sigma,
    reason_not_observed,
    reason_on_request,
    seen_by_earth_rate_alone,
)
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.iteration import iterate
from srt.estimation.leave_one_out import LeaveOneOutEstimate, leave_one_out_estimate, pooling_weights_without
from srt.estimation.move_checks import contradicting_move_of_solution, without_gross_moves
from srt.estimation.observability import OBSERVED_BELOW, admission_sigma, admit
from srt.estimation.solver_result import solver_result
from srt.estimation.unmodelled_errors import iterate_with_unmodelled_errors
from srt.model import measurement_model as model
from srt.model.table1 import SEQUENCES
from srt.sensor_errors import N_PARAMETERS, NAMES
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.moves import recorded_moves
from srt.sequences.stationary_windows import find_turns

if TYPE_CHECKING:
    from srt.estimation.iteration import Solution
    from srt.estimation.leave_one_out import SequenceRows
    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


_ROUNDS: Final = 3
"""Largest number of rounds that select anew which parameters are fixed."""


class LeastSquaresSolver:
    """Weighted least squares for the parameters that the recording determines.

    Parameters
    ----------
    requested : tuple of str
        Parameters fixed on request.
    prior : ndarray, shape (27,)
        1-sigma before the recording; a parameter is estimated if the data reduce it to a third.
    considered : ndarray, shape (27,), optional
        1-sigma of fixed values, which the weights of the measurements then include.
    """

    coefficients = None
    estimates_earth_rate = True

    def __init__(self, requested: tuple[str, ...], prior: Array, considered: Array | None = None) -> None:
        self.requested = np.array([n in requested for n in NAMES])
        self.fixed = self.requested.copy()
        self._prior, self._considered = prior, considered
        self._selected = False

    def gain(self, measurements: SrtMeasurements, covariance: Array, *, near: bool) -> Array:
        """Gain G of δ = G z; the first iterations use the prior for parameters that the data do not determine."""
        scale, L, A = self._whitened(measurements.H, covariance)
        if near and not self._selected:
            self.fixed = self.requested | ~admit(A, ~self.requested)
        if near and self._considered is not None:
            while True:
                by_fixed = measurements.H * np.where(self.fixed, self._considered, 0.0)
                scale, L, A = self._whitened(measurements.H, covariance + by_fixed @ by_fixed.T)
                fixed = self.fixed | ~admit(A, ~self.fixed)
                if self._selected or np.array_equal(fixed, self.fixed):
                    break
                self.fixed = fixed
        self._selected |= near
        free = np.flatnonzero(~self.fixed)
        normal = A[:, free].T @ A[:, free]
        if not near:
            normal = normal + np.eye(len(free))
        weighted = solve_triangular(L, A[:, free], lower=True, trans="T").T * scale
        G = np.zeros((N_PARAMETERS, len(scale)))
        # Each parameter in units of its conditional sigma, for the condition number.
        d = 1.0 / np.sqrt(np.diag(normal))
        G[free] = (self._prior[free] * d)[:, None] * cho_solve(
            cho_factor(normal * np.outer(d, d), lower=True), d[:, None] * weighted
        )
        return G

    def _whitened(self, H: Array, R: Array) -> tuple[Array, Array, Array]:
        """Scale of the measurements, root of their scaled covariance, and whitened Jacobian in units of the prior."""
        scale = 1.0 / np.sqrt(np.diag(R))
        L = cho_factor(R * np.outer(scale, scale), lower=True)[0]
        return scale, L, solve_triangular(L, H * scale[:, None] * self._prior, lower=True)


def estimate(recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
    """Calibrate by iterated weighted least squares on all measurements.

    Raises
    ------
    DataError
        If no rotation between two stationary windows is found, or readings are impossible.
    """
    options.refuse(("step", "loss", "filter", "prior", "fixture_states", "live", "targets"), "Least squares")
    labels = recording.sequences or find_turns(recording)
    moves = () if options.ignore_moves else recorded_moves(recording, labels)
    data = prepare_checked(recording, labels, options.average, moves=moves)
    first = initial_estimate(data, options)
    data = _with_sound_moves(without_gross_moves(data, options, first), options, first)
    uncertain = fixed_sigma(data, options)
    on_request = {n: reason_on_request(n, uncertain, data) for n in options.fixed_names}
    on_request = seen_by_earth_rate_alone(data) | on_request
    fixed, prior, relied = dict(on_request), admission_sigma(), None
    for _ in range(_ROUNDS + 1):
        requested = tuple(fixed)
        fitted = iterate_with_unmodelled_errors(
            data,
            options,
            partial(LeastSquaresSolver, requested, prior, relied),
            first,
            uncertain,
            progress,
            models_drift=True,
        )
        used, solution, solver = fitted.data, fitted.solution, fitted.solver
        sigma = np.sqrt(np.diag(np.asarray(sum(solution.covariance.values()))))
        weak = ~solver.fixed & (sigma > OBSERVED_BELOW * prior)
        vague = ~solver.fixed & (sigma > np.where(uncertain > 0.0, uncertain, np.inf))
        insufficient = vague.any() or solver.fixed.sum() > len(on_request) or solution.status != "converged"
        if relied is None and insufficient and _relies_on_fixture(data):
            # The test does not determine all parameters: what the nominal angles of the fixture give more accurately
            # keeps their value, and the weights include the uncertainty of what is kept.
            prior, relied = np.where(uncertain > 0.0, np.minimum(prior, uncertain), prior), uncertain
            continue
        for n, is_fixed, is_weak in zip(NAMES, solver.fixed, weak, strict=True):
            if (is_fixed or is_weak) and n not in fixed:
                fixed[n] = reason_not_observed(n)
        if not weak.any():
            break
    leave_one_out = partial(without_sequences, considered=relied is not None)
    result = solver_result(fitted, options, fixed, leave_one_out)
    return build_calibration("least-squares", used, options, result, fixed)


def _relies_on_fixture(data: PreparedRecording) -> bool:
    """Return True for a test on a fixture that is neither Table 1 nor poses alone, which measure the directions."""
    return data.nominal is not None and not data.posed.all() and not set(SEQUENCES) <= set(data.ids)


def _with_sound_moves(
    data: PreparedRecording, options: Options, first: tuple[SensorErrors, Array]
) -> PreparedRecording:
    """Recording without the moves that contradict the other measurements, one after the other."""
    uncertain = fixed_sigma(data, options)
    while data.moves:
        solver = LeastSquaresSolver(options.fixed_names, admission_sigma())
        solution = iterate(data, options, solver, *first, fixed_sigma=uncertain)
        reasons = contradicting_move_of_solution(data, solution, solver.fixed)
        if not reasons:
            break
        data = data.without_moves(reasons)
    return data


def without_sequences(
    data: PreparedRecording,
    options: Options,
    solution: Solution,
    rows_by_sequence: list[SequenceRows],
    *,
    considered: bool = False,
) -> list[LeaveOneOutEstimate]:
    """Weighted least squares without each sequence (see the module docstring).

    ``considered``: the weights include the uncertainty of fixed parameters.
    """
    measurements, n = solution.measurements, len(solution.measurements.z)
    estimated = np.asarray(solution.gain.any(axis=1), dtype=np.bool_)
    # The weights are R⁻¹ of the noise alone, unless fixed parameters are considered; their variance was added after it.
    by_fixed = measurements.H * np.where(estimated | considered, 0.0, fixed_sigma(data, options))
    noise = solution.measurement_covariance - by_fixed @ by_fixed.T
    sigma = np.sqrt(np.maximum(np.diag(solution.gain @ noise @ solution.gain.T), 0.0))
    unit = np.where(estimated, sigma, 0.0)
    back = np.divide(1.0, unit, out=np.zeros_like(unit), where=unit > 0.0)
    # The last pool omits no sequence: it gives the estimate from all sequences.
    pools = np.concatenate([pooling_weights_without(data, solution, rows_by_sequence), measurements.pool[None]])
    gain = used_bias_gain(data, options, solution)
    with_u, own = _pooled_noise(data, solution, gain, pools)
    rates = measurements.rest_rate
    H_pools = np.einsum("kw,wap->kap", pools, model.rate_error_jacobian(measurements.rate, measurements.gyro)) * unit
    z_pools = measurements.z[n - 3 :] + (pools - measurements.pool) @ rates
    pooled = np.concatenate([H_pools, z_pools[:, :, None]], axis=2)
    # Each sequence's full bias is subtracted here, not its deviation from the pooled bias. The estimates are the same,
    # and the pooled rate stays in separate rows.
    T = np.eye(n)[: n - 3]
    T[: 2 * data.K, n - 3 :] = -_offset_effect(data, solution, gain)
    R = T @ noise @ T.T
    scale = 1.0 / np.sqrt(np.diag(R))
    A = np.linalg.inv(R * np.outer(scale, scale)) * np.outer(scale, scale)
    X = np.concatenate([T @ measurements.H * unit, (T @ measurements.z)[:, None], T @ with_u], axis=1)
    AX = A @ X
    F = X.T @ AX
    found = []
    for k, D in enumerate([rows for rows, _ in rows_by_sequence] + [np.array([], dtype=np.intp)]):
        at = np.concatenate([np.arange(N_PARAMETERS + 1), N_PARAMETERS + 1 + 3 * k + np.arange(3)])
        block = AX[np.ix_(D, at)]
        left = F[np.ix_(at, at)] - block.T @ np.linalg.solve(A[np.ix_(D, D)], block)
        seen, cross = left[:-3, :-3], left[-3:, :-3]
        if pools[k].any():
            innovation = pooled[k] - cross
            seen = seen + innovation.T @ np.linalg.solve(own[k] - left[-3:, -3:], innovation)
        found.append(((seen[:-1, :-1] * np.outer(back, back)), seen[:-1, -1] * back))
    full = found[-1][0]
    return [leave_one_out_estimate(np.stack([full, N]), g, estimated) for N, g in found[:-1]]


def _offset_effect(data: PreparedRecording, solution: Solution, gain: Array) -> Array:
    """Effect of the pooled rate on the horizontal components via the bias deviations (own − pooled), shape (2 K, 3)."""
    measurements = solution.measurements
    per_rate = measurements.integrals.time @ measurements.gyro.matrix
    return np.asarray((measurements.attitude_effect @ per_rate * gain).reshape(2 * data.K, 3))


def _pooled_noise(data: PreparedRecording, solution: Solution, gain: Array, pools: Array) -> tuple[Array, Array]:
    """Cross-covariance of z with P pooled rates, (n_z, 3 P), and covariance of each pooled rate, (P, 3, 3)."""
    measurements = solution.measurements
    with_z = np.zeros((len(measurements.z), 3 * len(pools)))
    own = np.zeros((len(pools), 3, 3))
    for source in measurement_covariance.disturbances(measurements, data, solution.wander, solution.excess).values():
        if source.rate is not None:
            pooled = np.tensordot(pools, measurements.after_g_sensitivity(source.rate)[0], 1)
            with_z += (
                measurement_covariance.project(measurements, data, source, gain) @ pooled.reshape(3 * len(pools), -1).T
            )
            own += pooled @ np.swapaxes(pooled, 1, 2)
    return with_z, own
