"""Bayesian Cramér-Rao bound of the rotation test on the two-axis fixture.

The test is nearly linear, its noise and priors are Gaussian, so that the bound is the covariance of its best estimator.
It is computed independently of the estimators: every derivative is a central difference of the simulator's noise-free
output, about the given sensor errors and a fixture without errors.

*Measurements* of a sequence: the mean readings of gyros and accelerometers in both still windows, and the rotation that
the gyros integrate from the end of the first to the start of the second, as a small rotation vector in B at its start.
Where the moves are recorded, the rotation in each of them, too.

*Unknowns*: the 27 sensor errors, without a prior; base, mounting and non-orthogonality of the fixture, gravity, the
start angles of each sequence and the wobble in both windows, with the sigmas of the simulator; the angles in each end
window, without a prior; and, if the gyro bias is a random walk, its step between sequences.

*Noise*: white noise N gives a mean over T the variance N²/T. Each reading of the running integral is rounded to a pulse
independently, sigma quantum/√12. A mean has the errors at the edges of its window, the rotation those at the two edges
that it shares with the windows.

Not included: bias instability, g-sensitivity, saturation, rounding of the output word, an unknown latitude, and the
effect of pulses within a turn (up to 5 % of their variance at 200 Hz and 1 rad/s). Each of these can only increase the
bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from sims.physics.fixture import FixtureDraw, rotation
from sims.physics.imu import noise_free_increments
from sims.physics.motion import RateProfile
from sims.physics.table_motion import Schedule, constants_of_site, run_schedule
from srt.exceptions import DataError, InputError
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, NAMES, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from sims.physics.imu import ImuModel
    from sims.physics.true_motion import TrueMotion
    from sims.scenarios.scenario import Scenario
    from srt.recording.recording import Site
    from srt.types import Array, Indices


START_GYRO, START_ACCEL, END_GYRO, END_ACCEL, ROTATION = (slice(row, row + 3) for row in range(0, 15, 3))
"""Rows of a sequence's measurements: window means in rad/s and m/s², the integrated rotation in rad."""

FIXTURE_SIGMAS = tuple(
    f"{of}_sigma_rad" for of in ("level", "north", "mounting", "non_orthogonality", "rotation", "wobble")
)
"""Keys of ``fixture_sigma``: the keyword arguments of :func:`sims.physics.fixture.draw_fixture`."""

# Columns of Linearisation.fixture.
_MOUNTING, _SKEW, _GRAVITY, _STARTS = slice(3, 6), 6, 7, slice(8, 10)
# The readings in a pose do not depend on the motion before it: moves are fast, windows have one sample.
_POSE_RATE_HZ, _POSE_PROFILE = 10.0, RateProfile(20.0, 200.0)
# Limits of rounding: derivative over the largest of its measurement; a singular value, columns equilibrated, over the
# largest; the share of a sensor error in a direction of which nothing is known.
_NO_DERIVATIVE, _SINGULAR, _NO_SHARE = 1e-10, 1e-11, 1e-6
_LEAST_MOVE = 0.1
"""Least rotation of a move, rad; one that turns less adds nothing but the noise of its windows."""


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """Bound on the covariance of an estimate of the sensor errors; ``bound[name]`` is the 1-sigma value.

    Attributes
    ----------
    covariance : ndarray, shape (27, 27), SI
        In the order of :data:`srt.sensor_errors.NAMES`. For a gyro bias that walks, the
        parameter is its mean over the sequences.
    """

    covariance: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation of each sensor error, shape (27,), SI."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def __getitem__(self, name: str) -> float:
        return float(self.sigma[INDEX[name]])


