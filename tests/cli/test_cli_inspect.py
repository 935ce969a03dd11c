"""``srt inspect``: table, JSON, picture, and exit codes."""

import json
import shutil
from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
from foreign_motion import GRADES, drawn_errors, hand_turns
from foreign_motion import recording as foreign_recording

import sims
import srt
from srt.cli import main
from srt.constants import DEG_PER_H
from srt.model.table1 import SEQUENCES

pytestmark = pytest.mark.usefixtures("blank_figures")

RATE = 100.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Table 1 by a tactical unit, labelled, in degrees and g as its logger would write them."""
    scenario = sims.load_scenario("tactical-fog")
    kept = scenario.recording.model_copy(update={"sample_rate_hz": RATE, "kind": "rate", "serial": "T-7"})
    recording = sims.simulate(scenario.model_copy(update={"recording": kept})).recording
    path = tmp_path_factory.mktemp("inspect") / "unit"
    factor = np.degrees(1.0)
    logged = replace(recording, gyro=recording.gyro * factor, accel=recording.accel / 9.80665)
    srt.write_recording(logged, path, samples_format="npz")
    toml = path / "recording.toml"
    text = toml.read_text(encoding="utf-8").replace('"rad/s"', '"deg/s"').replace('"m/s^2"', '"g"')
    toml.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """A minute at rest."""
    rng = np.random.default_rng(1)
    gyro = 1e-3 * rng.standard_normal((6000, 3))
    accel = np.array([0.0, 0.0, 9.80665]) + 1e-2 * rng.standard_normal((6000, 3))
    path = tmp_path_factory.mktemp("inspect") / "shelf"
    srt.write_recording(srt.Recording(np.arange(1, 6001) / RATE, gyro, accel, accuracy_trials.SITE), path)
    return path


def test_standard_gravity_without_a_sigma_is_warned_of(shelf, tmp_path, shell):
    assert shell("inspect", shelf, "-q").err == ""  # this program wrote it, with the sigma
    by_hand = tmp_path / "by_hand"
    shutil.copytree(shelf, by_hand)
    toml = by_hand / "recording.toml"
    lines = [line for line in toml.read_text().splitlines() if "gravity_sigma" not in line]
    toml.write_text("\n".join(lines))
    # A minute at rest is no test, and calibrate refuses it after the warning.
    inspected, calibrated = shell("inspect", by_hand, "-q").err, shell("calibrate", by_hand, code=1).err
    assert calibrated.startswith(inspected)
    assert "no gravity_sigma_m_s2: 5e-06 m/s² is assumed" in inspected
    assert "In its place, give height_m, or the gravity of the site; or gravity_sigma_m_s2 if" in inspected
    toml.write_text("\n".join(line for line in lines if "latitude" not in line))
    assert "give latitude_deg and height_m, or" in shell("inspect", by_hand, "-q").err


def test_the_table_says_what_the_recording_is(folder, shell):
    out, err = shell("inspect", folder)
    assert err == ""
    lines = out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0] == "Fit to calibrate: yes"
    assert "serial T-7" in lines[1]
    for words in ("100 Hz, evenly spaced", "gyros deg/s, accelerometers g, time s", "34 windows", "16, the longest"):
        assert words in out
    rows = [line.split() for line in lines if "%" in line and "°" in line]
    assert [row[-1] for row in rows] == list(SEQUENCES)
    assert [row[-3] for row in rows] == list(SEQUENCES)
    assert "17 sequences of Table 1 recognised" in out.replace("\n            ", "")
    assert "0.0667" in out  # the random walk that is stated, °/√h


def test_a_rest_alone_is_shown_with_its_allan_deviation(shelf, capfd):
    code = main(["inspect", str(shelf)])
    out, _ = capfd.readouterr()
    assert code in (0, 1)
    assert max(map(len, out.splitlines())) <= 80
    assert "Allan deviation of one window of 5" in out
    assert "95 % intervals" in out.replace("\n  ", " ")


def test_json_and_picture(folder, tmp_path, shell):
    document, picture = tmp_path / "x.json", tmp_path / "x.png"
    assert shell("inspect", folder, "--json", document, "--plot", picture, "-q") == ("", "")
    read = json.loads(document.read_text(encoding="utf-8"))
    assert read["units"] == {"gyro": "deg/s", "accel": "g", "time": "s"}
    assert [turn["sequence"] for turn in read["turns"]] == [turn["labelled"] for turn in read["turns"]]
    assert read["stamps"]["gaps"] == 16
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_written_files_are_named(shelf, tmp_path, capfd):
    picture = tmp_path / "x.svg"
    main(["inspect", str(shelf), "--plot", str(picture)])
    assert f"Written: {picture}" in capfd.readouterr().out
    assert picture.read_bytes().startswith(b"<?xml")


def test_fatal_faults_are_named_and_exit_with_1(folder, tmp_path, shell):
    """Degrees declared as radians: the turns are 57 times too large."""
    wrong = tmp_path / "wrong"
    shutil.copytree(folder, wrong)
    toml = wrong / "recording.toml"
    toml.write_text(toml.read_text(encoding="utf-8").replace('"deg/s"', '"rad/s"'), encoding="utf-8")
    document = tmp_path / "x.json"
    out, err = shell("inspect", wrong, "--json", document, code=1)
    assert err.startswith("srt: ")
    assert err.count("\n") == 1
    assert "deg" in err
    assert "Refused: " in out
    findings = json.loads(document.read_text(encoding="utf-8"))["findings"]
    assert any(f["effect"] == "exit 1" and f["sentence"] in err for f in findings)


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (["absent"], ["absent", "check the path"]),
        (["absent", "--json", "x.txt"], ["x.txt", ".json"]),
        (["absent", "--plot", "x.gif"], ["x.gif", ".png", ".svg"]),
        ([], ["RECORDING"]),
    ],
)
def test_unreadable_input_and_unwritable_output_exit_with_2(arguments, fragments, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    err = refused("inspect", *arguments)
    for fragment in fragments:
        assert fragment in err
    assert list(tmp_path.iterdir()) == []


def test_a_correction_that_hides_coarse_steps_makes_no_drift_of_them(tmp_path, unit, shell):
    """Rates in steps of 0.5 °/s, eight sigma of a reading: in corrected ones they show as a drift of 569 °/h."""
    rng = np.random.default_rng((20261128, 0))
    turns, step = hand_turns(rng, shortest_s=1.0), np.radians(0.5)
    log = foreign_recording(turns, 5.0, drawn_errors(GRADES["consumer"], rng), GRADES["consumer"], rng, hz=50.0)
    course = (log.time - log.time.mean()) / np.ptp(log.time)
    rate = log.gyro + np.outer(course, [300.0 * DEG_PER_H, 0.0, 0.0])
    srt.write_recording(replace(log, gyro=np.round(rate / step) * step, sequences=()), tmp_path / "raw")
    shell("apply", unit, tmp_path / "raw", "-o", tmp_path / "corrected", "-q")
    raw, corrected = (" ".join(shell("inspect", tmp_path / name).out.split()) for name in ("raw", "corrected"))
    assert "The bias of gyro" not in raw + corrected
    assert "rounded to steps" not in raw
    assert "Not looked for: gyro_bias_drift. The rates were rounded to steps of 1800 °/h before they were" in corrected


@pytest.mark.parametrize("rate_hz", [1.0, 1.9])
@pytest.mark.parametrize("command", ["inspect", "calibrate"])
def test_a_slow_log_is_told_to_record_faster_and_no_unit_is_named(tmp_path, rate_hz, command, shell):
    """At rest for 20 min: nothing turns, so that nothing tells the unit of time."""
    rng, n = np.random.default_rng(6), int(1200 * rate_hz)
    gyro, accel = 1e-3 * rng.standard_normal((n, 3)), [0.0, 0.0, -9.80665] + 0.02 * rng.standard_normal((n, 3))
    slow = srt.Recording(np.arange(1, n + 1) / rate_hz, gyro, accel, srt.Site(9.80665, latitude_rad=0.785))
    srt.write_recording(slow, tmp_path / "slow")
    said = " ".join("".join(shell(command, tmp_path / "slow", code=1)).split())
    assert "record at 10 Hz or more" in said
    assert "look like" not in said
