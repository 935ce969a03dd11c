"""Site: consistency of gravity, latitude and heading with one another and with the stationary gyro rates.

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
from scipy.special import fdtri, ndtri, stdtrit

from srt.constants import DEG, DEG_PER_H, EARTH_RATE_RAD_S, normal_gravity_m_s2
from srt.diagnosis.findings import FALSE_ALARM, Fault, Finding
from srt.diagnosis.rotation_readings import computed_once
from srt.diagnosis.triad_fits import gyro_fit
from srt.noise.bias_instability import flicker_covariance
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.preparation import nominal_attitude

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.recording.recording import Fixture
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices

HEIGHTS_M: Final = (5000.0, -500.0)
"""Highest and lowest plausible height of a test site, m."""
ANOMALY_M_S2: Final = 1e-3
"""Largest plausible gravity anomaly, m/s²: 100 mGal, which is exceeded in few places on land."""
_SITE_SIGMAS: Final = 3.0
"""Tolerance of the stated gravity, and of the latitude from the gyros, in sigma."""
_GRID_DEG: Final = 0.01
"""Step of the latitudes that are tried, °: far below the resolution of gyros."""


def gravity(evidence: Evidence) -> Iterator[Finding]:
    """Test the stated gravity against normal gravity at the stated latitude, for all plausible heights.

    There is no finding if the gyros show another latitude, at which the stated gravity is plausible.
    """
    site = evidence.recording.site
    if site.latitude_rad is None:
        return
    low, high = _gravity_range(site.latitude_rad)
    doubt = _SITE_SIGMAS * site.gravity_sigma_m_s2
    if low - doubt <= site.gravity_m_s2 <= high + doubt:
        return
    wrong = next((found for found in _earth_rate(evidence) if found.fault == "latitude"), None)
    if wrong is not None:
        seen, sigma = wrong.details["found"] * DEG, _SITE_SIGMAS * wrong.details["sigma"] * DEG
        ranges = [_gravity_range(latitude) for latitude in np.linspace(seen - sigma, seen + sigma, 9).tolist()]
        if any(bottom <= site.gravity_m_s2 <= top for bottom, top in ranges):
            return
    yield GRAVITY.found(stated=site.gravity_m_s2, latitude=site.latitude_rad / DEG, low=low, high=high)


GRAVITY: Final = Fault(
    "gravity",
    "Gravity is inconsistent with the latitude",
    "stated gravity against normal gravity at the stated latitude, for heights from -500 m to 5000 m",
    "Gravity is stated as {stated:.6g} m/s², but at {latitude:.4g}° latitude it lies between {low:.6g} and {high:.6g} "
    "m/s²: correct gravity_m_s2 or latitude_deg.",
    "warning",
    gravity,
)


def _gravity_range(latitude_rad: float) -> tuple[float, float]:
    """Smallest and largest plausible gravity at a latitude, m/s²."""
    low, high = (float(normal_gravity_m_s2(latitude_rad, height)) for height in HEIGHTS_M)
    return low - ANOMALY_M_S2, high + ANOMALY_M_S2


def earth_rate(evidence: Evidence) -> Iterator[Finding]:
    """Test the stated latitude and heading against the Earth rate in the stationary windows."""
    yield from _earth_rate(evidence)


EARTH_RATE_ABSENT: Final = Fault(
    "earth_rate_absent",
    "The gyros do not sense the Earth rate",
    "vertical component and horizontal magnitude of the Earth rate, from the stationary windows: zero fits better than"
    " any latitude",
    "The gyros measure an Earth rate of {found:.3g} ± {sigma:.2g} °/h at rest, but {expected:.3g} °/h is expected at "
    "any latitude: the unit removes the Earth rate (auto-zero, or a dead band); record raw readings.",
    "warning",
    earth_rate,
)
LATITUDE: Final = Fault(
    "latitude",
    "The Earth rate is inconsistent with the latitude",
    "vertical component and horizontal magnitude of the Earth rate, from the stationary windows",
    "The gyros measure the Earth rate of {found:.3g}° ± {sigma:.2g}° latitude, but {stated:.4g}° is stated: correct "
    "latitude_deg (north is positive).",
    "warning",
    earth_rate,
)
NORTH: Final = Fault(
    "north",
    "The Earth rate is inconsistent with the heading",
    "direction of the horizontal component of the Earth rate, from the stationary windows",
    "According to the Earth rate, the heading of the table's x axis is {found:.4g}° ± {sigma:.2g}°, but {stated:.4g}° "
    "is stated: correct heading_deg (clockwise is positive).",
    "warning",
    earth_rate,
)


@computed_once
def _earth_rate(evidence: Evidence) -> list[Finding]:
    return list(_wrong_earth_rate(evidence))


def _wrong_earth_rate(evidence: Evidence) -> Iterator[Finding]:
    """Test the stated latitude and heading against the Earth rate in the stationary windows.

    The tests are likelihood-ratio tests. The stated latitude is wrong if the best latitude explains the vertical
    component and the horizontal magnitude significantly better. The stated heading is wrong if the direction of the
    horizontal component differs significantly. If an Earth rate of zero explains the readings significantly better than
    any latitude, the unit removes the Earth rate.
    """
    site, fixture = evidence.recording.site, evidence.recording.fixture
    if site.latitude_rad is None or fixture is None:
        return
    fit = stationary_rate_fit(evidence)
    if fit is None or fit.horizontal is None:
        return
    limit = float(fdtri(1, fit.freedom, 1.0 - FALSE_ALARM))
    vertical_sigma, horizontal_sigma = _component_sigmas(fit, fixture)
    x, y = fit.horizontal.tolist()
    size = float(np.hypot(x, y))

    def misfit(latitude_rad: Array) -> Array:
        down, level = -EARTH_RATE_RAD_S * np.sin(latitude_rad), EARTH_RATE_RAD_S * np.cos(latitude_rad)
        out: Array = ((fit.vertical - down) / vertical_sigma) ** 2 + ((size - level) / horizontal_sigma) ** 2
        return out

    latitudes = np.arange(-90.0, 90.0 + 0.5 * _GRID_DEG, _GRID_DEG) * DEG
    by_latitude = misfit(latitudes)
    best = int(np.argmin(by_latitude))
    latitude = site.latitude_rad
    absent = (fit.vertical / vertical_sigma) ** 2 + (size / horizontal_sigma) ** 2
    if float(by_latitude[best]) - absent > limit:
        yield EARTH_RATE_ABSENT.found(
            found=float(np.hypot(fit.vertical, size) / DEG_PER_H),
            sigma=float(np.hypot(vertical_sigma, horizontal_sigma) / DEG_PER_H),
            expected=float(EARTH_RATE_RAD_S / DEG_PER_H),
        )
        return
    factor = earth_rate_factor(evidence)
    by_clock = factor is not None and factor.misfit < by_latitude[best] - limit
    if not by_clock and float(misfit(np.array([latitude]))[0] - by_latitude[best]) > limit:
        near = latitudes[by_latitude <= by_latitude[best] + 1.0]
        yield LATITUDE.found(
            found=float(latitudes[best] / DEG),
            sigma=float(max(0.5 * np.ptp(near) / DEG, _GRID_DEG)),
            stated=float(latitude / DEG),
        )
        latitude = float(latitudes[best])
    if fixture.heading_rad is None:
        return
    # In base axes, the azimuth of north is minus the heading.
    seen = float(np.arctan2(-y, x))
    off = float(np.angle(np.exp(1j * (seen - fixture.heading_rad))))
    level = EARTH_RATE_RAD_S * float(np.cos(latitude))
    if 2.0 * size * level * (1.0 - np.cos(off)) / horizontal_sigma**2 > limit:
        yield NORTH.found(
            found=float((fixture.heading_rad + off) / DEG),
            sigma=float(min(horizontal_sigma / size, np.pi) / DEG),
            stated=float(fixture.heading_rad / DEG),
        )


class EarthRateFactor(NamedTuple):
    """Measured over true Earth rate at the stated latitude, its standard deviation, and chi-square of the residuals."""

    value: float
    sigma: float
    misfit: float


@computed_once
def earth_rate_components(evidence: Evidence) -> tuple[Array, Array, Array] | None:
    """Measured vertical and horizontal Earth rate, their standard deviations, and the values at the stated latitude.

    Each has shape (2,), rad/s; None if the Earth rate is not observable.
    """
    site, fixture, fit = evidence.recording.site, evidence.recording.fixture, stationary_rate_fit(evidence)
    if site.latitude_rad is None or fixture is None or fit is None or fit.horizontal is None:
        return None
    true = EARTH_RATE_RAD_S * np.array([-np.sin(site.latitude_rad), np.cos(site.latitude_rad)])
    found = np.array([fit.vertical, float(np.hypot(*fit.horizontal))])
    return found, np.array(_component_sigmas(fit, fixture)), true


def earth_rate_factor(evidence: Evidence) -> EarthRateFactor | None:
    """Factor on the Earth rate that fits the stationary rates at the stated latitude; None if it is not observable.

    A wrong sample rate multiplies both components by the same factor. A wrong latitude does not change the sum of their
    squares.
    """
    components = earth_rate_components(evidence)
    if components is None:
        return None
    measured, sigma, expected = components
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
    factor = stdtrit(8, 0.5 * FALSE_ALARM) / ndtri(0.5 * FALSE_ALARM)
    return float(np.sqrt(fit.vertical_sigma**2 + factor**2 * hidden))


LEAST_FREEDOM: Final = 12
"""Fewest degrees of freedom for an estimate of the scatter."""
_RANK: Final = 1e-3
"""Smallest over largest singular value of the scaled design matrix, below which some component is not observable."""
_OUTLIER: Final = 8.0
"""Ratio of a residual to the median residual, above which a window is an outlier, for instance after a bump."""
_MOST_OUTLIERS: Final = 0.2
"""Share of outliers above which none is down-weighted: so many windows are no outliers."""
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


@computed_once
def stationary_rate_fit(evidence: Evidence) -> StationaryRateFit | None:
    """Fit the stationary rates; None if there are too few windows, or if their poses are too similar."""
    return None if evidence.data is None else _fit(evidence, evidence.data)


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
    """

    window: Indices
    start: Array
    end: Array
    rate: Array
    columns: Array
    covariance: Array

    @property
    def known(self) -> bool:
        """True if the attitudes are known."""
        return bool(self.columns.shape[2] == _H_COLUMNS)


