"""Mutation tests: one change of the source at a time, and whether the tests that belong to it notice.

``python benchmarks/mutations.py`` copies the tree, applies each mutation to the copy, runs the tests of its subject and
prints "killed" or "survived" with file, line and change. Mutations are the sign of every term in the functions of
``mutation_subjects.toml`` (plus and minus swapped, a leading minus dropped) and changes given as text. ``--only
SUBJECT`` restricts them, ``--list`` prints them. Exits with 1 if a mutation survives.
"""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import harness
import pytest  # what all tests import is imported once, before the forks
import scipy.optimize
import scipy.signal
import scipy.spatial.transform
import scipy.stats  # noqa: F401

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

ROOT = Path(__file__).parents[1]
TESTS_FAILED = 1
"""Exit code of pytest if tests ran and failed."""


class Subject(NamedTuple):
    """Mutations of one file: ``functions`` have their signs changed, ``changes`` are pairs of texts."""

    name: str
    file: str
    tests: Sequence[str]
    functions: Sequence[str] = ()
    changes: Sequence[tuple[str, str]] = ()
    without_effect: Sequence[str] = ()


_TABLE = tomllib.loads((ROOT / "benchmarks" / "mutation_subjects.toml").read_text(encoding="utf-8"))
SUBJECTS = [Subject(name, **row) for name, row in _TABLE.items()]


class Mutation(NamedTuple):
    """One change: characters ``start`` to ``stop`` of a file are replaced by ``text``."""

    subject: Subject
    start: int
    stop: int
    text: str

    def apply(self, source: str) -> str:
        """Source text with the change."""
        return source[: self.start] + self.text + source[self.stop :]

    def describe(self, source: str) -> str:
        """Place, and the changed line."""
        line = source.count("\n", 0, self.start) + 1
        changed = self.apply(source).splitlines()[line - 1].strip()
        return f"{self.subject.file}:{line}  {changed}"


def mutations_of(subject: Subject, source: str) -> Iterator[Mutation]:
    """All mutations of a subject's file."""
    offsets = [0]
    for line in source.splitlines(keepends=True):
        offsets.append(offsets[-1] + len(line))
    for start, stop, text in _sign_changes(source, offsets, subject):
        yield Mutation(subject, start, stop, text)
    for before, after in subject.changes:
        if source.count(before) != 1:
            raise SystemExit(f"{subject.file}: {before!r} is there {source.count(before)} times, once is expected")
        at = source.index(before)
        yield Mutation(subject, at, at + len(before), after)


def _sign_changes(source: str, offsets: list[int], subject: Subject) -> Iterator[tuple[int, int, str]]:
    """Places and texts of the changed signs in the functions and assignments of a subject."""
    lines = source.splitlines()

    def place(line: int, column: int) -> int:
        # The columns of ast count bytes.
        return offsets[line - 1] + len(lines[line - 1].encode()[:column].decode())

    for node in _chosen(ast.parse(source), subject):
        for inner in _arithmetic(node):
            if not {ast.unparse(inner), lines[inner.lineno - 1].strip()}.isdisjoint(subject.without_effect):
                continue
            if isinstance(inner, ast.UnaryOp):
                at = place(inner.lineno, inner.col_offset)
                yield at, at + 1, "+"
                continue
            left = inner.target if isinstance(inner, ast.AugAssign) else inner.left
            right = inner.value if isinstance(inner, ast.AugAssign) else inner.right
            first, last = place(left.end_lineno, left.end_col_offset), place(right.lineno, right.col_offset)
            sign = "+" if isinstance(inner.op, ast.Add) else "-"
            at = source.index(sign, first, last)
            yield at, at + 1, "-" if sign == "+" else "+"


def _chosen(tree: ast.Module, subject: Subject) -> Iterator[ast.AST]:
    """Named functions and assignments of a module, or all of it."""
    if subject.functions == ["*"]:
        yield tree
        return
    wanted = set(subject.functions)
    for node in ast.walk(tree):
        name = node.target if isinstance(node, ast.AnnAssign) else node
        name = getattr(name, "id", getattr(name, "name", None))
        if isinstance(node, ast.FunctionDef | ast.AnnAssign) and name in wanted:
            wanted.discard(name)
            yield node
    if wanted:
        raise SystemExit(f"{subject.file}: not found: {', '.join(sorted(wanted))}")


