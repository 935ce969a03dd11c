"""Limits of the child process that reads logs: time, memory, truncated files and absent libraries."""

import importlib
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from log_samples import IMU_MESSAGES, STAMPS, US, VALUES, N, assert_same, ff, note, read

from srt.exceptions import InputError, MissingExtraError
from srt.recording.import_options import ImportOptions
from srt.recording.importer_registry import find_importer, import_file
from srt.recording.importers import child_process

# Guards


def allocate(path, options):
    return np.ones(1 << 40)


def loop(path, options):
    while True:
        pass


def crash(path, options):
    os.abort()


def fail(path, options):
    raise KeyError("a defect of the reader")


def shout(path, options):
    print("not an answer")
    os.write(1, b"not an answer")
    os.write(2, b"not an answer")
    raise InputError(f"{path} holds nothing.")


def in_child(name, path):
    return child_process.read_in_child(f"{__name__}:{name}", path, ImportOptions())


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits of a process are Linux's")
def test_a_reader_without_end_is_stopped_with_a_sentence(tmp_path, monkeypatch, capfd):
    path = tmp_path / "a"
    path.write_bytes(bytes(100))
    with pytest.raises(InputError, match=rf"{path} takes more than 512 MiB of memory to read, .* copy it again"):
        in_child("allocate", path)
    with pytest.raises(InputError, match=rf"{path} ended its reader \(exit code -6\): it is damaged"):
        in_child("crash", path)
    monkeypatch.setattr(child_process, "TIME_ALLOWANCE_S", 1)
    with pytest.raises(InputError, match=rf"{path} takes more than 2 s to read, .*: it is damaged"):
        in_child("loop", path)
    assert capfd.readouterr() == ("", "")


def test_a_child_answers_with_the_readers_own_error_and_nothing_else(tmp_path, capfd):
    path = tmp_path / "a"
    path.write_bytes(bytes(100))
    with pytest.raises(InputError, match=rf"^{path} holds nothing\.$"):
        in_child("shout", path)
    with pytest.raises(RuntimeError, match="a defect of the reader"):
        in_child("fail", path)
    assert capfd.readouterr() == ("", "")


def test_limits_grow_with_the_size_of_the_file(tmp_path):
    (tmp_path / "a").write_bytes(bytes(3 << 20))
    (tmp_path / "b").write_bytes(bytes(1 << 20))
    assert child_process.limits_for(tmp_path / "a") == ((512 + 96) << 20, 35)
    assert child_process.limits_for(tmp_path) == ((512 + 128) << 20, 40)


def test_without_limits_a_note_warns(tmp_path, monkeypatch):
    monkeypatch.setattr(child_process, "spawn", importlib.import_module("fuzz").InProcess)
    monkeypatch.setitem(sys.modules, "resource", None)
    assert not child_process.impose(child_process.ProcessLimits(1 << 30, 10))
    ff.write_ulog(tmp_path / "a.ulg", [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))])
    assert note(read(tmp_path / "a.ulg"), "does not limit the memory of a process")


def test_a_module_in_the_current_folder_is_not_imported(tmp_path, monkeypatch):
    """A log may lie beside a file that has the name of a library."""
    (tmp_path / "pyulog.py").write_text("raise SystemExit('imported')")
    (tmp_path / "json.py").write_text("raise SystemExit('imported')")
    ff.write_ulog(tmp_path / "a.ulg", [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))])
    monkeypatch.chdir(tmp_path)
    assert_same(read(Path("a.ulg")))


