"""Scenarios: the shipped ones run, wrong ones are refused in one sentence, seeds keep their meaning."""

import copy
import json
import math

import numpy as np
import pytest

import sims
from sims.scenarios import library
from sims.scenarios.simulation import schedule_of
from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from srt.exceptions import InputError
from srt.recording.folder import load_recording
from srt.recording.writing import write_recording
from srt.sensor_errors import GROUP_SLICES, SensorErrors

SMALL = {
    "seed": 3,
    "imu": {"from": "navigation-rlg"},
    "fixture": {"from": "lab-1mrad"},
    "site": {"from": "latitude-45"},
    "schedule": {"sequences": ["1", "7", "13"], "dwell_s": 1.0},
    "recording": {"sample_rate_hz": 50.0},
}


def changed(**sections):
    tables = copy.deepcopy(SMALL)
    for name, values in sections.items():
        if isinstance(values, dict):
            tables[name] = library.overlay(tables.get(name, {}), values)
        elif values is None:
            del tables[name]
        else:
            tables[name] = values
    return tables


def build(**sections):
    return sims.scenario_from_dict(changed(**sections))


@pytest.mark.parametrize("name", library.names("scenario"))
def test_shipped_scenarios_run(name):
    scenario = sims.load_scenario(name)
    if scenario.schedule is not None:  # a short run of the same kind
        schedule = scenario.schedule.model_copy(update={"sequences": ("1", "8"), "dwell_s": 1.0})
        scenario = scenario.model_copy(update={"schedule": schedule})
    simulation = sims.simulate(scenario)
    recording = simulation.recording
    assert np.all(np.isfinite(recording.gyro))
    assert np.all(np.isfinite(recording.accel))
    assert np.all(np.diff(recording.time) > 0.0)
    assert recording.kind == scenario.recording.kind
    assert (recording.fixture is None) == (scenario.free is not None)
    json.dumps(simulation.truth_dict(), allow_nan=False)


def test_the_seed_is_1_if_absent():
    assert build(seed=None) == build(seed=1)


@pytest.mark.parametrize("folder", ["imu", "fixture", "site"])
def test_shipped_parts_load(folder):
    assert library.names(folder)
    for name in library.names(folder):
        scenario = build(**{folder: {"from": name}})
        part = getattr(scenario, folder)
        assert part.name == name
        assert part.description


