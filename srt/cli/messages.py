"""Messages: results on standard output, warnings and errors on standard error, without control characters."""

from __future__ import annotations

import re
import sys
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

import click

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_UNPRINTABLE: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters but tab and line feed, marks of writing direction, and bytes of names that are not UTF-8.

In a terminal they could move the cursor, change the title, or hide text."""


def printable(text: str) -> str:
    """Replace characters that act on a terminal by their escape codes, for instance ESC by x1b after a backslash."""
    return _UNPRINTABLE.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def figure_title(text: str) -> str:
    """Make a text safe as the title of a figure: printable, and with no formulas between dollar signs."""
    return printable(text).replace("$", r"\$")


@contextmanager
def output_errors() -> Iterator[None]:
    """Raise InputError where standard output cannot be written, and BrokenPipeError where its reader has gone."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(
            f"Standard output cannot be written ({error.strerror or error}): redirect it to a place that takes it."
        ) from None


def show(text: str = "") -> None:
    """Print a result on standard output. Raises InputError if it cannot be written."""
    with output_errors():
        click.echo(printable(text))


def progress_line(text: str) -> None:
    """Print a line of progress on standard error; where it cannot be written, nobody is to be told."""
    with suppress(OSError):
        click.echo(printable(text).replace("\n", " "), err=True)


def say(sentence: str) -> None:
    """Print one sentence on standard error."""
    progress_line(f"srt: {sentence}")


def warn(sentence: str) -> None:
    """Print a warning on standard error: something that did not stop the work."""
    say(f"warning: {sentence}")


def is_seen(*, quiet: bool) -> bool:
    """True if a report is shown on a terminal, so that nothing in it need be said on standard error."""
    return not quiet and sys.stdout is not None and sys.stdout.isatty()


def announce(*paths: Path | None, quiet: bool = False) -> None:
    """Print the files that were written; None stands for a file that was not asked for."""
    written = [str(path) for path in paths if path is not None]
    if written and not quiet:
        show(f"\nWritten: {', '.join(written)}")
