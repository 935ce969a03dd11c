"""Errors of the libraries that parse foreign files, as sentences that name the file."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from srt.exceptions import InputError, SrtError, clipped

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_REASON_LENGTH = 160
"""Characters of a library's message that a sentence quotes."""


@contextmanager
def clear_errors(path: Path, title: str) -> Iterator[None]:
    """Turn any error of a library into an InputError that names the file.

    Only calls of the library belong into the block. A lack of memory passes through: the caller knows the limit.

    Raises InputError.

    Parameters
    ----------
    title : str
        The kind of file, such as "ROS 1 bag".
    """
    try:
        yield
    except (SrtError, MemoryError):
        raise
    # Parsers of foreign formats raise any exception on damaged input, from AssertionError to struct.error.
    except Exception as error:
        raise InputError(
            f"{path} is not a readable {title} ({reason_of(error)}): it may be cut off or damaged; copy it again."
        ) from None


def reason_of(error: BaseException) -> str:
    """First line of an error's message, at most 160 characters; the type of the error if it has no message."""
    lines = str(error).strip().splitlines() or [""]
    return clipped(lines[0].rstrip("."), _REASON_LENGTH) or type(error).__name__
