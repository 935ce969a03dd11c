"""Text of the comparison with the calibration of another program: parameters in sigma, and residuals of both."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H
from srt.exceptions import clipped
from srt.reports.parameters import GROUP_STARTS, sigma_text, value_text
from srt.reports.tables import fixed, table, text_table, wrap
from srt.sensor_errors import DISPLAY_UNITS, NAMES, collapse_names

if TYPE_CHECKING:
    from srt.comparison.other_calibration import OtherCalibration

_HEAD: Final = 16
"""Most characters of the name of a file in a table, so that its lines have at most 80."""
_FAR: Final = 3.0
"""Difference in sigma from which a parameter is named."""
_EQUAL: Final = 0.02
"""Relative difference of two residuals that counts as none."""


def other_calibration_text(found: OtherCalibration, this: str, other: str, recording: str) -> str:
    """Tables of residuals and of parameters, in lines of at most 80 characters; the names are those of the files."""
    notes = [
        f"Residuals on {recording}, rms and largest: specific force at rest less gravity, rate at rest less the "
        f"Earth's ({found.windows} stationary windows), and the angle between gravity after a turn and its prediction "
        f"by the gyros ({found.turns} turns)."
    ]
    if any("bias" in group for group in found.absent):
        notes.append(f"{other} holds no biases: its residuals are those with the biases of {this}.")
    if not found.earth_removed:
        notes.append(
            "The gyros do not measure the Earth's rotation, so that the turns include it: 0.07 mrad/s at most."
        )
    if found.same_recording:
        notes.append(
            f"{this} was made from this recording, which favours it: compare on another recording of the unit."
        )
    legend = (
        f"Last column: {other} less {this}, in sigma of {this}, both in MARS axes; {other} states no sigma of its own. "
        "A '-' stands for what one of them does not hold."
    )
    heads = clipped(this, _HEAD), clipped(other, _HEAD)
    notes.insert(0, conclusion(found, this, other))
    parts = [residual_table(found, *heads), *("\n".join(wrap(note)) for note in notes)]
    return "\n".join([*parts, "", parameter_table(found, *heads), "", *wrap(legend)])


def conclusion(found: OtherCalibration, this: str, other: str) -> str:
    """Parameters that differ beyond 3 sigma, and which calibration leaves the smaller residual."""
    far = [name for name, z in zip(NAMES, found.normalised, strict=True) if abs(z) > _FAR]  # False for NaN
    compared = int(np.isfinite(found.normalised).sum())
    text = f"{len(far)} of {compared} parameters differ by more than {_FAR:g} sigma"
    text += f" ({', '.join(collapse_names(far))})" if far else ""
    ours, theirs = found.residuals["this"], found.residuals["other"]
    smaller: dict[str, list[str]] = {this: [], other: [], "neither": []}
    for part in ("force", "rate", "turn"):
        a, b = getattr(ours, part).rms, getattr(theirs, part).rms
        smaller["neither" if abs(a - b) <= _EQUAL * max(a, b) else this if a < b else other].append(part)
    text += "; smaller rms residual: " + ", ".join(
        f"{name} ({', '.join(parts)})" for name, parts in smaller.items() if parts
    )
    lacks = any("asymmetry" in group for group in found.absent) and any(
        found.calibration.errors.group(group).any() for group in ("gyro_asymmetry", "accel_asymmetry")
    )
    if lacks and smaller[this]:
        text += f". {other} has no place for the scale-factor asymmetry, which may be why its residuals are larger"
    return f"{text}."


def residual_table(found: OtherCalibration, this: str, other: str) -> str:
    """Table of the residuals of both calibrations, and of none."""
    fast = found.residuals["none"].rate.largest > DEG
    unit, factor = ("°/s", DEG) if fast else ("°/h", DEG_PER_H)
    rows = []
    for key, title in (("this", this), ("other", other), ("none", "no calibration")):
        each = found.residuals[key]
        columns = ((each.force, 1e-3), (each.rate, factor), (each.turn, 1e-3))
        rows.append([title, *(f"{v / scale:.3g}" for part, scale in columns for v in (part.rms, part.largest))])
    headers = ["residual", "force\nmm/s²", "largest", f"rate\n{unit}", "largest", "turn\nmrad", "largest"]
    return text_table(headers, rows, "lrrrrrr")


def parameter_table(found: OtherCalibration, this: str, other: str) -> str:
    """Table of the 27 parameters of both, and their difference in sigma."""
    rows = []
    for i, name in enumerate(NAMES):
        value, sigma = float(found.calibration.errors.vector[i]), float(found.calibration.sigma[i])
        ours = f"{value_text(i, value, sigma)}{' fixed' if math.isnan(sigma) else f'±{sigma_text(i, sigma)}'}"
        theirs = value_text(i, float(found.other.vector[i]), sigma) if found.held[i] else "-"
        rows.append([name, DISPLAY_UNITS[i], ours, theirs, fixed(float(found.normalised[i]), 1)])
    headers = ["parameter", "unit", this, other, "diff.,\nsigma"]
    return table(headers, rows, "llrrr", breaks=GROUP_STARTS).text()
