"""Convergence of a campaign: maps over two axes, and the largest region without a failure.

Judged trials are trials with a physically possible IMU; only these enter the rates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sims.robustness.trial_table import AxisLevels, TrialTable
    from srt.types import Array, Counts, Indices, Mask


MAPS: Final = 6
"""Maximum number of maps, one per pair of axes."""
_CELLS: Final = 1_000_000
"""Maximum number of combinations of levels in the search for a region; the last axes are dropped to stay below it."""


@dataclass(frozen=True, slots=True, eq=False)
class ConvergenceMap:
    """Share of converged trials over one or two axes, averaged over all others.

    Attributes
    ----------
    across, up : AxisLevels or None
        None if the campaign varies fewer axes.
    averaged : tuple of str
        The other axes.
    converged, judged : ndarray of int, shape (estimators, levels up, levels across)
    beyond : ndarray of int, same shape
        Converged trials with errors beyond their sigmas; zero without noise.
    """

    across: AxisLevels | None
    up: AxisLevels | None
    averaged: tuple[str, ...]
    converged: Counts
    judged: Counts
    beyond: Counts

    @property
    def share(self) -> Array:
        """Ratio of converged to judged trials; NaN if there are none."""
        return np.where(self.judged > 0, self.converged / np.maximum(self.judged, 1), np.nan)

    @property
    def share_beyond(self) -> Array:
        """Ratio of trials that converged with errors beyond their sigmas to judged trials; NaN if there are none."""
        return np.where(self.judged > 0, self.beyond / np.maximum(self.judged, 1), np.nan)


@dataclass(frozen=True, slots=True)
class AxisLimit:
    """Limit of a region along a numeric axis.

    Attributes
    ----------
    axis : str
    value : float
    upward : bool
        True: the region contains values up to ``value``; False: values from ``value`` on.
    whole : bool
        True if the region contains all tried values of the axis.
    """

    axis: str
    value: float
    upward: bool
    whole: bool


@dataclass(frozen=True, slots=True)
class ConvergenceRegion:
    """Region where every trial of an estimator converged, over all levels of the categorical axes.

    Attributes
    ----------
    estimator : str
    limits : tuple of AxisLimit
        Limits that apply jointly; empty if trials fail at the easy end of all axes or if no axis is numeric.
    trials, tried : int
        Judged trials in the region; judged trials in total.
    """

    estimator: str
    limits: tuple[AxisLimit, ...]
    trials: int
    tried: int


def percent(share: float, digits: int = 0) -> str:
    """Text of a share in percent, without the % sign; "100" means all and "0" means none, without rounding.

    Parameters
    ----------
    share : float
        0 to 1.
    digits : int
        Digits after the decimal point.
    """
    value, step = 100.0 * share, 10.0**-digits
    if value not in (0.0, 100.0):
        value = min(max(round(value, digits), step), 100.0 - step)
        return f"{value:.{digits}f}"
    return f"{value:.0f}"


def convergence_map(trials: TrialTable, across: str | None = None, up: str | None = None) -> ConvergenceMap:
    """Map the share of converged trials over two axes.

    Parameters
    ----------
    trials : TrialTable
    across, up : str, optional
        Axes of the map; default: the first two (grid axes precede random ones).

    Raises
    ------
    InputError
        If the campaign does not vary an axis.
    """
    if across is None and up is None:
        across, up = axis_pairs(trials)[0]
    axes = [None if name is None else trials.axis(name) for name in (up, across)]
    shape = (len(trials.header.estimators), *(1 if axis is None else len(axis.labels) for axis in axes))
    codes = [trials.estimator, *(np.zeros_like(trials.estimator) if axis is None else axis.codes for axis in axes)]
    converged, tried, beyond = (
        count_cells([code[chosen] for code in codes], shape)
        for chosen in (trials.converged, trials.judged, trials.beyond)
    )
    averaged = tuple(axis.name for axis in trials.axes if axis.name not in (across, up))
    return ConvergenceMap(axes[1], axes[0], averaged, converged, tried, beyond)


def count_cells(codes: Sequence[Indices], shape: Sequence[int]) -> Counts:
    """Number of rows in every combination of levels: ``codes`` are the levels of the rows along each dimension."""
    cell = np.ravel_multi_index(tuple(codes), tuple(shape)) if len(codes[0]) else np.zeros(0, dtype=np.intp)
    return np.bincount(cell, minlength=math.prod(shape)).reshape(shape)


def axis_pairs(trials: TrialTable) -> Sequence[tuple[str | None, str | None]]:
    """Pairs of axes for the maps: grid axes with several levels, and random axes if there are fewer than two of these.

    Parameters
    ----------
    trials : TrialTable

    Returns
    -------
    sequence of (str or None, str or None)
        At most :data:`MAPS` pairs; the pair of the first two axes is the first.
    """
    names = [axis.name for axis in trials.axes if axis.on_grid and len(axis.labels) > 1]
    if len(names) < 2:
        names = [axis.name for axis in trials.axes if len(axis.labels) > 1]
    if len(names) < 2:
        return [(names[0] if names else None, None)]
    return list(combinations(names, 2))[:MAPS]


def convergence_regions(trials: TrialTable) -> tuple[ConvergenceRegion, ...]:
    """Largest region without a failure that begins at the easy end of every axis, by estimator.

    The easy end of an axis is the end with fewer failures: small values of an error, or large values of a time. The
    region is the failure-free box starting at the easy ends that contains most trials.

    Parameters
    ----------
    trials : TrialTable

    Returns
    -------
    tuple of ConvergenceRegion
        One region for each estimator with judged trials.
    """
    axes = [axis for axis in trials.axes if axis.numeric and len(axis.labels) > 1]
    # A campaign studies the grid axes; random axes are used only if there is no grid axis.
    axes = [axis for axis in axes if axis.on_grid] or axes
    while math.prod(len(axis.labels) for axis in axes) > _CELLS:
        axes = axes[:-1]
    found = []
    for k, name in enumerate(trials.header.estimators):
        rows = np.flatnonzero(trials.judged & (trials.estimator == k))
        if len(rows):
            found.append(_region(name, axes, rows, ~trials.converged[rows]))
    return tuple(found)


def _region(name: str, axes: Sequence[AxisLevels], rows: Indices, failed: Mask) -> ConvergenceRegion:
    values = np.array([axis.values[rows] for axis in axes]).reshape(len(axes), len(rows))
    upward = np.array([not failed.any() or v[failed].mean() >= v.mean() for v in values], dtype=bool)
    codes = [
        axis.codes[rows] if up else len(axis.labels) - 1 - axis.codes[rows]
        for axis, up in zip(axes, upward, strict=True)
    ]
    signed = np.where(upward[:, None], values, -values)
    limits = _box(codes, [len(axis.labels) for axis in axes], signed, failed)
    if limits is None:
        return ConvergenceRegion(name, (), 0, len(rows))
    # The bins of a random axis are coarse: each limit is extended to the last value before the first failure.
    for i in range(len(axes)):
        others = np.delete(signed <= limits[:, None], i, axis=0).all(axis=0)
        first = signed[i, others & failed].min(initial=np.inf)
        limits[i] = signed[i, others & (signed[i] < first)].max(initial=limits[i])
    inside = (signed <= limits[:, None]).all(axis=0)
    shown = tuple(
        AxisLimit(axis.name, float(limit if up else -limit), bool(up), bool(limit >= own.max()))
        for axis, limit, up, own in zip(axes, limits, upward, signed, strict=True)
    )
    return (
        ConvergenceRegion(name, shown, int(np.count_nonzero(inside)), len(rows))
        if inside.any()
        else ConvergenceRegion(name, (), 0, len(rows))
    )


def _box(codes: Sequence[Indices], levels: Sequence[int], values: Array, failed: Mask) -> Array | None:
    """Largest values in the failure-free box from the first levels with most trials; None if no such box exists."""
    if not levels:
        return None
    tried, wrong = (count_cells([code[chosen] for code in codes], levels) for chosen in (failed | True, failed))
    for axis in range(len(levels)):
        tried, wrong = tried.cumsum(axis=axis), wrong.cumsum(axis=axis)
    tried[wrong > 0] = 0
    if not tried.any():
        # A single numeric axis may still have values below the first failure within its first bin.
        return np.full(1, -np.inf) if len(levels) == 1 else None
    last = np.unravel_index(int(np.argmax(tried)), tried.shape)
    inside = np.all([code <= k for code, k in zip(codes, last, strict=True)], axis=0)
    return np.asarray(values[:, inside].max(axis=1))
