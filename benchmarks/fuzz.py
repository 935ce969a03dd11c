"""Damaged and hostile input to every reader and to recording.toml: nothing but a recording or a clear error.

``python benchmarks/fuzz.py`` gives 100,000 inputs, shared out evenly; ``--count N`` as many in all, ``--only NAME ...``
some readers, ``--first N`` other inputs, ``--one NAME:INDEX`` a single input again, with its error in full.

Each input is a valid file, made by its format's own library, and damaged: bits turned, bytes cut off, moved, doubled,
numbers in it replaced by hostile ones. What is checked of every one:

- a recording or imported samples come out, or InputError, DataError; the message is one line;
- no more than ``--memory`` MiB are reserved beyond what the process has at its start, and less than 10 s are used;
- no file is opened outside the input's folder, no program is run, no pickle is read, no code is made of the input;
- of lines that are corrected as they arrive ("stream"), each has one answer: none, or the correction of its numbers.

A reader's inputs run in a process of their own, so that a crash is counted and does not end the run. The readers that
start a child process get a fork of it in place of a new interpreter, which takes 5 ms in place of 200 ms; the fork is
watched, too. The numbers of the inputs are the seeds: the same number makes the same input.
"""

from __future__ import annotations

import gc
import io
import os
import re
import resource
import shutil
import signal
import sys
import sysconfig
import tempfile
import traceback
import warnings
import zipfile
import zlib
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from unittest import mock

import harness
import numpy as np
from fuzz_seeds import READERS, RECORDINGS, Seed
from fuzz_streams import STREAMS, correct_lines

import srt
from srt.exceptions import DataError, InputError
from srt.recording.imported_samples import to_recording
from srt.recording.importer_registry import IMPORTERS, find_importer, import_file, importer
from srt.recording.importers import child_process
from srt.recording.recording import Site

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

NAMES = (*READERS, *RECORDINGS, *STREAMS)
SECONDS_PER_INPUT = 10
"""Computing time of this process, s, after which an input counts as one that hangs; a busy machine does not matter."""
SECONDS_TO_KILL = 20
"""Computing time, s, after which the process is ended: compiled code does not stop for a signal of the interpreter."""
TOTAL = 100_000
"""Inputs in all, without ``--count``."""
FORBIDDEN_EVENTS = frozenset({"pickle.find_class", "os.system", "subprocess.Popen", "os.exec", "os.posix_spawn"})
SITE = Site(9.80665, 5e-4)

INTEGERS = (0, 1, 2, 3, 7, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 40,
            (1 << 62) + 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)  # fmt: skip
TOKENS = (
    b"", b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e-320", b"-0.0", b"0", b"-1", b"1_000", b"0x10", b"1,5",
    b"9" * 400, b"18446744073709551616", b"true", b"[]", b"[[[]]]", b"{}", b'""', b"'", b'"', b"\x00", b"\xff\xfe",
    b"#", b"\n", b"\r", b";", b"\t", "°".encode(), b"[" * 3000, b"{a=" * 3000, b"1979-05-27T07:32:00Z", b"12:00:00",
    b'"/etc/passwd"', b'"../secret.csv"', b'"samples.csv/../../x.csv"', b'"recording.toml"', b'"."', b'"\\u0000"',
    b'"samples.h5"', b'"samples.npz"', b'"counts"', b'"deg/s"', b'"increment"', b"1e-300", b"4.9e-324", b"1e300",
    b"%s%n", b"${HOME}", b"__import__('os').system('true')", b"!!python/object/apply:os.system [\"true\"]", b"A" * 5000,
)  # fmt: skip
"""Words that replace numbers and words of text."""
WORD = re.compile(rb"[A-Za-z0-9_.+-]+|\"[^\"\n]*\"")


def mutate(data: bytes, name: str, pool: list[bytes], rng: np.random.Generator) -> bytes:
    """Damage a file in one to four places, with pieces of other files (``pool``).

    Members of a zip archive are damaged inside, too, as their checksums would hide it.
    """
    if name.endswith(".npz") and rng.random() < 0.6:
        return _inside_zip(data, pool, rng)
    text, result = not any(c < 9 for c in data[:200]), bytearray(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 4]))):
        table = TEXT if text and rng.random() < 0.7 else BINARY
        result = table[int(rng.integers(len(table)))](result, pool, rng)
    return bytes(result[: 1 << 20])


