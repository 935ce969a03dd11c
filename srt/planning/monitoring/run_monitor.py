"""State of a running test from the samples so far: sequences done, operator's errors, and the next sequence.

The manoeuvres are those that :func:`srt.recognise` finds. Each is compared with the sequence that is next in the order
of the test, from an attitude that is followed by quarter turns through moves and sequences. Windows are compared with
one another by the checks of :mod:`srt.diagnosis`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG
from srt.diagnosis.staged_diagnosis import StagedDiagnosis
from srt.exceptions import DataError, InputError, did_you_mean
from srt.model.table1 import AXES, SEQUENCES, axis_vector
from srt.planning.monitoring.dwells import rest_motions
from srt.sequences.manoeuvres import end_attitude, quarter_turn, quarters
from srt.sequences.recognition import labelled, recognise
from srt.sequences.stationary_windows import no_turn_between

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.model.table1 import RotationSequence
    from srt.recording.recording import Recording, SequenceLabel
    from srt.sequences.recognition import RecognisedManoeuvre, Recognition
    from srt.types import Array, Indices

_SETTLED: Final = 0.7
"""Length of the last stationary window over the typical one, from which the manoeuvre before it counts as complete."""
_SMALL_TURN: Final = 10.0 * DEG
"""Angle below which a motion between two stationary windows is a disturbance, not a rotation of the test."""
_WINDOW_FAULTS: Final = ("noisy_window", "unsettled", "wrong_angle")
"""Faults of a sequence, named by the diagnosis, that an operator repeats it for."""
_EDGE_S: Final = 0.5
"""Distance from the edge of a stationary window, s, up to which a motion may lie beside it: blocks and smoothing."""
_FEW_WINDOWS: Final = 6
"""Windows below which the noise of one cannot be compared with that of the others."""


@dataclass(frozen=True, slots=True)
class OperatorError:
    """Deviation of the test from its order, or a disturbance.

    Attributes
    ----------
    kind : str
        "skipped", "wrong direction", "wrong turn", "wrong attitude", "moved", or the name of a fault of a window.
    sequence : str
        Sequence to do, or to do again.
    time_s : float
        When it happened.
    until_s : float
        End of the attempt that it spoils: the sequence, turned later than that, is a repetition.
    sentence : str
        Finding, and the action to take.
    """

    kind: str
    sequence: str
    time_s: float
    until_s: float
    sentence: str


@dataclass(frozen=True, slots=True)
class RunState:
    """State of a running test.

    Attributes
    ----------
    order : tuple of str
        Sequences of the test.
    labels : tuple of SequenceLabel
        Sequences found, in time order.
    errors : tuple of OperatorError
        Those that no later repetition has repaired, in time order.
    next : str or None
        Sequence to do next; None when all are done.
    turning : bool
        True while a manoeuvre is not complete.
    time_s : float
        Time of the last sample.
    unrecorded_s : float or None
        Time of the first move between sequences that the recording does not contain; None if it contains all. Then no
        move is judged.
    """

    order: tuple[str, ...]
    labels: tuple[SequenceLabel, ...]
    errors: tuple[OperatorError, ...]
    next: str | None
    turning: bool
    time_s: float
    unrecorded_s: float | None = None

    @property
    def done(self) -> tuple[str, ...]:
        """Ids of the sequences found, in time order."""
        return tuple(label.id or "" for label in self.labels)


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Manoeuvres of one sequence, or one other manoeuvre."""

    first: RecognisedManoeuvre
    last: RecognisedManoeuvre
    label: SequenceLabel | None
    start_s: float
    end_s: float
    legs: Array


def sequence_order(names: Sequence[str]) -> tuple[str, ...]:
    """Checked order of a test; empty: Table 1. Raises InputError for a name that is not in Table 1."""
    for name in names:
        if name not in SEQUENCES:
            raise InputError(
                f"There is no sequence {name!r}{did_you_mean(name, SEQUENCES)}: name those of Table 1, "
                f"{', '.join(SEQUENCES)}."
            )
    return tuple(names) or tuple(SEQUENCES)


