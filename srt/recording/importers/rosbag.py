"""ROS 1 bags, and ROS 2 bags (folder, SQLite or MCAP), without ROS: sensor_msgs/Imu, in rad/s and m/s² by definition.

The message definitions inside a bag are not used: rosbags makes Python code of them, and a faulty one of another topic
would prevent the reading of all. ``sensor_msgs/Imu`` has never changed; a ROS 1 bag states a checksum of its
definition, which is checked.
"""

from __future__ import annotations

import importlib
import mmap
import sqlite3
from array import array
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from srt.exceptions import InputError
from srt.recording.file_guards import clear_errors
from srt.recording.import_options import option
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.child_process import in_child
from srt.recording.importers.log_streams import Stream, choose, join, to_imported

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples

BAG1: Final = "ROS 1 bag"
MCAP: Final = "ROS 2 bag (MCAP)"
SQLITE: Final = "ROS 2 bag (SQLite)"
FOLDER: Final = "ROS 2 bag (folder)"

METADATA: Final = "metadata.yaml"

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_FIRST_BYTES = ((b"#ROSBAG V", BAG1), (b"\x89MCAP0\r\n", MCAP), (b"SQLite format 3\0", SQLITE))

_PROFILE = 17  # offset of the profile in an MCAP file: after the magic, the kind of the record and its length
_TOPICS_LISTED = 8  # topics that a message lists; a bag of a vehicle has hundreds


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """An open bag; its files are closed with the process."""

    path: Path  # of the file or folder
    title: str  # its kind
    reader: Any  # of rosbags
    decode: Callable[[bytes, str], Any]  # from serialised bytes and the name of their type

    def counts(self, message_type: str) -> dict[str, int]:
        """Number of messages in each topic of a type."""
        result: dict[str, int] = {}
        for connection in self.reader.connections:
            if connection.msgtype == message_type:
                result[connection.topic] = result.get(connection.topic, 0) + int(connection.msgcount)
        return result

    def listing(self) -> str:
        """The first topics, with their types."""
        there = sorted({f"{each.topic} ({each.msgtype})"[:100] for each in self.reader.connections})
        return ", ".join(there[:_TOPICS_LISTED]) + (" ..." if len(there) > _TOPICS_LISTED else "")

    def messages(self, topic: str, message_type: str) -> Iterator[tuple[int, Any]]:
        """Times of recording in ns, and messages."""
        wanted = [each for each in self.reader.connections if each.topic == topic and each.msgtype == message_type]
        for _, when, raw in self.reader.messages(connections=wanted):
            # A file without its folder does not state that each message is compressed; a serialised message never
            # starts with these bytes.
            plain = _zstd().decompress(raw) if raw[:4] == _ZSTD_MAGIC else raw
            yield when, self.decode(plain, message_type)


def title_of(path: Path) -> str:
    """Kind of bag at a path, by its content; empty if it is none. Never raises."""
    try:
        if path.is_dir():
            return FOLDER if (path / METADATA).is_file() else ""
    except (OSError, ValueError):
        return ""
    start = head(path, 16)
    found = next((title for magic, title in _FIRST_BYTES if start.startswith(magic)), "")
    # Many programs store their own data in SQLite.
    return "" if found == SQLITE and path.suffix.lower() != ".db3" else found


