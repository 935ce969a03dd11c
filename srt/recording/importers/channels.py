"""Channels of the columns of a foreign table, by their names, with the units that the names state."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError, clipped, did_you_mean
from srt.model.table1 import AXES
from srt.recording.import_options import CHANNELS, TRIADS, normal_unit, option
from srt.recording.imported_samples import StatedUnits
from srt.recording.samples import TEMPERATURE, TIME
from srt.recording.schema import COUNTS, UNITS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from srt.recording.recording import Kind

COLUMN_NAMES: Final[dict[tuple[str, Kind | None], tuple[str, ...]]] = {
    (TIME, None): (
        "time", "timestamp", "timestamps", "t", "stamp", "headerstamp", "secondselapsed", "sampletime",
        "sampletimefine",
    ),
    (TEMPERATURE, None): ("temperature", "temp", "imutemperature", "imutemp"),
    ("gyro", None): (
        "gyro", "gyr", "gyroscope", "g", "w", "omega", "angularvelocity", "angularrate", "angvel", "rotationrate",
        "wrss", "scaledgyro", "uncompgyro", "gyroout",
    ),
    ("accel", None): (
        "accel", "acc", "accl", "accelerometer", "acceleration", "a", "alpha", "linearacceleration", "linacc",
        "specificforce", "f", "arss", "scaledaccel", "uncompaccel", "uncompacc", "acclout", "accelout",
    ),
    ("gyro", "increment"): ("dtheta", "deltatheta", "deltaangle", "dangle", "wm"),
    ("accel", "increment"): ("dv", "dvel", "deltav", "deltavel", "deltavelocity", "velinc", "vm"),
}  # fmt: skip
"""Names of columns by channel and kind, in lower case without marks; kind None: the name does not state it.

The name of a sensor alone means an array of three columns; followed by an axis, as in "gyrox", one column. A name of
three letters or more may also follow the axis, as in "xgyro".
"""

_SHORTEST_WITH_AXIS_IN_FRONT = 3
"""Fewest letters of a name that may follow the axis: shorter ones, as "xg" and "ta", are ambiguous."""

_SUFFIX_UNITS: Final = {
    "rad_s": "rad/s", "rads": "rad/s", "radps": "rad/s", "deg_s": "deg/s", "degs": "deg/s", "dps": "deg/s",
    "deg_h": "deg/h", "m_s2": "m/s^2", "m_s_2": "m/s^2", "mps2": "m/s^2", "ms2": "m/s^2", "mg": "mg", "g": "g",
    "rad": "rad", "deg": "deg", "m_s": "m/s", "mps": "m/s",
    "s": "s", "sec": "s", "ms": "ms", "us": "us", "ns": "ns", "raw": COUNTS, "counts": COUNTS, "lsb": COUNTS,
}  # fmt: skip
_PREFIXES: Final = ("field", "imu")
"""First words of names that carry no meaning: "field.angular_velocity.x" of rostopic."""

_LONGEST_LIST = 800  # characters of the list of all columns, where some have to be chosen: names of some forty

_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")


def register_column_names(channel: str, *names: str, kind: Kind | None = None) -> None:
    """Add names of columns to :data:`COLUMN_NAMES`, without axis and unit; case and marks do not count.

    ``channel`` is "time", "temperature", "gyro" or "accel"; ``kind`` is that of the samples, if the names state it.
    Raises InputError for an unknown channel, or a name of another one.
    """
    if (channel, None) not in COLUMN_NAMES:
        known = [each for each, _ in COLUMN_NAMES]
        raise InputError(
            f"{channel!r} is no channel{did_you_mean(channel, known)}: use time, temperature, gyro or accel."
        )
    bare = tuple("".join(_words(name)) for name in names)
    for name, given in zip(bare, names, strict=True):
        if not name or _meanings().get(name, (channel, kind)) != (channel, kind):
            raise InputError(f"The column name {given!r} is empty, or stands for another channel: choose another.")
    COLUMN_NAMES[channel, kind] = (*COLUMN_NAMES.get((channel, kind), ()), *bare)
    _meanings.cache_clear()


@cache
def _meanings() -> dict[str, tuple[str, Kind | None]]:
    """Channel, and kind where the name states it, by the name of a column without its unit."""
    table: dict[str, tuple[str, Kind | None]] = {}
    for (channel, kind), names in COLUMN_NAMES.items():
        for name in names:
            table[name] = (channel, kind)
            if channel not in TRIADS:
                continue
            table.update({f"{name}{axis}": (f"{channel}_{axis}", kind) for axis in AXES})
            if len(name) >= _SHORTEST_WITH_AXIS_IN_FRONT:
                table.update({f"{axis}{name}": (f"{channel}_{axis}", kind) for axis in AXES})
    return table


def _words(text: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", text.lower()) if word]


def listed(names: Sequence[str], none: str = "none") -> str:
    """The first twelve names of a file, for a message."""
    return ", ".join(map(clipped, names[:12])) + (" ..." if len(names) > 12 else "") if names else none


def _all_listed(names: Sequence[str]) -> str:
    """All names of a file, as far as a message may hold them."""
    return clipped(", ".join(map(clipped, names)), _LONGEST_LIST) if names else "none has a name"


@dataclass(frozen=True, slots=True)
class ColumnMeaning:
    """Meaning of a column's name."""

    channel: str  # of CHANNELS, or "gyro" or "accel" for an array of three columns
    unit: str | None = None  # None: the name states none
    kind: Kind | None = None  # "increment"; None: the name does not state it
    remark: str | None = None  # text in the place of a unit that is none of the channel's, as "rpm" or "top"


