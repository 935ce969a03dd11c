"""The table of a campaign as arrays: which estimator, outcome and level of each axis every row belongs to.

Everything that is asked of a campaign is a count, a sum or a maximum over such codes, so rows are never looped over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from sims.robustness.trial import OUTCOMES as TRIAL_OUTCOMES
from srt.exceptions import DataError, InputError
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pyarrow as pa

    from srt.types import Array, Counts, Indices, Mask


OUTCOMES: Final = tuple(TRIAL_OUTCOMES)
"""What can become of a trial; the last is left out of every rate."""
CONVERGED: Final = OUTCOMES.index("converged")
NO_IMU: Final = OUTCOMES.index("no_imu")

BINS: Final = 8
"""Into which the values of a random axis are sorted, as many in each."""
_MOST_LEVELS: Final = 12
"""Of a random axis up to which its values stand as they are."""
_COLUMNS: Final = ("point", "replicate", "seed", "estimator", "outcome", "message", "playbacks", "distance")
_NUMBERS: Final = ("nees", "observed", "simulate_s", "calibrate_s")


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """A quantity that the campaign varies, cut into levels.

    Attributes
    ----------
    name : str
        Of the axis and of its column.
    on_grid : bool
        Else drawn anew by every trial.
    labels : tuple of str
        One per level.
    places : ndarray, shape (levels,)
        Where a level lies: its value, of a bin the middle; NaN throughout if the values are words.
    codes : ndarray of int, shape (rows,)
        Level of every row.
    values : ndarray, shape (rows,)
        Value of every row; NaN throughout if the values are words.
    """

    name: str
    on_grid: bool
    labels: tuple[str, ...]
    places: Array
    codes: Indices
    values: Array

    @property
    def numeric(self) -> bool:
        """Whether its levels are numbers."""
        return bool(np.isfinite(self.places).all()) and len(self.labels) > 0


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Rows of a campaign's table: one per trial and estimator.

    Attributes
    ----------
    header : Header
    table : pyarrow.Table
    estimator, outcome : ndarray of int, shape (rows,)
        Positions in ``header.estimators`` and in :data:`OUTCOMES`.
    point : ndarray of int, shape (rows,)
        Position in ``points``.
    points : ndarray of int, shape (points,)
        Numbers of the grid's points that were tried, rising.
    axes : tuple of Axis
        Those of the grid, then the random ones.
    """

    header: Header
    table: pa.Table
    estimator: Indices
    outcome: Indices
    point: Indices
    points: Counts
    axes: tuple[Axis, ...]

    @property
    def judged(self) -> Mask:
        """Rows whose drawn errors are those of an IMU, shape (rows,)."""
        return np.asarray(self.outcome != NO_IMU)

    @property
    def converged(self) -> Mask:
        """Rows that converged to the right result, shape (rows,)."""
        return np.asarray(self.outcome == CONVERGED)

    def numbers(self, name: str) -> Array:
        """A column of numbers, shape (rows,); NaN where it has none."""
        return _numbers(self.table, name)

    def rows(self, name: str, at: Indices) -> list[Any]:
        """Values of a column in a few rows."""
        return [] if name not in self.table.column_names else list(self.table.column(name).take(at).to_pylist())

    def first_rows(self) -> Indices:
        """Give one row of every unit, which has one for each estimator."""
        replicate = np.unique(self.numbers("replicate"), return_inverse=True)[1].astype(np.intp)
        unit, _ = cells((self.point, len(self.points)), (replicate, int(replicate.max(initial=0)) + 1))
        return np.asarray(np.unique(unit, return_index=True)[1])

    def axis(self, name: str) -> Axis:
        """An axis by its name.

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


def read(table: pa.Table, header: Header) -> Trials:
    """Check the table of a campaign and code its rows.

    Parameters
    ----------
    table : pyarrow.Table
        One row per trial and estimator; one without rows may lack columns.
    header : Header

    Raises
    ------
    InputError
        A column that is missing, or an outcome or estimator that is not known.
    DataError
        A trial that is there twice.
    """
    wanted = (*_COLUMNS, *_NUMBERS, *header.grid, *header.random)
    wanted += tuple(f"{kind}_{name}" for kind in ("error", "sigma") for name in NAMES)
    missing = [name for name in wanted if name not in table.column_names]
    if missing and table.num_rows:
        raise InputError(
            f"The table of the campaign {header.name} lacks the column {missing[0]!r}: give the table of a campaign, "
            "with all columns."
        )
    estimator = _positions(table, "estimator", header.estimators, header.name)
    outcome = _positions(table, "outcome", OUTCOMES, header.name)
    number = _integers(table, "point")
    points, point = np.unique(number, return_inverse=True)
    _check_once(number, _integers(table, "replicate"), estimator, header)
    axes = [_grid_axis(table, name, values) for name, values in header.grid.items()]
    axes += [_random_axis(table, name) for name in header.random]
    return Trials(header, table, estimator, outcome, np.asarray(point, dtype=np.intp), points, tuple(axes))


def cells(*codes: tuple[Indices, int]) -> tuple[Indices, int]:
    """Join several codes, each with the number of its values, to one; the last varies fastest."""
    joined, size = np.zeros(len(codes[0][0]), dtype=np.intp), 1
    for code, n in codes:
        joined, size = joined * n + code, size * n
    return joined, size


def label(value: object) -> str:
    """Give a value of an axis as people write it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else "not set" if value is None else str(value)


