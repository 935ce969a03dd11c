"""The analytic platform: attitude from gyro samples, and the error integrals gathered on the way.

``dĈ/dt = Ĉ (ω̃×) − (ω̂e×) Ĉ`` with Ĉ = I at the start (Savage 2020, eq. 2). As ω̂e is constant in B_Strt, the solution is
``Ĉ(t) = exp(−ω̂e× t) Ĉ_I(t)`` with Ĉ_I the attitude against inertial space: the Earth's rotation is exact, and the
inertial attitude is a chain of rotation vectors, each the integral of its interval with the coning term

    ``φ_i = Δθ_i + Δθ_i × s_i / 12``,    s_i the change of Δθ per interval,

exact for a rate that changes linearly over three intervals (next error: fifth power of the interval) and for a
constant rate of any size. The Earth's rate seen in a turning body is a case for it: without the term a turn at 50 Hz
is 1.5e-8 rad off. The change s is the central difference where the rate is smooth; where it kinks, as between two legs
about different axes, the difference across the kink would invent coning, and a limiter takes it out.

All sequences of a recording are integrated as one stream in cache-sized blocks; the chain is re-referenced to the
start of each sequence afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from srt.model import rotations
from srt.model.rotation_integrals import RotationIntegrals

if TYPE_CHECKING:
    from srt.model.sensor_model import Triad
    from srt.types import Array, Indices


BLOCK: Final = 16384
_SMOOTHING_S: Final = 0.2
_OCTANT_SEARCH: Final = 8


_PARTS: Final = (2, 12)
"""Fewest and most parts of one rotation."""

_PARTS_IN_ALL: Final = 600
"""Parts of all rotations of a recording together, which bounds the memory of their integrals."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroStream:
    """Raw gyro samples of K sequences, one after another.

    Attributes
    ----------
    increments : ndarray, shape (3, n)
        Raw readings times their interval, rad.
    smooth : ndarray, shape (3, n)
        Increments averaged over 0.2 s, which decide the sign of a channel that is near zero.
    interval_s : ndarray, shape (n,)
    starts : ndarray of int, shape (K + 1,)
        Sequence k is the samples starts[k] to starts[k + 1].
    rotation : ndarray of int, shape (K, 2)
        Where the rotation begins and ends within the stream (windows with integrated attitude lie outside it).
    F : ndarray, shape (n,), or None
        Weight of an attitude error, see :mod:`srt.model.rotation_integrals`; None means 1 everywhere.
    velocity : ndarray, shape (3, n), m/s, or None
        Compensated specific force times the interval, whose integral with the attitude is to be gathered.
    """

    increments: Array
    smooth: Array
    interval_s: Array
    starts: Indices
    rotation: Indices
    F: Array | None = None
    velocity: Array | None = None


