"""Steps of the analytic platform for each sample: compensation, coning correction, attitude at mid-interval.

The equations are explained in :mod:`srt.model.analytic_platform`. There are two forms of one algorithm: array
operations of numpy, and loops that numba compiles (:mod:`srt.model.compiled_platform`, extra ``fast``). Their results
are equal to rounding. The compiled form runs where numba is installed and where its start takes less time than it
saves: for long recordings, and for the many recordings of a campaign or a fleet.
"""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model import rotations
from srt.model.rotations import BESIDE, KINK, TINY
from srt.model.sensor_model import OCTANT_ITERATIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from srt.model.gyro_stream import GyroStream
    from srt.model.sensor_model import Triad
    from srt.types import Array, Indices

COMPILED_SAMPLES: Final = 400_000
"""Samples to integrate from which the compiled steps pay: the start of numba and of the stored code takes 0.25 s, and
each of four or five iterations saves 0.14 µs for each sample."""

COMPILED_RECORDINGS: Final = 100
"""Recordings of a fleet or a campaign from which they pay, with some thousand samples each."""

_NOISE_SIGMAS: Final = 3.0
"""A channel within this many sigma of zero has its sign from the smoothed rate."""

_many: ContextVar[bool] = ContextVar("many", default=False)


@contextmanager
def many_recordings(count: int) -> Iterator[None]:
    """Integrate as suits one of ``count`` recordings that are processed alike: the same steps for each of them."""
    token = _many.set(count >= COMPILED_RECORDINGS)
    try:
        yield
    finally:
        _many.reset(token)


def steps_of(stream: GyroStream, gyro: Triad, offset: Array, sample_noise_rad: Array | None) -> Steps:
    """Steps in the form that takes less time, with the parameters of :class:`Steps`."""
    pays = (len(stream.interval_s) >= COMPILED_SAMPLES or _many.get()) and not gyro.further
    kind = CompiledSteps if pays and _compiled_block() is not None else Steps
    return kind(stream, gyro, offset, sample_noise_rad)


@cache
def _compiled_block() -> Callable[..., tuple[Array, Array, Array, rotations.Quaternions]] | None:
    """Function of :mod:`srt.model.compiled_platform`; None without numba, and with one that is too old for numpy."""
    try:
        from srt.model.compiled_platform import block
    except ImportError:
        return None
    return block


class Steps:
    """Compensation and attitude of a stream's samples, block by block.

    Parameters
    ----------
    stream : GyroStream
    gyro : Triad
        If of several units, the stream has the sequences of one after those of another, as many of each.
    offset : ndarray, shape (K, 3), rad/s
        Residual bias of each sequence.
    sample_noise_rad : ndarray, shape (3,) or (units, 3), or None

    Attributes
    ----------
    sequence_of : ndarray of int, shape (n,)
        Sequence of each sample.
    chain : AttitudeChain
    """

    def __init__(self, stream: GyroStream, gyro: Triad, offset: Array, sample_noise_rad: Array | None) -> None:
        self._stream, self._gyro, self._offset, self._sample_noise_rad = stream, gyro, offset, sample_noise_rad
        self.sequence_of = np.repeat(np.arange(len(stream.starts) - 1), np.diff(stream.starts))
        self.chain = AttitudeChain(np.concatenate([stream.starts, stream.rotation[:, 1]]))
        units = gyro.bias.size // 3
        self._unit_of = None if units == 1 else self.sequence_of // (len(stream.rotation) // units)

    def block(self, a: int, b: int) -> tuple[Array, Array, Array]:
        """Compensated increments Δθ, (3, m), Ĉ D and Ĉ at mid-interval, (3, 3, m), of the samples a to b."""
        stream = self._stream
        # Some samples more on either side, for the course of the rate at the block's edges.
        lo, hi = max(a - BESIDE, 0), min(b + BESIDE, len(stream.interval_s))
        unit = None if self._unit_of is None else self._unit_of[lo:hi]
        theta, D = _compensate(stream, slice(lo, hi), self._gyro, self._sample_noise_rad, unit)
        if self._offset.any():
            theta -= self._offset.T[:, self.sequence_of[lo:hi]] * stream.interval_s[lo:hi]
        inner = slice(a - lo, a - lo + b - a)
        phi = theta + _coning(theta, self.sequence_of[lo:hi])
        theta, D = np.ascontiguousarray(theta[:, inner]), D if D.ndim == 2 else D[:, :, inner]
        C_mid = self.chain.extend(phi[:, inner], a)
        return theta, _times(C_mid, D), C_mid


