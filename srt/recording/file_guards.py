"""Checks of array files before they are read: sizes in their headers against the size of the file.

A header of a few bytes can state an array of terabytes, a compressed array can expand a thousandfold, and an HDF5 file
can name other files on the disk. Such files are refused before memory is reserved.
"""

from __future__ import annotations

import math
import mmap
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, MissingExtraError
from srt.recording.memory_limit import require_memory

if TYPE_CHECKING:
    import zipfile
    from pathlib import Path
    from typing import BinaryIO

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_TREE_MAGIC = b"TREE"

DEFLATE_LIMIT: Final = 1032
"""Largest compression ratio of deflate; the limit for other compressors too."""

SLACK_BYTES: Final = 1 << 20
"""Size, bytes, accepted at any ratio: small files have constant columns."""


NPZ_EXPANSION_LIMIT: Final = 100
"""Largest ratio of the arrays of an NPZ archive to its size; recorded samples compress by 2 to 10."""

NPZ_SLACK_BYTES: Final = 256 << 20
"""Size of arrays, bytes, accepted at any ratio: constant columns compress a thousandfold, and it loads in about 1 s."""


_PYARROW_BYTES: Final = 256 << 20
"""Memory that loading pyarrow and reading a small file take, with the stacks of its threads."""


def load_pyarrow(module: str, what: str = "A Parquet file") -> tuple[Any, Any]:
    """Import pyarrow and one of its modules, which the file ``what`` needs.

    Raises
    ------
    MissingExtraError
    MemoryError
        If a limit leaves too little memory: pyarrow's own code then ends the process.
    """
    require_memory(_PYARROW_BYTES)
    try:
        return import_module("pyarrow"), import_module(f"pyarrow.{module}")
    except ImportError:
        raise MissingExtraError("pyarrow", "io", what) from None


def require_size(path: Path, what: str, promised: int, present: int, factor: int = DEFLATE_LIMIT) -> None:
    """Refuse an array that is larger than its bytes in the file can expand to.

    Raises InputError.

    Parameters
    ----------
    what : str
        Name of the array in the message.
    promised : int
        Size stated in the header, bytes.
    present : int
        Size in the file, bytes.
    factor : int
        Largest ratio of the two.
    """
    if not 0 <= promised <= factor * present + SLACK_BYTES:
        raise InputError(
            f"{path}: {what} is stated to be {promised} bytes long, more than its {present} bytes in the file can "
            "expand to: the file is damaged; copy or export it again."
        )


def guard_npz(path: Path, archive: Any, name: str, file_size: int) -> None:
    """Check the headers of one array of an NPZ archive, and the size of all arrays.

    Raises
    ------
    InputError
        Arrays larger than their file allows, or of Python objects, which are never unpickled.
    """
    members = set(archive.zip.namelist())
    member = f"{name}.npy" if f"{name}.npy" in members else name
    info: zipfile.ZipInfo = archive.zip.getinfo(member)
    require_size(path, f"array {name}", info.file_size, min(info.compress_size, file_size))
    total = sum(each.file_size for each in archive.zip.infolist())
    if total > NPZ_EXPANSION_LIMIT * file_size + NPZ_SLACK_BYTES:
        raise InputError(
            f"{path}: the arrays are stated to be {total} bytes long, more than {NPZ_EXPANSION_LIMIT} times the "
            f"{file_size} bytes of the archive: the file is damaged or not a recording; export it again."
        )
    with archive.zip.open(info) as stream:
        _guard_npy_header(path, f"array {name}", stream, info.file_size)


def guard_npy(path: Path, file: BinaryIO, file_size: int) -> None:
    """Check the header of a NumPy file, and rewind it. Raises InputError."""
    _guard_npy_header(path, "the array", file, file_size)
    file.seek(0)


def _guard_npy_header(path: Path, what: str, stream: Any, size: int) -> None:
    version = np.lib.format.read_magic(stream)
    # Version 3 differs from 2 in the encoding of field names alone.
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    if dtype.hasobject:
        raise InputError(f"{path} is not a readable NPZ file ({what} holds Python objects): export it as numbers.")
    # Python's integers: the product of a hostile shape overflows any other.
    require_size(path, what, math.prod(int(n) for n in shape) * dtype.itemsize, size, factor=1)


def guard_hdf5(path: Path, h5py: Any, group: Any, name: str, file_size: int) -> None:
    """Check one link of an HDF5 file and its dataset before reading them.

    Parameters
    ----------
    group : h5py.Group
        Group of the link.
    name : str
        Name of the link within the group.

    Raises
    ------
    InputError
        A link or dataset in another file, or a dataset larger than its file allows.
    """
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise InputError(f"{path}: {name} is a link to another place, which is not followed: copy the data there.")
    node = group[name]
    if not isinstance(node, h5py.Dataset):
        return
    if node.is_virtual or node.external:
        raise InputError(f"{path}: {name} is kept in another file, which is not opened: copy the data there.")
    stored = min(int(node.id.get_storage_size()), file_size)
    item = int(node.dtype.itemsize)
    require_size(path, f"dataset {name}", math.prod(int(n) for n in node.shape or ()) * item, stored)
    if node.chunks is not None:
        require_size(path, f"a chunk of dataset {name}", math.prod(int(n) for n in node.chunks) * item, file_size)


def guard_hdf5_trees(path: Path) -> None:
    """Refuse an HDF5 file with a cycle in the nodes of a tree, which its library would follow without end.

    Raises InputError.
    """
    with path.open("rb") as file:
        if not file.seek(0, 2):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            base = max(data.find(_HDF5_MAGIC), 0)
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


def guard_parquet(path: Path, metadata: Any, file_size: int) -> None:
    """Check the stated number of rows of a Parquet file against its size. Raises InputError."""
    require_size(path, "the table", 8 * int(metadata.num_rows), file_size)
