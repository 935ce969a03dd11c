"""Kalman filter and factor graph where the closed form is at its limits: large errors, fine noise, no fixture.

Bounds are claims, or statistical: value plus 3.5 standard errors of the sample size used.
"""

from dataclasses import replace
from functools import cache, partial

import accuracy_trials
import numpy as np
import pytest
import recorded_sets
from small_units import on_fixture
from test_recorded_sets import FOLDER, assert_agrees_with_imu_tk, needs_data

import sims
import srt
from sims.physics.fixture import rotation
from sims.physics.free_motion import free_motion, random_attitude, random_turns
from sims.physics.imu import ImuModel, read_out
from sims.physics.table_motion import table1_motion
from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.estimation.observability import admission_sigma
from srt.estimation.registry import find_estimator
from srt.model.prior import Prior
from srt.recording.recording import Fixture, ImuNoise
from srt.sensor_errors import GROUP_SLICES, NAMES, SensorErrors

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")

JOINT = ("ekf", "graph")
ERRORS = slice(0, 24)  # gyro bias is a nuisance
SITE = accuracy_trials.SITE


def sized(small, full):
    """The same test with a small and with its full number of draws."""
    return pytest.mark.parametrize("count", [small, pytest.param(full, marks=pytest.mark.campaign)])


def distance(found, reference):
    """Largest difference over max(1e-8, 0.01 sigma), of the parameters that are estimated."""
    seen = found.observed & reference.observed
    difference = np.abs(found.errors.vector - reference.errors.vector) / accuracy_trials.IN_G
    return float(np.max((difference / np.maximum(1e-8, 0.01 * found.sigma / accuracy_trials.IN_G))[seen]))


# Large errors before the test


@cache
def large(seed):
    """Unit of accuracy_trials.large_trial: ±50 %, ±0.3 rad, ±1 % asymmetry, ±1 m/s², ±1 °/s; 5 mrad; noise-free."""
    rng = np.random.default_rng(seed)
    truth, _ = accuracy_trials.large_errors(rng)
    motion = on_fixture(rng, 5e-3, sample_rate_hz=100.0)
    return read_out(motion, truth), truth


@cache
def optimum_of_truth(seed, estimator):
    """Calibration of a unit of :func:`large` from its true errors."""
    recording, truth = large(seed)
    return srt.calibrate(recording, estimator, start=truth, checks=False)


@sized(1, 200)
@pytest.mark.parametrize("estimator", JOINT)
def test_large_errors_reach_the_optimum_of_the_truth(estimator, count):
    """Every draw converges to the optimum reached from the true errors, within the closed form's six iterations."""
    for seed in range(count):
        found = srt.calibrate(large(seed)[0], estimator)
        assert (seed, found.status) == (seed, "converged")
        assert len(found.corrections) <= 6
        assert distance(found, optimum_of_truth(seed, estimator)) <= 1.0


@sized(1, 200)
@pytest.mark.parametrize("estimator", [*JOINT, "least-squares", "closed-form"])
def test_start_at_zero_reaches_the_same_optimum(estimator, count):
    """A start at zero, without the fixture's angles, reaches the same optimum: short rotations are fitted first."""
    for seed in range(count):
        found = srt.calibrate(large(seed)[0], estimator, start="zero", checks=False)
        assert (seed, found.status) == (seed, "converged")
        assert distance(found, optimum_of_truth(seed, estimator)) <= 1.0


@sized(1, 200)
@pytest.mark.parametrize("estimator", JOINT)
def test_a_failure_from_a_bad_start_is_reported(estimator, count):
    """An iteration that starts at zero may fail at this size; it never reports convergence to another point."""
    rows = []
    for seed in range(count):
        found = srt.calibrate(large(seed)[0], estimator, start=SensorErrors(), checks=False)
        away = distance(found, optimum_of_truth(seed, estimator)) if found.observed.any() else np.inf
        rows.append((seed, found.status, len(found.corrections), away))
        assert found.status != "converged" or away <= 1.0, rows[-1]
    reached = sum(status == "converged" for _, status, _, _ in rows)
    print(f"\n{estimator} straight from no errors, ±50 %: {reached} of {count} reached the optimum")
    for row in rows[:20]:
        print("  draw {}: {} after {} iterations, {:.2g} of the tolerance away".format(*row))


