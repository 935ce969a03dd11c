"""Figure of a calibration. Needs matplotlib; its global state (pyplot, rcParams) is unchanged.

Values and their errors differ by orders of magnitude, so each unit has two panels: the values above, and
below them the ±1 sigma bars on a scale of their own, at estimate minus truth where that is known.
"""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import clipped
from srt.reports.figures.style import (
    BLUE,
    DPI,
    FAINT,
    GREEN,
    GREY,
    INK,
    LARGE,
    MEDIUM,
    PURPLE,
    SMALL,
    VERMILION,
    Axes,
    ConstrainedLayoutEngine,
    Figure,
    Line2D,
    LogLocator,
    MaxNLocator,
    NullLocator,
    SubFigure,
    TextPath,
    save_figure,
    style,
    symbol,
)
from srt.reports.parameters import units_for
from srt.sensor_errors import DISPLAY_UNITS, GROUP_SLICES, NAMES, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from srt.result.calibration import Calibration, Residual
    from srt.sensor_errors import SensorErrors
    from srt.types import Array, Indices


__all__ = ["calibration_figure", "save_figure"]

_SIZE_INCHES: Final = (12.0, 10.0)  # width and height
_MOST_TICKS: Final = 24  # largest number of labels of sequences that fit on the axis
_KINDS: Final = (
    ("horizontal", "horizontal", BLUE, "o"),
    ("start_down", "down at start", GREEN, "^"),
    ("end_down", "down at end", PURPLE, "v"),
    ("down", "down", VERMILION, "s"),
    ("force", "specific force", BLUE, "o"),
    ("stated_rate", "stated rate", PURPLE, "v"),
    ("rate", "rate at rest", GREEN, "^"),
    ("turn", "rotation", VERMILION, "s"),
)
_OTHER: Final = ("", "other", GREY, "D")
"""Word in the name of a component, label, colour and marker of its kind; the first that fits."""
_APART: Final = 0.2  # distance of the marks of two kinds at one sequence, in sequences
_HEADING: Final = 90  # characters of the heading beside the legend
_HEADING_POINTS: Final = 680.0  # width of the heading, pt: the legend begins at 700
_SHORTEST: Final = 4  # characters of a title that is shortened
_FOOT_WIDTH: Final = 172  # characters in a line of the explanation at the foot
_LAST: Final = (
    "Bottom left: each iteration re-processes the samples with the corrected errors, until the corrections are "
    "negligible. Bottom right: the difference of each measurement from its prediction, over its sigma; about two in "
    "three lie between the dashed lines. A sequence without marks is solved exactly."
)
_READING: Final = {
    True: "How to read it. Top: each sensor error as estimated (dot) and as simulated (diamond). Middle: the "
    "difference of the two with its 1-sigma bar; about two in three bars reach zero. " + _LAST,
    False: "How to read it. Top: each sensor error as estimated. Middle: its 1-sigma bar, enlarged. " + _LAST,
}
"""Explanation at the foot, with and without a truth."""
_TITLES = {
    "ppm": "scale factor and asymmetry",
    "µrad": "orthogonality and misalignment",
    "µg": "accel. bias",
    "°/h": "gyro bias",
}


def calibration_figure(
    calibration: Calibration, *, truth: SensorErrors | None = None, title: str | None = None
) -> Figure:
    """Draw the parameters by unit, the convergence of the iterations, and the residuals of the sequences.

    ``truth`` is marked beside the values; the error bars then stand at estimate minus truth. The figure is not known to
    pyplot; :func:`save_figure` writes it.
    """
    calibration = calibration.as_written
    layout = ConstrainedLayoutEngine(h_pad=0.07, w_pad=0.05, hspace=0.03, wspace=0.02)
    figure = Figure(figsize=_SIZE_INCHES, dpi=DPI, layout=layout)
    units = list(dict.fromkeys(DISPLAY_UNITS))
    members = [np.flatnonzero([u == unit for u in DISPLAY_UNITS]) for unit in units]
    strips = figure.subfigures(4, 1, squeeze=False, height_ratios=(0.11, 2.0, 1.15, 0.26))
    header, parameters, course, foot = strips[:, 0]
    _header(header, calibration, truth, title)
    grid = parameters.subplots(
        2,
        len(units),
        squeeze=False,
        sharex="col",
        width_ratios=[1.15 * len(m) + 2.2 for m in members],
        height_ratios=(1.0, 1.0),
    )
    for column, which in enumerate(members):
        draw_values(grid[0, column], calibration, truth, which)
        draw_errors(grid[1, column], calibration, truth, which)
    grid[0, 0].set_ylabel("estimate", fontsize=MEDIUM)
    grid[1, 0].set_ylabel("estimate − truth, ±1σ" if truth is not None else "±1σ", fontsize=MEDIUM)
    convergence, residuals = course.subplots(1, 2, width_ratios=(1.0, 2.6))
    draw_convergence(convergence, calibration)
    draw_residuals(residuals, calibration.residuals)
    residuals.set_title("Residuals over sigma", fontsize=MEDIUM, color=INK, loc="left")
    if calibration.residuals:
        residuals.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, fontsize=SMALL, frameon=False,
                         handletextpad=0.2, columnspacing=1.2, borderaxespad=0.1)  # fmt: skip
    foot.text(0.01, 0.5, textwrap.fill(_READING[truth is not None], _FOOT_WIDTH), fontsize=SMALL, color=INK,
              ha="left", va="center", linespacing=1.35)  # fmt: skip
    return figure


