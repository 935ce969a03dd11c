"""Modelled drift of the accelerometer biases, as the point about which the SRT measurements are linear.

The measurements contain the magnitude of the specific force, which a drift of tens of mg does not change linearly. The
estimated drift is therefore subtracted from the readings, and its linear effect E c added to z. The covariance of z
contains σ² E Eᵀ with a wide σ, so that the same E must stand in both.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation import measurement_covariance

if TYPE_CHECKING:
    from srt.estimation.drift_model import Unmodelled
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


class ForceDrift:
    """Coefficients of the drift of the accelerometers that an iteration models, and their effect on z.

    Parameters
    ----------
    data : PreparedRecording
    unmodelled : Unmodelled
        Its drift terms; those of the gyros are not used.
    """

    def __init__(self, data: PreparedRecording, unmodelled: Unmodelled) -> None:
        self.data = data
        self.terms = [term for term in unmodelled.drift if term.sensor == "accel"]
        self._shapes = [data.drift_shapes[term.form].windows for term in self.terms]
        self._coefficients = [np.zeros((shape.shape[1], 3)) for shape in self._shapes]
        self._effects: list[Array] = []

    @property
    def in_windows(self) -> Array | float:
        """Estimated drift of the raw channels in the windows, shape (W, 3), m/s²; zero without terms."""
        return sum((shape @ c for shape, c in zip(self._shapes, self._coefficients, strict=True)), 0.0)

    def linearise(self, measurements: SrtMeasurements) -> None:
        """Compute the effect on z at these measurements, from which the covariance of z is computed too."""
        self._effects = [measurement_covariance.force_drift(measurements, self.data, term.form) for term in self.terms]

    def added_to(self, measurements: SrtMeasurements) -> SrtMeasurements:
        """Measurements with the linear effect of the drift that was subtracted from the readings."""
        if not self._effects:
            return measurements
        effects = (E @ c.ravel() for E, c in zip(self._effects, self._coefficients, strict=True))
        return replace(measurements, z=measurements.z + sum(effects))

    def update(self, measurements: SrtMeasurements, correction: Array, covariance: Array) -> float:
        """Estimate the coefficients; return the largest change of the drift in a window, m/s².

        Parameters
        ----------
        measurements : SrtMeasurements
        correction : ndarray, shape (27,)
            Correction of the sensor errors.
        covariance : ndarray, shape (n_z, n_z)
            Of z, with the drift.
        """
        if not self._effects:
            return 0.0
        scale = 1.0 / np.sqrt(np.diag(covariance))
        residual = (measurements.z - measurements.H @ correction) * scale
        weighted = np.linalg.solve(covariance * np.outer(scale, scale), residual) * scale
        before = self.in_windows
        self._coefficients = [
            term.sigma**2 * (E.T @ weighted).reshape(-1, 3) for term, E in zip(self.terms, self._effects, strict=True)
        ]
        return float(np.abs(self.in_windows - before).max())
