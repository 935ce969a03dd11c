"""Uncertainty statements of a certificate (GUM): coverage, and the budget by source."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from srt.reports.tables import Table, decimals_for, fixed, table
from srt.reports.text.calibration import source_label
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES

if TYPE_CHECKING:
    from srt.result.calibration import Calibration


def coverage_probability(factor: float) -> float:
    """Probability of a normal distribution within ± ``factor`` standard deviations."""
    return math.erf(factor / math.sqrt(2.0))


def coverage_note(factor: float) -> str:
    """Sentence on the expanded uncertainty."""
    return (
        f"U: expanded uncertainty, the standard uncertainty sigma times the coverage factor k = {factor:g}. For a "
        f"normal distribution, value ± U has a coverage probability of {100.0 * coverage_probability(factor):.3g} %. "
        "Determined according to the GUM (JCGM 100)."
    )


def budget_table(calibration: Calibration, factor: float) -> Table | None:
    """Table of the sources of sigma, root mean square of each group; None without sources."""
    observed = calibration.observed
    parts = {name: np.flatnonzero(observed[part]) + part.start for name, part in GROUP_SLICES.items()}
    parts = {name: part for name, part in parts.items() if part.size}
    sources = {name: size for name, size in calibration.contributions.items() if np.any(size[observed] > 0.0)}
    if not sources or not parts:
        return None
    sigma = calibration.sigma
    rows = []
    for name, part in parts.items():
        scale = DISPLAY_FACTORS[part[0]]
        total = float(np.sqrt(np.mean(sigma[part] ** 2))) * scale
        decimals = decimals_for(total)
        sizes = [float(np.sqrt(np.mean(size[part] ** 2))) * scale for size in sources.values()]
        texts = [fixed(size, decimals) for size in (*sizes, total, factor * total)]
        rows.append([name.replace("_", " "), DISPLAY_UNITS[part[0]], *texts])
    head = ("group", "unit", *map(source_label, sources), "combined", f"U (k = {factor:g})")
    note = (
        "Each entry is the standard uncertainty by one source, root mean square over the group. The combined one is "
        "the root of the sum of squares of its row. Stated noise and references are type B, noise from the stationary "
        "windows is type A. The covariance of all parameters is in the calibration file."
    )
    return table(head, rows, "ll" + "r" * (len(sources) + 2), title="Uncertainty budget", note=note)
