"""Opening the storage files of bags through rosbags: which files, guarded against what a hostile one may ask for."""

from __future__ import annotations

import importlib
import shutil
import sqlite3
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, MissingExtraError
from srt.recording.importer_registry import head
from srt.recording.importers.guarded import INFLATED_LIMIT, READ_FACTOR, BoundedPath, inflate, library

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

BAG1: Final = "ROS 1 bag"
MCAP: Final = "ROS 2 bag (MCAP)"
SQLITE: Final = "ROS 2 bag (SQLite)"
FOLDER: Final = "ROS 2 bag (folder)"

METADATA: Final = "metadata.yaml"
ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"

_METADATA_LIMIT = 1 << 22
_OPENING, _CLOSING = (np.frombuffer(marks, dtype=np.uint8) for marks in (b"[{", b"]}"))
_DEEPEST = 64
_INFLATED_FACTOR = 256
"""How many times a compressed storage file may grow: readings at rest with empty covariances shrink by some tens."""

_MAGIC = ((b"#ROSBAG V", BAG1), (b"\x89MCAP0\r\n", MCAP), (b"SQLite format 3\0", SQLITE))
_SUFFIXES = {BAG1: ".bag", MCAP: ".mcap", SQLITE: ".db3"}


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """An open bag.

    Attributes
    ----------
    path : Path
        File or folder.
    title : str
        What kind it is, for messages.
    readers : sequence
        Readers of rosbags, one for each storage file.
    decode : callable
        Makes a message object of serialised bytes and the name of their type.
    release : callable
        Closes files and removes temporary ones.
    """

    path: Path
    title: str
    readers: Sequence[Any]
    decode: Callable[[bytes, str], Any]
    release: Callable[[], None]

    def counts(self, message_type: str) -> dict[str, int]:
        """Messages in each topic of a type."""
        result: dict[str, int] = {}
        for connection in self._connections():
            if connection.msgtype == message_type:
                result[connection.topic] = result.get(connection.topic, 0) + int(connection.msgcount)
        return result

    def listing(self) -> str:
        """Topics and their types, the first few."""
        there = sorted({f"{each.topic} ({each.msgtype})"[:100] for each in self._connections()})
        return ", ".join(there[:8]) + (" ..." if len(there) > 8 else "")

    def messages(self, topic: str, message_type: str) -> Iterator[tuple[int, bytes]]:
        """Times of recording in ns, and serialised messages."""
        for reader in self.readers:
            wanted = [each for each in reader.connections if each.topic == topic and each.msgtype == message_type]
            if wanted:
                for _, when, raw in reader.messages(connections=wanted):
                    yield when, raw

    def close(self) -> None:
        """Close all files."""
        self.release()

    def _connections(self) -> Iterator[Any]:
        for reader in self.readers:
            yield from reader.connections


def title_of(path: Path) -> str:
    """What kind of bag a path is, by its content; empty if none. Never raises."""
    try:
        if path.is_dir():
            return FOLDER if (path / METADATA).is_file() else ""
    except (OSError, ValueError):
        return ""
    start = head(path, 16)
    found = next((title for magic, title in _MAGIC if start.startswith(magic)), "")
    # Many programs keep their own things in SQLite.
    return "" if found == SQLITE and path.suffix.lower() != ".db3" else found


def open_bag(path: Path) -> Bag:
    """Open a bag, within :func:`bounded_decompression`; what its library raises passes through.

    Parameters
    ----------
    path : Path
        File, or folder with ``metadata.yaml``.

    Returns
    -------
    Bag
        To be closed.

    Raises
    ------
    InputError
        No bag, files outside its folder, a database that computes instead of holding data, messages defined in
        another way.
    """
    title = title_of(path)
    with ExitStack() as stack:
        files = _storage_files(path, stack) if title == FOLDER else [path]
        readers = []
        for file in files:
            reader = _reader(file)
            reader.open()
            stack.callback(reader.close)
            readers.append(reader)
            if isinstance(reader.path, BoundedPath):
                reader.path.allow(READ_FACTOR)
        store = _types(ros1=title == BAG1)
        if title == BAG1:
            _check_definitions(path, readers, store)
            decode = store.deserialize_ros1
        else:
            _check_serialization(path, readers)
            decode = store.deserialize_cdr
        return Bag(path, title or "ROS bag", readers, decode, stack.pop_all().close)
    raise AssertionError  # unreachable: the stack swallows nothing


@contextmanager
def bounded_decompression() -> Iterator[None]:
    """Let the library's decompressors of chunks give no more than a chunk states, or the limit.

    The library takes them from two tables, and has no other place where a limit could be set.

    Raises
    ------
    MissingExtraError
        If the library is absent.
    """
    try:
        from rosbags.rosbag1.reader import decompressors
        from rosbags.rosbag2.storage_mcap import DECOMPRESSORS
    except ImportError:
        raise MissingExtraError("rosbags", "formats", "A ROS bag") from None
    bz2, lz4 = importlib.import_module("bz2"), importlib.import_module("lz4.frame")
    bounded1 = {
        "bz2": partial(inflate, bz2.BZ2Decompressor),
        "lz4": partial(inflate, lz4.LZ4FrameDecompressor),
    }
    bounded2 = {
        "lz4": partial(inflate, lz4.LZ4FrameDecompressor),
        "zstd": partial(inflate, zstd().ZstdDecompressor),
    }
    before = dict(decompressors), dict(DECOMPRESSORS)
    decompressors.update(bounded1)
    DECOMPRESSORS.update(bounded2)
    try:
        yield
    finally:
        decompressors.update(before[0])
        DECOMPRESSORS.update(before[1])


