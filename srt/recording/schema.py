"""Keys of ``recording.toml``: name, type, unit and range of each, and its attribute.

Reader, writer and the classes of :mod:`srt.recording.recording` use these tables. A new key also needs its field
there. Unknown keys are refused with the most similar known name.
"""

from __future__ import annotations

import datetime
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from srt.constants import ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError, clipped, did_you_mean
from srt.model.table1 import SIGNED_AXES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

INFINITY: Final = math.inf

LARGEST_RATE_DEG_S: Final = 1e6
"""Bound of rates, °/s: gyros of spinning projectiles read 1e5."""
_LARGEST_ANGLE_DEG: Final = 3.6e5  # bound of one rotation, degrees: a thousand revolutions
LARGEST_SIGMA_MRAD: Final = 3200.0
"""Bound of the sigma of an angle, mrad: half a revolution, beyond which nothing is said of the direction."""
SMALLEST_SIGMA_MRAD: Final = 1e-9
"""Bound of the sigma of a fixture, mrad: 1e-12 rad, which the planner counts as exact."""
LARGEST_ELEMENT: Final = 1e6
"""Bound of matrices and offsets of a logger, SI units: far beyond any sensor's scale factor or reading."""
LARGEST_PPM: Final = 1e6
"""Bound of a relative sigma, ppm: as large as the quantity."""
FASTEST_HZ: Final = 1e6
"""Bound of the sample rate, Hz: a hundred times that of the fastest IMUs."""
LARGEST_TIME_S: Final = 1e5
"""Bound of the duration of a test and of its parts, s: more than a day."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a section."""

    name: str
    expected: str  # value in words, for messages
    read: Callable[[Any], Any]  # conversion of a TOML value to SI; raises ValueError for an unexpected one
    attribute: str | None = None  # field of the dataclass of the section; None: for the reader only
    factor: float = 1.0  # SI units per unit of the file; the writer divides by it


def finite_numbers(value: Any, count: int, allowed: Callable[[float], bool] = lambda _: True) -> tuple[float, ...]:
    """Floats of a list of ``count`` finite, allowed numbers. Raises ValueError for anything else."""
    if not isinstance(value, list) or len(value) != count:
        raise ValueError
    for each in value:
        if not isinstance(each, int | float) or isinstance(each, bool) or not math.isfinite(each) or not allowed(each):
            raise ValueError
    return tuple(map(float, value))


def number(
    name: str,
    unit: str,
    attribute: str | None = None,
    *,
    factor: float = 1.0,
    low: float = -INFINITY,
    high: float,
    above: float = -INFINITY,
) -> Key:
    """Key of a finite number within [low, high] and greater than ``above``, in units of the file."""

    def read(value: Any) -> float:
        return finite_numbers([value], 1, lambda v: low <= v <= high and v > above)[0] * factor

    limits = f"a positive number of at most {high:g}" if above == 0.0 else f"a number from {low:g} to {high:g}"
    return Key(name, f"{limits} in {unit}", read, attribute, factor)


def text(name: str, attribute: str | None = None, choices: tuple[str, ...] = ()) -> Key:
    """Key of a text, or of one of several choices; a TOML date becomes its text."""

    def read(value: Any) -> str:
        if isinstance(value, datetime.date | datetime.datetime) and not choices:
            return value.isoformat()
        if not isinstance(value, str) or not value or (choices and value not in choices):
            raise ValueError
        return value

    expected = "one of " + ", ".join(f'"{choice}"' for choice in choices) if choices else "a text in quotes"
    return Key(name, expected, read, attribute)


def one_or_three(name: str, unit: str, *, zero: bool, high: float) -> Key:
    """Key of a number, or a list of three for x, y, z, of magnitudes up to ``high``; read as a tuple of three."""

    def read(value: Any) -> tuple[float, ...]:
        three = value if isinstance(value, list) else [value] * 3
        return finite_numbers(three, 3, lambda v: abs(v) <= high and (zero or v != 0))

    limits = f"a number {'' if zero else 'other than 0 '}or a list of three"
    return Key(name, f"{limits}, of magnitudes up to {high:g}, in {unit}", read)


