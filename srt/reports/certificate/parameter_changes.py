"""Changes of the parameters of a unit since an earlier calibration, with a test of their significance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtri

from srt.exceptions import InputError, clipped
from srt.result.verdict import USABLE
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from srt.reports.certificate.calibration_file import CalibrationFile
    from srt.types import Array, Mask


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
