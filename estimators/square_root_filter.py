"""Adapter of filterpy's square-root Kalman filter to extended steps of varying size.

From a prior of a third of full scale to results of parts per million, the variance spans twelve decades, and nineteen
with a noise-free recording. The covariance form cannot represent this range: its sigmas had relative errors of 1e-3,
and an iteration that restarts from the prior did not converge. The square root spans half as many decades.
:class:`filterpy.kalman`'s ``SquareRootKalmanFilter`` predicts and updates by orthogonal triangularisation; this
adapter sets its inputs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from filterpy.kalman import SquareRootKalmanFilter
from scipy.linalg import solve_triangular

if TYPE_CHECKING:
    from srt.types import Array


class SquareRootFilter(SquareRootKalmanFilter):  # type: ignore[misc]
    """Square-root Kalman filter with the covariance ``root rootᵀ``.

    The attribute ``P_post`` of filterpy 2.0.0 returns the prior covariance; use ``P``.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Prior mean.
    root : ndarray, shape (n, n)
        Square root of the prior covariance.

    Attributes
    ----------
    whitened : ndarray, shape (m,)
        Innovations of the last update, normalised and decorrelated in their order.
    """

    def __init__(self, x: Array, root: Array) -> None:
        super().__init__(dim_x=len(x), dim_z=1)
        self.dim_x: int = len(x)
        self.x, self._P1_2 = np.array(x, dtype=float), np.array(root)
        self.B = 1.0  # inputs of predict() are in units of the state
        self.whitened = np.zeros(0)

    @property
    def root(self) -> Array:
        """Square root of the covariance, shape (n, n)."""
        return np.asarray(self.P1_2)

    def project(self, E: Array) -> Array:
        """Covariance ``E P Eᵀ`` of linear functions of the first states."""
        root = E @ self.root[: E.shape[1]]
        return np.asarray(root @ root.T)

    def propagate(self, F: Array, u: Array | float = 0.0, *, noise_root: Array | None = None) -> None:
        """Predict ``x = F x + u`` with the process noise ``noise_root noise_rootᵀ``, which may be singular."""
        self.F = F
        # The setter of Q computes a Cholesky factor, which does not exist for a singular Q.
        self._Q1_2 = np.zeros((self.dim_x, 0)) if noise_root is None else noise_root
        self.predict(u)

    def correct(self, z: Array, H: Array, *, noise_root: Array | None = None) -> None:
        """Update with the measurement ``z = H x + noise``, by default white with unit variance."""
        m, n = H.shape
        # filterpy inverts the innovations' root with pinv, which loses digits if the innovations are correlated. They
        # are uncorrelated along the principal axes U of the predicted measurement.
        U = np.linalg.svd(H @ self.root, full_matrices=m > n)[0]
        self.dim_z, self.H, self.M = m, U.T @ H, np.zeros((m + n, m + n))
        self.update(U.T @ z, U.T if noise_root is None else U.T @ noise_root)
        # Back to the axes of the measurement. Triangularisation does not define the signs of the columns.
        root: Array = np.asarray(np.linalg.qr(np.asarray(U @ self.S1_2).T, mode="r")).T
        self.S1_2: Array = root * np.where(np.diag(root) < 0.0, -1.0, 1.0)
        self.SI1_2 = solve_triangular(self.S1_2, np.eye(m), lower=True)
        self.z, self.H = z, H
        self.y: Array = U @ self.y
        self.K: Array = self.K @ U.T
        self.whitened = self.SI1_2 @ self.y
