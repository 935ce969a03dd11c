"""Samples as lines of CSV or JSON: corrected values in place of the readings, everything else as it came.

A CSV stream may begin with names of columns (:mod:`srt.recording.importers.channels`); without names the columns are
time, gyro x, y, z, accelerometer x, y, z and temperature, or the six readings alone. A line of JSON is an object with
"gyro" and "accel" as lists of three, or with "gyro_x" to "accel_z"; "time" in s and "temperature" in °C are optional.

Each line has exactly one answer, so that a program that waits for it keeps step: a line without a sample has an empty
one.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import InputError
from srt.recording.import_options import CHANNELS
from srt.recording.importers.channels import assign
from srt.recording.text_tables import is_number
from srt.stacks.stream_correction import LOST, MALFORMED, NOT_ADVANCING

if TYPE_CHECKING:
    from srt.stacks.stream_correction import Counts, StreamCorrector

_READINGS: Final = tuple(name for name in CHANNELS if name.startswith(("gyro", "accel")))
_NAMELESS: Final = ("time", *_READINGS, "temperature")
_SIGMAS: Final = tuple(f"{name}_sigma" for name in _READINGS)
_LONGEST: Final = 4096
"""Characters of a line; a sample has some hundreds."""
_LATE: Final = 1.5
"""Steps of time, in those before, from which samples are lost."""


class LineCorrector:
    """Correct lines of one stream.

    Parameters
    ----------
    covariance : bool
        True: six 1-sigma are appended to each line.
    counts : Counts, optional
        The lines hold counts, of this value in the units of the corrector; None: they are in these units.
    """

    __slots__ = ("_columns", "_corrector", "_counts", "_covariance", "_first", "_last", "_line", "_step", "_width")

    def __init__(self, corrector: StreamCorrector, *, covariance: bool = False, counts: Counts | None = None) -> None:
        self._corrector = corrector
        self._counts = counts
        self._covariance = covariance
        self._columns: dict[str, int] | None = None
        self._first = True
        self._last: float | None = None
        self._step: float | None = None
        self._line = 0
        self._width = 0

    def correct(self, line: str) -> str:
        """Answer one line.

        Returns
        -------
        str
            The line with corrected values, without its end; column names and comments as they are; empty for an empty
            line and for a malformed one, which is counted.
        """
        self._line += 1
        text = line.strip()
        if not text or text.startswith("#"):
            return text
        try:
            if len(text) > _LONGEST:
                raise ValueError("it is too long")  # noqa: TRY301
            return self._json(text) if text[0] == "{" else self._csv(text)
        except (ValueError, LookupError, TypeError, ArithmeticError, RecursionError, InputError) as error:
            self._corrector.event(MALFORMED, f"line {self._line} is no sample ({str(error)[:120].rstrip('.')})")
            return ""

    def _csv(self, text: str) -> str:
        cells = text.split(",")
        if self._first:
            self._first = False
            if not is_number(cells[0]):
                return self._header(cells)
        columns = self._columns or self._nameless(len(cells))
        if len(cells) != self._width:
            raise ValueError(f"it has {len(cells)} columns, and those before have {self._width}")
        values = tuple(float(cells[columns[name]]) for name in _READINGS)
        time, temperature = columns.get("time"), columns.get("temperature")
        stamp = None if time is None else _finite(float(cells[time]))
        corrected = self._corrected(values, None if temperature is None else float(cells[temperature]))
        if stamp is not None:
            self._count_lost(stamp)
        for name, value in zip(_READINGS, corrected, strict=False):
            cells[columns[name]] = repr(value)
        return ",".join([*cells, *map(repr, corrected[6:])])

    def _corrected(self, values: tuple[float, ...], temperature: float | None) -> tuple[float, ...]:
        readings = values if self._counts is None else self._counts.readings(values)
        return self._corrector.correct(readings, temperature)

    def _header(self, cells: list[str]) -> str:
        try:
            self._columns = assign(Path("the stream"), [cell.strip() for cell in cells], len(cells), {}).columns
        except InputError:
            self._first = True
            raise
        self._width = len(cells)
        return ",".join([*cells, *(_SIGMAS if self._covariance else ())])

    def _nameless(self, width: int) -> dict[str, int]:
        if width not in (6, 7, 8):
            raise ValueError(f"it has {width} columns, but 6, 7 or 8 are expected without names")
        names = _READINGS if width == len(_READINGS) else _NAMELESS[:width]
        self._columns, self._width = {name: i for i, name in enumerate(names)}, width
        return self._columns

    def _json(self, text: str) -> str:
        document: dict[str, Any] = json.loads(text)
        arrays = "gyro" in document
        if arrays:
            gyro, accel = (tuple(map(float, document[sensor])) for sensor in ("gyro", "accel"))
            if (len(gyro), len(accel)) != (3, 3):
                raise ValueError("gyro and accel are not three numbers each")
            values = gyro + accel
        else:
            values = tuple(float(document[name]) for name in _READINGS)
        stamp = _finite(float(document["time"])) if "time" in document else None
        temperature = document.get("temperature")
        corrected = self._corrected(values, None if temperature is None else float(temperature))
        if stamp is not None:
            self._count_lost(stamp)
        if arrays:
            document["gyro"], document["accel"] = corrected[:3], corrected[3:6]
        else:
            document.update(zip(_READINGS, corrected, strict=False))
        if self._covariance:
            document["sigma"] = corrected[6:]
        return json.dumps(document)

    def _count_lost(self, time: float) -> None:
        """Count samples that a step of time leaves out, and steps back; the step before is the usual one."""
        last, self._last = self._last, time
        if last is None:
            return
        step = time - last
        if step <= 0.0:
            self._corrector.event(NOT_ADVANCING, f"line {self._line}: the time goes from {last:.9g} to {time:.9g} s")
            return
        if self._step is not None and step > _LATE * self._step:
            count = round(step / self._step) - 1
            self._corrector.event(LOST, f"line {self._line}: {count} samples are missing before {time:.9g}", count)
            return
        self._step = self._corrector.interval_s = step


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("its time is not a finite number")
    return value
