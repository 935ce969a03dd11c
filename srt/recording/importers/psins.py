"""PSINS' table of increments: angle x, y, z (rad), velocity x, y, z (m/s) and time (s).

It is a MATLAB variable, text (``.imu``), or a binary file of doubles or of 32-bit floats (``binfile32``). Text may lack
the time; the rate of the samples is then an option. A binary file has no magic number, but is recognised by even stamps
in its last column and increments that hold gravity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.import_options import ImportOptions, option, parse_columns
from srt.recording.imported_samples import ImportedSamples, StatedUnits
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.arrays import samples_from_table
from srt.recording.importers.channels import listed
from srt.recording.importers.csv_formats import find_layout
from srt.recording.importers.matlab import is_matlab, open_matlab, unless_scipy
from srt.recording.text_tables import read_table

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.types import Array

COLUMNS: Final = 7

UNTIMED_COLUMNS: Final = 6
"""Columns of a table without time."""

_NAMES = parse_columns("gyro,accel,time")
_UNTIMED_NAMES = parse_columns("gyro,accel")
_AXES_NOTE = "PSINS has x right, y forward, z up: gyros and accelerometers share these axes."

_FLOATS_NOTE = "The file holds 32-bit floats: time and increments are rounded to 6e-8 of their size."

_ROWS_COMPARED = 64
_FEWEST_ROWS = 4
"""Rows at the start of a binary file that tell floats from doubles: in doubles, 4 would increase by accident once in
4! = 24 files, 64 never."""

_UNEVEN = 0.5
"""Largest relative deviation of a step of time from the median: rounding to 32 bits after an hour is 2 % of 10 ms."""

_PLAUSIBLE_RATE_RAD_S = 100.0  # rate beyond that of any gyro sold (4000 °/s), rad/s

_PLAUSIBLE_FORCE_M_S2 = (5.0, 20.0)
"""Median specific force of an IMU that is turned or carried, half to twice gravity; rates in m/s² instead of increments
are larger by the sample rate."""


def read_increments(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read a table of increments, in this process. Raises InputError."""
    values, notes = _table(path, options)
    untimed = values.shape[1] == UNTIMED_COLUMNS
    others = {name: getattr(options, name) for name in options.given if name not in ("variable", "delimiter")}
    return samples_from_table(
        path,
        values,
        ImportOptions(columns=_UNTIMED_NAMES if untimed else _NAMES, **others),
        StatedUnits("rad", "m/s", None if untimed else "s"),
        kind="increment",
        notes=(_AXES_NOTE, *notes),
    )


def _table(path: Path, options: ImportOptions) -> tuple[NDArray[Any], tuple[str, ...]]:
    """The table, and notes."""
    if is_matlab(path):
        return _matlab_table(path, options.variable), ()
    if options.variable is not None:
        raise InputError(f"{option('variable')} is given, but {path} is no MATLAB file: leave it out.")
    start = head(path)
    # A few rows of binary numbers always have a zero byte, or one that is no ASCII.
    if b"\0" in start or any(byte > 127 for byte in start):
        return _binary_table(path)
    layout = find_layout(path, options)
    if len(layout.cells) not in (COLUMNS, UNTIMED_COLUMNS):
        raise InputError(
            f"{path} has {len(layout.cells)} columns, but PSINS' increments have {COLUMNS}, or {UNTIMED_COLUMNS} "
            "without time."
        )
    table = read_table(path, layout, {str(i): i for i in range(len(layout.cells))})
    return np.column_stack(list(table.values())), ()


def _is_binary_table(path: Path) -> bool:
    """True for a file of whole rows with even stamps and plausible increments."""
    for kind, width in (("<f4", 4), ("<f8", 8)):
        start = head(path, width * COLUMNS * _ROWS_COMPARED)
        if len(start) < width * COLUMNS * _ROWS_COMPARED or path.stat().st_size % (width * COLUMNS):
            continue
        with np.errstate(all="ignore"):
            if _is_plausible(np.frombuffer(start, kind).reshape(-1, COLUMNS).astype(np.float64)):
                return True
    return False


def _is_plausible(rows: Array) -> bool:
    if not np.isfinite(rows).all():
        return False
    steps = np.diff(rows[:, 6])
    step = float(np.median(steps))
    if not (step > 0.0 and (np.abs(steps - step) < _UNEVEN * step).all()):
        return False
    rate, force = (float(np.median(np.linalg.norm(part, axis=1))) / step for part in (rows[:, :3], rows[:, 3:6]))
    low, high = _PLAUSIBLE_FORCE_M_S2
    return rate < _PLAUSIBLE_RATE_RAD_S and low < force < high


def _binary_table(path: Path) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Rows of doubles, or of 32-bit floats if time increases in these."""
    size = path.stat().st_size
    time = np.fromfile(path, "<f4", count=_ROWS_COMPARED * COLUMNS)[COLUMNS - 1 :: COLUMNS]
    # Read as floats, the same column of doubles holds parts of time and of an increment by turns.
    increases = time.size >= _FEWEST_ROWS and np.isfinite(time).all() and (np.diff(time) > 0).all()
    if size % (4 * COLUMNS) == 0 and increases:
        return np.fromfile(path, "<f4").reshape(-1, COLUMNS).astype(np.float64), (_FLOATS_NOTE,)
    if size % (8 * COLUMNS):
        raise InputError(
            f"{path} is {size} bytes long, which is no whole number of rows of {COLUMNS} doubles: the file is cut "
            "off, or of another format."
        )
    return np.fromfile(path, dtype="<f8").reshape(-1, COLUMNS), ()


def _matlab_table(path: Path, variable: str | None) -> NDArray[Any]:
    with open_matlab(path) as file:
        wide = [
            name
            for name, shape in file.shapes.items()
            if len(shape) == 2 and shape[1] in (COLUMNS, UNTIMED_COLUMNS) and shape[0] >= shape[1]
        ]
        name = None if variable is None else variable.replace(".", "/")
        if name is None and len(wide) == 1:
            name = wide[0]
        if name not in wide or name is None:
            raise InputError(
                f"{path} holds {listed(wide, 'nothing')} of {COLUMNS} or {UNTIMED_COLUMNS} columns: name the "
                f"increments with {option('variable')}."
            )
        return file.read(name)


_READ, _OPTIONS = unless_scipy(read_increments), frozenset({"variable", "delimiter"})
# Text and variables have no mark: they are numbers like any other.
PSINS: Final = Importer("psins", "PSINS increments, N x 7 or N x 6", (), None, _is_binary_table, _READ, _OPTIONS)
