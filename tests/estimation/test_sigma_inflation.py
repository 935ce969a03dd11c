"""Residuals that the sensors' own noise does not explain enlarge the sigmas of all estimators alike, and say so."""

from dataclasses import replace

import numpy as np
import pytest
from injected_faults.execution import labels_exchanged
from injected_faults.injection import Case

import srt

ALL = ("closed-form", "least-squares", "ekf", "graph")


@pytest.fixture(scope="module")
def wrong_noise():
    """Industrial unit whose accelerometers are stated to have no bias instability, but have 50 µg."""
    recording = Case("industrial-mems", 31).recording
    return replace(recording, noise=replace(recording.noise, accel_bias_instability=0.0))


@pytest.mark.parametrize("estimator", ALL[1:])
def test_noise_is_added_and_told(wrong_noise, estimator):
    found = srt.calibrate(wrong_noise, estimator, checks=False)
    assert found.status == "converged"
    assert found.judgement.word == "doubtful"
    own, added = found.consistency.own_noise, found.consistency.added_noise
    assert own.probability < 1e-3 <= found.consistency.probability
    # The bias instability of this unit, 50 µg, between windows.
    assert added["force_m_s2"].added == pytest.approx(50e-6 * 9.81, rel=1.0)
    low, high = found.consistency.sigma_factor
    assert 1.0 <= low < high
    # The sources add up to the sigma that is reported.
    total = np.sqrt(sum(part**2 for part in found.contributions.values()))
    np.testing.assert_allclose(total, found.sigma, rtol=1e-6)


def test_the_closed_form_enlarges_all_sigmas(wrong_noise):
    """Its Birge ratio is that of all residuals, or of the specific forces alone where these show more."""
    found = srt.calibrate(wrong_noise, "closed-form", checks=False)
    assert found.judgement.word == "doubtful"
    assert found.consistency.added_noise is None
    ratio = np.sqrt(found.consistency.chi_square / found.consistency.degrees_of_freedom)
    assert found.noise.sigma_inflation >= ratio > 1.0
    assert found.consistency.sigma_factor == pytest.approx((found.noise.sigma_inflation,) * 2)


def test_a_unit_with_stated_noise_keeps_its_sigmas():
    found = srt.calibrate(Case("industrial-mems", 31).recording, "closed-form", checks=False)
    assert found.judgement.word == "sound"
    assert found.consistency.added_noise is None
    assert found.noise.sigma_inflation == 1.0


@pytest.mark.slow
def test_exchanged_labels_are_no_noise():
    """Of two wrong labels, neither explains all residuals, and no third is accused; the diagnosis names both."""
    case = Case("navigation-rlg", 20261135)
    exchanged = labels_exchanged(case, 2.0, np.random.default_rng((20261122, 13)))
    for estimator in ("closed-form", "least-squares"):
        found = srt.calibrate(exchanged, estimator, checks=False)
        assert found.judgement.word in ("doubtful", "failed")
        assert found.consistency.contradicting is None
        with pytest.raises(srt.DataError, match="labelled 3, 4 are 4, 3"):
            srt.calibrate(exchanged, estimator)
