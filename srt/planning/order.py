"""Order of sequences with the shortest moves, and the angles of the fixture in that order."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.planning.candidates import Candidate
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array, Indices

_MOST_PASSES: Final = 100
"""Improvements of a path at most."""
_STARTS: Final = 6
"""Paths, the shortest by nearest neighbours, that are improved."""
_LEAST_GAIN_S: Final = 1e-9
"""Shortening that counts as an improvement, s: more than rounding."""
_LONGEST_RUN: Final = 3
"""Longest run of sequences that is shifted."""


def best_order(
    candidates: Sequence[Candidate], fixture: FixtureKinematics
) -> tuple[tuple[int, ...], tuple[Candidate, ...], float]:
    """Order sequences so that the moves between them are short.

    Parameters
    ----------
    fixture : FixtureKinematics
        Where several angles within the travel give a start attitude, the nearest are taken.

    Returns
    -------
    order : tuple of int
        Positions in ``candidates``.
    chosen : tuple of Candidate
        The sequences in that order, at the angles chosen.
    moves_s : float
        Time of pauses, moves and settling between the sequences, s.

    Notes
    -----
    This is a travelling-salesman problem, solved by local search. Paths by nearest neighbours start from every
    sequence; in the shortest of them, runs of sequences are shifted and reversed until nothing improves.
    """
    n = len(candidates)
    if n == 0:
        return (), (), 0.0
    ways = [c.alternatives(fixture) or (c,) for c in candidates]
    # Cost of a move: that between the nearest pair of angles. The angles are chosen consistently at the end.
    cost = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            if i != j:
                cost[i, j] = min(fixture.move_s(a.end_deg, b.start_deg) for a in ways[i] for b in ways[j])
    paths = sorted((_nearest(first, cost) for first in range(n)), key=lambda p: _length(p, cost))
    path = min((_improved(p, cost) for p in paths[:_STARTS]), key=lambda p: _length(p, cost))
    chosen, total = _angles([ways[i] for i in path], fixture)
    return tuple(path), chosen, total


def _nearest(first: int, cost: Array) -> list[int]:
    path, left = [first], set(range(len(cost))) - {first}
    while left:
        here = path[-1]
        path.append(min(sorted(left), key=lambda j: cost[here, j]))
        left.remove(path[-1])
    return path


def _length(path: Sequence[int], cost: Array) -> float:
    return float(cost[path[:-1], path[1:]].sum())


def _improved(path: list[int], cost: Array) -> list[int]:
    """Shift short runs of sequences and reverse runs while that shortens the path, the best change first."""
    changes = _changes(len(path))
    for _ in range(_MOST_PASSES):
        trials = np.array(path)[changes]
        lengths = cost[trials[:, :-1], trials[:, 1:]].sum(axis=1)
        best = int(np.argmin(lengths))
        if lengths[best] > _length(path, cost) - _LEAST_GAIN_S:
            return path
        path = trials[best].tolist()
    return path


@lru_cache(maxsize=16)
def _changes(n: int) -> Indices:
    """Orders of n positions after every change, the unchanged order first, shape (number of changes, n)."""
    path = list(range(n))
    out = [path]
    for size in range(1, _LONGEST_RUN + 1):
        for i in range(n - size + 1):
            run, rest = path[i : i + size], path[:i] + path[i + size :]
            out += [rest[:j] + run + rest[j:] for j in range(len(rest) + 1) if j != i]
    out += [path[:i] + path[i:j][::-1] + path[j:] for i in range(n) for j in range(i + 2, n + 1)]
    return np.array(out)


def _angles(ways: Sequence[Sequence[Candidate]], fixture: FixtureKinematics) -> tuple[tuple[Candidate, ...], float]:
    """Angles with the shortest moves along a path: shortest path through the layers of alternatives."""
    best: list[tuple[float, tuple[Candidate, ...]]] = [(0.0, (c,)) for c in ways[0]]
    for layer in ways[1:]:
        best = [
            min(
                ((t + fixture.move_s(line[-1].end_deg, c.start_deg), (*line, c)) for t, line in best),
                key=lambda pair: pair[0],
            )
            for c in layer
        ]
    total, line = min(best, key=lambda pair: pair[0])
    return line, total
