"""Samples files: one column per channel, in the units of the file; the extension gives the format.

Columns ``time``, ``gyro_x`` ... ``gyro_z``, ``accel_x`` ... ``accel_z`` and, optionally, ``temperature``, in
any order; others are ignored. CSV and NPZ need numpy only; Parquet and HDF5 need the extra ``io``. If the format
allows, columns are read one at a time, so that memory never has a table twice.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, clipped, did_you_mean
from srt.recording.array_files import ArrayFile, load_h5py, open_hdf5, open_npz, open_parquet
from srt.recording.atomic_file import atomic_path
from srt.recording.file_guards import load_pyarrow, reason_of
from srt.recording.text_tables import TableLayout, is_number, read_table, write_csv

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

    from srt.types import Array

GYRO_COLUMNS: Final = ("gyro_x", "gyro_y", "gyro_z")
ACCEL_COLUMNS: Final = ("accel_x", "accel_y", "accel_z")
TIME: Final = "time"
TEMPERATURE: Final = "temperature"


@dataclass(slots=True)
class Samples:
    """Samples in the units of their file; their values are not yet checked."""

    gyro: Array  # shape (n, 3)
    accel: Array
    time: Array | None = None  # shape (n,); None: the file has no time column
    temperature: Array | None = None

    @classmethod
    def empty(cls, names: Sequence[str], rows: int) -> Samples:
        """Samples with uninitialised arrays for the named columns."""
        return cls(
            np.empty((rows, 3)),
            np.empty((rows, 3)),
            np.empty(rows) if TIME in names else None,
            np.empty(rows) if TEMPERATURE in names else None,
        )

    def column(self, name: str) -> Array:
        """View of one column, shape (n,)."""
        if name in GYRO_COLUMNS:
            return self.gyro[:, GYRO_COLUMNS.index(name)]
        if name in ACCEL_COLUMNS:
            return self.accel[:, ACCEL_COLUMNS.index(name)]
        column = self.time if name == TIME else self.temperature
        assert column is not None
        return column

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in the order of writing."""
        first = () if self.time is None else (TIME,)
        last = () if self.temperature is None else (TEMPERATURE,)
        return (*first, *GYRO_COLUMNS, *ACCEL_COLUMNS, *last)


def read_samples(path: str | Path, *, time_required: bool = True) -> Samples:
    """Read a samples file: .csv, .npz, .parquet or .h5.

    ``time_required`` refuses a table without a time column. Raises InputError for a file that is absent, of an unknown
    kind, damaged, without a column, or with cells that are not numbers; MissingExtraError.
    """
    path = Path(path)
    reader = _format(path)[0]
    if not _is_file(path):
        raise InputError(f"There is no samples file {path}: check the name (key samples of recording.toml).")
    try:
        return reader(path, time_required)
    except OSError as error:
        raise InputError(f"Cannot read {path} ({error.strerror or reason_of(error)}).") from None
    except MemoryError:
        raise InputError(f"{path} does not fit into memory: split the recording, or give more memory.") from None


def write_samples(path: str | Path, samples: Samples) -> None:
    """Write a samples file (.csv, .npz, .parquet, .h5) completely or not at all; reading returns the same bits.

    Raises InputError for an unknown extension, or a path that cannot be written; MissingExtraError.
    """
    path = Path(path)
    writer = _format(path)[1]
    with atomic_path(path) as temporary:
        writer(temporary, samples)


def select_columns(path: Path, available: Sequence[str], *, time_required: bool) -> tuple[str, ...]:
    """Columns to read, out of those that a file has. Raises InputError if one is missing or present twice."""
    required = ((TIME,) if time_required else ()) + GYRO_COLUMNS + ACCEL_COLUMNS
    missing = [name for name in required if name not in available]
    if missing:
        others = [name for name in available if name not in required]
        found = ", ".join(map(clipped, available[:12])) + (" ..." if len(available) > 12 else "")
        raise InputError(
            f"{path} has no column {missing[0]}{did_you_mean(missing[0], others)} "
            f"(found: {found or 'none'}): name the columns {', '.join(required)}, "
            "or convert the file with 'srt convert'."
        )
    wanted = tuple(name for name in (TIME, *GYRO_COLUMNS, *ACCEL_COLUMNS, TEMPERATURE) if name in available)
    for name in wanted:
        if list(available).count(name) > 1:
            raise InputError(f"{path} has the column {name} more than once: rename or remove the others.")
    return wanted


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long, or has a zero in it
        return False


def _format(path: Path) -> tuple[Callable[[Path, bool], Samples], Callable[[Path, Samples], None]]:
    try:
        return _FORMATS[path.suffix.lower()]
    except KeyError:
        raise InputError(
            f"{path} is no samples file known here (by its extension {path.suffix!r}): "
            f"use one of {', '.join(_FORMATS)}, or a foreign format that 'srt convert' knows."
        ) from None


