"""A unit at rest while its temperature changes: what its readings say of the errors over temperature.

Rest shows changes alone. Of the gyros these are those of the bias, as the Earth's rate stays; of the accelerometers, in
an attitude that stays, those of bias, scale factor, asymmetry and misalignment together, as far as the specific force
in this attitude sees them. Each pass, heating or cooling, gives a mean in each of some intervals of temperature.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.measurement_model import force_error_jacobian, rate_error_jacobian
from srt.model.sensor_model import accel_triad, gyro_triad

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.sensor_errors import SensorErrors
    from srt.types import Array, Indices

LEAST_RANGE_K: Final = 5.0
"""Range of temperature from which a recording at rest is a ramp."""
_BLOCKS: Final = 200
"""Means over a recording in which rest and passes are looked for."""
_INTERVALS: Final = 12
"""Intervals of temperature in the range of a ramp."""
_TURNED_RAD: Final = 0.1
"""Change of the direction of specific force beyond which a unit was turned: drifts of biases reach a third of it."""
_PASS: Final = 0.1
"""Share of the range of temperature by which it turns back between two passes."""


@dataclass(frozen=True, slots=True, eq=False)
class RampVisits:
    """Means of a ramp in n visits of intervals of temperature, six channels each.

    Attributes
    ----------
    range_c : (float, float)
        Temperatures of the ramp, °C.
    temperature : ndarray, shape (n,), °C
    readings : ndarray, shape (n, 6)
        Gyros, rad/s, and accelerometers, m/s².
    sigma : ndarray, shape (n, 6)
        Noise of the means.
    effect : ndarray, shape (6, 27)
        Derivative of the readings with respect to the sensor errors.
    both_ways : bool
        True if heating and cooling are in it.
    """

    range_c: tuple[float, float]
    temperature: Array
    readings: Array
    sigma: Array
    effect: Array
    both_ways: bool


def is_ramp(recording: Recording) -> bool:
    """True if a recording is of a unit at rest in one attitude over a range of temperatures."""
    T = recording.temperature
    if T is None or recording.kind != "rate" or T.size < _BLOCKS or np.ptp(T) < LEAST_RANGE_K:
        return False
    force = np.stack([part.mean(axis=0) for part in np.array_split(recording.accel, _BLOCKS)])
    unit = force / np.linalg.norm(force, axis=1, keepdims=True)
    return bool(np.max(np.linalg.norm(unit - unit.mean(axis=0), axis=1)) < _TURNED_RAD)


def ramp_visits(recording: Recording, errors: SensorErrors) -> RampVisits:
    """Visits of a ramp; ``errors`` are those of the unit at some temperature, for the specific force.

    Parameters
    ----------
    recording : Recording
        For which :func:`is_ramp` is true.
    errors : SensorErrors
    """
    T = recording.temperature
    assert T is not None
    samples = np.hstack([recording.gyro, recording.accel])
    interval = np.minimum((_INTERVALS * (T - T.min()) / np.ptp(T)).astype(int), _INTERVALS - 1)
    key = _passes(T) * _INTERVALS + interval
    _, visit, count = np.unique(key, return_inverse=True, return_counts=True)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(visit, values) / count)

    readings = np.column_stack([mean(channel) for channel in samples.T])
    # Neighbouring differences: the noise of a sample without the drift of its mean.
    noise = np.std(np.diff(samples, axis=0), axis=0) / np.sqrt(2.0)
    force = accel_triad(errors).compensate(readings[:, 3:].mean(axis=0))
    gyro, accel = gyro_triad(errors), accel_triad(errors)
    slopes = (np.linalg.inv(part[None])[0] for part in (gyro.sensitivity(np.zeros(3)), accel.sensitivity(force)))
    by_rate, by_force = rate_error_jacobian(np.zeros(3), gyro), force_error_jacobian(force, accel)
    effect = np.concatenate([D @ J for D, J in zip(slopes, (by_rate, by_force), strict=True)])
    ends = float(T.min()), float(T.max())
    return RampVisits(ends, mean(T), readings, noise / np.sqrt(count)[:, None], effect, np.unique(_senses(T)).size > 1)


def _turning_points(T: Array) -> Indices:
    """First sample of each pass, and the number of samples; passes end where the temperature turns back."""
    blocks = np.linspace(0, T.size, _BLOCKS + 1).astype(int)
    course = np.array([part.mean() for part in np.array_split(T, _BLOCKS)])
    back, edges, extreme, sense = _PASS * np.ptp(T), [0], 0, 0
    for i, value in enumerate(course.tolist()):  # of blocks, not of samples
        if sense == 0 and abs(value - course[0]) > back:
            sense = 1 if value > course[0] else -1
        if sense * (value - course[extreme]) >= 0:
            extreme = i
        elif sense and sense * (course[extreme] - value) > back:
            edges.append(int(blocks[extreme]))
            sense, extreme = -sense, i
    return np.array([*edges, T.size])


def _passes(T: Array) -> Indices:
    """Number of the pass of each sample."""
    edges = _turning_points(T)
    return np.repeat(np.arange(len(edges) - 1), np.diff(edges))


def _senses(T: Array) -> Array:
    """Sign of the change of temperature in each pass."""
    edges = _turning_points(T)
    return np.array([np.sign(T[last - 1] - T[first]) for first, last in pairwise(edges.tolist())])
