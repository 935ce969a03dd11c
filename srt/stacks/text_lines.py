"""Samples as lines of CSV or JSON: corrected values in place of the readings, everything else as it came.

A CSV stream may begin with names of columns and their units (:mod:`srt.recording.importers.channels`), and names may
come again; without names the columns are time, gyro x, y, z, accelerometer x, y, z and temperature, or the six readings
alone. A line of JSON is an object with "gyro" and "accel" as lists of three, or with "gyro_x" to "accel_z"; "time" in s
and "temperature" in °C are optional.

Each line has exactly one answer, so that a program that waits for it keeps step: a line without a sample has an empty
one.
"""

from __future__ import annotations

import json
import math
import re
from operator import mul, truediv
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import InputError, SrtError, clipped
from srt.model.table1 import AXES
from srt.recording.import_options import CHANNELS, SENSOR_UNITS, TRIADS, option
from srt.recording.imported_samples import StatedUnits
from srt.recording.importers.channels import assign, meaning_of
from srt.recording.schema import COUNTS, TIME_UNITS
from srt.recording.text_tables import is_number
from srt.stacks.stream_correction import CHANGED, CORRECTED, LOST, MALFORMED, MISTAKEN, NOT_ADVANCING, OVERRIDDEN

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import TextIO

    from srt.recording.importers.channels import ColumnAssignment
    from srt.stacks.stream_correction import Counts, StreamCorrector

_READINGS: Final = tuple(name for name in CHANNELS if name.startswith(("gyro", "accel")))
_NAMELESS: Final = ("time", *_READINGS, "temperature")
_SIGMAS: Final = tuple(f"{name}_sigma" for name in _READINGS)
_LONGEST: Final = 4096
"""Characters of a line; a sample has some hundreds."""
_OPTIONAL: Final = ("time", "temperature")
_NUMERIC: Final = "+-.0123456789 "
"""Characters with which a number may begin."""
_VALUES: Final = re.compile(r"'.*?'|\d+|^.*(?= was found)")
"""Parts of a reason that differ from line to line; the rest is the cause."""
_OTHER_MARKS: Final = re.compile(r"[;\t|]")
_FEWEST: Final = len(_READINGS) - 1
"""Marks between the columns of a line of readings."""
_AGREEING: Final = 3
"""Lines in succession without names whose number of columns is believed, against that of the lines before."""
_LATE: Final = 1.5
"""Steps of time, in those before, from which samples are lost."""


def bounded_lines(stream: TextIO) -> Iterator[str]:
    """Lines of a stream; of one that is too long for a sample, its beginning alone is kept."""
    while line := stream.readline(_LONGEST + 2):
        rest = line
        while len(rest) > _LONGEST and not rest.endswith("\n"):
            rest = stream.readline(_LONGEST + 2)
        yield line


