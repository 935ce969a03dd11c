"""Attitude error by gyro errors and gyro bias ([P] eqs. 3, 20-21): integrals of a rotation in which it is linear.

With Ĉ the attitude (B to B_Strt) and δω̂ = D (δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias) the error of the compensated rate
(D the inverse slope of the sensor model, identity for a calibrated IMU), the attitude error that acts on the change of
the averaged acceleration is ``φ = ∫ F Ĉ δω̂ dt``. The weight F(t) is 1 in the rotation, and 0 in windows in which the
attitude is held constant. In an integrated window it is the fraction of the averaging after t (end window) or before t
(start window). φ is linear in four integrals. For an ideal rotation they have a closed form ([P]: Savage 2020,
eqs. 3, 20-21); for a recorded one :mod:`srt.model.analytic_platform` computes them with the attitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.model.rotations import cross_matrix, rotation_matrix
from srt.model.table1 import AXES
from srt.sensor_errors import OF_SENSOR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.model.table1 import RotationSequence
    from srt.types import Array


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
        ``∫ F dt``, s: duration over which an error of the Earth's rate acts.
    angle : ndarray, shape (K, 3)
        ``∫ ω̂ dt`` over the rotation in B less the Earth's rate, rad; for a single axis, the angle along it.
    noise : ndarray, shape (K, 3, 3, 3), or None
        ``∫ F² (Ĉ D)_ab (Ĉ D)_cb dt`` as [k, a, c, b], s: its contraction with the squared angle random walk of the
        sensor axes b is the covariance of φ.
    time_parts : ndarray, shape (K, P, 3, 3), or None
        ``time`` of equal parts of the rotation, in their order. An integrated window belongs to the part beside it.
    velocity : ndarray, shape (K, 3, 3, 3), or None
        ``∫ F (Ĉ D)_ab f_c dt``, m/s: effect of gyro g-sensitivity on φ, f the specific force.
    further : ndarray, shape (K, 3, n)
        ``∫ F (Ĉ D) e dt`` with the effects e of the n further errors of the gyros, in the order of the state.
    C_turned : ndarray, shape (K, 3, 3), or None
        Attitude at the end of the rotation itself, before an end window with integrated attitude; None: ``C_end``.
    """

    C_end: Array
    rate: Array
    abs_rate: Array
    time: Array
    weight_s: Array
    angle: Array
    further: Array
    noise: Array | None = None
    time_parts: Array | None = None
    velocity: Array | None = None
    C_turned: Array | None = None

    def reshaped(self, shape: tuple[int, ...]) -> RotationIntegrals:
        """The same with the axis of the rotations as axes of another shape, (units, K)."""
        parts: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        parts = {name: part.reshape(*shape, *part.shape[1:]) for name, part in parts.items() if part is not None}
        return replace(self, **parts)


FURTHER_GYRO: Final = tuple(group for group in OF_SENSOR["gyro"] if group.further)
"""Groups of gyro errors that are no element of the matrix, asymmetry or bias."""


def further_effects(rate: Array) -> Array:
    """Effects of the further errors of the gyros on readings of rates (..., 3), shape (..., 3, n)."""
    return np.concatenate([np.empty((*rate.shape, 0)), *(group.effect(rate) for group in FURTHER_GYRO)], axis=-1)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
"""Gaussian quadrature of an even function from -1 to 1, which is twice that of a ramp from 0 to 1."""


