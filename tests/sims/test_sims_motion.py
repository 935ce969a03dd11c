"""The simulator's motion: attitudes against hand-derived matrices, integrals against closed forms."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sims
from srt.constants import EARTH_RATE_RAD_S
from srt.exceptions import InputError
from srt.recording.recording import Site

LATITUDE = math.radians(45.0)
SITE = Site(9.80665, 5e-6, LATITUDE)
EARTH_NED = EARTH_RATE_RAD_S * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])
X, Y, Z = np.eye(3)

# By hand from Table 1: IMU axis down and along the outer axis (here east) at the start and at the end.
POSES = {
    "1": (Z, Y, Z, Y), "2": (Z, X, Z, X), "3": (X, Y, X, Y),
    "1a": (Z, Y, Z, Y), "2a": (Z, X, Z, X), "3a": (X, Y, X, Y),
    "4": (Z, Y, Z, Y), "5": (Z, X, Z, X), "6": (X, Y, X, Y),
    "7": (Y, X, -Y, X), "8": (Z, X, -Z, X), "9": (X, Y, -X, -Y),
    "10": (Y, X, -Y, -X), "11": (Z, Y, -Z, Y), "12": (X, Y, -X, Y),
    "13": (Z, Y, -Z, -Y), "14": (Z, X, -Z, -X),
}  # fmt: skip

# Table 1 once more, typed independently of the simulator's copy: (axis, degrees).
TURNS = {
    "1": [("y", 360)], "2": [("x", 360)], "3": [("z", 360)],
    "1a": [("y", -360)], "2a": [("x", -360)], "3a": [("z", -360)],
    "4": [("y", 180), ("z", 180)] * 2,
    "5": [("x", 180), ("z", 180)] * 2,
    "6": [("y", 180), ("z", 90), ("x", 180), ("z", 90)] * 2,
    "7": [("x", 180)], "8": [("x", 180)], "9": [("z", 180)], "10": [("z", 180)],
    "11": [("y", 180)], "12": [("y", 180)],
    "13": [("z", 180), ("y", 180)], "14": [("z", 180), ("x", 180)],
}  # fmt: skip


def imperfect(rng, ids, size=1e-3, wobble=0.0):
    sequences = sims.table_sequences(ids)
    return sims.draw_fixture(
        rng,
        sequences,
        level_sigma_rad=size,
        north_sigma_rad=size,
        mounting_sigma_rad=size,
        non_orthogonality_sigma_rad=size,
        rotation_sigma_rad=size,
        wobble_sigma_rad=wobble,
    )


def rows_in(motion, start_s, end_s):
    half = 0.5 * motion.interval
    return (motion.time > start_s + half) & (motion.time <= end_s + half)


def total(values):
    return np.array([math.fsum(column) for column in values.T])


@pytest.mark.parametrize("name", sims.TABLE_1)
def test_poses_of_every_sequence(name):
    motion = sims.table1_motion(site=SITE, sequences=(name,), sample_rate_hz=50.0, dwell_s=1.0)
    down0, outer0, down1, outer1 = POSES[name]
    for attitude, down, outer in zip(motion.attitudes[0], (down0, down1), (outer0, outer1), strict=True):
        expected = np.stack([np.cross(outer, down), outer, down])  # rows north, east, down in B
        np.testing.assert_allclose(attitude, expected, atol=3e-15)


# By hand from R_y(outer) R_z(inner): inner and outer angle in quarter turns, IMU axis down and along the outer axis.
STARTS = {
    ("z", "y"): (0, 0, Z, Y), ("-x", "y"): (0, 1, -X, Y), ("-z", "y"): (0, 2, -Z, Y), ("x", "y"): (0, -1, X, Y),
    ("z", "x"): (1, 0, Z, X), ("y", "x"): (1, 1, Y, X), ("-z", "x"): (1, 2, -Z, X), ("-y", "x"): (1, -1, -Y, X),
    ("z", "-y"): (2, 0, Z, -Y), ("x", "-y"): (2, 1, X, -Y), ("-z", "-y"): (2, 2, -Z, -Y), ("-x", "-y"): (2, -1, -X, -Y),
    ("z", "-x"): (-1, 0, Z, -X), ("-y", "-x"): (-1, 1, -Y, -X), ("-z", "-x"): (-1, 2, -Z, -X),
    ("y", "-x"): (-1, -1, Y, -X),
}  # fmt: skip


@pytest.mark.parametrize("start", STARTS, ids="/".join)
def test_every_start_attitude(start):
    """The named axes point where they should, and each turn is about its IMU axis in its own sense."""
    along = start[1].removeprefix("-")
    turns = ((along, 90.0), ("z", 180.0), (along, -180.0), ("z", 40.0))
    sequence = sims.TurnSequence("A", *start, turns)
    inner, outer, down_axis, outer_axis = STARTS[start]
    assert sequence.start_rad() == (0.5 * math.pi * inner, 0.5 * math.pi * outer)
    schedule = sims.Schedule((sequence,), dwell_s=1.0, leg_dwell_s=1.0)
    motion = sims.run_schedule(schedule, site=SITE, sample_rate_hz=100.0, earth_rate=False)
    expected = np.stack([np.cross(outer_axis, down_axis), outer_axis, down_axis])  # rows north, east, down in B
    np.testing.assert_allclose(motion.attitudes[0, 0], expected, atol=3e-15)
    begin = 1.0
    for axis, degrees in turns:
        end = begin + schedule.profile.duration_s(math.radians(degrees))
        turned = total(motion.angle[rows_in(motion, begin - 0.5, end + 0.5)])
        np.testing.assert_allclose(turned, np.radians(degrees) * np.eye(3)["xyz".index(axis)], atol=2e-14)
        begin = end + 1.0


@pytest.mark.parametrize("name", sims.TABLE_1)
def test_each_rotation_is_about_the_imu_axis_named(name):
    schedule = sims.Schedule(sims.table_sequences((name,)), dwell_s=1.0, leg_dwell_s=1.0)
    motion = sims.run_schedule(schedule, site=SITE, sample_rate_hz=100.0, earth_rate=False)
    begin = 1.0
    for axis, degrees in TURNS[name]:
        end = begin + schedule.profile.duration_s(math.radians(degrees))
        rows = rows_in(motion, begin - 0.5, end + 0.5)
        expected = np.zeros(3)
        expected["xyz".index(axis)] = math.radians(degrees)
        np.testing.assert_allclose(total(motion.angle[rows]), expected, atol=2e-14)
        np.testing.assert_allclose(total(motion.angle_abs[rows]), np.abs(expected), atol=2e-14)
        begin = end + 1.0


def test_attitudes_with_all_fixture_errors():
    rng = np.random.default_rng(10)
    ids = ("7", "13", "6")
    draw, U, heading = imperfect(rng, ids, 0.05, 0.02), sims.rotation(rng.standard_normal(3)), 0.7
    motion = sims.table1_motion(
        site=SITE,
        sequences=ids,
        sample_rate_hz=50.0,
        dwell_s=1.0,
        fixture_draw=draw,
        U=U,
        heading_rad=heading,
    )
    base = Rotation.from_euler("z", heading) * Rotation.from_rotvec(draw.base)
    # Fixture angles at start and end in quarter turns, and which axis each rotation turned.
    nominal = {"7": ((1, 1), (1, 3)), "13": ((0, 0), (2, -2)), "6": ((0, -1), (4, -1))}
    axes = {"7": [1], "13": [0, 1], "6": [1, 0, 1, 0] * 2}
    for number, name in enumerate(ids):
        for end in (0, 1):
            inner, outer = (0.5 * math.pi * q for q in nominal[name][end])
            error = draw.starts[number].copy()
            if end:
                np.add.at(error, axes[name], draw.legs[number])
            expected = (
                base
                * Rotation.from_euler("y", outer + error[1])
                * Rotation.from_euler("x", draw.non_orthogonality + draw.wobble[number, end])
                * Rotation.from_euler("z", inner + error[0])
                * Rotation.from_rotvec(draw.mounting)
            ).as_matrix() @ U.T
            np.testing.assert_allclose(motion.attitudes[number, end], expected, atol=5e-15)


@pytest.mark.parametrize("moves", ["skipped", "recorded"])
def test_still_windows_sense_the_earth_and_gravity(moves):
    ids = ("1", "12", "9", "14")
    draw = imperfect(np.random.default_rng(11), ids, wobble=1e-3)
    motion = sims.table1_motion(
        site=SITE,
        sequences=ids,
        sample_rate_hz=50.0,
        dwell_s=2.0,
        fixture_draw=draw,
        heading_rad=1.0,
        moves=moves,
    )
    for windows, attitudes in zip(motion.windows, motion.attitudes, strict=True):
        for (start, end), ned_from_body in zip(windows, attitudes, strict=True):
            rows = rows_in(motion, start, end)
            assert rows.sum() == 100
            np.testing.assert_allclose(total(motion.angle[rows]), 2.0 * EARTH_NED @ ned_from_body, atol=1e-17)
            force = np.array([0.0, 0.0, -SITE.gravity_m_s2]) @ ned_from_body
            np.testing.assert_allclose(total(motion.velocity[rows]), 2.0 * force, atol=2e-13)
            np.testing.assert_array_equal(motion.angle_abs[rows], np.abs(motion.angle[rows]))
            np.testing.assert_array_equal(motion.velocity_abs[rows], np.abs(motion.velocity[rows]))


@pytest.mark.parametrize("moves", ["skipped", "recorded"])
def test_increments_compose_to_the_attitudes(moves):
    # One axis turns at a time, so each increment is a rotation about an axis fixed in B, but for the wobble.
    ids = ("6", "13", "4")
    wobble = 0.002
    draw = imperfect(np.random.default_rng(12), ids, 0.02, wobble)
    U = sims.rotation([0.3, -0.2, 0.5])
    motion = sims.table1_motion(
        site=SITE, sequences=ids, sample_rate_hz=200.0, dwell_s=0.5, fixture_draw=draw, U=U, earth_rate=False,
        moves=moves,
    )  # fmt: skip
    # A sample that holds the end of one rotation and the start of the next loses their order: an error of
    # the product of the two angles, ramps of 10 rad/s² over 5 ms at most. While an axis turns at 1 rad/s, the axis of
    # the wobble turns in B, of which a sample loses ω ε̇ dt³ / 6 at most: ω ε̇ dt² / 6 of a second, and 30 s turn.
    half = (0.5 * 10.0 * 0.005**2) ** 2
    bound = 14 * half + 30.0 * (4.0 * wobble / 1.5) * 0.005**2 / 6.0
    edges = [(begin, end) for pair in motion.windows for _, begin in pair[:1] for end, _ in pair[1:]]
    if moves == "recorded":
        assert len(motion.piece_starts) == 1
        edges += [(before[1][1], after[0][0]) for before, after in pairwise(motion.windows)]
        attitudes = [*motion.attitudes, *zip(motion.attitudes[:-1, 1], motion.attitudes[1:, 0], strict=True)]
    else:
        attitudes = list(motion.attitudes)
    for (begin, end), (start, expected) in zip(edges, attitudes, strict=True):
        turned = start
        for step in Rotation.from_rotvec(motion.angle[rows_in(motion, begin, end)]).as_matrix():
            turned = turned @ step
        np.testing.assert_allclose(turned, expected, atol=bound + 3e-14)


def test_wobble_changes_with_the_motion_only():
    draw = sims.FixtureDraw(wobble=np.array([[1e-3, -2e-3], [3e-3, 4e-3]]))
    # From the end of 1 to the start of 1a nothing moves: without a motion the wobble stays.
    still = sims.table1_motion(site=SITE, sequences=("1", "1a"), dwell_s=1.0, moves="recorded", fixture_draw=draw)
    np.testing.assert_allclose(still.attitudes[1, 0], still.attitudes[0, 1], atol=1e-12)
    gap = sims.table1_motion(site=SITE, sequences=("1", "1a"), dwell_s=1.0, fixture_draw=draw)
    lean = Rotation.from_matrix(gap.attitudes[0, 1].T @ gap.attitudes[1, 0]).as_rotvec()
    np.testing.assert_allclose(lean, [5e-3, 0.0, 0.0], atol=1e-12)


def test_single_rotation_with_errors_composes_exactly():
    draw = imperfect(np.random.default_rng(13), ("11",), 0.05)
    motion = sims.table1_motion(
        site=SITE, sequences=("11",), sample_rate_hz=50.0, dwell_s=0.5, fixture_draw=draw, earth_rate=False
    )
    turned = motion.attitudes[0, 0]
    for step in Rotation.from_rotvec(motion.angle).as_matrix():
        turned = turned @ step
    np.testing.assert_allclose(turned, motion.attitudes[0, 1], atol=3e-14)


def test_rotation_adds_the_turning_earth():
    # Sequence 3 turns about z, which points south (x down, heading 0): the Earth adds -T cos(latitude).
    motion = sims.table1_motion(site=SITE, sequences=("3",), sample_rate_hz=100.0, dwell_s=1.0)
    duration = len(motion.time) * motion.interval
    expected = 2.0 * math.pi - duration * EARTH_NED[0]
    assert total(motion.angle)[2] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_sums_do_not_depend_on_the_sample_rate(rate):
    draw = imperfect(np.random.default_rng(14), ("6",))
    motions = [
        sims.table1_motion(
            site=SITE, sequences=("6",), rate_rad_s=rate, sample_rate_hz=hz, dwell_s=2.0, fixture_draw=draw
        )
        for hz in (50.0, 1000.0)
    ]
    for field in ("angle", "angle_abs", "velocity", "velocity_abs"):
        sums = [total(getattr(m, field)[rows_in(m, 0.0, 10.0)]) for m in motions]
        np.testing.assert_allclose(sums[0], sums[1], rtol=1e-14, atol=1e-14)
    fine = motions[1].angle[: 20 * (len(motions[1].time) // 20)].reshape(-1, 20, 3).sum(axis=1)
    n = min(len(fine), len(motions[0].time))
    np.testing.assert_allclose(motions[0].angle[:n], fine[:n], atol=5e-16)


def test_absolute_values_against_the_closed_form():
    # Sequence 1 on a perfect fixture: f = (g sin θ, 0, -g cos θ), θ = rate * (t - corner) + θ at the corner.
    g, rate, acceleration, hz = SITE.gravity_m_s2, 1.0, 10.0, 50.0
    motion = sims.table1_motion(site=SITE, sequences=("1",), sample_rate_hz=hz, dwell_s=1.0, earth_rate=False)
    corner, plateau = 0.1, 2.0 * math.pi - 0.1
    number = np.arange(6, 300)  # samples well inside the plateau, counted from the start of the rotation
    ends = np.stack([number, number + 1]) / hz - corner
    assert ends.max() < plateau
    theta = 0.5 * acceleration * corner**2 + rate * ends

    def integral_of_abs_sin(angle):
        full = np.floor(angle / math.pi)
        return 2.0 * full + 1.0 - np.cos(angle - full * math.pi)

    rows = 50 + number
    expected_x = g / rate * np.diff(integral_of_abs_sin(theta), axis=0)[0]
    expected_z = g / rate * np.diff(integral_of_abs_sin(theta + 0.5 * math.pi), axis=0)[0]
    # Differences of numbers near 10 are good to 2e-15 only.
    np.testing.assert_allclose(motion.velocity_abs[rows, 0], expected_x, atol=2e-14)
    np.testing.assert_allclose(motion.velocity_abs[rows, 2], expected_z, atol=2e-14)
    crossing = np.abs(motion.velocity[rows, 0]) < motion.velocity_abs[rows, 0] - 1e-12
    assert crossing.sum() == 1  # sin changes sign once inside these samples


def test_quadrature_is_at_its_limit(monkeypatch):
    draw = imperfect(np.random.default_rng(15), ("13",))
    ringing = sims.RateProfile(2.0, 5.0, settling_rad=1e-3, settling_hz=10.0, settling_decay_s=0.05)
    schedule = sims.Schedule(sims.table_sequences(("13",)), ringing, dwell_s=2.0)

    def run():
        return sims.run_schedule(schedule, site=SITE, sample_rate_hz=50.0, fixture_draw=draw)

    coarse = run()
    monkeypatch.setattr("sims.physics.integrals._MAX_PHASE", 0.03)
    monkeypatch.setattr("sims.physics.integrals.node_count", lambda _: 12)
    fine = run()
    np.testing.assert_allclose(coarse.angle, fine.angle, atol=2e-15)
    np.testing.assert_allclose(coarse.velocity, fine.velocity, atol=2e-15)
    np.testing.assert_allclose(coarse.angle_abs, fine.angle_abs, atol=1e-14)
    np.testing.assert_allclose(coarse.velocity_abs, fine.velocity_abs, atol=1e-14)


def test_ringing_reaches_into_the_window_unless_it_settles():
    ringing = sims.RateProfile(1.0, 10.0, settling_rad=1e-3, settling_hz=5.0, settling_decay_s=0.1)
    spread = []
    for settle_s in (0.0, 4.0):
        schedule = sims.Schedule(sims.table_sequences(("8", "9")), ringing, dwell_s=1.0, settle_s=settle_s)
        motion = sims.run_schedule(schedule, site=SITE, sample_rate_hz=100.0)
        windows = [window for pair in motion.windows for window in pair][1:]
        spread.append([np.ptp(motion.angle[rows_in(motion, *w)], axis=0).max() for w in windows])
    assert min(spread[0]) > 1e-4  # also after the move to sequence 9, which is not recorded
    assert max(spread[1]) == 0.0


def test_time_stamps_windows_and_gaps():
    motion = sims.table1_motion(site=SITE, sequences=("1", "2", "3"), sample_rate_hz=100.0, dwell_s=1.0)
    steps = np.diff(motion.time)
    gaps = np.flatnonzero(steps > 0.011) + 1
    np.testing.assert_array_equal(motion.piece_starts, [0, *gaps])
    assert len(gaps) == 2
    assert motion.time[0] == 0.01
    assert motion.windows[0] == ((0.0, 1.0), (7.39, 8.39))  # 2π s + 0.1 s of ramps, to the next sample edge
    # The move to sequence 2 goes the shorter way: 90 degrees about inner, none of the 360 about outer.
    assert motion.windows[1][0][0] == 8.39 + 1.0 + 1.68
    continuous = sims.table1_motion(
        site=SITE, sequences=("1", "2", "3"), sample_rate_hz=100.0, dwell_s=1.0, moves="recorded"
    )
    assert continuous.windows == motion.windows
    assert np.diff(continuous.time).max() < 0.011
    recorded = np.isin(np.round(continuous.time * 100), np.round(motion.time * 100))
    np.testing.assert_allclose(continuous.angle[recorded], motion.angle, atol=1e-15)


@pytest.mark.parametrize("moves", ["skipped", "recorded"])
def test_dwells_of_each_window(moves):
    """To the sample, in labels and in data; equal ones are the same run as one dwell for all."""
    dwells = ((1.0, 2.0), (0.5, 0.5), (3.0, 0.004))
    sequences = sims.table_sequences(("1", "8", "9"))
    schedule = sims.Schedule(sequences, dwell_s=7.0, moves=moves, dwells_s=dwells)
    motion = sims.run_schedule(schedule, site=SITE, sample_rate_hz=100.0)
    for label, windows, lengths in zip(motion.labels, motion.windows, dwells, strict=True):
        assert (label.start_static_s, label.end_static_s) == windows
        for window, length in zip(windows, lengths, strict=True):
            rows = np.flatnonzero(rows_in(motion, *window))
            assert len(rows) == max(1, round(length * 100.0))  # a window holds one sample at least
            assert motion.time[rows[-1]] == window[1]
            assert np.ptp(motion.angle[rows], axis=0).max() == 0.0
    # Sequence 1 takes 2π s + 0.1 s of ramps, to the next sample edge; nothing else lies between its windows.
    assert motion.windows[0] == ((0.0, 1.0), (7.39, 9.39))
    alike = [
        sims.run_schedule(s, site=SITE, sample_rate_hz=100.0)
        for s in (
            sims.Schedule(sequences, dwell_s=1.0, moves=moves),
            sims.Schedule(sequences, moves=moves, dwells_s=((1.0, 1.0),) * 3),
        )
    ]
    assert alike[0].windows == alike[1].windows
    np.testing.assert_array_equal(alike[0].angle, alike[1].angle)


def test_free_turns_compose_to_the_attitudes():
    rng = np.random.default_rng(16)
    turns = sims.random_turns(rng, 5)
    sizes = np.linalg.norm(turns, axis=1)
    assert math.pi / 3 <= sizes.min() <= sizes.max() <= math.pi
    start = sims.random_attitude(rng)
    np.testing.assert_allclose(start @ start.T, np.eye(3), atol=1e-15)
    motion = sims.free_motion(turns, site=SITE, attitude=start, sample_rate_hz=50.0, dwell_s=1.0, earth_rate=False)
    assert motion.fixture is None
    assert motion.labels == ()
    turned = start
    for step in Rotation.from_rotvec(motion.angle).as_matrix():
        turned = turned @ step
    np.testing.assert_allclose(turned, motion.attitudes[-1, 1], atol=3e-14)
    for number, turn in enumerate(turns):
        before, after = motion.attitudes[number]
        np.testing.assert_allclose(Rotation.from_matrix(before.T @ after).as_rotvec(), turn, atol=1e-14)
        rows = rows_in(motion, motion.windows[number][0][1], motion.windows[number][1][0])
        np.testing.assert_allclose(total(motion.angle[rows]), turn, atol=1e-14)
        peak = np.linalg.norm(motion.angle[rows], axis=1).max() / motion.interval
        assert 1.9 < peak <= 2.0


def test_free_poses_sense_the_earth_and_gravity():
    rng = np.random.default_rng(17)
    motion = sims.free_motion(sims.random_turns(rng, 3), site=SITE, sample_rate_hz=50.0, dwell_s=1.0)
    for windows, attitudes in zip(motion.windows, motion.attitudes, strict=True):
        for window, ned_from_body in zip(windows, attitudes, strict=True):
            rows = rows_in(motion, *window)
            np.testing.assert_allclose(motion.angle[rows] / 0.02, [EARTH_NED @ ned_from_body] * 50, atol=1e-19)
            down = ned_from_body[2]
            np.testing.assert_allclose(motion.velocity[rows] / 0.02, [-9.80665 * down] * 50, atol=1e-14)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: sims.table_sequences(("99",)), "no sequence '99'"),
        (lambda: sims.TurnSequence("A", "x", "z", (("z", 90.0),)), "along the outer axis"),
        (lambda: sims.TurnSequence("A", "x", "-z", (("z", 90.0),)), "with x down and -z along the outer axis"),
        (lambda: sims.TurnSequence("A", "-y", "y", (("z", 90.0),)), "with -y down and y along the outer axis"),
        (lambda: sims.TurnSequence("A", "+z", "y", (("z", 90.0),)), "with .z down"),
        (lambda: sims.TurnSequence("A", "z", "y", (("x", 90.0),)), "reorder its rotations"),
        (lambda: sims.TurnSequence("A", "-z", "-x", (("y", 90.0),)), "reorder its rotations"),
        (lambda: sims.TurnSequence("A", "-z", "-x", (("z", 40.0), ("x", 90.0))), "inner angle -50 deg"),
        (lambda: sims.TurnSequence("A", "z", "y", (("-y", 90.0),)), "about IMU -y"),
        (lambda: sims.RateProfile(rate_rad_s=0.0), "rate_rad_s"),
        (lambda: sims.Schedule(()), "names no sequence"),
        (lambda: sims.Schedule(sims.table_sequences(("1", "2")), dwells_s=((1.0, 1.0),)), "1 entries for 2 sequences"),
        (lambda: sims.Schedule(sims.table_sequences(("1",)), dwells_s=((1.0, 0.0),)), "for sequence 1: give"),
        (lambda: sims.Schedule(sims.table_sequences(("1",)), dwells_s=((1.0,),)), "for sequence 1: give"),
        (lambda: sims.Schedule(sims.table_sequences(("1",)), dwells_s=((1.0, math.inf),)), "two positive numbers"),
        (lambda: sims.table1_motion(site=SITE, U=-np.eye(3)), "proper rotation"),
        (lambda: sims.table1_motion(site=SITE, sample_rate_hz=0.0), "sample rate"),
        (lambda: sims.table1_motion(site=Site(9.8), sequences=("1",)), "latitude"),
        (lambda: sims.free_motion(np.zeros(3), site=SITE), "shape"),
        (
            lambda: sims.table1_motion(
                site=SITE, sequences=("1",), fixture_draw=imperfect(np.random.default_rng(0), ("1", "2"))
            ),
            "2, 2",
        ),
        (
            lambda: sims.table1_motion(
                site=SITE, sequences=("1",), fixture_draw=sims.FixtureDraw(wobble=np.zeros((2, 2)))
            ),
            r"wobble of shape \(2, 2\) for 1 sequences",
        ),
    ],
)
def test_impossible_runs_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_samples_far_longer_than_the_motion_allows_are_subdivided():
    motion = sims.table1_motion(site=SITE, sequences=("1",), sample_rate_hz=1.0, dwell_s=1.0, rate_rad_s=0.5)
    assert total(motion.angle)[1] == pytest.approx(2.0 * math.pi, abs=1e-13 + EARTH_RATE_RAD_S * 20.0)