def _scaled(calibration: Calibration, which: Indices, *vectors: Array) -> tuple[str, Iterator[Array]]:
    """Unit of some parameters, and vectors of all parameters as those in it."""
    units = units_for(calibration.values)
    factors = np.array(units.factors)[which]
    return units.names[int(which[0])], (vector[which] * factors for vector in vectors)


def draw_values(axes: Axes, calibration: Calibration, truth: SensorErrors | None, which: Indices) -> None:
    """Draw the values of some parameters with their sigmas."""
    style(axes)
    at = np.arange(len(which))
    seen = calibration.observed[which]
    shown = calibration.values, calibration.sigma, (truth or calibration.errors).vector
    unit, (values, sigma, true) = _scaled(calibration, which, *shown)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    if truth is not None:
        axes.plot(at, true, "D", markersize=9.0, markerfacecolor="none", markeredgecolor=VERMILION)
    axes.errorbar(at[seen], values[seen], sigma[seen], fmt="o", color=BLUE, markersize=4.5, capsize=3.0)
    axes.plot(at[~seen], values[~seen], "x", color=GREY, markersize=6.0)
    shown = DISPLAY_UNITS[which[0]]
    axes.set_title(f"{_TITLES.get(shown, NAMES[which[0]][:-2])}, {unit}", fontsize=MEDIUM, color=INK, loc="left")
    axes.margins(y=0.1)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    _separate_groups(axes, which)


def draw_errors(axes: Axes, calibration: Calibration, truth: SensorErrors | None, which: Indices) -> None:
    """Draw the 1-sigma bars of some parameters, at estimate minus truth where that is known."""
    style(axes)
    at = np.arange(len(which))
    seen = calibration.observed[which]
    difference = calibration.values - (truth or calibration.errors).vector
    unit, (error, sigma) = _scaled(calibration, which, difference, calibration.sigma)
    axes.axhline(0.0, color=VERMILION if truth is not None else GREY, linewidth=0.8)
    axes.errorbar(at[seen], error[seen], sigma[seen], fmt="o" if truth is not None else "none", color=BLUE,
                  ecolor=BLUE, markersize=4.5, capsize=3.0)  # fmt: skip
    axes.set_title(unit, fontsize=MEDIUM, color=INK, loc="left")
    axes.set_xticks(at, [symbol(SYMBOLS[i]) for i in which], fontsize=MEDIUM)
    axes.set_xlim(-0.7, len(which) - 0.3)
    _separate_groups(axes, which)
    axes.yaxis.set_major_locator(MaxNLocator(5, symmetric=truth is None))


def _separate_groups(axes: Axes, which: Indices) -> None:
    starts = {group.start for group in GROUP_SLICES.values()}
    for at, parameter in enumerate(which.tolist()):
        if at and parameter in starts:
            axes.axvline(at - 0.5, color=FAINT, linewidth=0.7)


def _heading(title: str, text: str) -> str:
    """Title and text, with as much of the title as fits beside the legend: of wide letters it is less."""
    length = _HEADING - len(text)
    while True:
        heading = f"{clipped(title, length)}: {text}"
        # Without mathematics, and without letters that the font may lack.
        plain = re.sub(r"[^ -#%-~]", "M", heading)
        if length <= _SHORTEST or TextPath((0.0, 0.0), plain, size=LARGE).get_extents().width < _HEADING_POINTS:
            return heading
        length -= 1


