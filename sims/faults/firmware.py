"""Faults of firmware and converters: high-pass filters, gravity removed, and words of one polarity."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from sims.faults.injection import injection

if TYPE_CHECKING:
    from sims.faults.injection import Case
    from srt.recording.recording import Recording
    from srt.types import Array


def _high_passed(values: Array, interval_s: float, time_s: float) -> Array:
    """Readings less their low-passed value, sample by sample, from the first reading on."""
    keep = math.exp(-interval_s / time_s)
    return np.asarray(values - lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])[0])


@injection("gyro_high_passed", 20.0, "s")
def gyro_high_passed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The offset of the gyros is tracked with one time constant."""
    recording = case.recording
    time_s = severity * float(rng.uniform(0.8, 1.2))
    return replace(recording, gyro=_high_passed(recording.gyro, recording.nominal_interval_s, time_s))


@injection("gravity_removed", 1.0, "")
def gravity_removed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit subtracts low-passed specific force."""
    recording = case.recording
    time_s = float(rng.uniform(0.2, 1.0))
    return replace(recording, accel=_high_passed(recording.accel, recording.nominal_interval_s, time_s))


def _one_polarity(fault: str, sensor: str) -> None:
    @injection(fault, 1.0, "")
    def one_polarity(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """One axis reads zero for all values of one sign."""
        values, axis = getattr(case.recording, sensor).copy(), int(rng.integers(3))
        sign = float(rng.choice((-1.0, 1.0)))
        values[:, axis] = sign * np.maximum(sign * values[:, axis], 0.0)
        return replace(case.recording, gyro=values) if sensor == "gyro" else replace(case.recording, accel=values)


_one_polarity("gyro_one_polarity", "gyro")
_one_polarity("accel_one_polarity", "accel")
