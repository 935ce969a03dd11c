"""Recordings that are worse than what is stated of them, or of which no noise is stated, for ``honesty.py``.

Each case is a fixture less accurate than stated, a unit whose biases move, or readings that no noise model covers. All
come from ``foreign_fixture.py`` and ``foreign_motion.py``, which share nothing with the estimators.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from foreign_fixture import on_fixture, table_1
from foreign_motion import DEG, GRADES, Grade, drawn_errors, drift_course, hand_turns, recording

import srt

if TYPE_CHECKING:
    from collections.abc import Callable

SEED, UNSTATED_SEED = 20261128, 20261127
HZ = 50.0
AT_REST_RAD_S = 0.1 * DEG
HAND_RESTS_S = {"hand": 4.0, "long hand": 14.0}
"""Rest between 24 turns by hand; the longer ones make recordings of 500 s."""
INSTABILITY = {
    "navigation": (0.003 * DEG / 3600.0, 5e-6 * 9.81),
    "tactical": (0.5 * DEG / 3600.0, 20e-6 * 9.81),
    "industrial": (5.0 * DEG / 3600.0, 50e-6 * 9.81),
    "consumer": (15.0 * DEG / 3600.0, 150e-6 * 9.81),
}
"""Allan floor of gyros and accelerometers, rad/s and m/s²."""
STATEMENTS = ("nothing, none", "nothing, instability", "all, instability")
"""Statement of the noise, and bias instability of the unit."""
LONGEST_S = 6000.0
"""Longest period of the bias instability."""


class Case(NamedTuple):
    """One kind of recording.

    ``disturbed`` changes the readings, and by ``shift_sigmas`` of the noise of a reading all biases; ``true_sigma_rad``
    is the accuracy of the fixture, ``stated_sigma_rad`` that which the recording states; ``noise_stated`` states all
    noise of the unit, else nothing of it. The alignment of the fixture and its wobble can have another accuracy. Of
    Table 1 only the sequences ``recorded`` are labelled, or all.
    """

    grade: str
    disturbed: Callable[[srt.Recording, np.random.Generator], srt.Recording]
    shift_sigmas: float = 0.0
    motion: str = "fixture"
    true_sigma_rad: float = 1e-3
    stated_sigma_rad: float = 1e-3
    noise_stated: bool = True
    alignment_rad: float | None = None
    wobble_rad: float | None = None
    recorded: tuple[str, ...] = ()


def as_it_is(unit: srt.Recording, _: np.random.Generator) -> srt.Recording:
    """Readings without a disturbance."""
    return unit


MG = 1e-3 * 9.80665
DEG_PER_H = DEG / 3600.0


def drifting(
    form: str, accel_mg: float = 0.0, gyro_deg_h: float = 0.0, *, temperature: bool = False
) -> Callable[[srt.Recording, np.random.Generator], srt.Recording]:
    """Change of the biases of both triads in random directions, zero on average in the stationary windows.

    A "step" is that of one channel at a quarter of the recording. ``temperature`` records one that follows the drift.
    """

    def disturbed(unit: srt.Recording, rng: np.random.Generator) -> srt.Recording:
        directions = rng.normal(size=(2, 3))
        if form == "step":
            course = (unit.time > 0.25 * unit.time[-1]).astype(float)
            directions = np.eye(3)[rng.integers(3, size=2)]
        else:
            course = drift_course(form, unit.time, [(0.0, unit.time[-1])], rng)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        at_rest = np.linalg.norm(unit.gyro, axis=1) < AT_REST_RAD_S
        if unit.sequences:
            spans = np.concatenate([(s.start_static_s, s.end_static_s) for s in unit.sequences])
            at_rest = np.any([(unit.time > a) & (unit.time <= b) for a, b in spans], axis=0)
        course = (course - course[at_rest].mean())[:, None]
        accel, gyro = directions * np.array([[accel_mg * MG], [gyro_deg_h * DEG_PER_H]])
        recorded = 25.0 + 5.0 * course[:, 0] if temperature else None
        return replace(unit, accel=unit.accel + course * accel, gyro=unit.gyro + course * gyro, temperature=recorded)

    return disturbed


def vibrating(unit: srt.Recording, rng: np.random.Generator) -> srt.Recording:
    """Angular vibration of 0.3 mrad at 7 Hz about a direction of the unit: its rate, and gravity in turned axes."""
    omega, amplitude = 2.0 * math.pi * 7.0, 0.3e-3
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    ends = np.append(unit.time[0] - 1.0 / HZ, unit.time)
    # Readings are means over the sampling interval.
    angle = amplitude * np.sin(omega * ends)
    mean = -amplitude * np.diff(np.cos(omega * ends)) / omega * HZ
    rate = (np.diff(angle) * HZ)[:, None] * direction
    # A body that is turned by θ n reads f − θ n × f.
    force = unit.accel - mean[:, None] * np.cross(direction, unit.accel)
    return replace(unit, gyro=unit.gyro + rate, accel=force)


def in_steps(rounding: Callable[[np.ndarray], np.ndarray], sigmas: float) -> Callable[..., srt.Recording]:
    """Readings in steps of so many standard deviations of their noise."""

    def read(unit: srt.Recording, _: np.random.Generator) -> srt.Recording:
        noise = (unit.noise.gyro_noise, unit.noise.accel_noise)
        steps = [sigmas * value * math.sqrt(HZ) for value in noise]
        gyro, accel = (rounding(x / q) * q for x, q in zip((unit.gyro, unit.accel), steps, strict=True))
        return replace(unit, gyro=gyro, accel=accel)

    return read


CASES: dict[str, Case] = {
    "fixture of 1 mrad, 0.1 stated": Case("tactical", as_it_is, stated_sigma_rad=1e-4),
    "fixture, no drift": Case("tactical", as_it_is),
    "fixture, accelerometer warm-up of 4 mg": Case("tactical", drifting("warm-up", 4.0)),
    "fixture, the same, temperature recorded": Case("tactical", drifting("warm-up", 4.0, temperature=True)),
    "navigation on a fixture, warm-up of 1 mg": Case("navigation", drifting("warm-up", 1.0)),
    "navigation on a fixture, linear, 4 mg and 300 °/h": Case("navigation", drifting("linear", 4.0, 300.0)),
    "fixture, accelerometer step of 0.4 mg": Case("tactical", drifting("step", 0.4)),
    "fixture, gyro step of 30 °/h": Case("tactical", drifting("step", gyro_deg_h=30.0)),
    "hand, no drift": Case("tactical", as_it_is, motion="hand"),
    "hand, accelerometers linear, 4 mg": Case("tactical", drifting("linear", 4.0), motion="hand"),
    "hand, 500 s, linear, 8 mg and 570 °/h": Case("tactical", drifting("linear", 8.0, 570.0), motion="long hand"),
    "hand, accelerometer step of 0.4 mg": Case("tactical", drifting("step", 0.4), motion="hand"),
    "hand, gyro step of 30 °/h": Case("tactical", drifting("step", gyro_deg_h=30.0), motion="hand"),
    "vibration of 0.3 mrad at 7 Hz, nothing stated": Case("tactical", vibrating, noise_stated=False),
    "no vibration, nothing stated": Case("tactical", as_it_is, noise_stated=False),
    "steps of half a noise sigma": Case("tactical", in_steps(np.round, 0.5)),
    "steps of three noise sigma": Case("tactical", in_steps(np.round, 3.0)),
    "steps of three noise sigma, nothing stated": Case("tactical", in_steps(np.round, 3.0), noise_stated=False),
    "truncated toward zero, half a noise sigma": Case("tactical", in_steps(np.trunc, 0.5)),
    "truncated toward zero, three noise sigma": Case("tactical", in_steps(np.trunc, 3.0)),
    "truncated downwards, half a noise sigma": Case("tactical", in_steps(np.floor, 0.5), -0.25),
    "fixture of 1 mrad, 0.1 stated, navigation grade": Case("navigation", as_it_is, stated_sigma_rad=1e-4),
    "rotations of 1 mrad, 0.1 stated": Case("tactical", as_it_is, stated_sigma_rad=1e-4, alignment_rad=1e-4),
    "alignment of 1 mrad, 0.1 stated": Case(
        "tactical", as_it_is, true_sigma_rad=1e-4, stated_sigma_rad=1e-4, alignment_rad=1e-3
    ),
    "axis wobble of 1 mrad, not stated": Case("tactical", as_it_is, wobble_rad=1e-3),
    "fixture of 1 mrad, 0.1 stated, without 1, 1a, 4, 5, 6, 10, 11, 12": Case(
        "tactical", as_it_is, stated_sigma_rad=1e-4,
        recorded=("2", "2a", "3", "3a", "7", "8", "9", "13", "14", "15", "16", "17"),
    ),
    "fixture of 1 mrad, 0.1 stated, 2, 2a, 7, 8, 9 alone": Case(
        "tactical", as_it_is, stated_sigma_rad=1e-4, recorded=("2", "2a", "7", "8", "9")
    ),
}  # fmt: skip
"""Cases by name."""


Unit = tuple[srt.Recording, dict[str, float]]
"""A recording, and the errors of its unit."""


def on_stand(errors: dict[str, float], grade: Grade, rng, case: Case, noise: srt.ImuNoise) -> srt.Recording:
    """Table 1 on the fixture of a case."""
    accuracy = {"sigma_rad": case.true_sigma_rad, "alignment_rad": case.alignment_rad, "wobble_rad": case.wobble_rad}
    motion = on_fixture(table_1(), rng, rest_s=10.0, rate_rad_s=60.0 * DEG, **accuracy)
    stated = {"stated_rad": case.stated_sigma_rad, "noise": noise, "recorded": case.recorded}
    return motion.recording(errors, grade, rng, hz=HZ, **stated)


def unit_of(case: Case, seed: int) -> Unit:
    """One unit of a case."""
    rng = np.random.default_rng((SEED, seed))
    grade = GRADES[case.grade]
    errors = drawn_errors(grade, rng)
    noise = srt.ImuNoise(grade.gyro_rad_per_sqrt_s, grade.accel_m_s2_sqrt_s, 0.0, 0.0, 0.0, 0.0)
    if case.motion in HAND_RESTS_S:
        turns = hand_turns(rng, shortest_s=1.0, count=24, rest_s=HAND_RESTS_S[case.motion])
        unit = replace(recording(turns, 5.0, errors, grade, rng), noise=noise)
    else:
        unit = on_stand(errors, grade, rng, case, noise)
    for sensor, white in (("gyro", grade.gyro_rad_per_sqrt_s), ("accel", grade.accel_m_s2_sqrt_s)):
        for axis in "xyz":
            errors[f"{sensor}_bias_{axis}"] += case.shift_sigmas * white * math.sqrt(HZ)
    unit = case.disturbed(unit, rng)
    return (unit if case.noise_stated else replace(unit, noise=srt.ImuNoise())), errors


def flicker(floor: float, count: int, rng) -> np.ndarray:
    """Flicker noise with an Allan floor, shape (count, 3): two-sided spectrum floor² / (4 ln 2 |f|)."""
    n = max(count, int(LONGEST_S * HZ))
    f = np.fft.rfftfreq(n, 1.0 / HZ)[1:]
    size = floor * np.sqrt(n * HZ / (8.0 * math.log(2.0) * f))
    part = size * (rng.standard_normal((3, len(f))) + 1j * rng.standard_normal((3, len(f))))
    return np.fft.irfft(np.concatenate([np.zeros((3, 1)), part], axis=1), n)[:, :count].T


def unstated_unit(seed: int, motion: str, grade: str, statement: str = STATEMENTS[0]) -> Unit:
    """One unit on a fixture of 1 mrad, or turned by hand, by a statement of its noise."""
    rng = np.random.default_rng((UNSTATED_SEED, 2 if motion == "hand" else 1, seed))
    white, floors = GRADES[grade], INSTABILITY[grade]
    errors = drawn_errors(white, rng)
    if motion == "hand":
        unit = recording(hand_turns(rng, shortest_s=1.0), 5.0, errors, white, rng)
    else:
        unit = on_stand(errors, white, rng, Case(grade, as_it_is), srt.ImuNoise())
    if statement != STATEMENTS[0]:
        rng = np.random.default_rng((UNSTATED_SEED, 3, seed))
        gyro, accel = (flicker(floor, len(unit.gyro), rng) for floor in floors)
        unit = replace(unit, gyro=unit.gyro + gyro, accel=unit.accel + accel)
    if statement == STATEMENTS[2]:
        noise = srt.ImuNoise(white.gyro_rad_per_sqrt_s, white.accel_m_s2_sqrt_s, 0.0, 0.0, *floors)
        unit = replace(unit, noise=noise)
    return unit, errors
