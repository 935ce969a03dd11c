"""Limits of the iterations: of the closed form, and of the joint model."""

from __future__ import annotations

from typing import Final

from srt.sensor_errors import by_parameter

PARAMETER_UNITS: Final = by_parameter("full")
"""SI value of the unit of each parameter in comparisons: accelerometer bias in g, all others in SI units."""
CONVERGED_CORRECTION: Final = 1e-9
"""Correction, in :data:`PARAMETER_UNITS`, that counts as negligible; noise-free data reach it."""
CONVERGED_SIGMAS: Final = 0.01
"""Correction, in sigma of the parameter, that counts as negligible: it changes an error by 1e-4 in quadrature."""
MAX_STEP: Final = 0.7
"""Largest correction of an iteration, in :data:`PARAMETER_UNITS`: of longer steps only the direction is reliable."""
