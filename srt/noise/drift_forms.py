"""Forms of a bias drift within a recording, as functions of time, and the test that selects them.

A form is a function s(t) with a mean of zero over the stationary windows, scaled to a range of one:

- linear in time;
- warm-up: ``exp(−t / τ)``, with τ a twelfth, a sixth or two fifths of the recording, and its derivative by ln τ, with
  which a sum of both describes the time constants between these;
- linear in temperature;
- random walk: the principal components of its means over the windows, with their conditional mean in the rotations;
- step: :mod:`srt.noise.bias_steps`.

The bias of a channel is ``b + a s(t)``; its constant part b is the mean bias over the windows, and a is its change over
the recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.types import Array, Mask


FALSE_ALARM: Final = 2e-5
"""Probability that any form of any sensor is selected in a recording without drift.

It is part of the 1e-4 that all checks share, see ``srt.diagnosis.false_alarms``. With 41 degrees of freedom, a
drift of 7.9 sigma is selected in 90 % of the recordings; at 1e-4 a drift of 7.3 sigma would be.
"""
LINEAR: Final = "linear"
TEMPERATURE: Final = "temperature"
WALK: Final = "random walk"
MOST_WALK_TERMS: Final = 100
"""Most components of a random walk, which recordings of more windows have; others would have 0.2 % of its variance."""
TESTED_TERMS: Final = 3
"""Components of the random walk in its test: they have 83 % of its variance about the mean."""
WARM_UP: Final = {"fast warm-up": 1.0 / 12.0, "warm-up": 1.0 / 6.0, "slow warm-up": 0.4}
"""Time constants of the warm-up by name, as a share of the recording."""
_SCATTER_RANGE: Final = (-14.0, 3.0)
"""Range of the variance of independent errors, logarithm of the ratio to their estimate without a walk."""
_WALK_RANGE: Final = (-9.0, 12.0)
"""The same for the variance of a random walk at the end of the recording."""
_LEAST_CHANGE: Final = 1e-3 - 1.0
"""Least relative change of the noise along an effect: a thousandth of it is left."""
_VARIANCES: Final = 1000
"""Variances among which the likelihood of a component is largest."""
_COARSE: Final = 10
"""Every so many of them are computed first: the logarithm of a variance changes by 0.37, and no term of the likelihood
rises or falls within less than 1."""
_LEAST_CHI_SQUARE: Final = 1e-300
"""Chi-square below which this limit counts: a form may explain noise-free residuals entirely."""
_SEEN: Final = 1e-10
"""Eigenvalue of the information, relative to the largest, below which a coefficient is not testable."""
_SHORTEST: Final = 1e-6
"""Duration, as a share of the recording, that an interval without samples counts as: rounding would spoil its mean."""
_LEAST_TEMPERATURE_RANGE: Final = 0.1
"""Range of the window temperatures, K, below which a drift with temperature is not tested."""


@dataclass(frozen=True, slots=True, eq=False)
class DriftShape:
    """Means of the n functions of a form.

    Attributes
    ----------
    windows : ndarray, shape (W, n)
    parts : ndarray, shape (K, P, n)
        Over the equal parts of every rotation.
    halves : ndarray, shape (W, 2, n)
        Over the halves of the windows.
    """

    windows: Array
    parts: Array
    halves: Array

    @property
    def tested(self) -> DriftShape:
        """The functions that the test of the form uses."""
        return self._functions(slice(TESTED_TERMS))

    def of(self, sensor: str) -> DriftShape:
        """The functions that act on a sensor: on "accel" in the windows, on "gyro" in rotations, too."""
        acts = np.any(self.windows != 0.0, axis=0)
        if sensor == "gyro":
            acts |= np.any(self.parts != 0.0, axis=(0, 1))
        return self if acts.all() else self._functions(acts)

    def _functions(self, which: slice | Mask) -> DriftShape:
        return DriftShape(*(means[..., which] for means in (self.windows, self.parts, self.halves)))


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Windows, parts of rotations and halves of windows.

    Attributes
    ----------
    start, end : ndarray, shape (W + K P + 2 W,), s
        In this order.
    parts : (int, int)
        K and P.
    temperature : ndarray, shape (W + K P + 2 W,), °C, or None
        Mean temperatures.
    """

    start: Array
    end: Array
    windows: int
    parts: tuple[int, int]
    temperature: Array | None


