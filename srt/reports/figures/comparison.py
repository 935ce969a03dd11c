"""Figure of a comparison of calibrations. Needs matplotlib; its global state (pyplot, rcParams) is unchanged.

All values are over the sigma of the reference, so that parameters of all units share one axis.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.reports.figures.parameter_columns import (
    PLAIN,
    column_places,
    draw_rings,
    frame_columns,
    label_columns,
    ring_handle,
    title_groups,
)
from srt.reports.figures.style import (
    DPI,
    GREY,
    INK,
    LARGE,
    MEDIUM,
    Axes,
    ConstrainedLayoutEngine,
    Figure,
    Line2D,
    LogLocator,
    MaxNLocator,
    NullLocator,
    Patch,
    estimator_styles,
)
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from srt.comparison.estimator_comparison import Comparison
    from srt.types import Array


_SIZE_INCHES: Final = (14.0, 8.5)
_HEADING_WIDTH: Final = 140
_LINEAR_TO: Final = 12.0
"""Largest difference, in sigma, on a linear axis; beyond, the axis is logarithmic so that small ones stay visible."""


def comparison_figure(comparison: Comparison, *, title: str | None = None) -> Figure:
    """Draw differences from the reference with their expected sigmas, and the ratios of sigmas.

    The figure is not known to pyplot; :func:`srt.reports.figures.style.save_figure` writes it. Raises InputError if
    there is no usable estimate.
    """
    if comparison.reference is None:
        raise InputError("There is nothing to draw: no estimator gave a usable result.")
    layout = ConstrainedLayoutEngine(h_pad=0.08, w_pad=0.06, hspace=0.04)
    figure = Figure(figsize=_SIZE_INCHES, dpi=DPI, layout=layout)
    differences, ratios = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    names = [comparison.reference, *comparison.differences]
    styles = estimator_styles(names)
    places, width = column_places(len(names))
    for axes in (differences, ratios):
        frame_columns(axes)
    for name, at in zip(names, places, strict=True):
        _differences(differences, comparison, name, at, width, styles[name])
        _ratios(ratios, comparison, name, at, styles[name])
    _finish_differences(differences, comparison)
    _finish_ratios(ratios)
    outcome = f"{comparison.verdict} {comparison.verdicts_differ}".rstrip()
    heading = textwrap.fill(f"{title}: {outcome}" if title else outcome, _HEADING_WIDTH)
    figure.suptitle(heading, fontsize=LARGE, color=INK, x=0.01, ha="left")
    figure.legend(
        handles=_handles(comparison, names, styles), loc="outside lower center", ncols=6, fontsize=MEDIUM, frameon=False
    )
    return figure


def _differences(
    axes: Axes, comparison: Comparison, name: str, at: Array, width: float, style: tuple[str, str]
) -> None:
    """Draw one estimate less the reference, with its own sigma, on the band of its expected sigma."""
    colour, marker = style
    assert comparison.reference is not None
    reference = comparison.calibrations[comparison.reference]
    calibration = comparison.calibrations[name]
    unit, pair = reference.sigma, comparison.differences.get(name)
    seen = np.isfinite(unit) if pair is None else pair.compared
    value = np.zeros(N_PARAMETERS) if pair is None else pair.difference / unit
    if pair is not None:
        spread = pair.expected_sigma / unit
        axes.bar(at[seen], 2.0 * spread[seen], 0.95 * width, bottom=-spread[seen], color=colour, alpha=0.25)
        wrong = pair.differing
        draw_rings(axes, at[wrong], value[wrong])
    sigma = (calibration.sigma / unit)[seen]
    bars: dict[str, Any] = {"fmt": marker, "color": colour, "markersize": 5.0, "elinewidth": 1.1, "capsize": 2.0}
    axes.errorbar(at[seen], value[seen], sigma, **bars)


def _ratios(axes: Axes, comparison: Comparison, name: str, at: Array, style: tuple[str, str]) -> None:
    pair = comparison.differences.get(name)
    if pair is None:
        axes.axhline(1.0, color=style[0], linewidth=1.2)
    else:
        axes.plot(at[pair.compared], pair.sigma_ratio[pair.compared], style[1], color=style[0], markersize=5.0)


def _finish_differences(axes: Axes, comparison: Comparison) -> None:
    assert comparison.reference is not None
    unit = comparison.calibrations[comparison.reference].sigma
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    if comparison.truth is not None:
        error = (comparison.truth.vector - comparison.calibrations[comparison.reference].errors.vector) / unit
        axes.hlines(error, np.arange(N_PARAMETERS) - 0.45, np.arange(N_PARAMETERS) + 0.45, color=INK, linewidth=1.3)
    held = np.flatnonzero(~np.isfinite(unit))
    axes.plot(held, np.zeros(len(held)), "x", color=GREY, markersize=6.0)
    axes.set_ylabel(f"estimate − {comparison.reference},\nsigmas of {comparison.reference}", fontsize=MEDIUM)
    largest = max(map(abs, axes.get_ylim()))
    if largest > _LINEAR_TO:
        axes.set_yscale("symlog", linthresh=3.0, linscale=1.5)
        axes.set_ylim(-2.0 * largest, 2.0 * largest)
        axes.yaxis.set_major_formatter(PLAIN)
    else:
        axes.yaxis.set_major_locator(MaxNLocator(10, integer=True))
    title_groups(axes)


def _finish_ratios(axes: Axes) -> None:
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.8), max(high, 2.2))
    # A few ticks within the one octave that is usual, decades where there are many.
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if high < 20.0 * low else (1.0,)))
    axes.yaxis.set_major_formatter(PLAIN)
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylabel("ratio of sigmas", fontsize=MEDIUM)
    label_columns(axes)


def _handles(comparison: Comparison, names: list[str], styles: dict[str, tuple[str, str]]) -> list[Any]:
    """Handles of the legend."""
    handles: list[Any] = []
    for name in names:
        colour, marker = styles[name]
        label = f"{name} ±1σ" + (" (reference)" if name == comparison.reference else "")
        handles.append(Line2D([], [], color=colour, marker=marker, markersize=5.0, label=label))
    if comparison.differences:
        handles.append(Patch(color=GREY, alpha=0.25, label="expected difference, ±1σ"))
    if any(pair.differing.any() for pair in comparison.differences.values()):
        handles.append(ring_handle("beyond the limit"))
    if comparison.calibrations[names[0]].fixed:
        handles.append(Line2D([], [], color="none", marker="x", markeredgecolor=GREY, label=f"fixed by {names[0]}"))
    if comparison.truth is not None:
        handles.append(Line2D([], [], color=INK, linewidth=1.3, label="truth"))
    return handles
