"""Parameters with which PX4 and ArduPilot correct an IMU, and their orientations.

Both log ``y = C ((r − offset) ∘ scale)``: PX4 as ``Accelerometer::Correct`` (``Gyroscope::Correct`` without a scale),
ArduPilot as ``_rotate_and_correct_accel`` and ``_rotate_and_correct_gyro``. C is the orientation of the board. Thermal
offsets come off r before that in both, whatever the parameters here are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from srt.exceptions import InputError
from srt.recording.applied import AppliedCorrection

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Mapping

    from srt.types import Array

Slots: TypeAlias = tuple[int, int]
"""Numbers of the parameters of accelerometers and gyros."""

_Y: Final = (0, 45, 90, 135, 180, 225, 270, 315)
ORIENTATIONS: Final[tuple[tuple[float, float, float], ...]] = (
    *((0, 0, yaw) for yaw in _Y),
    *((180, 0, yaw) if yaw != 180 else (0, 180, 0) for yaw in _Y),
    (90, 0, 0), (90, 0, 45), (90, 0, 90), (90, 0, 135), (270, 0, 0), (270, 0, 45), (270, 0, 90), (270, 0, 135),
    (0, 90, 0), (0, 270, 0), (0, 180, 90), (0, 180, 270), (90, 90, 0), (180, 90, 0), (270, 90, 0), (90, 180, 0),
    (270, 180, 0), (90, 270, 0), (180, 270, 0), (270, 270, 0), (90, 180, 90), (90, 0, 270), (90, 68.8, 293.3),
    (0, 315, 0), (90, 315, 0),
)  # fmt: skip
"""Roll, pitch and yaw of MAVLink's MAV_SENSOR_ORIENTATION by number, degrees, sensor axes to body axes."""


