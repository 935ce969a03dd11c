"""TOML with bounds on size and key length, so that a hostile file is refused at once."""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING, Any, Final

from srt.recording.bounded_file import read_bounded

if TYPE_CHECKING:
    from pathlib import Path

MAX_BYTES: Final = 16 << 20
"""Largest TOML file, bytes: a hundred thousand sequence labels."""

MAX_KEY_PARTS: Final = 32
"""Largest number of parts of a dotted key: no known key has more than two, and parsing time grows with the square."""

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY: Final = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_KEY_PARTS}}}".encode())


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    OSError
        A file that cannot be read, or is too large.
    ValueError
        A file that is not TOML, or has keys that are too long; the message is a clause that says why.
    """
    data = read_bounded(path, MAX_BYTES)
    long_key = _LONG_KEY.search(data)
    if long_key is not None:
        line = data.count(b"\n", 0, long_key.start()) + 1
        raise ValueError(f"a key in line {line} has more than {MAX_KEY_PARTS} parts")
    try:
        return tomllib.loads(data.decode("utf-8"))
    except RecursionError:
        raise ValueError("its values are nested too deep") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        raise
    except ValueError:  # Python's bound on the digits of an integer
        raise ValueError("a number in it has more than 4300 digits") from None
