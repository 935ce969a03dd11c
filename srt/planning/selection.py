"""Selection of whole sequences near the continuous optimum, by local search, and optimal lengths of their windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.optimize import minimize

from srt.planning.continuous_design import remembered
from srt.planning.information import equilibrated_inverse, inverse_diagonals

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.planning.information import Signatures
    from srt.types import Array, Indices


_PROMISING: Final = 25
"""Candidates tried in each place: those with the steepest derivative, and as many by derivative per time."""
_POWERS: Final = (3.0, 16.0)
"""Powers of the mean over the targets that stands for their largest in two rounds of search: it is differentiable."""
_MOST_PASSES: Final = 12
"""Passes over all places at most; the search ends before when a pass gains too little."""
_FACTORS: Final = np.geomspace(0.03, 2.0, 9)
"""Common factors of the windows for which the information is computed; it is interpolated between them."""
_STEP: Final = 1e-3
"""Relative step of a window length for the derivative of its information: the error of a central difference is 1e-6."""
_LEAST_GAIN: Final = 1e-5
"""Decrease of the logarithm of the criterion in a pass below which the search ends."""


def power_mean(values: Array, power: float) -> Array:
    """Power mean over the last axis, scaled by the largest value so that no power overflows."""
    largest = values.max(axis=-1)
    return np.asarray(largest * np.mean((values / largest[..., None]) ** power, axis=-1) ** (1.0 / power))


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Selected sequences and the lengths of their windows.

    Attributes
    ----------
    which : ndarray of int, shape (n,)
        Positions in the signatures; a sequence may occur several times.
    windows_s : ndarray, shape (n, 2)
        Length of the start and of the end window, s.
    ratio : float
        Largest sigma over target.
    """

    which: Indices
    windows_s: Array
    ratio: float


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
        raw = inverse_diagonals(M.reshape(-1, *M.shape[-2:])).reshape(M.shape[:-1])
        return np.asarray(self.correction * (raw[..., self.targets] + self.floor))

    def ratio(self, which: Indices, windows_s: Array) -> float:
        """Largest sigma over target."""
        return float(np.sqrt(self.variances(self.prior + self.information(which, windows_s).sum(axis=0)).max()))

    def filled(self, windows_s: Array, budget_s: float) -> Array | None:
        """Windows scaled by one factor, within their limits, to fill a time; None if the shortest do not fit."""
        if budget_s < self.shortest_s * windows_s.size:
            return None
        return _filled(windows_s.ravel(), budget_s, self.shortest_s, self.longest_s).reshape(windows_s.shape)

    def log_variances(self, which: Indices, windows_s: Array) -> tuple[Array, Array]:
        """Logarithms of the variances over target, shape (q,), and their derivatives by the windows, (q, 2 n)."""
        n = len(which)
        h = _STEP * windows_s[None] * np.eye(2)[:, None]
        # One call for all: with a dozen sequences, most of the time would be overhead.
        trials = np.concatenate([windows_s[None], windows_s + h, windows_s - h])
        each = self.information(np.tile(which, 5), trials.reshape(-1, 2)).reshape(5, n, *self.prior.shape)
        inverse = equilibrated_inverse(self.prior + each[0].sum(axis=0))
        g, X = np.diag(inverse)[self.targets] + self.floor, inverse[:, self.targets]
        change = (each[1:3] - each[3:]) / (2.0 * _STEP * windows_s.T[:, :, None, None])
        slopes = -np.einsum("enqb,bq->qne", X.T @ change, X)
        return np.log(self.correction * g), slopes.reshape(len(self.targets), -1) / g[:, None]

    def refine(self, which: Indices, windows_s: Array, budget_s: float | None) -> Selection:
        """Optimal lengths of the windows: the smallest ratio in a time, or the shortest windows that meet the targets.

        Parameters
        ----------
        which : ndarray of int, shape (n,)
        windows_s : ndarray, shape (n, 2)
            Initial lengths.
        budget_s : float or None
            Time for all windows together, s; None: the least that the targets allow.
        """
        n = len(which)
        low, high = self.shortest_s, self.longest_s
        first = np.clip(windows_s, low, high).ravel()
        if budget_s is not None:
            first = _filled(first, budget_s, low, high)

        @remembered
        def logs(x: Array) -> tuple[Array, Array]:
            return self.log_variances(which, x[: 2 * n].reshape(n, 2))

        bounds: list[tuple[float | None, float | None]] = [(low, high)] * (2 * n)
        ones = np.ones(2 * n)
        if budget_s is None:
            problem: dict[str, Any] = {
                "fun": lambda x: float(x.sum()) / n,
                "jac": lambda _: ones / n,
                "constraints": [{"type": "ineq", "fun": lambda x: -logs(x)[0], "jac": lambda x: -logs(x)[1]}],
            }
        else:
            bounds.append((None, None))
            # Scaled to one, like the ratios.
            spare = {"fun": lambda x: 1.0 - x[:-1].sum() / budget_s, "jac": lambda _: np.append(-ones / budget_s, 0.0)}
            epigraph = {
                "fun": lambda x: x[-1] - logs(x)[0],
                "jac": lambda x: np.hstack([-logs(x)[1], np.ones((len(self.targets), 1))]),
            }
            problem = {
                "fun": lambda x: float(x[-1]),
                "jac": lambda _: np.append(np.zeros(2 * n), 1.0),
                "constraints": [{"type": "ineq"} | spare, {"type": "ineq"} | epigraph],
            }
            first = np.append(first, logs(first)[0].max())
        found = minimize(x0=first, method="SLSQP", bounds=bounds, options={"maxiter": 150, "ftol": 1e-6}, **problem)
        windows = np.clip(found.x[: 2 * n], low, high)
        if budget_s is not None:
            windows = _filled(windows, budget_s, low, high)
        windows = windows.reshape(n, 2)
        ratio = self.ratio(which, windows)
        guess = first[: 2 * n].reshape(n, 2)
        if budget_s is not None and (before := self.ratio(which, guess)) < ratio:
            windows, ratio = guess, before
        return Selection(which, windows, ratio)