def test_an_index_that_is_read_again_and_again_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(child_process, "MEMORY_ALLOWANCE", 64 << 20)
    stamps, values = ff.samples(2000)
    path = tmp_path / "a.bag"
    ff.write_bag1(path, {"/imu": (stamps, values, "")})
    data = path.read_bytes()

    def number(at, width=4):
        return int.from_bytes(data[at : at + width], "little")

    # At the end stand the connection and the chunk, each as length, header, length, data.
    place = number(data.index(b"index_pos=") + 10, 8)
    place += 4 + number(place)
    place += 4 + number(place)
    more = 2000
    count = data.index(b"chunk_count=") + 12
    path.write_bytes(data[:count] + (1 + more).to_bytes(4, "little") + data[count + 4 :] + more * data[place:])
    # Of 24 bytes for each sample, the file would be read 2,000 times over, and all of it kept.
    with pytest.raises(InputError, match=r"takes more than \d+ MiB of memory"):
        read(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_bomb_in_a_bag_is_refused(tmp_path, monkeypatch, compression):
    """A chunk that grows to 192 MiB, where 64 MiB are allowed."""
    monkeypatch.setattr(child_process, "MEMORY_ALLOWANCE", 64 << 20)
    ff.write_bag1(tmp_path / "a.bag", {"/imu": (STAMPS, VALUES, "")}, compression)
    data = (tmp_path / "a.bag").read_bytes()
    library = importlib.import_module({"bz2": "bz2", "lz4": "lz4.frame"}[compression])
    bomb = library.compress(bytes(192 << 20)) if compression == "lz4" else 3 * library.compress(bytes(64 << 20))
    place = data.index(f"compression={compression}".encode())
    place += len(f"compression={compression}")
    # The header's last field is the size; after it stands the length of the chunk's data.
    place = data.index(b"size=", place) + 9
    length = int.from_bytes(data[place : place + 4], "little")
    index = data.index(b"index_pos=") + 10
    start = int.from_bytes(data[index : index + 8], "little") + len(bomb) - length
    data = data[:place] + len(bomb).to_bytes(4, "little") + bomb + data[place + 4 + length :]
    data = data[:index] + start.to_bytes(8, "little") + data[index + 8 :]
    (tmp_path / "a.bag").write_bytes(data)
    with pytest.raises(InputError, match=r"takes more than \d+ MiB of memory"):
        read(tmp_path / "a.bag")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One file of every format, with the name of its importer."""
    folder = tmp_path_factory.mktemp("whole")
    ff.write_bag1(folder / "a.bag", {"/imu": (STAMPS, VALUES, "")})
    for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
        ff.write_bag2(folder / storage, {"/imu": (STAMPS, VALUES, "")}, storage)
        (folder / storage / f"{storage}.{suffix}").rename(folder / f"a.{suffix}")
    ff.write_ulog(folder / "a.ulg", [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))])
    ff.write_dataflash(folder / "a.bin", IMU_MESSAGES)
    return {path.name: (path.read_bytes(), find_importer(path).name) for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("kept", [0, 10, 500, -1])
@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "a.ulg", "a.bin"])
def test_a_file_cut_off_gives_one_sentence_or_what_is_there(request, tmp_path, whole, name, kept, capfd):
    if kept != -1:  # one length with an interpreter of its own, as a user's
        request.getfixturevalue("forked_readers")
    data, importer = whole[name]
    (tmp_path / name).write_bytes(data[:kept])
    if name in ("a.ulg", "a.bin") and kept in (500, -1):
        # Logs end where the power was cut: all whole messages count.
        imported = import_file(tmp_path / name, None, importer)[1]
        assert 0 < len(imported.time) < N
        np.testing.assert_array_equal(imported.gyro, VALUES[: len(imported.time), :3])
    else:
        with pytest.raises(InputError, match=name) as caught:
            import_file(tmp_path / name, None, importer)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("package", "name"), [("rosbags", "a.bag"), ("pyulog", "a.ulg"), ("pymavlink", "a.bin")])
def test_an_absent_library_is_named_with_its_extra(tmp_path, whole, monkeypatch, package, name):
    (tmp_path / name).write_bytes(whole[name][0])
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"'{package}'.*strapdown-rotation-test\[formats\]"):
        read(tmp_path / name)
