"""Least-squares solution of the linearised system, sequence by sequence, and covariances from it.

A QR decomposition of the rows of a step (:mod:`srt.joint.linear_system`) and of the rows from earlier steps

    ``R v + S s + c = noise``

eliminates its local columns v; s are the columns shared with later steps and those of the whole recording. The
remaining rows are passed on to the next step. Marginal covariances follow backwards in time as square roots.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import diags_array

from srt.joint.linear_system import elimination_steps, global_columns

if TYPE_CHECKING:
    from srt.joint.linear_system import EliminationStep, LinearSystem
    from srt.types import Array, Indices


_SINGULAR: Final = 1e-13
"""Diagonal element of R, as a share of the norm of its column, below which columns are linearly dependent."""


@dataclass(frozen=True, eq=False)
class _Conditional:
    """Columns eliminated in one step: ``R v + S s + c`` is white noise of unit variance."""

    columns: Indices
    given: Indices
    R: Array
    S: Array
    c: Array

    @cached_property
    def inverse(self) -> Array:
        """R⁻¹, shape (n, n)."""
        return np.asarray(solve_triangular(self.R, np.eye(len(self.R))))


class BlockSolution:
    """Least-squares solution of all columns together.

    Parameters
    ----------
    system : LinearSystem

    Raises
    ------
    numpy.linalg.LinAlgError
        If the active columns are linearly dependent.

    Attributes
    ----------
    delta : ndarray, shape (n,)
        Correction; zero for columns that are not active.
    """

    def __init__(self, system: LinearSystem) -> None:
        self.system = system
        shared = global_columns(system)
        if system.columns["bias"].stop - system.columns["bias"].start > 3:  # a bias walk is shared with the next step
            shared = shared[~np.isin(shared, system.columns.of("bias"))]
        self.steps, self._conditionals, rest = eliminate(system, shared)
        if len(rest) < len(shared):
            raise np.linalg.LinAlgError("a column without any measurement")
        R, n = np.asarray(np.linalg.qr(rest, mode="r")), len(shared)
        self._conditionals.append(_Conditional(shared, shared[:0], R[:n, :n], np.zeros((n, 0)), R[:n, -1]))
        norm = np.sqrt(np.asarray(system.A.multiply(system.A).sum(axis=0)).ravel())
        for part in self._conditionals:
            if np.any(np.abs(np.diag(part.R)) <= _SINGULAR * norm[part.columns]):
                raise np.linalg.LinAlgError("dependent columns, or a column without any measurement")
        self.delta = np.zeros(len(system.active))
        for part in reversed(self._conditionals):
            self.delta[part.columns] = -part.inverse @ (part.S @ self.delta[part.given] + part.c)

    @property
    def residual(self) -> Array:
        """Whitened residuals at the solution, shape (m,)."""
        return np.asarray(self.system.b + self.system.A @ self.delta)

    @property
    def log_likelihood(self) -> float:
        """Logarithm of the restricted likelihood of the rows, up to a constant."""
        noise = sum(
            float(np.log(np.abs(np.diagonal(W, axis1=1, axis2=2))).sum()) for W in self.system.whitening.values()
        )
        found = sum(float(np.log(np.abs(np.diag(part.R))).sum()) for part in self._conditionals)
        return noise - found - 0.5 * float(self.residual @ self.residual)

    @cached_property
    def with_parameters(self) -> Array:
        """Covariance of all columns with the reported parameters, shape (n, 27)."""
        return self.with_columns(self.system.columns.parameter_map().T)

    def with_columns(self, combinations: Array) -> Array:
        """Covariance of all columns with linear combinations of them, (n, m), shape (n, m)."""
        out = np.array(combinations)
        out[~self.system.active] = 0.0
        for part in self._conditionals:
            out[part.columns] = part.inverse.T @ out[part.columns]
            out[part.given] -= part.S.T @ out[part.columns]
        for part in reversed(self._conditionals):
            out[part.columns] = part.inverse @ (out[part.columns] - part.S @ out[part.given])
        return out

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the reported parameters, shape (27, 27)."""
        found = self.system.columns.parameter_map() @ self.with_parameters
        return np.asarray(0.5 * (found + found.T))

    @cached_property
    def rows_with_parameters(self) -> Array:
        """Covariance of the predicted rows A δ with the reported parameters, shape (m, 27)."""
        return np.asarray(self.system.A @ self.with_parameters)

    @cached_property
    def _roots(self) -> list[Array]:
        """Square root of the covariance of the columns that each step involves, in their order."""
        last = self._conditionals[-1]
        columns, root = last.columns, last.inverse
        out = []
        for part in reversed(self._conditionals[:-1]):
            at = np.searchsorted(columns, part.given)
            # The square root of the given columns, made square again.
            given = np.asarray(np.linalg.qr(root[at].T, mode="r")).T
            n, r = len(part.columns), given.shape[1]
            root = np.zeros((n + len(given), n + r))
            root[:n, :n], root[:n, n:], root[n:, n:] = part.inverse, -part.inverse @ (part.S @ given), given
            columns = np.concatenate([part.columns, part.given])
            order = np.argsort(columns)
            columns, root = columns[order], root[order]
            out.append(root)
        return out[::-1]

    @cached_property
    def _predicted_roots(self) -> list[Array]:
        """For each step, the square root H of the covariance H Hᵀ of the predicted rows A δ of the step."""
        # The roots have their columns in ascending order, the steps have local ones first.
        orders = (np.argsort(np.concatenate([step.local, step.onward, step.shared])) for step in self.steps)
        return [step.A[:, order] @ root for step, order, root in zip(self.steps, orders, self._roots, strict=True)]

    def predicted_root(self, step: int, rows: Indices) -> Array:
        """Square root H of the covariance H Hᵀ of predicted rows A δ of one step."""
        return np.asarray(self._predicted_roots[step][np.searchsorted(self.steps[step].rows, rows)])

    @cached_property
    def leverage(self) -> Array:
        """Variance of the predicted rows A δ of all sequences, shape (m,); zero for rows that belong to no step."""
        out = np.zeros(len(self.system.b))
        for step, H in zip(self.steps, self._predicted_roots, strict=True):
            out[step.rows] = np.einsum("ij,ij->i", H, H)
        return out


