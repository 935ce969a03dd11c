"""Executed rotations against the catalogue's: the gyros measure what was turned; a wrong angle is named, not fatal."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.rotations import rotation_matrix, rotation_vector

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.model.table1 import Sequence
    from srt.playback_data import PlaybackData

    Array = NDArray[np.float64]

_SIGMAS: Final = 6.0


@cache
def end_attitude(sequence: Sequence) -> Array:
    """Nominal C_End of a sequence, B_End to B_Strt, shape (3, 3), for IMU axes along the table's; read-only."""
    C = np.eye(3)
    for axis, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        C = C @ rotation_matrix(axis * angle)
    C.flags.writeable = False
    return C


def wrong_turns(data: PlaybackData, turned: Array, U: Array) -> tuple[str, ...]:
    """Name the sequences that were not turned as their labels say.

    Parameters
    ----------
    data : PlaybackData
    turned : ndarray, shape (K, 3, 3)
        C_End as the gyros measured it, B_End to B_Strt.
    U : ndarray, shape (3, 3)
        T to MARS components.

    Returns
    -------
    tuple of str
        One sentence for each turn that is off by more than six times what the fixture allows.
    """
    fixture = data.recording.fixture
    if fixture is None:
        return ()
    said = []
    for k, sequence in enumerate(data.catalogue):
        if sequence is None:
            continue
        nominal = U @ end_attitude(sequence) @ U.T
        off = rotation_vector((nominal.T @ turned[k])[None])[0]
        # Every leg has its own error; about a misaligned axis a turn ends up to twice the misalignment away.
        legs = len(sequence.rotations)
        allowed = _SIGMAS * math.hypot(math.sqrt(legs) * fixture.rotation_sigma_rad, 2.0 * fixture.alignment_sigma_rad)
        if np.linalg.norm(off) <= allowed:
            continue
        title = data.labels[k].title[0].upper() + data.labels[k].title[1:]
        if legs == 1:
            angle = float(sequence.angles_rad[0])
            done = angle + float(off @ U @ sequence.axes[0])
            said.append(
                f"{title} turned by {math.degrees(done):.2f}° where its label has {math.degrees(angle):.0f}°: "
                "the gyros measure what it did turn, but check the label."
            )
        else:
            said.append(
                f"{title} ends {math.degrees(float(np.linalg.norm(off))):.2f}° from where its rotations lead: one of "
                "them was not turned by its nominal angle; the gyros measure what it did turn, but check the label."
            )
    return tuple(said)
