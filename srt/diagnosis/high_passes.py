"""High-pass filtered readings: gyros whose offset is tracked during rotations, and specific force without gravity.

A first-order high-pass filter outputs r = y - L: the true reading y less its low-pass filtered value L, which follows
dL/dt = r / τ. At rest y is constant, so that dr/dt = -r / τ: in every window, r is a constant less its own time
integral divided by τ. No other effect makes this relation with the same τ in all windows and axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import Fault
from srt.diagnosis.window_averages import ACCEL, GYRO
from srt.sequences.rest_detection import BLOCK_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding

_EXPLAINED: Final = 0.9
"""Smallest share of the variance within the windows that the filter must explain: it explains 0.6 of the variance if
rotations extend into the windows, and less of a drift."""
_LONGEST_S: Final = 200.0
"""Longest time constant of a filter, s: accelerometers that settle by 1e-3 of gravity within a window look like a
filter with a time constant of 1e4 s."""
_SHORTEST_S: Final = (0.5, BLOCK_S)
"""Shortest time constant of a filter of gyros and accelerometers, s: gyros behind a faster one would hardly read a
rotation, and a shorter decay in a window is the end of a rotation."""


def high_passed(evidence: Evidence) -> Iterator[Finding]:
    """Test the readings in the windows for a decrease in proportion to their own time integral."""
    averages = evidence.window_averages
    if averages is None:
        return
    for fault, channels, shortest_s in zip(
        (GYRO_HIGH_PASSED, GRAVITY_REMOVED), (GYRO, ACCEL), _SHORTEST_S, strict=True
    ):
        means = [blocks[:, :, channels] for _, blocks in averages.groups]
        integrals = [averages.step_s * (np.cumsum(mean, axis=1) - 0.5 * mean) for mean in means]
        y, x = (
            np.concatenate([(values - values.mean(axis=1, keepdims=True)).ravel() for values in tables])
            for tables in (means, integrals)
        )
        power, square, product = float(y @ y), float(x @ x), float(x @ y)
        if product * product > _EXPLAINED * power * square and shortest_s < -square / product < _LONGEST_S:
            yield fault.found(time_s=-square / product)


GYRO_HIGH_PASSED: Final = Fault(
    "gyro_high_passed",
    "The gyros have a high-pass filter",
    "readings in the stationary windows: a decrease in proportion to their own time integral, with one time constant "
    "in all windows",
    "After rotations the gyro readings decay in the stationary windows, with a time constant of {time_s:.3g} s, as "
    "behind a high-pass filter: the unit tracks the offset of its gyros during rotations; switch this off, and record "
    "raw readings.",
    "exit 1",
    high_passed,
)
GRAVITY_REMOVED: Final = Fault(
    "gravity_removed",
    "Gravity is removed from the accelerometer readings",
    "readings in the stationary windows: a decrease in proportion to their own time integral, with one time constant "
    "in all windows",
    "The accelerometer readings decay to zero in the stationary windows, with a time constant of {time_s:.3g} s: the "
    "unit outputs linear acceleration, without gravity; record the raw specific force.",
    "exit 1",
    high_passed,
)
