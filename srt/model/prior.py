"""Prior of the sensor errors: their mean and covariance before the test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from srt.exceptions import InputError
from srt.sensor_errors import N_PARAMETERS, NAMES, SensorErrors, by_parameter

if TYPE_CHECKING:
    from srt.types import Array, Mask


_SYMMETRY: Final = 1e-9
"""Largest asymmetry of a correlation matrix that counts as rounding of its file."""


def prior_sigma() -> Array:
    """Standard deviations of the 27 errors without any data, SI."""
    return by_parameter("prior_sigma")


class CalibratedErrors(Protocol):
    """Attributes of an earlier calibration that a prior uses; :class:`srt.Calibration` has them."""

    @property
    def errors(self) -> SensorErrors:
        """Sensor errors."""

    @property
    def covariance(self) -> Array:
        """Covariance, shape (27, 27), SI."""

    @property
    def observed(self) -> Mask:
        """Parameters that were estimated, shape (27,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Gaussian prior of the 27 sensor errors.

    Attributes
    ----------
    mean : SensorErrors
    covariance : ndarray, shape (27, 27), SI units
        Positive definite.

    Raises
    ------
    InputError
        A covariance of another shape, with values that are not finite, not symmetric or not positive definite.
    """

    mean: SensorErrors
    covariance: Array

    def __post_init__(self) -> None:
        if not isinstance(self.mean, SensorErrors):
            raise InputError(f"The prior's mean is {self.mean!r}: give SensorErrors.")
        try:
            P = np.array(self.covariance, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(
                "The prior's covariance is no array of numbers: give a square one of all parameters."
            ) from None
        if P.shape != (N_PARAMETERS, N_PARAMETERS):
            raise InputError(
                f"The prior's covariance has shape {P.shape}; give {N_PARAMETERS} by {N_PARAMETERS} numbers, in the "
                "order of the parameters."
            )
        if not np.all(np.isfinite(P)):
            row, column = np.argwhere(~np.isfinite(P))[0].tolist()
            raise InputError(
                f"The prior's covariance of {NAMES[row]} and {NAMES[column]} is {P[row, column]}: give finite numbers."
            )
        variance = np.diag(P)
        if np.any(variance <= 0.0):
            name = NAMES[int(np.argmin(variance))]
            raise InputError(
                f"The prior's variance of {name} is {variance.min():.3g}: give a positive one, or fix the parameter."
            )
        unit = P / np.sqrt(np.outer(variance, variance))
        if np.abs(unit - unit.T).max() > _SYMMETRY:
            raise InputError("The prior's covariance is not symmetric: give a covariance matrix.")
        smallest = float(np.linalg.eigvalsh(0.5 * (unit + unit.T))[0])
        if smallest <= 0.0:
            raise InputError(
                f"The prior's covariance is indefinite (smallest eigenvalue of its correlations {smallest:.3g}): "
                "give a positive definite one."
            )
        P = 0.5 * (P + P.T)
        P.flags.writeable = False
        object.__setattr__(self, "covariance", P)

    @classmethod
    def from_sigma(cls, sigma: Array, mean: SensorErrors | None = None) -> Prior:
        """Build an uncorrelated prior from one standard deviation per parameter, shape (27,)."""
        return cls(mean or SensorErrors(), np.diag(np.asarray(sigma, dtype=np.float64) ** 2))

    @classmethod
    def from_calibration(cls, calibration: CalibratedErrors, *, growth: float = 1.0) -> Prior:
        """Build a prior from a calibration with its sigmas times ``growth``; fixed parameters get the default prior.

        Raises
        ------
        InputError
            If ``growth`` is not positive.
        """
        if not 0.0 < growth < np.inf:
            raise InputError(f"The growth of a prior's sigmas is {growth!r}: give a positive number.")
        unobserved = ~calibration.observed
        P = calibration.covariance * growth**2
        P[unobserved, unobserved] = prior_sigma()[unobserved] ** 2
        return cls(calibration.errors, P)

    def as_dict(self) -> dict[str, Any]:
        """Mean and covariance as the provenance of a calibration stores them."""
        return {"mean": self.mean.as_dict(), "covariance": self.covariance.tolist()}
