"""gtsam factor of preintegrated readings with the sensor errors as variables, and the calibration as their prior.

The variable of the errors is ``z``, with ``e = e₀ + L z`` and ``L Lᵀ`` the covariance of the calibration. Its prior is
a unit normal one, whatever the units of the errors, and parameters without covariance, fixed ones, stay out of it.
Navigation axes are those of gtsam: flat, not rotating, gravity constant. The residual of states i and j, T apart::

    Log(ΔR̂ᵀ R_iᵀ R_j)    R_iᵀ (v_j − v_i − g T) − ΔV̂    R_iᵀ (p_j − p_i − v_i T − g T²/2) − ΔP̂

with ΔR̂, ΔV̂, ΔP̂ the sums of :mod:`srt.stacks.preintegration`, linear in z.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import optional
from srt.model.rotations import cross_matrix, inverse_right_jacobian, rotation_matrix, rotation_vector
from srt.sensor_errors import SensorErrors
from srt.stacks.preintegration import POSITION, ROTATION, VELOCITY

if TYPE_CHECKING:
    from srt.result.calibration import Calibration
    from srt.stacks.preintegration import PreintegratedReadings
    from srt.types import Array

_RANK_FROM: Final = 1e-12
"""Eigenvalue of the correlations, relative to the largest, below which a direction has no uncertainty."""


class ErrorVariable:
    """Variable z of the sensor errors, e = e₀ + L z.

    Parameters
    ----------
    calibration : Calibration
        Its values are e₀, its covariance L Lᵀ.

    Attributes
    ----------
    root : ndarray, shape (27, m)
        L.
    """

    __slots__ = ("_center", "root")

    def __init__(self, calibration: Calibration) -> None:
        calibration.require_values()
        self._center = calibration.errors.vector.copy()
        P = calibration.covariance
        sigma = np.sqrt(np.maximum(np.diag(P), 0.0))
        scale = np.where(sigma > 0.0, sigma, 1.0)
        # Eigenvalues of the correlations, as the units of the errors differ by ten orders of magnitude.
        values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
        kept = values > _RANK_FROM * max(float(values.max()), 1e-300)
        self.root: Array = sigma[:, None] * vectors[:, kept] * np.sqrt(values[kept])

    @property
    def size(self) -> int:
        """Length m of z."""
        return int(self.root.shape[1])

    def errors(self, z: Array) -> SensorErrors:
        """Sensor errors of a value of the variable."""
        return SensorErrors(self._center + self.root @ z)

    def covariance(self, z_covariance: Array) -> Array:
        """Covariance of the 27 errors from that of z, shape (27, 27)."""
        return np.asarray(self.root @ z_covariance @ self.root.T)

    def prior(self, key: int, *, weight: float = 1.0) -> Any:
        """Prior factor of gtsam: the calibration.

        Parameters
        ----------
        weight : float
            Factor on all sigmas; 1 is the calibration as it states itself.
        """
        gtsam = _gtsam()
        return gtsam.PriorFactorVector(
            key, np.zeros(self.size), gtsam.noiseModel.Isotropic.Sigma(self.size, float(weight))
        )


def preintegrated_factor(
    keys: tuple[int, int, int, int, int], readings: PreintegratedReadings, variable: ErrorVariable, gravity: Array
) -> Any:
    """Make the factor.

    Parameters
    ----------
    keys : tuple of 5 int
        Pose and velocity at the start, pose and velocity at the end, errors: Pose3, Vector3, Pose3, Vector3, Vector m.
    gravity : ndarray, shape (3,), m/s²
        In navigation axes, as (0, 0, -9.8) where z points up.

    Raises
    ------
    MissingExtraError
        Without gtsam.
    """
    gtsam = _gtsam()
    root = np.linalg.qr(np.linalg.inv(np.linalg.cholesky(readings.covariance)), mode="r")
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
    first, second, *_, last = keys

    def function(this: Any, values: Any, jacobians: Any) -> Array:  # noqa: ARG001 - gtsam's signature
        poses = values.atPose3(first), values.atPose3(keys[2])
        speeds = values.atVector(second), values.atVector(keys[3])
        states = [(pose.rotation().matrix(), pose.translation(), v) for pose, v in zip(poses, speeds, strict=True)]
        residual, J = residual_of(readings, variable, gravity, states[0], states[1], values.atVector(last))
        if jacobians is not None:
            for k, block in enumerate(J):
                jacobians[k] = np.asfortranarray(block)
        return residual

    return gtsam.CustomFactor(noise, list(keys), function)


def residual_of(
    readings: PreintegratedReadings,
    variable: ErrorVariable,
    gravity: Array,
    start: tuple[Array, Array, Array],
    end: tuple[Array, Array, Array],
    z: Array,
) -> tuple[Array, tuple[Array, Array, Array, Array, Array]]:
    """Residual, shape (9,), and its Jacobians: pose (6) and velocity (3) of both states, z (m).

    Parameters
    ----------
    gravity : ndarray, shape (3,)
    start, end : (R, p, v)
        Attitude (body to navigation), position, velocity. A pose changes as gtsam's: R Exp(ω), p + R ρ.
    z : ndarray, shape (m,)
    """
    (R, p, v), (Rj, pj, vj) = start, end
    T = readings.duration_s
    change = readings.jacobian @ (variable.errors(z).vector - readings.errors.vector)
    by_z = readings.jacobian @ variable.root
    phi = change[ROTATION]
    E = rotation_matrix(-phi) @ readings.rotation.T @ R.T @ Rj
    angle = np.asarray(rotation_vector(E[None])[0])
    dv = R.T @ (vj - v - gravity * T)
    dp = R.T @ (pj - p - v * T - 0.5 * gravity * T**2)
    residual = np.concatenate([angle, dv - readings.velocity, dp - readings.position])
    residual[3:] -= change[3:]
    inverse = inverse_right_jacobian(angle[None])[0]
    pose, speed, pose_j, speed_j = np.zeros((9, 6)), np.zeros((9, 3)), np.zeros((9, 6)), np.zeros((9, 3))
    pose[ROTATION, :3] = -inverse @ Rj.T @ R
    pose[VELOCITY, :3], pose[POSITION, :3] = cross_matrix(dv[None])[0], cross_matrix(dp[None])[0]
    pose[POSITION, 3:] = -np.eye(3)
    speed[VELOCITY], speed[POSITION] = -R.T, -R.T * T
    pose_j[ROTATION, :3] = inverse
    pose_j[POSITION, 3:] = R.T @ Rj
    speed_j[VELOCITY] = R.T
    errors = -by_z
    # Log(Exp(−Jr(φ) d) E) = Log(E) − Jr⁻¹(Log E) Eᵀ Jr(φ) d, as Jl⁻¹(r) = Jr⁻¹(r) Exp(r)ᵀ
    right = np.linalg.inv(inverse_right_jacobian(phi[None])[0])
    errors[ROTATION] = -inverse @ E.T @ right @ by_z[ROTATION]
    return residual, (pose, speed, pose_j, speed_j, errors)


def _gtsam() -> Any:
    with optional("gtsam", "graph", "The preintegrated factor"):
        import gtsam
    return gtsam
