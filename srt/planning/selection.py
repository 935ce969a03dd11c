"""Selection of whole sequences near the continuous optimum, by local search, and optimal lengths of their windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import minimize

from srt.planning.continuous_design import remembered, smallest_maximum
from srt.planning.information import target_variances
from srt.ranking import ranked, rounded

if TYPE_CHECKING:
    from srt.planning.information import Signatures
    from srt.types import Array, Indices


_PROMISING: Final = 25
"""Candidates tried in each place: those with the steepest derivative, and as many by derivative per time."""
_POWERS: Final = (3.0, 16.0)
"""Powers of the mean over the targets that stands for their largest in two rounds of search: it is differentiable."""
_MOST_PASSES: Final = 12
"""Passes over all places at most; the search ends before when a pass gains too little."""
_WEAK: Final = 1e-4
"""Information on every unknown in a search, over squared targets: far less than any plan gives. Selections that show
next to nothing are nearly singular without it, and rounding errors would decide which is the better one."""
_FACTORS: Final = np.geomspace(0.03, 2.0, 9)
"""Common factors of the windows for which the information is computed; it is interpolated between them."""
_STEP: Final = 1e-3
"""Relative step of a window length for the derivative of its information: the error of a central difference is 1e-6."""
_LEAST_CHANGE: Final = 1e-6
"""Decrease of the logarithm of the criterion for which a selection is changed: far above rounding errors."""
_LEAST_GAIN: Final = 1e-5
"""Decrease of the logarithm of the criterion in a pass below which the search ends."""


@dataclass(frozen=True, slots=True, eq=False)
class AccuracyCriterion:
    """Accuracy of a selection of sequences relative to the targets.

    Attributes
    ----------
    scale : ndarray, shape (N_UNKNOWNS,)
        Units of the unknowns, SI: their targets, where there are any.
    prior : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS)
        Information before the test, in these units.
    targets : ndarray of int
        Unknowns that have a target.
    floor : ndarray, shape (q,)
        Variance of each target that no test reduces.
    shortest_s, longest_s : float
        Limits of the length of a window, s.
    correction : ndarray, shape (q,)
        Factors of the variances, from the covariance of the whole test.
    """

    signatures: Signatures
    scale: Array
    prior: Array
    targets: Indices
    floor: Array
    shortest_s: float
    longest_s: float
    correction: Array

    def information(self, which: Indices, windows_s: Array) -> Array:
        """Information of each sequence, shape (n, p, p)."""
        rows = self.signatures.whitened(windows_s[:, 0], windows_s[:, 1], which) * self.scale
        return np.asarray(np.swapaxes(rows, 1, 2) @ rows)

    def variances(self, M: Array) -> Array:
        """Variance over squared target, shape (..., q)."""
        return np.asarray(self.correction * target_variances(M, self.targets, self.floor)[0])

    def log_variances(self, which: Indices, windows_s: Array) -> tuple[Array, Array]:
        """Logarithms of the variances over target, shape (q,), and their derivatives by the windows, (q, 2 n)."""
        n = len(which)
        h = _STEP * windows_s[None] * np.eye(2)[:, None]
        # One call for all: with a dozen sequences, most of the time would be overhead.
        trials = np.concatenate([windows_s[None], windows_s + h, windows_s - h])
        each = self.information(np.tile(which, 5), trials.reshape(-1, 2)).reshape(5, n, *self.prior.shape)
        g, X = target_variances(self.prior + each[0].sum(axis=0), self.targets, self.floor)
        change = (each[1:3] - each[3:]) / (2.0 * _STEP * windows_s.T[:, :, None, None])
        slopes = -np.einsum("enqb,bq->qne", X.T @ change, X)
        return np.log(self.correction * g), slopes.reshape(len(self.targets), -1) / g[:, None]

    def best_windows(self, which: Indices, windows_s: Array, budget_s: float) -> Array:
        """Lengths of the windows, shape (n, 2), with the smallest ratio in a time for all, from initial ones."""
        limits = self.shortest_s, self.longest_s
        first = filled(np.clip(windows_s, *limits), budget_s, *limits)
        found = smallest_maximum(
            lambda x: self.log_variances(which, x.reshape(-1, 2)),
            first.ravel(),
            np.full(first.size, 1.0 / budget_s),
            limits,
            1e-6,
        )
        full = filled(found.reshape(-1, 2), budget_s, *limits)
        return min(full, first, key=lambda windows: self.log_variances(which, windows)[0].max())

    def shortest_windows(self, which: Indices, windows_s: Array) -> Array:
        """Shortest windows, shape (n, 2), that meet the targets, from initial ones."""
        logs = remembered(lambda x: self.log_variances(which, x.reshape(-1, 2)))
        per_window = np.full(windows_s.size, 1.0 / windows_s.size)
        found = minimize(
            lambda x: per_window @ x,
            windows_s.ravel(),
            jac=lambda _: per_window,
            method="SLSQP",
            bounds=[(self.shortest_s, self.longest_s)] * windows_s.size,
            constraints=[{"type": "ineq", "fun": lambda x: -logs(x)[0], "jac": lambda x: -logs(x)[1]}],
            options={"maxiter": 150, "ftol": 1e-6},
        )
        return np.asarray(np.clip(found.x, self.shortest_s, self.longest_s).reshape(-1, 2))


def filled(windows: Array, budget_s: float, low: float, high: float) -> Array:
    """Windows scaled by one factor, within their limits, to fill a time; at the limits if no factor can."""
    # The sum is linear in the factor between those at which a window reaches a limit.
    factors = np.sort(np.concatenate([low / windows, high / windows], axis=None))
    sums = np.clip(factors[:, None] * windows.ravel(), low, high).sum(axis=1)
    return np.asarray(np.clip(np.interp(budget_s, sums, factors) * windows, low, high))


@dataclass(frozen=True, slots=True, eq=False)
class CandidatePool:
    """Candidates for the selection of whole sequences.

    Attributes
    ----------
    which : ndarray of int, shape (m,)
        Positions in the signatures.
    windows_s : ndarray, shape (m, 2)
        Relative lengths: they are scaled by one factor until the sequences fill the time.
    starts : tuple of ndarray of int
        Initial selections, as positions in ``which``.
    """

    which: Indices
    windows_s: Array
    starts: tuple[Indices, ...]


class SelectionSearch:
    """Local search among selections whose windows fill the time, by the power mean of the variances over target.

    The information of every sequence is computed for a few common factors of the windows and interpolated linearly
    between them. The error is small, and the lengths of the windows are optimised exactly at the end.

    Parameters
    ----------
    total_s : float
        Length of the whole test, s.
    most : int
        Largest number of sequences.
    """

    def __init__(self, criterion: AccuracyCriterion, pool: CandidatePool, total_s: float, most: int) -> None:
        self.criterion, self.total_s, self.pool, self.most = criterion, total_s, pool, most
        self._windows = np.clip(_FACTORS[:, None, None] * pool.windows_s, criterion.shortest_s, criterion.longest_s)
        self.prior = criterion.prior + _WEAK * np.eye(len(criterion.prior))
        # The last of the pool is no sequence: it costs and tells nothing.
        self.nothing = len(pool.which)
        information = np.stack([criterion.information(pool.which, w) for w in self._windows])
        self.information = np.pad(information, ((0, 0), (0, 1), (0, 0), (0, 0)))

    def selections(self, per_sequence_s: float) -> list[Indices]:
        """Selections as positions in the pool, from every start; those of which nothing fits are left out.

        Sequences are added, taken out and exchanged as long as that helps.

        Parameters
        ----------
        per_sequence_s : float
            Time that a sequence takes beside its windows and rotations (moves, waits), s.
        """
        fixed = self.criterion.signatures.between_windows_s[self.pool.which] + per_sequence_s
        self.cost = np.pad(self._windows.sum(axis=2) + fixed, ((0, 0), (0, 1)))
        return [chosen for chosen in map(self._improved, self.pool.starts) if chosen.size]

    def _improved(self, start: Indices) -> Indices:
        """Improve a selection; empty if nothing of it fits into the time."""
        chosen = start.tolist()[: self.most]
        while chosen and self.cost[0, chosen].sum() > self.total_s:
            chosen.pop()
        for self.power in _POWERS if chosen else ():
            now = self._of(chosen)
            for _ in range(_MOST_PASSES):
                chosen, value = self._pass(chosen, now)
                if value > now - _LEAST_GAIN:
                    break
                now = value
        return np.array(chosen, dtype=np.intp)

    def _level(self, cost: Array) -> tuple[Indices, Array]:
        """Interval of factors in which costs, shape (factors, n), reach the time, and the fraction of that interval."""
        # Costs do not decrease with the factor: the last interval that begins within the time, else the first.
        level = (cost[1:-1] <= self.total_s).sum(axis=0)
        n = np.arange(cost.shape[1])
        low, high = cost[level, n], cost[level + 1, n]
        share = np.minimum(np.maximum((self.total_s - low) / np.maximum(high - low, 1e-9), 0.0), 1.0)
        return level, np.where(cost[0] <= self.total_s, share, np.nan)

    def values(self, cost: Array, information: Array, added: Indices) -> Array:
        """Criterion of a selection with each of n further sequences, shape (n,); inf: too long.

        Parameters
        ----------
        cost : ndarray, shape (factors,)
        information : ndarray, shape (factors, p, p)
        added : ndarray of int, shape (n,)
            Positions in the pool, or ``nothing``.
        """
        level, share = self._level(cost[:, None] + self.cost[:, added])
        fits = np.flatnonzero(np.isfinite(share))
        out = np.full(len(level), np.inf)
        if fits.size:
            at, part, k = level[fits], share[fits, None, None], added[fits]
            M = (1.0 - part) * information[at] + part * information[at + 1]
            M += (1.0 - part) * self.information[at, k] + part * self.information[at + 1, k]
            g = self.criterion.variances(self.prior + M)
            largest = g.max(axis=1)
            out[fits] = np.log(largest) + np.log(((g / largest[:, None]) ** self.power).mean(axis=1)) / self.power
        return out

    def _of(self, chosen: list[int]) -> float:
        cost, information = self.cost[:, chosen].sum(axis=1), self.information[:, chosen].sum(axis=1)
        return float(self.values(cost, information, np.array([self.nothing]))[0])

    def _pass(self, chosen: list[int], now: float) -> tuple[list[int], float]:
        """Replace or drop the sequence in each place, then add one, wherever that decreases the criterion."""
        every: Indices = np.array(chosen, dtype=np.intp)
        total = self.cost[:, every].sum(axis=1), self.information[:, every].sum(axis=1)
        for i in range(min(len(chosen), self.most - 1), -1, -1):
            rest = chosen[:i] + chosen[i + 1 :]
            cost, information = total
            if i < len(chosen):
                cost, information = cost - self.cost[:, chosen[i]], information - self.information[:, chosen[i]]
            near = self._promising(cost, information)
            values = self.values(cost, information, np.append(near, self.nothing))
            k = int(np.argmin(rounded(values[:-1], scale=1.0)))
            without = float(values[-1]) if rest and i < len(chosen) else np.inf
            if min(values[k], without) < now - _LEAST_CHANGE:
                chosen, now, total = rest, without, (cost, information)
                if without >= values[k]:
                    chosen, now = [*rest, int(near[k])], float(values[k])
                    total = cost + self.cost[:, near[k]], information + self.information[:, near[k]]
        return chosen, now

    def _promising(self, cost: Array, information: Array) -> Indices:
        """Candidates of the pool that decrease the criterion most, by its derivative and by its derivative per time."""
        level, _ = self._level(cost[:, None])
        own = self.criterion
        g, X = target_variances(self.prior + information[level[0]], own.targets, own.floor)
        wanted = own.correction * g
        weight = own.correction * (wanted / wanted.max()) ** (self.power - 1.0) / wanted.max()
        gain = self.information[level[0], :-1].reshape(self.nothing, -1) @ ((X * weight) @ X.T).ravel()
        by_time = gain / self.cost[level[0], :-1]
        return np.union1d(ranked(gain)[:_PROMISING], ranked(by_time)[:_PROMISING]).astype(np.intp)