def bayesian_bound(
    schedule: Schedule,
    *,
    site: Site,
    imu: ImuModel,
    fixture_sigma: Mapping[str, float],
    errors: SensorErrors | None = None,
    heading_rad: float = 0.0,
    U: Array | None = None,
    sample_rate_hz: float = 200.0,
    gyro_bias_walk_rad_s: float = 0.0,
    earth_rate: bool = True,
) -> Bound:
    """Bound on the covariance of any estimate of the sensor errors from one recording.

    Parameters
    ----------
    site : Site
        Its gravity sigma is a prior; the latitude is known exactly.
    imu : ImuModel
        White noise and pulses of both triads, of each not both zero; its other figures are not used.
    fixture_sigma : mapping
        By the keys :data:`FIXTURE_SIGMAS`, rad. Absent or zero: known exactly. North may be infinite: unknown.
    errors : SensorErrors, optional
        Sensor errors at which the bound is evaluated; default: zero.
    heading_rad, U, sample_rate_hz, earth_rate
        See :func:`sims.physics.table_motion.run_schedule`; 100 Hz or more.
    gyro_bias_walk_rad_s : float
        One sigma of the gyro bias's step from each sequence to the next; default 0, one bias for all.

    Raises
    ------
    InputError
        If a sigma is negative or unknown, or a triad has no noise.
    DataError
        If the sequences do not determine all sensor errors; the message names those in question.
    """
    where: dict[str, Any] = {"heading_rad": heading_rad, "U": U, "earth_rate": earth_rate}
    linear = linearise(schedule, site=site, imu=imu, errors=errors, sample_rate_hz=sample_rate_hz, **where)
    return linear.bound(fixture_sigma, site.gravity_sigma_m_s2, gyro_bias_walk_rad_s)


def scenario_bound(scenario: Scenario, errors: SensorErrors | None = None) -> Bound:
    """Bound of a scenario on the fixture; see :func:`bayesian_bound`."""
    from sims.scenarios.simulation import imu_model, schedule_of  # needs the extra 'sims'

    if scenario.schedule is None or scenario.fixture is None:
        raise InputError("The scenario is a free recording, but the bound is of a run on the fixture: describe one.")
    sigma = scenario.fixture.draw_sizes()
    # A random rotation of B relative to its mount adds to the mounting error.
    sigma["mounting_sigma_rad"] = math.hypot(sigma["mounting_sigma_rad"], 1e-3 * scenario.imu.frame_turn_sigma_mrad)
    if not scenario.fixture.state_heading:
        sigma["north_sigma_rad"] = math.inf
    return bayesian_bound(
        schedule_of(scenario.schedule),
        site=scenario.site.site(),
        imu=imu_model(scenario, np.random.default_rng(0)),  # draws the g-sensitivity only, which is not used
        fixture_sigma=sigma,
        errors=errors,
        heading_rad=math.radians(scenario.fixture.heading_deg),
        U=rotation(1e-3 * np.array(scenario.imu.frame_turn_mrad)).T,
        sample_rate_hz=min(max(scenario.recording.sample_rate_hz, 100.0), 400.0),  # more only takes longer
        earth_rate=scenario.site.earth_rate,
    )


