"""Exchange algorithm: replaces single sequences of a plan, judged by the covariance of the whole test.

Here, unlike while sequences are chosen, bias instability is one process over the whole test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from srt.planning.information import equilibrated_inverse
from srt.planning.prediction import whole_covariance
from srt.planning.selection import power_mean

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
    total_s : float
        Length of the whole test, s.
    """

    criterion: AccuracyCriterion
    pool: CandidatePool
    total_s: float

    def ratio(self, which: Indices, windows_s: Array) -> float:
        """Power mean of sigma over target: close to the largest, but differentiable where several are as large."""
        R, _, _ = whole_covariance(self.criterion.signatures, which, windows_s)
        d = 1.0 / np.sqrt(np.diag(R))
        root = cholesky(R * np.outer(d, d), lower=True, check_finite=False)
        H = (self.criterion.signatures.H[which].reshape(len(R), -1) * self.criterion.scale) * d[:, None]
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
