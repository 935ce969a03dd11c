"""Tests for motion in a stationary window: chi-square of the difference of its halves.

A window that fails is integrated. Three other tests for motion answer other questions: which samples of an unlabelled
recording are at rest (:mod:`srt.sequences.rest_detection`), whether a labelled window holds a rotation, so that it is
refused (:mod:`srt.sequences.preparation`), and what disturbed a window (:mod:`srt.diagnosis.window_disturbances`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.sequences.window_means import MEDIAN_OF_SQUARE, PARTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.model.sensor_model import Triad
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.prepared_units import PreparedUnits
    from srt.types import Array, Mask


PROBABILITY: Final = 1e-3
"""Probability that a still window is classified as moving, by both tests together."""

_FIGURES: Final = ("gyro_white", "gyro_edge", "accel_white", "accel_edge", "accel_wander")
"""Figures of the noise model that the halves of a window have."""


def moved_windows(
    data: PreparedRecording,
    gyro: Triad,
    accel: Triad,
    rest_rate: Array,
    wander: Array,
    probability: float = PROBABILITY,
    *,
    drift: Sequence[Array | float] = (0.0, 0.0),
    suspect: Mask | None = None,
) -> Mask:
    """Test every window for motion: angle turned, and tilt.

    A constant rate alone is not motion: a bias that changes with the pose (g-sensitivity, instability) gives the same
    gyro readings. A rotation about a horizontal axis changes the accelerometer readings too; a change of these alone is
    their own drift. A window that fails is tested again with the noise of its own samples and without the change that
    all windows share, because neither larger noise nor a drift of the biases is motion.

    Parameters
    ----------
    gyro, accel : Triad
        Reading models at the estimate.
    rest_rate : ndarray, shape (W, 3), rad/s
        Compensated mean rate of every window less the Earth's and the common bias.
    wander : ndarray, shape (3,), rad/s
        One sigma of the bias between sequences, compensated.
    probability : float
        Probability that a still window is classified as moving.
    drift : sequence of two ndarray, shape (W, 2, 3), rad/s and m/s²
        Known drift of the raw readings in the halves of the windows, gyros and accelerometers.
    suspect : ndarray of bool, shape (W,), optional
        Windows whose mean rate contradicts the other windows. They moved if their tilt is closer to the one that this
        rate makes than to none, however small it is.

    Returns
    -------
    ndarray of bool, shape (W,)
    """
    halves = (data.windows.gyro_halves - drift[0], data.windows.accel_halves - drift[1])
    moved, alike = _fails(data, gyro, accel, halves, rest_rate, wander, probability=probability)
    if moved.any():
        halves = (_less_common_change(halves[0]), _less_common_change(halves[1]))
        own = _own_noise(data, moved)
        moved &= _fails(data, gyro, accel, halves, rest_rate, wander, probability=probability, ratio=own)[0]
    return moved if suspect is None else moved | suspect & alike


def suspect_units(
    data: PreparedUnits, gyro: Triad, accel: Triad, rest_rate: Array, wander: Array, probability: float = PROBABILITY
) -> Mask:
    """Units with a window that fails the test with the stated noise, (units,); arrays have a leading axis of units."""
    halves = data.windows.gyro_halves, data.windows.accel_halves
    return np.asarray(_fails(data, gyro, accel, halves, rest_rate, wander, probability=probability)[0].any(axis=-1))


def _fails(
    data: PreparedRecording,
    gyro: Triad,
    accel: Triad,
    halves: tuple[Array, Array],
    rest_rate: Array,
    wander: Array,
    *,
    probability: float,
    ratio: Array | tuple[float, float] = (1.0, 1.0),
) -> tuple[Mask, Mask]:
    """Windows that fail either test, and windows whose tilt is closer to that of the mean rate than to none.

    The stated noise of gyros and accelerometers is multiplied by ``ratio``, shape (W, 3) each. All arrays may have a
    leading axis of units.
    """
    by_window = {name: getattr(data.noise, name)[..., None, :] for name in _FIGURES}
    T = 0.5 * data.windows.duration_s[:, None]
    rate, force = (
        triad.compensate(part.reshape(*part.shape[:-3], -1, 3)).reshape(part.shape)
        for triad, part in zip((gyro, accel), halves, strict=True)
    )
    angle = (rate[..., 1, :] - rate[..., 0, :]) * T
    # Three readings of the angle make the difference of two adjoining halves: 1, -2, 1.
    raw = (2.0 * by_window["gyro_white"] ** 2 * T + 6.0 * by_window["gyro_edge"] ** 2) * ratio[0] ** 2
    # The gyros of a unit are alike: where one bias wanders, the others may, although the Earth's rate hides it.
    wandered = 2.0 * (wander.max(axis=-1)[..., None, None] * T) ** 2
    turned = np.sum(angle**2 / (raw @ np.swapaxes(gyro.inverse**2, -1, -2) + wandered), axis=-1)
    mean = accel.compensate(data.windows.accel_mean)
    up = mean / np.linalg.norm(mean, axis=-1, keepdims=True)
    change = force[..., 1, :] - force[..., 0, :]
    change -= up * np.einsum("...a,...a->...", up, change)[..., None]
    raw = (2.0 * by_window["accel_white"] ** 2 / T + 6.0 * (by_window["accel_edge"] / T) ** 2) * ratio[1] ** 2
    variance = raw @ np.swapaxes(accel.inverse**2, -1, -2) + 2.0 * by_window["accel_wander"] ** 2
    tilted = np.sum(change**2 / variance, axis=-1) > chdtri(2, 0.5 * probability)
    by_gyros = np.cross(mean, rest_rate) * T
    left, tilt = np.linalg.norm(change - by_gyros, axis=-1), np.linalg.norm(change, axis=-1)
    return (turned > chdtri(3, 0.5 * probability)) | tilted & (left < 0.5 * tilt), left < tilt


def _less_common_change(halves: Array) -> Array:
    """Halves without the median change of all windows, shape (W, 2, 3): what windows of all poses share is drift."""
    change = np.median(halves[:, 1] - halves[:, 0], axis=0)
    return halves - np.array([[-0.5], [0.5]]) * change


def _own_noise(data: PreparedRecording, which: Mask) -> Array:
    """Ratio of a window's own noise to that of the noise model, at least one, shape (2, W, 3).

    The noise is the median of the squared second differences of the means of sixteen parts: a constant drift does not
    change the second differences, and a single step does not change their median.
    """
    recording, noise = data.recording, data.noise
    ratio = np.ones((2, len(which), 3))
    sensors = (
        (recording.gyro, noise.gyro_white, noise.gyro_edge),
        (recording.accel, noise.accel_white, noise.accel_edge),
    )
    for w in np.flatnonzero(which).tolist():
        a, b = data.windows.samples[w].tolist()
        count = (b - a) // PARTS
        if count == 0:
            continue
        tau = float(data.windows.duration_s[w]) * count / (b - a)
        for s, (samples, white, edge) in enumerate(sensors):
            parts = samples[a : a + count * PARTS].reshape(PARTS, count, 3).sum(axis=1)
            means = parts / (tau if recording.kind == "increment" else count)
            bend = np.diff(means, n=2, axis=0)
            seen = np.median(bend**2, axis=0) / MEDIAN_OF_SQUARE
            expected = 6.0 * white**2 / tau + 20.0 * (edge / tau) ** 2
            ratio[s, w] = np.sqrt(np.maximum(seen / expected, 1.0))
    return ratio
