"""Matching of manoeuvres with the sequences of Table 1: the best assignment of a chain of quarter turns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise, permutations, product
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.table1 import AXES, SEQUENCES, axis_vector
from srt.sequences.manoeuvres import QUARTER, Manoeuvre, face_vector, faces, quarter_turn, quarters, scales
from srt.sequences.preparation import nominal_attitude

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from srt.types import Array

    Word = tuple[tuple[int, int], ...]


QUARTER_TURN_WORDS: Final[dict[str, tuple[tuple[int, int], Word]]] = {
    name: (
        (AXES.index(s.down[-1]), round(axis_vector(s.down).sum())),
        tuple((AXES.index(axis), round(angle / QUARTER)) for axis, angle in s.rotations),
    )
    for name, s in SEQUENCES.items()
}
"""Face that is down at the start, and quarter turns, of every sequence."""

_STARTS: Final = {name: np.rint(nominal_attitude(s)).astype(np.int64) for name, s in SEQUENCES.items()}
"""Nominal attitude at the start of every sequence, T to base, whole numbers."""

_LONGEST: Final = max(len(word) for _, word in QUARTER_TURN_WORDS.values())
"""Legs of the longest sequence."""

_SPLIT: Final = 0.05
"""Cost, in legs, of a stationary window inside a sequence."""

ENOUGH_TURNS: Final = 4
"""Smallest number of manoeuvres for which other names of the axes are tried."""

_TRIED: Final = 4
"""Number of other namings of the axes that are matched in full: the most promising of 143."""


def _mappings() -> list[tuple[Array, Array]]:
    """Alternative namings of the axes: of the accelerometers, of the gyros, or of both.

    If both sensors are renamed, both signs of the gyros are tried: left-handed axes occur with either sign of rotation.
    """
    eye = np.eye(3)
    signed = [
        np.array(sign)[:, None] * eye[list(order)]
        for order in permutations(range(3))
        for sign in product((1.0, -1.0), repeat=3)
    ]
    others = [P for P in signed if not np.array_equal(P, eye)]
    return [
        *((eye, P) for P in others),
        *((P, eye) for P in others),
        *((P, P) for P in others),
        *((-P, P) for P in others if not np.array_equal(P, -eye)),
    ]


def promising_mappings(
    turns: SequenceOf[Manoeuvre], face: SequenceOf[tuple[int, int] | None]
) -> list[tuple[Array, Array]]:
    """Namings of the axes under which most single manoeuvres equal a sequence of Table 1."""
    spelled = [(quarters(turn.legs, np.ones(3)), face[turn.start_window]) for turn in turns]
    read = [(word, down) for word, down in spelled if word is not None and down is not None]
    known = set(QUARTER_TURN_WORDS.values())

    def count(mapping: tuple[Array, Array]) -> int:
        # New index and sign of each axis.
        (g_axis, g_sign), (a_axis, a_sign) = (
            (np.argmax(np.abs(P), axis=0).tolist(), P.sum(axis=0).astype(int).tolist()) for P in mapping
        )
        return sum(
            (
                (a_axis[down[0]], a_sign[down[0]] * down[1]),
                tuple((g_axis[axis], g_sign[axis] * number) for axis, number in word),
            )
            in known
            for word, down in read
        )

    ranked = sorted(((count(mapping), -k, mapping) for k, mapping in enumerate(_mappings())), key=lambda r: r[:2])
    return [mapping for number, _, mapping in ranked[: -_TRIED - 1 : -1] if number >= ENOUGH_TURNS]


@dataclass(frozen=True, slots=True, eq=False)
class SequenceMatch:
    """Sequence assigned to manoeuvres ``first`` to ``last`` (inclusive), and the piece's attitude that it implies."""

    name: str
    first: int
    last: int
    attitude: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SequenceReading:
    """Best assignment of sequences to all manoeuvres under one naming of the axes."""

    matches: tuple[SequenceMatch, ...]
    joins: frozenset[int]
    legs: int
    scale: Array
    words: tuple[Word | None, ...]
    faces: tuple[tuple[int, int] | None, ...]
    mapping: tuple[Array, Array]

    @classmethod
    def of(
        cls,
        turns: SequenceOf[Manoeuvre],
        apart: SequenceOf[bool],
        force: Array,
        join_cost: Array,
        gravity: float,
        mapping: tuple[Array, Array],
    ) -> SequenceReading:
        """Match the manoeuvres of all pieces, the axes named by ``mapping``."""
        gyro, accel = mapping
        mapped = [replace(turn, legs=turn.legs @ gyro.T) for turn in turns]
        face = faces(force @ accel.T, gravity)
        scale = scales(mapped, face)
        found = [quarters(turn.legs, scale) for turn in mapped]
        words = [
            tuple(word) if word is not None and _agrees(word, turn, face) else None
            for word, turn in zip(found, mapped, strict=True)
        ]
        inner = range(1, len(mapped))
        cuts = [t for t in inner if apart[mapped[t].start_window - 1] or None in (words[t - 1], words[t])]
        matches: list[SequenceMatch] = []
        joins: set[int] = set()
        for begin, end in pairwise([0, *cuts, len(mapped)]):
            found_here, joined = _read_piece(mapped, words, face, join_cost, begin, end)
            matches += found_here
            joins |= joined
        legs = sum(len(QUARTER_TURN_WORDS[m.name][1]) for m in matches)
        return cls(tuple(matches), frozenset(joins), legs, scale, tuple(words), tuple(face), mapping)


