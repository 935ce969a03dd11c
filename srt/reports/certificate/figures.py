"""Figures of a certificate, as SVG for the page and the PDF."""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import MICRO_G, STANDARD_GRAVITY_M_S2
from srt.model.table1 import AXES
from srt.reports.figures.calibration import draw_convergence, draw_errors, draw_residuals, draw_values
from srt.reports.figures.inspection import COLOURS, MARKERS, envelope, time_scale
from srt.reports.figures.style import (
    BLUE,
    FAINT,
    GREY,
    INK,
    VERMILION,
    Axes,
    ConstrainedLayoutEngine,
    Figure,
    Line2D,
    MaxNLocator,
    SubFigure,
    style,
)
from srt.sensor_errors import DISPLAY_UNITS, GROUP_SLICES, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.reports.certificate.content import Certificate

_COMMENT: Final = re.compile(r"<!--.*?-->\s*|<metadata>.*?</metadata>\s*", re.DOTALL)
_TEXT: Final = 8.5  # size of letters, points
_SVG_DPI: Final = 72  # points to an inch, the unit of matplotlib's SVG
_GRID: Final = (("ppm", "µg"), ("µrad", "°/h"))  # units of the panels of parameters, by rows


@dataclass(frozen=True, slots=True)
class CertificateFigure:
    """Figure of the certificate."""

    name: str  # a word, for identifiers
    title: str
    caption: str
    size_in: tuple[float, float]  # width and height, inches
    draw: Callable[[Certificate, Figure | SubFigure], None]  # into a figure or a part of one


def certificate_figures(certificate: Certificate) -> tuple[CertificateFigure, ...]:
    """Figures for which the calibration has data."""
    calibration = certificate.source.calibration
    shown = {
        "parameters": True,
        "residuals": any(r.sigma > 0.0 for r in calibration.residuals),
        "test": certificate.course is not None,
        "convergence": any(c > 0.0 for c in calibration.corrections),
        "correlation": int(calibration.observed.sum()) > 1,
    }
    return tuple(p for p in _FIGURES if shown[p.name])