class DriftShapes(Mapping[str, DriftShape]):
    """Shapes of all forms by name, each computed at its first use: that of a random walk costs most."""

    def __init__(self, intervals: Intervals) -> None:
        self._intervals = intervals
        warm = None if intervals.temperature is None else np.ptp(intervals.temperature[: intervals.windows])
        temperature = () if warm is None or warm <= _LEAST_TEMPERATURE_RANGE else (TEMPERATURE,)
        self._shapes: dict[str, DriftShape | None] = dict.fromkeys((LINEAR, *WARM_UP, *temperature, WALK))

    def __getitem__(self, form: str) -> DriftShape:
        found = self._shapes[form]
        if found is None:
            found = self._shapes[form] = self._shape(form)
        return found

    def __contains__(self, form: object) -> bool:
        return form in self._shapes

    def __iter__(self) -> Iterator[str]:
        return iter(self._shapes)

    def __len__(self) -> int:
        return len(self._shapes)

    def _shape(self, form: str) -> DriftShape:
        own = self._intervals
        a, b = times = _shares(own)
        if form == WALK:
            return _walk(times, own)
        if form in WARM_UP:
            share = WARM_UP[form]
            falls = [(-share * np.exp(-x / share), -(x + share) * np.exp(-x / share)) for x in (a, b)]
            return _scaled(np.column_stack([_mean(begin, end, b - a) for begin, end in zip(*falls, strict=True)]), own)
        values = {LINEAR: 0.5 * (a + b), TEMPERATURE: own.temperature}[form]
        assert values is not None
        return _scaled(values[:, None], own)


def _shares(intervals: Intervals) -> Array:
    """Start and end of every interval as shares of the recording, shape (2, W + K P + 2 W)."""
    begin = float(intervals.start.min())
    return (np.stack([intervals.start, intervals.end]) - begin) / (float(intervals.end.max()) - begin)


def _mean(begin: Array, end: Array, width: Array) -> Array:
    """Mean of a function over intervals, from its antiderivative at both ends; zero for intervals without length."""
    return np.asarray((end - begin) / np.where(width > 0.0, width, 1.0))


def _scaled(values: Array, intervals: Intervals) -> DriftShape:
    return mean_zero(values / np.ptp(values[: intervals.windows], axis=0), intervals)


def mean_zero(values: Array, intervals: Intervals) -> DriftShape:
    """Shape of functions, less their mean over the windows, from their means in all intervals, (W + K P + 2 W, n)."""
    return _shape(values - _weight(intervals) @ values[: intervals.windows], intervals)


def _walk(times: Array, intervals: Intervals) -> DriftShape:
    """Random walk of unit variance at the end, about its mean over the windows; times are shares of the recording."""
    W, weight = intervals.windows, _weight(intervals)
    C = _walk_covariance(times, times[:, :W])
    C = C - weight @ C[:W]
    C = C - (C @ weight)[:, None]
    variances, components = np.linalg.eigh(0.5 * (C[:W] + C[:W].T))
    variances, components = variances[::-1][:MOST_WALK_TERMS], components[:, ::-1][:, :MOST_WALK_TERMS]
    seen = variances > _SEEN * variances[0]
    return _shape(C @ (components[:, seen] / np.sqrt(variances[seen])), intervals)


def walk_between_windows(intervals: Intervals, walk: DriftShape) -> Array:
    """Root of the covariance of a random walk in the parts of each rotation if its means over the windows are known.

    Parameters
    ----------
    walk : DriftShape
        Shape of the random walk in these intervals.

    Returns
    -------
    ndarray, shape (K, P, P)
        For a walk of unit variance at the end. That of different rotations counts as independent: windows lie between.
    """
    times, W, weight = _shares(intervals), intervals.windows, _weight(intervals)
    parts = times[:, W : -2 * W].reshape(2, *intervals.parts)
    windows = times[:, :W]
    by_mean = _walk_covariance(parts, windows[:, None]) @ weight
    C = _walk_covariance(parts, parts) - by_mean[:, :, None] - by_mean[:, None, :]
    C = C + weight @ _walk_covariance(windows, windows) @ weight - walk.parts @ np.swapaxes(walk.parts, 1, 2)
    variances, components = np.linalg.eigh(0.5 * (C + np.swapaxes(C, 1, 2)))
    return np.asarray(components * np.sqrt(np.maximum(variances, 0.0))[:, None, :])


