"""Damaged files of every format, and recording.toml: nothing but a recording, samples, or one clear sentence.

A small form of ``benchmarks/fuzz.py``, which gives 100,000 inputs and watches memory, files and code as well.
"""

import importlib
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from srt.exceptions import DataError, InputError
from srt.recording.importer_registry import IMPORTERS
from srt.recording.importers import child_process

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
fuzz = importlib.import_module("fuzz")
mutations = importlib.import_module("fuzz_mutations")

NAMES = (*fuzz.READERS, *fuzz.RECORDINGS)

LONGEST_MESSAGE = 1500

EDITS = st.one_of(
    st.tuples(st.just("cut"), st.just(0)),
    st.tuples(st.just("drop"), st.integers(1, 200)),
    st.tuples(st.just("put"), st.binary(min_size=1, max_size=12)),
    st.tuples(st.just("over"), st.binary(min_size=1, max_size=12)),
    st.tuples(
        st.just("over"),
        st.builds(
            lambda value, width: (value % (1 << 8 * width)).to_bytes(width, "little"),
            st.sampled_from((*mutations.INTEGERS, *mutations.HUGE)),
            st.sampled_from(mutations.WIDTHS),
        ),
    ),
    st.tuples(st.sampled_from(("put", "word")), st.sampled_from(mutations.TOKENS)),
)

DAMAGE = st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans(), EDITS), min_size=1, max_size=4)


@pytest.fixture(autouse=True)
def _forks_in_place_of_interpreters(monkeypatch):
    """A new interpreter for each input would take 0.2 s; the limits are the same."""
    monkeypatch.setattr(child_process, "spawn", fuzz.Fork)


@cache
def seeds(name):
    return fuzz.seeds_of(name)


def damaged(data, damage):
    """Edits at places that are fractions of the file, or of its first 256 bytes, where headers stand."""
    result = bytearray(data)
    for fraction, near, (kind, what) in damage:
        at = int(fraction * min(len(result), 256 if near else len(result)))
        if kind == "cut":
            del result[at:]
        elif kind == "drop":
            del result[at : at + what]
        elif kind == "put":
            result[at:at] = what
        elif kind == "over":
            result[at : at + len(what)] = what
        else:
            word = mutations._WORD.search(result, at)
            if word:
                result[slice(*word.span())] = what
    return bytes(result)


def check(name, place, number, which, damage):
    seed = seeds(name)[number % len(seeds(name))]
    names = seed.damaged or tuple(sorted(seed.files))
    chosen = names[which % len(names)]
    fuzz._fresh(place)
    for each, data in seed.files.items():
        (place / each).write_bytes(damaged(data, damage) if each == chosen else data)
    try:
        fuzz.read(name, seed, place / seed.target)
    except (InputError, DataError) as error:
        text = str(error)
        assert len(text.splitlines()) == 1
        assert len(text) <= LONGEST_MESSAGE
        assert "fit into memory" not in text


@pytest.mark.parametrize(("examples", "derandomize"), [(10, True), pytest.param(1500, False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_give_samples_or_one_clear_sentence(name, tmp_path, examples, derandomize):
    @settings(
        max_examples=examples,
        deadline=None,
        derandomize=derandomize,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.integers(0, 99), st.integers(0, 99), DAMAGE)
    def property_holds(number, which, damage):
        check(name, tmp_path / "input", number, which, damage)

    property_holds()


def test_every_reader_is_fuzzed():
    assert set(fuzz.READERS) == set(IMPORTERS)


@pytest.mark.parametrize("name", NAMES)
def test_undamaged_files_are_read(name, tmp_path):
    for seed in seeds(name):
        fuzz._fresh(tmp_path / "input")
        fuzz.read(name, seed, fuzz.place(seed, tmp_path / "input", None, []))


def test_the_fuzzer_repeats_an_input_by_its_number(tmp_path):
    made = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        seed = seeds("csv")[0]
        fuzz.place(seed, folder, fuzz.generator("csv", 7), [b"pool"])
        made.append((folder / seed.target).read_bytes())
    assert made[0] == made[1] != seeds("csv")[0].files["a.csv"]


@pytest.mark.parametrize("mutation", [*mutations.BINARY, *mutations.TEXT])
def test_mutations_stand_empty_and_tiny_files(mutation):
    for data in (b"", b"a", b"\x00" * 5):
        for index in range(50):
            assert isinstance(mutation(bytearray(data), np.random.default_rng(index)), bytearray)


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
