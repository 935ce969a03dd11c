"""Errors of a test that gave wrong results without a word: NEES, and how often each is named or called inconsistent.

``python benchmarks/silent_errors.py --units 50`` prints the table of docs/studies/silent-errors.md: vibration, a slow
ramp, unstated flicker noise, axis wobble stated as zero, a wrong clock and wrong gravity, on navigation-grade units. An
error is named if the checks of the recording or the calibration tell it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from joblib import Parallel, delayed
from verdicts import ESTIMATORS, outcome

import srt
from sims.faults.injection import Case
from sims.physics.disturbances import vibrating
from sims.physics.imu import read_out
from sims.physics.table_motion import run_schedule
from sims.scenarios.simulation import schedule_of
from srt.constants import DEG, DEG_PER_H, MICRO_G
from srt.diagnosis.staged_diagnosis import diagnose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sims.physics.true_motion import TrueMotion
    from srt.recording.recording import Recording

    Change = Callable[[Case, np.random.Generator], Recording]

GRADE = "navigation-rlg"
SEED = 20261130
LIMIT = 1.15
"""Mean NEES over 27 that is allowed where an error is neither named nor inconsistent."""
CLOCK, GRAVITY = 1e-4, 342e-6


def vibration(frequency_hz: float, angle_rad: float, force_mg: float) -> Change:
    """Vibration of the table in random directions of the unit."""

    def change(case: Case, rng: np.random.Generator) -> Recording:
        run = case.simulation
        angle, force = (x / np.linalg.norm(x) for x in rng.standard_normal((2, 3)))
        motion = vibrating(
            run.motion,
            frequency_hz,
            angle_rad * angle,
            force_mg * 1e3 * MICRO_G * force,
            phase_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        )
        return again(case, motion, rng)

    return change


def again(case: Case, motion: TrueMotion, rng: np.random.Generator) -> Recording:
    """Recording of another motion by the unit of a case."""
    run = case.simulation
    read = read_out(motion, run.truth, run.imu, rng, kind=run.recording.kind)
    return replace(run.recording, gyro=read.gyro, accel=read.accel, data_sha256=None)


def ramp(case: Case, rng: np.random.Generator) -> Recording:
    """Accelerometer bias of one axis that drifts by 100 µg/h."""
    recording = case.recording
    slope = np.zeros(3)
    slope[rng.integers(3)] = 100.0 * MICRO_G / 3600.0 * rng.choice([-1.0, 1.0])
    time = (recording.time - recording.time.mean())[:, None]
    per_sample = case.simulation.motion.interval if recording.kind == "increment" else 1.0
    return replace(recording, accel=recording.accel + slope * time * per_sample, data_sha256=None)


def flicker(case: Case, rng: np.random.Generator) -> Recording:
    """Bias instability of 0.003 °/h and 2 µg that is not stated; white noise and quantization are."""
    run = case.simulation
    imu = replace(run.imu, gyro_bias_instability=0.003 * DEG_PER_H, accel_bias_instability=2.0 * MICRO_G)
    read = read_out(run.motion, run.truth, imu, rng, kind=run.recording.kind)
    noise = replace(run.recording.noise, gyro_bias_instability=None, accel_bias_instability=None)
    return replace(run.recording, gyro=read.gyro, accel=read.accel, noise=noise, data_sha256=None)


def wobble(case: Case, rng: np.random.Generator) -> Recording:
    """Axes that lean by another 10 µrad in every pose, where the wobble is stated as zero."""
    run, scenario = case.simulation, case.scenario
    assert run.fixture_draw is not None
    assert run.fixture_draw.starts is not None
    assert scenario.schedule is not None
    assert scenario.fixture is not None
    lean = 1e-5 * rng.standard_normal(run.fixture_draw.starts.shape)
    motion = run_schedule(
        schedule_of(scenario.schedule),
        site=run.motion.site,
        sample_rate_hz=scenario.recording.sample_rate_hz,
        heading_rad=scenario.fixture.heading_deg * DEG,
        fixture_draw=replace(run.fixture_draw, wobble=lean),
        U=run.U,
        stated_fixture=run.motion.fixture,
        earth_rate=scenario.site.earth_rate,
        start_time_s=scenario.recording.start_time_s,
    )
    recording = again(case, motion, rng)
    assert recording.fixture is not None
    return replace(recording, fixture=replace(recording.fixture, wobble_sigma_rad=0.0))


def clock(case: Case, _rng: np.random.Generator) -> Recording:
    """Time stamps of a clock that is wrong by 1e-4, about which nothing is stated."""
    recording, factor = case.recording, 1.0 + CLOCK
    labels = tuple(
        replace(
            label,
            start_static_s=tuple(factor * t for t in label.start_static_s),
            end_static_s=tuple(factor * t for t in label.end_static_s),
        )
        for label in recording.sequences
    )
    return replace(recording, time=recording.time * factor, sequences=labels, data_sha256=None)


def gravity(case: Case, _rng: np.random.Generator) -> Recording:
    """Gravity stated 342 ppm too large, as of another height of 1100 m."""
    site = case.recording.site
    return replace(case.recording, site=replace(site, gravity_m_s2=site.gravity_m_s2 * (1.0 + GRAVITY)))


def stated_clock(case: Case, rng: np.random.Generator) -> Recording:
    """The wrong clock with its sigma stated."""
    return replace(clock(case, rng), clock_sigma=CLOCK)


def stated_gravity(case: Case, rng: np.random.Generator) -> Recording:
    """The wrong gravity with its sigma stated."""
    recording = gravity(case, rng)
    site = recording.site
    return replace(recording, site=replace(site, gravity_sigma_m_s2=GRAVITY * site.gravity_m_s2))


@dataclass(frozen=True)
class Row:
    """Error of a test.

    Attributes
    ----------
    change : callable
    findings : tuple of str
        Faults of the recording's checks that name it.
    unseen : str
        Source whose sigma the calibration tells as not stated, with its coefficient; empty for none.
    drift : str
        Sensor whose drift the calibration names; empty for none.
    """

    change: Change
    findings: tuple[str, ...] = ()
    unseen: str = ""
    drift: str = ""


ROWS = {
    "none": Row(lambda case, _rng: case.recording),
    "vibration, 5 µrad and 3 mg at 23 Hz": Row(vibration(23.0, 5e-6, 3.0), ("vibration",)),
    "vibration, 0.3 mrad at 7 Hz": Row(vibration(7.0, 3e-4, 0.0), ("vibration",)),
    "accelerometer ramp, 100 µg/h": Row(ramp, ("accel_bias_drift",), drift="accel"),
    "flicker of 0.003 °/h and 2 µg, not stated": Row(flicker),
    "wobble of 10 µrad, stated as 0": Row(wobble),
    "clock off by 1e-4": Row(clock, unseen="time base"),
    "clock off by 1e-4, sigma stated": Row(stated_clock),
    "gravity off by 342 ppm": Row(gravity, ("gravity",)),
    "gravity off by 342 ppm, sigma stated": Row(stated_gravity),
}


def trial(name: str, unit: int) -> list[tuple[float, bool, bool]]:
    """NEES over n, named and inconsistent, by estimator, of one unit."""
    row, case = ROWS[name], Case(GRADE, SEED + unit)
    recording = row.change(case, np.random.default_rng((SEED, unit)))
    findings = {found.fault for found in diagnose(recording, calibrating=False).findings}
    out = []
    for estimator in ESTIMATORS:
        result = srt.calibrate(recording, estimator, checks=False)
        unseen = {e.source for e in result.diagnostics.unseen_errors or () if e.sigma is None}
        drifting = {term.sensor for term in result.diagnostics.drift or ()}
        named = bool(findings & set(row.findings)) or row.unseen in unseen or row.drift in drifting
        out.append((outcome(result, case).nees, named, result.status == "inconsistent"))
    return out


def table(units: int, names: list[str], jobs: int) -> Iterator[tuple[str, bool]]:
    """Lines of the table, and whether each is silent and wrong."""
    for name in names:
        done = np.array(Parallel(n_jobs=jobs)(delayed(trial)(name, u) for u in range(units)))
        for i, estimator in enumerate(ESTIMATORS):
            nees, named, inconsistent = done[:, i].T
            told = (named + inconsistent) > 0
            silent = nees[~told]
            # The mean of chi-square / 27 over the silent units scatters by the root.
            band = LIMIT + 3.5 * np.sqrt(2.0 / 27.0 / max(len(silent), 1))
            share = f"{named.mean():.0%} | {inconsistent.mean():.0%}"
            line = f"| {name} | {estimator} | {np.nanmean(nees):.2f} | {share} |"
            yield line, bool(len(silent) > 0.05 * units and silent.mean() > band)


def main() -> int:
    """Print the table; 1 if a cell is silent and wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=50)
    parser.add_argument("--rows", nargs="+", default=list(ROWS), choices=list(ROWS))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    print(f"{options.units} units of {GRADE}, seed {SEED}\n")
    print("| error | estimator | NEES/27 | named | inconsistent |\n|---|---|---:|---:|---:|")
    wrong = 0
    for line, silent in table(options.units, options.rows, options.jobs):
        print(line, flush=True)
        wrong += silent
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
