"""Drift of the biases during a test: its search, steps of it, and the scatter of the rates at rest."""

from dataclasses import replace

import numpy as np
import pytest
from accuracy_trials import noisy_recording
from foreign_motion import GRADES, drawn_errors, hand_turns, recording
from scipy.integrate import quad
from scipy.stats import kstest
from worse_units import calibrated, unit

import srt
from srt.constants import STANDARD_GRAVITY_M_S2
from srt.estimation.rest_rate_scatter import excess_variance
from srt.noise.bias_steps import LEAST_WINDOWS, step_shapes, within_span
from srt.noise.drift_forms import (
    FALSE_ALARM,
    WALK,
    DriftShapes,
    Intervals,
    Statistics,
    drift_test,
    form_or_scatter,
    residual_statistics,
    variance_component,
    walk_between_windows,
)
from srt.noise.variance_components import RestrictedLikelihood
from srt.sensor_errors import NAMES

MG = 1e-3 * STANDARD_GRAVITY_M_S2
START, END = np.array([0.0, 20.0, 60.0, 10.0, 40.0]), np.array([10.0, 30.0, 100.0, 20.0, 60.0])


def intervals_of(start, end, windows, parts):
    """Windows and parts, with the halves of the windows."""
    middle = 0.5 * (start + end)[:windows]
    halves = np.stack([start[:windows], middle, middle, end[:windows]], axis=1).reshape(-1, 2)
    return Intervals(np.append(start, halves[:, 0]), np.append(end, halves[:, 1]), windows, parts, None)


def test_shapes_are_means_over_the_intervals():
    """Against means of fine samples; each form has a mean of zero over the windows and, but for the walk, range one."""
    intervals = intervals_of(START, END, 3, (1, 2))
    t = np.linspace(0.0, 1.0, 200_001)
    functions = {"linear": t[:, None]}
    for name, rate in {"warm-up": 6.0, "fast warm-up": 12.0, "slow warm-up": 2.5}.items():
        functions[name] = np.stack([np.exp(-rate * t), rate * t * np.exp(-rate * t)], axis=1)
    shapes = DriftShapes(intervals)
    assert set(shapes) == {*functions, WALK}
    for shape in shapes.values():
        np.testing.assert_allclose(shape.halves.mean(axis=1), shape.windows, atol=1e-12)
    for name, values in functions.items():
        at = [(t >= a / 100.0) & (t <= b / 100.0) for a, b in zip(START, END, strict=True)]
        means = np.array([values[mask].mean(axis=0) for mask in at])
        means = means - np.array([10.0, 10.0, 40.0]) @ means[:3] / 60.0
        means = means / np.ptp(means[:3], axis=0)
        np.testing.assert_allclose(shapes[name].windows, means[:3], atol=2e-4)
        np.testing.assert_allclose(shapes[name].parts[0], means[3:], atol=2e-4)


def test_random_walk_has_its_covariance():
    """Sampled Wiener processes of unit variance at the end, about their mean over the windows, within 4.5 sigma."""
    intervals, n = intervals_of(START, END, 3, (1, 2)), 5_000
    shape = DriftShapes(intervals)[WALK]
    between = walk_between_windows(intervals, shape)
    rng = np.random.default_rng(20261127)
    steps = np.cumsum(rng.normal(0.0, np.sqrt(1.0 / 1000.0), (n, 1000)), axis=1)
    edges = np.array([START, END]).astype(int) * 10
    means = np.array([steps[:, a:b].mean(axis=1) for a, b in edges.T])
    means = means - np.array([10.0, 10.0, 40.0]) @ means[:3] / 60.0
    courses = np.concatenate([shape.windows, shape.parts[0]])
    rest = np.zeros((5, 2))
    rest[3:] = between[0]
    expected = courses @ courses.T + rest @ rest.T
    found = means @ means.T / n
    # Products of normal values have this variance; sums of steps stand for means over 0.1 s, 1e-3 of the recording.
    error = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / n)
    assert np.all(np.abs(found - expected) <= 4.5 * error + 2e-3)
    # Without the mean, three components have 83 % of the variance of many windows.
    even = np.linspace(0.0, 100.0, 201)
    many = DriftShapes(intervals_of(even[:-1], even[1:], 200, (0, 1)))[WALK]
    assert np.sum(many.tested.windows**2) / np.sum(many.windows**2) == pytest.approx(0.83, abs=0.01)


