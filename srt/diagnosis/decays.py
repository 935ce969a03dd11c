"""Decays of the readings at rest: high-pass filters, and accelerometers that settle after rotations.

A first-order high-pass filter outputs r = y - L: the true reading y less its low-pass filtered value L, which follows
dL/dt = r / τ. At rest y is constant, so that dr/dt = -r / τ: r is a constant less its own time integral divided by τ.
From rest to rest, r changes by the integral between them, too: by the angle of the rotation over τ. The bias of a unit
that warms up does not. Rest is where the other triad is steady: the filter hides the rests of its own triad, and labels
may be wrong or absent.

The reading of an accelerometer that settles is ``f + s (L - f)``, where L follows f with a time constant τ and s is the
share that settles. In the window after a rotation, the deviation is ``s (L0 - f) exp(-t/τ)`` with the value L0 of L at
the start of the window. At the start of a sequence, L equals the mean reading of the first window.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtri

from srt.diagnosis.cause_comparison import Cause, compare
from srt.diagnosis.channels import SENSOR_ERROR
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault
from srt.diagnosis.gravity_rotation import SECOND, block_size
from srt.diagnosis.rotation_readings import AGREE, ROUNDING
from srt.diagnosis.window_averages import ACCEL
from srt.model.table1 import AXES
from srt.sequences.rest_detection import BLOCK_S, SPREAD

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices

_EXPLAINED: Final = 0.5
"""Smallest share of the variance of a steady run that the filter explains, and of the steady time in which it does: a
rotation about the vertical, which the accelerometers do not see, looks like a decay in its own run."""
_LONGEST_S: Final = 200.0
"""Longest time constant of a filter, s: accelerometers that settle by 1e-3 of gravity within a window look like a
filter with a time constant of 1e4 s."""


def high_passed(evidence: Evidence) -> Iterator[Finding]:
    """Test the readings at rest for a decrease in proportion to their own time integral.

    Readings of the other triad that are cut at zero do not show rest. Accelerometers that read the magnitude of gravity
    at the ends of the rests measure it, whatever decays.
    """
    size, (gyro, accel), tiny = block_size(evidence.recording), evidence.block_means, np.finfo(float).tiny
    rounding = evidence.steps * evidence.per_rate / math.sqrt(12.0 * size)
    gravity, (gyro_cut, accel_cut) = evidence.recording.site.gravity_m_s2, evidence.cut_at_zero.reshape(2, 3)
    for fault, own, other, least, blind in (
        (GYRO_HIGH_PASSED, gyro, accel, rounding[1], accel_cut),
        (GRAVITY_REMOVED, accel, gyro, rounding[0], gyro_cut),
    ):
        rows, gaps = [], evidence.recording.gaps // size
        runs = [] if blind.any() else _steady_runs(other, least, gaps)
        for first, last in runs:
            y = own[first:last]
            left = float(np.linalg.norm(y[-1]))
            x = size * evidence.dt * (np.cumsum(y, axis=0) - 0.5 * y)
            y, x = (values - values.mean(axis=0) for values in (y, x))
            power, square = np.vdot(y, y) + tiny, np.vdot(x, x) + tiny
            decay = -np.vdot(x, y) / square
            rows.append((last - first, max(decay, 0.0) ** 2 * square / power, decay, left))
        if not rows:
            continue
        length, share, decay, left = np.array(rows).T
        follows = share > _EXPLAINED
        typical = float(np.median(decay[follows])) if follows.any() else 0.0
        if length[follows].sum() <= _EXPLAINED * length.sum() or not 1.0 / _LONGEST_S < typical < 1.0 / BLOCK_S:
            continue
        if fault is GYRO_HIGH_PASSED and not _follows_rotations(own, runs, size * evidence.dt * typical, gaps):
            continue
        typical_left = float(np.median(left[follows]))
        if fault is GYRO_HIGH_PASSED or abs(typical_left - gravity) > SENSOR_ERROR * gravity:
            yield fault.found(time_s=1.0 / typical, left=typical_left)


def _follows_rotations(means: Array, runs: list[tuple[int, int]], decay: float, gaps: Indices) -> bool:
    """True if a filter explains how the rates at rest change from run to run: by the angle between them over τ.

    The bias of a unit that warms up decays in the same form, but whatever rotates between the runs. ``decay`` is the
    length of a block over τ. A run may end in a rotation about the vertical: the larger part of the angles counts.
    """
    explained = total = 0.0
    for (_, last), (first, _) in pairwise(runs):
        between = means[last - 1 : first + 1]
        if len(between) < 2 or np.any((last <= gaps) & (gaps <= first)):
            continue
        expected = -decay * (between.sum(axis=0) - 0.5 * (between[0] + between[-1]))
        size = float(np.linalg.norm(expected))
        total += size
        explained += size * (np.linalg.norm(between[-1] - between[0] - expected) < AGREE * size)
    return explained >= _EXPLAINED * total


def _steady_runs(means: Array, least: Array, gaps: Indices) -> list[tuple[int, int]]:
    """Runs of blocks (first, one past last), without their ends, whose means are those one second later, but for noise.

    The noise of a mean, of at least ``least``, is that of the quietest fifth of the successive differences. ``gaps``
    are the blocks with a gap of the time stamps.
    """
    if len(means) <= SECOND:
        return []
    fifth = np.quantile(np.abs(np.diff(means, axis=0)), 0.2, axis=0) / (math.sqrt(2.0) * float(ndtri(0.6)))
    same = np.all(np.abs(means[SECOND:] - means[:-SECOND]) <= SPREAD * np.maximum(fifth, least), axis=1)
    same[np.unique(np.clip(gaps[:, None] - np.arange(SECOND + 1), 0, len(same) - 1))] = False
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False)).reshape(-1, 2)
    return [(first + 1, last + SECOND - 1) for first, last in edges.tolist()]


GYRO_HIGH_PASSED: Final = Fault(
    "gyro_high_passed",
    "The gyros have a high-pass filter",
    "readings while the specific force is steady: a decrease in proportion to their own time integral; from rest to "
    "rest a change by the angle between them over the time constant",
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
    "The accelerometer readings decay in the stationary windows, with a time constant of {time_s:.3g} s, to {left:.3g} "
    "m/s² at their ends: the unit outputs linear acceleration, without gravity; record the raw specific force.",
    "exit 1",
    high_passed,
)

_TIMES_S: Final = np.exp2(range(4))
"""Time constants that are tried, 1 to 8 s: if the true value differs by a factor of up to 1.4, the pattern still has
a correlation above 0.95."""


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
    best = max(found, key=lambda explanation: round(explanation.score, 6))
    share, sigma = float(best.value[0]), float(best.sigma[0])
    least = limit("t", best.freedom, tests=len(found), both_sides=True) * sigma
    # A larger deviation than a sensor error is motion.
    if SENSOR_ERROR > abs(share) > max(ROUNDING, least):
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
    """Projections of the windows on the decay, (n,), and those of a share of 1, (n, 3), in units of their noise."""
    data, averages = evidence.data, evidence.window_averages
    values, columns = [np.zeros(0)], [np.zeros((0, 3))]
    if data is None or averages is None:
        return values[0], columns[0]
    windows, mean = data.windows.samples, evidence.stationary_force
    sequence = {int(data.end[k]): k for k in np.flatnonzero(evidence.contiguous)}
    sigma = np.median(averages.sigma[:, ACCEL], axis=0)
    longest = int(np.max(windows[data.end, 0] - windows[data.start, 0], initial=0))
    past = np.exp(-evidence.dt / time_s * np.arange(longest, -1, -1))
    for numbers, means in averages.groups:
        decay = np.exp(-averages.step_s * np.arange(means.shape[1]) / time_s)
        decay *= -time_s / averages.step_s * np.expm1(-averages.step_s / time_s)  # mean over a block
        decay -= decay.mean()
        size = float(np.linalg.norm(decay))
        for w, blocks in zip(averages.window[numbers].tolist(), means[:, :, ACCEL], strict=True):
            if w not in sequence:
                continue
            start = data.start[sequence[w]]
            first, stop = windows[start, 0], windows[w, 0]
            # Lag L - f at the start of the window. Earlier readings are taken as the mean of the first window.
            own = past[first - stop - 1 :]
            lag = np.diff(own) @ evidence.force[first:stop] + own[0] * mean[start] - mean[w]
            values.append(decay @ blocks / (size * sigma))
            columns.append(np.diag(size * lag / sigma))
    return np.concatenate(values), np.concatenate(columns)
