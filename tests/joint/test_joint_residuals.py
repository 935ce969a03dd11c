"""Residuals and rotations of the joint model, and least squares."""

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from accuracy_trials import fixture_recording
from foreign_motion import GRADES, Turn, drawn_errors, hand_turns, recording, windows
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jacobian_cases import EPS, HEADING, MARS, G, away, derivative, exp, numerical
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import sims
import srt
from sims.physics.fixture import FixtureDraw, FixtureGeometry, earth_rate_ned
from srt.exceptions import InputError
from srt.model import measurement_model as model
from srt.model import rotations

EARTH_NED = earth_rate_ned(math.radians(50.0))
DRAW = FixtureDraw(base=np.array([0.02, -0.03, 0.05]), mounting=np.array([-0.04, 0.01, 0.03]))
FIXTURE = FixtureGeometry.build(HEADING, DRAW, MARS)
ANGLES = np.random.default_rng(3).uniform(-3.0, 3.0, (8, 2))
"""Inner and outer angles of eight poses; a turn leads from each to the next."""
POSES = np.stack([FIXTURE.attitude(*angles) for angles in ANGLES])
DURATION = np.linspace(2.0, 16.0, 7)

SIZES = (0.0, 1e-9, 1e-3, 0.3)


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
        at = FIXTURE.turned(*(start + np.multiply.outer(t, speed)).T)
        turning = FIXTURE.turning_rate(at, np.full(count, speed[0]), np.full(count, speed[1]))
        return (turning + FIXTURE.to_body((FIXTURE.base_from_ned @ EARTH_NED)[None], at)[:, 0]).T

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
    lean = 0.1
    residual, by_attitude, by_base, by_U, by_lean = model.start_attitude_residual(A, nominal, base, U, HEADING, lean)
    residual = residual - [0.0, 0.0, math.sin(lean)]
    # Where the inner axis leans, the inner angle turns faster than the attitude does, by the cosine of the lean.
    assert np.abs(residual - found).max() <= size / math.cos(size) + 20.0 * EPS
    turn = in_turn(8)

    def at(a=0.0, b=0.0, u=0.0, n=0.0):
        a, b, u = (turn(np.zeros(3) + v) for v in (a, b, u))
        return model.start_attitude_residual(A @ a, nominal, base @ b[0], U @ u[0], HEADING, lean + n)[0]

    # The angles are singular where the inner axis lies along the outer one, a right angle from square.
    atol = numerical(4.0, math.pi / 2.0 - 0.3)
    assert np.abs(by_attitude - derivative(lambda v: at(a=v))).max() <= atol
    assert np.abs(by_base - derivative(lambda v: at(b=v))).max() <= atol
    assert np.abs(by_U - derivative(lambda v: at(u=v))).max() <= atol
    assert np.abs(by_lean - derivative(lambda v: at(n=v[0]))[..., :1]).max() <= atol


@pytest.mark.parametrize("lean", [1e-9, 1e-3, 0.3])
def test_lean_of_the_axes(lean):
    """The third component is the sine of what the fixture's axes are from square, less what is known of it."""
    base, U = sims.rotation(DRAW.base), MARS @ sims.rotation(DRAW.mounting).T
    A = FixtureGeometry(FIXTURE.base_from_ned, lean, FIXTURE.body_from_inner).attitude(*ANGLES[0])
    nominal = Rotation.from_euler("YZ", ANGLES[0][::-1]).as_matrix()
    found = model.start_attitude_residual(A[None], nominal[None], base, U, HEADING)[0][0]
    assert abs(found[2] + math.sin(lean)) <= 10.0 * EPS
    assert abs(found[0]) <= lean**2 + 10.0 * EPS
    known = model.start_attitude_residual(A[None], nominal[None], base, U, HEADING, lean)[0][0]
    np.testing.assert_allclose(known, 0.0, rtol=0.0, atol=20.0 * EPS)


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


# --- rotations ------------------------------------------------------------------------------------------------------


def directions():
    return arrays(float, 3, elements=st.floats(-1.0, 1.0)).filter(lambda v: np.linalg.norm(v) > 0.1)


def log(C):
    return Rotation.from_matrix(C).as_rotvec()


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
    """The inverse right Jacobian inverts Σ (−φ×)ⁿ / (n + 1)! at any angle; 40 terms leave 1e-16 of it."""
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


