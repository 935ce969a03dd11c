"""Claims of the closed form on simulated units: exactness, fixture errors, large errors, honest sigmas.

Each claim is tested in a small form here and, with ``-m campaign``, in full over the number of draws that it is stated
for. Bounds are the claims themselves, or statistical: value plus 3.5 standard errors of the sample size used.
"""

from functools import partial

import accuracy_trials
import numpy as np
import pytest
from foreign_motion import GRADES, drawn_errors, hand_turns, recording
from injected_faults.injection import Case
from scipy.stats import chi2

import srt
from sims.physics.imu import read_out
from sims.physics.table_motion import table1_motion
from srt.sensor_errors import GROUP_SLICES, INDEX, NAMES

ERRORS = slice(0, 24)  # gyro bias is a nuisance


def worst(trials, part=ERRORS):
    return max(float(np.abs(t.error[part]).max()) for t in trials)


def sized(small, full):
    """The same test with a small and with its full number of draws."""
    return pytest.mark.parametrize("count", [small, pytest.param(full, marks=pytest.mark.campaign)])


@sized(1, 20)
@pytest.mark.parametrize(
    "case",
    [
        {},
        {"sample_rate_hz": 50.0},
        {"sample_rate_hz": 100.0},
        {"sample_rate_hz": 1000.0},
        {"kind": "increment"},
        {"turned_rad": 0.2},
        {"average": "overlapping"},
        {"window_attitude": "integrated"},
        {"step": "coefficients", "max_playbacks": 20},
        {"gyro_bias": "per-sequence"},
    ],
    ids=str,
)
def test_noise_free_on_a_perfect_fixture_is_exact(case, count):
    """24 errors of 1e-3, gyro bias up to 1 °/s: every parameter within 1e-8, whatever the rate, kind and options."""
    trials = accuracy_trials.run(partial(accuracy_trials.exact_trial, **case), range(count))
    assert {t.status for t in trials} == {"converged"}
    assert worst(trials) < 1e-8


@sized(2, 200)
def test_one_milliradian_fixture(count):
    """Levelling, north, mounting and every rotation off by 1 mrad: the bar is 2e-6 in every draw."""
    trials = accuracy_trials.run(accuracy_trials.fixture_trial, range(count))
    assert {t.status for t in trials} == {"converged"}
    assert worst(trials) < 2e-6


def test_remainder_is_earth_rate_times_alignment():
    """The remainder scales with the alignment error, and vanishes with the Earth's rate."""
    seeds = range(2)
    one, three = (accuracy_trials.run(partial(accuracy_trials.fixture_trial, sigma_rad=s), seeds) for s in (1e-3, 3e-3))
    still = accuracy_trials.run(partial(accuracy_trials.fixture_trial, earth_rate=False), seeds)
    ratio = np.linalg.norm([t.error[ERRORS] for t in three]) / np.linalg.norm([t.error[ERRORS] for t in one])
    # Linear with a factor 3; the quadratic part of 3 mrad is a thousandth of it.
    assert 2.9 < ratio < 3.1
    assert worst(still) < 1e-8


def test_ten_milliradian_fixture_leaves_accelerometer_scale_alone():
    trials = accuracy_trials.run(partial(accuracy_trials.fixture_trial, sigma_rad=1e-2), range(2))
    assert worst(trials, GROUP_SLICES["accel_scale"]) < 1e-6


@sized(2, 200)
def test_half_turns_off_by_thirty_degrees(count):
    """150° to 210° in place of 180°: the recorded rotation counts, not the nominal one."""
    trials = accuracy_trials.run(partial(accuracy_trials.fixture_trial, stretch_rad=np.radians(30.0)), range(count))
    assert {t.status for t in trials} == {"converged"}
    assert worst(trials) < 2e-6


@sized(3, 1000)
def test_large_errors_converge_to_the_right_fixed_point(count):
    """±50 % scale, ±0.3 rad, ±1 % asymmetry, ±1 °/s, ±1 m/s², fixture 5 mrad: all within 6 iterations."""
    trials = accuracy_trials.run(accuracy_trials.large_trial, range(count))
    assert {t.status for t in trials} == {"converged"}
    assert max(t.playbacks for t in trials) <= 6
    # Converged to the point that is also reached from the truth, within max(1e-8, 0.01 sigma).
    assert max(t.distance for t in trials) <= 1.0


def variance_band(n):
    """Bounds of 27 sample variances of n unit normals: chi-square, family-wise 1 %."""
    tail = 0.01 / (2 * len(NAMES))
    return chi2.ppf(tail, n) / n, chi2.isf(tail, n) / n


@sized(5, 300)
@pytest.mark.parametrize("grade", list(accuracy_trials.GRADES))
def test_sigmas_are_true(grade, count):
    """Random walks, quantization, constant bias, 1 mrad fixture: error over sigma has unit variance, each parameter."""
    trial = partial(accuracy_trials.noisy_trial, grade=grade, sample_rate_hz=50.0)
    trials = accuracy_trials.run(trial, range(1000, 1000 + count))
    ratio = np.mean(accuracy_trials.normalised(trials) ** 2, axis=0)
    low, high = variance_band(count)
    outside = {NAMES[i]: round(float(ratio[i]), 3) for i in np.flatnonzero((ratio < low) | (ratio > high))}
    assert not outside, f"variance of error over sigma outside {low:.2f}-{high:.2f}: {outside}"
    nees = np.array([t.nees for t in trials])
    # Mean of NEES / 27 has variance 2 / 27 per trial.
    assert abs(nees.mean() - 1.0) < 3.5 * np.sqrt(2.0 / 27.0 / count)


@sized(6, 300)
def test_sigmas_are_true_when_the_noise_is_estimated(count):
    """Noise not stated: a navigation unit whose pulses hide its random walk ten times over."""
    trials = accuracy_trials.run(
        partial(accuracy_trials.noisy_trial, grade="navigation", state_noise=False), range(2000, 2000 + count)
    )
    ratio = np.mean(accuracy_trials.normalised(trials) ** 2, axis=0)
    # The random walk itself is known to about 10 % of its variance from the pulses of 340 s of rest.
    low, high = variance_band(count)
    assert np.all(ratio < high * 1.2)
    assert np.all(ratio > low / 1.2)


def test_large_asymmetry_does_not_rectify_pulses():
    """5 % errors, asymmetry included, and pulses a hundred times the random walk of a sample: sigmas stay true.

    Pulses in |ω| of a resting channel would add asymmetry · √(2/π) · noise: 2e-5 rad over a turn, 10 sigma.
    """
    nees, count = [], 3
    for seed in range(count):
        rng = np.random.default_rng(seed)
        truth = accuracy_trials.normal_errors(rng, 0.05, 1e-3)
        motion = table1_motion(site=accuracy_trials.SITE, sample_rate_hz=100.0)
        recording = read_out(motion, truth, accuracy_trials.GRADES["navigation"], rng)
        nees.append(accuracy_trials.score(srt.calibrate(recording, checks=False), truth).nees)
    assert abs(np.mean(nees) - 1.0) < 3.5 * np.sqrt(2.0 / 27.0 / count)


@sized(4, 300)
def test_free_recordings_are_consistent(count):
    """Hand-turned MEMS, no fixture, no labels, noise estimated: NEES of all 27 parameters."""
    trials = accuracy_trials.run(accuracy_trials.free_trial, range(3000, 3000 + count))
    assert {t.status for t in trials} <= {"converged", "partial"}
    nees = np.array([t.nees for t in trials])
    assert abs(nees.mean() - 1.0) < 3.5 * np.sqrt(2.0 / 27.0 / count)


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