def _walk_covariance(first: Array, second: Array) -> Array:
    """Covariance of the means of a Wiener process over intervals (2, ..., n) by (2, ..., m), of starts and of ends."""

    def integral(x: Array, y: Array) -> Array:
        # ∫∫ min(s, t) over 0 < s < x and 0 < t < y
        x, y = x[..., :, None], y[..., None, :]
        low, high = np.minimum(x, y), np.maximum(x, y)
        return np.asarray(low**2 * (high / 2.0 - low / 6.0))

    lengths = [np.maximum(b - a, _SHORTEST) for a, b in (first, second)]
    a, c = first[0], second[0]
    b, d = a + lengths[0], c + lengths[1]
    area = lengths[0][..., :, None] * lengths[1][..., None, :]
    return np.asarray((integral(b, d) - integral(a, d) - integral(b, c) + integral(a, c)) / area)


def _weight(intervals: Intervals) -> Array:
    """Weights of the windows in their mean, by duration."""
    duration = (intervals.end - intervals.start)[: intervals.windows]
    return np.asarray(duration / duration.sum())


def _shape(values: Array, intervals: Intervals) -> DriftShape:
    W, n = intervals.windows, values.shape[1]
    return DriftShape(values[:W], values[W : -2 * W].reshape(*intervals.parts, n), values[-2 * W :].reshape(W, 2, n))


@dataclass(frozen=True, eq=False)
class Statistics:
    """Information that the whitened residuals of a model contain on additional coefficients, which it lacks.

    Attributes
    ----------
    gradient : ndarray, shape (q,)
        Zᵀ r, with the residuals r and their derivative Z with respect to the coefficients.
    information : ndarray, shape (q, q)
        Zᵀ M Z with the projection M onto the residuals.
    chi_square : float
        rᵀ r.
    freedom : int
        Degrees of freedom of the residuals.
    known : (ndarray, ndarray), optional
        :attr:`eigen`, where it is known.
    """

    gradient: Array
    information: Array
    chi_square: float
    freedom: int
    known: tuple[Array, Array] | None = None

    @cached_property
    def eigen(self) -> tuple[Array, Array]:
        """Eigenvalues of the information, and its eigenvectors as columns."""
        if self.known is not None:
            return self.known
        values, vectors = np.linalg.eigh(self.information)
        return values, vectors

    def likelihood_ratio(self, variances: Array) -> Array:
        """Twice the logarithm of the restricted likelihood ratio of common variances (n,) of the coefficients.

        With the eigenvalues λ of the information and the gradient g along its eigenvectors it is
        ``Σ [v g² / (1 + v λ) − log(1 + v λ)]``. A negative variance v takes noise away that the weights include:
        v λ > −1, but where weights and effects are two models of the same noise.
        """
        values, vectors = self.eigen
        return _likelihood_ratio(variances, values, vectors.T @ self.gradient)


