"""Disturbances of stationary windows: oscillation at the start, bumps, creep and noise.

The tests run in this order, because each disturbance also affects the later tests: an oscillation contains steps, a
step looks like a drift, and all of them increase the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.false_alarms import FALSE_ALARM, limit
from srt.diagnosis.findings import Fault
from srt.diagnosis.rotation_readings import MAD, cross, invert_readings
from srt.diagnosis.window_averages import (
    ACCEL,
    GYRO,
    WindowAverages,
    block_sigma,
    stationary_rate_residual,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices, Mask


_LEAST_POWER: Final = 2.0
"""Smallest variance at the start of a window, relative to its second half, for a finding: less does not matter."""
_NOISIER: Final = 2.25
"""Smallest variance of a window, relative to the other windows, for a finding: 1.5 times their standard deviation."""
_NOISE_SIGMAS: Final = 6.0
"""Smallest deviation of the logarithm of a window's variance for a finding, in sigma of its scatter over all windows:
the noise of windows held by hand scatters more."""
_EDGE_BLOCKS: Final = 2
"""Number of blocks at each end of a window in which no step is searched: one side of the step would be too short."""
_WIDE: Final = 0.95
_WIDE_SIGMAS: Final = 1.96
"""Quantile of the magnitudes of the means from which their scatter is taken, and its value for a normal distribution in
sigma."""
_SPANS: Final = (1, 2, 3)
"""Numbers of blocks over which a bump rotates the unit; a longer motion is not a bump."""
_AGREE: Final = 0.35
"""Largest relative difference between the tilts by gyros and by accelerometers: allows for scale-factor errors of 10 %,
and for a step that the blocks do not fully resolve."""
_PLAUSIBLE: Final = 1e-3
"""Largest p-value of the accelerometers alone for a creep."""
_CONTRARY: Final = 1e-4
"""p-value below which gyros and accelerometers contradict each other on a creep."""
_UNKNOWNS: Final = 4
"""Number of unknowns of an axis in the fit of the stationary rates: one bias and three g-sensitivities."""
_MAD_EFFICIENCY: Final = 0.37
"""Degrees of freedom of a median absolute deviation, per value."""


def disturbed_windows(evidence: Evidence) -> Iterator[Finding]:
    """Compare each window with the others for oscillation, bumps, creep and noise."""
    averages = evidence.window_averages
    if averages is None:
        return
    # If gyros lag or lead, their readings of a rotation reach into the windows, in which the unit is at rest.
    lagging = evidence.lag is not None
    ringing, amplitude = _oscillation(averages, by_gyros=not lagging)
    if evidence.recording.fixture is None:
        ringing[:] = False  # a unit held by hand is never quite at rest
    steps = _steps(evidence, averages)
    # A step during an oscillation is a part of it, and no bump. An oscillation after a step is due to the bump.
    for v in list(steps):
        if ringing[v].any() and ringing[v] @ (averages.heads <= steps[v].block * averages.size):
            del steps[v]
    rings: Mask = np.asarray(ringing.any(axis=1))
    rings[list(steps)] = False
    if rings.any():
        worst = int(np.argmax(np.where(rings, amplitude[:, :2].max(axis=1), 0.0)))
        yield UNSETTLED.found(
            count=int(rings.sum()),
            amplitude=_amplitude(averages, worst),
            **_place(evidence, averages, worst),
        )
    if steps:
        v = max(steps, key=lambda v: steps[v].size)
        yield BUMP.found(
            **_place(evidence, averages, v)
            | {"time": _time(evidence, averages, v, (steps[v].block + 0.5) * averages.step_s)},
            angle_mrad=1e3 * steps[v].size,
        )
    done = rings.copy()
    done[list(steps)] = True
    creep = _creep(evidence, averages, done)
    if creep is not None:
        v, rate = creep
        done[v] = True
        yield CREEP.found(rate_urad_s=1e6 * rate, **_place(evidence, averages, v))
    noisy = None if lagging else _noisy(averages, done)
    if noisy is not None:
        v, ratio, sensor = noisy
        yield NOISY_WINDOW.found(ratio=ratio, sensor=sensor, **_place(evidence, averages, v))


UNSETTLED: Final = Fault(
    "unsettled",
    "The fixture had not settled",
    "oscillation at the start of windows, compared with their second half",
    "The fixture still oscillates at the start of the stationary window from {time:.6g} s ({sequence}; amplitude "
    "{amplitude}; {count} such windows in the recording): wait longer after a rotation, or start the windows later.",
    "warning",
    disturbed_windows,
)
BUMP: Final = Fault(
    "bump",
    "The unit was bumped in a stationary window",
    "a step of attitude inside a window, on which gyros and accelerometers agree",
    "The unit was bumped at {time:.6g} s, in a stationary window of {sequence}: it rotated by {angle_mrad:.3g} mrad; "
    "repeat the sequence.",
    "warning",
    disturbed_windows,
)
CREEP: Final = Fault(
    "creep",
    "The unit creeps in a stationary window",
    "a steady tilt inside a window, on which gyros and accelerometers agree",
    "The unit creeps in the stationary window from {time:.6g} s ({sequence}): it tilts by {rate_urad_s:.3g} µrad/s; "
    "clamp the unit, and repeat the sequence.",
    "warning",
    disturbed_windows,
)
NOISY_WINDOW: Final = Fault(
    "noisy_window",
    "A stationary window is noisier than the others",
    "noise of each window against that of the others",
    "In the stationary window from {time:.6g} s ({sequence}), the noise of the {sensor} is {ratio:.3g} times that in "
    "the other windows: look for vibration, and repeat the sequence.",
    "warning",
    disturbed_windows,
)


def _time(evidence: Evidence, averages: WindowAverages, v: int, later_s: float = 0.0) -> float:
    data = evidence.data
    assert data is not None
    first = int(data.windows.samples[averages.window[v], 0])
    return float(evidence.recording.time[first]) - evidence.dt + later_s


def _place(evidence: Evidence, averages: WindowAverages, v: int) -> dict[str, object]:
    """Start and sequence of a window, as fields of a message."""
    data = evidence.data
    assert data is not None
    w = int(averages.window[v])
    k = int(np.flatnonzero((data.start == w) | (data.end == w))[0])
    return {"time": _time(evidence, averages, v), "sequence": evidence.title(k)}


# --- oscillation -----------------------------------------------------------------------------------------------------


def _oscillation(averages: WindowAverages, by_gyros: bool) -> tuple[Mask, Array]:
    """Windows that oscillate at the start: their variance is far larger there than in the second half.

    Statistic: variance at the start over that of the noise, averaged over three axes. Distribution: chi-square over its
    degrees of freedom, which follow from the autocorrelation.

    Returns
    -------
    oscillating : ndarray of bool, shape (V, H)
        By window and length of the start part.
    ratio : ndarray, shape (V, 2)
        Largest variance of a start part over that of the noise, for gyros and accelerometers.
    """
    noise = np.maximum(
        np.maximum(averages.late_variance, np.median(averages.late_variance, axis=0)), averages.least_variance
    )
    ratio = averages.head_power / noise[:, None]
    by_sensor = np.stack([ratio[:, :, GYRO].mean(axis=2), ratio[:, :, ACCEL].mean(axis=2)], axis=2)
    freedom = averages.head_freedom
    loud = by_sensor > np.maximum(_LEAST_POWER, limit("chi-square", freedom, tests=by_sensor.size) / freedom)
    told = loud.any(axis=2) if by_gyros else loud[:, :, 1]
    return np.asarray(told), np.asarray(by_sensor.max(axis=1, initial=0.0))


def _amplitude(averages: WindowAverages, v: int) -> str:
    """Amplitude of the oscillation at the start of a window, with its unit, as text."""
    excess = np.maximum(averages.head_power[v, 0] - averages.late_variance[v], 0.0)
    sigma = excess / np.maximum(averages.late_variance[v], averages.least_variance)
    by_gyros = sigma[GYRO].max() >= sigma[ACCEL].max()
    size = np.sqrt(2.0 * excess[GYRO if by_gyros else ACCEL].sum())
    return f"{1e3 * size:.2g} mrad/s" if by_gyros else f"{size:.2g} m/s²"


# --- bumps -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _AttitudeStep:
    """Step of the attitude: number of its block, and angle in rad."""

    block: int
    size: float


def _steps(evidence: Evidence, averages: WindowAverages) -> dict[int, _AttitudeStep]:
    """Windows with a step of the attitude: the gyros show a rotation in a few blocks, and the accelerometers agree.

    Statistic: squared rotation angle in a span of blocks over its variance. Distribution: chi-square, three degrees of
    freedom.
    """
    gyro, accel, bias = evidence.raw_triads
    data = evidence.data
    assert data is not None
    sigma = block_sigma(averages)
    spread = _span_spread(averages, sigma)
    tests = len(_SPANS) * int(averages.blocks.sum())
    largest, z = limit("chi-square", 3.0, tests=tests), limit("normal", tests=tests, both_sides=True)
    noise = _step_noise(averages, accel)
    own = np.maximum(1.0, (sigma[:, ACCEL] / np.median(sigma[:, ACCEL], axis=0)).max(axis=1))
    out = {}
    for windows, means in averages.groups:
        rate = means[:, :, GYRO] - np.median(means[:, :, GYRO], axis=1, keepdims=True)
        power = _turning_power(
            rate, [factor * sigma[windows, None, GYRO] for factor in spread], averages.block_doubt[GYRO]
        )
        for i in np.flatnonzero([any((p[i] > largest).any() for p in power) for i in range(len(windows))]).tolist():
            v, count = int(windows[i]), means.shape[1]
            span = _turning_span([p[i] for p in power], largest)
            if span is None or span[0] < _EDGE_BLOCKS or span[1] > count - _EDGE_BLOCKS:
                continue
            first, last = span
            angle = np.linalg.solve(gyro, rate[i, first:last].sum(axis=0) * averages.step_s)
            force = invert_readings(accel, means[i, :, ACCEL] - bias)
            before, after = force[:first], force[last:]
            change = after.mean(axis=0) - before.mean(axis=0)
            expected = cross(before.mean(axis=0), angle)
            # The noise is that of the difference of two halves: scaled to the lengths before and after the step.
            doubt = noise * own[v] * np.sqrt((1.0 / len(before) + 1.0 / len(after)) * 0.25 * count)
            if np.linalg.norm(change - expected) <= _AGREE * np.linalg.norm(expected) + z * doubt:
                out[v] = _AttitudeStep(first + 1, float(np.linalg.norm(angle)))
    return out


def _turning_power(rate: Array, sigma: list[Array], doubt: Array) -> list[Array]:
    """Squared rotation angles of spans of blocks, divided by their variance; an array (g, B - span + 1) per length."""
    power = []
    for span, one in zip(_SPANS, sigma, strict=True):
        beyond = np.maximum(np.abs(_span_means(rate, span)) - doubt, 0.0) / one
        power.append(span * np.einsum("gbc,gbc->gb", beyond, beyond))
    return power


def _span_means(blocks: Array, span: int) -> Array:
    """Moving means over ``span`` successive blocks, from (g, B, c) to (g, B - span + 1, c)."""
    total = np.cumsum(np.pad(blocks, ((0, 0), (1, 0), (0, 0))), axis=1)
    return np.asarray((total[:, span:] - total[:, :-span]) / span)


def _span_spread(averages: WindowAverages, sigma: Array) -> Array:
    """Ratio of the scatter of gyro means over spans of blocks to that of independent blocks, at least 1, (spans, 3).

    A filter correlates blocks of few samples: their sums then scatter more, and their differences less. The scatter is
    taken from a high quantile over all windows. A bump has too few blocks to affect it, and a quantile near the median
    would determine the tails less well.
    """
    parts: list[list[Array]] = [[] for _ in _SPANS]
    for v, means in averages.groups:
        rate = means[:, :, GYRO] - np.median(means[:, :, GYRO], axis=1, keepdims=True)
        for part, span in zip(parts, _SPANS, strict=True):
            part.append((np.abs(_span_means(rate, span)) * np.sqrt(span) / sigma[v, None, GYRO]).reshape(-1, 3))
    wide = [np.quantile(np.concatenate(part), _WIDE, axis=0) / _WIDE_SIGMAS for part in parts]
    return np.maximum(1.0, np.array(wide))


def _turning_span(power: list[Array], largest: float) -> tuple[int, int] | None:
    """First block of the step of a window, and one past its last block; None if the window has more than one step.

    One block is added on each side: it may contain a part of the step that is below the threshold.
    """
    at = np.concatenate([np.arange(len(p))[:, None] + [0, span] for p, span in zip(power, _SPANS, strict=True)])
    every = np.concatenate(power)
    loud = at[every > largest]
    first, last = at[int(np.argmax(every))].tolist()
    elsewhere = (loud[:, 1] <= first - 1) | (loud[:, 0] >= last + 1)
    return None if elsewhere.any() else (first - 1, last + 1)


def _step_noise(averages: WindowAverages, accel: Array) -> float:
    """Standard deviation of the difference between both halves of a window, m/s²; robust estimate over all windows."""
    change = np.empty((len(averages.window), 3))
    for v, means in averages.groups:
        half = means.shape[1] // 2
        change[v] = means[:, half:, ACCEL].mean(axis=1) - means[:, :half, ACCEL].mean(axis=1)
    return float(MAD * np.median(np.abs(invert_readings(accel, change))))


# --- creep -----------------------------------------------------------------------------------------------------------


def _creep(evidence: Evidence, averages: WindowAverages, done: Mask) -> tuple[int, float] | None:
    """Find the window with the fastest steady tilt, and its rate in rad/s; None if there is none.

    The accelerometers measure the tilt rate as a drift of the vertical, the gyros as a rate in addition to bias,
    g-sensitivity and Earth rate. Both measurements scatter over the windows: equally by bias instability, and more in
    shorter windows by noise. A creep must satisfy three conditions: the weighted mean of both is significant, the
    accelerometers alone show it, and both agree.

    Statistic: squared tilt rate over its variance, half of it for each of two components. Distribution: F with two
    degrees of freedom and those of the robust estimate of the variance.
    """
    gyro, accel, bias = evidence.raw_triads
    data = evidence.data
    assert data is not None
    V = len(averages.window)
    force, slope = np.empty((V, 3)), np.empty((V, 3))
    moment = np.empty(V)
    for v, means in averages.groups:
        count = means.shape[1]
        time = averages.step_s * (np.arange(count) - 0.5 * (count - 1))
        moment[v] = time @ time
        force[v] = means[:, :, ACCEL].mean(axis=1)
        slope[v] = np.einsum("b,gbc->gc", time / (time @ time), means[:, :, ACCEL])
    up = invert_readings(accel, force - bias)
    square = np.sum(up**2, axis=1, keepdims=True)
    if not np.all(square > 0.0):
        return None
    # On a body that rotates at ω, df/dt = -ω × f, which gives the component of ω normal to f.
    across = -cross(up, invert_readings(accel, slope)) / square
    plane = _horizontal(up / np.sqrt(square))
    by_accel = np.einsum("vjc,vc->vj", plane, across)
    by_gyro = np.einsum("vjc,vc->vj", plane, stationary_rate_residual(data, gyro)[averages.window])
    # A fit of least absolute deviations has as many zero residuals as unknowns: these do not show the scatter.
    tell = np.argsort(np.einsum("vj,vj->v", by_gyro, by_gyro))[_UNKNOWNS:]
    if len(tell) < _UNKNOWNS:
        return None
    freedom = max(4.0, _MAD_EFFICIENCY * by_gyro[tell].size)
    sigma = block_sigma(averages)
    noisier = np.maximum(1.0, (sigma / np.median(sigma, axis=0)).max(axis=1))
    a = noisier**2 * _scatter(by_accel, moment, np.arange(V))
    g = noisier**2 * _scatter(by_gyro, averages.blocks.astype(np.float64), tell)
    both = (by_accel / a[:, None] + by_gyro / g[:, None]) / (1.0 / a + 1.0 / g)[:, None]
    size2 = np.sum(both**2, axis=1)

    def plane_limit(probability: float, windows: int = 1) -> float:
        return 2.0 * float(limit("F", 2.0, freedom, tests=windows, shared=probability))

    apart2 = np.sum((by_accel - by_gyro) ** 2, axis=1)
    creeps = (
        ~done
        & (size2 * (1.0 / a + 1.0 / g) > plane_limit(FALSE_ALARM, V))
        & (np.sum(by_accel**2, axis=1) / a > plane_limit(_PLAUSIBLE))
        & ((apart2 < plane_limit(_CONTRARY) * (a + g)) | (apart2 < _AGREE**2 * size2))
    )
    if not creeps.any():
        return None
    fastest = int(np.argmax(np.where(creeps, size2, 0.0)))
    return fastest, float(np.sqrt(size2[fastest]))


def _scatter(values: Array, information: Array, tell: Indices) -> Array:
    """Variance of the values (V, 2) of each window, shape (V,); a robust estimate from the windows ``tell``.

    It is the larger of two estimates: a variance that is equal in all windows, and a variance that is inversely
    proportional to the information of a window.
    """
    shares = np.stack([np.ones(len(values)), information / information.max()])
    each = [np.median(np.abs(np.sqrt(share[tell, None]) * values[tell])) ** 2 / share for share in shares]
    return np.asarray(np.maximum(MAD**2 * np.maximum(*each), 1e-24))


def _horizontal(up: Array) -> Array:
    """Two orthogonal unit vectors normal to each of the unit vectors (n, 3), shape (n, 2, 3)."""
    first = cross(up, np.eye(3)[np.argmin(np.abs(up), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, cross(up, first)], axis=1)


# --- noise -----------------------------------------------------------------------------------------------------------


def _noisy(averages: WindowAverages, done: Mask) -> tuple[int, float, str] | None:
    """Find the noisiest window: its number, its noise relative to the others, and the sensor; None if none is noisy.

    The noise of single samples is tested first, then that of blocks. Statistic: variance from first differences,
    averaged over three axes, over its median. Distribution: chi-square over its degrees of freedom, two for each value.
    """
    blocks = np.empty((len(averages.window), 6))
    for v, means in averages.groups:
        blocks[v] = 0.5 * np.mean(np.diff(means, axis=1) ** 2, axis=1)
    # The variance from first differences of n white values has 2/3 n degrees of freedom.
    for variance, floor, freedom in (
        (averages.sample_variance, 2.0 * averages.least_variance, 2.0 * averages.count),
        (blocks, averages.least_variance / averages.size**2 + averages.block_doubt**2, 2.0 * averages.blocks),
    ):
        ratio = variance / np.maximum(np.median(variance, axis=0), floor)
        told = []
        for name, channels in (("gyros", GYRO), ("accelerometers", ACCEL)):
            power = ratio[:, channels].mean(axis=1)
            scatter = MAD * float(np.median(np.abs(np.log(np.maximum(power, 1e-12)))))
            least = np.maximum(_NOISIER, limit("chi-square", freedom, tests=4 * len(power)) / freedom)
            excess = np.where(done, 0.0, power / np.maximum(least, np.exp(_NOISE_SIGMAS * scatter)))
            loudest = int(np.argmax(excess))
            if excess[loudest] > 1.0:
                told.append((float(power[loudest]), loudest, name))
        if told:
            most, window, name = max(told)
            return window, float(np.sqrt(most)), name
    return None
