"""Residuals that the noise does not explain widen the sigmas of every estimator by iteration alike, and say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import srt
from sims.faults.injection import Case


@pytest.fixture(scope="module")
def without_imu_table():
    """Industrial unit of which no noise is stated: its bias instability is in no sigma."""
    return replace(Case("industrial-mems", 31).recording, noise=srt.ImuNoise())


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_sigmas_are_multiplied_by_the_birge_ratio(without_imu_table, estimator):
    found = srt.calibrate(without_imu_table, estimator, checks=False)
    assert found.status == "converged"
    factor = found.noise["sigma_inflation"]
    warned = [w for w in found.warnings if "All sigmas were multiplied by" in w]
    if estimator == "closed-form":
        assert factor > 1.5
        assert "gyro_bias_instability_deg_per_h" in warned[0]
    if warned:
        chi_square, freedom = found.noise["chi_square"], found.noise["degrees_of_freedom"]
        assert factor == pytest.approx(np.sqrt(chi_square / freedom))
        # The sources add up to the sigma that is reported.
        total = np.sqrt(sum(part**2 for part in found.contributions.values()))
        np.testing.assert_allclose(total, found.sigma, rtol=1e-6)
    else:
        assert factor == 1.0


def test_a_unit_with_stated_noise_keeps_its_sigmas():
    found = srt.calibrate(Case("industrial-mems", 31).recording, "closed-form", checks=False)
    assert found.noise["sigma_inflation"] == 1.0
    assert not any("multiplied" in warning for warning in found.warnings)
