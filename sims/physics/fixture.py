"""Geometry and errors of the two-axis fixture, from the Earth to the sensitive axes of the IMU.

Chain of frames (``C_ab`` takes b-components to a-components)::

    C_NED,base = R_z(heading) · Exp(base)                 base: level x, level y, north
    C_base,T   = R_y(outer) · R_x(ε) · R_z(inner) · Exp(mounting)
    C_T,B      = Uᵀ

``ε`` is the non-orthogonality of the axes: the angle between inner and outer axis is 90° + ε. ``U`` transforms
table-mounted components T into components in B. All sensor errors refer to B.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from srt.constants import EARTH_RATE_RAD_S
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from sims.physics.sequences import TurnSequence
    from srt.types import Array


def rotation(vector: ArrayLike) -> Array:
    """Matrix of a rotation vector: it transforms components in the rotated frame to those in the original frame.

    Parameters
    ----------
    vector : array_like, shape (..., 3), rad

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    v = np.asarray(vector, dtype=np.float64)
    size = np.linalg.norm(v, axis=-1)[..., np.newaxis, np.newaxis]
    unit = v / np.where(size[..., 0] > 0.0, size[..., 0], 1.0)
    cross = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        cross[..., i, j] = -unit[..., k]
        cross[..., j, i] = unit[..., k]
    half = np.sin(0.5 * size)
    return np.asarray(np.eye(3) + np.sin(size) * cross + 2.0 * half**2 * (cross @ cross))


def earth_rate_ned(latitude_rad: float) -> Array:
    """Rate of the Earth relative to inertial space in north, east, down, shape (3,), rad/s."""
    return EARTH_RATE_RAD_S * np.array([math.cos(latitude_rad), 0.0, -math.sin(latitude_rad)])


@dataclass(frozen=True, slots=True, eq=False)
class FixtureDraw:
    """Errors of one fixture and of one run on it.

    Attributes
    ----------
    base : ndarray, shape (3,), rad
        Level errors about base x and y, and north error: rotation vector from the nominal to the true base.
    mounting : ndarray, shape (3,), rad
        Rotation vector from the nominal to the true mounting of frame T.
    non_orthogonality : float
        ε, rad.
    starts : ndarray, shape (s, 2), rad
        Errors of the (inner, outer) angle at the start of each sequence, drawn independently for each axis.
    legs : tuple of ndarray, rad
        Error of each rotation, by sequence; it persists until the sequence ends.
    wobble : ndarray, shape (s, 2), rad
        Addition to ε in the start and in the end pose of each sequence (axis wobble), drawn independently.
    """

    base: Array = field(default_factory=lambda: np.zeros(3))
    mounting: Array = field(default_factory=lambda: np.zeros(3))
    non_orthogonality: float = 0.0
    starts: Array | None = None
    legs: tuple[Array, ...] | None = None
    wobble: Array | None = None

    def check_covers(self, sequences: Sequence[TurnSequence]) -> None:
        """Raise InputError unless the draw has start errors and all rotation errors for every sequence."""
        wanted = [len(s.rotations) for s in sequences]
        if self.starts is not None and self.starts.shape != (len(wanted), 2):
            raise InputError(
                f"The fixture draw holds start errors of shape {self.starts.shape} for {len(wanted)} "
                f"sequences: draw it for these sequences, shape ({len(wanted)}, 2)."
            )
        if self.wobble is not None and self.wobble.shape != (len(wanted), 2):
            raise InputError(
                f"The fixture draw holds wobble of shape {self.wobble.shape} for {len(wanted)} sequences: draw it for "
                f"these sequences, shape ({len(wanted)}, 2)."
            )
        if self.legs is not None and [len(e) for e in self.legs] != wanted:
            raise InputError(
                f"The fixture draw holds rotation errors for {[len(e) for e in self.legs]} rotations per "
                f"sequence, but the sequences have {wanted}: draw it for these sequences."
            )


def draw_fixture(
    rng: np.random.Generator,
    sequences: Sequence[TurnSequence],
    *,
    level_sigma_rad: float = 0.0,
    north_sigma_rad: float = 0.0,
    mounting_sigma_rad: float = 0.0,
    non_orthogonality_sigma_rad: float = 0.0,
    rotation_sigma_rad: float = 0.0,
    wobble_sigma_rad: float = 0.0,
) -> FixtureDraw:
    """Draw the errors of a fixture and of one run of these sequences, from normal distributions with zero mean."""
    return FixtureDraw(
        base=rng.standard_normal(3) * [level_sigma_rad, level_sigma_rad, north_sigma_rad],
        mounting=rng.standard_normal(3) * mounting_sigma_rad,
        non_orthogonality=float(rng.standard_normal() * non_orthogonality_sigma_rad),
        starts=rng.standard_normal((len(sequences), 2)) * rotation_sigma_rad,
        legs=tuple(rng.standard_normal(len(s.rotations)) * rotation_sigma_rad for s in sequences),
        # Without wobble nothing is drawn, so that a seed gives the same other errors with and without wobble.
        wobble=rng.standard_normal((len(sequences), 2)) * wobble_sigma_rad if wobble_sigma_rad else None,
    )


