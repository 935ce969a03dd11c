"""The picture of a plan: what is drawn is the timetable and the prediction, and its texts can be read."""

import math
from dataclasses import replace

import numpy as np
import pytest
from figure_texts import require_readable

from srt.planning.candidates import Candidate
from srt.planning.conditions import Conditions
from srt.planning.fixture_kinematics import INNER, OUTER, AxisKinematics, FixtureKinematics
from srt.planning.plan import Plan
from srt.planning.plan_figure import plan_figure
from srt.planning.prediction import predict
from srt.reports.figures.style import save_figure
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

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


LIMITED = FixtureKinematics(
    inner=AxisKinematics(travel_deg=(-400.0, 1300.0)),
    outer=AxisKinematics(turns=False, positions_deg=(0.0, 90.0, 180.0, 270.0)),
)
CASES = {
    "four": plan,
    "forty": lambda: plan(40),
    "limited travel": lambda: plan(stand=LIMITED),
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


def test_moves_lead_from_one_sequence_to_the_next():
    found = plan()
    for k, (turning, moving) in enumerate(drawn(plan_figure(found))):
        ends = np.array([[c.start_deg[k], c.end_deg[k]] for c in found.candidates])
        steps = np.array([[s.start_static_s[0], s.end_static_s[1]] for s in found.timetable()]) / 60.0
        parts = pieces(moving)
        at = {round(float(t), 9): float(a) for t, a in parts.reshape(-1, 2)}
        for (_, done), (begin, _), (_, left), (start, _) in zip(steps, steps[1:], ends, ends[1:], strict=False):
            assert (at[round(done, 9)] - left) % 360.0 == pytest.approx(0.0, abs=1e-9)
            assert (at[round(begin, 9)] - start) % 360.0 == pytest.approx(0.0, abs=1e-9)
        assert turning[0, 1] == ends[0, 0]


def test_a_limited_axis_is_drawn_at_its_true_angles():
    (turning, _), (set_by_hand, _) = drawn(plan_figure(plan(2, stand=LIMITED)))
    assert np.nanmax(turning[:, 1]) == 990.0
    assert np.nanmax(set_by_hand[:, 1]) == 270.0


def test_ratios_stand_above_their_symbols_and_sources_have_shapes_of_their_own():
    found = plan(16)
    axes = plan_figure(found).axes[2]
    which = np.flatnonzero(np.isfinite(found.targets))
    dots = [line for line in axes.lines if line.get_marker() not in ("None", "")]
    at = np.concatenate([line.get_xydata() for line in dots])
    at = at[np.argsort(at[:, 0])]
    np.testing.assert_array_equal(at[:, 0], np.arange(len(which)))
    np.testing.assert_allclose(at[:, 1], found.ratios[which], rtol=1e-12)
    assert len({(line.get_marker(), line.get_color()) for line in dots}) == len(dots)
    largest = {found.prediction.limiting(k)[0].replace("_", " ") for k in which.tolist()}
    assert {line.get_label() for line in dots} == largest
    assert len(axes.get_xticks()) == len(which)
    levels = {float(line.get_ydata()[0]) for line in axes.lines if line not in dots}
    assert levels >= {1.0, found.bound}


def test_unobservable_parameters_are_named():
    axes = plan_figure(CASES["not observed"]()).axes[2]
    assert [(t.get_text(), t.xy[0]) for t in axes.texts] == [("not observed", 2)]


@pytest.mark.parametrize(("suffix", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml")])
def test_it_can_be_written(tmp_path, suffix, magic):
    save_figure(plan_figure(plan(2)), tmp_path / f"x{suffix}")
    assert (tmp_path / f"x{suffix}").read_bytes().startswith(magic)
