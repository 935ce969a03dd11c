"""Summary of a campaign as text: sentences and tables, which are the same in all reports."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from sims.robustness.convergence import percent
from sims.robustness.error_statistics import BAND, NEAR_SHARE, NEAR_SIGMAS, share_interval
from sims.robustness.trial import OUTCOMES
from srt.sensor_errors import GROUPS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sims.robustness.convergence import AxisLimit, ConvergenceMap, ConvergenceRegion
    from sims.robustness.error_statistics import Accuracy
    from sims.robustness.summary import CampaignSummary


OUTCOME_WORDS: Final = {
    name: name.replace("_", " ").removesuffix("imu") + "IMU" * (name == "no_imu") for name in OUTCOMES
}
"""Outcomes as the reports name them."""
CAUSES: Final = 3
"""Number of causes of failure listed for each estimator."""
POINTS: Final = 400
"""Largest number of rows of the table of grid points."""
NOISE_FREE: Final = (
    "The recordings have no noise (noise = false in [recording]): the sigmas are floors, and their consistency with "
    "the errors cannot be tested."
)
_NOTHING: Final = "–"
_FAILURES: Final = tuple(name for name in OUTCOMES if name not in ("converged", "no_imu"))
_OTHERS: Final = (*_FAILURES, "no_imu")
_RATES: Final = ("trials", "converged", "%", "95 % interval", *(OUTCOME_WORDS[name] for name in _OTHERS))
"""Headings of the cells of :func:`_rates`."""


@dataclass(frozen=True, slots=True)
class TextTable:
    """Table of text.

    Attributes
    ----------
    title : str
    head : tuple of str
    rows : tuple of tuple of str
    note : str
        Explanation below the table.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def number(value: float) -> str:
    """Text of a number with three digits, "–" for NaN."""
    if not math.isfinite(value):
        return _NOTHING
    if abs(value) >= 1000.0:
        return f"{value:.0f}" if abs(value) < 1e6 else f"{value:.2e}"
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0.0 else f"{value:.1e}"


def counted(many: int, one: str) -> str:
    """Text of a number of things: "1 trial", "3 trials"."""
    return f"{many} {one if many == 1 else one + 's'}"


def sentences(found: CampaignSummary) -> tuple[str, ...]:
    """Result of a campaign in a few sentences.

    Parameters
    ----------
    found : CampaignSummary
    """
    header = found.header
    if not found.units:
        return (f"No trial has been run yet, of {header.planned} that are planned.",)
    part = "" if found.units >= header.planned else f", of {header.planned} that are planned"
    out = [
        f"{counted(found.units, 'unit')} with known sensor errors {'was' if found.units == 1 else 'were'} "
        f"simulated{part}; each was calibrated by {_listed(header.estimators)}, and the result was compared with "
        "the truth."
    ]
    if found.impossible:
        were = "was" if found.impossible == 1 else "were"
        out.append(
            f"{found.impossible} of the drawn units {were} no IMU, because the errors were too large for one: "
            "counted here, excluded from every rate."
        )
    else:
        out.append("All drawn units were possible IMUs.")
    if found.unverified:
        out.append("Results were not compared with those reached from the truth: the reported status was not verified.")
    if header.trials_per_motion > 1:
        out.append(
            f"Each {header.trials_per_motion} successive trials have the same motion and fixture errors. Their errors "
            "are correlated: the intervals assume independent trials, and are too narrow where the fixture matters."
        )
    for row in found.outcomes.itertuples():
        out += _estimator_sentences(found, row)
    return (*out, *_consistency_sentences(found))


