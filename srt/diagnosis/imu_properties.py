"""Properties of the IMU: temperature, bias drift, white noise compared with its stated value, omitted asymmetry.

For an IMU with the stated noise, the Allan variance at the averaging time τ is ``A(τ) = N²/τ + 3 q²/τ² + B²`` (angle or
velocity random walk N, angle quantization error q, bias instability B). For white noise, the differences between
successive averages are independent, also between octaves of τ. Their weighted sum of squares therefore estimates N²
with a known chi-square distribution.

Averages over less than :data:`SHORTEST_S` are not used, because filters and coarse quantization dominate them. Windows
that are far noisier than the others are excluded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri

from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, EARTH_RATE_RAD_S, MICRO_G
from srt.diagnosis.false_alarms import FALSE_ALARM, limit
from srt.diagnosis.findings import Fault, by_sensor
from srt.estimation.options import Options
from srt.exceptions import DataError
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step
from srt.result.verdict import USABLE
from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.stationary_rates import StationaryRateFit
    from srt.result.calibration import Calibration
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask, Sensor


BENCH_C: Final = (-60.0, 90.0)
"""Lowest and highest plausible temperature, °C: parts are specified for -40 to 85 °C, military ones from -55 °C."""
_OTHER_UNITS: Final = (
    (150.0, "degrees Fahrenheit"),
    (200.0, "tenths of a degree, or raw counts"),
    (400.0, "kelvin"),
    (1000.0, "tenths of a degree, or raw counts"),
    (10_000.0, "hundredths of a degree, or raw counts"),
    (np.inf, "thousandths of a degree, or raw counts"),
)
"""Upper limits of the highest value of the column, and the unit that a value below the limit suggests."""
STEADY_C: Final = 2.0
"""Largest range of the mean temperatures of the sequences, °C, for a constant temperature: data sheets call ±1 °C
constant."""
NOISE_RATIO: Final = 1.5
"""Largest ratio of measured to stated noise, or of stated to measured noise, that is no finding: units of one type
differ by as much."""
_NO_ASYMMETRY: Final = NAMES[GROUP_SLICES["gyro_asymmetry"]]
"""Gyro parameters that ``--no-asymmetry`` fixes."""


def temperature(evidence: Evidence) -> Iterator[Finding]:
    """Test the range of the temperature column, and the mean temperatures of the sequences."""
    T = evidence.recording.temperature
    if T is None:
        return
    low, high = float(T.min()), float(T.max())
    if low < BENCH_C[0] or high > BENCH_C[1]:
        unit = "raw counts" if low < BENCH_C[0] else next(name for most, name in _OTHER_UNITS if high <= most)
        yield TEMPERATURE_UNIT.found(low=low, high=high, unit=unit)
        return
    data = evidence.data
    if data is None:
        return
    samples = data.windows.samples
    first, last = samples[data.start, 0], samples[data.end, 1]
    by_sequence = np.array([T[a:b].mean() for a, b in zip(first.tolist(), last.tolist(), strict=True)])
    if np.ptp(by_sequence) > STEADY_C:
        yield TEMPERATURE_DRIFT.found(
            first=float(by_sequence[np.argmin(first)]),
            last=float(by_sequence[np.argmax(last)]),
            range=float(np.ptp(by_sequence)),
            mean=float(T.mean()),
        )


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
    fit = evidence.stationary_rate_fit
    if fit is None:
        return
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
        ratio = shown.found / shown.stated
        # Eight tests: too much and too little noise, of three channels and of the triad.
        odd = np.where(ratio > 1.0, shown.more, shown.less) < FALSE_ALARM / 8.0
        odd &= (ratio > NOISE_RATIO) | (ratio < 1.0 / NOISE_RATIO)
        if not odd.any():
            continue
        # If the test of the triad fails, the triad is reported, else the channel whose ratio differs most from 1.
        distance = np.abs(np.log(np.maximum(ratio, 1e-9)))
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


def asymmetry_omitted(evidence: Evidence) -> Iterator[Finding]:
    """Test the gyro asymmetry that a second calibration estimates, if the options of the calibration fix it.

    Statistic: difference of the asymmetry over its standard deviation. Distribution: t, with the degrees of freedom of
    the stationary rates.
    """
    if not set(_NO_ASYMMETRY) <= set(evidence.options.fixed_names) or evidence.data is None:
        return
    held = evidence.result
    fit = evidence.stationary_rate_fit
    # A calibration that omits an asymmetry may be inconsistent for this reason.
    if held is None or held.status not in (*USABLE, "inconsistent") or fit is None:
        return
    free = _with_asymmetry(evidence, fit)
    if free is None or free.status not in USABLE:
        return
    part = GROUP_SLICES["gyro_asymmetry"]
    chi_square, freedom = free.noise.chi_square, free.noise.degrees_of_freedom
    inflation = max(1.0, chi_square / freedom) if freedom and chi_square is not None else 1.0
    sigma = np.sqrt(inflation * free.sigma[part] ** 2 + _of_g_sensitivity(evidence.data, fit) ** 2)
    off = free.errors.vector[part] - held.errors.vector[part]
    with np.errstate(invalid="ignore"):
        ratio = np.nan_to_num(np.abs(off) / sigma)  # the sigma of an asymmetry that is not observable is NaN
    axis = int(np.argmax(ratio))
    if ratio[axis] > limit("t", fit.freedom, tests=3, both_sides=True):
        yield ASYMMETRY_OMITTED.found(
            axis=AXES[axis],
            found_ppm=float(free.errors.vector[part][axis] * 1e6),
            sigma_ppm=float(sigma[axis] * 1e6),
            held_ppm=float(held.errors.vector[part][axis] * 1e6),
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


def _with_asymmetry(evidence: Evidence, fit: StationaryRateFit) -> Calibration | None:
    """Calibrate with asymmetry, from gyro readings compensated for g-sensitivity.

    A g-sensitivity adds a bias in the windows, but averages out over a rotation, in which gravity rotates. If the bias
    of the windows is subtracted from a pair of rotations in both senses, an apparent asymmetry remains.
    """
    from srt.estimation.registry import automatic_estimator, find_estimator

    recording = evidence.recording
    latitude = recording.site.latitude_rad
    vertical = 0.0 if latitude is None else -EARTH_RATE_RAD_S * float(np.sin(latitude))
    # The stationary specific force is -g times the downward vertical. The formula holds for increments and for rates.
    gyro = recording.gyro + recording.accel @ (fit.gamma(vertical).T / recording.site.gravity_m_s2)
    changed = replace(recording, gyro=gyro, sequences=evidence.labels)
    # Only the fixed parameters are taken over: the automatic estimator may not have the other options.
    options = Options(hold=tuple(name for name in evidence.options.hold if name not in _NO_ASYMMETRY))
    try:
        return find_estimator(automatic_estimator(changed))(changed, options)
    except (DataError, np.linalg.LinAlgError):
        return None


def _of_g_sensitivity(data: PreparedRecording, fit: StationaryRateFit) -> float:
    """Standard deviation of the asymmetry due to that of the g-sensitivity, over the duration of a full rotation."""
    samples, rotation = data.windows.samples, data.rotation
    duration = float(np.median(rotation[:, 1] - rotation[:, 0])) * data.recording.nominal_interval_s
    assert len(samples) > 0
    return float(np.max(fit.g_sensitivity_sigma)) * duration / (2.0 * np.pi)


SHORTEST_S: Final = 0.05
"""Shortest averaging time at which random walk dominates the Allan variance, s."""
_LEAST_AVERAGES: Final = 16
"""Fewest averages in a window of median length; in shorter windows the averages are over less than SHORTEST_S."""
_DOUBT: Final = 0.5
"""Relative standard deviation of the quantization and bias-instability terms, which do not average out."""
_OUTLIER_PROBABILITY: Final = 1e-6
"""Probability that any window of a recording with normal noise is excluded."""
_MOST_OUTLIERS: Final = 0.3
"""Largest share of windows that may be excluded: if more are noisy, all are used, as this is not the noise of a few
windows."""
_RESOLUTION_SAMPLES: Final = 4000
"""Number of readings from which the quantization step is taken."""
_ONE_PULSE: Final = 0.5
"""Share of the power of a single pulse below which the readings of all windows count as constant; a correction of the
scale factor changes the size of a pulse by less."""
_COARSE: Final = 0.5
"""Largest ratio of the quantization step to the stated noise of a sample at which the noise can be measured."""


@dataclass(frozen=True, slots=True)
class WhiteNoiseTest:
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
    """Test the stationary noise of a triad; None if no noise is stated, or if the windows do not determine it."""
    data = evidence.data
    stated = getattr(evidence.recording.noise, f"{sensor}_noise")
    if data is None or stated is None:
        return None
    dt = evidence.dt
    step = _step(evidence, data, sensor)
    if np.any(step > _COARSE * stated / np.sqrt(dt)):
        return None  # quantization is so coarse that it changes the noise
    powers = _powers(evidence, data, sensor)
    if powers is None:
        return None
    tau, power, pairs = powers
    kept = ~_noisy(power, pairs)
    total, count = power[kept].sum(axis=0), pairs[kept].sum(axis=0)  # (octaves, 3), (octaves,)
    used = count > 0
    tau, total, count = tau[used], total[used], count[used]
    # Constant readings do not show the noise. Corrected readings are never quite constant: the correction adds parts of
    # the pulses of the other axes.
    pulse = getattr(evidence.recording.noise, f"{sensor}_quantization") or 0.0
    if len(tau) == 0 or np.any(total[0] <= 0.5 * _ONE_PULSE * (pulse / tau[0]) ** 2):
        return None
    edge = getattr(data.noise, f"{sensor}_edge")
    instability = getattr(evidence.recording.noise, f"{sensor}_bias_instability") or 0.0
    other = 3.0 * edge**2 / tau[:, None] ** 2 + instability**2 + step**2 * dt / 12.0 / tau[:, None]
    found, more, less = np.empty(4), np.empty(4), np.empty(4)
    for i in range(4):
        channels = slice(i, i + 1) if i < 3 else slice(0, 3)
        m = (count * (1 if i < 3 else 3)).astype(np.float64)
        shown = total[:, channels].sum(axis=1) / m
        beside = other[:, channels].mean(axis=1)
        expected = stated**2 / tau + beside
        variance = 2.0 * expected**2 / m + (_DOUBT * beside) ** 2
        weight = 1.0 / (tau * variance)
        information = float(np.sum(weight / tau))
        found[i] = np.sqrt(max(0.0, float(weight @ (shown - beside)) / information))
        # The weighted sum of squares is approximated by a scaled chi-square with the same mean and variance.
        mean = float(weight @ expected) / information
        freedom = 2.0 * mean**2 * information
        at = float(weight @ shown) / information / mean * freedom
        more[i], less[i] = chdtrc(freedom, at), chdtr(freedom, at)
    return WhiteNoiseTest(float(stated), found, more, less)


def _step(evidence: Evidence, data: PreparedRecording, sensor: Sensor) -> Array:
    """Quantization step of single readings, as a rate, shape (3,); zero for readings that are pulse counts."""
    if getattr(data.noise, f"{sensor}_edge").any():
        return np.zeros(3)
    table = getattr(evidence.recording, sensor)
    samples = data.windows.samples
    stride = max(1, int((samples[:, 1] - samples[:, 0]).sum()) // _RESOLUTION_SAMPLES)
    return smallest_step(np.concatenate([table[a:b:stride] for a, b in samples.tolist()])) * evidence.per_rate


def _powers(evidence: Evidence, data: PreparedRecording, sensor: Sensor) -> tuple[Array, Array, Indices] | None:
    """Half the squared differences between successive averages, by octave of the averaging time.

    Returns
    -------
    tau : ndarray, shape (octaves,), s
    power : ndarray, shape (W, octaves, 3)
        Sums over the pairs of averages of a window.
    pairs : ndarray of int, shape (W, octaves)
        Number of pairs of averages.
    """
    table = getattr(evidence.recording, sensor)
    samples = data.windows.samples
    lengths = samples[:, 1] - samples[:, 0]
    longest = int(np.ceil(SHORTEST_S / evidence.dt - 1e-6))
    block = max(1, min(longest, int(np.median(lengths)) // _LEAST_AVERAGES))
    octaves = int(np.log2(max(1, int(lengths.max()) // block)))
    if octaves < 1:
        return None
    power, pairs = np.zeros((len(samples), octaves, 3)), np.zeros((len(samples), octaves), dtype=np.intp)
    for n in np.unique(lengths // block).tolist():
        alike = np.flatnonzero(lengths // block == n)
        parts = np.stack([table[a : a + n * block] for a in samples[alike, 0].tolist()])
        x = np.einsum("wnbc->wnc", parts.reshape(-1, n, block, 3)) * (evidence.per_rate / block)
        for octave in range(octaves):
            m = x.shape[1] // 2
            if m == 0:
                break
            even, odd = x[:, 0 : 2 * m : 2], x[:, 1 : 2 * m : 2]
            power[alike, octave] = 0.5 * np.einsum("wnc,wnc->wc", odd - even, odd - even)
            pairs[alike, octave] = m
            x = 0.5 * (even + odd)
    tau = block * evidence.dt * np.exp2(np.arange(octaves, dtype=np.float64))
    return tau, power, pairs


def _noisy(power: Array, pairs: Indices) -> Mask:
    """True for windows whose power in some octave exceeds the chi-square limit, scaled by the median window, (W,)."""
    freedom = np.maximum(3.0 * pairs, 1.0)
    largest = limit("chi-square", freedom, tests=pairs.size, shared=_OUTLIER_PROBABILITY)
    summed = power.sum(axis=2)
    out = np.zeros(len(power), dtype=np.bool_)
    for octave in range(power.shape[1]):
        has = pairs[:, octave] > 0
        # chdtri(freedom, 1/2) is the median.
        scale = np.median(summed[has, octave] / chdtri(freedom[has, octave], 0.5))
        out |= has & (summed[:, octave] > scale * largest[:, octave])
    return out if out.mean() <= _MOST_OUTLIERS else np.zeros(len(out), dtype=np.bool_)
