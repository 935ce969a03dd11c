"""Applier: the compensation of a calibration, prepared for use in a loop, exact and without allocation.

Asymmetry rectifies noise: s multiplies |v|, and the mean of |v + noise| is not |mean|. In a channel at rest a mean of
about ``-0.8 s σ`` remains, with σ the 1-sigma noise of a sample and 0.8 for √(2/π) (1 % of asymmetry and 1.7e-3 rad/s
of noise: 2.8 °/h). The effect vanishes where the channel is more than three sigma from zero. No correction of single
samples can avoid it: at rest, average the readings first and correct the mean.
"""

from __future__ import annotations

from numbers import Integral
from typing import TYPE_CHECKING, Final, Literal, Protocol, runtime_checkable

import numpy as np

from srt.arguments import real_array, require_type
from srt.exceptions import InputError
from srt.model.measurement_model import force_error_jacobian, rate_error_jacobian
from srt.model.prior import CalibratedErrors
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.result.triad_inverse import (
    InverseArrays,
    TriadInverse,
    WorkBlock,
    matrix_columns,
    multiply,
    product,
    solve_block,
    solve_sample,
)
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

    from numpy.typing import ArrayLike

    from srt.model.sensor_model import Triad
    from srt.result.triad_inverse import Vector, WorkArrays
    from srt.types import Array

    Sample = Sequence[float] | Array

    from srt.types import Array

BLOCK: Final = 8192
"""Samples per block: enough to hide the call overhead of numpy, with work arrays (0.7 MB) that fit a cache."""

_COVARIANCE_BLOCK: Final = 1024
"""Samples per block of covariances; their Jacobians take 1.3 kB per sample."""

_ORTHOGONAL_WITHIN: Final = 1e-6
"""Largest element of U Uᵀ − I of a rotation matrix that was read from a file."""


@runtime_checkable
class ErrorsInFrames(CalibratedErrors, Protocol):
    """Sensor errors in MARS with the rotation from the table frame; :class:`srt.Calibration` is one."""

    def require_values(self) -> None:
        """Raise InputError if there are no errors to correct."""
        ...

    @property
    def U(self) -> Array | None:
        """T to MARS components, shape (3, 3); None without a fixture."""

    @property
    def g_sensitivity(self) -> Array | None:
        """Gyro g-sensitivity Γ in MARS axes, shape (3, 3), rad/s per m/s²; None if not estimated."""

    @property
    def g_sensitivity_covariance(self) -> Array | None:
        """Covariance of Γ by rows, shape (9, 9); None if not estimated."""


