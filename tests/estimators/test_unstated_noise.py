"""Sigmas and verdicts where no noise is stated, of units by a generator that shares nothing with the estimators."""

import math

import numpy as np
import pytest
from foreign_motion import GRADES
from honesty_trials import unstated_noise
from studies import pooled_nees
from worse_recordings import STATEMENTS

import srt
from sims.scenarios.scenario import load_scenario
from sims.scenarios.simulation import simulate

LOW, HIGH = 0.70, 1.15
"""Mean NEES per parameter that is asked for; the closed form, which has no weights, may have 0.60."""
UNITS = 2


@pytest.mark.parametrize("statement", STATEMENTS)
@pytest.mark.parametrize(
    ("kind", "estimator"),
    [("fixture", "closed-form"), ("fixture", "least-squares"), ("fixture", "graph"), ("hand", "least-squares")],
)
def test_sigmas_are_true_and_the_units_own_noise_is_sound(kind, estimator, statement):
    """Mean NEES over four grades: the bounds and 3.5 standard errors of a chi-square."""
    cells = [((kind, grade, statement), seed) for grade in GRADES for seed in range(UNITS)]
    found = [unstated_noise(*cell, [estimator])[estimator] for cell in cells]
    error = 3.5 * math.sqrt(2.0 / sum(score.freedom for score in found))
    lowest = 0.60 if estimator == "closed-form" else LOW
    assert lowest * (1.0 - error) <= pooled_nees(found) <= HIGH * (1.0 + error)
    assert {score.word for score in found} == {"sound"}


@pytest.mark.parametrize("seed", [3, 4])
def test_the_units_own_instability_is_no_fault_of_one_turn(seed):
    """One turn deviates most, by flicker noise: an instability is more likely than a fault of that turn alone."""
    (score,) = unstated_noise(("hand", "navigation", STATEMENTS[1]), seed, ["least-squares"]).values()
    assert score.word == "sound"


@pytest.mark.parametrize("estimator", ["least-squares", "ekf", "graph"])
def test_flicker_beside_g_sensitivity_is_the_units_own(estimator):
    """Consumer gyros turned by hand: their bias instability is no added noise where g-sensitivity is modelled."""
    simulated = simulate(load_scenario("free-mems"))
    found = srt.calibrate(simulated.recording, estimator)
    assert found.diagnostics.g_sensitivity is not None
    assert found.judgement.word == "sound"
    z = (found.errors.vector - simulated.truth.vector) / found.sigma
    P = found.covariance / np.outer(found.sigma, found.sigma)
    assert z @ np.linalg.solve(P, z) < 27.0 + 3.5 * math.sqrt(2.0 * 27.0)
