"""Jacobians of joint estimation: rotations, the measurements of windows and turns, and the whole linearised problem.

Measurements are held against the simulator's own geometry, Jacobians against differences of what they linearise: the
functions of the model by small rotations of scipy's, the system by playing the recording back at other points, and
what a reading error at a window's edge does by putting it into the samples. The factors of the graph are held against
the rows of the system.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from accuracy_trials import large_errors
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

import sims
from sims.physics.fixture import FixtureDraw, FixtureGeometry, earth_rate_ned
from srt.estimation.options import Options
from srt.model import analytic_platform, rotations
from srt.model import measurement_model as model
from srt.model.prior import Prior
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.recording.recording import Fixture, ImuNoise, SequenceLabel, Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

pytest.importorskip("gtsam")

import gtsam

from estimators.dense_solution import solve
from estimators.factor_graph import FactorGraph
from estimators.graph import solve_linear
from estimators.iteration import apply_correction
from estimators.joint_model import JointModel, open_joint_model
from estimators.linear_system import N_ERRORS
from estimators.linearisation import edge_numbers, linearise

EPS = np.finfo(float).eps
G = 9.80665

# --- rotations ------------------------------------------------------------------------------------------------------


def directions():
    return arrays(float, 3, elements=st.floats(-1.0, 1.0)).filter(lambda v: np.linalg.norm(v) > 0.1)


def exp(v):
    return Rotation.from_rotvec(v).as_matrix()


def log(C):
    return Rotation.from_matrix(C).as_rotvec()


def derivative(function, size=3, step=1e-3):
    """Derivative at zero by differences of fourth order, the derivative's index last.

    What is left is step⁴ of the fifth derivative over 30, and rounding over the step: both 1e-12 of a function of
    size one.
    """
    out = []
    for d in step * np.eye(size):
        near, far = function(d) - function(-d), function(2.0 * d) - function(-2.0 * d)
        out.append((8.0 * near - far) / (12.0 * step))
    return np.stack(out, axis=-1)


def numerical(scale, distance=1.0, step=1e-3):
    """Error of :func:`derivative` for an analytic function of this size whose singularity is so far away (rad).

    Its fifth derivative is below 5! scale / distance⁵; rounding, of some ten operations each, comes 1.5 times.
    """
    return scale * (4.0 * (step / distance) ** 4 / distance + 15.0 * EPS / step)


@settings(deadline=None)
@given(directions(), st.one_of(st.floats(0.0, math.pi - 1e-7), st.floats(-12.0, -3.0).map(lambda p: 10.0**p)))
def test_rotation_vectors_round_trip(direction, angle):
    """To rounding of the angle, and of a small one relative to itself; at half a turn the sign alone is open."""
    phi = angle * direction / np.linalg.norm(direction)
    found = rotations.rotation_vector(rotations.rotation_matrix(phi[None]))[0]
    # The quaternion's elements come with some ten roundings, the angle is twice its arc; subnormal numbers have none.
    assert np.abs(found - phi).max() <= 20.0 * EPS * angle + 1e-300
    np.testing.assert_allclose(rotations.rotation_vector(exp(phi)[None])[0], phi, rtol=0, atol=20.0 * EPS)


@settings(deadline=None)
@given(directions(), st.floats(0.0, 1e-7))
def test_rotation_vectors_at_half_a_turn(direction, less):
    phi = (math.pi - less) * direction / np.linalg.norm(direction)
    C = rotations.rotation_matrix(phi[None])
    found = rotations.rotation_vector(C)[0]
    assert np.linalg.norm(found) <= math.pi + 4.0 * EPS
    # Either sign is within rounding of half a turn.
    off = min(np.abs(found - phi).max(), np.abs(found + phi).max() - 2.0 * less)
    assert off <= 20.0 * EPS
    np.testing.assert_allclose(exp(found), C[0], rtol=0, atol=20.0 * EPS)


def test_no_rotation_at_all():
    assert not rotations.rotation_vector(np.eye(3)[None]).any()
    np.testing.assert_array_equal(rotations.inverse_right_jacobian(np.zeros((1, 3)))[0], np.eye(3))


@settings(deadline=None)
@given(directions(), st.one_of(st.just(0.0), st.floats(1e-4, 2e-3), st.floats(0.0, math.pi - 0.01)))
def test_inverse_right_jacobian(direction, angle):
    """Log(Exp(φ) Exp(δ)) and Log(Exp(δ) Exp(φ)), also where the series ends; both vary over a whole turn, 2π away."""
    phi = angle * direction / np.linalg.norm(direction)
    found = rotations.inverse_right_jacobian(phi[None])[0]
    right = derivative(lambda d: log(exp(phi) @ exp(d)))
    left = derivative(lambda d: log(exp(d) @ exp(phi)))
    assert np.abs(found - right).max() <= numerical(4.0, 2.0)
    assert np.abs(found.T - left).max() <= numerical(4.0, 2.0)


@settings(deadline=None)
@given(directions(), st.floats(0.0, 2.0 * math.pi - 0.1))
def test_inverse_right_jacobian_is_the_inverse(direction, angle):
    """Of Σ (−φ×)ⁿ / (n + 1)!, at any angle; 40 terms leave 1e-16 of it."""
    phi = angle * direction / np.linalg.norm(direction)
    X, term, Jr = rotations.cross_matrix(phi), np.eye(3), np.eye(3)
    for n in range(1, 41):
        term = term @ -X / (n + 1)
        Jr = Jr + term
    found = rotations.inverse_right_jacobian(phi[None])[0]
    # Terms of up to e^|φ|, and an inverse of up to |φ| / (2 sin |φ|/2).
    assert np.abs(found @ Jr - np.eye(3)).max() <= 10.0 * EPS * math.exp(angle) * np.linalg.norm(found, 2)


@settings(deadline=None)
@given(directions(), directions(), st.floats(0.0, math.pi - 2e-3))
def test_smallest_rotation(first, other, angle):
    """Takes one vector to the other, about an axis square to both, by the angle between them."""
    a = first / np.linalg.norm(first)
    axis = np.cross(a, other)
    assume(np.linalg.norm(axis) > 0.1)
    axis /= np.linalg.norm(axis)
    b = exp(angle * axis) @ a
    found = rotations.smallest_rotation(a[None], b[None])[0]
    rounding = 20.0 * EPS / (1.0 + math.cos(angle))
    np.testing.assert_allclose(found @ a, b, rtol=0, atol=rounding)
    np.testing.assert_allclose(found @ axis, axis, rtol=0, atol=rounding)
    np.testing.assert_allclose(found, exp(angle * axis), rtol=0, atol=rounding)


# --- windows, turns and start attitudes -----------------------------------------------------------------------------

HEADING = 0.7
EARTH_NED = earth_rate_ned(math.radians(50.0))
DRAW = FixtureDraw(base=np.array([0.02, -0.03, 0.05]), mounting=np.array([-0.04, 0.01, 0.03]))
MARS = sims.rotation([0.4, -0.3, 0.5])
FIXTURE = FixtureGeometry.build(HEADING, DRAW, MARS)
ANGLES = np.random.default_rng(3).uniform(-3.0, 3.0, (8, 2))
"""Inner and outer angles of eight poses; a turn leads from each to the next."""
POSES = np.stack([FIXTURE.attitude(*angles) for angles in ANGLES])
DURATION = np.linspace(2.0, 16.0, 7)

SIZES = (0.0, 1e-9, 1e-3, 0.3)


def away(size, count, seed=1):
    """Random rotations of one angle."""
    v = np.random.default_rng(seed).standard_normal((count, 3))
    return exp(size * v / np.linalg.norm(v, axis=1, keepdims=True))


def in_turn(count):
    """Rotation vectors for the members of an array, one after the other, from one vector."""
    return lambda v: exp(np.tile(v, (count, 1)))


@pytest.mark.parametrize("size", SIZES)
def test_specific_force_residual(size):
    force = -G * np.einsum("nab,a->nb", POSES, [0.0, 0.0, 1.0])
    A = POSES @ away(size, 8)
    residual, by_attitude, by_gravity = model.specific_force_residual(force, A, G)
    # A rotation by an angle moves the vertical by twice the sine of its half at most.
    assert np.linalg.norm(residual, axis=1).max() <= 2.0 * G * math.sin(size / 2.0) + 4.0 * EPS * G
    turn = in_turn(8)
    expected = derivative(lambda v: model.specific_force_residual(force, A @ turn(v), G)[0])
    assert np.abs(by_attitude - expected).max() <= numerical(G)
    expected = derivative(lambda v: model.specific_force_residual(force, A, G + v[0])[0], 1)[:, :, 0]
    assert np.abs(by_gravity - expected).max() <= numerical(G)


@pytest.mark.parametrize("size", SIZES)
def test_angular_rate_residual(size):
    ω = np.linalg.norm(EARTH_NED)
    earth = np.broadcast_to(EARTH_NED, (8, 3))
    rate = np.einsum("nab,a->nb", POSES, EARTH_NED)
    A = POSES @ away(size, 8)
    residual, by_attitude, by_earth = model.angular_rate_residual(rate, A, earth)
    assert np.linalg.norm(residual, axis=1).max() <= 2.0 * ω * math.sin(size / 2.0) + 4.0 * EPS * ω
    turn = in_turn(8)
    expected = derivative(lambda v: model.angular_rate_residual(rate, A @ turn(v), earth)[0])
    assert np.abs(by_attitude - expected).max() <= numerical(ω)
    expected = derivative(lambda v: model.angular_rate_residual(rate, A, earth + ω * v)[0]) / ω
    assert np.abs(by_earth - expected).max() <= numerical(1.0)


def sensed(speed, start, duration):
    """B_End to B_Strt against inertial space, from the rates that gyros on the fixture sense while it turns.

    Both axes turn at a constant rate of ``speed``; Magnus' integrator of fourth order in steps of 1e-3 rad.
    """
    count = math.ceil(float(np.abs(speed).sum()) * duration / 1e-3)
    dt = duration / count

    def rate(t):
        inner, outer = (start + np.multiply.outer(t, speed)).T
        turning = FIXTURE.turning_rate(inner, np.full(count, speed[0]), np.full(count, speed[1]))
        return turning + FIXTURE.to_body((FIXTURE.base_from_ned @ EARTH_NED)[None], inner, outer)[0]

    one, two = (rate(dt * (np.arange(count) + 0.5 + side * math.sqrt(3) / 6)) for side in (-1.0, 1.0))
    C = np.eye(3)
    for step in exp(0.5 * dt * (one + two) + math.sqrt(3) / 12 * dt**2 * np.cross(one, two)):
        C = C @ step
    return C


@pytest.fixture(scope="module")
def turned():
    """Ĉ of the turns between the poses, as simulated gyros have it."""
    return np.stack(
        [
            sensed((ANGLES[k + 1] - ANGLES[k]) / duration, ANGLES[k], duration)
            for k, duration in enumerate(DURATION.tolist())
        ]
    )


@pytest.mark.parametrize("size", SIZES)
def test_turn(turned, size):
    earth = np.broadcast_to(EARTH_NED, (7, 3))
    start, end = POSES[:-1] @ away(size, 7, 1), POSES[1:] @ away(size, 7, 2)
    residual, by_start, by_end, by_turned, by_earth = model.rotation_residual(turned, start, end, earth, DURATION)
    # Steps of 1e-3 rad at fourth order, up to 12 rad of them; both attitudes may be off by ``size``.
    assert np.linalg.norm(residual, axis=1).max() <= 2.0 * size + 12.0 * 1e-3**4
    if size == 0.3:
        assert np.linalg.norm(residual, axis=1).max() > 0.3  # not by chance near none
    turn = in_turn(7)

    def at(s=0.0, e=0.0, c=0.0, ω=0.0):
        s, e, c = (turn(np.zeros(3) + v) for v in (s, e, -np.asarray(c)))
        return model.rotation_residual(c @ turned, start @ s, end @ e, earth + ω, DURATION)[0]

    # The logarithm is singular a whole turn away, of which the attitudes may have taken 0.6 rad.
    atol = numerical(2.0, 2.0)
    assert np.abs(by_start - derivative(lambda v: at(s=v))).max() <= atol
    assert np.abs(by_end - derivative(lambda v: at(e=v))).max() <= atol
    # Errors left in the estimate turn Ĉ the other way: at x̂ + δ it is [I + (Jδ)×]⁻¹ Ĉ.
    assert np.abs(by_turned - derivative(lambda v: at(c=v))).max() <= atol
    expected = derivative(lambda v: at(ω=v / 16.0)) * 16.0
    # The left Jacobian of the Earth's turn stands to first order.
    neglected = (np.linalg.norm(EARTH_NED) * DURATION) ** 2 / 6.0 * DURATION * 1.1
    assert np.all(np.abs(by_earth - expected).max(axis=(1, 2)) <= neglected + 16.0 * atol)


@pytest.mark.parametrize("size", SIZES)
def test_start_attitude(size):
    """The fixture's errors come out as they were put in, and the derivatives are those of any attitude."""
    off = np.random.default_rng(5).standard_normal((8, 2)) * 0.02
    nominal = np.stack([Rotation.from_euler("YZ", [outer, inner]).as_matrix() for inner, outer in ANGLES])
    base, U = sims.rotation(DRAW.base), MARS @ sims.rotation(DRAW.mounting).T
    executed = np.stack([FIXTURE.attitude(*angles) for angles in ANGLES + off])
    found = model.start_attitude_residual(executed, nominal, base, U, HEADING)[0]
    np.testing.assert_allclose(found, np.pad(off, ((0, 0), (0, 1))), rtol=0, atol=20.0 * EPS)

    A = executed @ away(size, 8)
    residual, by_attitude, by_base, by_U = model.start_attitude_residual(A, nominal, base, U, HEADING)
    # Where the inner axis leans, the inner angle turns faster than the attitude does, by the cosine of the lean.
    assert np.abs(residual - found).max() <= size / math.cos(size) + 20.0 * EPS
    turn = in_turn(8)

    def at(a=0.0, b=0.0, u=0.0):
        a, b, u = (turn(np.zeros(3) + v) for v in (a, b, u))
        return model.start_attitude_residual(A @ a, nominal, base @ b[0], U @ u[0], HEADING)[0]

    # The angles are singular where the inner axis lies along the outer one, a right angle from square.
    atol = numerical(4.0, math.pi / 2.0 - 0.3)
    assert np.abs(by_attitude - derivative(lambda v: at(a=v))).max() <= atol
    assert np.abs(by_base - derivative(lambda v: at(b=v))).max() <= atol
    assert np.abs(by_U - derivative(lambda v: at(u=v))).max() <= atol


