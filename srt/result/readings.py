"""Checks of the readings, sample durations and output arrays that a calibration is applied to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.arguments import real_array, require_type
from srt.exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from srt.types import Array


def reading_shape(name: str, values: ArrayLike) -> tuple[int, ...]:
    """Shape of the readings; raises InputError if they form no array."""
    if values is None:
        raise InputError(f"The {name} readings are None, but an array of shape (n, 3) or (3,) is expected.")
    try:
        return np.shape(values)
    except ValueError:
        raise InputError(f"The {name} readings are not numbers in an array of shape (n, 3) or (3,).") from None


def checked_readings(name: str, values: ArrayLike) -> Array:
    """Readings as an array of finite real numbers, shape (n, 3) or (3,), copied only if necessary."""
    y = real_array(name, values)  # other real numbers become floats block by block
    if y.shape[-1:] != (3,) or y.ndim > 2:
        raise InputError(f"The {name} readings have the shape {y.shape}; (n, 3) or (3,) is expected.")
    # A sum is finite only if every term is, and makes no array. If it overflows, look closer.
    with np.errstate(over="ignore", invalid="ignore"):
        if not np.isfinite(y.sum(dtype=np.float64)) and not np.isfinite(y).all():
            raise InputError(f"The {name} readings hold values that are not finite numbers.")
    return y


def durations(dt: float | ArrayLike | None, shape: tuple[int, ...]) -> float | Array | None:
    """Durations of increments for readings of that shape: one number, or one per sample; None for rates."""
    if dt is None:
        return None
    step = np.asarray(real_array("dt", dt), dtype=np.float64)
    # Comparisons with NaN are false; extremes make no array.
    if step.size and not (step.min() > 0.0 and step.max() < np.inf):
        raise InputError("dt must be positive seconds.")
    if step.ndim == 0:
        return float(step)
    if len(shape) != 2 or step.shape != shape[:1]:
        raise InputError(f"dt has the shape {step.shape}, which does not go with readings of shape {shape}.")
    return step


def check_output(out: tuple[Array, Array], readings: tuple[Array, Array]) -> None:
    """Refuse output arrays of a wrong shape or type, or that overlap the readings."""
    require_type("out=", "a pair of arrays", out, tuple, list)
    if len(out) != 2:
        raise InputError(f"out holds {len(out)} arrays, but one for the gyro and one for the accel are needed.")
    for name, target, y in zip(("gyro", "accel"), out, readings, strict=True):
        if np.shape(target) != y.shape:
            raise InputError(f"out for {name} has the shape {np.shape(target)}, not {y.shape}.")
        if not isinstance(target, np.ndarray) or target.dtype != np.float64 or not target.flags.writeable:
            raise InputError(f"out for {name} is no float64 array that can be written to.")
        if _overlap(target, y) and not _same_memory(target, y):
            raise InputError(f"out for {name} overlaps its readings; give these themselves, or an array of its own.")
    if _overlap(out[0], readings[1]) or _overlap(out[0], out[1]):
        raise InputError("out for gyro overlaps the accelerometers' arrays: give an array of its own.")


def _overlap(a: Array, b: Array) -> bool:
    """Return True if two arrays share an element."""
    return np.may_share_memory(a, b) and np.shares_memory(a, b)


def _same_memory(a: Array, b: Array) -> bool:
    """Return True if two arrays are the same view of the same memory."""
    return a.ctypes.data == b.ctypes.data and a.strides == b.strides and a.dtype == b.dtype
