"""Noise estimated from the windows, its floors, and noise components estimated from residuals."""

import accuracy_trials
import numpy as np
import pytest
from scipy.special import chdtri

import srt
from srt.noise.noise_model import ACCEL_FLOOR, GYRO_FLOOR, flicker_spread, noise_model
from srt.noise.random_walk import _PIECE, _fit_one, allan_octaves
from srt.noise.variance_components import RestrictedLikelihood

N, RATE = 2000, 200.0
WINDOWS = np.array([[k * N, (k + 1) * N] for k in range(34)])


INSTABILITY = ("accel_bias_instability", "gyro_bias_instability")


def recording(gyro, accel, **noise):
    time = np.arange(1, len(gyro) + 1) / RATE
    return srt.Recording(time, gyro, accel, accuracy_trials.SITE, noise=srt.ImuNoise(**noise))


def still(rng, white, pulse=0.0, drift=3.3e-5):
    """Readings of a unit at rest: random walk of the integral, counted in pulses."""
    n = WINDOWS[-1, 1]
    increments = (drift * np.array([1.0, -0.7, 0.4]) + rng.standard_normal((n, 3)) * white * np.sqrt(RATE)) / RATE
    if pulse:
        increments = np.diff(np.floor(np.cumsum(increments, axis=0) / pulse) * pulse, axis=0, prepend=0.0)
    return increments * RATE


def test_pulses_are_told_from_random_walk():
    """0.5″ pulses and 0.002 °/√h at 200 Hz: single samples scatter by pulses alone, 25 times the random walk."""
    rng = np.random.default_rng(2)
    white, pulse = 0.002 * np.pi / 180.0 / 60.0, 0.5 * np.pi / 180.0 / 3600.0
    found = noise_model(recording(still(rng, white, pulse), still(rng, 2e-3)), WINDOWS)
    # Three pooled axes, 34 windows, octaves of 2.5 and 5 s: some 300 differences, √(3/300) of the variance, quantised.
    np.testing.assert_allclose(found.gyro_white, white, rtol=3.5 * 0.5 * 0.1)
    np.testing.assert_allclose(found.gyro_edge, pulse / np.sqrt(12.0), rtol=0.5)


def test_stated_noise_is_believed():
    rng = np.random.default_rng(3)
    found = noise_model(
        recording(still(rng, 1e-4), still(rng, 2e-3), gyro_noise=3e-4, accel_quantization=1e-3), WINDOWS
    )
    np.testing.assert_array_equal(found.gyro_white, 3e-4)
    np.testing.assert_allclose(found.accel_edge, 1e-3 / np.sqrt(12.0))
    assert found.estimated == ("gyro_quantization", "accel_noise", *INSTABILITY)


def test_floors():
    n = WINDOWS[-1, 1]
    constant = np.full((n, 3), 1e-5)
    found = noise_model(recording(constant, np.tile([0.0, 0.0, -9.8], (n, 1))), WINDOWS)
    np.testing.assert_array_equal(found.gyro_white, GYRO_FLOOR)
    np.testing.assert_array_equal(found.accel_white, ACCEL_FLOOR)
    assert found.floored == ("gyro_noise", "accel_noise")


def test_resolution_is_a_floor():
    """A coarse unit that reads the same count at rest is not noise-free: its steps show in the motion."""
    n = WINDOWS[-1, 1]
    step = 1e-2
    gyro = np.tile([0.0, step, -step], (n + N, 1))
    gyro[n:] += step * np.round(50.0 * np.sin(np.arange(N) / 100.0))[:, None]
    accel = np.tile([0.0, 0.0, -9.8], (n + N, 1))
    found = noise_model(recording(gyro, accel), WINDOWS)
    np.testing.assert_allclose(found.gyro_white, step / np.sqrt(12.0) / np.sqrt(RATE))


