"""Table 1 as data, against the kinematics of the two-axis fixture it is executed on."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sims
from srt.model.rotation_integrals import ideal_rotations
from srt.model.table1 import AXES, SEQUENCES
from srt.sequences.preparation import nominal_attitude

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


# Travel in degrees from the initial angle: lowest and highest of inner and outer axis. A cable must allow it.
TRAVEL = {
    "1": ((0, 0), (0, 360)),
    "2": ((0, 0), (0, 360)),
    "3": ((0, 360), (0, 0)),
    "1a": ((0, 0), (-360, 0)),
    "2a": ((0, 0), (-360, 0)),
    "3a": ((-360, 0), (0, 0)),
    "4": ((0, 360), (0, 180)),
    "5": ((0, 360), (0, 180)),
    "6": ((0, 360), (0, 360)),
    "7": ((0, 0), (0, 180)),
    "8": ((0, 0), (0, 180)),
    "9": ((0, 180), (0, 0)),
    "10": ((0, 180), (0, 0)),
    "11": ((0, 0), (0, 180)),
    "12": ((0, 0), (0, 180)),
    "13": ((0, 180), (-180, 0)),
    "14": ((0, 180), (-180, 0)),
}


@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=lambda s: s.id)
def test_travel_of_both_fixture_axes(sequence):
    """Rotations of 180° about an axis that was turned round run the outer axis back."""
    C = attitude(sequence.inner_rad, sequence.outer_rad)
    inner, outer = [0.0], [0.0]
    for axis, angle in sequence.rotations:
        if axis == "z":
            inner.append(inner[-1] + math.degrees(angle))
        else:
            outer.append(outer[-1] + math.degrees(angle) * round((C @ UNIT[axis])[1]))
        C = C @ Rotation.from_rotvec(angle * UNIT[axis]).as_matrix()
    found = tuple((round(min(a)), round(max(a))) for a in (inner, outer))
    assert found == TRAVEL[sequence.id]
    # The simulator, which has its own table and its own kinematics, turns the same axes the same way.
    legs = sims.TABLE_1[sequence.id].fixture_legs()
    by_axis = [[0.0], [0.0]]
    for which, angle in legs:
        by_axis[which].append(by_axis[which][-1] + math.degrees(angle))
    assert tuple((round(min(a)), round(max(a))) for a in by_axis) == found


@pytest.mark.parametrize("name", ["1", "2", "3", "1a", "2a", "3a", "4", "5", "6"])
def test_net_rotation_of_scale_and_orthogonality_sequences_is_none(name):
    C = ideal_rotations([SEQUENCES[name]]).C_end[0]
    np.testing.assert_allclose(C, np.eye(3), atol=32 * EPS)


@pytest.mark.parametrize("name", [str(i) for i in range(7, 15)])
def test_the_others_end_upside_down(name):
    """The start's vertical axis points up at the end: the accelerometer is read in both directions."""
    sequence = SEQUENCES[name]
    down_at_end = ideal_rotations([sequence]).C_end[0].T @ UNIT[sequence.down]
    np.testing.assert_allclose(down_at_end, -UNIT[sequence.down], atol=32 * EPS)


def test_axes_and_angles_as_arrays():
    six = SEQUENCES["6"]
    np.testing.assert_array_equal(six.axes, [UNIT[a] for a in "yzxzyzxz"])
    np.testing.assert_array_equal(six.angles_rad, np.array([math.pi, math.pi / 2] * 4))
    assert SEQUENCES["1a"].angles_rad.tolist() == [-2 * math.pi]
    with pytest.raises(AttributeError):
        six.down = "z"
