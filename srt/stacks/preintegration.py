"""Preintegrated readings with their derivatives with respect to the 27 sensor errors.

Between two keyframes the corrected readings are summed in the body axes of the first one (R_k the attitude before
sample k, R_mid that in its middle, φ, V, P the rotation, velocity and position)::

    R_{k+1} = R_k Exp(ω_k dt)      V_{k+1} = V_k + R_mid f_k dt      P_{k+1} = P_k + V_k dt + R_mid f_k dt²/2

A small change of the rate and force of sample i changes the sums by G_i, shape (9, 6): by the rotation it leaves at the
end, and by what that rotation does to all later forces. Then ``J = Σ G_i ∂(ω, f)_i/∂e`` for the errors e, and
``Σ G_i Q_i G_iᵀ`` is the covariance by white noise. Attitudes are products of rotations on the manifold, as in gtsam's
Manifold variant; the attitude in the middle of a sample keeps sculling errors of second order in dt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srt.exceptions import InputError
from srt.model import rotations
from srt.model.measurement_model import force_error_jacobian, rate_error_jacobian
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.noise.stated_figures import white_density
from srt.result.applier import Applier

if TYPE_CHECKING:
    from srt.model.rotations import Quaternions
    from srt.result.calibration import Calibration
    from srt.sensor_errors import SensorErrors
    from srt.types import Array

ROTATION, VELOCITY, POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
"""Places in the residual, the Jacobian and the covariance."""


@dataclass(frozen=True, slots=True, eq=False)
class PreintegratedReadings:
    """Sums of corrected readings over one interval, at the errors e₀ of linearisation.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        From the body axes at the end to those at the start.
    velocity, position : ndarray, shape (3,), m/s and m
        Without gravity, body axes at the start.
    jacobian : ndarray, shape (9, 27)
        Derivative with respect to the errors: rotation vector (right), velocity, position.
    covariance : ndarray, shape (9, 9)
        By the white noise of the readings, in the same order.
    errors : SensorErrors
        e₀.
    """

    rotation: Array
    velocity: Array
    position: Array
    jacobian: Array
    covariance: Array
    duration_s: float
    errors: SensorErrors


def preintegrate(
    calibration: Calibration, gyro: Array, accel: Array, dt: float, *, errors: SensorErrors | None = None
) -> PreintegratedReadings:
    """Sum uncorrected readings over one interval.

    Parameters
    ----------
    calibration : Calibration
        Gives the white noise, the g-sensitivity and, unless stated, the errors of linearisation.
    gyro, accel : ndarray, shape (n, 3), rad/s and m/s²
        Readings, means over dt.
    dt : float, s
    errors : SensorErrors, optional
        Linearisation point; after an estimate that is far from the calibration, sum again at the estimate.

    Raises
    ------
    InputError
        No samples, or a calibration without noise.
    """
    if len(gyro) == 0 or not dt > 0.0:
        raise InputError(f"{len(gyro)} samples of {dt:g} s cannot be summed: give samples, and a positive interval.")
    at = calibration.errors if errors is None else errors
    triads = gyro_triad(at), accel_triad(at)
    rate, force = Applier(replace(calibration, errors=at)).apply(gyro, accel)
    steps = rotations.from_rotation_vector(np.ascontiguousarray(rate.T) * dt)
    halves = rotations.from_rotation_vector(np.ascontiguousarray(rate.T) * (0.5 * dt))
    chain = rotations.prefix_product(steps)
    start = np.concatenate([np.array([[1.0], [0.0]], dtype=np.complex128), chain[:, :-1]], axis=1)
    middle = _matrices(rotations.multiply(start, halves))
    after = _matrices(chain)
    gained = np.einsum("nab,nb->na", middle, force) * dt
    V = np.vstack([np.zeros(3), np.cumsum(gained, axis=0)])
    P = np.vstack([np.zeros(3), np.cumsum(V[:-1] * dt + 0.5 * gained * dt, axis=0)])
    n = len(rate)
    remaining = (n - 1.0 - np.arange(n)) * dt
    # A rotation by sample i turns what is gained after it, and half of what is gained within it.
    turned_V = V[-1] - V[1:] + 0.5 * gained
    turned_P = P[-1] - P[1:] - V[1:] * remaining[:, None] + gained * (0.5 * remaining[:, None] + dt / 6.0)
    by_rate = after @ np.linalg.inv(rotations.inverse_right_jacobian(rate * dt)) * dt
    G = np.zeros((n, 9, 6))
    G[:, ROTATION, :3] = after[-1].T @ by_rate
    G[:, VELOCITY, :3] = -rotations.cross_matrix(turned_V) @ by_rate
    G[:, POSITION, :3] = -rotations.cross_matrix(turned_P) @ by_rate
    G[:, VELOCITY, 3:] = middle * dt
    G[:, POSITION, 3:] = middle * (dt * (remaining + 0.5 * dt))[:, None, None]
    # For a given reading, a larger error means a smaller true value.
    by_errors = -np.concatenate([rate_error_jacobian(rate, triads[0]), force_error_jacobian(force, triads[1])], axis=1)
    # Errors of the accelerometers reach the gyros through g-sensitivity, too.
    if calibration.g_sensitivity is not None:
        slopes = triads[0].matrix + np.sign(rate)[:, :, None] * np.diag(triads[0].asymmetry)
        followed = np.broadcast_to(calibration.g_sensitivity, slopes.shape)
        by_errors[:, :3] -= np.linalg.solve(slopes, followed) @ by_errors[:, 3:]
    noise = np.zeros((6, 6))
    for sensor, part, triad in zip(("gyro", "accel"), (slice(0, 3), slice(3, 6)), triads, strict=True):
        noise[part, part] = white_density(calibration.noise, sensor, np.asarray(np.linalg.inv(triad.matrix))) / dt
    return PreintegratedReadings(
        rotation=after[-1],
        velocity=V[-1],
        position=P[-1],
        jacobian=np.tensordot(G, by_errors, axes=([0, 2], [0, 1])),
        covariance=np.tensordot(G @ noise, G, axes=([0, 2], [0, 2])),
        duration_s=n * dt,
        errors=at,
    )


def _matrices(q: Quaternions) -> Array:
    """Matrices of quaternions, shape (n, 3, 3)."""
    return np.ascontiguousarray(np.moveaxis(rotations.to_matrix(q), 2, 0))