class LineCorrector:
    """Correct lines of one stream.

    Parameters
    ----------
    units : mapping of "gyro" and "accel" to str
        Units of the lines, which override those of column names; without both, SI.
    covariance : bool
        True: six 1-sigma are appended to each line.
    counts : Counts, optional
        The lines hold counts, of this value in SI; the answers are in ``units``. None: they hold readings.

    Raises InputError: a unit that does not fit the kind of samples.
    """

    __slots__ = (
        "_columns", "_corrector", "_counts", "_covariance", "_guess", "_json_scale", "_last", "_line", "_named",
        "_order", "_other", "_others", "_refused", "_scale", "_second", "_step", "_unit", "_units", "_width",
    )  # fmt: skip

    def __init__(
        self,
        corrector: StreamCorrector,
        *,
        units: Mapping[str, str] | None = None,
        covariance: bool = False,
        counts: Counts | None = None,
    ) -> None:
        self._corrector = corrector
        self._units = units or {}
        self._counts = counts
        self._covariance = covariance
        self._columns: dict[str, int] | None = None
        self._width = 0
        self._guess: int | None = None  # line whose number of columns no other line has confirmed
        self._named = False
        self._other, self._others = 0, 0  # other number of columns, and lines in succession that have it
        self._order: tuple[str, ...] = ()  # of columns by names that were cut off
        self._refused = ""  # reason why lines without names are not read
        self._second = 1.0  # seconds per unit of time
        self._unit = self._units_of(StatedUnits())
        self._scale = self._json_scale = self._si_per(self._unit)
        self._last: float | None = None
        self._step: float | None = None
        self._line = 0

    def correct(self, line: str) -> str:
        """Answer one line.

        Returns
        -------
        str
            The line with corrected values, without its end; column names, with the units of the answers; comments as
            they are; empty for an empty line and for a malformed one, which is counted.
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
            reason = str(error) if isinstance(error, SrtError) else clipped(str(error), 160)
            sentence = f"line {self._line} is no sample ({reason.rstrip('.')})"
            self._corrector.event(MALFORMED, sentence, cause=_VALUES.sub("", reason))
            return ""

    def _csv(self, text: str) -> str:
        cells = text.split(",")
        columns = self._columns
        if columns is None or len(cells) != self._width or cells[columns["gyro_x"]][:1] not in _NUMERIC:
            columns = self._without_known_columns(cells)
            if columns is None:
                return ",".join([*self._answered(cells), *(_SIGMAS if self._covariance else ())])
        values = tuple(_of_cell(cells[columns[name]]) for name in _READINGS)
        time, temperature = (_of_cell(cells[columns[name]]) if name in columns else None for name in _OPTIONAL)
        corrected = self._corrected(values, temperature, self._scale)
        if columns is not self._columns:
            self._adopt(columns, len(cells))
        else:
            self._guess, self._others = None, 0
        if time is not None:
            self._count_lost(time * self._second)
        for name, value in zip(_READINGS, corrected, strict=False):
            cells[columns[name]] = repr(value)
        return ",".join([*cells, *map(repr, corrected[6:])])

    def _corrected(
        self, values: tuple[float, ...], temperature: float | None, scale: tuple[float, ...]
    ) -> tuple[float, ...]:
        """Corrected readings, and their sigmas where asked for, in the units of the lines."""
        readings = tuple(map(mul, values, scale)) if self._counts is None else self._counts.readings(values)
        corrected = self._corrector.correct(readings, temperature)
        return tuple(map(truediv, corrected, scale * 2))

    def _without_known_columns(self, cells: list[str]) -> dict[str, int] | None:
        """Columns of a line that does not fit those before; None for names of columns.

        Raises ValueError, or InputError for names that are not understood.
        """
        names, width = [cell.strip() for cell in cells], len(cells)
        named = not is_number(names[0]) and any(map(meaning_of, names))
        if named or (self._columns is None and width >= len(_READINGS) and not any(map(is_number, names))):
            self._read_names(names)
            return None
        text = ",".join(cells)
        if len(_OTHER_MARKS.findall(text)) >= _FEWEST or (width == 1 and len(text.split()) > _FEWEST):
            raise ValueError(
                "its columns are separated by other marks, but commas, and points in numbers, are expected"
            )
        if self._columns is not None:
            if width == self._width:
                return self._columns  # its cells are refused one by one
            self._others = self._others + 1 if width == self._other else 1
            self._other = width
            wider = self._guess is not None and width > self._width
            if self._named or not (wider or self._others >= _AGREEING):
                raise ValueError(f"it has {width} columns, and those before have {self._width}")
        if self._refused:
            raise ValueError(self._refused)
        order = self._order or (_READINGS if width == len(_READINGS) else _NAMELESS)
        if not order.index(_READINGS[-1]) < width <= len(order):
            raise ValueError(f"it has {width} columns, but 6, 7 or 8 are expected without names")
        return {name: i for i, name in enumerate(order[:width])}

    def _adopt(self, columns: dict[str, int], width: int) -> None:
        """Take the columns of a line without names for those that follow.

        One line alone may have been cut, as by the connection to a running logger: a wider one shows it. Otherwise
        three in succession are believed.
        """
        if self._columns is not None and self._guess is None:
            self._corrector.event(
                CHANGED, f"the lines have {width} columns from line {self._line} on, and had {self._width} before"
            )
        elif self._guess is not None:
            self._corrector.counts[CORRECTED] -= 1
            self._corrector.event(
                MISTAKEN,
                f"line {self._guess} has {self._width} columns, and line {self._line} {width}: line {self._guess} was "
                "damaged, and its answer is wrong",
            )
        self._columns, self._width, self._guess = columns, width, self._line

    def _read_names(self, names: list[str]) -> None:
        """Take names of columns, with their units. Raises InputError."""
        try:
            found = _assigned(names, increments=self._corrector.increments)
            self._refuse_unknown_units(names, found.columns)
            units = self._units_of(found.stated)
        except InputError:
            if self._columns is None:
                self._order = _cut_off(names)
                self._refused = (
                    "" if self._order else f"the names of the columns, line {self._line}, are not understood"
                )
            raise
        self._columns, self._width, self._guess, self._named = found.columns, len(names), None, True
        self._unit, self._scale = units, self._si_per(units)
        self._second = TIME_UNITS[found.stated.time or "s"]

    def _answered(self, names: list[str]) -> list[str]:
        """Names of columns of the answer: the readings have their own name and unit where the names state another."""
        result = list(names)
        for name, i in (self._columns or {}).items():
            meaning, unit = meaning_of(names[i]), self._unit.get(name.partition("_")[0])
            if unit and meaning is not None and (meaning.unit or meaning.remark or unit) != unit:
                result[i] = f"{name} [{unit}]"
        return result

    def _refuse_unknown_units(self, names: list[str], columns: Mapping[str, int]) -> None:
        """Raise InputError for names of readings with a unit that is not known, unless a unit is given."""
        for name in _READINGS:
            text, sensor = names[columns[name]], name.partition("_")[0]
            meaning = meaning_of(text)
            if meaning is not None and meaning.remark and sensor not in self._units:
                raise InputError(
                    f"the name {clipped(text)} states {clipped(meaning.remark)}, which is not one of the known units "
                    f"{', '.join(self._allowed(sensor))}: convert the readings, or give {option(f'{sensor}_unit')} if "
                    "theirs is one of these"
                )

    def _allowed(self, sensor: str) -> dict[str, float]:
        """SI units per unit, by the units of a sensor."""
        return SENSOR_UNITS[sensor]["increment" if self._corrector.increments else "rate"]

    def _si_per(self, units: Mapping[str, str]) -> tuple[float, ...]:
        """SI units per unit of the six readings."""
        return tuple(self._allowed(sensor)[unit] for sensor, unit in units.items() for _ in AXES)

    def _units_of(self, stated: StatedUnits) -> dict[str, str]:
        """Unit of each sensor, of its answers where the lines hold counts. Raises InputError."""
        units: dict[str, str] = {}
        for sensor in TRIADS:
            own, given, allowed = getattr(stated, sensor), self._units.get(sensor), self._allowed(sensor)
            if self._counts is not None and own not in (None, COUNTS):
                raise InputError(
                    f"the names of the columns state {own} for {sensor}, but {option(f'{sensor}_lsb')} is given: "
                    "leave it out"
                )
            if self._counts is None and own == COUNTS and given is None:
                raise InputError(
                    f"the names of the columns state counts for {sensor}: give {option('gyro_lsb')} and "
                    f"{option('accel_lsb')}"
                )
            own = None if own == COUNTS else own
            unit = given or own or next(iter(allowed))
            if unit not in allowed:
                kind = "increment" if self._corrector.increments else "rate"
                raise InputError(
                    f"The unit {unit} of {sensor} does not fit samples of kind {kind}: use one of {', '.join(allowed)}."
                )
            if own is not None and unit != own:
                self._corrector.event(OVERRIDDEN, f"the names state {own} for {sensor}; read as {unit}, as given")
            units[sensor] = unit
        return units

    def _json(self, text: str) -> str:
        document = _object(text)
        arrays = "gyro" in document or "accel" in document
        expected = tuple(TRIADS) if arrays else _READINGS
        if not document.keys() >= set(expected):
            keys = ", ".join(map(json.dumps, document)) or "none"
            raise ValueError(f"its keys are {clipped(keys)}, but gyro and accel, or gyro_x to accel_z, are expected")
        found = [document[name] for name in expected]
        if arrays:
            if not all(isinstance(triad, list) and len(triad) == 3 for triad in found):
                raise ValueError("gyro and accel are not lists of three numbers")
            found = [value for triad in found for value in triad]
        values = tuple(map(_of_json, found))
        time, temperature = (None if document.get(name) is None else _of_json(document[name]) for name in _OPTIONAL)
        corrected = self._corrected(values, temperature, self._json_scale)
        if time is not None:
            self._count_lost(time)
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


def _assigned(names: list[str], *, increments: bool) -> ColumnAssignment:
    """Columns by their names. Raises InputError."""
    try:
        found = assign(Path("the stream"), names, len(names), {}, kind="increment" if increments else None)
    except InputError as error:
        text = str(error).removeprefix("the stream: ")
        reason, _, advice = text.rpartition(": ")
        if "--" not in advice:
            raise error.reworded(text) from None
        # Advice of the importers names options that a stream does not have.
        raise InputError(
            f"{reason}: name the columns {', '.join(_NAMELESS[:-1])}, or send lines without names in this order"
        ) from None
    if found.kind == "increment" and not increments:
        raise InputError(f"the names of the columns state increments: give {option('increments_s')} SECONDS")
    return found


def _cut_off(names: list[str]) -> tuple[str, ...]:
    """Order of columns whose names were cut off, if those left are the first of a usual order, without units."""
    *meanings, last = map(meaning_of, names)  # the last name may be cut, too
    bare = [each for each in meanings if each is not None and each.unit is each.kind is each.remark is None]
    channels = tuple(each.channel for each in bare)
    if last is not None and (last.unit or last.remark):
        return ()
    for order in (_NAMELESS, _NAMELESS[1:]):
        if channels and len(channels) == len(meanings) and channels == order[: len(channels)]:
            return order
    return ()


def _of_cell(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise ValueError(f"{text.strip()!r} was found, but a finite number is expected")
    return value


def _object(text: str) -> dict[str, Any]:
    """Object of a line of JSON. Raises ValueError."""
    try:
        document: dict[str, Any] = _JSON.decode(text)
    except (json.JSONDecodeError, RecursionError):
        raise ValueError("it begins as an object of JSON, and is none: it was cut off or damaged") from None
    return document


def _of_json(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{json.dumps(value)} was found, but a number is expected")  # noqa: TRY004 - not our mistake
    return _finite(value)


def _finite(text: str | float) -> float:
    try:
        value = float(text)
    except OverflowError:  # a whole number
        value = math.inf
    if not math.isfinite(value):
        raise ValueError(f"{text} was found, but a finite number is expected")
    return value


_JSON: Final = json.JSONDecoder(parse_float=_finite, parse_constant=_finite)
