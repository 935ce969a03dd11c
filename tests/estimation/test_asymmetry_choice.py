"""Result without asymmetries, as the linear algebra gives it and as another calibration does."""

from __future__ import annotations

import numpy as np
import pytest

import srt
from sims.faults.injection import Case
from srt.sensor_errors import INDEX, NAMES

NONE = {name: 0.0 for name in NAMES if "asymmetry" in name}


@pytest.mark.parametrize("group", ["gyro_asymmetry", "accel_asymmetry"])
def test_result_without_asymmetry_equals_that_of_a_second_calibration(group):
    """The unit has none: both are linear in a correction of a few sigma, and end within 0.01 sigma of the optimum."""
    recording = Case("tactical-fog", 5, {"errors": {"values": NONE}}).recording
    row = srt.calibrate(recording, "least-squares", checks=False).diagnostics["asymmetry"][group]
    assert row["probability"] > 1e-3
    assert row["estimated"] == [name for name in NAMES if name.startswith(group)]
    fixed = srt.calibrate(recording, "least-squares", checks=False, hold=(group,), start=srt.SensorErrors())
    for name, other in row["without"].items():
        assert other["sigma"] == pytest.approx(fixed.sigma[INDEX[name]], rel=0.01)
        assert other["value"] == pytest.approx(fixed.errors[name], abs=0.05 * other["sigma"])


def test_a_real_asymmetry_is_significant():
    values = NONE | {"gyro_asymmetry_y": 300e-6}
    found = srt.calibrate(Case("tactical-fog", 6, {"errors": {"values": values}}).recording, "graph", checks=False)
    row = found.diagnostics["asymmetry"]["gyro_asymmetry"]
    assert row["probability"] < 1e-9
    assert abs(row["without"]["gyro_scale_y"]["value"] - found.errors["gyro_scale_y"]) > 0.0


def test_a_fixed_group_is_not_tested():
    recording = Case("tactical-fog", 5, {"errors": {"values": NONE}}).recording
    found = srt.calibrate(recording, "least-squares", checks=False, asymmetry=False).diagnostics["asymmetry"]
    assert set(found) == {"accel_asymmetry"}
    assert np.isfinite(found["accel_asymmetry"]["chi_square"])
