"""The 19-position test without labels, from a generator that shares nothing with the estimators, against the bound."""

import numpy as np
import pytest
from nineteen_positions import CASES, SHOWN, bound, study
from studies import rms

from srt.sensor_errors import GROUP_SLICES

PLAIN = "no extras"


def test_noise_free():
    """To 0.05 ppm, 0.1 µrad and 1 µg."""
    errors = np.abs(study(PLAIN, ["least-squares"], 1, noise=False)["least-squares"][0])
    for group, largest in (
        ("gyro_scale", 0.05e-6), ("gyro_orthogonality", 0.1e-6), ("accel_scale", 0.05e-6),
        ("accel_misalignment", 0.1e-6), ("accel_bias", 1e-6 * 9.80665),
    ):  # fmt: skip
        assert errors[:, GROUP_SLICES[group]].max() < largest


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("units", [pytest.param(2, id="small"), pytest.param(100, id="full", marks=pytest.mark.slow)])
def test_errors_reach_the_bound(case, units):
    """The rms of a group over the units is that of the bound within 3.5 standard errors."""
    errors, seconds = study(case, ["least-squares"], units)["least-squares"]
    limit = bound(CASES[case][1])
    for group in SHOWN:
        at = GROUP_SLICES[group]
        # Three parameters of one unit share errors, gravity among them: only the units count as independent.
        assert rms(errors[:, at]) / rms(limit[at]) < 1.0 + 3.5 / np.sqrt(2.0 * units)
    assert np.median(seconds) < 2.0