def set_bytes(data: bytearray, _pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """Single bits and bytes, and counts that are nearly right."""
    for _ in range(int(rng.integers(1, 9)) if data else 0):
        at = _place(len(data), rng)
        new = (
            data[at] ^ (1 << int(rng.integers(8))),
            int(rng.integers(256)),
            (data[at] + int(rng.choice([-1, 1]))) % 256,
        )
        data[at] = new[int(rng.integers(3))]
    return data


def cut(data: bytearray, _pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """An end or a start that is absent."""
    return data[: int(rng.integers(len(data) + 1))] if rng.random() < 0.5 else data[int(rng.integers(1, 65)) :]


def hostile_number(data: bytearray, _pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """Number where a count or a length may stand."""
    width = int(rng.choice([1, 2, 4, 8]))
    at = _place(max(len(data) - width, 1), rng)
    at -= at % width if rng.random() < 0.5 else 0
    choice = (*INTEGERS, len(data), len(data) + 1, len(data) - at)
    value = choice[int(rng.integers(len(choice)))] & ((1 << 8 * width) - 1)
    data[at : at + width] = value.to_bytes(width, "little" if rng.random() < 0.8 else "big")
    return data


def piece(data: bytearray, pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """A piece lost, doubled, or of zeros, as of a disk; or of another file, put in or over."""
    at, size, other = _place(len(data), rng), int(2.0 ** rng.uniform(0.0, 9.0)), pool[int(rng.integers(len(pool)))]
    own, start = bytes(data[at : at + size]), _place(len(other), rng)
    new, over = (
        (b"", size), (own * int(rng.integers(1, 9)), 0), (bytes(len(own)), size),
        (other[start : start + size], size), (other[start : start + size], 0),
    )[int(rng.integers(5))]  # fmt: skip
    data[at : at + over] = new
    return data


def replace_word(data: bytearray, _pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """A word of text replaced by a hostile one, or by another of the same file."""
    words = list(WORD.finditer(data))
    if words:
        start, end = words[int(rng.integers(len(words)))].span()
        token = TOKENS[int(rng.integers(len(TOKENS)))]
        data[start:end] = token if rng.random() < 0.8 else words[int(rng.integers(len(words)))].group()
    return data


def insert_token(data: bytearray, _pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """A hostile word anywhere."""
    at = _place(len(data), rng)
    data[at:at] = TOKENS[int(rng.integers(len(TOKENS)))]
    return data


def edit_lines(data: bytearray, _pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """A line dropped, doubled or moved."""
    lines = bytes(data).split(b"\n")
    i, j = (int(rng.integers(len(lines))) for _ in range(2))
    line = lines[i]
    if rng.random() < 0.6:
        del lines[i]
    if rng.random() < 0.6:
        lines.insert(j, line)
    return bytearray(b"\n".join(lines))


BINARY = (set_bytes, set_bytes, cut, hostile_number, hostile_number, piece, piece)
TEXT = (replace_word, replace_word, replace_word, insert_token, edit_lines)


def _place(size: int, rng: np.random.Generator) -> int:
    """Place of a damage: in half of the cases within the first or the last bytes, where headers and footers stand."""
    if size < 1 or rng.random() < 0.5:
        return int(rng.integers(max(size, 1)))
    at = int(rng.integers(min(size, 2 ** rng.integers(3, 10))))
    return at if rng.random() < 0.7 else size - 1 - at


def _inside_zip(data: bytes, pool: list[bytes], rng: np.random.Generator) -> bytes:
    """Damage one member of an archive, its checksum made anew; sometimes its name."""
    source, out = zipfile.ZipFile(io.BytesIO(data)), io.BytesIO()
    members = {name: source.read(name) for name in source.namelist()}
    chosen = str(rng.choice(list(members)))
    member = mutate(members.pop(chosen), "member.npy", pool, rng)
    if rng.random() < 0.1:
        chosen = ("../" * 3 + chosen, "/" + chosen, chosen * 50, "a\x01.npy")[int(rng.integers(4))]
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in (members | {chosen: member}).items():
            target.writestr(name, content)
    return out.getvalue()


class HangError(BaseException):
    """An input that takes too long; no Exception, so that no reader reports it as damage."""


class Watch:
    """Audit events of the interpreter on files and code while an input is read."""

    def __init__(self, folder: Path) -> None:
        places = [sys.prefix, sys.base_prefix, *sysconfig.get_paths().values(), str(Path(srt.__file__).parents[1])]
        self.allowed = (*{os.path.realpath(place) for place in (*places, folder)}, "/dev/null", "/proc/")
        self.temporary = os.path.realpath(folder.parent)
        self.on = False
        self.seen: list[str] = []
        sys.addaudithook(self.hook)

    def hook(self, event: str, args: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event in FORBIDDEN_EVENTS:
            self.seen.append(f"{event} {args!r}"[:200])
        elif event == "exec":
            name = getattr(args[0], "co_filename", "?")
            # Modules imported late are executed as well; a namedtuple or dataclass made of fixed names is not.
            if not name.startswith(self.allowed) and not name.startswith("<frozen"):
                self.seen.append(f"exec {name}")
        elif event == "open" and isinstance(args[0], str | bytes | os.PathLike):
            path = os.path.realpath(os.fsdecode(args[0]))
            if not path.startswith(self.allowed) and not path.startswith(f"{self.temporary}/srt-"):
                self.seen.append(f"open {path}"[:200])


class Fork:
    """A fork that reads one file, as :func:`srt.recording.importers.child_process.spawn` starts an interpreter.

    Its events are added to those of the watch, if one is given.
    """

    def __init__(self, request: bytes, scratch: Path, watch: Watch | None = None) -> None:
        self.watch, self.events = watch, scratch / "events"
        source, sink = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # forks of a process with threads: it has none of ours
            self.id = os.fork()
        if not self.id:
            self._answer(request, scratch, sink)
        os.close(sink)
        self.stdout = os.fdopen(source, "rb")

    def _answer(self, request: bytes, scratch: Path, sink: int) -> None:
        code = 1
        try:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            os.dup2(nowhere, 2)
            sys.stdout = sys.stderr = os.fdopen(nowhere, "w")  # a test may have replaced the streams of this process
            tempfile.tempdir = str(scratch)
            with os.fdopen(sink, "wb") as out:
                child_process.answer(request, out)
            code = 0
        except MemoryError:
            code = child_process.OUT_OF_MEMORY
        finally:
            if self.watch is not None:
                self.watch.on = False
                self.events.write_text("\n".join(self.watch.seen), encoding="utf-8")
            os._exit(code)

    def wait(self) -> int:
        code = os.waitstatus_to_exitcode(os.waitpid(self.id, 0)[1])
        if self.watch is not None and self.events.exists():
            self.watch.seen += self.events.read_text(encoding="utf-8").splitlines()
        return code

    def kill(self) -> None:
        os.kill(self.id, signal.SIGKILL)


class InProcess:
    """The answer of a reader in this process, in place of a child's."""

    def __init__(self, request: bytes, _scratch: Path) -> None:
        self.stdout = io.BytesIO()
        child_process.answer(request, self.stdout)
        self.stdout.seek(0)

    def wait(self) -> int:
        return 0

    def kill(self) -> None:
        pass


def place(seed: Seed, folder: Path, rng: np.random.Generator | None, pool: list[bytes]) -> Path:
    """Write a seed's files, one of them damaged (none without a generator)."""
    damaged = ""
    if rng is not None:
        names = seed.damaged or tuple(sorted(seed.files))
        damaged = names[int(rng.integers(len(names)))]
    for name, data in seed.files.items():
        (folder / name).write_bytes(mutate(data, name, pool, rng) if rng is not None and name == damaged else data)
    return folder / seed.target


def read(name: str, seed: Seed, path: Path) -> None:
    """Read one input to the end, as the command line does."""
    if name in RECORDINGS:
        srt.load_recording(path)
        return
    if name in STREAMS:
        correct_lines(seed, path)
        return
    with suppress(InputError):
        find_importer(path)
    options = seed.options
    if options.second is not None:
        options = replace(options, second=path.parent / options.second)
    _, imported = import_file(path, options, name)
    to_recording(imported, SITE)


def judge(name: str, seed: Seed, path: Path, watch: Watch) -> str:
    """Outcome of one input: "read", "refused", or the failure."""
    watch.seen.clear()
    watch.on = True
    signal.setitimer(signal.ITIMER_PROF, SECONDS_PER_INPUT)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS_TO_KILL)
    try:
        read(name, seed, path)
        outcome = "read"
    except (InputError, DataError) as error:
        text = str(error)
        outcome = "refused"
        if len(text.splitlines()) != 1 or len(text) > 1500:
            outcome = f"message of {len(text.splitlines())} lines, {len(text)} characters"
        elif "fit into memory" in text:
            outcome = "memory"
    except HangError:
        outcome = f"more than {SECONDS_PER_INPUT} s"
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        outcome = f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}: {str(error)[:120]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        watch.on = False
    return watch.seen[0] if watch.seen else outcome


def seeds_of(name: str) -> list[Seed]:
    return (READERS | RECORDINGS | STREAMS)[name]()


def pool_of(seeds: list[Seed]) -> list[bytes]:
    """Files whose pieces damage others."""
    return [data for seed in seeds for data in seed.files.values()]


def generator(name: str, index: int) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(name.encode()), index])


def worker(name: str, indices: range, memory_mib: int, scratch: Path, progress: Any, found: Connection) -> None:
    """Run the inputs of a reader in a process of their own.

    ``progress`` receives the number of the input, the counts of read and refused ones, and at the end the growth of the
    memory in MiB; ``found`` a sentence for each failure.
    """
    seeds, folder = seeds_of(name), scratch / "input"
    pool = pool_of(seeds)
    watch = Watch(folder)
    unraisable: list[str] = []
    sys.unraisablehook = lambda info: unraisable.append(f"unraisable {info.exc_type.__name__}: {info.exc_value}"[:160])
    signal.signal(signal.SIGPROF, _alarm)
    # Modules and code that are made once are made before the watch begins.
    for each in IMPORTERS:
        importer(each)
    impose, child_process.impose, child_process.spawn = child_process.impose, lambda _: True, InProcess
    for seed in seeds:
        _fresh(folder)
        read(name, seed, place(seed, folder, None, pool))
    gc.collect()  # files that the libraries left open
    child_process.impose, child_process.spawn = impose, partial(Fork, watch=watch)
    warnings.simplefilter("error")
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    limit = used + (memory_mib << 20)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    outcomes: Counter[str] = Counter()
    for index in indices:
        progress[:3] = index, outcomes["read"], outcomes["refused"]
        _fresh(folder)
        seed = seeds[index % len(seeds)]
        path = place(seed, folder, generator(name, index), pool)
        unraisable.clear()
        outcome = judge(name, seed, path, watch)
        outcome = unraisable[0] if unraisable and outcome in ("read", "refused") else outcome
        outcomes[outcome] += 1
        if outcome not in ("read", "refused"):
            found.send(f"{name}:{index} {outcome!r}")
    peaks = [resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    progress[1:] = outcomes["read"], outcomes["refused"], (max(peaks) - before) >> 10


def supervise(name: str, indices: range, memory_mib: int) -> tuple[int, int, list[str], int]:
    """Run inputs of a reader in own processes; counts of read and refused, failures, peak growth in MiB."""
    context, failures, taken, refused = get_context("spawn"), [], 0, 0
    with TemporaryDirectory(prefix="fuzz-") as scratch, mock.patch.dict(os.environ, TMPDIR=scratch):
        while True:
            progress, (received, sent) = context.Array("q", [-1, 0, 0, 0], lock=False), context.Pipe(duplex=False)
            child = context.Process(target=worker, args=(name, indices, memory_mib, Path(scratch), progress, sent))
            child.start()
            sent.close()
            with suppress(EOFError):  # the process has ended
                while True:
                    failures.append(received.recv())
            child.join()
            index, read_now, refused_now, grown = progress
            taken, refused = taken + read_now, refused + refused_now
            if child.exitcode == 0:
                return taken, refused, failures, grown
            if index < 0:
                raise SystemExit(f"{name}: the process ended before its first input")
            slow = child.exitcode == -signal.SIGVTALRM
            reason = f"more than {SECONDS_TO_KILL} s in compiled code" if slow else f"ended with {child.exitcode}"
            failures.append(f"{name}:{index} {reason}")
            indices = range(index + 1, indices.stop)


def _alarm(*_: object) -> None:
    raise HangError


def _fresh(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir()


def once(text: str) -> None:
    """Read one input again; its error is shown in full."""
    name, _, index = text.rpartition(":")
    seeds = seeds_of(name)
    seed = seeds[int(index) % len(seeds)]
    with TemporaryDirectory(prefix="fuzz-") as folder:
        read(name, seed, place(seed, Path(folder), generator(name, int(index)), pool_of(seeds)))
        print("read")


def main(
    *,
    count: int = TOTAL,
    first: int = 0,
    only: tuple[str, ...] = NAMES,
    memory: int = 512,
    one: str | None = None,
) -> int:
    if one is not None:
        once(one)
        return 0
    widths = 8, 8, 9, 8, 12
    print(f"{'reader':<16}{'inputs':>8}{'read':>8}{'refused':>9}{'failed':>8}{'grown, MiB':>12}", flush=True)
    rows, failures = [], []
    for number, name in enumerate(only):
        share = count // len(only) + (number < count % len(only))
        taken, refused, wrong, grown = supervise(name, range(first, first + share), memory)
        failures += wrong
        rows.append((share, taken, refused, len(wrong), grown))
        print(f"{name:<16}" + "".join(f"{n:>{w}}" for n, w in zip(rows[-1], widths, strict=True)), flush=True)
    sums = np.sum(rows, axis=0).tolist()[:-1]
    print(f"{'in all':<16}" + "".join(f"{n:>{w}}" for n, w in zip(sums, widths, strict=False)), *failures, sep="\n")
    return int(bool(failures))


if __name__ == "__main__":
    harness.run(main, __doc__, only=NAMES)
