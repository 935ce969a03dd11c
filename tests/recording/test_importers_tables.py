"""Tables of samples in foreign formats, each in a file that its own library wrote, and messages on faulty ones."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
import scipy.io

import srt
from srt.constants import DEG, STANDARD_GRAVITY_M_S2
from srt.exceptions import DataError, InputError
from srt.recording import importer_registry
from srt.recording.import_options import ImportOptions, parse_axis_map, parse_columns, parse_lsb, parse_offset
from srt.recording.imported_samples import (
    ImportedSamples,
    StatedUnits,
    join_streams,
    samples_in_si,
    to_recording,
    without_repeats,
)
from srt.recording.importer_registry import IMPORTERS, find_importer, import_file
from srt.recording.importers import channels
from srt.recording.importers.channels import meaning_of
from srt.recording.recording import Site

N = 40
RNG = np.random.default_rng(5)
TIME = 0.25 + np.arange(1, N + 1) / 128.0  # exact in binary
STAMPS = 1_403_636_579_758_555_392 + 5_000_001 * np.arange(N)
GYRO, ACCEL = RNG.normal(size=(N, 3)), RNG.normal(size=(N, 3))
SI = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}
SI_TIME = {**SI, "time_unit": "s"}
COLUMNS = {
    "time": TIME,
    **{f"gyro_{axis}": GYRO[:, i] for i, axis in enumerate("xyz")},
    **{f"accel_{axis}": ACCEL[:, i] for i, axis in enumerate("xyz")},
}
EUROC = "#timestamp [ns]," + ",".join(
    [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"] + [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
)
KALIBR = "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z"


def write_rows(path, header, columns, delimiter=","):
    """Write a table by Python's csv, which writes every digit of a float."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=delimiter)
        if header is not None:
            writer.writerow(header.split(","))
        writer.writerows(zip(*(np.asarray(column).tolist() for column in columns), strict=True))


def write_stamped(path, header):
    write_rows(path, header, [STAMPS, *GYRO.T, *ACCEL.T])


def write_npy(path):
    np.save(path, np.column_stack([TIME, GYRO, ACCEL]))


def write_hdf5(path):
    with pytest.importorskip("h5py").File(path, "w") as file:
        for name, column in COLUMNS.items():
            file.create_dataset(f"runs/first/{name}", data=column, compression="gzip")


def write_parquet(path):
    pa = pytest.importorskip("pyarrow")
    stamps = pa.array(STAMPS, type=pa.timestamp("ns"))
    table = pa.table({**COLUMNS, "time": stamps, "note": ["a"] * N})
    pytest.importorskip("pyarrow.parquet").write_table(table, path)


