"""``srt calibrate`` of a fleet: folders and patterns, one table, outlying and failed units, any number of workers."""

import csv
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import accuracy_trials
import numpy as np
import pytest
from small_units import on_fixture

import srt
from sims.physics.imu import read_out
from srt.cli import main
from srt.cli.recording_arguments import find_recordings, unit_names
from srt.result.provenance import Provenance
from srt.sensor_errors import INDEX, NAMES, SYMBOLS, SensorErrors

pytestmark = pytest.mark.usefixtures("blank_figures")

ODD, BROKEN, SHIFT = "unit-2", "unit-10", 0.02
"""One accelerometer scale 2 % off among units of 1e-4: 200 spreads, where the limit for 7 units is 14.9."""

UNITS = ("unit-1", ODD, "unit-3", "unit-4", "unit-5", "unit-6", "unit-7", BROKEN)


@pytest.fixture(scope="module")
def lot(tmp_path_factory):
    """Make the recordings of eight units of one kind on one fixture, one with broken samples."""
    folder = tmp_path_factory.mktemp("lot")
    rng = np.random.default_rng(12)
    motion = on_fixture(rng, dwell_s=4.0)
    for number, name in enumerate(UNITS):
        truth = accuracy_trials.normal_errors(rng, 1e-4)
        if name == ODD:
            truth = truth.plus(np.eye(len(NAMES))[INDEX["accel_scale_y"]] * SHIFT)
        recording = replace(read_out(motion, truth, accuracy_trials.GRADES["navigation"], rng), serial=f"SN-{number}")
        srt.write_recording(recording, folder / name, samples_format="npz")
    (folder / BROKEN / "samples.npz").write_bytes(b"no samples")
    return folder


@pytest.fixture(scope="module")
def calibration(lot):
    return srt.calibrate(srt.load_recording(lot / "unit-1"))


@pytest.fixture
def quick(monkeypatch, calibration):
    """Calibrate without the work: the values of one unit, each a little off by its serial."""

    def calibrate(recording, estimator, *, options, force):
        shifted = calibration.errors.vector + 1e-4 * float(recording.serial[3:])
        return replace(calibration, errors=SensorErrors(shifted), **changes)

    changes = {}
    monkeypatch.setattr("srt.procedure.calibrate", calibrate)
    return changes


@pytest.fixture(scope="module")
def made(lot, tmp_path_factory):
    """Run the whole command, as its users would, with one worker."""
    output = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(lot.parent)
        lines = {"out": [], "err": []}
        patch.setattr("click.echo", lambda text="", err=False: lines["err" if err else "out"].append(text))
        code = main(["calibrate", lot.name, "-o", str(output)])
    return code, "\n".join(lines["out"]), "\n".join(lines["err"]), output


def test_a_failed_unit_stops_none_and_decides_the_exit_code(made):
    code, out, err, output = made
    assert code == 2
    written = [f"{name}.json" for name in UNITS if name != BROKEN]
    assert sorted(p.name for p in output.iterdir()) == sorted([*written, "fleet.csv", "fleet.json"])
    assert srt.load_calibration(output / "unit-7.json").status == "converged"
    failures = [line for line in err.splitlines() if line.startswith("srt: ") and "warning" not in line]
    assert len(failures) == 1
    assert "unit-10" in failures[0]
    assert "not a readable NPZ file" in failures[0]
    assert f"{BROKEN}: lot" in out  # and in the report, under its table


def test_a_fleet_of_which_every_unit_failed_has_its_table(tmp_path, shell):
    for name in ("a", "b"):
        (tmp_path / "lot" / name).mkdir(parents=True)
        (tmp_path / "lot" / name / "recording.toml").write_text("no TOML")
    out, err = shell("calibrate", tmp_path / "lot", code=2)
    assert len(re.findall(r"^ [ab] +failed$", out, re.MULTILINE)) == 2
    assert err.count("is not valid TOML") == 2


