"""The five worked examples of Savage 2017 (part 3) and its gyro-bias results, with the paper's matrices.

Every matrix and every vector below is the paper's, entered as numbers; the misalignments κ_ij = κ_ji = υ_ij / 2 are
put in as the paper does when it goes over to MARS axes (eq. 10).
"""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from conftest import G
from test_equations_signatures import ideal_jacobian

from srt.model.measurement_model import attitude_error_jacobian, force_error_jacobian
from srt.model.rotation_integrals import ideal_rotations
from srt.model.sensor_model import Triad
from srt.model.table1 import AXES, SEQUENCES
from srt.sensor_errors import INDEX, N_PARAMETERS, SYMBOLS

PLACE = {symbol: i for i, symbol in enumerate(SYMBOLS)}
PERFECT = Triad(np.eye(3), np.zeros(3), np.zeros(3))
EPS = np.finfo(float).eps

RATE = 0.5  # |β̇|, rad/s: not 1, so that its place in the formulas counts
T_MEAS = 10.0

# A component is a sum of at most eight rotations, each good to a few rounding errors of 2π; times g or T / |β̇|.
ATTITUDE_ROUNDING = 64 * EPS * 2 * pi


def vector(**terms):
    """Coefficients by the papers' symbols, for example ``vector(κzz=2 * pi)``."""
    out = np.zeros(N_PARAMETERS)
    for symbol, value in terms.items():
        out[PLACE[symbol]] = value
    return out


ZERO = vector()


def attitudes(sequence):
    """C_Bi of every rotation's start, and C_End, by the model."""
    s = SEQUENCES[sequence]
    partial = [replace(s, rotations=s.rotations[:i]) for i in range(len(s.rotations) + 1)]
    return ideal_rotations(partial).C_end


def attitude_error(sequence):
    """φ_End by the model, three rows of coefficients; without the gyro bias, of which eq. 3 knows nothing."""
    J = attitude_error_jacobian(ideal_rotations([SEQUENCES[sequence]]))[0]
    J[:, [INDEX[f"gyro_bias_{a}"] for a in AXES]] = 0.0
    return J


def bias_attitude_error(sequence):
    """(φ_End) of the gyro bias over the rotations, by the model."""
    J = attitude_error_jacobian(ideal_rotations([SEQUENCES[sequence]], RATE))[0]
    return J[:, [INDEX[f"gyro_bias_{a}"] for a in AXES]]


def bias_effect(sequence):
    """Rows of e(Δa) by component, for the gyro bias over rotations and windows, by the model."""
    return {k: v[-3:] for k, v in ideal_jacobian(sequence, window_s=T_MEAS, rate=RATE).items() if k in AXES}


def signature(sequence):
    rows = ideal_jacobian(sequence)
    return {k: np.append(v[:-3], [0.0, 0.0, 0.0]) for k, v in rows.items()}


def check(found, expected, scale=1.0):
    np.testing.assert_allclose(found, expected, rtol=0, atol=scale * ATTITUDE_ROUNDING)


def check_attitudes(sequence, *printed):
    check(attitudes(sequence), [np.eye(3), *printed])


# --- Sequence 3: scale factor of gyro z ---------------------------------------------------------------------------


def test_sequence_3_measurement_eq_18():
    check_attitudes("3", np.eye(3))  # eq. 15
    check(attitude_error("3"), [ZERO, ZERO, vector(κzz=2 * pi, κzzz=2 * pi)])
    found = signature("3")
    check(found["y"], vector(κzz=-2 * pi * G, κzzz=-2 * pi * G), G)
    check(found["z"], ZERO, G)


def test_sequence_3_gyro_bias_eq_20():
    check(bias_attitude_error("3"), [[0, 0, 0], [0, 0, 0], [0, 0, 2 * pi / RATE]], 1 / RATE)
    found = bias_effect("3")
    check(found["y"], [0, 0, -2 * pi * G * (1 / RATE + T_MEAS / (2 * pi))], G * T_MEAS)
    check(found["z"], [0, G * T_MEAS, 0], G * T_MEAS)


# --- Sequence 5: orthogonality of gyros z and x -------------------------------------------------------------------