def write_matlab_73(path):
    """HDF5 as MATLAB 7.3 has it: behind 512 bytes of its own header, with the axes of arrays in reverse."""
    with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
        for name, values in (("time", TIME[None, :]), ("gyro", GYRO), ("accel", ACCEL)):
            node = file.create_dataset(f"imu/{name}", data=values.T)
            node.attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("imu/title", data=np.zeros((3, 1), dtype=np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


ARRAYS = {"time": TIME, "gyro": GYRO, "accel": ACCEL}
PSINS = np.column_stack([GYRO, ACCEL, TIME])
NAMED = parse_columns("time,gyro,accel")

# name: (file, format, writer, options)
ROUND_TRIPS = {
    "csv": ("a.csv", "csv", lambda p: write_rows(p, ",".join(COLUMNS), COLUMNS.values()), SI_TIME),
    "tab separated": ("a.tsv", "csv", lambda p: write_rows(p, ",".join(COLUMNS), COLUMNS.values(), "\t"), SI_TIME),
    "no header": (
        "a.txt",
        "csv",
        lambda p: np.savetxt(p, np.column_stack([ACCEL, TIME, GYRO])),
        {**SI_TIME, "columns": parse_columns("accel,time,gyro")},
    ),
    "quoted": (
        "q.csv",
        "csv",
        lambda p: p.write_text(
            ",".join(f'"{name}"' for name in COLUMNS)
            + "\n"
            + "".join(",".join(f'"{v!r}"' for v in row) + "\n" for row in np.column_stack([*COLUMNS.values()]).tolist())
        ),
        SI_TIME,
    ),
    "npz": ("a.npz", "npz", lambda p: np.savez_compressed(p, **COLUMNS), SI_TIME),
    "npz of triads": ("a.npz", "npz", lambda p: np.savez(p, **ARRAYS), SI_TIME),
    "npy": ("a.npy", "npz", write_npy, {**SI_TIME, "columns": NAMED}),
    "hdf5": ("a.hdf5", "hdf5", write_hdf5, {**SI_TIME, "variable": "runs/first"}),
    "matlab 5": ("a.mat", "matlab", lambda p: scipy.io.savemat(p, ARRAYS), SI_TIME),
    "matlab 7, struct": (
        "a.mat",
        "matlab",
        lambda p: scipy.io.savemat(
            p, {"log": {"imu": {**ARRAYS, "name": "unit", "cells": np.array(["a", 1.0], dtype=object)}}},
            do_compression=True,
        ),
        {**SI_TIME, "variable": "log.imu"},
    ),
    "matlab 4": ("a.mat", "matlab", lambda p: scipy.io.savemat(p, ARRAYS, format="4"), SI_TIME),
    "matlab 5, one table": (
        "a.mat",
        "matlab",
        lambda p: scipy.io.savemat(p, {"data": np.column_stack([TIME, GYRO, ACCEL]), "other": np.eye(2)}),
        {**SI_TIME, "columns": NAMED},
    ),
    "matlab 7.3": ("a.mat", "matlab", write_matlab_73, {**SI_TIME, "variable": "imu"}),
    "psins mat": ("a.mat", "psins", lambda p: scipy.io.savemat(p, {"imu": PSINS}), {}),
    "psins binary": ("a.bin", "psins", lambda p: PSINS.astype("<f8").tofile(p), {}),
    "psins text": ("a.txt", "psins", lambda p: np.savetxt(p, PSINS), {}),
}  # fmt: skip
STAMPED = {
    "euroc": ("data.csv", "euroc", lambda p: write_stamped(p, EUROC), {}),
    "kalibr": ("imu0.csv", "kalibr", lambda p: write_stamped(p, KALIBR), {}),
    "parquet": ("a.parquet", "parquet", write_parquet, SI),
    "npz of dates": (
        "a.npz",
        "npz",
        lambda p: np.savez(p, **{**ARRAYS, "time": STAMPS.astype("datetime64[ns]")}),
        SI,
    ),
}


@pytest.mark.parametrize("case", ROUND_TRIPS)
def test_round_trip(tmp_path, case):
    """Every bit comes back: all of these hold doubles, or as many digits."""
    name, kind, write, options = ROUND_TRIPS[case]
    write(tmp_path / name)
    importer, imported = import_file(tmp_path / name, ImportOptions(**options), "psins" if kind == "psins" else "auto")
    assert importer.name == kind
    np.testing.assert_array_equal(imported.time, TIME)
    np.testing.assert_array_equal(imported.gyro, GYRO)
    np.testing.assert_array_equal(imported.accel, ACCEL)
    assert imported.kind == ("increment" if kind == "psins" else "rate")


@pytest.mark.parametrize("rows", [8, 9, N])
def test_psins_floats_of_32_bits(tmp_path, rows):
    """Every bit of a float comes back; doubles of whatever digits are not taken for floats."""
    floats = PSINS[:rows].astype("<f4")
    floats.tofile(tmp_path / "a.bin")
    _, imported = import_file(tmp_path / "a.bin", name="psins")
    for values, columns in ((imported.gyro, slice(0, 3)), (imported.accel, slice(3, 6)), (imported.time, 6)):
        np.testing.assert_array_equal(values, floats[:, columns].astype(float))
    assert any("32-bit floats" in note for note in imported.notes)
    for doubles in (PSINS[:rows], floats, np.column_stack([np.zeros((rows, 6)), TIME[:rows]])):
        doubles.astype("<f8").tofile(tmp_path / "b.bin")
        _, imported = import_file(tmp_path / "b.bin", name="psins")
        np.testing.assert_array_equal(imported.time, doubles[:, 6])
        assert not any("32-bit floats" in note for note in imported.notes)
    with (tmp_path / "a.bin").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(InputError, match="no whole number of rows of 7 doubles"):
        import_file(tmp_path / "a.bin", name="psins")


@pytest.mark.parametrize("kind", ["text", "matlab"])
def test_psins_without_time_asks_for_the_rate(tmp_path, kind):
    path = tmp_path / {"text": "a.imu", "matlab": "a.mat"}[kind]
    if kind == "text":
        np.savetxt(path, PSINS[:, :6])
    else:
        scipy.io.savemat(path, {"imu": PSINS[:, :6]})
    _, imported = import_file(path, ImportOptions(sample_rate_hz=128.0), "psins")
    assert (imported.time, imported.kind) == (None, "increment")
    np.testing.assert_array_equal(imported.gyro, GYRO)
    np.testing.assert_array_equal(imported.accel, ACCEL)
    np.testing.assert_array_equal(to_recording(imported, Site(9.81)).time, np.arange(1, N + 1) / 128)
    with pytest.raises(InputError, match="no time stamps: give the rate with --sample-rate-hz"):
        to_recording(import_file(path, name="psins")[1], Site(9.81))


@pytest.mark.parametrize("case", STAMPED)
def test_nanoseconds_since_1970_lose_nothing(tmp_path, case):
    """Counted from the first as integers: a double would round them to 256 ns."""
    name, kind, write, options = STAMPED[case]
    write(tmp_path / name)
    importer, imported = import_file(tmp_path / name, ImportOptions(**options))
    assert importer.name == kind
    np.testing.assert_array_equal(imported.time, (STAMPS - STAMPS[0]) / 1e9)
    np.testing.assert_array_equal(imported.gyro, GYRO)
    np.testing.assert_array_equal(imported.accel, ACCEL)
    assert any("1403636579758555392 ns (2014-06-24" in note for note in imported.notes)


def test_euroc_by_its_folder(tmp_path):
    (tmp_path / "imu0").mkdir()
    write_stamped(tmp_path / "imu0" / "data.csv", EUROC)
    importer, imported = import_file(tmp_path / "imu0")
    assert importer.name == "euroc"
    np.testing.assert_array_equal(imported.gyro, GYRO)


def test_content_goes_before_the_suffix(tmp_path):
    with (tmp_path / "log.csv").open("wb") as file:
        np.savez(file, **ARRAYS)
    assert find_importer(tmp_path / "log.csv").name == "npz"


def test_imu_tk_pair(tmp_path):
    for name, values in (("acc", ACCEL), ("gyro", GYRO)):
        np.savetxt(tmp_path / f"unit_{name}.mat", np.column_stack([TIME, values]))
    options = ImportOptions(second=tmp_path / "unit_acc.mat", **SI_TIME)
    importer, imported = import_file(tmp_path / "unit_gyro.mat", options)
    assert importer.name == "imu-tk"
    np.testing.assert_array_equal(imported.gyro, GYRO)
    np.testing.assert_array_equal(imported.accel, ACCEL)
    assert imported.notes[0] == "Accelerometers from unit_acc.mat, gyros from unit_gyro.mat."


def test_pair_with_headers_and_stamps_of_its_own(tmp_path):
    """Phones log each sensor in ns at its own pace, with axes in reverse."""
    header = "time (ns),z,y,x"
    later = STAMPS + 1_000_000
    write_rows(tmp_path / "Accelerometer.csv", header, [STAMPS, *ACCEL.T[::-1]])
    write_rows(tmp_path / "Gyroscope.csv", header, [later, *GYRO.T[::-1]])
    options = ImportOptions(second=tmp_path / "Gyroscope.csv", **SI)
    _, imported = import_file(tmp_path / "Accelerometer.csv", options)
    # The last gyro sample lies behind the last accelerometer sample.
    np.testing.assert_array_equal(imported.gyro, GYRO[:-1])
    share = 1_000_000 / 5_000_001
    # Interpolation rounds a few times at the size of the readings.
    np.testing.assert_allclose(imported.accel, ACCEL[:-1] + share * np.diff(ACCEL, axis=0), atol=1e-12)
    assert any("linear interpolation" in note for note in imported.notes)


def test_joining_keeps_gaps_and_reproduces_a_line():
    """A straight line is its own interpolation, to a few roundings at its size."""
    accel_time = np.concatenate((np.arange(0.0, 1.0, 0.1), np.arange(5.0, 6.0, 0.1)))
    gyro_time = np.arange(0.025, 6.0, 0.05)
    line = np.array([1.0, -2.0, 0.5])
    notes = []
    kept, accel = join_streams(gyro_time, accel_time, accel_time[:, None] * line, notes)
    at = gyro_time[kept]
    np.testing.assert_allclose(accel, at[:, None] * line, atol=1e-13)
    assert not ((at > 0.9) & (at < 5.0)).any()
    inside = (gyro_time >= 0.0) & (gyro_time <= accel_time[9]) | (gyro_time >= 5.0) & (gyro_time <= accel_time[-1])
    assert len(at) == inside.sum()
    assert f"{len(gyro_time) - len(at)} gyro samples" in notes[1]
    with pytest.raises(InputError, match="no time in common"):
        join_streams(gyro_time, accel_time + 100.0, np.zeros((20, 3)), [])
    with pytest.raises(InputError, match="gyro readings cannot be joined"):
        join_streams(gyro_time[::-1], accel_time, np.zeros((20, 3)), [])


# Units and counts.


@pytest.mark.parametrize(
    ("header", "given", "gyro", "accel"),
    [
        ("time [s],gx (dps),gy (dps),gz (dps),ax (g),ay (g),az (g)", {}, DEG, STANDARD_GRAVITY_M_S2),
        (
            "time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,acc_x_mg,acc_y_mg,acc_z_mg",
            {},
            DEG,
            1e-3 * STANDARD_GRAVITY_M_S2,
        ),
        ("t,wx,wy,wz,ax,ay,az", {**SI_TIME, "gyro_unit": "dps", "accel_unit": "m/s2"}, DEG, 1.0),
        (
            "%time,field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,"
            "field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z",
            SI_TIME,
            1.0,
            1.0,
        ),
    ],
)
def test_units_of_header_and_options(tmp_path, header, given, gyro, accel):
    write_rows(tmp_path / "a.csv", header, [TIME, *GYRO.T, *ACCEL.T])
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(**given))
    np.testing.assert_array_equal(imported.gyro, GYRO * gyro)
    np.testing.assert_array_equal(imported.accel, ACCEL * accel)
    np.testing.assert_array_equal(imported.time, TIME)


@pytest.mark.parametrize("missing", ["gyro", "accel", "time"])
def test_a_unit_is_never_guessed(tmp_path, missing):
    write_rows(tmp_path / "a.csv", ",".join(COLUMNS), COLUMNS.values())
    options = {name: value for name, value in SI_TIME.items() if not name.startswith(missing)}
    with pytest.raises(InputError, match=f"in what unit its {missing} .*--{missing}-unit"):
        import_file(tmp_path / "a.csv", ImportOptions(**options))


def test_a_given_unit_overrides_the_format_with_a_note(tmp_path):
    write_stamped(tmp_path / "a.csv", EUROC)
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(gyro_unit="deg/s"))
    np.testing.assert_array_equal(imported.gyro, GYRO * DEG)
    assert "The file states rad/s for gyro; read as deg/s, as stated by the user." in imported.notes


