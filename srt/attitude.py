"""The analytic platform: attitude from gyro samples, and the error integrals gathered on the way.

``dĈ/dt = Ĉ (ω̃×) − (ω̂e×) Ĉ`` with Ĉ = I at the start (Savage 2020, eq. 2). As ω̂e is constant in B_Strt, the solution is
``Ĉ(t) = exp(−ω̂e× t) Ĉ_I(t)`` with Ĉ_I the attitude against inertial space: the Earth's rotation is exact, and the
inertial attitude is a chain of rotation vectors, each the integral of its interval with the coning term

    ``φ_i = Δθ_i + Δθ_i × (Δθ_{i+1} − Δθ_{i−1}) / 24``,

exact for a rate that changes linearly over three intervals (next error: fifth power of the interval) and for a
constant rate of any size. The Earth's rate seen in a turning body is a case for it: without the term a turn at 50 Hz
is 1.5e-8 rad off.

All sequences of a recording are integrated as one stream in cache-sized blocks; the chain is re-referenced to the
start of each sequence afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from srt import quaternion
from srt.rotation_integrals import RotationIntegrals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.compensation import Triad

    Array = NDArray[np.float64]

BLOCK: Final = 16384
_SMOOTHING_S: Final = 0.2
_OCTANT_WEIGHTS: Final = np.array([1.0, 2.0, 4.0])


@dataclass(frozen=True, slots=True, eq=False)
class GyroStream:
    """Raw gyro samples of K sequences, one after another.

    Attributes
    ----------
    increments : ndarray, shape (3, n)
        Raw readings times their interval, rad.
    slope : ndarray, shape (3, n)
        (next − previous increment) / 24, one-sided where a neighbour is missing.
    smooth : ndarray, shape (3, n)
        Increments averaged over 0.2 s, which decide the sign of a channel that is near zero.
    interval_s : ndarray, shape (n,)
    starts : ndarray of int, shape (K + 1,)
        Sequence k is the samples starts[k] to starts[k + 1].
    rotation : ndarray of int, shape (K, 2)
        Where the rotation begins and ends within the stream (windows with integrated attitude lie outside it).
    F : ndarray, shape (n,), or None
        Weight of an attitude error, see :mod:`srt.rotation_integrals`; None means 1 everywhere.
    """

    increments: Array
    slope: Array
    smooth: Array
    interval_s: Array
    starts: NDArray[np.intp]
    rotation: NDArray[np.intp]
    F: Array | None = None

    @property
    def elapsed_s(self) -> Array:
        """Time from the start of each sample's sequence to the sample's end, shape (n,)."""
        total = np.cumsum(self.interval_s)
        before = np.concatenate([[0.0], total])[self.starts[:-1]]
        out: Array = total - np.repeat(before, np.diff(self.starts))
        return out


def gyro_stream(
    gyro: Array,
    interval_s: float | Array,
    spans: NDArray[np.intp],
    rotation: NDArray[np.intp],
    *,
    rates: bool,
    gaps: NDArray[np.intp] | None = None,
    F: Array | None = None,
) -> GyroStream:
    """Gather the samples that attitude is integrated over.

    Parameters
    ----------
    gyro : ndarray, shape (n, 3)
        Raw readings of the whole recording, rad/s (``rates``) or rad.
    interval_s : float or ndarray, shape (n,)
    spans : ndarray of int, shape (K, 2)
        First sample and one past the last, per sequence.
    rotation : ndarray of int, shape (K, 2)
        The rotation's samples in the recording's numbering.
    rates : bool
        Whether the readings are rates.
    gaps : ndarray of int, optional
        Samples that begin a new contiguous piece; no coning term reaches across them.
    F : ndarray, shape (sum of the spans' lengths,), optional
    """
    lengths = spans[:, 1] - spans[:, 0]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    n, last = int(starts[-1]), len(gyro) - 1
    increments, slope, dt = np.empty((3, n)), np.empty((3, n)), np.empty(n)
    no_before = set() if gaps is None else set(gaps.tolist())
    for (a, b), s in zip(spans.tolist(), starts.tolist(), strict=False):
        lo, hi = max(a - 1, 0), min(b + 1, last + 1)
        step = np.full(hi - lo, interval_s) if isinstance(interval_s, float) else np.asarray(interval_s)[lo:hi]
        y = gyro[lo:hi].T * step if rates else np.ascontiguousarray(gyro[lo:hi].T)
        # The neighbour before or after the span: missing at the recording's ends and at gaps.
        left = y[:, :1] if lo == a or a in no_before else None
        right = y[:, -1:] if hi == b or b in no_before else None
        body = y[:, a - lo : b - lo]
        end = s + b - a
        increments[:, s:end], dt[s:end] = body, step[a - lo : b - lo]
        before = body[:, :1] if left is not None else y[:, a - lo - 1 : a - lo]
        after = body[:, -1:] if right is not None else y[:, b - lo : b - lo + 1]
        padded = np.concatenate([before, body, after], axis=1)
        np.subtract(padded[:, 2:], padded[:, :-2], out=slope[:, s:end])
        # A one-sided difference spans one interval, a central one two.
        if left is not None:
            slope[:, s] *= 2.0
        if right is not None:
            slope[:, end - 1] *= 2.0
    slope /= 24.0
    width = max(1, round(_SMOOTHING_S / float(np.median(dt)))) if n else 1
    smooth = uniform_filter1d(increments, width, axis=1, mode="nearest") if width > 1 and n else increments
    offset = starts[:-1] - spans[:, 0]
    return GyroStream(increments, slope, smooth, dt, starts, rotation + offset[:, None], F)


def integrate(
    stream: GyroStream,
    gyro: Triad,
    earth_rate: Array,
    *,
    bias_offset: Array | None = None,
    noise_rad_sqrt_s: Array | None = None,
    with_noise: bool = False,
) -> tuple[RotationIntegrals, Array]:
    """Integrate the attitude of every sequence and gather its error integrals.

    Parameters
    ----------
    stream : GyroStream
    gyro : Triad
        Errors to compensate with.
    earth_rate : ndarray, shape (K, 3), rad/s
        ω̂e in each sequence's B_Strt.
    bias_offset : ndarray, shape (K, 3), rad/s, optional
        Left-over bias of each sequence, taken off the compensated rate.
    noise_rad_sqrt_s : ndarray, shape (3,), optional
        Angle random walk of the raw channels: below three sigma of a sample the sign in the asymmetry term
        is that of the smoothed rate, so that noise is not rectified.
    with_noise : bool
        Gather the noise integral too.

    Returns
    -------
    integrals : RotationIntegrals
    attitude : ndarray, shape (3, 3, n)
        Ĉ at mid-interval (mean of both ends) of every sample; used where windows are integrated.
        Empty unless the stream has weights F.
    """
    K = len(stream.starts) - 1
    n = int(stream.starts[-1])
    elapsed = stream.elapsed_s
    inverses = gyro.inverses if gyro.asymmetry.any() else np.linalg.inv(gyro.matrix)[None]
    sums, noise = np.zeros((K, 9, 7)), np.zeros((K, 3, 3, 3)) if with_noise else None
    turned, C_end = np.zeros((K, 3)), np.empty((K, 3, 3))
    kept = np.empty((3, 3, n)) if stream.F is not None else np.empty((3, 3, 0))
    sequence_of = np.repeat(np.arange(K), np.diff(stream.starts))
    chain = np.array([[1.0 + 0j], [0.0]])  # attitude at the end of the block before, against the chain's origin
    origin = np.empty((2, K), dtype=np.complex128)  # and at each sequence's start
    C_before = np.eye(3)  # Ĉ at the end of the sample before the block
    for a in range(0, n, BLOCK):
        b = min(a + BLOCK, n)
        theta, D = _compensate(stream, slice(a, b), gyro, inverses, noise_rad_sqrt_s)
        k_of = sequence_of[a:b]
        dt = stream.interval_s[a:b]
        if bias_offset is not None:
            theta -= bias_offset.T[:, k_of] * dt
        phi = theta + _coning(theta, stream.slope[:, a:b], D)
        chained = quaternion.multiply(chain, quaternion.prefix_product(quaternion.from_rotation_vector(phi)))
        first, last = int(k_of[0]), int(k_of[-1])
        begins = stream.starts[first : last + 1]
        for k in range(first, last + 1):
            s = int(stream.starts[k])
            if s >= a:
                origin[:, k] = chain[:, 0] if s == a else chained[:, s - a - 1]
        chain = chained[:, -1:]
        # Re-reference to the sequence's start and turn the Earth back.
        earth = quaternion.from_rotation_vector(-earth_rate.T[:, k_of] * elapsed[a:b])
        left = quaternion.multiply(earth, quaternion.conjugate(origin)[:, k_of])
        C = quaternion.to_matrix(quaternion.multiply(left, chained))
        C_mid = np.empty_like(C)
        C_mid[:, :, 1:] = C[:, :, :-1]
        C_mid[:, :, 0] = C_before
        C_mid[:, :, begins[begins >= a] - a] = np.eye(3)[:, :, None]
        C_before = C[:, :, -1].copy()
        C_mid += C
        C_mid *= 0.5
        X = _times(C_mid, D)
        V = np.empty((7, b - a))
        V[:3] = theta
        np.abs(theta, out=V[3:6])
        V[6] = dt
        F = None if stream.F is None else stream.F[a:b]
        if F is not None:
            kept[:, :, a:b] = C_mid
            V *= F
        for k in range(first, last + 1):
            s, e = max(int(stream.starts[k]) - a, 0), min(int(stream.starts[k + 1]) - a, b - a)
            sums[k] += X.reshape(9, -1)[:, s:e] @ V[:, s:e].T
            if noise is not None:
                weight = dt[s:e] if F is None else dt[s:e] * F[s:e] ** 2
                for c in range(3):
                    noise[k, :, :, c] += (X[:, c, s:e] * weight) @ X[:, c, s:e].T
            if stream.starts[k + 1] <= b:
                C_end[k] = C[:, :, e - 1]
            s, e = np.clip(stream.rotation[k] - a, 0, b - a)
            if e > s:
                turned[k] += theta[:, s:e].sum(axis=1) - _earth_seen(C_mid[:, :, s:e], dt[s:e], earth_rate[k])
    sums = sums.reshape(K, 3, 3, 7)
    return RotationIntegrals(
        C_end,
        sums[..., :3],
        np.einsum("kabb->kab", sums[..., 3:6]),
        sums[..., 6],
        _weight(stream),
        turned,
        noise,
    ), kept


def _weight(stream: GyroStream) -> Array:
    weighted = stream.interval_s if stream.F is None else stream.interval_s * stream.F
    total = np.concatenate([[0.0], np.cumsum(weighted)])
    out: Array = np.diff(total[stream.starts])
    return out


def _earth_seen(C: Array, dt: Array, earth_rate: Array) -> Array:
    """Integral of the Earth's rate in body axes, rad."""
    out: Array = np.einsum("a,ab->b", earth_rate, C @ dt)
    return out


def _coning(theta: Array, slope: Array, D: Array) -> Array:
    """Δθ × D·slope for arrays of shape (3, n)."""
    s = _apply(D, slope)
    out = np.empty_like(theta)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(theta[j], s[k], out=out[i])
        out[i] -= theta[k] * s[j]
    return out


def _apply(D: Array, v: Array) -> Array:
    """D v for one matrix (3, 3) or one per sample (3, 3, n)."""
    if D.ndim == 2:
        return D @ v
    out: Array = np.einsum("abn,bn->an", D, v)
    return out


def _times(C: Array, D: Array) -> Array:
    """C D for C of shape (3, 3, n), D of shape (3, 3) or (3, 3, n)."""
    if D.ndim == 2:
        out = np.empty_like(C)
        for a in range(3):
            np.matmul(D.T, C[a], out=out[a])
        return out
    product: Array = C[:, 0, None] * D[0]
    product += C[:, 1, None] * D[1]
    product += C[:, 2, None] * D[2]
    return product


def _compensate(
    stream: GyroStream, block: slice, gyro: Triad, inverses: Array, noise_rad_sqrt_s: Array | None
) -> tuple[Array, Array]:
    """Compensated increments of a block, (3, m), and the matrices that made them, (3, 3) or (3, 3, m)."""
    dt = stream.interval_s[block]
    y = stream.increments[:, block] - gyro.bias[:, None] * dt
    if len(inverses) == 1:
        return inverses[0] @ y, inverses[0]
    mean_inverse = np.linalg.inv(gyro.matrix)
    guess = mean_inverse @ y
    octant = _OCTANT_WEIGHTS @ (guess < 0.0)
    table = np.ascontiguousarray(np.moveaxis(inverses, 0, 2))
    octant = octant.astype(np.intp)
    D = table[:, :, octant]
    theta = _apply(D, y)
    # One look back: a sample whose solution lies in another octant than the guess.
    wrong = np.flatnonzero(_OCTANT_WEIGHTS @ (theta < 0.0) != octant)
    if wrong.size:
        octant[wrong] = _OCTANT_WEIGHTS @ (theta[:, wrong] < 0.0)
        D[:, :, wrong] = table[:, :, octant[wrong]]
        theta[:, wrong] = _apply(D[:, :, wrong], y[:, wrong])
    if noise_rad_sqrt_s is not None:
        sigma = np.sqrt(mean_inverse**2 @ noise_rad_sqrt_s**2)[:, None] * np.sqrt(dt)
        near_zero = np.abs(theta) < 3.0 * sigma
        doubtful = np.flatnonzero(near_zero.any(axis=0))
        if doubtful.size:
            smooth = mean_inverse @ (
                stream.smooth[:, block][:, doubtful] - gyro.bias[:, None] * dt[doubtful]
            )
            decided = np.where(near_zero[:, doubtful], smooth, theta[:, doubtful]) < 0.0
            octant = (_OCTANT_WEIGHTS @ decided).astype(np.intp)
            D[:, :, doubtful] = table[:, :, octant]
            theta[:, doubtful] = _apply(D[:, :, doubtful], y[:, doubtful])
    return theta, D
