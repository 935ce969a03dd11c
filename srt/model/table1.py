"""Table 1 of Savage 2020: the 17 rotation sequences that have a closed form.

Table 1 of Savage 2017 starts sequences 2 and 2a with y along the outer axis and the inner angle 0, where no rotation
about x is possible. The 2020 table (x along outer, inner +90°) is correct.

Fixture: outer axis horizontal, along table y; inner axis along IMU z. Nominal attitude, IMU to fixture base:
``C_nom(inner, outer) = R_y(outer) R_z(inner)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

AXES: Final = ("x", "y", "z")

SIGNED_AXES: Final = (*AXES, *(f"-{axis}" for axis in AXES))
"""IMU axes with a sign: "-z" points opposite to z."""


def axis_vector(axis: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Unit vector of an axis of :data:`SIGNED_AXES` in IMU axes, shape (3,)."""
    vector = np.zeros(3)
    vector[AXES.index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


@dataclass(frozen=True, slots=True)
class RotationSequence:
    """One rotation sequence.

    Attributes
    ----------
    id : str
        Name in Table 1.
    down : str
        IMU axis that points down at the start, one of :data:`SIGNED_AXES`; "-z": the z axis points up.
    along_outer : str
        IMU axis that points along the outer rotation axis at the start, one of :data:`SIGNED_AXES`.
    inner_rad, outer_rad : float
        Initial fixture angles, rad.
    rotations : tuple of (axis, angle)
        Sequential rotations about IMU axes; angle in rad, signed.
    """

    id: str
    down: str
    along_outer: str
    inner_rad: float
    outer_rad: float
    rotations: tuple[tuple[str, float], ...]

    @property
    def horizontal(self) -> tuple[str, ...]:
        """Letters of the two IMU axes that are horizontal at the start, in order."""
        return tuple(axis for axis in AXES if axis != self.down[-1])

    @property
    def axes(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Unit vectors of the rotation axes in IMU axes, shape (m, 3), read-only."""
        return _axes_and_angles(self.rotations)[0]

    @property
    def angles_rad(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Signed rotation angles, shape (m,), rad, read-only."""
        return _axes_and_angles(self.rotations)[1]


@lru_cache
def _axes_and_angles(
    rotations: tuple[tuple[str, float], ...],
) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.float64]], np.ndarray[tuple[int], np.dtype[np.float64]]]:
    axes = np.eye(3)[[AXES.index(axis) for axis, _ in rotations]]
    angles = np.array([angle for _, angle in rotations], dtype=np.float64)
    axes.flags.writeable = angles.flags.writeable = False
    return axes, angles


_START_DEG = {  # (down, along outer) -> initial (inner, outer)
    ("z", "y"): (0.0, 0.0),
    ("z", "x"): (90.0, 0.0),
    ("x", "y"): (0.0, -90.0),
    ("y", "x"): (90.0, 90.0),
}

_ROWS = (
    ("1", "z", "y", ((360, "y"),)),
    ("2", "z", "x", ((360, "x"),)),
    ("3", "x", "y", ((360, "z"),)),
    ("1a", "z", "y", ((-360, "y"),)),
    ("2a", "z", "x", ((-360, "x"),)),
    ("3a", "x", "y", ((-360, "z"),)),
    ("4", "z", "y", ((180, "y"), (180, "z")) * 2),
    ("5", "z", "x", ((180, "x"), (180, "z")) * 2),
    ("6", "x", "y", ((180, "y"), (90, "z"), (180, "x"), (90, "z")) * 2),
    ("7", "y", "x", ((180, "x"),)),
    ("8", "z", "x", ((180, "x"),)),
    ("9", "x", "y", ((180, "z"),)),
    ("10", "y", "x", ((180, "z"),)),
    ("11", "z", "y", ((180, "y"),)),
    ("12", "x", "y", ((180, "y"),)),
    ("13", "z", "y", ((180, "z"), (180, "y"))),
    ("14", "z", "x", ((180, "z"), (180, "x"))),
)

SEQUENCES: Final = {
    name: RotationSequence(
        name,
        down,
        along_outer,
        math.radians(_START_DEG[down, along_outer][0]),
        math.radians(_START_DEG[down, along_outer][1]),
        tuple((axis, math.radians(angle)) for angle, axis in rotations),
    )
    for name, down, along_outer, rotations in _ROWS
}
"""The 17 sequences by id, in the order of Table 1."""
