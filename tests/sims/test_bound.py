"""The Cramér-Rao bound: derivatives and noise against the simulator, signatures against the paper's, and its limits."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from accuracy_trials import GRADES, SITE, noisy_recording, normal_errors
from scipy.spatial.transform import Rotation

import sims
import srt
from sims.accuracy.bound import (
    END_ACCEL,
    FIXTURE_SIGMAS,
    ROTATION,
    START_ACCEL,
    bayesian_bound,
    linearise,
    scenario_bound,
)
from sims.physics.imu import ImuModel, gyro_matrix, noise_free_increments
from sims.physics.motion import RateProfile
from sims.scenarios.simulation import schedule_of
from srt.constants import DEG_PER_SQRT_H
from srt.exceptions import DataError, InputError
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SYMBOLS, SensorErrors

G = SITE.gravity_m_s2
BIASES = (("κx", 1e-3), ("κy", 1e-3), ("κz", 1e-3), ("λx", 1e-2), ("λy", 1e-2), ("λz", 1e-2))
NAVIGATION = GRADES["navigation"]
SMOOTH = ImuModel(NAVIGATION.gyro_noise, NAVIGATION.accel_noise)


def table(*ids, **options):
    return sims.Schedule(sims.table_sequences(ids or tuple(sims.TABLE_1)), **options)


def fixture(sigma):
    return dict.fromkeys(FIXTURE_SIGMAS, sigma)


@cache
def linear(imu=NAVIGATION, **options):
    """Table 1 linearised, once for each unit and options."""
    return linearise(table(), site=SITE, imu=imu, sample_rate_hz=100.0, **options)


def turned(angles):
    """Rotation by increments one after the other, shape (..., n, 3) to (..., 3, 3)."""
    steps = Rotation.from_rotvec(angles.reshape(-1, 3)).as_matrix().reshape(*angles.shape, 3)
    while (n := steps.shape[-3]) > 1:
        pairs = steps[..., 0 : n - 1 : 2, :, :] @ steps[..., 1::2, :, :]
        steps = np.concatenate([pairs, steps[..., n - 1 :, :, :]], axis=-3) if n % 2 else pairs
    return steps[..., 0, :, :]


def measured(motion, gyro, accel, angles):
    """Window means (K, 12) of increments, and rotations (K, 3, 3) from the angles taken for true."""
    edges = np.searchsorted(motion.time, np.array(motion.windows) + 0.5 * motion.interval, side="right")
    means = [
        increments[a:b].mean(axis=0) / motion.interval
        for windows in edges
        for a, b in windows
        for increments in (gyro, accel)
    ]
    rotations = [turned(angles[windows[0, 1] : windows[1, 0]]) for windows in edges]
    return np.reshape(means, (len(edges), 12)), np.array(rotations)


def compensated(motion, gyro, errors):
    """True angles behind gyro increments, by fixed-point iteration on the simulator's reading."""
    angles = gyro
    for _ in range(12):
        guess = replace(motion, angle=angles, angle_abs=np.abs(angles), velocity=0 * gyro, velocity_abs=0 * gyro)
        angles = angles + gyro - noise_free_increments(guess, errors)[0]
    return angles


