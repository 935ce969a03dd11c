"""A plan as a picture: the angles of both axes on the clock, and how far the expected accuracy is from the targets."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.planning.document import clock, timetable
from srt.planning.stand import AXIS_NAMES
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
_MINUTE_S: Final = 60.0
_TURN_DEG: Final = 360.0
_MOST_IN_A_ROW: Final = 24
"""Numbers of sequences that stand side by side; more of them take turns on two lines."""
_COLOURS: Final = (BLUE, VERMILION)
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
    """Draw the timetable of a plan and its expected accuracy over the targets.

    Parameters
    ----------
    plan : Plan
    title : str
        Of the whole picture; default: sequences and length.

    Returns
    -------
    matplotlib.figure.Figure
        Not known to pyplot; ``srt.reports.figures.style.save_figure`` writes it.

    Notes
    -----
    Above, the inner and the outer angle against time. An axis with slip rings is drawn between 0 and 360°, so that a
    turn of 990° crosses that range nearly three times; an axis with a limited travel at its true angle. Windows are
    grey, moves between sequences thin and dotted. Below, sigma over target of every parameter that has a target.
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
        Patch(color=FAINT, label="window: stand still"),
        Line2D([], [], color=INK, label="turns"),
        Line2D([], [], color=INK, linewidth=1.0, linestyle=":", label="move to the next start"),
        Line2D([], [], color=GREY, linewidth=0.8, label="a sequence begins"),
    ]
    outer.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.0, -0.14), ncols=4, fontsize=SMALL, frameon=False,
    )  # fmt: skip
    _accuracy(accuracy, plan)
    length = f"{len(plan.candidates)} sequences in {clock(plan.total_s)} (min:s)"
    figure.suptitle(f"{title}: {length}" if title else length, x=0.01, ha="left", fontsize=LARGE, color=INK)
    return figure


def _angle(axes: Axes, plan: Plan, k: int) -> None:
    """One axis of the fixture against time."""
    style(axes)
    steps = timetable(plan)
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
    axis = plan.stand.axes[k]
    wraps = axis.turns and axis.travel_deg is None
    for pieces, width, dashes in ((_turning(plan, k), 1.6, "-"), (_moving(plan, k), 1.0, ":")):
        t, angle = _wrapped(pieces) if wraps else _joined(pieces)
        axes.plot(t / _MINUTE_S, angle, color=colour, linewidth=width, linestyle=dashes, solid_capstyle="butt")
    if wraps:
        axes.set_ylim(-20.0, _TURN_DEG + 20.0)
        axes.yaxis.set_major_locator(MultipleLocator(90.0))
    else:
        axes.yaxis.set_major_locator(MultipleLocator(90.0 if np.ptp(axes.get_ylim()) < 2.0 * _TURN_DEG else 180.0))
    axes.set_ylabel(f"{AXIS_NAMES[k]} axis, °", fontsize=MEDIUM, color=colour)


def _turning(plan: Plan, k: int) -> Array:
    """Straight pieces of one axis in the sequences, shape (m, 4): from and to in s, from and to in deg."""
    out = []
    for candidate, step in zip(plan.candidates, timetable(plan), strict=True):
        turns = [plan.stand.axes[axis].turn_s(turn) for axis, turn in candidate.legs]
        # Turns follow one another; the wait for the fixture to settle is behind the last.
        times = [step.start_static_s[0], *(step.start_static_s[1] + np.cumsum([0.0, *turns])), step.end_static_s[1]]
        path = [pose[k] for pose in candidate.path_deg]
        angles = [path[0], *path, path[-1]]
        out += [(*t, *a) for t, a in zip(pairwise(times), pairwise(angles), strict=True)]
    return np.array(out, dtype=np.float64)


def _moving(plan: Plan, k: int) -> Array:
    """Straight pieces of one axis between the sequences, as in :func:`_turning`: the inner axis moves first."""
    out = []
    steps = timetable(plan)
    for (before, after), (done, step) in zip(pairwise(plan.candidates), pairwise(steps), strict=True):
        ways = [a.way_deg(s, e) for a, s, e in zip(plan.stand.axes, before.end_deg, after.start_deg, strict=True)]
        each = [a.move_s(s, e) for a, s, e in zip(plan.stand.axes, before.end_deg, after.start_deg, strict=True)]
        begin = done.end_static_s[1] + plan.stand.pause_s + sum(each[:k])
        knots = (done.end_static_s[1], begin, begin + each[k], step.start_static_s[0])
        here = float(before.end_deg[k])
        angles = (here, here, here + ways[k], here + ways[k])
        out += [(*t, *a) for t, a in zip(pairwise(knots), pairwise(angles), strict=True)]
    return np.array(out, dtype=np.float64).reshape(-1, 4)


def _joined(pieces: Array) -> tuple[Array, Array]:
    """Times and angles of pieces in one line each, with a NaN behind every piece."""
    gap = np.full(len(pieces), np.nan)
    return np.column_stack([pieces[:, :2], gap]).ravel(), np.column_stack([pieces[:, 2:], gap]).ravel()


def _wrapped(pieces: Array) -> tuple[Array, Array]:
    """Cut pieces at whole turns, and put each part between 0 and 360°."""
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
    """Number every sequence above the timetable, between the beginning of its first window and the end of its last."""
    rows = 1 if len(plan.candidates) <= _MOST_IN_A_ROW else 2
    for number, step in enumerate(timetable(plan)):
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
    """Sigma over target, coloured and shaped by the largest source."""
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
        label = f"bound: no plan of this length has all below {plan.bound:.2g}"
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
    shown = np.concatenate([ratios[seen], [1.0], [plan.bound] if math.isfinite(plan.bound) else []])
    low, high = float(shown.min()) / 1.2, float(shown.max()) * 1.2
    axes.set_ylim(low, high)
    for at in place[~seen].tolist():
        axes.annotate("not seen", (at, high), rotation=90, ha="center", va="top", fontsize=SMALL, color=VERMILION)
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
        title="dots by the largest source of the variance", title_fontsize=SMALL, alignment="left",
    )  # fmt: skip
