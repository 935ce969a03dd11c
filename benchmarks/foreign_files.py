"""Small logs of an IMU in foreign formats, each written by the format's own library, for tests and the fuzzer.

ArduPilot's logs as text are written by hand: no library writes them.
"""

from __future__ import annotations

import zipfile
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

EPOCH_NS = 1_700_000_000_123_456_789
"""A stamp since 1970 that no double holds."""

IMU = "sensor_msgs/msg/Imu"


def samples(n: int = 24, seed: int = 1, interval_ns: int = 5_000_000) -> tuple[np.ndarray, np.ndarray]:
    """Stamps in ns and readings (n, 6), gyros first, that a float of 32 bits holds exactly."""
    rng = np.random.default_rng(seed)
    stamps = EPOCH_NS + interval_ns * np.arange(n, dtype=np.int64)
    values = rng.normal(size=(n, 6)) + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8])
    return stamps, values.astype(np.float32).astype(np.float64)


def imu_messages(store: Any, stamps: np.ndarray, values: np.ndarray, *, ros1: bool, absent: str = "") -> list[bytes]:
    """Serialised sensor_msgs/Imu; of an absent sensor ("gyro", "accel") all readings are zero."""
    kinds = {
        name.rpartition("/")[2]: kind
        for name, kind in store.types.items()
        if not name.startswith("std_msgs") or name.endswith("/Header")
    }
    values = values.copy()
    if absent:
        values[:, slice(0, 3) if absent == "gyro" else slice(3, 6)] = 0.0
    result = []
    for i, (stamp, row) in enumerate(zip(stamps.tolist(), values.tolist(), strict=True)):
        time = kinds["Time"](*divmod(stamp, 10**9))
        header = kinds["Header"](i, time, "imu") if ros1 else kinds["Header"](time, "imu")
        vectors = [kinds["Vector3"](*row[:3]), kinds["Vector3"](*row[3:])]
        nothing = np.zeros(9)
        message = kinds["Imu"](
            header, kinds["Quaternion"](0.0, 0.0, 0.0, 1.0), nothing, vectors[0], nothing, vectors[1], nothing
        )
        raw = (store.serialize_ros1 if ros1 else store.serialize_cdr)(message, IMU)
        result.append(bytes(raw))
    return result


Topics = dict[str, tuple[np.ndarray, np.ndarray, str]]
"""Stamps, readings and the absent sensor by name."""


def write_bag1(path: Path, topics: Topics, compression: str = "") -> None:
    """ROS 1 bag."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    write_messages(writer, get_typestore(Stores.ROS1_NOETIC), topics, ros1=True)


def write_messages(writer: Any, store: Any, topics: Topics, *, ros1: bool) -> None:
    """Write the messages of a bag, and close it."""
    with writer:
        for name, (stamps, values, absent) in topics.items():
            connection = writer.add_connection(name, IMU, typestore=store)
            raw = imu_messages(store, stamps, values, ros1=ros1, absent=absent)
            for stamp, message in zip(stamps.tolist(), raw, strict=True):
                writer.write(connection, abs(stamp), message)


def write_bag2(path: Path, topics: Topics, storage: str = "mcap", compression: str = "") -> None:
    """ROS 2 bag folder of storage "mcap" or "sqlite3"; compression "", "file", "message" or "storage"."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
    from rosbags.typesys import Stores, get_typestore

    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    write_messages(writer, get_typestore(Stores.ROS2_HUMBLE), topics, ros1=False)


def write_ulog(
    path: Path,
    topics: list[tuple[str, int, str, dict[str, np.ndarray]]],
    parameters: dict[str, float] | None = None,
    changed: tuple[tuple[int, str, float], ...] = (),
) -> None:
    """PX4 log; topics are name, instance, definition ("uint64_t timestamp;float x;") and columns by flat name.

    ``parameters`` are those at the start, ``changed`` later ones with their time in µs.
    """
    from pyulog import ULog

    log = ULog(None)
    for name, _, definition, _ in topics:
        log.message_formats[name] = ULog.MessageFormat(f"{name}:{definition}".encode(), None)
    for number, (name, instance, _, columns) in enumerate(topics):
        head = bytes([instance]) + number.to_bytes(2, "little") + name.encode()
        added = ULog._MessageAddLogged(head, None, log.message_formats)
        table = np.zeros(len(next(iter(columns.values()))), added.dtype)
        for column, values in columns.items():
            table[column] = values
        added.buffer = bytearray(table.tobytes())
        log.data_list.append(ULog.Data(added))
    log._initial_parameters.update(parameters or {})
    log._changed_parameters.extend(changed)
    log.msg_info_dict["sys_uuid"] = "000100000000"
    log._msg_info_dict_types["sys_uuid"] = "char[12]"
    log.write_ulog(str(path))


