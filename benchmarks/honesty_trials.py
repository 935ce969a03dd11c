"""Trials of ``honesty.py``: scores of one unit of a cell, by estimator or by rule.

A cell is a tuple of the properties of a unit; the same number gives the same unit. Names and sizes of the properties
are those of the modules that make the recordings.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from time import process_time
from typing import Any

import numpy as np
from accuracy_trials import fixture_recording, noisy_recording
from efficiency import bound_si
from foreign_motion import DEG, GRAVITY_M_S2, NINETEEN_START_DEG, PSINS_EXTRAS, Grade, drawn_errors, recording
from foreign_motion import GRADES as HAND_GRADES
from foreign_motion import nineteen_positions as nineteen_turns
from honesty_recordings import (
    DEFECTS,
    SILENT_ERRORS,
    defective_unit,
    drifting_unit,
    hand_unit,
    truth_of,
)
from injected_faults.injection import Case
from motion_bound import Chain, Conditions, Leg, motion_bound
from scipy.spatial.transform import Rotation
from studies import Score, scored
from worse_recordings import CASES, HAND_RESTS_S, unit_of, unstated_unit

import srt
from srt.comparison.estimator_comparison import compare
from srt.constants import DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.diagnosis.staged_diagnosis import diagnose
from srt.result.verdict import OF_FIXTURE
from srt.sensor_errors import NAMES

Cell = tuple[Any, ...]
Rows = dict[str, Score]
SENSITIVITIES = {"navigation": 0.002, "tactical": 0.1, "industrial": 1.0}
"""G-sensitivity by grade, °/h/g."""
SIMULATED = {
    "noise stated": {},
    "noise estimated": {"state_noise": False},
    "bias instability, stated": {"instability": True},
    "bias instability, not stated": {"instability": True, "state_noise": False},
    "g-sensitivity": {"g_sensitivity": DEG_PER_H / STANDARD_GRAVITY_M_S2},
}
"""Units of the simulator; g-sensitivity in units of that of the grade."""

NINETEEN_SEED = 20261122
NINETEEN_GRADE = Grade(0.001 * DEG / 60.0, 10e-6 * 9.80665, 3e-5, 1.5e-4, 0.2 * DEG / 3600.0, 2e-3)
NINETEEN_POSITIONS = {  # extras, parameters fixed
    "no extras": (None, ("gyro_asymmetry", "accel_asymmetry")),
    # At 1 g, |f| takes up what a quadratic term adds.
    "quadratic terms, lever arms, lag": (PSINS_EXTRAS, ("gyro_asymmetry",)),
}


def calibrated(unit: srt.Recording, truth: np.ndarray, estimators: list[str]) -> Rows:
    """Scores without the checks of the recording."""
    rows = {}
    for name in estimators:
        try:
            rows[name] = scored(srt.calibrate(unit, name, checks=False), truth)
        except srt.SrtError:
            rows[name] = Score("refused")
    return rows


def simulated(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    grade, case = cell
    changes = dict(SIMULATED[case])
    if "g_sensitivity" in changes:
        changes["g_sensitivity"] *= SENSITIVITIES[grade]
    recording, truth = noisy_recording(1000 + unit, grade, **changes)
    return calibrated(recording, truth.vector, estimators)


def on_the_fixture(cell: Cell, unit: int, estimators: list[str], *, moves: str) -> Rows:
    """Fixture as stated: alignment 1 mrad, wobble a hundredth of the rotations; "named": the estimators disagree."""
    grade, axes_mrad, rotations_mrad = cell
    changes = {"non_orthogonality_rad": 1e-3 * axes_mrad, "rotation_sigma_rad": 1e-3 * rotations_mrad}
    recording, truth = fixture_recording(unit, grade, **changes, moves=moves, sample_rate_hz=50.0)
    found = {name: srt.calibrate(recording, name, checks=False) for name in estimators}
    bound = bound_si(grade, 1e-3 * rotations_mrad, moves)
    differ = len(found) > 1 and not compare(found).agree
    return {name: replace(scored(each, truth.vector), bound=bound, named=differ) for name, each in found.items()}


@cache
def bound_of_nineteen(fixed: tuple[str, ...]) -> np.ndarray:
    """Cramér-Rao bound of the 27 errors, 1-sigma, zero for those that are fixed."""
    turns, first_rest_s = nineteen_turns()
    chain = Chain(
        Rotation.from_euler("ZYX", NINETEEN_START_DEG, degrees=True),
        [first_rest_s, *(turn.rest_s for turn in turns)],
        [[Leg(np.array(turn.axis), turn.angle_rad, turn.duration_s)] for turn in turns],
    )
    conditions = Conditions(
        NINETEEN_GRADE.gyro_rad_per_sqrt_s, NINETEEN_GRADE.accel_m_s2_sqrt_s, GRAVITY_M_S2, 5e-6, 34.0 * DEG
    )
    return motion_bound([chain], conditions, [n for n in NAMES if not n.startswith(fixed)])


def unit_of_nineteen(case: str, number: int, *, noise: bool = True) -> tuple[srt.Recording, np.ndarray]:
    """One unit of a case, and its errors."""
    rng = np.random.default_rng((NINETEEN_SEED, number))
    errors, grade = drawn_errors(NINETEEN_GRADE, rng, asymmetry=False), NINETEEN_GRADE if noise else None
    turned = {"start_deg": NINETEEN_START_DEG, "extras": NINETEEN_POSITIONS[case][0]}
    return recording(*nineteen_turns(), errors, grade, rng, **turned), truth_of(errors)


def nineteen_positions(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    recording, truth = unit_of_nineteen(cell[0], unit)
    fixed, rows = NINETEEN_POSITIONS[cell[0]][1], {}
    for name in estimators:
        started = process_time()
        found = srt.calibrate(replace(recording), name, hold=fixed, checks=False)
        spent = process_time() - started
        rows[name] = replace(scored(found, truth), bound=bound_of_nineteen(fixed), seconds=spent)
    return rows


def silent_errors(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    row, case = SILENT_ERRORS[cell[0]], Case("navigation-rlg", 20261130 + unit)
    recording = row.change(case, np.random.default_rng((20261130, unit)))
    found = {finding.fault for finding in diagnose(recording, calibrating=False).findings}
    rows = {}
    for name in estimators:
        result = srt.calibrate(recording, name, checks=False)
        unseen = {e.source for e in result.diagnostics.unseen_errors or () if e.sigma is None}
        score = scored(result, case.simulation.truth.vector)
        named = bool(found & set(row.findings)) or row.unseen in unseen or row.drift in score.drift
        rows[name] = replace(score, named=named)
    return rows


def by_hand(cell: Cell, unit: int, estimators: list[str], *, stated: bool) -> Rows:
    seed = 1000 * list(HAND_GRADES).index(cell[0]) + unit
    return calibrated(*hand_unit(seed, *cell, stated=stated), estimators)


def drift_by_hand(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    return calibrated(*drifting_unit(unit, *cell), estimators)


def defects(cell: Cell, unit: int, _estimators: list[str]) -> Rows:
    """Through ``srt.calibrate`` with its checks, by the default estimator."""
    recording, truth = defective_unit(cell[0], unit)
    faults = tuple(finding.fault for finding in srt.diagnose(recording).findings)
    try:
        score = scored(srt.calibrate(recording), truth)
    except srt.SrtError:
        score = Score("refused")
    named = set(DEFECTS[cell[0]].named)
    return {"default": replace(score, faults=faults, named=not named or bool(named & set(faults)))}


def named_by(found: srt.Calibration) -> tuple[str, ...]:
    """Drift that a result models, findings, and the sequence, the part of the fixture and the moves that it accuses."""
    named = [f"{row.sensor} {row.form}" for row in found.diagnostics.drift or ()]
    named += [finding.fault for finding in found.diagnostics.faults or ()]
    verdict = found.verdict
    if verdict is not None and verdict.contradicting is not None:
        named.append(f"contradicts: {verdict.contradicting.sequence}")
    added = verdict.added_noise if verdict is not None else None
    named += [OF_FIXTURE[kind] for kind in added or () if kind in OF_FIXTURE]
    named += ["move left out" for _ in found.provenance.voided]
    named += ["moves contradict" for text in found.diagnostics.contradicted or () if "recorded moves" in text]
    return *named, *("label" for warning in found.warnings if "check the label" in warning)


def worse_than_stated(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    """Through ``srt.calibrate`` with its checks; the closed form, on the fixture alone."""
    case, rows = CASES[cell[0]], {}
    recording, errors = unit_of(case, unit)
    for name in estimators:
        if name == "closed-form" and case.motion in HAND_RESTS_S:
            continue
        try:
            found = srt.calibrate(recording, name)
        except srt.InputError as error:
            rows[name] = Score("refused", faults=(str(error)[:60],))
            continue
        rows[name] = replace(scored(found, truth_of(errors)), faults=named_by(found))
    return rows


def unstated_noise(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    recording, errors = unstated_unit(unit, *cell)
    able = [name for name in estimators if cell[0] == "fixture" or name != "closed-form"]
    return calibrated(recording, truth_of(errors), able)
