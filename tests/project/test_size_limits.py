"""Limits on the length of files and functions, so that each is read in one go."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("srt", "estimators", "sims", "tests", "benchmarks", ".ci")
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))

SMALLEST_FILE, LARGEST_FILE = 20, 500
"""Lines. A smaller module is a part of another; a larger one has more than one subject."""
LARGEST_FUNCTION = 60
"""Lines from ``def`` to the end without the docstring: about one screen."""


def statements(node):
    """All statements of a node; functions are nowhere else."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        for child in getattr(node, name, ()):
            yield child
            yield from statements(child)


def function_lines(source):
    """Name, line and number of lines without the docstring of every function of a source text."""
    for node in statements(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = node.end_lineno - node.lineno + 1
            first = node.body[0]
            if ast.get_docstring(node) is not None:
                lines -= first.end_lineno - first.lineno + 1
            yield node.name, node.lineno, lines


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def test_length_of_files():
    # __init__ may be empty, __main__ is the entry of `python -m`.
    lines = {name_of(p): len(p.read_text(encoding="utf-8").splitlines()) for p in FILES if not p.stem.startswith("__")}
    assert len(lines) > 100
    assert {name: n for name, n in lines.items() if not SMALLEST_FILE <= n <= LARGEST_FILE} == {}


def test_length_of_functions():
    found = {
        f"{name_of(path)}:{line} {name}": lines
        for path in FILES
        for name, line, lines in function_lines(path.read_text(encoding="utf-8"))
        if lines > LARGEST_FUNCTION
    }
    assert found == {}


@pytest.mark.parametrize(
    ("source", "lines"),
    [("def f():\n    pass\n", 2), ('def f(\n    x,\n):\n    """One.\n\n    Two.\n    """\n    return x\n', 4)],
)
def test_docstrings_do_not_count(source, lines):
    assert list(function_lines(source)) == [("f", 1, lines)]
