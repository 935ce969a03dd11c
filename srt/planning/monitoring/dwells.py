"""Motion of the unit while it should stand still: rests between rotations, tested without labels.

Stationary windows leave out what is not at rest, so a bump may lie beside them. Here a rest is all that lies between
two rotations. In blocks of 0.2 s, the gyros must show one rate and the accelerometers one vertical.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.model.gyro_stream import moving_average
from srt.sequences.manoeuvres import MOVING

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from srt.recording.recording import Recording
    from srt.types import Array, Indices

BLOCK_S: Final = 0.2
"""Length of a block, s: that of a bump."""
_SMOOTH_S: Final = 0.1
"""Length of the mean by which rotations are found, s."""
_SLOWEST_RAD_S: Final = 0.05
"""Slowest rotation of a test, rad/s."""
_SETTLING_S: Final = 0.6
"""Time after a rotation in which a fixture may still settle, s."""
_BEFORE_TURN_S: Final = 0.2
"""Time before a rotation that belongs to its start, s."""
_FEWEST_BLOCKS: Final = 6
"""Blocks of the shortest rest that is tested."""
_FALSE_ALARM: Final = 1e-6
"""False-alarm probability of a rest with normal noise."""
_LEAST_ANGLE_RAD: Final = 5e-5
"""Smallest motion that is reported: a twentieth of the accuracy of a fixture."""
_FLICKER: Final = 2.2
"""1-sigma change of the mean between two thirds of a rest over the bias instability: sqrt(2) / 0.664, the floor of the
Allan deviation over the square root of the flicker density times frequency."""
_ENOUGH_RESTS: Final = 5
"""Rests from which the scatter of their tilts is used: it holds the drift that is not stated."""
_MAD: Final = 1.4826
"""Standard deviation of normal noise over its median absolute deviation."""
_LEAST_NOISE: Final = 1e-12
"""Noise of a block that is assumed at least, SI: that of noise-free data is zero."""
_QUANTILE: Final = 0.9
_NORMAL: Final = 1.6449
"""Quantile of the differences of blocks that gives the noise, and the same of the normal distribution, in sigma."""


@dataclass(frozen=True, slots=True)
class RestMotion:
    """Motion within a rest.

    Attributes
    ----------
    rest_s : (float, float)
        Start and end of the rest.
    time_s : float
        Start of the motion.
    """

    rest_s: tuple[float, float]
    time_s: float
    angle_rad: float


def rests(recording: Recording, breaks: ArrayLike = ()) -> Indices:
    """Rests between rotations, first sample and one past the last, shape (n, 2), without settling.

    ``breaks`` are samples before which the unit was moved without a record: a rest ends there.
    """
    dt = recording.nominal_interval_s
    rate = recording.gyro if recording.kind == "rate" else recording.gyro * recording.rates_factor
    # The constant bias of a poor unit is no rotation: its median counts as rest.
    smooth = moving_average((rate - np.median(rate, axis=0)).T, max(1, round(_SMOOTH_S / dt))).T
    speed = np.sqrt(np.einsum("na,na->n", smooth, smooth))
    turning = np.concatenate([[True], speed > max(MOVING * float(speed.max()), _SLOWEST_RAD_S), [True]])
    turning[1 + np.asarray(breaks, dtype=np.intp)] = True
    edges = np.flatnonzero(np.diff(turning.astype(np.int8)))
    spans = edges.reshape(-1, 2)  # a rest begins and ends at every change
    first = spans[:, 0] + np.where(spans[:, 0] > 0, round(_SETTLING_S / dt), 0)
    last = spans[:, 1] - np.where(spans[:, 1] < len(speed), round(_BEFORE_TURN_S / dt), 0)
    long = last - first >= _FEWEST_BLOCKS * max(1, round(BLOCK_S / dt))
    return np.stack([first, last], axis=1)[long]


def rest_motions(recording: Recording, breaks: ArrayLike = ()) -> tuple[RestMotion, ...]:
    """Motions within rests, at most one each; ``breaks`` as for :func:`rests`."""
    dt = recording.nominal_interval_s
    size = max(1, round(BLOCK_S / dt))
    scale = recording.rates_factor
    spans = rests(recording, breaks)
    blocks = [(_means(recording.gyro[a:b], size) * scale, _means(recording.accel[a:b], size) * scale) for a, b in spans]
    if not blocks:
        return ()
    sigma_rate, sigma_force = (_block_sigma([pair[sensor] for pair in blocks]) for sensor in (0, 1))
    gravity, noise, span_s = recording.site.gravity_m_s2, recording.noise, size * dt
    tilts = np.array([_tilt(force) for _, force in blocks])
    scatter = _MAD * np.median(np.abs(tilts), axis=0) if len(tilts) >= _ENOUGH_RESTS else np.zeros(3)
    drift = _FLICKER * (noise.accel_bias_instability or 0.0)
    out = []
    for (a, b), (rate, _), tilt in zip(spans.tolist(), blocks, tilts, strict=True):
        n = len(rate)
        limit = float(chdtri(3.0, _FALSE_ALARM / n))
        off = rate - np.median(rate, axis=0)
        loud = np.sum((off / sigma_rate) ** 2, axis=1) > limit
        angle = float(np.linalg.norm(off[loud].sum(axis=0))) * span_s
        least = max(_LEAST_ANGLE_RAD, _FLICKER * (noise.gyro_bias_instability or 0.0) * n * span_s)
        variance = np.maximum(6.0 * sigma_force**2 / n, scatter**2) + drift**2
        lean = float(np.linalg.norm(tilt)) / gravity
        start = float(recording.time[a]) - dt
        rest = (start, float(recording.time[b - 1]))
        if loud.any() and angle > least:
            out.append(RestMotion(rest, start + float(np.argmax(loud)) * span_s, angle))
        elif float(np.sum(tilt**2 / variance)) > limit and lean > _LEAST_ANGLE_RAD:
            out.append(RestMotion(rest, start, lean))
    return tuple(out)


def _tilt(force: Array) -> Array:
    """Last third of a rest less the first third, by the means of blocks, shape (3,)."""
    third = len(force) // 3
    return np.asarray(force[-third:].mean(axis=0) - force[:third].mean(axis=0))


def _means(values: Array, size: int) -> Array:
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, 3).mean(axis=1))


def _block_sigma(blocks: list[Array]) -> Array:
    """Standard deviation of a block's mean by axis, from the differences of neighbours, robust, shape (3,)."""
    steps = np.concatenate([np.diff(each, axis=0) for each in blocks])
    # Of coarse readings more than half of the differences may be zero, so not their median.
    sigma = np.quantile(np.abs(steps), _QUANTILE, axis=0) / (_NORMAL * np.sqrt(2.0))
    return np.asarray(np.maximum(sigma, _LEAST_NOISE))
