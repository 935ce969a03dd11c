"""Disturbances of stationary windows: vibration in all of them; oscillation at the start, bumps, creep and noise.

The tests run in this order, because an oscillation contains steps, a step looks like a drift, and all increase noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG_PER_H, MICRO_G
from srt.diagnosis.false_alarms import FALSE_ALARM, limit, robust_freedom, robust_sigma
from srt.diagnosis.findings import Fault
from srt.diagnosis.rotation_readings import AGREE, cross, invert_readings
from srt.diagnosis.window_averages import ACCEL, GYRO, NOISY
from srt.model.sensor_model import Triad
from srt.model.table1 import AXES
from srt.ranking import rounded

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.window_averages import WindowAverages
    from srt.types import Array, Indices, Mask

_BUMP: Final = 3
"""Number of blocks over which a bump rotates the unit; a longer motion is not a bump."""
_ONE_SIGN: Final = 0.9
"""Share of the power at the start of a window that has one sign, from which it fades, as behind a filter of the unit,
and does not oscillate: that of an oscillation is 0.55 if its amplitude halves with each half period."""
_SHOWN: Final = 0.1
"""Share of the power of a line from which a channel is named."""
_IN_WORDS: Final = {
    "gyro": ("gyro", "accelerometers", "°/s", 180.0 / np.pi),
    "accel": ("accelerometer", "gyros", "mg", 1e-3 / MICRO_G),
}
"""Name of a triad, the other triad, and its unit in reports with the factor to it."""
_DOUBTED: Final = 1e-4
"""p-value below which the tilt by accelerometers alone shows a creep, or differs from that by gyros."""


def disturbed_windows(evidence: Evidence) -> Iterator[Finding]:
    """Compare each window with the others for oscillation, bumps, creep and noise."""
    averages = evidence.window_averages
    if averages is None:
        return
    # If gyros lag or lead, their readings of a rotation reach into the windows, in which the unit is at rest.
    lagging = evidence.lag is not None
    ringing, amplitude = _oscillation(averages, by_gyros=not lagging)
    # Behind a filter a turn fades into the window after it, which is no noise.
    fading = np.any(ringing & (averages.head_sign > _ONE_SIGN), axis=1)
    if evidence.recording.fixture is None:
        ringing[:] = False  # a unit held by hand is never quite at rest
    # A step during an oscillation is a part of it, and no bump. An oscillation after a step is due to the bump.
    steps = _steps(evidence, averages)
    for v, (block, _) in tuple(steps.items()):
        if ringing[v].any() and ringing[v] @ (averages.heads <= block * averages.size):
            del steps[v]
    rings, done = np.asarray([ringing.any(axis=1)] * 2)
    rings[list(steps)], done[list(steps)] = False, True
    if rings.any():
        worst = int(np.argmax(np.where(rings, amplitude.max(axis=1), 0.0)))
        late = averages.late_variance[worst]
        excess = np.maximum(averages.head_power[worst, 0] - late, 0.0)
        sensor = int(np.argmax(excess / np.maximum(late, averages.least_variance))) // 3
        size = np.sqrt(2.0 * excess.reshape(2, 3)[sensor].sum())
        text = (f"{1e3 * size:.2g} mrad/s", f"{size:.2g} m/s²")[sensor]
        place = evidence.window_place(averages.window[worst])
        fades = sensor == 0 and averages.head_sign[worst, 0] > _ONE_SIGN
        what = "rates of the turn still fade" if fades else "fixture still oscillates"
        yield UNSETTLED.found(what=what, count=int(rings.sum()), amplitude=text, **place)
    if steps:
        v = max(steps, key=lambda v: steps[v][1])
        block, angle = steps[v]
        place = evidence.window_place(averages.window[v], (block + 0.5) * averages.step_s)
        yield BUMP.found(**place, angle_mrad=1e3 * angle)
    creep = _creep(evidence, averages, done)
    if creep is not None:
        v, rate = creep
        done[v] = True
        yield CREEP.found(rate_urad_s=1e6 * rate, **evidence.window_place(averages.window[v]))
    if lagging:
        return
    # The noise of windows held by hand scatters more than by chance.
    power, largest = averages.relative_noise()
    log = np.log(np.maximum(power, 1e-12))
    scatter = limit("normal", tests=power.size) * robust_sigma(log, axis=2)[:, :, None]
    loud = (log > np.maximum(np.log(largest), scatter)) & ~(done | fading)
    if loud.any():  # single samples first, then blocks
        kind = int(np.argmax(loud.any(axis=(1, 2))))
        sensor, v = divmod(int(np.argmax(np.where(loud[kind], power[kind], 0.0))), len(done))
        ratio, name = float(np.sqrt(power[kind, sensor, v])), ("gyros", "accelerometers")[sensor]
        yield NOISY_WINDOW.found(ratio=ratio, sensor=name, **evidence.window_place(averages.window[v]))


UNSETTLED: Final = Fault(
    "unsettled",
    "The fixture, or a filter of the unit, had not settled",
    "oscillation or fading readings at the start of windows, compared with their second half",
    "The {what} at the start of the stationary window from {time:.6g} s ({sequence}; amplitude {amplitude}; {count} "
    "such windows in the recording): wait longer after a rotation, or start the windows later.",
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


def vibration(evidence: Evidence) -> Iterator[Finding]:
    """Report the strongest line in the spectrum of the windows: vibration, or a line that is the unit's own."""
    data = evidence.data
    if data is None or data.vibration is None:
        return
    if (own := data.vibration.of_unit(data.windows.accel_mean)) is not None:
        sensor, share = own
        name, other, unit, per_si = _IN_WORDS[sensor]
        size = float(np.quantile(np.linalg.norm(getattr(data.vibration, sensor), axis=1), 0.75))
        yield SPECTRAL_LINE.found(
            channels=f"{name} {' and '.join(AXES[axis] for axis in np.flatnonzero(share > _SHOWN).tolist())}",
            frequency_hz=data.vibration.frequency_hz,
            amplitude=f"{size * per_si:.3g} {unit}",
            others=other,
        )
        return
    gyro, accel, bias = evidence.raw_triads
    # The mean of the stationary rates is the bias, because the Earth rate averages out over the poses.
    triads = Triad(gyro, np.zeros(3), data.windows.gyro_mean.mean(axis=0)), Triad(accel, np.zeros(3), bias)
    line = data.vibration
    # Amplitude in a quarter of the windows, along the direction of the vibration; the three channels are in phase.
    rate, force = (
        float(np.quantile(np.linalg.norm(line.amplitude(name, triad), axis=1), 0.75))
        for name, triad in zip(("gyro", "accel"), triads, strict=True)
    )
    gyro_bias, accel_bias = (1e-4 * float(values.max()) for values in data.rectified(*triads))  # by 100 ppm
    yield VIBRATION.found(
        frequency_hz=line.frequency_hz,
        angle_urad=1e6 * rate / (2.0 * np.pi * line.frequency_hz),
        force_mg=force / (1e3 * MICRO_G),
        gyro_deg_h=gyro_bias / DEG_PER_H,
        accel_ug=accel_bias / MICRO_G,
    )


