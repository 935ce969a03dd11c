"""Named arrays of NPZ, HDF5 and Parquet files, opened with checks of the sizes in their headers.

A header of a few bytes can state an array of terabytes, a compressed array can expand a thousandfold, and an HDF5 file
can name other files on the disk. Such files are refused before memory is reserved.
"""

from __future__ import annotations

import math
import mmap
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, optional
from srt.recording.file_guards import clear_errors, load_pyarrow, require_size
from srt.recording.parquet_pages import decoded_size

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

HDF5_MAGIC: Final = b"\x89HDF\r\n\x1a\n"
_TREE_MAGIC = b"TREE"
_NPY_MAGIC = b"\x93NUMPY"

NUMBERS: Final = "fiu"
"""Kinds of NumPy's types that hold readings; stamps may also be of "mM", durations and dates."""

EXPANSION_LIMIT: Final = 100
"""Largest ratio of all arrays of a file to its size; recorded samples compress by 2 to 10."""

EXPANSION_SLACK_BYTES: Final = 256 << 20
"""Size of arrays, bytes, accepted at any ratio: constant columns compress a thousandfold, and it loads in about 1 s."""

_PANDAS_INDEX = "__index_level_0__"  # column in which pandas writes an index without a name
_MOST_ARRAYS = 10_000  # datasets of an HDF5 file that are listed; those of a log number some hundreds


@dataclass(frozen=True, slots=True)
class ArrayFile:
    """Named arrays of an open file; nested names are separated by "/", a single array without a name has ""."""

    path: Path
    shapes: Mapping[str, tuple[int, ...]]  # of all arrays of numbers
    read: Callable[[str], NDArray[Any]]  # returns an array by its name; raises InputError
    units: Mapping[str, str] = field(default_factory=dict)  # that the file states for its arrays, as it spells them
    others: tuple[str, ...] = ()  # names of what is no array of numbers


@contextmanager
def open_npz(path: Path) -> Iterator[ArrayFile]:
    """Open the arrays of an NPZ archive, or the one of a NumPy file. Raises InputError."""
    size = path.stat().st_size
    # Opened here because numpy does not close files that it cannot read.
    with path.open("rb") as file:
        single = file.read(len(_NPY_MAGIC)) == _NPY_MAGIC
        file.seek(0)
        with clear_errors(path, "NumPy file" if single else "NPZ file"):
            if single:
                shape, dtype = _npy_header(file)
                _require_plain(path, "the array", shape, dtype, size)
                file.seek(0)
            content: Any = np.load(file, allow_pickle=False)
        if single:
            yield ArrayFile(path, {"": content.shape}, lambda _: content)
            return
        members = {name: f"{name}.npy" if f"{name}.npy" in content.zip.namelist() else name for name in content.files}

        def read(name: str) -> NDArray[Any]:
            with clear_errors(path, "NPZ file"):
                _check_member(path, content, name, members[name], size)
                values: NDArray[Any] = content[name]
            return values

        shapes: dict[str, tuple[int, ...]] = {}
        with clear_errors(path, "NPZ file"):
            for name, member in members.items():
                with content.zip.open(member) as stream:
                    shape, dtype = _npy_header(stream)
                if dtype.kind in NUMBERS + "mM":
                    shapes[name] = shape
        yield ArrayFile(path, shapes, read, others=tuple(name for name in members if name not in shapes))


def _check_member(path: Path, archive: Any, name: str, member: str, file_size: int) -> None:
    """Check the headers of one array of an archive, and the size of all. Raises InputError."""
    info = archive.zip.getinfo(member)
    require_size(path, f"array {name}", info.file_size, min(info.compress_size, file_size))
    _require_expansion(path, sum(each.file_size for each in archive.zip.infolist()))
    with archive.zip.open(info) as stream:
        _require_plain(path, f"array {name}", *_npy_header(stream), info.file_size)


