"""Fitness of a recording for a calibration, judged before any iteration, by the observability of the linear model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.channels import MOVED
from srt.estimation.fixed_parameters import in_frame_of_poses, parameters_due, remedies, seen_by_earth_rate_alone
from srt.estimation.registry import automatic_estimator
from srt.exceptions import DataError
from srt.model.srt_formulas import formulas, missing_parameters
from srt.model.table1 import SEQUENCES
from srt.sensor_errors import GROUP_SLICES, NAMES, collapse_names
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.recognition import label_sequences
from srt.sequences.stationary_windows import MIN_TURN_RAD

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

YES, PARTLY, NO = "yes", "partly", "no"
_TILT: Final = math.asin(MOVED)
"""Tilt of a level axis that changes gravity on it by as much, rad."""
_MOST: Final = 0.99
"""Share of the seconds of a log that are at rest if the log is: a knock lasts some seconds."""
_RECORD: Final = "record rests in many attitudes, with turns about all axes between them (protocol hand-turned)"


@dataclass(frozen=True, slots=True)
class Fitness:
    """Fitness of a recording for a calibration.

    Attributes
    ----------
    word : str
        "yes"; "partly": parameters that such a recording should show are not observable; "no".
    reason : str
        Missing parameters or cause, and advice on what to record; empty for "yes".
    stops : bool
        True if no estimator is to be tried.
    """

    word: str
    reason: str = ""
    stops: bool = False

    def __str__(self) -> str:
        return f"Fit to calibrate: {self.word}{f' ({self.reason})' if self.reason else ''}"


def fitness(evidence: Evidence, refusal: Finding | None, estimator: str = "auto") -> Fitness:
    """Judge a recording after the checks for faults, of which ``refusal`` is the first fatal one."""
    if refusal is not None:
        title = refusal.cause.title
        return Fitness(NO, title[0].lower() + title[1:])
    recording = evidence.recording
    try:
        recording = label_sequences(recording)[0]
        data, observed, wanted = _observability(recording, evidence, estimator)
    except DataError as error:
        log = None if recording.sequences else _log_without_turns(evidence)
        return Fitness(NO, log or str(error).rstrip("."), stops=log is not None)
    level = _restless(data) or _level(evidence, data)
    due = parameters_due(data) & wanted
    biases = np.zeros_like(due)
    for group in ("gyro_bias", "accel_bias"):
        biases[GROUP_SLICES[group]] = True
    asked = due & ~biases
    if level is not None or (asked.any() and not np.any(observed & asked)):
        needed = [name for name, own in zip(NAMES, asked, strict=True) if own]
        # The closed form itself says which estimator takes sequences that are not of its table.
        stops = level is not None or estimator != "closed-form"
        return Fitness(NO, level or f"nothing but biases is observable; {_remedy(data, needed)}", stops=stops)
    missing = [name for name, lacks in zip(NAMES, due & ~observed, strict=True) if lacks]
    if not missing:
        return Fitness(YES)
    return Fitness(PARTLY, f"not observable: {', '.join(collapse_names(missing))}; {_remedy(data, missing)}")


def _remedy(data: PreparedRecording, names: Sequence[str]) -> str:
    """Advice, in a few words, on what a recording lacks to show parameters."""
    if any(name in SEQUENCES for name in data.ids):
        return "add the other sequences of Table 1"
    single = remedies(names)
    return _RECORD if single.count(";") > 1 else f"add {single}"


def _observability(recording: Recording, evidence: Evidence, estimator: str) -> tuple[PreparedRecording, Mask, Mask]:
    """Prepared recording, and masks of the parameters that its estimator can observe, and of those that are free."""
    options = in_frame_of_poses(recording, evidence.options)
    wanted = np.array([name not in options.fixed_names for name in NAMES])
    chosen = automatic_estimator(recording) if estimator == "auto" else estimator
    if chosen == "closed-form":
        data = prepare_checked(recording, recording.sequences, options.average)
        return data, ~np.isin(NAMES, missing_parameters(formulas(frozenset(data.ids), asymmetry=True))), wanted
    from srt.joint.calibration_run import observable_at_start  # heavy, and the closed form does without
    from srt.joint.recording_opening import open_joint_model

    joint = open_joint_model(recording, options)
    wanted &= ~np.isin(NAMES, list(seen_by_earth_rate_alone(joint.data)))
    return joint.data, observable_at_start(joint, wanted), wanted


def _restless(data: PreparedRecording) -> str | None:
    """Clause on windows in most of which the unit turns from their first half to the second; None for others."""
    half = data.windows.accel_halves / np.linalg.norm(data.windows.accel_halves, axis=2, keepdims=True)
    turned = np.einsum("wa,wa->w", half[:, 0], half[:, 1]) < math.cos(MIN_TURN_RAD)
    if 2 * np.count_nonzero(turned) <= len(turned):
        return None
    return (
        f"in {np.count_nonzero(turned)} of {len(turned)} quiet windows the specific force turns by more than "
        f"{math.degrees(MIN_TURN_RAD):.0f}°, so that the unit never rests: {_RECORD}"
    )


def _level(evidence: Evidence, data: PreparedRecording) -> str | None:
    """Clause on windows and turns between which gravity hardly changes its direction; None for any others.

    No axis turns from level to 30°: a vehicle on slopes leans by less. The turns show it by the gyros, whose integral
    drifts in long ones, or by the accelerometers. Runs at a stated rate need no other attitude.
    """
    force = data.windows.accel_mean / np.linalg.norm(data.windows.accel_mean, axis=1, keepdims=True)
    down, read = force.mean(axis=0), evidence.missed_rotations[1]
    turned = np.linalg.norm(read - np.outer(read @ down, down), axis=1).max(initial=0.0)
    rated = any(label.rate is not None for label in data.labels)
    if rated or np.ptp(force, axis=0).max() > MOVED or min(turned, _leans(evidence)) > _TILT:
        return None
    angle = math.degrees(math.acos(np.clip((force @ force.T).min(), -1.0, 1.0)))
    return (
        f"in the {len(force)} stationary windows gravity changes its direction by at most {angle:.2g}°, and in the "
        f"turns by less than {math.degrees(_TILT):.0f}°, as in a vehicle, which shows no scale factor: {_RECORD}"
    )


def _leans(evidence: Evidence) -> float:
    """Angle to its mean direction below which the specific force of nearly all seconds lies, rad."""
    return float(np.quantile(_seconds(evidence)[0], _MOST))


def _log_without_turns(evidence: Evidence) -> str | None:
    """Clause on a log without two stationary windows that a turn joins: what it is, what it gives, what to record.

    None if gaps part the windows.
    """
    recording = evidence.recording
    lasts = float(recording.time[-1] - recording.time[0]) + evidence.dt
    told = at_rest(evidence)
    if told is not None:
        return f"{told}, which shows noise ('srt noise') and no scale factor: {_RECORD}"
    if recording.gaps.size:
        return None
    vehicle = ", as in a vehicle" if _leans(evidence) < _TILT else ""
    return f"in {lasts:.4g} s no turn lies between two rests of 1 s or more{vehicle}: {_RECORD}"


def at_rest(evidence: Evidence) -> str | None:
    """Clause on a log in which the unit rests in one attitude, with its temperature; None for any other log."""
    recording = evidence.recording
    tilt, rate = _seconds(evidence)
    if max(np.quantile(tilt, _MOST), np.quantile(rate, _MOST)) > MIN_TURN_RAD:
        return None
    seconds = float(recording.time[-1] - recording.time[0]) + evidence.dt
    lasts = f"{seconds:.4g} s" if seconds < 600.0 else f"{seconds / 60.0:.3g} min"
    T = recording.temperature
    course = "" if T is None or np.ptp(T) == 0.0 else f", at {T.min():.3g} to {T.max():.3g} °C"
    return f"the unit rests in one attitude for {lasts}{course}"


def _seconds(evidence: Evidence) -> tuple[Array, Array]:
    """For each second, angle of the mean specific force to its mean direction, and angle turned beside the median."""
    size = max(1, round(1.0 / evidence.dt))
    starts = np.arange(0, max(1, len(evidence.recording.time) - size + 1), size)
    rate, force = (
        np.add.reduceat(table[: starts[-1] + size], starts, axis=0) / min(size, len(table))
        for table in (evidence.rate, evidence.force)
    )
    mean = force.mean(axis=0)
    length = np.maximum(np.linalg.norm(force, axis=1) * np.linalg.norm(mean), np.finfo(float).tiny)
    tilt = np.arccos(np.clip(force @ mean / length, -1.0, 1.0))
    return tilt, np.linalg.norm(rate - np.median(rate, axis=0), axis=1)
