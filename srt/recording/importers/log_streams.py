"""Streams of logs with several sensors: choice of a sensor, order of its samples, junction of two streams."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, did_you_mean
from srt.recording.import_options import option
from srt.recording.imported_samples import ImportedSamples, StatedUnits, first_of_repeats, join_streams, samples_in_si

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from pathlib import Path

    from srt.recording.import_options import ImportOptions
    from srt.types import Array, Counts, Indices, Mask

SI_UNITS: Final = ("rad/s", "m/s^2")

LATE_LIMIT_S: Final = 1.0
"""Largest delay of samples that is corrected by sorting, s; a clock that goes back by more was set."""


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Readings of one sensor, or of both, with their stamps."""

    name: str  # in messages and notes
    stamps: Counts  # shape (n,)
    per_second: int  # ticks of the stamps, a power of ten
    values: Array  # shape (n, 3) or (n, 6), in the units of the format
    temperature: Array | None = None  # shape (n,), °C

    def rows(self, which: Indices | Mask | slice) -> Stream:
        """Some of the samples."""
        temperature = None if self.temperature is None else self.temperature[which]
        return Stream(self.name, self.stamps[which], self.per_second, self.values[which], temperature)


def choose(path: Path, what: str, counts: Mapping[str, int], wanted: str | None, how: str, notes: list[str]) -> str:
    """Choose one of several sensors: the given one, else the one with most samples; a note names the others.

    ``what`` is the word for a sensor in messages, such as "topic"; ``counts`` are the samples of each; ``how`` is the
    option that chooses. Raises InputError if the given one is absent.
    """
    there = ", ".join(f"{name} ({count})" for name, count in sorted(counts.items())[:12])
    if wanted is not None:
        if wanted not in counts:
            raise InputError(
                f"{path} holds no IMU {what} {wanted}{did_you_mean(wanted, counts)}: "
                f"use one of those there, {there or 'none'} (samples in brackets)."
            )
        return wanted
    chosen = max(sorted(counts), key=lambda name: counts[name])
    if len(counts) > 1:
        notes.append(f"Several IMUs there: {there}; {what} {chosen} was read. Choose another with {how}.")
    return chosen


def choose_topic(
    path: Path,
    topics: Mapping[str, tuple[str, ...]],
    instances: Callable[[str], Collection[int]],
    options: ImportOptions,
    notes: list[str],
    absent: str,
) -> tuple[str, int]:
    """Choose topic and instance: those of the options, else the first; notes name the others.

    ``topics`` are the values of the option, in order of preference, with the parts of a log that each needs;
    ``instances`` are those of a part; ``absent`` ends the sentence on a log without them.

    Raises InputError if there is no such topic or instance.
    """
    wanted = options.topic
    if wanted is not None and wanted not in topics:
        raise InputError(
            f"{option('topic')} is {wanted!r}{did_you_mean(wanted, topics)}, but a log is read from one of "
            f"{', '.join(topics)}."
        )
    complete = [topic for topic, parts in topics.items() if all(map(instances, parts))]
    if not complete or wanted not in (None, *complete):
        raise InputError(f"{path} holds no samples {absent}")
    topic = wanted or complete[0]
    there = sorted(instances(topics[topic][0]))
    listed = ", ".join(map(str, there))
    if options.instance is None and len(there) > 1:
        notes.append(
            f"{topic} has the instances {listed}; {there[0]} was read. Choose another with {option('instance')}."
        )
    if len(complete) > 1 and wanted is None:
        notes.append(f"Read from {topic}; {', '.join(complete[1:])} would be read with {option('topic')}.")
    if options.instance not in (None, *there):
        raise InputError(f"{path}: {topic} has no instance {options.instance}: use one of {listed}.")
    return topic, there[0] if options.instance is None else options.instance


def in_order(stream: Stream, notes: list[str]) -> Stream:
    """Sort samples that arrived late by their stamps; the recording refuses a clock that was set back."""
    stamps = stream.stamps
    if stamps.size < 2:
        return stream
    late = np.maximum.accumulate(stamps) - stamps
    if not late.any() or float(late.max()) > LATE_LIMIT_S * stream.per_second:
        return stream
    order = np.argsort(stamps, kind="stable")
    notes.append(f"{stream.name}: {np.count_nonzero(late)} samples that arrived late were put in order.")
    return stream.rows(order)


def join(gyro: Stream, accel: Stream, notes: list[str]) -> Stream:
    """Make one stream of six columns at the gyros' stamps, of two with three columns each and the same clock.

    Raises InputError for streams without time in common, or stamps that do not increase.
    """
    gyro, accel = (_without_repeats(in_order(stream, notes), notes) for stream in (gyro, accel))
    if not (gyro.stamps.size and accel.stamps.size):
        empty = gyro if not gyro.stamps.size else accel
        raise InputError(f"{empty.name} holds no samples: choose another sensor.")
    if gyro.name != accel.name:
        notes.append(f"Gyros from {gyro.name}, accelerometers from {accel.name}.")
    # Counted from one stamp as integers, so that the conversion to seconds is exact for any clock reading.
    zero = gyro.stamps[0]
    seconds = [(stream.stamps - zero) / stream.per_second for stream in (gyro, accel)]
    kept, values = join_streams(seconds[0], seconds[1], accel.values, notes)
    return replace(gyro.rows(kept), values=np.hstack([gyro.values[kept], values]))


def to_imported(stream: Stream, options: ImportOptions, notes: list[str], **more: Any) -> ImportedSamples:
    """Make imported samples of a stream of six columns; ``more`` are further arguments of :func:`samples_in_si`."""
    stream = in_order(stream, notes)
    gyro_unit, accel_unit = more.pop("units", SI_UNITS)
    unit = {10**9: "ns", 10**6: "us", 10**3: "ms"}[stream.per_second]
    return samples_in_si(
        options,
        gyro=stream.values[:, :3],
        accel=stream.values[:, 3:],
        time=stream.stamps,
        stated=StatedUnits(gyro_unit, accel_unit, unit),
        kind=more.pop("kind", "rate"),
        temperature=stream.temperature,
        notes=tuple(notes),
        **more,
    )


def _without_repeats(stream: Stream, notes: list[str]) -> Stream:
    """Drop samples that repeat the one before: interpolation needs stamps that increase."""
    keep = first_of_repeats(stream.stamps, stream.values)
    if keep is None:
        return stream
    notes.append(f"{stream.name}: {(~keep).sum()} repeated samples (same stamp, same readings) dropped.")
    return stream.rows(keep)
