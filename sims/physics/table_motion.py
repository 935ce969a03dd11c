"""Runs on the two-axis fixture: stationary window, rotations, settling, stationary window, move to the next start.

Every rotation, every move and every stationary window begins on a sample edge. The end of a rotation is
arbitrary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sims.physics.fixture import FixtureDraw, FixtureGeometry, earth_rate_ned
from sims.physics.integrals import Episode
from sims.physics.motion import AngleProfile, JoinedProfile, RateProfile, Ringing, angle_profile
from sims.physics.sequences import INNER, OUTER, TABLE_1, TurnSequence, table_sequences
from sims.physics.true_motion import Clock, TrueMotion
from srt.exceptions import InputError
from srt.recording.recording import Fixture, SequenceLabel, Site

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array, Indices

Moves = Literal["recorded", "skipped"]
Window = tuple[float, float]
"""Start and end of a stationary window, s."""
Pose = tuple[float, float, float]
"""Inner and outer angle and wobble of the fixture, rad."""


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


@dataclass(slots=True, eq=False)
class _Run:
    """Fixture during the execution of a schedule: geometry, angles and present oscillations."""

    geometry: FixtureGeometry
    constant_base: Array  # rows: Earth rate (rad/s) and specific force at rest (m/s²), base components
    schedule: Schedule
    clock: Clock
    angles: tuple[float, float]
    ringings: tuple[Ringing, ...] = ()
    recorded: JoinedProfile = field(default_factory=JoinedProfile)
    wobble: float = 0.0
    wobbles: list[Array] = field(default_factory=list)  # of each piece: wobble at its border, and its rate

    def profile(self, legs: Sequence[tuple[int, float]], leg_dwell_s: float) -> AngleProfile:
        return angle_profile(self.angles, legs, self.schedule.profile, leg_dwell_s=leg_dwell_s, ringings=self.ringings)

    def execute(self, profile: AngleProfile, n_samples: int, *, record: bool, wobble: float | None = None) -> None:
        """Run a profile for a number of samples; its end, with the given wobble, is the new state of the fixture."""
        ramp, at_end = profile.ramp(self.wobble, self.wobble if wobble is None else wobble)
        if record:
            self.clock.record(self._episode(profile, n_samples, ramp))
        else:
            self.clock.now += n_samples
        self.wobble = at_end
        duration = n_samples * self.clock.interval
        self.angles = profile.end_rad
        self.ringings = tuple(
            Ringing(r.axis, r.start_s - duration)
            for r in profile.ringings
            if r.start_s + profile.profile.settling_life_s > duration
        )

    def _episode(self, profile: AngleProfile, n_samples: int, ramp: Array) -> Episode:
        first = self.recorded.append(profile)
        self.wobbles.append(ramp)
        return Episode(n_samples, profile.breaks_s, profile.moving, profile.bandwidth_rad_s, self.sensed, first)

    def sensed(self, piece: Indices, time: Array) -> Array:
        """Rate and specific force in B at times of the pieces of all recorded episodes."""
        angle, rate = self.recorded.angles(piece, time)
        inner, outer = angle[..., INNER], angle[..., OUTER]
        wobble: Array | float = 0.0
        wobble_rate: Array | float = 0.0
        if any(ramp.any() for ramp in self.wobbles):
            at_border, slope = np.concatenate(self.wobbles, axis=1)
            wobble_rate = np.broadcast_to(slope[piece], inner.shape)
            wobble = at_border[piece] + wobble_rate * self.recorded.since_border(piece, time)
        constant = self.geometry.to_body(self.constant_base, inner, outer, wobble)
        turning = self.geometry.turning_rate(inner, rate[..., INNER], rate[..., OUTER], wobble, wobble_rate)
        return np.concatenate([constant[0] + turning, constant[1]], axis=-1)

    def pose(self) -> Pose:
        """Inner and outer angle and wobble, rad."""
        return (*self.angles, self.wobble)


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
    constant_ned = constants_of_site(site, earth_rate=earth_rate)
    clock = Clock.start(check_sample_rate(sample_rate_hz), start_time_s)
    run = _Run(geometry, constant_ned @ geometry.base_from_ned.T, schedule, clock, (0.0, 0.0))
    executed = [_execute_sequence(run, draw, number) for number in range(len(schedule.sequences))]
    windows = tuple(pair for pair, _ in executed)
    time, piece_starts, total = clock.stack()
    return TrueMotion(
        time,
        clock.interval,
        piece_starts,
        *total,
        windows=windows,
        attitudes=geometry.attitude(*np.moveaxis(np.array([poses for _, poses in executed]), -1, 0)),
        labels=tuple(_label(s, *pair) for s, pair in zip(schedule.sequences, windows, strict=True)),
        site=site,
        fixture=stated_fixture or Fixture(heading_rad),
        U=check_rotation(U),
        draw=draw,
    )


def _execute_sequence(run: _Run, draw: FixtureDraw, number: int) -> tuple[tuple[Window, Window], tuple[Pose, Pose]]:
    """Run one sequence with the move to its start; return both windows (s), and the poses at the end of each."""
    schedule, clock = run.schedule, run.clock
    sequence = schedule.sequences[number]
    dwell, end_dwell = (max(1, round(length * clock.sample_rate_hz)) for length in schedule.window_lengths_s()[number])
    nominal, error = sequence.start_rad(), draw.start_errors(number)
    start = (nominal[INNER] + error[INNER], nominal[OUTER] + error[OUTER])
    start_wobble, end_wobble = draw.wobble_of(number)
    if number in schedule.continued:
        dwell = max(1, round(schedule.window_lengths_s()[number - 1][1] * clock.sample_rate_hz))
    elif number == 0:
        run.angles, run.wobble = start, start_wobble
        run.execute(run.profile([], 0.0), dwell, record=True)
    else:
        _move(run, start, dwell, start_wobble)
    first = (clock.at(clock.now - dwell), clock.at(clock.now))
    before = run.pose()

    legs = sequence.fixture_legs()
    errors = draw.leg_errors(number, len(legs)).tolist()
    profile = run.profile([(a, t + e) for (a, t), e in zip(legs, errors, strict=True)], schedule.leg_dwell_s)
    turning = clock.samples(profile.legs_end_s + schedule.settle_s)
    run.execute(profile, turning + end_dwell, record=True, wobble=end_wobble)
    second = (clock.at(clock.now - end_dwell), clock.at(clock.now))
    return (first, second), (before, run.pose())


def _move(run: _Run, start: tuple[float, float], dwell: int, wobble: float) -> None:
    """Move to a start attitude by the smaller angle about each axis, settle, and rest for the start window."""
    schedule, clock = run.schedule, run.clock
    recorded = schedule.moves == "recorded"
    pause = clock.samples(schedule.pause_s)
    if pause:
        run.execute(run.profile([], 0.0), pause, record=recorded)
    legs = []
    for axis in (INNER, OUTER):
        way = math.remainder(start[axis] - run.angles[axis], 2.0 * math.pi)
        legs.append((axis, way))
    profile = run.profile(legs, 0.0)
    moving = clock.samples(profile.legs_end_s + schedule.settle_s)
    if recorded:
        run.execute(profile, moving + dwell, record=True, wobble=wobble)
    else:
        run.execute(profile, moving, record=False)
        run.wobble = wobble
        run.execute(run.profile([], 0.0), dwell, record=True)
    # The omitted full turns do not change the attitude.
    run.angles = start


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
