"""Readings during the rotations: integrals, averages over blocks, and the measured angles of single rotations."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.false_alarms import limit, robust_sigma
from srt.sequences.manoeuvres import MOVING, leg_borders
from srt.sequences.rest_detection import BLOCK_S

if TYPE_CHECKING:
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask

_STEP_S: Final = 0.01
"""Length of a block of samples, s: at 1 rad/s the unit rotates by 10 mrad per block."""
_MARGIN_S: Final = 0.5
"""Stationary time used before and after a rotation, s."""
_ROUNDS: Final = 12
"""Number of reweightings of a robust fit."""
ROTATING: Final = 0.05
"""Smallest rate in a window, relative to that of the rotations, at which the unit is not at rest: bumps and creep are
slower."""
RANK: Final = 0.1
"""Smallest singular value of unit vectors, relative to the square root of their number, at which they determine a
matrix: below it they lie within 6° of a plane; and smallest over largest singular value of the matrix of a triad."""
BESIDE: Final = 20
"""Number of samples or blocks on each side of a place with which its readings are compared."""
ROUNDING: Final = 1e-9
"""Largest rounding of readings, relative to the largest reading: a unit conversion makes 1e-16, a file 1e-10."""
AGREE: Final = 0.5
"""Largest relative difference between a rotation by gyros and by accelerometers, due to scale-factor errors and coarse
blocks. Lost samples and asymmetric scale factors make a difference of the whole error."""
SLOWEST_RAD_S: Final = 0.05
"""Slowest rotation of a manoeuvre, rad/s: 180° in a minute."""


def cross(a: Array, b: Array) -> Array:
    """Cross product along the last axis; shapes broadcast. For few vectors, ``numpy.cross`` takes ten times as long."""
    ahead, behind = [1, 2, 0], [2, 0, 1]
    return np.asarray(a[..., ahead] * b[..., behind] - a[..., behind] * b[..., ahead])


def invert_readings(matrix: Array, readings: Array) -> Array:
    """Values whose readings are ``matrix @ value``; readings and values have shape (n, 3)."""
    return np.asarray(readings @ np.linalg.inv(matrix).T)


class RawIntegrals(NamedTuple):
    """Raw gyro readings of each of K sequences, less the mean of both windows, integrated over the rotation."""

    signed: Array  # integrals, (K, 3), rad
    absolute: Array  # integrals of the absolute values, (K, 3), rad
    speed: Array  # mean rate, zero without a rotation, (K,), rad/s


def raw_integrals(data: PreparedRecording) -> RawIntegrals:
    """Integrals of all sequences."""
    recording, rest = data.recording, data.windows.gyro_mean
    interval, bias = recording.interval_s, 0.5 * (rest[data.start] + rest[data.end])
    signed, absolute = np.empty((2, data.K, 3))
    for k, (a, b) in enumerate(data.rotation.tolist()):
        steps: float | Array = interval if isinstance(interval, float) else interval[a:b, None]
        angle = recording.gyro[a:b] * (steps if recording.kind == "rate" else 1.0) - bias[k] * steps
        signed[k] = angle.sum(axis=0)
        absolute[k] = np.abs(angle, out=angle).sum(axis=0)
    duration = np.maximum(np.diff(data.rotation, axis=1)[:, 0], 1) * recording.nominal_interval_s
    return RawIntegrals(signed, absolute, absolute.sum(axis=1) / duration)


def _bias_per_force(data: PreparedRecording) -> Array:
    """Slope of raw stationary rate over raw specific force, (3, 3), rad/s per m/s²: g-sensitivity, vertical Earth rate.

    It gives the change of the rate offset during a rotation. Zero if the windows do not determine it.
    """
    force = data.windows.accel_mean
    design = np.hstack([force / data.gravity, np.ones((len(force), 1))])
    if len(force) < 3 * design.shape[1] or np.linalg.matrix_rank(design, tol=RANK) < design.shape[1]:
        return np.zeros((3, 3))
    return robust_fit(design, data.windows.gyro_mean)[:3].T / data.gravity


class BlockAverages(NamedTuple):
    """Raw readings averaged over m blocks of about 10 ms, from 0.5 s before each manoeuvre to 0.5 s after it."""

    sequence: Indices  # number of the sequence of each block, (m,); sequences with a gap are omitted
    starts: Indices  # number of the first block of each of K' sequences, and the number of blocks, (K' + 1,)
    first_sample: Indices  # number of the first sample of each block, (m,)
    step_s: float  # length of a block
    rate: Array  # mean rate less stationary rate of the windows and effect of specific force, (m, 3), rad/s
    force: Array  # (m, 3), m/s²


def block_averages(data: PreparedRecording, contiguous: Mask) -> BlockAverages | None:
    """Block averages of all manoeuvres without a gap, which are the true ones of a mask; None if there are none."""
    if not contiguous.any():
        return None
    recording, per_force = data.recording, _bias_per_force(data)
    dt, per_rate = recording.nominal_interval_s, recording.rates_factor
    rest = data.windows.gyro_mean - data.windows.accel_mean @ per_force.T
    size, margin, sequences = max(1, round(_STEP_S / dt)), round(_MARGIN_S / dt), np.flatnonzero(contiguous)
    first, means = [], []
    for k in sequences.tolist():
        (low, a), (b, high) = data.windows.samples[[data.start[k], data.end[k]]].tolist()
        begin = max(low, a - margin)
        count = (min(high, b + margin) - begin) // size
        part = slice(begin, begin + count * size)
        rate, force = (
            table[part].reshape(count, size, 3).mean(axis=1) * per_rate for table in (recording.gyro, recording.accel)
        )
        rate -= force @ per_force.T + 0.5 * (rest[data.start[k]] + rest[data.end[k]])
        first.append(begin + size * np.arange(count))
        means.append(np.stack([rate, force]))
    lengths = [len(part) for part in first]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    sequence, sample = np.repeat(sequences, lengths), np.concatenate(first)
    return BlockAverages(sequence, starts, sample, size * dt, *np.concatenate(means, axis=1))


def turning_windows(data: PreparedRecording, columns: Array, seen: RawIntegrals) -> Mask:
    """True for windows in which the unit rotates as in a manoeuvre, shape (W,): their labels are wrong.

    Slower motion has other causes, see :mod:`srt.diagnosis.window_disturbances`. Statistic: half the range of the rates
    of a window over the noise of a block. Distribution: normal, six times as many tests as blocks. ``columns`` are the
    stored values of all channels, shape (6, N).
    """
    recording, samples = data.recording, data.windows.samples
    size, factor = max(1, round(BLOCK_S / recording.nominal_interval_s)), recording.rates_factor
    # Without rotations (static poses only), the slowest rotation is the lower limit.
    slowest = 2.0 * ROTATING * max(float(np.median(seen.speed)), SLOWEST_RAD_S)
    span, scatter = np.zeros((2, len(samples), 3))
    if not any(np.ptp(columns[:3, a:b], axis=1).max() * factor > slowest for a, b in samples.tolist()):
        return np.zeros(len(samples), dtype=np.bool_)
    for w, (a, b) in enumerate(samples.tolist()):
        count = (b - a) // size
        if count:
            blocks = recording.gyro[a : a + count * size].reshape(count, size, 3)
            # The median, so that a spike is not taken for a rotation.
            means = np.median(blocks, axis=1) * factor
            span[w] = np.ptp(means, axis=0)
            scatter[w] = robust_sigma(means - np.median(means, axis=0), axis=0)
    tests = max(1, 6 * int(np.sum((samples[:, 1] - samples[:, 0]) // size)))
    noise = 2.0 * limit("normal", tests=tests) * np.median(scatter, axis=0)
    return np.asarray(np.any(span > np.maximum(slowest, noise), axis=1))


class Rotations(NamedTuple):
    """L rotations of the sequences in which as many rotations are found as their label states.

    A rotation begins where the axis changes, or after a pause. Sequences with a gap are left out.
    """

    sequence: Indices  # number of the sequence of each rotation, (L,)
    nominal: Array  # signed angle times axis, (L, 3), rad
    turned: Array  # raw gyro readings integrated over the rotation, (L, 3), rad


def find_rotations(data: PreparedRecording | None, path: BlockAverages | None) -> Rotations:
    """Rotations in the block averages."""
    found = [Rotations(np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 3)))]
    if data is not None and path is not None:
        size = np.abs(path.rate)
        speed, axis = size.max(axis=1), np.argmax(size, axis=1)
        for s, e in pairwise(path.starts.tolist()):
            sequence = data.catalogue[path.sequence[s]] if s < e else None
            if sequence is None:  # unknown, or shorter than a block
                continue
            mark = np.where(speed[s:e] > MOVING * speed[s:e].max(), axis[s:e], -1)
            cuts = leg_borders(mark, through_stops=False)[:-1]
            if len(cuts) == len(sequence.rotations):
                turned = np.add.reduceat(path.rate[s:e], cuts, axis=0) * path.step_s
                found.append(Rotations(path.sequence[s + cuts], sequence.axes * sequence.angles_rad[:, None], turned))
    return Rotations(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def robust_fit(x: Array, y: Array) -> Array:
    """Solution b (p, 3) of ``y ≈ x @ b`` for x (n, p) and y (n, 3), with the least sum of lengths of the residuals."""
    weight = np.ones(len(x))
    floor = 1e-9 * float(np.abs(y).max(initial=1e-300))
    solution: Array = np.zeros((x.shape[1], y.shape[1]))
    for _ in range(_ROUNDS):
        solution = np.asarray(np.linalg.lstsq(x * weight[:, None], y * weight[:, None], rcond=None)[0])
        weight = 1.0 / np.sqrt(np.maximum(np.linalg.norm(y - x @ solution, axis=1), floor))
    return solution