@pytest.mark.parametrize("lean", [1e-9, 1e-3, 0.3])
def test_lean_of_the_axes(lean):
    """The third component is the sine of what the fixture's axes are from square."""
    base, U = sims.rotation(DRAW.base), MARS @ sims.rotation(DRAW.mounting).T
    A = FixtureGeometry(FIXTURE.base_from_ned, lean, FIXTURE.body_from_inner).attitude(*ANGLES[0])
    nominal = Rotation.from_euler("YZ", ANGLES[0][::-1]).as_matrix()
    found = model.start_attitude_residual(A[None], nominal[None], base, U, HEADING)[0][0]
    assert abs(found[2] + math.sin(lean)) <= 10.0 * EPS
    assert abs(found[0]) <= lean**2 + 10.0 * EPS


@settings(deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_fixture_angles_all_around(inner, outer, off_inner, off_outer):
    """No jump where a nominal angle is half a turn."""
    nominal, executed = (
        Rotation.from_euler("YZ", [o, i]).as_matrix()[None]
        for i, o in ((inner, outer), (inner + off_inner, outer + off_outer))
    )
    found = model.start_attitude_residual(executed, nominal, np.eye(3), np.eye(3), 0.0)[0][0]
    np.testing.assert_allclose(found, [off_inner, off_outer, 0.0], rtol=0, atol=30.0 * EPS)


# --- the whole system -----------------------------------------------------------------------------------------------

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


VARIANTS = {
    "all": Variant(),
    "plain": Variant(walk=False, prior=False),
    "no fixture states": Variant(fixture_states=False, walk=False),
    "no heading": Variant(heading=False),
    "no latitude": Variant(latitude=False, walk=False),
    "free": Variant(free=True),
    "drift": Variant(walk=False, instability=True),
}


def errors_of(size):
    if size == "large":
        return large_errors(np.random.default_rng(8))[0]
    scale = {"zero": 0.0, "tiny": 1e-6}[size]
    return SensorErrors(scale * np.random.default_rng(9).standard_normal(N_PARAMETERS))


@pytest.fixture(scope="module")
def motions():
    """A table run on a poor fixture, the body well away from the table, and turns by hand; no |·| stands at zero."""
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
    return {True: free, False: table}


@dataclass(frozen=True)
class Case:
    joint: JointModel
    state: object
    system: object
    prior: Prior | None
    errors: SensorErrors


def make(motions, variant, size, noise=NOISE, off=True):
    """Problem and a point well away from its solution in all but the sensor errors, played back and linearised."""
    motion = motions[variant.free]
    errors = errors_of(size)
    site = SITE if variant.latitude else replace(SITE, latitude_rad=None)
    fixture = None if variant.free else Fixture(HEADING if variant.heading else None, 5e-3, 5e-3)
    recording = replace(sims.read_out(motion.stated_as(site=site), errors), noise=noise, fixture=fixture)
    if variant.free:
        recording = recording.with_sequences(tuple(SequenceLabel(a, b) for a, b in motion.windows))
    # Of one bias per sequence, of one with the drift that is stated, and of one alone.
    mode = "per-sequence" if variant.walk else "auto" if variant.instability else "pooled"
    options = Options(gyro_bias=mode, fixture_states=variant.fixture_states, start=errors)
    joint = open_joint_model(recording, options)
    rng = np.random.default_rng(11)
    state = replace(joint.start, U=motion.U)
    state = joint.initial_attitudes(state, joint.compensate(state))
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
        )
    prior = None
    if variant.prior:
        root = np.diag(rng.uniform(0.5, 2.0, N_PARAMETERS)) @ (np.eye(N_PARAMETERS) + 0.1)
        prior = Prior(SensorErrors(errors.vector + 0.01), root @ root.T)
    system = linearise(joint, state, joint.compensate(state), np.ones(N_PARAMETERS, dtype=bool), prior)
    return Case(joint, state, system, prior, errors)


