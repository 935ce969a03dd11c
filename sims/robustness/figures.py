"""Figures of a campaign: maps of convergence, error against an axis, consistency of the sigmas, iterations and time.

The module needs matplotlib and does not change its global state (pyplot, rcParams). Names come from files and are
shown unchanged.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from sims.robustness.convergence import percent
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
    FAINT,
    GREY,
    INK,
    MEDIUM,
    SMALL,
    Axes,
    ConstrainedLayoutEngine,
    Figure,
    Line2D,
    LogLocator,
    MaxNLocator,
    NullLocator,
    Patch,
    estimator_styles,
    style,
)
from srt.sensor_errors import GROUPS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sims.robustness.convergence import ConvergenceMap
    from sims.robustness.error_statistics import Accuracy, SigmaConsistency
    from sims.robustness.summary import Effort
    from srt.types import Array


_PANELS: Final = 3
"""Number of maps in a row."""
_MOST_LABELS: Final = 14
"""Maximum number of labels of an axis; with more levels, every second (third, ...) level is labelled."""
_LINEAR_TO: Final = 4.0
"""Largest error / sigma on a linear axis; with larger values, the axis is logarithmic."""
_COLOURS: Final = "cividis"
"""Colour map readable with any colour vision; light for large shares."""


def map_figure(found: ConvergenceMap, estimators: Sequence[str]) -> Figure:
    """Draw the share of converged trials over two axes, one panel per estimator; hatched without trials.

    Parameters
    ----------
    found : ConvergenceMap
    estimators : sequence of str

    Returns
    -------
    matplotlib.figure.Figure
        Not registered in pyplot.
    """
    share = found.share
    number, levels_up, levels_across = share.shape
    columns = min(number, _PANELS)
    rows = -(-number // columns)
    width, height = max(3.4, 0.42 * levels_across + 1.2), max(1.9, 0.34 * levels_up + 1.3)
    figure = _figure(width * columns + 1.0, height * rows + 0.4)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    mesh: Any = None
    for k, (axes, name) in enumerate(zip(panels, estimators, strict=False)):
        mesh = axes.pcolormesh(
            np.arange(levels_across + 1) - 0.5,
            np.arange(levels_up + 1) - 0.5,
            np.ma.masked_invalid(100.0 * share[k]),
            cmap=_COLOURS,
            vmin=0.0,
            vmax=100.0,
            edgecolors="white",
            linewidth=0.6,
        )
        _write_shares(axes, share[k], found.share_beyond[k])
        axes.set_title(_plain(name), fontsize=MEDIUM, color=INK, loc="left")
        _levels(axes, "x", found.across)
        _levels(axes, "y", found.up)
        axes.tick_params(labelsize=SMALL, color=GREY, labelcolor=INK)
        for side in axes.spines.values():
            side.set_visible(False)
    for axes in panels[number:]:
        axes.set_visible(False)
    bar = figure.colorbar(mesh, ax=panels.tolist(), fraction=0.04, pad=0.015)
    bar.set_label("converged, % of the trials", fontsize=MEDIUM)
    bar.ax.tick_params(labelsize=SMALL)
    bar.outline.set_visible(False)
    return figure


def _write_shares(axes: Axes, share: Array, beyond: Array) -> None:
    """Write the shares into every cell, that with errors beyond their sigmas below, and hatch cells without trials."""
    size = min(SMALL, 90.0 / max(share.shape[1], 10))
    for (up, across), value in np.ndenumerate(share):
        if np.isfinite(value):
            colour = INK if value > 0.55 else "white"
            off = float(beyond[up, across])
            text = percent(value) + (f"\n({percent(off)})" if off else "")
            axes.text(across, up, text, ha="center", va="center", fontsize=size, color=colour, linespacing=0.9)
    up, across = np.nonzero(~np.isfinite(share))
    axes.bar(across, 1.0, 1.0, bottom=up - 0.5, hatch="////", facecolor="white", edgecolor=FAINT, linewidth=0.0)
    axes.set_xlim(-0.5, share.shape[1] - 0.5)
    axes.set_ylim(-0.5, share.shape[0] - 0.5)


def _levels(axes: Axes, side: str, axis: Any) -> None:
    """Label the levels of one side of a map."""
    labels = ("all",) if axis is None else axis.labels
    every = -(-len(labels) // _MOST_LABELS)
    places, words = range(0, len(labels), every), [_plain(_short(word)) for word in labels[::every]]
    name = "" if axis is None else _plain(axis.name)
    if side == "x":
        long = len(words) > 5 and sum(map(len, words)) > 30
        axes.set_xticks(places, words, rotation=40.0 if long else 0.0, ha="right" if long else "center")
        axes.set_xlabel(name, fontsize=MEDIUM)
    else:
        axes.set_yticks(places, words)
        axes.set_ylabel(name, fontsize=MEDIUM)


def size_figure(found: Accuracy, estimators: Sequence[str], *, noisy: bool) -> Figure:
    """Draw the error of converged trials against one axis: rms (lines) and largest (thin), by group of parameters.

    Parameters
    ----------
    found : Accuracy
        Errors against an axis.
    estimators : sequence of str
    noisy : bool
        True: add a panel with error / sigma.
    """
    assert found.axis is not None
    axis = found.axis
    figure = _figure(11.5, 8.6)
    panels = figure.subplots(3, 3, sharex=True).ravel()
    at = axis.positions if axis.numeric else np.arange(len(axis.labels), dtype=np.float64)
    titles = [f"{group.name.replace('_', ' ')}, {group.display_unit}" for group in GROUPS]
    rms, largest = found.array("rms"), found.array("largest")
    for group, axes in enumerate(panels[: len(GROUPS)]):
        _against(axes, at, rms[..., group], largest[..., group], estimators)
    count = found.array("count")
    weight = count.sum(axis=2)
    square = np.nansum(count * np.nan_to_num(found.array("rms_in_sigma")) ** 2, axis=2)
    together = np.where(weight > 0, np.sqrt(square / np.maximum(weight, 1)), np.nan)
    largest_in_sigma = np.where(weight > 0, np.nan_to_num(found.array("largest_in_sigma")).max(axis=2), np.nan)
    last = panels[len(GROUPS)]
    if noisy:
        _against(last, at, together, largest_in_sigma, estimators)
        last.axhline(1.0, color=GREY, linewidth=0.8)
        titles.append("all parameters, in sigmas")
    else:
        last.set_visible(False)
        for axes in panels[3:6]:
            axes.xaxis.set_tick_params(labelbottom=True)
    for axes, title in zip(panels, titles, strict=False):
        axes.set_title(title, fontsize=MEDIUM, color=INK, loc="left")
        if not axis.numeric:
            every = -(-len(axis.labels) // _MOST_LABELS)
            words = [_plain(_short(word)) for word in axis.labels[::every]]
            axes.set_xticks(range(0, len(axis.labels), every), words, rotation=25.0 if len(words) > 3 else 0.0)
    for axes in panels[6:]:
        axes.set_xlabel(_plain(axis.name), fontsize=MEDIUM)
    handles = [
        *_handles(estimators),
        Line2D([], [], color=GREY, linewidth=1.6, label="root mean square"),
        Line2D([], [], color=GREY, linewidth=0.8, linestyle="--", label="largest"),
    ]
    _legend(figure, handles)
    return figure


def _against(axes: Axes, at: Array, rms: Array, largest: Array, estimators: Sequence[str]) -> None:
    style(axes, grid="both")
    for k, (colour, marker) in enumerate(estimator_styles(estimators).values()):
        # A logarithmic axis cannot show zero.
        for values, line in ((rms[k], "-"), (largest[k], "--")):
            shown = np.where(values > 0.0, values, np.nan)
            heavy = line == "-"
            axes.plot(at, shown, line, marker=marker if heavy else "", color=colour, markersize=4.5,
                      linewidth=1.6 if heavy else 0.8)  # fmt: skip
    positive = np.nan_to_num(np.concatenate((rms, largest)))
    positive = positive[positive > 0.0]
    if positive.size:
        axes.set_yscale("log")
        axes.set_ylim(positive.min() / 1.4, positive.max() * 1.4)
        _log_ticks(axes.yaxis, float(positive.max() / positive.min()))


def _log_ticks(axis: Any, ratio: float) -> None:
    """Label 1, 2, 5 on an axis of few decades, which may otherwise have no labelled tick."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ratio < 200.0 else (1.0,), numticks=8))
    axis.set_major_formatter(PLAIN)
    axis.set_minor_locator(NullLocator())


