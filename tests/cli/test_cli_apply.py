"""``srt apply``: corrected recordings, the header, and what is refused before anything is written."""

import json
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from small_units import VECTOR, U, calibrated, recorded, simulated

import srt
from srt.exporters.c_header import c99_header
from srt.model.sensor_model import accel_triad
from srt.sensor_errors import GROUP_SLICES, SensorErrors

COMPLETE = {
    "fixture": srt.Fixture(),
    "noise": srt.ImuNoise(gyro_noise=1e-6, gyro_range=7.0),
    "sequences": (srt.SequenceLabel((0.0, 1.0), (2.0, 3.0), id="1"),),
    "temperature": np.linspace(20.0, 21.0, 300),
    "date": "2024-05-06",
}
"""Everything that a recording may hold beside its readings."""


@pytest.mark.parametrize("kind", ["rate", "increment"])
@pytest.mark.parametrize("frame", ["mars", "table"])
def test_the_samples_are_the_librarys(unit, tmp_path, kind, frame, shell):
    raw = srt.load_recording(recorded(tmp_path / "raw", kind, **COMPLETE))
    out, err = shell("apply", unit, tmp_path / "raw", "-o", tmp_path / "out", "--frame", frame)
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
def test_pulses_that_the_correction_hides_are_stated(unit, tmp_path, kind, shell):
    """Half an arc second: the axes mixed, the smallest step between readings would be that of a misalignment."""
    pulse, dt = np.radians(0.5 / 3600.0), 0.01
    angle = np.random.default_rng(6).integers(-4, 5, size=(300, 3)) * pulse
    recorded(tmp_path / "rec", kind=kind, gyro=angle if kind == "increment" else angle / dt)
    shell("apply", unit, tmp_path / "rec", "-o", tmp_path / "out", "-q", "--force")  # no gyro bias: of another unit
    noise = srt.load_recording(tmp_path / "out").noise
    assert noise.gyro_quantization == pytest.approx(pulse, rel=1e-9)
    assert noise.accel_quantization is None


@pytest.mark.parametrize(("samples_format", "options"), [("csv", []), ("npz", []), ("csv", ["--samples-format", "h5"])])
def test_the_samples_keep_their_format_unless_told(unit, tmp_path, samples_format, options, shell):
    recorded(tmp_path / "raw", samples_format=samples_format)
    source = tmp_path / "raw" / "recording.toml"
    shell("apply", unit, source, "-o", tmp_path / "out", "-q", *options)
    expected = options[1] if options else samples_format
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["recording.toml", f"samples.{expected}"]
    assert tomllib.loads((tmp_path / "out" / "recording.toml").read_text())["recording"]["gyro_unit"] == "rad/s"


def test_the_header_alone_or_with_the_samples(unit, raw, tmp_path, shell):
    expected = c99_header(srt.load_calibration(unit))
    assert str(tmp_path / "alone.h") in shell("apply", unit, "--c-header", tmp_path / "alone.h").out
    assert (tmp_path / "alone.h").read_text() == expected
    both = ["-o", tmp_path / "out", "--c-header", tmp_path / "imu.h", "-q"]
    assert shell("apply", unit, raw, *both).out == ""
    assert (tmp_path / "imu.h").read_text() == expected
    assert (tmp_path / "out" / "recording.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ([], "or - for lines of CSV or JSON on standard input"),
        (["RAW"], "write '- < raw' in place of both"),
        (["-o", "OUT"], "go together"),
        (["RAW", "-o", "OUT", "--c-header", "OUT.c"], "ends in .h"),
        (["RAW", "-o", "OUT", "--frame", "body"], "frame"),
        (["RAW", "-o", "RAW", "--overwrite"], "holds the recording itself"),
        (["RAW/recording.toml", "-o", "RAW"], "holds the recording itself"),
        (["RAW", "-o", "unit.json"], "is a file"),
        (["absent", "-o", "OUT"], "no recording absent"),
    ],
)
def test_wrong_usage(unit, raw, tmp_path, monkeypatch, arguments, fragment, refused):
    monkeypatch.chdir(tmp_path)
    before = {p: p.read_bytes() for p in raw.iterdir()}
    assert fragment in refused("apply", unit, *(text.replace("RAW", "raw") for text in arguments))
    assert {p: p.read_bytes() for p in raw.iterdir()} == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["raw", "unit.json"]


def test_a_folder_with_files_is_not_written_to_unless_asked(unit, raw, tmp_path, shell, refused):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    line = [unit, raw, "-o", tmp_path / "out"]
    assert "holds files already" in refused("apply", *line)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["notes.txt"]
    shell("apply", *line, "--overwrite")
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "out" / "samples.npz").exists()