VIBRATION: Final = Fault(
    "vibration",
    "The unit vibrates in the stationary windows",
    "a spectral line at one frequency in more than half of the windows, or a stronger one in more than a quarter",
    "The unit vibrates at {frequency_hz:.4g} Hz in the stationary windows, with amplitudes of {angle_urad:.3g} µrad "
    "and {force_mg:.3g} mg. With a scale-factor asymmetry of 100 ppm, this causes biases of up to {gyro_deg_h:.2g} °/h"
    " and {accel_ug:.2g} µg. The calibration corrects these biases; isolate the table, or stop the source of the "
    "vibration.",
    "warning",
    vibration,
)

SPECTRAL_LINE: Final = Fault(
    "spectral_line",
    "One sensor has a line in its spectrum at rest",
    "a spectral line as of a vibration, which one triad alone shows and whose direction in the unit is the same in all "
    "attitudes",
    "In the stationary windows the readings of {channels} have a line at {frequency_hz:.4g} Hz with an amplitude of "
    "{amplitude}. The {others} do not show it, and it keeps its direction in the unit in all attitudes: its source "
    "turns with the unit (clocks, converter, supply, or the drive of a fixture's inner axis). The calibration removes "
    "it.",
    "warning",
    vibration,
)


def _oscillation(averages: WindowAverages, *, by_gyros: bool) -> tuple[Mask, Array]:
    """Windows that oscillate at the start, by length of the start part, (V, H), and by how much, by sensor, (V, 2).

    Statistic: variance at the start over that of the noise, averaged over three axes. Distribution: chi-square over its
    degrees of freedom, which follow from the autocorrelation.
    """
    late = averages.late_variance
    noise = np.maximum(np.maximum(late, np.median(late, axis=0)), averages.least_variance)
    ratio = (averages.head_power / noise[:, None]).reshape(*averages.head_power.shape[:2], 2, 3).mean(axis=3)
    freedom = averages.head_freedom
    largest = limit("chi-square", freedom, tests=ratio.size, shared=FALSE_ALARM) / freedom
    loud = ratio > np.maximum(NOISY, largest)
    return np.asarray(loud[:, :, 0 if by_gyros else 1 :].any(axis=2)), np.asarray(ratio.max(axis=1))