def test_flicker_spread_against_simulated_flicker():
    """Window means of flicker noise with Allan floor 1 scatter by the spread."""
    rng = np.random.default_rng(6)
    n, trials, window = 1 << 14, 200, 1 << 9
    f = np.fft.rfftfreq(n, 1.0)
    S = 1.0 / (4.0 * np.log(2.0) * np.maximum(f, f[1]))  # two-sided
    amplitude = np.sqrt(S * n / 2.0)
    means = []
    for _ in range(trials):
        spectrum = amplitude * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
        spectrum[0] = 0.0
        means.append(np.fft.irfft(spectrum, n).reshape(-1, window).mean(axis=1))
    windows = np.arange(0, n, window)[:, None] + np.array([0, window])
    # The formula cuts the spectrum sharply at 1/T_w, an average does so gradually: within a fifth.
    assert np.std(means) == pytest.approx(flicker_spread(windows), rel=0.2)


@pytest.mark.slow
def test_restricted_likelihood_recovers_components():
    """Mean over 200 draws within 3.5 standard errors of the truth, and 10 % for the bias of clipping at zero."""
    rng = np.random.default_rng(9)
    n, p = 120, 25
    H = rng.standard_normal((n, p))
    R0 = np.diag(rng.uniform(0.5, 1.5, n))
    turn, pose = np.diag(np.r_[np.ones(80), np.zeros(40)]), np.diag(np.r_[np.zeros(80), np.ones(40)])
    L = np.linalg.cholesky(R0 + 9.0 * turn + 4.0 * pose)
    W = np.linalg.inv(R0)
    residual = np.eye(n) - H @ np.linalg.solve(H.T @ W @ H, H.T @ W)
    draws = (residual @ L @ rng.standard_normal(n) for _ in range(200))
    found = np.array([RestrictedLikelihood(z, H, R0, (turn, pose)).variances() for z in draws])
    error = 3.5 * found.std(axis=0) / np.sqrt(200)
    np.testing.assert_allclose(found.mean(axis=0), [9.0, 4.0], atol=0.0, rtol=0.1 + (error / [9.0, 4.0]).max())


@pytest.mark.parametrize("columns", [(6, 4), (60, 40)])
def test_variances_are_those_of_the_largest_restricted_likelihood(columns):
    """Components that few contrasts show, and more columns than contrasts; against the likelihood as it is defined."""
    rng = np.random.default_rng(12)
    H, R0 = rng.standard_normal((50, 8)), np.diag(rng.uniform(0.5, 2.0, 50))
    roots = tuple(rng.standard_normal((50, n)) / np.sqrt(n) for n in columns)
    z = rng.standard_normal(50) + sum(3.0 * L @ rng.standard_normal(L.shape[1]) for L in roots)

    def likelihood(variances):
        R = R0 + sum(v * L @ L.T for v, L in zip(variances, roots, strict=True))
        information = H.T @ np.linalg.solve(R, H)
        white = np.linalg.solve(R, z - H @ np.linalg.solve(information, H.T @ np.linalg.solve(R, z)))
        return -0.5 * (np.linalg.slogdet(R)[1] + np.linalg.slogdet(information)[1] + z @ white)

    asked = RestrictedLikelihood(z, H, R0, roots)
    found = asked.variances()
    assert np.all(found > 0.0)
    # The steps end at a thousandth, which changes the logarithm by its square.
    step = 0.03
    for i in range(2):
        aside = [found * (1.0 + step * sign * np.eye(2)[i]) for sign in (-1.0, 1.0)]
        assert likelihood(found) > max(likelihood(other) for other in aside)
        for other in aside:
            expected = likelihood(found) - likelihood(other)
            assert asked.logarithm(found) - asked.logarithm(other) == pytest.approx(expected, rel=1e-6)


