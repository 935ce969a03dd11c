"""Free motion: a unit rotated by hand or by a servo between static poses, without a fixture or known attitudes.

Each turn is about an axis fixed in B; its angle over time is a profile of :mod:`sims.physics.turn_profiles`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sims.physics.fixture import rotation
from sims.physics.integrals import Pieces
from sims.physics.table_motion import check_rotation, check_sample_rate, constants_of_site
from sims.physics.true_motion import Clock, TrueMotion
from sims.physics.turn_profiles import TurnProfile, peak_factor, turn_profile
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from sims.physics.turn_profiles import ProfileName
    from srt.recording.recording import Site
    from srt.types import Array, Indices, Mask


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
    profile: ProfileName = "quintic",
    durations_s: Array | None = None,
    **run: Any,
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
    profile : str
        Profile of every turn, see :mod:`sims.physics.turn_profiles`.
    durations_s : ndarray, shape (m,), optional
        Duration of each turn, s, in place of ``peak_rate_rad_s``.
    sample_rate_hz, earth_rate, start_time_s, rng
        As in :func:`sims.physics.free_motion.placed_motion`.

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
    steps = tuple(
        (Turn(vector, duration if size > 0.0 else 0.0, profile),)
        for vector, size, duration in zip(vectors, sizes.tolist(), durations.tolist(), strict=True)
    )
    placement = Placement(check_rotation(attitude), dwell_s, steps, (dwell_s,) * len(steps))
    return placed_motion((placement,), site=site, settle_s=settle_s, **run)[0]


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Rotation about an axis fixed in B.

    Attributes
    ----------
    vector : ndarray, shape (3,), rad
    duration_s : float
    profile : str or TurnProfile
        A name of :data:`sims.physics.turn_profiles.ProfileName`, or the profile itself.
    """

    vector: Array
    duration_s: float
    profile: ProfileName | TurnProfile = "quintic"

    def shape(self, rng: np.random.Generator | None) -> TurnProfile:
        """Profile of the turn; drawn for "recorded-hand"."""
        if isinstance(self.profile, str):
            return turn_profile(self.profile, float(np.linalg.norm(self.vector)), self.duration_s, rng)
        return self.profile


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A pose that the unit is placed in, and the steps that follow without a gap.

    Attributes
    ----------
    attitude : ndarray, shape (3, 3)
        C_NED,B of the pose.
    rest_s : float
        Rest in the pose, s.
    steps : tuple of tuple of Turn
        Each step is one turn or several without a rest between them.
    rests_s : tuple of float
        Rest after each step, s.
    """

    attitude: Array
    rest_s: float
    steps: tuple[tuple[Turn, ...], ...] = ()
    rests_s: tuple[float, ...] = ()


def placed_motion(
    placements: tuple[Placement, ...],
    *,
    site: Site,
    pause_s: float = 0.0,
    settle_s: float = 0.0,
    sample_rate_hz: float = 200.0,
    earth_rate: bool = True,
    start_time_s: float = 0.0,
    rng: np.random.Generator | None = None,
) -> tuple[TrueMotion, tuple[float, ...]]:
    """Integrals of static poses and turns; the motion from the end of a placement to the next is not recorded.

    Parameters
    ----------
    placements : tuple of Placement
    site : Site
    pause_s : float
        Time to place the unit in the next pose, s.
    settle_s : float
        Settling time between each turn and the following window, s.
    sample_rate_hz, earth_rate, start_time_s
        As in :func:`sims.physics.table_motion.run_schedule`.
    rng : numpy.random.Generator, optional
        Required for the profile "recorded-hand".

    Returns
    -------
    motion : TrueMotion
        Without labels and fixture. ``windows`` are those before and after each step; a placement without a step gives
        the two halves of its pose.
    starts_s : tuple of float
        Beginning of each step's first turn, s; the middle of the pose for a placement without a step.
    """
    constants = constants_of_site(site, earth_rate=earth_rate)
    clock = Clock(check_sample_rate(sample_rate_hz), start_time_s)
    pairs: list[tuple[tuple[float, float], tuple[float, float]]] = []
    attitudes: list[tuple[Array, Array]] = []
    starts: list[float] = []

    def samples(rest_s: float) -> int:
        return max(1, round(rest_s * sample_rate_hz))

    def at(sample: int) -> float:
        return float(clock.at(sample))

    for number, placement in enumerate(placements):
        if number:
            clock.now += int(clock.samples(pause_s))
        attitude, dwell = placement.attitude, samples(placement.rest_s)
        before = at(clock.now), at(clock.now + dwell)
        _record_rest(clock, constants @ attitude, dwell)
        if not placement.steps:
            middle = at(clock.now - dwell // 2)
            pairs.append(((before[0], middle), (middle, before[1])))
            attitudes.append((attitude, attitude))
            starts.append(middle)
        for turns, rest_s in zip(placement.steps, placement.rests_s, strict=True):
            starts.append(at(clock.now))
            old, after = attitude, samples(rest_s)
            for leg, turn in enumerate(turns, start=1):
                still = (settle_s, after) if leg == len(turns) else (0.0, 0)
                _record_turn(clock, constants @ attitude, turn, still, rng)
                attitude = attitude @ rotation(turn.vector)
            end = at(clock.now - after), at(clock.now)
            pairs.append((before, end))
            attitudes.append((old, attitude))
            before = end
    time, piece_starts, integrals = clock.stack()
    motion = TrueMotion(
        time,
        clock.interval,
        piece_starts,
        *integrals,
        windows=tuple(pairs),
        attitudes=np.array(attitudes),
        labels=(),
        site=site,
        fixture=None,
        U=np.eye(3),
        draw=None,
    )
    return motion, tuple(starts)


def _record_turn(
    clock: Clock, constants_b: Array, turn: Turn, still: tuple[float, int], rng: np.random.Generator | None
) -> None:
    """Record a turn, and the settling time (s) and number of samples at rest after it."""
    n_samples = int(clock.samples(turn.duration_s + still[0])) + still[1]
    if turn.duration_s == 0.0:
        _record_rest(clock, constants_b, n_samples)
        return
    profile, total = turn.shape(rng), float(np.linalg.norm(turn.vector))
    axis = turn.vector / total
    along = (constants_b @ axis)[:, np.newaxis] * axis
    along, across, third = (
        vectors.T[..., np.newaxis, np.newaxis] for vectors in (along, constants_b - along, np.cross(axis, constants_b))
    )
    last = len(profile.borders) + 1

    def evaluate(piece: Indices, time: Array) -> Array:
        turning = np.broadcast_to(piece < last, time.shape)
        angle, slope = profile.evaluate(total, np.where(turning, time / turn.duration_s, 1.0))
        # Vectors fixed in space rotate backwards in B.
        sensed = along + np.cos(angle) * across - np.sin(angle) * third
        sensed[:, 0] += np.where(turning, slope, 0.0) / turn.duration_s * axis[:, np.newaxis, np.newaxis]
        return np.asarray(sensed)

    borders = np.array([0.0, *profile.borders, 1.0, math.inf]) * turn.duration_s
    bandwidth = (profile.peak * total + profile.bandwidth) / turn.duration_s
    _record(clock, n_samples, borders, np.arange(last + 1) < last, bandwidth, evaluate)


def _record_rest(clock: Clock, constants_b: Array, n_samples: int) -> None:
    """Record samples at rest, with constant Earth rate (rad/s) and specific force (m/s²) in B, shape (2, 3)."""

    def evaluate(_: Indices, time: Array) -> Array:
        return np.broadcast_to(constants_b.T[..., np.newaxis, np.newaxis], (3, 2, *time.shape))

    _record(clock, n_samples, np.array([0.0, math.inf]), np.array([False]), 0.0, evaluate)


def _record(
    clock: Clock,
    n_samples: int,
    borders_s: Array,
    moving: Mask,
    bandwidth_rad_s: float,
    evaluate: Callable[[Indices, Array], Array],
) -> None:
    """Record an episode, see :class:`sims.physics.integrals.Pieces`."""
    none = np.zeros(len(moving), dtype=np.intp)
    pieces = Pieces(
        none, none + n_samples, borders_s[:-1], borders_s[1:], moving.astype(np.intp), bandwidth_rad_s, evaluate
    )
    clock.record(pieces, np.arange(clock.now, clock.now + n_samples))
