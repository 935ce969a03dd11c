"""Variance components: unmodelled errors estimated from the residuals by restricted maximum likelihood.

The covariance of the measurements is ``R = R0 + Σ v_i C_i``, with the known covariance R0 and one component C_i for
each unmodelled error, such as rotation and specific force per pose (non-linear scale factors, sampling of fast
rotations, motion in a pose). Fisher scoring of the restricted likelihood (Patterson and Thompson 1971) gives v_i ≥ 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
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
    components : tuple of ndarray, shape (n, n)
        Covariance of each component for unit variance.
    """

    def __init__(self, z: Array, H: Array, R0: Array, components: tuple[Array, ...]) -> None:
        scale = 1.0 / np.sqrt(np.diag(R0))
        unit = H * scale[:, None]
        # The restricted likelihood is that of the contrasts, the combinations of measurements without the parameters.
        basis = np.linalg.qr(unit / np.linalg.norm(unit, axis=0), mode="complete")[0]
        contrasts = basis[:, H.shape[1] :] * scale[:, None]
        self._y, self._known = contrasts.T @ z, contrasts.T @ R0 @ contrasts
        self._parts = [contrasts.T @ C @ contrasts for C in components]
        self._square = float(np.sum((z * scale) ** 2))
        self._traces = [float(np.diag(C) @ scale**2) for C in components]

    @property
    def separable(self) -> bool:
        """True if the residuals can tell all components apart: one contrast shows only the sum of three."""
        P = np.linalg.inv(self._known)
        weighted = [P @ C for C in self._parts]
        return bool(has_inverse(np.array([[np.sum(A * B.T) for B in weighted] for A in weighted])))

    def variances(self, used: Mask | None = None) -> Array:
        """Variances of the components, at least zero; of those not in ``used`` zero, shape (number of components,)."""
        effective = np.array([bool(np.any(C)) for C in self._parts])
        used = np.ones(len(self._parts), dtype=np.bool_) if used is None else used
        # Initial values: the traces agree.
        square = self._square / max(int(used.sum()), 1)
        sizes = np.array([square / max(trace, 1e-300) for trace in self._traces])
        effective &= used
        sizes = np.where(effective, sizes, 0.0)
        for _ in range(_STEPS):
            P = np.linalg.inv(self._covariance(sizes))
            PC = [P @ C for C in self._parts]
            Py = P @ self._y
            score = np.array(
                [-0.5 * np.trace(A) + 0.5 * float(Py @ C @ Py) for A, C in zip(PC, self._parts, strict=True)]
            )
            fisher = np.array([[0.5 * np.sum(A * B.T) for B in PC] for A in PC])
            # A component without effect on the residuals, as a rotation error in a test of poses alone, stays zero.
            free = ((sizes > 0.0) | (score > 0.0)) & effective
            if not free.any():
                break
            step = np.zeros(len(self._parts))
            step[free] = np.linalg.solve(fisher[np.ix_(free, free)], score[free])
            new = np.maximum(sizes + step, 0.0)
            done = np.all(np.abs(new - sizes) <= 1e-3 * np.maximum(new, 1e-12 * sizes.max()))
            sizes = new
            if done:
                break
        return sizes

    def significant(self, used: Mask, tested: Mask, probability: float) -> Mask:
        """Components ``used`` without those of ``tested`` that the residuals do not show, shape as both.

        One after the other the least significant component is left out, while its likelihood ratio is that of no
        component with more than ``probability``. A variance at its bound has half the probability of a chi-square.
        """
        limit = 0.5 * float(chdtri(1, 2.0 * probability))
        while (used & tested).any():
            own = self.logarithm(self.variances(used))
            without = {i: used & (np.arange(len(used)) != i) for i in np.flatnonzero(used & tested).tolist()}
            loss = {i: own - self.logarithm(self.variances(others)) for i, others in without.items()}
            least = min(loss, key=lambda i: round(loss[i], 6))  # components without effect lose rounding errors
            if loss[least] > limit:
                break
            used = without[least]
        return used

    def logarithm(self, variances: Array) -> float:
        """Logarithm of the likelihood, up to a constant."""
        # Components of a gross error, far above the known noise, are positive definite up to rounding alone.
        R = self._covariance(variances)
        return -0.5 * float(np.linalg.slogdet(R)[1] + self._y @ np.linalg.solve(R, self._y))

    def _covariance(self, variances: Array) -> Array:
        return np.asarray(self._known + sum(v * C for v, C in zip(variances, self._parts, strict=True)))
