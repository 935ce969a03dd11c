"""The adapter of filterpy's square-root filter against its plain filter, and against least squares."""

import numpy as np
import pytest
from scipy.linalg import solve_triangular

pytest.importorskip("filterpy")

from filterpy.kalman import ExtendedKalmanFilter
from threadpoolctl import threadpool_limits

from estimators.square_root_filter import SquareRootFilter

EPS = np.finfo(float).eps
SEEDS = range(10)


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Threads that wait for each other over a handful of numbers take seconds on a busy machine."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def random_root(rng, n, spread=3.0):
    """A full square root whose covariance has sigmas that differ by up to ``spread``."""
    return rng.uniform(1.0, spread, n)[:, None] * (np.eye(n) + 0.3 * rng.standard_normal((n, n)))


class Measurement:
    """A curved measurement of the state, so that it matters where it is linearised."""

    def __init__(self, rng, n, m):
        self.H, self.bend = rng.standard_normal((m, n)), 0.1 * rng.standard_normal((m, n))

    def __call__(self, x):
        return self.H @ x + self.bend @ np.sin(x)

    def jacobian(self, x):
        return self.H + self.bend * np.cos(x)


def plain_filter(x, root, transition):
    ekf = ExtendedKalmanFilter(dim_x=len(x), dim_z=1)
    ekf.x, ekf.P, ekf.F, ekf.B = x.copy(), root @ root.T, transition, np.eye(len(x))
    return ekf


@pytest.mark.parametrize("seed", SEEDS)
def test_results_equal_those_of_the_covariance_filter(seed):
    """Eight cycles with inputs, process noise and nonlinear measurements of varying size agree to ten digits."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    x, root = rng.standard_normal(n), random_root(rng, n)
    F = np.eye(n) + 0.2 * rng.standard_normal((n, n))
    plain, found = plain_filter(x, root, F), SquareRootFilter(x.copy(), root)
    for _ in range(8):
        u, noise = rng.standard_normal(n), random_root(rng, n)[:, : int(rng.integers(1, n + 1))]
        plain.Q = noise @ noise.T
        plain.predict(u)
        found.propagate(F, u, noise_root=noise)
        for name in ("x", "P", "x_prior", "P_prior"):
            np.testing.assert_allclose(getattr(found, name), getattr(plain, name), rtol=0, atol=size(plain, name))
        m = int(rng.integers(1, 6))
        h, R = Measurement(rng, n, m), random_root(rng, m)
        R = R @ R.T
        z = rng.standard_normal(m)
        plain.update(z, h.jacobian, h, R=R)
        H = h.jacobian(found.x)
        found.correct(z - h(found.x) + H @ found.x, H, noise_root=np.linalg.cholesky(R))
        for name in ("x", "P", "y", "S", "SI", "K", "x_post"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(plain, name), rtol=0, atol=size(plain, name), err_msg=name
            )
        # The innovations one after the other, each given those before it: L⁻¹ y with the Cholesky factor of S.
        expected = np.linalg.solve(np.linalg.cholesky(plain.S), plain.y)
        np.testing.assert_allclose(found.whitened, expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max()))
        assert found.whitened @ found.whitened == pytest.approx(plain.mahalanobis**2, rel=1e-10)


def size(ekf, name):
    """1e-10 of a quantity. The covariances here span no more than a few decades: rounding is far below."""
    return 1e-10 * max(1e-3, float(np.abs(getattr(ekf, name)).max()))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_prior_a_million_times_wider_than_the_result(seed):
    """Least squares has the digits: its prior rows are a millionth of the others, which are well conditioned.

    The root's largest element is a million times its result, so that it is left with 1e6 · ε; the covariance, with the
    square of that, twelve decades, and filterpy shows it.
    """
    rng = np.random.default_rng(100 + seed)
    n, wide = 6, 1e6
    root, mean, truth = wide * random_root(rng, n), rng.standard_normal(n), rng.standard_normal(n)
    plain, found = plain_filter(mean, root, np.eye(n)), SquareRootFilter(mean.copy(), root)
    rows, right = [np.linalg.inv(root)], [np.linalg.solve(root, mean)]
    for _ in range(12):
        H = rng.standard_normal((2, n))
        z = H @ truth + rng.standard_normal(2)
        plain.update(z, lambda _, H=H: H, lambda x, H=H: H @ x, R=np.eye(2))
        found.correct(z, H)
        rows.append(H)
        right.append(z)
    Q, R = np.linalg.qr(np.concatenate(rows))
    x, spread = solve_triangular(R, Q.T @ np.concatenate(right)), solve_triangular(R, np.eye(n))
    P = spread @ spread.T
    sigma = np.sqrt(np.diag(P))

    def off(ekf):
        return max(np.abs((ekf.x - x) / sigma).max(), np.abs((ekf.P - P) / np.outer(sigma, sigma)).max())

    # Rounding of elements of the size of the prior: its spread of up to 3 over the results' sigmas, in every one of the
    # twelve triangularisations of n + 2 columns.
    rounding = 12 * (n + 2) * EPS * np.abs(root).max() / sigma.min()
    assert off(found) < rounding < 1e-6
    assert off(plain) > 100 * rounding
