"""Content of a certificate: sentences, definitions and tables, without their layout."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.presentation import Presented
from srt.reports.certificate.laboratory import COVERAGE_FACTOR, Laboratory, equipment_table, references_table
from srt.reports.certificate.parameter_changes import FALSE_ALARM
from srt.reports.certificate.tables import CertificateCell, CertificateTable, plain
from srt.reports.certificate.uncertainty import budget_table, coverage_note
from srt.reports.certificate.unit_description import (
    SERIAL_LENGTH,
    application_section,
    limitations,
    recordings_table,
    temperature,
    unit_description,
)
from srt.reports.text.calibration import measured_count, time_base
from srt.reports.text.tables import decimals_for, fixed, text_table, wrap
from srt.result.verdict import DOUBTFUL, USABLE, probability_text
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, INDEX, NAMES, SYMBOLS, collapse_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from srt.reports.certificate.acceptance_limits import AcceptanceLimits
    from srt.reports.certificate.calibration_file import CalibrationFile
    from srt.reports.certificate.parameter_changes import ParameterChanges
    from srt.reports.certificate.recording_history import RecordingHistory
    from srt.reports.certificate.unit_description import Application
    from srt.result.calibration import Calibration, Residual

_DIGITS: Final = 7
"""Largest number of significant digits of a value; the sigma of noise-free data would require more."""
_SOLVED: Final = 1e-3
"""Fraction of sigma below which a component is solved exactly."""
_VERDICT_LENGTH: Final = 1000
"""Largest length of the verdict, characters."""
_STARTS: Final = frozenset(part.start for part in GROUP_SLICES.values())


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(Presented):
    """Content of the certificate of one unit.

    Attributes
    ----------
    unit : str
        Serial of the unit.
    outcome : str
        "passed", "failed", "doubtful" (limits are met, but the verdict is doubtful), or empty without limits.
    summary : tuple of str
        Main results, in sentences.
    parties : tuple of (str, str)
        Laboratory, customer, operator and conditions, as labels and texts, of those that are stated.
    missing : str
        Sentence on what the laboratory does not state; empty if it states all.
    equipment : CertificateTable or None
    references : CertificateTable
    description : tuple of (str, str)
        Unit, date, site, data and software, as labels and texts.
    parameters : CertificateTable
    g_sensitivity : CertificateTable or None
        Gyro g-sensitivity with its sigma, if estimated.
    budget : CertificateTable or None
        Uncertainty by source.
    decision : str
        Decision rule; empty without limits.
    held : tuple of str
        Fixed parameters and the reasons.
    residuals : CertificateTable or None
        By sequence.
    residual_notes : tuple of str
    recordings : CertificateTable or None
        Recordings of a merged calibration.
    changes : CertificateTable or None
        Since an earlier calibration.
    change_notes : tuple of str
    application : Application
        Formulas and numbers of the compensation.
    limitations : tuple of str
        Limitations of the test.
    notes : tuple of str
        Warnings of the calibration.
    failed : tuple of str
        Parameters that do not meet their limits.
    source : CalibrationFile
    course : RecordingHistory or None
    change : ParameterChanges or None
    """

    unit: str
    outcome: str
    summary: tuple[str, ...]
    parties: tuple[tuple[str, str], ...]
    missing: str
    equipment: CertificateTable | None
    references: CertificateTable
    description: tuple[tuple[str, str], ...]
    parameters: CertificateTable
    g_sensitivity: CertificateTable | None
    budget: CertificateTable | None
    decision: str
    held: tuple[str, ...]
    residuals: CertificateTable | None
    residual_notes: tuple[str, ...]
    recordings: CertificateTable | None
    changes: CertificateTable | None
    change_notes: tuple[str, ...]
    application: Application
    limitations: tuple[str, ...]
    notes: tuple[str, ...]
    failed: tuple[str, ...]
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
    """Content of a certificate.

    Parameters
    ----------
    source : CalibrationFile
    course : RecordingHistory, optional
        Of its recording.
    limits : AcceptanceLimits, optional
    change : ParameterChanges, optional
        Since an earlier calibration of the unit.
    laboratory : Laboratory, optional
        Statements of the laboratory; a sentence lists those that are missing.

    Returns
    -------
    Certificate

    Raises
    ------
    DataError
        If the calibration did not converge.
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
        limitations=limitations(calibration, course),
        notes=tuple(plain(text) for text in calibration.warnings),
        failed=failed,
        source=source,
        course=course,
        change=change,
    )


