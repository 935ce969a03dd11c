"""A calibration compiled for use in a loop: readings in, corrected values out, exact and without allocation.

A reading is ``y = M v + s ∘ |v| + b``. Within one octant of ``v`` it is linear, so that eight inverses computed once,
``(M + diag(s ∘ sign v))⁻¹``, hold all there is to know; what is left per sample is to find the octant that the solution
itself lies in. For increments the same holds with ``b dt`` in place of ``b``, as ``|v| dt = |v dt|``.

Arrays, single samples and the generated C header (:mod:`srt.exporters.c_header`) do the same operations in the same
order: their results agree to the last bit where the compiler does not contract products and sums.

Rectified noise. Asymmetry s multiplies |v|, and the mean of |v + noise| is not |mean|: in a channel at rest a mean of
about ``-0.8 s σ`` is left, with σ the one-sigma noise of a sample and 0.8 for √(2/π) (1 % of asymmetry and 1.7e-3
rad/s of noise: 2.8 °/h). It falls off as a channel moves away from zero and is gone at three sigma. No correction
sample by sample can avoid it; where the unit stands still, average the readings first and correct the mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, Protocol

import numpy as np

from srt.exceptions import InputError
from srt.model.measurement_model import force_error_jacobian, rate_error_jacobian
from srt.model.prior import CalibratedErrors
from srt.model.sensor_model import SIGNS, Triad, accel_triad, gyro_triad
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

    from numpy.typing import ArrayLike, NDArray

    from srt.types import Array, Indices, Mask

    Vector = tuple[float, float, float]
    Sample = Sequence[float] | Array

BLOCK: Final = 8192
"""Samples corrected at a time: enough to forget the calls of numpy, and work arrays (0.7 MB) that a cache holds."""

STEPS: Final = 9
"""Octants tried in turn, each that of the solution before; one or two are enough but on a border."""

_BITS: Final = np.array([[0], [1], [2]], dtype=np.uint8)

_COVARIANCE_BLOCK: Final = 1024

_ORTHOGONAL_WITHIN: Final = 1e-6


class ErrorsInFrames(CalibratedErrors, Protocol):
    """Sensor errors in MARS with the rotation from the table frame; :class:`srt.Calibration` is one."""

    @property
    def U(self) -> Array | None:
        """T to MARS components, shape (3, 3); None without a fixture."""


@dataclass(frozen=True, slots=True)
class TriadInverse:
    """The inverse of one triad's reading model in plain numbers.

    Attributes
    ----------
    bias : (float, float, float)
        b, rad/s or m/s².
    linear : tuple of 9 floats
        M⁻¹ by rows.
    octants : tuple of 8 tuples of 9 floats, or None
        ``(M + diag(s ∘ sign))⁻¹`` by rows; bit c of the index is set where component c is negative. None without
        asymmetry: ``linear`` is all.
    """

    bias: Vector
    linear: tuple[float, ...]
    octants: tuple[tuple[float, ...], ...] | None

    @classmethod
    def of(cls, triad: Triad, name: str) -> TriadInverse:
        """Invert a triad.

        Parameters
        ----------
        triad : Triad
        name : str
            What messages call it.

        Raises
        ------
        InputError
            If some reading has no true value, or several.
        """
        slopes = triad.matrix + SIGNS[:, :, None] * np.diag(triad.asymmetry)
        # The determinant is linear in each sign, so that of M lies between those of the octants.
        determinants = np.linalg.det(slopes)
        if not (np.all(determinants > 0.0) or np.all(determinants < 0.0)):
            raise InputError(
                f"The {name} errors of this calibration cannot be undone: with such scale, misalignment and asymmetry "
                "different motions give the same reading; calibrate the unit again."
            )
        linear = _rows(np.linalg.inv(triad.matrix[None]))[0]
        octants = _rows(np.linalg.inv(slopes)) if triad.asymmetry.any() else None
        x, y, z = triad.bias.tolist()
        return cls((x, y, z), linear, octants)


class Applier:
    """Correct readings in a loop.

    Results are in MARS or table axes, in the units of the readings. The work arrays belong to the object: give every
    thread its own.

    Parameters
    ----------
    calibration : Calibration
        Of any status; whether it is good enough is for the caller to say.
    frame : "mars" or "table"
        Axes of the result.
    block : int
        Samples corrected at a time, which decides the size of the work arrays (86 bytes per sample).

    Attributes
    ----------
    gyro, accel : TriadInverse
    rotation : tuple of 9 floats, or None
        Uᵀ by rows, MARS to table-mounted components; None for MARS axes.

    Raises
    ------
    InputError
        An unknown frame, no table frame in the calibration, or errors that cannot be undone.

    Notes
    -----
    The noise of a channel near zero is rectified by its asymmetry: see the head of this module.
    """

    __slots__ = ("_block", "_covariance", "_tables", "_triads", "_work", "accel", "gyro", "rotation")

    def __init__(
        self, calibration: ErrorsInFrames, *, frame: Literal["mars", "table"] = "mars", block: int = BLOCK
    ) -> None:
        if frame == "table" and calibration.U is None:
            raise InputError("This calibration was made without a fixture and knows no table frame; use frame='mars'.")
        if frame not in ("mars", "table"):
            raise InputError(f"frame is {frame!r}; it must be 'mars' or 'table'.")
        if block < 1:
            raise InputError(f"block is {block}, but at least one sample at a time is corrected.")
        self._triads = gyro_triad(calibration.errors), accel_triad(calibration.errors)
        self.gyro = TriadInverse.of(self._triads[0], "gyro")
        self.accel = TriadInverse.of(self._triads[1], "accelerometer")
        self.rotation = _rotation(calibration.U) if frame == "table" else None
        self._covariance = calibration.covariance
        self._tables = _Tables(self.gyro), _Tables(self.accel)
        self._block = block
        self._work = _Work(block)

    def apply(
        self,
        gyro: ArrayLike,
        accel: ArrayLike,
        *,
        dt: float | ArrayLike | None = None,
        out: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """Correct samples; with ``out`` and readings that are arrays already, nothing of their length is allocated.

        Parameters
        ----------
        gyro, accel : array_like, shape (n, 3) or (3,)
            Readings: rad/s and m/s², or with ``dt`` increments in rad and m/s.
        dt : float or array_like, shape (n,), s, optional
            Duration of increments; None for rates.
        out : (ndarray, ndarray), optional
            float64 arrays to write to, of the shapes of the readings; they may be strided, and they may be the readings
            themselves, but must not overlap them in another way.

        Returns
        -------
        gyro, accel : ndarray
            ``out`` where given.

        Raises
        ------
        InputError
            Shapes that do not fit, values that are not finite numbers, durations that are not positive, or arrays
            that cannot be written to. Nothing is written then.
        """
        shapes = _shape("gyro", gyro), _shape("accel", accel)
        if shapes[0] != shapes[1]:
            raise InputError(f"The gyro readings have the shape {shapes[0]}, the accelerometers {shapes[1]}.")
        step = _durations(dt, shapes[0])
        readings = _readings("gyro", gyro), _readings("accel", accel)
        if out is None:
            out = np.empty(shapes[0]), np.empty(shapes[0])
        else:
            _check_out(out, readings)
        rotation = None if self.rotation is None else _columns(self.rotation)
        for values, inverse, tables, target in zip(readings, (self.gyro, self.accel), self._tables, out, strict=True):
            self._correct(np.atleast_2d(values), step, inverse, tables, np.atleast_2d(target), rotation)
        return out

    def apply_sample(
        self,
        gyro: Sample,
        accel: Sample,
        *,
        dt: float | None = None,
        out: tuple[MutableSequence[float] | Array, MutableSequence[float] | Array] | None = None,
    ) -> tuple[Vector, Vector]:
        """Correct one sample with plain floats, the fastest that Python does; the same bits as :meth:`apply`.

        Parameters
        ----------
        gyro, accel : sequence of 3 floats, or ndarray, shape (3,)
            Readings: rad/s and m/s², or with ``dt`` increments in rad and m/s. Tuples and lists are faster than arrays.
        dt : float, s, optional
            Duration of an increment; None for rates.
        out : pair of lists or ndarrays of length 3, optional
            Also written to.

        Returns
        -------
        gyro, accel : tuple of 3 floats

        Raises
        ------
        InputError
            Not three finite numbers each, or a duration that is not positive.
        """
        try:
            # Items of an array are slow to take one by one.
            gx, gy, gz = gyro.tolist() if isinstance(gyro, np.ndarray) else gyro
            ax, ay, az = accel.tolist() if isinstance(accel, np.ndarray) else accel
            # Infinite or NaN if any reading is, and zero otherwise.
            finite = 0.0 * gx + 0.0 * gy + 0.0 * gz + 0.0 * ax + 0.0 * ay + 0.0 * az == 0.0
            g, a = self.gyro, self.accel
            bx, by, bz = g.bias
            cx, cy, cz = a.bias
            if dt is not None:
                if not 0.0 < dt < float("inf"):
                    raise InputError("dt must be positive seconds.")
                bx, by, bz, cx, cy, cz = bx * dt, by * dt, bz * dt, cx * dt, cy * dt, cz * dt
            if not finite:
                raise InputError("The readings of the sample hold values that are not finite numbers.")
            rate = _solve(gx - bx, gy - by, gz - bz, g.linear, g.octants)
            force = _solve(ax - cx, ay - cy, az - cz, a.linear, a.octants)
        except (TypeError, ValueError):
            raise InputError("A sample is three numbers of the gyros and three of the accelerometers.") from None
        if self.rotation is not None:
            rate = _product(self.rotation, *rate)
            force = _product(self.rotation, *force)
        if out is not None:
            target, other = out
            target[0], target[1], target[2] = rate
            other[0], other[1], other[2] = force
        return rate, force

    def sample_covariance(self, gyro: ArrayLike, accel: ArrayLike, *, dt: float | ArrayLike | None = None) -> Array:
        """Covariance of corrected samples that the calibration's own covariance leaves; noise of the sample apart.

        Parameters
        ----------
        gyro, accel : array_like, shape (n, 3) or (3,)
            Readings, as in :meth:`apply`.
        dt : float or array_like, shape (n,), s, optional

        Returns
        -------
        ndarray, shape (n, 6, 6) or (6, 6)
            Of (gyro x, y, z, accelerometer x, y, z) in the frame and the squared units of the result: J P Jᵀ, with J
            the derivative of the corrected values with respect to the 27 errors and P their covariance.

        Raises
        ------
        InputError
            As :meth:`apply` does.

        Notes
        -----
        First order in the calibration's sigma. Held parameters count as exact. The error is common to all samples: it
        does not average out, and two samples' errors are correlated. In table axes the uncertainty of U is not part of
        it.
        """
        shape = _shape("gyro", gyro)
        if shape != _shape("accel", accel):
            raise InputError(f"The gyro readings have the shape {shape}, the accelerometers {_shape('accel', accel)}.")
        step = _durations(dt, shape)
        readings = [_readings(name, v).reshape(-1, 3) for name, v in (("gyro", gyro), ("accel", accel))]
        n = len(readings[0])
        values = np.empty((n, 3)), np.empty((n, 3))
        for y, inverse, tables, v in zip(readings, (self.gyro, self.accel), self._tables, values, strict=True):
            self._correct(y, step, inverse, tables, v, None)
        seconds = np.ones(n) if step is None else np.broadcast_to(step, n)
        covariance = np.empty((n, 6, 6))
        for a in range(0, n, _COVARIANCE_BLOCK):
            b = min(a + _COVARIANCE_BLOCK, n)
            duration = seconds[a:b, None]
            J = np.empty((b - a, 6, N_PARAMETERS))
            # The same reading with larger errors stands for a smaller value. An increment is a rate times its duration.
            J[:, :3] = -rate_error_jacobian(values[0][a:b] / duration, self._triads[0])
            J[:, 3:] = -force_error_jacobian(values[1][a:b] / duration, self._triads[1])
            J *= duration[:, :, None]
            if self.rotation is not None:
                to_table = np.array(self.rotation).reshape(3, 3)
                J[:, :3], J[:, 3:] = to_table @ J[:, :3], to_table @ J[:, 3:]
            covariance[a:b] = J @ self._covariance @ np.swapaxes(J, 1, 2)
        return covariance.reshape(*shape[:-1], 6, 6)

    def _correct(
        self,
        y: Array,
        step: float | Array | None,
        inverse: TriadInverse,
        tables: _Tables,
        target: Array,
        rotation: Array | None,
    ) -> None:
        """Correct readings of shape (n, 3) into ``target``, block by block."""
        for a in range(0, len(y), self._block):
            b = min(a + self._block, len(y))
            work = self._work.part(b - a)
            x, v, t = work.x, work.v, work.t
            for c, bias in enumerate(inverse.bias):  # in doubles, also where the readings are of single precision
                if step is None:
                    np.subtract(y[a:b, c], bias, out=x[c], dtype=np.float64)
                elif isinstance(step, float):
                    np.subtract(y[a:b, c], bias * step, out=x[c], dtype=np.float64)
                else:
                    np.multiply(step[a:b], bias, out=t[0])
                    np.subtract(y[a:b, c], t[0], out=x[c], dtype=np.float64)
            _multiply(tables.linear, x, v, t)
            if inverse.octants is not None:
                _settle(work, tables, inverse.octants)
            if rotation is not None:
                _multiply(rotation, v, x, t)
                v = x
            for c in range(3):
                target[a:b, c] = v[c]


class _Tables:
    """A triad's inverses as arrays: column j of every matrix together, as the products take them.

    Attributes
    ----------
    linear : ndarray, shape (3, 3, 1)
    uniform : ndarray, shape (8, 3, 3, 1)
        By octant.
    gathered : ndarray, shape (3, 3, 8)
    """

    __slots__ = ("gathered", "linear", "uniform")

    def __init__(self, inverse: TriadInverse) -> None:
        self.linear = _columns(inverse.linear)
        self.uniform = _columns(inverse.octants or (inverse.linear,) * 8)
        self.gathered = np.ascontiguousarray(self.uniform[..., 0].transpose(1, 2, 0))


@dataclass(frozen=True, slots=True)
class _Part:
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


class _Work:
    """Room for a block, lent in parts: one call of numpy for three components takes a third of the time of three."""

    __slots__ = ("_bits", "_codes", "_octant", "_values", "_whole")

    def __init__(self, block: int) -> None:
        self._values = np.empty((3, 3 * block))
        self._bits = np.empty(3 * block, dtype=np.uint8)
        self._codes = np.empty((3, block), dtype=np.uint8)
        self._octant = np.empty(block, dtype=np.intp)
        self._whole = self._lend(block)

    def part(self, m: int) -> _Part:
        return self._whole if m == len(self._octant) else self._lend(m)

    def _lend(self, m: int) -> _Part:
        x, v, t = (values[: 3 * m].reshape(3, m) for values in self._values)
        bits = self._bits[: 3 * m].reshape(3, m)
        code, found, wrong = (codes[:m] for codes in self._codes)
        return _Part(x, v, t, bits.view(np.bool_), bits, code, found, wrong.view(np.bool_), self._octant[:m])


def _settle(work: _Part, tables: _Tables, octants: tuple[tuple[float, ...], ...]) -> None:
    """Replace the first guess of the solutions by the solutions, each in the octant that it lies in itself."""
    x, v, t, code = work.x, work.v, work.t, work.code
    _number(v, work.negative, work.bits, code)
    if code.min() == code.max():  # a block of slow motion lies in one octant: nothing to gather
        _multiply(tables.uniform[int(code[0])], x, v, t)
    else:
        np.copyto(work.octant, code)
        # Without clipping, take would first write to a copy.
        tables.gathered[0].take(work.octant, axis=1, out=v, mode="clip")
        np.multiply(v, x[0], out=v)
        for j in (1, 2):
            tables.gathered[j].take(work.octant, axis=1, out=t, mode="clip")
            np.multiply(t, x[j], out=t)
            np.add(v, t, out=v)
    _number(v, work.negative, work.bits, work.found)
    if np.not_equal(code, work.found, out=work.wrong).any():
        _mend(work, tables, octants)


def _mend(work: _Part, tables: _Tables, octants: tuple[tuple[float, ...], ...]) -> None:
    """Solve again where the first octant was not that of the solution; on copies of these few, at most a block."""
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
        _number(v, negative, negative.view(np.uint8), found)
        left = found != code
        wrong, code = wrong[left], found[left]
        if wrong.size == 0:
            return
    for k in wrong.tolist():
        x, y, z = work.x[:, k].tolist()
        work.v[:, k] = _least_contradiction(x, y, z, octants)


def _number(v: Array, negative: Mask, bits: NDArray[np.uint8], code: NDArray[np.uint8]) -> None:
    """Number the octants of vectors of shape (3, m); a zero counts as positive. ``bits`` views ``negative``."""
    np.less(v, 0.0, out=negative)
    np.left_shift(bits, _BITS, out=bits)
    np.bitwise_or.reduce(bits, axis=0, out=code)


def _columns(matrices: tuple[float, ...] | tuple[tuple[float, ...], ...]) -> Array:
    """Columns of matrices given by rows, shape (..., 3, 3, 1): column, row, to broadcast against samples."""
    rows = np.array(matrices)
    return np.ascontiguousarray(np.swapaxes(rows.reshape(*rows.shape[:-1], 3, 3), -1, -2))[..., None]


def _multiply(columns: Array, x: Array, v: Array, t: Array) -> None:
    """Multiply a matrix, given by columns, and vectors of shape (3, m): into ``v``, with room ``t`` for products."""
    np.multiply(columns[0], x[0], out=v)
    np.multiply(columns[1], x[1], out=t)
    np.add(v, t, out=v)
    np.multiply(columns[2], x[2], out=t)
    np.add(v, t, out=v)


def _product(matrix: tuple[float, ...], x: float, y: float, z: float) -> Vector:
    a, b, c, d, e, f, g, h, i = matrix
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _solve(
    x: float, y: float, z: float, linear: tuple[float, ...], octants: tuple[tuple[float, ...], ...] | None
) -> Vector:
    """Invert the reading model for one reading less its bias."""
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
    return _least_contradiction(x, y, z, octants)


def _least_contradiction(x: float, y: float, z: float, octants: tuple[tuple[float, ...], ...]) -> Vector:
    """Look through all octants for the solution that contradicts its own the least.

    On a border rounding can make the search alternate between octants whose solutions agree but for rounding; that it
    never runs in a wider circle is not proven. One octant holds the solution, so one contradicts itself by rounding at
    most.
    """
    best, least = (0.0, 0.0, 0.0), float("inf")
    for octant, matrix in enumerate(octants):
        v = _product(matrix, x, y, z)
        contradiction = 0.0
        for bit, component in enumerate(v):
            contradiction = max(contradiction, component if octant >> bit & 1 else -component)
        if contradiction < least:
            best, least = v, contradiction
    return best


def _rows(matrices: NDArray[np.floating]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrices.reshape(-1, 9).tolist())


def _rotation(U: Array | None) -> tuple[float, ...]:
    assert U is not None
    if U.shape != (3, 3) or not np.abs(U @ U.T - np.eye(3)).max() < _ORTHOGONAL_WITHIN or not np.linalg.det(U) > 0.0:
        raise InputError("The matrix U of this calibration is no rotation: its file was edited; use frame='mars'.")
    return tuple(U.T.ravel().tolist())


def _shape(name: str, values: ArrayLike) -> tuple[int, ...]:
    try:
        return np.shape(values)
    except ValueError:
        raise InputError(f"The {name} readings are not numbers in an array of shape (n, 3) or (3,).") from None


def _readings(name: str, values: ArrayLike) -> Array:
    """Readings as an array of real numbers, of shape (n, 3) or (3,), all finite; not copied where not needed."""
    try:
        # Other real numbers become floats block by block.
        y = values if isinstance(values, np.ndarray) and values.dtype.kind in "fiu" else np.asarray(values)
        if y.dtype.kind not in "fiu":
            y = y.astype(np.float64, casting="unsafe" if y.dtype.kind in "bOUS" else "same_kind")
    except (TypeError, ValueError):
        raise InputError(f"The {name} readings are not numbers in an array of shape (n, 3) or (3,).") from None
    if y.shape[-1:] != (3,) or y.ndim > 2:
        raise InputError(f"The {name} readings have the shape {y.shape}; (n, 3) or (3,) is expected.")
    # A sum is finite only if every term is, and makes no array. If it overflows, look closer.
    with np.errstate(over="ignore", invalid="ignore"):
        if not np.isfinite(y.sum(dtype=np.float64)) and not np.isfinite(y).all():
            raise InputError(f"The {name} readings hold values that are not finite numbers.")
    return y


def _durations(dt: float | ArrayLike | None, shape: tuple[int, ...]) -> float | Array | None:
    """Durations of increments for readings of that shape: one number, or one per sample; None for rates."""
    if dt is None:
        return None
    try:
        step = np.asarray(dt, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("dt must be positive seconds.") from None
    # Comparisons with NaN are false; extremes make no array.
    if step.size and not (step.min() > 0.0 and step.max() < np.inf):
        raise InputError("dt must be positive seconds.")
    if step.ndim == 0:
        return float(step)
    if len(shape) != 2 or step.shape != shape[:1]:
        raise InputError(f"dt has the shape {step.shape}, which does not go with readings of shape {shape}.")
    return step


def _check_out(out: tuple[Array, Array], readings: tuple[Array, Array]) -> None:
    """Refuse arrays that the result does not fit, or that writing to would spoil what is still to be read."""
    if len(out) != 2:
        raise InputError(f"out holds {len(out)} arrays, but one for the gyro and one for the accel are needed.")
    for name, target, y in zip(("gyro", "accel"), out, readings, strict=True):
        if np.shape(target) != y.shape:
            raise InputError(f"out for {name} has the shape {np.shape(target)}, not {y.shape}.")
        if not isinstance(target, np.ndarray) or target.dtype != np.float64 or not target.flags.writeable:
            raise InputError(f"out for {name} is no float64 array that can be written to.")
        if _overlap(target, y) and not _same_memory(target, y):
            raise InputError(f"out for {name} overlaps its readings; give these themselves, or an array of its own.")
    if _overlap(out[0], readings[1]) or _overlap(out[0], out[1]):
        raise InputError("out for gyro overlaps the accelerometers' arrays: give an array of its own.")


def _overlap(a: Array, b: Array) -> bool:
    return np.may_share_memory(a, b) and np.shares_memory(a, b)


def _same_memory(a: Array, b: Array) -> bool:
    return a.ctypes.data == b.ctypes.data and a.strides == b.strides and a.dtype == b.dtype
