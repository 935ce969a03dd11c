"""Candidates of a plan, and its figure."""

import math
from dataclasses import replace

import numpy as np
import pytest
from figure_texts import require_readable
from hypothesis import given
from hypothesis import strategies as st

from sims.physics.fixture import FixtureGeometry
from sims.physics.motion import RateProfile
from sims.physics.sequences import TABLE_1, TurnSequence
from srt.exceptions import InputError
from srt.model.table1 import SEQUENCES, RotationSequence
from srt.planning.candidates import Candidate, executable_candidates, from_catalogue, turn_patterns
from srt.planning.conditions import Conditions
from srt.planning.fixture_kinematics import INNER, OUTER, AxisKinematics, FixtureKinematics
from srt.planning.order import moves_between, nearest_angles
from srt.planning.plan import Plan
from srt.planning.plan_figure import plan_figure
from srt.planning.prediction import predict
from srt.reports.figures.style import save_figure
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

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


def test_moves_use_the_nearest_of_several_angles():
    there = Candidate((0, -180), ((1, 180),))
    again = Candidate((0, 180), ((1, -180),))
    ways, moves_s = nearest_angles([there, again], LIMITED)
    # From 0 either end of the travel is as far; the two sequences can follow each other with one half turn between.
    assert moves_s == pytest.approx(LIMITED.outer.turn_s(180.0))
    assert all(w.obstacle(LIMITED) is None for w in ways)
    assert moves_between([there, again], LIMITED)[0, 1] == moves_s


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


CONDITIONS = Conditions(gyro_white=1e-6, accel_white=1e-4, accel_instability=1e-5)
KINDS = (((INNER, 990),), ((OUTER, -180), (INNER, 90)), ((OUTER, 90),) * 3, ((INNER, -90), (OUTER, 180), (INNER, -270)))
STARTS = ((0, 0), (90, 270), (180, 90), (270, 180))


def plan(count=4, stand=None, bound=0.2):
    """Sequences one after the other, whether or not anybody would choose them."""
    stand = stand or FixtureKinematics(settle_s=1.5, pause_s=1.0)
    candidates = tuple(Candidate(STARTS[k % 4], KINDS[(k + k // 4) % 4]) for k in range(count))
    windows = np.tile([[10.0, 8.0], [6.0, 6.0]], (count // 2, 1))
    targets = np.full(N_PARAMETERS, math.nan)
    targets[GROUP_SLICES["gyro_scale"]] = targets[GROUP_SLICES["accel_scale"]] = 1e-6
    targets[GROUP_SLICES["accel_bias"]] = 1e-4
    prediction = predict(candidates, windows, stand, CONDITIONS, targets)
    draft = Plan(candidates, windows, 0.0, 0.0, stand, CONDITIONS, targets, prediction, bound)
    return replace(draft, total_s=draft.timetable()[-1].end_static_s[1])


def with_sigma(found, sigma):
    return replace(found, prediction=replace(found.prediction, sigma=sigma))


LIMITED_TRAVEL = FixtureKinematics(
    inner=AxisKinematics(travel_deg=(-400.0, 1300.0)),
    outer=AxisKinematics(turns=False, positions_deg=(0.0, 90.0, 180.0, 270.0)),
)
CASES = {
    "four": plan,
    "forty": lambda: plan(40),
    "limited travel": lambda: plan(stand=LIMITED_TRAVEL),
    "no bound": lambda: plan(bound=math.nan),
    "one": lambda: replace(plan(2), candidates=plan(2).candidates[:1], windows_s=plan(2).windows_s[:1], total_s=60.0),
    "not observed": lambda: with_sigma(plan(), np.where(np.arange(N_PARAMETERS) == 2, math.inf, plan().targets)),
}


def drawn(figure):
    """Lines of the timetable: of each axis the turns and the moves, as (minutes, deg)."""
    return [[line.get_xydata() for line in axes.lines] for axes in figure.axes[:2]]


def pieces(line):
    """Straight pieces of a line that is broken by NaN."""
    return line.reshape(-1, 3, 2)[:, :2]


@pytest.mark.parametrize("case", CASES)
def test_texts_neither_overlap_nor_leave_the_picture(case):
    figure = plan_figure(CASES[case](), title="Rotation test of a unit on a fixture")
    require_readable(figure, figure.axes, [figure._suptitle], 25)


def test_turns_on_slip_rings_are_drawn_whole_between_0_and_360_deg():
    found = plan(40)
    for k, (turning, _) in enumerate(drawn(plan_figure(found))):
        parts = pieces(turning)
        assert parts[:, :, 1].min() >= 0.0
        assert parts[:, :, 1].max() <= 360.0
        change = np.abs(np.diff(parts[:, :, 1], axis=1)).sum()
        # Cuts at 0 and 360 take nothing away; times are the timetable's.
        assert change == pytest.approx(
            sum(abs(turn) for c in found.candidates for axis, turn in c.axis_rotations if axis == k)
        )
        assert parts[-1, 1, 0] * 60.0 == pytest.approx(found.total_s)


def test_a_limited_axis_is_drawn_at_its_true_angles():
    (turning, _), (set_by_hand, _) = drawn(plan_figure(plan(2, stand=LIMITED_TRAVEL)))
    assert np.nanmax(turning[:, 1]) == 990.0
    assert np.nanmax(set_by_hand[:, 1]) == 270.0


def test_unobservable_parameters_are_named():
    axes = plan_figure(CASES["not observed"]()).axes[2]
    assert [(t.get_text(), t.xy[0]) for t in axes.texts] == [("not observed", 2)]


@pytest.mark.parametrize(("suffix", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml")])
def test_it_can_be_written(tmp_path, suffix, magic):
    save_figure(plan_figure(plan(2)), tmp_path / f"x{suffix}")
    assert (tmp_path / f"x{suffix}").read_bytes().startswith(magic)
