"""Mean rates of the stationary windows, and the Earth rate in them.

The model of the mean rate in window w, in uncompensated sensor axes, is::

    rate_w = b + d t_w + Γ u_w + M (v u_w + x e_x,w + y e_y,w) + noise

b is the bias, d its change during the test (t runs from -1/2 to 1/2), Γ the g-sensitivity, and M the raw gyro matrix
from the rotations. (x, y, v) is the Earth rate in fixture base axes, along the unit vectors e_x, e_y and u (down),
which are given in table-mounted axes. A multiple of the identity in Γ has the same effect as v. Γ is therefore fitted
without its trace; the size of the other eight components limits how large the trace may be.

The noise is white noise plus flicker noise of the stated bias instability, which is correlated from window to window.
Its covariance weights the least-squares fit. Residuals above this noise enlarge all sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.triad_fits import LEAST_FREEDOM, MOST_OUTLIERS, OUTLIER
from srt.estimation.error_sources import raw_rate_variance
from srt.noise.bias_instability import flicker_covariance
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.preparation import nominal_attitude

if TYPE_CHECKING:
    from srt.diagnosis.triad_fits import LinearFit
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices

_RANK: Final = 1e-3
"""Smallest over largest singular value of the scaled design matrix, below which some component is not observable."""
_MOST_WINDOWS: Final = 400
"""Largest number of windows used, evenly spaced: the computing time grows with the third power of the number."""
_TRACELESS: Final = np.linalg.svd(np.eye(3).reshape(1, 9))[2][1:].reshape(8, 3, 3)
"""Orthonormal basis of the traceless matrices."""
BIAS, DRIFT, _G, _V, _H = np.split(np.arange(17), [3, 6, 14, 15])
"""Columns of the model; those of the horizontal Earth rate need known attitudes."""


@dataclass(frozen=True, slots=True, eq=False)
class StationaryRateFit:
    """Fitted components of the stationary rates, in rad/s and uncompensated sensor axes.

    Attributes
    ----------
    drift, drift_sigma : ndarray, shape (3,)
        Change of the bias from the first window to the last.
    g_sensitivity : ndarray, shape (3, 3)
        Γ without its trace, per g of downward gravity.
    vertical, vertical_sigma : float
        Rate about the downward vertical: sum of the vertical Earth rate and the effect of the trace of Γ. The sigma is
        that due to noise only.
    horizontal : ndarray, shape (2,), or None
        Earth rate along base x and y; None if the attitudes are not known.
    horizontal_sigma : float
        Standard deviation of each horizontal component.
    residual : ndarray, shape (W, 3)
        Rates of the windows less the model.
    freedom : int
        Degrees of freedom of the residuals.
    """

    drift: Array
    drift_sigma: Array
    g_sensitivity: Array
    vertical: float
    vertical_sigma: float
    horizontal: Array | None
    horizontal_sigma: float
    residual: Array
    freedom: int


@dataclass(frozen=True, slots=True, eq=False)
class StationaryRates:
    """Stationary rates and the design matrix of their model.

    Attributes
    ----------
    window : ndarray of int, shape (W,)
        Number of each window in the prepared data.
    start, end : ndarray, shape (W,), s
    rate : ndarray, shape (W, 3), rad/s
    columns : ndarray, shape (W, 3, 15 or 17)
        Columns of bias, drift, g-sensitivity and vertical rate; with known attitudes also of the horizontal Earth rate.
    covariance : ndarray, shape (3, W, W), (rad/s)²
        Covariance of the rates of each axis over the windows.
    flicker : ndarray, shape (W, W)
        Covariance of the means of flicker noise over the windows, for a bias instability of one.
    """

    window: Indices
    start: Array
    end: Array
    rate: Array
    columns: Array
    covariance: Array
    flicker: Array


def stationary_rates(data: PreparedRecording, gyro: LinearFit) -> StationaryRates | None:
    """Stationary rates of the windows; None if there are too few windows, or if a vertical cannot be measured."""
    recording, W = data.recording, len(data.windows.duration_s)
    chosen = np.unique(np.linspace(0, W - 1, min(W, _MOST_WINDOWS)).astype(int))
    rate = (data.windows.gyro_mean - data.noise.gyro_rounding)[chosen]
    force = data.windows.accel_mean[chosen]
    fixture = recording.fixture
    known = fixture is not None and gyro.rank == 3 and all(s is not None for s in data.catalogue)
    start = recording.time[data.windows.samples[chosen, 0]]
    end = start + data.windows.duration_s[chosen]
    middle = 0.5 * (start + end)
    span = float(np.ptp(middle))
    size = np.linalg.norm(force, axis=1, keepdims=True)
    columns = _H[-1] + 1 if known else _H[0]
    if span == 0.0 or rate.size - columns < LEAST_FREEDOM or not (known or np.all(size > 0.0)):
        return None
    X = np.zeros((*rate.shape, columns))
    X[:, :, BIAS] = np.eye(3)
    X[:, :, DRIFT] = np.eye(3) * ((middle - 0.5 * (middle.max() + middle.min())) / span)[:, None, None]
    if known:
        poses = _attitudes(data)[chosen]
        X[:, :, _G] = np.einsum("nij,wj->win", _TRACELESS, poses[:, 2])
        # Base axes in uncompensated sensor axes.
        turned = np.swapaxes(poses @ gyro.matrix.T, 1, 2)
        X[:, :, _V], X[:, :, _H] = turned[:, :, 2:], turned[:, :, :2]
    else:
        X[:, :, _V] = (-force / size)[:, :, None]
        X[:, :, _G] = np.einsum("nij,wj->win", _TRACELESS, -force / size)
    flicker = flicker_covariance(start, end)
    # Each pose differs from its nominal attitude, which rotates the Earth rate in sensor axes by the same angle. In
    # free rotations, only the vertical is measured, and the horizontal Earth rate is noise.
    doubt = fixture.rotation_sigma_rad if known and fixture is not None else 1.0
    white = raw_rate_variance(data.noise, end - start).T + (doubt * EARTH_RATE_RAD_S) ** 2
    covariance = (recording.noise.gyro_bias_instability or 0.0) ** 2 * flicker + white[:, :, None] * np.eye(len(rate))
    return StationaryRates(chosen, start, end, rate, X, np.asarray(covariance), flicker)


def _attitudes(data: PreparedRecording) -> Array:
    """Base axes in table-mounted axes at each window, shape (W, 3, 3): row i is base axis i (C_T,base transposed)."""
    out = np.empty((len(data.windows.duration_s), 3, 3))
    for k, sequence in enumerate(data.catalogue):
        assert sequence is not None
        nominal = nominal_attitude(sequence)
        out[data.start[k]], out[data.end[k]] = nominal, nominal @ end_attitude(sequence)
    return out


def whitened(covariance: Array, table: Array) -> Array:
    """Values (W, 3, ...) of windows and axes, whitened by the covariance (3, W, W) of each axis; (3 W, ...)."""
    roots = np.linalg.cholesky(covariance)
    flat = table.reshape(*table.shape[:2], -1)
    own = [solve_triangular(L, flat[:, axis], lower=True) for axis, L in enumerate(roots)]
    return np.concatenate(own).reshape(-1, *table.shape[2:])


def stationary_rate_fit(rates: StationaryRates, recording: Recording) -> StationaryRateFit | None:
    """Fit the stationary rates; None if their poses are too similar.

    A bias instability that is not stated is estimated as the flicker noise that explains the residuals.
    """
    freedom = rates.rate.size - rates.columns.shape[2]
    solved = _solve(rates, rates.covariance)
    if solved is None:
        return None
    if recording.noise.gyro_bias_instability is None:
        # Bisection of the logarithm of its square; the residuals are allowed chi-square of p = 0.975.
        level = float(np.trace(rates.covariance.mean(axis=0)) / np.trace(rates.flicker))
        low, high = np.log(level * 1e-4), np.log(level * 1e6)
        for _ in range(14):
            middle = 0.5 * (low + high)
            solved = _solve(rates, rates.covariance + np.exp(middle) * rates.flicker) or solved
            low, high = (low, middle) if solved[2] < limit("chi-square", freedom, shared=0.975) else (middle, high)
    value, P, chi_square = solved
    sigma = np.sqrt(np.diag(P) * max(1.0, chi_square / freedom))
    known = len(value) > _H[0]
    return StationaryRateFit(
        drift=value[DRIFT],
        drift_sigma=sigma[DRIFT],
        g_sensitivity=np.tensordot(value[_G], _TRACELESS, 1),
        vertical=float(value[_V[0]]),
        vertical_sigma=float(sigma[_V[0]]),
        horizontal=value[_H] if known else None,
        horizontal_sigma=float(np.sqrt(np.mean(sigma[_H] ** 2))) if known else np.inf,
        residual=rates.rate - rates.columns @ value,
        freedom=freedom,
    )


def _solve(rates: StationaryRates, covariance: Array) -> tuple[Array, Array, float] | None:
    """Weighted least squares: values, covariance and chi-square; None if some component is not observable.

    Outliers among the windows, for instance after a bump, get a negligible weight.
    """
    weak = np.zeros(len(rates.rate), dtype=np.bool_)
    while True:
        V = covariance + 1e8 * np.where(weak[:, None] & np.eye(len(weak), dtype=np.bool_), covariance, 0.0)
        A, y = whitened(V, rates.columns), whitened(V, rates.rate)
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
        if s[-1] < _RANK * s[0]:
            return None
        root = (Vt.T / s) / scale[:, None]
        value = root @ (U.T @ y)
        left = y - A @ value
        off = np.abs(left).reshape(3, -1).max(axis=0)
        outlier = off > OUTLIER * np.median(off)
        if weak.any() or not outlier.any() or outlier.mean() > MOST_OUTLIERS:
            return value, root @ root.T, float(left @ left)
        weak = outlier


class EarthRateFactor(NamedTuple):
    """Measured over true Earth rate at the stated latitude, its standard deviation, and chi-square of the residuals."""

    value: float
    sigma: float
    misfit: float


class EarthRate(NamedTuple):
    """Measured vertical and horizontal Earth rate, their standard deviations, and the values at the stated latitude.

    Each has shape (2,), rad/s.
    """

    found: Array
    sigma: Array
    true: Array


def earth_rate(fit: StationaryRateFit, recording: Recording) -> EarthRate | None:
    """Earth rate from the stationary rates; None if it is not observable.

    The sigmas include those of the alignment and, of the vertical component, the unknown trace of the g-sensitivity.
    The nine components of Γ are assumed to have the same standard deviation, which is estimated from the eight fitted
    components. The trace therefore has a t distribution with eight degrees of freedom. The factor converts its quantile
    at the false-alarm probability to that of a normal distribution.
    """
    site, fixture = recording.site, recording.fixture
    if site.latitude_rad is None or fixture is None or fit.horizontal is None:
        return None
    factor = limit("t", 8, both_sides=True) / limit("normal", both_sides=True)
    hidden = np.array([np.sum(fit.g_sensitivity**2) / 8.0 / 3.0, 0.0])
    sigma = np.array([fit.vertical_sigma, fit.horizontal_sigma])
    align = EARTH_RATE_RAD_S * fixture.alignment_sigma_rad
    true = EARTH_RATE_RAD_S * np.array([-np.sin(site.latitude_rad), np.cos(site.latitude_rad)])
    found = np.array([fit.vertical, float(np.hypot(*fit.horizontal))])
    return EarthRate(found, np.sqrt(sigma**2 + factor**2 * hidden + align**2), true)


def earth_rate_factor(earth: EarthRate) -> EarthRateFactor:
    """Factor on the Earth rate that fits the stationary rates at the stated latitude.

    A wrong sample rate multiplies both components by the same factor. A wrong latitude does not change the sum of their
    squares.
    """
    found, true = earth.found / earth.sigma, earth.true / earth.sigma
    information = float(true @ true)
    value = float(true @ found) / information
    left = found - value * true
    return EarthRateFactor(value, information**-0.5, float(left @ left))
