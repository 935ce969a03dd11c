"""Exceptions: one sentence for the user and the exit code of the command line each; helpers for such sentences."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


class SrtError(Exception):
    """Base of all errors of this package; the message is one sentence for the person who reads it.

    Attributes
    ----------
    exit_code : int
        What the command line exits with: 1, the data cannot support a result; 2, wrong usage or unreadable input.
    fault : str or None
        Its name in the catalogue of faults (:mod:`srt.diagnosis.faults`), if it stands there.
    """

    exit_code = 2

    def __init__(self, *args: object, fault: str | None = None) -> None:
        super().__init__(*args)
        self.fault = fault


class InputError(SrtError):
    """Unreadable input or wrong usage (exit code 2)."""

    exit_code = 2


class DataError(SrtError):
    """Readable data that cannot support the result asked for (exit code 1)."""

    exit_code = 1


class MissingExtraError(InputError):
    """An optional dependency is absent; the message says what to install."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package {package!r}, which is not installed: "
            f"run pip install 'strapdown-rotation-test[{extra}]'."
        )


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
