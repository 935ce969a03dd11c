"""Logs of text messages, one a line with a checksum: NovAtel RAWIMU and VectorNav VNIMU.

- NovAtel ``RAWIMUA``, ``RAWIMUSA``, ``RAWIMUXA``, ``RAWIMUSXA``: increments in counts, in the order z, −y, x
  (accelerometers first), week and second. The value of a count depends on the IMU: it must be stated.
- VectorNav ``VNIMU``: accelerations in m/s² and rates in rad/s after the magnetometer, without time.

Lines of other messages are passed over; damaged ones are counted in a note.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
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
    """Messages of one maker.

    Attributes
    ----------
    pattern : re.Pattern
        Groups: text that the checksum covers, name, fields, checksum.
    checksum : callable
        Checksum of the text, as hexadecimal digits.
    places : callable
        From the fields of one message to those of week, second (None without time), gyros, accelerometers, temperature
        (None without).
    signs : tuple of 6 floats
        Signs of gyros and accelerometers, x, y, z.
    kind : "rate" or "increment"
    """

    title: str
    pattern: re.Pattern[str]
    checksum: Callable[[bytes], str]
    places: Callable[[str], tuple[tuple[int, int] | None, tuple[int, ...], int | None]]
    signs: tuple[float, ...]
    stated: StatedUnits
    kind: Kind


def _crc32(text: bytes) -> str:
    """NovAtel's CRC: the polynomial of zlib, from zero and not inverted at the end."""
    return f"{zlib.crc32(text, _ALL_ONES) ^ _ALL_ONES:08x}"


def _xor(text: bytes) -> str:
    total = 0
    for byte in text:
        total ^= byte
    return f"{total:02x}"


def _novatel_places(name: str) -> tuple[tuple[int, int], tuple[int, ...], None]:
    # The extended messages have information and type of the IMU in front.
    first = 2 if "X" in name.removeprefix("RAW") else 0
    accel, gyro = first + 3, first + 6
    return (first, first + 1), (gyro + 2, gyro + 1, gyro, accel + 2, accel + 1, accel), None


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
    lambda _: (None, (6, 7, 8, 3, 4, 5), 9),
    (1.0,) * 6,
    StatedUnits("rad/s", "m/s^2", None),
    "rate",
)


def _read(messages: _Messages, path: Path, options: ImportOptions) -> ImportedSamples:
    rows, damaged = [], 0
    try:
        with path.open(encoding="latin-1") as file:
            for line in file:
                match = messages.pattern.search(line)
                if match is None:
                    continue
                try:
                    row = _row(messages, match)
                except (ValueError, IndexError):
                    damaged += 1
                    continue
                rows.append(row)
    except OSError as error:
        raise InputError(f"Cannot read {path} ({error.strerror}): check its permissions.") from None
    if not rows:
        raise InputError(f"{path} holds no whole message {messages.title}: name another file or format.")
    table = np.array(rows)
    notes = (f"{damaged} damaged messages (checksum or fields) were left out.",) if damaged else ()
    values: Array = table[:, 2:8] * messages.signs
    has_time, temperature = not np.isnan(table[0, 0]), table[:, 8]
    return samples_in_si(
        options,
        gyro=values[:, :3],
        accel=values[:, 3:],
        time=_WEEK_S * (table[:, 0] - table[0, 0]) + table[:, 1] if has_time else None,
        stated=messages.stated,
        kind=messages.kind,
        temperature=None if np.isnan(temperature).any() else temperature,
        notes=notes,
    )


def _row(messages: _Messages, match: re.Match[str]) -> tuple[float, ...]:
    """Week, second, six readings and temperature, NaN where absent. Raises ValueError for a damaged message."""
    text, name, body, total = match.groups()
    if messages.checksum(text.encode("latin-1")) != total.lower():
        raise ValueError("checksum")
    fields = body.split(",")
    time, readings, temperature = messages.places(name)
    nothing = float("nan")
    week, second = (nothing, nothing) if time is None else (float(fields[time[0]]), float(fields[time[1]]))
    celsius = nothing if temperature is None else float(fields[temperature])
    return (week, second, *(float(fields[i]) for i in readings), celsius)


def _importer(name: str, messages: _Messages) -> Importer:
    return Importer(
        name,
        f"{messages.title} messages (text)",
        (),
        None,
        lambda path: messages.pattern.search(head(path).decode("latin-1")) is not None,
        lambda path, options: _read(messages, path, options),
    )


NOVATEL: Final = _importer("novatel", _NOVATEL)
VECTORNAV: Final = _importer("vectornav", _VECTORNAV)