@pytest.mark.slow
def test_the_optimum_does_not_depend_on_the_start_where_mars_is_rotated_from_the_mount(monkeypatch):
    """The mounting's prior is renewed near the solution; as the start left it, the optimum moves with the start."""
    rng = np.random.default_rng(50)
    truth, _ = accuracy_trials.large_errors(rng)
    motion = on_fixture(rng, 5e-3, sample_rate_hz=50.0, U=rotation(0.2 * np.array([0.6, -0.48, 0.64])))
    # Noise is stated, at its smallest value: what the windows show of it depends on the start, too.
    recording = replace(read_out(motion, truth), noise=ImuNoise(gyro_noise=1e-10, accel_noise=1e-8))

    def away():
        return distance(
            srt.calibrate(recording, "graph", checks=False),
            srt.calibrate(recording, "graph", start=truth, checks=False),
        )

    renewed = away()
    # The class that the registered estimator uses, whatever other tests import anew.
    joint = find_estimator("graph").__globals__["open_joint_model"].__globals__["JointModel"]
    monkeypatch.setattr(joint, "with_mounting_prior", lambda self, _: self)
    assert renewed <= 1.0
    assert away() > 10.0 * renewed


# Fine noise


@cache
def fine(seed):
    """1e-9 rad/√s and 1e-8 g·√s, every alignment and angle off by 1 mrad; worst error of graph and closed form."""
    rng = np.random.default_rng(seed)
    truth = accuracy_trials.normal_errors(rng, 1e-3, 10.0 * DEG_PER_H)
    # Gravity is known, as a common error of it is none of an estimator's.
    motion = on_fixture(rng, site=replace(SITE, gravity_sigma_m_s2=1e-9), sample_rate_hz=200.0)
    recording = read_out(motion, truth, ImuModel(gyro_noise=1e-9, accel_noise=1e-8 * STANDARD_GRAVITY_M_S2), rng)
    return {
        e: accuracy_trials.score(srt.calibrate(recording, e, checks=False), truth)
        for e in ("graph", "ekf", "closed-form")
    }


@sized(1, 50)
def test_fine_noise_shows_what_joint_estimation_buys(count):
    """Below 1e-7 on every parameter, and five times below the closed form's worst."""
    trials = [fine(seed) for seed in range(count)]
    worst = {e: max(float(np.abs(t[e].error).max()) for t in trials) for e in ("graph", "ekf")}
    closed = max(float(np.abs(t["closed-form"].error[ERRORS]).max()) for t in trials)
    for estimator in JOINT:
        assert {t[estimator].status for t in trials} == {"converged"}
        assert worst[estimator] < 1e-7
        assert worst[estimator] < closed / 5.0
        # And as small as they say themselves.
        nees = np.mean([t[estimator].nees for t in trials])
        assert nees < 1.0 + 3.5 * np.sqrt(2.0 / 27.0 / count)


# Without a fixture, or with less of one


def free(seed, *, latitude=True):
    """The hand-turned MEMS unit of accuracy_trials.free_trial, with or without a latitude."""
    rng = np.random.default_rng(seed)
    sizes = {"gyro_scale": 0.01, "gyro_asymmetry": 1e-3, "gyro_orthogonality": 0.01, "accel_bias": 0.2}
    sizes |= {"accel_scale": 0.01, "accel_asymmetry": 1e-3, "accel_misalignment": 0.01, "gyro_bias": 0.01}
    vector = [rng.standard_normal(GROUP_SLICES[g].stop - GROUP_SLICES[g].start) * s for g, s in sizes.items()]
    truth = SensorErrors(np.concatenate(vector))
    true_site = replace(SITE, gravity_m_s2=SITE.gravity_m_s2 + rng.standard_normal() * SITE.gravity_sigma_m_s2)
    motion = free_motion(
        random_turns(rng, 36, smallest_rad=0.8, largest_rad=3.0),
        site=true_site,
        attitude=random_attitude(rng),
        sample_rate_hz=100.0,
    )
    imu = ImuModel(gyro_noise=0.3 * DEG_PER_SQRT_H, accel_noise=200.0 * MICRO_G)
    stated = SITE if latitude else replace(SITE, latitude_rad=None)
    return read_out(motion.stated_as(site=stated), truth, imu, rng, state_noise=False), truth


