"""The samples of the analytic platform, compiled by numba (extra ``fast``).

The algorithm is that of :mod:`srt.model.analytic_platform`, which explains it: compensation, coning correction, product
of the rotations, and attitude at mid-interval. Here it runs sample by sample instead of array by array; the results are
equal to rounding (tests/model/test_compiled_platform.py). This module imports numba, and the analytic platform imports
it only for recordings long enough to save more time than the import takes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from srt.model.rotations import BESIDE, KINK, SMALL_ANGLE_SQUARED, TINY
from srt.model.sensor_model import OCTANT_ITERATIONS

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.model.rotations import Quaternions
    from srt.types import Array, Indices


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on the first call and store the code; with no folder that can be written, compile in every process."""
    # Contraction to fused products and unsigned zeros change results by rounding alone.
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}
    compiled: Callable[..., Any]
    try:
        compiled = njit(**options, cache=True)(function)
    except RuntimeError:
        compiled = njit(**options)(function)
    return compiled


def block(
    samples: tuple[Array, Array, Array, Indices],
    span: tuple[int, int],
    bias: Array,
    offset: Array,
    inverses: Array,
    near_zero: Array,
    last: Array,
    *,
    with_attitude: bool,
) -> tuple[Array, Array, Array, Quaternions]:
    """Attitudes and compensated increments of a block of m samples.

    Parameters
    ----------
    samples : tuple of ndarray
        Increments (3, n) and smoothed increments (3, n), rad; intervals (n,), s; sequence of each sample (n,).
    span : (int, int)
        First sample of the block and one past its last.
    bias : ndarray, shape (units, 3), rad/s
        The sequences of one unit follow those of another, as many of each.
    offset : ndarray, shape (K, 3), rad/s
        Residual bias of each sequence after compensation.
    inverses : ndarray, shape (9 units, 3, 3)
        Inverse sensor model in each octant; the last of nine is the one without asymmetry.
    near_zero : ndarray, shape (units, 3), rad
        Channels below this value have their sign from the smoothed increments.
    last : ndarray of complex, shape (2, 1)
        Attitude before the block.
    with_attitude : bool
        Return C_mid.

    Returns
    -------
    theta : ndarray, shape (3, m), rad
    X : ndarray, shape (3, 3, m)
        Ĉ D at mid-interval, with D the inverse in the sample's octant.
    C_mid : ndarray, shape (3, 3, m)
        Ĉ at mid-interval; shape (3, 3, 0) if not asked for.
    chained : ndarray of complex, shape (2, m)
        Attitude after each sample.
    """
    theta, octants = _compensate(samples, span, bias, offset, inverses, near_zero)
    chained = _chain(theta, samples[3], span, last)
    C_mid = np.empty((3, 3, chained.shape[1] if with_attitude else 0))
    X = _at_mid_interval(chained, last, inverses, octants, C_mid)
    first = span[0] - max(span[0] - BESIDE, 0)
    return np.ascontiguousarray(theta[:, first : first + chained.shape[1]]), X, C_mid, chained


@_compiled
def _row(inverses: Any, octant: Any, row: int, x: float, y: float, z: float) -> Any:
    # One index for all octants: a view of one matrix would be counted as a reference for each sample.
    return inverses[octant, row, 0] * x + inverses[octant, row, 1] * y + inverses[octant, row, 2] * z


