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
from typing import TYPE_CHECKING

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

    def start_errors(self, sequence: int) -> tuple[float, float]:
        """Error of the (inner, outer) start angle of a sequence, rad."""
        if self.starts is None:
            return 0.0, 0.0
        return float(self.starts[sequence, 0]), float(self.starts[sequence, 1])

    def wobble_of(self, sequence: int) -> tuple[float, float]:
        """Addition to ε in the start and end pose of a sequence (axis wobble), rad."""
        return (0.0, 0.0) if self.wobble is None else (float(self.wobble[sequence, 0]), float(self.wobble[sequence, 1]))

    def leg_errors(self, sequence: int, count: int) -> Array:
        """Errors of a sequence's rotations, shape (count,), rad."""
        return np.zeros(count) if self.legs is None else self.legs[sequence]

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

    def to_body(
        self,
        v_base: Array,
        inner: Array,
        outer: Array,
        wobble: Array | float = 0.0,
    ) -> Array:
        """B-components of vectors that are constant in the base.

        Parameters
        ----------
        v_base : ndarray, shape (k, 3)
        inner, outer : ndarray, shape (...), rad
        wobble : ndarray, shape (...), or float, rad
            Addition to ε.

        Returns
        -------
        ndarray, shape (k, ..., 3)
        """
        columns = v_base.T.reshape(3, -1, *(1,) * inner.ndim)
        co, so, ci, si = np.cos(outer), np.sin(outer), np.cos(inner), np.sin(inner)
        x = co * columns[0] - so * columns[2]  # R_y(outer)ᵀ
        z = so * columns[0] + co * columns[2]
        lean = self.non_orthogonality + np.asarray(wobble)
        ce, se = np.cos(lean), np.sin(lean)
        y, z = ce * columns[1] + se * z, ce * z - se * columns[1]  # R_x(ε)ᵀ
        x, y = ci * x + si * y, ci * y - si * x  # R_z(inner)ᵀ
        m = self.body_from_inner
        return np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] * z for i in range(3)], axis=-1)

    def turning_rate(
        self,
        inner: Array,
        inner_rate: Array,
        outer_rate: Array,
        wobble: Array | float = 0.0,
        wobble_rate: Array | float = 0.0,
    ) -> Array:
        """Rate of B relative to the base in B-components, shape (..., 3), rad/s."""
        lean = self.non_orthogonality + np.asarray(wobble)
        ce, se = np.cos(lean), np.sin(lean)
        # The outer axis is y of the outer frame, ε turns about its x; both rotate with the inner angle.
        ci, si = np.cos(inner), np.sin(inner)
        x, y = si * ce * outer_rate + ci * wobble_rate, ci * ce * outer_rate - si * wobble_rate
        z = inner_rate - se * outer_rate
        m = self.body_from_inner
        return np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] * z for i in range(3)], axis=-1)

    def attitude(self, inner: Array, outer: Array, wobble: Array | float = 0.0) -> Array:
        """C_NED,B at fixture angles of shape (...), shape (..., 3, 3)."""
        # Row k of to_body(I) is axis k of the base in B; the stacked rows are C_base,B.
        base_from_body = np.moveaxis(self.to_body(np.eye(3), np.asarray(inner), np.asarray(outer), wobble), 0, -2)
        return np.asarray(self.base_from_ned.T @ base_from_body)
