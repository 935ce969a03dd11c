"""Budget of errors, and the accuracy that a test is expected to reach."""

import json
import math

import g_sensitivity
import numpy as np
import pytest

import sims
import srt
from sims.accuracy.bound import scenario_bound
from sims.accuracy.budget import FIXTURE, G_SENSITIVITY, NOT_COUNTED, budget
from sims.accuracy.expected_accuracy import sigma_with_moves
from sims.scenarios.plan_file import load_plan_file
from sims.scenarios.simulation import simulate
from srt.cli import main
from srt.planning.planner import table_1_plan
from srt.sensor_errors import NAMES

pytestmark = pytest.mark.usefixtures("short_search")

QUICK = {"dwell_s": 4.0, "moves": "skipped", "settle_s": 0.5}


def scenario(grade="tactical-fog", noise=None, **changes):
    """A test of two minutes; ``noise`` replaces all figures of the grade."""
    base = sims.load_scenario(grade)
    imu = base.imu
    if noise is not None:
        imu = imu.model_copy(update={"noise": type(imu.noise)(**noise)})
    recording = base.recording.model_copy(update={"sample_rate_hz": 50.0, "label_sequences": True, "kind": "rate"})
    schedule = base.schedule.model_copy(update=QUICK)
    return base.model_copy(update={"imu": imu, "recording": recording, "schedule": schedule, **changes})


WHITE = {"gyro_noise_deg_per_sqrt_h": 0.0667, "accel_noise_ug_per_sqrt_hz": 60.0}
PULSES = {"gyro_quantization_arcsec": 2.0, "accel_quantization_m_s": 1e-4}
G = {"gyro_g_sensitivity_deg_per_h_per_g": 30.0}
# With the noise above, enough to rule some parameters of the gyros and most of the accelerometers.
INSTABILITY = {"gyro_bias_instability_deg_per_h": 3.0, "accel_bias_instability_ug": 40.0}
DRIFT = {"gyro_bias_instability", "accel_bias_instability"}
SOURCES = {
    "white": (WHITE, {"gyro_noise", "accel_noise"}),
    "pulses": (WHITE | PULSES, {"gyro_noise", "accel_noise", "gyro_quantization", "accel_quantization"}),
    "g-sensitivity": (WHITE | G, {"gyro_noise", "accel_noise", G_SENSITIVITY}),
    "instability": (WHITE | INSTABILITY, {"gyro_noise", "accel_noise"} | DRIFT),
    # The tactical grade's own figures.
    "all": (None, {"gyro_noise", "accel_noise"} | DRIFT),
}
MODELLED = {"instability": 0.02, "all": 0.02}
"""Share of sigma by which drift may be off besides: the simulator's processes begin at 1 s, those of the estimators at
0.1 s, which adds 2 · 0.1 s / 4 s = 5 % to the variance of one of four in a window's mean."""


@pytest.mark.parametrize(
    ("source", "units", "estimator"),
    [
        ("white", 12, "closed-form"),
        *(pytest.param(source, 2500, "closed-form", marks=pytest.mark.campaign) for source in SOURCES),
        *(pytest.param(source, 600, "graph", marks=pytest.mark.campaign) for source in ("instability", "all")),
    ],
)
def test_predicted_sigma_is_that_of_simulated_units(source, units, estimator):
    """Every unit with its own errors, fixture, noise and gravity."""
    if estimator == "graph":
        pytest.importorskip("gtsam")
    noise, chosen = SOURCES[source]
    modelled, plan = MODELLED.get(source, 0.0), scenario(noise=noise)
    (predicted,) = budget(plan, (estimator,), draws=10)
    assert chosen <= {name for name, sizes in predicted.sources.items() if np.nanmax(sizes) > 0.0}
    errors = []
    for seed in range(units):
        simulation = simulate(plan.model_copy(update={"seed": 1000 + seed}))
        found = srt.calibrate(simulation.recording, estimator, checks=False)
        errors.append(found.errors.vector - simulation.truth.vector)
    # Gravity, an error of the accelerometer scale factors, is not drawn by the simulator.
    scale = np.array(["accel_scale" in name for name in NAMES])
    sigma = np.where(scale, np.sqrt(predicted.total**2 - predicted.sources["gravity"] ** 2), predicted.total)
    squares = (np.array(errors) / sigma) ** 2
    # A standard deviation from n draws has a standard error of 1 / √(2n).
    ratio = np.sqrt(squares.mean(axis=0))
    band = 3.5 / math.sqrt(2.0 * units) + modelled
    assert np.all(np.abs(ratio - 1.0) < band), dict(zip(NAMES, ratio.round(3), strict=True))
    # Over all parameters: parameters of one unit are correlated, units are not.
    by_unit = squares.mean(axis=1)
    assert abs(by_unit.mean() - 1.0) < 3.5 * by_unit.std(ddof=1) / math.sqrt(units) + 2.0 * modelled


