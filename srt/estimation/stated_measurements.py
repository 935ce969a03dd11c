"""Measurements against what labels state: the vertical of poses on a fixture, and the rate of a rate table.

A pose does not rotate, so that the change of its horizontal specific force shows no sensor error; in a run at a stated
rate, this change shows many revolutions, modulo one. The two horizontal measurements of such sequences are replaced:

* pose: if no sequence of the recording rotates and a fixture states the vertical, the horizontal components of the
  pose's mean specific force along the nominal axes; otherwise the change between its halves in axes of the unit, which
  has no derivative;
* stated rate Ω about an axis: in each half of the steady window ``|ω̂| − ω̂e·ω̂/|ω̂| − |Ω|``. The Earth rate along the
  axis is constant while the unit turns about it, and the magnitude is free of mounting errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.exceptions import DataError
from srt.model import measurement_model as model

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.model.rotation_integrals import RotationIntegrals
    from srt.model.sensor_model import Triad
    from srt.recording.recording import SequenceLabel
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


def refuse_stated_rates(labels: Iterable[SequenceLabel]) -> None:
    """Refuse labels that state a rate, for estimators that do not use it.

    Raises
    ------
    DataError
    """
    rated = next((label for label in labels if label.rate is not None), None)
    if rated is not None:
        raise DataError(f"{rated.title} states a rate, which ekf and graph do not use: calibrate with least-squares.")


@dataclass(frozen=True, slots=True, eq=False)
class StatedMeasurements:
    """Statements of a recording's labels as arrays, which do not depend on the sensor errors.

    Attributes
    ----------
    posed : ndarray of bool, shape (K,)
        Poses without a rotation.
    directed : bool
        True if the poses show the vertical of a fixture.
    rated : ndarray of int, shape (R,)
        Sequences at a stated rate.
    rate : ndarray, shape (R, 2, 3), rad/s
        Mean gyro reading over each half of the steady window.
    duration_s : ndarray, shape (R, 2)
    stated : ndarray, shape (R,), rad/s
        Magnitude of the stated rate.
    sigma : ndarray, shape (R,)
        Its relative 1-sigma error.
    """

    posed: Mask
    directed: bool
    rated: Indices
    rate: Array
    duration_s: Array
    stated: Array
    sigma: Array

    @classmethod
    def of(cls, data: PreparedRecording) -> StatedMeasurements:
        """Gather what the labels state, and the mean readings in the steady windows."""
        recording = data.recording
        factor = 1.0 if recording.kind == "rate" else 1.0 / recording.nominal_interval_s
        rated, means, counts, stated, sigma = [], [], [], [], []
        for k, label in enumerate(data.labels):
            if label.rate is None or label.steady_s is None or label.rate_sigma is None:
                continue
            window = recording.window_indices(*label.steady_s)
            halves = np.array_split(recording.gyro[window], 2)
            rated.append(k)
            means.append([half.mean(axis=0) * factor for half in halves])
            counts.append([len(half) for half in halves])
            stated.append(abs(label.rate[1]))
            sigma.append(label.rate_sigma)
        return cls(
            data.posed,
            bool(data.posed.all()) and data.nominal is not None,
            np.array(rated, dtype=np.intp),
            np.array(means).reshape(-1, 2, 3),
            np.array(counts, dtype=np.float64).reshape(-1, 2) * recording.nominal_interval_s,
            np.array(stated),
            np.array(sigma),
        )

    @property
    def replaced(self) -> Mask:
        """True for the sequences whose horizontal measurements do not show an attitude error, shape (K,)."""
        out = self.posed.copy()
        out[self.rated] = True
        return out

    def spin_axes(self, gyro: Triad) -> Array:
        """Unit vectors of the compensated rates in the halves of the steady windows, shape (R, 2, 3)."""
        rate = self._compensated(gyro)
        return np.asarray(rate / np.linalg.norm(rate, axis=2, keepdims=True))

    def _compensated(self, gyro: Triad) -> Array:
        return gyro.compensate(self.rate.reshape(-1, 3)).reshape(-1, 2, 3)

    def replace(
        self,
        horizontal: Array,
        jacobian: Array,
        *,
        basis: Array,
        force: tuple[Array, Array],
        earth_rate: Array,
        triads: tuple[Triad, Triad],
    ) -> tuple[Array, Array]:
        """Horizontal measurements and their Jacobian with the rows of poses and of stated rates replaced.

        Parameters
        ----------
        horizontal : ndarray, shape (K, 2)
        jacobian : ndarray, shape (K, 2, 27)
        basis : ndarray, shape (K, 2, 3)
        force : (ndarray, ndarray), shape (K, 3), m/s²
            Compensated specific force in start and end window, in B.
        earth_rate : ndarray, shape (K, 3), rad/s
            ω̂e in B_Strt.
        triads : (Triad, Triad)
            Sensor models of gyros and accelerometers.
        """
        if not self.replaced.any():
            return horizontal, jacobian
        gyro, accel = triads
        horizontal, jacobian = horizontal.copy(), jacobian.copy()
        jacobian[self.posed] = 0.0
        horizontal[self.posed] = np.einsum("kia,ka->ki", basis, force[1] - force[0])[self.posed]
        if self.directed:
            horizontal = np.einsum("kia,ka->ki", basis, 0.5 * (force[0] + force[1]))
            jacobian = basis @ (0.5 * sum(model.force_error_jacobian(f, accel) for f in force))
        rate, axes = self._compensated(gyro), self.spin_axes(gyro)
        along = np.einsum("rha,ra->rh", axes, earth_rate[self.rated])
        horizontal[self.rated] = np.linalg.norm(rate, axis=2) - along - self.stated[:, None]
        by_errors = model.rate_error_jacobian(rate.reshape(-1, 3), gyro).reshape(-1, 2, 3, jacobian.shape[2])
        jacobian[self.rated] = np.einsum("rha,rhap->rhp", axes, by_errors)
        return horizontal, jacobian

    def change_of_force(self, basis: Array, integrals: RotationIntegrals, start: Array, end: Array) -> Array:
        """Effect of force disturbances, shape (K, 3, S) in start and end window, on the measurements, (K, 2, S)."""
        if self.directed:
            return np.asarray(basis @ (0.5 * (start + end)))
        out: Array = basis @ (np.where(self.posed[:, None, None], end, integrals.C_end @ end) - start)
        out[self.rated] = 0.0
        return out
