"""Writing of a recording folder: the samples file and ``recording.toml``, replaced together or not at all.

The opposite of :mod:`srt.recording.folder`.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

from srt.arguments import require_path, require_type
from srt.exceptions import InputError, did_you_mean
from srt.recording.atomic_file import remove_leftovers, unwritable
from srt.recording.file_marks import write_marked_text
from srt.recording.folder import TOML_NAME, read_document
from srt.recording.recording import Recording
from srt.recording.samples import SAMPLES_FORMATS, Samples, write_samples
from srt.recording.schema import POSE_KEYS, SECTIONS, SEQUENCE_KEYS, section_of, toml_value


def write_recording(
    recording: Recording, directory: str | os.PathLike[str], *, samples_format: str = "csv", overwrite: bool = False
) -> None:
    """Write a recording in SI units, samples exact to the last bit.

    Parameters
    ----------
    directory : path-like
        Folder; created if absent.
    samples_format : str
        "csv", "npz", "parquet" or "h5".
    overwrite : bool
        Write to a folder that has files already. Files of other names remain.

    Raises
    ------
    InputError
        A folder with files in it, an unknown format, a path that cannot be written. The folder then has
        the same complete recording as before, and no incomplete file.
    MissingExtraError
        If the format needs a package that is not installed.
    """
    require_type("write_recording", "a recording (srt.read)", recording, Recording)
    require_path("write_recording", directory)
    require_type("samples_format=", "a text", samples_format, str)
    if samples_format not in SAMPLES_FORMATS:
        raise InputError(
            f"There is no samples format {samples_format!r}{did_you_mean(samples_format, SAMPLES_FORMATS)}: "
            f"use one of {', '.join(SAMPLES_FORMATS)}."
        )
    folder = Path(directory)
    created = _prepare(folder, overwrite=overwrite)
    name, usual, old_name = _unused_name(folder, samples_format), f"samples.{samples_format}", _old_name(folder)
    temperature = recording.temperature
    constant = temperature is not None and temperature.strides == (0,)
    # Writers copy one column or block at a time.
    samples = Samples(recording.gyro, recording.accel, recording.time, None if constant else temperature)
    try:
        write_samples(folder / name, samples)
        try:
            # Until this renaming, the folder has the old recording; from then on, the new one.
            write_marked_text(folder / TOML_NAME, _emit(recording, name, folder))
        except BaseException:
            with suppress(OSError):
                (folder / name).unlink(missing_ok=True)
            raise
    except BaseException:
        if created and not any(folder.iterdir()):
            folder.rmdir()
        raise
    if re.fullmatch(rf"samples-\d+\.{samples_format}", old_name):  # from an interrupted overwriting
        with suppress(OSError):
            (folder / old_name).unlink()
    if name != usual:
        _rename_samples(folder, name, usual, _emit(recording, usual, folder))


def _old_name(folder: Path) -> str:
    """Name of the samples file of the recording in a folder, empty if there is none."""
    main: object = None
    with suppress(InputError):
        main = read_document(folder).get("recording")
    return str(main.get("samples", "")) if isinstance(main, dict) else ""


def _unused_name(folder: Path, samples_format: str) -> str:
    """Name for the new samples file that no file in the folder has."""
    numbered = (f"samples-{number}.{samples_format}" for number in count(2))
    return next(name for name in chain([f"samples.{samples_format}"], numbered) if not os.path.lexists(folder / name))


def _rename_samples(folder: Path, name: str, usual: str, toml_text: str) -> None:
    """Rename the new samples file to the usual name, replacing the old samples file.

    ``recording.toml`` names a complete file throughout. The recording is complete under either name, so errors end the
    renaming silently; the old samples are then removed, and the next overwriting takes their name.
    """
    link = folder / f".{name}.link"
    superseded = name
    try:
        link.hardlink_to(folder / name)
        link.replace(folder / usual)
        write_marked_text(folder / TOML_NAME, toml_text)
    except (OSError, NotImplementedError, InputError):  # some file systems have no links
        superseded = usual
    for path in (link, folder / superseded):
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _prepare(folder: Path, *, overwrite: bool) -> bool:
    """Create the folder if absent; True if it was created."""
    try:
        if folder.exists():
            if not folder.is_dir():
                raise InputError(f"{folder} is a file, but a recording is a folder: name another place.")
            remove_leftovers(folder)
            if any(folder.iterdir()) and not overwrite:
                raise InputError(f"The folder {folder} holds files already: name another, or allow overwriting.")
            return False
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(unwritable(folder, error)) from None
    return True


def sections_of(recording: Recording) -> dict[str, Any]:
    """Sections [site], [fixture] and [imu] of a recording, in the units of the file."""
    parts = {"site": recording.site, "fixture": recording.fixture, "imu": recording.noise}
    return {name: section_of(part, SECTIONS[name]) for name, part in parts.items() if part is not None}


def _emit(recording: Recording, samples_name: str, folder: Path) -> str:
    units = ("rad/s", "m/s^2") if recording.kind == "rate" else ("rad", "m/s")
    main: dict[str, Any] = {"samples": samples_name, "gyro_unit": units[0], "accel_unit": units[1], "time_unit": "s"}
    main |= section_of(recording, SECTIONS["recording"])
    if recording.protocol is not None:
        name = recording.protocol.name
        # The path of a file is relative to the folder.
        main["protocol"] = os.path.relpath(name, folder) if name.endswith(".toml") else name
    temperature = recording.temperature
    if temperature is not None and temperature.strides == (0,):
        main["temperature_c"] = float(temperature[0])
    tables = [("[recording]", main), *((f"[{name}]", section) for name, section in sections_of(recording).items())]
    if recording.applied is not None:
        tables.append(("[imu.applied]", recording.applied.document()))
    tables += [
        ("[[sequence]]", section_of(label, POSE_KEYS if label.pose else SEQUENCE_KEYS)) for label in recording.sequences
    ]
    return "\n".join(
        "\n".join([title, *(f"{name} = {toml_value(value)}" for name, value in table.items()), ""])
        for title, table in tables
        if table or title != "[imu]"
    )