def _agrees(word: SequenceOf[tuple[int, int]], turn: Manoeuvre, face: SequenceOf[tuple[int, int] | None]) -> bool:
    """True if the quarter turns take the face that was down before to the face that is down after."""
    before, after = face[turn.start_window], face[turn.end_window]
    if before is None or after is None:
        return False
    down = face_vector(before)
    for axis, count in word:
        down = quarter_turn(axis, count).T @ down
    return np.array_equal(down, face_vector(after))


def _merged(words: SequenceOf[Word]) -> Word:
    """Quarter turns of several manoeuvres in a row; successive turns about one axis in one sense are added."""
    out: list[tuple[int, int]] = []
    for word in words:
        for axis, count in word:
            if out and out[-1][0] == axis and out[-1][1] * count > 0:
                out[-1] = (axis, out[-1][1] + count)
            else:
                out.append((axis, count))
    return tuple(out)


def _read_piece(
    turns: SequenceOf[Manoeuvre],
    words: SequenceOf[Word | None],
    face: SequenceOf[tuple[int, int] | None],
    join_cost: Array,
    begin: int,
    end: int,
) -> tuple[list[SequenceMatch], set[int]]:
    """Best assignment for manoeuvres ``begin`` to ``end`` of one contiguous piece; windows with a hidden join."""
    carried = [np.eye(3, dtype=np.int64)]
    for t in range(begin, end):
        C = carried[-1]
        for axis, count in words[t] or ():
            C = C @ quarter_turn(axis, count)
        carried.append(C)
    options: list[SequenceMatch] = []
    for i in range(begin, end):
        for j in range(i, min(i + _LONGEST, end)):
            spelled = _merged([w for w in words[i : j + 1] if w is not None])
            for name, (down, word) in QUARTER_TURN_WORDS.items():
                if word == spelled and face[turns[i].start_window] == down:
                    attitude = _STARTS[name] @ carried[i - begin].T
                    options.append(SequenceMatch(name, i, j, tuple(attitude.ravel().tolist())))
    return _best_path(options, begin, end, [float(join_cost[t.start_window]) for t in turns[begin:end]])


def _best_path(
    options: SequenceOf[SequenceMatch], begin: int, end: int, join_cost: SequenceOf[float]
) -> tuple[list[SequenceMatch], set[int]]:
    """Best-scoring selection of matches that do not overlap; each jump of the piece's attitude has a cost."""
    states = sorted({m.attitude for m in options})
    if not states:
        return [], set()
    number = {state: s for s, state in enumerate(states)}
    starting: dict[int, list[SequenceMatch]] = {}
    for m in options:
        starting.setdefault(m.first, []).append(m)
    # score[window][attitude]: best score up to this window with the piece in this attitude.
    score = np.full((end - begin + 1, len(states)), -np.inf)
    score[0] = 0.0
    came: dict[tuple[int, int], tuple[int, int, SequenceMatch | None]] = {}
    for i in range(begin, end):
        row, after = score[i - begin : i - begin + 2]
        top = int(np.argmax(row))
        joined = row[top] - join_cost[i - begin]
        for s in range(len(states)):
            if row[s] < joined:
                row[s] = joined
                came[i, s] = (i, top, None)
            if row[s] > after[s]:
                after[s] = row[s]
                came[i + 1, s] = (i, s, None)
        for m in starting.get(i, ()):
            s = number[m.attitude]
            value = row[s] + len(QUARTER_TURN_WORDS[m.name][1]) - _SPLIT * (m.last - m.first)
            if value > score[m.last + 1 - begin, s]:
                score[m.last + 1 - begin, s] = value
                came[m.last + 1, s] = (i, s, m)
    at = (end, int(np.argmax(score[-1])))
    matches, joins = [], set()
    while at in came:
        i, s, taken = came[at]
        if taken is not None:
            matches.append(taken)
        elif i == at[0] and begin < i < end:
            joins.add(i)
        at = (i, s)
    return matches[::-1], joins
