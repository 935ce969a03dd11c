"""The model's equations against references that share no line with them.

Integrals by brute force, numerical derivatives of the exact compensation, and what the simulator's fixture has an IMU
sense while it turns with the Earth.
"""

import numpy as np
import pytest
from ideal_table_1 import G
from scipy.spatial.transform import Rotation

from sims.physics.fixture import FixtureDraw, FixtureGeometry, rotation
from srt.model import measurement_model as model
from srt.model import rotation_integrals
from srt.model.sensor_model import gyro_triad
from srt.model.table1 import AXES, SEQUENCES, RotationSequence
from srt.sensor_errors import N_PARAMETERS, SensorErrors

# --- references -----------------------------------------------------------------------------------------------------

ODD = RotationSequence("odd", "z", "y", 0.0, 0.0, (("x", 0.7), ("y", -1.9), ("z", 2.3), ("x", -0.4)))
"""No half turns here, so that no sine or cosine is 0 or ±1."""


def brute_force_integrals(sequence, rate):
    """The integrals of a rotation by Gauss-Legendre quadrature of scipy's rotations, 40 nodes in each."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    C = np.eye(3)
    out = {
        "rate": np.zeros((3, 3, 3)),
        "abs_rate": np.zeros((3, 3)),
        "time": np.zeros((3, 3)),
        "noise": np.zeros((3, 3, 3)),
        "angle": np.zeros(3),
        "weight_s": 0.0,
    }
    for axis, angle in sequence.rotations:
        u = np.eye(3)[AXES.index(axis)]
        duration = abs(angle) / rate
        for x, w in zip(nodes, weights, strict=True):
            A = C @ Rotation.from_rotvec(0.5 * (x + 1.0) * angle * u).as_matrix()
            dt = 0.5 * w * duration
            ω = u * angle / duration
            out["rate"] += dt * A[:, :, None] * ω
            out["abs_rate"] += dt * A * np.abs(ω)
            out["time"] += dt * A
            out["noise"] += dt * np.einsum("ab,cb->acb", A, A)
            out["angle"] += dt * ω
            out["weight_s"] += dt
        C = C @ Rotation.from_rotvec(angle * u).as_matrix()
    return out | {"C_end": C}


REFERENCE = {name: brute_force_integrals(s, 0.8) for name, s in {"odd": ODD, "6": SEQUENCES["6"]}.items()}


def ramped_integrals(sequence, rate, acceleration):
    """Integrals over time with a trapezoidal rate: Gaussian quadrature of the angle at each time."""
    x, w = np.polynomial.legendre.leggauss(60)
    C, time, noise, weight_s = np.eye(3), np.zeros((3, 3)), np.zeros((3, 3, 3)), 0.0
    most = rate
    for u, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        rate = min(most, np.sqrt(abs(angle) * acceleration))  # a triangle where the angle is small
        ramp_s = rate / acceleration
        total = abs(angle) / rate + ramp_s
        for a, b in ((0.0, ramp_s), (ramp_s, total - ramp_s), (total - ramp_s, total)):
            for t, dt in zip(0.5 * (a + b + (b - a) * x), 0.5 * (b - a) * w, strict=True):
                beta = 0.5 * acceleration * min(t, ramp_s) ** 2 + rate * max(0.0, min(t, total - ramp_s) - ramp_s)
                late = max(0.0, t - total + ramp_s)
                beta += rate * late - 0.5 * acceleration * late**2
                A = C @ Rotation.from_rotvec(np.sign(angle) * beta * u).as_matrix()
                time += dt * A
                noise += dt * np.einsum("ab,cb->acb", A, A)
        weight_s += total
        C = C @ Rotation.from_rotvec(angle * u).as_matrix()
    return {"time": time, "noise": noise, "weight_s": weight_s}


RAMPED = ramped_integrals(ODD, 0.8, 1.3)
WINDOW_NOISE = 5.0 / 3.0  # of one window of 5 s: ∫ F² dt of a ramp from 0 to 1

ERRORS = SensorErrors(np.random.default_rng(5).uniform(-0.1, 0.1, N_PARAMETERS))
OMEGA = np.array([[0.3, -0.8, 0.5], [-0.4, 0.9, -0.2]])


def minus_derivative(errors, reading, rectified):
    """Minus d(compensated)/d(estimate): change of the compensated rate per error of the estimate.

    By vibration, the mean reading has asymmetry times a rectified rate besides, which the estimate takes off.
    """
    step = 1e-5

    def compensated(estimate):
        triad = gyro_triad(estimate)
        return triad.compensate(reading - triad.asymmetry * rectified)

    columns = [
        (compensated(errors.plus(-d)) - compensated(errors.plus(d))) / (2 * step) for d in step * np.eye(N_PARAMETERS)
    ]
    return np.stack(columns, axis=-1)


# Truncation of the central difference: step² times the third derivative, some 10 · 6 · |f| here; rounding 1e-16 / step.
NUMERICAL = 1e-10 * 60 * 10 + 1e-10
RECTIFIED = np.array([[0.05, 0.2, 0.1], [0.3, 0.02, 0.15]])
READING = gyro_triad(ERRORS).read(OMEGA) + gyro_triad(ERRORS).asymmetry * RECTIFIED
VIBRATING_JACOBIAN = minus_derivative(ERRORS, READING, RECTIFIED)

# An Earth that turns by 0.08 rad while the fixture does: in the real one's 1e-3 a wrong sign would hide.
EARTH_NED = np.array([0.02, -0.005, -0.015])
TURN_S = 3.0
HEADING = 0.7
DRAW = FixtureDraw(base=np.array([0.05, -0.08, 0.1]), mounting=np.array([-0.06, 0.09, 0.04]))
MARS = rotation([0.2, -0.1, 0.3])
FIXTURE = FixtureGeometry.build(HEADING, DRAW, MARS)
BASE, MOUNTED = rotation(DRAW.base), MARS @ rotation(DRAW.mounting).T
START, END = (0.4, -0.7), (1.9, 1.1)
"""Inner and outer angle."""


def sensed_turn():
    """B_End to B_Strt against inertial space, from the rates that a gyro on the fixture senses between two poses.

    Both axes turn at a constant rate; 400 steps of fourth order leave 1e-12 rad.
    """
    speed = (np.array(END) - START) / TURN_S
    dt = TURN_S / 400
    C = Rotation.identity()

    def rate(t):
        inner, outer = START + speed * t
        earth = FIXTURE.attitude(inner, outer).T @ EARTH_NED
        at = FIXTURE.turned(np.array(inner), np.array(outer))
        return FIXTURE.turning_rate(at, np.array(speed[0]), np.array(speed[1])) + earth

    for i in range(400):
        one, two = (rate(dt * (i + 0.5 + side * np.sqrt(3) / 6)) for side in (-1.0, 1.0))
        C = C * Rotation.from_rotvec(0.5 * dt * (one + two) + np.sqrt(3) / 12 * dt**2 * np.cross(one, two))
    return C.as_matrix()


TURNED = sensed_turn()
WINDOWS = np.stack([FIXTURE.attitude(*START), FIXTURE.attitude(*END)])
# Not on the fixture, nor near what was measured: no residual, sine or cosine is 0 or 1 here.
ELSEWHERE = WINDOWS @ Rotation.from_rotvec([[0.3, -0.2, 0.25], [-0.15, 0.35, 0.2]]).as_matrix()


def on_fixture(inner, outer):
    """R_y(outer) R_z(inner)."""
    return Rotation.from_euler("YZ", [outer, inner]).as_matrix()


# --- the checks -----------------------------------------------------------------------------------------------------


def assert_close(a, b, tolerance):
    assert np.all(np.abs(np.asarray(a) - np.asarray(b)) <= tolerance)


@pytest.mark.parametrize(("name", "sequence"), [("odd", ODD), ("6", SEQUENCES["6"])])
def test_integrals_of_ideal_rotations(name, sequence):
    expected = REFERENCE[name]
    found = rotation_integrals.ideal_rotations([sequence], 0.8)
    for key, value in expected.items():
        assert_close(getattr(found, key)[0], value, 1e-12)
    if name == "odd":
        ramped = rotation_integrals.ideal_rotations([sequence], 0.8, acceleration_rad_s2=1.3)
        for key, value in RAMPED.items():
            assert_close(getattr(ramped, key)[0], value, 1e-12)
    # Windows by eq. 21 and by the noise of a ramp.
    found = rotation_integrals.ideal_rotations([sequence], 0.8, 5.0, 0.3)
    C = expected["C_end"]
    noise = WINDOW_NOISE * (np.einsum("ab,cb->acb", np.eye(3), np.eye(3)) + np.einsum("ab,cb->acb", C, C))
    assert_close(found.time[0], expected["time"] + 5.0 * (0.7 * np.eye(3) + 0.3 * C), 1e-12)
    assert_close(found.noise[0], expected["noise"] + noise, 1e-12)
    assert_close(found.weight_s[0], expected["weight_s"] + 5.0, 1e-12)


def test_jacobian_of_vibrating_gyros_and_directions_off_the_axes():
    """Table 1 shows neither; test_jacobians has the Jacobians of readings without vibration."""
    down = np.array([[0.6, -0.48, 0.64]])
    assert_close(model.rate_error_jacobian(OMEGA, gyro_triad(ERRORS), RECTIFIED), VIBRATING_JACOBIAN, NUMERICAL)
    assert_close(model.horizontal_projector(down)[0] @ down[0], 0.0, 1e-15)
    assert_close(model.horizontal_projector(down)[0] @ np.array([0.8, 0.36, -0.48]), [0.8, 0.36, -0.48], 1e-15)


def derivative(function, step=1e-5):
    """Central differences of a function of three small numbers, the derivative's index last."""
    return np.stack([(function(d) - function(-d)) / (2 * step) for d in step * np.eye(3)], axis=-1)