def _estimator_sentences(found: CampaignSummary, row: Any) -> Iterator[str]:
    """Convergence of one estimator, a row of the outcomes."""
    if not row.judged:
        yield f"{row.Index}: no trial of a possible IMU."
        return
    words = ", ".join(f"{getattr(row, o)} {OUTCOME_WORDS[o]}" for o in _FAILURES if getattr(row, o))
    yield (
        f"{row.Index}: {row.converged} of {counted(row.judged, 'trial')} converged "
        f"({percent(row.converged / row.judged, 1)} %; 95 % interval {100.0 * row.low:.1f} to {100.0 * row.high:.1f} %)"
        f"{f'; {words}' if words else ''}."
    )
    if any(axis.numeric and len(axis.labels) > 1 for axis in found.axes):
        yield from (_region_sentence(region) for region in found.regions if region.estimator == row.Index)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else "no estimator"


def _region_sentence(region: ConvergenceRegion) -> str:
    if not region.limits:
        return f"{region.estimator} has failures already at the easy end of every axis."
    if region.trials == region.tried:
        sizes = _listed([f"{limit.axis} {limit.value:g}" for limit in region.limits])
        # One-sided 95 %: the upper end of the two-sided interval of 90 %.
        most = 100.0 * float(share_interval(0, region.trials, 0.9)[1])
        return (
            f"{region.estimator} converged in every trial ({sizes} at most): with 95 % confidence, fewer than "
            f"{most:.2g} % of such trials fail."
        )
    # No confidence is stated: the region was chosen for having no failure.
    parts = _listed([f"{limit.axis} {_limit(limit)}" for limit in region.limits])
    return f"{region.estimator} converged in all {counted(region.trials, 'trial')} with {parts}."


def _limit(limit: AxisLimit) -> str:
    end = (" (the most tried)" if limit.upward else " (the least tried)") if limit.whole else ""
    return f"up to {limit.value:g}{end}" if limit.upward else f"from {limit.value:g} on{end}"


def _consistency_sentences(found: CampaignSummary) -> Iterator[str]:
    if found.consistency is None:
        yield NOISE_FREE
        return
    for name in found.header.estimators:
        own = found.consistency.parameters.loc[name]
        seen = counted(int((own["count"] > 0).sum()), "parameter")
        names = {word: list(own.index[own[f"too_{word}"]]) for word in ("small", "large")}
        parts = [
            f"too {word} for {len(of)} ({', '.join(of[:4])}{' and others' if len(of) > 4 else ''})"
            for word, of in names.items()
            if of
        ]
        if not (own["count"] > 0).any():
            continue
        if parts:
            yield f"Sigmas of {name} are {' and '.join(parts)} of {seen} (p < 0.01 for all tests together)."
        elif found.consistency.nees.loc[name, "inconsistent"]:
            yield f"Sigmas of {name} match its errors one by one, but not together (NEES)."
        else:
            yield f"Sigmas of {name} match its errors for {seen}."


def _rates(row: Any) -> tuple[str, ...]:
    """Cells of a row of outcomes: judged trials, share that converged with its interval, and other outcomes."""
    share = (_NOTHING, _NOTHING)
    if row.judged:
        share = (percent(row.converged / row.judged, 1), f"{100.0 * row.low:.1f} to {100.0 * row.high:.1f}")
    return (str(row.judged), str(row.converged), *share, *(str(getattr(row, name)) for name in _OTHERS))


def share_table(found: CampaignSummary) -> TextTable:
    """Convergence and consistency of the sigmas together, by estimator; no rows without noise."""
    rows = tuple(
        (
            row.Index,
            *(str(int(number)) for number in (row.judged, row.estimates, row.converged, row.within, row.beyond)),
            percent(row.within / row.judged, 1) if row.judged else _NOTHING,
            number(row.nees),
            number(row.nees_all),
        )
        for row in found.shares.itertuples()
    )
    counts = ("trials", "estimates", "converged", "within sigmas", "beyond sigmas", "within, %")
    head = ("estimator", *counts, "NEES/n, converged", "NEES/n, all estimates")
    note = (
        "Estimates: of any status. Within or beyond sigmas: converged trials whose NEES has p above or below 0.001. "
        "NEES/n: median of the NEES over the number of parameters."
    )
    return TextTable("Convergence and errors over sigmas", head, rows if found.header.noisy else (), note)