def gyro_stream(
    gyro: Array,
    interval_s: float | Array,
    spans: Indices,
    rotation: Indices,
    *,
    rates: bool,
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
    F : ndarray, shape (sum of the spans' lengths,), optional
    """
    lengths = spans[:, 1] - spans[:, 0]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    n = int(starts[-1])
    increments, dt = np.empty((3, n)), np.empty(n)
    for (a, b), s in zip(spans.tolist(), starts.tolist(), strict=False):
        end = s + b - a
        dt[s:end] = interval_s if isinstance(interval_s, float) else interval_s[a:b]
        if rates:
            np.multiply(gyro[a:b].T, dt[s:end], out=increments[:, s:end])
        else:
            increments[:, s:end] = gyro[a:b].T
    width = max(1, round(_SMOOTHING_S / float(np.median(dt)))) if n else 1
    smooth = uniform_filter1d(increments, width, axis=1, mode="nearest") if width > 1 and n else increments
    offset = starts[:-1] - spans[:, 0]
    return GyroStream(increments, smooth, dt, starts, rotation + offset[:, None], F)


def integrate(
    stream: GyroStream,
    gyro: Triad,
    earth_rate: Array,
    *,
    bias_offset: Array | None = None,
    sample_noise_rad: Array | None = None,
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
    sample_noise_rad : ndarray, shape (3,), optional
        One sigma of a raw sample's angle, random walk and pulses: below three of them the sign in the asymmetry term
        is that of the smoothed rate, so that noise is not rectified.
    with_noise : bool
        Gather the noise integral and the parts of the time integral too.

    Returns
    -------
    integrals : RotationIntegrals
    attitude : ndarray, shape (3, 3, n)
        Ĉ at mid-interval (mean of both ends) of the samples of integrated windows; of use nowhere else, and
        empty unless the stream has weights F.
    """
    K, n = len(stream.starts) - 1, int(stream.starts[-1])
    inverses: Array = gyro.inverses if gyro.asymmetry.any() else np.asarray(np.linalg.inv(gyro.matrix))[None]
    columns = 7 if stream.velocity is None else 10
    sums, noise = np.zeros((K, 9, columns)), np.zeros((K, 3, 3, 3)) if with_noise else None
    parts = _Parts(stream) if with_noise else None
    turned = np.zeros((K, 3))
    kept = np.empty((3, 3, n)) if stream.F is not None else np.empty((3, 3, 0))
    sequence_of = np.repeat(np.arange(K), np.diff(stream.starts))
    chain = np.array([[1.0 + 0j], [0.0]])  # attitude at the end of the block before, against the chain's origin
    C_before = np.eye(3)
    edges = np.empty((2, K + 1), dtype=np.complex128)  # the chain at each sequence's start, and at its very end
    edges[:, 0] = chain[:, 0]
    for a in range(0, n, BLOCK):
        b = min(a + BLOCK, n)
        k_of, dt = sequence_of[a:b], stream.interval_s[a:b]
        # One sample more on either side, for the change of the rate at the block's edges.
        lo, hi = max(a - 1, 0), min(b + 1, n)
        theta, D = _compensate(stream, slice(lo, hi), gyro, inverses, sample_noise_rad)
        if bias_offset is not None and bias_offset.any():
            theta -= bias_offset.T[:, sequence_of[lo:hi]] * stream.interval_s[lo:hi]
        change = _change(theta, sequence_of[lo:hi])
        inner = slice(a - lo, a - lo + b - a)
        theta, D = np.ascontiguousarray(theta[:, inner]), D if D.ndim == 2 else D[:, :, inner]
        phi = theta + _cross(theta, change[:, inner]) / 12.0
        chained = rotations.multiply(chain, rotations.prefix_product(rotations.from_rotation_vector(phi)))
        chain = chained[:, -1:]
        ended = np.flatnonzero((stream.starts > a) & (stream.starts <= b))
        edges[:, ended] = chained[:, stream.starts[ended] - a - 1]
        C = rotations.to_matrix(chained)
        C_mid = np.empty_like(C)
        C_mid[:, :, 0] = C_before + C[:, :, 0]
        np.add(C[:, :, :-1], C[:, :, 1:], out=C_mid[:, :, 1:])
        C_mid *= 0.5
        C_before = C[:, :, -1].copy()
        X = _times(C_mid, D)
        flat = X.reshape(9, -1)
        V = _integrands(theta, dt, None if stream.velocity is None else stream.velocity[:, a:b])
        F = None if stream.F is None else stream.F[a:b]
        if F is not None:
            kept[:, :, a:b] = C_mid
            V *= F
        if parts is not None:
            parts.add(flat * V[6], a)
        for k in range(int(k_of[0]), int(k_of[-1]) + 1):
            s, e = max(int(stream.starts[k]) - a, 0), min(int(stream.starts[k + 1]) - a, b - a)
            sums[k] += flat[:, s:e] @ V[:, s:e].T
            if noise is not None:
                noise[k] += _outer(X[:, :, s:e], dt[s:e] if F is None else dt[s:e] * F[s:e] ** 2)
            s, e = max(int(stream.rotation[k, 0]) - a, 0), min(int(stream.rotation[k, 1]) - a, b - a)
            if e > s:
                turned[k] += theta[:, s:e].sum(axis=1)
    # From the chain's origin to each B_Strt, the Earth turned back: exactly for the attitudes, and for the integrals by
    # the mean of its turn (less than 1e-3 rad in a sequence, of which the mean leaves a part in ten).
    to_start = np.swapaxes(_matrices(edges[:, :-1]), 1, 2)
    elapsed = np.diff(np.concatenate([[0.0], np.cumsum(stream.interval_s)])[stream.starts])
    C_end = rotations.rotation_matrix(-earth_rate * elapsed[:, None]) @ to_start @ _matrices(edges[:, 1:])
    middle = rotations.rotation_matrix(-0.5 * earth_rate * elapsed[:, None]) @ to_start
    sums = np.einsum("kad,kdbm->kabm", middle, sums.reshape(K, 3, 3, columns))
    if noise is not None:
        noise = np.einsum("kad,kdeb,kce->kacb", middle, noise, middle)
    if stream.F is not None:
        kept = _at_start(stream, kept, to_start, earth_rate)
    time = sums[..., 6]
    # The Earth's part of what was turned, in B; windows count for little here and are left in.
    turned -= np.einsum("ka,kab->kb", earth_rate, time @ gyro.matrix)
    return RotationIntegrals(
        C_end,
        sums[..., :3],
        np.einsum("kabb->kab", sums[..., 3:6]),
        time,
        _weight(stream),
        turned,
        noise,
        None if parts is None else middle[:, None] @ parts.sums.reshape(3, 3, K, -1).transpose(2, 3, 0, 1),
        None if stream.velocity is None else sums[..., 7:],
    ), kept


class _Parts:
    """Sums of a 3x3 quantity over the parts of all rotations, shape (9, K P)."""

    def __init__(self, stream: GyroStream) -> None:
        inner = equal_parts(stream.rotation, parts_per_rotation(len(stream.rotation)))[:, 1:-1]
        begins = np.concatenate([stream.starts[:-1, None], inner], axis=1).ravel()
        self._edges = np.append(begins, stream.starts[-1])
        self.sums = np.zeros((9, len(begins)))

    def add(self, values: Array, first: int) -> None:
        """Add samples, (9, m), from number ``first`` on."""
        # By running sums: a part of a very short rotation may hold no sample.
        running = np.zeros((9, values.shape[1] + 1))
        np.cumsum(values, axis=1, out=running[:, 1:])
        self.sums += np.diff(running[:, np.clip(self._edges - first, 0, values.shape[1])], axis=1)


def _outer(X: Array, weight: Array) -> Array:
    """Weighted sums over samples of the outer product of every column of X (3, 3, n), as [a, c, column]."""
    return np.stack([(X[:, c] * weight) @ X[:, c].T for c in range(3)], axis=2)


def _integrands(theta: Array, dt: Array, velocity: Array | None) -> Array:
    """What Ĉ D is summed with: Δθ, |Δθ|, time and, where it is there, f times it; shape (7 or 10, m)."""
    V = np.empty((7 if velocity is None else 10, len(dt)))
    V[:3] = theta
    np.abs(theta, out=V[3:6])
    V[6] = dt
    if velocity is not None:
        V[7:] = velocity
    return V


def _matrices(q: rotations.Quaternions) -> Array:
    return np.ascontiguousarray(np.moveaxis(rotations.to_matrix(np.ascontiguousarray(q)), 2, 0))


def _at_start(stream: GyroStream, C: Array, to_start: Array, earth_rate: Array) -> Array:
    """Attitudes in the integrated windows from the chain's frame to their B_Strt, the Earth turned back by samples."""
    ends = np.cumsum(stream.interval_s)
    middle = ends - 0.5 * stream.interval_s
    for k, (s, e) in enumerate(zip(stream.starts[:-1].tolist(), stream.starts[1:].tolist(), strict=True)):
        origin = ends[s - 1] if s > 0 else 0.0
        for lo, hi in ((s, int(stream.rotation[k, 0])), (int(stream.rotation[k, 1]), e)):
            if hi > lo:
                earth = -earth_rate[k][:, None] * (middle[lo:hi] - origin)
                E = rotations.to_matrix(rotations.from_rotation_vector(earth))
                C[:, :, lo:hi] = np.einsum("abn,bcn->acn", E, np.tensordot(to_start[k], C[:, :, lo:hi], 1))
    return C


def _weight(stream: GyroStream) -> Array:
    weighted = stream.interval_s if stream.F is None else stream.interval_s * stream.F
    total = np.concatenate([[0.0], np.cumsum(weighted)])
    out: Array = np.diff(total[stream.starts])
    return out


def _change(theta: Array, sequence_of: Indices) -> Array:
    """Change of the increment per interval, (3, m): central, limited where the rate kinks, zero at sequence edges.

    The limiter is van Leer's monotonised central one: no change beyond twice either one-sided difference, and none
    where these disagree in sign.
    """
    out = np.zeros_like(theta)
    if theta.shape[1] < 3:
        return out
    step = np.diff(theta, axis=1)
    step[:, sequence_of[1:] != sequence_of[:-1]] = 0.0
    back, ahead = step[:, :-1], step[:, 1:]
    limit = 2.0 * np.minimum(np.abs(back), np.abs(ahead))
    limit[back * ahead <= 0.0] = 0.0
    np.clip(0.5 * (back + ahead), -limit, limit, out=out[:, 1:-1])
    return out


def _cross(u: Array, v: Array) -> Array:
    """Cross product of arrays of shape (3, n)."""
    out = np.empty_like(u)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(u[j], v[k], out=out[i])
        out[i] -= u[k] * v[j]
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
    stream: GyroStream, block: slice, gyro: Triad, inverses: Array, sample_noise_rad: Array | None
) -> tuple[Array, Array]:
    """Compensated increments of a block, (3, m), and the matrices that made them, (3, 3) or (3, 3, m)."""
    dt = stream.interval_s[block]
    y = stream.increments[:, block] - gyro.bias[:, None] * dt
    if len(inverses) == 1:
        return inverses[0] @ y, inverses[0]
    mean_inverse = np.linalg.inv(gyro.matrix)
    table = np.ascontiguousarray(np.moveaxis(inverses, 0, 2))
    smooth = sigma = None
    judged = mean_inverse @ y
    if sample_noise_rad is not None:
        sigma = np.broadcast_to(3.0 * np.sqrt(mean_inverse**2 @ sample_noise_rad**2)[:, None], y.shape)
        smooth = stream.smooth[:, block] - gyro.bias[:, None] * dt
        np.copyto(judged, mean_inverse @ smooth, where=np.abs(judged) < sigma)
    octant = _octant(judged)
    D = np.take(table, octant, axis=2)  # contiguous, unlike fancy indexing
    theta = _apply(D, y)
    # The first judgement left the asymmetry out: the solution may lie in another octant, and that one lead to a third.
    new = _octant(_judge(theta, D, smooth, sigma))
    at = np.flatnonzero(new != octant)
    new = new[at]
    for _ in range(_OCTANT_SEARCH):
        if at.size == 0:
            break
        octant[at] = new
        part = table[:, :, new]
        D[:, :, at] = part
        theta[:, at] = solved = _apply(part, y[:, at])
        judged = _judge(
            solved, part, None if smooth is None else smooth[:, at], None if sigma is None else sigma[:, at]
        )
        new = _octant(judged)
        at, new = at[new != octant[at]], new[new != octant[at]]
    return theta, D


def _judge(theta: Array, D: Array, smooth: Array | None, sigma: Array | None) -> Array:
    """Values whose signs decide the octant: the compensated increments, the smoothed ones where noise may rule."""
    if smooth is None or sigma is None:
        return theta
    near_zero = np.abs(theta) < sigma
    return np.where(near_zero, _apply(D, smooth), theta) if near_zero.any() else theta


def _octant(v: Array) -> Indices:
    """Octant numbers of vectors of shape (3, n)."""
    negative = v < 0.0
    out: Indices = negative[0] + 2 * negative[1].astype(np.intp) + 4 * negative[2]
    return out


def parts_per_rotation(rotations: int) -> int:
    """Number of parts that every rotation is cut into: drift within it acts by the attitude of the moment.

    Four for each half turn of a sequence of three; with two of them its sigmas come out a tenth too small.
    """
    return int(np.clip(_PARTS_IN_ALL // max(rotations, 1), *_PARTS))


def equal_parts(spans: Indices, parts: int) -> Indices:
    """Ends of equal parts of sample spans (K, 2), shape (K, parts + 1)."""
    out: Indices = spans[:, :1] + (spans[:, 1:] - spans[:, :1]) * np.arange(parts + 1) // parts
    return out
