"""Recordings of a generator that shares nothing with the simulator or the estimators: turned units without labels.

Every turn is one rotation about an axis of the body that keeps its direction, with a profile of its own; the attitude
follows from scipy's rotations at sub-sample steps, and the readings from the model of the sensor errors written out
here (Savage 2020, eqs. 6-7 with asymmetry). Truth is the vector of the 27 errors in MARS.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY_M_S2 = 9.79468
EARTH_RATE_RAD_S = 7.292115e-5
SUBSTEPS = 8
"""Attitude steps per sample: the mean specific force of a sample is then right to 1e-9 of g at 3 rad/s and 100 Hz."""

DEG = np.pi / 180.0

PROFILES = ("raised-cosine", "trapezoid", "constant-rate", "hand")
SHAKING = "shaking hand"
"""Another profile: the hand trembles in every turn, and sets the unit down with a knock."""


@dataclass(frozen=True)
class Grade:
    """Noise of a unit: angle random walk, velocity random walk, and sizes of its errors before calibration."""

    gyro_rad_per_sqrt_s: float
    accel_m_s2_sqrt_s: float
    scale: float
    angle_rad: float
    gyro_bias_rad_s: float
    accel_bias_m_s2: float


GRADES = {
    "navigation": Grade(0.002 * DEG / 60.0, 10e-6 * 9.81, 1e-4, 1e-3, 0.1 * DEG / 3600.0, 1e-3),
    "tactical": Grade(0.05 * DEG / 60.0, 50e-6 * 9.81, 1e-3, 2e-3, 2.0 * DEG / 3600.0, 1e-2),
    "industrial": Grade(0.2 * DEG / 60.0, 100e-6 * 9.81, 3e-3, 5e-3, 50.0 * DEG / 3600.0, 3e-2),
    "consumer": Grade(0.5 * DEG / 60.0, 200e-6 * 9.81, 1e-2, 1e-2, 0.3 * DEG, 0.2),
}


@dataclass(frozen=True)
class Turn:
    """Rotation about a body axis, and the rest after it."""

    axis: tuple[float, float, float]
    angle_rad: float
    duration_s: float
    rest_s: float


def angle_share(profile: str, s: np.ndarray) -> np.ndarray:
    """Share of the angle turned after the share s of the time."""
    s = np.clip(s, 0.0, 1.0)
    if profile == "constant-rate":
        return s
    if profile == "trapezoid":  # a fifth of the time each to start and to stop
        r, v = 0.2, 1.0 / 0.8
        up, down = 0.5 * v * s**2 / r, 1.0 - 0.5 * v * (1.0 - s) ** 2 / r
        return np.where(s < r, up, np.where(s > 1.0 - r, down, v * (s - 0.5 * r)))
    return 0.5 * (1.0 - np.cos(np.pi * s))


def attitudes(turns: list[Turn], start: Rotation, first_rest_s: float, dt: float, profile: str, rng) -> Rotation:
    """Body to local level axes at every sub-sample step, the first one included."""
    step = dt / SUBSTEPS
    begins = np.cumsum([first_rest_s, *(turn.duration_s + turn.rest_s for turn in turns)])
    n = round(begins[-1] / dt) * SUBSTEPS
    t = step * np.arange(n + 1)
    edges = [*np.searchsorted(t, begins[:-1]).tolist(), n + 1]
    parts, attitude = [Rotation.from_quat(np.tile(start.as_quat(), (edges[0], 1)))], start
    for turn, begin, (a, b) in zip(turns, begins[:-1], pairwise(edges), strict=True):
        s = (t[a:b] - begin) / turn.duration_s
        s = s[: np.searchsorted(s, 1.0) + 1]  # the first step at rest stands for all of them
        vector = np.array(turn.axis) / np.linalg.norm(turn.axis) * turn.angle_rad
        moved = attitude * Rotation.from_rotvec(angle_share(profile, s)[:, None] * vector)
        if profile in (
            "hand",
            SHAKING,
        ):  # a hand leads the body astray by some degrees on the way, and comes back to rest
            bump = np.where((s > 0.0) & (s < 1.0), np.sin(np.pi * np.clip(s, 0.0, 1.0)) ** 3, 0.0)
            waves = rng.normal(0.0, 0.05, (3, 3))
            stray = bump[:, None] * (np.sin(2.0 * np.pi * np.outer(np.clip(s, 0.0, 1.0), [1.0, 2.3, 3.7])) @ waves)
            moved = moved * Rotation.from_rotvec(stray)
        if profile == SHAKING:
            moved = moved * Rotation.from_rotvec(bump[:, None] * tremor(s * turn.duration_s, rng))
        parts += [moved, Rotation.from_quat(np.tile(moved[-1].as_quat(), (b - a - len(s), 1)))]
        attitude = attitude * Rotation.from_rotvec(vector)
    whole = Rotation.concatenate(parts)
    assert len(whole) == n + 1, (len(whole), n + 1)
    return whole


def tremor(time: np.ndarray, rng) -> np.ndarray:
    """Rotation vectors of a tremor of 4 to 12 Hz and some 0.3°, and of knocks of 1° within 20 to 60 ms, (n, 3), rad."""
    phase = 2.0 * np.pi * (np.outer(time, rng.uniform(4.0, 12.0, 3)) + rng.random(3))
    out = np.sin(phase) @ rng.normal(0.0, 0.2 * DEG, (3, 3))
    for begin, length in zip(rng.uniform(0.2, 0.8, 4) * time[-1], rng.uniform(0.02, 0.06, 4), strict=True):
        share = np.clip((time - begin) / length, 0.0, 1.0)
        out += np.outer(np.sin(np.pi * share) ** 2, rng.normal(0.0, 1.0 * DEG, 3))
    return out


def true_samples(body: Rotation, dt: float, latitude_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean rates of sub-steps and mean specific force of samples, body axes; the level axes are north, east, down."""
    step = dt / SUBSTEPS
    earth = EARTH_RATE_RAD_S * np.array([np.cos(latitude_rad), 0.0, -np.sin(latitude_rad)])
    # All steps of a rest are alike: one of them is computed.
    quaternions = body.as_quat()
    moving = np.any(quaternions[1:] != quaternions[:-1], axis=1)
    own = moving | np.concatenate([[True], moving[:-1]])
    computed, place = np.flatnonzero(own), np.cumsum(own) - 1
    before, after = body[computed], body[computed + 1]
    relative = (before.inv() * after).as_rotvec() / step
    middle = before * Rotation.from_rotvec(0.5 * step * relative)
    rate = relative + middle.inv().apply(earth)
    up = np.array([0.0, 0.0, -GRAVITY_M_S2])
    # Simpson's rule over each sub-step.
    force = (before.inv().apply(up) + 4.0 * middle.inv().apply(up) + after.inv().apply(up)) / 6.0
    n = len(place) // SUBSTEPS
    return rate[place].reshape(n, SUBSTEPS, 3), force[place].reshape(n, SUBSTEPS, 3).mean(axis=1)


