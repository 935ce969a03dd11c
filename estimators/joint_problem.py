"""The joint estimation problem of a recording: unknowns, priors, noise, and the linearisation by play-back.

Unknowns besides the sensor errors: drift of the biases as their instability is stated (else, where the rest rates
scatter, a gyro bias of every sequence), levelling and north of the fixture's base, orientation U of MARS on the table,
gravity, the Earth's rate where it is not known, and the attitude of every stationary window.
Measurements: mean specific force and mean rate of every window, and the rotation that the gyros integrated between
the windows of a sequence. The mathematics is that of :mod:`srt.model.measurement_model`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.bias_drift import drift
from estimators.linearisation_point import Chain, Played, Point
from srt.constants import EARTH_RATE_RAD_S
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.estimation.initial_estimates import first_estimate
from srt.estimation.measurement_covariance import earth_rate_doubt, excess_scatter
from srt.estimation.srt_measurements import Player
from srt.exceptions import DataError, InputError
from srt.model import measurement_model as model
from srt.model.analytic_platform import integrate
from srt.model.rotations import rotation_matrix, rotation_vector, smallest_rotation
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.noise.from_windows import flicker_spread
from srt.sensor_errors import GROUP_SLICES, SensorErrors
from srt.sequences.plausibility import gap_inside
from srt.sequences.preparation import nominal_attitude, open_session, sequence_of_label
from srt.sequences.stationary_windows import find_turns
from srt.sequences.stillness import PROBABILITY as STILLNESS_PROBABILITY
from srt.sequences.stillness import moved_windows

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.model.table1 import Sequence
    from srt.recording.recording import Recording, SequenceLabel
    from srt.sequences.preparation import PlaybackData
    from srt.types import Array, Mask


_BIAS: Final = GROUP_SLICES["gyro_bias"]
_TURNED_SIGMAS: Final = 5.0
_ANY_BIAS: Final = 1e-2
"""Wander, rad/s, beyond any unit's: every sequence has a bias of its own."""
_EDGES_MATTER: Final = 1e-3
_START_AXIS: Final = 1e-4
"""The inner axis's lean from square to the outer one, as a share of the executed angles' sigma: the model has none."""


