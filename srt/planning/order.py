"""Moves between the sequences of a test, and the angles of the fixture at which they are short."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.planning.candidates import Candidate
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array


def moves_between(candidates: Sequence[Candidate], fixture: FixtureKinematics) -> Array:
    """Times from the end of each of m sequences to the start window of each, shape (m, m), s.

    Where several angles within the travel give a start attitude, the nearest pair counts.
    """
    ways = [_ways(candidate, fixture) for candidate in candidates]
    # Many sequences begin or end at the same angles.
    starts = [tuple({way.start_deg: None for way in own}) for own in ways]
    ends = [tuple({way.end_deg: None for way in own}) for own in ways]
    times = {
        (end, start): min(fixture.move_s(a, b) for a in end for b in start)
        for end in set(ends)
        for start in set(starts)
    }
    return np.array([[times[end, start] for start in starts] for end in ends])


def nearest_angles(candidates: Sequence[Candidate], fixture: FixtureKinematics) -> tuple[tuple[Candidate, ...], float]:
    """Sequences in their order at the angles that make the moves shortest, and the time of the moves, s.

    The angles are the shortest path through the layers of alternatives.
    """
    ways = [_ways(candidate, fixture) for candidate in candidates]
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


def _ways(candidate: Candidate, fixture: FixtureKinematics) -> tuple[Candidate, ...]:
    return candidate.alternatives(fixture) or (candidate,)
