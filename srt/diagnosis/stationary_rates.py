"""Mean rates of the stationary windows, and the Earth rate in them.

The model of the mean rate in window w, in uncompensated sensor axes, is::

    rate_w = b + d t_w + Γ u_w + x e_x,w + y e_y,w + noise

b is the bias, d its change during the test (t runs from -1/2 to 1/2), and (x, y) the Earth rate in fixture base axes.
The unit vectors e_x, e_y and u (down) are turned to sensor axes by the raw gyro matrix from the rotations. Γ is the
g-sensitivity and the vertical Earth rate, which has the effect of a multiple of the identity: the size of the other
eight components limits how large the trace of the g-sensitivity may be.

The noise is white noise plus flicker noise of the stated bias instability, which is correlated from window to window.
Its covariance weights the least-squares fit. Residuals above this noise enlarge all sigmas.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.triad_fits import LEAST_FREEDOM, MOST_OUTLIERS, OUTLIER
from srt.estimation.error_sources import raw_rate_variance
from srt.model.rotations import smallest_rotation
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


class StationaryRateFit(NamedTuple):
    """Fitted components of the stationary rates, in rad/s and uncompensated sensor axes."""

    drift: Array  # change of the bias from the first window to the last, (3,)
    drift_sigma: Array  # (3,)
    g_sensitivity: Array  # Γ without its trace, per g of downward gravity, (3, 3)
    vertical: float  # rate about the downward vertical: vertical Earth rate and trace of the g-sensitivity
    vertical_sigma: float  # its standard deviation due to noise only
    horizontal: Array | None  # Earth rate along base x and y, (2,); None if the attitudes are not known
    horizontal_sigma: float  # standard deviation of each of both
    residual: Array  # rates of the windows less the model, (W, 3)
    freedom: int  # degrees of freedom of the residuals


class StationaryRates(NamedTuple):
    """Stationary rates of W windows and the design matrix of their model."""

    window: Indices  # number of each window in the prepared data, (W,)
    start: Array  # (W,), s
    end: Array  # (W,), s
    rate: Array  # (W, 3), rad/s
    drift: Array  # columns of the drift, (W, 3, 3)
    columns: Array  # columns of bias and Γ, and with known attitudes of the horizontal Earth rate, (W, 3, 12 or 14)
    covariance: Array  # covariance of the rates of each axis over the windows, (3, W, W), (rad/s)²
    flicker: Array  # covariance of the means of flicker noise for a bias instability of one, (W, W)


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
    if span == 0.0 or not (known or np.all(size > 0.0)):
        return None
    # Base axes x and y, and the downward vertical, in uncompensated sensor axes.
    level, down = np.zeros((len(rate), 3, 0)), -force / np.maximum(size, 1e-300)
    if known:
        turned = np.swapaxes(_base_axes(data)[chosen] @ gyro.matrix.T, 1, 2)
        level, down = turned[:, :, :2], turned[:, :, 2]
    unit = np.tile(np.eye(3), (len(rate), 1, 1))
    drift = unit * ((middle - 0.5 * (middle.max() + middle.min())) / span)[:, None, None]
    tilted = np.einsum("wij,wk->wijk", unit, down).reshape(len(rate), 3, -1)
    X = np.concatenate([unit, tilted, level], axis=2)
    if rate.size - X.shape[2] - 3 < LEAST_FREEDOM:
        return None
    flicker = flicker_covariance(start, end)
    # Each pose differs from its nominal attitude, which rotates the Earth rate in sensor axes by the same angle. In
    # free rotations, only the vertical is measured, and the horizontal Earth rate is noise.
    doubt = fixture.rotation_sigma_rad if known and fixture is not None else 1.0
    white = raw_rate_variance(data.noise, end - start).T + (doubt * EARTH_RATE_RAD_S) ** 2
    covariance = (recording.noise.gyro_bias_instability or 0.0) ** 2 * flicker + white[:, :, None] * np.eye(len(rate))
    return StationaryRates(chosen, start, end, rate, drift, X, np.asarray(covariance), flicker)


def _base_axes(data: PreparedRecording) -> Array:
    """Base axes in table-mounted axes at each window, as labelled (C_T,base transposed), shape (W, 3, 3)."""
    axes = np.empty((len(data.windows.duration_s), 3, 3))
    for k, sequence in enumerate(data.catalogue):
        assert sequence is not None
        axes[data.start[k]] = nominal_attitude(sequence)
        axes[data.end[k]] = axes[data.start[k]] @ end_attitude(sequence)
    return axes


def base_tilt(data: PreparedRecording, poses: tuple[Array, Array]) -> Array:
    """Components x and y of the true downward vertical in base axes, from the static poses, shape (2,); else zero.

    The specific force of a pose is ``M n + b``, with its nominal value n. A tilt of the base is constant in base axes,
    so that it turns with the poses in table axes; the matrix M, which includes the mounting, does not.
    """
    nominal, reading = poses
    if not len(nominal) or any(sequence is None for sequence in data.catalogue):
        return np.zeros(2)
    axes = _base_axes(data)[np.stack([data.start, data.end], axis=1).ravel()]
    unit = np.tile(np.eye(3), (len(nominal), 1, 1))
    by_matrix = np.einsum("wij,wk->wijk", unit, nominal).reshape(len(nominal), 3, 9)
    design = np.concatenate([by_matrix, unit, -data.gravity * np.swapaxes(axes[:, :2], 1, 2)], axis=2)
    kept = np.ones(len(nominal), dtype=np.bool_)
    for _ in range(2):  # the second time without the poses that the others contradict
        A, y = design[kept].reshape(-1, design.shape[2]), reading[kept].ravel()
        if np.linalg.matrix_rank(A, tol=_RANK * np.linalg.norm(A, axis=0).max()) < A.shape[1]:
            return np.zeros(2)
        solution = np.linalg.lstsq(A, y, rcond=None)[0]
        left = np.linalg.norm(reading - design @ solution, axis=1)
        kept = left <= max(OUTLIER * float(np.median(left)), np.finfo(float).eps * data.gravity)
    return np.asarray(solution[-2:])


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
    columns = np.concatenate([rates.drift, rates.columns], axis=2)
    freedom = rates.rate.size - columns.shape[2]
    solved = _solve(rates.rate, columns, rates.covariance)
    if solved is None:
        return None
    if recording.noise.gyro_bias_instability is None:
        # Bisection of the logarithm of its square; the residuals are allowed chi-square of p = 0.975.
        level = float(np.trace(rates.covariance.mean(axis=0)) / np.trace(rates.flicker))
        low, high = np.log(level * 1e-4), np.log(level * 1e6)
        for _ in range(14):
            middle = 0.5 * (low + high)
            solved = _solve(rates.rate, columns, rates.covariance + np.exp(middle) * rates.flicker) or solved
            low, high = (low, middle) if solved[2] < limit("chi-square", freedom, shared=0.975) else (middle, high)
    value, P, chi_square = solved
    P *= max(1.0, chi_square / freedom)
    drift, _, gamma, horizontal = np.split(value, [3, 6, 15])
    unit = np.eye(3)
    vertical, by_gamma = float(np.trace(gamma.reshape(3, 3))) / 3.0, unit.ravel() / 3.0
    return StationaryRateFit(
        drift=drift,
        drift_sigma=np.sqrt(np.diag(P)[:3]),
        g_sensitivity=gamma.reshape(3, 3) - vertical * unit,
        vertical=vertical,
        vertical_sigma=float(np.sqrt(by_gamma @ P[6:15, 6:15] @ by_gamma)),
        horizontal=horizontal if horizontal.size else None,
        horizontal_sigma=float(np.sqrt(np.diag(P)[15:].mean())) if horizontal.size else np.inf,
        residual=rates.rate - columns @ value,
        freedom=freedom,
    )


def _solve(rate: Array, columns: Array, covariance: Array) -> tuple[Array, Array, float] | None:
    """Weighted least squares without outliers: values, covariance, chi-square; None if one is not observable."""
    weak = np.zeros(len(rate), dtype=np.bool_)
    while True:
        V = covariance + 1e8 * np.where(weak[:, None] & np.eye(len(weak), dtype=np.bool_), covariance, 0.0)
        A, y = whitened(V, columns), whitened(V, rate)
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


class EarthRate(NamedTuple):
    """Earth rate about the true vertical: downward component and horizontal magnitude, (2,) each, rad/s."""

    found: Array
    sigma: Array
    true: Array  # at the stated latitude
    horizontal: Array  # components along the level axes next to base x and y, (2,); each has the sigma of the magnitude


def earth_rate(fit: StationaryRateFit, recording: Recording, tilt: Array) -> EarthRate | None:
    """Earth rate from the stationary rates; None if it is not observable.

    The sigmas include those of the alignment and, of the vertical component, the unknown trace of the g-sensitivity,
    which has the standard deviation of the eight other components, and thus a t distribution with eight degrees of
    freedom. The factor converts its quantile at the false-alarm probability to that of a normal distribution.
    """
    site, fixture = recording.site, recording.fixture
    if site.latitude_rad is None or fixture is None or fit.horizontal is None:
        return None
    factor = limit("t", 8, both_sides=True) / limit("normal", both_sides=True)
    hidden = np.array([np.sum(fit.g_sensitivity**2) / 8.0 / 3.0, 0.0])
    sigma = np.array([fit.vertical_sigma, fit.horizontal_sigma])
    align = EARTH_RATE_RAD_S * fixture.alignment_sigma_rad
    true = EARTH_RATE_RAD_S * np.array([-np.sin(site.latitude_rad), np.cos(site.latitude_rad)])
    down = np.array([*tilt, 1.0]) / np.sqrt(1.0 + tilt @ tilt)
    x, y, z = smallest_rotation(down, np.array([0.0, 0.0, 1.0])) @ [*fit.horizontal, fit.vertical]
    found = np.array([z, np.hypot(x, y)])
    return EarthRate(found, np.sqrt(sigma**2 + factor**2 * hidden + align**2), true, np.array([x, y]))