def triad(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Columns name[0] to name[2]."""
    return {f"{name}[{i}]": values[:, i] for i in range(3)}


COMBINED = (
    "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;int32_t accelerometer_timestamp_relative;"
    "float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;uint8_t accelerometer_clipping;"
    "uint8_t[3] _padding0;"
)
VEHICLE_IMU = (
    "uint64_t timestamp;uint64_t timestamp_sample;uint32_t accel_device_id;uint32_t gyro_device_id;"
    "float[3] delta_angle;float[3] delta_velocity;uint32_t delta_angle_dt;uint32_t delta_velocity_dt;"
    "uint8_t delta_velocity_clipping;uint8_t accel_calibration_count;uint8_t gyro_calibration_count;"
    "uint8_t[5] _padding0;"
)
SELECTION = "uint64_t timestamp;uint32_t accel_device_id;uint32_t gyro_device_id;"
SENSOR = "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;float temperature;"


def combined(stamps_us: np.ndarray, values: np.ndarray, offset_us: int = 0) -> dict[str, np.ndarray]:
    """Columns of sensor_combined."""
    return {
        "timestamp": stamps_us,
        **triad("gyro_rad", values[:, :3]),
        **triad("accelerometer_m_s2", values[:, 3:]),
        "accelerometer_timestamp_relative": np.full(len(values), offset_us),
        "gyro_integral_dt": np.full(len(values), 5000),
    }


def write_dataflash(path: Path, messages: list[tuple[str, str, str, list[list[Any]]]]) -> None:
    """ArduPilot log, binary; messages are name, format ("QBffffff"), columns with commas between, and rows."""
    from pymavlink.DFReader import DFFormat, DFReader_binary

    formats = {0x80: DFFormat(0x80, "FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns")}
    maker = SimpleNamespace(formats=formats)
    parts = [DFReader_binary.make_format_msgbuf(maker, formats[0x80])]
    for number, (name, layout, columns, rows) in enumerate(messages):
        form = DFFormat(0x81 + number, name, 0, layout, columns)
        parts.append(DFReader_binary.make_format_msgbuf(maker, form))
        parts += [DFReader_binary.make_msgbuf(maker, form, row) for row in rows]
    path.write_bytes(b"".join(parts))


PARM = ("PARM", "QNf", "TimeUS,Name,Value")
"""Name, format and columns of the message of a parameter."""


def parameter_message(parameters: dict[str, float], *, text: bool = False) -> tuple[str, str, str, list[list[Any]]]:
    """Messages of parameters at 1 s."""
    rows = [[1_000_000, name if text else name.encode(), value] for name, value in parameters.items()]
    return (*PARM, rows)


def write_dataflash_text(path: Path, messages: list[tuple[str, str, str, list[list[Any]]]]) -> None:
    """The same as text."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    for number, (name, layout, columns, rows) in enumerate(messages):
        lines.append(f"FMT, {129 + number}, 40, {name}, {layout}, {columns}")
        lines += [", ".join((name, *(v if isinstance(v, str) else repr(v) for v in row))) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_sensor_logger(
    path: Path,
    stamps: np.ndarray,
    values: np.ndarray,
    tables: tuple[str, str] = ("TotalAcceleration", "Gyroscope"),
    *,
    folder: bool = False,
) -> None:
    """Zip archive, or folder, of the app Sensor Logger: a table of each sensor, with axes in reverse."""
    seconds = (stamps - stamps[0]) / 1e9
    files = {"Metadata.csv": "version,device name\n3,phone\n"}
    for name, columns in zip(tables, (values[:, 3:], values[:, :3]), strict=True):
        rows = zip(stamps.tolist(), seconds.tolist(), columns[:, ::-1].tolist(), strict=True)
        lines = [",".join(map(repr, (stamp, second, *row))) for stamp, second, row in rows]
        files[f"{name}.csv"] = "\n".join(["time,seconds_elapsed,z,y,x", *lines]) + "\n"
    if folder:
        path.mkdir()
        for name, text in files.items():
            (path / name).write_text(text, encoding="ascii")
        return
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)


def write_phyphox(path: Path, stamps: np.ndarray, values: np.ndarray, mark: str = ",") -> None:
    """Zip archive of the app phyphox; with a semicolon it writes decimal commas."""
    seconds = (stamps - stamps[0]) / 1e9
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, word, unit, columns in (
            ("Accelerometer.csv", "Acceleration", "m/s^2", values[:, 3:]),
            ("Gyroscope.csv", "Gyroscope", "rad/s", values[:, :3]),
            ("Linear Acceleration.csv", "Linear Acceleration", "m/s^2", 0.0 * values[:, 3:]),
        ):
            head = mark.join(f'"{text}"' for text in ("Time (s)", *(f"{word} {axis} ({unit})" for axis in "xyz")))
            rows = [mark.join(map(repr, (t, *row))) for t, row in zip(seconds.tolist(), columns.tolist(), strict=True)]
            text = "\n".join([head, *rows, ""])
            archive.writestr(name, text.replace(".", ",") if mark == ";" else text)


def microstrain_text(stamps: np.ndarray, values: np.ndarray) -> str:
    """Table of SensorConnect: rad/s and g, the names as public programs quote them, other columns between."""
    unit = "inertial-6253.76535"
    accel, gyro = ([f"{unit}:scaled{sensor}{a}" for a in "XYZ"] for sensor in ("Accel", "Gyro"))
    names = ["Time", *accel, f"{unit}:flags", *gyro]
    rows = [
        ",".join(map(repr, (t, *(v / 9.80665 for v in row[3:]), 0, *row[:3])))
        for t, row in zip(stamps.tolist(), values.tolist(), strict=True)
    ]
    return "\n".join(["DATA_START", ",".join(names), *rows, ""])


def xsens_text(stamps: np.ndarray, values: np.ndarray) -> str:
    """Export of MT Manager: its head, ticks of 0.1 ms, m/s² and rad/s."""
    ticks = ((stamps - stamps[0]) // 100_000).tolist()
    rate = 1e9 / float(np.median(np.diff(stamps)))
    names = ["PacketCounter", "SampleTimeFine", *(f"{part}_{a}" for part in ("Acc", "Gyr") for a in "XYZ")]
    rows = [
        "\t".join(map(repr, (i, t, *row[3:], *row[:3])))
        for i, (t, row) in enumerate(zip(ticks, values.tolist(), strict=True))
    ]
    head = ["// Start Time: Unknown", f"// Update Rate: {rate:.1f}Hz", "// Filter Profile: human (46.1)"]
    return "\n".join([*head, "\t".join(names), *rows, ""])


def bitwise_crc(text: str) -> int:
    """NovAtel's CRC by its definition."""
    total = 0
    for byte in text.encode():
        total ^= byte
        for _ in range(8):
            total = (total >> 1) ^ (0xEDB88320 if total & 1 else 0)
    return total


def novatel_text(stamps: np.ndarray, counts: np.ndarray, name: str = "RAWIMUSA") -> str:
    """Messages of raw increments in counts."""
    lines = ["#BESTPOSA,USB1,0,0;not an IMU*00000000"]
    info = "00,5," if "X" in name.removeprefix("RAW") else ""
    seconds = (stamps % (604800 * 10**9) / 1e9).tolist()
    for stamp, (gx, gy, gz, ax, ay, az) in zip(seconds, counts.tolist(), strict=True):
        text = f"{name},2200,{stamp:.6f};{info}2200,{stamp:.9f},00000077,{az},{-ay},{ax},{gz},{-gy},{gx}"
        lines.append(f"#{text}*{bitwise_crc(text):08x}")
    return "\n".join([*lines, ""])


def vectornav_text(values: np.ndarray) -> str:
    """Messages VNIMU: magnetometer, accelerations, rates, temperature, pressure."""
    lines = ["$VNYMR,+1.0,+2.0*00"]
    for gx, gy, gz, ax, ay, az in values.tolist():
        text = f"VNIMU,+0.1,-0.2,+0.3,{ax!r},{ay!r},{az!r},{gx!r},{gy!r},{gz!r},+25.5,+101.3"
        total = 0
        for byte in text.encode():
            total ^= byte
        lines.append(f"${text}*{total:02X}")
    return "\r\n".join([*lines, ""])


def imu_rows(stamps: np.ndarray, values: np.ndarray, instance: int | None = 0) -> list[list[Any]]:
    """Rows of messages: stamp, instance (None: no such column) and readings."""
    first = [] if instance is None else [instance]
    return [[stamp, *first, *row] for stamp, row in zip(stamps.tolist(), values.tolist(), strict=True)]
