"""Recognition of the sequences of Table 1 in an unlabelled recording, in any order, with repeats and moves between.

Each manoeuvre is described by the face that is down before it and by its quarter turns, counted by the gyros. The 17
sequences are described in the same way, each with its start attitude. Within one contiguous piece of the recording the
attitude is propagated by quarter turns. This excludes manoeuvres with the rotations of a sequence but another start
heading.
Dynamic programming over the stationary windows finds the most probable assignment of a piece.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError, InputError
from srt.model.table1 import AXES, SEQUENCES
from srt.recording.readings import derived
from srt.recording.recording import SequenceLabel
from srt.result.diagnostics import RecognisedSequence, RecognisedSequences
from srt.sequences.manoeuvres import QUARTER, Manoeuvre, faces, find_manoeuvre, leg_axis
from srt.sequences.protocol_matching import with_protocol
from srt.sequences.rest_detection import resolution_floor
from srt.sequences.sequence_matching import ENOUGH_TURNS, QUARTER_TURN_WORDS, SequenceReading, promising_mappings
from srt.sequences.stationary_windows import (
    best_join,
    find_turns,
    find_windows,
    no_turn_between,
    trimmed,
    window_times,
)

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.types import Array, Indices

    Word = tuple[tuple[int, int], ...]


_JOIN: Final = 0.6
"""Cost, in legs, of assuming an attitude jump inside a stationary window without other evidence."""
_JOIN_OF_TWO: Final = 0.3
"""Cost, in legs, in a window as long as two dwells: jumps at both ends of a one-leg sequence must cost below a leg."""
_ANGLE_SIGMA: Final = 0.05
"""1-sigma of a leg's angle about the nominal one, rad, for the confidence: fixture and unit, with a margin."""
_STEP: Final = 60.0
"""Decrease of chi-square above which an attitude jump in a stationary window is accepted."""
_TWO_DWELLS: Final = 1.5
"""Ratio of a window's length to the median length, above which it counts as two dwells."""
DOUBTFUL: Final = 0.5
"""Confidence below which a sequence causes a warning."""
_NEARLY_ALL: Final = 15
"""Number of different recognised sequences that is enough: other names of the axes are then not tried."""
_CLEARLY: Final = 1.2
"""Ratio of recognised legs by which another naming of the axes must exceed the given one."""
_BY_CHANCE: Final = 1.0 / (np.pi / 2.0) / 36.0
"""Probability density, 1/rad, of an accidental match: uniform over a quarter turn, and 1/36 for the two faces."""