def parameter_table(
    calibration: Calibration, limits: AcceptanceLimits | None = None, coverage_factor: float = COVERAGE_FACTOR
) -> CertificateTable:
    """Table of values, sigmas and expanded uncertainties in display units, with the results of the limits.

    Parameters
    ----------
    calibration : Calibration
    limits : AcceptanceLimits, optional
        Adds the limit and the result of every parameter that has one.
    coverage_factor : float
    """
    expanded = f"U (k = {coverage_factor:g})"
    head = (
        "symbol",
        "parameter",
        "value",
        "sigma",
        expanded,
        "unit",
        *(("result", "limit") if limits is not None else ()),
    )
    met = None if limits is None else limits.met(calibration)
    passed = DOUBTFUL if calibration.judgement.word == DOUBTFUL else "passed"
    rows = []
    for i, name in enumerate(NAMES):
        held = name in calibration.held
        value, sigma = float(calibration.errors.vector[i]), float(calibration.sigma[i])
        row = [
            CertificateCell(SYMBOLS[i]),
            CertificateCell(name.replace("_", " ")),
            CertificateCell(*_value(i, value, sigma)),
            CertificateCell("fixed", mark="held") if held else CertificateCell(*_value(i, sigma, sigma)),
            CertificateCell("-" if held else _value(i, coverage_factor * sigma, coverage_factor * sigma)[0]),
            CertificateCell(DISPLAY_UNITS[i]),
        ]
        if limits is not None and met is not None:
            result = "" if not limits.given[i] else passed if met[i] else "failed"
            shown = "failed (not measured)" if result == "failed" and held else result
            row += [CertificateCell(shown, mark=result), CertificateCell(_limit(limits, i))]
        rows.append(tuple(row))
    note = coverage_note(coverage_factor)
    if limits is not None:
        note += f" Limits: {plain(limits.name)}. {limits.decision_rule}"
    return CertificateTable(
        "Parameters", head, tuple(rows), "llrrrl" + ("ll" if limits is not None else ""), note, _STARTS
    )


def g_sensitivity_table(calibration: Calibration) -> CertificateTable | None:
    """Table of the gyro g-sensitivity and its sigma; None if not estimated.

    Parameters
    ----------
    calibration : Calibration
    """
    stated = calibration.diagnostics.g_sensitivity
    if stated is None:
        return None
    shown = stated.matrix_deg_per_h_per_g.tolist(), stated.sigma_deg_per_h_per_g.tolist()
    rows = []
    for i, axis in enumerate("xyz"):
        cells = [CertificateCell(f"gyro {axis}")]
        for j in range(3):
            value, sigma = (table[i][j] for table in shown)
            decimals = decimals_for(sigma)
            cells += [
                CertificateCell(fixed(value, decimals), float(stated.matrix[i, j])),
                CertificateCell(f"± {fixed(sigma, decimals)}", float(stated.sigma[i, j])),
            ]
        rows.append(tuple(cells))
    head = ("°/h per g", "along x", "sigma", "along y", "sigma", "along z", "sigma")
    return CertificateTable("Gyro g-sensitivity", head, tuple(rows), "lrrrrrr")


