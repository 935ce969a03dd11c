"""Quaternions and rotation vectors against rotations of scipy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from platform_streams import EPS
from scipy.spatial.transform import Rotation

from srt.model import rotations

TAYLOR_SWITCH = math.sqrt(0.05)  # rad, where the series hands over to sine and cosine


def matrices(q):
    """(n, 3, 3) from the package's (2, n)."""
    return np.moveaxis(rotations.to_matrix(q), 2, 0)


def random_vectors(rng, n, size):
    return rng.normal(size=(3, n)) * size


# --- quaternions ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1, 1.0, math.pi, 6.0, 20.0])
def test_rotation_vectors_of_any_size(size):
    rng = np.random.default_rng(1)
    direction = random_vectors(rng, 50, 1.0)
    phi = size * direction / np.linalg.norm(direction, axis=0)
    found = matrices(rotations.from_rotation_vector(phi))
    # Rounding of the angle itself, some eps of it, and of the products.
    np.testing.assert_allclose(found, Rotation.from_rotvec(phi.T).as_matrix(), rtol=0, atol=(8 + 2 * size) * EPS)
    np.testing.assert_allclose(rotations.rotation_matrix(phi.T), found, rtol=0, atol=0)


@pytest.mark.parametrize("side", [1 - 1e-12, 1 + 1e-12])
def test_both_sides_of_the_switch_of_the_series(side):
    """Just below it is Taylor's series, just above sine and cosine: both to the last digits."""
    phi = np.array([[0.6], [-0.48], [0.64]]) * TAYLOR_SWITCH * side
    q = rotations.from_rotation_vector(phi)
    half = 0.5 * TAYLOR_SWITCH * side
    expected = np.array([math.cos(half), *(math.sin(half) * np.array([0.6, -0.48, 0.64]))])
    found = np.array([q[0, 0].real, -q[1, 0].imag, -q[1, 0].real, -q[0, 0].imag])
    np.testing.assert_allclose(found, expected, rtol=4 * EPS)
    # The switch looks at the largest of all: a small one beside it takes the other branch, and must not notice.
    both = np.concatenate([phi, 0.01 * phi, 10 * phi], axis=1)
    alone = rotations.from_rotation_vector(0.01 * phi)
    np.testing.assert_allclose(rotations.from_rotation_vector(both)[:, 1:2], alone, rtol=4 * EPS)


@pytest.mark.parametrize("n", [*range(1, 18), 31, 32, 33, 1000, 1001])
@pytest.mark.parametrize("size", [1e-4, 1.0])
def test_prefix_products_of_chains(n, size):
    """Odd, even and shortest lengths, against multiplying one by one."""
    phi = random_vectors(np.random.default_rng(n), n, size)
    found = matrices(rotations.prefix_product(rotations.from_rotation_vector(phi)))
    total = Rotation.identity()
    for i, vector in enumerate(phi.T):
        total = total * Rotation.from_rotvec(vector)
        # scipy's own chain drifts by an eps or so in every product.
        np.testing.assert_allclose(found[i], total.as_matrix(), rtol=0, atol=(8 + 2 * i) * EPS)


@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_quaternion_algebra(n, seed):
    rng = np.random.default_rng(seed)
    p, q = (rotations.from_rotation_vector(random_vectors(rng, n, 2.0)) for _ in range(2))
    np.testing.assert_allclose(matrices(rotations.multiply(p, q)), matrices(p) @ matrices(q), atol=16 * EPS)
    np.testing.assert_allclose(matrices(rotations.conjugate(p)), np.swapaxes(matrices(p), 1, 2), atol=4 * EPS)
    unit = rotations.multiply(p, rotations.conjugate(p))
    np.testing.assert_allclose(unit, np.array([[1.0], [0.0]]) * np.ones(n), atol=4 * EPS)
    # Normalised whatever the norm of the quaternion.
    np.testing.assert_allclose(matrices(1.5 * p), matrices(p), atol=8 * EPS)
    v, w = rng.normal(size=(2, n, 3))
    crossed = np.einsum("nab,nb->na", rotations.cross_matrix(v), w)
    np.testing.assert_allclose(crossed, np.cross(v, w), atol=8 * EPS * 25)


