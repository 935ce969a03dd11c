"""Cramér-Rao bound of a test by poses and turns without a fixture, from the nominal motion alone.

*Measurements*: mean readings of gyros and accelerometers in every rest, the rotation that the gyros integrate between
two rests, and the mean rate in runs at a stated rate. *Unknowns*: the free sensor errors, gravity with its sigma, the
attitude of every rest, and the common error of the stated rates with its sigma. White noise only; the derivatives are
those at a unit without errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from srt.sensor_errors import INDEX, NAMES

EARTH_RATE_RAD_S = 7.292115e-5
STEPS = 200
"""Steps of the integral over a rotation."""


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
                for R in part:
                    seen = spin + (attitude * R).inv().apply(earth)
                    rows[:, :n_errors] += R.as_matrix() @ by_errors(free, "gyro", seen) * leg.duration_s / STEPS
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
    """Derivative of a reading of v with respect to the free errors, shape (3, n)."""
    out = np.zeros((3, len(free)))
    for j, name in enumerate(free):
        group, _, axes = name.rpartition("_")
        if not group.startswith(sensor):
            continue
        i = "xyz".index(axes[0])
        kind = group.removeprefix(sensor + "_")
        if kind == "bias":
            out[i, j] = 1.0
        elif kind == "scale":
            out[i, j] = v[i]
        elif kind == "asymmetry":
            out[i, j] = abs(v[i])
        else:
            k = "xyz".index(axes[1])
            out[i, j] = v[k] if kind == "misalignment" else 0.5 * v[k]
            if kind == "orthogonality":
                out[k, j] = 0.5 * v[i]
    return out
