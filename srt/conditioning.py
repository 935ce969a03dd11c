"""Judgement of matrices by their condition: an exactly zero pivot appears on one processor and not on another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from srt.types import Array, Mask

_ROUNDING: Final = float(np.finfo(np.float64).eps)


def has_inverse(A: Array) -> Mask:
    """True for matrices (..., n, n) whose inverse is more than rounding errors, shape (...).

    The reciprocal condition, with columns and then rows of length one, is compared with n times the unit roundoff.
    """
    with np.errstate(all="ignore"):
        unit = A / np.linalg.norm(A, axis=-2, keepdims=True)
        unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
    finite = np.asarray(np.isfinite(unit).all(axis=(-2, -1)))
    size = np.linalg.svd(np.where(finite[..., None, None], unit, 0.0), compute_uv=False)
    return np.asarray(size[..., -1] > A.shape[-1] * _ROUNDING * size[..., 0])


def scaled_root(R: Array) -> tuple[Array, Array]:
    """Lower triangular root L and scale s of covariances R (..., n, n): s R s = L Lᵀ has a unit diagonal.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is not positive definite beyond rounding errors.
    """
    with np.errstate(all="ignore"):
        scale = 1.0 / np.sqrt(np.einsum("...ii->...i", R))
        L = np.asarray(np.linalg.cholesky(R * (scale[..., :, None] * scale[..., None, :])), dtype=np.float64)
    if not np.all(np.einsum("...ii->...i", L) ** 2 > R.shape[-1] * _ROUNDING):
        raise np.linalg.LinAlgError("a covariance is singular to rounding")
    return L, scale
