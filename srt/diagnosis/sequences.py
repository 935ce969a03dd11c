"""Sequences and labels: shifted labels, rotations that differ from their labels, and missing or repeated sequences.

Shifted labels show in the stationary windows found in the samples, and in rotation at the edges of labelled windows: a
unit begins to rotate within one or two samples, which therefore differ clearly from those at rest.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.cause_comparison import CLOSE, Cause, compare
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault
from srt.diagnosis.rotation_readings import AGREE, ROTATING, cross, invert_readings, rates_factor
from srt.diagnosis.time_offsets import SAMPLES_LOST, samples_lost
from srt.diagnosis.triad_fits import RAW_SCALE
from srt.estimation.rotation_accuracy import SIGMAS, scatter_ratio
from srt.exceptions import DataError
from srt.model import closed_form
from srt.model.table1 import SEQUENCES
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.moves import recorded_moves
from srt.sequences.preparation import nominal_attitude
from srt.sequences.rest_detection import BLOCK_S
from srt.sequences.stationary_windows import find_windows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.rotation_readings import RawIntegrals
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_BESIDE_S: Final = 2.0 * BLOCK_S
"""Largest error of the edges of the stationary windows found in the samples, s: one or two blocks."""
_SLACK_S: Final = 0.03
"""Stationary time per window, s, by which a smaller shift may be worse than the best shift and still be preferred."""
_SOME_WINDOWS: Final = 16
"""Largest number of windows whose edges give the candidates for the common shift, which is the same for all windows."""


class LabelShift(NamedTuple):
    """Time by which the labels are late, s (negative: early), and the number of windows affected."""

    late_s: float
    windows: int


def label_shift(data: PreparedRecording, seen: RawIntegrals, contiguous: Mask, turning: Mask) -> LabelShift | None:
    """Shift of the labels; None if they are not shifted.

    ``contiguous`` (K,) is true for the sequences without a gap, ``turning`` (W,) for the windows with a rotation.
    """
    found = _block_shift(data, turning) if turning.any() else None
    found = found or _rotation_at_edges(data, seen, contiguous)
    if found is None or found.late_s > 0.0:
        return found
    labelled, rest = _spans(data)
    if len(rest) == 0:
        return found
    # A low-pass filter makes rotations end late, but not begin late.
    later = (rest[_shared(labelled, rest).argmax(axis=1), 1] - labelled[:, 1])[data.start]
    return found if np.median(later) > -0.5 * found.late_s else None


def lost_samples(data: PreparedRecording) -> tuple[int, float] | None:
    """Window from which the labels are late, and the time, s; None if all are late alike, or ever later.

    Samples lost without a gap in the stamps shift the labels after them; a clock shifts them in proportion.
    """
    labelled, rest = _spans(data)
    if len(rest) == 0:
        return None
    number, side = np.concatenate([data.start, data.end]), np.repeat([1, 0], data.K)
    order = np.argsort(labelled[number, 0])
    number, side = number[order], side[order]
    own = labelled[number]
    late, rows = own[np.arange(len(own)), side] - rest[_shared(own, rest).argmax(axis=1), side], np.arange(len(own))
    causes = [Cause("", np.zeros((len(own), 0)), {}), Cause("labels_shifted", own[:, :1], {})]
    causes += [
        Cause("samples_lost", (rows >= m)[:, None].astype(np.float64), {"window": number[m]}, len(own))
        for m in range(2, len(own) - 1)
    ]
    best, *others = compare(late, causes, np.stack([side, 1 - side], axis=1).astype(np.float64))
    other = next((e for e in others if e.cause.fault != "samples_lost"), best)
    if best.cause.fault != "samples_lost" or best.score - other.score < CLOSE or best.value[0] < _BESIDE_S:
        return None
    return int(best.cause.details["window"]), float(best.value[0])


def _spans(data: PreparedRecording) -> tuple[Array, Array]:
    """Start and end of the labelled windows, and of the windows found in the samples, s; (n, 2) each."""
    time, dt = data.recording.time, data.recording.nominal_interval_s
    try:
        rest = find_windows(data.recording)
    except DataError:
        rest = np.zeros((0, 2), dtype=np.intp)
    parts = (data.windows.samples, rest)
    spans = [np.stack([time[rows[:, 0]] - dt, time[rows[:, 1] - 1]], axis=1) for rows in parts]
    return spans[0], spans[1]


def _shared(labelled: Array, rest: Array) -> Array:
    """Time that each label shares with each stationary window, s; negative if they are apart."""
    return np.asarray(np.minimum(labelled[:, 1, None], rest[:, 1]) - np.maximum(labelled[:, 0, None], rest[:, 0]))


def _block_shift(data: PreparedRecording, turning: Mask) -> LabelShift | None:
    """Shift of the labels from block means, a coarse search; None if the labels are not shifted."""
    labelled, rest = _spans(data)
    if len(rest) == 0:
        return None
    some = labelled[np.unique(np.linspace(0, len(labelled) - 1, _SOME_WINDOWS).astype(int))]
    # The best shift is one of those that move an edge of a label to an edge of a stationary window.
    late = np.unique(np.append((some[:, None, :, None] - rest[None, :, None, :]).ravel(), 0.0))
    still_until = np.repeat(np.concatenate([[0.0], np.cumsum(rest[:, 1] - rest[:, 0])]), 2)[1:-1]
    until = np.interp(some[None] - late[:, None, None], rest.ravel(), still_until)
    at_rest = np.sum(until[:, :, 1] - until[:, :, 0], axis=1)
    enough = late[at_rest >= at_rest.max() - _SLACK_S * len(some)]
    best = float(enough[np.argmin(np.abs(enough))])
    if abs(best) > _BESIDE_S:
        return LabelShift(best, int(turning.sum()))
    # Shifts of single labels, against the stationary window that they overlap most.
    labelled = labelled[turning]
    shared = _shared(labelled, rest)
    nearest, most = rest[shared.argmax(axis=1)], shared.max(axis=1)
    late, early = np.maximum(labelled[:, 1] - nearest[:, 1], 0.0), np.maximum(nearest[:, 0] - labelled[:, 0], 0.0)
    # The label is not wrong if it is too long on both sides.
    wrong = (most > 0.0) & (np.minimum(late, early) <= _BESIDE_S) & (np.maximum(late, early) > _BESIDE_S)
    return LabelShift(float(np.median((late - early)[wrong])), int(wrong.sum())) if wrong.any() else None


def _rotation_at_edges(data: PreparedRecording, seen: RawIntegrals, contiguous: Mask) -> LabelShift | None:
    """Rotation at the inner edges of most start windows or of most end windows; None if there is none."""
    turns = np.flatnonzero(contiguous).tolist()
    found = np.array([[_edge(data, seen, k, sense) for k in turns] for sense in (1, -1)]).reshape(2, -1, 7)
    if found.size == 0:
        return None
    duration, angle, change = found[:, :, 0], found[:, :, 1:4], found[:, :, 4:]
    both = duration > 0.0
    common = both.mean(axis=1) > 0.5
    # The direction of gravity must confirm half of the angle, if the axis is not vertical: a low-pass filter of the
    # gyros also makes their readings end late.
    shown, expected = np.einsum("skc,skc->s", angle, change), np.einsum("skc,skc->s", angle, angle)
    real = common & ((shown > 0.5 * expected) | (expected == 0.0))
    if not real.any():
        return None
    side = int(np.argmax(np.where(real, both.sum(axis=1), 0)))
    late = float(np.median(duration[side][both[side]])) * (1.0, -1.0)[side]
    return LabelShift(late, int(both[real].sum()))


def _edge(data: PreparedRecording, seen: RawIntegrals, sequence: int, sense: int) -> Array:
    """Duration of rotation at the inner edge of a window, and the expected and measured change of specific force, (7,).

    ``sense`` is 1 for the start window, -1 for the end window. Statistic: rate over its standard deviation.
    Distribution: normal.
    """
    recording, factor = data.recording, rates_factor(data.recording)
    dt = recording.nominal_interval_s
    a, b = data.windows.samples[(data.start if sense > 0 else data.end)[sequence]].tolist()
    most = (b - a) // 4
    if most <= 2 or seen.speed[sequence] == 0.0:
        return np.zeros(7)
    inner = slice(a + most, b - most)
    near = recording.gyro[b - most : b][::-1] if sense > 0 else recording.gyro[a : a + most]
    off = (near - recording.gyro[inner].mean(axis=0)) * factor  # from the rotation into the window
    # Slower motion is a disturbance of a window whose label is right. A single sample may be due to a channel that is
    # sampled early or late.
    slowest = ROTATING * seen.speed[sequence]
    if np.abs(off[:2]).max(axis=1).min() <= slowest:
        return np.zeros(7)
    tests = 3 * most * len(data.windows.samples)
    noise = limit("normal", tests=tests, both_sides=True) * recording.gyro[inner].std(axis=0) * factor
    loud = np.any(np.abs(off) > np.maximum(noise, slowest), axis=1)
    count = most if loud.all() else int(np.argmin(loud))
    if count < 2:
        return np.zeros(7)
    turned = off[:count].sum(axis=0) * dt
    force = recording.accel[inner].mean(axis=0) * factor
    at_edge = recording.accel[b - 1 if sense > 0 else a] * factor
    return np.concatenate([[count * dt], -sense * cross(turned, force), at_edge - force])


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
    lost = [n for n in closed_form.missing_parameters(closed_form.formulas(set(ids))) if n not in fixed]
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