def test_degrees_of_windows_programs_and_decimal_commas(tmp_path):
    rows = "".join(
        ";".join(f"{v!r}".replace(".", ",") for v in row) + "\r\n"
        for row in np.column_stack([*COLUMNS.values()]).tolist()
    )
    header = "Zeit;Gyro X (°/s);Gyro Y (°/s);Gyro Z (°/s);Acc X (m/s²);Acc Y (m/s²);Acc Z (m/s²)\r\n"
    (tmp_path / "a.csv").write_bytes(("Titel: Messung\r\n\r\n" + header + rows).encode("latin-1"))
    with pytest.raises(InputError, match="--decimal-comma"):
        import_file(tmp_path / "a.csv")
    options = ImportOptions(decimal_comma=True, columns={"time": "zeit"}, time_unit="s")
    _, imported = import_file(tmp_path / "a.csv", options)
    np.testing.assert_array_equal(imported.gyro, GYRO * DEG)
    np.testing.assert_array_equal(imported.accel, ACCEL)
    np.testing.assert_array_equal(imported.time, TIME)


def test_counts(tmp_path):
    counts = RNG.integers(0, 65536, size=(N, 6))
    write_rows(tmp_path / "a.csv", ",".join(COLUMNS), [TIME, *counts.T])
    options = ImportOptions(
        time_unit="s",
        gyro_lsb=parse_lsb("1/131 deg/s", "gyro"),
        accel_lsb=parse_lsb("1/415,1/413,1/415 m/s^2", "accel"),
        gyro_offset=parse_offset("32768", "gyro"),
        accel_offset=parse_offset("33123,33276,32360", "accel"),
    )
    _, imported = import_file(tmp_path / "a.csv", options)
    # Multiplying by a rounded quotient differs from dividing by one rounding of each.
    np.testing.assert_allclose(imported.gyro, (counts[:, :3] - 32768) / 131 * DEG, rtol=1e-15)
    expected = (counts[:, 3:] - [33123, 33276, 32360]) / [415.0, 413.0, 415.0]
    np.testing.assert_allclose(imported.accel, expected, rtol=1e-15)
    assert imported.units["accel"].startswith("counts (as given), of 0.00240964 0.00242131 0.00240964 m/s²")
    with pytest.raises(InputError, match="are counts: state the value of one count with --accel-lsb"):
        import_file(tmp_path / "a.csv", replace(options, accel_lsb=None, accel_unit="counts"))


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_lsb, "0"),
        (parse_lsb, "1/0"),
        (parse_lsb, "1,2"),
        (parse_lsb, "1 furlong"),
        (parse_lsb, "inf"),
        (parse_offset, "one"),
        (parse_offset, "1,2,3,4"),
    ],
)
def test_bad_counts(parse, text):
    with pytest.raises(InputError, match="--gyro-"):
        parse(text, "gyro")


