"""``srt watch``: a recording that grows, its messages, and an end result equal to that of ``srt calibrate``."""

import shutil
import threading
import time

import operator_errors as study
import pytest

import sims
import srt
from srt.cli import main
from srt.model.table1 import SEQUENCES

pytestmark = pytest.mark.usefixtures("plain_layout")

ORDER = tuple(SEQUENCES)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Write a whole test without labels, one with sequence 2 reversed, and one without sequence 3."""
    folder = tmp_path_factory.mktemp("tests")
    own = {"id": "back", "down": "z", "along_outer": "x", "rotations": (("x", -360.0),)}
    for name, order, custom in (
        ("good", ORDER, ()),
        ("reversed", ("1", "back", *ORDER[2:]), (own,)),
        ("skipped", (*ORDER[:2], *ORDER[3:]), ()),
    ):
        recording = sims.simulate(study.scenario("navigation-rlg", 21, order, custom)).recording
        srt.write_recording(recording.with_sequences(()), folder / name)
    return folder


@pytest.fixture(scope="module")
def calibrated(finished):
    """File of the calibration of the whole test."""
    assert main(["calibrate", str(finished / "good"), "-q", "-o", str(finished / "good.json")]) == 0
    return (finished / "good.json").read_bytes()


def grow(source, target, pieces, pause_s):
    """Append a file to another in pieces that end within lines."""
    data = source.read_bytes()
    size = -(-len(data) // pieces)
    with target.open("ab") as file:
        for k in range(pieces):
            file.write(data[k * size : (k + 1) * size])
            file.flush()
            time.sleep(pause_s)


def test_a_growing_recording_is_followed_and_its_result_is_that_of_calibrate(finished, calibrated, tmp_path, capfd):
    growing = tmp_path / "rec"
    growing.mkdir()
    shutil.copy(finished / "good" / "recording.toml", growing)
    writer = threading.Thread(target=grow, args=(finished / "good" / "samples.csv", growing / "samples.csv", 9, 0.15))
    writer.start()
    code = main(
        ["watch", str(growing), "--every", "0.1", "--idle", "1.5", "-o", str(tmp_path / "w.json"), "--plot",
         str(tmp_path / "w.png"), "--target", "gyro_scale=5"]
    )  # fmt: skip
    writer.join()
    out, err = capfd.readouterr()
    assert code == 0
    told = [line.split()[1] for line in err.splitlines() if line.startswith("sequence ")]
    assert told == list(ORDER)
    assert "All 17 sequences are done." in out
    assert "All targets are met" in out
    assert "Converged after" in out
    assert (tmp_path / "w.png").stat().st_size > 10_000
    assert (tmp_path / "w.json").read_bytes() == calibrated


def test_samples_in_a_subfolder_with_lines_that_are_no_text(finished, tmp_path, shell):
    """A comment in another encoding, and a damaged sample: the result is that of the file without them."""
    folder, whole = tmp_path / "rec", tmp_path / "whole"
    lines = (finished / "good" / "samples.csv").read_bytes().splitlines(keepends=True)
    damaged = [*lines[:1000], b"# 20 \xb0C\n", *lines[1000:5000], b"\xff" + lines[5000], *lines[5001:]]
    for place, content in ((folder, damaged), (whole, [*lines[:5000], *lines[5001:]])):
        (place / "data").mkdir(parents=True)
        text = (finished / "good" / "recording.toml").read_text()
        (place / "recording.toml").write_text(text.replace('"samples.csv"', '"data/samples.csv"'))
        (place / "data" / "samples.csv").write_bytes(b"".join(content))
    err = shell("watch", folder, "--idle", "0", "-q", "-o", tmp_path / "w.json").err
    assert f"{folder / 'data' / 'samples.csv'}: lines that are no text in UTF-8 are left out (line 1001, 5002): " in err
    shell("calibrate", whole, "-q", "-o", tmp_path / "c.json")
    assert (tmp_path / "w.json").read_bytes() == (tmp_path / "c.json").read_bytes()


@pytest.mark.parametrize("replaced", [True, False])
def test_a_samples_file_that_begins_anew_begins_the_test_anew(
    finished, calibrated, tmp_path, shell, monkeypatch, replaced
):
    """A logger that starts again, in a new file or in the same one: the rest of the old one is not read on."""
    folder = tmp_path / "rec"
    shutil.copytree(finished / "skipped", folder)
    samples, new = folder / "samples.csv", (finished / "good" / "samples.csv").read_bytes()
    begun = samples.read_bytes().splitlines(keepends=True)
    samples.write_bytes(b"".join(begun[: len(begun) // 3]))
    todo = [lambda: samples.rename(folder / "old")] * replaced + [lambda: samples.write_bytes(new)]
    # Between the looks, in place of the pause.
    monkeypatch.setattr(time, "sleep", lambda _: todo.pop(0)() if todo else None)
    err = shell("watch", folder, "--idle", "0.5", "-q", "-o", tmp_path / "w.json").err
    assert "Sequence 3, skipped" in err.partition("was cut or replaced: the test begins anew")[0]
    assert "skipped" not in err.partition("was cut or replaced: the test begins anew")[2]
    assert (tmp_path / "w.json").read_bytes() == calibrated


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        pytest.param("reversed", "Sequence 2, wrong direction: it was turned as sequence 2a", marks=pytest.mark.slow),
        ("skipped", "Sequence 3, skipped: the unit is at the start of sequence 1a"),
    ],
)
def test_an_open_error_is_named_and_gives_exit_code_1(finished, name, sentence, shell):
    assert sentence in shell("watch", finished / name, "--idle", "0", "-q", code=1).err


def test_refusals(finished, tmp_path, shell, refused):
    good = str(finished / "good")
    for arguments, sentence in (
        ([good, "--order", "1,99"], "no sequence '99'"),
        ([good, "--target", "gyro"], "NAME=SIGMA"),
        ([str(tmp_path)], "recording.toml"),
        ([good, "-o", "x.txt"], "x.txt"),
    ):
        assert sentence in refused("watch", *arguments, "--idle", "0")
    assert "kalman" in refused("watch", good, "--estimator", "kalman")
    labelled = tmp_path / "labelled"
    labelled.mkdir()
    document = (finished / "good" / "recording.toml").read_text()
    label = '[[sequence]]\nid = "1"\nstart_static_s = [9000.0, 9001.0]\nend_static_s = [9002.0, 9003.0]\n'
    (labelled / "recording.toml").write_text(f"{document}\n{label}")
    shutil.copy(finished / "good" / "samples.csv", labelled)
    err = shell("watch", labelled, "--idle", "0", code=2).err
    assert f"{labelled}: " in err
    assert "A test that still runs has no labels: remove [[sequence]] from recording.toml." in " ".join(err.split())
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copy(finished / "good" / "recording.toml", empty)
    assert "no sequence of Table 1 was found" in shell("watch", empty, "--idle", "0", code=1).err
