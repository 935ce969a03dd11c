"""``srt align-mount``: the angles of the library, and what is refused before anything is written."""

import json
import math

import numpy as np
import pytest
from mount_motion import simulate_mount

import srt
from sims.physics.imu import ImuModel, read_out
from srt.model.rotations import rotation_matrix
from srt.mount.alignment import load_mount_alignment, mount_from_calibration
from srt.mount.poses import mount_from_recording
from srt.result.calibration import Calibration
from srt.result.provenance import Provenance
from srt.sensor_errors import N_PARAMETERS, SensorErrors

ANGLES = np.array([0.004, -0.003, 0.006])
U = rotation_matrix(np.array([0.01, -0.02, 0.03]))
SITE = srt.Site(9.80665, latitude_rad=0.8)
ERRORS = np.random.default_rng(3).uniform(-0.02, 0.02, N_PARAMETERS)


def calibrated(path, **changes):
    given = {"status": "converged", "U": U, "U_sigma_rad": 1e-3, "provenance": Provenance(serial="SN-7")} | changes
    P = np.eye(N_PARAMETERS) * 1e-12
    Calibration("closed-form", message="Done.", errors=SensorErrors(ERRORS), covariance=P, **given).save(path)
    return path


def recorded(folder, pitch_rad=(0.0, -0.5 * math.pi), *, serial="SN-7"):
    motion = simulate_mount(ANGLES, site=SITE, pitch_rad=pitch_rad, dwell_s=3.0, sample_rate_hz=50.0, labelled=False)
    imu = ImuModel(gyro_noise=1e-5, accel_noise=1e-5)
    recording = read_out(motion, SensorErrors(ERRORS), imu, np.random.default_rng(4), serial=serial)
    srt.write_recording(recording, folder, samples_format="npz")
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Hold a calibration and recordings that no test changes."""
    place = tmp_path_factory.mktemp("mount")
    calibrated(place / "unit.json")
    recorded(place / "raw")
    recorded(place / "flat", (0.0, 0.4))
    recorded(place / "other", serial="SN-8")
    return place


def test_a_recording_gives_the_librarys_angles(folder, tmp_path, shell):
    unit, output = folder / "unit.json", tmp_path / "mount.json"
    options = ["--level-sigma-mrad", "0.05", "--axis-sigma-mrad", "0.1"]
    out, err = shell("align-mount", folder / "raw", "--calibration", unit, "-o", output, *options)
    assert err == ""
    recording, calibration = srt.load_recording(folder / "raw"), srt.load_calibration(unit)
    expected = mount_from_recording(recording, calibration, level_sigma_rad=5e-5, axis_sigma_rad=1e-4)
    found = load_mount_alignment(output)
    np.testing.assert_array_equal(found.matrix, expected.matrix)
    np.testing.assert_array_equal(found.covariance, expected.covariance)
    # Noise of 1e-5 / sqrt(3 s) / g is 0.6 µrad; at most twice that in a row, six sigma.
    np.testing.assert_allclose(found.angles_rad, ANGLES, rtol=0, atol=6.0 * 1.2e-6)
    for name, value, sigma in zip(
        ("roll", "pitch", "yaw"), ("4.00", "-3.00", "6.00"), ("0.05", "0.05", "0.14"), strict=True
    ):
        line = next(line for line in out.splitlines() if line.split()[:1] == [name])
        assert line.split()[1].startswith(value[:-1])
        assert line.split()[2].startswith(sigma)
    assert "pitched, x down" in out
    assert f"Written: {output}" in out
    provenance = json.loads(output.read_text())["provenance"]
    assert provenance["serial"] == "SN-7"
    assert provenance["data_sha256"] == recording.data_sha256
    assert provenance["level_sigma_rad"] == pytest.approx(5e-5)


def test_default_stand_error_is_1_mrad(folder, shell):
    out, err = shell("align-mount", folder / "raw", "--calibration", folder / "unit.json")
    assert err == ""
    assert "Nothing was written" in out
    roll = next(line for line in out.splitlines() if line.split()[:1] == ["roll"])
    assert roll.split()[2] == "1.0"


def test_mount_alignment_without_a_recording_is_that_of_the_calibration(folder, tmp_path, shell):
    out, _ = shell("align-mount", "--calibration", folder / "unit.json", "-o", tmp_path / "mount.json")
    assert "From the rotation U" in out
    found = load_mount_alignment(tmp_path / "mount.json")
    expected = mount_from_calibration(srt.load_calibration(folder / "unit.json"))
    np.testing.assert_array_equal(found.matrix, expected.matrix)
    assert found.method == "play-back"


def test_quiet_says_nothing(folder, tmp_path, shell):
    files = ["--calibration", folder / "unit.json", "-o", tmp_path / "mount.json"]
    assert shell("align-mount", folder / "raw", *files, "-q") == ("", "")


def test_warnings_go_to_standard_error(folder, tmp_path, shell):
    recorded(tmp_path / "more", (0.0, -0.5 * math.pi, -2.4))
    out, err = shell("align-mount", tmp_path / "more", "--calibration", folder / "unit.json", "-q")
    assert out == ""
    assert err.startswith("srt: warning: 1 stationary windows are neither")


@pytest.mark.parametrize(
    ("arguments", "code", "fragment"),
    [
        (["flat", "--calibration", "UNIT"], 1, "pitched by about 90°"),
        (["other", "--calibration", "UNIT"], 2, "is of the unit SN-7"),
        (["absent", "--calibration", "UNIT"], 2, "absent"),
        (["raw", "--calibration", "absent.json"], 2, "absent.json"),
        (["raw"], 2, "--calibration"),
        (["raw", "--calibration", "UNIT", "-o", "OUT.toml"], 2, "ends in .json"),
        (["raw", "--calibration", "UNIT", "-o", "UNIT"], 2, "is the calibration itself"),
        (["raw", "--calibration", "UNIT", "--level-sigma-mrad", "0"], 2, "positive"),
        (["raw", "--calibration", "UNIT", "--axis-sigma-mrad", "nan"], 2, "positive"),
        (["--calibration", "UNIT", "--level-sigma-mrad", "1"], 2, "name their RECORDING"),
        (["--calibration", "FREE"], 2, "no table frame"),
        (["raw", "--calibration", "FAILED"], 2, "not_converged"),
    ],
)
def test_refusals_are_one_sentence_and_write_nothing(folder, tmp_path, arguments, code, fragment, refused):
    calibrated(tmp_path / "free.json", U=None, U_sigma_rad=None)
    calibrated(tmp_path / "failed.json", status="not_converged")
    places = {"UNIT": folder / "unit.json", "FREE": tmp_path / "free.json", "FAILED": tmp_path / "failed.json"}
    before = (folder / "unit.json").read_bytes()
    places |= {name: folder / name for name in ("raw", "flat", "other")}
    output = [] if "-o" in arguments else ["-o", tmp_path / "mount.json"]
    assert fragment in refused("align-mount", *(places.get(word, word) for word in arguments), *output, code=code)
    assert not (tmp_path / "mount.json").exists()
    assert (folder / "unit.json").read_bytes() == before


def test_force_takes_another_serial_and_an_inconsistent_calibration(folder, tmp_path, shell):
    unit = calibrated(tmp_path / "failed.json", status="inconsistent")
    assert shell("align-mount", folder / "other", "--calibration", unit, "--force", "-q") == ("", "")
