"""Samples from named arrays: NPZ, HDF5 and Parquet files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import InputError, clipped, did_you_mean
from srt.recording.array_files import HDF5_MAGIC, NUMBERS, ArrayFile, open_hdf5, open_npz, open_parquet
from srt.recording.import_options import TRIADS, ImportOptions, option
from srt.recording.imported_samples import ImportedSamples, StatedUnits, of_channels, samples_in_si
from srt.recording.importer_registry import Importer, starts_with
from srt.recording.importers.channels import assign, listed, unread, with_temperature
from srt.recording.samples import TEMPERATURE, TIME

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from pathlib import Path

    from numpy.typing import NDArray


ARRAY_OPTIONS: Final = frozenset({"columns", "time_unit", "variable"})

_MOST_COLUMNS = 64  # columns of a table; a longer side of an array is its rows
_SENSOR_COLUMNS = 6  # columns of gyros and accelerometers together


def samples_from_arrays(
    file: ArrayFile,
    options: ImportOptions,
    stated: StatedUnits | None = None,
    *,
    sample_rate_hz: float | None = None,
    notes: tuple[str, ...] = (),
) -> ImportedSamples:
    """Make samples of named arrays: one for each channel, one for each sensor, or one for all.

    ``variable`` of the options names a group, or the one array that holds all columns. ``stated`` are the units that
    the format defines; without them, those that the file states for its arrays or in their names count.

    Raises InputError for arrays that are absent, or of different lengths.
    """
    name = _single_array(file, options)
    if name is not None:
        return samples_from_table(file.path, file.read(name), options, stated)
    prefix = "" if options.variable is None else options.variable.replace(".", "/").strip("/") + "/"
    names = [each for each, shape in file.shapes.items() if each.startswith(prefix) and _is_columns(shape)]
    wide = _wide(file)
    if not names and wide:
        raise InputError(
            f"{file.path} holds a table without names, {wide[0]}: list its columns in their order, such as "
            f"{option('columns')} gyro,accel,time."
        )
    if not names:
        raise InputError(
            f"{file.path} holds no array of samples{f' in {options.variable}' if prefix else ''} "
            f"(found: {_listed(file)}): name one with {option('variable')}."
        )
    found = assign(
        file.path,
        [each.removeprefix(prefix) for each in names],
        len(names),
        options.columns,
        arrays=True,
        units=[file.units.get(each) for each in names],
    )
    units = {channel: file.units.get(names[i]) for channel, i in found.columns.items()}
    remarks = [*notes, *found.notes]
    table = {channel: _oriented(file, names[i], channel, remarks) for channel, i in found.columns.items()}
    rows = {channel: len(values) for channel, values in table.items()}
    if len(set(rows.values())) > 1:
        shown = ", ".join(f"{channel} {count}" for channel, count in rows.items())
        raise InputError(f"{file.path}: the arrays are of different lengths ({shown}), but they must agree.")
    return samples_in_si(
        options,
        **of_channels(table),
        stated=stated or found.stated,
        kind=None if options.kind is not None else found.kind,
        sample_rate_hz=None if TIME in table else sample_rate_hz,
        notes=with_temperature(tuple(remarks), table, units.get(TEMPERATURE)),
        unread=unread(names, found.columns),
    )


def samples_from_table(
    path: Path, values: NDArray[Any], options: ImportOptions, stated: StatedUnits | None = None, **fixed: Any
) -> ImportedSamples:
    """Make samples of one array, shape (n, m), with a column for each channel, as the options number them.

    ``fixed`` are further arguments of :func:`~srt.recording.imported_samples.samples_in_si`. Raises InputError for an
    array that is no table of numbers, or columns that are absent.
    """
    if values.ndim != 2 or values.dtype.kind not in NUMBERS:
        raise InputError(
            f"{path} holds an array of shape {values.shape} and type {values.dtype}, but a table of numbers with a "
            "column for each channel is expected."
        )
    if values.shape[0] < values.shape[1] <= _MOST_COLUMNS or values.shape[1] > _MOST_COLUMNS >= values.shape[0]:
        values = values.T
    found = assign(path, [], values.shape[1], options.columns)
    table = {channel: values[:, i] for channel, i in found.columns.items()}
    return samples_in_si(options, **of_channels(table), stated=stated or StatedUnits(), **fixed)


def _single_array(file: ArrayFile, options: ImportOptions) -> str | None:
    """Name of the one array that holds all columns; None if each channel has its own."""
    wide = _wide(file)
    if options.variable is not None:
        name = options.variable.replace(".", "/").strip("/")
        if name in file.shapes:
            return name
        if not any(each.startswith(f"{name}/") for each in file.shapes):
            raise InputError(
                f"{file.path} holds no {options.variable}{did_you_mean(name, map(clipped, file.shapes))} "
                f"(found: {_listed(file)}): name one of those with {option('variable')}."
            )
        return None
    numbered = bool(options.columns) and all(isinstance(column, int) for column in options.columns.values())
    if "" in file.shapes or (numbered and wide):
        if len(wide) > 1:
            raise InputError(f"{file.path} holds several tables ({listed(wide)}): name one with {option('variable')}.")
        return next(iter(wide), "")
    return None


def _wide(file: ArrayFile) -> list[str]:
    """Names of the tables with columns enough for both sensors."""
    shapes = file.shapes.items()
    return [name for name, shape in shapes if len(shape) == 2 and _SENSOR_COLUMNS <= min(shape) <= _MOST_COLUMNS]


def _is_columns(shape: tuple[int, ...]) -> bool:
    long = [n for n in shape if n != 1]
    return len(long) == 1 or (len(shape) == 2 and 3 in shape)


def _oriented(file: ArrayFile, name: str, channel: str, notes: list[str]) -> NDArray[Any]:
    """An array as (n,), or as (n, 3) for a sensor."""
    values = file.read(name)
    if values.dtype.kind not in NUMBERS + "mM":
        raise InputError(f"{file.path}: {name} is of type {values.dtype}, but numbers are expected.")
    if channel not in TRIADS:
        if values.size != max(values.shape, default=0):
            raise InputError(f"{file.path}: {name} has the shape {values.shape}, but one column is expected.")
        return values.reshape(-1)
    if values.ndim == 2 and values.shape[1] == 3:
        return values
    if values.ndim == 2 and values.shape[0] == 3:
        notes.append(f"{name} was turned from rows to columns.")
        return values.T
    raise InputError(f"{file.path}: {name} has the shape {values.shape}, but (n, 3) is expected for {channel}.")


def _listed(file: ArrayFile) -> str:
    shown = [f"{clipped(name)} {'x'.join(map(str, shape))}" for name, shape in file.shapes.items()]
    return ", ".join(shown[:12]) + (" ..." if len(shown) > 12 else "") if shown else "no arrays of numbers"


def _reader(opened: Callable[[Path], AbstractContextManager[ArrayFile]]) -> Callable[..., ImportedSamples]:
    def read(path: Path, options: ImportOptions) -> ImportedSamples:
        with opened(path) as file:
            return samples_from_arrays(file, options)

    return read


_NPZ_MAGICS: Final = starts_with(b"\x93NUMPY", b"PK\x03\x04")

NPZ: Final = Importer("npz", "NumPy arrays", (".npz", ".npy"), None, _NPZ_MAGICS, _reader(open_npz), ARRAY_OPTIONS)

HDF5: Final = Importer(
    "hdf5", "HDF5", (".h5", ".hdf5", ".hdf"), "io", starts_with(HDF5_MAGIC), _reader(open_hdf5), ARRAY_OPTIONS
)

PARQUET: Final = Importer(
    "parquet", "Parquet", (".parquet", ".pq"), "io", starts_with(b"PAR1"), _reader(open_parquet), ARRAY_OPTIONS
)