def open_bag(path: Path, message_type: str) -> Bag:
    """Open a bag, a file or a folder with ``metadata.yaml``; errors of rosbags pass through.

    Definition and serialisation of the messages of ``message_type`` are checked. Raises InputError: no bag, files
    outside its folder, a database that computes, another definition of the messages.
    """
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.rosbag2.storage_mcap import McapReader

    title = title_of(path)
    for file in path.iterdir() if title == FOLDER else [path]:
        kind = title_of(file) or (MCAP if head(file, 4) == _ZSTD_MAGIC else "")
        if kind and title == FOLDER and not file.resolve().is_relative_to(path.resolve()):
            raise InputError(f"{path} holds {file.name[:200]!r}, which lies outside the bag: it is not read.")
        if kind == SQLITE:
            _check_database(file)
    kinds: dict[str, Any] = {BAG1: Reader1, MCAP: McapReader, SQLITE: Reader2, FOLDER: Reader2}
    if title not in kinds:
        raise InputError(f"{path} is no storage file of a bag, by its first bytes: copy it again.")
    reader = kinds[title](_WithProfile(path) if title == MCAP and _lacks_profile(path) else path)
    reader.open()
    store = _definitions(ros1=title == BAG1)
    for connection in reader.connections:
        if connection.msgtype != message_type:
            continue
        topic = f"{path}: topic {connection.topic[:100]}"
        if title == BAG1 and connection.digest not in ("*", store.generate_msgdef(message_type)[1]):
            raise InputError(
                f"{topic} has another definition of sensor_msgs/Imu than ROS: its readings cannot be interpreted."
            )
        if title != BAG1 and connection.ext.serialization_format != "cdr":
            raise InputError(
                f"{topic} is serialised as {connection.ext.serialization_format[:40]!r}, but cdr is expected: record "
                "it with the default of ROS 2."
            )
    return Bag(path, title, reader, store.deserialize_ros1 if title == BAG1 else store.deserialize_cdr)


class _WithProfile:
    """Path of an MCAP file without profile that opens as one of profile "ros2", which rosbags requires.

    The four letters take the place of the first four of the library's name in the header, so that no offset changes.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def open(self, _mode: str) -> mmap.mmap:
        """Open a copy of the file in memory, of which only the changed page takes room."""
        with self._path.open("rb") as file:
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        length = int.from_bytes(content[_PROFILE + 4 : _PROFILE + 8], "little")
        header = (4).to_bytes(4, "little") + b"ros2" + (length - 4).to_bytes(4, "little")
        content[_PROFILE : _PROFILE + len(header)] = header
        return content

    def __str__(self) -> str:
        return str(self._path)


def _lacks_profile(path: Path) -> bool:
    """True for an MCAP file with an empty profile and a library's name of four letters or more."""
    lengths = head(path, _PROFILE + 8)[_PROFILE:]
    return lengths[:4] == bytes(4) and int.from_bytes(lengths[4:], "little") >= len("ros2")


@cache
def _definitions(*, ros1: bool) -> Any:
    """The message definitions of ROS itself."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def _zstd() -> Any:
    """The module of zstd: of the standard library from Python 3.14 on."""
    try:
        return importlib.import_module("compression.zstd")
    except ImportError:
        return importlib.import_module("backports.zstd")


def _check_database(file: Path) -> None:
    """Refuse a database that is cut off, or in which reading a table runs statements of the file's author."""
    if any(mark in str(file) for mark in "?#%"):
        raise InputError(f"The path {file} has a '?', '#' or '%' in it, which the reader cannot open: rename it.")
    start = head(file, 100)
    # SQLite reads a database that was cut off as if zeros followed.
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


IMU: Final = "sensor_msgs/msg/Imu"

_NS = 10**9  # ticks of a ROS stamp in a second

_FRAMES_LISTED = 4  # coordinate frames that a note lists
_FRAME_LENGTH = 40  # characters of each


class _Topic(NamedTuple):
    """Messages of one topic.

    Some drivers publish each sensor on a topic of its own, in messages of which the other half is empty.
    """

    stream: Stream  # six columns
    has_gyro: bool
    has_accel: bool
    frames: tuple[str, ...]  # coordinate frames named in the messages


