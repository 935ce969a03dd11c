"""Damaged files of every format, and recording.toml: nothing but a recording, samples, or one clear sentence.

A small form of ``benchmarks/fuzz.py``, which gives 100,000 inputs and watches memory, files and code as well.
"""

import importlib
import sys
from functools import cache
from pathlib import Path

import pytest

from srt.exceptions import DataError, InputError
from srt.recording.importer_registry import IMPORTERS
from srt.recording.importers import child_process

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
fuzz = importlib.import_module("fuzz")

NAMES = fuzz.NAMES

LONGEST_MESSAGE = 1500


@pytest.fixture(autouse=True)
def _forks_in_place_of_interpreters(monkeypatch):
    """A new interpreter for each input would take 0.2 s; the limits are the same."""
    monkeypatch.setattr(child_process, "spawn", fuzz.Fork)


@cache
def seeds(name):
    return fuzz.seeds_of(name)


def check(name, folder, index):
    """Read the input of this number: samples, or one sentence."""
    own = seeds(name)
    seed = own[index % len(own)]
    fuzz._fresh(folder)
    path = fuzz.place(seed, folder, fuzz.generator(name, index), fuzz.pool_of(own))
    try:
        fuzz.read(name, seed, path)
    except (InputError, DataError) as error:
        text = str(error)
        assert len(text.splitlines()) == 1
        assert len(text) <= LONGEST_MESSAGE
        assert "fit into memory" not in text


def test_every_reader_is_fuzzed():
    assert set(fuzz.READERS) == set(IMPORTERS)


@pytest.mark.parametrize("name", NAMES)
def test_undamaged_files_are_read(name, tmp_path):
    for seed in seeds(name):
        fuzz._fresh(tmp_path / "input")
        fuzz.read(name, seed, fuzz.place(seed, tmp_path / "input", None, []))


@pytest.mark.parametrize("count", [10, pytest.param(1500, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_give_samples_or_one_clear_sentence(name, tmp_path, count):
    for index in range(count):
        check(name, tmp_path / "input", index)


def test_the_fuzzer_tells_failures(tmp_path, monkeypatch):
    """A reader that raises something else, opens another file, or takes too long does not go unseen."""
    outside = tmp_path / "secret"
    outside.write_text("x")
    (tmp_path / "input").mkdir()
    watch = fuzz.Watch(tmp_path / "input")
    seed = seeds("csv")[0]

    def outcome_of(reader):
        monkeypatch.setattr(fuzz, "read", lambda *_: reader())
        return fuzz.judge("csv", seed, tmp_path, watch)

    def raises(error):
        raise error

    assert outcome_of(lambda: None) == "read"
    assert outcome_of(lambda: raises(InputError("One sentence."))) == "refused"
    assert outcome_of(lambda: raises(InputError("Two\nlines."))).startswith("message of 2 lines")
    assert outcome_of(lambda: raises(InputError("It does not fit into memory."))) == "memory"
    assert outcome_of(lambda: raises(KeyError("x"))).startswith("KeyError at ")
    assert outcome_of(lambda: raises(fuzz.HangError())).startswith("more than ")
    assert outcome_of(outside.read_text).startswith("open ")
    assert outcome_of(lambda: exec("1")).startswith("exec ")  # noqa: S102
