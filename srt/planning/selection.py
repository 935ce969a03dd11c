"""Whole sequences from the optimum with fractions: build up, exchange, and share the time among the windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.optimize import minimize

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.planning.information import Signatures
    from srt.types import Array, Indices


_PROMISING: Final = 25
_POWERS: Final = (3.0, 16.0)
"""Of the mean over the targets that stands for their largest while whole sequences are exchanged: it has a slope."""
_MOST_PASSES: Final = 12
_FACTORS: Final = np.geomspace(0.03, 2.0, 9)
_STEP: Final = 1e-3
"""Relative step of a window's length for the slope of its information: the error of a central difference is 1e-6."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Sequences to run, with their windows.

    Attributes
    ----------
    which : ndarray of int, shape (n,)
        Sequences of the signatures; may repeat.
    windows_s : ndarray, shape (n, 2)
        Length of the start and of the end window, s.
    ratio : float
        Largest sigma over its target.
    """

    which: Indices
    windows_s: Array
    ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """The accuracy of any choice against the targets.

    Attributes
    ----------
    signatures : Signatures
    scale : ndarray, shape (N_UNKNOWNS,)
        Units of the unknowns: the targets where there are any.
    prior : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS)
        Information beforehand, in these units.
    targets : ndarray of int
    floor : ndarray, shape (q,)
        Variance of each target that nothing takes away.
    shortest_s, longest_s : float
        Limits of a window.
    correction : ndarray, shape (q,)
        By which variances are multiplied: what the covariance of the whole test has shown them to be.
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
        """Information of each sequence by itself, shape (n, p, p)."""
        rows = self.signatures.whitened(windows_s[:, 0], windows_s[:, 1], which) * self.scale
        return np.asarray(np.swapaxes(rows, 1, 2) @ rows)

    def inverse(self, M: Array) -> Array:
        """Inverses of information matrices, equilibrated, shape (..., p, p)."""
        d = 1.0 / np.sqrt(np.einsum("...aa->...a", M))
        outer = d[..., :, None] * d[..., None, :]
        return np.asarray(np.linalg.inv(M * outer) * outer)

    def variances(self, M: Array) -> Array:
        """Variances of the targets over theirs squared, shape (..., q)."""
        raw = np.einsum("...aa->...a", self.inverse(M))[..., self.targets] + self.floor
        return np.asarray(self.correction * raw)

    def ratio(self, which: Indices, windows_s: Array) -> float:
        """Largest sigma over its target."""
        return float(np.sqrt(self.variances(self.prior + self.information(which, windows_s).sum(axis=0)).max()))

    def filled(self, windows_s: Array, budget_s: float) -> Array | None:
        """Windows within their limits that fill a budget, all by one factor; None if the shortest do not fit."""
        if budget_s < self.shortest_s * windows_s.size:
            return None
        return _filled(windows_s.ravel(), budget_s, self.shortest_s, self.longest_s).reshape(windows_s.shape)

    def refine(self, which: Indices, windows_s: Array, budget_s: float | None) -> Choice:
        """Best lengths of the windows: for the smallest ratio within a budget, or the shortest that meets the targets.

        Parameters
        ----------
        which : ndarray of int, shape (n,)
        windows_s : ndarray, shape (n, 2)
            First guess.
        budget_s : float or None
            Time for all windows together, s; None: as little as the targets allow.
        """
        n = len(which)
        low, high = self.shortest_s, self.longest_s
        first = np.clip(windows_s, low, high).ravel()
        if budget_s is not None:
            first = _filled(first, budget_s, low, high)

        def evaluated(x: Array) -> tuple[Array, Array]:
            windows = x[: 2 * n].reshape(n, 2)
            h = _STEP * windows[None] * np.eye(2)[:, None]
            # All in one: of a dozen sequences, most of the time would be overhead.
            trials = np.concatenate([windows[None], windows + h, windows - h])
            each = self.information(np.tile(which, 5), trials.reshape(-1, 2)).reshape(5, n, *self.prior.shape)
            inverse = self.inverse(self.prior + each[0].sum(axis=0))
            g, X = np.diag(inverse)[self.targets] + self.floor, inverse[:, self.targets]
            change = (each[1:3] - each[3:]) / (2.0 * _STEP * windows.T[:, :, None, None])
            slopes = -np.einsum("enqb,bq->qne", X.T @ change, X)
            return np.log(self.correction * g), slopes.reshape(len(self.targets), -1) / g[:, None]

        last: tuple[Array, tuple[Array, Array]] | None = None

        def logs(x: Array) -> tuple[Array, Array]:
            # Values and slopes are asked for one after the other.
            nonlocal last
            if last is None or not np.array_equal(x, last[0]):
                last = x.copy(), evaluated(x)
            return last[1]

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
            # Scaled to one, as the ratios are.
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
        if budget_s is not None and self.ratio(which, guess) < ratio:
            windows, ratio = guess, self.ratio(which, guess)
        return Choice(which, windows, ratio)


