"""How large the errors of converged trials are, and whether the sigmas that came with them are honest.

With r = error / sigma of a parameter in n units, an honest sigma makes n·rms(r)² a chi-square of n degrees of freedom,
whose root lies within 1 ± 3.5/√(2n) in all but 5 of 10 000 cases. A campaign judges many parameters of several
estimators: what it calls dishonest lies beyond limits that all of them together keep in 99 of 100 campaigns (each gets
an equal part of the 1 %, which is safe however the errors of one unit are correlated).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import betaincinv, chdtri

from sims.robustness.tidy import Axis, Trials, cells
from srt.sensor_errors import GROUPS, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from srt.types import Array, Counts, Indices, Mask


CONFIDENCE: Final = 0.95
FALSE_ALARMS: Final = 0.01
"""Chance that a campaign with honest sigmas has one called dishonest."""
BAND: Final = 3.5
"""Half width of the band of one rms, in its standard errors."""
_TWO_SIDED_95: Final = 1.959964
_GROUP_OF: Final = tuple(k for k, group in enumerate(GROUPS) for _ in group.suffixes)


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Errors of converged trials by the level of an axis and the group of parameters.

    All arrays have shape (estimators, levels, groups) and hold NaN where there is no error.

    Attributes
    ----------
    axis : Axis or None
        None for all trials together, one level.
    count : ndarray of int
        Errors that went in: one per trial and estimated parameter of the group.
    rms, largest : ndarray
        Of the error, in the display unit of the group.
    rms_in_sigma, largest_in_sigma : ndarray
        Of the error over its sigma.
    """

    axis: Axis | None
    count: Counts
    rms: Array
    largest: Array
    rms_in_sigma: Array
    largest_in_sigma: Array


@dataclass(frozen=True, slots=True, eq=False)
class Honesty:
    """Errors over sigmas of the converged trials of a noisy campaign.

    Arrays of parameters have shape (estimators, 27), those of all together (estimators,); NaN where there is nothing.

    Attributes
    ----------
    count : ndarray of int
        Trials per parameter.
    rms : ndarray
        Of error over sigma; 1 if honest.
    half_width : ndarray
        Of the band about 1 that the rms of one honest parameter keeps: 3.5/√(2n).
    low, high : ndarray
        Limits of ``rms`` that honest sigmas keep all together in 99 of 100 campaigns.
    coverage, coverage_low, coverage_high : ndarray
        Share of the errors within their 95 % interval, and its own 95 % interval.
    nees, nees_low, nees_high : ndarray
        Chi-square of all errors of a unit with their covariance, over the degrees of freedom, mean; and its limits.
    units : ndarray of int
        Trials in ``nees``.
    """

    count: Counts
    rms: Array
    half_width: Array
    low: Array
    high: Array
    coverage: Array
    coverage_low: Array
    coverage_high: Array
    nees: Array
    nees_low: Array
    nees_high: Array
    units: Counts

    @property
    def too_small(self) -> Mask:
        """Whose sigma is smaller than the errors are, shape (estimators, 27)."""
        return np.asarray(self.rms > self.high)

    @property
    def too_large(self) -> Mask:
        """Whose sigma is larger than the errors are, shape (estimators, 27)."""
        return np.asarray(self.rms < self.low)

    @property
    def nees_off(self) -> Mask:
        """Whose NEES is beyond its limits, shape (estimators,)."""
        return np.asarray((self.nees < self.nees_low) | (self.nees > self.nees_high))


def share_interval(successes: ArrayLike, trials: ArrayLike, confidence: float = CONFIDENCE) -> tuple[Array, Array]:
    """Interval of a share (Clopper and Pearson): it holds the true one at least as often as said.

    Parameters
    ----------
    successes, trials : array_like of int
        Of like shape; without trials the share may be anything, 0 to 1.
    confidence : float
        Two-sided.

    Returns
    -------
    low, high : ndarray
    """
    k, n = np.asarray(successes, dtype=np.float64), np.asarray(trials, dtype=np.float64)
    tail = 0.5 * (1.0 - confidence)
    # A beta distribution needs both parameters above 0: where one is not, the limit is 0 or 1.
    low = np.where(k > 0, betaincinv(np.maximum(k, 1.0), np.maximum(n - k, 0.0) + 1.0, tail), 0.0)
    high = np.where(n > k, betaincinv(k + 1.0, np.maximum(n - k, 1.0), 1.0 - tail), 1.0)
    return low, high


def accuracy(trials: Trials) -> tuple[Accuracy, ...]:
    """Errors of the converged trials: all together first, then against every axis.

    Parameters
    ----------
    trials : Trials
    """
    chosen = np.flatnonzero(trials.converged)
    axes: tuple[Axis | None, ...] = (None, *trials.axes)
    sums = [_Sums(trials, axis, chosen) for axis in axes]
    # One parameter's columns at a time: all of them at once would be gigabytes of a large campaign.
    for name, group in zip(NAMES, _GROUP_OF, strict=True):
        error, sigma = trials.numbers(f"error_{name}")[chosen], trials.numbers(f"sigma_{name}")[chosen]
        estimated = np.isfinite(error) & np.isfinite(sigma)
        with np.errstate(divide="ignore", invalid="ignore"):
            scaled = np.where(sigma > 0.0, error / sigma, 0.0)
        for total in sums:
            total.add(group, estimated, error * GROUPS[group].display_factor, scaled)
    return tuple(total.result() for total in sums)


