"""Paths of results: checks that they can be written, before the work whose result they are to hold."""

from __future__ import annotations

import tempfile
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final

from srt.cli.messages import warn
from srt.cli.overwriting import check_replaceable, refuse_recording
from srt.exceptions import InputError, MissingExtraError
from srt.recording.atomic_file import remove_leftovers, unwritable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


PLOT_SUFFIXES: Final = (".png", ".pdf", ".svg")
RESULT_SUFFIXES: Final = (".json",)
SAMPLES_FORMATS: Final = ("csv", "npz", "parquet", "h5")
"""Formats of samples, written out: importing them from srt.recording would make the help wait for numpy."""


def require_matplotlib() -> None:
    """Raise MissingExtraError if matplotlib is missing, before the result is computed."""
    if find_spec("matplotlib") is None:
        raise MissingExtraError("matplotlib", "plot", "A plot")


def picture_in(folder: Path) -> Path | None:
    """Path of the figure of a calibration in a folder of results; None, with a warning, if matplotlib is missing."""
    try:
        require_matplotlib()
    except MissingExtraError as error:
        warn(f"No plot will be made: {error}")
        return None
    return folder / "calibration.png"


def check_plot(path: Path | None) -> None:
    """Check that a figure can be written and drawn, before its content is computed; nothing for None."""
    if path is not None:
        check_file(path, PLOT_SUFFIXES, "The plot")
        require_matplotlib()


def check_file(path: Path | None, suffixes: Sequence[str], what: str) -> None:
    """Check that a file can be written, and replaced if it exists, before its content is computed; nothing for None.

    Parameters as those of :func:`check_place`. Raises InputError.
    """
    if path is not None:
        check_place(path, suffixes, what)
        check_replaceable(path)


def check_place(path: Path | None, suffixes: Sequence[str], what: str) -> None:
    """Check that a file of this name can be written, whether it exists or not; nothing for None.

    Parameters
    ----------
    suffixes : sequence of str
        Endings that are allowed. Another ending is mostly a slip, and could replace a file of samples.
    what : str
        Content of the file, as the start of a sentence.

    Raises
    ------
    InputError
    """
    if path is None:
        return
    if path.is_dir():
        raise InputError(f"{what} cannot be written as {path}: it is a folder; name a file.")
    if path.suffix.lower() not in suffixes:
        raise InputError(
            f"{what} cannot be written as {path}: name a file that ends in {' or '.join(suffixes)}, "
            f"as {path.with_suffix(suffixes[0])}."
        )
    # A link is written through, so its target decides.
    _check_folder(path.resolve().parent, path)


def check_directory(path: Path) -> None:
    """Check that a folder for results can be created or written to, without creating it; none is in a recording.

    Raises
    ------
    InputError
    """
    _check_directory(path)
    refuse_recording(path, path)


def _check_directory(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file, but results go to a folder: name another place.")
    existing = path
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    _check_folder(existing, path)


def check_recording_target(folder: Path, *, overwrite: bool) -> None:
    """Check that a recording can be written to a folder, before the work; remove what a killed run left there.

    Raises
    ------
    InputError
        A folder that cannot be written to, or, without ``overwrite``, one with files in it.
    """
    _check_directory(folder)
    remove_leftovers(folder)
    if folder.is_dir() and not overwrite and any(folder.iterdir()):
        raise InputError(f"The folder {folder} holds files already: name another, or add --overwrite.")


def make_directory(path: Path) -> None:
    """Create a folder for results. Raises InputError if it cannot be created."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(unwritable(path, error)) from None


def recording_folder(recording: Path) -> Path:
    """Folder of a recording that is named by its folder or by its ``recording.toml``."""
    return recording.parent if recording.suffix == ".toml" else recording


def _check_folder(folder: Path, wanted: Path) -> None:
    try:
        # Permission bits do not show read-only disks and the like; an unnamed temporary file does.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(unwritable(wanted, error)) from None