def run_state(recording: Recording, order: Sequence[str] = ()) -> RunState:
    """State of a test from its samples so far.

    Parameters
    ----------
    recording : Recording
        Samples from the start attitude of the first sequence on, moves included; labels are ignored.
    order : sequence of str
        Sequences of the test; default: those of Table 1, in its order.

    Raises
    ------
    InputError
        An unknown sequence.
    """
    planned = sequence_order(order)
    bare = recording.with_sequences(()) if recording.sequences else recording
    now = float(bare.time[-1])
    try:
        found = recognise(bare, renaming=False)  # an operator who turns the other way looks like other axes
    except DataError:  # fewer than two stationary windows
        return RunState(planned, (), (), planned[0], turning=False, time_s=now)
    breaks, unrecorded_s = _unrecorded_moves(found, bare)
    follower = _Follower(planned, found, bare, breaks if unrecorded_s is not None else breaks[:0])
    attempts = _attempts(found, bare)
    typical = float(np.median([b - a for a, b in found.windows.tolist()[:-1]])) if len(found.windows) > 1 else 0.0
    last = int(found.windows[-1, 1] - found.windows[-1, 0])
    reached = len(bare.time) - int(found.windows[-1, 1]) <= max(2, round(0.5 / bare.nominal_interval_s))
    settled = last >= _SETTLED * typical
    turning = not reached
    for number, attempt in enumerate(attempts):
        if number == len(attempts) - 1 and not settled:
            turning = True
            if attempt.label is None or follower.may_continue(attempt):
                break
        follower.take(attempt)
    labels = tuple(follower.labels)
    moved = _moved(bare, attempts, follower.next, breaks, unrecorded=unrecorded_s is not None)
    errors = [*follower.errors, *moved, *_window_errors(bare, labels)]
    errors.sort(key=lambda error: error.time_s)
    return RunState(planned, labels, tuple(_open(errors, labels)), follower.next, turning, now, unrecorded_s)


def _unrecorded_moves(found: Recognition, recording: Recording) -> tuple[Indices, float | None]:
    """First samples after interruptions and joins, and the time of the first that changes the attitude, else None."""
    apart = [pair for pair in pairwise(found.windows.tolist()) if no_turn_between(recording, *pair)]
    breaks = np.union1d(recording.gaps, [second for (_, first), (second, _) in apart if first == second])
    for (a, b), (c, d) in apart:
        before, after = recording.accel[a:b].mean(axis=0), recording.accel[c:d].mean(axis=0)
        if before @ after < math.cos(_SMALL_TURN) * np.linalg.norm(before) * np.linalg.norm(after):
            return breaks.astype(np.intp), float(recording.time[b - 1])
    return breaks.astype(np.intp), None