def innovation_table(found: CampaignSummary) -> TextTable:
    """Normalised innovations by filter and sequence."""
    medians = found.innovations
    numbers = [column for column in medians.columns if column != "trials"]
    rows = tuple(
        (str(name), str(int(row["trials"])), *(number(float(row[column])) for column in numbers))
        for name, row in medians.iterrows()
    )
    note = (
        "Sequences in the order of time. Median over the trials of the normalised innovations squared (NIS) over their "
        "degrees of freedom: about 1 if the filter's model holds, below 1 where the prior is wider than the errors."
    )
    return TextTable("Innovations (NIS/n) by sequence", ("filter", "trials", *map(str, numbers)), rows, note)


def cause_table(found: CampaignSummary) -> TextTable:
    """Causes of failure by estimator, the most frequent ones."""
    first = found.causes.groupby("estimator", observed=True).head(CAUSES)
    rows = tuple(
        (str(row.estimator), str(row.number), OUTCOME_WORDS[row.outcome], row.cause or _NOTHING)
        for row in first.itertuples()
    )
    note = f"The {CAUSES} most frequent causes of every estimator; numbers and names in a message are replaced by …"
    return TextTable("Causes of failure", ("estimator", "trials", "outcome", "message"), rows, note)


def outcome_table(found: CampaignSummary) -> TextTable:
    """Outcomes of the trials by estimator."""
    rows = tuple((row.Index, *_rates(row)) for row in found.outcomes.itertuples())
    note = "Trials that are no IMU are excluded from the trials and the rates."
    return TextTable("Outcomes", ("estimator", *_RATES), rows, note)


def region_table(found: CampaignSummary) -> TextTable:
    """Region without a failure by estimator."""
    axes = tuple(dict.fromkeys(limit.axis for region in found.regions for limit in region.limits))
    rows = []
    for region in found.regions:
        limits = {limit.axis: _limit(limit) for limit in region.limits}
        cells = (limits.get(axis, _NOTHING) for axis in axes)
        rows.append((region.estimator, *cells, str(region.trials), str(region.tried)))
    note = "The largest region without a failure that begins at the easy end of every axis. A dash: no such region."
    head = ("estimator", *axes, "trials there", "of")
    return TextTable("Where every trial converged", head, tuple(rows) if axes else (), note)


def point_table(found: CampaignSummary) -> TextTable:
    """Outcomes at every point of the grid; with more than a few hundred rows, only those with a failure."""
    shown, note = found.points, ""
    if len(found.points) > POINTS:
        shown = found.points[found.points[list(_FAILURES)].sum(axis=1) > 0]
        note = (
            f"Of {len(found.points)} rows, {len(shown)} have a failure; the first {min(len(shown), POINTS)} of these "
            "are shown."
        )
    rows = tuple(
        (str(row.Index[0]), *found.settings.loc[row.Index[0]], row.Index[1], *_rates(row))
        for row in shown[:POINTS].itertuples()
    )
    head = ("point", *found.header.grid, "estimator", *_RATES)
    return TextTable("Outcomes at every point of the grid", head, rows, note)


def map_tables(found: ConvergenceMap, estimators: Sequence[str]) -> tuple[TextTable, ...]:
    """Share that converged over two axes in percent, one table per estimator; the largest value of ``up`` on top."""
    if found.across is None:
        return ()
    up = ("all",) if found.up is None else found.up.labels
    corner = found.across.name if found.up is None else f"{found.up.name} ↓  {found.across.name} →"
    share, beyond = found.share, found.share_beyond
    note = "In brackets: converged with errors beyond their sigmas (p < 0.001)." if found.beyond.any() else ""
    return tuple(
        TextTable(
            f"Converged, %: {name}",
            (corner, *found.across.labels),
            tuple((up[r], *map(_cell, share[k, r].tolist(), beyond[k, r].tolist())) for r in reversed(range(len(up)))),
            " ".join(filter(None, (averaged(found), note))),
        )
        for k, name in enumerate(estimators)
    )


