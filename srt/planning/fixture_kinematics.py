"""Kinematics of a two-axis fixture: travel, rate and acceleration of its axes, and the time that moves take.

The outer axis is horizontal, the inner axis lies along the IMU's z; at angles (0, 0), z is down and y along the outer
axis. Static poses have both axes at multiples of 90 deg.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from srt.exceptions import InputError

INNER: Final = 0
OUTER: Final = 1
"""Positions of the axes in pairs of angles."""
AXIS_NAMES: Final = ("inner", "outer")
QUARTER_DEG: Final = 90
"""Angle between neighbouring static poses, deg."""
_ANGLE_TOLERANCE_DEG: Final = 1e-9
"""Rounding error of a stated travel limit, deg."""


@dataclass(frozen=True, slots=True)
class AxisKinematics:
    """Kinematics of one axis of a fixture.

    Attributes
    ----------
    rate_rad_s, acceleration_rad_s2 : float
        Largest rate and constant acceleration of a rotation.
    travel_deg : (float, float) or None
        Limits of the angle; None: slip rings, unlimited rotation.
    turns : bool
        False: the axis is set by hand to ``positions_deg``, between sequences only.
    positions_deg : tuple of float
        Where an axis that is set by hand can fixture, multiples of 90°.
    set_s : float
        Time to set it by hand, s.

    Raises
    ------
    InputError
        Values that are contradictory or out of range.
    """

    rate_rad_s: float = 1.0
    acceleration_rad_s2: float = 10.0
    travel_deg: tuple[float, float] | None = None
    turns: bool = True
    positions_deg: tuple[float, ...] = (0.0,)
    set_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rate_rad_s", "acceleration_rad_s2"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} of a fixture axis is {value!r}: give a positive number.")
        if not (math.isfinite(self.set_s) and self.set_s >= 0.0):
            raise InputError(f"set_s of a fixture axis is {self.set_s!r}: give zero or a positive number of seconds.")
        if self.travel_deg is not None and not self.travel_deg[0] < self.travel_deg[1]:
            low, high = self.travel_deg
            raise InputError(f"The travel of a fixture axis is {low:g} to {high:g} deg: the first must be the smaller.")
        if self.turns and not self.rest_angles_deg():
            raise InputError(
                f"No multiple of 90 deg lies within the travel of {self.travel_deg} deg: the fixture has no pose in "
                "which an axis of the unit is vertical."
            )
        odd = [p for p in self.positions_deg if p % QUARTER_DEG]
        if not self.turns and (odd or not self.positions_deg):
            raise InputError(f"positions_deg is {list(self.positions_deg)}: give multiples of 90 deg, at least one.")

    def rest_angles_deg(self) -> tuple[int, ...]:
        """Angles at which the axis can rest, multiples of 90°; with slip rings, those of one turn."""
        if not self.turns:
            return tuple(sorted({int(p) for p in self.positions_deg}))
        if self.travel_deg is None:
            return (0, 90, 180, 270)
        low, high = self.travel_deg
        first, last = (
            math.ceil(low / QUARTER_DEG - _ANGLE_TOLERANCE_DEG),
            math.floor(high / QUARTER_DEG + _ANGLE_TOLERANCE_DEG),
        )
        return tuple(QUARTER_DEG * k for k in range(first, last + 1))

    def allows(self, angle_deg: float) -> bool:
        """Return True if the angle is within the travel of an axis that turns."""
        if not self.turns:
            return False
        if self.travel_deg is None:
            return True
        low, high = self.travel_deg
        return low - _ANGLE_TOLERANCE_DEG <= angle_deg <= high + _ANGLE_TOLERANCE_DEG

    def turn_s(self, angle_deg: float) -> float:
        """Time of a rotation from rest to rest, with a trapezoidal or triangular rate profile, s."""
        size = abs(math.radians(angle_deg))
        if size * self.acceleration_rad_s2 < self.rate_rad_s**2:
            return 2.0 * math.sqrt(size / self.acceleration_rad_s2)
        return size / self.rate_rad_s + self.rate_rad_s / self.acceleration_rad_s2

    def move_deg(self, start_deg: float, end_deg: float) -> float:
        """Angle of the move between two rest angles, deg: the shorter one where both senses are possible."""
        angle = end_deg - start_deg
        return math.remainder(angle, 360.0) if self.turns and self.travel_deg is None else angle

    def move_s(self, start_deg: float, end_deg: float) -> float:
        """Time of the move between two rest angles, s."""
        angle = self.move_deg(start_deg, end_deg)
        if angle == 0.0:
            return 0.0
        return self.turn_s(angle) if self.turns else self.set_s


@dataclass(frozen=True, slots=True)
class FixtureKinematics:
    """Kinematics of a two-axis fixture.

    Attributes
    ----------
    inner, outer : AxisKinematics
    settle_s : float
        Wait after every rotation or move before a stationary window may begin, s.
    pause_s : float
        Pause between the end of a sequence and the move to the next, s.
    """

    inner: AxisKinematics = AxisKinematics()
    outer: AxisKinematics = AxisKinematics()
    settle_s: float = 0.0
    pause_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("settle_s", "pause_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} of the fixture is {value!r}: give zero or a positive number of seconds.")
        if not (self.inner.turns or self.outer.turns):
            raise InputError("Neither axis of the fixture turns: a rotation test needs one that does.")

    @property
    def axes(self) -> tuple[AxisKinematics, AxisKinematics]:
        """Inner and outer axis, in the order of angle pairs."""
        return self.inner, self.outer

    def move_s(self, start_deg: tuple[int, int], end_deg: tuple[int, int]) -> float:
        """Time from the end of a sequence to the start window of the next; the axes move one after the other, s."""
        moves = sum(a.move_s(s, e) for a, s, e in zip(self.axes, start_deg, end_deg, strict=True))
        return self.pause_s + moves + self.settle_s
