"""Recordings of the telephone apps Sensor Logger and phyphox: zip archive or folder with one CSV table for each sensor.

Each table has the columns ``time`` (ns since 1970), ``seconds_elapsed``, ``z``, ``y``, ``x``. Units are the app's:
rad/s for the gyro tables and m/s² for ``TotalAcceleration``. ``AccelerometerUncalibrated`` is in m/s², or in g on iOS
without "Standardise Units & Frames". ``Accelerometer`` lacks gravity and is not read.

The app phyphox exports such tables, too, with "Time (s)" and units in their heads; its ``Accelerometer`` has gravity.
"""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, NamedTuple

from srt.exceptions import InputError
from srt.recording.file_guards import clear_errors, require_size
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.csv_formats import read_pair

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples


class _App(NamedTuple):
    """Tables of an app in order of preference: of specific force with their unit, of angular rate in rad/s."""

    title: str
    accel: Mapping[str, str | None]
    gyro: tuple[str, ...]
    time_unit: str
    advice: str


_SENSOR_LOGGER: Final = _App(
    "archive of Sensor Logger",
    {"TotalAcceleration.csv": "m/s^2", "AccelerometerUncalibrated.csv": None},  # None: it depends on the telephone
    ("Gyroscope.csv", "GyroscopeUncalibrated.csv"),
    "ns",
    "record the sensor, uncalibrated",
)
# "Linear Acceleration.csv" of phyphox lacks gravity.
_PHYPHOX: Final = _App(
    "phyphox export",
    {"Accelerometer.csv": "m/s^2"},
    ("Gyroscope.csv",),
    "s",
    "export the raw data of accelerometer (with g) and gyroscope",
)


def _names(path: Path) -> set[str]:
    """Tables of an archive or a folder."""
    if path.is_dir():
        return {each.name for each in path.iterdir() if each.is_file()}
    with zipfile.ZipFile(path) as archive:
        return set(archive.namelist())


def _sniff(path: Path, *, phyphox: bool = False) -> bool:
    """True for tables with the names of an app; phyphox also needs its head, as Sensor Logger has the same names."""
    (gyro,) = _PHYPHOX.gyro
    names: set[str] = set()
    try:
        if not path.is_dir() and head(path, 4) != b"PK\x03\x04":
            return False
        with clear_errors(path, _PHYPHOX.title):
            names = _names(path)
            if not phyphox:
                return not names.isdisjoint(_SENSOR_LOGGER.gyro)
            if not {gyro, *_PHYPHOX.accel} <= names:
                return False
            if path.is_dir():
                return b"Time (s)" in head(path / gyro)
            with zipfile.ZipFile(path) as archive, archive.open(gyro) as table:
                return b"Time (s)" in table.read(200)
    except (OSError, InputError):
        # A damaged table: the names decide, and the reader tells the damage.
        return phyphox and {gyro, *_PHYPHOX.accel} <= names and names.isdisjoint(_SENSOR_LOGGER.accel)


def _read(app: _App, path: Path, options: ImportOptions) -> ImportedSamples:
    with clear_errors(path, app.title):
        names = _names(path)
    accel, gyro = (next((name for name in tables if name in names), None) for tables in (app.accel, app.gyro))
    if accel is None or gyro is None:
        what, tables = ("gyro readings", app.gyro) if gyro is None else ("acceleration with gravity", app.accel)
        raise InputError(f"{path} holds no {what} (expected: {' or '.join(tables)}): {app.advice}.")
    options = replace(
        options,
        time_unit=app.time_unit,
        gyro_unit=options.gyro_unit or ("rad/s" if options.gyro_lsb is None else None),
        accel_unit=options.accel_unit or (app.accel[accel] if options.accel_lsb is None else None),
    )
    if path.is_dir():
        return read_pair(path / accel, replace(options, second=path / gyro))
    with TemporaryDirectory(prefix="srt-") as folder:
        for name in (accel, gyro):
            _extract(app, path, name, Path(folder))
        try:
            return read_pair(Path(folder) / accel, replace(options, second=Path(folder) / gyro))
        except InputError as error:
            raise InputError(str(error).replace(folder, str(path)), fault=error.fault) from None


def _extract(app: _App, path: Path, name: str, folder: Path) -> None:
    with clear_errors(path, app.title), zipfile.ZipFile(path) as archive:
        info = archive.getinfo(name)
        require_size(path, f"table {name}", info.file_size, min(info.compress_size, path.stat().st_size))
        with archive.open(info) as table, (folder / name).open("wb") as copy:
            shutil.copyfileobj(table, copy)


PHYPHOX: Final = Importer(
    "phyphox", "phyphox (zip or folder of CSV)", (), None, partial(_sniff, phyphox=True), partial(_read, _PHYPHOX)
)
SENSOR_LOGGER: Final = Importer(
    "sensor-logger", "Sensor Logger (zip or folder of CSV)", (), None, _sniff, partial(_read, _SENSOR_LOGGER)
)