def unwhitened(system):
    """Residuals and Jacobians of every kind of rows in their own units."""
    return {
        rows.kind: (
            np.linalg.solve(system.whitening[rows.kind], system.b[rows.index][..., None])[..., 0],
            np.linalg.solve(system.whitening[rows.kind], system.A[rows.index]),
        )
        for rows in system.rows
    }


STEPS = {"base": 1e-4, "mounting": 1e-4, "gravity": 1e-3, "earth_rate": 1e-6, "attitude": 1e-4, "bias": 1e-7}
ERROR_STEPS = np.full(N_ERRORS, 1e-5)
ERROR_STEPS[GROUP_SLICES["accel_bias"]] = 1e-4


def step_of(name, i):
    return float(ERROR_STEPS[i]) if name == "errors" else STEPS[name]


def allowed(case, kind, name, shape):
    """How far the derivative of rows of a kind by columns of a name may lie from the differences.

    Of every central difference: step² of the third derivative (over 6, left as margin), and rounding of the residual
    over the step. Besides:

    * Ĉ of a sample is the mean of its ends, (ω dt)²/12 off its integral;
    * a bias of one sequence's own is taken off the compensated rate by the mean slope of both signs, a common one by
      the slope of the sign that rules: an asymmetry apart;
    * the compensated bias deviation moves with the matrices, a product of two errors;
    * the Earth's own left Jacobian stands to first order.
    """
    gyro, accel = gyro_triad(case.errors), accel_triad(case.errors)
    D = np.linalg.norm(gyro.inverses, 2, axis=(1, 2)).max()
    D_accel = np.linalg.norm(accel.inverses, 2, axis=(1, 2)).max()
    two_sided = np.linalg.norm(gyro.inverses - np.linalg.inv(gyro.matrix), 2, axis=(1, 2)).max()
    deviation = np.linalg.norm(case.state.bias_deviation, axis=1).max()
    ω = 1e-4
    seconds = case.system.compensated.duration_s.max()
    angle = RATE * seconds
    h = np.array([step_of(name, i) for i in range(shape[-1])])
    # Left when the residual turns with a vector of the size given, by the angle h.
    turning = {"force": G, "rate": ω, "turn": 2.0, "start": 4.0, "base": 1.0, "mounting": 1.0}.get(kind, 0.0)
    rounding = {"force": G * D_accel, "rate": 1e-2 * D, "turn": 10.0}.get(kind, 10.0) * 10.0 * EPS / h
    own = two_sided * (name == "bias" and case.joint.bias_walks)
    size = D * (seconds if name == "bias" else angle)
    of_errors = {
        "force": 3.0 * G * D_accel**4 * h**2,
        "rate": 3.0 * ω * D**4 * h**2 + D**2 * deviation + own,
        "turn": size * ((RATE / HZ) ** 2 / 12.0 + (h * size) ** 2) + (D**2 * deviation + own) * seconds,
    }
    of_earth = {"turn": seconds * ((ω * seconds) ** 2 + (h * seconds) ** 2)}
    left = {"errors": of_errors, "bias": of_errors, "earth_rate": of_earth}.get(name, {}).get(kind, 0.0)
    if name in {"attitude", "base", "mounting"}:
        left = turning * h**2
    return left + rounding


