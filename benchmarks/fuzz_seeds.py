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

from srt.recording.import_options import ImportOptions, parse_columns

if TYPE_CHECKING:
    from collections.abc import Callable

ROWS = 24
NAMES = ("time", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "temperature")

TOML = """[recording]
samples = "samples.{suffix}"
kind = "rate"
gyro_unit = "rad/s"
accel_unit = "m/s^2"
time_unit = "s"
sample_rate_hz = 200.0
serial = "SN-0042"
date = "2024-02-29"
temperature_c = 21.5
[site]
latitude_deg = 45.0
gravity_m_s2 = 9.80665
height_m = 120.0
gravity_sigma_m_s2 = 5e-6
[fixture]
heading_deg = 10.0
alignment_sigma_mrad = 1.0
rotation_sigma_mrad = 1.0
[imu]
gyro_noise_deg_per_sqrt_h = 0.002
accel_noise_ug_per_sqrt_hz = 20.0
gyro_quantization_arcsec = 0.5
accel_quantization_m_s = 1e-5
gyro_bias_instability_deg_per_h = 0.003
accel_bias_instability_ug = 5.0
gyro_range_deg_s = 400.0
accel_range_g = 10.0
[[sequence]]
id = "1"
start_static_s = [0.0, 0.03]
end_static_s = [0.06, 0.11]
[[sequence]]
id = "own"
start_static_s = [0.06, 0.08]
end_static_s = [0.1, 0.11]
down = "z"
along_outer = "y"
rotations = [["y", 180.0], ["z", -90.0]]
"""

COUNTS_TOML = """[recording]
samples = "samples.csv"
gyro_unit = "counts"
gyro_lsb = [1e-4, 1e-4, 1e-4]
gyro_offset_counts = 3.0
accel_unit = "counts"
accel_lsb = 1e-3
accel_offset_counts = [1.0, 2.0, 3.0]
sample_rate_hz = 200.0
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


UNITS = ImportOptions(gyro_unit="deg/s", accel_unit="g", time_unit="ms")


def _made(write: Callable[[Path], Any], name: str = "file", *, options: ImportOptions | None = None) -> Seed:
    """Let a writer write, and take what is there afterwards."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / name
        write(place)
        options = options or ImportOptions()
        if place.is_dir():
            return Seed({each.name: each.read_bytes() for each in place.iterdir()}, ".", options)
        return Seed({name: place.read_bytes()}, name, options)


def _swapped(write: Callable[..., None], arguments: tuple[Any, ...], path: Path) -> None:
    """Write a file at a path that is given last."""
    write(path, *arguments)


def _columns() -> dict[str, np.ndarray]:
    stamps, values = ff.samples(ROWS)
    time = (stamps - stamps[0]) / 1e9 + 0.005
    return dict(zip(NAMES, (time, *values.T, np.linspace(20.0, 21.0, ROWS)), strict=True))


def rosbag1() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    whole, other = {"/imu": (stamps, values, "")}, {"/other": (stamps[:4], values[:4], "")}
    apart = {"/gyro": (stamps, values, "accel"), "/accel": (stamps[:20] + 1_000_000, values[:20], "gyro")}
    bags = (whole, ""), (whole, "bz2"), (whole | other, "lz4"), (apart, "")
    return [_made(partial(_swapped, ff.write_bag1, bag), "imu.bag") for bag in bags]


