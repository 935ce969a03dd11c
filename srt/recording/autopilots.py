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
    """Names of an autopilot's parameters, from its slots: the instance of the IMU where they do not differ."""

    name: str  # of its export format
    title: str
    instances: int  # IMUs that have parameters
    names: Callable[[Slots], dict[str, tuple[str, ...]]]  # of "accel_offset", "accel_scale", "gyro_offset", three each
    ids: Callable[[Slots], tuple[str, str]]  # names of what identifies the devices: gyro, accelerometer
    rotation: Callable[[Mapping[str, float], Slots], Array]  # C
    orientation: tuple[str, ...]  # names of the parameters of C that matter to all
    advice: str  # how to list the parameters of a log or a vehicle

    def relevant(self, slots: Slots) -> tuple[str, ...]:
        """Parameters whose change changes the correction."""
        return (*(name for group in self.names(slots).values() for name in group), *self.orientation)

    def carried(
        self, parameters: Mapping[str, float], changed: Container[str], slots: Slots, notes: list[str]
    ) -> AppliedCorrection | None:
        """Correction by the parameters of a log; None, with a note, if they do not state one for the whole log."""
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


def _ardupilot_number(slots: Slots) -> str:
    return "" if slots[0] == 0 else str(slots[0] + 1)


def _ardupilot_names(slots: Slots) -> dict[str, tuple[str, ...]]:
    n = _ardupilot_number(slots)
    return _names(f"INS_ACC{n}OFFS_{{}}", f"INS_ACC{n}SCAL_{{}}", f"INS_GYR{n}OFFS_{{}}")


PX4: Final = Autopilot(
    "px4",
    "PX4",
    4,
    _px4_names,
    lambda slots: (f"CAL_GYRO{slots[1]}_ID", f"CAL_ACC{slots[0]}_ID"),
    _px4_rotation,
    ("SENS_BOARD_ROT", *(f"SENS_BOARD_{axis}_OFF" for axis in "XYZ")),
    "'ulog_params LOG.ulg' lists CAL_ACCn_*, CAL_GYROn_* and SENS_BOARD_*; QGroundControl saves those of a vehicle",
)

ARDUPILOT: Final = Autopilot(
    "ardupilot",
    "ArduPilot",
    3,
    _ardupilot_names,
    lambda slots: (f"INS_GYR{_ardupilot_number(slots)}_ID", f"INS_ACC{_ardupilot_number(slots)}_ID"),
    lambda parameters, _: orientation(parameters.get("AHRS_ORIENTATION", 0), "AHRS_ORIENTATION"),
    ("AHRS_ORIENTATION",),
    "'mavparms.py LOG.bin' lists INS_* and AHRS_ORIENTATION; ground stations save those of a vehicle",
)

AUTOPILOTS: Final = {item.name: item for item in (PX4, ARDUPILOT)}
