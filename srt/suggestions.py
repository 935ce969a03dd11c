"""A word for messages about names that are nearly right."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Say " (did you mean ...?)" where a known name resembles the given one, else nothing.

    Parameters
    ----------
    name : str
        What was found.
    known : iterable of str
        What could have been meant.

    Returns
    -------
    str
        With a leading space, or empty.
    """
    folded = {candidate.lower(): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower(), list(folded), n=1, cutoff=0.6)
    return f" (did you mean {clipped(folded[close[0]])}?)" if close else ""


def clipped(text: str, length: int = 60) -> str:
    """Give a name out of a file as a message may show it: printable, and short enough for a sentence.

    Parameters
    ----------
    text : str
    length : int
        Characters.

    Returns
    -------
    str
    """
    shown = text if len(text) <= length else text[: length - 3] + "..."
    return "".join(c if c.isprintable() else "?" for c in shown)
