"""Writes of every command: whichever call fails, each file is the old or the new one, and nothing else remains.

A file of other origin, or one that was changed, is kept unless ``--overwrite`` is given.
"""

import errno
import os
import re
import shutil
import tempfile
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from failing_calls import FailingCalls
from mount_motion import simulate_mount
from small_units import simulated

import srt
from sims.physics.imu import ImuModel, read_out
from srt.cli import main
from srt.cli.app import COMMANDS
from srt.exporters import export, save
from srt.result.provenance import Temperature
from srt.sensor_errors import SensorErrors

pytestmark = pytest.mark.usefixtures("blank_figures")

PLAN = """
imu = { from = "tactical-fog" }
fixture = { from = "lab-1mrad" }
site = { from = "latitude-45" }
targets = { accel_bias_ug = 2000.0 }
plan = { most_legs = 1, largest_turn_deg = 180, most_sequences = 6, total_time_s = 120.0 }
recording = { sample_rate_hz = 50.0 }
"""
CAMPAIGN = """
campaign = { name = "small", seed = 7, trials = 2 }
grid = { scale_percent = [5], misalignment_mrad = [30] }
estimator = [{ name = "closed-form" }]
[scenario]
from = "robustness"
errors = { draw = "uniform", factor = 1.0 }
schedule = { dwell_s = 2.0, rate_rad_s = 2.0 }
recording = { sample_rate_hz = 50.0 }
"""

ROWS = {
    "simulate": "simulate {lab}/3.toml -o {out}/unit",
    "simulate over": "simulate {lab}/3.toml -o {out}/unit --samples-format csv",
    "simulate parquet": "simulate {lab}/3.toml -o {out}/unit --samples-format parquet",
    "simulate h5": "simulate {lab}/3.toml -o {out}/unit --samples-format h5",
    "convert": "convert {lab}/3/samples.csv -o {out}/unit --samples-format npz --gyro-unit rad/s --accel-unit m/s^2"
    " --time-unit s --gravity-m-s2 9.81",
    "apply": "apply {lab}/3.json {lab}/3 -o {out}/corrected --c-header {out}/unit.h",
    "export": "export {lab}/3.json --to kalibr -o {out}/imu.yaml",
    "calibrate": "calibrate {lab}/3 -o {out}/3.json",
    "noise": "noise {lab}/rest -o {out}/noise.json",
    "noise into": "noise {lab}/rest --into {out}/3.json",
    "inspect": "inspect {lab}/3 -o {out}/inspection.json",
    "budget": "budget {lab}/3.toml --paper -o {out}/budget.json",
    "plan": "plan {lab}/plan.toml -o {out}/s.toml --sheet {out}/s.md --json {out}/s.json",
    "align-mount": "align-mount {lab}/mount --calibration {lab}/3.json -o {out}/mount.json",
    "merge": "calibrate --merge {lab}/3.json {lab}/4.json -o {out}/both.json",
    "thermal": "thermal {lab}/cold.json {lab}/warm.json -o {out}/thermal.json",
    "watch": "watch {lab}/3 --idle 0 -o {out}/w.json",
    "compare": "compare {lab}/3 --estimator closed-form --estimator least-squares -o {out}/c.json",
    "calibrate log": "calibrate {lab}/3/samples.csv -o {out}/log --to c-header --gyro-unit rad/s --accel-unit m/s^2"
    " --time-unit s --latitude-deg 45 --height-m 0",
    "compare with": "compare {lab}/3.json {lab}/3 --with {lab}/3-pyins.json -o {out}/c.json",
    "fleet": "calibrate {lab}/[345] -o {out}/fleet",
    "replay": "robustness {lab}/campaign.toml --replay 0:1 -o {out}/trial",
    "robustness": "robustness {lab}/campaign.toml -o {out}/campaign --markdown {out}/campaign.md --workers 1",
    "calibrate plot": "calibrate {lab}/3 -o {out}/3.json --plot {out}/3.png",
    "inspect plot": "inspect {lab}/3 --plot {out}/inspection.svg",
    "noise plot": "noise {lab}/rest --plot {out}/noise.pdf",
    "certificate": "certificate {lab}/3.json -o {out}/certificate.html",
    "demo": "demo -o {out}/demo",
}
"""Command lines; "over" writes over what an earlier run left."""
LONG = {"compare", "fleet", "replay", "robustness", "calibrate plot", "inspect plot", "noise plot", "certificate",
        "calibrate log", "demo", "watch", "noise", "noise into", "budget", "inspect", "plan"}  # fmt: skip
