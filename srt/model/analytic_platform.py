"""Analytic platform ([P] eq. 2): attitude from gyro samples, and the integrals that the measurement model needs.

The platform solves ``dĈ/dt = Ĉ (ω̂×) − (ω̂e×) Ĉ`` with Ĉ = I at the start ([P]: Savage 2020). As ω̂e is
constant in B_Strt, the solution is ``Ĉ(t) = exp(−ω̂e× t) Ĉ_I(t)`` with Ĉ_I the attitude relative to inertial space. The
Earth's rotation is exact. The inertial attitude is a product of rotation vectors, one per sampling interval, each with
its coning correction:

    ``φ_i = Δθ_i + Δθ_i × s_i / 12 + d1_i × d2_i / 720``,    ``s_i = d1_i − 11/60 d3_i``,

with d1, d2 and d3 the central differences of Δθ over five intervals. The correction is exact to the sixth power of the
interval for a rate that is a polynomial of fourth order over them, and for a constant rate of any magnitude. It matters
for a hand that shakes, and for the Earth's rate seen in a rotating body: without it, a rotation at 50 Hz has an error
of 1.5e-8 rad. Where the rate has a kink, as between two rotations about different axes, a difference across the kink
would be false coning: there, s is the central difference over three intervals with a limiter, and d1 × d2 is left out.

All sequences of a recording are integrated as one stream in cache-sized blocks. Afterwards the attitudes are referred
to the start of each sequence. The steps up to the attitude are in :mod:`srt.model.platform_steps`, the sums here.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model import rotations
from srt.model.platform_steps import steps_of
from srt.model.rotation_integrals import FURTHER_GYRO, RotationIntegrals, further_effects

if TYPE_CHECKING:
    from srt.model.gyro_stream import GyroStream
    from srt.model.sensor_model import Triad
    from srt.types import Array, Indices, Mask

BLOCK: Final = 16384
"""Samples per block: the 3x3 matrices of a block fit into a processor's cache."""

_FURTHER: Final = sum(len(group.suffixes) for group in FURTHER_GYRO)
"""Number of further errors of the gyros."""
_PARTS: Final = (2, 12)
"""Fewest and most parts of one rotation."""

_TOTAL_PARTS: Final = 600
"""Parts of all rotations of a recording together; bounds the memory of their integrals."""


