"""Kinds of static poses for the mount alignment: level, pitched nose down, pitched nose up."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError

if TYPE_CHECKING:
    from srt.types import Array


WITHIN_RAD: Final = math.radians(30.0)
"""Largest angle from level, or from a right angle, of a pose, rad: the sensor axes are near those of the mount."""


def pose_kinds(force: Array) -> Array:
    """Kind of each pose by the direction of gravity, shape (s,): 0 level, 1 nose down, -1 nose up, NaN neither.

    Parameters
    ----------
    force : ndarray, shape (s, 3), m/s²
        Compensated, in B.
    """
    down = -force / np.linalg.norm(force, axis=1, keepdims=True)
    near = math.cos(WITHIN_RAD)
    return np.select([down[:, 2] > near, down[:, 0] > near, down[:, 0] < -near], [0.0, 1.0, -1.0], np.nan)


def require_both(kind: Array) -> None:
    """Refuse poses that do not determine three angles. Raises DataError."""
    for there, what, pose in (
        (kind == 0.0, "level (z down)", "record the unit stationary on the levelled mount"),
        (np.abs(kind) == 1.0, "pitched by about 90° (x down or up)", "record the mount pitched by 90°"),
    ):
        if not there.any():
            raise DataError(
                f"None of the {len(kind)} static poses is {what} within {math.degrees(WITHIN_RAD):.0f}° in sensor "
                f"axes: {pose}, or correct the axes' names."
            )
