"""Measurement model ([P] eqs. 3-5): SRT measurements as linear functions of the sensor errors, for any rotations.

For every sequence and any vertical (``u`` down, ``f = -g u`` the specific force at rest; [P]: Savage 2020)::

    φ         = ∫ F Ĉ (δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias) dt
    Δa_H      = horizontal part of  [ φ × â + C_End δf_End − δf_Strt ]          (φ × (−g u) = g u × φ)
    a_Down    = u · δf                                  for every stationary window
    δω_window = δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias         at rest: the gyro bias

with ``δf = δMa f + δλ_Asym ∘ |f| + δλ_Bias``. The measured ``a_Down = g − |f|`` has the same derivative. The predicted
measurement is H times the errors; the measured values z are in :mod:`srt.estimation.srt_measurements`. The model
neglects products of two errors, and the Earth's rate times an error of the vertical (1e-3 of a coefficient). Away from
zero error, each triad's error is multiplied by D, the inverse slope of its sensor model at the current estimate.

Joint estimation treats the attitudes of the stationary windows as unknowns. Its measurements are the mean specific
force and the mean rate of a window, and the rotation between two windows (:func:`specific_force_residual`,
:func:`angular_rate_residual`, :func:`rotation_residual`, :func:`stated_rate_residual`,
:func:`start_attitude_residual`). ``A`` takes B-components to the local level frame L (z down), which turns with the
Earth. Attitude errors are small rotations of B, ``A exp(a×)``.

All estimators take their Jacobians from this module: the closed form :func:`horizontal_jacobian`,
:func:`down_jacobian` and :func:`rate_error_jacobian`; least squares, Kalman filter and factor graph those of the
residuals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.model.rotation_integrals import FURTHER_GYRO
from srt.model.rotations import cross_matrix, inverse_right_jacobian, rotation_matrix, rotation_vector
from srt.model.sensor_model import GYRO_BASIS
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, OF_SENSOR

if TYPE_CHECKING:
    from srt.model.rotation_integrals import RotationIntegrals
    from srt.model.sensor_model import Triad
    from srt.types import Array


_S: Final = GROUP_SLICES


class SpecificForceResidual(NamedTuple):
    """Mean specific force of n stationary windows less gravity at their attitudes, with its derivatives.

    Attributes
    ----------
    residual : ndarray, shape (n, 3), m/s²
    by_attitude : ndarray, shape (n, 3, 3)
        Derivative with respect to a rotation a of B.
    by_gravity : ndarray, shape (n, 3)
    """

    residual: Array
    by_attitude: Array
    by_gravity: Array


class AngularRateResidual(NamedTuple):
    """Mean rate of n stationary windows less the Earth's, with its derivatives.

    Attributes
    ----------
    residual : ndarray, shape (n, 3), rad/s
    by_attitude, by_earth_rate : ndarray, shape (n, 3, 3)
    """

    residual: Array
    by_attitude: Array
    by_earth_rate: Array


class RotationResidual(NamedTuple):
    """Attitude change over n rotations less the integrated one, with its derivatives.

    Attributes
    ----------
    residual : ndarray, shape (n, 3), rad
        In B_Strt.
    by_start, by_end : ndarray, shape (n, 3, 3)
        Derivatives with respect to rotations of B_Strt and of B_End.
    by_rotation : ndarray, shape (n, 3, 3)
        Its product with :func:`attitude_error_jacobian` is the derivative with respect to errors in the estimate.
    by_earth_rate : ndarray, shape (n, 3, 3)
    """

    residual: Array
    by_start: Array
    by_end: Array
    by_rotation: Array
    by_earth_rate: Array


class StatedRateResidual(NamedTuple):
    """Rates of runs on a rate table less the stated ones, with their derivatives.

    Attributes
    ----------
    residual : ndarray, shape (..., ), rad/s
    by_rate, by_earth_rate : ndarray, shape (..., 3)
    """

    residual: Array
    by_rate: Array
    by_earth_rate: Array


class StartAttitudeResidual(NamedTuple):
    """Attitudes on the fixture at the start of n sequences less the nominal ones, with their derivatives.

    Attributes
    ----------
    residual : ndarray, shape (n, 3), rad
        Inner angle and outer angle less nominal, and the non-orthogonality of the axes less the measured one.
    by_attitude, by_base, by_mounting : ndarray, shape (n, 3, 3)
        Derivatives with respect to small rotations behind A, ``base`` and ``U``.
    by_non_orthogonality : ndarray, shape (n, 3, 1)
    """

    residual: Array
    by_attitude: Array
    by_base: Array
    by_mounting: Array
    by_non_orthogonality: Array


def attitude_error_jacobian(integrals: RotationIntegrals) -> Array:
    """Derivative of φ with respect to the 27 sensor errors, shape (..., K, 3, 27)."""
    J = np.zeros((*integrals.time.shape[:-1], N_PARAMETERS))
    # φ = ∫ F Ĉ (δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias) dt  ([P] eqs. 3, 20-21)
    linear = np.einsum("...bc,pbc->...p", integrals.rate, GYRO_BASIS)
    J[..., _S["gyro_scale"]], J[..., _S["gyro_orthogonality"]] = linear[..., :3], linear[..., 3:]
    J[..., _S["gyro_asymmetry"]], J[..., _S["gyro_bias"]] = integrals.abs_rate, integrals.time
    first = 0
    for group in FURTHER_GYRO:
        part = _S[group.name]
        J[..., part] = integrals.further[..., first : first + part.stop - part.start]
        first += part.stop - part.start
    return J


def force_error_jacobian(f: Array, accel: Triad) -> Array:
    """Derivative of the compensated specific force with respect to the 27 errors, shape (..., n, 3, 27).

    Parameters
    ----------
    f : ndarray, shape (..., n, 3), m/s²
        Compensated (or nominal) specific force in B.
    accel : Triad
        Errors that it was compensated with.
    """
    # δf = D (δMa f + δλ_Asym ∘ |f| + δλ_Bias)  ([P] eqs. 6-11)
    out: Array = accel.sensitivity(f) @ _effects("accel", f)
    return out


def rate_error_jacobian(omega: Array, gyro: Triad, rectified: Array | float = 0.0) -> Array:
    """Derivative of the compensated angular rate with respect to the 27 errors, shape (..., n, 3, 27).

    Parameters
    ----------
    omega : ndarray, shape (..., n, 3), rad/s
        Compensated rate in B.
    gyro : Triad
        Errors that it was compensated with.
    rectified : ndarray, shape (..., n, 3), rad/s, optional
        Mean of |ω| over |ω| of the mean, by vibration.
    """
    # δω = D (δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias)  ([P] eqs. 6-11)
    J = _effects("gyro", omega)
    J[..., _S["gyro_asymmetry"]] += np.broadcast_to(rectified, omega.shape)[..., None] * np.eye(3)
    out: Array = gyro.sensitivity(omega) @ J
    return out


def _effects(sensor: str, true: Array) -> Array:
    """Effect of the 27 errors on the readings of a triad, by true values (..., 3), shape (..., 3, 27)."""
    J = np.zeros((*true.shape, N_PARAMETERS))
    for group in OF_SENSOR[sensor]:
        J[..., _S[group.name]] = group.effect(true)
    return J


def horizontal_projector(down: Array) -> Array:
    """I − u uᵀ for unit vectors of shape (..., 3); shape (..., 3, 3)."""
    out: Array = np.eye(3) - down[..., :, None] * down[..., None, :]
    return out


def attitude_to_horizontal(basis: Array, acceleration: Array) -> Array:
    """Derivative of the horizontal components of Δa with respect to φ: ``basis`` times −(â×), shape (..., K, 2, 3)."""
    # φ × â = −(â×) φ  ([P] eq. 5)
    out: Array = -basis @ cross_matrix(acceleration)
    return out


def horizontal_jacobian(
    integrals: RotationIntegrals, basis: Array, f_start: Array, f_end: Array, accel: Triad
) -> Array:
    """Derivative of Δa_H with respect to the 27 errors (eq. 5), shape (..., K, 2, 27), m/s² per SI unit.

    Parameters
    ----------
    integrals : RotationIntegrals
        Of K rotations.
    basis : ndarray, shape (..., K, 2, 3)
        Two horizontal directions in B_Strt; components are taken along them.
    f_start, f_end : ndarray, shape (..., K, 3), m/s²
        Specific force at the start and at the end, each in B at that time.
    accel : Triad
        Errors that it was compensated with.
    """
    C = integrals.C_end
    a_mean = 0.5 * (f_start + np.einsum("...ab,...b->...a", C, f_end))
    by_attitude = attitude_to_horizontal(basis, a_mean) @ attitude_error_jacobian(integrals)
    # Δa_H = basis · [φ × â + C_End δf_End − δf_Strt]  ([P] eq. 5)
    by_force = basis @ (C @ force_error_jacobian(f_end, accel) - force_error_jacobian(f_start, accel))
    out: Array = by_attitude + by_force
    return out


def down_jacobian(f: Array, accel: Triad) -> Array:
    """Derivative of a_Down = g − |f| with respect to the 27 errors, shape (..., n, 27)."""
    # δa_Down = u · δf, u = −f / |f|  ([P] eq. 5)
    u = -f / np.sqrt(np.einsum("...a,...a", f, f))[..., None]
    out: Array = np.einsum("...a,...ap->...p", u, force_error_jacobian(f, accel))
    return out


def specific_force_residual(force: Array, attitude: Array, gravity: float) -> SpecificForceResidual:
    """Residual of the specific force in stationary windows: ``f + g u`` with ``u = Aᵀ e_z`` down.

    Parameters
    ----------
    force : ndarray, shape (n, 3), m/s²
        Compensated mean specific force in B.
    attitude : ndarray, shape (n, 3, 3)
        A, B to L.
    gravity : float, m/s²

    Returns
    -------
    SpecificForceResidual

    Notes
    -----
    The derivative with respect to errors in the estimate is minus :func:`force_error_jacobian`.
    """
    down = attitude[:, 2]
    return SpecificForceResidual(force + gravity * down, gravity * cross_matrix(down), down)


def angular_rate_residual(rate: Array, attitude: Array, earth_rate: Array) -> AngularRateResidual:
    """Residual of the angular rate in stationary windows: ``ω − Aᵀ ω_L``.

    Parameters
    ----------
    rate : ndarray, shape (n, 3), rad/s
        Compensated mean rate in B.
    attitude : ndarray, shape (n, 3, 3)
    earth_rate : ndarray, shape (n, 3), rad/s
        ω_L, in L.

    Returns
    -------
    AngularRateResidual

    Notes
    -----
    The derivative with respect to errors in the estimate is minus :func:`rate_error_jacobian`.
    """
    to_body = np.swapaxes(attitude, 1, 2)
    earth = np.einsum("nab,nb->na", to_body, earth_rate)
    return AngularRateResidual(rate - earth, -cross_matrix(earth), -to_body)


def rotation_residual(
    rotation: Array, start: Array, end: Array, earth_rate: Array, duration_s: Array
) -> RotationResidual:
    """Residual of the integrated rotation between two windows: ``Log(A_Strtᵀ exp(ω_L T) A_End Ĉᵀ)``.

    Parameters
    ----------
    rotation : ndarray, shape (n, 3, 3)
        Ĉ, B_End to B_Strt against inertial space.
    start, end : ndarray, shape (n, 3, 3)
        A of the windows before and after.
    earth_rate : ndarray, shape (n, 3), rad/s
        ω_L, in L.
    duration_s : ndarray, shape (n,)

    Returns
    -------
    RotationResidual
    """
    earth_angle = earth_rate * duration_s[:, None]
    to_start = np.swapaxes(start, 1, 2)
    residual = rotation_vector(to_start @ rotation_matrix(earth_angle) @ end @ np.swapaxes(rotation, 1, 2))
    right = inverse_right_jacobian(residual)
    left = np.swapaxes(right, 1, 2)
    # Left Jacobian of the Earth's rotation to first order: about 1e-3 rad per sequence, so the error is below 1e-6.
    of_earth = np.eye(3) + 0.5 * cross_matrix(earth_angle)
    by_earth = left @ to_start @ of_earth * duration_s[:, None, None]
    return RotationResidual(residual, -left, right @ rotation, right, by_earth)


def heading_residual(rotation: RotationResidual, start: Array) -> RotationResidual:
    """Component about the vertical of rotation residuals and their derivatives, d = 1 in place of 3 components.

    Parameters
    ----------
    rotation : RotationResidual
    start : ndarray, shape (n, 3, 3)
        Attitudes at the start, B to L.
    """
    down = start[:, 2:]
    residual, by_start, *others = rotation
    # e_zᵀ A exp(a×) r: the vertical in B_Strt turns with A.
    by_start = down @ by_start + np.cross(residual[:, None], down)
    return RotationResidual((down @ residual[:, :, None])[:, :, 0], by_start, *(down @ J for J in others))


def stated_rate_residual(rate: Array, earth_rate: Array, stated: Array) -> StatedRateResidual:
    """Residual of the rate of runs at a stated rate: ``|ω̂| − ω̂e·ω̂/|ω̂| − |Ω|``.

    The Earth's rate along the axis of the run is constant while the unit turns about it; that across it averages out.

    Parameters
    ----------
    rate : ndarray, shape (..., 3), rad/s
        Compensated mean rate in B.
    earth_rate : ndarray, shape (..., 3), rad/s
        ω̂e in B_Strt.
    stated : ndarray, shape (...), rad/s
        Magnitude |Ω| of the stated rate.

    Returns
    -------
    StatedRateResidual
    """
    size = np.linalg.norm(rate, axis=-1)
    axis = rate / size[..., None]
    along = np.sum(axis * earth_rate, axis=-1)
    across = earth_rate - axis * along[..., None]
    return StatedRateResidual(size - along - stated, axis - across / size[..., None], -axis)


def start_attitude_residual(
    attitude: Array, nominal: Array, base: Array, U: Array, heading_rad: float, non_orthogonality: float = 0.0
) -> StartAttitudeResidual:
    """Residual of attitudes on the fixture: errors of inner and outer angle, and of the axes' non-orthogonality.

    ``C = (R_z(heading) C_base)ᵀ A U`` takes T-components to the base's; on a fixture it is
    ``R_y(outer) R_x(ε) R_z(inner)`` with the non-orthogonality ε: inner and outer axis are 90° + ε apart.

    Parameters
    ----------
    attitude : ndarray, shape (n, 3, 3)
        A, B to L (north, east, down).
    nominal : ndarray, shape (n, 3, 3)
        C_nom, table-mounted frame T to fixture base.
    base : ndarray, shape (3, 3)
        True to nominal base: levelling and north.
    U : ndarray, shape (3, 3)
        T to B components.
    heading_rad : float
    non_orthogonality : float, rad

    Returns
    -------
    StartAttitudeResidual
    """
    to_base = (rotation_matrix(np.array([0.0, 0.0, heading_rad])) @ base).T
    C = to_base @ attitude @ U
    inner, outer = _fixture_angles(C)
    inner_nominal, outer_nominal = _fixture_angles(nominal)
    residual = np.stack([_wrapped(inner - inner_nominal), _wrapped(outer - outer_nominal), C[:, 1, 2]], axis=1)
    # e_y · C e_z = −sin ε
    residual[:, 2] += np.sin(non_orthogonality)
    # C (I + v×) for a small rotation v behind C.
    behind = np.zeros_like(C)
    across, along = C[:, 1, 0] ** 2 + C[:, 1, 1] ** 2, C[:, 0, 2] ** 2 + C[:, 2, 2] ** 2
    behind[:, 0, 0], behind[:, 0, 1] = -C[:, 1, 0] * C[:, 1, 2] / across, -C[:, 1, 1] * C[:, 1, 2] / across
    behind[:, 0, 2] = 1.0
    behind[:, 1, 0] = (C[:, 0, 2] * C[:, 2, 1] - C[:, 2, 2] * C[:, 0, 1]) / along
    behind[:, 1, 1] = (C[:, 2, 2] * C[:, 0, 0] - C[:, 0, 2] * C[:, 2, 0]) / along
    behind[:, 2, 0], behind[:, 2, 1] = -C[:, 1, 1], C[:, 1, 0]
    by_non_orthogonality = np.zeros((len(C), 3, 1))
    by_non_orthogonality[:, 2, 0] = np.cos(non_orthogonality)
    return StartAttitudeResidual(residual, behind @ U.T, -behind @ np.swapaxes(C, 1, 2), behind, by_non_orthogonality)


def _fixture_angles(C: Array) -> tuple[Array, Array]:
    """Inner and outer angle of ``R_y(outer) R_x(ε) R_z(inner)``, rad."""
    return np.arctan2(C[:, 1, 0], C[:, 1, 1]), np.arctan2(C[:, 0, 2], C[:, 2, 2])


def _wrapped(angle: Array) -> Array:
    out: Array = np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
    return out