def _filled(windows: Array, budget_s: float, low: float, high: float) -> Array:
    """Windows within their limits that fill a budget, all by one factor; at the limits if none can."""
    if budget_s <= low * len(windows):
        return np.full(len(windows), low)
    if budget_s >= high * len(windows):
        return np.full(len(windows), high)
    smallest, largest = 0.0, high / windows.min()
    for _ in range(60):
        factor = 0.5 * (smallest + largest)
        smallest, largest = (
            (factor, largest) if np.clip(factor * windows, low, high).sum() < budget_s else (smallest, factor)
        )
    return np.clip(smallest * windows, low, high)


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """What whole sequences are chosen from.

    Attributes
    ----------
    which : ndarray of int, shape (m,)
        Sequences of the signatures.
    windows_s : ndarray, shape (m, 2)
        In proportion: all are made shorter or longer alike until the sequences fill the time.
    starts : tuple of ndarray of int
        Choices to begin from, positions in ``which``.
    """

    which: Indices
    windows_s: Array
    starts: tuple[Indices, ...]


def select(
    judge: Judge,
    pool: Pool,
    total_s: float,
    per_sequence_s: float,
    most: int,
    progress: Callable[[], None] | None = None,
) -> Choice:
    """Choose whole sequences that fit into a time.

    From several starts, sequences are added, taken out and exchanged as long as that helps; the windows of the best
    choices then share the time as is best for the targets.

    Parameters
    ----------
    judge : Judge
    pool : Pool
    total_s : float
        For everything, s.
    per_sequence_s : float
        What a sequence takes beside its windows and its rotations (moves, waits), s.
    most : int
        Sequences at the most.
    progress : callable, optional
        Called after each start.

    Raises
    ------
    ValueError
        No start fits into the time.
    """
    fixed = judge.signatures.own_s[pool.which] + per_sequence_s
    search = _Search(judge, pool, fixed, total_s, most)
    found = []
    for start in pool.starts:
        chosen = search.run(start)
        if chosen is not None:
            budget = total_s - float(fixed[chosen].sum())
            found.append(judge.refine(pool.which[chosen], search.windows(chosen), budget))
        if progress is not None:
            progress()
    if not found:
        raise ValueError(f"{total_s:g} s hold no choice of sequences that shows all targets")
    return min(found, key=lambda choice: choice.ratio)


