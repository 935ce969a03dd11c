"""Plans: the sequences, windows and order that reach an accuracy soonest, or the best accuracy in a time.

The way: all that the fixture can execute becomes columns (sequence and windows); the optimum with fractions says which
are worth their time and bounds what any plan can do (:mod:`srt.planning.optimum`); whole sequences are chosen among
those (:mod:`srt.planning.selection`), ordered for short moves (:mod:`srt.planning.order`), and the windows share the
time that the moves leave.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError, InputError
from srt.model.table1 import SEQUENCES
from srt.planning.candidates import executable, from_catalogue, words
from srt.planning.information import Signatures
from srt.planning.optimum import Columns, Relaxed, limits_of_time, relaxed_optimum, unseen
from srt.planning.planned import MET, Limits, Plan, TooLongError, check_targets, finished, judge_of
from srt.planning.polish import WholeTest
from srt.planning.prediction import predict
from srt.planning.selection import Choice, Judge, Pool, select
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.planning.candidates import Candidate
    from srt.planning.information import Conditions
    from srt.planning.stand import Stand
    from srt.types import Array, Indices

    Progress = Callable[[str, int, float], None]

__all__ = ["Limits", "Plan", "Task", "check_targets", "make_plan", "table_1_plan"]

_GRID: Final = 8
_FINE_GRID: Final = 9
_FINE_SEQUENCES: Final = 150
_FINE_COLUMNS: Final = 2000
_NEARLY: Final = 0.9
_POOL: Final = 250
_START_COUNTS: Final = (8, 14, 22)
_FIRST_TIME_S: Final = 900.0
_TRIES: Final = 12
_HALVINGS: Final = 4
_ROUNDS: Final = 4
_POLISHES: Final = 4
_BALANCES: Final = 5
_WORTHWHILE: Final = 5e-3
_CLOSE: Final = 0.03


def make_plan(
    stand: Stand,
    conditions: Conditions,
    targets: Array,
    *,
    total_s: float | None = None,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Plan a test.

    Parameters
    ----------
    stand : Stand
    conditions : Conditions
    targets : ndarray, shape (27,), SI
        Wanted sigma of every parameter; NaN where none is.
    total_s : float, optional
        Length of the test, s: the plan has the smallest worst sigma over target then. Default: the shortest test that
        meets all targets.
    limits : Limits, optional
    progress : callable, optional
        Called with what is being done, a count, and the relative gap to the optimum that is left.

    Raises
    ------
    InputError
        No targets, or none that is positive; a time that is too short for any sequence.
    DataError
        A target that the fixture cannot show, or that no test reaches; the message names the limiting source.
    """
    limits = limits or Limits()
    check_targets(targets)
    task = Task(stand, conditions, targets, limits, progress)
    task.require_seen()
    if total_s is not None:
        if not (math.isfinite(total_s) and total_s > 0.0):
            raise InputError(f"The time for the test is {total_s!r}: give a positive number of seconds.")
        return task.in_time(total_s)
    return task.in_least_time()


def table_1_plan(
    stand: Stand, conditions: Conditions, targets: Array, total_s: float, limits: Limits | None = None
) -> Plan:
    """Plan the 17 sequences of Table 1, each once, in the best order and with the best windows for a time.

    Raises
    ------
    InputError
        If the fixture cannot execute them, or the time is too short.
    """
    limits = limits or Limits()
    check_targets(targets)
    candidates = [from_catalogue(s, stand) for s in SEQUENCES.values()]
    judge = judge_of(Signatures(candidates, stand, conditions), targets, limits)
    which = np.arange(len(candidates))
    guess = Choice(which, np.full((len(which), 2), 10.0), math.nan)
    return finished(judge, guess, stand, conditions, targets, total_s)