def test_grades_convert_to_si():
    scenario = sims.load_scenario("demo")
    noise = scenario.imu.noise.si()
    assert noise["gyro_noise"] == pytest.approx(0.002 * DEG_PER_SQRT_H)
    assert noise["gyro_noise"] * math.sqrt(40.0) == pytest.approx(3.7e-6, rel=0.01)  # Savage 2020, section 9
    assert noise["gyro_quantization"] * math.sqrt(1.0 / 6.0) == pytest.approx(0.99e-6, rel=0.01)  # likewise
    assert noise["gyro_bias_instability"] == pytest.approx(0.001 * DEG_PER_H)
    assert noise["accel_noise"] == pytest.approx(5.0 * MICRO_G)
    assert noise["gyro_range"] == pytest.approx(math.radians(400.0))
    sizes = scenario.imu.errors.si()
    assert set(sizes) == set(GROUP_SLICES)
    assert sizes["gyro_scale"] == pytest.approx(1e-4)
    assert sizes["accel_bias"] == pytest.approx(9.80665e-3)


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        ({"schedule": {"dwel_s": 3.0}}, "unknown key 'dwel_s' in .schedule.: did you mean 'dwell_s'"),
        ({"shedule": {}}, "unknown key 'shedule' in the top level"),
        ({"imu": {"noise": {"gyro_noise_rad": 1.0}}}, "unknown key 'gyro_noise_rad' in .imu.noise."),
        ({"imu": {"errors": {"gyro_scale": 1.0}}}, "did you mean 'gyro_scale_ppm'"),
        ({"fixture": {"level_sigma_rad": 1.0}}, "unknown key 'level_sigma_rad'"),
        ({"site": {"latitude_rad": 1.0}}, "unknown key 'latitude_rad'"),
        ({"recording": {"rate_hz": 1.0}}, "unknown key 'rate_hz'"),
        ({"free": {"turn": 1}}, "unknown key 'turn' in .free."),
        ({"errors": {"values": {"gyro_scal_x": 1.0}}}, "write 'gyro_scale_x'"),
        ({"site": None}, "'site' is missing"),
        ({"schedule": None}, r"one of a \[schedule\]"),
        ({"fixture": None}, r"needs a \[fixture\]"),
        ({"free": {"turns": 3}}, r"one of a \[schedule\]"),
        ({"free": {"turns": 3}, "schedule": None}, r"has no \[fixture\]"),
        ({"schedule": {"dwell_s": "10 s"}}, "schedule.dwell_s is '10 s': give a number"),
        ({"schedule": {"dwell_s": "10"}}, "schedule.dwell_s is '10': give a number"),
        ({"schedule": {"dwell_s": True}}, "give a number"),
        ({"schedule": {"dwell_s": -1.0}}, "give a number above 0"),
        ({"schedule": {"dwell_s": math.nan}}, "give a finite number"),
        ({"schedule": {"sequences": ["1", "99"]}}, "no sequence '99'"),
        ({"schedule": {"sequences": []}}, "sequences is empty"),
        ({"schedule": {"repeats": 0}}, "schedule.repeats is 0: give a number not below 1"),
        ({"schedule": {"custom": [{"id": "A"}]}}, r"'down' is missing from \[schedule.custom\[1\]\]"),
        (
            {"schedule": {"custom": [{"id": "1", "down": "z", "along_outer": "y", "rotations": [["y", 90.0]]}]}},
            "belongs to Table 1",
        ),
        (
            {"schedule": {"custom": [{"id": "A", "down": "z", "along_outer": "y", "rotations": [["x", 90.0]]}]}},
            "reorder its rotations",
        ),
        (
            {"schedule": {"custom": [{"id": "A", "down": "+z", "along_outer": "y", "rotations": [["y", 90.0]]}]}},
            r"down is '\+z': give 'x', 'y', 'z', '-x', '-y' or '-z'",
        ),
        (
            {"schedule": {"custom": [{"id": "A", "down": "x", "along_outer": "-z", "rotations": [["z", 90.0]]}]}},
            "with x down and -z along the outer axis",
        ),
        (
            {"schedule": {"custom": [{"id": "A", "down": "-z", "along_outer": "y", "rotations": [["-y", 90.0]]}]}},
            "is '-y': give 'x', 'y' or 'z'",
        ),
        ({"schedule": {"dwells_s": [1.0, 2.0]}}, "dwells_s has 2 entries, but there are 3 sequences"),
        ({"schedule": {"dwells_s": 2.0}}, "schedule.dwells_s is 2.0: give an array"),
        (
            {"schedule": {"dwells_s": [1.0, 0.0, 1.0]}},
            r"in .schedule.dwells_s\[2\]., found 0.0: give a positive",
        ),
        ({"schedule": {"dwells_s": [1.0, 1.0, [2.0]]}}, r"dwells_s\[3\]., found \[2.0\]: give"),
        ({"schedule": {"dwells_s": [1.0, 1.0, [2.0, "3"]]}}, "or a pair .start, end. of them"),
        ({"schedule": {"dwells_s": [True, 1.0, 1.0]}}, "found True"),
        ({"schedule": {"dwells_s": [math.inf, 1.0, 1.0]}}, "give a finite number"),
        ({"site": {"height_m": 1.0}}, "either gravity_m_s2 or height_m"),
        ({"site": {"latitude_deg": 91.0}}, "not above 90"),
        ({"site": 3}, "site is 3: give a table"),
        ({"site": {"from": "nowhere"}}, "no shipped site configuration 'nowhere'"),
        ({"site": {"from": "nowhere.toml"}}, "no file nowhere.toml"),
        ({"imu": {"from": 7}}, "from is 7"),
        ({"imu": {"frame_turn_mrad": [1.0, 2.0]}}, "too few values: 3"),
        ({"recording": {"kind": "rates"}}, "give 'rate' or 'increment'"),
        ({"recording": {"noise": 2}}, "give true or false"),
        ({"seed": 1.5}, "give a whole number"),
    ],
)
def test_wrong_scenarios_are_refused_in_one_sentence(sections, words):
    with pytest.raises(InputError, match=words) as caught:
        build(**sections)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert "pydantic" not in sentence
    assert sentence[-1] in ".?"


