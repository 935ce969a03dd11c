"""``srt calibrate --merge``: one calibration of several recordings, and how well they repeat."""

import json
from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
from small_units import on_fixture

import srt
import srt.estimation.registry
from sims.physics.imu import read_out
from srt.comparison.merge import merge_calibrations
from srt.result.provenance import Provenance
from srt.sensor_errors import NAMES

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Make three recordings of one unit, each with its own fixture errors and noise, date and temperature."""
    folder = tmp_path_factory.mktemp("unit")
    rng = np.random.default_rng(31)
    truth = accuracy_trials.normal_errors(rng, 1e-3)
    paths = []
    for n, name in enumerate(("monday", "tuesday", "friday")):
        motion = on_fixture(rng, dwell_s=4.0)
        recording = read_out(motion, truth, accuracy_trials.GRADES["navigation"], rng)
        recording = replace(
            recording, serial="SN-9", date=f"2026-03-0{n + 1}", temperature=np.full(len(recording.time), 20.0 + n)
        )
        srt.write_recording(recording, folder / name, samples_format="npz")
        paths.append(folder / name)
    return tuple(map(str, paths))


@pytest.fixture(scope="module")
def calibrations(folders):
    return [srt.calibrate(srt.load_recording(folder)) for folder in folders]


def test_result_is_the_librarys(folders, calibrations, tmp_path, shell):
    path = tmp_path / "unit.json"
    out = shell("calibrate", "--merge", *folders, "-o", path).out
    expected = merge_calibrations(calibrations, ["monday", "tuesday", "friday"])
    assert srt.load_calibration(path).to_dict() == expected.to_dict()
    assert [p.name for p in tmp_path.iterdir()] == ["unit.json"]
    assert "Merged from 3 recordings" in out
    assert str(path) in out
    for word in ("tuesday", "2026-03-02", "22.0", "Repeatability", "Verdict", "scatter:"):
        assert word in out
    assert max(len(line) for line in out.splitlines() if str(path) not in line) <= 80
    assert "\x1b" not in out
    rows = [line.split() for line in out.splitlines() if len(line.split()) > 1 and line.split()[1] in NAMES]
    assert [row[1] for row in rows] == list(NAMES)


def test_calibrations_stand_for_their_recordings(folders, calibrations, tmp_path, monkeypatch, shell):
    """Files of before, or of other estimators, beside a recording; nothing is calibrated twice."""
    monkeypatch.setattr("srt.cli.progress._LINE_EVERY_S", -1.0)
    files = []
    for calibration, name in zip(calibrations[:2], ("monday", "tuesday"), strict=True):
        calibration.save(tmp_path / f"{name}.json")
        files.append(str(tmp_path / f"{name}.json"))
    out, err = shell("calibrate", "--merge", *files, folders[2], "-o", tmp_path / "unit.json", "--verdict")
    assert "monday: iteration" not in err
    assert "friday: iteration" in err
    assert "inde-" in out
    expected = merge_calibrations(calibrations, ["monday", "tuesday", "friday"])
    assert srt.load_calibration(tmp_path / "unit.json").to_dict() == expected.to_dict()


def test_plot_truth_and_quiet(folders, tmp_path, shell):
    pytest.importorskip("matplotlib")
    merged, figure = tmp_path / "unit.json", tmp_path / "unit.svg"
    truth = {"format": "srt-truth", "version": 1, "parameters": dict.fromkeys(NAMES, 0.0)}
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    arguments = ["-o", str(merged), "--plot", str(figure), "--truth", str(tmp_path / "truth.json")]
    assert "error" in shell("calibrate", "--merge", *folders[:2], *arguments).out
    assert figure.stat().st_size > 0
    out, err = shell("calibrate", "--merge", *folders[:2], "-q")
    assert out == err == ""


def test_recordings_that_cannot_be_calibrated_are_left_out(folders, tmp_path, monkeypatch, shell):
    found = srt.estimation.registry.find_estimator

    def estimator(name):
        def estimate(recording, options, progress=None):
            if recording.date == "2026-03-01":
                raise srt.DataError("It cannot be.")
            result = found("closed-form")(recording, options, progress)
            return replace(result, status="not_converged", message="It did not.") if failing else result

        return estimate

    failing = False
    monkeypatch.setattr(srt.estimation.registry, "find_estimator", estimator)
    err = shell("calibrate", "--merge", *folders, "-q", "-o", tmp_path / "unit.json").err
    assert err.splitlines() == [f"srt: warning: {folders[0]} is left out: It cannot be."]
    assert len(srt.load_calibration(tmp_path / "unit.json").provenance.recordings) == 2
    assert "Only tuesday can be calibrated" in shell("calibrate", "--merge", *folders[:2], "-q", code=1).err
    failing = True
    err = shell("calibrate", "--merge", *folders, "-q", "-o", tmp_path / "none.json", code=1).err
    assert "tuesday is not converged, friday is not converged" in err
    assert not (tmp_path / "none.json").exists()


def test_different_units_are_refused(folders, calibrations, tmp_path, shell):
    other = replace(calibrations[0], provenance=Provenance(serial="SN-10"))
    other.save(tmp_path / "other.json")
    err = shell("calibrate", "--merge", folders[1], tmp_path / "other.json", "-q", code=2).err
    assert err == "srt: These are different units: tuesday has the serial SN-9, other has SN-10.\n"


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["{0}"], "at least two recordings of a unit"),
        (["{0}", "{0}/recording.toml"], "is named twice"),
        (["{0}", "{1}", "-o", "{0}"], "The merged calibration cannot be written"),
        (["{0}", "{1}", "-o", "{0}/samples.npz"], "ends in .json"),
        (["{0}", "{1}", "--plot", "{0}/x.txt"], "The plot cannot be written"),
        (["{0}", "{1}", "--prior", "{0}/prior.json"], "--merge and --prior do not go together"),
        (["{0}", "{0}/absent"], "There is no recording"),
        (["{0}", "{0}/absent.json"], "cannot be read"),
    ],
)
def test_wrong_usage_is_one_sentence(folders, arguments, fragment, shell):
    err = shell("calibrate", "--merge", "-q", *(a.format(*folders) for a in arguments), code=2).err
    assert fragment in err
    assert err.count("\n") == 1
    assert "Traceback" not in err


def test_different_units_without_serials_are_not_merged_in_silence(calibrations, tmp_path, shell):
    rng = np.random.default_rng(3)
    files = []
    for n, calibration in enumerate(calibrations):
        errors = srt.SensorErrors(calibration.errors.vector + n * 1e-3 * rng.standard_normal(27))
        provenance = replace(calibration.provenance, serial=None)
        file = tmp_path / f"unit-{n}.json"
        replace(calibration, errors=errors, provenance=provenance).save(file)
        files.append(str(file))
    err = shell("calibrate", "--merge", *files, "-q", code=1).err
    assert "times their sigmas (RMS over all parameters): are they of one unit?" in err
    shell("calibrate", "--merge", *files, "-q", "--force")