class _Follower:
    """Attitude and order of a test, manoeuvre by manoeuvre; ``breaks`` are samples after unrecorded moves."""

    def __init__(self, order: tuple[str, ...], found: Recognition, recording: Recording, breaks: Indices) -> None:
        self.remaining = list(order)
        self.missed: list[str] = []
        self.found = found
        self.recording = recording
        self.breaks = breaks
        self.errors: list[OperatorError] = []
        self.labels: list[SequenceLabel] = []
        self.pose: Array | None = _start_pose(SEQUENCES[order[0]])

    @property
    def next(self) -> str | None:
        """Sequence to do next: a missed one first."""
        return next(iter([*self.missed, *self.remaining]), None)

    def may_continue(self, attempt: _Attempt) -> bool:
        """True if the rotations so far are the first ones of the expected sequence."""
        if self.next is None:
            return False
        expected, word = _word(SEQUENCES[self.next]), quarters(attempt.legs, self.found.scale)
        return word is not None and len(word) < len(expected) and word == expected[: len(word)]

    def take(self, attempt: _Attempt) -> None:
        """Compare one attempt with the order of the test."""
        passed = int(np.searchsorted(self.breaks, attempt.first.first, side="right"))
        if passed and self.next is not None:  # an attitude after an unrecorded move is taken for the expected one
            self.pose = _start_pose(SEQUENCES[self.next])
        self.breaks = self.breaks[passed:]
        if attempt.label is not None:
            self._take_sequence(attempt, attempt.label)
        elif float(np.linalg.norm(attempt.legs, axis=1).sum()) > _SMALL_TURN:
            self._take_other(attempt)

    def _take_sequence(self, attempt: _Attempt, label: SequenceLabel) -> None:
        name = label.id or ""
        expected = self.next
        if expected is not None and name != expected and _reversed_word(expected) == _word(SEQUENCES[name]) and (
            _same_start(expected, name)
        ):  # fmt: skip
            self._report(
                "wrong direction", expected, attempt, f"it was turned as sequence {name}, in the opposite direction"
            )
        elif name in self.remaining and self.remaining[0] != name and name not in self.missed:
            at = self.remaining.index(name)
            for skipped in self.remaining[:at]:
                self._report("skipped", skipped, attempt, f"sequence {name} was done in its place", "do it now")
            self.missed += self.remaining[:at]
            del self.remaining[:at]
        self.labels.append(label)
        for names in (self.missed, self.remaining):
            if name in names:
                names.remove(name)
                break
        self.pose = np.round(_start_pose(SEQUENCES[name]) @ end_attitude(SEQUENCES[name]))

    def _take_other(self, attempt: _Attempt) -> None:
        """Compare a manoeuvre that is no sequence: a move, or a sequence gone wrong."""
        word = quarters(attempt.legs, self.found.scale)
        before, self.pose = self.pose, self._pose_after(word)
        expected = self.next
        if expected is None:
            return
        there, later = SEQUENCES[expected], [*self.missed, *self.remaining][1:]
        began = before is not None and np.array_equal(before, _start_pose(there))
        if not began and self.pose is not None and np.array_equal(self.pose, _start_pose(there)):
            return  # a move to the start of the expected sequence
        said = ", ".join(_turn_text(*turn) for turn in word) if word is not None else "no quarter turns"
        wanted = ", ".join(f"{angle / DEG:+.0f}° {axis}" for axis, angle in there.rotations)
        if began:
            if word is not None and word == _reversed_word(expected):
                self._report("wrong direction", expected, attempt, f"turned {said}, expected {wanted}")
                return
            start_of = self._starts_at(later)
            first = _word(there)[0]
            begun = word is not None and word[0][0] == first[0] and word[0][1] * first[1] > 0
            if begun or start_of is None:
                self._report("wrong turn", expected, attempt, f"turned {said}, expected {wanted}")
                return
            self._report(
                "skipped", expected, attempt, f"the unit is at the start of sequence {start_of}", "go back and do it"
            )
            return
        start_of = self._starts_at(later)
        if start_of is not None:
            self._report(
                "skipped", expected, attempt, f"the unit is at the start of sequence {start_of}", "go back and do it"
            )
        else:
            self._report(
                "wrong attitude", expected, attempt,
                f"it starts with {there.down} down and {there.along_outer} along the outer axis", "go there first",
            )  # fmt: skip

    def _pose_after(self, word: list[tuple[int, int]] | None) -> Array | None:
        """Attitude after quarter turns; after others it is unknown."""
        if self.pose is None or word is None:
            return None
        pose = self.pose
        for axis, count in word:
            pose = pose @ quarter_turn(axis, count)
        return pose

    def _starts_at(self, names: Sequence[str]) -> str | None:
        """First of some sequences that starts in the present attitude."""
        if self.pose is None:
            return None
        return next((name for name in names if np.array_equal(self.pose, _start_pose(SEQUENCES[name]))), None)

    def _report(self, kind: str, sequence: str, attempt: _Attempt, why: str, advice: str = "") -> None:
        advice = advice or f"repeat sequence {sequence}"
        sentence = f"Sequence {sequence}, {kind}: {why} (at {attempt.start_s:.1f} s); {advice}."
        until_s = attempt.start_s if kind == "skipped" else attempt.end_s
        self.errors.append(OperatorError(kind, sequence, attempt.start_s, until_s, sentence))


def _attempts(found: Recognition, recording: Recording) -> list[_Attempt]:
    """Sequences and other manoeuvres in time order."""
    dt = recording.nominal_interval_s

    def attempt(turns: Sequence[RecognisedManoeuvre], label: SequenceLabel | None) -> _Attempt:
        start, end = float(recording.time[turns[0].first]) - dt, float(recording.time[turns[-1].last - 1])
        legs = np.concatenate([turn.legs for turn in turns])
        return _Attempt(turns[0], turns[-1], label, start, end, legs @ found.mapping[0].T)

    out, used = [], set()
    for label in found.labels:
        inside = [
            turn
            for turn in found.turns
            if label.start_static_s[1] - dt <= float(recording.time[turn.first]) <= label.end_static_s[0] + dt
        ]
        used |= {turn.first for turn in inside}
        out.append(attempt(inside, label))
    out += [attempt([turn], None) for turn in found.turns if turn.first not in used]
    return sorted(out, key=lambda each: each.start_s)


