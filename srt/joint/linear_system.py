"""Linearised joint model: whitened rows over named columns, and the steps of its elimination.

Rows are measurements and priors, each whitened with its noise, so that the correction δ minimises ``|A δ + b|²``.
Attitudes are corrected by small rotations about the axes of the level frame L: two tilts and the heading. Errors that
measurements share, such as the quantization at a window edge or the bias instability, are columns of their own.

A step of the elimination, one for each sequence in the order of time, holds the rows of its sequence. Columns that no
later step needs are local; the others are handed on. Both the least-squares solution
(:mod:`srt.joint.block_solution`) and the filter (:mod:`estimators.nuisance_elimination`) eliminate step by step, so
that their cost grows with the number of sequences and not with its cube.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from srt.joint.joint_state import CompensatedData
    from srt.types import Array, Indices, Mask


N_ERRORS: Final = GROUP_SLICES["gyro_bias"].start
"""Number of sensor errors other than the gyro bias, which can differ between sequences."""
FIXTURE: Final = {"base": 3, "mounting": 3, "non_orthogonality": 1}
"""Columns of the fixture's alignment by name, with their number; one prior row each."""


@dataclass(frozen=True, slots=True, eq=False)
class RowGroup:
    """Rows of one kind: d for each of n windows, rotations or other members.

    Attributes
    ----------
    kind : str
    first : int
        First row of the group in A.
    owner : ndarray of int, shape (n,)
        Sequence of each member; −1 for priors of the recording.
    step : ndarray of int, shape (n,)
        Step of the elimination, in the order of time, that processes each member; −1: after all steps.
    sources : dict of str to ndarray, shape (n, d, d)
        Share of each source of error in the whitened (unit) covariance of each member.
    size : int
        Number of rows of a member, d.
    """

    kind: str
    first: int
    owner: Indices
    step: Indices
    sources: dict[str, Array]
    size: int = 3

    @property
    def index(self) -> Indices:
        """Row numbers in A by member, shape (n, d)."""
        return self.first + np.arange(len(self.owner) * self.size).reshape(-1, self.size)


class Columns(dict[str, slice]):
    """Columns of a linear system by name.

    "errors" (24), "bias" (3, or 3 per sequence), those of ``FIXTURE``, "gravity", "table_rate" (1 if a rate is stated),
    "earth_rate" (3 per level frame), "drift_form" (1 per coefficient), "attitude" (3 per window), "edge" (3 per edge
    that is an unknown), and the states and white unknowns of the bias instability of every sequence: "gyro_drift",
    "gyro_drift_noise", "accel_drift", "accel_drift_noise".

    Parameters
    ----------
    sizes : dict of str to int
        Number of columns by name, in their order.
    """

    def __init__(self, sizes: dict[str, int]) -> None:
        stops = np.cumsum(list(sizes.values())).tolist()
        super().__init__(
            (name, slice(stop - size, stop)) for (name, size), stop in zip(sizes.items(), stops, strict=True)
        )
        self.count: int = stops[-1]

    def of(self, name: str) -> Indices:
        """Column numbers by name."""
        return np.arange(self[name].start, self[name].stop)

    def parameter_map(self) -> Array:
        """Reported parameters from the columns, shape (27, n): the gyro bias is the mean over the sequences."""
        E = np.zeros((N_PARAMETERS, self.count))
        E[:N_ERRORS, self["errors"]] = np.eye(N_ERRORS)
        number = len(self.of("bias")) // 3
        E[N_ERRORS:, self["bias"]] = np.tile(np.eye(3), number) / number
        return E


@dataclass(frozen=True, slots=True, eq=False)
class LinearSystem:
    """Linear least-squares system: minimise ``|A δ + b|²`` over the active columns.

    Attributes
    ----------
    A : scipy.sparse.csr_array, shape (m, n)
    b : ndarray, shape (m,)
    columns : Columns
    active : ndarray of bool, shape (n,)
        Columns that are estimated.
    rows : tuple of RowGroup
    free : ndarray of bool, shape (27,)
        Sensor errors that are estimated.
    whitening : dict of str to ndarray, shape (n, d, d)
        Whitening matrices of the residuals, by kind of rows.
    compensated : CompensatedData
        Compensated data that were linearised.
    order : ndarray of int, shape (K,)
        Sequences in the order of time.
    """

    A: Any
    b: Array
    columns: Columns
    active: Mask
    rows: tuple[RowGroup, ...]
    free: Mask
    whitening: dict[str, Array]
    compensated: CompensatedData
    order: Indices

    def rows_of(self, kind: str) -> RowGroup:
        """Rows of a kind."""
        return next(r for r in self.rows if r.kind == kind)


def attitude_columns(columns: Columns) -> Mask:
    """Mask of the columns that do not affect compensation: fixture, site and attitudes, shape (n,)."""
    out = np.zeros(columns.count, dtype=np.bool_)
    for name in (*FIXTURE, "gravity", "table_rate", "earth_rate", "attitude"):
        out[columns[name]] = True
    return out


def whiten(covariance: Array) -> Array:
    """Whitening matrices W, ``W R Wᵀ = I``, of covariances R, shape (n, d, d)."""
    scale = np.sqrt(np.einsum("naa->na", covariance))
    unit = covariance / (scale[:, :, None] * scale[:, None, :])
    return np.asarray(np.linalg.inv(np.linalg.cholesky(unit)) / scale[:, None, :])


def total(noise: dict[str, Array]) -> Array:
    """Sum of the covariances of all sources, shape (n, d, d)."""
    return np.asarray(sum(noise.values()))


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