def motion_samples(
    turns: list[Turn], start: Rotation, first_rest_s: float, dt: float, latitude_rad: float, profile: str, rng
) -> tuple[np.ndarray, np.ndarray]:
    """Samples of :func:`true_samples` for turns; a motion that several units execute is computed once."""
    motion = (first_rest_s, dt, profile)
    if profile in ("hand", SHAKING):  # they draw random numbers
        return true_samples(attitudes(turns, start, *motion, rng), dt, latitude_rad)
    return _same_motion(tuple(turns), tuple(start.as_quat().tolist()), *motion, latitude_rad)


@lru_cache(maxsize=6)
def _same_motion(
    turns: tuple[Turn, ...], start: tuple[float, ...], first_rest_s: float, dt: float, profile: str, latitude_rad: float
) -> tuple[np.ndarray, np.ndarray]:
    body = attitudes(list(turns), Rotation.from_quat(start), first_rest_s, dt, profile, None)
    rate, force = true_samples(body, dt, latitude_rad)
    rate.flags.writeable = force.flags.writeable = False
    return rate, force


def readings(rate: np.ndarray, force: np.ndarray, errors: dict[str, float], grade: Grade | None, dt: float, rng):
    """Rate and specific force as the unit reads them; ``rate`` at sub-steps, shape (n, s, 3)."""
    e = errors.get
    k = np.array([e(f"gyro_scale_{a}", 0.0) for a in "xyz"])
    xy, yz, zx = (0.5 * e(f"gyro_orthogonality_{p}", 0.0) for p in ("xy", "yz", "zx"))
    gyro_matrix = np.array([[1 + k[0], xy, zx], [xy, 1 + k[1], yz], [zx, yz, 1 + k[2]]])
    accel_matrix = np.eye(3)
    for i, a in enumerate("xyz"):
        accel_matrix[i, i] += e(f"accel_scale_{a}", 0.0)
        for j, b in enumerate("xyz"):
            if i != j:
                accel_matrix[i, j] += e(f"accel_misalignment_{a}{b}", 0.0)
    gyro_asymmetry, accel_asymmetry, gyro_bias, accel_bias = (
        np.array([e(f"{group}_{a}", 0.0) for a in "xyz"])
        for group in ("gyro_asymmetry", "accel_asymmetry", "gyro_bias", "accel_bias")
    )
    gyro = (rate @ gyro_matrix.T + gyro_asymmetry * np.abs(rate)).mean(axis=1) + gyro_bias
    accel = force @ accel_matrix.T + accel_asymmetry * np.abs(force) + accel_bias
    if grade is not None:
        gyro = gyro + rng.normal(0.0, grade.gyro_rad_per_sqrt_s / np.sqrt(dt), gyro.shape)
        accel = accel + rng.normal(0.0, grade.accel_m_s2_sqrt_s / np.sqrt(dt), accel.shape)
    return gyro, accel


