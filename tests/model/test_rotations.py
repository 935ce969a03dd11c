"""Quaternions and rotation vectors against rotations of scipy."""

from __future__ import annotations

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
