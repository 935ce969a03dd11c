"""Exceptions, each with one sentence for the user and an exit code of the command line; helpers for the sentences."""

from __future__ import annotations

import copy
import difflib
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import Self


class SrtError(Exception):
    """Base class of the errors of this package; the message is one sentence for the user.

    Attributes
    ----------
    exit_code : int
        Exit code of the command line: 1, the data cannot support a result; 2, wrong usage or unreadable input.
    fault : str or None
        Name of the fault in the catalogue (:mod:`srt.diagnosis.faults`), if it has one.
    """

    exit_code = 2

    def __init__(self, *args: object, fault: str | None = None) -> None:
        super().__init__(*args)
        self.fault = fault

    def reworded(self, text: str) -> Self:
        """Make the same error with another sentence."""
        other = copy.copy(self)
        other.args = (text,)
        return other


class InputError(SrtError):
    """Unreadable input or wrong usage (exit code 2)."""

    exit_code = 2


class NotStatedError(InputError):
    """A quantity that the input does not state and the user has to.

    Attributes
    ----------
    missing : tuple of str
        Keywords of :func:`srt.read` that state what is missing.
    """

    def __init__(self, *args: object, missing: Iterable[str] = (), fault: str | None = None) -> None:
        super().__init__(*args, fault=fault)
        self.missing = tuple(missing)


class DataError(SrtError):
    """Data that are readable but cannot support the requested result (exit code 1)."""

    exit_code = 1


class MissingExtraError(InputError):
    """Missing optional dependency; the message says what to install."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package {package!r}, which is not installed: "
            f"run pip install 'strapdown-rotation-test[{extra}]'."
        )


@contextmanager
def optional(module: str, extra: str, purpose: str, package: str | None = None) -> Iterator[None]:
    """Context of the import of an optional dependency, which an extra of this distribution installs.

    ``module`` is the name of its top-level module, ``package`` that of its distribution, if another; ``purpose`` begins
    the sentence. Raises MissingExtraError if this very module is missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != module:
            raise
        raise MissingExtraError(package or module, extra, purpose) from None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggestion " (did you mean ...?)" if a known name resembles the given one, else an empty text.

    Parameters
    ----------
    name : str
        Unknown name.
    known : iterable of str
        Valid names.

    Returns
    -------
    str
        With a leading space, or empty.
    """
    folded = {candidate.lower(): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower(), list(folded), n=1, cutoff=0.6)
    return f" (did you mean {clipped(folded[close[0]])}?)" if close else ""


def clipped(text: str, length: int = 60) -> str:
    """Shorten a name from a file for a message, with unprintable characters replaced by "?".

    Parameters
    ----------
    text : str
    length : int
        Largest number of characters.

    Returns
    -------
    str
    """
    shown = text if len(text) <= length else text[: length - 3] + "..."
    return "".join(c if c.isprintable() else "?" for c in shown)
