"""The verdict on a calibration as text, for a reader who never saw the test: tables, and what their columns say."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Final

from srt.estimation.leave_one_out import most_contradicted
from srt.reports.text.tables import WIDTH, decimals_for, fixed, text_table
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, INDEX, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.result.calibration import Calibration

UNLIKELY: Final = 0.05
"""Chance below which something is worth a look, shared among all that are looked at."""

_UNEXPECTED: Final = 1e-3
_MOST: Final = 3
_LONG, _SHOWN = 20, 10
"""Of more sequences than the one, only the other number of them are shown unless all are asked for."""


def verdict_text(calibration: Calibration, *, parameters: bool = False) -> str:
    """Set the verdict.

    Parameters
    ----------
    calibration : Calibration
    parameters : bool
        Also the table by parameter: who shows it, and what it is mixed up with; and all sequences, however many.

    Returns
    -------
    str
        Lines of at most 80 characters; empty if nothing is known.
    """
    verdict = calibration.verdict
    if not verdict:
        return ""
    parts = ["Verdict\n" + "\n".join(_wrap(overall(verdict)))]
    if verdict["sequences"]:
        parts.append(sequence_table(calibration, full=parameters))
    if parameters and verdict["parameters"]:
        parts.append(observability_table(verdict, _word(calibration)))
    return "\n\n".join(parts)


def overall(verdict: Mapping[str, Any]) -> str:
    """Say in a sentence whether the residuals are as large as the noise explains."""
    statistic, freedom, chance = (verdict[key] for key in ("chi_square", "degrees_of_freedom", "probability"))
    if chance is None:
        return "Nothing is measured twice: whether the measurements agree cannot be checked."
    if chance < _UNEXPECTED:
        words = "The measurements contradict each other more than their noise explains"
    elif chance < UNLIKELY:
        words = "The measurements agree less than usual"
    elif chance > 1.0 - _UNEXPECTED:
        words = "The measurements agree better than their noise allows: it is stated or estimated too large"
    else:
        words = "The measurements agree as well as their noise lets them"
    return (
        f"{words}: chi-square {statistic:.4g} for {freedom} degrees of freedom (about 1 each is expected; larger by "
        f"chance alone: {probability(chance)})."
    )


def sequence_table(calibration: Calibration, *, full: bool = True) -> str:
    """Set every sequence against the others, what hangs on it, and what each column says.

    For the filter the chi-square of its innovation stands beside it, all sequences before it being known; under a
    robust loss its weight.
    """
    rows = calibration.verdict["sequences"]
    innovations = calibration.diagnostics.get("filter") or calibration.diagnostics.get("live")
    weights = calibration.diagnostics.get("weights")
    word = _word(calibration)
    headers, alignment = [word, "chi2 / dof", "chance", "if left out"], "lrrl"
    if innovations:
        headers, alignment = [*headers, "as it came\nNIS / dof", "chance"], alignment + "rr"
    if weights:
        headers, alignment = [*headers, "weight"], alignment + "r"
    table: list[list[str] | None] = []
    shown: list[int] = list(range(len(rows)))
    left_off = ""
    if len(rows) > _LONG and not full:
        unlikely = sorted(range(len(rows)), key=lambda i: 1.0 if (p := rows[i]["probability"]) is None else p)
        shown = sorted(unlikely[:_SHOWN])
        left_off = f" The {_SHOWN} least likely of {len(rows)}; --verdict shows all."
    for i in shown:
        row = rows[i]
        freedom = row["degrees_of_freedom"]
        cells = [_title(row), f"{row['chi_square']:.1f} / {freedom}", probability(row["probability"])]
        if not freedom:
            cells[1:] = ["not checkable", ""]
        cells.append(_influence(row))
        if innovations:
            cells += [
                f"{innovations[i]['nis']:.1f} / {innovations[i]['degrees_of_freedom']}",
                probability(innovations[i]["probability"]),
            ]
        if weights:
            cells.append(fixed(weights[i]["weight"], 2))
        table.append(cells)
    lines = [text_table(headers, table, alignment), *([left_off] if left_off else [])]
    return "\n".join([*lines, *_notes(rows, word, innovations=bool(innovations))])


def _notes(rows: Sequence[dict[str, Any]], word: str, *, innovations: bool) -> list[str]:
    limit = UNLIKELY / len(rows)
    notes = [
        f"chi2 / dof: how far the {word} is from what all others predict: squares over their sigma, and their number. "
        "About equal is right.",
        f"chance: of a larger chi2 by noise alone. Among {len(rows)} {word}s one below {limit:.1g} is worth a look.",
        f"if left out: the parameter that would move most without the {word}, and how far, in its own sigma.",
    ]
    if innovations:
        notes.append(f"as it came: the same with only the {word}s before it known.")
    out = [line for note in notes for line in _wrap(note, " ")]
    worst = most_contradicted(rows)
    if worst is not None:
        out += _wrap(
            f"{word.capitalize()} {_title(worst)} contradicts the others: chance {probability(worst['probability'])}.",
        )
    for key, words in (
        ("lost_without", f"Without a {word} would be lost:"),
        ("only_witness_of", f"Shown by one {word} alone, so not checkable by the others:"),
    ):
        found = [(_title(row), row[key]) for row in rows if row[key]]
        if found:
            shown = "; ".join(f"{title}: {_symbols(names)}" for title, names in found)
            out += _wrap(f"{words} {shown}.", " ")
    return out


def observability_table(verdict: Mapping[str, Any], word: str = "sequence") -> str:
    """Set who shows each parameter, and what it is mixed up with."""
    rows: list[list[str] | None] = []
    for row in verdict["parameters"]:
        i = INDEX[row["name"]]
        sigma = row["sigma"] * DISPLAY_FACTORS[i]
        shown = ", ".join(f"{_title(s)} {100.0 * s['share']:.0f} %" for s in row["shown_by"][:_MOST])
        more = len(row["shown_by"]) - _MOST
        correlation = row["largest_correlation"]
        rows.append(
            [
                SYMBOLS[i],
                fixed(sigma, decimals_for(sigma)),
                DISPLAY_UNITS[i],
                f"{row['witnesses']:.1f}" if row["witnesses"] is not None else "-",
                shown + (f", +{more}" if more > 0 else ""),
                f"{row['variance_inflation']:.1f}",
                f"{correlation['value']:+.2f} {SYMBOLS[INDEX[correlation['with']]]}" if correlation else "-",
            ]
        )
    headers = ["", "sigma", "unit", "wit-\nnesses", "shown by", "infla-\ntion", "correlation"]
    notes = [
        f"witnesses: about how many {word}s show it independently; at 1 it hangs on a single one.",
        f"shown by: share of its information that goes with a {word}; {word}s that need each other each hold it all.",
        "inflation: how much smaller its variance would be if all others were known.",
        "correlation: of its error with that of the parameter it is mixed up with most.",
    ]
    weakest = verdict["weakest_combination"]
    if weakest is not None:
        terms = " ".join(f"{value:+.2f} {SYMBOLS[INDEX[name]]}" for name, value in weakest["combination"].items())
        notes.append(
            f"Narrowed down least: {terms}, each in the sigma it has before any data; to "
            f"{100.0 * weakest['sigma_over_prior']:.2g} % of that."
        )
    return "\n".join([text_table(headers, rows, "lrlrlrl"), *(line for note in notes for line in _wrap(note, " "))])


def probability(chance: float | None) -> str:
    """Write a probability; an empty cell for none."""
    if chance is None:
        return ""
    return f"{chance:.1g}" if chance < 0.01 else f"{chance:.2f}"


def _word(calibration: Calibration) -> str:
    return "recording" if calibration.estimator == "merged" else "sequence"


def _influence(row: Mapping[str, Any]) -> str:
    largest = row["largest_influence"]
    if largest is None:
        return "nothing is left"
    return f"{SYMBOLS[INDEX[largest['parameter']]]} {largest['sigmas']:+.2g}"


def _title(row: Mapping[str, Any]) -> str:
    return f"{row['sequence']} ({row['occurrence']})" if row["occurrence"] > 1 else str(row["sequence"])


def _symbols(names: Sequence[str]) -> str:
    return " ".join(SYMBOLS[INDEX[name]] for name in names)


def _wrap(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent + "  ", break_on_hyphens=False)
