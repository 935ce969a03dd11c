"""Sequences that a fixture can execute, against the simulator's kinematics, and messages about the others."""

import math
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sims.physics.fixture import FixtureGeometry
from sims.physics.motion import RateProfile
from sims.physics.sequences import TABLE_1, TurnSequence
from srt.exceptions import InputError
from srt.model.rotation_integrals import ideal_rotations
from srt.model.table1 import SEQUENCES, RotationSequence
from srt.planning.candidates import Candidate, executable_candidates, from_catalogue, turn_patterns
from srt.planning.fixture_kinematics import AxisKinematics, FixtureKinematics
from srt.planning.order import best_order

LIMITED = FixtureKinematics(AxisKinematics(travel_deg=(-180.0, 180.0)), AxisKinematics(travel_deg=(-180.0, 180.0)))
OUTER_ONLY = FixtureKinematics(AxisKinematics(turns=False, positions_deg=(0.0, 90.0), set_s=300.0), AxisKinematics())
ANYWHERE = st.tuples(st.sampled_from((0, 90, 180, 270)), st.sampled_from((0, 90, 180, 270)))
LEGS = st.lists(
    st.tuples(st.sampled_from((0, 1)), st.integers(-12, 12).filter(bool).map(lambda k: 90 * k)), min_size=1, max_size=8
).map(tuple)


@given(start=ANYWHERE, legs=LEGS)
def test_imu_rotations_are_those_that_the_simulator_executes(start, legs):
    candidate = Candidate(start, legs)
    turned = TurnSequence("own", candidate.down, candidate.along_outer, candidate.rotations)
    inner, outer = turned.start_rad()
    # The same attitude: whole turns apart, or both axes the other way round.
    assert math.cos(inner - math.radians(start[0])) == pytest.approx(1.0)
    assert math.cos(outer - math.radians(start[1])) == pytest.approx(1.0)
    assert [axis for axis, _ in turned.fixture_legs()] == [axis for axis, _ in legs]
    np.testing.assert_allclose([a for _, a in turned.fixture_legs()], np.radians([t for _, t in legs]), rtol=1e-12)


@given(start=ANYWHERE, legs=LEGS)
def test_axis_that_is_down_at_both_ends(start, legs):
    candidate = Candidate(start, legs)
    geometry = FixtureGeometry(np.eye(3), 0.0, np.eye(3))
    for said, angles in ((candidate.down, candidate.start_deg), (candidate.end_down, candidate.end_deg)):
        inner, outer = np.radians(angles)
        down = geometry.to_body(np.array([[0.0, 0.0, 1.0]]), geometry.turned(np.array(inner), np.array(outer)))[:, 0]
        expected = np.zeros(3)
        expected["xyz".index(said[-1])] = -1.0 if said.startswith("-") else 1.0
        np.testing.assert_allclose(down, expected, atol=1e-12)


@given(start=ANYWHERE, legs=LEGS, speed=st.floats(0.1, 5.0))
def test_integrals_of_ideal_rotations_against_small_steps(start, legs, speed):
    candidate = Candidate(start, legs[:3])
    sequence = candidate.catalogue_sequence()
    speeds = speed * np.arange(1, len(sequence.rotations) + 1)
    found = ideal_rotations([sequence], [speeds])
    steps = 400
    C = np.eye(3)
    total = {name: np.zeros(getattr(found, name).shape[1:]) for name in ("rate", "abs_rate", "time", "noise")}
    for u, angle, v in zip(sequence.axes, sequence.angles_rad, speeds, strict=True):
        dt, omega = abs(angle) / v / steps, np.sign(angle) * v * u
        # Midpoints: the error of a step of β is β³ / 24 of its size.
        A = C @ Rotation.from_rotvec(omega * dt * (np.arange(steps)[:, None] + 0.5)).as_matrix()
        total["rate"] += dt * np.einsum("nab,c->abc", A, omega)
        total["abs_rate"] += dt * np.einsum("nab,b->ab", A, np.abs(omega))
        total["time"] += dt * A.sum(axis=0)
        total["noise"] += dt * np.einsum("nab,ncb->acb", A, A)
        C = C @ Rotation.from_rotvec(u * angle).as_matrix()
    step = np.abs(sequence.angles_rad).max() / steps
    way, time = np.abs(sequence.angles_rad).sum(), np.sum(np.abs(sequence.angles_rad) / speeds)
    for name, value in total.items():
        # The noise has products of two matrices: twice the frequency, four times the error.
        size = way if "rate" in name else time
        np.testing.assert_allclose(
            getattr(found, name)[0], value, atol=4.0 * step**2 / 24.0 * size + 1e-12, err_msg=name
        )
    np.testing.assert_allclose(found.C_end[0], C, atol=1e-12)


def test_table_1_is_among_the_words():
    keys = {c.key for c in executable_candidates(FixtureKinematics(), turn_patterns())}
    for name, sequence in SEQUENCES.items():
        candidate = from_catalogue(sequence, FixtureKinematics())
        assert candidate.key in keys, name
        own = TABLE_1[name]
        assert [a for a, _ in own.fixture_legs()] == [a for a, _ in candidate.axis_rotations]
        assert own.rotations == tuple((axis, float(turn)) for axis, turn in candidate.rotations)


def test_limited_travel_is_kept_along_the_whole_way():
    found = executable_candidates(LIMITED, turn_patterns(largest_turn_deg=360, most_legs=4))
    assert len(found) > 100
    for candidate in found:
        assert all(-180 <= angle <= 180 for angles in candidate.path_deg for angle in angles)
    # A whole turn fits, from one end to the other.
    assert any(abs(turn) == 360 for c in found for _, turn in c.axis_rotations)


