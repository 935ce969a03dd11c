"""Residuals of measurements in units of their noise, of one unit or of many, and their tests.

With ``M = R⁻¹ − R⁻¹ H (Hᵀ R⁻¹ H)⁻¹ Hᵀ R⁻¹``, chi-square of all residuals is ``zᵀ M z``. Without the rows D of a group
it is smaller by ``(M z)_Dᵀ (M_DD)⁻¹ (M z)_D``: the squared difference between D and its prediction by the others, in
units of sigma. Only D determines the directions in which M_DD vanishes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg.lapack import dtrtri

from srt.noise.drift_forms import Statistics

if TYPE_CHECKING:
    from srt.types import Array, Counts, Indices, Mask

_DEPENDENT: Final = 1e-10
"""Part of a derivative, over its length, that those before it leave, below which it depends on them."""
LEAST_PREDICTED_SHARE: Final = 1e-4
"""Share of a measurement's variance in the residual, below which the others do not check this measurement: their
prediction is then less accurate by a factor of 100."""


@dataclass(frozen=True, slots=True, eq=False)
class WhiteResiduals:
    """Residuals of measurements in units of their noise; arrays of several units have a leading axis of units.

    Attributes
    ----------
    whitener : ndarray, shape (..., n, n)
        L⁻¹ of the covariance R = L Lᵀ.
    basis : ndarray, shape (..., n, min(n, p))
        Orthonormal basis of the whitened derivatives; its last columns are zero where parameters depend on others.
    triangle : ndarray, shape (..., min(n, p), p)
        Whitened derivatives, in units of their lengths, in that basis if no parameter depends on others.
    length : ndarray, shape (..., p)
        Lengths of the whitened derivatives.
    value : ndarray, shape (..., n)
        Residuals r for the best parameters.
    """

    whitener: Array
    basis: Array
    triangle: Array
    length: Array
    value: Array

    @classmethod
    def of(cls, z: Array, H: Array, R: Array) -> WhiteResiduals:
        """Residuals for the parameters that fit best.

        Parameters
        ----------
        z : ndarray, shape (..., n)
        H : ndarray, shape (..., n, p)
            Derivative with respect to the estimated parameters.
        R : ndarray, shape (..., n, n)
            Covariance of z.

        Raises
        ------
        numpy.linalg.LinAlgError
            If a covariance is not positive definite, as far outside the model.
        """
        with np.errstate(all="ignore"):
            scale = 1.0 / np.sqrt(np.einsum("...ii->...i", R))
            # Without noise R may be singular; the variance of its rounding errors makes it regular.
            rounding = R.shape[-1] * np.finfo(np.float64).eps * np.eye(R.shape[-1])
            L = np.linalg.cholesky(R * (scale[..., :, None] * scale[..., None, :]) + rounding)
        # Rows of the lower triangles are columns of upper ones, as LAPACK stores them.
        inverse = np.array([dtrtri(L[u].T)[0].T for u in np.ndindex(L.shape[:-2]) if L.size]).reshape(L.shape)
        whitener = inverse * scale[..., None, :]
        white = whitener @ np.concatenate([z[..., None], H], axis=-1)
        own, slope = white[..., :1], white[..., 1:]
        length = np.linalg.norm(slope, axis=-2)
        unit = slope / np.where(length > 0.0, length, 1.0)[..., None, :]
        Q, T = np.linalg.qr(unit)
        dependent = np.abs(np.diagonal(T, axis1=-2, axis2=-1)) <= _DEPENDENT
        for u in map(tuple, np.argwhere(dependent.any(axis=-1))):
            # The columns after a dependent one may have a part along its column of Q, which is arbitrary.
            whole = np.linalg.qr(np.delete(unit[u], np.flatnonzero(dependent[u]), axis=1))[0]
            Q[u] = 0.0
            Q[u][:, : whole.shape[1]] = whole
        left = own - Q @ (np.swapaxes(Q, -1, -2) @ own)
        return cls(whitener, Q, T, length, left[..., 0])

    def of_unit(self, u: int) -> WhiteResiduals:
        """Residuals of one of several units."""
        return WhiteResiduals(self.whitener[u], self.basis[u], self.triangle[u], self.length[u], self.value[u])

    @property
    def chi_square(self) -> Array:
        """Smallest weighted square sum of residuals over all values of the parameters, shape (...)."""
        return np.asarray(np.sum(self.value**2, axis=-1))

    @property
    def freedom(self) -> Counts:
        """Degrees of freedom of the residuals, shape (...)."""
        return np.asarray(self.value.shape[-1] - np.count_nonzero(self.basis.any(axis=-2), axis=-1))

    @property
    def test(self) -> tuple[float, int]:
        """Chi-square and degrees of freedom of a single unit."""
        return float(self.chi_square), int(self.freedom)

    @property
    def projector(self) -> Array:
        """Whitened residuals by the measurements, shape (..., n, n); its square is M in Mz = Mᵀ r."""
        return self.left(np.eye(self.value.shape[-1]))

    def left(self, effect: Array) -> Array:
        """Part of effects (..., n, q) on the measurements that residuals show, whitened."""
        white = self.whitener @ effect
        return np.asarray(white - self.basis @ (np.swapaxes(self.basis, -1, -2) @ white))

    def statistics(self, effect: Array) -> Statistics:
        """Statistics of a single unit for coefficients with an effect (n, q) on the measurements."""
        Z = self.left(effect)
        return Statistics(Z.T @ self.value, Z.T @ Z, *self.test)

    def statistics_by_unit(self, effects: Array) -> list[Statistics]:
        """The same of each of several units, with effects (units, n, q)."""
        Z = self.left(effects)
        products = np.swapaxes(Z, -1, -2) @ np.concatenate([self.value[..., None], Z], axis=-1)
        tests = zip(self.chi_square.tolist(), self.freedom.tolist(), strict=True)
        return [Statistics(own[:, 0], own[:, 1:], *test) for own, test in zip(products, tests, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class PredictedGroups:
    """Groups of d measurements against their prediction by all others.

    Attributes
    ----------
    chi_square : ndarray, shape (..., groups)
    freedom : ndarray of int, shape (..., groups)
        Number of directions that the other measurements predict.
    predicted : ndarray of bool, shape (..., groups, d)
    directions : ndarray, shape (..., groups, d, d)
        Columns, in the units of the measurements.
    """

    chi_square: Array
    freedom: Counts
    predicted: Mask
    directions: Array

    @classmethod
    def of(cls, residuals: WhiteResiduals, R: Array, rows: Indices) -> PredictedGroups:
        """Test groups of measurements, rows (groups, d), of covariance R (..., n, n)."""
        left = residuals.projector
        Mz = np.einsum("...ij,...i->...j", left, residuals.value)
        own = np.linalg.cholesky(R[..., rows[:, :, None], rows[:, None, :]])
        columns = np.moveaxis(left[..., rows], -3, -2) @ own
        values, vectors = np.linalg.eigh(np.swapaxes(columns, -1, -2) @ columns)
        directions = own @ vectors
        u = np.einsum("...di,...d->...i", directions, Mz[..., rows])
        seen = values > LEAST_PREDICTED_SHARE
        chi_square = np.sum(np.where(seen, u**2 / np.where(seen, values, 1.0), 0.0), axis=-1)
        return cls(chi_square, np.count_nonzero(seen, axis=-1), seen, directions)
