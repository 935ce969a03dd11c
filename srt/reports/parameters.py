"""Texts of the parameters, in display units with two digits of sigma, and of the residuals, for all reports."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from srt.reports.tables import Cell, decimals_for, fixed
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, INDEX, NAMES, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srt.result.calibration import Calibration, Residual
    from srt.types import Array

GROUP_STARTS: Final = frozenset(part.start for part in GROUP_SLICES.values())
"""Parameters that begin a group."""
_DIGITS: Final = 7  # largest number of significant digits of a value; the sigma of noise-free data would require more
_DECIMALS_FIXED: Final = 2  # decimals of a fixed parameter, which has no sigma
_SOLVED: Final = 1e-3  # fraction of sigma below which a component is solved exactly: solvers stop at 1e-2 sigma or less
_HEADS: Final = {
    "gyro_scale": "gyro\nscale",
    "gyro_asymmetry": "gyro\nasym.",
    "gyro_orthogonality": "gyro\northo.",
    "accel_bias": "accel\nbias",
    "accel_scale": "accel\nscale",
    "accel_asymmetry": "accel\nasym.",
    "accel_misalignment": "mis-\nalign.",
    "gyro_bias": "gyro\nbias",
}


def decimals_of(i: int, sigma: float) -> int:
    """Decimals of parameter ``i`` in its display unit: two digits of its sigma, SI; 2 where that is NaN."""
    return _DECIMALS_FIXED if math.isnan(sigma) else decimals_for(sigma * DISPLAY_FACTORS[i])


def value_text(i: int, value: float, sigma: float, digits: int = _DIGITS) -> str:
    """Value of parameter ``i``, SI, in its display unit, with the decimals of its sigma and at most some digits."""
    shown = value * DISPLAY_FACTORS[i]
    return fixed(shown, min(decimals_of(i, sigma), max(digits - len(f"{abs(shown):.0f}"), 0)))


def sigma_text(i: int, sigma: float) -> str:
    """Sigma of parameter ``i``, SI, in its display unit with two digits; "-" for NaN."""
    return fixed(sigma * DISPLAY_FACTORS[i], decimals_of(i, sigma))


def parameter_cells(calibration: Calibration) -> list[list[Cell]]:
    """Symbol, name, value, sigma and unit of the 27 parameters; "fixed" in place of the sigma of a fixed one."""
    values, sigmas = calibration.errors.vector.tolist(), calibration.sigma.tolist()
    return [
        [
            Cell(SYMBOLS[i]),
            Cell(name),
            Cell(value_text(i, values[i], sigmas[i]), values[i]),
            Cell("fixed", mark="held") if name in calibration.held else Cell(sigma_text(i, sigmas[i]), sigmas[i]),
            Cell(DISPLAY_UNITS[i]),
        ]
        for i, name in enumerate(NAMES)
    ]


def group_heads() -> list[str]:
    """Headings of the groups with their display units."""
    return [f"{_HEADS[name]}\n{DISPLAY_UNITS[part.start]}" for name, part in GROUP_SLICES.items()]


def group_sigmas(sigma: Array) -> list[str]:
    """Largest sigma of each group in its display unit, three digits; "-" where not all are observed."""
    out = []
    for part in GROUP_SLICES.values():
        largest = float(sigma[part].max()) * DISPLAY_FACTORS[part.start]
        out.append("-" if not math.isfinite(largest) else f"{largest:.3g}" if largest < 1e4 else f"{largest:.1e}")
    return out


def symbols(names: Iterable[str]) -> str:
    """Symbols of parameters, with blanks between them."""
    return " ".join(SYMBOLS[INDEX[name]] for name in names)


def fixed_by_reason(calibration: Calibration) -> dict[str, list[str]]:
    """Names of the fixed parameters by reason."""
    reasons: dict[str, list[str]] = {}
    for name, reason in calibration.held.items():
        reasons.setdefault(reason, []).append(name)
    return reasons


def unsolved(residuals: Iterable[Residual]) -> list[Residual]:
    """Residuals that are not solved exactly, of those with a sigma."""
    return [r for r in residuals if r.sigma > 0.0 and abs(r.value) > _SOLVED * r.sigma]


def rms_over_sigma(residuals: Sequence[Residual]) -> float:
    """Root mean square of residuals over their sigmas."""
    return math.sqrt(sum((r.value / r.sigma) ** 2 for r in residuals) / len(residuals))
