"""Disturbances of a simulated test, each against the same disturbance made in another way."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from injected_faults.disturbances import accel_bias_step, lose_samples, noisier_window, tilt_step, wrong_angle
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import sims
from srt.constants import EARTH_RATE_RAD_S
from srt.recording.recording import Site
from srt.sensor_errors import SensorErrors

LATITUDE = math.radians(45.0)
SITE = Site(9.80665, 5e-6, LATITUDE)
IDS = ("7", "13", "6")
TILT = np.array([1e-3, -2e-3, 0.5e-3])
U = Rotation.from_rotvec([0.2, -0.1, 0.3])


def draw(size=2e-3):
    return sims.draw_fixture(
        np.random.default_rng(5),
        sims.table_sequences(IDS),
        level_sigma_rad=size,
        north_sigma_rad=size,
        mounting_sigma_rad=size,
        non_orthogonality_sigma_rad=size,
        rotation_sigma_rad=size,
    )


def run(turn=U, fixture_draw=None, **changes):
    settings_of_run = {"sequences": IDS, "sample_rate_hz": 50.0, "dwell_s": 1.0, "settle_s": 0.5, "heading_rad": 0.4}
    return sims.table1_motion(
        site=SITE, fixture_draw=fixture_draw or draw(), U=turn.as_matrix(), **(settings_of_run | changes)
    )


MOTION = run()


def untouched(motion, before):
    return all(np.array_equal(getattr(motion, name), array) for name, array in before.items())


def snapshot(thing):
    return {
        f.name: np.array(value)
        for f in fields(thing)
        if isinstance(value := getattr(thing, f.name), np.ndarray) and not f.name.startswith("_")
    }


NONE = SensorErrors()
ERRORS = SensorErrors(np.random.default_rng(1).standard_normal(27) * 1e-3)
RECORDING = sims.read_out(MOTION, ERRORS, sims.ImuModel(gyro_noise=1e-4, accel_noise=1e-3), np.random.default_rng(2))
INCREMENTS = replace(
    RECORDING, gyro=RECORDING.gyro * MOTION.interval, accel=RECORDING.accel * MOTION.interval, kind="increment"
)
EITHER = pytest.mark.parametrize("recording", [RECORDING, INCREMENTS], ids=["rate", "increment"])


def inside(recording, start_s, end_s):
    half = 0.5 * (recording.time[1] - recording.time[0])
    return (recording.time > start_s + half) & (recording.time <= end_s + half)


@EITHER
@pytest.mark.parametrize("sensors", [("gyro",), ("accel",), ("gyro", "accel")])
def test_lost_samples_lie_on_a_line_between_the_neighbours(recording, sensors):
    start = MOTION.windows[0][0][1] + 0.3
    before = snapshot(recording)
    out = lose_samples(recording, start, 0.2, sensors)
    assert untouched(recording, before)
    lost = inside(recording, start, start + 0.2)
    assert lost.sum() == 10
    for name in ("gyro", "accel"):
        values, original = getattr(out, name), getattr(recording, name)
        np.testing.assert_array_equal(values[~lost], original[~lost])
        if name not in sensors:
            np.testing.assert_array_equal(values, original)
            continue
        for axis in range(3):
            expected = np.interp(recording.time[lost], recording.time[~lost], original[~lost, axis])
            np.testing.assert_allclose(values[lost, axis], expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_a_bias_step_is_the_reading_of_a_unit_with_another_bias(kind):
    step = np.array([1e-3, -2e-3, 5e-4])
    added = SensorErrors.from_dict({f"accel_bias_{a}": s for a, s in zip("xyz", step, strict=True)})
    biased = SensorErrors(ERRORS.vector + added.vector)
    plain, other = (sims.read_out(MOTION, errors, kind=kind) for errors in (ERRORS, biased))
    start, end = MOTION.windows[0][1][0] + 0.3, MOTION.windows[2][0][0] + 0.5  # over two gaps
    before = snapshot(plain)
    out = accel_bias_step(plain, start, end, step)
    assert untouched(plain, before)
    rows = inside(plain, start, end)
    assert 0 < rows.sum() < len(rows)
    np.testing.assert_array_equal(out.gyro, plain.gyro)
    np.testing.assert_array_equal(out.accel[~rows], plain.accel[~rows])
    np.testing.assert_allclose(out.accel[rows], other.accel[rows], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_noise_of_a_window_is_the_factor_times_the_stated_one(kind):
    still = sims.free_motion(np.array([[1.0, 0.0, 0.0]]), site=SITE, dwell_s=40.0, sample_rate_hz=100.0)
    densities = (2e-4, 3e-3)
    recording = sims.read_out(still, NONE, sims.ImuModel(*densities), np.random.default_rng(3), kind=kind)
    before = snapshot(recording)
    rng = np.random.default_rng(4)
    out = noisier_window(recording, (2.0, 38.0), 3.0, *densities, rng)
    assert untouched(recording, before)
    rows = inside(recording, 2.0, 38.0) & (still.time < 39.0)
    exact = sims.read_out(still, NONE, kind=kind)
    n = 3 * rows.sum()
    low, high = np.sqrt(chi2.ppf([1e-6, 1.0 - 1e-6], n) / n)
    added = []
    for name, density in zip(("gyro", "accel"), densities, strict=True):
        values, original = getattr(out, name), getattr(recording, name)
        np.testing.assert_array_equal(values[~rows], original[~rows])
        sigma = 3.0 * density * (0.1 if kind == "increment" else 10.0)  # √dt of 100 Hz, or one over it
        assert low < np.sqrt(np.mean((values - getattr(exact, name))[rows] ** 2)) / sigma < high
        added.append((values - original)[rows].ravel())
    assert abs(np.corrcoef(*added)[0, 1]) < 5.0 / math.sqrt(n)
    repeated = noisier_window(recording, (2.0, 38.0), 3.0, *densities, np.random.default_rng(4))
    np.testing.assert_array_equal(repeated.gyro, out.gyro)
    assert not np.array_equal(noisier_window(recording, (2.0, 38.0), 3.0, *densities, rng).gyro, out.gyro)


def test_a_wrong_angle_turns_the_end_attitude_about_the_axis_of_its_leg():
    # Sequence 13 turns 180° about IMU z, then 180° about IMU y: the error of its second leg is one about y.
    plain = draw()
    legs = [leg.copy() for leg in plain.legs]
    wrong = wrong_angle(plain, 1, 1, 0.01)
    for leg, kept in zip(plain.legs, legs, strict=True):
        np.testing.assert_array_equal(leg, kept)
    motions = [
        run(Rotation.identity(), replace(d, mounting=np.zeros(3), non_orthogonality=0.0), earth_rate=False)
        for d in (plain, wrong)
    ]
    np.testing.assert_array_equal(motions[1].attitudes[[0, 2]], motions[0].attitudes[[0, 2]])
    np.testing.assert_array_equal(motions[1].attitudes[1, 0], motions[0].attitudes[1, 0])
    relative = Rotation.from_matrix(motions[0].attitudes[1, 1].T @ motions[1].attitudes[1, 1]).as_rotvec()
    # The outer axis is y of the body at the inner angle zero; here it is 180° and what was executed wrongly.
    inner = math.pi + plain.starts[1, 0] + plain.legs[1][0]
    expected = 0.01 * np.array([math.sin(inner), math.cos(inner), 0.0])
    np.testing.assert_allclose(relative, expected, rtol=0.0, atol=1e-14)
    sums = [m.angle[m.piece_starts[1] : m.piece_starts[2]].sum(axis=0) for m in motions]
    np.testing.assert_allclose(sums[1] - sums[0], expected, rtol=0.0, atol=1e-12)


EARTH_NED = EARTH_RATE_RAD_S * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])
FORCE_NED = np.array([0.0, 0.0, -SITE.gravity_m_s2])
INTEGRALS = ("angle", "angle_abs", "velocity", "velocity_abs")


def sample_at(motion, time_s):
    """Give the sample whose interval holds a time that is not on an edge."""
    return int(np.flatnonzero((motion.time - motion.interval < time_s) & (time_s < motion.time))[0])


# In the second piece's start window, turn (at full rate and in a ramp) and end window, and in turns of the others.
TIMES = {
    "start window": MOTION.windows[1][0][0] + 0.51,
    "turn": MOTION.windows[1][0][1] + 1.03,
    "ramp": MOTION.windows[1][0][1] + 0.05,
    "end window": MOTION.windows[1][1][0] + 0.51,
    "first piece": MOTION.windows[0][0][1] + 1.03,
    "last piece": MOTION.windows[2][0][1] + 5.03,
}


@pytest.mark.parametrize("time_s", TIMES.values(), ids=TIMES)
@pytest.mark.parametrize("size", [1e-6, 1.0, 100.0])
def test_after_a_tilt_step_the_run_is_that_of_a_body_mounted_otherwise(time_s, size):
    vector = size * TILT
    before = snapshot(MOTION)
    stepped = tilt_step(MOTION, time_s, vector)
    assert untouched(MOTION, before)
    # A body turned by v in its mount: U becomes Exp(-v) U, for the whole of the run.
    mounted = run(Rotation.from_rotvec(-vector) * U)

    k = sample_at(MOTION, time_s)
    stop = min([s for s in MOTION.piece_starts if s > k] + [len(MOTION.time)])
    after = np.zeros(len(MOTION.time), dtype=bool)
    after[k + 1 : stop] = True
    assert after.sum() > 10
    same = ~after
    same[k] = False
    for name in INTEGRALS:
        np.testing.assert_array_equal(getattr(stepped, name)[same], getattr(MOTION, name)[same])
    for name in ("angle", "velocity"):
        new, reference = getattr(stepped, name)[after], getattr(mounted, name)[after]
        np.testing.assert_allclose(new, reference, rtol=0.0, atol=2e-15)
        absolute, exact = getattr(stepped, f"{name}_abs")[after], getattr(mounted, f"{name}_abs")[after]
        crossing = getattr(MOTION, f"{name}_abs")[after] - np.abs(getattr(MOTION, name)[after]) > 1e-15
        crossing |= exact - np.abs(reference) > 1e-15
        assert not crossing.all()
        np.testing.assert_allclose(absolute[~crossing], exact[~crossing], rtol=0.0, atol=2e-15)
        bound = 2.0 * np.linalg.norm(vector) * getattr(MOTION, f"{name}_abs")[after].sum(axis=1)
        assert np.all(np.abs(absolute - exact) <= bound[:, np.newaxis] + 2e-15)

    ends = np.array(MOTION.windows)[:, :, 1]
    moved = (ends > time_s) & (ends < MOTION.time[stop - 1] + 1e-9)
    np.testing.assert_allclose(stepped.attitudes[moved], mounted.attitudes[moved], rtol=0.0, atol=2e-15)
    np.testing.assert_array_equal(stepped.attitudes[~moved], MOTION.attitudes[~moved])


def test_the_sample_of_the_step_turns_at_a_constant_rate():
    vector = 100.0 * TILT
    k = sample_at(MOTION, TIMES["end window"])
    stepped = tilt_step(MOTION, TIMES["end window"], vector)
    # By the midpoint rule on the still body's path: Earth rate and force seen from frames between start and end.
    parts = 4000
    path = Rotation.from_rotvec(np.outer((np.arange(parts) + 0.5) / parts, vector))
    ned_from_body = MOTION.attitudes[1, 1]
    angle = vector + path.apply(EARTH_NED @ ned_from_body, inverse=True).mean(axis=0) * MOTION.interval
    velocity = path.apply(FORCE_NED @ ned_from_body, inverse=True).mean(axis=0) * MOTION.interval
    np.testing.assert_allclose(stepped.angle[k], angle, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(stepped.velocity[k], velocity, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(stepped.angle_abs[k], np.abs(angle), rtol=0.0, atol=1e-10)