CASES = [
    pytest.param(v, s, id=f"{v}-{s}", marks=[pytest.mark.slow] * (s == "tiny" and v not in {"all", "free"}))
    for v in VARIANTS
    for s in ("zero", "tiny", "large")
]


@pytest.mark.parametrize(("variant", "size"), CASES)
def test_system_against_played_back_differences(motions, variant, size):
    """Every column but the edges', whose unknowns are in no residual."""
    case = make(motions, VARIANTS[variant], size)
    joint, system = case.joint, case.system
    found = unwhitened(system)

    def residuals(delta):
        state = apply_correction(case.state, system, delta)
        return unwhitened(linearise(joint, state, joint.compensate(state), system.free, case.prior))

    seen = set()
    for name in ("errors", "bias", "base", "mounting", "gravity", "earth_rate", "attitude"):
        columns = system.of(name)
        expected = {kind: np.empty((*r.shape, len(columns))) for kind, (r, _) in found.items()}
        for i, column in enumerate(columns.tolist()):
            delta = np.zeros(len(system.active))
            delta[column] = step = step_of(name, i)
            plus, minus = residuals(delta), residuals(-delta)
            for kind, out in expected.items():
                out[..., i] = (plus[kind][0] - minus[kind][0]) / (2.0 * step)
        for kind, (_, J) in found.items():
            block, tolerance = J[..., columns], allowed(case, kind, name, (len(columns),))
            worst = np.unravel_index(np.argmax(np.abs(block - expected[kind]) - tolerance), block.shape)
            assert np.all(np.abs(block - expected[kind]) <= tolerance), (kind, name, worst, block[worst])
            if block.any():
                seen.add((kind, name))
                # So that nothing of the size of a coefficient could hide.
                assert np.abs(block).max() > 10.0 * np.max(tolerance), (kind, name)
    assert {("force", "attitude"), ("rate", "attitude"), ("turn", "attitude"), ("turn", "errors")} <= seen
    if VARIANTS[variant].fixture_states and not VARIANTS[variant].free:
        assert {("start", n) for n in ("attitude", "base", "mounting")} <= seen
        assert {("force", "gravity"), ("base", "base"), ("mounting", "mounting"), ("gravity", "gravity")} <= seen
    if VARIANTS[variant].prior:
        assert {("prior", "errors"), ("prior", "bias")} <= seen
    if VARIANTS[variant].walk:
        assert ("walk", "bias") in seen
    if not (VARIANTS[variant].heading and VARIANTS[variant].latitude):
        assert {(k, "earth_rate") for k in ("rate", "turn", "earth_rate:0")} <= seen


