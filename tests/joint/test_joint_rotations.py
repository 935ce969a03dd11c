"""Rotation vectors and their Jacobians against small rotations of scipy."""

import math

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jacobian_cases import EPS, derivative, exp, numerical
from scipy.spatial.transform import Rotation

from srt.model import rotations

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