@_compiled
def _solve(inverses: Any, first: Any, near_zero: Any, reading: Any, smooth: Any) -> Any:
    """Compensated increment of a sample, and the number of its inverse; the first one tried has no asymmetry."""
    octant = new = first + np.uint64(8)
    x, y, z = 0.0, 0.0, 0.0
    (a, b, c), (d, e, f) = reading, smooth
    for _ in range(OCTANT_ITERATIONS + 2):
        octant = new
        x, y = _row(inverses, octant, 0, a, b, c), _row(inverses, octant, 1, a, b, c)
        z = _row(inverses, octant, 2, a, b, c)
        sx, sy, sz = x, y, z
        if abs(x) < near_zero[0]:
            sx = _row(inverses, octant, 0, d, e, f)
        if abs(y) < near_zero[1]:
            sy = _row(inverses, octant, 1, d, e, f)
        if abs(z) < near_zero[2]:
            sz = _row(inverses, octant, 2, d, e, f)
        new = np.uint64(sx < 0.0) | (np.uint64(sy < 0.0) << np.uint64(1)) | (np.uint64(sz < 0.0) << np.uint64(2))
        new += first
        if new == octant:
            break
    return x, y, z, octant


@_compiled
def _compensate(samples: Any, span: Any, bias: Any, offset: Any, inverses: Any, near_zero: Any) -> Any:
    """Compensated increments of a block and of the samples beside it, (3, ·), and octants of the block."""
    increments, smooth, interval_s, sequence_of = samples
    lo, hi = max(span[0] - BESIDE, 0), min(span[1] + BESIDE, len(interval_s))
    theta, octants = np.empty((3, hi - lo)), np.empty(span[1] - span[0], dtype=np.uint64)
    each = len(offset) // len(bias)
    for i in range(lo, hi):
        dt, k = interval_s[i], sequence_of[i]
        unit = k // each
        b0, b1, b2 = bias[unit, 0], bias[unit, 1], bias[unit, 2]
        limits = (near_zero[unit, 0], near_zero[unit, 1], near_zero[unit, 2])
        reading = (increments[0, i] - b0 * dt, increments[1, i] - b1 * dt, increments[2, i] - b2 * dt)
        mean = (smooth[0, i] - b0 * dt, smooth[1, i] - b1 * dt, smooth[2, i] - b2 * dt)
        x, y, z, octant = _solve(inverses, np.uint64(9 * unit), limits, reading, mean)
        theta[0, i - lo] = x - offset[k, 0] * dt
        theta[1, i - lo] = y - offset[k, 1] * dt
        theta[2, i - lo] = z - offset[k, 2] * dt
        if span[0] <= i < span[1]:
            octants[i - span[0]] = octant
    return theta, octants


@_compiled
def _limited(before: float, now: float, after: float) -> float:
    """Change of the increment per interval: central difference with van Leer's limiter."""
    back, ahead = now - before, after - now
    if back * ahead <= 0.0:
        return 0.0
    limit = 2.0 * min(abs(back), abs(ahead))
    return max(-limit, min(limit, 0.5 * (back + ahead)))


@_compiled
def _course(values: Any, j: int) -> Any:
    """Slope, and first and second difference where there is no kink, of one component of the increments."""
    s0, s1 = values[j - 1] - values[j - 2], values[j] - values[j - 1]
    s2, s3 = values[j + 1] - values[j], values[j + 2] - values[j + 1]
    slope = _limited(values[j - 1], values[j], values[j + 1])
    before, after = abs(s0) + abs(s1), abs(s2) + abs(s3)
    smooth = min(min(before, after, abs(s0) + abs(s3)) / (KINK * (before + after) + TINY), 1.0)
    slope += smooth * ((s1 + s2) * (71.0 / 120.0) - (s0 + s3) * (11.0 / 120.0) - slope)
    return slope, 0.5 * smooth * (s1 + s2), smooth * (s2 - s1)


@_compiled
def _half_angle(squared: float) -> Any:
    """cos(θ/2) and sin(θ/2)/θ of θ², as in :func:`srt.model.rotations.from_rotation_vector`."""
    if squared < SMALL_ANGLE_SQUARED:
        s = squared * 0.25
        cosine = 1.0 - s * (1 / 2 - s * (1 / 24 - s * (1 / 720 - s / 40320)))
        return cosine, 0.5 - s * (1 / 12 - s * (1 / 240 - s * (1 / 10080 - s / 725760)))
    angle = np.sqrt(squared)
    return np.cos(0.5 * angle), np.sin(0.5 * angle) / angle


