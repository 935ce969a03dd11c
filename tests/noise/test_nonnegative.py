"""Non-negative least squares against scipy's, and by its conditions of optimality."""

import numpy as np
import pytest
from scipy.optimize import nnls

from srt.noise.nonnegative import many_nonnegative_least_squares, nonnegative_least_squares

both = pytest.mark.parametrize("solve", [nonnegative_least_squares, many_nonnegative_least_squares])


@both
def test_agrees_with_scipy(solve):
    """Full rank makes the solution unique: both agree to rounding, times the condition number (below 1e4 here)."""
    rng = np.random.default_rng(4)
    for _ in range(300):
        m, n = int(rng.integers(7, 20)), int(rng.integers(1, 8))
        A = rng.standard_normal((m, n)) * 10.0 ** rng.uniform(-2.0, 2.0, n)
        b = A @ np.where(rng.random(n) < 0.5, rng.random(n), -rng.random(n)) + 0.1 * rng.standard_normal(m)
        expected = nnls(A, b)[0]
        size = np.linalg.norm(b) / np.linalg.norm(A, axis=0)
        np.testing.assert_allclose(solve(A, b) / size, expected / size, rtol=1e-9, atol=1e-11)


@both
def test_exact_solution_at_the_boundary(solve):
    """Unknowns that are exactly zero in the data stay zero, and the others are exact."""
    A = np.vander(np.arange(1.0, 7.0), 4) / 100.0
    truth = np.array([0.0, 2.0, 0.0, 3.0])
    np.testing.assert_allclose(solve(A, A @ truth), truth, rtol=1e-9, atol=1e-9)


@both
def test_all_negative_gives_zero(solve):
    A = np.random.default_rng(1).random((9, 3))
    assert not solve(A, -A @ np.ones(3)).any()


def test_signed_unknowns_agree_with_scipy():
    """Unknowns of either sign are the same as a pair of non-negative ones with opposite columns."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        m, n = int(rng.integers(7, 20)), int(rng.integers(2, 6))
        A = rng.standard_normal((m, n))
        b = A @ rng.standard_normal(n) + 0.1 * rng.standard_normal(m)
        expected = nnls(np.column_stack([A, -A[:, 1]]), b)[0]
        expected[1] -= expected[n]
        found = nonnegative_least_squares(A, b, (1,))
        np.testing.assert_allclose(found, expected[:n], rtol=1e-9, atol=1e-9)