def _arithmetic(function: ast.AST) -> Iterator[ast.BinOp | ast.AugAssign | ast.UnaryOp]:
    """Sums, differences and leading minuses of a function, outside of defaults, indices and calls that count."""
    skipped: set[int] = set()
    for node in ast.walk(function):
        counts = isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in _COUNTING
        is_text = isinstance(node, ast.Raise | ast.JoinedStr | ast.BinOp) and _has_text(node)
        if isinstance(node, ast.arguments | ast.Subscript) or counts or is_text:
            parts = [node.slice] if isinstance(node, ast.Subscript) else [node]
            skipped |= {id(inner) for part in parts for inner in ast.walk(part)}
    for node in ast.walk(function):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.BinOp | ast.AugAssign | ast.UnaryOp) and isinstance(
            node.op, ast.Add | ast.Sub | ast.USub
        ):
            yield node


def _has_text(node: ast.AST) -> bool:
    return any(
        isinstance(part, ast.JoinedStr) or isinstance(getattr(part, "value", None), str) for part in ast.walk(node)
    )


_COUNTING = {"range", "reshape", "zeros", "empty", "ones", "arange", "reversed", "round", "broadcast_to", "tile"}
"""Calls whose arguments are numbers of elements."""


def run_tests(folder: Path, tests: Sequence[str]) -> int:
    """Exit code of pytest for tests of a copy of the tree, slow ones too, in a fork that has imported nothing of it."""
    child = os.fork()
    if not child:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        os.chdir(folder)
        sys.path.insert(0, str(folder))
        importlib.invalidate_caches()
        os._exit(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-n", "0", "-m", "not campaign", *tests]))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def copy_tree(folder: Path) -> None:
    """Copy the files of the tree that git knows, or would add, to a folder."""
    names = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"],  # noqa: S607
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split("\0")  # fmt: skip
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes((ROOT / name).read_bytes())


def study(subjects: list[Subject], folder: Path) -> Iterator[tuple[str, str, str]]:
    """Subjects and mutations in words, with "killed", "survived", or "broken": not even imported."""
    for subject in subjects:
        if run_tests(folder, subject.tests) != 0:
            raise SystemExit(f"{subject.name}: the tests fail without a mutation")
        file = folder / subject.file
        source = file.read_text(encoding="utf-8")
        for mutation in mutations_of(subject, source):
            file.write_text(mutation.apply(source), encoding="utf-8")
            code = run_tests(folder, subject.tests)
            yield subject.name, mutation.describe(source), {0: "survived", TESTS_FAILED: "killed"}.get(code, "broken")
        file.write_text(source, encoding="utf-8")


def main(*, only: tuple[str, ...] = (), list: bool = False) -> int:  # noqa: A002 - the name of the option
    """Run the mutations and give the exit code."""
    subjects = [s for s in SUBJECTS if not only or s.name in only]
    if list:
        for subject in subjects:
            source = (ROOT / subject.file).read_text(encoding="utf-8")
            print(f"{subject.name}: {', '.join(subject.tests)}")
            print(*(f"  {m.describe(source)}" for m in mutations_of(subject, source)), sep="\n")
        return 0
    began, counts = time.process_time(), {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        copy_tree(folder)
        for name, change, fate in study(subjects, folder):
            counts[fate] = counts.get(fate, 0) + 1
            print(f"{fate:8}  {name}: {change}", flush=True)
    spent = time.process_time() - began + sum(os.times()[2:4])
    print(", ".join(f"{count} {fate}" for fate, count in counts.items()), f"({spent:.0f} s of processor time)")
    return int("survived" in counts)


if __name__ == "__main__":
    harness.run(main, __doc__, only=[s.name for s in SUBJECTS])
