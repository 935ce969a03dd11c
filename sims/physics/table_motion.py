"""Runs on the two-axis fixture: stationary window, rotations, settling, stationary window, move to the next start.

Every rotation, every move and every stationary window begins on a sample edge. The end of a rotation is
arbitrary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from sims.physics.fixture import FixtureDraw, FixtureGeometry, earth_rate_ned
from sims.physics.integrals import Pieces, ranges
from sims.physics.motion import AngleProfile, RateProfile, angle_profile
from sims.physics.sequences import INNER, OUTER, TABLE_1, TurnSequence, table_sequences
from sims.physics.true_motion import Clock, TrueMotion
from srt.exceptions import InputError
from srt.recording.recording import Fixture, SequenceLabel, Site

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array, Indices, Mask

Moves = Literal["recorded", "skipped"]
_PAUSE, _MOVE, _DWELL, _TURN = range(4)
"""Episodes of every sequence: rest before the move to its start, move, start window, rotations with the end window."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Sequences of a run and their timing.

    Attributes
    ----------
    sequences : tuple of TurnSequence
        Sequences in the order of execution; repetitions are allowed.
    profile : RateProfile
    dwell_s : float
        Length of every stationary window, rounded to whole samples, s.
    leg_dwell_s : float
        Rest between the rotations within a sequence, s.
    settle_s : float
        Settling time between the end of a rotation or move and the following window, s.
    moves : "recorded" or "skipped"
        Moves to the start attitudes: recorded, or replaced by gaps in time.
    pause_s : float
        Rest between the end of a sequence and the next move, s.
    dwells_s : tuple of (start, end), or None
        Length of start and end window of each sequence, s, instead of ``dwell_s``.
    continued : frozenset of int
        Positions of sequences that start, without a move, from the end window of the one before.

    Raises
    ------
    InputError
        If there is no sequence, a time is not a positive number, or the number of dwells differs.
    """

    sequences: tuple[TurnSequence, ...]
    profile: RateProfile = field(default_factory=RateProfile)
    dwell_s: float = 10.0
    leg_dwell_s: float = 0.0
    settle_s: float = 0.0
    moves: Moves = "skipped"
    pause_s: float = 1.0
    dwells_s: tuple[tuple[float, float], ...] | None = None
    continued: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        if not self.sequences:
            raise InputError("The schedule names no sequence: name at least one.")
        if not (math.isfinite(self.dwell_s) and self.dwell_s > 0.0):
            raise InputError(f"The schedule's dwell_s is {self.dwell_s!r}: it must be a positive number of seconds.")
        for name in ("leg_dwell_s", "settle_s", "pause_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(
                    f"The schedule's {name} is {value!r}: it must be zero or a positive number of seconds."
                )
        dwells, count = self.window_lengths_s(), len(self.sequences)
        if len(dwells) != count:
            raise InputError(
                f"The schedule's dwells_s has {len(dwells)} entries for {count} sequences: give one for each."
            )
        for number, pair in enumerate(dwells, start=1):
            if len(pair) != 2 or not all(math.isfinite(value) and value > 0.0 for value in pair):
                raise InputError(
                    f"The schedule's dwells_s has {pair!r} for sequence {number}: give the start and the end window's "
                    "length, two positive numbers of seconds."
                )

    def window_lengths_s(self) -> tuple[tuple[float, float], ...]:
        """Length of each sequence's start and end window, s."""
        return ((self.dwell_s, self.dwell_s),) * len(self.sequences) if self.dwells_s is None else self.dwells_s


class _Nominal(NamedTuple):
    """Sequences without errors: start angles, shape (s, 2), rad; axis and angle (rad) of each leg, shape (s, l)."""

    start_rad: Array
    axis: Indices
    turn_rad: Array
    executed: Mask  # False beyond the last leg of a sequence


@lru_cache(maxsize=8)
def _nominal(sequences: tuple[TurnSequence, ...]) -> _Nominal:
    legs = [sequence.fixture_legs() for sequence in sequences]
    # Two legs at least, as a move has
    executed = np.array([[k < len(own) for k in range(max(2, *map(len, legs)))] for own in legs])
    axis, turn_rad = np.zeros(executed.shape, dtype=np.intp), np.zeros(executed.shape)
    axis[executed], turn_rad[executed] = np.array([leg for own in legs for leg in own]).reshape(-1, 2).T
    return _Nominal(np.array([sequence.start_rad() for sequence in sequences]), axis, turn_rad, executed)


