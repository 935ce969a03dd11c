"""Synchronisation of gyros and accelerometers: time offset between the sensors, and samples lost in rotations.

The attitude from the gyros transforms the measured specific force to B_Strt, the body frame at the start of the
sequence, in which it should be constant. Its change in the direction in which gravity rotates, divided by gravity, is
the angle between the rotations that gyros and accelerometers measure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.cause_comparison import Cause, compare
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.rotation_readings import cross
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.rotation_readings import BlockAverages
    from srt.diagnosis.stabilised_force import StabilisedForce
    from srt.types import Array, Indices, Mask


_FEWEST_TURNS: Final = 4
"""Fewest rotations for an estimate of the scatter of the offset."""
_LEAST_OFFSET: Final = 0.02
"""Smallest offset for a finding, in sampling intervals: the effective time of a reading is not known better."""
_OBSERVED: Final = 1e-9
"""Smallest relative singular value of an observable combination of accelerometer errors; far above rounding."""
_SURE: Final = 5.0
"""Smallest step, in units of its sigma due to the accelerometer errors, which few rotations hardly determine."""
_COARSE: Final = 5
"""Number of blocks that are averaged for the estimate of the offset, which is constant during a rotation."""
_MOVING: Final = 0.2
"""Smallest rate of a block in a rotation, relative to the highest rate."""
_SIDE: Final = 20
"""Number of blocks used on each side of a step."""
_HALF_A_SAMPLE: Final = 0.5
"""Smallest angle of a step, in angles of rotation per sample: a loss is at least one sample."""
_RAYLEIGH_MEDIAN: Final = 1.1774
"""Median of the Rayleigh distribution in sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class TimeOffset:
    """Time offset between the sensors, and the accelerometer errors estimated with it.

    Attributes
    ----------
    late_s, sigma_s : float
        Mean lag of the accelerometers behind the gyros over the rotations, and its standard deviation.
    typical_s : float
        Median lag, which a single rotation with lost samples does not affect.
    by_turn : ndarray, shape (n,), s
        Lag in each rotation used.
    axes : ndarray, shape (n, 3)
        Axis of each rotation, unit vectors in B.
    by_accel : ndarray, shape (n, 3)
        Lag estimated in each rotation if only accelerometer x, y or z lags, by one second.
    errors : ndarray, shape (15,)
        Accelerometer errors, in the order of the columns of :func:`_error_columns`.
    spread : ndarray, shape (r, 15)
        Square root S of the covariance SᵀS of these errors.
    """

    late_s: float
    sigma_s: float
    typical_s: float
    by_turn: Array
    axes: Array
    by_accel: Array
    errors: Array
    spread: Array


def time_offset(path: StabilisedForce, turns: BlockAverages) -> TimeOffset | None:
    """Time offset between the sensors; None with fewer than four suitable rotations."""
    chosen = [
        equations
        for s, e in pairwise(turns.starts.tolist())
        if (equations := _equations(path, turns, s, e)) is not None
    ]
    n = len(chosen)
    if n < _FEWEST_TURNS:
        return None
    # The accelerometer errors are common to all rotations. Each rotation has its own offset, initial angle and gyro
    # scale-factor error; the scatter of the offsets includes all unmodelled effects. The unknowns of single rotations
    # are projected out, so that the computing time grows only linearly with the number of rotations.
    projected = []
    for columns, angles, _ in chosen:
        own, _ = np.linalg.qr(columns[:, :3])
        rest = np.concatenate([columns[:, 3:], angles], axis=1)
        projected.append(rest - own @ (own.T @ rest))
    stacked = np.concatenate(projected)
    seen, wanted = stacked[:, :-4], stacked[:, -4:]
    # Lags of single accelerometers are put through the same estimation: the accelerometer errors absorb a part of them.
    every, spread = _solution(seen, wanted, freedom=len(stacked) - 3 * n)
    lags = np.array(
        [
            np.linalg.lstsq(columns[:, :3], angles - columns[:, 3:] @ every, rcond=_OBSERVED)[0][0]
            for columns, angles, _ in chosen
        ]
    )
    late, axes = lags[:, 0], np.array([axis for _, _, axis in chosen])
    sigma = float(late.std(ddof=1)) / math.sqrt(n)
    return TimeOffset(float(late.mean()), sigma, float(np.median(late)), late, axes, lags[:, 1:], every[:, 0], spread)