def turned_by(v):
    return Rotation.from_rotvec(v).as_matrix()


def test_force_and_rate_of_windows():
    """Nothing left at the truth, and derivatives away from it."""
    earth = np.broadcast_to(EARTH_NED, (2, 3))
    force, rate = -G * WINDOWS[:, 2], WINDOWS.transpose(0, 2, 1) @ EARTH_NED
    residual, by_attitude, by_gravity = model.specific_force_residual(force, ELSEWHERE, G)
    at_rest, rate_by_attitude, by_earth = model.angular_rate_residual(rate, ELSEWHERE, earth)

    def force_at(v):
        return model.specific_force_residual(force, ELSEWHERE @ turned_by(v), G)[0]

    def rate_at(v):
        return model.angular_rate_residual(rate, ELSEWHERE @ turned_by(v), earth)[0]

    assert_close(model.specific_force_residual(force, WINDOWS, G)[0], 0.0, 1e-14)
    assert_close(model.angular_rate_residual(rate, WINDOWS, earth)[0], 0.0, 1e-16)
    assert_close(by_attitude, derivative(force_at), NUMERICAL)
    assert_close(by_gravity, model.specific_force_residual(force, ELSEWHERE, G + 1.0)[0] - residual, 1e-14)
    assert_close(rate_by_attitude, derivative(rate_at), NUMERICAL)
    by_rate = derivative(lambda v: model.angular_rate_residual(rate, ELSEWHERE, earth + v)[0])
    assert_close(by_earth, by_rate, NUMERICAL)
    assert_close(at_rest, rate - ELSEWHERE.transpose(0, 2, 1) @ EARTH_NED, 1e-16)


