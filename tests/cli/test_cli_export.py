"""``srt export``: the file, the printed loss, and what is refused before anything is written."""

import re

import numpy as np
import pytest
from small_units import VECTOR, U

import srt
from srt import exporters
from srt.exporters import Readings, export
from srt.exporters.file_format import to_yaml
from srt.result.calibration import Calibration
from srt.sensor_errors import N_PARAMETERS, SensorErrors

pytest.importorskip("yaml")

TARGETS = {name: item.suffixes[0] for name, item in exporters.exporters().items()}
NUMBER = r"\d\.\d{3}e[+-]\d\d"


@pytest.mark.parametrize("target", TARGETS)
def test_the_file_and_the_loss(unit, raw, tmp_path, target, shell):
    """The printed losses are those of the library, and the written file is the library's."""
    output = tmp_path / f"out{TARGETS[target]}"
    out, err = shell("export", unit, "--to", target, "-o", output, "--recording", raw)
    assert (err == "") == (target not in ("kalibr", "openvins", "basalt"))  # random walks, which nobody stated
    readings = Readings.of(srt.load_recording(raw))
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
        # The rate is the recording's, which the library does not look up; the digest covers it.
        kept = [s for s in found.splitlines() if "update_rate" not in s]
        assert [s for s in kept if "digest:" not in s] == [s for s in text.splitlines() if "digest:" not in s]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        ["unit.json", "raw", *(f"out{part}{TARGETS[target]}" for part in made.texts)]
    )


def test_a_change_of_axes_is_told(unit, tmp_path, shell):
    out, _ = shell("export", unit, "--to", "imucal", "-o", tmp_path / "t.json", "--frame", "table")
    matrix = re.findall(r"^ +(-?\d\.\d{12}) +(-?\d\.\d{12}) +(-?\d\.\d{12})$", out, re.MULTILINE)
    np.testing.assert_allclose(np.array(matrix, dtype=float), U.T, rtol=0, atol=1e-12)
    # U turns by (0, 0.1, -0.05) rad, and what takes MARS to the table by the opposite.
    assert re.search(r"by \(-?0\.0000, -100\.0000, 50\.0000\) mrad", out)
    assert "T_cam_imu" in shell("export", unit, "--to", "kalibr").out


def test_a_yaml_file_has_no_rounding_of_the_rate_and_no_negative_zero(unit, tmp_path, shell):
    shell("export", unit, "--to", "kalibr", "-o", tmp_path / "k.yaml", "--rate-hz", "200.00000000000003", "-q")
    assert "update_rate: 200.0\n" in (tmp_path / "k.yaml").read_text()
    assert to_yaml({"A": [[-0.0, -1e-5]], "b": {"c": -0.0}}) == "A:\n  - [0.0, -1.0e-05]\nb: {c: 0.0}\n"


def test_without_a_file_only_the_loss_is_shown(unit, tmp_path, shell):
    out, _ = shell("export", unit, "--to", "pyins")
    assert "1 rad/s and 1 g in 1000 directions" in out
    assert "add -o FILE" in out
    assert [p.name for p in tmp_path.iterdir()] == ["unit.json"]


def test_several_targets_go_to_a_folder(unit, tmp_path, shell, refused):
    """An option is for the formats that take it; one that none takes is refused."""
    both = ("export", unit, "--to", "KALIBR", "--to", "pyins")
    out, _ = shell(*both, "-o", tmp_path / "files", "--topic", "/raw")
    assert {p.name for p in (tmp_path / "files").iterdir()} == {"kalibr.yaml", "kalibr-imu.yaml", "pyins.json"}
    assert "/raw" in (tmp_path / "files" / "kalibr-imu.yaml").read_text()
    assert out.count("Written to") == 3
    assert "a folder" in refused(*both, "-o", tmp_path / "all.yaml")
    assert "no place for prefix" in refused(*both, "-o", tmp_path / "none", "--prefix", "x")


def test_a_quiet_run_says_nothing(unit, tmp_path, shell):
    assert shell("export", unit, "--to", "pyins", "-o", tmp_path / "p.json", "-q") == ("", "")
    assert (tmp_path / "p.json").exists()


def test_the_fit_suits_the_recording_better(unit, raw, shell):
    def rms(*options):
        out, _ = shell("export", unit, "--to", "pyins", "--recording", raw, *options)
        return float(re.search(rf"this file +{NUMBER} +{NUMBER} +{NUMBER} +({NUMBER})", out)[1])

    # z sees -9.8 m/s² throughout: its asymmetry is all of a slope there.
    assert rms("--fit-asymmetry") < 0.5 * rms()


def test_figures_that_are_stated_are_in_the_file(unit, tmp_path, shell):
    line = [unit, "--to", "kalibr", "-o", tmp_path / "k.yaml", "--rate-hz", 100, "--topic", "/raw", "-q"]
    _, err = shell("export", *line, "--gyro-random-walk", 1e-5, "--accel-random-walk", 1e-4)
    assert err == ""
    text = (tmp_path / "k.yaml").read_text()
    for part in ("update_rate: 100.0", "rostopic: /raw", "gyroscope_random_walk: 1.0e-05"):
        assert part in text
    assert "gyro random walk" in shell("export", *line).err


def test_the_list_names_every_target(shell):
    out, _ = shell("export", "--list")
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
def test_wrong_usage(unit, raw, tmp_path, monkeypatch, arguments, fragment, refused):
    monkeypatch.chdir(tmp_path)
    before = unit.read_bytes()
    assert fragment in refused("export", unit, *arguments)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["raw", "unit.json"]
    assert unit.read_bytes() == before


def test_value_beyond_the_limits_of_the_target_is_refused(tmp_path, refused):
    vector = VECTOR.copy()
    vector[9:12] = 5.0
    wrong = Calibration("closed-form", "converged", "Done.", SensorErrors(vector), np.eye(N_PARAMETERS) * 1e-10)
    wrong.save(tmp_path / "unit.json")
    line = [tmp_path / "unit.json", "--to", "ardupilot", "-o", tmp_path / "a.param"]
    assert "--applied ardupilot:FILE" in refused("export", *line)
    sentence = refused("export", *line, "--applied", "none")
    assert "3.5 m/s²" in sentence
    assert [p.name for p in tmp_path.iterdir()] == ["unit.json"]
