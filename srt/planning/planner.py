"""Planner: sequences, windows and order for the best accuracy in a given time, or for given targets in the least time.

1. The sequences that the fixture can execute, each with several lengths of its windows, are the columns of a continuous
   design. Its optimum bounds what any plan can reach (:mod:`srt.planning.continuous_design`).
2. Whole sequences are selected among the columns of most value (:mod:`srt.planning.selection`).
3. Sequences, order and windows are searched together, with the covariance of the whole test in its order and the time
   of the moves (:mod:`srt.planning.annealing`); then the windows share the time (:mod:`srt.planning.plan`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError, InputError
from srt.model.table1 import SEQUENCES
from srt.planning.annealing import AnnealedSearch
from srt.planning.candidates import executable_candidates, from_catalogue, turn_patterns
from srt.planning.continuous_design import (
    Columns,
    ContinuousDesign,
    asymptotic_variances,
    optimal_design,
    unobservable_targets,
)
from srt.planning.drift_chain import DriftChain
from srt.planning.information import Signatures
from srt.planning.order import moves_between
from srt.planning.plan import (
    MET,
    Plan,
    PlanLimits,
    TooLongError,
    accuracy_criterion,
    check_targets,
    scheduled_plan,
    too_short,
)
from srt.planning.prediction import predict
from srt.planning.selection import CandidatePool, SelectionSearch
from srt.ranking import ranked
from srt.recording.schema import LARGEST_TIME_S
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.planning.candidates import Candidate
    from srt.planning.conditions import Conditions
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array, Indices

    Progress = Callable[[str, int, float], None]

_GRID: Final = 8
"""Lengths of equal windows in the coarse continuous design."""
_FINE_GRID: Final = 9
"""Lengths of the start and of the end window, each, in the fine design."""
_FINE_SEQUENCES: Final = 150
"""Sequences of most value whose windows are refined."""
_FINE_COLUMNS: Final = 2000
"""Columns that the refinement adds."""
_NEARLY: Final = 0.9
"""Value per time over the best from which on the windows of a sequence are refined."""
_POOL: Final = 250
"""Sequences of most value among which whole sequences are selected."""
_START_COUNTS: Final = (8, 14, 22)
"""Numbers of sequences in the initial selections."""
_LEAST_WEIGHT: Final = 0.02
"""Weight from which on a target is said to limit the plan."""
_FIRST_TIME_S: Final = 900.0
"""First guess of the shortest test, s."""
_TRIES: Final = 12
"""Lengths tried for the shortest test."""
_RATIO_TOLERANCE: Final = 0.02
"""Distance of sigma over target from one at which the search for the shortest continuous design ends."""
_LONGER: Final = (1.02, 1.04, 1.5)
"""Lengthening of a plan that is too short: factor beyond the variance, least factor, largest factor."""
_BISECTIONS: Final = 4
"""Bisections between a plan that meets the targets and a time that was too short."""
_CLOSE: Final = 0.03
"""Relative distance of those two times at which the bisection ends."""
_QUICK: Final = 0.25
"""Share of the search for each of the lengths that are tried for the shortest test, and for the order of Table 1."""
_RESERVES: Final = 4
"""Searches for one length, each with more time kept for the moves than the one before."""


def make_plan(
    fixture: FixtureKinematics,
    conditions: Conditions,
    targets: Array,
    *,
    total_s: float | None = None,
    limits: PlanLimits | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Plan a test.

    Parameters
    ----------
    targets : ndarray, shape (27,), SI
        Target sigma of every parameter; NaN: none.
    total_s : float, optional
        Length of the test, s: the plan minimises the worst sigma over target. Default: the shortest test that meets all
        targets.
    progress : callable, optional
        Called with the stage ("optimum", "plan"), a count, and the relative gap to the optimum.

    Raises
    ------
    InputError
        Targets that are absent or not positive, or a time that is too short for any sequence.
    DataError
        A target that the fixture cannot observe, or that no test reaches; the message names the limiting source.
    """
    limits = limits or PlanLimits()
    check_targets(targets)
    planner = Planner(fixture, conditions, targets, limits, progress)
    planner.require_observable()
    if total_s is not None:
        if not 0.0 < total_s <= LARGEST_TIME_S:
            raise InputError(
                f"The time for the test is {total_s!r}: give a positive number of seconds, at most {LARGEST_TIME_S:g}."
            )
        return planner.plan_for_time(total_s)
    return planner.shortest_plan()