def rosbag2() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    whole = {"/imu": (stamps, values, "")}
    pairs = [("mcap", ""), ("mcap", "storage"), ("mcap", "message"), ("sqlite3", ""), ("mcap", "file")]
    folders = [_made(partial(_swapped, ff.write_bag2, (whole, *pair)), "bag") for pair in pairs]
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
    stamps, values = ff.samples(ROWS)
    us = ((stamps - stamps[0]) // 1000 + 1_000_000).astype(np.uint64)
    combined = ("sensor_combined", 0, ff.COMBINED, ff.combined(us, values))
    late = ("sensor_combined", 1, ff.COMBINED, ff.combined(us, values, -1000))
    increments = {
        "timestamp": us, "timestamp_sample": us, **ff.triad("delta_angle", values[:, :3]),
        **ff.triad("delta_velocity", values[:, 3:]),
        "delta_angle_dt": np.full(ROWS, 5000), "delta_velocity_dt": np.full(ROWS, 4900),
    }  # fmt: skip
    stamped = {"timestamp": us, "timestamp_sample": us}
    drivers = [
        (name, 0, ff.SENSOR, stamped | dict(zip("xyz", part.T, strict=True)))
        for name, part in (("sensor_gyro", values[:, :3]), ("sensor_accel", values[:, 3:]))
    ]
    logs = ([combined], {}), ([combined, late], {"instance": 1}), ([("vehicle_imu", 0, ff.VEHICLE_IMU, increments)], {})
    return [
        _made(partial(_swapped, ff.write_ulog, (topics,)), "log.ulg", options=ImportOptions(**options))
        for topics, options in (*logs, (drivers, {}))
    ]


def ardupilot() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    us = (stamps - stamps[0]) // 1000 + 1_000_000
    columns = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    imu = [("IMU", "QBffffff", columns, ff.imu_rows(us, values))]
    raw = [
        (name, "QBQfff", f"TimeUS,I,SampleUS,{kind}X,{kind}Y,{kind}Z",
         [[t, 0, t + late, *row] for t, row in zip(us, part, strict=True)])
        for name, kind, late, part in (("GYR", "Gyr", 0, values[:, :3]), ("ACC", "Acc", 9, values[:, 3:]))
    ]  # fmt: skip
    old = [(f"IMU{k}", "Qffffff", columns.replace("I,", ""), ff.imu_rows(us, values, None)) for k in ("", "2")]
    logs = [_made(partial(_swapped, ff.write_dataflash, (messages,)), "log.bin") for messages in (imu, raw, old)]
    return [*logs, _made(partial(_swapped, ff.write_dataflash_text, (imu,)), "log.log")]


def _text(header: str, table: np.ndarray, separator: str = ",", form: str = "%.9g") -> bytes:
    rows = [separator.join(form % value for value in row) for row in table.tolist()]
    return "\n".join(([header] if header else []) + rows + [""]).encode()


def euroc() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    header = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
    rows = [",".join(map(repr, (t, *row))) for t, row in zip(stamps.tolist(), values.tolist(), strict=True)]
    text = "\n".join([header + "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]", *rows, ""])
    return [Seed({"data.csv": text.encode()}, "data.csv")]


def kalibr() -> list[Seed]:
    text = euroc()[0].files["data.csv"].decode().partition("\n")[2]
    header = "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z\n"
    return [Seed({"imu0.csv": (header + text).encode()}, "imu0.csv")]


def imu_tk() -> list[Seed]:
    columns = _columns()
    time = columns["time"]
    pair = {
        f"xsens_{name}.mat": _text("", np.column_stack([time, *(columns[f"{key}_{a}"] for a in "xyz")]), "  ", "%.7e")
        for name, key in (("acc", "accel"), ("gyro", "gyro"))
    }
    options = ImportOptions(gyro_unit="rad/s", accel_unit="m/s^2", time_unit="s", second=Path("xsens_gyro.mat"))
    return [Seed(pair, "xsens_acc.mat", options)]


def csv() -> list[Seed]:
    columns = _columns()
    table = np.column_stack(list(columns.values()))
    dated = [f"2024-05-06T07:08:09.{k:03d}Z," + ",".join(map(repr, row)) for k, row in enumerate(table[:, 1:].tolist())]
    headless = replace(UNITS, time_unit=None, sample_rate_hz=100.0, columns=parse_columns("accel,gyro"), skip=0)
    commas = _text(";".join(NAMES), table, ";").replace(b".", b",")
    dates = "\n".join([",".join(NAMES), *dated, "," * 7, ""]).encode()
    return [
        Seed({"a.csv": _text(",".join(NAMES), table)}, "a.csv", UNITS),
        Seed({"a.txt": commas}, "a.txt", replace(UNITS, decimal_comma=True)),
        Seed({"a.log": _text("", table[:, [4, 5, 6, 1, 2, 3]], " ")}, "a.log", headless),
        Seed({"b.csv": dates}, "b.csv", replace(UNITS, time_unit=None)),
    ]


def npz() -> list[Seed]:
    columns = _columns()
    return [
        _made(lambda path: np.savez(path, **columns), "a.npz", options=UNITS),  # type: ignore[arg-type]
        _made(lambda path: np.savez_compressed(path, **columns), "a.npz", options=UNITS),  # type: ignore[arg-type]
    ]


def hdf5() -> list[Seed]:
    import h5py

    def write(path: Path, version: str = "earliest", **how: Any) -> None:
        with h5py.File(path, "w", libver=version) as file:
            for name, values in _columns().items():
                file.create_dataset(name, data=values, **how)

    def stated(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, values in _columns().items():
                of_sensor = {"g": "deg/s", "a": "m s-2", "t": "s"}
                file.create_dataset(name, data=values).attrs["units"] = of_sensor[name[0]]

    return [
        _made(write, "a.h5", options=UNITS),
        _made(lambda path: write(path, chunks=(8,), compression="gzip"), "a.h5", options=UNITS),
        _made(lambda path: write(path, "latest", chunks=(8,)), "a.h5", options=UNITS),
        _made(stated, "a.h5"),
    ]


def parquet() -> list[Seed]:
    import pyarrow as pa
    from pyarrow import parquet as writer

    table = pa.table(_columns())
    writers = [partial(writer.write_table, table, compression=each) for each in ("none", "snappy", "zstd")]
    return [_made(write, "a.parquet", options=UNITS) for write in writers]


def matlab() -> list[Seed]:
    import h5py

    columns = _columns()

    gyro, accel = (np.column_stack([columns[f"{name}_{a}"] for a in "xyz"]) for name in ("gyro", "accel"))
    navego = {"t": columns["time"], "wb": gyro, "fb": accel, "freq": 200.0}

    def version_73(path: Path) -> None:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in columns.items():
                file.create_dataset(name, data=values[None, :])
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")

    return [
        _made(lambda path: scipy.io.savemat(path, columns), "a.mat", options=UNITS),
        _made(lambda path: scipy.io.savemat(path, columns, do_compression=True), "a.mat", options=UNITS),
        _made(version_73, "a.mat", options=UNITS),
        _made(lambda path: scipy.io.savemat(path, {"imu1": navego}), "a.mat"),
    ]


def psins() -> list[Seed]:
    columns = _columns()
    table = np.column_stack([*(columns[name] for name in NAMES[1:7]), columns["time"]])
    return [
        _made(lambda path: scipy.io.savemat(path, {"imu": table}), "a.mat"),
        Seed({"a.bin": table.astype("<f8").tobytes()}, "a.bin"),
        Seed({"b.bin": table.astype("<f4").tobytes()}, "b.bin"),
        Seed({"a.txt": _text("", table, " ")}, "a.txt"),
    ]


def sensor_logger() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    return [
        _made(lambda path: ff.write_sensor_logger(path, stamps, values), "a.zip"),
        _made(lambda path: ff.write_sensor_logger(path, stamps, values, folder=True), "a"),
    ]


def phyphox() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    return [
        _made(lambda path: ff.write_phyphox(path, stamps, values), "a.zip"),
        _made(lambda path: ff.write_phyphox(path, stamps, values, mark=";"), "a.zip"),
    ]


def microstrain() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    return [Seed({"a.csv": ff.microstrain_text(stamps, values).encode()}, "a.csv", ImportOptions(time_unit="ns"))]


def xsens() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    return [Seed({"MT_0.txt": ff.xsens_text(stamps, values).encode()}, "MT_0.txt")]


def kf_gins() -> list[Seed]:
    columns = _columns()
    table = np.column_stack([columns[name] for name in NAMES[:7]])
    return [Seed({"imu.txt": _text("", table, " ")}, "imu.txt")]


def novatel() -> list[Seed]:
    stamps, values = ff.samples(ROWS)
    options = ImportOptions(gyro_lsb=(1e-6,) * 3, accel_lsb=(1e-6,) * 3)
    counts = np.round(1000.0 * values).astype(int)
    return [
        Seed({"a.log": ff.novatel_text(stamps, counts, name).encode()}, "a.log", options)
        for name in ("RAWIMUA", "RAWIMUSXA")
    ]


def vectornav() -> list[Seed]:
    text = ff.vectornav_text(ff.samples(ROWS)[1])
    return [Seed({"a.txt": text.encode()}, "a.txt", ImportOptions(sample_rate_hz=200.0))]


def recording_toml() -> list[Seed]:
    samples = _text(",".join(NAMES), np.column_stack(list(_columns().values())))
    others = {f"samples.{kind}": _samples(kind) for kind in ("npz", "h5")}
    return [
        Seed({"recording.toml": text.encode(), "samples.csv": samples, **others}, ".", damaged=("recording.toml",))
        for text in (TOML.format(suffix="csv"), COUNTS_TOML, TOML.format(suffix="h5"))
    ]


def _samples(kind: str) -> bytes:
    makers = {"npz": npz, "h5": hdf5, "parquet": parquet, "csv": csv}
    seed = makers[kind]()[0]
    return seed.files[seed.target]


def _recording(kind: str) -> Callable[[], list[Seed]]:
    def make() -> list[Seed]:
        name = f"samples.{kind}"
        toml = TOML.format(suffix=kind).encode()
        return [Seed({"recording.toml": toml, name: _samples(kind)}, ".", damaged=(name,))]

    return make


READERS: dict[str, Callable[[], list[Seed]]] = {
    make.__name__.replace("_", "-"): make
    for make in (
        rosbag1, rosbag2, ulog, ardupilot, matlab, hdf5, parquet, npz, euroc, kalibr, imu_tk, psins, sensor_logger,
        phyphox, microstrain, xsens, kf_gins, novatel, vectornav, csv,
    )
}  # fmt: skip
"""Seeds by the name of the importer."""

RECORDINGS: dict[str, Callable[[], list[Seed]]] = {
    "recording.toml": recording_toml,
    **{f"samples.{kind}": _recording(kind) for kind in ("csv", "npz", "parquet", "h5")},
}
"""Seeds for what load_recording reads itself."""
