"""``srt apply``: corrected recordings, the header, and what is refused before anything is written."""

import json
import tomllib

import numpy as np
import pytest

import srt
from srt.cli import main
from srt.exporters.c_header import c99_header
from srt.model.rotations import rotation_matrix
from srt.result.calibration import Calibration
from srt.result.provenance import Provenance
from srt.sensor_errors import N_PARAMETERS, SensorErrors

U = rotation_matrix(np.array([0.0, 0.1, -0.05]))
VECTOR = np.random.default_rng(3).uniform(-0.02, 0.02, N_PARAMETERS)
SEQUENCE = srt.SequenceLabel((0.0, 1.0), (2.0, 3.0), id="1")
SCENARIO = """
seed = 3
imu = { from = "navigation-rlg" }
fixture = { from = "lab-1mrad" }
site = { from = "latitude-45" }
schedule = { dwell_s = 4.0, rate_rad_s = 3.0, acceleration_rad_s2 = 30.0, settle_s = 0.1, leg_dwell_s = 0.2 }
recording = { sample_rate_hz = 100.0, format = "npz", serial = "SN-7" }
"""


def calibrated(**changes):
    given = {
        "status": "converged",
        "U": U,
        "provenance": Provenance(serial="SN-7", data_sha256="0" * 64, software="test"),
    }
    covariance = np.eye(N_PARAMETERS) * 1e-10
    return Calibration(
        "closed-form", message="Done.", errors=SensorErrors(VECTOR), covariance=covariance, **(given | changes)
    )


def recorded(folder, kind="rate", samples_format="npz", **changes):
    rng = np.random.default_rng(4)
    n, dt = 300, 0.01
    scale = dt if kind == "increment" else 1.0
    given = {
        "time": np.arange(1, n + 1) * dt,
        "gyro": rng.normal(size=(n, 3)) * scale,
        "accel": (rng.normal(size=(n, 3)) - np.array([0.0, 0.0, 9.8])) * scale,
        "site": srt.Site(9.80665, latitude_rad=0.7),
        "kind": kind,
        "fixture": srt.Fixture(),
        "noise": srt.ImuNoise(gyro_noise=1e-6, gyro_range=7.0),
        "sequences": (SEQUENCE,),
        "temperature": np.linspace(20.0, 21.0, n),
        "serial": "SN-7",
        "date": "2024-05-06",
    }
    srt.write_recording(srt.Recording(**(given | changes)), folder, samples_format=samples_format)
    return folder


@pytest.fixture
def unit(tmp_path):
    calibrated().save(tmp_path / "unit.json")
    return tmp_path / "unit.json"


@pytest.fixture
def recording(tmp_path):
    return recorded(tmp_path / "raw")


