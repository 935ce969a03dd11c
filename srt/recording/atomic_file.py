"""Atomic writing of files: under a temporary name in the same folder, then renamed."""

from __future__ import annotations

import os
import secrets
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Context with a temporary path of the same suffix, renamed to the file if the block ends without an error.

    Parameters
    ----------
    path : path-like
        File to write. An existing file is replaced; a symbolic link is followed.

    Yields
    ------
    Path
        Temporary path to write to.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    # A symbolic link remains, and its target is replaced.
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}.tmp{target.suffix}")
    try:
        yield temporary
        # Without it, a power failure after the renaming could leave an empty file under the final name.
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise InputError(unwritable(path, error)) from None
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def atomic_write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file completely or not at all. Raises InputError if it cannot be written."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def atomic_write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file, with line feeds on every system, completely or not at all.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    atomic_write_bytes(path, text.encode("utf-8"))


def unwritable(path: str | os.PathLike[str], error: OSError) -> str:
    """Sentence that says why a path cannot be written."""
    reason = error.strerror or str(error) or type(error).__name__
    return f"Cannot write {os.fspath(path)} ({reason}): choose a place that exists and may be written to."