def _executed(schedule: Schedule, draw: FixtureDraw) -> tuple[AngleProfile, Array]:
    """Execute s sequences with these errors: angles over their 4 s episodes; start and end angles, shape (s, 2, 2)."""
    nominal, count = _nominal(schedule.sequences), len(schedule.sequences)
    turn_rad = nominal.turn_rad.copy()
    if draw.legs is not None:
        turn_rad[nominal.executed] += np.concatenate(draw.legs)
    way = np.stack([np.sum(turn_rad * (nominal.axis == axis), axis=1) for axis in (INNER, OUTER)], axis=1)
    start = nominal.start_rad + (0.0 if draw.starts is None else draw.starts)
    for number in sorted(schedule.continued):
        start[number] = start[number - 1] + way[number - 1]
    end = start + way
    previous = np.concatenate([start[:1], end[:-1]])
    # The smaller angle about each axis: the full turns that a move omits do not change the attitude.
    moves = [math.remainder(angle, 2.0 * math.pi) for angle in (start - previous).ravel().tolist()]

    turns, rest_s = np.zeros((2, count, 4, turn_rad.shape[1]))
    axes = np.zeros(turns.shape, dtype=np.intp)
    turns[:, _MOVE, :2], axes[:, _MOVE, :2] = np.reshape(moves, (-1, 2)), (INNER, OUTER)
    turns[:, _TURN], axes[:, _TURN] = turn_rad, nominal.axis
    rest_s[:, _TURN, 1:] = schedule.leg_dwell_s * nominal.executed[:, 1:]
    begin = np.stack([previous, previous, start, start], axis=1).reshape(-1, 2)
    shape = len(begin), -1
    profile = angle_profile(
        begin, axes.reshape(shape), turns.reshape(shape), schedule.profile, rest_s=rest_s.reshape(shape)
    )
    return profile, np.stack([start, end], axis=1)


def _timed(schedule: Schedule, profile: AngleProfile, clock: Clock) -> tuple[Indices, Indices]:
    """Sample intervals of each episode, shape (s, 4), and edges of start and end windows, shape (s, 2, 2)."""
    dwell = np.maximum(1, np.rint(np.array(schedule.window_lengths_s()) * clock.sample_rate_hz)).astype(np.intp)
    continued = sorted(schedule.continued)
    dwell[continued, 0] = dwell[np.array(continued, dtype=np.intp) - 1, 1]
    samples = clock.samples(profile.legs_end_s + schedule.settle_s).reshape(-1, 4)
    samples[:, _PAUSE], samples[:, _DWELL] = clock.samples(schedule.pause_s), dwell[:, 0]
    samples[:, _TURN] += dwell[:, 1]
    samples[0, [_PAUSE, _MOVE]] = 0
    samples[continued, :_TURN] = 0
    ends = np.cumsum(samples).reshape(-1, 4)[:, [_DWELL, _TURN]]
    return samples, np.stack([ends - dwell, ends], axis=-1)


def _wobble(schedule: Schedule, draw: FixtureDraw, profile: AngleProfile) -> tuple[Array, Array]:
    """Wobble in start and end poses, shape (s, 2); at the border of each piece, and its rate, shape (2, m).

    It changes at a constant rate while an axis turns: as bearings do, it stays while both rest.
    """
    count = len(schedule.sequences)
    if draw.wobble is None:
        return np.zeros((count, 2)), np.zeros(profile.progress.shape)
    turned = np.bincount(profile.legs.episode, minlength=4 * count).reshape(count, 4) > 0
    changes = turned[:, [_MOVE, _TURN]]
    if schedule.moves == "skipped":
        changes[:, 0] = [number not in schedule.continued for number in range(count)]
    latest = np.maximum.accumulate(np.where(changes.ravel(), np.arange(2 * count), 0))
    poses = draw.wobble.ravel()[latest].reshape(count, 2)
    start, end = poses.T
    previous = np.concatenate([start[:1], end[:-1]])
    begin = np.stack([previous, previous, start, start], axis=1).ravel()[profile.episode]
    change = np.stack([0.0 * start, start - previous, 0.0 * start, end - start], axis=1).ravel()[profile.episode]
    return poses, np.stack([begin + change * profile.progress[0], change * profile.progress[1]])


def _sensed(
    geometry: FixtureGeometry, constant_base: Array, profile: AngleProfile, wobble: Array, piece: Indices, time: Array
) -> Array:
    """Rate and specific force in B, see :class:`sims.physics.integrals.Pieces`.

    ``constant_base`` holds the Earth's rate (rad/s) and the specific force at rest (m/s²) in the base, shape (2, 3).
    """
    (inner, inner_rate), (outer, outer_rate) = (profile.angle(axis, piece, time) for axis in (INNER, OUTER))
    lean, lean_rate = wobble[:, piece] if wobble.any() else np.zeros(2)
    if lean_rate.any():
        lean = lean + lean_rate * (time - profile.begin_s[piece])
    at = geometry.turned(inner, outer, lean)
    return geometry.sensed(constant_base, at, inner_rate, outer_rate, lean_rate)


