"""Faults of a logger: time stamps, columns, stuck or spurious readings, and saturation.

Faults of units and axes are in ``injected_faults.units_and_axes``.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

import injected_faults.firmware
import injected_faults.units_and_axes  # noqa: F401 - these modules register their injections on import
from injected_faults.changes import kept, per_sample, restamped, sign, somewhere, with_sensor
from injected_faults.injection import GRADES, Case, injection
from sims.physics.imu import read_out
from srt.recording.recording import Recording
from srt.types import Array

# --- helpers ---------------------------------------------------------------------------------------------------------


def _samples(recording: Recording, seconds: float) -> int:
    return int(seconds / recording.nominal_interval_s + 1e-6)


# --- faults that the construction of a recording detects -------------------------------------------------------------


@injection("not_finite", 1.0, "samples")
def not_finite(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Readings are NaN, as after a failed conversion of text, or infinite, as after a division by zero."""
    recording = case.recording
    sensor = str(rng.choice(["gyro", "accel"]))
    values = getattr(recording, sensor).copy()
    where = rng.integers(len(values), size=max(1, round(severity)))
    values[where, rng.integers(3)] = rng.choice([math.nan, math.inf, -math.inf])
    return with_sensor(recording, sensor, values)


@injection("time_backwards", 1.0, "s")
def time_backwards(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The clock is set back by ``severity`` while the logger runs."""
    recording = case.recording
    time = recording.time.copy()
    time[somewhere(recording, rng, 1).start :] -= severity
    return replace(recording, time=time)


@injection("time_repeats", 1.0, "samples")
def time_repeats(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Some consecutive samples have the same time stamp."""
    recording = case.recording
    time = recording.time.copy()
    rows = somewhere(recording, rng, max(1, round(severity)))
    time[rows] = time[rows.start - 1]
    return replace(recording, time=time)


@injection("rate_contradicts_stamps", 2.0, "times", also=("sample_rate",))
def rate_contradicts_stamps(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The stated sample rate is wrong by the factor ``severity`` or its inverse."""
    recording = case.recording
    return replace(recording, sample_rate_hz=severity ** sign(rng) / recording.nominal_interval_s)


# --- time stamps -----------------------------------------------------------------------------------------------------


@injection("time_unit", 1e3, "times", also=("sample_rate",))
def time_unit(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit of the stamps is ``severity`` times smaller or larger than declared; the labels have the same unit."""
    factor = severity ** sign(rng)
    return restamped(case.recording, lambda time: factor * time)


@injection("stamp_jitter", 0.1, "intervals (rms)")
def stamp_jitter(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The time stamps, set by the host, have random errors."""
    recording = case.recording
    late = np.clip(severity * rng.standard_normal(len(recording.time)), -0.49, 0.49)
    return replace(recording, time=recording.time + recording.nominal_interval_s * late)


@injection("clock_drift", 0.02, "of the interval")
def clock_drift(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """After switch-on, the clock of the logger approaches its final rate exponentially."""
    recording, towards = case.recording, sign(rng)
    first, span = recording.time[0], recording.time[-1] - recording.time[0]
    slow = span * float(rng.uniform(0.3, 1.0))
    # Scaled so that the relative change of the interval from the first sample to the last is the severity.
    size = towards * severity / -math.expm1(-span / slow)
    return restamped(recording, lambda time: time + size * slow * np.expm1(-(time - first) / slow))


@injection("gap_in_sequence", 0.2, "s")
def gap_in_sequence(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Consecutive samples are missing, including their time stamps."""
    recording = case.recording
    keep = np.ones(len(recording.time), dtype=bool)
    keep[somewhere(recording, rng, _samples(recording, severity))] = False
    return kept(recording, np.flatnonzero(keep))


# --- channels --------------------------------------------------------------------------------------------------------


def _dead(sensor: str) -> None:
    @injection(f"{sensor}_channel_dead", 1.0, "columns")
    def dead(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """Some columns are constant: zero, or the value before a disconnection."""
        recording = case.recording
        values = getattr(recording, sensor).copy()
        for axis in rng.choice(3, max(1, min(3, round(severity))), replace=False):
            values[:, axis] = values[0, axis] if rng.random() < 0.5 else 0.0
        return with_sensor(recording, sensor, values)


_dead("gyro")
_dead("accel")


@injection("columns_repeat", 1.0, "")
def columns_repeat(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The mapping of the columns names one column twice, in one triad or in both."""
    recording = case.recording
    columns = np.hstack([recording.gyro, recording.accel])
    source, target = rng.choice(6, 2, replace=False)
    columns[:, target] = columns[:, source]
    return replace(recording, gyro=columns[:, :3], accel=columns[:, 3:])


@injection("sensors_exchanged", 1.0, "")
def sensors_exchanged(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Gyro and accelerometer columns are exchanged."""
    recording = case.recording
    return replace(recording, gyro=recording.accel, accel=recording.gyro)


def _stuck(fault: str, sensors: tuple[str, ...], severity: float | dict[str, float]) -> None:
    @injection(fault, severity, "s")
    def stuck(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """Readings repeat their last value for a time, and then continue normally."""
        recording = case.recording
        rows = somewhere(recording, rng, _samples(recording, severity))
        for sensor in sensors:
            values = getattr(recording, sensor).copy()
            values[rows] = values[rows.start - 1]
            recording = with_sensor(recording, sensor, values)
        return recording


_stuck("samples_stuck", ("gyro", "accel"), 0.5)
# Laser gyros output few pulses at rest and evenly spaced pulses in a rotation: equal consecutive readings are normal.
_stuck("gyro_stuck", ("gyro",), dict(zip(GRADES, (2.0, 0.5, 0.5, 0.5), strict=True)))
_stuck("accel_stuck", ("accel",), 0.5)


_REPEATING_PULSES: Final = (
    "With the pulses of laser gyros, one of fifty samples repeats the previous one in all six channels by chance. "
    "Duplicated samples are therefore found only in rotations, as spikes or as an attitude error."
)


@injection("samples_duplicated", 24.0, "samples", unseen={GRADES[0]: _REPEATING_PULSES})
def samples_duplicated(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger writes samples twice, either in place of the next sample or as an additional sample.

    An additional sample delays all later stamps by one interval.
    """
    recording, dt = case.recording, case.recording.nominal_interval_s
    rows = np.array([somewhere(recording, rng, 1).start for _ in range(max(1, round(severity)))])
    if rng.random() < 0.5:
        source = np.arange(len(recording.time))
        source[rows] -= 1
        return replace(recording, gyro=recording.gyro[source], accel=recording.accel[source])
    rows = np.unique(rows)
    late = np.arange(len(rows) + 1) * dt

    def clock(time: Array) -> Array:
        moved: Array = time + late[np.searchsorted(recording.time[rows], time - 0.5 * dt)]
        return moved

    out = restamped(recording, clock)
    source = np.sort(np.concatenate([np.arange(len(recording.time)), rows]))
    stamps = out.time[source]
    again = np.flatnonzero(np.diff(source) == 0) + 1
    stamps[again] += dt
    return replace(out, time=stamps, gyro=recording.gyro[source], accel=recording.accel[source])


def _axis_stuck(fault: str, sensor: str, severity: dict[str, float], unseen: dict[str, str]) -> None:
    @injection(fault, severity, "s", unseen=unseen)
    def axis_stuck(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """One axis repeats its last reading for a time during a rotation, and then continues normally."""
        recording, axis = case.recording, int(rng.integers(3))
        label = recording.sequences[int(rng.integers(len(recording.sequences)))]
        turning = recording.window_indices(label.start_static_s[1], label.end_static_s[0])
        count = min(_samples(recording, severity), (turning.stop - turning.start) // 2)
        first = int(rng.integers(turning.start, turning.stop - count))
        values = getattr(recording, sensor).copy()
        values[first : first + count, axis] = values[first - 1, axis]
        return with_sensor(recording, sensor, values)


_PULSES: Final = (
    "The pulse count of a laser gyro repeats for seconds while its axis is at rest or rotates steadily. Most freezes "
    "of one axis cannot be distinguished from this, and neither can the rotation error that they cause."
)
_axis_stuck("gyro_axis_stuck", "gyro", dict.fromkeys(GRADES[1:], 0.5), {GRADES[0]: _PULSES})
_axis_stuck("accel_axis_stuck", "accel", dict(zip(GRADES, (2.0, 0.5, 0.5, 0.5), strict=True)), {})


def _wrapped(fault: str, sensor: str, share: float) -> None:
    @injection(fault, share, "of the largest reading")
    def wrapped(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """One triad is stored in signed words that are too short for its largest readings, which wrap around."""
        values = getattr(case.recording, sensor)
        half = severity * float(np.abs(values).max()) * rng.uniform(0.95, 1.05)
        return with_sensor(case.recording, sensor, (values + half) % (2.0 * half) - half)


_wrapped("gyro_wrapped", "gyro", 0.6)
_wrapped("accel_wrapped", "accel", 0.7)


@injection("gyro_dead_band", dict(zip(GRADES, (5e-4, 1e-3, 5e-3, 0.05), strict=True)), "rad/s")
def gyro_dead_band(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Gyro readings below a threshold are output as zero."""
    recording = case.recording
    small = np.abs(recording.gyro) < severity * rng.uniform(1.0, 1.5) * per_sample(recording)
    return replace(recording, gyro=np.where(small, 0.0, recording.gyro))


@injection("spikes", 0.05, "of the range")
def spikes(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One to three readings of a channel have a transmission error of ``severity`` times the range of the sensor.

    Those of the accelerometers are at rest: readings in rotations enter no result.
    """
    recording, imu = case.recording, case.simulation.imu
    sensor = str(rng.choice(["gyro", "accel"]))
    limit = imu.gyro_range if sensor == "gyro" else imu.accel_range
    size = severity * limit * per_sample(recording)
    values, axis = getattr(recording, sensor).copy(), int(rng.integers(3))
    for _ in range(int(rng.integers(1, 4))):
        values[somewhere(recording, rng, 1, at_rest=sensor == "accel"), axis] += size * sign(rng)
    return with_sensor(recording, sensor, values)


# --- ranges ----------------------------------------------------------------------------------------------------------


@injection("gyro_clipped", 1.2, "times")
def gyro_clipped(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The table rotates at ``severity`` times the range of the gyros, which saturate."""
    simulation = case.simulation
    schedule = simulation.scenario.schedule
    assert schedule is not None
    limited = replace(simulation.imu, gyro_range=schedule.rate_rad_s / severity)
    return read_out(simulation.motion, simulation.truth, limited, rng, kind=case.recording.kind)


@injection("accel_clipped", 1.5, "times")
def accel_clipped(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A shock along one axis: a half sine of 60 ms, with a peak of ``severity`` times the accelerometers' range."""
    simulation = case.simulation
    motion, limit = simulation.motion, simulation.imu.accel_range
    rows = somewhere(case.recording, rng, _samples(case.recording, 0.06))
    phase = np.pi * (np.arange(rows.stop - rows.start) + 0.5) / (rows.stop - rows.start)
    velocity = motion.velocity.copy()
    velocity[rows, rng.integers(3)] += sign(rng) * severity * limit * motion.interval * np.sin(phase)
    velocity_abs = np.maximum(motion.velocity_abs, np.abs(velocity))
    shaken = replace(motion, velocity=velocity, velocity_abs=velocity_abs)
    return read_out(shaken, simulation.truth, simulation.imu, rng, kind=case.recording.kind)


@injection("samples_interpolated", 0.4, "s")
def samples_interpolated(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A tool fills a gap in a sequence by linear interpolation between the samples before and after it."""
    recording = case.recording
    rows = somewhere(recording, rng, round(severity / recording.nominal_interval_s))
    gyro, accel = recording.gyro.copy(), recording.accel.copy()
    for values in (gyro, accel):
        before, after = values[rows.start - 1].copy(), values[rows.stop].copy()
        share = (np.arange(rows.start, rows.stop) - rows.start + 1.0) / (rows.stop - rows.start + 1.0)
        values[rows] = before + share[:, np.newaxis] * (after - before)
    return replace(recording, gyro=gyro, accel=accel)
