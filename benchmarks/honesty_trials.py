"""Trials of ``honesty.py``: scores of one unit of a cell, by estimator or by rule.

A cell is a tuple of the properties of a unit; the same number gives the same unit. Names and sizes of the properties
are those of the modules that make the recordings.
"""

from __future__ import annotations

from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
from accuracy_trials import GRADES as SIMULATED_GRADES
from accuracy_trials import fixture_recording, noisy_recording
from efficiency import bound_si
from foreign_motion import GRADES as HAND_GRADES
from honesty_recordings import (
    DEFECTS,
    FAULTS,
    SILENT_ERRORS,
    asymmetric_unit,
    defective_unit,
    drifting_unit,
    fixture_drift,
    hand_unit,
    truth_of,
)
from injected_faults.injection import Case
from nineteen_positions import CASES as NINETEEN_POSITIONS
from nineteen_positions import bound as bound_of_nineteen
from nineteen_positions import unit_of as unit_of_nineteen
from studies import Score, scored
from worse_recordings import CASES, HAND_RESTS_S, unit_of, unstated_unit

import srt
from srt.comparison.estimator_comparison import compare
from srt.constants import DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.diagnosis.staged_diagnosis import diagnose
from srt.result.verdict import OF_FIXTURE
from srt.sensor_errors import GROUP_SLICES, NAMES

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
RULES = {"estimated": 1.0, "where p < 0.05": 0.05, "where p < 0.001": 1e-3, "never": 0.0}
"""Probability of the test below which a group of asymmetries is estimated."""


ASYMMETRIES = {"none": 0.0, "a tenth of the scale error": 0.1, "three tenths": 0.3, "as large": 1.0}
"""Asymmetries, 1-sigma, in units of the scale errors."""


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


def nineteen_positions(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    recording, truth = unit_of_nineteen(cell[0], unit)
    fixed, rows = NINETEEN_POSITIONS[cell[0]][1], {}
    for name in estimators:
        started = process_time()
        found = srt.calibrate(replace(recording), name, hold=fixed, checks=False)
        spent = process_time() - started
        rows[name] = replace(scored(found, truth), bound=bound_of_nineteen(fixed), seconds=spent)
    return rows


def verdicts(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    grade, fault = cell
    case = Case(grade, 20261122 + unit)
    recording = FAULTS[fault](case, np.random.default_rng((20261122, unit)))
    found = diagnose(recording, calibrating=False)
    checks = "refused" if found.refusal else "warned" if found.first else "passed"
    rows = calibrated(recording, case.simulation.truth.vector, estimators)
    return {name: replace(row, checks=checks) for name, row in rows.items()}


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


def drift_on_the_fixture(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    case = Case(cell[0], 20261124 + unit)
    recording = fixture_drift(case, *cell[1:], np.random.default_rng((20261124, unit)))
    return calibrated(recording, case.simulation.truth.vector, estimators)


def false_drift(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    grades = list(SIMULATED_GRADES)
    seed = 500_000 + len(grades) * unit + grades.index(cell[0])
    recording, truth = noisy_recording(seed, cell[0], sample_rate_hz=20.0, instability=True)
    return calibrated(recording, truth.vector, estimators)


def by_hand(cell: Cell, unit: int, estimators: list[str], *, stated: bool) -> Rows:
    seed = 1000 * list(HAND_GRADES).index(cell[0]) + unit
    return calibrated(*hand_unit(seed, *cell, stated=stated), estimators)


def drift_by_hand(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    return calibrated(*drifting_unit(unit, *cell), estimators)


def asymmetry(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    """Errors under each rule, of gyro scale, accelerometer bias and accelerometer scale."""
    recording, truth = asymmetric_unit(unit, cell[0], ASYMMETRIES[cell[1]])
    rows = {}
    for estimator in estimators:
        found = srt.calibrate(recording, estimator, checks=False)
        tests = found.diagnostics.asymmetry or {}
        for rule, limit in RULES.items():
            score = Score(found.status, found.judgement.word)
            for group in ("gyro_scale", "accel_bias", "accel_scale"):
                test = tests.get(f"{group.split('_')[0]}_asymmetry")
                for name in NAMES[GROUP_SLICES[group]]:
                    k = NAMES.index(name)
                    if test is None or not score.usable or not found.observed[k]:
                        continue
                    other = test.without[name]
                    own = test.probability <= limit and limit > 0.0
                    value, sigma = (found.errors[name], found.sigma[k]) if own else (other.value, other.sigma)
                    score.error[k] = value - truth[k]
                    score.z[k] = score.error[k] / sigma
            rows[f"{estimator}, {rule}"] = score
    return rows


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
