"""Linear part of a calibration, and its triangular factors.

Most formats hold no scale-factor asymmetry: the exported model is linear, ``y = M v + b``. There are two ways to choose
M and b where ``y = M v + s ∘ |v| + b``:

* "leave": M and b as they are. The slope is the mean of both signs, the best linear fit for motion that is symmetric
  about zero, and b is exact where a channel is at zero. ``s |v|`` remains as an error.
* "fit": ``|v|`` of every channel is replaced by the line ``α v + β`` that fits it best over a given recording, hence
  ``M + diag(s α)`` and ``b + s β``. For a unit that is mounted level, z always sees +g, and its asymmetry goes wholly
  into that scale. It is right for motion like the recording's, and for no other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError

if TYPE_CHECKING:
    from srt.model.sensor_model import Triad
    from srt.types import Array


ASYMMETRY: Final = ("leave", "fit")

_MOVING_FROM: Final = 1e-9
"""Standard deviation of a channel over its largest value below which it counts as constant: rounding of doubles."""

_REVERSED: Final = np.eye(3)[::-1]


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """Linear sensor model ``y = M v + b`` of a triad."""

    matrix: Array  # shape (3, 3)
    bias: Array  # shape (3,), rad/s or m/s²

    def correct(self, readings: Array) -> Array:
        """True values of readings, shape (n, 3)."""
        return np.asarray(np.linalg.solve(self.matrix, (readings - self.bias).T).T)

    def turned(self, C: Array) -> LinearModel:
        """The same model for v in other axes; C takes components to these."""
        return LinearModel(self.matrix @ C.T, self.bias)

    def before(self, matrix: Array, offset: Array, rotation: Array) -> LinearModel:
        """Model of readings r whose log is ``y = C A (r − o)``: A ``matrix``, o ``offset``, C ``rotation``.

        ``r = o + A⁻¹ Cᵀ y = (A⁻¹ Cᵀ M C) (Cᵀ v) + o + A⁻¹ Cᵀ b``, in the axes of the sensors.
        """
        undone = np.linalg.solve(matrix, rotation.T)
        return LinearModel(undone @ self.matrix @ rotation, offset + undone @ self.bias)

    @property
    def inverse(self) -> Array:
        """M⁻¹."""
        return np.asarray(np.linalg.inv(self.matrix))


def linear_part(triad: Triad, motion: Array | None = None) -> LinearModel:
    """Linear part of a triad.

    Parameters
    ----------
    triad : Triad
        In MARS axes.
    motion : ndarray, shape (n, 3), rad/s or m/s², optional
        True values in MARS axes to fit the asymmetry to; None leaves it out.

    Returns
    -------
    LinearModel
        In MARS axes.
    """
    matrix, bias = triad.matrix, triad.bias
    if motion is not None:
        size = np.abs(motion)
        deviation, size_deviation = motion - motion.mean(axis=0), size - size.mean(axis=0)
        variance = np.mean(deviation**2, axis=0)
        # For a channel that is constant but for rounding, any slope would fit.
        moving = np.sqrt(variance) > _MOVING_FROM * size.max(axis=0)
        slope = np.where(moving, np.mean(deviation * size_deviation, axis=0) / np.where(moving, variance, 1.0), 0.0)
        offset = size.mean(axis=0) - slope * motion.mean(axis=0)
        matrix = matrix + np.diag(triad.asymmetry * slope)
        bias = bias + triad.asymmetry * offset
    return LinearModel(matrix, bias)


def axis_factors(matrix: Array) -> Array:
    """Factors, one for each axis, with the least error over true values of all directions alike, shape (3,).

    Row i of the sensor model's matrix being m, ``factor_i = m_i / |m|²``.
    """
    return np.asarray(np.diag(matrix) / np.sum(matrix**2, axis=1))


def lower_rotation(M: Array) -> tuple[Array, Array]:
    """Write ``M = L Q``, L lower-triangular with a positive diagonal and Q a rotation.

    Raises InputError if det M is not positive.
    """
    if not np.linalg.det(M) > 0.0:
        raise InputError("A triad of this calibration is left-handed or flat: it has no such form; calibrate again.")
    q, r = np.linalg.qr(M.T)
    signs = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    # Elements above the diagonal become exactly zero: formats have no room for their rounding.
    return np.tril(r.T * signs), signs[:, None] * q.T


def upper_rotation(M: Array) -> tuple[Array, Array]:
    """Write ``M = R Q``, R upper-triangular with a positive diagonal and Q a rotation.

    Raises InputError if det M is not positive.
    """
    lower, turn = lower_rotation(_REVERSED @ M @ _REVERSED)
    return np.triu(_REVERSED @ lower @ _REVERSED), _REVERSED @ turn @ _REVERSED


FACTORS: Final = {"lower": lower_rotation, "upper": upper_rotation}
"""Factorisations by the triangle of the accelerometer matrix."""
