"""``srt export``: the file, the printed loss, and what is refused before anything is written."""

import json
import re

import numpy as np
import pytest

import srt
from srt import exporters
from srt.cli import main
from srt.exporters import Readings, export
from srt.model.rotations import rotation_matrix
from srt.result.calibration import Calibration
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Provenance, StatedSite
from srt.sensor_errors import N_PARAMETERS, SensorErrors

pytest.importorskip("yaml")

U = rotation_matrix(np.array([0.0, 0.1, -0.05]))
VECTOR = np.random.default_rng(3).uniform(-0.02, 0.02, N_PARAMETERS)
TARGETS = {name: item.suffixes[0] for name, item in exporters.exporters().items()}
NUMBER = r"\d\.\d{3}e[+-]\d\d"


def calibrated(**changes):
    given = {
        "status": "converged",
        "U": U,
        "site": StatedSite(gravity_m_s2=9.81),
        "noise": NoiseFigures(gyro_noise_rad_per_sqrt_s=np.full(3, 1e-6), accel_noise_m_s2_sqrt_s=np.full(3, 1e-4)),
        "provenance": Provenance(serial="SN-7", data_sha256="0" * 64, applied={"system": "none"}),
    }
    covariance = np.eye(N_PARAMETERS) * 1e-10
    return Calibration(
        "closed-form", message="Done.", errors=SensorErrors(VECTOR), covariance=covariance, **(given | changes)
    )


@pytest.fixture
def unit(tmp_path):
    calibrated().save(tmp_path / "unit.json")
    return tmp_path / "unit.json"


def recorded(folder, **changes):
    rng = np.random.default_rng(4)
    n, dt = 300, 0.01
    given = {
        "time": np.arange(1, n + 1) * dt,
        "gyro": rng.normal(size=(n, 3)),
        "accel": rng.normal(size=(n, 3)) - np.array([0.0, 0.0, 9.8]),
        "site": srt.Site(9.80665, latitude_rad=0.7),
        "serial": "SN-7",
    }
    srt.write_recording(srt.Recording(**(given | changes)), folder, samples_format="csv")
    return folder


@pytest.fixture
def recording(tmp_path):
    return recorded(tmp_path / "raw")


def run(capfd, *arguments, code=0):
    assert main(["export", *map(str, arguments)]) == code
    return capfd.readouterr()


def refused(capfd, *arguments, code=2):
    out, err = run(capfd, *arguments, code=code)
    assert out == ""
    assert err.startswith("srt: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("target", TARGETS)
def test_the_file_and_the_loss(unit, recording, tmp_path, capfd, target):
    """The printed losses are those of the library, and the written file is the library's."""
    output = tmp_path / f"out{TARGETS[target]}"
    out, err = run(capfd, unit, "--to", target, "-o", output, "--recording", recording)
    assert (err == "") == (target not in ("kalibr", "openvins", "basalt"))  # random walks, which nobody stated
    readings = Readings.of(srt.load_recording(recording))
    made = export(srt.load_calibration(unit), target, readings=readings)
    rows = re.findall(rf"^ (\S.*?) +({NUMBER}) +({NUMBER}) +({NUMBER}) +({NUMBER})$", out, re.MULTILINE)
    assert [title for title, *_ in rows] == [r.title for r in made.residuals]
    for (_, *printed), r in zip(rows, made.residuals, strict=True):
        assert printed == [f"{v:.3e}" for v in (r.gyro_max, r.gyro_rms, r.accel_max, r.accel_rms)]
    for loss in made.losses:
        assert loss in out
    assert made.format.formula in out
    written = re.findall(r"^Written to (.*)$", out, re.MULTILINE)
    assert len(written) == len(made.texts)
    for place, (part, text) in zip(written, made.texts.items(), strict=True):
        found = (tmp_path / f"out{part}{TARGETS[target]}").read_bytes().decode()
        assert str(tmp_path / f"out{part}{TARGETS[target]}") == place
        # The rate is the recording's, which the library does not look up.
        assert [s for s in found.splitlines() if "update_rate" not in s] == text.splitlines()
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        ["unit.json", "raw", *(f"out{part}{TARGETS[target]}" for part in made.texts)]
    )


