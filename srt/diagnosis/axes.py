"""Axes and frames: swapped axes and wrong signs.

Two independent sources show them: the labels, and the rotation of gravity in the accelerometers against the gyros.
The specific force of a body that only rotates is constant in Earth-fixed axes, so in body axes ``df/dt = f × ω``. The
readings f̃ and ω̃ during rotations therefore determine the matrix ``K`` of ``df̃/dt = f̃ × (K ω̃)`` without labels.
Correct readings give ``K = I``. Gyro readings in a unit that is wrong by the factor c give ``K = I / c``. Signed
permutations of the axes, ``f̃ = Pa f`` and ``ω̃ = Pg ω``, give ``K = det(Pa) Pa Pg⁻¹``. The wrong sign of all three
accelerometers does not change K.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.rotation_readings import rotation_angles
from srt.diagnosis.triad_fits import accel_fit, gyro_fit
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices


_EYE: Final = np.eye(3)


def axis_permutations(evidence: Evidence) -> Iterator[Finding]:
    """Find signed permutations of both triads relative to the labels, if the rotation of gravity confirms them."""
    gyro, accel = gyro_axes(evidence), accel_axes(evidence)
    relation = None
    if gyro is None or accel is None or not (_is(gyro, _EYE) and _is(accel, _EYE)):
        relation = gravity_relation(evidence)
        relation = None if relation is None else nearest_axes(relation)
    if gyro is None or accel is None:
        if relation is not None and not _is(relation, _EYE):
            yield _relative_finding(relation)
        return
    if _is(gyro, _EYE) and _is(accel, _EYE):
        return
    if relation is not None and not _is(relation, np.linalg.det(accel) * accel @ gyro.T):
        return  # the rotation of gravity contradicts the permutations: the labels are wrong, not the axes
    yield _permutation_finding(gyro, accel)


SIGN_CONVENTION: Final = by_sensor(
    "sign_convention",
    "[All gyro axes have the wrong sign|The accelerometers read gravity, not specific force]",
    "[signs of the measured rotation angles; rotation|direction] of gravity in [the accelerometers against the "
    "gyros|each static pose]",
    "All three [gyros measure rotations with|accelerometers have] the wrong sign[| (at rest, their vector points "
    "down)]: the unit [uses the opposite sign convention|outputs gravity instead of specific force]; map the "
    "[gyro|accelerometer] axes as {mapping}.",
    "exit 1",
    axis_permutations,
)
AXIS_FLIPPED: Final = by_sensor(
    "axis_flipped",
    "One [gyro|accelerometer] axis has the wrong sign",
    "[rotation angles by axis|direction of gravity in each static pose]",
    "[Gyro|Accelerometer] axis {axis} [measures rotations with|has] the wrong sign, which makes the triad left-handed:"
    " map the [gyro|accelerometer] axes as {mapping}.",
    "exit 1",
    axis_permutations,
)
AXES_SWAPPED: Final = by_sensor(
    "axes_swapped",
    "Two [gyro|accelerometer] axes are swapped",
    "[rotation angles by axis|direction of gravity in each static pose]",
    "[Gyro|Accelerometer] axes {axes} are swapped: map the [gyro|accelerometer] axes as {mapping}.",
    "exit 1",
    axis_permutations,
)
LEFT_HANDED: Final = Fault(
    "left_handed",
    "Gyros and accelerometers share a left-handed frame",
    "rotation angles and static poses together",
    "Gyros and accelerometers agree with each other, but their frame is left-handed: map the gyro axes as "
    "{gyro_mapping} and the accelerometer axes as {accel_mapping}.",
    "exit 1",
    axis_permutations,
)
FRAME_TURNED: Final = Fault(
    "frame_turned",
    "The axes of the unit are rotated by multiples of 90°",
    "rotation angles and static poses together",
    "Gyros and accelerometers agree with each other, but not with the axes of the labels: map the axes of both as "
    "{mapping}, or mount the unit along the axes of the table.",
    "exit 1",
    axis_permutations,
)
FRAMES_DISAGREE: Final = Fault(
    "frames_disagree",
    "Gyro and accelerometer frames disagree",
    "rotation of gravity in the accelerometers against the gyros",
    "Gyros and accelerometers use different axes: map the gyro axes as {gyro_mapping} and the accelerometer axes as "
    "{accel_mapping}.",
    "exit 1",
    axis_permutations,
)


def _is(first: Array, second: Array) -> bool:
    return bool(np.abs(first - second).max() < 0.5)


def _relative_finding(relation: Array) -> Finding:
    """Fault of the gyros relative to the accelerometers; without labels, the simplest fault that explains K."""
    proper = np.linalg.det(relation) > 0.0
    # An improper Pg makes K improper (determinant -1). An improper Pa makes K = -Pa, which is proper.
    if not proper:
        return _permutation_finding(relation.T, _EYE)
    other = _one_sensor("accel", -relation)
    return other if other is not None else _permutation_finding(relation.T, _EYE)


def _permutation_finding(gyro: Array, accel: Array) -> Finding:
    """Fault for the signed permutations of gyros and accelerometers."""
    if _is(accel, _EYE) and (one := _one_sensor("gyro", gyro)) is not None:
        return one
    if _is(gyro, _EYE) and (one := _one_sensor("accel", accel)) is not None:
        return one
    maps = {"gyro_mapping": mapping(gyro), "accel_mapping": mapping(accel)}
    if np.linalg.det(accel) < 0.0 and (_is(gyro, accel) or _is(gyro, -accel)):
        return LEFT_HANDED.found(**maps)
    if _is(gyro, accel):
        return FRAME_TURNED.found(mapping=maps["gyro_mapping"])
    return FRAMES_DISAGREE.found(**maps)


def _one_sensor(sensor: str, axes: Array) -> Finding | None:
    """Fault for a signed permutation of one triad; None if the catalogue has no fault for it."""
    undo = mapping(axes)
    if _is(axes, -_EYE):
        return SIGN_CONVENTION[sensor].found(mapping=undo)
    wrong = np.flatnonzero(np.abs(np.diag(axes) - 1.0) > 0.5)
    if len(wrong) == 1:
        return AXIS_FLIPPED[sensor].found(axis=AXES[wrong[0]], mapping=undo)
    if len(wrong) == 2 and axes[wrong[0], wrong[1]] > 0.5 and axes[wrong[1], wrong[0]] > 0.5:
        return AXES_SWAPPED[sensor].found(axes=f"{AXES[wrong[0]]} and {AXES[wrong[1]]}", mapping=undo)
    return None


_BLOCK_S: Final = 0.1
"""Length of a block, s, over which gyro readings are integrated and accelerometer readings averaged: long enough to
suppress the noise of a sample, short enough for a constant rotation axis over two blocks."""
_LEAST_EIGENVALUE: Final = 1e-3
"""Smallest ratio of the smallest to the largest eigenvalue of the normal equations: below it, the rotations hardly
cover one axis."""
_UNEXPLAINED_BY_LABELS: Final = 0.3
"""Largest share of the power of the readings that the fit to the labels may leave unexplained: it leaves a few per cent
of correct readings, but most of the power if the labels are wrong."""
_UNEXPLAINED_BY_GYROS: Final = 0.65
"""Largest share of the power of df/dt that K may leave unexplained: the acceleration of a unit turned by hand changes f
about as much as the rotation does."""
_FEWEST_BLOCKS: Final = 50
"""Fewest blocks for a fit of K: with 50 blocks, its nine coefficients explain 6 % of pure noise."""
_AXIS_TOLERANCE: Final = 0.5
"""Largest deviation of an element of a unit row from that of the nearest axis: 0.5 is an angle of 30°."""


@dataclass(frozen=True, slots=True, eq=False)
class ManoeuvreReadings:
    """Means of the stationary windows, and the manoeuvres between them, from the labels or from the recognition.

    Attributes
    ----------
    rate, force : ndarray, shape (W, 3), rad/s and m/s²
        Mean readings of the windows.
    spans : ndarray of int, shape (K, 2)
        First sample of each manoeuvre without a gap, and one past its last sample.
    between : ndarray of int, shape (K, 2)
        Numbers of the windows before and after each manoeuvre.
    """

    rate: Array
    force: Array
    spans: Indices
    between: Indices


def manoeuvre_readings(evidence: Evidence) -> ManoeuvreReadings | None:
    """Readings of the labelled manoeuvres, or of the recognised ones without labels; None if there are none."""
    if evidence.has_labels:
        data = evidence.data
        if data is None:
            return None
        between = np.stack([data.start, data.end], axis=1)[evidence.contiguous]
        return ManoeuvreReadings(
            evidence.stationary_rate, evidence.stationary_force, data.rotation[evidence.contiguous], between
        )
    if evidence.recognition is None:
        return None
    found = evidence.recognition
    recording, rates = evidence.recording, evidence.per_rate
    rate, force = (
        np.array([table[a:b].mean(axis=0) for a, b in found.windows.tolist()]) * rates
        for table in (recording.gyro, recording.accel)
    )
    spans = np.array([(turn.first, turn.last) for turn in found.turns], dtype=np.intp).reshape(-1, 2)
    between = np.array([(turn.start_window, turn.end_window) for turn in found.turns], dtype=np.intp).reshape(-1, 2)
    return ManoeuvreReadings(rate, force, spans, between)


def gravity_relation(evidence: Evidence) -> Array | None:
    """Matrix K of ``df/dt = f × (K ω̃)`` over all rotations, by least squares.

    Returns
    -------
    ndarray, shape (3, 3), or None
        None if the rotations do not cover all axes, or no K explains the readings.
    """
    turns = manoeuvre_readings(evidence)
    if turns is None:
        return None
    recording = evidence.recording
    size = max(1, round(_BLOCK_S / evidence.dt))
    seconds = evidence.dt * size
    normal, right, seen, blocks = np.zeros((3, 3, 3, 3)), np.zeros((3, 3)), 0.0, 0
    for (a, b), (before, after) in zip(turns.spans.tolist(), turns.between.tolist(), strict=True):
        count = (b - a) // size
        if count < 2:
            continue
        stop = a + count * size
        rate = recording.gyro[a:stop].reshape(count, size, 3).mean(axis=1) * evidence.per_rate
        angle = (rate - 0.5 * (turns.rate[before] + turns.rate[after])) * seconds
        force = recording.accel[a:stop].reshape(count, size, 3).mean(axis=1)
        turned, mean, change = 0.5 * (angle[1:] + angle[:-1]), 0.5 * (force[1:] + force[:-1]), np.diff(force, axis=0)
        across = np.einsum("ni,ni->n", mean, mean)[:, None, None] * np.eye(3) - np.einsum("ni,nj->nij", mean, mean)
        normal += np.einsum("nij,nk,nl->ikjl", across, turned, turned)
        right += np.einsum("ni,nk->ik", np.cross(change, mean), turned)
        seen += float(np.einsum("ni,ni->", change, change))
        blocks += len(change)
    matrix = normal.reshape(9, 9)
    if blocks < _FEWEST_BLOCKS or seen == 0.0 or not np.all(np.isfinite(matrix)):
        return None
    values = np.linalg.eigvalsh(matrix)
    if values[0] <= _LEAST_EIGENVALUE * values[-1]:
        return None
    relation = np.asarray(np.linalg.solve(matrix, right.ravel()), dtype=np.float64).reshape(3, 3)
    # The power explained by least squares is the scalar product of the solution and the right-hand side.
    return relation if seen - float(np.sum(relation * right)) <= _UNEXPLAINED_BY_GYROS * seen else None


def nearest_axes(matrix: Array) -> Array | None:
    """Signed permutation nearest to the directions of the rows of a matrix; None if no permutation is near."""
    length = np.linalg.norm(matrix, axis=1, keepdims=True)
    if not (np.all(np.isfinite(length)) and np.all(length > 0.0)):
        return None
    rows = matrix / length
    largest = np.argmax(np.abs(rows), axis=1)
    if len(set(largest.tolist())) < 3:
        return None
    nearest = np.zeros((3, 3))
    nearest[range(3), largest] = np.sign(rows[range(3), largest])
    return nearest if np.abs(rows - nearest).max() < _AXIS_TOLERANCE else None


def gyro_axes(evidence: Evidence) -> Array | None:
    """Signed permutation Pg of the gyros from the labelled rotations; None if they do not determine it."""
    if evidence.data is None or gyro_fit(evidence).rank < 3:
        return None
    _, _, turned = rotation_angles(evidence)
    return nearest_axes(gyro_fit(evidence).matrix) if _fits(gyro_fit(evidence).residual, turned) else None


def accel_axes(evidence: Evidence) -> Array | None:
    """Signed permutation Pa of the accelerometers from the labelled poses; None if they do not determine it."""
    if evidence.data is None or accel_fit(evidence).rank < 3:
        return None
    _, reading = evidence.poses
    fit = accel_fit(evidence)
    return nearest_axes(fit.matrix) if _fits(fit.residual, reading - fit.offset) else None


def _fits(residual: Array, reading: Array) -> bool:
    return bool(np.sum(residual**2) <= _UNEXPLAINED_BY_LABELS * np.sum(reading**2))


def mapping(axes: Array) -> str:
    """Axis mapping that reverses a signed permutation, in the form of ``srt convert --map-gyro``: "x,-y,z"."""
    undo = axes.T
    columns = np.argmax(np.abs(undo), axis=1)
    return ",".join(("-" if undo[i, j] < 0.0 else "") + AXES[j] for i, j in enumerate(columns.tolist()))