def test_the_turn_between_two_poses_as_gyros_sense_it():
    """The whole turn, and its part about the vertical; derivatives elsewhere."""
    T, earth = np.array([TURN_S]), EARTH_NED[None]
    off_start, off_end = ELSEWHERE[:1], ELSEWHERE[1:]

    def found(s=0.0, e=0.0, c=0.0, ω=0.0):
        C = turned_by(np.zeros(3) - c) @ TURNED[None]
        s, e = (turned_by(np.zeros(3) + v) for v in (s, e))
        return model.rotation_residual(C, off_start @ s, off_end @ e, earth + ω, T), off_start @ s

    # The left Jacobian of the Earth's turn is taken to first order: (ω_e T)² / 6 of the derivative is left out. What
    # multiplies it, the inverse Jacobian of a residual below 1 rad, and the next order are below 1.5 together.
    neglected = 1.5 * TURN_S * (np.linalg.norm(EARTH_NED) * TURN_S) ** 2 / 6.0
    assert_close(model.rotation_residual(TURNED[None], WINDOWS[:1], WINDOWS[1:], earth, T)[0], 0.0, 1e-11)
    for part in (lambda whole, _: whole, model.heading_residual):
        _, *by = part(*found())
        for name, J in zip("secω", by, strict=True):
            expected = derivative(lambda v, name=name, part=part: part(*found(**{name: v}))[0])
            assert_close(J, expected, NUMERICAL + neglected * (name == "ω"))
    assert_close(part(*found())[0], off_start[0, 2] @ found()[0][0][0], 1e-15)


