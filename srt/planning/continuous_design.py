"""Continuous optimal design: the best test of a given length if sequences could be run a fractional number of times.

A column is a sequence with its windows, w_j ≥ 0 the number of times that it is run, c_j its time. The largest
``log g_i(w)`` is minimised subject to ``Σ c w ≤ T``. Here ``g_i = [M(w)⁻¹]_ii + f_i`` is the variance of parameter i
over that of its target, f_i is constant, and the information ``M(w) = M_0 + Σ w_j M_j`` is linear in w. As
``1 / [M⁻¹]_ii`` is concave in M, ``log g_i`` is convex: a local optimum is the global one, and every point gives a
lower bound. With weights λ of the targets (λ ≥ 0, Σ λ = 1)::

    min max_i log g_i  ≥  Σ_i λ_i (log g_i(w) + Σ_j d_ij w_j) − T max_j Σ_i λ_i d_ij / c_j,   d_ij = −∂ log g_i / ∂w_j

for any w, by the tangents at w. The best λ solves a linear programme. The column at which its maximum is reached is
added (column generation); when no column is worth adding, the bound is reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from scipy.optimize import linprog, minimize

from srt.exceptions import DataError
from srt.planning.information import target_variances
from srt.ranking import ranked

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.types import Array, Indices

Value = TypeVar("Value")

GAP: Final = 0.01
"""Distance of sigma to its bound, relative, at which the search ends."""
_ROUGH_GAP: Final = 0.03
"""The same while the larger share of time is still spread over all columns."""
_LARGEST_GAP: Final = 10.0
"""Multiple of the gap asked for beyond which the search has failed."""
_EVEN: Final = (0.1, 0.01)
"""Share of the time that is spread evenly over all columns: first, and in the final search."""
_MOST_ROUNDS: Final = 40
"""Rounds of column generation."""
_MOST_CUTS: Final = 60
"""Rounds of constraint generation in the linear programme."""
_FIRST_PER_TARGET: Final = 3
"""Columns per target in the first design."""
_ADDED_PER_ROUND: Final = 20
"""Columns, or constraints, added in a round."""
_WORTH_ADDING: Final = 1.0 - 1e-3
"""Value of a column's time over the mean value of the design's, from which on the column is added."""
_NEW_SHARE: Final = 0.02
"""Share of the time that new columns get at first, together."""
_NO_SHARE: Final = 1e-5
"""Share of the time below which a column is dropped."""
_NO_INFORMATION: Final = 1e-11
"""Eigenvalue of the scaled information, over the largest, below which a direction is unobservable."""
_NO_PART: Final = 1e-3
"""Component of a target along unobservable directions above which it is unobservable itself."""
_NO_ROW: Final = 1e-6
"""Information on a target from all columns together, in units of the target, below which no column observes it."""
_CUT_TOLERANCE: Final = 1e-4
"""Relative violation of a constraint of the linear programme that is accepted."""
_CACHE_ROWS: Final = 1024
"""Columns handled at a time, so that they fit the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Information and time of everything that can be run: J columns.

    Attributes
    ----------
    rows : ndarray, shape (J, m, p)
        Whitened Jacobians; the information of a column is ``rowsᵀ rows``. Unknowns are in units of their targets.
    cost_s : ndarray, shape (J,)
    prior : ndarray, shape (p, p)
        Information before the test.
    targets : ndarray of int, shape (q,)
        Unknowns that have a target.
    floor : ndarray, shape (q,)
        Variance of each target that no test reduces.
    """

    rows: Array
    cost_s: Array
    prior: Array
    targets: Indices
    floor: Array

    def information(self, which: Indices, weight: Array) -> Array:
        """``M(w)`` for weights of some columns, shape (p, p)."""
        out = self.prior.copy()
        for first in range(0, len(which), _CACHE_ROWS):
            part = slice(first, first + _CACHE_ROWS)
            rows = (self.rows[which[part]] * np.sqrt(weight[part])[:, None, None]).reshape(-1, self.rows.shape[2])
            out += rows.T @ rows
        return out

    def variances(self, M: Array) -> tuple[Array, Array]:
        """``g_i`` and the columns of M⁻¹ that belong to the targets, shapes (q,) and (p, q)."""
        return target_variances(M, self.targets, self.floor)

    def gains(self, X: Array, g: Array, which: Indices | None = None) -> Array:
        """``−∂ log g_i / ∂w_j``, shape (J or n, q)."""
        rows = self.rows if which is None else self.rows[which]
        out = np.empty((len(rows), X.shape[1]))
        for first in range(0, len(rows), _CACHE_ROWS):
            part = rows[first : first + _CACHE_ROWS]
            # One product of two matrices instead of one for each column.
            along = (part.reshape(-1, rows.shape[2]) @ X).reshape(*part.shape[:2], -1)
            out[first : first + _CACHE_ROWS] = np.einsum("jmq,jmq->jq", along, along) / g
        return out


@dataclass(frozen=True, slots=True, eq=False)
class ContinuousDesign:
    """Optimal design with fractional numbers of runs.

    Attributes
    ----------
    which : ndarray of int, shape (n,)
        Columns that are run.
    weight : ndarray, shape (n,)
        Number of times that each is run, fractional.
    ratio : float
        Largest sigma over target.
    bound : float
        Lower bound of the ratio for any test of this length out of these columns.
    weights : ndarray, shape (q,)
        Weights λ of the targets; zero where a target does not limit the design.
    worth : ndarray, shape (J,)
        Value per time of every column, over that of the best.
    """

    which: Indices
    weight: Array
    ratio: float
    bound: float
    weights: Array
    worth: Array

    @property
    def gap(self) -> float:
        """Largest possible further decrease of sigma, relative."""
        return self.ratio / self.bound - 1.0 if self.bound > 0.0 else math.inf


def unobservable_targets(columns: Columns) -> Indices:
    """Targets that no design observes, by the null space of all columns: positions in ``columns.targets``."""
    S = columns.information(np.arange(len(columns.cost_s)), np.ones(len(columns.cost_s)))
    d = 1.0 / np.sqrt(np.diag(S))
    values, vectors = np.linalg.eigh(S * np.outer(d, d))
    null_space = vectors[:, values < _NO_INFORMATION * values[-1]]
    share = np.linalg.norm(null_space, axis=1)[columns.targets]
    # An unknown with no row at all is scaled to one above, and is found apart.
    alone = (np.diag(S) - np.diag(columns.prior))[columns.targets] < _NO_ROW
    return np.flatnonzero((share > _NO_PART) | alone)


def asymptotic_variances(columns: Columns, time_s: float) -> Array:
    """Variances of the targets in the limit of a long test, shape (q,), extrapolated from a time and twice that."""
    every = np.arange(len(columns.cost_s))
    weight = time_s / len(every) / columns.cost_s
    once, _ = columns.variances(columns.information(every, weight))
    twice, _ = columns.variances(columns.information(every, 2.0 * weight))
    # Variance = constant + a / T: twice the value at 2 T less that at T is the constant.
    return np.asarray(2.0 * twice - once)


def optimal_design(
    columns: Columns,
    total_s: float,
    *,
    gap: float = GAP,
    start: ContinuousDesign | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> ContinuousDesign:
    """Find the optimal continuous design.

    Parameters
    ----------
    total_s : float
        Time T, s.
    gap : float
        Relative distance of sigma to its bound at which to stop.
    start : ContinuousDesign, optional
        Design of the first of these columns, to start from.
    progress : callable, optional
        Called with the number of rounds and the gap so far.

    Raises
    ------
    DataError
        The search cannot close the gap to ten times the value asked for.
    """
    rounds = count(1)

    def report(gap: float) -> None:
        if progress is not None:
            progress(next(rounds), gap)

    for even in _EVEN if start is None else _EVEN[-1:]:
        # While much is unknown, the value of a sequence may depend on another that separates the errors that it mixes,
        # and derivatives say nothing. So a part of the time is spread evenly over all columns.
        every = np.arange(len(columns.cost_s))
        spread = columns.information(every, even * total_s / len(every) / columns.cost_s)
        supported = replace(columns, prior=spread)
        rest_s = (1.0 - even) * total_s
        start = _column_generation(
            supported,
            rest_s,
            start or _first_design(supported, rest_s),
            gap if even == _EVEN[-1] else _ROUGH_GAP,
            report,
        )
    assert start is not None
    # The best weights times (1 - even), with the even part, are feasible here: the bound falls by that factor at most.
    best = replace(start, bound=start.bound * math.sqrt(1.0 - _EVEN[-1]))
    if best.gap > _LARGEST_GAP * gap:
        raise DataError(
            f"The search for the best plan stopped {100.0 * best.gap:.1f} % above its bound: give more time, or more "
            "targets."
        )
    return best


def _first_design(columns: Columns, total_s: float) -> ContinuousDesign:
    """First design: the columns that decrease each variance most if all are run for the same time."""
    cost = columns.cost_s
    even = np.full(len(cost), total_s / len(cost)) / cost
    g, X = columns.variances(columns.information(np.arange(len(cost)), even))
    each = columns.gains(X, g) / cost[:, None]
    active = np.unique(ranked(each, axis=0)[:_FIRST_PER_TARGET])
    weight = total_s / len(active) / cost[active]
    return ContinuousDesign(active, weight, math.inf, 0.0, np.zeros(len(g)), np.zeros(len(cost)))


def _column_generation(
    columns: Columns, total_s: float, start: ContinuousDesign, gap: float, report: Callable[[float], None]
) -> ContinuousDesign:
    """Add columns to a design until the gap is closed or no column is worth adding."""
    cost = columns.cost_s
    active, share = start.which, start.weight * cost[start.which] / total_s
    bound = 0.0
    for _ in range(_MOST_ROUNDS):
        share = _best_shares(columns, active, share, total_s)
        keep = share > _NO_SHARE
        active, share = active[keep], share[keep] / share[keep].sum()
        weight = share * total_s / cost[active]
        g, X = columns.variances(columns.information(active, weight))
        gains = columns.gains(X, g)
        weights = _target_weights(gains, g, active, weight, cost, total_s)
        worth = gains @ weights / cost
        price = float(share @ worth[active])
        log_bound = float(weights @ (np.log(g) + weight @ gains[active]) - total_s * worth.max())
        bound = max(bound, math.exp(0.5 * log_bound))
        best = ContinuousDesign(active, weight, math.sqrt(g.max()), bound, weights, worth / worth.max())
        report(best.gap)
        if best.gap <= gap:
            break
        # The target weights of the best bound give equal value per time to all columns that should be run: new columns
        # are those worth at least the present mean.
        fresh = np.setdiff1d(ranked(worth)[: 4 * _ADDED_PER_ROUND], active)
        fresh = fresh[worth[fresh] > price * _WORTH_ADDING]
        fresh = fresh[ranked(worth[fresh])][:_ADDED_PER_ROUND]
        if fresh.size == 0:
            break
        active = np.concatenate([active, fresh])
        # The shares of mirrored columns are free but for their sum: their rounding errors would grow by the round.
        share = np.array([float(f"{own:.3g}") for own in share])
        share = np.concatenate([(1.0 - _NEW_SHARE) / share.sum() * share, np.full(len(fresh), _NEW_SHARE / len(fresh))])
    return best


def remembered(function: Callable[[Array], Value]) -> Callable[[Array], Value]:
    """Function that keeps its last value: an optimiser asks for values and derivatives one after the other."""
    last: tuple[Array, Value] | None = None

    def of(x: Array) -> Value:
        nonlocal last
        if last is None or not np.array_equal(x, last[0]):
            last = x.copy(), function(x)
        return last[1]

    return of


def smallest_maximum(
    functions: Callable[[Array], tuple[Array, Array]],
    first: Array,
    cost: Array,
    limits: tuple[float, float],
    tolerance: float,
) -> Array:
    """Minimise the largest of q functions of x, shape (n,), by sequential quadratic programming in epigraph form.

    Parameters
    ----------
    functions : callable
        Values, shape (q,), and derivatives, shape (q, n), at x.
    first : ndarray, shape (n,)
        Initial x.
    cost : ndarray, shape (n,)
        ``cost · x`` is at most one.
    limits : (float, float)
        Of every element of x.
    tolerance : float
        Decrease of the largest function at which to stop.
    """
    n, values = len(first), remembered(lambda x: functions(x[:-1]))
    start = np.append(first, functions(first)[0].max())
    epigraph = {
        "fun": lambda x: x[-1] - values(x)[0],
        "jac": lambda x: np.insert(-values(x)[1], n, 1.0, axis=1),
    }
    spare = {"fun": lambda x: 1.0 - cost @ x[:-1], "jac": lambda _: np.append(-cost, 0.0)}
    found = minimize(
        lambda x: x[-1],
        start,
        jac=lambda _: np.append(np.zeros(n), 1.0),
        method="SLSQP",
        bounds=[limits] * n + [(None, None)],
        constraints=[{"type": "ineq"} | spare, {"type": "ineq"} | epigraph],
        options={"maxiter": 200, "ftol": tolerance},
    )
    return np.asarray(np.clip(found.x[:-1], *limits))


def _best_shares(columns: Columns, active: Indices, share: Array, total_s: float) -> Array:
    """Best shares of the time for a few columns."""
    per_share = total_s / columns.cost_s[active]

    def logs(x: Array) -> tuple[Array, Array]:
        g, X = columns.variances(columns.information(active, np.maximum(x, 0.0) * per_share))
        return np.log(g), -(columns.gains(X, g, active) * per_share[:, None]).T

    found = smallest_maximum(logs, share, np.ones(len(active)), (0.0, 1.0), 1e-7)
    total = float(found.sum())
    if not np.isfinite(total) or total <= 0.0:
        return share
    found /= total
    return found if logs(found)[0].max() <= logs(share)[0].max() else share


def _target_weights(gains: Array, g: Array, active: Indices, weight: Array, cost: Array, total_s: float) -> Array:
    """Weights λ of the targets that give the best bound: a linear programme with constraint generation."""
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
            raise DataError(
                "The linear programme for the bound of the plan has no solution: please report the plan file."
            )
        weights = np.maximum(result.x[:q], 0.0)
        weights /= weights.sum()
        worth = per_time @ weights
        broken = ranked(worth)[:_ADDED_PER_ROUND]
        broken = broken[worth[broken] > worth[rows].max() * (1.0 + _CUT_TOLERANCE)]
        if broken.size == 0:
            break
        rows = np.union1d(rows, broken)
    return np.asarray(weights)