def table_1_plan(
    fixture: FixtureKinematics, conditions: Conditions, targets: Array, total_s: float, limits: PlanLimits | None = None
) -> Plan:
    """Plan the 17 sequences of Table 1, each once, in the best order and with the best windows for a time.

    Raises
    ------
    InputError
        The fixture cannot execute them, or the time is too short.
    """
    limits = limits or PlanLimits()
    check_targets(targets)
    candidates = [from_catalogue(s, fixture) for s in SEQUENCES.values()]
    criterion = accuracy_criterion(Signatures(candidates, fixture, conditions), targets, limits)
    every = np.arange(len(candidates))
    chain = DriftChain(criterion, every, moves_between(candidates, fixture), total_s)
    search = AnnealedSearch(chain, most=0, share=_QUICK)
    found = search.best([every])
    if found is None:
        raise too_short(criterion, every, total_s)
    return scheduled_plan(criterion, every[list(found[0].members)], found[1], targets, total_s)


class Planner:
    """Search for the best plan among the sequences that a fixture can execute.

    Parameters
    ----------
    targets : ndarray, shape (27,), SI
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information from earlier measurements, SI; default: that on gravity and north.
    """

    def __init__(
        self,
        fixture: FixtureKinematics,
        conditions: Conditions,
        targets: Array,
        limits: PlanLimits,
        progress: Progress | None = None,
        known: Array | None = None,
    ) -> None:
        self.fixture, self.conditions, self.targets, self.limits = fixture, conditions, targets, limits
        self.tell: Progress = progress or (lambda *_: None)
        patterns = turn_patterns(largest_turn_deg=limits.largest_turn_deg, most_legs=limits.most_legs)
        candidates = executable_candidates(fixture, patterns)
        if not candidates:
            raise InputError("The fixture can execute no sequence at all: widen its travel to 90 deg or more.")
        self.signatures = Signatures(candidates, fixture, conditions)
        self.criterion = accuracy_criterion(self.signatures, targets, limits, known)
        self._number = {c.key: k for k, c in enumerate(candidates)}
        self._table_1 = [from_catalogue(s) for s in SEQUENCES.values()]
        self.grid = limits.grid_s(_GRID)
        self.bounded = self.signatures.with_least_drift()
        # Least time between sequences. Moves are left out, so that the bound holds for any order.
        self.least_s = fixture.pause_s + fixture.settle_s
        self.coarse = self._coarse(self.signatures)

    def _coarse(self, signatures: Signatures) -> Columns:
        """Columns of all sequences with equal windows of every length of the grid."""
        rows = np.empty((len(self.grid), *signatures.H.shape))
        for t, each in zip(self.grid, rows, strict=True):
            signatures.whitened(t, t, out=each)
            np.multiply(each, self.criterion.scale, out=each)
        cost = (2.0 * self.grid[:, None] + signatures.between_windows_s + self.least_s).ravel()
        columns = rows.reshape(-1, *rows.shape[2:])
        return Columns(columns, cost, self.criterion.prior, self.criterion.targets, self.criterion.floor)

    def require_observable(self) -> None:
        """Raise DataError if no sequence that the fixture can execute observes one of the targets."""
        hidden = [NAMES[self.criterion.targets[i]] for i in unobservable_targets(self.coarse)]
        if hidden:
            raise DataError(
                f"No sequence that this fixture can execute shows {', '.join(hidden)}: take these "
                "targets out, or use a fixture with more freedom (both axes turning, more travel or positions)."
            )

    def continuous(self, total_s: float) -> ContinuousDesign:
        """Optimal continuous design: on the coarse grid of equal windows, then with refined windows."""
        optimum, self.rough, self.columns, self.sequence, self.windows = self._optimum(
            self.signatures, self.coarse, total_s
        )
        self.rough_s = total_s
        return optimum

    def bound(self, total_s: float) -> ContinuousDesign:
        """Optimal continuous design with the least possible drift, for a lower bound; from that with all drift."""
        longer = (total_s + self.least_s) / (self.rough_s + self.least_s)
        start = replace(self.rough, weight=longer * self.rough.weight)
        return self._optimum(self.bounded, self._coarse(self.bounded), total_s, start)[0]

    def _optimum(
        self, signatures: Signatures, coarse: Columns, total_s: float, start: ContinuousDesign | None = None
    ) -> tuple[ContinuousDesign, ContinuousDesign, Columns, Indices, Array]:
        tell = partial(self.tell, "optimum")
        # No move precedes the first sequence.
        total_s += self.least_s
        rough = optimal_design(coarse, total_s, start=start, progress=tell)
        columns, sequence, windows = self._with_fine_windows(signatures, coarse, rough)
        return optimal_design(columns, total_s, start=rough, progress=tell), rough, columns, sequence, windows

    def _with_fine_windows(
        self, signatures: Signatures, coarse: Columns, rough: ContinuousDesign
    ) -> tuple[Columns, Indices, Array]:
        """Columns with unequal start and end windows for the sequences of most value.

        The information of a sequence is concave in its windows, so that the coarse grid loses little between its
        points. Sequences that fall short by more are left as they are.
        """
        K = len(signatures)
        by_sequence = rough.worth.reshape(-1, K).max(axis=0)
        near = ranked(by_sequence)[:_FINE_SEQUENCES]
        near = near[by_sequence[near] > _NEARLY]
        fine = self.limits.grid_s(_FINE_GRID)
        pairs = np.stack(np.meshgrid(fine, fine, indexing="ij"), axis=-1).reshape(-1, 2)
        sequence, windows = np.repeat(near, len(pairs)), np.tile(pairs, (len(near), 1))
        rows = signatures.whitened(windows[:, 0], windows[:, 1], sequence) * self.criterion.scale
        cost = windows.sum(axis=1) + signatures.between_windows_s[sequence] + self.least_s
        added = replace(coarse, rows=rows, cost_s=cost)
        g, X = coarse.variances(coarse.information(rough.which, rough.weight))
        worth = added.gains(X, g) @ rough.weights / cost
        good = ranked(worth)[:_FINE_COLUMNS]
        columns = replace(
            coarse, rows=np.concatenate([coarse.rows, rows[good]]), cost_s=np.concatenate([coarse.cost_s, cost[good]])
        )
        every, equal = np.tile(np.arange(K), len(self.grid)), np.repeat(self.grid, K)
        return (
            columns,
            np.concatenate([every, sequence[good]]),
            np.concatenate([np.stack([equal, equal], axis=1), windows[good]]),
        )

    def pool(self, design: ContinuousDesign) -> CandidatePool:
        """Candidates for whole sequences: those of the continuous optimum, those of nearly equal value, and Table 1."""
        best: dict[int, int] = {}
        # Each sequence once, with its best windows.
        for j in ranked(design.worth).tolist():
            best.setdefault(int(self.sequence[j]), j)
            if len(best) == _POOL:
                break
        time = np.zeros(len(self.signatures))
        np.add.at(time, self.sequence[design.which], design.weight * self.columns.cost_s[design.which])
        for j in design.which[ranked(design.weight)].tolist():
            best[int(self.sequence[j])] = j  # a sequence of the optimum keeps the windows that it has there
        known = [self._number[c.key] for c in self._table_1 if c.key in self._number]
        worth = np.where(np.isin(np.arange(len(self.sequence)), list(best.values())), 2.0, design.worth)
        for k in known:
            if k not in best:
                own = np.flatnonzero(self.sequence == k)
                best[k] = int(own[ranked(worth[own])[0]])
        sequences = np.array(list(best))
        columns = np.array(list(best.values()))
        by_time = ranked(time[sequences])
        position = {int(k): i for i, k in enumerate(sequences)}
        starts = [by_time[:count] for count in _START_COUNTS]
        if known:
            starts.append(np.array([position[k] for k in known]))
        return CandidatePool(sequences, self.windows[columns], tuple(starts))

    def plan_for_time(self, total_s: float) -> Plan:
        """Best plan of a given length."""
        return self._with_bound(self.integer_plan(self.continuous(total_s), total_s))

    def _with_bound(self, plan: Plan) -> Plan:
        """Plan with the lower bound of the worst ratio for its length."""
        bound = self.bound(plan.total_s)
        first = ranked(bound.weights)
        limiting = tuple(
            (NAMES[self.criterion.targets[i]], float(bound.weights[i]))
            for i in first
            if bound.weights[i] > _LEAST_WEIGHT
        )
        return replace(plan, bound=bound.bound, limiting_targets=limiting)

    def integer_plan(self, design: ContinuousDesign, total_s: float, share: float = 1.0) -> Plan:
        """Plan of whole sequences near a continuous design, by a share of the search."""
        pool, reserve_s = self.pool(design), 0.0
        moves_s = moves_between([self.signatures.candidates[k] for k in pool.which], self.fixture)
        selections = SelectionSearch(self.criterion, pool, total_s, self.limits.most_sequences).selections(
            self.least_s + self.fixture.outer.move_s(0.0, 90.0)
        )
        for _ in range(_RESERVES):
            chain = DriftChain(self.criterion, pool.which, moves_s, total_s - reserve_s)
            search = AnnealedSearch(chain, self.limits.most_sequences, share, lambda: self.tell("plan", 0, 0.0))
            found = search.best(selections)
            if found is None:
                break
            try:
                plan = scheduled_plan(
                    self.criterion, pool.which[list(found[0].members)], found[1], self.targets, total_s
                )
            except TooLongError as error:  # the angles at which each move is shortest may differ
                reserve_s += error.missing_s
                continue
            if math.isfinite(plan.ratio):
                return plan
            break
        raise InputError(
            f"{total_s:g} s are too short for a test that observes all targets: give more time, shorter windows "
            "(shortest_window_s), more sequences (most_sequences), or fewer targets."
        )

    def shortest_plan(self) -> Plan:
        """Shortest plan that meets the targets."""
        self._require_reach()
        total_s, design = self._shortest_continuous()
        too_short = 0.0
        plan: Plan | None = None
        for _ in range(_TRIES):
            try:
                plan = self.integer_plan(design, total_s, _QUICK)
                ratio = plan.ratio
            except InputError:  # too short for any
                ratio = math.inf
            if plan is not None and ratio <= MET:
                return self._with_bound(self._shortened(self._bisected(plan, design, too_short)))
            too_short = total_s
            # Variances decrease with the time; whole numbers of sequences cost a little more.
            margin, least, most = _LONGER
            total_s *= min(max(margin * ratio**2, least), most)
            if total_s > self.limits.longest_test_s:
                break
            design = self.continuous(total_s)
        raise self._out_of_reach(plan or self.integer_plan(design, total_s, _QUICK))

    def _bisected(self, plan: Plan, design: ContinuousDesign, too_short_s: float) -> Plan:
        """Shorter plan between one that meets the targets and a time that was too short, by bisection."""
        for _ in range(_BISECTIONS):
            if plan.total_s < (1.0 + _CLOSE) * too_short_s or too_short_s == 0.0:
                break
            total_s = math.sqrt(plan.total_s * too_short_s)
            try:
                trial = self.integer_plan(design, total_s, _QUICK)
            except InputError:  # too short for any
                too_short_s = total_s
                continue
            if trial.ratio <= MET:
                plan = trial
            else:
                too_short_s = total_s
        return plan

    def _require_reach(self) -> None:
        """Raise DataError if the errors common to the whole test exceed a target, whatever the length of the test."""
        g = asymptotic_variances(self.coarse, self.limits.longest_test_s)
        if g.max() > 1.0:
            k = int(self.criterion.targets[ranked(g)[0]])
            raise DataError(
                f"The target of {NAMES[k]} is out of reach however long the test is: the uncertainty of gravity and "
                f"north and the drift of the unit, which no sequence reduces, are {math.sqrt(g.max()):.3g} times the "
                "target; measure gravity better (gravity_sigma_m_s2), or take a larger target."
            )

    def _shortest_continuous(self) -> tuple[float, ContinuousDesign]:
        """Shortest time, at least that of one sequence, in which a continuous design meets the targets; the design."""
        least_s = float(self.coarse.cost_s.min())
        total_s = _FIRST_TIME_S
        for _ in range(_TRIES):
            design = self.continuous(total_s)
            if abs(design.ratio - 1.0) < _RATIO_TOLERANCE:
                break
            # A design may hold a sequence a fraction of a time: wide targets are met in less time than one takes.
            if design.ratio < 1.0 and total_s <= least_s:
                break
            total_s = min(max(total_s * design.ratio**2, least_s), 4.0 * self.limits.longest_test_s)
            if design.bound > 1.0 and total_s > self.limits.longest_test_s:
                design = self.continuous(self.limits.longest_test_s)
                if design.bound > 1.0:
                    raise self._out_of_reach(self.integer_plan(design, self.limits.longest_test_s, _QUICK))
        return total_s, design

    def _out_of_reach(self, plan: Plan) -> DataError:
        k = NAMES.index(plan.worst)
        source, share = plan.prediction.limiting(k)
        return DataError(
            f"The targets are out of reach in {self.limits.longest_test_s / 3600.0:.3g} h: {plan.worst} stays at "
            f"{plan.ratio:.3g} times its target, {100.0 * share:.0f} % of its variance by {source.replace('_', ' ')}; "
            "take larger targets, a better unit, fixture or gravity, or allow more time."
        )

    def _shortened(self, plan: Plan) -> Plan:
        """Plan with the windows shortened as far as the targets allow."""
        windows_s = self.criterion.shortest_windows(self._positions(plan.candidates), plan.windows_s)
        total_s = plan.total_s + float(windows_s.sum() - plan.windows_s.sum())
        prediction = predict(plan.candidates, windows_s, self.fixture, self.conditions, self.targets)
        shorter = replace(plan, windows_s=windows_s, total_s=total_s, prediction=prediction)
        return shorter if shorter.ratio <= MET and total_s < plan.total_s else plan

    def _positions(self, candidates: Sequence[Candidate]) -> Indices:
        return np.array([self._number[c.key] for c in candidates], dtype=np.intp)
