"""Samples from named arrays: NPZ, HDF5 and Parquet files."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, MissingExtraError, clipped, did_you_mean
from srt.recording.file_guards import guard_hdf5, guard_hdf5_trees, guard_npy, guard_npz, guard_parquet, load_pyarrow
from srt.recording.import_options import TRIADS, ImportOptions, option
from srt.recording.imported_samples import ImportedSamples, StatedUnits, samples_in_si
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.channels import assign, listed, with_temperature
from srt.recording.importers.parser_errors import clear_errors
from srt.recording.samples import TEMPERATURE, TIME

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.types import Array

ARRAY_OPTIONS: Final = frozenset({"columns", "time_unit", "variable"})

HDF5_MAGIC: Final = b"\x89HDF\r\n\x1a\n"

_MOST_COLUMNS = 64
"""Columns of a table; a longer side of an array is its rows."""

_SENSOR_COLUMNS = 6
"""Columns of gyros and accelerometers together."""

_MOST_ARRAYS = 10_000
"""Datasets of an HDF5 file that are listed; those of a log number some hundreds."""

_PANDAS_INDEX = "__index_level_0__"
"""Column in which pandas writes an index without a name."""

_NUMBERS = "fiu"
"""Kinds of NumPy's types that hold readings."""


@dataclass(frozen=True, slots=True)
class ArrayFile:
    """Named arrays of an open file.

    Attributes
    ----------
    shapes : mapping of str to tuple of int
        Shapes of all arrays of numbers; nested names are separated by "/". A single array without a name has "".
    read : callable
        Returns an array by its name.
    units : mapping of str to str
        Units that the file states for its arrays, as it spells them.
    """

    path: Path
    shapes: Mapping[str, tuple[int, ...]]
    read: Callable[[str], NDArray[Any]]
    units: Mapping[str, str] = field(default_factory=dict)


