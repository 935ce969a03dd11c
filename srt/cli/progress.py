"""Progress of play-backs on standard error: one moving line on a terminal, one line each elsewhere."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


def _sentence(name: str, number: int, correction: float) -> str:
    return f"{name}: play-back {number}, largest correction {correction:.1e}"


@contextmanager
def playback_progress(name: str, *, quiet: bool) -> Iterator[Callable[[int, float], None] | None]:
    """Lend a function that an estimator calls after every play-back.

    Parameters
    ----------
    name : str
        Of the recording.
    quiet : bool

    Yields
    ------
    callable or None
        Takes the number of the play-back and the largest correction; None if quiet.
    """
    if quiet:
        yield None
        return
    if sys.stderr.isatty():
        try:
            from rich.console import Console
        except ModuleNotFoundError:
            pass  # plain lines tell the same
        else:
            console = Console(stderr=True, highlight=False)
            with console.status(f"{name}: preparing") as status:
                yield lambda number, correction: status.update(_sentence(name, number, correction))
            return
    yield lambda number, correction: click.echo(_sentence(name, number, correction), err=True)
