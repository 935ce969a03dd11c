"""Free recordings: a unit turned by hand between poses of stillness, without a fixture or known attitudes.

Each turn is about an axis fixed in B, with an angle that follows the quintic ``θ(s) = Θ (10 s³ − 15 s⁴ + 6
s⁵)``, s = t/T: rate and acceleration vanish at both ends, and the peak rate is 15 Θ / 8 T.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sims.physics.fixture import rotation
from sims.physics.integrals import Episode
from sims.physics.table_motion import check_rotation, check_sample_rate, constants_of_site
from sims.physics.true_motion import Clock, TrueMotion
from srt.exceptions import InputError

if TYPE_CHECKING:
    from srt.recording.recording import Site
    from srt.types import Array, Indices


def random_turns(
    rng: np.random.Generator, count: int, *, smallest_rad: float = math.pi / 3.0, largest_rad: float = math.pi
) -> Array:
    """Draw rotation vectors with isotropic axes and uniform angles, shape (count, 3), rad."""
    axes = rng.standard_normal((count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(axes * rng.uniform(smallest_rad, largest_rad, (count, 1)))


def random_attitude(rng: np.random.Generator) -> Array:
    """Draw an attitude C_NED,B, uniform over all rotations, shape (3, 3)."""
    q = rng.standard_normal(4)
    w, x, y, z = q / np.linalg.norm(q)
    angle = 2.0 * math.atan2(math.hypot(x, y, z), w)
    return rotation(angle * np.array([x, y, z]) / math.hypot(x, y, z))


def free_motion(
    turns: Array,
    *,
    site: Site,
    attitude: Array | None = None,
    peak_rate_rad_s: float = 2.0,
    dwell_s: float = 5.0,
    settle_s: float = 0.0,
    sample_rate_hz: float = 200.0,
    earth_rate: bool = True,
    start_time_s: float = 0.0,
) -> TrueMotion:
    """Stand still, turn, stand still, ... : one pose more than turns.

    Parameters
    ----------
    turns : ndarray, shape (m, 3), rad
        Rotation vectors in B, executed one after the other.
    site : Site
    attitude : ndarray, shape (3, 3), optional
        C_NED,B of the first pose; default identity.
    peak_rate_rad_s : float
        Peak rate of every turn.
    dwell_s : float
        Stillness of every pose, s.
    settle_s : float
        Further stillness, before the window, after each turn, s.
    sample_rate_hz, earth_rate, start_time_s
        As in :func:`sims.physics.table_motion.run_schedule`.

    Returns
    -------
    TrueMotion
        Without labels and fixture; ``windows`` are the poses before and after each turn.
    """
    vectors = np.asarray(turns, dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != 3 or len(vectors) == 0:
        raise InputError(f"Turns are rotation vectors in an array of shape (m, 3), not {vectors.shape}.")
    if peak_rate_rad_s <= 0.0 or dwell_s <= 0.0 or settle_s < 0.0:
        raise InputError("A free recording needs a positive peak rate and dwell, and a settling time not below zero.")
    ned_from_body = check_rotation(attitude)
    constants = constants_of_site(site, earth_rate=earth_rate)
    clock = Clock.start(check_sample_rate(sample_rate_hz), start_time_s)
    dwell = max(1, round(dwell_s * sample_rate_hz))
    clock.record(_turn_episode(constants @ ned_from_body, np.zeros(3), 0.0, dwell))
    poses = [(clock.at(0), clock.at(dwell))]
    attitudes = [ned_from_body]
    for vector in vectors:
        duration = 15.0 / 8.0 * float(np.linalg.norm(vector)) / peak_rate_rad_s
        n_samples = clock.samples(duration + settle_s) + dwell
        clock.record(_turn_episode(constants @ attitudes[-1], vector, duration, n_samples))
        poses.append((clock.at(clock.now - dwell), clock.at(clock.now)))
        attitudes.append(attitudes[-1] @ rotation(vector))
    time, piece_starts, total = clock.stack()
    return TrueMotion(
        time,
        clock.interval,
        piece_starts,
        *total,
        windows=tuple(pairwise(poses)),
        attitudes=np.stack([attitudes[:-1], attitudes[1:]], axis=1),
        labels=(),
        site=site,
        fixture=None,
        U=np.eye(3),
        draw=None,
    )


def _turn_episode(constants_b: Array, vector: Array, duration_s: float, n_samples: int) -> Episode:
    """One turn about a fixed axis and the stillness after it.

    Parameters
    ----------
    constants_b : ndarray, shape (2, 3)
        Earth rate (rad/s) and specific force (m/s²) in B before the turn.
    vector : ndarray, shape (3,), rad
    duration_s : float
    n_samples : int
    """
    total = float(np.linalg.norm(vector))
    axis = vector / total if total > 0.0 else np.array([1.0, 0.0, 0.0])
    along = (constants_b @ axis)[:, np.newaxis] * axis
    across = constants_b - along
    third = np.cross(axis, constants_b)

    def evaluate(piece: Indices, time: Array) -> Array:
        s = np.where(piece == 0, time / duration_s, 1.0) if total > 0.0 else np.ones_like(time)
        angle = (total * s**3 * (10.0 + s * (6.0 * s - 15.0)))[..., np.newaxis]
        rate = (30.0 * total * (s * (1.0 - s)) ** 2)[..., np.newaxis]
        if total > 0.0:
            rate = rate / duration_s
        # Vectors that stand still turn backwards, seen from B.
        earth, force = (along[i] + np.cos(angle) * across[i] - np.sin(angle) * third[i] for i in (0, 1))
        return np.concatenate([earth + rate * axis, force], axis=-1)

    if total == 0.0:
        return Episode(n_samples, np.array([0.0, math.inf]), np.array([False]), 0.0, evaluate)
    # The quintic adds its own frequencies, some turns of phase over its duration, to those of the attitude.
    bandwidth = 15.0 / 8.0 * total / duration_s + 12.0 / duration_s
    return Episode(n_samples, np.array([0.0, duration_s, math.inf]), np.array([True, False]), bandwidth, evaluate)
