"""Where a campaign converges: maps over two axes, and how far along each axis without a single failure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np

from sims.robustness.tidy import Axis, Trials, cells

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array, Counts, Indices, Mask


MAPS: Final = 6
"""Drawn at most: of pairs of axes."""
_CELLS: Final = 1_000_000
"""Combinations of levels that are searched for a region at most; beyond, the last axes count as anything."""


@dataclass(frozen=True, slots=True, eq=False)
class ConvergenceMap:
    """Share that converged over one axis or two, all others averaged.

    Attributes
    ----------
    across, up : Axis or None
        None where the campaign varies fewer.
    averaged : tuple of str
        The other axes.
    converged, judged : ndarray of int, shape (estimators, levels up, levels across)
    """

    across: Axis | None
    up: Axis | None
    averaged: tuple[str, ...]
    converged: Counts
    judged: Counts

    @property
    def share(self) -> Array:
        """NaN where nothing was judged."""
        return np.where(self.judged > 0, self.converged / np.maximum(self.judged, 1), np.nan)


@dataclass(frozen=True, slots=True)
class Limit:
    """How far along an axis of numbers.

    Attributes
    ----------
    axis : str
    value : float
    upward : bool
        All values up to this one; else from this one on.
    whole : bool
        Whether that is all that was tried.
    """

    axis: str
    value: float
    upward: bool
    whole: bool


@dataclass(frozen=True, slots=True)
class Reach:
    """A region where every trial of an estimator converged, whatever the axes of words were.

    Attributes
    ----------
    estimator : str
    limits : tuple of Limit
        All hold together. Empty if trials fail at the easy end of every axis, or if no axis is one of numbers.
    trials, tried : int
        In the region, and in all.
    """

    estimator: str
    limits: tuple[Limit, ...]
    trials: int
    tried: int


def percent(share: float, digits: int = 0) -> str:
    """Give a share in percent without a sign: "100" for all and "0" for none, and for nothing else.

    Parameters
    ----------
    share : float
        0 to 1.
    digits : int
        After the point.
    """
    value, step = 100.0 * share, 10.0**-digits
    if value not in (0.0, 100.0):
        value = min(max(round(value, digits), step), 100.0 - step)
        return f"{value:.{digits}f}"
    return f"{value:.0f}"


def convergence_map(trials: Trials, across: str | None = None, up: str | None = None) -> ConvergenceMap:
    """Map the share of converged trials over two axes.

    Parameters
    ----------
    trials : Trials
    across, up : str, optional
        Default: the first two, those of the grid before the random ones.

    Raises
    ------
    InputError
        If the campaign varies no such axis.
    """
    if across is None and up is None:
        across, up = pairs(trials)[0]
    axes = [None if name is None else trials.axis(name) for name in (up, across)]
    number, rows = len(trials.header.estimators), trials.table.num_rows
    levels = [(np.zeros(rows, dtype=np.intp), 1) if a is None else (a.codes, len(a.labels)) for a in axes]
    cell, size = cells((trials.estimator, number), *levels)
    shape = (number, levels[0][1], levels[1][1])
    converged, tried = (
        np.bincount(cell[chosen], minlength=size).reshape(shape) for chosen in (trials.converged, trials.judged)
    )
    averaged = tuple(axis.name for axis in trials.axes if axis.name not in (across, up))
    return ConvergenceMap(axes[1], axes[0], averaged, converged, tried)


def pairs(trials: Trials) -> Sequence[tuple[str | None, str | None]]:
    """Give the pairs of axes that maps are of: those of the grid that have several values, or random ones beside one.

    Parameters
    ----------
    trials : Trials

    Returns
    -------
    sequence of (str or None, str or None)
        The first two axes first; at most :data:`MAPS`.
    """
    names = [axis.name for axis in trials.axes if axis.on_grid and len(axis.labels) > 1]
    if len(names) < 2:
        names = [axis.name for axis in trials.axes if len(axis.labels) > 1]
    if len(names) < 2:
        return [(names[0] if names else None, None)]
    return list(combinations(names, 2))[:MAPS]


def reach(trials: Trials) -> tuple[Reach, ...]:
    """Find how far each estimator converged without exception: the largest such region that begins at the easy end.

    The easy end of an axis is where fewer trials fail: small values of an error, and perhaps large ones of a time. Of
    all boxes of levels from there without a failure, the one with most trials counts.

    Parameters
    ----------
    trials : Trials

    Returns
    -------
    tuple of Reach
        Of the estimators that have a trial to judge.
    """
    axes = [axis for axis in trials.axes if axis.numeric and len(axis.labels) > 1]
    # What a campaign asks about is its grid; of what is merely drawn a region says little.
    axes = [axis for axis in axes if axis.on_grid] or axes
    while math.prod(len(axis.labels) for axis in axes) > _CELLS:
        axes = axes[:-1]
    found = []
    for k, name in enumerate(trials.header.estimators):
        rows = np.flatnonzero(trials.judged & (trials.estimator == k))
        if len(rows):
            found.append(_reach(name, axes, rows, ~trials.converged[rows]))
    return tuple(found)


def _reach(name: str, axes: Sequence[Axis], rows: Indices, failed: Mask) -> Reach:
    values = np.array([axis.values[rows] for axis in axes]).reshape(len(axes), len(rows))
    upward = np.array([not failed.any() or v[failed].mean() >= v.mean() for v in values], dtype=bool)
    codes = [
        axis.codes[rows] if up else len(axis.labels) - 1 - axis.codes[rows]
        for axis, up in zip(axes, upward, strict=True)
    ]
    signed = np.where(upward[:, None], values, -values)
    limits = _box(codes, [len(axis.labels) for axis in axes], signed, failed)
    if limits is None:
        return Reach(name, (), 0, len(rows))
    # Levels are coarse for what is drawn at random: each limit moves on to the first failure beyond it.
    for i in range(len(axes)):
        others = np.delete(signed <= limits[:, None], i, axis=0).all(axis=0)
        first = signed[i, others & failed].min(initial=np.inf)
        limits[i] = signed[i, others & (signed[i] < first)].max(initial=limits[i])
    inside = (signed <= limits[:, None]).all(axis=0)
    shown = tuple(
        Limit(axis.name, float(limit if up else -limit), bool(up), bool(limit >= own.max()))
        for axis, limit, up, own in zip(axes, limits, upward, signed, strict=True)
    )
    return (
        Reach(name, shown, int(np.count_nonzero(inside)), len(rows)) if inside.any() else Reach(name, (), 0, len(rows))
    )


def _box(codes: Sequence[Indices], levels: Sequence[int], values: Array, failed: Mask) -> Array | None:
    """Largest values in the box of levels, from the first on, with most trials and no failure; None without one."""
    if not levels:
        return None
    cell, size = cells(*zip(codes, levels, strict=True))
    tried, wrong = (np.bincount(cell[of], minlength=size).reshape(levels) for of in (failed | True, failed))
    for axis in range(len(levels)):
        tried, wrong = tried.cumsum(axis=axis), wrong.cumsum(axis=axis)
    tried[wrong > 0] = 0
    if not tried.any():
        # Along a single axis of numbers that are all different, there may still be something before the first failure.
        return np.full(1, -np.inf) if len(levels) == 1 else None
    last = np.unravel_index(int(np.argmax(tried)), tried.shape)
    inside = np.all([code <= k for code, k in zip(codes, last, strict=True)], axis=0)
    return np.asarray(values[:, inside].max(axis=1))
