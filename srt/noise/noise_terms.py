"""Noise terms of a unit at rest by maximum likelihood, with 95 % intervals and the record length that each needs.

The readings of a channel, means over dt, are modelled as a constant and::

    ε   quantization: differences of independent errors of variance ε²/12 of the integral
    N   angular or velocity random walk: white, variance N²/dt
    B   bias instability: power spectral density B²/(4 ln 2 |f|), the flat part of the Allan deviation at B
    K   rate random walk: steps of variance K² dt
    R   rate ramp: R t

Type-II discrete cosines diagonalise the covariance of white noise and of a random walk whose start is unknown exactly:
with s = sin(π j / 2n), coefficient j has the variance::

    λ = ε²/12 · 4 s²/dt² + N²/dt + B² n/(2 ln 2 j) + K² dt/(4 s²)

Quantization and 1/f noise are nearly diagonal. The coefficients are then independent normal numbers of mean R u, u the
transform of t, and the likelihood of the record, restricted for R and the constant, is a sum over them. An
interval holds the values whose likelihood, the other terms fitted anew, is above a threshold that
:mod:`srt.noise.likelihood_thresholds` derives. A term whose interval reaches zero is an upper limit, and holds 95 %
like an interval.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from math import log, pi
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import stdtrit

from srt.constants import DEG_PER_H, HOUR_S, MICRO_G
from srt.exceptions import DataError
from srt.noise.allan import CHANNELS, CONFIDENCE, TERMS, Term, deviation, figures
from srt.noise.likelihood_thresholds import SLOW, Bins, SimulatedRecords, normal_threshold
from srt.noise.noise_agreement import contradiction
from srt.noise.nonnegative import many_nonnegative_least_squares

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from srt.recording.recording import Recording
    from srt.types import Array, Indices, Mask


RAMP_TERM: Final = Term(
    "rate_ramp", "rate ramp", 0.5, 2.0, -4,
    ("gyro_rate_ramp_deg_per_h_per_h", "accel_rate_ramp_ug_per_h"),
    ("°/h/h", "µg/h"), (DEG_PER_H / HOUR_S, MICRO_G / HOUR_S),
)  # fmt: skip
ALL_TERMS: Final = (*TERMS, RAMP_TERM)
"""Terms of the columns of :class:`NoiseTerms`."""

SHORTEST_S: Final = 30.0
"""Shortest record, s."""
FEWEST: Final = 64
"""Smallest number of samples."""

_RAMP: Final = len(TERMS)
_SINGLE_BINS: Final = 256
"""Coefficients that are kept one by one; slow terms show in few of them."""
_BINS_PER_E: Final = 25
"""Bins per factor e beyond them: λ changes by up to 8 % within one."""
_PASSES: Final = 200
_STILL: Final = 1e-7
"""Relative change of λ at which the fit has converged."""
_FIRST_THRESHOLD: Final = 3.84
"""Quantile of chi-square with 1 degree of freedom."""
_THRESHOLDS: Final = 2
"""Thresholds computed for an end of an interval."""
_CLOSE: Final = 0.01
"""Share of its width to which an end of an interval is known."""
_PRECISION: Final = 0.5
"""Relative half-width of the 95 % interval at which a term counts as known, for the record length needed."""
_LENGTHS_S: Final = np.geomspace(10.0, 1e8, 64)
"""Record lengths that are tried; the longest is three years."""
_QUADRATURE: Final = 400


@dataclass(frozen=True, slots=True, eq=False)
class NoiseTerms:
    """Noise terms of the six channels, SI.

    Attributes
    ----------
    value, low, high : ndarray, shape (6, 5)
        Coefficients of :data:`ALL_TERMS` (for quantization ε; the ramp has a sign) and their 95 % intervals. A term
        that is not resolved has the interval from zero to its upper limit. NaN for a channel that does not change.
    needed_s : ndarray, shape (6, 5), s
        Record length from which the 95 % interval is within ± 50 % of the coefficient; for a term that is not resolved,
        of its upper limit: a smaller term needs more. Infinite beyond three years.
    length_s, interval_s : float, s
    refused : dict of str to str
        Channels whose readings contradict the fitted terms, or whose noise changes within the window, with the
        reason; their terms are NaN.
    """

    value: Array
    low: Array
    high: Array
    needed_s: Array
    length_s: float
    interval_s: float
    refused: dict[str, str]

    @property
    def resolved(self) -> Mask:
        """True where the interval excludes zero, shape (6, 5)."""
        return np.asarray(self.low * self.high > 0.0)

    def deviation(self, tau_s: Array) -> Array:
        """Allan deviation by the resolved terms, shape (6, k), for times of shape (k,), s."""
        return deviation(ALL_TERMS, np.where(self.resolved, self.value, np.nan), tau_s)

    def figures(self) -> dict[str, dict[str, dict[str, float]]]:
        """Figures by channel and key, in the units of their keys, as JSON values: value, low, high, or below."""
        return figures(ALL_TERMS, np.where(self.resolved, self.value, np.nan), self.low, self.high, self.high)


@dataclass(frozen=True, slots=True, eq=False)
class _Spectrum:
    """Sums of c² and c u over bins of coefficients, shape (b,) each."""

    bins: Bins
    cc: Array
    cu: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Squared coefficients, ramp, its variance, −2 ln(restricted likelihood), λ by bin."""

    squares: Array
    ramp: float
    ramp_variance: float
    loss: float
    variance: Array


