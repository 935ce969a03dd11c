"""Noise of a test and of its readings, as a calibration states it."""

# Annotations are evaluated: srt.result.document reads files by them.
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from srt.exceptions import InputError
from srt.types import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class LogNoise:
    """Noise terms of a log at rest (``srt noise``): by channel and key, its value, low and high, or an upper limit."""

    length_s: float
    samples_sha256: str | None
    channels: Mapping[str, Mapping[str, Mapping[str, float]]]


_OF_BOTH_SIGNS: Final = ("gyro_bias_by_sequence_rad_s", "gravity_effect", "held_values_covariance")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NoiseFigures:
    """Noise that a calibration used, 1-sigma by channel; None where it is not known, as in merged calibrations.

    Attributes
    ----------
    gyro_filter_s, accel_filter_s : float or None
        Time constant of a filter that the readings went through.
    gyro_noise_rad_per_sqrt_s, accel_noise_m_s2_sqrt_s : ndarray, shape (3,), or None
        White noise.
    gyro_reading_error_rad, accel_reading_error_m_s : ndarray, shape (3,), or None
        Error of the readings at the edges of a window.
    gyro_bias_wander_rad_s, accel_bias_wander_m_s2 : ndarray, shape (3,), or None
        Bias of a sequence about the mean of the test.
    estimated, floored : tuple of str, or None
        Figures that were not stated; figures that were raised to the lower limit.
    sigma_inflation : float or None
        Factor on all sigmas.
    gyro_bias_by_sequence_rad_s : ndarray, shape (K, 3), or None
    chi_square, degrees_of_freedom : float, int, or None
    gravity_effect : ndarray, shape (27,), SI, or None
        Effect of one sigma of gravity on the parameters.
    held_values_covariance : ndarray, shape (27, 27), SI, or None
        Covariance due to fixed values.
    between_recordings : mapping of str to float, or None
        1-sigma between merged recordings by group of parameters, SI.
    terms : LogNoise or None
    """

    gyro_filter_s: float | None = None
    accel_filter_s: float | None = None
    gyro_noise_rad_per_sqrt_s: Array | None = None
    accel_noise_m_s2_sqrt_s: Array | None = None
    gyro_reading_error_rad: Array | None = None
    accel_reading_error_m_s: Array | None = None
    gyro_bias_wander_rad_s: Array | None = None
    accel_bias_wander_m_s2: Array | None = None
    estimated: tuple[str, ...] | None = None
    floored: tuple[str, ...] | None = None
    sigma_inflation: float | None = None
    gyro_bias_by_sequence_rad_s: Array | None = None
    chi_square: float | None = None
    degrees_of_freedom: int | None = None
    gravity_effect: Array | None = None
    held_values_covariance: Array | None = None
    between_recordings: Mapping[str, float] | None = None
    terms: LogNoise | None = None

    def __post_init__(self) -> None:
        """Refuse sizes of noise that are negative.

        Raises
        ------
        InputError
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in _OF_BOTH_SIGNS and isinstance(value, float | np.ndarray) and np.any(value < 0.0):
                raise InputError(f"noise.{field.name} is negative, but it is the size of a noise.")
