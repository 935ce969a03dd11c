"""Content of a certificate: sentences, definitions and tables, without their layout."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.presentation import Presented
from srt.ranking import significant
from srt.reports.certificate.calibration_file import FALSE_ALARM
from srt.reports.certificate.laboratory import COVERAGE_FACTOR, Laboratory, equipment_table, references_table
from srt.reports.certificate.unit_description import (
    SERIAL_LENGTH,
    application_section,
    limitations,
    recordings_table,
    temperature,
    unit_description,
)
from srt.reports.parameters import (
    GROUP_STARTS,
    Units,
    fixed_by_reason,
    parameter_cells,
    rms_over_sigma,
    sigma_text,
    symbols,
    units_for,
    unsolved,
    value_text,
)
from srt.reports.tables import Cell, Table, decimals_for, fixed, plain, table, wrap
from srt.reports.text.calibration import measured_count, source_label, time_base
from srt.result.verdict import DOUBTFUL, USABLE, probability_text
from srt.sensor_errors import GROUP_SLICES, INDEX, NAMES, SYMBOLS, collapse_names

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.reports.certificate.acceptance_limits import AcceptanceLimits
    from srt.reports.certificate.calibration_file import CalibrationFile, ParameterChanges
    from srt.reports.certificate.recording_history import RecordingHistory
    from srt.reports.certificate.unit_description import Application
    from srt.result.calibration import Calibration, Residual

_VERDICT_LENGTH: Final = 1000  # largest length of the verdict, characters


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(Presented):
    """Content of the certificate of one unit."""

    unit: str  # serial
    outcome: str  # "passed", "failed", "doubtful" (limits are met, but the verdict is doubtful); empty without limits
    summary: tuple[str, ...]  # main results, in sentences
    parties: tuple[tuple[str, str], ...]  # labels and texts of what the laboratory states
    missing: str  # sentence on what it does not state; empty if it states all
    equipment: Table | None
    references: Table
    description: tuple[tuple[str, str], ...]  # unit, date, site, data and software, as labels and texts
    parameters: Table
    g_sensitivity: Table | None
    budget: Table | None  # uncertainty by source
    decision: str  # decision rule; empty without limits
    held: tuple[str, ...]  # fixed parameters and the reasons
    residuals: Table | None  # by sequence
    residual_notes: tuple[str, ...]
    recordings: Table | None  # of a merged calibration
    changes: Table | None  # since an earlier calibration
    change_notes: tuple[str, ...]
    application: Application
    limitations: tuple[str, ...]  # of the test
    notes: tuple[str, ...]  # warnings of the calibration
    failed: tuple[str, ...]  # parameters that do not meet their limits
    source: CalibrationFile
    course: RecordingHistory | None
    change: ParameterChanges | None

    @property
    def title(self) -> str:
        """Heading of the page and of the PDF."""
        return f"Calibration certificate: {self.unit}"


def make_certificate(
    source: CalibrationFile,
    *,
    course: RecordingHistory | None = None,
    limits: AcceptanceLimits | None = None,
    change: ParameterChanges | None = None,
    laboratory: Laboratory | None = None,
) -> Certificate:
    """Content of a certificate; a sentence lists what the laboratory does not state.

    ``course`` is that of its recording, ``change`` that since an earlier calibration of the unit. Raises DataError if
    the calibration did not converge.
    """
    calibration = source.calibration
    if calibration.status not in USABLE:
        raise DataError(
            f"{source.name} has the status {calibration.status.replace('_', ' ')}, and nothing can be certified by it: "
            "calibrate the unit again."
        )
    stated = laboratory or Laboratory()
    failed: tuple[str, ...] = ()
    if limits is not None:
        failed = tuple(NAMES[i] for i in np.flatnonzero(~limits.met(calibration)))
    # A limit is passed by a value with a sigma that holds; a doubtful calibration has none.
    passed = DOUBTFUL if calibration.judgement.word == DOUBTFUL else "passed"
    outcome = "" if limits is None else "failed" if failed else passed
    return Certificate(
        unit=plain(source.serial, SERIAL_LENGTH) or "no serial",
        outcome=outcome,
        summary=tuple(_summary(calibration, limits, failed, change)),
        parties=tuple(stated.rows()),
        missing=stated.missing,
        equipment=equipment_table(stated),
        references=references_table(calibration, stated),
        description=tuple(unit_description(source, course, limits)),
        parameters=parameter_table(calibration, limits, stated.coverage_factor),
        g_sensitivity=g_sensitivity_table(calibration),
        budget=budget_table(calibration, stated.coverage_factor),
        decision="" if limits is None else limits.decision_rule,
        held=tuple(_held(calibration)),
        residuals=residual_table(calibration),
        residual_notes=tuple(_residual_notes(calibration)),
        recordings=recordings_table(calibration),
        changes=None if change is None else change_table(source, change),
        change_notes=() if change is None else tuple(_change_notes(source, change)),
        application=application_section(calibration),
        limitations=tuple(limitations(calibration, course)),
        notes=tuple(plain(text) for text in calibration.warnings),
        failed=failed,
        source=source,
        course=course,
        change=change,
    )


def parameter_table(
    calibration: Calibration, limits: AcceptanceLimits | None = None, coverage_factor: float = COVERAGE_FACTOR
) -> Table:
    """Table of values, sigmas and expanded uncertainties; limits add the result and the limit of every parameter."""
    met = None if limits is None else limits.met(calibration)
    passed = DOUBTFUL if calibration.judgement.word == DOUBTFUL else "passed"
    rows: list[list[Cell | str]] = []
    units = units_for(calibration.errors.vector)
    for i, (symbol, _, value, sigma, unit) in enumerate(parameter_cells(calibration)):
        expanded = sigma_text(i, coverage_factor * float(calibration.sigma[i]), units)
        rows.append([symbol, NAMES[i].replace("_", " "), value, sigma, expanded, unit])
        if limits is not None and met is not None:
            result = "" if not limits.given[i] else passed if met[i] else "failed"
            shown = "failed (not measured)" if result == "failed" and sigma.mark == "held" else result
            rows[i] += [Cell(shown, mark=result), _limit(limits, i, units)]
    head = ["symbol", "parameter", "value", "sigma", f"U (k = {coverage_factor:g})", "unit"]
    head += [] if limits is None else ["result", "limit"]
    note = coverage_note(coverage_factor)
    if limits is not None:
        note += f" Limits: {plain(limits.name)}. {limits.decision_rule}"
    return table(head, rows, "llrrrlll"[: len(head)], title="Parameters", note=note, breaks=GROUP_STARTS)


def g_sensitivity_table(calibration: Calibration) -> Table | None:
    """Table of the gyro g-sensitivity and its sigma; None if not estimated."""
    stated = calibration.diagnostics.g_sensitivity
    if stated is None:
        return None
    shown = stated.matrix_deg_per_h_per_g.tolist(), stated.sigma_deg_per_h_per_g.tolist()
    rows = []
    for i, axis in enumerate("xyz"):
        cells: list[Cell | str] = [f"gyro {axis}"]
        for j in range(3):
            value, sigma = (numbers[i][j] for numbers in shown)
            decimals = decimals_for(sigma)
            cells += [
                Cell(fixed(value, decimals), float(stated.matrix[i, j])),
                Cell(f"± {fixed(sigma, decimals)}", float(stated.sigma[i, j])),
            ]
        rows.append(cells)
    head = ("°/h per g", "along x", "sigma", "along y", "sigma", "along z", "sigma")
    return table(head, rows, "lrrrrrr", title="Gyro g-sensitivity")


def change_table(source: CalibrationFile, change: ParameterChanges) -> Table:
    """Table of the change of every parameter to its value in ``source``, over its combined sigma."""
    new, old = (s.calibration.errors.vector.tolist() for s in (source, change.old))
    rows: list[list[Cell | str]] = []
    units = units_for(source.calibration.errors.vector, change.old.calibration.errors.vector)
    for i, name in enumerate(NAMES):
        sigma, ratio = float(change.sigma[i]), float(change.ratio[i])
        title, unit = name.replace("_", " "), units.names[i]
        if math.isnan(sigma):
            rows.append([SYMBOLS[i], title, *"----", unit, "-", Cell("not measured in both", mark="held")])
            continue
        values = [Cell(value_text(i, value, sigma, units), value) for value in (old[i], new[i], new[i] - old[i])]
        flag = Cell("changed", mark="changed") if change.flagged[i] else ""
        sizes = *values, Cell(sigma_text(i, sigma, units), sigma)
        rows.append([SYMBOLS[i], title, *sizes, unit, Cell(_signed(ratio), ratio), flag])
    head = ("symbol", "parameter", "before", "now", "change", "sigma", "unit", "change / sigma", "")
    compared = int(np.sum(~np.isnan(change.sigma)))
    note = (
        "sigma: of the change, the root of the sum of both squares. A change beyond "
        f"{change.limit:.2f} sigma is marked: over the {compared} compared parameters, the probability of any false "
        f"mark is at most {FALSE_ALARM:.0%}."
    )
    title = "As found and as left: change since the last calibration"
    return table(head, rows, "llrrrrlrl", title=title, note=note, breaks=GROUP_STARTS)


def residual_table(calibration: Calibration) -> Table | None:
    """Table of the residuals by sequence; None without residuals."""
    if not calibration.residuals:
        return None
    tests = () if calibration.consistency is None else calibration.consistency.sequences
    judged = {(row.sequence, row.occurrence): row for row in tests}
    by_turn: dict[tuple[str, int], list[Residual]] = {}
    for residual in calibration.residuals:
        by_turn.setdefault((residual.sequence, residual.occurrence), []).append(residual)
    rows = []
    for turn, residuals in by_turn.items():
        left = unsolved(residuals)
        name = plain(turn[0]) + (f" ({turn[1]})" if turn[1] > 1 else "")
        cells: list[Cell | str] = [name, str(len(residuals)), str(len(left))]
        if left:
            worst = max(left, key=lambda r: significant(abs(r.value / r.sigma)))
            rms, largest = rms_over_sigma(left), worst.value / worst.sigma
            component = plain(worst.component.replace("_", " "))
            cells += [Cell(f"{rms:.2f}", rms), Cell(_signed(largest), largest), component]
        else:
            cells += ["-", "-", "solved for"]
        row = judged.get(turn)
        if row is not None and row.degrees_of_freedom:
            cells += [f"{row.chi_square:.1f} / {row.degrees_of_freedom}", probability_text(row.probability) or "-"]
        elif judged:
            cells += ["not checkable", "-" if row is None else probability_text(row.probability) or "-"]
        rows.append(cells)
    note = (
        "About 1 sigma is expected for each residual that is not zero. Component: the one with the largest residual. "
        "Start down and end down: the vertical specific force before and after the rotations. Horizontal: the change "
        "of the horizontal specific force by the rotations."
    )
    if judged:
        note += (
            " Chi-square tests the sequence against its prediction from all others; p is the probability that noise "
            "alone gives a larger value. Redundant counts the residuals that are not zero, dof the combinations of the "
            "sequence's measurements that the other sequences predict."
        )
    head = ["sequence", "residuals", "redundant", "rms / sigma", "largest / sigma", "component"]
    head += ["chi-square / dof", "p"] if judged else []
    return table(head, rows, "lrrrrlrr"[: len(head)], title="Residuals by sequence", note=note)


def _summary(
    calibration: Calibration, limits: AcceptanceLimits | None, failed: tuple[str, ...], change: ParameterChanges | None
) -> Iterator[str]:
    status = calibration.status.replace("_", " ")
    yield (
        f"{measured_count(calibration)} parameters were estimated (estimator {plain(calibration.estimator)}, {status})."
    )
    if zero := [name for name in calibration.fixed if calibration.errors[name] == 0.0]:
        yield f"Not measured, and zero in the corrections: {', '.join(collapse_names(zero))}."
    if limits is not None:
        count = int(limits.given.sum())
        yield (
            f"{len(failed)} of {_count(count)} with a limit failed: {symbols(failed)}."
            if failed
            else f"All {_count(count)} with a limit lie within it, but the calibration is doubtful."
            if calibration.judgement.word == DOUBTFUL
            else f"All {_count(count)} with a limit passed."
        )
    elif calibration.status == "converged":
        yield "No acceptance limits were given."
    yield f"Verdict: {plain(str(calibration.judgement), _VERDICT_LENGTH)}"
    if exact := time_base(calibration):
        yield exact
    if change is not None:
        names = change.names
        yield (
            f"Since {plain(change.old.name)}, {_count(len(names))} changed significantly: {symbols(names)}."
            if names
            else f"Since {plain(change.old.name)}, no parameter changed significantly."
        )


def _count(number: int, noun: str = "parameter") -> str:
    """Number with its noun, singular or plural."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _held(calibration: Calibration) -> Iterator[str]:
    for reason, names in fixed_by_reason(calibration).items():
        shown = ", ".join(f"{SYMBOLS[INDEX[name]]} ({name.replace('_', ' ')})" for name in names)
        yield f"{shown}: {plain(reason, 400).rstrip('.')}."


