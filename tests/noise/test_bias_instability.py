"""Bias instability: its Markov model, its share at rest, and the covariance that it adds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from injected_faults.injection import Case
from scipy.integrate import dblquad
from scipy.signal import lfilter
from scipy.stats import chi2

import srt
from srt.constants import MICRO_G
from srt.model.analytic_platform import equal_parts
from srt.noise import markov_drift
from srt.noise.bias_instability import (
    CORRELATION_TIMES_S,
    PROCESS_VARIANCE,
    correlation_times,
    drift_draws,
    flicker_covariance,
    window_draws,
)
from srt.noise.instability_at_rest import InstabilityAtRest, _fitted, instability_at_rest
from srt.noise.markov_drift import carried, markov_steps
from srt.noise.noise_model import noise_model

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


def chain(steps):
    """Covariance of the averages of all steps, by propagation of the states from their distribution at the start."""
    K, n, M = steps.by_state.shape
    size = n + M
    # Effects of the draws, those of the first states and then those of every step, on the states and on all averages.
    states, means = np.zeros((M, M + K * size)), np.zeros((K, n, M + K * size))
    states[:, :M] = np.eye(M)
    for k in range(K):
        own = slice(M + k * size, M + (k + 1) * size)
        means[k] = steps.by_state[k] @ states
        means[k, :, own] += steps.root[k, :n]
        states = steps.decay[k][:, None] * states
        states[:, own] += steps.root[k, n:]
    means = means.reshape(K * n, -1)
    return means @ means.T


def sequences(pause):
    """Windows of 10 s around a rotation in three parts, of several lengths, with pauses between the sequences."""
    start, end, at = [], [], 5.0
    for turn in (6.3, 12.6, 3.1, 25.0):
        edges = at + np.array([0.0, 10.0, 10.0 + turn / 3, 10.0 + turn / 1.5, 10.0 + turn, 20.0 + turn])
        start.append(edges[:-1])
        end.append(edges[1:])
        at = edges[-1] + pause
    start, end = np.array(start), np.array(end)
    return start, end, (start[:, 0], np.append(start[1:, 0], end[-1, -1]))


@pytest.mark.parametrize("pause", [0.0, 8.0])
def test_chain_has_the_covariance_of_the_averages(pause, monkeypatch):
    """With a state for every process the chain is exact; the roots are regularised by 1e-12 of the variances."""
    monkeypatch.setattr(markov_drift, "CARRIED_S", 0.0)
    start, end, span = sequences(pause)
    times = correlation_times(float(end.max() - start.min()))
    found = chain(markov_steps(start, end, span, times))
    expected = flicker_covariance(start.ravel(), end.ravel(), times)
    assert np.abs(found - expected).max() <= 1e-10 * expected.max()


@pytest.mark.parametrize("pause", [0.0, 8.0])
def test_processes_without_a_state_matter_between_adjoining_averages_only(pause):
    """Faster ones lose their covariance between steps: at most (τ/T₁)(τ/T₂) of a process, apart e^(−pause/τ) of it."""
    start, end, span = sequences(pause)
    times = correlation_times(float(end.max() - start.min()))
    found = chain(markov_steps(start, end, span, times))
    expected = flicker_covariance(start.ravel(), end.ravel(), times)
    inside = np.kron(np.eye(len(start)), np.ones((start.shape[1],) * 2)) > 0.0
    assert np.abs(found - expected)[inside].max() <= 1e-10 * expected.max()
    lost = (expected - found)[~inside]
    fast = [tau for tau in times if tau not in carried(times)]
    bound = PROCESS_VARIANCE * sum((tau / 10.0) ** 2 * math.exp(-pause / tau) for tau in fast)
    assert 0.0 <= lost.max() <= bound * (1.0 + 1e-9)
    assert lost.max() < 0.005 * expected.diagonal().min()


def spectrum(frequency, times):
    """Two-sided spectrum of the sum of processes for an Allan floor of one, over that of flicker noise."""
    own = sum(2.0 * PROCESS_VARIANCE * tau / (1.0 + (2.0 * np.pi * frequency * tau) ** 2) for tau in times)
    return own * 4.0 * math.log(2.0) * frequency


def test_fit_to_flicker_noise():
    """The spectrum ripples by 2 / cosh(π² / ln 10) = 5.5 % (2.8 % of a sigma) where processes continue on both sides.

    The sum over processes a decade apart is a sum over n of sech(x − n ln 10), whose Fourier series has the relative
    amplitudes 2 sech(π² m / ln 10). A sum that ends with the process τ lacks (2 / π) atan(1 / (√10 ω τ)).
    """
    ripple, second, third = (2.0 / math.cosh(m * math.pi**2 / math.log(10.0)) for m in (1, 2, 3))
    endless = 10.0 ** np.arange(-12, 13.0)
    over = spectrum(np.geomspace(1e-2, 1.0, 2001), endless) - 1.0
    assert over.max() == pytest.approx(ripple + second, abs=1.1 * third)
    assert over.min() == pytest.approx(-ripple + second, abs=1.1 * third)
    assert ripple == pytest.approx(0.055, rel=1e-3)
    # The processes in use, a decade inside their range.
    frequency = 1.0 / (2.0 * np.pi * np.geomspace(10.0 * CORRELATION_TIMES_S[0], 0.1 * CORRELATION_TIMES_S[-1], 501))
    found = spectrum(frequency, CORRELATION_TIMES_S)
    missing = 2.0 / math.pi * math.atan(1.0 / math.sqrt(1000.0))
    assert np.all(np.abs(found - 1.0) < ripple + second + 2.0 * missing)


DT = 0.01
LENGTHS = (1000, 500, 1500)


def recorded(rng, *, white, floor, quantum=0.0, windows=34, times_s=CORRELATION_TIMES_S):
    """White noise and flicker noise of an Allan floor, the latter as a sum of Gauss-Markov processes."""
    n = sum(LENGTHS[w % 3] for w in range(windows))
    out = white / math.sqrt(DT) * rng.standard_normal((n, 3))
    size = floor * math.sqrt(math.log(10.0) / (2.0 * math.log(2.0)))
    for tau in times_s:
        phi = math.exp(-DT / tau)
        steps = size * math.sqrt(1.0 - phi**2) * rng.standard_normal((n, 3))
        steps[0] = size * rng.standard_normal(3)
        out += lfilter([1.0], [1.0, -phi], steps, axis=0)
    ends = np.cumsum([LENGTHS[w % 3] for w in range(windows)])
    bounds = np.stack([ends - [LENGTHS[w % 3] for w in range(windows)], ends], axis=1)
    return (np.round(out / quantum) * quantum if quantum else out), bounds


@pytest.mark.parametrize("times_s", [CORRELATION_TIMES_S, CORRELATION_TIMES_S[1:]], ids=["all", "without fastest"])
def test_instability_is_found_with_its_size(times_s):
    """34 windows of 5 to 15 s with as much white noise of 1 s; sensors differ in the noise above 1 Hz.

    B² and its 1-sigma, which the bound adds, against the scatter of 12 recordings: 3.5 standard errors.
    """
    rng, n = np.random.default_rng(4), 12
    found = [instability_at_rest(*recorded(rng, white=1.0, floor=1.0, times_s=times_s), DT) for _ in range(n)]
    square = np.array([one.value**2 for one in found])
    sigma = np.mean([one.bound**2 - one.value**2 for one in found])
    assert np.all(square > 0.0)
    assert square.mean() == pytest.approx(1.0, abs=3.5 * sigma / math.sqrt(n))
    assert np.var(square, ddof=1) < sigma**2 * chi2.isf(2e-4, n - 1) / (n - 1)


def test_white_noise_shows_none_and_bounds_it():
    """The bound of 34 windows of white noise is a third of the noise of 1 s at most: it hardly widens a sigma."""
    rng = np.random.default_rng(5)
    found = [instability_at_rest(*recorded(rng, white=1.0, floor=0.0, windows=34), DT) for _ in range(6)]
    assert all(0.0 < one.bound < 0.33 and one.value == 0.0 for one in found)


def test_one_window_with_motion_changes_little():
    rng = np.random.default_rng(6)
    readings, windows = recorded(rng, white=1.0, floor=0.0)
    a, b = windows[7]
    readings[a:b] += 50.0 * np.linspace(-1.0, 1.0, b - a)[:, None]
    found = instability_at_rest(readings, windows, DT)
    assert found.value == 0.0
    assert found.bound < 0.33


def test_windows_of_a_few_samples_tell_nothing():
    assert instability_at_rest(np.ones((20, 3)), np.array([[0, 10], [10, 20]]), DT) == InstabilityAtRest()


def test_stated_instability_has_precedence_and_an_estimated_one_is_named():
    recording = Case("industrial-mems", 31).recording
    windows = np.array([recording.window_indices(*s.end_static_s).indices(10**9)[:2] for s in recording.sequences])
    assert noise_model(recording, windows).accel_flicker == pytest.approx(50.0 * MICRO_G)
    found = noise_model(replace(recording, noise=srt.ImuNoise()), windows)
    assert {"accel_bias_instability", "gyro_bias_instability"} <= set(found.estimated)
    np.testing.assert_array_less(50.0 * MICRO_G, found.accel_limit)
    assert np.hypot(found.accel_flicker, found.accel_unseen) == pytest.approx(50.0 * MICRO_G, rel=0.5)


def test_without_stated_noise_the_weights_have_what_the_windows_show_and_the_bound_is_apart():
    """5 µg/√Hz with 1 µg of instability: not shown by 10 s, not excluded either."""
    recording = Case("navigation-rlg", 31).recording
    windows = np.array([recording.window_indices(*s.end_static_s).indices(10**9)[:2] for s in recording.sequences])
    found = noise_model(replace(recording, noise=srt.ImuNoise()), windows)
    np.testing.assert_array_equal(found.accel_flicker, 0.0)
    assert np.all((found.accel_unseen > 0.0) & (found.accel_limit > found.accel_unseen))
    assert 0.0 < found.accel_spectra[1] <= found.accel_unseen[0] ** 2
    shown = found.with_accel_instability(2.0 * MICRO_G)
    np.testing.assert_array_equal([shown.accel_flicker, shown.accel_limit], 2.0 * MICRO_G)
    np.testing.assert_array_equal(shown.accel_unseen, 0.0)
    stated = noise_model(recording, windows)
    np.testing.assert_array_equal(stated.accel_limit, stated.accel_flicker)


@pytest.mark.slow
def test_sigma_of_the_instability_is_that_of_medians():
    """Medians of 35 windows with 20 squares an octave: the squares of 800 estimates scatter as their 1-sigma says.

    Two-sided chi-square, 3.5 standard errors (p = 5e-4). The 1-sigma of means would be smaller by √(π/2).
    """
    rng, n, squares, windows, units = np.random.default_rng(20), 1000, 20, 35, 800
    f_dt = np.array([1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 901]) / (2.0 * n)
    white, pulses = np.full_like(f_dt, 1.0 / DT), 4.0 * np.sin(math.pi * f_dt) ** 2 / DT**2
    fast = 1.0 / (1.0 + (2.0 * math.pi * f_dt / DT * CORRELATION_TIMES_S[0]) ** 2)
    design = np.stack([white, pulses, fast, 1.0 / (4.0 * math.log(2.0) * f_dt)], axis=1)
    expected = design @ [1.0, 4e-6, 0.5, 0.5]
    found = []
    for _ in range(units):
        power = rng.chisquare(squares, (windows, len(f_dt), 3)) / chi2.median(squares) * expected[:, None]
        found.append(_fitted(np.median(power, axis=0), design, np.full(len(f_dt), windows * squares), filtered=False))
    ratio = np.var([one.square for one in found], ddof=1) / np.mean([one.doubt**2 for one in found])
    low, high = chi2.ppf([2.5e-4, 1.0 - 2.5e-4], units - 1) / (units - 1)
    assert low < ratio < high
