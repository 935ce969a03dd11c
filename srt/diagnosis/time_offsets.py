"""Gyro-stabilised specific force, and what it shows: time offset between the sensors, and samples lost in rotations.

The attitude from the gyros transforms the measured specific force to B_Strt, the body frame at the start of the
sequence, in which it should be constant. Its change in the direction in which gravity rotates, divided by gravity, is
the angle between the rotations that gyros and accelerometers measure.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.diagnosis.cause_comparison import Cause, compare
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.rotation_readings import BESIDE, ROUNDING, cross, invert_readings
from srt.model import rotations
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.rotation_readings import BlockAverages
    from srt.diagnosis.triad_fits import RawTriads
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask

_FEWEST_TURNS: Final = 4
"""Fewest rotations for an estimate of the scatter of the offset, and of the accelerometer errors that all share."""
_LEAST_OFFSET: Final = 0.02
"""Smallest offset for a finding, in sampling intervals: the effective time of a reading is not known better."""
_COARSE: Final = 5
"""Number of blocks that are averaged for the estimate of the offset, which is constant during a rotation."""


class StabilisedForce(NamedTuple):
    """Specific force averaged over m blocks of about 10 ms, transformed by the gyros to B_Strt of its sequence."""

    blocks: BlockAverages  # raw readings
    attitude: Array  # attitude at the middle of the block, from the gyros: B to B_Strt, (m, 3, 3)
    rate: Array  # rate in B, less the stationary mean, (m, 3), rad/s
    up: Array  # measured vertical at the start of the block's sequence in B_Strt, (m, 3)
    up_body: Array  # the same in B at the middle of the block, (m, 3)
    force: Array  # specific force in B_Strt, in units of gravity, (m, 3); constant for a perfect IMU


def stabilised_force(data: PreparedRecording, blocks: BlockAverages, triads: RawTriads) -> StabilisedForce:
    """Gyro-stabilised specific force of all rotations."""
    gyro, accel, bias = triads
    rate = invert_readings(gyro, blocks.rate)
    half = rotations.from_rotation_vector(np.ascontiguousarray(0.5 * blocks.step_s * rate.T))
    ends = rotations.prefix_product(rotations.multiply(half, half))
    begins = np.concatenate([[[1.0], [0.0]], ends[:, blocks.starts[1:-1] - 1]], axis=1)
    # One product over all sequences, times the inverse attitude at the start of each one and of half the last step.
    back = np.repeat(rotations.conjugate(begins), np.diff(blocks.starts), axis=1)
    middle = rotations.multiply(rotations.multiply(back, ends), rotations.conjugate(half))
    attitude = np.ascontiguousarray(np.moveaxis(rotations.to_matrix(middle), 2, 0))
    vertical = invert_readings(accel, data.windows.accel_mean[data.start] - bias)
    size = np.linalg.norm(vertical, axis=1, keepdims=True)
    up = np.divide(vertical, size, out=np.zeros_like(vertical), where=size > 0.0)[blocks.sequence]
    force = invert_readings(accel, blocks.force - bias) / data.gravity
    up_body = np.einsum("ma,mab->mb", up, attitude)
    return StabilisedForce(blocks, attitude, rate, up, up_body, np.einsum("mab,mb->ma", attitude, force))


class TimeOffset(NamedTuple):
    """Time offset between the sensors in n rotations, and the accelerometer errors estimated with it."""

    by_turn: Array  # lag of the accelerometers behind the gyros, (n,), s
    axes: Array  # axis of each rotation, unit vectors in B, (n, 3)
    by_accel: Array  # lag that is estimated if only accelerometer x, y or z lags, by one second, (n, 3)
    errors: Array  # accelerometer errors, in the order of :func:`force_effects`, (15,)
    spread: Array  # square root S of their covariance SᵀS, (r, 15)


def time_offset(path: StabilisedForce, effects: Array) -> TimeOffset | None:
    """Time offset between the sensors; None with fewer than four rotations about one horizontal axis.

    The accelerometer errors are common to all rotations. Each rotation has its own offset, initial angle and gyro
    scale-factor error; the scatter of the offsets includes all unmodelled effects. ``effects`` are those of
    :func:`force_effects`.
    """
    turns, first = path.blocks, path.blocks.starts[:-1]
    rate = np.einsum("mab,mb->ma", path.attitude, path.rate)
    total = np.add.reduceat(rate, first) * turns.step_s
    size = np.linalg.norm(total, axis=1)
    axis = total / np.maximum(size, 1e-300)[:, None]
    across = cross(axis, path.up[first])
    level = np.linalg.norm(across, axis=1)
    one_axis = size > 0.9 * np.add.reduceat(np.linalg.norm(rate, axis=1), first) * turns.step_s
    chosen = np.flatnonzero((size > 1.0) & one_axis & (level > 0.9) & (np.diff(turns.starts) >= 2 * _COARSE))
    n = len(chosen)
    if n < _FEWEST_TURNS:
        return None
    # By block: effects of the accelerometer errors on the angle, this angle, and the rate about the axis.
    number = np.repeat(np.arange(len(first)), np.diff(turns.starts))
    sideways = (across / np.maximum(level, 1e-300)[:, None])[number]
    along = np.einsum("ma,mab->bm", sideways, path.attitude)
    values = np.empty((len(effects) + 2, len(number)))
    values[:-2] = np.einsum("eam,am->em", effects, along)
    values[-2:] = [np.einsum("ma,ma->m", *pair) for pair in ((path.force, sideways), (rate, axis[number]))]
    lags, projected = [], []
    for k in chosen.tolist():
        s = int(first[k])
        count = (int(turns.starts[k + 1]) - s) // _COARSE
        *shared, about = values[:, s : s + count * _COARSE].reshape(-1, count, _COARSE).mean(axis=2)
        # Lag by 1 s, initial angle and gyro scale-factor error.
        own = np.stack([about * level[k], np.ones(count), np.cumsum(about)], axis=1)
        # The unknowns of single rotations are projected out, so that the computing time grows only linearly.
        inverse, table = np.linalg.pinv(own), np.array(shared).T
        lags.append(inverse[0] @ table)
        projected.append(table - own @ (inverse @ table))
    by_turn, stacked = np.array(lags), np.asarray(np.linalg.qr(np.concatenate(projected), mode="r"))
    U, sizes, Vt = np.linalg.svd(stacked[:, :-4], full_matrices=False)
    seen = sizes > ROUNDING * sizes[0]
    root = Vt[seen] / sizes[seen, None]
    # Lags of single accelerometers are put through the same estimation: the accelerometer errors absorb a part of them.
    every = root.T @ (U[:, seen].T @ stacked[:, -4:])
    left = stacked[:, -1] - stacked[:, :-4] @ every[:, -1]
    freedom = max(1, sum(map(len, projected)) - 3 * n - int(seen.sum()))
    by_turn = by_turn[:, -4:] - by_turn[:, :-4] @ every
    spread = np.asarray(root * math.sqrt(float(left @ left) / freedom))
    return TimeOffset(by_turn[:, -1], axis[chosen], by_turn[:, :-1], every[:, -1], spread)


def force_effects(path: StabilisedForce) -> Array:
    """Effects of 18 accelerometer errors on the specific force in B, in units of gravity, (18, 3, m).

    The errors are a symmetric matrix (6), bias (3), asymmetry (3), lever arm over gravity (3, in s²), and the lags of
    accelerometers x, y and z (3, in s).
    """
    rate, up, late = (np.ascontiguousarray(x.T) for x in (path.rate, path.up_body, cross(path.rate, path.up_body)))
    change = np.gradient(rate, path.blocks.step_s, axis=1)  # sequences begin and end at rest
    out, square = np.zeros((18, 3, rate.shape[1])), np.sum(rate**2, axis=0)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[[i, 6 + i, 9 + i, 15 + i], i] = up[i], np.ones_like(up[i]), np.abs(up[i]), late[i]
        out[3 + i, [i, j]] = up[[j, i]]
        # Lever arm r: dω/dt × r + ω × (ω × r)
        out[12 + i] = rate * rate[i]
        out[12 + i, [i, j, k]] += -square, change[k], -change[j]
    return out


def _expected(path: StabilisedForce, effects: Array, errors: Array) -> Array:
    """Effect of 18 accelerometer errors on the specific force in B_Strt, in units of gravity, (m, 3)."""
    return np.asarray(np.einsum("mab,bm->ma", path.attitude, np.tensordot(errors, effects, 1)))


def lag(seen: TimeOffset, dt: float) -> list[Explanation] | None:
    """Possible causes of a lag between gyros and rotation of gravity, most likely first; None if there is no lag.

    Statistic: lag of the most likely cause over its standard deviation. Distribution: t, with the degrees of freedom of
    the lags of the rotations.
    """
    n, by_gyro = len(seen.axes), seen.axes**2
    causes = [Cause("", np.zeros((n, 0)), {}), Cause("sensor_time_offset", np.ones((n, 1)), {})]
    for i, axis in enumerate(AXES):
        causes.append(Cause("gyro_axis_delayed", -by_gyro[:, i, None], {"channel": f"gyro_{axis}"}, 3))
        causes.append(Cause("accel_axis_delayed", seen.by_accel[:, i, None], {"channel": f"accel_{axis}"}, 3))
    ranked = compare(seen.by_turn, causes)
    best = next(explanation for explanation in ranked if explanation.cause.fault)
    largest = limit("t", best.freedom, tests=len(causes) - 1, both_sides=True) * float(best.sigma[0])
    return None if abs(float(best.value[0])) <= max(largest, _LEAST_OFFSET * dt) else ranked


class AttitudeStep(NamedTuple):
    """Step of the gyro-stabilised specific force."""

    sequence: int
    sample: int  # first one after the step
    height: float  # angle, rad
    duration_s: float  # time in which the unit rotates by it; negative if the gyros measured too large an angle


def attitude_step(
    path: StabilisedForce, effects: Array, seen: TimeOffset | None, dt: float, void: list[int]
) -> AttitudeStep | None:
    """Largest significant step; None if there is none.

    Statistic: squared height over its variance. Distribution: chi-square, with two components of a height. ``void`` are
    the sequences with clipped readings: clipping causes their missing angle, not lost samples.
    """
    turns, turning = path.blocks, cross(path.rate, path.up_body)
    speed = np.linalg.norm(turning, axis=1)
    left = path.force - path.up
    if seen is not None:
        # Without this correction, a time offset makes a step at the beginning and at the end of a rotation.
        left -= _expected(path, effects, np.append(seen.errors, np.full(3, np.median(seen.by_turn))))
    left -= np.einsum("ma,ma->m", left, path.up)[:, None] * path.up
    steps, whole = _steps(left, turns.starts)
    places = np.flatnonzero((speed > 0.2 * speed.max()) & whole)
    if len(places) == 0:
        return None
    square = np.sum(steps[places] ** 2, axis=1)
    # At most places there is no step: the median square gives the noise. A loss is at least one sample.
    largest, half = limit("chi-square", 2.0, tests=len(square)), 0.5 * speed[places] * dt
    variance = np.full(len(square), float(np.median(square)) / limit("chi-square", 2.0, shared=0.5))
    if seen is not None and np.any(square > np.maximum(largest * variance, half**2)):
        # Few rotations hardly determine the accelerometer errors.
        doubts = (_expected(path, effects, np.append(own, np.zeros(3))) for own in seen.spread)
        variance += sum(np.sum(_steps(doubt, turns.starts)[0][places] ** 2, axis=1) for doubt in doubts)
    excess = square / np.maximum(largest * variance, half**2)
    excess[np.isin(turns.sequence[places], void)] = 0.0
    best = int(np.argmax(excess))
    if excess[best] <= 1.0:
        return None
    block = int(places[best])
    surplus = steps[block] @ path.attitude[block] @ turning[block] > 0.0
    height = math.sqrt(float(square[best]))
    duration_s = (-1.0 if surplus else 1.0) * height / float(speed[block])
    return AttitudeStep(int(turns.sequence[block]), int(turns.first_sample[block]), height, duration_s)


def _steps(values: Array, starts: Indices) -> tuple[Array, Mask]:
    """Height of a step before each block, from a fit of a step and a straight line to the blocks around it, (m, 3).

    The mask, shape (m,), is true where these blocks belong to one sequence.
    """
    lengths = np.diff(starts)
    side = min(BESIDE, int(lengths.min()) // 4)
    steps = np.zeros_like(values)
    if side < 2:
        return steps, np.zeros(len(values), dtype=np.bool_)
    x = np.arange(-side, side) + 0.5
    weight = np.linalg.pinv(np.stack([np.ones(2 * side), x, x > 0.0], axis=1))[2]
    for column in range(3):
        steps[side : len(values) - side + 1, column] = np.convolve(values[:, column], weight[::-1], mode="valid")
    place = np.arange(len(values)) - np.repeat(starts[:-1], lengths)
    return steps, (place >= side) & (place <= np.repeat(lengths, lengths) - side)
