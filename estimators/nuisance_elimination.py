"""Measurements of each sequence for a filter, after elimination of the nuisance parameters.

An orthogonal transformation (QR) of the rows of a sequence concentrates its nuisance parameters, such as attitudes,
edge errors and the white part of the drift, in the first rows. The other rows are white measurements of the filter's
state.
The states of the drift, and an attitude or edge error that both share, are handed on to the next sequence: the
rows of these columns become the transition of the filter's states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.elimination_steps import elimination_steps, global_columns

if TYPE_CHECKING:
    from estimators.linear_system import LinearSystem
    from srt.types import Array, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class SequenceEquations:
    """Whitened equations of one sequence, with noise of unit covariance.

    The columns p are those handed on by the previous sequence, p' those handed on by this one. A column in both keeps
    its value.

    Attributes
    ----------
    sequence : int
    H : ndarray, shape (m, n)
        Measurements of the global columns g and of p: ``0 = b + H g + H_handed p + noise``.
    H_handed : ndarray, shape (m, p)
    b : ndarray, shape (m,)
    transition : tuple of ndarray
        R (q, q), G (q, n), P (q, p), c (q) of the new columns among p': ``0 = c + R p' + G g + P p + noise``.
    before, after : ndarray of int, shape (p,) and (p',)
        Columns p and p' in the system.
    is_new : ndarray of bool, shape (p',)
        True: a column of p' that is not among p.
    local : tuple of ndarray
        Columns of the nuisance parameters y (l), R (l, l), S (l, q), G (l, n), P (l, p), c (l):
        ``0 = c + R y + S p' + G g + P p + noise``.
    """

    sequence: int
    H: Array
    H_handed: Array
    b: Array
    transition: tuple[Array, Array, Array, Array]
    before: Indices
    after: Indices
    is_new: Mask
    local: tuple[Indices, Array, Array, Array, Array, Array]

    def advance(self) -> tuple[Array, Array, Array, Array]:
        """Columns p' from g and p: matrices (p', n) and (p', p), constant (p',), and root of their noise (p', q)."""
        R, G, P, c = self.transition
        new = self.is_new
        inverse = np.linalg.inv(R)
        by_g, by_p = np.zeros((len(new), G.shape[1])), np.zeros((len(new), P.shape[1]))
        constant, noise = np.zeros(len(new)), np.zeros((len(new), len(R)))
        by_g[new], by_p[new], constant[new], noise[new] = -inverse @ G, -inverse @ P, -inverse @ c, inverse
        by_p[np.flatnonzero(~new), np.searchsorted(self.before, self.after[~new])] = 1.0
        return by_g, by_p, constant, noise

    def nuisances(self, g: Array, p: Array, handed_on: Array) -> Array:
        """Nuisance parameters (l) for given global columns, columns handed in, and columns handed on."""
        _, R, S, G, P, c = self.local
        new = handed_on[self.is_new]
        return -np.asarray(np.linalg.solve(R, S @ new + G @ g + P @ p + c), dtype=np.float64)


def smoothed(parts: list[SequenceEquations], g: Array) -> list[Array]:
    """Columns handed on by every sequence, from the measurements of all sequences, for given global columns."""
    solved: list[tuple[Array, Indices, Indices]] = []
    carry = np.zeros((0, 1))
    for part in parts[:-1]:
        p = len(part.before)
        R, G, P, c = part.transition
        # Columns that end here, columns of both p and p', new columns, and the constant.
        old = np.searchsorted(part.before, part.after[~part.is_new])
        order = np.concatenate([np.setdiff1d(np.arange(p), old), old])
        known = np.concatenate([carry, np.column_stack([part.H_handed, part.H @ g + part.b])])
        step = np.column_stack([P[:, order], R, G @ g + c])
        rows = np.zeros((len(known) + len(step), p + len(R) + 1))
        rows[: len(known), :p], rows[: len(known), -1] = known[:, order], known[:, -1]
        rows[len(known) :] = step
        T, n = np.asarray(np.linalg.qr(rows, mode="r")), p - len(old)
        place = np.concatenate([np.flatnonzero(~part.is_new), np.flatnonzero(part.is_new)])
        solved.append((T[:n], order, place))
        carry = np.zeros((max(len(T) - n, 0), len(part.after) + 1))
        carry[:, place], carry[:, -1] = T[n:, n:-1], T[n:, -1]
    last = parts[-1]
    rows = np.concatenate([carry, np.column_stack([last.H_handed, last.H @ g + last.b])])
    value: Array = np.zeros(0)
    if len(last.before):
        value = -np.asarray(np.linalg.lstsq(rows[:, :-1], rows[:, -1])[0], dtype=np.float64)
    out: list[Array] = [np.zeros(0)]
    for part, (top, order, place) in zip(reversed(parts[:-1]), reversed(solved), strict=True):
        out.insert(0, value)
        n, before = len(top), np.empty(len(part.before))
        before[order[n:]] = value[~part.is_new]
        before[order[:n]] = -np.linalg.solve(top[:, :n], top[:, n:-1] @ value[place] + top[:, -1])
        value = before
    return out


def eliminate_nuisances(system: LinearSystem) -> list[SequenceEquations]:
    """Equations of all sequences in time order."""
    out = []
    before = np.empty(0, dtype=np.intp)
    is_before = np.zeros(len(system.active), dtype=np.bool_)
    for step in elimination_steps(system, global_columns(system), own_bias=True)[0]:
        own = np.concatenate([step.local, step.onward])
        is_before[:] = False
        is_before[before] = True
        is_old = is_before[own]
        is_new = ~is_old
        n, q = int(is_new[: len(step.local)].sum()), int(is_new[len(step.local) :].sum())
        A, G = step.A[:, : len(own)], step.A[:, len(own) :]
        P = np.zeros((len(A), len(before)))
        P[:, np.searchsorted(before, own[is_old])] = A[:, is_old]
        Q, R = np.linalg.qr(A[:, is_new], mode="complete")
        G, P, c = Q.T @ G, Q.T @ P, Q.T @ step.b
        middle, rest = slice(n, n + q), slice(n + q, None)
        out.append(
            SequenceEquations(
                sequence=step.sequence,
                H=G[rest],
                H_handed=P[rest],
                b=c[rest],
                transition=(R[middle, n:], G[middle], P[middle], c[middle]),
                before=before,
                after=step.onward,
                is_new=is_new[len(step.local) :],
                local=(own[is_new][:n], R[:n, :n], R[:n, n:], G[:n], P[:n], c[:n]),
            )
        )
        before = step.onward
    return out
