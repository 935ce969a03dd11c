"""The one measurement model: what sensor errors do to the SRT measurements, for any rotations and any vertical.

For every sequence (Savage 2020, eqs. 3-5; ``u`` down, ``f = -g u`` the specific force at rest)::

    φ         = ∫ F Ĉ (δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias) dt
    Δa_H      = horizontal part of  [ φ × â + C_End δf_End − δf_Strt ]          (φ × (−g u) = g u × φ)
    a_Down    = u · δf                                  for every stationary window
    δω_window = δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias         at rest: the gyro bias

with ``δf = δMa f + δλ_Asym ∘ |f| + δλ_Bias``. Neglected: products of two errors, and the Earth's rate times an error
of the vertical (parts in 1e3 of a coefficient). Away from zero error the same expressions hold with each triad's error
multiplied by D, the inverse slope of its reading model at the current estimate.

Closed form, least squares, Kalman filter and factor graph all take their Jacobians from here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.compensation import ACCEL_BASIS, GYRO_BASIS
from srt.quaternion import cross_matrix
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.compensation import Triad
    from srt.rotation_integrals import RotationIntegrals

    Array = NDArray[np.float64]

_S: Final = GROUP_SLICES


def attitude_error_jacobian(integrals: RotationIntegrals) -> Array:
    """Derivative of φ with respect to the 27 sensor errors, shape (K, 3, 27)."""
    J = np.zeros((*integrals.time.shape[:1], 3, N_PARAMETERS))
    linear = np.einsum("kabc,pbc->kap", integrals.rate, GYRO_BASIS)
    J[:, :, _S["gyro_scale"]] = linear[:, :, :3]
    J[:, :, _S["gyro_orthogonality"]] = linear[:, :, 3:]
    J[:, :, _S["gyro_asymmetry"]] = integrals.abs_rate
    J[:, :, _S["gyro_bias"]] = integrals.time
    return J


def force_error_jacobian(f: Array, accel: Triad) -> Array:
    """Derivative of the compensated specific force with respect to the 27 errors, shape (n, 3, 27).

    Parameters
    ----------
    f : ndarray, shape (n, 3), m/s²
        Compensated (or nominal) specific force in B.
    accel : Triad
        Errors that it was compensated with.
    """
    J = np.zeros((len(f), 3, N_PARAMETERS))
    linear = np.einsum("pbc,nc->nbp", ACCEL_BASIS, f)
    J[:, :, _S["accel_scale"]] = linear[:, :, :3]
    J[:, :, _S["accel_misalignment"]] = linear[:, :, 3:]
    J[:, :, _S["accel_asymmetry"]] = np.abs(f)[:, :, None] * np.eye(3)
    J[:, :, _S["accel_bias"]] = np.eye(3)
    out: Array = accel.sensitivity(f) @ J
    return out


def rate_error_jacobian(omega: Array, gyro: Triad) -> Array:
    """Derivative of the compensated angular rate with respect to the 27 errors, shape (n, 3, 27).

    Parameters
    ----------
    omega : ndarray, shape (n, 3), rad/s
        Compensated rate in B.
    gyro : Triad
        Errors that it was compensated with.
    """
    J = np.zeros((len(omega), 3, N_PARAMETERS))
    linear = np.einsum("pbc,nc->nbp", GYRO_BASIS, omega)
    J[:, :, _S["gyro_scale"]] = linear[:, :, :3]
    J[:, :, _S["gyro_orthogonality"]] = linear[:, :, 3:]
    J[:, :, _S["gyro_asymmetry"]] = np.abs(omega)[:, :, None] * np.eye(3)
    J[:, :, _S["gyro_bias"]] = np.eye(3)
    out: Array = gyro.sensitivity(omega) @ J
    return out


def horizontal_projector(down: Array) -> Array:
    """I − u uᵀ for unit vectors of shape (K, 3); shape (K, 3, 3)."""
    out: Array = np.eye(3) - down[:, :, None] * down[:, None, :]
    return out


def attitude_to_horizontal(basis: Array, acceleration: Array) -> Array:
    """Matrix that takes φ to the horizontal components of Δa: rows of ``basis`` times −(â×), shape (K, 2, 3)."""
    out: Array = -basis @ cross_matrix(acceleration)
    return out


def horizontal_jacobian(
    integrals: RotationIntegrals, basis: Array, f_start: Array, f_end: Array, accel: Triad
) -> Array:
    """Derivative of Δa_H with respect to the 27 errors (eq. 5), shape (K, 2, 27), m/s² per SI unit.

    Parameters
    ----------
    integrals : RotationIntegrals
        Of K rotations.
    basis : ndarray, shape (K, 2, 3)
        Two horizontal directions in B_Strt; components are taken along them.
    f_start, f_end : ndarray, shape (K, 3), m/s²
        Specific force at the start and at the end, each in B at that time.
    accel : Triad
        Errors that it was compensated with.
    """
    C = integrals.C_end
    a_mean = 0.5 * (f_start + np.einsum("kab,kb->ka", C, f_end))
    by_attitude = attitude_to_horizontal(basis, a_mean) @ attitude_error_jacobian(integrals)
    by_force = basis @ (C @ force_error_jacobian(f_end, accel) - force_error_jacobian(f_start, accel))
    out: Array = by_attitude + by_force
    return out


def down_jacobian(f: Array, accel: Triad) -> Array:
    """Derivative of a_Down = g − |f| with respect to the 27 errors (eq. 5, u · δf), shape (n, 27)."""
    u = -f / np.linalg.norm(f, axis=1, keepdims=True)
    out: Array = np.einsum("na,nap->np", u, force_error_jacobian(f, accel))
    return out
