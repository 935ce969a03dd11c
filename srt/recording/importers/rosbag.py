"""ROS 1 bags, and ROS 2 bags (folder, SQLite or MCAP), without ROS: sensor_msgs/Imu, in rad/s and m/s² by definition.

The message definitions inside a bag are not used: the library makes Python code of them, and those of one foreign
topic may hinder reading all others. ``sensor_msgs/Imu`` has been the same since it exists; a ROS 1 bag says by a
checksum whether it means that one.
"""

from __future__ import annotations

from array import array
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.import_options import option
from srt.recording.importer_registry import Importer
from srt.recording.importers import rosbag_storage
from srt.recording.importers.guarded import inflate, library, silence
from srt.recording.importers.log_streams import Stream, choose, join, to_imported

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import Imported
    from srt.types import Array

IMU: Final = "sensor_msgs/msg/Imu"

_MESSAGE_LIMIT = 1 << 16  # an Imu message has 300 to 400 bytes
_NS = 10**9


@dataclass(frozen=True, slots=True, eq=False)
class _Topic:
    """What a topic holds: a stream of six columns, and which sensors are in it.

    Attributes
    ----------
    stream : Stream
    has : (bool, bool)
        Whether it has gyros, and accelerometers: some drivers publish each on a topic of its own, in messages of
        which the other half is empty.
    frames : tuple of str
        Coordinate frames named in the messages.
    """

    stream: Stream
    has: tuple[bool, bool]
    frames: tuple[str, ...]


def _read(path: Path, options: ImportOptions) -> Imported:
    notes: list[str] = []
    with _open(path) as bag:
        counts = bag.counts(IMU)
        if not counts:
            raise InputError(
                f"{path} holds no topic of type {IMU} (topics: {bag.listing() or 'none'}): record the IMU as such."
            )
        first, _, second = (options.topic or "").partition(",")
        wanted = first.strip() or None
        chosen = choose(path, "topic", counts, wanted, option("topic"), notes)
        topic = _load(bag, chosen, notes)
        if second:
            other = choose(path, "topic", counts, second.strip(), option("topic"), notes)
            pair = [topic, _load(bag, other, notes)]
        elif all(topic.has):
            pair = [topic]
        else:
            pair = _with_partner(path, bag, topic, counts, notes)
    notes += [
        f"Topic {each.stream.name} has messages of several frames: {', '.join(each.frames)}."
        for each in pair
        if len(each.frames) > 1
    ]
    stream = pair[0].stream
    if len(pair) == 2:
        gyro, accel = _halves(path, pair)
        stream = join(gyro, accel, notes)
    return to_imported(stream, options, notes)


def _with_partner(
    path: Path, bag: rosbag_storage.Bag, topic: _Topic, counts: dict[str, int], notes: list[str]
) -> list[_Topic]:
    """Find the one topic that holds the sensor which the chosen one lacks."""
    name = topic.stream.name
    lacks = "accelerometers" if topic.has[0] else "gyros"
    others = [_load(bag, other, []) for other in sorted(counts) if other != name] if any(topic.has) else []
    partners = [each for each in others if each.has[0] != topic.has[0] and each.has[1] != topic.has[1]]
    if len(partners) != 1:
        raise InputError(
            f"{path}: the messages of topic {name} hold no {lacks if any(topic.has) else 'readings'}: name the "
            f"topics of both sensors with {option('topic')} GYRO,ACCEL (topics: {', '.join(sorted(counts))})."
        )
    pair = [topic, partners[0]]
    notes[:] = [note for note in notes if not note.startswith("Several IMUs")]
    return pair if topic.has[0] else pair[::-1]


def _halves(path: Path, pair: list[_Topic]) -> tuple[Stream, Stream]:
    """The gyros of the first topic and the accelerometers of the second."""
    for i, sensor in enumerate(("gyros", "accelerometers")):
        if not pair[i].has[i]:
            raise InputError(f"{path}: the messages of topic {pair[i].stream.name} hold no {sensor}: name another.")
    streams = [each.stream for each in pair]
    gyro, accel = (
        Stream(stream.name, stream.stamps, stream.per_second, stream.values[:, 3 * i : 3 * i + 3])
        for i, stream in enumerate(streams)
    )
    return gyro, accel


def _load(bag: rosbag_storage.Bag, name: str, notes: list[str]) -> _Topic:
    """Read all messages of a topic."""
    received, stamps, flat, absent = array("q"), array("q"), array("d"), array("d")
    frames: dict[str, None] = {}
    with library(bag.path, bag.title), silence():
        for when, raw in bag.messages(name, IMU):
            message = bag.decode(_plain(raw), IMU)
            header, rate, force = message.header, message.angular_velocity, message.linear_acceleration
            received.append(when)
            stamps.append(header.stamp.sec * _NS + header.stamp.nanosec)
            flat.extend((rate.x, rate.y, rate.z, force.x, force.y, force.z))
            # By the message's definition, -1 in the first element of a covariance says that there is no such reading.
            absent.extend(
                (message.angular_velocity_covariance[0] == -1.0, message.linear_acceleration_covariance[0] == -1.0)
            )
            if len(frames) < 4:
                frames.setdefault(header.frame_id[:40])
    time = np.array(stamps, dtype=np.int64)
    values = np.array(flat, dtype=np.float64).reshape(-1, 6)
    if time.size and not time.any():
        notes.append(f"The messages of topic {name} have no stamps: the times at which they were recorded were taken.")
        time = np.array(received, dtype=np.int64)
    return _Topic(Stream(name, time, _NS, values), _present(values, np.array(absent).reshape(-1, 2)), tuple(frames))


def _plain(raw: bytes) -> bytes:
    """Undo the compression of single messages that ROS 2 offers; a serialised message never starts like this."""
    if raw[:4] != rosbag_storage.ZSTD_MAGIC:
        return raw
    return inflate(rosbag_storage.zstd().ZstdDecompressor, raw, _MESSAGE_LIMIT)


def _present(values: Array, absent: Array) -> tuple[bool, bool]:
    """Whether there are readings of gyros and accelerometers: not said to be absent, and not all exactly zero."""
    if not len(values):
        return True, True
    zero = [not values[:, columns].any() for columns in (slice(0, 3), slice(3, 6))]
    gyro, accel = (not (empty or each.all()) for empty, each in zip(zero, absent.T, strict=True))
    return gyro, accel


@contextmanager
def _open(path: Path) -> Iterator[rosbag_storage.Bag]:
    """Open a bag, its decompressors bounded, and close it whatever happens."""
    title = rosbag_storage.title_of(path) or "ROS bag"
    with rosbag_storage.bounded_decompression():
        with library(path, title), silence():
            bag = rosbag_storage.open_bag(path)
        try:
            yield bag
        finally:
            bag.close()


def _sniff(*titles: str) -> Any:
    return lambda path: rosbag_storage.title_of(path) in titles


ROSBAG1: Final = Importer(
    "rosbag1",
    "ROS 1 bag",
    (".bag",),
    "formats",
    _sniff(rosbag_storage.BAG1),
    _read,
    frozenset({"topic"}),
)

ROSBAG2: Final = Importer(
    "rosbag2",
    "ROS 2 bag (folder, .mcap or .db3)",
    (".mcap", ".db3"),
    "formats",
    _sniff(rosbag_storage.FOLDER, rosbag_storage.MCAP, rosbag_storage.SQLITE),
    _read,
    frozenset({"topic"}),
)
