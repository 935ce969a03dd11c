"""``srt calibrate LOG``: a log through conversion, inspection, calibration, picture and files for other tools."""

import io
import json
import re
import shutil
import sys
import tomllib

import numpy as np
import pytest
from small_units import recorded, simulated

import srt
from srt.cli.convert import log_remedy
from srt.constants import DEG, STANDARD_GRAVITY_M_S2
from srt.exporters import load

UNITS = {"--gyro-unit": "deg/s", "--accel-unit": "g", "--time-unit": "s"}
SITE = {"--latitude-deg": "45", "--gravity-m-s2": "9.80665"}
STATED = [word for pair in (UNITS | SITE).items() for word in pair]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Table of a short test in °/s and g, which states neither its units nor its site."""
    folder = tmp_path_factory.mktemp("log")
    unit = srt.load_recording(simulated(folder / "unit", dwell_s=2.0, sample_rate_hz=50.0))
    columns = np.column_stack([unit.time, unit.gyro / DEG, unit.accel / STANDARD_GRAVITY_M_S2])
    names = ",".join(["time", *(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")])
    np.savetxt(folder / "imu.csv", columns, fmt="%.12g", delimiter=",", header=names, comments="")
    return folder / "imu.csv"


@pytest.fixture(scope="module")
def made(log, tmp_path_factory):
    """Folder of a first run, which no test changes."""
    pytest.importorskip("yaml")
    folder = tmp_path_factory.mktemp("first") / "new" / "unit"
    from srt.cli import main

    targets = ["--to", "kalibr", "--to", "c-header", "--to", "kalibr", "--to", "px4"]
    # No correction by an autopilot is stated, so that px4 alone is refused.
    assert main(["calibrate", str(log), "-o", str(folder), *targets, *STATED]) == 2
    return folder


@pytest.fixture
def again(made, tmp_path):
    """Copy of what a second run reads of the first one."""
    results = shutil.ignore_patterns("calibration.*", "kalibr*", "c-header*")
    return shutil.copytree(made, tmp_path / "unit", ignore=results)


def test_a_log_becomes_a_recording_a_calibration_and_the_files_asked_for(log, made):
    files = {path.relative_to(made).as_posix() for path in made.rglob("*") if path.is_file()}
    pictures = {name for name in files if name.endswith(".png")}
    assert pictures <= {"calibration.png"}
    assert files - pictures == {
        "recording/recording.toml", "recording/samples.npz", "conversion.json", "calibration.json", "kalibr.yaml",
        "kalibr-imu.yaml", "c-header.h",
    }  # fmt: skip
    apart = srt.calibrate(srt.read(log, gyro_unit="deg/s", accel_unit="g", time_unit="s", latitude_deg=45.0,
                                   gravity_m_s2=9.80665))  # fmt: skip
    calibration = srt.load_calibration(made / "calibration.json")
    np.testing.assert_array_equal(calibration.errors.vector, apart.errors.vector)
    # The file of Kalibr holds them but for asymmetry and biases; it has the accelerometers' axes.
    found = load(made / "kalibr.yaml", "kalibr")
    scale = slice(srt.INDEX["accel_scale_x"], srt.INDEX["accel_scale_z"] + 1)
    np.testing.assert_allclose(found.errors.vector[scale], calibration.errors.vector[scale], atol=1e-5)


def test_the_correction_of_a_log_is_asked_for_before_the_calculation(log, tmp_path, shell):
    words = ("calibrate", log, "-o", tmp_path / "out", "-q", "--to", "px4", *STATED)
    assert "add --applied px4:FILE, or --applied none" in shell(*words, code=2).err
    assert not (tmp_path / "out" / "calibration.json").exists()


def test_the_second_run_reads_the_recording_with_what_was_entered_in_it(log, made, again, shell):
    toml = again / "recording" / "recording.toml"
    toml.write_text(toml.read_text() + "\n[imu]\ngyro_noise_deg_per_sqrt_h = 0.002\n")
    edited = toml.read_bytes()
    shutil.copy(made / "calibration.json", again)
    out, err = shell("calibrate", log, "-o", again, *STATED)
    assert re.search(r"calibration.json was replaced.* 'srt export' .* 'srt noise --into' are not kept", err)
    assert "which was made of" in out
    assert toml.read_bytes() == edited
    noise = srt.load_calibration(again / "calibration.json").noise
    np.testing.assert_allclose(noise.gyro_noise_rad_per_sqrt_s, 0.002 * DEG / 60.0, rtol=1e-12)


def test_options_that_change_make_the_recording_again_and_never_replace_an_edited_one(log, again, shell, refused):
    shell("calibrate", log, "-o", again, "-q", "--serial", "SN-8")
    toml = again / "recording" / "recording.toml"
    document = tomllib.loads(toml.read_text())
    # The units and the site of the first run hold on.
    assert (document["recording"]["serial"], document["site"]["latitude_deg"]) == ("SN-8", 45.0)
    toml.write_text(toml.read_text() + "# mine\n")
    for path in again.glob("calibration.*"):
        path.unlink()
    before = {path: path.read_bytes() for path in again.rglob("*") if path.is_file()}
    sentence = refused("calibrate", log, "-o", again, "--serial", "SN-9")
    assert "edited" in sentence
    assert "--serial" in sentence
    assert {path: path.read_bytes() for path in again.rglob("*") if path.is_file()} == before


def test_a_wrong_unit_is_mended_by_the_option_of_the_log(log, tmp_path, capsys):
    from srt.cli import main

    def failed(*words):
        stated = {**UNITS, **SITE, **dict(zip(words[::2], words[1::2], strict=False))}
        more = ["--force"] * (len(words) % 2)
        assert main(["calibrate", str(log), "-o", str(tmp_path / "out"), *more, *sum(stated.items(), ())]) == 1
        read = capsys.readouterr()
        assert "correct gyro_unit" not in " ".join(read.out.split())
        return read.err.splitlines()[-1]

    sentence = failed("--gyro-unit", "deg/h")
    assert sentence.endswith("gyro readings look like deg/s, declared as deg/h; run again with --gyro-unit deg/s.")
    assert failed("--gyro-unit", "deg/h", "--force").endswith(sentence.removeprefix("srt: "))
    assert failed("--accel-unit", "m/s^2").endswith("look like g, declared as m/s²; run again with --accel-unit g.")
    assert failed("--accel-unit", "m/s^2", "--force").count("At rest the accelerometers read") == 1
    toml = tmp_path / "out" / "recording" / "recording.toml"
    toml.write_text(toml.read_text().replace('gyro_unit = "rad/s"', 'gyro_unit = "deg/s"'))
    assert main(["calibrate", str(log), "-o", str(tmp_path / "out"), "--accel-unit", "g"]) == 2
    assert "name another folder, and repeat the edit there; these samples are in SI units" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "kind", "expected"),
    [
        ("x: the readings look like degrees, declared as radians; correct gyro_unit.", None, "--gyro-unit deg/s."),
        ("x: look like degrees, declared as radians; correct gyro_unit or kind.", "increment", "--gyro-unit deg."),
        ("look like m/s², declared as g; correct accel_unit.", None, "--accel-unit m/s^2."),
        ("look like g, declared as m/s²; correct accel_unit.", "increment", "--accel-unit g*s."),
        (
            "look like ft/s², declared as m/s²; correct accel_unit.",
            None,
            "--accel-unit counts and the value of the unit as --accel-lsb.",
        ),
        ("no known unit explains it; correct accel_unit or kind.", None, "--accel-unit of another value, or --kind."),
        (
            "the time stamps look like ms, declared as s; correct time_unit in recording.toml.",
            None,
            "run again with --time-unit ms.",
        ),
        ('set gyro_unit = "counts" and gyro_lsb.', None, "run again with --gyro-unit counts and --gyro-lsb."),
        ('as for increments; set kind = "increment".', None, "run again with --kind increment."),
    ],
)
def test_remedies_name_options(words, kind, expected):
    assert log_remedy(words, kind).endswith(expected)


def test_another_log_or_a_foreign_folder_is_refused(log, again, tmp_path, refused):
    other = tmp_path / "other.csv"
    other.write_text(log.read_text() + "\n")
    assert "was not made of" in refused("calibrate", other, "-o", again, *STATED)
    for text in ((again / "conversion.json").read_text().replace('"g"', '"mg"'), "{}", None):
        if text is None:
            (again / "conversion.json").unlink()
        else:
            (again / "conversion.json").write_text(text)
        assert "was not made of" in refused("calibrate", log, "-o", again, *STATED)
    raw = recorded(tmp_path / "raw")
    assert "is the folder of a recording" in refused("calibrate", log, "-o", raw, *STATED)


def test_a_file_of_json_keeps_the_calibration_alone(log, tmp_path, shell, refused):
    assert "folder" in refused("calibrate", log, "-o", tmp_path / "u.json", "--to", "kalibr", *STATED)
    assert "folder" in refused("calibrate", log, "--to", "kalibr", *STATED)
    shell("calibrate", log, "-o", tmp_path / "u.json", "-q", *STATED)
    assert [path.name for path in tmp_path.iterdir()] == ["u.json"]
    assert srt.load_calibration(tmp_path / "u.json").site.gravity_m_s2 == 9.80665


def test_what_is_missing_is_refused_with_the_command(log, tmp_path, refused):
    sentence = refused("calibrate", log, "-o", tmp_path / "out", "--to", "kalibr", "--accel-unit", "g", sentences=4)
    command = f"srt calibrate {log} -o {tmp_path / 'out'} --to kalibr --accel-unit g "
    missing = "--gyro-unit GYRO_UNIT --time-unit TIME_UNIT --latitude-deg LATITUDE_DEG --height-m HEIGHT_M"
    assert sentence.endswith(f"{command}{missing}.\n")
    assert list(tmp_path.iterdir()) == []


class Terminal(io.StringIO):
    """Stream of a person at a terminal."""

    def isatty(self):
        return True


def test_what_is_missing_is_asked_at_a_terminal(log, tmp_path, shell, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Terminal("dps\nfurlongs\ng\ns\n45\n0\n"))
    monkeypatch.setattr(sys, "stderr", Terminal())
    shell("calibrate", log, "-o", tmp_path / "out")
    asked = sys.stderr.getvalue()
    assert "Unit of the gyros (rad/s, deg/s" in asked
    assert "Latitude of the site" in asked
    options = json.loads((tmp_path / "out" / "conversion.json").read_text())["options"]
    assert options == {
        "gyro_unit": "deg/s", "accel_unit": "g", "time_unit": "s", "latitude_deg": 45.0, "height_m": 0.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["RAW", "--gyro-unit", "deg/s"], "--gyro-unit describes a log"),
        (["RAW", "--latitude-deg", "0"], "--latitude-deg describes a log"),
        (["LOG", "RAW"], "calibrated alone"),
        (["LOG", "--merge"], "calibrated alone"),
        (["RAW", "RAW", "--to", "kalibr"], "--to belongs to one recording"),
        (["RAW", "--to", "kalibbr"], "did you mean kalibr?"),
    ],
)
def test_what_does_not_go_with_a_log_is_refused(log, raw, tmp_path, words, fragment, refused):
    words = [{"RAW": raw, "LOG": log}.get(word, word) for word in words]
    assert fragment in refused("calibrate", *words, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_recording_is_written_for_other_tools_too(recording, tmp_path, shell):
    out, _ = shell("calibrate", recording, "-o", tmp_path / "out", "--to", "c-header", "--to", "imu_tk")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names - {"calibration.png", "imu_tk_gyro.calib", "imu_tk_acc.calib"} == {"calibration.json", "c-header.h"}
    # The axes are told as srt export tells them.
    exported = shell("export", tmp_path / "out" / "calibration.json", "--to", "imu_tk").out
    axes = exported[exported.index("axes:") : exported.index("\n\n")].splitlines()
    assert len(axes) == 5
    assert "\n".join(f"  {line}" for line in axes) in out


def test_files_of_which_nothing_is_measured_are_not_written(tmp_path, shell):
    """One turn about the vertical shows three biases at most, and the matrices of Kalibr would be identity."""
    rng = np.random.default_rng(5)
    time = np.arange(1, 1001) / 100.0
    gyro, accel = rng.normal(0.0, 1e-4, (1000, 3)), rng.normal([0.0, 0.0, 9.8066], 1e-3, (1000, 3))
    gyro[400:600, 2] += 0.25
    np.savetxt(tmp_path / "log.csv", np.column_stack([time, gyro, accel]), delimiter=",")
    columns = ["--columns", "time,gyro,accel", "--gyro-unit", "rad/s", "--accel-unit", "m/s^2", "--time-unit", "s"]
    targets = ["--to", "kalibr", "--to", "openvins", "--to", "pyins"]
    given = [tmp_path / "log.csv", "-o", tmp_path / "out", "-q", *targets, *columns, *STATED[-4:]]
    assert "Fit to calibrate: no (in the 2 stationary windows" in shell("calibrate", *given, code=1).err
    _, err = shell("calibrate", *given, "--force", "--overwrite")
    assert "kalibr, openvins were not written: the log is too short or has too few turns" in err
    assert "record 20 to 30 turns between rests" in err
    assert not list((tmp_path / "out").glob("*.yaml"))
    assert "parameters are measured" in (tmp_path / "out" / "pyins.json").read_text()
