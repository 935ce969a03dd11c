"""Fixtures of the tests of files and readers."""

import os

import fuzz
import pytest

from srt.recording.importers import child_process


@pytest.fixture
def forked_readers(monkeypatch):
    """Readers of logs in a fork of this process: a new interpreter takes 0.3 s, and test_importers_child starts it."""
    if hasattr(os, "fork"):
        monkeypatch.setattr(child_process, "spawn", fuzz.Fork)