@computed_once
def stationary_rates(evidence: Evidence) -> StationaryRates | None:
    """Stationary rates of the windows; None if there are too few windows, or if a vertical cannot be measured."""
    data = evidence.data
    if data is None:
        return None
    W = len(data.windows.duration_s)
    chosen = np.unique(np.linspace(0, W - 1, min(W, _MOST_WINDOWS)).astype(int))
    rate, force = data.windows.gyro_mean[chosen], data.windows.accel_mean[chosen]
    poses = _poses(data)
    known = poses is not None and gyro_fit(evidence).rank == 3
    if known:
        assert poses is not None
        poses = poses[chosen]
        turned = poses @ gyro_fit(evidence).matrix.T  # rows: base axes in uncompensated sensor axes
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
    return StationaryRates(chosen, start, end, rate, X, _covariance(data, start, end, known=known))


def _fit(evidence: Evidence, data: PreparedRecording) -> StationaryRateFit | None:
    rates = stationary_rates(evidence)
    if rates is None:
        return None
    X, rate, covariance, known = rates.columns, rates.rate, rates.covariance, rates.known
    freedom = rate.size - X.shape[2]
    solved = _solve(X, rate, covariance)
    if solved is None:
        return None
    value, P, chi_square = solved
    instability = data.recording.noise.gyro_bias_instability
    if instability is None:
        # The bias instability is not stated: it is estimated as the flicker noise that explains the residuals.
        solved = _with_flicker(X, rate, covariance, flicker_covariance(rates.start, rates.end), freedom)
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


def _covariance(data: PreparedRecording, start: Array, end: Array, *, known: bool) -> Array:
    """Covariance of the mean rates of the windows, by axis, shape (3, W, W), (rad/s)²."""
    noise, T = data.noise, end - start
    instability = data.recording.noise.gyro_bias_instability or 0.0
    fixture = data.recording.fixture
    # Each pose differs from its nominal attitude, which rotates the Earth rate in sensor axes by the same angle.
    doubt = fixture.rotation_sigma_rad if known and fixture is not None else 1.0
    white = noise.gyro_white[:, None] ** 2 / T + 2.0 * (noise.gyro_edge[:, None] / T) ** 2
    white = white + (doubt * EARTH_RATE_RAD_S) ** 2
    out: Array = instability**2 * flicker_covariance(start, end) + white[:, :, None] * np.eye(len(T))
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
        outlier = ~weak & (off > _OUTLIER * np.median(off))
        if weak.any() or not outlier.any() or outlier.sum() > _MOST_OUTLIERS * W:
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
