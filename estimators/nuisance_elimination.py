"""Measurements of each sequence for a filter, after elimination of the nuisance parameters.

An orthogonal transformation (QR) of the rows of a sequence concentrates its nuisance parameters, attitudes and edge
errors, in the first rows. The other rows are white measurements of the filter's state. Where the next sequence starts
from the end attitude, the rows of this attitude become the transition of the filter's attitude states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from estimators.joint_model import JointModel
    from estimators.linear_system import LinearSystem
    from srt.types import Array, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class SequenceEquations:
    """Whitened equations of one sequence, with noise of unit covariance.

    Attributes
    ----------
    sequence : int
    H : ndarray, shape (m, n)
        Measurements of the global columns g and the previous end attitude p: ``0 = b + H g + H_pose p + noise``.
    H_pose : ndarray, shape (m, 3)
        Zero if the sequence does not start from the previous end attitude.
    b : ndarray, shape (m,)
    pose : tuple of ndarray, or None
        R (p, p), G (p, n), G_pose (p, 3), c (p) of the end attitude p' that the next sequence starts from:
        ``0 = c + R p' + G g + G_pose p + noise``; None if the next sequence does not start from it.
    pose_columns : ndarray of int, shape (p,)
        Columns of the end attitude in the system.
    pose_active : ndarray of bool, shape (3,)
        Directions of the end attitude that are estimated.
    local : tuple of ndarray
        Columns of the nuisance parameters y (l), R (l, l), S (l, p), G (l, n), G_pose (l, 3), c (l):
        ``0 = c + R y + S p' + G g + G_pose p + noise``.
    """

    sequence: int
    H: Array
    H_pose: Array
    b: Array
    pose: tuple[Array, Array, Array, Array] | None
    pose_columns: Indices
    pose_active: Mask
    local: tuple[Indices, Array, Array, Array, Array, Array]

    def nuisances(self, g: Array, pose: Array) -> tuple[Array, Array]:
        """Nuisance parameters (l) and end attitude (3) for given global columns and previous end attitude."""
        _, R, S, G, G_pose, c = self.local
        new: Array = np.zeros(len(self.pose_columns))
        if self.pose is not None:
            R_new, G_new, P_new, c_new = self.pose
            new = -np.asarray(np.linalg.solve(R_new, G_new @ g + P_new @ pose + c_new), dtype=np.float64)
        handed_on = np.zeros(3)
        handed_on[self.pose_active] = new
        own: Array = -np.asarray(np.linalg.solve(R, S @ new + G @ g + G_pose @ pose + c), dtype=np.float64)
        return own, handed_on


def global_columns(system: LinearSystem) -> Indices:
    """Estimated columns shared by all sequences, in the order of the filter's state; one gyro bias represents all.

    The columns of the bias instability are the last, ordered by the first sequence that depends on each.
    """
    names = ("errors", "bias", "base", "mounting", "gravity", "earth_rate", "instability")
    kept = [system.of(name)[:3] if name == "bias" else system.of(name) for name in names]
    columns = np.concatenate(kept)
    return columns[system.active[columns]]


def eliminate_nuisances(joint: JointModel, system: LinearSystem) -> list[SequenceEquations]:
    """Equations of all sequences in time order."""
    shared = global_columns(system)
    bias = system.columns["bias"]
    data = joint.data
    rows_of: list[list[Indices]] = [[] for _ in range(data.K)]
    edges = next((r.index for r in system.rows if r.kind == "edge"), np.empty((0, 3), dtype=np.intp))
    for rows in system.rows:
        if rows.kind == "edge":
            continue
        for member, owner in zip(rows.index, rows.owner.tolist(), strict=True):
            if owner >= 0:
                rows_of[owner].append(member)
    attitude = system.of("attitude").reshape(-1, 3)
    later = {int(data.start[k]): i for i, k in enumerate(joint.order.tolist())}
    out = []
    carried = -1
    for i, k in enumerate(joint.order.tolist()):
        at = np.concatenate(rows_of[k])
        # Each sequence adds the priors of its edge errors; an edge shared with the next rotation is independent there.
        used = system.A[np.ix_(at, system.of("edge"))].any(axis=0).reshape(-1, 3).any(axis=1)
        at = np.concatenate([at, edges[used].ravel()])
        A, b = system.A[at], system.b[at]
        end = int(data.end[k])
        onward = end if later.get(end, -1) > i else -1
        own = np.flatnonzero(A.any(axis=0) & system.active)
        own = own[own >= system.columns["attitude"].start]
        handed_in = attitude[carried] if carried >= 0 else np.empty(0, dtype=np.intp)
        handed_on = attitude[onward][system.active[attitude[onward]]] if onward >= 0 else np.empty(0, dtype=np.intp)
        local = own[~np.isin(own, np.concatenate([handed_in, handed_on]))]
        mine = shared.copy()
        if bias.stop - bias.start > 3:
            of_bias = (shared >= bias.start) & (shared < bias.stop)
            mine[of_bias] += 3 * k
        G = A[:, mine]
        P = A[:, handed_in] if carried >= 0 else np.zeros((len(at), 3))
        Q, R = np.linalg.qr(A[:, np.concatenate([local, handed_on])], mode="complete")
        G, P, c = Q.T @ G, Q.T @ P, Q.T @ b
        n, p = len(local), len(handed_on)
        pose = (R[n : n + p, n:], G[n : n + p], P[n : n + p], c[n : n + p]) if p else None
        active = np.isin(attitude[onward], handed_on) if onward >= 0 else np.zeros(3, dtype=np.bool_)
        own_rows = (local, R[:n, :n], R[:n, n:], G[:n], P[:n], c[:n])
        out.append(SequenceEquations(k, G[n + p :], P[n + p :], c[n + p :], pose, handed_on, active, own_rows))
        carried = onward
    return out
