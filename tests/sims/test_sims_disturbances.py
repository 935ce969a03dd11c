"""Disturbances of a simulated test, each against the same disturbance made in another way."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import sims
from sims.physics.disturbances import accel_bias_step, lose_samples, noisier_window, tilt_step, wrong_angle
from srt.constants import EARTH_RATE_RAD_S
from srt.exceptions import InputError
from srt.recording.recording import Recording, Site
from srt.sensor_errors import SensorErrors

LATITUDE = math.radians(45.0)
SITE = Site(9.80665, 5e-6, LATITUDE)
EARTH_NED = EARTH_RATE_RAD_S * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])
FORCE_NED = np.array([0.0, 0.0, -SITE.gravity_m_s2])
IDS = ("7", "13", "6")
NONE = SensorErrors()
TILT = np.array([1e-3, -2e-3, 0.5e-3])
U = Rotation.from_rotvec([0.2, -0.1, 0.3])
INTEGRALS = ("angle", "angle_abs", "velocity", "velocity_abs")


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


def sample_at(motion, time_s):
    """Give the sample whose interval holds a time that is not on an edge."""
    return int(np.flatnonzero((motion.time - motion.interval < time_s) & (time_s < motion.time))[0])


def untouched(motion, before):
    return all(np.array_equal(getattr(motion, name), array) for name, array in before.items())


def snapshot(thing):
    return {
        f.name: np.array(value)
        for f in fields(thing)
        if isinstance(value := getattr(thing, f.name), np.ndarray) and not f.name.startswith("_")
    }


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


def integrated(motion, rows, attitude, earth_rate=True):
    """C_NED,B at the end of each sample, from the gyro integrals alone; each sample is one rotation."""
    steps = Rotation.from_rotvec(motion.angle[rows])
    now = Rotation.from_matrix(attitude)
    out = []
    for number, step in enumerate(steps, start=1):
        now = now * step
        earth = Rotation.from_rotvec(-EARTH_NED * number * motion.interval * earth_rate)
        out.append((earth * now).as_matrix())
    return np.array(out)


def angle_between(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


@pytest.mark.parametrize("where", ["start window", "end window"])
def test_gyros_and_accelerometers_agree_after_a_step_in_a_window(where):
    time_s = TIMES[where]
    stepped = tilt_step(MOTION, time_s, TILT)
    number = 0 if where == "start window" else 1
    begin, end = MOTION.windows[1][number]
    rows = np.flatnonzero((MOTION.time > begin + 0.01) & (MOTION.time < end + 0.01))
    attitude = integrated(stepped, rows, MOTION.attitudes[1, number])  # at rest: at the begin as at the end
    k = sample_at(MOTION, time_s) - rows[0]
    turned = MOTION.attitudes[1, number] @ Rotation.from_rotvec(TILT).as_matrix()
    np.testing.assert_allclose(attitude[:k], np.broadcast_to(MOTION.attitudes[1, number], (k, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(attitude[k:], np.broadcast_to(turned, (len(rows) - k, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(stepped.attitudes[1, number], turned, atol=1e-15)

    force = stepped.velocity[rows] / MOTION.interval
    np.testing.assert_allclose(force[k + 1 :], np.tile(FORCE_NED @ turned, (len(rows) - k - 1, 1)), atol=1e-13)
    rate = stepped.angle[rows] / MOTION.interval
    np.testing.assert_allclose(rate[k + 1 :], np.tile(EARTH_NED @ turned, (len(rows) - k - 1, 1)), atol=1e-15)
    seen = np.einsum("nij,nj->ni", attitude, force)
    assert angle_between(seen, FORCE_NED)[np.arange(len(rows)) != k].max() < 1e-9


def test_gyros_and_accelerometers_agree_after_a_step_in_a_turn():
    # Fast samples: one rotation vector for the turn a and the step v of a sample is wrong by about a²v/12 = 1e-10 rad.
    motion = run(sequences=("11",), fixture_draw=sims.FixtureDraw(), sample_rate_hz=1000.0, earth_rate=False)
    (_, begin), (still, _) = motion.windows[0]
    time_s = begin + 1.2345
    stepped = tilt_step(motion, time_s, TILT)
    rows = motion.time > begin + 0.5e-3
    attitude = integrated(stepped, rows, motion.attitudes[0, 0], earth_rate=False)
    np.testing.assert_allclose(attitude[-1], stepped.attitudes[0, 1], rtol=0.0, atol=1e-9)
    expected = motion.attitudes[0, 1] @ Rotation.from_rotvec(TILT).as_matrix()
    np.testing.assert_allclose(stepped.attitudes[0, 1], expected, rtol=0.0, atol=1e-15)
    at_rest = motion.time[rows] > still + 0.5e-3
    seen = np.einsum("nij,nj->ni", attitude[at_rest], stepped.velocity[rows][at_rest])
    assert angle_between(seen, FORCE_NED).max() < 1e-9


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


@pytest.mark.parametrize("time_s", [2.05, 3.03], ids=["ramp", "full rate"])
def test_in_a_turn_the_sample_of_the_step_is_wrong_by_the_bound_stated(time_s):
    one = {"sequences": ("12",), "fixture_draw": sims.FixtureDraw(), "dwell_s": 2.0}
    coarse, fine = run(**one), run(**one, sample_rate_hz=10000.0)
    k = sample_at(coarse, time_s)
    stepped = tilt_step(coarse, time_s, TILT)
    parts = slice(200 * k, 200 * (k + 1))
    path = Rotation.from_rotvec(np.outer((np.arange(200) + 0.5) / 200, TILT))
    for name, added in (("angle", TILT), ("velocity", 0.0)):
        samples = getattr(fine, name)[parts]
        expected = path.apply(samples, inverse=True).sum(axis=0) + added
        change = 200.0 * np.linalg.norm(samples[-1] - samples[0])  # δ·dt
        bound = np.linalg.norm(TILT) * change / 12.0
        off = np.linalg.norm(getattr(stepped, name)[k] - expected)
        assert off <= 1.05 * bound + 2e-12  # what curves within the sample, and the midpoint rule's own error
        assert name == "angle" or off > 1e-3 * bound


def test_a_step_on_a_samples_edge_falls_into_the_sample_that_begins_there():
    begin, end = MOTION.windows[1][0]
    for edge in (begin, end, float(MOTION.time[sample_at(MOTION, begin + 0.51)])):
        for rounding in (-1e-12, 0.0, 1e-12):
            changed = np.flatnonzero(np.any(tilt_step(MOTION, edge + rounding, TILT).angle != MOTION.angle, axis=1))
            assert changed[0] == sample_at(MOTION, edge + 0.5 * MOTION.interval)
    # A step as the start window ends is one of the turn: the attitude at the window's end is the old one.
    stepped = tilt_step(MOTION, end, TILT)
    np.testing.assert_array_equal(stepped.attitudes[1, 0], MOTION.attitudes[1, 0])
    assert np.abs(stepped.attitudes[1, 1] - MOTION.attitudes[1, 1]).max() > 5e-4


def test_a_step_in_the_last_sample_of_a_piece_turns_that_sample_only():
    stop = int(MOTION.piece_starts[1])
    stepped = tilt_step(MOTION, float(MOTION.time[stop - 1]) - 0.5 * MOTION.interval, TILT)
    changed = np.flatnonzero(np.any(stepped.angle != MOTION.angle, axis=1))
    np.testing.assert_array_equal(changed, [stop - 1])
    np.testing.assert_allclose(
        stepped.attitudes[0, 1], MOTION.attitudes[0, 1] @ Rotation.from_rotvec(TILT).as_matrix(), atol=1e-15
    )


def test_with_recorded_moves_a_step_stays_to_the_end_of_the_run():
    motion = run(moves="recorded")
    mounted = run(Rotation.from_rotvec(-TILT) * U, moves="recorded")
    time_s = motion.windows[0][1][0] + 0.51
    stepped = tilt_step(motion, time_s, TILT)
    k = sample_at(motion, time_s)
    np.testing.assert_allclose(stepped.angle[k + 1 :], mounted.angle[k + 1 :], rtol=0.0, atol=2e-15)
    np.testing.assert_allclose(stepped.attitudes[1:], mounted.attitudes[1:], rtol=0.0, atol=2e-15)
    np.testing.assert_array_equal(stepped.attitudes[0, 0], motion.attitudes[0, 0])


def test_a_step_between_free_turns():
    rng = np.random.default_rng(8)
    turns, start = sims.random_turns(rng, 3), Rotation.from_matrix(sims.random_attitude(rng))
    motion = sims.free_motion(turns, site=SITE, attitude=start.as_matrix(), dwell_s=1.0, sample_rate_hz=50.0)
    stepped = tilt_step(motion, 0.51, TILT)
    # In the axes of the turned body, the same turns have other components.
    tilt = Rotation.from_rotvec(TILT)
    other = sims.free_motion(
        tilt.apply(turns, inverse=True),
        site=SITE,
        attitude=(start * tilt).as_matrix(),
        dwell_s=1.0,
        sample_rate_hz=50.0,
    )
    k = sample_at(motion, 0.51)
    for name in ("angle", "velocity"):
        np.testing.assert_allclose(getattr(stepped, name)[k + 1 :], getattr(other, name)[k + 1 :], rtol=0, atol=1e-14)
    np.testing.assert_allclose(stepped.attitudes, other.attitudes, rtol=0.0, atol=1e-14)


times = st.floats(0.0, float(MOTION.time[int(MOTION.piece_starts[1]) - 1]) - 1e-3)
small = st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3)


@given(times)
@settings(max_examples=30, deadline=None)
def test_a_step_of_zero_changes_nothing(time_s):
    stepped = tilt_step(MOTION, time_s, np.zeros(3))
    for name in (*INTEGRALS, "attitudes"):
        np.testing.assert_allclose(getattr(stepped, name), getattr(MOTION, name), rtol=0.0, atol=1e-16)


@given(times, times, small)
@settings(max_examples=30, deadline=None)
def test_opposite_steps_cancel_outside(one, other, vector):
    first, second = sorted((one, other))
    back = tilt_step(tilt_step(MOTION, first, vector), second, np.negative(vector))
    # A step at the edge of a sample is in the sample that begins there, whatever rounding makes of the edge.
    rounding = 1e-6 * MOTION.interval
    outside = (MOTION.time <= first + rounding) | (MOTION.time - MOTION.interval > second + rounding)
    for name in INTEGRALS:
        values, reference = getattr(back, name), getattr(MOTION, name)
        np.testing.assert_allclose(values[outside], reference[outside], rtol=0.0, atol=1e-15)
    for name in ("angle", "velocity"):
        assert np.all(getattr(back, f"{name}_abs") >= np.abs(getattr(back, name)) - 1e-15)
    ends = np.array(MOTION.windows)[:, :, 1]
    outside = (ends <= first) | (ends > second + MOTION.interval)
    np.testing.assert_allclose(back.attitudes[outside], MOTION.attitudes[outside], rtol=0.0, atol=1e-15)


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


def test_default_is_to_lose_gyro_samples_and_a_hash_of_other_samples_goes():
    recording = replace(RECORDING, data_sha256="0" * 64)
    out = lose_samples(recording, 0.2, 0.1)
    assert not np.array_equal(out.gyro, recording.gyro)
    np.testing.assert_array_equal(out.accel, recording.accel)
    assert out.data_sha256 is None
    assert (out.site, out.fixture, out.sequences, out.kind) == (SITE, recording.fixture, recording.sequences, "rate")


@given(st.integers(1, 150), st.integers(1, 40), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_losing_samples_of_straight_lines_or_twice_changes_nothing(first, count, seed):
    rng = np.random.default_rng(seed)
    # Stamps that scatter, as of a logger: the line is one in time, not in the sample's number.
    time = np.cumsum(rng.uniform(0.008, 0.012, 200))
    lines = rng.standard_normal((1, 3)) + rng.standard_normal((1, 3)) * time[:, np.newaxis]
    recording = Recording(time, lines, rng.standard_normal((200, 3)), SITE)
    half = 0.5 * recording.nominal_interval_s
    start, duration = time[first] - half - 1e-4, time[first + count - 1] - time[first] + 2e-4
    out = lose_samples(recording, start, duration, ("gyro", "accel"))
    np.testing.assert_allclose(out.gyro, lines, rtol=0.0, atol=1e-13)
    again = lose_samples(out, start, duration, ("gyro", "accel"))
    np.testing.assert_allclose(again.accel, out.accel, rtol=0.0, atol=1e-13)
    assert (out.accel != recording.accel).any(axis=1).sum() == count


def test_losing_for_no_time_changes_nothing():
    out = lose_samples(RECORDING, 0.5, 0.0)
    np.testing.assert_array_equal(out.gyro, RECORDING.gyro)


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


def test_a_bias_step_in_increments_goes_by_each_samples_own_interval():
    time = np.cumsum(np.random.default_rng(4).uniform(0.005, 0.015, 100))
    recording = Recording(time, np.zeros((100, 3)), np.zeros((100, 3)), SITE, "increment")
    out = accel_bias_step(recording, time[9] + 0.004, time[59] + 0.004, [1.0, 2.0, 3.0])
    summed = out.accel.sum(axis=0)
    first, last = np.flatnonzero(out.accel[:, 0])[[0, -1]]
    np.testing.assert_allclose(summed, (time[last] - time[first - 1]) * np.array([1.0, 2.0, 3.0]), rtol=1e-12)


@given(st.floats(0.0, 3.0), st.floats(0.1, 3.0), small)
@settings(max_examples=30, deadline=None)
def test_opposite_bias_steps_cancel(start, duration, step):
    out = accel_bias_step(RECORDING, start, start + duration, step)
    back = accel_bias_step(out, start, start + duration, np.negative(step))
    np.testing.assert_allclose(back.accel, RECORDING.accel, rtol=0.0, atol=4e-15)


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


def test_a_factor_of_one_or_no_noise_adds_nothing():
    one = noisier_window(RECORDING, MOTION.windows[0][0], 1.0, 1e-4, 1e-3, np.random.default_rng(1))
    no_gyro = noisier_window(RECORDING, MOTION.windows[0][0], 2.0, 0.0, 1e-3, np.random.default_rng(1))
    np.testing.assert_array_equal(one.gyro, RECORDING.gyro)
    np.testing.assert_array_equal(one.accel, RECORDING.accel)
    np.testing.assert_array_equal(no_gyro.gyro, RECORDING.gyro)
    assert not np.array_equal(no_gyro.accel, RECORDING.accel)


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


@given(st.integers(0, 2), st.floats(-0.1, 0.1), st.data())
@settings(max_examples=30, deadline=None)
def test_opposite_wrong_angles_cancel(sequence, error, data):
    plain = draw()
    leg = data.draw(st.integers(0, len(plain.legs[sequence]) - 1))
    wrong = wrong_angle(plain, sequence, leg, error)
    assert sum(int(np.sum(a != b)) for a, b in zip(plain.legs, wrong.legs, strict=True)) <= 1
    assert wrong.legs[sequence][leg] - plain.legs[sequence][leg] == pytest.approx(error, abs=1e-17)
    back = wrong_angle(wrong, sequence, leg, -error)
    for a, b in zip(plain.legs, back.legs, strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-16)


GAP = 0.5 * (MOTION.windows[0][1][1] + MOTION.windows[1][0][0])
LAST = float(MOTION.time[-1])
RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("call", "fragments"),
    [
        (lambda: tilt_step(MOTION, -0.1, TILT), ["-0.1 s", "samples run from 0 "]),
        (lambda: tilt_step(MOTION, LAST, TILT), ["samples run from 0 "]),
        (lambda: tilt_step(MOTION, math.nan, TILT), ["nan"]),
        (lambda: tilt_step(MOTION, GAP, TILT), ["in a gap", "recorded piece"]),
        (lambda: tilt_step(MOTION, MOTION.windows[0][1][1], TILT), ["in a gap"]),
        (lambda: tilt_step(MOTION, 0.5, [1e-3, 0.0]), ["[0.001, 0.0]", "three finite numbers"]),
        (lambda: tilt_step(MOTION, 0.5, [1e-3, math.inf, 0.0]), ["inf", "three finite numbers"]),
        (lambda: lose_samples(RECORDING, 0.5, -0.1), ["-0.1 s", "zero or positive"]),
        (lambda: lose_samples(RECORDING, 0.5, math.nan), ["nan", "zero or positive"]),
        (lambda: lose_samples(RECORDING, -0.5, 0.1), ["[-0.5, -0.4]", "samples run from"]),
        (lambda: lose_samples(RECORDING, LAST - 0.1, 0.2), ["samples run from"]),
        (lambda: lose_samples(RECORDING, math.nan, 0.2), ["nan", "samples run from"]),
        (lambda: lose_samples(RECORDING, 0.5, 0.001), ["holds no sample"]),
        (lambda: lose_samples(RECORDING, GAP, 0.1), ["holds no sample"]),
        (lambda: lose_samples(RECORDING, 0.0, 0.1), ["no neighbour", "gapless piece"]),
        (lambda: lose_samples(RECORDING, LAST - 0.1, 0.1), ["no neighbour"]),
        (lambda: lose_samples(RECORDING, MOTION.windows[0][1][1] - 0.1, 0.1), ["no neighbour"]),
        (lambda: lose_samples(RECORDING, MOTION.windows[1][0][0], 0.1), ["no neighbour"]),
        (lambda: lose_samples(RECORDING, MOTION.windows[0][1][1] - 0.1, GAP), ["a gap between"]),
        (lambda: lose_samples(RECORDING, 0.5, 0.1, ()), ["sensors", "'gyro', 'accel'"]),
        (lambda: lose_samples(RECORDING, 0.5, 0.1, "gyro"), ["sensors", "'gyro', 'accel'"]),
        (lambda: accel_bias_step(RECORDING, 0.5, 0.5, TILT), ["end after it starts"]),
        (lambda: accel_bias_step(RECORDING, 0.5, math.nan, TILT), ["end after it starts"]),
        (lambda: accel_bias_step(RECORDING, 0.5, LAST + 1.0, TILT), ["samples run from"]),
        (lambda: accel_bias_step(RECORDING, GAP, GAP + 0.1, TILT), ["holds no sample"]),
        (lambda: accel_bias_step(RECORDING, 0.5, 0.6, 1e-3), ["three finite numbers"]),
        (lambda: noisier_window(RECORDING, (0.6, 0.5), 2.0, 1.0, 1.0, RNG), ["end after it starts"]),
        (lambda: noisier_window(RECORDING, (-1.0, 0.5), 2.0, 1.0, 1.0, RNG), ["samples run from"]),
        (lambda: noisier_window(RECORDING, (0.5, 0.6), 0.99, 1.0, 1.0, RNG), ["0.99", "at least 1"]),
        (lambda: noisier_window(RECORDING, (0.5, 0.6), math.inf, 1.0, 1.0, RNG), ["inf", "at least 1"]),
        (lambda: noisier_window(RECORDING, (0.5, 0.6), 2.0, -1.0, 1.0, RNG), ["gyro noise", "-1"]),
        (lambda: noisier_window(RECORDING, (0.5, 0.6), 2.0, 1.0, math.nan, RNG), ["accelerometer noise", "nan"]),
        (lambda: wrong_angle(sims.FixtureDraw(), 0, 0, 0.1), ["no errors of rotations", "draw_fixture"]),
        (lambda: wrong_angle(draw(), 3, 0, 0.1), ["no sequence 3", "for 3"]),
        (lambda: wrong_angle(draw(), -1, 0, 0.1), ["no sequence -1"]),
        (lambda: wrong_angle(draw(), 1, 2, 0.1), ["no rotation 2", "has 2"]),
        (lambda: wrong_angle(draw(), 1, -1, 0.1), ["no rotation -1"]),
        (lambda: wrong_angle(draw(), 1, 1, math.nan), ["nan", "finite"]),
    ],
)
def test_impossible_disturbances_are_refused_in_one_sentence(call, fragments):
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert all(fragment in message for fragment in fragments), message
    assert "\n" not in message
