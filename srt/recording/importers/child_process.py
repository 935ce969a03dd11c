"""Foreign logs read in one child process, with limits on its memory and on its computing time.

The libraries that parse logs trust the lengths and offsets that a file states. A damaged or hostile file makes them
reserve memory without end, loop, or crash. In a child process each of these ends in one sentence.

The parent sends a request as JSON on standard input: the reader, the file, the options. The child answers on standard
output with one line of JSON and then the bytes of the arrays. Nothing is pickled.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import math
import os
import signal
import subprocess
import sys
import traceback
import warnings
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple

import numpy as np

from srt.exceptions import DataError, InputError, MissingExtraError
from srt.recording.applied import applied_correction
from srt.recording.import_options import ImportOptions
from srt.recording.imported_samples import ImportedSamples

if TYPE_CHECKING:
    from collections.abc import Callable

MEMORY_ALLOWANCE: Final = 512 << 20
"""Bytes that a reader may reserve for any file: the libraries themselves take about 100 MiB."""

MEMORY_FACTOR: Final = 32
"""Bytes that it may reserve in addition for each byte of the file; compressed logs at rest take about 20."""

TIME_ALLOWANCE_S: Final = 20
"""Computing time that a reader may use for any file, s; the imports take 1 s, on a slow computer 10 s."""

TIME_PER_MIB_S: Final = 5
"""Computing time in addition for each MiB of the file, s; a compressed bag takes 0.2 to 2 s."""

ARRAYS: Final = ("gyro", "accel", "time", "temperature")
FIELDS: Final = ("kind", "sample_rate_hz", "serial", "date", "units", "notes")

NO_LIMITS_NOTE: Final = "This platform does not limit the memory of a process: read only logs from a trusted origin."

OUT_OF_MEMORY: Final = 77
"""Exit code of a child that reached its limit on memory; Python and the system use lower and higher ones."""

_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment of the child: a reader multiplies no matrices, and threads take time to start."""

_LONGEST_ANSWER = 1 << 20  # bytes of the line of JSON in an answer; notes and units take a few hundred


class ProcessLimits(NamedTuple):
    """Limits on a reader's process."""

    memory: int  # bytes reserved beyond those after the imports
    seconds: int  # computing time


def in_child(
    reader: str, package: str | None = None, purpose: str = ""
) -> Callable[[Path, ImportOptions], ImportedSamples]:
    """Make a reader that runs another one in a child process.

    ``reader`` is the "module:function" of the other one, which takes a path and options and returns samples;
    ``package`` is the package that it needs, of the extra "formats"; ``purpose`` is the file in the message if that is
    absent.
    """

    def read(path: Path, options: ImportOptions) -> ImportedSamples:
        if package is not None and importlib.util.find_spec(package) is None:
            raise MissingExtraError(package, "formats", purpose)
        return read_in_child(reader, path, options)

    return read


def read_in_child(reader: str, path: Path, options: ImportOptions) -> ImportedSamples:
    """Read a file in a child process by a "module:function".

    Raises InputError or DataError: an error of the reader, a limit that was exceeded, or a crash.
    """
    limits, place = limits_for(path), str(path.absolute())
    request = {"reader": reader, "path": place, "shown": str(path), "options": asdict(options), "limits": limits}
    with TemporaryDirectory(prefix="srt-", ignore_cleanup_errors=True) as scratch:
        child = spawn(json.dumps(request, default=str).encode("ascii"), Path(scratch))
        assert child.stdout is not None
        try:
            answer = _received(child.stdout)
        except BaseException:
            child.kill()
            raise
        finally:
            child.stdout.close()
            code = child.wait()
    if answer is None:
        raise InputError(_end_of_reader(path, code, limits))
    return answer


def spawn(request: bytes, scratch: Path) -> subprocess.Popen[bytes]:
    """Start the child process, with a folder for its temporary files, and send it the request."""
    # -P: a module in the current folder is not imported, unless the parent imports from there, too.
    paths = os.pathsep.join(each or str(Path.cwd()) for each in sys.path)
    environment = (
        os.environ | _ONE_THREAD | {"PYTHONPATH": paths} | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch))
    )
    pipe, command = subprocess.PIPE, [sys.executable, "-P", "-m", __name__]
    child = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, env=environment)  # noqa: S603
    assert child.stdin is not None
    with contextlib.suppress(BrokenPipeError), child.stdin:
        child.stdin.write(request)
    return child


