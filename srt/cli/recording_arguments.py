"""Arguments RECORDING of a command: recordings, folders of recordings, and patterns that the shell did not expand."""

from __future__ import annotations

import glob
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from srt.cli.messages import warn
from srt.cli.output_paths import recording_folder
from srt.cli.overwriting import TOML
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.recording.recording import Recording

_RESERVED: Final = "fleet"
"""Name of the files of the fleet, which stand beside the results."""


@dataclass(frozen=True, slots=True)
class RecordingArguments:
    """Recordings that the arguments name.

    Attributes
    ----------
    paths : tuple of Path
        In the order of the arguments; within one, by name, with numbers in names by their size.
    searched : bool
        True if a folder of recordings or a pattern was among the arguments.
    """

    paths: tuple[Path, ...]
    searched: bool


def find_recordings(arguments: Sequence[Path], *, files: Sequence[str] = ()) -> RecordingArguments:
    """Resolve arguments to recordings.

    An argument that exists is taken literally. A folder without ``recording.toml`` stands for the recordings in it, at
    any depth, except in hidden folders, inside recordings, and behind links to folders of recordings. An argument that
    neither exists nor is a pattern is kept, and refused where it is read.

    Parameters
    ----------
    files : sequence of str
        Endings of files that a pattern may also match, as ".json".

    Raises
    ------
    InputError
        A folder that cannot be searched, or a pattern that matches no recording.
    """
    paths: list[Path] = []
    searched = False
    for argument in arguments:
        inside = _below(argument)
        if not inside and not argument.exists() and glob.has_magic(str(argument)):
            inside = _matches(str(argument), files)
        searched |= bool(inside)
        paths += inside or [argument]
    if searched:
        # Patterns may overlap, and a unit counts once.
        first: dict[Path, Path] = {}
        for path in paths:
            first.setdefault(recording_folder(path).resolve(), path)
        paths = list(first.values())
    return RecordingArguments(tuple(paths), searched)


def unit_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Names of units: their folders, with as many parent folders as distinguish them.

    Raises
    ------
    InputError
        A recording that is named twice, or two whose results would have one name.
    """
    folders = [recording_folder(path).resolve() for path in paths]
    first = {folder: n for n, folder in reversed(list(enumerate(folders)))}
    twice = next((path for n, path in enumerate(paths) if first[folders[n]] < n), None)
    if twice is not None:
        raise InputError(f"The recording {twice} is named twice, and one unit must not count twice.")
    for depth in range(1, max(len(folder.parts) for folder in folders) + 1):
        names = ["/".join(folder.relative_to(folder.anchor).parts[-depth:]) for folder in folders]
        # Some disks do not tell capitals apart.
        files = {file_name(name).casefold() for name in names}
        if len(files) == len(names) and _RESERVED not in files:
            return tuple(names)
    raise InputError(
        "The results of two recordings would have one name, as their folders differ in capitals or hyphens alone: "
        "calibrate them apart."
    )


def file_name(unit: str) -> str:
    """Name of the files of a unit, without an ending."""
    return unit.replace("/", "-")


def load_stated(path: Path) -> Recording:
    """Load a recording; warn of the standard gravity without a sigma. Raises InputError."""
    from srt.recording.folder import load_recording
    from srt.recording.reading import gravity_warning

    recording = load_recording(path)
    doubt = gravity_warning(recording.site, of_file=True)
    if doubt is not None:
        warn(f"{path}: {doubt}")
    return recording


def median_force(recording: Recording) -> float:
    """Median of the size of the specific force, m/s²: near gravity in the motion of a test, and of a vehicle."""
    import numpy as np

    size = np.linalg.norm(recording.accel, axis=1)
    return float(np.median(size / recording.interval_s if recording.kind == "increment" else size))


def check_median_force(recording: Recording) -> None:
    """Raise DataError for accelerometers that do not read gravity: a unit, or the kind of the samples, is wrong."""
    from srt.sequences.plausibility import check_rest

    force = [[median_force(recording), 0.0, 0.0]]
    check_rest(
        force, recording.site.gravity_m_s2, lambda: ["the whole recording"], interval_s=recording.nominal_interval_s
    )


def _below(folder: Path) -> list[Path]:
    """Recordings below a folder that is not a recording itself."""
    if not folder.is_dir() or (folder / TOML).exists():
        return []
    found = []
    for place, folders, names in os.walk(folder, onerror=_refuse):
        if TOML in names:
            found.append(Path(place))
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        # The walk does not enter links, which may go in circles; a link to a recording is one all the same.
        links = (Path(place, name) for name in folders)
        found += [link for link in links if link.is_symlink() and (link / TOML).is_file()]
    return sorted(found, key=_by_name)


def _matches(pattern: str, files: Sequence[str]) -> list[Path]:
    found: list[Path] = []
    for path in sorted(map(Path, glob.glob(pattern, recursive=True)), key=_by_name):  # noqa: PTH207 - of any root
        if (path / TOML).is_file() or path.suffix in files:
            found.append(path)
        elif path.name == TOML:
            found.append(path.parent)
        else:
            found += _below(path)
    if not found:
        raise InputError(
            f"No recording matches the pattern {pattern}: give one of folders with {TOML}, or of folders above such."
        )
    return found


def _refuse(error: OSError) -> None:
    raise InputError(
        f"The folder {error.filename} cannot be looked through for recordings ({error.strerror or error}): "
        "name the recordings themselves, or change its permissions."
    ) from None


def _by_name(path: Path) -> list[list[tuple[bool, int, str]]]:
    """Key that sorts unit-10 after unit-2."""
    return [
        [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in re.split(r"(\d+)", name)]
        for name in path.parts
    ]
