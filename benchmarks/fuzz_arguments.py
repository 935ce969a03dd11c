"""Random command lines and environments: no traceback, exit codes 0 to 2, one sentence for what is refused.

``python benchmarks/fuzz_arguments.py`` runs 10,000 command lines in this process; ``--count N`` as many,
``--one INDEX`` a single one again, with its output. Options are taken from the commands; a value is one that
fits (of this folder's files, and of the option's choices) or a hostile one. Streams are closed, full or of another
encoding, the working directory is deleted, and variables of the environment are absent or nonsense, each in some of
the runs.

The seed and the number of a run repeat it. A run of more than ``--seconds`` is interrupted, as by Ctrl-C, and must then
end with 130 or, for commands that follow a stream, as usual. ``--scheduler`` is left out: it would look up hosts of
random names.
"""

from __future__ import annotations

import errno
import importlib
import io
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import click
import harness
import numpy as np

from srt.cli import main as srt_main
from srt.cli.app import COMMANDS, app

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

SCENARIO = """
seed = 3
imu = { from = "navigation-rlg" }
fixture = { from = "lab-1mrad" }
site = { from = "latitude-45" }
schedule = { dwell_s = 2.0, rate_rad_s = 3.0, acceleration_rad_s2 = 30.0, settle_s = 0.1, leg_dwell_s = 0.2 }
recording = { sample_rate_hz = 50.0, format = "csv", serial = "SN-\\u001b[31m" }
"""
FILES = (
    "unit", "unit/recording.toml", "unit/samples.csv", "unit/truth.json", "unit.json", "unit.toml", "new", "new.json",
    "new.png", "new.svg", "new.toml", "new.md", "new.html", "new.h", "absent/x.json", "u\x1bnit", "damaged.json",
)  # fmt: skip
"""Places in the folder of a run; those with "new" do not exist."""
NAMES = (
    "demo", "noise-free", "closed-form", "least-squares", "ekf", "graph", "gyro_scale", "gyro_scale_x", "1,2,3",
    "gyro_scale=5", "table-1", "navigation-equal", "quick", "kalibr", "c-header", "px4", "imucal", "SN-7", "x,y,z",
    "-x,z,y", "1/131 deg/s", "1/16384 g", "udp:127.0.0.1:9", "0:0", "2026-01-01", "px4:unit.toml", "sequence", "ulog",
)  # fmt: skip
"""Words that options of text take."""
NUMBERS = ("0", "1", "2", "3.5", "45", "9.81", "100", "1e-3")
HOSTILE = (
    "", " ", ".", "..", "-", "--", "-1", "nan", "NaN", "inf", "-inf", "1e309", "1e-400", "9" * 400, "-" + "9" * 30,
    "2147483648", "9223372036854775808", "0x10", "1_0", "\u0663", "1,5", "1e", "a" * 300, "a" * 5000, "a/" * 2000,
    "caf\xe9", "\U0001f680.json", "\udcff", "\udcff.json", "\x1b]0;x\x07", "a\nb", "a\nb.json", "a\tb.png",
    "$HOME", "~", "~nobody/x.json", "$\\input{x}$", "%s%n", "{0}", "[bold]", "=1+1", "/dev/null",
    "/dev/full", "/proc/self/x.json", "CON", "'; true", "*", "?.json", ":", "::", "=", "a=", "=5", "a=nan", "a:b:c",
    "0:-1", "99999999999:1", "udp:127.0.0.1:0", "udp:127.0.0.1:99999", "udp:", "1/0 g", "1/nan deg/s", "\u202egpj.x",
    "\ufeff", "None", "null", "[]", "[1", "{\"a\"", "--help", "-h", "-o", "-q",
)  # fmt: skip
ENVIRONMENT = {
    "HOME": (None, "", "/nonexistent", "\udcff"), "TMPDIR": (None, "/nonexistent", "\udcff"),
    "MPLBACKEND": (None, "nonsense", "TkAgg"), "MPLCONFIGDIR": ("/nonexistent", "\udcff"),
    "LANG": (None, "C", "nonsense"), "LC_ALL": ("C", "POSIX", "tr_TR.UTF-8"),
    "COLUMNS": ("0", "1", "-5", "abc", "99999"), "LINES": ("0", "abc"), "TERM": (None, "dumb", "nonsense"),
    "NO_COLOR": ("", "1"), "FORCE_COLOR": ("1",), "TZ": ("nonsense", "\udcff"), "PATH": (None, ""),
    "USER": (None, "\udcff"), "SOURCE_DATE_EPOCH": ("abc", "-1", "9" * 30), "OMP_NUM_THREADS": ("0", "abc"),
    "PYTHONIOENCODING": ("nonsense",), "JOBLIB_TEMP_FOLDER": ("/nonexistent",),
    "_SRT_COMPLETE": ("bash_source", "nonsense", "zsh_complete"), "COMP_WORDS": ("srt cal", "srt '"),
    "COMP_CWORD": ("1", "abc"),
}  # fmt: skip
"""Variables with their values; None: absent. Each changes in one run of twenty."""
INTERRUPTED, BROKEN_PIPE = 130, 141
MODULES = (
    "matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg", "scipy.stats",
    "matplotlib.backends.backend_pdf", "fpdf", "pandas", "pydantic", "joblib", "scipy.optimize",
)  # fmt: skip
"""Imported first: an interrupted import would spoil the later runs of this process."""


