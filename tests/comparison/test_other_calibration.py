"""A calibration of another program beside ours: parameters in sigma, and residuals of both and of none."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_units import recorded, simulated

import srt
from srt.comparison.other_calibration import compare_with
from srt.constants import EARTH_RATE_RAD_S
from srt.exporters import export, load, save
from srt.exporters.conversion import load_any
from srt.exporters.registry import exporters
from srt.reports.text.other_calibration import conclusion
from srt.sensor_errors import INDEX, NAMES, SensorErrors

READABLE = sorted(name for name, item in exporters().items() if item.imports)
WITH_BIASES = sorted(name for name in READABLE if exporters()[name].biases)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Simulated test of a unit with its true errors as the calibration, and this in another format."""
    folder = tmp_path_factory.mktemp("other")
    simulated(folder / "rec", dwell_s=2.0, sample_rate_hz=50.0)
    truth = json.loads((folder / "rec" / "truth.json").read_text())
    errors = {**truth["parameters"], **{name: 0.0 for name in NAMES if "asymmetry" in name}}
    recording = srt.load_recording(folder / "rec")
    found = srt.calibrate(recording, checks=False)
    calibration = replace(found, errors=SensorErrors.from_dict(errors))
    calibration.save(folder / "unit.json")
    save(export(calibration, "pyins", frame="mars"), folder / "pyins.json")
    return folder


@pytest.mark.parametrize("target", READABLE)
def test_every_format_that_is_read_back_is_recognised(folder, tmp_path, target):
    pytest.importorskip("yaml")
    unit = srt.load_calibration(folder / "unit.json")
    path = tmp_path / f"file{exporters()[target].suffixes[0]}"
    stated = srt.recording.applied.AppliedCorrection("none")
    save(export(unit, target, applied=stated), path)
    name, found = load_any(str(path))
    assert name == target
    held = ~np.array(["asymmetry" in n or ("bias" in n and target not in WITH_BIASES) for n in NAMES])
    np.testing.assert_allclose(found.errors.vector[held], unit.errors.vector[held], rtol=0.0, atol=1e-5)


def test_the_same_calibration_in_another_format_differs_by_nothing(folder):
    unit, recording = srt.load_calibration(folder / "unit.json"), srt.load_recording(folder / "rec")
    found = compare_with(unit, load(folder / "pyins.json", "pyins"), recording)
    np.testing.assert_allclose(found.normalised[found.held], 0.0, atol=1e-6)
    assert not any(held for held, name in zip(found.held, NAMES, strict=True) if "asymmetry" in name)
    assert found.residuals["this"].turn.rms == pytest.approx(found.residuals["other"].turn.rms, rel=1e-6)
    # A navigation-grade unit measures the Earth's rate: 17 turns, which it removes to a fraction of 0.1 mrad.
    assert found.earth_removed
    assert found.residuals["this"].turn.rms < 0.1e-3 < found.residuals["none"].turn.rms


@pytest.mark.parametrize(
    ("name", "step", "residual"),
    [("accel_scale_x", 1e-3, "force"), ("gyro_bias_y", 1e-4, "rate"), ("gyro_scale_z", 5e-3, "turn")],
)
def test_an_error_of_the_other_file_is_seen_in_sigma_and_in_the_residual_that_it_concerns(folder, name, step, residual):
    unit, recording = srt.load_calibration(folder / "unit.json"), srt.load_recording(folder / "rec")
    vector = unit.errors.vector.copy()
    vector[INDEX[name]] += step
    wrong = replace(load(folder / "pyins.json", "pyins"), errors=SensorErrors(vector))
    found = compare_with(unit, wrong, recording)
    assert found.normalised[INDEX[name]] == pytest.approx(step / unit.sigma[INDEX[name]], rel=1e-9)
    ours, theirs = (getattr(found.residuals[key], residual) for key in ("this", "other"))
    assert theirs.largest > 3.0 * ours.largest
    if name == "gyro_bias_y":
        # The bias adds to the Earth's rate as vectors do.
        assert step - 2.0 * EARTH_RATE_RAD_S < theirs.largest < step + EARTH_RATE_RAD_S
    if name == "accel_scale_x":
        # x stands up in some pose, with 1 g on it; the asymmetry, which is left out of both, remains of both.
        assert theirs.largest == pytest.approx(step * recording.site.gravity_m_s2, abs=1.05 * ours.largest)


