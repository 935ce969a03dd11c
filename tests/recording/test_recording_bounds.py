"""Bounds on what is read: hostile files are refused at once, in one sentence."""

import time
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import srt
from srt.cli.truth import load_truth
from srt.exceptions import InputError
from srt.recording.folder import load_recording
from srt.recording.import_options import ImportOptions
from srt.recording.imported_samples import to_recording
from srt.recording.importer_registry import import_file
from srt.recording.samples import ACCEL_COLUMNS, GYRO_COLUMNS, read_samples
from srt.recording.schema import FIXTURE_KEYS, IMU_KEYS, SECTIONS, SITE_KEYS, read_section
from srt.reports.certificate import load_acceptance_limits
from srt.reports.certificate.calibration_file import calibration_file

QUICK_S = 5.0
"""Time limit of a refusal, s, on a machine that others use; the slowest takes half a second alone."""

HEADER = ",".join(("time", *GYRO_COLUMNS, *ACCEL_COLUMNS))
ROWS = [f"{0.01 * (i + 1):.2f},0,0,0,0,0,-9.8" for i in range(30)]
TOML = """[recording]
samples = "samples.csv"
gyro_unit = "rad/s"
accel_unit = "m/s^2"
[site]
gravity_m_s2 = 9.8
"""


def refusal(read, path):
    start = time.perf_counter()
    with pytest.raises(InputError) as caught:
        read(path)
    assert time.perf_counter() - start < QUICK_S
    message = str(caught.value)
    assert path.name in message
    assert len(message) < 500
    assert message.endswith((".", "?"))
    assert "\n" not in message
    return message


def folder(path, *, toml=TOML, rows=ROWS):
    (path / "recording.toml").write_text(toml)
    (path / "samples.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    return path


@pytest.mark.parametrize("value", ["1e12", "-1e12", "3e200"])
@pytest.mark.parametrize(("column", "name"), [(1, "gyro_x"), (6, "accel_z")])
def test_values_of_a_million_million_are_refused(tmp_path, value, column, name):
    cells = ROWS[7].split(",")
    cells[column] = value
    found = refusal(load_recording, folder(tmp_path, rows=[*ROWS[:7], ",".join(cells), *ROWS[8:]]))
    assert f"Column {name}: sample 8 of 30 is {float(value):.3g} in SI units" in found
    assert "smaller than 1e+12" in found


def test_time_in_another_unit_is_refused_and_large_values_below_the_bound_are_not(tmp_path):
    rows = [f"{1_700_000_000_000_000_000 + 10_000_000 * i},0,0,0,0,0,-9.8" for i in range(30)]
    assert "Column time: sample 1 of 30 is 1.7e+18 in SI units" in refusal(load_recording, folder(tmp_path, rows=rows))
    nanoseconds = TOML.replace("[site]", 'time_unit = "ns"\n[site]')
    assert load_recording(folder(tmp_path, toml=nanoseconds, rows=rows)).time.size == 30
    assert load_recording(folder(tmp_path, rows=[row.replace("-9.8", "9e11") for row in ROWS])).accel[0, 2] == 9e11


def test_imported_values_are_bounded_too(tmp_path):
    columns = {name: np.zeros(20) for name in (*GYRO_COLUMNS, *ACCEL_COLUMNS)}
    columns["gyro_y"][3] = -1e12
    np.savez(tmp_path / "log.npz", time=0.01 * np.arange(20), **columns)
    _, imported = import_file(tmp_path / "log.npz", ImportOptions(gyro_unit="rad/s", accel_unit="g", time_unit="s"))
    with pytest.raises(InputError, match=r"Column gyro_y: sample 4 of 20 is -1e\+12 in SI units"):
        to_recording(imported, srt.Site(9.8))


DIGITS = "9" * 4301
NESTED = "serial = " + "[" * 200_000 + "]" * 200_000


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (f"sample_rate_hz = {DIGITS}", "a number in it has more than 4300 digits"),
        (f"sample_rate_hz = {DIGITS[:4300]}", "9999..., but a positive number of at most 1e+06 in Hz"),
        ("sample_rate_hz = 0x" + "f" * 9000, "an integer of more than 4300 digits, but a positive number of at most"),
        (NESTED, "its values are nested too deep"),
        (".".join("a" * 100_000) + " = 1", "a key in line 5 has more than 32 parts"),
        ("[" + ". ".join(["a-b"] * 50_000) + "]", "a key in line 5 has more than 32 parts"),
        (".".join(['"a.b"', "'c'"] * 25_000) + " = 1", "a key in line 5 has more than 32 parts"),
        ("serial = " + ".".join("1" * 100_000), "a key in line 5 has more than 32 parts"),
        ("a" * 200_000, "is not valid TOML"),
        ('serial = "' + "a b" * 70_000, "is not valid TOML"),
        ("# " + "x" * (16 << 20), "it is larger than 16 MB"),
    ],
    ids=["4301-digits", "4300-digits", "hexadecimal", "nested", "dotted", "section", "quoted", "value", "bare", "open",
         "large"],
)  # fmt: skip
def test_toml(tmp_path, line, reason):
    assert reason in refusal(load_recording, folder(tmp_path, toml=TOML.replace("[site]", f"{line}\n[site]")))


