"""Start without a fixture: accelerometer errors from the magnitude of gravity over the poses, gyro bias from rest.

Only ``|f| = g`` is known of a pose. It fixes the accelerometer matrix up to a rotation; the symmetric one is taken,
which is near the truth where the sensor axes nearly coincide. A weak prior decides what the poses do not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares

from srt.model.measurement_model import down_jacobian
from srt.model.sensor_model import accel_triad
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.sequences.preparation import PlaybackData

    Array = NDArray[np.float64]

_PRIOR: Final = 0.5
_NOISE: Final = 1e-3
"""Assumed error of a pose over g: weighs poses against the prior, nothing else."""


def _layout() -> Array:
    """Nine unknowns (bias/g, scale, symmetric misalignment) to the 27 parameters, shape (27, 9)."""
    E = np.zeros((N_PARAMETERS, 9))
    E[GROUP_SLICES["accel_bias"], :3] = np.eye(3)
    E[GROUP_SLICES["accel_scale"], 3:6] = np.eye(3)
    for k, (i, j) in enumerate((("x", "y"), ("x", "z"), ("y", "z"))):
        E[INDEX[f"accel_misalignment_{i}{j}"], 6 + k] = E[INDEX[f"accel_misalignment_{j}{i}"], 6 + k] = 1.0
    return E


def start_from_gravity(data: PlaybackData) -> SensorErrors:
    """First estimate for free turns.

    Parameters
    ----------
    data : PlaybackData
    """
    g, readings = data.gravity, data.windows.accel_mean
    E = _layout()
    E[GROUP_SLICES["accel_bias"]] *= g

    def residuals(u: Array) -> Array:
        f = accel_triad(SensorErrors(E @ u)).compensate(readings)
        return np.concatenate([(np.linalg.norm(f, axis=1) / g - 1.0) / _NOISE, u / _PRIOR])

    def jacobian(u: Array) -> Array:
        triad = accel_triad(SensorErrors(E @ u))
        J = down_jacobian(triad.compensate(readings), triad) @ E / (g * _NOISE)
        return np.concatenate([J, np.eye(9) / _PRIOR])

    solution = least_squares(residuals, np.zeros(9), jac=jacobian, method="lm")
    vector = E @ solution.x
    weights = data.windows.duration_s / data.windows.duration_s.sum()
    vector[GROUP_SLICES["gyro_bias"]] = weights @ data.windows.gyro_mean
    return SensorErrors(vector)
