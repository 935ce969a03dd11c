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
from srt.diagnosis.rotation_readings import AGREE, ROUNDING, cross
from srt.sequences.rest_detection import BLOCK_S

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.recognition import Recognition
    from srt.types import Array, Indices, Mask

SECOND: Final = round(1.0 / BLOCK_S)
"""Number of blocks in a second: fewest of a reading that stays."""
_UNEXPLAINED_BY_GYROS: Final = 0.65
"""Largest share of the power of df/dt that K may leave unexplained: the acceleration of a unit turned by hand changes f
about as much as the rotation does."""
_ACROSS: Final = 0.25
"""Smallest squared sine of the angle between an axis and the vertical at which the accelerometers see a rotation."""
UNEXPLAINED: Final = 0.3
"""Largest share of a power that an explanation may leave: of that of df after the gyros, by a missing rotation about
one axis; of that of the readings, by the fit to the labels. Noise and wrong labels leave half and more."""
SAME: Final = 0.02
"""Largest difference of two readings of an axis that does not follow gravity, in units of gravity: noise and drift."""
_UPRIGHT: Final = 0.2
"""Largest share of gravity on the other axes of an axis that is upright."""
_NEAR_TOP: Final = 0.05
"""Largest distance of a rate from the largest one where a limit acts, and smallest effect of a limit: time offsets and
lever arms make less."""


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
        np.array([table[a:b].mean(axis=0) for a, b in found.windows.tolist()]) * recording.rates_factor
        for table in (recording.gyro, recording.accel)
    )
    spans = np.array([(turn.first, turn.last) for turn in found.turns], dtype=np.intp).reshape(-1, 2)
    between = np.array([(turn.start_window, turn.end_window) for turn in found.turns], dtype=np.intp).reshape(-1, 2)
    return ManoeuvreReadings(rate, force, spans, between)


def block_size(recording: Recording) -> int:
    """Number of samples of a block of a tenth of a second."""
    return max(1, round(BLOCK_S / recording.nominal_interval_s))


def block_means(recording: Recording) -> tuple[Array, Array]:
    """Mean rates and specific forces of the blocks of a recording, rad/s and m/s², (n, 3) each."""
    size, factor = block_size(recording), recording.rates_factor
    count = len(recording.time) // size
    gyro, accel = (
        np.einsum("bsc->bc", table[: count * size].reshape(count, size, 3)) * (factor / size)
        for table in (recording.gyro, recording.accel)
    )
    return gyro, accel


class TurningBlocks(NamedTuple):
    """Readings of the manoeuvres from the middle of each of n blocks to the middle of the next one."""

    step_s: float  # length of a block
    turn: Indices  # number of the manoeuvre, (n,)
    at: Indices  # first sample of the second block, (n,)
    angle: Array  # raw angle, (n, 3), rad
    force: Array  # mean specific force, (n, 3), m/s²
    change: Array  # its change, (n, 3), m/s²