def test_increments_are_first_class(tmp_path):
    header = "time [s],dtheta_x [deg],dtheta_y [deg],dtheta_z [deg],dv_x [m/s],dv_y [m/s],dv_z [m/s]"
    write_rows(tmp_path / "a.csv", header, [TIME, *GYRO.T, *ACCEL.T])
    _, imported = import_file(tmp_path / "a.csv")
    assert imported.kind == "increment"
    np.testing.assert_array_equal(imported.gyro, GYRO * DEG)
    write_rows(tmp_path / "b.csv", ",".join(COLUMNS), COLUMNS.values())
    options = ImportOptions(kind="increment", gyro_unit="rad/s", accel_unit="m/s", time_unit="s")
    with pytest.raises(InputError, match="rad/s of the gyro readings does not fit samples of kind increment"):
        import_file(tmp_path / "b.csv", options)


# Axes, channels, options.


def test_axis_maps(tmp_path):
    write_rows(tmp_path / "a.csv", ",".join(COLUMNS), COLUMNS.values())
    options = ImportOptions(map_gyro="y,x,-z", map_accel="x,y,-z", **SI_TIME)
    _, imported = import_file(tmp_path / "a.csv", options)
    np.testing.assert_array_equal(imported.gyro, GYRO[:, [1, 0, 2]] * [1, 1, -1])
    np.testing.assert_array_equal(imported.accel, ACCEL * [1, 1, -1])
    assert any(
        "one triad of gyros and accelerometers right-handed and the other left-handed" in note
        for note in imported.notes
    )