@lru_cache(maxsize=8)
def figure_svg(certificate: Certificate, figure: CertificateFigure) -> str:
    """Draw a figure as SVG, once for the page and the PDF; the same certificate gives the same text."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    layout = ConstrainedLayoutEngine(h_pad=0.04, w_pad=0.03, hspace=0.03, wspace=0.02)
    drawing = Figure(figsize=figure.size_in, dpi=_SVG_DPI, layout=layout)
    figure.draw(certificate, drawing)
    FigureCanvasSVG(drawing)  # measures texts for the layout as SVG has them
    written = io.BytesIO()
    # Identifiers in the file are random numbers without a salt; the setting is restored at once.
    with mpl.rc_context({"svg.hashsalt": "srt", "svg.fonttype": "path"}), warnings.catch_warnings():
        # Letters that the font lacks show as boxes in the figure; the tables have them.
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        # With an engine of its layout, a figure is drawn once more than it is written.
        layout.execute(drawing)
        drawing.set_layout_engine(None)
        nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
        drawing.savefig(written, format="svg", transparent=True, metadata=nothing)
    text = written.getvalue().decode("utf-8")
    return _COMMENT.sub("", text[text.index("<svg") :]).strip()


def _parameters(certificate: Certificate, figure: Figure | SubFigure) -> None:
    calibration = certificate.source.calibration
    members = {unit: np.flatnonzero([u == unit for u in DISPLAY_UNITS]) for row in _GRID for unit in row}
    parts = figure.subfigures(len(_GRID), 1, squeeze=False)[:, 0]
    for part, units in zip(parts, _GRID, strict=True):
        widths = [len(members[unit]) + 1.8 for unit in units]
        grid = part.subplots(2, 2, sharex="col", width_ratios=widths, height_ratios=(1.25, 1.0))
        for column, unit in enumerate(units):
            draw_values(grid[0, column], calibration, None, members[unit])
            draw_errors(grid[1, column], calibration, None, members[unit])
            grid[1, column].set_title("±1 sigma", fontsize=_TEXT, color=INK, loc="left")
            for axes in grid[:, column]:
                _set_label_sizes(axes)


def _residuals(certificate: Certificate, figure: Figure | SubFigure) -> None:
    axes = figure.subplots()
    draw_residuals(axes, certificate.source.calibration.residuals, letters=_TEXT)
    axes.set_ylabel("residual / sigma", fontsize=_TEXT, color=INK)
    figure.legend(loc="outside upper left", ncols=4, fontsize=_TEXT, frameon=False, labelcolor=INK)
    _set_label_sizes(axes)


def _test(certificate: Certificate, figure: Figure | SubFigure) -> None:
    course = certificate.course
    assert course is not None
    scale, unit = time_scale(course.duration_s)
    attitude, force, excess = figure.subplots(3, 1, sharex=True, height_ratios=(1.2, 1.2, 0.8))
    at, drawn = envelope(course.samples, course.force / STANDARD_GRAVITY_M_S2, course.breaks)
    middle = course.rest.mean(axis=1) / scale
    for axis, colour in enumerate(COLOURS):
        attitude.plot(course.time / scale, course.down[:, axis], color=colour, linewidth=0.9)
        attitude.plot(middle, course.rest_down[:, axis], MARKERS[axis], color=colour, markersize=3.0)
        force.plot(at / scale, drawn[:, axis], color=colour, linewidth=0.7, alpha=0.85)
    excess.axhline(0.0, color=GREY, linewidth=0.8)
    excess.plot(middle, course.excess / MICRO_G, "o", color=BLUE, markersize=3.0)
    for axes, title in (
        (attitude, "Attitude: down in IMU axes (lines: gyros, marks: accelerometers at rest)"),
        (force, "Corrected specific force in IMU axes, g"),
        (excess, "Specific force at rest less gravity, µg"),
    ):
        style(axes)
        axes.set_title(title, fontsize=_TEXT, color=INK, loc="left")
        axes.yaxis.set_major_locator(MaxNLocator(5))
        _set_label_sizes(axes)
    excess.set_xlabel(f"time, {unit}", fontsize=_TEXT, color=INK)
    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=3.0, label=axis)
        for axis, colour, marker in zip(AXES, COLOURS, MARKERS, strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3, fontsize=_TEXT, frameon=False, labelcolor=INK)


def _convergence(certificate: Certificate, figure: Figure | SubFigure) -> None:
    axes = figure.subplots()
    draw_convergence(axes, certificate.source.calibration)
    axes.set_title("", loc="left")
    axes.set_xlabel("iteration", fontsize=_TEXT, color=INK)
    axes.set_ylabel("largest correction", fontsize=_TEXT, color=INK)
    _set_label_sizes(axes)


def _correlation(certificate: Certificate, figure: Figure | SubFigure) -> None:
    calibration = certificate.source.calibration
    seen = np.flatnonzero(calibration.observed)
    sigma = calibration.sigma[seen]
    C = calibration.covariance[np.ix_(seen, seen)] / np.outer(sigma, sigma)
    # Magnitude as opacity: zero correlation shows the background, light or dark.
    picture = np.empty((*C.shape, 4))
    colours = np.array([[int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)] for colour in (BLUE, VERMILION)])
    picture[..., :3] = colours[(C > 0.0).astype(int)]
    picture[..., 3] = np.clip(np.abs(C), 0.0, 1.0)
    axes = figure.subplots()
    # Squares, not an image: typesetters of SVG know paths.
    edges = np.arange(len(seen) + 1) - 0.5
    axes.pcolormesh(edges, edges, picture, linewidth=0.0)
    axes.set_aspect("equal")
    axes.invert_yaxis()
    labels = [SYMBOLS[i] for i in seen]
    axes.set_xticks(range(len(seen)), labels, rotation=90, fontsize=_TEXT)
    axes.set_yticks(range(len(seen)), labels, fontsize=_TEXT)
    axes.tick_params(length=0.0, labelcolor=INK)
    starts = {group.start for group in GROUP_SLICES.values()}
    for n, i in enumerate(seen.tolist()):
        if n and i in starts:
            axes.axhline(n - 0.5, color=GREY, linewidth=0.6)
            axes.axvline(n - 0.5, color=GREY, linewidth=0.6)
    for spine in axes.spines.values():
        spine.set_color(GREY)
    handles = [
        Line2D([], [], color=colour, marker="s", linestyle="none", markersize=7.0, label=label)
        for label, colour in (("positive", VERMILION), ("negative", BLUE), ("none", FAINT))
    ]
    handles[-1].set_markerfacecolor("none")
    figure.legend(handles=handles, loc="outside upper left", ncols=3, fontsize=_TEXT, frameon=False, labelcolor=INK)


def _set_label_sizes(axes: Axes) -> None:
    """Set the sizes of all numbers of a panel."""
    axes.tick_params(labelsize=_TEXT)
    axes.yaxis.get_offset_text().set_fontsize(_TEXT)


_FIGURES: Final = (
    CertificateFigure(
        "parameters",
        "Parameters with their error bars",
        "Values, and below them their 1-sigma bars on a scale of their own. A cross marks a fixed parameter.",
        (7.0, 7.2),
        _parameters,
    ),
    CertificateFigure(
        "residuals",
        "Residuals of the sequences",
        "Residuals over their expected sigma: two in three are expected between the dashed lines.",
        (7.0, 2.7),
        _residuals,
    ),
    CertificateFigure(
        "test",
        "Attitude and acceleration over the test",
        "Lines: attitude from the gyros. Marks: attitude from the accelerometers. For a correct calibration each line "
        "ends on its mark, and the specific force in the stationary windows equals gravity.",
        (7.0, 6.0),
        _test,
    ),
    CertificateFigure(
        "convergence",
        "Convergence of the iterations",
        "Largest correction of any parameter (accelerometer bias in g) in each iteration.",
        (7.0, 2.3),
        _convergence,
    ),
    CertificateFigure(
        "correlation",
        "Correlation of the errors",
        "Correlation coefficients of the errors; opacity shows the magnitude. Use the covariance in the calibration "
        "file where several parameters are combined.",
        (6.4, 6.4),
        _correlation,
    ),
)