def table(seed, *, latitude=True, heading=True, labels=True, U=None):
    """A navigation unit on a 1 mrad fixture of which less is stated than there is."""
    rng = np.random.default_rng(seed)
    truth = accuracy_trials.normal_errors(rng, 1e-3, 10.0 * DEG_PER_H)
    true_site = replace(SITE, gravity_m_s2=SITE.gravity_m_s2 + rng.standard_normal() * SITE.gravity_sigma_m_s2)
    motion = table1_motion(
        site=true_site,
        sample_rate_hz=100.0,
        heading_rad=0.0 if heading else 0.7,
        fixture_draw=accuracy_trials.fixture_errors(rng, 1e-3),
        stated_fixture=Fixture(0.0 if heading else None, 1e-3, 1e-3),
        moves="skipped" if labels else "recorded",
        U=U,
    )
    stated = SITE if latitude else replace(SITE, latitude_rad=None)
    recording = read_out(motion.stated_as(site=stated), truth, accuracy_trials.GRADES["navigation"], rng)
    return (recording if labels else recording.with_sequences(())), truth


TURNED = rotation(0.2 * np.array([1.0, 2.0, -2.0]) / 3.0)
LESS_KNOWN = {
    "free": (free, 3000),
    "free without latitude": (partial(free, latitude=False), 3000),
    "no heading": (partial(table, heading=False), 0),
    "no latitude": (partial(table, latitude=False), 0),
    "neither": (partial(table, heading=False, latitude=False), 0),
    "unlabelled": (partial(table, labels=False), 0),
    "turned 0.2 rad": (partial(table, U=TURNED), 0),
}


@cache
def less_known(case, seed):
    """Recording of a case, its true errors, and both calibrations."""
    recording, truth = LESS_KNOWN[case][0](seed)
    return truth, {e: srt.calibrate(recording, e, checks=False) for e in JOINT}


def consistent(nees, count):
    """Mean of NEES / 27 over recordings, of variance 2 / 27 each."""
    return abs(np.mean(nees) - 1.0) < 3.5 * np.sqrt(2.0 / 27.0 / count)


@pytest.mark.parametrize(
    ("case", "count"),
    [(name, 1) for name in LESS_KNOWN]
    + [pytest.param(name, 300 if name == "free" else 40, marks=pytest.mark.campaign) for name in LESS_KNOWN],
)
def test_filter_and_graph_are_consistent_and_agree(case, count):
    """Both find the same within 0.05 sigma, as they solve the same problem, and their sigmas are true."""
    first = LESS_KNOWN[case][1]
    nees = {estimator: [] for estimator in JOINT}
    for seed in range(first, first + count):
        truth, found = less_known(case, seed)
        for estimator, calibration in found.items():
            assert calibration.status in ("converged", "partial"), calibration.message
            nees[estimator].append(accuracy_trials.score(calibration, truth).nees)
        both = found["ekf"].observed & found["graph"].observed
        apart = np.abs(found["ekf"].errors.vector - found["graph"].errors.vector)[both] / found["graph"].sigma[both]
        ratio = found["ekf"].sigma[both] / found["graph"].sigma[both]
        # The filter's prior, a third of full scale, takes nothing from a sigma that the data give.
        assert np.abs(ratio - 1.0).max() < (0.001 if case != "unlabelled" else 0.02)
        # Where pulses outweigh the random walk, the reading at the edge of a pose that two turns share is one unknown
        # to the graph and two to the filter: two unbiased weightings of the same data, each within its own sigma.
        bar = 0.05 if case != "unlabelled" else 1.0
        assert apart.max() < bar, (seed, NAMES[np.flatnonzero(both)[apart.argmax()]], apart.max())
    for estimator in JOINT:
        assert consistent(nees[estimator], count), (estimator, np.mean(nees[estimator]))


@pytest.mark.parametrize("estimator", JOINT)
def test_mars_turned_from_the_mount_is_noted_and_found(estimator):
    """0.2 rad: told in the warnings, and U comes out to the milliradian that mounting and angles are known to."""
    calibration = less_known("turned 0.2 rad", 0)[1][estimator]
    assert calibration.status == "converged"
    assert any("rotated by" in w and "mounting" in w for w in calibration.warnings)
    away = 0.5 * np.linalg.norm(calibration.U @ TURNED.T - TURNED @ calibration.U.T) / np.sqrt(2.0)
    assert away < 3.5e-3 * np.sqrt(3.0)
    straight = srt.calibrate(table(0)[0], estimator, checks=False)
    assert not any("mounting" in w for w in straight.warnings)


