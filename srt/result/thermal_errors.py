"""Sensor errors of a unit over temperature: a Chebyshev series of each parameter, with its covariance.

``p_k(T) = Σ_j c_kj T_j(τ)``, ``τ = (T − T_mid) / T_half``, with the Chebyshev polynomials of the first kind, which are
at most 1 within the temperatures of the tests.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from srt.exceptions import InputError
from srt.sensor_errors import N_PARAMETERS
from srt.types import Array

_ARRAYS: Final = ("coefficients", "covariance", "visit_sigma", "degree")
_POINTS: Final = 201
"""Temperatures at which curves are looked at for their largest and smallest value."""


@dataclass(frozen=True, slots=True, eq=False)
class ThermalErrors:
    """Sensor errors over temperature.

    Attributes
    ----------
    lowest_c, highest_c : float
        Temperatures of the tests, °C; the errors are known between them.
    tests_c : tuple of float
        Mean temperature of each test, °C.
    coefficients : ndarray, shape (D + 1, 27), SI
    covariance : ndarray, shape ((D + 1) 27, (D + 1) 27), SI
        Covariance of the coefficients, those of one order together.
    visit_sigma : ndarray, shape (27,), SI
        1-sigma of a later visit of a temperature about the curve: repeatability between tests and hysteresis.
    degree : ndarray of int, shape (27,)
        Highest order that the tests show of each parameter.

    Raises
    ------
    InputError
        Shapes that do not fit, or values that are not finite.
    """

    lowest_c: float
    highest_c: float
    tests_c: tuple[float, ...]
    coefficients: Array
    covariance: Array
    visit_sigma: Array
    degree: Array

    def __post_init__(self) -> None:
        arrays = {name: np.array(getattr(self, name), dtype=np.float64) for name in _ARRAYS}
        orders = len(arrays["coefficients"])
        size = orders * N_PARAMETERS
        shapes = {
            "coefficients": (orders, N_PARAMETERS),
            "covariance": (size, size),
            "visit_sigma": (N_PARAMETERS,),
            "degree": (N_PARAMETERS,),
        }
        for name, array in arrays.items():
            if array.shape != shapes[name] or not np.isfinite(array).all():
                raise InputError(f"{name} of a thermal calibration is no array of {shapes[name]} finite numbers.")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if not self.lowest_c < self.highest_c:
            raise InputError(f"A thermal calibration is for {self.lowest_c} to {self.highest_c} °C: give a range.")

    def basis(self, temperature_c: ArrayLike) -> Array:
        """Chebyshev polynomials at temperatures of shape (...), shape (..., D + 1); constant outside the range."""
        inside = np.clip(np.asarray(temperature_c, dtype=np.float64), self.lowest_c, self.highest_c)
        orders = len(self.coefficients)
        return np.asarray(chebyshev.chebvander(self._reduced(inside), orders - 1).reshape(*inside.shape, orders))

    def values(self, temperature_c: ArrayLike) -> Array:
        """Errors at temperatures of shape (...), SI, shape (..., 27); outside the range those at its end."""
        return np.asarray(self.basis(temperature_c) @ self.coefficients)

    def covariance_at(self, temperature_c: float) -> dict[str, Array]:
        """Covariance (27, 27) of the errors at a later visit of a temperature, by source.

        Outside the range, where the values are those at its end, it has the change that the slope there gives.
        """
        basis = self.basis(temperature_c)
        by_order = self.covariance.reshape(len(basis), N_PARAMETERS, len(basis), N_PARAMETERS)
        out = {
            "thermal_fit": np.einsum("i,ikjl,j->kl", basis, by_order, basis),
            "between_tests": np.diag(self.visit_sigma**2),
        }
        beyond = max(self.lowest_c - temperature_c, temperature_c - self.highest_c, 0.0)
        if beyond:
            end = self._reduced(np.clip(temperature_c, self.lowest_c, self.highest_c))
            slope = chebyshev.chebval(end, chebyshev.chebder(self.coefficients)) * self._per_kelvin
            derivative = np.array([chebyshev.chebval(end, chebyshev.chebder(row)) for row in np.eye(len(basis))])
            variance = np.einsum("i,ikjk,j->k", derivative, by_order, derivative) * self._per_kelvin**2
            out["outside_range"] = np.diag(beyond**2 * (slope**2 + variance))
        return out

    def require_inside(self, temperature_c: ArrayLike, what: str) -> None:
        """Raise InputError if temperatures of ``what`` are outside the range, or not finite."""
        T = np.asarray(temperature_c, dtype=np.float64)
        low, high = float(T.min(initial=np.inf)), float(T.max(initial=-np.inf))
        if T.size and not (self.lowest_c <= low and high <= self.highest_c):
            stated = f"{low:.1f}" if low == high else f"{low:.1f} to {high:.1f}"
            raise InputError(
                f"{what}: {stated} °C, but the unit was calibrated at {self.lowest_c:.1f} to {self.highest_c:.1f} °C: "
                "calibrate it at that temperature, or hold the values at the end of the range (clip)."
            )

    def _reduced(self, temperature_c: Array) -> Array:
        return np.asarray((2.0 * temperature_c - self.lowest_c - self.highest_c) / (self.highest_c - self.lowest_c))

    @property
    def _per_kelvin(self) -> float:
        return 2.0 / (self.highest_c - self.lowest_c)

    def spread(self) -> Array:
        """Largest less smallest value of each parameter within the range, SI, shape (27,)."""
        values = self.values(np.linspace(self.lowest_c, self.highest_c, _POINTS))
        return np.asarray(np.ptp(values, axis=0))
