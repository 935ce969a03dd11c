"""Units whose biases move, and readings that no noise model covers, by a generator that shares nothing with the
estimators."""

import math

import pytest
from honesty import largest
from honesty_trials import worse_than_stated
from scipy.special import ndtri
from studies import pooled_nees
from worse_recordings import CASES, unit_of

import srt

UNITS = 2
ACCUSATIONS = ("contradicts", "move left out")


@pytest.mark.parametrize(
    ("case", "estimator", "drift"),
    [
        ("fixture, no drift", "least-squares", ""),
        ("hand, no drift", "least-squares", ""),
        ("fixture, accelerometer warm-up of 4 mg", "least-squares", "accel"),
        ("navigation on a fixture, warm-up of 1 mg", "graph", "accel"),
        ("fixture, accelerometer step of 0.4 mg", "least-squares", "accel step"),
        ("fixture, gyro step of 30 °/h", "least-squares", "gyro step"),
        ("hand, accelerometers linear, 4 mg", "ekf", "accel"),
        ("hand, accelerometer step of 0.4 mg", "least-squares", "accel step"),
        ("vibration of 0.3 mrad at 7 Hz, nothing stated", "least-squares", ""),
        ("vibration of 0.3 mrad at 7 Hz, nothing stated", "closed-form", ""),
    ],
)
def test_sigmas_are_true_and_nothing_innocent_is_accused(case, estimator, drift):
    """Mean NEES: at most 3.5 standard errors of a chi-square; largest error: family-wise 1 %."""
    found = [worse_than_stated((case,), seed, [estimator])[estimator] for seed in range(UNITS)]
    seen = sum(score.freedom for score in found)
    assert pooled_nees(found) < 1.0 + 3.5 * math.sqrt(2.0 / seen)
    assert max(largest(score.z) for score in found) < -float(ndtri(0.005 / seen))
    for score in found:
        assert score.word == "sound"
        assert not any(what.startswith(ACCUSATIONS) for what in score.faults)
        assert not drift or any(what.startswith(drift) for what in score.faults)


@pytest.mark.parametrize(
    ("case", "seed", "named"),
    [
        ("fixture, accelerometer warm-up of 4 mg", 0, "accelerometer biases changed"),
        ("fixture, accelerometer warm-up of 4 mg", 1, "accelerometer biases changed"),
        ("navigation on a fixture, linear, 4 mg and 300 °/h", 0, "gyro biases changed linearly"),
        ("navigation on a fixture, linear, 4 mg and 300 °/h", 1, "gyro biases changed linearly"),
        ("fixture, accelerometer step of 0.4 mg", 0, "recorded moves contradict"),
        ("fixture, accelerometer step of 0.4 mg", 0, "a bias drift of the accelerometers (step at 123.5 s)"),
        ("fixture, accelerometer step of 0.4 mg", 1, "accelerometer biases changed by a step at 123.5 s"),
        ("fixture, gyro step of 30 °/h", 0, "gyro biases changed by a step at 123.5 s"),
        ("fixture, gyro step of 30 °/h", 1, "gyro biases changed by a step at 123.5 s"),
    ],
)
def test_the_closed_form_names_a_drift_and_no_sequence(case, seed, named):
    unit, _ = unit_of(CASES[case], seed)
    found = srt.calibrate(unit, "closed-form")
    assert found.judgement.word in ("doubtful", "failed")
    assert any(named in text for text in (found.message, *found.warnings))
    assert not any("moved in the stationary windows" in warning for warning in found.warnings)
    assert found.verdict.contradicting is None


def test_a_step_that_is_modelled_is_no_second_unit():
    """``srt inspect`` finds the step, without a calibration that explains it."""
    unit, _ = unit_of(CASES["fixture, accelerometer step of 0.4 mg"], 1)
    found = srt.calibrate(unit, "least-squares")
    assert "units_joined" in {fault.fault for fault in found.diagnostics.faults}
    assert not any("joins two units" in warning for warning in found.warnings)
    assert any("by a step at" in warning for warning in found.warnings)


def test_channels_whose_steps_are_not_dithered_are_named_and_no_g_sensitivity_is_found_in_them():
    unit, _ = unit_of(CASES["steps of three noise sigma"], 0)
    found = srt.calibrate(unit, "least-squares")
    assert any("gyro_x, gyro_y, gyro_z, accel_x" in message and "steps" in message for message in found.warnings)
    assert found.diagnostics.g_sensitivity is None


@pytest.mark.parametrize("case", ["steps of three noise sigma", "steps of three noise sigma, nothing stated"])
@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_sigmas_of_readings_in_steps_are_true(case, estimator):
    """Mean NEES between 0.70 and 1.15, and 3.5 standard errors of a chi-square."""
    found = [worse_than_stated((case,), seed, [estimator])[estimator] for seed in range(UNITS)]
    error = 3.5 * math.sqrt(2.0 / sum(score.freedom for score in found))
    assert 0.70 * (1.0 - error) < pooled_nees(found) < 1.15 * (1.0 + error)
    assert {score.word for score in found} == {"sound"}


@pytest.mark.parametrize(
    "case", ["truncated toward zero, half a noise sigma", "truncated toward zero, three noise sigma"]
)
def test_readings_truncated_toward_zero_are_named_and_the_result_is_not_sound(case):
    """Half a step by the sign of a reading moves parameters by many sigma, and residuals need not show it."""
    for seed in range(UNITS):
        unit, _ = unit_of(CASES[case], seed)
        found = srt.calibrate(unit, "closed-form")
        assert found.diagnostics.faults[0].fault in ("gyro_truncated", "accel_truncated")
        assert found.judgement.word in ("doubtful", "failed")


@pytest.mark.parametrize(
    "case",
    ["steps of half a noise sigma", "steps of three noise sigma", "truncated downwards, half a noise sigma"],
)
def test_readings_rounded_to_steps_are_not_truncated(case):
    unit, _ = unit_of(CASES[case], 0)
    assert srt.calibrate(unit, "closed-form").diagnostics.faults == ()