@pytest.mark.parametrize(("variant", "size"), [("all", "zero"), ("all", "large"), ("free", "large")])
def test_edge_columns_against_errors_in_the_samples(motions, variant, size):
    """A reading of the angle at a window's edge that is off: the sample before has it more, the one after has it less.

    Away from the data it was taken from, the problem's residual is minus what its unknown takes off.
    """
    case = make(motions, VARIANTS[variant], size)
    joint, system = case.joint, case.system
    data = joint.data
    edges = edge_numbers(joint, system.compensated)
    assert edges.max() + 1 == 2 * data.K
    found = unwhitened(system)
    dt, e = 1.0 / HZ, 1e-8
    gyro = gyro_triad(case.errors)
    D = np.linalg.norm(gyro.inverses, 2, axis=(1, 2)).max()
    two_sided = np.linalg.norm(gyro.inverses - np.linalg.inv(gyro.matrix), 2, axis=(1, 2)).max()
    # The angle of the first sample of a turn: the error comes before, within and after it.
    within = 10.0 * dt**2 * D

    def residuals(sample, axis, size):
        rates = data.recording.gyro.copy()
        rates[sample - 1, axis] += size / dt
        rates[sample, axis] -= size / dt
        other = open_joint_model(replace(data.recording, gyro=rates), joint.options)
        return unwhitened(linearise(other, case.state, other.compensate(case.state), system.free, case.prior))

    sigma = data.noise.gyro_edge
    for w, side in np.argwhere(edges >= 0).tolist():
        sample = int(data.windows.samples[w, side])
        columns = system.of("edge")[3 * edges[w, side] :][:3]
        for axis, column in enumerate(columns.tolist()):
            plus, minus = residuals(sample, axis, e), residuals(sample, axis, -e)
            for kind in ("force", "rate", "turn"):
                J = found[kind][1][..., column] / sigma[axis]
                expected = -(plus[kind][0] - minus[kind][0]) / (2.0 * e)
                scale = 1.0 / data.windows.duration_s.min() if kind == "rate" else 1.1
                rounding = 1e-14 * (0.1 if kind == "rate" else G) / e
                tolerance = scale * (D * within + two_sided) + rounding
                assert np.abs(J - expected).max() <= tolerance, (kind, w, side, axis)
                assert kind == "force" or np.abs(J).max() > 20.0 * tolerance


