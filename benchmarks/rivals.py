"""Our estimators beside imucal's Ferraris calibration, on the same simulated units and fixtures, for ``honesty.py``.

A tactical unit on a fixture with errors is calibrated by the 17 sequences with four estimators, and by faces and full
turns of the same total time with imucal, which also gets those samples of the 17 sequences that fit its method. Every
unit comes with and without asymmetry, which imucal does not know.
"""

from __future__ import annotations

import math
from dataclasses import replace
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np
from accuracy_trials import GRADES, SITE, fixture_errors, normal_errors, true_site
from ferraris import (
    TABLE_1_FACES,
    TABLE_1_TURN_RAD,
    TABLE_1_TURNS,
    TURN_RAD,
    Take,
    face_seconds,
    ferraris_motions,
    imucal_errors,
    signal_regions,
)
from studies import ESTIMATORS, Cell, Rows, Score, scored

import srt
from sims.physics.imu import read_out
from sims.physics.motion import RateProfile
from sims.physics.table_motion import table1_motion
from srt.constants import DEG_PER_H
from srt.recording.recording import Fixture
from srt.sensor_errors import GROUP_SLICES, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Iterable

FIXTURES_MRAD = (0.1, 1, 5)
"""1-sigma errors of the fixtures: a precise one, the paper's, a bench."""
SAMPLE_RATE_HZ = 100.0
DWELL_S = 10.0
"""Length of every stationary window, s, as in the paper."""
FIRST_SEED = 60_000
"""Seed of the first unit: apart from the seeds of the other studies."""
ASYMMETRIES = ("gyro_asymmetry", "accel_asymmetry")
HELD, IMUCAL, IMUCAL_SAME = "graph, asymmetry fixed", "imucal", "imucal, same samples"
OURS: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {}) for name in ESTIMATORS},
    HELD: ("graph", {"hold": ASYMMETRIES}),
}
"""Our estimators and their options. The last one assumes no asymmetry, as imucal does."""
METHODS = (*OURS, IMUCAL, IMUCAL_SAME)
NO_ASYMMETRY, ASYMMETRIC = "no asymmetry", "asymmetry 1e-3"
POPULATIONS = (NO_ASYMMETRY, ASYMMETRIC)
PROFILE = RateProfile(1.0, 10.0)
"""Rotations of the fixture: 1 rad/s, 10 rad/s²."""


def without_asymmetry(errors: SensorErrors) -> SensorErrors:
    vector = errors.vector.copy()
    for group in ASYMMETRIES:
        vector[GROUP_SLICES[group]] = 0.0
    return SensorErrors(vector)


def takes(seed: int, sigma_rad: float, population: str) -> tuple[SensorErrors, list[Take], int]:
    """Unit, its takes of the 17 sequences, of faces and of turns, and the duration of a face, s.

    Unit, gravity, noise and the draw of the fixture's errors, which ``sigma_rad`` makes larger or smaller, are those of
    the seed in both populations.
    """
    for_unit, for_fixture, for_ferraris, for_noise = np.random.default_rng(seed).spawn(4)
    truth, site = normal_errors(for_unit, 1e-3, 10.0 * DEG_PER_H), true_site(for_unit)
    fixture = fixture_errors(for_fixture, sigma_rad)
    motion = table1_motion(
        site=site, rate_rad_s=PROFILE.rate_rad_s, accel_rad_s2=PROFILE.accel_rad_s2, dwell_s=DWELL_S,
        sample_rate_hz=SAMPLE_RATE_HZ, fixture_draw=fixture, stated_fixture=Fixture(0.0, sigma_rad, sigma_rad),
    ).stated_as(site=SITE)  # fmt: skip
    face_s = math.floor(face_seconds(len(motion.time) / SAMPLE_RATE_HZ, PROFILE))
    faces_and_turns = ferraris_motions(
        site=site, face_s=face_s, profile=PROFILE, sample_rate_hz=SAMPLE_RATE_HZ, fixture_draw=fixture,
        rotation_sigma_rad=sigma_rad, rng=for_ferraris,
    )  # fmt: skip
    truth = truth if population == ASYMMETRIC else without_asymmetry(truth)
    motions = motion, *faces_and_turns
    noise = [np.random.default_rng(s) for s in for_noise.integers(2**63, size=len(motions))]
    made = [Take(read_out(m, truth, GRADES["tactical"], rng), m.windows) for m, rng in zip(motions, noise, strict=True)]
    return truth, made, face_s


def beside_imucal(cell: Cell, unit: int, methods: Iterable[str]) -> Rows:
    """Scores of a unit; those of imucal have no sigma, and no asymmetry."""
    population, fixture_mrad = cell
    truth, (table_1, *own), face_s = takes(FIRST_SEED + unit, 1e-3 * fixture_mrad, population)
    same = {"face_s": 2.0 * DWELL_S, "face_picks": TABLE_1_FACES, "turn_picks": TABLE_1_TURNS}
    regions = {
        IMUCAL: (signal_regions(*own, face_s=face_s), TURN_RAD),
        IMUCAL_SAME: (signal_regions(table_1, table_1, **same), TABLE_1_TURN_RAD),
    }
    rows = {}
    for method in methods:
        if method == HELD and population == ASYMMETRIC:  # its assumption is wrong
            continue
        began = process_time()
        if method in OURS:
            name, options = OURS[method]
            found = srt.calibrate(replace(table_1.recording), name, checks=False, **options)
        else:
            samples, turn_rad = regions[method]
            known = {"sample_rate_hz": SAMPLE_RATE_HZ, "gravity_m_s2": SITE.gravity_m_s2, "turn_rad": turn_rad}
            found = imucal_errors(samples, **known)
        spent = process_time() - began
        if isinstance(found, SensorErrors):
            error = found.vector - truth.vector
            for group in ASYMMETRIES:
                error[GROUP_SLICES[group]] = math.nan
            score = Score("converged", error=error)
        else:
            score = scored(found, truth.vector)
        rows[method] = replace(score, seconds=spent)
    return rows