@pytest.fixture(params=["apply", "export"])
def line(request, tmp_path):
    """Command line of a correction or of an export, of a calibration and a recording; its output is OUT."""

    def words(unit, recording):
        if request.param == "apply":
            return ["apply", unit, recording, "-o", tmp_path / "OUT", "--c-header", tmp_path / "OUT.h"]
        return ["export", unit, "--to", "ros2", "-o", tmp_path / "OUT.yaml", "--recording", recording]

    return words


def require_force(line, tmp_path, shell, refused, code=2):
    """Sentence of a refusal that writes nothing and that --force overrides."""
    sentence = refused(*line, code=code)
    assert not list(tmp_path.glob("OUT*"))
    shell(*line, "--force", "-q")
    assert list(tmp_path.glob("OUT*"))
    return sentence


def test_an_inconsistent_calibration_needs_force(line, raw, tmp_path, shell, refused):
    calibrated(status="inconsistent").save(tmp_path / "bad.json")
    assert "inconsistent" in require_force(line(tmp_path / "bad.json", raw), tmp_path, shell, refused)


@pytest.mark.parametrize("status", ["not_converged", "outside_model"])
def test_a_calibration_that_did_not_converge_has_no_values_to_force(line, raw, tmp_path, status, refused):
    calibrated(status=status).save(tmp_path / "bad.json")
    for force in ([], ["--force"]):
        assert f"has the status {status} and no values" in refused(*line(tmp_path / "bad.json", raw), *force)
        assert not list(tmp_path.glob("OUT*"))


def test_held_parameters_are_a_warning(line, raw, tmp_path, shell):
    partial = calibrated(status="partial", fixed={"gyro_bias_x": "held on request"})
    covariance = partial.covariance.copy()
    covariance[24] = covariance[:, 24] = 0.0
    replace(partial, covariance=covariance).save(tmp_path / "partial.json")
    err = shell(*line(tmp_path / "partial.json", raw), "-q").err
    assert err.endswith("fixed, not observed: gyro_bias_x: held on request.\n")
    assert err.count("\n") == 1


def test_another_serial_needs_force_and_an_absent_one_does_not(line, unit, tmp_path, shell, refused):
    other = recorded(tmp_path / "other", serial="SN-8")
    assert {"SN-7", "SN-8"} <= set(re.findall(r"SN-\d", require_force(line(unit, other), tmp_path, shell, refused)))
    shell("apply", unit, recorded(tmp_path / "unnamed", serial=None), "-o", tmp_path / "out2", "-q")


def test_the_rests_tell_another_unit(recording, calibration, tmp_path, shell, refused):
    calibration.save(tmp_path / "unit.json")
    out = shell("apply", tmp_path / "unit.json", recording, "-o", tmp_path / "own").out
    number = r"(\d\S*)"
    text = " ".join(out.split())
    differences = rf"force from gravity {number} and {number} m/s², rate from the Earth's {number} and {number} °/h"
    force, left, *_ = map(float, re.search(differences, text).groups())
    raw = np.linalg.norm(srt.load_recording(recording).accel, axis=1)  # most samples are at rest
    assert force == pytest.approx(np.median(np.abs(raw - 9.80665)), rel=0.5)
    assert left < 0.1 * force
    other = simulated(tmp_path / "other", seed=5, recording='format = "npz"')
    err = refused("apply", tmp_path / "unit.json", other, "-o", tmp_path / "out")
    assert (
        f"{other}: {tmp_path / 'unit.json'} makes it worse (median differences at rest, before and after (windows: 34)"
        in err
    )
    assert not (tmp_path / "out").exists()
    shell("apply", tmp_path / "unit.json", other, "-o", tmp_path / "out", "--force")


def test_a_log_of_one_attitude_is_compared_and_one_without_a_rest_is_not(unit, tmp_path, shell):
    rng, n = np.random.default_rng(3), 600
    rest = {"time": 0.01 * np.arange(1, n + 1), "gyro": rng.normal(VECTOR[GROUP_SLICES["gyro_bias"]], 1e-5, (n, 3))}
    force = accel_triad(SensorErrors(VECTOR)).read(np.array([[0.0, 0.0, -9.80665]]))
    recorded(tmp_path / "rest", accel=rng.normal(force, 1e-4, (n, 3)), **rest)
    assert "(windows: 1)" in shell("apply", unit, tmp_path / "rest", "-o", tmp_path / "a").out
    few = {name: values[:7] for name, values in rest.items()} | {"accel": np.tile(force, (7, 1))}
    recorded(tmp_path / "short", **few)
    assert "Check: no stationary window was found" in shell("apply", unit, tmp_path / "short", "-o", tmp_path / "b").out


