"""Numbers and tables as plain text: aligned columns within 80 characters."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

WIDTH: Final = 80
"""Width of all text, characters: that of the customary terminal."""
_GAP: Final = 2
_MOST_DECIMALS: Final = 6
_FIXED_BELOW: Final = 1e7
"""Value from which a number has an exponent: columns are about ten characters wide."""


def decimals_for(sigma: float) -> int:
    """Number of decimals that shows two significant digits of a sigma.

    Parameters
    ----------
    sigma : float
        Positive and finite; anything else gives as many decimals as a table has room for.

    Returns
    -------
    int
        0 to 6.
    """
    if not (math.isfinite(sigma) and sigma > 0.0):
        return _MOST_DECIMALS
    return min(max(1 - math.floor(math.log10(sigma)), 0), _MOST_DECIMALS)


def fixed(value: float, decimals: int) -> str:
    """Text of a number with the given decimals; very large and very small ones get an exponent.

    Parameters
    ----------
    value : float
    decimals : int

    Returns
    -------
    str
        "-" for a value that is not a number.
    """
    if math.isnan(value):
        return "-"
    if abs(value) >= _FIXED_BELOW:
        return f"{value:.3e}"
    text = f"{value:.{decimals}f}"
    if float(text) == 0.0:
        # Six decimals hide it: an exponent shows how small it is. With fewer, it is nothing beside its sigma.
        return f"{value:.1e}" if decimals == _MOST_DECIMALS and value != 0.0 else text.lstrip("-")
    return text


def text_table(
    headers: Sequence[str],
    rows: Sequence[Sequence[str] | None],
    alignment: str,
    *,
    indent: int = 1,
    gap: int = _GAP,
) -> str:
    """Text of a table.

    Parameters
    ----------
    headers : sequence of str
        May hold line feeds; headings of fewer lines stand at the bottom.
    rows : sequence of sequences of str, or None
        None makes an empty line, between groups of rows.
    alignment : str
        One letter per column: "l" or "r".
    indent, gap : int
        Blanks before the first column, and between columns.

    Returns
    -------
    str
        Lines without blanks at their ends, joined, without a line feed at the end.
    """
    heads = [header.split("\n") for header in headers]
    height = max(len(lines) for lines in heads)
    heads = [[""] * (height - len(lines)) + lines for lines in heads]
    widths = [max(map(len, lines)) for lines in heads]
    for row in rows:
        if row is not None:
            widths = [max(width, len(cell)) for width, cell in zip(widths, row, strict=True)]

    def line(cells: Sequence[str]) -> str:
        padded = (
            cell.ljust(width) if side == "l" else cell.rjust(width)
            for cell, width, side in zip(cells, widths, alignment, strict=True)
        )
        return (" " * indent + (" " * gap).join(padded)).rstrip()

    top = [line([lines[i] for lines in heads]) for i in range(height)]
    rule = " " * indent + "-" * (sum(widths) + gap * (len(widths) - 1))
    return "\n".join([*top, rule, *("" if row is None else line(row) for row in rows)])


def wrap(text: str, indent: str = "") -> list[str]:
    """Lines of a text within the width; the second and later ones are indented."""
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent + "  ", break_on_hyphens=False)