class Problem:
    """A recording as a joint estimation problem.

    Parameters
    ----------
    data : PlaybackData
    options : Options
    start : SensorErrors, ndarray of shape (3, 3)
        First estimate and U.

    Raises
    ------
    InputError
        Gyros that are to follow specific force.
    """

    def __init__(self, data: PlaybackData, options: Options, start: tuple[SensorErrors, Array]) -> None:
        if options.gyro_bias == G_SENSITIVE:
            raise InputError(
                f"Joint estimation has no option gyro_bias={G_SENSITIVE!r}: take the estimator closed-form or "
                "least-squares, which have it, or leave the option out."
            )
        self.data, self.options = data, options
        self.fixture_states = options.fixture_states and data.recording.fixture is not None
        self.integrated = np.full(len(data.windows.duration_s), options.window_attitude == "integrated")
        self.player = Player(data, options, self.integrated)
        self.nominal = [_executable(s) if data.recording.fixture is not None else None for s in data.catalogue]
        self.excess = (0.0, 0.0, 0.0)
        """One sigma beyond the sensors' noise: attitude per turn, rad; force and rate per window, m/s² and rad/s."""
        stated = np.zeros(3) if data.noise.gyro_wander is None else data.noise.gyro_wander
        self.wander = {"auto": stated, "pooled": np.zeros(3), "per-sequence": np.full(3, _ANY_BIAS)}[options.gyro_bias]
        # The difference of neighbours under flicker of that floor, whatever their distance: twice its variance.
        self.step = self.wander * math.sqrt(2.0) / flicker_spread(data.windows.samples)
        self._lay_out()
        self.U_prior, self.U_note = self._mounting(start[1])
        self.start = Point(start[0], np.zeros((data.K, 3)), np.eye(3), start[1], 0.0, np.zeros((len(self.chains), 3)))

    def _lay_out(self) -> None:
        """Chains of attitudes; which sequence each window belongs to, and where it was measured first."""
        data = self.data
        W = len(data.windows.duration_s)
        self.order = np.argsort(data.rotation[:, 0], kind="stable")
        self.rank = np.argsort(self.order)
        self.window_sequence = np.full(W, -1, dtype=np.intp)
        self.window_chain = np.full(W, -1, dtype=np.intp)
        self.sequence_chain = np.empty(data.K, dtype=np.intp)
        self.chains: list[Chain] = []
        on_fixture = -1
        for k in self.order.tolist():
            s, e = int(data.start[k]), int(data.end[k])
            if self.window_chain[s] < 0:
                if self.nominal[k] is None or on_fixture < 0:
                    self.chains.append(self._chain(fixture=self.nominal[k] is not None))
                    if self.nominal[k] is not None:
                        on_fixture = len(self.chains) - 1
                self.window_chain[s] = on_fixture if self.nominal[k] is not None else len(self.chains) - 1
            self.sequence_chain[k] = self.window_chain[e] = self.window_chain[s]
            for w in (s, e):
                if self.window_sequence[w] < 0:
                    self.window_sequence[w] = k
        # A pose without its turn belongs to the sequence before it in time, as far as its gyro bias goes.
        for _, w in data.poses:
            before = np.flatnonzero(data.rotation[self.order, 0] < data.windows.samples[w, 0])
            self.window_sequence[w] = self.order[before[-1]] if before.size else self.order[0]
            self.window_chain[w] = on_fixture
        self.is_end = np.zeros(W, dtype=np.bool_)
        self.is_end[data.end] = True
        self.is_start = np.zeros(W, dtype=np.bool_)
        self.is_start[data.start] = True
        middle = data.windows.samples.mean(axis=1)
        self.times = 0.5 * (middle[data.start] + middle[data.end])
        steps = np.diff(self.times[self.order])
        span = float(steps.sum())
        # A random walk of total variance Q scatters by Q / 6 about its mean.
        self.walk_share = 6.0 * steps / span if span > 0.0 else np.zeros(0)

    def _chain(self, *, fixture: bool) -> Chain:
        site, stated = self.data.recording.site, self.data.recording.fixture
        if site.latitude_rad is None:
            return Chain(np.zeros(3), np.full(3, EARTH_RATE_RAD_S / math.sqrt(3.0)), fixture)
        north, down = (
            EARTH_RATE_RAD_S * math.cos(site.latitude_rad),
            -EARTH_RATE_RAD_S * math.sin(site.latitude_rad),
        )
        if fixture and stated is not None and stated.heading_rad is not None:
            return Chain(np.array([north, 0.0, down]), np.zeros(3), fixture)
        return Chain(np.array([0.0, 0.0, down]), np.array([1.0, 1.0, 0.0]) * north / math.sqrt(2.0), fixture)

    def update_mounting(self, point: Point) -> None:
        """Renew the mounting's prior by what the turns show near the solution: it must not hang on the start."""
        if self.data.nominal is not None:
            self.U_prior, self.U_note = self._mounting(self.player.play(point.errors, U=point.U).U)

    def _mounting(self, U: Array) -> tuple[Array, str]:
        """Prior mean of U: the nominal mounting; what the turns showed where MARS is clearly turned from it."""
        fixture = self.data.recording.fixture
        if fixture is None:
            return U, ""
        turned = float(np.linalg.norm(rotation_vector(U[None])))
        # The turning axes and verticals that U was found from have the errors of the fixture themselves.
        limit = _TURNED_SIGMAS * math.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad)
        if turned <= limit:
            return np.eye(3), ""
        return U, (
            f"The gyro axes are turned by {turned * 1e3:.3g} mrad from the stated mounting: the mounting's prior was "
            "centred on what the turns show."
        )

    @property
    def heading_rad(self) -> float:
        """Heading of the fixture; 0 where it is not known, and the Earth's rate takes the unknown up."""
        fixture = self.data.recording.fixture
        return 0.0 if fixture is None or fixture.heading_rad is None else fixture.heading_rad

    @property
    def alignment_sigma(self) -> float:
        """One sigma of base and mounting, rad."""
        fixture = self.data.recording.fixture
        return 0.0 if fixture is None else fixture.alignment_sigma_rad

    @property
    def start_sigma(self) -> Array:
        """One sigma of a start attitude in inner angle, outer angle and squareness of the axes, shape (3,), rad.

        The axes' lean from square is one angle of the fixture, and no unknown of its own: where all starts can be
        brought about by another base and mounting, these take it up; else every start has a lean. What it differs by
        from start to start is the wobble.
        """
        fixture = self.data.recording.fixture
        rotation, wobble = (0.0, 0.0) if fixture is None else (fixture.rotation_sigma_rad, fixture.wobble)
        lean = _START_AXIS * rotation if self._lean_is_taken_up else self.alignment_sigma
        return np.array([rotation, rotation, np.hypot(lean, wobble)])

    @cached_property
    def _lean_is_taken_up(self) -> bool:
        """Whether small turns of base and mounting do to the inner axis what a lean does, at every start."""
        starts = [C for C in self.nominal if C is not None] + [pose_nominal(label) for label, _ in self.data.poses]
        if not starts:
            return True
        C = np.stack(starts)
        # Along the outer axis, e_y · C e_z: derivatives by turns of the base (before C) and of the mounting (behind).
        by_turns = np.concatenate([np.cross(C[:, :, 2], [0.0, 1.0, 0.0]), np.cross([0.0, 0.0, 1.0], C[:, 1])], axis=1)
        lean = np.ones(len(C))
        found = np.linalg.lstsq(by_turns, lean)[0]
        return bool(np.abs(by_turns @ found - lean).max() < 1e-6)

    def at_start(self, point: Point, held: Mask) -> Point:
        """Give parameters that are held the first estimate's values."""
        vector = np.where(held, self.start.errors.vector, point.errors.vector)
        return replace(point, errors=SensorErrors(vector))

    def walk_sigma(self) -> Array:
        """One sigma of the bias steps between sequences in time order, shape (K − 1, 3), rad/s."""
        # An axis without a walk of its own still has its columns: its steps are a thousandth of what a window shows.
        least = 1e-3 * self.data.noise.gyro_white / math.sqrt(float(self.data.windows.duration_s.max()))
        by_scatter = np.sqrt(self.walk_share)[:, None] * self.wander
        # What differs from pose to pose (g-sensitivity, flicker) steps more than a walk of that scatter would.
        return np.asarray(np.maximum(np.maximum(by_scatter, self.step), least))

    @property
    def walks(self) -> bool:
        """Whether every sequence has a gyro bias of its own; a drift that is stated comes on top of the bias."""
        free = self.data.noise.gyro_flicker is None or self.options.gyro_bias == "per-sequence"
        return free and bool(self.wander.any()) and self.data.K > 1

    def earth_rate(self, point: Point) -> Array:
        """ω_L of every window, shape (W, 3), rad/s."""
        by_chain = np.stack([c.earth_rate for c in self.chains]) + point.earth_rate
        return np.asarray(by_chain[self.window_chain])

    def play(self, point: Point) -> Played:
        """Play the recorded data back at a point."""
        data, noise, windows = self.data, self.data.noise, self.data.windows
        gyro, accel = gyro_triad(point.errors), accel_triad(point.errors)
        slope = np.linalg.inv(gyro.matrix)
        deviation = point.bias_deviation @ slope.T
        force, rate = accel.compensate(windows.accel_mean), gyro.compensate(windows.gyro_mean)
        force_jacobian = model.force_error_jacobian(force, accel)
        rate_jacobian = model.rate_error_jacobian(rate, gyro)
        D_force, D_rate = accel.sensitivity(force), gyro.sensitivity(rate)
        rate = rate - deviation[self.window_sequence]
        if self.integrated.any():
            playback = self.player.play(point.errors, U=point.U, bias_offset=deviation, with_noise=True)
            integrals = playback.integrals
            duration = integrals.weight_s
            turned = rotation_matrix(playback.earth_rate * duration[:, None]) @ integrals.C_end
            for k in range(data.K):
                s, e = data.start[k], data.end[k]
                force[s] = playback.carried[k, 0] if self.integrated[s] else force[s]
                force[e] = integrals.C_end[k].T @ playback.carried[k, 1] if self.integrated[e] else force[e]
        else:
            integrals, _ = integrate(
                self.player.stream,
                gyro,
                np.zeros((data.K, 3)),
                bias_offset=deviation,
                sample_noise_rad=noise.gyro_sample(data.recording.nominal_interval_s),
                with_noise=True,
            )
            turned, duration = integrals.C_end, integrals.weight_s
        assert integrals.noise is not None
        T = windows.duration_s[:, None]
        edge = noise.gyro_edge
        matters = bool(np.any(2.0 * edge**2 > _EDGES_MATTER * noise.gyro_white**2 * float(duration.min())))
        # Edges that no turn shares are noise of the window's rate alone; where they matter little, all of them are.
        lone = np.where(matters, 2.0 - self.is_end.astype(float) - self.is_start, 2.0)[:, None]
        A, C = slope * edge, integrals.C_end
        edges = np.broadcast_to(A @ A.T, C.shape) + C @ (A @ A.T) @ np.swapaxes(C, 1, 2)
        rate_noise = {
            "gyro_noise": _through(D_rate, noise.gyro_white**2 / T),
            "gyro_quantization": _through(D_rate, lone * (edge / T) ** 2),
            "rest_excess": np.broadcast_to(self.excess[2] ** 2 * np.eye(3), D_rate.shape),
        }
        if self.integrated.any():
            # While a window's attitude is integrated its gyros measure motion, not the Earth's rate.
            rate_noise["gyro_noise"][self.integrated] = np.eye(3)
        return Played(
            force,
            rate,
            force_jacobian,
            rate_jacobian,
            {
                "accel_noise": _through(D_force, noise.accel_white**2 * windows.white_factor[:, None]),
                "accel_quantization": _through(D_force, noise.accel_edge**2 * windows.edge_factor[:, None]),
                "pose_excess": np.broadcast_to(self.excess[1] ** 2 * np.eye(3), D_force.shape),
            },
            rate_noise,
            {
                "gyro_noise": integrals.noise @ noise.gyro_white**2,
                "gyro_quantization": 0.0 * edges if matters else edges,
                "turn_excess": np.broadcast_to(self.excess[0] ** 2 * np.eye(3), C.shape),
            },
            D_rate,
            turned,
            model.attitude_error_jacobian(integrals),
            duration,
            A * float(matters),
            drift(
                data,
                integrals,
                (D_rate, D_force),
                (self.rank[self.window_sequence], self.rank),
                of_gyros=self.options.gyro_bias != "pooled",
            ),
        )

    def place(self, point: Point, played: Played) -> Point:
        """Attitudes from the data: level by the specific force, heading by the fixture or along the turns."""
        data = self.data
        attitude = np.tile(np.eye(3), (len(data.windows.duration_s), 1, 1))
        placed = np.zeros(len(attitude), dtype=np.bool_)
        down = -played.force / np.linalg.norm(played.force, axis=1, keepdims=True)
        earth = self.earth_rate(point)
        heading = rotation_matrix(np.array([0.0, 0.0, self.heading_rad]))

        def level(A: Array, w: int) -> Array:
            return np.asarray(A @ smallest_rotation(down[w][None], A[2][None])[0])

        def on_fixture(nominal: Array) -> Array:
            return np.asarray(heading @ point.base @ nominal @ point.U.T)

        for label, w in data.poses:
            attitude[w] = level(on_fixture(pose_nominal(label)), w)
        for k in self.order.tolist():
            s, e = int(data.start[k]), int(data.end[k])
            nominal = self.nominal[k]
            if not placed[s]:
                A = on_fixture(nominal) if nominal is not None else _upright(down[s])
                attitude[s], placed[s] = level(A, s), True
            if not placed[e]:
                turn = rotation_matrix(-earth[s] * played.duration_s[k])
                attitude[e], placed[e] = level(turn @ attitude[s] @ played.turned[k], e), True
        return replace(point, attitude=attitude)

    def moved(self, point: Point, played: Played) -> Mask:
        """Windows held so far in which the unit moved, shape (W,)."""
        assert point.attitude is not None
        gyro = gyro_triad(point.errors)
        rest, _, _ = model.pose_rate(played.rate, point.attitude, self.earth_rate(point))
        wander = np.sqrt(np.linalg.inv(gyro.matrix) ** 2 @ self.wander**2)
        chance = STILLNESS_PROBABILITY / len(rest)
        moved = moved_windows(self.data, gyro, accel_triad(point.errors), rest, wander, chance)
        return np.asarray(moved & ~self.integrated)

    def release(self, windows: Mask) -> None:
        """Integrate the attitude over windows instead of holding it."""
        self.integrated = self.integrated | windows
        self.player = Player(self.data, self.options, self.integrated)

    @cached_property
    def share(self) -> Array:
        """Weights of the windows in each sequence's own rest rate, shape (K, W)."""
        T = self.data.windows.duration_s
        share = np.zeros((self.data.K, len(T)))
        for which in (self.data.start, self.data.end):
            share[np.arange(self.data.K), which] = T[which]
        return np.asarray(share / share.sum(axis=1, keepdims=True))

    def drift_by_sequence(self, played: Played, draws: Array) -> Array:
        """Drift of the raw gyros in each sequence's windows less its mean, shape (K, 3), rad/s."""
        raw = np.linalg.solve(played.rate_slope, (played.drift.rate @ draws)[:, :, None])[:, :, 0]
        own = self.share @ raw
        return np.asarray(own - own.mean(axis=0))

    def update_wander(self, point: Point, played: Played) -> None:
        """Estimate the bias scatter between sequences from the rest rates, if no bias instability is stated."""
        if self.data.noise.gyro_wander is not None or self.options.gyro_bias != "auto" or self.data.K < 3:
            return
        assert point.attitude is not None
        rest, _, _ = model.pose_rate(played.rate, point.attitude, self.earth_rate(point))
        rest = np.einsum("wab,wb->wa", np.linalg.inv(played.rate_slope), rest)
        rest = rest + point.bias_deviation[self.window_sequence]
        T, share = self.data.windows.duration_s, self.share
        noise = self.data.noise
        variance = noise.gyro_white**2 / T[:, None] + 2.0 * (noise.gyro_edge / T[:, None]) ** 2
        expected = np.mean(share**2 @ variance, axis=0) + earth_rate_doubt(self.data) ** 2
        own = share @ rest
        self.wander = np.sqrt(excess_scatter(own, expected))
        steps = np.mean(np.diff(own[self.order], axis=0) ** 2, axis=0) - 2.0 * expected
        self.step = np.where(self.wander > 0.0, np.sqrt(np.maximum(steps, 0.0)), 0.0)


