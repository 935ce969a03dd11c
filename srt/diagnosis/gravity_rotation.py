"""Rotation of gravity in the accelerometers against the gyros.

The specific force of a body that only rotates is constant in Earth-fixed axes, so in body axes ``df/dt = f × ω``. The
readings f̃ and ω̃ during rotations therefore determine the matrix ``K`` of ``df̃/dt = f̃ × (K ω̃)`` without labels.
Correct readings give ``K = I``. Gyro readings in a unit that is wrong by the factor c give ``K = I / c``. Signed
permutations of the axes, ``f̃ = Pa f`` and ``ω̃ = Pg ω``, give ``K = det(Pa) Pa Pg⁻¹``. The wrong sign of all three
accelerometers does not change K.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.false_alarms import limit
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

_UPRIGHT: Final = 0.2
"""Largest share of gravity on the other axes of an axis that is upright."""
_SAME: Final = 0.01
"""Largest difference of readings at one limit: noise."""
_NEAR_TOP: Final = 0.05
"""Largest distance of a rate from the largest one where a limit acts, and smallest effect of a limit: time offsets and
lever arms make less."""
_FEWEST_HELD: Final = 10
"""Fewest blocks at a limit, one second."""


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


class Limit(NamedTuple):
    """Limit below whose noise the readings of an axis stay, and the samples of blocks at the limit."""

    axis: int
    value: float
    at: Indices


def force_limit(recording: Recording, turns: ManoeuvreReadings) -> Limit | None:
    """Limit of the specific force below gravity: an upright axis keeps its reading while the others show that it tilts.

    Within 1 % of its largest reading, an axis that measures gravity is upright to 0.14 rad.
    """
    at, _, force, _ = _all_blocks(recording, turns)
    for axis, sign in product(range(3), (1.0, -1.0)):
        others = np.delete(np.arange(3), axis)
        best = turns.force[np.argmax(sign * turns.force[:, axis])] / rates_factor(recording)
        top = sign * float(best[axis])
        tilted = np.linalg.norm(force[:, others], axis=1) > 2.0 * _UPRIGHT * top
        held = at[tilted & (np.abs(sign * force[:, axis] - top) < _SAME * top)]
        if np.linalg.norm(best[others]) < _UPRIGHT * top and len(held) >= _FEWEST_HELD:
            return Limit(axis, top * rates_factor(recording), held)
    return None


def rate_limit(recording: Recording, turns: ManoeuvreReadings) -> Limit | None:
    """Limit of the rate: near the largest readings gravity rotates faster than the gyros read, but not at lower ones.

    Statistic: difference of the two ratios over its standard deviation from the scatter. Distribution: normal.
    """
    at, angle, force, change = _all_blocks(recording, turns)
    size, expected = np.abs(angle).max(axis=1), cross(force, angle)
    top = float(size.max(initial=0.0))
    held, ratio, variance = at[size > (1.0 - _NEAR_TOP) * top], [], []
    for part in (size > (1.0 - _NEAR_TOP) * top, (size > 2.0 * _UPRIGHT * top) & (size < 0.9 * top)):
        power = float(np.sum(expected[part] ** 2))
        if np.count_nonzero(part) < _FEWEST_HELD or power == 0.0:
            return None
        ratio.append(float(np.sum(expected[part] * change[part])) / power)
        left = change[part] - ratio[-1] * expected[part]
        variance.append(float(np.mean(left**2)) / power)
    if ratio[0] - ratio[1] <= max(_NEAR_TOP * ratio[1], limit("normal") * math.sqrt(sum(variance))):
        return None
    axis = int(np.argmax(np.abs(angle).max(axis=0)))
    return Limit(axis, top / (block_size(recording) * recording.nominal_interval_s), held)


def block_size(recording: Recording) -> int:
    """Number of samples of a block of a tenth of a second."""
    return max(1, round(BLOCK_S / recording.nominal_interval_s))


def _blocks(recording: Recording, turns: ManoeuvreReadings) -> Iterator[tuple[int, Indices, Array, Array, Array]]:
    """Number of each manoeuvre; from block to block, sample, raw angle, mean specific force and its change, (n, 3)."""
    size = block_size(recording)
    seconds = recording.nominal_interval_s * size
    for k, ((a, b), ends) in enumerate(zip(turns.spans.tolist(), turns.between, strict=True)):
        count = (b - a) // size
        if count < 2:
            continue
        stop = a + count * size
        rate = recording.gyro[a:stop].reshape(count, size, 3).mean(axis=1) * rates_factor(recording)
        angle = (rate - turns.rate[ends].mean(axis=0)) * seconds
        force = recording.accel[a:stop].reshape(count, size, 3).mean(axis=1)
        at = a + size * np.arange(1, count)
        yield k, at, 0.5 * (angle[1:] + angle[:-1]), 0.5 * (force[1:] + force[:-1]), np.diff(force, axis=0)


def _all_blocks(recording: Recording, turns: ManoeuvreReadings) -> tuple[Indices, Array, Array, Array]:
    """Blocks of all manoeuvres one after the other; none where all manoeuvres are shorter than two blocks."""
    rows = [(np.zeros(0, dtype=np.intp), *np.zeros((3, 0, 3))), *(row[1:] for row in _blocks(recording, turns))]
    at, angle, force, change = (np.concatenate(values) for values in zip(*rows, strict=True))
    return at, angle, force, change


def missed_rotations(recording: Recording, turns: ManoeuvreReadings) -> tuple[Array, Array]:
    """Angles that single gyros miss in each manoeuvre, and that they read, (K, 3) each, rad, with signs.

    The change of specific force that the gyros leave, ``df - f × dθ``, gives the angle about one axis that they miss.
    It is zero where an angle about that axis does not explain this change.
    """
    missed, read = np.zeros((2, len(turns.spans), 3))
    for k, _, turned, force, change in _blocks(recording, turns):
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
    for _, _, turned, mean, change in _blocks(recording, turns):
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
