"""Guards around libraries that parse foreign files: what a hostile or damaged file may cost, and what it may raise.

A header that promises terabytes is answered with the bytes that are there, one that sends its reader round in circles
with an error, and a compressed block may not grow beyond a stated size. Whatever the library then raises becomes one
sentence that names the file.
"""

from __future__ import annotations

import io
import os
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, Protocol

from srt.exceptions import InputError, MissingExtraError, SrtError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import ModuleType

READ_FACTOR: Final = 32
"""How many times over a library may read a file, before the file is taken for one that leads in circles."""

OPEN_FACTOR: Final = 4
"""How many times over it may do so to open a bag, when all that it reads stays in memory."""

READ_ALLOWANCE: Final = 1 << 20
"""Bytes that may be read beyond that: small files have more of headers than of anything else."""

INFLATED_LIMIT: Final = 1 << 28
"""Bytes to which one compressed block may grow; writers use blocks of about a megabyte."""

_STREAMS_PER_BLOCK = 16
_STANDARD_ERROR = 2
_SMALL_READ = 1 << 12  # bytes, reserved without asking whether they are there


class BoundedFile(io.RawIOBase):
    """A file whose reads give what is there, however much is asked for, and do not go on for ever.

    Parameters
    ----------
    path : Path
    factor : int
        How many times over it may be read.

    Raises
    ------
    OSError
        From reading, when that is used up.
    """

    def __init__(self, path: Path, factor: int = READ_FACTOR) -> None:
        super().__init__()
        self._file = path.open("rb")
        self._size = os.fstat(self._file.fileno()).st_size
        self._left = 0
        self.allow(factor)

    def allow(self, factor: int) -> None:
        """Let the file be read so many times over from now on."""
        self._left = factor * self._size + READ_ALLOWANCE

    def read(self, size: int | None = -1, /) -> bytes:
        """Read at most what is left of the file: asking for more would reserve memory for it."""
        count = -1 if size is None else size
        if not 0 <= count <= _SMALL_READ:
            rest = max(0, self._size - self._file.tell())
            count = rest if count < 0 else min(count, rest)
        self._left -= count
        if self._left < 0:
            raise OSError("it leads its reader in circles")
        return self._file.read(count)

    def readline(self, size: int | None = -1, /) -> bytes:
        """Read a line, no longer than the rest of the file."""
        line = self._file.readline(-1 if size is None else size)
        self._left -= len(line)
        return line

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Move within the file or beyond its end."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Where the next read begins."""
        return self._file.tell()

    def readable(self) -> bool:
        """True."""
        return True

    def seekable(self) -> bool:
        """True."""
        return True

    def close(self) -> None:
        """Close the file beneath."""
        self._file.close()
        super().close()


class BoundedPath:
    """As much of a path as the bag readers use; opens a :class:`BoundedFile`.

    Parameters
    ----------
    path : Path
    suffix : str
        What the content says, whatever the name ends in.
    """

    def __init__(self, path: Path, suffix: str) -> None:
        self._path = path
        self.suffix = suffix
        self.name = path.name
        self.stem = path.stem
        self._opened: list[BoundedFile] = []

    def exists(self) -> bool:
        """Whether the file is there."""
        return self._path.exists()

    def is_dir(self) -> bool:
        """False: only files are wrapped."""
        return False

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """The file's."""
        return self._path.stat(follow_symlinks=follow_symlinks)

    def open(self, *_args: object, **_kwargs: object) -> BinaryIO:
        """Open for reading bytes, whatever the mode."""
        self._opened.append(BoundedFile(self._path, OPEN_FACTOR))
        return self._opened[-1]  # type: ignore[return-value]

    def allow(self, factor: int) -> None:
        """Let the open files be read so many times over from now on."""
        for file in self._opened:
            file.allow(factor)

    def read_text(self, encoding: str | None = None) -> str:
        """Read the file as text."""
        return self._path.read_text(encoding)

    def __truediv__(self, key: object) -> BoundedPath:
        raise NotADirectoryError(str(self._path / str(key)))

    def __str__(self) -> str:
        return str(self._path)


class Inflater(Protocol):
    """A decompressor as bz2, lzma, lz4 and zstd have it."""

    eof: bool
    unused_data: bytes | None

    def decompress(self, data: bytes, max_length: int = ...) -> bytes:
        """Give the next bytes, at most ``max_length``."""
        ...


def inflate(make: Callable[[], Any], data: bytes, limit: int = INFLATED_LIMIT) -> bytes:
    """Decompress a block that may not grow beyond a limit.

    Parameters
    ----------
    make : callable
        Makes an :class:`Inflater`; one is needed for each of several streams joined end to end.
    data : bytes
    limit : int
        Bytes.

    Returns
    -------
    bytes

    Raises
    ------
    ValueError
        A block that grows beyond the limit, or is cut off.
    """
    parts: list[bytes] = []
    left = min(limit, INFLATED_LIMIT)
    rest: bytes | None = data
    while rest:
        if len(parts) == _STREAMS_PER_BLOCK:
            raise ValueError("a compressed block is chopped into pieces")
        inflater: Inflater = make()
        part = inflater.decompress(rest, max_length=left + 1)
        left -= len(part)
        if left < 0:
            raise ValueError("a compressed block grows beyond the size that it states, or 256 MiB")
        if not inflater.eof:
            raise ValueError("a compressed block is cut off")
        parts.append(part)
        rest = inflater.unused_data
    return b"".join(parts)


@contextmanager
def library(path: Path, title: str) -> Iterator[None]:
    """Turn whatever a library raises over a file into one sentence that names the file.

    Nothing but calls of the library belongs into the block.

    Parameters
    ----------
    path : Path
    title : str
        What the file was taken for.

    Raises
    ------
    InputError
    """
    try:
        yield
    except SrtError:
        raise
    except MemoryError:
        raise InputError(f"{path} does not fit into memory, or is damaged: copy it again, or split it.") from None
    # Parsers of foreign formats raise whatever the damage leads them into, from AssertionError to struct.error.
    except Exception as error:
        raise InputError(
            f"{path} is not a readable {title} ({reason_of(error)}): it may be cut off or damaged; copy it again."
        ) from None


@contextmanager
def silence() -> Iterator[None]:
    """Swallow what libraries print about damage: it may be longer than the file, and the error says it."""
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield


@contextmanager
def silence_below() -> Iterator[None]:
    """Swallow what compiled libraries print, too, which go past Python to the standard error of the process."""
    with silence(), ExitStack() as stack:
        with suppress(OSError):  # there may be no such thing, as in a program of windows
            kept = os.dup(_STANDARD_ERROR)
            stack.callback(os.close, kept)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            stack.callback(os.close, nowhere)
            os.dup2(nowhere, _STANDARD_ERROR)
            stack.callback(os.dup2, kept, _STANDARD_ERROR)
        yield


def reason_of(error: BaseException) -> str:
    """The first line of a message, short enough for a sentence; the error's type where there is none."""
    text = str(error).strip()[:400]
    line = "".join(c if c.isprintable() else "?" for c in (text.splitlines() or [""])[0]).rstrip(".")
    return line[:160] or type(error).__name__


def require(package: str, purpose: str, load: Callable[[], ModuleType]) -> Any:
    """Import an optional package. Raises MissingExtraError if it is absent."""
    try:
        return load()
    except ImportError:
        raise MissingExtraError(package, "formats", purpose) from None
