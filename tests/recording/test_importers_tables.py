"""Tables of samples in foreign formats, each in a file that its own library wrote, and messages on faulty ones."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from table_files import (
    ACCEL,
    ARRAYS,
    COLUMNS,
    EUROC,
    GYRO,
    PSINS,
    ROUND_TRIPS,
    ROWS,
    SI,
    SI_TIME,
    STAMPS,
    TIME,
    N,
    assert_readings,
    write_rows,
    write_stamped,
)

import srt
from srt.exceptions import DataError, InputError
from srt.recording import importer_registry
from srt.recording.import_options import ImportOptions
from srt.recording.imported_samples import (
    ImportedSamples,
    StatedUnits,
    join_streams,
    samples_in_si,
    to_recording,
    without_repeats,
)
from srt.recording.importer_registry import IMPORTERS, find_importer, import_file
from srt.recording.recording import Site

KALIBR = "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z"


def write_parquet(path):
    pa = pytest.importorskip("pyarrow")
    stamps = pa.array(STAMPS, type=pa.timestamp("ns"))
    table = pa.table({**COLUMNS, "time": stamps, "note": ["a"] * N})
    pytest.importorskip("pyarrow.parquet").write_table(table, path)


STAMPED = {
    "euroc": ("data.csv", "euroc", lambda p: write_stamped(p, EUROC), {}),
    "kalibr": ("imu0.csv", "kalibr", lambda p: write_stamped(p, KALIBR), {}),
    "parquet": ("a.parquet", "parquet", write_parquet, SI),
    "npz of dates": ("a.npz", "npz", lambda p: np.savez(p, **{**ARRAYS, "time": STAMPS.astype("datetime64[ns]")}), SI),
}


@pytest.mark.parametrize("case", ROUND_TRIPS)
def test_round_trip(tmp_path, case):
    """Every bit comes back: all of these hold doubles, or as many digits."""
    name, kind, write, options = ROUND_TRIPS[case]
    write(tmp_path / name)
    importer, imported = import_file(tmp_path / name, ImportOptions(**options), "psins" if kind == "psins" else "auto")
    assert importer.name == kind
    assert_readings(imported, GYRO, ACCEL, TIME)
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


def _increments(rows, rate_hz=128.0):
    """Increments of a unit that is turned, after an hour of recording."""
    step = 1.0 / rate_hz
    gyro, accel = (np.resize(values, (rows, 3)) for values in (GYRO, ACCEL))
    force = 9.8 * accel / np.linalg.norm(accel, axis=1)[:, None]
    return np.column_stack([gyro * step, force * step, 3600.0 + step * np.arange(rows)])


@pytest.mark.parametrize("kind", ["<f8", "<f4"])
@pytest.mark.parametrize("name", ["a.bin", "a.imu"])
def test_psins_in_binary_is_recognised(tmp_path, kind, name):
    table = _increments(100).astype(kind)
    table.tofile(tmp_path / name)
    importer, imported = import_file(tmp_path / name)
    assert (importer.name, imported.kind) == ("psins", "increment")
    np.testing.assert_array_equal(imported.time, table[:, 6].astype(float))
    np.testing.assert_array_equal(imported.accel, table[:, 3:6].astype(float))


def _other_binaries():
    table = _increments(100)
    return {
        "rates": table * np.repeat([128.0, 1.0], [6, 1]),
        "accelerometers first": table[:, [3, 4, 5, 0, 1, 2, 6]],
        "time first": table[:, [6, 0, 1, 2, 3, 4, 5]],
        "noise": np.random.default_rng(3).normal(size=(100, 7)),
        "bytes": np.frombuffer(np.random.default_rng(4).bytes(5600), "<f8"),
        "zeros": np.zeros((100, 7)),
        "few rows": table[:5],
        "cut off": table.ravel()[:-1],
        "time stands still": np.column_stack([table[:, :6], np.repeat(table[::2, 6], 2)]),
    }


@pytest.mark.parametrize("case", _other_binaries())
def test_other_binary_files_are_not_taken_for_psins(tmp_path, case):
    _other_binaries()[case].astype("<f8").tofile(tmp_path / "a.bin")
    with pytest.raises(InputError, match=r"was not recognised: name it with --format, as one of .*psins"):
        import_file(tmp_path / "a.bin")


@pytest.mark.parametrize("kind", ["text", "matlab"])
def test_psins_without_time_asks_for_the_rate(tmp_path, kind):
    path = tmp_path / {"text": "a.imu", "matlab": "a.mat"}[kind]
    if kind == "text":
        np.savetxt(path, PSINS[:, :6])
    else:
        scipy.io.savemat(path, {"imu": PSINS[:, :6]})
    _, imported = import_file(path, ImportOptions(sample_rate_hz=128.0), "psins")
    assert (imported.time, imported.kind) == (None, "increment")
    assert_readings(imported, GYRO, ACCEL)
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
    assert_readings(imported, GYRO, ACCEL, (STAMPS - STAMPS[0]) / 1e9)
    assert any("1403636579758555392 ns (2014-06-24" in note for note in imported.notes)


def test_euroc_by_its_folder(tmp_path):
    (tmp_path / "imu0").mkdir()
    write_stamped(tmp_path / "imu0" / "data.csv", EUROC)
    importer, imported = import_file(tmp_path / "imu0")
    assert importer.name == "euroc"
    np.testing.assert_array_equal(imported.gyro, GYRO)


def test_imu_tk_pair(tmp_path):
    for name, values in (("acc", ACCEL), ("gyro", GYRO)):
        np.savetxt(tmp_path / f"unit_{name}.mat", np.column_stack([TIME, values]))
    options = ImportOptions(second=tmp_path / "unit_acc.mat", **SI_TIME)
    importer, imported = import_file(tmp_path / "unit_gyro.mat", options)
    assert importer.name == "imu-tk"
    assert_readings(imported, GYRO, ACCEL)
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


def test_arrays_that_disagree():
    with pytest.raises(InputError, match="time stamps for"):
        samples_in_si(ImportOptions(), gyro=GYRO, accel=ACCEL, time=TIME[1:], stated=StatedUnits("rad/s", "m/s^2", "s"))
    with pytest.raises(InputError, match="shape"):
        samples_in_si(ImportOptions(), gyro=GYRO, accel=ACCEL[1:], time=None, stated=StatedUnits("rad/s", "m/s^2"))


# Text that is wrong.

HEADER = ",".join(COLUMNS)


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


def test_an_error_of_the_data_names_the_file(tmp_path, monkeypatch):
    def read(path, options):
        raise DataError("No IMU\x1b[0m here.")

    monkeypatch.setattr(importer_registry, "importer", lambda name: replace(MINE, read=read))
    with pytest.raises(DataError, match=r"a\.mine: No IMU\?\[0m here"):
        import_file(_mark(tmp_path), name="mine")
