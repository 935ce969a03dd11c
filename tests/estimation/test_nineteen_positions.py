"""The 19-position test without labels, from a generator that shares nothing with the estimators, against the bound."""

import numpy as np
import pytest
from honesty_trials import nineteen_positions
from nineteen_positions import CASES, unit_of
from studies import rms

import srt
from srt.sensor_errors import GROUP_SLICES

PLAIN = "no extras"
NOISE_FREE = {
    "gyro_scale": 0.05e-6, "gyro_orthogonality": 0.1e-6, "accel_scale": 0.05e-6, "accel_misalignment": 0.1e-6,
    "accel_bias": 1e-6 * 9.80665,
}  # fmt: skip
"""Largest errors without noise, SI."""


def test_noise_free():
    """To 0.05 ppm, 0.1 µrad and 1 µg."""
    recording, truth = unit_of(PLAIN, 0, noise=False)
    errors = np.abs(srt.calibrate(recording, "least-squares", hold=CASES[PLAIN][1], checks=False).errors.vector - truth)
    for group, largest in NOISE_FREE.items():
        assert errors[GROUP_SLICES[group]].max() < largest


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("units", [pytest.param(2, id="small"), pytest.param(100, id="full", marks=pytest.mark.slow)])
def test_errors_reach_the_bound(case, units):
    """The rms of a group over the units is that of the bound within 3.5 standard errors."""
    scores = [nineteen_positions((case,), unit, ["least-squares"])["least-squares"] for unit in range(units)]
    for group in NOISE_FREE:
        at = GROUP_SLICES[group]
        # Three parameters of one unit share errors, gravity among them: only the units count as independent.
        ratio = rms(np.array([score.error[at] for score in scores])) / rms(scores[0].bound[at])
        assert ratio < 1.0 + 3.5 / np.sqrt(2.0 * units)
    assert np.median([score.seconds for score in scores]) < 2.0
