"""Forms of the Kalman filter: the same optimum where linearisation and rounding allow it, a named failure elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

import sims
import srt
from srt.estimation.observability import admission_sigma
from srt.exceptions import InputError
from srt.model.prior import Prior

pytest.importorskip("filterpy")

from filterpy.kalman import KalmanFilter, UnscentedKalmanFilter

from estimators.covariance_filter import CovarianceFilter

SCENARIO = {
    "seed": 5,
    "imu": {"from": "tactical-fog"},
    "fixture": {"from": "lab-1mrad"},
    "site": {"from": "latitude-45"},
    "schedule": {"dwell_s": 4.0, "rate_rad_s": 3.0, "acceleration_rad_s2": 30.0},
    "recording": {"sample_rate_hz": 50.0},
}
NARROW = Prior.from_sigma(0.01 * admission_sigma())
"""A hundredth of the default prior: 0.3 % scale, several times the errors of the unit."""


@pytest.fixture(scope="module")
def recording():
    return sims.simulate(sims.scenario_from_dict(SCENARIO)).recording


@pytest.fixture(scope="module")
def iterated(recording):
    return srt.calibrate(recording, "ekf", checks=False, prior=NARROW)


def in_sigmas(calibration, reference):
    return float(np.abs((calibration.errors.vector - reference.errors.vector) / reference.sigma).max())


@pytest.mark.parametrize("form", ["one-pass", "per-sequence"])
def test_sequential_filters_reach_the_optimum_from_a_narrow_prior(recording, iterated, form):
    """The estimate is within the reported distance of the iterated one, and sigmas agree to 1 %."""
    found = srt.calibrate(recording, "ekf", checks=False, prior=NARROW, filter=form)
    assert found.status == iterated.status
    optimum = found.diagnostics.optimum
    assert optimum.distance_sigma < 1.0
    assert in_sigmas(found, iterated) == pytest.approx(optimum.distance_sigma, abs=0.01)
    np.testing.assert_allclose(found.sigma, iterated.sigma, rtol=0.01)
    rows = found.diagnostics.filter
    assert [row.sequence for row in rows] == [row.sequence for row in iterated.diagnostics.filter]
    assert all(np.isfinite(row.nis) for row in rows)


def test_linearisation_errors_from_the_wide_prior_are_reported(recording):
    """One pass from a third of full scale misses the optimum; the result says so and claims no convergence."""
    found = srt.calibrate(recording, "ekf", checks=False, filter="one-pass")
    assert found.status == "not_converged"
    assert "'one-pass'" in found.message


def test_covariance_form_agrees_while_it_has_digits(recording, iterated):
    found = srt.calibrate(recording, "ekf", checks=False, prior=NARROW, filter="covariance")
    assert found.status == iterated.status
    assert in_sigmas(found, iterated) < 1e-3
    np.testing.assert_allclose(found.sigma, iterated.sigma, rtol=1e-3)


def test_loss_of_positive_definiteness_is_named():
    """A negative variance, as rounding leaves it, is an error and not a sigma of zero."""
    ekf = CovarianceFilter(np.zeros(2), np.eye(2))
    ekf.P[0, 0] = -1e-9
    with pytest.raises(np.linalg.LinAlgError, match="positive definiteness"):
        ekf.project(np.eye(2))
    ekf.P = -np.eye(2) * 2.0
    with pytest.raises(np.linalg.LinAlgError, match="positive definiteness"):
        ekf.correct(np.zeros(1), np.array([[1.0, 0.0]]))


def test_covariance_adapter_propagates_and_corrects():
    rng = np.random.default_rng(2)
    root, F, noise = np.tril(rng.uniform(1.0, 2.0, (2, 2))), rng.standard_normal((2, 2)), rng.standard_normal((2, 1))
    ekf = CovarianceFilter(np.array([1.0, 2.0]), root)
    ekf.propagate(F, np.array([0.5, -0.5]), noise_root=noise)
    expected = F @ root @ root.T @ F.T + noise @ noise.T
    np.testing.assert_allclose(ekf.P, expected, rtol=1e-13)
    np.testing.assert_allclose(ekf.x, F @ [1.0, 2.0] + [0.5, -0.5], rtol=1e-13)
    ekf.correct(np.array([3.0]), np.array([[1.0, 0.0]]))
    assert ekf.S[0, 0] == pytest.approx(expected[0, 0] + 1.0, rel=1e-13)


@pytest.mark.parametrize(
    ("form", "base"), [("covariance", KalmanFilter), ("unscented", UnscentedKalmanFilter)], ids=["plain", "unscented"]
)
def test_filterpy_does_the_filtering(recording, monkeypatch, form, base):
    """filterpy's own update runs for each of four sequences until the filter ends or fails."""
    calls = []
    own = base.update
    monkeypatch.setattr(base, "update", lambda self, *a, **k: (calls.append(1), own(self, *a, **k))[1])
    few = recording.with_sequences(recording.sequences[:4])
    found = srt.calibrate(few, "ekf", checks=False, filter=form, max_playbacks=1)
    assert calls
    if found.status != "converged":
        assert found.message


@pytest.mark.parametrize("form", ["one-pass", "covariance", "unscented"])
def test_forms_refuse_to_run_live(recording, form):
    with pytest.raises(InputError, match="live"):
        srt.calibrate(recording, "ekf", checks=False, filter=form, live=True)


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares", "graph"])
def test_other_estimators_have_no_filter(recording, estimator):
    if estimator == "graph":
        pytest.importorskip("gtsam")
    with pytest.raises(InputError, match="filter='one-pass'"):
        srt.calibrate(recording, estimator, checks=False, filter="one-pass")


def test_sequential_filters_need_windows_of_their_own(recording):
    with pytest.raises(InputError, match="one gyro bias"):
        srt.calibrate(recording, "ekf", checks=False, filter="one-pass", gyro_bias="per-sequence")


def test_unscented_filter_knows_no_more_than_all_measurements(recording):
    """With drift that is handed on, no sigma is less than that of the optimum, to the 1 % of linearisation."""
    few = recording.with_sequences(recording.sequences[:4])
    assert few.noise.gyro_bias_instability > 0.0
    prior = Prior.from_sigma(1e-3 * admission_sigma())
    found = srt.calibrate(few, "ekf", checks=False, prior=prior, filter="unscented")
    assert found.diagnostics.optimum.sigma_ratio[0] > 0.99
