"""Tables and picture of the navigation example."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.reports.figures.style import BLUE, GREY, INK, MEDIUM, ORANGE, SKY, SMALL, VERMILION, Figure, LogLocator, style

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from navigation import DriftResult


LINES: Final = {
    "raw": (VERMILION, "-"),
    "raw, zeroed": (ORANGE, "--"),
    "calibrated": (BLUE, "-"),
    "calibrated, zeroed": (SKY, "--"),
    "perfect": (GREY, ":"),
}
DELTAS: Final = (("rotation", 1e3, "mrad"), ("velocity", 1.0, "m/s"), ("position", 1.0, "m"))
"""Preintegrated quantities: name, factor from SI, unit."""
SMALLEST_M: Final = 0.01
"""Lower limit of the axis, m."""


def tables(outcomes: Mapping[tuple[str, str], DriftResult], marks_min: Sequence[float]) -> str:
    """Write the results as Markdown tables: drifts at the end, ratios on the way, preintegration where there is any."""
    parts = [_drifts(outcomes, marks_min[-1]), _ratios(outcomes, marks_min)]
    if all(outcome.deltas["raw"] for outcome in outcomes.values()):
        parts.append(_deltas(outcomes))
    return "\n".join(parts)


def _drifts(outcomes: Mapping[tuple[str, str], DriftResult], minutes: float) -> str:
    forms = list(LINES)
    rows = [
        [vehicle, grade, *(_metres(float(np.median(outcome.at(minutes, form)))) for form in forms)]
        for (vehicle, grade), outcome in outcomes.items()
    ]
    return f"Horizontal drift after {minutes:g} minutes, median of the units:\n\n" + _markdown(
        ["vehicle", "grade", *forms], rows
    )


def _ratios(outcomes: Mapping[tuple[str, str], DriftResult], marks_min: Sequence[float]) -> str:
    pairs = (("raw", "calibrated"), ("raw, zeroed", "calibrated, zeroed"))
    rows = [
        [
            vehicle,
            grade,
            *(
                _two_digits(float(np.median(outcome.at(m, above)) / np.median(outcome.at(m, below))))
                for above, below in pairs
                for m in marks_min
            ),
        ]
        for (vehicle, grade), outcome in outcomes.items()
    ]
    header = [f"{title}, {m:g} min" for title in ("raw / calibrated", "both zeroed") for m in marks_min]
    return "Ratio of the median drifts:\n\n" + _markdown(["vehicle", "grade", *header], rows)


def _deltas(outcomes: Mapping[tuple[str, str], DriftResult]) -> str:
    forms = ("raw", "calibrated", "perfect")
    rows = []
    for (vehicle, grade), outcome in outcomes.items():
        medians = {form: np.median(np.vstack(outcome.deltas[form]), axis=0) for form in forms}
        cells = [
            " / ".join(_two_digits(float(medians[form][i] * factor)) for form in forms)
            for i, (_, factor, _) in enumerate(DELTAS)
        ]
        rows.append([vehicle, grade, *cells])
    header = [f"{what}, {unit}" for what, _, unit in DELTAS]
    return "Errors of gtsam's preintegration over 10 s, raw / calibrated / perfect, median:\n\n" + _markdown(
        ["vehicle", "grade", *header], rows
    )


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---", "---", *["---:"] * (len(header) - 2)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _two_digits(value: float) -> str:
    """Two digits, or one behind the point of a number from 1 to 10, without an exponent."""
    if not np.isfinite(value):
        return "∞"
    if value == 0.0:
        return "0"
    digits = max(1 - int(np.floor(np.log10(abs(value)))), -12)
    return f"{round(value, digits):.{max(digits, 0)}f}"


def _metres(value: float) -> str:
    return f"{_two_digits(value / 1e3)} km" if value >= 1e3 else f"{_two_digits(value)} m"


def drift_figure(outcomes: Mapping[tuple[str, str], DriftResult]) -> Figure:
    """Draw drift against time: a row for each vehicle, a column for each grade, the same scales throughout.

    Lines are medians of the units; raw and calibrated ones have a band from the best to the worst unit.
    """
    vehicles = list(dict.fromkeys(vehicle for vehicle, _ in outcomes))
    grades = list(dict.fromkeys(grade for _, grade in outcomes))
    figure = Figure(figsize=(10.5, 2.6 * len(vehicles) + 0.9), dpi=100, layout="constrained")
    grid = figure.subplots(len(vehicles), len(grades), squeeze=False, sharex=True, sharey=True)
    for (vehicle, grade), outcome in outcomes.items():
        axes = grid[vehicles.index(vehicle), grades.index(grade)]
        style(axes, grid="both")
        minutes = outcome.time_s[1:] / 60.0
        for form, (colour, dashes) in LINES.items():
            drifts = np.maximum(np.array(outcome.drifts[form])[:, 1:], SMALLEST_M)
            axes.plot(minutes, np.median(drifts, axis=0), color=colour, linestyle=dashes, linewidth=1.5, label=form)
            if form in ("raw", "calibrated"):
                axes.fill_between(
                    minutes, drifts.min(axis=0), drifts.max(axis=0), color=colour, alpha=0.15, linewidth=0
                )
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(base=100.0, numticks=12))
        if vehicle == vehicles[0]:
            axes.set_title(grade, fontsize=MEDIUM, color=INK)
        if vehicle == vehicles[-1]:
            axes.set_xlabel("minutes", fontsize=SMALL)
        if grade == grades[0]:
            axes.set_ylabel(f"{vehicle}: horizontal drift, m", fontsize=SMALL)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=SMALL)
    return figure
