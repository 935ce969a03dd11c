"""Type of the options that are units, and the units of both sensors, without those of counts."""

from __future__ import annotations

from typing import Any, Final

import click

GYRO_UNITS: Final = ("rad/s", "deg/s", "deg/h", "rad", "deg")
ACCEL_UNITS: Final = ("m/s^2", "g", "mg", "m/s", "g*s")


class Unit(click.Choice):  # type: ignore[type-arg]  # generic from click 8.2 on
    """Unit in any spelling that a file may use."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Unit as the choices spell it. An unknown one is wrong usage."""
        from srt.recording.import_options import normal_unit

        unit = normal_unit(value)
        chosen: str = super().convert(unit if unit in self.choices else value, param, ctx)
        return chosen
