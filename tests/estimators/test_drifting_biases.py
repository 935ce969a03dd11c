"""A part of the study of biases that drift within a recording: hand-turned units, by an independent generator."""

import pytest
from honesty import STUDIES
from scipy.stats import chi2

CASES = [
    ("ekf", "consumer", "warm-up", "4, 300"),
    # Long rests, in which such a drift turns the attitude by more than the noise, and few turns.
    ("least-squares", "industrial", "linear", "8, 570"),
    *(
        pytest.param(*case, marks=pytest.mark.campaign if n % 5 else pytest.mark.slow)
        for n, case in enumerate(
            (
                ("least-squares", "industrial", "warm-up", "8, 570"),
                ("least-squares", "industrial", "linear", "10, 1000"),
                ("least-squares", "consumer", "warm-up", "10, 1000"),
                ("least-squares", "consumer", "random walk", "0.1, 10"),
                ("ekf", "industrial", "linear", "10, 1000"),
                ("ekf", "consumer", "random walk", "4, 300"),
                ("graph", "industrial", "warm-up", "0.1, 10"),
                ("graph", "consumer", "linear", "4, 300"),
                ("graph", "consumer", "warm-up", "10, 1000"),
            )
        )
    ),
]
"""Estimator, grade, form and change of the drift in mg and °/h; one unit of each is a fortieth of the study."""


@pytest.mark.parametrize(("estimator", "grade", "form", "change"), CASES)
def test_drift_is_named_and_modelled(estimator, grade, form, change):
    """NEES below its band (1 % for the family); smooth drift of a milligram or more is named in both triads.

    Asked of smooth drift of 4 mg and 300 °/h: sigmas of accelerometer scale of at most 200 ppm.
    """
    pytest.importorskip("gtsam" if estimator == "graph" else "filterpy")
    found = STUDIES["hand-drift"].trial((grade, form, change), 100, [estimator])[estimator]
    assert found.status == "converged"
    assert found.nees < chi2.isf(0.01 / len(CASES), found.freedom)
    if change != "0.1, 10" and form != "random walk":
        assert found.drift == {"accel", "gyro"}
        assert found.scale_sigma < 200e-6 or change == "8, 570"