class CompiledSteps(Steps):
    """The same, compiled by numba."""

    def __init__(self, stream: GyroStream, gyro: Triad, offset: Array, sample_noise_rad: Array | None) -> None:
        super().__init__(stream, gyro, offset, sample_noise_rad)
        noise = np.zeros(3) if sample_noise_rad is None else sample_noise_rad
        by_unit = np.concatenate([gyro.inverses, gyro.inverse[..., None, :, :]], axis=-3)
        # Copies, because numba compiles anew for another layout of an array, and for one that is read-only.
        self._corrections = (
            np.array(gyro.bias.reshape(-1, 3), order="C"),
            np.array(offset, order="C"),
            by_unit.reshape(-1, 3, 3),
            np.array(_near_zero(gyro, noise).reshape(-1, 3), order="C"),
        )

    def block(self, a: int, b: int) -> tuple[Array, Array, Array]:
        """As :meth:`Steps.block`; Ĉ is empty unless the stream has weights F."""
        stream, compiled = self._stream, _compiled_block()
        assert compiled is not None
        samples = (stream.increments, stream.smooth, stream.interval_s, self.sequence_of)
        theta, X, C_mid, chained = compiled(
            samples, (a, b), *self._corrections, self.chain.last, with_attitude=stream.F is not None
        )
        self.chain.append(chained, a)
        return theta, X, C_mid


class AttitudeChain:
    """Product of the rotations of all samples, block by block, relative to the start of the stream.

    Attributes
    ----------
    edges : ndarray of complex, shape (2, number of edges)
        Attitude before each of the samples that were given as edges.
    last : ndarray of complex, shape (2, 1)
        Attitude after the last sample so far.
    """

    def __init__(self, samples: Indices) -> None:
        self._samples = samples
        self.last = np.array([[1.0 + 0j], [0.0]])
        self._C_before = np.eye(3)
        self.edges = np.empty((2, len(samples)), dtype=np.complex128)
        self.edges[:, samples == 0] = self.last

    def append(self, chained: rotations.Quaternions, first: int) -> None:
        """Attitudes after the samples from ``first`` on, (2, m)."""
        self.last = chained[:, -1:].copy()
        ended = np.flatnonzero((self._samples > first) & (self._samples <= first + chained.shape[1]))
        self.edges[:, ended] = chained[:, self._samples[ended] - first - 1]

    def extend(self, phi: Array, first: int) -> Array:
        """Append the rotation vectors (3, m) of the samples from ``first`` on; return Ĉ at mid-interval, (3, 3, m)."""
        # Ĉ relative to inertial space: the solution of [P] eq. 2 without its term of the Earth's rotation, which
        # _ErrorSums.integrals takes into account.
        chained = rotations.multiply(self.last, rotations.prefix_product(rotations.from_rotation_vector(phi)))
        self.append(chained, first)
        C = rotations.to_matrix(chained)
        C_mid = np.empty_like(C)
        C_mid[:, :, 0] = self._C_before + C[:, :, 0]
        np.add(C[:, :, :-1], C[:, :, 1:], out=C_mid[:, :, 1:])
        C_mid *= 0.5
        self._C_before = C[:, :, -1].copy()
        return C_mid


def _coning(theta: Array, sequence_of: Indices) -> Array:
    """Coning correction of the increments, (3, m); the outermost samples of a sequence have none.

    The limiter is van Leer's monotonised central one: no change beyond twice either one-sided difference, and none
    where these disagree in sign.
    """
    slope = np.zeros_like(theta)
    if theta.shape[1] < 3:
        return slope
    step = np.diff(theta, axis=1)
    step[:, sequence_of[1:] != sequence_of[:-1]] = 0.0
    back, ahead = step[:, :-1], step[:, 1:]
    limit = 2.0 * np.minimum(np.abs(back), np.abs(ahead))
    limit[back * ahead <= 0.0] = 0.0
    np.clip(0.5 * (back + ahead), -limit, limit, out=slope[:, 1:-1])
    size = np.abs(step)
    pair = size[:, :-1] + size[:, 1:]
    before, after = pair[:, :-2], pair[:, 2:]
    # A kink is in two neighbouring differences alone, a course in all four.
    smooth = np.minimum(np.minimum(before, after), size[:, :-3] + size[:, 3:])
    smooth /= KINK * (before + after) + TINY
    np.minimum(smooth, 1.0, out=smooth)
    smooth *= sequence_of[2 * BESIDE :] == sequence_of[: -2 * BESIDE]
    twice = step[:, 1:-2] + step[:, 2:-1]
    inner = slope[:, BESIDE:-BESIDE]
    inner += smooth * (twice * (71.0 / 120.0) - (step[:, :-3] + step[:, 3:]) * (11.0 / 120.0) - inner)
    out = _cross(theta, slope) / 12.0
    out[:, BESIDE:-BESIDE] += _cross(smooth * twice, smooth * (step[:, 2:-1] - step[:, 1:-2])) / 1440.0
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
    out: Array = D[:, 0] * v[0]
    out += D[:, 1] * v[1]
    out += D[:, 2] * v[2]
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