class _Search:
    """Local search among choices whose windows fill the time, by the power mean of the targets' variances.

    The information of every sequence is computed for a few common factors of the windows; between them it is
    interpolated, which it is nearly linear enough for: the windows are shared out exactly at the end.
    """

    def __init__(self, judge: Judge, pool: Pool, fixed_s: Array, total_s: float, most: int) -> None:
        self.judge, self.total_s, self.pool_windows, self.most = judge, total_s, pool.windows_s, most
        windows = np.clip(_FACTORS[:, None, None] * pool.windows_s, judge.shortest_s, judge.longest_s)
        self.cost = windows.sum(axis=2) + fixed_s
        self.information = np.stack([judge.information(pool.which, w) for w in windows])
        self.power = _POWERS[0]

    def windows(self, chosen: Indices) -> Array:
        """Windows of a choice that fill the time, shape (n, 2), s."""
        level, share = self._level(self.cost[:, chosen].sum(axis=1)[:, None])
        factor = _FACTORS[level[0]] * (_FACTORS[level[0] + 1] / _FACTORS[level[0]]) ** share[0]
        return np.asarray(np.clip(factor * self.pool_windows[chosen], self.judge.shortest_s, self.judge.longest_s))

    def _level(self, cost: Array) -> tuple[Indices, Array]:
        """Step of the factor between which and the next the costs, shape (factors, n), reach the time; and how far."""
        level = np.clip((cost <= self.total_s).sum(axis=0) - 1, 0, len(_FACTORS) - 2)
        n = np.arange(cost.shape[1])
        low, high = cost[level, n], cost[level + 1, n]
        share = np.clip((self.total_s - low) / np.maximum(high - low, 1e-9), 0.0, 1.0)
        return level, np.where(cost[0] <= self.total_s, share, np.nan)

    def values(self, cost: Array, information: Array) -> Array:
        """Criterion of n choices from their costs (factors, n) and information (factors, n, p, p); inf: too long."""
        level, share = self._level(cost)
        fits = np.flatnonzero(np.isfinite(share))
        out = np.full(cost.shape[1], np.inf)
        if fits.size:
            low, high = information[level[fits], fits], information[level[fits] + 1, fits]
            g = self.judge.variances(self.judge.prior + low + share[fits, None, None] * (high - low))
            largest = g.max(axis=1)
            mean = np.mean((g / largest[:, None]) ** self.power, axis=1)
            out[fits] = np.log(largest) + np.log(mean) / self.power
        return out

    def run(self, start: Indices) -> Indices | None:
        """Improve a choice; None if nothing that fits is found."""
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
                if value > now - 1e-5:
                    break
                now = value
        return np.array(chosen, dtype=np.intp)

    def _of(self, chosen: list[int]) -> float:
        cost = self.cost[:, chosen].sum(axis=1)[:, None]
        return float(self.values(cost, self.information[:, chosen].sum(axis=1)[:, None])[0])

    def _pass(self, chosen: list[int], now: float) -> tuple[list[int], float]:
        """Try for each place what could stand there, nothing among it, and then one more."""
        for i in range(min(len(chosen), self.most - 1), -1, -1):
            rest = chosen[:i] + chosen[i + 1 :]
            cost, information = self.cost[:, rest].sum(axis=1), self.information[:, rest].sum(axis=1)
            near = self._promising(cost, information)
            values = self.values(cost[:, None] + self.cost[:, near], information[:, None] + self.information[:, near])
            k = int(np.argmin(values))
            without = self._of(rest) if rest and i < len(chosen) else np.inf
            if min(values[k], without) < now - 1e-9:
                chosen, now = (rest, without) if without < values[k] else ([*rest, int(near[k])], float(values[k]))
        return chosen, now

    def _promising(self, cost: Array, information: Array) -> Indices:
        """Columns of the pool whose information is worth most to a choice, by its slope; also for their time."""
        level, _ = self._level(cost[:, None])
        inverse = self.judge.inverse(self.judge.prior + information[level[0]])
        g, X = np.diag(inverse)[self.judge.targets] + self.judge.floor, inverse[:, self.judge.targets]
        wanted = self.judge.correction * g
        weight = self.judge.correction * (wanted / wanted.max()) ** (self.power - 1.0) / wanted.max()
        gain = np.einsum("kab,ab->k", self.information[level[0]], (X * weight) @ X.T)
        return np.union1d(np.argsort(-gain)[:_PROMISING], np.argsort(-gain / self.cost[level[0]])[:_PROMISING]).astype(
            np.intp
        )