# --- rotation vectors of matrices -----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 0.1, 1.0, 2.0, 3.0, math.pi - 1e-6])
def test_rotation_vectors_of_matrices(size):
    """Each element of the quaternion is the largest one for some of the axes."""
    rng = np.random.default_rng(2)
    axes = np.vstack([np.eye(3), -np.eye(3), rng.normal(size=(60, 3))])
    phi = size * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    found = rotations.rotation_vector(Rotation.from_rotvec(phi).as_matrix())
    # Rounding of the matrices, a few eps, is an error of the angle of as much.
    np.testing.assert_allclose(found, phi, rtol=0, atol=16 * EPS)


@pytest.mark.parametrize("less", [0.0, 1e-16, 1e-12, 1e-7])
def test_rotation_vectors_at_half_a_turn(less):
    """Either sign is within rounding of half a turn, and its rotation is the same."""
    axes = np.vstack([np.eye(3), np.random.default_rng(2).normal(size=(60, 3))])
    phi = (math.pi - less) * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    C = Rotation.from_rotvec(phi).as_matrix()
    found = rotations.rotation_vector(C)
    assert np.linalg.norm(found, axis=1).max() <= math.pi + 4 * EPS
    np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), C, rtol=0, atol=20 * EPS)


@pytest.mark.parametrize("size", [0.0, 0.9e-3, 1.1e-3, 0.03, 0.5, 2.0, 3.0])
def test_inverse_right_jacobian_is_the_derivative_of_the_logarithm(size):
    """Log(exp(φ×) exp(δ×)) by central differences, on both sides of the switch of the series."""
    rng = np.random.default_rng(3)
    axes = rng.normal(size=(20, 3))
    phi = size * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    before, step = Rotation.from_rotvec(phi), 1e-5
    columns = [
        ((before * Rotation.from_rotvec(step * e)).as_rotvec() - (before * Rotation.from_rotvec(-step * e)).as_rotvec())
        / (2.0 * step)
        for e in np.eye(3)
    ]
    # Third derivatives, below 10 at 3 rad, times a sixth of the squared step; rounding of the angles over the step.
    atol = 10.0 * step**2 / 6.0 + 16 * EPS / step
    np.testing.assert_allclose(rotations.inverse_right_jacobian(phi), np.stack(columns, axis=2), rtol=0, atol=atol)


def test_series_of_the_inverse_jacobian_is_its_closed_form():
    """Just below the switch the series, just above the closed form: the factor of φ×φ× has an error of 1e-9."""
    below, above = (
        rotations.inverse_right_jacobian(np.array([[0.6, -0.48, 0.64]]) * 1e-3 * side) for side in (1 - 1e-9, 1 + 1e-9)
    )
    np.testing.assert_allclose(below, above, rtol=0, atol=1e-11)
    angle = 0.9e-3
    X = rotations.cross_matrix(np.array([0.6, -0.48, 0.64]) * angle)
    factor = (1.0 / 12.0) + angle**2 / 720.0  # + angle^4 / 30240, 2e-17
    found = rotations.inverse_right_jacobian(np.array([[0.6, -0.48, 0.64]]) * angle)[0] - np.eye(3) - 0.5 * X
    np.testing.assert_allclose(found, factor * X @ X, rtol=0, atol=2 * EPS)


def test_smallest_rotation_takes_one_vector_to_the_other():
    rng = np.random.default_rng(4)
    before, after = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 50, 3)))
    C = rotations.smallest_rotation(before, after)
    cosine = np.einsum("na,na->n", before, after)
    # The division by 1 + cos amplifies rounding for nearly opposite vectors.
    bound = 16 * EPS / (1.0 + cosine)[:, None]
    assert np.all(np.abs(np.einsum("nab,nb->na", C, before) - after) < bound)
    angle = Rotation.from_matrix(C).magnitude()
    assert np.all(np.abs(angle - np.arccos(cosine)) < 1e-7)  # square root of the rounding error, near 0 and π
