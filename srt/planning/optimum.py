"""The best test of a given length if sequences could be run any fraction of a time, with a proof of how good it is.

Minimise over weights w ≥ 0 (how often each column, a sequence with its windows, is run) with ``Σ c w ≤ T`` the largest
of ``log g_i(w)``, where ``g_i = [M(w)⁻¹]_ii + f_i`` is the variance of parameter i over that of its target, f_i is
constant, and ``M(w) = M_0 + Σ w_j M_j`` is linear. ``1 / [M⁻¹]_ii`` is concave in M, so that ``log g_i`` is convex:
what a local method finds is the optimum, and every point bounds it from below. With weights λ of the parameters (λ ≥ 0,
Σ λ = 1)::

    min max_i log g_i  ≥  Σ_i λ_i (log g_i(w) + Σ_j d_ij w_j) − T max_j Σ_i λ_i d_ij / c_j,   d_ij = −∂ log g_i / ∂w_j

for any w, by the tangents there. The best λ is a linear programme; the column that rules its maximum is the one to add
(column generation), and when none is worth adding the bound is reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import linprog, minimize

from srt.exceptions import DataError

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.types import Array, Indices


GAP: Final = 0.01
"""The search ends when the bound is this close, as a share of sigma."""
_MOST_ROUNDS: Final = 40
_FIRST_PER_TARGET: Final = 3
_ADDED_PER_ROUND: Final = 20
_EVEN: Final = (0.1, 0.01)
"""Share of the time that is spread over all columns, on the way and at the end."""
_MOST_CUTS: Final = 60
_ROUGH_GAP: Final = 0.03
_NO_INFORMATION: Final = 1e-11
_NO_PART: Final = 1e-3
_NO_SHARE: Final = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Everything that can be run: J columns with their information and their time.

    Attributes
    ----------
    rows : ndarray, shape (J, m, p)
        Whitened Jacobians; the information of a column is ``rowsᵀ rows``. Unknowns are in units of their targets.
    cost_s : ndarray, shape (J,)
    prior : ndarray, shape (p, p)
        Information that is there without any column.
    targets : ndarray of int, shape (q,)
        Unknowns that count.
    floor : ndarray, shape (q,)
        Variance of each target that nothing takes away.
    """

    rows: Array
    cost_s: Array
    prior: Array
    targets: Indices
    floor: Array

    def information(self, which: Indices, weight: Array) -> Array:
        """``M(w)`` for weights of some columns, shape (p, p)."""
        stacked = (self.rows[which] * np.sqrt(weight)[:, None, None]).reshape(-1, self.rows.shape[2])
        return np.asarray(self.prior + stacked.T @ stacked)

    def variances(self, M: Array) -> tuple[Array, Array]:
        """``g_i`` and the columns of M⁻¹ that belong to the targets, shapes (q,) and (p, q)."""
        scale = 1.0 / np.sqrt(np.diag(M))
        inverse = np.linalg.inv(M * np.outer(scale, scale)) * np.outer(scale, scale)
        return np.diag(inverse)[self.targets] + self.floor, inverse[:, self.targets]

    def gains(self, X: Array, g: Array, which: Indices | None = None) -> Array:
        """``−∂ log g_i / ∂w_j``, shape (J or n, q)."""
        rows = self.rows if which is None else self.rows[which]
        out = np.empty((len(rows), X.shape[1]))
        for first in range(0, len(rows), 4096):  # what fits a cache
            part = rows[first : first + 4096]
            out[first : first + 4096] = np.einsum("jmq,jmq->jq", part @ X, part @ X) / g
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Relaxed:
    """The optimum with fractions.

    Attributes
    ----------
    which : ndarray of int, shape (n,)
        Columns that are run.
    weight : ndarray, shape (n,)
        How often.
    ratio : float
        Largest sigma over its target.
    bound : float
        No test of this length out of these columns, in whole numbers or fractions, has a smaller one.
    weights : ndarray, shape (q,)
        λ: how much each target rules.
    worth : ndarray, shape (J,)
        Value of every column's time, over that of the best.
    """

    which: Indices
    weight: Array
    ratio: float
    bound: float
    weights: Array
    worth: Array

    @property
    def gap(self) -> float:
        """How much of sigma could still be gained at the very most."""
        return self.ratio / self.bound - 1.0 if self.bound > 0.0 else math.inf


