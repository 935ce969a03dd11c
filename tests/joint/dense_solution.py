"""Least-squares solution of a linearised system by one QR decomposition of all its rows: the reference of the tests."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular


@dataclass(frozen=True)
class DenseSolution:
    """Correction of all columns, zero where inactive, and a square root of their covariance."""

    delta: np.ndarray
    root: np.ndarray


def solve(system):
    """Solution with columns scaled to norm 1."""
    A = system.A[:, np.flatnonzero(system.active)].toarray()
    scale = np.linalg.norm(A, axis=0)
    Q, R = np.linalg.qr(A / scale)
    delta, root = np.zeros(len(system.active)), np.zeros((len(system.active), len(scale)))
    delta[system.active] = -solve_triangular(R, Q.T @ system.b) / scale
    root[system.active] = solve_triangular(R, np.eye(len(scale))) / scale[:, None]
    return DenseSolution(delta, root)