def answer(request: bytes, out: BinaryIO) -> None:
    """Read a file and write the answer: the part of the child, in any process. Raises MemoryError at the limit."""
    asked = json.loads(request)
    path, shown = Path(asked["path"]), asked["shown"]
    module, _, function = asked["reader"].partition(":")
    reader = getattr(importlib.import_module(module), function)
    limited = impose(ProcessLimits(*asked["limits"]))
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            imported = reader(path, ImportOptions(**asked["options"]))
    except (InputError, DataError) as error:
        kind = "DataError" if isinstance(error, DataError) else "InputError"
        _send(out, {"error": kind, "message": str(error).replace(str(path), shown), "fault": error.fault}, [])
        return
    except MemoryError:
        raise
    # A defect of a reader shall be seen as such, with its place.
    except Exception:
        _send(out, {"error": "defect", "message": traceback.format_exc()}, [])
        return
    if not limited:
        imported = replace(imported, notes=(*imported.notes, NO_LIMITS_NOTE))
    arrays = {name: getattr(imported, name) for name in ARRAYS if getattr(imported, name) is not None}
    header = {name: getattr(imported, name) for name in FIELDS}
    header["notes"] = [note.replace(str(path), shown) for note in imported.notes]
    header["applied"] = None if imported.applied is None else imported.applied.document()
    header["arrays"] = {name: values.shape for name, values in arrays.items()}
    _send(out, header, [np.ascontiguousarray(values, dtype="<f8") for values in arrays.values()])


def limits_for(path: Path) -> ProcessLimits:
    """Limits for a file, or for a folder with all files in it, by their size."""
    files = path.iterdir() if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files if file.is_file())
    return ProcessLimits(
        MEMORY_ALLOWANCE + MEMORY_FACTOR * size, TIME_ALLOWANCE_S + math.ceil(TIME_PER_MIB_S * size / (1 << 20))
    )


def impose(limits: ProcessLimits) -> bool:
    """Limit memory, computing time and written files of this process; False where the platform cannot limit all."""
    try:
        import resource
    except ImportError:
        return False
    bounds = {resource.RLIMIT_CPU: limits.seconds, resource.RLIMIT_FSIZE: limits.memory, resource.RLIMIT_CORE: 0}
    statm = Path("/proc/self/statm")
    if statm.exists():
        # The limit counts from zero, so that the memory in use has to be known.
        in_use = int(statm.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
        bounds[resource.RLIMIT_AS] = in_use + limits.memory
    try:
        for which, bound in bounds.items():
            hard = resource.getrlimit(which)[1]
            resource.setrlimit(which, (bound if hard == resource.RLIM_INFINITY else min(bound, hard), hard))
    except (OSError, ValueError):
        return False
    return statm.exists()


def _send(out: BinaryIO, header: dict[str, Any], arrays: list[np.ndarray[Any, Any]]) -> None:
    out.write(json.dumps(header).encode("ascii") + b"\n")
    for values in arrays:
        out.write(values.data)
    out.flush()


def _received(stream: IO[bytes]) -> ImportedSamples | None:
    """Read an answer; None if it is not complete. Raises the error that it states."""
    line = stream.readline(_LONGEST_ANSWER)
    if not line.endswith(b"\n"):
        return None
    header = json.loads(line)
    if header.get("error") == "defect":
        raise RuntimeError(header["message"])
    if "error" in header:
        kind = DataError if header["error"] == "DataError" else InputError
        raise kind(header["message"], fault=header["fault"])
    for name, shape in header.pop("arrays").items():
        values: np.ndarray[Any, Any] = np.empty(shape, dtype="<f8")
        if values.size and stream.readinto(values.data.cast("B")) != values.nbytes:  # type: ignore[attr-defined]
            return None
        header[name] = values
    header["applied"] = applied_correction("the log", header["applied"])
    return ImportedSamples(**{**header, "notes": tuple(header["notes"])})


def _end_of_reader(path: Path, code: int, limits: ProcessLimits) -> str:
    """Sentence about a child that ended without an answer."""
    if code == OUT_OF_MEMORY:
        found = f"takes more than {limits.memory >> 20} MiB of memory to read, more than its size explains"
    elif code == -getattr(signal, "SIGXCPU", 0):
        found = f"takes more than {limits.seconds} s to read, more than its size explains"
    else:
        found = f"ended its reader (exit code {code})"
    return f"{path} {found}: it is damaged; copy it again."


def main() -> None:
    """Answer the request on standard input; libraries that print do not reach standard output."""
    out = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    try:
        answer(sys.stdin.buffer.read(), out)
    except MemoryError:
        # There may be no memory left for a sentence.
        os._exit(OUT_OF_MEMORY)
    # Without the destructors of the libraries, which may fail on a damaged file.
    os._exit(0)


if __name__ == "__main__":
    main()
