"""Noise model of an IMU: stated figures, completed by estimates from the stationary windows, with lower limits.

White noise and errors of the readings are taken from averages within the windows (:mod:`srt.noise.random_walk`), bias
instability of the accelerometers from all windows together (:mod:`srt.noise.instability_at_rest`). Both leave out the
short times in which a low-pass filter of the sensor hides noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtr

from srt.constants import STANDARD_GRAVITY_M_S2
from srt.noise.instability_at_rest import InstabilityAtRest, instability_at_rest
from srt.noise.quantization import single_precision_step, smallest_step, thinned
from srt.noise.random_walk import random_walk
from srt.noise.variance_components import expected_variance
from srt.recording.readings import by_length

if TYPE_CHECKING:
    from srt.noise.drift_forms import Statistics
    from srt.recording.recording import Recording
    from srt.types import Array, Indices, Mask


_ESTIMATED: Final = (
    "gyro_noise", "gyro_quantization", "accel_noise", "accel_quantization", "accel_bias_instability",
    "gyro_bias_instability",
)  # fmt: skip
"""Figures that are estimated where they are not stated."""
GYRO_FLOOR: Final = 1e-10
"""Lower limit of an estimated angular random walk, rad/√s: gives noise-free data a finite weight."""
ACCEL_FLOOR: Final = 1e-9 * STANDARD_GRAVITY_M_S2
"""Lower limit of an estimated velocity random walk, m/s²·√s (1e-9 g·√s)."""
_DITHERED: Final = 2.0
"""Steps of the readings over their noise from which the noise does not dither them: the mean of a window is then off by
1e-3 of a step, which no longer averages out."""
_PULSES: Final = 0.5
"""Error of the integral, over that of pulses of one step, from which readings are pulse counts, whose errors cancel."""
OFF_GRID: Final = 0.1
"""Distance of a reading from the grid of steps, in steps, that rounding of stored digits leaves."""
_FEWEST_READINGS: Final = 10
"""Distinct readings from which a grid is no coincidence."""
_FEW: Final = 300
"""Readings that show first whether they lie on a grid."""
_BISECTIONS: Final = 40
"""Bisections of the noise below the steps, which the scatter of the readings shows."""
_FAR_STEPS: Final = 4
"""Distance of readings from their true value, in steps, that noise of half a step does not reach."""
_SAME_SCATTER: Final = 1e-3
"""Relative difference of the scatter that is no evidence of more noise: two readings scatter alike with any noise."""
_FEW_PLACES: Final = 10
"""Places within a step, at which windows read alike, that do not show the noise by the share of those between steps."""
_PLACES: Final = 201
"""Number of true values within a step of a reading, and within 4 sigma of the limits between readings."""
_LEAST_VARIANCE: Final = 1e-6
"""Variance of means, in squared steps, below which the places are too coarse."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Noise of the readings, before compensation.

    Attributes
    ----------
    gyro_white, accel_white : ndarray, shape (3,)
        Random walk of the integral, rad/√s and m/s²·√s.
    gyro_edge, accel_edge : ndarray, shape (3,)
        1-sigma error of one reading of the integral (angle, velocity), rad and m/s.
    gyro_rounding, accel_rounding : ndarray, shape (W, 3), rad/s and m/s²
        Expected error of the means of windows by rounding to steps which the noise of the readings does not dither:
        it does not average out. Zero for dithered readings and pulse counts.
    gyro_step, accel_step : ndarray, shape (3,), rad/s and m/s²
        1-sigma of what remains of that error beyond white noise. Larger where many windows share it.
    gyro_wander : ndarray, shape (3,), rad/s, or None
        1-sigma of the bias of one sequence about the mean of the test; None if no bias instability is stated. The
        estimator then takes it from the rest rates of the sequences.
    accel_wander : ndarray, shape (3,), m/s²
        The same for the accelerometer bias of one window.
    gyro_flicker : ndarray, shape (3,), rad/s, or None
        Bias instability (Allan floor), the input of :mod:`srt.noise.bias_instability`; None if not stated.
    accel_flicker : ndarray, shape (3,), m/s²
        The same for the accelerometers, as stated or as the windows show it.
    accel_unseen : ndarray, shape (3,), m/s²
        Bias instability beyond ``accel_flicker`` that the windows cannot exclude to 1 sigma.
    accel_spectra : ndarray, shape (2,), (m/s²)²
        Square of the bias instability of the accelerometers as the spectra within the windows show it, negative where
        the noise happens to be small, and its 1-sigma.
    accel_limit : ndarray, shape (3,), m/s²
        Largest bias instability that the windows cannot exclude, at least ``accel_flicker``.
    filter_s : ndarray, shape (2,), s
        Averaging time beyond which a low-pass filter of the gyros and of the accelerometers, found in the noise at
        rest, does not show; zero without a filter.
    estimated, floored : tuple of str
        Figures estimated from the windows, and figures raised to the lower limit.
    """

    gyro_white: Array
    accel_white: Array
    gyro_edge: Array
    accel_edge: Array
    gyro_rounding: Array
    accel_rounding: Array
    gyro_step: Array
    accel_step: Array
    gyro_wander: Array | None
    accel_wander: Array
    gyro_flicker: Array | None
    accel_flicker: Array
    accel_unseen: Array
    accel_spectra: Array
    accel_limit: Array
    filter_s: Array
    estimated: tuple[str, ...] = ()
    floored: tuple[str, ...] = ()

    @property
    def noise_free(self) -> bool:
        """True if the gyros have no noise but rounding, as in simulations."""
        return "gyro_noise" in self.floored

    @property
    def undithered(self) -> tuple[str, ...]:
        """Channels whose readings have steps that their noise does not dither."""
        both = (("gyro", self.gyro_rounding, self.gyro_step), ("accel", self.accel_rounding, self.accel_step))
        return tuple(
            f"{sensor}_{axis}"
            for sensor, error, step in both
            for axis, own in zip("xyz", np.any(error, axis=0) | (step > 0.0), strict=True)
            if own
        )

    def expected_accel_instability(self, shown: Statistics) -> tuple[float, float]:
        """Expected bias instability of the accelerometers, and the part of it that the weights lack, m/s².

        It is by the spectra within the windows and by what residuals show of an instability of one.
        """
        used = float(self.accel_flicker.max()) ** 2
        square = expected_variance(shown, used, self.accel_spectra)
        return math.sqrt(square), math.sqrt(max(square - used, 0.0))

    def with_accel_instability(self, instability: float) -> NoiseModel:
        """Noise with a bias instability of the accelerometers, m/s², that spectra and residuals together show."""
        flicker = np.full(3, instability)
        return replace(self, accel_flicker=flicker, accel_unseen=np.zeros(3), accel_limit=flicker)

    def with_gyro_instability(self, instability: float, windows: Indices) -> NoiseModel:
        """Noise with a bias instability of the gyros, rad/s, that the rates at rest show."""
        flicker = np.full(3, instability)
        return replace(self, gyro_flicker=flicker, gyro_wander=flicker * flicker_spread(windows))

    def gyro_sample(self, interval_s: float) -> Array:
        """1-sigma of the angle of a single sample, random walk and quantization, shape (3,), rad."""
        out: Array = np.hypot(self.gyro_white * math.sqrt(interval_s), math.sqrt(2.0) * self.gyro_edge)
        return out


def noise_model(recording: Recording, windows: Indices) -> NoiseModel:
    """Complete the stated noise of a unit from its stationary windows.

    Parameters
    ----------
    windows : ndarray of int, shape (W, 2)
        First sample and one past the last of every window.
    """
    stated, dt, factor = recording.noise, recording.nominal_interval_s, recording.rates_factor
    found = random_walk(recording, windows)
    figures: dict[str, Array] = {}
    floored = []
    for sensor, columns, floor in (("gyro", slice(0, 3), GYRO_FLOOR), ("accel", slice(3, 6), ACCEL_FLOOR)):
        noise, pulse = getattr(stated, f"{sensor}_noise"), getattr(stated, f"{sensor}_quantization")
        white, seen_edge = found.white[columns] * factor, found.edge[columns] * factor
        edge = seen_edge if pulse is None else np.full(3, pulse / math.sqrt(12.0))
        step = _resolution(recording, windows, sensor)
        rounding, own = _step_error(recording, windows, sensor, step, seen_edge)
        at_rest_single, single = single_precision_step(getattr(recording, sensor), windows) * factor
        resolution = np.maximum(step, single) / math.sqrt(12.0)
        if noise is not None:  # what the windows show contains the rounding
            undithered = np.any(rounding, axis=0) | (own > 0.0)
            white = np.hypot(noise, np.where(undithered, resolution * math.sqrt(dt), 0.0))
        shown = np.hypot(white / math.sqrt(dt), math.sqrt(2.0) * edge / dt)
        least = np.maximum(np.where(shown < resolution, resolution * math.sqrt(dt), 0.0), floor)
        own = np.where(shown < at_rest_single, np.hypot(own, at_rest_single / math.sqrt(12.0)), own)
        if np.any(white < least):
            floored.append(f"{sensor}_noise")
        values = (np.maximum(white, least), edge, rounding, own)
        figures |= zip((f"{sensor}_{what}" for what in ("white", "edge", "rounding", "step")), values, strict=True)
    at_rest = InstabilityAtRest()
    if stated.accel_bias_instability is not None:
        at_rest = InstabilityAtRest(*3 * [stated.accel_bias_instability])
    # Without noise, as in simulations, rounding would count.
    elif np.any(found.white[3:] * factor > ACCEL_FLOOR):
        # That of the gyros is not taken from the windows, where angle random walk and the quantization of slow rates
        # hide it: the scatter of the rest rates between sequences is its measure.
        force = recording.accel if recording.kind == "rate" else recording.accel * factor
        at_rest = instability_at_rest(force, windows, dt, float(found.filter_s[1]))
    # If the noise is stated, an instability that the windows do not show counts as none, unless residuals ask for it.
    unseen = math.sqrt(at_rest.bound**2 - at_rest.value**2) if stated.accel_noise is None else 0.0
    spread, flicker = flicker_spread(windows), stated.gyro_bias_instability
    return NoiseModel(
        **figures,
        gyro_wander=None if flicker is None else np.full(3, flicker * spread),
        accel_wander=np.full(3, math.hypot(at_rest.value, unseen) * spread),
        gyro_flicker=None if flicker is None else np.full(3, flicker),
        accel_flicker=np.full(3, at_rest.value),
        accel_unseen=np.full(3, unseen),
        accel_spectra=np.array([at_rest.square, at_rest.doubt]),
        accel_limit=np.full(3, at_rest.limit),
        filter_s=found.filter_s,
        estimated=tuple(key for key in _ESTIMATED if getattr(stated, key) is None),
        floored=tuple(floored),
    )


def flicker_spread(windows: Indices) -> float:
    """1-sigma of a window's bias about its mean over the test, in units of the stated bias instability.

    The bias instability B_A of data sheets is the floor of the Allan deviation. Flicker noise with that floor,
    ``S(f) = B_A² / (4 ln 2 f)`` (two-sided), has the variance ``B_A² ln(T / T_w) / (2 ln 2)`` between the frequencies
    1/T and 1/T_w: the variance of averages over T_w within a test of length T.
    """
    lengths = windows[:, 1] - windows[:, 0]
    ratio = (int(windows[:, 1].max()) - int(windows[:, 0].min())) / float(np.median(lengths))
    return math.sqrt(max(1.0, math.log(ratio) / (2.0 * math.log(2.0))))


def _resolution(recording: Recording, windows: Indices, sensor: str) -> Array:
    """Smallest step between distinct readings of a column, as a rate, shape (3,); 0 where readings hardly repeat."""
    table = getattr(recording, sensor)
    still = thinned(table, windows)
    step, constant = smallest_step(still), still.max(axis=0) == still.min(axis=0)
    if constant.any():  # readings constant at rest: the step is estimated during motion
        step = np.where(constant, smallest_step(thinned(table)), step)
    return step * recording.rates_factor


def _step_error(recording: Recording, windows: Indices, sensor: str, step: Array, edge: Array) -> tuple[Array, Array]:
    """Expected error of means of rounded readings at rest, (W, 3), and 1-sigma of the remainder, (3,)."""
    pulse, none = getattr(recording.noise, f"{sensor}_quantization"), (np.zeros((len(windows), 3)), np.zeros(3))
    if pulse or (pulse is None and recording.kind == "increment"):
        return none  # the error of pulse counts is that of the integral at the edges
    coarse = _on_grid(getattr(recording, sensor), step / recording.rates_factor)
    if pulse is None:
        coarse &= edge < _PULSES * step * recording.nominal_interval_s / math.sqrt(12.0)
    return _rounding(recording, windows, sensor, step, coarse) if coarse.any() else none


def hidden_gyro_step(recording: Recording, windows: Indices) -> float:
    """Step to which rates were rounded before a correction, rad/s; 0 where the readings show it, or noise dithers it.

    A correction mixes the steps of the axes: corrected readings state them as quantization, and lie on no grid. Their
    means at rest are off by up to half a step, and nothing shows by how much.
    """
    pulse, dt = recording.noise.gyro_quantization, recording.nominal_interval_s
    if not pulse or recording.kind == "increment":
        return 0.0
    edge = random_walk(recording, windows).edge[:3]
    variance = np.concatenate([np.var(own, axis=1) for _, own in by_length(recording.gyro, windows)]).mean(axis=0)
    hidden = ~_on_grid(recording.gyro, np.full(3, pulse / dt)) & _is_coarse(variance, np.full(3, pulse / dt))
    return pulse / dt if np.any(hidden & (edge < _PULSES * pulse / math.sqrt(12.0))) else 0.0


def _is_coarse(variance: Array, step: Array) -> Mask:
    """True for channels whose noise, of the variance of readings within windows, does not dither their steps."""
    return np.asarray(variance < (step / _DITHERED) ** 2 + step**2 / 12.0)


def _on_grid(table: Array, step: Array) -> Mask:
    """Channels whose readings lie on a grid of steps, shape (3,).

    Distinct readings without a grid, as in simulations without noise, are not rounded: the first ones tell mostly.
    """
    coarse, some = step > 0.0, thinned(table)
    for part in (some[:_FEW], some):
        if coarse.any():
            steps = (part - part[0]) / np.where(coarse, step, np.inf)
            coarse &= np.all(np.abs(steps - np.round(steps)) < OFF_GRID, axis=0)
    return coarse


def _rounding(recording: Recording, windows: Indices, sensor: str, step: Array, coarse: Mask) -> tuple[Array, Array]:
    """:func:`_step_error` of one unit, (W, 3) and (3,), rad/s or m/s²; ``coarse`` channels lie on a grid of steps.

    The mean of readings with normal noise s, rounded to steps q, is off by ``Σ (−1)^k q/(π k) exp(−2 π² k² s²/q²)
    sin(2 π k x/q)`` at the true value x (Widrow & Kollár, Quantization Noise, 2008). Means and scatter of the windows
    show s, and so x, but where all mix the same two readings: any noise up to a third of a step does so. Windows with
    the same reading then share what is not known: to first order the correlation at x and y is cos(2 π (x − y)/q). As
    errors of single windows, which are independent, it counts so many times as there are such windows, for the reading
    that most of them share.
    """
    table, scale = getattr(recording, sensor), 1.0 / recording.rates_factor
    error, remainder = np.zeros((len(windows), 3)), np.zeros(3)
    each = np.concatenate([np.var(readings, axis=1) for _, readings in by_length(table, windows)])
    variance = each.mean(axis=0) / scale**2
    coarse = coarse & _is_coarse(variance, step)
    unit = np.where(coarse, step, np.inf)
    every = thinned(table) / scale
    steps = np.round((every - every[0]) / unit)
    coarse &= np.array([len(np.unique(own)) for own in steps.T]) >= _FEWEST_READINGS
    if not coarse.any():
        return error, remainder
    first = table[windows[:, 0]] / scale  # the grid of the readings may lie off zero
    x = np.array([table[a:b].mean(axis=0) for a, b in windows.tolist()]) / scale
    apart = np.abs(x[:, None] - x) / unit
    shared = np.where(apart < 0.25, np.cos(2.0 * math.pi * apart), 0.0).sum(axis=1).max(axis=0)
    number, scatter = np.diff(windows, axis=1)[:, 0], variance / unit**2
    for axis in np.flatnonzero(coarse).tolist():
        means = (x - first)[:, axis] / step[axis]
        if len(windows) > _FEW_PLACES * shared[axis]:  # with more noise, more of them would mix readings
            noises = (_below_steps(means, scatter[axis], _SAME_SCATTER)[0],) * 2
        else:
            noises = _below_steps(means, scatter[axis], _SAME_SCATTER + 2.0 / math.sqrt(number.sum()))
        both = [_rounded_means(means, number, noise) for noise in noises]
        off, unknown = np.mean(both, axis=0)
        error[:, axis] = step[axis] * off
        beyond = max(float(np.mean(unknown - scatter[axis] / number)), 0.0)
        unresolved = min(12.0 * beyond, 1.0)  # without noise, all of a step
        by_noise = float(np.mean((both[1][0] - both[0][0]) ** 2)) / 12.0  # the noise of all windows is the same
        beyond = beyond * (1.0 + unresolved * (shared[axis] - 1.0)) + by_noise * shared[axis]
        remainder[axis] = step[axis] * math.sqrt(beyond)
    return error, remainder


def _rounded_means(means: Array, number: Array, noise: float) -> tuple[Array, Array]:
    """Expected error of means of rounded readings, and variance of the true values, shape (W,) each, all in steps."""
    true, mean, variance = _rounded(noise)
    near = means - np.rint(means)
    own = variance / number[:, None] + _LEAST_VARIANCE
    log = -0.5 * ((near[:, None] - mean) ** 2 / own + np.log(own))
    weight = np.exp(log - log.max(axis=1, keepdims=True)) * np.gradient(true)
    weight /= weight.sum(axis=1, keepdims=True)
    expected = weight @ true
    return near - expected, weight @ true**2 - expected**2


def _rounded(noise: float) -> tuple[Array, Array, Array]:
    """True values within a step of zero, and mean and variance of their rounded readings, in steps."""
    limits = np.arange(-_FAR_STEPS, _FAR_STEPS + 1) - 0.5
    beside = noise * np.linspace(-4.0, 4.0, _PLACES)  # little noise mixes two readings only there
    true = np.sort(np.concatenate([np.linspace(-1.0, 1.0, _PLACES), beside - 0.5, beside + 0.5]))
    above = ndtr((true[:, None] - limits) / noise)  # the reading is the number of limits that it exceeds
    mean = above.sum(axis=1)
    variance = above @ (2.0 * np.arange(len(limits)) + 1.0) - mean**2
    return true, mean - _FAR_STEPS - 1.0, variance


def _below_steps(means: Array, scatter: float, tolerance: float) -> tuple[float, float]:
    """Least and largest noise of rounded readings, from means of windows and the variance within them, all in steps.

    Readings scatter the less the nearer their true value is to a multiple of the step. ``tolerance`` is the relative
    difference of the scatter that is no evidence.
    """
    least, largest = (0.0, 1.0 / _DITHERED), (0.0, 1.0 / _DITHERED)
    for _ in range(_BISECTIONS):
        low, high = 0.5 * sum(least), 0.5 * sum(largest)
        least = (least[0], low) if _scatter(means, low) >= (1.0 - tolerance) * scatter else (low, least[1])
        largest = (high, largest[1]) if _scatter(means, high) <= (1.0 + tolerance) * scatter else (largest[0], high)
    return 0.5 * sum(least), 0.5 * sum(largest)


def _scatter(means: Array, noise: float) -> float:
    """Expected variance of rounded readings with these means, in squared steps."""
    _, mean, variance = _rounded(noise)
    return float(np.interp(means - np.rint(means), mean, variance).mean())
