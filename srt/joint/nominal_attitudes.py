"""Nominal attitudes of sequences on the fixture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.rotations import rotation_matrix
from srt.sequences.preparation import nominal_attitude, sequence_of_label

if TYPE_CHECKING:
    from srt.model.table1 import RotationSequence
    from srt.recording.recording import SequenceLabel
    from srt.types import Array

_ALONG: Final = 1e-9
"""Largest component of a nominal rotation axis across an axis of the fixture: rounding of products of rotations."""


def pose_nominal(label: SequenceLabel) -> Array:
    """Nominal start attitude C_nom of a label."""
    sequence = sequence_of_label(label)
    assert sequence is not None
    return nominal_attitude(sequence)


def nominal_start(sequence: RotationSequence | None) -> Array | None:
    """Nominal start attitude C_nom; None if it needs IMU z along the outer axis, which the fixture cannot do."""
    if sequence is None or sequence.along_outer[-1] == "z":
        return None
    return nominal_attitude(sequence)


def nominal_end(C: Array | None, sequence: RotationSequence | None) -> Array | None:
    """Nominal attitude after the rotations of a sequence that starts at C, if all are about an axis of the fixture."""
    if C is None or sequence is None:
        return None
    for axis, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        across = np.cross(axis, np.stack([[0.0, 0.0, 1.0], C[1]]))  # inner and outer axis
        if np.linalg.norm(across, axis=1).min() > _ALONG:
            return None
        C = C @ rotation_matrix(axis * angle)
    return C
