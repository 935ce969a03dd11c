"""High-pass filtered readings: gyros whose offset is tracked during rotations, and specific force without gravity.

A first-order high-pass filter outputs r = y - L: the true reading y less its low-pass filtered value L, which follows
dL/dt = r / τ. At rest y is constant, so that dr/dt = -r / τ: at rest, r is a constant less its own time integral
divided by τ. No other effect makes this relation. Rest is where the other triad is steady: the filter hides the rests
of its own triad, and labels may be wrong or absent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import Fault
from srt.diagnosis.window_averages import ACCEL, GYRO
from srt.exceptions import DataError
from srt.sequences.rest_detection import BLOCK_S, blocks_of, steady_runs

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding

_EXPLAINED: Final = 0.5
"""Smallest share of the variance that the filter explains, averaged over all steady time: rotations are a smaller part
of it than rests. Readings without a filter have less than 0.2, also where accelerometers settle."""
_TINY: Final = np.finfo(float).tiny
_LONGEST_S: Final = 200.0
"""Longest time constant of a filter, s: accelerometers that settle by 1e-3 of gravity within a window look like a
filter with a time constant of 1e4 s."""
_SHORTEST_S: Final = (0.5, BLOCK_S)
"""Shortest time constant of a filter of gyros and accelerometers, s: gyros behind a faster one would hardly read a
rotation, and a shorter decay is the end of a rotation."""


def high_passed(evidence: Evidence) -> Iterator[Finding]:
    """Test the readings at rest for a decrease in proportion to their own time integral."""
    try:
        blocks = blocks_of(evidence.recording)
    except DataError:
        return
    step_s = blocks.size * evidence.dt
    for fault, own, other, shortest_s in zip(
        (GYRO_HIGH_PASSED, GRAVITY_REMOVED), (GYRO, ACCEL), (ACCEL, GYRO), _SHORTEST_S, strict=True
    ):
        rows = []
        for first, last in steady_runs(blocks, other):
            y = blocks.mean[first:last, own]
            x = step_s * (np.cumsum(y, axis=0) - 0.5 * y)
            y, x = (values - values.mean(axis=0) for values in (y, x))
            power, square = np.vdot(y, y) + _TINY, np.vdot(x, x) + _TINY
            decay = -np.vdot(x, y) / square
            rows.append((last - first, max(decay, 0.0) ** 2 * square / power, decay))
        if rows:
            length, share, decay = np.array(rows).T
            typical = float(np.median(decay))
            if share @ length > _EXPLAINED * length.sum() and 1.0 / _LONGEST_S < typical < 1.0 / shortest_s:
                yield fault.found(time_s=1.0 / typical)


GYRO_HIGH_PASSED: Final = Fault(
    "gyro_high_passed",
    "The gyros have a high-pass filter",
    "readings while the specific force is steady: a decrease in proportion to their own time integral",
    "After rotations the gyro readings decay in the stationary windows, with a time constant of {time_s:.3g} s, as "
    "behind a high-pass filter: the unit tracks the offset of its gyros during rotations; switch this off, and record "
    "raw readings.",
    "exit 1",
    high_passed,
)
GRAVITY_REMOVED: Final = Fault(
    "gravity_removed",
    "Gravity is removed from the accelerometer readings",
    "readings while the rate is steady: a decrease in proportion to their own time integral",
    "The accelerometer readings decay to zero in the stationary windows, with a time constant of {time_s:.3g} s: the "
    "unit outputs linear acceleration, without gravity; record the raw specific force.",
    "exit 1",
    high_passed,
)
