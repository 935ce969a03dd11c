"""Units of a campaign that run through one motion, and results that need no comparison with the fixed point."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from small_campaign import TIMES, numbers, small_campaign

from sims.robustness import trial
from sims.robustness.run import run_campaign
from sims.robustness.trial import SAMPLED, UNIQUE_WITHIN, run_trial, score
from sims.scenarios.simulation import _kept_motion, simulate
from srt.closed_form.estimator import estimate_units
from srt.sensor_errors import GROUP_SLICES, SensorErrors


@pytest.fixture
def small(tmp_path):
    return partial(small_campaign, tmp_path)


def test_trials_share_a_motion(small, tmp_path):
    """Units through one motion differ in errors and noise; in any process and order, the numbers are the same."""
    campaign = small(trials="4\ntrials_per_motion = 3")
    assert list(campaign.tasks) == [(p, k) for ks in ((0, 1, 2), (3,)) for p in (0, 1) for k in ks]
    runs = [simulate(campaign.unit(*task)[0]) for task in ((0, 0), (0, 2), (1, 1), (0, 3))]
    assert [run.motion is runs[0].motion for run in runs] == [True, True, True, False]
    assert not np.array_equal(runs[0].truth.vector, runs[1].truth.vector)
    assert not np.array_equal(runs[0].fixture_draw.starts, runs[3].fixture_draw.starts)
    table = {(row["point"], row["replicate"]): row for row in numbers(run_campaign(campaign, tmp_path / "one"))}
    _kept_motion.cache_clear()  # as in another process, and in another order
    for task in reversed(list(campaign.tasks)):
        (row,) = run_trial(campaign, task)
        assert {name: row.get(name) for name in table[task]} == table[task]
    assert campaign.digest != small(trials=4).digest


def test_a_motion_belongs_to_its_settings(small):
    """A seed of the motion does not make one of two schedules, sample rates or fixtures."""
    scenario = small(trials="2\ntrials_per_motion = 2").unit(0, 0)[0]
    first = simulate(scenario)
    again = simulate(scenario.model_copy(update={"seed": scenario.seed + 1}))
    assert again.motion is first.motion
    with pytest.raises(ValueError, match="read-only"):
        again.motion.velocity[0] = 0.0
    for change in (
        {"schedule": scenario.schedule.model_copy(update={"dwell_s": 2.5})},
        {"recording": scenario.recording.model_copy(update={"sample_rate_hz": 40.0})},
        {"fixture": scenario.fixture.model_copy(update={"rotation_sigma_mrad": 3.0})},
        {"motion_seed": scenario.motion_seed + 1},
    ):
        assert simulate(scenario.model_copy(update=change)).motion is not first.motion


def test_the_fixed_point_is_computed_where_the_result_may_be_another(small, monkeypatch):
    """Without it, the row is the same but for the distance; a result farther from the truth than 1e-3 is compared."""
    campaign = small()
    (choice,) = campaign.estimators
    for point in (0, 1):
        simulation = simulate(campaign.unit(point, 0)[0])
        full, short = (score(simulation, choice, fixed_point=True, sampled=sampled) for sampled in (True, False))
        assert full["distance"] < 1.0
        assert short["distance"] is None
        assert {name: full[name] for name in full if name not in (*TIMES, "distance")} == {
            name: value for name, value in short.items() if name not in (*TIMES, "distance")
        }
    found = [run_trial(campaign, (0, SAMPLED + k))[0]["distance"] for k in (0, 1)]
    assert [distance is None for distance in found] == [False, True]

    def wrong(recordings, options):
        (found,) = estimate_units(recordings, options)
        vector = found.errors.vector.copy()
        vector[GROUP_SLICES["accel_bias"].start] += 1.1 * UNIQUE_WITHIN * 9.80665 * (options[0].start == "auto")
        return [replace(found, errors=SensorErrors(vector))]

    monkeypatch.setattr(trial, "estimate_units", wrong)
    (row,) = run_trial(campaign, (0, SAMPLED + 1))
    assert row["outcome"] == "wrong_minimum"