class FixtureTurned(NamedTuple):
    """Cosines and sines of the inner angle, the outer angle, and ε with the wobble, at some angles of the fixture."""

    inner: tuple[Array, Array]
    outer: tuple[Array, Array]
    lean: tuple[Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class FixtureGeometry:
    """Attitude of the IMU on the fixture for any pair of fixture angles.

    Attributes
    ----------
    base_from_ned : ndarray, shape (3, 3)
        C_base,NED.
    non_orthogonality : float
        ε, rad.
    body_from_inner : ndarray, shape (3, 3)
        Rotation from the frame fixed to the inner axis to B: U · Exp(mounting)ᵀ.
    """

    base_from_ned: Array
    non_orthogonality: float
    body_from_inner: Array

    @classmethod
    def build(cls, heading_rad: float, draw: FixtureDraw, U: Array) -> FixtureGeometry:
        """Combine heading, fixture errors and the rotation U from T to B."""
        ned_from_base = rotation([0.0, 0.0, heading_rad]) @ rotation(draw.base)
        return cls(ned_from_base.T, draw.non_orthogonality, U @ rotation(draw.mounting).T)

    def turned(self, inner: Array, outer: Array, wobble: Array | float = 0.0) -> FixtureTurned:
        """Cosines and sines at these angles; shapes (...) that broadcast, rad; the wobble is added to ε."""
        lean = self.non_orthogonality + np.asarray(wobble)
        return FixtureTurned(*((np.cos(angle), np.sin(angle)) for angle in (inner, outer, lean)))

    def to_body(self, v_base: Array, at: FixtureTurned) -> Array:
        """B-components of j vectors that are constant in the base.

        Parameters
        ----------
        v_base : ndarray, shape (j, 3)
        at : FixtureTurned
            At angles of shape (...).

        Returns
        -------
        ndarray, shape (3, j, ...)
        """
        return self._from_inner(self._constant(v_base, at))

    def turning_rate(
        self, at: FixtureTurned, inner_rate: Array, outer_rate: Array, wobble_rate: Array | float = 0.0
    ) -> Array:
        """Rate of B relative to the base in B-components, shape (3, ...), rad/s."""
        return self._from_inner(self._turning(at, inner_rate, outer_rate, wobble_rate))

    def sensed(
        self, v_base: Array, at: FixtureTurned, inner_rate: Array, outer_rate: Array, wobble_rate: Array | float = 0.0
    ) -> Array:
        """Sum of :meth:`turning_rate` and the first vector of :meth:`to_body`, and its other vectors."""
        vectors = self._constant(v_base, at)
        vectors[:, 0] += self._turning(at, inner_rate, outer_rate, wobble_rate)
        return self._from_inner(vectors)

    # In the frame fixed to the inner axis:

    def _constant(self, v_base: Array, at: FixtureTurned) -> Array:
        (ci, si), (co, so), (ce, se) = at
        columns = v_base.T.reshape(3, -1, *(1,) * max(ci.ndim, co.ndim, ce.ndim))
        x = co * columns[0] - so * columns[2]  # R_y(outer)ᵀ
        z = so * columns[0] + co * columns[2]
        y, z = ce * columns[1] + se * z, ce * z - se * columns[1]  # R_x(ε)ᵀ
        return np.stack(np.broadcast_arrays(ci * x + si * y, ci * y - si * x, z))  # R_z(inner)ᵀ

    @staticmethod
    def _turning(at: FixtureTurned, inner_rate: Array, outer_rate: Array, wobble_rate: Array | float) -> Array:
        (ci, si), _, (ce, se) = at
        # The outer axis is y of the outer frame, ε turns about its x; both rotate with the inner angle.
        along = ce * outer_rate
        x, y = si * along + ci * wobble_rate, ci * along - si * wobble_rate
        return np.stack(np.broadcast_arrays(x, y, inner_rate - se * outer_rate))

    def _from_inner(self, vectors: Array) -> Array:
        return np.asarray((self.body_from_inner @ vectors.reshape(3, -1)).reshape(vectors.shape))

    def attitude(self, inner: Array, outer: Array, wobble: Array | float = 0.0) -> Array:
        """C_NED,B at fixture angles of shape (...), shape (..., 3, 3)."""
        # Axes of the base in B are the columns of C_B,base.
        body_from_base = self.to_body(np.eye(3), self.turned(np.asarray(inner), np.asarray(outer), wobble))
        return np.asarray(self.base_from_ned.T @ np.moveaxis(body_from_base, (1, 0), (-2, -1)))
