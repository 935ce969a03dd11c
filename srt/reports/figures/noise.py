"""Figure of the noise of a unit at rest: Allan deviation of the six channels with the terms by maximum likelihood."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from srt.constants import DEG_PER_H, MICRO_G
from srt.reports.figures.inspection import allan_panel
from srt.reports.figures.style import DPI, INK, LARGE, MEDIUM, ConstrainedLayoutEngine, Figure

if TYPE_CHECKING:
    from srt.noise.allan import AllanDeviation
    from srt.noise.noise_terms import NoiseTerms

_SIZE_INCHES: Final = (12.0, 5.5)


def noise_figure(terms: NoiseTerms, allan: AllanDeviation, *, title: str | None = None) -> Figure:
    """Draw the Allan deviation with 95 % intervals, and the curves of the resolved terms."""
    figure = Figure(figsize=_SIZE_INCHES, dpi=DPI, layout=ConstrainedLayoutEngine())
    for sensor, (si, unit) in enumerate(((DEG_PER_H, "°/h"), (MICRO_G, "µg"))):
        axes = figure.add_subplot(1, 2, sensor + 1)
        allan_panel(axes, allan, sensor, si, unit, terms)
        axes.set_xlabel("averaging time, s", fontsize=MEDIUM, color=INK)
    figure.suptitle(f"Allan deviation{f' of {title}' if title else ''}", fontsize=LARGE, color=INK)
    return figure