@pytest.mark.parametrize("size", [0.0, 0.01])
def test_derivatives_predict_what_the_simulator_measures(size):
    """Errors, fixture, start and end attitudes changed at once, by 1e-7: what is quadratic in them is 1e-12 at most."""
    rng = np.random.default_rng(1)
    schedule = table("1", "6", "8", "13")
    errors = normal_errors(rng, size)
    turn_of_body = sims.rotation([0.1, -0.2, 0.3])
    where = {"heading_rad": 0.4, "U": turn_of_body}
    model = linearise(schedule, site=SITE, imu=NAVIGATION, errors=errors, **where)
    change = rng.standard_normal(N_PARAMETERS) * 1e-7
    draw = sims.draw_fixture(rng, schedule.sequences, **fixture(1e-7))
    gravity = 1e-6

    still, moved = (
        sims.run_schedule(schedule, site=replace(SITE, gravity_m_s2=G + more), fixture_draw=drawn, **where)
        for more, drawn in ((0.0, None), (gravity, draw))
    )
    results = []
    for motion, added in ((still, 0.0 * change), (moved, change)):
        gyro, accel = noise_free_increments(motion, errors.plus(added))
        results.append(measured(motion, gyro, accel, compensated(motion, gyro, errors)))
    (means, rotations), (new_means, new_rotations) = results

    e = Rotation.from_matrix(still.attitudes[:, 1].transpose(0, 2, 1) @ moved.attitudes[:, 1]).as_rotvec()
    unknowns = np.array([*draw.base, *draw.mounting, draw.non_orthogonality, gravity])
    unknowns = np.hstack([np.tile(unknowns, (4, 1)), draw.starts])
    unknowns[:, 6] += draw.wobble[:, 0]
    predicted = model.errors @ change
    predicted += np.einsum("krp,kp->kr", model.fixture, unknowns) + np.einsum("krp,kp->kr", model.end, e)
    np.testing.assert_allclose(new_means - means, predicted[:, :12], rtol=0.0, atol=1e-11)
    rho = Rotation.from_matrix(new_rotations @ rotations.transpose(0, 2, 1)).as_rotvec()
    # Where a rate changes its sign within a sample, half of one at most has the wrong slope of |ω|, for each rotation.
    tolerance = 1e-11 + 8.0 * size * np.abs(change).max() / 200.0
    np.testing.assert_allclose(rho, predicted[:, ROTATION], rtol=0.0, atol=tolerance)
    assert np.abs(rho).max() > 1e3 * tolerance
    # The Earth turns by a milliradian meanwhile; what does not commute in a sample is (β̇ dt / 2)² for each rotation.
    between = Rotation.from_matrix(model.turn.transpose(0, 2, 1) @ rotations).magnitude()
    assert between.max() < 8.0 * (0.5 / 200.0) ** 2


def test_derivatives_predict_the_moves():
    """As of the sequences; only moves that turn are measured, and a gap is none."""
    rng = np.random.default_rng(8)
    # No move turns by half a turn, whose sense the smallest error decides.
    schedule = table("1", "1a", "6", "2", "7", moves="recorded", pause_s=0.3)
    model = linearise(schedule, site=SITE, imu=NAVIGATION).moves
    assert model.before.tolist() == [1, 2, 3]  # 1a starts where 1 ends
    assert not linear().moves.before.size
    attitude = linearise(schedule, site=SITE, imu=NAVIGATION).attitude
    change = rng.standard_normal(N_PARAMETERS) * 1e-7
    draw = sims.draw_fixture(rng, schedule.sequences, **fixture(1e-7))
    results, ends = [], []
    for drawn, added in ((None, 0.0 * change), (draw, change)):
        motion = sims.run_schedule(schedule, site=SITE, fixture_draw=drawn)
        angles = compensated(motion, noise_free_increments(motion, SensorErrors(added))[0], SensorErrors())
        windows = np.searchsorted(motion.time, np.array(motion.windows) + 0.5 * motion.interval, side="right")
        results.append([turned(angles[a:b]) for a, b in zip(windows[:-1, 1, 1], windows[1:, 0, 0], strict=True)])
        ends.append(motion.attitudes[:, 1])
    still, moved = (np.array(r)[model.before] for r in results)
    common = np.array([*draw.base, *draw.mounting, draw.non_orthogonality, 0.0])
    of_start = np.hstack([np.tile(common, (5, 1)), draw.starts])
    of_start[:, 6] += draw.wobble[:, 0]
    end = Rotation.from_matrix(ends[0].transpose(0, 2, 1) @ ends[1]).as_rotvec()
    start = np.einsum("kap,kp->ka", attitude[:, 0], of_start)
    predicted = model.errors @ change - end[model.before]
    predicted += np.einsum("mab,mb->ma", model.turn, start[model.before + 1])
    rho = Rotation.from_matrix(moved @ still.transpose(0, 2, 1)).as_rotvec()
    # A sample in which a rotation begins or ends, 10 rad/s² over 5 ms, can have the wrong slope of |ω|: four of a move.
    tolerance = 1e-11 + 4.0 * 0.5 * 10.0 * 0.005**2 * np.abs(change).max()
    np.testing.assert_allclose(rho, predicted, rtol=0.0, atol=tolerance)
    assert np.abs(rho).max() > 1e3 * tolerance


