"""PX4 logs (ULog): rates, increments, or separate gyros and accelerometers, in the units that PX4 defines.

Topics in the order in which they are tried:

- ``sensor_combined``: means over ``gyro_integral_dt``, in rad/s and m/s², after PX4's own calibration;
- ``vehicle_imu``: increments over ``delta_angle_dt`` and ``delta_velocity_dt``, in rad and m/s, also calibrated by PX4;
  mean rates where the log has a part of them only;
- ``sensor_gyro`` with ``sensor_accel``: readings of the driver, in rad/s and m/s², not calibrated.

The parameters of the log give the calibration and orientation that PX4 applied; it finds them by the device ids.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.applied import AppliedCorrection
from srt.recording.autopilots import PX4
from srt.recording.file_guards import clear_errors
from srt.recording.importer_registry import Importer, starts_with
from srt.recording.importers.child_process import in_child
from srt.recording.importers.log_streams import Stream, choose_topic, join, to_imported
from srt.recording.timing import GAP_STEPS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples
    from srt.types import Array, Counts

MAGIC: Final = b"ULog\x01\x12\x35"

COMBINED: Final = "sensor_combined"
INCREMENTS: Final = "vehicle_imu"
GYRO: Final = "sensor_gyro"
ACCEL: Final = "sensor_accel"
SELECTION: Final = "sensor_selection"

TOPICS: Final = {COMBINED: (COMBINED,), INCREMENTS: (INCREMENTS,), GYRO: (GYRO, ACCEL)}
"""Values of the option ``topic``, and the topics of the log that each stands for, in order of preference."""

_TITLE = "ULog"

_US = 10**6  # ticks of a stamp in a second
_LATEST_STAMP_US = 2**62  # stamps of 146 000 years and more are damage; their differences would overflow 64 bits
_NOT_KNOWN_US = 0x7FFFFFFF  # PX4's value of accelerometer_timestamp_relative for "no reading yet", µs

_UNCOVERED = 0.01
"""Share of the time that increments leave out from which they are no increments between stamps: durations in whole µs
leave out 0.1 % at most at 1 kHz, a log of every second message leaves out half."""

_DURATION_MISMATCH = 1e-3
"""Relative difference of gyro and accelerometer intervals beyond which a note reports it: a sample at 1 kHz."""


@dataclass(frozen=True, slots=True, eq=False)
class _LogTopics:
    """Topics of a parsed log."""

    path: Path
    data: dict[tuple[str, int], dict[str, NDArray[Any]]]  # columns by topic and instance
    info: dict[str, object]  # on the system that wrote the log
    parameters: dict[str, float]  # at the start of the log
    changed: frozenset[str]  # parameters that changed within the log
    damaged: bool

    def instances(self, topic: str) -> list[int]:
        """Instances of a topic that hold samples."""
        return sorted(instance for name, instance in self.data if name == topic)

    def column(self, topic: str, instance: int, *names: str) -> Array:
        """Columns side by side, shape (n, len(names)), or (n,) for one."""
        data = self.data[topic, instance]
        missing = next((name for name in names if name not in data), None)
        if missing is not None:
            raise InputError(f"{self.path}: {topic} has no field {missing}: it is not PX4's topic of that name.")
        columns = [np.asarray(data[name], dtype=np.float64) for name in names]
        return columns[0] if len(columns) == 1 else np.stack(columns, axis=1)

    def device_ids(self, topic: str, instance: int) -> tuple[int, int] | None:
        """Ids of the gyros' and the accelerometers' device; None if not stated, or not the same throughout."""
        if topic == COMBINED:
            topic, instance = SELECTION, 0
        places = ((GYRO, "device_id"), (ACCEL, "device_id"))
        if topic != GYRO:
            places = ((topic, "gyro_device_id"), (topic, "accel_device_id"))
        found = []
        for name, column in places:
            ids = np.unique(self.data.get((name, instance), {}).get(column, np.zeros(0)))
            if ids.size != 1 or int(ids[0]) == 0:
                return None
            found.append(int(ids[0]))
        return found[0], found[1]

    def stamps(self, topic: str, instance: int) -> Counts:
        """Times of the samples, µs: the driver's stamp where there is one."""
        data = self.data[topic, instance]
        raw = data.get("timestamp_sample", data.get("timestamp"))
        if raw is None or raw.dtype != np.dtype(np.uint64):
            raise InputError(f"{self.path}: {topic} has no time stamps of 64 bits: it is not PX4's topic of that name.")
        if raw.size and int(raw.max()) >= _LATEST_STAMP_US:
            raise InputError(f"{self.path}: {topic} has stamps of more than 100 000 years: the log is damaged.")
        # Some drivers leave the stamp of the sample at zero.
        if not raw.any() and "timestamp" in data and data["timestamp"].dtype == raw.dtype:
            raw = np.minimum(data["timestamp"], np.uint64(_LATEST_STAMP_US))
        return raw.astype(np.int64)