@pytest.mark.parametrize("form", [WALK, "linear"])
@pytest.mark.parametrize("count", [24, pytest.param(60, marks=pytest.mark.campaign)])
def test_a_form_is_told_from_independent_errors_of_the_windows(form, count):
    """p-values below 10 % in at most 10 % of the samples without the form, and below 1e-6 in most with it."""
    rng = np.random.default_rng(20261128)
    W, scatter, walk = 15, 3.0, form == WALK
    even = np.linspace(0.0, 300.0, W + 1)
    course = DriftShapes(intervals_of(even[:-1], even[1:], W, (0, 1)))[form].windows

    def p_value(size):
        errors = scatter * rng.standard_normal((W, 3)) + size * course @ rng.standard_normal((course.shape[1], 3))
        z = (errors.ravel() + rng.standard_normal(3 * W)) / np.hypot(1.0, scatter)
        (found,) = residual_statistics(z, np.tile(np.eye(3), (W, 1)), np.eye(3 * W) / np.hypot(1.0, scatter))
        return form_or_scatter(found, course, scatter, walk=walk)

    none, drifting = (np.array([p_value(size) for _ in range(n)]) for size, n in ((0.0, count), (60.0, 10)))
    assert np.mean(none < 0.1) <= 0.1 + 3.5 * np.sqrt(0.09 / len(none))
    assert np.mean(drifting < 1e-6) >= 0.8


@pytest.mark.slow
def test_p_values_are_uniform_without_drift():
    """Of each candidate; the larger of two p-values is at least as large as a uniform one."""
    rng = np.random.default_rng(20261123)
    H, Z = rng.standard_normal((40, 10)), rng.standard_normal((40, 3))
    for scale in (1.0, 5.0):  # the F-test does not depend on the scale of the noise
        found = [drift_test(*residual_statistics(scale * rng.standard_normal(40), H, Z)).p_value for _ in range(2000)]
        assert kstest(found, "uniform", alternative="greater").pvalue > 1e-3
    # At the stated noise the two tests nearly agree, so that little power is lost.
    found = [drift_test(*residual_statistics(rng.standard_normal(40), H, Z)).p_value for _ in range(2000)]
    assert np.mean(np.array(found) < 0.05) > 0.02


def test_sigma_of_a_random_walk_is_its_restricted_likelihood():
    """Against scoring of the dense covariance, and on average the sigma that was drawn."""
    rng = np.random.default_rng(20261124)
    H, Z = rng.standard_normal((60, 8)), rng.standard_normal((60, 12))
    variances = []
    for _ in range(50):
        z = rng.standard_normal(60) + Z @ rng.normal(0.0, 3.0, 12)
        variances.append(variance_component(*residual_statistics(z, H, Z)).sigma ** 2)
        (expected,) = RestrictedLikelihood(z, H, np.eye(60), (Z,)).variances()
        assert variances[-1] == pytest.approx(expected, rel=2e-2)
    # A variance from 12 coefficients has a relative standard error of √(2 / 12) at least.
    assert np.mean(variances) == pytest.approx(9.0, rel=3.5 * 1.1 * np.sqrt(2.0 / 12.0 / 50.0))


@pytest.mark.parametrize("coefficients", [1, 2, 30])
def test_a_variance_component_is_the_most_likely_of_all_variances(coefficients):
    """Coefficients that are known to very different accuracy, some zero and some large, have several maxima."""
    rng = np.random.default_rng(20261126)
    for _ in range(40):
        Z = rng.standard_normal((coefficients + 20, coefficients)) * 10.0 ** rng.uniform(-3.0, 3.0, coefficients)
        r = rng.standard_normal(len(Z)) + Z @ (rng.standard_normal(coefficients) * 10.0 ** rng.uniform(-3.0, 3.0))
        found = Statistics(Z.T @ r, Z.T @ Z, float(r @ r), 20)
        variances = np.exp(np.linspace(-9.2, 27.6, 20_000)) / found.eigen[0].max()
        most = max(float(found.likelihood_ratio(variances).max()), 0.0)
        assert variance_component(found).ratio == pytest.approx(most, rel=1e-4, abs=1e-3)