@pytest.mark.parametrize("text", ["x,y", "x,x,z", "x,y,w", "--x,y,z", "x,y,z,z", ""])
def test_bad_axis_maps(text):
    with pytest.raises(InputError, match=r"--map-gyro is .* each once"):
        parse_axis_map(text)


def test_column_maps():
    assert parse_columns("time,-,gyro,accel") == {
        "time": 1, "gyro_x": 3, "gyro_y": 4, "gyro_z": 5, "accel_x": 6, "accel_y": 7, "accel_z": 8,
    }  # fmt: skip
    assert parse_columns("gyro=w, time=t") == {"gyro": "w", "time": "t"}
    assert parse_columns("gyro_x=4") == {"gyro_x": 4}
    for text in ("time,time", "gyro,gyro_x", "time="):
        with pytest.raises(InputError, match="--columns"):
            parse_columns(text)
    with pytest.raises(InputError, match="did you mean gyro_x"):
        ImportOptions(columns=parse_columns("gyr_x=4"))


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("w_RS_S_y [rad s^-1]", "gyro_y", "rad/s"),
        ("Acc X (top)", "accel_x", None),
        ("gyr_z", "gyro_z", None),
        ("timestamp_ns", "time", "ns"),
        ("Temperature (°C)", "temperature", None),
        ("accel_x_m_s2", "accel_x", "m/s^2"),
        ("orientation.x", None, None),
        ("mag_x", None, None),
        ("scaledGyroX", "gyro_x", None),
        ("scaledAccelZ", "accel_z", None),
        ("UncompAcc Y [m/s^2]", "accel_y", "m/s^2"),
        ("X_ACCL", "accel_x", None),
        ("z_gyro (deg/s)", "gyro_z", "deg/s"),
        ("VelInc_X", "accel_x", None),
        ("xg", None, None),
    ],
)
def test_names_of_columns(name, channel, unit):
    found = meaning_of(name)
    assert (None if found is None else (found.channel, found.unit)) == (None if channel is None else (channel, unit))


