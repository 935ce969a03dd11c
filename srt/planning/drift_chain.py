"""Accuracy of ordered tests, fast: slow drift of the biases as a Markov chain from sequence to sequence.

The covariance of a whole test (:func:`srt.planning.prediction.variances_of_test`) has a row for every measurement.
Here each sequence is a measurement of the unknowns and of the slow components of bias instability in its middle, and
the information is passed on from sequence to sequence (an information filter). What a slow component does within a
sequence is noise of this sequence. Without drift the sigmas are those of the whole covariance, to 0.2 %. With drift
they are too large, by some 10 %, for accelerometer asymmetries in orders of Table 1 by up to 50 %.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.noise.bias_instability import (
    CORRELATION_TIMES_S,
    PROCESS_VARIANCE,
    adjoining_covariance,
    correlation_times,
)
from srt.planning.information import target_variances, whitening

if TYPE_CHECKING:
    from srt.planning.selection import AccuracyCriterion
    from srt.types import Array, Indices

_STEP: Final = 1.2
"""Ratio of successive window lengths; information is interpolated linearly between them."""
MOST_STEPS: Final = 6
"""Largest lengthening of the windows of one sequence over those of the others, in steps: a factor of 3."""
_SLOW_S: Final = 50.0
"""Correlation time from which on bias instability is a state of the chain, s: sequences are some 25 s apart."""


class DriftChain:
    """Variances of the targets of tests that consist of members of a pool.

    Both windows of a sequence are equal. Their lengths are those of a common length times a factor of each sequence,
    ``_STEP`` to the power of its steps; the common length is such that the test takes the whole time.

    Parameters
    ----------
    which : ndarray of int, shape (m,)
        Members of the pool, as positions in the signatures of the criterion.
    moves_s : ndarray, shape (m, m), s
        Time from the end of one member to the start window of another.
    total_s : float
        Length of the test, s.
    """

    def __init__(self, criterion: AccuracyCriterion, which: Indices, moves_s: Array, total_s: float) -> None:
        self.criterion, self.which, self.moves_s, self.total_s = criterion, which, moves_s, total_s
        self.between_s = criterion.signatures.between_windows_s[which]
        low, high = criterion.shortest_s, criterion.longest_s
        lengths = np.minimum(low * _STEP ** np.arange(math.ceil(math.log(high / low, _STEP) - 1e-9) + 1), high)
        self.lengths_s = np.append(lengths, lengths[-1])  # the longest twice: it is interpolated with itself
        self.levels = np.arange(-MOST_STEPS, len(self.lengths_s) - 1)
        slow = [tau for tau in correlation_times(total_s) if tau > _SLOW_S]
        self.tau_s = np.repeat(slow, 6)
        self.information = np.stack([self._information(length, slow) for length in self.lengths_s])
        self.duration_s = 2.0 * self.lengths_s[:, None] + self.between_s

    def _information(self, window_s: float, slow: list[float]) -> Array:
        """Information of every member on unknowns and slow drift, for windows of one length, shape (m, n, n)."""
        own, k = self.criterion.signatures, self.which
        T = np.full(len(k), window_s)
        lengths = np.stack([T, np.maximum(self.between_s, 1e-6), T], axis=1)
        shares = np.array([tau not in slow for tau in CORRELATION_TIMES_S], dtype=np.float64)
        within, means = adjoining_covariance(lengths, shares), []
        for tau in slow:
            # Mean correlation of each interval with the middle of the test sequence.
            half, x = lengths[:, 1] / (2.0 * tau), lengths[:, ::2] / tau
            beside = np.exp(-half)[:, None] * -np.expm1(-x) / x
            mean = np.stack([beside[:, 0], -np.expm1(-half) / half, beside[:, 1]], axis=1)
            alone = np.array([t == tau for t in CORRELATION_TIMES_S], dtype=np.float64)
            within += adjoining_covariance(lengths, alone)
            within -= PROCESS_VARIANCE * mean[:, :, None] * mean[:, None, :]
            means.append(mean)
        R = np.asarray(sum(own.covariances(T, T, k, drift=False).values()))
        columns = [own.H[k] * self.criterion.scale]
        sources = (own.conditions.gyro_instability, own.by_bias[k], slice(None)), (
            own.conditions.accel_instability, own.by_force[k], slice(None, None, 2)
        )  # fmt: skip
        for floor, effect, intervals in sources:
            K = floor**2 * within[:, intervals, intervals]
            R += np.einsum("kiac,kij,kjbc->kab", effect, K, effect, optimize=True)
        for mean in means:
            columns += [
                floor * math.sqrt(PROCESS_VARIANCE) * np.einsum("kiac,ki->kac", effect, mean[:, intervals])
                for floor, effect, intervals in sources
            ]
        rows = whitening(R) @ np.concatenate(columns, axis=2)
        return np.asarray(np.swapaxes(rows, 1, 2) @ rows)

    def windows_s(self, members: Indices, steps: Indices) -> tuple[Array, Array, Array, Array]:
        """Window lengths with which tests take the whole time.

        Parameters
        ----------
        members, steps : ndarray of int, shape (B, n)

        Returns
        -------
        windows_s : ndarray, shape (B, n), s
            NaN for tests that are too long with the shortest windows.
        level : ndarray of int, shape (2, B, n)
            Positions in the table of lengths between which information is interpolated.
        share : ndarray, shape (B,)
            Weight of the second.
        gaps_s : ndarray, shape (B, n - 1), s
            Times between the middles of the sequences.
        """
        moves = self.moves_s[members[:, :-1], members[:, 1:]]
        at = np.clip(self.levels[:, None, None] + steps, 0, len(self.lengths_s) - 1)
        cost = self.duration_s[at, members].sum(axis=2) + moves.sum(axis=1)
        every = np.arange(len(members))
        first = np.minimum((cost[1:-1] <= self.total_s).sum(axis=0), len(cost) - 2)
        low, high = cost[first, every], cost[first + 1, every]
        share = np.clip((self.total_s - low) / np.maximum(high - low, 1e-9), 0.0, 1.0)
        level, part = np.stack([at[first, every], at[first + 1, every]]), share[:, None]
        windows = (1.0 - part) * self.lengths_s[level[0]] + part * self.lengths_s[level[1]]
        windows[cost[0] > self.total_s] = np.nan
        duration = 2.0 * windows + self.between_s[members]
        return windows, level, share, 0.5 * (duration[:, :-1] + duration[:, 1:]) + moves

    def variances(self, members: Indices, steps: Indices) -> tuple[Array, Array]:
        """Variances over squared targets of B tests, shape (B, q), infinite if too long; the windows, (B, n), s."""
        windows, level, share, gaps = self.windows_s(members, steps)
        fits = np.isfinite(windows[:, 0])
        out = np.full((len(members), len(self.criterion.targets)), np.inf)
        members, level, share, gaps = members[fits], level[:, fits], share[fits, None, None], gaps[fits]
        decay = np.exp(-gaps[..., None] / self.tau_s)
        free = 1.0 / -np.expm1(-2.0 * gaps[..., None] / self.tau_s)  # inverse variance of what is new in a gap
        p, n = len(self.criterion.scale), members.shape[1]
        drift = np.arange(len(self.tau_s))
        # Information on the unknowns, on the drift, and of both, in blocks; the drift has a variance of one first.
        M: Array = np.broadcast_to(self.criterion.prior, (len(members), p, p))
        C: Array = np.zeros((len(members), len(drift), p))
        D: Array = np.broadcast_to(np.eye(len(drift)), (len(members), len(drift), len(drift)))
        for k in range(n):
            each = (1.0 - share) * self.information[level[0, :, k], members[:, k]]
            each += share * self.information[level[1, :, k], members[:, k]]
            M, C, D = M + each[:, :p, :p], C + each[:, p:, :p], D + each[:, p:, p:]
            if k < n - 1:
                D[:, drift, drift] += decay[:, k] ** 2 * free[:, k]
            inverse = np.linalg.inv(D)
            Y = inverse @ C
            M -= np.swapaxes(C, 1, 2) @ Y
            if k < n - 1:
                passed = decay[:, k] * free[:, k]
                C = passed[:, :, None] * Y
                D = -passed[:, :, None] * inverse * passed[:, None, :]
                D[:, drift, drift] += free[:, k]
        if len(members):
            out[fits] = target_variances(M, self.criterion.targets, np.zeros(out.shape[1]))[0]
        return out, windows
