"""Cells and tables as every form of the certificate sets them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from srt.exceptions import clipped

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

_TEXT = 400


@dataclass(frozen=True, slots=True)
class CertificateCell:
    """A cell of a table.

    Attributes
    ----------
    text : str
    value : float or None
        The number that the text rounds, SI, for programs that read the page.
    mark : str
        "passed", "failed", "changed" or "held"; the text says the same.
    """

    text: str
    value: float | None = None
    mark: str = ""


@dataclass(frozen=True, slots=True)
class CertificateTable:
    """A table.

    Attributes
    ----------
    title : str
    head : tuple of str
    rows : tuple of tuple of CertificateCell
    alignment : str
        One letter per column: "l" or "r".
    note : str
        How to read it.
    breaks : set of int
        Rows that begin a group.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[CertificateCell, ...], ...]
    alignment: str
    note: str = ""
    breaks: AbstractSet[int] = field(default_factory=frozenset)


def plain(text: object, length: int = _TEXT) -> str:
    """Give a text out of a file as it may be shown: in one line, printable, not endless; empty for None.

    Parameters
    ----------
    text : object
    length : int
        Characters.
    """
    return "" if text is None else clipped(" ".join(str(text).split()), length)
