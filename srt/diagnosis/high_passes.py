"""Readings behind a high-pass filter: gyros whose offset is tracked through rotations, and specific force less gravity.

A filter of first order takes the low-passed reading L from the true one, with dL/dt = r / τ, r being what is output. At
rest the true reading is constant, and so is the sum of r and its integral over τ: in every window the reading falls by
1/τ for each unit of its own integral. Nothing else ties the two to one another in all windows and axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import check, finding
from srt.sequences.rest_detection import BLOCK_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array

_EXPLAINED: Final = 0.9
"""Share of the power of the changes within the windows that the filter must explain: rotations that reach into windows
are explained to 0.6, a drift of the readings to less."""
_LONGEST_S: Final = 200.0
"""Longest time constant, s: a settling of 1e-3 of gravity within a window looks like one of 1e4 s."""
_SHORTEST_S: Final = {"gyro": 0.5, "accel": 0.01}
"""Shortest time constant, s: gyros behind a shorter one read no rotation, and windows hold the end of one instead."""
_FEWEST_WINDOWS: Final = 4
"""Windows, fewer of which may do so by chance."""
_LEAST: Final = {"gyro": 1e-3, "accel": 0.1}
"""Least change of the readings in the windows, rad/s and m/s² (rms), that is a decay after rotations."""


@check("gyro_high_passed", "gravity_removed")
def high_passed(evidence: Evidence) -> Iterator[Finding]:
    """Test the readings in the windows for a fall in proportion to their own integral."""
    for sensor, fault in (("gyro", "gyro_high_passed"), ("accel", "gravity_removed")):
        time_s = _time_constant(evidence, sensor)
        if time_s is not None:
            yield finding(fault, time_s=time_s)


def _time_constant(evidence: Evidence, sensor: str) -> float | None:
    """Time constant of the filter, s; None if there is none."""
    data = evidence.data
    if data is None or len(data.windows.samples) < _FEWEST_WINDOWS:
        return None
    size = max(1, round(BLOCK_S / evidence.dt))
    table = evidence.rate if sensor == "gyro" else evidence.force
    readings: list[Array] = []
    integrals: list[Array] = []
    for a, b in data.windows.samples.tolist():
        count = (b - a) // size
        if count < 3:
            continue
        mean = table[a : a + count * size].reshape(count, size, 3).mean(axis=1)
        integral = size * evidence.dt * (np.cumsum(mean, axis=0) - 0.5 * mean)
        readings.append(mean - mean.mean(axis=0))
        integrals.append(integral - integral.mean(axis=0))
    if len(readings) < _FEWEST_WINDOWS:
        return None
    y, x = np.concatenate(readings).ravel(), np.concatenate(integrals).ravel()
    power, square = float(y @ y), float(x @ x)
    if power < _LEAST[sensor] ** 2 * len(y) or square == 0.0:
        return None
    slope = float(x @ y) / square
    explained = slope**2 * square / power
    fits = -1.0 / _SHORTEST_S[sensor] < slope < -1.0 / _LONGEST_S and explained > _EXPLAINED
    return -1.0 / slope if fits else None
