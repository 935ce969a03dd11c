"""Bias instability in the joint problem: what the stated drift does to windows and turns, as unit unknowns.

Drift is alike from window to window, so that what one sequence shows of it tells of the next. All that it adds to the
mean rates, the mean forces and the turned angles is one Gaussian vector y; with ``y = L u`` the unknowns u are
independent and of unit variance. L is triangular in the order of the sequences: a sequence knows of those before it,
which a filter needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.measurement_covariance import accel_drift, gyro_drift

if TYPE_CHECKING:
    from srt.model.rotation_integrals import RotationIntegrals
    from srt.sequences.preparation import PlaybackData
    from srt.types import Array, Indices, Mask


_ROUNDING: Final = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Effect of n unit draws, three for every window and turn of a sensor that drifts.

    Attributes
    ----------
    rate, force : ndarray, shape (W, 3, n)
        On the compensated means of the windows, rad/s and m/s².
    turned : ndarray, shape (K, 3, n)
        On the attitude error of the turns, rad.
    is_gyro : ndarray of bool, shape (n / 3,)
        Sensor of every three draws.
    """

    rate: Array
    force: Array
    turned: Array
    is_gyro: Mask

    @property
    def size(self) -> int:
        """Number of draws."""
        return int(self.rate.shape[2])


def drift(
    data: PlaybackData,
    integrals: RotationIntegrals,
    slopes: tuple[Array, Array],
    owner: tuple[Indices, Indices],
    *,
    of_gyros: bool,
) -> Drift:
    """Set the stated drift up; nothing where none is stated.

    Parameters
    ----------
    data : PlaybackData
    integrals : RotationIntegrals
        Gathered with the parts of the time integral.
    slopes : (ndarray, ndarray), shape (W, 3, 3) each
        Compensated rate and force of unit biases of the raw channels.
    owner : (ndarray, ndarray) of int, shape (W,) and (K,)
        Place in time of the sequence that a window or a turn belongs to.
    of_gyros : bool
        Whether that of the gyros counts.
    """
    windows, turns = owner
    W = len(windows)
    gyro, accel = np.zeros((W + data.K, 3, 0)), np.zeros((W, 3, 0))
    place_gyro = place_accel = np.zeros(0, dtype=np.intp)
    if of_gyros and data.noise.gyro_flicker is not None and data.noise.gyro_flicker.any():
        found = gyro_drift(data, integrals, slopes[0])
        assert found.rate is not None
        assert found.phi is not None
        gyro, place_gyro = _root(np.concatenate([found.rate, found.phi]), np.concatenate([windows, turns]))
    if data.noise.accel_flicker.any():
        found = accel_drift(data, slopes[1])
        assert found.force is not None
        accel, place_accel = _root(found.force, windows)
    # Both sensors' draws in one order of time.
    by_time = np.argsort(np.concatenate([place_gyro, place_accel]), kind="stable")
    columns = (3 * by_time[:, None] + np.arange(3)).ravel()
    gyro, accel = (
        np.pad(effect, ((0, 0), (0, 0), room))[:, :, columns]
        for effect, room in ((gyro, (0, accel.shape[2])), (accel, (gyro.shape[2], 0)))
    )
    return Drift(gyro[:W], accel, gyro[W:], by_time < len(place_gyro))


def _root(effect: Array, place: Indices) -> tuple[Array, Indices]:
    """Triangular root of the covariance of effects (m, 3, S) in the order of their places: (m, 3, 3 m), and the order.

    The draws that it is a root for are in that order, too.
    """
    order = np.argsort(place, kind="stable")
    Y = effect[order].reshape(-1, effect.shape[2])
    size = np.linalg.norm(Y, axis=1)
    # What nothing acts on, as a turn without samples, has no drift.
    unit = Y / np.where(size > 0.0, size, 1.0)[:, None]
    L = np.linalg.cholesky(unit @ unit.T + _ROUNDING * np.eye(len(Y))) * size[:, None]
    out = np.empty((len(order), 3, len(Y)))
    out[order] = L.reshape(out.shape)
    return out, place[order]
