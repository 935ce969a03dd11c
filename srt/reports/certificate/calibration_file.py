"""Calibration of a certificate, with the name and the hash of its file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from srt.arguments import require_type
from srt.recording.file_guards import read_bounded
from srt.result.calibration import Calibration, load_calibration
from srt.result.json_file import json_text

if TYPE_CHECKING:
    from srt.result.provenance import Provenance


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFile:
    """Calibration and its file."""

    calibration: Calibration
    name: str  # of the file, without its folder
    sha256: str  # of the file

    @property
    def serial(self) -> str | None:
        """Serial of the unit; None if not stated."""
        return self.calibration.provenance.serial

    @property
    def origins(self) -> tuple[Provenance, ...]:
        """Provenance of all recordings of the calibration whose samples have a hash."""
        provenance = self.calibration.provenance
        return tuple(origin for origin in provenance.recordings or (provenance,) if origin.data_sha256)

    @property
    def hashes(self) -> tuple[str, ...]:
        """SHA-256 of the samples of all recordings of the calibration."""
        return tuple(str(origin.data_sha256) for origin in self.origins)


def calibration_file(source: Calibration | str | PathLike[str]) -> CalibrationFile:
    """Calibration of a certificate, from its file or from memory; the hash of the latter is that of its file.

    Raises InputError as :func:`srt.load_calibration`, and for a file without a digest: nothing tells that it is as
    written.
    """
    require_type("A certificate", "a calibration, or the path of one", source, Calibration, str, PathLike)
    if isinstance(source, Calibration):
        return CalibrationFile(source, "not saved", hashlib.sha256(json_text(source.to_dict()).encode()).hexdigest())
    calibration = load_calibration(source, signed=True)
    path = Path(source)
    return CalibrationFile(calibration, path.name, hashlib.sha256(read_bounded(path)).hexdigest())
