"""What all commands do alike: sentences to the user, and a look at the places that they are to write to."""

from __future__ import annotations

import tempfile
from importlib.util import find_spec
from typing import TYPE_CHECKING

import click

from srt.exceptions import InputError, MissingExtraError
from srt.recording.atomic_file import unwritable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


def say(sentence: str) -> None:
    """Tell the user one thing on standard error."""
    click.echo(f"srt: {sentence}", err=True)


def warn(sentence: str) -> None:
    """Tell the user of something that did not stop the work, on standard error."""
    say(f"warning: {sentence}")


def announce(*paths: Path | None, quiet: bool = False) -> None:
    """Print the files that were written; None stands for a file that was not asked for."""
    written = [str(path) for path in paths if path is not None]
    if written and not quiet:
        click.echo(f"\nWritten: {', '.join(written)}")


def require_matplotlib() -> None:
    """Raise MissingExtraError where matplotlib is missing, before the work whose result is to be drawn."""
    if find_spec("matplotlib") is None:
        raise MissingExtraError("matplotlib", "plot", "A plot")


def check_file(path: Path, suffixes: Sequence[str], what: str) -> None:
    """Refuse a file that could not be written, before the work whose result it is to hold.

    Parameters
    ----------
    path : Path
    suffixes : sequence of str
        Endings that the file may have. A result under another is mostly a slip, and would replace, say, the
        samples.
    what : str
        What the file is to hold, as a sentence begins.

    Raises
    ------
    InputError
    """
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{what} cannot be written as {path}: name a file that ends in {' or '.join(suffixes)}.")
    if path.is_dir():
        raise InputError(f"{what} cannot be written as {path}: it is a folder; name a file.")
    # A link is written through, so its target decides.
    _check_folder(path.resolve().parent, path)


def check_directory(path: Path) -> None:
    """Refuse a folder that could not be made or written to, without making it.

    Raises
    ------
    InputError
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file, but results go to a folder: name another place.")
    existing = path
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    _check_folder(existing, path)


def make_directory(path: Path) -> None:
    """Make a folder for results. Raises InputError if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(unwritable(path, error)) from None


def recording_folder(recording: Path) -> Path:
    """Give the folder of a recording that was named by its folder or by its ``recording.toml``."""
    return recording.parent if recording.suffix == ".toml" else recording


def _check_folder(folder: Path, wanted: Path) -> None:
    try:
        # Permission bits do not tell of read-only disks and the like; a file without a name does.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(unwritable(wanted, error)) from None
