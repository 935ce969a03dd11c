"""``srt simulate``: what it writes, and what it will not write over."""

import json

import pytest

import sims
import srt
from srt.cli.truth import load_truth

SCENARIO = """
description = "Two sequences"
seed = 5
imu = { from = "navigation-rlg" }
fixture = { from = "lab-1mrad" }
site = { from = "latitude-45" }
schedule = { sequences = ["1", "1a"], dwell_s = 1.0, rate_rad_s = 3.0 }
recording = { sample_rate_hz = 50.0, format = "npz" }
"""


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO)
    return path


@pytest.mark.parametrize("samples_format", ["csv", "npz", "parquet", "h5"])
def test_recording_and_truth_are_the_simulators(scenario, tmp_path, samples_format, shell):
    folder = tmp_path / "out"
    out, err = shell("simulate", scenario, "-o", folder, "--format", samples_format)
    assert err == ""
    assert sorted(p.name for p in folder.iterdir()) == ["recording.toml", f"samples.{samples_format}", "truth.json"]
    expected = sims.simulate(sims.load_scenario(scenario))
    recording = srt.load_recording(folder)
    assert (recording.gyro == expected.recording.gyro).all()
    assert (recording.accel == expected.recording.accel).all()
    assert load_truth(folder / "truth.json") == expected.truth
    for text in (
        "Two sequences",
        f"{recording.time.size} samples",
        "50 Hz",
        "2 sequences: 1 1a",
        "seed 5",
        str(folder),
    ):
        assert text in out


def test_seed_makes_another_unit(scenario, tmp_path, shell):
    for name, more in {"a": [], "b": ["--seed", "5"], "c": ["--seed", "6"]}.items():
        shell("simulate", scenario, "-o", tmp_path / name, "-q", *more)
    a, b, c = (load_truth(tmp_path / name / "truth.json") for name in "abc")
    assert a == b
    assert a != c
    assert json.loads((tmp_path / "c" / "truth.json").read_text())["seed"] == 6


def test_files_are_not_written_over_unless_asked(scenario, tmp_path, shell, refused):
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    assert "holds files already" in refused("simulate", scenario, "-o", folder)
    assert [p.name for p in folder.iterdir()] == ["notes.txt"]
    shell("simulate", scenario, "-o", folder, "--overwrite")
    assert (folder / "notes.txt").read_text() == "mine"
    assert (folder / "truth.json").exists()


@pytest.mark.parametrize(("writer", "kept"), [("srt.write_recording", True), ("srt.cli.truth.write_truth", False)])
def test_a_failure_on_overwriting_keeps_the_old_pair_or_leaves_no_old_truth(
    scenario, tmp_path, monkeypatch, writer, kept, shell, refused
):
    folder = tmp_path / "out"
    shell("simulate", scenario, "-o", folder, "-q")

    def fail(*args, **options):
        raise srt.InputError("The disk is full.")

    monkeypatch.setattr(writer, fail)
    assert refused("simulate", scenario, "-o", folder, "--overwrite") == "srt: The disk is full.\n"
    assert (folder / "truth.json").exists() == kept


@pytest.mark.parametrize("place", ["file", "file/below"])
def test_a_place_that_cannot_be_a_folder_is_noticed_first(scenario, tmp_path, monkeypatch, place, shell):
    (tmp_path / "file").touch()
    monkeypatch.setattr(sims, "simulate", lambda *_: pytest.fail("it was simulated first"))
    err = shell("simulate", scenario, "-o", tmp_path / place, code=2).err
    assert str(tmp_path / place) in err
    assert err.count("\n") == 1
