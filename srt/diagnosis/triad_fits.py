"""Raw matrices of the triads from the labelled rotations and poses, and ratios of reading to truth.

A few sequences with wrong labels do not bias the matrices. The residuals show if the labels explain the readings, and
the rank shows if the labels determine the matrix. Where they do not, the ratios are those to gravity: of the gyros by
the rotation of gravity, of the accelerometers by the magnitude of specific force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.linalg import polar

from srt.diagnosis.false_alarms import robust_sigma
from srt.diagnosis.gravity_rotation import relation_by_turn
from srt.diagnosis.rotation_readings import RANK, robust_fit
from srt.model.table1 import AXES
from srt.result.verdict import USABLE
from srt.sensor_errors import GROUP_SLICES

if TYPE_CHECKING:
    from srt.diagnosis.gravity_rotation import ManoeuvreReadings, TurningBlocks
    from srt.diagnosis.rotation_readings import Rotations
    from srt.recording.recording import Fixture, Recording
    from srt.result.calibration import Calibration
    from srt.types import Array, Indices, Sensor

OUTLIER: Final = 8.0
"""Ratio of a residual to the median residual, above which a rotation or a window is an outlier, as after a bump."""
MOST_OUTLIERS: Final = 0.2
"""Share of outliers from which none is excluded: so many are no outliers."""
_BY_HAND: Final = 0.1
"""Common error of the rotation of gravity in turns by hand: the hand accelerates the unit alike in all of them, and an
acceleration of 1 m/s² is a tenth of gravity."""
LEAST_FREEDOM: Final = 8
"""Fewest degrees of freedom for an estimate of the scatter."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Fit of readings, shape (n, 3), to nominal vectors: ``reading ≈ matrix @ nominal + offset``.

    The matrix is identity for a perfect IMU in the nominal frame; ``rank`` is 3 if the nominal vectors determine it.
    """

    matrix: Array
    offset: Array
    residual: Array
    rank: int


def gyro_fit(rotations: Rotations) -> LinearFit:
    """Fit of measured to nominal rotations: raw gyro matrix in the nominal frame; residuals in rad."""
    return _fit(rotations.nominal, rotations.turned, 0)


def accel_fit(poses: tuple[Array, Array]) -> LinearFit:
    """Fit of stationary readings to the nominal specific force: raw accelerometer matrix, and bias in m/s²."""
    return _fit(*poses, 1)


def _fit(nominal: Array, reading: Array, offsets: int) -> LinearFit:
    """Fit with an offset or none: least squares without the outliers from least absolute deviations."""
    if len(nominal) == 0:
        return LinearFit(np.eye(3), np.zeros(3), np.zeros((0, 3)), 0)
    size = np.linalg.norm(nominal, axis=1, keepdims=True)
    design = np.hstack([nominal / size, np.ones((len(nominal), offsets))])
    rank = np.linalg.matrix_rank(design, tol=RANK)
    solution = robust_fit(design, reading / size)
    left = np.linalg.norm(reading - size * (design @ solution), axis=1)
    kept = left <= OUTLIER * np.median(left)
    if kept.mean() > 1.0 - MOST_OUTLIERS and np.linalg.matrix_rank(design[kept], tol=RANK) == rank:
        solution = np.linalg.lstsq(size[kept] * design[kept], reading[kept], rcond=None)[0]
    residual = reading - size * (design @ solution)
    return LinearFit(solution[:3].T, size[0] * solution[3:].sum(axis=0), residual, int(rank) - offsets)


class RawTriads(NamedTuple):
    """Raw sensor model of both triads: gyro matrix, accelerometer matrix, and accelerometer bias in m/s²."""

    gyro: Array
    accel: Array
    accel_bias: Array


def raw_triads(gyro: LinearFit, accel: LinearFit) -> RawTriads:
    """Raw gyro matrix, and raw accelerometer matrix and bias, in the nominal frame.

    The result is identity and zero if the rotations are not labelled or cover too few directions. If the labels
    determine only one of both triads, the other one is taken as perfect. The matrix is then given without its rotation
    relative to the nominal frame, so that both triads refer to the same frame except for misalignments.
    """
    seen = [fit.rank == 3 for fit in (gyro, accel)]
    matrices = [fit.matrix if own else np.eye(3) for fit, own in zip((gyro, accel), seen, strict=True)]
    if not all(np.linalg.cond(matrix) * RANK < 1.0 for matrix in matrices):
        return RawTriads(np.eye(3), np.eye(3), np.zeros(3))
    if not all(seen):
        # At the beginning of a test: in the nominal frame, only one of the matrices would include the mounting.
        matrices = [polar(matrix, side="left")[1] for matrix in matrices]
    return RawTriads(matrices[0], matrices[1], accel.offset if seen[1] else np.zeros(3))


class MeasuredAngles(NamedTuple):
    """Rotations without outliers.

    ``sequence`` is the number of the sequence of each of L rotations, ``measured`` its angle, rad; ``by_axis``, shape
    (L, 3), are the magnitudes of the components of the nominal rotation (columns of the scale factors), and ``fixed``,
    shape (L, 6), the columns of scale factors and asymmetries, rad.
    """

    sequence: Indices
    measured: Array
    by_axis: Array
    fixed: Array


def measured_angles(rotations: Rotations) -> MeasuredAngles | None:
    """Measured angles of the rotations; None with too few rotations.

    A rotation with lost samples, or by a wrong angle, is an outlier. A step of the scale factors changes many angles.
    """
    numbers, nominal, turned = rotations
    measured = np.einsum("la,la->l", turned, nominal) / np.linalg.norm(nominal, axis=1)
    by_axis = np.abs(nominal)
    fixed = np.concatenate([by_axis, nominal], axis=1)
    if len(numbers) < LEAST_FREEDOM + fixed.shape[1]:
        return None
    left = np.abs(measured - (fixed @ robust_fit(fixed, measured[:, None]))[:, 0])
    outlier = left > OUTLIER * np.median(left)
    kept = ~outlier if outlier.mean() < MOST_OUTLIERS else np.ones(len(numbers), dtype=np.bool_)
    return MeasuredAngles(numbers[kept], measured[kept], by_axis[kept], fixed[kept])


@dataclass(frozen=True, slots=True, eq=False)
class ScaleRatios:
    """Ratios of reading to truth of one triad, NaN where unknown.

    ``typical`` is the median of the triad; ``axes``, shape (3,), are those of the sensor axes. ``axis_scatter`` is the
    scatter of single rotations or poses: standard deviation of the logarithm of their ratio to that of their axis.
    ``common_sigma`` is the standard deviation of an error that the logarithms of all axes have.
    """

    typical: float
    axes: Array
    axis_scatter: float
    common_sigma: float = 0.0

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


def gyro_ratios_to_gravity(by_labels: ScaleRatios, blocks: TurningBlocks | None, relation: Array | None) -> ScaleRatios:
    """Ratios of the gyros to the rotation of gravity (matrix K), if they contradict those to recognised angles."""
    if relation is None or blocks is None:
        return by_labels
    axes = 1.0 / np.linalg.norm(relation, axis=0)
    of_turns = np.log(relation_by_turn(blocks, relation))
    scatter = float(robust_sigma(of_turns - np.median(of_turns))) if of_turns.size else math.inf
    by_gravity = ScaleRatios(float(np.median(axes)), axes, math.hypot(RAW_SCALE, scatter), _BY_HAND)
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
        sizes = np.linalg.norm(recording.accel, axis=1) * (recording.rates_factor / gravity)
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
