"""Random command lines and environments: a small form of ``benchmarks/fuzz_arguments.py``, which runs 10,000."""

import fuzz_arguments
import pytest

from srt.cli import main


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arguments")
    fuzz_arguments.laboratory(folder)
    return folder


@pytest.mark.parametrize("indices", [range(12, 25), pytest.param(range(1000), marks=pytest.mark.slow)])
def test_random_command_lines_have_no_defect(laboratory, tmp_path, monkeypatch, indices):
    monkeypatch.chdir(tmp_path)
    runs = fuzz_arguments.runs(laboratory, tmp_path / "runs", 20261123, indices, 10.0)
    assert [(words, defect) for words, defect, _ in runs if defect] == []


@pytest.mark.parametrize("instruction", ["bash_complete", "nonsense_source"])
def test_a_request_of_completion_without_its_words_is_a_sentence(monkeypatch, capfd, instruction):
    monkeypatch.setenv("_SRT_COMPLETE", instruction)
    for name in ("COMP_WORDS", "COMP_CWORD"):
        monkeypatch.delenv(name, raising=False)
    code = main([])
    out, err = capfd.readouterr()
    assert (code, out) in ((1, ""), (2, ""))
    assert err.count("\n") == (1 if code == 2 else 0)


def test_no_standard_error_stops_no_command(monkeypatch, tmp_path):
    monkeypatch.setattr("sys.stderr", None)
    assert main(["simulate", "noise-free", "-o", str(tmp_path / "unit"), "-q"]) == 0
    assert main(["demo", "-o", str(tmp_path / "unit" / "recording.toml")]) == 2
