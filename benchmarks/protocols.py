"""Shipped protocols in equal time, for ``honesty.py``: the Cramér-Rao bound of a motion, and simulated units.

Every protocol lasts 600 s, its rests scaled to that, without a fixture: a tactical unit with white noise alone, poses
placed to 1°, turns to 0.5°. The bound is computed from the nominal motion; units without asymmetry are calibrated with
asymmetries fixed at zero, or estimated.

Measurements of the bound: mean readings of gyros and accelerometers in every rest, the rotation that the gyros
integrate between two rests, and the mean rate in runs at a stated rate. Unknowns: the free sensor errors, gravity with
its sigma, the attitude of every rest, and the common error of the stated rates with its sigma. White noise only; the
derivatives are those at a unit without errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from foreign_motion import EARTH_RATE_RAD_S, readings
from scipy.spatial.transform import Rotation
from studies import Cell, Rows, scored

import sims
import srt
from sims.scenarios.scenario import scenario_from_dict
from srt.constants import DEG, DEG_PER_SQRT_H, MICRO_G
from srt.recording.protocol import load_protocol
from srt.sensor_errors import GROUP_SLICES, INDEX, NAMES

if TYPE_CHECKING:
    from srt.recording.protocol import Protocol

PROTOCOLS = (
    "table-1", "19-positions", "11-positions", "7-positions", "9-positions", "two-axis-table", "hand-turned",
    "ferraris", "rate-table", "24-face-tumble", "six-face-tumble",
)  # fmt: skip
ASYMMETRIES = {"fixed": ("gyro_asymmetry", "accel_asymmetry"), "estimated": ()}
"""Parameters fixed at zero, which they are."""
TOTAL_S = 600.0
GYRO_DEG_PER_SQRT_H, ACCEL_UG_PER_SQRT_HZ = 0.05, 50.0
LATITUDE_DEG, GRAVITY_M_S2, GRAVITY_SIGMA_M_S2 = 45.0, 9.80665, 5e-6
FIRST_SEED = 70_000
WIDE_PRIOR = {"scale": 0.1, "orthogonality": 0.1, "misalignment": 0.1, "asymmetry": 0.01}
NOT_SHOWN = 1.0 / 3.0
"""A bound above this share of the prior means that the protocol does not show the parameter."""
STEPS = 200
"""Steps of the integral over a rotation."""


def wide_prior() -> np.ndarray:
    out = np.array([WIDE_PRIOR.get(name.split("_")[1], math.inf) for name in NAMES])
    out[GROUP_SLICES["accel_bias"]], out[GROUP_SLICES["gyro_bias"]] = 1.0, 0.02
    return out


@dataclass(frozen=True)
class Leg:
    """Rotation about a body axis; ``steady_s`` is the time at a stated rate, 0 if none is stated."""

    axis: np.ndarray
    angle_rad: float
    duration_s: float
    steady_s: float = 0.0


@dataclass
class Chain:
    """Rests in a row: attitude of the first (body to north-east-down), their lengths, and the legs between them."""

    start: Rotation
    rests_s: list[float]
    turns: list[list[Leg]] = field(default_factory=list)


@dataclass(frozen=True)
class Conditions:
    """White noise (rad/√s, m/s²·√s), site, and relative sigma of stated rates."""

    gyro: float
    accel: float
    gravity: float
    gravity_sigma: float
    latitude_rad: float
    rate_sigma: float = 1.0


def motion_bound(chains: list[Chain], conditions: Conditions, free: list[str], prior: np.ndarray | None = None):
    """1-sigma bound of the 27 errors, zero for those that are not free.

    ``prior``, shape (27,): 1-sigma of a Gaussian prior of each error, where there is one.
    """
    n_errors = len(free)
    rests = sum(len(chain.rests_s) for chain in chains)
    n = n_errors + 2 + 3 * rests  # errors, gravity, table rate, attitudes as small rotations in the body
    c = conditions
    information = np.zeros((n, n))
    information[n_errors, n_errors] = c.gravity_sigma**-2
    information[n_errors + 1, n_errors + 1] = c.rate_sigma**-2
    if prior is not None:
        at = np.arange(n_errors)
        information[at, at] += prior[[INDEX[name] for name in free]] ** -2.0
    earth = EARTH_RATE_RAD_S * np.array([np.cos(c.latitude_rad), 0.0, -np.sin(c.latitude_rad)])

    def add(rows: np.ndarray, sigma: float) -> None:
        information[...] += rows.T @ rows / sigma**2

    place = n_errors + 2
    for chain in chains:
        attitude = chain.start
        for w, T in enumerate(chain.rests_s):
            at = slice(place, place + 3)
            place += 3
            down, rate = attitude.inv().apply([0.0, 0.0, 1.0]), attitude.inv().apply(earth)
            rows = np.zeros((3, n))
            rows[:, :n_errors] = by_errors(free, "accel", -c.gravity * down)
            rows[:, n_errors], rows[:, at] = -down, cross(-c.gravity * down)
            add(rows, c.accel / np.sqrt(T))
            rows = np.zeros((3, n))
            rows[:, :n_errors], rows[:, at] = by_errors(free, "gyro", rate), cross(rate)
            add(rows, c.gyro / np.sqrt(T))
            if w == len(chain.turns):
                break
            rows, turned, total_s = np.zeros((3, n)), Rotation.identity(), 0.0
            for leg in chain.turns[w]:
                s = (np.arange(STEPS) + 0.5) / STEPS
                part = turned * Rotation.from_rotvec((s * leg.angle_rad)[:, None] * leg.axis)
                spin = leg.angle_rad / leg.duration_s * leg.axis
                seen = by_errors(free, "gyro", spin + (attitude * part).inv().apply(earth))
                rows[:, :n_errors] += np.einsum("nij,njk->ik", part.as_matrix(), seen) * leg.duration_s / STEPS
                if leg.steady_s > 0.0:
                    along = np.zeros((1, n))
                    along[0, :n_errors] = np.sign(leg.angle_rad) * leg.axis @ by_errors(free, "gyro", spin)
                    along[0, n_errors + 1] = np.linalg.norm(spin)
                    add(along, c.gyro / np.sqrt(leg.steady_s))
                turned = turned * Rotation.from_rotvec(leg.angle_rad * leg.axis)
                total_s += leg.duration_s
            # In start axes: error of the integrated rotation = δA_End carried to the start − δA_Strt. The rotation of
            # the Earth in that time changes it by 1e-3 of itself at most.
            rows[:, at] -= np.eye(3)
            rows[:, place : place + 3] = turned.as_matrix()
            add(rows, c.gyro * np.sqrt(total_s))
            attitude = attitude * turned
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale))
    out = np.zeros(len(NAMES))
    out[[INDEX[name] for name in free]] = (np.sqrt(np.diag(covariance)) * scale)[:n_errors]
    return out


def cross(v: np.ndarray) -> np.ndarray:
    """Derivative of components in the body, Aᵀ v, with respect to a small rotation behind A: v ×."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def by_errors(free: list[str], sensor: str, v: np.ndarray) -> np.ndarray:
    """Derivatives of readings of v, shape (..., 3), with respect to the free errors, in which they are linear."""
    flat = v.reshape(-1, 3)
    of_sensor = {"gyro": 0, "accel": 1}[sensor]
    columns = [readings(flat[:, None], flat, {name: 1.0}, None, 1.0, None)[of_sensor] - flat for name in free]
    return np.stack(columns, axis=-1).reshape(*v.shape, len(free))


