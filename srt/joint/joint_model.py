"""Joint model of a recording: unknowns, priors, measurements and their noise, shared by all joint solvers.

Unknowns besides the sensor errors: the bias instability as specified, levelling and north of the fixture's base,
orientation U of MARS on the table, non-orthogonality of the fixture's axes, gravity, the unknown part of the Earth's
rate, the error of a rate table, and the attitude of every stationary window. If no bias instability is specified and
the rates at rest scatter, every sequence has its own gyro bias.
Measurements (equations in :mod:`srt.model.measurement_model`): mean specific force and mean rate of every window, the
integrated rotation between the windows of a sequence, and the mean rate of runs at a stated rate.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import EARTH_RATE_RAD_S
from srt.estimation import error_sources as sources
from srt.estimation.fixed_parameters import fixed_values
from srt.estimation.g_sensitivity import LEAST_SCATTER, RestRates, pose_regression
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.estimation.iterations import PARAMETER_UNITS
from srt.estimation.observability import admission_sigma
from srt.estimation.rest_rate_scatter import excess_variance
from srt.estimation.srt_measurements import SrtProcessor
from srt.joint.drift import DriftTerms, drift_chain, drift_states
from srt.joint.joint_state import CompensatedData, JointState, LevelFrame, ModelChoice
from srt.joint.nominal_attitudes import mounting_limit, mounting_prior, nominal_end, nominal_start
from srt.joint.stated_rates import SteadyReadings
from srt.model import measurement_model as model
from srt.model.analytic_platform import integrate_attitude, parts_per_rotation
from srt.model.prior import Prior
from srt.model.rotations import rotation_matrix, rotation_vector
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.noise.drift_forms import WALK
from srt.noise.noise_model import flicker_spread
from srt.sensor_errors import SensorErrors
from srt.sequences.stillness import PROBABILITY as STILLNESS_PROBABILITY
from srt.sequences.stillness import moved_windows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.estimation.drift_model import DriftTerm
    from srt.estimation.error_sources import Slopes, Source
    from srt.estimation.g_sensitivity import PoseRegression
    from srt.estimation.options import Options
    from srt.joint.drift import DriftStates
    from srt.joint.stated_rates import StatedRates
    from srt.model.rotation_integrals import RotationIntegrals
    from srt.model.sensor_model import Triad
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


_UNCONSTRAINED_BIAS: Final = 1e-2
"""Bias scatter between sequences, rad/s (about 2000 °/h): larger than that of any unit, so that biases are free."""
_RELEVANT_EDGE_NOISE: Final = 1e-3
"""Errors at window edges are estimated if quantization has a larger share of the variance of a rotation than this."""
_LEAST_WALK: Final = 1e-3
"""Smallest step of the bias walk, as a share of the rate noise of a window: the walk's covariance must be regular."""
_LINEAR: Final = 1e-3
"""Largest sigma of the sensor errors (accelerometer bias in g) whose square is below a wobble of microradians."""