def test_names_of_columns_can_be_added(tmp_path, monkeypatch):
    monkeypatch.setattr(channels, "COLUMN_NAMES", dict(channels.COLUMN_NAMES))
    channels._meanings.cache_clear()
    names = "Uhr,Kreisel X [deg/s],Kreisel Y [deg/s],Kreisel Z [deg/s],dV-Neu.x,dV-Neu.y,dV-Neu.z"
    try:
        channels.register_column_names("gyro", "Kreisel")
        channels.register_column_names("accel", "dV-Neu", kind="increment")
        channels.register_column_names("time", "Uhr")
        assert meaning_of("Kreisel X [deg/s]") == channels.ColumnMeaning("gyro_x", "deg/s")
        assert meaning_of("z kreisel") == channels.ColumnMeaning("gyro_z")
        assert meaning_of("dV-Neu.x") == channels.ColumnMeaning("accel_x", None, "increment")
        write_rows(tmp_path / "a.csv", names, [TIME, *GYRO.T, *ACCEL.T])
        _, imported = import_file(tmp_path / "a.csv", ImportOptions(accel_unit="m/s^2", time_unit="s"))
        np.testing.assert_array_equal(imported.gyro, GYRO * DEG)
        for bad in (("gyros", "rot"), ("accel", "Kreisel"), ("gyro", "acc"), ("time", "-")):
            with pytest.raises(InputError, match=r"is no channel|stands for another channel"):
                channels.register_column_names(*bad)
    finally:
        monkeypatch.undo()
        channels._meanings.cache_clear()
    assert meaning_of("z kreisel") is None


def test_columns_given_by_name_number_and_stem(tmp_path):
    names = "t0,rot_x,rot_y,rot_z,p,q,r"
    write_rows(tmp_path / "a.csv", names, [TIME, *GYRO.T, *ACCEL.T])
    columns = parse_columns("time=t0,gyro=rot,accel_x=p,accel_y=6,accel_z=r")
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(columns=columns, **SI_TIME))
    np.testing.assert_array_equal(imported.gyro, GYRO)
    np.testing.assert_array_equal(imported.accel, ACCEL)
    for said, fragment in (
        ("gyro=rat", r"no column rat_x \(did you mean rot_x\?\)"),
        ("time=9", "has 7 columns, but column 9"),
        ("gyro=rot", "no column was recognised as accel_x .*--columns accel_x=NAME"),
    ):
        with pytest.raises(InputError, match=fragment):
            import_file(tmp_path / "a.csv", ImportOptions(columns=parse_columns(said), **SI_TIME))


