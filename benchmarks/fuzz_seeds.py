"""Valid small files of every format that is read, to be damaged by the fuzzer."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import foreign_files as ff
import numpy as np
import scipy.io

import srt
from srt.recording.import_options import ImportOptions, parse_columns
from srt.recording.recording import Fixture, Site

if TYPE_CHECKING:
    from collections.abc import Callable

ROWS = 24
STAMPS, VALUES = ff.samples(ROWS)
MICROSECONDS = ((STAMPS - STAMPS[0]) // 1000 + 1_000_000).astype(np.uint64)
GYRO, ACCEL = VALUES[:, :3], VALUES[:, 3:]
TIME, TEMPERATURE = (STAMPS - STAMPS[0]) / 1e9 + 0.005, np.linspace(20.0, 21.0, ROWS)
NAMES = ("time", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "temperature")
TABLE = np.column_stack([TIME, GYRO, ACCEL, TEMPERATURE])
COLUMNS = dict(zip(NAMES, TABLE.T, strict=True))
UNITS = ImportOptions(gyro_unit="deg/s", accel_unit="g", time_unit="ms")

RECORDING = srt.Recording(
    TIME, GYRO, ACCEL, Site(9.80665, 5e-6, 0.8), fixture=Fixture(0.2), temperature=TEMPERATURE, serial="SN-0042",
    date="2024-02-29", clock_sigma=1e-6, noise=srt.ImuNoise(1e-6, 2e-4, 2e-6, 1e-5, 1e-8, 5e-5, 40.0, 400.0),
    sample_rate_hz=200.0,
    sequences=(
        srt.SequenceLabel((0.0, 0.03), (0.06, 0.11), id="1"),
        srt.SequenceLabel((0.06, 0.08), (0.1, 0.11), "own", "z", "y", (("y", 3.0), ("z", -1.5))),
    ),
)  # fmt: skip
COUNTS_TOML = """[recording]
samples = "samples.csv"
gyro_unit = "counts"
gyro_lsb = [1e-4, 1e-4, 1e-4]
gyro_offset_counts = 3.0
accel_unit = "counts"
accel_lsb = 1e-3
accel_offset_counts = [1.0, 2.0, 3.0]
sample_rate_hz = 200.0
temperature_c = 21.5
[site]
latitude_deg = 45.0
height_m = 120.0
"""


@dataclass(frozen=True, slots=True)
class Seed:
    """A file, or the files of a folder, by name.

    ``target`` is what is read, "." for the folder itself; only files in ``damaged`` are mutated (all, if empty).
    """

    files: dict[str, bytes]
    target: str
    options: ImportOptions = field(default_factory=ImportOptions)
    damaged: tuple[str, ...] = ()


def _made(
    name: str, write: Callable[..., Any], *arguments: Any, options: ImportOptions | None = None, **how: Any
) -> Seed:
    """Let a writer write a file or a folder, and take what is there afterwards."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / name
        write(place, *arguments, **how)
        options = options or ImportOptions()
        if place.is_dir():
            return Seed({each.name: each.read_bytes() for each in place.iterdir()}, ".", options)
        return Seed({name: place.read_bytes()}, name, options)


def _text(name: str, text: str, options: ImportOptions | None = None) -> Seed:
    return Seed({name: text.encode()}, name, options or ImportOptions())


def _rows(table: np.ndarray, header: str = "", separator: str = ",", form: str = "%.9g") -> str:
    rows = [separator.join(form % value for value in row) for row in table.tolist()]
    return "\n".join(([header] if header else []) + rows + [""])


def rosbag1() -> list[Seed]:
    whole, other = {"/imu": (STAMPS, VALUES, "")}, {"/other": (STAMPS[:4], VALUES[:4], "")}
    apart = {"/gyro": (STAMPS, VALUES, "accel"), "/accel": (STAMPS[:20] + 1_000_000, VALUES[:20], "gyro")}
    bags = (whole, ""), (whole, "bz2"), (whole | other, "lz4"), (apart, "")
    return [_made("imu.bag", ff.write_bag1, *bag) for bag in bags]


def rosbag2() -> list[Seed]:
    pairs = [("mcap", ""), ("mcap", "storage"), ("mcap", "message"), ("sqlite3", ""), ("mcap", "file")]
    folders = [_made("bag", ff.write_bag2, {"/imu": (STAMPS, VALUES, "")}, *pair) for pair in pairs]
    alone = []
    for folder in folders[:4]:
        name = next(each for each in folder.files if each != "metadata.yaml")
        data = folder.files[name]
        alone.append(Seed({name: data}, name))
        if name.endswith(".mcap"):
            alone.append(Seed({name: _without_checksums(data)}, name))
    # Each storage file alone twice as often as with its folder: that is where the parsing is.
    return [*alone, *folders]


