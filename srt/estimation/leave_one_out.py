"""Leave-one-out: consistency of every sequence with the others, and the estimate from the others alone.

The computation is linear algebra at the solution, with measurements z, covariance R and Jacobian H; no estimation is
repeated.

*Consistency test.* Chi-square of the measurements of a sequence against their prediction by the other sequences, see
``srt.estimation.white_residuals``.

*Estimate without a sequence.* The information N' and gradient g' of the other sequences give the change ``N'⁻¹ g'`` of
every parameter and its variance. A parameter is *lost* if its sigma grows a hundredfold, or so much that an estimator
would fix it; it then keeps its value and the others are estimated with it fixed.

The noise figures are those found with all sequences. So is the accuracy of a known heading, although a gap
in a chain of free rotations would reduce it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import solve_triangular

from srt.estimation.goodness_of_fit import chi_square_probability, faulty_group
from srt.estimation.observability import observed_limit
from srt.estimation.white_residuals import PredictedGroups, WhiteResiduals
from srt.model.prior import prior_sigma
from srt.ranking import ranked, rounded
from srt.result.consistency import (
    Consistency,
    Contradiction,
    Correlation,
    Influence,
    InformationShare,
    LeaveOneOut,
    ParameterObservability,
    WeakestCombination,
)
from srt.sensor_errors import GROUPS, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srt.types import Array, Indices, Mask

_LOST: Final = 100.0
"""Growth of a sigma above which a parameter counts as lost without a sequence."""
_INDEPENDENT: Final = 1e-10
"""Eigenvalue of the remaining information, over the largest, below which a direction is not determined."""
_LEAST_COMPONENT: Final = 0.05
"""Component of a direction, over the largest, from which a parameter takes part in it."""
_LEAST_SHARE: Final = 0.05
"""Share of a parameter's information from which a sequence is listed for it."""
_LAST: Final = [g.name for g in sorted(GROUPS, key=lambda g: (g.further, g.sensor)) if g.omissible]
"""Groups that are fixed first when the remaining sequences do not determine everything."""
_RANK: Final = np.array([1 + _LAST.index(g.name) if g.omissible else 0 for g in GROUPS for _ in g.suffixes])


@dataclass(frozen=True, slots=True, eq=False)
class ConsistencyTest:
    """Chi-square test of a group of measurements against the prediction by all others.

    Attributes
    ----------
    chi_square : float
    degrees_of_freedom : int
        Number of directions that the other measurements predict.
    unchecked : int
        Number of directions that no other measurement determines.
    determined : ndarray of bool, shape (27,)
        Parameters that take part in the unchecked directions.
    """

    chi_square: float
    degrees_of_freedom: int
    unchecked: int
    determined: Mask


@dataclass(frozen=True, slots=True, eq=False)
class LeaveOneOutEstimate:
    """The estimate without a group of measurements.

    Attributes
    ----------
    change : ndarray, shape (27,), SI
        Estimate without the group less estimate with it; zero for lost parameters.
    lost : ndarray of bool, shape (27,)
        Parameters that the remaining measurements do not determine.
    information : ndarray, shape (27,)
        Share of a parameter's information in the group, ``1 − variance / variance without it``; 1 if lost.
    """

    change: Array
    lost: Mask
    information: Array


@dataclass(frozen=True, slots=True, eq=False)
class SequenceDiagnostics:
    """Leave-one-out diagnostics of a sequence, or of one of several merged recordings."""

    title: str
    occurrence: int
    consistency: ConsistencyTest
    without: LeaveOneOutEstimate

    @property
    def finite(self) -> bool:
        """True if all values are finite."""
        parts = (self.without.change, self.without.information, np.array(self.consistency.chi_square))
        return all(bool(np.all(np.isfinite(part))) for part in parts)


