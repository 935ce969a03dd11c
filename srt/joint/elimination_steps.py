"""Steps of the elimination of a linear system: one for each sequence, in the order of time.

A step holds the rows of its sequence. Columns that no later step needs are local; the others are handed on. Both the
least-squares solution (:mod:`srt.joint.block_solution`) and the filter (:mod:`estimators.nuisance_elimination`)
eliminate step by step, so that their cost grows with the number of sequences and not with its cube.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.joint.linear_system import FIXTURE

if TYPE_CHECKING:
    from srt.joint.linear_system import LinearSystem
    from srt.types import Array, Indices

_GLOBAL = ("errors", "bias", *FIXTURE, "gravity", "table_rate", "earth_rate", "drift_form")


@dataclass(frozen=True, slots=True, eq=False)
class EliminationStep:
    """Rows of one step.

    Attributes
    ----------
    sequence : int
    rows : ndarray of int, shape (m,)
    local, onward, shared : ndarray of int
        Columns that no later step needs; columns handed on to the next step; columns of the whole recording.
    A : ndarray, shape (m, local + onward + shared)
    b : ndarray, shape (m,)
    """

    sequence: int
    rows: Indices
    local: Indices
    onward: Indices
    shared: Indices
    A: Array
    b: Array


def global_columns(system: LinearSystem) -> Indices:
    """Estimated columns of the whole recording; of the gyro biases of a random walk, the first represents all."""
    names = [system.columns.of(name)[:3] if name == "bias" else system.columns.of(name) for name in _GLOBAL]
    columns = np.concatenate(names)
    return columns[system.active[columns]]


def elimination_steps(
    system: LinearSystem, shared: Indices, *, own_bias: bool = False
) -> tuple[list[EliminationStep], Indices]:
    """Steps in the order of time, and the rows of the whole recording, which belong to none.

    Parameters
    ----------
    system : LinearSystem
    shared : ndarray of int
        Columns of the whole recording.
    own_bias : bool
        In every step, the bias of its sequence takes the place of the shared one, and rows of the bias walk and of its
        prior are left out: a filter adds them itself.
    """
    K, (m, n) = len(system.order), system.A.shape
    bias = system.columns["bias"]
    of_bias = (shared >= bias.start) & (shared < bias.stop)
    own_bias = own_bias and bias.stop - bias.start > 3
    is_global = np.zeros(n, dtype=np.bool_)
    is_global[shared] = True
    if own_bias:
        is_global[bias] = True
    step_of = np.full(m, -1, dtype=np.intp)
    for group in system.rows:
        if not (own_bias and group.kind == "walk"):
            step_of[group.index] = group.step[:, None]
    A = system.A.tocoo()
    used = (A.data != 0.0) & system.active[A.col]
    row, column, value = A.row[used], A.col[used], A.data[used]
    # A prior of the mean of all biases needs those of all steps.
    step_of[row[(step_of[row] < 0) & ~is_global[column]]] = K - 1
    kept = step_of[row] >= 0
    row, column, value = row[kept], column[kept], value[kept]
    first, last = np.full(n, K), np.full(n, -1)
    local = ~is_global[column]
    np.minimum.at(first, column[local], step_of[row[local]])
    np.maximum.at(last, column[local], step_of[row[local]])
    order, ends = _by_step(step_of[row], K)
    place, out = np.empty(n, dtype=np.intp), []
    rows_by_step, row_ends = _by_step(step_of, K)
    for i, k in enumerate(system.order.tolist()):
        rows = rows_by_step[row_ends[i] : row_ends[i + 1]]
        here, onward = np.flatnonzero(last == i), np.flatnonzero((first <= i) & (last > i))
        mine = shared + 3 * k * of_bias if own_bias else shared
        columns = np.concatenate([here, onward, mine])
        place[columns] = np.arange(len(columns))
        dense, entries = np.zeros((len(rows), len(columns))), order[ends[i] : ends[i + 1]]
        dense[np.searchsorted(rows, row[entries]), place[column[entries]]] = value[entries]
        out.append(EliminationStep(k, rows, here, onward, mine, dense, system.b[rows]))
    return out, np.flatnonzero(step_of < 0)


def _by_step(step: Indices, K: int) -> tuple[Indices, Indices]:
    """Order of members by step, and the limits of each step in it; members of steps below 0 come before the first."""
    order = np.argsort(step, kind="stable")
    return order, np.searchsorted(step[order], np.arange(K + 1))