HALF = ("1", "2", "3", "1a", "4", "5", "6", "7", "8", "9", "13")
SCENARIOS = {
    "half of Table 1": {
        "seed": 32, "fixture": {"from": "lab-1mrad"},
        "schedule": {"dwell_s": 4.0, "rate_rad_s": 2.0, "acceleration_rad_s2": 20.0, "sequences": HALF},
    },
    "rate table": {"seed": 37, "protocol": {"from": "rate-table"}},
    "six faces": {"seed": 38, "protocol": {"from": "six-face-tumble"}},
    "hand-turned protocol": {"seed": 39, "imu": {"from": "industrial-mems"}, "protocol": {"from": "hand-turned"}},
}  # fmt: skip


def simulated(name):
    if name == "moves":
        return fixture_recording(21, "tactical", moves="recorded", sample_rate_hz=50.0)[0]
    base = {"imu": {"from": "tactical-fog"}, "site": {"from": "latitude-45"}, "recording": {"sample_rate_hz": 50.0}}
    return sims.simulate(sims.scenario_from_dict(base | SCENARIOS[name])).recording


@pytest.mark.parametrize("name", ["half of Table 1", "moves", "hand-turned protocol", "rate table"])
def test_all_joint_solvers_agree(name):
    """The same optimum as the factor graph to 1e-6 sigma; status, observed parameters and verdict of all three."""
    pytest.importorskip("gtsam")
    pytest.importorskip("filterpy")
    recording = simulated(name)
    least, graph, ekf = (srt.calibrate(recording, e, checks=False) for e in ("least-squares", "graph", "ekf"))
    seen = graph.observed & (graph.sigma > 0.0)
    difference = (least.errors.vector - graph.errors.vector)[seen] / graph.sigma[seen]
    assert np.abs(difference).max() < 1e-6
    np.testing.assert_allclose(least.sigma[seen], graph.sigma[seen], rtol=1e-6)
    for other in (least, ekf):
        assert (other.status, other.judgement.word) == (graph.status, graph.judgement.word)
        # The figures of a reason follow from the values.
        reasons = (re.sub(r"[\d.]+(e[+-]?\d+)?", "#", found.judgement.reason) for found in (other, graph))
        assert len(set(reasons)) == 1
        np.testing.assert_array_equal(other.observed, graph.observed)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("step", "coefficients"), ("down", "paper"), ("measured_vertical", False), ("window_attitude", "integrated"),
        ("loss", "cauchy"), ("filter", "one-pass"), ("live", True), ("targets", {"gyro_scale": 1e-5}),
    ],
)  # fmt: skip
def test_options_of_other_estimators_are_refused(option, value):
    recording = simulated("six faces")
    with pytest.raises(InputError, match=f"has no option {option}"):
        srt.calibrate(recording, "least-squares", **{option: value}, checks=False)


def test_a_rest_in_which_the_unit_turns_slowly_accuses_no_turn():
    """Evenly, so that its halves agree: its rate contradicts the other rests, and the tilt is that of the rate."""
    rng = np.random.default_rng(20261125)
    errors = drawn_errors(GRADES["consumer"], rng)
    turns = hand_turns(rng, shortest_s=1.0, longest_s=4.0, count=20, rest_s=3.0)
    turns[6:7] = [replace(turns[6], rest_s=0.02), Turn((1.0, -0.5, 0.7), 0.002, 3.0, 0.02)]
    unit = recording(turns, 5.0, errors, GRADES["consumer"], rng, profile="constant-rate")
    rests = windows(turns, 5.0)
    rests[7:9] = [(rests[7][0], rests[8][1])]
    labels = tuple(srt.SequenceLabel(a, b) for a, b in pairwise((x + 0.05, y - 0.05) for x, y in rests))
    found = srt.calibrate(unit.with_sequences(labels), "least-squares", checks=False)
    assert found.status in ("converged", "partial"), found.message
    assert any(f"moved in the stationary windows from {int(rests[7][0])}." in warning for warning in found.warnings)
    truth, seen = np.array([errors.get(name, 0.0) for name in srt.NAMES]), found.observed
    z, sigma = ((found.errors.vector - truth) / found.sigma)[seen], found.sigma[seen]
    nees = z @ np.linalg.solve(found.covariance[np.ix_(seen, seen)] / np.outer(sigma, sigma), z)
    assert nees < chi2.isf(1e-3, seen.sum())
