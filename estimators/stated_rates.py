"""Runs at a stated rate in the joint model: mean rates against that of the table, and the heading that they turn to.

The rotation between the windows of such a run has many revolutions, and is known modulo one: no measurement of scale
factors. Only its component about the vertical is used, which the specific force at the end does not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.model import measurement_model as model
from srt.model.rotations import cross_matrix

if TYPE_CHECKING:
    from estimators.joint_model import JointModel
    from estimators.joint_state import JointState
    from srt.model.sensor_model import Triad
    from srt.types import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class StatedRates:
    """Compensated mean rates of R runs at a stated rate, in the halves of their steady windows.

    Attributes
    ----------
    sequences : ndarray of int, shape (R,)
    rate : ndarray, shape (R, 2, 3), rad/s
        Less the bias deviation of the sequence, the modelled drift and g-sensitivity.
    stated : ndarray, shape (R,), rad/s
        Magnitude of the stated rate.
    by_table_rate : ndarray, shape (R, 2, 1), rad/s
        Derivative of the residual with respect to the error of the table's rate in sigmas, one for all runs.
    jacobian : ndarray, shape (R, 2, 27)
        Negative derivative of the residual with respect to the 27 sensor errors.
    noise : dict of str to ndarray, shape (R, 2, 2)
        Noise covariance by source.
    """

    sequences: Indices
    rate: Array
    stated: Array
    by_table_rate: Array
    jacobian: Array
    noise: dict[str, Array]

    def residual(self, start: Array, earth_rate: Array, table_rate: float) -> tuple[Array, Array, Array]:
        """Residuals (n, 2) of all runs, and derivatives by rotations of B_Strt and by the Earth's rate, (n, 2, 3).

        Parameters
        ----------
        start : ndarray, shape (R, 3, 3)
            Attitudes from which the runs start, B to L.
        earth_rate : ndarray, shape (R, 3), rad/s
            In L.
        table_rate : float
            Error of the table's rate in sigmas.
        """
        to_body = np.swapaxes(start, 1, 2)
        earth = (to_body @ earth_rate[:, :, None])[:, :, 0]
        residual, _, by_earth = model.stated_rate_residual(self.rate, earth[:, None], self.stated[:, None])
        residual = residual + self.by_table_rate[:, :, 0] * table_rate
        return residual, by_earth @ cross_matrix(earth), by_earth @ to_body


def stated_rates(joint: JointModel, state: JointState, gyro: Triad, force: Array) -> StatedRates:
    """Compensate the mean rates of the runs at an estimate.

    Parameters
    ----------
    joint : JointModel
    state : JointState
    gyro : Triad
        Sensor model of the gyros at ``state``.
    force : ndarray, shape (R, 2, 3), m/s²
        Mean specific forces in the halves.
    """
    stated = joint.processor.stated
    windows, parts = joint.data.start[stated.rated], joint.drift.raw("gyro", state.drift, "parts")[stated.rated]
    drift = state.bias_deviation[stated.rated, None] + stated.shares @ parts
    rate = stated.compensated(gyro, drift + force @ joint.drift.g_sensitivity(state.drift).T)
    earth = np.zeros((len(rate), 1, 3))
    if state.attitude is not None:  # before the first iteration it is unknown; a small part of the derivative
        earth = joint.earth_rate(state)[windows, None] @ state.attitude[windows]
    _, by_rate, _ = model.stated_rate_residual(rate, earth, stated.stated[:, None])
    by_errors = model.rate_error_jacobian(rate.reshape(-1, 3), gyro)
    return StatedRates(
        stated.rated,
        rate,
        stated.stated,
        np.broadcast_to(-(stated.sigma * stated.stated)[:, None, None], (len(rate), 2, 1)),
        np.einsum("rha,rhap->rhp", by_rate, by_errors.reshape(*rate.shape, by_errors.shape[2])),
        {"gyro_noise": stated.rate_noise(joint.data.noise, gyro)},
    )
