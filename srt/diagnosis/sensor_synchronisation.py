"""Synchronisation of gyros and accelerometers: time offset between the sensors, and samples lost in rotation.

The gyros transform the measured specific force to the frame at the start of each sequence, where it should be constant.
Its deviation along the direction in which gravity rotates is an angle by which gyros and accelerometers disagree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import stdtrit

from srt.diagnosis.cause_comparison import Cause, compare, with_runner_up
from srt.diagnosis.clipping import clipped_parts
from srt.diagnosis.findings import FALSE_ALARM, check, finding
from srt.diagnosis.rotation_readings import BlockAverages, block_averages, computed_once, cross
from srt.diagnosis.stabilised_force import StabilisedForce, stabilised_force
from srt.model.table1 import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices, Mask


_FEWEST_TURNS: Final = 4
"""Rotations, fewer of which do not tell the scatter of the offset."""
_LEAST_OFFSET: Final = 0.02
"""Smallest offset in sampling intervals: the effective time of a reading is not known better."""
_OBSERVED: Final = 1e-9
"""Relative singular value from which a combination of accelerometer errors is observed; far above rounding."""
_SURE: Final = 5.0
"""Sigmas of the accelerometer errors that a step must exceed, where a few rotations hardly determine them."""
_COARSE: Final = 5
"""Blocks averaged for the offset, which is constant over a rotation."""
_MOVING: Final = 0.2
"""Share of the highest rate above which a block belongs to a rotation."""
_SIDE: Final = 20
"""Blocks used on each side of a step."""
_HALF_A_SAMPLE: Final = 0.5
"""Smallest step in angles of one sample: at least one sample is lost."""
_WHOLE: Final = 0.25
"""Distance of a step from the angle of a whole number of samples, relative to it, that noise explains."""
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
        Median lag, which a rotation with lost samples does not affect.
    by_turn : ndarray, shape (n,), s
        Lag of each rotation used.
    axes : ndarray, shape (n, 3)
        Its axis, unit vectors in B.
    by_accel : ndarray, shape (n, 3)
        Lag that it would show for an accelerometer of x, y or z that lags by one second.
    errors : ndarray, shape (15,)
        Accelerometer errors, columns of :func:`_error_columns`.
    spread : ndarray, shape (r, 15)
        Root S of the covariance of these errors, SᵀS.
    """

    late_s: float
    sigma_s: float
    typical_s: float
    by_turn: Array
    axes: Array
    by_accel: Array
    errors: Array
    spread: Array


@computed_once
def time_offset(evidence: Evidence) -> TimeOffset | None:
    """Time offset between the sensors; None with fewer than four suitable rotations."""
    path, turns = stabilised_force(evidence), block_averages(evidence)
    if path is None or turns is None:
        return None
    chosen = [
        equations
        for s, e in pairwise(turns.starts.tolist())
        if (equations := _equations(path, turns, s, e)) is not None
    ]
    n = len(chosen)
    if n < _FEWEST_TURNS:
        return None
    # The accelerometer errors are common. Each rotation has its own offset, initial angle and gyro scale error; their
    # scatter over the rotations contains all that is not modelled. The unknowns of single rotations are projected out,
    # so the cost grows only linearly.
    projected = []
    for columns, angles, _ in chosen:
        own, _ = np.linalg.qr(columns[:, :3])
        rest = np.concatenate([columns[:, 3:], angles], axis=1)
        projected.append(rest - own @ (own.T @ rest))
    stacked = np.concatenate(projected)
    seen, wanted = stacked[:, :-4], stacked[:, -4:]
    common, spread = _solution(seen, wanted[:, 0], freedom=len(stacked) - 3 * n)
    # Lags of single accelerometers pass through the same estimate: errors take over a part of them.
    every = np.column_stack([common, np.linalg.lstsq(seen, wanted[:, 1:], rcond=_OBSERVED)[0]])
    lags = np.array(
        [
            np.linalg.lstsq(columns[:, :3], angles - columns[:, 3:] @ every, rcond=_OBSERVED)[0][0]
            for columns, angles, _ in chosen
        ]
    )
    late, axes = lags[:, 0], np.array([axis for _, _, axis in chosen])
    sigma = float(late.std(ddof=1)) / math.sqrt(n)
    return TimeOffset(float(late.mean()), sigma, float(np.median(late)), late, axes, lags[:, 1:], common, spread)


