"""Variance components: unmodelled errors estimated from the residuals by restricted maximum likelihood.

The covariance of the measurements is ``R = R0 + Σ v_i C_i``, with the known covariance R0 and one component C_i for
each unmodelled error, such as rotation and specific force per pose (non-linear scale factors, sampling of fast
rotations, motion in a pose). Fisher scoring of the restricted likelihood (Patterson and Thompson 1971) gives v_i ≥ 0.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from srt.conditioning import has_inverse

if TYPE_CHECKING:
    from srt.noise.drift_forms import Statistics
    from srt.types import Array, Mask


_POINTS: Final = 2000
"""Points of the integral over a standard deviation."""
_STEPS: Final = 50
"""Largest number of scoring steps; convergence takes about ten."""


def expected_variance(shown: Statistics, used: float, measured: Array | tuple[float, float]) -> float:
    """Expected common variance of random effects, from what residuals show of them and from a measurement of it.

    The prior is uniform in the square root of the variance.

    Parameters
    ----------
    shown : Statistics
        Statistics of the effects for unit variance.
    used : float
        Variance that the weights include.
    measured : array_like, shape (2,)
        Another estimate of the variance, and its 1-sigma; infinite if there is none.
    """
    estimate, sigma = measured
    # The roots lie between a hundredth and a hundred times the size that both would barely show.
    size = np.sqrt(1.0 / np.sqrt(1.0 / sigma**2 + 0.5 * np.sum(shown.information**2)) + used)
    root = size * np.geomspace(1e-2, 1e2, _POINTS)
    log = 0.5 * (shown.likelihood_ratio(root**2 - used) - ((root**2 - estimate) / sigma) ** 2)
    weight = np.exp(log - log.max()) * root  # geometric spacing
    return float(weight @ root**2 / weight.sum())


class RestrictedLikelihood:
    """Restricted likelihood of variance components.

    Parameters
    ----------
    z : ndarray, shape (n,)
        Residuals at the solution.
    H : ndarray, shape (n, p)
        Jacobian with respect to the estimated parameters.
    R0 : ndarray, shape (n, n)
        Known covariance.
    roots : tuple of ndarray, shapes (n, any)
        Root L of the covariance L Lᵀ of each component for unit variance.
    """

    def __init__(self, z: Array, H: Array, R0: Array, roots: tuple[Array, ...]) -> None:
        scale = 1.0 / np.sqrt(np.diag(R0))
        unit = H * scale[:, None]
        # The restricted likelihood is that of the contrasts, the combinations of measurements without the parameters.
        basis = np.linalg.qr(unit / np.linalg.norm(unit, axis=0), mode="complete")[0]
        contrasts = basis[:, H.shape[1] :] * scale[:, None]
        # In units of the known noise, whose covariance then is the identity.
        white = np.linalg.cholesky(contrasts.T @ R0 @ contrasts)
        whitened = [solve_triangular(white, contrasts.T @ values, lower=True) for values in (z, *roots)]
        self._set(whitened[0], whitened[1:])
        self._square = float(np.sum((z * scale) ** 2))
        self._traces = [float(np.sum((scale[:, None] * L) ** 2)) for L in roots]

    @property
    def separable(self) -> bool:
        """True if the residuals can tell all components apart: one contrast shows only the sum of three."""
        return bool(has_inverse(np.array([[np.sum((A.T @ B) ** 2) for B in self._roots] for A in self._roots])))

    def variances(self, used: Mask | None = None) -> Array:
        """Variances of the components, at least zero; of those not in ``used`` zero, shape (number of components,)."""
        used = np.ones(len(self._roots), dtype=np.bool_) if used is None else used
        # Initial values: the traces agree.
        square = self._square / max(int(used.sum()), 1)
        effective = used & [bool(np.any(L)) for L in self._roots]
        sizes = np.where(effective, [square / max(trace, 1e-300) for trace in self._traces], 0.0)
        if not effective.any():
            return sizes
        shown = self._shown_by(effective)
        L = np.hstack(shown._roots)
        starts = np.cumsum([0, *(part.shape[1] for part in shown._roots if part.size)])[:-1]
        for _ in range(_STEPS):
            # The inverse and a product take a fifth of the time of a solution with as many right-hand sides.
            LP = L.T @ np.linalg.inv(shown._covariance(sizes))
            LPL, LPy = LP @ L, LP @ shown._y
            score, fisher = np.zeros(len(sizes)), np.zeros((len(sizes), len(sizes)))
            score[effective] = 0.5 * np.add.reduceat(LPy**2 - np.diag(LPL), starts)
            sums = np.add.reduceat(np.add.reduceat(LPL**2, starts, axis=0), starts, axis=1)
            fisher[np.ix_(effective, effective)] = 0.5 * sums
            # A component without effect on the residuals, as a rotation error in a test of poses alone, stays zero.
            free = ((sizes > 0.0) | (score > 0.0)) & effective
            if not free.any():
                break
            step = np.zeros(len(sizes))
            step[free] = np.linalg.solve(fisher[np.ix_(free, free)], score[free])
            new = np.maximum(sizes + step, 0.0)
            done = np.all(np.abs(new - sizes) <= 1e-3 * np.maximum(new, 1e-12 * sizes.max()))
            sizes = new
            if done:
                break
        return sizes

    def _shown_by(self, used: Mask) -> Self:
        """Likelihood of the combinations of contrasts that have an effect of these components; others have none."""
        shown = copy(self)
        roots = [L if u else L[:, :0] for L, u in zip(self._roots, used, strict=True)]
        L = np.hstack(roots)
        if L.shape[1] < len(L):
            basis = np.linalg.qr(L)[0]
            shown._set(basis.T @ self._y, [basis.T @ part for part in roots])
        else:
            shown._set(self._y, roots)
        return shown

    def _set(self, y: Array, roots: list[Array]) -> None:
        """Contrasts in units of the known noise, and the roots and covariances of the components in them."""
        self._y, self._roots, self._parts = y, roots, [L @ L.T for L in roots]

    def significant(self, used: Mask, tested: Mask, probability: float) -> tuple[Mask, Array]:
        """Components ``used`` without those of ``tested`` that the residuals do not show, and their variances.

        One after the other the least significant component is left out, while its likelihood ratio is that of no
        component with more than ``probability``. A variance at its bound has half the probability of a chi-square.
        """
        limit = 0.5 * float(chdtri(1, 2.0 * probability))
        shown = self._shown_by(used)
        sizes = shown.variances(used)
        while True:
            # Without a component whose variance is zero, the likelihood is the same.
            kept, own = used & ~(tested & (sizes == 0.0)), shown.logarithm(sizes)
            without = {i: kept & (np.arange(len(kept)) != i) for i in np.flatnonzero(kept & tested).tolist()}
            found = {i: shown.variances(others) for i, others in without.items()}
            loss = {i: own - shown.logarithm(variances) for i, variances in found.items()}
            least = min(loss, key=lambda i: round(loss[i], 6), default=None)
            if least is None or loss[least] > limit:
                return kept, sizes if np.array_equal(kept, used) else shown.variances(kept)
            used, sizes = without[least], found[least]

    def logarithm(self, variances: Array) -> float:
        """Logarithm of the likelihood, up to a constant."""
        # Components of a gross error, far above the known noise, are positive definite up to rounding alone.
        R = self._covariance(variances)
        return -0.5 * float(np.linalg.slogdet(R)[1] + self._y @ np.linalg.solve(R, self._y))

    def _covariance(self, variances: Array) -> Array:
        return np.asarray(np.eye(len(self._y)) + sum(v * C for v, C in zip(variances, self._parts, strict=True)))