def whole(name: str, attribute: str, low: int = 0, high: int = (1 << 32) - 1) -> Key:
    """Key of a whole number within [low, high], by default one that has 32 bits."""

    def read(value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise ValueError
        return value

    return Key(name, f"a whole number from {low} to {high}", read, attribute)


def numbers(name: str, unit: str, attribute: str, count: int) -> Key:
    """Key of a list of finite numbers, matrices by rows."""

    def read(value: Any) -> tuple[float, ...]:
        return finite_numbers(value, count, lambda v: abs(v) <= LARGEST_ELEMENT)

    return Key(name, f"a list of {count} numbers of magnitudes up to {LARGEST_ELEMENT:g}, {unit},", read, attribute)


def _window(name: str) -> Key:
    return Key(name, "a window [from, to] in s", lambda value: finite_numbers(value, 2), name)


def _about_axis(value: Any, largest: float) -> tuple[str, float]:
    """Axis, and angle or rate about it: rad and rad/s from degrees up to ``largest``."""
    if not (isinstance(value, list) and len(value) == 2 and value[0] in ("x", "y", "z")):
        raise ValueError
    return value[0], finite_numbers(value[1:], 1, lambda v: abs(v) <= largest)[0] * DEG


def _read_rotations(value: Any) -> tuple[tuple[str, float], ...]:
    if not isinstance(value, list):
        raise ValueError  # noqa: TRY004 - the caller turns every ValueError into one sentence
    return tuple(_about_axis(item, _LARGEST_ANGLE_DEG) for item in value)


GYRO_UNITS: Final = {"rate": {"rad/s": 1.0, "deg/s": DEG, "deg/h": DEG_PER_H}, "increment": {"rad": 1.0, "deg": DEG}}
"""SI units per unit of the file, by kind of recording; "counts" has its own factor."""

ACCEL_UNITS: Final = {
    "rate": {"m/s^2": 1.0, "g": STANDARD_GRAVITY_M_S2, "mg": 1e-3 * STANDARD_GRAVITY_M_S2},
    "increment": {"m/s": 1.0, "g*s": STANDARD_GRAVITY_M_S2},
}

TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "0.1ms": 1e-4, "us": 1e-6, "ns": 1e-9}

COUNTS: Final = "counts"


UNITS: Final = {
    "gyro": (*GYRO_UNITS["rate"], *GYRO_UNITS["increment"], COUNTS),
    "accel": (*ACCEL_UNITS["rate"], *ACCEL_UNITS["increment"], COUNTS),
    "time": tuple(TIME_UNITS),
}
"""Units that files may state, by quantity."""

RECORDING_KEYS: Final = (
    text("samples"),
    text("kind", "kind", ("rate", "increment")),
    text("gyro_unit", choices=UNITS["gyro"]),
    text("accel_unit", choices=UNITS["accel"]),
    text("time_unit", choices=UNITS["time"]),
    one_or_three("gyro_lsb", "rad/s (or rad) per count", zero=False, high=1e3),
    one_or_three("gyro_offset_counts", "counts", zero=True, high=2.0**63),
    one_or_three("accel_lsb", "m/s² (or m/s) per count", zero=False, high=1e3),
    one_or_three("accel_offset_counts", "counts", zero=True, high=2.0**63),
    number("sample_rate_hz", "Hz", "sample_rate_hz", above=0.0, high=FASTEST_HZ),
    number("clock_sigma_ppm", "ppm", "clock_sigma", factor=1e-6, low=0.0, high=LARGEST_PPM),
    text("serial", "serial"),
    text("date", "date"),
    text("protocol"),
    number("temperature_c", "°C", low=-273.15, high=1000.0),
)

ASSUMED: Final = "assumed"
"""Origin of a standard deviation that nobody stated."""

SITE_KEYS: Final = (
    number("latitude_deg", "degrees", "latitude_rad", factor=DEG, low=-90.0, high=90.0),
    number("gravity_m_s2", "m/s²", "gravity_m_s2", low=9.5, high=10.1),
    number("height_m", "m", low=-1000.0, high=10000.0),
    number("gravity_sigma_m_s2", "m/s²", "gravity_sigma_m_s2", above=0.0, high=1.0),
    number("latitude_sigma_deg", "degrees", "latitude_sigma_rad", factor=DEG, low=0.0, high=180.0),
    text("gravity_sigma_origin", "gravity_sigma_origin", (ASSUMED,)),
)