def test_noise_is_that_of_noisy_readings():
    """Measurements of noisy readings, whitened with the covariance, are independent and of unit variance."""
    vector = np.array(normal_errors(np.random.default_rng(2), 0.05).vector)
    vector[GROUP_SLICES["gyro_asymmetry"]] = 0.0  # which is compensated by the sign of a rate: no matter of noise
    errors = SensorErrors(vector)
    schedule = table("8", "13", dwell_s=2.0)
    # Pulses make most of the variance of the means and of the rotation, so that what they share is seen.
    imu = ImuModel(gyro_noise=3e-6, accel_noise=3e-5, gyro_quantization=2e-5, accel_quantization=2e-4)
    model = linearise(schedule, site=SITE, imu=imu, errors=errors, sample_rate_hz=400.0)
    motion = sims.run_schedule(schedule, site=SITE, sample_rate_hz=400.0)
    to_true = np.linalg.inv(gyro_matrix(errors)).T
    dt = motion.interval

    def measure(gyro, accel, biases):
        gyro, accel = gyro - biases[0] * dt, accel - biases[1] * dt
        return measured(motion, gyro, accel, gyro @ to_true)

    stems = ("gyro_bias", "accel_bias")
    means, rotations = measure(*noise_free_increments(motion, errors), [errors.group(stem) for stem in stems])
    trials, off = 400, []
    for rng in np.random.default_rng(3).spawn(trials):
        # Known biases of many pulses in a window, so that each edge is rounded anew.
        unit = errors.plus(sum(rng.uniform(-size, size) * (np.array(SYMBOLS) == symbol) for symbol, size in BIASES))
        noisy = sims.read_out(motion, unit, imu, rng, kind="increment")
        noisy_means, noisy_rotations = measure(noisy.gyro, noisy.accel, [unit.group(stem) for stem in stems])
        rho = Rotation.from_matrix(noisy_rotations @ rotations.transpose(0, 2, 1)).as_rotvec()
        off.append(np.hstack([noisy_means - means, rho]))
    white = np.linalg.solve(np.linalg.cholesky(model.noise), np.array(off)[..., np.newaxis])[..., 0]
    correlation = np.einsum("tki,tkj->kij", white, white) / trials
    # 450 numbers: the largest is below 4.5 standard errors, √(2/n) on the diagonal and √(1/n) off it.
    assert (np.abs(correlation - np.eye(15)) < 4.5 * np.sqrt((1.0 + np.eye(15)) / trials)).all()
    assert abs((white**2).mean() - 1.0) < 3.5 * math.sqrt(2.0 / white.size)


def test_noise_is_that_of_windows_of_their_own_lengths():
    """White noise of a mean goes with one over the window's time; equal lengths are the one length for all."""
    runs = [
        linearise(table("1", "8", **dwells), site=SITE, imu=SMOOTH, sample_rate_hz=100.0)
        for dwells in ({"dwell_s": 2.0}, {"dwells_s": ((2.0, 2.0),) * 2}, {"dwells_s": ((2.0, 2.0), (6.0, 4.0))})
    ]
    for name in ("errors", "fixture", "end", "noise", "turn"):
        np.testing.assert_array_equal(getattr(runs[1], name), getattr(runs[0], name))
    same, longer = (np.einsum("kii->ki", run.noise) for run in runs[1:])
    np.testing.assert_array_equal(longer[0], same[0])
    # Rounding of differences of times near 30 s: 1e-15 of a window.
    np.testing.assert_allclose(same[1, START_ACCEL] / longer[1, START_ACCEL], 3.0, rtol=1e-13)
    np.testing.assert_allclose(same[1, END_ACCEL] / longer[1, END_ACCEL], 2.0, rtol=1e-13)


