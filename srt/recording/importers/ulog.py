"""PX4 logs (ULog): an IMU's rates, increments, or gyros and accelerometers apart, with the units that PX4 defines.

Topics in the order in which they are tried:

- ``sensor_combined``: means over ``gyro_integral_dt``, in rad/s and m/s², after PX4's own calibration;
- ``vehicle_imu``: increments over ``delta_angle_dt`` and ``delta_velocity_dt``, in rad and m/s, after it as well;
- ``sensor_gyro`` with ``sensor_accel``: readings as the driver gives them, in rad/s and m/s².
"""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, did_you_mean
from srt.recording.import_options import option
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.guarded import BoundedFile, library, require, silence
from srt.recording.importers.log_streams import Stream, choose_instance, join, to_imported

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import Imported
    from srt.types import Array, Counts

MAGIC: Final = b"ULog\x01\x12\x35"

COMBINED: Final = "sensor_combined"
INCREMENTS: Final = "vehicle_imu"
GYRO: Final = "sensor_gyro"
ACCEL: Final = "sensor_accel"

TOPICS: Final = {COMBINED: (COMBINED,), INCREMENTS: (INCREMENTS,), GYRO: (GYRO, ACCEL)}
"""What ``topic`` may say, and the topics of the log that it stands for, in order of preference."""

_US = 10**6
_TITLE = "ULog"
_LARGEST_MESSAGE = 65535  # a message's length is stated in two bytes
_FIELD_LIMIT = 4096  # of any message; PX4's largest have some hundreds
_OWN_FIELD_LIMIT = 64  # of those read here
_SUBSCRIBED_FIELDS = 200_000  # in all; a large log has ten thousand
_NOT_KNOWN_US = 0x7FFFFFFF  # in accelerometer_timestamp_relative
_DURATION_MISMATCH = 1e-3  # of gyro and accelerometer intervals, beyond which a note says so


@dataclass(frozen=True, slots=True, eq=False)
class _Log:
    """What is asked of a log once it has been parsed.

    Attributes
    ----------
    path : Path
    data : dict of (topic, instance) to dict of column to ndarray
    info : dict of str to object
        The log's own words on the system that wrote it.
    damaged : bool
    """

    path: Path
    data: dict[tuple[str, int], dict[str, NDArray[Any]]]
    info: dict[str, object]
    damaged: bool

    def instances(self, topic: str) -> list[int]:
        """Instances of a topic that hold samples."""
        return sorted(instance for name, instance in self.data if name == topic)

    def column(self, topic: str, instance: int, *names: str) -> Array:
        """Columns side by side, shape (n, len(names)), or (n,) for one."""
        data = self.data[topic, instance]
        missing = next((name for name in names if name not in data), None)
        if missing is not None:
            raise InputError(f"{self.path}: {topic} has no field {missing}: it is not PX4's topic of that name.")
        columns = [np.asarray(data[name], dtype=np.float64) for name in names]
        return columns[0] if len(columns) == 1 else np.stack(columns, axis=1)

    def stamps(self, topic: str, instance: int) -> Counts:
        """When the samples were taken, µs: the driver's stamp where there is one."""
        data = self.data[topic, instance]
        raw = data.get("timestamp_sample", data.get("timestamp"))
        if raw is None or raw.dtype != np.dtype(np.uint64):
            raise InputError(f"{self.path}: {topic} has no time stamps of 64 bits: it is not PX4's topic of that name.")
        if raw.size and int(raw.max()) >= 2**62:
            raise InputError(f"{self.path}: {topic} has stamps of more than 100 000 years: the log is damaged.")
        # Some drivers leave the sample's own stamp at zero.
        if not raw.any() and "timestamp" in data and data["timestamp"].dtype == raw.dtype:
            raw = np.minimum(data["timestamp"], np.uint64(2**62))
        return raw.astype(np.int64)


def _read(path: Path, options: ImportOptions) -> Imported:
    wanted = options.topic
    if wanted is not None and wanted not in TOPICS:
        raise InputError(
            f"{option('topic')} is {wanted!r}{did_you_mean(wanted, TOPICS)}, but a log is read from one "
            f"of {', '.join(TOPICS)}."
        )
    log = _parse(path)
    notes: list[str] = []
    if log.damaged:
        notes.append("The log is damaged; what could be read of it was read.")
    complete = [topic for topic, parts in TOPICS.items() if all(log.instances(part) for part in parts)]
    if not complete or wanted not in (None, *complete):
        there = ", ".join(f"{name} [{instance}]" for name, instance in sorted(log.data)) or "none of them"
        needed = " with ".join(TOPICS[wanted]) if wanted else f"{COMBINED}, {INCREMENTS}, or {GYRO} with {ACCEL}"
        raise InputError(f"{path} holds no samples of {needed} (found: {there}): log the IMU's topics.")
    topic = wanted or complete[0]
    instance = choose_instance(path, topic, log.instances(TOPICS[topic][0]), options.instance, notes)
    if len(complete) > 1 and wanted is None:
        notes.append(f"Read from {topic}; {', '.join(complete[1:])} would be read with {option('topic')}.")
    serial = log.info.get("sys_uuid")
    # What a damaged log holds in place of numbers shall not warn, but be found by the checks of a recording.
    with np.errstate(all="ignore"):
        stream, more = _READERS[topic](log, instance, notes)
    return to_imported(stream, options, notes, serial=serial if isinstance(serial, str) else None, **more)