@cache
def _types(*, ros1: bool) -> Any:
    """The definitions of ROS itself, made once."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def zstd() -> Any:
    """The module of zstd: of the standard library from Python 3.14 on, else the one that rosbags brings along."""
    try:
        return importlib.import_module("compression.zstd")
    except ImportError:
        return importlib.import_module("backports.zstd")


def _reader(file: Path) -> Any:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    title = title_of(file)
    if title == BAG1:
        return Reader1(BoundedPath(file, _SUFFIXES[title]))
    if title == SQLITE:
        _check_database(file)
        return Reader2(file)
    if title == MCAP:
        return Reader2(BoundedPath(file, _SUFFIXES[title]))
    raise InputError(f"{file} is no storage file of a bag, by its first bytes: copy it again.")


def _storage_files(folder: Path, stack: ExitStack) -> list[Path]:
    """The files that the metadata name, all of them inside the folder."""
    from ruamel.yaml import YAML

    metadata = folder / METADATA
    if metadata.stat().st_size > _METADATA_LIMIT:
        raise InputError(f"{metadata} is larger than any list of files of a bag: it is damaged; copy the folder again.")
    with library(metadata, "list of a bag's files"):
        text = metadata.read_text(encoding="utf-8")
    marks = np.frombuffer(text.encode("utf-8"), dtype=np.uint8)
    opened = np.isin(marks, _OPENING).astype(np.int64) - np.isin(marks, _CLOSING)
    if opened.size and int(np.cumsum(opened).max()) > _DEEPEST:
        # The parser's time grows with the square of the depth.
        raise InputError(f"{metadata} is nested deeper than any list of a bag's files: it is damaged.")
    with library(metadata, "list of a bag's files"):
        document = YAML(typ="safe", pure=True).load(text)
        names = [str(PurePosixPath(name)) for name in document["rosbag2_bagfile_information"]["relative_file_paths"]]
    if not names:
        raise InputError(f"{metadata} names no storage file: the recording was not closed properly; reindex the bag.")
    files = []
    for name in dict.fromkeys(names):
        parts = PurePosixPath(name).parts
        # Early versions put the bag's own folder in front of each name.
        file = folder / parts[-1] if len(parts) == 2 and parts[0] != ".." else folder / name
        if len(parts) > 2 or not file.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"{metadata} names {name[:200]!r}, which lies outside the bag: it is not read.")
        if not file.is_file():
            raise InputError(f"{metadata} names {name[:200]!r}, which is not in the folder: copy the bag whole.")
        files.append(_unpacked(file, stack) if head(file, 4) == ZSTD_MAGIC else file)
    return files


def _unpacked(file: Path, stack: ExitStack) -> Path:
    """Decompress a storage file into a temporary folder that goes with the bag."""
    limit = INFLATED_LIMIT + _INFLATED_FACTOR * file.stat().st_size
    place = Path(stack.enter_context(TemporaryDirectory(prefix="srt-"))) / file.name.removesuffix(".zstd")
    with zstd().open(file, "rb") as source, place.open("wb") as target:
        left = limit
        while block := source.read(1 << 20):
            left -= len(block)
            if left < 0 or shutil.disk_usage(place.parent).free < len(block):
                raise InputError(f"{file} grows beyond {limit - left >> 20} MiB: decompress it first, with zstd -d.")
            target.write(block)
    return place


def _check_database(file: Path) -> None:
    """Refuse a database in which reading a table runs what the file's author wrote, for as long as they like."""
    if any(mark in str(file) for mark in "?#%"):
        raise InputError(f"The path {file} has a '?', '#' or '%' in it, at which the reader stops: rename it.")
    start = head(file, 100)
    # A database that was cut off is read as if zeros followed.
    page = int.from_bytes(start[16:18], "big")
    stated = (1 << 16 if page == 1 else page) * int.from_bytes(start[28:32], "big")
    if file.stat().st_size < stated:
        raise InputError(f"{file} is cut off: it has {file.stat().st_size} bytes, but states {stated}; copy it again.")
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        database.execute("PRAGMA trusted_schema = OFF")
        computed = database.execute(
            "SELECT name FROM sqlite_master WHERE type IN ('view', 'trigger') OR sql LIKE 'CREATE VIRTUAL%' UNION ALL "
            "SELECT m.name FROM sqlite_master m JOIN pragma_table_xinfo(m.name) c WHERE m.type = 'table' AND c.hidden"
        ).fetchone()
    if computed:
        raise InputError(
            f"{file} has a table or view {str(computed[0])[:60]!r} that computes: no recorder writes such."
        )


def _check_definitions(path: Path, readers: Sequence[Any], store: Any) -> None:
    """Refuse messages that are called Imu, but are other ones."""
    for each in (connection for reader in readers for connection in reader.connections):
        if each.msgtype == "sensor_msgs/msg/Imu" and each.digest not in ("*", store.generate_msgdef(each.msgtype)[1]):
            raise InputError(
                f"{path}: topic {each.topic[:100]} has another definition of sensor_msgs/Imu than ROS: "
                "its readings cannot be told."
            )


def _check_serialization(path: Path, readers: Sequence[Any]) -> None:
    for each in (connection for reader in readers for connection in reader.connections):
        if each.msgtype == "sensor_msgs/msg/Imu" and each.ext.serialization_format != "cdr":
            raise InputError(
                f"{path}: topic {each.topic[:100]} is serialised as {each.ext.serialization_format[:40]!r}, but cdr "
                "is expected: record it with the default of ROS 2."
            )
