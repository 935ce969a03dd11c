"""Figure of errors over temperature: a panel for each group of errors, curves with bands of their sigmas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.reports.figures.style import (
    BLUE,
    DPI,
    GREEN,
    GREY,
    INK,
    LARGE,
    MEDIUM,
    ORANGE,
    PURPLE,
    SKY,
    SMALL,
    VERMILION,
    ConstrainedLayoutEngine,
    Figure,
    style,
    symbol,
)
from srt.reports.parameters import units_for
from srt.sensor_errors import GROUP_SLICES, GROUPS, NAMES, SYMBOLS

if TYPE_CHECKING:
    from srt.result.calibration import Calibration

_SIZE_INCHES: Final = (14.0, 7.6)
_POINTS: Final = 81
_COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
_READING: Final = (
    "Lines: errors as curves. Bands: ±1 sigma of a later visit of the temperature. Marks on the axes: temperatures of "
    "the tests."
)


def thermal_figure(calibration: Calibration, *, title: str | None = None) -> Figure:
    """Draw the errors of a calibration over temperature; the figure is not known to pyplot."""
    thermal = calibration.thermal
    assert thermal is not None
    T = np.linspace(thermal.lowest_c, thermal.highest_c, _POINTS)
    at = [calibration.at(t) for t in T.tolist()]
    values = np.stack([each.errors.vector for each in at])
    sigma = np.stack([np.nan_to_num(each.sigma) for each in at])
    units = units_for(*values)
    layout = ConstrainedLayoutEngine(h_pad=0.07, w_pad=0.06, hspace=0.04, wspace=0.03)
    figure = Figure(figsize=_SIZE_INCHES, dpi=DPI, layout=layout)
    columns = -(-len(GROUPS) // 2)
    for axes, group in zip(figure.subplots(2, columns, sharex=True, squeeze=False).flat, GROUPS, strict=False):
        style(axes)
        part = GROUP_SLICES[group.name]
        for colour, k in zip(_COLOURS, range(part.start, part.stop), strict=False):
            if NAMES[k] in calibration.fixed:
                continue
            value, spread = values[:, k] * units.factors[k], sigma[:, k] * units.factors[k]
            axes.fill_between(T, value - spread, value + spread, color=colour, alpha=0.18, linewidth=0.0)
            axes.plot(T, value, color=colour, linewidth=1.5, label=symbol(SYMBOLS[k]))
        low, _ = axes.get_ylim()
        axes.plot(thermal.tests_c, np.full(len(thermal.tests_c), low), "^", color=GREY, markersize=6.0, clip_on=False)
        axes.set_ylim(bottom=low)
        name = group.name.replace("_", " ")
        axes.set_title(f"{name}, {units.names[part.start]}", fontsize=MEDIUM, color=INK, loc="left")
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=SMALL, frameon=False, ncols=3, handlelength=1.2, columnspacing=1.0)
    figure.supxlabel(f"temperature, °C\n{_READING}", fontsize=SMALL, color=INK)
    heading = f"{title}: {calibration.message}" if title else calibration.message
    figure.suptitle(heading, fontsize=LARGE, color=INK, x=0.01, ha="left")
    return figure
