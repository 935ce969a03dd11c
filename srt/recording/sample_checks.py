"""Checks of arrays of samples: shape, finite values, increasing time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from srt.arguments import real_array
from srt.exceptions import InputError
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from srt.types import Array


def as_samples(name: str, given: object, dimensions: int) -> Array:
    """Read-only contiguous float64 view, copied only if needed, shape (n,) or (n, 3) by the number of dimensions.

    A value broadcast to n samples remains one value in memory. Raises InputError for another shape, masked values, or
    what does not consist of real numbers; it names the array.
    """
    values = np.asarray(real_array(name, given), dtype=np.float64)
    if values.ndim != dimensions or (dimensions == 2 and values.shape[1] != 3):
        expected = "(n, 3)" if dimensions == 2 else "(n,)"
        raise InputError(f"{name} has the shape {values.shape}, but {expected} is expected.")
    if values.strides != (0,):
        values = np.ascontiguousarray(values)
    values = values.view()
    values.flags.writeable = False
    return values


def require_finite(name: str, values: Array, time: Array | None) -> None:
    """Raise InputError that names the first value that is not finite, by column, sample and time."""
    # The sum is finite only if every term is, and takes a fraction of the time of a test of each term. It may also
    # overflow, so the terms are tested then.
    with np.errstate(over="ignore", invalid="ignore"):
        if math.isfinite(values.sum()):
            return
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size == 0:
        return
    where, row = place_of(name, values, int(bad[0]))
    when = "" if time is None else f", at {time[row]:.9g} s,"
    raise InputError(
        f"{where}{when} is {values.flat[bad[0]]} "
        f"({bad.size} such in this sensor), but every reading must be a finite number: "
        "repair or remove the sample.",
        fault="not_finite",
    )


def place_of(name: str, values: Array, index: int) -> tuple[str, int]:
    """Column and sample of a value by its flat index, as the start of a sentence, and the row."""
    row, column = divmod(index, values.size // len(values))
    full_name = f"{name}_{AXES[column]}" if values.ndim == 2 else name
    return f"Column {full_name}: sample {row + 1} of {len(values)}", row


def require_increasing(time: Array) -> None:
    """Raise InputError that names the first stamp which does not follow its predecessor."""
    rising = time[1:] > time[:-1]
    if rising.all():
        return
    bad = np.flatnonzero(~rising) + 1
    row = int(bad[0])
    what = "repeats" if time[row] == time[row - 1] else "goes back from"
    raise InputError(
        f"Column time: sample {row + 1} of {time.size} at {time[row]:.9g} s {what} {time[row - 1]:.9g} s "
        f"({bad.size} such in all), but time must increase: remove repeated samples, or restore the order.",
        fault="time_repeats" if what == "repeats" else "time_backwards",
    )
