"""Summary of a campaign: convergence rates and regions, accuracy, consistency of the sigmas, cost and failures.

Numbers only, from the table of the trials: :mod:`sims.robustness.report` writes them as text and
:mod:`sims.robustness.figures` draws them.

Rates refer to judged trials, which are the trials with a physically possible IMU. A trial has converged if its result
equals the result of an iteration from the true errors. Unverified results do not count as converged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from sims.robustness.convergence import axis_pairs, convergence_map, convergence_regions
from sims.robustness.error_statistics import (
    accuracy,
    innovation_medians,
    scores_by_level,
    share_interval,
    sigma_consistency,
    sigma_shares,
)
from sims.robustness.trial import OUTCOMES
from sims.robustness.trial_table import factorized, label, read_trials

if TYPE_CHECKING:
    import pyarrow as pa

    from sims.robustness.convergence import ConvergenceMap, ConvergenceRegion
    from sims.robustness.error_statistics import Accuracy, SigmaConsistency
    from sims.robustness.trial_table import AxisLevels, Header, TrialTable


_PARTICULARS: Final = (
    (r"[Ss]equence '?\w+'?", "sequence …"),
    (r" \([a-z]+_[a-z_]+\)", ""),
    (r"[-−+]?\d[\d.,]*(?:e[-+]?\d+)?", "…"),
)
"""Parts of a message that differ between trials with the same cause, and what replaces them."""
FAILURES: Final = 20
"""Maximum number of failures listed for each estimator."""


@dataclass(frozen=True, slots=True, eq=False)
class Effort:
    """Iterations of the converged trials, and CPU time of all judged trials; NaN if there are none.

    Attributes
    ----------
    table : pandas.DataFrame
        By estimator: ``median`` and ``most`` iterations; ``seconds`` and ``seconds_95``, the median and the 95 %
        quantile of the CPU time of a calibration, s.
    histogram : pandas.DataFrame
        Converged trials by estimator and number of iterations.
    simulate_s, total_s : float
        CPU time: median simulation of a unit, and whole campaign, s.
    """

    table: pd.DataFrame
    histogram: pd.DataFrame
    simulate_s: float
    total_s: float


@dataclass(frozen=True, slots=True, eq=False)
class CampaignSummary:
    """Results of a campaign.

    Attributes
    ----------
    header : Header
    axes : tuple of AxisLevels
    units, impossible : int
        Number of simulated units, and number of those that are no physically possible IMU.
    unverified : bool
        True if no result was compared with that from the true errors.
    outcomes : pandas.DataFrame
        By estimator: number of trials of every outcome, ``judged`` trials, and the 95 % interval ``low`` to ``high`` of
        the share that converged.
    points : pandas.DataFrame
        As ``outcomes``, by point of the grid and estimator.
    settings : pandas.DataFrame
        By point: value of each axis of the grid, as text.
    maps : tuple of ConvergenceMap
        Map of the first two axes first.
    regions : tuple of ConvergenceRegion
    accuracy : tuple of Accuracy
        First all trials together, then by level of each axis.
    consistency : SigmaConsistency or None
        Consistency of the sigmas; None if the recordings have no noise.
    shares : pandas.DataFrame
        Convergence and consistency of the sigmas together, by estimator: :func:`error_statistics.sigma_shares`.
    scores : pandas.DataFrame or None
        Errors by estimator and level of the axis, :func:`error_statistics.scores_by_level`; None with several.
    innovations : pandas.DataFrame
        Innovations by filter and sequence: :func:`error_statistics.innovation_medians`.
    effort : Effort
    causes : pandas.DataFrame
        Failed trials by ``estimator``, ``outcome`` and ``cause`` (message without numbers), with their ``number``.
    failures : pandas.DataFrame
        First failed trials of every estimator.
    """

    header: Header
    axes: tuple[AxisLevels, ...]
    units: int
    impossible: int
    unverified: bool
    outcomes: pd.DataFrame
    points: pd.DataFrame
    settings: pd.DataFrame
    maps: tuple[ConvergenceMap, ...]
    regions: tuple[ConvergenceRegion, ...]
    accuracy: tuple[Accuracy, ...]
    consistency: SigmaConsistency | None
    shares: pd.DataFrame
    scores: pd.DataFrame | None
    innovations: pd.DataFrame
    effort: Effort
    causes: pd.DataFrame
    failures: pd.DataFrame


def summarise(table: pa.Table, header: Header) -> CampaignSummary:
    """Summarise the table of a campaign.

    Parameters
    ----------
    table : pyarrow.Table
        One row per trial and estimator.
    header : Header

    Raises
    ------
    InputError
        A missing column, or an unknown outcome or estimator.
    DataError
        If a trial occurs twice.
    """
    trials = read_trials(table, header)
    units, frame = trials.units, trials.frame
    counts = frame.groupby(["point", "estimator", "outcome"], observed=False).size().unstack("outcome")
    counts = counts.set_axis(counts.columns.astype(object), axis=1).reindex(columns=list(OUTCOMES), fill_value=0)
    first = frame.loc[~frame.duplicated("point"), ["point"]].sort_values("point")
    grid = {a.name: np.array(a.labels, dtype=object)[a.codes[first.index]] for a in trials.axes if a.on_grid}
    distances = frame.loc[trials.converged, "distance"]
    maps = tuple(convergence_map(trials, *pair) for pair in axis_pairs(trials))
    only = maps[0].across if maps[0].up is None else None
    return CampaignSummary(
        header,
        trials.axes,
        units=len(units),
        impossible=int((units["outcome"] == "no_imu").sum()),
        unverified=len(distances) > 0 and bool(distances.isna().all()),
        outcomes=_with_rates(counts.groupby("estimator", observed=False).sum().reindex(list(header.estimators))),
        points=_with_rates(counts),
        settings=pd.DataFrame(grid, index=first["point"]),
        maps=maps,
        regions=convergence_regions(trials),
        accuracy=accuracy(trials),
        consistency=sigma_consistency(trials) if header.noisy else None,
        shares=sigma_shares(trials),
        scores=scores_by_level(trials, only) if only is not None and len(units) else None,
        innovations=innovation_medians(trials),
        effort=effort(trials),
        causes=causes(trials),
        failures=failures(trials),
    )


def _with_rates(counts: pd.DataFrame) -> pd.DataFrame:
    """Number of trials by outcome, number of judged trials, and 95 % interval of the share of converged ones."""
    counts = counts.fillna(0).astype(np.int64)
    judged = counts.sum(axis=1) - counts["no_imu"]
    low, high = share_interval(counts["converged"], judged)
    return counts.assign(judged=judged, low=low, high=high)


def effort(trials: TrialTable) -> Effort:
    """Count iterations and CPU seconds.

    Parameters
    ----------
    trials : TrialTable
    """
    converged = trials.frame.loc[trials.converged, ["estimator", "playbacks"]]
    judged = trials.frame.loc[trials.judged, ["estimator", "calibrate_s"]]
    played = converged.groupby("estimator", observed=False)["playbacks"]
    seconds = judged.groupby("estimator", observed=False)["calibrate_s"]
    table = pd.DataFrame(
        {
            "median": played.median(),
            "most": played.max(),
            "seconds": seconds.median(),
            "seconds_95": seconds.quantile(0.95),
        }
    )
    number = converged["playbacks"].dropna().astype(np.int64)
    bins = np.arange(number.min(), number.max() + 1) if len(number) else np.zeros(0, dtype=np.int64)
    histogram = pd.crosstab(converged["estimator"].astype(object), number)
    # The rows of all estimators repeat the duration of the one simulation of the unit.
    simulated = trials.units["simulate_s"]
    return Effort(
        table.reindex(list(trials.header.estimators)),
        histogram.reindex(index=list(trials.header.estimators), columns=bins, fill_value=0),
        float(simulated.median()),
        float(simulated.sum() + judged["calibrate_s"].sum()),
    )


def causes(trials: TrialTable) -> pd.DataFrame:
    """Count the failed trials by estimator, outcome and cause, the most frequent first.

    Parameters
    ----------
    trials : TrialTable

    Returns
    -------
    pandas.DataFrame
        Columns ``estimator``, ``outcome``, ``cause`` and ``number``. A cause is a message without its numbers, names of
        sequences and parameters.
    """
    failed = trials.frame[trials.judged & ~trials.converged]
    cause = failed["message"].astype(object).fillna("")
    for pattern, shown in _PARTICULARS:
        cause = cause.str.replace(pattern, shown, regex=True)
    groups = failed.astype({"estimator": object, "outcome": object}).assign(cause=cause)
    found = groups.groupby(["estimator", "outcome", "cause"]).size().rename("number").reset_index()
    found["estimator"] = pd.Categorical(found["estimator"], categories=list(trials.header.estimators))
    return found.sort_values(["estimator", "number"], ascending=[True, False], ignore_index=True)


def failures(trials: TrialTable, most: int = FAILURES) -> pd.DataFrame:
    """First trials of every estimator that did not converge to the right result.

    Parameters
    ----------
    trials : TrialTable
    most : int
        Number of trials of each estimator.

    Returns
    -------
    pandas.DataFrame
        Columns ``estimator``, ``point``, ``replicate``, ``seed``, ``outcome``, ``message``, ``distance`` (to the right
        result, in tolerances; NaN without a comparison), ``settings`` (dict: value of every axis as text) and
        ``replay`` (command that repeats the trial).
    """
    failed = trials.frame[trials.judged & ~trials.converged].sort_values(["estimator", "point", "replicate"])
    listed = failed.groupby("estimator", observed=False).head(most)
    values = {axis.name: factorized(listed[axis.name]) for axis in trials.axes}
    settings = [{name: label(found[codes[k]]) for name, (codes, found) in values.items()} for k in range(len(listed))]
    place = listed["point"].astype(str) + ":" + listed["replicate"].astype(str)
    columns = ["estimator", "point", "replicate", "seed", "outcome", "message", "distance"]
    listed = listed[columns].assign(settings=settings, replay=trials.header.replay + place)
    return listed.assign(message=listed["message"].astype(object).where(listed["message"].notna(), ""))