FIXTURE_KEYS: Final = (
    number("heading_deg", "degrees", "heading_rad", factor=DEG, low=-360.0, high=360.0),
    number(
        "alignment_sigma_mrad",
        "mrad",
        "alignment_sigma_rad",
        factor=1e-3,
        low=SMALLEST_SIGMA_MRAD,
        high=LARGEST_SIGMA_MRAD,
    ),
    number(
        "rotation_sigma_mrad",
        "mrad",
        "rotation_sigma_rad",
        factor=1e-3,
        low=SMALLEST_SIGMA_MRAD,
        high=LARGEST_SIGMA_MRAD,
    ),
    number("wobble_sigma_mrad", "mrad", "wobble_sigma_rad", factor=1e-3, low=0.0, high=LARGEST_SIGMA_MRAD),
)

IMU_KEYS: Final = (
    number("gyro_noise_deg_per_sqrt_h", "°/√h", "gyro_noise", factor=DEG_PER_SQRT_H, low=1e-9, high=1e5),
    number("accel_noise_ug_per_sqrt_hz", "µg/√Hz", "accel_noise", factor=MICRO_G, low=1e-6, high=1e8),
    number("gyro_quantization_arcsec", "arc seconds", "gyro_quantization", factor=ARCSEC, low=0.0, high=1.296e6),
    number("accel_quantization_m_s", "m/s", "accel_quantization", low=0.0, high=100.0),
    number("gyro_bias_instability_deg_per_h", "°/h", "gyro_bias_instability", factor=DEG_PER_H, low=0.0, high=1e6),
    number("accel_bias_instability_ug", "µg", "accel_bias_instability", factor=MICRO_G, low=0.0, high=1e7),
    number("gyro_range_deg_s", "°/s", "gyro_range", factor=DEG, low=0.01, high=LARGEST_RATE_DEG_S),
    number("accel_range_g", "g", "accel_range", factor=STANDARD_GRAVITY_M_S2, low=0.1, high=1e6),
)
"""Keys of [imu]. Each bound is a hundred times the worst of sensors or more: noise whose mean over a second is 29 rad/s
or 100 g, a quantum of one revolution or of 10 s at 1 g, an instability of 280 °/s or 10 g, the range of gun-launched
units (1e5 g). The lower bounds are as far from the best: noise of a thousandth of that of a ring laser of the size of a
room, and ranges in which the Earth's rate or gravity would already be clipped."""

APPLIED_KEYS: Final = (
    text("system", "system"),
    whole("instance", "instance"),
    whole("gyro_instance", "gyro_instance"),
    whole("gyro_id", "gyro_id"),
    whole("accel_id", "accel_id"),
    numbers("rotation", "sensor axes to log axes, by rows", "rotation", 9),
    numbers("gyro_matrix", "by rows", "gyro_matrix", 9),
    numbers("gyro_offset_rad_s", "rad/s", "gyro_offset", 3),
    numbers("accel_matrix", "by rows", "accel_matrix", 9),
    numbers("accel_offset_m_s2", "m/s²", "accel_offset", 3),
    numbers("g_sensitivity", "rad/s per m/s², by rows", "g_sensitivity", 9),
)
"""Keys of [imu.applied]: the correction that the readings had before they were logged."""

SEQUENCE_KEYS: Final = (
    text("id", "id"),
    _window("start_static_s"),
    _window("end_static_s"),
    text("down", "down", SIGNED_AXES),
    text("along_outer", "along_outer", SIGNED_AXES),
    Key("rotations", 'a list like [["y", 180.0], ["z", 90.0]] in degrees', _read_rotations, "rotations", DEG),
    Key(
        "rate_deg_s",
        'an axis and a rate like ["z", -100.0] in deg/s',
        lambda value: _about_axis(value, LARGEST_RATE_DEG_S),
        "rate",
        DEG,
    ),
    number("rate_sigma_ppm", "ppm", "rate_sigma", factor=1e-6, low=1e-6, high=LARGEST_PPM),
    _window("steady_s"),
)

POSE_KEYS: Final = (
    _window("static_s"),
    text("id", "id"),
    text("down", "down", SIGNED_AXES),
    text("along_outer", "along_outer", SIGNED_AXES),
)
"""Keys of a [[sequence]] that is a pose."""

SECTIONS: Final = {
    "recording": RECORDING_KEYS,
    "site": SITE_KEYS,
    "fixture": FIXTURE_KEYS,
    "imu": IMU_KEYS,
    "imu.applied": APPLIED_KEYS,
    "sequence": SEQUENCE_KEYS,
}


