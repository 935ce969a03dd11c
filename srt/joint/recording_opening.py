"""Opening of a recording for joint estimation: its sequences, its moves between them, and poses without a rotation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.estimation.initial_estimates import initial_estimate
from srt.exceptions import DataError
from srt.joint.joint_model import JointModel
from srt.joint.move_checks import without_gross_moves
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.moves import recorded_moves
from srt.sequences.plausibility import gap_inside
from srt.sequences.stationary_windows import find_turns

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.recording.recording import Recording, SequenceLabel


def open_joint_model(recording: Recording, options: Options) -> JointModel:
    """Open a recording for joint estimation, with the recorded moves between its sequences unless options exclude them.

    Raises
    ------
    DataError
        As :func:`srt.sequences.checked_preparation.prepare_checked`, and if no sequence has both stationary windows.
    """
    labels = recording.sequences or find_turns(recording)
    whole = tuple(s for s in labels if not _end_is_missing(recording, s))
    poses = tuple(s for s in labels if s.id is not None and (s not in whole or _rotation_is_incomplete(recording, s)))
    if not whole:
        raise DataError(
            "No sequence of the recording has both stationary windows: record at least one rotation to its end."
        )
    moves = () if options.ignore_moves else recorded_moves(recording, labels)
    data = prepare_checked(
        recording, whole, options.average, poses=poses if recording.fixture is not None else (), moves=moves
    )
    first = initial_estimate(data, options)
    return JointModel(without_gross_moves(data, options, first), options, first)


def _rotation_is_incomplete(recording: Recording, label: SequenceLabel) -> bool:
    """True if samples are missing after a complete start window."""
    first, last = recording.window_indices(*label.start_static_s), recording.window_indices(*label.end_static_s)
    lost = gap_inside(recording, slice(first.start, last.stop)).size > 0
    return lost and gap_inside(recording, first).size == 0


def _end_is_missing(recording: Recording, label: SequenceLabel) -> bool:
    window = recording.window_indices(*label.end_static_s)
    return bool(window.stop - window.start < 2)
