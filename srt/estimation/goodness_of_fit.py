"""Chi-square of the residuals: agreement of the measurements with each other and with their stated noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

if TYPE_CHECKING:
    from srt.estimation.iteration import Solution
    from srt.types import Mask


MISFIT_PROBABILITY: Final = 1e-3
"""p-value of chi-square below which residuals count as larger than the noise: one false alarm in 1000 recordings."""
GROSS_RATIO: Final = 100.0
"""Chi-square per degree of freedom above which no noise figure can be the cause (sigmas ten times too small)."""
GROSS_G: Final = 0.01
"""Smallest rms of the horizontal residuals, in g, of a gross misfit: 10 mrad, far beyond any attitude noise."""


def chi_square(solution: Solution, fixed: Mask) -> tuple[float, int]:
    """Smallest weighted square sum of the residuals over all values of the free parameters; degrees of freedom."""
    R, z = solution.measurement_covariance, solution.measurements.z
    if fixed.all():
        return 0.0, 0
    with np.errstate(all="ignore"):
        scale = 1.0 / np.sqrt(np.diag(R))
        scaled = R * np.outer(scale, scale)
    try:
        L = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        return 0.0, 0  # far outside the model, R is not positive definite; the status reports that failure
    H = np.linalg.solve(L, solution.measurements.H[:, ~fixed] * scale[:, None])
    y = np.linalg.solve(L, z * scale)
    orthonormal, _ = np.linalg.qr(H / np.linalg.norm(H, axis=0))
    y = y - orthonormal @ (orthonormal.T @ y)
    return float(y @ y), len(z) - int((~fixed).sum())


def is_misfit(chi_square: float, degrees_of_freedom: int) -> bool:
    """Return True if noise alone makes the residuals this large with p < 1e-3."""
    return degrees_of_freedom > 0 and chi_square > float(chdtri(degrees_of_freedom, MISFIT_PROBABILITY))


def is_gross(solution: Solution, chi_square: float, degrees_of_freedom: int, gravity: float) -> bool:
    """Return True if the residuals are too large for any noise: a wrong minimum, a wrong label, or a broken unit."""
    horizontal = solution.measurements.z[: 2 * len(solution.measurements.acceleration)]
    return (
        degrees_of_freedom > 0
        and chi_square / degrees_of_freedom > GROSS_RATIO
        and float(np.sqrt(np.mean(horizontal**2))) > GROSS_G * gravity
    )