@dataclass(frozen=True, slots=True, eq=False)
class MoveLinearisation:
    """Derivatives and noise of the rotations that the gyros integrate in M recorded moves.

    Attributes
    ----------
    before : ndarray of int, shape (M,)
        Sequence before each move.
    errors : ndarray, shape (M, 3, 27)
        By the sensor errors, SI; in B at the end of the sequence before.
    turn : ndarray, shape (M, 3, 3)
        From B in the next start window to B in the end window before, relative to inertial space.
    noise : ndarray, shape (M, 3, 3)
        Covariance.
    shared : ndarray, shape (M, 3, 2, 3)
        Covariance with the gyro means of the end window before and of the next start window (pulses).
    """

    before: Indices
    errors: Array
    turn: Array
    noise: Array
    shared: Array


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """Derivatives and noise of the measurements of K sequences, and of the recorded moves between them.

    Attributes
    ----------
    errors : ndarray, shape (K, 15, 27)
        By the sensor errors, SI.
    fixture : ndarray, shape (K, 15, 10)
        By base (3), mounting (3), non-orthogonality, gravity, own inner and outer start angle; rad, m/s² for gravity.
    end : ndarray, shape (K, 15, 3)
        By a small rotation vector of B in the end window, in B, rad.
    noise : ndarray, shape (K, 15, 15)
        Covariance.
    turn : ndarray, shape (K, 3, 3)
        From B in the end window to B in the start window, relative to inertial space.
    attitude : ndarray, shape (K, 2, 3, 10)
        Small rotation vector of B in both windows, by the same unknowns, of which the angles are those of that window.
    """

    errors: Array
    fixture: Array
    end: Array
    noise: Array
    turn: Array
    attitude: Array
    moves: MoveLinearisation

    def bound(
        self, fixture_sigma: Mapping[str, float], gravity_sigma_m_s2: float, gyro_bias_walk_rad_s: float = 0.0
    ) -> Bound:
        """Combine the measurements with priors; see :func:`bayesian_bound`."""
        for name, value in fixture_sigma.items():
            if name not in FIXTURE_SIGMAS:
                raise InputError(f"There is no fixture sigma {name!r}: the names are {', '.join(FIXTURE_SIGMAS)}.")
            if not (0.0 <= value < math.inf or (name == "north_sigma_rad" and value == math.inf)):
                raise InputError(f"{name} is {value!r} rad: it must be zero or a positive number.")
        if not 0.0 <= gyro_bias_walk_rad_s < math.inf:
            raise InputError(f"gyro_bias_walk_rad_s is {gyro_bias_walk_rad_s!r}: it must be zero or a positive number.")
        level, north, mounting, skew, start, wobble = (float(fixture_sigma.get(name, 0.0)) for name in FIXTURE_SIGMAS)
        count = len(self.errors)
        prior = [np.inf] * N_PARAMETERS + [level, level, north, *[mounting] * 3, skew, gravity_sigma_m_s2]
        prior += [gyro_bias_walk_rad_s] * (3 * (count - 1)) + [start, start, wobble, np.inf, np.inf, wobble] * count
        rows, sigma = self._rows(), np.array(prior)
        root = np.linalg.cholesky(self._covariance())
        known = np.diag(1.0 / sigma[sigma > 0.0])
        whitened = np.vstack([np.linalg.solve(root, rows[:, sigma > 0.0]), known])
        return Bound(_covariance(whitened, np.linalg.norm(whitened, axis=0)))

    def _rows(self) -> Array:
        """Derivatives of all measurements: of the sequences, then of the moves.

        Columns: sensor errors (27), base, mounting, non-orthogonality, gravity (8), steps of the gyro bias between
        sequences (3 K − 3), and of each sequence the angles and the wobble of its start and of its end (6).
        """
        count = len(self.errors)
        # Bias of each sequence from the steps, minus its mean over the sequences, which is one of the 27 parameters.
        walked = np.tri(count, count - 1, -1)
        walked -= walked.mean(axis=0)
        # Columns of the angles and of the wobble of a pose.
        of_pose = np.array([_STARTS.start, _STARTS.start + 1, _SKEW])

        def joined(errors: Array, fixture: Array, poses: Array, sequence: Indices) -> Array:
            """Rows (n, d, ·) of sequences, by poses of all sequences, shape (n, d, K, 6)."""
            bias = errors[:, :, GROUP_SLICES["gyro_bias"]]
            steps = walked[sequence][:, np.newaxis, :, np.newaxis] * bias[:, :, np.newaxis, :]
            n, d = errors.shape[:2]
            own = steps.reshape(n, d, 3 * (count - 1)), poses.reshape(n, d, 6 * count)
            out = np.concatenate([errors, fixture[:, :, : _STARTS.start], *own], axis=2)
            return out.reshape(n * d, out.shape[2])

        every = np.arange(count)
        at_end = self.end @ self.attitude[:, 1]
        poses = np.zeros((count, 15, count, 6))
        poses[every, :, every] = np.concatenate([self.fixture[:, :, of_pose], at_end[:, :, of_pose]], axis=2)
        measured = joined(self.errors, self.fixture + at_end, poses, every)
        before, moves = self.moves.before, np.arange(len(self.moves.before))
        by_end, by_start = -self.attitude[before, 1], self.moves.turn @ self.attitude[before + 1, 0]
        poses = np.zeros((len(before), 3, count, 6))
        poses[moves, :, before, 3:] = by_end[:, :, of_pose]
        poses[moves, :, before + 1, :3] = by_start[:, :, of_pose]
        moved = joined(self.moves.errors, by_end + by_start, poses, before)
        return np.concatenate([measured, moved])

    def _covariance(self) -> Array:
        """Covariance of all measurements; a move shares the pulses at the edges of the windows that it joins."""
        count, before = len(self.noise), self.moves.before
        size = 15 * count + 3 * len(before)
        out = np.zeros((size, size))
        every, moves = np.arange(count), np.arange(len(before))
        out[: 15 * count, : 15 * count].reshape(count, 15, count, 15)[every, :, every] = self.noise
        out[15 * count :, 15 * count :].reshape(len(before), 3, len(before), 3)[moves, :, moves] = self.moves.noise
        for which, rows in ((0, END_GYRO), (1, START_GYRO)):
            with_windows = out[15 * count :, : 15 * count].reshape(len(before), 3, count, 15)
            with_windows[moves, :, before + which, rows] = self.moves.shared[:, :, which]
        out[: 15 * count, 15 * count :] = out[15 * count :, : 15 * count].T
        return out