def refused(capfd, *arguments, code=2):
    """Run and give the one sentence of a refusal."""
    assert main(["apply", *map(str, arguments)]) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("srt: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("kind", ["rate", "increment"])
@pytest.mark.parametrize("frame", ["mars", "table"])
def test_the_samples_are_the_librarys(unit, tmp_path, capfd, kind, frame):
    raw = srt.load_recording(recorded(tmp_path / "raw", kind))
    assert main(["apply", str(unit), str(tmp_path / "raw"), "-o", str(tmp_path / "out"), "--frame", frame]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert "300 samples" in out
    assert str(tmp_path / "out") in out
    found = srt.load_recording(tmp_path / "out")
    dt = raw.interval_s if kind == "increment" else None
    gyro, accel = srt.load_calibration(unit).apply(raw.gyro, raw.accel, kind=kind, dt=dt, frame=frame)
    np.testing.assert_array_equal(found.gyro, gyro)
    np.testing.assert_array_equal(found.accel, accel)
    for name in ("kind", "serial", "date", "site", "fixture", "sequences"):
        assert getattr(found, name) == getattr(raw, name)
    for name in ("time", "temperature"):
        np.testing.assert_array_equal(getattr(found, name), getattr(raw, name))
    # A range is one of raw readings.
    assert found.noise == srt.ImuNoise(gyro_noise=1e-6)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_pulses_that_the_correction_hides_are_stated(unit, tmp_path, kind):
    """Half an arc second: the axes mixed, the smallest step between readings would be that of a misalignment."""
    pulse, dt = np.radians(0.5 / 3600.0), 0.01
    angle = np.random.default_rng(6).integers(-4, 5, size=(300, 3)) * pulse
    recorded(tmp_path / "rec", kind=kind, gyro=angle if kind == "increment" else angle / dt)
    assert main(["apply", str(unit), str(tmp_path / "rec"), "-o", str(tmp_path / "out"), "-q"]) == 0
    noise = srt.load_recording(tmp_path / "out").noise
    assert noise.gyro_quantization == pytest.approx(pulse, rel=1e-9)
    assert noise.accel_quantization is None


@pytest.mark.parametrize(("samples_format", "options"), [("csv", []), ("npz", []), ("csv", ["--samples-format", "h5"])])
def test_the_samples_keep_their_format_unless_told(unit, tmp_path, samples_format, options):
    recorded(tmp_path / "raw", samples_format=samples_format)
    source = tmp_path / "raw" / "recording.toml"
    assert main(["apply", str(unit), str(source), "-o", str(tmp_path / "out"), "-q", *options]) == 0
    expected = options[1] if options else samples_format
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["recording.toml", f"samples.{expected}"]
    assert tomllib.loads((tmp_path / "out" / "recording.toml").read_text())["recording"]["gyro_unit"] == "rad/s"


def test_the_header_alone_or_with_the_samples(unit, recording, tmp_path, capfd):
    expected = c99_header(srt.load_calibration(unit))
    assert main(["apply", str(unit), "--c-header", str(tmp_path / "alone.h")]) == 0
    assert (tmp_path / "alone.h").read_text() == expected
    assert str(tmp_path / "alone.h") in capfd.readouterr().out
    both = [unit, recording, "-o", tmp_path / "out", "--c-header", tmp_path / "imu.h", "-q"]
    assert main(["apply", *map(str, both)]) == 0
    assert (tmp_path / "imu.h").read_text() == expected
    assert (tmp_path / "out" / "recording.toml").exists()
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ([], "nothing to write"),
        (["RAW"], "go together"),
        (["-o", "OUT"], "go together"),
        (["RAW", "-o", "OUT", "--c-header", "OUT.c"], "ends in .h"),
        (["RAW", "-o", "OUT", "--frame", "body"], "frame"),
        (["RAW", "-o", "RAW", "--overwrite"], "holds the recording itself"),
        (["RAW/recording.toml", "-o", "RAW"], "holds the recording itself"),
        (["RAW", "-o", "unit.json"], "is a file"),
        (["absent", "-o", "OUT"], "no recording absent"),
    ],
)
def test_wrong_usage(unit, recording, tmp_path, capfd, monkeypatch, arguments, fragment):
    monkeypatch.chdir(tmp_path)
    before = {p: p.read_bytes() for p in recording.iterdir()}
    assert fragment in refused(capfd, unit, *(text.replace("RAW", "raw") for text in arguments))
    assert {p: p.read_bytes() for p in recording.iterdir()} == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["raw", "unit.json"]


def test_a_folder_with_files_is_not_written_to_unless_asked(unit, recording, tmp_path, capfd):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    line = [unit, recording, "-o", tmp_path / "out"]
    assert "holds files already" in refused(capfd, *line)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["notes.txt"]
    assert main(["apply", *map(str, line), "--overwrite"]) == 0
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "out" / "samples.npz").exists()


@pytest.mark.parametrize("status", ["not_converged", "outside_model"])
def test_a_calibration_that_did_not_converge_needs_force(recording, tmp_path, capfd, status):
    calibrated(status=status).save(tmp_path / "bad.json")
    line = [tmp_path / "bad.json", recording, "-o", tmp_path / "out", "--c-header", tmp_path / "imu.h"]
    assert status in refused(capfd, *line)
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "imu.h").exists()
    assert main(["apply", *map(str, line), "--force"]) == 0


def test_held_parameters_are_a_warning(recording, tmp_path, capfd):
    partial = calibrated(status="partial", held={"gyro_bias_x": "held on request"})
    partial.covariance[24] = partial.covariance[:, 24] = 0.0
    partial.save(tmp_path / "partial.json")
    assert main(["apply", str(tmp_path / "partial.json"), str(recording), "-o", str(tmp_path / "out"), "-q"]) == 0
    err = capfd.readouterr().err
    assert err.endswith("fixed, not observed: gyro_bias_x: held on request.\n")
    assert err.count("\n") == 1


def test_another_serial_needs_force_and_an_absent_one_does_not(unit, tmp_path, capfd):
    other = recorded(tmp_path / "other", serial="SN-8")
    line = [unit, other, "-o", tmp_path / "out"]
    sentence = refused(capfd, *line)
    assert "SN-7" in sentence
    assert "SN-8" in sentence
    assert not (tmp_path / "out").exists()
    assert main(["apply", *map(str, line), "--force", "-q"]) == 0
    unnamed = recorded(tmp_path / "unnamed", serial=None)
    assert main(["apply", str(unit), str(unnamed), "-o", str(tmp_path / "out2"), "-q"]) == 0


