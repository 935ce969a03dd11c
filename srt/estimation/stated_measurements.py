"""Measurements against what labels state: the vertical of poses on a fixture, and the rate of a rate table.

A pose does not rotate, so that the change of its horizontal specific force shows no sensor error; in a run at a stated
rate, this change shows many revolutions, modulo one. The two horizontal measurements of such sequences are replaced:

* pose: if no sequence of the recording rotates and a fixture states the vertical, the horizontal components of the
  pose's mean specific force along the nominal axes; otherwise the change between its halves in axes of the unit, which
  has no derivative;
* stated rate Ω about an axis: in each half of the steady window ``|ω̂| − ω̂e·ω̂/|ω̂| − |Ω|``
  (:func:`srt.model.measurement_model.stated_rate_residual`). The magnitude is free of mounting errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.error_sources import raw_rate_variance
from srt.model import measurement_model as model
from srt.model.analytic_platform import equal_parts, parts_per_rotation

if TYPE_CHECKING:
    from srt.model.rotation_integrals import RotationIntegrals
    from srt.model.sensor_model import Triad
    from srt.noise.noise_model import NoiseModel
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


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
    force : ndarray, shape (R, 2, 3), m/s²
        Mean accelerometer reading over each half.
    duration_s : ndarray, shape (R, 2)
    shares : ndarray, shape (R, 2, P)
        Shares of P equal parts of the rotation in each half.
    stated : ndarray, shape (R,), rad/s
        Magnitude of the stated rate.
    sigma : ndarray, shape (R,)
        Its relative 1-sigma error.
    """

    posed: Mask
    directed: bool
    rated: Indices
    rate: Array
    force: Array
    duration_s: Array
    shares: Array
    stated: Array
    sigma: Array

    @classmethod
    def of(cls, data: PreparedRecording) -> StatedMeasurements:
        """Gather what the labels state, and the mean readings in the steady windows."""
        recording = data.recording
        factor = 1.0 if recording.kind == "rate" else 1.0 / recording.nominal_interval_s
        rated, means, edges, stated, sigma = [], [], [], [], []
        for k, label in enumerate(data.labels):
            if label.rate is None or label.steady_s is None or label.rate_sigma is None:
                continue
            window = recording.window_indices(*label.steady_s)
            halves = [np.array_split(samples[window], 2) for samples in (recording.gyro, recording.accel)]
            rated.append(k)
            means.append([[half.mean(axis=0) * factor for half in sensor] for sensor in halves])
            edges.append([window.start, window.start + len(halves[0][0]), window.stop])
            stated.append(abs(label.rate[1]))
            sigma.append(label.rate_sigma)
        gyro, accel = np.array(means).reshape(-1, 2, 2, 3).swapaxes(0, 1)
        half, at = np.array(edges).reshape(-1, 3, 1), np.array(rated, dtype=np.intp)
        part = equal_parts(data.rotation[at], parts_per_rotation(data.K))[:, None]
        overlap = np.minimum(half[:, 1:], part[..., 1:]) - np.maximum(half[:, :-1], part[..., :-1])
        inside = np.maximum(overlap, 0)
        return cls(
            data.posed,
            bool(data.posed.all()) and data.nominal is not None,
            at,
            gyro,
            accel,
            np.diff(half[..., 0], axis=1) * recording.nominal_interval_s,
            inside / inside.sum(axis=2, keepdims=True),
            np.array(stated),
            np.array(sigma),
        )

    @property
    def replaced(self) -> Mask:
        """True for the sequences whose horizontal measurements do not show an attitude error, shape (K,)."""
        out = self.posed.copy()
        out[self.rated] = True
        return out

    def compensated(self, gyro: Triad, raw_bias: Array | float = 0.0) -> Array:
        """Compensated mean rates in the halves, less biases of the raw channels, shape (R, 2, 3), rad/s."""
        return np.asarray(gyro.compensate((self.rate - raw_bias).reshape(-1, 3)).reshape(-1, 2, 3))

    def compensated_force(self, accel: Triad) -> Array:
        """Compensated mean specific forces in the halves, shape (R, 2, 3), m/s²."""
        return np.asarray(accel.compensate(self.force.reshape(-1, 3)).reshape(-1, 2, 3))

    def by_raw_rate(self, gyro: Triad) -> Array:
        """Derivative of the rate along the axis of the run by the raw channels, shape (R, 2, 3)."""
        rate = self.compensated(gyro)
        axes = rate / np.linalg.norm(rate, axis=2, keepdims=True)
        return np.asarray(np.einsum("rha,rhab->rhb", axes, gyro.sensitivity(rate)))

    def by_parts(self, gyro: Triad) -> Array:
        """The same by biases of the raw channels in P equal parts of the rotation, shape (R, P, 2, 3)."""
        return np.asarray(np.einsum("rhp,rhb->rphb", self.shares, self.by_raw_rate(gyro)))

    def rate_noise(self, noise: NoiseModel, gyro: Triad) -> Array:
        """Covariance by white noise and quantization, diagonal, shape (R, 2, 2), (rad/s)²."""
        variance = np.sum(self.by_raw_rate(gyro) ** 2 * raw_rate_variance(noise, self.duration_s), axis=2)
        return np.asarray(variance[:, :, None] * np.eye(2))

    def replace(
        self,
        horizontal: Array,
        jacobian: Array,
        *,
        basis: Array,
        force: tuple[Array, Array],
        earth_rate: Array,
        triads: tuple[Triad, Triad],
        g_sensitivity: Array,
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
        g_sensitivity : ndarray, shape (3, 3), rad/s per m/s²
            Γ; zero where it is not estimated.
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
        rate = self.compensated(gyro, self.compensated_force(accel) @ g_sensitivity.T)
        horizontal[self.rated], by_rate, _ = model.stated_rate_residual(
            rate, earth_rate[self.rated, None], self.stated[:, None]
        )
        by_errors = model.rate_error_jacobian(rate.reshape(-1, 3), gyro).reshape(-1, 2, 3, jacobian.shape[2])
        jacobian[self.rated] = np.einsum("rha,rhap->rhp", by_rate, by_errors)
        return horizontal, jacobian

    def change_of_force(self, basis: Array, integrals: RotationIntegrals, start: Array, end: Array) -> Array:
        """Effect of force disturbances, shape (K, 3, S) in start and end window, on the measurements, (K, 2, S)."""
        if self.directed:
            return np.asarray(basis @ (0.5 * (start + end)))
        out: Array = basis @ (np.where(self.posed[:, None, None], end, integrals.C_end @ end) - start)
        out[self.rated] = 0.0
        return out