def _moved(
    recording: Recording, attempts: list[_Attempt], following: str | None, breaks: Indices, *, unrecorded: bool
) -> list[OperatorError]:
    """Motions in rests: after a sequence they are in its end window, after a move in the next start window.

    If moves are not recorded, a rest between two sequences without a break holds a move about the vertical.
    """
    errors, cuts = [], recording.time[breaks]
    for motion in rest_motions(recording, breaks):
        start, end = motion.rest_s
        if any(each.start_s < start and end < each.end_s for each in attempts):
            continue  # a pause between the rotations of a sequence
        turns = [each for each in attempts if float(np.linalg.norm(each.legs, axis=1).sum()) > _SMALL_TURN]
        before = max((each for each in turns if each.start_s < start), key=lambda each: each.start_s, default=None)
        after = min((each for each in turns if each.start_s >= start), key=lambda each: each.start_s, default=None)
        sides = [each.label for each in (before, after) if each is not None and each.label is not None]
        own = next((each for each in (before, after) if each is not None and each.label is not None), None)
        if len(sides) == 2 and before is not None and after is not None:
            own = after if np.any((cuts > before.end_s) & (cuts <= start)) else before
            cut = np.any((cuts > before.end_s) & (cuts < after.start_s))
            if not cut and (unrecorded or not _within(motion.time_s, sides)):
                continue  # the fixture is set to the next start attitude again, without a recorded move
        name = following if own is None or own.label is None else own.label.id
        if name is not None:
            sentence = (
                f"Sequence {name}, moved: the unit moved by {1e3 * motion.angle_rad:.2g} mrad (at "
                f"{motion.time_s:.1f} s) when it should stand still; repeat sequence {name}."
            )
            errors.append(OperatorError("moved", name, motion.time_s, end if own is None else own.end_s, sentence))
    return errors


def _within(time_s: float, labels: Sequence[SequenceLabel]) -> bool:
    """True for a time within the stationary windows of some sequences, not at their edges."""
    return any(
        a + _EDGE_S <= time_s <= b - _EDGE_S for each in labels for a, b in (each.start_static_s, each.end_static_s)
    )


def _window_errors(recording: Recording, labels: tuple[SequenceLabel, ...]) -> list[OperatorError]:
    """Faults of windows and rotations that the checks of the diagnosis find in the sequences so far."""
    if not labels:
        return []
    try:
        findings = StagedDiagnosis(labelled(recording, labels)).before_calibration().findings
    except DataError:
        return []
    errors = []
    for finding in findings:
        if finding.fault not in _WINDOW_FAULTS or (finding.fault == "noisy_window" and 2 * len(labels) < _FEW_WINDOWS):
            continue
        said = str(finding.details.get("sequence") or finding.details.get("title") or "")
        owner = next((each for each in labels if each.title == said), labels[-1])
        time = float(finding.details.get("time", owner.end_static_s[0]))
        sentence = f"Sequence {owner.id}: {finding.sentence}"
        errors.append(OperatorError(finding.fault, owner.id or "", time, owner.end_static_s[0], sentence))
    return errors


def _open(errors: list[OperatorError], labels: tuple[SequenceLabel, ...]) -> list[OperatorError]:
    """Errors whose sequence was not done again after them."""
    return [
        error
        for error in errors
        if not any(each.id == error.sequence and each.start_static_s[1] > error.until_s for each in labels)
    ]


def _start_pose(sequence: RotationSequence) -> Array:
    """Nominal attitude at the start, B to (across, along the outer axis, down), shape (3, 3), whole numbers."""
    down, along = axis_vector(sequence.down), axis_vector(sequence.along_outer)
    return np.stack([np.cross(along, down), along, down])


def _word(sequence: RotationSequence) -> list[tuple[int, int]]:
    """Rotations of a sequence as axis and quarter turns."""
    return [(AXES.index(axis), round(angle / (0.5 * math.pi))) for axis, angle in sequence.rotations]


def _reversed_word(name: str) -> list[tuple[int, int]]:
    return [(axis, -count) for axis, count in _word(SEQUENCES[name])]


def _same_start(a: str, b: str) -> bool:
    return np.array_equal(_start_pose(SEQUENCES[a]), _start_pose(SEQUENCES[b]))


def _turn_text(axis: int, count: int) -> str:
    return f"{90 * count:+d}° {AXES[axis]}"


def truncated(recording: Recording, end_s: float) -> Recording:
    """Samples of a recording up to a time, without labels."""
    n = int(np.searchsorted(recording.time, end_s, side="right"))
    temperature = None if recording.temperature is None else recording.temperature[:n]
    return replace(
        recording.with_sequences(()),
        time=recording.time[:n],
        gyro=recording.gyro[:n],
        accel=recording.accel[:n],
        temperature=temperature,
    )
