"""Options for reading a foreign file: columns, units, axes, and the choice among several IMUs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import TYPE_CHECKING, Final, get_args

import numpy as np

from srt.arguments import require_type
from srt.constants import DEG
from srt.exceptions import InputError, did_you_mean
from srt.model.table1 import AXES
from srt.recording.recording import Kind
from srt.recording.samples import ACCEL_COLUMNS, GYRO_COLUMNS, TEMPERATURE, TIME
from srt.recording.schema import ACCEL_UNITS, COUNTS, GYRO_UNITS, TIME_UNITS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from srt.types import Array

TRIADS: Final = {"gyro": GYRO_COLUMNS, "accel": ACCEL_COLUMNS}
"""Channels of each sensor; the name of a sensor stands for its three channels."""

CHANNELS: Final = (TIME, *GYRO_COLUMNS, *ACCEL_COLUMNS, TEMPERATURE)

SENSOR_UNITS: Final = {"gyro": GYRO_UNITS, "accel": ACCEL_UNITS}

Triple = tuple[float, float, float]

_SPELLINGS = {
    "rad s^-1": "rad/s",
    "rads^-1": "rad/s",
    "rad*s^-1": "rad/s",
    "rad/sec": "rad/s",
    "rps": "rad/s",
    "°/s": "deg/s",
    "deg/sec": "deg/s",
    "degree/s": "deg/s",
    "degrees/s": "deg/s",
    "deg s^-1": "deg/s",
    "dps": "deg/s",
    "°/h": "deg/h",
    "deg/hr": "deg/h",
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "m/s²": "m/s^2",
    "m/s2": "m/s^2",
    "m/s/s": "m/s^2",
    "m/sec^2": "m/s^2",
    "m s^-2": "m/s^2",
    "ms^-2": "m/s^2",
    "m*s^-2": "m/s^2",
    "g0": "g",
    "milli-g": "mg",
    "m s^-1": "m/s",
    "sec": "s",
    "seconds": "s",
    "second": "s",
    "msec": "ms",
    "milliseconds": "ms",
    "µs": "us",
    "μs": "us",
    "usec": "us",
    "microseconds": "us",
    "nsec": "ns",
    "nanoseconds": "ns",
    "lsb": COUNTS,
    "count": COUNTS,
    "raw": COUNTS,
}

_LSB_UNITS = {"gyro": {**GYRO_UNITS["rate"], "rad": 1.0, "deg": DEG}, "accel": {**ACCEL_UNITS["rate"], "m/s": 1.0}}


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Properties of a file that it does not state, or states wrongly; None: as the format defines.

    Attributes
    ----------
    columns : mapping of channel to column
        Channels are those of a table of samples, or "gyro" and "accel" for an array of three columns; a column is a
        name, or a number counted from 1. Empty: columns are recognised by their names.
    kind : "rate" or "increment"
    time_unit, gyro_unit, accel_unit : str
        As in ``recording.toml``.
    gyro_lsb, accel_lsb : (float, float, float)
        SI units per count, for the unit "counts".
    gyro_offset, accel_offset : (float, float, float)
        Counts at zero input.
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
        for sensor, units in SENSOR_UNITS.items():
            self._set_unit(f"{sensor}_unit", (*units["rate"], *units["increment"], COUNTS))
            parse_axis_map(getattr(self, f"map_{sensor}"), f"map_{sensor}")
            counts = getattr(self, f"{sensor}_unit") in (None, COUNTS)
            for name in (f"{sensor}_lsb", f"{sensor}_offset"):
                if getattr(self, name) is not None and not counts:
                    raise InputError(
                        f"{option(name)} is given, but {option(f'{sensor}_unit')} is "
                        f"{getattr(self, f'{sensor}_unit')}: leave it out, or state the unit counts."
                    )
        self._set_unit("time_unit", tuple(TIME_UNITS))
        rate = self.sample_rate_hz
        if rate is not None:
            require_type(option("sample_rate_hz"), "a number in Hz", rate, Real)
        if rate is not None and not (math.isfinite(rate) and rate > 0.0):
            raise InputError(f"{option('sample_rate_hz')} is {rate:g}, but a positive number in Hz is expected.")
        if self.skip < 0:
            raise InputError(f"{option('skip')} is {self.skip}, but a number of lines is expected.")
        require_type(option("columns"), "a text, or a mapping of channels to columns", self.columns, Mapping)
        for channel in self.columns:
            if channel not in CHANNELS and channel not in TRIADS:
                raise InputError(
                    f"{option('columns')}: {channel!r} is no channel{did_you_mean(channel, CHANNELS)}: "
                    f"use {', '.join((*TRIADS, *CHANNELS))}."
                )

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
        default = _DEFAULT
        return frozenset(item.name for item in fields(self) if getattr(self, item.name) != getattr(default, item.name))


def option(name: str) -> str:
    """Option of the command line for a field of :class:`ImportOptions`, as messages name it."""
    return "--" + name.replace("_", "-")


def normal_unit(text: str) -> str:
    """Convert the spelling of a unit to that of ``recording.toml``; an unknown one is returned unchanged.

    Parameters
    ----------
    text : str
        Such as "dps", "rad s^-1" or "m/s²".

    Returns
    -------
    str
    """
    folded = " ".join(text.strip().lower().replace("**", "^").split())
    return _SPELLINGS.get(folded, folded)


def parse_columns(text: str) -> dict[str, str | int]:
    """Read a column map from one line of text.

    Parameters
    ----------
    text : str
        Channels in the order of the columns ("time,gyro,accel", with "-" for a column that is not read), or channels
        with their columns ("gyro_x=wx,gyro_y=wy", "gyro_x=4"), or both.

    Returns
    -------
    dict
        As :attr:`ImportOptions.columns`.

    Raises
    ------
    InputError
        A channel that is unknown or named twice.
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
    """Read an axis map such as "x,-y,z".

    Parameters
    ----------
    text : str or None
        Axes of the file that become x, y and z of the IMU, with their signs.
    name : str
        Field of the options, for messages.

    Returns
    -------
    ndarray, shape (3, 3), or None
        Signed permutation P with IMU = P @ file.

    Raises
    ------
    InputError
        Text that is not the three axes, each once.
    """
    if text is None:
        return None
    parts = [part.strip().lower() for part in text.split(",")]
    axes = [part.lstrip("+-") for part in parts]
    if sorted(axes) != list(AXES) or any(
        part not in (axis, f"+{axis}", f"-{axis}") for part, axis in zip(parts, axes, strict=True)
    ):
        raise InputError(
            f"{option(name)} is {text!r}, but three axes, each once, are expected, such as x,-y,z or y,x,-z."
        )
    matrix = np.zeros((3, 3))
    for row, (part, axis) in enumerate(zip(parts, axes, strict=True)):
        matrix[row, AXES.index(axis)] = -1.0 if part.startswith("-") else 1.0
    return matrix


def parse_lsb(text: str, sensor: str) -> Triple:
    """Read the scale factor of counts.

    Parameters
    ----------
    text : str
        One number or three, each also as 1/N, and a unit: "1/131 deg/s", "1/415,1/413,1/415 m/s^2". The default unit
        is SI.
    sensor : "gyro" or "accel"

    Returns
    -------
    (float, float, float)
        SI units per count.

    Raises
    ------
    InputError
    """
    name = f"{sensor}_lsb"
    numbers, _, unit_text = text.strip().partition(" ")
    factors = _LSB_UNITS[sensor]
    unit = normal_unit(unit_text)
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