def score_tables(found: CampaignSummary) -> tuple[TextTable, ...]:
    """Errors of all estimates by estimator and level of the only axis; no table without one, or without noise."""
    axis, scores = found.maps[0].across, found.scores
    if axis is None or scores is None or not found.header.noisy:
        return ()

    labels, estimators = axis.labels, found.header.estimators
    cells = scores.reindex(pd.MultiIndex.from_product([estimators, range(len(labels))], names=scores.index.names))

    def table(title: str, column: str, note: str) -> TextTable:
        shown = [number(value) for value in cells[column]]
        if column in ("right", "close"):
            pairs = cells[[column, "judged"]].fillna(0).astype(int).itertuples(index=False)
            shown = [f"{many} of {judged}" if judged else _NOTHING for many, judged in pairs]
        width = len(labels)
        rows = tuple((name, *shown[k * width : (k + 1) * width]) for k, name in enumerate(estimators))
        return TextTable(f"{title}, by {axis.name}", ("estimator", *labels), rows, note)

    right = f"Units with an estimate, of any status, whose errors are all within {NEAR_SIGMAS:g} sigma."
    close = (
        f"Units with an estimate whose errors that {axis.name} sizes are within {100.0 * NEAR_SHARE:g} % of this size."
    )
    median = "Median over the estimates of any status."
    tables = [table(f"Within {NEAR_SIGMAS:g} sigma", "right", right)]
    if scores["close"].any():
        tables.append(table(f"Within {100.0 * NEAR_SHARE:g} % of the size", "close", close))
    return (
        *tables,
        table("NEES/n", "nees", median),
        table("Largest error over sigma", "largest", median),
        table("CPU time, s", "seconds", "Median over the trials."),
    )


def _cell(share: float, beyond: float) -> str:
    """Cell of a map: share that converged, and in brackets that with errors beyond the sigmas."""
    if not math.isfinite(share):
        return ""
    return percent(share) + (f" ({percent(beyond)})" if beyond else "")


def averaged(found: ConvergenceMap) -> str:
    """Sentence on the axes that a map averages over."""
    return f"Averaged over {_listed(found.averaged)}." if found.averaged else ""