def _of_samples(values: Array, unit: Indices | None) -> Array:
    """Vectors (units, 3) or matrices (units, 3, 3) of the units of samples, the samples last; of one unit, for all."""
    if unit is None:
        return values.reshape(3, 1) if values.size == 3 else values.reshape(3, 3)
    return np.take(np.ascontiguousarray(np.moveaxis(values, 0, -1)), unit, axis=-1)


def _near_zero(gyro: Triad, sample_noise_rad: Array) -> Array:
    """Increments below which the smoothed ones have the sign, shape (..., 3)."""
    variance = np.einsum("...ab,...b->...a", gyro.inverse**2, sample_noise_rad**2)
    return np.asarray(_NOISE_SIGMAS * np.sqrt(variance))


def _compensate(
    stream: GyroStream, block: slice, gyro: Triad, sample_noise_rad: Array | None, unit: Indices | None
) -> tuple[Array, Array]:
    """Compensated increments of a block, (3, m), and the matrices that made them, (3, 3) or (3, 3, m)."""
    if not gyro.further:
        return _linear_compensation(stream, block, gyro, sample_noise_rad, unit)
    dt = stream.interval_s[block]
    by_sample, shape = (gyro, (-1, 3)) if unit is None else (gyro.of(unit), (-1, 1, 3))

    def rate(other: Array | float) -> Array:
        offset = np.broadcast_to(other, (dt.size, *shape[1:])).reshape(-1, 3).T * dt
        theta, _ = _linear_compensation(stream, block, gyro, sample_noise_rad, unit, offset)
        return (theta / dt).T.reshape(shape)

    found = by_sample.contract(rate)
    D = np.ascontiguousarray(np.moveaxis(by_sample.sensitivity(found).reshape(-1, 3, 3), 0, -1))
    return np.ascontiguousarray(found.reshape(-1, 3).T * dt), D


def _linear_compensation(
    stream: GyroStream,
    block: slice,
    gyro: Triad,
    sample_noise_rad: Array | None,
    unit: Indices | None,
    offset: Array | None = None,
) -> tuple[Array, Array]:
    """Compensation without further errors, whose effect ``offset``, rad, the increments have besides the bias."""
    dt = stream.interval_s[block]
    bias, mean_inverse = _of_samples(gyro.bias, unit) * dt, _of_samples(gyro.inverse, unit)
    if offset is not None:
        bias = bias + offset
    y = stream.increments[:, block] - bias
    reference = _apply(mean_inverse, y)
    if not gyro.asymmetry.any():
        return reference, mean_inverse
    table = np.ascontiguousarray(np.moveaxis(gyro.inverses.reshape(-1, 3, 3), 0, 2))
    first = 0 if unit is None else 8 * unit
    smooth = sigma = None
    if sample_noise_rad is not None:
        sigma = np.broadcast_to(_of_samples(_near_zero(gyro, sample_noise_rad), unit), y.shape)
        smooth = stream.smooth[:, block] - bias
        np.copyto(reference, _apply(mean_inverse, smooth), where=np.abs(reference) < sigma)
    octant = _octant(reference) + first
    D = np.take(table, octant, axis=2)  # contiguous, unlike fancy indexing
    theta = _apply(D, y)
    # The first octant ignores the asymmetry: the solution may lie in another octant, and that one lead to a third.
    new = _octant(_sign_reference(theta, D, smooth, sigma)) + first
    at = np.flatnonzero(new != octant)
    new = new[at]
    for _ in range(OCTANT_ITERATIONS):
        if at.size == 0:
            break
        octant[at] = new
        part = table[:, :, new]
        D[:, :, at] = part
        theta[:, at] = solved = _apply(part, y[:, at])
        reference = _sign_reference(
            solved, part, None if smooth is None else smooth[:, at], None if sigma is None else sigma[:, at]
        )
        new = _octant(reference) + (0 if unit is None else 8 * unit[at])
        at, new = at[new != octant[at]], new[new != octant[at]]
    return theta, D


def _sign_reference(theta: Array, D: Array, smooth: Array | None, sigma: Array | None) -> Array:
    """Values whose signs give the octant: the compensated increments; within 3 sigma of zero, the smoothed ones."""
    if smooth is None or sigma is None:
        return theta
    near_zero = np.abs(theta) < sigma
    return np.where(near_zero, _apply(D, smooth), theta) if near_zero.any() else theta


def _octant(v: Array) -> Indices:
    """Octant numbers of vectors of shape (3, n)."""
    negative = v < 0.0
    out: Indices = negative[0] + 2 * negative[1].astype(np.intp) + 4 * negative[2]
    return out