@dataclass(frozen=True)
class Extras:
    """Effects that the model of the sensor errors does not have.

    Quadratic terms of the accelerometers (s²/m), position of each accelerometer in body axes (m, row i is
    accelerometer i), and lag of the accelerometers against the gyros (s).
    """

    quadratic: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lever_m: tuple[tuple[float, float, float], ...] = ((0.0,) * 3,) * 3
    lag_s: float = 0.0


# 10, 20, 30 µg/g², lever arms of 1-6 cm and 5 ms, as in the demonstration of PSINS.
PSINS_EXTRAS = Extras(
    (10e-6 / 9.80665, 20e-6 / 9.80665, 30e-6 / 9.80665),
    ((0.01, 0.02, 0.03), (0.04, 0.05, 0.06), (0.02, 0.04, 0.06)),
    5e-3,
)


def with_extras(rate: np.ndarray, force: np.ndarray, extras: Extras, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Specific force of samples at the accelerometers, delayed, and what their quadratic terms add, (n, 3) each."""
    body_rate = rate.mean(axis=1)
    acceleration = np.gradient(body_rate, dt, axis=0)
    lever = np.array(extras.lever_m)
    # a_i = (α × r_i + ω × (ω × r_i))_i for accelerometer i, at its own place.
    spin = np.cross(body_rate[:, None], np.cross(body_rate[:, None], lever)) + np.cross(acceleration[:, None], lever)
    force = force + np.diagonal(spin, axis1=1, axis2=2)
    time = dt * np.arange(len(force))
    force = np.stack([np.interp(time - extras.lag_s, time, f) for f in force.T], axis=1)
    return force, np.array(extras.quadratic) * force**2


def drawn_errors(grade: Grade, rng, *, asymmetry: bool = True) -> dict[str, float]:
    """One unit of a grade."""
    out = {}
    for a in "xyz":
        out[f"gyro_scale_{a}"] = rng.normal(0.0, grade.scale)
        out[f"accel_scale_{a}"] = rng.normal(0.0, grade.scale)
        out[f"gyro_bias_{a}"] = rng.normal(0.0, grade.gyro_bias_rad_s)
        out[f"accel_bias_{a}"] = rng.normal(0.0, grade.accel_bias_m_s2)
        if asymmetry:
            out[f"gyro_asymmetry_{a}"] = rng.normal(0.0, 0.1 * grade.scale)
            out[f"accel_asymmetry_{a}"] = rng.normal(0.0, 0.1 * grade.scale)
    for p in ("xy", "yz", "zx"):
        out[f"gyro_orthogonality_{p}"] = rng.normal(0.0, grade.angle_rad)
    for p in ("xy", "xz", "yx", "yz", "zx", "zy"):
        out[f"accel_misalignment_{p}"] = rng.normal(0.0, grade.angle_rad)
    return out


def hand_turns(
    rng, *, shortest_s: float = 0.5, longest_s: float = 12.0, count: int = 24, rest_s: float = 4.0
) -> list[Turn]:
    """Turns about each body axis in both senses, of a quarter to a full circle, then about random axes."""
    turns = []
    for i in range(count):
        axis = np.eye(3)[i % 3] if i < count // 2 else rng.normal(size=3)
        axis = axis + rng.normal(0.0, 0.1, 3)
        angle = rng.choice([0.5, 1.0, 1.0, 1.5]) * np.pi * (1.0 if (i // 3) % 2 == 0 else -1.0)
        duration = float(np.exp(rng.uniform(np.log(max(shortest_s, 0.15 * abs(angle))), np.log(longest_s))))
        turns.append(Turn(tuple(axis), angle, duration, rest_s * rng.uniform(0.8, 1.5)))
    return turns


START_DEG = (-91.0, 1.0, -91.0)
"""Yaw, pitch and roll at the start of a hand-turned recording, deg."""

NINETEEN_START_DEG = (-91.0, 89.0, 1.0)
"""The same of the 19-position test: x vertical, y and z horizontal to a degree, so that the first turns are seen."""


def nineteen_positions(rest_s: float = 20.0) -> tuple[list[Turn], float]:
    """Turns of the 19-position test (Xie Bo 2011, as PSINS' demonstration has it), and the first rest."""
    text = ["y+"] * 3 + ["y-"] * 3 + ["z+"] + ["x+"] * 3 + ["x-"] * 3 + ["z+"] * 2 + ["z-"] * 3
    rests = [3 * rest_s] + [rest_s] * (len(text) - 1)
    axes = dict(zip("xyz", np.eye(3), strict=True))
    turns = [
        Turn(tuple(axes[w[0]]), (1.0 if w[1] == "+" else -1.0) * 0.5 * np.pi, 9.0, rest)
        for w, rest in zip(text, rests, strict=True)
    ]
    return turns, 3 * rest_s


def windows(turns: list[Turn], first_rest_s: float) -> list[tuple[float, float]]:
    """True rests, s."""
    at, out = first_rest_s, [(0.0, first_rest_s)]
    for turn in turns:
        out.append((at + turn.duration_s, at + turn.duration_s + turn.rest_s))
        at = out[-1][1]
    return out


DRIFT_FORMS = ("linear", "warm-up", "random walk")


def drift_course(form: str, time: np.ndarray, rests: list[tuple[float, float]], rng) -> np.ndarray:
    """Course of a drift over the recording: a change of one (one sigma of a random walk), zero on average at rest."""
    share = time / time[-1]
    if form == "linear":
        course = share
    elif form == "warm-up":
        slowness = rng.uniform(0.1, 0.5)
        course = np.expm1(-share / slowness) / np.expm1(-1.0 / slowness)
    else:
        course = np.cumsum(rng.normal(0.0, 1.0 / np.sqrt(len(time)), len(time)))
    at_rest = np.any([(time > a) & (time <= b) for a, b in rests], axis=0)
    return course - course[at_rest].mean()


def drifting(unit, turns, first_rest_s, rng, *, form="linear", accel_mg=0.0, gyro_deg_h=0.0):
    """A recording with a drift of both triads: a change of given size, in a random direction of the channels."""
    rests = windows(turns, first_rest_s)
    direction = rng.normal(size=(2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    sizes = np.array([accel_mg * 1e-3 * 9.80665, gyro_deg_h * DEG / 3600.0])
    accel, gyro = (
        drift_course(form, unit.time, rests, rng)[:, None] * size * d for size, d in zip(sizes, direction, strict=True)
    )
    return replace(unit, accel=unit.accel + accel, gyro=unit.gyro + gyro)


def recording(
    turns,
    first_rest_s,
    errors,
    grade,
    rng,
    *,
    profile="raised-cosine",
    hz=100.0,
    labelled=False,
    start_deg=START_DEG,
    extras=None,
):
    """A free recording of which no noise is stated, unlabelled unless asked for."""
    import srt

    dt, latitude = 1.0 / hz, 34.0 * DEG
    start = Rotation.from_euler("ZYX", start_deg, degrees=True)
    rate, force = motion_samples(turns, start, first_rest_s, dt, latitude, profile, rng)
    added = 0.0
    if extras is not None:
        force, added = with_extras(rate, force, extras, dt)
    gyro, accel = readings(rate, force, errors, grade, dt, rng)
    accel = accel + added
    labels = ()
    if labelled:
        rests = windows(turns, first_rest_s)
        labels = tuple(srt.SequenceLabel(a, b) for a, b in pairwise((x + 0.05, y - 0.05) for x, y in rests))
    return srt.Recording(
        dt * np.arange(1, len(gyro) + 1), gyro, accel, srt.Site(GRAVITY_M_S2, latitude_rad=latitude), sequences=labels
    )
