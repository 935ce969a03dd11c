"""Timetable of a planned test: windows, rotations and moves on the clock, from the first window on."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.planning.candidates import Candidate
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array


class ScheduledSequence(NamedTuple):
    """Times of one sequence of a plan, s; zero is the start of the first window of the test.

    Attributes
    ----------
    start_static_s, end_static_s : (float, float)
        Start and end of the two stationary windows.
    """

    start_static_s: tuple[float, float]
    end_static_s: tuple[float, float]


def timetable(
    candidates: Sequence[Candidate], windows_s: Array, fixture: FixtureKinematics
) -> tuple[ScheduledSequence, ...]:
    """Times of sequences that are run in this order, if no time is lost."""
    moves = [fixture.move_s(before.end_deg, after.start_deg) for before, after in pairwise(candidates)]
    between = np.array([c.between_windows_s(fixture) for c in candidates])
    borders = window_borders(between, windows_s, np.array(moves)).tolist()
    return tuple(ScheduledSequence((a, b), (c, d)) for a, b, c, d in borders)


def window_borders(between_s: Array, windows_s: Array, moves_s: Array) -> Array:
    """Start and end of the start window, then of the end window, of n sequences, shape (n, 4), s.

    Parameters
    ----------
    between_s : ndarray, shape (n,), s
        Time between the windows of each sequence.
    windows_s : ndarray, shape (n, 2), s
        Length of the start and of the end window.
    moves_s : ndarray, shape (n - 1,), s
        Time between the sequences.
    """
    # Start of the first window; then each sequence is its windows, what lies between them, and the move to the next.
    steps = np.column_stack([windows_s[:, 0], between_s, windows_s[:, 1], np.append(moves_s, 0.0)])
    return np.concatenate([[0.0], np.cumsum(steps)])[:-1].reshape(-1, 4)


def clock(seconds: float) -> str:
    """Format a time as minutes and seconds."""
    return f"{int(seconds + 0.5) // 60}:{int(seconds + 0.5) % 60:02d}"
