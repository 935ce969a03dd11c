"""Noise figures that a calibration states: those of ``srt noise --into``, else the white noise of its test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.noise.allan import CHANNELS, RANDOM_WALK, TERMS

if TYPE_CHECKING:
    from srt.result.noise_figures import NoiseFigures
    from srt.types import Array, Mask

_SENSORS: Final = ("gyro", "accel")


def stated_term(noise: NoiseFigures, sensor: str, term: int) -> tuple[Array, Mask]:
    """Figures of a noise term by ``srt noise``.

    Parameters
    ----------
    sensor : "gyro" or "accel"
    term : int
        Index in :data:`srt.noise.allan.TERMS`.

    Returns
    -------
    figures : ndarray, shape (3,)
        SI; NaN where not stated.
    limits : ndarray of bool, shape (3,)
        True for a figure that is an upper limit.
    """
    s = _SENSORS.index(sensor)
    key, scale = TERMS[term].keys[s], TERMS[term].scales[s]
    channels = {} if noise.terms is None else noise.terms.channels
    rows = [channels.get(channel, {}).get(key, {}) for channel in CHANNELS[3 * s : 3 * s + 3]]
    figures = [row.get("value", row.get("below", np.nan)) for row in rows]
    return scale * np.array(figures, dtype=np.float64), np.array(["below" in row for row in rows])


def white_noise(noise: NoiseFigures, sensor: str) -> Array:
    """White noise of the uncorrected readings, shape (3,), rad/s/√Hz or m/s²/√Hz; NaN where not stated.

    The log of ``srt noise`` comes first: in the test, it is estimated from short stationary windows.
    """
    of_the_log, _ = stated_term(noise, sensor, RANDOM_WALK)
    of_the_test = noise.gyro_noise_rad_per_sqrt_s if sensor == "gyro" else noise.accel_noise_m_s2_sqrt_s
    return np.where(np.isnan(of_the_log), np.nan if of_the_test is None else of_the_test, of_the_log)


def white_density(noise: NoiseFigures, sensor: str, correction: Array) -> Array:
    """Spectral density of the white noise of corrected readings, shape (3, 3), squares of rad/s/√Hz or m/s²/√Hz.

    Parameters
    ----------
    sensor : "gyro" or "accel"
    correction : ndarray, shape (3, 3)
        D of ``corrected = D (reading − bias)``.

    Raises
    ------
    InputError
        If the white noise of a channel is not stated.
    """
    white = white_noise(noise, sensor)
    if not np.all(np.isfinite(white)):
        raise InputError(
            f"This calibration does not state the white noise of the {sensor} channels: take one that is not merged, "
            "or add the noise of a log at rest (srt noise LOG --into UNIT.json)."
        )
    return np.asarray(correction @ np.diag(white**2) @ correction.T)
