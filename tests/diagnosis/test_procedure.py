"""Calibration of recordings that were looked through for faults first."""

from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
from injected_faults.injection import Case

import srt
from srt.constants import DEG
from srt.estimation.options import Options
from srt.procedure import calibrate


@pytest.fixture(scope="module")
def recording():
    return Case("tactical-fog", 900).recording


def test_a_sound_recording_gains_nothing(recording):
    examined = calibrate(recording, options=Options())
    plain = srt.calibrate(recording)
    np.testing.assert_array_equal(examined.errors.vector, plain.errors.vector)
    assert examined.diagnostics.faults == ()
    assert examined.warnings == plain.warnings


def test_a_fault_that_makes_it_senseless_refuses_it_by_name(recording):
    wrong = replace(recording, gyro=recording.gyro / DEG)
    with pytest.raises(srt.DataError, match="correct gyro_unit") as caught:
        calibrate(wrong, options=Options())
    assert caught.value.fault == "gyro_degrees"


def test_force_goes_on_to_what_the_calibration_itself_says(recording):
    wrong = replace(recording, gyro=recording.gyro / DEG)
    with pytest.raises(srt.DataError, match=r"The likely cause: .* correct gyro_unit"):
        calibrate(wrong, options=Options(), force=True)


def test_a_fault_that_is_told_stands_with_the_result(recording):
    wrong = replace(recording, site=replace(recording.site, gravity_m_s2=9.78))
    examined = calibrate(wrong, options=Options())
    (finding,) = [f for f in examined.diagnostics.faults if f.fault == "gravity"]
    assert finding.effect == "warning"
    assert finding.sentence in examined.warnings


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_missing_sequences_are_no_warning_of_a_result(estimator):
    """The recorded moves carry what the closed form cannot estimate; it fixes that, and names the sequence itself."""
    whole, _ = accuracy_trials.fixture_recording(21, "tactical", moves="recorded", sample_rate_hz=50.0)
    recording = replace(whole, sequences=tuple(s for s in whole.sequences if s.id not in ("6", "9")))
    result = srt.calibrate(recording, estimator)
    assert not any("cannot" in warning for warning in result.warnings)
    assert any("sequence 6 is missing" in reason for reason in result.held.values()) == (estimator == "closed-form")
    (found,) = [f for f in srt.inspect(recording).diagnosis.findings if f.fault == "sequence_missing"]
    assert "the closed form cannot estimate gyro_orthogonality_xy" in found.sentence
    assert "--estimator least-squares" in found.sentence


def test_faults_that_only_a_calibration_shows_are_searched_for(recording):
    truth = srt.SensorErrors.from_dict({"gyro_asymmetry_x": 2e-3})
    from accuracy_trials import GRADES

    from sims.physics.imu import read_out

    case = Case("tactical-fog", 901)
    asymmetric = read_out(case.simulation.motion, truth, GRADES["tactical"], np.random.default_rng(1))
    examined = calibrate(asymmetric, options=Options(asymmetry=False))
    assert "asymmetry_omitted" in [f.fault for f in examined.diagnostics.faults]


def test_findings_survive_the_file(recording, tmp_path):
    wrong = replace(recording, site=replace(recording.site, gravity_m_s2=9.78))
    calibrate(wrong, options=Options()).save(tmp_path / "unit.json")
    loaded = srt.load_calibration(tmp_path / "unit.json")
    assert [f.fault for f in loaded.diagnostics.faults] == ["gravity"]


@pytest.mark.parametrize("gravity_sigma", [5e-6, 0.02])
def test_gravity_that_does_not_fit_the_latitude_is_doubtful(gravity_sigma):
    """0.025 m/s² more than at any height of 45°: thousands of sigma, which a stated sigma of 0.02 m/s² covers."""
    recording = Case("navigation-rlg", 5).recording
    off = replace(recording.site, gravity_m_s2=recording.site.gravity_m_s2 + 0.025, gravity_sigma_m_s2=gravity_sigma)
    found = srt.calibrate(replace(recording, site=off))
    told = [sentence for sentence in found.warnings if sentence.startswith("Gravity is stated as")]
    doubtful = gravity_sigma < 0.01
    assert found.judgement.word == ("doubtful" if doubtful else "sound")
    assert bool(told) == doubtful
    assert all(sentence in found.judgement.reason for sentence in told)
