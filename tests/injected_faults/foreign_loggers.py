"""Faults of loggers, buses and sensors in forms other than those of the catalogue.

They were written from the behaviour of real loggers, without knowledge of the checks. Each variant states the faults of
the catalogue that are correct findings for it. Some variants state none: they are harmless, or the catalogue has no
fault for them.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.signal import lfilter

from injected_faults.injection import Case, variant
from injected_faults.logger import restamped, somewhere
from srt.constants import DEG, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.recording.recording import Recording, SequenceLabel
from srt.types import Array, Indices

_G: Final = STANDARD_GRAVITY_M_S2
_BITS: Final = 15
"""Bits of a signed 16-bit word, without the sign bit."""


# --- helpers ---------------------------------------------------------------------------------------------------------


def _unit(recording: Recording) -> float:
    """Factor from rates to the stored values: 1 for rates, the interval in s for increments."""
    return recording.nominal_interval_s if recording.kind == "increment" else 1.0


def _changed(recording: Recording, sensor: str, values: Array) -> Recording:
    return replace(recording, gyro=values) if sensor == "gyro" else replace(recording, accel=values)


def _sensor(rng: np.random.Generator) -> str:
    return str(rng.choice(["gyro", "accel"]))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _kept(recording: Recording, rows: Indices) -> Recording:
    """Recording with only some of its samples, which keep their time stamps."""
    return replace(recording, time=recording.time[rows], gyro=recording.gyro[rows], accel=recording.accel[rows])


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


@variant("clock fast", 1.05, "times", "sample_rate")
def clock_fast(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The clock of the logger runs fast or slow, because its oscillator has another frequency than assumed."""
    factor = severity ** _sign(rng)
    return restamped(case.recording, lambda time: time * factor)


