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
from scipy.special import log_softmax, logsumexp

from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis.cause_comparison import CLOSE
from srt.result.diagnostics import RunnerUp

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from srt.diagnosis.scale_ratios import ScaleRatios
    from srt.diagnosis.stationary_rates import EarthRate
    from srt.types import Array

FREQUENT: Final = 1e-2
RARE: Final = 1e-3
"""Prior probabilities of causes, relative to no fault. Only their ratios matter: a scale ratio that is known to 1 %
outweighs them."""
_ROUNDING: Final = 1e-4
"""Smallest standard deviation of the logarithm of a ratio: labels and windows are not more accurate."""
_GRID: Final = np.geomspace(_ROUNDING, 1.0, 25)
"""Standard deviations of the scale-factor errors of a unit over which the likelihood is averaged."""
_USUAL: Final = 0.02
"""Standard deviation of scale-factor errors above which the prior weight falls with its square: uncalibrated MEMS."""
_LOG_WEIGHT: Final = log_softmax(-np.log1p(np.square(_GRID / _USUAL)))
GRAVITY_SIGMA: Final = 0.0035
"""Relative standard deviation of the stated gravity: 0.4 of its variation over the Earth (9.76 to 9.84 m/s²)."""


@dataclass(frozen=True, slots=True, eq=False)
class ScaleCause:
    """Cause of the scales of both triads: one fault, one fault of each triad, or none for a sound unit.

    ``gyro`` and ``accel``, float or shape (3,), are the known parts of the logarithm of reading over truth; ``clock``
    is the logarithm of the stated interval over the true one. ``unknown`` gives, for each triad whose logarithm has an
    unknown part, its range and the factor by which it contributes to ``clock``. ``prior`` is relative to that of no
    fault; ``details`` are the values for the message of each fault.
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


def score(cause: ScaleCause, gyro: ScaleRatios, accel: ScaleRatios, earth: EarthRate | None) -> float:
    """Logarithm of the posterior probability of a cause, given all measurements, up to a constant."""
    total, clock, doubt = np.zeros((1, 1)), np.full((1, 1), cause.clock), np.zeros((1, 1))
    for axis, (sensor, scales, shift, common) in enumerate(
        (("gyro", gyro, cause.gyro, 0.0), ("accel", accel, cause.accel, GRAVITY_SIGMA))
    ):
        width, on_clock = cause.unknown.get(sensor, (None, 0.0))
        own, mean, variance = np.expand_dims(_terms(scales, shift, width, common), 2 - axis)
        total = total + own
        clock, doubt = clock + on_clock * mean, doubt + on_clock**2 * variance
    by_earth = 0.0 if earth is None else _earth_term(clock, doubt, *earth)
    return math.log(cause.prior) + float(logsumexp(total + by_earth))


def _terms(scales: ScaleRatios, shift: float | Array, width: float | None, common: float) -> Array:
    """Log-likelihood of a triad, mean deviation of its ratios from the shift, and variance of that mean.

    Shape (3, m), for the m standard deviations of the scale-factor errors; ``common`` is the standard deviation of an
    error that all axes have. If ``width`` is given, the shift has an unknown part, uniformly distributed over it.
    """
    if not scales.known:
        return np.zeros((3, 1))
    left = scales.logarithms - shift
    n, mean = len(left), float(left.mean())
    s2 = _GRID**2 + (scales.axis_scatter if math.isfinite(scales.axis_scatter) else 1.0) ** 2 + _ROUNDING**2
    v = s2 / n + common**2
    own = -0.5 * ((n - 1) * np.log(2.0 * np.pi * s2) + float(np.sum((left - mean) ** 2)) / s2) + _LOG_WEIGHT
    of_mean = -0.5 * (np.log(2.0 * np.pi * v) + mean**2 / v) if width is None else -math.log(width)
    return np.stack([own + of_mean, np.full(len(v), mean), v])


def _earth_term(clock: Array, doubt: Array, found: Array, sigma: Array, true: Array) -> Array:
    """Log-likelihood of the measured Earth rate, for the logarithm of the clock factor and its variance (any shape)."""
    # A stated interval that is too short raises all rates and their noise.
    sigma = sigma * np.maximum(1.0, np.exp(-clock))[..., None]
    expected = np.exp(-clock)[..., None] * true / sigma
    left = found / sigma - expected
    size, along = np.sum(expected**2, axis=-1), np.sum(expected * left, axis=-1)
    square = np.sum(left**2, axis=-1) - along**2 * doubt / (1.0 + doubt * size)
    normal = -0.5 * (square + np.log1p(doubt * size)) - np.sum(np.log(math.sqrt(2.0 * math.pi) * sigma), axis=-1)
    # For a wrong latitude, as frequent as another frequent fault, the Earth rate does not distinguish the causes.
    anywhere = math.log(FREQUENT / (math.pi * (2.0 * EARTH_RATE_RAD_S) ** 2))
    return np.asarray(np.logaddexp(normal, anywhere))


def most_likely(
    causes: Iterable[ScaleCause], gyro: ScaleRatios, accel: ScaleRatios, earth: EarthRate | None
) -> tuple[ScaleCause, RunnerUp | None]:
    """Most likely cause, and the second most likely one with another first fault, if it is nearly as likely."""
    ranked = sorted(((score(cause, gyro, accel, earth), cause) for cause in causes), key=lambda row: -row[0])
    top, best = ranked[0]
    for value, other in ranked:
        if other.faults[:1] not in ((), best.faults[:1]):
            return best, RunnerUp(other.faults[0], top - value) if top - value < CLOSE else None
    return best, None
