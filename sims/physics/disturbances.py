"""Disturbances of a test on a bench, applied to a simulated run.

Three kinds, by where they act; each function returns a new object and leaves its input alone::

    draw   = wrong_angle(draw, sequence, leg, error_rad)              # on the fixture, before the motion
    motion = tilt_step(motion, time_s, vector_rad)                    # on the true motion, before the read-out
    record = lose_samples(record, start_s, duration_s)                # on the samples
    record = accel_bias_step(record, start_s, end_s, step_m_s2)
    record = noisier_window(record, (start_s, end_s), factor, gyro_noise, accel_noise, rng)

A disturbance of the true motion is sensed by gyros and accelerometers alike; one of the samples is not, and comes
after quantization and saturation. Spans of time hold the samples that a window with the same limits holds,
a + dt/2 < t <= b + dt/2 (:meth:`srt.recording.recording.Recording.window_indices`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.polynomial import legendre

from sims.physics.fixture import rotation
from srt.exceptions import InputError
from srt.recording.recording import WINDOW_TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from sims.physics.fixture import FixtureDraw
    from sims.physics.true_motion import TrueMotion
    from srt.recording.recording import Recording
    from srt.types import Array

Sensor = Literal["gyro", "accel"]


def tilt_step(motion: TrueMotion, time_s: float, rotation_vector_rad: ArrayLike) -> TrueMotion:
    """True motion with a slip in the mount: within one sample B rotates by v, and stays there to the end of the piece.

    The sample is the one whose interval begins at ``time_s`` or contains it; over it the body turns away from its
    undisturbed attitude C by Exp(s v), s from 0 to 1, and from then on its attitude is C·Exp(v)::

        rate            Exp(-s v)·ω + v/dt     in the sample
        specific force  Exp(-s v)·f
        any vector x    Exp(-v)·x              after it

    The next piece begins undisturbed, as the mount is set right between sequences; with recorded moves there is one
    piece only, and the slip stays to the end of the run. ``U`` and ``draw`` keep telling of the mount before the slip.

    Exact but for two things. The sample of the step takes rate and force to be constant over it: where they change by
    δ over the sample, their integrals are off by |v|·δ·dt/12. And of ∫|x| only |∫x| is known in the turned frame:
    the excess of one over the other, which is zero unless a component changes sign within the sample, is kept, which
    is wrong by up to 2|v|·∫|x| where there is such a change before or after.

    Parameters
    ----------
    motion : TrueMotion
    time_s : float
        In a still window, in a turn, or anywhere else where samples are recorded.
    rotation_vector_rad : array_like, shape (3,), rad
        v, in body axes; meant to be small. A later step is in the axes that an earlier one left, provided that they
        are applied in that order.

    Returns
    -------
    TrueMotion
        With changed ``angle``, ``angle_abs``, ``velocity``, ``velocity_abs``, and with the ``attitudes`` of those
        windows that end after the step in its piece.

    Raises
    ------
    InputError
        A time outside the samples or in a gap between them; a vector of another shape or not finite.
    """
    vector = _vector("The rotation vector of a tilt step", rotation_vector_rad)
    step, stop = _sample_and_end_of_piece(motion, time_s)
    during, after = slice(step, step + 1), slice(step + 1, stop)
    # Rows times Exp(v) are Exp(-v) times columns; in the step's own sample it is their mean over the sample.
    nodes, weights = legendre.leggauss(12)
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


def lose_samples(
    recording: Recording, start_s: float, duration_s: float, sensors: Sequence[Sensor] = ("gyro",)
) -> Recording:
    """Lose a run of samples, which the logger fills with a straight line between the neighbours.

    Parameters
    ----------
    recording : Recording
    start_s, duration_s : float
        The run, s; a duration of zero loses nothing.
    sensors : sequence of "gyro", "accel"
        Which of them lose it; the time stamps stay.

    Returns
    -------
    Recording
        Rates or increments, whichever it holds, are linear in time over the run.

    Raises
    ------
    InputError
        A negative duration, a run outside the recording, one that holds no sample, or one without a neighbour on each
        side in the same gapless piece; no sensor, or one that is neither "gyro" nor "accel".
    """
    if not sensors or any(name not in ("gyro", "accel") for name in sensors):
        raise InputError(f"The sensors that lose samples are {sensors!r}, but a sequence of 'gyro', 'accel' is needed.")
    if not (math.isfinite(duration_s) and duration_s >= 0.0):
        raise InputError(f"Samples are lost for {duration_s:g} s, but a duration is zero or positive: correct it.")
    what = "The run of lost samples"
    _check_inside(recording, what, start_s, start_s + duration_s)
    if duration_s == 0.0:
        return recording
    rows = _rows(recording, what, start_s, start_s + duration_s)
    before, after = rows.start - 1, rows.stop
    gaps = recording.gaps
    if before < 0 or after >= len(recording.time) or np.any((gaps > before) & (gaps <= after)):
        raise InputError(
            f"{what} [{start_s:g}, {start_s + duration_s:g}] s has no neighbour on one side, or a gap between them: "
            "keep it inside a gapless piece of the recording."
        )
    time = recording.time
    weight = ((time[rows] - time[before]) / (time[after] - time[before]))[:, np.newaxis]

    def bridged(name: Sensor, values: Array) -> Array:
        if name not in sensors:
            return values
        new = values.copy()
        new[rows] = (1.0 - weight) * values[before] + weight * values[after]
        return new

    return _with_samples(recording, bridged("gyro", recording.gyro), bridged("accel", recording.accel))


def accel_bias_step(recording: Recording, start_s: float, end_s: float, step_m_s2: ArrayLike) -> Recording:
    """Add a constant to the accelerometers for a time.

    Parameters
    ----------
    recording : Recording
    start_s, end_s : float
        Span, s; it may reach over gaps.
    step_m_s2 : array_like, shape (3,), m/s²
        Added to the readings, in body axes; to increments, times the interval.

    Raises
    ------
    InputError
        A span that does not end after it starts, reaches outside the recording or holds no sample; a step of another
        shape or not finite.
    """
    step = _vector("The step of the accelerometer bias", step_m_s2)
    rows = _rows(recording, "The span of the bias step", start_s, end_s)
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
    """Raise the white noise of a window to ``factor`` times the stated one, as a passing lorry or a fan does.

    Parameters
    ----------
    recording : Recording
        Whose samples hold the stated white noise already.
    window : (start_s, end_s)
        s; it may reach over gaps.
    factor : float
        At least 1; the noise added has √(factor² − 1) times the stated density.
    gyro_noise, accel_noise : float
        The stated ones: angle random walk, rad/√s, and velocity random walk, m/s/√s; zero leaves a sensor alone.
    rng : numpy.random.Generator
        Gyro and accelerometer draw from children of their own.

    Raises
    ------
    InputError
        A window that does not end after it starts, reaches outside the recording or holds no sample; a factor below 1,
        a noise below zero, or one that is not finite.
    """
    if not (math.isfinite(factor) and factor >= 1.0):
        raise InputError(f"The noise of a window is raised by the factor {factor:g}, but at least 1 is expected.")
    for name, noise in (("gyro", gyro_noise), ("accelerometer", accel_noise)):
        if not (math.isfinite(noise) and noise >= 0.0):
            raise InputError(f"The stated {name} noise is {noise:g}, but zero or a positive number is expected.")
    rows = _rows(recording, "The noisier window", *window)
    # White noise of density N has the variance N²·dt in an increment, N²/dt in a mean rate.
    power = -0.5 if recording.kind == "rate" else 0.5
    per_density = math.sqrt(factor**2 - 1.0) * _intervals(recording, rows) ** power
    gyro, accel = recording.gyro.copy(), recording.accel.copy()
    for values, density, child in zip((gyro, accel), (gyro_noise, accel_noise), rng.spawn(2), strict=True):
        values[rows] += density * per_density * child.standard_normal((rows.stop - rows.start, 3))
    return _with_samples(recording, gyro, accel)


def wrong_angle(draw: FixtureDraw, sequence: int, leg: int, error_rad: float) -> FixtureDraw:
    """Fixture draw with an error of one rotation; like every rotation error it lasts until its sequence ends.

    Parameters
    ----------
    draw : FixtureDraw
        With the errors of all rotations (:func:`sims.physics.fixture.draw_fixture` without sigmas draws zeros).
    sequence, leg : int
        Number of the sequence in the order of execution, and of its rotation, both from 0.
    error_rad : float
        On top of the error drawn, positive in the sense of the fixture axis' angle, rad.

    Raises
    ------
    InputError
        A draw without errors of rotations, an index out of range, an error that is not finite.
    """
    if draw.legs is None:
        raise InputError(
            "This fixture draw holds no errors of rotations, so that its sequences are unknown: "
            "draw it for the sequences with draw_fixture, whose sigmas may be zero."
        )
    if not 0 <= sequence < len(draw.legs):
        raise InputError(f"There is no sequence {sequence} in a fixture draw for {len(draw.legs)}: count from 0.")
    if not 0 <= leg < len(draw.legs[sequence]):
        raise InputError(
            f"There is no rotation {leg} in sequence {sequence}, which has {len(draw.legs[sequence])}: count from 0."
        )
    if not math.isfinite(error_rad):
        raise InputError(f"The error of a rotation is {error_rad:g} rad, but a finite number is expected.")
    errors = np.array(draw.legs[sequence], dtype=np.float64)
    errors[leg] += error_rad
    return replace(draw, legs=(*draw.legs[:sequence], errors, *draw.legs[sequence + 1 :]))


def _sample_and_end_of_piece(motion: TrueMotion, time_s: float) -> tuple[int, int]:
    """Find the sample with time - interval <= time_s < time, and one past the last sample of its piece."""
    early = WINDOW_TOLERANCE * motion.interval
    first, last = float(motion.time[0]) - motion.interval, float(motion.time[-1])
    if not first - early <= time_s < last - early:
        raise InputError(
            f"The tilt step is at {time_s:g} s, but the samples run from {first:g} to {last:g} s: move it."
        )
    # Rounding must not put a step at a sample's edge into the sample before.
    sample = int(np.searchsorted(motion.time, time_s + early, side="right"))
    begins = float(motion.time[sample]) - motion.interval
    if time_s < begins - early:
        raise InputError(
            f"The tilt step is at {time_s:g} s, in a gap: samples end at {motion.time[sample - 1]:g} s "
            f"and go on from {begins:g} s, so move it into a recorded piece."
        )
    following = int(np.searchsorted(motion.piece_starts, sample, side="right"))
    stop = len(motion.time) if following == len(motion.piece_starts) else int(motion.piece_starts[following])
    return sample, stop


def _vector(what: str, given: ArrayLike) -> Array:
    vector = np.array(given, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{what} is {vector.tolist()}, but three finite numbers are expected.")
    return vector


def _check_inside(recording: Recording, what: str, start_s: float, end_s: float) -> None:
    interval = recording.nominal_interval_s
    first, last = float(recording.time[0]) - interval, float(recording.time[-1])
    early = WINDOW_TOLERANCE * interval
    if not (first - early <= start_s and end_s <= last + early):
        raise InputError(
            f"{what} is [{start_s:g}, {end_s:g}] s, but the samples run from {first:g} to {last:g} s: move it inside."
        )


def _rows(recording: Recording, what: str, start_s: float, end_s: float) -> slice:
    """Samples of a span that must lie in the recording and hold some."""
    if not start_s < end_s:
        raise InputError(f"{what} is [{start_s:g}, {end_s:g}] s, but it must end after it starts: correct its limits.")
    _check_inside(recording, what, start_s, end_s)
    rows = recording.window_indices(start_s, end_s)
    if rows.stop == rows.start:
        raise InputError(f"{what} [{start_s:g}, {end_s:g}] s holds no sample: widen it, or move it out of a gap.")
    return rows


def _intervals(recording: Recording, rows: slice) -> Array:
    """Durations of samples as a column, shape (m, 1) or (1, 1), s."""
    interval = recording.interval_s
    return np.asarray(interval[rows] if isinstance(interval, np.ndarray) else [interval])[:, np.newaxis]


def _with_samples(recording: Recording, gyro: Array, accel: Array) -> Recording:
    """Change the samples; they are no longer those of a file, so its hash goes."""
    return replace(recording, gyro=gyro, accel=accel, data_sha256=None)
