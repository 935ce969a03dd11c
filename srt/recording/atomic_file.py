"""Atomic writing of files: under a temporary name in the same folder, then renamed."""

from __future__ import annotations

import os
import platform
import re
import zlib
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


_LEFTOVER: Final = re.compile(r"\..+\.([0-9a-f]{8})-(\d+)-[0-9a-f]{8}\.tmp(\.\w+)?")
"""Name of a temporary file: that of its target, the machine and process that write it, and a random number."""


@cache
def _machine() -> str:
    return f"{zlib.crc32(platform.node().encode()):08x}"


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of processes of this machine that were killed; of living ones and others, none."""
    if os.name == "nt":  # the only question about a process that POSIX answers and Windows does not
        return
    with suppress(OSError):
        for path in folder.glob(".*.tmp*"):
            found = _LEFTOVER.fullmatch(path.name)
            if found is not None and found[1] == _machine() and not _lives(int(found[2])):
                path.unlink(missing_ok=True)


@cache
def _remove_leftovers_once(folder: Path) -> None:
    """Remove leftovers at the first writing to a folder: a fleet writes thousands of files to one."""
    remove_leftovers(folder)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Context with a temporary path of the same suffix, renamed to the file if the block ends without an error.

    An existing file is replaced; a symbolic link is followed. Raises InputError if the file cannot be written.
    """
    with atomic_paths(path) as (temporary,):
        yield temporary


@contextmanager
def atomic_paths(*paths: str | os.PathLike[str]) -> Iterator[list[Path]]:
    """Context as that of :func:`atomic_path` with several files: all are on the disk before the first is renamed."""
    # A symbolic link remains, and its target is replaced.
    targets = [Path(os.path.realpath(path)) for path in paths]
    for folder in {target.parent for target in targets}:
        _remove_leftovers_once(folder)
    mark = f"{_machine()}-{os.getpid()}-{os.urandom(4).hex()}"
    temporary = [target.with_name(f".{target.stem}.{mark}.tmp{target.suffix}") for target in targets]
    try:
        yield temporary
        # Without it, a power failure after the renaming could leave an empty file under the final name.
        for each in temporary:
            with each.open("rb+") as file:
                os.fsync(file.fileno())
        for each, target in zip(temporary, targets, strict=True):
            each.replace(target)
    except OSError as error:
        raise InputError(unwritable(" and ".join(str(path) for path in paths), error)) from None
    finally:
        for each in temporary:
            with suppress(OSError):
                each.unlink(missing_ok=True)


def atomic_write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file completely or not at all. Raises InputError if it cannot be written."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def atomic_write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8, with line feeds on every system, completely or not at all. Raises InputError if it cannot."""
    atomic_write_bytes(path, text.encode("utf-8"))


def unwritable(path: str | os.PathLike[str], error: OSError) -> str:
    """Sentence that says why a path cannot be written."""
    reason = error.strerror or str(error) or type(error).__name__
    return f"Cannot write {os.fspath(path)} ({reason}): choose a place that exists and may be written to."
