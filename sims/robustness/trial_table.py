"""Table of the trials of a campaign, one row per trial and estimator, with the level of every axis in each row."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
from scipy.special import chdtri

from sims.robustness.trial import OUTCOMES
from srt.exceptions import DataError, InputError
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pyarrow as pa

    from srt.types import Array, Indices, Mask


NEES_PROBABILITY: Final = 1e-3
"""p-value of the NEES of one unit below which its errors are beyond their sigmas."""
BINS: Final = 8
"""Number of bins of a random axis; each bin has an equal number of rows."""
_MOST_LEVELS: Final = 12
"""Largest number of distinct values of a random axis for which each value is a level."""
_COLUMNS: Final = ("point", "replicate", "seed", "estimator", "outcome", "message")
_NUMBERS: Final = ("playbacks", "distance", "nees", "largest", "observed", "simulate_s", "calibrate_s")


@dataclass(frozen=True, slots=True)
class Header:
    """Description of a campaign.

    Attributes
    ----------
    name, description : str
    seed : int
    trials : int
        Planned trials of every point of the grid.
    grid : mapping of str to sequence
        Values of every axis of the grid.
    random : mapping of str to str
        Distribution of every quantity that each trial draws, in words.
    estimators : tuple of str
        Labels, in the order of the file.
    noisy : bool
        True if the recordings have noise. Without noise a sigma is a floor and unrelated to the error.
    replay : str
        Start of the command that repeats a trial; "POINT:REPLICATE" completes it.
    trials_per_motion : int
        Successive trials with the same motion and fixture errors.
    """

    name: str
    description: str
    seed: int
    trials: int
    grid: Mapping[str, Sequence[Any]]
    random: Mapping[str, str]
    estimators: tuple[str, ...]
    noisy: bool
    replay: str
    trials_per_motion: int = 1

    @property
    def planned(self) -> int:
        """Number of trials of the whole campaign."""
        return self.trials * math.prod(len(values) for values in self.grid.values())


@dataclass(frozen=True, slots=True, eq=False)
class AxisLevels:
    """Levels of one axis: a quantity that the campaign varies.

    Attributes
    ----------
    name : str
        Name of the axis and of its column.
    on_grid : bool
        True: axis of the grid; False: every trial draws a value.
    labels : tuple of str
        One per level.
    positions : ndarray, shape (levels,)
        Value of each level, or the middle of its bin; all NaN for a categorical axis.
    codes : ndarray of int, shape (rows,)
        Level of every row.
    values : ndarray, shape (rows,)
        Value of every row; all NaN for a categorical axis.
    """

    name: str
    on_grid: bool
    labels: tuple[str, ...]
    positions: Array
    codes: Indices
    values: Array

    @property
    def numeric(self) -> bool:
        """True if the levels are numbers."""
        return bool(np.isfinite(self.positions).all()) and len(self.labels) > 0


@dataclass(frozen=True, slots=True, eq=False)
class TrialTable:
    """Trials of a campaign.

    Attributes
    ----------
    header : Header
    table : pyarrow.Table
        All columns, as stored.
    frame : pandas.DataFrame
        Columns other than errors and sigmas; ``estimator`` and ``outcome`` are categories in their order.
    axes : tuple of AxisLevels
        Axes of the grid, then the random ones.
    """

    header: Header
    table: pa.Table
    frame: pd.DataFrame
    axes: tuple[AxisLevels, ...]

    @property
    def estimator(self) -> Indices:
        """Position of the estimator of every row, shape (rows,)."""
        return np.asarray(self.frame["estimator"].cat.codes, dtype=np.intp)

    @property
    def judged(self) -> Mask:
        """Mask of the rows with a physically possible IMU, shape (rows,)."""
        return np.asarray(self.frame["outcome"] != "no_imu")

    @property
    def converged(self) -> Mask:
        """Mask of the rows that converged to the right result, shape (rows,)."""
        return np.asarray(self.frame["outcome"] == "converged")

    @property
    def beyond(self) -> Mask:
        """Mask of the converged rows with errors beyond their sigmas: NEES with p < 0.001, shape (rows,).

        No row if the recordings have no noise, because the sigmas are floors then.
        """
        nees, freedom = (np.asarray(self.frame[name], dtype=np.float64) for name in ("nees", "observed"))
        limit: Array = chdtri(np.maximum(np.nan_to_num(freedom), 1.0), NEES_PROBABILITY)
        return np.asarray(self.converged & self.header.noisy & (nees > limit))

    @property
    def units(self) -> pd.DataFrame:
        """Outcome and time of simulation of every unit; the table has one row per unit and estimator."""
        return self.frame.loc[~self.frame.duplicated(["point", "replicate"]), ["outcome", "simulate_s"]]

    def errors(self, name: str) -> pd.DataFrame:
        """Error and sigma of one parameter in the converged rows that estimate it, SI; the index is the row.

        The function reads one parameter at a time, as all columns of a large campaign are gigabytes.
        """
        names = [f"{stem}_{name}" for stem in ("error", "sigma")]
        columns = {
            stem: self.table.column(column).to_numpy().astype(np.float64) if column in self.table.column_names else []
            for stem, column in zip(("error", "sigma"), names, strict=True)
        }
        found = pd.DataFrame(columns, dtype=np.float64).assign(estimator=self.estimator)
        return found[self.converged & np.isfinite(found["error"]) & np.isfinite(found["sigma"])]

    def axis(self, name: str) -> AxisLevels:
        """Axis with a given name.

        Raises
        ------
        InputError
            If the campaign does not vary it.
        """
        for axis in self.axes:
            if axis.name == name:
                return axis
        known = ", ".join(axis.name for axis in self.axes) or "none"
        raise InputError(f"The campaign {self.header.name} does not vary {name!r}: its axes are {known}.")


def read_trials(table: pa.Table, header: Header) -> TrialTable:
    """Check the table of a campaign, and find the levels of its axes.

    Parameters
    ----------
    table : pyarrow.Table
        One row per trial and estimator; a table without rows may lack columns.
    header : Header

    Raises
    ------
    InputError
        A missing column, or an unknown outcome or estimator.
    DataError
        If a trial occurs twice.
    """
    wanted = [*_COLUMNS, *_NUMBERS, *header.grid, *header.random]
    parameters = [f"{stem}_{name}" for stem in ("error", "sigma") for name in NAMES]
    missing = [name for name in (*wanted, *parameters) if name not in table.column_names]
    if missing and table.num_rows:
        raise InputError(
            f"The table of the campaign {header.name} lacks the column {missing[0]!r}: give the table of a campaign, "
            "with all columns."
        )
    frame = table.select([name for name in wanted if name not in missing]).to_pandas().reindex(columns=wanted)
    for name, known in (("estimator", header.estimators), ("outcome", tuple(OUTCOMES))):
        unknown = frame.loc[~frame[name].isin(known), name]
        if len(unknown):
            raise InputError(
                f"The table of the campaign {header.name} has the {name} {unknown.iloc[0]!r}: it must be one of "
                f"{', '.join(known)}."
            )
        frame[name] = pd.Categorical(frame[name].astype(object), categories=list(known))
    for name in _NUMBERS:
        frame[name] = frame[name].astype(np.float64)
    twice = np.flatnonzero(frame.duplicated(["point", "replicate", "estimator"]))
    if len(twice):
        row = frame.iloc[twice[0]]
        raise DataError(
            f"The table of the campaign {header.name} has trial {row['point']}:{row['replicate']} of "
            f"{row['estimator']} twice: keep one row of every trial and estimator."
        )
    axes = [_grid_axis(frame[name], values) for name, values in header.grid.items()]
    axes += [_random_axis(frame[name]) for name in header.random]
    return TrialTable(header, table, frame, tuple(axes))


def label(value: object) -> str:
    """Text of a value of an axis."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else "not set" if value is None else str(value)


