"""Exact inverse of the sensor model of one triad, for single samples and for blocks of samples.

A reading is ``y = M v + s ∘ |v| + b``. Within one octant of ``v`` it is linear, so that eight inverses
``(M + diag(s ∘ sign v))⁻¹`` are computed once. Each sample is solved with the inverse of the octant that contains its
solution. For increments ``b dt`` replaces ``b``, because ``|v| dt = |v dt|``.

Arrays, single samples and the generated C header (:mod:`srt.exporters.c_header`) do the same operations in the same
order: their results agree to the last bit where the compiler does not contract products and sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.model.sensor_model import SIGNS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.model.sensor_model import Triad
    from srt.types import Array, Indices, Mask

    Vector = tuple[float, float, float]

STEPS: Final = 9
"""Largest number of octants tried, each that of the previous solution; one or two suffice away from borders."""

_BITS: Final = np.array([[0], [1], [2]], dtype=np.uint8)
"""Bit of each component in the number of an octant."""


@dataclass(frozen=True, slots=True)
class TriadInverse:
    """Inverse of the sensor model of one triad, in plain numbers."""

    bias: Vector  # b, rad/s or m/s²
    linear: tuple[float, ...]  # M⁻¹ by rows
    # ``(M + diag(s ∘ sign))⁻¹`` by rows; bit c of the index is set where component c is negative. None without
    # asymmetry: ``linear`` then holds for all octants
    octants: tuple[tuple[float, ...], ...] | None

    @classmethod
    def of(cls, triad: Triad, name: str) -> TriadInverse:
        """Invert a triad.

        Parameters
        ----------
        triad : Triad
        name : str
            Name of the sensor in messages.

        Raises InputError if the sensor model has no unique inverse.
        """
        slopes = triad.matrix + SIGNS[:, :, None] * np.diag(triad.asymmetry)
        # The determinant is linear in each sign, so that of M lies between those of the octants.
        determinants = np.linalg.det(slopes)
        if not (np.all(determinants > 0.0) or np.all(determinants < 0.0)):
            raise InputError(
                f"The {name} model of this calibration has no unique inverse: with such scale, misalignment and "
                "asymmetry, different motions give the same reading. Calibrate the unit again."
            )
        linear = _rows(np.linalg.inv(triad.matrix[None]))[0]
        octants = _rows(np.linalg.inv(slopes)) if triad.asymmetry.any() else None
        x, y, z = triad.bias.tolist()
        return cls((x, y, z), linear, octants)


class InverseArrays:
    """Inverses of a triad as arrays, ordered by matrix columns for the products.

    Attributes
    ----------
    linear : ndarray, shape (3, 3, 1)
    uniform : ndarray, shape (8, 3, 3, 1)
        By octant.
    gathered : ndarray, shape (3, 3, 8)
    """

    __slots__ = ("gathered", "linear", "uniform")

    def __init__(self, inverse: TriadInverse) -> None:
        self.linear = matrix_columns(inverse.linear)
        self.uniform = matrix_columns(inverse.octants or (inverse.linear,) * 8)
        self.gathered = np.ascontiguousarray(self.uniform[..., 0].transpose(1, 2, 0))


@dataclass(frozen=True, slots=True)
class WorkArrays:
    """Work arrays for m samples: x, v, t of shape (3, m), bits (3, m), the others (m,); all contiguous."""

    x: Array
    v: Array
    t: Array
    negative: Mask
    bits: NDArray[np.uint8]
    code: NDArray[np.uint8]
    found: NDArray[np.uint8]
    wrong: Mask
    octant: Indices


class WorkBlock:
    """Work arrays of one block, with all three components in one array so that one numpy call processes them."""

    __slots__ = ("_bits", "_codes", "_octant", "_values", "_whole")

    def __init__(self, block: int) -> None:
        self._values = np.empty((3, 3 * block))
        self._bits = np.empty(3 * block, dtype=np.uint8)
        self._codes = np.empty((3, block), dtype=np.uint8)
        self._octant = np.empty(block, dtype=np.intp)
        self._whole = self._lend(block)

    def part(self, m: int) -> WorkArrays:
        """Work arrays for m samples."""
        return self._whole if m == len(self._octant) else self._lend(m)

    def _lend(self, m: int) -> WorkArrays:
        x, v, t = (values[: 3 * m].reshape(3, m) for values in self._values)
        bits = self._bits[: 3 * m].reshape(3, m)
        code, found, wrong = (codes[:m] for codes in self._codes)
        return WorkArrays(
            x=x,
            v=v,
            t=t,
            negative=bits.view(np.bool_),
            bits=bits,
            code=code,
            found=found,
            wrong=wrong.view(np.bool_),
            octant=self._octant[:m],
        )


def solve_block(work: WorkArrays, tables: InverseArrays, octants: tuple[tuple[float, ...], ...]) -> None:
    """Solve a block: each sample with the inverse of the octant that contains its solution."""
    x, v, t, code = work.x, work.v, work.t, work.code
    _octant_numbers(v, work.negative, work.bits, code)
    if code.min() == code.max():  # slow motion: the whole block lies in one octant
        multiply(tables.uniform[int(code[0])], x, v, t)
    else:
        np.copyto(work.octant, code)
        # Without clipping, take would first write to a copy.
        tables.gathered[0].take(work.octant, axis=1, out=v, mode="clip")
        np.multiply(v, x[0], out=v)
        for j in (1, 2):
            tables.gathered[j].take(work.octant, axis=1, out=t, mode="clip")
            np.multiply(t, x[j], out=t)
            np.add(v, t, out=v)
    _octant_numbers(v, work.negative, work.bits, work.found)
    if np.not_equal(code, work.found, out=work.wrong).any():
        _solve_remaining(work, tables, octants)


def _solve_remaining(work: WorkArrays, tables: InverseArrays, octants: tuple[tuple[float, ...], ...]) -> None:
    """Repeat the solution for samples whose first octant does not contain it."""
    wrong = np.flatnonzero(work.wrong)
    code = work.found[wrong]
    for _ in range(STEPS - 1):
        m = tables.gathered[:, :, code]
        X = work.x[:, wrong]
        v = m[0] * X[0]
        v += m[1] * X[1]
        v += m[2] * X[2]
        work.v[:, wrong] = v
        found = np.empty_like(code)
        negative = np.empty(v.shape, dtype=np.bool_)
        _octant_numbers(v, negative, negative.view(np.uint8), found)
        left = found != code
        wrong, code = wrong[left], found[left]
        if wrong.size == 0:
            return
    for k in wrong.tolist():
        x, y, z = work.x[:, k].tolist()
        work.v[:, k] = _least_inconsistent(x, y, z, octants)


def _octant_numbers(v: Array, negative: Mask, bits: NDArray[np.uint8], code: NDArray[np.uint8]) -> None:
    """Octant numbers of vectors, shape (3, m); zero counts as positive. ``bits`` is a view of ``negative``."""
    np.less(v, 0.0, out=negative)
    np.left_shift(bits, _BITS, out=bits)
    np.bitwise_or.reduce(bits, axis=0, out=code)


def matrix_columns(matrices: tuple[float, ...] | tuple[tuple[float, ...], ...]) -> Array:
    """Columns of matrices given by rows, shape (..., 3, 3, 1): column, row, to broadcast against samples."""
    rows = np.array(matrices)
    return np.ascontiguousarray(np.swapaxes(rows.reshape(*rows.shape[:-1], 3, 3), -1, -2))[..., None]


def multiply(columns: Array, x: Array, v: Array, t: Array) -> None:
    """Product of a matrix, given by columns, and vectors of shape (3, m), written to ``v``; ``t`` is a work array."""
    np.multiply(columns[0], x[0], out=v)
    np.multiply(columns[1], x[1], out=t)
    np.add(v, t, out=v)
    np.multiply(columns[2], x[2], out=t)
    np.add(v, t, out=v)


def product(matrix: tuple[float, ...], x: float, y: float, z: float) -> Vector:
    """Product of a matrix, given by rows, and a vector."""
    a, b, c, d, e, f, g, h, i = matrix
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def solve_sample(
    x: float, y: float, z: float, linear: tuple[float, ...], octants: tuple[tuple[float, ...], ...] | None
) -> Vector:
    """Inverse of the sensor model for one reading less its bias."""
    # Written out: calls and tuples would take longer than the arithmetic.
    a, b, c, d, e, f, g, h, i = linear
    p, q, r = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
    if octants is None:
        return p, q, r
    octant = (1 if p < 0.0 else 0) + (2 if q < 0.0 else 0) + (4 if r < 0.0 else 0)
    for _ in range(STEPS):
        a, b, c, d, e, f, g, h, i = octants[octant]
        p, q, r = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
        found = (1 if p < 0.0 else 0) + (2 if q < 0.0 else 0) + (4 if r < 0.0 else 0)
        if found == octant:
            return p, q, r
        octant = found
    return _least_inconsistent(x, y, z, octants)


def _least_inconsistent(x: float, y: float, z: float, octants: tuple[tuple[float, ...], ...]) -> Vector:
    """Solution by exhaustive search: of all octants, the one whose signs differ least from those of its solution.

    On a border, rounding can make the search alternate between octants whose solutions agree within rounding; no
    proof excludes other cycles. One octant contains the solution, so the least difference is rounding.
    """
    best, least = (0.0, 0.0, 0.0), float("inf")
    for octant, matrix in enumerate(octants):
        v = product(matrix, x, y, z)
        contradiction = 0.0
        for bit, component in enumerate(v):
            contradiction = max(contradiction, component if octant >> bit & 1 else -component)
        if contradiction < least:
            best, least = v, contradiction
    return best


def _rows(matrices: NDArray[np.floating]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrices.reshape(-1, 9).tolist())
