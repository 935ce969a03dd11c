"""Unknown part of the Earth rate (no heading or no latitude) from the rates of the windows at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class EarthRateRegression:
    """Linear estimate ε = G (rates at rest) of the unknown Earth rate in units of its prior sigma, with prior N(0, 1).

    Attributes
    ----------
    rate : ndarray, shape (K, 3, S), rad/s
        Unknown Earth rate per unit draw, in each B_Strt.
    on_rest_rate : ndarray, shape (W, 3, S), rad/s
        The same in each window, in B.
    gain : ndarray, shape (S, W, 3), s/rad
    components : int
        Unknown components, 2 or 3, of each of the S / components independent Earth-fixed frames.
    draws : ndarray, shape (S,)
        The estimate.
    by_errors : ndarray, shape (S, 27)
        Derivative of the estimate with respect to the remaining sensor errors.
    """

    rate: Array
    on_rest_rate: Array
    gain: Array
    components: int
    draws: Array
    by_errors: Array

    def fit(self, rest_rate: Array) -> Array:
        """Estimates, shape (S, n), from rates at rest, shape (W, 3, n), rad/s."""
        return np.asarray(np.einsum("swa,wan->sn", self.gain, rest_rate))

    def after(self, rate: Array, weight_s: Array) -> tuple[Array, Array]:
        """Disturbances of the rates at rest less their fit, shape (W, 3, n), and the effect on φ, shape (K, 3, n)."""
        draws = self.fit(rate)
        return rate - self.on_rest_rate @ draws, -weight_s[:, None, None] * (self.rate @ draws)

    def after_correction(self, correction: Array) -> Array:
        """Estimate after a correction of the sensor errors, shape (S,), no larger than the Earth rate itself.

        With n components, a unit draw is 1/√n of the Earth rate.
        """
        parts = (self.draws - self.by_errors @ correction).reshape(-1, self.components)
        size = np.maximum(np.linalg.norm(parts, axis=1, keepdims=True), 1e-300)
        return np.asarray((parts * np.minimum(1.0, np.sqrt(self.components) / size)).ravel())


def earth_rate_regression(rate: Array, on_rest_rate: Array, sigma: Array, components: int) -> EarthRateRegression:
    """Regression of the rates at rest on a common bias and the unknown Earth rate.

    Parameters
    ----------
    rate, on_rest_rate : ndarray, shape (K, 3, S) and (W, 3, S), rad/s
    sigma : ndarray, shape (W, 3), rad/s
        1-sigma of the rate of each window: noise and bias variation.
    components : int
    """
    W, S = len(sigma), rate.shape[2]
    bias = np.broadcast_to(np.eye(3), (W, 3, 3))
    # Biases in units of the smallest sigma, for the condition number.
    A = np.concatenate([bias * sigma.min(), on_rest_rate], axis=2) / sigma[:, :, None]
    A = A.reshape(3 * W, 3 + S)
    prior = np.diag(np.concatenate([np.zeros(3), np.ones(S)]))
    gain = np.linalg.solve(A.T @ A + prior, A.T)[3:].reshape(S, W, 3) / sigma
    return EarthRateRegression(rate, on_rest_rate, gain, components, np.zeros(S), np.zeros((S, N_PARAMETERS)))