def _encoded(table: pa.Table, name: str) -> tuple[Indices, list[Any]]:
    """Position of every row's value in a list of the values that occur; None stands for none."""
    if name not in table.column_names:
        return np.zeros(0, dtype=np.intp), []
    column = table.column(name).combine_chunks().dictionary_encode()
    values = column.dictionary.to_pylist()
    indices = column.indices
    if indices.null_count:
        indices, values = indices.fill_null(len(values)), [*values, None]
    return np.asarray(indices.to_numpy(zero_copy_only=False), dtype=np.intp), values


def _numbers(table: pa.Table, name: str) -> Array:
    if name not in table.column_names:
        return np.zeros(0)
    return np.asarray(table.column(name).to_numpy(), dtype=np.float64)


def _integers(table: pa.Table, name: str) -> Counts:
    if name not in table.column_names:
        return np.zeros(0, dtype=np.int64)
    return np.asarray(table.column(name).to_numpy(), dtype=np.int64)


def _positions(table: pa.Table, name: str, known: Sequence[str], campaign: str) -> Indices:
    codes, values = _encoded(table, name)
    unknown = next((value for value in values if value not in known), None)
    if any(value not in known for value in values):
        raise InputError(
            f"The table of the campaign {campaign} has the {name} {unknown!r}: it must be one of {', '.join(known)}."
        )
    return np.array([known.index(value) for value in values], dtype=np.intp)[codes] if values else codes


def _check_once(point: Counts, replicate: Counts, estimator: Indices, header: Header) -> None:
    """Refuse a trial that is there twice: it would count twice."""
    order = np.lexsort((estimator, replicate, point))
    same = np.ones(max(len(order) - 1, 0), dtype=bool)
    for column in (point, replicate, estimator):
        same &= np.diff(column[order]) == 0
    if same.any():
        at = order[int(np.argmax(same))]
        raise DataError(
            f"The table of the campaign {header.name} has trial {point[at]}:{replicate[at]} of "
            f"{header.estimators[estimator[at]]} twice: keep one row of every trial and estimator."
        )


def _grid_axis(table: pa.Table, name: str, stated: Sequence[Any]) -> Axis:
    """Levels as the campaign lists them, tried or not; values beside them come last."""
    codes, found = _encoded(table, name)
    levels = list(dict.fromkeys(stated))
    if found and all(isinstance(value, str) for value in found):
        levels = [value if isinstance(value, str) else label(value) for value in levels]
    levels += sorted((value for value in found if value not in levels), key=lambda v: (str(type(v)), v))
    if _are_numbers(levels):
        levels.sort()
    order = np.array([levels.index(value) for value in found], dtype=np.intp)
    return _axis(name, on_grid=True, levels=levels, codes=order[codes] if found else codes)


def _random_axis(table: pa.Table, name: str) -> Axis:
    """Levels as drawn if they are few or words; else bins with as many rows in each."""
    codes, found = _encoded(table, name)
    if len(found) <= _MOST_LEVELS or not _are_numbers(found):
        order = sorted(range(len(found)), key=lambda k: (str(type(found[k])), 0 if found[k] is None else found[k]))
        rank = np.empty(len(found), dtype=np.intp)
        rank[order] = np.arange(len(found))
        return _axis(name, on_grid=False, levels=[found[k] for k in order], codes=rank[codes] if found else codes)
    values = np.array(found, dtype=np.float64)[codes]
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    binned = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    labels = tuple(f"{low:.3g}–{high:.3g}" for low, high in pairwise(edges))
    return Axis(name, False, labels, 0.5 * (edges[:-1] + edges[1:]), np.asarray(binned, dtype=np.intp), values)


def _axis(name: str, *, on_grid: bool, levels: list[Any], codes: Indices) -> Axis:
    places = np.array(levels, dtype=np.float64) if _are_numbers(levels) else np.full(len(levels), np.nan)
    values = places[codes] if len(levels) else np.zeros(0)
    return Axis(name, on_grid, tuple(label(value) for value in levels), places, codes, values)


def _are_numbers(values: Sequence[Any]) -> bool:
    return all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)


@dataclass(frozen=True, slots=True)
class Header:
    """What a campaign is.

    Attributes
    ----------
    name, description : str
    seed : int
    trials : int
        Planned of every point of the grid.
    grid : mapping of str to sequence
        Values of every axis of the grid.
    random : mapping of str to str
        Distribution of every quantity that each trial draws, in words.
    estimators : tuple of str
        Labels, in the order of the file.
    noisy : bool
        Whether the recordings have noise; without it a sigma is a floor and says nothing of the error.
    replay : str
        Start of the command that repeats a trial; "POINT:REPLICATE" completes it.
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

    @property
    def planned(self) -> int:
        """Trials of the whole campaign."""
        return self.trials * math.prod(len(values) for values in self.grid.values())