def require_sections(file: str, document: Iterable[str], known: Iterable[str]) -> None:
    """Raise InputError for a section of a file that is none of the known ones."""
    known = tuple(known)
    for section in document:
        if section not in known or "." in section:
            raise InputError(
                f"{file}: [{clipped(section)}] is no known section{did_you_mean(section, known)}: "
                f"remove it, or use one of {', '.join(known)}."
            )


def read_section(file: str, section: str, values: object, keys: tuple[Key, ...]) -> dict[str, Any]:
    """Check one section of a file against its keys: values in SI by key, without the keys that are absent.

    Raises InputError for unknown keys, wrong types, values out of range.
    """
    if not isinstance(values, dict):
        raise InputError(f"{file}: {section} is {shown(values)}, but a section of keys is expected.")
    known = {key.name: key for key in keys}
    result: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            raise InputError(
                f"{file}: {section}.{clipped(name)} is no known key{did_you_mean(name, known)}: "
                f"remove it, or use one of {', '.join(known)}."
            )
        try:
            result[name] = known[name].read(value)
        except (ValueError, OverflowError):
            raise InputError(
                f"{file}: {section}.{name} is {shown(value)}, but {known[name].expected} is expected."
            ) from None
    return result


def read_fields(file: str, section: str, values: object, keys: tuple[Key, ...] | None = None) -> dict[str, Any]:
    """Values of a section, in SI, by field of its dataclass; checked as :func:`read_section` does.

    The keys are those of the section, unless given.
    """
    keys = SECTIONS[section] if keys is None else keys
    return fields_of(read_section(file, section, values, keys), keys)


def check_fields(what: str, source: object, keys: Iterable[Key]) -> None:
    """Check the numbers of a Site, Fixture, ImuNoise or Recording, as far as stated, against the ranges of their keys.

    ``what`` is the owner of the fields, as the start of a sentence: "The unit's". Raises InputError for a field that is
    no number, or out of range.
    """
    for key in keys:
        value = None if key.attribute is None else getattr(source, key.attribute)
        if value is None:
            continue
        if hasattr(value, "item"):  # a number of numpy, which files do not know
            value = value.item()
            object.__setattr__(source, str(key.attribute), value)
        try:
            # 12 digits: 90° is in the range after any conversion.
            key.read(value if isinstance(value, str) else float(f"{value / key.factor:.12g}"))
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"{what} {key.attribute} is {short(value)} in SI units, but for {key.name} {key.expected} is expected: "
                "correct it or leave it out."
            ) from None


def fields_of(section: Mapping[str, Any], keys: tuple[Key, ...]) -> dict[str, Any]:
    """Values of a section that are fields of its dataclass, by field name."""
    return {key.attribute: section[key.name] for key in keys if key.attribute is not None and key.name in section}


def section_of(source: object, keys: Iterable[Key]) -> dict[str, Any]:
    """Fields of a dataclass that are neither None nor empty, by key, in the units of the file."""
    values = {key: getattr(source, key.attribute) for key in keys if key.attribute is not None}
    return {key.name: _in_file(value, key.factor) for key, value in values.items() if value not in (None, ())}


def _in_file(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return [_in_file(item, factor) for item in value] if factor != 1.0 else list(value)
    return in_file_unit(value, factor) if isinstance(value, int | float) else value


def in_file_unit(value: float, factor: float) -> float:
    """Convert from SI to the unit of the file so that reading returns the same bits, if a float can.

    Round numbers come first: 45° is 45.0, not 45.00000000000001.
    """
    exact = value / factor
    nearest = (exact, math.nextafter(exact, INFINITY), math.nextafter(exact, -INFINITY))
    for candidate in (*(float(f"{exact:.{digits}g}") for digits in (6, 12, 15)), *nearest):
        if candidate * factor == value:
            return candidate
    return exact


def toml_value(value: object) -> str:
    """TOML notation of a text, a number, or a list of them."""
    if isinstance(value, str):
        # JSON strings are TOML strings, except for the character DEL.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    assert isinstance(value, int | float)
    return repr(value if type(value) is int else float(value))


def short(value: object) -> str:
    """Number for messages, of six digits."""
    return f"{value:g}" if isinstance(value, float) else shown(value)


def shown(value: object) -> str:
    """Value for messages, at most 60 characters."""
    try:
        text = f'the text "{value}"' if isinstance(value, str) else repr(value)
    except ValueError:  # Python's bound on the digits of an integer, which hexadecimal ones can exceed
        return "an integer of more than 4300 digits"
    return text if len(text) <= 60 else text[:57] + "..."
