"""Gyro g-sensitivity: a gyro bias proportional to specific force (Savage 2020 [P], §9.4).

The sensor model gets one more term, ``ω̃ = Mg ω + κ_Asym ∘ |ω| + κ_Bias + Γ f + noise``, with f the specific force in
B. At rest f and the Earth rate are known, so that every window w gives ``r_w = κ_Bias + Γ f_w`` for its rest rate.
Weighted least squares, with the window durations as weights p, gives

    ``Γ = Σ_w r_w l_wᵀ``,    l_w = p_w S⁺ (f_w − f̄),    S = Σ_w p_w (f_w − f̄)(f_w − f̄)ᵀ,

and the bias is the pooled rest rate at zero specific force. The l_w add up to zero, so that the bias does not enter Γ.
An accelerometer error linear in f changes Γ f by a constant only.

In a rotation f is the recorded specific force, lever-arm accelerations included, which is what acts on the gyros. Its
noise enters as Γ times the velocity random walk, 1e-3 of the gyro noise.

Γ f is subtracted from the raw samples first and updated in every iteration, like the biases of the sequences. An error
of r_w propagates through Γ into every window and, by ``−∫ F (Ĉ D)_ab f_c dt``, into the attitude error of every
rotation. The noise of f_w, multiplied by Γ, is neglected. Whether Γ is estimated unasked,
:func:`~srt.estimation.g_sensitivity_report.significant_g_sensitivity` tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from srt.model.gyro_stream import GyroStream
    from srt.model.sensor_model import Triad
    from srt.types import Array, Indices, Mask


MODE: Final = "g-sensitive"
"""Value of the option ``gyro_bias`` that estimates g-sensitivity."""
LEAST_FORCE_VARIATION: Final = 0.1
"""Rms variation of the windows' specific force, in g, below which g-sensitivity along a direction is not observable."""
LEAST_SCATTER: Final = 0.1
"""Share of the bias variance between sequences that remains after the fit of g-sensitivity; below it, no estimate."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseRegression:
    """Regression of the rest rates of W windows on specific force.

    Attributes
    ----------
    weights : ndarray, shape (..., W, 3), s²/m
        l_w; they add up to zero.
    axes : ndarray, shape (..., 3, 3)
        Columns: principal directions of the specific force, in B.
    seen : ndarray of bool, shape (..., 3)
        Directions along which the specific force varies; Γ is zero along the others.
    """

    weights: Array
    axes: Array
    seen: Mask

    @property
    def observed(self) -> Array:
        """Unit vectors in B along which the specific force of one unit varies, shape (3 − m, 3)."""
        return np.asarray(self.axes[:, self.seen].T)

    @property
    def unobserved(self) -> Array:
        """Unit vectors in B along which that of one unit hardly varies, shape (m, 3)."""
        return np.asarray(self.axes[:, ~self.seen].T)

    def fit(self, rate: Array) -> Array:
        """Γ, shape (..., 3, 3), rad/s per m/s², from window rates, shape (..., W, 3)."""
        out: Array = np.swapaxes(rate, -1, -2) @ self.weights
        return out

    def scatter_left(self, force: Array, deviation: Array, sequence: Indices) -> Array:
        """Share of the variance of a bias per sequence that remains after the regression.

        Parameters
        ----------
        force : ndarray, shape (..., W, 3), m/s²
        deviation : ndarray, shape (K, W)
            Weights of the windows in each sequence's own rate, less those in the pooled rate.
        sequence : ndarray of int, shape (W,)
            Sequence of each window.
        """
        own = np.zeros((len(sequence), len(deviation)))
        own[np.arange(len(sequence)), sequence] = 1.0
        left = own - force @ (np.swapaxes(self.weights, -1, -2) @ own)
        whole = float(np.sum((deviation @ own) ** 2))
        return np.sum((deviation @ left) ** 2, axis=(-1, -2)) / whole if whole > 0.0 else np.ones(force.shape[:-2])


class RestRates(NamedTuple):
    """Rates of the windows at rest and their regression on specific force.

    Attributes
    ----------
    poses : PoseRegression
    force : ndarray, shape (W, 3), m/s²
        Compensated, in B.
    rate : ndarray, shape (W, 3), rad/s
        Compensated rates less the Earth rate.
    pool : ndarray, shape (W,)
        Weights of the windows.
    sequence : ndarray of int, shape (W,)
        Sequence of each window.
    gyro : Triad
        Sensor model that the rates were compensated with.
    """

    poses: PoseRegression
    force: Array
    rate: Array
    pool: Array
    sequence: Indices
    gyro: Triad


def pose_regression(force: Array, pool: Array, gravity: float) -> PoseRegression:
    """Set up the regression of rest rates on specific force.

    Parameters
    ----------
    force : ndarray, shape (W, 3), m/s²
        Compensated mean specific force of the windows, in B.
    pool : ndarray, shape (W,)
        Weights of the windows, which add up to one.
    gravity : float, m/s²
    """
    deviation = force - (pool @ force)[..., None, :]
    sizes, axes = np.linalg.eigh(np.swapaxes(pool[:, None] * deviation, -1, -2) @ deviation)
    seen = sizes > (LEAST_FORCE_VARIATION * gravity) ** 2
    inverse = (axes * np.where(seen, 1.0 / np.where(seen, sizes, 1.0), 0.0)[..., None, :]) @ np.swapaxes(axes, -1, -2)
    return PoseRegression(pool[:, None] * (deviation @ inverse), axes, seen)


def compensate_stream(stream: GyroStream, force: Array, accel: Triad, matrix: Array) -> GyroStream:
    """Subtract Γ f from raw gyro samples, and store the velocity increments with them.

    Parameters
    ----------
    stream : GyroStream
        Raw.
    force : ndarray, shape (3, n), m/s²
        Raw specific force of the same samples.
    accel : Triad
        Sensor model of the accelerometers.
    matrix : ndarray, shape (3, 3), rad/s per m/s²
        Γ.
    """
    by_unit = accel.compensate(force.T.reshape(*matrix.shape[:-2], -1, 3))
    velocity = np.ascontiguousarray(by_unit.reshape(-1, 3).T) * stream.interval_s
    followed = (by_unit @ np.swapaxes(matrix, -1, -2)).reshape(-1, 3).T * stream.interval_s
    return replace(stream, increments=stream.increments - followed, smooth=stream.smooth - followed, velocity=velocity)
