"""MATLAB files: levels 4 to 7 by scipy in a child process, level 7.3 as an HDF5 file."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.array_files import HDF5_MAGIC, ArrayFile, open_hdf5
from srt.recording.file_guards import clear_errors
from srt.recording.import_options import option
from srt.recording.imported_samples import StatedUnits
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.arrays import ARRAY_OPTIONS, samples_from_arrays
from srt.recording.importers.channels import listed
from srt.recording.importers.child_process import in_child
from srt.recording.samples import TIME

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples

_TITLE = "MATLAB file"

_HDF5_OFFSET = 512  # bytes of MATLAB's own header before that of HDF5
_STRUCT_LEVELS = 4  # structs within structs that are searched for arrays; loggers write one or two


@contextmanager
def open_matlab(path: Path) -> Iterator[ArrayFile]:
    """Open the arrays of a MATLAB file; the name of a struct's field is "struct/field".

    Objects, function handles, cells and tables are left out: they are no arrays of numbers. Raises InputError.
    """
    if is_level_73(path):
        with open_hdf5(path, _TITLE, matlab=True) as file:
            yield file
        return
    import scipy.io

    with clear_errors(path, _TITLE):
        content = scipy.io.loadmat(path)
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            arrays.update(_fields(name, value, _STRUCT_LEVELS))
    yield ArrayFile(path, {name: values.shape for name, values in arrays.items()}, arrays.__getitem__)


def read_matlab(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read a MATLAB file in this process. Raises InputError."""
    with open_matlab(path) as file:
        struct = None if options.columns else _navego_struct(file, options.variable)
        if struct is None:
            return samples_from_arrays(file, options)
        timed = f"{struct}/t" in file.shapes
        rate = file.read(f"{struct}/freq").ravel()[:1].tolist() if f"{struct}/freq" in file.shapes else []
        return samples_from_arrays(
            file,
            replace(options, variable=struct, columns={"gyro": "wb", "accel": "fb"} | ({TIME: "t"} if timed else {})),
            StatedUnits("rad/s", "m/s^2", "s" if timed else None),
            sample_rate_hz=next((value for value in rate if 0.0 < value < np.inf), None),
            notes=(f"{struct} is a struct of NaveGo: wb are rates in rad/s, fb specific forces in m/s².",),
        )


def is_matlab(path: Path) -> bool:
    """True for a MATLAB file: by its header; level 4 has none, so by its suffix if it is no text."""
    return _sniff(path) or (path.suffix.lower() == ".mat" and b"\0" in head(path))


def is_level_73(path: Path) -> bool:
    """True for an HDF5 file, with MATLAB's header before it or without."""
    start = head(path, _HDF5_OFFSET + len(HDF5_MAGIC))
    return start.startswith(HDF5_MAGIC) or start[_HDF5_OFFSET:] == HDF5_MAGIC


def _navego_struct(file: ArrayFile, wanted: str | None) -> str | None:
    """Struct with rates ``wb`` and specific forces ``fb``, as NaveGo has it; None: there is none, or another is wanted.

    Raises InputError if there are several.
    """
    structs = [name.removesuffix("/wb") for name in file.shapes if name.endswith("/wb")]
    structs = [name for name in structs if f"{name}/fb" in file.shapes]
    if wanted is not None:
        structs = [name for name in structs if name == wanted.replace(".", "/").strip("/")]
    if len(structs) > 1:
        raise InputError(f"{file.path} holds several IMUs ({listed(structs)}): name one with {option('variable')}.")
    return next(iter(structs), None)


def _fields(name: str, value: Any, levels: int) -> dict[str, NDArray[Any]]:
    """Arrays of numbers in a variable, by their path."""
    if not isinstance(value, np.ndarray) or levels == 0:
        return {}
    if value.dtype.names is not None and value.size == 1:
        parts = (_fields(f"{name}/{key}", value.flat[0][key], levels - 1) for key in value.dtype.names)
        return {place: array for part in parts for place, array in part.items()}
    # Function handles and objects have another array type and are left out.
    return {name: value} if type(value) is np.ndarray and value.dtype.kind in "fiu" and value.size else {}


def _sniff(path: Path) -> bool:
    start = head(path, _HDF5_OFFSET + len(HDF5_MAGIC))
    return start.startswith(b"MATLAB ") and (b"MAT-file" in start[:128] or start[_HDF5_OFFSET:] == HDF5_MAGIC)


def unless_scipy(reader: Callable[[Path, ImportOptions], ImportedSamples]) -> Callable[..., ImportedSamples]:
    """Reader of files that runs in this process, and in a child where scipy parses the file."""
    child = in_child(f"{reader.__module__}:{reader.__name__}")
    return lambda path, options: (child if is_matlab(path) and not is_level_73(path) else reader)(path, options)


MATLAB: Final = Importer("matlab", "MATLAB file", (".mat",), None, _sniff, unless_scipy(read_matlab), ARRAY_OPTIONS)