class FullFile(io.RawIOBase):
    """Stream that cannot be written."""

    def __init__(self, number: int) -> None:
        self.number = number

    def writable(self) -> bool:
        return True

    def write(self, _data: object) -> int:
        raise OSError(self.number, os.strerror(self.number))


def laboratory(folder: Path) -> None:
    """Make a recording, its calibration, and what else the commands take; import what is large."""
    for name in MODULES:
        importlib.import_module(name)
    (folder / "unit.toml").write_text(SCENARIO)
    assert srt_main(["simulate", str(folder / "unit.toml"), "-o", str(folder / "unit"), "-q"]) == 0
    assert srt_main(["calibrate", str(folder / "unit"), "-o", str(folder / "unit.json"), "-q"]) == 0
    shutil.copytree(folder / "unit", folder / "u\x1bnit")
    (folder / "damaged.json").write_bytes((folder / "unit.json").read_bytes()[:-100])


def value(parameter: click.Parameter, rng: np.random.Generator) -> str:
    """Text for an argument or option, that fits in half of the cases."""
    if rng.random() < 0.5:
        return str(rng.choice(np.array(HOSTILE, dtype=object)))
    kind = parameter.type
    if isinstance(kind, click.Choice):
        fitting = tuple(map(str, kind.choices))
    elif isinstance(kind, click.Path):
        fitting = FILES
    else:
        fitting = NUMBERS if kind.name.startswith(("float", "integer")) else (*NAMES, *FILES)
    return str(rng.choice(np.array(fitting, dtype=object)))


def command_line(rng: np.random.Generator) -> list[str]:
    """Words of a random command, about half of whose required ones are given."""
    if rng.random() < 0.02:
        return [str(rng.choice(np.array(HOSTILE, dtype=object))) for _ in range(int(rng.integers(4)))]
    name = str(rng.choice(list(COMMANDS)))
    command = app.get_command(click.Context(app), name)
    assert command is not None
    words = [name]
    for parameter in command.params:
        likely = 0.9 if isinstance(parameter, click.Argument) else 0.7 if parameter.required else 0.12
        if "--scheduler" in parameter.opts or rng.random() > likely:
            continue
        for _ in range(int(rng.integers(1, 4)) if parameter.multiple or parameter.nargs == -1 else 1):
            option = [] if isinstance(parameter, click.Argument) else [str(rng.choice(parameter.opts))]
            given = [] if getattr(parameter, "is_flag", False) else [value(parameter, rng)]
            words += option + given
    if rng.random() < 0.1:
        rng.shuffle(tail := words[1:])
        words[1:] = tail
    return words


def text_stream(rng: np.random.Generator) -> io.TextIOWrapper | None:
    """Standard output or error: mostly whole; otherwise closed, full, broken, or of a small alphabet."""
    kind = rng.random()
    if kind < 0.02:
        return None
    if kind < 0.06:
        full = FullFile(errno.ENOSPC if kind < 0.04 else errno.EPIPE)
        return io.TextIOWrapper(io.BufferedWriter(full), encoding="utf-8")
    return io.TextIOWrapper(io.BytesIO(), encoding="ascii" if kind < 0.2 else "utf-8")


def content(stream: io.TextIOWrapper | None) -> str | None:
    """Text of a stream; None for one that could not be written."""
    if stream is None or not isinstance(stream.buffer, io.BytesIO):
        return None
    stream.flush()
    return stream.buffer.getvalue().decode()  # click writes UTF-8 where the stream is ASCII


def environment(rng: np.random.Generator) -> dict[str, str]:
    changed = dict(os.environ)
    for name, values in ENVIRONMENT.items():
        if rng.random() < 0.05:
            chosen = values[int(rng.integers(len(values)))]
            changed.pop(name, None)
            if chosen is not None:
                changed[name] = chosen
    return changed


