"""Every command and block of README and docs runs as it stands and prints the output shown.

The blocks of a page run in order and in one folder. The language of a fence says what it is: Python, ``console`` with
``$`` and output, ``toml``, other languages (not run), or none: output of the block before it. An indented block holds
commands, one a line. A comment before a block changes this:

- ``<!-- given: NAMES -->`` makes files of docs_inputs.py;
- ``<!-- file: NAME -->`` and ``<!-- append: NAME -->`` write the block to a file;
- ``<!-- part of: FILE -->``: the block is a part of a file of the page or of the repository, too;
- ``<!-- not run: REASON -->``: commands pass the parser, Python and TOML are compiled. With the reason "takes N s" the
  block runs in a campaign.
"""

import contextlib
import doctest
import io
import re
import shlex
import tomllib
from collections import Counter
from itertools import pairwise
from pathlib import Path

import click
import pytest
from docs_inputs import INPUTS
from markdown_it import MarkdownIt

import sims
import srt
from srt.cli import main
from srt.cli.app import COMMANDS, app
from srt.planning import annealing

pytestmark = pytest.mark.usefixtures("blank_figures")

ROOT = Path(__file__).parents[2]
PAGES = {p.relative_to(ROOT).as_posix(): p for p in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]}
MARK = re.compile(r"<!-- (given|file|append|part of|not run): (.*?) -->")
LONG = "takes"
LONG_PAGES = {"docs/planning.md", "docs/turned-by-hand.md"}
"""Pages that run in the slow tests: plans by the whole search, and recordings of many minutes."""
LANGUAGES = {"python", "console", "toml", ""}


def blocks(page):
    """Fences and indented blocks of a page, each with its comments; ``given`` alone has no block."""
    marks = {}
    for token in MarkdownIt("commonmark").parse(PAGES[page].read_text(encoding="utf-8")):
        if token.type == "html_block" and (found := MARK.match(token.content)):
            marks[found[1]] = found[2]
        elif token.type in {"fence", "code_block"}:
            if not token.info.startswith("{"):  # a directive of the site
                yield token, marks
            marks = {}


def commands(token):
    """Each command of a block, and the output shown after it."""
    text = token.content.replace("\\\n", " ")
    if token.type == "code_block":
        return [(line, "") for line in text.splitlines()]
    return [entry.partition("\n")[::2] for entry in re.split(r"^\$ ", text, flags=re.M)[1:]]


def words_of(command):
    """Words of a command line without its comment; ``|`` and ``>`` are words."""
    lexer = shlex.shlex(command, posix=True, punctuation_chars="|>")
    lexer.whitespace_split = True
    return list(lexer)


