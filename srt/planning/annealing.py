"""Search for the sequences of a test, their order and their windows, by simulated annealing.

Every step tries a few random changes of the test. The fast model (:mod:`srt.planning.drift_chain`) chooses the best of
them, and the covariance of the whole test (:func:`srt.planning.prediction.variances_of_test`) decides: a better test is
kept, a worse one with a probability that decreases with the loss and with time. Changes are of the order as well as of
the sequences: drift makes the comparison of sequences far apart inaccurate, which moves alone would not show.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.planning.drift_chain import MOST_STEPS, DriftChain
from srt.planning.prediction import variances_of_test
from srt.ranking import significant

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.types import Array, Indices

TRIALS: Final = 10000
"""Changes that are tried for one plan."""
_BATCH: Final = 8
"""Changes in one step."""
_TEMPERATURE: Final = 0.012
"""First temperature, of the logarithm of the variance: a loss of 0.6 % of sigma is accepted with probability 1/e."""
_DOUBT: Final = 4.0, 0.002
"""Loss by the fast model up to which a test is computed exactly: in temperatures, and at least."""
_ORDERS: Final = 8
"""Random orders of an initial selection, of which the best is taken."""
_BEST: Final = 60
"""Members at the head of the pool, of which every other new sequence is one."""
_LEAST: Final = 2
"""Smallest number of sequences."""
_SEED: Final = 2020
"""Seed of the random changes: a task has one plan."""

_ORDER: Final = {"shift": 0.41, "swap": 0.16, "reverse": 0.16, "lengthen": 0.27}
"""Kinds of changes that keep the sequences, and their probabilities."""
_SEQUENCES: Final = {name: 0.7 * share for name, share in _ORDER.items()} | {"replace": 0.3}
"""The same where sequences may be replaced."""
_RESIZED: Final = 0.07
"""Probability of a step in which a sequence is added, and of one in which one is taken out."""


class Schedule(NamedTuple):
    """Sequences of a test in their order.

    Attributes
    ----------
    members : tuple of int
        Positions in the pool.
    steps : tuple of int
        Lengthening of the windows, in steps of :class:`DriftChain`.
    """

    members: tuple[int, ...]
    steps: tuple[int, ...]


class _Walk:
    """Test that changes step by step.

    Attributes
    ----------
    value : float
        Logarithm of its worst variance over squared target.
    correction : ndarray, shape (q,)
        Its variances over those of the fast model.
    best : tuple
        Value, test and windows of the best so far.
    """

    def __init__(self, test: Schedule, value: float, correction: Array, windows_s: Array) -> None:
        self.test, self.value, self.correction = test, value, correction
        self.best = value, test, windows_s


class AnnealedSearch:
    """Search among tests of members of a pool.

    Parameters
    ----------
    most : int
        Largest number of sequences; 0: the sequences stay what they are.
    share : float
        Share of ``TRIALS`` that is tried.
    tell : callable
        Called at every step.
    """

    def __init__(
        self, chain: DriftChain, most: int, share: float = 1.0, tell: Callable[[], None] = lambda: None
    ) -> None:
        self.chain, self.most, self.tell = chain, most, tell
        self._steps = math.ceil(share * TRIALS / _BATCH)
        kinds = _SEQUENCES if most else _ORDER
        self._kinds, self._borders = tuple(kinds), np.cumsum(list(kinds.values()))
        self._rng = np.random.default_rng(_SEED)

    def best(self, selections: Sequence[Indices]) -> tuple[Schedule, Array] | None:
        """Best test from several initial selections, and its windows, shape (n,), s; None if none of them fits."""
        ordered = [each[1] for each in map(self._ordered, selections) if each is not None]
        if not ordered:
            return None
        walks = [_Walk(test, *self._exact(test)) for test in ordered]
        steps, starts = self._steps, len(walks)
        for step in range(steps):
            self.tell()
            # The worst of the walks ends after equal parts of the time.
            if len(walks) > starts - starts * step // steps:
                walks.remove(max(walks, key=lambda walk: significant(walk.best[0])))
            self._step(walks[step % len(walks)], _TEMPERATURE * (1.0 - step / steps))
        _, test, windows = min((walk.best for walk in walks), key=lambda best: significant(best[0]))
        return test, windows

    def _step(self, walk: _Walk, heat: float) -> None:
        """Try random changes of a test, and keep the best of them or the test."""
        resized, n = self._rng.random(), len(walk.test.members)
        kind = None
        if resized < _RESIZED and n > _LEAST:
            kind = "remove"
        elif resized > 1.0 - _RESIZED and n < self.most:
            kind = "add"
        fast, trial = self._promising([self._changed(walk.test, kind) for _ in range(_BATCH)], walk.correction)
        if fast > walk.value + _DOUBT[0] * heat + _DOUBT[1]:
            return
        value, correction, windows = self._exact(trial)
        if value < walk.value - heat * math.log(self._rng.random()):
            walk.test, walk.value, walk.correction = trial, value, correction
            walk.best = min(walk.best, (value, trial, windows), key=lambda best: best[0])

    def _ordered(self, selection: Indices) -> tuple[float, Schedule] | None:
        """Best of some orders of a selection, random but for one, shortened until it fits; None if nothing does."""
        chosen = selection.tolist()
        while chosen:
            orders = [self._short_order(chosen), *(self._rng.permutation(chosen).tolist() for _ in range(_ORDERS))]
            tests = [Schedule(tuple(order), (0,) * len(order)) for order in orders]
            best = self._promising(tests, np.ones(len(self.chain.criterion.targets)))
            if math.isfinite(best[0]):
                return best
            if not self.most:
                return None
            chosen.pop()
        return None

    def _short_order(self, chosen: list[int]) -> list[int]:
        """Order with short moves: the nearest sequence follows, from the first with which the whole is shortest."""
        moves, paths = np.round(self.chain.moves_s[np.ix_(chosen, chosen)], 6), []
        for first in range(len(chosen)):
            path, left = [first], [k for k in range(len(chosen)) if k != first]
            while left:
                path.append(left.pop(int(np.argmin(moves[path[-1], left]))))
            paths.append(path)
        best = min(paths, key=lambda path: significant(float(moves[path[:-1], path[1:]].sum())))
        return [chosen[k] for k in best]

    def _promising(self, trials: list[Schedule], correction: Array) -> tuple[float, Schedule]:
        """Best of some tests with equally many sequences by the fast model, with corrected variances."""
        members, steps = (np.array(each) for each in zip(*trials, strict=True))
        values = np.round(np.log((correction * self.chain.variances(members, steps)[0]).max(axis=1)), 6)
        k = int(np.argmin(values))
        return float(values[k]), trials[k]

    def _exact(self, test: Schedule) -> tuple[float, Array, Array]:
        """Logarithm of the worst variance by the whole covariance, its ratio to the fast model, and the windows, s."""
        members, steps = np.array([test.members]), np.array([test.steps])
        fast, windows = self.chain.variances(members, steps)
        chain = self.chain
        moves = chain.moves_s[members[0, :-1], members[0, 1:]]
        exact = variances_of_test(
            chain.criterion, chain.which[members[0]], np.repeat(windows[0, :, None], 2, axis=1), moves
        )
        return round(math.log(exact.max()), 6), exact / fast[0], windows[0]

    def _changed(self, test: Schedule, kind: str | None) -> Schedule:
        """Test with one random change, of a kind that keeps the number of sequences for None."""
        rng, n = self._rng, len(test.members)
        rows = list(zip(*test, strict=True))
        kind = kind or self._kinds[int(np.searchsorted(self._borders, rng.random() * self._borders[-1]))]
        i, j = (int(k) for k in rng.integers(n, size=2))
        if kind == "shift":
            rows.insert(j, rows.pop(i))
        elif kind == "swap":
            rows[i], rows[j] = rows[j], rows[i]
        elif kind == "reverse":
            i, j = sorted((i, j))
            rows[i : j + 1] = rows[i : j + 1][::-1]
        elif kind == "lengthen":
            longer = rows[i][1] + (1 if rng.random() < 0.5 else -1)
            rows[i] = rows[i][0], min(max(longer, 0), MOST_STEPS)
        elif kind == "replace":
            rows[i] = self._any_member(), rows[i][1]
        elif kind == "remove":
            rows.pop(i)
        elif kind == "add":
            rows.insert(j, (self._any_member(), 0))
        return Schedule(tuple(member for member, _ in rows), tuple(steps for _, steps in rows))

    def _any_member(self) -> int:
        m = len(self.chain.which)
        return int(self._rng.integers(m if self._rng.random() < 0.5 else min(m, _BEST)))
