"""Correction that a system had applied to the readings of an IMU before it logged them.

An autopilot or an IMU with registers of its own logs ``y = C A (r − o)``, not the readings r of its sensors. Parameters
found from y replace A and o inside the system, so that they must be composed with those that the log was made under
(:meth:`srt.exporters.linear_model.LinearModel.before`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.schema import APPLIED_KEYS, read_fields

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.types import Array

NOTHING: Final = "none"
"""System of readings that are those of the sensors themselves."""

_ORTHOGONAL_WITHIN: Final = 1e-6
"""Largest departure from orthogonality of a rotation: parameters have single precision, and files seven digits."""


_IDENTITY: Final = partial(np.eye, 3)


@dataclass(frozen=True, slots=True, eq=False)
class AppliedCorrection:
    """Correction ``y = C A (r − o)`` of each triad, C common to both.

    The gyros' offset includes ``G a``, with a the corrected specific force before the rotation C.

    Attributes
    ----------
    system : str
        Name of the export format whose parameters applied it, such as "px4"; "none": y are the sensors' readings.
    instance : int or None
        Number of the IMU in the system, from 0.
    gyro_instance : int or None
        Number of the gyros' parameters, where it is another than that of the accelerometers.
    gyro_id, accel_id : int or None
        Identification of the devices in the system.
    rotation : ndarray, shape (3, 3)
        C, from the axes of the sensors to those of the log.
    gyro_matrix, accel_matrix : ndarray, shape (3, 3)
        A.
    gyro_offset : ndarray, shape (3,), rad/s
    accel_offset : ndarray, shape (3,), m/s²
    g_sensitivity : ndarray, shape (3, 3), rad/s per m/s²
        G.

    Raises
    ------
    InputError
        Matrices without an inverse, a rotation that is none, values that are not finite.
    """

    system: str
    instance: int | None = None
    gyro_id: int | None = None
    accel_id: int | None = None
    gyro_instance: int | None = None
    rotation: Array = field(default_factory=_IDENTITY)
    gyro_matrix: Array = field(default_factory=_IDENTITY)
    gyro_offset: Array = field(default_factory=partial(np.zeros, 3))
    accel_matrix: Array = field(default_factory=_IDENTITY)
    accel_offset: Array = field(default_factory=partial(np.zeros, 3))
    g_sensitivity: Array = field(default_factory=partial(np.zeros, (3, 3)))

    def __post_init__(self) -> None:
        for key in APPLIED_KEYS:
            name = str(key.attribute)
            value = getattr(self, name)
            if value is None or isinstance(value, str | int):
                continue
            shape = (3,) if name.endswith("_offset") else (3, 3)
            values = np.array(value, dtype=np.float64)
            if values.size != math.prod(shape) or not np.all(np.isfinite(values)):
                raise InputError(f"The applied {name} is not {math.prod(shape)} finite numbers: correct it.")
            object.__setattr__(self, name, values.reshape(shape))
        if np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() > _ORTHOGONAL_WITHIN:
            raise InputError("The applied rotation is no rotation: its rows must be orthogonal unit vectors.")
        for name in ("gyro_matrix", "accel_matrix"):
            if not np.linalg.cond(getattr(self, name)) < 1e6:
                raise InputError(f"The applied {name} has no inverse: a scale of zero or a row is wrong.")

    @property
    def slots(self) -> tuple[int, int]:
        """Numbers of the parameters of accelerometers and gyros; 0 if the instance is not known."""
        accel = self.instance or 0
        return accel, accel if self.gyro_instance is None else self.gyro_instance

    def undo(self, gyro: Array, accel: Array) -> tuple[Array, Array]:
        """Readings r of the sensors that were logged as these, shapes (n, 3), rad/s and m/s²."""
        force = accel @ self.rotation
        return (
            np.linalg.solve(self.gyro_matrix, (gyro @ self.rotation).T).T
            + self.gyro_offset
            + force @ self.g_sensitivity.T,
            np.linalg.solve(self.accel_matrix, force.T).T + self.accel_offset,
        )

    def document(self) -> dict[str, Any]:
        """Values under the names of ``[imu.applied]``; those of no correction are left out."""
        out: dict[str, Any] = {}
        for key in APPLIED_KEYS:
            value, default = getattr(self, str(key.attribute)), _DEFAULTS.get(str(key.attribute))
            if value is None or (default is not None and np.array_equal(value, default)):
                continue
            out[key.name] = value.ravel().tolist() if isinstance(value, np.ndarray) else value
        return out


_DEFAULTS: Final = {
    item.name: item.default_factory() for item in fields(AppliedCorrection) if callable(item.default_factory)
}


def applied_correction(file: str, document: Mapping[str, Any] | None) -> AppliedCorrection | None:
    """Read ``[imu.applied]`` of a file; None: not known. Raises InputError: an unknown key, a wrong type or value."""
    if document is None:
        return None
    given = read_fields(file, "imu.applied", document)
    if "system" not in given:
        raise InputError(f'{file}: imu.applied.system is missing: name the system, or "{NOTHING}" for raw readings.')
    try:
        return AppliedCorrection(**given)
    except InputError as error:
        raise InputError(f"{file}: [imu.applied]: {error}") from None
