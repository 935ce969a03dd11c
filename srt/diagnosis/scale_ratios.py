"""Ratios of reading to truth of each triad: rotations against labels or gravity, specific force against gravity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.false_alarms import robust_sigma
from srt.diagnosis.rotation_readings import RANK, rates_factor
from srt.diagnosis.triad_fits import LEAST_FREEDOM
from srt.model.table1 import AXES
from srt.result.verdict import USABLE
from srt.sensor_errors import GROUP_SLICES

if TYPE_CHECKING:
    from srt.diagnosis.gravity_rotation import ManoeuvreReadings
    from srt.diagnosis.rotation_readings import Rotations
    from srt.diagnosis.triad_fits import LinearFit
    from srt.recording.recording import Fixture, Recording
    from srt.result.calibration import Calibration
    from srt.types import Array, Sensor


@dataclass(frozen=True, slots=True, eq=False)
class ScaleRatios:
    """Ratios of reading to truth of one triad, NaN where unknown.

    ``typical`` is the median of the triad; ``axes``, shape (3,), are those of the sensor axes. ``axis_scatter`` is the
    scatter of single rotations or poses: standard deviation of the logarithm of their ratio to that of their axis.
    """

    typical: float
    axes: Array
    axis_scatter: float

    @property
    def known(self) -> bool:
        """True if the triad has a positive, finite ratio."""
        return math.isfinite(self.typical) and self.typical > 0.0

    @property
    def by_axis(self) -> bool:
        """True if each axis has a positive, finite ratio."""
        return bool(self.axes.min() > 0.0 and self.axes.max() < math.inf)

    @property
    def logarithms(self) -> Array:
        """Logarithms of the three ratios, shape (3,); of the typical ratio, shape (1,), where they are unknown."""
        return np.asarray(np.log(self.axes if self.by_axis else [self.typical]))

    @property
    def common(self) -> float:
        """Mean of the logarithms."""
        return float(self.logarithms.mean())

    @property
    def spread(self) -> float:
        """Standard deviation of the logarithms of the three axes."""
        return float(np.std(self.logarithms, ddof=1))

    @property
    def scatter(self) -> float:
        """Standard deviation of the logarithms of the three axes, including the scatter of one axis."""
        return math.hypot(self.spread, self.axis_scatter)


RAW_SCALE: Final = 0.02
"""Standard deviation of the scale-factor errors and misalignments of uncalibrated MEMS."""
_UNSEEN: Final = np.full(len(AXES), np.nan)
UNKNOWN: Final = ScaleRatios(math.nan, _UNSEEN, math.nan)
"""Ratios of a triad that the data do not determine."""


def gyro_ratios_to_gravity(by_labels: ScaleRatios, relation: Array | None) -> ScaleRatios:
    """Ratios of the gyros to the rotation of gravity (matrix K), if they contradict those to recognised angles."""
    if relation is None:
        return by_labels
    axes = 1.0 / np.linalg.norm(relation, axis=0)
    by_gravity = ScaleRatios(float(np.median(axes)), axes, RAW_SCALE)
    # Without labels, angles are recognised as multiples of 90° and may be wrong by a factor of two.
    nearer = by_labels.known and abs(math.log(by_labels.typical / by_gravity.typical)) < 0.5 * math.log(2.0)
    return by_labels if nearer else by_gravity


def gyro_ratios_to_labels(rotations: Rotations, fit: LinearFit, fixture: Fixture | None) -> ScaleRatios:
    """Ratios of measured to labelled angles, of each axis if the labels determine their fit.

    Wrong axes, signs and senses, and a few wrong labels, do not affect them.
    """
    _, nominal, turned = rotations
    if len(nominal) == 0:
        return UNKNOWN
    size, labelled = np.linalg.norm(turned, axis=1), np.linalg.norm(nominal, axis=1)
    typical = float(np.median(size / labelled))
    axes, expected = _UNSEEN, typical * labelled
    if fit.rank == 3:
        axes, expected = np.linalg.norm(fit.matrix, axis=1), np.linalg.norm(nominal @ fit.matrix.T, axis=1)
    if not np.all(size * expected > 0.0):
        return ScaleRatios(typical, axes, math.inf)
    fixture_scatter = 0.0 if fixture is None else fixture.rotation_sigma_rad / math.pi
    return ScaleRatios(typical, axes, math.hypot(float(robust_sigma(np.log(size / expected))), fixture_scatter))


def accel_ratios(recording: Recording, turns: ManoeuvreReadings | None, fit: LinearFit) -> ScaleRatios:
    """Ratios of the stationary specific force to gravity, for each axis if the poses or their fit determine them.

    The poses do so if their labels span space, or if there are enough poses for a fit of their magnitudes. Without a
    stationary window, the ratio is that of all readings: in motion by hand they remain near gravity.
    """
    gravity = recording.site.gravity_m_s2
    if turns is None or len(turns.force) == 0:
        sizes = np.linalg.norm(recording.accel, axis=1) * (rates_factor(recording) / gravity)
        if not np.any(sizes > 0.0):
            return UNKNOWN
        low, typical, high = np.quantile(sizes[sizes > 0.0], (0.25, 0.5, 0.75))
        return ScaleRatios(float(typical), _UNSEEN, 0.5 * math.log(high / low))
    ratio = np.linalg.norm(turns.force, axis=1) / gravity
    typical = float(np.median(ratio))
    if not np.all(ratio > 0.0):
        return ScaleRatios(typical, _UNSEEN, math.inf)
    if fit.rank == 3:
        off = robust_sigma(fit.residual, axis=0) / (gravity * typical)
        return ScaleRatios(typical, np.linalg.norm(fit.matrix, axis=1), float(off.max()))
    return _by_magnitude(turns.force / gravity) or ScaleRatios(
        typical, _UNSEEN, float(robust_sigma(np.log(ratio / typical)))
    )


def _by_magnitude(force: Array) -> ScaleRatios | None:
    """Ratios from an ellipsoid fit to specific forces in units of gravity, (n, 3), with its axes along the sensor axes.

    None with too few poses, or with poses that do not determine the axes of the ellipsoid.
    """
    size = float(np.median(np.linalg.norm(force, axis=1)))
    design = np.hstack([(force / size) ** 2, force / size])
    count, weakest = len(force), np.linalg.svd(design, compute_uv=False)[-1]
    if count < design.shape[1] + LEAST_FREEDOM or weakest < RANK * math.sqrt(count):
        return None
    square, slope = np.split(np.linalg.lstsq(design, np.ones(count), rcond=None)[0], 2)
    if not np.all(square > 0.0):
        return None
    # Σ a (f − b)² = 1 + Σ a b² with b = −slope / 2a.
    level = 1.0 + 0.25 * float(np.sum(slope**2 / square))
    off = 0.5 * (design @ np.concatenate([square, slope]) - 1.0) / level
    axes = size * np.sqrt(level / square)
    return ScaleRatios(float(np.median(axes)), axes, float(robust_sigma(off)))


def calibrated_ratios(result: Calibration, sensor: Sensor) -> ScaleRatios:
    """Ratios of a calibration, ``1 + κ``; unknown unless all three scale factors are observed."""
    part = GROUP_SLICES[f"{sensor}_scale"]
    axes, sigma = 1.0 + result.errors.vector[part], result.sigma[part]
    if result.status not in USABLE or not result.observed[part].all():
        return UNKNOWN
    return ScaleRatios(float(np.median(axes)), axes, float(sigma.max()))


def stationary_force_scatter(turns: ManoeuvreReadings | None) -> float:
    """Logarithm of upper over lower quartile of the stationary specific force; infinite without stationary windows."""
    if turns is None or len(turns.force) == 0:
        return math.inf
    low, high = np.quantile(np.linalg.norm(turns.force, axis=1), (0.25, 0.75))
    return math.log(high / low) if low > 0.0 else math.inf
