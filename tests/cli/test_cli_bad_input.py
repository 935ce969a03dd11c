"""A good recording, spoiled in one way, through ``srt calibrate``: exit code, one sentence, nothing half-written."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import srt
from srt.cli import main

# 50 Hz and windows of 2 s: small enough to calibrate in a moment, large enough for every check.
SCENARIO = """
seed = 11
imu = { from = "navigation-rlg" }
fixture = { from = "lab-1mrad" }
site = { from = "latitude-45" }
schedule = { dwell_s = 2.0, rate_rad_s = 3.0, acceleration_rad_s2 = 30.0, settle_s = 0.1, leg_dwell_s = 0.2 }
recording = { sample_rate_hz = 50.0, noise = false, state_noise = false, format = "csv" }
"""
GYRO, ACCEL = slice(1, 4), slice(4, 7)


@pytest.fixture(scope="session")
def good(tmp_path_factory):
    """Make the recording that every case spoils a copy of."""
    folder = tmp_path_factory.mktemp("good")
    (folder / "scenario.toml").write_text(SCENARIO)
    assert main(["simulate", str(folder / "scenario.toml"), "-o", str(folder / "recording"), "-q"]) == 0
    return folder / "recording"


@dataclass
class Spoiled:
    """A copy of the recording and the means to spoil it."""

    folder: Path

    @property
    def csv(self) -> Path:
        return self.folder / "samples.csv"

    @property
    def toml(self) -> Path:
        return self.folder / "recording.toml"

    def replace(self, old: str, new: str) -> None:
        text = self.toml.read_text()
        assert old in text
        self.toml.write_text(text.replace(old, new, 1))

    def without_sequence(self, name: str) -> None:
        head, *sequences = self.toml.read_text().split("\n[[sequence]]\n")
        kept = [s for s in sequences if not s.startswith(f'id = "{name}"\n')]
        assert len(kept) == len(sequences) - 1
        self.toml.write_text("\n[[sequence]]\n".join([head, *kept]))

    def samples(self, change: Callable[[np.ndarray], np.ndarray | None]) -> None:
        """Change the array of samples: time, gyro, accel."""
        header = self.csv.read_text().split("\n", 1)[0]
        values = np.loadtxt(self.csv, delimiter=",", skiprows=1)
        changed = change(values)
        values = values if changed is None else changed
        rows = [",".join(map(repr, row)) for row in values.tolist()]
        self.csv.write_text("\n".join([header, *rows]) + "\n")

    def lines(self, change: Callable[[list[str]], None]) -> None:
        lines = self.csv.read_text().splitlines()
        change(lines)
        self.csv.write_text("\n".join(lines) + "\n")

    def turn(self, name: str) -> np.ndarray:
        """Give the row numbers of the rotation of a sequence."""
        recording = srt.load_recording(self.folder)
        label = next(s for s in recording.sequences if s.id == name)
        start = recording.window_indices(*label.start_static_s).stop
        return np.arange(start, recording.window_indices(*label.end_static_s).start)

    def as_npz(self, **changes: np.ndarray) -> None:
        values = np.loadtxt(self.csv, delimiter=",", skiprows=1)
        names = self.csv.read_text().split("\n", 1)[0].split(",")
        np.savez(self.folder / "samples.npz", **(dict(zip(names, values.T, strict=True)) | changes))
        self.csv.unlink()
        self.replace("samples.csv", "samples.npz")


def missing_column(r: Spoiled) -> None:
    r.lines(lambda lines: lines.__setitem__(slice(None), [line.rsplit(",", 1)[0] for line in lines]))


def not_a_number(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((500, 2), np.nan))


def word_for_a_number(r: Spoiled) -> None:
    r.lines(lambda lines: lines.__setitem__(100, lines[100].replace(",", ",oops,", 1).rsplit(",", 1)[0]))


def unequal_lengths(r: Spoiled) -> None:
    values = np.loadtxt(r.csv, delimiter=",", skiprows=1)
    r.as_npz(accel_y=values[:-3, 5])


def short_row(r: Spoiled) -> None:
    r.lines(lambda lines: lines.__setitem__(200, lines[200].rsplit(",", 2)[0]))


def time_backwards(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__(([300, 301], 0), v[[301, 300], 0]))


def time_repeated(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((300, 0), v[299, 0]))


def gap_in_a_turn(r: Spoiled) -> None:
    middle = int(r.turn("9").mean())
    r.samples(lambda v: np.delete(v, slice(middle - 5, middle + 5), axis=0))


def window_outside(r: Spoiled) -> None:
    r.replace("start_static_s = [0.0, 2.0]", "start_static_s = [-9.0, 2.0]")


def window_after_the_end(r: Spoiled) -> None:
    r.samples(lambda v: v[:-200])


def unknown_sequence(r: Spoiled) -> None:
    r.replace('id = "14"', 'id = "15"')


def left_handed(r: Spoiled) -> None:
    r.samples(lambda v: v[:, [0, 2, 1, 3, 5, 4, 6]])


def left_handed_gyros(r: Spoiled) -> None:
    r.samples(lambda v: v[:, [0, 2, 1, 3, 4, 5, 6]])


def flipped_gyro(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), 3), -v[:, 3]))


def flipped_accelerometer(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), 4), -v[:, 4]))


def flipped_unit_axis(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), [2, 5]), -v[:, [2, 5]]))


def accel_in_g(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), ACCEL), v[:, ACCEL] / 9.80665))


def gyro_in_degrees(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), GYRO), np.degrees(v[:, GYRO])))


def accel_in_counts(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), ACCEL), np.rint(v[:, ACCEL] * 83886.08 / 9.80665)))


def accel_in_counts_of_16_bits(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), ACCEL), np.rint(v[:, ACCEL] * 8192 / 9.80665)))


def gyro_in_counts(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), GYRO), np.rint(v[:, GYRO] * 1e5)))


def gyro_in_counts_of_16_bits(r: Spoiled) -> None:
    r.samples(lambda v: v.__setitem__((slice(None), GYRO), np.rint(np.degrees(v[:, GYRO]) * 65.5)))


def motion_in_a_window(r: Spoiled) -> None:
    start = r.turn("4")[0]
    r.samples(lambda v: v.__setitem__((slice(start - 60, start - 40), 1), 0.5))


def clipped_turn(r: Spoiled) -> None:
    rows = r.turn("9")
    r.toml.write_text(
        r.toml.read_text().replace("\n[[sequence]]", "\n[imu]\ngyro_range_deg_s = 200.0\n\n[[sequence]]", 1)
    )
    limit = np.radians(200.0)
    r.samples(lambda v: v.__setitem__((rows[len(rows) // 2 :][:9], 3), limit))


def no_gravity(r: Spoiled) -> None:
    r.replace("gravity_m_s2 = 9.80665\n", "")


def garbage(r: Spoiled) -> None:
    r.csv.write_bytes(bytes(range(256)) * 40)


def truncated_npz(r: Spoiled) -> None:
    r.as_npz()
    file = r.folder / "samples.npz"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def truncated_csv(r: Spoiled) -> None:
    data = r.csv.read_bytes()
    last = data.rstrip(b"\n").rfind(b"\n")
    r.csv.write_bytes(data[: last + 30])


def truncated_toml(r: Spoiled) -> None:
    text = r.toml.read_text()
    r.toml.write_text(text[: text.rindex("end_static_s") + 18])


def no_recording(r: Spoiled) -> None:
    shutil.rmtree(r.folder)


COST_OF_9 = ("accel_scale_x", "accel_asymmetry_x", "accel_misalignment_zx")

CASES = [
    # spoil, exit code, what the sentence must hold
    (missing_column, 2, ["samples.csv", "accel_z"]),
    (not_a_number, 2, ["gyro_y", "finite"]),
    (word_for_a_number, 2, ["samples.csv", "oops"]),
    (unequal_lengths, 2, ["accel_y"]),
    (short_row, 2, ["samples.csv", "201"]),
    (time_backwards, 2, ["time", "increas"]),
    (time_repeated, 2, ["time", "increas"]),
    (gap_in_a_turn, 0, ["Sequence '9'", "void", "samples are missing", *COST_OF_9]),
    (window_outside, 2, ["Sequence '1'", "start_static_s", "-9", "the samples run from"]),
    (window_after_the_end, 2, ["Sequence '14'", "end_static_s", "the samples run from"]),
    (unknown_sequence, 2, ["'15'", "Table 1"]),
    (lambda r: r.without_sequence("9"), 0, ["sequence 9", "missing", "fixed", *COST_OF_9]),
    (lambda r: r.without_sequence("1a"), 0, ["sequence 1a", "gyro_asymmetry_y"]),
    (left_handed, 1, ["left-handed"]),
    (left_handed_gyros, 1, ["Gyro axes x and y are swapped", "y,x,z"]),
    (flipped_gyro, 1, ["gyro", "z"]),
    (flipped_accelerometer, 1, ["accelerometer", "x"]),
    (flipped_unit_axis, 1, ["y"]),
    (accel_in_g, 1, ["accelerometers", "look like g, declared as m/s²", "accel_unit"]),
    (gyro_in_degrees, 1, ["gyro readings look like degrees, declared as radians", "gyro_unit"]),
    (accel_in_counts, 1, ["accelerometers", "counts", "accel_unit"]),
    (accel_in_counts_of_16_bits, 1, ["accelerometers", "9.807 m/s² is expected", "accel_unit"]),
    (gyro_in_counts, 1, ["gyro", "counts", "gyro_unit"]),
    (gyro_in_counts_of_16_bits, 1, ["times the expected ones", "counts", "gyro_unit", "gyro_lsb"]),
    (lambda r: r.replace("latitude_deg = 45.0", "latitude_deg = 95.0"), 2, ["latitude", "95", "90"]),
    (lambda r: r.replace("9.80665", "980.665"), 2, ["980.665", "m/s²"]),
    (no_gravity, 2, ["gravity_m_s2", "height_m"]),
    (motion_in_a_window, 1, ["moves", "stationary window"]),
    (clipped_turn, 0, ["Sequence '9'", "void", "gyro_z", "limit of its range", *COST_OF_9]),
    (lambda r: r.csv.unlink(), 2, ["samples.csv"]),
    (lambda r: r.toml.unlink(), 2, ["recording.toml"]),
    (no_recording, 2, ["There is no recording"]),
    (garbage, 2, ["samples.csv"]),
    (lambda r: r.csv.write_text(""), 2, ["samples.csv"]),
    (truncated_npz, 2, ["samples.npz"]),
    (truncated_csv, 2, ["samples.csv"]),
    (truncated_toml, 2, ["recording.toml", "not valid TOML"]),
]


def name_of(case: object) -> str | None:
    return getattr(case, "__name__", None) if callable(case) else None


def one_sentence(text: str) -> str:
    """Check that a text is one line with one sentence for a person; give it back."""
    assert text.startswith("srt: ")
    assert text.count("\n") == 1
    assert text.endswith("\n")
    sentence = text.removeprefix("srt: ").rstrip("\n")
    assert sentence.endswith((".", "?"))
    # A full stop inside would be followed by a capital; figures and file names are not.
    assert not re.search(r"[.?!] [A-Z]", sentence), sentence
    return sentence


@pytest.mark.parametrize(("spoil", "code", "fragments"), CASES, ids=name_of)
def test_bad_input(good, tmp_path, capfd, spoil, code, fragments):
    folder = tmp_path / "recording"
    shutil.copytree(good, folder)
    spoil(Spoiled(folder))
    before = sorted(folder.iterdir()) if folder.exists() else []
    output = tmp_path / "results" / "calibration.json"
    output.parent.mkdir()

    assert main(["calibrate", str(folder), "-q", "-o", str(output)]) == code

    out, err = capfd.readouterr()
    assert out == ""
    sentence = one_sentence(err)
    for fragment in fragments:
        assert fragment in sentence, sentence
    # The result is there if there is one, and whole; beside it nothing is left over.
    assert list(output.parent.iterdir()) == ([output] if code == 0 else [])
    assert (sorted(folder.iterdir()) if folder.exists() else []) == before
    if code == 0:
        calibration = srt.load_calibration(output)
        assert calibration.status == "partial"
        held = {name for name in fragments if "_" in name} & set(calibration.errors.as_dict())
        assert held <= set(calibration.held)
        assert calibration.observed.sum() > 15


def test_the_good_recording_is_good(good, tmp_path, capfd):
    output = tmp_path / "calibration.json"
    assert main(["calibrate", str(good), "-q", "-o", str(output)]) == 0
    assert capfd.readouterr() == ("", "")
    assert json.loads(output.read_text())["status"] == "converged"


def test_sequence_9_costs_what_the_formulas_say(good, tmp_path):
    """The parameters named above are all that sequence 9 costs: all else is still found."""
    folder = tmp_path / "recording"
    shutil.copytree(good, folder)
    Spoiled(folder).without_sequence("9")
    calibration = srt.calibrate(srt.load_recording(folder))
    assert set(calibration.held) == set(COST_OF_9)


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
    good, tmp_path, capfd, monkeypatch, output, fragments, recording
):
    (tmp_path / "file").touch()
    (tmp_path / "folder.json").write_text("")
    if output == "folder.json":
        (tmp_path / "folder.json").unlink()
        (tmp_path / "folder.json").symlink_to(tmp_path / "nowhere" / "x.json")
    monkeypatch.setattr("srt.recording.folder.load_recording", lambda path: pytest.fail(f"{path} was read first"))
    path = good if recording == "good" else tmp_path / "absent"
    before = sorted(tmp_path.iterdir())

    assert main(["calibrate", str(path), "-o", str(tmp_path / output)]) == 2

    sentence = one_sentence(capfd.readouterr().err)
    for fragment in (*fragments, str(tmp_path / output)):
        assert fragment in sentence
    assert sorted(tmp_path.iterdir()) == before