def samples_from_arrays(
    file: ArrayFile,
    options: ImportOptions,
    stated: StatedUnits | None = None,
    *,
    sample_rate_hz: float | None = None,
    notes: tuple[str, ...] = (),
) -> ImportedSamples:
    """Make samples of named arrays: one for each channel, one for each sensor, or one for all.

    Parameters
    ----------
    options : ImportOptions
        ``variable`` names a group, or the one array that holds all columns.
    stated : StatedUnits, optional
        Units that the format defines; None: those that the file states for its arrays or in their names.
    sample_rate_hz : float, optional
        Rate by the file.
    notes : tuple of str
        Notes of the reader.

    Raises
    ------
    InputError
        Arrays that are absent, or of different lengths.
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
        gyro=_sensor(table, "gyro"),
        accel=_sensor(table, "accel"),
        time=table.get(TIME),
        stated=stated or found.stated,
        kind=None if options.kind is not None else found.kind,
        sample_rate_hz=None if TIME in table else sample_rate_hz,
        temperature=table.get(TEMPERATURE),
        notes=with_temperature(tuple(remarks), table, units.get(TEMPERATURE)),
    )


def samples_from_table(
    path: Path, values: NDArray[Any], options: ImportOptions, stated: StatedUnits | None = None, **fixed: Any
) -> ImportedSamples:
    """Make samples of one array with a column for each channel, as the options number them.

    Parameters
    ----------
    values : ndarray, shape (n, m)
    options : ImportOptions
        ``columns`` by number.
    **fixed
        Further arguments of :func:`~srt.recording.imported_samples.samples_in_si`.

    Raises
    ------
    InputError
        An array that is no table of numbers, or columns that are absent.
    """
    if values.ndim != 2 or values.dtype.kind not in _NUMBERS:
        raise InputError(
            f"{path} holds an array of shape {values.shape} and type {values.dtype}, but a table of numbers with a "
            "column for each channel is expected."
        )
    if values.shape[0] < values.shape[1] <= _MOST_COLUMNS or values.shape[1] > _MOST_COLUMNS >= values.shape[0]:
        values = values.T
    found = assign(path, [], values.shape[1], options.columns)
    table = {channel: values[:, i] for channel, i in found.columns.items()}
    return samples_in_si(
        options,
        gyro=_sensor(table, "gyro"),
        accel=_sensor(table, "accel"),
        time=table.get(TIME),
        stated=stated or StatedUnits(),
        temperature=table.get(TEMPERATURE),
        **fixed,
    )


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
    return [
        name
        for name, shape in file.shapes.items()
        if len(shape) == 2 and _SENSOR_COLUMNS <= min(shape) <= _MOST_COLUMNS
    ]


def _is_columns(shape: tuple[int, ...]) -> bool:
    long = [n for n in shape if n != 1]
    return len(long) == 1 or (len(shape) == 2 and 3 in shape)


def _oriented(file: ArrayFile, name: str, channel: str, notes: list[str]) -> NDArray[Any]:
    """An array as (n,), or as (n, 3) for a sensor."""
    values = file.read(name)
    if values.dtype.kind not in _NUMBERS + "mM":
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


def _sensor(table: Mapping[str, NDArray[Any]], sensor: str) -> Array:
    if sensor in table:
        return np.asarray(table[sensor], dtype=np.float64)
    return np.column_stack([table[name] for name in TRIADS[sensor]]).astype(np.float64, copy=False)


def _listed(file: ArrayFile) -> str:
    shown = [f"{clipped(name)} {'x'.join(map(str, shape))}" for name, shape in file.shapes.items()]
    return ", ".join(shown[:12]) + (" ..." if len(shown) > 12 else "") if shown else "no arrays of numbers"


def _read_npz(path: Path, options: ImportOptions) -> ImportedSamples:
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            file.seek(0)
            with clear_errors(path, "NumPy file"):
                guard_npy(path, file, size)
                array = np.load(file, allow_pickle=False)
            return samples_from_arrays(ArrayFile(path, {"": array.shape}, lambda _: array), options)
        file.seek(0)
        with clear_errors(path, "NPZ file"):
            archive = np.load(file, allow_pickle=False)
            names = list(archive.files)

        def read(name: str) -> NDArray[Any]:
            with clear_errors(path, "NPZ file"):
                guard_npz(path, archive, name, size)
                values: NDArray[Any] = archive[name]
            return values

        arrays: dict[str, tuple[int, ...]] = {}
        for name in names:
            with clear_errors(path, "NPZ file"):
                shape, numbers = _npz_shape(archive, name)
            if numbers:
                arrays[name] = shape
        return samples_from_arrays(ArrayFile(path, arrays, read), options)


def _npz_shape(archive: Any, name: str) -> tuple[tuple[int, ...], bool]:
    member = f"{name}.npy" if f"{name}.npy" in archive.zip.namelist() else name
    with archive.zip.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(stream)
    return tuple(int(n) for n in shape), dtype.kind in _NUMBERS + "mM"


def _read_hdf5(path: Path, options: ImportOptions) -> ImportedSamples:
    with open_hdf5(path, "HDF5 file") as file:
        return samples_from_arrays(file, options)


@contextmanager
def open_hdf5(path: Path, title: str, *, matlab: bool = False) -> Iterator[ArrayFile]:
    """Open the arrays of an HDF5 file; links are neither listed nor followed.

    Raises InputError.

    Parameters
    ----------
    title : str
        Kind of file, for messages.
    matlab : bool
        True for a file written by MATLAB, which stores arrays with their axes in reverse.
    """
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("h5py", "io", f"The {title}") from None
    size = path.stat().st_size
    guard_hdf5_trees(path)
    with clear_errors(path, title):
        file = h5py.File(path, "r")
    try:
        shapes: dict[str, tuple[int, ...]] = {}
        units: dict[str, str] = {}

        def note(name: str, node: Any) -> bool | None:
            text = matlab and node.attrs.get("MATLAB_class") in (b"char", b"cell", b"logical")
            # h5py returns a damaged name as bytes.
            if (
                isinstance(name, str)
                and isinstance(node, h5py.Dataset)
                and node.shape
                and node.dtype.kind in _NUMBERS
                and not text
            ):
                shapes[name] = node.shape[::-1] if matlab else node.shape
                unit = _unit_attribute(h5py, node.attrs)
                if unit:
                    units[name] = unit
            # A value other than None ends the visit.
            return True if len(shapes) >= _MOST_ARRAYS else None

        def read(name: str) -> NDArray[Any]:
            group, _, last = name.rpartition("/")
            with clear_errors(path, title):
                guard_hdf5(path, h5py, file[group] if group else file, last, size)
                values = np.asarray(file[name][()])
            return values.T if matlab else values

        with clear_errors(path, title):
            file.visititems(note)
        yield ArrayFile(path, shapes, read, units)
    finally:
        file.close()


def _unit_attribute(h5py: Any, attributes: Any) -> str | None:
    """Text of the attribute "units" of a dataset; None if there is none, or something else than one text."""
    for name in ("units", "unit"):
        if name not in attributes:
            continue
        attribute = attributes.get_id(name)
        if h5py.check_string_dtype(attribute.dtype) is None or attribute.shape not in ((), (1,)):
            continue
        value = np.asarray(attributes[name]).item()
        return (value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)).strip()
    return None


def _read_parquet(path: Path, options: ImportOptions) -> ImportedSamples:
    pa, parquet = load_pyarrow("parquet")
    with clear_errors(path, "Parquet file"):
        file = parquet.ParquetFile(path)
    with file:
        with clear_errors(path, "Parquet file"):
            guard_parquet(path, file.metadata, path.stat().st_size)
            types = {field.name: field.type for field in file.schema_arrow}
            rows = int(file.metadata.num_rows)
        stamps = {name: "M8" for name, kind in types.items() if pa.types.is_timestamp(kind)}
        stamps |= {name: "m8" for name, kind in types.items() if pa.types.is_duration(kind)}
        kept = [name for name, kind in types.items() if pa.types.is_floating(kind) or pa.types.is_integer(kind)]
        columns = {name: name for name in (*kept, *stamps)}
        if _PANDAS_INDEX in stamps and TIME not in columns:
            columns[TIME] = columns.pop(_PANDAS_INDEX)

        def read(shown: str) -> NDArray[Any]:
            name = columns[shown]
            with clear_errors(path, "Parquet file"):
                column = file.read(columns=[name]).column(0)
                if name in stamps:
                    ticks: NDArray[Any] = column.cast(pa.int64()).to_numpy()
                    return ticks.astype(f"{stamps[name]}[{types[name].unit}]")
                values: NDArray[Any] = column.to_numpy()
            return values

        return samples_from_arrays(ArrayFile(path, dict.fromkeys(columns, (rows,)), read), options)


def _starts_with(*magics: bytes) -> Callable[[Path], bool]:
    return lambda path: head(path, 16).startswith(magics)


NPZ: Final = Importer(
    "npz",
    "NumPy arrays",
    (".npz", ".npy"),
    None,
    _starts_with(b"\x93NUMPY", b"PK\x03\x04"),
    _read_npz,
    ARRAY_OPTIONS,
)

HDF5: Final = Importer(
    "hdf5", "HDF5", (".h5", ".hdf5", ".hdf"), "io", _starts_with(HDF5_MAGIC), _read_hdf5, ARRAY_OPTIONS
)

PARQUET: Final = Importer(
    "parquet", "Parquet", (".parquet", ".pq"), "io", _starts_with(b"PAR1"), _read_parquet, ARRAY_OPTIONS
)
