"""TOML with bounds on size and key length, so that a hostile file is refused at once."""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import InputError, clipped
from srt.recording.file_guards import read_bounded

if TYPE_CHECKING:
    from pathlib import Path

MAX_BYTES: Final = 16 << 20
"""Largest TOML file, bytes: a hundred thousand sequence labels."""

MAX_KEY_PARTS: Final = 32
"""Largest number of parts of a dotted key: no known key has more than two, and parsing time grows with the square."""

_CLAUSE: Final = 160  # characters of a reason that a sentence quotes

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY: Final = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_KEY_PARTS}}}".encode())


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises InputError, if it cannot be read, is too large or not TOML, or has keys that are too long.
    """
    try:
        return _parsed(read_bounded(path, MAX_BYTES))
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): check the path and its permissions.") from None
    except ValueError as error:
        raise InputError(f"{path} is not valid TOML ({clipped(str(error), _CLAUSE)}): correct it there.") from None


def _parsed(data: bytes) -> dict[str, Any]:
    """Content of a TOML file; the message of a ValueError is a clause that says why there is none."""
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
