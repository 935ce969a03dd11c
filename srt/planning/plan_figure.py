"""Figure of a plan: the angles of both axes against time, and the expected accuracy relative to the targets."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.planning.fixture_kinematics import AXIS_NAMES
from srt.planning.plan import MET
from srt.planning.timetable import clock
from srt.reports.figures.style import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    INK,
    LARGE,
    MEDIUM,
    ORANGE,
    PURPLE,
    SKY,
    SMALL,
    SYMBOL,
    VERMILION,
    Axes,
    Figure,
    FuncFormatter,
    Line2D,
    LogLocator,
    MultipleLocator,
    NullLocator,
    Patch,
    style,
    symbol,
)
from srt.sensor_errors import GROUP_SLICES, SYMBOLS

if TYPE_CHECKING:
    from srt.planning.plan import Plan
    from srt.types import Array


_SIZE_INCHES: Final = (12.0, 8.0)
"""Width and height of the figure."""
_MINUTE_S: Final = 60.0
_TURN_DEG: Final = 360.0
"""Units of the axes of the figure: minutes in s, one turn in deg."""
_MOST_IN_A_ROW: Final = 24
"""Largest count of sequences whose numbers fit on one line; with more, they alternate between two lines."""
_COLOURS: Final = (BLUE, VERMILION)
"""Colours of the inner and of the outer axis."""
_SOURCES: Final = {
    "gyro_noise": (BLUE, "o"),
    "gyro_quantization": (SKY, "s"),
    "gyro_bias_instability": (PURPLE, "^"),
    "accel_noise": (VERMILION, "D"),
    "accel_quantization": (ORANGE, "P"),
    "accel_bias_instability": (GREEN, "v"),
    "earth_rate_alignment": (INK, "X"),
    "gravity": (GREY, "h"),
}
_OTHER: Final = (INK, "*")


def plan_figure(plan: Plan, *, title: str = "") -> Figure:
    """Draw the timetable of a plan and its expected accuracy relative to the targets.

    Parameters
    ----------
    title : str
        Title of the figure; default: sequences and length.

    Returns
    -------
    matplotlib.figure.Figure
        Independent of pyplot; ``srt.reports.figures.style.save_figure`` writes it.

    Notes
    -----
    The upper panels show the inner and the outer angle against time. The angle of an axis with slip rings is wrapped to
    0 to 360°: a rotation of 990° crosses that range nearly three times. An axis with limited travel is drawn at its
    true angle. Stationary windows are grey; moves between sequences are thin and dotted. The lower panel shows sigma
    over target of every parameter that has a target.
    """
    figure = Figure(figsize=_SIZE_INCHES, layout="constrained")
    inner, outer, accuracy = figure.subplots(3, 1, height_ratios=(1.0, 1.0, 1.7))
    inner.sharex(outer)
    inner.tick_params(labelbottom=False)
    for k, axes in enumerate((inner, outer)):
        _angle(axes, plan, k)
    _numbers(inner, plan)
    outer.set_xlabel("min", loc="right", fontsize=SMALL)
    outer.set_xlim(0.0, plan.total_s / _MINUTE_S)
    handles = [
        Patch(color=FAINT, label="stationary window"),
        Line2D([], [], color=INK, label="rotation"),
        Line2D([], [], color=INK, linewidth=1.0, linestyle=":", label="move to the next sequence"),
        Line2D([], [], color=GREY, linewidth=0.8, label="start of a sequence"),
    ]
    outer.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.0, -0.14), ncols=4, fontsize=SMALL, frameon=False,
    )  # fmt: skip
    _accuracy(accuracy, plan)
    length = f"{len(plan.candidates)} sequences in {clock(plan.total_s)} (min:s)"
    figure.suptitle(f"{title}: {length}" if title else length, x=0.01, ha="left", fontsize=LARGE, color=INK)
    return figure


def _angle(axes: Axes, plan: Plan, k: int) -> None:
    """Draw the angle of one axis of the fixture against time."""
    style(axes)
    steps = plan.timetable()
    windows = [w for step in steps for w in (step.start_static_s, step.end_static_s)]
    axes.broken_barh(
        [(a / _MINUTE_S, (b - a) / _MINUTE_S) for a, b in windows],
        (0.0, 1.0),
        transform=axes.get_xaxis_transform(),
        color=FAINT,
        linewidth=0.0,
    )
    begins = np.array([step.start_static_s[0] for step in steps]) / _MINUTE_S
    axes.vlines(begins, 0.0, 1.0, transform=axes.get_xaxis_transform(), color=GREY, linewidth=0.8)
    colour = _COLOURS[k]
    axis = plan.fixture.axes[k]
    wraps = axis.turns and axis.travel_deg is None
    for pieces, width, dashes in ((_rotation_pieces(plan, k), 1.6, "-"), (_move_pieces(plan, k), 1.0, ":")):
        t, angle = _wrapped(pieces) if wraps else _joined(pieces)
        axes.plot(t / _MINUTE_S, angle, color=colour, linewidth=width, linestyle=dashes, solid_capstyle="butt")
    if wraps:
        axes.set_ylim(-20.0, _TURN_DEG + 20.0)
        axes.yaxis.set_major_locator(MultipleLocator(90.0))
    else:
        axes.yaxis.set_major_locator(MultipleLocator(90.0 if np.ptp(axes.get_ylim()) < 2.0 * _TURN_DEG else 180.0))
    axes.set_ylabel(f"{AXIS_NAMES[k]} axis, °", fontsize=MEDIUM, color=colour)


def _rotation_pieces(plan: Plan, k: int) -> Array:
    """Straight pieces of the angle of one axis in the sequences, shape (m, 4): two times in s, two angles in deg."""
    out = []
    for candidate, step in zip(plan.candidates, plan.timetable(), strict=True):
        turns = [plan.fixture.axes[axis].turn_s(turn) for axis, turn in candidate.axis_rotations]
        # Rotations follow one another; the wait for the fixture to settle follows the last.
        times = [step.start_static_s[0], *(step.start_static_s[1] + np.cumsum([0.0, *turns])), step.end_static_s[1]]
        path = [pose[k] for pose in candidate.path_deg]
        angles = [path[0], *path, path[-1]]
        out += [(*t, *a) for t, a in zip(pairwise(times), pairwise(angles), strict=True)]
    return np.array(out, dtype=np.float64)


def _move_pieces(plan: Plan, k: int) -> Array:
    """Straight pieces of the angle of one axis between the sequences; the inner axis moves first."""
    out = []
    steps = plan.timetable()
    for (before, after), (done, step) in zip(pairwise(plan.candidates), pairwise(steps), strict=True):
        ways = [a.move_deg(s, e) for a, s, e in zip(plan.fixture.axes, before.end_deg, after.start_deg, strict=True)]
        each = [a.move_s(s, e) for a, s, e in zip(plan.fixture.axes, before.end_deg, after.start_deg, strict=True)]
        begin = done.end_static_s[1] + plan.fixture.pause_s + sum(each[:k])
        knots = (done.end_static_s[1], begin, begin + each[k], step.start_static_s[0])
        here = float(before.end_deg[k])
        angles = (here, here, here + ways[k], here + ways[k])
        out += [(*t, *a) for t, a in zip(pairwise(knots), pairwise(angles), strict=True)]
    return np.array(out, dtype=np.float64).reshape(-1, 4)


def _joined(pieces: Array) -> tuple[Array, Array]:
    """Times and angles of all pieces as two arrays, with a NaN after every piece."""
    gap = np.full(len(pieces), np.nan)
    return np.column_stack([pieces[:, :2], gap]).ravel(), np.column_stack([pieces[:, 2:], gap]).ravel()


def _wrapped(pieces: Array) -> tuple[Array, Array]:
    """Cut pieces at multiples of 360° and wrap each part to 0 to 360°."""
    parts = []
    for t0, t1, a0, a1 in pieces.tolist():
        low, high = sorted((a0, a1))
        cuts = _TURN_DEG * np.arange(math.floor(low / _TURN_DEG) + 1, math.ceil(high / _TURN_DEG))
        angles = np.concatenate([[a0], cuts if a0 <= a1 else cuts[::-1], [a1]])
        times = np.array([t0, t1]) if a0 == a1 else t0 + (angles - a0) / (a1 - a0) * (t1 - t0)
        base = _TURN_DEG * np.floor(np.minimum(angles[:-1], angles[1:]) / _TURN_DEG)
        parts.append(np.column_stack([times[:-1], times[1:], angles[:-1] - base, angles[1:] - base]))
    return _joined(np.concatenate(parts) if parts else pieces)


def _numbers(axes: Axes, plan: Plan) -> None:
    """Write the number of every sequence above the timetable, centred on the sequence."""
    rows = 1 if len(plan.candidates) <= _MOST_IN_A_ROW else 2
    for number, step in enumerate(plan.timetable()):
        middle = (step.start_static_s[0] + step.end_static_s[1]) / 2.0
        axes.annotate(
            str(number + 1),
            (middle / _MINUTE_S, 1.0),
            xytext=(0.0, 2.0 + 10.0 * (number % rows)),
            xycoords=axes.get_xaxis_transform(),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=SMALL,
            color=INK,
        )


def _accuracy(axes: Axes, plan: Plan) -> None:
    """Draw sigma over target, with colour and marker by the largest noise source."""
    style(axes)
    which = np.flatnonzero(np.isfinite(plan.targets))
    ratios = plan.ratios[which]
    seen = np.isfinite(ratios)
    largest = [plan.prediction.limiting(k)[0] for k in which.tolist()]
    place = np.arange(len(which))
    axes.set_yscale("log")
    axes.axhline(1.0, color=INK, linewidth=1.2)
    handles = [Line2D([], [], color=INK, linewidth=1.2, label="target")]
    if math.isfinite(plan.bound):
        axes.axhline(plan.bound, color=GREY, linewidth=1.2, linestyle="--")
        label = f"lower bound for plans of this length: {plan.bound:.3f}"
        handles.append(Line2D([], [], color=GREY, linewidth=1.2, linestyle="--", label=label))
    axes.vlines(place[seen], np.minimum(ratios[seen], 1.0), np.maximum(ratios[seen], 1.0), color=FAINT, linewidth=3.0)
    for name in (*_SOURCES, *dict.fromkeys(s for s in largest if s not in _SOURCES)):
        mine = seen & np.array([source == name for source in largest], dtype=bool)
        if mine.any():
            colour, marker = _SOURCES.get(name, _OTHER)
            (dots,) = axes.plot(
                place[mine], ratios[mine], marker, color=colour, markersize=8.0, label=name.replace("_", " ")
            )
            handles.append(dots)
    missed = seen & (ratios > MET)
    if missed.any():
        (rings,) = axes.plot(place[missed], ratios[missed], "o", color=VERMILION, label="target missed")
        rings.set(markersize=14.0, markerfacecolor="none")
        handles.append(rings)
    shown = np.concatenate([ratios[seen], [1.0], [plan.bound] if math.isfinite(plan.bound) else []])
    low, high = float(shown.min()) / 1.2, float(shown.max()) * 1.2
    axes.set_ylim(low, high)
    for at in place[~seen].tolist():
        axes.annotate("not observed", (at, high), rotation=90, ha="center", va="top", fontsize=SMALL, color=VERMILION)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0, 7.0) if high < 30.0 * low else (1.0,)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    starts = {group.start for group in GROUP_SLICES.values()}
    for at, parameter in enumerate(which.tolist()):
        if at and parameter in starts:
            axes.axvline(at - 0.5, color=FAINT, linewidth=0.7)
    axes.set_xticks(place, [symbol(SYMBOLS[k]) for k in which], fontsize=SYMBOL)
    axes.set_xlim(-0.7, len(which) - 0.3)
    axes.set_ylabel("sigma over target", fontsize=MEDIUM)
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=4, fontsize=SMALL, frameon=False,
        title="markers: largest source of the variance", title_fontsize=SMALL, alignment="left",
    )  # fmt: skip