def integrate_attitude(
    stream: GyroStream,
    gyro: Triad,
    earth_rate: Array,
    *,
    bias_offset: Array | None = None,
    sample_noise_rad: Array | None = None,
    with_noise: bool = False,
) -> tuple[RotationIntegrals, Array]:
    """Solve [P] eq. 2 for every sequence: attitude and error integrals.

    Parameters
    ----------
    stream : GyroStream
    gyro : Triad
        Sensor errors to compensate with. If of several units, the stream has the sequences of one after those of
        another, as many of each, and the arrays have a leading axis of units, the integrals too.
    earth_rate : ndarray, shape (K, 3), rad/s
        ω̂e in each sequence's B_Strt.
    bias_offset : ndarray, shape (K, 3), rad/s, optional
        Residual bias of each sequence, subtracted from the compensated rate.
    sample_noise_rad : ndarray, shape (3,), optional
        Standard deviation of a raw sample's angle (random walk and quantization). Within 3 sigma of zero, the
        asymmetry term takes the sign of the smoothed rate, so that noise is not rectified.
    with_noise : bool
        Compute the noise integral and the parts of the time integral too.

    Returns
    -------
    integrals : RotationIntegrals
    attitude : ndarray, shape (3, 3, n)
        Ĉ at mid-interval (mean of both ends) of the samples of integrated windows; not valid elsewhere, and empty
        unless the stream has weights F.
    """
    K, n = len(stream.starts) - 1, int(stream.starts[-1])
    shape, earth_rate = earth_rate.shape[:-1], earth_rate.reshape(-1, 3)
    offset = np.zeros((K, 3)) if bias_offset is None else bias_offset.reshape(-1, 3)
    steps = steps_of(stream, gyro, offset, sample_noise_rad)
    chain = steps.chain
    sums = _ErrorSums(stream, gyro.bias.size // 3, with_noise=with_noise)
    attitude = np.empty((3, 3, n if stream.F is not None else 0))
    for a in range(0, n, BLOCK):
        b = min(a + BLOCK, n)
        theta, X, C_mid = steps.block(a, b)
        if stream.F is not None:
            attitude[:, :, a:b] = C_mid
        sums.add(theta, X, a)
    to_start = np.swapaxes(_matrices(chain.edges[:, :K]), 1, 2)
    if stream.F is not None:
        attitude = _at_start(stream, attitude, to_start, earth_rate)
    return sums.integrals(chain.edges, to_start, earth_rate, gyro).reshaped(shape), attitude


class _ErrorSums:
    """Sums over the samples of each sequence that become the :class:`RotationIntegrals`, in the stream's frame."""

    def __init__(self, stream: GyroStream, units: int, *, with_noise: bool) -> None:
        K = len(stream.starts) - 1
        self._stream = stream
        self._columns = (7 if stream.velocity is None else 10) + 3 * _FURTHER
        self._sums = np.zeros((K, 9, self._columns + (9 if with_noise else 0)))
        self._parts = _PartSums(stream, K // units) if with_noise else None
        self._angle = np.zeros((K, 3))
        self._turning: Mask | None = None
        if stream.F is not None:  # samples of integrated windows lie between the rotations
            begun, ended = (np.bincount(at, minlength=int(stream.starts[-1]) + 1) for at in stream.rotation.T)
            self._turning = np.cumsum(begun - ended)[:-1] > 0

    def add(self, theta: Array, X: Array, a: int) -> None:
        """Add a block of m samples from number ``a`` on: Δθ (3, m) and Ĉ D (3, 3, m)."""
        stream, m = self._stream, theta.shape[1]
        b = a + m
        flat = X.reshape(9, m)
        V = np.empty((self._sums.shape[-1], m))
        # Weights of Ĉ D in its sums: Δθ, |Δθ|, Δt and, where given, f Δt.
        V[:3] = theta
        np.abs(theta, out=V[3:6])
        V[6] = stream.interval_s[a:b]  # gyro bias, [P] eq. 21 with the weight F
        if _FURTHER:
            effects = np.moveaxis(further_effects((theta / V[6]).T), 0, -1)
            V[self._columns - 3 * _FURTHER : self._columns] = effects.reshape(3 * _FURTHER, m) * V[6]
        if stream.velocity is not None:
            V[7:10] = stream.velocity[:, a:b]
        F = None if stream.F is None else stream.F[a:b]
        if F is not None:
            V[: self._columns] *= F
        if self._parts is not None:
            # All products of two elements of Ĉ D in one multiplication; those of the same column are needed.
            weighted = np.multiply(flat, V[6], out=V[self._columns :])
            self._parts.add(weighted, a)
            if F is not None:
                weighted *= F
        first, last = np.searchsorted(stream.starts, (a, b), side="right").tolist()
        within = np.clip(stream.starts[first - 1 : last + 1] - a, 0, m)
        turned = theta if self._turning is None else np.where(self._turning[a:b], theta, 0.0)
        rows = np.flatnonzero(within[1:] > within[:-1])
        self._angle[rows + first - 1] += np.add.reduceat(turned, within[rows], axis=1).T
        for k, (s, e) in enumerate(pairwise(within.tolist()), first - 1):
            if e > s:
                self._sums[k] += flat[:, s:e] @ V[:, s:e].T

    def integrals(
        self, edges: rotations.Quaternions, to_start: Array, earth_rate: Array, gyro: Triad
    ) -> RotationIntegrals:
        """Transform the sums to each sequence's B_Strt, and remove the Earth's rotation from the inertial attitudes.

        Parameters
        ----------
        edges : ndarray of complex, shape (2, 2 K + 1)
            Edges of the :class:`~srt.model.platform_steps.AttitudeChain`: start of each sequence, end of the stream,
            end of each rotation.
        to_start : ndarray, shape (K, 3, 3)
            From the stream's frame to B_Strt.
        earth_rate : ndarray, shape (K, 3), rad/s
        gyro : Triad
        """
        stream = self._stream
        time_s = np.concatenate([[0.0], np.cumsum(stream.interval_s)])
        elapsed = np.diff(time_s[stream.starts])
        # The Earth's rotation ([P] eq. 2) is removed exactly from the attitudes, and from the integrals by its mean: it
        # is less than 1e-3 rad in a sequence, and a tenth of that remains.
        K, columns = len(to_start), self._columns
        found = self._sums.reshape(K, 3, 3, -1)

        def since_start(attitude: rotations.Quaternions, seconds: Array) -> Array:
            earth = rotations.rotation_matrix(-earth_rate * seconds[:, None])
            return np.asarray(earth @ to_start @ _matrices(attitude))

        C_end = C_turned = since_start(edges[:, 1 : K + 1], elapsed)
        if stream.F is not None:
            C_turned = since_start(edges[:, K + 1 :], time_s[stream.rotation[:, 1]] - time_s[stream.starts[:-1]])
        middle = rotations.rotation_matrix(-0.5 * earth_rate * elapsed[:, None]) @ to_start
        sums = (middle @ found[..., :columns].reshape(K, 3, -1)).reshape(K, 3, 3, columns)
        noise = parts = None
        if self._parts is not None:
            of_columns = np.einsum("kdbeb->kbde", found[..., columns:].reshape(K, 3, 3, 3, 3))
            turned = middle[:, None] @ of_columns @ np.swapaxes(middle, 1, 2)[:, None]
            noise = np.moveaxis(turned, 1, 3)
            parts = middle[:, None] @ self._parts.sums.reshape(3, 3, K, -1).transpose(2, 3, 0, 1)
        time = sums[..., 6]
        effects = sums[..., columns - 3 * _FURTHER :].reshape(K, 3, 3, 3, _FURTHER)
        return RotationIntegrals(
            C_end=C_end,
            rate=sums[..., :3],
            abs_rate=np.einsum("kabb->kab", sums[..., 3:6]),
            time=time,
            weight_s=elapsed if stream.F is None else _totals(stream.interval_s * stream.F, stream.starts),
            # The Earth's part of the angle, in B. Integrated windows add little to it and are not excluded.
            angle=self._angle.reshape(K, 3) - np.einsum("ka,kab->kb", earth_rate, _by_unit(time, gyro.matrix)),
            noise=noise,
            time_parts=parts,
            further=np.einsum("kabbn->kan", effects),
            velocity=None if stream.velocity is None else sums[..., 7:10],
            C_turned=C_turned,
        )


class _PartSums:
    """Sums of a 3x3 quantity over the parts of all rotations of the stream, shape (9, K P).

    A rotation is divided as its recording of so many ``rotations`` asks for.
    """

    def __init__(self, stream: GyroStream, rotations: int) -> None:
        inner = equal_parts(stream.rotation, parts_per_rotation(rotations))[:, 1:-1]
        begins = np.concatenate([stream.starts[:-1, None], inner], axis=1).ravel()
        self._edges = np.append(begins, stream.starts[-1])
        self.sums = np.zeros((9, len(begins)))

    def add(self, values: Array, first: int) -> None:
        """Add samples, (9, m), from number ``first`` on."""
        edges = np.clip(self._edges - first, 0, values.shape[-1])
        some = np.flatnonzero(edges[1:] > edges[:-1])  # a part of a very short rotation may hold no sample
        if some.size:
            self.sums[:, some] += np.add.reduceat(values[:, : edges[-1]], edges[some], axis=-1)


def _by_unit(matrices: Array, right: Array) -> Array:
    """Products of matrices (K, 3, 3) and those of their units, (3, 3) or (units, 3, 3), from the right."""
    units = right.size // 9
    product = matrices.reshape(units, -1, 3, 3) @ right.reshape(units, 1, 3, 3)
    return np.asarray(product.reshape(matrices.shape))


def _matrices(q: rotations.Quaternions) -> Array:
    return np.ascontiguousarray(np.moveaxis(rotations.to_matrix(np.ascontiguousarray(q)), 2, 0))


def _at_start(stream: GyroStream, C: Array, to_start: Array, earth_rate: Array) -> Array:
    """Transform the attitudes in integrated windows to their B_Strt, less the Earth's rotation at each sample."""
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


def _totals(values: Array, starts: Indices) -> Array:
    """Sums over the samples of each sequence, shape (K,)."""
    out: Array = np.diff(np.concatenate([[0.0], np.cumsum(values)])[starts])
    return out


def parts_per_rotation(rotations: int) -> int:
    """Number of equal parts of every rotation: bias drift within a rotation acts through the attitude at its time.

    Twelve parts are four for each 180° rotation of a sequence of three. With two for each, the reported sigmas are
    10 % too small.
    """
    return int(np.clip(_TOTAL_PARTS // max(rotations, 1), *_PARTS))


def equal_parts(spans: Indices, parts: int) -> Indices:
    """Limits of equal parts of sample spans (K, 2), shape (K, parts + 1)."""
    out: Indices = spans[:, :1] + (spans[:, 1:] - spans[:, :1]) * np.arange(parts + 1) // parts
    return out
