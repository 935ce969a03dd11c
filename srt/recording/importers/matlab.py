"""MATLAB files: levels 4 to 7 by scipy, 7.3 as the HDF5 file that it is."""

from __future__ import annotations

import io
import math
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.arrays import ARRAY_OPTIONS, HDF5_MAGIC, Store, from_store, hdf5_store
from srt.recording.importers.matlab_elements import NUMERIC, variables
from srt.recording.importers.parser_errors import clear_errors

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples

_TITLE = "MATLAB file"
_HDF5_OFFSET = 512  # MATLAB's own header stands before the HDF5 one
_DEEPEST = 4


@contextmanager
def matlab_store(path: Path) -> Iterator[Store]:
    """Open the arrays of a MATLAB file; fields of structs have the struct's name and a slash before theirs.

    Objects, function handles, cells and tables are left out: they are no arrays of numbers.

    Parameters
    ----------
    path : Path

    Yields
    ------
    Store

    Raises
    ------
    InputError
    """
    if head(path, _HDF5_OFFSET + 8)[_HDF5_OFFSET:] == HDF5_MAGIC or head(path, 8) == HDF5_MAGIC:
        with hdf5_store(path, _TITLE, matlab=True) as store:
            yield store
        return
    with clear_errors(path, _TITLE):
        found = list(variables(path.read_bytes()))
    shapes: dict[str, tuple[int, ...]] = {}
    fields: dict[str, NDArray[Any]] = {}
    files: dict[str, bytes] = {}
    for variable in found:
        if variable.kind in NUMERIC:
            shapes[variable.name], files[variable.name] = variable.shape, variable.data
        elif variable.kind == "struct" and math.prod(variable.shape) == 1:
            fields.update(_flat(variable.name, _load(path, variable.data), _DEEPEST))
    shapes.update({name: values.shape for name, values in fields.items()})
    yield Store(path, shapes, lambda name: fields[name] if name in fields else _load(path, files[name]))


def _load(path: Path, data: bytes) -> NDArray[Any]:
    """Read the one variable of a file that has been checked."""
    import scipy.io

    with clear_errors(path, _TITLE):
        content = scipy.io.loadmat(io.BytesIO(data))
        values = [np.asarray(value) for name, value in content.items() if not name.startswith("__")]
    if len(values) != 1:
        raise InputError(f"{path} is not a readable {_TITLE} (a variable has no name): copy or export it again.")
    return values[0]


def _flat(name: str, value: Any, depth: int) -> dict[str, NDArray[Any]]:
    """Arrays of numbers in a struct, by their path."""
    if not isinstance(value, np.ndarray) or depth == 0:
        return {}
    if value.dtype.names is not None and value.size == 1:
        result = {}
        for key in value.dtype.names:
            result.update(_flat(f"{name}/{key}", value.flat[0][key], depth - 1))
        return result
    # Function handles and objects are arrays of another type.
    return {name: value} if type(value) is np.ndarray and value.dtype.kind in "fiu" and value.size else {}


def is_matlab(path: Path) -> bool:
    """Whether a file is one of MATLAB's: by its header, or by its suffix if it is no text, as level 4 has no header."""
    return _sniff(path) or (path.suffix.lower() == ".mat" and b"\0" in head(path))


def _sniff(path: Path) -> bool:
    start = head(path, _HDF5_OFFSET + 8)
    return start.startswith(b"MATLAB ") and (b"MAT-file" in start[:128] or start[_HDF5_OFFSET:] == HDF5_MAGIC)


def _read(path: Path, options: ImportOptions) -> ImportedSamples:
    with matlab_store(path) as store:
        return from_store(store, options)


MATLAB: Final = Importer("matlab", "MATLAB file", (".mat",), None, _sniff, _read, ARRAY_OPTIONS)
