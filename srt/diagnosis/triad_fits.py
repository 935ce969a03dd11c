"""Raw matrices of the gyro and accelerometer triads from the labelled rotations and poses, by two fits.

* Least squares (:func:`gyro_fit`, :func:`accel_fit`): the residuals show if the labels explain the readings, and the
  rank shows if the labels determine the matrix.
* Least absolute deviations (:func:`raw_triads`): a few sequences with wrong labels do not bias the matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.linalg import polar

from srt.diagnosis.rotation_readings import robust_fit

if TYPE_CHECKING:
    from srt.diagnosis.rotation_readings import Rotations
    from srt.types import Array, Indices


_RIDGE: Final = 1e-9
"""Relative singular value below which a direction is not observable; far above rounding, far below any rotation."""
_RANK: Final = 0.1
"""Smallest singular value of the unit vectors for full rank: below it, they lie within 6° of a plane."""
_SOUND: Final = 10.0
"""Condition number of a triad's matrix above which its fit has failed."""
OUTLIER: Final = 8.0
"""Ratio of a residual to the median residual, above which a rotation or a window is an outlier, as after a bump."""
MOST_OUTLIERS: Final = 0.2
"""Share of outliers from which none is excluded: so many are no outliers."""
LEAST_FREEDOM: Final = 8
"""Fewest degrees of freedom for an estimate of the scatter."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Least-squares fit of readings, shape (n, 3), to nominal vectors: ``reading ≈ matrix @ nominal + offset``.

    The matrix is identity for a perfect IMU in the nominal frame; ``rank`` is that of the nominal vectors.
    """

    matrix: Array
    offset: Array
    residual: Array
    rank: int


def gyro_fit(rotations: Rotations) -> LinearFit:
    """Fit of measured to nominal rotations: raw gyro matrix in the nominal frame; residuals in rad."""
    return _fit(rotations.nominal, rotations.turned, np.zeros((len(rotations.nominal), 0)))


def accel_fit(poses: tuple[Array, Array]) -> LinearFit:
    """Fit of stationary readings to the nominal specific force: raw accelerometer matrix, and bias in m/s²."""
    return _fit(*poses, np.ones((len(poses[0]), 1)))


def _fit(x: Array, y: Array, offset: Array) -> LinearFit:
    if len(x) == 0:
        return LinearFit(np.eye(3), np.zeros(3), np.zeros((0, 3)), 0)
    scale = float(np.linalg.norm(x, axis=1).mean())
    design = np.hstack([x / scale, offset])
    rank = int(np.linalg.matrix_rank(x / scale, tol=_RANK))
    solution = np.linalg.lstsq(design, y, rcond=_RIDGE)[0]
    matrix, bias = np.asarray(solution[:3].T / scale), np.asarray(solution[3:].sum(axis=0))
    return LinearFit(matrix, bias, np.asarray(y - design @ solution), rank)


class RawTriads(NamedTuple):
    """Raw sensor model of both triads: gyro matrix, accelerometer matrix, and accelerometer bias in m/s²."""

    gyro: Array
    accel: Array
    accel_bias: Array


def raw_triads(rotations: Rotations, poses: tuple[Array, Array], gravity: float) -> RawTriads:
    """Raw gyro matrix, and raw accelerometer matrix and bias, in the nominal frame.

    The result is identity and zero if the rotations are not labelled or cover too few directions. If the labels
    determine only one of both triads, the other one is taken as perfect. The matrix is then given without its rotation
    relative to the nominal frame, so that both triads refer to the same frame except for misalignments.
    """
    _, nominal, turned = rotations
    vertical, reading = poses
    # Rotations are divided by their angles, so that large rotations do not have more weight than small ones.
    angle = np.linalg.norm(nominal, axis=1, keepdims=True)
    design = np.hstack([vertical / gravity, np.ones((len(vertical), 1))])
    systems = ((nominal / angle, turned / angle), (design, reading / gravity))
    seen = [np.linalg.matrix_rank(x, tol=_RANK) == x.shape[1] for x, _ in systems]
    fits = [robust_fit(x, y) if own else np.eye(4, 3) for (x, y), own in zip(systems, seen, strict=True)]
    gyro, accel, bias = fits[0][:3].T, fits[1][:3].T, gravity * fits[1][3]
    if not all(np.linalg.cond(matrix) < _SOUND for matrix in (gyro, accel)):
        return RawTriads(np.eye(3), np.eye(3), np.zeros(3))
    if not all(seen):
        # At the beginning of a test: in the nominal frame, only one of the matrices would include the mounting.
        gyro, accel = (polar(matrix, side="left")[1] for matrix in (gyro, accel))
    return RawTriads(gyro, accel, bias)


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
    left = np.abs(measured - (fixed @ robust_fit(fixed, np.repeat(measured[:, None], 3, axis=1)))[:, 0])
    outlier = left > OUTLIER * np.median(left)
    kept = ~outlier if outlier.mean() < MOST_OUTLIERS else np.ones(len(numbers), dtype=np.bool_)
    return MeasuredAngles(numbers[kept], measured[kept], by_axis[kept], fixed[kept])