def factorized(column: pd.Series) -> tuple[Indices, list[Any]]:
    """Position of every row's value in the list of distinct values, and that list; None stands for an absent value."""
    codes, found = pd.factorize(column.astype(object), use_na_sentinel=False)
    return codes, [None if pd.isna(value) else value for value in found]


def _grid_axis(column: pd.Series, stated: Sequence[Any]) -> AxisLevels:
    """Levels in the order of the campaign file, including untried ones; other values are last."""
    codes, found = factorized(column)
    levels = list(dict.fromkeys(stated))
    if found and all(isinstance(value, str) for value in found):
        levels = [value if isinstance(value, str) else label(value) for value in levels]
    levels += sorted((value for value in found if value not in levels), key=lambda v: (str(type(v)), v))
    if _are_numbers(levels):
        levels.sort()
    return _axis(column.name, on_grid=True, levels=levels, codes=codes, found=found)


def _random_axis(column: pd.Series) -> AxisLevels:
    """Distinct values if they are few or categorical; otherwise bins with equal numbers of rows."""
    codes, found = factorized(column)
    if len(found) <= _MOST_LEVELS or not _are_numbers(found):
        levels = sorted(found, key=lambda value: (str(type(value)), 0 if value is None else value))
        return _axis(column.name, on_grid=False, levels=levels, codes=codes, found=found)
    values = np.array(found, dtype=np.float64)[codes]
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    binned = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    labels = tuple(f"{low:.3g}–{high:.3g}" for low, high in pairwise(edges))
    middles = 0.5 * (edges[:-1] + edges[1:])
    return AxisLevels(column.name, False, labels, middles, np.asarray(binned, dtype=np.intp), values)


def _axis(name: str, *, on_grid: bool, levels: list[Any], codes: Indices, found: list[Any]) -> AxisLevels:
    """Axis of ``levels``, of rows with the values ``found[codes]``."""
    codes = np.array([levels.index(value) for value in found], dtype=np.intp)[codes]
    positions = np.array(levels, dtype=np.float64) if _are_numbers(levels) else np.full(len(levels), np.nan)
    return AxisLevels(name, on_grid, tuple(label(value) for value in levels), positions, codes, positions[codes])


def _are_numbers(values: Sequence[Any]) -> bool:
    return all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)