def _solution(columns: Array, values: Array, *, freedom: int) -> tuple[Array, Array]:
    """Least-squares solutions of smallest norm, and the root of the covariance of the first, from its residuals."""
    U, size, Vt = np.linalg.svd(columns, full_matrices=False)
    seen = size > _OBSERVED * size[0]
    root = Vt[seen] / size[seen, None]
    solution = root.T @ (U[:, seen].T @ values)
    left = values[:, 0] - columns @ solution[:, 0]
    return np.asarray(solution), np.asarray(root * math.sqrt(float(left @ left) / max(1, freedom - int(seen.sum()))))


def _equations(path: StabilisedForce, turns: BlockAverages, s: int, e: int) -> tuple[Array, Array, Array] | None:
    """Linear equations of a sequence with one rotation about a horizontal axis; None for any other sequence.

    Returns
    -------
    columns : ndarray, shape (n, 18)
        Columns of offset, initial angle, gyro scale-factor error, and the 15 accelerometer errors.
    angles : ndarray, shape (n, 4)
        Measured angle, and the angle if only accelerometer x, y or z lags by 1 s.
    axis : ndarray, shape (3,)
        Rotation axis, unit vector in B.
    """
    if e - s < 2 * _COARSE:
        return None
    rate = np.einsum("mab,mb->ma", path.attitude[s:e], path.rate[s:e])
    total = rate.sum(axis=0) * turns.step_s
    size = float(np.linalg.norm(total))
    if size < 1.0 or size < 0.9 * float(np.linalg.norm(rate, axis=1).sum()) * turns.step_s:
        return None
    across = cross(total / size, path.up[s])
    horizontal = float(np.linalg.norm(across))
    if horizontal < 0.9:
        return None
    across /= horizontal
    about = rate @ (total / size)
    own = np.stack([about * horizontal, np.ones(e - s), np.cumsum(about) * turns.step_s], axis=1)
    along = across @ path.attitude[s:e]
    seen = _error_columns(along, path.up_body[s:e], path.rate[s:e], turns.step_s)
    columns = np.concatenate([own, seen], axis=1)
    late = along * cross(path.rate[s:e], path.up_body[s:e])
    angles = np.column_stack([path.force_start[s:e] @ across, late])
    return _coarser(columns), _coarser(angles), np.asarray(total / size)


def _error_columns(along: Array, up: Array, rate: Array, step_s: float) -> Array:
    """Effect of accelerometer errors on the specific force in a direction in B, in units of gravity; shape (n, 15).

    The columns are for a symmetric matrix (6), bias (3), asymmetry (3), and lever arm of the accelerometers over
    gravity (3, in s²). A rotation of the whole triad needs no columns: it only changes the initial angle.
    """
    change = np.gradient(rate, step_s, axis=0)
    ahead = [1, 2, 0]
    mixed = along * up[:, ahead] + along[:, ahead] * up
    lever = cross(along, change) + cross(rate, cross(rate, along))
    return np.concatenate([along * up, mixed, along, along * np.abs(up), lever], axis=1)


def _expected(path: StabilisedForce, turns: BlockAverages, errors: Array, late_s: float) -> Array:
    """Effect of accelerometer errors and a time offset on the specific force in B, in units of gravity, (m, 3)."""
    e, up, rate = errors, path.up_body, path.rate
    symmetric = np.array([[e[0], e[3], e[5]], [e[3], e[1], e[4]], [e[5], e[4], e[2]]])
    change = np.gradient(rate, turns.step_s, axis=0)  # sequences begin and end at rest
    out = late_s * cross(rate, up) + up @ symmetric + e[6:9] + e[9:12] * np.abs(up)
    return np.asarray(out + cross(change, e[12:]) + cross(rate, cross(rate, e[12:])))


def _coarser(values: Array) -> Array:
    n = len(values) // _COARSE
    return np.asarray(values[: n * _COARSE].reshape(n, _COARSE, *values.shape[1:]).mean(axis=1))


def _lag_causes(seen: TimeOffset) -> list[Cause]:
    """Possible causes of a lag, each with the lag in each rotation that it predicts if its channels lag by 1 s.

    A rotation about one axis is measured only by the gyro of that axis.
    """
    n, by_gyro = len(seen.axes), seen.axes**2
    causes = [Cause("", np.zeros((n, 0)), {}), Cause("sensor_time_offset", np.ones((n, 1)), {})]
    for i, axis in enumerate(AXES):
        causes.append(Cause("gyro_axis_delayed", -by_gyro[:, i, None], {"channel": f"gyro_{axis}"}, 3))
        causes.append(Cause("accel_axis_delayed", seen.by_accel[:, i, None], {"channel": f"accel_{axis}"}, 3))
    return causes


