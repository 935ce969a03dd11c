"""Progress on standard error: a moving line or bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from srt.cli.messages import printable, progress_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.console import Console

    from srt.comparison.fleet import FleetUnit as Unit

_LINE_EVERY_S: Final = 30.0
"""Time between lines of progress where there is no terminal, s."""


def _console() -> Console | None:
    """Console of the terminal on standard error; None if there is no terminal, or no rich."""
    if sys.stderr is None or not sys.stderr.isatty():
        return None
    try:
        from rich.console import Console
    except ModuleNotFoundError:
        return None
    return Console(stderr=True, highlight=False)


@contextmanager
def status_line(first: str) -> Iterator[Callable[[str], None] | None]:
    """Yield a function that replaces the text of a moving line; None if there is no terminal, or no rich.

    Parameters
    ----------
    first : str
        Text before the first call.
    """
    console = _console()
    if console is None:
        yield None
        return
    from rich.live import Live
    from rich.spinner import Spinner
    from rich.text import Text

    line = Spinner("dots", Text(printable(first)))
    # Other output goes above the line on a terminal, and as it is to a file.
    shared = sys.stdout is not None and sys.stdout.isatty()
    with Live(line, console=console, refresh_per_second=12.5, transient=True, redirect_stdout=shared):
        yield lambda text: line.update(text=Text(printable(text)))


@contextmanager
def live_text(*, quiet: bool) -> Iterator[Callable[[str], None] | None]:
    """Yield a function that replaces a text of several lines; None if quiet, without a terminal or without rich."""
    console = None if quiet else _console()
    if console is None:
        yield None
        return
    from rich.live import Live
    from rich.text import Text

    with Live(console=console, auto_refresh=False, transient=True) as live:
        yield lambda text: live.update(Text(printable(text)), refresh=True)


@contextmanager
def iteration_progress(name: str, *, quiet: bool) -> Iterator[Callable[[int, float], None] | None]:
    """Yield a function of the number of an iteration and its largest correction; None if quiet.

    Without a moving line, the progress of a long calibration is shown by a line every 30 s.

    Parameters
    ----------
    name : str
        Name of the recording.
    """
    if quiet:
        yield None
        return
    said = time.monotonic()
    with status_line(f"{name}: preparing") as update:

        def show(number: int, correction: float) -> None:
            nonlocal said
            text = f"{name}: iteration {number}, largest correction {correction:.1e}"
            if update is not None:
                update(text)
            elif time.monotonic() - said > _LINE_EVERY_S:
                said = time.monotonic()
                progress_line(text)

        yield show


@contextmanager
def bar(label: str, total: int | None = None) -> Iterator[Callable[[int, int, str], None] | None]:
    """Yield a function of count, total and label that moves a bar; None if there is no terminal, or no rich."""
    console = _console()
    if console is None:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("left"),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(printable(label), total=total)
        yield lambda done, size, text: progress.update(task, completed=done, total=size, description=printable(text))


@contextmanager
def count_progress(name: str, *, quiet: bool, lines: bool = True) -> Iterator[Callable[[int, int], None] | None]:
    """Yield a function of the finished and of all trials; None if quiet.

    Parameters
    ----------
    lines : bool
        Print lines where there is no terminal, every 30 s.
    """
    if quiet:
        yield None
        return
    with bar(name) as move:
        if move is not None:
            yield lambda done, size: move(done, size, name)
        else:
            yield _periodic_lines(name) if lines else None


def _periodic_lines(name: str) -> Callable[[int, int], None]:
    """Function that prints the progress at the first call, then every 30 s and at the end."""
    began = said = time.monotonic()
    first: int | None = None

    def line(done: int, size: int) -> None:
        nonlocal said, first
        now = time.monotonic()
        if first is None:
            first = done
            progress_line(f"{name}: {done} of {size} trials exist already" if done else f"{name}: {size} trials")
        elif done == size or now - said > _LINE_EVERY_S:
            said = now
            left = (now - began) / (done - first) * (size - done)
            progress_line(f"{name}: {done} of {size} trials, {left:.0f} s left")

    return line


@contextmanager
def unit_progress(count: int, *, quiet: bool) -> Iterator[Callable[[Unit], None]]:
    """Yield a function that takes every finished unit of a fleet: a bar on a terminal, one line each elsewhere.

    Parameters
    ----------
    count : int
        Number of all units.
    """
    if quiet:
        yield lambda unit: None  # noqa: ARG005 - nothing is shown
        return
    begun = time.monotonic()
    done, failed = 0, 0
    with bar("units", count) as move:

        def advance(unit: Unit) -> None:
            nonlocal done, failed
            done += 1
            failed += unit.exit_code != 0
            if move is not None:
                move(done, count, f"units, {failed} failed" if failed else "units")
                return
            left = (time.monotonic() - begun) / done * (count - done)
            rest = f", about {left:.0f} s left" if done < count else ""
            progress_line(f"{unit.name}: {unit.status.replace('_', ' ')} ({done} of {count}{rest})")

        yield advance
