"""Rotation of gravity in the accelerometers against the gyros.

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

from srt.diagnosis.rotation_readings import cross, rates_factor
from srt.sequences.rest_detection import BLOCK_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.recognition import Recognition
    from srt.types import Array, Indices, Mask

_LEAST_EIGENVALUE: Final = 1e-3
"""Smallest ratio of the smallest to the largest eigenvalue of the normal equations: below it, the rotations hardly
cover one axis."""
_UNEXPLAINED_BY_GYROS: Final = 0.65
"""Largest share of the power of df/dt that K may leave unexplained: the acceleration of a unit turned by hand changes f
about as much as the rotation does."""
_ACROSS: Final = 0.25
"""Smallest squared sine of the angle between an axis and the vertical at which the accelerometers see a rotation."""
UNEXPLAINED: Final = 0.3
"""Largest share of a power that an explanation may leave: of that of df after the gyros, by a missing rotation about
one axis; of that of the readings, by the fit to the labels. Noise and wrong labels leave half and more."""
_FEWEST_BLOCKS: Final = 50
"""Fewest blocks for a fit of K: with 50 blocks, its nine coefficients explain 6 % of pure noise."""


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


def labelled_manoeuvres(data: PreparedRecording, contiguous: Mask) -> ManoeuvreReadings:
    """Readings of the labelled manoeuvres without a gap, which are the true ones of a mask."""
    between = np.stack([data.start, data.end], axis=1)[contiguous]
    return ManoeuvreReadings(data.windows.gyro_mean, data.windows.accel_mean, data.rotation[contiguous], between)


def recognised_manoeuvres(recording: Recording, found: Recognition) -> ManoeuvreReadings:
    """Readings of the recognised manoeuvres."""
    rate, force = (
        np.array([table[a:b].mean(axis=0) for a, b in found.windows.tolist()]) * rates_factor(recording)
        for table in (recording.gyro, recording.accel)
    )
    spans = np.array([(turn.first, turn.last) for turn in found.turns], dtype=np.intp).reshape(-1, 2)
    between = np.array([(turn.start_window, turn.end_window) for turn in found.turns], dtype=np.intp).reshape(-1, 2)
    return ManoeuvreReadings(rate, force, spans, between)


def _blocks(recording: Recording, turns: ManoeuvreReadings) -> Iterator[tuple[int, Array, Array, Array]]:
    """Number of each manoeuvre, and raw angle, mean specific force and its change from block to block, (n, 3) each."""
    size = max(1, round(BLOCK_S / recording.nominal_interval_s))
    seconds = recording.nominal_interval_s * size
    for k, ((a, b), ends) in enumerate(zip(turns.spans.tolist(), turns.between, strict=True)):
        count = (b - a) // size
        if count < 2:
            continue
        stop = a + count * size
        rate = recording.gyro[a:stop].reshape(count, size, 3).mean(axis=1) * rates_factor(recording)
        angle = (rate - turns.rate[ends].mean(axis=0)) * seconds
        force = recording.accel[a:stop].reshape(count, size, 3).mean(axis=1)
        yield k, 0.5 * (angle[1:] + angle[:-1]), 0.5 * (force[1:] + force[:-1]), np.diff(force, axis=0)


def missed_rotations(recording: Recording, turns: ManoeuvreReadings) -> tuple[Array, Array]:
    """Angles that single gyros miss in each manoeuvre, and that they read, (K, 3) each, rad, with signs.

    The change of specific force that the gyros leave, ``df - f × dθ``, gives the angle about one axis that they miss.
    It is zero where an angle about that axis does not explain this change.
    """
    missed, read = np.zeros((2, len(turns.spans), 3))
    for k, turned, force, change in _blocks(recording, turns):
        left = change - cross(force, turned)
        about = cross(force[:, None], np.eye(3))
        square = np.einsum("nij,nij->ni", about, about)
        seen = square > _ACROSS * np.einsum("ni,ni->n", force, force)[:, None]
        angle = np.where(seen, np.einsum("nj,nij->ni", left, about) / np.where(seen, square, 1.0), 0.0)
        rest = np.sum((left[:, None] - angle[:, :, None] * about) ** 2, axis=(0, 2))
        explained = rest < UNEXPLAINED * np.sum(left**2)
        missed[k] = _extent(np.cumsum(angle, axis=0)) * explained
        read[k] = _extent(np.cumsum(turned, axis=0))
    return missed, read


def _extent(course: Array) -> Array:
    """Value of each column of the course (n, 3) that is farthest from zero, with its sign."""
    return np.asarray(course[np.argmax(np.abs(course), axis=0), range(3)])


def gravity_relation(recording: Recording, turns: ManoeuvreReadings) -> Array | None:
    """Matrix K of ``df/dt = f × (K ω̃)`` over all rotations, by least squares, shape (3, 3).

    None if the rotations do not cover all axes, or no K explains the readings.
    """
    normal, right, seen, blocks = np.zeros((3, 3, 3, 3)), np.zeros((3, 3)), 0.0, 0
    for _, turned, mean, change in _blocks(recording, turns):
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