def change_table(source: CalibrationFile, change: ParameterChanges) -> CertificateTable:
    """Table of the change of every parameter, over its combined sigma.

    Parameters
    ----------
    source : CalibrationFile
        The newer one.
    change : ParameterChanges
    """
    rows = []
    for i, name in enumerate(NAMES):
        new, old = (float(s.calibration.errors.vector[i]) for s in (source, change.old))
        sigma, ratio = float(change.sigma[i]), float(change.ratio[i])
        cells = [CertificateCell(SYMBOLS[i]), CertificateCell(name.replace("_", " "))]
        if math.isnan(sigma):
            nothing = CertificateCell("-")
            cells += [
                *[nothing] * 4,
                CertificateCell(DISPLAY_UNITS[i]),
                nothing,
                CertificateCell("not measured in both", mark="held"),
            ]
        else:
            values = ((old, sigma), (new, sigma), (new - old, sigma), (sigma, sigma))
            cells += [CertificateCell(*_value(i, value, size)) for value, size in values]
            flagged = bool(change.flagged[i])
            cells += [CertificateCell(DISPLAY_UNITS[i]), CertificateCell(_signed(ratio), ratio)]
            cells.append(CertificateCell("changed", mark="changed") if flagged else CertificateCell(""))
        rows.append(tuple(cells))
    head = ("symbol", "parameter", "before", "now", "change", "sigma", "unit", "change / sigma", "")
    compared = int(np.sum(~np.isnan(change.sigma)))
    note = (
        "sigma: of the change, the root of the sum of both squares. A change beyond "
        f"{change.limit:.2f} sigma is marked: over the {compared} compared parameters, the probability of any false "
        f"mark is at most {FALSE_ALARM:.0%}."
    )
    return CertificateTable(
        "As found and as left: change since the last calibration", head, tuple(rows), "llrrrrlrl", note, _STARTS
    )


def residual_table(calibration: Calibration) -> CertificateTable | None:
    """Table of the residuals by sequence; None without residuals.

    Parameters
    ----------
    calibration : Calibration
    """
    if not calibration.residuals:
        return None
    tests = () if calibration.verdict is None else calibration.verdict.sequences
    judged = {(row.sequence, row.occurrence): row for row in tests}
    by_turn: dict[tuple[str, int], list[Residual]] = {}
    for residual in calibration.residuals:
        by_turn.setdefault((residual.sequence, residual.occurrence), []).append(residual)
    against = ("chi-square / dof", "p") if judged else ()
    head = ("sequence", "residuals", "redundant", "rms / sigma", "largest / sigma", "component", *against)
    rows = []
    for turn, residuals in by_turn.items():
        left = _left(residuals)
        ratios = [r.value / r.sigma for r in left]
        cells = [
            CertificateCell(plain(turn[0]) + (f" ({turn[1]})" if turn[1] > 1 else "")),
            CertificateCell(str(len(residuals))),
        ]
        cells.append(CertificateCell(str(len(left))))
        if left:
            worst = int(np.argmax(np.abs(ratios)))
            rms = math.sqrt(sum(r * r for r in ratios) / len(ratios))
            component = plain(left[worst].component.replace("_", " "))
            cells += [
                CertificateCell(f"{rms:.2f}", rms),
                CertificateCell(_signed(ratios[worst]), ratios[worst]),
                CertificateCell(component),
            ]
        else:
            cells += [CertificateCell("-"), CertificateCell("-"), CertificateCell("solved for")]
        if judged:
            row = judged.get(turn)
            freedom = 0 if row is None else row.degrees_of_freedom
            cells += [
                CertificateCell(f"{row.chi_square:.1f} / {freedom}")
                if row and freedom
                else CertificateCell("not checkable"),
                CertificateCell(probability_text(row.probability) or "-") if row else CertificateCell("-"),
            ]
        rows.append(tuple(cells))
    note = (
        "About 1 sigma is expected for each residual that is not zero. Component: the one with the largest residual. "
        "Start down and end down: the vertical specific force before and after the rotations. Horizontal: the change "
        "of the horizontal specific force by the rotations."
    ) + (
        " Chi-square tests the sequence against its prediction from all others; p is the probability that noise alone "
        "gives a larger value." * bool(judged)
    )
    return CertificateTable("Residuals by sequence", head, tuple(rows), "lrrrrl" + ("rr" if judged else ""), note)