def chains(protocol: Protocol) -> list[Chain]:
    """Rests and legs of a protocol, each placed pose in some heading."""
    out: list[Chain] = []
    for step in protocol.steps:
        legs = []
        for (axis, angle), duration in zip(step.rotations, step.durations_s(), strict=True):
            ramps = 0.0 if step.turn_s is not None else 2.0 * step.rate_rad_s / step.acceleration_rad_s2
            legs.append(Leg(axis, angle, duration, 0.0 if step.stated_rate_rad_s is None else duration - ramps))
        if step.down is not None:
            first = np.cross(step.down, np.eye(3)[int(np.argmin(np.abs(step.down)))])
            first /= np.linalg.norm(first)
            level = np.stack([first, np.cross(step.down, first), step.down])
            out.append(Chain(Rotation.from_matrix(level), [step.rest_s[0] if legs else step.rest_s[1]]))
        if legs:
            out[-1].turns.append(legs)
            out[-1].rests_s.append(step.rest_s[1])
    return out


@cache
def bound(name: str, fixed: tuple[str, ...]) -> np.ndarray:
    """Bound of the 27 errors, SI; NaN where the protocol does not show them."""
    protocol, prior = load_protocol(name).lasting(TOTAL_S), wide_prior()
    free = [n for n in NAMES if not n.startswith(fixed)] if fixed else list(NAMES)
    if all(step.pose for step in protocol.steps):  # the axes are those of the accelerometers
        free = [n for n in free if n not in ("accel_misalignment_xy", "accel_misalignment_xz", "accel_misalignment_yz")]
    conditions = Conditions(
        GYRO_DEG_PER_SQRT_H * DEG_PER_SQRT_H, ACCEL_UG_PER_SQRT_HZ * MICRO_G, GRAVITY_M_S2, GRAVITY_SIGMA_M_S2,
        LATITUDE_DEG * DEG, protocol.rate_sigma or 1.0,
    )  # fmt: skip
    sigma = motion_bound(chains(protocol), conditions, free, prior)
    return np.where((sigma > 0.0) & (sigma < NOT_SHOWN * prior), sigma, math.nan)


def by_protocol(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    """Scores of a simulated unit by the steps of a protocol, over their bound."""
    name, fixed = cell[0], ASYMMETRIES[cell[1]]
    quiet = dict.fromkeys(("gyro_bias_instability_deg_per_h", "accel_bias_instability_ug"), 0.0)
    noise = {"gyro_noise_deg_per_sqrt_h": GYRO_DEG_PER_SQRT_H, "accel_noise_ug_per_sqrt_hz": ACCEL_UG_PER_SQRT_HZ}
    tables = {
        "seed": FIRST_SEED + unit,
        "imu": {
            "from": "tactical-fog",
            "noise": quiet | noise,
            "errors": {"gyro_asymmetry_ppm": 0.0, "accel_asymmetry_ppm": 0.0},
        },
        "site": {
            "latitude_deg": LATITUDE_DEG, "gravity_m_s2": GRAVITY_M_S2, "gravity_sigma_m_s2": GRAVITY_SIGMA_M_S2,
        },
        "protocol": {"from": name, "total_time_s": TOTAL_S, "settle_s": 0.0},
        "recording": {"sample_rate_hz": 50.0},
    }  # fmt: skip
    run = sims.simulate(scenario_from_dict(tables))
    found = {each: srt.calibrate(run.recording, each, checks=False, hold=fixed) for each in estimators}
    known = {"bound": bound(name, fixed)}
    return {each: replace(scored(result, run.truth.vector), **known) for each, result in found.items()}
