"""Texts of a calibration over temperature: each parameter at five temperatures, and what a file does not hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.reports.parameters import GROUP_STARTS, sigma_text, units_for, value_text
from srt.reports.tables import text_table, wrap
from srt.reports.text.calibration_summary import verdict_lines
from srt.sensor_errors import NAMES, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.exporters.thermal_offsets import ThermalFile
    from srt.result.calibration import Calibration
    from srt.result.thermal_errors import ThermalErrors

COLUMNS: Final = 5
"""Temperatures of the table: the ends of the range, and those between in equal steps."""


def thermal_text(calibration: Calibration, *, title: str = "Thermal calibration") -> str:
    """Verdict, notes, and values at five temperatures with their largest sigma, in lines of at most 80 characters."""
    thermal = calibration.thermal
    assert thermal is not None
    lines = [*verdict_lines(calibration, title), *calibration.warnings]
    return "\n".join([*(line for text in lines for line in wrap(text)), "", *thermal_table(calibration, thermal)])


def temperatures(thermal: ThermalErrors) -> Sequence[float]:
    """Temperatures of the table, °C."""
    return [float(T) for T in np.linspace(thermal.lowest_c, thermal.highest_c, COLUMNS)]


def thermal_table(calibration: Calibration, thermal: ThermalErrors) -> list[str]:
    """Table of the parameters at five temperatures, and its legend."""
    shown = [calibration.at(T) for T in temperatures(thermal)]
    values = np.stack([each.errors.vector for each in shown])
    sigma = np.stack([each.sigma for each in shown])
    units = units_for(*values)
    rows: list[Sequence[str] | None] = []
    for i, name in enumerate(NAMES):
        if i and i in GROUP_STARTS:
            rows.append(None)
        if name in calibration.fixed:
            rows.append([SYMBOLS[i], "fixed", *("" for _ in shown), "", units.names[i]])
            continue
        largest = float(sigma[:, i].max())
        at = [value_text(i, float(value), largest, units) for value in values[:, i]]
        rows.append([SYMBOLS[i], f"{thermal.degree[i]:.0f}", *at, sigma_text(i, largest, units), units.names[i]])
    head = ["", "deg.", *(f"{T:.0f} °C" for T in temperatures(thermal)), "sigma", "unit"]
    table = text_table(head, rows, "lr" + "r" * COLUMNS + "rl", gap=1)
    legend = "sigma: the largest over the range, for a later visit; deg.: degree of the curve that the tests show."
    return [table, "", *wrap(legend)]


def thermal_file_text(made: ThermalFile) -> str:
    """Text on the parts of the curves that the parameter file of an autopilot leaves out, 80 characters wide."""
    rows: list[Sequence[str] | None] = []
    for s, (sensor, factor, unit) in enumerate((("gyro", 206264.8, "°/h"), ("accel", 1e6 / 9.80665, "µg"))):
        for axis in range(3):
            cells = [f"{factor * part[s, axis]:.3g}" for part in (made.residual, made.step)]
            rows.append([f"{sensor} {'xyz'[axis]}", *cells, unit])
    table = text_table(["offset", "off the curve", "step of 1 K", "unit"], rows, "lrrl", gap=2)
    gyro, accel = made.lost
    lost = (
        "Not held: scale factors and misalignments over temperature, up to "
        f"{206264.8 / 3600.0 * gyro:.3g} °/s at 1 rad/s and {1e3 / 9.80665 * accel:.3g} mg at 1 g over the range."
    )
    return "\n".join([table, "", *wrap(lost)])
