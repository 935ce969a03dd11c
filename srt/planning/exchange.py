"""Exchange algorithm: replaces single sequences of a plan, judged by the covariance of the whole test.

Here, unlike while sequences are chosen, bias instability is one process over the whole test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from srt.noise.bias_instability import correlation_times, flicker_covariance
from srt.planning.information import N_ROWS, equilibrated_inverse
from srt.planning.selection import power_mean
from srt.planning.timetable import window_borders

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.planning.selection import AccuracyCriterion, CandidatePool
    from srt.types import Array, Indices


_SHORTLIST: Final = 16
"""Candidates tried in each place: their covariance over the whole test takes most of the time."""
_POWER: Final = 8.0
"""Power of the mean that stands for the largest variance: high enough to follow it, low enough to have a slope."""
_MOST_PASSES: Final = 4
"""Passes over all places at most; the search ends before when a pass gains too little."""
_LEAST_GAIN: Final = 2e-3
"""Relative decrease of sigma for which a sequence is exchanged."""


@dataclass(frozen=True, slots=True, eq=False)
class ExchangeSearch:
    """Accuracy of sequences in their order, and the exchange of single sequences by it.

    Attributes
    ----------
    criterion : AccuracyCriterion
    pool : CandidatePool
    total_s : float
        Length of the whole test, s.
    """

    criterion: AccuracyCriterion
    pool: CandidatePool
    total_s: float

    def borders(self, which: Indices, windows_s: Array) -> Array:
        """Start and end of both windows of every sequence, shape (n, 4), s."""
        between = self.criterion.signatures.between_windows_s[which]
        return window_borders(windows_s, between, self.criterion.signatures.moves_s(which))

    def ratio(self, which: Indices, windows_s: Array) -> float:
        """Power mean of sigma over target: close to the largest, but differentiable where several are as large."""
        s, n = self.criterion.signatures, len(which)
        c = s.conditions
        R = np.zeros((n, N_ROWS, n, N_ROWS))
        blocks = s.covariances(windows_s[:, 0], windows_s[:, 1], which, drift=False)
        R[np.arange(n), :, np.arange(n)] = sum(blocks.values())
        borders = self.borders(which, windows_s)
        K = flicker_covariance(borders[:, :3].ravel(), borders[:, 1:].ravel(), correlation_times(float(borders[-1, 3])))
        K = K.reshape(n, 3, n, 3)
        for floor, effect, part in (
            (c.gyro_instability, s.by_bias[which], K),
            (c.accel_instability, s.by_force[which], K[:, ::2, :, ::2]),
        ):
            if floor > 0.0:
                R += floor**2 * _through(effect, part)
        flat = R.reshape(n * N_ROWS, -1)
        d = 1.0 / np.sqrt(np.diag(flat))
        root = cholesky(flat * np.outer(d, d), lower=True, check_finite=False)
        H = (s.H[which].reshape(n * N_ROWS, -1) * self.criterion.scale) * d[:, None]
        rows = solve_triangular(root, H, lower=True, check_finite=False)
        g = np.diag(equilibrated_inverse(self.criterion.prior + rows.T @ rows))[self.criterion.targets]
        return float(np.sqrt(power_mean(g, _POWER)))

    def filled(self, which: Indices, windows_s: Array) -> Array | None:
        """Windows scaled by one factor so that the test fills its time; None if they do not fit."""
        signatures = self.criterion.signatures
        between = signatures.between_windows_s[which].sum() + signatures.moves_s(which).sum()
        return self.criterion.filled(windows_s, self.total_s - float(between))

    def improved(
        self, which: Indices, windows_s: Array, progress: Callable[[], None] | None = None
    ) -> tuple[Indices, Array]:
        """Exchange sequences one by one while the largest sigma over target decreases."""
        now, offer = self.ratio(which, windows_s), self._offer(which, windows_s)
        tried = 0
        for _ in range(_MOST_PASSES):
            before = now
            for i in range(len(which)):
                if tried == len(which):  # every place, since the last exchange
                    break
                begun, tried = now, tried + 1
                for k, windows in offer.shortlist(i):
                    if k == which[i]:
                        continue
                    trial = which.copy()
                    trial[i] = k
                    changed = windows_s.copy()
                    changed[i] = windows
                    full = self.filled(trial, changed)
                    if full is None:
                        continue
                    value = self.ratio(trial, full)
                    if value < now * (1.0 - _LEAST_GAIN):
                        which, windows_s, now = trial, full, value
                if now < begun:
                    offer, tried = self._offer(which, windows_s), 0
            if progress is not None:
                progress()
            if now > before * (1.0 - 2.0 * _LEAST_GAIN):
                break
        return which, windows_s

    def _offer(self, which: Indices, windows_s: Array) -> _Offer:
        """Candidates of the pool for the places of a selection."""
        scale = windows_s.mean() / self.pool.windows_s.mean()
        windows = np.clip(scale * self.pool.windows_s, self.criterion.shortest_s, self.criterion.longest_s)
        cost = windows.sum(axis=1) + self.criterion.signatures.between_windows_s[self.pool.which]
        own = self.criterion.information(which, windows_s)
        added = self.criterion.information(self.pool.which, windows)
        # A longer sequence takes time from all others: the variance grows in proportion.
        return _Offer(self.criterion, self.pool.which, windows, own, added, 0.5 * cost / self.total_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Offer:
    """Candidates of the pool with the windows that they would have in a selection.

    ``own`` and ``added`` are the information of the selected sequences and of the candidates; ``price`` is the
    logarithm of sigma that the time of a candidate costs.
    """

    criterion: AccuracyCriterion
    which: Indices
    windows_s: Array
    own: Array
    added: Array
    price: Array

    def shortlist(self, i: int) -> list[tuple[int, Array]]:
        """Candidates for one place, the best by the additive criterion first."""
        rest = self.criterion.prior + self.own.sum(axis=0) - self.own[i]
        worst = power_mean(self.criterion.variances(rest + self.added), _POWER)
        order = np.argsort(0.5 * np.log(worst) + self.price)[:_SHORTLIST]
        return [(int(self.which[j]), self.windows_s[j]) for j in order.tolist()]


def _through(effect: Array, covariance: Array) -> Array:
    """Covariance (n, 10, n, 10) of measurements from that of the biases (n, m, n, m), the same for the three axes.

    ``effect`` has shape (n, m, 10, 3). Two matrix products are ten times faster than one contraction of three factors.
    """
    n, m = effect.shape[:2]
    by_axis = effect.transpose(0, 3, 2, 1).reshape(n, 3 * N_ROWS, m)  # k, (c, a), i
    half = (by_axis @ covariance.reshape(n, m, n * m)).reshape(n, 3, N_ROWS, n, m)
    left = half.transpose(3, 0, 2, 1, 4).reshape(n, n * N_ROWS, 3 * m)  # l, (k, a), (c, j)
    right = effect.transpose(0, 3, 1, 2).reshape(n, 3 * m, N_ROWS)  # l, (c, j), b
    return np.asarray((left @ right).reshape(n, n, N_ROWS, N_ROWS).transpose(1, 2, 0, 3))