def lag(seen: TimeOffset, dt: float) -> list[Explanation] | None:
    """Possible causes of a lag between gyros and rotation of gravity, most likely first; None if there is no lag.

    Statistic: lag of the most likely cause over its standard deviation. Distribution: t, with the degrees of freedom of
    the lags of the rotations.
    """
    causes = _lag_causes(seen)
    ranked = compare(seen.by_turn, causes)
    best = next(explanation for explanation in ranked if explanation.cause.fault)
    largest = limit("t", best.freedom, tests=len(causes) - 1, both_sides=True) * float(best.sigma[0])
    return None if abs(float(best.value[0])) <= max(largest, _LEAST_OFFSET * dt) else ranked


@dataclass(frozen=True, slots=True)
class AttitudeStep:
    """Step of the gyro-stabilised specific force during a rotation.

    Attributes
    ----------
    block : int
        Block of :func:`block_averages` before which the attitude error changes.
    height : float
        Angle of the step, rad.
    duration_s : float
        Time in which the unit rotates by this angle; negative if the gyros measured too large an angle.
    """

    block: int
    height: float
    duration_s: float


def attitude_step(
    path: StabilisedForce, turns: BlockAverages, seen: TimeOffset | None, dt: float, void: list[int]
) -> AttitudeStep | None:
    """Largest significant step; None if there is none.

    Statistic: height over its standard deviation. Distribution: Rayleigh, as a height has two components. ``void`` are
    the sequences with clipped readings: clipping causes their missing angle, not lost samples.
    """
    turning = cross(path.rate, path.up_body)
    speed = np.linalg.norm(turning, axis=1)
    moving = speed > _MOVING * speed.max()
    left = path.force_start - path.up
    if seen is not None:
        # Without this correction, a time offset makes a step at the beginning and at the end of a rotation.
        left -= _levelled(path, _expected(path, turns, seen.errors, seen.typical_s))
    left -= np.einsum("ma,ma->m", left, path.up)[:, None] * path.up
    steps, whole = _steps(left, turns.starts)
    places = np.flatnonzero(moving & whole)
    height = np.linalg.norm(steps[places], axis=1)
    if len(height) == 0:
        return None
    # At most places there is no step: the median height gives the noise.
    scale = float(np.median(height)) / _RAYLEIGH_MEDIAN
    least = limit("Rayleigh", tests=len(height)) * scale
    excess = height / np.maximum(least, _HALF_A_SAMPLE * speed[places] * dt)
    if excess.max() > 1.0 and seen is not None:
        excess = height / np.hypot(height / excess, _SURE * _step_doubt(path, turns, seen)[places])
    if excess.max() > 1.0:
        excess[np.isin(turns.sequence[places], void)] = 0.0
    best = int(np.argmax(excess))
    block = int(places[best])
    if excess[best] <= 1.0:
        return None
    surplus = float(steps[block] @ _levelled(path, turning)[block]) > 0.0
    size = float(height[best] / speed[block])
    return AttitudeStep(block, float(height[best]), -size if surplus else size)


def _levelled(path: StabilisedForce, in_body: Array) -> Array:
    """Changes of the specific force in B, transformed to B_Strt of the sequence, shape (m, 3)."""
    return np.asarray(np.einsum("mab,mb->ma", path.attitude, in_body))


def _step_doubt(path: StabilisedForce, turns: BlockAverages, seen: TimeOffset) -> Array:
    """Standard deviation of the height of a step before each block due to the accelerometer errors, shape (m,)."""
    steps = (_steps(_levelled(path, _expected(path, turns, errors, 0.0)), turns.starts)[0] for errors in seen.spread)
    return np.asarray(np.sqrt(sum(np.einsum("ma,ma->m", step, step) for step in steps)))


def _steps(values: Array, starts: Indices) -> tuple[Array, Mask]:
    """Height of a step before each block, from a fit of a step and a straight line to the blocks around it, (m, 3).

    The mask, shape (m,), is true where these blocks belong to one sequence.
    """
    shortest = int(np.diff(starts).min())
    side = min(_SIDE, shortest // 4)
    if side < 2:
        return np.zeros_like(values), np.zeros(len(values), dtype=np.bool_)
    x = np.arange(-side, side) + 0.5
    weight = np.linalg.pinv(np.stack([np.ones(2 * side), x, x > 0.0], axis=1))[2]
    steps = np.zeros_like(values)
    for column in range(3):
        steps[side : len(values) - side + 1, column] = np.convolve(values[:, column], weight[::-1], mode="valid")
    place = np.arange(len(values)) - np.repeat(starts[:-1], np.diff(starts))
    whole = (place >= side) & (place <= np.repeat(np.diff(starts), np.diff(starts)) - side)
    return steps, whole
