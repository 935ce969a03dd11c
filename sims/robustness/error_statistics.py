"""Errors of the converged trials, and their consistency with the reported sigmas.

Let r = error / sigma of a parameter in n units. If sigma is consistent, n·rms(r)² has a chi-square distribution with n
degrees of freedom, and rms(r) is within 1 ± 3.5/√(2n) with a probability of 99.95 %. A campaign tests many parameters
of several estimators. Sigmas outside the limits are called inconsistent; the limits give a 1 % family-wise false-alarm
rate. Each test has an equal part of the 1 % (Bonferroni), which is valid for any correlation between the errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd
from scipy.special import betaincinv, chdtri

from sims.robustness.campaign import AXES
from srt.sensor_errors import GROUPS, NAMES

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from sims.robustness.trial_table import AxisLevels, TrialTable
    from srt.types import Array


CONFIDENCE: Final = 0.95
"""Confidence of the intervals of shares, two-sided."""
FALSE_ALARM: Final = 0.01
"""Probability that at least one sigma is called inconsistent although all are consistent."""
BAND: Final = 3.5
"""Half width of the single-parameter band of an rms, in standard errors of the rms."""
NEAR_SIGMAS: Final = 5.0
"""Largest error over sigma of an estimate that counts as right."""
NEAR_SHARE: Final = 0.01
"""Largest error, as a share of the errors before the calibration, of an estimate that counts as close."""
_TWO_SIDED_95: Final = 1.959964
"""Half width of the 95 % interval of a normal error, sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Errors of converged trials by estimator, level of an axis and group of parameters.

    Attributes
    ----------
    axis : AxisLevels or None
        Axis of the levels; None: one level with all trials.
    table : pandas.DataFrame
        Indexed by estimator, number of the level and group, all combinations. ``count``: errors, one per trial and
        estimated parameter of the group; ``rms`` and ``largest`` error in the display unit of the group;
        ``rms_in_sigma`` and ``largest_in_sigma``: of error / sigma. NaN for an empty cell.
    shape : (int, int, int)
        Numbers of estimators, levels and groups.
    """

    axis: AxisLevels | None
    table: pd.DataFrame
    shape: tuple[int, int, int]

    def array(self, column: str) -> Array:
        """One column of the table in its shape (estimators, levels, groups)."""
        return np.asarray(self.table[column]).reshape(self.shape)


@dataclass(frozen=True, slots=True, eq=False)
class SigmaConsistency:
    """Errors over sigmas of the converged trials of a noisy campaign.

    Attributes
    ----------
    parameters : pandas.DataFrame
        By estimator and parameter. ``count``: trials; ``rms`` of error / sigma, 1 if consistent; ``half_width``: half
        width of the single-parameter band around 1, 3.5/√(2n); ``low``, ``high``: Bonferroni limits of ``rms``;
        ``too_small``: sigma too small, rms > high; ``too_large``: sigma too large, rms < low; ``coverage``: share of
        the errors within their 95 % interval; ``coverage_low``, ``coverage_high``: 95 % interval of that share.
    nees : pandas.DataFrame
        By estimator. ``units``: trials; ``nees``: mean NEES (normalised estimation error squared) per degree of
        freedom; ``low``, ``high``: its limits; ``inconsistent``: NEES outside the limits.
    """

    parameters: pd.DataFrame
    nees: pd.DataFrame


def sigma_shares(trials: TrialTable) -> pd.DataFrame:
    """Convergence and consistency of the sigmas together, by estimator.

    Parameters
    ----------
    trials : TrialTable

    Returns
    -------
    pandas.DataFrame
        ``judged`` trials; ``estimates``: trials with an estimate of any status; ``converged``; ``within`` and
        ``beyond``: converged with the errors within or beyond their sigmas; ``nees``: median NEES per degree of freedom
        of the converged trials; ``nees_all``: of all estimates.
    """
    frame = trials.frame
    ratio = frame["nees"] / frame["observed"].where(frame["observed"] > 0)
    columns = pd.DataFrame({
        "estimator": frame["estimator"],
        "judged": trials.judged,
        "estimates": ratio.notna(),
        "converged": trials.converged,
        "within": trials.converged & ~trials.beyond,
        "beyond": trials.beyond,
        "nees": ratio.where(trials.converged),
        "nees_all": ratio,
    })  # fmt: skip
    medians = dict.fromkeys(("nees", "nees_all"), "median")
    counts = dict.fromkeys(("judged", "estimates", "converged", "within", "beyond"), "sum")
    return columns.groupby("estimator", observed=False).agg(counts | medians).reindex(list(trials.header.estimators))


def scores_by_level(trials: TrialTable, axis: AxisLevels) -> pd.DataFrame:
    """Errors of all estimates, of any status, by estimator and level of an axis.

    Parameters
    ----------
    trials : TrialTable
    axis : AxisLevels

    Returns
    -------
    pandas.DataFrame
        ``judged`` trials; of these, but for inconsistent results, ``right``: with all errors within
        :data:`NEAR_SIGMAS`, and ``close``: with all errors whose size the axis states within :data:`NEAR_SHARE` of that
        size, zero if it states none; medians over the estimates: ``nees`` per degree of freedom, ``largest`` error over
        sigma; over the trials: ``seconds`` of CPU.
    """
    frame = trials.frame
    stated = AXES.get(axis.name)
    worst = np.full(len(frame), np.nan)
    for group in GROUPS:
        if stated is not None and stated.error and any(f".{group.name}_" in key for key in stated.keys):
            for suffix in group.suffixes:
                error = trials.table.column(f"error_{group.name}_{suffix}").to_numpy().astype(np.float64)
                worst = np.fmax(worst, np.abs(error) * group.display_factor)
    limit = NEAR_SHARE * axis.values * (1.0 if stated is None else stated.factor)
    accepted = frame["outcome"] != "inconsistent"  # its sigmas cover any error
    columns = pd.DataFrame({
        "estimator": frame["estimator"],
        "level": axis.codes,
        "judged": trials.judged,
        "right": accepted & (frame["largest"] <= NEAR_SIGMAS),
        "close": accepted & (worst <= limit),
        "nees": frame["nees"] / frame["observed"].where(frame["observed"] > 0),
        "largest": frame["largest"],
        "seconds": frame["calibrate_s"],
    })  # fmt: skip
    kinds = dict.fromkeys(("judged", "right", "close"), "sum") | dict.fromkeys(("nees", "largest", "seconds"), "median")
    return columns[trials.judged].groupby(["estimator", "level"], observed=False).agg(kinds)


def innovation_medians(trials: TrialTable) -> pd.DataFrame:
    """Median of the normalised innovations squared over their degrees of freedom, by filter and sequence.

    Parameters
    ----------
    trials : TrialTable

    Returns
    -------
    pandas.DataFrame
        Index: estimators with innovations. Columns: number of the sequence in the order of time, from 1, and
        ``trials``, the number of trials with an estimate.
    """
    if "nis" not in trials.table.column_names:
        return pd.DataFrame()
    listed = pd.Series(trials.table.column("nis").to_pylist(), dtype=object)
    listed = listed[listed.map(bool)]
    wide = pd.DataFrame(listed.tolist(), index=listed.index)
    wide.columns = wide.columns + 1
    groups = wide.groupby(trials.frame["estimator"].astype(object).loc[wide.index], sort=False)
    order = [name for name in trials.header.estimators if name in groups.groups]
    return groups.median().assign(trials=groups.size()).reindex(order)


def share_interval(successes: ArrayLike, trials: ArrayLike, confidence: float = CONFIDENCE) -> tuple[Array, Array]:
    """Clopper-Pearson interval of a share: its coverage is at least the stated confidence.

    Parameters
    ----------
    successes, trials : array_like of int
        Numbers in equal shapes; without trials the interval is 0 to 1.
    confidence : float
        Two-sided.

    Returns
    -------
    low, high : ndarray
    """
    k, n = np.asarray(successes, dtype=np.float64), np.asarray(trials, dtype=np.float64)
    tail = 0.5 * (1.0 - confidence)
    # A beta distribution requires positive parameters; otherwise the limit is 0 or 1.
    low = np.where(k > 0, betaincinv(np.maximum(k, 1.0), np.maximum(n - k, 0.0) + 1.0, tail), 0.0)
    high = np.where(n > k, betaincinv(k + 1.0, np.maximum(n - k, 1.0), 1.0 - tail), 1.0)
    return low, high


def accuracy(trials: TrialTable) -> tuple[Accuracy, ...]:
    """Errors of the converged trials: first for all trials together, then by level of every axis.

    Parameters
    ----------
    trials : TrialTable
    """
    axes: tuple[AxisLevels | None, ...] = (None, *trials.axes)
    tables = [_ErrorTable(trials, axis) for axis in axes]
    # One parameter after the other: those of a group together are gigabytes in a large campaign.
    for number, group in enumerate(GROUPS):
        for suffix in group.suffixes:
            found = trials.errors(f"{group.name}_{suffix}")
            size = np.abs(np.asarray(found["error"])) * group.display_factor
            scaled = np.asarray((found["error"] / found["sigma"]).where(found["sigma"] > 0.0, 0.0).abs())
            for table in tables:
                table.add(found, number, size, scaled)
    return tuple(table.accuracy() for table in tables)


class _ErrorTable:
    """Counts, sums of squares and largest values of errors by estimator, level of an axis and group."""

    def __init__(self, trials: TrialTable, axis: AxisLevels | None) -> None:
        self.axis = axis
        self.shape = (len(trials.header.estimators), 1 if axis is None else len(axis.labels), len(GROUPS))
        cells = math.prod(self.shape)
        self.count = np.zeros(cells, dtype=np.int64)
        self.squares, self.largest = np.zeros((2, cells)), np.full((2, cells), np.nan)

    def add(self, found: pd.DataFrame, group: int, *sizes: Array) -> None:
        """Add the errors of one parameter: their sizes, and those over sigma, both of shape (rows,)."""
        level = 0 if self.axis is None else self.axis.codes[found.index]
        _, levels, groups = self.shape
        cell = (np.asarray(found["estimator"]) * levels + level) * groups + group
        self.count += np.bincount(cell, minlength=len(self.count))
        for k, size in enumerate(sizes):
            self.squares[k] += np.bincount(cell, weights=size**2, minlength=len(self.count))
            np.fmax.at(self.largest[k], cell, size)

    def accuracy(self) -> Accuracy:
        """Errors of all parameters that were added."""
        names = ["estimator", "level", "group"]
        cells = pd.MultiIndex.from_product([range(n) for n in self.shape], names=names)
        rms = np.sqrt(self.squares / np.where(self.count > 0, self.count, np.nan))
        columns = {"count": self.count, "rms": rms[0], "largest": self.largest[0]}
        columns |= {"rms_in_sigma": rms[1], "largest_in_sigma": self.largest[1]}
        return Accuracy(self.axis, pd.DataFrame(columns, index=cells), self.shape)


def sigma_consistency(trials: TrialTable) -> SigmaConsistency:
    """Compare the sigmas of the converged trials with the actual errors.

    Parameters
    ----------
    trials : TrialTable
    """
    estimators = list(trials.header.estimators)
    cells = pd.MultiIndex.from_product([estimators, NAMES], names=["estimator", "parameter"])
    # Numbers of errors, of errors within their interval, and sums of squares: shape (3, estimators, parameters).
    sums = np.zeros((3, len(estimators), len(NAMES)))
    for k, name in enumerate(NAMES):
        errors = trials.errors(name)
        errors = errors[errors["sigma"] > 0.0]
        scaled = np.asarray(errors["error"] / errors["sigma"])
        for weights, by_estimator in zip((None, np.abs(scaled) <= _TWO_SIDED_95, scaled**2), sums, strict=True):
            by_estimator[:, k] = np.bincount(errors["estimator"], weights, minlength=len(estimators))
    count, covered, squares = sums.reshape(3, -1)
    some = np.where(count > 0, count, np.nan)
    columns = {"count": count.astype(np.int64), "rms": np.sqrt(squares / some), "covered": covered.astype(np.int64)}
    found = pd.DataFrame(columns | {"coverage": covered / some}, index=cells)
    seen = trials.converged & trials.frame["nees"].notna() & (trials.frame["observed"] > 0)
    rows = trials.frame.loc[seen, ["estimator", "nees", "observed"]]
    total = rows.groupby("estimator", observed=False).agg(
        units=("nees", "size"), freedom=("observed", "sum"), square=("nees", "sum")
    )
    total = total.reindex(estimators)
    tests = int((found["count"] > 0).sum() + (total["units"] > 0).sum())
    tail = 0.5 * FALSE_ALARM / max(tests, 1)
    found["low"], found["high"] = _rms_limits(found["count"], tail)
    found["half_width"] = BAND / np.sqrt(2.0 * found["count"].where(found["count"] > 0))
    interval = share_interval(found["covered"], found["count"])
    for name, values in zip(("coverage_low", "coverage_high"), interval, strict=True):
        found[name] = np.where(found["count"] > 0, values, np.nan)
    found["too_small"], found["too_large"] = found["rms"] > found["high"], found["rms"] < found["low"]
    low, high = _rms_limits(total["freedom"], tail)
    nees = total["square"] / total["freedom"].where(total["freedom"] > 0)
    beyond = (nees < low**2) | (nees > high**2)
    return SigmaConsistency(found, total[["units"]].assign(nees=nees, low=low**2, high=high**2, inconsistent=beyond))


def _rms_limits(freedom: ArrayLike, tail: float) -> tuple[Array, Array]:
    """Limits of the rms of ``freedom`` standard normal numbers, each exceeded with probability ``tail``."""
    count = np.asarray(freedom, dtype=np.float64)
    n = np.where(count > 0, count, np.nan)
    return np.sqrt(chdtri(n, 1.0 - tail) / n), np.sqrt(chdtri(n, tail) / n)