def test_bound_is_the_inverse_information_of_all_unknowns_at_once():
    """The bias of each sequence and its whole end attitude unknowns of their own: 24, 8, 3K, 2K, 3K and K unknowns.

    The end attitude is free but for the angle between its axes, which is that of the fixture to within the wobble.
    """
    model, K = linear(), len(sims.TABLE_1)
    known = dict(zip(FIXTURE_SIGMAS, (2e-4, 1e-3, 5e-4, 3e-4, 7e-4, 5e-6), strict=True))
    level, north, mounting, skew, rotation, wobble = known.values()
    walk = 2e-8
    own = 3 + 2 + 3 + 1
    blocks = np.zeros((K, 15, K, own))
    blocks[range(K), :, range(K)] = np.concatenate(
        [model.errors[:, :, 24:], model.fixture[:, :, 8:], model.end, model.fixture[:, :, [6]]], axis=2
    )
    J = np.concatenate([model.errors[:, :, :24], model.fixture[:, :, :8], blocks.reshape(K, 15, -1)], axis=2)
    information = np.einsum("kri,krs,ksj->ij", J, np.linalg.inv(model.noise), J, optimize=True)
    variance = np.square([level, level, north, mounting, mounting, mounting, skew, 5e-6])
    information[range(24, 32), range(24, 32)] += 1.0 / variance
    bias = 32 + own * np.arange(K)[:, np.newaxis] + np.arange(3)
    start = 32 + own * np.arange(K)[:, np.newaxis] + np.arange(3, 5)
    information[start, start] += 1.0 / rotation**2
    lean = 32 + own * np.arange(K) + 8
    information[lean, lean] += 1.0 / wobble**2
    of_end = model.attitude[:, 1]
    across = np.cross(of_end[:, :, 8], of_end[:, :, 9])  # of the rotations of both axes
    squareness = np.zeros((K, len(information)))
    squareness[:, 24:32] = -np.einsum("ka,kap->kp", across, of_end[:, :, :8])
    squareness[np.arange(K)[:, np.newaxis], 32 + own * np.arange(K)[:, np.newaxis] + np.arange(5, 8)] = across
    squareness /= (np.einsum("ka,ka->k", across, of_end[:, :, 6]) * wobble)[:, np.newaxis]
    information += squareness.T @ squareness
    step = np.zeros((K - 1, 3, len(information)))
    step[np.arange(K - 1)[:, np.newaxis], np.arange(3), bias[1:]] = 1.0 / walk
    step[np.arange(K - 1)[:, np.newaxis], np.arange(3), bias[:-1]] = -1.0 / walk
    information += np.einsum("kai,kaj->ij", step, step)
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    reported = np.zeros((N_PARAMETERS, len(information)))
    reported[range(24), range(24)] = 1.0
    reported[np.arange(24, 27)[np.newaxis], bias] = 1.0 / K
    expected = reported @ covariance @ reported.T
    got = model.bound(known, 5e-6, walk).covariance
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(got / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0.0, atol=1e-6)


def assert_not_below(worse, better):
    scale = np.sqrt(np.outer(np.diag(worse), np.diag(worse)))
    assert np.linalg.eigvalsh((worse - better) / scale)[0] > -1e-9


def test_an_unknown_north_is_the_limit_of_a_poor_one():
    north = {"north_sigma_rad": 30.0}
    poor, unknown = (
        linear().bound(fixture(1e-3) | sigma, 5e-6).sigma for sigma in (north, {"north_sigma_rad": math.inf})
    )
    np.testing.assert_allclose(unknown, poor, rtol=1e-4)


def test_errors_that_no_sequence_shows_are_named():
    without = [name for name in sims.TABLE_1 if name != "3a"]
    with pytest.raises(DataError, match=r"do not determine gyro_scale_z, gyro_asymmetry_z:"):
        bayesian_bound(table(*without), site=SITE, imu=NAVIGATION, fixture_sigma=fixture(1e-3), earth_rate=False)
    # The Earth's rate in the windows tells them apart after all, as well as N/√(20 s) against 5e-5 rad/s does.
    bound = bayesian_bound(
        table(*without), site=SITE, imu=NAVIGATION, fixture_sigma=fixture(1e-3), sample_rate_hz=100.0
    )
    assert 1e-4 < bound["gyro_scale_z"] < 1e-2


