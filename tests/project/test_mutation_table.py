"""The table of ``benchmarks/mutations.py`` fits the source that it changes."""

import ast
from pathlib import Path

import pytest
from mutation_subjects import SUBJECTS
from mutations import mutations_of

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_every_mutation_is_a_change_of_one_place(subject):
    """Mutants are Python, differ from the source, and from one another; the tests that must notice them exist."""
    source = (ROOT / subject.file).read_text(encoding="utf-8")
    mutants = [mutation.apply(source) for mutation in mutations_of(subject, source)]
    if not mutants:
        assert subject.functions == ("*",)  # a module without a sign
    for mutant in mutants:
        ast.parse(mutant)
    assert len({source, *mutants}) == len(mutants) + 1
    assert all((ROOT / test.split("::")[0]).exists() for test in subject.tests)