def _residual_notes(calibration: Calibration) -> Iterator[str]:
    left, count = unsolved(calibration.residuals), len(calibration.residuals)
    solved = count - len(left)
    if left and solved:
        yield f"{solved} of the {count} residuals are zero, as the parameters were computed from them."
    if left:
        others = "the other " * (solved > 0)
        yield f"The root mean square of {others}{len(left)} residuals is {rms_over_sigma(left):.2f} sigma."
    elif solved:
        yield f"All {solved} residuals are zero, as the parameters were computed from them."
    else:
        yield "The calibration file contains no residuals."


def _change_notes(source: CalibrationFile, change: ParameterChanges) -> Iterator[str]:
    old = change.old
    dates = [plain(s.calibration.provenance.date) or "a date not stated" for s in (old, source)]
    yield f"Before: {plain(old.name)}, of {dates[0]}, SHA-256 {old.sha256}; now of {dates[1]}."
    temperatures = [temperature(s.calibration) for s in (old, source)]
    yield f"Temperature before: {temperatures[0]}; now: {temperatures[1]}."
    if change.on_trust:
        yield "A serial is not stated: one unit is assumed."
    yield (
        "Errors common to both tests, such as that of gravity, are treated as independent: the sigma of a change is "
        "rather too large than too small."
    )


