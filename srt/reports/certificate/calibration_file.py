"""Calibration of a certificate with the name and the hash of its file, and its changes since an earlier one."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtri

from srt.arguments import require_type
from srt.exceptions import InputError, clipped
from srt.recording.file_guards import read_bounded
from srt.result.calibration import Calibration, load_calibration
from srt.result.json_file import json_text
from srt.result.verdict import USABLE
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from srt.result.provenance import Provenance
    from srt.types import Array, Mask


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
        source.require_one_temperature()
        return CalibrationFile(source, "not saved", hashlib.sha256(json_text(source.to_dict()).encode()).hexdigest())
    calibration = load_calibration(source, signed=True)
    calibration.require_one_temperature()
    path = Path(source)
    return CalibrationFile(calibration, path.name, hashlib.sha256(read_bounded(path)).hexdigest())


FALSE_ALARM: Final = 0.01
"""Probability of any false flag over all parameters, by Bonferroni's bound, which holds for any correlation."""


@dataclass(frozen=True, slots=True, eq=False)
class ParameterChanges:
    """New parameters minus old ones."""

    old: CalibrationFile
    difference: Array  # shape (27,), SI; NaN where one of the two did not measure it, as the sigma
    sigma: Array  # sqrt(sigma_new² + sigma_old²)
    limit: float  # of the absolute change over sigma
    on_trust: bool  # a serial is missing; both are then assumed to be of one unit

    @property
    def ratio(self) -> Array:
        """Change over sigma, shape (27,)."""
        return np.asarray(self.difference / self.sigma)

    @property
    def flagged(self) -> Mask:
        """Mask of the significant changes, shape (27,)."""
        return np.asarray(np.abs(self.ratio) > self.limit)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that are flagged."""
        return tuple(NAMES[i] for i in np.flatnonzero(self.flagged))


def changes_since(new: CalibrationFile, old: CalibrationFile) -> ParameterChanges:
    """Changes since an earlier calibration of the same unit.

    Raises InputError: another unit, an old calibration that did not converge, the same samples, or no parameter
    measured in both.
    """
    if None not in (new.serial, old.serial) and new.serial != old.serial:
        raise InputError(
            f"{old.name} is of the unit {clipped(str(old.serial))}, but {new.name} of {clipped(str(new.serial))}: "
            "give an earlier calibration of the same unit."
        )
    if old.calibration.status not in USABLE:
        raise InputError(
            f"{old.name} has the status {old.calibration.status}: give an earlier calibration that converged."
        )
    if set(new.hashes) & set(old.hashes):
        raise InputError(
            f"{new.name} and {old.name} were computed from the same samples, so that they cannot show a change: give "
            "an earlier calibration, or compare estimators by 'srt compare'."
        )
    difference = new.calibration.errors.vector - old.calibration.errors.vector
    sigma = np.hypot(new.calibration.sigma, old.calibration.sigma)
    compared = ~np.isnan(sigma)
    if not compared.any():
        raise InputError(f"{new.name} and {old.name} have no measured parameter in common: nothing can be compared.")
    limit = -float(ndtri(0.5 * FALSE_ALARM / int(compared.sum())))
    difference = np.where(compared, difference, np.nan)
    return ParameterChanges(old, difference, sigma, limit, None in (new.serial, old.serial))