def linearise(
    schedule: Schedule,
    *,
    site: Site,
    imu: ImuModel,
    errors: SensorErrors | None = None,
    sample_rate_hz: float = 200.0,
    step: float = 1e-4,
    **where: Any,
) -> Linearisation:
    """Derivatives of the measurements about a faultless fixture, by central differences of half width ``step`` (SI).

    ``where`` is passed to :func:`sims.physics.table_motion.run_schedule`; other parameters: :func:`bayesian_bound`.
    """
    for triad in ("gyro", "accel"):
        if not (getattr(imu, f"{triad}_noise") > 0.0 or getattr(imu, f"{triad}_quantization") > 0.0):
            raise InputError(f"The IMU model has no {triad} noise, so that nothing bounds the accuracy: state it.")
    about = errors or SensorErrors()
    motion = run_schedule(schedule, site=site, sample_rate_hz=sample_rate_hz, **where)
    windows = np.array(motion.windows)
    poses = Schedule(schedule.sequences, _POSE_PROFILE, dwell_s=1.0 / _POSE_RATE_HZ, pause_s=0.0)

    def pose_run(unknowns: Array) -> TrueMotion:
        # Sequences are independent: one run perturbs the start angles of all.
        starts = np.tile(unknowns[_STARTS], (len(poses.sequences), 1))
        draw = FixtureDraw(unknowns[:3], unknowns[_MOUNTING], float(unknowns[_SKEW]), starts)
        there = replace(site, gravity_m_s2=site.gravity_m_s2 + float(unknowns[_GRAVITY]))
        return run_schedule(poses, site=there, sample_rate_hz=_POSE_RATE_HZ, fixture_draw=draw, **where)

    by_errors, by_unknowns, turned = _in_windows(pose_run, about, step)
    earth = constants_of_site(site, earth_rate=where.get("earth_rate", True))[0]
    sequences = windows[:, [0, 1], [1, 0]], motion.attitudes
    by_errors_in_turn, spread, first, last, turn = _in_turns(motion, *sequences, earth, (about, step))

    # The end attitude is an unknown: readings there depend on gravity, but not on the fixture errors.
    by_attitude = by_unknowns[:, 1, :, _MOUNTING] @ np.linalg.inv(turned[:, 1, :, _MOUNTING])
    by_unknowns[:, 1, :, np.arange(10) != _GRAVITY] = 0.0
    by_errors = np.concatenate([by_errors[:, 0], by_errors[:, 1], by_errors_in_turn], axis=1)
    # An axis perpendicular to gravity has cos 90° = 6e-17 instead of 0 because of rounding.
    by_errors[np.abs(by_errors) < _NO_DERIVATIVE * np.abs(by_errors).max(axis=2, keepdims=True)] = 0.0
    return Linearisation(
        by_errors,
        np.concatenate([by_unknowns[:, 0], by_unknowns[:, 1], -turned[:, 0]], axis=1),
        np.concatenate([np.zeros_like(by_attitude), by_attitude, turn], axis=1),
        _noise(windows, imu, spread, first, turn @ last),
        turn,
        turned,
        _in_moves(motion, windows, imu, earth, (about, step)),
    )


def _in_turns(
    motion: TrueMotion, turning: Array, attitudes: Array, earth: Array, about: tuple[SensorErrors, float]
) -> tuple[Array, ...]:
    """Results of :func:`_in_turn` for n rotations, and each rotation relative to inertial space, shape (n, 3, 3).

    ``turning`` are the times between which the rotations are integrated, shape (n, 2), ``attitudes`` C_NED,B there,
    shape (n, 2, 3, 3), ``earth`` the Earth's rate in NED, and ``about`` the sensor errors and the step.
    """
    edges = np.searchsorted(motion.time, turning + 0.5 * motion.interval, side="right")
    turns = [_in_turn(motion, slice(start, stop), *about) for start, stop in edges]
    columns = [np.array(column) for column in zip(*turns, strict=True)]
    # Attitudes are relative to NED, which rotates with the Earth between the two windows.
    to_start = attitudes[:, 0].transpose(0, 2, 1) @ rotation(earth * np.diff(turning))
    return (*columns, to_start @ attitudes[:, 1])


