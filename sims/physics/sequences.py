"""Rotation sequences of the fixture, and Table 1 of Savage 2020 in this form.

A sequence is stated as in the paper: the IMU axis that points down, the IMU axis along the outer axis, then
rotations about IMU axes. The inner axis of the fixture is along IMU z; the outer axis is horizontal, along
table y. A rotation about IMU z is therefore a rotation of the inner axis. Every other rotation must be about
an IMU axis along the outer axis, in either direction. This table is a separate copy for the simulator, as a
check of the estimators must be independent of their data.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Final

from srt.exceptions import InputError

INNER: Final = 0
OUTER: Final = 1
"""Column of each fixture axis in arrays of fixture angles."""

_QUARTER: Final = math.pi / 2.0


def _axis_along(*components: int) -> str:
    """Signed name of the IMU axis along a vector with one component ±1."""
    return next(("" if c > 0 else "-") + axis for axis, c in zip("xyz", components, strict=True) if c)


def _start_quarters() -> dict[tuple[str, str], tuple[int, int]]:
    """Quarter turns of the (inner, outer) axis, by start attitude (down, along outer), from z down, y along outer."""
    cosine = (1, 0, -1, 0)  # of 0, 1, 2, 3 quarter turns; sin(x) = cos(x - 90°)
    starts = {}
    for inner, outer in product((0, 1, 2, -1), repeat=2):
        ci, si, co, so = (cosine[quarters % 4] for quarters in (inner, inner - 1, outer, outer - 1))
        # Rows z and y of R_y(outer) R_z(inner): the base's vertical and the outer axis in IMU components.
        starts[_axis_along(-so * ci, so * si, co), _axis_along(si, ci, 0)] = (inner, outer)
    return starts


_START_QUARTERS: Final = _start_quarters()


@dataclass(frozen=True, slots=True)
class TurnSequence:
    """One sequence: a start attitude and rotations about IMU axes.

    Attributes
    ----------
    id : str or None
        Name from Table 1, another name, or None.
    down, along_outer : str
        IMU axis that points down, and IMU axis along the outer axis, at the start: "x", "y", "z", or "-x", "-y", "-z"
        for the opposite direction. The inner axis is IMU z, which therefore is never along the outer axis.
    rotations : tuple of (axis, angle in degrees)
        Consecutive rotations; the angle has a sign and any size, the axis has no sign. After a rotation about z that
        is not a multiple of 90°, no other IMU axis is along the outer axis.
    in_table_1 : bool
        True if the sequence is that of the same name in Table 1.

    Raises
    ------
    InputError
        If the fixture cannot reach the start attitude or rotate about a requested axis.
    """

    id: str | None
    down: str
    along_outer: str
    rotations: tuple[tuple[str, float], ...]
    in_table_1: bool = False

    def __post_init__(self) -> None:
        if (self.down, self.along_outer) not in _START_QUARTERS:
            raise InputError(
                f"Sequence {self.id!r} starts with {self.down} down and {self.along_outer} along the outer axis, which "
                "the two-axis fixture does not offer: its inner axis is IMU z, so put x, y, -x or -y along the outer "
                "axis, and one of the other two IMU axes down, with a sign or without."
            )
        self.fixture_legs()

    def start_rad(self) -> tuple[float, float]:
        """Nominal (inner, outer) angle at the start, rad."""
        inner, outer = _START_QUARTERS[self.down, self.along_outer]
        return inner * _QUARTER, outer * _QUARTER

    def fixture_legs(self) -> tuple[tuple[int, float], ...]:
        """Rotations as (fixture axis, signed angle in rad)."""
        inner_deg = 90.0 * _START_QUARTERS[self.down, self.along_outer][0]
        legs = []
        for axis, angle_deg in self.rotations:
            if axis == "z":
                legs.append((INNER, math.radians(angle_deg)))
                inner_deg += angle_deg
                continue
            # The outer axis in IMU components is (sin, cos, 0) of the inner angle: IMU x lies on it at +-90
            # degrees, IMU y at 0 and 180, pointing along it or against it.
            quarters = (inner_deg - (90.0 if axis == "x" else 0.0)) / 180.0
            if axis not in {"x", "y"} or abs(quarters - round(quarters)) > 1e-9:
                raise InputError(
                    f"Sequence {self.id!r} asks for a rotation about IMU {axis} while that axis does not lie "
                    f"along the outer axis (inner angle {inner_deg:g} deg): reorder its rotations, or turn "
                    "about z first."
                )
            direction = 1.0 if round(quarters) % 2 == 0 else -1.0
            legs.append((OUTER, direction * math.radians(angle_deg)))
        return tuple(legs)


def _table(rows: str) -> dict[str, TurnSequence]:
    table = {}
    for row in rows.strip().splitlines():
        name, start, *turns = row.split()
        rotations = tuple((turn[-1], float(turn[:-1])) for turn in turns)
        table[name] = TurnSequence(name, start[0], start[2], rotations, in_table_1=True)
    return table


TABLE_1: Final = _table(
    """
    1   z/y  +360y
    2   z/x  +360x
    3   x/y  +360z
    1a  z/y  -360y
    2a  z/x  -360x
    3a  x/y  -360z
    4   z/y  +180y +180z +180y +180z
    5   z/x  +180x +180z +180x +180z
    6   x/y  +180y +90z +180x +90z +180y +90z +180x +90z
    7   y/x  +180x
    8   z/x  +180x
    9   x/y  +180z
    10  y/x  +180z
    11  z/y  +180y
    12  x/y  +180y
    13  z/y  +180z +180y
    14  z/x  +180z +180x
    """
)
"""Table 1 of Savage 2020 by sequence id: start as down/along outer, then signed degrees and IMU axis."""


def table_sequences(ids: tuple[str, ...]) -> tuple[TurnSequence, ...]:
    """Sequences of Table 1 by id, in the given order; an unknown id raises InputError."""
    for name in ids:
        if name not in TABLE_1:
            raise InputError(f"There is no sequence {name!r} in Table 1: the ids are {', '.join(TABLE_1)}.")
    return tuple(TABLE_1[name] for name in ids)