def accuracy_tables(found: Accuracy, estimators: Sequence[str], *, noisy: bool) -> tuple[TextTable, ...]:
    """Errors of converged trials by level and group: in units, and in sigmas if the recordings have noise."""
    head = ("all trials" if found.axis is None else found.axis.name, "estimator", "trials")
    where = "" if found.axis is None else f" against {found.axis.name}"
    labels = ("",) if found.axis is None else found.axis.labels
    count = found.array("count")
    # A trial adds fewer errors to a group that is fixed in part: the group estimated most often counts the trials.
    trials = np.max(-(-count // np.array([len(group.suffixes) for group in GROUPS])), axis=2)

    def table(title: str, heads: Sequence[str], rms: str, largest: str) -> TextTable:
        pairs = np.stack([found.array(rms), found.array(largest)], axis=-1)
        rows = tuple(
            (labels[level], estimators[k], str(int(trials[k, level])), *map(_pair, pairs[k, level].tolist()))
            for level in range(len(labels))
            for k in range(len(estimators))
            if trials[k, level]
        )
        note = "Converged trials: root mean square, and the largest in brackets."
        return TextTable(f"{title}{where}", (*head, *heads), rows, note)

    names = [group.name.replace("_", " ") for group in GROUPS]
    units = [f"{name}, {group.display_unit}" for name, group in zip(names, GROUPS, strict=True)]
    out = (table("Error", units, "rms", "largest"),)
    return (*out, table("Error in sigmas", names, "rms_in_sigma", "largest_in_sigma")) if noisy else out


def _pair(values: Sequence[float]) -> str:
    """Cell of an rms and the largest error."""
    return f"{number(values[0])} ({number(values[1])})" if math.isfinite(values[0]) else _NOTHING


def consistency_tables(found: CampaignSummary) -> tuple[TextTable, ...]:
    """Consistency of the sigmas: all parameters together, then one by one; no table without noise."""
    if found.consistency is None:
        return ()
    parameters = found.consistency.parameters
    together = []
    for row in found.consistency.nees.itertuples():
        wrong = (str(int(parameters.loc[row.Index, f"too_{word}"].sum())) for word in ("small", "large"))
        limits = f"{number(row.low)} to {number(row.high)}"
        together.append((row.Index, str(row.units), number(row.nees), limits, *wrong))
    single = tuple(
        (
            *row.Index,
            str(row.trials),
            f"{row.rms:.3f}",
            f"{BAND:g}/√(2n) = {row.half_width:.3f}",
            f"{row.low:.3f} to {row.high:.3f}",
            percent(row.coverage, 1),
            f"{100.0 * row.coverage_low:.1f} to {100.0 * row.coverage_high:.1f}",
            "too small" if row.too_small else "too large" if row.too_large else "",
        )
        for row in parameters.rename(columns={"count": "trials"})[parameters["count"] > 0].itertuples()
    )
    head = ("estimator", "trials", "NEES / degrees of freedom", "limits", "sigmas too small", "sigmas too large")
    note = "Limits that all values of both tables keep together in 99 of 100 campaigns, if the sigmas match the errors."
    alone = ("estimator", "parameter", "trials", "rms of error / sigma", "band about 1", "limits")
    columns = (*alone, "within 95 %, %", "95 % interval", "sigma")
    return (
        TextTable("Sigmas, all together", head, tuple(together), note),
        TextTable("Sigmas, one by one", columns, single, note),
    )


def effort_table(found: CampaignSummary) -> TextTable:
    """Iterations and CPU time by estimator."""
    effort = found.effort
    rows = tuple((row[0], *map(number, row[1:])) for row in effort.table.itertuples())
    head = ("estimator", "iterations, median", "most", "CPU s, median", "CPU s, 95 %")
    simulation, campaign = number(effort.simulate_s), number(effort.total_s)
    note = f"Simulation of a unit: {simulation} CPU s (median). Whole campaign: {campaign} CPU s."
    return TextTable("Iterations and time", head, rows, note)


def failure_table(failures: pd.DataFrame, title: str) -> TextTable:
    """Failed trials, with the command that repeats each."""
    rows = tuple(
        (
            f"{f.point}:{f.replicate}",
            str(f.seed),
            ", ".join(f"{name} = {value}" for name, value in f.settings.items()) or _NOTHING,
            OUTCOME_WORDS[f.outcome],
            f.message or (f"{number(f.distance)} tolerances away" if math.isfinite(f.distance) else _NOTHING),
            f.replay,
        )
        for f in failures.itertuples()
    )
    return TextTable(title, ("trial", "seed", "settings", "outcome", "message", "repeat it"), rows)


def varied_table(found: CampaignSummary) -> TextTable:
    """Axes of the campaign, their meaning and values."""
    from sims.robustness.campaign import AXES

    def meaning(name: str) -> str:
        return AXES[name].text if name in AXES else "key of the scenario"

    header = found.header
    labels = {axis.name: axis.labels for axis in found.axes}
    rows = [(name, meaning(name), "each of " + ", ".join(labels[name])) for name in header.grid]
    rows += [(name, meaning(name), f"drawn by every trial: {text}") for name, text in header.random.items()]
    return TextTable("Axes of the campaign", ("axis", "meaning", "values"), tuple(rows))