def test_restricted_likelihood_finds_nothing_in_nothing():
    rng = np.random.default_rng(10)
    H, R0 = rng.standard_normal((60, 10)), np.eye(60)
    assert np.all(RestrictedLikelihood(np.zeros(60), H, R0, (np.eye(60),)).variances() == 0.0)


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_pulses_alone_leave_no_white_noise_and_all_doubt(size):
    """The result does not depend on the units: readings of a million times full scale must not overflow."""
    tau = np.array([0.02, 0.04, 0.08, 0.16])
    # Falls faster than even pulses do, so that nothing is left for white noise.
    (white, pulses), doubt, _ = _fit_one(tau, np.array([1000.0, 500.0, 250.0, 125.0]), size / tau**3)
    assert white == 0.0
    assert pulses > 0.0
    assert 1.0 < doubt < np.inf


def test_a_variance_of_few_differences_does_not_lead_the_fit():
    """White noise with quantization of a tenth, from 46,000 samples; the last octaves have four and two differences.

    From m differences a variance has two thirds of m degrees of freedom. N can be known to 0.9 %.
    """
    rng = np.random.default_rng(11)
    count = np.array([23000, 11500, 5750, 2870, 1430, 710, 350, 165, 73, 27, 4, 2], dtype=float)
    tau = 0.01 * 2.0 ** np.arange(len(count))
    expected = 1.0 / tau + 3.0 * 0.01**2 / tau**2
    found = np.array(
        [_fit_one(tau, count, expected * rng.gamma(count / 3.0, 3.0 / count)).squares[0] ** 0.5 for _ in range(400)]
    )
    design = np.stack([1.0 / tau, 3.0 / tau**2], axis=1) / (expected * np.sqrt(3.0 / count))[:, None]
    bound = 0.5 * np.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    assert np.sqrt(np.mean((found - 1.0) ** 2)) < bound * (1.0 + 3.5 / np.sqrt(2.0 * len(found)))