def _header(figure: SubFigure, calibration: Calibration, truth: SensorErrors | None, title: str | None) -> None:
    word, status = calibration.judgement.word, calibration.status
    verdict = word if status == "converged" else f"{word} ({status.replace('_', ' ')})"
    text = f"{verdict}, {calibration.estimator}"
    figure.text(0.008, 0.5, _heading(title, text) if title else text, fontsize=LARGE, color=INK, va="center")
    handles = [Line2D([], [], color=BLUE, marker="o", markersize=4.5, label="estimate, ±1σ")]
    if truth is not None:
        hollow = {"marker": "D", "markersize": 8.0, "markeredgecolor": VERMILION, "markerfacecolor": "none"}
        handles.append(Line2D([], [], color=VERMILION, linewidth=0.8, label="truth", **hollow))  # type: ignore[arg-type]
    if calibration.fixed and calibration.has_values:
        handles.append(Line2D([], [], color="none", marker="x", markeredgecolor=GREY, label="fixed, not observed"))
    figure.legend(handles=handles, loc="center right", ncols=len(handles), fontsize=SMALL, frameon=False)


def draw_convergence(axes: Axes, calibration: Calibration) -> None:
    """Draw the largest correction of each iteration."""
    style(axes)
    axes.set_title("Largest correction of each iteration", fontsize=MEDIUM, color=INK, loc="left")
    steps = np.array(calibration.corrections)
    number = np.arange(1, len(steps) + 1)
    shown = steps > 0.0  # a logarithmic axis has no zero
    if shown.any():
        axes.semilogy(number[shown], steps[shown], "o-", color=BLUE, markersize=5.0)
        axes.yaxis.set_major_locator(LogLocator(numticks=7))
        axes.yaxis.set_minor_locator(NullLocator())
    refits = calibration.diagnostics.refits or ()
    for number_of_first in refits:
        axes.axvline(number_of_first - 0.5, color=GREY, linewidth=0.8, linestyle=(0, (4, 4)))
    axes.set_xlabel("iteration" + (" (dashed: another model is fitted)" if refits else ""), fontsize=MEDIUM)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.margins(x=0.08, y=0.12)


def draw_residuals(axes: Axes, residuals: Sequence[Residual], *, letters: float = MEDIUM) -> None:
    """Draw the residuals over sigma by sequence, one mark for each kind of measurement.

    The legend is left to the caller; ``letters`` is the size of letters, points.
    """
    style(axes)
    turns = list(dict.fromkeys((r.sequence, r.occurrence) for r in residuals))
    place = {turn: i for i, turn in enumerate(turns)}
    kinds = [*_KINDS, _OTHER]
    points: dict[int, list[tuple[float, float]]] = {}
    for r in residuals:
        if r.sigma > 0.0:
            k = next((k for k, kind in enumerate(_KINDS) if kind[0] in r.component), len(_KINDS))
            points.setdefault(k, []).append((float(place[r.sequence, r.occurrence]), r.value / r.sigma))
    for sigmas, line in ((-1.0, (0, (4, 4))), (0.0, "-"), (1.0, (0, (4, 4)))):
        axes.axhline(sigmas, color=GREY, linewidth=0.8, linestyle=line)
    for order, k in enumerate(sorted(points)):
        _, label, colour, marker = kinds[k]
        x, y = np.array(points[k]).T
        # Side by side, so that equal values do not hide each other.
        beside = _APART * (order - 0.5 * (len(points) - 1))
        axes.plot(x + beside, y, marker, color=colour, markersize=4.5, label=label)
    every = -(-len(turns) // _MOST_TICKS) if turns else 1
    names = [clipped(name, 12).removeprefix("turn ") + (f"·{n}" if n > 1 else "") for name, n in turns]
    # A name with two dollar signs would be taken for mathematics.
    axes.set_xticks(range(0, len(turns), every), [name.replace("$", r"\$") for name in names[::every]])
    axes.set_xlim(-0.7, max(len(turns), 1) - 0.3)
    axes.set_xlabel("sequence", fontsize=letters, color=INK)
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    largest = max((abs(y) for pairs in points.values() for _, y in pairs), default=1.0)
    axes.set_ylim(-1.15 * max(largest, 1.5), 1.15 * max(largest, 1.5))
