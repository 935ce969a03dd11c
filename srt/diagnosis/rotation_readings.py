"""Readings during the rotations: integrals, averages over blocks, and the measured angles of single rotations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from srt.diagnosis.false_alarms import limit
from srt.sequences.manoeuvres import MOVING, end_attitude, leg_borders
from srt.sequences.preparation import nominal_attitude
from srt.sequences.rest_detection import BLOCK_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.model.table1 import RotationSequence
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_STEP_S: Final = 0.01
"""Length of a block of samples, s: at 1 rad/s the unit rotates by 10 mrad per block."""
_MARGIN_S: Final = 0.5
"""Stationary time used before and after a rotation, s."""
_ROUNDS: Final = 12
"""Number of reweightings of a robust fit."""
_ROTATING: Final = 0.05
"""Ratio of the range of the rates in a window to that in the rotations, above which the window is not stationary: bumps
and creep are slower."""
_BY_NOISE: Final = 4e-6
"""False-alarm probability, for one recording, that noise alone classifies a window as rotating."""
ROUNDING: Final = 1e-9
"""Largest rounding of readings, relative to the largest reading: a unit conversion makes 1e-16, a file 1e-10."""
MAD: Final = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal distribution."""
_SLOWEST_RAD_S: Final = 0.05
"""Slowest rotation of a manoeuvre, rad/s: 180° in a minute."""
_OTHER_UNIT: Final = 8.0
"""Ratio of the largest rate of an axis to the median of the three axes, above which it is in another unit."""
_MANY_WINDOWS: Final = 12
"""Fewest windows for a fit of g-sensitivity: three times its four unknowns, one bias and three slopes."""


def rates_factor(recording: Recording) -> float:
    """Factor from stored values to rates: 1, or one over the interval for increments."""
    return 1.0 if recording.kind == "rate" else 1.0 / recording.nominal_interval_s


