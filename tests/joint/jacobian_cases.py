"""Rotations and recordings that the tests of the Jacobians of joint estimation share."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from accuracy_trials import large_errors
from scipy.spatial.transform import Rotation

import sims
from sims.physics.free_motion import Placement, Turn, placed_motion
from sims.physics.turn_profiles import trapezoid
from srt.estimation.options import Options
from srt.joint.initial_attitudes import initial_attitudes
from srt.joint.joint_model import JointModel
from srt.joint.linearisation import linearise
from srt.joint.recording_opening import open_joint_model
from srt.model.prior import Prior
from srt.recording.recording import Fixture, ImuNoise, SequenceLabel, Site
from srt.sensor_errors import N_PARAMETERS, SensorErrors

EPS = np.finfo(float).eps
G = 9.80665


def exp(v):
    return Rotation.from_rotvec(v).as_matrix()


HEADING = 0.7
MARS = sims.rotation([0.4, -0.3, 0.5])


def away(size, count, seed=1):
    """Random rotations of one angle."""
    v = np.random.default_rng(seed).standard_normal((count, 3))
    return exp(size * v / np.linalg.norm(v, axis=1, keepdims=True))


HZ, RATE, DWELL_S = 100.0, 1.0, 2.0
SITE = Site(G, 1e-4, math.radians(50.0))
# Far below the Earth's rate in a sample, so that nowhere a sign depends on the neighbours; pulses that count, and a
# bias that drifts.
NOISE = ImuNoise(1e-9, 1e-7, 3e-9, 1e-9, 1e-9, 1e-9)
TABLE = ("1", "4", "8")


@dataclass(frozen=True)
class Variant:
    """A kind of recording and of problem."""

    free: bool = False
    heading: bool = True
    latitude: bool = True
    walk: bool = True
    fixture_states: bool = True
    prior: bool = True
    instability: bool = False
    rates: bool = False

    @property
    def motion(self) -> str:
        return "rates" if self.rates else "free" if self.free else "table"


VARIANTS = {
    "all": Variant(),
    "plain": Variant(walk=False, prior=False),
    "no fixture states": Variant(fixture_states=False, walk=False),
    "no heading": Variant(heading=False),
    "no latitude": Variant(latitude=False, walk=False),
    "free": Variant(free=True),
    "drift": Variant(walk=False, instability=True),
    "rates": Variant(free=True, rates=True),
    "rates, drift": Variant(free=True, rates=True, walk=False, prior=False, instability=True),
}


def errors_of(size):
    if size == "large":
        return large_errors(np.random.default_rng(8))[0]
    scale = {"zero": 0.0, "tiny": 1e-6}[size]
    return SensorErrors(scale * np.random.default_rng(9).standard_normal(N_PARAMETERS))


RUN_S, RAMP_S = 9.0, 0.5


def rates_motion():
    """Three runs of a rate table and a turn; the axes lie away from those of the sensors, and from the vertical."""
    profile = trapezoid(RAMP_S / RUN_S)
    axes = [np.array(v) / np.linalg.norm(v) for v in ([1.0, 0.3, -0.2], [-1.0, -0.3, 0.2], [0.2, 1.0, 0.3])]
    runs = [(Turn(RATE * (RUN_S - RAMP_S) * axis, RUN_S, profile),) for axis in axes]
    upright = [
        exp(0.1 * np.ones(3)) @ Rotation.align_vectors([[0.0, 0.0, 1.0]], [axis])[0].as_matrix() for axis in axes
    ]
    placements = (
        Placement(upright[0], DWELL_S, (runs[0], runs[1]), (DWELL_S, DWELL_S)),
        Placement(upright[2], DWELL_S, (runs[2], (Turn(np.array([0.6, 0.3, -0.5]), 3.0),)), (DWELL_S, DWELL_S)),
    )
    motion, starts = placed_motion(placements, site=SITE, pause_s=1.0, settle_s=0.1, sample_rate_hz=HZ)
    stated = [("x", RATE), ("x", -RATE), ("y", RATE)]
    labels = [
        SequenceLabel(*pair, rate=rate, rate_sigma=1e-4, steady_s=(start + RAMP_S, start + RUN_S - RAMP_S))
        for pair, start, rate in zip(motion.windows, starts, stated, strict=False)
    ]
    return replace(motion, labels=(*labels, SequenceLabel(*motion.windows[3])))


@cache
def simulated_motions():
    """A table run on a poor fixture, the body well away from the table, turns by hand, and a rate table.

    No |·| stands at zero.
    """
    draw = sims.draw_fixture(
        np.random.default_rng(4),
        sims.table_sequences(TABLE),
        level_sigma_rad=5e-3,
        north_sigma_rad=5e-3,
        mounting_sigma_rad=5e-3,
        rotation_sigma_rad=5e-3,
    )
    table = sims.run_schedule(
        sims.Schedule(
            sims.table_sequences(TABLE), sims.RateProfile(RATE, 10.0), dwell_s=DWELL_S, leg_dwell_s=0.05, settle_s=0.1
        ),
        site=SITE,
        sample_rate_hz=HZ,
        heading_rad=HEADING,
        fixture_draw=draw,
        U=MARS,
        stated_fixture=Fixture(HEADING, 5e-3, 5e-3),
    )
    rng = np.random.default_rng(6)
    free = sims.free_motion(
        sims.random_turns(rng, 4),
        site=SITE,
        attitude=sims.random_attitude(rng),
        peak_rate_rad_s=RATE,
        dwell_s=DWELL_S,
        settle_s=0.1,
        sample_rate_hz=HZ,
    )
    return {"free": free, "table": table, "rates": rates_motion()}


@dataclass(frozen=True)
class Case:
    joint: JointModel
    state: object
    system: object
    prior: Prior | None
    errors: SensorErrors


def make(motions, variant, size, noise=NOISE, off=True):
    """Problem and a point well away from its solution in all but the sensor errors, played back and linearised."""
    motion = motions[variant.motion]
    errors = errors_of(size)
    site = SITE if variant.latitude else replace(SITE, latitude_rad=None)
    fixture = None if variant.free else Fixture(HEADING if variant.heading else None, 5e-3, 5e-3)
    recording = replace(sims.read_out(motion.stated_as(site=site), errors), noise=noise, fixture=fixture)
    if variant.free:
        labels = motion.labels if variant.rates else [SequenceLabel(a, b) for a, b in motion.windows]
        recording = recording.with_sequences(tuple(labels))
    # Of one bias per sequence, of one with the drift that is stated, and of one alone.
    mode = "per-sequence" if variant.walk else "auto" if variant.instability else "pooled"
    options = Options(gyro_bias=mode, fixture_states=variant.fixture_states, start=errors)
    joint = open_joint_model(recording, options).with_choice(ends_tied=True)
    rng = np.random.default_rng(11)
    state = replace(joint.start, U=motion.U)
    state = initial_attitudes(joint, state, joint.compensate(state))
    if off:
        a = 0.3 if size == "large" else 1e-3
        deviation = 1e-8 * rng.standard_normal(state.bias_deviation.shape) * variant.walk
        unknown = np.stack([c.unknown_sigma > 0.0 for c in joint.level_frames])
        state = replace(
            state,
            bias_deviation=deviation - deviation.mean(axis=0),
            base=state.base @ sims.rotation(a * rng.uniform(-0.5, 0.5, 3)),
            U=state.U @ sims.rotation(a * rng.uniform(-0.5, 0.5, 3)),
            gravity=1e-3 * variant.fixture_states,
            earth_rate=1e-5 * rng.standard_normal(state.earth_rate.shape) * unknown,
            attitude=state.attitude @ away(a, len(state.attitude), 12),
            table_rate=0.7 * variant.rates,
        )
    prior = None
    if variant.prior:
        root = np.diag(rng.uniform(0.5, 2.0, N_PARAMETERS)) @ (np.eye(N_PARAMETERS) + 0.1)
        prior = Prior(SensorErrors(errors.vector + 0.01), root @ root.T)
    system = linearise(joint, state, joint.compensate(state), np.ones(N_PARAMETERS, dtype=bool), prior)
    return Case(joint, state, system, prior, errors)


def marks(variant, size):
    """Quick tests have large errors, where every term counts; the slow ones zero errors of all unknowns and of none."""
    if size == "large":
        return ()
    return pytest.mark.slow if size == "zero" and variant in ("all", "free") else pytest.mark.campaign


CASES = [pytest.param(v, s, id=f"{v}-{s}", marks=marks(v, s)) for v in VARIANTS for s in ("zero", "tiny", "large")]
