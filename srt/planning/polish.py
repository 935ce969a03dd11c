"""Single sequences of a plan exchanged by the covariance of the whole test, drift as one process over all of it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.noise.bias_instability import correlation_times, flicker_covariance
from srt.planning.information import N_ROWS

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.planning.selection import Judge, Pool
    from srt.types import Array, Indices


_SHORTLIST: Final = 16
_POWER: Final = 8.0
_MOST_PASSES: Final = 4
_WORTHWHILE: Final = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class WholeTest:
    """The accuracy of sequences in their order, and the exchange of single ones by it.

    Attributes
    ----------
    judge : Judge
    pool : Pool
    total_s : float
        Time for everything, s.
    """

    judge: Judge
    pool: Pool
    total_s: float

    def borders(self, which: Indices, windows_s: Array) -> Array:
        """Borders of start windows, turns and end windows, shape (n, 4), s."""
        signatures = self.judge.signatures
        lengths = np.stack([windows_s[:, 0], signatures.own_s[which], windows_s[:, 1]], axis=1)
        begins = np.concatenate([[0.0], np.cumsum(lengths[:-1].sum(axis=1) + self._moves(which))])
        inner = np.concatenate([np.zeros((len(which), 1)), np.cumsum(lengths, axis=1)], axis=1)
        return np.asarray(begins[:, None] + inner)

    def _moves(self, which: Indices) -> list[float]:
        signatures = self.judge.signatures
        chosen = [signatures.candidates[k] for k in which.tolist()]
        return [signatures.stand.move_s(a.end_deg, b.start_deg) for a, b in pairwise(chosen)]

    def ratio(self, which: Indices, windows_s: Array) -> float:
        """Power mean of sigma over its target: near the largest, but with a slope where many are as large."""
        s, n = self.judge.signatures, len(which)
        c = s.conditions
        R = np.zeros((n, N_ROWS, n, N_ROWS))
        blocks = s.covariances(windows_s[:, 0], windows_s[:, 1], which)
        R[np.arange(n), :, np.arange(n)] = sum(
            part for name, part in blocks.items() if not name.endswith("_bias_instability")
        )
        borders = self.borders(which, windows_s)
        K = flicker_covariance(borders[:, :3].ravel(), borders[:, 1:].ravel(), correlation_times(float(borders[-1, 3])))
        K = K.reshape(n, 3, n, 3)
        for floor, effect, part in (
            (c.gyro_instability, s.by_bias[which], K),
            (c.accel_instability, s.by_force[which], K[:, ::2, :, ::2]),
        ):
            if floor > 0.0:
                R += floor**2 * np.einsum("kiac,kilj,ljbc->kalb", effect, part, effect, optimize=True)
        flat = R.reshape(n * N_ROWS, -1)
        d = 1.0 / np.sqrt(np.diag(flat))
        L = np.linalg.cholesky(flat * np.outer(d, d))
        rows = np.linalg.solve(L, (s.H[which].reshape(n * N_ROWS, -1) * self.judge.scale) * d[:, None])
        M = self.judge.prior + rows.T @ rows
        g = np.diag(self.judge.inverse(M))[self.judge.targets]
        return float(np.sqrt(g.max() * np.mean((g / g.max()) ** _POWER) ** (1.0 / _POWER)))

    def filled(self, which: Indices, windows_s: Array) -> Array | None:
        """Windows made longer or shorter alike so that the test fills its time; None if it cannot."""
        budget = self.total_s - float(self.judge.signatures.own_s[which].sum()) - sum(self._moves(which))
        return self.judge.filled(windows_s, budget)

    def improved(
        self, which: Indices, windows_s: Array, progress: Callable[[], None] | None = None
    ) -> tuple[Indices, Array]:
        """Exchange sequences one by one while the largest sigma over its target falls."""
        now = self.ratio(which, windows_s)
        for _ in range(_MOST_PASSES):
            before = now
            for i in range(len(which)):
                for k, windows in self._shortlist(which, windows_s, i):
                    trial = which.copy()
                    trial[i] = k
                    changed = windows_s.copy()
                    changed[i] = windows
                    full = self.filled(trial, changed)
                    if full is None:
                        continue
                    value = self.ratio(trial, full)
                    if value < now * (1.0 - _WORTHWHILE):
                        which, windows_s, now = trial, full, value
            if progress is not None:
                progress()
            if now > before * (1.0 - 2.0 * _WORTHWHILE):
                break
        return which, windows_s

    def _shortlist(self, which: Indices, windows_s: Array, i: int) -> list[tuple[int, Array]]:
        """Sequences of the pool that are worth trying in a place, by the slope of the additive criterion."""
        rest = np.delete(np.arange(len(which)), i)
        M = self.judge.prior + self.judge.information(which[rest], windows_s[rest]).sum(axis=0)
        scale = windows_s.mean() / self.pool.windows_s.mean()
        windows = np.clip(scale * self.pool.windows_s, self.judge.shortest_s, self.judge.longest_s)
        added = M + self.judge.information(self.pool.which, windows)
        g = self.judge.variances(added)
        largest = g.max(axis=1)
        worst = largest * np.mean((g / largest[:, None]) ** _POWER, axis=1) ** (1.0 / _POWER)
        cost = windows.sum(axis=1) + self.judge.signatures.own_s[self.pool.which]
        # Per time, as a longer sequence takes time from all others.
        value = 0.5 * np.log(worst) + 0.5 * cost / self.total_s
        order = np.argsort(value)
        return [
            (int(self.pool.which[j]), windows[j]) for j in order[:_SHORTLIST].tolist() if self.pool.which[j] != which[i]
        ]
