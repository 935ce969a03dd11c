"""Tables of results: one model that text, HTML, PDF and DataFrames show, and numbers rounded to their sigmas."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import clipped

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from collections.abc import Set as AbstractSet

WIDTH: Final = 80
"""Width of all text, characters: that of the customary terminal."""
_GAP: Final = 2
_MOST_DECIMALS: Final = 6
_FIXED_BELOW: Final = 1e7  # value from which a number has an exponent: columns are about ten characters wide
_SIDES: Final = {"l": "left", "r": "right"}
_LONGEST: Final = 400  # largest number of characters of a text out of a file


@dataclass(frozen=True, slots=True)
class Cell:
    """Cell of a table."""

    text: str
    value: float | None = None  # unrounded number of the text, SI, for programs that read the page
    mark: str = ""  # "passed", "failed", "changed" or "held"; the text says the same


@dataclass(frozen=True, slots=True)
class Table:
    """Table of a result; see :func:`table`."""

    head: tuple[str, ...]  # may hold line feeds
    rows: tuple[tuple[Cell, ...], ...]
    alignment: str  # one letter per column: "l" or "r"
    title: str = ""
    note: str = ""  # legend
    breaks: AbstractSet[int] = frozenset()  # rows that begin a group

    @property
    def texts(self) -> list[list[str]]:
        """Texts of the cells by row."""
        return [[cell.text for cell in row] for row in self.rows]

    def text(self, *, gap: int = _GAP, grouped: bool = True) -> str:
        """Text of the table, with an empty line between groups unless ``grouped`` is False."""
        rows: list[Sequence[str] | None] = []
        for number, row in enumerate(self.texts):
            rows += [None, row] if grouped and number and number in self.breaks else [row]
        return text_table(self.head, rows, self.alignment, gap=gap)

    def html(self) -> str:
        """Table in HTML for notebooks, escaped."""

        def line(cells: Sequence[str], tag: str) -> str:
            columns = zip(cells, self.alignment, strict=True)
            return "".join(f'<{tag} style="text-align:{_SIDES[s]}">{escape(cell)}</{tag}>' for cell, s in columns)

        body = "".join(f"<tr>{line(row, 'td')}</tr>" for row in self.texts)
        return f"<table><thead><tr>{line(self.head, 'th')}</tr></thead><tbody>{body}</tbody></table>"


def table(head: Iterable[str], rows: Iterable[Iterable[Cell | str]], alignment: str, **others: Any) -> Table:
    """Table of cells; a text stands for a cell without a number or mark. ``others`` are further fields."""
    cells = tuple(tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row) for row in rows)
    return Table(tuple(head), cells, alignment, **others)


def plain(text: object, length: int = _LONGEST) -> str:
    """Text out of a file in one line, printable and of at most ``length`` characters; empty for None."""
    return "" if text is None else clipped(" ".join(str(text).split()), length)


def decimals_for(sigma: float) -> int:
    """Number of decimals, 0 to 6, that shows two significant digits of a sigma; 6 unless it is positive and finite."""
    if not (math.isfinite(sigma) and sigma > 0.0):
        return _MOST_DECIMALS
    return min(max(1 - math.floor(math.log10(sigma)), 0), _MOST_DECIMALS)


def fixed(value: float, decimals: int) -> str:
    """Text of a number with the given decimals; an exponent for very large and very small ones; "-" for NaN."""
    if math.isnan(value):
        return "-"
    if abs(value) >= _FIXED_BELOW:
        return f"{value:.3e}"
    text = f"{value:.{decimals}f}"
    if float(text) == 0.0:
        # Six decimals hide it: an exponent shows how small it is. With fewer, it is nothing beside its sigma.
        return f"{value:.1e}" if decimals == _MOST_DECIMALS and value != 0.0 else text.lstrip("-")
    return text


def text_table(headers: Sequence[str], rows: Sequence[Sequence[str] | None], alignment: str, *, gap: int = _GAP) -> str:
    """Text of a table: lines without blanks at their ends, and without a line feed at the end.

    Headings may hold line feeds; those of fewer lines stand at the bottom. A row None makes an empty line, between
    groups. ``alignment`` has one letter per column: "l" or "r"; ``gap`` is the number of blanks between columns.
    """
    heads = [header.split("\n") for header in headers]
    height = max(len(lines) for lines in heads)
    heads = [[""] * (height - len(lines)) + lines for lines in heads]
    widths = [max(map(len, lines)) for lines in heads]
    for row in rows:
        if row is not None:
            widths = [max(width, len(cell)) for width, cell in zip(widths, row, strict=True)]

    def line(cells: Sequence[str]) -> str:
        columns = zip(cells, widths, alignment, strict=True)
        padded = (cell.ljust(width) if side == "l" else cell.rjust(width) for cell, width, side in columns)
        return f" {(' ' * gap).join(padded)}".rstrip()

    top = [line([lines[i] for lines in heads]) for i in range(height)]
    rule = " " + "-" * (sum(widths) + gap * (len(widths) - 1))
    return "\n".join([*top, rule, *("" if row is None else line(row) for row in rows)])


def continued_tables(
    first: Sequence[str], left: Sequence[Sequence[str]], groups: Sequence[Sequence[tuple[str, list[str]]]], sides: str
) -> list[str]:
    """Tables of groups of columns side by side, as many as fit; the others continue in further tables.

    ``first`` and ``left`` are headings and rows of the columns that every table begins with, ``sides`` is their
    alignment; the others are flush right. The columns of a group, each a heading and its cells, stay together.
    """
    texts = []
    start = sum(max(map(len, cells)) + 1 for cells in zip(*left, first, strict=True))
    while groups:
        used, count = start, 0
        for group in groups:
            used += sum(1 + max(map(len, [*head.split("\n"), *cells])) for head, cells in group)
            if count and used > WIDTH:
                break
            count += 1
        columns = [column for group in groups[:count] for column in group]
        rows = [[*cells, *more] for cells, *more in zip(left, *(cells for _, cells in columns), strict=True)]
        heads = [*first, *(head for head, _ in columns)]
        texts.append(text_table(heads, rows, sides + "r" * len(columns), gap=1))
        groups = groups[count:]
    return texts


def wrap(text: str, indent: str = "") -> list[str]:
    """Lines of a text within the width; the second and later ones are indented."""
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent + "  ", break_on_hyphens=False)
