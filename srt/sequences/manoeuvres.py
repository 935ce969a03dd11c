"""Manoeuvres between stationary windows: their single-axis rotations (legs), and a check against the labels.

All manoeuvres are split by :func:`leg_borders`. The callers differ in what marks a leg: for unlabelled recordings the
sensor axis and the sense (:func:`find_manoeuvre`), for labelled ones the pauses between the rotations
(:func:`rotation_angles`) or, in the diagnosis, pauses and changes of axis
(:func:`srt.diagnosis.rotation_readings.find_rotations`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.gyro_stream import moving_average
from srt.model.rotations import rotation_matrix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.model.gyro_stream import GyroStream
    from srt.model.table1 import RotationSequence
    from srt.recording.recording import Recording
    from srt.types import Array, Counts, Indices

MOVING: Final = 0.2
"""Share of the highest rate of a manoeuvre above which the unit moves."""
_SMOOTH_S: Final = 0.05
"""Averaging time, s, of the rate whose largest component gives the axis; shorter than a stop between rotations."""

_SHORTEST: Final = 0.02
"""Share of a manoeuvre's duration below which a leg is a transient between two others."""


def leg_borders(mark: Array, *, through_stops: bool) -> Indices:
    """Borders of the legs of a manoeuvre, shape (m + 1,): every sample belongs to a leg.

    A leg is a run of samples with one mark. The border between two legs is the middle of the gap between them.

    Parameters
    ----------
    mark : ndarray of int, shape (n,)
        Mark of each sample, for example the number of its axis; -1 where the unit does not rotate.
    through_stops : bool
        True: a stop does not end a leg, as the same mark follows it; False: it does.
    """
    rotating = np.flatnonzero(mark >= 0)
    at = rotating if through_stops else np.arange(len(mark))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(mark[at])) + 1, [len(at)]]).tolist()
    legs: list[list[int]] = []
    for a, b in pairwise(edges):
        if b - a <= _SHORTEST * len(at) or mark[at[a]] < 0:
            continue
        if through_stops and legs and mark[legs[-1][0]] == mark[at[a]]:
            legs[-1][1] = int(at[b - 1]) + 1
        else:
            legs.append([int(at[a]), int(at[b - 1]) + 1])
    middles = [(before[1] + after[0]) // 2 for before, after in pairwise(legs)]
    return np.array([0, *middles, len(mark)], dtype=np.intp)


def whole_rotations(stream: GyroStream, bias: Array) -> Array:
    """Summed raw gyro increments of each rotation less biases (K, 3), shape (K, 3), rad."""
    # Between the rotations of a stream may lie samples of integrated windows.
    edges = stream.rotation.ravel()
    edges = edges[: len(edges) - (edges[-1] == len(stream.interval_s))]
    turned, seconds = (np.add.reduceat(own, edges, axis=-1)[..., ::2] for own in (stream.increments, stream.interval_s))
    return np.asarray(turned.T - bias * seconds[:, None])


def rotation_angles(stream: GyroStream, k: int, sequence: RotationSequence, bias: Array) -> Array | None:
    """Summed raw gyro increments of each rotation of sequence k, less bias, shape (number of rotations, 3), rad.

    Returns None if the pauses between the rotations cannot be found. Only pauses separate the rotations; axes are not
    used, because raw axes may be far from those of the table.
    """
    own = slice(*stream.rotation[k].tolist())
    rate = stream.smooth[:, own] / stream.interval_s[own] - bias[:, None]
    square = np.einsum("an,an->n", rate, rate)
    borders = leg_borders(np.where(square > MOVING**2 * square.max(), 0, -1), through_stops=False)
    if len(borders) != len(sequence.rotations) + 1:
        return None
    turned, seconds = (
        np.add.reduceat(part, borders[:-1], axis=-1) for part in (stream.increments[:, own], stream.interval_s[own])
    )
    return np.asarray((turned - bias[:, None] * seconds).T)


@dataclass(frozen=True, slots=True, eq=False)
class Manoeuvre:
    """Rotations between two successive stationary windows of one contiguous piece.

    Attributes
    ----------
    start_window, end_window : int
        Indices into the windows.
    first, last : int
        First sample of the turn and one past its last.
    legs : ndarray, shape (m, 3), rad
        Summed raw gyro angle of each leg, less the bias that the two windows show.
    """

    start_window: int
    end_window: int
    first: int
    last: int
    legs: Array


def angles_between(recording: Recording, first: Sequence[int], second: Sequence[int]) -> Array:
    """Raw gyro angle of every sample between two windows, less the mean rate of both, shape (n, 3), rad.

    Parameters
    ----------
    first, second : (int, int)
        First sample and one past the last.
    """
    between, interval = slice(first[1], second[0]), recording.interval_s
    rest = 0.5 * sum(recording.gyro[a:b].mean(axis=0) for a, b in (first, second))
    per_sample = recording.gyro[between] - rest
    if recording.kind == "rate":
        per_sample = per_sample * (interval if isinstance(interval, float) else interval[between, None])
    return np.asarray(per_sample)


def find_manoeuvre(recording: Recording, windows: Indices, start: int) -> Manoeuvre:
    """Split the turn after a window into legs.

    In a leg one sensor axis turns fastest, in one sense: a fixture turns about one axis at a time, and sensor axes lie
    within some tenths of a radian of the fixture's. A stop on the way does not end a leg.

    Parameters
    ----------
    windows : ndarray of int, shape (W, 2)
    start : int
        Window before the turn; the turn ends at the next one.
    """
    before, after = windows[start : start + 2].tolist()
    per_sample = angles_between(recording, before, after)
    smooth = moving_average(per_sample.T, max(1, round(_SMOOTH_S / recording.nominal_interval_s))).T
    speed = np.linalg.norm(smooth, axis=1)
    axis = np.argmax(np.abs(smooth), axis=1)
    positive = smooth[np.arange(len(smooth)), axis] > 0.0
    edges = leg_borders(np.where(speed > MOVING * speed.max(), 2 * axis + positive, -1), through_stops=True)
    return Manoeuvre(start, start + 1, before[1], after[0], np.add.reduceat(per_sample, edges[:-1], axis=0))


QUARTER: Final = 0.5 * np.pi
"""Quarter turn, rad."""

LEGAL_SCALE: Final = (0.5, 1.6)
"""Accepted ratio of gyro angle to quarter turns: scale-factor errors of 30 %, with a margin of the same size."""
_UPRIGHT: Final = 0.75
"""Cosine of the largest angle between a face's axis and the vertical, 40°: a margin for misalignment and bias."""
_PURE: Final = 0.75
"""Share of a leg's angle about its largest axis, above which the leg is a rotation about that axis."""

OFF: Final = 0.4
"""Largest distance of an angle from a whole number of quarter turns, in quarter turns."""


@cache
def quarter_turn(axis: int, count: int) -> Counts:
    """Rotation by quarter turns about a body axis, components after to before, shape (3, 3), integers."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[count % 4]
    out = np.eye(3, dtype=np.int64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    out.flags.writeable = False
    return out


def centred(force: Array, gravity: float) -> Array:
    """Mean specific force of windows less the bias of each axis, the mean of its two extremes, shape (W, 3)."""
    low, high = force.min(axis=0), force.max(axis=0)
    both = (low < -0.3 * gravity) & (high > 0.3 * gravity)
    return np.asarray(force - np.where(both, 0.5 * (low + high), 0.0))


def faces(force: Array, gravity: float) -> list[tuple[int, int] | None]:
    """Body axis that is down, and its sign, for every window; None if no axis is near the vertical."""
    f = centred(force, gravity)
    axis = np.argmax(np.abs(f), axis=1)
    share = np.abs(f[np.arange(len(f)), axis]) / np.maximum(np.linalg.norm(f, axis=1), 1e-300)
    sign = -np.sign(f[np.arange(len(f)), axis]).astype(int)
    return [(int(a), int(s)) if c > _UPRIGHT else None for a, s, c in zip(axis, sign, share, strict=True)]


def face_vector(face: tuple[int, int]) -> Counts:
    """Down in body axes, shape (3,)."""
    out = np.zeros(3, dtype=np.int64)
    out[face[0]] = face[1]
    return out


def leg_axis(leg: Array) -> tuple[int, float] | None:
    """Sensor axis of a leg and its signed raw angle; None if no axis dominates."""
    axis = int(np.argmax(np.abs(leg)))
    size = float(np.linalg.norm(leg))
    if size == 0.0 or abs(leg[axis]) < _PURE * size:
        return None
    return axis, float(np.sign(leg[axis]) * size)


def scales(turns: Sequence[Manoeuvre], face: Sequence[tuple[int, int] | None]) -> Array:
    """Reading over truth of each gyro axis, from manoeuvres of one leg that change the face that is down, shape (3,).

    The faces that are down before and after give the true angle up to full turns, independently of the gyro.
    """
    ratios: list[list[float]] = [[], [], []]
    for turn in turns:
        before, after = face[turn.start_window], face[turn.end_window]
        found = leg_axis(turn.legs[0]) if len(turn.legs) == 1 else None
        if found is None or before is None or after is None or found[0] == before[0]:
            continue
        axis, angle = found
        down, end = face_vector(before), face_vector(after)
        for q in range(1, 7):
            count = q if angle > 0.0 else -q
            ratio = angle / (count * QUARTER)
            if LEGAL_SCALE[0] < ratio < LEGAL_SCALE[1] and np.array_equal(quarter_turn(axis, count).T @ down, end):
                ratios[axis].append(ratio)
    middle = [float(np.median(r)) if r else np.nan for r in ratios]
    common = float(np.nanmedian(middle)) if not np.all(np.isnan(middle)) else 1.0
    return np.array([common if np.isnan(m) else m for m in middle])


def quarters(legs: Array, scale: Array) -> list[tuple[int, int]] | None:
    """Axis and quarter turns of each leg; None if a leg is not a whole number of quarter turns about one axis."""
    out = []
    for leg in legs:
        found = leg_axis(leg)
        if found is None:
            return None
        axis, angle = found
        turns = angle / (QUARTER * scale[axis])
        count = round(turns)
        if count == 0 or abs(turns - count) > OFF:
            return None
        out.append((axis, count))
    return out


@cache
def end_attitude(sequence: RotationSequence) -> Array:
    """Nominal C_End of a sequence, B_End to B_Strt, shape (3, 3), for IMU axes along the table's; read-only."""
    C = np.eye(3)
    for axis, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        C = C @ rotation_matrix(axis * angle)
    C.flags.writeable = False
    return C
