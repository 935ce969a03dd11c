"""Marks of the files that this program writes: by them a command knows which files it may replace.

A text holds a line with the SHA-256 of the text, in which zeros stand for the digits of the digest itself. A figure, a
PDF and a page of HTML name the program in their metadata. Results in JSON have a digest of their content
(:mod:`srt.result.json_file`).
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from srt.recording.atomic_file import atomic_write_text

if TYPE_CHECKING:
    from os import PathLike

PROGRAM: Final = "strapdown-rotation-test"
"""Name of this program in metadata."""
UNSIGNED: Final = f"srt sha256:{64 * '0'}"
"""Mark of a text before :func:`signed` puts the digest into it."""

_SIGNED: Final = re.compile(r"srt sha256:([0-9a-f]{64})")
_COMMENTS: Final = {".md": "<!-- {} -->\n", ".toml": "# {}\n"}
"""Last line with the mark, by the ending of the file."""


def signed(text: str) -> str:
    """Text with its digest in the place of the zeros of :data:`UNSIGNED`, where it has that mark."""
    return text.replace(UNSIGNED, f"srt sha256:{_digest(text)}")


def unchanged_text(text: str) -> bool | None:
    """True if a text is as this program wrote it, False if it was changed since, None if it has no mark."""
    found = _SIGNED.search(text)
    return None if found is None else _digest(text.replace(found[0], UNSIGNED)) == found[1]


def write_marked_text(path: str | PathLike[str], text: str) -> None:
    """Write a text with a mark as its last line, completely or not at all. Raises InputError if it cannot be."""
    atomic_write_text(path, signed(text + _COMMENTS[Path(path).suffix.lower()].format(UNSIGNED)))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
