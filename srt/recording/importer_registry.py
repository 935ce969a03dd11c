"""Every format that can be read, by name; the readers are imported when first asked for.

A new format is a reader and one line in :data:`IMPORTERS`, or a call of :func:`register` from outside.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError, InputError, did_you_mean
from srt.recording.import_options import ImportOptions, option
from srt.recording.imported_samples import ImportedSamples, in_axes, without_repeats
from srt.recording.samples import SAMPLES_FORMATS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


AUTO: Final = "auto"

HEAD_BYTES: Final = 4096
"""As much of a file as a sniffer looks at."""

COMMON: Final = frozenset(
    {
        "kind", "gyro_unit", "accel_unit", "gyro_lsb", "accel_lsb", "gyro_offset", "accel_offset",
        "sample_rate_hz", "map_gyro", "map_accel",
    }
)  # fmt: skip
"""Options that every format takes."""


@dataclass(frozen=True, slots=True)
class Importer:
    """One format.

    Attributes
    ----------
    name : str
        On the command line.
    title : str
        For people, a few words.
    suffixes : tuple of str
        Lower case, with the dot; asked only if no content is recognised.
    extra : str or None
        The optional extra that it needs.
    sniff : callable
        Whether a file (or folder) is of this format, by its first bytes; never raises, reads little.
    read : callable
        Raises InputError, DataError or MissingExtraError, nothing else.
    options : frozenset of str
        The fields of ImportOptions that it takes beside the common ones; others are refused, not ignored.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    extra: str | None
    sniff: Callable[[Path], bool]
    read: Callable[[Path, ImportOptions], ImportedSamples]
    options: frozenset[str] = frozenset()


IMPORTERS: Final[dict[str, str]] = {
    "rosbag1": "srt.recording.importers.rosbag:ROSBAG1",
    "rosbag2": "srt.recording.importers.rosbag:ROSBAG2",
    "ulog": "srt.recording.importers.ulog:ULOG",
    "ardupilot": "srt.recording.importers.ardupilot:ARDUPILOT",
    "matlab": "srt.recording.importers.matlab:MATLAB",
    "hdf5": "srt.recording.importers.arrays:HDF5",
    "parquet": "srt.recording.importers.arrays:PARQUET",
    "npz": "srt.recording.importers.arrays:NPZ",
    "euroc": "srt.recording.importers.csv_formats:EUROC",
    "kalibr": "srt.recording.importers.csv_formats:KALIBR",
    "imu-tk": "srt.recording.importers.csv_formats:IMU_TK",
    "psins": "srt.recording.importers.psins:PSINS",
    "csv": "srt.recording.importers.csv_formats:CSV",
}
"""Name to "module:attribute", those with the most certain marks first."""


def register(name: str, target: str) -> None:
    """Add a format.

    Parameters
    ----------
    name : str
    target : str
        "module:attribute" of an :class:`Importer`. It is asked before those that stand already.

    Raises
    ------
    InputError
        If the name is taken.
    """
    if name in IMPORTERS or name == AUTO:
        raise InputError(f"There is a format {name!r} already: choose another name.")
    others = dict(IMPORTERS)
    IMPORTERS.clear()
    IMPORTERS.update({name: target, **others})


def importer(name: str) -> Importer:
    """Load one format by its name. Raises InputError if there is none."""
    if name not in IMPORTERS:
        raise InputError(f"There is no format {name!r}{did_you_mean(name, IMPORTERS)}: use one of {_names()}.")
    module, _, attribute = IMPORTERS[name].partition(":")
    found = getattr(importlib.import_module(module), attribute)
    assert isinstance(found, Importer)
    return found


def find_importer(path: Path, name: str = AUTO) -> Importer:
    """Find the format of a file: by its content, then by its suffix.

    Parameters
    ----------
    path : Path
        File, or folder for formats that are folders.
    name : str
        A format's name, which is believed, or "auto".

    Returns
    -------
    Importer

    Raises
    ------
    InputError
        A file that is absent, an unknown name, or no format that fits.
    """
    if name != AUTO:
        found = importer(name)
        _require(path)
        return found
    _require(path)
    known = []
    for each in IMPORTERS:
        candidate = importer(each)
        if candidate.sniff(path):
            return candidate
        known.append(candidate)
    suffix = path.suffix.lower()
    for candidate in known:
        if suffix in candidate.suffixes:
            return candidate
    raise InputError(f"{path} is of no format known here: name it with {option('format')}, as one of {_names()}.")


def import_file(path: Path, options: ImportOptions | None = None, name: str = AUTO) -> tuple[Importer, ImportedSamples]:
    """Read a foreign file.

    Parameters
    ----------
    path : Path
    options : ImportOptions, optional
    name : str
        A format's name, or "auto".

    Returns
    -------
    importer : Importer
        The one that read it.
    imported : ImportedSamples
        In the axes asked for, without records written twice.

    Raises
    ------
    InputError
        What :func:`find_importer` raises, an option that the format does not take, and whatever is wrong with the
        file; one sentence that names it.
    DataError
    MissingExtraError
        If the format needs a package that is not installed.
    """
    options = options or ImportOptions()
    if name == AUTO and options.second is not None:
        name = "imu-tk"
    chosen = find_importer(path, name)
    unused = sorted(options.given - chosen.options - COMMON)
    if unused:
        taken = ", ".join(option(each) for each in sorted(chosen.options)) or "no others"
        raise InputError(
            f"{option(unused[0]) if unused[0] != 'second' else 'A second file'} is given, but the format "
            f"{chosen.name} of {path} has no use for it (beside units and axes it takes {taken}): leave it out, or "
            f"name another format with {option('format')}."
        )
    try:
        # What is not finite, or becomes so, is refused by the recording in a sentence, with its place.
        with np.errstate(all="ignore"):
            imported = without_repeats(in_axes(chosen.read(path, options), options))
    except MemoryError:
        raise InputError(f"{path} does not fit into memory: split the recording.") from None
    except OSError as error:
        raise InputError(f"Cannot read {path} ({error.strerror or error}): check its permissions.") from None
    except (InputError, DataError) as error:
        if type(error) not in (InputError, DataError):
            raise
        # What a sensor's arrays are refused for is said where their file is not known; and names in a damaged file
        # may be anything.
        text = _printable(str(error))
        raise type(error)(text if path.name in text else f"{path}: {text}", fault=error.fault) from None
    if len(imported.gyro) == 0:
        raise InputError(f"{path} holds no samples of an IMU: name another file.")
    return chosen, replace(imported, notes=tuple(map(_printable, imported.notes)))


def head(path: Path, size: int = HEAD_BYTES) -> bytes:
    """First bytes of a file for a sniffer; empty for a folder or what cannot be read."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(size)
    except (OSError, ValueError):
        return b""


def _require(path: Path) -> None:
    try:
        if path.is_file() or path.is_dir():
            return
        reason = "it is neither a file nor a folder" if path.exists() else "there is none"
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
    raise InputError(f"There is no file {path} to read ({reason}): check the path.")


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _names() -> str:
    return ", ".join(IMPORTERS)


def is_foreign(path: Path) -> bool:
    """Whether a file or folder is of a format that has an importer, and none of those read here.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    if path.suffix.lower().removeprefix(".") in SAMPLES_FORMATS:
        return False
    try:
        find_importer(path)
    except InputError:
        return False
    return True
