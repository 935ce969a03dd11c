"""Gyros that follow specific force: a bias that changes with the pose, and turns with the body (Savage 2020, §9.4).

Raw gyro readings have one more term, ``ω̃ = Mg ω + κ_Asym ∘ |ω| + κ_Bias + Γ f + noise``, f the specific force in B.
At rest f is known and so is the Earth's rate, and every window w is one equation ``r_w = κ_Bias + Γ f_w`` for the rate
left at rest. A vertical along one axis shows a sum of bias and Γ; other poses take it apart. Weighted least squares
with the windows' durations as weights p gives

    ``Γ = Σ_w r_w l_wᵀ``,    l_w = p_w S⁺ (f_w − f̄),    S = Σ_w p_w (f_w − f̄)(f_w − f̄)ᵀ,

and the bias is what is left of the pooled rate, at no specific force. As the l_w add up to zero the bias takes no part
in Γ; and as S⁺ is taken from the same f, an error of the accelerometers that is linear in f changes Γ f by a constant.

In a turn f is what the accelerometers recorded: a reading of what the gyros felt at that moment, lever arms and the
start of a turn included, where gravity carried along by the attitude would be neither; and it is there before the
attitude is. Its noise comes in as Γ times the accelerometers' random walk, parts in a thousand of the gyros' own.

So the term is taken off the raw samples before anything else is done, and is renewed with every play-back like the
biases of the sequences. What is wrong with r_w goes through Γ into every window and, by ``−∫ F (Ĉ D)_ab f_c dt``, into
the attitude error of every turn (:func:`carried`). Neglected: the noise of the f_w, which acts times Γ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from srt.exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from srt.model.analytic_platform import GyroStream
    from srt.model.sensor_model import Triad
    from srt.result.calibration import Calibration
    from srt.types import Array


MODE: Final = "g-sensitive"
"""Value of the option ``gyro_bias`` that asks for all this."""
KEY: Final = "g_sensitivity"
"""Of the diagnostics of a result."""
LEAST_SPREAD: Final = 0.1
"""Of g, rms: a direction along which the specific force of the windows varies less than this is not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseRegression:
    """How the rates of W windows make a g-sensitivity.

    Attributes
    ----------
    weights : ndarray, shape (W, 3), s²/m
        l_w; they add up to zero.
    unseen : ndarray, shape (m, 3)
        Unit vectors in B along which the windows hardly differ; Γ is zero along them.
    """

    weights: Array
    unseen: Array

    def fit(self, rate: Array) -> Array:
        """Γ of the rates of windows, shape (W, 3) or (W, 3, S): (3, 3) or (3, 3, S), rad/s per m/s²."""
        out: Array = np.einsum("wa...,wc->ac...", rate, self.weights)
        return out


def pose_regression(force: Array, pool: Array, gravity: float) -> PoseRegression:
    """Set up the regression of rates at rest on the specific force.

    Parameters
    ----------
    force : ndarray, shape (W, 3), m/s²
        Compensated mean specific force of the windows, in B.
    pool : ndarray, shape (W,)
        Weights of the windows, which add up to one.
    gravity : float, m/s²
    """
    spread = force - pool @ force
    sizes, axes = np.linalg.eigh((pool[:, None] * spread).T @ spread)
    seen = sizes > (LEAST_SPREAD * gravity) ** 2
    inverse = (axes[:, seen] / sizes[seen]) @ axes[:, seen].T
    return PoseRegression(pool[:, None] * (spread @ inverse), axes[:, ~seen].T)


def compensate_stream(stream: GyroStream, force: Array, accel: Triad, matrix: Array) -> GyroStream:
    """Take Γ f off raw gyro samples, and leave f with them.

    Parameters
    ----------
    stream : GyroStream
        Raw.
    force : ndarray, shape (3, n), m/s²
        Raw specific force of the same samples.
    accel : Triad
        Errors to compensate it with.
    matrix : ndarray, shape (3, 3), rad/s per m/s²
        Γ.
    """
    velocity = np.ascontiguousarray(accel.compensate(force.T).T) * stream.interval_s
    followed = matrix @ velocity
    return replace(stream, increments=stream.increments - followed, smooth=stream.smooth - followed, velocity=velocity)


def compensate_g_sensitivity(
    calibration: Calibration,
    gyro: ArrayLike,
    accel: ArrayLike,
    *,
    kind: Literal["rate", "increment"] = "rate",
    dt: float | ArrayLike | None = None,
) -> Array:
    """Take Γ f off gyro readings by a calibration that holds Γ; the result is for :meth:`srt.Calibration.apply`.

    Parameters
    ----------
    calibration : Calibration
        Made with ``gyro_bias="g-sensitive"``.
    gyro, accel : array_like, shape (n, 3) or (3,)
        Readings: rad/s and m/s², or for increments rad and m/s.
    kind, dt
        As for :meth:`srt.Calibration.apply`.

    Returns
    -------
    ndarray
        Gyro readings of the shape and unit of the input.

    Raises
    ------
    InputError
        If the calibration holds no g-sensitivity; and what :meth:`srt.Calibration.apply` raises.
    """
    if KEY not in calibration.diagnostics:
        raise InputError(
            f"The calibration holds no g-sensitivity: calibrate with gyro_bias={MODE!r}, or apply it as it is."
        )
    force = calibration.apply(gyro, accel, kind=kind, dt=dt)[1]
    matrix: Array = np.array(calibration.diagnostics[KEY]["matrix"], dtype=np.float64)
    return np.asarray(np.asarray(gyro, dtype=np.float64) - force @ matrix.T)
