"""What a fixture can do: travel, rate and acceleration of its two axes, and how long moving takes.

The outer axis is horizontal, the inner axis carries the IMU's z; at angles (0, 0) z is down and y along the outer axis.
Poses are whole quarter turns of both axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from srt.exceptions import InputError

INNER: Final = 0
OUTER: Final = 1
AXIS_NAMES: Final = ("inner", "outer")
QUARTER_DEG: Final = 90


@dataclass(frozen=True, slots=True)
class StandAxis:
    """One axis of a fixture.

    Attributes
    ----------
    rate_rad_s, acceleration_rad_s2 : float
        What a turn is executed with.
    travel_deg : (float, float) or None
        Limits of the angle; None: slip rings, any number of turns.
    turns : bool
        False: the axis does not turn under control. It is set by hand, between sequences only, to ``positions_deg``.
    positions_deg : tuple of float
        Where an axis that is set by hand can stand, multiples of 90°.
    set_s : float
        How long setting it by hand takes, s.

    Raises
    ------
    InputError
        An axis that no fixture has.
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
        if self.turns and not self.standing_deg():
            raise InputError(
                f"No multiple of 90 deg lies within the travel of {self.travel_deg} deg: the fixture has no pose in "
                "which an axis of the unit is vertical."
            )
        odd = [p for p in self.positions_deg if p % QUARTER_DEG]
        if not self.turns and (odd or not self.positions_deg):
            raise InputError(f"positions_deg is {list(self.positions_deg)}: give multiples of 90 deg, at least one.")

    def standing_deg(self) -> tuple[int, ...]:
        """Angles of rest, multiples of 90°: with slip rings one turn of them."""
        if not self.turns:
            return tuple(sorted({int(p) for p in self.positions_deg}))
        if self.travel_deg is None:
            return (0, 90, 180, 270)
        low, high = self.travel_deg
        first, last = math.ceil(low / QUARTER_DEG - 1e-9), math.floor(high / QUARTER_DEG + 1e-9)
        return tuple(QUARTER_DEG * k for k in range(first, last + 1))

    def allows(self, angle_deg: float) -> bool:
        """Whether the axis can be at an angle."""
        if not self.turns:
            return False
        return self.travel_deg is None or self.travel_deg[0] - 1e-9 <= angle_deg <= self.travel_deg[1] + 1e-9

    def turn_s(self, angle_deg: float) -> float:
        """Time of a turn from rest to rest, trapezoidal or triangular in rate, s."""
        size = abs(math.radians(angle_deg))
        if size * self.acceleration_rad_s2 < self.rate_rad_s**2:
            return 2.0 * math.sqrt(size / self.acceleration_rad_s2)
        return size / self.rate_rad_s + self.rate_rad_s / self.acceleration_rad_s2

    def way_deg(self, start_deg: float, end_deg: float) -> float:
        """Angle of the move from one standing angle to another: the shorter way where both are possible."""
        way = end_deg - start_deg
        return math.remainder(way, 360.0) if self.turns and self.travel_deg is None else way

    def move_s(self, start_deg: float, end_deg: float) -> float:
        """Time of the move from one standing angle to another, s."""
        way = self.way_deg(start_deg, end_deg)
        if way == 0.0:
            return 0.0
        return self.turn_s(way) if self.turns else self.set_s


@dataclass(frozen=True, slots=True)
class Stand:
    """A fixture's two axes, and its times.

    Attributes
    ----------
    inner, outer : StandAxis
    settle_s : float
        Wait after every turn or move before a window may begin, s.
    pause_s : float
        Stillness between the end of a sequence and the move to the next, s.
    """

    inner: StandAxis = StandAxis()
    outer: StandAxis = StandAxis()
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
    def axes(self) -> tuple[StandAxis, StandAxis]:
        """Inner and outer axis, in the order of angle pairs."""
        return self.inner, self.outer

    def move_s(self, start_deg: tuple[int, int], end_deg: tuple[int, int]) -> float:
        """Time from a sequence's end to the next one's start window, one axis after the other, s."""
        moves = sum(a.move_s(s, e) for a, s, e in zip(self.axes, start_deg, end_deg, strict=True))
        return self.pause_s + moves + self.settle_s