@pytest.mark.parametrize(("variant", "size"), [("drift", "zero"), ("drift", "large")])
def test_drift_columns_against_drift_in_the_samples(motions, variant, size, monkeypatch):
    """Steps of the bias from window to part of a turn to window, of every draw, in the samples: the same covariance.

    With three parts of each turn, which is as good a test as twelve and faster. Away from the data it was taken from,
    the problem's residual is minus what its unknown takes off.
    """
    monkeypatch.setattr(analytic_platform, "_PARTS", (2, 3))
    case = make(motions, VARIANTS[variant], size)
    joint, system = case.joint, case.system
    data, draws = joint.data, joint.data.drift
    windows = data.windows.samples
    ends = analytic_platform.equal_parts(data.rotation, draws.parts.shape[1])
    spans = [*windows.tolist(), *np.stack([ends[:, :-1], ends[:, 1:]], axis=2).reshape(-1, 2).tolist()]
    values = np.concatenate([draws.windows, draws.parts.reshape(-1, draws.parts.shape[2])])
    found, kinds = unwhitened(system), ("force", "rate", "turn")
    columns = np.concatenate([found[kind][1][..., system.of("instability")] for kind in kinds])
    columns = columns.reshape(-1, columns.shape[2])

    def residuals(instability, sensor, axis):
        table = getattr(data.recording, sensor).copy()
        for (a, b), value in zip(spans, instability.tolist(), strict=True):
            table[a:b, axis] += value
        other = open_joint_model(replace(data.recording, **{sensor: table}), joint.options)
        rows = unwhitened(linearise(other, case.state, other.compensate(case.state), system.free, case.prior))
        return np.concatenate([rows[kind][0] for kind in kinds]).ravel()

    effects = []
    for sensor, step in (("gyro", 1e-8), ("accel", 1e-6)):
        floor = {"gyro": data.noise.gyro_flicker, "accel": data.noise.accel_flicker}[sensor]
        for axis in range(3):
            for draw in np.eye(values.shape[1]):
                instability = step * values @ draw
                change = residuals(instability, sensor, axis) - residuals(-instability, sensor, axis)
                effects.append(change * floor[axis] / (2.0 * step))
    effects = np.array(effects).T
    expected, own = effects @ effects.T, columns @ columns.T
    unit = np.sqrt(np.diag(expected))
    assert np.all(unit > 0.0)
    # Ĉ of a sample is the mean of its ends, 1e-5 off; where the sign of a channel changes within a turn, an asymmetry
    # takes the drift by another slope there than the mean of both.
    gyro = gyro_triad(case.errors)
    two_sided = np.linalg.norm(gyro.inverses - np.linalg.inv(gyro.matrix), 2, axis=(1, 2)).max()
    tolerance = 1e-4 + 2.0 * two_sided
    assert np.all(np.abs(own - expected) <= tolerance * np.outer(unit, unit))


