"""``srt demo``: the chain from simulation to verdict, as a newcomer runs it."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import srt
from srt.cli import main
from srt.cli.truth import load_truth
from srt.reports.text.calibration_summary import largest_error_text
from srt.sensor_errors import NAMES

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Run it once."""
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["demo"]) == 0
    return folder / "demo-output"


def test_it_writes_recording_result_and_plot(demo):
    assert sorted(p.name for p in demo.iterdir()) == ["calibration.json", "calibration.png", "recording"]
    assert (demo / "calibration.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in (demo / "recording").iterdir()) == ["recording.toml", "samples.npz", "truth.json"]


def test_its_errors_are_those_that_its_sigmas_promise(demo):
    """27 normal draws stay below 4.2 sigma with a probability of 0.9993: the demo's seed is no lucky one."""
    calibration = srt.load_calibration(demo / "calibration.json")
    assert calibration.status == "converged"
    truth = load_truth(demo / "recording" / "truth.json")
    ratio = (calibration.errors.vector - truth.vector) / calibration.sigma
    assert np.abs(ratio).max() < 4.2
    # Chi-square of 27 degrees of freedom: 9.1 to 55 hold 99.9 % of it; correlation widens that a little.
    assert 7.0 < ratio @ ratio < 70.0


def test_calibrate_finds_the_same(demo, tmp_path, shell):
    again = tmp_path / "again.json"
    shell("calibrate", demo / "recording", "-q", "-o", again)
    assert again.read_text() == (demo / "calibration.json").read_text()


def test_it_replaces_its_own_recording_and_no_other(demo, shell, refused):
    out, _ = shell("demo", "-o", demo, "--seed", "7", "-q")
    truth = demo / "recording" / "truth.json"
    assert '"seed": 7' in truth.read_text()
    assert out.startswith("The largest error is ")
    truth.rename(demo / "truth.json")
    assert "holds files already" in refused("demo", "-o", demo)
    (demo / "truth.json").rename(truth)


def test_without_matplotlib_there_is_no_plot_and_a_warning(tmp_path, monkeypatch, shell):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for name in ("plots", "figure_style"):
        monkeypatch.delitem(sys.modules, f"srt.{name}", raising=False)
        if hasattr(srt, name):
            monkeypatch.delattr(srt, name)
    monkeypatch.setattr("srt.cli.demo.SCENARIO", "noise-free")
    assert "No plot will be made" in shell("demo", "-o", tmp_path, "-q").err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["calibration.json", "recording"]


def test_verdict_names_the_worst_and_the_bound():
    """(2Φ(3.11) − 1)^27 = 0.95; a smaller number of draws has a smaller bound."""
    sigma = np.full(27, 2.0)
    calibration = srt.Calibration("x", "converged", "", srt.SensorErrors(), np.diag(sigma**2))
    error = np.zeros(27)
    error[4] = -5.0
    text = " ".join(largest_error_text(calibration, srt.SensorErrors(error)).split())
    assert f"The largest error is 2.50 sigma ({NAMES[4]})" in text
    assert "the largest of 27 normal draws stays below 3.11 sigma in 95% of all runs" in text
    assert text.endswith("agrees with the truth.")
    error[4] = 8.0
    assert "does not agree with the truth" in " ".join(largest_error_text(calibration, srt.SensorErrors(error)).split())
    held = replace(calibration, fixed=dict.fromkeys(NAMES[4:], "held on request"))
    assert "of 4 normal draws stays below 2.49 sigma" in " ".join(largest_error_text(held, srt.SensorErrors()).split())