class _Sums:
    """Sums and maxima of errors by estimator, level and group."""

    def __init__(self, trials: Trials, axis: Axis | None, rows: Indices) -> None:
        levels = (np.zeros(trials.table.num_rows, dtype=np.intp), 1) if axis is None else (axis.codes, len(axis.labels))
        cell, self._size = cells((trials.estimator, len(trials.header.estimators)), levels)
        self._axis, self._cell = axis, cell[rows]
        self._shape = (len(trials.header.estimators), levels[1], len(GROUPS))
        self._count = np.zeros((self._size, len(GROUPS)), dtype=np.int64)
        self._square, self._largest, self._square_in_sigma, self._largest_in_sigma = np.zeros(
            (4, self._size, len(GROUPS))
        )

    def add(self, group: int, chosen: Mask, error: Array, scaled: Array) -> None:
        """Add the errors of one parameter, in display units and in sigmas."""
        cell, error, scaled = self._cell[chosen], np.abs(error[chosen]), np.abs(scaled[chosen])
        self._count[:, group] += np.bincount(cell, minlength=self._size)
        self._square[:, group] += np.bincount(cell, error**2, self._size)
        self._square_in_sigma[:, group] += np.bincount(cell, scaled**2, self._size)
        np.maximum.at(self._largest[:, group], cell, error)
        np.maximum.at(self._largest_in_sigma[:, group], cell, scaled)

    def result(self) -> Accuracy:
        """Give rms and maxima."""
        count = self._count.reshape(self._shape)
        some = np.where(count > 0, 1.0, np.nan)
        n = np.maximum(count, 1)
        return Accuracy(
            self._axis,
            count,
            np.sqrt(self._square.reshape(self._shape) / n) * some,
            self._largest.reshape(self._shape) * some,
            np.sqrt(self._square_in_sigma.reshape(self._shape) / n) * some,
            self._largest_in_sigma.reshape(self._shape) * some,
        )


def honesty(trials: Trials) -> Honesty | None:
    """Judge the sigmas of the converged trials; None for a campaign without noise, whose sigmas are floors.

    Parameters
    ----------
    trials : Trials
    """
    if not trials.header.noisy:
        return None
    number = len(trials.header.estimators)
    chosen = np.flatnonzero(trials.converged)
    estimator = trials.estimator[chosen]
    count, square, covered = np.zeros((3, number, N_PARAMETERS))
    for k, name in enumerate(NAMES):
        error, sigma = trials.numbers(f"error_{name}")[chosen], trials.numbers(f"sigma_{name}")[chosen]
        seen = np.isfinite(error) & np.isfinite(sigma) & (sigma > 0.0)
        scaled, of = error[seen] / sigma[seen], estimator[seen]
        count[:, k] = np.bincount(of, minlength=number)
        square[:, k] = np.bincount(of, scaled**2, number)
        covered[:, k] = np.bincount(of, np.abs(scaled) <= _TWO_SIDED_95, number)
    nees, observed = trials.numbers("nees")[chosen], trials.numbers("observed")[chosen]
    seen = np.isfinite(nees) & (observed > 0)
    units = np.bincount(estimator[seen], minlength=number)
    freedom = np.bincount(estimator[seen], observed[seen], number).astype(np.float64)
    chi_square = np.bincount(estimator[seen], nees[seen], number)
    judged = int(np.count_nonzero(count) + np.count_nonzero(units))
    tail = 0.5 * FALSE_ALARMS / max(judged, 1)
    low, high = _rms_limits(count, tail)
    nees_low, nees_high = _rms_limits(freedom, tail)
    some = np.where(count > 0, 1.0, np.nan)
    n = np.maximum(count, 1.0)
    coverage_low, coverage_high = share_interval(covered, count)
    return Honesty(
        count=count.astype(np.int64),
        rms=np.sqrt(square / n) * some,
        half_width=BAND / np.sqrt(2.0 * n) * some,
        low=low,
        high=high,
        coverage=covered / n * some,
        coverage_low=coverage_low * some,
        coverage_high=coverage_high * some,
        nees=np.where(freedom > 0, chi_square / np.maximum(freedom, 1.0), np.nan),
        nees_low=nees_low**2,
        nees_high=nees_high**2,
        units=units,
    )


def _rms_limits(freedom: Array, tail: float) -> tuple[Array, Array]:
    """Limits of the rms of so many standard normal numbers, each passed with the chance ``tail``."""
    n = np.where(freedom > 0, freedom, np.nan)
    return np.sqrt(chdtri(n, 1.0 - tail) / n), np.sqrt(chdtri(n, tail) / n)
