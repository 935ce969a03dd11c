"""Runs at a stated rate in the joint model: mean rates against that of the table, and the heading that they turn to.

The rotation between the windows of such a run has many revolutions, and is known modulo one: no measurement of scale
factors. Only its component about the vertical is used, which the specific force at the end does not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.error_sources import raw_rate_variance
from srt.model import measurement_model as model
from srt.model.analytic_platform import equal_parts, parts_per_rotation
from srt.model.rotations import cross_matrix

if TYPE_CHECKING:
    from srt.model.sensor_model import Triad
    from srt.noise.noise_model import NoiseModel
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class SteadyReadings:
    """Mean readings in the halves of the steady windows of R runs at a stated rate, and the stated rates.

    Attributes
    ----------
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

    rated: Indices
    rate: Array
    force: Array
    duration_s: Array
    shares: Array
    stated: Array
    sigma: Array

    @classmethod
    def of(cls, data: PreparedRecording) -> SteadyReadings:
        """Gather what the labels state, and the mean readings in the steady windows."""
        recording = data.recording
        factor = recording.rates_factor
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
            at,
            gyro,
            accel,
            np.diff(half[..., 0], axis=1) * recording.nominal_interval_s,
            inside / inside.sum(axis=2, keepdims=True),
            np.array(stated),
            np.array(sigma),
        )

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

    def compensate(self, gyro: Triad, raw_bias: Array, earth_rate: Array, noise: NoiseModel) -> StatedRates:
        """Compensate the mean rates at an estimate.

        Parameters
        ----------
        gyro : Triad
        raw_bias : ndarray, shape (R, 2, 3), rad/s
            Biases of the raw channels in the halves beside the mean bias.
        earth_rate : ndarray, shape (R, 1, 3), rad/s
            In B_Strt; it is a small part of the derivative.
        noise : NoiseModel
        """
        rate = self.compensated(gyro, raw_bias)
        _, by_rate, _ = model.stated_rate_residual(rate, earth_rate, self.stated[:, None])
        by_errors = model.rate_error_jacobian(rate.reshape(-1, 3), gyro)
        return StatedRates(
            self.rated,
            rate,
            self.stated,
            np.broadcast_to(-(self.sigma * self.stated)[:, None, None], (len(rate), 2, 1)),
            np.einsum("rha,rhap->rhp", by_rate, by_errors.reshape(*rate.shape, by_errors.shape[2])),
            {"gyro_noise": self.rate_noise(noise, gyro)},
        )

    def rate_noise(self, noise: NoiseModel, gyro: Triad) -> Array:
        """Covariance by white noise and quantization, diagonal, shape (R, 2, 2), (rad/s)²."""
        variance = np.sum(self.by_raw_rate(gyro) ** 2 * raw_rate_variance(noise, self.duration_s), axis=2)
        return np.asarray(variance[:, :, None] * np.eye(2))


@dataclass(frozen=True, slots=True, eq=False)
class StatedRates:
    """Compensated mean rates of R runs at a stated rate, in the halves of their steady windows.

    Attributes
    ----------
    sequences : ndarray of int, shape (R,)
    rate : ndarray, shape (R, 2, 3), rad/s
        Less the bias deviation of the sequence, the modelled drift and g-sensitivity.
    stated : ndarray, shape (R,), rad/s
        Magnitude of the stated rate.
    by_table_rate : ndarray, shape (R, 2, 1), rad/s
        Derivative of the residual with respect to the error of the table's rate in sigmas, one for all runs.
    jacobian : ndarray, shape (R, 2, 27)
        Negative derivative of the residual with respect to the 27 sensor errors.
    noise : dict of str to ndarray, shape (R, 2, 2)
        Noise covariance by source.
    """

    sequences: Indices
    rate: Array
    stated: Array
    by_table_rate: Array
    jacobian: Array
    noise: dict[str, Array]

    def residual(
        self, runs: Indices, start: Array, earth_rate: Array, table_rate: float
    ) -> tuple[Array, Array, Array, Array]:
        """Residuals (n, 2) of n runs, and derivatives by rotations of B_Strt, Earth's rate and error of the table.

        Parameters
        ----------
        runs : ndarray of int, shape (n,)
        start : ndarray, shape (n, 3, 3)
            Attitudes from which the runs start, B to L.
        earth_rate : ndarray, shape (n, 3), rad/s
            In L.
        table_rate : float
            Error of the table's rate in sigmas.
        """
        to_body = np.swapaxes(start, 1, 2)
        earth = (to_body @ earth_rate[:, :, None])[:, :, 0]
        by_table_rate = self.by_table_rate[runs]
        residual, _, by_earth = model.stated_rate_residual(self.rate[runs], earth[:, None], self.stated[runs, None])
        residual = residual + by_table_rate[:, :, 0] * table_rate
        return residual, by_earth @ cross_matrix(earth), by_earth @ to_body, by_table_rate