def _without_checksums(data: bytes) -> bytes:
    """MCAP whose chunks state no checksum, so that damage inside them is not found at once."""
    result, place = bytearray(data), 8
    while place + 9 <= len(data) - 8:
        (size,) = struct.unpack_from("<Q", data, place + 1)
        if data[place] == 0x06:
            result[place + 9 + 24 : place + 9 + 28] = bytes(4)
        place += 9 + size
    return bytes(result)


def ulog() -> list[Seed]:
    stamped = {"timestamp": MICROSECONDS, "timestamp_sample": MICROSECONDS}
    combined = ("sensor_combined", 0, ff.COMBINED, ff.combined(MICROSECONDS, VALUES))
    late = ("sensor_combined", 1, ff.COMBINED, ff.combined(MICROSECONDS, VALUES, -1000))
    increments = {
        **stamped, **ff.triad("delta_angle", GYRO), **ff.triad("delta_velocity", ACCEL),
        "delta_angle_dt": np.full(ROWS, 5000), "delta_velocity_dt": np.full(ROWS, 4900),
    }  # fmt: skip
    drivers = [
        (name, 0, ff.SENSOR, stamped | dict(zip("xyz", part.T, strict=True)))
        for name, part in (("sensor_gyro", GYRO), ("sensor_accel", ACCEL))
    ]
    logs = [combined], [("vehicle_imu", 0, ff.VEHICLE_IMU, increments)], drivers
    second = _made("log.ulg", ff.write_ulog, [combined, late], options=ImportOptions(instance=1))
    return [second, *(_made("log.ulg", ff.write_ulog, topics) for topics in logs)]


def ardupilot() -> list[Seed]:
    columns = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    imu = [("IMU", "QBffffff", columns, ff.imu_rows(MICROSECONDS, VALUES))]
    raw = [
        (name, "QBQfff", f"TimeUS,I,SampleUS,{kind}X,{kind}Y,{kind}Z",
         [[t, 0, t + late, *row] for t, row in zip(MICROSECONDS, part, strict=True)])
        for name, kind, late, part in (("GYR", "Gyr", 0, GYRO), ("ACC", "Acc", 9, ACCEL))
    ]  # fmt: skip
    rows = ff.imu_rows(MICROSECONDS, VALUES, None)
    old = [(f"IMU{k}", "Qffffff", columns.replace("I,", ""), rows) for k in ("", "2")]
    logs = [_made("log.bin", ff.write_dataflash, messages) for messages in (imu, raw, old)]
    return [*logs, _made("log.log", ff.write_dataflash_text, imu)]


def euroc() -> list[Seed]:
    header = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
    rows = [",".join(map(repr, (t, *row))) for t, row in zip(STAMPS.tolist(), VALUES.tolist(), strict=True)]
    return [_text("data.csv", "\n".join([header + "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]", *rows, ""]))]


def kalibr() -> list[Seed]:
    rows = euroc()[0].files["data.csv"].decode().partition("\n")[2]
    return [_text("imu0.csv", "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z\n" + rows)]


def imu_tk() -> list[Seed]:
    pair = {
        f"xsens_{name}.mat": _rows(np.column_stack([TIME, part]), "", "  ", "%.7e").encode()
        for name, part in (("acc", ACCEL), ("gyro", GYRO))
    }
    options = ImportOptions(gyro_unit="rad/s", accel_unit="m/s^2", time_unit="s", second=Path("xsens_gyro.mat"))
    return [Seed(pair, "xsens_acc.mat", options)]


def csv() -> list[Seed]:
    dated = [f"2024-05-06T07:08:09.{k:03d}Z," + ",".join(map(repr, row)) for k, row in enumerate(TABLE[:, 1:].tolist())]
    headless = replace(UNITS, time_unit=None, sample_rate_hz=100.0, columns=parse_columns("accel,gyro"), skip=0)
    commas = _rows(TABLE, ";".join(NAMES), ";").replace(".", ",")
    return [
        _text("a.csv", _rows(TABLE, ",".join(NAMES)), UNITS),
        _text("a.txt", commas, replace(UNITS, decimal_comma=True)),
        _text("a.log", _rows(np.column_stack([ACCEL, GYRO]), "", " "), headless),
        _text("b.csv", "\n".join([",".join(NAMES), *dated, "," * 7, ""]), replace(UNITS, time_unit=None)),
    ]


def npz() -> list[Seed]:
    return [_made("a.npz", write, options=UNITS, **COLUMNS) for write in (np.savez, np.savez_compressed)]


def _hdf5(path: Path, version: str = "earliest", *, stated: bool = False, **how: Any) -> None:
    import h5py

    with h5py.File(path, "w", libver=version) as file:
        for name, values in COLUMNS.items():
            column = file.create_dataset(name, data=values, **how)
            if stated:
                column.attrs["units"] = {"g": "deg/s", "a": "m s-2", "t": "s"}[name[0]]