def _combined(log: _Log, instance: int, notes: list[str]) -> tuple[Stream, dict[str, Any]]:
    """Gyro means at their stamps, accelerometers at theirs."""
    notes.append(f"PX4 has calibrated {COMBINED}: what is found here is left over from that calibration.")
    stamps = log.stamps(COMBINED, instance)
    gyro = log.column(COMBINED, instance, *_triad("gyro_rad"))
    accel = log.column(COMBINED, instance, *_triad("accelerometer_m_s2"))
    offset = log.column(COMBINED, instance, "accelerometer_timestamp_relative").astype(np.int64)
    known = offset != _NOT_KNOWN_US
    if not known.all():
        notes.append(f"{COMBINED}: {np.count_nonzero(~known)} samples without an accelerometer reading dropped.")
    if not offset[known].any():
        return Stream(COMBINED, stamps[known], _US, np.hstack([gyro, accel])[known]), {}
    # A slower accelerometer repeats its reading, stamp and all, until it has a new one.
    accel_stamps, first = np.unique(stamps[known] + offset[known], return_index=True)
    pair = (
        Stream(COMBINED, stamps, _US, gyro),
        Stream(COMBINED, accel_stamps, _US, accel[known][first]),
    )
    return join(*pair, notes), {}


def _increments(log: _Log, instance: int, notes: list[str]) -> tuple[Stream, dict[str, Any]]:
    notes.append(f"PX4 has calibrated {INCREMENTS}: what is found here is left over from that calibration.")
    values = [log.column(INCREMENTS, instance, *_triad(name)) for name in ("delta_angle", "delta_velocity")]
    spans = [log.column(INCREMENTS, instance, name) for name in ("delta_angle_dt", "delta_velocity_dt")]
    apart = np.abs(spans[0] - spans[1]) > _DURATION_MISMATCH * spans[0]
    if apart.any():
        notes.append(
            f"{INCREMENTS}: in {np.count_nonzero(apart)} of {apart.size} samples the velocity increment covers another "
            "time than the angle increment; it was scaled to the angle's."
        )
        # The mean specific force is the same over either interval to the accuracy at which they differ.
        values[1] = np.where(apart[:, None], values[1] * (spans[0] / spans[1])[:, None], values[1])
    stream = Stream(INCREMENTS, log.stamps(INCREMENTS, instance), _US, np.hstack(values))
    return stream, {"kind": "increment", "units": ("rad", "m/s")}


def _apart(log: _Log, instance: int, notes: list[str]) -> tuple[Stream, dict[str, Any]]:
    """Gyros and accelerometers as their drivers give them."""
    accels = log.instances(ACCEL)
    other = instance if instance in accels else accels[0]
    streams = []
    for topic, which in ((GYRO, instance), (ACCEL, other)):
        temperature = None
        if "temperature" in log.data[topic, which]:
            temperature = log.column(topic, which, "temperature")
        values = log.column(topic, which, "x", "y", "z")
        streams.append(Stream(f"{topic} [{which}]", log.stamps(topic, which), _US, values, temperature))
    return join(streams[0], streams[1], notes), {}


def _triad(name: str) -> tuple[str, ...]:
    return tuple(f"{name}[{i}]" for i in range(3))


_READERS: Final = {COMBINED: _combined, INCREMENTS: _increments, GYRO: _apart}


def _parse(path: Path) -> _Log:
    """Parse the topics of an IMU, after a look at the definitions."""
    pyulog = require("pyulog", "A PX4 log", lambda: __import__("pyulog"))
    wanted = sorted({part for parts in TOPICS.values() for part in parts})
    with closing(BoundedFile(path)) as file, library(path, _TITLE), silence():
        formats = pyulog.ULog(file, parse_header_only=True).message_formats
    sizes = {name: [(kind, count) for kind, count, _ in form.fields] for name, form in formats.items()}
    _check_formats(path, sizes, wanted)
    with closing(BoundedFile(path)) as file, library(path, _TITLE), silence():
        log = _frugal(pyulog.ULog)(file, wanted)
    data = {(each.name, each.multi_id): each.data for each in log.data_list}
    return _Log(path, data, log.msg_info_dict, bool(log.file_corruption))


def _frugal(base: Any) -> Any:
    """The library's parser, with an end to the fields that it makes for subscriptions, each of a few bytes."""
    left = _SUBSCRIBED_FIELDS

    class Added(base._MessageAddLogged):  # type: ignore[misc]
        def __init__(self, *args: Any) -> None:
            nonlocal left
            super().__init__(*args)
            left -= len(self.field_data)
            if left < 0:
                raise OSError("it subscribes to more fields than any log has")

    return type("Reader", (base,), {"_MessageAddLogged": Added})


def _check_formats(path: Path, formats: dict[str, list[tuple[str, int]]], wanted: list[str]) -> None:
    """Refuse definitions that unfold to more fields than a message has room for: the library would make them all."""
    fields: Counter[str] = Counter()

    def unfold(name: str, depth: int) -> int:
        if name not in formats:
            return 1
        if depth > len(formats) or depth > 32:
            raise InputError(f"{path}: the definition of {name[:40]!r} contains itself: the log is damaged.")
        if name not in fields:
            # Sums stop growing at the limit, so that their digits do not.
            total = 0
            for kind, count in formats[name]:
                total = min(total + max(count, 1) * unfold(kind, depth + 1), _LARGEST_MESSAGE)
            fields[name] = total
        return fields[name]

    for name in formats:
        limit = _OWN_FIELD_LIMIT if name in wanted else _FIELD_LIMIT
        if unfold(name, 0) > limit:
            raise InputError(
                f"{path}: the definition of {name[:40]!r} has more than {limit} fields: the log is damaged, or not "
                "one of PX4."
            )


def _sniff(path: Path) -> bool:
    return head(path, len(MAGIC)) == MAGIC


ULOG: Final = Importer(
    "ulog",
    "PX4 log (ULog)",
    (".ulg",),
    "formats",
    _sniff,
    _read,
    frozenset({"topic", "instance"}),
)