def consistency_tests(z: Array, H: Array, R: Array, groups: Sequence[Indices]) -> list[ConsistencyTest]:
    """Consistency test of every group of measurements.

    Parameters
    ----------
    z : ndarray, shape (n,)
        Residuals at the solution, or at another point of the linear range.
    H : ndarray, shape (n, 27)
        Jacobian; columns of zeros belong to fixed parameters.
    R : ndarray, shape (n, n)
        Covariance.
    groups : sequence of ndarray of int
        Rows of each group.

    Raises
    ------
    numpy.linalg.LinAlgError
        If R is not positive definite.
    """
    estimated = np.flatnonzero(H.any(axis=0))
    return tests_of_groups(WhiteResiduals.of(z, H[:, estimated], R), R, groups, estimated)


def tests_of_groups(
    white: WhiteResiduals, R: Array, groups: Sequence[Indices], estimated: Indices
) -> list[ConsistencyTest]:
    """:func:`consistency_tests` of residuals for the ``estimated`` parameters, with the covariance R of z."""
    out: list[ConsistencyTest | None] = [None] * len(groups)
    triangle, size = white.triangle, white.length
    sigma = np.linalg.norm(solve_triangular(triangle, np.eye(len(size))), axis=1) / size
    # Groups of equal size share one call for the eigenvalues: single calls would be mostly overhead.
    for which, rows in by_size(groups):
        found = PredictedGroups.of(white, R, rows)
        for g, i in enumerate(which):
            unseen, determined = ~found.predicted[g], np.zeros(N_PARAMETERS, dtype=np.bool_)
            if unseen.any():
                # M E_D u = 0 means E_D u = H c: only this group determines the combination c.
                own = white.whitener[:, rows[g]] @ found.directions[g][:, unseen]
                c = solve_triangular(triangle, white.basis.T @ own) / size[:, None]
                determined[estimated] = participating(c / sigma[:, None])
            statistic, freedom = float(found.chi_square[g]), int(found.freedom[g])
            out[i] = ConsistencyTest(statistic, freedom, int(unseen.sum()), determined)
    return [c for c in out if c is not None]


def by_size(groups: Sequence[Indices]) -> list[tuple[list[int], Indices]]:
    """Numbers of the groups of each size, and their rows, shape (groups, size)."""
    numbers: dict[int, list[int]] = {}
    for i, D in enumerate(groups):
        numbers.setdefault(len(D), []).append(i)
    return [(which, np.stack([groups[i] for i in which])) for which in numbers.values()]


def participating(directions: Array) -> Mask:
    """Mask of the parameters that take part in directions, shape (p, m), in units of their sigma."""
    size = np.abs(directions)
    return np.asarray(np.any(size > _LEAST_COMPONENT * np.max(size, axis=0, initial=1e-300), axis=1))


def leave_one_out_estimate(information: Array, gradient: Array, estimated: Mask) -> LeaveOneOutEstimate:
    """Estimate from the remaining information.

    Parameters
    ----------
    information : ndarray, shape (2, 27, 27)
        Information of all measurements, and of the remaining ones.
    gradient : ndarray, shape (27,)
        Gradient of the remaining measurements at the solution of all.
    estimated : ndarray of bool, shape (27,)
    """
    out = LeaveOneOutEstimate(np.zeros(N_PARAMETERS), np.zeros(N_PARAMETERS, dtype=np.bool_), np.zeros(N_PARAMETERS))
    e = np.flatnonzero(estimated)
    if not len(e):
        return out
    full, rest = (N[np.ix_(e, e)] for N in information)
    size = 1.0 / np.sqrt(np.diag(full))
    variance = np.diag(np.linalg.inv(full * np.outer(size, size)))
    unit = size * np.sqrt(variance)  # 1-sigma of the full estimate
    # Imperfect rotations alone may keep a parameter below the admission limit; it counts as lost too.
    limit = np.minimum(observed_limit()[e] / unit, _LOST)
    N, g = rest * np.outer(unit, unit), gradient[e] * unit
    values, vectors = np.linalg.eigh(0.5 * (N + N.T))
    there = values > _INDEPENDENT * max(float(values[-1]), 1e-300)
    change, lost, share = np.zeros(len(e)), np.zeros(len(e), dtype=np.bool_), np.zeros(len(e))
    free = np.ones(len(e), dtype=np.bool_)
    if there.all():
        P = (vectors / values) @ vectors.T
        sigma = np.sqrt(np.diag(P))
        lost = (sigma > limit) & (limit > 1.0)
        share = 1.0 - 1.0 / np.maximum(np.diag(P), 1.0)
        change = P @ g
    if lost.any() or not there.all():
        # Selection as in the estimators: in order of admission, then without parameters that remain weak.
        free = _free_parameters(np.where(there, values, 0.0), vectors, limit, e)
        while free.any():
            P = np.linalg.inv(N[np.ix_(free, free)])
            sigma = np.sqrt(np.maximum(np.diag(P), 0.0))
            weak = (sigma > limit[free]) & (limit[free] > 1.0)
            if not weak.any():
                break
            free[np.flatnonzero(free)[weak]] = False
        change, lost = np.zeros(len(e)), ~free
        if free.any():
            change[free] = P @ g[free]
            share[free] = 1.0 - 1.0 / np.maximum(np.diag(P), 1.0)
    out.change[e] = np.where(lost, 0.0, change * unit)
    out.lost[e], out.information[e] = lost, np.where(lost, 1.0, share)
    return out


