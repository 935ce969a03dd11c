"""Detection rate of every fault and false-alarm rate of clean recordings: docs/fault-detection.md.

``python benchmarks/faults.py`` injects every fault into 200 units of every grade, halves its severity while all of 40
units are named, diagnoses 200 clean recordings of every grade, and prints the tables of the page as Markdown. A trial
is a function of fault, grade, severity and seed; its result is stored in a file, from which an interrupted run
resumes: add ``--fresh`` after a change of the checks. The exit code is 1 if a fault is named in fewer than 99 % of its
injections, or if more than 1 % of the clean recordings raise a finding.
"""

import itertools
import sqlite3
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import harness
from fault_severities import ALL_OR_NOTHING, severity_at
from injected_faults.injection import GRADES, INJECTIONS, Case
from studies import counts, in_processes, markdown

from srt.diagnosis.faults import FAULTS
from srt.diagnosis.staged_diagnosis import diagnose
from srt.exceptions import InputError

RESULTS = Path("build") / "fault-study.sqlite"
SEEN = 0.99
"""Share of the injections that must be named for a fault to count as detected."""
LADDER_UNITS = 40
"""Units of each severity below the stated one; 40 of 40 give a lower limit of 92.8 % at 95 % confidence."""
FIRST_UNITS = 8
"""Units run first at each step: an undetected severity mostly shows within these."""
MOST_RUNGS = 12
"""Largest number of halvings: a factor of 4096."""
CLEAN = ""
"""Fault name of a clean recording."""
NOTHING = "nothing"
"""Cause named in a recording without a finding other than notes."""

Trial = tuple[str, str, float, int, str]
"""Fault, grade, severity and seed, and the cause named first."""


def named(fault: str, case: Case, severity: float) -> str:
    """Cause named first in a unit with a fault of this severity, or with none."""
    if fault == CLEAN:
        found, note = diagnose(case.recording), False
    else:
        injection, note = INJECTIONS[fault], FAULTS[fault].effect == "note"
        try:
            found = diagnose(injection.recording(case, severity), injection.options)
        except InputError as error:
            return error.fault or NOTHING
    first = found.findings[0] if note and found.first is None and found.findings else found.first
    return NOTHING if first is None else first.fault


def trials(grade: str, seed: int, asked: Sequence[tuple[str, float]]) -> list[Trial]:
    """Trials of one unit with one fault after another, each with its severity."""
    case = Case(grade, seed)
    return [(fault, grade, severity, seed, named(fault, case, severity)) for fault, severity in asked]


@dataclass(frozen=True, slots=True)
class Detection:
    """Detection of one fault in one grade.

    ``causes`` counts those named first at the stated severity, which is None if the fault cannot be detected in this
    grade; ``smallest`` is the smallest severity detected, None if the stated one is not or smaller ones were not tried.
    """

    fault: str
    grade: str
    severity: float | None
    causes: Counter[str]
    smallest: float | None = None

    @property
    def seen(self) -> bool:
        """True if enough of the injections were named."""
        return 0 < self.causes.total() * SEEN <= self.causes[self.fault]

    def cell(self) -> str:
        """Cell of the table."""
        right, unit = f"{self.causes[self.fault]}/{self.causes.total()}", INJECTIONS[self.fault].unit
        if self.severity is None or not self.causes:
            return "unseen" if self.severity is None else "not run"
        if unit in ALL_OR_NOTHING:
            return right
        smallest = f"; ≥ {self.smallest:.4g}" if self.smallest is not None else "" if self.seen else "; none seen"
        return f"{self.severity:.4g} {unit}: {right}{smallest}"