# --- factors and rows -----------------------------------------------------------------------------------------------


def columns_of(case, built, key):
    """Columns of the system for a variable, and the matrix from their corrections to the variable's."""
    system, letter, number = case.system, chr(gtsam.symbolChr(key)), gtsam.symbolIndex(key)

    def part(name, size=3):
        return system.of(name).reshape(-1, size)[number]

    if letter == "x":
        return system.of("errors")[built.errors], np.eye(len(built.errors))
    if letter == "b":
        return part("bias")[built.axes], np.eye(len(built.axes))
    if letter == "d":
        return system.of("instability"), np.eye(system.compensated.instability.size)
    if letter == "a":
        return part("attitude"), case.state.attitude[number].T
    name = {"f": "base", "u": "mounting", "g": "gravity", "e": "earth_rate", "q": "edge"}[letter]
    columns = part(name, 1 if letter == "g" else 3)
    return columns, np.eye(len(columns))


def normal(A, b):
    return A.T @ A, A.T @ b, b @ b


def factor_system(case, built, i):
    """Jacobian over the system's columns and residual of a factor, whitened."""
    factor = built.graph.at(i).linearize(built.values)
    J, right = factor.jacobian()
    A, at = np.zeros((len(J), len(case.system.active))), 0
    for key in list(factor.keys()):
        columns, to_variable = columns_of(case, built, key)
        A[:, columns] = J[:, at : at + len(columns)] @ to_variable
        at += len(columns)
    return A, -right


def measured_rows(built, rows, kind, number):
    """Rows of a measurement."""
    if kind == "window":
        return np.concatenate([rows["force"].index[number], rows["rate"].index[number]])
    if kind == "start":
        starts = [n for k, n, _ in built.measured if k == "start"]
        return rows["start"].index[starts.index(number)]
    return rows[kind].index[number]


def drift_rows(case, rows):
    """Rows of the draws of the drift in the order of their columns."""
    is_gyro = case.system.compensated.instability.is_gyro
    out = np.empty((len(is_gyro), 3), dtype=np.intp)
    for kind, members in (("gyro_instability", is_gyro), ("accel_instability", ~is_gyro)):
        if members.any():
            out[members] = rows[kind].index
    return out.ravel()


def rows_of_factor(case, built, i):
    """Rows of the system that a factor stands for; None for a heading that is given, which has no rows."""
    rows = {r.kind: r for r in case.system.rows}
    if i < len(built.measured):
        return measured_rows(built, rows, *built.measured[i][:2])
    keys = built.graph.at(i).keys()
    letters, number = "".join(chr(gtsam.symbolChr(k)) for k in keys), gtsam.symbolIndex(keys[0])
    if letters == "d":
        return drift_rows(case, rows)
    if letters == "bb":
        order = case.joint.order.tolist()
        return rows["walk"].index[order.index(number)]
    if letters == "a":
        return None
    kind = {"f": "base", "u": "mounting", "g": "gravity", "e": f"earth_rate:{number}", "q": "edge"}.get(letters)
    return rows["prior"].index[0] if kind is None else rows[kind].index[number if kind == "edge" else 0]


def build(case):
    return FactorGraph(case.joint, case.state, case.system.compensated, case.system.free, prior=case.prior)


