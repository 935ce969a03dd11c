"""Text of a comparison of estimators: one row each, then estimates, differences and the verdict."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from srt.comparison.estimate_difference import FALSE_ALARM
from srt.reports.text.tables import decimals_for, fixed, text_table, wrap
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srt.comparison.estimate_difference import EstimateDifference
    from srt.comparison.estimator_comparison import Comparison


def comparison_text(comparison: Comparison, *, title: str = "Comparison") -> str:
    """Tables of a comparison, and its verdict.

    Parameters
    ----------
    comparison : Comparison
    title : str
        Title: the path of the recording.

    Returns
    -------
    str
        Lines of at most 120 characters with four estimators, without a line feed at the end.
    """
    serials = {c.provenance.get("serial") for c in comparison.calibrations.values()} - {None}
    serial = f" (serial {serials.pop()})" if serials else ""
    reasons = [f"{name} failed: {reason}" for name, reason in comparison.failures.items()]
    reasons += [f"{name} is left out: {reason}" for name, reason in comparison.left_out.items()]
    reasons += [f"Note: {note}" for note in comparison.notes]
    parts = [
        [f"{title}{serial}: estimators side by side"],
        [estimator_table(comparison)],
        [line for reason in reasons for line in wrap(reason)],
        [parameter_table(comparison)],
        _legend(comparison),
        [truth_table(comparison)],
        wrap(comparison.verdict),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if any(lines))


def estimator_table(comparison: Comparison) -> str:
    """Table of the estimators: status, time, and comparison with the reference."""
    truth = ["error/\nsigma"] if comparison.truth is not None else []
    headers = ["estimator", "status", "verdict", "itera-\ntions", "seconds", "ob-\nserved", *truth]
    headers += ["sigma\nratio", "largest\ndiff.", "chi-\nsquare", "proba-\nbility", "agree-\nment"]
    rows = []
    for name, calibration in comparison.calibrations.items():
        pair = comparison.differences.get(name)
        rows.append(
            [
                name,
                calibration.status.replace("_", " "),
                calibration.judgement.word,
                str(len(calibration.corrections)),
                fixed(comparison.seconds.get(name, math.nan), 2),
                str(int(calibration.observed.sum())),
                *(fixed(comparison.rms_error(name), 2) for _ in truth),
                *_compared(pair, name == comparison.reference),
            ]
        )
    for name in comparison.failures:
        nothing = ["-"] * (len(headers) - 6)
        rows.append([name, "failed", "-", "-", fixed(comparison.seconds.get(name, math.nan), 2), *nothing, "no result"])
    return text_table(headers, rows, "lll" + "r" * (len(headers) - 4) + "l")


def _compared(pair: EstimateDifference | None, is_reference: bool) -> list[str]:
    """Cells of the comparison with the reference."""
    if is_reference:
        return ["1.00", "-", "-", "-", "reference"]
    if pair is None or pair.largest is None:
        return ["-", "-", "-", "-", "not compared"]
    return [
        fixed(pair.efficiency, 2),
        fixed(abs(float(pair.normalised[pair.largest])), 1),
        fixed(pair.chi_square, 0),
        f"{pair.p_value:.2g}",
        "agrees" if pair.agrees else "differs",
    ]


def parameter_table(comparison: Comparison) -> str:
    """Table of the parameters: estimates with their sigmas, and normalised differences from the reference."""
    if not comparison.calibrations:
        return ""
    rows: list[Sequence[str] | None] = []
    for i, name in enumerate(NAMES):
        row = [name, DISPLAY_UNITS[i]]
        for calibration in comparison.calibrations.values():
            factor = DISPLAY_FACTORS[i]
            row.append(_estimate(float(calibration.errors.vector[i]) * factor, float(calibration.sigma[i]) * factor))
        for pair in comparison.differences.values():
            value = float(pair.normalised[i])
            row.append("-" if math.isnan(value) else f"{round(value, 1) + 0.0:+.1f}{'*' if pair.differing[i] else ' '}")
        rows.append(row)
    headers = ["parameter", "unit", *comparison.calibrations, *(_head(name) for name in comparison.differences)]
    alignment = "ll" + "r" * (len(headers) - 2)
    return text_table(headers, _grouped(rows), alignment)


def truth_table(comparison: Comparison) -> str:
    """Table of the truth and of every error over its sigma; empty without a truth."""
    if comparison.truth is None or not comparison.calibrations:
        return ""
    ratios = {name: comparison.error_over_sigma(name) for name in comparison.calibrations}
    best = comparison.calibrations[comparison.reference or next(iter(ratios))]
    rows: list[Sequence[str] | None] = []
    for i, name in enumerate(NAMES):
        sigma = float(best.sigma[i]) * DISPLAY_FACTORS[i]
        true = fixed(comparison.truth[name] * DISPLAY_FACTORS[i], 2 if math.isnan(sigma) else decimals_for(sigma))
        rows.append([name, DISPLAY_UNITS[i], true, *(fixed(float(ratio[i]), 2) for ratio in ratios.values())])
    table = text_table(["parameter", "unit", "truth", *ratios], _grouped(rows), "llr" + "r" * len(ratios))
    return f"Errors over sigma\n{table}"


def _legend(comparison: Comparison) -> Iterable[str]:

    pair = next(iter(comparison.differences.values()), None)
    if pair is None:
        return []
    return wrap(
        f"Last columns: estimate less {pair.reference}, over the expected standard deviation of that difference; "
        f"beyond {pair.limit:.1f} it is marked *. The false-alarm probability of all limits together is "
        f"{FALSE_ALARM:.0%} per recording."
    )


def _estimate(value: float, sigma: float) -> str:
    """Format value±sigma in display units, with two digits of sigma."""
    if math.isnan(sigma):
        return f"{fixed(value, 2)} fixed"
    decimals = decimals_for(sigma)
    return f"{fixed(value, decimals)}±{fixed(sigma, decimals)}"


def _head(name: str) -> str:
    """Break a name at its hyphens, for a narrow column."""
    return name.replace("-", "-\n")


def _grouped(rows: Sequence[Sequence[str] | None]) -> list[Sequence[str] | None]:
    """Rows of the 27 parameters, with an empty row between groups."""
    out: list[Sequence[str] | None] = []
    for group in GROUP_SLICES.values():
        out += [*([None] if out else []), *rows[group]]
    return out