def test_the_conclusion_names_what_differs_and_whose_residual_is_smaller(folder):
    unit, recording = srt.load_calibration(folder / "unit.json"), srt.load_recording(folder / "rec")
    vector = unit.errors.vector.copy()
    vector[INDEX["accel_scale_x"]] += 1e-3
    found = compare_with(unit, replace(load(folder / "pyins.json", "pyins"), errors=SensorErrors(vector)), recording)
    text = conclusion(found, "a.json", "b.json")
    assert text.startswith(
        "1 of 21 parameters differ by more than 3 sigma (accel_scale_x); smaller rms residual: a.json ("
    )
    assert "asymmetry" not in text
    vector[INDEX["gyro_asymmetry_x"]] = 1e-5
    asymmetric = replace(found, calibration=replace(unit, errors=SensorErrors(vector)))
    assert "b.json has no place for the scale-factor asymmetry" in conclusion(asymmetric, "a.json", "b.json")


def test_the_reason_of_the_closest_format_is_given(folder, tmp_path):
    pytest.importorskip("yaml")
    path = tmp_path / "chain.yaml"
    save(export(srt.load_calibration(folder / "unit.json"), "kalibr"), path)
    path.write_text(path.read_text().replace("model: scale-misalignment", "model: calibrated"))
    with pytest.raises(srt.InputError, match="model of imu0 is 'calibrated', but scale-misalignment is expected"):
        load_any(str(path))


def test_the_command_shows_both_and_writes_json(folder, tmp_path, shell):
    words = ("compare", folder / "unit.json", "--with", folder / "pyins.json", folder / "rec")
    out, err = shell(*words, "-o", tmp_path / "pair.json")
    assert err == ""
    rows = [line.split() for line in out.splitlines()]
    scale = next(row for row in rows if row[:1] == ["gyro_scale_x"])
    assert scale[-1] == "0.0"
    titles = [line[:16].strip() for line in out.splitlines()[3:6]]
    assert titles == ["unit.json", "pyins.json", "no calibration"]
    assert "was made from this recording" in " ".join(out.split())
    assert (
        "0 of 21 parameters differ by more than 3 sigma; smaller rms residual: neither (force, rate, turn)."
        in " ".join(out.split())
    )
    document = json.loads((tmp_path / "pair.json").read_text())
    assert document["residuals"]["none"]["turn"]["rms"] > 1e-4
    assert all(len(line) <= 80 for line in out.splitlines() if str(tmp_path) not in line)


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["REC", "--with", "FILE"], "give CALIBRATION and RECORDING"),
        (["UNIT", "REC"], "--with FILE"),
        (["UNIT", "REC", "--with", "FILE", "--estimator", "ekf"], "--estimator belongs"),
        (["UNIT", "REC", "--with", "UNIT"], "is of no format that can be read back"),
        (["UNIT", "REC", "--with", "kalibr:FILE"], "Kalibr"),
        (["UNIT", "REC", "--with", "absent.yaml"], "There is no file absent.yaml"),
        (["UNIT", "REC", "--with", "COUNTS"], "times gravity at rest"),
        (["UNIT", "OTHER", "--with", "FILE"], "is of the unit SN-7, but the recording"),
    ],
)
def test_wrong_usage_is_refused(folder, tmp_path, words, fragment, refused):
    pytest.importorskip("yaml")
    other = recorded(tmp_path / "other", serial="SN-8") if "OTHER" in words else None
    paths = {"REC": folder / "rec", "UNIT": folder / "unit.json", "FILE": folder / "pyins.json", "OTHER": other}
    # A file for readings in counts is refused by the size of what it makes of readings in SI units.
    counts = json.loads((folder / "pyins.json").read_text())
    for sensor in ("gyro", "accel"):
        counts[sensor]["transform"] = (400.0 * np.array(counts[sensor]["transform"])).tolist()
    (tmp_path / "counts.json").write_text(json.dumps(counts))
    paths["COUNTS"] = tmp_path / "counts.json"
    words = [f"kalibr:{paths['FILE']}" if word == "kalibr:FILE" else paths.get(word, word) for word in words]
    assert fragment in refused("compare", *words)
