"""Reading of recordings, of logs in other formats and of arrays: one function, with keywords for missing properties.

The keywords are the keys of ``recording.toml`` and the fields of
:class:`~srt.recording.import_options.ImportOptions`, with the unit in the name; ``srt convert`` has them as options.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.arguments import real_array, require_type
from srt.constants import STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError, NotStatedError, did_you_mean
from srt.recording.folder import TOML_NAME, load_recording, read_document, read_metadata, sha256_of
from srt.recording.import_options import CHANNELS, TRIADS, ImportOptions, option
from srt.recording.imported_samples import StatedUnits, in_imu_axes, samples_in_si, to_recording
from srt.recording.importer_registry import AUTO, import_file
from srt.recording.recording import GRAVITY_SIGMA_M_S2, Recording
from srt.recording.samples import TIME
from srt.recording.schema import ASSUMED, SECTIONS
from srt.recording.writing import sections_of

if TYPE_CHECKING:
    from srt.recording.imported_samples import ImportedSamples
    from srt.recording.importer_registry import Importer
    from srt.recording.recording import Site

SECTION_KEYS: Final = {section: tuple(key.name for key in SECTIONS[section]) for section in ("site", "fixture", "imu")}
"""Keys of the sections of ``recording.toml`` that can be given as keywords."""
SAMPLES_KEYS: Final = tuple(item.name for item in fields(ImportOptions))
IDENTIFICATION_KEYS: Final = ("serial", "date", "temperature_c", "applied")
STATED_KEYS: Final = (*SAMPLES_KEYS, *IDENTIFICATION_KEYS, *(key for keys in SECTION_KEYS.values() for key in keys))
"""Keywords of :func:`read` other than ``format`` and ``like``."""
READING_KEYS: Final = frozenset((*STATED_KEYS, "format", "like"))

_LARGEST_M_S2: Final = 1e3  # far above any gravity, which is refused by its key
_GRAVITY: Final = ("gravity_m_s2", "height_m", "gravity_sigma_m_s2", "gravity_sigma_origin")
ANYWHERE_SIGMA_M_S2: Final = 0.02
"""Standard deviation of gravity between places, m/s²: it goes from 9.780 at the equator to 9.832 at the poles at sea
level, 0.015 if uniformly distributed, and falls by 0.003 for each kilometre of height."""

_SI_UNITS: Final = {"rate": StatedUnits("rad/s", "m/s^2", "s"), "increment": StatedUnits("rad", "m/s", "s")}
"""Units of arrays by kind, unless others are stated: those of this package."""


def read(
    source: Any,
    *,
    format: str = AUTO,  # noqa: A002 - as the option
    like: str | os.PathLike[str] | Recording | None = None,
    **stated: Any,
) -> Recording:
    """Read a recording, a log in another format, or arrays.

    Parameters
    ----------
    source : path-like, Recording, mapping, DataFrame or tuple
        A folder with ``recording.toml``; a log in any format of ``srt convert --list``; arrays ``(time, gyro, accel)``,
        with None for time stamps that do not exist; or a mapping with ``gyro`` and ``accel`` (or ``gyro_x`` and so on),
        ``time`` and ``temperature``. Arrays are in SI units unless a unit is stated. A DataFrame without a column of
        time has the stamps in its index, if that consists of dates or durations, or is named "time".
    format : str
        Format of a log; "auto" recognises it.
    like : path-like or Recording, optional
        Recording that provides site, fixture, noise and sequences. Stated values override them.
    **stated
        Properties that the data lack, with the unit in the name. Samples: ``kind``, ``gyro_unit``, ``accel_unit``,
        ``time_unit``, ``gyro_lsb`` and ``accel_lsb`` (SI units per count, or a text as "1/131 deg/s"),
        ``gyro_offset``, ``accel_offset``, ``sample_rate_hz``, ``columns``, ``map_gyro``, ``map_accel``, ``topic`` and
        the other fields of :class:`~srt.recording.import_options.ImportOptions`. Place: ``latitude_deg``,
        ``gravity_m_s2``, ``height_m``, ``gravity_sigma_m_s2``, ``latitude_sigma_deg``. Fixture: ``heading_deg``,
        ``alignment_sigma_mrad``,
        ``rotation_sigma_mrad``, ``wobble_sigma_mrad``; without any of them there is none. Noise of the unit:
        ``gyro_noise_deg_per_sqrt_h``, ``accel_noise_ug_per_sqrt_hz`` and the other keys of ``[imu]``. Unit:
        ``serial``, ``date``, ``temperature_c``, and ``applied``, the
        :class:`~srt.recording.applied.AppliedCorrection` that the readings had before they were logged.

    Returns
    -------
    Recording
        In SI units; the hash of arrays is that of their values in SI.

    Raises
    ------
    InputError
        A source that cannot be read, an unknown keyword, or something that has to be stated and is not.
    MissingExtraError
        If the format needs a package that is not installed.
    """
    unknown = sorted(set(stated) - set(STATED_KEYS))
    if unknown:
        raise InputError(
            f"There is no keyword {unknown[0]!r}{did_you_mean(unknown[0], STATED_KEYS)}: "
            f"use one of {', '.join(STATED_KEYS)}."
        )
    if like is not None:
        require_type("like=", "a recording, or the path of one", like, Recording, str, os.PathLike)
    given = {key: value for key, value in stated.items() if value is not None}
    try:
        if isinstance(source, Recording):
            return restated(source, given, like)
        if isinstance(source, str | os.PathLike):
            path = Path(source)
            if path.suffix == ".toml" or (path / TOML_NAME).is_file() or not path.exists():
                return restated(load_recording(path), given, like)
            return read_log(path, given, format=format, like=like)[0]
        return _from_arrays(source, given, like)
    except InputError as error:
        if type(error) not in (InputError, NotStatedError):  # the message of a missing extra has no keyword in it
            raise
        raise InputError(_as_keywords(str(error)), fault=error.fault) from None


def read_log(
    path: Path,
    given: Mapping[str, Any],
    *,
    format: str = AUTO,  # noqa: A002
    like: str | os.PathLike[str] | Recording | None = None,
) -> tuple[Recording, ImportedSamples, Importer]:
    """Read a log in another format, with keywords of :func:`read` that are not None. Raises InputError."""
    options = _import_options(given)
    try:
        about = surroundings(given, like)
    except NotStatedError as gravity:
        # All that is missing is asked for at once.
        try:
            import_file(path, options, format)
        except NotStatedError as units:
            raise NotStatedError(f"{units} {gravity}", missing=(*units.missing, *gravity.missing)) from None
        raise
    importer, imported = import_file(path, options, format)
    origin = {"source": os.fspath(path), "data_sha256": sha256_of(path)}
    try:
        return _recording(imported, about, {**_identification(given), **origin}), imported, importer
    except InputError as error:
        raise error.reworded(f"{path}: {error}") from None


def surroundings(given: Mapping[str, Any], like: str | os.PathLike[str] | Recording | None = None) -> dict[str, Any]:
    """Fields site, fixture, noise and sequences, as stated by keywords of :func:`read`, else as in another recording.

    Raises InputError: gravity is not given, a wrong value, or a file that cannot be read.
    """
    if isinstance(like, Recording):
        document = sections_of(like)
    else:
        document = {} if like is None else {k: v for k, v in read_document(Path(like)).items() if k != "recording"}
    if isinstance(document.get("imu"), dict):
        # The other log may have been made under another calibration of the logger.
        document["imu"] = {key: value for key, value in document["imu"].items() if key != "applied"}
    _state(document, given)
    site = document.get("site", {})
    if isinstance(site, dict) and "gravity_m_s2" not in site and not {"latitude_deg", "height_m"} <= set(site):
        raise NotStatedError(
            "Gravity is not known: give it with --gravity-m-s2, or --latitude-deg and --height-m for normal gravity, "
            "or name a recording of the same place with --like.",
            missing=[key for key in ("latitude_deg", "height_m") if key not in site],
        )
    name = str(like) if isinstance(like, str | os.PathLike) else "As stated"
    about = read_metadata(name, document)
    return about | {"sequences": like.sequences} if isinstance(like, Recording) else about


def restated(
    recording: Recording, given: Mapping[str, Any], like: str | os.PathLike[str] | Recording | None = None
) -> Recording:
    """Recording with another site, fixture, noise or identification, as stated.

    Raises InputError for a keyword on the samples, which a recording states itself.
    """
    samples = sorted(set(given) & {*SAMPLES_KEYS, "temperature_c"} - {"sample_rate_hz"})
    if samples:
        raise InputError(
            f"{samples[0]} is given, but the recording states it: leave it out, or correct recording.toml."
        )
    if not given and like is None:
        return recording
    document = sections_of(recording)
    if like is not None:
        other = sections_of(like if isinstance(like, Recording) else load_recording(like))
        document |= other
    _state(document, given)
    about = read_metadata("As stated", document)
    rest = {key: given[key] for key in ("serial", "date", "sample_rate_hz", "applied") if key in given}
    return replace(recording, **{name: about[name] for name in ("site", "fixture", "noise")}, **rest)


def _state(document: dict[str, Any], given: Mapping[str, Any]) -> None:
    """Enter what is stated in the sections of ``recording.toml``."""
    for section, keys in SECTION_KEYS.items():
        # Numbers of numpy are numbers, too.
        said = {k: v.item() if isinstance(v, np.generic) else v for k in keys if (v := given.get(k)) is not None}
        before = document.get(section, {})
        # A section that is no table is refused by name when the document is read.
        if not said or not isinstance(before, dict):
            continue
        # Gravity that is given replaces all values from the other recording, and a sigma its origin.
        drop = set(_GRAVITY) if {"gravity_m_s2", "height_m"} & set(said) else set()
        drop |= {"gravity_sigma_origin"} if "gravity_sigma_m_s2" in said else set()
        gravity = said.get("gravity_m_s2")
        if isinstance(gravity, int | float) and 0.0 < gravity < _LARGEST_M_S2 and "gravity_sigma_m_s2" not in said:
            said |= {"gravity_sigma_m_s2": sigma_of_digits(gravity), "gravity_sigma_origin": ASSUMED}
        document[section] = {key: value for key, value in before.items() if key not in drop} | said


def sigma_of_digits(gravity_m_s2: float) -> float:
    """1-sigma, m/s², of a gravity that is stated without one.

    Half a unit of the last digit either way, uniformly distributed: 0.29 units. Standard gravity is the value of no
    place: it stands for gravity anywhere.
    """
    if gravity_m_s2 == STANDARD_GRAVITY_M_S2:
        return ANYWHERE_SIGMA_M_S2
    last = Decimal(str(gravity_m_s2)).as_tuple().exponent
    assert isinstance(last, int)
    return max(10.0**last / math.sqrt(12.0), GRAVITY_SIGMA_M_S2)


def gravity_warning(site: Site, *, of_file: bool = False) -> str | None:
    """Sentence on a gravity that is the standard value and that nobody stated a sigma of; None for any other.

    With ``of_file``, only if ``recording.toml`` states none: a sigma that ``srt convert`` assumed was told then.
    """
    if site.gravity_m_s2 != STANDARD_GRAVITY_M_S2 or site.gravity_sigma_origin is None:
        return None
    sigma, names = site.gravity_sigma_m_s2, ("latitude_deg", "height_m", "gravity_sigma_m_s2")
    unstated = sigma == GRAVITY_SIGMA_M_S2  # the default of a file, not that of the digits
    if of_file and not unstated:
        return None
    latitude, height, key = names if unstated else map(option, names)
    place = height if site.latitude_rad is not None else f"{latitude} and {height}"
    taken = (
        f"recording.toml states no {key}: {sigma:g} m/s² is assumed, which is that of a measured value"
        if unstated
        else f"its sigma is taken as {sigma:g} m/s², {1e6 * sigma / site.gravity_m_s2:.0f} ppm of every accelerometer "
        "scale factor"
    )
    return (
        f"Gravity is {STANDARD_GRAVITY_M_S2} m/s², the standard value, which is that of no place: {taken}. "
        f"In its place, give {place}, or the gravity of the site; or {key} if it is right."
    )


def _from_arrays(source: Any, given: Mapping[str, Any], like: str | os.PathLike[str] | Recording | None) -> Recording:
    """Recording of arrays."""
    table = _arrays(source)
    table |= {name: real_array(name, table[name], dates=True) for name in CHANNELS if table.get(name) is not None}
    options = _import_options(given)
    refused = sorted(options.given - {"kind", "time_unit", "sample_rate_hz", "map_gyro", "map_accel"} - {
        f"{sensor}_{what}" for sensor in TRIADS for what in ("unit", "lsb", "offset")})  # fmt: skip
    if refused:
        raise InputError(f"{refused[0]} is given, but arrays have none: leave it out.")
    units = _SI_UNITS[options.kind or "rate"]
    counts = {sensor: None for sensor in TRIADS if getattr(options, f"{sensor}_lsb") is not None}
    imported = samples_in_si(
        options,
        gyro=_matrix("gyro", table["gyro"]),
        accel=_matrix("accel", table["accel"]),
        time=None if table.get(TIME) is None else _stamps(table[TIME]),
        stated=replace(units, **counts),
        temperature=None if table.get("temperature") is None else np.asarray(table["temperature"]),
    )
    imported = in_imu_axes(imported, options)
    digest = hashlib.sha256()
    for values in (imported.time, imported.gyro, imported.accel):
        digest.update(b"" if values is None else np.ascontiguousarray(values).tobytes())
    origin = {"data_sha256": digest.hexdigest()}
    return _recording(imported, surroundings(given, like), {**_identification(given), **origin})


def _arrays(source: Any) -> dict[str, Any]:
    """Arrays by "time", "gyro", "accel" and "temperature"."""
    if isinstance(source, tuple) and len(source) == 3:
        source = dict(zip(("time", "gyro", "accel"), source, strict=True))
    if not isinstance(source, Mapping) and not hasattr(source, "columns"):
        raise InputError(
            f"{type(source).__name__} is no recording: give the path of a recording or of a log, a Recording, arrays "
            "as (time, gyro, accel), or a mapping with gyro and accel."
        )
    names = source.keys() if isinstance(source, Mapping) else source.columns
    table = {str(name): source[name] for name in names}
    index: Any = getattr(source, "index", None)  # of pandas
    if TIME not in table and hasattr(index, "dtype") and (index.dtype.kind in "mM" or index.name == TIME):
        table[TIME] = index
    for sensor, channels in TRIADS.items():
        if sensor not in table and all(channel in table for channel in channels):
            table[sensor] = np.column_stack([real_array(channel, table.pop(channel)) for channel in channels])
    missing = [sensor for sensor in TRIADS if table.get(sensor) is None]
    unknown = sorted(set(table) - {*TRIADS, *CHANNELS})
    if missing or unknown:
        wrong = " and ".join(
            ([f"there is no {' and no '.join(missing)}"] if missing else [])
            + ([f"no channel is called {' or '.join(map(repr, unknown))}"] if unknown else [])
        )
        raise InputError(
            f"The arrays are not complete: {wrong}; expected are gyro and accel (or gyro_x and so on), with time and "
            "temperature where they exist."
        )
    return table


def _stamps(values: Any) -> np.ndarray[Any, Any]:
    # Dates with a time zone, of pandas, would become an array of objects.
    zoned = hasattr(getattr(values, "dtype", None), "tz")
    return np.asarray(values, dtype="M8[ns]" if zoned else None)


def _matrix(name: str, values: Any) -> np.ndarray[Any, Any]:
    return np.asarray(real_array(name, values), dtype=np.float64)


def _recording(imported: ImportedSamples, about: Mapping[str, Any], rest: Mapping[str, Any]) -> Recording:
    recording = to_recording(imported, **{**about, **rest})
    # Timing is found when it is first needed; a rate that contradicts the stamps is refused here already.
    recording.timing  # noqa: B018
    return recording


def _import_options(given: Mapping[str, Any]) -> ImportOptions:
    return ImportOptions(**{key: given[key] for key in SAMPLES_KEYS if given.get(key) is not None})


def _identification(given: Mapping[str, Any]) -> dict[str, Any]:
    return {key: given[key] for key in IDENTIFICATION_KEYS if key in given}


def _as_keywords(sentence: str) -> str:
    """Message with the options of the command line replaced by the keywords of :func:`read`."""
    names = {name.replace("_", "-"): name for name in READING_KEYS}
    spelled = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    return re.sub(rf"--({spelled})(?![\w-])", lambda match: names[match[1]] + "=", sentence)
