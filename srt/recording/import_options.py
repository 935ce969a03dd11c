"""Options for reading a foreign file: columns, units, axes, and the choice among several IMUs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np

from srt.arguments import real_array, require_type
from srt.constants import ARCSEC, DEG, MICRO_G
from srt.exceptions import InputError, did_you_mean
from srt.model.table1 import AXES
from srt.recording.recording import Kind
from srt.recording.samples import ACCEL_COLUMNS, GYRO_COLUMNS, TEMPERATURE, TIME
from srt.recording.schema import ACCEL_UNITS, COUNTS, FASTEST_HZ, GYRO_UNITS, UNITS, shown

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.types import Array

TRIADS: Final = {"gyro": GYRO_COLUMNS, "accel": ACCEL_COLUMNS}
"""Channels of each sensor; the name of a sensor stands for its three channels."""

CHANNELS: Final = (TIME, *GYRO_COLUMNS, *ACCEL_COLUMNS, TEMPERATURE)

SENSOR_UNITS: Final = {"gyro": GYRO_UNITS, "accel": ACCEL_UNITS}

Triple = tuple[float, float, float]

_WORDS = {
    "radian": "rad", "radians": "rad", "°": "deg", "degree": "deg", "degrees": "deg", "g0": "g", "milli-g": "mg",
    "µg": "ug", "μg": "ug", "micro-g": "ug", "arcsecond": "arcsec", "arcseconds": "arcsec", "arc-sec": "arcsec",
    "sec": "s", "second": "s", "seconds": "s", "hr": "h", "hour": "h", "s2": "s^2", "sec^2": "s^2",
    "msec": "ms", "milliseconds": "ms", "µs": "us", "μs": "us", "usec": "us", "microseconds": "us",
    "nsec": "ns", "nanoseconds": "ns", "lsb": COUNTS, "count": COUNTS, "digit": COUNTS, "raw": COUNTS,
}  # fmt: skip
"""Spellings of the parts of a unit."""

_WHOLE = {"rps": "rad/s", "dps": "deg/s", "m/s/s": "m/s^2"}

_RAISED = str.maketrans({"²": "^2", "⁻": "-", "¹": "1"})

_NEGATIVE_POWER = re.compile(r"[\s*·.]*s(?:\^?-|-\^)([12])(?=$|/)")
"""Seconds in the denominator, as in "rad s^-1" and "m s-2"."""

_LSB_UNITS: Final = {"gyro": {"arcsec": ARCSEC}, "accel": {"ug": MICRO_G}}
"""Units of the value of a count in data sheets, beside those of files."""

_LSB = re.compile(r"([\d.,/eE+\- ]*[\d.])\s*(.*)")  # numbers of the value of a count, and its unit


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Properties of a file that it does not state, or states wrongly; None: as the format defines.

    Attributes
    ----------
    columns : mapping of channel to column
        Channels are those of a table of samples, or "gyro" and "accel" for an array of three columns; a column is a
        name, or a number counted from 1. Empty: columns are recognised by their names. Or the text of ``--columns``.
    kind : "rate" or "increment"
    time_unit, gyro_unit, accel_unit : str
        As in ``recording.toml``.
    gyro_lsb, accel_lsb : (float, float, float)
        SI units per count, for the unit "counts". One number, or the text of ``--gyro-lsb``, will do.
    gyro_offset, accel_offset : (float, float, float)
        Counts at zero input. One number, or the text of ``--gyro-offset``, will do.
    sample_rate_hz : float
        Rate of the samples; it overrides time stamps.
    topic : str
        Topic of a bag or of a log.
    instance : int
        Instance of a topic in a log, counted from 0.
    delimiter : str
        Separator of a text table.
    decimal_comma : bool
        True: a text table writes 1,5 for 1.5.
    skip : int
        Lines at the top of a text table that are not read.
    variable : str
        Array, struct or group of a MATLAB, HDF5 or NPZ file that holds the samples.
    map_gyro, map_accel : str
        IMU axes by those of the file, such as "x,-y,z" or "y,x,-z".
    second : Path
        File of the gyros, where each sensor has its own.

    Raises
    ------
    InputError
        A value that is not allowed.
    """

    columns: Mapping[str, str | int] = field(default_factory=dict)
    kind: Kind | None = None
    time_unit: str | None = None
    gyro_unit: str | None = None
    accel_unit: str | None = None
    gyro_lsb: Triple | None = None
    accel_lsb: Triple | None = None
    gyro_offset: Triple | None = None
    accel_offset: Triple | None = None
    sample_rate_hz: float | None = None
    topic: str | None = None
    instance: int | None = None
    delimiter: str | None = None
    decimal_comma: bool = False
    skip: int = 0
    variable: str | None = None
    map_gyro: str | None = None
    map_accel: str | None = None
    second: Path | None = None

    def __post_init__(self) -> None:
        if self.kind is not None and self.kind not in get_args(Kind):
            raise InputError(f"{option('kind')} is {self.kind!r}, but rate or increment is expected.")
        for quantity, allowed in UNITS.items():
            self._set_unit(f"{quantity}_unit", allowed)
        for sensor in SENSOR_UNITS:
            parse_axis_map(getattr(self, f"map_{sensor}"), f"map_{sensor}")
            counts = getattr(self, f"{sensor}_unit") in (None, COUNTS)
            for name, parse in ((f"{sensor}_lsb", parse_lsb), (f"{sensor}_offset", parse_offset)):
                value = getattr(self, name)
                if value is not None and not counts:
                    raise InputError(
                        f"{option(name)} is given, but {option(f'{sensor}_unit')} is "
                        f"{getattr(self, f'{sensor}_unit')}: leave it out, or state the unit counts."
                    )
                if value is not None:
                    object.__setattr__(
                        self, name, parse(value, sensor) if isinstance(value, str) else _of_numbers(name, value)
                    )
        rate = 1.0 if self.sample_rate_hz is None else self.sample_rate_hz
        require_type(option("sample_rate_hz"), "a number in Hz", rate, Real)
        if not 0.0 < rate <= FASTEST_HZ:
            raise InputError(
                f"{option('sample_rate_hz')} is {shown(rate)}, but a positive number of at most {FASTEST_HZ:g} in Hz "
                "is expected."
            )
        if self.skip < 0:
            raise InputError(f"{option('skip')} is {self.skip}, but a number of lines is expected.")
        if isinstance(self.columns, str):
            object.__setattr__(self, "columns", parse_columns(self.columns))
        require_type(option("columns"), "a text, or a mapping of channels to columns", self.columns, Mapping)
        for channel in self.columns:
            if channel not in CHANNELS and channel not in TRIADS:
                raise InputError(
                    f"{option('columns')}: {channel!r} is no channel{did_you_mean(channel, CHANNELS)}: "
                    f"use {', '.join((*TRIADS, *CHANNELS))}."
                )

        if self.second is not None:
            object.__setattr__(self, "second", Path(self.second))

    def _set_unit(self, name: str, allowed: tuple[str, ...]) -> None:
        given = getattr(self, name)
        if given is None:
            return
        unit = normal_unit(given)
        if unit not in allowed:
            raise InputError(
                f"{option(name)} is {given!r}{did_you_mean(given, allowed)}, "
                f"but one of {', '.join(allowed)} is expected."
            )
        object.__setattr__(self, name, unit)

    @property
    def given(self) -> frozenset[str]:
        """Names of the fields that are not at their defaults."""
        return frozenset(item.name for item in fields(self) if getattr(self, item.name) != getattr(_DEFAULT, item.name))