def test_an_axis_that_never_sees_gravity_is_named():
    """Its force is rounding, 6e-17 g, and must not count as a measurement however small the noise."""
    names = "accel_scale_y, accel_asymmetry_y, accel_misalignment_xy, accel_misalignment_zy"
    with pytest.raises(DataError, match=f"do not determine {names}:"):
        bayesian_bound(table("8", "9"), site=SITE, imu=NAVIGATION, fixture_sigma=fixture(1e-3))


def test_bound_of_the_papers_gyro():
    """0.002 °/√h over two full turns of 6.4 s ([P] §9: 0.59 ppm over one and 40 s), lowered by the other sequences."""
    noise = 0.002 * DEG_PER_SQRT_H
    imu = ImuModel(gyro_noise=noise, accel_noise=1e-9)
    bound = bayesian_bound(table(), site=SITE, imu=imu, fixture_sigma=fixture(1e-3), sample_rate_hz=100.0)
    pair = noise * math.sqrt(RateProfile().duration_s(2.0 * math.pi)) / (2.0 * math.pi * math.sqrt(2.0))
    assert 0.15e-6 < pair < 0.17e-6
    scales = bound.sigma[GROUP_SLICES["gyro_scale"]]
    assert ((scales > 0.8 * pair) & (scales < pair)).all()
    assert bound["gyro_scale_x"] == scales[0]


@pytest.mark.parametrize("grade", GRADES)
def test_closed_form_is_not_better_than_the_bound(grade):
    recording, truth = noisy_recording(11, grade)
    known = fixture(1e-3) | {"non_orthogonality_sigma_rad": 0.0}
    bound = bayesian_bound(
        table(), site=SITE, imu=GRADES[grade], fixture_sigma=known, errors=truth, sample_rate_hz=100.0
    )
    ratio = srt.calibrate(recording, "closed-form", checks=False).sigma / bound.sigma
    assert ratio.min() > 0.99
    assert ratio[GROUP_SLICES["gyro_scale"]].max() < 1.3


def test_bound_of_a_scenario():
    scenario = sims.load_scenario("navigation-rlg")
    scenario = scenario.model_copy(
        update={"recording": scenario.recording.model_copy(update={"sample_rate_hz": 100.0})}
    )
    sigma = scenario.fixture.draw_sizes()
    sigma["mounting_sigma_rad"] = math.hypot(sigma["mounting_sigma_rad"], 0.5e-3)
    expected = bayesian_bound(
        schedule_of(scenario.schedule),
        site=scenario.site.site(),
        imu=ImuModel(**scenario.imu.noise.si()),
        fixture_sigma=sigma,
        heading_rad=math.radians(30.0),
        sample_rate_hz=100.0,
    )
    np.testing.assert_allclose(scenario_bound(scenario).sigma, expected.sigma, rtol=1e-9)
    blind = scenario.model_copy(update={"fixture": scenario.fixture.model_copy(update={"state_heading": False})})
    assert_not_below(scenario_bound(blind).covariance, expected.covariance)


def test_unsupported_scenarios_are_refused():
    with pytest.raises(InputError, match="free recording"):
        scenario_bound(sims.load_scenario("free-mems"))
    with pytest.raises(InputError, match="no accel noise"):
        bayesian_bound(table("1"), site=SITE, imu=ImuModel(gyro_noise=1e-6), fixture_sigma={})
    with pytest.raises(InputError, match="no fixture sigma 'level'"):
        linear().bound({"level": 1e-3}, 5e-6)
    with pytest.raises(InputError, match="level_sigma_rad is inf"):
        linear().bound({"level_sigma_rad": math.inf}, 5e-6)
    with pytest.raises(InputError, match="walk"):
        linear().bound({}, 5e-6, -1.0)
