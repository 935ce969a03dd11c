"""PSINS' table of increments, seven columns: angle x, y, z (rad), velocity x, y, z (m/s), time (s).

As a MATLAB variable, as rows of doubles in a binary file, or as text.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.import_options import ImportOptions, option, parse_columns
from srt.recording.imported_samples import ImportedSamples, StatedUnits
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.arrays import from_matrix
from srt.recording.importers.channels import listed
from srt.recording.importers.matlab import is_matlab, matlab_store
from srt.recording.importers.text_tables import find_layout, read_table

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

COLUMNS: Final = 7

_LAYOUT: Final = parse_columns("gyro,accel,time")
_AXES_NOTE = "PSINS has x right, y forward, z up: gyros and accelerometers share these axes."


def _read(path: Path, options: ImportOptions) -> ImportedSamples:
    values = _table(path, options)
    if values.ndim != 2 or values.shape[1] != COLUMNS:
        raise InputError(f"{path} holds a table of shape {values.shape}, but {COLUMNS} columns are expected.")
    said = ImportOptions(
        columns=_LAYOUT,
        **{name: getattr(options, name) for name in options.given if name not in ("variable", "delimiter")},
    )
    return from_matrix(path, values, said, StatedUnits("rad", "m/s", "s"), kind="increment", notes=(_AXES_NOTE,))


def _table(path: Path, options: ImportOptions) -> NDArray[Any]:
    start = head(path)
    if is_matlab(path):
        return _matlab_table(path, options.variable)
    if options.variable is not None:
        raise InputError(f"{option('variable')} is given, but {path} is no MATLAB file: leave it out.")
    # A double in these ranges always has a zero byte or one beyond text somewhere in a few rows.
    if b"\0" in start or any(byte > 127 for byte in start):
        size = path.stat().st_size
        if size % (8 * COLUMNS):
            raise InputError(
                f"{path} is {size} bytes long, which is no whole number of rows of {COLUMNS} doubles: the file is cut "
                "off, or of another format."
            )
        return np.fromfile(path, dtype="<f8").reshape(-1, COLUMNS)
    layout = find_layout(path, options)
    if len(layout.cells) != COLUMNS:
        raise InputError(f"{path} has {len(layout.cells)} columns, but PSINS' increments have {COLUMNS}.")
    table = read_table(path, layout, {str(i): i for i in range(COLUMNS)})
    return np.column_stack(list(table.values()))


def _matlab_table(path: Path, variable: str | None) -> NDArray[Any]:
    with matlab_store(path) as store:
        wide = [name for name, shape in store.shapes.items() if len(shape) == 2 and shape[1] == COLUMNS]
        name = None if variable is None else variable.replace(".", "/")
        if name is None and len(wide) == 1:
            name = wide[0]
        if name not in wide or name is None:
            raise InputError(
                f"{path} holds {listed(wide, 'nothing')} of {COLUMNS} columns: name the increments with "
                f"{option('variable')}."
            )
        return store.read(name)


PSINS: Final = Importer(
    "psins",
    "PSINS increments, N x 7",
    (),
    None,
    lambda _: False,  # nothing marks it: doubles, or a variable like any other
    _read,
    frozenset({"variable", "delimiter"}),
)
