"""The five worked examples of Savage 2017 (part 3) and its gyro-bias results, with the paper's matrices.

Every matrix and every vector below is the paper's, entered as numbers; the misalignments κ_ij = κ_ji = υ_ij / 2 are
put in as the paper does when it goes over to MARS axes (eq. 10).
"""

from dataclasses import dataclass, replace
from math import pi

import numpy as np
import pytest
from ideal_table_1 import G
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


HALF_X, HALF_Y, HALF_Z = np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Example:
    """A sequence as the paper works it out.

    ``attitudes`` are the C_Bi after each rotation, ``error`` and ``by_bias`` the rows of φ_End of the sensor errors and
    of the gyro bias, ``signature`` and ``bias`` the rows of e(Δa) by component, of the same.
    """

    attitudes: list
    error: list
    signature: dict
    by_bias: list
    bias: dict


EXAMPLES = {
    # Scale factor of gyro z: eqs. 15-20.
    "3": Example(
        [np.eye(3)],
        [ZERO, ZERO, vector(κzz=2 * pi, κzzz=2 * pi)],
        {"y": vector(κzz=-2 * pi * G, κzzz=-2 * pi * G), "z": ZERO},
        [[0, 0, 0], [0, 0, 0], [0, 0, 2 * pi / RATE]],
        {"y": [0, 0, -2 * pi * G * (1 / RATE + T_MEAS / (2 * pi))], "z": [0, G * T_MEAS, 0]},
    ),
    # Orthogonality of gyros z and x: eqs. 23-34.
    "5": Example(
        [HALF_X, HALF_Y, HALF_Z, np.eye(3)],
        [ZERO, vector(υzx=-4), ZERO],
        {"x": vector(υzx=4 * G), "y": ZERO},
        [[0, 0, 0], [-4 / RATE, 0, -4 / RATE], [0, 0, 0]],
        {"x": [4 * G / RATE, -4 * G * T_MEAS / 4, 4 * G / RATE], "y": [G * T_MEAS, 0, 0]},
    ),
    # Orthogonality of gyros x and y: eqs. 37-48; eq. 48 follows from the corrected eq. 47, which is printed as eq. 33.
    "6": Example(
        [
            [[-1, 0, 0], [0, 1, 0], [0, 0, -1]], [[0, 1, 0], [1, 0, 0], [0, 0, -1]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
            [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
            [[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.eye(3),
        ],
        [ZERO, ZERO, vector(υxy=-4)],
        {"y": vector(υxy=4 * G), "z": ZERO},
        [[0, 0, 0], [0, 0, 0], [-4 / RATE, -4 / RATE, 0]],
        {"y": [4 * G / RATE, 4 * G / RATE, -G * T_MEAS], "z": [0, G * T_MEAS, 0]},
    ),
    # Misalignment of accelerometer x to gyro y, bias of accelerometer z: eqs. 50-57, where F_Meas = 1/2.
    "7": Example(
        [HALF_X],
        [vector(κxx=pi, κxxx=pi), vector(υzx=-1), vector(υxy=1)],
        {
            "x": vector(μxy=2 * G, υxy=G), "z": vector(λz=-2, κxx=-pi * G, κxxx=-pi * G),
            "start": vector(λyy=-G, λyyy=G, λy=1), "end": vector(λyy=-G, λyyy=-G, λy=-1),
        },
        [[pi / RATE, 0, 0], [0, 0, -2 / RATE], [0, 2 / RATE, 0]],
        {"x": [0, 2 * G / RATE, 0], "z": [-pi * G * (1 / RATE + T_MEAS / pi), 0, 0]},
    ),
    # Bias of accelerometer y: eqs. 59-65; eq. 65 holds without the second g of the printed one.
    "13": Example(
        [HALF_Z, HALF_X],
        [vector(υyz=-2), vector(κyy=-pi, κyyy=-pi, υzx=1), vector(κzz=pi, κzzz=pi, υxy=-1)],
        {"x": vector(κyy=pi * G, κyyy=pi * G, υzx=-G, μxz=2 * G), "y": vector(υyz=-2 * G, λy=-2)},
        np.array([[0, -2, -2], [2, -pi, 0], [-2, 0, pi]]) / RATE,
        {"x": np.array([-2 * G, pi * G, 0]) / RATE, "y": [2 * G * T_MEAS / 2, -2 * G / RATE, -2 * G / RATE]},
    ),
}  # fmt: skip
of_each_sequence = pytest.mark.parametrize("name", EXAMPLES)


@of_each_sequence
def test_attitudes(name):
    check(attitudes(name), [np.eye(3), *EXAMPLES[name].attitudes])


@of_each_sequence
def test_attitude_error(name):
    check(attitude_error(name), EXAMPLES[name].error)


@of_each_sequence
def test_measurement(name):
    found = signature(name)
    for component, expected in EXAMPLES[name].signature.items():
        check(found[component], expected, G)


@of_each_sequence
def test_gyro_bias(name):
    check(bias_attitude_error(name), EXAMPLES[name].by_bias, 1 / RATE)
    found = bias_effect(name)
    for component, expected in EXAMPLES[name].bias.items():
        check(found[component], expected, G * T_MEAS)


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


@pytest.mark.parametrize("F", [0.0, 0.3, 1.0])
def test_gyro_bias_for_any_ramp_response_eqs_57_65(F):
    """The windows' term for averaging algorithms with another F_Meas."""
    for name in ("7", "13"):
        s = SEQUENCES[name]
        windows = ideal_rotations([s], RATE, T_MEAS, F).time[0] - ideal_rotations([s], RATE).time[0]
        check(windows, T_MEAS * np.diag([1.0, 1 - 2 * F, 1 - 2 * F]), T_MEAS)


@pytest.mark.parametrize(("name", "axis"), [("7", 1), ("13", 2)])
def test_specific_force_errors_eqs_53_62(name, axis):
    """Windows at the start and at the end, where the axis that is down reads -g and g."""
    expected = {
        "7": (
            [vector(λx=1, μxy=-G), vector(λy=1, λyy=-G, λyyy=G), vector(λz=1, μzy=-G)],
            [vector(λx=1, μxy=G), vector(λy=1, λyy=G, λyyy=G), vector(λz=1, μzy=G)],
        ),
        "13": (
            [vector(λx=1, μxz=-G), vector(λy=1, μyz=-G), vector(λz=1, λzz=-G, λzzz=G)],
            [vector(λx=1, μxz=G), vector(λy=1, μyz=G), vector(λz=1, λzz=G, λzzz=G)],
        ),
    }
    check(force_error_jacobian(np.outer([-G, G], np.eye(3)[axis]), PERFECT), expected[name], G)
    check(attitudes(name)[-1].T @ np.eye(3)[axis], -np.eye(3)[axis])
