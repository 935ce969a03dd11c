"""A part of the study of biases that drift within a recording: hand-turned units, by an independent generator."""

from __future__ import annotations

import pytest
from hand_turns import DRIFTS, drifting_unit
from scipy.stats import chi2

CASES = [
    ("ekf", "consumer", "warm-up", "middle"),
    # Long rests, in which such a drift turns the attitude by more than the noise, and few turns.
    ("least-squares", "industrial", "linear", "array"),
    ("least-squares", "industrial", "warm-up", "array"),
    *(
        pytest.param(*case, marks=pytest.mark.slow)
        for case in (
            ("least-squares", "industrial", "linear", "large"),
            ("least-squares", "consumer", "warm-up", "large"),
            ("least-squares", "consumer", "random walk", "small"),
            ("ekf", "industrial", "linear", "large"),
            ("ekf", "consumer", "random walk", "middle"),
            ("graph", "industrial", "warm-up", "small"),
            ("graph", "consumer", "linear", "middle"),
            ("graph", "consumer", "warm-up", "large"),
        )
    ),
]
"""Estimator, grade, form and size of the drift; two units of each are a twentieth of the study."""


@pytest.mark.parametrize(("estimator", "grade", "form", "size"), CASES)
def test_drift_is_named_and_modelled(estimator, grade, form, size):
    """NEES below its band (1 % for the family); smooth drift of a milligram or more is named in both triads.

    Asked of smooth drift of 4 mg and 300 °/h: sigmas of accelerometer scale of at most 200 ppm.
    """
    pytest.importorskip("gtsam" if estimator == "graph" else "filterpy")
    for seed in range(2):
        status, nees, parameters, named, scale = drifting_unit(100 + seed, grade, form, size, estimator)
        assert status == "converged"
        assert nees < chi2.isf(0.01 / (2 * len(CASES)), parameters)
        if DRIFTS[size][0] >= 1.0 and form != "random walk":
            assert named == {"accel", "gyro"}
            assert scale < 200e-6 or size == "array"
