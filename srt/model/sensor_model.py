"""Sensor model of a triad: readings, exact compensation, composition of errors and MARS gauge ([P] eqs. 6-11).

The reading is ``y = M v + s ∘ |v| + b`` (``v`` the true rate or specific force; [P]: Savage 2020). Names and values of
the errors in Mg and Ma are in :mod:`srt.sensor_errors`, which may declare further ones. Without these the model is
piecewise linear: within one octant of ``v`` it is ``y = (M + diag(s ∘ sign v)) v + b``. Compensation finds the octant
and solves this exactly; further errors are contracted to the last bit. Nothing is linearised, so errors of 50 % are
allowed. The solution is unique if ``M + diag(s ∘ σ)`` has the same sign of its determinant for every sign vector σ.

The inverse exists in three forms: :meth:`Triad.compensate`; for gyro streams in :mod:`srt.model.platform_steps`
(``_compensate``, compiled in :mod:`srt.model.compiled_platform`); for applied calibrations in
:mod:`srt.result.triad_inverse`.

Gauge. A gyro matrix ``Mg`` in any frame T is ``Mg = P U`` with P symmetric positive definite and U a rotation (polar
decomposition). MARS is the frame ``ω_MARS = U ω_T`` in which the gyro matrix is P; the accelerometer matrix becomes
``Ma Uᵀ``. [P] eq. 8 holds to first order; P is exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, OF_SENSOR, MatrixElements, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from srt.sensor_errors import ParameterGroup
    from srt.types import Array, Indices


def _basis(sensor: str) -> Array:
    """Derivative of a sensor matrix with respect to the errors that are elements of it, in the order of the state."""
    of_unit = [g.effect(np.eye(3)) for g in OF_SENSOR[sensor] if isinstance(g.effect, MatrixElements)]
    return np.ascontiguousarray(np.transpose(np.concatenate(of_unit, axis=-1), (2, 1, 0)))


GYRO_BASIS: Final = _basis("gyro")
"""dMg / d(gyro_scale, gyro_orthogonality), shape (6, 3, 3)."""
ACCEL_BASIS: Final = _basis("accel")
"""dMa / d(accel_scale, accel_misalignment), shape (9, 3, 3)."""

# Octant o has the signs SIGNS[o]; bit c of o is set where component c is negative.
SIGNS: Final = 1.0 - 2.0 * ((np.arange(8)[:, None] >> np.arange(3)) & 1)

MIN_SINGULAR_VALUE: Final = 0.15
"""Smallest singular value of a triad's matrix that is accepted; below it the axes are nearly coplanar."""

OCTANT_ITERATIONS: Final = 8
"""Limit of the iterations that search the octant of a sample: the number of octants."""

_CONTRACTION_ITERATIONS: Final = 100
"""Limit of a contraction to the inverse; one by 0.5 reaches double precision in 53."""

_SLOPE_STEP: Final = 1e-4
"""Step of the differences that give the slope of further errors, m/s² or rad/s."""


