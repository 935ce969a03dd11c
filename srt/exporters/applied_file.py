"""Corrections that readings had before they were logged, read from files of the systems that applied them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.exceptions import InputError, SrtError
from srt.exporters.conversion import forward_model, read_texts
from srt.exporters.parameter_files import parameter_values
from srt.exporters.registry import exporter
from srt.recording.applied import NOTHING, AppliedCorrection
from srt.recording.autopilots import AUTOPILOTS

if TYPE_CHECKING:
    from os import PathLike


def applied_of(text: str, instance: int | None = None) -> AppliedCorrection:
    """Correction named as "FORMAT:FILE", or "none" for readings of the sensors themselves.

    Parameters of another IMU than 0 are named as "FORMAT.N:FILE"; "FORMAT.N.M:FILE" if those of the gyros have the
    number M.

    Parameters
    ----------
    instance : int, optional
        Number of the IMU of an autopilot; default 0.

    Raises InputError: another form, or a file that does not hold the correction.
    """
    if text == NOTHING:
        return AppliedCorrection(NOTHING)
    name, colon, path = text.partition(":")
    target, *numbers = name.split(".")
    if not colon or not path or len(numbers) > 2 or not all(map(str.isdecimal, numbers)):
        raise InputError(
            f"The applied correction is {text!r}: give FORMAT:FILE, as px4:vehicle.params or px4.1:vehicle.params for "
            "IMU 1, or none."
        )
    chosen = [int(number) for number in numbers] or [instance or 0]
    return load_applied(path, target, chosen[0], chosen[-1])


def load_applied(
    path: str | PathLike[str], target: str, instance: int | None = None, gyro_instance: int | None = None
) -> AppliedCorrection:
    """Read a file of other software as the correction that readings had before they were logged.

    Parameters
    ----------
    path : path-like
        Parameters of an autopilot, registers of a unit, or a calibration that :func:`load` reads.
    target : str
        Name of the format.
    instance : int, optional
        Number of the IMU of an autopilot; default 0.
    gyro_instance : int, optional
        Number of the gyros' parameters; default ``instance``.

    Raises InputError: a file that cannot be read, or that does not hold the correction.
    """
    chosen = exporter(target)
    texts = read_texts(chosen, path)
    try:
        if target in AUTOPILOTS:
            values = parameter_values(texts[""])
            first = instance or 0
            slots = first, first if gyro_instance is None else gyro_instance
            found = AUTOPILOTS[target].applied(values, slots)
            if found is None:
                groups = AUTOPILOTS[target].names(slots).values()
                missing = next(name for group in groups for name in group if name not in values)
                raise InputError(
                    f"there is no {missing} in it: save all parameters of the vehicle, or name another IMU "
                    f"({target}.1:FILE)."
                )
            return found
        gyro, accel, g_sensitivity = forward_model(chosen, chosen.read(texts))
    except SrtError as error:
        raise InputError(f"{path}, read as {chosen.title}: {error}") from None
    return AppliedCorrection(
        target,
        gyro_matrix=np.asarray(np.linalg.inv(gyro.matrix)),
        gyro_offset=gyro.bias,
        accel_matrix=np.asarray(np.linalg.inv(accel.matrix)),
        accel_offset=accel.bias,
        g_sensitivity=g_sensitivity,
    )
