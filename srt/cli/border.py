"""Border of the command line: errors become sentences and exit codes, signals end a run as Ctrl-C does."""

from __future__ import annotations

import csv
import os
import signal
import sys
import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

import click

from srt.cli.messages import output_errors, say
from srt.exceptions import InputError, SrtError
from srt.recording.file_guards import memory_is_limited, require_memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

INTERRUPTED: Final = 128 + 2
"""Exit code after SIGINT, as a shell reports it."""
BROKEN_PIPE: Final = 128 + 13
"""Exit code after SIGPIPE, as a shell reports it."""

_BLAS_MEMORY_BYTES: Final = 160 << 20
"""Memory of the linear algebra, bytes: numpy and scipy have an OpenBLAS each, with a buffer of 32 MiB; and imports."""

_SPARE_BYTES: Final = 4 << 20
"""Memory that is given back before the sentence about a lack of memory is made: that needs some, too."""
_NO_DIRECTORY: Final = "The working directory does not exist any more: change to another one."


class TerminatedError(KeyboardInterrupt):
    """Interruption by SIGTERM or SIGHUP; it takes the way of Ctrl-C, so that temporary files are removed."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number


def guarded(work: Callable[[], int]) -> int:
    """Run a command; turn what it raises into one sentence on standard error and an exit code.

    A defect of this program keeps its traceback. The limits of the machine and of Python (disk, memory, nesting, digits
    of a number) are not defects, and standard streams may be closed or full.

    Parameters
    ----------
    work : callable
        Gives the exit code.
    """
    with _signals(), _without_display(), _output():
        try:
            code = _sentences(work)
            with output_errors():
                sys.stdout.flush()
        except BrokenPipeError:
            _discard_output()
            return BROKEN_PIPE
        except InputError as error:
            _discard_output()
            if code == 0:  # else a sentence tells already why
                say(str(error))
            return code or error.exit_code
        return code


def _reserve_memory() -> None:
    """Let OpenBLAS take its buffers where a limit of memory is set: it waits for ever for those that are refused later.

    Raises
    ------
    MemoryError
        If the limit leaves too little for them.
    """
    if not memory_is_limited():
        return
    require_memory(_BLAS_MEMORY_BYTES)
    import numpy as np
    import scipy.linalg.blas

    square = np.ones((128, 128))
    square @ square
    scipy.linalg.blas.dgemm(1.0, square, square)


def _sentences(work: Callable[[], int]) -> int:
    spare = bytearray(_SPARE_BYTES)
    try:
        _reserve_memory()
        return work()
    except click.exceptions.Exit as error:
        return error.exit_code
    except (click.Abort, KeyboardInterrupt) as error:
        with suppress(OSError):
            click.echo(err=True)  # ends the line on which the terminal shows ^C
        return error.exit_code if isinstance(error, TerminatedError) else INTERRUPTED
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx is not None else "srt"
        say(f"{error.format_message().rstrip('.')}: see '{path} --help'.")
        return error.exit_code
    except (click.ClickException, SrtError) as error:
        text = error.format_message() if isinstance(error, click.ClickException) else str(error)
        say(text if _has_working_directory() else _NO_DIRECTORY)  # the cause of the other sentence
        return error.exit_code
    except BrokenPipeError:
        raise
    except (OSError, MemoryError, RecursionError, ValueError, csv.Error) as error:
        spare.clear()
        sentence = limit_sentence(error)
        if sentence is None:
            raise
        say(sentence)
        return InputError.exit_code


def limit_sentence(error: Exception) -> str | None:
    """Sentence for an error of the machine or a limit of Python; None for any other error."""
    if isinstance(error, FileNotFoundError) and not _has_working_directory():
        return _NO_DIRECTORY
    if isinstance(error, OSError):
        place = "" if error.filename is None else f" with {error.filename}"
        return f"The operating system refused to work{place} ({error.strerror or error}): check disk and permissions."
    long = isinstance(error, csv.Error) or "Exceeds the limit" in str(error)
    sentences = {
        MemoryError: "There is not enough memory for this input: give a smaller one, or more memory.",
        RecursionError: "The input is nested too deeply to be read: give a file with fewer levels.",
        UnicodeError: f"A name or a text cannot be encoded ({error}): use names that are valid UTF-8.",
    }
    found = next((sentence for kind, sentence in sentences.items() if isinstance(error, kind)), None)
    return f"The input holds a number or a text that is too long to be read ({error})." if long else found


def _has_working_directory() -> bool:
    try:
        os.getcwd()  # noqa: PTH109 - only whether it exists
    except OSError:
        return False
    return True


def _discard_output() -> None:
    """Send standard output nowhere: the interpreter flushes it once more at its end, and must not fail then."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _output() -> Iterator[None]:
    """Let every write fail where a shell closed standard output: python has no stream then, and results would be lost.

    The descriptor is taken again, too, as the next file that is opened would have it and receive what libraries print.
    """
    if sys.stdout is not None:
        yield
        return
    with suppress(OSError), os.fdopen(os.open(os.devnull, os.O_RDONLY), "w") as refusing:
        sys.stdout = refusing
        try:
            yield
        finally:
            sys.stdout = None


@contextmanager
def _signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise an interruption in this thread while a command runs."""
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        names = []

    def interrupt(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - as signal wants it
        raise TerminatedError(number)

    # A signal that is ignored, as SIGHUP under nohup, stays so.
    chosen = [s for s in (getattr(signal, name) for name in names) if signal.getsignal(s) is signal.SIG_DFL]
    for each in chosen:
        signal.signal(each, interrupt)
    try:
        yield
    finally:
        for each in chosen:
            signal.signal(each, signal.SIG_DFL)


@contextmanager
def _without_display() -> Iterator[None]:
    """Let matplotlib draw to files alone, whatever MPLBACKEND says: no window is opened here."""
    before = os.environ.get("MPLBACKEND")
    os.environ["MPLBACKEND"] = "agg"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("MPLBACKEND", None)
        else:
            os.environ["MPLBACKEND"] = before
