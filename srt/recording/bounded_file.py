"""Reading of a whole file up to a bound: a device such as /dev/full has no size, and no end."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from os import PathLike

MAX_BYTES: Final = 64 << 20
"""Largest document, bytes: a calibration takes a few kilobytes for each sequence, so thousands of sequences."""

_PART: Final = 1 << 20
"""Bytes read at once, between which an interruption is served."""


def read_bounded(path: str | PathLike[str], limit: int = MAX_BYTES) -> bytes:
    """Read a whole file, whatever its size is stated to be.

    Parameters
    ----------
    limit : int
        Largest size, bytes.

    Raises
    ------
    OSError
        A file that cannot be read, or is longer than the limit; ``strerror`` is a clause that says why.
    """
    data = bytearray()
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123 - any path-like is welcome
        while part := file.read(_PART):
            data += part
            if len(data) > limit:
                raise OSError(errno.EFBIG, f"it is larger than {limit >> 20} MB")
    return bytes(data)
