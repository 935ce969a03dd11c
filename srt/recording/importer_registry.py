"""Registry of the foreign formats by name; their readers are imported on first use.

A new format is a reader in ``srt/recording/importers``, one line in :data:`IMPORTERS`, and a seed in ``READERS`` of
``benchmarks/fuzz_seeds.py``, without which a test fails. Another distribution calls :func:`register` instead.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError, InputError, NotStatedError, did_you_mean
from srt.recording.import_options import ImportOptions, option
from srt.recording.imported_samples import ImportedSamples, in_imu_axes, without_repeats
from srt.recording.samples import SAMPLES_FORMATS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


AUTO: Final = "auto"

HEAD_BYTES: Final = 4096
"""Bytes at the start of a file by which a format is recognised."""

COMMON_OPTIONS: Final = frozenset(
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
        Name on the command line.
    title : str
        Description in a few words.
    suffixes : tuple of str
        Lower case, with the dot; they decide only if no format recognises the content.
    extra : str or None
        The optional extra that it needs.
    sniff : callable
        True for a file (or folder) of this format, by its first bytes; never raises.
    read : callable
        Raises InputError, DataError or MissingExtraError, nothing else.
    options : frozenset of str
        Fields of ImportOptions that it takes in addition to the common ones; others are refused.
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
    "phyphox": "srt.recording.importers.sensor_logger:PHYPHOX",
    "sensor-logger": "srt.recording.importers.sensor_logger:SENSOR_LOGGER",
    "matlab": "srt.recording.importers.matlab:MATLAB",
    "hdf5": "srt.recording.importers.arrays:HDF5",
    "parquet": "srt.recording.importers.arrays:PARQUET",
    "npz": "srt.recording.importers.arrays:NPZ",
    "euroc": "srt.recording.importers.csv_formats:EUROC",
    "kalibr": "srt.recording.importers.csv_formats:KALIBR",
    "imu-tk": "srt.recording.importers.csv_formats:IMU_TK",
    "microstrain": "srt.recording.importers.vendor_tables:MICROSTRAIN",
    "xsens": "srt.recording.importers.vendor_tables:XSENS",
    "kf-gins": "srt.recording.importers.vendor_tables:KF_GINS",
    "novatel": "srt.recording.importers.text_messages:NOVATEL",
    "vectornav": "srt.recording.importers.text_messages:VECTORNAV",
    "psins": "srt.recording.importers.psins:PSINS",
    "csv": "srt.recording.importers.csv_formats:CSV",
}
"""Name to "module:attribute"; formats with the most certain marks come first."""


def register(name: str, target: str) -> None:
    """Add a format.

    Parameters
    ----------
    target : str
        "module:attribute" of an :class:`Importer`. It is tried before the existing ones.

    Raises
    ------
    InputError
        If the name is taken.
    """
    if name in IMPORTERS or name == AUTO:
        raise InputError(f"The format {name!r} exists already: choose another name.")
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
    """Find the format of a file, or of a folder for formats that are folders, by its content, then by its suffix.

    A name other than "auto" is not checked against the content. Raises InputError: a file that is absent, an unknown
    name, or no format that fits.
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
    if path.is_dir():
        raise InputError(
            f"{path} is a folder, and not one of a format that is a folder (srt convert --list): name the log in it."
        )
    raise InputError(f"The format of {path} was not recognised: name it with {option('format')}, as one of {_names()}.")


def import_file(path: Path, options: ImportOptions | None = None, name: str = AUTO) -> tuple[Importer, ImportedSamples]:
    """Read a foreign file: its format, and its samples in the axes of the IMU, without repeated records.

    Raises InputError as :func:`find_importer` does, for an option that the format does not take, or a fault of the
    file, in one sentence that names the file; DataError; MissingExtraError if the format needs a package that is not
    installed.
    """
    options = options or ImportOptions()
    if name == AUTO and options.second is not None:
        name = "imu-tk"
    chosen = find_importer(path, name)
    unused = sorted(options.given - chosen.options - COMMON_OPTIONS)
    if unused:
        taken = ", ".join(option(each) for each in sorted(chosen.options)) or "no others"
        raise InputError(
            f"{option(unused[0]) if unused[0] != 'second' else 'A second file'} is given, but the format "
            f"{chosen.name} of {path} does not take it (in addition to units and axes it takes {taken}): leave it "
            f"out, or name another format with {option('format')}."
        )
    try:
        # The recording refuses values that are not finite, and names their place.
        with np.errstate(all="ignore"):
            imported = without_repeats(in_imu_axes(chosen.read(path, options), options))
    except MemoryError:
        raise InputError(f"{path} does not fit into memory: split the recording.") from None
    except OSError as error:
        place, reason = error.filename or path, error.strerror or error
        raise InputError(f"Cannot read {place} ({reason}): check its permissions.") from None
    except (InputError, DataError) as error:
        if type(error) not in (InputError, NotStatedError, DataError):
            raise
        # Errors about arrays do not name their file, and names out of a damaged file may be unprintable.
        text = _printable(str(error))
        raise error.reworded(text if path.name in text else f"{path}: {text}") from None
    if len(imported.gyro) == 0:
        raise InputError(f"{path} holds no samples of an IMU: name another file.")
    return chosen, replace(imported, notes=tuple(map(_printable, imported.notes)))


def head(path: Path, size: int = HEAD_BYTES) -> bytes:
    """First bytes of a file; empty for a folder or an unreadable file."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(size)
    except (OSError, ValueError):
        return b""


def starts_with(*magics: bytes) -> Callable[[Path], bool]:
    """Recognition of a format by its first bytes."""
    return lambda path: head(path, 16).startswith(magics)


def _require(path: Path) -> None:
    try:
        if path.is_file() or path.is_dir():
            return
        reason = "it is neither a file nor a folder" if path.exists() else "it does not exist"
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
    raise InputError(f"There is no file {path} to read ({reason}): check the path.")


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _names() -> str:
    return ", ".join(IMPORTERS)


def is_foreign(path: Path) -> bool:
    """True for a file or folder of a format that has an importer, and is no format of samples in a recording."""
    if path.suffix.lower().removeprefix(".") in SAMPLES_FORMATS:
        return False
    try:
        find_importer(path)
    except InputError:
        return False
    return True
