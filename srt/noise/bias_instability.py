"""Bias instability (flicker noise): covariance of bias averages over any time intervals.

Flicker noise with the Allan floor B has the two-sided spectrum ``B² / (4 ln 2 |f|)``. It is modelled as a sum of
first-order Gauss-Markov processes with correlation times a decade apart, each of variance ``B² ln 10 / (2 ln 2)``. The
spectrum of the sum agrees with flicker noise to a few per cent between the fastest and the slowest process. Averages of
such processes have a covariance in closed form. They are strongly correlated: components slower than the test are equal
in all windows, and neighbouring windows differ by √2 B, however long they are.

Components slower than the test are not distinguishable from the bias. Slower processes are therefore omitted: the sum
has zero mean, and the constant part is the bias of the unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.analytic_platform import equal_parts, parts_per_rotation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array, Indices


CORRELATION_TIMES_S: Final = tuple(10.0**decade for decade in range(-1, 5))
"""Correlation times of all processes, s."""
PROCESS_VARIANCE: Final = math.log(10.0) / (2.0 * math.log(2.0))
"""Variance of one process for an Allan floor of one."""
_SLOWEST_S: Final = 1000.0
"""Slowest correlation time that is used in any test, s."""
_ROUNDING: Final = 1e-12
"""Relative increase of the variances that keeps the Cholesky factor real in spite of rounding."""
_NO_TIME_S: Final = 1e-9
"""Length, s, below which an interval counts as a point, and an overlap as zero."""


def correlation_times(span_s: float) -> tuple[float, ...]:
    """Correlation times used for a test of a given length: up to 1000 s, or to the power of ten nearest to it."""
    slowest = max(_SLOWEST_S, 10.0 ** round(math.log10(max(span_s, 1.0))))
    return tuple(tau for tau in CORRELATION_TIMES_S if tau < 1.5 * slowest)


def flicker_covariance(start: Array, end: Array, times_s: Sequence[float] = CORRELATION_TIMES_S) -> Array:
    """Covariance of averages of flicker noise with an Allan floor of one.

    Parameters
    ----------
    start, end : ndarray, shape (..., n), s
        Start and end of the averages, which may overlap.
    times_s : sequence of float, s
        Correlation times of the processes, a decade apart.

    Returns
    -------
    ndarray, shape (..., n, n)
    """
    # An interval without length is a value at its time; rounding must not make adjoining intervals overlap.
    T = np.maximum(end - start, _NO_TIME_S)
    gap = np.maximum(start[..., :, None] - end[..., None, :], start[..., None, :] - end[..., :, None])
    overlap = np.nonzero(gap < -_NO_TIME_S)
    i, j = (*overlap[:-2], overlap[-2]), (*overlap[:-2], overlap[-1])
    short, other = (np.where(T[i] <= T[j], *pair) for pair in ((start[i], start[j]), (T[j], T[i])))
    before = short - np.where(T[i] <= T[j], start[j], start[i])
    point = np.minimum(T[i], T[j]) <= _NO_TIME_S
    out = np.zeros(gap.shape)
    for tau in times_s:
        x = T / tau
        mean = -np.expm1(-x) / x
        part = np.exp(-np.maximum(gap, 0.0) / tau) * (mean[..., :, None] * mean[..., None, :])
        # Overlapping intervals: the second integral of the correlation at the four differences of their ends. A point
        # in an interval: the first integral on both sides.
        twice = (
            _twice_integrated(end[i] - start[j], tau)
            - _twice_integrated(start[i] - start[j], tau)
            - _twice_integrated(end[i] - end[j], tau)
            + _twice_integrated(start[i] - end[j], tau)
        ) / (T[i] * T[j])
        once = -(np.expm1(-before / tau) + np.expm1((before - other) / tau)) * tau / other
        part[overlap] = np.where(point, once, twice)
        out += part
    out *= PROCESS_VARIANCE
    return out


def _twice_integrated(t: Array, tau: float | Array) -> Array:
    """Second integral ∫∫ exp(−|t| / τ), even in t, zero with zero slope at t = 0."""
    x = np.abs(t) / tau
    # Series for small x, where the terms cancel.
    out: Array = tau**2 * np.where(x < 1e-3, x**2 * (0.5 - x / 6.0 + x**2 / 24.0), x + np.expm1(-x))
    return out


@dataclass(frozen=True, eq=False)
class DriftDraws:
    """Unit draws of the bias instability of one sensor with an Allan floor of one.

    Attributes
    ----------
    windows : ndarray, shape (W, n)
        Mean bias of every window; only the first W columns are not zero.
    parts : ndarray, shape (K, P, n)
        Mean bias of every part of every rotation.
    part_s : ndarray, shape (K, P), s
        Lengths of the parts.
    """

    windows: Array
    parts: Array
    part_s: Array

    @cached_property
    def turns(self) -> Array:
        """Mean bias of every rotation, shape (K, n)."""
        share = self.part_s / self.part_s.sum(axis=1, keepdims=True)
        return np.asarray(np.einsum("kp,kpn->kn", share, self.parts))

    @cached_property
    def window_covariance(self) -> Array:
        """Covariance of the mean biases of the windows, shape (W, W)."""
        return np.asarray(self.windows @ self.windows.T)

    @cached_property
    def turn_covariance(self) -> Array:
        """Covariance of the mean biases of rotations and windows, shape (K, W)."""
        return np.asarray(self.turns @ self.windows.T)


def drift_draws(windows: Indices, rotation: Indices, time_s: Array) -> DriftDraws:
    """Unit draws of the bias instability in the windows and rotations of a recording.

    Parameters
    ----------
    windows, rotation : ndarray of int, shape (W, 2) and (K, 2)
        First sample and one past the last.
    time_s : ndarray, shape (n,), s
        Time of the samples, as recorded. The pauses between joined recordings are not included, which matters little:
        the correlation falls with the logarithm of the distance.
    """
    edges = equal_parts(rotation, parts_per_rotation(len(rotation)))
    parts = np.stack([edges[:, :-1].ravel(), edges[:, 1:].ravel()], axis=1)
    root, length_s = _root(np.concatenate([windows, parts]), time_s)
    W = len(windows)
    part_s = length_s[W:].reshape(len(rotation), -1)
    return DriftDraws(root[:W], root[W:].reshape(*part_s.shape, -1), part_s)


def window_draws(windows: Indices, time_s: Array) -> Array:
    """Unit draws of the bias instability in the windows alone, shape (W, W), for the accelerometers."""
    return _root(windows, time_s)[0]


def _root(spans: Indices, time_s: Array) -> tuple[Array, Array]:
    """Lower triangular root of the covariance of the means over sample spans (n, 2), and the lengths of these, s."""
    start, end = interval_times(spans, time_s)
    return _root_between(start.tobytes(), end.tobytes()), end - start


@lru_cache(maxsize=2)
def _root_between(starts: bytes, ends: bytes) -> Array:
    """Root for intervals given as bytes: units that run through one test in turn have the same."""
    start, end = np.frombuffer(starts), np.frombuffer(ends)
    root = regular_root(flicker_covariance(start, end, correlation_times(float(end.max() - start.min()))))
    root.flags.writeable = False
    return root


def regular_root(covariance: Array) -> Array:
    """Cholesky factors of covariances, shape (..., n, n), that may be singular to rounding."""
    size = np.sqrt(np.einsum("...aa->...a", covariance))
    # A quantity without variance, such as the effect on a rotation without samples, is normalised by 1.
    size = np.where(size > 0.0, size, 1.0)
    unit = covariance / (size[..., :, None] * size[..., None, :]) + _ROUNDING * np.eye(size.shape[-1])
    return np.asarray(np.linalg.cholesky(unit) * size[..., :, None])


def interval_times(spans: Indices, time_s: Array) -> tuple[Array, Array]:
    """Start and end, s, of sample spans (n, 2)."""
    # A sample represents the interval before its time; a part without samples has no length.
    length = float(np.median(np.diff(time_s), overwrite_input=True))
    end = time_s[np.minimum(spans[:, 1], len(time_s)) - 1]
    return np.minimum(time_s[np.minimum(spans[:, 0], len(time_s) - 1)] - length, end), end


def shares_within(spacing_s: float) -> Array:
    """Share of the variance of every process that is uncorrelated after a time, shape (number of processes,)."""
    return np.asarray(-np.expm1(-spacing_s / np.array(CORRELATION_TIMES_S)))


def common_variance(shares: Array, test_s: float) -> float:
    """Variance of the mean over a test of given shares of all processes, for an Allan floor of one.

    Parameters
    ----------
    shares : ndarray, shape (number of processes,)
    test_s : float
        Length of the test, s.
    """
    times = correlation_times(test_s)
    own = [2.0 * float(_twice_integrated(np.array(test_s), tau)) / test_s**2 for tau in times]
    return float(shares[: len(times)] @ np.array(own)) * PROCESS_VARIANCE


def adjoining_covariance(lengths_s: Array, shares: Array) -> Array:
    """Covariance of averages over consecutive intervals, for many rows of intervals at once.

    Parameters
    ----------
    lengths_s : ndarray, shape (n, m), s
        Positive lengths of m intervals, each beginning where the one before ends.
    shares : ndarray, shape (number of processes,)
        Share of the variance of every process.

    Returns
    -------
    ndarray, shape (n, m, m)
    """
    n, m = lengths_s.shape
    counted = shares > 0.0
    share, tau = (a[counted][:, None, None] for a in (shares, np.array(CORRELATION_TIMES_S)))
    ends = np.cumsum(lengths_s, axis=1)
    i, j = np.triu_indices(m, 1)
    gap = np.maximum(ends[:, j] - lengths_s[:, j] - ends[:, i], 0.0)
    x = lengths_s / tau
    mean = -np.expm1(-x) / x
    pairs = np.sum(share * np.exp(-gap / tau) * mean[:, :, i] * mean[:, :, j], axis=0)
    out = np.empty((n, m, m))
    out[:, i, j] = out[:, j, i] = pairs
    out[:, np.arange(m), np.arange(m)] = np.sum(share * 2.0 * _twice_integrated(lengths_s, tau), axis=0) / lengths_s**2
    out *= PROCESS_VARIANCE
    return out