def _limit(limits: AcceptanceLimits, i: int, units: Units) -> str:
    sizes = ((limits.value[i], "|value| ≤ {}"), (limits.sigma[i], "sigma ≤ {}"))
    return ", ".join(words.format(f"{size * units.factors[i]:.6g}") for size, words in sizes if not math.isnan(size))


def _signed(value: float) -> str:
    return f"{value:+.2f}" if abs(value) < 1e4 else f"{value:+.2e}"


def certificate_text(certificate: Certificate) -> str:
    """Title, main results and parameters of a certificate, as text."""
    lines = [certificate.title, *(line for sentence in certificate.summary for line in wrap(sentence))]
    return "\n".join([*lines, "", certificate.parameters.text(gap=1, grouped=False)])


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
    sigma, units = calibration.sigma, units_for(calibration.errors.vector)
    rows = []
    for name, part in parts.items():
        scale = units.factors[part[0]]
        total = float(np.sqrt(np.mean(sigma[part] ** 2))) * scale
        decimals = decimals_for(total)
        sizes = [float(np.sqrt(np.mean(size[part] ** 2))) * scale for size in sources.values()]
        texts = [fixed(size, decimals) for size in (*sizes, total, factor * total)]
        rows.append([name.replace("_", " "), units.names[part[0]], *texts])
    head = ("group", "unit", *map(source_label, sources), "combined", f"U (k = {factor:g})")
    note = (
        "Each entry is the standard uncertainty by one source, root mean square over the group. The combined one is "
        "the root of the sum of squares of its row. Stated noise and references are type B, noise from the stationary "
        "windows is type A. The covariance of all parameters is in the calibration file."
    )
    return table(head, rows, "ll" + "r" * (len(sources) + 2), title="Uncertainty budget", note=note)
