"""Bias instability (flicker noise), as specified, in the joint model: unknowns of unit variance.

Bias instability is correlated in time, also between sequences. Its effects on the mean rates, the mean specific forces
and the rotations are one Gaussian vector y. With ``y = L u`` the unknowns u are independent and have unit variance. L
is lower triangular in time: a sequence depends only on its own unknowns and on earlier ones, as a filter requires.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.measurement_covariance import accel_drift, gyro_drift

if TYPE_CHECKING:
    from srt.model.rotation_integrals import RotationIntegrals
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_REGULARISATION: Final = 1e-12
"""Term added to the normalised variances (1): the effects on adjacent windows are almost fully correlated."""


@dataclass(frozen=True, slots=True, eq=False)
class BiasInstability:
    """Effects of n unknowns of unit variance: three per window and rotation (gyros) or per window (accelerometers).

    Attributes
    ----------
    rate, force : ndarray, shape (W, 3, n)
        Effects on the compensated means of the windows, rad/s and m/s².
    rotation : ndarray, shape (K, 3, n)
        Effects on the attitude errors of the rotations, rad.
    is_gyro : ndarray of bool, shape (n / 3,)
        True: three unknowns belong to the gyros; False: to the accelerometers.
    """

    rate: Array
    force: Array
    rotation: Array
    is_gyro: Mask

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.rate.shape[2])


def bias_instability(
    data: PreparedRecording,
    integrals: RotationIntegrals,
    slopes: tuple[Array, Array],
    owner: tuple[Indices, Indices],
    *,
    of_gyros: bool,
) -> BiasInstability:
    """Effects of the bias instability as specified; no unknowns if none is specified.

    Parameters
    ----------
    data : PreparedRecording
    integrals : RotationIntegrals
        Integrals that include the parts of the time integral.
    slopes : (ndarray, ndarray), shape (W, 3, 3) each
        Derivatives of compensated rate and force with respect to biases of the raw gyros and accelerometers.
    owner : (ndarray, ndarray) of int, shape (W,) and (K,)
        Rank in time of the sequence of each window and of each rotation.
    of_gyros : bool
        Include the bias instability of the gyros.
    """
    windows, rotations = owner
    W = len(windows)
    gyro, accel = np.zeros((W + data.K, 3, 0)), np.zeros((W, 3, 0))
    rank_gyro = rank_accel = np.zeros(0, dtype=np.intp)
    if of_gyros and data.noise.gyro_flicker is not None and data.noise.gyro_flicker.any():
        found = gyro_drift(data, integrals, slopes[0])
        assert found.rate is not None
        assert found.phi is not None
        gyro, rank_gyro = _root(np.concatenate([found.rate, found.phi]), np.concatenate([windows, rotations]))
    if data.noise.accel_flicker.any():
        found = accel_drift(data, slopes[1])
        assert found.force is not None
        accel, rank_accel = _root(found.force, windows)
    # Unknowns of both sensors, sorted by time.
    by_time = np.argsort(np.concatenate([rank_gyro, rank_accel]), kind="stable")
    columns = (3 * by_time[:, None] + np.arange(3)).ravel()
    gyro, accel = (
        np.pad(effect, ((0, 0), (0, 0), room))[:, :, columns]
        for effect, room in ((gyro, (0, accel.shape[2])), (accel, (gyro.shape[2], 0)))
    )
    return BiasInstability(gyro[:W], accel, gyro[W:], by_time < len(rank_gyro))


def _root(effect: Array, rank: Indices) -> tuple[Array, Indices]:
    """Cholesky factor (m, 3, 3 m) of the covariance of effects (m, 3, S), and the sorted ranks of its unknowns."""
    order = np.argsort(rank, kind="stable")
    Y = effect[order].reshape(-1, effect.shape[2])
    size = np.linalg.norm(Y, axis=1)
    # A rotation without samples has zero effect: normalised by 1, it leaves the covariance regular.
    unit = Y / np.where(size > 0.0, size, 1.0)[:, None]
    L = np.linalg.cholesky(unit @ unit.T + _REGULARISATION * np.eye(len(Y))) * size[:, None]
    out = np.empty((len(order), 3, len(Y)))
    out[order] = L.reshape(out.shape)
    return out, rank[order]
