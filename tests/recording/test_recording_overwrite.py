"""Overwriting a recording: whatever call fails, the folder has the old or the new recording, complete."""

import errno
import os

import numpy as np
import pytest
from failing_calls import FailingCalls

from srt.exceptions import InputError
from srt.recording.folder import load_recording
from srt.recording.recording import Recording, Site
from srt.recording.samples import SAMPLES_FORMATS
from srt.recording.writing import write_recording

OLD, NEW = 40, 60
ZIP_LEFT_OPEN = (
    pytest.mark.filterwarnings("ignore:Exception ignored in.*ZipFile:pytest.PytestUnraisableExceptionWarning")
    if np.lib.NumpyVersion(np.__version__) < "2.2.0"
    else lambda test: test
)
"""Before 2.2, numpy leaves the archive of a failed ``savez`` open: its destructor writes to a closed file."""


def recording(n):
    rng = np.random.default_rng(n)
    return Recording(0.01 * np.arange(1, n + 1), rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), Site(9.8))


def folder_with_old(path, samples_format):
    write_recording(recording(OLD), path, samples_format=samples_format)
    (path / "notes.txt").write_text("kept")
    return {p.name: p.read_bytes() for p in path.iterdir()}


@ZIP_LEFT_OPEN
@pytest.mark.parametrize("samples_format", SAMPLES_FORMATS)
def test_each_failing_call_leaves_a_complete_recording(tmp_path, samples_format):
    failing, failed = 0, []
    while True:
        folder = tmp_path / str(failing)
        before = folder_with_old(folder, samples_format)
        error = None
        with pytest.MonkeyPatch.context() as patch:
            layer = FailingCalls(patch, folder, failing)
            try:
                write_recording(recording(NEW), folder, samples_format=samples_format, overwrite=True)
            except InputError as refused:
                error = refused
        loaded = load_recording(folder)
        now = {p.name: p.read_bytes() for p in folder.iterdir()}
        assert now["notes.txt"] == b"kept"
        if error is not None:
            assert "No space left" in str(error)
            assert {name: now[name] for name in before} == before
        else:
            assert np.array_equal(loaded.gyro, recording(NEW).gyro)
        if len(layer.calls) <= failing:
            break
        failed.append((layer.calls[failing], error is not None))
        failing += 1
    # Opening, syncing and renaming the samples, and the same for recording.toml, end with an error.
    assert {name for name, refused in failed if refused} >= {"open", "fsync", "replace"}
    assert samples_format != "csv" or ("write", True) in failed
    assert sum(refused for _, refused in failed) >= 5
    assert error is None
    assert sorted(now) == ["notes.txt", "recording.toml", f"samples.{samples_format}"]


def test_nothing_is_left_of_a_first_write_that_fails(tmp_path):
    failing = 0
    while True:
        folder = tmp_path / str(failing)
        error = None
        with pytest.MonkeyPatch.context() as patch:
            layer = FailingCalls(patch, folder, failing)
            try:
                write_recording(recording(NEW), folder)
            except InputError as refused:
                error = refused
        if len(layer.calls) <= failing:
            break
        # Where the removal of a temporary file is the call that fails, the file stays.
        assert error is None or layer.calls[failing] == "unlink" or not folder.exists()
        assert error is not None or np.array_equal(load_recording(folder).gyro, recording(NEW).gyro)
        failing += 1
    assert failing > 5


def test_a_file_system_without_links_keeps_the_new_recording_under_another_name(tmp_path, monkeypatch):
    folder_with_old(tmp_path, "csv")

    def unsupported(*_args, **_kwargs):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", unsupported)
    for n, name in ((NEW, "samples-2.csv"), (NEW + 1, "samples.csv")):
        write_recording(recording(n), tmp_path, overwrite=True)
        assert len(load_recording(tmp_path).gyro) == n
        assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt", "recording.toml", name]
