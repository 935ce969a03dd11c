"""Detection rate of every fault and false-alarm rate of clean recordings: docs/fault-detection.md.

``python benchmarks/faults.py`` injects every fault into 200 units of every grade, halves its severity while it is still
detected, and diagnoses 200 clean recordings of every grade. Results are appended to a file; an interrupted run resumes
from it. ``--markdown docs/fault-detection.md`` writes the committed table. The exit code is 1 if a fault is named in
fewer than 99 % of its injections, or if more than 1 % of the clean recordings raise a finding.
"""

import os

# One thread for each process, their children included: the matrices are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from fault_study import ALL_OR_NOTHING, LADDER_UNITS, SEEN, FaultDetection, FaultStudy, Report
from injected_faults.injection import GRADES
from rich.console import Console
from rich.table import Table

from srt.diagnosis.faults import FAULTS
from srt.exceptions import InputError
from srt.recording.atomic_file import atomic_write_text

console = Console(width=180)
RESULTS = Path("build") / "fault-study.jsonl"
EVERY_S = 60.0
"""Time between two lines of the report, s."""


def progress() -> Report:
    """Progress report: one line a minute."""
    began = said = time.monotonic()

    def report(rung: int, left: int) -> None:
        nonlocal said
        if left == 0 or time.monotonic() - said > EVERY_S:
            said = time.monotonic()
            what = "stated severity" if rung == 0 else f"severity halved {rung} times"
            console.print(f"{said - began:.0f} s: {what}, {left} units left")

    return report


def table(study: FaultStudy) -> Table:
    out = Table(title="severity: named first of injections; smallest severity seen")
    out.add_column("fault")
    out.add_column("effect")
    for grade in study.grades:
        out.add_column(grade)
    pairs = list(study.detections())
    for fault in study.faults:
        cells = (cell(pair) for pair in pairs if pair.fault == fault)
        out.add_row(fault, FAULTS[fault].effect, *cells)
    out.add_section()
    clean = ((count, alarms.total()) for count, alarms in map(study.alarms, study.grades))
    out.add_row("clean recordings", "", *(f"{alarms} of {count} raise a finding" for count, alarms in clean))
    return out


def markdown(study: FaultStudy) -> str:
    """Markdown of the committed page: every fault and grade, clean recordings, and undetectable faults."""
    pairs = list(study.detections())
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


def cell(pair: FaultDetection) -> str:
    """Table cell of one fault and grade."""
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


def missed_targets(study: FaultStudy) -> Iterator[str]:
    """Targets that are missed: 99 % detection of every fault and grade, at most 1 % false alarms."""
    for pair in study.detections():
        if pair.severity is not None and not pair.seen:
            yield f"{pair.fault}, {pair.grade}: {pair.named} of {pair.of} named"
    clean = [study.alarms(grade) for grade in study.grades]
    recordings, findings = sum(count for count, _ in clean), sum(alarms.total() for _, alarms in clean)
    if findings > (1.0 - SEEN) * recordings:
        yield f"{findings} of {recordings} clean recordings raise a finding"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", nargs="+", default=(), metavar="NAME", help="default all")
    parser.add_argument("--grades", nargs="+", default=GRADES, choices=GRADES)
    parser.add_argument("--injections", type=int, default=200, help="of every fault and grade (default 200)")
    parser.add_argument("--clean", type=int, default=200, help="clean recordings of every grade (default 200)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--seed", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--results", type=Path, default=RESULTS, help=f"file to go on with (default {RESULTS})")
    parser.add_argument("--fresh", action="store_true", help="delete that file first")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table to this file")
    arguments = parser.parse_args()
    if arguments.fresh:
        arguments.results.unlink(missing_ok=True)
    arguments.results.parent.mkdir(parents=True, exist_ok=True)
    try:
        study = FaultStudy(
            arguments.results,
            faults=arguments.faults,
            grades=arguments.grades,
            injections=arguments.injections,
            clean=arguments.clean,
            seed=arguments.seed,
        )
    except InputError as error:
        console.print(str(error))
        return error.exit_code
    study.run(jobs=arguments.jobs, report=progress())
    console.print(table(study))
    if arguments.markdown is not None:
        atomic_write_text(arguments.markdown, markdown(study))
    missed = list(missed_targets(study))
    for line in missed:
        console.print(f"Missed: {line}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
