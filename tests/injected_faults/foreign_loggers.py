"""Faults of loggers, buses and sensors in forms other than those of the catalogue.

They were written from the behaviour of real loggers, without knowledge of the checks. Each variant states the faults of
the catalogue that are correct findings for it. Some variants state none: they are harmless, or the catalogue has no
fault for them.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from injected_faults.changes import (
    kept,
    low_passed,
    moved_labels,
    per_sample,
    restamped,
    sign,
    somewhere,
    with_sensor,
)
from injected_faults.injection import Case, variant
from srt.constants import DEG, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.recording.recording import Recording
from srt.types import Array

_G: Final = STANDARD_GRAVITY_M_S2
_BITS: Final = 15
"""Bits of a signed 16-bit word, without the sign bit."""


# --- helpers ---------------------------------------------------------------------------------------------------------


def _sensor(rng: np.random.Generator) -> str:
    return str(rng.choice(["gyro", "accel"]))


def _turning(recording: Recording, rng: np.random.Generator) -> slice:
    """Samples of the rotation of a sequence drawn at random."""
    label = recording.sequences[int(rng.integers(len(recording.sequences)))]
    return recording.window_indices(label.start_static_s[1], label.end_static_s[0])


def _from_here(recording: Recording, rng: np.random.Generator) -> slice:
    """All samples after a sequence drawn at random from the middle half of the test."""
    count = len(recording.sequences)
    label = recording.sequences[int(rng.integers(count // 4, 3 * count // 4))]
    return slice(recording.window_indices(*label.end_static_s).stop, len(recording.time))


# --- clocks and stamps -----------------------------------------------------------------------------------------------


def _clock_factor(kind: str, severity: float, *causes: str) -> None:
    @variant(kind, severity, "times", *causes)
    def clock_factor(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """Stamps and labels run fast or slow by one factor."""
        factor = severity ** sign(rng)
        return restamped(case.recording, lambda time: time * factor)


# An oscillator of another frequency than assumed.
_clock_factor("clock fast", 1.05, "sample_rate")


@variant("clock warming up", 0.02, "of the rate", "clock_drift")
def clock_warming_up(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The frequency of the clock changes linearly during the test."""
    recording, towards = case.recording, sign(rng)
    first, span = recording.time[0], recording.time[-1] - recording.time[0]
    return restamped(recording, lambda time: time + towards * severity * (time - first) ** 2 / (2.0 * span))


