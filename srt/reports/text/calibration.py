"""Text of a calibration: values and sigmas in display units, sources of error, verdict and warnings."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from srt.constants import DEG_PER_H
from srt.ranking import significant
from srt.reports.parameters import (
    FINE,
    GROUP_STARTS,
    Units,
    decimals_of,
    fixed_by_reason,
    parameter_cells,
    rms_over_sigma,
    sigma_text,
    units_for,
    unsolved,
    value_text,
)
from srt.reports.tables import Cell, Table, continued_tables, decimals_for, fixed, table, text_table, wrap
from srt.reports.text.leave_one_out import verdict_text
from srt.result.verdict import p_value_text
from srt.sensor_errors import DISPLAY_UNITS, INDEX, N_PARAMETERS, NAMES, SYMBOLS, collapse_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from srt.result.calibration import Calibration
    from srt.result.diagnostics import Estimate
    from srt.sensor_errors import SensorErrors
    from srt.types import Array


SOURCE_LABELS: Final = {
    "gyro_noise": "gyro noise",
    "gyro_quantization": "gyro quant.",
    "gyro_bias_instability": "gyro drift",
    "gyro_undersampling": "too slow",
    "accel_noise": "acc. noise",
    "accel_quantization": "acc. quant.",
    "accel_bias_instability": "acc. drift",
    "earth_rate_alignment": "Earth rate",
    "stated_vertical": "vertical",
    "stated_rate": "table rate",
    "gravity": "gravity",
    "clock": "time base",
    "latitude": "latitude",
    "prior": "prior",
    "held_values": "fixed values",
    "recordings": "recordings",
    "between_recordings": "betw. rec.",
}
"""Short names of the sources of error; a source that is not listed has its own name."""

_LARGEST: Final = 3  # number of sources of error in the short table
_SIGNIFICANT: Final = 0.05  # p-value below which asymmetries count as significant, the customary one


def report(
    calibration: Calibration,
    *,
    title: str,
    truth: SensorErrors | None = None,
    budget: bool = False,
    verdict: bool = False,
) -> str:
    """Text of the whole report, in lines of at most 80 characters, without a line feed at the end.

    ``title`` is that of the recording; ``truth`` adds columns of the truth, the error, and the error over sigma;
    ``budget`` shows all sources of error as columns instead of the three largest; ``verdict`` adds the verdict by
    parameter.
    """
    calibration = calibration.as_written
    parts = [
        "\n".join(_heading(calibration, title)),
        parameter_table(calibration, truth).text(gap=1 if truth is not None else 2),
        "\n".join(_held(calibration)),
        g_sensitivity_table(calibration),
        budget_table(calibration) if budget else contribution_table(calibration),
        verdict_text(calibration, parameters=verdict),
        "\n".join(_asymmetry(calibration)),
        "\n".join(_unseen_errors(calibration)),
        "\n".join(_notes(calibration)),
    ]
    return "\n\n".join(part for part in parts if part)


def parameter_table(calibration: Calibration, truth: SensorErrors | None = None) -> Table:
    """Table of the 27 values; the truth adds columns of it, of the error, and of the error over sigma."""
    rows, units = parameter_cells(calibration), units_for(calibration.values)
    if truth is None:
        return table(("symbol", "parameter", "value", "sigma", "unit"), rows, "llrrl", breaks=GROUP_STARTS)
    compared: list[list[Cell | str]] = []
    for i, row in enumerate(rows):
        true, sigma = float(truth.vector[i]), float(calibration.sigma[i])
        error = float(calibration.values[i]) - true
        over = math.nan if NAMES[i] in calibration.fixed or sigma == 0.0 else error / sigma
        shown = fixed(error * units.factors[i], decimals_of(i, sigma, units))
        compared.append([*row, value_text(i, true, sigma, units), shown, fixed(over, 2)])
    heads = ("", "parameter", "value", "sigma", "unit", "truth", "error", "error/\nsigma")
    return table(heads, compared, "llrrlrrr", breaks=GROUP_STARTS)


def g_sensitivity_table(calibration: Calibration) -> str:
    """Table of the gyro g-sensitivity and of the scatter of the stationary rates; empty if not estimated."""
    found = calibration.diagnostics.g_sensitivity
    if found is None:
        return ""
    matrix, sigma = found.matrix_deg_per_h_per_g.tolist(), found.sigma_deg_per_h_per_g.tolist()
    scatter = found.rest_rate_scatter_rad_s
    decimals = decimals_for(min(max(row) for row in sigma))
    rows = []
    for i, axis in enumerate("xyz"):
        elements = [f"{fixed(v, decimals)} ± {fixed(s, decimals)}" for v, s in zip(matrix[i], sigma[i], strict=True)]
        rates = [fixed(float(rates[i]) / DEG_PER_H, 2) for rates in (scatter.before, scatter.after, scatter.expected)]
        rows.append([f"gyro {axis}", *elements, *rates])
    heads = ["°/h per g", *(f"along {axis}" for axis in "xyz"), "scatter\n°/h", "\nafter", "\nexpected"]
    table = text_table(heads, rows, "lrrrrrr", gap=1)
    return f"Gyro g-sensitivity, and scatter of the rest rates before and after it\n{table}"


def contribution_table(calibration: Calibration) -> str:
    """Table of the largest sources of error of every observed parameter; empty without sources."""
    if not calibration.contributions:
        return ""
    rows, units = [], units_for(calibration.errors.vector)
    for i in _observed(calibration):
        factor = units.factors[i]
        decimals = decimals_for(float(calibration.sigma[i]) * factor)
        sizes = {source: float(sigmas[i]) * factor for source, sigmas in calibration.contributions.items()}
        largest = sorted(sizes, key=lambda source: -sizes[source])[:_LARGEST]
        shown = [(source_label(source), fixed(sizes[source], decimals)) for source in largest]
        shown = [(label, size) for label, size in shown if float(size) > 0.0]
        shown += [("", "")] * (_LARGEST - len(shown))
        rows.append([SYMBOLS[i], units.names[i], *(cell for pair in shown for cell in pair)])
    if not rows:
        return ""
    headers = ["", "unit", "largest", "sigma", "second", "sigma", "third", "sigma"]
    return f"Largest sources of sigma (--budget shows all)\n{text_table(headers, rows, 'lllrlrlr')}"


def budget_table(calibration: Calibration) -> str:
    """Table of all sources of error as columns; empty without sources."""
    observed = _observed(calibration)
    sources = {s: sizes for s, sizes in calibration.contributions.items() if any(sizes[i] > 0.0 for i in observed)}
    if not sources:
        return ""
    text = ["Sources of sigma, 1-sigma each; their squares add up"]
    text.append(sources_table(sources, calibration.sigma, observed, units_for(calibration.errors.vector)))
    silent = [source_label(source) for source in calibration.contributions if source not in sources]
    if silent:
        text += wrap(f"No contribution from: {', '.join(silent)}.")
    return "\n".join(text)


def sources_table(
    sources: Mapping[str, Array], total: Array | None, parameters: Sequence[int], units: Units = FINE
) -> str:
    """Table of sigmas by source, shape (27,), SI, as columns; columns that do not fit continue below.

    The total is shown before the sources, and determines the number of decimals; without it, the largest source does.
    ``parameters`` are the rows.
    """
    left: list[list[str]] = []
    columns: list[list[str]] = [[] for _ in sources]
    for i in parameters:
        factor = units.factors[i]
        size = max(float(sizes[i]) for sizes in sources.values()) if total is None else float(total[i])
        decimals = decimals_for(size * factor)
        left.append([SYMBOLS[i], units.names[i]] + ([] if total is None else [fixed(size * factor, decimals)]))
        for column, sizes in zip(columns, sources.values(), strict=True):
            column.append(fixed(float(sizes[i]) * factor, decimals))
    first = ["", "unit"] + ([] if total is None else ["sigma"])
    heads = [source_label(source).replace(" ", "\n") for source in sources]
    groups = [[column] for column in zip(heads, columns, strict=True)]
    return "\n".join(continued_tables(first, left, groups, "llr"[: len(first)]))


def residual_summary(calibration: Calibration) -> str:
    """Sentences on the residuals of the last iteration; empty without residuals."""
    known = [r for r in calibration.residuals if r.sigma > 0.0]
    left = unsolved(known)
    if not left:
        return f"Residuals: all {len(known)} components are solved exactly." if known else ""
    worst = max(left, key=lambda r: significant(abs(r.value / r.sigma)))
    again = f" (occurrence {worst.occurrence})" if worst.occurrence > 1 else ""
    text = (
        f"Residuals over sigma: rms {rms_over_sigma(left):.2g} of {len(left)} components, largest "
        f"{abs(worst.value / worst.sigma):.2g} in sequence {worst.sequence}{again}, {worst.component}."
    )
    solved = len(known) - len(left)
    if solved:
        text += f" {solved} more are solved exactly; errors of the parameters that they determine appear in the others."
    return text


def measured_count(calibration: Calibration) -> str:
    """Number of the parameters that the recording determined, of all."""
    return f"{int(calibration.observed.sum())} of {N_PARAMETERS}"


def passed_on(calibration: Calibration) -> str:
    """Clauses on the values of parameters that are not measured, as files and corrected readings contain them."""
    zero = [name for name in calibration.fixed if calibration.errors[name] == 0.0]
    stated = [name for name in calibration.fixed if name not in zero]
    parts = [
        f"{text}: {', '.join(collapse_names(names))}"
        for text, names in (("passed on as zero", zero), ("passed on with a value not measured here", stated))
        if names
    ]
    return "; ".join([f"{measured_count(calibration)} parameters are measured", *parts])


def time_base(calibration: Calibration) -> str:
    """Sentence on a time base whose error is not stated, and the parameters that it shifts; empty if it is stated."""
    shifted = [
        f"{abs(row.coefficient):g} ppm of {'every ' if row.axes == 'xyz' else ''}{row.group.replace('_', ' ')} factor"
        + ("" if row.axes == "xyz" else f" {' and '.join(row.axes)}")
        for row in calibration.diagnostics.unseen_errors or ()
        if row.source == "time base" and row.sigma is None
    ]
    return f"Time base taken as exact: 1 ppm of clock is {' and '.join(shifted)}." if shifted else ""


def held_summary(calibration: Calibration) -> str:
    """Fixed parameters by reason, one clause each; empty if none is fixed."""
    return "; ".join(f"{', '.join(names)}: {reason}" for reason, names in fixed_by_reason(calibration).items())


def _observed(calibration: Calibration) -> list[int]:
    return [i for i, name in enumerate(NAMES) if name not in calibration.fixed]


def source_label(source: str) -> str:
    """Short name of a source of error."""
    return SOURCE_LABELS.get(source, source.replace("_", " "))


def heading(calibration: Calibration, title: str) -> str:
    """First line of a report: title, serial, estimator and the number of parameters that are measured."""
    serial = calibration.provenance.serial
    unit = f"{title} (serial {serial})" if serial else title
    return f"{unit}: {calibration.estimator}, {measured_count(calibration)} measured"


def _heading(calibration: Calibration, title: str) -> Iterable[str]:
    yield from wrap(heading(calibration, title))
    yield from wrap(time_base(calibration))
    # Only the first sentence: the fixed parameters follow the table, with the reasons.
    message = calibration.message.split(" Fixed, not observed:")[0]
    steps = ", ".join(f"{c:.1e}" for c in calibration.corrections)
    status = "" if calibration.status == "converged" else f"Status {calibration.status.replace('_', ' ')}: "
    yield from wrap(f"{status}{message}")
    if steps:
        refits = ", ".join(map(str, calibration.diagnostics.refits or ()))
        grown = f" They grow in iteration {refits}, the first with another model." if refits else ""
        yield from wrap(f"Largest correction of each iteration: {steps}.{grown}")
    temperature = calibration.temperature
    if temperature is not None:
        yield f"Temperature {temperature.mean_c:.1f} °C, range {temperature.range_c:.1f} °C."


def _held(calibration: Calibration) -> Iterable[str]:
    reasons = fixed_by_reason(calibration) if calibration.has_values else {}
    if reasons:
        yield "Fixed, not observed"
    for reason, names in reasons.items():
        yield from wrap(f"{', '.join(names)}: {reason}", indent=" ")


def _asymmetry(calibration: Calibration) -> Iterable[str]:
    groups = calibration.diagnostics.asymmetry or {}
    if groups:
        yield "Asymmetries"
    for group, row in groups.items():
        word = "significant" if row.probability < _SIGNIFICANT else "not significant"
        without = ", ".join(_without(name, estimate) for name, estimate in row.without.items())
        yield from wrap(
            f"{group.replace('_', ' ')} estimated: {word} (chi-square {row.chi_square:.3g} for "
            f"{row.degrees_of_freedom}, {p_value_text(row.probability)}). Fixed at zero: {without}.",
            indent=" ",
        )


def _without(name: str, estimate: Estimate) -> str:
    """Value and sigma of an asymmetry."""
    i, sigma = INDEX[name], estimate.sigma
    return f"{SYMBOLS[i]} {value_text(i, estimate.value, sigma)} ± {sigma_text(i, sigma)} {DISPLAY_UNITS[i]}"


def _unseen_errors(calibration: Calibration) -> Iterable[str]:
    rows = calibration.diagnostics.unseen_errors or ()
    if rows:
        yield "Errors that no residual shows"
    for row in rows:
        yield from wrap(row.sentence, indent=" ")


def _notes(calibration: Calibration) -> Iterable[str]:
    targets = calibration.diagnostics.targets
    if targets is not None:
        met, name, short = targets.met_after, targets.limiting, targets.shortfall
        yield from wrap(
            f"All targets are met after sequence {met}; {name} is nearest to its target: "
            f"{short:.2g} of the required sigma."
            if met is not None
            else f"The targets are not met: the sigma of {name} is {short:.2g} times the required one."
        )
    yield from wrap(residual_summary(calibration))
    for sentence in calibration.warnings:
        yield from wrap(f"Note: {sentence}")
