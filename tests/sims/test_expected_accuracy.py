"""Accuracy of a plan whose moves between the sequences are recorded: against the bound, and in the plan itself."""

import json

import numpy as np
import pytest

import sims
from sims.accuracy.bound import scenario_bound
from sims.accuracy.expected_accuracy import sigma_with_moves
from sims.scenarios.plan_file import load_plan_file
from srt.cli import main
from srt.planning.planner import table_1_plan

INSTABILITIES = ("gyro_bias_instability_deg_per_h", "accel_bias_instability_ug")
PLAN = """
[imu]
from = "tactical-fog"
[fixture]
from = "lab-1mrad"
[site]
from = "latitude-45"
[targets]
gyro_scale_ppm = 100.0
accel_scale_ppm = 200.0
[plan]
most_legs = 1
largest_turn_deg = 180
most_sequences = 6
moves = "recorded"
total_time_s = 200.0
[recording]
sample_rate_hz = 50.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moves")
    (folder / "lab.toml").write_text(PLAN, encoding="utf-8")
    names = {"-o": "s.toml", "--sheet": "s.md", "--json": "s.json"}
    options = [text for option, name in names.items() for text in (option, str(folder / name))]
    assert main(["plan", str(folder / "lab.toml"), *options, "-q"]) in (0, 1)
    return folder


@pytest.mark.parametrize(("estimator", "above"), [("graph", 1.01), ("least-squares", 1.03)])
def test_the_sigma_with_moves_is_that_of_the_bound(estimator, above):
    """The bound differentiates the simulator and shares no code; a move by half a turn may go either way round.

    Which way it goes moves information between a scale factor and its asymmetry, by a tenth here; on the geometric mean
    the graph has all of it, and least squares all but what the ends of the sequences tell of the fixture's axes.
    """
    if estimator == "graph":
        pytest.importorskip("gtsam")
    file = load_plan_file("navigation-equal")
    # The bound has no bias instability.
    still = file.imu.noise.model_copy(update=dict.fromkeys(INSTABILITIES, 0.0))
    wobble = {"wobble_sigma_mrad": 0.01, "stated_wobble_sigma_mrad": 0.01}
    file = file.model_copy(
        update={
            "imu": file.imu.model_copy(update={"noise": still}),
            "fixture": file.fixture.model_copy(update=wobble),
        }
    )
    task = file.task()
    plan = table_1_plan(task.fixture, task.conditions, file.targets.sigma(), 400.0)
    scenario = file.scenario(plan)
    assert scenario.schedule is not None
    recorded = scenario.schedule.model_copy(update={"moves": "recorded"})
    bound = scenario_bound(scenario.model_copy(update={"schedule": recorded})).sigma
    ratio = sigma_with_moves(file, plan, estimator) / bound
    mean = np.exp(np.log(ratio).mean())
    assert 0.99 < mean < above
    assert np.all(np.abs(ratio / mean - 1.0) < 0.12)
    assert np.exp(np.log(plan.prediction.sigma / bound).mean()) > 1.1


def test_the_plan_counts_on_the_moves(folder):
    made = json.loads((folder / "s.json").read_text(encoding="utf-8"))
    assert made["moves"] == "recorded"
    assert made["ratio_bound"] is None
    with_moves = np.array([row["sigma_with_moves"] or np.inf for row in made["parameters"]])
    targets = np.array([np.nan if row["target"] is None else row["target"] for row in made["parameters"]])
    assert made["worst_ratio"] == pytest.approx(np.nanmax(with_moves / targets), rel=1e-12)
    assert sims.load_scenario(folder / "s.toml").schedule.moves == "recorded"
    assert "Let the log run on during the moves" in (folder / "s.md").read_text(encoding="utf-8")
