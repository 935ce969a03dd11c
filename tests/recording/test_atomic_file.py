"""Files appear whole or not at all."""

import os
import stat
import sys

import pytest

from srt.exceptions import InputError, did_you_mean
from srt.recording.atomic_file import atomic_path, atomic_write_bytes, atomic_write_text


def test_text_and_bytes_replace_what_was_there(tmp_path):
    path = tmp_path / "a.json"
    atomic_write_text(path, "°/h\n")
    assert path.read_bytes() == b"\xc2\xb0/h\n"
    atomic_write_bytes(path, b"x")
    assert path.read_bytes() == b"x"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_an_error_within_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("old")

    def write():
        with atomic_path(path) as temporary:
            assert temporary.suffix == ".json"
            assert temporary.parent == tmp_path
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_paths_that_cannot_be_written_make_one_sentence(tmp_path):
    for path in (tmp_path / "absent" / "a", tmp_path):
        with pytest.raises(InputError, match=r"^Cannot write .*: choose a place"):
            atomic_write_text(path, "x")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX permissions and links")
def test_permissions_follow_the_umask_and_links_are_followed(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old")
    link.symlink_to(target)
    before = os.umask(0o027)
    try:
        atomic_write_text(link, "new")
    finally:
        os.umask(before)
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_nearly_right_names_are_suggested():
    assert did_you_mean("Gyro_Units", ["gyro_unit", "accel_unit"]) == " (did you mean gyro_unit?)"
    assert did_you_mean("xyz", ["gyro_unit"]) == ""