@dataclass(frozen=True, slots=True, eq=False)
class RecognisedManoeuvre(Manoeuvre):
    """Manoeuvre and the sequence that it was recognised as.

    Attributes
    ----------
    sequence : str or None
        Id in Table 1.
    confidence : float
        Probability that it is that sequence, 0 to 1.
    reason : str
        Why no sequence was recognised; empty for a recognised one.
    """

    sequence: str | None
    confidence: float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Recognition:
    """Stationary windows, manoeuvres and sequences found in a recording.

    Attributes
    ----------
    windows : ndarray of int, shape (W, 2)
        Stationary windows, first sample and one past the last; a rest with an attitude jump is two windows.
    turns : tuple of RecognisedManoeuvre
        In time order, each with the id of the sequence that it belongs to.
    labels : tuple of SequenceLabel
        Labels of the sequences, in time order.
    confidence : tuple of float
        Confidence of each label.
    scale : ndarray, shape (3,)
        Ratio of raw reading to true angle of each gyro axis, from rotations of nominally 90°.
    mapping : tuple of ndarray, shape (3, 3)
        Signed permutations of gyro and accelerometer axes with which the sequences were found; the unit matrix
        unless only another fits.
    """

    windows: Indices
    turns: tuple[RecognisedManoeuvre, ...]
    labels: tuple[SequenceLabel, ...]
    confidence: tuple[float, ...]
    scale: Array
    mapping: tuple[Array, Array] = field(default_factory=lambda: (np.eye(3), np.eye(3)))

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the sequences in time order."""
        return tuple(label.id or "" for label in self.labels)

    @property
    def missing(self) -> tuple[str, ...]:
        """Sequences of Table 1 that were not found."""
        return tuple(name for name in SEQUENCES if name not in self.ids)

    @property
    def repeated(self) -> tuple[str, ...]:
        """Sequences found more than once."""
        return tuple(name for name in SEQUENCES if self.ids.count(name) > 1)

    @property
    def by_chance(self) -> bool:
        """True if so few turns are of sequences that free rotations match as many by chance."""
        return 2 * sum(turn.sequence is not None for turn in self.turns) <= len(self.turns)

    @property
    def axis_renaming(self) -> str:
        """Axis names that match the sequences, as "the gyro axes are read as x,-y,z"; empty if the given ones do."""
        said = [
            f"the {sensor} axes are read as {mapping_text(P)}"
            for sensor, P in zip(("gyro", "accelerometer"), self.mapping, strict=True)
            if not np.array_equal(P, np.eye(3))
        ]
        return " and ".join(said)

    @property
    def summary(self) -> str:
        """One sentence."""
        others = sum(turn.sequence is None for turn in self.turns)
        said = f"{len(self.turns)} turns between {len(self.windows)} rests"
        if not self.labels:
            return f"{said}: none is a sequence of Table 1."
        parts = [f"{len(self.ids)} sequence{'s' if len(self.ids) > 1 else ''} of Table 1 recognised"]
        if self.repeated:
            parts.append(f"{', '.join(self.repeated)} more than once")
        if self.missing:
            parts.append(f"{', '.join(self.missing)} missing")
        if others:
            parts.append(f"{others} other turn{'s' if others > 1 else ''}, as moves between them")
        if self.axis_renaming:
            parts.append(f"if {self.axis_renaming}")
        least = min(self.confidence)
        return f"{said}: {'; '.join(parts)}; least confidence {least:.2f}."

    def told_in(self, calibration: Calibration) -> Calibration:
        """Calibration with the recognised sequences in its diagnostics, and a warning for each doubtful one."""
        rows = tuple(
            RecognisedSequence(
                sequence=label.id or "",
                occurrence=self.ids[: k + 1].count(label.id or ""),
                start_static_s=label.start_static_s,
                end_static_s=label.end_static_s,
                confidence=confidence,
            )
            for k, (label, confidence) in enumerate(zip(self.labels, self.confidence, strict=True))
        )
        doubtful = [
            f"{label.title} is doubtful (confidence {confidence:.2f}): check it, or label the sequences."
            for label, confidence in zip(self.labels, self.confidence, strict=True)
            if confidence < DOUBTFUL
        ]
        told = RecognisedSequences(summary=self.summary, sequences=rows)
        return replace(
            calibration,
            diagnostics=replace(calibration.diagnostics, recognition=told),
            warnings=(*calibration.warnings, *doubtful),
        )


def mapping_text(mapping: Array) -> str:
    """Write a signed permutation as the axes that x, y and z are read from, as "y,-x,z"."""
    return ",".join(("-" if row.sum() < 0.0 else "") + AXES[int(np.argmax(np.abs(row)))] for row in mapping)


@derived
def recognise(recording: Recording, *, renaming: bool = True) -> Recognition:
    """Find rests, turns and the sequences of Table 1.

    Parameters
    ----------
    recording : Recording
        Its labels, if any, are ignored.
    renaming : bool
        Try other names of the axes where few sequences fit with the given ones.

    Returns
    -------
    Recognition
        With no labels where no sequence was recognised, as in a free recording.

    Raises
    ------
    DataError
        If fewer than two stationary windows are found.
    """
    windows = find_windows(recording)
    apart = [no_turn_between(recording, *pair) for pair in pairwise(windows.tolist())]
    turns = [find_manoeuvre(recording, windows, w) for w, cut in enumerate(apart) if not cut]
    force = np.array([recording.accel[a:b].mean(axis=0) for a, b in windows.tolist()]) * recording.rates_factor
    length, gravity = windows[:, 1] - windows[:, 0], recording.site.gravity_m_s2
    join_cost = np.where(length > _TWO_DWELLS * np.median(length), _JOIN_OF_TWO, _JOIN)
    best = SequenceReading.of(turns, apart, force, join_cost, gravity, (np.eye(3), np.eye(3)))
    if renaming and len(turns) >= ENOUGH_TURNS and len({m.name for m in best.matches}) < _NEARLY_ALL:
        for mapping in promising_mappings(turns, faces(force, gravity)):
            other = SequenceReading.of(turns, apart, force, join_cost, gravity, mapping)
            if other.legs >= _CLEARLY * max(best.legs, 1):
                best = other
    return _result(recording, windows, turns, best)


@derived
def labelled(recording: Recording, labels: tuple[SequenceLabel, ...]) -> Recording:
    """Recording with the labels that were found in it; the same object at every call."""
    return recording.with_sequences(labels)


def label_sequences(recording: Recording) -> tuple[Recording, Recognition | None]:
    """Label a recording by its protocol, or with its recognised sequences if it has a fixture; labels remain.

    Returns
    -------
    recording : Recording
        Unchanged if it has labels or no fixture, or if no sequence of Table 1 is recognised.
    recognition : Recognition or None
        None if no sequences were searched for, or none were found.

    Raises
    ------
    DataError
        If fewer than two stationary windows are found, or the sequences fit only with other names of the axes.
    """
    recording = with_protocol(recording)
    if recording.sequences or recording.fixture is None:
        return recording, None
    found = recognise(recording)
    if not found.labels:
        return recording, None
    if found.axis_renaming:
        raise DataError(
            f"The turns are those of Table 1 only if {found.axis_renaming}: name the axes so when the recording is "
            "converted, or label the sequences."
        )
    return labelled(recording, found.labels), found


def leave_out(recording: Recording, names: SequenceOf[str]) -> tuple[Recording, tuple[str, ...]]:
    """Leave out turns, poses or sequences, labelled or recognised; the others keep their numbers.

    Parameters
    ----------
    names : sequence of str
        Number of a turn or pose without an id, "22", or id, "1a", of which all runs are left out.

    Returns
    -------
    recording : Recording
        With the labels that are left.
    titles : tuple of str
        Names in messages of what is left out.

    Raises
    ------
    InputError
        A name that no label has.
    DataError
        As :func:`label_sequences`.
    """
    labels = label_sequences(recording)[0].sequences or find_turns(recording)
    numbered = [replace(label, number=k) for k, label in enumerate(labels, 1)]
    known = [label.id or str(label.number) for label in numbered]
    for name in sorted(set(names) - set(known)):
        raise InputError(f"There is no turn or sequence {name!r} to leave out; the recording has {', '.join(known)}.")
    left = tuple(label for label, name in zip(numbered, known, strict=True) if name not in names)
    titles = tuple(label.title for label, name in zip(numbered, known, strict=True) if name in names)
    return recording.with_sequences(left), titles


def _result(recording: Recording, windows: Indices, turns: SequenceOf[Manoeuvre], best: SequenceReading) -> Recognition:
    """Labels and confidences of the most probable assignment."""
    confidence = _confidences(turns, best)
    spans = {w: (int(a), int(b)) for w, (a, b) in enumerate(windows.tolist())}
    # A rest of two parts: the first belongs to the turn before it, the second to the turn after it.
    first_part, second_part = dict(spans), dict(spans)
    floor = resolution_floor(recording)
    for w, at in _parted_rests(recording, windows, turns, best).items():
        a, b = spans[w]
        first_part[w], second_part[w] = (trimmed(recording, part, floor) for part in ((a, at), (at, b)))
    labels = tuple(
        SequenceLabel(
            window_times(recording, second_part[turns[m.first].start_window]),
            window_times(recording, first_part[turns[m.last].end_window]),
            m.name,
        )
        for m in best.matches
    )
    owner = {t: k for k, m in enumerate(best.matches) for t in range(m.first, m.last + 1)}
    found = tuple(
        RecognisedManoeuvre(
            turn.start_window,
            turn.end_window,
            turn.first,
            turn.last,
            turn.legs,
            best.matches[owner[t]].name if t in owner else None,
            confidence[owner[t]] if t in owner else 0.0,
            "" if t in owner else _why_not(t, turn, best),
        )
        for t, turn in enumerate(turns)
    )
    return Recognition(windows, found, labels, tuple(confidence), best.scale, best.mapping)


def _parted_rests(
    recording: Recording, windows: Indices, turns: SequenceOf[Manoeuvre], best: SequenceReading
) -> dict[int, int]:
    """Windows that contain two dwells, or an attitude jump; the value is the first sample of the second part.

    A window that ends one sequence and starts another is one pose for both, unless it is as long as two dwells or the
    attitude jumps in it: the operator may have driven the fixture to the start attitude again.
    """
    length = windows[:, 1] - windows[:, 0]
    ends = {turns[m.last].end_window for m in best.matches}
    shared = ends & {turns[m.first].start_window for m in best.matches}
    hidden = {turns[t].start_window for t in best.joins} & ends
    alone = [w for w in range(len(windows)) if w not in shared]
    typical = float(np.median(length[alone])) if alone else np.inf
    out = {}
    for w in sorted(shared | hidden):
        a, b = int(windows[w, 0]), int(windows[w, 1])
        margin = (b - a) // 8
        if margin < 1:
            continue
        at, gain = best_join(recording, a + margin, b - margin)
        if gain > _STEP:
            out[w] = at
        elif length[w] > _TWO_DWELLS * typical:
            out[w] = (a + b) // 2  # no jump shows where the second dwell begins: halves
        elif w in hidden:
            out[w] = at
    return out


def _confidences(turns: SequenceOf[Manoeuvre], best: SequenceReading) -> list[float]:
    """Probability of each match, from the deviations of its angles from the nominal ones."""
    out = []
    for m in best.matches:
        worst = 0.0
        legs = np.concatenate([turns[t].legs for t in range(m.first, m.last + 1)]) @ best.mapping[0].T
        total = np.zeros(3)
        nominal = np.zeros(3)
        for leg in legs:
            found = leg_axis(leg)
            if found is not None:
                total[found[0]] += abs(found[1]) / best.scale[found[0]]
        for axis, count in QUARTER_TURN_WORDS[m.name][1]:
            nominal[axis] += abs(count) * QUARTER
        worst = float(np.abs(total - nominal).max()) / max(1.0, np.sqrt(len(legs)))
        fits = np.exp(-0.5 * (worst / _ANGLE_SIGMA) ** 2) / (_ANGLE_SIGMA * np.sqrt(2.0 * np.pi))
        out.append(float(fits / (fits + _BY_CHANCE)))
    return out


def _why_not(t: int, turn: Manoeuvre, best: SequenceReading) -> str:
    """Short reason why a manoeuvre was not recognised as a sequence."""
    word = best.words[t]
    if best.faces[turn.start_window] is None or best.faces[turn.end_window] is None:
        return "no axis of the unit is vertical before or after it"
    if word is None:
        return "it is not made of quarter turns about single axes"
    down = best.faces[turn.start_window]
    for name, (face, nominal) in QUARTER_TURN_WORDS.items():
        if face == down and tuple((axis, -count) for axis, count in nominal) == word:
            return f"it is sequence {name} turned the other way"
        if face == down and nominal == word:
            return f"it is like sequence {name}, but began turned about the vertical"
    return "a move between sequences"