def test_two_columns_for_one_channel(tmp_path):
    write_rows(tmp_path / "a.csv", "t,gx,gy,gz,ax,ay,az,wx", [TIME, *GYRO.T, *ACCEL.T, TIME])
    with pytest.raises(InputError, match="several columns may be gyro_x"):
        import_file(tmp_path / "a.csv", ImportOptions(**SI_TIME))


def test_options_that_a_format_does_not_take_are_refused(tmp_path):
    write_stamped(tmp_path / "a.csv", EUROC)
    with pytest.raises(InputError, match="--topic is given, but the format euroc"):
        import_file(tmp_path / "a.csv", ImportOptions(topic="/imu"))
    with pytest.raises(InputError, match="--kind is increment, but this format holds samples of kind rate"):
        import_file(tmp_path / "a.csv", ImportOptions(kind="increment"))
    with pytest.raises(InputError, match="--gyro-lsb is given"):
        ImportOptions(gyro_unit="rad/s", gyro_lsb=(1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="did you mean"):
        ImportOptions(gyro_unit="rads/s")


# Registry, repeats, recordings.


def test_formats_by_name(tmp_path):
    (tmp_path / "a.xyz").write_bytes(b"\0\1\2" * 50)
    with pytest.raises(InputError, match=r"was not recognised: name it with --format, as one of .*euroc.*csv"):
        find_importer(tmp_path / "a.xyz")
    with pytest.raises(InputError, match="did you mean kalibr"):
        find_importer(tmp_path / "a.xyz", "kalib")
    with pytest.raises(InputError, match="There is no file"):
        find_importer(tmp_path / "absent.csv")
    for name in IMPORTERS:
        assert importer_registry.importer(name).name == name


def test_a_format_from_outside(monkeypatch, tmp_path):
    monkeypatch.setattr(importer_registry, "IMPORTERS", dict(IMPORTERS))
    importer_registry.register("mine", f"{__name__}:MINE")
    assert find_importer(_mark(tmp_path)).name == "mine"
    assert import_file(_mark(tmp_path))[1].sample_rate_hz == 10.0
    with pytest.raises(InputError, match="already"):
        importer_registry.register("mine", "a:b")


def _mark(folder):
    (folder / "a.mine").write_text("MINE")
    return folder / "a.mine"


MINE = importer_registry.Importer(
    "mine",
    "my own",
    (),
    None,
    lambda path: importer_registry.head(path) == b"MINE",
    lambda path, options: ImportedSamples(GYRO, ACCEL, sample_rate_hz=10.0),
)


def test_records_written_twice(tmp_path):
    rows = np.repeat(np.arange(N), np.where(np.arange(N) % 10 == 3, 2, 1))
    twice = ImportedSamples(GYRO[rows], ACCEL[rows], time=TIME[rows], temperature=TIME[rows])
    once = without_repeats(twice)
    np.testing.assert_array_equal(once.time, TIME)
    np.testing.assert_array_equal(once.gyro, GYRO)
    np.testing.assert_array_equal(once.temperature, TIME)
    assert once.notes == ("4 repeated samples (same stamp, same readings) dropped.",)
    # With other readings nobody knows which is right.
    changed = replace(twice, gyro=twice.gyro + np.arange(len(rows))[:, None])
    assert without_repeats(changed) is changed
    with pytest.raises(InputError, match="time must increase"):
        to_recording(changed, srt.Site(9.81))


def test_to_recording_without_stamps():
    imported = ImportedSamples(GYRO, ACCEL, sample_rate_hz=50.0, serial="from the file", date="2020-01-01")
    recording = to_recording(imported, srt.Site(9.81), serial="said", temperature_c=20.0)
    np.testing.assert_array_equal(recording.time, np.arange(1, N + 1) / 50.0)
    assert (recording.serial, recording.date, recording.temperature[7]) == ("said", "2020-01-01", 20.0)
    with pytest.raises(InputError, match="give the rate with --sample-rate-hz"):
        to_recording(replace(imported, sample_rate_hz=None), srt.Site(9.81))


@pytest.mark.parametrize("dtype", [np.uint32, np.uint64, np.int32])
def test_a_clock_that_goes_back_stays_so(dtype):
    """Unsigned counters must not wrap around to a time that rises."""
    stamps = np.array([3_000, 2_000, 4_000], dtype=dtype) + dtype(2_000_000_000)
    options = ImportOptions(**SI)
    imported = samples_in_si(options, gyro=GYRO[:3], accel=ACCEL[:3], time=stamps, stated=StatedUnits(time="ms"))
    np.testing.assert_array_equal(imported.time, [0.0, -1.0, 1.0])


def test_readings_beyond_doubles_are_refused_as_not_finite(tmp_path):
    np.savez(tmp_path / "a.npz", **{**ARRAYS, "accel": np.sign(ACCEL) * 1e308})
    _, imported = import_file(tmp_path / "a.npz", ImportOptions(gyro_unit="rad/s", accel_unit="g", time_unit="s"))
    with pytest.raises(InputError, match="must be a finite number"):
        to_recording(imported, srt.Site(9.81))


def test_arrays_that_disagree():
    with pytest.raises(InputError, match="time stamps for"):
        samples_in_si(ImportOptions(), gyro=GYRO, accel=ACCEL, time=TIME[1:], stated=StatedUnits("rad/s", "m/s^2", "s"))
    with pytest.raises(InputError, match="shape"):
        samples_in_si(ImportOptions(), gyro=GYRO, accel=ACCEL[1:], time=None, stated=StatedUnits("rad/s", "m/s^2"))


# Text that is wrong.

HEADER = ",".join(COLUMNS)
ROWS = [",".join(f"{v:.6f}" for v in row) for row in np.column_stack([*COLUMNS.values()])]


def spoiled(line, text):
    rows = list(ROWS)
    rows[line - 2] = text
    return "\n".join([HEADER, *rows]) + "\n"


@pytest.mark.parametrize(
    ("content", "fragments"),
    [
        ("", ["is empty"]),
        ("\n\n", ["is empty"]),
        ("just a letter\nto you\n", ["no row of numbers"]),
        ("a,b\0\0", ["not a text"]),
        ("\ufefftime,a".encode("utf-16"), ["UTF-16", "UTF-8"]),
        (spoiled(7, ROWS[5].replace("0.", "0.x", 1)), ["line 7, column 1 (time)", "a number is expected"]),
        (spoiled(7, ROWS[5].rpartition(",")[0] + ","), ["line 7, column 7 (accel_z)", "an empty cell"]),
        (spoiled(9, ROWS[7] + ROWS[8]), ["line 9", "13 cells", "has 7"]),
        (spoiled(9, "1,2,3"), ["line 9", "3 cells", "has 7"]),
        (spoiled(9, "1_0," + ROWS[7].partition(",")[2]), ["line 9, column 1", "'1_0'"]),
        ("\n".join([HEADER, *ROWS])[:-4], ["cut off in its last line"]),
        ("\n".join([HEADER, *ROWS])[:-20], ["line 41", "the file seems cut off"]),
        ("\n".join(ROWS), ["no column names", "--columns time,gyro,accel"]),
    ],
)
def test_text_that_is_wrong(tmp_path, content, fragments):
    path = tmp_path / "a.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        import_file(path, ImportOptions(**SI_TIME), "csv")
    message = str(caught.value)
    assert all(fragment in message for fragment in fragments), message
    assert message.count("\n") == 0
    assert str(path) in message


def test_a_longer_row_is_found_whatever_is_read(tmp_path):
    """Two lines run together would shift nothing that is read, and lose a sample."""
    path = tmp_path / "a.csv"
    path.write_text("note," + spoiled(9, ROWS[7] + ",0.0,7").replace("\n0", "\n1,0"))
    with pytest.raises(InputError, match="line 9"):
        import_file(path, ImportOptions(**SI_TIME))


def test_an_error_of_the_data_names_the_file(tmp_path, monkeypatch):
    def read(path, options):
        raise DataError("No IMU\x1b[0m here.")

    monkeypatch.setattr(importer_registry, "importer", lambda name: replace(MINE, read=read))
    with pytest.raises(DataError, match=r"a\.mine: No IMU\?\[0m here"):
        import_file(_mark(tmp_path), name="mine")
