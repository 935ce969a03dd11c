"""Texts of the parameters, in display units with two digits of sigma, and of the residuals, for all reports."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.reports.tables import Cell, decimals_for, fixed
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, GROUPS, INDEX, N_PARAMETERS, NAMES, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srt.result.calibration import Calibration, Residual
    from srt.types import Array

GROUP_STARTS: Final = frozenset(part.start for part in GROUP_SLICES.values())
"""Parameters that begin a group."""
_DIGITS: Final = 7  # largest number of significant digits of a value; the sigma of noise-free data would require more
_DECIMALS_FIXED: Final = 2  # decimals of a fixed parameter, which has no sigma
_SOLVED: Final = 1e-3  # fraction of sigma below which a component is solved exactly: solvers stop at 1e-2 sigma or less
_COARSE: Final = {"µg": ("mg", 1000.0, 1e4), "°/h": ("°/s", 3600.0, 1e3)}
"""Coarser unit, the number of finer ones in it, and the value from which a group is in it: beyond tactical units."""


@dataclass(frozen=True, slots=True)
class Units:
    """Units of the parameters in a report: names, and factors from SI, in the order of the state."""

    names: tuple[str, ...]
    factors: tuple[float, ...]


FINE: Final = Units(DISPLAY_UNITS, DISPLAY_FACTORS)
"""Units of limits, targets and tables without values."""


def units_for(*values: Array) -> Units:
    """Units of a report of values, shape (..., 27), SI: one for each group, by the largest value.

    A group with a value of 10 mg or 1000 °/h and more is in mg or °/s, as data sheets of such units state it.
    """
    names, factors = list(DISPLAY_UNITS), list(DISPLAY_FACTORS)
    # NaN: no value; of a fleet in which every unit failed there are none.
    largest = np.fmax.reduce(np.abs(np.vstack((np.zeros(N_PARAMETERS), *values))), axis=0) * DISPLAY_FACTORS
    for part in GROUP_SLICES.values():
        coarse = _COARSE.get(DISPLAY_UNITS[part.start])
        if coarse is not None and np.max(largest[part]) >= coarse[2]:
            name, ratio, _ = coarse
            names[part] = [name] * (part.stop - part.start)
            factors[part] = [factor / ratio for factor in factors[part]]
    return Units(tuple(names), tuple(factors))


def decimals_of(i: int, sigma: float, units: Units = FINE) -> int:
    """Decimals of parameter ``i`` in its unit: two digits of its sigma, SI; those of a fixed one where that is NaN."""
    if math.isnan(sigma):
        return _DECIMALS_FIXED + round(math.log10(DISPLAY_FACTORS[i] / units.factors[i]))
    return decimals_for(sigma * units.factors[i])


def value_text(i: int, value: float, sigma: float, units: Units = FINE, digits: int = _DIGITS) -> str:
    """Value of parameter ``i``, SI, in its unit, with the decimals of its sigma and at most some digits."""
    shown = value * units.factors[i]
    return fixed(shown, min(decimals_of(i, sigma, units), max(digits - len(f"{abs(shown):.0f}"), 0)))


def sigma_text(i: int, sigma: float, units: Units = FINE) -> str:
    """Sigma of parameter ``i``, SI, in its unit with two digits; "-" for NaN."""
    return fixed(sigma * units.factors[i], decimals_of(i, sigma, units))


def parameter_cells(calibration: Calibration) -> list[list[Cell]]:
    """Symbol, name, value, sigma and unit of the 27 parameters; "fixed" in place of the sigma of a fixed one.

    Values and sigmas of a calibration without a solution are "-".
    """
    values, sigmas = calibration.values.tolist(), calibration.as_written.sigma.tolist()
    units = units_for(calibration.values)
    return [
        [
            Cell(SYMBOLS[i]),
            Cell(name),
            Cell(value_text(i, values[i], sigmas[i], units), values[i] if calibration.has_values else None),
            Cell("-")
            if not calibration.has_values
            else Cell("fixed", mark="held")
            if name in calibration.fixed
            else Cell(sigma_text(i, sigmas[i], units), sigmas[i]),
            Cell(units.names[i]),
        ]
        for i, name in enumerate(NAMES)
    ]


def group_heads(units: Units = FINE) -> list[str]:
    """Headings of the groups with their units."""
    return [f"{group.heading}\n{units.names[GROUP_SLICES[group.name].start]}" for group in GROUPS]


def group_sigmas(sigma: Array, units: Units = FINE) -> list[str]:
    """Largest sigma of each group in its unit, three digits; "-" where not all are observed."""
    out = []
    for part in GROUP_SLICES.values():
        largest = float(sigma[part].max()) * units.factors[part.start]
        out.append("-" if not math.isfinite(largest) else f"{largest:.3g}" if largest < 1e4 else f"{largest:.1e}")
    return out


def symbols(names: Iterable[str]) -> str:
    """Symbols of parameters, with blanks between them."""
    return " ".join(SYMBOLS[INDEX[name]] for name in names)


def fixed_by_reason(calibration: Calibration) -> dict[str, list[str]]:
    """Names of the fixed parameters by reason."""
    reasons: dict[str, list[str]] = {}
    for name, reason in calibration.fixed.items():
        reasons.setdefault(reason, []).append(name)
    return reasons


def unsolved(residuals: Iterable[Residual]) -> list[Residual]:
    """Residuals that are not solved exactly, of those with a sigma."""
    return [r for r in residuals if r.sigma > 0.0 and abs(r.value) > _SOLVED * r.sigma]


def rms_over_sigma(residuals: Sequence[Residual]) -> float:
    """Root mean square of residuals over their sigmas."""
    return math.sqrt(sum((r.value / r.sigma) ** 2 for r in residuals) / len(residuals))