def _in_moves(
    motion: TrueMotion, windows: Array, imu: ImuModel, earth: Array, about: tuple[SensorErrors, float]
) -> MoveLinearisation:
    """Derivatives and noise of the recorded moves from an end window to the next start window."""
    attitudes = np.stack([motion.attitudes[:-1, 1], motion.attitudes[1:, 0]], axis=1)
    turning = np.stack([windows[:-1, 1, 1], windows[1:, 0, 0]], axis=1)
    first, last = np.searchsorted(motion.time, turning.T + 0.5 * motion.interval, side="right")
    # A gap lies before the first sample of a piece.
    gapless = np.searchsorted(motion.piece_starts, first) == np.searchsorted(motion.piece_starts, last, side="right")
    angle = Rotation.from_matrix(attitudes[:, 0].transpose(0, 2, 1) @ attitudes[:, 1]).magnitude()
    before = np.flatnonzero(gapless & (angle > _LEAST_MOVE))
    if not len(before):
        none = np.zeros((0, 3, 3))
        return MoveLinearisation(before, np.zeros((0, 3, N_PARAMETERS)), none, none, np.zeros((0, 3, 2, 3)))
    errors, spread, D_first, D_last, turn = _in_turns(motion, turning[before], attitudes[before], earth, about)
    at_edges = np.stack([-D_first, turn @ D_last])
    variance = imu.gyro_quantization**2 / 12.0
    noise = imu.gyro_noise**2 * spread + variance * np.einsum("emab,emcb->mac", at_edges, at_edges)
    # The mean of a window ends at its last edge, with a plus, and begins at its first, with a minus.
    lengths = np.stack([np.diff(windows[before, 1])[:, 0], -np.diff(windows[before + 1, 0])[:, 0]])
    shared = variance * at_edges.transpose(1, 2, 0, 3) / lengths.T[:, np.newaxis, :, np.newaxis]
    return MoveLinearisation(before, errors, turn, noise, shared)


def _central(function: Callable[[Array], Array], count: int, step: float) -> Array:
    """Derivatives of a function of ``count`` numbers about zero, on a new last axis."""
    return np.stack([function(c) - function(-c) for c in step * np.eye(count)], axis=-1) / (2.0 * step)


def _in_windows(run: Callable[[Array], TrueMotion], about: SensorErrors, step: float) -> tuple[Array, Array, Array]:
    """Derivatives in both windows of K sequences.

    Those of gyro and accelerometer readings by the errors, shape (K, 2, 6, 27), and by the unknowns, (K, 2, 6, 10),
    and of the attitude by the unknowns as a small rotation vector in B, (K, 2, 3, 10).
    """

    def readings(motion: TrueMotion, errors: SensorErrors) -> Array:
        only = np.searchsorted(motion.time, np.array(motion.windows)[:, :, 1] - 0.5 * motion.interval)
        return np.hstack(noise_free_increments(motion, errors))[only] / motion.interval

    def readings_and_attitudes(unknowns: Array) -> Array:
        motion = run(unknowns)
        return np.concatenate([readings(motion, about), motion.attitudes.reshape(-1, 2, 9)], axis=2)

    still = run(np.zeros(10))
    by_errors = _central(lambda change: readings(still, about.plus(change)), N_PARAMETERS, step)
    both = _central(readings_and_attitudes, 10, step)
    cross = np.einsum("kwba,kwbcp->kwacp", still.attitudes, both[:, :, 6:].reshape(-1, 2, 3, 3, 10))
    turned = 0.5 * np.stack([cross[:, :, j, i] - cross[:, :, i, j] for i, j in ((1, 2), (2, 0), (0, 1))], axis=2)
    return by_errors, both[:, :, :6], turned