def _solution(columns: Array, values: Array, *, freedom: int) -> tuple[Array, Array]:
    """Least squares of smallest norm, and the root of its covariance with the scatter of the residuals."""
    U, size, Vt = np.linalg.svd(columns, full_matrices=False)
    seen = size > _OBSERVED * size[0]
    root = Vt[seen] / size[seen, None]
    solution = (U[:, seen].T @ values) @ root
    left = values - columns @ solution
    return np.asarray(solution), np.asarray(root * math.sqrt(float(left @ left) / max(1, freedom - int(seen.sum()))))


def _equations(path: StabilisedForce, turns: BlockAverages, s: int, e: int) -> tuple[Array, Array, Array] | None:
    """Equations of a sequence with one rotation about a horizontal axis.

    Columns (offset, start, scale, errors); the angle, and those for each accelerometer late by 1 s; axis in B. None for
    any other sequence.
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
    """Change of the specific force along a direction in B by accelerometer errors, over gravity; shape (n, 15).

    Symmetric matrix (6), bias (3), asymmetry (3), and lever arm of the accelerometers (3), in s². A rotation of the
    whole triad adds a constant to the angle, which is the initial angle.
    """
    change = np.gradient(rate, step_s, axis=0)
    ahead = [1, 2, 0]
    mixed = along * up[:, ahead] + along[:, ahead] * up
    lever = cross(along, change) + cross(rate, cross(rate, along))
    return np.concatenate([along * up, mixed, along, along * np.abs(up), lever], axis=1)


def _expected(path: StabilisedForce, turns: BlockAverages, errors: Array, late_s: float) -> Array:
    """Change of the specific force in B by accelerometer errors and a time offset, over gravity, shape (m, 3)."""
    e, up, rate = errors, path.up_body, path.rate
    symmetric = np.array([[e[0], e[3], e[5]], [e[3], e[1], e[4]], [e[5], e[4], e[2]]])
    change = np.gradient(rate, turns.step_s, axis=0)  # sequences begin and end at rest
    out = late_s * cross(rate, up) + up @ symmetric + e[6:9] + e[9:12] * np.abs(up)
    return np.asarray(out + cross(change, e[12:]) + cross(rate, cross(rate, e[12:])))


def _coarser(values: Array) -> Array:
    n = len(values) // _COARSE
    return np.asarray(values[: n * _COARSE].reshape(n, _COARSE, *values.shape[1:]).mean(axis=1))


def _lag_causes(seen: TimeOffset) -> list[Cause]:
    """Patterns of the lag of accelerometers behind gyros over the rotations, for a lag of 1 s of some channels.

    In a rotation about one axis only the gyro of that axis turns.
    """
    n, by_gyro = len(seen.axes), seen.axes**2
    causes = [Cause("", np.zeros((n, 0)), {}), Cause("sensor_time_offset", np.ones((n, 1)), {})]
    for i, axis in enumerate(AXES):
        causes.append(Cause("gyro_axis_delayed", -by_gyro[:, i, None], {"channel": f"gyro_{axis}"}, 3))
        causes.append(Cause("accel_axis_delayed", seen.by_accel[:, i, None], {"channel": f"accel_{axis}"}, 3))
    return causes


@computed_once
def lag(evidence: Evidence) -> Finding | None:
    """Lag of the rotation of gravity behind the gyros, of all channels of a sensor or of one; None if there is none."""
    seen = time_offset(evidence)
    if seen is None:
        return None
    causes = _lag_causes(seen)
    ranked = compare(seen.by_turn, causes)
    best = next(explanation for explanation in ranked if explanation.cause.fault)
    late, sigma = float(best.value[0]), float(best.sigma[0])
    limit = -float(stdtrit(best.freedom, 0.5 * FALSE_ALARM / (len(causes) - 1)))
    if abs(late) <= max(limit * sigma, _LEAST_OFFSET * evidence.dt):
        return None
    told = finding(best.cause.fault, offset_ms=1e3 * late, sigma_ms=1e3 * sigma, **best.cause.details)
    return with_runner_up(told, ranked)


@check("sensor_time_offset", "gyro_axis_delayed", "accel_axis_delayed")
def sensor_time_offset(evidence: Evidence) -> Iterator[Finding]:
    """Test for a lag of the rotation of gravity behind the gyros: of all channels of a sensor, or of one."""
    told = lag(evidence)
    if told is not None:
        yield told


@dataclass(frozen=True, slots=True)
class AttitudeStep:
    """Step of the gyro-stabilised specific force in a rotation.

    Attributes
    ----------
    block : int
        Block of :func:`block_averages` before which the attitude steps.
    height : float
        Angle, rad.
    duration_s : float
        Time in which the rotation turns by it; negative where the gyros read too large an angle.
    """

    block: int
    height: float
    duration_s: float


@computed_once
def attitude_step(evidence: Evidence) -> AttitudeStep | None:
    """Largest significant step; None if there is none, or without a fixture: a hand accelerates in steps, too."""
    path, turns = stabilised_force(evidence), block_averages(evidence)
    if path is None or turns is None or evidence.recording.fixture is None:
        return None
    seen = time_offset(evidence)
    turning = cross(path.rate, path.up_body)
    speed = np.linalg.norm(turning, axis=1)
    moving = speed > _MOVING * speed.max()
    left = path.force_start - path.up
    if seen is not None:
        # A time offset would make steps of the beginning and the end of a rotation.
        left -= _levelled(path, _expected(path, turns, seen.errors, seen.typical_s))
    left -= np.einsum("ma,ma->m", left, path.up)[:, None] * path.up
    steps, whole = _steps(left, turns.starts)
    places = np.flatnonzero(moving & whole)
    height = np.linalg.norm(steps[places], axis=1)
    if len(height) == 0:
        return None
    # Most places hold no step: their median gives the noise.
    scale = float(np.median(height)) / _RAYLEIGH_MEDIAN
    limit = math.sqrt(-2.0 * math.log(FALSE_ALARM / len(height))) * scale
    excess = height / np.maximum(limit, _HALF_A_SAMPLE * speed[places] * evidence.dt)
    if excess.max() > 1.0 and seen is not None:
        excess = height / np.hypot(height / excess, _SURE * _step_doubt(path, turns, seen)[places])
    if excess.max() > 1.0:
        # A sequence with clipped gyro readings is void; the angle that it lacks is not of lost samples.
        void = [k for k, _ in clipped_parts(evidence) if k is not None]
        excess[np.isin(turns.sequence[places], void)] = 0.0
    best = int(np.argmax(excess))
    block = int(places[best])
    if excess[best] <= 1.0:
        return None
    surplus = float(steps[block] @ _levelled(path, turning)[block]) > 0.0
    size = float(height[best] / speed[block])
    return AttitudeStep(block, float(height[best]), -size if surplus else size)


def sample_twice(evidence: Evidence) -> int | None:
    """Sample that repeats the one before and turns the attitude too far by its angle; None if there is none."""
    step, turns = attitude_step(evidence), block_averages(evidence)
    if step is None or turns is None:
        return None
    samples = -step.duration_s / evidence.dt
    if round(samples) < 1 or abs(samples - round(samples)) > _WHOLE * round(samples):
        return None
    recording, first = evidence.recording, int(turns.first_sample[step.block])
    reach = 2 * max(1, round(turns.step_s / evidence.dt))
    rows = np.arange(max(1, first - reach), min(len(recording.time), first + reach))
    same = [np.all(x[rows] == x[rows - 1], axis=1) for x in (recording.gyro, recording.accel)]
    again = rows[same[0] & same[1]]
    return int(again[0]) if again.size else None


@check("samples_lost")
def samples_lost(evidence: Evidence) -> Iterator[Finding]:
    """Report a step of the gyro-stabilised specific force that no repeated sample explains."""
    step, turns = attitude_step(evidence), block_averages(evidence)
    if step is None or turns is None or sample_twice(evidence) is not None:
        return
    yield finding(
        "samples_lost",
        sequence=evidence.title(int(turns.sequence[step.block])),
        time=float(evidence.recording.time[turns.first_sample[step.block]]) - evidence.dt,
        angle_deg=math.degrees(step.height),
        duration=abs(step.duration_s),
    )


def _levelled(path: StabilisedForce, in_body: Array) -> Array:
    """Changes of the specific force in B, transformed to the frame at the start of the sequence, shape (m, 3)."""
    return np.asarray(np.einsum("mab,mb->ma", path.attitude, in_body))


def _step_doubt(path: StabilisedForce, turns: BlockAverages, seen: TimeOffset) -> Array:
    """Standard deviation of the height of a step before each block, by that of the accelerometer errors, shape (m,)."""
    steps = (_steps(_levelled(path, _expected(path, turns, errors, 0.0)), turns.starts)[0] for errors in seen.spread)
    return np.asarray(np.sqrt(sum(np.einsum("ma,ma->m", step, step) for step in steps)))


def _steps(values: Array, starts: Indices) -> tuple[Array, Mask]:
    """Height of a step before each block, fitted with a straight line through its surroundings, shape (m, 3).

    The mask, shape (m,), is true where the surroundings belong to one sequence.
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