def turning_blocks(recording: Recording, turns: ManoeuvreReadings, means: tuple[Array, Array]) -> TurningBlocks:
    """Blocks that lie inside of the manoeuvres, of all manoeuvres one after the other."""
    size, (rate, force) = block_size(recording), means
    step_s = size * recording.nominal_interval_s
    first, last = -(-turns.spans[:, 0] // size), turns.spans[:, 1] // size
    count = np.maximum(last - first - 1, 0)
    turn = np.repeat(np.arange(len(count)), count)
    i = np.arange(len(turn)) + np.repeat(first - np.cumsum(count) + count, count)
    offset = turns.rate[turns.between].mean(axis=1)
    angle = (0.5 * (rate[i] + rate[i + 1]) - offset[turn]) * step_s
    return TurningBlocks(step_s, turn, size * (i + 1), angle, 0.5 * (force[i] + force[i + 1]), force[i + 1] - force[i])


_SCALE: Final = 0.2
"""Largest difference from one of the rotation of gravity over that of the gyros below a limit: twice the scale-factor
error of a working sensor. Where it is larger, the windows are no rests, or the axes are wrong."""
_TURNS: Final = 2.0
"""Smallest effective number of the rotations that a limit leaves alone."""
_LARGEST_HALF: Final = 1.0
"""Largest half angle of a block, rad: 20 rad/s, faster than any gyro reads; beyond, the unit of the rates is wrong."""


class Limit(NamedTuple):
    """Limit below whose noise the readings of an axis stay, and the samples of blocks at the limit."""

    axis: int
    value: float
    at: Indices


def force_limit(turns: ManoeuvreReadings, blocks: TurningBlocks) -> Limit | None:
    """Limit of the specific force below gravity: an upright axis keeps its reading while the others show that it tilts.

    Within 2 % of its largest reading, an axis that measures gravity is upright to 0.2 rad.
    """
    for axis, sign in product(range(3), (1.0, -1.0)):
        others = np.delete(np.arange(3), axis)
        best = turns.force[np.argmax(sign * turns.force[:, axis])]
        top = sign * float(best[axis])
        tilted = np.linalg.norm(blocks.force[:, others], axis=1) > 2.0 * _UPRIGHT * top
        held = blocks.at[tilted & (np.abs(sign * blocks.force[:, axis] - top) < SAME * top)]
        if np.linalg.norm(best[others]) < _UPRIGHT * top and len(held) >= SECOND:
            return Limit(axis, top, held)
    return None


def rate_limit(blocks: TurningBlocks) -> Limit | None:
    """Limit of the rate: near the largest readings gravity rotates faster than the gyros read, but not at lower ones.

    It may be that of one axis, or of all. Statistic: difference of the two ratios over its standard deviation from the
    scatter within the rotations and between them, where the errors of the sensors differ. Distribution: normal, four
    tests.
    """
    half = 0.5 * np.linalg.norm(blocks.angle, axis=1)
    if half.max(initial=0.0) > _LARGEST_HALF:
        return None
    # Between the means of two blocks, the chord of a rotation is that of its arc times tan(x) / x.
    arc = blocks.angle * (np.tan(half) / np.where(half > 0.0, half, 1.0))[:, None]
    for axes in (np.ones(3), *np.eye(3)):
        size, expected = np.abs(blocks.angle * axes).max(axis=1), cross(blocks.force, arc * axes)
        change = blocks.change - cross(blocks.force, arc * (1.0 - axes))
        top = float(size.max(initial=0.0))
        near, ratio, variance, turns = size > (1.0 - _NEAR_TOP) * top, [], [], []
        for part in (near, (size > 2.0 * _UPRIGHT * top) & (size < (1.0 - 2.0 * _NEAR_TOP) * top)):
            power = float(np.sum(expected[part] ** 2))
            if np.count_nonzero(part) < SECOND or power == 0.0:
                break
            ratio.append(float(np.sum(expected[part] * change[part])) / power)
            left = change[part] - ratio[-1] * expected[part]
            variance.append(float(np.mean(left**2)) / power)
            turns.append(_by_turn(blocks.turn[part], expected[part], left))
        # One rotation does not show by how much rotations differ.
        if len(ratio) < 2 or abs(ratio[1] - 1.0) > _SCALE or turns[1][1] < _TURNS:
            continue
        between = turns[1][0] * (1.0 / turns[0][1] + 1.0 / turns[1][1])
        doubt = limit("normal", tests=4) * math.sqrt(sum(variance) + between)
        if ratio[0] - ratio[1] > max(_NEAR_TOP * ratio[1], doubt):
            axis = int(np.argmax(np.abs(blocks.angle * axes).max(axis=0)))
            return Limit(axis, top / blocks.step_s, blocks.at[near])
    return None


def _by_turn(turn: Indices, expected: Array, left: Array) -> tuple[float, float]:
    """Variance between rotations of a ratio to what is expected, from what it leaves, and their effective number.

    The variance is about the mean of so many rotations; it is zero of a single one.
    """
    power = np.bincount(turn, np.sum(expected**2, axis=1))
    along = np.bincount(turn, np.sum(expected * left, axis=1))[power > 0.0]
    power = power[power > 0.0]
    number = float(power.sum() ** 2 / np.sum(power**2))
    return float(np.sum(along**2 / power) / power.sum()) / max(1.0 - 1.0 / number, 0.5), number


def missed_rotations(turns: ManoeuvreReadings | None, blocks: TurningBlocks | None) -> tuple[Array, Array]:
    """Angles that single gyros miss in each of K manoeuvres, and that they read, (K, 3) each, rad, with signs.

    The change of specific force that the gyros leave, ``df - f × dθ``, gives the angle about one axis that they miss.
    It is zero where an angle about that axis does not explain this change. A knock, which comes and goes, is no angle.
    """
    missed, read = np.zeros((2, 0 if turns is None else len(turns.spans), 3))
    if blocks is None or not len(blocks.turn):
        return missed, read
    force, left = blocks.force, blocks.change - cross(blocks.force, blocks.angle)
    about = cross(force[:, None], np.eye(3))
    square = np.einsum("nij,nij->ni", about, about)
    seen = square > _ACROSS * np.einsum("ni,ni->n", force, force)[:, None]
    angle = np.where(seen, np.einsum("nj,nij->ni", left, about) / np.where(seen, square, 1.0), 0.0)
    first = np.flatnonzero(np.diff(blocks.turn, prepend=-1))
    rest = np.add.reduceat(np.sum((left[:, None] - angle[:, :, None] * about) ** 2, axis=2), first)
    explained = rest < UNEXPLAINED * np.add.reduceat(np.sum(left**2, axis=1), first)[:, None]
    missed[blocks.turn[first]] = _extent(_lasting(angle), first) * explained
    read[blocks.turn[first]] = _extent(blocks.angle, first)
    return missed, read


def _lasting(steps: Array) -> Array:
    """Steps (n, 3) whose sum is the median over five blocks: without what comes and goes within two of them."""
    course = np.pad(np.cumsum(steps, axis=0), ((2, 2), (0, 0)), mode="edge")
    return np.diff(np.median(np.lib.stride_tricks.sliding_window_view(course, 5, axis=0), axis=2), axis=0, prepend=0.0)


def _extent(steps: Array, first: Indices) -> Array:
    """Sum of the steps (n, 3) since the first one of each manoeuvre that is farthest from zero, with its sign."""
    course = np.cumsum(steps, axis=0)
    start = course[first] - steps[first]
    low, high = (extreme.reduceat(course, first) - start for extreme in (np.minimum, np.maximum))
    return np.asarray(np.where(high > -low, high, low))


def gravity_relation(blocks: TurningBlocks) -> Array | None:
    """Matrix K of ``df/dt = f × (K ω̃)`` over all rotations, by least squares, shape (3, 3).

    None if no K explains the readings, or if its elements are not determined to half of the length of their row, as
    where the rotations do not cover all axes. Statistic: half a length over the standard deviation from the scatter.
    Distribution: t, nine elements.
    """
    about = cross(blocks.force[:, None], np.eye(3))
    design = np.einsum("nki,nl->nikl", about, blocks.angle).reshape(-1, 9)
    freedom = blocks.change.size - design.shape[1]
    if freedom <= 0 or not np.all(np.isfinite(design)):
        return None
    U, size, Vt = np.linalg.svd(design, full_matrices=False)
    if size[-1] <= ROUNDING * size[0]:
        return None
    root = Vt.T / size
    relation = root @ (U.T @ blocks.change.ravel())
    left = blocks.change.ravel() - design @ relation
    if left @ left > _UNEXPLAINED_BY_GYROS * np.sum(blocks.change**2):
        return None
    sigma = np.linalg.norm(root, axis=1) * math.sqrt(float(left @ left) / freedom)
    doubt, K = limit("t", freedom, tests=sigma.size, both_sides=True) * sigma.reshape(3, 3), relation.reshape(3, 3)
    return K if np.all(doubt.max(axis=1) < AGREE * np.linalg.norm(K, axis=1)) else None


def relation_by_turn(blocks: TurningBlocks, relation: Array) -> Array:
    """Rotation of gravity in each manoeuvre over that which K gives, shape (m,); positive ones only.

    Accelerations of the hand add to the rotation of gravity, and scatter from turn to turn.
    """
    expected = cross(blocks.force, blocks.angle @ relation.T)
    along, square = (np.bincount(blocks.turn, np.sum(each * expected, axis=1)) for each in (blocks.change, expected))
    ratios = along[square > 0.0] / square[square > 0.0]
    return np.asarray(ratios[ratios > 0.0])
