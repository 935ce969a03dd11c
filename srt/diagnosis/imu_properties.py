"""Properties of the IMU: temperature, bias drift, white noise compared with its stated value, omitted asymmetry.

For an IMU with the stated noise, the Allan variance at the averaging time τ is ``A(τ) = N²/τ + 3 q²/τ² + B²`` (angle or
velocity random walk N, angle quantization error q, bias instability B). For white noise, the differences between
successive averages are independent, also between octaves of τ. Their weighted sum of squares therefore estimates N²
with a known chi-square distribution.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri

from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from srt.diagnosis.false_alarms import FALSE_ALARM, limit
from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.triad_fits import MOST_OUTLIERS
from srt.diagnosis.window_averages import ACCEL, GYRO, NOISY
from srt.estimation.options import Options
from srt.model.table1 import AXES
from srt.noise.noise_model import hidden_gyro_step
from srt.result.verdict import USABLE
from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Sensor

BENCH_C: Final = (-60.0, 90.0)
"""Lowest and highest plausible temperature, °C: parts are specified for -40 to 85 °C, military ones from -55 °C."""
_OTHER_UNITS: Final = ((150.0, "degrees Fahrenheit"), (400.0, "kelvin"), (np.inf, "parts of a degree, or raw counts"))
"""Upper limits of the highest value of the column, and the unit that a value below the limit suggests."""
STEADY_C: Final = 2.0
"""Largest range of the mean temperatures of the sequences, °C, for a constant temperature: data sheets call ±1 °C
constant."""
NOISE_RATIO: Final = math.sqrt(NOISY)
"""Largest ratio of measured to stated noise, or of stated to measured noise, that is no finding: units of one type
differ by as much."""
_SHORTEST_S: Final = 0.05
"""Shortest averaging time, s: filters and coarse quantization dominate shorter averages."""
_DOUBT: Final = 0.5
"""Relative standard deviation of the quantization and bias-instability terms, which do not average out; largest ratio
of the quantization step to the stated noise of a sample, and of a power to that of a single pulse, for a test."""
_NO_ASYMMETRY: Final = NAMES[GROUP_SLICES["gyro_asymmetry"]]
"""Gyro parameters that ``--no-asymmetry`` fixes."""


def temperature(evidence: Evidence) -> Iterator[Finding]:
    """Test the range of the temperature column, and the mean temperatures of the sequences."""
    T, data = evidence.recording.temperature, evidence.data
    if T is None:
        return
    low, high = float(T.min()), float(T.max())
    if low < BENCH_C[0] or high > BENCH_C[1]:
        unit = "raw counts" if low < BENCH_C[0] else next(name for most, name in _OTHER_UNITS if high <= most)
        yield TEMPERATURE_UNIT.found(low=low, high=high, unit=unit)
    elif data is not None:
        samples = data.windows.samples
        parts = np.column_stack([samples[data.start, 0], samples[data.end, 1]]).tolist()
        means = [float(T[a:b].mean()) for a, b in sorted(parts)]
        spread = float(np.ptp(means))
        if spread > STEADY_C:
            yield TEMPERATURE_DRIFT.found(first=means[0], last=means[-1], range=spread, mean=float(T.mean()))


TEMPERATURE_UNIT: Final = Fault(
    "temperature_unit",
    "Temperature is not in °C",
    "range of the temperature column",
    "The temperature runs from {low:.4g} to {high:.4g}, which looks like {unit}, but °C is expected: convert the "
    "column.",
    "warning",
    temperature,
)
TEMPERATURE_DRIFT: Final = Fault(
    "temperature_drift",
    "The temperature changed during the test",
    "mean temperature of each sequence",
    "The temperature changed from {first:.4g} to {last:.4g} °C during the test (range {range:.3g} °C): let the unit "
    "warm up before the test; the calibration holds for the mean temperature of {mean:.4g} °C.",
    "warning",
    temperature,
)


def gyro_bias_drift(evidence: Evidence) -> Iterator[Finding]:
    """Test the stationary rates, after removal of g-sensitivity and Earth rate, for a trend over time.

    Statistic: change of the bias of an axis over its standard deviation. Distribution: t, with the degrees of freedom
    of the stationary rates.
    """
    fit, data = evidence.stationary_rate_fit, evidence.data
    if fit is None or data is None or hidden_gyro_step(evidence.recording, data.windows.samples):
        return  # steps that cannot be seen any more would pass for a drift, or hide one
    ratio = np.abs(fit.drift) / fit.drift_sigma
    axis = int(np.argmax(ratio))
    if ratio[axis] > limit("t", fit.freedom, tests=3, both_sides=True):
        yield GYRO_BIAS_DRIFT.found(axis=AXES[axis], change_deg_h=float(fit.drift[axis] / DEG_PER_H))


GYRO_BIAS_DRIFT: Final = Fault(
    "gyro_bias_drift",
    "The gyro bias drifts during the test",
    "trend of the stationary rates, compared with their noise and the stated bias instability",
    "The bias of gyro {axis} changed by {change_deg_h:+.3g} °/h during the test, more than its noise and bias "
    "instability allow: let the unit warm up, or state gyro_bias_instability_deg_per_h.",
    "warning",
    gyro_bias_drift,
)


def accel_bias_drift(evidence: Evidence) -> Iterator[Finding]:
    """Report the drift of the accelerometer biases that a calibration estimates from its residuals."""
    result = evidence.result
    for drift in () if result is None else result.diagnostics.drift or ():
        if drift.change_m_s2 is not None:
            x, y, z = (drift.change_m_s2 / (1e3 * MICRO_G)).tolist()
            yield ACCEL_BIAS_DRIFT.found(form=drift.form, x_mg=x, y_mg=y, z_mg=z)
            return


ACCEL_BIAS_DRIFT: Final = Fault(
    "accel_bias_drift",
    "The accelerometer bias drifts during the test",
    "residuals of a calibration: a drift that is linear in time or temperature, exponential (warm-up), a random "
    "walk or a step, against no drift",
    "The accelerometer biases changed by {x_mg:+.3g}, {y_mg:+.3g}, {z_mg:+.3g} mg (x, y, z; {form}) during the test, "
    "more than their noise and bias instability allow: let the unit warm up, and calibrate with least-squares, ekf or "
    "graph, which model the drift.",
    "warning",
    accel_bias_drift,
    needs_result=True,
)


def white_noise(evidence: Evidence) -> Iterator[Finding]:
    """Test the noise of the stationary windows against its stated value: of each channel, or of the triad.

    Statistic: weighted mean of the Allan variances over the stated one. Distribution: chi-square, with the degrees of
    freedom of :func:`white_noise_test`.
    """
    rows: tuple[tuple[Sensor, float, str, str], ...] = (
        ("gyro", DEG_PER_SQRT_H, "Gyro {} shows", "The gyros show"),
        ("accel", MICRO_G, "Accelerometer {} shows", "The accelerometers show"),
    )
    for sensor, unit, one, triad in rows:
        shown = white_noise_test(evidence, sensor)
        if shown is None:
            continue
        # Eight tests: too much and too little noise, of three channels and of the triad.
        distance = np.abs(np.log(np.maximum(shown.found / shown.stated, 1e-9)))
        odd = (np.minimum(shown.more, shown.less) < FALSE_ALARM / 8.0) & (distance > np.log(NOISE_RATIO))
        if odd.any():
            # If the test of the triad fails, the triad is reported, else the channel whose ratio differs most from 1.
            which = 3 if odd[3] else int(np.argmax(np.where(odd, distance, -1.0)))
            yield NOISE[sensor].found(
                who=triad if which == 3 else one.format(AXES[which]),
                found=float(shown.found[which] / unit),
                stated=shown.stated / unit,
            )


NOISE: Final = by_sensor(
    "noise",
    "The [gyro|accelerometer] noise differs from the stated value",
    "noise in the stationary windows against the stated value",
    "{who} [an angle random walk|a noise] of {found:.3g} [°/√h|µg/√Hz] at rest, but {stated:.3g} [°/√h|µg/√Hz] is "
    "stated: correct [gyro_noise_deg_per_sqrt_h|accel_noise_ug_per_sqrt_hz], or look for vibration.",
    "warning",
    white_noise,
)


class WhiteNoiseTest(NamedTuple):
    """White noise of one triad compared with its stated value, SI units.

    Attributes
    ----------
    stated : float
        Stated angle or velocity random walk, rad/√s or m/s²·√s.
    found : ndarray, shape (4,)
        Measured noise of x, y, z, and of all three.
    more, less : ndarray, shape (4,)
        p-values of the measured noise under the stated noise: probability of at least, and of at most, as much.
    """

    stated: float
    found: Array
    more: Array
    less: Array


def white_noise_test(evidence: Evidence, sensor: Sensor) -> WhiteNoiseTest | None:
    """Test the stationary noise of a triad; None if no noise is stated, or if the windows do not determine it.

    Windows that are far noisier than the others are excluded.
    """
    data, averages, noise = evidence.data, evidence.window_averages, evidence.recording.noise
    stated = getattr(noise, f"{sensor}_noise")
    if data is None or averages is None or stated is None:
        return None
    channels = GYRO if sensor == "gyro" else ACCEL
    step = np.where(averages.pulses, 0.0, averages.step)[channels]
    if np.any(step > _DOUBT * stated / np.sqrt(evidence.dt)):
        return None  # quantization is so coarse that it changes the noise
    # Half the squared differences between successive averages, and their number, by octave of the averaging time.
    octaves = int(np.log2(averages.blocks.max()))
    power, pairs = np.zeros((len(averages.window), octaves, 3)), np.full((len(averages.window), octaves), np.nan)
    for windows, means in averages.groups:
        x = means[:, :, channels]
        for octave in range(int(np.log2(x.shape[1]))):
            even, odd = x[:, : x.shape[1] // 2 * 2 : 2], x[:, 1::2]
            power[windows, octave] = 0.5 * np.einsum("wnc,wnc->wc", odd - even, odd - even)
            pairs[windows, octave] = even.shape[1]
            x = 0.5 * (even + odd)
    summed, own = power.sum(axis=2), 3.0 * pairs
    typical = np.nanmedian(summed / chdtri(own, 0.5), axis=0)
    quiet = ~np.any(summed > typical * limit("chi-square", own, tests=own.size), axis=1)
    quiet |= quiet.mean() < 1.0 - MOST_OUTLIERS
    tau = averages.step_s * np.exp2(np.arange(octaves))
    used = np.isfinite(pairs[quiet]).any(axis=0) & (tau > 0.999 * _SHORTEST_S)
    tau, total = tau[used, None], power[quiet].sum(axis=0)[used]
    count = np.nansum(pairs[quiet], axis=0)[used, None]
    # Constant readings do not show the noise. Corrected readings are never quite constant: the correction adds parts of
    # the pulses of the other axes.
    pulse = getattr(noise, f"{sensor}_quantization") or 0.0
    if len(tau) == 0 or np.any(total[0] <= 0.5 * _DOUBT * (pulse / tau[0]) ** 2):
        return None
    instability = getattr(noise, f"{sensor}_bias_instability") or 0.0
    other = 3.0 * getattr(data.noise, f"{sensor}_edge") ** 2 / tau**2 + instability**2
    other = other + step**2 * evidence.dt / 12.0 / tau
    # Three channels, and the triad: shape (octaves, 4).
    shown, beside = (np.column_stack([x, x.mean(axis=1)]) for x in (total / count, other))
    expected = stated**2 / tau + beside
    variance = 2.0 * expected**2 / (count * [1, 1, 1, 3]) + (_DOUBT * beside) ** 2
    weight = 1.0 / (tau * variance)
    weight /= np.sum(weight / tau, axis=0)
    found = np.sqrt(np.maximum(np.sum(weight * (shown - beside), axis=0), 0.0))
    # The weighted sum of squares is approximated by a scaled chi-square with the same mean and variance.
    mean = np.sum(weight * expected, axis=0)
    freedom = 2.0 * mean**2 / np.sum(weight**2 * variance, axis=0)
    at = np.sum(weight * shown, axis=0) / mean * freedom
    return WhiteNoiseTest(float(stated), found, chdtrc(freedom, at), chdtr(freedom, at))


def asymmetry_omitted(evidence: Evidence) -> Iterator[Finding]:
    """Test the gyro asymmetry that a second calibration estimates, if the options of the calibration fix it.

    Statistic: difference of the asymmetry over its standard deviation. Distribution: t, with the degrees of freedom of
    the stationary rates.
    """
    fit = evidence.stationary_rate_fit
    held = evidence.result if set(_NO_ASYMMETRY) <= set(evidence.options.fixed_names) and fit is not None else None
    # A calibration that omits an asymmetry may be inconsistent for this reason.
    if held is None or fit is None or held.status not in (*USABLE, "inconsistent"):
        return
    # A g-sensitivity adds a bias in the windows, but averages out over a rotation, in which gravity rotates: if it is
    # not estimated, it looks like an asymmetry. Of the other options, the automatic estimator may not have all.
    hold = tuple(name for name in evidence.options.hold if name not in _NO_ASYMMETRY)
    free = evidence.calibrated(Options(hold=hold, gyro_bias="g-sensitive"))
    if free is None or free.status not in USABLE:
        return
    part = GROUP_SLICES["gyro_asymmetry"]
    chi_square, freedom = free.noise.chi_square, free.noise.degrees_of_freedom
    inflation = max(1.0, chi_square / freedom) if freedom and chi_square is not None else 1.0
    sigma = np.sqrt(inflation) * free.sigma[part]
    found, fixed = free.errors.vector[part], held.errors.vector[part]
    with np.errstate(invalid="ignore"):
        ratio = np.nan_to_num(np.abs(found - fixed) / sigma)  # the sigma of an asymmetry that is not observable is NaN
    axis = int(np.argmax(ratio))
    if ratio[axis] > limit("t", fit.freedom, tests=3, both_sides=True):
        yield ASYMMETRY_OMITTED.found(
            axis=AXES[axis],
            found_ppm=float(found[axis] * 1e6),
            sigma_ppm=float(sigma[axis] * 1e6),
            held_ppm=float(fixed[axis] * 1e6),
        )


ASYMMETRY_OMITTED: Final = Fault(
    "asymmetry_omitted",
    "Scale-factor asymmetry was fixed, but the data show it",
    "gyro asymmetry of a second calibration that estimates it",
    "Gyro {axis} has a scale-factor asymmetry of {found_ppm:.3g} ± {sigma_ppm:.2g} ppm, but it is fixed at "
    "{held_ppm:.3g} ppm: omit --no-asymmetry.",
    "warning",
    asymmetry_omitted,
    needs_result=True,
)
