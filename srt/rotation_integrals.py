"""What a rotation does to gyro errors: the integrals that the measurement model is linear in.

With Ĉ the attitude (B to B_Strt) and δω̂ = D (δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias) the error of the compensated rate
(D the inverse of the reading model's slope, identity for a calibrated unit), the attitude error that acts on the
change of the averaged acceleration is ``φ = ∫ F Ĉ δω̂ dt``. F(t) is 1 in the rotation and 0 in windows over which the
attitude is held; over an integrated window it is the share of the averaging that still lies after t (end window) or
already lies before t (start window). All of it is linear in four integrals, for an ideal rotation in closed form
(Savage 2020, eqs. 3, 20-21) and for a recorded one gathered while the attitude is integrated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.quaternion import cross_matrix, rotation_matrix

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from srt.catalogue import Sequence

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RotationIntegrals:
    """Integrals of K rotations, each in its own B_Strt frame.

    Attributes
    ----------
    C_end : ndarray, shape (K, 3, 3)
        Attitude after the rotation, B_End to B_Strt.
    rate : ndarray, shape (K, 3, 3, 3)
        ``∫ F (Ĉ D)_ab ω̂_c dt``, rad.
    abs_rate : ndarray, shape (K, 3, 3)
        ``∫ F (Ĉ D)_ab |ω̂_b| dt``, rad.
    time : ndarray, shape (K, 3, 3)
        ``∫ F (Ĉ D)_ab dt``, s.
    weight_s : ndarray, shape (K,)
        ``∫ F dt``, s: how long an error of the Earth's rate acts.
    turned : ndarray, shape (K, 3)
        ``∫ ω̂ dt`` over the rotation in B less the Earth's rate, rad: along the axis of a single-axis turn.
    noise : ndarray, shape (K, 3, 3, 3), or None
        ``∫ F² (Ĉ D)_ab (Ĉ D)_cb dt`` as [k, a, c, b], s: contracted with the squared angle random walk of the raw
        channels b it is the covariance of φ.
    velocity : ndarray, shape (K, 3, 3, 3), or None
        ``∫ F (Ĉ D)_ab f_c dt``, m/s: what gyros that follow the specific force f do to φ.
    """

    C_end: Array
    rate: Array
    abs_rate: Array
    time: Array
    weight_s: Array
    turned: Array
    noise: Array | None = None
    velocity: Array | None = None


def ideal_rotations(
    sequences: SequenceOf[Sequence], rate_rad_s: float = 1.0, window_s: float = 0.0, F_meas: float = 0.5
) -> RotationIntegrals:
    """Integrals of the catalogue's rotations turned exactly about IMU axes at a constant rate, error-free sensors.

    Parameters
    ----------
    sequences : sequence of Sequence
        Rotations about IMU axes (K of them).
    rate_rad_s : float
        Magnitude of the turning rate, rad/s.
    window_s : float
        T_Meas of a window with integrated attitude, s; 0 where the attitude is held in the windows.
    F_meas : float
        Output of the averaging algorithm to a unit ramp (1/2 for linear and overlapping averages).

    Returns
    -------
    RotationIntegrals
        With the T_Meas terms of eq. 21, ``T [I + F (C_End − I)]``, in ``time``, as its gyro errors other than bias
        do not act at rest. ``noise`` includes the windows for the linear average.
    """
    K = len(sequences)
    C_end, rate = np.empty((K, 3, 3)), np.zeros((K, 3, 3, 3))
    abs_rate, time, noise = np.zeros((K, 3, 3)), np.zeros((K, 3, 3)), np.zeros((K, 3, 3, 3))
    weight_s, turned = np.empty(K), np.zeros((K, 3))
    for k, sequence in enumerate(sequences):
        C = np.eye(3)
        for u, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
            ux = cross_matrix(u)
            # ∫ exp(βu×) dβ from 0 to θ; for v ⟂ u it is sin θ v + (1 − cos θ) u×v, the bracket of eq. 3.
            swept = C @ (angle * np.eye(3) + (1.0 - math.cos(angle)) * ux + (angle - math.sin(angle)) * (ux @ ux))
            sign = math.copysign(1.0, angle)
            rate[k] += swept[:, :, None] * u
            abs_rate[k] += swept * sign * np.abs(u)
            time[k] += swept * sign / rate_rad_s
            noise[k] += _swept_outer(C, u, angle) / rate_rad_s
            turned[k] += angle * u
            C = C @ rotation_matrix(u * angle)
        C_end[k] = C
        weight_s[k] = np.abs(sequence.angles_rad).sum() / rate_rad_s + window_s
        if window_s > 0.0:
            time[k] += window_s * (np.eye(3) + F_meas * (C - np.eye(3)))
            noise[k] += (window_s / 3.0) * sum(np.einsum("ab,cb->acb", A, A) for A in (np.eye(3), C))
    return RotationIntegrals(C_end, rate, abs_rate, time, weight_s, turned, noise)


def _swept_outer(C: Array, u: Array, angle: float) -> Array:
    """``∫ A_ab A_cb d|β|`` with A = C exp(βu×), by Gauss-Legendre quadrature (exact to rounding for |θ| ≤ 2π)."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    A = C @ rotation_matrix(0.5 * angle * (nodes[:, None] + 1.0) * u)
    out: Array = np.einsum("n,nab,ncb->acb", 0.5 * abs(angle) * weights, A, A)
    return out