def test_files_are_refused_in_one_sentence(tmp_path):
    path = tmp_path / "mine.toml"
    with pytest.raises(InputError, match="no file"):
        sims.load_scenario(path)
    path.write_text("seed = = 1")
    with pytest.raises(InputError, match="not valid TOML"):
        sims.load_scenario(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not valid TOML"):
        sims.load_scenario(path)
    with pytest.raises(InputError, match="no shipped scenario configuration 'dmeo'"):
        sims.load_scenario("dmeo")


def test_own_files_beside_the_scenario(tmp_path):
    (tmp_path / "hall.toml").write_text('name = "hall"\nlatitude_deg = 10.0\nheight_m = 0.0\n')
    (tmp_path / "mine.toml").write_text(
        'seed = 1\n[imu]\nfrom = "perfect"\n[fixture]\nfrom = "perfect"\n[site]\nfrom = "hall.toml"\n'
        '[schedule]\nsequences = ["8"]\ndwell_s = 1.0\n'
    )
    scenario = sims.load_scenario(tmp_path / "mine.toml")
    assert scenario.site.site().latitude_rad == pytest.approx(math.radians(10.0))
    assert scenario.site.site().gravity_sigma_m_s2 == 5e-4  # normal gravity knows no anomaly
    assert scenario.site.site().gravity_m_s2 == pytest.approx(9.7819, abs=1e-4)


def test_same_seed_same_numbers():
    first, second = sims.simulate(build()), sims.simulate(build())
    other = sims.simulate(build(seed=4))
    np.testing.assert_array_equal(first.recording.gyro, second.recording.gyro)
    np.testing.assert_array_equal(first.recording.accel, second.recording.accel)
    assert first.truth == second.truth
    assert first.truth != other.truth
    given = sims.simulate(build(), np.random.default_rng(3))
    np.testing.assert_array_equal(given.recording.gyro, first.recording.gyro)


def test_streams_are_independent():
    # Another noise, another fixture or other errors leave the other draws alone.
    base = sims.simulate(build())
    quiet = sims.simulate(build(recording={"noise": False}))
    assert quiet.truth == base.truth
    np.testing.assert_array_equal(quiet.fixture_draw.starts, base.fixture_draw.starts)
    np.testing.assert_array_equal(quiet.U, base.U)
    no_errors = sims.simulate(build(errors={"draw": "none"}))
    assert no_errors.truth == SensorErrors()
    np.testing.assert_array_equal(no_errors.fixture_draw.base, base.fixture_draw.base)


def test_explicit_errors_and_factor():
    simulation = sims.simulate(build(errors={"draw": "none", "values": {"gyro_scale_x": 1e-3}}))
    assert simulation.truth == SensorErrors.from_dict({"gyro_scale_x": 1e-3})
    once, twice = (sims.simulate(build(errors={"factor": f})).truth.vector for f in (1.0, 2.0))
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-15)


@pytest.mark.parametrize("distribution", ["normal", "uniform"])
def test_drawn_errors_have_their_size(distribution):
    rng = np.random.default_rng(20)
    sizes = {"gyro_scale": 2.0, "accel_misalignment": 3.0}
    drawn = np.array([sims.draw_errors(rng, sizes, distribution=distribution).vector for _ in range(2000)])
    for name, columns in GROUP_SLICES.items():
        values = drawn[:, columns] / sizes.get(name, 1.0)
        if name not in sizes:
            assert not values.any()
            continue
        excess = 2.0 if distribution == "normal" else 0.8  # variance of the square of a unit draw
        assert abs(np.mean(values**2) - 1.0) < 3.5 * math.sqrt(excess / values.size)
        assert distribution == "normal" or np.abs(values).max() <= math.sqrt(3.0)


def test_fixture_draw_has_its_size():
    sequences = sims.table_sequences(("6",) * 400)
    draw = sims.draw_fixture(np.random.default_rng(21), sequences, rotation_sigma_rad=2e-3)
    for values in (draw.starts, np.concatenate(draw.legs)):
        assert abs(np.mean(values**2) / 4e-6 - 1.0) < 3.5 * math.sqrt(2.0 / values.size)
    assert draw.starts.shape == (400, 2)
    assert len(draw.legs[0]) == 8
    assert not draw.base.any()


