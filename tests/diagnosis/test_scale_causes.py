"""Causes of scale errors, and which of two causes explains more."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis import scale_causes
from srt.diagnosis.cause_comparison import CLOSE, Cause, compare
from srt.diagnosis.faults import FAULTS
from srt.diagnosis.findings import with_runner_up
from srt.diagnosis.scale_causes import ScaleCause, scores
from srt.diagnosis.staged_diagnosis import Diagnosis
from srt.diagnosis.triad_fits import UNKNOWN, ScaleRatios
from srt.reports.text.inspection import runner_up_sentence
from srt.result.diagnostics import RunnerUp
from srt.result.document import to_document

SOUND = ScaleRatios(1.0, np.array([1.0, 1.0005, 0.9995]), 3e-4)
TRUE = EARTH_RATE_RAD_S * np.array([-1.0, 1.0]) / math.sqrt(2.0)
SIGMA = 0.02 * EARTH_RATE_RAD_S * np.ones(2)
CLOCK = ScaleCause(("sample_rate",), clock=0.0, unknown={"accel": -1.0}, prior=1e-2)
FACTOR = ScaleCause(("accel_factor",), unknown={"accel": 0.0}, prior=1e-3)


def score(cause, *measured):
    """Logarithm of the posterior probability of one cause."""
    return float(scores([cause], *measured)[0])


def with_mean(x, law, y):
    """Density of ratios y with an unknown mean x, whose own law is that of Cauchy."""
    return law.pdf(y - x) / (math.pi * 0.02 * (1.0 + (x / 0.02) ** 2))


def by_integration(ratios, common, *, unknown=False):
    """Log-likelihood of one triad, by the covariance of its errors and numerical integration over an unknown mean."""
    grid = np.geomspace(1e-4, 1.0, 25)
    weight = (1.0 + (grid / 0.02) ** 2) ** -2.0
    y, total = np.log(ratios.axes), 0.0
    for share, sigma in zip(weight / weight.sum(), grid, strict=True):
        V = (sigma**2 + ratios.axis_scatter**2 + 1e-8) * np.eye(3) + common**2 * np.ones((3, 3))
        if not unknown:
            total += share * multivariate_normal(np.zeros(3), V).pdf(y)
            continue
        reach = 12.0 * math.sqrt(V.sum() / 9.0)
        law = multivariate_normal(np.zeros(3), V)
        total += share * quad(with_mean, y.mean() - reach, y.mean() + reach, (law, y), points=[0.0], limit=200)[0]
    return math.log(total)


@pytest.mark.parametrize("unknown", [False, True])
def test_probability_of_a_triad(unknown):
    """Constants common to all causes are the same with and without an unknown mean: only differences count."""
    wrong = ScaleRatios(1.19, np.array([1.18, 1.19, 1.20]), 1e-3)
    cause = FACTOR if unknown else ScaleCause(prior=1e-3)
    reference = score(ScaleCause(accel=math.log(1.19), prior=1e-3), UNKNOWN, wrong, None)
    moved = ScaleRatios(1.0, wrong.axes / 1.19, 1e-3)
    expected = by_integration(wrong, 0.0035, unknown=unknown) - by_integration(moved, 0.0035)
    assert score(cause, UNKNOWN, wrong, None) - reference == pytest.approx(expected, abs=1e-6)


def test_likelihood_of_the_earth_rate():
    """Both components, off by a clock that is known with an error of its own, against the two-dimensional normal."""
    clock, doubt, found = 0.3, 0.01, math.exp(-0.3) * 1.02 * TRUE
    expected = math.exp(-clock) * TRUE
    V = np.diag(SIGMA**2) + doubt * np.outer(expected, expected)
    direct = multivariate_normal(expected, V).logpdf(found)
    term = scale_causes._earth_term(np.array(clock), np.array(doubt), found, SIGMA, TRUE)
    # The alternative of a wrong latitude adds little where the clock explains the rate.
    assert 0.0 < float(term) - direct < 0.01
    far = scale_causes._earth_term(np.array(clock), np.array(0.0), -TRUE, SIGMA, TRUE)
    assert float(far) == pytest.approx(math.log(5e-3 / (4.0 * math.pi * EARTH_RATE_RAD_S**2)), abs=1e-6)


@pytest.mark.parametrize("factor", [1.05, 1.19, 1.41])
def test_the_earth_rate_tells_a_clock_from_a_factor(factor):
    """Velocity increments off by one factor: the clock, if the Earth rate is off by it, too; else the count value."""
    accel = ScaleRatios(factor, factor * SOUND.axes, 1e-3)
    for earth, better, worse in ((TRUE, FACTOR, CLOCK), (TRUE * factor, CLOCK, FACTOR)):
        measured = earth, SIGMA, TRUE
        first, second = (score(cause, SOUND, accel, measured) for cause in (better, worse))
        assert first > second
    # Without it, the more frequent cause is the likelier one, by the ratio of the priors.
    apart = score(CLOCK, SOUND, accel, None) - score(FACTOR, SOUND, accel, None)
    assert apart == pytest.approx(math.log(10.0))


def test_equal_axes_tell_a_unit_from_a_near_clock():
    """Stamps in minutes make 1/60, degrees taken for radians 1/57.3: scale errors of 0.1 % tell them, of 5 % do not."""
    minutes = ScaleCause(("time_unit",), gyro=-math.log(60.0), clock=-math.log(60.0), prior=1e-3)
    degrees = ScaleCause(("gyro_radians",), gyro=-math.log(57.29578), prior=1e-2)

    def lead(errors):
        ratios = (1.0 + np.array(errors)) / 60.0
        gyro = ScaleRatios(float(np.median(ratios)), ratios, 3e-4)
        return score(minutes, gyro, SOUND, None) - score(degrees, gyro, SOUND, None)

    assert lead([1e-3, -1e-3, 5e-4]) > math.log(20.0)
    assert lead([0.05, 0.09, -0.02]) < 0.0


def test_two_causes_together():
    """Shifts and unknowns of both are those of the pair, and the probabilities multiply."""
    both = CLOCK & ScaleCause(("gyro_factor",), unknown={"gyro": 0.0}, prior=1e-3)
    assert both.faults == ("sample_rate", "gyro_factor")
    assert both.prior == pytest.approx(1e-5)
    assert set(both.unknown) == {"gyro", "accel"}
    gyro = ScaleRatios(1.19, 1.19 * SOUND.axes, 3e-4)
    accel = ScaleRatios(0.2, 0.2 * SOUND.axes, 1e-3)
    assert score(both, gyro, accel, None) > score(CLOCK, gyro, accel, None)


def test_weights_of_scale_errors():
    """Half of all units are within 2 %, by the weights of the standard deviations; tens of per cent are rare."""
    share = np.exp(scale_causes._LOG_WEIGHT)
    assert share.sum() == pytest.approx(1.0)
    within = float(share @ (1.0 - 2.0 * norm.sf(0.02 / scale_causes._GRID)))
    assert within > 0.5
    assert float(share[scale_causes._GRID > 0.2].sum()) < 0.01


def false_alarms(sigma, ratios, units=1000):
    """Number of sound units whose gyros look off by one factor; ``ratios`` gives the ratios of their three axes."""
    rng, causes = np.random.default_rng(41), (ScaleCause(), replace(CLOCK, unknown={"gyro": 1.0}, prior=5e-4))
    found = 0
    for errors in rng.normal(0.0, sigma, (units, 3)):
        gyro = ScaleRatios(1.0, ratios(errors), 3e-4)
        sound, clock = scores(causes, gyro, UNKNOWN, None)
        found += clock > sound
    return found


@pytest.mark.parametrize("sigma", [3e-4, 5e-3, 0.015])
def test_errors_of_a_sound_unit_are_no_sample_rate(sigma):
    """At most 5e-4 of the units, the prior probability of the fault: fewer than 5 of 1,000 with p = 1.7e-4 of more."""
    assert false_alarms(sigma, np.exp) < 5
    # The same units with a factor of 1.5 on all axes show it.
    assert false_alarms(sigma, lambda errors: 1.5 * np.exp(errors), 100) > 95


N = 12
ALL = Cause("sensor_time_offset", np.ones((N, 1)), {})
ONE = Cause("gyro_axis_delayed", np.repeat([[1.0], [0.0]], N // 2, axis=0), {}, choices=3)
NOTHING = Cause("", np.zeros((N, 0)), {})
TOLD = FAULTS["sensor_time_offset"].found(offset_ms=5.0)


def test_the_pattern_that_made_the_residuals_is_first_and_has_its_value():
    rng = np.random.default_rng(5)
    for true in (ALL, ONE):
        values = true.columns @ [3.0] + rng.standard_normal(N)
        best = compare(values, (NOTHING, ALL, ONE))[0]
        assert best.cause is true
        # t of 11 degrees of freedom: 1e-4 of all samples lie beyond 5.9 sigmas.
        assert abs(best.value[0] - 3.0) < 5.9 * best.sigma[0]


def test_a_parameter_that_explains_nothing_costs():
    values = np.tile([1.0, -1.0], N // 2)
    explained = compare(values, (ALL, NOTHING))
    assert explained[0].cause is NOTHING
    assert explained[0].score - explained[1].score == pytest.approx(0.5 * math.log(N))


def test_columns_of_the_nuisance_explain_nothing_twice():
    values = np.random.default_rng(6).standard_normal(N) + 100.0
    found = compare(values, (NOTHING, ALL), nuisance=np.ones((N, 1)))
    assert found[0].cause is NOTHING
    assert found[0].freedom == N - 1
    assert found[0].square == pytest.approx(np.sum((values - values.mean()) ** 2))


def test_a_close_runner_up_is_told_and_a_distant_one_is_not():
    values = 1e-3 * np.random.default_rng(7).standard_normal(N) + 1.0
    assert with_runner_up(TOLD, compare(values, (NOTHING, ALL, ONE))).runner_up is None
    alike = Cause("gyro_axis_delayed", ALL.columns, {}, choices=3)
    told = with_runner_up(TOLD, compare(values, (NOTHING, ALL, alike)))
    assert told.runner_up == RunnerUp("gyro_axis_delayed", pytest.approx(math.log(3.0)))
    assert math.log(3.0) < CLOSE
    assert "One gyro axis has another delay" in runner_up_sentence(told.runner_up)
    (fault,) = Diagnosis((told,)).faults
    assert to_document(fault)["runner_up"] == asdict(told.runner_up)


def test_a_cause_that_is_no_other_than_what_is_fitted_beside_it_explains_nothing():
    """A trend beside a fitted trend leaves a column of rounding errors, which had a coefficient of 1e11."""
    time = np.linspace(0.0, 1000.0, 37)
    values = np.random.default_rng(1).normal(size=time.size)
    beside = np.stack([np.ones_like(time), time], axis=1)
    causes = [Cause("trend", (3.0 * time + 1.0)[:, None], {}), Cause("", np.zeros((time.size, 0)), {})]
    none, trend = compare(values, causes, beside)
    assert trend.cause.fault == "trend"
    assert (trend.value[0], trend.square) == (0.0, none.square)
