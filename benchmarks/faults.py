"""How reliably faults are named, and how seldom sound recordings raise any: docs/fault-detection.md.

``python benchmarks/faults.py`` puts every fault into 200 units of every grade, halves its severity for as long as it is
still seen, and looks at 200 clean recordings of every grade. Results go to a file as they come; a run that was
interrupted goes on with what it holds. ``--markdown docs/fault-detection.md`` writes the table that is committed. The
exit code is 1 if a fault is named in fewer than 99 % of its injections, or more than 1 % of the clean recordings raise
a finding.
"""

import os

# One thread for each process, their children included: the matrices are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import argparse
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from sims.faults.injection import GRADES
from sims.faults.study import Report, Study
from sims.faults.table import cell, markdown, missed_targets
from srt.diagnosis.faults import FAULTS
from srt.exceptions import InputError
from srt.recording.atomic import atomic_write_text

console = Console(width=180)
RESULTS = Path("build") / "fault-study.jsonl"
EVERY_S = 60.0


def progress() -> Report:
    """Give a line a minute."""
    began = said = time.monotonic()

    def report(rung: int, left: int) -> None:
        nonlocal said
        if left == 0 or time.monotonic() - said > EVERY_S:
            said = time.monotonic()
            what = "stated severity" if rung == 0 else f"severity halved {rung} times"
            console.print(f"{said - began:.0f} s: {what}, {left} units left")

    return report


def table(study: Study) -> Table:
    out = Table(title="severity: named first of injections; smallest severity seen")
    out.add_column("fault")
    out.add_column("effect")
    for grade in study.grades:
        out.add_column(grade)
    pairs = list(study.pairs())
    for fault in study.faults:
        cells = (cell(pair) for pair in pairs if pair.fault == fault)
        out.add_row(fault, FAULTS[fault].effect, *cells)
    out.add_section()
    clean = ((count, alarms.total()) for count, alarms in map(study.alarms, study.grades))
    out.add_row("clean recordings", "", *(f"{alarms} of {count} raise a finding" for count, alarms in clean))
    return out


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
        study = Study(
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