class JointModel:
    """Unknowns, measurements and noise of a recording, and its linearisation about an estimate.

    A model does not change. One of another choice is another model, which shares all that the choice does not affect.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    start : SensorErrors, ndarray of shape (3, 3)
        Initial estimate and U.
    """

    def __init__(self, data: PreparedRecording, options: Options, start: tuple[SensorErrors, Array]) -> None:
        self.options, self.steady = options, SteadyReadings.of(data)
        self.fixture_states = options.fixture_states and data.recording.fixture is not None
        self.nominal = [nominal_start(s) if data.recording.fixture is not None else None for s in data.catalogue]
        stated = np.zeros(3) if data.noise.gyro_wander is None else data.noise.gyro_wander
        fixed = {"pooled": np.zeros(3), "per-sequence": np.full(3, _UNCONSTRAINED_BIAS)}
        scatter = fixed.get(options.gyro_bias, stated)
        # Flicker noise is taken as independent between neighbours: their difference has twice the variance.
        step = scatter * math.sqrt(2.0) / flicker_spread(data.windows.samples)
        mounting = mounting_prior(data.recording.fixture, start[1])
        integrated = np.zeros(len(data.windows.duration_s), dtype=np.bool_)
        self.choice = ModelChoice(data, DriftTerms(data), scatter, step, integrated, admission_sigma(), *mounting)
        self.processor = SrtProcessor(data, options, integrated)
        self._lay_out()
        # One for all models of the recording: steps of the drift, by the number of parts of a rotation.
        self._chain = cache(partial(drift_chain, data, self.rank[self.window_sequence], self.rank))
        self.fixed_values = fixed_values(data, options, start[0])
        deviation, earth_rate = np.zeros((data.K, 3)), np.zeros((len(self.level_frames), 3))
        self.start = JointState(start[0], deviation, np.eye(3), start[1], 0.0, 0.0, earth_rate, np.zeros(0))
        if options.gyro_bias == G_SENSITIVE:
            followed, self.start = self.with_g_sensitivity(self.start)
            self.choice, self.processor = followed.choice, followed.processor
        self._complete = True

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse changes of a complete model."""
        if "_complete" in vars(self):
            raise AttributeError(f"{name} of a joint model does not change: make another model by with_choice.")
        super().__setattr__(name, value)

    def _with(self, **attributes: Any) -> JointModel:
        out = copy(self)
        vars(out).update(attributes)
        return out

    def with_choice(self, **changes: Any) -> JointModel:
        """Model with another choice; ``changes`` are attributes of :class:`~srt.joint.joint_state.ModelChoice`."""
        return self._with(choice=replace(self.choice, **changes))

    @property
    def data(self) -> PreparedRecording:
        """Data with the noise model that is chosen."""
        return self.choice.data

    def _lay_out(self) -> None:
        """Assign windows and sequences to level frames, and each window to the first sequence that uses it."""
        data = self.data
        W = len(data.windows.duration_s)
        self.order = np.argsort(data.rotation[:, 0], kind="stable")
        self.rank = np.argsort(self.order)
        self.window_sequence = np.full(W, -1, dtype=np.intp)
        self.window_frame = np.full(W, -1, dtype=np.intp)
        self.sequence_frame = np.empty(data.K, dtype=np.intp)
        self.level_frames: list[LevelFrame] = []
        fixture_frame = -1
        for k in self.order.tolist():
            s, e = int(data.start[k]), int(data.end[k])
            if self.window_frame[s] < 0:
                if self.nominal[k] is None or fixture_frame < 0:
                    self.level_frames.append(self._level_frame(fixture=self.nominal[k] is not None))
                    if self.nominal[k] is not None:
                        fixture_frame = len(self.level_frames) - 1
                self.window_frame[s] = fixture_frame if self.nominal[k] is not None else len(self.level_frames) - 1
            self.sequence_frame[k] = self.window_frame[e] = self.window_frame[s]
        # A move has no windows of its own.
        for k in self.order[np.argsort(data.is_move[self.order], kind="stable")].tolist():
            for w in (int(data.start[k]), int(data.end[k])):
                if self.window_sequence[w] < 0:
                    self.window_sequence[w] = k
        # A pose without its rotation takes the gyro bias of the sequence before it.
        for _, w in data.poses:
            before = np.flatnonzero(data.rotation[self.order, 0] < data.windows.samples[w, 0])
            self.window_sequence[w] = self.order[before[-1]] if before.size else self.order[0]
            self.window_frame[w] = fixture_frame
        middle = data.windows.samples.mean(axis=1)
        self.times = 0.5 * (middle[data.start] + middle[data.end])
        steps = np.diff(self.times[self.order])
        span = float(steps.sum())
        # A random walk of total variance Q scatters by Q / 6 about its mean.
        self.walk_share = 6.0 * steps / span if span > 0.0 else np.zeros(0)

    def _level_frame(self, *, fixture: bool) -> LevelFrame:
        latitude = self.data.recording.site.latitude_rad
        unknown = sources.unknown_earth_rate(self.data.recording, placed=fixture)
        known = np.zeros(3)
        if latitude is not None:
            known = EARTH_RATE_RAD_S * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])
        return LevelFrame(np.where(unknown > 0.0, 0.0, known), unknown, fixture)

    def with_mounting_prior(self, state: JointState) -> JointModel:
        """Model with the mounting's prior near the solution, so that it does not depend on the initial estimate."""
        U, fixture, choice = state.U, self.data.recording.fixture, self.choice
        if self.data.nominal is None or fixture is None:
            return self
        if np.linalg.norm(rotation_vector(U[None])) > 0.5 * mounting_limit(fixture, choice.unmodelled_sigma):
            gamma = choice.drift.g_sensitivity(state.drift)
            U = self.processor.process(state.errors, U=U, g_sensitivity=gamma).U
        U, note = mounting_prior(fixture, U, choice.unmodelled_sigma)
        return self.with_choice(U_prior=U, U_note=note)

    @property
    def heading_rad(self) -> float:
        """Heading of the fixture; 0 if unknown, as the horizontal Earth's rate is estimated then."""
        fixture = self.data.recording.fixture
        return 0.0 if fixture is None or fixture.heading_rad is None else fixture.heading_rad

    def with_tied_ends(self, sigma: Array) -> JointModel | None:
        """Model that uses the fixture in end attitudes, once the sensor errors are known to ``sigma``; None before.

        With large errors, products of two of them exceed the wobble, and the iteration would converge slowly.
        """
        new = not self.choice.ends_tied and bool(np.all(sigma / PARAMETER_UNITS < _LINEAR))
        return self.with_choice(ends_tied=True) if new else None

    @cached_property
    def nominal_ends(self) -> list[Array | None]:
        """Nominal end attitude of every sequence, T to base; None if a rotation is not about an axis of the fixture."""
        return [None if C is None else nominal_end(s) for C, s in zip(self.nominal, self.data.catalogue, strict=True)]

    def without_moves(self, reasons: Mapping[int, str]) -> JointModel:
        """Model of the recording without some moves, by their position and with the reason, and with the same drift."""
        out = JointModel(self.data.without_moves(reasons), self.options, (self.start.errors, self.start.U))
        drift = self.choice.drift
        if drift.force_axes is not None and out.choice.drift.force_axes is None:
            out = out.with_g_sensitivity(out.start)[0]
        out, start = out.with_drift(drift.terms, out.start)
        return out._with(start=start).with_choice(unmodelled_sigma=self.choice.unmodelled_sigma)

    def with_drift(self, terms: tuple[DriftTerm, ...], state: JointState) -> tuple[JointModel, JointState]:
        """Model with terms of drift beside those that it has, and a state with their coefficients, zero."""
        before = self.choice.drift
        drift = DriftTerms(self.data, (*before.terms, *terms), before.force_axes)
        coefficients = np.append(state.drift, np.zeros(drift.size - len(state.drift)))
        return self.with_choice(drift=drift), replace(state, drift=coefficients)

    def with_g_sensitivity(self, state: JointState) -> tuple[JointModel, JointState]:
        """Model with gyro g-sensitivity where the poses show it, and the state with Γ from the rates at rest."""
        axes = self._poses(state).observed
        out = self.with_force_axes(axes)
        measured = out.processor.process(state.errors, U=state.U)
        assert measured.poses is not None
        first = measured.gyro.matrix @ measured.poses.fit(measured.rest_rate) @ axes.T
        state = replace(state, drift=np.concatenate([first.T.ravel(), state.drift]))
        return out._with(start=replace(self.start, drift=state.drift)), state

    def with_force_axes(self, axes: Array) -> JointModel:
        """Model with gyro g-sensitivity along axes of B, unit vectors of shape (n, 3)."""
        drift = DriftTerms(self.data, self.choice.drift.terms, axes)
        processor = SrtProcessor(self.data, replace(self.options, gyro_bias=G_SENSITIVE), self.choice.integrated)
        return self._with(processor=processor).with_choice(drift=drift)

    def _poses(self, state: JointState) -> PoseRegression:
        """Regression of the rates at rest on specific force."""
        return self.rest_rates(state, np.zeros((len(self.choice.integrated), 3))).poses

    def rest_rates(self, state: JointState, rate: Array) -> RestRates:
        """Rates at rest, shape (W, 3), rad/s, with their regression on specific force."""
        T = self.data.windows.duration_s
        force, pool = accel_triad(state.errors).compensate(self.data.windows.accel_mean), T / T.sum()
        poses = pose_regression(force, pool, self.data.gravity)
        return RestRates(poses, force, rate, pool, self.window_sequence, gyro_triad(state.errors))

    @property
    def relies_on_fixture(self) -> bool:
        """True if the prior of :meth:`relying_on_fixture` is in use."""
        return bool(np.any(self.choice.admission < admission_sigma()))

    def relying_on_fixture(self, uncertain: Array) -> tuple[JointModel, Prior]:
        """Model with a prior about the values that the nominal angles of the fixture give, with sigma ``uncertain``.

        A parameter is then observed if the measurements reduce this sigma to a third. The others have the value that
        prior and measurements together give, so that sums that are known better stay right.
        """
        sigma = np.minimum(admission_sigma(), np.where(uncertain > 0.0, uncertain, np.inf))
        return self.with_choice(admission=sigma), Prior.from_sigma(sigma, self.fixed_values)

    def with_fixed_values(self, state: JointState, fixed: Mask) -> JointState:
        """Give fixed parameters their values."""
        vector = np.where(fixed, self.fixed_values.vector, state.errors.vector)
        return replace(state, errors=SensorErrors(vector))

    def bias_walk_sigma(self) -> Array:
        """Standard deviation of the bias steps between sequences in time order, shape (K − 1, 3), rad/s."""
        least = _LEAST_WALK * self.data.noise.gyro_white / math.sqrt(float(self.data.windows.duration_s.max()))
        by_scatter = np.sqrt(self.walk_share)[:, None] * self.choice.bias_scatter
        # From pose to pose, g-sensitivity and flicker noise change by more than a random walk with that scatter.
        return np.asarray(np.maximum(np.maximum(by_scatter, self.choice.bias_step), least))

    @property
    def bias_walks(self) -> bool:
        """True if every sequence has its own gyro bias, following a random walk."""
        free = self.data.noise.gyro_flicker is None or self.options.gyro_bias == "per-sequence"
        return free and bool(self.choice.bias_scatter.any()) and self.data.K > 1

    def earth_rate(self, state: JointState) -> Array:
        """Earth's rate ω_L in the level frame of every window, shape (W, 3), rad/s."""
        by_frame = np.stack([frame.earth_rate for frame in self.level_frames]) + state.earth_rate
        return np.asarray(by_frame[self.window_frame])

    def compensate(self, state: JointState) -> CompensatedData:
        """Compensate the recorded data with an estimate, and integrate the rotations."""
        gyro, accel = gyro_triad(state.errors), accel_triad(state.errors)
        slope = np.linalg.inv(gyro.matrix)
        deviation = state.bias_deviation @ slope.T
        gyro_mean, accel_mean = self.data.means(gyro, accel)
        force = accel.compensate(accel_mean)
        rate = gyro.compensate(gyro_mean - force @ self.choice.drift.g_sensitivity(state.drift).T)
        force_jacobian = model.force_error_jacobian(force, accel)
        rate_jacobian = model.rate_error_jacobian(rate, gyro, self.data.rectified(gyro, accel)[0])
        raw_rate, raw_force = rate, force
        rate = rate - deviation[self.window_sequence]
        deviation = deviation + self.choice.drift.raw("gyro", state.drift, "parts").mean(axis=1) @ slope.T
        integrals, rotation, force = self._integrate(state, deviation, force)
        by = sources.slopes(gyro, accel, raw_rate, raw_force, integrals)
        by_drift = self._drift_form(by, gyro)
        stated = self.steady
        along = stated.compensated_force(accel)
        self.choice.drift.add_g_sensitivity(by_drift, by, raw_force, (stated.by_raw_rate(gyro), along))
        drift = self.choice.drift.of_forms(state.drift)
        force, rate = force - by_drift["force"] @ drift, rate - by_drift["rate"] @ drift
        rotation = rotation_matrix(-self._rotation_drift(integrals, state)) @ rotation
        noise = self._sensor_noise(by)
        return CompensatedData(
            force=force,
            rate=rate,
            force_jacobian=force_jacobian,
            rate_jacobian=rate_jacobian,
            force_noise=sources.own_covariances(noise, "force"),
            rate_noise=sources.own_covariances(noise, "rate"),
            rotation_noise=sources.own_covariances(noise, "turn"),
            rotation=rotation,
            rotation_jacobian=model.attitude_error_jacobian(integrals),
            duration_s=integrals.weight_s,
            edges=noise["gyro_quantization"],
            slopes=by,
            stated=self._stated_rates(state, gyro, along),
            drift_form=by_drift,
            drift=self.instability(by, gyro),
        )

    def _stated_rates(self, state: JointState, gyro: Triad, force: Array) -> StatedRates:
        """Runs at a stated rate; ``force`` is the mean specific force in the halves of their steady windows."""
        rated, shares = self.steady.rated, self.steady.shares
        drift = state.bias_deviation[rated, None] + shares @ self.choice.drift.raw("gyro", state.drift, "parts")[rated]
        windows, earth = self.data.start[rated], np.zeros((len(rated), 1, 3))
        if state.attitude is not None:  # before the first iteration it is unknown
            earth = self.earth_rate(state)[windows, None] @ state.attitude[windows]
        raw_bias = drift + force @ self.choice.drift.g_sensitivity(state.drift).T
        return self.steady.compensate(gyro, raw_bias, earth, self.data.noise)

    def _drift_form(self, by: Slopes, gyro: Triad) -> dict[str, Array]:
        """Effect of the coefficients of the modelled drift on all measurements."""
        assert by.integrals.time_parts is not None
        stated = self.steady
        return {
            "stated_rate": self.choice.drift.jacobian("gyro", "parts", stated.by_parts(gyro), stated.rated),
            "force": self.choice.drift.jacobian("accel", "windows", by.force),
            "rate": self.choice.drift.jacobian("gyro", "windows", by.rate),
            "turn": self.choice.drift.jacobian("gyro", "parts", by.integrals.time_parts),
        }

    def _rotation_drift(self, integrals: RotationIntegrals, state: JointState) -> Array:
        """Attitude error of the rotations by the modelled drift about its mean in each rotation, shape (K, 3), rad."""
        drift = self.choice.drift.raw("gyro", state.drift, "parts")
        assert integrals.time_parts is not None
        return np.asarray(np.einsum("kpab,kpb->ka", integrals.time_parts, drift - drift.mean(axis=1, keepdims=True)))

    def instability(self, by: Slopes, gyro: Triad) -> dict[str, DriftStates]:
        """Effect of the bias instability as specified, by sensor; not of that of the gyros if one bias is asked for."""
        noise, stated, out = self.data.noise, self.steady, {}
        flicker, parts = noise.gyro_flicker, by.integrals.time_parts
        gyros = flicker is not None and flicker.any() and self.options.gyro_bias != "pooled"
        count = parts_per_rotation(self.data.K) if gyros else 0
        if gyros and flicker is not None and parts is not None:
            rotations = {"turn": (np.arange(self.data.K), parts)}
            if stated.rated.size:
                rotations["stated_rate"] = stated.rated, stated.by_parts(gyro)
            out["gyro"] = drift_states(self._chain(count), flicker, ("rate", by.rate), rotations)
        if noise.accel_flicker.any():  # in the steps of the gyros, if there are any
            out["accel"] = drift_states(self._chain(count), noise.accel_flicker, ("force", by.force))
        return out

    def with_data(self, data: PreparedRecording) -> JointModel:
        """Model of data with another noise model."""
        wander = data.noise.gyro_wander
        return self.with_choice(data=data, bias_scatter=self.choice.bias_scatter if wander is None else wander)

    def _integrate(self, state: JointState, deviation: Array, force: Array) -> tuple[RotationIntegrals, Array, Array]:
        """Integrals of the rotations, rotations relative to inertial space, and mean specific forces of the windows.

        The force of a window in which the unit moved is averaged in one attitude, not in that of each sample: that at
        the beginning of the window, or at the end of one from which no rotation starts.
        """
        data = self.data
        if not self.choice.integrated.any():
            integrals, _ = integrate_attitude(
                self.processor.stream_without(self.choice.drift.g_sensitivity(state.drift), accel_triad(state.errors)),
                gyro_triad(state.errors),
                np.zeros((data.K, 3)),
                bias_offset=deviation,
                sample_noise_rad=data.noise.gyro_sample(data.recording.nominal_interval_s),
                with_noise=True,
            )
            return integrals, integrals.C_end, force
        processed = self.processor.process(
            state.errors,
            U=state.U,
            bias_offset=deviation,
            g_sensitivity=self.choice.drift.g_sensitivity(state.drift),
            earth_rate_offset=self._unknown_earth_rate(state),
            with_noise=True,
        )
        integrals = processed.integrals
        assert integrals.C_turned is not None
        shared = self.choice.integrated[data.end] & np.isin(data.end, data.start)
        C_end = np.where(shared[:, None, None], integrals.C_turned, integrals.C_end)
        rotation = rotation_matrix(processed.earth_rate * integrals.weight_s[:, None]) @ C_end
        force = force.copy()
        at_end = np.einsum("kba,kb->ka", integrals.C_end, processed.carried[:, 1])
        for windows, carried in ((data.end, at_end), (data.start, processed.carried[:, 0])):
            used = self.choice.integrated[windows]
            force[windows[used]] = carried[used]
        return integrals, rotation, force

    def _unknown_earth_rate(self, state: JointState) -> Array | float:
        """Estimate of the unknown part of the Earth's rate in B_Strt of each sequence, shape (K, 3), rad/s.

        Over a window of 20 s it is 1 mrad of attitude, which would be an error of 1 mg of its mean specific force.
        """
        if state.attitude is None:
            return 0.0
        by_frame = state.earth_rate[self.sequence_frame]
        return np.asarray(np.einsum("kab,ka->kb", state.attitude[self.data.start], by_frame))

    def _sensor_noise(self, by: Slopes) -> dict[str, Source]:
        """Noise of the sensors and unmodelled errors."""
        # Errors at the edges are unknowns if they matter.
        white = self.data.noise.gyro_white**2 * float(by.integrals.weight_s.min())
        shared = bool(np.any(2.0 * self.data.noise.gyro_edge**2 > _RELEVANT_EDGE_NOISE * white))
        out = sources.white_noise(self.data, by) | sources.quantization(self.data, by, shared=shared)
        if self.choice.integrated.any():
            # In a window with integrated attitude the gyros measure motion: 1 rad/s gives the rate no weight.
            out["gyro_noise"].own["rate"][self.choice.integrated] = np.eye(3)
            out["gyro_noise"].own["turn"] += sources.excess_of_turns(self.data, by, self.choice.integrated)
        for term, _ in self.choice.drift.of("gyro"):
            if term.form == WALK:
                out["gyro_drift"] = sources.walk_between_windows(self.data, by, term.sigma)
        out |= sources.undersampled_motion(self.data)
        return out | sources.unmodelled(self.data, self.choice.unmodelled_sigma)

    def rest_rate(self, state: JointState, compensated: CompensatedData) -> Array:
        """Compensated rates of the windows with the bias of their sequence, less the Earth's, shape (W, 3), rad/s."""
        assert state.attitude is not None
        rest, _, _ = model.angular_rate_residual(compensated.rate, state.attitude, self.earth_rate(state))
        own = state.bias_deviation @ np.linalg.inv(gyro_triad(state.errors).matrix).T
        return np.asarray(rest + own[self.window_sequence])

    def moving_windows(self, state: JointState, compensated: CompensatedData, suspect: Mask | None = None) -> Mask:
        """Windows, assumed stationary so far, in which the unit moved, shape (W,); see :func:`moved_windows`."""
        assert state.attitude is not None
        gyro = gyro_triad(state.errors)
        rest = model.angular_rate_residual(compensated.rate, state.attitude, self.earth_rate(state))[0]
        wander = np.sqrt(np.linalg.inv(gyro.matrix) ** 2 @ self.choice.bias_scatter**2)
        chance, accel = STILLNESS_PROBABILITY / len(rest), accel_triad(state.errors)
        drift = [self.choice.drift.raw(sensor, state.drift, "halves") for sensor in ("gyro", "accel")]
        moved = moved_windows(self.data, gyro, accel, rest, wander, chance, drift=drift, suspect=suspect)
        return np.asarray(moved & ~self.choice.integrated)

    def with_integrated(self, windows: Mask) -> JointModel:
        """Model that integrates the attitude over these windows, too, instead of taking it as constant."""
        integrated = self.choice.integrated | windows
        processor = SrtProcessor(self.data, self.processor.options, integrated)
        return self._with(processor=processor).with_choice(integrated=integrated)

    @cached_property
    def rest_rate_weights(self) -> Array:
        """Weights of the windows in the mean rest rate of each sequence, shape (K, W)."""
        T = self.data.windows.duration_s
        weights = np.zeros((self.data.K, len(T)))
        for which in (self.data.start, self.data.end):
            weights[np.arange(self.data.K), which] = T[which]
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def with_bias_scatter(self, state: JointState, compensated: CompensatedData, correction: float) -> JointModel:
        """Model with the bias scatter between sequences of the rates at rest, if no instability is specified."""
        free = self.options.gyro_bias in ("auto", G_SENSITIVE)
        if self.data.noise.gyro_wander is not None or not free or self.data.K < 3:
            return self
        rest = np.einsum("wab,wb->wa", np.linalg.inv(compensated.slopes.rate), self.rest_rate(state, compensated))
        left = 1.0
        if self.choice.drift.force_axes is not None:  # the scatter beyond g-sensitivity, of which its fit takes a part
            poses, T = self._poses(state), self.data.windows.duration_s
            rest = rest - compensated.force @ poses.fit(rest).T
            deviation = self.rest_rate_weights - T / T.sum()
            left = float(poses.scatter_left(compensated.force, deviation, self.window_sequence))
            if left < LEAST_SCATTER:
                return self.with_choice(bias_scatter=np.zeros(3), bias_step=np.zeros(3))
        weights = self.rest_rate_weights
        variance = sources.raw_rate_variance(self.data.noise, self.data.windows.duration_s)
        doubt = sources.earth_rate_sigma(self.data.recording, self.choice.unmodelled_sigma)
        noise = np.mean(weights[~self.data.is_move] ** 2 @ variance, axis=0)
        expected = noise + doubt**2
        own = weights @ rest
        own = own.mean(axis=0) + (own - own.mean(axis=0)) / math.sqrt(left)
        unstated = self.data.recording.noise.gyro_noise is None
        # In hand the Earth's rate is estimated, with attitudes that are as far off as the last correction.
        off = min(doubt, EARTH_RATE_RAD_S * correction) if self.data.recording.fixture is None else doubt
        least = noise + off**2
        excess = excess_variance(own[~self.data.is_move], expected, least if unstated else None)
        scatter = np.sqrt(excess)
        in_time = self.order[~self.data.is_move[self.order]]
        steps = np.mean(np.diff(own[in_time], axis=0) ** 2, axis=0) - 2.0 * expected
        step = np.where(scatter > 0.0, np.sqrt(np.maximum(steps, 0.0)), 0.0)
        return self.with_choice(bias_scatter=scatter, bias_step=step)