def median(rows: Array) -> Array:
    """Median along the last axis. For short rows, ``numpy.median`` takes several times as long."""
    middle = [(rows.shape[-1] - 1) // 2, rows.shape[-1] // 2]
    return np.asarray(np.partition(np.ascontiguousarray(rows), middle, axis=-1)[..., middle].mean(axis=-1))


def cross(a: Array, b: Array) -> Array:
    """Cross product along the last axis; shapes broadcast. For few vectors, ``numpy.cross`` takes ten times as long."""
    ahead, behind = [1, 2, 0], [2, 0, 1]
    return np.asarray(a[..., ahead] * b[..., behind] - a[..., behind] * b[..., ahead])


def invert_readings(matrix: Array, readings: Array) -> Array:
    """Values whose readings are ``matrix @ value``; readings and values have shape (n, 3)."""
    return np.asarray(readings @ np.linalg.inv(matrix).T)


@cache
def nominal_end_attitude(sequence: RotationSequence) -> Array:
    """Nominal attitude at the end of a sequence, B_End to B_Strt, shape (3, 3); read-only."""
    return end_attitude(sequence)


@dataclass(frozen=True, slots=True, eq=False)
class RawIntegrals:
    """Raw readings of each sequence: gyros integrated over the rotations, accelerometers averaged over the windows.

    Attributes
    ----------
    signed, absolute : ndarray, shape (K, 3), rad
        Integrals of the gyro readings less the mean of both windows, and of their absolute values.
    before, after : ndarray, shape (K, 3), m/s²
        Mean accelerometer readings of the start window and of the end window.
    """

    signed: Array
    absolute: Array
    before: Array
    after: Array


def raw_integrals(data: PreparedRecording) -> RawIntegrals:
    """Integrals of all sequences."""
    recording, rest = data.recording, data.windows.gyro_mean
    signed, absolute = np.empty((data.K, 3)), np.empty((data.K, 3))
    for k, (a, b) in enumerate(data.rotation.tolist()):
        bias = 0.5 * (rest[data.start[k]] + rest[data.end[k]])
        interval = recording.interval_s
        steps: float | Array = interval if isinstance(interval, float) else interval[a:b, None]
        angle = recording.gyro[a:b] * (steps if recording.kind == "rate" else 1.0) - bias * steps
        signed[k] = angle.sum(axis=0)
        absolute[k] = np.abs(angle, out=angle).sum(axis=0)
    force = data.windows.accel_mean
    return RawIntegrals(signed, absolute, force[data.start], force[data.end])


@cache
def nominal_integrals(sequence: RotationSequence) -> tuple[Array, Array, Array, Array]:
    """Integrals of a sequence for a perfect IMU, signed and absolute (rad); unit vector up in B before and after."""
    vectors = sequence.axes * sequence.angles_rad[:, None]
    up = -nominal_attitude(sequence)[2]
    return vectors.sum(axis=0), np.abs(vectors).sum(axis=0), up, nominal_end_attitude(sequence).T @ up


def _bias_per_force(data: PreparedRecording) -> Array:
    """Slope of raw stationary rate over raw specific force, (3, 3), rad/s per m/s²: g-sensitivity, vertical Earth rate.

    Zero if the windows do not determine it. During a rotation it gives the change of the rate offset, because the
    attitudes of the rotation differ from those of its windows.
    """
    force = data.windows.accel_mean
    if len(force) < _MANY_WINDOWS:
        return np.zeros((3, 3))
    design = np.hstack([force / data.gravity, np.ones((len(force), 1))])
    if np.linalg.matrix_rank(design, tol=0.1) < design.shape[1]:
        return np.zeros((3, 3))
    return robust_fit(design, data.windows.gyro_mean)[:3].T / data.gravity


@dataclass(frozen=True, slots=True, eq=False)
class BlockAverages:
    """Raw readings averaged over blocks of about 10 ms, from 0.5 s before each manoeuvre to 0.5 s after it.

    Attributes
    ----------
    sequence : ndarray of int, shape (m,)
        Number of the sequence of each block; sequences with a gap are omitted.
    starts : ndarray of int, shape (K' + 1,)
        Number of the first block of each of the K' sequences, and the number of blocks.
    first_sample : ndarray of int, shape (m,)
        Number of the first sample of each block.
    step_s : float
        Length of a block.
    rate : ndarray, shape (m, 3), rad/s
        Mean rate, less the stationary rate of the sequence's windows and the effect of specific force.
    force : ndarray, shape (m, 3), m/s²
    """

    sequence: Indices
    starts: Indices
    first_sample: Indices
    step_s: float
    rate: Array
    force: Array


def block_averages(data: PreparedRecording, contiguous: Mask) -> BlockAverages | None:
    """Block averages of all manoeuvres without a gap, which are the true ones of a mask; None if there are none."""
    if not contiguous.any():
        return None
    recording, per_force = data.recording, _bias_per_force(data)
    dt, per_rate = recording.nominal_interval_s, rates_factor(recording)
    rest = data.windows.gyro_mean - data.windows.accel_mean @ per_force.T
    size = max(1, round(_STEP_S / dt))
    margin = round(_MARGIN_S / dt)
    sequences = np.flatnonzero(contiguous)
    first: list[Indices] = []
    rate: list[Array] = []
    force: list[Array] = []
    for k in sequences.tolist():
        (low, a), (b, high) = data.windows.samples[[data.start[k], data.end[k]]].tolist()
        begin = max(low, a - margin)
        count = (min(high, b + margin) - begin) // size
        for values, means in ((recording.gyro, rate), (recording.accel, force)):
            mean = values[begin : begin + count * size].reshape(count, size, 3).mean(axis=1)
            means.append(mean * per_rate if per_rate != 1.0 else mean)
        rate[-1] -= force[-1] @ per_force.T + 0.5 * (rest[data.start[k]] + rest[data.end[k]])
        first.append(begin + size * np.arange(count))
    lengths = [len(part) for part in first]
    return BlockAverages(
        np.repeat(sequences, lengths),
        np.concatenate([[0], np.cumsum(lengths)]),
        np.concatenate(first),
        size * dt,
        np.concatenate(rate),
        np.concatenate(force),
    )


def turning_windows(data: PreparedRecording) -> Mask:
    """True for windows in which the unit rotates as in a manoeuvre, shape (W,): their labels are wrong.

    Slower motion has other causes, see :mod:`srt.diagnosis.window_disturbances`. Statistic: half the range of the rates
    of a window over the noise of a block. Distribution: normal, six times as many tests as blocks.
    """
    recording = data.recording
    size = max(1, round(BLOCK_S / recording.nominal_interval_s))
    samples = data.windows.samples
    in_turns, in_windows = np.empty(data.K), np.zeros((len(samples), 3))
    scatter, blocks_in_windows = np.zeros((len(samples), 3)), 0
    for k, (s, e) in enumerate(zip(data.start.tolist(), data.end.tolist(), strict=True)):
        first, last = int(samples[s, 0]), int(samples[e, 1])
        count = (last - first) // size
        blocks = recording.gyro[first : first + count * size].reshape(count, size, 3)
        # The median, so that a spike is not taken for a rotation.
        means = median(np.moveaxis(blocks, 1, 2))
        in_turns[k] = _rate_range(means).max()
        for w in (s, e):
            inside = slice(-(-(int(samples[w, 0]) - first) // size), (int(samples[w, 1]) - first) // size)
            in_windows[w] = _rate_range(means[inside])
            if len(means[inside]):
                rows = means[inside].T
                scatter[w] = MAD * median(np.abs(rows - median(rows)[:, None]))
            blocks_in_windows += len(means[inside])
    # Without rotations (static poses only) the median is noise: the slowest rotation is its lower limit.
    slowest = _SLOWEST_RAD_S / rates_factor(recording)
    slowest = _ROTATING * max(float(np.median(in_turns)), slowest)
    noise = 2.0 * limit("normal", tests=max(1, 6 * blocks_in_windows), shared=_BY_NOISE) * np.median(scatter, axis=0)
    return np.asarray(np.any(in_windows > np.maximum(slowest, noise), axis=1))


def _rate_range(means: Array) -> Array:
    return np.asarray(means.max(axis=0) - means.min(axis=0)) if len(means) else np.zeros(3)


class Rotations(NamedTuple):
    """Rotations of the sequences in which as many rotations are found as their label states.

    A rotation begins where the axis changes, or after a pause. Sequences with a gap are left out.

    Attributes
    ----------
    sequence : ndarray of int, shape (L,)
        Number of the sequence of each rotation.
    nominal, turned : ndarray, shape (L, 3), rad
        Nominal rotation (signed angle times axis), and the raw gyro readings integrated over the rotation.
    """

    sequence: Indices
    nominal: Array
    turned: Array


def find_rotations(data: PreparedRecording | None, path: BlockAverages | None) -> Rotations:
    """Rotations in the block averages."""
    numbers, nominal, turned = [np.zeros(0, dtype=np.intp)], [np.zeros((0, 3))], [np.zeros((0, 3))]
    if data is None or path is None or len(path.rate) == 0:
        return Rotations(numbers[0], nominal[0], turned[0])
    largest = np.abs(path.rate).max(axis=0)
    typical = float(np.median(largest))
    # An axis in a smaller unit, as deg/s, would have the largest reading in rotations about the others.
    unit = np.where(largest > _OTHER_UNIT * typical, largest / max(typical, 1e-300), 1.0)
    for s, e in pairwise(path.starts.tolist()):
        k = int(path.sequence[s])
        sequence = data.catalogue[k]
        if sequence is None:
            continue
        size = np.abs(path.rate[s:e]) / unit
        speed = size.max(axis=1)
        mark = np.where(speed > MOVING * speed.max(), np.argmax(size, axis=1), -1)
        cuts = leg_borders(mark, through_stops=False)[:-1]
        if len(cuts) == len(sequence.rotations):
            numbers.append(np.full(len(cuts), k))
            nominal.append(sequence.axes * sequence.angles_rad[:, None])
            turned.append(np.add.reduceat(path.rate[s:e], cuts, axis=0) * path.step_s)
    return Rotations(np.concatenate(numbers), np.concatenate(nominal), np.concatenate(turned))


def robust_fit(x: Array, y: Array) -> Array:
    """Solve ``y ≈ x @ b`` for least absolute deviations, by iteratively reweighted least squares.

    The solution minimises the sum of the lengths of the residual vectors.

    Parameters
    ----------
    x : ndarray, shape (n, p)
    y : ndarray, shape (n, 3)

    Returns
    -------
    ndarray, shape (p, 3)
    """
    weight = np.ones(len(x))
    floor = 1e-9 * float(np.abs(y).max(initial=1e-300))
    solution: NDArray[np.floating[Any]] = np.zeros((x.shape[1], y.shape[1]))
    for _ in range(_ROUNDS):
        solution = np.asarray(np.linalg.lstsq(x * weight[:, None], y * weight[:, None], rcond=None)[0])
        weight = 1.0 / np.sqrt(np.maximum(np.linalg.norm(y - x @ solution, axis=1), floor))
    return np.asarray(solution, dtype=np.float64)