@variant("clock warming up", 0.02, "of the rate", "clock_drift")
def clock_warming_up(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The frequency of the clock changes linearly during the test."""
    recording, sign = case.recording, _sign(rng)
    first, span = recording.time[0], recording.time[-1] - recording.time[0]
    return restamped(recording, lambda time: time + sign * severity * (time - first) ** 2 / (2.0 * span))


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


@variant("stamps in minutes", 60.0, "times", "time_unit", "sample_rate")
def stamps_in_minutes(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Stamps and labels in minutes, or in sixtieths of a second."""
    factor = severity ** _sign(rng)
    return restamped(case.recording, lambda time: factor * time)


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

    def label_moved(label: SequenceLabel) -> SequenceLabel:
        first, second = (np.interp(at, recording.time, moved) for at in (label.start_static_s, label.end_static_s))
        return replace(label, start_static_s=(first[0], first[1]), end_static_s=(second[0], second[1]))

    labels = tuple(label_moved(label) for label in recording.sequences)
    return replace(recording, time=stamps, gyro=recording.gyro[keep], accel=recording.accel[keep], sequences=labels)


@variant("samples dropped with their stamps", 60.0, "samples", "gap_in_sequence")
def samples_dropped_with_stamps(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The bus loses single samples with their stamps, so that the stamps show the gaps."""
    keep = np.ones(len(case.recording.time), dtype=bool)
    for _ in range(round(severity)):
        keep[somewhere(case.recording, rng, 1)] = False
    return _kept(case.recording, np.flatnonzero(keep))


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
    return _changed(case.recording, sensor, values)


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
    return _kept(recording, np.arange(int(rng.integers(step)), len(recording.time), step))


# --- words -----------------------------------------------------------------------------------------------------------


def _word(recording: Recording, sensor: str, counts: float) -> tuple[Array, float]:
    """Readings as whole numbers, scaled so that the largest is ``counts``, and the value of one count."""
    values = getattr(recording, sensor)
    lsb = float(np.abs(values).max()) / counts
    return np.round(values / lsb), lsb


@variant("unsigned words", 1.0, "", "gyro_wrapped", "accel_wrapped")
def unsigned_words(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Signed words of 16 bits are read as unsigned ones."""
    sensor = _sensor(rng)
    words, lsb = _word(case.recording, sensor, 0.9 * 2.0**_BITS)
    return _changed(case.recording, sensor, lsb * (words % 2.0 ** (_BITS + 1)))


@variant("sign bit and magnitude", 1.0, "", "gyro_wrapped", "accel_wrapped")
def sign_and_magnitude(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Words in two's complement are read as words of sign and magnitude."""
    sensor = _sensor(rng)
    words, lsb = _word(case.recording, sensor, 0.9 * 2.0**_BITS)
    return _changed(case.recording, sensor, lsb * np.where(words < 0.0, -(2.0**_BITS + words), words))


@variant("bit flipped in transmission", 3.0, "samples", "spikes")
def bit_flipped(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One of the five highest bits of a word is inverted, in single readings."""
    sensor = _sensor(rng)
    words, lsb = _word(case.recording, sensor, 0.9 * 2.0**_BITS)
    for _ in range(max(1, round(severity))):
        at = somewhere(case.recording, rng, 1).start, int(rng.integers(3))
        words[at] = (int(words[at]) + 2**_BITS ^ 2 ** int(rng.integers(_BITS - 5, _BITS))) - 2**_BITS
    return _changed(case.recording, sensor, lsb * words)


@variant("bit of a converter stuck", 10.0, "bit", "bit_stuck")
def bit_stuck(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One bit of the converter of one axis is always set."""
    sensor = _sensor(rng)
    words, lsb = _word(case.recording, sensor, 0.9 * 2.0**_BITS)
    axis = int(rng.integers(3))
    words[:, axis] = (words[:, axis].astype(int) + 2**_BITS | 2 ** round(severity)) - 2**_BITS
    return _changed(case.recording, sensor, lsb * words)


@variant("low bits lost", 64.0, "times", "gyro_noise", "accel_noise")
def low_bits_lost(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The low bits of the words are cut off without rounding, to fit a shorter message."""
    sensor = _sensor(rng)
    words, lsb = _word(case.recording, sensor, 0.9 * 2.0**_BITS)
    return _changed(case.recording, sensor, lsb * severity * np.floor(words / severity))


@variant("one axis of another range", 2.0, "-", "gyro_lsb", "accel_lsb")
def one_axis_of_another_range(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One axis has another measuring range than the other two."""
    sensor = _sensor(rng)
    values = getattr(case.recording, sensor).copy()
    values[:, int(rng.integers(3))] *= severity ** _sign(rng)
    return _changed(case.recording, sensor, values)


@variant("range switched in the test", 2.0, "times", "gyro_lsb", "accel_lsb", "units_joined")
def range_switched(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """From one sequence on, the unit uses another measuring range, but the logger keeps the old count value."""
    sensor = _sensor(rng)
    values = getattr(case.recording, sensor).copy()
    values[_from_here(case.recording, rng)] *= severity ** _sign(rng)
    return _changed(case.recording, sensor, values)


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
    limit = (1.0 - severity * rng.uniform(0.9, 1.1)) * _G * _unit(case.recording)
    return replace(case.recording, accel=np.clip(case.recording.accel, -limit, limit))


@variant("one accelerometer limited", 0.004, "of gravity", "accel_clipped")
def one_accelerometer_limited(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One accelerometer saturates just below 1 g, for one sign only."""
    limit, axis = (1.0 - severity * rng.uniform(0.9, 1.1)) * _G * _unit(case.recording), int(rng.integers(3))
    accel = case.recording.accel.copy()
    accel[:, axis] = np.minimum(accel[:, axis], limit) if rng.random() < 0.5 else np.maximum(accel[:, axis], -limit)
    return replace(case.recording, accel=accel)


@variant("negative readings cut off", 1.0, "", "gyro_one_polarity", "accel_one_polarity")
def negative_cut_off(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The converter of one axis has no negative values: it reads zero instead."""
    sensor = _sensor(rng)
    values, axis = getattr(case.recording, sensor).copy(), int(rng.integers(3))
    values[:, axis] = np.maximum(values[:, axis], 0.0)
    return _changed(case.recording, sensor, values)


@variant("gyros held below the rate of the table", 0.05, "of the rate", "gyro_clipped")
def gyros_held(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The gyros saturate just below the rate of the table, far below the stated range."""
    limit = (1.0 - severity * rng.uniform(0.9, 1.1)) * _unit(case.recording)
    return replace(case.recording, gyro=np.clip(case.recording.gyro, -limit, limit))


# --- firmware --------------------------------------------------------------------------------------------------------


@variant("gyros high-passed", 30.0, "s", "gyro_high_passed")
def gyros_high_passed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The firmware tracks the offset of the gyros with one time constant, also during rotations, and subtracts it."""
    recording = case.recording
    decay = math.exp(-recording.nominal_interval_s / (severity * rng.uniform(0.8, 1.2)))
    slow = lfilter([1.0 - decay], [1.0, -decay], recording.gyro, axis=0, zi=decay * recording.gyro[:1])[0]
    return replace(recording, gyro=recording.gyro - slow)


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
    recording = case.recording
    decay = math.exp(-recording.nominal_interval_s / rng.uniform(0.2, 0.5))
    slow = lfilter([1.0 - decay], [1.0, -decay], recording.accel, axis=0, zi=decay * recording.accel[:1])[0]
    return replace(recording, accel=recording.accel - slow)


@variant("dead band of accelerometers", 2000.0, "ug", "accel_dead_band")
def accel_dead_band(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Accelerometer readings below a threshold are output as zero."""
    limit = severity * rng.uniform(1.0, 1.5) * MICRO_G * _unit(case.recording)
    accel = np.where(np.abs(case.recording.accel) < limit, 0.0, case.recording.accel)
    return replace(case.recording, accel=accel)


@variant("gyros low-passed", 10.0, "ms", "sensor_time_offset")
def gyros_low_passed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The gyros have a low-pass filter, and the accelerometers have none."""
    recording = case.recording
    decay = math.exp(-recording.nominal_interval_s / (1e-3 * severity * rng.uniform(0.9, 1.1)))
    gyro = lfilter([1.0 - decay], [1.0, -decay], recording.gyro, axis=0, zi=decay * recording.gyro[:1])[0]
    return replace(recording, gyro=gyro)


@variant("offset subtracted twice", 0.02, "rad/s")
def offset_subtracted_twice(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger subtracts an offset that the unit has already removed: a large constant bias, which is no fault."""
    offset = severity * _unit(case.recording) * rng.uniform(-1.0, 1.0, 3)
    return replace(case.recording, gyro=case.recording.gyro - offset)


# --- sensors that change ---------------------------------------------------------------------------------------------


@variant("accelerometer bias steps", 5000.0, "ug", "accel_bias_drift", "units_joined")
def accel_bias_steps(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The bias of one accelerometer changes between two sequences, as after a knock."""
    accel = case.recording.accel.copy()
    accel[_from_here(case.recording, rng), int(rng.integers(3))] += (
        _sign(rng) * severity * MICRO_G * _unit(case.recording)
    )
    return replace(case.recording, accel=accel)


@variant("gyro bias steps", 100.0, "deg/h", "gyro_bias_drift", "units_joined")
def gyro_bias_steps(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The bias of one gyro changes between two sequences."""
    gyro = case.recording.gyro.copy()
    gyro[_from_here(case.recording, rng), int(rng.integers(3))] += (
        _sign(rng) * severity * DEG / 3600.0 * _unit(case.recording)
    )
    return replace(case.recording, gyro=gyro)


@variant("accelerometer scale drifts", 2000.0, "ppm", "accel_bias_drift", "temperature_drift", "units_joined")
def accel_scale_drifts(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The scale factors of the accelerometers drift while the unit warms up."""
    return _scale_drift(case, "accel", severity, rng)


@variant("gyro scale drifts", 2000.0, "ppm", "gyro_scale_drift", "gyro_bias_drift", "temperature_drift", "units_joined")
def gyro_scale_drifts(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The scale factors of the gyros drift while the unit warms up."""
    return _scale_drift(case, "gyro", severity, rng)


def _scale_drift(case: Case, sensor: str, severity: float, rng: np.random.Generator) -> Recording:
    time = case.recording.time
    share = (time - time[0]) / (time[-1] - time[0])
    values = getattr(case.recording, sensor) * (1.0 + _sign(rng) * 1e-6 * severity * share[:, np.newaxis])
    return _changed(case.recording, sensor, values)