def test_the_outlying_unit_is_found_and_no_other(made):
    _, out, err, output = made
    document = json.loads((output / "fleet.json").read_text())
    flagged = {unit["name"]: unit["flagged"] for unit in document["units"] if unit["flagged"]}
    assert flagged == {ODD: ["accel_scale_y"]}
    assert next(p for p in document["parameters"] if p["name"] == "accel_scale_y")["flagged"] == [ODD]
    warnings = [line for line in err.splitlines() if "warning" in line]
    assert len(warnings) == 1
    assert re.search(rf"{ODD} is outlying against the fleet: accel_scale_y by z = \+\d+\.$", warnings[0])
    assert re.search(rf" {ODD} +accel_scale_y +\d{{5}} ", out.split("Outlying\n")[1])


def test_table_has_a_row_per_unit_and_fits(made):
    _, out, _, output = made
    assert "\x1b" not in out
    assert max(len(line) for line in out.splitlines() if str(output) not in line) <= 80
    states, sizes = out.split("Largest error")[0], out.split("Largest error")[1].split("Outlying\n")[0]
    rows = {line.split()[0]: line.split()[1:] for line in states.splitlines() if line.startswith(" unit-")}
    assert tuple(rows) == UNITS  # unit-10 comes last
    assert rows[BROKEN] == ["failed"]
    symbol = SYMBOLS[INDEX["accel_scale_y"]]
    for number, name in enumerate(UNITS[:-1]):
        found = srt.load_calibration(output / f"{name}.json")
        ratio = found.consistency.chi_square / found.consistency.degrees_of_freedom
        assert rows[name][:3] == [f"SN-{number}", "converged", found.judgement.word]
        assert rows[name][3] == str(found.observed.sum())
        assert float(rows[name][4]) == pytest.approx(ratio, abs=0.0051)
        assert rows[name][6:] == [str(len(found.warnings)), symbol if name == ODD else "no"]
        shown = next(line.split() for line in sizes.splitlines() if line.startswith(f" {name} "))
        largest = max(found.errors.group("gyro_scale"), key=abs) * 1e6
        assert float(shown[1]) == pytest.approx(largest, abs=0.051)
        assert shown[5].endswith("*") == (name == ODD)


