"""Text tables of vendors' programs, whose units are published: MicroStrain SensorConnect, Xsens MT Manager, KF-GINS."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.import_options import ImportOptions, option
from srt.recording.imported_samples import ImportedSamples, StatedUnits, of_channels, samples_in_si
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.csv_formats import TEXT_OPTIONS, find_layout, read_csv_table
from srt.recording.samples import ACCEL_COLUMNS, GYRO_COLUMNS, TIME
from srt.recording.text_tables import read_table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from srt.recording.recording import Kind
    from srt.types import Array

_MICROSTRAIN_UNITS: Final[Mapping[Kind, StatedUnits]] = {
    "rate": StatedUnits("rad/s", "g", None),
    "increment": StatedUnits("rad", "g*s", None),
}
"""Units of the MIP protocol: scaled rates, delta theta and delta velocity."""

_XSENS_UNITS: Final[Mapping[Kind, StatedUnits]] = {"rate": StatedUnits("rad/s", "m/s^2", "0.1ms")}
"""Units of the MTi manual; SampleTimeFine counts at 10 kHz."""
_XSENS_RATE: Final = re.compile(r"//\s*Update Rate:\s*([0-9]+(?:\.[0-9]+)?)\s*Hz")
_WRAP_S: Final = 2**32 * 1e-4  # period of SampleTimeFine, an unsigned integer of 32 bits
_XSENS_COUNTER: Final = "PacketCounter"
_XSENS_COUNTS: Final = 2**16  # period of the packet counter, an unsigned integer of 16 bits
_RATE_TOLERANCE: Final = 0.1
"""Share by which stamps and stated rate may differ; the next unit of time is a factor of 10 away."""


def _read_xsens(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read an export of MT Manager: rates where it has them, its own stamps, else its update rate and counter."""
    stated = _XSENS_RATE.search(head(path).decode("latin-1"))
    rate = float(stated.group(1)) if stated else None
    result = read_csv_table(path, options, _XSENS_UNITS, rate)
    if result.time is None:
        counted = _time_by_packets(path, options, rate)
        return result if counted is None else replace(result, time=counted, sample_rate_hz=None)
    time = result.time
    if options.time_unit is None:
        time = time + _WRAP_S * np.cumsum(np.diff(time, prepend=time[0]) < -0.5 * _WRAP_S)
        step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        if rate is not None and abs(step * rate - 1.0) > _RATE_TOLERANCE:
            raise InputError(
                f"{path}: SampleTimeFine has steps of {step * 1e4:.6g}, but {1e4 / rate:.6g} ticks of 0.1 ms are "
                f"expected at the stated rate of {rate:g} Hz: state the unit with {option('time_unit')}, or "
                f"{option('sample_rate_hz')}."
            )
    return replace(result, time=time)


def _time_by_packets(path: Path, options: ImportOptions, rate: float | None) -> Array | None:
    """Time by packet counter and stated rate, s from the first; None if none is missing or the rate is given."""
    layout = find_layout(path, options)
    if rate is None or options.sample_rate_hz is not None or _XSENS_COUNTER not in layout.header:
        return None
    counter = read_table(path, layout, {_XSENS_COUNTER: layout.header.index(_XSENS_COUNTER)})[_XSENS_COUNTER]
    steps = np.diff(counter, prepend=counter[0]) % _XSENS_COUNTS
    return np.cumsum(steps) / rate if np.any(steps[1:] != 1.0) else None


def _read_kf_gins(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read second of week, angle increments in rad and velocity increments in m/s, without a header."""
    layout = find_layout(path, options)
    names = (TIME, *GYRO_COLUMNS, *ACCEL_COLUMNS)
    if len(layout.cells) < len(names):
        raise InputError(
            f"{path} has {len(layout.cells)} columns, but {len(names)} are expected: time, angles, velocities."
        )
    table = read_table(path, layout, {name: i for i, name in enumerate(names)})
    return samples_in_si(options, **of_channels(table), stated=StatedUnits("rad", "m/s", "s"), kind="increment")


def _importer(
    name: str, title: str, sniff: Callable[[bytes], bool], read: Callable[..., ImportedSamples], options: frozenset[str]
) -> Importer:
    return Importer(name, title, (), None, lambda path: sniff(head(path)), read, options)


KF_GINS: Final = _importer(
    "kf-gins",
    "KF-GINS increments as text (time, angles, velocities)",
    lambda _: False,  # seven columns without names may be anything
    _read_kf_gins,
    frozenset({"delimiter", "skip"}),
)
MICROSTRAIN: Final = _importer(
    "microstrain",
    "MicroStrain SensorConnect CSV (scaledGyro and scaledAccel, or deltaTheta and deltaVel)",
    lambda text: (
        (b"scaledGyroX" in text and b"scaledAccelX" in text) or (b"deltaThetaX" in text and b"deltaVelX" in text)
    ),
    partial(read_csv_table, published=_MICROSTRAIN_UNITS),
    TEXT_OPTIONS | {"kind"},
)
XSENS: Final = _importer(
    "xsens",
    "Xsens MT Manager text (Acc, Gyr; SampleTimeFine of 0.1 ms)",
    lambda text: text.startswith(b"//") and b"PacketCounter" in text and b"Acc_X" in text and b"Gyr_X" in text,
    _read_xsens,
    TEXT_OPTIONS,
)
