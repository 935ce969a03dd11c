"""Forms of the Kalman filter: the same optimum where linearisation and rounding allow it, a named failure elsewhere."""

import numpy as np
import pytest

import sims
import srt
from srt.estimation.observability import admission_sigma
from srt.estimation.options import Options
from srt.exceptions import InputError
from srt.joint.recording_opening import open_joint_model
from srt.model.prior import Prior
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

pytest.importorskip("filterpy")

from filterpy.kalman import KalmanFilter, UnscentedKalmanFilter

from estimators.covariance_filter import CovarianceFilter
from estimators.sequential_filter import initial_prior

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


@pytest.fixture(scope="module")
def far():
    """Unit with scale-factor errors of 30 % and angles of 0.3 rad."""
    errors = {"gyro_scale_ppm": 3e5, "accel_scale_ppm": 3e5, "gyro_orthogonality_urad": 3e5}
    size = {"errors": {"draw": "uniform", "factor": 3**-0.5}}
    imu = {"from": "tactical-fog", "errors": {**errors, "accel_misalignment_urad": 3e5}}
    return sims.simulate(sims.scenario_from_dict({**SCENARIO, **size, "imu": imu}))


@pytest.mark.parametrize("form", ["one-pass", "per-sequence"])
def test_sequential_filters_start_from_the_angles_of_the_fixture(far, form):
    """They reach the optimum of errors that are far outside the range in which a start from zero does."""
    found = srt.calibrate(far.recording, "ekf", checks=False, filter=form)
    assert found.status == "converged", found.message
    optimum = srt.calibrate(far.recording, "least-squares", checks=False, ignore_moves=True)
    assert in_sigmas(found, optimum) < 1.0
    np.testing.assert_allclose(found.sigma, optimum.sigma, rtol=0.05)


@pytest.mark.parametrize("errors", ["recording", "far"])
def test_linearisation_errors_of_one_pass_from_zero_are_reported(request, errors):
    """One pass with a prior of a third of full scale misses the optimum; the result says so."""
    recording = request.getfixturevalue(errors)
    found = srt.calibrate(
        getattr(recording, "recording", recording), "ekf", checks=False, filter="one-pass", start=SensorErrors()
    )
    assert found.status == "not_converged"
    assert "'one-pass'" in found.message


def test_a_stated_prior_is_updated_with_the_start_from_the_fixture(far):
    """The mean is that of whichever is more accurate, and the fixture is accurate to 3 * sqrt(2) mrad."""
    joint = open_joint_model(far.recording, Options(ignore_moves=True))
    scale = GROUP_SLICES["accel_scale"]
    near = SensorErrors(np.where(np.arange(N_PARAMETERS) == scale.start, 0.1, 0.0))
    narrow, wide = (initial_prior(joint, Prior.from_sigma(factor * admission_sigma(), near)) for factor in (1e-6, 1.0))
    np.testing.assert_allclose(narrow.mean.vector[scale], near.vector[scale], atol=1e-6)
    np.testing.assert_allclose(wide.mean.vector[scale], far.truth.vector[scale], atol=4.0 * 2**0.5 * 1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(wide.covariance)[scale]), 3.0 * 2**0.5 * 1e-3, rtol=1e-3)
    # The fixture's angles tell nothing of asymmetries.
    asymmetry = GROUP_SLICES["gyro_asymmetry"]
    np.testing.assert_array_equal(np.diag(wide.covariance)[asymmetry], admission_sigma()[asymmetry] ** 2)


def test_sequential_filters_have_no_stages(recording):
    with pytest.raises(InputError, match="start='zero'"):
        srt.calibrate(recording, "ekf", checks=False, filter="one-pass", start="zero")


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


@pytest.mark.slow
def test_unscented_filter_uses_all_measurements(recording):
    """With drift that is handed on, the sigmas are those of the optimum, to the 2 % of linearisation."""
    few = recording.with_sequences(tuple(label for label in recording.sequences if label.id in "1247"))
    assert few.noise.gyro_bias_instability > 0.0
    prior = Prior.from_sigma(1e-3 * admission_sigma())
    found = srt.calibrate(few, "ekf", checks=False, prior=prior, filter="unscented")
    low, high = found.diagnostics.optimum.sigma_ratio
    assert 0.98 < low <= high < 1.02
