"""Sigmas of a test sequence by sequence: the largest of each group of parameters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.reports.text.tables import text_table, wrap
from srt.result.verdict import probability_text
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES

if TYPE_CHECKING:
    from srt.result.calibration import Calibration
    from srt.types import Array

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


def live_table(calibration: Calibration) -> str:
    """Sigmas after each sequence of a live filter; empty without one."""
    reports = calibration.diagnostics.live
    if not reports:
        return ""
    rows = [[report.sequence, probability_text(report.probability), *group_sigmas(report.sigma)] for report in reports]
    met = next((report.sequence for report in reports if report.targets_met), None)
    lines = [
        *wrap("Largest 1-sigma of each group after each sequence; p of its innovations given all sequences before"),
        text_table(["seq.", "p", *group_heads()], rows, "lr" + "r" * len(GROUP_SLICES), gap=1),
    ]
    if calibration.diagnostics.targets:
        lines += wrap("The targets are not met." if met is None else f"All targets are met after sequence {met}.")
    return "\n".join(lines)


def group_heads() -> list[str]:
    """Headings of the groups with their display units."""
    return [f"{_HEADS[name]}\n{DISPLAY_UNITS[part.start]}" for name, part in GROUP_SLICES.items()]


def group_sigmas(sigma: Array) -> list[str]:
    """Largest sigma of each group in its display unit, three digits; "-" where not all are observed."""
    out = []
    for part in GROUP_SLICES.values():
        largest = float(np.max(sigma[part])) * DISPLAY_FACTORS[part.start]
        out.append("-" if not math.isfinite(largest) else f"{largest:.3g}" if largest < 1e4 else f"{largest:.1e}")
    return out