def test_bias_instability_limits_the_expected_parameters():
    """Bias instability is the largest source for these parameters."""
    noise, _ = SOURCES["instability"]
    (found,) = budget(scenario(noise=noise), draws=2)
    ruled = [name for name, source in zip(NAMES, found.limiting, strict=True) if source in DRIFT]
    assert {"accel_bias_x", "gyro_bias_x", "accel_misalignment_xy"} <= set(ruled), ruled


def test_the_total_is_the_root_of_the_squares():
    """Without sequence 1a, an asymmetry has no sigma; the progress ends at the number that it names."""
    plan, told = scenario(), []
    schedule = plan.schedule.model_copy(update={"sequences": tuple(s for s in sims.TABLE_1 if s != "1a")})
    plan = plan.model_copy(update={"schedule": schedule})
    (found,) = budget(plan, draws=2, progress=lambda done, size: told.append((done, size)))
    np.testing.assert_allclose(found.total, np.sqrt(sum(sizes**2 for sizes in found.sources.values())), rtol=1e-14)
    lost = NAMES.index("gyro_asymmetry_y")
    assert np.flatnonzero(np.isnan(found.total)).tolist() == [lost]
    for k, name in enumerate(found.limiting):
        assert (name is None) == (k == lost)
        assert k == lost or found.sources[name][k] == max(sizes[k] for sizes in found.sources.values())
    plain = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert (plain["total"]["gyro_scale_x"], plain["total"]["gyro_asymmetry_y"]) == (found.total[0], None)
    assert FIXTURE in plain["sources"]
    assert told == sorted(told)
    assert told[-1][0] == told[-1][1]


def test_the_budget_lists_errors_that_it_does_not_count():
    (found,) = budget(scenario(), draws=3)
    assert set(found.not_counted) == set(NOT_COUNTED)
    # Products of errors of some thousandths: more than a millionth, less than a thousandth.
    second = found.not_counted["second_order_before_iteration"][:24]
    assert 1e-6 < np.median(second) < 1e-3
    bias = [NAMES.index(f"gyro_bias_{a}") for a in "xyz"]
    # Held at zero, the bias is wrong by all of it.
    truth = simulate(scenario()).truth.vector
    np.testing.assert_allclose(found.not_counted["gyro_bias_if_not_measured"][bias], np.abs(truth[bias]), rtol=0.05)


def test_command(tmp_path, capsys):
    file, plot = tmp_path / "b.json", tmp_path / "b.png"
    arguments = ["budget", "demo", "--estimator", "closed-form", "--draws", "2", "-o", str(file), "--plot", str(plot)]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "Budget of closed-form" in out
    assert max(len(line) for line in out.splitlines() if str(tmp_path) not in line) <= 80
    assert json.loads(file.read_text())["budgets"][0]["estimator"] == "closed-form"
    assert plot.read_bytes()[:4] == b"\x89PNG"


def test_command_in_the_papers_mode(tmp_path, shell):
    file = tmp_path / "paper.json"
    assert "Savage 2020, §9: sequences of 40 s" in shell("budget", "demo", "--paper", "-o", file).out
    rows = {row["quantity"]: row for row in json.loads(file.read_text())["quantities"]}
    assert rows["υyz"]["gyro_noise"] == pytest.approx(0.002 / 60 * math.pi / 180 * math.sqrt(40) / 4, rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["free-mems"], "needs a scenario with a [fixture]"),
        (["free-mems", "--paper"], "17 sequences"),
        (["no-such"], "no shipped scenario"),
        (["demo", "--paper", "--plot", "x.png"], "leave one of the two options out"),
        (["demo", "--estimator", "closed"], "closed-form"),
        (["demo", "-o", "x.txt"], ".json"),
    ],
)
def test_mistakes(arguments, said, shell):
    captured = shell("budget", *arguments, code=2)
    assert said in captured.err
    assert captured.out == ""


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


def test_residuals_that_contradict_a_pooled_bias_enlarge_no_source():
    """Γ of 30 °/h/g enlarges the sigmas of one bias for all poses by 1.6; the noise is that of the right model."""
    plan = g_sensitivity.mems_scenario(dwell_s=4.0, sample_rate_hz=50.0)
    (pooled,), (right,) = (budget(plan, draws=2, gyro_bias=mode) for mode in ("pooled", "g-sensitive"))
    # Four unknowns of each gyro in place of one: the bias is a small part of the noise of a rotation.
    np.testing.assert_allclose(pooled.sources["gyro_noise"][:3], right.sources["gyro_noise"][:3], rtol=0.05)