def ideal_rotations(
    sequences: Sequence[RotationSequence],
    rate_rad_s: float | Sequence[Array] = 1.0,
    window_s: float = 0.0,
    F_meas: float = 0.5,
    acceleration_rad_s2: float | Sequence[Array] = math.inf,
) -> RotationIntegrals:
    """Integrals of exact rotations about IMU axes, with error-free sensors.

    Planning and accuracy analysis use them. A calibration takes the integrals of the recorded rotations from
    :func:`srt.model.analytic_platform.integrate_attitude`.

    Parameters
    ----------
    sequences : sequence of RotationSequence
        Rotations about IMU axes (K of them).
    rate_rad_s : float, or sequence of K ndarrays
        Magnitude of the angular rate, rad/s: one for all, or one for every rotation of each sequence.
    window_s : float
        T_Meas of a window with integrated attitude, s; 0 where the attitude is held constant in the windows.
    F_meas : float
        Output of the averaging algorithm to a unit ramp (1/2 for linear and overlapping averages).
    acceleration_rad_s2 : float, or sequence of K ndarrays
        Angular acceleration from rest to the rate and back, rad/s²; infinite: the rate is constant.

    Returns
    -------
    RotationIntegrals
        ``time`` includes the T_Meas terms of [P] eq. 21, ``T [I + F (C_End − I)]``: at rest only the bias acts.
        ``noise`` includes the windows for the linear average.
    """
    K = len(sequences)
    C = np.tile(np.eye(3), (K, 1, 1))
    rate, noise = np.zeros((2, K, 3, 3, 3))
    abs_rate, time = np.zeros((2, K, 3, 3))
    further = np.zeros((K, 3, sum(len(group.suffixes) for group in FURTHER_GYRO)))
    weight_s, total_angle = np.full(K, float(window_s)), np.zeros((K, 3))
    count = np.array([len(s.rotations) for s in sequences])
    for i in range(count.max(initial=0)):
        k = np.flatnonzero(count > i)
        axis = np.array([AXES.index(sequences[j].rotations[i][0]) for j in k.tolist()])
        angle = np.array([sequences[j].rotations[i][1] for j in k.tolist()])
        speed, acceleration = (
            np.broadcast_to(given, k.shape)
            if isinstance(given, (int, float))
            else np.array([given[j][i] for j in k.tolist()], dtype=np.float64)
            for given in (rate_rad_s, acceleration_rad_s2)
        )
        size, u = np.abs(angle), np.sign(angle)[:, None] * np.eye(3)[axis]
        parts = _rodrigues_matrices(u)
        first, _ = _moments(size)
        elapsed, products = _moments_in_time(size, speed, acceleration)
        # ∫ exp(βu×) dβ from 0 to |θ|; for v ⟂ u it is sin θ v + (1 − cos θ) u×v, the bracket of [P] eq. 3.
        swept = C[k] @ np.einsum("in,inab->nab", first, parts)
        rate[k] += swept[:, :, :, None] * u[:, None, None, :]
        abs_rate[k] += swept * np.abs(u)[:, None, :]
        seconds = C[k] @ np.einsum("in,inab->nab", elapsed, parts)
        time[k] += seconds
        further[k] += seconds @ further_effects(u * speed[:, None])  # of a constant rate
        rotated = C[k] @ parts
        noise[k] += np.einsum("ijn,inab,jncb->nacb", products, rotated, rotated, optimize=True)  # ∫ A_ab A_cb dt
        weight_s[k] += elapsed[0]
        total_angle[k] += size[:, None] * u
        C[k] = C[k] @ rotation_matrix(u * size[:, None])
    if window_s > 0.0:
        time += window_s * (np.eye(3) + F_meas * (C - np.eye(3)))  # [P] eq. 21
        noise += (window_s / 3.0) * (np.einsum("ab,cb->acb", np.eye(3), np.eye(3)) + np.einsum("kab,kcb->kacb", C, C))
    return RotationIntegrals(C, rate, abs_rate, time, weight_s, total_angle, further, noise)


def _rodrigues_matrices(u: Array) -> Array:
    """Matrices of ``exp(βu×) = uuᵀ + cos β (I − uuᵀ) + sin β u×`` (Rodrigues), shape (3, n, 3, 3)."""
    along = u[:, :, None] * u[:, None, :]
    return np.stack([along, np.eye(3) - along, cross_matrix(u)])


def _moments(angle: Array) -> tuple[Array, Array]:
    """Integrals from 0 to θ of (1, cos β, sin β), shape (3, n), and of their products, shape (3, 3, n).

    Products of 1 with another are left at zero: for a rotation about an axis of B they multiply zero columns.
    """
    s, c = np.sin(angle), np.cos(angle)
    half, cross, none = 0.5 * s * c, 0.5 * s**2, np.zeros_like(angle)
    first = np.stack([angle, s, 1.0 - c])
    products = np.stack([[angle, none, none], [none, 0.5 * angle + half, cross], [none, cross, 0.5 * angle - half]])
    return first, products


def _moments_in_time(angle: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
    """Integrals over time of (1, cos β, sin β) and of their products, as :func:`_moments`, from rest to rest, s.

    The rate is a trapezoid, or a triangle where the angle is too small to reach it. Over a ramp, where β grows with t²,
    the integrals are Fresnel's: Gaussian quadrature gives them.
    """
    peak = np.minimum(rate, np.sqrt(angle * acceleration))
    ramp, ramp_s = 0.5 * peak**2 / acceleration, peak / acceleration
    first, products = (after - before for after, before in zip(_moments(angle - ramp), _moments(ramp), strict=True))
    first, products = first / peak, products / peak
    for begin, sign in ((0.0, 1.0), (angle, -1.0)):
        beta = begin + sign * ramp * _NODES[:, None] ** 2
        trig = np.stack([np.ones_like(beta), np.cos(beta), np.sin(beta)])
        share = 0.5 * _WEIGHTS[:, None] * ramp_s
        first += np.einsum("ipn,pn->in", trig, share)
        square = np.einsum("ipn,jpn,pn->ijn", trig, trig, share, optimize=True)
        square[0, 1:] = square[1:, 0] = 0.0
        products += square
    return first, products
