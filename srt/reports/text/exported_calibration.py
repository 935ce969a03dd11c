"""Text of an exported calibration: formula, axes, remaining difference and limits of the format."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.reports.tables import text_table, wrap

if TYPE_CHECKING:
    from srt.exporters.conversion import ExportedCalibration


def export_summary(made: ExportedCalibration) -> str:
    """Title, axes, largest difference from ``srt apply``, what the file does not hold, and advice; lines of 80."""
    # Programs whose file has no biases estimate them.
    difference = made.residuals[0] if made.format.biases else made.residuals[1]
    which = "" if made.format.biases else ", with the biases given beside the file"
    sentences = (
        f"Difference from srt apply on {made.readings.title}{which}: at most {difference.gyro_max:.1e} rad/s and "
        f"{difference.accel_max:.1e} m/s².",
        f"Not in the file: {'; '.join(made.losses)}.",
        *made.limits,
        *made.format.advice,
    )
    composed, lines = ([line for text in texts for line in wrap(text, "  ")] for texts in (_composed(made), sentences))
    return "\n".join([made.format.title, *composed, *(f"  {line}" for line in _axes(made)), *lines])


def _axes(made: ExportedCalibration) -> list[str]:
    """Lines on the axes of the file; if they are not MARS axes, with the rotation to them."""
    axes = {
        "mars": "MARS axes, those of the calibration",
        "table": "axes of the table-mounted frame",
        "accel": "axes that its accelerometer matrix defines",
    }[made.frame]
    lines = [f"axes: {axes}"]
    if made.frame != "mars":
        x, y, z = made.turn_mrad
        lines.append(f"turned from MARS axes by ({x:.4f}, {y:.4f}, {z:.4f}) mrad; v is C v there, C =")
        lines += ["  " + "  ".join(f"{value: .12f}" for value in row) for row in made.C_FB.tolist()]
    return lines


def _composed(made: ExportedCalibration) -> list[str]:
    """Line on the correction of the log with which a file is composed; empty without one."""
    if made.applied is None:
        return []
    which = "" if made.applied.instance is None else f" (IMU {made.applied.instance})"
    return [f"composed with the correction by {made.applied.system} that the log was made under{which}"]


def export_text(made: ExportedCalibration) -> str:
    """Formula, axes, difference from ``srt apply``, limits and advice.

    Lines have at most 80 characters but for formulas.
    """
    rows = [
        (r.title, *(f"{value:.3e}" for value in (r.gyro_max, r.gyro_rms, r.accel_max, r.accel_rms)))
        for r in made.residuals
    ]
    headers = ("difference from srt apply", "gyro max\nrad/s", "rms\nrad/s", "accel. max\nm/s^2", "rms\nm/s^2")
    lines = [f"{made.format.title}", f"formula: {made.format.formula}", *_axes(made), *_composed(made)]
    lines += [
        "",
        f"Difference on {made.readings.title}:",
        "",
        text_table(headers, rows, "lrrrr"),
        "",
        "Not in the file:",
        *(f"  {loss}" for loss in made.losses),
    ]
    if made.format.advice or made.limits:
        lines += ["", "Note:", *(f"  {sentence}" for sentence in (*made.limits, *made.format.advice))]
    return "\n".join(lines)
