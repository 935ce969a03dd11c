"""Outlier test of a fleet: every value of a unit against the median and scatter of all other units.

For one parameter, ``y_i = m + s u_i + e_i`` are the values of n units: m and s are the median and scatter of the
fleet, u_i is standard normal, and e_i the error of the calibration of the unit, of known sigma ``σ_i``. Unit i is
compared with all others, so that an outlier does not widen the scatter that enters its own test:

*Scatter*, independent of the median: ``S = d / (√2 q)``, where d is the K-th smallest difference between two of the
others, ``K = h (h − 1) / 2`` counts the pairs among h good units, and q is the quantile of ``|N(0, 1)|`` that belongs
to K (with h half of the units this is Qn of Rousseeuw and Croux, 1993). h leaves out a quarter of the others (rounded
down, at least one), so that as many outliers have no influence on S. With half of the units, as in Qn, the test would
have no power in small fleets. S includes the measurement errors; its lower limit is the smallest σ of all units,
``σ_0``.

*Centre*: the median, of variance ``v = (π / 2) S² / (n − 1)``.

*Test*: ``z_i = (y_i − m) / √(S² + σ_i² − σ_0² + v)``, flagged beyond a limit.

The limit keeps the expected number of false flags in a table of 27 parameters at 0.01, so the probability of any flag
is at most 1 %, for any correlation of the parameters (Bonferroni). It is the solution c of ``27 n T(n, c) =
0.01``, with T the probability that |z| of one sound unit exceeds c where all σ are equal (:func:`tail_probability`). A
common σ acts like scatter between the units, so T does not depend on it. For unequal σ, the common part σ_0 counts as
scatter, and each unit keeps a variance ``σ_i² − σ_0²`` of its own. These variances increase S for all units, and that
of the tested unit is also in the denominator. The false-alarm rate is then below the stated one
(tests/comparison/test_fleet.py).

S is not corrected for the σ of the units. An estimate of s from pair differences less their σ vanishes if a few pairs
agree by chance; it flagged good units in most fleets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import ndtr, ndtri

from srt.exceptions import InputError
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from srt.types import Array, Counts, Mask


EXPECTED_FALSE_FLAGS: Final = 0.01
"""Expected number of false flags in a table of 27 parameters; it bounds the probability of one."""

MINIMUM_UNITS: Final = 6
"""Smallest number of units of a test. With five units the limit would be 96 sigma, which is of no use."""

_LIMITS: Final = (
    {6: 26.698, 7: 14.904, 8: 10.906, 9: 10.601, 10: 8.849, 11: 7.827, 12: 7.223, 13: 7.173, 14: 6.760, 15: 6.479}
    | {16: 6.240, 17: 6.206, 18: 6.055, 19: 5.922, 20: 5.803, 23: 5.597, 27: 5.410, 33: 5.257, 40: 5.128, 50: 5.042}
    | {70: 4.951, 100: 4.907, 200: 4.917}
)
"""Limits by number of units, from 6 million draws for up to ten units, and 600 million / n² draws for n units."""

_SCATTER_FROM: Final = 3
"""Smallest number of units for which a scatter is defined."""
_FEW_UNITS: Final = 200
"""Number of units up to which all pairs are listed; beyond, counting the pairs by bisection is faster."""
_CHUNK: Final = 2_000_000
"""Numbers in one work array, 16 MB."""


@dataclass(frozen=True, eq=False)
class FleetOutliers:
    """Outlier statistics of all units; NaN where unknown or not tested.

    Attributes
    ----------
    median, scatter : ndarray, shape (27,), SI
        Over all units; the scatter is a 1-sigma value and includes the units' own errors.
    limit : ndarray, shape (27,)
        Size of z beyond which a value is outlying; NaN with fewer than :data:`MINIMUM_UNITS` units.
    others_median, others_scatter : ndarray, shape (n, 27), SI
        Over all units except the tested one.
    z : ndarray, shape (n, 27)
        Value less the others' median, over the root sum of squares of the others' scatter, the excess of the unit's
        own sigma over the smallest one, and the sigma of the median.
    """

    median: Array
    scatter: Array
    limit: Array
    others_median: Array
    others_scatter: Array
    z: Array

    @cached_property
    def flagged(self) -> Mask:
        """Mask of the outlying values, shape (n, 27); cached, as it is read once for each unit."""
        size = np.where(np.isnan(self.z), 0.0, np.abs(self.z))
        out: Mask = size > np.where(np.isnan(self.limit), np.inf, self.limit)
        return out


def find_outliers(values: ArrayLike, sigmas: ArrayLike) -> FleetOutliers:
    """Test every unit against all others, parameter by parameter.

    Parameters
    ----------
    values, sigmas : array_like, shape (n, p), SI
        One row per unit; a sigma that is not positive and finite marks a value that is not known (a held parameter),
        which takes no part.

    Returns
    -------
    FleetOutliers
        With p in place of 27 (the limits are those of a table of 27).

    Raises InputError: shapes that differ.
    """
    y, sigma = np.asarray(values, dtype=np.float64), np.asarray(sigmas, dtype=np.float64)
    if y.ndim != 2 or y.shape != sigma.shape:
        raise InputError(
            f"Values of shape {y.shape} and sigmas of shape {sigma.shape}: give one row per unit and one column per "
            "parameter, for both."
        )
    known = np.isfinite(sigma) & (sigma > 0.0) & np.isfinite(y)
    n, p = y.shape
    median, scatter, limit = (np.full(p, np.nan) for _ in range(3))
    others = np.full((3, n, p), np.nan)
    # Columns with values of the same units are processed together; mostly these are all columns.
    patterns, kind = np.unique(known, axis=1, return_inverse=True)
    for number, pattern in enumerate(patterns.T):
        rows, columns = np.flatnonzero(pattern), np.flatnonzero(kind.reshape(-1) == number)
        step = max(_CHUNK // max(len(rows), 1) ** 2, 1)
        for part in (columns[k : k + step] for k in range(0, len(columns) if len(rows) else 0, step)):
            at = np.ix_(rows, part)
            least = sigma[at].min(axis=0)
            median[part], scatter[part] = _of_columns(middle_and_scatter, _of_large_fleet, y[at])
            scatter[part] = np.maximum(scatter[part], least)
            if len(rows) < MINIMUM_UNITS:
                continue
            limit[part] = critical_value(len(rows))
            m, S = _of_columns(_without_each, _without_each_of_many, y[at])
            S = np.maximum(S, least)
            z = (y[at] - m) / np.sqrt(S**2 * _with_median(len(rows)) + sigma[at] ** 2 - least**2)
            for whole, found in zip(others, (m, S, z), strict=True):
                whole[at] = found
    return FleetOutliers(median, scatter, limit, *others)


def middle_and_scatter(y: Array) -> tuple[Array, Array]:
    """Median and robust scatter of fleets.

    Parameters
    ----------
    y : ndarray, shape (b, n)
        Values of n units; one fleet per row.

    Returns
    -------
    median, scatter : ndarray, shape (b,)
        Below three units the scatter is not known, NaN.
    """
    n = y.shape[1]
    median: Array = np.median(y, axis=1)
    if n < _SCATTER_FROM:
        return median, np.full(len(y), np.nan)
    rank, quantile = _good_pairs(n)
    return median, np.partition(_differences(y), rank, axis=1)[:, rank] / (math.sqrt(2.0) * quantile)


def critical_value(units: int) -> float:
    """Size of z beyond which a value is outlying among a number of units.

    Parameters
    ----------
    units : int
        :data:`MINIMUM_UNITS` or more.

    Notes
    -----
    Solved at the knots of a table by :func:`tail_probability`; between them, its ratio to the limit of a fleet with
    known centre and scatter is interpolated over 1/n, and tends to 1.
    """
    knots = np.array(list(_LIMITS), dtype=np.float64)
    ratios = np.array(list(_LIMITS.values())) / _normal_limit(knots)
    ratio = np.interp(-1.0 / units, [*(-1.0 / knots), 0.0], [*ratios, 1.0])
    return float(ratio * _normal_limit(np.float64(units)))


def tail_probability(units: int, limits: ArrayLike, rng: np.random.Generator, draws: int) -> Array:
    """Probability that the |z| of one unit exceeds a limit in a fleet without outliers, if all sigmas are equal.

    Parameters
    ----------
    draws : int
        Number of draws of the other units. The unit itself is not drawn: given the others, its value is normal.

    Returns
    -------
    ndarray, of the shape of limits
    """
    c = np.asarray(limits, dtype=np.float64)
    total = np.zeros(c.shape)
    step = max(_CHUNK // units**2, 1)
    for start in range(0, draws, step):
        others = rng.standard_normal((min(step, draws - start), units - 1))
        middle, scatter = middle_and_scatter(others)
        reach = c[..., None] * scatter * math.sqrt(_with_median(units))
        total += np.sum(ndtr(-reach - middle) + ndtr(-reach + middle), axis=-1)
    return total / draws


def _normal_limit(units: Array | np.float64) -> Array:
    out: Array = -ndtri(0.5 * EXPECTED_FALSE_FLAGS / (N_PARAMETERS * units))
    return out


def _good_pairs(n: int) -> tuple[int, float]:
    """Rank, from 0, of the pair difference that estimates the scatter of n units, and its quantile of |N(0, 1)|."""
    good = n - max(1, n // 4)
    count = good * (good - 1) // 2
    return count - 1, float(ndtri(0.5 + 0.5 * (count - 0.5) / (n * (n - 1) // 2)))


def _with_median(n: int) -> float:
    """Variance of the difference of a unit from the median of the n − 1 others, over that of a unit."""
    return 1.0 + 0.5 * math.pi / (n - 1)


def _differences(y: Array) -> Array:
    """Size of the difference of every pair, shape (b, n (n − 1) / 2)."""
    i, j = np.triu_indices(y.shape[1], 1)
    out: Array = np.abs(y[:, i] - y[:, j])
    return out


def _without_each(y: Array) -> tuple[Array, Array]:
    """Median and scatter of all but each unit, shape (b, n), from one sort of the pairs."""
    b, n = y.shape
    rank, quantile = _good_pairs(n - 1)
    pairs = _differences(y)
    by_size = np.argsort(pairs, axis=1)
    place = np.empty_like(by_size)
    np.put_along_axis(place, by_size, np.broadcast_to(np.arange(pairs.shape[1]), pairs.shape), axis=1)
    # Removing the pairs of a unit moves the pair of that rank up by the number of removed pairs before it. The j-th
    # pair of the unit (from 0) has "place − j" pairs of others before it, and is removed before the rank if these are
    # at most "rank".
    i, j = np.triu_indices(n, 1)
    own = np.array([np.flatnonzero((i == unit) | (j == unit)) for unit in range(n)])
    before = np.sort(place[:, own], axis=2) - np.arange(n - 1) <= rank
    at = np.take_along_axis(by_size, rank + before.sum(axis=2), axis=1)
    scatter = np.take_along_axis(pairs, at, axis=1) / (math.sqrt(2.0) * quantile)
    # The same holds for the median: without a unit, the values after it move up by one.
    order = np.argsort(y, axis=1)
    middle = np.empty((b, n))
    halves = (np.take_along_axis(y, order[:, k + (np.arange(n) <= k)], axis=1) for k in ((n - 2) // 2, (n - 1) // 2))
    np.put_along_axis(middle, order, 0.5 * sum(halves), axis=1)
    return middle, scatter


# Large fleets: the same numbers to the last bit, without a list of all pairs


def _of_columns(
    listed: Callable[[Array], tuple[Array, Array]], counted: Callable[[Array], tuple[Any, Any]], y: Array
) -> tuple[Array, Array]:
    """Results for the columns of a table by a list of all pairs, and in large fleets by counting them."""
    if len(y) <= _FEW_UNITS:
        first, second = listed(y.T)
    else:
        first, second = (np.array(found) for found in zip(*map(counted, y.T), strict=True))
    return first.T, second.T


def _of_large_fleet(y: Array) -> tuple[float, float]:
    """Median and scatter of one fleet, as :func:`middle_and_scatter`."""
    rank, quantile = _good_pairs(len(y))
    return float(np.median(y)), _kth_difference(np.sort(y), rank) / (math.sqrt(2.0) * quantile)


def _pairs_within(y: Array, size: float) -> Counts:
    """Number of later values that differ from each value by at most ``size``, for sorted values of shape (n,).

    A rounded difference grows with the later value, so the count is a position in the sorted values. A search for
    ``y + size`` finds this position up to the rounding of the sum; the two loops correct that.
    """
    end = np.searchsorted(y, y + size, side="right")
    while np.any(more := (end < len(y)) & (y[np.minimum(end, len(y) - 1)] - y <= size)):
        end += more
    while np.any(less := y[end - 1] - y > size):
        end -= less
    return np.asarray(end - np.arange(1, len(y) + 1))


def _kth_difference(y: Array, rank: int) -> float:
    """Difference of the given rank, from 0, among all pairs of sorted values, by bisection over all floats.

    Positive floats have the order of their bits as integers, so at most 64 counts of order n log n find it exactly.
    """
    low, high = -1, int(np.float64(y[-1] - y[0]).view(np.int64))
    while high - low > 1:
        middle = (low + high) // 2
        if _pairs_within(y, float(np.int64(middle).view(np.float64))).sum() > rank:
            high = middle
        else:
            low = middle
    return float(np.int64(high).view(np.float64))


def _without_each_of_many(values: Array) -> tuple[Array, Array]:
    """Median and scatter of all but each of n values, shape (n,), in time n log n and memory n.

    Removing a unit removes its n − 1 pairs, so the pair of a given rank moves up by at most n − 1 ranks. Among all
    pairs in order of size, it lies from that rank to n − 1 ranks above. Only the n − 2 pairs between these two are
    sorted.
    """
    n = len(values)
    order = np.argsort(values)
    y = values[order]
    rank, quantile = _good_pairs(n - 1)
    low, high = _kth_difference(y, rank), _kth_difference(y, rank + n - 1)
    within = _pairs_within(y, low)
    after = np.arange(n) + 1
    as_later = np.cumsum(np.bincount(after, minlength=n + 1) - np.bincount(after + within, minlength=n + 1))[:n]
    # Pairs with a difference between the two, sorted by it.
    first = after + within
    count = np.maximum(_pairs_within(y, float(np.nextafter(high, 0.0))) - within, 0)
    i, j = np.repeat(np.arange(n), count), _spans(first, count)
    size = y[j] - y[i]
    by_size = np.argsort(size, kind="stable")
    # Number of pairs of others that are still to be counted from here on, for each unit. The k-th pair of the unit
    # itself (from 0), at place p, is skipped if the p − k pairs of others before it are fewer than that.
    missing = rank + 1 - (within.sum() - within - as_later)
    unit = np.concatenate([i[by_size], j[by_size]])
    place = np.tile(np.arange(len(size)), 2)
    sort = np.lexsort((place, unit))
    unit, place = unit[sort], place[sort]
    earlier = np.arange(len(unit)) - np.searchsorted(unit, unit)
    skipped = np.bincount(unit[place - earlier < missing[unit]], minlength=n)
    ladder = np.concatenate([[low], size[by_size], [high]])
    found = ladder[np.clip(np.where(missing > 0, missing + skipped, 0), 0, len(ladder) - 1)]
    scatter, middle = np.empty(n), np.empty(n)
    scatter[order] = found / (math.sqrt(2.0) * quantile)
    # The same holds for the median: without a unit, the values after it move up by one.
    halves = (y[k + (np.arange(n) <= k)] for k in ((n - 2) // 2, (n - 1) // 2))
    middle[order] = 0.5 * sum(halves)
    return middle, scatter


def _spans(start: Counts, length: Counts) -> Counts:
    """Concatenated ranges of the given starts and lengths."""
    before = np.cumsum(length) - length
    return np.asarray(np.repeat(start - before, length) + np.arange(length.sum()))
