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
from srt.diagnosis.window_averages import ACCEL, block_sigma
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.window_averages import WindowAverages
    from srt.types import Array

_TIMES_S: Final = (1.0, 2.0, 4.0, 8.0)
"""Time constants that are tried, s: for a true value that differs by a factor of up to 1.4, the pattern still has a
correlation above 0.95."""
_FEWEST: Final = 6
"""Fewest windows after a rotation for an estimate of the scatter."""
_LEAST_LAG: Final = 0.05
"""Smallest lag L0 - f, in units of gravity, at which a window counts as a window after a rotation."""
_SMALLEST: Final = 1e-7
"""Smallest share for a finding, 0.1 µg for a change of 1 g: rounding of noise-free readings makes patterns, too."""
_LARGEST: Final = 0.1
"""Largest share for a finding: a larger deviation is motion."""
_REACH: Final = 5.0
"""Time before the window from which the lag is computed, in time constants."""


def accel_settling(evidence: Evidence) -> Iterator[Finding]:
    """Test for a common settling of all accelerometers, or of one, after the rotations.

    Statistic: share that settles over its standard deviation. Distribution: t, with the degrees of freedom of the
    projections of windows and channels on the decay.
    """
    averages = evidence.window_averages
    if averages is None:
        return
    found = []
    for time_s in _TIMES_S:
        patterns = _patterns(evidence, averages, time_s)
        if patterns is None:
            return
        values, columns = patterns
        details = {"time_s": time_s}
        causes = [
            Cause("accel_settling", columns.sum(axis=1, keepdims=True), {**details, "channel": "The accelerometers"})
        ]
        causes += [
            Cause("accel_settling", columns[:, i, None], {**details, "channel": f"accel_{axis}"}, 3)
            for i, axis in enumerate(AXES)
        ]
        found += compare(values, causes)
    best = max(found, key=lambda explanation: explanation.score)
    share, sigma = float(best.value[0]), float(best.sigma[0])
    if _LARGEST > abs(share) > max(_SMALLEST, limit("t", best.freedom, tests=len(found), both_sides=True) * sigma):
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


def _patterns(evidence: Evidence, averages: WindowAverages, time_s: float) -> tuple[Array, Array] | None:
    """Projections of the readings of the windows on the decay, (n,), and their values for a share of 1, (n, 3).

    Both are divided by the standard deviation of the projections due to noise. None with too few windows.
    """
    data = evidence.data
    assert data is not None
    end = {int(w): k for k, w in enumerate(data.end.tolist()) if evidence.contiguous[k]}
    sigma = np.median(block_sigma(averages)[:, ACCEL], axis=0)
    values: list[Array] = []
    columns: list[Array] = []
    lags: list[Array] = []
    for windows, means in averages.groups:
        after = [(g, end[int(w)]) for g, w in enumerate(averages.window[windows]) if int(w) in end]
        if not after:
            continue
        which, sequence = np.array(after).T
        t = averages.step_s * (np.arange(means.shape[1]) + 0.5)
        decay = time_s / averages.step_s * np.exp(-t / time_s) * 2.0 * np.sinh(0.5 * averages.step_s / time_s)
        decay -= decay.mean()
        size = float(np.linalg.norm(decay))
        values.append(np.einsum("b,gbc->gc", decay / size, means[which][:, :, ACCEL]) / sigma)
        lags.append(_lags(evidence, sequence, time_s))
        columns.append(size * lags[-1] / sigma)
    if not values:
        return None
    value, column, lag = (np.concatenate(parts) for parts in (values, columns, lags))
    if np.count_nonzero(np.abs(lag).max(axis=1) > _LEAST_LAG * data.gravity) < _FEWEST:
        return None
    return value.ravel(), (column[:, :, None] * np.eye(3)).reshape(-1, 3)


def _lags(evidence: Evidence, sequences: Array, time_s: float) -> Array:
    """Lag L - f at the start of the window after each sequence, shape (n, 3), m/s²."""
    data = evidence.data
    assert data is not None
    samples, dt = data.windows.samples, evidence.dt
    out = np.empty((len(sequences), 3))
    # Weights of a first-order lag. Earlier readings are taken as the mean of the first window.
    weights = -np.expm1(-dt / time_s) * np.exp(-dt / time_s * np.arange(round(_REACH * time_s / dt))[::-1])
    for row, k in enumerate(sequences.tolist()):
        first, stop = int(samples[data.start[k], 0]), int(samples[data.end[k], 0])
        weight = weights[-(stop - first) :]
        begin = stop - len(weight)
        before = evidence.stationary_force[data.start[k]]
        out[row] = weight @ evidence.force[begin:stop] + (1.0 - weight.sum()) * before
        out[row] -= evidence.stationary_force[data.end[k]]
    return out