def _filled(windows: Array, budget_s: float, low: float, high: float) -> Array:
    """Windows scaled by one factor, within their limits, to fill a time; at the limits if no factor can."""
    if budget_s <= low * len(windows):
        return np.full(len(windows), low)
    if budget_s >= high * len(windows):
        return np.full(len(windows), high)
    # The sum is linear in the factor between those at which a window reaches a limit.
    factors = np.sort(np.concatenate([low / windows, high / windows]))
    sums = np.clip(factors[:, None] * windows, low, high).sum(axis=1)
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


def select(
    criterion: AccuracyCriterion,
    pool: CandidatePool,
    total_s: float,
    per_sequence_s: float,
    most: int,
    progress: Callable[[], None] | None = None,
) -> Selection:
    """Select whole sequences that fit into a time.

    From several starts, sequences are added, taken out and exchanged as long as that helps; the windows of the best
    choices then share the time as is best for the targets.

    Parameters
    ----------
    total_s : float
        Length of the whole test, s.
    per_sequence_s : float
        Time that a sequence takes beside its windows and rotations (moves, waits), s.
    most : int
        Largest number of sequences.
    progress : callable, optional
        Called after the search from each initial selection.

    Raises
    ------
    ValueError
        No initial selection fits into the time.
    """
    fixed = criterion.signatures.between_windows_s[pool.which] + per_sequence_s
    search = _Search(criterion, pool, fixed, total_s, most)
    found = []
    for start in pool.starts:
        chosen = search.run(start)
        if chosen is not None:
            budget = total_s - float(fixed[chosen].sum())
            found.append(criterion.refine(pool.which[chosen], search.windows(chosen), budget))
        if progress is not None:
            progress()
    if not found:
        raise ValueError(f"{total_s:g} s hold no selection of sequences that observes all targets")
    return min(found, key=lambda choice: choice.ratio)


