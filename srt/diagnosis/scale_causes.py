"""Causes of wrong scales, compared by likelihood: factors on gyros, accelerometers and clock.

A cause shifts the logarithms of the ratios of reading and truth of the three gyros and of the three accelerometers, by
a known amount (another unit) or by an unknown one (a sample rate), and the Earth rate that the windows show: it is
measured in true angles over stated time, and only a wrong clock changes it. What is left are the scale errors of the
unit: independent from axis to axis, normal, of a standard deviation that is not known and is averaged over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import logsumexp

from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis.cause_comparison import CLOSE
from srt.diagnosis.findings import RunnerUp
from srt.diagnosis.site import earth_rate_components

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.scale_ratios import ScaleRatios
    from srt.types import Array

_GRID: Final = np.geomspace(1e-4, 1.0, 25)
"""Standard deviations of the scale errors of a unit, from the best to the worst."""
_USUAL: Final = 0.02
"""Standard deviation of the scale errors, above which units are the rarer the larger it is: uncalibrated MEMS."""
_WEIGHT: Final = 1.0 / (1.0 + (_GRID / _USUAL) ** 2)
_LOG_WEIGHT: Final = np.log(_WEIGHT / _WEIGHT.sum())
_ROUNDING: Final = 1e-4
"""Least standard deviation of a ratio: labels and windows are not better."""
_GRAVITY: Final = 0.0035
"""Standard deviation of the stated gravity, relative: a third of its variation over the Earth (9.76 to 9.84 m/s²)."""
_SITE_WRONG: Final = 1e-2
"""Probability of a wrong latitude, which makes the Earth rate no evidence."""


@dataclass(frozen=True, slots=True, eq=False)
class ScaleCause:
    """One cause, or one of each triad.

    Attributes
    ----------
    faults : tuple of str
        Keys of the catalogue of faults; none for scale errors of the unit.
    gyro, accel : float or ndarray, shape (3,)
        Logarithm of reading over truth.
    clock : float
        Logarithm of the stated interval over the true one.
    unknown : mapping of sensor to (float, float)
        Triads with a further, unknown logarithm: its range, and the factor with which it is added to ``clock``.
    prior : float
        Probability, relative to that of no fault.
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
    """Logarithms of the ratios of a triad; for each standard deviation of its errors their variance and weight."""

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
        """Log-likelihood, the mean off the shift, and its variance; over the standard deviations of the errors.

        With a width, any mean within it is equally likely.
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


def score(cause: ScaleCause, gyro: ScaleRatios, accel: ScaleRatios, earth: tuple[Array, Array, Array] | None) -> float:
    """Logarithm of the probability of a cause with all that is measured, up to a constant.

    Parameters
    ----------
    cause : ScaleCause
    gyro, accel : ScaleRatios
    earth : (found, sigma, true) or None
        Vertical and horizontal Earth rate measured, their standard deviations, and the true ones, each of shape (2,).
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
    """Log-likelihood of the Earth rate, for the logarithm of a wrong clock and its variance, of any shape."""
    # A slow clock raises all rates, and their noise with them.
    sigma = sigma * np.maximum(1.0, np.exp(-clock))[..., None]
    expected = np.exp(-clock)[..., None] * true / sigma
    left = found / sigma - expected
    size, along = np.sum(expected**2, axis=-1), np.sum(expected * left, axis=-1)
    square = np.sum(left**2, axis=-1) - along**2 * doubt / (1.0 + doubt * size)
    normal = -0.5 * (square + np.log1p(doubt * size)) - np.sum(np.log(math.sqrt(2.0 * math.pi) * sigma), axis=-1)
    anywhere = math.log(_SITE_WRONG / (math.pi * (2.0 * EARTH_RATE_RAD_S) ** 2))
    return np.asarray(np.logaddexp(normal, anywhere))


def most_likely(
    causes: Iterable[ScaleCause], evidence: Evidence, gyro: ScaleRatios, accel: ScaleRatios
) -> tuple[ScaleCause, RunnerUp | None]:
    """Most likely of some causes, and the next one with another first fault, if it is nearly as likely."""
    earth = earth_rate_components(evidence)
    ranked = sorted(((score(cause, gyro, accel, earth), cause) for cause in causes), key=lambda row: -row[0])
    (top, best), rest = ranked[0], ranked[1:]
    for value, other in rest:
        if other.faults and other.faults[0] != (best.faults or ("",))[0]:
            return best, RunnerUp(other.faults[0], top - value) if top - value < CLOSE else None
    return best, None
