"""Pictures of README and docs: fixture with the 17 sequences, demo, unit turned by hand, convergence, temperature.

``python benchmarks/pictures.py`` writes them to docs/images. The picture of convergence shows a table of
docs/studies/filters.md. A test draws all again and compares, so that they are those of the present software.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from soaked_units import Unit

import sims
import srt
from sims.robustness.error_statistics import share_interval
from srt.model.table1 import SEQUENCES
from srt.reports.figures.calibration import calibration_figure
from srt.reports.figures.inspection import inspection_figure
from srt.reports.figures.style import (
    BLUE,
    DPI,
    FAINT,
    GREEN,
    GREY,
    INK,
    LARGE,
    MEDIUM,
    SMALL,
    VERMILION,
    Axes,
    ConstrainedLayoutEngine,
    Figure,
    NullLocator,
    save_figure,
    style,
)
from srt.reports.figures.thermal import thermal_figure

if TYPE_CHECKING:
    from collections.abc import Iterable

FOLDER = Path(__file__).parents[1] / "docs" / "images"
STUDY = FOLDER.parent / "studies" / "filters.md"
"""Page with the table that the picture of convergence shows."""
COLOURS = {"x": BLUE, "y": VERMILION, "z": GREEN}
# Oblique view: table axes x (away from the reader), y (to the right, along the outer axis), z (down): right-handed.
VIEW = np.array([[0.50, 0.94, 0.0], [0.40, -0.08, -1.0]])


def seen(*points: Iterable[float]) -> np.ndarray:
    """Points of the page of points in table axes, shape (n, 2)."""
    return np.array([[*point] for point in points]) @ VIEW.T


def polygon(axes: Axes, corners: list[tuple[float, float, float]], *, fill: str, order: int = 1) -> None:
    """Draw a plane face."""
    axes.fill(*seen(*corners).T, facecolor=fill, edgecolor=INK, linewidth=1.1, zorder=order)


def arrow(axes: Axes, start: tuple[float, float, float], end: tuple[float, float, float], colour: str) -> None:
    """Draw an arrow between points in table axes."""
    a, b = seen(start, end)
    axes.annotate("", b, a, arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2.0}, zorder=8)


def circle(radius: float, height: float, first: float = 0.0, last: float = 360.0) -> list[tuple[float, float, float]]:
    """Points of an arc about the inner axis."""
    return [
        (radius * math.cos(a), radius * math.sin(a), height) for a in np.radians(np.linspace(first, last, 80)).tolist()
    ]


def draw_fixture(axes: Axes) -> None:
    """Two-axis fixture at the angles (0, 0): z down, y along the outer axis."""
    for y in (-2.05, 2.05):  # stands with the bearings of the outer axis
        polygon(axes, [(-0.35, y, 0.25), (0.35, y, 0.25), (0.55, y, 2.1), (-0.55, y, 2.1)], fill="#E8E8E8")
    polygon(axes, [(-0.9, -2.4, 2.1), (0.9, -2.4, 2.1), (0.9, 2.4, 2.1), (-0.9, 2.4, 2.1)], fill="#F3F3F3", order=0)
    axes.plot(*seen((0, -2.7, 0), (0, 2.7, 0)).T, color=GREY, linewidth=1.2, linestyle=(0, (6, 3)), zorder=2)
    frame = [(-1.25, -1.55, 0.0), (1.25, -1.55, 0.0), (1.25, 1.55, 0.0), (-1.25, 1.55, 0.0)]
    polygon(axes, frame, fill="#DCE6EE", order=3)
    polygon(axes, circle(0.95, -0.06), fill="#FFFFFF", order=4)
    h, top = 0.42, -0.75
    faces = (
        [(-h, -h, -0.06), (-h, h, -0.06), (-h, h, top), (-h, -h, top)],
        [(-h, h, -0.06), (h, h, -0.06), (h, h, top), (-h, h, top)],
        [(-h, -h, top), (h, -h, top), (h, h, top), (-h, h, top)],
    )
    for face, fill in zip(faces, ("#C9CED3", "#B4BBC2", "#DDE1E5"), strict=True):
        polygon(axes, face, fill=fill, order=6)
    centre = (0.0, 0.0, top)
    for axis, end in (("x", (1.45, 0.0, top)), ("y", (0.0, 1.35, top)), ("z", (0.0, 0.0, 1.25))):
        start = centre if axis != "z" else (0.0, 0.0, 0.06)
        arrow(axes, start, end, COLOURS[axis])
        (at,) = seen(tuple(1.0 * v for v in end))
        shift = {"x": (0.14, 0.10), "y": (0.16, 0.0), "z": (0.18, -0.02)}[axis]
        axes.text(*(at + shift), axis, color=COLOURS[axis], fontsize=LARGE, ha="center", va="center", weight="bold",
                  zorder=9)  # fmt: skip
    axes.plot(*seen((0, 0, -1.75), (0, 0, top)).T, color=GREY, linewidth=1.2, linestyle=(0, (6, 3)), zorder=7)
    notes = (
        ("inner axis (along z of the unit)", seen((0, 0, -1.75))[0] + (0.12, 0.05), "left"),
        ("outer axis,\nhorizontal", seen((0, 2.7, 0))[0] + (0.05, 0.18), "left"),
        ("unit", seen((-h, -h, top))[0] + (-0.12, 0.08), "right"),
        ("turntable", seen((-1.25, 0.4, 0.0))[0] + (0.75, -0.26), "left"),
    )
    for text, at, side in notes:
        axes.text(*at, text, fontsize=MEDIUM, color=INK, ha=side, va="center")
    axes.set_title("Fixture at (0°, 0°): z down, y along the outer axis", fontsize=MEDIUM, color=INK, loc="left")
    axes.set_aspect("equal")
    axes.set_xlim(-3.2, 4.0)
    axes.set_axis_off()


def draw_strips(axes: Axes) -> None:
    """The 17 sequences: rest, rotations, rest, with the length of a rotation by its angle."""
    longest = max(sum(abs(angle) for _, angle in s.rotations) for s in SEQUENCES.values())
    rest = 0.10
    for row, (name, sequence) in enumerate(SEQUENCES.items()):
        at, height = 0.0, 0.62
        pieces = [("rest", FAINT, rest)]
        pieces += [(axis, COLOURS[axis], 1.35 * abs(angle) / longest) for axis, angle in sequence.rotations]
        for (kind, colour, length), (_, angle) in zip(pieces, [("", 0.0), *sequence.rotations], strict=True):
            axes.barh(row, length, left=at, height=height, color=colour, edgecolor="white", linewidth=1.0)
            if kind != "rest":
                text = f"{math.degrees(angle):+.0f}"
                axes.text(at + 0.5 * length, row, text, color="white", fontsize=7.5, ha="center", va="center")
            at += length
        axes.barh(row, rest, left=at, height=height, color=FAINT, edgecolor="white", linewidth=1.0)
        axes.text(-0.42, row, name, fontsize=SMALL, color=INK, ha="left", va="center", weight="bold")
        axes.text(-0.28, row, f"{sequence.down} / {sequence.along_outer}", fontsize=SMALL, color=INK, va="center")
    axes.text(-0.42, -0.95, "no.", fontsize=SMALL, color=GREY, va="center")
    axes.text(-0.28, -0.95, "down / outer", fontsize=SMALL, color=GREY, va="center")
    for k, axis in enumerate("xyz"):
        axes.text(0.42 + 0.34 * k, -0.95, f"■ about {axis}, °", fontsize=SMALL, color=COLOURS[axis], va="center")
    axes.text(0.42 + 0.34 * 3, -0.95, "■ rest", fontsize=SMALL, color=GREY, va="center")
    axes.set_title("The 17 sequences: rest, rotate, rest", fontsize=MEDIUM, color=INK, loc="left", pad=14)
    axes.set_xlim(-0.45, 1.75)
    axes.set_ylim(len(SEQUENCES) - 0.4, -1.4)
    axes.set_axis_off()


def fixture_figure() -> Figure:
    """Fixture with the axes of the unit, and the 17 sequences as strips."""
    figure = Figure(figsize=(12.0, 5.6), dpi=DPI)
    draw_fixture(figure.add_axes((0.01, 0.02, 0.46, 0.88)))
    draw_strips(figure.add_axes((0.50, 0.02, 0.49, 0.86)))
    return figure


def demo_figure() -> Figure:
    """Calibration of the demo with its truth."""
    simulation = sims.simulate(sims.load_scenario("demo"))
    return calibration_figure(srt.calibrate(simulation.recording), truth=simulation.truth, title="demo")


def hand_figure() -> Figure:
    """Readings of a unit that was turned by hand, with the stationary windows that were found."""
    recording = sims.simulate(sims.load_scenario("free-mems")).recording
    return inspection_figure(recording, srt.inspect(recording), title="hand")


def start_scores() -> tuple[dict[str, dict[str, np.ndarray]], list[float]]:
    """Units with errors within 5 sigma and all units, by estimator and start, and the size of the errors, %."""
    text = STUDY.read_text(encoding="utf-8")
    table = re.search(r"^\*\*Within 5 sigma, .*?\*\*\n\n(.*?)\n\n", text, re.M | re.S)
    assert table is not None
    head, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table[1].splitlines()]
    found: dict[str, dict[str, np.ndarray]] = {}
    for label, *cells in rows:
        name, start = label.split(" from ")
        found.setdefault(name, {})[start] = np.array([[int(n) for n in cell.split(" of ")] for cell in cells])
    return found, [float(size) for size in head[1:]]


STARTS = {"zero": (VERMILION, "s", (0, (3, 1.5))), "the fixture": (BLUE, "o", "-")}


def convergence_figure() -> Figure:
    """Share of the units with errors within 5 sigma over the size of the errors: a panel for each estimator."""
    found, sizes = start_scores()
    figure = Figure(figsize=(9.0, 6.6), dpi=DPI, layout=ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.1))
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    letters = 1.6 * MEDIUM  # legible at 360 pixels
    for axes, (name, by_start) in zip(panels.ravel(), found.items(), strict=True):
        style(axes)
        for start, (colour, marker, line) in STARTS.items():
            right, units = by_start[start].T
            low, high = share_interval(right, units)
            share = right / units
            away = np.maximum(100.0 * np.stack([share - low, high - share]), 0.0)
            axes.errorbar(sizes, 100.0 * share, away, color=colour, linewidth=3.0, linestyle=line, marker=marker,
                          markersize=9.0, elinewidth=1.2, label=f"from {start}", clip_on=False, zorder=3)  # fmt: skip
        axes.set_xscale("log")
        axes.set_xticks([0.1, 1.0, 10.0, 50.0], ["0.1", "1", "10", "50"])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_yticks([0, 50, 100])
        axes.set_ylim(-4.0, 104.0)
        axes.tick_params(labelsize=letters)
        axes.set_title(name, fontsize=letters, color=INK, loc="left")
    units = sorted({int(n) for by_start in found.values() for cells in by_start.values() for n in cells[:, 1]})
    number = str(units[0]) if len(units) == 1 else f"{units[0]} to {units[-1]}"
    figure.supxlabel("scale-factor error, %   (10 mrad of misalignment for 1 %)", fontsize=letters, color=INK)
    figure.supylabel("errors within 5 sigma, % of units", fontsize=letters, color=INK)
    handles, _ = panels[0, 0].get_legend_handles_labels()
    words = [f"start from {start}" for start in STARTS]
    title = f"{number} units a point; bars: 95 % intervals"
    figure.legend(handles[::-1], words[::-1], loc="outside upper left", ncols=2, fontsize=letters, frameon=False,
                  title=title, title_fontsize=letters, alignment="left")  # fmt: skip
    return figure


def temperature_figure() -> Figure:
    """Draw the errors of a unit over temperature."""
    rng = np.random.default_rng(20261202)
    return thermal_figure(srt.calibrate_thermal(Unit(rng).tests(rng)), title="Simulated unit")


PICTURES = {
    "fixture.png": fixture_figure,
    "calibration.png": demo_figure,
    "inspection.png": hand_figure,
    "convergence.png": convergence_figure,
    "temperature.png": temperature_figure,
}


def main() -> None:
    for name, draw in PICTURES.items():
        save_figure(draw(), FOLDER / name)
        print(f"Written: {FOLDER / name}")


if __name__ == "__main__":
    main()