def test_recording_states_what_the_scenario_says():
    simulation = sims.simulate(
        build(
            site={"state_latitude": False},
            fixture={"state_heading": False, "heading_deg": 40.0},
            recording={
                "state_noise": False,
                "label_sequences": False,
                "serial": "SN-1",
                "start_time_s": 100.0,
            },
        )
    )
    recording = simulation.recording
    assert recording.site.latitude_rad is None
    assert recording.fixture.heading_rad is None
    assert recording.fixture.alignment_sigma_rad == 1e-3
    assert recording.noise.gyro_noise is None
    assert recording.sequences == ()
    assert recording.serial == "SN-1"
    assert recording.time[0] == pytest.approx(100.02)
    assert simulation.windows[0][0] == (100.0, 101.0)
    labelled = sims.simulate(build()).recording
    assert [s.id for s in labelled.sequences] == ["1", "7", "13"]
    assert all(s.down is None for s in labelled.sequences)


def test_dwells_of_each_window_arrive_in_the_recording(tmp_path):
    """Dwells are given per entry of ``sequences``, one number for both windows, and hold to the sample of 20 ms."""
    custom = [{"id": "A", "down": "-z", "along_outer": "-y", "rotations": [["y", 90.0], ["z", 30.0]]}]
    schedule = {"sequences": ["A", "1"], "custom": custom, "repeats": 2, "dwells_s": [1, [0.5, 2.02]]}
    scenario = build(schedule=schedule)
    assert schedule_of(scenario.schedule).dwells_s == ((1.0, 1.0), (0.5, 2.02)) * 2
    recording = sims.simulate(scenario).recording
    write_recording(recording, tmp_path / "recording")
    again = load_recording(tmp_path / "recording")
    assert again.sequences == recording.sequences
    rows = [[again.window_indices(*w) for w in (s.start_static_s, s.end_static_s)] for s in again.sequences]
    assert [[w.stop - w.start for w in pair] for pair in rows] == [[50, 50], [25, 101]] * 2
    turns = (("y", math.pi / 2.0), ("z", math.pi / 6.0))
    assert [(s.id, s.down, s.along_outer) for s in again.sequences] == [("A", "-z", "-y"), ("1", None, None)] * 2
    assert again.sequences[0].rotations == turns
    # What a scenario became is a scenario again, pairs included.
    assert sims.Scenario.model_validate(scenario.model_dump(mode="json")) == scenario


def test_frame_turn():
    simulation = sims.simulate(build(imu={"frame_turn_mrad": [0.0, 0.0, 100.0], "frame_turn_sigma_mrad": 0.0}))
    # B is turned from T by +0.1 rad about z, so that T's x axis has the B-components (cos, -sin, 0).
    np.testing.assert_allclose(simulation.U @ [1, 0, 0], [math.cos(0.1), -math.sin(0.1), 0.0], atol=1e-15)


def test_truth_file(tmp_path):
    simulation = sims.simulate(build())
    simulation.write_truth(tmp_path / "truth.json")
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert SensorErrors.from_dict(truth["parameters"]) == simulation.truth
    np.testing.assert_array_equal(truth["frame"]["U"], simulation.U)
    np.testing.assert_array_equal(truth["fixture"]["starts"], simulation.fixture_draw.starts)
    assert truth["seed"] == 3
    assert [p.name for p in tmp_path.iterdir()] == ["truth.json"]


def test_free_scenario():
    tables = changed(fixture=None, schedule=None, free={"turns": 4, "dwell_s": 1.0})
    simulation = sims.simulate(sims.scenario_from_dict(tables))
    assert simulation.recording.fixture is None
    assert simulation.recording.sequences == ()
    assert len(simulation.windows) == 4
    assert simulation.windows[0][1] == simulation.windows[1][0]
    assert simulation.truth_dict()["fixture"] is None
    fixed = changed(fixture=None, schedule=None, free={"rotations_deg": [[90.0, 0.0, 0.0]], "dwell_s": 1.0})
    attitudes = sims.simulate(sims.scenario_from_dict(fixed)).motion.attitudes[0]
    np.testing.assert_allclose(attitudes[0].T @ attitudes[1], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)