def unseen(columns: Columns) -> Indices:
    """Targets (positions in ``columns.targets``) that all columns together leave open, by the null space."""
    S = columns.information(np.arange(len(columns.cost_s)), np.ones(len(columns.cost_s)))
    d = 1.0 / np.sqrt(np.diag(S))
    values, vectors = np.linalg.eigh(S * np.outer(d, d))
    open_ways = vectors[:, values < _NO_INFORMATION * values[-1]]
    share = np.linalg.norm(open_ways, axis=1)[columns.targets]
    # What has no row at all is no part of it: a thousand times the target after every column.
    alone = (np.diag(S) - np.diag(columns.prior))[columns.targets] < 1e-6
    return np.flatnonzero((share > _NO_PART) | alone)


def limits_of_time(columns: Columns, time_s: float) -> Array:
    """Variances of the targets that no time takes away, shape (q,): from a long time, and twice as long."""
    every = np.arange(len(columns.cost_s))
    weight = time_s / len(every) / columns.cost_s
    once, _ = columns.variances(columns.information(every, weight))
    twice, _ = columns.variances(columns.information(every, 2.0 * weight))
    # What falls with the time halves; the rest stays.
    return np.asarray(2.0 * twice - once)


def relaxed_optimum(
    columns: Columns,
    total_s: float,
    *,
    gap: float = GAP,
    start: Relaxed | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Relaxed:
    """Solve the problem with fractions.

    Parameters
    ----------
    columns : Columns
    total_s : float
        T, s.
    gap : float
        Relative distance of sigma to the bound at which to stop.
    start : Relaxed, optional
        Solution for the first of these columns, to go on from.
    progress : callable, optional
        Called with the number of rounds and the gap so far.

    Raises
    ------
    DataError
        If the search cannot close the gap to ten times what was asked for.
    """
    told = _Told(progress)
    for even in _EVEN if start is None else _EVEN[-1:]:
        # Where much is unknown, a sequence may be worthless until another is there that takes it apart, and slopes mean
        # nothing. So a little of the time goes to all columns alike.
        every = np.arange(len(columns.cost_s))
        alike = columns.information(every, even * total_s / len(every) / columns.cost_s)
        helped = replace(columns, prior=alike)
        rest_s = (1.0 - even) * total_s
        start = _generated(
            helped, rest_s, start or _first(helped, rest_s), gap if even == _EVEN[-1] else _ROUGH_GAP, told
        )
    assert start is not None
    # Of the best weights, (1 - even) with the even part are within this problem, and no worse than by that factor.
    best = replace(start, bound=start.bound * math.sqrt(1.0 - _EVEN[-1]))
    if best.gap > 10.0 * gap:
        raise DataError(
            f"The search for the best plan stopped {100.0 * best.gap:.1f} % above its bound: give more time, or more "
            "targets."
        )
    return best


class _Told:
    """Tells the progress, with the rounds counted through."""

    def __init__(self, progress: Callable[[int, float], None] | None) -> None:
        self._progress, self._rounds = progress, 0

    def __call__(self, gap: float) -> None:
        self._rounds += 1
        if self._progress is not None:
            self._progress(self._rounds, gap)


def _first(columns: Columns, total_s: float) -> Relaxed:
    """A start: the columns that each target gains most from if all are run alike."""
    cost = columns.cost_s
    even = np.full(len(cost), total_s / len(cost)) / cost
    g, X = columns.variances(columns.information(np.arange(len(cost)), even))
    each = columns.gains(X, g) / cost[:, None]
    active = np.unique(np.argsort(-each, axis=0)[:_FIRST_PER_TARGET])
    weight = total_s / len(active) / cost[active]
    return Relaxed(active, weight, math.inf, 0.0, np.zeros(len(g)), np.zeros(len(cost)))


def _generated(columns: Columns, total_s: float, start: Relaxed, gap: float, told: _Told) -> Relaxed:
    """Column generation from a start until the gap is closed, or nothing more is worth adding."""
    cost = columns.cost_s
    active, share = start.which, start.weight * cost[start.which] / total_s
    bound = 0.0
    for _ in range(_MOST_ROUNDS):
        share = _master(columns, active, share, total_s)
        keep = share > _NO_SHARE
        active, share = active[keep], share[keep] / share[keep].sum()
        weight = share * total_s / cost[active]
        g, X = columns.variances(columns.information(active, weight))
        gains = columns.gains(X, g)
        weights = _prices(gains, g, active, weight, cost, total_s)
        worth = gains @ weights / cost
        price = float(share @ worth[active])
        log_bound = float(weights @ (np.log(g) + weight @ gains[active]) - total_s * worth.max())
        bound = max(bound, math.exp(0.5 * log_bound))
        best = Relaxed(active, weight, math.sqrt(g.max()), bound, weights, worth / worth.max())
        told(best.gap)
        if best.gap <= gap:
            break
        # What is worth at least what the time is on the average now: the prices of the best bound make equal what
        # should be run.
        fresh = np.setdiff1d(np.argsort(-worth)[: 4 * _ADDED_PER_ROUND], active, assume_unique=False)
        fresh = fresh[worth[fresh] > price * (1.0 - 1e-3)]
        fresh = fresh[np.argsort(-worth[fresh])][:_ADDED_PER_ROUND]
        if fresh.size == 0:
            break
        active = np.concatenate([active, fresh])
        share = np.concatenate([0.98 * share, np.full(len(fresh), 0.02 / len(fresh))])
    return best


def _master(columns: Columns, active: Indices, share: Array, total_s: float) -> Array:
    """Best shares of the time for a few columns: sequential quadratic programming on the epigraph."""
    per_share = total_s / columns.cost_s[active]
    rows = columns.rows[active]
    n = len(active)

    def logs(x: Array) -> tuple[Array, Array]:
        weight = np.maximum(x[:n], 0.0) * per_share
        g, X = columns.variances(columns.information(active, weight))
        slopes = -np.einsum("jmq,jmq->jq", rows @ X, rows @ X) / g * per_share[:, None]
        return np.log(g), slopes.T

    first, _ = logs(share)
    x0 = np.append(share, first.max())
    result = minimize(
        lambda x: x[n],
        x0,
        jac=lambda _: np.append(np.zeros(n), 1.0),
        method="SLSQP",
        bounds=[(0.0, 1.0)] * n + [(None, None)],
        constraints=[
            {
                "type": "ineq",
                "fun": lambda x: x[n] - logs(x)[0],
                "jac": lambda x: np.hstack([-logs(x)[1], np.ones((len(columns.targets), 1))]),
            },
            {"type": "ineq", "fun": lambda x: 1.0 - x[:n].sum(), "jac": lambda _: np.append(np.full(n, -1.0), 0.0)},
        ],
        options={"maxiter": 200, "ftol": 1e-7},
    )
    found = np.maximum(result.x[:n], 0.0)
    total = float(found.sum())
    if not np.isfinite(total) or total <= 0.0:
        return share
    found /= total
    return found if logs(found)[0].max() <= first.max() else share


def _prices(gains: Array, g: Array, active: Indices, weight: Array, cost: Array, total_s: float) -> Array:
    """Weights λ of the parameters that give the best bound, by a linear programme whose rows are made as needed."""
    q = len(g)
    value = np.log(g) + weight @ gains[active]
    per_time = gains / cost[:, None]
    scale = float(per_time[active].max())
    rows = active
    for _ in range(_MOST_CUTS):
        # Maximise λ·value − T m subject to m ≥ λ·d_j / c_j.
        result = linprog(
            np.append(-value, total_s * scale),
            A_ub=np.hstack([per_time[rows] / scale, np.full((len(rows), 1), -1.0)]),
            b_ub=np.zeros(len(rows)),
            A_eq=np.append(np.ones(q), 0.0)[None],
            b_eq=[1.0],
            bounds=[(0.0, None)] * (q + 1),
            method="highs",
        )
        if result.x is None:
            raise DataError("The search for the best plan met equations without a solution: report the plan's file.")
        weights = np.maximum(result.x[:q], 0.0)
        weights /= weights.sum()
        worth = per_time @ weights
        broken = np.argsort(-worth)[:_ADDED_PER_ROUND]
        broken = broken[worth[broken] > worth[rows].max() * (1.0 + 1e-4)]
        if broken.size == 0:
            break
        rows = np.union1d(rows, broken)
    return np.asarray(weights)