def rotation_of(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    """Matrix Rz(yaw) Ry(pitch) Rx(roll), shape (3, 3)."""
    from scipy.spatial.transform import Rotation  # a heavy import that few recordings need

    matrix = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    # Quarter turns are exact: their sines and cosines are rounded by 1e-16.
    return np.asarray(np.where(np.abs(matrix - np.round(matrix)) < 1e-15, np.round(matrix) + 0.0, matrix))


def orientation(number: float, name: str) -> Array:
    """Matrix of one of :data:`ORIENTATIONS`. Raises InputError for a number that has none."""
    if number != int(number) or not 0 <= number < len(ORIENTATIONS):
        raise InputError(
            f"The orientation {name} is {number:g}, but 0 to {len(ORIENTATIONS) - 1} are known: write the rotation "
            "into [imu.applied]."
        )
    return rotation_of(*ORIENTATIONS[int(number)])


@dataclass(frozen=True, slots=True)
class Autopilot:
    """Names of an autopilot's parameters.

    Attributes
    ----------
    name, title : str
        Name of its export format, and in text.
    instances : int
        Number of IMUs that have parameters.
    names : callable
        From the slots to the parameters of "accel_offset", "accel_scale" and "gyro_offset", three names each. Slots are
        the numbers of the parameters of accelerometers and gyros, the instance of the IMU where they do not differ.
    ids : callable
        From the slots to the parameters that identify the devices: gyro, accelerometer.
    rotation : callable
        From parameters and slots to C.
    advice : str
        How to list the parameters of a log or a vehicle.
    """

    name: str
    title: str
    instances: int
    names: Callable[[Slots], dict[str, tuple[str, ...]]]
    ids: Callable[[Slots], tuple[str, str]]
    rotation: Callable[[Mapping[str, float], Slots], Array]
    advice: str

    def relevant(self, slots: Slots) -> tuple[str, ...]:
        """Parameters whose change changes the correction."""
        return (*(name for group in self.names(slots).values() for name in group), *_ORIENTATION[self.name])

    def carried(
        self, parameters: Mapping[str, float], changed: Container[str], slots: Slots, notes: list[str]
    ) -> AppliedCorrection | None:
        """Correction by the parameters of a log; None, with a note, if they do not state one for the whole log.

        Parameters
        ----------
        changed : container of str
            Parameters that changed within the log.
        slots : (int, int)
            Of accelerometers and gyros.
        """
        moved = [name for name in self.relevant(slots) if name in changed]
        if moved:
            notes.append(f"{', '.join(moved)} changed within the log: {self.title}'s calibration is not carried.")
            return None
        try:
            found = self.applied(parameters, slots)
        except InputError as error:
            notes.append(f"{self.title}'s calibration is not carried: {error}")
            return None
        if found is None:
            notes.append(
                f"The log lacks {self.names(slots)['accel_offset'][0]}: {self.title}'s calibration is unknown."
            )
        else:
            which = f"IMU {slots[0]}" if slots[0] == slots[1] else f"accelerometers {slots[0]} and gyros {slots[1]}"
            notes.append(f"{self.title}'s calibration and orientation of {which} are carried in [imu.applied].")
        return found

    def applied(self, parameters: Mapping[str, float], slots: Slots) -> AppliedCorrection | None:
        """Correction by these parameters; None if they do not hold it. Raises InputError for values that cannot be."""
        found = {key: [parameters.get(name) for name in group] for key, group in self.names(slots).items()}
        if any(value is None for group in found.values() for value in group):
            return None
        gyro_id, accel_id = (parameters.get(name) for name in self.ids(slots))
        return AppliedCorrection(
            self.name,
            slots[0],
            None if gyro_id is None else int(gyro_id),
            None if accel_id is None else int(accel_id),
            gyro_instance=None if slots[0] == slots[1] else slots[1],
            rotation=self.rotation(parameters, slots),
            gyro_offset=np.array(found["gyro_offset"], dtype=np.float64),
            accel_matrix=np.diag(np.array(found["accel_scale"], dtype=np.float64)),
            accel_offset=np.array(found["accel_offset"], dtype=np.float64),
        )


def _names(accel_offset: str, accel_scale: str, gyro_offset: str) -> dict[str, tuple[str, ...]]:
    patterns = {"accel_offset": accel_offset, "accel_scale": accel_scale, "gyro_offset": gyro_offset}
    return {key: tuple(pattern.format(axis) for axis in "XYZ") for key, pattern in patterns.items()}


def _px4_names(slots: Slots) -> dict[str, tuple[str, ...]]:
    accel, gyro = slots
    return _names(f"CAL_ACC{accel}_{{}}OFF", f"CAL_ACC{accel}_{{}}SCALE", f"CAL_GYRO{gyro}_{{}}OFF")


def _px4_rotation(parameters: Mapping[str, float], slots: Slots) -> Array:
    # An external sensor has an orientation of its own in place of the board's; the level adjustment is common.
    own = f"CAL_ACC{slots[0]}_ROT", f"CAL_GYRO{slots[1]}_ROT"
    accel, gyro = (name if parameters.get(name, -1) >= 0 else "SENS_BOARD_ROT" for name in own)
    number = parameters.get(accel, 0)
    if own[1] in parameters and parameters.get(gyro, 0) != number:
        raise InputError(f"{accel} and {gyro} turn accelerometers and gyros differently.")
    level = rotation_of(*(parameters.get(f"SENS_BOARD_{axis}_OFF", 0.0) for axis in "XYZ"))
    return level @ orientation(number, accel)


def _ardupilot_names(slots: Slots) -> dict[str, tuple[str, ...]]:
    n = "" if slots[0] == 0 else str(slots[0] + 1)
    return _names(f"INS_ACC{n}OFFS_{{}}", f"INS_ACC{n}SCAL_{{}}", f"INS_GYR{n}OFFS_{{}}")


def _ardupilot_ids(slots: Slots) -> tuple[str, str]:
    n = "" if slots[0] == 0 else str(slots[0] + 1)
    return f"INS_GYR{n}_ID", f"INS_ACC{n}_ID"


def _ardupilot_rotation(parameters: Mapping[str, float], _: Slots) -> Array:
    return orientation(parameters.get("AHRS_ORIENTATION", 0), "AHRS_ORIENTATION")


_ORIENTATION: Final = {
    "px4": ("SENS_BOARD_ROT", *(f"SENS_BOARD_{axis}_OFF" for axis in "XYZ")),
    "ardupilot": ("AHRS_ORIENTATION",),
}

PX4: Final = Autopilot(
    "px4",
    "PX4",
    4,
    _px4_names,
    lambda slots: (f"CAL_GYRO{slots[1]}_ID", f"CAL_ACC{slots[0]}_ID"),
    _px4_rotation,
    "'ulog_params LOG.ulg' lists CAL_ACCn_*, CAL_GYROn_* and SENS_BOARD_*; QGroundControl saves those of a vehicle",
)

ARDUPILOT: Final = Autopilot(
    "ardupilot",
    "ArduPilot",
    3,
    _ardupilot_names,
    _ardupilot_ids,
    _ardupilot_rotation,
    "'mavparms.py LOG.bin' lists INS_* and AHRS_ORIENTATION; ground stations save those of a vehicle",
)

AUTOPILOTS: Final = {item.name: item for item in (PX4, ARDUPILOT)}
