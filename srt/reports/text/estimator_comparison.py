"""Text of a comparison of estimators: the verdict, one row each, then estimates and differences."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from srt.comparison.estimate_difference import FALSE_ALARM
from srt.reports.parameters import GROUP_STARTS, Units, sigma_text, units_for, value_text
from srt.reports.tables import fixed, table, text_table, wrap
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.comparison.estimate_difference import EstimateDifference
    from srt.comparison.estimator_comparison import Comparison


def comparison_text(comparison: Comparison, *, title: str = "Comparison", details: bool = False) -> str:
    """Verdict of a comparison, and its tables; ``details`` shows values and sigmas of all estimators.

    Lines have at most 80 characters with four estimators, 120 with details. ``title`` is the path of the recording.
    """
    serials = {c.provenance.serial for c in comparison.calibrations.values()} - {None}
    serial = f" (serial {serials.pop()})" if serials else ""
    reasons = [f"{name} failed: {reason}" for name, reason in comparison.failures.items()]
    reasons += [f"{name} is left out: {reason}" for name, reason in comparison.left_out.items()]
    reasons += [f"Note: {note}" for note in comparison.notes]
    parts = [
        [f"{title}{serial}: estimators side by side"],
        wrap(comparison.verdict),
        wrap(comparison.verdicts_differ),
        [estimator_table(comparison, details=details)],
        [line for reason in reasons for line in wrap(reason)],
        [parameter_table(comparison, details=details)],
        _legend(comparison),
        [truth_table(comparison)],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if any(lines))


def estimator_table(comparison: Comparison, *, details: bool) -> str:
    """Table of the estimators: status, time, and comparison with the reference."""
    heads = ["estimator", "status", "verdict", "time,\ns", "error/\nsigma", "sigma\nratio", "p", "agreement"]
    more = ["itera-\ntions", "ob-\nserved", "largest\ndiff.", "chi-\nsquare"]
    shown = [h for h in (*heads[:-1], *more, heads[-1]) if h != "error/\nsigma" or comparison.truth is not None]
    shown = [h for h in shown if details or h not in more]
    rows = []
    for name, calibration in comparison.calibrations.items():
        cells = {
            "estimator": name,
            "status": calibration.status.replace("_", " "),
            "verdict": calibration.judgement.word,
            "time,\ns": fixed(comparison.seconds.get(name, math.nan), 2),
            "error/\nsigma": fixed(comparison.rms_error(name), 2) if comparison.truth is not None else "-",
            "itera-\ntions": str(len(calibration.corrections)),
            "ob-\nserved": str(int(calibration.observed.sum())),
            **_compared(comparison.differences.get(name), name == comparison.reference),
        }
        rows.append([cells.get(head, "-") for head in shown])
    for name in comparison.failures:
        time_s = fixed(comparison.seconds.get(name, math.nan), 2)
        cells = {"estimator": name, "status": "failed", "time,\ns": time_s, "agreement": "no result"}
        rows.append([cells.get(head, "-") for head in shown])
    return text_table(shown, rows, "lll" + "r" * (len(shown) - 4) + "l")


def _compared(pair: EstimateDifference | None, is_reference: bool) -> dict[str, str]:
    """Cells of the comparison with the reference, by heading."""
    if is_reference:
        return {"sigma\nratio": "1.00", "agreement": "reference"}
    if pair is None or pair.largest is None:
        return {"agreement": "not compared"}
    return {
        "sigma\nratio": fixed(pair.efficiency, 2),
        "p": f"{pair.p_value:.2g}",
        "largest\ndiff.": fixed(abs(float(pair.normalised[pair.largest])), 1),
        "chi-\nsquare": fixed(pair.chi_square, 0),
        "agreement": "agrees" if pair.agrees else "differs",
    }


def parameter_table(comparison: Comparison, *, details: bool) -> str:
    """Table of the parameters: estimates with their sigmas, and normalised differences from the reference."""
    if not comparison.calibrations:
        return ""
    shown = comparison.calibrations
    if comparison.reference is not None and not details:
        shown = {comparison.reference: shown[comparison.reference]}
    rows, units = [], _units(comparison)
    for i, name in enumerate(NAMES):
        row = [name, units.names[i]]
        for calibration in shown.values():
            value, sigma = float(calibration.values[i]), float(calibration.sigma[i])
            known = "" if math.isnan(value) else " fixed" if math.isnan(sigma) else f"±{sigma_text(i, sigma, units)}"
            row.append(f"{value_text(i, value, sigma, units)}{known}")
        for pair in comparison.differences.values():
            value = float(pair.normalised[i])
            row.append("-" if math.isnan(value) else f"{round(value, 1) + 0.0:+.1f}{'*' if pair.differing[i] else ' '}")
        rows.append(row)
    headers = ["parameter", "unit", *shown, *(_head(name) for name in comparison.differences)]
    alignment = "ll" + "r" * (len(headers) - 2)
    return table(headers, rows, alignment, breaks=GROUP_STARTS).text()


def _units(comparison: Comparison) -> Units:
    return units_for(*(calibration.values for calibration in comparison.calibrations.values()))


def truth_table(comparison: Comparison) -> str:
    """Table of the truth and of every error over its sigma; empty without a truth."""
    if comparison.truth is None or not comparison.calibrations:
        return ""
    ratios = {name: comparison.error_over_sigma(name) for name in comparison.calibrations}
    best = comparison.calibrations[comparison.reference or next(iter(ratios))]
    rows, units = [], _units(comparison)
    for i, name in enumerate(NAMES):
        true = value_text(i, comparison.truth[name], float(best.sigma[i]), units)
        rows.append([name, units.names[i], true, *(fixed(float(ratio[i]), 2) for ratio in ratios.values())])
    shown = table(["parameter", "unit", "truth", *ratios], rows, "llr" + "r" * len(ratios), breaks=GROUP_STARTS)
    return f"Errors over sigma\n{shown.text()}"


def _legend(comparison: Comparison) -> Iterable[str]:
    pair = next(iter(comparison.differences.values()), None)
    if pair is None:
        return []
    return wrap(
        f"Last columns: estimate less {pair.reference}, over the expected standard deviation of that difference; "
        f"beyond {pair.limit:.1f} it is marked *. The false-alarm probability of all limits together is "
        f"{FALSE_ALARM:.0%} per recording."
    )


def _head(name: str) -> str:
    """Break a name at its hyphens, for a narrow column."""
    return name.replace("-", "-\n")
