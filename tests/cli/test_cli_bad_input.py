"""A good recording, spoiled in one way, through ``srt calibrate``: exit code, one sentence, nothing half-written.

Refusals of the reader of a folder are in ``recording/test_recording_refusals``; one case of each of its files is here.
"""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from small_units import simulated

import srt

GYRO, ACCEL = slice(1, 4), slice(4, 7)


@pytest.fixture(scope="session")
def good(tmp_path_factory):
    """Make the recording that every case spoils a copy of."""
    # 50 Hz and windows of 2 s: small enough to calibrate in a moment, large enough for every check.
    exact = 'noise = false, state_noise = false, format = "csv"'
    folder = tmp_path_factory.mktemp("good") / "recording"
    return simulated(folder, seed=11, dwell_s=2.0, sample_rate_hz=50.0, recording=exact)


@dataclass
class Spoiled:
    """A copy of the recording and the means to spoil it."""

    folder: Path

    @property
    def csv(self):
        return self.folder / "samples.csv"

    @property
    def toml(self):
        return self.folder / "recording.toml"

    def without_sequence(self, name):
        head, *sequences = self.toml.read_text().split("\n[[sequence]]\n")
        kept = [s for s in sequences if not s.startswith(f'id = "{name}"\n')]
        assert len(kept) == len(sequences) - 1
        self.toml.write_text("\n[[sequence]]\n".join([head, *kept]))

    def samples(self, change):
        """Change the array of samples: time, gyro, accel."""
        header = self.csv.read_text().split("\n", 1)[0]
        values = np.loadtxt(self.csv, delimiter=",", skiprows=1)
        changed = change(values)
        values = values if changed is None else changed
        rows = [",".join(map(repr, row)) for row in values.tolist()]
        self.csv.write_text("\n".join([header, *rows]) + "\n")

    def turn(self, name):
        """Give the row numbers of the rotation of a sequence."""
        recording = srt.load_recording(self.folder)
        label = next(s for s in recording.sequences if s.id == name)
        start = recording.window_indices(*label.start_static_s).stop
        return np.arange(start, recording.window_indices(*label.end_static_s).start)


def word_for_a_number(r):
    lines = r.csv.read_text().splitlines()
    lines[100] = lines[100].replace(",", ",oops,", 1).rsplit(",", 1)[0]
    r.csv.write_text("\n".join(lines) + "\n")


def gap_in_a_turn(r):
    middle = int(r.turn("9").mean())
    r.samples(lambda v: np.delete(v, slice(middle - 5, middle + 5), axis=0))


def motion_in_a_window(r):
    start = r.turn("4")[0]
    r.samples(lambda v: v.__setitem__((slice(start - 60, start - 40), 1), 0.5))