def leave_one_out_estimates(z: Array, H: Array, R: Array, groups: Sequence[Indices]) -> list[LeaveOneOutEstimate]:
    """Weighted least-squares estimates without each group of measurements.

    Parameters
    ----------
    z, H, R, groups
        As in :func:`consistency_tests`, z being residuals at the estimate of all.
    """
    estimated = np.asarray(H.any(axis=0), dtype=np.bool_)
    scale = 1.0 / np.sqrt(np.diag(R))
    A = np.linalg.inv(R * np.outer(scale, scale)) * np.outer(scale, scale)
    full = H.T @ A @ H
    out = []
    for D in groups:
        block = A[D] @ np.column_stack([H, z])
        taken = block.T @ np.linalg.solve(A[np.ix_(D, D)], block)
        gradient = H.T @ (A @ z) - taken[:-1, -1]
        out.append(leave_one_out_estimate(np.stack([full, full - taken[:-1, :-1]]), gradient, estimated))
    return out


def _free_parameters(values: Array, vectors: Array, limit: Array, members: Indices) -> Mask:
    """Mask of the parameters that are determined, admitted one by one, asymmetries last."""
    left = (vectors * values) @ vectors.T
    free = np.zeros(len(members), dtype=np.bool_)
    for n in sorted(range(len(members)), key=lambda n: _RANK[members[n]]):
        if left[n, n] * limit[n] ** 2 > 1.0:
            free[n] = True
            left -= np.outer(left[:, n], left[n]) / left[n, n]
    return free


def consistency(
    evidence: Iterable[SequenceDiagnostics],
    covariance: Array,
    observed: Mask,
    statistic: float,
    freedom: int,
    *,
    estimated_from: float = math.inf,
    against: float = -math.inf,
) -> Consistency:
    """Verdict of the measurements on the result.

    Parameters
    ----------
    evidence : iterable of SequenceDiagnostics
        In the order of the sequences; empty if only the total chi-square is known.
    covariance : ndarray, shape (27, 27)
        As reported.
    observed : ndarray of bool, shape (27,)
    statistic : float
        Chi-square of all residuals.
    freedom : int
    estimated_from : float
        As in ``contradicting_group``.
    against : float
        As in ``faulty_group``.
    """
    # Far from a solution, where an iteration did not converge, the linear algebra may fail.
    rows = list(evidence)
    rows = rows if all(row.finite for row in rows) else []
    seen = np.flatnonzero(observed)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Consistency(
        chi_square=statistic,
        degrees_of_freedom=freedom,
        probability=chi_square_probability(statistic, freedom),
        contradicting=_contradicting(rows, statistic, freedom, estimated_from, against),
        sequences=tuple(_sequence(row, sigma, observed) for row in rows),
        parameters=_parameters(rows, covariance, seen),
        weakest_combination=_weakest(covariance, seen),
    )


def _contradicting(
    rows: Sequence[SequenceDiagnostics], statistic: float, freedom: int, estimated_from: float, against: float
) -> Contradiction | None:
    tests = [(row.consistency.chi_square, row.consistency.degrees_of_freedom) for row in rows]
    worst = faulty_group(tests, statistic, freedom, estimated_from=estimated_from, against=against)
    if worst is None:
        return None
    row = rows[worst[0]]
    return Contradiction(sequence=row.title, occurrence=row.occurrence, probability=worst[1])


