"""Disturbances of a test on a bench, applied to a simulated run.

There are three kinds. Each function returns a new object and does not change its input::

    draw   = wrong_angle(draw, sequence, leg, error_rad)              # on the fixture, before the motion
    motion = tilt_step(motion, time_s, vector_rad)                    # on the true motion, before the read-out
    motion = vibrating(motion, frequency_hz, angle_rad, force_m_s2)
    record = lose_samples(record, start_s, duration_s)                # on the samples
    record = accel_bias_step(record, start_s, end_s, step_m_s2)
    record = noisier_window(record, (start_s, end_s), factor, gyro_noise, accel_noise, rng)

Gyros and accelerometers sense a disturbance of the true motion consistently. A disturbance of the samples is applied
after quantization and saturation. A time span contains the same samples as a window with the same limits,
a + dt/2 < t <= b + dt/2 (:meth:`srt.recording.recording.Recording.window_indices`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.polynomial import legendre

from sims.physics.fixture import rotation
from srt.recording.recording import WINDOW_TOLERANCE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from sims.physics.fixture import FixtureDraw
    from sims.physics.true_motion import TrueMotion
    from srt.recording.recording import Recording
    from srt.types import Array


_NODES: Final = 12
"""Nodes of Gauss quadrature over a sample."""


def tilt_step(motion: TrueMotion, time_s: float, rotation_vector_rad: ArrayLike) -> TrueMotion:
    """True motion with a slip in the mount: within one sample B rotates by v, and remains so to the end of the piece.

    The interval of this sample begins at ``time_s`` or contains it. During the sample the attitude is C·Exp(s v), where
    C is the undisturbed attitude and s goes from 0 to 1; afterwards it is C·Exp(v)::

        rate            Exp(-s v)·ω + v/dt     in the sample
        specific force  Exp(-s v)·f
        any vector x    Exp(-v)·x              after it

    The next piece begins undisturbed, as if the mount were corrected between sequences. With recorded moves there is
    only one piece, and the slip persists to the end of the run. ``U`` and ``draw`` describe the mount before the slip.

    There are two approximations. Rate and force are taken as constant during the sample of the step: if they change by
    δ in it, their integrals have an error of |v|·δ·dt/12. In the rotated frame, only |∫x| is known of ∫|x|. The
    difference ∫|x| − |∫x|, which is zero unless a component changes sign within the sample, is left unchanged; the
    error is up to 2|v|·∫|x| in samples with a sign change in either frame.

    ``rotation_vector_rad`` is v, small, in body axes; a later step is in the axes after the earlier ones. The attitudes
    of the windows that end after the step in the same piece change with it.
    """
    vector = np.asarray(rotation_vector_rad)
    step, stop = _sample_and_end_of_piece(motion, time_s)
    during, after = slice(step, step + 1), slice(step + 1, stop)
    # For rows, multiplication with Exp(v) is Exp(-v) for columns; during the step, the mean over the sample applies.
    nodes, weights = legendre.leggauss(_NODES)
    part = np.multiply.outer(0.5 * (1.0 + nodes), vector)
    mean_turn = np.einsum("k,kij->ij", 0.5 * weights, rotation(part))
    turn = rotation(vector)

    def turned(old: Array, old_absolute: Array, added: Array | float) -> tuple[Array, Array]:
        new, absolute = old.copy(), old_absolute.copy()
        new[during] = old[during] @ mean_turn + added
        new[after] = old[after] @ turn
        changed = slice(step, stop)
        excess = np.maximum(old_absolute[changed] - np.abs(old[changed]), 0.0)
        absolute[changed] = np.abs(new[changed]) + excess
        return new, absolute

    angle, angle_abs = turned(motion.angle, motion.angle_abs, vector)
    velocity, velocity_abs = turned(motion.velocity, motion.velocity_abs, 0.0)
    ends = np.array(motion.windows).reshape(-1, 2, 2)[:, :, 1]
    half = 0.5 * motion.interval
    later = (ends > motion.time[step] - half) & (ends < motion.time[stop - 1] + half)
    attitudes = motion.attitudes.copy()
    attitudes[later] = motion.attitudes[later] @ turn
    return replace(
        motion,
        angle=angle,
        angle_abs=angle_abs,
        velocity=velocity,
        velocity_abs=velocity_abs,
        attitudes=attitudes,
    )


def vibrating(
    motion: TrueMotion, frequency_hz: float, angle_rad: ArrayLike, force_m_s2: ArrayLike, *, phase_rad: float = 0.0
) -> TrueMotion:
    """True motion on a vibrating table: B oscillates by a small angle, and linearly, throughout the run.

    The attitude C becomes C·Exp(v sin u), u = 2π f t + phase. Every vector x in B becomes x − v sin u × x, the rate
    v·du/dt·cos u is added, and the specific force of the linear vibration. Second-order terms in v are neglected.

    Angle v, rad, and amplitude of the specific force of the linear vibration, m/s², are in body axes and in phase.
    """
    v, a = np.asarray(angle_rad), np.asarray(force_m_s2)
    w, dt = 2.0 * math.pi * frequency_hz, motion.interval
    nodes, weights = legendre.leggauss(_NODES)
    u = w * (motion.time[:, None] - dt + 0.5 * dt * (1.0 + nodes)) + phase_rad
    share = 0.5 * weights

    def shaken(old: Array, old_absolute: Array, added: Array) -> tuple[Array, Array]:
        # The motion without vibration is taken as constant within a sample; ``added`` has shape (n, nodes, 3).
        new = old + dt * np.einsum("q,nqc->nc", share, added)
        absolute = dt * np.einsum("q,nqc->nc", share, np.abs(old[:, None] / dt + added))
        return new, absolute + np.maximum(old_absolute - np.abs(old), 0.0)

    sin, cos = np.sin(u)[:, :, None], np.cos(u)[:, :, None]
    turned, tilted = (-np.cross(v, values / dt)[:, None] for values in (motion.angle, motion.velocity))
    angle, angle_abs = shaken(motion.angle, motion.angle_abs, w * cos * v + sin * turned)
    velocity, velocity_abs = shaken(motion.velocity, motion.velocity_abs, sin * (tilted + a))
    return replace(motion, angle=angle, angle_abs=angle_abs, velocity=velocity, velocity_abs=velocity_abs)


def lose_samples(recording: Recording, start_s: float, duration_s: float) -> Recording:
    """Replace consecutive gyro samples by a straight line between their neighbours, as a logger fills lost samples.

    The time stamps are unchanged; the span is within one gapless piece, with a neighbour on each side.
    """
    rows = recording.window_indices(start_s, start_s + duration_s)
    before, after = rows.start - 1, rows.stop
    time, gyro = recording.time, recording.gyro.copy()
    weight = ((time[rows] - time[before]) / (time[after] - time[before]))[:, np.newaxis]
    gyro[rows] = (1.0 - weight) * gyro[before] + weight * gyro[after]
    return _with_samples(recording, gyro, recording.accel)


def accel_bias_step(recording: Recording, start_s: float, end_s: float, step_m_s2: ArrayLike) -> Recording:
    """Add a constant (3,), m/s² in body axes, to the accelerometer readings of a time span, which may include gaps."""
    step, rows = np.asarray(step_m_s2), recording.window_indices(start_s, end_s)
    accel = recording.accel.copy()
    accel[rows] += step if recording.kind == "rate" else step * _intervals(recording, rows)
    return _with_samples(recording, recording.gyro, accel)


def noisier_window(
    recording: Recording,
    window: tuple[float, float],
    factor: float,
    gyro_noise: float,
    accel_noise: float,
    rng: np.random.Generator,
) -> Recording:
    """Increase the white noise in a window to ``factor`` times the stated noise, as a passing lorry or a fan does.

    ``gyro_noise`` and ``accel_noise`` are the stated angular random walk, rad/√s, and velocity random walk, m/s/√s.
    Each triad uses a generator of its own.
    """
    rows = recording.window_indices(*window)
    # White noise of density N has the variance N²·dt in an increment, N²/dt in a mean rate.
    power = -0.5 if recording.kind == "rate" else 0.5
    per_density = math.sqrt(factor**2 - 1.0) * _intervals(recording, rows) ** power
    gyro, accel = recording.gyro.copy(), recording.accel.copy()
    for values, density, child in zip((gyro, accel), (gyro_noise, accel_noise), rng.spawn(2), strict=True):
        values[rows] += density * per_density * child.standard_normal((rows.stop - rows.start, 3))
    return _with_samples(recording, gyro, accel)


def wrong_angle(draw: FixtureDraw, sequence: int, leg: int, error_rad: float) -> FixtureDraw:
    """Add an error to one rotation of a fixture draw, in the positive sense of the fixture angle.

    It persists until the sequence ends. Sequences and their rotations are numbered in the order of execution, from 0.
    """
    assert draw.legs is not None
    errors = np.array(draw.legs[sequence], dtype=np.float64)
    errors[leg] += error_rad
    return replace(draw, legs=(*draw.legs[:sequence], errors, *draw.legs[sequence + 1 :]))


def _sample_and_end_of_piece(motion: TrueMotion, time_s: float) -> tuple[int, int]:
    """Find the sample with time - interval <= time_s < time, and the end (exclusive) of its gapless piece."""
    # A step at the edge of a sample must not fall into the preceding sample because of rounding.
    early = WINDOW_TOLERANCE * motion.interval
    sample = int(np.searchsorted(motion.time, time_s + early, side="right"))
    following = int(np.searchsorted(motion.piece_starts, sample, side="right"))
    stop = len(motion.time) if following == len(motion.piece_starts) else int(motion.piece_starts[following])
    return sample, stop


def _intervals(recording: Recording, rows: slice) -> Array:
    """Durations of samples as a column, shape (m, 1) or (1, 1), s."""
    interval = recording.interval_s
    return np.asarray(interval[rows] if isinstance(interval, np.ndarray) else [interval])[:, np.newaxis]


def _with_samples(recording: Recording, gyro: Array, accel: Array) -> Recording:
    """Replace the samples and remove the hash of the file, as they are no longer those of the file."""
    return replace(recording, gyro=gyro, accel=accel, data_sha256=None)
