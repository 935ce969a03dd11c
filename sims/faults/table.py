"""The study of faults as tables: what a cell says, the page that is committed, and what misses its target."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sims.faults.study import ALL_OR_NOTHING, LADDER_UNITS, SEEN
from srt.diagnosis.faults import FAULTS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sims.faults.study import Pair, Study


def markdown(study: Study) -> str:
    """The table that is committed: every fault and grade, clean recordings, and what cannot be seen."""
    pairs = list(study.pairs())
    grades = study.grades
    limit = 0.05 ** (1.0 / LADDER_UNITS)
    lines = [
        "# How reliably faults are named",
        "",
        "Each cell: severity injected, how many of the injections were detected and named as the first cause, and (≥) "
        "the\nsmallest severity still seen, where smaller ones were tried. Simulated units of four grades "
        "(`configs/imu`) on the\n1 mrad fixture, 17 sequences, 100 Hz, seeds from "
        f"{study.seed}. What the faults are and say is in [faults.md](faults.md).",
        "",
        f"The stated severity is halved (of a factor, the square root is taken) for as long as all of {LADDER_UNITS} "
        "units are\nnamed; the smallest one seen is that of the last such step. A fault that is named in 99 % of the "
        f"recordings passes a step\n{100.0 * SEEN**LADDER_UNITS:.0f} times in 100, one that is named in less than "
        f"{100.0 * limit:.1f} % fewer than 5 times in 100.",
        "",
        "| fault | effect | " + " | ".join(grades) + " |",
        "|---|---|" + "---|" * len(grades),
    ]
    by_fault = {fault: [pair for pair in pairs if pair.fault == fault] for fault in study.faults}
    lines += [
        f"| `{fault}` | {FAULTS[fault].effect} | " + " | ".join(cell(pair) for pair in row) + " |"
        for fault, row in by_fault.items()
    ]
    lines += ["", "## Clean recordings", "", "| grade | recordings | with a finding | findings |", "|---|---|---|---|"]
    for grade in grades:
        count, alarms = study.alarms(grade)
        what = ", ".join(f"`{name}` {n}" for name, n in alarms.most_common()) or "none"
        lines.append(f"| {grade} | {count} | {alarms.total()} | {what} |")
    unseen = [pair for pair in pairs if pair.severity is None]
    if unseen:
        lines += ["", "## What cannot be seen", ""]
        lines += [f"- `{pair.fault}`, {pair.grade}: {pair.reason}" for pair in unseen]
    missed = [pair for pair in pairs if pair.misnamed]
    if missed:
        lines += ["", "## Named otherwise, at the stated severity", ""]
        lines += [
            f"- `{pair.fault}`, {pair.grade}: " + ", ".join(f"{name} {n}" for name, n in pair.misnamed.items())
            for pair in missed
        ]
    return "\n".join(lines) + "\n"


def cell(pair: Pair) -> str:
    """What a table says of a pair."""
    if pair.severity is None:
        return "unseen"
    if pair.of == 0:
        return "not run"
    if pair.unit in ALL_OR_NOTHING:
        return f"{pair.named}/{pair.of}"
    smallest = "" if pair.seen else "; none seen"
    if pair.smallest is not None:
        smallest = f"; ≥ {pair.smallest:.4g}"
    return f"{pair.severity:.4g} {pair.unit}: {pair.named}/{pair.of}{smallest}"


def missed_targets(study: Study) -> Iterator[str]:
    """What is missed of the goals: 99 % of every pair, and one false alarm in a hundred recordings."""
    for pair in study.pairs():
        if pair.severity is not None and not pair.seen:
            yield f"{pair.fault}, {pair.grade}: {pair.named} of {pair.of} named"
    clean = [study.alarms(grade) for grade in study.grades]
    recordings, findings = sum(count for count, _ in clean), sum(alarms.total() for _, alarms in clean)
    if findings > (1.0 - SEEN) * recordings:
        yield f"{findings} of {recordings} clean recordings raise a finding"