def _steps(evidence: Evidence, averages: WindowAverages) -> dict[int, tuple[int, float]]:
    """Block and angle (rad) of a step of the attitude, by window: the accelerometers confirm a rotation by the gyros.

    Statistic: squared rotation angle in three successive blocks over its variance. Distribution: chi-square, three
    degrees of freedom.
    """
    gyro, accel, bias = evidence.raw_triads
    tests = int(averages.blocks.sum())
    largest, z = limit("chi-square", 3.0, tests=tests), limit("normal", tests=tests, both_sides=True)
    sigma = averages.sigma[:, GYRO] / np.sqrt(_BUMP)
    rates = [means[:, :, GYRO] - np.median(means[:, :, GYRO], axis=1, keepdims=True) for _, means in averages.groups]
    moving = [sum(rate[:, i : rate.shape[1] - _BUMP + 1 + i] for i in range(_BUMP)) / _BUMP for rate in rates]
    # A filter correlates blocks of few samples: their sums then scatter more, and their differences less. The scatter
    # is taken from a quantile over all windows that a bump has too few blocks to affect.
    relative = [(m / sigma[v, None]).reshape(-1, 3) for (v, _), m in zip(averages.groups, moving, strict=True)]
    scatter = robust_sigma(np.concatenate(relative), axis=0, quantile=0.95)
    sigma = sigma * np.maximum(1.0, scatter)
    own = np.maximum(1.0, (averages.sigma[:, ACCEL] / np.median(averages.sigma[:, ACCEL], axis=0)).max(axis=1))
    change = np.empty((len(sigma), 3))
    for v, means in averages.groups:
        halves = np.array_split(means[:, :, ACCEL], 2, axis=1)
        change[v] = halves[1].mean(axis=1) - halves[0].mean(axis=1)
    noise = robust_sigma(invert_readings(accel, change))
    out = {}
    for (windows, means), rate, mean in zip(averages.groups, rates, moving, strict=True):
        beyond = np.maximum(np.abs(mean) - averages.block_doubt[GYRO], 0.0) / sigma[windows, None]
        power = np.einsum("gbc,gbc->gb", beyond, beyond)
        loud, count = power > largest, means.shape[1]
        for i in np.flatnonzero(loud.any(axis=1)).tolist():
            # One block on each side may contain a part of the step that is below the limit.
            first = int(np.argmax(power[i])) - 1
            last = first + _BUMP + 2
            if first < 2 or last > count - 2 or loud[i, : first - _BUMP + 1].any() or loud[i, last:].any():
                continue  # too close to an end, or another motion in the window
            angle = np.linalg.solve(gyro, rate[i, first:last].sum(axis=0) * averages.step_s)
            force = invert_readings(accel, means[i, :, ACCEL] - bias)
            before, after = force[:first], force[last:]
            expected = cross(before.mean(axis=0), angle)
            off = np.linalg.norm(after.mean(axis=0) - before.mean(axis=0) - expected)
            # The noise is that of the difference of two halves: scaled to the lengths before and after the step.
            doubt = noise * own[windows[i]] * np.sqrt((1.0 / len(before) + 1.0 / len(after)) * 0.25 * count)
            if off <= AGREE * np.linalg.norm(expected) + z * doubt:
                out[int(windows[i])] = first + 2, float(np.linalg.norm(angle))
    return out