def cut_off(recording, left):
    """The recording ended ``left`` samples into the last sequence's end window, the label kept as far as it goes."""
    last = recording.sequences[-1]
    stop = recording.window_indices(*last.end_static_s).start + left
    label = replace(last, end_static_s=(last.end_static_s[0], float(recording.time[stop - 1])))
    return replace(
        recording,
        time=recording.time[:stop],
        gyro=recording.gyro[:stop],
        accel=recording.accel[:stop],
        sequences=(*recording.sequences[:-1], label),
        data_sha256=None,
    )


@pytest.mark.parametrize("estimator", JOINT)
def test_a_lost_end_window_leaves_the_start_window(estimator):
    """One sample is no window: the start window counts all the same, and is worth something."""
    recording, truth = table(1)
    calibration = srt.calibrate(cut_off(recording, 1), estimator, checks=False)
    assert calibration.status == "converged"
    without = srt.calibrate(recording.with_sequences(recording.sequences[:-1]), estimator, checks=False)
    # Another pose is information about something and takes none from anything; rounding, and noise that is
    # estimated from windows, are a part in a thousand.
    assert np.all(calibration.sigma < 1.002 * without.sigma)
    assert np.any(calibration.sigma < 0.99 * without.sigma)
    error = (calibration.errors.vector - truth.vector) / calibration.sigma
    # 27 normals: 1 in 1e4 for the largest.
    assert np.abs(error).max() < 4.6


@pytest.mark.parametrize("left", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (50, 500))])
@pytest.mark.parametrize("estimator", JOINT)
def test_a_short_end_window_is_a_window(estimator, left):
    recording, truth = table(1)
    calibration = srt.calibrate(cut_off(recording, left), estimator, checks=False)
    assert calibration.status == "converged"
    assert np.abs((calibration.errors.vector - truth.vector) / calibration.sigma).max() < 4.6


# Recorded data


@cache
def xsens(estimator, gyro_bias):
    held = ("gyro_asymmetry", "accel_asymmetry")  # imu_tk models no asymmetry of either kind
    return srt.calibrate(recorded_sets.xsens_mti(FOLDER), estimator, hold=held, gyro_bias=gyro_bias)


@needs_data
@pytest.mark.parametrize("estimator", JOINT)
def test_xsens_agrees_with_imu_tk(estimator):
    """Which has no g-sensitivity."""
    calibration = xsens(estimator, "pooled")
    assert calibration.status == "partial"
    assert_agrees_with_imu_tk(calibration)


RECORDED = {
    "xsens": lambda: recorded_sets.xsens_mti(FOLDER),
    "mpu9150": lambda: recorded_sets.mpu9150(FOLDER, 0),
    "ferraris": lambda: recorded_sets.ferraris(FOLDER),
}


def agree(recording):
    """Least squares, Kalman filter and graph observe the same and end at one point; result of least squares."""
    least = srt.calibrate(recording, "least-squares")
    for estimator in JOINT:
        found = srt.calibrate(recording, estimator)
        assert (found.status, found.judgement.word) == (least.status, least.judgement.word), estimator
        assert np.array_equal(found.observed, least.observed), estimator
        apart = np.abs(found.errors.vector - least.errors.vector)[least.observed]
        assert np.all(apart < 0.01 * least.sigma[least.observed]), estimator
    return least


@needs_data
@pytest.mark.parametrize("name", RECORDED)
def test_estimators_agree_on_recorded_data(name):
    """Where asymmetries are hardly shown, too."""
    agree(RECORDED[name]())


def test_a_parameter_that_is_hardly_shown_costs_the_others_no_accuracy():
    """Eight turns by hand: one asymmetry has a sigma of 0.4 %. Fixed as if known to 1 %, it would double others'."""
    scenario = sims.load_scenario("free-mems")
    few = scenario.free.model_copy(update={"turns": 8})
    recording = sims.simulate(scenario.model_copy(update={"free": few, "seed": 2})).recording
    least = agree(recording)
    assert np.array(NAMES)[~least.observed].tolist() == ["gyro_asymmetry_y"]
    free = srt.calibrate(recording, "least-squares", prior=Prior.from_sigma(10.0 * admission_sigma()))
    both = least.observed & free.observed
    assert np.all(least.sigma[both] <= 1.001 * free.sigma[both])