class Task:
    """One planning problem: everything that the fixture can execute, ready to be weighed.

    Parameters
    ----------
    stand : Stand
    conditions : Conditions
    targets : ndarray, shape (27,), SI
    limits : Limits
    progress : callable, optional
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information that there already is; default that on gravity and north.
    """

    def __init__(
        self,
        stand: Stand,
        conditions: Conditions,
        targets: Array,
        limits: Limits,
        progress: Progress | None = None,
        known: Array | None = None,
    ) -> None:
        self.stand, self.conditions, self.targets, self.limits = stand, conditions, targets, limits
        self._progress = progress
        kinds = words(largest_turn_deg=limits.largest_turn_deg, most_legs=limits.most_legs)
        candidates = executable(stand, kinds)
        if not candidates:
            raise InputError("The fixture can execute no sequence at all: widen its travel to 90 deg or more.")
        self.signatures = Signatures(candidates, stand, conditions)
        self.judge = judge_of(self.signatures, targets, limits, known)
        self._number = {c.key: k for k, c in enumerate(candidates)}
        self._table_1 = [from_catalogue(s) for s in SEQUENCES.values()]
        self.grid = limits.grid_s(_GRID)
        self.bounded = self.signatures.with_least_drift()
        # Moves are left out: with them no plan is shorter, and a bound holds for any order.
        self.least_s = stand.pause_s + stand.settle_s
        self.coarse = self._coarse(self.signatures)

    def _coarse(self, signatures: Signatures) -> Columns:
        """Every sequence with equal windows of every length of the grid."""
        rows = np.concatenate([signatures.whitened(t, t) for t in self.grid]) * self.judge.scale
        cost = (2.0 * self.grid[:, None] + signatures.own_s + self.least_s).ravel()
        return Columns(rows, cost, self.judge.prior, self.judge.targets, self.judge.floor)

    def tell(self, what: str, count: int, gap: float) -> None:
        """Tell the progress."""
        if self._progress is not None:
            self._progress(what, count, gap)

    def require_seen(self) -> None:
        """Raise DataError where no sequence that the fixture can execute shows a target."""
        hidden = [NAMES[self.judge.targets[i]] for i in unseen(self.coarse)]
        if hidden:
            raise DataError(
                f"No sequence that this fixture can execute shows {', '.join(hidden)}: take these "
                "targets out, or use a fixture with more freedom (both axes turning, more travel or positions)."
            )

    def relaxed(self, total_s: float) -> Relaxed:
        """The optimum with fractions: on the coarse grid of equal windows, then with any windows where it matters."""
        optimum, self.columns, self.sequence, self.windows = self._optimum(self.signatures, self.coarse, total_s)
        return optimum

    def bound(self, total_s: float) -> Relaxed:
        """Likewise with as little drift as there can be: no plan is better."""
        return self._optimum(self.bounded, self._coarse(self.bounded), total_s)[0]

    def _optimum(
        self, signatures: Signatures, coarse: Columns, total_s: float
    ) -> tuple[Relaxed, Columns, Indices, Array]:
        def tell(count: int, gap: float) -> None:
            self.tell("optimum", count, gap)

        # The first sequence has no move before it.
        total_s += self.least_s
        rough = relaxed_optimum(coarse, total_s, progress=tell)
        columns, sequence, windows = self._with_fine_windows(signatures, coarse, rough)
        return relaxed_optimum(columns, total_s, start=rough, progress=tell), columns, sequence, windows

    def _with_fine_windows(
        self, signatures: Signatures, coarse: Columns, rough: Relaxed
    ) -> tuple[Columns, Indices, Array]:
        """Columns with a start and an end window of their own for the sequences that are worth it.

        The information of a sequence is concave in its windows, so that the coarse grid loses a little between its
        points; sequences that fall short by more than that are left as they are.
        """
        K = len(signatures)
        by_sequence = rough.worth.reshape(-1, K).max(axis=0)
        near = np.argsort(-by_sequence)[:_FINE_SEQUENCES]
        near = near[by_sequence[near] > _NEARLY]
        fine = self.limits.grid_s(_FINE_GRID)
        pairs = np.stack(np.meshgrid(fine, fine, indexing="ij"), axis=-1).reshape(-1, 2)
        sequence, windows = np.repeat(near, len(pairs)), np.tile(pairs, (len(near), 1))
        rows = signatures.whitened(windows[:, 0], windows[:, 1], sequence) * self.judge.scale
        cost = windows.sum(axis=1) + signatures.own_s[sequence] + self.least_s
        added = replace(coarse, rows=rows, cost_s=cost)
        g, X = coarse.variances(coarse.information(rough.which, rough.weight))
        worth = added.gains(X, g) @ rough.weights / cost
        good = np.argsort(-worth)[:_FINE_COLUMNS]
        columns = replace(
            coarse, rows=np.concatenate([coarse.rows, rows[good]]), cost_s=np.concatenate([coarse.cost_s, cost[good]])
        )
        every, equal = np.tile(np.arange(K), len(self.grid)), np.repeat(self.grid, K)
        return (
            columns,
            np.concatenate([every, sequence[good]]),
            np.concatenate([np.stack([equal, equal], axis=1), windows[good]]),
        )

    def pool(self, relaxed: Relaxed) -> Pool:
        """What whole sequences are chosen from: the optimum's, what is worth nearly as much, and Table 1."""
        best: dict[int, int] = {}
        # Of each sequence its best windows: what makes plans different is the sequence.
        for j in np.argsort(-relaxed.worth, kind="stable").tolist():
            best.setdefault(int(self.sequence[j]), j)
            if len(best) == _POOL:
                break
        time = np.zeros(len(self.signatures))
        np.add.at(time, self.sequence[relaxed.which], relaxed.weight * self.columns.cost_s[relaxed.which])
        for j in relaxed.which[np.argsort(-relaxed.weight, kind="stable")].tolist():
            best[int(self.sequence[j])] = j  # what is run in fact has the windows that it is run with
        known = [self._number[c.key] for c in self._table_1 if c.key in self._number]
        worth = np.where(np.isin(np.arange(len(self.sequence)), list(best.values())), 2.0, relaxed.worth)
        for k in known:
            if k not in best:
                own = np.flatnonzero(self.sequence == k)
                best[k] = int(own[np.argmax(worth[own])])
        sequences = np.array(list(best))
        columns = np.array(list(best.values()))
        by_time = np.argsort(-time[sequences], kind="stable")
        position = {int(k): i for i, k in enumerate(sequences)}
        starts = [by_time[:count] for count in _START_COUNTS]
        if known:
            starts.append(np.array([position[k] for k in known]))
        return Pool(sequences, self.windows[columns], tuple(starts))

    def in_time(self, total_s: float) -> Plan:
        """The best plan for a time."""
        return self._bounded(self.whole(self.relaxed(total_s), total_s))

    def _bounded(self, plan: Plan) -> Plan:
        """The plan with what no plan of its length can do better than."""
        bound = self.bound(plan.total_s)
        first = np.argsort(-bound.weights)
        ruling = tuple(
            (NAMES[self.judge.targets[i]], float(bound.weights[i])) for i in first if bound.weights[i] > 0.02
        )
        return replace(plan, bound=bound.bound, ruling=ruling)

    def whole(self, relaxed: Relaxed, total_s: float) -> Plan:
        """Whole sequences for the optimum with fractions; the time of the moves is first guessed, then known."""
        best: Plan | None = None
        pool, judge = self.pool(relaxed), self.judge
        per_sequence = self.least_s + self.stand.outer.move_s(0.0, 90.0)
        for _ in range(_ROUNDS):
            most = self.limits.most_sequences
            try:
                choice = select(judge, pool, total_s, per_sequence, most, lambda: self.tell("plan", 0, 0.0))
                plan = finished(judge, choice, self.stand, self.conditions, self.targets, total_s)
            except ValueError:
                break
            except TooLongError as error:
                per_sequence = max(1.05 * per_sequence, error.per_sequence_s)
                continue
            if best is None or plan.ratio < best.ratio:
                best = plan
            per_sequence = plan.moves_s / max(1, len(plan.candidates) - 1)
            here = np.array([pool.which.tolist().index(k) for k in choice.which])
            pool = replace(pool, starts=(here,))
            judge = self._corrected(judge, plan)
        if best is not None and math.isfinite(best.ratio):
            best = self._polished(best, pool, judge, total_s)
        if best is None:
            raise InputError(
                f"{total_s:g} s are too short for a test that shows all targets: give more time, shorter windows "
                "(shortest_window_s), or fewer targets."
            )
        return best

    def _polished(self, plan: Plan, pool: Pool, judge: Judge, total_s: float) -> Plan:
        """A plan after exchanges by the covariance of the whole test, ordered and shared out anew each time."""
        for _ in range(_POLISHES):
            test = WholeTest(judge, pool, total_s)
            which, windows_s = test.improved(
                self._positions(plan.candidates), plan.windows_s, lambda: self.tell("plan", 0, 0.0)
            )
            found, choice = plan, Choice(which, windows_s, math.nan)
            for _ in range(_BALANCES):
                try:
                    trial = finished(judge, choice, self.stand, self.conditions, self.targets, total_s)
                except TooLongError:
                    break
                judge = self._corrected(judge, trial)
                found = min(found, trial, key=lambda p: p.ratio)
            if found.ratio > plan.ratio * (1.0 - _WORTHWHILE):
                return found
            plan = found
        return plan

    def _corrected(self, judge: Judge, plan: Plan) -> Judge:
        """The judge with variances as the covariance of the whole test has them for a plan: drift is not additive."""
        if not math.isfinite(plan.ratio):
            return judge
        raw = replace(judge, correction=np.ones_like(judge.correction))
        information = raw.information(self._positions(plan.candidates), plan.windows_s)
        simple = raw.variances(raw.prior + information.sum(axis=0))
        return replace(judge, correction=plan.ratios[judge.targets] ** 2 / simple)

    def in_least_time(self) -> Plan:
        """The shortest plan that meets the targets."""
        self._require_reach()
        total_s, relaxed = self._least_relaxed_time()
        too_short = 0.0
        plan: Plan | None = None
        for _ in range(_TRIES):
            try:
                plan = self.whole(relaxed, total_s)
                ratio = plan.ratio
            except InputError:  # too short for any
                ratio = math.inf
            if plan is not None and ratio <= MET:
                return self._bounded(self._shortened(self._halved(plan, relaxed, too_short)))
            too_short = total_s
            # Variances fall with the time, and a little more for what whole numbers cost.
            total_s *= min(max(1.02 * ratio**2, 1.04), 1.5)
            if total_s > self.limits.longest_test_s:
                break
            relaxed = self.relaxed(total_s)
        raise self._out_of_reach(plan or self.whole(relaxed, total_s))

    def _halved(self, plan: Plan, relaxed: Relaxed, too_short_s: float) -> Plan:
        """A shorter plan between one that meets the targets and a time that was too short, by halving the gap."""
        for _ in range(_HALVINGS):
            if plan.total_s < (1.0 + _CLOSE) * too_short_s or too_short_s == 0.0:
                break
            total_s = math.sqrt(plan.total_s * too_short_s)
            try:
                trial = self.whole(relaxed, total_s)
            except InputError:  # too short for any
                too_short_s = total_s
                continue
            if trial.ratio <= MET:
                plan = trial
            else:
                too_short_s = total_s
        return plan

    def _require_reach(self) -> None:
        """Raise DataError where no time is enough: what the whole test has in common remains."""
        g = limits_of_time(self.coarse, self.limits.longest_test_s)
        if g.max() > 1.0:
            k = int(self.judge.targets[np.argmax(g)])
            raise DataError(
                f"The target of {NAMES[k]} is out of reach however long the test is: {math.sqrt(g.max()):.3g} times "
                "the target remains of the uncertainty of gravity and north and of the drift of the unit, which no "
                "sequence takes away; measure gravity better (gravity_sigma_m_s2), or take a larger target."
            )

    def _least_relaxed_time(self) -> tuple[float, Relaxed]:
        total_s = _FIRST_TIME_S
        for _ in range(_TRIES):
            relaxed = self.relaxed(total_s)
            if abs(relaxed.ratio - 1.0) < 0.02:
                break
            total_s = min(total_s * relaxed.ratio**2, 4.0 * self.limits.longest_test_s)
            if relaxed.bound > 1.0 and total_s > self.limits.longest_test_s:
                relaxed = self.relaxed(self.limits.longest_test_s)
                if relaxed.bound > 1.0:
                    raise self._out_of_reach(self.whole(relaxed, self.limits.longest_test_s))
        return total_s, relaxed

    def _out_of_reach(self, plan: Plan) -> DataError:
        k = NAMES.index(plan.worst)
        source, share = plan.prediction.limiting(k)
        return DataError(
            f"The targets are out of reach in {self.limits.longest_test_s / 3600.0:.3g} h: {plan.worst} stays at "
            f"{plan.ratio:.3g} times its target, {100.0 * share:.0f} % of its variance by {source.replace('_', ' ')}; "
            "take larger targets, a better unit, fixture or gravity, or allow more time."
        )

    def _shortened(self, plan: Plan) -> Plan:
        """Windows cut to what the targets need."""
        which = self._positions(plan.candidates)
        choice = self.judge.refine(which, plan.windows_s, None)
        total_s = plan.total_s + float(choice.windows_s.sum() - plan.windows_s.sum())
        prediction = predict(plan.candidates, choice.windows_s, self.stand, self.conditions, self.targets)
        shorter = replace(plan, windows_s=choice.windows_s, total_s=total_s, prediction=prediction)
        return shorter if shorter.ratio <= MET and total_s < plan.total_s else plan

    def _positions(self, candidates: Sequence[Candidate]) -> Indices:
        return np.array([self._number[c.key] for c in candidates], dtype=np.intp)
