"""Candidate rotation sequences: those that a fixture can execute, as angles of its axes and about IMU axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, product
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.model.table1 import AXES, RotationSequence
from srt.planning.fixture_kinematics import AXIS_NAMES, INNER, OUTER, QUARTER_DEG

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike

    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array

    AxisRotations = tuple[tuple[int, int], ...]

_PAIR_ANGLES: Final = (90, -90, 180, -180, 270, -270)
"""Angles of the two rotations of a pair, deg; whole turns are left to the patterns of one rotation."""
_QUARTER_TOLERANCE_DEG: Final = 1e-6
"""Rounding error of an angle that went through radians, deg: nearer to a multiple of 90, it is that multiple."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A sequence on the fixture: start pose and rotations of its axes.

    Attributes
    ----------
    start_deg : (int, int)
        Inner and outer angle at the start, multiples of 90.
    axis_rotations : tuple of (axis, angle in deg)
        Axis 0 is the inner one, 1 the outer one; angles are signed multiples of 90.
    """

    start_deg: tuple[int, int]
    axis_rotations: AxisRotations

    @property
    def path_deg(self) -> tuple[tuple[int, int], ...]:
        """Inner and outer angle before, between and after the rotations, deg."""
        angles = [self.start_deg]
        for axis, turn in self.axis_rotations:
            inner, outer = angles[-1]
            angles.append((inner + turn, outer) if axis == INNER else (inner, outer + turn))
        return tuple(angles)

    @property
    def end_deg(self) -> tuple[int, int]:
        """Inner and outer angle at the end, deg."""
        return self.path_deg[-1]

    @property
    def rotations(self) -> tuple[tuple[str, int], ...]:
        """Rotations as IMU axis and signed angle in deg."""
        out = []
        for (inner, _), (axis, turn) in zip(self.path_deg, self.axis_rotations, strict=False):
            if axis == INNER:
                out.append(("z", turn))
            else:
                letter, sign = _outer_letter(inner % 360)
                out.append((letter, sign * turn))
        return tuple(out)

    @property
    def down(self) -> str:
        """IMU axis that is down at the start, with its sign: "z", "-z"."""
        return _signed_down(*self.start_deg)

    @property
    def along_outer(self) -> str:
        """IMU axis along the outer axis at the start, with its sign."""
        letter, sign = _outer_letter(self.start_deg[INNER] % 360)
        return letter if sign > 0 else f"-{letter}"

    @property
    def end_down(self) -> str:
        """IMU axis that is down at the end, with its sign."""
        return _signed_down(*self.end_deg)

    @property
    def label(self) -> str:
        """Short text: down/along outer, then the rotations, as ``z/y +360y``; a repeated block is written once."""
        parts = [f"{turn:+d}{axis}" for axis, turn in self.rotations]
        for size in range(1, len(parts) // 2 + 1):
            times, rest = divmod(len(parts), size)
            if rest == 0 and parts == parts[:size] * times:
                block = " ".join(parts[:size])
                return f"{self.down}/{self.along_outer} ({block})x{times}"
        return f"{self.down}/{self.along_outer} {' '.join(parts)}"

    @property
    def key(self) -> tuple[str, tuple[tuple[str, int], ...]]:
        """Axis that is down at the start, and rotations: equal for sequences that differ in heading alone."""
        return self.down, self.rotations

    def catalogue_sequence(self) -> RotationSequence:
        """Sequence in the form of Table 1 (Savage 2020)."""
        inner, outer = (math.radians(a) for a in self.start_deg)
        rotations = tuple((axis, math.radians(turn)) for axis, turn in self.rotations)
        return RotationSequence(self.label, self.down, self.along_outer, inner, outer, rotations)

    def rotation_s(self, fixture: FixtureKinematics) -> float:
        """Time of all rotations, s."""
        return sum(fixture.axes[axis].turn_s(turn) for axis, turn in self.axis_rotations)

    def between_windows_s(self, fixture: FixtureKinematics) -> float:
        """Time from the end of the start window to the beginning of the end window, s."""
        return self.rotation_s(fixture) + fixture.settle_s

    def obstacle(self, fixture: FixtureKinematics) -> str | None:
        """Reason why the fixture cannot execute the sequence, naming the rotation; None if it can."""
        for one, angle, name in zip(fixture.axes, self.start_deg, AXIS_NAMES, strict=True):
            possible = angle in one.rest_angles_deg() if one.travel_deg or not one.turns else angle % QUARTER_DEG == 0
            if not possible:
                return f"the {name} axis cannot fixture at its start angle of {angle} deg"
        for number, ((axis, turn), (before, after)) in enumerate(
            zip(self.axis_rotations, pairwise(self.path_deg), strict=True), start=1
        ):
            what = f"rotation {number} ({turn:+d} deg about the {AXIS_NAMES[axis]} axis)"
            if not fixture.axes[axis].turns:
                return f"{what}: that axis does not turn, it is set by hand"
            if not fixture.axes[axis].allows(after[axis]):
                travel = fixture.axes[axis].travel_deg
                assert travel is not None
                return (
                    f"{what} would go from {before[axis]} to {after[axis]} deg, beyond the travel of "
                    f"{travel[0]:g} to {travel[1]:g} deg"
                )
        return None

    def alternatives(self, fixture: FixtureKinematics) -> tuple[Candidate, ...]:
        """Executable sequences with the same attitudes at other angles of the axes, this one included."""
        return tuple(way for way in _shifted(self, fixture) if way.obstacle(fixture) is None)


def outer_axis(inner_deg: ArrayLike) -> Array:
    """Direction of the outer axis in IMU components: (sin inner, cos inner, 0), shape (..., 3)."""
    a = np.radians(inner_deg)
    return np.asarray(np.rint(np.stack([np.sin(a), np.cos(a), np.zeros_like(a)], axis=-1)) + 0.0)


def down_axis(inner_deg: ArrayLike, outer_deg: ArrayLike) -> Array:
    """Direction of down in IMU components: the third row of R_y(outer) R_z(inner), shape (..., 3)."""
    i, o = np.radians(inner_deg), np.radians(outer_deg)
    return np.asarray(np.rint(np.stack([-np.sin(o) * np.cos(i), np.sin(o) * np.sin(i), np.cos(o)], axis=-1)) + 0.0)


@cache
def _outer_letter(inner_deg: int) -> tuple[str, int]:
    """IMU axis along the outer axis, and its sign; the planner asks thousands of candidates."""
    return _axis_letter(outer_axis(inner_deg))


def _signed_down(inner_deg: int, outer_deg: int) -> str:
    return _signed_down_within_turn(inner_deg % 360, outer_deg % 360)


@cache
def _signed_down_within_turn(inner_deg: int, outer_deg: int) -> str:
    letter, sign = _axis_letter(down_axis(inner_deg, outer_deg))
    return letter if sign > 0 else f"-{letter}"


def _axis_letter(direction: Array) -> tuple[str, int]:
    k = int(np.flatnonzero(direction)[0])
    return AXES[k], int(direction[k])


def from_catalogue(sequence: RotationSequence, fixture: FixtureKinematics | None = None) -> Candidate:
    """Convert a sequence that is stated in IMU axes to angles of the fixture.

    Parameters
    ----------
    sequence : RotationSequence
        Sequence of Table 1, or one with signed ``down`` and ``along_outer``.
    fixture : FixtureKinematics, optional
        If given, the angles are chosen within its travel.

    Raises
    ------
    InputError
        No attitude of the fixture is the start attitude, a rotation is not about an axis of the fixture, or the
        fixture cannot execute the sequence.
    """
    starts = [
        (i, o)
        for i, o in product((0, 90, 180, 270), repeat=2)
        if (_signed_down(i, o), Candidate((i, o), ()).along_outer) == (sequence.down, sequence.along_outer)
    ]
    if not starts:
        raise InputError(
            f"Sequence {sequence.id}: a two-axis fixture has no attitude with {sequence.down} down and "
            f"{sequence.along_outer} along its outer axis: the outer axis is horizontal, and z lies on the inner one."
        )
    inner = starts[0][INNER]
    rotations: list[tuple[int, int]] = []
    for number, (axis, angle) in enumerate(sequence.rotations, start=1):
        turn = math.degrees(angle)
        if abs(turn - QUARTER_DEG * round(turn / QUARTER_DEG)) > _QUARTER_TOLERANCE_DEG or round(turn) == 0:
            raise InputError(
                f"Sequence {sequence.id}: rotation {number} turns by {turn:g} deg; plans use multiples of 90 deg."
            )
        turn = QUARTER_DEG * round(turn / QUARTER_DEG)
        letter, sign = _outer_letter(inner % 360)
        if axis == "z":
            rotations.append((INNER, turn))
            inner += turn
        elif axis == letter:
            rotations.append((OUTER, sign * turn))
        else:
            raise InputError(
                f"Sequence {sequence.id}: rotation {number} is about {axis}, which does not lie along the outer axis "
                f"then ({letter} does): turn about z first."
            )
    candidate = Candidate(starts[0], tuple(rotations))
    if fixture is None:
        return candidate
    ways = candidate.alternatives(fixture)
    if ways:
        return ways[0]
    reason = next(_shifted(candidate, fixture)).obstacle(fixture)
    raise InputError(f"Sequence {sequence.id} cannot be executed by this fixture: {reason}.")


def _shifted(candidate: Candidate, fixture: FixtureKinematics) -> Iterator[Candidate]:
    """Yield the same sequence shifted by whole turns within the rest angles, the angles nearest to zero first."""
    choices = []
    for axis, angle in zip(fixture.axes, candidate.start_deg, strict=True):
        if axis.turns and axis.travel_deg is None:
            choices.append([angle])
        else:
            same = [a for a in axis.rest_angles_deg() if (a - angle) % 360 == 0]
            choices.append(sorted(same, key=abs) or [angle])
    for inner, outer in product(*choices):
        yield Candidate((inner, outer), candidate.axis_rotations)


@dataclass(frozen=True, slots=True)
class TurnPattern:
    """Rotations of a sequence, independent of its start attitude.

    Attributes
    ----------
    rotations : tuple of (axis, angle in deg)
    in_imu_sense : bool
        True: an outer rotation is signed about the positive IMU axis that lies along the outer axis, as in Table 1.
        False: it is signed about the outer axis itself.
    """

    rotations: AxisRotations
    in_imu_sense: bool = False

    def axis_rotations(self, inner_deg: int) -> AxisRotations:
        """Rotations of the fixture's axes for a start at this inner angle, deg."""
        if not self.in_imu_sense:
            return self.rotations
        out = []
        for axis, turn in self.rotations:
            if axis == INNER:
                out.append((axis, turn))
                inner_deg += turn
            else:
                out.append((axis, _outer_letter(inner_deg % 360)[1] * turn))
        return tuple(out)


