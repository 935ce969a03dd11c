"""Logs of text messages, one a line with a checksum: NovAtel RAWIMU and VectorNav VNIMU.

- NovAtel ``RAWIMUA``, ``RAWIMUSA``, ``RAWIMUXA``, ``RAWIMUSXA``: increments in counts, in the order z, −y, x
  (accelerometers first), week and second. The value of a count depends on the IMU: it must be stated.
- VectorNav ``VNIMU``: accelerations in m/s² and rates in rad/s after the magnetometer, without time.

Lines of other messages are passed over; damaged ones are counted in a note.
"""

from __future__ import annotations

import re
import zlib
from contextlib import suppress
from dataclasses import dataclass
from functools import partial, reduce
from operator import xor
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.imported_samples import ImportedSamples, StatedUnits, samples_in_si
from srt.recording.importer_registry import Importer, head
from srt.recording.schema import COUNTS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from srt.recording.import_options import ImportOptions
    from srt.recording.recording import Kind
    from srt.types import Array

_WEEK_S: Final = 604800.0
_ALL_ONES: Final = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class _Messages:
    """Messages of one maker."""

    title: str
    pattern: re.Pattern[str]  # groups: text that the checksum covers, name, fields, checksum
    checksum: Callable[[bytes], str]  # of the text, as hexadecimal digits
    places: Callable[[str], tuple[int, ...]]  # fields by the name: gyros, accelerometers, then week, second or celsius
    signs: tuple[float, ...]  # of gyros and accelerometers, x, y, z
    stated: StatedUnits
    kind: Kind


def _crc32(text: bytes) -> str:
    """NovAtel's CRC: the polynomial of zlib, from zero and not inverted at the end."""
    return f"{zlib.crc32(text, _ALL_ONES) ^ _ALL_ONES:08x}"


def _xor(text: bytes) -> str:
    return f"{reduce(xor, text, 0):02x}"


def _novatel_places(name: str) -> tuple[int, ...]:
    # The extended messages have information and type of the IMU in front.
    first = 2 if "X" in name.removeprefix("RAW") else 0
    return tuple(first + place for place in (8, 7, 6, 5, 4, 3, 0, 1))


_NOVATEL: Final = _Messages(
    "NovAtel RAWIMU",
    re.compile(r"[#%]((RAWIMUS?X?A),[^;*\r\n]*;([^*\r\n]*))\*([0-9a-fA-F]{8})"),
    _crc32,
    _novatel_places,
    (1.0, -1.0, 1.0, 1.0, -1.0, 1.0),
    StatedUnits(COUNTS, COUNTS, "s"),
    "increment",
)
_VECTORNAV: Final = _Messages(
    "VectorNav VNIMU",
    re.compile(r"\$((VNIMU),([^*\r\n]*))\*([0-9a-fA-F]{2})(?![0-9a-fA-F])"),
    _xor,
    lambda _: (6, 7, 8, 3, 4, 5, 9),
    (1.0,) * 6,
    StatedUnits("rad/s", "m/s^2", None),
    "rate",
)


def _read(messages: _Messages, path: Path, options: ImportOptions) -> ImportedSamples:
    rows, begun = [], 0
    name = messages.title.rpartition(" ")[2]
    with path.open(encoding="latin-1") as file:
        for line in file:
            begun += line.count(name)
            for match in messages.pattern.finditer(line):
                with suppress(ValueError, IndexError):
                    rows.append(_row(messages, match))
    if not rows:
        raise InputError(f"{path} holds no whole message {messages.title}: name another file or format.")
    table = np.array(rows)
    damaged = begun - len(rows)
    notes = (f"{damaged} damaged messages (end, checksum or fields) were left out.",) if damaged > 0 else ()
    values: Array = table[:, :6] * messages.signs
    timed = table.shape[1] == 8
    return samples_in_si(
        options,
        gyro=values[:, :3],
        accel=values[:, 3:],
        time=_WEEK_S * (table[:, 6] - table[0, 6]) + table[:, 7] if timed else None,
        stated=messages.stated,
        kind=messages.kind,
        temperature=None if timed or np.isnan(table[:, 6]).any() else table[:, 6],
        notes=notes,
    )


def _row(messages: _Messages, match: re.Match[str]) -> list[float]:
    """Values of a message. Raises ValueError or IndexError for a damaged one."""
    text, name, body, total = match.groups()
    if messages.checksum(text.encode("latin-1")) != total.lower():
        raise ValueError("checksum")
    fields = body.split(",")
    return [float(fields[i]) for i in messages.places(name)]


def _importer(name: str, messages: _Messages) -> Importer:
    def sniff(path: Path) -> bool:
        return messages.pattern.search(head(path).decode("latin-1")) is not None

    return Importer(name, f"{messages.title} messages (text)", (), None, sniff, partial(_read, messages))


NOVATEL: Final = _importer("novatel", _NOVATEL)
VECTORNAV: Final = _importer("vectornav", _VECTORNAV)
