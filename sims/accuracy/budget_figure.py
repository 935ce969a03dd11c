"""Figure of a budget: share of each source in the variance of every parameter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.reports.figures.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    SMALL,
    VERMILION,
    Figure,
    style,
    symbol,
)
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, SYMBOLS

if TYPE_CHECKING:
    from sims.accuracy.budget import Budget

_COLOURS: Final = (BLUE, SKY, PURPLE, VERMILION, ORANGE, GREEN, GREY, INK)
_HATCHES: Final = ("", "//", "..")
"""Hatches that distinguish sources if there are more sources than colours."""


def budget_figure(found: Budget, *, title: str = "") -> Figure:
    """Draw stacked bars of the variance shares of every parameter, with its sigma beside the bar."""
    total = found.total
    seen = np.flatnonzero(np.isfinite(total) & (total > 0.0))
    figure = Figure(figsize=(9.0, 1.6 + 0.27 * len(seen)), layout="constrained")
    axes = figure.subplots()
    left = np.zeros(len(seen))
    place = np.arange(len(seen))
    for k, (name, sigma) in enumerate(found.sources.items()):
        share = (sigma[seen] / total[seen]) ** 2
        colour, hatch = _COLOURS[k % len(_COLOURS)], _HATCHES[k // len(_COLOURS) % len(_HATCHES)]
        axes.barh(place, share, left=left, color=colour, hatch=hatch, edgecolor="white", label=name.replace("_", " "))
        left += share
    for y, i in zip(place.tolist(), seen.tolist(), strict=True):
        text = f"{total[i] * DISPLAY_FACTORS[i]:.3g} {DISPLAY_UNITS[i]}"
        axes.text(1.01, y, text, va="center", fontsize=SMALL)
    axes.set_yticks(place, [symbol(SYMBOLS[i]) for i in seen])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.16)
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25", "50", "75", "100 %"])
    axes.set_xlabel("share of the variance; one sigma in all beside the bar")
    axes.set_title(title or f"What limits the {found.estimator}")
    style(axes, grid="x")
    figure.legend(loc="outside lower center", ncols=3, fontsize=SMALL, frameon=False)
    return figure
