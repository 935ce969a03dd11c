"""Tilt steps of a simulated test, each against the same step made in another way."""

import math

import numpy as np
import pytest
from disturbed_runs import LATITUDE, MOTION, SITE, TILT, U, run, small, snapshot, untouched
from hypothesis import given, settings
from hypothesis import strategies as st
from injected_faults.disturbances import tilt_step
from scipy.spatial.transform import Rotation

import sims
from srt.constants import EARTH_RATE_RAD_S

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
def test_the_sample_of_a_step_within_a_rotation_is_wrong_by_the_stated_bound(time_s):
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


def test_a_step_lasts_to_the_end_of_the_run_if_moves_are_recorded():
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
