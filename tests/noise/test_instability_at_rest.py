"""Bias instability from the stationary windows, on noise of known spectrum."""

import math
from dataclasses import replace

import numpy as np
import pytest
from injected_faults.injection import Case
from scipy.signal import lfilter
from scipy.stats import chi2

import srt
from srt.constants import MICRO_G
from srt.noise.bias_instability import CORRELATION_TIMES_S
from srt.noise.instability_at_rest import _fitted, instability_at_rest
from srt.noise.noise_model import noise_model

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
    assert all(one.shown for one in found)
    assert square.mean() == pytest.approx(1.0, abs=3.5 * sigma / math.sqrt(n))
    assert np.var(square, ddof=1) < sigma**2 * chi2.isf(2e-4, n - 1) / (n - 1)
    np.testing.assert_allclose(np.mean([one.white for one in found], axis=0), 1.0, rtol=0.05)


def test_white_noise_shows_none_and_bounds_it():
    """The bound of 34 windows of white noise is a third of the noise of 1 s at most: it hardly widens a sigma."""
    rng = np.random.default_rng(5)
    found = [instability_at_rest(*recorded(rng, white=1.0, floor=0.0, windows=34), DT) for _ in range(6)]
    assert not any(one.shown for one in found)
    assert all(0.0 < one.bound < 0.33 and one.value == 0.0 for one in found)


def test_one_window_with_motion_changes_little():
    rng = np.random.default_rng(6)
    readings, windows = recorded(rng, white=1.0, floor=0.0)
    a, b = windows[7]
    readings[a:b] += 50.0 * np.linspace(-1.0, 1.0, b - a)[:, None]
    found = instability_at_rest(readings, windows, DT)
    assert not found.shown
    assert found.bound < 0.33


def test_windows_of_a_few_samples_tell_nothing():
    assert instability_at_rest(np.ones((20, 3)), np.array([[0, 10], [10, 20]]), DT) is None


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
