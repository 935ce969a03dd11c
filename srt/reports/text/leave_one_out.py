"""Text of the verdict on a calibration: consistency of the measurements and observability of the parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from srt.reports.parameters import Units, sigma_text, symbols, units_for
from srt.reports.tables import fixed, text_table, wrap
from srt.result.verdict import p_value_text, probability_text
from srt.sensor_errors import INDEX, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.result.calibration import Calibration
    from srt.result.consistency import Consistency, Influence, LeaveOneOut

UNLIKELY: Final = 0.05
"""Family-wise significance level: 5 %, the customary one, divided by the number of tests (Bonferroni)."""

_MOST: Final = 3  # largest number of sequences that the table of observability names for one parameter
_LONG, _SHOWN = 20, 10
"""Rows: of more than 20 sequences the table shows the 10 with the smallest p-values, unless all are requested."""


def verdict_text(calibration: Calibration, *, parameters: bool = False) -> str:
    """Text of the verdict, in lines of at most 80 characters; empty without a verdict.

    ``parameters`` adds the table of observability by parameter, and shows all sequences.
    """
    evidence = calibration.consistency
    if evidence is None:
        return ""
    parts = ["Verdict\n" + "\n".join(wrap(str(calibration.judgement)))]
    if evidence.sequences:
        parts.append(sequence_table(calibration, evidence, full=parameters))
    if parameters and evidence.parameters:
        parts.append(observability_table(evidence, units_for(calibration.errors.vector), _word(calibration)))
    return "\n\n".join(parts)


def sequence_table(calibration: Calibration, verdict: Consistency, *, full: bool = True) -> str:
    """Table of the leave-one-out test of every sequence, with a legend.

    The extended Kalman filter adds the normalised innovation squared, a robust loss the weight of each sequence.
    """
    rows = verdict.sequences
    innovations = calibration.diagnostics.filter or calibration.diagnostics.live
    weights = calibration.diagnostics.weights
    word = _word(calibration)
    headers = [word, "chi2 / dof", "p", "shift if\nomitted"]
    headers += ["innovation\nNIS / dof", "p"] if innovations else []
    headers += ["weight"] if weights else []
    table: list[list[str] | None] = []
    shown: list[int] = list(range(len(rows)))
    left_off = ""
    if len(rows) > _LONG and not full:
        unlikely = sorted(range(len(rows)), key=lambda i: 1.0 if (p := rows[i].probability) is None else p)
        shown = sorted(unlikely[:_SHOWN])
        left_off = f" The {_SHOWN} least likely of {len(rows)}; --verdict shows all."
    for i in shown:
        row = rows[i]
        freedom = row.degrees_of_freedom
        cells = [row.title, f"{row.chi_square:.1f} / {freedom}", probability_text(row.probability)]
        if not freedom:
            cells[1:] = ["not checkable", ""]
        cells.append(_influence(row.largest_influence))
        if innovations:
            step = innovations[i]
            cells += [f"{step.nis:.1f} / {step.degrees_of_freedom}", probability_text(step.probability)]
        if weights:
            cells.append(fixed(weights[i].weight, 2))
        table.append(cells)
    lines = [text_table(headers, table, "lrrl".ljust(len(headers), "r")), *([left_off] if left_off else [])]
    lines += _notes(rows, word, innovations=bool(innovations))
    worst = verdict.contradicting
    if worst is not None:
        lines += wrap(f"{word.capitalize()} {worst.title} contradicts the others, {p_value_text(worst.probability)}.")
    return "\n".join(lines)


def _notes(rows: Sequence[LeaveOneOut], word: str, *, innovations: bool) -> list[str]:
    limit = UNLIKELY / len(rows)
    notes = [
        f"chi2 / dof: chi-square of the {word} against the prediction from all others, and its degrees of freedom. "
        "About equal is expected.",
        f"p: probability that noise alone gives a larger chi2. Among {len(rows)} {word}s, examine one below "
        f"{limit:.1g}.",
        f"shift if omitted: the parameter that shifts most without the {word}, and its shift in sigma.",
    ]
    if innovations:
        notes.append(f"innovation: the same test, with the prediction from the {word}s before it alone (NIS).")
    out = [line for note in notes for line in wrap(note, " ")]
    lost = f"Parameters that are not observable without one {word}:"
    alone = f"Parameters that one {word} alone determines, so that the others cannot check them:"
    for words, found in (
        (lost, [(row.title, row.lost_without) for row in rows]),
        (alone, [(row.title, row.only_witness_of) for row in rows]),
    ):
        shown = "; ".join(f"{title}: {symbols(names)}" for title, names in found if names)
        if shown:
            out += wrap(f"{words} {shown}.", " ")
    return out


def observability_table(verdict: Consistency, units: Units, word: str = "sequence") -> str:
    """Table of observability: information, variance inflation and largest correlation of every parameter."""
    rows: list[list[str] | None] = []
    for row in verdict.parameters:
        i = INDEX[row.name]
        shown = ", ".join(f"{s.title} {100.0 * s.share:.0f} %" for s in row.shown_by[:_MOST])
        more = len(row.shown_by) - _MOST
        correlation = row.largest_correlation
        rows.append(
            [
                SYMBOLS[i],
                sigma_text(i, row.sigma, units),
                units.names[i],
                f"{row.witnesses:.1f}" if row.witnesses is not None else "-",
                shown + (f", +{more}" if more > 0 else ""),
                f"{row.variance_inflation:.1f}",
                f"{correlation.value:+.2f} {SYMBOLS[INDEX[correlation.with_]]}" if correlation else "-",
            ]
        )
    headers = ["", "sigma", "unit", "inde-\npendent", "information from", "infla-\ntion", "correlation"]
    notes = [
        f"independent: effective number of {word}s that determine it; 1 means a single one.",
        f"information from: share of its information lost without a {word}; {word}s that work only together have 100 % "
        "each.",
        "inflation: its variance over its variance with all other parameters known.",
        "correlation: largest correlation of its error with that of another parameter.",
    ]
    weakest = verdict.weakest_combination
    if weakest is not None:
        terms = " ".join(f"{value:+.2f} {SYMBOLS[INDEX[name]]}" for name, value in weakest.combination.items())
        notes.append(
            f"Least observable combination: {terms}, each over its prior sigma; posterior sigma "
            f"{100.0 * weakest.sigma_over_prior:.2g} % of the prior."
        )
    return "\n".join([text_table(headers, rows, "lrlrlrl"), *(line for note in notes for line in wrap(note, " "))])


def _word(calibration: Calibration) -> str:
    return "recording" if calibration.estimator == "merged" else "sequence"


def _influence(largest: Influence | None) -> str:
    return "not observable" if largest is None else f"{SYMBOLS[INDEX[largest.parameter]]} {largest.sigmas:+.2g}"
