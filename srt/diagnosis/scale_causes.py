"""Causes of wrong scales, compared by likelihood: factors on gyros, accelerometers and clock.

The measurements are the ratios of reading to truth of the three gyros and of the three accelerometers, and the Earth
rate in the stationary windows. A cause shifts the logarithms of the ratios by a known amount (another unit) or by an
unknown one (a sample rate). The Earth rate is measured with the gyro scale factors from the rotations, so that a factor
on the gyros cancels: only a wrong clock changes it. The remaining deviations of the ratios are the scale-factor errors
of the unit. They are modelled as normal and independent from axis to axis; the likelihood is averaged over their
unknown standard deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import logsumexp

from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis.cause_comparison import CLOSE
from srt.result.diagnostics import RunnerUp

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from srt.diagnosis.scale_ratios import ScaleRatios
    from srt.diagnosis.stationary_rates import EarthRate
    from srt.types import Array

_GRID: Final = np.geomspace(1e-4, 1.0, 25)
"""Standard deviations of the scale-factor errors of a unit over which the likelihood is averaged."""
_USUAL: Final = 0.02
"""Standard deviation of scale-factor errors above which the prior weight falls with its square: uncalibrated MEMS."""
_WEIGHT: Final = 1.0 / (1.0 + (_GRID / _USUAL) ** 2)
_LOG_WEIGHT: Final = np.log(_WEIGHT / _WEIGHT.sum())
_ROUNDING: Final = 1e-4
"""Smallest standard deviation of the logarithm of a ratio: labels and windows are not more accurate."""
_GRAVITY: Final = 0.0035
"""Relative standard deviation of the stated gravity: 0.4 of its variation over the Earth (9.76 to 9.84 m/s²)."""
_SITE_WRONG: Final = 1e-2
"""Prior probability of a wrong latitude, for which the Earth rate does not distinguish the causes."""


@dataclass(frozen=True, slots=True, eq=False)
class ScaleCause:
    """Cause of the scales of both triads: one fault, or one fault of each triad.

    Attributes
    ----------
    faults : tuple of str
        Keys of the catalogue of faults; empty for the scale-factor errors of a sound unit.
    gyro, accel : float or ndarray, shape (3,)
        Known part of the logarithm of reading over truth.
    clock : float
        Logarithm of the stated interval over the true one.
    unknown : mapping of sensor to (float, float)
        Triads whose logarithm has an unknown part: its range, and the factor by which it contributes to ``clock``.
    prior : float
        Prior probability, relative to that of no fault.
    details : mapping by fault
        Values for the messages.
    """

    faults: tuple[str, ...] = ()
    gyro: float | Array = 0.0
    accel: float | Array = 0.0
    clock: float = 0.0
    unknown: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    prior: float = 1.0
    details: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __and__(self, other: ScaleCause) -> ScaleCause:
        """Both causes together."""
        return ScaleCause(
            self.faults + other.faults,
            self.gyro + other.gyro,
            self.accel + other.accel,
            self.clock + other.clock,
            {**self.unknown, **other.unknown},
            self.prior * other.prior,
            self.details | other.details,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Triad:
    """Logarithms of the ratios of a triad, and their variance for each standard deviation of the scale-factor errors.

    Attributes
    ----------
    ratio : ndarray, shape (n,)
    variance : ndarray, shape (25,)
    common : float
        Standard deviation of an error that is common to the axes.
    """

    ratio: Array
    variance: Array
    common: float

    @staticmethod
    def of(scales: ScaleRatios, common: float) -> _Triad:
        if not scales.known:
            return _Triad(np.zeros(0), np.ones(1), common)
        ratio = np.log(scales.axes) if scales.by_axis else np.array([math.log(scales.typical)])
        scatter = scales.axis_scatter if math.isfinite(scales.axis_scatter) else 1.0
        return _Triad(ratio, _GRID**2 + scatter**2 + _ROUNDING**2, common)

    def terms(self, shift: float | Array, width: float | None) -> tuple[Array, Array, Array]:
        """Log-likelihood, mean deviation of the ratios from the shift, and variance of that mean.

        Each is an array over the standard deviations of the scale-factor errors. If ``width`` is given, the shift has
        an unknown part that is uniformly distributed over it.
        """
        n, s2 = len(self.ratio), self.variance
        if n == 0:
            return np.zeros(1), np.zeros(1), np.zeros(1)
        left = self.ratio - shift
        mean = float(left.mean())
        v = s2 / n + self.common**2
        own = -0.5 * ((n - 1) * np.log(2.0 * np.pi * s2) + float(np.sum((left - mean) ** 2)) / s2) + _LOG_WEIGHT
        of_mean = -0.5 * (np.log(2.0 * np.pi * v) + mean**2 / v) if width is None else np.full(len(v), -math.log(width))
        return own + of_mean, np.full(len(v), mean), v


def score(cause: ScaleCause, gyro: ScaleRatios, accel: ScaleRatios, earth: EarthRate | None) -> float:
    """Logarithm of the posterior probability of a cause, given all measurements, up to a constant.

    Parameters
    ----------
    cause : ScaleCause
    gyro, accel : ScaleRatios
    earth : EarthRate or None
    """
    total, clock, doubt = np.zeros((1, 1)), np.full((1, 1), cause.clock), np.zeros((1, 1))
    for sensor, triad, shift, axis in (
        ("gyro", _Triad.of(gyro, 0.0), cause.gyro, 0),
        ("accel", _Triad.of(accel, _GRAVITY), cause.accel, 1),
    ):
        width, on_clock = cause.unknown.get(sensor, (None, 0.0))
        own, mean, variance = (np.expand_dims(x, 1 - axis) for x in triad.terms(shift, width))
        total = total + own
        clock, doubt = clock + on_clock * mean, doubt + on_clock**2 * variance
    if earth is not None:
        total = total + _earth_term(clock, doubt, *earth)
    return math.log(cause.prior) + float(logsumexp(total))


def _earth_term(clock: Array, doubt: Array, found: Array, sigma: Array, true: Array) -> Array:
    """Log-likelihood of the measured Earth rate, for the logarithm of the clock factor and its variance (any shape)."""
    # A stated interval that is too short raises all rates and their noise.
    sigma = sigma * np.maximum(1.0, np.exp(-clock))[..., None]
    expected = np.exp(-clock)[..., None] * true / sigma
    left = found / sigma - expected
    size, along = np.sum(expected**2, axis=-1), np.sum(expected * left, axis=-1)
    square = np.sum(left**2, axis=-1) - along**2 * doubt / (1.0 + doubt * size)
    normal = -0.5 * (square + np.log1p(doubt * size)) - np.sum(np.log(math.sqrt(2.0 * math.pi) * sigma), axis=-1)
    anywhere = math.log(_SITE_WRONG / (math.pi * (2.0 * EARTH_RATE_RAD_S) ** 2))
    return np.asarray(np.logaddexp(normal, anywhere))


def most_likely(
    causes: Iterable[ScaleCause], gyro: ScaleRatios, accel: ScaleRatios, earth: EarthRate | None
) -> tuple[ScaleCause, RunnerUp | None]:
    """Most likely cause, and the second most likely one with another first fault, if it is nearly as likely."""
    ranked = sorted(((score(cause, gyro, accel, earth), cause) for cause in causes), key=lambda row: -row[0])
    (top, best), rest = ranked[0], ranked[1:]
    for value, other in rest:
        if other.faults and other.faults[0] != (best.faults or ("",))[0]:
            return best, RunnerUp(other.faults[0], top - value) if top - value < CLOSE else None
    return best, None