@pytest.mark.parametrize(
    ("kind", "scale", "fragment"),
    [
        ("rate", 0.01, "increments per sample, declared as rates"),
        ("rate", 1 / 9.8, "like g,"),
        ("increment", 1.0, "declared as increments"),
    ],
)
def test_wrong_kinds_and_units_are_told_from_gravity(unit, tmp_path, kind, scale, fragment, shell, refused):
    wrong = recorded(tmp_path / "wrong", kind, accel=np.tile([0.0, 0.0, -9.8 * scale], (300, 1)))
    line = ["apply", unit, wrong, "-o", tmp_path / "OUT"]
    assert fragment in require_force(line, tmp_path, shell, refused, code=1)


def test_samples_that_are_no_numbers_are_refused(line, unit, tmp_path, refused):
    folder = recorded(tmp_path / "bad", samples_format="csv")
    lines = (folder / "samples.csv").read_text().splitlines()
    lines[7] = ",".join(["nan" if i == 2 else cell for i, cell in enumerate(lines[7].split(","))])
    (folder / "samples.csv").write_text("\n".join(lines) + "\n")
    assert "gyro_y" in refused(*line(unit, folder))
    assert not list(tmp_path.glob("OUT*"))


def test_no_table_frame_without_a_fixture(raw, tmp_path, refused):
    calibrated(U=None).save(tmp_path / "free.json")
    sentence = refused("apply", tmp_path / "free.json", raw, "-o", tmp_path / "out", "--frame", "table")
    assert "no table frame" in sentence
    assert not (tmp_path / "out").exists()


def parameter(text, **values):
    document = json.loads(text)
    document["parameters"][0] |= values
    # A sign that is wrong everywhere makes the triad left-handed; one parameter, sigma.
    if values.get("value") == 1e9:
        document["parameters"][1]["value"] = -1e9
    return json.dumps(document)


@pytest.mark.parametrize(
    ("edit", "fragment"),
    [
        (lambda text: text[: len(text) // 2], "truncated"),
        (lambda text: text.replace('"version": 1', '"version": 2'), "version"),
        (lambda text: "", "not valid JSON"),
        (lambda text: text.replace('"format": "srt-calibration"', '"format": "mine"'), "no calibration file"),
        (lambda text: text.replace('"provenance"', '"origin"'), "edited or truncated"),
        (lambda text: text.replace('"covariance"', '"variance"'), "edited or truncated"),
        (lambda text: parameter(text, sigma=1.0), "does not agree with the covariance"),
        (lambda text: parameter(text, value=1e9), "edited"),
        (lambda text: parameter(text, value=-0.999), "edited"),
        (lambda text: parameter(text, value="much"), "parameters.0.value is 'much': a finite number is expected"),
        (lambda text: parameter(text, value=float("nan")), "finite"),
        (lambda text: json.dumps(json.loads(text) | {"provenance": []}), "provenance is []: an object with keys is"),
        (lambda text: json.dumps(json.loads(text) | {"estimator": None}), "estimator is None: a text is expected"),
    ],
)
def test_calibrations_that_were_edited_are_refused(line, unit, raw, tmp_path, edit, fragment, refused):
    document = json.loads(unit.read_text())
    del document["digest"]  # the values themselves are checked
    unit.write_text(edit(json.dumps(document)))
    assert fragment in refused(*line(unit, raw))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["raw", "unit.json"]


def test_an_edited_u_is_refused(raw, tmp_path, refused):
    calibrated(U=2.0 * U).save(tmp_path / "bad.json")
    for line in (["--c-header", tmp_path / "imu.h"], [raw, "-o", tmp_path / "out", "--frame", "table"]):
        assert "no rotation" in refused("apply", tmp_path / "bad.json", *line)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.json", "raw"]


def test_applied_to_its_own_recording_nothing_is_left_to_calibrate(recording, tmp_path, shell):
    """The corrected recording of a simulated unit calibrates to zero errors."""
    result, out = tmp_path / "unit.json", tmp_path / "out"
    shell("calibrate", recording, "-o", result, "-q")
    shell("apply", result, recording, "-o", out, "-q")
    again = srt.calibrate(srt.load_recording(out))
    assert np.abs(again.errors.vector / again.sigma).max() < 0.1