def turn_patterns(*, largest_turn_deg: int = 1080, most_legs: int = 16) -> tuple[TurnPattern, ...]:
    """Patterns of rotations that the planner considers.

    They are one rotation of either axis by a multiple of 90 deg, and a rotation of one axis followed by one of the
    other, once or repeated. All sequences of Table 1 are among them.

    Parameters
    ----------
    largest_turn_deg : int
        Largest angle of one rotation, deg.
    most_legs : int
        Largest number of rotations in a sequence.
    """
    singles = [
        TurnPattern(((axis, sign * turn),))
        for axis in (INNER, OUTER)
        for turn in range(QUARTER_DEG, largest_turn_deg + 1, QUARTER_DEG)
        for sign in (1, -1)
    ]
    angles = [a for a in _PAIR_ANGLES if abs(a) <= largest_turn_deg]
    pairs = [
        TurnPattern(((first, a), (1 - first, b)) * times, in_imu_sense)
        for first in (INNER, OUTER)
        for a, b in product(angles, repeat=2)
        for times in range(1, most_legs // 2 + 1)
        for in_imu_sense in (False, True)
    ]
    return tuple(singles + pairs)


def executable_candidates(fixture: FixtureKinematics, patterns: Iterable[TurnPattern]) -> tuple[Candidate, ...]:
    """Sequences that a fixture can execute; one of those that differ in heading alone."""
    found: dict[tuple[str, tuple[tuple[str, int], ...]], Candidate] = {}
    starts = sorted(
        product(fixture.inner.rest_angles_deg(), fixture.outer.rest_angles_deg()),
        key=lambda s: (abs(s[0]) + abs(s[1]), s),
    )
    for pattern in patterns:
        for start in starts:
            candidate = Candidate(start, pattern.axis_rotations(start[INNER]))
            key = candidate.key
            if key not in found and candidate.obstacle(fixture) is None:
                found[key] = candidate
    return tuple(found.values())
