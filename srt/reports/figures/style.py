"""Common style of the figures: classes of matplotlib, colours, sizes of letters, frames.

Modules that draw import the classes of matplotlib from here. Its global state (pyplot, rcParams) is unchanged.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from srt.arguments import require_path
from srt.exceptions import InputError, optional
from srt.recording.atomic_file import atomic_write_bytes
from srt.recording.file_marks import PROGRAM

with optional("matplotlib", "plot", "A plot"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.layout_engine import ConstrainedLayoutEngine
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.textpath import TextPath
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator, NullLocator

if TYPE_CHECKING:
    from collections.abc import Iterable
    from os import PathLike

__all__ = [
    "BLUE", "DPI", "FAINT", "GREEN", "GREY", "INK", "LARGE", "MEDIUM", "ORANGE", "PURPLE", "SKY", "SMALL", "SYMBOL",
    "VERMILION", "Axes", "ConstrainedLayoutEngine", "Figure", "FuncFormatter", "Line2D", "LogLocator", "MaxNLocator",
    "MultipleLocator", "NullLocator", "Patch", "SubFigure", "TextPath", "estimator_styles", "save_figure", "style",
    "symbol",
]  # fmt: skip

# Okabe and Ito's colours, which all types of colour vision distinguish; the markers differ too.
BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#CC79A7"
SKY: Final = "#56B4E9"
ORANGE: Final = "#E69F00"
INK: Final = "#222222"
GREY: Final = "#777777"
FAINT: Final = "#DDDDDD"

DPI: Final = 120
"""Resolution of raster images, dots per inch."""
SMALL: Final = 9.0
MEDIUM: Final = 10.0
SYMBOL: Final = 11.5
LARGE: Final = 13.0
"""Sizes of letters, points."""


def style(axes: Axes, *, grid: str = "y") -> None:
    """Frame a panel: spines on the left and below, a faint grid ("x", "y" or "both") behind the data."""
    axes.tick_params(labelsize=SMALL, color=GREY, labelcolor=INK)
    axes.grid(axis=grid, color=FAINT, linewidth=0.7)  # type: ignore[arg-type]
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)


_ESTIMATORS: Final = {
    "closed-form": (VERMILION, "s"), "least-squares": (BLUE, "o"), "ekf": (GREEN, "^"), "graph": (PURPLE, "v"),
}  # fmt: skip
_OTHERS: Final = ((SKY, "P"), (ORANGE, "X"), (INK, "d"), (VERMILION, "<"), (BLUE, ">"), (GREEN, "h"), (PURPLE, "*"))


def estimator_styles(names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Colour and marker of every estimator; those of this package are the same in every figure.

    The marker distinguishes them where colours cannot be told apart.
    """
    names = list(names)
    others = [name for name in names if name not in _ESTIMATORS]
    known = _ESTIMATORS | {name: _OTHERS[k % len(_OTHERS)] for k, name in enumerate(others)}
    return {name: known[name] for name in names}


def symbol(name: str) -> str:
    """Symbol of a parameter, as κxx, with its indices as subscripts in mathtext."""
    return rf"{name[0]}$_\mathrm{{{name[1:]}}}$"


_SUFFIXES: Final = (".png", ".pdf", ".svg")


def save_figure(figure: Figure, path: str | PathLike[str]) -> None:
    """Write a figure as .png, .pdf or .svg, whole or not at all.

    Raises InputError for a name with another ending, or a path that cannot be written.
    """
    require_path("A figure", path)
    suffix, drawn = Path(path).suffix.lower(), io.BytesIO()
    if suffix not in _SUFFIXES:
        raise InputError(f"The figure cannot be written as {path}: name a file that ends in {' or '.join(_SUFFIXES)}.")
    # Without a date, the same result makes the same file.
    metadata: dict[str, Any] = {
        ".svg": {"Date": None, "Creator": PROGRAM}, ".pdf": {"CreationDate": None, "Creator": PROGRAM},
    }  # fmt: skip
    # In memory first: matplotlib leaves the file of a PDF open that cannot be written.
    if suffix == ".png":  # the same file in one drawing; savefig draws once more for the layout alone
        FigureCanvasAgg(figure).print_png(drawn, metadata={"Software": PROGRAM})  # type: ignore[no-untyped-call]
    else:
        figure.savefig(drawn, format=suffix.lstrip("."), metadata=metadata.get(suffix))
    atomic_write_bytes(path, drawn.getvalue())
