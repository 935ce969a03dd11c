"""Result without asymmetries, as the linear algebra gives it and as another calibration does."""

import numpy as np
import pytest
from foreign_motion import GRADES, drawn_errors, hand_turns, recording
from injected_faults.injection import Case

import srt
from srt.sensor_errors import INDEX, NAMES

NONE = {name: 0.0 for name in NAMES if "asymmetry" in name}


@pytest.mark.parametrize("group", ["gyro_asymmetry", "accel_asymmetry"])
def test_result_without_asymmetry_equals_that_of_a_second_calibration(group):
    """The unit has none: both are linear in a correction of a few sigma, and end within 0.01 sigma of the optimum."""
    recording = Case("tactical-fog", 5, {"errors": {"values": NONE}}).recording
    row = srt.calibrate(recording, "least-squares", checks=False).diagnostics.asymmetry[group]
    assert row.probability > 1e-3
    assert row.estimated == tuple(name for name in NAMES if name.startswith(group))
    fixed = srt.calibrate(recording, "least-squares", checks=False, hold=(group,), start=srt.SensorErrors())
    for name, other in row.without.items():
        assert other.sigma == pytest.approx(fixed.sigma[INDEX[name]], rel=0.01)
        assert other.value == pytest.approx(fixed.errors[name], abs=0.05 * other.sigma)


def test_a_real_asymmetry_is_significant():
    values = NONE | {"gyro_asymmetry_y": 300e-6}
    found = srt.calibrate(Case("tactical-fog", 6, {"errors": {"values": values}}).recording, "graph", checks=False)
    row = found.diagnostics.asymmetry["gyro_asymmetry"]
    assert row.probability < 1e-9
    assert abs(row.without["gyro_scale_y"].value - found.errors["gyro_scale_y"]) > 0.0


def test_a_fixed_group_is_not_tested():
    recording = Case("tactical-fog", 5, {"errors": {"values": NONE}}).recording
    found = srt.calibrate(recording, "least-squares", checks=False, asymmetry=False).diagnostics.asymmetry
    assert set(found) == {"accel_asymmetry"}
    assert np.isfinite(found["accel_asymmetry"].chi_square)


def test_a_result_that_did_not_converge_is_not_tested():
    """Its covariance may be singular."""
    found = srt.calibrate(Case("tactical-fog", 5).recording, "closed-form", max_playbacks=1, checks=False)
    assert found.status == "not_converged"
    assert found.diagnostics.asymmetry == {}


def test_an_asymmetry_that_few_turns_do_not_show_is_in_the_sigmas():
    """Consumer unit with asymmetries of 1 %, nine turns by hand: that of gyro z resembles its scale factor."""
    rng = np.random.default_rng((20261122, 11, 17))
    errors = drawn_errors(GRADES["consumer"], rng)
    errors |= {name: 10.0 * value for name, value in errors.items() if "asymmetry" in name}
    unit = recording(hand_turns(rng, shortest_s=1.0, count=9), 5.0, errors, GRADES["consumer"], rng)
    found = srt.calibrate(unit, "least-squares", checks=False)
    assert np.array(NAMES)[~found.observed].tolist() == ["gyro_asymmetry_z"]
    scale = INDEX["gyro_scale_z"]
    assert found.sigma[scale] > 3e-3
    # 26 normalised errors: the largest exceeds 4.2 with a probability of 7e-4.
    seen = np.flatnonzero(found.observed)
    error = found.errors.vector - np.array([errors.get(name, 0.0) for name in NAMES])
    assert np.abs(error[seen] / found.sigma[seen]).max() < 4.2
