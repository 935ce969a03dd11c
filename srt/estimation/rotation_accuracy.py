"""Accuracy of the rotations that a fixture executed: the angles that the gyros measured against the nominal ones.

No estimator uses the nominal angles, as the gyros measure what was executed. They show a wrong label, or a fixture that
is less accurate than stated.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import bdtrc, ndtr, ndtri

from srt.model.rotations import rotation_vector
from srt.result.verdict import MISFIT_PROBABILITY
from srt.sensor_errors import GROUP_SLICES
from srt.sequences.manoeuvres import end_attitude

if TYPE_CHECKING:
    from srt.estimation.error_sources import UnmodelledErrors
    from srt.estimation.solver_result import SolverResult
    from srt.model.table1 import RotationSequence
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array

SIGMAS: Final = 6.0
"""Largest rotation error, in sigma, that is consistent with a label (false alarms: p = 1e-9)."""
_ALIKE: Final = 4.0
"""Largest error that is part of the scatter of the others, in its sigma by the median."""
_FEWEST: Final = 6
"""Fewest rotations that show a scatter; it is then known to 30 %."""


def scatter_ratio(error: Array, sigma: Array | float) -> float:
    """Scatter of errors over their 1-sigma, where more than half of them exceed it by the median; otherwise 1.

    A wrong angle, or several, do not change a median, and are not part of the scatter.

    Parameters
    ----------
    error : ndarray, shape (n,)
    sigma : array_like, shape (n,) or ()
        As stated.
    """
    size, n = np.sort(np.abs(error) / sigma), len(error)
    if n < _FEWEST:
        return 1.0
    middle = (n - 1) // 2
    by_chance = float(bdtrc(n - middle - 1, n, 2.0 * ndtr(-size[middle])))
    if by_chance >= MISFIT_PROBABILITY:
        return 1.0
    alike = size[size <= _ALIKE * size[middle] / ndtri(0.75)]
    return max(1.0, float(np.sqrt(np.mean(alike**2))))


class ExecutedRotations:
    """Rotations of a test on a fixture as the calibrated gyros measured them; without one there are none.

    Parameters
    ----------
    data : PreparedRecording
    result : SolverResult
    sigma : ndarray, shape (27,)
        Standard deviations of the parameters.

    Attributes
    ----------
    stated, excess : float, rad
        Accuracy of the angles, and what they show beyond it.
    """

    def __init__(self, data: PreparedRecording, result: SolverResult, sigma: Array) -> None:
        fixture, U = data.recording.fixture, result.U
        self._labels = data.labels
        self._turns: list[tuple[int, RotationSequence, Array]] = []
        self.stated, self.excess, self._alignment = 0.0, 0.0, 0.0
        if fixture is None or result.status == "outside_model":
            return
        self.stated, self._alignment = fixture.rotation_sigma_rad, fixture.alignment_sigma_rad
        for k, sequence in enumerate(data.catalogue):
            if sequence is not None:
                nominal = U @ end_attitude(sequence) @ U.T
                off = U.T @ rotation_vector((nominal.T @ result.end_attitude[k])[None])[0]
                self._turns.append((k, sequence, off))
        single = [(k, sequence, off) for k, sequence, off in self._turns if len(sequence.rotations) == 1]
        along = np.array([off @ sequence.axes[0] for _, sequence, off in single])
        angle = np.array([sequence.angles_rad[0] for _, sequence, _ in single])
        turning_s = np.diff(data.rotation[[k for k, *_ in single]], axis=1)[:, 0] * data.recording.nominal_interval_s
        scale = max(float(sigma[GROUP_SLICES[group]].max()) for group in ("gyro_scale", "gyro_asymmetry"))
        noise = np.hypot(float(data.noise.gyro_white.max()) * np.sqrt(turning_s), scale * angle)
        expected = np.hypot(self.stated, np.hypot(noise, result.unmodelled.rotation))
        ratio = scatter_ratio(along, expected)
        if ratio > 1.0:
            self.excess = math.sqrt(ratio**2 - 1.0) * float(np.median(expected))

    def wrong_angles(self, excess: UnmodelledErrors) -> tuple[str, ...]:
        """Sentences about sequences whose measured rotation contradicts the label, one for each.

        Their error is above six times the sigma of the fixture, with what it has beyond its stated accuracy: that of
        the rotations or of ``excess``.
        """
        rotation = math.hypot(self.stated, max(self.excess, excess.angle))
        alignment = math.hypot(self._alignment, excess.alignment)
        said = []
        for k, sequence, off in self._turns:
            # Every leg has its own error; about a misaligned axis a turn ends up to twice the misalignment away.
            legs = len(sequence.rotations)
            if np.linalg.norm(off) <= SIGMAS * math.hypot(math.sqrt(legs) * rotation, 2.0 * alignment):
                continue
            title = self._labels[k].title[0].upper() + self._labels[k].title[1:]
            if legs == 1:
                angle = float(sequence.angles_rad[0])
                done = angle + float(off @ sequence.axes[0])
                said.append(
                    f"{title} turned by {math.degrees(done):.2f}° where its label has {math.degrees(angle):.0f}°: "
                    "the gyros measure what it did turn, but check the label."
                )
            else:
                said.append(
                    f"{title} ends {math.degrees(float(np.linalg.norm(off))):.2f}° from where its rotations lead: one "
                    "of them was not turned by its nominal angle; the gyros measure what it did turn, but check the "
                    "label."
                )
        return tuple(said)