def _summary(
    calibration: Calibration, limits: AcceptanceLimits | None, failed: tuple[str, ...], change: ParameterChanges | None
) -> Iterator[str]:
    status = calibration.status.replace("_", " ")
    yield (
        f"{measured_count(calibration)} parameters were estimated (estimator {plain(calibration.estimator)}, {status})."
    )
    if zero := [name for name in calibration.held if calibration.errors[name] == 0.0]:
        yield f"Not measured, and zero in the corrections: {', '.join(collapse_names(zero))}."
    if limits is not None:
        count = int(limits.given.sum())
        yield (
            f"{len(failed)} of {_count(count)} with a limit failed: {_symbols(failed)}."
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
            f"Since {plain(change.old.name)}, {_count(len(names))} changed significantly: {_symbols(names)}."
            if names
            else f"Since {plain(change.old.name)}, no parameter changed significantly."
        )


def _count(number: int, noun: str = "parameter") -> str:
    """Number with its noun, singular or plural."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _symbols(names: Iterable[str]) -> str:
    return " ".join(SYMBOLS[INDEX[name]] for name in names)


def _held(calibration: Calibration) -> Iterator[str]:
    reasons: dict[str, list[str]] = {}
    for name, reason in calibration.held.items():
        reasons.setdefault(reason, []).append(f"{SYMBOLS[INDEX[name]]} ({name.replace('_', ' ')})")
    for reason, names in reasons.items():
        yield f"{', '.join(names)}: {plain(reason, 400).rstrip('.')}."


def _residual_notes(calibration: Calibration) -> Iterator[str]:
    left, count = _left(calibration.residuals), len(calibration.residuals)
    solved = count - len(left)
    if left and solved:
        yield f"{solved} of the {count} residuals are zero, as the parameters were computed from them."
    if left:
        rms = math.sqrt(sum((r.value / r.sigma) ** 2 for r in left) / len(left))
        yield f"The root mean square of {'the other ' * (solved > 0)}{len(left)} residuals is {rms:.2f} sigma."
    elif solved:
        yield f"All {solved} residuals are zero, as the parameters were computed from them."
    else:
        yield "The calibration file contains no residuals."


def _left(residuals: Iterable[Residual]) -> list[Residual]:
    return [r for r in residuals if r.sigma > 0.0 and abs(r.value) > _SOLVED * r.sigma]


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


def _value(i: int, value: float, sigma: float) -> tuple[str, float]:
    """Text of a parameter in its display unit, rounded to two digits of its sigma, and its SI value."""
    factor = DISPLAY_FACTORS[i]
    decimals = 2 if math.isnan(sigma) else decimals_for(sigma * factor)
    # The sigma of noise-free data would require too many digits of the value.
    places = decimals if value == sigma else min(decimals, max(_DIGITS - len(f"{abs(value * factor):.0f}"), 0))
    return fixed(value * factor, places), value


def _limit(limits: AcceptanceLimits, i: int) -> str:
    sizes = ((limits.value[i], "|value| ≤ {}"), (limits.sigma[i], "sigma ≤ {}"))
    return ", ".join(words.format(f"{size * DISPLAY_FACTORS[i]:.6g}") for size, words in sizes if not math.isnan(size))


def _signed(value: float) -> str:
    return f"{value:+.2f}" if abs(value) < 1e4 else f"{value:+.2e}"


def certificate_text(certificate: Certificate) -> str:
    """Title, main results and parameters of a certificate, as text."""
    table = certificate.parameters
    rows = [[cell.text for cell in row] for row in table.rows]
    lines = [certificate.title, *(line for sentence in certificate.summary for line in wrap(sentence))]
    return "\n".join([*lines, "", text_table(list(table.head), rows, table.alignment, gap=1)])
