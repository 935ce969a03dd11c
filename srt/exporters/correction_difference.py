"""Difference of two corrections of the same readings: a recording, or rotation and force in all directions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.recording.recording import as_samples, require_finite

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.types import Array

    Correction = Callable[[Array, Array], tuple[Array, Array]]

DIRECTIONS: Final = 1000
"""Number of directions of the standard motion: neighbours are 6° apart."""
STANDARD_RATE_RAD_S: Final = 1.0
"""Rate of the standard motion, rad/s."""
_BLOCK: Final = 1 << 16
"""Samples compared at a time, so that a long recording needs no more memory than a short one."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Raw readings on which corrections are compared.

    Attributes
    ----------
    gyro, accel : ndarray, shape (n, 3), rad/s and m/s²
    title : str
        Description in text.

    Raises
    ------
    InputError
        Shapes that do not fit, no samples, or values that are not finite numbers.
    """

    gyro: Array
    accel: Array
    title: str

    def __post_init__(self) -> None:
        for name in ("gyro", "accel"):
            values = as_samples(name, getattr(self, name), 2)
            require_finite(name, values, None)
            object.__setattr__(self, name, values)
        if len(self.gyro) != len(self.accel) or not len(self.gyro):
            raise InputError(
                f"The readings are {len(self.gyro)} samples of the gyros and {len(self.accel)} of the accelerometers, "
                "but as many of both are needed, and one at least."
            )

    @classmethod
    def of(cls, recording: Recording, title: str = "the recording") -> Readings:
        """Readings of a recording; increments become rates, as all formats expect."""
        n = len(recording.time)
        if recording.kind == "rate":
            return cls(recording.gyro, recording.accel, f"{n} samples of {title}")
        dt = np.broadcast_to(recording.interval_s, n)[:, None]
        return cls(recording.gyro / dt, recording.accel / dt, f"{n} samples of {title}")

    @classmethod
    def standard(cls, calibration: Calibration) -> Readings:
        """Readings of the unit at 1 rad/s and 1 g in 1000 directions distributed evenly over the sphere.

        Rate and force of a sample point in different directions; there is no noise.
        """
        directions = _sphere(DIRECTIONS)
        # 619 is prime to 1000: every direction comes once.
        others = directions[(619 * np.arange(DIRECTIONS)) % DIRECTIONS]
        gyro = gyro_triad(calibration.errors).read(STANDARD_RATE_RAD_S * directions)
        force = STANDARD_GRAVITY_M_S2 * others
        accel = accel_triad(calibration.errors).read(force)
        if calibration.g_sensitivity is not None:
            gyro = gyro + force @ calibration.g_sensitivity.T
        return cls(gyro, accel, f"1 rad/s and 1 g in {DIRECTIONS} directions")


@dataclass(frozen=True, slots=True)
class CorrectionDifference:
    """Magnitude of the difference of two corrections.

    Attributes
    ----------
    title : str
        Description of the compared correction.
    gyro_max, gyro_rms : float, rad/s
    accel_max, accel_rms : float, m/s²
    """

    title: str
    gyro_max: float
    gyro_rms: float
    accel_max: float
    accel_rms: float


def compare_corrections(title: str, readings: Readings, ours: Correction, theirs: Correction) -> CorrectionDifference:
    """Correct readings in two ways and measure the difference.

    Parameters
    ----------
    ours, theirs : callable
        From readings, shapes (n, 3), to corrected values in the same axes.
    """
    largest, total = np.zeros(2), np.zeros(2)
    n = len(readings.gyro)
    for a in range(0, n, _BLOCK):
        gyro, accel = readings.gyro[a : a + _BLOCK], readings.accel[a : a + _BLOCK]
        for s, (ours_s, theirs_s) in enumerate(zip(ours(gyro, accel), theirs(gyro, accel), strict=True)):
            square = np.sum((theirs_s - ours_s) ** 2, axis=1)
            largest[s] = max(largest[s], float(square.max()))
            total[s] += float(square.sum())
    gyro_max, accel_max = (math.sqrt(value) for value in largest)
    gyro_rms, accel_rms = (math.sqrt(value / n) for value in total)
    return CorrectionDifference(title, gyro_max, gyro_rms, accel_max, accel_rms)


def _sphere(n: int) -> Array:
    """Unit vectors on a spiral that gives each the same area, shape (n, 3)."""
    i = np.arange(n) + 0.5
    z = 1.0 - 2.0 * i / n
    angle = math.pi * (1.0 + math.sqrt(5.0)) * i
    radius = np.sqrt(1.0 - z**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
