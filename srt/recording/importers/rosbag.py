"""ROS 1 bags, and ROS 2 bags (folder, SQLite or MCAP), without ROS: sensor_msgs/Imu, in rad/s and m/s² by definition.

The message definitions inside a bag are not used: rosbags makes Python code of them, and a faulty one of another topic
would prevent the reading of all. ``sensor_msgs/Imu`` has never changed; a ROS 1 bag states a checksum of its
definition, which is checked.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.exceptions import InputError
from srt.recording.file_guards import clear_errors
from srt.recording.import_options import option
from srt.recording.importer_registry import Importer
from srt.recording.importers.child_process import in_child
from srt.recording.importers.log_streams import Stream, choose, join, to_imported
from srt.recording.importers.rosbag_storage import BAG1, FOLDER, MCAP, SQLITE, Bag, open_bag, title_of

if TYPE_CHECKING:
    from pathlib import Path

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples

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
