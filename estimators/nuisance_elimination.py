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
from scipy.linalg.lapack import dgeqrf, dormqr

from srt.joint.linear_system import elimination_steps, global_columns

if TYPE_CHECKING:
    from srt.joint.linear_system import LinearSystem
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
        R (q, q) and [G, P, c] (q, n + p + 1) of the new columns among p': ``0 = c + R p' + G g + P p + noise``.
    before, after : ndarray of int, shape (p,) and (p',)
        Columns p and p' in the system.
    is_new : ndarray of bool, shape (p',)
        True: a column of p' that is not among p.
    local : tuple of ndarray
        Columns of the nuisance parameters y (l), R (l, l), S (l, q), [G, P, c] (l, n + p + 1):
        ``0 = c + R y + S p' + G g + P p + noise``.
    """

    sequence: int
    H: Array
    H_handed: Array
    b: Array
    transition: tuple[Array, Array]
    before: Indices
    after: Indices
    is_new: Mask
    local: tuple[Indices, Array, Array, Array]

    def advance(self) -> tuple[Array, Array, Array, Array]:
        """Columns p' from g and p: matrices (p', n) and (p', p), constant (p',), and root of their noise (p', q)."""
        R, rows = self.transition
        new, n = self.is_new, self.H.shape[1]
        inverse = np.linalg.inv(R)
        by, noise = np.zeros((len(new), rows.shape[1])), np.zeros((len(new), len(R)))
        by[new], noise[new] = -inverse @ rows, inverse
        if not new.all():
            by[np.flatnonzero(~new), n + np.searchsorted(self.before, self.after[~new])] = 1.0
        return by[:, :n], by[:, n:-1], by[:, -1], noise

    def nuisances(self, g: Array, p: Array, handed_on: Array) -> Array:
        """Nuisance parameters (l) for given global columns, columns handed in, and columns handed on."""
        _, R, S, rows = self.local
        known = S @ handed_on[self.is_new] + rows @ np.concatenate([g, p, [1.0]])
        return -np.asarray(np.linalg.solve(R, known), dtype=np.float64)


def smoothed(parts: list[SequenceEquations], g: Array) -> list[Array]:
    """Columns handed on by every sequence, from the measurements of all sequences, for given global columns."""
    solved: list[tuple[Array, Indices, Indices]] = []
    carry = np.zeros((0, 1))
    for part in parts[:-1]:
        p = len(part.before)
        R, given = part.transition
        # Columns that end here, columns of both p and p', new columns, and the constant.
        old = np.searchsorted(part.before, part.after[~part.is_new])
        order = np.concatenate([np.setdiff1d(np.arange(p), old), old])
        known = np.concatenate([carry, np.column_stack([part.H_handed, part.H @ g + part.b])])
        step = np.column_stack([given[:, len(g) + order], R, given[:, : len(g)] @ g + given[:, -1]])
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


def eliminate_nuisances(system: LinearSystem, last: int | None = None) -> list[SequenceEquations]:
    """Equations of the sequences in time order, to that of the number ``last``, from 0; default: of all."""
    out = []
    before = np.empty(0, dtype=np.intp)
    is_before = np.zeros(len(system.active), dtype=np.bool_)
    steps = elimination_steps(system, global_columns(system), own_bias=True)[0]
    for step in steps if last is None else steps[: last + 1]:
        own = np.concatenate([step.local, step.onward])
        is_before[:] = False
        is_before[before] = True
        is_old = is_before[own]
        is_new = ~is_old
        n, q = int(is_new[: len(step.local)].sum()), int(is_new[len(step.local) :].sum())
        # Coefficients of the global columns, of those handed in, and the constant.
        A, m = step.A[:, : len(own)], len(step.shared)
        given = np.zeros((len(A), m + len(before) + 1))
        given[:, :m], given[:, -1] = step.A[:, len(own) :], step.b
        given[:, m + np.searchsorted(before, own[is_old])] = A[:, is_old]
        factor, tau, _, _ = dgeqrf(A[:, is_new])
        R, given = np.triu(factor[: n + q]), dormqr("L", "T", factor, tau, given, given.size)[0]
        middle, rest = slice(n, n + q), slice(n + q, None)
        out.append(
            SequenceEquations(
                sequence=step.sequence,
                H=given[rest, :m],
                H_handed=given[rest, m:-1],
                b=given[rest, -1],
                transition=(R[middle, n:], given[middle]),
                before=before,
                after=step.onward,
                is_new=is_new[len(step.local) :],
                local=(own[is_new][:n], R[:n, :n], R[:n, n:], given[:n]),
            )
        )
        before = step.onward
    return out
