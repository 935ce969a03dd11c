"""Accuracy of a running test: sigmas after each sequence, targets, and the repetition that helps most."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.registry import estimate
from srt.exceptions import DataError, InputError
from srt.model.table1 import SEQUENCES
from srt.planning.candidates import from_catalogue
from srt.planning.conditions import Conditions
from srt.planning.fixture_kinematics import AxisKinematics, FixtureKinematics
from srt.planning.next_sequence import known_information
from srt.planning.prediction import predict
from srt.sensor_errors import INDEX, N_PARAMETERS
from srt.sequences.recognition import labelled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.recording.recording import Recording, SequenceLabel
    from srt.result.calibration import Calibration
    from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class SequenceAccuracy:
    """Accuracy after a sequence.

    Attributes
    ----------
    sigma : ndarray, shape (27,), SI
        Infinite for parameters that are not observed yet.
    calibration : Calibration or None
        Result of the sequences so far; None if they support none.
    """

    sequence: str
    sigma: Array
    calibration: Calibration | None

    def shortfall(self, targets: Mapping[str, float]) -> tuple[str, float] | None:
        """Parameter with the largest ratio of sigma to target, and the ratio; None without targets."""
        if not targets:
            return None
        ratios = {name: float(self.sigma[INDEX[name]]) / wanted for name, wanted in targets.items()}
        worst = max(ratios, key=lambda name: ratios[name])
        return worst, ratios[worst]


def accuracy_after(
    recording: Recording, labels: tuple[SequenceLabel, ...], estimator: str = "auto"
) -> SequenceAccuracy:
    """Accuracy of a test after the given sequences.

    Parameters
    ----------
    labels : tuple of SequenceLabel
        Sequences so far.
    estimator : str
        Estimator of the final result: the targets are compared with its sigmas.
    """
    sigma = np.full(N_PARAMETERS, math.inf)
    try:
        found = estimate(labelled(recording, labels), estimator)
    except (DataError, InputError):
        return SequenceAccuracy(labels[-1].id or "", sigma, None)
    seen = found.observed
    sigma[seen] = found.sigma[seen]
    return SequenceAccuracy(labels[-1].id or "", sigma, found)


def best_repetition(
    recording: Recording, labels: tuple[SequenceLabel, ...], after: SequenceAccuracy, targets: Mapping[str, float]
) -> tuple[str, float] | None:
    """Sequence of Table 1 whose repetition brings the sigmas nearest to their targets, and the worst ratio after it.

    Parameters
    ----------
    labels : tuple of SequenceLabel
        Sequences so far; a repetition has windows as long as the last one.
    targets : mapping of str to float, SI
        By parameter.

    Returns
    -------
    (str, float) or None
        None without targets, without a calibration, or where the noise is not known.
    """
    fixture = recording.fixture
    if not targets or after.calibration is None or fixture is None:
        return None
    conditions = _conditions(recording, after.calibration)
    wanted = np.full(N_PARAMETERS, math.nan)
    wanted[[INDEX[name] for name in targets]] = list(targets.values())
    known = known_information(after.calibration, conditions)
    stand = FixtureKinematics(AxisKinematics(), AxisKinematics())
    start, end = labels[-1].start_static_s
    length = end - start
    ratios = {}
    for name, sequence in SEQUENCES.items():
        found = predict([from_catalogue(sequence, stand)], np.full((1, 2), length), stand, conditions, wanted, known)
        ratios[name] = float(np.nanmax(found.sigma / wanted))
    best = min(ratios, key=lambda name: ratios[name])
    return best, ratios[best]


def _conditions(recording: Recording, calibration: Calibration) -> Conditions:
    """Conditions of a recording, with the noise that its calibration used."""
    noise, site, fixture = calibration.noise, recording.site, recording.fixture
    assert fixture is not None

    def largest(figures: Array | None) -> float:
        return 0.0 if figures is None else float(figures.max())

    return Conditions(
        gyro_white=largest(noise.gyro_noise_rad_per_sqrt_s),
        accel_white=largest(noise.accel_noise_m_s2_sqrt_s),
        gyro_edge=largest(noise.gyro_reading_error_rad),
        accel_edge=largest(noise.accel_reading_error_m_s),
        gyro_instability=recording.noise.gyro_bias_instability or 0.0,
        accel_instability=recording.noise.accel_bias_instability or 0.0,
        latitude_rad=site.latitude_rad or 0.0,
        heading_rad=fixture.heading_rad or 0.0,
        gravity_m_s2=site.gravity_m_s2,
        gravity_sigma_m_s2=site.gravity_sigma_m_s2,
        alignment_sigma_rad=fixture.alignment_sigma_rad,
        rotation_sigma_rad=fixture.rotation_sigma_rad,
    )
