"""Nominal attitudes of sequences on the fixture, and the prior of the mounting."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.error_sources import NO_ERRORS
from srt.model.rotations import rotation_matrix, rotation_vector
from srt.sequences.preparation import nominal_attitude, sequence_of_label

if TYPE_CHECKING:
    from srt.estimation.error_sources import UnmodelledErrors
    from srt.model.table1 import RotationSequence
    from srt.recording.recording import Fixture, SequenceLabel
    from srt.types import Array

_ALONG: Final = 1e-9
"""Largest component of a nominal rotation axis across an axis of the fixture: rounding of products of rotations."""
_MOUNTING_LIMIT: Final = 5.0
"""If MARS is rotated from its stated mounting by more sigmas of the fixture than this, the prior follows the data."""


def pose_nominal(label: SequenceLabel) -> Array:
    """Nominal start attitude C_nom of a label, shape (3, 3)."""
    sequence = sequence_of_label(label)
    assert sequence is not None
    return nominal_attitude(sequence)


def nominal_start(sequence: RotationSequence | None) -> Array | None:
    """Nominal start attitude C_nom (3, 3); None if it needs IMU z along the outer axis, which no fixture can do."""
    if sequence is None or sequence.along_outer[-1] == "z":
        return None
    return nominal_attitude(sequence)


@cache
def nominal_end(sequence: RotationSequence | None) -> Array | None:
    """Nominal attitude (3, 3) after the rotations of a sequence, if all are about an axis of the fixture."""
    C = nominal_start(sequence)
    if C is None or sequence is None:
        return None
    for axis, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        across = np.cross(axis, np.stack([[0.0, 0.0, 1.0], C[1]]))  # inner and outer axis
        if np.linalg.norm(across, axis=1).min() > _ALONG:
            return None
        C = C @ rotation_matrix(axis * angle)
    return C


def mounting_limit(fixture: Fixture, excess: UnmodelledErrors = NO_ERRORS) -> float:
    """Largest rotation of U by the errors of the fixture's axes and verticals, rad."""
    return _MOUNTING_LIMIT * math.hypot(
        fixture.alignment_sigma_rad, fixture.rotation_sigma_rad, excess.alignment, excess.angle
    )


def mounting_prior(fixture: Fixture | None, U: Array, excess: UnmodelledErrors = NO_ERRORS) -> tuple[Array, str]:
    """Prior mean of U (nominal, or the estimate if MARS is clearly rotated from the mounting), and a warning.

    ``excess`` is the error of the fixture beyond the stated one.
    """
    if fixture is None:
        return U, ""
    rotation = float(np.linalg.norm(rotation_vector(U[None])))
    if rotation <= mounting_limit(fixture, excess):
        return np.eye(3), ""
    return U, (
        f"The gyro axes are rotated by {rotation * 1e3:.3g} mrad from the stated mounting: the prior of the "
        "mounting was centred on the orientation estimated from the rotations."
    )