@pytest.mark.parametrize(
    ("scale", "fragment"), [(0.01, "increments per sample, declared as rates"), (1 / 9.8, "like g,")]
)
def test_increments_given_as_rates_are_told_from_gravity(unit, tmp_path, capfd, scale, fragment):
    wrong = recorded(tmp_path / "wrong", accel=np.tile([0.0, 0.0, -9.8 * scale], (300, 1)))
    line = [unit, wrong, "-o", tmp_path / "out"]
    assert fragment in refused(capfd, *line, code=1)
    assert not (tmp_path / "out").exists()
    assert main(["apply", *map(str, line), "--force", "-q"]) == 0


def test_rates_given_as_increments_are_told_from_gravity(unit, tmp_path, capfd):
    wrong = recorded(tmp_path / "wrong", "increment", accel=np.tile([0.0, 0.0, -9.8], (300, 1)))
    assert "declared as increments" in refused(capfd, unit, wrong, "-o", tmp_path / "out", code=1)


def test_samples_that_are_no_numbers_are_refused(unit, tmp_path, capfd):
    folder = recorded(tmp_path / "bad", samples_format="csv")
    lines = (folder / "samples.csv").read_text().splitlines()
    lines[7] = ",".join(["nan" if i == 2 else cell for i, cell in enumerate(lines[7].split(","))])
    (folder / "samples.csv").write_text("\n".join(lines) + "\n")
    assert "gyro_y" in refused(capfd, unit, folder, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_no_table_frame_without_a_fixture(recording, tmp_path, capfd):
    calibrated(U=None).save(tmp_path / "free.json")
    sentence = refused(capfd, tmp_path / "free.json", recording, "-o", tmp_path / "out", "--frame", "table")
    assert "no table frame" in sentence
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("edit", "fragment"),
    [
        (lambda text: text[: len(text) // 2], "truncated"),
        (lambda text: text.replace('"version": 1', '"version": 2'), "version"),
        (lambda text: "", "not valid JSON"),
        (lambda text: text.replace('"format": "srt-calibration"', '"format": "mine"'), "no calibration file"),
        (lambda text: text.replace('"provenance"', '"origin"'), "edited or truncated"),
        (lambda text: changed(text, "sigma", 1.0), "does not agree with the covariance"),
        (lambda text: changed(text, "value", 1e9), "edited"),
        (lambda text: changed(text, "value", -0.999), "edited"),
        (lambda text: changed(text, "value", "much"), "edited or truncated"),
        (lambda text: changed(text, "value", float("nan")), "finite"),
        (lambda text: json.dumps(json.loads(text) | {"provenance": []}), "provenance is []: an object with keys is"),
        (lambda text: json.dumps(json.loads(text) | {"estimator": None}), "estimator is None: a text is expected"),
    ],
)
def test_calibrations_that_were_edited_are_refused(unit, recording, tmp_path, capfd, edit, fragment):
    document = json.loads(unit.read_text())
    del document["digest"]  # the values themselves are checked
    unit.write_text(edit(json.dumps(document)))
    assert fragment in refused(capfd, unit, recording, "-o", tmp_path / "out", "--c-header", tmp_path / "imu.h")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["raw", "unit.json"]


def changed(text, key, value, index=0):
    document = json.loads(text)
    document["parameters"][index][key] = value
    # A sign that is wrong everywhere makes the triad left-handed; one parameter, sigma.
    if key == "value" and value == 1e9:
        document["parameters"][1][key] = -value
    return json.dumps(document)


def test_an_edited_u_is_refused(recording, tmp_path, capfd):
    calibrated(U=2.0 * U).save(tmp_path / "bad.json")
    for line in (["--c-header", tmp_path / "imu.h"], [recording, "-o", tmp_path / "out", "--frame", "table"]):
        assert "no rotation" in refused(capfd, tmp_path / "bad.json", *line)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.json", "raw"]


def test_a_failure_leaves_nothing(unit, recording, tmp_path, capfd, monkeypatch):
    def fail(*args, **options):
        raise srt.InputError("The disk is full.")

    monkeypatch.setattr("srt.recording.writing.write_samples", fail)
    line = [unit, recording, "-o", tmp_path / "out", "--c-header", tmp_path / "imu.h"]
    assert refused(capfd, *line) == "srt: The disk is full.\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["raw", "unit.json"]


def test_applied_to_its_own_recording_nothing_is_left_to_calibrate(tmp_path):
    """The corrected recording of a simulated unit calibrates to zero errors."""
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(SCENARIO)
    raw, result, out = (str(tmp_path / name) for name in ("raw", "unit.json", "out"))
    assert main(["simulate", str(scenario), "-o", raw, "-q"]) == 0
    assert main(["calibrate", raw, "-o", result, "-q"]) == 0
    assert main(["apply", result, raw, "-o", out, "-q"]) == 0
    again = srt.calibrate(srt.load_recording(out))
    assert np.abs(again.errors.vector / again.sigma).max() < 0.1