def hdf5() -> list[Seed]:
    return [
        _made("a.h5", _hdf5, options=UNITS),
        _made("a.h5", _hdf5, options=UNITS, chunks=(8,), compression="gzip"),
        _made("a.h5", _hdf5, "latest", options=UNITS, chunks=(8,)),
        _made("a.h5", _hdf5, stated=True),
    ]


def parquet() -> list[Seed]:
    import pyarrow as pa
    from pyarrow import parquet as writer

    write = partial(writer.write_table, pa.table(COLUMNS))
    return [_made("a.parquet", write, options=UNITS, compression=each) for each in ("none", "snappy", "zstd")]


def matlab() -> list[Seed]:
    import h5py

    navego = {"t": TIME, "wb": GYRO, "fb": ACCEL, "freq": 200.0}

    def version_73(path: Path) -> None:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in COLUMNS.items():
                file.create_dataset(name, data=values[None, :])
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")

    return [
        _made("a.mat", scipy.io.savemat, COLUMNS, options=UNITS),
        _made("a.mat", scipy.io.savemat, COLUMNS, options=UNITS, do_compression=True),
        _made("a.mat", version_73, options=UNITS),
        _made("a.mat", scipy.io.savemat, {"imu1": navego}),
    ]


def psins() -> list[Seed]:
    table = np.column_stack([GYRO, ACCEL, TIME])
    return [
        _made("a.mat", scipy.io.savemat, {"imu": table}),
        Seed({"a.bin": table.astype("<f8").tobytes()}, "a.bin"),
        Seed({"b.bin": table.astype("<f4").tobytes()}, "b.bin"),
        _text("a.txt", _rows(table, "", " ")),
    ]


def novatel() -> list[Seed]:
    options = ImportOptions(gyro_lsb=(1e-6,) * 3, accel_lsb=(1e-6,) * 3)
    counts = np.round(1000.0 * VALUES).astype(int)
    return [_text("a.log", ff.novatel_text(STAMPS, counts, name), options) for name in ("RAWIMUA", "RAWIMUSXA")]


def _stored(kind: str) -> dict[str, bytes]:
    """Folder of a recording; samples as the seed of their format has them, so that no compression hides a damage."""
    made = _made("recording", lambda path: srt.write_recording(RECORDING, path, samples_format=kind)).files
    (samples,) = {"csv": csv, "npz": npz, "parquet": parquet, "h5": hdf5}[kind]()[0].files.values()
    return {**made, f"samples.{kind}": samples}


def recording_toml() -> list[Seed]:
    files = [_stored("csv"), _stored("h5")]
    # All kinds of samples are there, for a damaged name of the file.
    every = {**_stored("npz"), **files[0], **files[1]}
    texts = *(each["recording.toml"] for each in files), COUNTS_TOML.encode()
    return [Seed({**every, "recording.toml": text}, ".", damaged=("recording.toml",)) for text in texts]


def _samples(kind: str) -> list[Seed]:
    return [Seed(_stored(kind), ".", damaged=(f"samples.{kind}",))]


READERS: dict[str, Callable[[], list[Seed]]] = {
    **{
        make.__name__.replace("_", "-"): make
        for make in (
            rosbag1, rosbag2, ulog, ardupilot, matlab, hdf5, parquet, npz, euroc, kalibr, imu_tk, psins, novatel, csv,
        )
    },
    "sensor-logger": lambda: [
        _made("a.zip", ff.write_sensor_logger, STAMPS, VALUES),
        _made("a", ff.write_sensor_logger, STAMPS, VALUES, folder=True),
    ],
    "phyphox": lambda: [_made("a.zip", ff.write_phyphox, STAMPS, VALUES, mark) for mark in ",;"],
    "microstrain": lambda: [_text("a.csv", ff.microstrain_text(STAMPS, VALUES), ImportOptions(time_unit="ns"))],
    "xsens": lambda: [_text("MT_0.txt", ff.xsens_text(STAMPS, VALUES))],
    "kf-gins": lambda: [_text("imu.txt", _rows(TABLE[:, :7], "", " "))],
    "vectornav": lambda: [_text("a.txt", ff.vectornav_text(VALUES), ImportOptions(sample_rate_hz=200.0))],
}  # fmt: skip
"""Seeds by the name of the importer."""

RECORDINGS: dict[str, Callable[[], list[Seed]]] = {
    "recording.toml": recording_toml,
    **{f"samples.{kind}": partial(_samples, kind) for kind in ("csv", "npz", "parquet", "h5")},
}
"""Seeds for what load_recording reads itself."""
