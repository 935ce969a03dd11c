"""Opening of a recording for joint estimation: its sequences, its moves between them, and poses without a rotation.

A move that contradicts the other measurements is left out: the unit was lifted off the fixture, or the gyros saturated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtrc

from srt.estimation.goodness_of_fit import CONTRADICTION_PROBABILITY
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.srt_measurements import SrtProcessor
from srt.exceptions import DataError
from srt.joint.joint_model import JointModel
from srt.model.rotations import rotation_vector
from srt.ranking import rounded
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.moves import recorded_moves
from srt.sequences.stationary_windows import find_turns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.estimation.options import Options
    from srt.recording.recording import Recording, SequenceLabel
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


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
    whole, window = recording.gaps_inside([(first.start, last.stop), (first.start, first.stop)]).tolist()
    return bool(whole >= 0 and window < 0)


def _end_is_missing(recording: Recording, label: SequenceLabel) -> bool:
    window = recording.window_indices(*label.end_static_s)
    return bool(window.stop - window.start < 2)


_GROSS_RAD: Final = 0.1
"""Largest difference between the measured and the nominal rotation of a move, rad; it allows for the errors of the
fixture and of the initial estimate over one full turn."""


def without_gross_moves(
    data: PreparedRecording, options: Options, first: tuple[SensorErrors, Array]
) -> PreparedRecording:
    """Recording without the moves whose measured end differs from the nominal attitude on the fixture.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    first : SensorErrors and ndarray, shape (3, 3)
        Initial estimate of the sensor errors and of U.
    """
    if not data.moves or data.nominal is None:
        return data
    errors, U = first
    measured = SrtProcessor(data, options).process(errors, U=U).integrals.C_end
    started = {int(data.start[k]): data.nominal[k] for k in np.flatnonzero(~data.is_move).tolist()}
    reasons = {}
    for k in np.flatnonzero(data.is_move & data.placed).tolist():
        nominal = U @ data.nominal[k].T @ started[int(data.end[k])] @ U.T
        off = float(np.linalg.norm(rotation_vector((nominal.T @ measured[k])[None])))
        if off > _GROSS_RAD:
            reasons[k] = f"it ends {np.degrees(off):.1f}° from the start attitude of the next sequence"
    return data.without_moves(reasons) if reasons else data


def contradicting_move(tests: Sequence[tuple[float, int]], is_move: Mask) -> dict[int, str]:
    """Move that contradicts the other measurements, with the reason; empty if none does.

    Parameters
    ----------
    tests : sequence of (float, int)
        Chi-square of each sequence and move as predicted from all others, and its degrees of freedom.
    is_move : ndarray of bool, shape (K,)

    Notes
    -----
    An error of the noise model enlarges all chi-squares: they are divided by their median, if it is above one. A move
    is left out only if no sequence contradicts the others by more.
    """
    chi_square, freedom = (np.array(values, dtype=np.float64) for values in zip(*tests, strict=True))
    tested = freedom > 0
    if not (is_move & tested).any():
        return {}
    share = chi_square / np.maximum(freedom, 1.0)
    scale = max(1.0, float(np.median(share[tested])))
    excess = np.where(tested, (chi_square / scale - freedom) / np.sqrt(2.0 * np.maximum(freedom, 1.0)), -np.inf)
    # Where one redundant rotation tests all alike, a move contradicts as much as a sequence.
    worst = len(excess) - 1 - int(np.argmax(rounded(excess)[::-1]))
    probability = float(chdtrc(freedom[worst], chi_square[worst] / scale))
    if not is_move[worst] or probability > CONTRADICTION_PROBABILITY:
        return {}
    return {
        worst: f"it contradicts the other measurements (chi-square {chi_square[worst]:.3g} for {freedom[worst]:.0f} "
        "degrees of freedom)"
    }
