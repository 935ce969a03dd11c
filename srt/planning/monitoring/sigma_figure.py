"""Figure of a running test: the sigma of each group of parameters against the sequences."""

from __future__ import annotations

from typing import TYPE_CHECKING

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
)
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.planning.monitoring.accuracy import SequenceAccuracy

_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, INK, GREY)
_MARKERS = "osD^v<>P"


def sigma_figure(
    history: Sequence[SequenceAccuracy], targets: Mapping[str, float] | None = None, *, title: str = ""
) -> Figure:
    """Draw the largest sigma of each group after every sequence, one panel a unit.

    Parameters
    ----------
    targets : mapping of str to float, SI, optional
        Dashed lines: the smallest target of each group.
    """
    units = list(dict.fromkeys(DISPLAY_UNITS[part.start] for part in GROUP_SLICES.values()))
    figure = Figure(figsize=(11.0, 6.4), dpi=DPI, layout=ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.06, hspace=0.04))
    panels = figure.subplots(2, 2, sharex=True).ravel()
    sigma = np.array([after.sigma for after in history]).reshape(len(history), -1)
    at = np.arange(1, len(history) + 1)
    for axes, unit in zip(panels, units, strict=True):
        style(axes)
        axes.set_yscale("log")
        axes.set_ylabel(f"largest 1-sigma, {unit}", fontsize=MEDIUM, color=INK)
        axes.set_xlim(0.5, max(len(history), 1) + 0.5)
        for k, (name, part) in enumerate(GROUP_SLICES.items()):
            if DISPLAY_UNITS[part.start] != unit:
                continue
            factor = DISPLAY_FACTORS[part.start]
            largest = sigma[:, part].max(axis=1) * factor if len(history) else np.zeros(0)
            known = np.isfinite(largest)
            axes.plot(at[known], largest[known], color=_COLOURS[k], marker=_MARKERS[k], markersize=5.0, linewidth=1.4,
                      label=name.replace("_", " "))  # fmt: skip
            wanted = [value for each, value in (targets or {}).items() if part.start <= INDEX[each] < part.stop]
            if wanted:
                axes.axhline(min(wanted) * factor, color=_COLOURS[k], linestyle="--", linewidth=1.2)
        axes.legend(fontsize=SMALL, frameon=False, loc="upper right")
    for axes in panels[2:]:
        axes.set_xticks(at, [after.sequence for after in history], fontsize=SMALL)
        axes.set_xlabel("after sequence", fontsize=MEDIUM, color=INK)
    note = "; dashed: target" if targets else ""
    heading = f"{title}: sigma after each sequence" if title else "Sigma after each sequence"
    figure.suptitle(f"{heading}{note}", fontsize=LARGE, color=INK, x=0.01, ha="left")
    return figure
