"""A campaign's answers in words: sentences, and tables of text that every kind of report shows alike."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from sims.robustness.convergence import percent
from sims.robustness.spread import BAND, share_interval
from sims.robustness.tidy import CONVERGED, NO_IMU, OUTCOMES
from srt.sensor_errors import GROUPS, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sims.robustness.answers import Answers, Failure, Outcomes
    from sims.robustness.convergence import ConvergenceMap, Limit, Reach
    from sims.robustness.spread import Accuracy
    from srt.types import Array


MEANINGS: Final = {
    "converged": "the estimator says that it converged, and its result is the one that is also reached from the true "
    "errors",
    "wrong minimum": "it says that it converged, but to another result",
    "not converged": "it says itself that it did not converge",
    "outside model": "it says that its estimate is no longer that of a possible unit",
    "crashed": "it broke off with an error that is none of the input's: a defect of the estimator",
    "refused": "it stopped with a sentence that says why",
    "unverified": "it says that it converged, but a start from the true errors did not, so there is nothing to compare "
    "with; counted as not converged",
    "no IMU": "the errors drawn are so large that the unit would not be an IMU; left out of every rate",
}
"""What the outcomes mean, in the order of :data:`sims.robustness.tidy.OUTCOMES`."""
OUTCOME_WORDS: Final = dict(zip(OUTCOMES, MEANINGS, strict=True))

POINTS: Final = 400
"""Rows of the table of grid points, at most."""
_NOTHING: Final = "–"
_FAILING: Final = tuple(k for k in range(len(OUTCOMES)) if k not in (CONVERGED, NO_IMU))
_OTHER_OUTCOMES: Final = tuple(OUTCOME_WORDS[OUTCOMES[o]] for o in (*_FAILING, NO_IMU))


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text.

    Attributes
    ----------
    title : str
    head : tuple of str
    rows : tuple of tuple of str
    note : str
        How to read it.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def number(value: float) -> str:
    """Give a number with three digits, "–" if it is none."""
    if not math.isfinite(value):
        return _NOTHING
    if abs(value) >= 1000.0:
        return f"{value:.0f}" if abs(value) < 1e6 else f"{value:.2e}"
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0.0 else f"{value:.1e}"


def counted(many: int, one: str, several: str | None = None) -> str:
    """Give a number of things: "1 trial", "3 trials"."""
    return f"{many} {one if many == 1 else several or one + 's'}"


def sentences(found: Answers) -> tuple[str, ...]:
    """Give the answer in a few sentences: how many units, how many converged, up to where all did, honest or not.

    Parameters
    ----------
    found : Answers
    """
    header, outcomes = found.header, found.outcomes
    if not outcomes.trials:
        return (f"No trial has been run yet, of {header.planned} that are planned.",)
    part = "" if outcomes.trials >= header.planned else f", of {header.planned} that are planned"
    out = [
        f"{counted(outcomes.trials, 'unit')} with known sensor errors {'was' if outcomes.trials == 1 else 'were'} "
        f"simulated{part}; each was calibrated by {_listed(header.estimators)}, and the result was compared with "
        "the truth."
    ]
    if outcomes.no_imu:
        were = "was" if outcomes.no_imu == 1 else "were"
        out.append(
            f"{outcomes.no_imu} of the drawn units {were} no IMU, because the errors were too large for one: "
            "counted here, and left out of every rate."
        )
    else:
        out.append("All of the drawn units were IMUs, none with errors too large for one.")
    if outcomes.unverified:
        out.append("Results were not compared with those that are reached from the truth: a status was believed.")
    low, high = outcomes.interval
    for k, name in enumerate(header.estimators):
        n, right = int(outcomes.judged[k]), int(outcomes.converged[k])
        if not n:
            out.append(f"{name}: no trial to judge.")
            continue
        failed = [(OUTCOME_WORDS[OUTCOMES[o]], int(outcomes.counts[k, o])) for o in _FAILING]
        words = ", ".join(f"{count} {word}" for word, count in failed if count)
        out.append(
            f"{name}: {right} of {counted(n, 'trial')} converged ({percent(right / n, 1)} %; 95 % interval "
            f"{100.0 * low[k]:.1f} to {100.0 * high[k]:.1f} %){f'; {words}' if words else ''}."
        )
        if any(axis.numeric and len(axis.labels) > 1 for axis in found.axes):
            out += [_reach_sentence(r) for r in found.reach if r.estimator == name]
    out += _honesty_sentences(found)
    return tuple(out)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else "no estimator"


def _reach_sentence(reach: Reach) -> str:
    if reach.limits and reach.trials == reach.tried:
        sizes = _listed([f"{limit.axis} {limit.value:g}" for limit in reach.limits])
        # One-sided: the upper end of the two-sided interval of 90 %.
        most = 100.0 * float(share_interval(0, reach.trials, 0.9)[1])
        return (
            f"{reach.estimator} converged in every trial, whatever was varied ({sizes} at most): with 95 % confidence, "
            f"fewer than {most:.2g} % of such trials fail."
        )
    if reach.limits:
        # Without a confidence: the region was chosen for having no failure.
        parts = _listed([f"{limit.axis} {_limit(limit)}" for limit in reach.limits])
        return f"{reach.estimator} converged in all {counted(reach.trials, 'trial')} with {parts}."
    return f"{reach.estimator} has failures at the easy end of what was varied already."


def _limit(limit: Limit) -> str:
    end = (" (the most tried)" if limit.upward else " (the least tried)") if limit.whole else ""
    return f"up to {limit.value:g}{end}" if limit.upward else f"from {limit.value:g} on{end}"


def _some(names: Sequence[str], most: int = 4) -> str:
    return ", ".join(names[:most]) + (" and others" if len(names) > most else "")


def _honesty_sentences(found: Answers) -> Iterator[str]:
    honest = found.honesty
    if honest is None:
        yield "The recordings have no noise: a sigma is then a floor, and nothing can be said of its honesty."
        return
    for k, name in enumerate(found.header.estimators):
        seen = int(np.count_nonzero(honest.count[k]))
        if not seen:
            continue
        wrong = {"too small": honest.too_small[k], "too large": honest.too_large[k]}
        parts = [
            f"{word} for {np.count_nonzero(of)} ({_some([NAMES[p] for p in np.flatnonzero(of)])})"
            for word, of in wrong.items()
            if of.any()
        ]
        if parts:
            yield f"Sigmas of {name} are {' and '.join(parts)} of {counted(seen, 'parameter')}, beyond chance."
        elif honest.nees_off[k]:
            yield f"Sigmas of {name} are honest one by one, but all together (NEES) they are not."
        else:
            yield f"Sigmas of {name} are as large as its errors, within chance, for {counted(seen, 'parameter')}."


def outcome_table(found: Answers) -> Table:
    """What became of the trials, by estimator."""
    outcomes = found.outcomes
    low, high = outcomes.interval
    rows = [
        (
            name,
            str(outcomes.judged[k]),
            *_share(int(outcomes.converged[k]), int(outcomes.judged[k]), float(low[k]), float(high[k])),
            *(str(outcomes.counts[k, o]) for o in (*_FAILING, NO_IMU)),
        )
        for k, name in enumerate(found.header.estimators)
    ]
    head = ("estimator", "trials", "converged", "%", "95 % interval", *_OTHER_OUTCOMES)
    return Table("Outcomes", head, tuple(rows), "Trials that are no IMU are left out of the trials and of the rates.")


def _share(right: int, trials: int, low: float, high: float) -> tuple[str, str, str]:
    if not trials:
        return str(right), _NOTHING, _NOTHING
    return str(right), percent(right / trials, 1), f"{100.0 * low:.1f} to {100.0 * high:.1f}"


def reach_table(found: Answers) -> Table:
    """How far everything converged, by estimator."""
    axes = tuple(dict.fromkeys(limit.axis for r in found.reach for limit in r.limits))
    rows = []
    for r in found.reach:
        limits = {limit.axis: _limit(limit) for limit in r.limits}
        rows.append((r.estimator, *(limits.get(axis, _NOTHING) for axis in axes), str(r.trials), str(r.tried)))
    note = "The largest region without a failure that begins at the easy end of every axis. A dash: there is none."
    head = ("estimator", *axes, "trials there", "of")
    return Table("Where every trial converged", head, tuple(rows) if axes else (), note)


def point_table(found: Answers) -> Table:
    """Outcomes at every point of the grid; of more than a few hundred, those with a failure."""
    outcomes = found.outcomes
    head = ("point", *found.header.grid, "estimator", "trials", "converged", "%", "95 % interval", *_OTHER_OUTCOMES)
    total = outcomes.of_point[..., 0].size
    failed = outcomes.of_point[..., list(_FAILING)].sum(axis=2) > 0
    shown = np.argwhere(failed.T) if total > POINTS else np.argwhere(np.ones_like(failed).T)
    note = ""
    if total > POINTS:
        note = f"Of {total} rows, {len(shown)} have a failure; the first {min(len(shown), POINTS)} of these are shown."
    rows = tuple(_point_row(found, outcomes, point, k) for point, k in shown[:POINTS].tolist())
    return Table("Outcomes at every point of the grid", head, rows, note)


def _point_row(found: Answers, outcomes: Outcomes, point: int, k: int) -> tuple[str, ...]:
    counts = outcomes.of_point[k, point]
    trials, right = int(counts.sum() - counts[NO_IMU]), int(counts[CONVERGED])
    low, high = share_interval(right, trials)
    return (
        str(outcomes.points[point]),
        *(outcomes.settings[point][name] for name in found.header.grid),
        found.header.estimators[k],
        str(trials),
        *_share(right, trials, float(low), float(high)),
        *(str(counts[o]) for o in (*_FAILING, NO_IMU)),
    )


def map_tables(found: ConvergenceMap, estimators: Sequence[str]) -> tuple[Table, ...]:
    """Share that converged over two axes in percent, one table per estimator; the largest value of ``up`` on top."""
    if found.across is None:
        return ()
    up = ("all",) if found.up is None else found.up.labels
    corner = found.across.name if found.up is None else f"{found.up.name} ↓  {found.across.name} →"
    share = found.share
    return tuple(
        Table(
            f"Converged, %: {name}",
            (corner, *found.across.labels),
            tuple(
                (up[r], *(percent(s) if math.isfinite(s) else "" for s in share[k, r].tolist()))
                for r in reversed(range(len(up)))
            ),
            averaged(found),
        )
        for k, name in enumerate(estimators)
    )


def averaged(found: ConvergenceMap) -> str:
    """Say what a map averages over."""
    return f"Averaged over {_listed(found.averaged)}." if found.averaged else ""


def accuracy_tables(found: Accuracy, estimators: Sequence[str], *, noisy: bool) -> tuple[Table, ...]:
    """Errors of converged trials by level and group: in units, and in sigmas where these mean anything."""
    head = ("all trials" if found.axis is None else found.axis.name, "estimator", "trials")
    where = "" if found.axis is None else f" against {found.axis.name}"
    labels = ("",) if found.axis is None else found.axis.labels
    cells = [(level, k) for level in range(len(labels)) for k in range(len(estimators)) if found.count[k, level].any()]
    suffixes = np.array([len(group.suffixes) for group in GROUPS])

    def rows(rms: Array, largest: Array) -> tuple[tuple[str, ...], ...]:
        return tuple(
            (
                labels[level],
                estimators[k],
                # Of a group that is held in part, a trial adds fewer errors: the group seen most often counts them.
                str(int(np.max(-(-found.count[k, level] // suffixes)))),
                *(
                    f"{number(a)} ({number(b)})" if math.isfinite(a) else _NOTHING
                    for a, b in zip(rms[k, level].tolist(), largest[k, level].tolist(), strict=True)
                ),
            )
            for level, k in cells
        )

    names = [group.name.replace("_", " ") for group in GROUPS]
    units = tuple(f"{name}, {group.display_unit}" for name, group in zip(names, GROUPS, strict=True))
    note = "Of converged trials: root mean square, and in brackets the largest."
    out = [Table(f"Error{where}", (*head, *units), rows(found.rms, found.largest), note)]
    if noisy:
        scaled = rows(found.rms_in_sigma, found.largest_in_sigma)
        out.append(Table(f"Error in sigmas{where}", (*head, *names), scaled, note))
    return tuple(out)


def honesty_tables(found: Answers) -> tuple[Table, ...]:
    """How honest the sigmas are: all parameters together, then one by one; nothing without noise."""
    honest = found.honesty
    if honest is None:
        return ()
    together = tuple(
        (
            name,
            str(honest.units[k]),
            number(float(honest.nees[k])),
            f"{number(float(honest.nees_low[k]))} to {number(float(honest.nees_high[k]))}",
            str(int(honest.too_small[k].sum())),
            str(int(honest.too_large[k].sum())),
        )
        for k, name in enumerate(found.header.estimators)
    )
    head = ("estimator", "trials", "NEES / its mean if honest", "limits", "sigmas too small", "sigmas too large")
    note = "Limits that all values of all tables keep together in 99 of 100 campaigns, if the sigmas are honest."
    single = tuple(
        (
            name,
            parameter,
            str(honest.count[k, p]),
            f"{honest.rms[k, p]:.3f}",
            f"{BAND:g}/√(2n) = {honest.half_width[k, p]:.3f}",
            f"{honest.low[k, p]:.3f} to {honest.high[k, p]:.3f}",
            percent(float(honest.coverage[k, p]), 1),
            f"{100.0 * honest.coverage_low[k, p]:.1f} to {100.0 * honest.coverage_high[k, p]:.1f}",
            "too small" if honest.too_small[k, p] else "too large" if honest.too_large[k, p] else "",
        )
        for k, name in enumerate(found.header.estimators)
        for p, parameter in enumerate(NAMES)
        if honest.count[k, p]
    )
    alone = ("estimator", "parameter", "trials", "rms of error / sigma", "band about 1", "limits")
    columns = (*alone, "within 95 %, %", "95 % interval", "sigma")
    return (Table("Sigmas, all together", head, together, note), Table("Sigmas, one by one", columns, single, note))


def effort_table(found: Answers) -> Table:
    """Play-backs and CPU time, by estimator."""
    effort = found.effort
    rows = tuple(
        (name, *(number(float(v[k])) for v in (effort.median, effort.most, effort.seconds, effort.seconds_95)))
        for k, name in enumerate(found.header.estimators)
    )
    head = ("estimator", "play-backs, median", "most", "CPU s, median", "95 % stay below")
    note = f"A unit is simulated in {number(effort.simulate_s)} s (median); all took {number(effort.total_s)} CPU s."
    return Table("Play-backs and time", head, rows, note)


def failure_table(failures: Iterable[Failure], title: str) -> Table:
    """Trials that failed, with the command that repeats each."""
    rows = tuple(
        (
            f"{f.point}:{f.replicate}",
            str(f.seed),
            ", ".join(f"{name} = {value}" for name, value in f.settings.items()) or _NOTHING,
            OUTCOME_WORDS[f.outcome],
            f.message or (f"{number(f.distance)} tolerances away" if math.isfinite(f.distance) else _NOTHING),
            f.replay,
        )
        for f in failures
    )
    return Table(title, ("trial", "seed", "settings", "outcome", "message", "repeat it"), rows)


def varied_table(found: Answers) -> Table:
    """What the campaign varies."""
    from sims.robustness.config import AXES

    def meaning(name: str) -> str:
        return AXES[name].text if name in AXES else "key of the scenario"

    header = found.header
    labels = {axis.name: axis.labels for axis in found.axes}
    rows = [(name, meaning(name), "each of " + ", ".join(labels[name])) for name in header.grid]
    rows += [(name, meaning(name), f"drawn by every trial: {text}") for name, text in header.random.items()]
    return Table("What was varied", ("axis", "meaning", "values"), tuple(rows))
