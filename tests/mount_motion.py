"""Motion of a mount on a fixture with one horizontal axis: level and pitched poses, and the errors of the mount.

Chain of frames (``C_ab`` takes b-components to a-components)::

    C_NED,M(0) = R_z(heading) · Exp(level)            mount in the level pose
    C_NED,M(θ) = Exp(θ p) · C_NED,M(0)                p: the axis, in NED
    C_M,B      = R_z(yaw) R_y(pitch) R_x(roll)        the sensor axes in the mount

The axis p is the mount's y axis, rotated by ``square`` (about down) and ``tilt`` (its y end below the horizon).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sims.physics.fixture import rotation
from sims.physics.free_motion import free_motion
from srt.recording.recording import SequenceLabel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from sims.physics.true_motion import TrueMotion
    from srt.recording.recording import Site
    from srt.types import Array

LEVEL_AND_NOSE_DOWN_RAD = (0.0, -0.5 * math.pi)
"""Pitch angles of the two poses of the procedure: level, and pitched by -90° about y, with x down."""


@dataclass(frozen=True, slots=True, eq=False)
class MountErrors:
    """Errors of one mount and its poses.

    Level errors of the mount about its x and its y axis, tilt of the axis from the horizontal (its y end down), its
    rotation about down from the mount's y axis, and the error of the fixture's angle in each pose (s,), in addition to
    ``level``; empty: none. All in rad.
    """

    level: Array = field(default_factory=lambda: np.zeros(2))
    tilt: float = 0.0
    square: float = 0.0
    pitch: Array = field(default_factory=lambda: np.zeros(0))


def draw_mount_errors(
    rng: np.random.Generator,
    pitch_rad: Sequence[float] = LEVEL_AND_NOSE_DOWN_RAD,
    *,
    level_sigma_rad: float = 0.0,
    axis_sigma_rad: float = 0.0,
    pitch_sigma_rad: float = 0.0,
) -> MountErrors:
    """Draw the errors of a mount with poses at these angles, from normal distributions with zero mean.

    At the angle 0 the mount is set with a level, and the error of the angle is zero.
    """
    level = rng.standard_normal(2) * level_sigma_rad
    tilt, square = (rng.standard_normal(2) * axis_sigma_rad).tolist()
    pitch = rng.standard_normal(len(pitch_rad)) * pitch_sigma_rad * (np.asarray(pitch_rad) != 0.0)
    return MountErrors(level, tilt, square, pitch)


def mount_matrix(angles_rad: ArrayLike) -> Array:
    """Matrix C_bm from roll, pitch and yaw of the sensor axes in the mount, shape (3, 3)."""
    roll, pitch, yaw = np.asarray(angles_rad, dtype=np.float64)
    x, y, z = np.eye(3)
    return np.asarray((rotation(yaw * z) @ rotation(pitch * y) @ rotation(roll * x)).T)


def simulate_mount(
    angles_rad: ArrayLike,
    *,
    site: Site,
    pitch_rad: Sequence[float] = LEVEL_AND_NOSE_DOWN_RAD,
    draw: MountErrors | None = None,
    heading_rad: float = 0.0,
    dwell_s: float = 10.0,
    settle_s: float = 0.5,
    peak_rate_rad_s: float = 1.0,
    sample_rate_hz: float = 100.0,
    earth_rate: bool = True,
    labelled: bool = True,
) -> TrueMotion:
    """Integrals of static poses with a rotation of the fixture between them; ``attitudes`` are those of the poses.

    ``angles_rad`` are roll, pitch and yaw of the sensor axes in the mount, ``pitch_rad`` the nominal angle of the
    fixture in each pose, from level, ``heading_rad`` that of the mount's x axis, clockwise from north; the other
    arguments are those of :func:`sims.physics.free_motion.free_motion`. Recordings state the windows if ``labelled``.
    """
    draw = draw or MountErrors()
    nominal = np.asarray(pitch_rad, dtype=np.float64)
    error = draw.pitch if draw.pitch.size else np.zeros(len(nominal))
    heading = rotation([0.0, 0.0, heading_rad])
    level = heading @ rotation([*draw.level, 0.0])
    cosine = math.cos(draw.tilt)
    axis = heading @ [-math.sin(draw.square) * cosine, math.cos(draw.square) * cosine, math.sin(draw.tilt)]
    angle = nominal + error
    first = rotation(angle[0] * axis) @ level @ mount_matrix(angles_rad).T
    # The axis is constant in B while B rotates about it.
    motion = free_motion(
        np.diff(angle)[:, np.newaxis] * (first.T @ axis),
        site=site,
        attitude=first,
        peak_rate_rad_s=peak_rate_rad_s,
        dwell_s=dwell_s,
        settle_s=settle_s,
        sample_rate_hz=sample_rate_hz,
        earth_rate=earth_rate,
    )
    if not labelled:
        return motion
    poses = [motion.windows[0][0], *(after for _, after in motion.windows)]
    return replace(motion, labels=tuple(SequenceLabel(a, b) for a, b in pairwise(poses)))