HALF_X = np.diag([1.0, -1.0, -1.0])
HALF_Y = np.diag([-1.0, 1.0, -1.0])
HALF_Z = np.diag([-1.0, -1.0, 1.0])


def test_sequence_5_attitudes_eq_23():
    check_attitudes("5", HALF_X, HALF_Y, HALF_Z, np.eye(3))


def test_sequence_5_measurement_eqs_27_28():
    check(attitude_error("5"), [ZERO, vector(υzx=-4), ZERO])
    found = signature("5")
    check(found["x"], vector(υzx=4 * G), G)
    check(found["y"], ZERO, G)


def test_sequence_5_gyro_bias_eq_34():
    check(bias_attitude_error("5"), [[0, 0, 0], [-4 / RATE, 0, -4 / RATE], [0, 0, 0]], 1 / RATE)  # eq. 33
    found = bias_effect("5")
    check(found["x"], [4 * G / RATE, -4 * G * T_MEAS / 4, 4 * G / RATE], G * T_MEAS)
    check(found["y"], [G * T_MEAS, 0, 0], G * T_MEAS)


# --- Sequence 6: orthogonality of gyros x and y -------------------------------------------------------------------


def test_sequence_6_attitudes_eq_37():
    check_attitudes(
        "6",
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
        [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        [[0, -1, 0], [-1, 0, 0], [0, 0, -1]],
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        np.eye(3),
    )


def test_sequence_6_measurement_eqs_42_43():
    check(attitude_error("6"), [ZERO, ZERO, vector(υxy=-4)])
    found = signature("6")
    check(found["y"], vector(υxy=4 * G), G)
    check(found["z"], ZERO, G)


@pytest.mark.parametrize(
    ("rotations", "terms"),
    [  # the eight terms of eq. 42, in MARS: κxy = κyx = υxy/2 and so on
        (1, (vector(υyz=1), vector(κyy=pi, κyyy=pi), vector(υxy=-1))),
        (
            2,
            (
                vector(υzx=-0.5, υyz=0.5),
                vector(υzx=0.5, υyz=0.5),
                vector(κzz=-pi / 2, κzzz=-pi / 2),
            ),
        ),
        (3, (vector(υzx=-1), vector(κxx=pi, κxxx=pi), vector(υxy=-1))),
        (4, (vector(υzx=-0.5, υyz=-0.5), vector(υzx=0.5, υyz=-0.5), vector(κzz=pi / 2, κzzz=pi / 2))),
        (5, (vector(υyz=-1), vector(κyy=-pi, κyyy=-pi), vector(υxy=-1))),
        (6, (vector(υzx=0.5, υyz=-0.5), vector(υzx=-0.5, υyz=-0.5), vector(κzz=-pi / 2, κzzz=-pi / 2))),
        (7, (vector(υzx=1), vector(κxx=-pi, κxxx=-pi), vector(υxy=-1))),
        (8, (vector(υzx=0.5, υyz=0.5), vector(υzx=-0.5, υyz=0.5), vector(κzz=pi / 2, κzzz=pi / 2))),
    ],
)
def test_sequence_6_each_rotation_eqs_39_to_41(rotations, terms):
    s = SEQUENCES["6"]
    upto = [replace(s, rotations=s.rotations[:n]) for n in (rotations - 1, rotations)]
    before, after = attitude_error_jacobian(ideal_rotations(upto))
    found = after - before
    found[:, -3:] = 0.0
    check(found, terms)


def test_sequence_6_gyro_bias_eq_48():
    """Eq. 48 follows from the corrected eq. 47; the printed one repeats eq. 33."""
    check(bias_attitude_error("6"), [[0, 0, 0], [0, 0, 0], [-4 / RATE, -4 / RATE, 0]], 1 / RATE)
    found = bias_effect("6")
    check(found["y"], [4 * G / RATE, 4 * G / RATE, -G * T_MEAS], G * T_MEAS)
    check(found["z"], [0, G * T_MEAS, 0], G * T_MEAS)


# --- Sequence 7: misalignment of accelerometer x to gyro y, and bias of accelerometer z ---------------------------


def test_sequence_7_attitudes_eq_50():
    check_attitudes("7", HALF_X)
    down_end = attitudes("7")[-1].T @ [0.0, 1.0, 0.0]
    check(down_end, [0, -1, 0])


def test_sequence_7_attitude_error_eq_52():
    check(attitude_error("7"), [vector(κxx=pi, κxxx=pi), vector(υzx=-1), vector(υxy=1)])


def test_sequence_7_specific_force_errors_eq_53():
    start, end = force_error_jacobian(np.array([[0.0, -G, 0.0], [0.0, G, 0.0]]), PERFECT)
    check(start, [vector(λx=1, μxy=-G), vector(λy=1, λyy=-G, λyyy=G), vector(λz=1, μzy=-G)], G)
    check(end, [vector(λx=1, μxy=G), vector(λy=1, λyy=G, λyyy=G), vector(λz=1, μzy=G)], G)


def test_sequence_7_measurement_eq_54():
    found = signature("7")
    check(found["x"], vector(μxy=2 * G, υxy=G), G)
    check(found["z"], vector(λz=-2, κxx=-pi * G, κxxx=-pi * G), G)


def test_sequence_7_down_eq_55():
    found = signature("7")
    check(found["start"], vector(λyy=-G, λyyy=G, λy=1), G)
    check(found["end"], vector(λyy=-G, λyyy=-G, λy=-1), G)


def test_sequence_7_gyro_bias_eq_57():
    """F_Meas = 1/2, so that the terms with 1 − 2F vanish."""
    check(bias_attitude_error("7"), [[pi / RATE, 0, 0], [0, 0, -2 / RATE], [0, 2 / RATE, 0]], 1 / RATE)  # eq. 56
    found = bias_effect("7")
    check(found["x"], [0, 2 * G / RATE, 0], G * T_MEAS)
    check(found["z"], [-pi * G * (1 / RATE + T_MEAS / pi), 0, 0], G * T_MEAS)


@pytest.mark.parametrize("F", [0.0, 0.3, 1.0])
def test_gyro_bias_for_any_ramp_response_eqs_57_65(F):
    """The windows' term for averaging algorithms with another F_Meas."""
    for name in ("7", "13"):
        s = SEQUENCES[name]
        windows = ideal_rotations([s], RATE, T_MEAS, F).time[0] - ideal_rotations([s], RATE).time[0]
        check(windows, T_MEAS * np.diag([1.0, 1 - 2 * F, 1 - 2 * F]), T_MEAS)


# --- Sequence 13: bias of accelerometer y -------------------------------------------------------------------------


def test_sequence_13_attitudes_eq_59():
    check_attitudes("13", HALF_Z, HALF_X)
    check(attitudes("13")[-1].T @ [0.0, 0.0, 1.0], [0, 0, -1])


def test_sequence_13_attitude_error_eq_61():
    check(
        attitude_error("13"),
        [vector(υyz=-2), vector(κyy=-pi, κyyy=-pi, υzx=1), vector(κzz=pi, κzzz=pi, υxy=-1)],
    )


def test_sequence_13_specific_force_errors_eq_62():
    start, end = force_error_jacobian(np.array([[0.0, 0.0, -G], [0.0, 0.0, G]]), PERFECT)
    check(start, [vector(λx=1, μxz=-G), vector(λy=1, μyz=-G), vector(λz=1, λzz=-G, λzzz=G)], G)
    check(end, [vector(λx=1, μxz=G), vector(λy=1, μyz=G), vector(λz=1, λzz=G, λzzz=G)], G)


def test_sequence_13_measurement_eq_63():
    found = signature("13")
    check(found["x"], vector(κyy=pi * G, κyyy=pi * G, υzx=-G, μxz=2 * G), G)
    check(found["y"], vector(υyz=-2 * G, λy=-2), G)


def test_sequence_13_gyro_bias_eq_65():
    """Eq. 65 holds without the second g of the printed one."""
    check(
        bias_attitude_error("13"),  # eq. 64
        np.array([[0, -2, -2], [2, -pi, 0], [-2, 0, pi]]) / RATE,
        1 / RATE,
    )
    found = bias_effect("13")
    check(found["x"], np.array([-2 * G, pi * G, 0]) / RATE, G * T_MEAS)
    check(found["y"], [2 * G * T_MEAS / 2, -2 * G / RATE, -2 * G / RATE], G * T_MEAS)
