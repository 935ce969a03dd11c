"""Reading of a recording folder: ``recording.toml`` and the samples file that it names.

This module and the importers of foreign formats convert units: files state their units, in names of keys or as keys;
values in memory are in SI.
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from srt.constants import normal_gravity_m_s2
from srt.exceptions import DataError, InputError, MissingExtraError, NotStatedError
from srt.recording.applied import applied_correction
from srt.recording.import_options import SENSOR_UNITS, ImportOptions
from srt.recording.imported_samples import ImportedSamples, require_units, to_recording, to_si
from srt.recording.importer_registry import import_file, is_foreign
from srt.recording.protocol import load_protocol
from srt.recording.recording import Fixture, ImuNoise, Recording, Site
from srt.recording.samples import read_samples
from srt.recording.schema import (
    ASSUMED,
    COUNTS,
    POSE_KEYS,
    SECTIONS,
    SEQUENCE_KEYS,
    TIME_UNITS,
    fields_of,
    read_fields,
    read_section,
    require_sections,
)
from srt.recording.sequence_label import SequenceLabel
from srt.recording.toml_text import read_toml

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.recording.protocol import Protocol

TOML_NAME: Final = "recording.toml"

_OPTION_KEYS: Final = {name: name for name in ("kind", "time_unit", "sample_rate_hz")} | {
    f"{sensor}_{what}": f"{sensor}_{key}"
    for sensor in SENSOR_UNITS
    for what, key in (("unit", "unit"), ("lsb", "lsb"), ("offset", "offset_counts"))
}
"""Keys of [recording] by the options of importers that they state."""
_OPTION: Final = re.compile(rf"--({'|'.join(_OPTION_KEYS).replace('_', '-')})(?: \(\w+ in recording\.toml\))?")
"""Such an option as messages name it."""

_NORMAL_GRAVITY_SIGMA_M_S2 = 5e-4  # 1 sigma: local anomalies, which normal gravity does not include


def load_recording(path: str | os.PathLike[str]) -> Recording:
    """Read a recording, in SI units, from its folder or its ``recording.toml``.

    Gravity is ``gravity_m_s2`` if given, else normal gravity at ``height_m``. Without a column ``temperature``, all
    samples have ``temperature_c``. Without a column ``time``, ``sample_rate_hz`` gives the time stamps; the first
    interval starts at 0. Samples in a foreign format are imported; units that such a format defines can be omitted.

    Raises InputError: a file that is absent, unreadable or damaged, an unknown key, a wrong type, unit or value,
    samples outside the recording's folder, or samples that :class:`~srt.recording.recording.Recording` refuses;
    MissingExtraError if the samples format needs a package that is not installed.
    """
    toml = _find_toml(Path(path))
    document = read_document(toml)
    if "recording" not in document:
        raise InputError(f"{toml}: the section [recording] is missing: add it.")
    main = read_section(str(toml), "recording", document["recording"], SECTIONS["recording"])
    about = read_metadata(str(toml), document)
    if "samples" not in main:
        raise InputError(f'{toml}: recording.samples is missing: name the samples file, as samples = "samples.csv".')
    samples_path = samples_inside(toml, main["samples"])
    try:
        return to_recording(
            _samples(toml, samples_path, main),
            **about,
            temperature_c=main.get("temperature_c"),
            source=os.fspath(path),
            data_sha256=sha256_of(samples_path),
            serial=main.get("serial"),
            date=main.get("date"),
            clock_sigma=main.get("clock_sigma_ppm"),
        )
    except InputError as error:
        if type(error) not in (InputError, NotStatedError) or str(toml.parent) in str(error):
            raise
        raise error.reworded(f"{toml.parent}: {error}") from None


def _samples(toml: Path, path: Path, main: Mapping[str, Any]) -> ImportedSamples:
    """Samples in SI units, by the keys of [recording]; messages name these keys."""
    try:
        options = ImportOptions(**{name: main[key] for name, key in _OPTION_KEYS.items() if key in main})
        return import_file(path, options)[1] if is_foreign(path) else _own(path, options)
    except (InputError, DataError) as error:
        if isinstance(error, MissingExtraError):
            raise
        text = _OPTION.sub(lambda option: f"recording.{_OPTION_KEYS[option[1].replace('-', '_')]}", str(error))
        named = text if str(toml.parent) in text else f"{toml}: {text}"
        raise error.reworded(named) from None


def _own(path: Path, options: ImportOptions) -> ImportedSamples:
    """Samples in a format of recordings, converted to SI in place; the zero of their stamps stays."""
    require_units(options, dict.fromkeys(SENSOR_UNITS))
    samples = read_samples(path, time_required=options.sample_rate_hz is None)
    kind = options.kind or "rate"
    for sensor in SENSOR_UNITS:
        to_si(options, sensor, getattr(options, f"{sensor}_unit") or COUNTS, kind, getattr(samples, sensor))
    if samples.time is not None and options.time_unit not in (None, "s"):
        samples.time *= TIME_UNITS[options.time_unit]
    return ImportedSamples(samples.gyro, samples.accel, kind, samples.time, options.sample_rate_hz, samples.temperature)


def read_metadata(file: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a recording out of the sections [site], [fixture], [imu] and [[sequence]] of a file.

    Raises InputError: an unknown key, a wrong type or value, no site.
    """
    if "site" not in document:
        raise InputError(f"{file}: the section [site] is missing: add it.")
    site = _read_site(file, document)
    fixture = None
    if "fixture" in document:
        fixture = Fixture(**{"heading_rad": None, **read_fields(file, "fixture", document["fixture"])})
    imu = document.get("imu", {})
    applied = None
    if isinstance(imu, dict) and "applied" in imu:
        applied = applied_correction(file, imu["applied"])
        imu = {name: value for name, value in imu.items() if name != "applied"}
    noise = ImuNoise(**read_fields(file, "imu", imu))
    sequences = _read_sequences(file, document.get("sequence", []))
    about = {"site": site, "fixture": fixture, "noise": noise, "sequences": sequences, "applied": applied}
    return about | {"protocol": _read_protocol(file, document)}


