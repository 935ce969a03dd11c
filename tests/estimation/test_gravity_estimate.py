"""Initial estimate from |f| = g in every pose: Gauss-Newton where it is as good as Levenberg-Marquardt."""

from types import SimpleNamespace

import numpy as np
import pytest

from srt.constants import STANDARD_GRAVITY_M_S2 as G
from srt.estimation import initial_estimates
from srt.estimation.initial_estimates import _by_gauss_newton


def resting(rng, level):
    """Twenty poses of an accelerometer triad with errors up to a level."""
    up = rng.standard_normal((20, 3))
    M = np.eye(3) + rng.uniform(-level, level, (3, 3))
    mean = G * (up / np.linalg.norm(up, axis=1)[:, None]) @ M.T + 0.3 * level * G * rng.standard_normal(3)
    mean += 1e-5 * G * rng.standard_normal(mean.shape)
    windows = SimpleNamespace(accel_mean=mean, gyro_mean=np.zeros((20, 3)), duration_s=np.ones(20))
    return SimpleNamespace(gravity=G, windows=windows, posed=np.zeros(1, dtype=bool))


@pytest.mark.parametrize(("level", "least"), [(0.02, 20), (0.1, 18), (0.5, 0)])
def test_gauss_newton_finds_the_minimum_of_levenberg_marquardt(monkeypatch, level, least):
    """The smaller errors must not need scipy's optimiser; where both run, the estimates differ by its tolerance."""
    rng = np.random.default_rng(int(100 * level))
    reached = []

    def recorded(*arguments):
        reached.append(_by_gauss_newton(*arguments))
        return reached[-1]

    for _ in range(20):
        data = resting(rng, level)
        with monkeypatch.context() as patch:
            patch.setattr(initial_estimates, "_by_gauss_newton", recorded)
            quick = initial_estimates.estimate_from_gravity(data).vector
            patch.setattr(initial_estimates, "_by_gauss_newton", lambda *_: None)
            slow = initial_estimates.estimate_from_gravity(data).vector
        np.testing.assert_allclose(quick, slow, rtol=0.0, atol=1e-4)
    assert sum(u is not None for u in reached) >= least
