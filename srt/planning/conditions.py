"""Conditions of a planned test: noise of the unit, site, errors of the fixture, and the priors that follow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import EARTH_RATE_RAD_S, STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError
from srt.noise.bias_instability import common_variance, shares_within
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from srt.types import Array

GRAVITY: Final = N_PARAMETERS
NORTH: Final = N_PARAMETERS + 1
N_UNKNOWNS: Final = N_PARAMETERS + 2
"""Unknowns of a planned test: the 27 sensor errors, then gravity (m/s²) and north (rad)."""
OWN_DRIFT: Final = shares_within(60.0)
"""Share of each drift process that counts as noise of one sequence while sequences are chosen; the rest counts as bias
of the whole test. Neighbouring sequences are less than 60 s apart."""
_EXACT_SIGMA: Final = 1e-12
"""Smallest sigma of gravity (m/s²) and north (rad): keeps the information finite where they are stated as exact."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Noise of the unit, site and fixture errors that limit the accuracy; SI, 1-sigma, the same for all axes.

    Attributes
    ----------
    gyro_white, accel_white : float
        Angle and velocity random walk, rad/√s and m/s²·√s.
    gyro_edge, accel_edge : float
        Standard deviation of one reading of the integral (quantization), rad and m/s.
    gyro_instability, accel_instability : float
        Bias instability: floor of the Allan deviation, rad/s and m/s².
    test_s : float
        Approximate length of the test, s: it determines the drift within the test.
    latitude_rad, heading_rad : float
        Latitude of the site; heading of the table x axis, clockwise from north.
    gravity_m_s2, gravity_sigma_m_s2 : float
    alignment_sigma_rad, rotation_sigma_rad : float
        Standard deviation of north, common to the whole test, and of the inner angle at the start of each sequence.

    Raises
    ------
    InputError
        A value that is negative or not finite, or gyros or accelerometers without noise.
    """

    gyro_white: float
    accel_white: float
    gyro_edge: float = 0.0
    accel_edge: float = 0.0
    gyro_instability: float = 0.0
    accel_instability: float = 0.0
    latitude_rad: float = math.pi / 4.0
    heading_rad: float = 0.0
    test_s: float = 900.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    gravity_sigma_m_s2: float = 5e-6
    alignment_sigma_rad: float = 1e-3
    rotation_sigma_rad: float = 1e-3

    def __post_init__(self) -> None:
        signed = {"latitude_rad", "heading_rad"}
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not math.isfinite(value) or (value < 0.0 and name not in signed):
                raise InputError(f"{name} of the plan's conditions is {value!r}: give a number not below zero.")
        for sensor in ("gyro", "accel"):
            if getattr(self, f"{sensor}_white") == 0.0 == getattr(self, f"{sensor}_edge"):
                raise InputError(
                    f"The {sensor} noise of the unit is zero: a plan weighs tests by their noise; "
                    "state the noise of the unit."
                )

    def earth_rate_base(self) -> Array:
        """Earth rate in components of the fixture base, shape (3,), rad/s."""
        north = EARTH_RATE_RAD_S * math.cos(self.latitude_rad)
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return np.array([north * c, -north * s, -EARTH_RATE_RAD_S * math.sin(self.latitude_rad)])

    def drift_variance(self) -> Array:
        """Variance that no test reduces, shape (27,), SI: the bias during one test differs from the long-term bias."""
        out = np.zeros(N_PARAMETERS)
        common = common_variance(1.0 - OWN_DRIFT, self.test_s)
        for sensor, floor in (("gyro", self.gyro_instability), ("accel", self.accel_instability)):
            out[GROUP_SLICES[f"{sensor}_bias"]] = floor**2 * common
        return out

    def prior(self) -> Array:
        """Information on gravity and north before the test, shape (N_UNKNOWNS,); zero for the sensor errors."""
        out = np.zeros(N_UNKNOWNS)
        out[GRAVITY] = 1.0 / max(self.gravity_sigma_m_s2, _EXACT_SIGMA) ** 2
        out[NORTH] = 1.0 / max(self.alignment_sigma_rad, _EXACT_SIGMA) ** 2
        return out