def eliminate(system: LinearSystem, shared: Indices) -> tuple[list[EliminationStep], list[_Conditional], Array]:
    """Steps, conditionals of the local columns of each, and rows that remain of the shared columns and of b."""
    out: list[_Conditional] = []
    carry, handed = np.empty((0, len(shared) + 1)), np.empty(0, dtype=np.intp)
    steps, rows = elimination_steps(system, shared)
    place = np.empty(len(system.active), dtype=np.intp)
    for step in steps:
        columns = np.concatenate([step.local, step.onward, shared])
        place[columns] = np.arange(len(columns))
        old = np.zeros((len(carry), len(columns) + 1))
        old[:, np.append(place[np.concatenate([handed, shared])], len(columns))] = carry
        R = np.asarray(np.linalg.qr(np.concatenate([np.column_stack([step.A, step.b]), old]), mode="r"))
        n = len(step.local)
        if len(R) < n:
            raise np.linalg.LinAlgError("dependent columns")
        out.append(_Conditional(step.local, columns[n:], R[:n, :n], R[:n, n:-1], R[:n, -1]))
        carry, handed = R[n:, n:], step.onward
    rest = np.column_stack([system.A[rows][:, shared].toarray(), system.b[rows]])
    return steps, out, np.concatenate([rest, carry])


def covariance_by_source(solution: BlockSolution) -> dict[str, Array]:
    """Covariance of the reported parameters by source of error, shape (27, 27) each."""
    out: dict[str, Array] = {}
    for rows in solution.system.rows:
        G = solution.rows_with_parameters[rows.index]
        for source, share in rows.sources.items():
            out[source] = out.get(source, 0.0) + np.einsum("rdp,rde,req->pq", G, share, G, optimize=True)
    return out


def apply_weights(system: LinearSystem, weights: dict[tuple[str, int], float]) -> LinearSystem:
    """Scale rows by the square roots of their weights.

    Parameters
    ----------
    system : LinearSystem
    weights : dict of (str, int) to float
        Weights by kind and number: "window" (force and rate) and the other kinds, each in the order of its rows.
    """
    factor, whitening = np.ones(len(system.b)), dict(system.whitening)
    for group in {kind for kind, _ in weights}:
        root = np.sqrt([weight for (kind, _), weight in weights.items() if kind == group])[:, None]
        for kind in ("force", "rate") if group == "window" else (group,):
            factor[system.rows_of(kind).index] = root
            whitening[kind] = whitening[kind] * root[:, :, None]
    A = (diags_array(factor) @ system.A).tocsr()
    return replace(system, A=A, b=system.b * factor, whitening=whitening)