def option(name: str) -> str:
    """Option of the command line for a field of :class:`ImportOptions`, as messages name it."""
    return "--" + name.replace("_", "-")


def normal_unit(text: str) -> str:
    """Unit as ``recording.toml`` spells it; an unknown one is returned unchanged.

    The text is such as "dps", "rad s^-1", "degrees per second" or "m/s²".
    """
    folded = " ".join(text.lower().replace("**", "^").replace(" per ", "/").translate(_RAISED).split())
    folded = _NEGATIVE_POWER.sub(lambda power: "/s" if power[1] == "1" else "/s^2", folded)
    unit = "/".join(_WORDS.get(word.strip(), word.strip()) for word in folded.split("/"))
    return _WHOLE.get(unit, unit)


def parse_columns(text: str) -> dict[str, str | int]:
    """Read a column map, as :attr:`ImportOptions.columns`, from one line of text.

    The text has channels in the order of the columns ("time,gyro,accel", with "-" for a column that is not read), or
    channels with their columns ("gyro_x=wx,gyro_y=wy", "gyro_x=4"), or both. Raises InputError for a channel that is
    unknown or named twice.
    """
    result: dict[str, str | int] = {}
    position = 1
    for item in (part.strip() for part in text.split(",")):
        channel, equals, column = (part.strip() for part in item.partition("="))
        if equals:
            named: list[tuple[str, str | int]] = [(channel, int(column) if column.isdecimal() else column)]
        elif item in ("-", "_", ""):
            position += 1
            continue
        else:
            # The name of a sensor stands for three adjacent columns.
            named = [(name, position + i) for i, name in enumerate(TRIADS.get(channel, (channel,)))]
            position += len(named)
        for name, where in named:
            if name in result:
                raise InputError(f"{option('columns')}: the channel {name} is named twice: name it once.")
            if where == "":
                raise InputError(f"{option('columns')}: {name}= lacks its column: give a name, or a number from 1.")
            result[name] = where
    return result


