"""Variance components: unmodelled errors estimated from the residuals by restricted maximum likelihood.

The covariance of the measurements is ``R = R0 + Σ v_i C_i``, with the known covariance R0 and one component C_i for
each unmodelled error, such as rotation and specific force per pose (non-linear scale factors, sampling of fast
rotations, motion in a pose). Fisher scoring of the restricted likelihood (Patterson and Thompson 1971) gives v_i ≥ 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from srt.noise.drift_forms import Statistics
    from srt.types import Array


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


def restricted_likelihood(z: Array, H: Array, R0: Array, components: tuple[Array, ...]) -> Array:
    """Variances v_i of the components.

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

    Returns
    -------
    ndarray, shape (number of components,)
        Variances, at least zero.
    """
    scale = 1.0 / np.sqrt(np.diag(R0))
    unit = H * scale[:, None]
    # The restricted likelihood is that of the contrasts, the combinations of measurements without the parameters.
    basis = np.linalg.qr(unit / np.linalg.norm(unit, axis=0), mode="complete")[0]
    contrasts = basis[:, H.shape[1] :] * scale[:, None]
    y, known = contrasts.T @ z, contrasts.T @ R0 @ contrasts
    parts = [contrasts.T @ C @ contrasts for C in components]
    # Initial values: the traces agree.
    square = float(np.sum((z * scale) ** 2)) / len(components)
    sizes = np.array([square / max(float(np.diag(C) @ scale**2), 1e-300) for C in components])
    effective = np.array([bool(np.any(C)) for C in components])
    sizes = np.where(effective, sizes, 0.0)
    for _ in range(_STEPS):
        P = np.linalg.inv(known + sum(v * C for v, C in zip(sizes, parts, strict=True)))
        PC = [P @ C for C in parts]
        Py = P @ y
        score = np.array([-0.5 * np.trace(A) + 0.5 * float(Py @ C @ Py) for A, C in zip(PC, parts, strict=True)])
        fisher = np.array([[0.5 * np.sum(A * B.T) for B in PC] for A in PC])
        # A component without effect on the residuals, as a rotation error in a test of poses alone, stays zero.
        free = ((sizes > 0.0) | (score > 0.0)) & effective
        if not free.any():
            break
        step = np.zeros(len(parts))
        step[free] = np.linalg.solve(fisher[np.ix_(free, free)], score[free])
        new = np.maximum(sizes + step, 0.0)
        done = np.all(np.abs(new - sizes) <= 1e-3 * np.maximum(new, 1e-12 * sizes.max()))
        sizes = new
        if done:
            break
    return sizes