def test_a_unit_that_turns_at_the_stated_rate():
    """About the same axis with the Earth; derivatives away from it."""
    axis, stated = np.array([0.6, -0.48, 0.64]), 0.5
    executed = (stated + EARTH_NED @ axis) * axis
    _, by_rate, by_earth = model.stated_rate_residual(OMEGA[0], EARTH_NED, stated)
    assert_close(model.stated_rate_residual(executed, EARTH_NED, stated)[0], 0.0, 1e-15)
    expected = derivative(lambda v: model.stated_rate_residual(OMEGA[0] + v, EARTH_NED, stated)[0])
    assert_close(by_rate, expected, NUMERICAL)
    expected = derivative(lambda v: model.stated_rate_residual(OMEGA[0], EARTH_NED + v, stated)[0])
    assert_close(by_earth, expected, NUMERICAL)


def test_start_attitudes_and_the_axes_non_orthogonality():
    """Angles of the fixture, over the border of a half turn too."""
    off = np.array([0.03, -0.02])
    angles = np.array([START, END, (np.pi - 0.01, 0.2), (0.3, 0.02 - np.pi)])
    attitude = np.stack([FIXTURE.attitude(*(a + off)) for a in angles])
    nominal = np.stack([on_fixture(*a) for a in angles])
    lean = 0.05
    leaning = FixtureGeometry(FIXTURE.base_from_ned, lean, FIXTURE.body_from_inner).attitude(*START)[None]

    def residual(a=0.0, b=0.0, u=0.0, n=0.0):
        a, b, u = (turned_by(np.zeros(3) + v) for v in (a, b, u))
        return model.start_attitude_residual(ELSEWHERE @ a, nominal[:2], BASE @ b, MOUNTED @ u, HEADING, lean + n)[0]

    def third(*non_orthogonality):
        return model.start_attitude_residual(leaning, nominal[:1], BASE, MOUNTED, HEADING, *non_orthogonality)[0][0, 2]

    _, by_attitude, by_base, by_U, by_lean = model.start_attitude_residual(
        ELSEWHERE, nominal[:2], BASE, MOUNTED, HEADING, lean
    )
    assert_close(model.start_attitude_residual(attitude, nominal, BASE, MOUNTED, HEADING)[0], [*off, 0.0], 1e-14)
    assert_close(third(), -np.sin(lean), 1e-14)
    assert_close(third(lean), 0.0, 1e-14)
    assert_close(by_attitude, derivative(lambda v: residual(a=v)), NUMERICAL)
    assert_close(by_base, derivative(lambda v: residual(b=v)), NUMERICAL)
    assert_close(by_U, derivative(lambda v: residual(u=v)), NUMERICAL)
    assert_close(by_lean[..., 0], derivative(lambda v: residual(n=v[0]))[..., 0], NUMERICAL)