def noise_terms(recording: Recording, window: tuple[int, int], rng: np.random.Generator | None = None) -> NoiseTerms:
    """Fit the noise terms of all channels over one stationary window.

    Parameters
    ----------
    window : (int, int)
        First sample and one past the last.
    rng : numpy.random.Generator, optional
        Of the simulated records behind the intervals; one of fixed seed if left out.

    Raises
    ------
    DataError
        A window of less than :data:`SHORTEST_S` or :data:`FEWEST` samples, or noise in all channels that is not that of
        a unit at rest.
    """
    a, b = window
    dt, n = recording.nominal_interval_s, b - a
    if n < FEWEST or n * dt < SHORTEST_S:
        raise DataError(
            f"The longest stationary window lasts {n * dt:.3g} s ({n} samples), but noise terms need {SHORTEST_S:g} s "
            f"and {FEWEST} samples: log the unit at rest, for hours if its bias instability is wanted."
        )
    factor = recording.rates_factor
    value, low, high, needed = np.full((4, len(CHANNELS), len(ALL_TERMS)), np.nan)
    refused = {}
    edges, u = _edges(n), _ramp(n, dt)
    bins = _bins(edges, u, dt)
    records = SimulatedRecords.draw(bins, np.random.default_rng(0) if rng is None else rng)
    for c in range(len(CHANNELS)):
        x = (recording.gyro, recording.accel)[c // 3][a:b, c % 3]
        if not np.ptp(x) > 1e-15 * np.abs(x).max():
            continue
        spectrum = _spectrum((x - x.mean()) * factor, edges, u, bins)
        best = _likeliest(spectrum)
        without_ramp = x * factor - best.ramp * dt * np.arange(n)
        if reason := contradiction(without_ramp, dt, partial(_variance, squares=best.squares, dt=dt)):
            refused[CHANNELS[c]] = reason
            continue
        value[c], low[c], high[c], needed[c] = _channel(spectrum, best, records, dt)
    if refused and np.isnan(high).all():
        channel, reason = next(iter(refused.items()))
        raise DataError(
            f"The noise from {recording.time[a]:.6g} to {recording.time[b - 1]:.6g} s is not that of a unit at rest. "
            f"{channel}: {reason}. A filter, interpolated samples, vibration or a changing noise give such readings: "
            "log the unit undisturbed, unfiltered, at its own rate."
        )
    return NoiseTerms(value, low, high, needed, n * dt, dt, refused)


def _variance(n: int, squares: Array, dt: float) -> Array:
    """Variance of the coefficients 1 to n − 1 of a record of n samples by the terms with these squares."""
    return np.asarray(_design(0.5 * pi * np.arange(1, n) / n, n, dt) @ squares)


def _edges(n: int) -> Indices:
    """First coefficient of each bin, less 1 (coefficient 0, the constant, is left out)."""
    count = max(2, round(_BINS_PER_E * log(n / _SINGLE_BINS))) if n > _SINGLE_BINS else 2
    coarse = np.geomspace(min(_SINGLE_BINS, n - 1), n - 1, count)
    return (
        np.unique(np.concatenate([np.arange(1, min(_SINGLE_BINS, n - 1)), np.round(coarse)[:-1]]).astype(np.intp)) - 1
    )


def _design(x: Array, n: int, dt: float) -> Array:
    """Variance of the coefficients by each term of coefficient 1, shape (n, 4), for x = π j / 2n."""
    s = np.sin(x)
    # The readings' first and last error of the integral have no neighbour, hence the cosine.
    pulses = (s**2 + np.cos(x) ** 2 / n) / (3.0 * dt**2)
    return np.stack([pulses, np.full_like(s, 1.0 / dt), pi / (4.0 * log(2.0) * x), dt / (4.0 * s**2)], axis=1)


def _ramp(n: int, dt: float) -> Array:
    from scipy.fft import dct

    return np.asarray(dct((np.arange(n) - 0.5 * (n - 1)) * dt, norm="ortho")[1:])


def _bins(edges: Indices, u: Array, dt: float) -> Bins:
    n = len(u) + 1
    count = np.diff(np.append(edges, n - 1)).astype(np.float64)
    design = np.add.reduceat(_design(0.5 * pi * np.arange(1, n) / n, n, dt), edges) / count[:, None]
    return Bins(count, np.add.reduceat(u**2, edges), design)


def _spectrum(x: Array, edges: Indices, u: Array, bins: Bins) -> _Spectrum:
    from scipy.fft import dct

    c = np.asarray(dct(x, norm="ortho")[1:])
    return _Spectrum(bins, np.add.reduceat(c**2, edges), np.add.reduceat(c * u, edges))


def _likeliest(spectrum: _Spectrum, fixed: int | None = None, square: float = 0.0, ramp: float | None = None) -> _Fit:
    """Maximum likelihood by iterated non-negative least squares, one squared coefficient or the ramp fixed if stated.

    The likelihood is restricted for the ramp, which is estimated, unless the ramp is fixed.
    """
    count, uu, A = spectrum.bins
    free = np.array([k for k in range(A.shape[1]) if k != fixed])
    offset = np.zeros(len(A)) if fixed is None else A[:, fixed] * square
    variance = np.maximum(spectrum.cc / count, 1e-300) + offset
    # Smoothed for the first weights: single coefficients scatter by more than their mean.
    variance = np.exp(np.convolve(np.log(variance), np.ones(9) / 9.0, mode="same"))
    squares = np.zeros(A.shape[1])
    for _ in range(_PASSES):
        slope, slope_variance = _slope(spectrum, variance, ramp)
        # The last term restores the power that the estimate of the ramp takes away (restricted likelihood).
        power = (spectrum.cc - 2.0 * slope * spectrum.cu + (slope**2 + slope_variance) * uu) / count
        weight = np.sqrt(count) / variance
        squares[free] = many_nonnegative_least_squares(A[:, free] * weight[:, None], (power - offset) * weight)
        if fixed is not None:
            squares[fixed] = square
        new = np.maximum(A @ squares, 1e-12 * variance)
        change = float(np.abs(np.log(new / variance)).max())
        variance = new
        if change < _STILL:
            break
    slope, slope_variance = _slope(spectrum, variance, ramp)
    power = spectrum.cc - 2.0 * slope * spectrum.cu + slope**2 * uu
    loss = float(np.sum(count * np.log(variance) + power / variance))
    if ramp is None:
        loss -= log(slope_variance)
    return _Fit(squares, slope, slope_variance, loss, variance)


def _slope(spectrum: _Spectrum, variance: Array, ramp: float | None) -> tuple[float, float]:
    """Weighted estimate of the ramp and its variance; a fixed ramp has none."""
    if ramp is not None:
        return ramp, 0.0
    slope_variance = 1.0 / float((spectrum.bins.uu / variance).sum())
    return float((spectrum.cu / variance).sum()) * slope_variance, slope_variance


def _channel(
    spectrum: _Spectrum, best: _Fit, records: SimulatedRecords, dt: float
) -> tuple[Array, Array, Array, Array]:
    """Value, low, high and needed length of the terms of one channel."""
    doubt = np.sqrt(np.diag(np.linalg.inv(_information(spectrum.bins, best.variance))))
    low, high = np.zeros(len(ALL_TERMS)), np.zeros(len(ALL_TERMS))
    for k in range(_RAMP):

        def ratio(square: float, k: int = k) -> float:
            return _likeliest(spectrum, k, square).loss - best.loss

        def threshold(square: float, k: int = k) -> float:
            fit = _likeliest(spectrum, k, square)
            if k in SLOW:
                return records.term_threshold(fit.squares, k, CONFIDENCE)
            return normal_threshold(square / _sigma(spectrum.bins, fit, k), CONFIDENCE)

        low[k], high[k] = _ends(ratio, threshold, float(best.squares[k]), float(doubt[k]))
    low[:_RAMP], high[:_RAMP] = np.sqrt(low[:_RAMP]), np.sqrt(high[:_RAMP])
    value: Array = np.append(np.sqrt(best.squares), best.ramp)
    low[_RAMP], high[_RAMP] = _ramp_ends(spectrum, records, best)
    resolved: Mask = np.asarray(low > 0.0, dtype=np.bool_)
    if resolved[_RAMP] and best.ramp < 0.0:
        low[_RAMP], high[_RAMP] = -high[_RAMP], -low[_RAMP]
    assumed: Array = np.where(resolved, np.abs(value), high)
    return value, low, high, _needed(assumed, resolved, dt)


def _ends(
    ratio: Callable[[float], float], threshold: Callable[[float], float], best: float, doubt: float
) -> tuple[float, float]:
    """Ends of the interval where the ratio is below the threshold; the lower one is zero if zero belongs to it.

    The threshold changes slowly along the values: it is that of the end that the threshold before it gave.
    """
    from scipy.optimize import brentq

    ratio = cache(ratio)

    def upper(allowed: float) -> float:
        high = best + doubt
        while ratio(high) < allowed:
            high = best + 2.0 * (high - best)
        return float(brentq(lambda value: ratio(value) - allowed, best, high, xtol=_CLOSE * (high - best)))

    def lower(allowed: float) -> float:
        if ratio(0.0) < allowed:
            return 0.0
        return float(brentq(lambda value: ratio(value) - allowed, 0.0, best, xtol=_CLOSE * min(best, doubt)))

    resolved = best > 0.0 and ratio(0.0) > threshold(0.0)
    ends = []
    for end in (lower, upper) if resolved else (upper,):
        value = end(_FIRST_THRESHOLD)
        for _ in range(_THRESHOLDS):
            value = end(threshold(value))
        ends.append(value)
    # Zero is excluded: a threshold that is larger next to it leaves the lowest value that was resolved.
    return (max(ends[0], _CLOSE * best), ends[1]) if resolved else (0.0, ends[0])


def _ramp_ends(spectrum: _Spectrum, records: SimulatedRecords, best: _Fit) -> tuple[float, float]:
    """Ends of the interval of the size of the ramp; the other terms are fitted anew to each ramp that is tested."""
    from scipy.optimize import minimize_scalar

    sign = 1.0 if best.ramp >= 0.0 else -1.0
    size, doubt = abs(best.ramp), float(np.sqrt(best.ramp_variance))
    found = minimize_scalar(
        lambda tested: _likeliest(spectrum, ramp=sign * tested).loss,
        bounds=(max(size - doubt, 0.0), size + doubt),
        method="bounded",
        options={"xatol": _CLOSE * doubt},
    )

    def ratio(tested: float) -> float:
        return _likeliest(spectrum, ramp=sign * tested).loss - float(found.fun)

    def threshold(tested: float) -> float:
        return records.ramp_threshold(_likeliest(spectrum, ramp=sign * tested).squares, tested, CONFIDENCE)

    return _ends(ratio, threshold, float(found.x), doubt)


def _information(bins: Bins, variance: Array) -> Array:
    """Fisher information of the squared coefficients, shape (4, 4), lightly loaded so that it has an inverse."""
    weighted = bins.design * (np.sqrt(0.5 * bins.number) / variance)[:, None]
    information = weighted.T @ weighted
    return information + 1e-12 * np.diag(np.diag(information))


def _sigma(bins: Bins, fit: _Fit, k: int) -> float:
    """Standard deviation of squared coefficient k, fitted with the others that are not zero."""
    kept = [k, *(j for j in range(len(fit.squares)) if j != k and fit.squares[j] > 0.0)]
    covariance = np.linalg.inv(_information(bins, fit.variance)[np.ix_(kept, kept)])
    return float(np.sqrt(covariance[0, 0]))


def _needed(coefficients: Array, resolved: Mask, dt: float) -> Array:
    """Record length from which each term is known, s; a term that is not resolved is added to those that are."""
    out = np.full(len(coefficients), np.inf)
    for t in range(len(coefficients)):
        present = resolved.copy()
        present[t] = present[1] = True
        if not coefficients[t] > 0.0:
            continue
        for length, doubts in _predicted(np.where(present, coefficients, 0.0), dt):
            if doubts[t] <= _PRECISION:
                out[t] = length
                break
    return out


def _predicted(coefficients: Array, dt: float) -> Iterator[tuple[float, Array]]:
    """Relative half-widths of the 95 % intervals, by record length."""
    width = float(stdtrit(1e9, 0.5 * (1.0 + CONFIDENCE)))
    squares = coefficients[:_RAMP] ** 2
    kept = squares > 0.0
    for length in _LENGTHS_S[FEWEST * dt <= _LENGTHS_S].tolist():
        n = round(length / dt)
        # Midpoints of logarithmic cells of coefficients, each with its width as weight; the first ones singly.
        edges = np.unique(np.concatenate([np.arange(1, 65), np.geomspace(64, n, _QUADRATURE)]).round()) - 0.5
        edges = edges[edges <= n - 0.5]
        j, count = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
        design = _design(0.5 * pi * j / n, n, dt)
        variance = design @ squares
        # Transform of t: only odd coefficients, -(2/n)^(1/2) dt / (4 sin²) there in the limit of many samples.
        odd = np.where(j < 64, np.round(j) % 2.0, 0.5)
        uu = count * odd * (2.0 / n) * (dt * np.cos(0.5 * pi * j / n) / (2.0 * np.sin(0.5 * pi * j / n) ** 2)) ** 2
        doubts = np.full(len(coefficients), np.inf)
        covariance = np.linalg.inv(_information(Bins(count, uu, design), variance)[np.ix_(kept, kept)])
        doubts[:_RAMP][kept] = 0.5 * width * np.sqrt(np.diag(covariance)) / squares[kept]
        if coefficients[_RAMP]:
            doubts[_RAMP] = width / np.sqrt((uu / variance).sum()) / abs(coefficients[_RAMP])
        yield length, doubts