def test_a_change_of_axes_is_told(unit, tmp_path, capfd):
    out, _ = run(capfd, unit, "--to", "imucal", "-o", tmp_path / "t.json", "--frame", "table")
    matrix = re.findall(r"^ +(-?\d\.\d{12}) +(-?\d\.\d{12}) +(-?\d\.\d{12})$", out, re.MULTILINE)
    np.testing.assert_allclose(np.array(matrix, dtype=float), U.T, rtol=0, atol=1e-12)
    # U turns by (0, 0.1, -0.05) rad, and what takes MARS to the table by the opposite.
    assert re.search(r"by \(-?0\.0000, -100\.0000, 50\.0000\) mrad", out)
    assert "T_cam_imu" in run(capfd, unit, "--to", "kalibr").out


def test_without_a_file_only_the_loss_is_shown(unit, tmp_path, capfd):
    out, _ = run(capfd, unit, "--to", "pyins")
    assert "1 rad/s and 1 g in 1000 directions" in out
    assert "add -o FILE" in out
    assert [p.name for p in tmp_path.iterdir()] == ["unit.json"]


def test_a_quiet_run_says_nothing(unit, tmp_path, capfd):
    assert run(capfd, unit, "--to", "pyins", "-o", tmp_path / "p.json", "-q") == ("", "")
    assert (tmp_path / "p.json").exists()


def test_the_fit_suits_the_recording_better(unit, recording, capfd):
    def rms(*options):
        out, _ = run(capfd, unit, "--to", "pyins", "--recording", recording, *options)
        return float(re.search(rf"this file +{NUMBER} +{NUMBER} +{NUMBER} +({NUMBER})", out)[1])

    # z sees -9.8 m/s² throughout: its asymmetry is all of a slope there.
    assert rms("--fit-asymmetry") < 0.5 * rms()


def test_figures_that_are_stated_are_in_the_file(unit, tmp_path, capfd):
    line = [unit, "--to", "kalibr", "-o", tmp_path / "k.yaml", "--rate-hz", 100, "--topic", "/raw", "-q"]
    _, err = run(capfd, *line, "--gyro-random-walk", 1e-5, "--accel-random-walk", 1e-4)
    assert err == ""
    text = (tmp_path / "k.yaml").read_text()
    for part in ("update_rate: 100.0", "rostopic: /raw", "gyroscope_random_walk: 1.0e-05"):
        assert part in text
    assert "gyro random walk" in run(capfd, *line).err


def test_the_list_names_every_target(capfd):
    out, _ = run(capfd, "--list")
    assert [line.split()[0] for line in out.splitlines()[2:]] == list(TARGETS)


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ([], "--to"),
        (["--to", "kalib"], "did you mean kalibr"),
        (["--to", "kalibr", "-o", "OUT.json"], ".yaml"),
        (["--to", "pyins", "-o", "unit.json"], "is the calibration itself"),
        (["--to", "pyins", "-o", "absent/p.json"], "Cannot write"),
        (["--to", "kalibr", "--frame", "mars"], "takes accel"),
        (["--to", "imucal", "--rate-hz", "100"], "no place for rate_hz"),
        (["--to", "px4", "--instance", "12"], "instance"),
        (["--to", "pyins", "--fit-asymmetry"], "--recording"),
        (["--to", "ros2", "--recording", "raw", "--fit-asymmetry"], "holds it"),
        (["--to", "pyins", "--recording", "absent"], "absent"),
    ],
)
def test_wrong_usage(unit, recording, tmp_path, capfd, monkeypatch, arguments, fragment):
    monkeypatch.chdir(tmp_path)
    before = unit.read_bytes()
    assert fragment in refused(capfd, unit, *arguments)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["raw", "unit.json"]
    assert unit.read_bytes() == before