def test_an_axis_set_by_hand_does_not_turn():
    found = executable_candidates(OUTER_ONLY, turn_patterns(largest_turn_deg=360, most_legs=4))
    assert found
    assert {axis for c in found for axis, _ in c.axis_rotations} == {1}
    assert {c.start_deg[0] for c in found} <= {0, 90}
    assert OUTER_ONLY.move_s((0, 0), (90, 0)) == 300.0


@pytest.mark.parametrize("turn_deg", [3.0, 90.0, -360.0, 720.0])
def test_turning_time_is_the_simulators(turn_deg):
    axis, profile = AxisKinematics(0.7, 2.0), RateProfile(0.7, 2.0)
    assert axis.turn_s(turn_deg) == pytest.approx(profile.duration_s(math.radians(turn_deg)), rel=1e-12)


def test_order_is_the_best_of_all_orders():
    rng = np.random.default_rng(5)
    every = executable_candidates(
        FixtureKinematics(settle_s=1.0, pause_s=0.5), turn_patterns(largest_turn_deg=180, most_legs=2)
    )
    stand = FixtureKinematics(settle_s=1.0, pause_s=0.5)
    for _ in range(4):
        chosen = [every[k] for k in rng.choice(len(every), 6)]
        order, ways, moves_s = best_order(chosen, stand)
        assert sorted(order) == list(range(6))
        assert [w.key for w in ways] == [chosen[k].key for k in order]
        shortest = min(
            sum(stand.move_s(chosen[a].end_deg, chosen[b].start_deg) for a, b in pairwise(p))
            for p in permutations(range(6))
        )
        assert moves_s == pytest.approx(shortest, abs=1e-9)


def test_order_uses_the_nearest_of_several_angles():
    there = Candidate((0, -180), ((1, 180),))
    again = Candidate((0, 180), ((1, -180),))
    _, ways, moves_s = best_order([there, again], LIMITED)
    # From 0 either end of the travel is as far; the two sequences can follow each other with one half turn between.
    assert moves_s == pytest.approx(LIMITED.outer.turn_s(180.0))
    assert all(w.obstacle(LIMITED) is None for w in ways)


@pytest.mark.parametrize(
    ("sequence", "stand", "said"),
    [
        (
            SEQUENCES["1"],
            LIMITED,
            r"Sequence 1 cannot .* rotation 1 \(\+360 deg about the outer axis\) .* 0 to 360 deg",
        ),
        (SEQUENCES["3"], OUTER_ONLY, "inner axis.: that axis does not turn, it is set by hand"),
        (RotationSequence("own", "z", "z", 0.0, 0.0, (("z", math.pi),)), None, "no attitude with z down and z along"),
        (
            RotationSequence("own", "z", "y", 0.0, 0.0, (("x", math.pi),)),
            None,
            "rotation 1 is about x, .* turn about z first",
        ),
        (RotationSequence("own", "z", "y", 0.0, 0.0, (("y", 1.0),)), None, "multiples of 90"),
    ],
)
def test_the_obstacle_to_a_sequence_is_named(sequence, stand, said):
    with pytest.raises(InputError, match=said):
        from_catalogue(sequence, stand)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: AxisKinematics(rate_rad_s=0.0), "rate_rad_s"),
        (lambda: AxisKinematics(travel_deg=(10.0, -10.0)), "the first must be the smaller"),
        (lambda: AxisKinematics(travel_deg=(10.0, 80.0)), "No multiple of 90 deg"),
        (lambda: AxisKinematics(turns=False, positions_deg=(45.0,)), "multiples of 90"),
        (lambda: FixtureKinematics(settle_s=-1.0), "settle_s"),
        (lambda: FixtureKinematics(AxisKinematics(turns=False), AxisKinematics(turns=False)), "Neither axis"),
    ],
)
def test_impossible_fixtures(make, said):
    with pytest.raises(InputError, match=said):
        make()


@given(turn=st.sampled_from((90, -180, 360, 1080)), rate=st.floats(0.3, 3.0), acceleration=st.floats(0.5, 20.0))
def test_bias_and_noise_act_over_the_ramps_of_the_rate_too(turn, rate, acceleration):
    """The mean rate has the right time, but not the right attitudes: 6 % at 1 rad/s and 5 rad/s²."""
    sequence = Candidate((0, 0), ((1, turn),)).catalogue_sequence()
    found = ideal_rotations([sequence], [np.array([rate])], acceleration_rad_s2=[np.array([acceleration])])
    size, n = math.radians(abs(turn)), 20000
    peak = min(rate, math.sqrt(size * acceleration))
    total = size / peak + peak / acceleration
    t = (np.arange(n) + 0.5) * total / n
    up, down = np.minimum(t, peak / acceleration), np.minimum(total - t, peak / acceleration)
    plateau = np.clip(t - peak / acceleration, 0.0, total - 2.0 * peak / acceleration)
    beta = (
        0.5 * acceleration * up**2
        + peak * plateau
        + np.where(total - t < peak / acceleration, 0.5 * acceleration * ((peak / acceleration) ** 2 - down**2), 0.0)
    )
    A = Rotation.from_rotvec(np.sign(turn) * beta[:, None] * np.array([0.0, 1.0, 0.0])).as_matrix()
    # Midpoints: the error is (2 peak dt)² / 24 of the time for products of two matrices.
    atol = (2.0 * peak * total / n) ** 2 / 24.0 * total + 1e-7
    np.testing.assert_allclose(found.time[0], A.mean(axis=0) * total, atol=atol)
    np.testing.assert_allclose(found.noise[0], np.einsum("nab,ncb->acb", A, A) * total / n, atol=atol)
    np.testing.assert_allclose(found.weight_s[0], total, rtol=1e-12)