def _read_csv(path: Path, time_required: bool) -> Samples:
    try:
        layout = _csv_layout(path)
        names = select_columns(path, layout.header, time_required=time_required)
        table = read_table(path, layout, {name: layout.header.index(name) for name in names})
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file in UTF-8: export it again as CSV.") from None
    except csv.Error as error:
        raise InputError(f"{path} is not a table of numbers ({error} characters): export it again as CSV.") from None
    samples = Samples.empty(names, len(table[names[0]]))
    for name, column in table.items():
        samples.column(name)[:] = column
    return samples


def _csv_layout(path: Path) -> TableLayout:
    """Layout by the header row, the first line that is no comment; it may be marked as one itself."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        for number, line in enumerate(file, start=1):
            text = line.strip()
            if text.startswith("#") and "gyro_x" in text:
                text = text.lstrip("#").lstrip()
            if not text or text.startswith("#"):
                continue
            names = tuple(name.strip() for name in next(csv.reader([text])))
            if not any(row.strip() and not row.lstrip().startswith("#") for row in file):
                raise InputError(f"{path} ends after its header row: there are no samples in it.")
            first_row = number
            break
        else:
            raise InputError(f"{path} is empty: a header row with column names, then one row per sample, is expected.")
    if all(map(is_number, names)):
        raise InputError(
            f"{path} starts with a row of numbers, but a header row is expected: put the column names first."
        )
    marks = {";": "semicolons", "\t": "tabs", " ": "blanks"}
    found = next((called for mark, called in marks.items() if len(names) == 1 and mark in names[0]), None)
    if found:
        raise InputError(f"{path} is separated by {found}, but commas are expected: export it again.")
    return TableLayout(",", False, names, first_row, names, "#", own=True)


def _write_csv(path: Path, samples: Samples) -> None:
    write_csv(path, samples.names, [samples.column(name) for name in samples.names])


def _fill(path: Path, names: Sequence[str], read: Callable[[str], NDArray[Any]]) -> Samples:
    """Read column by column, and check that all are lists of equally many numbers."""
    samples: Samples | None = None
    rows = 0
    for name in names:
        column = read(name)
        if column.ndim != 1 or column.dtype.kind not in "fiu":
            raise InputError(
                f"{path}: column {name} is of type {column.dtype} and shape {column.shape}, "
                "but one list of numbers is expected: export it as numbers."
            )
        if samples is None:
            rows = column.size
            samples = Samples.empty(names, rows)
        if column.size != rows:
            raise InputError(
                f"{path}: column {name} holds {column.size} samples, but {names[0]} {rows}: they must agree."
            )
        samples.column(name)[:] = column
    assert samples is not None
    return samples


def _array_reader(opened: Callable[[Path], AbstractContextManager[ArrayFile]]) -> Callable[[Path, bool], Samples]:
    def read(path: Path, time_required: bool) -> Samples:
        with opened(path) as file:
            if "" in file.shapes:
                raise InputError(f"{path} holds a single array, but an archive with one array per column is expected.")
            names = select_columns(path, (*file.shapes, *file.others), time_required=time_required)
            return _fill(path, names, file.read)

    return read


def _write_npz(path: Path, samples: Samples) -> None:
    with path.open("wb") as file:
        np.savez(file, **{name: samples.column(name) for name in samples.names})  # type: ignore[arg-type]


def _write_parquet(path: Path, samples: Samples) -> None:
    pa, parquet = load_pyarrow("parquet")
    table = pa.table({name: np.ascontiguousarray(samples.column(name)) for name in samples.names})
    parquet.write_table(table, path, write_page_checksum=True)


def _write_hdf5(path: Path, samples: Samples) -> None:
    # In memory first: a file that HDF5 cannot close, as on a full disk, ends the interpreter with a segmentation fault.
    image = io.BytesIO()
    # The newest file layout has checksums of its structure, fletcher32 of the data.
    with load_h5py().File(image, "w", libver="latest") as file:
        for name in samples.names:
            file.create_dataset(name, data=samples.column(name), track_times=False, fletcher32=True)
    path.write_bytes(image.getbuffer())


_FORMATS: Final[dict[str, tuple[Callable[[Path, bool], Samples], Callable[[Path, Samples], None]]]] = {
    ".csv": (_read_csv, _write_csv),
    ".npz": (_array_reader(open_npz), _write_npz),
    ".parquet": (_array_reader(open_parquet), _write_parquet),
    ".h5": (_array_reader(open_hdf5), _write_hdf5),
}

SAMPLES_FORMATS: Final = tuple(extension.lstrip(".") for extension in _FORMATS)
"""Formats that can be read and written."""