def open_problem(recording: Recording, options: Options) -> Problem:
    """Open a recording for joint estimation.

    Raises
    ------
    DataError
        As :func:`srt.sequences.preparation.open_session`, and if no sequence has both its windows.
    """
    labels = recording.sequences or find_turns(recording)
    whole = tuple(s for s in labels if not _end_is_lost(recording, s))
    poses = tuple(s for s in labels if s.id is not None and (s not in whole or _turn_is_lost(recording, s)))
    if not whole:
        raise DataError("No sequence of the recording has both its windows: record at least one turn to its end.")
    data = open_session(recording, whole, options.average, poses=poses if recording.fixture is not None else ())
    return Problem(data, options, first_estimate(data, options))


def pose_nominal(label: SequenceLabel) -> Array:
    """C_nom of a label's start."""
    sequence = sequence_of_label(label)
    assert sequence is not None
    return nominal_attitude(sequence)


def _turn_is_lost(recording: Recording, label: SequenceLabel) -> bool:
    """Whether samples are missing after a start window that is whole."""
    first, last = recording.window_indices(*label.start_static_s), recording.window_indices(*label.end_static_s)
    lost = gap_inside(recording, slice(first.start, last.stop)).size > 0
    return lost and gap_inside(recording, first).size == 0


def _end_is_lost(recording: Recording, label: SequenceLabel) -> bool:
    window = recording.window_indices(*label.end_static_s)
    return bool(window.stop - window.start < 2)


def _executable(sequence: Sequence | None) -> Array | None:
    """C_nom of a sequence's start, if the fixture can stand so: its inner axis is IMU z, square to the outer one."""
    if sequence is None or sequence.along_outer[-1] == "z":
        return None
    return nominal_attitude(sequence)


def _through(D: Array, variance: Array) -> Array:
    """Covariance of compensated values from the variances of raw channels, (n, 3, 3)."""
    return np.asarray((D * variance[:, None, :]) @ np.swapaxes(D, 1, 2))


def _upright(down: Array) -> Array:
    """Any attitude with a given down: B to L."""
    first = np.cross(down, np.eye(3)[np.argmin(np.abs(down))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first), down])
