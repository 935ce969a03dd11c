"""Text of a fleet: one row per unit, and every outlying value."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.comparison.outliers import EXPECTED_FALSE_FLAGS, MINIMUM_UNITS
from srt.reports.parameters import Units, group_heads, units_for, value_text
from srt.reports.tables import decimals_for, fixed, text_table, wrap
from srt.result.verdict import probability_text
from srt.sensor_errors import GROUP_SLICES, GROUPS, N_PARAMETERS, NAMES, SYMBOLS

if TYPE_CHECKING:
    from srt.comparison.fleet import Fleet, FleetUnit

_STATUS: Final = {"not_converged": "not conv.", "outside_model": "outside", "inconsistent": "inconsist."}
_SYMBOLS_SHOWN: Final = 3  # largest number of outlying parameters that a row names
_DIGITS: Final = 4  # largest number of significant digits of a value: eight columns fit within 80 characters


def fleet_text(fleet: Fleet) -> str:
    """Text of the whole report of a fleet, in lines of at most 80 characters, unless names of units are long."""
    parts = [
        f"Fleet of {len(fleet.units)} unit{'s' if len(fleet.units) != 1 else ''}\n{state_table(fleet)}",
        size_table(fleet),
        outlying_table(fleet),
        "\n".join(wrap(outlier_test_text(fleet))),
        _failures(fleet),
    ]
    return "\n\n".join(part for part in parts if part)


def state_table(fleet: Fleet) -> str:
    """Table of the units: status, verdict, parameters measured of 27, chi-square, warnings, outlying parameters."""
    rows = []
    for number, unit in enumerate(fleet.units):
        cells = [unit.name, unit.serial or "", _STATUS.get(unit.status, unit.status), *[""] * 6]
        if unit.calibration is not None:
            test = unit.calibration.consistency
            cells[3:8] = [
                unit.calibration.judgement.word,
                str(int(unit.calibration.observed.sum())),
                fixed(test.chi_square / test.degrees_of_freedom, 2) if test and test.degrees_of_freedom else "-",
                (test and probability_text(test.probability)) or "-",
                str(len(unit.calibration.warnings)),
            ]
            cells[8] = _outlying(fleet, number) if unit.sound else "not tested"
        rows.append(cells)
    headers = ["unit", "serial", "status", "verdict", f"of\n{N_PARAMETERS}", "chi2/\ndof", "p", "notes", "outlying"]
    return text_table(headers, rows, "llllrrrrl")


def size_table(fleet: Fleet) -> str:
    """Table of the largest error of every parameter group; empty if no unit has a calibration."""
    rows = [
        [unit.name, *(_largest(fleet, number, unit, group.name) for group in GROUPS)]
        for number, unit in enumerate(fleet.units)
        if unit.calibration is not None
    ]
    if not rows:
        return ""
    heads = group_heads(_units(fleet))
    text = text_table(["unit", *heads], rows, "l" + "r" * len(heads), gap=1)
    return f"Largest error of each parameter group (* a parameter of the group is outlying)\n{text}"


def outlying_table(fleet: Fleet) -> str:
    """Table of the outlying values with median and scatter of the other units; empty if there is none."""
    judged, units = fleet.outliers, _units(fleet)
    rows = []
    for number, unit in enumerate(fleet.units):
        for i in fleet.flagged(number):
            assert unit.calibration is not None
            factor = units.factors[i]
            sizes = [
                unit.calibration.errors.vector[i],
                unit.calibration.sigma[i],
                judged.others_median[number, i],
                judged.others_scatter[number, i],
            ]
            scale = np.hypot(sizes[1], sizes[3]) * factor
            shown = [fixed(float(size) * factor, decimals_for(scale)) for size in sizes]
            rows.append([unit.name, NAMES[i], *shown, units.names[i], f"{judged.z[number, i]:+.3g}"])
    if not rows:
        return ""
    headers = ["unit", "parameter", "value", "sigma", "others'\nmedian", "others'\nscatter", "unit", "z"]
    return f"Outlying\n{text_table(headers, rows, 'llrrrrlr', gap=1)}"


def outlier_test_text(fleet: Fleet) -> str:
    """Sentences on the outlier test: limit, number of units, false-alarm probability."""
    sound = sum(unit.sound for unit in fleet.units)
    limit = fleet.outliers.limit[np.isfinite(fleet.outliers.limit)]
    if not len(limit):
        return (
            f"The outlier test needs {MINIMUM_UNITS} converged units with a parameter in common, and there "
            f"{'is' if sound == 1 else 'are'} {sound}: no unit is tested."
        )
    low, high = f"{limit.min():.3g}", f"{limit.max():.3g}"
    reach = low if low == high else f"its limit, {low} to {high} by the number of units that have the parameter"
    few = int(np.sum(np.isnan(fleet.outliers.limit)))
    return (
        f"Each unit is compared with all others. A value is outlying if z exceeds {reach}. In a fleet of {sound} "
        f"units without outliers, the probability of any flag is at most {100.0 * EXPECTED_FALSE_FLAGS:.0f} %."
        + (f" {few} parameters are not tested: fewer than {MINIMUM_UNITS} units have them." if few else "")
    )


def _outlying(fleet: Fleet, number: int) -> str:
    found = fleet.flagged(number)
    more = [f"+{len(found) - _SYMBOLS_SHOWN}"] if len(found) > _SYMBOLS_SHOWN else []
    if not np.any(np.isfinite(fleet.outliers.z[number])):
        return "not tested"
    return " ".join([*(SYMBOLS[i] for i in found[:_SYMBOLS_SHOWN]), *more]) or "no"


def _largest(fleet: Fleet, number: int, unit: FleetUnit, group: str) -> str:
    """Largest value of a group, rounded to its sigma and to the width of the column."""
    assert unit.calibration is not None
    where = np.arange(len(NAMES))[GROUP_SLICES[group]]
    where = where[unit.calibration.observed[where]]
    if not len(where):
        return "fixed" if unit.calibration.has_values else "-"
    values = unit.calibration.errors.vector[where]
    i = int(where[np.argmax(np.abs(values))])
    value, sigma = float(unit.calibration.errors.vector[i]), float(unit.calibration.sigma[i])
    text = value_text(i, value, sigma, _units(fleet), _DIGITS)
    return text + ("*" if fleet.outliers.flagged[number, where].any() else "")


def _units(fleet: Fleet) -> Units:
    """Units for the values of all units that are sound; of all, where none is."""
    found = [unit for unit in fleet.units if unit.calibration is not None]
    shown = [unit for unit in found if unit.sound] or found
    return units_for(*(unit.calibration.values for unit in shown if unit.calibration is not None))


def _failures(fleet: Fleet) -> str:
    """Reasons of the units that failed."""
    lines = [line for unit in fleet.units if unit.exit_code for line in wrap(f"{unit.name}: {unit.message}", " ")]
    return "\n".join(["Failed", *lines]) if lines else ""