@pytest.mark.parametrize(("variant", "size"), CASES)
def test_factors_are_the_rows_of_the_system(motions, variant, size):
    """JᵀJ, Jᵀr and rᵀr of every factor, at a point where no residual vanishes; together they are the whole system."""
    case = make(motions, VARIANTS[variant], size)
    built, system = build(case), case.system
    left = np.ones(len(system.b), dtype=bool)
    for i in range(built.graph.size()):
        A, b = factor_system(case, built, i)
        at = rows_of_factor(case, built, i)
        if at is None:
            # A heading: along the vertical alone, of a column that the system does not estimate.
            (column,) = np.flatnonzero(np.abs(A[0]) > 1e-12 * np.abs(A).max())
            assert not system.active[column]
            continue
        left[at] = False
        here = system.active & (A.any(axis=0) | system.A[at].any(axis=0))
        found, expected = normal(A[:, here], b), normal(system.A[at][:, here], system.b[at])
        size_b = math.sqrt(expected[2])
        d = np.sqrt(np.diag(expected[0]))
        where = (variant, i, built.measured[i] if i < len(built.measured) else built.graph.at(i).keys())
        assert np.all(np.abs(found[0] - expected[0]) <= 1e-12 * np.outer(d, d)), where
        assert np.all(np.abs(found[1] - expected[1]) <= 1e-12 * d * max(size_b, 1.0)), where
        assert abs(found[2] - expected[2]) <= 1e-12 * max(expected[2], 1.0), where
    # Rows without a factor: those that no estimated column is in.
    assert not system.A[left][:, system.active].any()


# Of navigation grade; and a prior near enough that 3 or 4 sequences leave no direction open.
GRADE = ImuNoise(5.8e-7, 5e-5, 2.4e-6, 1e-5, 5e-9, 1e-5)


def known(motions, variant):
    case = make(motions, VARIANTS[variant], "tiny", GRADE, off=False)
    prior = Prior.from_sigma(np.full(N_PARAMETERS, 1e-5))
    system = linearise(case.joint, case.state, case.system.compensated, case.system.free, prior)
    return replace(case, prior=prior, system=system)


def parameters(case, built, solution):
    """Covariance of the reported parameters from that of the graph's variables."""
    E = case.system.parameter_map()
    spread = np.concatenate([E[:, columns_of(case, built, key)[0]] for key in solution.keys], axis=1)
    return spread @ solution.covariance @ spread.T


@pytest.mark.parametrize("variant", VARIANTS)
def test_elimination_is_the_dense_solution(motions, variant):
    """Corrections and covariance of the parameters, by gtsam's elimination and by one QR of all rows.

    Both are backward stable: what they may differ by is rounding times the condition of the scaled system. The graph
    holds what is known of the Earth's rate by a sigma of 1e-6 of the unknown part, which adds to a bias's variance.
    """
    case = known(motions, variant)
    built, E = build(case), case.system.parameter_map()
    solution, dense = solve_linear(built.graph, built.values, built.reported_keys()), solve(case.system)
    A = case.system.A[:, case.system.active]
    rounding = 100.0 * EPS * np.linalg.cond(A / np.linalg.norm(A, axis=0))
    P = (E @ dense.root) @ (E @ dense.root).T
    sigma = np.sqrt(np.diag(P))
    known_rate = 1e-6 * max(float(c.unknown_sigma.max()) for c in case.joint.level_frames)
    held = (known_rate / sigma[GROUP_SLICES["gyro_bias"]].min()) ** 2
    assert np.abs((parameters(case, built, solution) - P) / np.outer(sigma, sigma)).max() <= rounding + held
    found = np.zeros(len(case.system.active))
    for key in solution.keys:
        found[columns_of(case, built, key)[0]] = solution.delta.at(key)
    assert np.abs(E @ (found - dense.delta) / sigma).max() <= rounding * np.linalg.norm(case.system.b)
    assert rounding + held < 1e-7


@pytest.mark.parametrize("variant", ["no fixture states", "free"])
def test_marginals_of_gtsam(motions, variant):
    """gtsam's own marginals, by Cholesky: rounding times the square of the condition.

    It gives up where pivots span more than twelve bits. So it gets the whole linear graph as one variable in units of
    its columns' norms, and without the fixture, whose axes are square to a ten-thousandth of what its angles are known
    to.
    """
    case = known(motions, variant)
    built = build(case)
    solution = solve_linear(built.graph, built.values, built.reported_keys())
    keys = sorted(built.values.keys())
    order = gtsam.Ordering()
    for key in keys:
        order.push_back(key)
    A, b = built.graph.linearize(built.values).jacobian(order)
    norm = np.linalg.norm(A, axis=0)
    whole, at = gtsam.GaussianFactorGraph(), gtsam.VectorValues()
    whole.add(gtsam.JacobianFactor(0, A / norm, b, gtsam.noiseModel.Unit.Create(len(b))))
    at.insert(0, np.zeros(len(norm)))
    P = gtsam.Marginals(whole, at).marginalCovariance(0) / np.outer(norm, norm)
    widths = [solution.delta.at(key).size for key in keys]
    first = dict(zip(keys, np.cumsum([0, *widths]).tolist(), strict=False))
    kept = np.concatenate([first[key] + np.arange(solution.delta.at(key).size) for key in solution.keys])
    sigma = np.sqrt(np.diag(solution.covariance))
    off = np.abs((P[np.ix_(kept, kept)] - solution.covariance) / np.outer(sigma, sigma)).max()
    rounding = EPS * np.linalg.cond(A / norm) ** 2
    assert off <= 10.0 * rounding < 1e-5
