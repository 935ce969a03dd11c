"""Sequences and labels: shifted labels, rotations that differ from their labels, and missing or repeated sequences."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import Fault
from srt.diagnosis.label_shift import lost_samples
from srt.diagnosis.rotation_readings import AGREE, invert_readings
from srt.diagnosis.sensor_synchronisation import SAMPLES_LOST, samples_lost
from srt.diagnosis.triad_fits import RAW_SCALE
from srt.estimation.rotation_accuracy import SIGMAS, scatter_ratio
from srt.model import srt_formulas
from srt.model.table1 import SEQUENCES
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.moves import recorded_moves
from srt.sequences.preparation import nominal_attitude

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Mask

_FAR: Final = 1.0
"""Squared distance above which a manoeuvre is another sequence; rotation angles in units of 180°, verticals as unit
vectors. The two most similar of the 17 sequences are 2 apart; a unit with errors of 10 % is within 0.1 of its own."""
_LOST: Final = (
    "Samples of about {duration:.2g} s are missing in or before {sequence} (at {time:.6g} s), but the time stamps have "
    "no gap: the labels after them are late by as much. Omit the labels to have the sequences recognised, and repeat "
    "the sequence."
)
"""Message of lost samples that shift labels."""
_SHORT: Final = 0.5
"""Ratio of the length of a window to the median length, below which it is short: its mean is noisier by √2."""


def labels_shifted(evidence: Evidence) -> Iterator[Finding]:
    """Compare the labelled windows with the stationary windows in the samples; lost samples shift all later labels."""
    seen = evidence.label_shift
    if seen is None or evidence.data is None:
        return
    lost = next(samples_lost(evidence.unlabelled), None)
    place = lost_samples(evidence.data) if lost is None else None
    if place is not None:
        lost = SAMPLES_LOST.found(duration=place[1], **evidence.window_place(place[0]))
    if lost is not None:
        yield replace(lost, cause=replace(SAMPLES_LOST, message=_LOST, effect="exit 1"))
    else:
        yield LABELS_SHIFTED.found(shift=seen.late_s, count=seen.windows, of=len(evidence.data.windows.samples))


LABELS_SHIFTED: Final = Fault(
    "labels_shifted",
    "The labels are shifted in time",
    "labelled windows against the stationary windows found in the samples; rotation at the inner edges of most windows",
    "The labels are late by {shift:+.3g} s relative to the stationary windows (negative: early; {count} of {of} "
    "windows): correct the times of the labels, or omit the labels to have the sequences recognised.",
    "exit 1",
    labels_shifted,
)


def rotations_against_labels(evidence: Evidence) -> Iterator[Finding]:
    """Compare each rotation with its label: find another sequence, the opposite sense, or another angle."""
    data = evidence.data
    if data is None or evidence.label_shift is not None:  # with shifted labels, no rotation agrees with its label
        return
    exchanged = _exchanged(evidence) if evidence.has_labels else {}
    if exchanged:
        yield LABELS_EXCHANGED.found(
            labelled=", ".join(data.ids[k] for k in exchanged),
            found=", ".join(exchanged.values()),
            count=len(exchanged),
            of=data.K,
        )
    numbers, nominal, turned = evidence.rotations
    angle = np.linalg.norm(nominal, axis=1)
    matrix = evidence.raw_triads.gyro
    done = np.einsum("la,la->l", invert_readings(matrix, turned), nominal) / np.maximum(angle, 1e-300)
    known = ~np.isin(numbers, list(exchanged))
    # Recognised sequences have the right sense by construction.
    backwards = known & (done < -AGREE * angle) & evidence.has_labels
    if backwards.any():
        leg = int(np.flatnonzero(backwards)[0])
        expected = float(nominal[leg].sum())  # a rotation about one axis
        yield WRONG_DIRECTION.found(
            title=_turn_title(evidence, leg),
            found=math.degrees(math.copysign(done[leg], -expected)),
            expected=math.degrees(expected),
        )
    known &= ~np.isin(numbers, numbers[backwards])
    yield from _wrong_angles(evidence, known, done - angle)


LABELS_EXCHANGED: Final = Fault(
    "labels_exchanged",
    "Labels are those of other sequences",
    "measured rotations and static poses against those of the labelled sequences",
    "The sequences labelled {labelled} are {found} by their rotations and poses ({count} of {of} labels differ): the "
    "sequences were executed in another order; correct the ids, or omit the labels.",
    "exit 1",
    rotations_against_labels,
)
WRONG_DIRECTION: Final = Fault(
    "wrong_direction",
    "A sequence was rotated in the wrong sense",
    "sign of each rotation against the label",
    "{title} was rotated in the wrong sense (by {found:+.4g}°, but {expected:+.4g}° is expected): repeat it, or "
    "correct its label.",
    "exit 1",
    rotations_against_labels,
)
WRONG_ANGLE: Final = Fault(
    "wrong_angle",
    "A sequence was rotated by a wrong angle",
    "angle of each rotation against the label and the scatter of all, where gyros and accelerometers agree on it",
    "{title} was rotated by {found:.5g}°, but {expected:.4g}° is expected, more than the accuracy of the fixture "
    "allows ({count} such rotations): the calibration uses the measured angle; check the stops of the fixture.",
    "warning",
    rotations_against_labels,
)


def _exchanged(evidence: Evidence) -> dict[int, str]:
    """Names of the executed sequences where the label states another one, by the number of the sequence."""
    data, seen = evidence.data, evidence.raw_integrals
    names = list(SEQUENCES)
    places = [] if data is None else [k for k, name in enumerate(data.ids) if name in SEQUENCES]
    if data is None or seen is None or not places:
        return {}
    angles = [sequence.axes * sequence.angles_rad[:, None] for sequence in SEQUENCES.values()]
    signed, absolute = (np.array([of(angle).sum(axis=0) for angle in angles]) for of in (np.asarray, np.abs))
    before = np.array([-nominal_attitude(sequence)[2] for sequence in SEQUENCES.values()])
    after = np.einsum("kab,ka->kb", [end_attitude(sequence) for sequence in SEQUENCES.values()], before)
    own = np.array([names.index(data.ids[k]) for k in places])
    # Exchanged labels do not change the total rotation about each axis, which gives the scales of the raw readings.
    stated = absolute[own].sum(axis=0)
    scale = np.where(stated > 1.0, seen.absolute[places].sum(axis=0) / np.maximum(stated, 1.0), 1.0)
    poses = np.concatenate([evidence.stationary_force[data.start], evidence.stationary_force[data.end]], axis=1)
    gravity = float(np.median(np.linalg.norm(poses.reshape(-1, 3), axis=1)))
    if not (np.all(scale > 0.0) and gravity > 0.0):
        return {}
    turn = math.pi * scale
    measured = np.hstack([seen.signed / turn, seen.absolute / turn, poses / gravity])
    nominal = np.hstack([signed / math.pi, absolute / math.pi, before, after])
    distance = np.sum((measured[places][:, None] - nominal) ** 2, axis=2)
    best, rows = np.argmin(distance, axis=1), np.arange(len(places))
    off = (best != own) & (distance[rows, own] > _FAR) & (distance[rows, best] < 0.5 * _FAR)
    swapped = Counter(own[off].tolist()) == Counter(best[off].tolist())
    # Some sequences of Table 1 differ only in sense. If two such sequences were not exchanged, one was executed in the
    # wrong sense, and its label is right.
    opposite = np.all(np.abs(signed[own] + signed[best]) < 1e-9, axis=1) & np.all(before[own] == before[best], axis=1)
    return {places[i]: names[best[i]] for i in np.flatnonzero(off & (swapped | ~opposite)).tolist()}


def _wrong_angles(evidence: Evidence, known: Mask, excess: Array) -> Iterator[Finding]:
    """Find rotations on a fixture by a wrong angle, as gyros and accelerometers both measure it."""
    fixture = evidence.recording.fixture
    if fixture is None:
        return
    numbers, nominal, _ = evidence.rotations
    # If the rotations do not cover all axes, the angles include uncorrected scale factors.
    scale = 0.0 if evidence.gyro_fit.rank == 3 else RAW_SCALE * np.linalg.norm(nominal, axis=1)
    sigma = np.hypot(math.hypot(fixture.rotation_sigma_rad, 2.0 * fixture.alignment_sigma_rad), scale)
    sigma = np.broadcast_to(sigma, excess.shape)
    # Where all rotations scatter alike, the fixture is less accurate than stated, and no angle is wrong.
    allowed = SIGMAS * sigma * scatter_ratio(excess[known], sigma[known])
    off = np.flatnonzero(known & (np.abs(excess) > allowed))
    if off.size and evidence.lag is not None:
        # A lagging gyro measures the end of a rotation during the next rotation of the sequence.
        off = off[np.bincount(numbers)[numbers[off]] == 1]
    path, data = evidence.stabilised_force, evidence.data
    if off.size == 0 or path is None or data is None:
        return
    # Angle between the vertical propagated by the gyros and the measured one, at the end of each sequence.
    _, accel, bias = evidence.raw_triads
    last = path.blocks.starts[1:] - 1
    own = path.blocks.sequence[last]
    measured = invert_readings(accel, evidence.stationary_force[data.end[own]] - bias)
    measured /= np.maximum(np.linalg.norm(measured, axis=1, keepdims=True), 1e-300)
    mismatch = np.full(data.K, np.inf)
    mismatch[own] = np.linalg.norm(np.einsum("kab,kb->ka", path.attitude[last], measured) - path.up[last], axis=1)
    off = off[mismatch[numbers[off]] < AGREE * np.abs(excess[off])]
    if off.size:
        leg = int(off[np.argmax(np.abs(excess[off]))])
        expected = float(nominal[leg].sum())  # a rotation about one axis
        yield WRONG_ANGLE.found(
            title=_turn_title(evidence, leg),
            found=math.degrees(expected + math.copysign(1.0, expected) * excess[leg]),
            expected=math.degrees(expected),
            count=len(off),
        )


def _turn_title(evidence: Evidence, leg: int) -> str:
    """Name of a rotation, with a capital letter for the beginning of a message."""
    numbers = evidence.rotations.sequence
    mine = np.flatnonzero(numbers == numbers[leg])
    title = evidence.title(int(numbers[leg]))
    title = f"rotation {leg - int(mine[0]) + 1} of {title}" if len(mine) > 1 else title
    return title[0].upper() + title[1:]


def sequence_missing(evidence: Evidence) -> Iterator[Finding]:
    """Find the parameters that the closed form cannot estimate from the sequences present."""
    data, ids = evidence.data, _catalogue_ids(evidence)
    if data is None or not ids:
        return
    fixed = evidence.options.fixed_names
    without = srt_formulas.missing_parameters(srt_formulas.formulas(set(ids)))
    lost = [n for n in without if n not in fixed and srt_formulas.sequences_needed(n)]
    if not lost:
        return
    missing = [name for name in SEQUENCES if name not in ids]
    several = len(missing) > 1
    moves = recorded_moves(data.recording, data.labels)
    yield SEQUENCE_MISSING.found(
        missing=f"Sequences {', '.join(missing)} are" if several else f"Sequence {missing[0]} is",
        found=len(SEQUENCES) - len(missing),
        parameters=", ".join(lost),
        them="them" if several else "it",
        otherwise=", or use --estimator least-squares, which uses the recorded moves, too" if moves else "",
    )


SEQUENCE_MISSING: Final = Fault(
    "sequence_missing",
    "A sequence is missing",
    "sequences in the recording against those that the closed form needs",
    "{missing} missing (the recording has {found} of 17), so that the closed form cannot estimate {parameters}: record"
    " {them}{otherwise}.",
    "warning",
    sequence_missing,
)


def sequence_repeated(evidence: Evidence) -> Iterator[Finding]:
    """Find sequences that were executed more than once."""
    often = [f"{name} ({n} times)" for name, n in Counter(_catalogue_ids(evidence)).items() if n > 1]
    if often:
        yield SEQUENCE_REPEATED.found(sequences=", ".join(often))


SEQUENCE_REPEATED: Final = Fault(
    "sequence_repeated",
    "A sequence was executed more than once",
    "count of each sequence",
    "Sequences executed more than once: {sequences}; all of them are used.",
    "note",
    sequence_repeated,
)


def _catalogue_ids(evidence: Evidence) -> list[str]:
    """Names of the sequences that are among the 17, in the order of the recording; none without a fixture."""
    if evidence.recording.fixture is None or evidence.data is None:
        return []
    return [name for name in evidence.data.ids if name in SEQUENCES]


def window_short(evidence: Evidence) -> Iterator[Finding]:
    """Compare the window lengths with their median, of Table 1 only: rests of other protocols differ as planned."""
    data, seen = evidence.data, None if evidence.has_labels else evidence.recognition
    by_chance = seen is not None and seen.by_chance
    if data is None or not _catalogue_ids(evidence) or by_chance or evidence.label_shift is not None:
        return
    duration = data.windows.duration_s
    typical, w = float(np.median(duration)), int(np.argmin(duration))
    if duration[w] < _SHORT * typical:
        yield WINDOW_SHORT.found(duration=float(duration[w]), typical=typical, **evidence.window_place(w))


WINDOW_SHORT: Final = Fault(
    "window_short",
    "A stationary window is much shorter than the others",
    "lengths of the windows",
    "The stationary window from {time:.6g} s lasts {duration:.3g} s, but the median window lasts {typical:.3g} s: the "
    "short window limits the accuracy of {sequence}; keep the unit stationary equally long in all windows.",
    "warning",
    window_short,
)
