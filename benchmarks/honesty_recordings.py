"""Recordings with an error of the test, a drift, or a defect of real logs, for the studies of ``honesty.py``.

Errors of a test change a simulated case (:class:`injected_faults.injection.Case`). Hand-turned units, drifts and
defects come from ``foreign_motion.py``, which shares nothing with the simulator or the estimators. All are drawn from
``rng``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from foreign_motion import DEG, GRADES, PROFILES, drawn_errors, drifting, hand_turns, recording, windows
from scipy.signal import lfilter

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults.disturbances import vibrating
from injected_faults.injection import Case

import srt
from sims.physics.imu import read_out
from sims.physics.table_motion import run_schedule
from sims.scenarios.simulation import schedule_of
from srt.constants import DEG_PER_H, MICRO_G
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from sims.physics.true_motion import TrueMotion

Change = Callable[[Case, np.random.Generator], srt.Recording]
HAND_SEED = 20261122
CLOCK, GRAVITY = 1e-4, 342e-6
LONG_RESTS = {"8, 570": (12, 33.0)}
"""Turns, and rest after each, s, if other than 36 and 5 s: repeated recordings of a sensor array last 500 s."""
COUNTS = 32767
"""Largest count of a signed word of 16 bits."""


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
    rng, white = np.random.default_rng((HAND_SEED, seed)), GRADES[grade]
    errors = drawn_errors(white, rng)
    turns = hand_turns(rng, shortest_s=0.5, longest_s=30.0)
    unit = recording(turns, 5.0, errors, white, rng, profile=profile)
    if stated:
        unit = replace(unit, noise=srt.ImuNoise(white.gyro_rad_per_sqrt_s, white.accel_m_s2_sqrt_s, 0.0, 0.0, 0.0, 0.0))
    return unit, truth_of(errors)


def drifting_unit(
    seed: int, grade: str, form: str, change: str, *, profile: str | None = None
) -> tuple[srt.Recording, np.ndarray]:
    """Unit turned by hand whose biases drift by "mg, °/h" over the recording, and its errors."""
    rng = np.random.default_rng((HAND_SEED, 7, seed))
    errors = drawn_errors(GRADES[grade], rng)
    count, rest_s = LONG_RESTS.get(change, (36, 5.0))
    turns = hand_turns(rng, shortest_s=0.5, longest_s=12.0, count=count, rest_s=rest_s)
    profile = profile or PROFILES[seed % len(PROFILES)]
    unit = recording(turns, rest_s, errors, GRADES[grade], rng, profile=profile)
    accel_mg, gyro_deg_h = map(float, change.split(", "))
    unit = drifting(unit, turns, rest_s, rng, form=form, accel_mg=accel_mg, gyro_deg_h=gyro_deg_h)
    return unit, truth_of(errors)


@dataclass(frozen=True)
class Unit:
    """Recording without a defect, the rests in it, and what draws the defect."""

    recording: srt.Recording
    rests: list[tuple[float, float]]
    rng: np.random.Generator

    def rows(self, interval: tuple[float, float]) -> slice:
        """Samples of an interval."""
        return slice(*np.searchsorted(self.recording.time, interval).tolist())


def clipped_turns(unit: Unit) -> srt.Recording:
    """Two turns exceed the range of the gyros: it is 0.8 of the second largest rate of any turn."""
    gyro = unit.recording.gyro
    turns = [(a[1], b[0]) for a, b in zip(unit.rests, unit.rests[1:], strict=False)]
    limit = 0.8 * np.sort([np.abs(gyro[unit.rows(turn)]).max() for turn in turns])[-2]
    return replace(unit.recording, gyro=np.clip(gyro, -limit, limit))


def shake(unit: Unit) -> srt.Recording:
    """A shake between two rests, at the rails of 16 bits: 741 readings."""
    middle = int(np.searchsorted(unit.recording.time, 0.5 * sum(unit.rests[len(unit.rests) // 2])))
    t = np.arange(130)[:, None] / 100.0
    read = {}
    for sensor, size, largest in (("gyro", 60.0, 2000.0 * DEG), ("accel", 80.0, 4.0 * 9.80665)):
        x, count = getattr(unit.recording, sensor).copy(), largest / COUNTS
        phase = unit.rng.uniform(0.0, 6.0, 3)
        x[middle - 65 : middle + 65] += np.sin(np.pi * t / t[-1]) * size * np.sin(2.0 * np.pi * 4.0 * t + phase)
        read[sensor] = np.clip(np.round(x / count), -COUNTS, COUNTS) * count
    return replace(unit.recording, **read)


def scaled(sensor: str, factor: float) -> Callable[[Unit], srt.Recording]:
    """A wrong value of a count."""
    return lambda unit: replace(unit.recording, **{sensor: factor * getattr(unit.recording, sensor)})


def decimated_increments(unit: Unit) -> srt.Recording:
    """One increment of 4 ms, every 500 ms."""
    every = unit.recording
    step = round(0.5 / every.nominal_interval_s)
    rows = np.arange(step - 1, len(every.time), step)
    gyro, accel = 0.004 * every.gyro[rows], 0.004 * every.accel[rows]
    return replace(every, time=every.time[rows], gyro=gyro, accel=accel, kind="increment")


def autopilot_log(unit: Unit) -> srt.Recording:
    """Samples of 5 ms with stamps to 4 ms, one of 400 lost, and a gap of up to half a second in thirty seconds."""
    every, rng = unit.recording, unit.rng
    keep = rng.random(len(every.time)) > 1.0 / 400.0
    for at in rng.uniform(every.time[0], every.time[-1], round(every.time[-1] / 30.0)):
        keep[unit.rows((at, at + rng.uniform(0.05, 0.5)))] = False
    stamps = np.round(every.time / 0.004) * 0.004
    return replace(every, time=stamps[keep], gyro=every.gyro[keep], accel=every.accel[keep])


def low_pass(time_s: float) -> Callable[[Unit], srt.Recording]:
    """Outputs filtered by the sensor, first order."""

    def filtered(unit: Unit) -> srt.Recording:
        share = -np.expm1(-unit.recording.nominal_interval_s / time_s)
        both = {sensor: getattr(unit.recording, sensor) for sensor in ("gyro", "accel")}
        read = {
            sensor: lfilter([share], [1.0, share - 1.0], x, axis=0, zi=(1.0 - share) * x[:1])[0]
            for sensor, x in both.items()
        }
        return replace(unit.recording, **read)

    return filtered


def off_the_grid(unit: Unit) -> srt.Recording:
    """Readings of 16 bits after a correction that leaves them off their grid."""
    scale = {"gyro": 2000.0 * DEG / COUNTS, "accel": 4.0 * 9.80665 / COUNTS}
    grids = {name: np.round(getattr(unit.recording, name) / s) * s for name, s in scale.items()}
    read = {name: x + unit.rng.normal(0.0, 1e-12, x.shape) for name, x in grids.items()}
    return replace(unit.recording, **read)


@dataclass(frozen=True)
class Defect:
    """Defect of a log, the findings that name it, and the units it is put into."""

    change: Callable[[Unit], srt.Recording]
    named: tuple[str, ...] = ()
    turns: int = 24
    hz: float = 100.0


DEFECTS = {
    "none": Defect(lambda unit: unit.recording),
    "none, 9 turns": Defect(lambda unit: unit.recording, turns=9),
    "2 of 9 turns clipped": Defect(clipped_turns, ("gyro_clipped",), turns=9),
    "shake at ±32767": Defect(shake, ("gyro_clipped",)),
    "count of accelerometers a half": Defect(scaled("accel", 0.5), ("accel_lsb",)),
    "count of accelerometers a quarter": Defect(scaled("accel", 0.25), ("accel_lsb",)),
    "count of gyros twice": Defect(scaled("gyro", 2.0), ("gyro_lsb",)),
    "one increment of 4 ms in 500 ms": Defect(decimated_increments, ("increments_thinned",), hz=250.0),
    "stamps of 4 ms, samples lost, gaps": Defect(autopilot_log, ("gap_in_sequence",), hz=200.0),
    "low-pass filter of 5 ms": Defect(low_pass(0.005)),
    "low-pass filter of 50 ms": Defect(low_pass(0.05)),
    "corrected readings of 16 bits": Defect(off_the_grid),
}


def defective_unit(name: str, seed: int) -> tuple[srt.Recording, np.ndarray]:
    """Consumer unit turned by hand with a defect, and its errors."""
    row, rng, grade = DEFECTS[name], np.random.default_rng((20261123, seed)), GRADES["consumer"]
    errors = drawn_errors(grade, rng)
    turns = hand_turns(rng, shortest_s=1.5, count=row.turns)
    clean = recording(turns, 5.0, errors, grade, rng, hz=row.hz)
    return row.change(Unit(clean, windows(turns, 5.0), rng)), truth_of(errors)