@dataclass(frozen=True, eq=False)
class Triad:
    """Sensor model of a triad, ``y = M v + s ∘ |v| + b + Q(v)``, or of the triads of several units.

    Attributes
    ----------
    matrix : ndarray, shape (3, 3) or (units, 3, 3)
        M: scale factor and misalignment, identity for a perfect triad.
    asymmetry : ndarray, shape (3,) or (units, 3)
        s, dimensionless.
    bias : ndarray, shape (3,) or (units, 3)
        b, rad/s or m/s².
    further : tuple of (ParameterGroup, ndarray)
        Groups of other errors that are not zero, with their values, (n,) or (units, n): ``Q(v)`` is their effect.
    """

    matrix: Array
    asymmetry: Array
    bias: Array
    further: tuple[tuple[ParameterGroup, Array], ...] = ()

    @cached_property
    def inverse(self) -> Array:
        """``M⁻¹``, shape (..., 3, 3)."""
        return np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)

    @cached_property
    def inverses(self) -> Array:
        """``(M + diag(s ∘ sign))⁻¹`` by octant, shape (..., 8, 3, 3)."""
        signed: Array = SIGNS * self.asymmetry[..., None, :]
        return np.asarray(np.linalg.inv(self.matrix[..., None, :, :] + signed[..., None] * np.eye(3)), dtype=np.float64)

    def read(self, true: ArrayLike) -> Array:
        """Noise-free readings of true values of shape (..., 3)."""
        v = np.asarray(true, dtype=np.float64)
        return v @ self.matrix.T + self.asymmetry * np.abs(v) + self.bias + self.other(v)

    def other(self, v: Array) -> Array:
        """Effect Q of the further errors on readings of true values (..., 3), those of several units (units, n, 3)."""
        out = np.zeros(v.shape)
        for group, values in self.further:
            by_unit = values if values.ndim == 1 else values[:, None]
            out += (group.effect(v) @ by_unit[..., None])[..., 0]
        return out

    def contract(self, solve: Callable[[Array | float], Array]) -> Array:
        """Solution v of the whole model from that of the model without further errors for readings less Q(v).

        ``solve`` takes Q, or zero, and gives v. Further errors are small beside 1, so that this converges.
        """
        v = solve(0.0)
        for _ in range(_CONTRACTION_ITERATIONS if self.further else 0):
            before, v = v, solve(self.other(v))
            if np.abs(v - before).max(initial=0.0) <= 4.0 * np.finfo(np.float64).eps * np.abs(v).max(initial=0.0):
                break
        return v

    def compensate(self, reading: ArrayLike) -> Array:
        """Invert :meth:`read` exactly, for readings of shape (..., 3), those of several units (units, n, 3).

        Two faster inverses give the same values: of gyro streams (:mod:`srt.model.platform_steps`; compared in
        tests/model/test_sensor_model.py) and of applied calibrations (:mod:`srt.result.triad_inverse`; compared in
        tests/result/test_apply.py).
        """
        y = np.asarray(reading, dtype=np.float64)
        y = y - (self.bias if self.bias.ndim == 1 else self.bias[:, None])
        return self.contract(lambda other: self._without_further(y - other))

    def _without_further(self, y: Array) -> Array:
        """Solution of ``M v + s ∘ |v| = y``."""
        first = y @ np.swapaxes(self.inverse, -1, -2)
        if not self.asymmetry.any():
            return np.asarray(first)
        flat, unit = y.reshape(-1, 3), self._units(y)
        inverses = self.inverses.reshape(-1, 3, 3)
        octant = octants(first.reshape(-1, 3)) + 8 * unit
        solution = np.einsum("nij,nj->ni", inverses[octant], flat)
        # The solution in a wrong octant points to another octant; few samples need a second iteration.
        for _ in range(OCTANT_ITERATIONS):
            found = octants(solution) + 8 * unit
            wrong = np.flatnonzero(found != octant)
            if wrong.size == 0:
                break
            octant[wrong] = found[wrong]
            solution[wrong] = np.einsum("nij,nj->ni", inverses[octant[wrong]], flat[wrong])
        else:
            # On the border between octants, rounding can make the search alternate. The contraction
            # v <- M⁻¹(y - s ∘ |v|) converges there for either sign.
            v, own = solution[wrong], unit[wrong]
            asymmetry, inverse = self.asymmetry.reshape(-1, 3)[own], self.inverse.reshape(-1, 3, 3)[own]
            for _ in range(_CONTRACTION_ITERATIONS):
                v = np.einsum("nij,nj->ni", inverse, flat[wrong] - asymmetry * np.abs(v))
            solution[wrong] = v
        out: Array = solution.reshape(y.shape)
        return out

    def sensitivity(self, value: Array) -> Array:
        """Derivative of the compensated value to the reading, ``(M + diag(s ∘ sign v) + Q')⁻¹``, shape (..., 3, 3)."""
        if self.further:
            slopes = [
                (self.other(value + d) - self.other(value - d)) / (2.0 * _SLOPE_STEP) for d in _SLOPE_STEP * np.eye(3)
            ]
            inverse = replace(self, further=()).sensitivity(value)
            return np.asarray(np.linalg.inv(np.linalg.inv(inverse) + np.stack(slopes, axis=-1)))
        if not self.asymmetry.any():
            inverse = self.inverse if self.inverse.ndim == 2 else self.inverse[:, None]
            return np.broadcast_to(inverse, (*value.shape, 3))
        octant = octants(value.reshape(-1, 3)) + 8 * self._units(value)
        return np.asarray(self.inverses.reshape(-1, 3, 3)[octant].reshape(*value.shape, 3))

    def of(self, which: Indices | int) -> Triad:
        """Triads of some units, or that of one."""
        further = tuple((group, values[which]) for group, values in self.further)
        return Triad(self.matrix[which], self.asymmetry[which], self.bias[which], further)

    def _units(self, values: Array) -> Indices:
        """Number of the unit of each vector of an array (..., 3); the first axis is that of the units, if any."""
        count = 1 if self.bias.ndim == 1 else len(self.bias)
        return np.repeat(np.arange(count), values.size // (3 * count))


def octants(v: Array) -> Indices:
    """Octant number, 0-7, of vectors of shape (n, 3); a zero counts as positive."""
    negative = v < 0.0
    return negative[:, 0] + 2 * negative[:, 1].astype(np.intp) + 4 * negative[:, 2]


@lru_cache(maxsize=8)
def gyro_triad(errors: SensorErrors) -> Triad:
    """Sensor model of the gyros: Mg, κ_Asym, κ_Bias."""
    return triads(errors.vector)[0]


@lru_cache(maxsize=8)
def accel_triad(errors: SensorErrors) -> Triad:
    """Sensor model of the accelerometers: Ma, λ_Asym, λ_Bias."""
    return triads(errors.vector)[1]


def triads(vector: Array) -> tuple[Triad, Triad]:
    """Sensor models of gyros and accelerometers with sensor errors (27,), or those of units, (units, 27)."""
    by_group = {name: vector[..., part] for name, part in GROUP_SLICES.items()}
    rows = (("gyro", "orthogonality", GYRO_BASIS), ("accel", "misalignment", ACCEL_BASIS))
    gyro, accel = (
        Triad(
            np.eye(3)
            + np.tensordot(
                np.concatenate([by_group[f"{sensor}_scale"], by_group[f"{sensor}_{angles}"]], axis=-1), basis, 1
            ),
            by_group[f"{sensor}_asymmetry"],
            by_group[f"{sensor}_bias"],
            tuple((g, by_group[g.name]) for g in OF_SENSOR[sensor] if g.further and by_group[g.name].any()),
        )
        for sensor, angles, basis in rows
    )
    return gyro, accel


def errors_from_triads(gyro: Triad, accel: Triad) -> SensorErrors:
    """Sensor errors of two triads whose gyro matrix is symmetric (MARS)."""
    return SensorErrors(_vectors(gyro, accel))


def _vectors(gyro: Triad, accel: Triad) -> Array:
    """Sensor errors (..., 27) of triads, the inverse of :func:`triads`."""
    vector = np.zeros((*gyro.bias.shape[:-1], N_PARAMETERS))
    for sensor, triad in (("gyro", gyro), ("accel", accel)):
        vector[..., GROUP_SLICES[f"{sensor}_asymmetry"]] = triad.asymmetry
        vector[..., GROUP_SLICES[f"{sensor}_bias"]] = triad.bias
        for group, values in triad.further:
            vector[..., GROUP_SLICES[group.name]] = values
        error = triad.matrix - np.eye(3)
        for group in OF_SENSOR[sensor]:
            if isinstance(group.effect, MatrixElements):
                elements = [sum(error[..., i, j] for i, j in places) for places in group.effect.places]
                vector[..., GROUP_SLICES[group.name]] = np.stack(elements, axis=-1)
    return vector


def to_mars(gyro: Triad, accel: Triad) -> tuple[SensorErrors, Array]:
    """Transform two triads from any frame T to the MARS gauge.

    Returns
    -------
    errors : SensorErrors
        The same triads in MARS.
    U : ndarray, shape (3, 3)
        Rotation from T to MARS components, ``ω_MARS = U ω_T``.

    Raises
    ------
    DataError
        If det Mg is not positive: a flipped axis or a left-handed triad.

    Notes
    -----
    Asymmetry multiplies the absolute values of MARS components, and further errors follow these. They are not
    transformed: this is exact for U = I, and their definition otherwise.
    """
    if np.linalg.det(gyro.matrix) <= 0.0:
        raise DataError(
            "The gyro triad is left-handed (determinant of its scale and misalignment matrix "
            f"{np.linalg.det(gyro.matrix):.3g}): one axis is flipped or two are swapped; correct the axis mapping."
        )
    vector, U = vectors_in_mars(gyro, accel)
    return SensorErrors(vector), U


def vectors_in_mars(gyro: Triad, accel: Triad) -> tuple[Array, Array]:
    """:func:`to_mars` of triads with det Mg > 0 or those of units: sensor errors (..., 27), and U (..., 3, 3)."""
    left, singular, right = np.linalg.svd(gyro.matrix)
    # The polar decomposition Mg = P U
    U, P = left @ right, (left * singular[..., None, :]) @ np.swapaxes(left, -1, -2)
    symmetric = replace(gyro, matrix=0.5 * (P + np.swapaxes(P, -1, -2)))
    turned = replace(accel, matrix=accel.matrix @ np.swapaxes(U, -1, -2))
    return _vectors(symmetric, turned), U


def compose(errors: SensorErrors, delta: ArrayLike) -> tuple[SensorErrors, Array]:
    """Compose errors with ``delta``, the errors of the data *compensated* with ``errors``.

    Closed-form coefficients are a Jacobian at zero error, so they give the errors of the compensated data:
    ``Mg <- Mg (I + δκ)``, ``κ_Bias <- κ_Bias + Mg δκ_Bias``, ``κ_iii <- κ_iii + (Mg)_ii δκ_iii``; likewise for the
    accelerometers. The product is not symmetric, so it is transformed to the MARS gauge.

    Parameters
    ----------
    errors : SensorErrors
        Errors that the data were compensated with.
    delta : array_like, shape (27,)
        Errors of the compensated data.

    Returns
    -------
    errors : SensorErrors
    U : ndarray, shape (3, 3)
        Rotation from the old to the new MARS components.
    """
    d = SensorErrors(np.asarray(delta, dtype=np.float64))
    (g, dg), (a, da) = ((triad(errors), triad(d)) for triad in (gyro_triad, accel_triad))
    gyro, accel = (
        Triad(
            t.matrix @ dt.matrix,
            t.asymmetry + np.diag(t.matrix) * dt.asymmetry,
            t.bias + t.matrix @ dt.bias,
            both.further,
        )
        for t, dt, both in zip((g, a), (dg, da), triads(errors.vector + d.vector), strict=True)
    )
    return to_mars(gyro, accel)


def outside_model(errors: SensorErrors) -> str | None:
    """Reason why the sensor errors lie outside the model, or None.

    The model requires Mg positive definite, det Ma > 0, and singular values of both above 0.15.
    """
    return outside_models(errors.vector[None])[0]


def outside_models(vectors: Array) -> list[str | None]:
    """:func:`outside_model` of the sensor errors of several units, shape (units, 27)."""
    Mg, Ma = (triad.matrix for triad in triads(vectors))
    least = np.linalg.eigvalsh(Mg)[:, 0], np.linalg.det(Ma)
    smallest = [np.linalg.svd(M, compute_uv=False)[:, -1] for M in (Mg, Ma)]
    out: list[str | None] = [None] * len(vectors)
    for u in np.flatnonzero((np.minimum(*least) <= 0.0) | (np.minimum(*smallest) < MIN_SINGULAR_VALUE)).tolist():
        flat = 0 if smallest[0][u] < MIN_SINGULAR_VALUE else 1
        if least[0][u] <= 0.0:
            out[u] = "the gyro matrix is not positive definite (a flipped or swapped gyro axis?)"
        elif least[1][u] <= 0.0:
            out[u] = "the accelerometer triad has the opposite handedness to the gyros (a flipped or swapped axis?)"
        else:
            name = ("gyro", "accelerometer")[flat]
            out[u] = f"the {name} axes are nearly coplanar (smallest singular value {smallest[flat][u]:.3f})"
    return out
