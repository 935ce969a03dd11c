"""A part of the study of errors that gave wrong results without a word: one or two units of each row that can show."""

import numpy as np
import pytest
from honesty import ESTIMATORS, STUDIES
from honesty_trials import SILENT_ERRORS
from injected_faults.injection import Case
from scipy.stats import chi2

import srt
from srt.constants import MICRO_G
from srt.estimation import drift_model
from srt.result.verdict import verdict_on

GRADE, SEED = "navigation-rlg", 20261130


def trial(name, unit):
    """Scores of all estimators."""
    return list(STUDIES["silent-errors"].trial((name,), unit, ESTIMATORS).values())


@pytest.mark.parametrize("units", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["vibration, 5 µrad and 3 mg at 23 Hz", "vibration, 0.3 mrad at 7 Hz"])
def test_vibration_is_named_and_its_effect_removed(name, units):
    """NEES of all units and estimators, whose errors are alike, below the band of 1e-4."""
    pytest.importorskip("gtsam")
    scores = [score for u in range(units) for score in trial(name, 40 + u)]
    assert len(scores) == units * len(ESTIMATORS)
    assert all(score.named and score.status != "inconsistent" for score in scores)
    assert all(score.nees < chi2.isf(1e-4 / units, 27) for score in scores)


@pytest.mark.slow
def test_a_wrong_clock_and_gravity_are_told():
    pytest.importorskip("gtsam")
    for name in ("clock off by 1e-4", "gravity off by 342 ppm"):
        assert all(score.named for score in trial(name, 40))
    assert all(score.nees < chi2.isf(1e-4, 27) for score in trial("clock off by 1e-4, sigma stated", 40))
    assert "none" in SILENT_ERRORS


def test_wobble_stated_as_zero_is_found_with_its_size():
    """10 µrad per pose, from 17 starts and as many ends; no sigma of the filter is far above that of least squares."""
    case = Case(GRADE, SEED + 40)
    recording = SILENT_ERRORS["wobble of 10 µrad, stated as 0"].change(case, np.random.default_rng((SEED, 40)))
    found, least = (srt.calibrate(recording, estimator, checks=False) for estimator in ("ekf", "least-squares"))
    added = found.consistency.added_noise["wobble_rad"]
    assert added.own == 0.0
    assert added.added == pytest.approx(1e-5, rel=3.5 / np.sqrt(2.0 * 34.0))
    assert "µrad of axis wobble per pose" in verdict_on(found).reason
    error = found.errors.vector - case.simulation.truth.vector
    assert error @ np.linalg.solve(found.covariance, error) < chi2.isf(1e-4, 27)
    # Least squares does not use the angle between the axes in the ends, so that wobble is no error of it.
    assert np.all(found.sigma < 1.5 * least.sigma)


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares", "graph"])
def test_a_possible_drift_enters_the_covariance_alone(estimator, monkeypatch):
    """A ramp of 14 µg over the test, not significant: three draws, one for each axis; the same estimate."""
    pytest.importorskip("gtsam")
    unit = 5
    recording = SILENT_ERRORS["accelerometer ramp, 100 µg/h"].change(
        Case(GRADE, SEED + unit), np.random.default_rng((SEED, unit))
    )
    found = srt.calibrate(recording, estimator, checks=False)
    monkeypatch.setattr(drift_model, "_POSSIBLE", 0.0)
    without = srt.calibrate(recording, estimator, checks=False)
    assert found.status == without.status == "converged"
    assert found.diagnostics.drift is None
    # 14 µg on one axis of three is 8 µg in the rms, which three axes determine to a factor of √(1/6) at best.
    share = found.diagnostics.possible_accel_drift_sigma_m_s2 / (14.0 * MICRO_G / np.sqrt(3.0))
    assert 0.25 < share < 4.0
    np.testing.assert_array_equal(found.errors.vector, without.errors.vector)
    added = (found.covariance - without.covariance) / np.outer(found.sigma, found.sigma)
    values = np.linalg.eigvalsh(added)
    assert np.all(values[:-3] == pytest.approx(0.0, abs=1e-9))
    assert values[-1] > 0.01
    assert without.diagnostics.possible_accel_drift_sigma_m_s2 is None