def parse_axis_map(text: str | None, name: str = "map_gyro") -> Array | None:
    """Read an axis map such as "x,-y,z": the axes of the file that become x, y and z of the IMU, with their signs.

    Returns the signed permutation P, shape (3, 3), with IMU = P @ file; None for None. Raises InputError for a text
    that is not the three axes, each once; it names the option ``name``.
    """
    if text is None:
        return None
    signs = (("", 1.0), ("+", 1.0), ("-", -1.0))
    rows = {
        f"{mark}{axis}": sign * row + 0.0 for axis, row in zip(AXES, np.eye(3), strict=True) for mark, sign in signs
    }
    parts = [part.strip().lower() for part in text.split(",")]
    if sorted(part.lstrip("+-") for part in parts) != list(AXES) or not rows.keys() >= set(parts):
        raise InputError(
            f"{option(name)} is {text!r}, but three axes, each once, are expected, such as x,-y,z or y,x,-z."
        )
    return np.array([rows[part] for part in parts])


def parse_lsb(text: str, sensor: str) -> Triple:
    """Read the scale factor of counts, SI units per count.

    The text has one number or three, each also as 1/N, and a unit: "1/131 deg/s", "1/415,1/413,1/415 m/s^2", "0.061
    mg/LSB". The units are those of ``gyro_unit`` and ``accel_unit``, arcsec and ug; the default is SI. Raises
    InputError.
    """
    name = f"{sensor}_lsb"
    split = _LSB.fullmatch(text.strip())
    numbers, unit_text = split.groups() if split else (text.strip(), "")
    factors = {unit: factor for units in SENSOR_UNITS[sensor].values() for unit, factor in units.items()}
    factors |= _LSB_UNITS[sensor]
    unit = normal_unit(unit_text).removesuffix(f"/{COUNTS}")
    if unit and unit not in factors:
        raise InputError(f"{option(name)}: the unit {unit_text!r} is not one of {', '.join(factors)}.")
    factor = factors[unit] if unit else 1.0
    values = [value * factor for value in _triple(numbers, name, _fraction)]
    if not all(values):
        raise InputError(
            f"{option(name)} is {text!r}, but 0 was found: give the value of one count, a number other than 0."
        )
    return values[0], values[1], values[2]


def parse_offset(text: str, sensor: str) -> Triple:
    """Read the counts at zero input: one number, or three separated by commas. Raises InputError."""
    return _triple(text, f"{sensor}_offset", float)


def counts_text(options: ImportOptions, sensor: str, unit: str) -> str:
    """Value of a count in an SI unit, and the counts at zero input; for gyros in degrees, too, as data sheets do."""
    lsb, offset = getattr(options, f"{sensor}_lsb"), getattr(options, f"{sensor}_offset")
    text = f" of {_triple_text(lsb)} {unit}"
    if sensor == "gyro" and len(set(lsb)) == 1:
        text += f" ({_triple_text(tuple(value / DEG for value in lsb))} {unit.replace('rad', '°')})"
    return text if offset is None else f"{text}, zero at {_triple_text(offset)}"


def _triple_text(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.6g}" for value in (values if len(set(values)) > 1 else values[:1]))


def _of_numbers(name: str, value: Any) -> Triple:
    numbers = np.asarray(real_array(name, value), dtype=np.float64).ravel()
    if numbers.size not in (1, 3) or not np.all(np.isfinite(numbers)):
        raise InputError(f"{name} is {value!r}, but one finite number, or three, is expected.")
    x, y, z = np.broadcast_to(numbers, 3).tolist()
    return x, y, z


def _fraction(text: str) -> float:
    numerator, slash, denominator = text.partition("/")
    return float(numerator) / float(denominator) if slash else float(numerator)


def _triple(text: str, name: str, read: Callable[[str], float]) -> Triple:
    try:
        values = [read(part) for part in text.split(",")]
    except (ValueError, ZeroDivisionError):
        values = []
    if len(values) == 1:
        values *= 3
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise InputError(f"{option(name)} is {text!r}, but one number, or three separated by commas, is expected.")
    return values[0], values[1], values[2]


_DEFAULT = ImportOptions()
