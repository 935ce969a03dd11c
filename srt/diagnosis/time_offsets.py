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
from srt.diagnosis.rotation_readings import ROUNDING, cross, invert_readings
from srt.model import rotations
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.rotation_readings import BlockAverages
    from srt.diagnosis.triad_fits import RawTriads
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask

_FEWEST_TURNS: Final = 4
"""Fewest rotations for an estimate of the scatter of the offset."""
_LEAST_OFFSET: Final = 0.02
"""Smallest offset for a finding, in sampling intervals: the effective time of a reading is not known better."""
_COARSE: Final = 5
"""Number of blocks that are averaged for the estimate of the offset, which is constant during a rotation."""
_SIDE: Final = 20
"""Number of blocks used on each side of a step."""


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
    errors: Array  # accelerometer errors, in the order of :func:`_columns`, (15,)
    spread: Array  # square root S of their covariance SᵀS, (r, 15)


def time_offset(path: StabilisedForce) -> TimeOffset | None:
    """Time offset between the sensors; None with fewer than four rotations about one horizontal axis.

    The accelerometer errors are common to all rotations. Each rotation has its own offset, initial angle and gyro
    scale-factor error; the scatter of the offsets includes all unmodelled effects.
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
    step_s = _COARSE * turns.step_s
    own, shared, projected = [], [], []
    for k in chosen.tolist():
        s = int(first[k])
        count = (int(turns.starts[k + 1]) - s) // _COARSE
        blocks, middle = slice(s, s + count * _COARSE), slice(s + _COARSE // 2, s + count * _COARSE, _COARSE)
        about, angle = (
            x[blocks].reshape(count, _COARSE, 3).mean(axis=1) @ direction
            for x, direction in ((rate, axis[k]), (path.force, across[k] / level[k]))
        )
        along = across[k] / level[k] @ path.attitude[middle]
        late = along * cross(path.rate[middle], path.up_body[middle])
        # Lag by 1 s, initial angle and gyro scale-factor error; accelerometer errors, the measured angle, and the angle
        # if only accelerometer x, y or z lags by 1 s.
        own.append(np.stack([about * level[k], np.ones(count), np.cumsum(about) * step_s], axis=1))
        shared.append(np.column_stack([_columns(along, path.rate[middle], path.up_body[middle], step_s), angle, late]))
        # The unknowns of single rotations are projected out, so that the computing time grows only linearly.
        Q, _ = np.linalg.qr(own[-1])
        projected.append(shared[-1] - Q @ (Q.T @ shared[-1]))
    stacked = np.concatenate(projected)
    U, sizes, Vt = np.linalg.svd(stacked[:, :-4], full_matrices=False)
    seen = sizes > ROUNDING * sizes[0]
    root = Vt[seen] / sizes[seen, None]
    # Lags of single accelerometers are put through the same estimation: the accelerometer errors absorb a part of them.
    every = root.T @ (U[:, seen].T @ stacked[:, -4:])
    left = stacked[:, -4] - stacked[:, :-4] @ every[:, 0]
    freedom = max(1, len(stacked) - 3 * n - int(seen.sum()))
    rest = [common[:, -4:] - common[:, :-4] @ every for common in shared]
    lags = np.array([(np.linalg.pinv(mine) @ angles)[0] for mine, angles in zip(own, rest, strict=True)])
    spread = np.asarray(root * math.sqrt(float(left @ left) / freedom))
    return TimeOffset(lags[:, 0], axis[chosen], lags[:, 1:], every[:, 0], spread)


def _columns(along: Array, rate: Array, up: Array, step_s: float) -> Array:
    """Effect of 15 accelerometer errors on the specific force along directions in B, in units of gravity, (n, 15).

    The errors are a symmetric matrix (6), bias (3), asymmetry (3), and lever arm over gravity (3, in s²).
    """
    ahead = [1, 2, 0]
    mixed = along * up[:, ahead] + along[:, ahead] * up
    lever = cross(along, np.gradient(rate, step_s, axis=0)) + cross(rate, cross(rate, along))
    return np.concatenate([along * up, mixed, along, along * np.abs(up), lever], axis=1)


def _expected(path: StabilisedForce, errors: Array, late_s: float) -> Array:
    """Effect of accelerometer errors and a time offset on the specific force in B_Strt, in units of gravity, (m, 3)."""
    e, lever, up, rate = errors, errors[12:], path.up_body, path.rate
    symmetric = np.array([[e[0], e[3], e[5]], [e[3], e[1], e[4]], [e[5], e[4], e[2]]])
    change = np.gradient(rate, path.blocks.step_s, axis=0)  # sequences begin and end at rest
    out = late_s * cross(rate, up) + up @ symmetric + e[6:9] + e[9:12] * np.abs(up)
    out = out + cross(change, lever) + cross(rate, cross(rate, lever))
    return np.asarray(np.einsum("mab,mb->ma", path.attitude, out))


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


def attitude_step(path: StabilisedForce, seen: TimeOffset | None, dt: float, void: list[int]) -> AttitudeStep | None:
    """Largest significant step; None if there is none.

    Statistic: height over its standard deviation. Distribution: Rayleigh, as a height has two components. ``void`` are
    the sequences with clipped readings: clipping causes their missing angle, not lost samples.
    """
    turns, turning = path.blocks, cross(path.rate, path.up_body)
    speed = np.linalg.norm(turning, axis=1)
    left = path.force - path.up
    if seen is not None:
        # Without this correction, a time offset makes a step at the beginning and at the end of a rotation.
        left -= _expected(path, seen.errors, float(np.median(seen.by_turn)))
    left -= np.einsum("ma,ma->m", left, path.up)[:, None] * path.up
    steps, whole = _steps(left, turns.starts)
    places = np.flatnonzero((speed > 0.2 * speed.max()) & whole)
    if len(places) == 0:
        return None
    height = np.linalg.norm(steps[places], axis=1)
    # At most places there is no step: the median height gives the noise. A loss is at least one sample.
    largest, half = limit("Rayleigh", tests=len(height)), 0.5 * speed[places] * dt
    variance = np.full(len(height), (float(np.median(height)) / limit("Rayleigh", shared=0.5)) ** 2)
    if seen is not None and np.any(height > np.maximum(largest * np.sqrt(variance), half)):
        # Few rotations hardly determine the accelerometer errors.
        doubts = (_steps(_expected(path, own, 0.0), turns.starts)[0][places] for own in seen.spread)
        variance += sum(np.einsum("ma,ma->m", step, step) for step in doubts)
    excess = height / np.maximum(largest * np.sqrt(variance), half)
    excess[np.isin(turns.sequence[places], void)] = 0.0
    best = int(np.argmax(excess))
    if excess[best] <= 1.0:
        return None
    block = int(places[best])
    surplus = steps[block] @ path.attitude[block] @ turning[block] > 0.0
    duration_s = (-1.0 if surplus else 1.0) * float(height[best] / speed[block])
    return AttitudeStep(int(turns.sequence[block]), int(turns.first_sample[block]), float(height[best]), duration_s)


def _steps(values: Array, starts: Indices) -> tuple[Array, Mask]:
    """Height of a step before each block, from a fit of a step and a straight line to the blocks around it, (m, 3).

    The mask, shape (m,), is true where these blocks belong to one sequence.
    """
    lengths = np.diff(starts)
    side = min(_SIDE, int(lengths.min()) // 4)
    steps = np.zeros_like(values)
    if side < 2:
        return steps, np.zeros(len(values), dtype=np.bool_)
    x = np.arange(-side, side) + 0.5
    weight = np.linalg.pinv(np.stack([np.ones(2 * side), x, x > 0.0], axis=1))[2]
    for column in range(3):
        steps[side : len(values) - side + 1, column] = np.convolve(values[:, column], weight[::-1], mode="valid")
    place = np.arange(len(values)) - np.repeat(starts[:-1], lengths)
    return steps, (place >= side) & (place <= np.repeat(lengths, lengths) - side)