@dataclass(frozen=True, slots=True)
class ColumnAssignment:
    """Columns of a table by channel; with arrays, "gyro" and "accel" may stand for three channels."""

    columns: dict[str, int]  # position, from 0
    stated: StatedUnits  # by the names of the columns
    kind: Kind | None  # "increment", if all names say so
    notes: tuple[str, ...]


def meaning_of(name: str) -> ColumnMeaning | None:
    """Find the meaning of a name as "gyr_x", "w_RS_S_x [rad s^-1]", "Acc X (g)" or "gyro_x_deg_s"; None if unknown."""
    # "inertial:6254.12345:scaledAccelX": MicroStrain names the unit before the column.
    name = name.rpartition(":")[2] if ":" in name.partition("[")[0].partition("(")[0] else name
    brackets = _BRACKETS.search(name)
    unit = normal_unit(brackets.group(1)) if brackets else None
    parts = _words(_BRACKETS.sub("", name))
    if len(parts) > 1 and parts[0] in _PREFIXES:
        parts = parts[1:]
    # "gyro_x_deg_s": the longest unit at the end that leaves a known name.
    for count in (0, 3, 2, 1):
        ending = "_".join(parts[len(parts) - count :]) if count else ""
        if count and (count >= len(parts) or ending not in _SUFFIX_UNITS):
            continue
        found = _meanings().get("".join(parts[: len(parts) - count]))
        if found is not None:
            stated = unit or (_SUFFIX_UNITS[ending] if count else None)
            if stated and not _fits(found[0], stated):
                return ColumnMeaning(found[0], None, found[1], stated)
            return ColumnMeaning(found[0], stated, found[1])
    return None