@contextmanager
def interrupted_after(seconds: float) -> Iterator[list[float]]:
    """Raise KeyboardInterrupt after some time; yield a list that then holds the moment."""
    moments: list[float] = []

    def interrupt(_number: int, _frame: object) -> None:
        moments.append(time.monotonic())
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds, 1.0)  # again: one within a finalizer is lost
    try:
        yield moments
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def unraisable_to(found: list[str]) -> Callable[[Any], None]:
    """Hook that lists what finalizers raise, but for interruptions."""

    def hook(info: Any) -> None:
        if not isinstance(info.exc_value, KeyboardInterrupt):
            found.append(repr(info.exc_value))

    return hook


def run(rng: np.random.Generator, place: Path, seconds: float) -> tuple[list[str], str, str | None]:
    """Run one command line in a folder; its words, what was wrong ("" for nothing), and standard error."""
    words, variables = command_line(rng), environment(rng)
    out, err = text_stream(rng), text_stream(rng)
    rows = [str(rng.choice(np.array([*HOSTILE, "0,0,0,0,0,0,9.8", '{"gyro": 1}'], dtype=object))) for _ in range(5)]
    source = io.StringIO("\n".join(rows))
    os.chdir(place)
    if rng.random() < 0.03:
        (place / "gone").mkdir()
        os.chdir(place / "gone")
        (place / "gone").rmdir()
    defect, code, moments = "", 0, []
    unraisable: list[str] = []
    streams = {"stdin": source, "stdout": out, "stderr": err}
    with (
        mock.patch.multiple(sys, unraisablehook=unraisable_to(unraisable), **streams),
        mock.patch.dict(os.environ, variables, clear=True),
        mock.patch.object(tempfile, "tempdir", None),
        warnings.catch_warnings(),
    ):
        try:
            with interrupted_after(seconds) as moments:
                code = srt_main(words)
        except KeyboardInterrupt:
            code = INTERRUPTED  # outside the command: between it and the end of the timer
        except BaseException as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            defect = f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}: {str(error)[:120]}"
    said = content(err)
    return words, defect or judge(code, said, content(out), place, words, bool(moments)) or "".join(unraisable), said


def judge(code: int, said: str | None, out: str | None, place: Path, words: list[str], interrupted: bool) -> str:
    """Defect of a run that ended."""
    allowed = {0, 1, 2} | ({INTERRUPTED} if interrupted else set()) | ({BROKEN_PIPE} if None in (out, said) else set())
    if code not in allowed:
        return f"exit code {code}"
    for text in (said or "", out or ""):
        if "Traceback" in text:
            return "a traceback is printed"
        if "\x1b" in text or "\x07" in text:
            return "a control character is printed"
    if code == 2 and said is not None and words and not any(line.startswith("srt: ") for line in said.splitlines()):
        return f"exit code 2 without a sentence: {said[-200:]!r}" if out is not None else ""
    left = [path.name for path in place.rglob(".*.tmp*")]
    return f"temporary files remain: {left}" if left else ""


def runs(
    laboratory: Path, scratch: Path, seed: int, indices: Iterable[int], seconds: float
) -> Iterator[tuple[list[str], str, str | None]]:
    """Run command lines, each in a new copy of the laboratory; yield their words, defects and standard error."""
    origin, place = Path.cwd(), scratch / "a" / "b" / "c"
    for index in indices:
        shutil.copytree(laboratory, place, copy_function=os.link)  # files are replaced, never changed
        try:
            yield run(np.random.default_rng([seed, index]), place, seconds)
        finally:
            os.chdir(origin)
            shutil.rmtree(scratch / "a", ignore_errors=True)


def main(
    *,
    count: int = 10_000,
    start: int = 0,
    seed: int = 1,
    seconds: float = 10.0,
    one: int | None = None,
) -> int:
    """Runs from a first number on, each interrupted after some seconds; or one run."""
    failures = 0
    indices = range(start, start + count) if one is None else range(one, one + 1)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as scratch:
        pristine = Path(scratch) / "pristine"
        pristine.mkdir()
        laboratory(pristine)
        done = runs(pristine, Path(scratch), seed, indices, seconds)
        for index, (words, defect, said) in zip(indices, done, strict=True):
            failures += bool(defect)
            if defect or one is not None:
                print(f"{index} {defect!r} {words!r}"[:600], flush=True)
            if one is not None:
                print(said)
    print(f"{len(indices)} command lines, {failures} with a defect")
    return 1 if failures else 0


if __name__ == "__main__":
    harness.run(main, __doc__)