class _Search:
    """Local search among selections whose windows fill the time, by the power mean of the variances over target.

    The information of every sequence is computed for a few common factors of the windows and interpolated linearly
    between them. The error is small, and the lengths of the windows are optimised exactly at the end.
    """

    def __init__(
        self, criterion: AccuracyCriterion, pool: CandidatePool, fixed_s: Array, total_s: float, most: int
    ) -> None:
        self.criterion, self.total_s, self.pool_windows, self.most = criterion, total_s, pool.windows_s, most
        windows = np.clip(_FACTORS[:, None, None] * pool.windows_s, criterion.shortest_s, criterion.longest_s)
        # The last of the pool is no sequence: it costs and tells nothing.
        self.nothing = len(pool.which)
        self.cost = np.pad(windows.sum(axis=2) + fixed_s, ((0, 0), (0, 1)))
        information = np.stack([criterion.information(pool.which, w) for w in windows])
        self.information = np.pad(information, ((0, 0), (0, 1), (0, 0), (0, 0)))
        self.power = _POWERS[0]

    def windows(self, chosen: Indices) -> Array:
        """Windows of a selection that fill the time, shape (n, 2), s."""
        level, share = self._level(self.cost[:, chosen].sum(axis=1)[:, None])
        factor = _FACTORS[level[0]] * (_FACTORS[level[0] + 1] / _FACTORS[level[0]]) ** share[0]
        return np.asarray(
            np.clip(factor * self.pool_windows[chosen], self.criterion.shortest_s, self.criterion.longest_s)
        )

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
            g = self.criterion.variances(self.criterion.prior + M)
            largest = g.max(axis=1)
            out[fits] = np.log(largest) + np.log(((g / largest[:, None]) ** self.power).mean(axis=1)) / self.power
        return out

    def run(self, start: Indices) -> Indices | None:
        """Improve a selection; None if none fits into the time."""
        chosen = start.tolist()[: self.most]
        while chosen and self.cost[0, chosen].sum() > self.total_s:
            chosen.pop()
        if not chosen:
            return None
        for power in _POWERS:
            self.power = power
            now = float(self._of(chosen))
            for _ in range(_MOST_PASSES):
                chosen, value = self._pass(chosen, now)
                if value > now - _LEAST_GAIN:
                    break
                now = value
        return np.array(chosen, dtype=np.intp)

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
            k = int(np.argmin(values[:-1]))
            without = float(values[-1]) if rest and i < len(chosen) else np.inf
            if min(values[k], without) < now - 1e-9:
                chosen, now, total = rest, without, (cost, information)
                if without >= values[k]:
                    chosen, now = [*rest, int(near[k])], float(values[k])
                    total = cost + self.cost[:, near[k]], information + self.information[:, near[k]]
        return chosen, now

    def _promising(self, cost: Array, information: Array) -> Indices:
        """Candidates of the pool that decrease the criterion most, by its derivative and by its derivative per time."""
        level, _ = self._level(cost[:, None])
        inverse = equilibrated_inverse(self.criterion.prior + information[level[0]])
        g, X = np.diag(inverse)[self.criterion.targets] + self.criterion.floor, inverse[:, self.criterion.targets]
        wanted = self.criterion.correction * g
        weight = self.criterion.correction * (wanted / wanted.max()) ** (self.power - 1.0) / wanted.max()
        gain = self.information[level[0], :-1].reshape(self.nothing, -1) @ ((X * weight) @ X.T).ravel()
        by_time = gain / self.cost[level[0], :-1]
        return np.union1d(np.argsort(-gain)[:_PROMISING], np.argsort(-by_time)[:_PROMISING]).astype(np.intp)
