"""Synchronisation of gyros and accelerometers: time offset between the sensors, and samples lost in rotations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import Fault, by_sensor, with_runner_up

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding


def sensor_time_offset(evidence: Evidence) -> Iterator[Finding]:
    """Test for a lag between the gyros and the rotation of gravity, of a triad or of one channel."""
    ranked = evidence.lag
    if ranked is None:
        return
    best = next(explanation for explanation in ranked if explanation.cause.fault)
    fault = next(f for f in (SENSOR_TIME_OFFSET, *AXIS_DELAYED.values()) if f.name == best.cause.fault)
    offset = {"offset_ms": 1e3 * float(best.value[0]), "sigma_ms": 1e3 * float(best.sigma[0])}
    yield with_runner_up(fault.found(**offset, **best.cause.details), ranked)


SENSOR_TIME_OFFSET: Final = Fault(
    "sensor_time_offset",
    "Gyros and accelerometers are not synchronised",
    "lag between the gyros and the rotation of gravity in the accelerometers",
    "The accelerometer readings lag the gyro readings by {offset_ms:+.3g} ms (negative: lead): align the time stamps "
    "of both sensors.",
    "warning",
    sensor_time_offset,
)
AXIS_DELAYED: Final = by_sensor(
    "axis_delayed",
    "One [gyro|accelerometer] axis has another delay than the others",
    "lag between the gyros and the rotation of gravity in the accelerometers, by axis",
    "{channel} lags the other axes by {offset_ms:+.3g} ms (negative: leads), as with a multiplexed converter or a "
    "filter of another delay: align the channels in time.",
    "warning",
    sensor_time_offset,
)


def sample_twice(evidence: Evidence) -> int | None:
    """Sample that repeats the previous one and causes an attitude error by its angle; None if there is none."""
    step, turns = evidence.attitude_step, evidence.block_averages
    if step is None or turns is None or step.duration_s > -0.5 * evidence.dt:
        return None
    recording, reach = evidence.recording, 2 * max(1, round(turns.step_s / evidence.dt))
    rows = np.arange(max(1, step.sample - reach), min(len(recording.time), step.sample + reach))
    same = [np.all(x[rows] == x[rows - 1], axis=1) for x in (recording.gyro, recording.accel)]
    again = rows[same[0] & same[1]]
    return int(again[0]) if again.size else None


def samples_lost(evidence: Evidence) -> Iterator[Finding]:
    """Report a step of the gyro-stabilised specific force that a repeated sample does not explain."""
    step = evidence.attitude_step
    if step is None or sample_twice(evidence) is not None:
        return
    yield SAMPLES_LOST.found(
        sequence=evidence.title(step.sequence),
        time=float(evidence.recording.time[step.sample]) - evidence.dt,
        angle_deg=math.degrees(step.height),
        duration=abs(step.duration_s),
    )


SAMPLES_LOST: Final = Fault(
    "samples_lost",
    "Samples were lost in a rotation, but the time stamps have no gap",
    "a rotation of gravity between two samples that the gyros do not measure",
    "In {sequence}, samples of about {duration:.2g} s are missing at {time:.6g} s, but the time stamps have no gap: "
    "gravity rotated by {angle_deg:.3g}°, which the gyros did not measure; repeat the sequence.",
    "warning",
    samples_lost,
)