def read_bag(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read the IMU of a bag, in this process; the option ``topic`` names one, or "GYRO,ACCEL". Raises InputError."""
    notes: list[str] = []
    with clear_errors(path, title_of(path) or "ROS bag"):
        bag = open_bag(path, IMU)
        counts = bag.counts(IMU)
    if not counts:
        raise InputError(
            f"{path} holds no topic of type {IMU} (topics: {bag.listing() or 'none'}): record the IMU as such."
        )
    first, _, second = (options.topic or "").partition(",")
    chosen = choose(path, "topic", counts, first.strip() or None, option("topic"), notes)
    topic = _load(bag, chosen, notes)
    if second:
        other = choose(path, "topic", counts, second.strip(), option("topic"), notes)
        topics = [topic, _load(bag, other, notes)]
    elif topic.has_gyro and topic.has_accel:
        topics = [topic]
    else:
        topics = _with_other_sensor(bag, topic, counts, notes)
    notes += [
        f"Topic {each.stream.name} has messages of several frames: {', '.join(each.frames)}."
        for each in topics
        if len(each.frames) > 1
    ]
    stream = topic.stream if len(topics) == 1 else join(*_sensors(path, topics), notes)
    return to_imported(stream, options, notes)


def _with_other_sensor(bag: Bag, topic: _Topic, counts: dict[str, int], notes: list[str]) -> list[_Topic]:
    """Find the one topic with the sensor that the chosen one lacks; the topic of the gyros comes first."""
    name = topic.stream.name
    has_any = topic.has_gyro or topic.has_accel
    others = [_load(bag, other, []) for other in sorted(counts) if other != name] if has_any else []
    found = [each for each in others if (each.has_gyro, each.has_accel) == (not topic.has_gyro, not topic.has_accel)]
    if len(found) != 1:
        lacks = "readings" if not has_any else "accelerometers" if topic.has_gyro else "gyros"
        raise InputError(
            f"{bag.path}: the messages of topic {name} hold no {lacks}: name the "
            f"topics of both sensors with {option('topic')} GYRO,ACCEL (topics: {', '.join(sorted(counts))})."
        )
    notes[:] = [note for note in notes if not note.startswith("Several IMUs")]
    return [topic, found[0]] if topic.has_gyro else [found[0], topic]


def _sensors(path: Path, topics: list[_Topic]) -> tuple[Stream, Stream]:
    """Gyros of the first topic and accelerometers of the second."""
    gyro, accel = topics
    for topic, present, sensor in ((gyro, gyro.has_gyro, "gyros"), (accel, accel.has_accel, "accelerometers")):
        if not present:
            raise InputError(f"{path}: the messages of topic {topic.stream.name} hold no {sensor}: name another.")
    parts = gyro.stream.values[:, :3], accel.stream.values[:, 3:]
    return replace(gyro.stream, values=parts[0]), replace(accel.stream, values=parts[1])


def _load(bag: Bag, name: str, notes: list[str]) -> _Topic:
    """Read all messages of a topic."""
    received, stamps, flat, absent = array("q"), array("q"), array("d"), array("d")
    frames: dict[str, None] = {}
    with clear_errors(bag.path, bag.title):
        for when, message in bag.messages(name, IMU):
            header, rate, force = message.header, message.angular_velocity, message.linear_acceleration
            received.append(when)
            stamps.append(header.stamp.sec * _NS + header.stamp.nanosec)
            flat.extend((rate.x, rate.y, rate.z, force.x, force.y, force.z))
            # By the message's definition, -1 in the first element of a covariance states that there is no such reading.
            absent.extend(
                (message.angular_velocity_covariance[0] == -1.0, message.linear_acceleration_covariance[0] == -1.0)
            )
            if len(frames) < _FRAMES_LISTED:
                frames.setdefault(header.frame_id[:_FRAME_LENGTH])
    time = np.array(stamps, dtype=np.int64)
    values = np.array(flat, dtype=np.float64).reshape(-1, 6)
    if time.size and not time.any():
        notes.append(f"The messages of topic {name} have no stamps: the times at which they were recorded were taken.")
        time = np.array(received, dtype=np.int64)
    # A sensor is there if it is neither stated to be absent nor all exactly zero; without messages, nothing is known.
    stated = [bool(each.all()) for each in np.array(absent).reshape(-1, 2).T]
    there = [not len(values) or bool(values[:, 3 * k : 3 * k + 3].any() and not stated[k]) for k in range(2)]
    return _Topic(Stream(name, time, _NS, values), there[0], there[1], tuple(frames))


def _importer(name: str, title: str, suffixes: tuple[str, ...], *kinds: str) -> Importer:
    read = in_child(f"{__name__}:{read_bag.__name__}", "rosbags", "A ROS bag")
    return Importer(name, title, suffixes, "formats", lambda path: title_of(path) in kinds, read, frozenset({"topic"}))


ROSBAG1: Final = _importer("rosbag1", BAG1, (".bag",), BAG1)
ROSBAG2: Final = _importer("rosbag2", "ROS 2 bag (folder, .mcap or .db3)", (".mcap", ".db3"), FOLDER, MCAP, SQLITE)