def test_a_variance_component_of_zero_is_rarely_significant():
    """At most 5 % of p-values below 5 %, and most of a component twice as large as its noise are below it."""
    rng = np.random.default_rng(20261125)
    H, Z = rng.standard_normal((60, 8)), rng.standard_normal((60, 12)) / np.sqrt(52.0)
    p = np.empty((2, 200))
    for i, size in enumerate((0.0, 2.0)):
        for k in range(200):
            z = rng.standard_normal(60) + size * Z @ rng.standard_normal(12)
            p[i, k] = variance_component(*residual_statistics(z, H, Z)).p_value
    assert np.mean(p[0] < 0.05) < 0.05 + 3.5 * np.sqrt(0.05 * 0.95 / 200.0)
    assert np.mean(p[1] < 0.05) > 0.9


@pytest.mark.parametrize(("estimator", "first"), [("least-squares", 100), ("ekf", 200)])
@pytest.mark.parametrize("units", [3, pytest.param(30, marks=pytest.mark.campaign)])
def test_recordings_without_drift_are_not_changed(estimator, first, units):
    """Units with bias instability as stated: by design at most one of 50,000 selects a drift."""
    pytest.importorskip("filterpy" if estimator == "ekf" else "numpy")
    assert FALSE_ALARM == 2e-5
    for seed in range(units):
        grade = ("navigation", "tactical", "industrial")[seed % 3]
        unit, _ = noisy_recording(first + seed, grade, sample_rate_hz=20.0, instability=True)
        assert srt.calibrate(unit, estimator, checks=False).diagnostics.drift is None


@pytest.mark.slow
def test_warm_up_and_temperature_are_told_apart():
    """A drift with temperature, which rises and falls, is no function of time that the other forms have."""
    grade, rng = GRADES["industrial"], np.random.default_rng(3)
    errors = drawn_errors(grade, rng)
    still = recording(hand_turns(rng, longest_s=8.0, count=24), 5.0, errors, grade, rng, profile="raised-cosine")
    share = still.time / still.time[-1]
    temperature = 25.0 + 5.0 * np.sin(2.0 * np.pi * 1.3 * share)
    warm = still.accel + (temperature[:, None] - 25.0) * np.array([1.0, 0.5, -1.0]) * MG
    found = srt.calibrate(replace(still, accel=warm, temperature=temperature), "least-squares", checks=False)
    assert found.diagnostics.drift[0].form == "temperature"
    course = np.exp(-share * 12.0)[:, None] * np.array([3.0, -4.0, 2.0]) * MG
    found = srt.calibrate(replace(still, accel=still.accel + course), "least-squares", checks=False)
    assert found.diagnostics.drift[0].form == "fast warm-up"


def error_over_sigma(found, errors):
    truth = np.array([errors.get(name, 0.0) for name in NAMES])
    return np.abs((found.errors.vector - truth)[found.observed] / found.sigma[found.observed])


@pytest.mark.parametrize(
    ("case", "seed", "named"),
    [
        ("fixture, accelerometer step of 0.4 mg", 0, {("accel", "step at 123.5 s")}),
        pytest.param("fixture, gyro step of 30 °/h", 0, {("gyro", "step at 123.5 s")}, marks=pytest.mark.slow),
        pytest.param("hand, accelerometer step of 0.4 mg", 0, {("accel", "step at 55.1 s")}, marks=pytest.mark.slow),
        ("hand, gyro step of 30 °/h", 0, {("gyro", "step at 55.1 s")}),
        *(
            pytest.param(
                "hand, 500 s, linear, 8 mg and 570 °/h", seed, {("accel", "linear"), ("gyro", "linear")}, marks=mark
            )
            for seed, mark in enumerate((pytest.mark.slow, pytest.mark.campaign))
        ),
        ("navigation on a fixture, warm-up of 1 mg", 1, {("accel", "warm-up")}),
    ],
)
def test_drift_is_named_and_nothing_else_accused(case, seed, named):
    """Sound, moves and windows kept. The largest of 27 normalised errors exceeds 4.2 with a probability of 7e-4."""
    found, (_, errors) = calibrated(case, seed, "least-squares"), unit(case, seed)
    assert {(row.sensor, row.form) for row in found.diagnostics.drift} == named
    assert found.judgement.word == "sound"
    assert not found.provenance.voided
    assert not any("moved in the stationary windows" in warning for warning in found.warnings)
    assert error_over_sigma(found, errors).max() < 4.2


