"""Recordings for sequence recognition: random orders, repeats, rates, dwells, moves and joins; units of all grades.

A trial compares the calibration of a recording without its labels with the calibration of the same recording with them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from studies import nees_of

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults.injection import GRADES, Case

import srt
from sims.physics.sequences import TABLE_1
from srt.constants import DEG
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.recording.recording import Recording
    from srt.sensor_errors import SensorErrors
    from srt.types import Array


_LARGE = {
    "gyro_scale": 0.3,
    "gyro_orthogonality": 0.1,
    "accel_bias": 0.5,
    "accel_scale": 0.3,
    "accel_misalignment": 0.1,
    "gyro_bias": 1.0 * DEG,
}
"""Largest sensor errors before calibration, SI."""


@dataclass(frozen=True, slots=True)
class RecognitionTest:
    """One recording and the sequences that were run.

    Attributes
    ----------
    recording : Recording
        Labelled.
    order : tuple of str
        Sequence ids in the order of execution.
    truth : SensorErrors
    joined : bool
        True if it is one recording per sequence joined end to end, without gaps in the time stamps.
    """

    recording: Recording
    order: tuple[str, ...]
    truth: SensorErrors
    joined: bool


def random_order(rng: np.random.Generator, repeats: int = 3) -> tuple[str, ...]:
    """All sequences of Table 1 in random order, and up to ``repeats`` of them once more at the end."""
    ids = np.array(list(TABLE_1))
    again = rng.choice(ids, int(rng.integers(0, repeats + 1)))
    return tuple(str(name) for name in np.concatenate([rng.permutation(ids), again]))


def hard_test(seed: int) -> RecognitionTest:
    """Recording of a unit with errors up to 30 % and 1 °/s, at 0.1-2 rad/s, with random dwells and stops between legs.

    Moves between sequences are recorded, or omitted with or without a gap in the time stamps.
    """
    rng = np.random.default_rng(seed)
    order = random_order(rng)
    schedule: dict[str, Any] = {
        "sequences": list(order),
        "rate_rad_s": float(np.exp(rng.uniform(np.log(0.1), np.log(2.0)))),
        "dwell_s": float(rng.uniform(5.0, 15.0)),
        "leg_dwell_s": float(rng.choice([0.0, 0.0, 0.5, 2.0])),
        "moves": str(rng.choice(["recorded", "skipped"])),
    }
    bound = np.zeros(N_PARAMETERS)
    for group, size in _LARGE.items():
        bound[GROUP_SLICES[group]] = size
    values = dict(zip(NAMES, (rng.uniform(-1.0, 1.0, N_PARAMETERS) * bound).tolist(), strict=True))
    case = Case(
        GRADES[seed % len(GRADES)],
        seed,
        {"schedule": schedule, "errors": {"draw": "none", "values": values}, "imu": {"frame_turn_sigma_mrad": 0.0}},
    )
    return _test(case, order, joined=schedule["moves"] == "skipped" and bool(rng.integers(2)))


def fair_test(seed: int, grade: str, *, noise: bool = True) -> RecognitionTest:
    """Recording whose labels are exactly the stationary windows, of a unit with the modelled noise only.

    That is random walks and quantization; bias instability and g-sensitivity are zero. Even seeds have recorded moves;
    odd ones are joined end to end.
    """
    rng = np.random.default_rng(seed)
    order = random_order(rng)
    joined = bool(seed % 2)
    none = {"gyro_g_sensitivity_deg_per_h_per_g": 0.0, "gyro_bias_instability_deg_per_h": 0.0}
    changes: dict[str, Mapping[str, Any]] = {
        "imu": {"from": grade, "noise": {**none, "accel_bias_instability_ug": 0.0}},
        "schedule": {
            "sequences": list(order),
            "rate_rad_s": float(rng.uniform(0.3, 2.0)),
            "settle_s": 0.0,
            "pause_s": 0.0,
            "moves": "skipped" if joined else "recorded",
        },
        "recording": {"noise": noise},
    }
    if not noise:
        changes["fixture"] = {"from": "perfect"}
    return _test(Case(grade, seed, changes), order, joined=joined)


def _test(case: Case, order: tuple[str, ...], *, joined: bool) -> RecognitionTest:
    recording = case.recording
    return RecognitionTest(end_to_end(recording) if joined else recording, order, case.simulation.truth, joined)


def end_to_end(recording: Recording) -> Recording:
    """Recording without gaps: evenly spaced time stamps, labels moved with their samples."""
    dt = recording.nominal_interval_s

    def moved(window: tuple[float, float]) -> tuple[float, float]:
        samples = recording.window_indices(*window)
        return samples.start * dt, samples.stop * dt

    labels = tuple(
        replace(label, start_static_s=moved(label.start_static_s), end_static_s=moved(label.end_static_s))
        for label in recording.sequences
    )
    time: Array = np.arange(1, len(recording.time) + 1, dtype=np.float64) * dt
    return replace(recording, time=time, sequences=labels)


@dataclass(frozen=True, slots=True, eq=False)
class LabelEffect:
    """Difference between the calibrations without and with labels.

    Attributes
    ----------
    difference : ndarray, shape (27,), SI
        Unlabelled minus labelled.
    sigma : ndarray, shape (27,), SI
        Sigma of the labelled calibration.
    nees : float
        NEES of the unlabelled calibration, per parameter.
    """

    difference: Array
    sigma: Array
    nees: float


def label_effect(test: RecognitionTest) -> LabelEffect:
    """Calibrate a recording with its labels and without them, by the default estimator."""
    labelled = srt.calibrate(test.recording, checks=False)
    found = srt.calibrate(test.recording.with_sequences(()), checks=False)
    nees = nees_of(found.errors.vector - test.truth.vector, found.covariance) / N_PARAMETERS
    return LabelEffect(found.errors.vector - labelled.errors.vector, labelled.sigma, nees)
