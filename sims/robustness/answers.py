"""What a campaign answers: how many trials converge and where they cease to, how good they are, what they cost.

Numbers alone, from the table of a campaign; :mod:`sims.robustness.report` says them in words and
:mod:`sims.robustness.figures` draws them. Errors and sigmas are in :mod:`sims.robustness.spread`.

A rate is that of the trials whose drawn errors are those of an IMU. Of these, the ones that converged to the result
that is reached from the true errors count as converged, and no others: not those whose result could not be verified.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from sims.robustness.convergence import ConvergenceMap, Reach, convergence_map, pairs, reach
from sims.robustness.spread import Accuracy, Honesty, accuracy, honesty, share_interval
from sims.robustness.tidy import CONVERGED, NO_IMU, OUTCOMES, Axis, Header, Trials, cells, label, read

if TYPE_CHECKING:
    import pyarrow as pa

    from srt.types import Array, Counts, Indices


FAILURES: Final = 20
"""Listed of every estimator."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """What became of the trials.

    Attributes
    ----------
    counts : ndarray of int, shape (estimators, outcomes)
    of_point : ndarray of int, shape (estimators, points, outcomes)
    points : ndarray of int, shape (points,)
        Those that were tried.
    settings : tuple of dict
        Of every point: value of each axis of the grid, as text.
    trials, no_imu : int
        Units simulated, and those among them that were no IMU.
    unverified : bool
        Whether the campaign compared no result with the one that is reached from the true errors.
    """

    counts: Counts
    of_point: Counts
    points: Counts
    settings: tuple[dict[str, str], ...]
    trials: int
    no_imu: int
    unverified: bool

    @property
    def judged(self) -> Counts:
        """Trials that rates are of, shape (estimators,)."""
        return np.asarray(judged(self.counts))

    @property
    def converged(self) -> Counts:
        """Shape (estimators,)."""
        return np.asarray(self.counts[:, CONVERGED])

    @property
    def interval(self) -> tuple[Array, Array]:
        """95 % interval of the share that converged, each of shape (estimators,)."""
        return share_interval(self.converged, self.judged)


@dataclass(frozen=True, slots=True, eq=False)
class Effort:
    """Play-backs of converged trials, and CPU time of all that were judged; NaN where there is none.

    Attributes
    ----------
    playbacks : ndarray of int, shape (bins,)
        Numbers that occur, and those between them.
    histogram : ndarray of int, shape (estimators, bins)
    median, most : ndarray, shape (estimators,)
        Of play-backs.
    seconds, seconds_95 : ndarray, shape (estimators,)
        Of a calibration: median, and what 95 % stay below.
    simulate_s : float
        Of the simulation of a unit: median.
    total_s : float
        Of the whole campaign.
    """

    playbacks: Counts
    histogram: Counts
    median: Array
    most: Array
    seconds: Array
    seconds_95: Array
    simulate_s: float
    total_s: float


@dataclass(frozen=True, slots=True)
class Failure:
    """A trial that did not converge to the right result.

    Attributes
    ----------
    estimator : str
    point, replicate, seed : int
    settings : dict of str to str
        Value of every axis.
    outcome, message : str
    distance : float
        From the right result, in its tolerances; NaN if there is nothing to compare.
    replay : str
        Command that repeats it.
    """

    estimator: str
    point: int
    replicate: int
    seed: int
    settings: dict[str, str]
    outcome: str
    message: str
    distance: float
    replay: str


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """All that a campaign answers.

    Attributes
    ----------
    header : Header
    axes : tuple of Axis
    outcomes : Outcomes
    maps : tuple of ConvergenceMap
        The first two axes first.
    reach : tuple of Reach
    accuracy : tuple of Accuracy
        All trials together, then one per axis.
    honesty : Honesty or None
    effort : Effort
    failures : tuple of Failure
        The first of every estimator.
    """

    header: Header
    axes: tuple[Axis, ...]
    outcomes: Outcomes
    maps: tuple[ConvergenceMap, ...]
    reach: tuple[Reach, ...]
    accuracy: tuple[Accuracy, ...]
    honesty: Honesty | None
    effort: Effort
    failures: tuple[Failure, ...]


def answer(table: pa.Table, header: Header) -> Answers:
    """Answer everything from the table of a campaign.

    Parameters
    ----------
    table : pyarrow.Table
        One row per trial and estimator.
    header : Header

    Raises
    ------
    InputError
        A column that is missing, or an outcome or estimator that is not known.
    DataError
        A trial that is there twice.
    """
    trials = read(table, header)
    return Answers(
        header,
        trials.axes,
        outcomes(trials),
        tuple(convergence_map(trials, *pair) for pair in pairs(trials)),
        reach(trials),
        accuracy(trials),
        honesty(trials),
        effort(trials),
        failures(trials),
    )


def judged(counts: Counts) -> Counts:
    """Trials that are those of an IMU, of counts of shape (..., outcomes)."""
    return np.asarray(counts.sum(axis=-1) - counts[..., NO_IMU])


def outcomes(trials: Trials) -> Outcomes:
    """Count what became of the trials, in all and at every point of the grid."""
    shape = (len(trials.header.estimators), len(trials.points), len(OUTCOMES))
    codes = zip((trials.estimator, trials.point, trials.outcome), shape, strict=True)
    cell, size = cells(*codes)
    of_point = np.bincount(cell, minlength=size).reshape(shape)
    first = np.unique(trials.point, return_index=True)[1]
    grid = [axis for axis in trials.axes if axis.on_grid]
    settings = tuple({axis.name: axis.labels[axis.codes[row]] for axis in grid} for row in first)
    units = trials.first_rows()
    no_imu = int(np.count_nonzero(~trials.judged[units]))
    right = trials.numbers("distance")[trials.converged]
    unverified = bool(right.size) and not np.isfinite(right).any()
    return Outcomes(of_point.sum(axis=1), of_point, trials.points, settings, len(units), no_imu, unverified)


def effort(trials: Trials) -> Effort:
    """Count play-backs and CPU seconds."""
    number = len(trials.header.estimators)
    played, seconds, simulated = (trials.numbers(name) for name in ("playbacks", "calibrate_s", "simulate_s"))
    counted = trials.converged & np.isfinite(played)
    timed = trials.judged & np.isfinite(seconds)
    least, most = (int(f(played[counted])) if counted.any() else 0 for f in (np.min, np.max))
    bins = np.arange(least, most + 1) if counted.any() else np.zeros(0, dtype=np.int64)
    cell, size = cells(
        (trials.estimator[counted], number), (played[counted].astype(np.intp) - least, max(len(bins), 1))
    )
    of = [(played[counted & (trials.estimator == k)], seconds[timed & (trials.estimator == k)]) for k in range(number)]
    # A unit is simulated once, however many rows say what it took.
    simulated = simulated[trials.first_rows()] if len(simulated) else simulated
    simulated = simulated[np.isfinite(simulated)]
    return Effort(
        bins,
        np.bincount(cell, minlength=size).reshape(number, -1)[:, : len(bins)],
        np.array([_quantile(p, 0.5) for p, _ in of]),
        np.array([_quantile(p, 1.0) for p, _ in of]),
        np.array([_quantile(s, 0.5) for _, s in of]),
        np.array([_quantile(s, 0.95) for _, s in of]),
        _quantile(simulated, 0.5),
        float(simulated.sum() + seconds[timed].sum()),
    )


def _quantile(values: Array, share: float) -> float:
    return float(np.quantile(values, share)) if values.size else math.nan


def failures(trials: Trials, most: int = FAILURES) -> tuple[Failure, ...]:
    """List the first trials of every estimator that did not converge to the right result.

    Parameters
    ----------
    trials : Trials
    most : int
        Of every estimator.
    """
    failed = trials.judged & ~trials.converged
    replicate = trials.numbers("replicate")
    rows: list[Indices] = []
    for k in range(len(trials.header.estimators)):
        own = np.flatnonzero(failed & (trials.estimator == k))
        rows.append(own[np.lexsort((replicate[own], trials.points[trials.point[own]]))][:most])
    at = np.concatenate(rows) if rows else np.zeros(0, dtype=np.intp)
    columns = ("point", "replicate", "seed", "message", "distance")
    values = zip(*(trials.rows(name, at) for name in columns), strict=True)
    axes = {axis.name: trials.rows(axis.name, at) for axis in trials.axes}
    return tuple(
        Failure(
            trials.header.estimators[trials.estimator[row]],
            point,
            number,
            seed,
            {name: label(of[k]) for name, of in axes.items()},
            OUTCOMES[trials.outcome[row]],
            message or "",
            math.nan if distance is None else float(distance),
            f"{trials.header.replay}{point}:{number}",
        )
        for k, (row, (point, number, seed, message, distance)) in enumerate(zip(at, values, strict=True))
    )
