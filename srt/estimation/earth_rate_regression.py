"""Unknown part of the Earth rate (no heading or no latitude) from the rates of the windows at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.measurement_covariance import Disturbance, project
from srt.estimation.rest_rate_scatter import window_rate_variance
from srt.estimation.unknown_earth_rate import unknown_earth_rate_components, unknown_earth_rate_draws
from srt.model import measurement_model as model
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class EarthRateRegression:
    """Linear estimate ε = G (rates at rest) of the unknown Earth rate in units of its prior sigma, with prior N(0, 1).

    Attributes
    ----------
    rate : ndarray, shape (K, 3, S), rad/s
        Unknown Earth rate per unit draw, in each B_Strt.
    on_rest_rate : ndarray, shape (W, 3, S), rad/s
        The same in each window, in B, less the g-sensitivity that it causes.
    on_phi : ndarray, shape (K, 3, S), rad
        Effect on φ in B_Strt, that of this g-sensitivity included.
    gain : ndarray, shape (S, W, 3), s/rad
    sigma : ndarray, shape (S,)
        Standard deviation of the estimate by the noise of the rates, in units of the prior sigma.
    components : int
        Unknown components, 2 or 3, of each of the S / components independent Earth-fixed frames.
    draws : ndarray, shape (S,)
        The estimate.
    by_errors : ndarray, shape (S, 27)
        Derivative of the estimate with respect to the remaining sensor errors.
    """

    rate: Array
    on_rest_rate: Array
    on_phi: Array
    gain: Array
    sigma: Array
    components: int
    draws: Array
    by_errors: Array

    def fit(self, rest_rate: Array) -> Array:
        """Estimates, shape (S, n), from rates at rest, shape (W, 3, n), rad/s."""
        return np.asarray(np.einsum("swa,wan->sn", self.gain, rest_rate))

    def after(self, rate: Array) -> tuple[Array, Array]:
        """Disturbances of the rates at rest less their fit, shape (W, 3, n), and the effect on φ, shape (K, 3, n)."""
        draws = self.fit(rate)
        return rate - self.on_rest_rate @ draws, -self.on_phi @ draws

    def after_correction(self, correction: Array) -> Array:
        """Estimate after a correction of the sensor errors, shape (S,), no larger than the Earth rate itself.

        With n components, a unit draw is 1/√n of the Earth rate.
        """
        parts = (self.draws - self.by_errors @ correction).reshape(-1, self.components)
        size = np.maximum(np.linalg.norm(parts, axis=1, keepdims=True), 1e-300)
        return np.asarray((parts * np.minimum(1.0, np.sqrt(self.components) / size)).ravel())


def earth_rate_regression(
    rate: Array, on_rest_rate: Array, on_phi: Array, sigma: Array, components: int
) -> EarthRateRegression:
    """Regression of the rates at rest on a common bias and the unknown Earth rate.

    Parameters
    ----------
    rate, on_rest_rate, on_phi : ndarray, shape (K, 3, S), (W, 3, S) and (K, 3, S)
    sigma : ndarray, shape (W, 3), rad/s
        1-sigma of the rate of each window: noise and bias variation.
    components : int
    """
    W, S = len(sigma), rate.shape[2]
    bias = np.broadcast_to(np.eye(3), (W, 3, 3))
    # Biases in units of the smallest sigma, for the condition number.
    A = np.concatenate([bias * sigma.min(), on_rest_rate], axis=2) / sigma[:, :, None]
    A = A.reshape(3 * W, 3 + S)
    prior = np.diag(np.concatenate([np.zeros(3), np.ones(S)]))
    P = np.linalg.inv(A.T @ A + prior)[3:]
    gain = (P @ A.T).reshape(S, W, 3) / sigma
    own = np.sqrt(np.diag(P[:, 3:]))
    none, fixed = np.zeros(S), np.zeros((S, N_PARAMETERS))
    return EarthRateRegression(rate, on_rest_rate, on_phi, gain, own, components, none, fixed)


def with_earth_rate_regression(
    measurements: SrtMeasurements, data: PreparedRecording, wander: Array, bias_gain: Array, draws: Array | None
) -> SrtMeasurements:
    """Measurements with the unknown Earth rate estimated from the rates at rest and removed.

    Without a heading, the horizontal part of the Earth rate is unknown; without a latitude, all three components are.
    The effect on z is not linear: over a long recording the second order is many sigma of a navigation-grade unit. The
    unknown part is therefore estimated from the rates of the windows and removed before z is formed, as g-sensitivity
    is. The Jacobian and the covariance include this estimate.

    Parameters
    ----------
    measurements, data : SrtMeasurements, PreparedRecording
    wander : ndarray, shape (3,), rad/s
        1-sigma of the bias between sequences, compensated.
    bias_gain : ndarray, shape (3,)
        As in :func:`srt.estimation.measurement_covariance.project`.
    draws : ndarray, shape (S,), or None
        Estimate with which the data were processed; the new estimate replaces it to first order.
    """
    n = unknown_earth_rate_components(data)
    if not n:
        return measurements
    rate = unknown_earth_rate_draws(measurements, data)
    raw = np.einsum("wab,was->wbs", measurements.window_attitude, rate[measurements.window_sequence])
    # The rates at rest are those after their regression on specific force: both regressions together are one.
    seen, by_g_sensitivity = measurements.after_g_sensitivity(raw)
    phi = measurements.integrals.weight_s[:, None, None] * rate
    sigma = np.sqrt(window_rate_variance(measurements, data) + wander**2)
    regression = earth_rate_regression(rate, seen, phi + by_g_sensitivity, sigma, n)
    on_z = project(measurements, data, Disturbance(phi=phi, rate=raw), bias_gain)
    by_errors = regression.fit(model.rate_error_jacobian(measurements.rate, measurements.gyro))
    used = np.zeros(rate.shape[2]) if draws is None else draws
    present = regression.fit((measurements.rest_rate + seen @ used)[:, :, None])[:, 0]
    return replace(
        measurements,
        z=measurements.z - on_z @ (present - used),
        H=measurements.H - on_z @ by_errors,
        rest_rate=measurements.rest_rate - raw @ (present - used),
        earth_rate_regression=replace(regression, draws=present, by_errors=by_errors),
    )