class FaultStudy:
    """Detection study and its results so far.

    Parameters
    ----------
    path : Path
        File of the results; created if absent.
    faults, grades : sequence of str, optional
        Default all.
    injections, clean : int
        Units of each fault and grade at the stated severity, and clean recordings of each grade.
    seed : int
        First seed.

    Raises
    ------
    InputError
        A file of something else.
    """

    def __init__(
        self,
        path: Path,
        *,
        faults: Sequence[str] = (),
        grades: Sequence[str] = GRADES,
        injections: int = 200,
        clean: int = 200,
        seed: int = 0,
    ) -> None:
        self.faults = tuple(faults) or tuple(name for name in FAULTS if name in INJECTIONS)
        self.grades, self.injections, self.clean, self.seed = grades, injections, clean, seed
        self.file = sqlite3.connect(path)
        key = "fault, grade, severity, seed"
        try:
            self.file.execute(f"CREATE TABLE IF NOT EXISTS trials ({key}, cause, PRIMARY KEY ({key}))")
        except sqlite3.DatabaseError as error:
            raise InputError(f"{path} holds no results of this study ({error}): name another file.") from None

    def severity(self, fault: str, grade: str, rung: int) -> float | None:
        """Severity after a number of halvings; None if there is no such step."""
        return 0.0 if fault == CLEAN else severity_at(INJECTIONS[fault], grade, rung)

    def rows(self, fault: str, grade: str, rung: int, count: int) -> list[tuple[int, str]]:
        """Seed and cause of the trials among the first ``count`` units, at the severity now stated."""
        asked = fault, grade, self.severity(fault, grade, rung), self.seed, self.seed + count - 1
        where = "fault = ? AND grade = ? AND severity = ? AND seed BETWEEN ? AND ?"
        return self.file.execute(f"SELECT seed, cause FROM trials WHERE {where}", asked).fetchall()  # noqa: S608

    def causes(self, fault: str, grade: str, rung: int = 0) -> Counter[str]:
        """Causes named in the trials of one severity."""
        count = LADDER_UNITS if rung else self.clean if fault == CLEAN else self.injections
        return Counter(cause for _, cause in self.rows(fault, grade, rung, count))

    def seen(self, fault: str, grade: str, rung: int) -> bool:
        """True if all trials of this severity were run, and as many named as a detection takes."""
        causes, count = self.causes(fault, grade, rung), LADDER_UNITS if rung else self.injections
        return causes.total() == count and causes[fault] >= (count if rung else SEEN * count)

    def asked(self, rung: int, units: int) -> dict[tuple[str, int], list[tuple[str, float]]]:
        """Trials to run, by grade and seed: of the faults that were seen, and not missed at this severity so far."""
        out: dict[tuple[str, int], list[tuple[str, float]]] = defaultdict(list)
        for fault, grade in itertools.product((CLEAN, *self.faults), self.grades):
            if fault == CLEAN:
                count, wanted = self.clean, rung == 0
            else:
                count, wanted = units, grade in INJECTIONS[fault].severity
                if rung and wanted:
                    missed = set(self.causes(fault, grade, rung)) - {fault}
                    wanted = self.seen(fault, grade, rung - 1) and not missed
            severity = self.severity(fault, grade, rung) if wanted else None
            if severity is not None:
                done = {seed for seed, _ in self.rows(fault, grade, rung, count)}
                for seed in sorted(set(range(self.seed, self.seed + count)) - done):
                    out[grade, seed].append((fault, severity))
        return out

    def run(self, jobs: int = 1) -> None:
        """Run the missing trials, severity step by severity step."""
        began = time.monotonic()
        steps = itertools.product(range(1, MOST_RUNGS + 1), (FIRST_UNITS, LADDER_UNITS))
        for rung, units in ((0, self.injections), *steps):
            asked = self.asked(rung, units)
            tasks = ((*unit, faults) for unit, faults in asked.items())
            for found in in_processes(jobs, trials, tasks, as_they_end=True):
                with self.file:
                    self.file.executemany("INSERT INTO trials VALUES (?, ?, ?, ?, ?)", found)
            if asked:
                print(f"{time.monotonic() - began:.0f} s: {len(asked)} units, severity halved {rung} times", flush=True)

    def detections(self) -> Iterator[Detection]:
        """Detection of every fault in every grade."""
        for fault, grade in itertools.product(self.faults, self.grades):
            injection = INJECTIONS[fault]
            if grade not in injection.severity:
                yield Detection(fault, grade, None, Counter())
                continue
            rung = 0
            while rung <= MOST_RUNGS and self.seen(fault, grade, rung):
                rung += 1
            tried = severity_at(injection, grade, 1) is None or self.causes(fault, grade, 1)
            smallest = severity_at(injection, grade, rung - 1) if rung and tried else None
            yield Detection(fault, grade, injection.severity[grade], self.causes(fault, grade), smallest)

    def alarms(self, grade: str) -> tuple[int, Counter[str]]:
        """Number of clean recordings of a grade, and the causes named in them."""
        causes = self.causes(CLEAN, grade)
        return causes.total(), Counter({cause: n for cause, n in causes.items() if cause != NOTHING})


def page(study: FaultStudy) -> Iterator[str]:
    """Lines of the tables: every fault and grade, clean recordings, and what cannot be seen or is named otherwise."""
    found = list(study.detections())
    cells = {fault: [one.cell() for one in found if one.fault == fault] for fault in study.faults}
    rows = ([f"`{fault}`", FAULTS[fault].effect, *row] for fault, row in cells.items())
    yield from markdown(("fault", "effect", *study.grades), rows, 2 + len(study.grades))
    clean = ((grade, *study.alarms(grade)) for grade in study.grades)
    columns = "grade", "clean recordings", "with a finding", "findings"
    yield from ("", *markdown(columns, ((g, str(n), str(a.total()), counts(a.elements())) for g, n, a in clean), 4), "")
    for one in found:
        if one.severity is None:
            yield f"- `{one.fault}`, {one.grade}: {INJECTIONS[one.fault].unseen.get(one.grade, '')}"
    for one in found:
        others = Counter({cause: n for cause, n in one.causes.items() if cause != one.fault})
        if others:
            yield f"- `{one.fault}`, {one.grade}, named otherwise: {counts(others.elements())}"


def missed_targets(study: FaultStudy) -> Iterator[str]:
    """Targets that are missed: 99 % detection of every fault and grade, at most 1 % false alarms."""
    for one in study.detections():
        if one.severity is not None and not one.seen:
            yield f"{one.fault}, {one.grade}: {one.causes[one.fault]} of {one.causes.total()} named"
    recordings, alarms = zip(*map(study.alarms, study.grades), strict=True)
    findings = sum(each.total() for each in alarms)
    if findings > (1.0 - SEEN) * sum(recordings):
        yield f"{findings} of {sum(recordings)} clean recordings raise a finding"


def main(
    *,
    faults: tuple[str, ...] = (),
    grades: tuple[str, ...] = GRADES,
    injections: int = 200,
    clean: int = 200,
    jobs: int = 2,
    seed: int = 0,
    results: Path = RESULTS,
    fresh: bool = False,
) -> int:
    if fresh:
        results.unlink(missing_ok=True)
    results.parent.mkdir(parents=True, exist_ok=True)
    study = FaultStudy(results, faults=faults, grades=grades, injections=injections, clean=clean, seed=seed)
    study.run(jobs)
    missed = [f"Missed: {line}" for line in missed_targets(study)]
    print("", *page(study), "", *missed, sep="\n")
    return int(bool(missed))


if __name__ == "__main__":
    harness.run(main, __doc__, faults=INJECTIONS, grades=GRADES)