def test_octaves_of_pieces_are_those_of_the_definition():
    """Differences of adjoining averages of 2^k samples, from each window's start, in windows of any length."""
    rng = np.random.default_rng(11)
    lengths = np.array([5, 2 * _PIECE + 4711, 700, 700, _PIECE, 1])
    ends = np.cumsum(lengths)
    windows = np.stack([ends - lengths, ends], axis=1)
    n = int(ends[-1])
    gyro, accel = rng.standard_normal((2, n, 3))
    log = srt.Recording(np.arange(1, n + 1) / RATE, gyro, accel, accuracy_trials.SITE)
    found = allan_octaves([log], [windows])[0]
    both = np.concatenate([gyro, accel], axis=1)
    assert len(found.tau) == int(np.log2(lengths.max()))
    for k, m in enumerate(2 ** np.arange(len(found.tau))):
        whole = [both[a:b][: (b - a) // (2 * m) * 2 * m].reshape(-1, 2, m, 6) for a, b in windows]
        steps = np.concatenate([np.diff(w.mean(axis=2), axis=1)[:, 0] for w in whole])
        assert (found.tau[k], found.differences[k]) == (pytest.approx(m / RATE), len(steps))
        # Rounding: pairwise averages of k octaves.
        np.testing.assert_allclose(found.variance[:, k], 0.5 * (steps**2).mean(axis=0), rtol=1e-13)


def test_equal_long_averages_leave_finite_figures():
    """Readings that hardly change: short averages differ, long ones are equal."""
    tau, count = np.array([0.01, 0.02, 0.04, 0.08, 0.16]), np.array([400.0, 200.0, 100.0, 50.0, 25.0])
    with np.errstate(all="raise"):
        fit = _fit_one(tau, count, np.array([1e-20, 1e-21, 0.0, 0.0, 0.0]), first=2, drifting=True)
    assert np.all(fit.squares == 0.0)
    assert np.isfinite([fit.doubt, fit.deviance]).all()


@pytest.mark.parametrize("noise_steps", [0.01, 0.2, 1.0 / 3.0])
def test_means_of_readings_that_noise_does_not_dither_have_an_error_of_their_own(noise_steps):
    """Windows whose rates are several steps apart: chi-square of the errors of 600 means less their expected error.

    Two-sided, p = 1e-3, as for normal numbers: the errors of rounding have shorter tails. Stated noise gets the
    variance of the rounding.
    """
    rng, windows, n, step = np.random.default_rng(21), 200, 400, 1e-3
    true = step * (3.0 * np.arange(windows)[:, None] + rng.uniform(0.0, 1.0, (windows, 3)))
    readings = np.repeat(true, n, axis=0) + noise_steps * step * rng.standard_normal((windows * n, 3))
    readings, true = (np.round(readings / step) + 0.3) * step, true + 0.3 * step  # a grid off zero
    spans = n * np.arange(windows)[:, None] + np.array([0, n])
    white = noise_steps * step / np.sqrt(RATE)
    stated = {"gyro_noise": white, "gyro_quantization": 0.0, "accel_noise": white, "accel_quantization": 0.0}
    found = noise_model(recording(readings, readings, **stated), spans)
    assert found.undithered == tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
    np.testing.assert_array_equal(found.gyro_step, found.accel_step)
    np.testing.assert_allclose(found.gyro_white, np.sqrt(white**2 + step**2 / 12.0 / RATE), rtol=1e-9)
    error = readings.reshape(windows, n, 3).mean(axis=1) - found.gyro_rounding - true
    variance = found.gyro_step**2 + found.gyro_white**2 * RATE / n
    chi_square = float(np.sum(error**2 / variance))
    assert chdtri(600, 1.0 - 5e-4) < chi_square < chdtri(600, 5e-4)


def test_windows_that_all_mix_the_same_two_readings_do_not_show_their_noise():
    """One rate in all windows, noise of 0.05 to 0.3 of a step: the error of the mean of all is within 3.5 sigma.

    Between the least and the largest possible noise the prior is uniform, with 1.7 sigma at its ends.
    """
    rng, windows, n, step = np.random.default_rng(23), 40, 400, 1e-3
    spans = n * np.arange(windows)[:, None] + np.array([0, n])
    for _ in range(20):
        noise, true = rng.uniform(0.05, 0.3, 3), 0.5 + rng.uniform(-0.9, 0.9, 3) * 0.2
        readings = step * np.round(true + noise * rng.standard_normal((windows * n, 3)))
        # A turn tells the grid: at rest there are two levels only.
        readings = np.concatenate([readings, step * np.arange(-200.0, 200.0)[:, None] * np.ones(3)])
        found = noise_model(recording(readings, readings), spans)
        error = readings[: windows * n].mean(axis=0) - found.gyro_rounding.mean(axis=0) - step * true
        sigma = np.sqrt(found.gyro_step**2 / windows + (noise * step) ** 2 / (windows * n))
        assert np.all(np.abs(error) < 3.5 * sigma)


def test_dithered_readings_have_no_error_of_their_own():
    rng = np.random.default_rng(22)
    readings = np.round((still(rng, 1e-4) + 0.1) / 1e-3) * 1e-3  # 1.4 noise sigma
    found = noise_model(recording(readings, readings), WINDOWS)
    assert found.undithered == ()


@pytest.mark.slow
def test_a_component_without_effect_is_left_out_and_another_kept():
    """By chance, a component that is not there stays in one of a thousand; one of 3 sigma always does."""
    rng = np.random.default_rng(11)
    H, R0 = rng.standard_normal((80, 10)), np.eye(80)
    parts = np.diag(np.r_[np.ones(40), np.zeros(40)]), np.diag(np.r_[np.zeros(40), np.ones(40)])
    every, kept = np.ones(2, dtype=bool), []
    for _ in range(100):
        z = rng.standard_normal(80) * np.r_[np.full(40, 3.0), np.ones(40)]
        kept.append(RestrictedLikelihood(z, H, R0, parts).significant(every, every, 1e-3)[0])
    assert np.all(np.array(kept)[:, 0])
    assert np.sum(np.array(kept)[:, 1]) <= 2
    assert RestrictedLikelihood(z, H, R0, parts).significant(every, ~every, 1e-3)[0].all()
