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
from srt.diagnosis.triad_fits import MOST_OUTLIERS, OUTLIER
from srt.estimation.error_sources import raw_rate_variance
from srt.noise.bias_instability import flicker_covariance
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.preparation import nominal_attitude

if TYPE_CHECKING:
    from srt.diagnosis.triad_fits import LinearFit
    from srt.recording.recording import Fixture, Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices

LEAST_FREEDOM: Final = 12
"""Fewest degrees of freedom for an estimate of the scatter."""
_RANK: Final = 1e-3
"""Smallest over largest singular value of the scaled design matrix, below which some component is not observable."""
_MOST_WINDOWS: Final = 400
"""Largest number of windows used, evenly spaced: the computing time grows with the third power of the number."""


def _traceless() -> Array:
    """Orthonormal basis of the traceless 3x3 matrices, shape (8, 3, 3)."""
    pairs = [(i, j) for i in range(3) for j in range(3) if i != j]
    basis = np.zeros((8, 3, 3))
    for n, (i, j) in enumerate(pairs):
        basis[n, i, j] = 1.0
    basis[6] = np.diag([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    basis[7] = np.diag([1.0, 1.0, -2.0]) / np.sqrt(6.0)
    return basis


_BASIS: Final = _traceless()
_H_COLUMNS: Final = 17
"""Number of columns if the horizontal Earth rate is fitted."""
BIAS, DRIFT, _G, _V, _H = slice(0, 3), slice(3, 6), slice(6, 14), 14, slice(15, 17)


@dataclass(frozen=True, slots=True, eq=False)
class StationaryRateFit:
    """Fitted components of the stationary rates, in rad/s and uncompensated sensor axes.

    Attributes
    ----------
    drift, drift_sigma : ndarray, shape (3,)
        Change of the bias from the first window to the last.
    g_sensitivity : ndarray, shape (8,)
        Components of the traceless part of Γ in an orthonormal basis.
    g_sensitivity_sigma : ndarray, shape (8,)
    vertical, vertical_sigma : float
        Rate about the downward vertical: sum of the vertical Earth rate and the effect of the trace of Γ. The sigma is
        that due to noise only.
    horizontal : ndarray, shape (2,), or None
        Earth rate along base x and y; None if the attitudes are not known.
    horizontal_sigma : float
        Standard deviation of each horizontal component.
    freedom : int
        Degrees of freedom of the residuals.
    """

    drift: Array
    drift_sigma: Array
    g_sensitivity: Array
    g_sensitivity_sigma: Array
    vertical: float
    vertical_sigma: float
    horizontal: Array | None
    horizontal_sigma: float
    freedom: int

    def gamma(self, earth_vertical: float) -> Array:
        """Γ for a known vertical Earth rate, shape (3, 3), in rad/s per g of downward gravity."""
        matrix: Array = np.tensordot(self.g_sensitivity, _BASIS, 1) + (self.vertical - earth_vertical) * np.eye(3)
        return matrix


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

    @property
    def known(self) -> bool:
        """True if the attitudes are known."""
        return bool(self.columns.shape[2] == _H_COLUMNS)


def stationary_rates(data: PreparedRecording, gyro: LinearFit) -> StationaryRates | None:
    """Stationary rates of the windows; None if there are too few windows, or if a vertical cannot be measured."""
    W = len(data.windows.duration_s)
    chosen = np.unique(np.linspace(0, W - 1, min(W, _MOST_WINDOWS)).astype(int))
    rate, force = (data.windows.gyro_mean - data.noise.gyro_rounding)[chosen], data.windows.accel_mean[chosen]
    poses = _poses(data)
    known = poses is not None and gyro.rank == 3
    if known:
        assert poses is not None
        poses = poses[chosen]
        turned = poses @ gyro.matrix.T  # rows: base axes in uncompensated sensor axes
        down = poses[:, 2]
    else:
        # Free rotations: the vertical is measured, and the horizontal Earth rate is treated as noise.
        size = np.linalg.norm(force, axis=1, keepdims=True)
        if np.any(size == 0.0):
            return None
        down = -force / size
    start = data.recording.time[data.windows.samples[chosen, 0]]
    end = start + data.windows.duration_s[chosen]
    middle = 0.5 * (start + end)
    span = float(middle.max() - middle.min())
    columns = _H_COLUMNS if known else _H_COLUMNS - 2
    freedom = rate.size - columns
    if span == 0.0 or freedom < LEAST_FREEDOM:
        return None
    X = np.zeros((*rate.shape, columns))
    X[:, :, BIAS] = np.eye(3)
    X[:, :, DRIFT] = np.eye(3) * ((middle - 0.5 * (middle.max() + middle.min())) / span)[:, None, None]
    X[:, :, _G] = np.einsum("nij,wj->win", _BASIS, down)
    X[:, :, _V] = turned[:, 2] if known else down
    if known:
        X[:, :, _H] = np.swapaxes(turned[:, :2], 1, 2)
    flicker = flicker_covariance(start, end)
    covariance = _covariance(data, end - start, flicker, known=known)
    return StationaryRates(chosen, start, end, rate, X, covariance, flicker)


def stationary_rate_fit(rates: StationaryRates, instability: float | None) -> StationaryRateFit | None:
    """Fit the stationary rates; None if their poses are too similar.

    A bias instability (rad/s) that is not stated is estimated as the flicker noise that explains the residuals.
    """
    X, rate, covariance, known = rates.columns, rates.rate, rates.covariance, rates.known
    freedom = rate.size - X.shape[2]
    solved = _solve(X, rate, covariance)
    if solved is None:
        return None
    value, P, chi_square = solved
    if instability is None:
        solved = _with_flicker(X, rate, covariance, rates.flicker, freedom)
        value, P, chi_square = solved
    sigma = np.sqrt(np.diag(P) * max(1.0, chi_square / freedom))
    return StationaryRateFit(
        drift=value[DRIFT],
        drift_sigma=sigma[DRIFT],
        g_sensitivity=value[_G],
        g_sensitivity_sigma=sigma[_G],
        vertical=float(value[_V]),
        vertical_sigma=float(sigma[_V]),
        horizontal=value[_H] if known else None,
        horizontal_sigma=float(np.sqrt(np.mean(sigma[_H] ** 2))) if known else np.inf,
        freedom=freedom,
    )


def _poses(data: PreparedRecording) -> Array | None:
    """Base axes in table-mounted axes at each window, shape (W, 3, 3): row i is base axis i (C_T,base transposed)."""
    if data.recording.fixture is None or any(s is None for s in data.catalogue):
        return None
    out = np.empty((len(data.windows.duration_s), 3, 3))
    for k, sequence in enumerate(data.catalogue):
        assert sequence is not None
        nominal = nominal_attitude(sequence)
        out[data.start[k]], out[data.end[k]] = nominal, nominal @ end_attitude(sequence)
    return out


def _covariance(data: PreparedRecording, T: Array, flicker: Array, *, known: bool) -> Array:
    """Covariance of the mean rates of the windows, by axis, shape (3, W, W), (rad/s)²."""
    noise = data.noise
    instability = data.recording.noise.gyro_bias_instability or 0.0
    fixture = data.recording.fixture
    # Each pose differs from its nominal attitude, which rotates the Earth rate in sensor axes by the same angle.
    doubt = fixture.rotation_sigma_rad if known and fixture is not None else 1.0
    white = raw_rate_variance(noise, T).T
    white = white + (doubt * EARTH_RATE_RAD_S) ** 2
    out: Array = instability**2 * flicker + white[:, :, None] * np.eye(len(T))
    return out


def _solve(X: Array, rate: Array, covariance: Array) -> tuple[Array, Array, float] | None:
    """Weighted least squares: values, covariance and chi-square; None if some component is not observable.

    Outliers among the windows, for instance after a bump, get a negligible weight.
    """
    W = len(X)
    weak = np.zeros(W, dtype=np.bool_)
    while True:
        V = covariance.copy()
        far = np.flatnonzero(weak)
        V[:, far, far] *= 1e8
        L = np.linalg.cholesky(V)
        A = np.concatenate([solve_triangular(L[i], X[:, i], lower=True) for i in range(3)])
        y = np.concatenate([solve_triangular(L[i], rate[:, i], lower=True) for i in range(3)])
        scale = np.linalg.norm(A, axis=0)
        if np.any(scale == 0.0):
            return None
        U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
        if s[-1] < _RANK * s[0]:
            return None
        value = (Vt.T @ ((U.T @ y) / s)) / scale
        left = y - A @ value
        off = np.abs(left).reshape(3, W).max(axis=0)
        outlier = ~weak & (off > OUTLIER * np.median(off))
        if weak.any() or not outlier.any() or outlier.sum() > MOST_OUTLIERS * W:
            root = (Vt.T / s) / scale[:, None]
            return value, root @ root.T, float(left @ left)
        weak |= outlier


def _with_flicker(X: Array, rate: Array, covariance: Array, flicker: Array, freedom: int) -> tuple[Array, Array, float]:
    """Solve with the level of flicker noise that explains the residuals, found by bisection of its logarithm."""
    wanted = freedom * (1.0 - 2.0 * np.sqrt(2.0 / freedom)) if freedom > 18 else 0.5 * freedom
    level = float(np.trace(covariance.mean(axis=0)) / np.trace(flicker))
    low, high = level * 1e-4, level * 1e6
    for _ in range(14):
        middle = float(np.sqrt(low * high))
        solved = _solve(X, rate, covariance + middle * flicker)
        if solved is None or solved[2] < wanted:
            high = middle
        else:
            low = middle
    solved = _solve(X, rate, covariance + high * flicker)
    assert solved is not None  # the rank does not depend on the weights
    return solved


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


def earth_rate(fit: StationaryRateFit | None, recording: Recording) -> EarthRate | None:
    """Earth rate from the stationary rates; None if it is not observable."""
    site, fixture = recording.site, recording.fixture
    if site.latitude_rad is None or fixture is None or fit is None or fit.horizontal is None:
        return None
    true = EARTH_RATE_RAD_S * np.array([-np.sin(site.latitude_rad), np.cos(site.latitude_rad)])
    found = np.array([fit.vertical, float(np.hypot(*fit.horizontal))])
    return EarthRate(found, np.array(_component_sigmas(fit, fixture)), true)


def earth_rate_factor(earth: EarthRate | None) -> EarthRateFactor | None:
    """Factor on the Earth rate that fits the stationary rates at the stated latitude; None if it is not observable.

    A wrong sample rate multiplies both components by the same factor. A wrong latitude does not change the sum of their
    squares.
    """
    if earth is None:
        return None
    measured, sigma, expected = earth
    found, true = measured / sigma, expected / sigma
    information = float(true @ true)
    value = float(true @ found) / information
    left = found - value * true
    return EarthRateFactor(value, information**-0.5, float(left @ left))


def _component_sigmas(fit: StationaryRateFit, fixture: Fixture) -> tuple[float, float]:
    """Standard deviations of the vertical and the horizontal Earth rate, including those due to the alignment."""
    align = EARTH_RATE_RAD_S * fixture.alignment_sigma_rad
    return float(np.hypot(_vertical_sigma(fit), align)), float(np.hypot(fit.horizontal_sigma, align))


def _vertical_sigma(fit: StationaryRateFit) -> float:
    """Standard deviation of the vertical component, including the effect of the unknown trace of the g-sensitivity.

    The nine components of Γ are assumed to have the same standard deviation, which is estimated from the eight fitted
    components. The trace therefore has a t distribution with eight degrees of freedom. The factor converts its quantile
    at the false-alarm probability to that of a normal distribution.
    """
    hidden = np.mean(fit.g_sensitivity**2) / 3.0
    factor = limit("t", 8, both_sides=True) / limit("normal", both_sides=True)
    return float(np.sqrt(fit.vertical_sigma**2 + factor**2 * hidden))
