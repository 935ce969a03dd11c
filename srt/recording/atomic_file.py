"""Files that appear whole or not at all: written under a temporary name in the same folder, then renamed."""

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
    """Lend a temporary path with the same suffix, which becomes the file if the block ends without an error.

    Parameters
    ----------
    path : path-like
        The file to be; one that exists is replaced, a symbolic link is followed.

    Yields
    ------
    Path
        Where to write.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    # A link is to be written through, not replaced by a file.
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}.tmp{target.suffix}")
    try:
        yield temporary
        # Without this, a power cut after the renaming could leave an empty file under the final name.
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise InputError(unwritable(path, error)) from None
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def atomic_write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a whole file or nothing. Raises InputError if it cannot be written."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def atomic_write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a whole UTF-8 text file, with line feeds on every system, or nothing.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    atomic_write_bytes(path, text.encode("utf-8"))


def unwritable(path: str | os.PathLike[str], error: OSError) -> str:
    """Say in one sentence why a path cannot be written."""
    reason = error.strerror or str(error) or type(error).__name__
    return f"Cannot write {os.fspath(path)} ({reason}): choose a place that exists and may be written to."
