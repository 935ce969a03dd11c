"""Rotation sequences that a fixture can execute, as angles of its axes and as rotations about IMU axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.model.table1 import AXES, Sequence
from srt.planning.stand import AXIS_NAMES, INNER, OUTER, QUARTER_DEG

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from srt.planning.stand import Stand
    from srt.types import Indices

    Legs = tuple[tuple[int, int], ...]

_PAIR_ANGLES: Final = (90, -90, 180, -180, 270, -270)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A sequence on the fixture: start pose and legs.

    Attributes
    ----------
    start_deg : (int, int)
        Inner and outer angle at the start, multiples of 90.
    legs : tuple of (axis, angle in deg)
        Axis 0 is the inner one, 1 the outer one; angles are signed multiples of 90.
    """

    start_deg: tuple[int, int]
    legs: Legs

    @property
    def path_deg(self) -> tuple[tuple[int, int], ...]:
        """Inner and outer angle before, between and after the legs."""
        angles = [self.start_deg]
        for axis, turn in self.legs:
            inner, outer = angles[-1]
            angles.append((inner + turn, outer) if axis == INNER else (inner, outer + turn))
        return tuple(angles)

    @property
    def end_deg(self) -> tuple[int, int]:
        """Inner and outer angle at the end."""
        return self.path_deg[-1]

    @property
    def rotations(self) -> tuple[tuple[str, int], ...]:
        """Rotations as IMU axis and signed angle in deg."""
        out = []
        for (inner, _), (axis, turn) in zip(self.path_deg, self.legs, strict=False):
            if axis == INNER:
                out.append(("z", turn))
            else:
                letter, sign = _letter(outer_axis(inner))
                out.append((letter, sign * turn))
        return tuple(out)

    @property
    def down(self) -> str:
        """IMU axis that is down at the start, with its sign: "z", "-z"."""
        return _signed(down_axis(*self.start_deg))

    @property
    def along_outer(self) -> str:
        """IMU axis along the outer axis at the start, with its sign."""
        return _signed(outer_axis(self.start_deg[INNER]))

    @property
    def end_down(self) -> str:
        """IMU axis that is down at the end, with its sign."""
        return _signed(down_axis(*self.end_deg))

    @property
    def label(self) -> str:
        """Start and rotations in one word: ``z/y +360y``; a block that repeats is written once."""
        words = [f"{turn:+d}{axis}" for axis, turn in self.rotations]
        for size in range(1, len(words) // 2 + 1):
            times, rest = divmod(len(words), size)
            if rest == 0 and words == words[:size] * times:
                block = " ".join(words[:size])
                return f"{self.down}/{self.along_outer} ({block})x{times}"
        return f"{self.down}/{self.along_outer} {' '.join(words)}"

    @property
    def key(self) -> tuple[str, tuple[tuple[str, int], ...]]:
        """What the unit goes through, whatever the heading: what is down, and the rotations."""
        return self.down, self.rotations

    def catalogue_sequence(self) -> Sequence:
        """Give the sequence in the form of Table 1."""
        inner, outer = (math.radians(a) for a in self.start_deg)
        rotations = tuple((axis, math.radians(turn)) for axis, turn in self.rotations)
        return Sequence(self.label, self.down, self.along_outer, inner, outer, rotations)

    def turning_s(self, stand: Stand) -> float:
        """Time of all legs, s."""
        return sum(stand.axes[axis].turn_s(turn) for axis, turn in self.legs)

    def own_s(self, stand: Stand) -> float:
        """Time from the end of the start window to the beginning of the end window, s."""
        return self.turning_s(stand) + stand.settle_s

    def obstacle(self, stand: Stand) -> str | None:
        """Why the fixture cannot execute it, naming the rotation; None if it can."""
        for one, angle, name in zip(stand.axes, self.start_deg, AXIS_NAMES, strict=True):
            standing = angle in one.standing_deg() if one.travel_deg or not one.turns else angle % QUARTER_DEG == 0
            if not standing:
                return f"the {name} axis cannot stand at its start angle of {angle} deg"
        for number, ((axis, turn), (before, after)) in enumerate(
            zip(self.legs, pairwise(self.path_deg), strict=True), start=1
        ):
            what = f"rotation {number} ({turn:+d} deg about the {AXIS_NAMES[axis]} axis)"
            if not stand.axes[axis].turns:
                return f"{what}: that axis does not turn, it is set by hand"
            if not stand.axes[axis].allows(after[axis]):
                travel = stand.axes[axis].travel_deg
                assert travel is not None
                return (
                    f"{what} would go from {before[axis]} to {after[axis]} deg, beyond the travel of "
                    f"{travel[0]:g} to {travel[1]:g} deg"
                )
        return None

    def alternatives(self, stand: Stand) -> tuple[Candidate, ...]:
        """The same attitudes by other angles of the axes, this one among them, as far as the fixture can."""
        choices = []
        for axis, angle in zip(stand.axes, self.start_deg, strict=True):
            standing = axis.standing_deg() if axis.travel_deg is not None or not axis.turns else (angle,)
            choices.append([a for a in standing if (a - angle) % 360 == 0])
        found = [Candidate((inner, outer), self.legs) for inner, outer in product(*choices)]
        return tuple(c for c in found if c.obstacle(stand) is None)


def outer_axis(inner_deg: int) -> Indices:
    """Direction of the outer axis in IMU components: (sin, cos, 0) of the inner angle."""
    a = math.radians(inner_deg)
    return np.rint([math.sin(a), math.cos(a), 0.0]).astype(np.intp)


def down_axis(inner_deg: int, outer_deg: int) -> Indices:
    """Direction of down in IMU components: the third row of R_y(outer) R_z(inner)."""
    i, o = math.radians(inner_deg), math.radians(outer_deg)
    return np.rint([-math.sin(o) * math.cos(i), math.sin(o) * math.sin(i), math.cos(o)]).astype(np.intp)


def _letter(direction: Indices) -> tuple[str, int]:
    k = int(np.flatnonzero(direction)[0])
    return AXES[k], int(direction[k])


def _signed(direction: Indices) -> str:
    letter, sign = _letter(direction)
    return letter if sign > 0 else f"-{letter}"


def from_catalogue(sequence: Sequence, stand: Stand | None = None) -> Candidate:
    """Put a sequence that is stated in IMU axes on the fixture.

    Parameters
    ----------
    sequence : Sequence
        Of Table 1, or with signed ``down`` and ``along_outer``.
    stand : Stand, optional
        Fixture: the angles are chosen within its travel.

    Raises
    ------
    InputError
        If no attitude of the fixture is the start, a rotation is about no axis of the fixture, or the fixture
        cannot execute it.
    """
    starts = [
        (i, o)
        for i, o in product((0, 90, 180, 270), repeat=2)
        if (_signed(down_axis(i, o)), _signed(outer_axis(i))) == (sequence.down, sequence.along_outer)
    ]
    if not starts:
        raise InputError(
            f"Sequence {sequence.id}: a two-axis fixture has no attitude with {sequence.down} down and "
            f"{sequence.along_outer} along its outer axis: the outer axis is horizontal, and z lies on the inner one."
        )
    inner = starts[0][INNER]
    legs = []
    for number, (axis, angle) in enumerate(sequence.rotations, start=1):
        turn = math.degrees(angle)
        if abs(turn - QUARTER_DEG * round(turn / QUARTER_DEG)) > 1e-6 or round(turn) == 0:
            raise InputError(
                f"Sequence {sequence.id}: rotation {number} turns by {turn:g} deg; plans are made of multiples of 90."
            )
        turn = QUARTER_DEG * round(turn / QUARTER_DEG)
        letter, sign = _letter(outer_axis(inner))
        if axis == "z":
            legs.append((INNER, turn))
            inner += turn
        elif axis == letter:
            legs.append((OUTER, sign * turn))
        else:
            raise InputError(
                f"Sequence {sequence.id}: rotation {number} is about {axis}, which does not lie along the outer axis "
                f"then ({letter} does): turn about z first."
            )
    candidate = Candidate(starts[0], tuple(legs))
    if stand is None:
        return candidate
    reasons = []
    for way in _shifted(candidate, stand):
        reasons.append(way.obstacle(stand))
        if reasons[-1] is None:
            return way
    raise InputError(f"Sequence {sequence.id} cannot be executed by this fixture: {reasons[0]}.")


def _shifted(candidate: Candidate, stand: Stand) -> Iterator[Candidate]:
    """The same attitudes by all whole turns that the standing angles allow, the nearest to zero first."""
    choices = []
    for axis, angle in zip(stand.axes, candidate.start_deg, strict=True):
        if axis.turns and axis.travel_deg is None:
            choices.append([angle])
        else:
            same = [a for a in axis.standing_deg() if (a - angle) % 360 == 0]
            choices.append(sorted(same, key=abs) or [angle])
    for inner, outer in product(*choices):
        yield Candidate((inner, outer), candidate.legs)


@dataclass(frozen=True, slots=True)
class Word:
    """Turns of a sequence, wherever it starts.

    Attributes
    ----------
    turns : tuple of (axis, angle in deg)
    in_imu_sense : bool
        The sign of a turn of the outer axis is that about the positive IMU axis that lies on it then, as Table 1 has
        it; False: that about the outer axis itself.
    """

    turns: Legs
    in_imu_sense: bool = False

    def legs(self, inner_deg: int) -> Legs:
        """Turns of the fixture's axes for a start at this inner angle."""
        if not self.in_imu_sense:
            return self.turns
        out = []
        for axis, turn in self.turns:
            if axis == INNER:
                out.append((axis, turn))
                inner_deg += turn
            else:
                out.append((axis, _letter(outer_axis(inner_deg))[1] * turn))
        return tuple(out)


def words(*, largest_turn_deg: int = 1080, most_legs: int = 16) -> tuple[Word, ...]:
    """All kinds of sequences that are tried.

    One turn of either axis by any number of quarters, and two turns of both axes one after the other, once or
    repeated: all sequences of Table 1 are such.

    Parameters
    ----------
    largest_turn_deg : int
        Of one leg.
    most_legs : int
        Of a sequence.
    """
    singles = [
        Word(((axis, sign * turn),))
        for axis in (INNER, OUTER)
        for turn in range(QUARTER_DEG, largest_turn_deg + 1, QUARTER_DEG)
        for sign in (1, -1)
    ]
    angles = [a for a in _PAIR_ANGLES if abs(a) <= largest_turn_deg]
    pairs = [
        Word(((first, a), (1 - first, b)) * times, in_imu_sense)
        for first in (INNER, OUTER)
        for a, b in product(angles, repeat=2)
        for times in range(1, most_legs // 2 + 1)
        for in_imu_sense in (False, True)
    ]
    return tuple(singles + pairs)


def executable(stand: Stand, kinds: Iterable[Word]) -> tuple[Candidate, ...]:
    """All that a fixture can execute; of sequences that differ in heading alone one."""
    found: dict[tuple[str, tuple[tuple[str, int], ...]], Candidate] = {}
    starts = sorted(
        product(stand.inner.standing_deg(), stand.outer.standing_deg()), key=lambda s: (abs(s[0]) + abs(s[1]), s)
    )
    for word in kinds:
        for start in starts:
            candidate = Candidate(start, word.legs(start[INNER]))
            key = candidate.key
            if key not in found and candidate.obstacle(stand) is None:
                found[key] = candidate
    return tuple(found.values())
