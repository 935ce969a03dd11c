"""Faults of firmware and wires: high-pass filters, gravity removed, dead bands, truncation, stuck bits, lost inputs."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from injected_faults.changes import low_passed, per_sample, sign, with_sensor
from injected_faults.injection import GRADES, Case, injection, variant
from srt.constants import MICRO_G
from srt.recording.recording import Recording
from srt.types import Array


@injection("gyro_high_passed", 20.0, "s")
def gyro_high_passed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The firmware tracks the offset of the gyros and subtracts it: a high-pass filter with one time constant."""
    recording = case.recording
    time_s = severity * float(rng.uniform(0.8, 1.2))
    return replace(recording, gyro=recording.gyro - low_passed(recording.gyro, recording.nominal_interval_s, time_s))


@injection("gravity_removed", 1.0, "")
def gravity_removed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit subtracts the low-pass filtered specific force as an estimate of gravity."""
    recording = case.recording
    time_s = float(rng.uniform(0.2, 1.0))
    return replace(recording, accel=recording.accel - low_passed(recording.accel, recording.nominal_interval_s, time_s))


def _one_polarity(fault: str, sensor: str) -> None:
    @injection(fault, 1.0, "")
    def one_polarity(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """One axis reads zero for all values of one sign."""
        values, axis = getattr(case.recording, sensor).copy(), int(rng.integers(3))
        one = sign(rng)
        values[:, axis] = one * np.maximum(one * values[:, axis], 0.0)
        return with_sensor(case.recording, sensor, values)


_one_polarity("gyro_one_polarity", "gyro")
_one_polarity("accel_one_polarity", "accel")


@injection("accel_dead_band", dict(zip(GRADES, (2000.0, 2000.0, 8000.0, 16000.0), strict=True)), "ug")
def accel_dead_band(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The readings of one accelerometer below a threshold are output as zero."""
    recording, axis = case.recording, int(rng.integers(3))
    accel = recording.accel.copy()
    accel[np.abs(accel[:, axis]) < severity * rng.uniform(1.0, 1.5) * MICRO_G * per_sample(recording), axis] = 0.0
    return replace(recording, accel=accel)


_COUNTED: Final = "Increments are counts of pulses, whose remainder the next count contains: they are not truncated."


_FAR_FROM_ZERO: Final = (
    "The biases are many times the noise: a channel that never reads zero at rest does not show it, and the other "
    "errors of the sensor take up half a step by the sign."
)


def _truncated(fault: str, sensor: str) -> None:
    @injection(fault, 0.5, "of the noise", unseen=dict.fromkeys(GRADES[:2], _COUNTED) | {GRADES[3]: _FAR_FROM_ZERO})
    def truncated(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """The readings of one triad are converted to integers toward zero, in steps of a share of their noise."""
        recording = case.recording
        values = getattr(recording, sensor)
        at_rest = recording.window_indices(*recording.sequences[0].start_static_s)
        step = severity * rng.uniform(0.9, 1.1) * float(np.std(np.diff(values[at_rest], axis=0))) / math.sqrt(2.0)
        words = step * np.trunc(values / step)
        return with_sensor(recording, sensor, words)


_truncated("gyro_truncated", "gyro")
_truncated("accel_truncated", "accel")


@injection("spectral_line", dict(zip(GRADES, (8.0, 0.5, 0.5, 0.5), strict=True)), "of the noise")
def spectral_line(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One gyro reads a beat of its drive with that of another, an eighth to three eighths of the sample rate."""
    recording, axis = case.recording, int(rng.integers(3))
    phase = 2.0 * math.pi * (rng.uniform(0.125, 0.375) * np.arange(len(recording.time)) + rng.uniform())
    _, sigma = _at_rest(recording, "gyro")
    return with_sensor(recording, "gyro", recording.gyro + severity * sigma * np.sin(phase)[:, None] * np.eye(3)[axis])


@injection("bit_stuck", 6.0, "bit")
def bit_stuck(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One bit of one axis is always set, as when a line of a 16-bit bus is stuck at high."""
    sensor, axis = str(rng.choice(["gyro", "accel"])), int(rng.integers(3))
    values = getattr(case.recording, sensor).copy()
    lsb = float(np.abs(values).max()) / 2.0**14
    words = np.floor(values / lsb).astype(np.int64)
    words[:, axis] |= 1 << round(severity)
    return with_sensor(case.recording, sensor, lsb * words)


def _at_rest(recording: Recording, sensor: str) -> tuple[Array, float]:
    """Mean of the first window, shape (3,), and the noise of a reading."""
    values = getattr(recording, sensor)[recording.window_indices(*recording.sequences[0].start_static_s)]
    return values.mean(axis=0), float(np.std(np.diff(values, axis=0))) / math.sqrt(2.0)


def _wire_broken(recording: Recording, share: float, noise: float, rng: np.random.Generator) -> Recording:
    """One axis reads a level near zero for a share of the test, with or without the noise of its input."""
    sensor, axis, n = str(rng.choice(["gyro", "accel"])), int(rng.integers(3)), len(recording.time)
    values, (_, sigma) = getattr(recording, sensor).copy(), _at_rest(recording, sensor)
    first = int(rng.uniform(0.0, 1.0 - share) * n)
    part = slice(first, first + int(share * n))
    values[part, axis] = rng.normal(0.0, 10.0 * sigma) + noise * rng.normal(0.0, sigma, part.stop - part.start)
    return with_sensor(recording, sensor, values)


@variant(
    "wire of an axis broken",
    0.4,
    "of the test",
    *(f"{s}_{f}" for s in ("gyro", "accel") for f in ("axis_stuck", "channel_dead")),
)
def wire_broken(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The input of one axis is open."""
    return _wire_broken(case.recording, severity, 0.0, rng)


@variant("wire of an axis broken, noisy", 0.8, "of the test", "gyro_channel_dead", "accel_channel_dead")
def wire_broken_noisy(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The input of one axis is open and reads noise."""
    return _wire_broken(case.recording, severity, 1.0, rng)


@variant("dead band of gyros, subtracted", 6.0, "of noise and bias", "gyro_dead_band")
def dead_band_subtracted(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Gyros read zero below a threshold, and less by the threshold above it."""
    gyro, (bias, sigma) = case.recording.gyro, _at_rest(case.recording, "gyro")
    width = severity * rng.uniform(0.7, 1.4) * (sigma + np.abs(bias).max())
    return replace(case.recording, gyro=np.sign(gyro) * np.maximum(np.abs(gyro) - width, 0.0))


@variant("saturated, with noise", 0.7, "of the largest reading", "gyro_clipped", "accel_clipped")
def saturated_noisy(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A triad is limited before noise is added."""
    sensor = str(rng.choice(["gyro", "accel"]))
    values, (_, sigma) = getattr(case.recording, sensor), _at_rest(case.recording, sensor)
    top = severity * np.abs(values).max()
    noise = (np.abs(values) > top) * rng.normal(0.0, sigma, values.shape)
    return with_sensor(case.recording, sensor, np.clip(values, -top, top) + noise)
