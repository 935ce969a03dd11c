"""Least squares with non-negative unknowns: the variances of noise terms.

Scipy has this as ``scipy.optimize.nnls``, a ninth of the time, whose import takes a sixth of that of ``srt calibrate``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from srt.types import Array, Mask


def nonnegative_least_squares(A: Array, b: Array, signed: tuple[int, ...] = ()) -> Array:
    """Minimum of |A x − b| over x ≥ 0, by the active-set algorithm of Lawson and Hanson (1974, chapter 23).

    Parameters
    ----------
    A : ndarray, shape (m, n)
        Of full column rank for a unique solution; m ≥ n. The columns may differ in size, but none is zero.
    b : ndarray, shape (m,)
    signed : tuple of int
        Unknowns of either sign.

    Returns
    -------
    ndarray, shape (n,)
    """
    scale = np.linalg.norm(A, axis=0)
    return np.asarray(_minimum(A / scale, b, signed) / scale)


def many_nonnegative_least_squares(A: Array, b: Array) -> Array:
    """The same by scipy, for those who solve thousands."""
    from scipy.optimize import nnls

    scale = np.linalg.norm(A, axis=0)
    try:
        return np.asarray(nnls(A / scale, b, maxiter=100)[0] / scale, dtype=np.float64)
    except RuntimeError:  # rounding keeps it going round
        return nonnegative_least_squares(A, b)


def _minimum(A: Array, b: Array, signed: tuple[int, ...]) -> Array:
    """Minimum for columns of length one."""
    unbounded = np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], dtype=np.float64)
    bounded = np.ones(A.shape[1], dtype=bool)
    bounded[list(signed)] = False
    if np.all(unbounded[bounded] > 0.0):
        return unbounded
    # Rounding of a gradient that is zero: |b| times the unit roundoff and the number of terms of the sums.
    tolerance = max(A.shape) * np.finfo(np.float64).eps * np.linalg.norm(b)
    # Mostly the minimum is on the bounds that the unbounded solution is beyond; its gradients there prove it.
    free = (unbounded > 0.0) | ~bounded
    x = _on_bounds(A, b, free)
    if np.all(x[free & bounded] > 0.0) and np.all((A.T @ (b - A @ x))[~free] <= tolerance):
        return x
    free = ~bounded
    x = _on_bounds(A, b, free)
    while True:
        gain = np.where(free, -np.inf, A.T @ (b - A @ x) - tolerance)
        entering = int(np.argmax(gain))
        if not gain[entering] > 0.0:
            return x
        free[entering] = True
        while True:
            trial = _on_bounds(A, b, free)
            blocked = np.flatnonzero(free & bounded & (trial <= 0.0))
            if not blocked.size:
                break
            if entering in blocked and x[entering] == 0.0:
                return x  # the gain was rounding
            step = x[blocked] / np.maximum(x[blocked] - trial[blocked], np.finfo(np.float64).tiny)
            x = x + step.min() * (trial - x)
            x[bounded] = np.maximum(x[bounded], 0.0)
            leaving = blocked[np.argmin(step)]
            x[leaving], free[leaving] = 0.0, False
        x = trial


def _on_bounds(A: Array, b: Array, free: Mask) -> Array:
    """Minimum of |A x − b| over the free unknowns, with the others at zero."""
    x = np.zeros(A.shape[1])
    if free.any():
        x[free] = np.linalg.lstsq(A[:, free], b, rcond=None)[0]
    return x
