"""Wrong units: factors between readings and truth when a recording declares another unit than it holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2

_G: Final = STANDARD_GRAVITY_M_S2


@dataclass(frozen=True, slots=True)
class WrongUnit:
    """One wrong unit.

    Attributes
    ----------
    factor : float
        Reading over truth.
    unit, declared : str
        True unit of the readings, and the declared one.
    fault : str
        Fault of the diagnosis (:mod:`srt.diagnosis.units`).
    rates_only : bool
        True if increments have no such unit.
    """

    factor: float
    unit: str
    declared: str
    fault: str
    rates_only: bool = True

    def __str__(self) -> str:
        return f"the values look like {self.unit}, declared as {self.declared}"


WRONG_UNITS: Final[dict[str, tuple[WrongUnit, ...]]] = {
    "gyro": (
        WrongUnit(1.0 / DEG, "degrees", "radians", "gyro_degrees", rates_only=False),
        WrongUnit(DEG, "radians", "degrees", "gyro_radians", rates_only=False),
        WrongUnit(1e3, "thousandths", "units", "gyro_milli", rates_only=False),
        WrongUnit(1.0 / DEG_PER_H, "deg/h", "rad/s", "gyro_per_hour"),
        WrongUnit(DEG / DEG_PER_H, "deg/h", "deg/s", "gyro_per_hour"),
        WrongUnit(DEG_PER_H / DEG, "deg/s", "deg/h", "gyro_per_hour"),
        WrongUnit(DEG_PER_H, "rad/s", "deg/h", "gyro_per_hour"),
        WrongUnit(60.0 / (360.0 * DEG), "revolutions per minute", "rad/s", "gyro_other_unit"),
    ),
    "accel": (
        WrongUnit(1.0 / _G, "g", "m/s²", "accel_g", rates_only=False),
        WrongUnit(1e-3, "g", "mg", "accel_g"),
        WrongUnit(1e3 / _G, "mg", "m/s²", "accel_mg", rates_only=False),
        WrongUnit(1e3, "mg", "g", "accel_mg"),
        WrongUnit(_G, "m/s²", "g", "accel_m_s2", rates_only=False),
        WrongUnit(1e-3 * _G, "m/s²", "mg", "accel_m_s2"),
        WrongUnit(1e3, "mm/s²", "m/s²", "accel_other_unit"),
        WrongUnit(100.0, "cm/s²", "m/s²", "accel_other_unit"),
        WrongUnit(1.0 / 0.3048, "ft/s²", "m/s²", "accel_other_unit"),
    ),
}
"""Factors far beyond the errors of an uncalibrated IMU."""
