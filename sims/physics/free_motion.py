"""Free motion: a unit rotated by hand or by a servo between static poses, without a fixture or known attitudes.

Each turn is about an axis fixed in B; its angle over time is a profile of :mod:`sims.physics.turn_profiles`.
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
from sims.physics.turn_profiles import TurnProfile, peak_factor, turn_profile
from srt.exceptions import InputError

if TYPE_CHECKING:
    from sims.physics.turn_profiles import ProfileName
    from srt.recording.recording import Site
    from srt.types import Array, Indices


def random_turns(
    rng: np.random.Generator, count: int, *, smallest_rad: float = math.pi / 3.0, largest_rad: float = math.pi
) -> Array:
    """Draw rotation vectors with isotropic axes and uniform angles, shape (count, 3), rad."""
    axes = rng.standard_normal((count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(axes * rng.uniform(smallest_rad, largest_rad, (count, 1)))


def random_durations(rng: np.random.Generator, count: int, shortest_s: float, longest_s: float) -> Array:
    """Draw durations of turns with uniform logarithms, shape (count,), s."""
    return np.asarray(np.exp(rng.uniform(math.log(shortest_s), math.log(longest_s), count)))


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
    profile: ProfileName = "quintic",
    durations_s: Array | None = None,
    rng: np.random.Generator | None = None,
) -> TrueMotion:
    """Integrals of static poses and the turns between them; there is one pose more than turns.

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
        Length of the window of every pose, s.
    settle_s : float
        Settling time between each turn and the following window, s.
    sample_rate_hz, earth_rate, start_time_s
        As in :func:`sims.physics.table_motion.run_schedule`.
    profile : str
        Profile of every turn, see :mod:`sims.physics.turn_profiles`.
    durations_s : ndarray, shape (m,), optional
        Duration of each turn, s, in place of ``peak_rate_rad_s``.
    rng : numpy.random.Generator, optional
        Required for the profile "recorded-hand".

    Returns
    -------
    TrueMotion
        Motion without labels and fixture; ``windows`` are the poses before and after each turn.
    """
    vectors = np.asarray(turns, dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != 3 or len(vectors) == 0:
        raise InputError(f"Turns are rotation vectors in an array of shape (m, 3), not {vectors.shape}.")
    if peak_rate_rad_s <= 0.0 or dwell_s <= 0.0 or settle_s < 0.0:
        raise InputError("A free recording needs a positive peak rate and dwell, and a settling time not below zero.")
    sizes = np.array([np.linalg.norm(vector) for vector in vectors])
    durations = peak_factor(profile) * sizes / peak_rate_rad_s if durations_s is None else np.asarray(durations_s)
    if durations.shape != sizes.shape or not np.all((durations > 0.0) | (sizes == 0.0)):
        raise InputError(
            f"The durations are {durations.tolist()} s: give a positive one for each of {len(sizes)} turns."
        )
    ned_from_body = check_rotation(attitude)
    constants = constants_of_site(site, earth_rate=earth_rate)
    clock = Clock.start(check_sample_rate(sample_rate_hz), start_time_s)
    dwell = max(1, round(dwell_s * sample_rate_hz))
    clock.record(_rest_episode(constants @ ned_from_body, dwell))
    poses = [(clock.at(0), clock.at(dwell))]
    attitudes = [ned_from_body]
    for vector, size, duration in zip(vectors, sizes.tolist(), durations.tolist(), strict=True):
        n_samples = clock.samples((duration if size > 0.0 else 0.0) + settle_s) + dwell
        fixed = constants @ attitudes[-1]
        if size > 0.0:
            shape = turn_profile(profile, size, duration, rng)
            clock.record(_turn_episode(fixed, vector, duration, n_samples, shape))
        else:
            clock.record(_rest_episode(fixed, n_samples))
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


def _rest_episode(constants_b: Array, n_samples: int) -> Episode:
    """Episode at rest with constant Earth rate (rad/s) and specific force (m/s²) in B, shape (2, 3)."""

    def evaluate(_: Indices, time: Array) -> Array:
        return np.broadcast_to(constants_b.ravel(), (*time.shape, 6))

    return Episode(n_samples, np.array([0.0, math.inf]), np.array([False]), 0.0, evaluate)


def _turn_episode(
    constants_b: Array, vector: Array, duration_s: float, n_samples: int, profile: TurnProfile
) -> Episode:
    """Episode of one turn about a fixed axis and the rest after it.

    Parameters
    ----------
    constants_b : ndarray, shape (2, 3)
        Earth rate (rad/s) and specific force (m/s²) in B before the turn.
    vector : ndarray, shape (3,), rad
        Rotation vector, not zero.
    duration_s : float
    n_samples : int
    profile : TurnProfile
    """
    total = float(np.linalg.norm(vector))
    axis = vector / total
    along = (constants_b @ axis)[:, np.newaxis] * axis
    across = constants_b - along
    third = np.cross(axis, constants_b)
    last = len(profile.borders) + 1

    def evaluate(piece: Indices, time: Array) -> Array:
        turning = np.broadcast_to(piece < last, time.shape)
        angle, slope = profile.evaluate(total, np.where(turning, time / duration_s, 1.0))
        angle, rate = angle[..., np.newaxis], (np.where(turning, slope, 0.0) / duration_s)[..., np.newaxis]
        # Vectors fixed in space rotate backwards in B.
        earth, force = (along[i] + np.cos(angle) * across[i] - np.sin(angle) * third[i] for i in (0, 1))
        return np.concatenate([earth + rate * axis, force], axis=-1)

    breaks = np.array([0.0, *(border * duration_s for border in profile.borders), duration_s, math.inf])
    bandwidth = profile.peak * total / duration_s + profile.bandwidth / duration_s
    return Episode(n_samples, breaks, np.arange(last + 1) < last, bandwidth, evaluate)
