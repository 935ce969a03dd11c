"""Search for a bias drift in the residuals of a solution, and its estimated size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from srt.estimation import measurement_covariance
from srt.estimation.drift_model import DriftEstimate, DriftTerm, candidates, change, select

if TYPE_CHECKING:
    from srt.estimation.iteration import Solution
    from srt.estimation.options import Options
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


def search(data: PreparedRecording, options: Options, solution: Solution, fixed: Mask) -> DriftTerm | None:
    """Most significant form of drift that a solution does not model; None if there is none.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    solution : Solution
    fixed : ndarray of bool, shape (27,)
        Parameters that are not estimated.
    """
    measurements = solution.measurements
    if measurements.integrals.time_parts is None:
        return None
    keys = candidates(data, solution.excess.drift)
    accel = {key: _effect(data, options, solution, *key) for key in keys if key[0] == "accel"}
    rest, noise = measurements.rest_rate, _rest_noise(data, solution)
    taken = [data.drift_shapes[term.form].windows for term in solution.excess.drift if term.sensor == "gyro"]
    constant = np.concatenate([np.ones((len(rest), 1)), *taken], axis=1)
    gyro = {key: _on_rates(data, key[1]) for key in keys if key[0] == "gyro"}
    try:
        found = [
            select(measurements.z, measurements.H[:, ~fixed], solution.measurement_covariance, accel, len(keys)),
            select(rest.ravel(), np.kron(constant, np.eye(3)), noise, gyro, len(keys)),
        ]
    except np.linalg.LinAlgError:  # far outside the model the covariance is not positive definite
        return None
    return min((term for term in found if term is not None), key=lambda term: term[1], default=(None, 1.0))[0]


def _on_rates(data: PreparedRecording, form: str) -> Array:
    """Effect of the unit coefficients of a form on the rates of all windows, shape (3 W, 3 q)."""
    return np.asarray(np.kron(data.drift_shapes[form].windows, np.eye(3)), dtype=np.float64)


def _rest_noise(data: PreparedRecording, solution: Solution) -> Array:
    """Covariance of the rest rates of all windows, shape (3 W, 3 W), of the noise and bias instability as specified."""
    measurements = solution.measurements
    variance = measurement_covariance.window_rate_variance(measurements, data)
    variance = variance + measurement_covariance.earth_rate_sigma(data) ** 2
    # Windows with integrated attitude do not show the rate at rest.
    variance[measurements.integrated] = 1.0
    out = np.diag(variance.ravel())
    if data.noise.gyro_flicker is not None:
        slope = np.asarray(np.linalg.inv(measurements.gyro.matrix), dtype=np.float64)
        own = measurement_covariance.gyro_drift(data, measurements.integrals, slope).rate
        assert own is not None
        root = own.reshape(len(out), -1)
        out = out + root @ root.T
    return out


def estimates(
    data: PreparedRecording, options: Options, solution: Solution, fixed: Mask, unmodelled: DriftTerm | None = None
) -> tuple[DriftEstimate, ...]:
    """Estimated drift of the terms of a solution, and of one that it does not model."""
    terms = [*solution.excess.drift, *([] if unmodelled is None else [unmodelled])]
    if not terms:
        return ()
    gyro = _gyro_coefficients(data, solution, [term for term in terms if term.sensor == "gyro"])
    R, z, H = solution.measurement_covariance, solution.measurements.z, solution.measurements.H[:, ~fixed]
    effects = [_effect(data, options, solution, term.sensor, term.form) for term in terms]
    if unmodelled is not None:
        R = R + unmodelled.sigma**2 * effects[-1] @ effects[-1].T
    scale = 1.0 / np.sqrt(np.diag(R))
    factor = cho_factor(R * np.outer(scale, scale), lower=True)
    H, unit = H * scale[:, None], np.linalg.norm(H * scale[:, None], axis=0)
    H = H[:, unit > 0.0] / unit[unit > 0.0]
    weighted = cho_solve(factor, np.column_stack([H, z * scale]))
    x = np.linalg.solve(H.T @ weighted[:, :-1], H.T @ weighted[:, -1])
    left = (weighted[:, -1] - weighted[:, :-1] @ x) * scale
    out = []
    for term, effect in zip(terms, effects, strict=True):
        coefficients = (term.sigma**2 * effect.T @ left).reshape(-1, 3)
        if term.sensor == "gyro":
            coefficients = gyro[term.form]
        size = change(term.form, coefficients, data.drift_shapes[term.form].windows)
        out.append(DriftEstimate(term.sensor, term.form, size, modelled=term is not unmodelled))
    return tuple(out)


def _gyro_coefficients(data: PreparedRecording, solution: Solution, terms: list[DriftTerm]) -> dict[str, Array]:
    """Coefficients (q, 3) of the gyros' forms from the rest rates, rad/s; the rotations are far less sensitive."""
    shapes = [data.drift_shapes[term.form].windows for term in terms]
    constant = np.ones((len(solution.measurements.rest_rate), 1))
    weight = np.sqrt(solution.measurements.pool)[:, None]
    A = np.concatenate([constant, *shapes], axis=1)
    found = np.linalg.lstsq(weight * A, weight * solution.measurements.rest_rate)[0]
    ends = np.cumsum([1, *(shape.shape[1] for shape in shapes)])
    return {term.form: found[a:b] for term, a, b in zip(terms, ends[:-1], ends[1:], strict=True)}


def used_bias_gain(data: PreparedRecording, options: Options, solution: Solution) -> Array:
    """Share of a sequence's own rest rate that was used as its bias, shape (3,)."""
    if solution.excess.drifting("gyro"):
        return np.ones(3)
    compensated = np.sqrt(np.linalg.inv(solution.measurements.gyro.matrix) ** 2 @ solution.wander**2)
    return measurement_covariance.bias_gain(solution.measurements, data, options.gyro_bias, compensated)


def _effect(data: PreparedRecording, options: Options, solution: Solution, sensor: str, form: str) -> Array:
    """Effect of the unit coefficients of a form on the measurements, shape (n_z, 3 q)."""
    draws = measurement_covariance.drift_form(solution.measurements, data, sensor, form)
    return measurement_covariance.project(solution.measurements, data, draws, used_bias_gain(data, options, solution))