@pytest.mark.parametrize("section", ["recording", "site", "fixture", "imu", "imu.applied"])
def test_every_number_has_an_upper_bound(section):
    """A value of 1e300 overflows in the covariance of the windows."""
    for key in SECTIONS[section]:
        for value in (1e300, [1e300] * 3, [1e300] * 9, 10**300):
            with pytest.raises(InputError, match=rf"{section}\.{key.name} is "):
                read_section("x.toml", section, {key.name: value}, SECTIONS[section])


@pytest.mark.parametrize(
    ("key", "value"), [("rotations", [["x", 1e300]]), ("rate_deg_s", ["x", 1e300]), ("rate_sigma_ppm", 1e300)]
)
def test_every_number_of_a_sequence_has_an_upper_bound(key, value):
    with pytest.raises(InputError, match=rf"sequence\[1\].{key} is "):
        read_section("x.toml", "sequence[1]", {key: value}, SECTIONS["sequence"])


def test_the_classes_have_the_bounds_of_the_file():
    for keys, make in ((IMU_KEYS, srt.ImuNoise), (FIXTURE_KEYS, srt.Fixture), (SITE_KEYS, partial(srt.Site, 9.8))):
        for name in (key.attribute for key in keys if key.attribute not in (None, "gravity_m_s2")):
            for value in (1e300, "1", [1.0]):
                with pytest.raises(InputError, match=name):
                    make(**{name: value})


def test_copies_of_a_label_are_refused_at_once(tmp_path):
    """The diagnosis of 20,000 copies takes a minute and 2 GB."""
    label = "[[sequence]]\nstart_static_s = [0.0, 0.1]\nend_static_s = [0.15, 0.25]\n"
    assert load_recording(folder(tmp_path, toml=TOML + label)).sequences
    twice = folder(tmp_path, toml=TOML + 2 * label)
    assert "rotate while The free turn at 0 s still does" in refusal(load_recording, twice)


def test_a_long_text_with_dots_is_no_key(tmp_path):
    serial = "no. 12.3, rev. 4: " + "word. " * 30
    loaded = load_recording(folder(tmp_path, toml=TOML.replace("[site]", f'serial = "{serial}"\n[site]')))
    assert loaded.serial == serial


@pytest.mark.parametrize("read", [srt.load_calibration, load_truth], ids=["calibration", "truth"])
@pytest.mark.parametrize("opening", ["[", '{"a":'], ids=["lists", "objects"])
def test_json_nested_deep(tmp_path, read, opening):
    path = tmp_path / "nested.json"
    path.write_text(opening * 200_000)
    assert "is not valid JSON" in refusal(read, path)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device without an end")
@pytest.mark.parametrize("read", [srt.load_calibration, load_truth, load_acceptance_limits, calibration_file])
def test_a_device_without_an_end_is_read_to_the_bound(read):
    assert "is larger than" in refusal(read, Path("/dev/full"))


@pytest.mark.parametrize("where", ["header", "row"])
def test_a_csv_cell_of_many_characters(tmp_path, where):
    path = tmp_path / "samples.csv"
    long = "x" * 131_073
    lines = [HEADER + "," + long, *ROWS] if where == "header" else [HEADER, *ROWS, ROWS[0] + "," + long]
    path.write_text("\n".join(lines) + "\n")
    assert "field larger than field limit (131072)" in refusal(read_samples, path)


def bomb(path, size):
    """Archive of less than 2 MB whose seven arrays of zeros take ``size`` bytes each."""
    zeros = bytes(1 << 20)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in ("time", *GYRO_COLUMNS, *ACCEL_COLUMNS):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array_header_1_0(
                    member, {"descr": "<f8", "fortran_order": False, "shape": (size // 8,)}
                )
                for _ in range(size >> 20):
                    member.write(zeros)


def test_an_npz_bomb(tmp_path):
    path = tmp_path / "samples.npz"
    bomb(path, 1 << 26)
    assert path.stat().st_size < 2 << 20
    found = refusal(read_samples, path)
    assert "more than 100 times" in found
    start = time.perf_counter()
    with pytest.raises(InputError, match="more than 100 times"):
        import_file(path)
    assert time.perf_counter() - start < QUICK_S


def test_an_archive_of_constant_columns_is_read(tmp_path):
    path = tmp_path / "samples.npz"
    bomb(path, 4 << 20)
    assert len(read_samples(path).gyro) == 1 << 19
