"""Readings truncated toward zero, as a conversion to integers does: half a step too small, by their sign."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtr

from srt.diagnosis.channels import SAMPLES
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import by_sensor
from srt.model.table1 import AXES
from srt.noise.noise_model import OFF_GRID, smallest_step

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices


_ROUNDED: Final = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
"""Limits of the true values that are read as −2 to 2 steps, in steps, if readings are rounded. Rounding down differs by
a bias."""
_TRUNCATED: Final = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
"""The same if readings are truncated: zero is read twice as often as its neighbours."""
_OUTLIERS: Final = 1e-4
"""Share of readings of each value that no noise explains."""
_NEAR: Final = 2
"""Largest reading that is counted, in steps: noise of any distribution is like normal noise over a few steps."""
_UNDITHERED: Final = 0.5
"""Noise in steps below which the scatter of the readings does not show it."""
_LEAST_NOISE: Final = 0.05
"""Noise in steps below which all readings of a window are equal."""
_NOISES: Final = 17
"""Number of noises compared in one pass."""
_MEANS: Final = np.linspace(-1.0, 1.0, 33)
"""Means of a window compared in one pass, as a share of the largest distance from the previous one."""
_PASSES: Final = 3
"""Passes over a finer and finer grid: the tails of little noise need its size to 1 %."""
FALSE_ALARM: Final = 2e-6
"""False-alarm probability of both sensors."""


def truncation(evidence: Evidence) -> Iterator[Finding]:
    """Find sensors whose stationary readings near zero are zero about twice as often as its neighbours.

    Noise spreads the readings of a window over several steps. The likelihood of their counts near zero for normal noise
    is compared between truncation and rounding, each with its most likely mean of each window and noise of each
    channel. A channel that never rests near zero shows nothing.
    """
    if evidence.data is None:
        return
    windows = evidence.data.windows.samples
    least = limit("chi-square", 1, tests=6, shared=FALSE_ALARM)
    for sensor, table in (("gyro", evidence.rate), ("accel", evidence.force)):
        pulse = getattr(evidence.recording.noise, f"{sensor}_quantization")
        counted = pulse or (pulse is None and evidence.recording.kind == "increment")
        if counted or sensor in evidence.wrapped_readings:
            continue  # pulse counts carry the remainder over; wrapped readings lie on several grids
        step = smallest_step(table[:: max(1, len(table) // SAMPLES)])
        ratios = np.array([_likelihood_ratio(table[:, axis], step[axis], windows) for axis in range(3)])
        if ratios.max() > least:
            names = ", ".join(f"{sensor}_{AXES[axis]}" for axis in np.flatnonzero(ratios > least))
            yield TRUNCATED[sensor].found(channels=names, half=0.5 * float(step[ratios > least].max()))


TRUNCATED: Final = by_sensor(
    "truncated",
    "The readings of the [gyros|accelerometers] are truncated toward zero",
    "stationary readings near zero: zero about twice as often as its neighbours",
    "At rest {channels} read zero about twice as often as one step above or below it: a conversion to integers "
    "truncates toward zero, so that readings are half a step ({half:.2g} [rad/s|m/s²]) too small by their sign, which "
    "noise does not average out; let the logger round, and record again.",
    "warning",
    truncation,
)


def _likelihood_ratio(column: Array, step: float, windows: Indices) -> float:
    """Twice the logarithm of the likelihood ratio of truncation and rounding; zero for readings without steps."""
    if step == 0.0:
        return 0.0
    rows = []
    for a, b in windows.tolist():
        steps = column[a:b] / step
        whole = np.rint(steps).astype(np.intp)
        if np.abs(steps - whole).max() > OFF_GRID:
            return 0.0
        own = np.bincount(whole[np.abs(whole) <= _NEAR] + _NEAR, minlength=2 * _NEAR + 1)
        # Zeros without neighbours are a dead band, or stand for lost readings.
        if own[_NEAR] and (own[_NEAR - 1] + own[_NEAR + 1] or own[_NEAR] == b - a):
            rows.append((own, np.median(whole), whole.var(), b - a))
    if not rows:
        return 0.0
    counts, middle, variance, number = (np.array(values) for values in zip(*rows, strict=True))
    read = counts.sum(axis=0) > 0
    if np.any(read[[0, -1]] & ~read[[1, -2]]):
        return 0.0  # words that never occur, as with a stuck bit
    seen = math.sqrt(max(float(np.median(variance)) - 1.0 / 12.0, 0.0))
    noises = (0.5 * seen if seen > _UNDITHERED else _LEAST_NOISE, 2.0 * max(seen, _UNDITHERED))
    far = max(1.5, 6.0 * noises[1] / math.sqrt(number.min()))
    truncated, rounded = (_logarithm(limits, middle, far, noises, counts) for limits in (_TRUNCATED, _ROUNDED))
    return 2.0 * (truncated - rounded)


def _logarithm(limits: Array, mean: Array, far: float, noises: tuple[float, float], counts: Array) -> float:
    """Largest logarithm of the likelihood of counts near zero, shape (w, 5), over means of windows and one noise."""
    best = -math.inf
    for _ in range(_PASSES):
        noise = np.geomspace(*noises, _NOISES)
        means = mean[:, None] + far * _MEANS
        share = np.diff(ndtr((limits - means[..., None]) / noise[:, None, None, None]), axis=-1) + _OUTLIERS
        each = np.einsum("swmk,wk->swm", np.log(share / share.sum(axis=-1, keepdims=True)), counts)
        total = each.max(axis=2).sum(axis=1)
        k = int(total.argmax())
        best = max(best, float(total[k]))
        mean, far = means[np.arange(len(mean)), each[k].argmax(axis=1)], far * (_MEANS[1] - _MEANS[0])
        noises = (noise[max(k - 1, 0)], noise[min(k + 1, _NOISES - 1)])
    return best