def assign(
    path: Path,
    names: Sequence[str],
    width: int,
    wanted: Mapping[str, str | int],
    *,
    arrays: bool = False,
    kind: Kind | None = None,
    units: Sequence[str | None] = (),
) -> ColumnAssignment:
    """Find the columns of all channels.

    ``names`` are those of all ``width`` columns, empty where the table has none; channels in ``wanted``, as the user
    gives them, override the names. With ``arrays``, a column may be an array of three columns, "gyro" or "accel". Of
    rates and increments, those of ``kind`` are read; rates if left out. ``units`` are those that the file states for
    each column beside its name; an unknown one is kept, for an error or a note.

    Raises InputError: columns that are absent, not recognised, or ambiguous, or whose units contradict each other.
    """
    columns = _all_given(path, names, width, wanted, arrays=arrays)
    notes: list[str] = []
    both = False
    meanings = [meaning_of(name) for name in names]
    for channel in (*CHANNELS, *(TRIADS if arrays else ())):
        if channel in columns or channel.partition("_")[0] in columns:
            continue
        candidates = [i for i, meaning in enumerate(meanings) if meaning is not None and meaning.channel == channel]
        exact = [i for i in candidates if names[i].strip() == channel]
        found = exact or candidates
        if len(found) > 1 and channel == TIME:
            others = listed([names[i] for i in found[1:]])
            notes.append(f"Time is the column {clipped(names[found[0]])}; {others} not used.")
            found = found[:1]
        kinds = [meaning.kind for meaning in (meanings[i] for i in found) if meaning is not None]
        if len(set(kinds)) > 1:
            found = [i for i, own in zip(found, kinds, strict=True) if (own == "increment") == (kind == "increment")]
            both = True
        if len(found) > 1:
            raise InputError(
                f"{path}: several columns may be {channel} ({listed([names[i] for i in found])}): name one with "
                f"{option('columns')} {channel}=NAME."
            )
        if found:
            columns[channel] = found[0]
    _require_once(path, columns)
    _require_all(path, names, width, columns, arrays=arrays)
    if both:
        read, other = ("increments", "rates") if kind == "increment" else ("rates", "increments")
        notes.append(
            f"The file holds rates and increments; {read} were read, {other} with {option('kind')} {other[:-1]}."
        )
    renamed = [
        f"{channel} from {clipped(names[i])}" for channel, i in columns.items() if names and names[i].strip() != channel
    ]
    if renamed:
        notes.append(f"Columns: {', '.join(renamed)}.")
    used = {channel: meanings[i] for channel, i in columns.items() if names}
    for channel, i in columns.items() if units else ():
        used[channel] = _with_unit(path, channel, names[i], used[channel], units[i])
    stated = StatedUnits(*(_common_unit(path, sensor, used) for sensor in ("gyro", "accel", TIME)))
    of_sensors = {meaning.kind for channel, meaning in used.items() if meaning and channel not in NO_SENSOR}
    return ColumnAssignment(columns, stated, "increment" if of_sensors == {"increment"} else None, tuple(notes))


NO_SENSOR: Final = (TIME, TEMPERATURE)
"""Channels that belong to no sensor."""


def with_temperature(
    notes: tuple[str, ...], columns: Mapping[str, object], stated: str | None = None
) -> tuple[str, ...]:
    """Add a note on the unit of the temperature, if a column has the temperature; the file may state a unit."""
    text = f"read in °C; the file states {clipped(stated)}" if stated else "assumed to be in °C"
    return (*notes, f"Temperature is {text}.") if TEMPERATURE in columns else notes


def _all_given(
    path: Path, names: Sequence[str], width: int, wanted: Mapping[str, str | int], *, arrays: bool
) -> dict[str, int]:
    """Positions of the channels given by the user. Raises InputError on columns that are absent."""
    given: dict[str, str | int] = {}
    for channel, column in wanted.items():
        given.update(_given(names, channel, column, arrays=arrays))
    columns: dict[str, int] = {}
    absent = []
    for channel, column in given.items():
        place = _position(names, column)
        if place is None:
            absent.append(f"{column}{did_you_mean(str(column), [clipped(name) for name in names])}")
        elif not 0 <= place < width:
            raise InputError(f"{path} has {width} columns, but column {column} was asked for: columns count from 1.")
        else:
            columns[channel] = place
    if absent:
        raise InputError(f"{path} has no column {', '.join(absent)} (found: {_all_listed(names)}): name one of those.")
    return columns


def _require_once(path: Path, columns: Mapping[str, int]) -> None:
    owner: dict[int, str] = {}
    for channel, place in columns.items():
        if owner.setdefault(place, channel) != channel:
            raise InputError(
                f"{path}: column {place + 1} would be read as {owner[place]} and as {channel}: give each channel a "
                f"column of its own with {option('columns')} (channels without one count from column 1)."
            )


