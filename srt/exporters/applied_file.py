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

    Parameters
    ----------
    text : str
    instance : int, optional
        Number of the IMU of an autopilot; default 0.

    Returns
    -------
    AppliedCorrection

    Raises
    ------
    InputError
        Another form, or a file that does not hold the correction.
    """
    if text == NOTHING:
        return AppliedCorrection(NOTHING)
    target, colon, path = text.partition(":")
    if not colon or not path:
        raise InputError(f"The applied correction is {text!r}: give FORMAT:FILE, as px4:vehicle.params, or none.")
    return load_applied(path, target, instance)


def load_applied(path: str | PathLike[str], target: str, instance: int | None = None) -> AppliedCorrection:
    """Read a file of other software as the correction that readings had before they were logged.

    Parameters
    ----------
    path : path-like
        Parameters of an autopilot, registers of a unit, or a calibration that :func:`load` reads.
    target : str
        Name of the format.
    instance : int, optional
        Number of the IMU of an autopilot; default 0.

    Returns
    -------
    AppliedCorrection

    Raises
    ------
    InputError
        A file that cannot be read, or that does not hold the correction.
    """
    chosen = exporter(target)
    texts = read_texts(chosen, path)
    try:
        if target in AUTOPILOTS:
            found = AUTOPILOTS[target].applied(parameter_values(texts[""]), instance or 0)
            if found is None:
                name = AUTOPILOTS[target].names(instance or 0)["accel_offset"][0]
                raise InputError(f"there is no {name} in it: save all parameters of the vehicle.")
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
