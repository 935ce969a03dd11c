"""Dense least-squares solution of the linearised system, covariance by source of error, and weights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import solve_triangular

if TYPE_CHECKING:
    from estimators.linear_system import LinearSystem
    from srt.types import Array


_SINGULAR: Final = 1e-13
"""Columns are scaled to norm 1. A smaller diagonal element of R marks linearly dependent columns."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseSolution:
    """Least-squares solution of all columns together.

    Attributes
    ----------
    delta : ndarray, shape (n,)
        Correction; zero for columns that are not active.
    root : ndarray, shape (n, number of active columns)
        Square root S of the covariance of all columns, S Sᵀ.
    """

    delta: Array
    root: Array


def solve(system: LinearSystem) -> DenseSolution:
    """Solve the system by QR decomposition, with columns scaled to norm 1.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the active columns are linearly dependent.
    """
    A = system.A[:, system.active]
    scale = np.linalg.norm(A, axis=0)
    if np.any(scale == 0.0):
        raise np.linalg.LinAlgError("a column without any measurement")
    Q, R = np.linalg.qr(A / scale)
    if np.abs(np.diag(R)).min() < _SINGULAR:
        raise np.linalg.LinAlgError("dependent columns")
    delta, root = np.zeros(len(scale_all := system.active)), np.zeros((len(scale_all), len(scale)))
    delta[system.active] = -solve_triangular(R, Q.T @ system.b) / scale
    root[system.active] = solve_triangular(R, np.eye(len(scale))) / scale[:, None]
    return DenseSolution(delta, root)


def covariance_by_source(system: LinearSystem, solution: DenseSolution) -> dict[str, Array]:
    """Covariance of the reported parameters by source of error, shape (27, 27) each."""
    E = system.parameter_map()
    P = (E @ solution.root) @ solution.root.T
    out: dict[str, Array] = {}
    for rows in system.rows:
        G = np.einsum("pn,rdn->rpd", P, system.A[rows.index])
        for source, share in rows.sources.items():
            part = np.einsum("rpd,rde,rqe->pq", G, share, G)
            out[source] = out.get(source, 0.0) + part
    return out


def apply_weights(system: LinearSystem, weights: dict[tuple[str, int], float]) -> LinearSystem:
    """Scale rows by the square roots of their weights.

    Parameters
    ----------
    system : LinearSystem
    weights : dict of (str, int) to float
        Weights by kind and number: "window" (force and rate), "turn", and "start" by window, in the order of the rows.
    """
    factor = np.ones(len(system.b))
    for group in {kind for kind, _ in weights}:
        numbers = [n for kind, n in weights if kind == group]
        root = np.sqrt([weights[group, n] for n in numbers])[:, None]
        for kind in ("force", "rate") if group == "window" else (group,):
            rows = system.rows_of(kind).index
            factor[rows if group == "start" else rows[numbers]] = root
    return replace(system, A=system.A * factor[:, None], b=system.b * factor)