def consistency_figure(found: SigmaConsistency, estimators: Sequence[str]) -> Figure:
    """Draw rms of error / sigma of every parameter over the band of a consistent one, with rings beyond the limits.

    Parameters
    ----------
    found : SigmaConsistency
    estimators : sequence of str
    """
    figure = _figure(12.5, 4.8)
    axes = figure.subplots()
    frame_columns(axes)
    places, width = column_places(len(estimators))
    table = found.parameters
    for name, (colour, marker), at in zip(estimators, estimator_styles(estimators).values(), places, strict=True):
        own = table.loc[name]
        half, rms = own["half_width"].to_numpy(), own["rms"].to_numpy()
        seen = np.isfinite(rms)
        low = np.maximum(1.0 - half[seen], 0.0)
        axes.bar(at[seen], 1.0 + half[seen] - low, 0.95 * width, bottom=low, color=colour, alpha=0.25)
        axes.plot(at[seen], rms[seen], marker, color=colour, markersize=5.0)
        off = (own["too_small"] | own["too_large"]).to_numpy()
        draw_rings(axes, at[off], rms[off])
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    low = np.nanmin(np.minimum(table["rms"], np.maximum(1.0 - table["half_width"], 0.0)), initial=1.0)
    high = np.nanmax(np.maximum(table["rms"], 1.0 + table["half_width"]), initial=1.0)
    if high > _LINEAR_TO:
        low = np.nanmin(table["rms"], initial=1.0)
        axes.set_yscale("log")
        axes.set_ylim(max(0.8 * low, 1e-3), 1.3 * high)
        _log_ticks(axes.yaxis, high / max(low, 1e-3))
    else:
        room = 0.12 * (high - low)
        axes.set_ylim(max(low - room, 0.0), high + room)
    title_groups(axes)
    label_columns(axes)
    axes.set_ylabel("rms of error / sigma", fontsize=MEDIUM)
    handles = [*_handles(estimators), Patch(color=GREY, alpha=0.25, label="3.5 standard errors about 1")]
    handles.append(ring_handle("beyond the limits of all tests"))
    _legend(figure, handles)
    return figure


