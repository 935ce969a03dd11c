"""Panels with one column for each parameter, in which the marks of several estimators stand side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.reports.figures.style import GREY, INK, MEDIUM, SYMBOL, Axes, FuncFormatter, Line2D, style, symbol
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SYMBOLS

if TYPE_CHECKING:
    from srt.types import Array

_ROOM: Final = 0.72  # share of a column that the marks of all estimators take up

PLAIN: Final = FuncFormatter(lambda value, _: f"{value:g}")
"""Labels of an axis without exponents, on logarithmic axes too."""


def column_places(estimators: int) -> tuple[Array, float]:
    """Places of the marks, shape (estimators, 27), and the width of one."""
    width = _ROOM / max(estimators, 1)
    shift = np.arange(estimators) - 0.5 * (estimators - 1)
    return np.arange(N_PARAMETERS) + width * shift[:, None], width


def frame_columns(axes: Axes) -> None:
    """Frame a panel, and separate the groups of parameters by lines."""
    style(axes)
    for group in GROUP_SLICES.values():
        if group.start:
            axes.axvline(group.start - 0.5, color=GREY, linewidth=0.7)


def title_groups(axes: Axes) -> None:
    """Write the names of the groups above a panel."""
    for name, group in GROUP_SLICES.items():
        middle = 0.5 * (group.start + group.stop - 1)
        axes.text(middle, 1.0, name.replace("_", "\n"), transform=axes.get_xaxis_transform(), ha="center", va="bottom",
                  fontsize=MEDIUM, color=INK)  # fmt: skip


def label_columns(axes: Axes) -> None:
    """Write the symbols of the parameters below a panel."""
    axes.set_xlim(-0.6, N_PARAMETERS - 0.4)
    axes.set_xticks(range(N_PARAMETERS), [symbol(name) for name in SYMBOLS], fontsize=SYMBOL)


def draw_rings(axes: Axes, at: Array, values: Array) -> None:
    """Draw rings around marks that are beyond their limit."""
    axes.plot(at, values, "o", markersize=12.0, markerfacecolor="none", markeredgecolor=INK)


def ring_handle(label: str) -> Any:
    """Handle of the rings in a legend."""
    ring: dict[str, Any] = {"marker": "o", "markersize": 11.0, "markerfacecolor": "none", "markeredgecolor": INK}
    return Line2D([], [], linestyle="none", label=label, **ring)
