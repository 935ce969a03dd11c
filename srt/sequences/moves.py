"""Moves between the sequences of a recording: each is a free turn from an end window to the next start window.

The gyros measure a move as they measure a sequence. A move may have several rotations, stops, or a slip. A gap is never
crossed, and where recordings were put end to end nothing turns: neither is a move.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from srt.recording.recording import SequenceLabel
from srt.sequences.manoeuvres import angles_between
from srt.sequences.stationary_windows import MIN_TURN_RAD
from srt.sequences.window_means import LEAST_SAMPLES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.recording.recording import Recording


def recorded_moves(recording: Recording, labels: Iterable[SequenceLabel]) -> tuple[SequenceLabel, ...]:
    """Free turns between successive sequences on a fixture, in the order of time.

    Parameters
    ----------
    labels : iterable of SequenceLabel
        Sequences, and free turns that the user labelled; there is no move where one of these is.

    Returns
    -------
    tuple of SequenceLabel
        Empty without a fixture.
    """
    ordered = sorted(labels, key=lambda label: label.start_static_s)
    if recording.fixture is None:
        return ()
    return tuple(
        SequenceLabel(before.end_static_s, after.start_static_s)
        for before, after in pairwise(ordered)
        if before.id is not None and after.id is not None and _are_next(before, after)
        if _is_move(recording, before, after)
    )


def _are_next(before: SequenceLabel, after: SequenceLabel) -> bool:
    """True if no sequence between the two was left out."""
    return before.number is None or after.number is None or after.number == before.number + 1


def _is_move(recording: Recording, before: SequenceLabel, after: SequenceLabel) -> bool:
    """True if the unit turns between two sequences, and all samples of it are recorded."""
    if before.pose or after.pose:
        return False
    first, last = (recording.window_indices(*w) for w in (before.end_static_s, after.start_static_s))
    if min(first.stop - first.start, last.stop - last.start) < LEAST_SAMPLES or last.start <= first.stop:
        return False
    if (recording.gaps_inside((first.start, last.stop)) >= 0).any():
        return False
    angles = angles_between(recording, (first.start, first.stop), (last.start, last.stop))
    return float(np.linalg.norm(angles.sum(axis=0))) > MIN_TURN_RAD