def run_schedule(
    schedule: Schedule,
    *,
    site: Site,
    sample_rate_hz: float = 200.0,
    heading_rad: float = 0.0,
    fixture_draw: FixtureDraw | None = None,
    U: Array | None = None,
    stated_fixture: Fixture | None = None,
    earth_rate: bool = True,
    start_time_s: float = 0.0,
) -> TrueMotion:
    """Execute a schedule on a fixture, and integrate the rate and specific force of an ideal IMU on it.

    Parameters
    ----------
    schedule : Schedule
    site : Site
        Site; without the Earth's rate, its latitude may be None.
    sample_rate_hz : float
    heading_rad : float
        Heading of the table x axis, clockwise from north; the north error of the draw is added.
    fixture_draw : FixtureDraw, optional
        Errors of the fixture and of the run; default: no errors.
    U : ndarray, shape (3, 3), optional
        Rotation from table-mounted components T to B; default identity.
    stated_fixture : Fixture, optional
        Fixture as stated by recordings of this motion; default: the heading, and sigmas of 1 mrad.
    earth_rate : bool
        False: the Earth does not rotate.
    start_time_s : float
        Time at which the first sample's interval begins.

    Raises
    ------
    InputError
        If the draw is for other sequences, U is not a rotation, or the latitude is missing.
    """
    draw = fixture_draw or FixtureDraw()
    draw.check_covers(schedule.sequences)
    geometry = FixtureGeometry.build(heading_rad, draw, check_rotation(U))
    constant_base = constants_of_site(site, earth_rate=earth_rate) @ geometry.base_from_ned.T
    clock = Clock(check_sample_rate(sample_rate_hz), start_time_s)
    profile, angles = _executed(schedule, draw)
    samples, edges = _timed(schedule, profile, clock)
    begin = np.cumsum(samples) - samples.ravel()
    profile = profile.with_ringings(begin, clock.interval)
    leans, wobble = _wobble(schedule, draw, profile)
    recorded = np.where([schedule.moves == "recorded"] * 2 + [True] * 2, samples, 0).ravel()
    pieces = Pieces(
        (np.cumsum(recorded) - recorded)[profile.episode],
        recorded[profile.episode],
        profile.begin_s,
        profile.end_s,
        profile.kind,
        profile.bandwidth_rad_s,
        partial(_sensed, geometry, constant_base, profile, wobble),
    )
    clock.record(pieces, ranges(begin, begin + recorded)[1])
    time, piece_starts, integrals = clock.stack()
    windows = tuple(((a, b), (c, d)) for a, b, c, d in clock.at(edges).reshape(-1, 4).tolist())
    return TrueMotion(
        time,
        clock.interval,
        piece_starts,
        *integrals,
        windows=windows,
        attitudes=geometry.attitude(angles[..., INNER], angles[..., OUTER], leans),
        labels=tuple(_label(s, *pair) for s, pair in zip(schedule.sequences, windows, strict=True)),
        site=site,
        fixture=stated_fixture or Fixture(heading_rad),
        U=check_rotation(U),
        draw=draw,
    )


def _label(sequence: TurnSequence, first: tuple[float, float], second: tuple[float, float]) -> SequenceLabel:
    if sequence.in_table_1:
        return SequenceLabel(first, second, sequence.id)
    if not sequence.rotations:
        return SequenceLabel.of_pose((first[0], second[1]), sequence.id, sequence.down, sequence.along_outer)
    rotations = tuple((axis, math.radians(angle)) for axis, angle in sequence.rotations)
    return SequenceLabel(first, second, sequence.id, sequence.down, sequence.along_outer, rotations)


def table1_motion(
    *,
    site: Site,
    sequences: Sequence[str] = tuple(TABLE_1),
    rate_rad_s: float = 1.0,
    accel_rad_s2: float = 10.0,
    dwell_s: float = 10.0,
    settle_s: float = 0.0,
    moves: Moves = "skipped",
    **run: Any,
) -> TrueMotion:
    """Run sequences of Table 1, stated by their ids; ``run`` has further arguments of :func:`run_schedule`."""
    chosen, profile = table_sequences(tuple(sequences)), RateProfile(rate_rad_s, accel_rad_s2)
    return run_schedule(Schedule(chosen, profile, dwell_s=dwell_s, settle_s=settle_s, moves=moves), site=site, **run)


def constants_of_site(site: Site, *, earth_rate: bool) -> Array:
    """Earth rate (rad/s) and specific force at rest (m/s²) in north, east, down, shape (2, 3)."""
    if not earth_rate:
        rate = np.zeros(3)
    elif site.latitude_rad is None:
        raise InputError(
            "The site has no latitude, so the Earth's rate is unknown: state the latitude, or set earth_rate to False."
        )
    else:
        rate = earth_rate_ned(site.latitude_rad)
    return np.stack([rate, [0.0, 0.0, -site.gravity_m_s2]])


def check_rotation(U: Array | None) -> Array:
    """Return U, or the identity for None; raise InputError unless U is a proper rotation."""
    if U is None:
        return np.eye(3)
    matrix = np.array(U, dtype=np.float64)
    if matrix.shape != (3, 3) or np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-12 or np.linalg.det(matrix) < 0.0:
        raise InputError("U must be a proper rotation matrix of shape (3, 3), orthogonal to 1e-12.")
    return matrix


def check_sample_rate(sample_rate_hz: float) -> float:
    """Return the rate; raise InputError unless it is a positive number."""
    if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0.0):
        raise InputError(f"The sample rate is {sample_rate_hz!r} Hz: it must be a positive number.")
    return sample_rate_hz
