"""Settling of the accelerometers after a change of specific force.

The model of the reading is ``f + s (L - f)``, where L follows f with a time constant τ (first-order low-pass filter)
and s is the share that settles. In the window after a rotation, the deviation is ``s (L0 - f) exp(-t/τ)`` with the
value L0 of L at the start of the window. At the start of a sequence, L equals the mean reading of the first window.
Each window and channel gives one estimate of s. The scatter of these estimates includes all other changes of the
readings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.cause_comparison import Cause, compare
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault
from srt.diagnosis.window_averages import ACCEL
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array

_TIMES_S: Final = (1.0, 2.0, 4.0, 8.0)
"""Time constants that are tried, s: for a true value that differs by a factor of up to 1.4, the pattern still has a
correlation above 0.95."""
_SHARES: Final = (1e-7, 0.1)
"""Smallest and largest share for a finding: 0.1 µg for 1 g is rounding, and a larger deviation is motion."""


def accel_settling(evidence: Evidence) -> Iterator[Finding]:
    """Test for a common settling of all accelerometers, or of one, after the rotations.

    Statistic: share that settles over its standard deviation. Distribution: t, with the degrees of freedom of the
    projections of windows and channels on the decay.
    """
    found = []
    for time_s in _TIMES_S:
        values, columns = _patterns(evidence, time_s)
        if not values.size:
            return
        of = [(columns.sum(axis=1, keepdims=True), "The accelerometers", 1)]
        of += [(columns[:, i, None], f"accel_{axis}", 3) for i, axis in enumerate(AXES)]
        causes = [Cause("accel_settling", one, {"time_s": time_s, "channel": who}, n) for one, who, n in of]
        found += compare(values, causes)
    best = max(found, key=lambda explanation: explanation.score)
    share, sigma = float(best.value[0]), float(best.sigma[0])
    least = limit("t", best.freedom, tests=len(found), both_sides=True) * sigma
    if _SHARES[1] > abs(share) > max(_SHARES[0], least):
        yield ACCEL_SETTLING.found(share_ppm=1e6 * share, sigma_ppm=1e6 * sigma, **best.cause.details)


ACCEL_SETTLING: Final = Fault(
    "accel_settling",
    "The accelerometers settle after a rotation",
    "readings after each rotation: an exponential decay in proportion to the change of specific force",
    "{channel}: after a rotation, {share_ppm:.3g} ± {sigma_ppm:.2g} ppm of the change of specific force decays with a "
    "time constant of about {time_s:g} s: start the windows later, or make them longer.",
    "warning",
    accel_settling,
)


def _patterns(evidence: Evidence, time_s: float) -> tuple[Array, Array]:
    """Projections of the readings of the windows on the decay, (n,), and their values for a share of 1, (n, 3).

    Both are divided by the standard deviation of the projections due to noise.
    """
    data, averages = evidence.data, evidence.window_averages
    values, columns = [np.zeros(0)], [np.zeros((0, 3))]
    if data is None or averages is None:
        return values[0], columns[0]
    end = {int(w): k for k, w in enumerate(data.end.tolist()) if evidence.contiguous[k]}
    sigma = np.median(averages.sigma[:, ACCEL], axis=0)
    longest = int(np.max(data.windows.samples[data.end, 0] - data.windows.samples[data.start, 0]))
    past = np.exp(-evidence.dt / time_s * np.arange(max(longest, 0), -1, -1))
    for windows, means in averages.groups:
        decay = np.exp(-averages.step_s * np.arange(means.shape[1]) / time_s)
        decay *= -time_s / averages.step_s * np.expm1(-averages.step_s / time_s)  # mean over a block
        decay -= decay.mean()
        size = float(np.linalg.norm(decay))
        for w, blocks in zip(averages.window[windows].tolist(), means[:, :, ACCEL], strict=True):
            if w in end:
                values.append(decay @ blocks / (size * sigma))
                columns.append(np.diag(size * _lag(evidence, end[w], past) / sigma))
    return np.concatenate(values), np.concatenate(columns)


def _lag(evidence: Evidence, sequence: int, past: Array) -> Array:
    """Lag L - f at the start of the window after a sequence, shape (3,), m/s².

    ``past`` is the decay since the samples before, the latest last.
    """
    data = evidence.data
    assert data is not None
    start, end = data.start[sequence], data.end[sequence]
    first, stop = data.windows.samples[start, 0], data.windows.samples[end, 0]
    # Earlier readings are taken as the mean of the first window.
    past = past[first - stop - 1 :]
    lagged = np.diff(past) @ evidence.force[first:stop] + past[0] * evidence.stationary_force[start]
    return np.asarray(lagged - evidence.stationary_force[end])