@variant("stamps of milliseconds", 8.0, "ms", "stamp_jitter", "time_repeats")
def stamps_of_milliseconds(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger stamps each sample on arrival, with a clock that ticks every few milliseconds."""
    recording, tick = case.recording, 1e-3 * severity
    late = rng.uniform(0.0, tick)
    return replace(recording, time=np.floor((recording.time + late) / tick) * tick)


@variant("stamps by packet", 8.0, "samples", "time_repeats")
def stamps_by_packet(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """All samples of a packet have the time of its arrival as their stamp."""
    size = max(2, round(severity))
    rows = np.arange(len(case.recording.time))
    last = np.minimum((rows + int(rng.integers(size))) // size * size + size - 1, rows[-1])
    return replace(case.recording, time=case.recording.time[last])


@variant("stamps of single precision", 2.0e5, "s since switch-on", "time_repeats", "stamp_jitter")
def stamps_of_single_precision(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Stamps in seconds since switch-on are stored in single precision, which rounds large values coarsely."""
    offset = severity * rng.uniform(1.0, 1.5)
    recording = restamped(case.recording, lambda time: time + offset)
    return replace(recording, time=recording.time.astype(np.float32).astype(float))


@variant("clock set by GPS", 18.0, "s", "gap_in_sequence")
def clock_set_by_gps(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The clock is set forward during a sequence; no sample is lost, and the labels keep the old clock."""
    time = case.recording.time.copy()
    time[somewhere(case.recording, rng, 1).start :] += severity
    return replace(case.recording, time=time)


@variant("counter overflow", 65.536, "s", "time_backwards")
def counter_overflow(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The counter of the time stamps overflows and starts again at zero."""
    start = rng.uniform(0.0, severity)
    return replace(case.recording, time=(case.recording.time + start) % severity)


# Stamps and labels in minutes, or in sixtieths of a second.
_clock_factor("stamps in minutes", 60.0, "time_unit", "sample_rate")


@variant("nominal rate of a chip", 1.04, "times", "sample_rate")
def nominal_rate_of_a_chip(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Stamps are computed from the nominal output rate; the true rate of the chip differs by some per cent."""
    factor = 1.0 / severity if rng.random() < 0.5 else severity
    return restamped(case.recording, lambda time: time * factor)


# --- lost, repeated and exchanged samples ----------------------------------------------------------------------------


@variant("samples dropped, stamps closed up", 40.0, "samples", "samples_lost")
def samples_dropped(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The bus loses single samples in rotations; stamps follow from a count of samples, so they show no gap.

    The stamps after each loss are too early, and the recording ends too early.
    """
    recording = case.changed(schedule={"moves": "recorded"}).recording
    keep = np.ones(len(recording.time), dtype=bool)
    for _ in range(round(severity)):
        part = _turning(recording, rng)
        keep[int(rng.integers(part.start, part.stop))] = False
    # The labels come from the same counter as the stamps: they shift with the samples.
    stamps = recording.time[: int(keep.sum())]
    moved = np.interp(recording.time, recording.time[keep], stamps)
    labels = moved_labels(recording.sequences, lambda at: np.interp(at, recording.time, moved))
    return replace(recording, time=stamps, gyro=recording.gyro[keep], accel=recording.accel[keep], sequences=labels)


@variant("samples dropped with their stamps", 60.0, "samples", "gap_in_sequence")
def samples_dropped_with_stamps(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The bus loses single samples with their stamps, so that the stamps show the gaps."""
    keep = np.ones(len(case.recording.time), dtype=bool)
    for _ in range(round(severity)):
        keep[somewhere(case.recording, rng, 1)] = False
    return kept(case.recording, np.flatnonzero(keep))


@variant(
    "gap bridged by a line",
    0.4,
    "s",
    "samples_lost",
    "wrong_angle",
    "accel_stuck",
    "spikes",
    "noisy_window",
    "samples_interpolated",
)
def gap_bridged(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A tool fills a gap at the beginning or end of a rotation by linear interpolation."""
    recording = case.recording
    part = _turning(recording, rng)
    edge = part.start if rng.random() < 0.5 else part.stop
    half = round(0.5 * severity / recording.nominal_interval_s)
    rows = np.arange(edge - half, edge + half)
    ends = rows[[0, -1]]
    gyro, accel = recording.gyro.copy(), recording.accel.copy()
    for values in (gyro, accel):
        for axis in range(3):
            values[rows, axis] = np.interp(rows, ends, values[ends, axis])
    return replace(recording, gyro=gyro, accel=accel)


@variant("block sent twice", 0.5, "s", "samples_duplicated", "samples_stuck", "samples_lost", "spikes")
def block_sent_twice(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """In a rotation, a block of samples is repeated in place of the following block."""
    recording = case.recording
    part = _turning(recording, rng)
    size = min(max(2, round(severity / recording.nominal_interval_s)), (part.stop - part.start) // 2)
    first = int(rng.integers(part.start, max(part.start + 1, part.stop - 2 * size)))
    gyro, accel = recording.gyro.copy(), recording.accel.copy()
    for values in (gyro, accel):
        values[first + size : first + 2 * size] = values[first : first + size].copy()
    return replace(recording, gyro=gyro, accel=accel)


@variant("last value held at a lost sample", 60.0, "samples", "samples_duplicated", "samples_lost")
def last_value_held(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger repeats the previous sample in place of a lost one."""
    source = np.arange(len(case.recording.time))
    for _ in range(round(severity)):
        row = somewhere(case.recording, rng, 1).start
        source[row] = row - 1
    return replace(case.recording, gyro=case.recording.gyro[source], accel=case.recording.accel[source])


@variant("zeros at lost samples", 8.0, "samples", "spikes", "samples_stuck")
def zeros_at_lost_samples(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger writes zeros in all channels in place of a lost sample."""
    gyro, accel = case.recording.gyro.copy(), case.recording.accel.copy()
    for _ in range(max(1, round(severity))):
        row = somewhere(case.recording, rng, 1)
        gyro[row], accel[row] = 0.0, 0.0
    return replace(case.recording, gyro=gyro, accel=accel)


@variant("-9999 at lost samples", 4.0, "samples", "spikes")
def sentinels_at_lost_samples(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger writes an impossible number in place of the readings of a lost sample, in one triad."""
    sensor = _sensor(rng)
    values = getattr(case.recording, sensor).copy()
    for _ in range(max(1, round(severity))):
        values[somewhere(case.recording, rng, 1)] = -9999.0
    return with_sensor(case.recording, sensor, values)


@variant("neighbouring samples exchanged", 40.0, "samples", "spikes")
def neighbours_exchanged(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Two neighbouring samples arrive in the wrong order; the stamps follow from the count of samples."""
    order = np.arange(len(case.recording.time))
    for _ in range(round(severity)):
        row = somewhere(case.recording, rng, 2).start
        order[[row, row + 1]] = order[[row + 1, row]]
    return replace(case.recording, gyro=case.recording.gyro[order], accel=case.recording.accel[order])


@variant("every second increment dropped", 2.0, "-", "increments_thinned", "samples_lost")
def increments_decimated(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One of ``severity`` increments is kept instead of their sum: integrals are too small by this factor."""
    recording = case.recording
    if recording.kind == "rate":
        step = recording.nominal_interval_s
        recording = replace(recording, kind="increment", gyro=recording.gyro * step, accel=recording.accel * step)
    step = max(2, round(severity))
    return kept(recording, np.arange(int(rng.integers(step)), len(recording.time), step))


# --- words -----------------------------------------------------------------------------------------------------------


def _words(
    kind: str, severity: float, unit: str, *causes: str
) -> Callable[[Callable[[Case, Array, float, np.random.Generator], Array]], None]:
    """Register a change of the words of one triad, whole numbers of which the largest takes nine tenths of 16 bits."""

    def register(change: Callable[[Case, Array, float, np.random.Generator], Array]) -> None:
        @variant(kind, severity, unit, *causes)
        def apply(case: Case, severity: float, rng: np.random.Generator) -> Recording:
            sensor = _sensor(rng)
            values = getattr(case.recording, sensor)
            lsb = float(np.abs(values).max()) / (0.9 * 2.0**_BITS)
            return with_sensor(case.recording, sensor, lsb * change(case, np.round(values / lsb), severity, rng))

    return register


@_words("unsigned words", 1.0, "", "gyro_wrapped", "accel_wrapped")
def unsigned_words(case: Case, words: Array, severity: float, rng: np.random.Generator) -> Array:
    """Signed words of 16 bits are read as unsigned ones."""
    return words % 2.0 ** (_BITS + 1)


@_words("sign bit and magnitude", 1.0, "", "gyro_wrapped", "accel_wrapped")
def sign_and_magnitude(case: Case, words: Array, severity: float, rng: np.random.Generator) -> Array:
    """Words in two's complement are read as words of sign and magnitude."""
    return np.where(words < 0.0, -(2.0**_BITS + words), words)


@_words("bit flipped in transmission", 3.0, "samples", "spikes")
def bit_flipped(case: Case, words: Array, severity: float, rng: np.random.Generator) -> Array:
    """One of the five highest bits of a word is inverted, in single readings."""
    for _ in range(max(1, round(severity))):
        at = somewhere(case.recording, rng, 1).start, int(rng.integers(3))
        words[at] = (int(words[at]) + 2**_BITS ^ 2 ** int(rng.integers(_BITS - 5, _BITS))) - 2**_BITS
    return words


@_words("bit of a converter stuck", 10.0, "bit", "bit_stuck")
def bit_stuck(case: Case, words: Array, severity: float, rng: np.random.Generator) -> Array:
    """One bit of the converter of one axis is always set."""
    axis = int(rng.integers(3))
    words[:, axis] = (words[:, axis].astype(int) + 2**_BITS | 2 ** round(severity)) - 2**_BITS
    return words


@_words("low bits lost", 64.0, "times", "gyro_noise", "accel_noise")
def low_bits_lost(case: Case, words: Array, severity: float, rng: np.random.Generator) -> Array:
    """The low bits of the words are cut off without rounding, to fit a shorter message."""
    return severity * np.floor(words / severity)


@variant("one axis of another range", 2.0, "-", "gyro_lsb", "accel_lsb")
def one_axis_of_another_range(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One axis has another measuring range than the other two."""
    sensor = _sensor(rng)
    values = getattr(case.recording, sensor).copy()
    values[:, int(rng.integers(3))] *= severity ** sign(rng)
    return with_sensor(case.recording, sensor, values)


@variant("range switched in the test", 2.0, "times", "gyro_lsb", "accel_lsb", "units_joined")
def range_switched(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """From one sequence on, the unit uses another measuring range, but the logger keeps the old count value."""
    sensor = _sensor(rng)
    values = getattr(case.recording, sensor).copy()
    values[_from_here(case.recording, rng)] *= severity ** sign(rng)
    return with_sensor(case.recording, sensor, values)


@variant("one axis in degrees", 1.0, "", "gyro_lsb", "gyro_degrees")
def one_axis_in_degrees(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One gyro column is in degrees, and the others are in radians."""
    gyro = case.recording.gyro.copy()
    gyro[:, int(rng.integers(3))] /= DEG
    return replace(case.recording, gyro=gyro)


# --- ranges ----------------------------------------------------------------------------------------------------------


@variant("accelerometers limited below 1 g", 0.004, "of gravity", "accel_clipped")
def limited_below_gravity(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The accelerometers saturate just below 1 g."""
    limit = (1.0 - severity * rng.uniform(0.9, 1.1)) * _G * per_sample(case.recording)
    return replace(case.recording, accel=np.clip(case.recording.accel, -limit, limit))


@variant("one accelerometer limited", 0.004, "of gravity", "accel_clipped")
def one_accelerometer_limited(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One accelerometer saturates just below 1 g, for one sign only."""
    limit, axis = (1.0 - severity * rng.uniform(0.9, 1.1)) * _G * per_sample(case.recording), int(rng.integers(3))
    accel = case.recording.accel.copy()
    accel[:, axis] = np.minimum(accel[:, axis], limit) if rng.random() < 0.5 else np.maximum(accel[:, axis], -limit)
    return replace(case.recording, accel=accel)


@variant("negative readings cut off", 1.0, "", "gyro_one_polarity", "accel_one_polarity")
def negative_cut_off(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The converter of one axis has no negative values: it reads zero instead."""
    sensor = _sensor(rng)
    values, axis = getattr(case.recording, sensor).copy(), int(rng.integers(3))
    values[:, axis] = np.maximum(values[:, axis], 0.0)
    return with_sensor(case.recording, sensor, values)


@variant("gyros held below the rate of the table", 0.05, "of the rate", "gyro_clipped")
def gyros_held(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The gyros saturate just below the rate of the table, far below the stated range."""
    limit = (1.0 - severity * rng.uniform(0.9, 1.1)) * per_sample(case.recording)
    return replace(case.recording, gyro=np.clip(case.recording.gyro, -limit, limit))


# --- firmware --------------------------------------------------------------------------------------------------------


@variant("gyros high-passed", 30.0, "s", "gyro_high_passed")
def gyros_high_passed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The firmware tracks the offset of the gyros with one time constant, also during rotations, and subtracts it."""
    gyro, time_s = case.recording.gyro, severity * rng.uniform(0.8, 1.2)
    return replace(case.recording, gyro=gyro - low_passed(gyro, case.recording.nominal_interval_s, time_s))


@variant("earth rate removed", 1.0, "", "earth_rate_absent")
def earth_rate_removed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The firmware subtracts the mean gyro reading of each stationary window, from that window until the next one."""
    recording = case.recording
    gyro, before = recording.gyro.copy(), np.zeros(3)
    for label in recording.sequences:
        for span in (label.start_static_s, label.end_static_s):
            rows = recording.window_indices(*span)
            mean = recording.gyro[rows].mean(axis=0)
            gyro[rows.start :] += severity * before
            gyro[rows.start :] -= severity * mean
            before = mean
    del rng
    return replace(recording, gyro=gyro)


@variant("gravity removed", 1.0, "", "gravity_removed")
def gravity_removed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit outputs linear acceleration: it subtracts the low-pass filtered specific force as gravity."""
    accel, time_s = case.recording.accel, rng.uniform(0.2, 0.5)
    return replace(case.recording, accel=accel - low_passed(accel, case.recording.nominal_interval_s, time_s))


@variant("dead band of accelerometers", 2000.0, "ug", "accel_dead_band")
def accel_dead_band(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Accelerometer readings below a threshold are output as zero."""
    limit = severity * rng.uniform(1.0, 1.5) * MICRO_G * per_sample(case.recording)
    accel = np.where(np.abs(case.recording.accel) < limit, 0.0, case.recording.accel)
    return replace(case.recording, accel=accel)


@variant("gyros low-passed", 10.0, "ms", "sensor_time_offset")
def gyros_low_passed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The gyros have a low-pass filter, and the accelerometers have none."""
    gyro, time_s = case.recording.gyro, 1e-3 * severity * rng.uniform(0.9, 1.1)
    return replace(case.recording, gyro=low_passed(gyro, case.recording.nominal_interval_s, time_s))


@variant("offset subtracted twice", 0.02, "rad/s")
def offset_subtracted_twice(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger subtracts an offset that the unit has already removed: a large constant bias, which is no fault."""
    offset = severity * per_sample(case.recording) * rng.uniform(-1.0, 1.0, 3)
    return replace(case.recording, gyro=case.recording.gyro - offset)


# --- sensors that change ---------------------------------------------------------------------------------------------


def _bias_steps(kind: str, sensor: str, severity: float, unit: str, si: float, *causes: str) -> None:
    @variant(kind, severity, unit, *causes)
    def bias_steps(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """The bias of one sensor changes between two sequences, as after a knock."""
        values = getattr(case.recording, sensor).copy()
        at = _from_here(case.recording, rng), int(rng.integers(3))
        values[at] += sign(rng) * severity * si * per_sample(case.recording)
        return with_sensor(case.recording, sensor, values)


_bias_steps("accelerometer bias steps", "accel", 5000.0, "ug", MICRO_G, "accel_bias_drift", "units_joined")
_bias_steps("gyro bias steps", "gyro", 100.0, "deg/h", DEG / 3600.0, "gyro_bias_drift", "units_joined")


def _scale_drifts(kind: str, sensor: str, *causes: str) -> None:
    @variant(kind, 2000.0, "ppm", *causes)
    def scale_drifts(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """The scale factors of one triad drift while the unit warms up."""
        time = case.recording.time
        share = (time - time[0]) / (time[-1] - time[0])
        values = getattr(case.recording, sensor) * (1.0 + sign(rng) * 1e-6 * severity * share[:, np.newaxis])
        return with_sensor(case.recording, sensor, values)


_scale_drifts("accelerometer scale drifts", "accel", "accel_bias_drift", "temperature_drift", "units_joined")
_scale_drifts("gyro scale drifts", "gyro", "gyro_scale_drift", "gyro_bias_drift", "temperature_drift", "units_joined")
