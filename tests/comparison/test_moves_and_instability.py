"""Estimators with different models of one bias instability do not disagree by these models."""

import pytest

import srt
from sims.scenarios.scenario import scenario_from_dict
from sims.scenarios.simulation import simulate


@pytest.mark.parametrize("seed", [300, 301])
def test_recorded_moves_with_bias_instability_raise_no_disagreement(seed):
    """The closed form has the covariance of the instability over the windows, the others have Markov states."""
    pytest.importorskip("gtsam")
    scenario = scenario_from_dict(
        {
            "seed": seed,
            "imu": {"from": "tactical-fog"},
            "fixture": {"from": "lab-1mrad"},
            "site": {"from": "latitude-45"},
            "schedule": {"dwell_s": 5.0, "rate_rad_s": 2.0, "acceleration_rad_s2": 20.0, "moves": "recorded"},
            "recording": {"sample_rate_hz": 50.0},
        }
    )
    compared = srt.compare(simulate(scenario).recording, ("closed-form", "least-squares", "graph"))
    assert compared.agree, compared.verdict
