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
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError
from srt.recording.file_guards import require_size
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.csv_formats import read_pair
from srt.recording.importers.parser_errors import clear_errors

if TYPE_CHECKING:
    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples

ACCEL_TABLES: Final = {"TotalAcceleration.csv": "m/s^2", "AccelerometerUncalibrated.csv": None}
"""Tables of specific force in order of preference, with their unit; None: it depends on the telephone."""

GYRO_TABLES: Final = ("Gyroscope.csv", "GyroscopeUncalibrated.csv")
"""Tables of angular rate, in order of preference."""

PHYPHOX_ACCEL: Final = "Accelerometer.csv"
PHYPHOX_GYRO: Final = "Gyroscope.csv"
"""Tables of phyphox: "Linear Acceleration.csv" lacks gravity and is not read."""

_TITLE = "archive of Sensor Logger"


def _names(path: Path) -> set[str]:
    """Tables of an archive or a folder."""
    if path.is_dir():
        return {each.name for each in path.iterdir() if each.is_file()}
    with zipfile.ZipFile(path) as archive:
        return set(archive.namelist())


def _sniff(path: Path) -> bool:
    if not path.is_dir() and head(path, 4) != b"PK\x03\x04":
        return False
    try:
        return not _names(path).isdisjoint(GYRO_TABLES)
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False


def _read(path: Path, options: ImportOptions) -> ImportedSamples:
    with clear_errors(path, _TITLE):
        names = _names(path)
    accel = next((name for name in ACCEL_TABLES if name in names), None)
    gyro = next((name for name in GYRO_TABLES if name in names), None)
    if accel is None or gyro is None:
        raise InputError(
            f"{path} holds no {'gyro readings' if gyro is None else 'acceleration with gravity'} (expected: "
            f"{' or '.join(GYRO_TABLES if gyro is None else ACCEL_TABLES)}): record the sensor, uncalibrated."
        )
    if path.is_dir():
        return _read_tables(path / accel, path / gyro, options)
    with TemporaryDirectory(prefix="srt-") as folder:
        for name in (accel, gyro):
            _extract(path, name, Path(folder))
        try:
            return _read_tables(Path(folder) / accel, Path(folder) / gyro, options)
        except InputError as error:
            raise InputError(str(error).replace(folder, str(path)), fault=error.fault) from None


def _read_tables(accel: Path, gyro: Path, options: ImportOptions) -> ImportedSamples:
    return read_pair(
        accel,
        replace(
            options,
            second=gyro,
            time_unit="ns",
            gyro_unit=options.gyro_unit or ("rad/s" if options.gyro_lsb is None else None),
            accel_unit=options.accel_unit or (ACCEL_TABLES[accel.name] if options.accel_lsb is None else None),
        ),
    )


def _extract(path: Path, name: str, folder: Path) -> None:
    with clear_errors(path, _TITLE), zipfile.ZipFile(path) as archive:
        info = archive.getinfo(name)
        require_size(path, f"table {name}", info.file_size, min(info.compress_size, path.stat().st_size))
        with archive.open(info) as table, (folder / name).open("wb") as copy:
            shutil.copyfileobj(table, copy)


def _sniff_phyphox(path: Path) -> bool:
    """Tables of the names of the app, with its head: Sensor Logger has tables of the same names."""
    try:
        if not _sniff(path) or not {PHYPHOX_ACCEL, PHYPHOX_GYRO} <= _names(path):
            return False
        if path.is_dir():
            return b"Time (s)" in head(path / PHYPHOX_GYRO)
        with zipfile.ZipFile(path) as archive, archive.open(PHYPHOX_GYRO) as table:
            return b"Time (s)" in table.read(200)
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False


def _read_phyphox(path: Path, options: ImportOptions) -> ImportedSamples:
    def read(accel: Path, gyro: Path) -> ImportedSamples:
        return read_pair(
            accel,
            replace(
                options,
                second=gyro,
                time_unit="s",
                gyro_unit=options.gyro_unit or "rad/s",
                accel_unit=options.accel_unit or "m/s^2",
            ),
        )

    with clear_errors(path, "phyphox export"):
        names = _names(path)
    for name in (PHYPHOX_ACCEL, PHYPHOX_GYRO):
        if name not in names:
            raise InputError(f"{path} holds no {name}: export the raw data of accelerometer (with g) and gyroscope.")
    if path.is_dir():
        return read(path / PHYPHOX_ACCEL, path / PHYPHOX_GYRO)
    with TemporaryDirectory(prefix="srt-") as folder:
        for name in (PHYPHOX_ACCEL, PHYPHOX_GYRO):
            _extract(path, name, Path(folder))
        try:
            return read(Path(folder) / PHYPHOX_ACCEL, Path(folder) / PHYPHOX_GYRO)
        except InputError as error:
            raise InputError(str(error).replace(folder, str(path)), fault=error.fault) from None


PHYPHOX: Final = Importer("phyphox", "phyphox (zip or folder of CSV)", (), None, _sniff_phyphox, _read_phyphox)

SENSOR_LOGGER: Final = Importer(
    "sensor-logger",
    "Sensor Logger (zip or folder of CSV)",
    (),
    None,
    _sniff,
    _read,
)
