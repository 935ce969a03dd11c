"""Expected covariance of the difference of two estimates: its form, and its size on simulated recordings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2

import srt
from sims.scenarios.scenario import scenario_from_dict
from sims.scenarios.simulation import simulate
from srt.comparison.estimate_difference import FALSE_ALARM, expected_covariance
from srt.comparison.estimator_comparison import compare
from srt.sensor_errors import N_PARAMETERS

BOTH = ("closed-form", "least-squares")
RECORDINGS = 16


def recording(grade, seed):
    schedule = {"dwell_s": 2.0, "rate_rad_s": 3.0, "acceleration_rad_s2": 30.0, "settle_s": 0.1, "leg_dwell_s": 0.2}
    scenario = {"seed": seed, "imu": {"from": grade}, "schedule": schedule, "recording": {"sample_rate_hz": 50.0}}
    places = {"fixture": {"from": "lab-1mrad"}, "site": {"from": "latitude-45"}}
    return simulate(scenario_from_dict(scenario | places)).recording


@pytest.fixture(scope="module")
def stated():
    """Comparisons of tactical units with stated noise."""
    return [srt.compare(recording("tactical-fog", 1000 + number), BOTH) for number in range(RECORDINGS)]


def test_single_and_joint_tests_have_one_covariance_which_exceeds_the_difference_of_either_order():
    rng = np.random.default_rng(8)

    def estimate(name):
        root = rng.standard_normal((N_PARAMETERS, 100)) * 1e-4
        errors = srt.SensorErrors(rng.standard_normal(N_PARAMETERS) * 1e-3)
        return srt.Calibration(name, "converged", "Converged.", errors, root @ root.T)

    # Neither estimate is better in all directions: the difference of their covariances is indefinite.
    pair = {name: estimate(name) for name in BOTH}
    first, second = pair.values()
    D = first.covariance - second.covariance
    assert np.linalg.eigvalsh(D)[[0, -1]].prod() < 0.0
    C = expected_covariance(first, second, np.ones(N_PARAMETERS, dtype=bool))
    rounding = 1e-12 * np.trace(C)
    for lower in (0.0 * D, D - rounding * np.eye(N_PARAMETERS), -D - rounding * np.eye(N_PARAMETERS)):
        assert np.linalg.eigvalsh(C - lower)[0] > 0.0
    one = compare(pair).differences["closed-form"]
    np.testing.assert_allclose(one.expected_sigma, np.sqrt(np.diag(C)))
    assert one.chi_square == pytest.approx(one.difference @ np.linalg.solve(C, one.difference))


def test_differences_of_simulated_recordings_are_as_large_as_expected(stated):
    pairs = [comparison.differences["closed-form"] for comparison in stated]
    freedom = RECORDINGS * N_PARAMETERS
    assert chi2.ppf(1e-3, freedom) < sum(pair.chi_square for pair in pairs) < chi2.isf(1e-3, freedom)
    assert sum(not pair.agrees for pair in pairs) <= binom.isf(1e-3, RECORDINGS, FALSE_ALARM)


def test_a_difference_of_half_a_sigma_between_efficient_estimates_is_found(stated):
    best = stated[0].calibrations["least-squares"]
    for i, sigma in enumerate(best.sigma):
        shifted = replace(best, errors=best.errors.plus(0.5 * sigma * np.eye(N_PARAMETERS)[i]))
        assert not compare({"least-squares": best, "graph": shifted}).agree


def test_sigmas_enlarged_by_residuals_raise_no_false_alarm():
    """The closed form multiplies its sigmas, least squares adds noise; neither covariance is that of the true noise."""
    made = recording("navigation-rlg", 1008)
    understated = {
        f"{sensor}_{kind}": 0.6 * getattr(made.noise, f"{sensor}_{kind}")
        for sensor in ("gyro", "accel")
        for kind in ("noise", "bias_instability")
    }
    compared = srt.compare(replace(made, noise=replace(made.noise, **understated)), BOTH)
    assert {c.judgement.word for c in compared.calibrations.values()} == {"doubtful"}
    assert compared.agree, compared.verdict