def test_tidy_table_is_complete_and_can_be_computed_again(made):
    output = made[-1]
    with (output / "fleet.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    good = [name for name in UNITS if name != BROKEN]
    assert [(r["unit"], r["parameter"]) for r in rows[:-1]] == [(name, p) for name in good for p in NAMES]
    assert rows[-1]["unit"] == BROKEN
    assert rows[-1]["parameter"] == rows[-1]["value"] == rows[-1]["flagged"] == ""
    assert "not a readable NPZ file" in rows[-1]["message"]
    calibrations = {name: srt.load_calibration(output / f"{name}.json") for name in good}
    for row in rows[:-1]:
        i, found = INDEX[row["parameter"]], calibrations[row["unit"]]
        least = min(c.sigma[i] for c in calibrations.values())
        values = [c.errors.vector[i] for c in calibrations.values()]
        others = [c.errors.vector[i] for name, c in calibrations.items() if name != row["unit"]]
        number = {key: float(row[key]) for key in ("value", "sigma", "fleet_median", "others_median", "z", "limit")}
        assert (number["value"], number["sigma"]) == (found.errors.vector[i], found.sigma[i])
        assert number["fleet_median"] == pytest.approx(np.median(values), rel=1e-12)
        assert number["others_median"] == pytest.approx(np.median(others), rel=1e-12)
        variance = float(row["others_scatter"]) ** 2 * (1.0 + np.pi / 12.0) + number["sigma"] ** 2 - least**2
        assert number["z"] == pytest.approx((number["value"] - number["others_median"]) / variance**0.5, rel=1e-9)
        assert (row["flagged"] == "True") == (abs(number["z"]) > number["limit"])
    document = json.loads((output / "fleet.json").read_text())
    assert document["columns"] == list(rows[0])
    assert [["" if v is None else str(v) for v in row] for row in document["rows"]] == [list(r.values()) for r in rows]


def test_progress_tells_what_is_done_and_the_time_left(made):
    lines = [line for line in made[2].splitlines() if not line.startswith("srt: ")]
    assert lines[0].startswith("unit-1: converged (1 of 8, about ")
    assert lines[0].endswith(" s left)")
    assert lines[-1] == f"{BROKEN}: failed (8 of 8)"


def test_two_workers_write_the_same_files(lot, made, tmp_path, monkeypatch, shell):
    pytest.importorskip("joblib")
    monkeypatch.chdir(lot.parent)
    assert shell("calibrate", lot.name, "-o", tmp_path, "--workers", "2", "-q", code=2).out == ""
    first = {p.name: p.read_bytes() for p in made[-1].iterdir()}
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == first


@pytest.mark.parametrize("pattern", ["{lot}/unit-[1-7]", "{lot}/unit-[1-7]/recording.toml", "{lot}/**/unit-[1-7]"])
def test_a_pattern_stands_for_what_it_matches(lot, quick, tmp_path, pattern, shell):
    output = tmp_path / "new" / "results"
    assert shell("calibrate", pattern.format(lot=lot), "-q", "-o", output) == ("", "")
    names = [unit["name"] for unit in json.loads((output / "fleet.json").read_text())["units"]]
    assert names == list(UNITS[:-1])


def test_folders_are_searched_however_deep(lot, tmp_path, quick, shell):
    for name in ("b/unit-1", "a/deep/unit-2", ".hidden/unit-3", "b/unit-1/inside/unit-4"):
        shutil.copytree(lot / "unit-1", tmp_path / "tree" / name)
    (tmp_path / "tree" / "b" / "notes.txt").write_text("no recording")
    expected = [tmp_path / "tree" / "a" / "deep" / "unit-2", tmp_path / "tree" / "b" / "unit-1"]
    found = find_recordings([tmp_path / "tree"])
    assert found.searched
    assert list(found.paths) == expected
    assert find_recordings([expected[1], tmp_path / "tree"]).paths == (expected[1], expected[0])  # a unit counts once
    assert not find_recordings([expected[0], tmp_path / "absent"]).searched
    out = shell("calibrate", tmp_path / "tree" / "b").out
    assert "Fleet of 1 unit\n" in out
    assert "needs 6 converged units with a parameter in common, and there is 1: no unit is tested." in " ".join(
        out.split()
    )


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_a_link_to_a_recording_is_one_and_no_circle_is_walked(lot, tmp_path):
    (tmp_path / "unit-1").symlink_to(lot / "unit-1")
    (tmp_path / "again").symlink_to(tmp_path)
    assert find_recordings([tmp_path]).paths == (tmp_path / "unit-1",)


def test_a_name_with_the_signs_of_a_pattern_is_itself(lot, tmp_path, quick):
    shutil.copytree(lot / "unit-1", tmp_path / "unit[1]")
    found = find_recordings([tmp_path / "unit[1]"])
    assert (found.paths, found.searched) == ((tmp_path / "unit[1]",), False)


def test_units_of_one_name_are_told_apart_by_the_folders_above():
    paths = [Path("/x/a/unit-1"), Path("/x/b/unit-1"), Path("/x/b/unit-2/recording.toml")]
    assert unit_names(paths) == ("a/unit-1", "b/unit-1", "b/unit-2")
    assert unit_names(paths[1:]) == ("unit-1", "unit-2")
    assert unit_names([Path("/lot/Fleet")]) == ("lot/Fleet",)  # whose file would be the fleet's own
    assert unit_names([Path("/x/a/b-c"), Path("/x/a-b/c")]) == ("b-c", "c")
    for paths in ([Path("/x/u"), Path("/x/U")], [Path("/x/u"), Path("/x/u/recording.toml")]):
        with pytest.raises(srt.InputError, match=r"differ in capitals or hyphens alone|is named twice"):
            unit_names(paths)


def test_six_recordings_are_a_fleet_and_five_are_not(lot, quick, shell):
    paths = [str(lot / name) for name in UNITS[:6]]
    out = shell("calibrate", *paths).out
    assert "Fleet of 6 units" in out
    assert "A value is outlying if z exceeds 26.7." in " ".join(out.split())
    assert "Nothing was written: -o FOLDER keeps" in out


def test_statuses_count_and_are_said(lot, quick, tmp_path, shell):
    quick |= {"status": "not_converged", "message": "It is not done."}
    out, err = shell("calibrate", lot / "unit-[1-7]", "-o", tmp_path, code=1)
    assert srt.load_calibration(tmp_path / "unit-3.json").status == "not_converged"
    assert f"srt: {lot / 'unit-3'}: It is not done; {tmp_path / 'unit-3.json'} holds it with that status." in err
    assert re.search(r"^ unit-3 +SN-2 +not conv\. .* not tested$", out, re.MULTILINE)
    assert "there are 0: no unit is tested." in " ".join(out.split())
    quick |= {"status": "partial", "fixed": {"gyro_bias_x": "not shown"}}
    err = shell("calibrate", lot / "unit-[1-7]", "-q").err
    assert err.startswith("srt: warning: some parameters are fixed, not observed, in 7 of 7: unit-1, unit-2, ")
    assert err.count("\n") == 1


def test_recordings_of_one_serial_are_named(lot, quick, tmp_path, shell):
    for name in ("a", "b"):
        shutil.copytree(lot / "unit-3", tmp_path / name)
    assert "2 recordings have the serial SN-2" in shell("calibrate", tmp_path, "-q").err


def test_a_result_that_cannot_be_written_stops_no_other(lot, quick, tmp_path, refused):
    (tmp_path / "unit-3.json").mkdir()
    err = refused("calibrate", lot / "unit-[1-4]", "-q", "-o", tmp_path)
    assert f"Cannot write {tmp_path / 'unit-3.json'}" in err
    assert (tmp_path / "unit-4.json").is_file()
    assert (tmp_path / "fleet.csv").is_file()
    assert not list(tmp_path.glob(".*"))


def test_plots_are_named_by_unit(lot, quick, tmp_path, shell):
    pytest.importorskip("matplotlib")
    shell("calibrate", lot / "unit-[1]", "-q", "--plot", tmp_path / "fig.svg")
    assert [p.name for p in tmp_path.iterdir()] == ["fig-unit-1.svg"]


def test_one_process_needs_no_extra(lot, quick, monkeypatch, shell, refused):
    monkeypatch.setitem(sys.modules, "threadpoolctl", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    shell("calibrate", lot / "unit-[12]", "-q")
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "joblib", None)
    assert "'joblib', which is not installed" in refused("calibrate", lot / "unit-[12]", "-q", "--workers", "2")


def test_progress_on_a_terminal_is_a_bar(lot, quick, monkeypatch, shell):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    out, err = shell("calibrate", lot / "unit-[12]")
    assert "\x1b" not in out
    assert "1 of 2" not in err
    monkeypatch.setitem(sys.modules, "rich.console", None)
    assert "unit-1: converged (1 of 2" in shell("calibrate", lot / "unit-[12]").err


def test_merge_takes_patterns_too(lot, calibration, tmp_path, shell, refused):
    for name in ("a", "b"):
        replace(calibration, provenance=Provenance(data_sha256=name)).save(tmp_path / f"{name}.json")
    out = shell("calibrate", "--merge", tmp_path / "*.json", "-o", tmp_path / "unit.json").out
    assert "Merged from 2 recordings" in out
    assert "at least two recordings of a unit" in refused("calibrate", "--merge", lot / "unit-[1]")


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["{lot}/absent-*"], "No recording matches the pattern {lot}/absent-*"),
        (["{lot}/unit-1/*.npz"], "No recording matches the pattern"),
        (["{empty}"], "holds no recording.toml"),
        (["{lot}", "-o", "{lot}/unit-1/recording.toml"], "is a file, but results go to a folder"),
        (["{lot}", "-o", "{lot}/all.json"], "The results of a fleet go to a folder"),
        (["{lot}", "--plot", "{lot}/all.txt"], "The plot cannot be written"),
        (["{lot}", "--truth", "{lot}/truth.json"], "--truth belongs to one recording"),
        (["{lot}", "--verdict"], "--budget and --verdict belong to the tables of few recordings"),
        (["{lot}", "--estimator", "nearest"], "There is no estimator 'nearest'"),
        (["{lot}", "--workers", "-1"], "Invalid value for '--workers'"),
        (["{lot}", "--merge", "--workers", "2"], "--merge goes without --workers"),
        (["{lot}/unit-1", "{lot}/unit-1", "--workers", "2"], "is named twice"),
    ],
)
def test_wrong_usage_is_one_sentence(lot, tmp_path, arguments, fragment, shell):
    names = {"lot": str(lot), "empty": str(tmp_path)}
    before = sorted(lot.rglob("*"))
    err = shell("calibrate", "-q", *(a.format(**names) for a in arguments), code=2).err
    assert fragment.format(**names) in err
    assert err.count("\n") == 1
    assert sorted(lot.rglob("*")) == before