def _in_turn(motion: TrueMotion, samples: slice, about: SensorErrors, step: float) -> tuple[Array, ...]:
    """Effect of the errors of the readings in a rotation on the angle that is integrated from them.

    A reading that is off by dy is taken for a rotation that is off by D dy, D the inverse of the reading's derivative
    by the true rotation; the attitude C, from B in the sample to B in the start window, brings it to the start.

    Gives Σ C D ∂y, shape (3, 27), ∂y the derivative of a reading by the sensor errors; Σ C D Dᵀ Cᵀ dt, shape (3, 3),
    the covariance per squared white noise, s; and D of the first and of the last sample, each of shape (3, 3).
    """
    parts = ("angle", "angle_abs", "velocity", "velocity_abs")  # all that is read out
    turn = replace(motion, **{name: getattr(motion, name)[samples] for name in parts})

    def turned_more(change: Array) -> Array:
        more = turn.angle_abs + np.sign(turn.angle) * change  # no rate changes its sign by it
        return noise_free_increments(replace(turn, angle=turn.angle + change, angle_abs=more), about)[0]

    D = np.linalg.inv(_central(turned_more, 3, step * turn.interval))
    # In the middle of a sample, where its rotation acts to second order in its length.
    half = Rotation.from_rotvec(0.5 * turn.angle).as_matrix()
    C, reach = half @ half, 1
    while reach < len(C):  # products of all before, in as many rounds as their number has binary digits
        C[reach:] = C[:-reach] @ C[reach:]
        reach *= 2
    CD = C @ half.transpose(0, 2, 1) @ D
    dy = _central(lambda change: noise_free_increments(turn, about.plus(change))[0], N_PARAMETERS, step)
    return np.einsum("nab,nbp->ap", CD, dy), np.einsum("nab,ncb->ac", CD, CD) * turn.interval, D[0], D[-1]


def _noise(windows: Array, imu: ImuModel, spread: Array, first: Array, last: Array) -> Array:
    """Covariance of the measurements of each sequence, shape (K, 15, 15).

    ``spread`` is the rotation's per squared white noise; ``first`` and ``last`` say what an error of the running
    integral at the turn's first edge (less) and at its last (more) makes of the rotation; each of shape (K, 3, 3).
    """
    noise = np.zeros((len(windows), 15, 15))
    noise[:, ROTATION, ROTATION] = imu.gyro_noise**2 * spread
    # Columns: errors of the running integrals at the four edges of the windows, in the order of time.
    gyro, accel = np.zeros((len(windows), 15, 12)), np.zeros((len(windows), 15, 12))
    gyro[:, ROTATION, 3:9] = np.concatenate([-first, last], axis=2)
    for window, (of_gyro, of_accel) in enumerate(((START_GYRO, START_ACCEL), (END_GYRO, END_ACCEL))):
        per_s = np.eye(3) / np.diff(windows[:, window])[:, :, np.newaxis]
        noise[:, of_gyro, of_gyro] = imu.gyro_noise**2 * per_s
        noise[:, of_accel, of_accel] = imu.accel_noise**2 * per_s
        edges = slice(6 * window, 6 * window + 6)
        gyro[:, of_gyro, edges] = accel[:, of_accel, edges] = np.concatenate([-per_s, per_s], axis=2)
    pulses = (gyro * imu.gyro_quantization, accel * imu.accel_quantization)
    return np.asarray(noise + sum(p @ p.transpose(0, 2, 1) for p in pulses) / 12.0)


def _covariance(rows: Array, scale: Array) -> Array:
    """Covariance of the 27 errors, the first unknowns, from whitened measurements and priors of all, shape (m, n)."""
    scale[scale == 0.0] = 1.0
    _, singular, directions = np.linalg.svd(np.linalg.qr(rows / scale, mode="r"))
    rank = int(np.sum(singular > _SINGULAR * singular[0]))
    # An unobservable fixture error is harmless unless it cannot be separated from a sensor error.
    blind = np.abs(directions[rank:, :N_PARAMETERS]).max(axis=0, initial=0.0)
    if blind.max() > _NO_SHARE:
        names = ", ".join(name for name, share in zip(NAMES, blind, strict=True) if share > 0.01 * blind.max())
        raise DataError(f"These sequences do not determine {names}: add sequences of Table 1, which as a whole does.")
    root = directions[:rank].T / singular[:rank] / scale[:, np.newaxis]
    return np.asarray(root[:N_PARAMETERS] @ root[:N_PARAMETERS].T)
