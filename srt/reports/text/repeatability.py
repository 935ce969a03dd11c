"""Text of the repeatability over recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.reports.parameters import Units, sigma_text, units_for, value_text
from srt.reports.tables import continued_tables, decimals_for, fixed, text_table, wrap
from srt.result.verdict import probability_text
from srt.sensor_errors import GROUP_SLICES, INDEX, SYMBOLS

if TYPE_CHECKING:
    from srt.result.calibration import Calibration
    from srt.result.repeatability import Repeatability


def repeatability_text(calibration: Calibration) -> str:
    """Text of the repeatability of a merged calibration; empty if it was not merged.

    Lines have at most 80 characters, as far as the recordings' names allow.
    """
    table = calibration.diagnostics.repeatability
    if table is None:
        return ""
    units = units_for(calibration.errors.vector)
    parts = [f"Recordings\n{_recordings(table)}", f"Values by recording\n{_values(table, units)}"]
    if table.degrees_of_freedom:
        parts.append(f"Repeatability\n{_scatter(table, units)}")
        parts.append("\n".join(part for line in _groups(table, units) for part in wrap(line)))
    return "\n\n".join(parts)


def _recordings(table: Repeatability) -> str:
    rows = [
        [
            row.name,
            row.estimator,
            row.status.replace("_", " "),
            row.date or "-",
            "-" if row.temperature_c is None else f"{row.temperature_c:.1f}",
        ]
        for row in table.recordings
    ]
    rows += [[row.name, "", f"{row.status.replace('_', ' ')}, left out", "", ""] for row in table.left_out]
    return text_table(["name", "estimator", "status", "date", "°C"], rows, "llllr")


def _values(table: Repeatability, units: Units) -> str:
    """Tables of value and sigma by recording, as many recordings side by side as the width permits."""
    left = [[SYMBOLS[INDEX[row.name]], units.names[INDEX[row.name]]] for row in table.parameters]
    groups = []
    for n, recording in enumerate(table.recordings):
        cells = []
        for row in table.parameters:
            i, value, sigma = INDEX[row.name], row.values[n], row.sigmas[n]
            cells.append(
                ("held", "")
                if value is None or sigma is None
                else (value_text(i, value, sigma, units), sigma_text(i, sigma, units))
            )
        groups.append([(recording.name, [value for value, _ in cells]), ("sigma", [sigma for _, sigma in cells])])
    return "\n\n".join(continued_tables(["", "unit"], left, groups, "ll"))


def _scatter(table: Repeatability, units: Units) -> str:
    rows: list[list[str] | None] = []
    for row in table.parameters:
        freedom = row.degrees_of_freedom
        away = row.largest_deviation
        if away is None or row.spread is None:
            continue
        i = INDEX[row.name]
        factor, sigma = units.factors[i], min(s for s in row.sigmas if s is not None)
        decimals = decimals_for(sigma * factor)
        rows.append(
            [
                SYMBOLS[i],
                units.names[i],
                value_text(i, row.weighted_mean, sigma, units),
                fixed(row.spread * factor, decimals),
                sigma_text(i, sigma, units),
                f"{row.chi_square:.1f} / {freedom}",
                probability_text(row.probability),
                f"{away.sigmas:+.1f} {away.recording}",
            ]
        )
    headers = ["", "unit", "mean", "scatter", "least\nsigma", "chi2 / dof", "p", "farthest"]
    notes = [
        "scatter: standard deviation of the values over the recordings; expected to be about their sigma.",
        "chi2 / dof: chi-square of the values about their mean, and its degrees of freedom; errors common to all "
        "recordings, such as gravity, are not counted.",
        "p: probability that noise alone gives a larger chi2.",
        "farthest: the recording with the largest deviation from the mean, over the sigma of the deviation.",
    ]
    return "\n".join(
        [text_table(headers, rows, "llrrrrrl", gap=1), *(line for note in notes for line in wrap(note, " "))]
    )


def _groups(table: Repeatability, units: Units) -> list[str]:
    """Sentences on the variation between recordings beyond noise."""
    found = []
    for row in table.groups:
        if row.between_sigma > 0.0:
            i = GROUP_SLICES[row.group].start
            size = row.between_sigma * units.factors[i]
            words = f"{row.group.replace('_', ' ')} {fixed(size, decimals_for(size))} {units.names[i]}"
            found.append(f"{words} (p = {probability_text(row.probability)})")
    whole = (
        f"All parameters together: chi-square {table.chi_square:.4g} for {table.degrees_of_freedom} degrees of "
        f"freedom, p = {probability_text(table.probability)}."
    )
    if not found:
        return [whole, "Noise explains all differences between the recordings."]
    return [
        whole,
        f"Standard deviation between recordings beyond noise, included in the merged sigmas: {'; '.join(found)}. "
        "Expect another recording to differ from the merged value by as much.",
    ]