def _likelihood_ratio(variances: Array, values: Array, along: Array) -> Array:
    """:meth:`Statistics.likelihood_ratio` of variances (..., n), eigenvalues and gradients along them (..., q)."""
    v = variances[..., None]
    changed = np.maximum(v * np.maximum(values, 0.0)[..., None, :], _LEAST_CHANGE)
    return np.asarray(np.sum(v * along[..., None, :] ** 2 / (1.0 + changed) - np.log1p(changed), axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class DriftTest:
    """Result of the test of one form.

    Attributes
    ----------
    amplitude : ndarray, shape (q,)
        Least-squares estimate of the tested coefficients.
    gain : float
        See :func:`likelihood_gain`.
    """

    p_value: float
    amplitude: Array
    gain: float


def residual_statistics(z: Array, H: Array, *effects: Array) -> list[Statistics]:
    """Statistics of measurements with white noise of unit variance, for each of several sets of coefficients.

    Parameters
    ----------
    z : ndarray, shape (n,)
    H : ndarray, shape (n, p)
        Derivative with respect to the parameters of the model; columns that are zero are ignored.
    *effects : ndarray, shape (n, q)
        Derivative with respect to the coefficients of a set.
    """
    norm = np.linalg.norm(H, axis=0)
    unit = H[:, norm > 0.0] / norm[norm > 0.0]
    Q, T = np.linalg.qr(unit)
    dependent = np.flatnonzero(np.abs(np.diag(T)) <= 1e-10)
    if dependent.size:  # the columns of Q after an arbitrary one lack its direction
        Q = np.linalg.qr(np.delete(unit, dependent, axis=1))[0]
    r = z - Q @ (Q.T @ z)
    chi_square, freedom = float(r @ r), len(z) - Q.shape[1]
    left = (Z - Q @ (Q.T @ Z) for Z in effects)
    return [Statistics(Z.T @ r, Z.T @ Z, chi_square, freedom) for Z in left]


def drift_test(found: Statistics) -> DriftTest | None:
    """Test of a form against the model without it; None if the residuals do not depend on it.

    F test: the decrease of chi-square per coefficient, over the remaining chi-square per degree of freedom. The ratio
    does not depend on the scale of the noise. The decrease must also be significant by itself: residuals far below the
    stated noise, as in a noise-free recording, are systematic and would pass the F test alone.
    """
    values, vectors = found.eigen
    seen = values > _SEEN * values.max()
    q, along = int(seen.sum()), vectors[:, seen].T @ found.gradient
    freedom = found.freedom - q
    if values.max() <= 0.0 or freedom < 1:
        return None
    explained = float(np.sum(along**2 / values[seen]))
    left = max(found.chi_square - explained, _LEAST_CHI_SQUARE)
    p_value = max(float(fdtrc(q, freedom, explained / q / (left / freedom))), float(chdtrc(q, explained)))
    gain = likelihood_gain(explained, q, found.chi_square, found.freedom)
    return DriftTest(p_value, vectors[:, seen] @ (along / values[seen]), gain)


def likelihood_gain(explained: float, coefficients: int, chi_square: float, freedom: int) -> float:
    """Twice the logarithm of a likelihood ratio, with the scale of the noise estimated, less a penalty.

    The penalty is that of the Bayesian information criterion. The gain compares causes of different kinds, and those
    whose p-values are too small to compute.

    Parameters
    ----------
    explained : float
        Decrease of chi-square by the coefficients, or twice the logarithm of the likelihood ratio of their variances,
        with noise of a known scale.
    coefficients : int
        Number of coefficients or variances.
    chi_square, freedom : float, int
        Residuals of the model without them: square sum, and degrees of freedom.
    """
    left = max(chi_square - explained, _LEAST_CHI_SQUARE)
    return freedom * math.log(max(chi_square, left) / left) - coefficients * math.log(max(freedom, 1))


class VarianceComponent(NamedTuple):
    """Common variance of a set of coefficients by restricted maximum likelihood.

    Attributes
    ----------
    sigma : float
        Standard deviation.
    p_value : float
        Of the likelihood ratio, if the variance is zero: half that of chi-square with one degree of freedom, because a
        variance is not negative (Self and Liang 1987).
    ratio : float
        Twice the logarithm of that likelihood ratio.
    """

    sigma: float
    p_value: float
    ratio: float


def of_courses(found: Statistics, courses: Array) -> Statistics:
    """Statistics of coefficients of n courses (W, n), from those of independent errors of W windows with 3 channels."""
    W, n = courses.shape
    gradient = courses.T @ found.gradient.reshape(W, 3)
    # Of channel b of window x and channel a of course n, and then of both courses.
    half = (courses.T @ found.information.reshape(W, -1)).reshape(3 * n, W, 3)
    information = np.swapaxes(np.swapaxes(half, 1, 2) @ courses, 1, 2).reshape(3 * n, 3 * n)
    return Statistics(gradient.ravel(), information, found.chi_square, found.freedom)


def form_or_scatter(found: Statistics, course: Array, scatter: float, *, walk: bool = False) -> float:
    """p-value of a form in addition to independent errors of the windows, whose variance is estimated anew with it.

    Without the form, its effect on the windows counts as independent errors, and hides it from :func:`drift_test`. The
    statistic is the restricted likelihood ratio of form and independent errors against these alone. Its distribution
    for many measurements is chi-square, for the variance of a walk half of it; the F distribution here allows for
    their number.

    Parameters
    ----------
    found : Statistics
        Of independent errors of the W windows with 3 channels.
    course : ndarray, shape (W, n)
        All functions of the form.
    scatter : float, m/s²
        Standard deviation of the independent errors in the noise of ``found``.
    walk : bool
        The functions belong to a random walk: their coefficients have one variance.
    """
    from scipy.optimize import minimize, minimize_scalar  # heavy, and few calibrations have such errors

    unit, along = np.eye(len(found.gradient)), np.kron(course, np.eye(3))
    walking = along @ along.T

    def cost(independent: float, walk_variance: float = -math.inf, *, free: bool = False) -> float:
        S = scatter**2 * ((math.exp(independent) - 1.0) * unit + math.exp(walk_variance) * walking)
        M = unit + found.information @ S
        left = np.linalg.solve(M, np.column_stack([found.gradient, found.information @ along]))
        out = float(np.linalg.slogdet(M)[1] - found.gradient @ S @ left[:, 0])
        if free:  # less what the best coefficients explain
            gradient = along.T @ left[:, 0]
            out -= float(gradient @ np.linalg.lstsq(along.T @ left[:, 1:], gradient)[0])
        return out

    alone = minimize_scalar(cost, bounds=_SCATTER_RANGE, method="bounded")
    if walk:
        starts = [(float(alone.x), 0.0), (0.5 * _SCATTER_RANGE[0], 2.0)]
        ranges = (_SCATTER_RANGE, _WALK_RANGE)
        found_costs = [minimize(lambda x: cost(*x), start, method="Nelder-Mead", bounds=ranges).fun for start in starts]
        best, q, share = min(float(value) for value in found_costs), 1, 0.5
    else:
        best = float(minimize_scalar(lambda x: cost(x, free=True), bounds=_SCATTER_RANGE, method="bounded").fun)
        q, share = along.shape[1], 1.0
    freedom = found.freedom
    ratio = math.expm1(min(max(float(alone.fun) - best, 0.0) / freedom, 300.0))
    return share * float(fdtrc(q, max(freedom - q, 1), max(freedom - q, 1) / q * ratio))


def variance_component(found: Statistics) -> VarianceComponent:
    """Estimate the common variance of coefficients, and test it."""
    if not found.information.size:
        return VarianceComponent(0.0, 1.0, 0.0)
    values, vectors = found.eigen
    sigma, p_value, ratio = variance_components(values[None], (vectors.T @ found.gradient)[None])
    return VarianceComponent(float(sigma[0]), float(p_value[0]), float(ratio[0]))


def variance_components(values: Array, along: Array) -> tuple[Array, Array, Array]:
    """:class:`VarianceComponent` of several units: sigma, p-value and ratio, shape (units,) each.

    Parameters
    ----------
    values, along : ndarray, shape (units, q)
        Eigenvalues of the information on the coefficients, and the gradient along its eigenvectors.
    """
    largest = values.max(axis=1)
    shown = largest > 0.0
    # From a hundredth of the sigma of the best-known coefficient to a million times that sigma, then a parabola.
    steps, units = np.linspace(-9.2, 27.6, _VARIANCES), np.arange(len(values))[:, None]
    log_variance = steps - np.log(np.where(shown, largest, 1.0))[:, None]
    coarse = _likelihood_ratio(np.exp(log_variance[:, ::_COARSE]), values, along)
    near = _COARSE * np.argmax(coarse, axis=1)[:, None] + np.arange(-_COARSE - 1, _COARSE + 2)
    near = np.clip(near, 0, _VARIANCES - 1)
    ratio = _likelihood_ratio(np.exp(log_variance[units, near]), values, along)
    # The largest one has a neighbour on either side.
    i = np.argmax(np.where((near > 0) & (near < _VARIANCES - 1), ratio, -np.inf), axis=1)
    before, at, after = (ratio[units[:, 0], i + k] for k in (-1, 0, 1))
    slope, bend = 0.5 * (after - before), after - 2.0 * at + before
    shift = np.where(bend < 0.0, np.clip(-slope / np.where(bend < 0.0, bend, -1.0), -1.0, 1.0), 0.0)
    best = np.where(shown, np.maximum(at + (slope + 0.5 * bend * shift) * shift, 0.0), 0.0)
    log_sigma = 0.5 * (log_variance[units[:, 0], near[units[:, 0], i]] + shift * (steps[1] - steps[0]))
    return np.where(shown, np.exp(log_sigma), 0.0), np.where(shown, 0.5 * chdtrc(1, best), 1.0), best