"""Rows of more than half a second."""
WITHOUT_OUTPUT = {"list"}
WRITES_RECORDINGS = {"simulate", "convert", "apply", "replay"}
UNNAMED = {
    "certificate": ["certificate.pdf"],
    "fleet": ["fleet/3.json", "fleet/fleet.csv", "fleet/fleet.json"],
    "demo": ["demo/calibration.json", "demo/calibration.png", "demo/recording/recording.toml"],
    "robustness": ["campaign/report.html", "campaign/campaign.toml", "campaign/results.parquet"],
    "export": ["imu-imu.yaml"],
    "replay": ["trial/recording.toml"],
    "simulate": ["unit/recording.toml"],
    "convert": ["unit/recording.toml"],
    "apply": ["corrected/recording.toml"],
}
"""Files that a row writes beside those that its command line names."""
JOURNAL = {"campaign/journal.jsonl"}
"""Appended to: complete but for its last line."""


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    """Hold recordings and calibrations that no row changes."""
    folder = tmp_path_factory.mktemp("disk")
    for seed in (3, 4, 5):
        simulated(folder / str(seed), seed=seed, dwell_s=2.0, sample_rate_hz=50.0, recording='format = "csv"')
        srt.calibrate(srt.load_recording(folder / str(seed))).save(folder / f"{seed}.json")
    calibrated = srt.load_calibration(folder / "3.json")
    save(export(calibrated, "pyins"), folder / "3-pyins.json")
    for name, seed, mean_c in (("cold", 3, -10.0), ("warm", 4, 50.0)):
        soaked = replace(srt.load_calibration(folder / f"{seed}.json"), temperature=Temperature(mean_c, 0.0))
        soaked.save(folder / f"{name}.json")
    noise = np.random.default_rng(1).normal([0.0, 0.0, 0.0, 0.0, 0.0, 9.81], 1e-4, (2000, 6))
    at_rest = srt.Recording(0.02 * np.arange(1, 2001), noise[:, :3], noise[:, 3:], srt.Site(9.81))
    srt.write_recording(at_rest, folder / "rest")
    (folder / "plan.toml").write_text(PLAN)
    (folder / "campaign.toml").write_text(CAMPAIGN)
    site = srt.Site(9.80665, latitude_rad=0.8)
    motion = simulate_mount(
        np.array([0.004, -0.003, 0.006]), site=site, pitch_rad=(0.0, -1.5708), dwell_s=3.0, sample_rate_hz=50.0,
        labelled=False,
    )  # fmt: skip
    imu = ImuModel(gyro_noise=1e-5, accel_noise=1e-5)
    srt.write_recording(read_out(motion, SensorErrors(), imu, np.random.default_rng(4)), folder / "mount")
    return folder


def arguments(row, lab, out):
    return [word.format(lab=lab, out=out) for word in ROWS[row].split()]