class Applier:
    """Correct readings in a loop.

    Results are in MARS or table axes, in the units of the readings. The work arrays belong to the object: give every
    thread its own.

    Parameters
    ----------
    calibration : Calibration
        Of any status, which the caller has to check.
    frame : "mars" or "table"
        Axes of the result.
    block : int
        Samples corrected at a time, which decides the size of the work arrays (86 bytes per sample).

    Attributes
    ----------
    gyro, accel : TriadInverse
    sensitivity : tuple of 9 floats, or None
        Γ by rows: Γ f, with f the corrected specific force in MARS axes, is subtracted from the gyro readings.
    rotation : tuple of 9 floats, or None
        Uᵀ by rows, MARS to table-mounted components; None for MARS axes.

    Raises
    ------
    InputError
        An unknown frame, no table frame in the calibration, or a sensor model without a unique inverse.

    Notes
    -----
    Asymmetry rectifies the noise of a channel near zero: see the docstring of this module.
    """

    __slots__ = (
        "_block", "_covariance", "_followed", "_sensitivity_covariance", "_tables", "_triads", "_work", "accel", "gyro",
        "rotation", "sensitivity",
    )  # fmt: skip

    def __init__(
        self, calibration: ErrorsInFrames, *, frame: Literal["mars", "table"] = "mars", block: int = BLOCK
    ) -> None:
        require_type("An Applier", "a calibration", calibration, ErrorsInFrames)
        require_type("block=", "a whole number", block, Integral)
        calibration.require_values()
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
        matrix = calibration.g_sensitivity
        self.sensitivity = None if matrix is None else tuple(matrix.ravel().tolist())
        self._covariance = calibration.covariance
        self._sensitivity_covariance = calibration.g_sensitivity_covariance
        self._tables = InverseArrays(self.gyro), InverseArrays(self.accel)
        self._block = block
        self._work = WorkBlock(block)
        self._followed = None if matrix is None else np.empty(3 * block)

    def apply(
        self,
        gyro: ArrayLike,
        accel: ArrayLike,
        *,
        dt: float | ArrayLike | None = None,
        out: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """Correct samples. With ``out``, and readings that are arrays, no array of their length is allocated.

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
        shapes = reading_shape("gyro", gyro), reading_shape("accel", accel)
        if shapes[0] != shapes[1]:
            raise InputError(f"The gyro readings have the shape {shapes[0]}, the accelerometers {shapes[1]}.")
        step = durations(dt, shapes[0])
        readings = checked_readings("gyro", gyro), checked_readings("accel", accel)
        if out is None:
            out = np.empty(shapes[0]), np.empty(shapes[0])
        else:
            check_output(out, readings)
        rotation = None if self.rotation is None else matrix_columns(self.rotation)
        self._correct(readings, step, (np.atleast_2d(out[0]), np.atleast_2d(out[1])), rotation)
        return out

    def apply_sample(
        self,
        gyro: Sample,
        accel: Sample,
        *,
        dt: float | None = None,
        out: tuple[MutableSequence[float] | Array, MutableSequence[float] | Array] | None = None,
    ) -> tuple[Vector, Vector]:
        """Correct one sample with plain floats, the fastest way in Python; the results equal those of :meth:`apply`.

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
        if any(triad.further for triad in self._triads):
            of_rate, of_force = self.apply(np.asarray(gyro), np.asarray(accel), dt=dt)
            for target, values in zip(out or (), (of_rate, of_force), strict=False):
                target[0], target[1], target[2] = values
            return tuple(of_rate.tolist()), tuple(of_force.tolist())
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
            force = solve_sample(ax - cx, ay - cy, az - cz, a.linear, a.octants)
            gx, gy, gz = gx - bx, gy - by, gz - bz
            if self.sensitivity is not None:
                sx, sy, sz = product(self.sensitivity, *force)
                gx, gy, gz = gx - sx, gy - sy, gz - sz
            rate = solve_sample(gx, gy, gz, g.linear, g.octants)
        except (TypeError, ValueError):
            raise InputError("A sample is three numbers of the gyros and three of the accelerometers.") from None
        if self.rotation is not None:
            rate = product(self.rotation, *rate)
            force = product(self.rotation, *force)
        if out is not None:
            target, other = out
            target[0], target[1], target[2] = rate
            other[0], other[1], other[2] = force
        return rate, force

    def sample_covariance(self, gyro: ArrayLike, accel: ArrayLike, *, dt: float | ArrayLike | None = None) -> Array:
        """Covariance of corrected samples due to the covariance of the calibration, without the noise of the samples.

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
        First order in the sigma of the calibration. Fixed parameters count as exact. The error is common to all
        samples and does not average out. In table axes the uncertainty of U is not included.
        """
        shape = reading_shape("gyro", gyro)
        if shape != reading_shape("accel", accel):
            raise InputError(
                f"The gyro readings have the shape {shape}, the accelerometers {reading_shape('accel', accel)}."
            )
        step = durations(dt, shape)
        readings = [checked_readings(name, v).reshape(-1, 3) for name, v in (("gyro", gyro), ("accel", accel))]
        n = len(readings[0])
        values = np.empty((n, 3)), np.empty((n, 3))
        self._correct(readings, step, values, None)
        seconds = np.ones(n) if step is None else np.broadcast_to(step, n)
        covariance = np.empty((n, 6, 6))
        for a in range(0, n, _COVARIANCE_BLOCK):
            b = min(a + _COVARIANCE_BLOCK, n)
            duration = seconds[a:b, None]
            J = np.empty((b - a, 6, N_PARAMETERS))
            # For a given reading, a larger error means a smaller true value. An increment is a rate times its duration.
            J[:, :3] = -rate_error_jacobian(values[0][a:b] / duration, self._triads[0])
            J[:, 3:] = -force_error_jacobian(values[1][a:b] / duration, self._triads[1])
            J *= duration[:, :, None]
            own = self._follow(J, values[0][a:b], values[1][a:b])
            if self.rotation is not None:
                to_table = np.array(self.rotation).reshape(3, 3)
                J[:, :3], J[:, 3:] = to_table @ J[:, :3], to_table @ J[:, 3:]
            covariance[a:b] = J @ self._covariance @ np.swapaxes(J, 1, 2)
            if own is not None:
                covariance[a:b, :3, :3] += own
        return covariance.reshape(*shape[:-1], 6, 6)

    def _follow(self, J: Array, rate: Array, force: Array) -> Array | None:
        """Add accelerometer errors that reach the gyros through Γ to J; covariance by Γ itself, shape (n, 3, 3)."""
        if self.sensitivity is None:
            return None
        triad = self._triads[0]
        slopes = triad.matrix + np.sign(rate)[:, :, None] * np.diag(triad.asymmetry)
        followed = np.linalg.solve(slopes, np.broadcast_to(np.reshape(self.sensitivity, (3, 3)), slopes.shape))
        J[:, :3] -= followed @ J[:, 3:]
        P = self._sensitivity_covariance
        if P is None:
            return None
        # δω = −D⁻¹ δΓ f
        inverse: Array = np.asarray(np.linalg.inv(slopes), dtype=np.float64)
        if self.rotation is not None:
            inverse = np.reshape(self.rotation, (3, 3)) @ inverse
        turned: Array = np.einsum("abcd,nb,nd->nac", P.reshape(3, 3, 3, 3), force, force)
        return np.asarray(inverse @ turned @ np.swapaxes(inverse, 1, 2))

    def _correct(
        self,
        readings: Sequence[Array],
        step: float | Array | None,
        targets: tuple[Array, Array],
        rotation: Array | None,
    ) -> None:
        """Correct readings of shape (n, 3) or (3,) into ``targets``, block by block, the accelerometers first."""
        gyro, accel = np.atleast_2d(readings[0]), np.atleast_2d(readings[1])
        sensitivity = None if self.sensitivity is None else matrix_columns(self.sensitivity)
        for a in range(0, len(gyro), self._block):
            b = min(a + self._block, len(gyro))
            duration = step[a:b] if isinstance(step, np.ndarray) else step
            followed = None
            for y, inverse, tables, triad, target in (
                (accel, self.accel, self._tables[1], self._triads[1], targets[1]),
                (gyro, self.gyro, self._tables[0], self._triads[0], targets[0]),
            ):
                work = self._work.part(b - a)
                x, v, t = work.x, work.v, work.t
                for c, bias in enumerate(inverse.bias):  # in doubles, also where the readings are of single precision
                    if duration is None:
                        np.subtract(y[a:b, c], bias, out=x[c], dtype=np.float64)
                    elif isinstance(duration, float):
                        np.subtract(y[a:b, c], bias * duration, out=x[c], dtype=np.float64)
                    else:
                        np.multiply(duration, bias, out=t[0])
                        np.subtract(y[a:b, c], t[0], out=x[c], dtype=np.float64)
                if followed is not None:
                    np.subtract(x, followed, out=x)
                if triad.further:
                    _solve_with_further(work, tables, inverse, triad, duration)
                else:
                    _solve(work, tables, inverse)
                if sensitivity is not None and self._followed is not None and inverse is self.accel:
                    followed = self._followed[: 3 * (b - a)].reshape(3, b - a)
                    multiply(sensitivity, v, followed, t)
                if rotation is not None:
                    multiply(rotation, v, x, t)
                    v = x
                for c in range(3):
                    target[a:b, c] = v[c]


def _solve(work: WorkArrays, tables: InverseArrays, inverse: TriadInverse) -> None:
    """Solve readings less their bias, ``work.x``, for the true values ``work.v``."""
    multiply(tables.linear, work.x, work.v, work.t)
    if inverse.octants is not None:
        solve_block(work, tables, inverse.octants)


def _solve_with_further(
    work: WorkArrays, tables: InverseArrays, inverse: TriadInverse, triad: Triad, duration: float | Array | None
) -> None:
    """The same with the further errors of a triad; they act on rates, increments are rates times the duration."""
    whole, seconds = work.x.copy(), 1.0 if duration is None else duration

    def solve(other: Array | float) -> Array:
        np.subtract(whole, np.transpose(other) * seconds, out=work.x)
        _solve(work, tables, inverse)
        return np.asarray((work.v / seconds).T)

    triad.contract(solve)


def _rotation(U: Array | None) -> tuple[float, ...]:
    """Rows of Uᵀ, MARS to table-mounted components."""
    assert U is not None
    if U.shape != (3, 3) or not np.abs(U @ U.T - np.eye(3)).max() < _ORTHOGONAL_WITHIN or not np.linalg.det(U) > 0.0:
        raise InputError("The matrix U of this calibration is no rotation: its file was edited; use frame='mars'.")
    return tuple(U.T.ravel().tolist())


def reading_shape(name: str, values: ArrayLike) -> tuple[int, ...]:
    """Shape of the readings; raises InputError if they form no array."""
    if values is None:
        raise InputError(f"The {name} readings are None, but an array of shape (n, 3) or (3,) is expected.")
    try:
        return np.shape(values)
    except ValueError:
        raise InputError(f"The {name} readings are not numbers in an array of shape (n, 3) or (3,).") from None


def checked_readings(name: str, values: ArrayLike) -> Array:
    """Readings as an array of finite real numbers, shape (n, 3) or (3,), copied only if necessary."""
    y = real_array(name, values)  # other real numbers become floats block by block
    if y.shape[-1:] != (3,) or y.ndim > 2:
        raise InputError(f"The {name} readings have the shape {y.shape}; (n, 3) or (3,) is expected.")
    # A sum is finite only if every term is, and makes no array. If it overflows, look closer.
    with np.errstate(over="ignore", invalid="ignore"):
        if not np.isfinite(y.sum(dtype=np.float64)) and not np.isfinite(y).all():
            raise InputError(f"The {name} readings hold values that are not finite numbers.")
    return y


def durations(dt: float | ArrayLike | None, shape: tuple[int, ...]) -> float | Array | None:
    """Durations of increments for readings of that shape: one number, or one per sample; None for rates."""
    if dt is None:
        return None
    step = np.asarray(real_array("dt", dt), dtype=np.float64)
    # Comparisons with NaN are false; extremes make no array.
    if step.size and not (step.min() > 0.0 and step.max() < np.inf):
        raise InputError("dt must be positive seconds.")
    if step.ndim == 0:
        return float(step)
    if len(shape) != 2 or step.shape != shape[:1]:
        raise InputError(f"dt has the shape {step.shape}, which does not go with readings of shape {shape}.")
    return step


def check_output(out: tuple[Array, Array], readings: tuple[Array, Array]) -> None:
    """Refuse output arrays of a wrong shape or type, or that overlap the readings."""
    require_type("out=", "a pair of arrays", out, tuple, list)
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
    """Return True if two arrays share an element."""
    return np.may_share_memory(a, b) and np.shares_memory(a, b)


def _same_memory(a: Array, b: Array) -> bool:
    """Return True if two arrays are the same view of the same memory."""
    return a.ctypes.data == b.ctypes.data and a.strides == b.strides and a.dtype == b.dtype
