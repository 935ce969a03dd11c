"""The terms of an Allan variance, each with its own slope, and their fit to the variances of the octaves.

The variance of averages over τ is the sum of::

    3 q²/τ²   q = ε/√12, pulses ε of the integral (or other white errors of its readings)
    N²/τ      random walk of the integral
    B²        bias instability: the flat part, which is what data sheets quote
    K² τ/3    random walk of the bias

The fit is the likeliest one for chi-square variates. A term stays only if the fit is much worse without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri

from srt.constants import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, HOUR_S, MICRO_G

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

CONFIDENCE: Final = 0.95
"""Of all intervals."""


@dataclass(frozen=True, slots=True)
class Term:
    """One term of the Allan variance, ``coefficient² · factor · τ^exponent``.

    Attributes
    ----------
    name, title : str
    factor, exponent : float
    alpha : int
        Exponent of the power spectral density of such noise in the rate.
    keys : (str, str)
        Names of the figure for gyros and accelerometers, with the unit.
    units : (str, str)
        What tables show.
    scales : (float, float)
        SI per unit.
    """

    name: str
    title: str
    factor: float
    exponent: float
    alpha: int
    keys: tuple[str, str]
    units: tuple[str, str]
    scales: tuple[float, float]


TERMS: Final = (
    Term(
        "quantization", "quantization", 0.25, -2.0, 2,
        ("gyro_quantization_arcsec", "accel_quantization_m_s"),
        ("″", "m/s"), (ARCSEC, 1.0),
    ),
    Term(
        "random_walk", "random walk", 1.0, -1.0, 0,
        ("gyro_noise_deg_per_sqrt_h", "accel_noise_ug_per_sqrt_hz"),
        ("°/√h", "µg/√Hz"), (DEG_PER_SQRT_H, MICRO_G),
    ),
    Term(
        "bias_instability", "bias instability", 1.0, 0.0, -1,
        ("gyro_bias_instability_deg_per_h", "accel_bias_instability_ug"),
        ("°/h", "µg"), (DEG_PER_H, MICRO_G),
    ),
    Term(
        "bias_random_walk", "bias random walk", 1.0 / 3.0, 1.0, -2,
        ("gyro_bias_random_walk_deg_per_h_per_sqrt_h", "accel_bias_random_walk_ug_per_sqrt_h"),
        ("°/h/√h", "µg/√h"), (DEG_PER_H / HOUR_S**0.5, MICRO_G / HOUR_S**0.5),
    ),
)  # fmt: skip
"""Their figures carry the names that the section [imu] of ``recording.toml`` has for them."""

PULSES, RANDOM_WALK, FLAT = 0, 1, 2
"""Places in :data:`TERMS`."""

_SHARED: Final = 0.5
"""The degrees of freedom of all octaves of overlapping averages add up to twice the number of samples, as neighbouring
octaves see the same noise; what a fit may count is that number."""
_MODEL_DOUBT: Final = 0.03
"""No sensor keeps to the four slopes more closely than that: samples without end shall not find terms in the rest."""
_PULSE_DOUBT: Final = 0.5
"""Pulses of a slow input are no white sequence (a saw-tooth has lines): octaves that they rule deviate by so much."""
_DROP: Final = 9.55
"""Loss of twice the logarithm of the likelihood up to which a term is left out: one in a thousand is kept by chance."""
_PASSES: Final = 60


def design_matrix(tau: Array) -> Array:
    """Variance of every term at coefficient 1, shape (m, 4), for averaging times of shape (m,), s."""
    return np.stack([term.factor * tau**term.exponent for term in TERMS], axis=1)


def interval(variance: Array, freedom: Array) -> tuple[Array, Array]:
    """Limits of the root of a variance known from chi-square variates; NaN where it is zero.

    Parameters
    ----------
    variance, freedom : ndarray
        Of one shape; degrees of freedom that are not finite give no limits.
    """
    tail = 0.5 * (1.0 - CONFIDENCE)
    known = np.where((variance > 0.0) & np.isfinite(freedom), variance, np.nan)
    nu = np.where(np.isfinite(freedom), freedom, 1.0)
    low, high = np.sqrt(known * nu / chdtri(nu, tail)), np.sqrt(known * nu / chdtri(nu, 1.0 - tail))
    return low, high


def fit_terms(design: Array, variance: Array, freedom: Array) -> tuple[Array, Array]:
    """Fit the terms that are needed.

    Random walk is never left out: every sensor has it, if only too little of it to be told from pulses.

    Parameters
    ----------
    design : ndarray, shape (m, 4)
        From :func:`design_matrix`.
    variance, freedom : ndarray, shape (m,)
        Allan variances, positive, and their equivalent degrees of freedom.

    Returns
    -------
    squares : ndarray, shape (4,)
        Squared coefficients, zero for what is not needed.
    doubt : ndarray, shape (4,)
        Their relative standard deviations.
    """
    k = design.shape[1]
    kept = np.arange(k)
    solution, loss = _likeliest(design, variance, freedom, kept)
    while True:
        kept = np.flatnonzero(solution > 0.0)
        leaving = [i for i, t in enumerate(kept.tolist()) if t != RANDOM_WALK]
        if not leaving or len(kept) == 1:
            break
        trials = [_likeliest(design, variance, freedom, np.delete(kept, i)) for i in leaving]
        best = int(np.argmin([trial[1] for trial in trials]))
        # The loss to compare with stays that of all terms: small steps shall not add up.
        if trials[best][1] - loss > _DROP:
            break
        solution = trials[best][0]
    doubt = np.full(k, np.inf)
    kept = np.flatnonzero(solution > 0.0)
    weighted = design[:, kept] / _sigma(design, solution, freedom)[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    covariance = np.linalg.inv((weighted / scale).T @ (weighted / scale))
    doubt[kept] = np.sqrt(np.diag(covariance)) / scale / solution[kept]
    return solution, doubt


def _likeliest(design: Array, variance: Array, freedom: Array, kept: NDArray[np.intp]) -> tuple[Array, float]:
    """Coefficients by iterated weighted least squares, weighted by the model as the likelihood is; and the loss."""
    solution = np.zeros(design.shape[1])
    sigma = variance * np.hypot(np.sqrt(2.0 / (_SHARED * freedom)), _MODEL_DOUBT)
    for _ in range(_PASSES):
        weighted = design[:, kept] / sigma[:, None]
        scale = np.linalg.norm(weighted, axis=0)
        new = np.zeros_like(solution)
        new[kept] = nnls(weighted / scale, variance / sigma)[0] / scale
        if np.allclose(new, solution, rtol=1e-6, atol=0.0):
            break
        solution = new
        sigma = _sigma(design, solution, freedom)
    ratio = variance / (design @ solution)
    effective = 2.0 * ((design @ solution) / sigma) ** 2
    return solution, float(np.sum(effective * (ratio - 1.0 - np.log(ratio))))


def _sigma(design: Array, solution: Array, freedom: Array) -> Array:
    """One sigma of every variance by the model."""
    model = design @ solution
    chance = np.hypot(np.sqrt(2.0 / (_SHARED * freedom)), _MODEL_DOUBT)
    out: Array = np.hypot(model * chance, _PULSE_DOUBT * design[:, PULSES] * solution[PULSES])
    return out
