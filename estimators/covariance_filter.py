"""Adapter of filterpy's Kalman filter in covariance form, for comparison with the square-root form.

The covariance form is unchanged: prediction and Joseph update are those of filterpy, and the covariance is not
symmetrised. Loss of positive definiteness is reported.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_triangular

if TYPE_CHECKING:
    from srt.types import Array


class CovarianceFilter(KalmanFilter):  # type: ignore[misc]
    """Kalman filter with the interface of :class:`estimators.square_root_filter.SquareRootFilter`.

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
        self.x, self.P = np.array(x, dtype=float), root @ root.T
        self.whitened = np.zeros(0)

    def project(self, E: Array) -> Array:
        """Covariance ``E P Eᵀ`` of linear functions of the first states.

        Raises
        ------
        numpy.linalg.LinAlgError
            If a variance is negative or not finite.
        """
        n = E.shape[1]
        P = E @ self.P[:n, :n] @ E.T
        if not np.all(np.diag(P) >= 0.0):
            raise np.linalg.LinAlgError("the covariance form lost positive definiteness")
        return np.asarray(P)

    def propagate(self, F: Array, u: Array | float = 0.0, *, noise_root: Array | None = None) -> None:
        """Predict ``x = F x + u`` with the process noise ``noise_root noise_rootᵀ``."""
        n = len(self.x)
        self.predict(
            u=np.broadcast_to(u, n), B=np.eye(n), F=F, Q=0.0 if noise_root is None else noise_root @ noise_root.T
        )

    def correct(self, z: Array, H: Array, *, noise_root: Array | None = None) -> None:
        """Update with the measurement ``z = H x + noise``, by default white with unit variance.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the covariance of the innovations is not positive definite.
        """
        m = len(z)
        self.update(z, np.eye(m) if noise_root is None else noise_root @ noise_root.T, H)
        try:
            root = np.linalg.cholesky(self.S)
        except np.linalg.LinAlgError:
            raise np.linalg.LinAlgError("the covariance form lost positive definiteness") from None
        self.whitened = solve_triangular(root, self.y, lower=True)
