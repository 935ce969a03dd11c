"""Figure of an inspection: readings over time with stationary windows and rotations, and the Allan deviation."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.model.table1 import AXES
from srt.noise.allan import TERMS
from srt.noise.noise_terms import ALL_TERMS
from srt.reports.figures.style import (
    BLUE,
    DPI,
    GREEN,
    GREY,
    INK,
    LARGE,
    MEDIUM,
    SKY,
    SMALL,
    VERMILION,
    Axes,
    ConstrainedLayoutEngine,
    Figure,
    FuncFormatter,
    Line2D,
    LogLocator,
    MaxNLocator,
    NullLocator,
    Patch,
    save_figure,
    style,
)
from srt.reports.inspection import inspect

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from srt.noise.allan import AllanDeviation, Term
    from srt.noise.noise_terms import NoiseTerms
    from srt.recording.recording import Recording
    from srt.reports.inspection import Inspection, ManoeuvreSummary
    from srt.types import Array, Indices

__all__ = ["envelope", "inspection_figure", "save_figure"]

_SIZE_INCHES: Final = (15.0, 8.5)
COLOURS: Final = (BLUE, VERMILION, GREEN)
MARKERS: Final = ("o", "s", "^")
"""Colours and markers of the axes x, y and z."""
_COLUMNS: Final = 1500
"""Number of intervals of time for a long recording, each drawn by its smallest and largest reading: one per pixel."""
_ALPHA: Final = 0.8  # opacity of a line, so that the noise of one axis does not hide that of the others
_VISIBLE_GAP: Final = 1e-3  # fraction of the duration from which a gap is visible: about a pixel
_IN_MINUTES: Final = 1200.0  # duration from which the time axis is in minutes, s
_ROOM: Final = 0.011  # width of a label of a rotation, as a fraction of that of the panel
_FEW_DECADES: Final = 300.0  # range of an axis below which it has ticks at 1, 2 and 5, not at decades alone
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")
_STEEP: Final[dict[str, Any]] = {
    "quantization": ":",
    "random_walk": "--",
    "bias_instability": "-.",
    "bias_random_walk": (0, (1, 4)),
    "rate_ramp": (0, (6, 2)),
}


def inspection_figure(
    recording: Recording, inspection: Inspection | None = None, *, title: str | None = None
) -> Figure:
    """Draw a recording and its inspection, which is made if absent.

    The figure is not known to pyplot; :func:`save_figure` writes it.
    """
    inspection = inspection or inspect(recording)
    layout = ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.06, hspace=0.03, wspace=0.03)
    figure = Figure(figsize=_SIZE_INCHES, dpi=DPI, layout=layout)
    allan = inspection.allan
    ratios = (1.0,) if allan is None else (2.1, 1.0)
    grid = figure.subplots(2, len(ratios), squeeze=False, sharex="col", width_ratios=ratios)
    scale, unit = time_scale(inspection.stamps.duration_s)
    per_rate = recording.rates_factor
    time = recording.time
    panels = ((recording.gyro, DEG, "gyros, °/s"), (recording.accel, STANDARD_GRAVITY_M_S2, "specific force, g"))
    for axes, (values, si, label) in zip(grid[:, 0], panels, strict=True):
        style(axes)
        _rests(axes, inspection, scale)
        at, drawn = envelope(time, values, _visible_gaps(recording))
        for axis, colour in enumerate(COLOURS):
            axes.plot(at / scale, drawn[:, axis] * (per_rate / si), color=colour, linewidth=0.8, alpha=_ALPHA)
        axes.set_ylabel(label, fontsize=MEDIUM, color=INK)
        axes.yaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10]))
    grid[0, 0].set_xlim(inspection.stamps.first_s / scale, time[-1] / scale)
    grid[1, 0].set_xlabel(f"time, {unit}", fontsize=MEDIUM, color=INK)
    _name_turns(grid[0, 0], inspection, scale)
    if allan is not None:
        for sensor, (axes, si, label) in enumerate(zip(grid[:, 1], (DEG_PER_H, MICRO_G), ("°/h", "µg"), strict=True)):
            allan_panel(axes, allan, sensor, si, label)
        grid[0, 1].set_title("Allan deviation at rest", fontsize=MEDIUM, color=INK, loc="left")
        grid[1, 1].set_xlabel("averaged over, s", fontsize=MEDIUM, color=INK)
    heading = inspection.summary if title is None else f"{title}: {inspection.summary}"
    figure.suptitle(_shortened(heading), fontsize=LARGE, color=INK, x=0.01, ha="left")
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=colour, marker=marker if allan is not None else "", markersize=4.0, label=axis)
        for axis, colour, marker in zip(AXES, COLOURS, MARKERS, strict=True)
    ]
    handles.append(Patch(color=SKY, alpha=0.25, label="at rest"))
    figure.legend(handles=handles, loc="outside lower left", ncols=4, fontsize=SMALL, frameon=False)
    return figure


def time_scale(duration_s: float) -> tuple[float, str]:
    """Scale of the time axis, s, and its name."""
    return (60.0, "min") if duration_s > _IN_MINUTES else (1.0, "s")


def envelope(time: Array, values: Array, breaks: Indices) -> tuple[Array, Array]:
    """Envelope of a long table: smallest and largest value of every interval, which draws the same.

    Time, shape (n,), and values, shape (n, c), become those of shape (m,) and (m, c), with NaN between the pieces that
    begin at ``breaks``: lines are not drawn across.
    """
    size = max(1, len(time) // _COLUMNS)
    edges = [0, *breaks.tolist(), len(time)]
    times, tables = [], []
    for a, b in pairwise(edges):
        starts = np.arange(a, b, size)
        if size <= 2:
            times.append(time[a:b])
            tables.append(values[a:b])
        else:
            lows, highs = _extremes(values, a, b, size)
            times.append(np.repeat(time[starts], 2))
            tables.append(np.stack([lows, highs], axis=1).reshape(2 * len(starts), -1))
        times.append(time[b - 1 : b])
        tables.append(np.full((1, values.shape[1]), np.nan))
    return np.concatenate(times[:-1]), np.concatenate(tables[:-1])


def _extremes(values: Array, a: int, b: int, size: int) -> tuple[Array, Array]:
    """Smallest and largest value of consecutive intervals, each of shape (k, c); the last may be shorter."""
    whole = (b - a) // size
    width = values.shape[1]
    # Column by column: comparing short rows is slow.
    rows = values[a : a + whole * size].reshape(whole, size * width)
    lows, highs = (np.stack([f(rows[:, c::width], axis=1) for c in range(width)], axis=1) for f in (np.min, np.max))
    rest = values[a + whole * size : b]
    if len(rest):
        lows = np.concatenate([lows, rest.min(axis=0, keepdims=True)])
        highs = np.concatenate([highs, rest.max(axis=0, keepdims=True)])
    return lows, highs


def _visible_gaps(recording: Recording) -> Indices:
    gaps, time = recording.gaps, recording.time
    wide = time[gaps] - time[gaps - 1] > _VISIBLE_GAP * (time[-1] - time[0])
    out: Indices = gaps[wide]
    return out


def _rests(axes: Axes, inspection: Inspection, scale: float) -> None:
    if inspection.stillness is None:
        return
    spans = [(a / scale, (b - a) / scale) for a, b in inspection.stillness.windows_s]
    axes.broken_barh(
        spans, (0.0, 1.0), transform=axes.get_xaxis_transform(), facecolor=SKY, alpha=0.25, linewidth=0.0, zorder=0.5
    )


def _name_turns(axes: Axes, inspection: Inspection, scale: float) -> None:
    """Label the rotations with the recognised sequence or their angle, as far as there is room."""
    room = _ROOM * inspection.stamps.duration_s * (1.6 if inspection.allan is not None else 1.0)
    taken = -np.inf
    for middle, text, colour in _turn_texts(inspection.turns):
        if middle - taken < room:
            continue
        taken = middle
        axes.text(middle / scale, 1.01, text, transform=axes.get_xaxis_transform(), ha="center", va="bottom",
                  rotation=90.0 if text.endswith("°") else 0.0, fontsize=SMALL, color=colour)  # fmt: skip


def _turn_texts(turns: tuple[ManoeuvreSummary, ...]) -> Iterator[tuple[float, str, str]]:
    """Middle, text and colour of the labels; if sequences were recognised, of these alone."""
    named = any(turn.sequence for turn in turns)
    for turn in turns:
        middle = 0.5 * (turn.start_s + turn.end_s)
        if turn.sequence is not None:
            yield middle, turn.sequence, INK
        elif not named:
            leg = turn.parts[0] if len(turn.parts) == 1 else turn.net
            yield middle, f"{abs(leg.angle_deg):.0f}°", GREY


def allan_panel(
    axes: Axes, allan: AllanDeviation, sensor: int, si: float, unit: str, terms: NoiseTerms | None = None
) -> None:
    """Draw the Allan deviation of one sensor, 0 for gyros and 1 for accelerometers, with curve and slopes of its terms.

    ``si`` is SI per unit; ``terms`` by maximum likelihood stand in place of those of the Allan fit.
    """
    style(axes, grid="both")
    tau = allan.tau_s
    fine = np.geomspace(tau[0], tau[-1], 100)
    fitted = (allan.fitted(fine) if terms is None else terms.deviation(fine)) / si
    for axis, (colour, marker) in enumerate(zip(COLOURS, MARKERS, strict=True)):
        c = 3 * sensor + axis
        if not np.isfinite(allan.deviation[c]).any():
            continue
        axes.fill_between(tau, allan.low[c] / si, allan.high[c] / si, color=colour, alpha=0.15, linewidth=0.0)
        axes.plot(fine, fitted[c], color=colour, linewidth=1.2)
        axes.plot(tau, allan.deviation[c] / si, marker, color=colour, markersize=4.0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylabel(f"{('gyros', 'accelerometers')[sensor]}, {unit}", fontsize=MEDIUM, color=INK)
    limits = axes.get_ylim()
    values: Array = allan.value
    drawn: tuple[Term, ...] = TERMS
    if terms is not None:
        values, drawn = np.where(terms.resolved, np.abs(terms.value), np.nan), ALL_TERMS
    _slopes(axes, values[3 * sensor : 3 * sensor + 3], drawn, sensor, fine, si)
    axes.set_ylim(limits)
    for which in (axes.xaxis, axes.yaxis):
        low, high = which.get_view_interval()
        # A few ticks within the decade or two that are usual, decades where there are many.
        which.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,), numticks=12))
        which.set_major_formatter(_PLAIN)
        which.set_minor_locator(NullLocator())


def _slopes(axes: Axes, coefficients: Array, terms: Sequence[Term], sensor: int, tau: Array, si: float) -> None:
    """Draw the slope of every term that was identified, by the median of the axes that show it."""
    handles = []
    for t, term in enumerate(terms):
        seen = coefficients[np.isfinite(coefficients[:, t]), t]
        if seen.size == 0:
            continue
        typical = float(np.median(seen))
        slope = typical * np.sqrt(term.factor * tau**term.exponent) / si
        axes.plot(tau, slope, linestyle=_STEEP[term.name], color=GREY, linewidth=1.0, zorder=1.5)
        figure = f"{term.title} {typical / term.scales[sensor]:.3g} {term.units[sensor]}"
        handles.append(Line2D([], [], color=GREY, linestyle=_STEEP[term.name], linewidth=1.0, label=figure))
    if handles:
        axes.legend(handles=handles, loc="upper right", fontsize=SMALL, frameon=False)


def _shortened(text: str, width: int = 150) -> str:
    return text if len(text) <= width else text[: width - 2].rsplit(" ", 1)[0] + " …"


_NOISE_SIZE_INCHES: Final = (12.0, 5.5)


def noise_figure(terms: NoiseTerms, allan: AllanDeviation, *, title: str | None = None) -> Figure:
    """Draw the Allan deviation with 95 % intervals, and the curves of the resolved terms."""
    figure = Figure(figsize=_NOISE_SIZE_INCHES, dpi=DPI, layout=ConstrainedLayoutEngine())
    for sensor, (si, unit) in enumerate(((DEG_PER_H, "°/h"), (MICRO_G, "µg"))):
        axes = figure.add_subplot(1, 2, sensor + 1)
        allan_panel(axes, allan, sensor, si, unit, terms)
        axes.set_xlabel("averaging time, s", fontsize=MEDIUM, color=INK)
    figure.suptitle(f"Allan deviation{f' of {title}' if title else ''}", fontsize=LARGE, color=INK)
    return figure