def content(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def same(name, found, expected):
    """Compare contents but for numbers and hashes, which are times and names of clips where two runs differ."""
    if name.endswith((".parquet", ".pdf", "report.html")):  # compressed, or with times: as the format begins and ends
        return (found[:4], found.strip()[-4:]) == (expected[:4], expected.strip()[-4:])
    number = re.compile(rb"[0-9a-f]*[0-9][0-9a-f]*")
    return found == expected or number.sub(b"0", found) == number.sub(b"0", expected)


class Row:
    """One command line with what a clean run of it leaves."""

    def __init__(self, row, lab, place, capfd):
        self.row, self.lab, self.place, self.capfd = row, lab, place, capfd
        self.old = {}
        if row == "noise into":
            self.old = {"3.json": (lab / "3.json").read_bytes()}
        code, self.said, self.new, calls = self.run(-1)
        assert code in (0, 1), self.said
        self.calls = calls.calls
        beside = {name: b"old" for name in self.new if "/" not in name}
        self.old = beside | self.old | (self.new if " over" in row else {})

    def run(self, failing, number=errno.ENOSPC):
        """Exit code, lines of standard error, files and calls."""
        shutil.rmtree(self.place, ignore_errors=True)
        for name in ("out", "tmp"):
            (self.place / name).mkdir(parents=True)
        for name, data in self.old.items():
            path = self.place / "out" / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(data)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(tempfile, "tempdir", str(self.place / "tmp"))
            layer = FailingCalls(patch, self.place, failing, number)
            code = main([*arguments(self.row, self.lab, self.place / "out"), "-q", "--overwrite"])
        found = content(self.place / "out")
        if code == 0:  # without links, the new samples keep the other name
            found = {name.replace("-2.", "."): data.replace(b"samples-2.", b"samples.") for name, data in found.items()}
        assert not list((self.place / "tmp").iterdir()) or layer.failed in ("unlink", "rmdir")
        return code, self.capfd.readouterr().err.splitlines(), found, layer

    def check(self, failing, number):
        code, said, found, layer = self.run(failing, number)
        told = [line for line in said if line not in self.said]
        where = f"{self.row}: call {failing} ({layer.failed}) of {len(self.calls)}, exit {code}: {told}"
        if code not in (0, 1) or told:
            assert code in (1, 2), where
            assert len(told) == 1, where
            assert told[0].startswith("srt: "), where
            assert os.strerror(number) in told[0] or "cannot" in told[0], where
        left = set(found) - set(self.old) - set(self.new)
        assert not left or layer.failed == "unlink", f"{where}: {left}"
        for name in set(self.old) | (set(self.new) if code == 0 else set()):
            assert name in found, f"{where}: {name} is lost"
        for name in set(found) & (set(self.old) | set(self.new)) - JOURNAL:
            whole = [each[name] for each in (self.old, self.new) if name in each]
            assert any(same(name, found[name], each) for each in whole), f"{where}: {name} is neither old nor new"

    def points(self, rng):
        """Numbers of all calls; of successive writes the first, the last and one between."""
        kinds = np.array(self.calls)
        begins = np.flatnonzero(np.r_[True, (kinds[1:] != "write") | (kinds[:-1] != "write")])
        ends = np.r_[begins[1:], len(kinds)] - 1
        return sorted({*begins.tolist(), *ends.tolist(), *rng.integers(begins, ends + 1).tolist()})


def test_every_command_that_writes_has_a_row():
    forms = {"calibrate": {"merge", "fleet"}, "robustness": {"replay"}}
    assert {row.split()[0] for row in ROWS} == {
        *COMMANDS,
        *(f for each in forms.values() for f in each),
    } - WITHOUT_OUTPUT


@pytest.mark.parametrize("row", [name for name in ROWS if name not in LONG])
def test_a_failing_call_leaves_old_or_new(row, lab, tmp_path, capfd):
    rng = np.random.default_rng(20261123)
    made = Row(row, lab, tmp_path, capfd)
    assert len(made.calls) > 3
    for failing in rng.choice(made.points(rng), 2, replace=False).tolist():
        made.check(failing, errno.ENOSPC)


def outputs(row, out):
    """Files that a row writes: named on the command line, or not."""
    named = re.findall(r"{out}/(\S+\.\w+)", ROWS[row])
    return [out / name for name in (*named, *UNNAMED.get(row, UNNAMED.get(row.split()[0], ())))]


def snapshot(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


@pytest.mark.parametrize("row", ROWS)
def test_a_file_of_other_origin_is_kept(row, lab, tmp_path, capfd):
    for number in range(len(outputs(row, tmp_path))):
        out = tmp_path / str(number)
        path = outputs(row, out)[number]
        path.parent.mkdir(parents=True)
        path.write_bytes(b'{"by": "hand"}')
        assert main([*arguments(row, lab, out), "-q"]) == 2
        said = capfd.readouterr().err
        assert said.startswith("srt: ")
        assert any(words in said for words in ("add --overwrite", "name another folder")), said
        assert snapshot(out) == {path: b'{"by": "hand"}'}


@pytest.mark.parametrize("row", [row for row in ROWS if row.split()[0] not in WRITES_RECORDINGS])
def test_nothing_is_written_into_a_recording(row, lab, capfd):
    before = snapshot(lab)
    assert main([*arguments(row, lab, lab / "3"), "-q"]) == 2
    assert "is the folder of a recording" in capfd.readouterr().err
    assert snapshot(lab) == before


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, marks=[pytest.mark.campaign] * (row in LONG))
        for row in ROWS
        if row.split()[0] not in WRITES_RECORDINGS and row != "noise into"
    ],
)
def test_an_own_file_is_replaced_until_it_is_changed(row, lab, tmp_path, capfd):
    line = [*arguments(row, lab, tmp_path), "-q"]
    code = main(line)
    capfd.readouterr()
    assert main(line) == code
    said = capfd.readouterr().err
    written = [path for path in outputs(row, tmp_path) if path.name not in ("campaign.toml", "results.parquet")]
    for path in written:
        assert f"{path}" in said or path.name == "recording.toml"
        assert path.exists()
    assert "replaced: earlier results, unchanged since." in said
    for path in written:
        if path.suffix in (".png", ".pdf", ".svg", ".html"):
            continue
        whole = path.read_bytes()
        path.write_bytes(whole.replace(b"1", b"2", 1))
        assert main(line) == 2
        assert "add --overwrite" in capfd.readouterr().err
        path.write_bytes(whole)


IN_SLOW_TESTS = {("export", errno.ENOSPC), ("calibrate", errno.EIO), ("merge", errno.ENOSPC)}
"""The commands that call least; the others are a campaign."""


@pytest.mark.parametrize(
    ("row", "number"),
    [
        pytest.param(*case, marks=pytest.mark.slow if case in IN_SLOW_TESTS else pytest.mark.campaign)
        for case in product(ROWS, (errno.ENOSPC, errno.EIO))
    ],
)
def test_each_failing_call_leaves_old_or_new(row, number, lab, tmp_path, capfd):
    rng = np.random.default_rng(20261123)
    made = Row(row, lab, tmp_path, capfd)
    for failing in made.points(rng):
        made.check(failing, number)
