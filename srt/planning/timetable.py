"""Timetable of a planned test: windows, rotations and moves on the clock, from the first window on."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from srt.planning.candidates import Candidate
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array


@dataclass(frozen=True, slots=True)
class ScheduledSequence:
    """Times of one sequence of a plan, s; zero is the start of the first window of the test.

    Attributes
    ----------
    start_static_s, end_static_s : (float, float)
        Start and end of the two stationary windows.
    move_s : float
        Duration of the move to the start attitude, without waits.
    """

    start_static_s: tuple[float, float]
    end_static_s: tuple[float, float]
    move_s: float


def timetable(
    candidates: Sequence[Candidate], windows_s: Array, fixture: FixtureKinematics
) -> tuple[ScheduledSequence, ...]:
    """Times of sequences that are run in this order, if no time is lost."""
    waits = fixture.pause_s + fixture.settle_s
    moves = [fixture.move_s(before.end_deg, after.start_deg) for before, after in pairwise(candidates)]
    between = np.array([c.between_windows_s(fixture) for c in candidates])
    borders = window_borders(windows_s, between, moves).tolist()
    return tuple(
        ScheduledSequence((a, b), (c, d), move)
        for (a, b, c, d), move in zip(borders, [0.0, *(each - waits for each in moves)], strict=True)
    )


def window_borders(windows_s: Array, between_windows_s: Array, moves_s: ArrayLike) -> Array:
    """Start and end of the start window, then of the end window, of every sequence, shape (n, 4), s.

    Parameters
    ----------
    windows_s : ndarray, shape (n, 2)
        Lengths of the start and of the end window.
    between_windows_s : ndarray, shape (n,)
        Time between the two windows of a sequence.
    moves_s : array_like, shape (n - 1,)
        Time between a sequence and the next.
    """
    lengths = np.stack([windows_s[:, 0], between_windows_s, windows_s[:, 1]], axis=1)
    begins = np.concatenate([[0.0], np.cumsum(lengths[:-1].sum(axis=1) + np.asarray(moves_s))])
    inner = np.concatenate([np.zeros((len(lengths), 1)), np.cumsum(lengths, axis=1)], axis=1)
    return np.asarray(begins[:, None] + inner)


def clock(seconds: float) -> str:
    """Format a time as minutes and seconds."""
    return f"{int(seconds + 0.5) // 60}:{int(seconds + 0.5) % 60:02d}"
