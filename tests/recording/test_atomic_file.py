"""Permissions and links of files that are written whole; failures of writing are in cli/test_cli_failing_writes."""

import os
import stat
import sys

import pytest

from srt.recording.atomic_file import atomic_write_text


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