def effort_figure(found: Effort, estimators: Sequence[str]) -> Figure:
    """Draw the number of iterations of converged trials, and the CPU time of a calibration.

    Parameters
    ----------
    found : Effort
    estimators : sequence of str
    """
    figure = _figure(11.5, 3.6 + 0.1 * len(estimators))
    histogram, times = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    style(histogram)
    style(times, grid="x")
    counts, playbacks = found.histogram.to_numpy(), found.histogram.columns.to_numpy()
    share = 100.0 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    median, most = found.table["seconds"].to_numpy(), found.table["seconds_95"].to_numpy()
    width = 0.85 / max(len(estimators), 1)
    for k, (colour, marker) in enumerate(estimator_styles(estimators).values()):
        at = playbacks + width * (k - 0.5 * (len(estimators) - 1))
        histogram.bar(at, share[k], width, color=colour)
        if np.isfinite(median[k]):
            times.plot([median[k], most[k]], [k, k], color=colour, linewidth=2.0)
            times.plot(median[k], k, marker, color=colour, markersize=6.0)
            times.plot(most[k], k, "|", color=colour, markersize=11.0, markeredgewidth=2.0)
    histogram.xaxis.set_major_locator(MaxNLocator(12, integer=True))
    histogram.set_xlabel("iterations until converged", fontsize=MEDIUM)
    histogram.set_ylabel("% of the converged trials", fontsize=MEDIUM)
    times.set_yticks(range(len(estimators)), [_plain(name) for name in estimators])
    times.set_ylim(len(estimators) - 0.5, -0.5)
    if (np.nan_to_num(median) > 0.0).any():
        times.set_xscale("log")
        low, high = max(np.nanmin(median), 1e-6), np.nanmax(most)
        times.set_xlim(0.5 * low, 2.0 * high)
        _log_ticks(times.xaxis, 4.0 * high / low)
    times.set_xlabel("CPU seconds: median and 95 %", fontsize=MEDIUM)
    _legend(figure, _handles(estimators))
    return figure


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), dpi=DPI, layout=ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.06))


def _legend(figure: Figure, handles: list[Any]) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=MEDIUM, frameon=False)


def _handles(estimators: Sequence[str]) -> list[Any]:
    return [
        Line2D([], [], color=colour, marker=marker, markersize=5.0, label=_plain(name))
        for name, (colour, marker) in zip(estimators, estimator_styles(estimators).values(), strict=True)
    ]


def _short(word: str, length: int = 22) -> str:
    return word if len(word) <= length else word[: length - 1] + "…"


def _plain(text: str) -> str:
    """Text that matplotlib shows unchanged: no formula, and no leading underscore, which hides a legend entry."""
    shown = "".join(c if c.isprintable() else "?" for c in text).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown
