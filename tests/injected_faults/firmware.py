"""Faults of firmware: high-pass filters, gravity removed, unsigned words, dead bands, truncation, stuck bits."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from injected_faults.changes import low_passed, per_sample, sign, with_sensor
from injected_faults.injection import GRADES, Case, injection
from srt.constants import MICRO_G
from srt.recording.recording import Recording


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


@injection("bit_stuck", 6.0, "bit")
def bit_stuck(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One bit of one axis is always set, as when a line of a 16-bit bus is stuck at high."""
    sensor, axis = str(rng.choice(["gyro", "accel"])), int(rng.integers(3))
    values = getattr(case.recording, sensor).copy()
    lsb = float(np.abs(values).max()) / 2.0**14
    words = np.floor(values / lsb).astype(np.int64)
    words[:, axis] |= 1 << round(severity)
    return with_sensor(case.recording, sensor, lsb * words)