def read_log(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read the IMU of a log, in this process. Raises InputError."""
    log = _parse(path)
    notes = ["The log is damaged; its readable messages were read."] if log.damaged else []
    there = ", ".join(f"{name} [{instance}]" for name, instance in sorted(log.data)) or "none of them"
    needed = " with ".join(TOPICS.get(options.topic or "", (f"{COMBINED}, {INCREMENTS}, or {GYRO}", ACCEL)))
    absent = f"of {needed} (found: {there}): log the IMU's topics."
    topic, instance = choose_topic(path, TOPICS, log.instances, options, notes, absent)
    serial = log.info.get("sys_uuid")
    stream, more = _READERS[topic](log, instance, notes)
    applied = _applied(log, topic, instance, notes)
    return to_imported(
        stream, options, notes, serial=serial if isinstance(serial, str) else None, applied=applied, **more
    )


def _applied(log: _LogTopics, topic: str, instance: int, notes: list[str]) -> AppliedCorrection | None:
    ids = log.device_ids(topic, instance)
    slots = [_slots(log, group, None if ids is None else ids[group]) for group in (0, 1)]
    if topic == GYRO:
        return _of_drivers(slots, ids)
    if len(slots[0]) != 1 or len(slots[1]) != 1:
        notes.append(
            "The log does not state which of PX4's calibrations (CAL_ACCn_ID, CAL_GYROn_ID) these readings had: it is "
            "not carried."
        )
        return None
    return PX4.carried(log.parameters, log.changed, (slots[1][0], slots[0][0]), notes)


def _of_drivers(slots: list[list[int]], ids: tuple[int, int] | None) -> AppliedCorrection:
    """Readings without a correction, with the places of their parameters as far as they are known."""
    gyro, accel = (found[0] if len(found) == 1 else None for found in slots)
    other = gyro if None not in (gyro, accel) and gyro != accel else None
    gyro_id, accel_id = ids or (None, None)
    return AppliedCorrection(PX4.name, accel, gyro_id, accel_id, other)


def _slots(log: _LogTopics, group: int, device: int | None) -> list[int]:
    """Slots of calibration parameters of a device, or all in use if the device is not known."""
    ids = {n: int(log.parameters.get(PX4.ids((n, n))[group], 0)) & 0xFFFFFFFF for n in range(PX4.instances)}
    return [n for n, each in ids.items() if each and device in (None, each)]


def _combined(log: _LogTopics, instance: int, notes: list[str]) -> tuple[Stream, dict[str, Any]]:
    """Gyro means at their stamps, accelerometers at theirs."""
    notes.append(f"PX4 has calibrated {COMBINED}: the errors found here are the residuals of that calibration.")
    stamps = log.stamps(COMBINED, instance)
    gyro = log.column(COMBINED, instance, *_triad("gyro_rad"))
    accel = log.column(COMBINED, instance, *_triad("accelerometer_m_s2"))
    offset = log.column(COMBINED, instance, "accelerometer_timestamp_relative").astype(np.int64)
    known = offset != _NOT_KNOWN_US
    if not known.all():
        notes.append(f"{COMBINED}: {np.count_nonzero(~known)} samples without an accelerometer reading dropped.")
    if not offset[known].any():
        return Stream(COMBINED, stamps[known], _US, np.hstack([gyro, accel])[known]), {}
    # A slower accelerometer repeats its reading, stamp and all, until it has a new one.
    accel_stamps, first = np.unique(stamps[known] + offset[known], return_index=True)
    pair = (Stream(COMBINED, stamps, _US, gyro), Stream(COMBINED, accel_stamps, _US, accel[known][first]))
    return join(*pair, notes), {}


def _increments(log: _LogTopics, instance: int, notes: list[str]) -> tuple[Stream, dict[str, Any]]:
    notes.append(f"PX4 has calibrated {INCREMENTS}: the errors found here are the residuals of that calibration.")
    values = [log.column(INCREMENTS, instance, *_triad(name)) for name in ("delta_angle", "delta_velocity")]
    spans = [log.column(INCREMENTS, instance, name) for name in ("delta_angle_dt", "delta_velocity_dt")]
    stamps = log.stamps(INCREMENTS, instance)
    steps = np.diff(stamps)
    covered = _covered(steps, spans[0][1:])
    if abs(covered - 1.0) > _UNCOVERED:
        notes.append(
            f"{INCREMENTS}: the increments cover {covered:.2g} of the time between their stamps (medians: "
            f"{np.median(spans[0]):g} of {np.median(steps):g} us), so that they were read as mean rates over their own "
            "intervals. A calibration needs a log of every message."
        )
        rates = np.hstack([value / (span / _US)[:, None] for value, span in zip(values, spans, strict=True)])
        return Stream(INCREMENTS, stamps, _US, rates), {}
    apart = np.abs(spans[0] - spans[1]) > _DURATION_MISMATCH * spans[0]
    if apart.any():
        notes.append(
            f"{INCREMENTS}: in {np.count_nonzero(apart)} of {apart.size} samples the velocity increment covers another "
            "time than the angle increment; it was scaled to the angle's."
        )
        # The mean specific force is the same over either interval to the accuracy at which they differ.
        values[1] = np.where(apart[:, None], values[1] * (spans[0] / spans[1])[:, None], values[1])
    return Stream(INCREMENTS, stamps, _US, np.hstack(values)), {"kind": "increment", "units": ("rad", "m/s")}


def _covered(steps: Counts, spans: Array) -> float:
    """Share of the time between stamps that increments cover, without the gaps of the log; jitter of stamps cancels."""
    whole = steps <= GAP_STEPS * np.median(steps) if steps.size else np.zeros(0, dtype=bool)
    total = float(steps[whole].sum())
    return float(spans[whole].sum()) / total if total > 0.0 else 1.0


def _apart(log: _LogTopics, instance: int, notes: list[str]) -> tuple[Stream, dict[str, Any]]:
    """Gyros and accelerometers as their drivers give them."""
    accels = log.instances(ACCEL)
    other = instance if instance in accels else accels[0]
    streams = []
    for topic, which in ((GYRO, instance), (ACCEL, other)):
        temperature = log.column(topic, which, "temperature") if "temperature" in log.data[topic, which] else None
        values = log.column(topic, which, "x", "y", "z")
        streams.append(Stream(f"{topic} [{which}]", log.stamps(topic, which), _US, values, temperature))
    return join(streams[0], streams[1], notes), {}


def _triad(name: str) -> tuple[str, ...]:
    return tuple(f"{name}[{i}]" for i in range(3))


_READERS: Final = {COMBINED: _combined, INCREMENTS: _increments, GYRO: _apart}


def _parse(path: Path) -> _LogTopics:
    """Parse the topics of an IMU."""
    from pyulog import ULog

    with clear_errors(path, _TITLE):
        log = ULog(str(path), sorted({part for parts in TOPICS.values() for part in parts} | {SELECTION}))
    data = {(each.name, each.multi_id): each.data for each in log.data_list}
    parameters = {name: value for name, value in log.initial_parameters.items() if isinstance(value, int | float)}
    changed = frozenset(name for _, name, value in log.changed_parameters if value != parameters.get(name))
    return _LogTopics(path, data, log.msg_info_dict, parameters, changed, bool(log.file_corruption))


_READ = in_child(f"{__name__}:{read_log.__name__}", "pyulog", "A PX4 log")
_OPTIONS = frozenset({"topic", "instance"})
ULOG: Final = Importer("ulog", "PX4 log (ULog)", (".ulg",), "formats", starts_with(MAGIC), _READ, _OPTIONS)