def check_command(words):
    """Give a command to its parser: options exist, values have the type, arguments are complete."""
    program, *rest = words
    if program == "srt":
        name, *arguments = rest
        command = app.get_command(click.Context(app), name)
        assert command is not None, f"srt {name}"
        with contextlib.suppress(click.exceptions.Exit):  # of --list
            command.make_context(name, arguments)
    elif program.endswith("python") and rest[0].endswith(".py"):
        source = (ROOT / rest[0]).read_text(encoding="utf-8")
        # Options of a parser, or keyword arguments of the function that benchmarks/harness.py runs.
        known = re.findall(r'"(--[a-z-]+)"', source) + re.findall(r"^    (\w+): |[(*,] (\w+): ", source, re.M)
        known = {"".join(name).removeprefix("--").replace("_", "-") for name in known}
        assert {word.removeprefix("--") for word in rest if word.startswith("--")} <= known, words
    elif program == "make":
        assert re.search(rf"^{rest[0]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M), words
    else:
        return "skipped"
    return "parsed"


class PageRun:
    """Blocks of a page as they run."""

    def __init__(self, page, *, whole):
        self.page, self.whole = page, whole
        self.names, self.printed, self.counts = {}, None, Counter()

    def block(self, token, marks):
        if "given" in marks:
            for name in marks["given"].split():
                INPUTS[name](Path(name))
        if "part of" in marks:
            files = [folder / marks["part of"] for folder in (Path(), ROOT)]
            assert token.content in next(f for f in files if f.exists()).read_text(encoding="utf-8")
        language = "console" if token.type == "code_block" else token.info.strip()
        idle = "not run" in marks and not (self.whole and marks["not run"].startswith(LONG))
        if language not in LANGUAGES:
            self.counts["skipped"] += 1
        elif language == "":
            self.output(token.content, idle=idle or "part of" in marks)
        else:
            getattr(self, language)(token, marks, idle=idle)

    def output(self, shown, *, idle):
        if idle or self.printed is None:
            self.counts["skipped"] += 1
        else:
            self.compare(shown, self.printed)

    def compare(self, shown, printed):
        same = doctest.OutputChecker().check_output(shown, printed, doctest.ELLIPSIS)
        assert same, f"{self.page} shows\n{shown}\nand this was printed:\n{printed}"

    def toml(self, token, marks, *, idle):
        for how, mode in (("file", "w"), ("append", "a")):
            if how in marks:
                with Path(marks[how]).open(mode, encoding="utf-8") as file:
                    file.write(token.content)
        tomllib.loads(token.content)
        self.counts["parsed" if idle or not {"file", "append"} & marks.keys() else "run"] += 1

    def python(self, token, marks, *, idle):
        code = compile("\n" * (token.map[0] + 1) + token.content, PAGES[self.page], "exec")
        self.counts["parsed" if idle else "run"] += 1
        self.printed = None if idle else self.capture(lambda: exec(code, self.names))  # noqa: S102 - our own page

    def console(self, token, marks, *, idle):
        for command, shown in commands(token):
            words = words_of(command)
            if not words:  # a comment
                continue
            ends = [-1, *(k for k, word in enumerate(words) if set(word) <= {"|", ">"}), len(words)]
            kinds = {check_command(words[a + 1 : b]) for a, b in pairwise(ends)}
            if idle:
                self.counts["skipped" if kinds == {"skipped"} else "parsed"] += 1
                self.printed = None
                continue
            assert words[0] == "srt", f"{self.page}: say why this is not run: {command}"
            codes = []
            self.printed = self.capture(lambda words=words, codes=codes: codes.append(main(words[1:])))
            assert codes == [0], f"{self.page}: {command}"
            self.counts["run"] += 1
            if shown:
                self.compare(shown, self.printed)

    @staticmethod
    def capture(call):
        with contextlib.redirect_stdout(io.StringIO()) as stream:
            call()
        return stream.getvalue()


def pages():
    """Pages with a fence or an indented block; they are read as Markdown when they run."""
    for page, path in PAGES.items():
        text = path.read_text(encoding="utf-8")
        if re.search(r"^```\w|\n\n {4}\S", text, re.M):
            yield pytest.param(page, False, id=page, marks=[pytest.mark.slow] * (page in LONG_PAGES))
        if f"<!-- not run: {LONG}" in text:
            yield pytest.param(page, True, id=f"{page}-whole", marks=pytest.mark.campaign)


@pytest.mark.parametrize(("page", "whole"), list(pages()))
def test_blocks_run_and_print_what_the_page_shows(page, whole, tmp_path, monkeypatch, record_property):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    run = PageRun(page, whole=whole)
    for token, marks in blocks(page):
        run.block(token, marks)
    record_property("documentation", dict(run.counts))


ROW = re.compile(r"^\| `srt (.*?)` \| (.*) \|$", re.M)
"""Command and Python in the table of docs/python.md."""


@pytest.mark.slow
def test_every_command_has_a_row_whose_python_runs(tmp_path, monkeypatch, record_property):
    # docs/planning.md has a plan by the whole search.
    monkeypatch.setattr(annealing, "TRIALS", annealing.TRIALS // 8)
    text = PAGES["docs/python.md"].read_text(encoding="utf-8")
    rows = ROW.findall(text)
    assert {command.split()[0] for command, _ in rows} == set(COMMANDS)
    monkeypatch.chdir(tmp_path)
    for name in re.search(r"<!-- rows given: (.*) -->", text)[1].split():
        INPUTS[name](Path(name))
    names = {"srt": srt, "sims": sims}
    for command, python in rows:
        check_command(["srt", *shlex.split(command)])
        for code in re.findall(r"`([^`]+)`", python):
            exec(code, names)  # noqa: S102 - our own page
    record_property("documentation", {"run": len(rows), "parsed": len(rows)})
