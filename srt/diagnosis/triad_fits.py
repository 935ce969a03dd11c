"""Raw matrices of the gyro and accelerometer triads from the labelled rotations and poses, and the measured angles.

A few sequences with wrong labels do not bias the matrices. The residuals show if the labels explain the readings, and
the rank shows if the labels determine the matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.linalg import polar

from srt.diagnosis.rotation_readings import RANK, robust_fit

if TYPE_CHECKING:
    from srt.diagnosis.rotation_readings import Rotations
    from srt.types import Array, Indices


OUTLIER: Final = 8.0
"""Ratio of a residual to the median residual, above which a rotation or a window is an outlier, as after a bump."""
MOST_OUTLIERS: Final = 0.2
"""Share of outliers from which none is excluded: so many are no outliers."""
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
