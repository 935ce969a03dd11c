"""Recordings and trials of ``honesty.py``: scores of one unit of a cell, by estimator.

A cell is a tuple of the properties of a unit; the same number gives the same unit. Errors of a test change a simulated
case (:class:`injected_faults.injection.Case`). Hand-turned units and drifts come from ``foreign_motion.py``, which
shares nothing with the simulator or the estimators.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING

import numpy as np
from accuracy_trials import GRADES, IN_G, SITE, fixture_recording, noisy_recording
from foreign_motion import (
    DEG,
    GRAVITY_M_S2,
    NINETEEN_START_DEG,
    PROFILES,
    PSINS_EXTRAS,
    Grade,
    drawn_errors,
    drifting,
    hand_turns,
    recording,
)
from foreign_motion import GRADES as HAND_GRADES
from foreign_motion import nineteen_positions as nineteen_turns
from protocols import Chain, Conditions, Leg, motion_bound
from scipy.spatial.transform import Rotation
from studies import Cell, Rows, Score, scored
from worse_recordings import CASES, HAND_RESTS_S, unit_of, unstated_unit

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults.disturbances import vibrating
from injected_faults.injection import Case

import srt
from sims.accuracy.bound import bayesian_bound
from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1, table_sequences
from sims.physics.table_motion import Schedule, run_schedule
from sims.scenarios.simulation import schedule_of
from srt.comparison.estimator_comparison import compare
from srt.constants import DEG_PER_H, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.diagnosis.staged_diagnosis import diagnose
from srt.model.prior import Prior
from srt.result.verdict import OF_FIXTURE
from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from sims.physics.table_motion import Moves
    from sims.physics.true_motion import TrueMotion

Change = Callable[[Case, np.random.Generator], srt.Recording]
HAND_SEED = 20261122
CLOCK, GRAVITY = 1e-4, 342e-6
LONG_RESTS = {"8, 570": (12, 33.0)}
"""Turns, and rest after each, s, if other than 36 and 5 s: repeated recordings of a sensor array last 500 s."""


def unit_vector(rng: np.random.Generator) -> np.ndarray:
    """Random direction, from the next three normal numbers."""
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def per_sample(case: Case) -> float:
    """Change of a reading by a unit of its rate."""
    return case.simulation.motion.interval if case.recording.kind == "increment" else 1.0


def read_again(case: Case, motion: TrueMotion, rng: np.random.Generator) -> srt.Recording:
    """Recording of another motion by the unit of a case."""
    run = case.simulation
    read = read_out(motion, run.truth, run.imu, rng, kind=run.recording.kind)
    return replace(run.recording, gyro=read.gyro, accel=read.accel, data_sha256=None)


def as_recorded(case: Case, _rng: np.random.Generator) -> srt.Recording:
    """Recording without an error."""
    return case.recording


def ramp(ug_per_h: float) -> Change:
    """Accelerometer bias of one axis that drifts."""

    def change(case: Case, rng: np.random.Generator) -> srt.Recording:
        unit, slope = case.recording, np.zeros(3)
        slope[rng.integers(3)] = ug_per_h * MICRO_G / 3600.0 * rng.choice([-1.0, 1.0])
        time = (unit.time - unit.time.mean())[:, None]
        return replace(unit, accel=unit.accel + slope * time * per_sample(case), data_sha256=None)

    return change


def vibration(frequency_hz: float, angle_rad: float, force_mg: float) -> Change:
    """Vibration of the table in random directions of the unit."""

    def change(case: Case, rng: np.random.Generator) -> srt.Recording:
        angle, force = (unit_vector(rng) for _ in range(2))
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        force = force_mg * 1e3 * MICRO_G * force
        motion = vibrating(case.simulation.motion, frequency_hz, angle_rad * angle, force, phase_rad=phase)
        return read_again(case, motion, rng)

    return change


def flicker(case: Case, rng: np.random.Generator) -> srt.Recording:
    """Bias instability of 0.003 °/h and 2 µg that is not stated; white noise and quantization are."""
    run = case.simulation
    imu = replace(run.imu, gyro_bias_instability=0.003 * DEG_PER_H, accel_bias_instability=2.0 * MICRO_G)
    read = read_out(run.motion, run.truth, imu, rng, kind=run.recording.kind)
    noise = replace(run.recording.noise, gyro_bias_instability=None, accel_bias_instability=None)
    return replace(run.recording, gyro=read.gyro, accel=read.accel, noise=noise, data_sha256=None)


def wobble(case: Case, rng: np.random.Generator) -> srt.Recording:
    """Axes that lean by another 10 µrad in every pose, where the wobble is stated as zero."""
    run, scenario = case.simulation, case.scenario
    motion = run_schedule(
        schedule_of(scenario.schedule),
        site=run.motion.site,
        sample_rate_hz=scenario.recording.sample_rate_hz,
        heading_rad=scenario.fixture.heading_deg * DEG,
        fixture_draw=replace(run.fixture_draw, wobble=1e-5 * rng.standard_normal(run.fixture_draw.starts.shape)),
        U=run.U,
        stated_fixture=run.motion.fixture,
        earth_rate=scenario.site.earth_rate,
        start_time_s=scenario.recording.start_time_s,
    )
    unit = read_again(case, motion, rng)
    return replace(unit, fixture=replace(unit.fixture, wobble_sigma_rad=0.0))


def clock(*, stated: bool) -> Change:
    """Time stamps of a clock that is wrong by 1e-4."""

    def spread(span: tuple[float, float]) -> tuple[float, ...]:
        return tuple((1.0 + CLOCK) * t for t in span)

    def change(case: Case, _rng: np.random.Generator) -> srt.Recording:
        unit, sigma = case.recording, {"clock_sigma": CLOCK} if stated else {}
        labels = tuple(
            replace(label, start_static_s=spread(label.start_static_s), end_static_s=spread(label.end_static_s))
            for label in unit.sequences
        )
        return replace(unit, time=unit.time * (1.0 + CLOCK), sequences=labels, data_sha256=None, **sigma)

    return change


def gravity(*, stated: bool) -> Change:
    """Gravity stated 342 ppm too large, as of another height of 1100 m."""

    def change(case: Case, _rng: np.random.Generator) -> srt.Recording:
        value = case.recording.site.gravity_m_s2 * (1.0 + GRAVITY)
        sigma = {"gravity_sigma_m_s2": GRAVITY * value} if stated else {}
        return replace(case.recording, site=replace(case.recording.site, gravity_m_s2=value, **sigma))

    return change


@dataclass(frozen=True)
class SilentError:
    """Error of a test, and what tells it: faults of the checks, a source of unseen errors, the sensor of a drift."""

    change: Change
    findings: tuple[str, ...] = ()
    unseen: str = ""
    drift: str = ""


SILENT_ERRORS = {
    "none": SilentError(as_recorded),
    "vibration, 5 µrad and 3 mg at 23 Hz": SilentError(vibration(23.0, 5e-6, 3.0), ("vibration",)),
    "vibration, 0.3 mrad at 7 Hz": SilentError(vibration(7.0, 3e-4, 0.0), ("vibration",)),
    "accelerometer ramp, 100 µg/h": SilentError(ramp(100.0), ("accel_bias_drift",), drift="accel"),
    "flicker of 0.003 °/h and 2 µg, not stated": SilentError(flicker),
    "wobble of 10 µrad, stated as 0": SilentError(wobble),
    "clock off by 1e-4": SilentError(clock(stated=False), unseen="time base"),
    "clock off by 1e-4, sigma stated": SilentError(clock(stated=True)),
    "gravity off by 342 ppm": SilentError(gravity(stated=False), ("gravity",)),
    "gravity off by 342 ppm, sigma stated": SilentError(gravity(stated=True)),
}


def truth_of(errors: dict[str, float]) -> np.ndarray:
    """Errors as a vector, shape (27,), SI."""
    return np.array([errors.get(name, 0.0) for name in NAMES])


def hand_unit(seed: int, grade: str, profile: str, *, stated: bool) -> tuple[srt.Recording, np.ndarray]:
    """Unit turned by hand in 0.5 to 30 s, and its errors; ``stated``: white noise, and that there is no instability."""
    rng, white = np.random.default_rng((HAND_SEED, seed)), HAND_GRADES[grade]
    errors = drawn_errors(white, rng)
    turns = hand_turns(rng, shortest_s=0.5, longest_s=30.0)
    unit = recording(turns, 5.0, errors, white, rng, profile=profile)
    if stated:
        unit = replace(unit, noise=srt.ImuNoise(white.gyro_rad_per_sqrt_s, white.accel_m_s2_sqrt_s, 0.0, 0.0, 0.0, 0.0))
    return unit, truth_of(errors)


def drifting_unit(seed: int, grade: str, form: str, change: str) -> tuple[srt.Recording, np.ndarray]:
    """Unit turned by hand whose biases drift by "mg, °/h" over the recording, and its errors."""
    rng = np.random.default_rng((HAND_SEED, 7, seed))
    errors = drawn_errors(HAND_GRADES[grade], rng)
    count, rest_s = LONG_RESTS.get(change, (36, 5.0))
    turns = hand_turns(rng, shortest_s=0.5, longest_s=12.0, count=count, rest_s=rest_s)
    profile = PROFILES[seed % len(PROFILES)]
    unit = recording(turns, rest_s, errors, HAND_GRADES[grade], rng, profile=profile)
    accel_mg, gyro_deg_h = map(float, change.split(", "))
    unit = drifting(unit, turns, rest_s, rng, form=form, accel_mg=accel_mg, gyro_deg_h=gyro_deg_h)
    return unit, truth_of(errors)


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


@cache
def bound_si(grade: str, rotation_sigma_rad: float = 1e-3, moves: Moves = "skipped") -> np.ndarray:
    """Cramér-Rao bound (1 sigma, SI) at zero errors, shape (27,), for :func:`accuracy_trials.fixture_recording`."""
    alignment = ("level_sigma_rad", "north_sigma_rad", "mounting_sigma_rad", "non_orthogonality_sigma_rad")
    rotations = {"rotation_sigma_rad": rotation_sigma_rad, "wobble_sigma_rad": 1e-2 * rotation_sigma_rad}
    return bayesian_bound(
        Schedule(table_sequences(tuple(TABLE_1)), moves=moves),
        site=SITE,
        imu=GRADES[grade],
        fixture_sigma=dict.fromkeys(alignment, 1e-3) | rotations,
        sample_rate_hz=100.0,
    ).sigma


PRIOR_SIGMA = 1e-3 * IN_G
"""Distribution of the units, 1-sigma; the gyro bias is uniform within 10 °/h."""
PRIOR_SIGMA[GROUP_SLICES["gyro_bias"]] = 10.0 * DEG_PER_H / np.sqrt(3.0)


def efficient(
    cell: Cell, unit: int, estimators: list[str], *, sample_rate_hz: float = 100.0, innovations: bool = True
) -> Rows:
    """Noisy unit on the 1 mrad fixture, of which all is stated.

    The innovations are those of a second filter, whose prior is the distribution of the units: with the default, very
    wide prior the first innovations would be far smaller than their sigma.
    """
    (grade,) = cell
    seed = 10_000 * (1 + list(GRADES).index(grade)) + unit
    recording, truth = fixture_recording(seed, grade, sample_rate_hz=sample_rate_hz)
    rows = {
        name: replace(score, bound=bound_si(grade))
        for name, score in calibrated(recording, truth.vector, estimators).items()
    }
    if innovations and "ekf" in rows:
        informed = srt.calibrate(recording, "ekf", prior=Prior.from_sigma(PRIOR_SIGMA), checks=False)
        by_sequence = tuple(row.innovations for row in informed.diagnostics.filter or ())
        rows["ekf"] = replace(rows["ekf"], innovations=by_sequence)
    return rows


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


def named_by(found: srt.Calibration) -> tuple[str, ...]:
    """Drift that a result models, findings, and the sequence, the part of the fixture and the moves that it accuses."""
    named = [f"{row.sensor} {row.form}" for row in found.diagnostics.drift or ()]
    named += [finding.fault for finding in found.diagnostics.faults or ()]
    verdict = found.consistency
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
        rows[name] = judged(found, errors)
    return rows


def judged(found: srt.Calibration, errors: dict[str, float]) -> Score:
    """Score of a calibration, with all that it names."""
    return replace(scored(found, truth_of(errors)), faults=named_by(found))


def unstated_noise(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    recording, errors = unstated_unit(unit, *cell)
    able = [name for name in estimators if cell[0] == "fixture" or name != "closed-form"]
    return calibrated(recording, truth_of(errors), able)