def _creep(evidence: Evidence, averages: WindowAverages, done: Mask) -> tuple[int, float] | None:
    """Find the window with the fastest steady tilt, and its rate in rad/s; None if there is none.

    The accelerometers measure the tilt rate as a drift of the vertical, the gyros as a rate in addition to bias,
    g-sensitivity and Earth rate. The weighted mean of both must be significant, the accelerometers alone must show it,
    and both must agree. Statistic: squared tilt rate over its variance, half of it for each of two components.
    Distribution: F with two degrees of freedom and those of the robust estimate of the variance.
    """
    rates, fit = evidence.stationary_rates, evidence.stationary_rate_fit
    if rates is None or fit is None:
        return None
    gyro, accel, bias = evidence.raw_triads
    V = len(averages.window)
    force, slope = np.empty((2, V, 3))
    moment = np.empty(V)
    for v, means in averages.groups:
        time = averages.step_s * (np.arange(means.shape[1]) - 0.5 * (means.shape[1] - 1))
        moment[v] = time @ time
        force[v] = means[:, :, ACCEL].mean(axis=1)
        slope[v] = np.einsum("b,gbc->gc", time / (time @ time), means[:, :, ACCEL])
    up = invert_readings(accel, force - bias)
    size = np.linalg.norm(up, axis=1, keepdims=True)
    if not np.all(size > 0.0):
        return None
    known = np.isin(averages.window, rates.window)
    seen = np.flatnonzero(known)
    left = np.zeros((V, 3))
    left[seen] = fit.residual[np.searchsorted(rates.window, averages.window[seen])]
    # On a body that rotates at ω, df/dt = -ω × f, which gives the component of ω normal to f.
    tilt = np.stack([-cross(up, invert_readings(accel, slope)) / size**2, invert_readings(gyro, left)])
    first = cross(up, np.eye(3)[np.argmin(rounded(np.abs(up)), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    tilt = np.einsum("vjc,svc->svj", np.stack([first, cross(up / size, first)], axis=1), tilt)
    share = fit.freedom / rates.rate.size
    noisier = np.maximum(1.0, (averages.sigma / np.median(averages.sigma, axis=0)).max(axis=1))
    variance = noisier**2 * np.stack(
        [_variance(tilt[0], moment), _variance(tilt[1], averages.blocks.astype(np.float64), seen) / share]
    )
    weight = 1.0 / variance
    square = np.sum((np.einsum("sv,svj->vj", weight, tilt) / weight.sum(axis=0)[:, None]) ** 2, axis=1)
    apart = np.sum((tilt[0] - tilt[1]) ** 2, axis=1)
    freedom = max(4.0, robust_freedom(2.0 * len(seen)) * share)
    least, doubted = (
        2.0 * limit("F", 2.0, freedom, tests=tests, shared=p) for tests, p in ((V, FALSE_ALARM), (1, _DOUBTED))
    )
    creeps = (
        known
        & ~done
        & (square * weight.sum(axis=0) > least)
        & (np.sum(tilt[0] ** 2, axis=1) > doubted * variance[0])
        & ((apart < doubted * variance.sum(axis=0)) | (apart < AGREE**2 * square))
    )
    if not creeps.any():
        return None
    fastest = int(np.argmax(np.where(creeps, square, 0.0)))
    return fastest, float(np.sqrt(square[fastest]))


def _variance(values: Array, information: Array, tell: Indices | slice = slice(None)) -> Array:
    """Variance of the values (V, 2) of each window, shape (V,); a robust estimate from the windows ``tell``.

    It is the larger of one that is equal in all windows, and one inversely proportional to the information of a window.
    """
    shares = np.stack([np.ones(len(values)), information / information.max()])
    each = robust_sigma(np.sqrt(shares[:, tell, None]) * values[tell], axis=(1, 2))[:, None] ** 2 / shares
    return np.asarray(np.maximum(each.max(axis=0), 1e-24))