def _require_expansion(path: Path, total: int) -> None:
    """Refuse arrays that are together far larger than their file. Raises InputError."""
    size = path.stat().st_size
    if total > EXPANSION_LIMIT * size + EXPANSION_SLACK_BYTES:
        raise InputError(
            f"{path}: its arrays are {total} bytes long when decoded, more than {EXPANSION_LIMIT} times the {size} "
            "bytes of the file: it is damaged or not a recording; export it again."
        )


def _npy_header(stream: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    # Version 3 differs from 2 in the encoding of field names alone.
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return tuple(int(n) for n in shape), dtype


def _require_plain(path: Path, what: str, shape: tuple[int, ...], dtype: np.dtype[Any], size: int) -> None:
    """Refuse an array of Python objects, which are never unpickled, or one larger than its file."""
    if dtype.hasobject:
        raise InputError(f"{path} is not a readable NPZ file ({what} holds Python objects): export it as numbers.")
    # Python's integers: the product of a hostile shape overflows any other.
    require_size(path, what, math.prod(shape) * dtype.itemsize, size, factor=1)


@contextmanager
def open_hdf5(path: Path, title: str = "HDF5 file", *, matlab: bool = False) -> Iterator[ArrayFile]:
    """Open the arrays of an HDF5 file; links are not followed. ``title`` is the kind of file in messages.

    MATLAB stores arrays with their axes in reverse. Raises InputError, MissingExtraError.
    """
    h5py = load_h5py(f"The {title}" if matlab else "An HDF5 file")
    size = path.stat().st_size
    _check_trees(path)
    with clear_errors(path, title):
        file = h5py.File(path, "r")
    try:
        shapes: dict[str, tuple[int, ...]] = {}
        units: dict[str, str] = {}
        sizes: list[int] = []

        def note(name: str, node: Any) -> bool | None:
            text = matlab and node.attrs.get("MATLAB_class") in (b"char", b"cell", b"logical")
            numbers = isinstance(node, h5py.Dataset) and node.shape and node.dtype.kind in NUMBERS
            # h5py returns a damaged name as bytes.
            if isinstance(name, str) and numbers and not text:
                shapes[name] = node.shape[::-1] if matlab else node.shape
                unit = _unit_attribute(h5py, node.attrs)
                if unit:
                    units[name] = unit
            # A value other than None ends the visit.
            return True if len(shapes) >= _MOST_ARRAYS else None

        def read(name: str) -> NDArray[Any]:
            group, _, last = name.rpartition("/")
            with clear_errors(path, title):
                sizes.append(_check_dataset(path, h5py, file[group] if group else file, last, size))
                _require_expansion(path, sum(sizes))
                values = np.asarray(file[name][()])
            return values.T if matlab else values

        with clear_errors(path, title):
            file.visititems(note)
            others = tuple(name if isinstance(name, str) else repr(name) for name in file if name not in shapes)
        yield ArrayFile(path, shapes, read, units, others)
    finally:
        file.close()


def load_h5py(what: str = "An HDF5 file") -> Any:
    """Import h5py, which the file ``what`` needs. Raises MissingExtraError."""
    with optional("h5py", "io", what):
        import h5py
    return h5py


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


def _check_dataset(path: Path, h5py: Any, group: Any, name: str, file_size: int) -> int:
    """Bytes of a dataset. Raises InputError for a link, for one in another file, or larger than its file allows."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise InputError(f"{path}: {name} is a link to another place, which is not followed: copy the data there.")
    node = group[name]
    if not isinstance(node, h5py.Dataset):
        raise InputError(f"{path}: {name} is a group, but a dataset with one number per sample is expected.")
    if node.is_virtual or node.external:
        raise InputError(f"{path}: {name} is kept in another file, which is not opened: copy the data there.")
    stored = min(int(node.id.get_storage_size()), file_size)
    item = int(node.dtype.itemsize)
    total = math.prod(int(n) for n in node.shape or ()) * item
    require_size(path, f"dataset {name}", total, stored)
    if node.chunks is not None:
        require_size(path, f"a chunk of dataset {name}", math.prod(int(n) for n in node.chunks) * item, file_size)
    return total


def _check_trees(path: Path) -> None:
    """Refuse an HDF5 file with a cycle in the nodes of a tree, which its library would follow without end."""
    with path.open("rb") as file:
        if not file.seek(0, 2):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            base = max(data.find(HDF5_MAGIC), 0)
            # The byte with the length of addresses moved in version 2 of the superblock.
            width = data[base + 13] if data[base + 8 : base + 9] < b"\x02" and len(data) > base + 13 else 8
            width = width if width in (2, 4, 8) else 8
            following: dict[int, int] = {}
            place = data.find(_TREE_MAGIC)
            while place >= 0:
                after = data[place + 8 + width : place + 8 + 2 * width]
                following[place] = base + int.from_bytes(after, "little")
                place = data.find(_TREE_MAGIC, place + 1)
    done: set[int] = set()
    for start in following:
        chain: set[int] = set()
        node = start
        while node in following and node not in done:
            done.add(node)
            chain.add(node)
            node = following[node]
        if node in chain:
            raise InputError(f"{path} is damaged: a part of its index leads back to itself; copy or export it again.")


@contextmanager
def open_parquet(path: Path) -> Iterator[ArrayFile]:
    """Open the columns of a Parquet file; stamps of timestamps and durations are dates of NumPy.

    Raises InputError, MissingExtraError.
    """
    pa, parquet = load_pyarrow("parquet")
    with clear_errors(path, "Parquet file"):
        file = parquet.ParquetFile(path, page_checksum_verification=True)
    with file:
        with clear_errors(path, "Parquet file"):
            rows = int(file.metadata.num_rows)
            require_size(path, "the table", 8 * rows, path.stat().st_size)
            types = {each.name: each.type for each in file.schema_arrow}
            names = tuple(file.schema_arrow.names)
            stamps = {name: "M8" for name, kind in types.items() if pa.types.is_timestamp(kind)}
            stamps |= {name: "m8" for name, kind in types.items() if pa.types.is_duration(kind)}
            numbers = [name for name, kind in types.items() if pa.types.is_floating(kind) or pa.types.is_integer(kind)]
            _check_decoded(path, rows, (*numbers, *stamps))
        index = _PANDAS_INDEX if _PANDAS_INDEX in stamps and "time" not in types else None

        def read(shown: str) -> NDArray[Any]:
            name = index if index is not None and shown == "time" else shown
            if name not in (*numbers, *stamps):
                raise InputError(f"{path}: column {name} is of type {types[name]}, but numbers are expected.")
            with clear_errors(path, "Parquet file"):
                column = file.read(columns=[name]).column(0)
                if len(column) != rows:
                    raise ValueError(f"column {name} has {len(column)} rows of {rows}")
                if name in stamps:
                    ticks: NDArray[Any] = column.cast(pa.int64()).to_numpy()
                    return ticks.astype(f"{stamps[name]}[{types[name].unit}]")
                values: NDArray[Any] = column.to_numpy()  # an absent value becomes nan
            return values

        shapes = {"time" if name == index else name: (rows,) for name in (*numbers, *stamps)}
        # A name that comes twice stays twice, for the message that refuses it.
        twice = [name for i, name in enumerate(names) if name in names[:i]]
        yield ArrayFile(path, shapes, read, others=(*(name for name in types if name not in (*shapes, index)), *twice))


def _check_decoded(path: Path, rows: int, columns: tuple[str, ...]) -> None:
    """Refuse columns whose values, as runs of one value, or whose pages are far larger than their file.

    Raises InputError; ValueError or LookupError for a file that contradicts itself.
    """
    _require_expansion(path, 8 * rows * len(columns))
    size = decoded_size(path, columns)
    if size.rows != rows:
        raise ValueError(f"its groups have {size.rows} rows of {rows}")
    _require_expansion(path, size.page_bytes)