def _given(names: Sequence[str], channel: str, column: str | int, *, arrays: bool) -> dict[str, str | int]:
    """Columns of a channel given by the user; for a sensor, three adjacent or named alike but for the axis."""
    triad = TRIADS.get(channel)
    if triad is None or (arrays and (isinstance(column, int) or column in names)):
        return {channel: column}
    if isinstance(column, int):
        return {each: column + i for i, each in enumerate(triad)}
    result: dict[str, str | int] = {}
    for each, axis in zip(triad, AXES, strict=True):
        spelled = [f"{column}{mark}{axis}" for mark in ("_", "", ".", " ", "-")]
        result[each] = next((s for s in spelled if s in names), spelled[0])
    return result


def _position(names: Sequence[str], column: str | int) -> int | None:
    """Position of a column, from 0; None if no column has this name."""
    if isinstance(column, int):
        return column - 1
    for spelling in (str, lambda name: _BRACKETS.sub("", name).strip().lower()):
        hits = [i for i, name in enumerate(names) if spelling(name) == spelling(column)]
        if hits:
            return hits[0]
    return None


def _require_all(path: Path, names: Sequence[str], width: int, columns: Mapping[str, int], *, arrays: bool) -> None:
    missing: list[str] = []
    for sensor, triad in TRIADS.items():
        if arrays and sensor in columns:
            continue
        absent = [channel for channel in triad if channel not in columns]
        # An array of three columns is one name.
        missing += [sensor] if arrays and len(absent) == len(triad) else absent
    if not missing:
        return
    if not names:
        raise InputError(
            f"{path} has no column names: list its {width} columns in their order, such as "
            f"{option('columns')} time,gyro,accel (- for a column that is not read); or give {option('format')} "
            "psins or kf-gins for a file of those."
        )
    channels = [*([] if TIME in columns else [TIME]), *missing]
    line = ",".join(f"{channel}=NAME" for channel in channels)
    start = f"{path}: no column was recognised as {', '.join(channels)}"
    if width and not unread(names, columns):
        raise InputError(
            f"{start}, and the file lacks it: all columns are read as others ({_all_listed(names)}); log it, or "
            f"correct a wrong column with {option('columns')}."
        )
    raise InputError(
        f"{start} (columns found: {_all_listed(names)}): give "
        f"{option('columns')} '{line}' with a name found, or its number from 1, for each NAME"
        f"{f' (leave {TIME} out if there are no stamps)' if TIME in channels else ''}."
    )


def unread(names: Sequence[str], columns: Mapping[str, int]) -> tuple[str, ...]:
    """Names of the columns that are not read."""
    return tuple(name for i, name in enumerate(names) if i not in columns.values())


def _fits(channel: str, unit: str) -> bool:
    """True for a unit that fits a channel: "Acc X (top)" states none."""
    return unit in UNITS.get(channel.partition("_")[0], ())


def _with_unit(
    path: Path, channel: str, name: str, meaning: ColumnMeaning | None, text: str | None
) -> ColumnMeaning | None:
    """Meaning of a column with the unit that the file states beside its name."""
    if not text:
        return meaning
    # "seconds since 1970-01-01", by the CF conventions
    unit = normal_unit(text.partition(" since ")[0] if channel == TIME else text)
    if meaning is None:
        return ColumnMeaning(channel, unit)
    if meaning.unit not in (None, unit):
        raise InputError(
            f"{path}: the name of {clipped(name)} states {meaning.unit}, but its attribute states {clipped(unit)}: "
            "correct one of them."
        )
    return replace(meaning, unit=unit)


def _common_unit(path: Path, sensor: str, used: Mapping[str, ColumnMeaning | None]) -> str | None:
    units = {m.unit if m is not None else None for name, m in used.items() if name.partition("_")[0] == sensor}
    if len(units) > 1:
        shown = ", ".join(sorted(str(unit or "none") for unit in units))
        raise InputError(f"{path}: the {sensor} columns state different units ({shown}): state one unit for all three.")
    return next(iter(units), None)