def clipped_turn(r):
    rows = r.turn("9")
    stated = "\n[imu]\ngyro_range_deg_s = 200.0\n\n[[sequence]]"
    r.toml.write_text(r.toml.read_text().replace("\n[[sequence]]", stated, 1))
    r.samples(lambda v: v.__setitem__((rows[len(rows) // 2 :][:9], 3), np.radians(200.0)))


def truncated_toml(r):
    text = r.toml.read_text()
    r.toml.write_text(text[: text.rindex("end_static_s") + 18])


def columns(*order):
    """Take the samples' columns in another order; a minus takes a column with the other sign."""
    return lambda r: r.samples(lambda v: v[:, np.abs(order)] * np.where(np.signbit(np.float64(order)), -1.0, 1.0))


def scaled(part, change):
    return lambda r: r.samples(lambda v: v.__setitem__((slice(None), part), change(v[:, part])))


COST_OF_9 = ("accel_scale_x", "accel_asymmetry_x", "accel_misalignment_zx")

CASES = {
    "word for a number": (word_for_a_number, 2, ["samples.csv", "oops"]),
    "gap in a turn": (gap_in_a_turn, 0, ["Sequence '9'", "void", "samples are missing", *COST_OF_9]),
    "ends early": (
        lambda r: r.samples(lambda v: v[:-200]),
        2,
        ["Sequence '14'", "end_static_s", "the samples run from"],
    ),
    "no sequence 9": (lambda r: r.without_sequence("9"), 0, ["sequence 9", "missing", "fixed", *COST_OF_9]),
    "no sequence 1a": (lambda r: r.without_sequence("1a"), 0, ["sequence 1a", "gyro_asymmetry_y"]),
    "left-handed": (columns(0, 2, 1, 3, 5, 4, 6), 1, ["left-handed"]),
    "left-handed gyros": (columns(0, 2, 1, 3, 4, 5, 6), 1, ["Gyro axes x and y are swapped", "y,x,z"]),
    "flipped gyro": (columns(0, 1, 2, -3, 4, 5, 6), 1, ["gyro", "z"]),
    "flipped accelerometer": (columns(0, 1, 2, 3, -4, 5, 6), 1, ["Accelerometer axis x", "--map-accel -x,y,z"]),
    "flipped axis of the unit": (columns(0, 1, -2, 3, 4, -5, 6), 1, ["y"]),
    "accel in g": (scaled(ACCEL, lambda f: f / 9.80665), 1, ["look like g, declared as m/s²", "accel_unit"]),
    "gyro in degrees": (scaled(GYRO, np.degrees), 1, ["look like degrees, declared as radians", "gyro_unit"]),
    "accel in counts": (
        scaled(ACCEL, lambda f: np.rint(f * 83886.08 / 9.80665)),
        1,
        ["accelerometers", "counts", "accel_unit"],
    ),
    "accel in counts of 16 bits": (
        scaled(ACCEL, lambda f: np.rint(f * 8192 / 9.80665)),
        1,
        ["accelerometers", "9.807 m/s² is expected", "accel_unit"],
    ),
    "gyro in counts": (scaled(GYRO, lambda w: np.rint(w * 1e5)), 1, ["gyro", "counts", "gyro_unit"]),
    "gyro in counts of 16 bits": (
        scaled(GYRO, lambda w: np.rint(np.degrees(w) * 65.5)),
        1,
        ["times the expected ones", "counts", "gyro_unit", "gyro_lsb"],
    ),
    "motion in a window": (motion_in_a_window, 1, ["moves", "stationary window"]),
    "clipped turn": (clipped_turn, 0, ["Sequence '9'", "void", "gyro_z", "limit of its range", *COST_OF_9]),
    "no recording": (lambda r: shutil.rmtree(r.folder), 2, ["There is no recording"]),
    "truncated recording.toml": (truncated_toml, 2, ["recording.toml", "not valid TOML"]),
}
"""Edit that spoils the recording, exit code, and words that the sentence must hold."""


@pytest.mark.parametrize(("spoil", "code", "fragments"), CASES.values(), ids=CASES)
def test_bad_input(good, tmp_path, spoil, code, fragments, refused):
    folder = tmp_path / "recording"
    shutil.copytree(good, folder)
    spoil(Spoiled(folder))
    before = sorted(folder.iterdir()) if folder.exists() else []
    output = tmp_path / "results" / "calibration.json"
    output.parent.mkdir()

    sentence = refused("calibrate", folder, "-q", "-o", output, code=code)
    for fragment in fragments:
        assert fragment in sentence, sentence
    # The result is there if there is one, and whole; beside it nothing is left over.
    assert list(output.parent.iterdir()) == ([output] if code == 0 else [])
    assert (sorted(folder.iterdir()) if folder.exists() else []) == before
    if code == 0:
        calibration = srt.load_calibration(output)
        assert calibration.status == "partial"
        held = {name for name in fragments if "_" in name} & set(calibration.errors.as_dict())
        assert held == set(calibration.fixed)
        assert calibration.observed.sum() > 15


def test_the_good_recording_is_good(good, tmp_path, shell):
    output = tmp_path / "calibration.json"
    assert shell("calibrate", good, "-q", "-o", output) == ("", "")
    assert json.loads(output.read_text())["status"] == "converged"


@pytest.mark.parametrize(
    ("output", "fragments"),
    [
        ("absent/calibration.json", ["No such file"]),
        ("file/calibration.json", ["Not a directory"]),
        ("samples.csv", [".json"]),
        ("calibration", [".json"]),
        ("folder.json", ["folder.json"]),
    ],
)
@pytest.mark.parametrize("recording", ["good", "absent"])
def test_output_that_cannot_be_written_is_noticed_first(
    good, tmp_path, monkeypatch, output, fragments, recording, refused
):
    (tmp_path / "file").touch()
    (tmp_path / "folder.json").write_text("")
    if output == "folder.json":
        (tmp_path / "folder.json").unlink()
        (tmp_path / "folder.json").symlink_to(tmp_path / "nowhere" / "x.json")
    monkeypatch.setattr("srt.recording.folder.load_recording", lambda path: pytest.fail(f"{path} was read first"))
    path = good if recording == "good" else tmp_path / "absent"
    before = sorted(tmp_path.iterdir())

    sentence = refused("calibrate", path, "-o", tmp_path / output)
    for fragment in (*fragments, str(tmp_path / output)):
        assert fragment in sentence
    assert sorted(tmp_path.iterdir()) == before
