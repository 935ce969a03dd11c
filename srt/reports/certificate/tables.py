"""Tables of a certificate and their cells, common to the page and the PDF."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from srt.exceptions import clipped

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

_TEXT = 400
"""Largest number of characters of a text out of a file."""


@dataclass(frozen=True, slots=True)
class CertificateCell:
    """Cell of a table of the certificate.

    Attributes
    ----------
    text : str
    value : float or None
        Unrounded number of the text, SI, for programs that read the page.
    mark : str
        "passed", "failed", "changed" or "held"; the text says the same.
    """

    text: str
    value: float | None = None
    mark: str = ""


@dataclass(frozen=True, slots=True)
class CertificateTable:
    """Table of the certificate.

    Attributes
    ----------
    title : str
    head : tuple of str
    rows : tuple of tuple of CertificateCell
    alignment : str
        One letter per column: "l" or "r".
    note : str
        Legend.
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
    """Text out of a file in one line, printable and of limited length; empty for None.

    Parameters
    ----------
    text : object
    length : int
        Characters.
    """
    return "" if text is None else clipped(" ".join(str(text).split()), length)