@_compiled
def _chain(theta: Any, sequence_of: Any, span: Any, last: Any) -> Any:
    """Attitudes after the samples of a block, (2, m)."""
    start, n = span[0] - max(span[0] - BESIDE, 0), theta.shape[1]
    out = np.empty((2, span[1] - span[0]), dtype=np.complex128)
    a, b = last[0, 0], last[1, 0]
    for i in range(out.shape[1]):
        j, k = i + start, span[0] + i
        x, y, z = theta[0, j], theta[1, j], theta[2, j]
        if BESIDE <= j < n - BESIDE and sequence_of[k - BESIDE] == sequence_of[k + BESIDE]:
            u, a1, a2 = _course(theta[0], j)
            v, b1, b2 = _course(theta[1], j)
            w, c1, c2 = _course(theta[2], j)
            phi = (x + (y * w - z * v) / 12.0 + (b1 * c2 - c1 * b2) / 720.0,
                   y + (z * u - x * w) / 12.0 + (c1 * a2 - a1 * c2) / 720.0,
                   z + (x * v - y * u) / 12.0 + (a1 * b2 - b1 * a2) / 720.0)  # fmt: skip
            x, y, z = phi
        elif 0 < j < n - 1 and sequence_of[k - 1] == sequence_of[k + 1]:
            u = _limited(theta[0, j - 1], x, theta[0, j + 1]) / 12.0
            v = _limited(theta[1, j - 1], y, theta[1, j + 1]) / 12.0
            w = _limited(theta[2, j - 1], z, theta[2, j + 1]) / 12.0
            x, y, z = x + y * w - z * v, y + z * u - x * w, z + x * v - y * u
        cosine, sine = _half_angle(x * x + y * y + z * z)
        c, d = complex(cosine, -sine * z), complex(-sine * y, -sine * x)
        a, b = a * c - b * d.conjugate(), a * d + b * c.conjugate()
        out[0, i], out[1, i] = a, b
    return out


@_compiled
def _to_matrix(a: complex, b: complex) -> Any:
    """Rows of the matrix of a quaternion, normalised."""
    w, z, y, x = a.real, -a.imag, -b.real, -b.imag
    two = 2.0 / (w * w + x * x + y * y + z * z)
    xs, ys, zs = x * two, y * two, z * two
    wx, wy, wz = w * xs, w * ys, w * zs
    xx, yy, zz = x * xs, y * ys, z * zs
    xy, xz, yz = x * ys, x * zs, y * zs
    return (1.0 - (yy + zz), xy - wz, xz + wy, xy + wz, 1.0 - (xx + zz), yz - wx, xz - wy, yz + wx, 1.0 - (xx + yy))


@_compiled
def _at_mid_interval(chained: Any, last: Any, inverses: Any, octants: Any, C_mid: Any) -> Any:
    """Ĉ D with Ĉ at mid-interval, the mean of both ends; Ĉ itself to ``C_mid`` if that has room."""
    X = np.empty((3, 3, chained.shape[1]))
    before = _to_matrix(last[0, 0], last[1, 0])
    for i in range(chained.shape[1]):
        after, octant = _to_matrix(chained[0, i], chained[1, i]), octants[i]
        for row in range(3):
            x = 0.5 * (before[3 * row] + after[3 * row])
            y = 0.5 * (before[3 * row + 1] + after[3 * row + 1])
            z = 0.5 * (before[3 * row + 2] + after[3 * row + 2])
            if C_mid.shape[2]:
                C_mid[row, 0, i], C_mid[row, 1, i], C_mid[row, 2, i] = x, y, z
            for k in range(3):
                X[row, k, i] = x * inverses[octant, 0, k] + y * inverses[octant, 1, k] + z * inverses[octant, 2, k]
        before = after
    return X
