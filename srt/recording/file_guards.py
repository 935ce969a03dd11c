"""Guards of reading: bounds of whole files, errors of libraries as sentences, stated sizes, limits of memory."""

from __future__ import annotations

import errno
import mmap
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import InputError, MissingExtraError, SrtError, clipped

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

MAX_BYTES: Final = 64 << 20
"""Largest document, bytes: a calibration takes a few kilobytes for each sequence, so thousands of sequences."""

_PART: Final = 1 << 20  # bytes read at once, between which an interruption is served

DEFLATE_LIMIT: Final = 1032
"""Largest compression ratio of deflate; the limit for other compressors too."""

SLACK_BYTES: Final = 1 << 20
"""Size, bytes, accepted at any ratio: small files have constant columns."""

_PYARROW_BYTES: Final = 256 << 20
"""Memory that loading pyarrow and reading a small file take, with the stacks of its threads."""

_REASON_LENGTH = 160  # characters of a library's message that a sentence quotes


def read_bounded(path: str | PathLike[str], limit: int = MAX_BYTES) -> bytes:
    """Read a whole file of at most ``limit`` bytes: a device such as /dev/full has no size, and no end.

    Raises OSError for a file that cannot be read, or is longer; its ``strerror`` is a clause that says why.
    """
    data = bytearray()
    if Path(path).is_dir():
        raise IsADirectoryError(errno.EISDIR, "it is a folder, and a file is expected")
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123 - any path-like is welcome
        while part := file.read(_PART):
            data += part
            if len(data) > limit:
                raise OSError(errno.EFBIG, f"it is larger than {limit >> 20} MB")
    return bytes(data)


@contextmanager
def clear_errors(path: Path, title: str) -> Iterator[None]:
    """Turn any error of a library into an InputError that names the file; ``title`` is its kind, as "ROS 1 bag".

    Only calls of the library belong into the block. A lack of memory passes through: the caller knows the limit.
    """
    try:
        yield
    except (SrtError, MemoryError):
        raise
    # Parsers of foreign formats raise any exception on damaged input, from AssertionError to struct.error.
    except Exception as error:
        raise InputError(
            f"{path} is not a readable {title} ({reason_of(error)}): it may be cut off or damaged; copy it again."
        ) from None


def reason_of(error: BaseException) -> str:
    """First line of an error's message, at most 160 characters; the type of the error if it has no message."""
    lines = str(error).strip().splitlines() or [""]
    return clipped(lines[0].rstrip("."), _REASON_LENGTH) or type(error).__name__


def require_size(path: Path, what: str, promised: int, present: int, factor: int = DEFLATE_LIMIT) -> None:
    """Refuse an array, named ``what``, whose stated size is larger than its bytes in the file can expand to.

    ``promised`` and ``present`` are bytes, ``factor`` is the largest ratio of the two. Raises InputError.
    """
    if not 0 <= promised <= factor * present + SLACK_BYTES:
        raise InputError(
            f"{path}: {what} is stated to be {promised} bytes long, more than its {present} bytes in the file can "
            "expand to: the file is damaged; copy or export it again."
        )


def load_pyarrow(module: str, what: str = "A Parquet file") -> tuple[Any, Any]:
    """Import pyarrow and one of its modules, which the file ``what`` needs.

    Raises MissingExtraError, or MemoryError if a limit leaves too little memory: pyarrow's own code then ends the
    process.
    """
    require_memory(_PYARROW_BYTES)
    try:
        return import_module("pyarrow"), import_module(f"pyarrow.{module}")
    except ImportError:
        raise MissingExtraError("pyarrow", "io", what) from None


def require_memory(size: int) -> None:
    """Require bytes for a library that ends badly without them, where the system limits memory. Raises MemoryError."""
    if memory_is_limited():
        try:  # reserved and not touched: filling it with zeros takes a third of a second
            mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS).close()
        except OSError:
            raise MemoryError from None


def memory_is_limited() -> bool:
    """True if the system limits the memory of this process."""
    try:
        import resource
    except ModuleNotFoundError:  # no such limits on this system
        return False
    kinds = resource.RLIMIT_DATA, resource.RLIMIT_AS
    return any(resource.getrlimit(kind)[0] != resource.RLIM_INFINITY for kind in kinds)
