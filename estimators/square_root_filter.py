"""filterpy's extended Kalman filter with its covariance held as a square root.

A prior of a third of full scale against results of parts in a million spans twelve decades of variance, and a
noise-free recording nineteen: more than the covariance form has digits for (its sigmas came out wrong by parts in a
thousand, and an iteration that restarts from the prior never came to rest). The array form of Kaminski, Bryson and
Schmidt (1971), one orthogonal triangularisation for every step, needs half as many; ``x``, ``y``, ``K`` and ``S`` mean
what they mean in filterpy, and ``P`` is the square.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import solve_triangular

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.types import Array


class SquareRootFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """Extended Kalman filter whose covariance is ``root rootᵀ``.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Prior mean.
    root : ndarray, shape (n, n)
        Square root of the prior covariance.

    Attributes
    ----------
    root : ndarray, shape (n, n)
    whitened : ndarray, shape (m,)
        Innovations of the last update, normalised and decorrelated in their order.
    """

    def __init__(self, x: Array, root: Array) -> None:
        super().__init__(dim_x=len(x), dim_z=1)
        self.root = root
        self.x = x
        self.P = root @ root.T
        self.whitened = np.zeros(0)

    def grow(self, number: int) -> None:
        """Append states of mean zero and unit variance that have nothing to do with the others."""
        n = len(self.x)
        root = np.eye(n + number)
        root[:n, :n] = self.root
        self.x, self.root = np.append(self.x, np.zeros(number)), root
        self.P = root @ root.T

    def predict(self, u: Any = 0, *, F: Array | None = None, noise_root: Array | None = None) -> None:
        """Predict: ``x = F x + u``, with the process noise ``noise_root noise_rootᵀ``."""
        if F is not None:
            self.F = F
        self.x = self.F @ self.x + u
        wide = self.F @ self.root if noise_root is None else np.hstack([self.F @ self.root, noise_root])
        self.root = _lower(wide)
        self.P = self.root @ self.root.T
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(
        self,
        z: Array,
        HJacobian: Callable[[Array], Array],
        Hx: Callable[[Array], Array],
        R: Array | None = None,
        **_: Any,
    ) -> None:
        """Update with a measurement of m components; ``R`` is their covariance, default white of unit variance."""
        H = np.asarray(HJacobian(self.x))
        m, n = H.shape
        noise = np.eye(m) if R is None else np.linalg.cholesky(R)
        array = np.zeros((m + n, m + n))
        array[:m, :m], array[m:, :m], array[m:, m:] = noise.T, (H @ self.root).T, self.root.T
        lower = _lower(array.T)
        lower *= np.where(np.diag(lower) < 0.0, -1.0, 1.0)
        root_S, gain = lower[:m, :m], lower[m:, :m]
        self.z = np.asarray(z)
        self.y = self.z - np.asarray(Hx(self.x))
        self.whitened = solve_triangular(root_S, self.y, lower=True)
        self.x = self.x + gain @ self.whitened
        self.root = lower[m:, m:]
        self.P = self.root @ self.root.T
        self.S = root_S @ root_S.T
        self.SI = np.linalg.inv(self.S)
        self.K = solve_triangular(root_S, gain.T, lower=True, trans="T").T
        self.x_post, self.P_post = self.x.copy(), self.P.copy()
        self._log_likelihood = self._likelihood = self._mahalanobis = None


def _lower(wide: Array) -> Array:
    """Lower triangle L with ``L Lᵀ = wide wideᵀ``."""
    upper: Array = np.asarray(np.linalg.qr(wide.T, mode="r"))
    return upper.T
