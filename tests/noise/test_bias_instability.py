"""The covariance of averages of flicker noise: against integrals, against simulated drift, and what is made of it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

import sims
from sims.physics.imu import CORRELATION_TIMES_S as SIMULATED_TIMES_S
from sims.physics.imu import drift
from srt.model.analytic_platform import equal_parts
from srt.noise.bias_instability import (
    CORRELATION_TIMES_S,
    correlation_times,
    drift_draws,
    flicker_covariance,
    window_draws,
)
from srt.recording.recording import Site

TIME_S = 100.0 + 0.01 * np.arange(1, 4001)
PROCESS = math.log(10.0) / (2.0 * math.log(2.0))
"""Variance of one process, Allan floor one."""


@settings(max_examples=50, deadline=None)
@given(length=st.floats(2.0, 1000.0), shift=st.floats(-1e5, 1e5))
def test_flicker_has_its_allan_floor(length, shift):
    """Half the mean square difference of neighbouring averages is one for all τ; decades ripple by 3 %."""
    at = shift + length * np.arange(3.0)
    covariance = flicker_covariance(at[:-1], at[1:])
    assert covariance[0, 0] - covariance[0, 1] == pytest.approx(1.0, rel=0.04)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


@pytest.mark.parametrize("tau", [0.1, 10.0, 1e4])
def test_against_numerical_integration(tau):
    """Apart, touching, overlapping, one within the other, and the variances."""
    start = np.array([0.0, 3.0, 7.0, 5.5, 8.0, 40.0])
    end = np.array([3.0, 7.0, 9.0, 8.5, 8.2, 43.0])
    found = flicker_covariance(start, end, (tau,))
    for i, j in [(0, 0), (0, 1), (0, 2), (1, 3), (2, 3), (2, 4), (1, 5), (4, 4)]:
        # Above and below the diagonal apart: the kink of exp(−|t|/τ) is on a border of the integrals.
        expected = 0.0
        for side in (-1.0, 1.0):

            def upper(t, side=side, j=j):
                return float(np.clip(t, start[j], end[j])) if side < 0.0 else float(end[j])

            def lower(t, side=side, j=j):
                return float(start[j]) if side < 0.0 else float(np.clip(t, start[j], end[j]))

            value, _ = dblquad(
                lambda u, t: math.exp(-abs(t - u) / tau), start[i], end[i], lower, upper, epsabs=1e-10, epsrel=1e-10
            )
            expected += value
        expected *= PROCESS / ((end[i] - start[i]) * (end[j] - start[j]))
        assert found[i, j] == pytest.approx(expected, rel=1e-6, abs=1e-9)
        assert found[j, i] == pytest.approx(found[i, j], rel=1e-12)


def test_a_point_in_an_interval_is_the_limit_of_short_ones():
    start, end = np.array([[0.0, 3.0], [0.0, 3.0]]), np.array([[10.0, 3.0], [10.0, 3.0 + 1e-5]])
    point, short = flicker_covariance(start, end)
    np.testing.assert_allclose(point, short, rtol=1e-5)  # the covariance with a mean over 1e-5 s, of 1 s at least


def test_against_simulated_drift():
    """Averages of 300 runs of three sensors; every element of the covariance within 3.5 of its standard errors.

    The variance of an estimated covariance of n Gaussian pairs is (c_ii c_jj + c_ij²) / n. One element of the 36 is
    beyond 3.5 sigma with a chance of 1.7 %. Drift is held over a sample of 0.1 s: of the process of 1 s this takes
    parts in a thousand.
    """
    motion = sims.table1_motion(site=Site(9.8, latitude_rad=0.8), sample_rate_hz=10.0, sequences=("1", "7"))
    n = len(motion.time)
    edges = np.array([[0, 40], [40, 100], [100, 110], [150, 250], [250, n - 50], [n - 50, n]])
    rng = np.random.default_rng(2026)
    means = []
    for _ in range(300):
        values = drift(1.0, motion, rng)
        means.append([values[a:b].mean(axis=0) for a, b in edges])
    means = np.concatenate(np.moveaxis(means, 2, 0))
    start, end = motion.time[edges[:, 0]] - motion.interval, motion.time[edges[:, 1] - 1]
    expected = flicker_covariance(start, end, SIMULATED_TIMES_S)
    found = means.T @ means / len(means)
    own = np.diag(expected)
    error = np.sqrt((np.outer(own, own) + expected**2) / len(means))
    assert np.all(np.abs(found - expected) < 3.5 * error + 0.005 * np.sqrt(np.outer(own, own)))


def test_correlation_times_end_with_the_test():
    """Variations slower than the test belong to the bias: correlation times end at its length, at least 1000 s."""
    assert correlation_times(60.0) == correlation_times(2000.0) == CORRELATION_TIMES_S[:5]
    assert max(correlation_times(2e4)) == 1e4


def test_draws_have_the_covariance():
    windows = np.array([[0, 400], [1400, 1800], [1800, 2200], [3200, 3600]])
    rotation = np.array([[400, 1400], [2200, 3200]])
    draws = drift_draws(windows, rotation, TIME_S)
    np.testing.assert_allclose(draws.part_s.sum(axis=1), 10.0, rtol=1e-9)
    # Equal parts together are their rotation, and the windows need no draws of the rotations.
    together = np.concatenate([draws.windows, draws.turns])
    spans = 0.01 * np.concatenate([windows, rotation])
    expected = flicker_covariance(spans[:, 0], spans[:, 1], correlation_times(36.0))
    np.testing.assert_allclose(together @ together.T, expected, rtol=1e-2)
    np.testing.assert_allclose(draws.windows @ draws.windows.T, expected[:4, :4], rtol=1e-9)
    assert np.all(draws.windows[:, 4:] == 0.0)
    np.testing.assert_allclose(window_draws(windows, TIME_S), draws.windows[:, :4], rtol=1e-12, atol=1e-15)


def test_rotations_too_short_for_their_parts():
    """Parts without a sample stay without effect, and the draws stay finite."""
    rotation = np.array([[100, 103], [203, 204]])
    assert np.array_equal(equal_parts(rotation, 4), [[100, 100, 101, 102, 103], [203, 203, 203, 203, 204]])
    draws = drift_draws(np.array([[0, 100], [103, 203], [204, 304]]), rotation, TIME_S)
    assert np.all(np.isfinite(draws.parts))
    np.testing.assert_allclose(draws.part_s.sum(axis=1), [0.03, 0.01], rtol=1e-9)