def _sequence(row: SequenceDiagnostics, sigma: Array, observed: Mask) -> LeaveOneOut:
    against, without = row.consistency, row.without
    kept = observed & ~without.lost & (sigma > 0.0)
    influence = np.zeros(N_PARAMETERS)
    influence[kept] = without.change[kept] / sigma[kept]
    largest = int(np.argmax(np.abs(influence)))
    checkable = "no" if against.degrees_of_freedom == 0 else "partly" if against.unchecked else "yes"
    return LeaveOneOut(
        sequence=row.title,
        occurrence=row.occurrence,
        chi_square=against.chi_square,
        degrees_of_freedom=against.degrees_of_freedom,
        probability=chi_square_probability(against.chi_square, against.degrees_of_freedom),
        checkable=checkable,
        only_witness_of=_names(against.determined & observed),
        lost_without=_names(without.lost & observed),
        largest_influence=(
            Influence(parameter=NAMES[largest], sigmas=float(influence[largest])) if kept.any() else None
        ),
        influence={NAMES[i]: float(influence[i]) if kept[i] else None for i in np.flatnonzero(observed)},
    )


def _parameters(
    rows: Sequence[SequenceDiagnostics], covariance: Array, seen: Indices
) -> tuple[ParameterObservability, ...]:
    sigma = np.sqrt(np.maximum(np.diag(covariance)[seen], 0.0))
    if not len(seen) or not np.all(sigma > 0.0):
        return ()
    C = covariance[np.ix_(seen, seen)] / np.outer(sigma, sigma)
    values, vectors = np.linalg.eigh(C)
    # A limit on the eigenvalues: rounding must not make a combination better known than the covariance can state.
    values = np.maximum(values, len(seen) * np.finfo(np.float64).eps * values[-1])
    inflation = np.einsum("ij,j,ij->i", vectors, 1.0 / values, vectors)
    apart = np.abs(C - np.diag(np.diag(C)))
    partner = np.argmax(rounded(apart), axis=1)
    shares = np.array([row.without.information for row in rows]).reshape(len(rows), N_PARAMETERS)
    out = []
    for n, i in enumerate(seen.tolist()):
        share = shares[:, i]
        most = float(share.max(initial=0.0))
        out.append(
            ParameterObservability(
                name=NAMES[i],
                sigma=float(sigma[n]),
                witnesses=1.0 / most if most > 0.0 else None,
                shown_by=tuple(
                    InformationShare(sequence=rows[k].title, occurrence=rows[k].occurrence, share=float(share[k]))
                    for k in ranked(share).tolist()
                    if share[k] >= _LEAST_SHARE
                ),
                information=tuple(share.tolist()),
                variance_inflation=max(float(inflation[n]), 1.0),
                largest_correlation=(
                    Correlation(with_=NAMES[seen[partner[n]]], value=float(C[n, partner[n]])) if len(seen) > 1 else None
                ),
            )
        )
    return tuple(out)


def _weakest(covariance: Array, seen: Indices) -> WeakestCombination | None:
    """Combination of parameters whose sigma the data reduce least, relative to the prior sigma."""
    if not len(seen):
        return None
    prior = prior_sigma()[seen]
    values, vectors = np.linalg.eigh(covariance[np.ix_(seen, seen)] / np.outer(prior, prior))
    by_size = ranked(np.abs(vectors[:, -1]))
    direction = vectors[:, -1] * np.sign(vectors[by_size[0], -1])
    order = [n for n in by_size.tolist() if abs(direction[n]) > 2.0 * _LEAST_COMPONENT]
    return WeakestCombination(
        sigma_over_prior=float(np.sqrt(max(values[-1], 0.0))),
        combination={NAMES[seen[n]]: float(direction[n]) for n in order},
    )


def _names(mask: Mask) -> tuple[str, ...]:
    return tuple(NAMES[i] for i in np.flatnonzero(mask))
