"""Labels of a recording: its sequences, poses and runs at a stated rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from srt.exceptions import InputError
from srt.model.table1 import AXES, SEQUENCES, SIGNED_AXES

POSE_MIDDLE: Final = 0.02
"""Share of a pose between its two halves; it takes the place of the rotation and holds at least one sample."""


@dataclass(frozen=True, slots=True)
class SequenceLabel:
    """Label of one sequence in a recording: stationary window, rotation, stationary window.

    A pose without a rotation is a sequence too: its windows are the two halves of the pose, see :meth:`of_pose`.

    Attributes
    ----------
    start_static_s, end_static_s : (float, float)
        A window [a, b] holds the samples with a + dt/2 < t <= b + dt/2.
    id : str or None
        Name in Table 1 of Savage 2020 ("1" ... "14", "1a" ...); None for a free rotation.
    down, along_outer : str or None
        For an id outside Table 1: the IMU axis that points down, and the one that points along the outer
        axis, each "x", "y", "z", "-x", "-y" or "-z" ("-z" down: the z axis points up).
    rotations : tuple of (axis, angle in rad)
        For an id outside Table 1; the axis has no sign, the angle has.
    pose : bool
        True for a pose, in which the unit does not rotate.
    rate : (axis, rate in rad/s), or None
        Constant rate of the rotation about an IMU axis, as a rate table states it.
    rate_sigma : float or None
        1-sigma relative error of the stated rates, one for the whole recording.
    steady_s : (float, float) or None
        Window, limits as above, in which the rate is constant.
    number : int or None
        Place among all labels of the recording, from 1, where some are left out; None where none is.

    Raises
    ------
    InputError
        Windows that end before they start or overlap, invalid axes, or the same axis down and along the outer axis,
        an id outside Table 1 without its definition, or one of Table 1 with another definition, a pose with rotations,
        a stated rate without its sigma or window.
    """

    start_static_s: tuple[float, float]
    end_static_s: tuple[float, float]
    id: str | None = None
    down: str | None = None
    along_outer: str | None = None
    rotations: tuple[tuple[str, float], ...] = ()
    pose: bool = False
    rate: tuple[str, float] | None = None
    rate_sigma: float | None = None
    steady_s: tuple[float, float] | None = None
    number: int | None = field(default=None, compare=False)

    @classmethod
    def of_pose(
        cls,
        static_s: tuple[float, float],
        id: str | None = None,  # noqa: A002 - the field's name
        down: str | None = None,
        along_outer: str | None = None,
    ) -> SequenceLabel:
        """Label of a pose from its whole stationary window; a fiftieth in the middle separates the halves."""
        a, b = (float(limit) for limit in static_s)
        apart = 0.5 * POSE_MIDDLE * (b - a)
        middle = 0.5 * (a + b)
        return cls((a, middle - apart), (middle + apart, b), id, down, along_outer, pose=True)

    def __post_init__(self) -> None:
        for name in ("start_static_s", "end_static_s"):
            a, b = (float(limit) for limit in getattr(self, name))
            if not (math.isfinite(a) and math.isfinite(b) and a < b):
                raise InputError(
                    f"{self.title}: {name} is [{a:g}, {b:g}], but a window starts before it ends: correct its limits."
                )
            object.__setattr__(self, name, (a, b))
        if not self.start_static_s[1] < self.end_static_s[0]:
            raise InputError(
                f"{self.title}: the start window ends at {self.start_static_s[1]:g} s, not before the end "
                f"window starts ({self.end_static_s[0]:g} s), but the rotation lies between them: "
                "correct the windows."
            )
        rotations = tuple((axis, float(angle)) for axis, angle in self.rotations)
        object.__setattr__(self, "rotations", rotations)
        for axis in (self.down, self.along_outer):
            if axis is not None and axis not in SIGNED_AXES:
                raise InputError(f"{self.title}: {axis!r} is no IMU axis: use one of {', '.join(SIGNED_AXES)}.")
        for axis, _ in rotations:
            if axis not in AXES:
                raise InputError(
                    f"{self.title}: {axis!r} is no IMU axis to turn about: use x, y or z, and the angle's sign."
                )
        if self.down is not None and self.along_outer is not None and self.down[-1] == self.along_outer[-1]:
            raise InputError(
                f"{self.title}: axis {self.down[-1]} cannot be both down and along the outer axis, whichever way it "
                "points: name two axes."
            )
        if not all(math.isfinite(angle) for _, angle in rotations):
            raise InputError(f"{self.title}: a rotation angle is not a finite number: correct it.")
        if self.pose:
            self._check_pose()
        elif self.id is not None:
            self._check_definition(self.id)
        self._check_rate()

    def _check_pose(self) -> None:
        if self.rotations or self.rate is not None or self.id in SEQUENCES:
            raise InputError(
                f"{self.title} is a pose, in which the unit does not rotate: leave out rotations and rate, and give no "
                "id of Table 1."
            )
        if (self.down is None) != (self.along_outer is None):
            raise InputError(f"{self.title}: give both down and along_outer, or neither.")

    def _check_rate(self) -> None:
        if self.rate is None:
            if self.rate_sigma is not None or self.steady_s is not None:
                raise InputError(f"{self.title}: rate_sigma and steady_s belong to a stated rate: add it.")
            return
        axis, rate = self.rate[0], float(self.rate[1])
        if axis not in AXES or not math.isfinite(rate) or rate == 0.0:
            raise InputError(
                f"{self.title}: the stated rate is {self.rate!r}: give x, y or z, and a rate with its sign."
            )
        if self.rate_sigma is None or not 0.0 < self.rate_sigma < 1.0:
            raise InputError(f"{self.title}: a stated rate needs its 1-sigma relative error, above 0 and below 1.")
        if (
            self.steady_s is None
            or not self.start_static_s[1] <= self.steady_s[0] < self.steady_s[1] <= (self.end_static_s[0])
        ):
            raise InputError(
                f"{self.title}: the window steady_s, in which the stated rate is constant, must lie between the start "
                "and the end window: give [from, to]."
            )
        object.__setattr__(self, "rate", (axis, rate))

    def _check_definition(self, name: str) -> None:
        given = (self.down is not None, self.along_outer is not None, bool(self.rotations))
        known = SEQUENCES.get(name)
        if known is None:
            if not all(given):
                raise InputError(
                    f"{self.title} is not in Table 1 ({', '.join(SEQUENCES)}): give down, along_outer and "
                    "rotations with it, or leave the id out for a free turn."
                )
            return
        same = (
            self.down in (None, known.down)
            and self.along_outer in (None, known.along_outer)
            and (not self.rotations or _same_rotations(self.rotations, known.rotations))
        )
        if not same:
            raise InputError(f"{self.title} is defined by Table 1 in another way: give a different id to it.")

    @property
    def static_s(self) -> tuple[float, float]:
        """Whole stationary window of a pose, s."""
        return self.start_static_s[0], self.end_static_s[1]

    @property
    def title(self) -> str:
        """Name of the sequence in messages."""
        if self.id is None:
            kind = "pose" if self.pose else "free turn" if self.rate is None else "rate-table run"
            return f"The {kind} at {self.start_static_s[0]:g} s"
        return f"Sequence {self.id!r} at {self.start_static_s[0]:g} s"


def _same_rotations(first: tuple[tuple[str, float], ...], second: tuple[tuple[str, float], ...]) -> bool:
    return len(first) == len(second) and all(
        a == b and abs(x - y) < 1e-6 for (a, x), (b, y) in zip(first, second, strict=True)
    )