def intervals_of_windows(W):
    """Windows of 10 s, a rotation of two parts of 5 s after each."""
    start = 20.0 * np.arange(W)
    parts = (start[:-1, None] + [[10.0, 15.0]]).ravel()
    halves = (start[:, None] + [[0.0, 5.0]]).ravel()
    starts = np.concatenate([start, parts, halves])
    ends = starts + np.repeat([10.0, 5.0, 5.0], [W, 2 * (W - 1), 2 * W])
    return Intervals(starts, ends, W, (W - 1, 2), None)


def test_shapes_of_steps_are_means_of_steps():
    """Some coefficients give a sampled step in a rotation, and in the first and the second half of a window."""
    W = 12
    intervals = intervals_of_windows(W)
    shapes = step_shapes(intervals)
    assert len(shapes) == W - 2 * LEAST_WINDOWS + 1 + 2 * (W - 2 * LEAST_WINDOWS)
    for at, name in ((111.0, "step at 115.0 s"), (121.5, "step at 122.5 s"), (128.0, "step at 127.5 s")):
        mean = np.clip((intervals.end - at) / (intervals.end - intervals.start), 0.0, 1.0)
        mean = mean - mean[:W].mean()
        shape = shapes[name]
        rows = (shape.windows, shape.parts.reshape(-1, 2), shape.halves.reshape(-1, 2))
        # In a rotation the mean over its parts alone acts, up to the change of attitude between them.
        parts = mean[W : -2 * W].reshape(-1, 2)
        kept = np.abs(parts[:, 0] - parts[:, 1]) < 1e-12
        use = np.concatenate([np.ones(W, bool), np.repeat(kept, 2), np.ones(2 * W, bool)])
        found = np.linalg.lstsq(np.concatenate(rows)[use], mean[use], rcond=None)[0]
        assert np.abs(np.concatenate(rows)[use] @ found - mean[use]).max() < 1e-12
        assert found[0] == pytest.approx(1.0)
        assert shape.of("accel").windows.shape[1] == (1 if at == 111.0 else 2)
        assert within_span(np.outer(found, [1.0, 2.0, 0.0]).ravel()) <= 0.5 + 1e-12


NOISE = np.array([1.0, 2.0, 4.0])


def posterior_mean(shown, freedom):
    """Mean of σ² by quadrature: variances (3,) of normal numbers of variance σ² + NOISE, σ uniform."""

    def density(sigma):
        variance = sigma**2 + NOISE
        return np.exp(-0.5 * freedom * np.sum(np.log(variance / NOISE) + shown / variance - shown / NOISE))

    parts = [quad(lambda s, power=power: s**power * density(s), 0.0, np.inf, epsabs=0.0)[0] for power in (0, 2)]
    return parts[1] / parts[0]


@pytest.mark.parametrize("share", [0.2, 0.7, 1.0, 1.3])
def test_rates_that_noise_explains_leave_room_for_what_it_hides(share):
    """17 rest rates with this share of the variance of noise: the mean over all scatters, by quadrature.

    3 %: the sum leaves out scatters of less than a hundredth of its scale, which is up to three times the mean.
    """
    rates = np.random.default_rng(5).normal(size=(17, 3))
    rates *= np.sqrt(share * NOISE / np.var(rates, axis=0, ddof=1))
    np.testing.assert_array_equal(excess_variance(rates, NOISE), 0.0)
    expected = posterior_mean(share * NOISE, 16)
    np.testing.assert_allclose(excess_variance(rates, NOISE, NOISE), expected, rtol=0.03)