def test_another_unit_needs_force(unit, tmp_path, capfd):
    other = recorded(tmp_path / "other", serial="SN-8")
    line = [unit, "--to", "pyins", "-o", tmp_path / "p.json", "--recording", other]
    sentence = refused(capfd, *line)
    assert "SN-7" in sentence
    assert "SN-8" in sentence
    assert not (tmp_path / "p.json").exists()
    run(capfd, *line, "--force", "-q")


@pytest.mark.parametrize("status", ["not_converged", "outside_model"])
def test_a_calibration_that_did_not_converge_needs_force(tmp_path, capfd, status):
    calibrated(status=status).save(tmp_path / "bad.json")
    line = [tmp_path / "bad.json", "--to", "pyins", "-o", tmp_path / "p.json"]
    assert status in refused(capfd, *line)
    assert not (tmp_path / "p.json").exists()
    run(capfd, *line, "--force", "-q")


def parameter(text, **values):
    document = json.loads(text)
    document["parameters"][0] |= values
    return json.dumps(document)


@pytest.mark.parametrize(
    ("edit", "fragment"),
    [
        (lambda text: text[: len(text) // 2], "truncated"),
        (lambda text: text.replace('"version": 1', '"version": 2'), "version"),
        (lambda text: text.replace('"format": "srt-calibration"', '"format": "mine"'), "no calibration file"),
        (lambda text: parameter(text, value=float("nan")), "finite"),
        (lambda text: parameter(text, value=-0.999), "edited"),
        (lambda text: parameter(text, sigma=1.0), "does not agree with the covariance"),
        (lambda text: text.replace('"covariance"', '"variance"'), "edited or truncated"),
    ],
)
@pytest.mark.parametrize("target", ["kalibr", "ros2"])
def test_calibrations_that_were_edited_are_refused(unit, tmp_path, capfd, edit, fragment, target):
    document = json.loads(unit.read_text())
    del document["digest"]  # the values themselves are checked
    unit.write_text(edit(json.dumps(document)))
    assert fragment in refused(capfd, unit, "--to", target, "-o", tmp_path / "o.yaml")
    assert [p.name for p in tmp_path.iterdir()] == ["unit.json"]


def test_samples_that_are_no_numbers_are_refused(unit, recording, tmp_path, capfd):
    lines = (recording / "samples.csv").read_text().splitlines()
    lines[7] = ",".join(["nan" if i == 2 else cell for i, cell in enumerate(lines[7].split(","))])
    (recording / "samples.csv").write_text("\n".join(lines) + "\n")
    line = [unit, "--to", "pyins", "-o", tmp_path / "p.json", "--recording", recording]
    assert "gyro_y" in refused(capfd, *line)
    assert not (tmp_path / "p.json").exists()


def test_held_parameters_are_a_warning(tmp_path, capfd):
    partial = calibrated(status="partial", held={"gyro_bias_x": "held on request"})
    partial.covariance[24] = partial.covariance[:, 24] = 0.0
    partial.save(tmp_path / "partial.json")
    _, err = run(capfd, tmp_path / "partial.json", "--to", "pyins", "-q")
    assert "fixed, not observed: gyro_bias_x" in err


def test_value_beyond_the_limits_of_the_target_is_refused(tmp_path, capfd):
    vector = VECTOR.copy()
    vector[9:12] = 5.0
    wrong = Calibration("closed-form", "converged", "Done.", SensorErrors(vector), np.eye(N_PARAMETERS) * 1e-10)
    wrong.save(tmp_path / "unit.json")
    line = [tmp_path / "unit.json", "--to", "ardupilot", "-o", tmp_path / "a.param"]
    assert "--applied ardupilot:FILE" in refused(capfd, *line)
    sentence = refused(capfd, *line, "--applied", "none")
    assert "3.5 m/s²" in sentence
    assert [p.name for p in tmp_path.iterdir()] == ["unit.json"]
