"""``srt plan`` at the shell: what it writes, what it prints, and its sentences."""

import json
import math

import pytest

import sims
from srt.cli import main
from srt.sensor_errors import NAMES

pytestmark = pytest.mark.usefixtures("blank_figures", "short_search")

PLAN = """
[imu]
from = "tactical-fog"
[fixture]
from = "lab-1mrad"
[site]
from = "latitude-45"

[stand]
settle_s = 0.5
{stand}
[targets]
{targets}
[plan]
{limits}
{plan}
[recording]
sample_rate_hz = 50.0
"""
SEVERAL_ROTATIONS = "most_legs = 2\nlargest_turn_deg = 360\nmost_sequences = 12"
HALF_TURNS = "most_legs = 1\nlargest_turn_deg = 180\nmost_sequences = 6"
"""Limits of the plans that stand for any."""
SCALES = "gyro_scale_ppm = 100.0\naccel_scale_ppm = 200.0\naccel_bias_ug = 200.0"


def write(path, *, stand="", targets=SCALES, plan="total_time_s = 200.0", limits=HALF_TURNS):
    path.write_text(PLAN.format(stand=stand, targets=targets, plan=plan, limits=limits), encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    file = write(folder / "lab.toml", limits=SEVERAL_ROTATIONS)
    names = {"-o": "s.toml", "--sheet": "s.md", "--json": "s.json", "--plot": "s.png"}
    options = [text for option, name in names.items() for text in (option, str(folder / name))]
    assert main(["plan", file, *options, "-q"]) == 0
    return folder


def test_the_schedule_is_what_the_plan_says(made):
    plan = json.loads((made / "s.json").read_text(encoding="utf-8"))
    scenario = sims.load_scenario(made / "s.toml")
    sequences = scenario.schedule.turn_sequences()
    assert [s.id for s in sequences] == [s["id"] for s in plan["sequences"]]
    for executed, said in zip(sequences, plan["sequences"], strict=True):
        assert (executed.down, executed.along_outer) == (said["down"], said["along_outer"])
        assert [list(r) for r in executed.rotations] == said["rotations"]
        inner_or_outer = [["inner" if axis == 0 else "outer", pytest.approx(said_turn)] for axis, said_turn in
                          ((a, round(t * 57.29577951308232, 6)) for a, t in executed.fixture_legs())]  # fmt: skip
        assert inner_or_outer == said["fixture_turns"]
    for (start, end), said in zip(scenario.schedule.dwells_s, plan["sequences"], strict=True):
        assert start == pytest.approx(said["start_static_s"][1] - said["start_static_s"][0], abs=1e-3)
        assert end == pytest.approx(said["end_static_s"][1] - said["end_static_s"][0], abs=1e-3)
    assert plan["total_s"] <= 200.0 * (1.0 + 1e-6)
    assert plan["ratio_bound"] <= plan["worst_ratio"]
    assert [p["name"] for p in plan["parameters"]] == list(NAMES)


def test_sheet_and_plot(made):
    sheet = (made / "s.md").read_text(encoding="utf-8")
    plan = json.loads((made / "s.json").read_text(encoding="utf-8"))
    rows = [line for line in sheet.splitlines() if line.startswith("| ") and line.split("|")[1].strip().isdigit()]
    assert len(rows) == len(plan["sequences"])
    assert sheet.count("[[sequence]]") == len(rows)
    assert (made / "s.png").read_bytes()[:4] == b"\x89PNG"


def test_the_plan_is_simulated_and_calibrated(made, tmp_path, shell):
    shell("simulate", made / "s.toml", "-o", tmp_path / "run", "-q")
    unit = tmp_path / "unit.json"
    shell("calibrate", tmp_path / "run", "-o", unit, "-q")
    out = shell("plan", made / "lab.toml", "--after", unit).out
    assert out.startswith("Sequences on which the optimal continuation")
    assert max(map(len, out.splitlines())) <= 100


def test_the_table_fits_a_terminal(tmp_path, shell):
    file = write(tmp_path / "lab.toml", targets="gyro_scale_ppm = 100.0", plan="total_time_s = 150.0")
    out = shell("plan", file, "--table-1").out
    assert max(map(len, out.splitlines())) <= 80
    assert "no plan of this length" in " ".join(out.split())
    assert "150 s are too short for 17 sequences" in " ".join(out.split())


def test_missed_targets_exit_with_one_and_leave_a_plan(tmp_path, shell):
    file = write(tmp_path / "lab.toml", targets="gyro_scale_ppm = 1.0", plan="total_time_s = 150.0")
    err = shell("plan", file, "-o", tmp_path / "s.toml", "-q", code=1).err
    assert "The plan misses 3 of the targets: gyro_scale_" in err
    assert (tmp_path / "s.toml").is_file()


@pytest.mark.parametrize(
    ("changes", "arguments", "code", "said"),
    [
        (
            {"targets": "gyro_scale = 1.0"},
            [],
            2,
            "unknown key 'gyro_scale' in [targets]: did you mean 'gyro_scale_ppm'?",
        ),
        ({"targets": "gyro_scale_ppm = -1.0"}, [], 2, "targets.gyro_scale_ppm is -1.0"),
        ({"targets": "parameters = {gyro_scale_q = 1e-6}"}, [], 2, "no sensor error named 'gyro_scale_q'"),
        ({"targets": ""}, [], 2, "there is no target"),
        ({"stand": "inner = {travel_deg = [10.0, 80.0]}"}, [], 2, "No multiple of 90 deg"),
        ({"stand": "inner = {turns = false}\nouter = {turns = false}"}, [], 2, "Neither axis"),
        ({"stand": "inner = {turns = false, travel_deg = [0.0, 90.0]}"}, [], 2, "has no travel_deg"),
        ({"stand": "inner = {set_s = 3.0}"}, [], 2, "add turns = false"),
        ({"stand": "rate_rad_s = 0.0"}, [], 2, "stand.rate_rad_s is 0.0"),
        ({"plan": "shortest_window_s = 70.0"}, [], 2, "contradictory"),
        ({"plan": "total_time_s = 4.0"}, [], 2, "too short"),
        ({"stand": "inner = {turns = false}"}, [], 1, "shows gyro_scale_"),
        ({}, ["--total-time", "nan"], 2, "--total-time is nan"),
        ({}, ["-o", "s.txt"], 2, ".toml"),
        ({}, ["--after", "no.json", "--sheet", "s.md"], 2, "leave the other options out"),
        ({}, ["--after", "no.json"], 2, "no.json"),
        ({}, ["--sequence", "z/y"], 2, "is no sequence"),
        ({}, ["--sequence", "z/y +360x"], 2, "rotation 1 is about x, which does not lie along the outer axis"),
        (
            {"stand": "outer = {travel_deg = [-180.0, 180.0]}"},
            ["--sequence", "1"],
            2,
            "rotation 1 (+360 deg about the outer axis) would go from 0 to 360 deg",
        ),
    ],
)
def test_mistakes(tmp_path, monkeypatch, changes, arguments, code, said, shell):
    monkeypatch.chdir(tmp_path)
    captured = shell("plan", write(tmp_path / "lab.toml", **changes), *arguments, code=code)
    assert said in captured.err
    assert len(captured.err.strip().splitlines()) == 1
    assert captured.out == ""


@pytest.mark.parametrize(
    ("sequence", "component", "terms"),
    [
        ("1", "horizontal x", {"κyy": -2 * math.pi, "κyyy": -2 * math.pi}),
        ("z/x +180x +180z +180x +180z", "horizontal x", {"υzx": 4.0}),
        ("7", "horizontal x", {"μxy": 2.0, "υxy": 1.0}),
        ("7", "down at end", {"λyy": -1.0, "λyyy": -1.0, "λy": -1.0}),
    ],
)
def test_measured_parameters_of_each_sequence_are_table_2(tmp_path, sequence, component, terms):
    """Savage 2020, Table 2, over g; gyro biases apart, which eqs. 20-22 have."""
    from sims.scenarios.plan_file import load_plan_file
    from srt.planning.signature_table import parse_sequence, signature

    file = load_plan_file(write(tmp_path / "lab.toml"))
    stand = file.stand.kinematics()
    rows = {
        row.component: dict(row.terms) for row in signature(parse_sequence(sequence, stand), stand, file.conditions())
    }
    found = {symbol: value for symbol, value in rows[component].items() if symbol not in ("κx", "κy", "κz")}
    assert found == pytest.approx(terms, abs=1e-9)


def test_a_sequence_is_shown(shell):
    out = shell("plan", "navigation-equal", "--sequence", "1").out
    assert "horizontal x   -6.283 κyy -6.283 κyyy" in out
    assert max(map(len, out.splitlines())) <= 80


def test_shipped_plans_are_read():
    from sims.scenarios.library import names
    from sims.scenarios.plan_file import load_plan_file

    assert len(names("plan")) == 6
    for name in names("plan"):
        load_plan_file(name).conditions()


def test_a_plan_is_compared_with_protocols(tmp_path, shell, refused):
    file = write(tmp_path / "lab.toml", targets="gyro_scale_ppm = 100.0", plan="total_time_s = 300.0")
    names = ("table-1", "19-positions", "24-face-tumble")
    out = " ".join(shell("plan", file, *(word for name in names for word in ("--compare", name))).out.split())
    assert "Protocol table-1 in the same time: gyro_scale_" in out
    assert "Protocol 19-positions in the same time: gyro_scale_" in out
    where = "without the fixture, which cannot run it"
    assert f"Protocol 24-face-tumble in the same time, {where}: not observed: gyro_scale_x, gyro_scale_y, " in out
    assert "There is no shipped protocol '20-positions'" in refused("plan", file, "--compare", "20-positions")
