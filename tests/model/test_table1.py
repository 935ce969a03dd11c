"""Table 1, and the gyro biases that it leaves uncalibrated."""

import math

import numpy as np
import pytest
from ideal_table_1 import RAMP_S, RATE_RAD_S, G, ideal_motion
from scipy.spatial.transform import Rotation

import sims
from srt.constants import DEG
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.model.rotation_integrals import ideal_rotations
from srt.model.rotations import cross_matrix, rotation_matrix
from srt.model.table1 import AXES, SEQUENCES
from srt.sensor_errors import SensorErrors
from srt.sequences.preparation import nominal_attitude, prepare

EPS = np.finfo(float).eps
UNIT = dict(zip(AXES, np.eye(3), strict=True))

# Table 1 of the 2020 paper as it is printed: down, along outer, inner and outer angle, rotations in degrees.
PRINTED = """
1  z y   0   0  +360y
2  z x +90   0  +360x
3  x y   0 -90  +360z
1a z y   0   0  -360y
2a z x +90   0  -360x
3a x y   0 -90  -360z
4  z y   0   0  +180y +180z +180y +180z
5  z x +90   0  +180x +180z +180x +180z
6  x y   0 -90  +180y +90z +180x +90z +180y +90z +180x +90z
7  y x +90 +90  +180x
8  z x +90   0  +180x
9  x y   0 -90  +180z
10 y x +90 +90  +180z
11 z y   0   0  +180y
12 x y   0 -90  +180y
13 z y   0   0  +180z +180y
14 z x +90   0  +180z +180x
"""


def attitude(inner, outer):
    """C_nom: IMU to fixture base, R_y(outer) R_z(inner)."""
    return (Rotation.from_euler("y", outer) * Rotation.from_euler("z", inner)).as_matrix()


def test_the_table_is_the_printed_one():
    rows = {}
    for line in PRINTED.strip().splitlines():
        name, down, along, inner, outer, *turns = line.split()
        rows[name] = (down, along, int(inner), int(outer), tuple((t[-1], int(t[:-1])) for t in turns))
    ours = {
        name: (
            s.down,
            s.along_outer,
            round(math.degrees(s.inner_rad)),
            round(math.degrees(s.outer_rad)),
            tuple((axis, round(math.degrees(angle))) for axis, angle in s.rotations),
        )
        for name, s in SEQUENCES.items()
    }
    assert list(rows) == list(ours)  # the order too
    assert rows == ours
    assert all(name == s.id for name, s in SEQUENCES.items())


@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=lambda s: s.id)
def test_initial_angles_bring_the_named_axes_down_and_along_outer(sequence):
    C = attitude(sequence.inner_rad, sequence.outer_rad)
    np.testing.assert_allclose(C @ UNIT[sequence.down], [0, 0, 1], atol=4 * EPS)
    # The outer axis is table y; "along" it is along its positive direction.
    np.testing.assert_allclose(C @ UNIT[sequence.along_outer], [0, 1, 0], atol=4 * EPS)
    np.testing.assert_allclose(nominal_attitude(sequence), C, atol=4 * EPS)


@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=lambda s: s.id)
def test_every_rotation_is_one_of_a_fixture_axis(sequence):
    """About IMU z it is the inner axis; any other IMU axis must lie on the outer one at that moment."""
    inner, outer = sequence.inner_rad, sequence.outer_rad
    C = attitude(inner, outer)
    for axis, angle in sequence.rotations:
        u = C @ UNIT[axis]  # in the base
        if axis == "z":
            np.testing.assert_allclose(u, attitude(0.0, outer)[:, 2], atol=16 * EPS)
            inner += angle
        else:
            np.testing.assert_allclose(np.abs(u), [0, 1, 0], atol=16 * EPS)
            outer += angle * np.sign(u[1])
        C = C @ Rotation.from_rotvec(angle * UNIT[axis]).as_matrix()
        np.testing.assert_allclose(C, attitude(inner, outer), atol=32 * EPS)


BIAS = np.array([0.12, -0.08, 0.1]) * DEG
STEPS = 4000
"""Steps of the quadrature per rotation: the midpoint rule is off by (π / STEPS)² / 24 of a half turn's integral."""


def horizontal(bias):
    """Change of the horizontal acceleration of every sequence, data with a bias played back as if there were none."""
    errors = SensorErrors.from_dict({f"gyro_bias_{a}": float(b) for a, b in zip("xyz", bias, strict=True)})
    recording = sims.read_out(ideal_motion(), errors)
    data = prepare(recording, recording.sequences)
    z = SrtProcessor(data, Options()).process(SensorErrors()).z[: 2 * data.K].reshape(-1, 2)
    down = [AXES.index(SEQUENCES[name].down) for name in data.ids]
    out = np.zeros((data.K, 3))
    for row, values, d in zip(out, z, down, strict=True):
        row[[a for a in range(3) if a != d]] = values
    return {name: (row, d) for name, row, d in zip(data.ids, out, down, strict=True)}


def by_order(sequence, bias):
    """First and second term of E − 1 for rotations at a constant rate, and how long they take."""
    C, v, dt = np.eye(3), [], []
    for u, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        part = (np.arange(STEPS) + 0.5) / STEPS * angle
        v.append(np.einsum("ab,nbc,c->na", C, rotation_matrix(part[:, None] * u), bias))
        dt.append(np.full(STEPS, abs(angle) / RATE_RAD_S / STEPS))
        C = C @ rotation_matrix(angle * u)
    turns, dt = np.concatenate(v) * np.concatenate(dt)[:, None], np.concatenate(dt)
    before = np.cumsum(turns, axis=0) - 0.5 * turns
    second = np.einsum("nab,nbc->ac", cross_matrix(before), cross_matrix(turns))
    return cross_matrix(turns.sum(axis=0)), second, float(dt.sum())


def test_effect_of_a_bias_on_all_17_sequences_to_second_order():
    measured = horizontal(BIAS)
    assert set(measured) == set(SEQUENCES)
    size, seen = float(np.linalg.norm(BIAS)), 0
    for name, (delta, d) in measured.items():
        sequence = SEQUENCES[name]
        first, second, T = by_order(sequence, BIAS)
        # Eq. 20 is the first order in closed form.
        (closed,) = ideal_rotations([sequence], RATE_RAD_S).time
        quadrature = size * T * (math.pi / STEPS) ** 2
        np.testing.assert_allclose(first, cross_matrix(closed @ BIAS), rtol=0, atol=quadrature)
        u = np.eye(3)[d]
        level = np.eye(3) - np.outer(u, u)
        left = [np.linalg.norm(delta - level @ (order @ (-G * u))) for order in (first, first + second)]
        # Each rotation's ramps and what is left of its last sample add up to two ramps' time (see conftest); the
        # quadrature is of first and second order alike; rounding of a sum of g.
        n = len(sequence.angles_rad)
        exact = G * (size * (n + 4) * RAMP_S + 2.0 * quadrature) + 1e-12 * G
        x = size * T
        assert left[1] <= G * x**3 / 6.0 * math.exp(x) + exact, name
        assert left[0] <= G * x**2 / 2.0 * math.exp(x) + exact, name
        seen += left[0] > 5.0 * left[1]
    # The second order is there: without it most sequences are off by several times more. (Some have little of it.)
    assert seen > len(SEQUENCES) / 2