def _read_sequences(file: str, values: object) -> tuple[SequenceLabel, ...]:
    """Labels of the tables [[sequence]]; one with ``static_s`` is a pose."""
    if not isinstance(values, list):
        raise InputError(f"{file}: sequence is no list: write each as [[sequence]], in double brackets.")
    labels = []
    for number, value in enumerate(values, start=1):
        posed = isinstance(value, dict) and "static_s" in value
        keys = POSE_KEYS if posed else SEQUENCE_KEYS
        section = read_section(file, f"sequence[{number}]", value, keys)
        for name in () if posed else ("start_static_s", "end_static_s"):
            if name not in section:
                raise InputError(f"{file}: sequence[{number}].{name} is missing: add the window [from, to] in s.")
        try:
            labels.append((SequenceLabel.of_pose if posed else SequenceLabel)(**fields_of(section, keys)))
        except InputError as error:
            raise InputError(f"{file}: sequence[{number}]: {error}") from None
    return tuple(labels)


def _read_protocol(file: str, document: Mapping[str, Any]) -> Protocol | None:
    """Protocol that [recording] names; a relative path starts from the folder of the file."""
    main = document.get("recording")
    name = main.get("protocol") if isinstance(main, dict) else None
    if not isinstance(name, str):
        return None
    try:
        return load_protocol(name, near=Path(file).parent)
    except InputError as error:
        raise InputError(f"{file}: recording.protocol: {error}", fault=error.fault) from None


def read_document(toml: Path) -> dict[str, Any]:
    """Read a ``recording.toml``, or that of a folder, without checking its values; its sections are known ones."""
    found = _find_toml(toml)
    document = read_toml(found)
    require_sections(str(found), document, SECTIONS)
    return document


def _find_toml(path: Path) -> Path:
    if path.is_dir():
        toml = path / TOML_NAME
        if not toml.is_file():
            raise InputError(
                f"The folder {path} holds no {TOML_NAME}: it is no recording; {_conversion_advice(path, 'folder')}."
            )
        return toml
    if not path.exists():
        what = "file" if path.suffix else "recording"
        raise InputError(f"There is no {what} {path}: check the path.")
    if path.suffix != ".toml":
        raise InputError(
            f"{path} is no recording: name the folder that holds {TOML_NAME}, or {_conversion_advice(path, 'file')}."
        )
    return path


def _conversion_advice(path: Path, what: str) -> str:
    """Advice to convert a foreign file, if its format is known."""
    from srt.recording.importer_registry import find_importer

    try:
        title = find_importer(path).title
    except InputError:
        return f"name another {what}"
    return (
        f"convert the {what} ({title}): srt convert {path} -o DIR, with --latitude-deg and --height-m, and "
        "--gyro-unit, --accel-unit and --time-unit where it states none; 'srt calibrate LOG -o FOLDER' keeps such a "
        "recording as FOLDER/recording"
    )


def samples_inside(toml: Path, name: str) -> Path:
    """Path of the samples, which must lie in the recording's folder; symbolic links are resolved. Raises InputError."""
    path = toml.parent / name
    try:
        # A bag may be a folder with links as files.
        parts = [path, *path.iterdir()] if path.is_dir() else [path]
        folder = toml.parent.resolve()
        inside = all(part.resolve().is_relative_to(folder) for part in parts)
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a name too long or with a zero in it
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{toml}: recording.samples is no usable name of a file ({reason}): correct it.") from None
    if not inside:
        raise InputError(
            f"{toml}: recording.samples leads out of the recording's folder ({name}): copy the samples into the "
            "folder, and give the file's name alone."
        )
    return path


def _read_site(file: str, document: Mapping[str, Any]) -> Site:
    site = read_section(file, "site", document["site"], SECTIONS["site"])
    given = fields_of(site, SECTIONS["site"])
    if "gravity_m_s2" not in site:
        if "height_m" not in site:
            raise InputError(
                f"{file}: neither site.gravity_m_s2 nor site.height_m is given: "
                "give local gravity in m/s², or latitude_deg and height_m for normal gravity."
            )
        if "latitude_deg" not in site:
            raise InputError(
                f"{file}: site.height_m is given without site.latitude_deg, on which normal gravity depends: "
                "add latitude_deg, or give gravity_m_s2."
            )
        gravity = normal_gravity_m_s2(given["latitude_rad"], site["height_m"])
        given = {"gravity_m_s2": gravity, "gravity_sigma_m_s2": _NORMAL_GRAVITY_SIGMA_M_S2, **given}
    if "gravity_sigma_m_s2" not in site:
        given["gravity_sigma_origin"] = ASSUMED
    return Site(**given)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, or of a folder's files."""
    if path.is_dir():
        # A bag may be a folder: hash of the hashes of its files, in the order of their names.
        files = sorted(each for each in path.iterdir() if each.is_file() and each.name != TOML_NAME)
        return hashlib.sha256("\n".join(f"{sha256_of(each)} {each.name}" for each in files).encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
