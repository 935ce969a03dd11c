"""Detection study of the faults: many injections of each, clean recordings, and decreasing severities.

A trial is one unit of a grade and a seed, with the requested faults injected one after another. It is a function of
grade and seed. Results are appended to a file, and an interrupted study resumes from it.

The severity is halved step by step while the fault is still detected (:func:`severity_at`). The smallest severity
detected is that of the last step at which all of :data:`LADDER_UNITS` units are named. The stated severity counts as
detected at 99 % (198 of 200); 40 of 40 alone give a lower limit of 92.8 % at 95 % confidence.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults import execution, logger, site_and_drift
from injected_faults.injection import GRADES, INJECTIONS, Case, Injection

from srt.diagnosis.faults import FAULTS
from srt.diagnosis.staged_diagnosis import diagnose
from srt.exceptions import InputError

if TYPE_CHECKING:
    from srt.diagnosis.staged_diagnosis import Diagnosis

Report = Callable[[int, int], None]
"""Callback with the number of the severity step (rung) and of the units left in it."""

FORMAT: Final = "srt-fault-study 1"
SEEN: Final = 0.99
"""Share of the injections that must be named for a fault to count as detected."""
LADDER_UNITS: Final = 40
"""Units of each severity below the stated one."""
MOST_RUNGS: Final = 12
"""Largest number of halvings: a factor of 4096."""
_FIRST_UNITS: Final = 8
"""Units run first at each step: an undetected severity mostly shows within these."""
CLEAN: Final = ""
"""Fault name of a clean recording."""

LEAST_ONE: Final = ("sequences", "samples", "columns", "channels", "windows")
"""Severity units that are counts: a step halves them, rounded up; one is the last."""
FACTORS: Final = ("times", "times the noise")
"""Severity units that are factors: a step takes the square root."""
SHARES: Final = ("of the planned length",)
"""Severity units that are a remaining share of the whole: a step halves the missing part."""
ALL_OR_NOTHING: Final = ("", "-")
"""Severity units of a fault that is present or absent: there is no smaller severity."""


_MODULES: Final = (logger, execution, site_and_drift)
"""Modules of the injections, which register on import."""


def all_injections() -> dict[str, Injection]:
    """Injections by fault name."""
    return INJECTIONS


@dataclass(frozen=True, slots=True)
class DiagnosedRecording:
    """One recording and the first cause that the diagnosis named.

    Attributes
    ----------
    fault : str
        Fault injected; :data:`CLEAN` for none.
    grade : str
    seed : int
    rung : int
        0 for the stated severity, n for n halvings.
    severity : float
        0 for a clean recording.
    named : str or None
        First cause; None without a finding other than notes.
    """

    fault: str
    grade: str
    seed: int
    rung: int
    severity: float
    named: str | None


@dataclass(frozen=True, slots=True)
class FaultDetection:
    """Detection of one fault in one grade.

    Attributes
    ----------
    fault, grade : str
    severity : float or None
        Stated severity; None if the fault is not detectable in this grade.
    unit : str
    named, of : int
        Injections at that severity named first, and all.
    smallest : float or None
        Smallest severity detected; None if the stated one is not, or smaller ones were not tried.
    misnamed : mapping of str to int
        Causes named first instead; "nothing" for no finding.
    reason : str
        Reason why the fault is not detectable in this grade.
    """

    fault: str
    grade: str
    severity: float | None
    unit: str
    named: int = 0
    of: int = 0
    smallest: float | None = None
    misnamed: Mapping[str, int] = field(default_factory=dict)
    reason: str = ""

    @property
    def seen(self) -> bool:
        """True if enough of the injections were named."""
        return self.of > 0 and self.named >= SEEN * self.of


def severity_at(injection: Injection, grade: str, rung: int) -> float | None:
    """Severity after ``rung`` halvings of the stated one; None if there is no such step."""
    stated = injection.severity[grade]
    if rung == 0:
        return stated
    if injection.unit in ALL_OR_NOTHING:
        return None
    if injection.unit in LEAST_ONE:
        left = math.ceil(stated / 2.0**rung)
        return float(left) if left < math.ceil(stated / 2.0 ** (rung - 1)) else None
    if injection.unit in FACTORS:
        return float(stated ** (0.5**rung))
    if injection.unit in SHARES:
        return 1.0 - (1.0 - stated) / 2.0**rung
    return stated / 2.0**rung


def diagnose_unit(grade: str, seed: int, asked: Sequence[tuple[str, int]]) -> list[DiagnosedRecording]:
    """Inject faults into one unit and diagnose each recording.

    Parameters
    ----------
    grade : str
    seed : int
    asked : sequence of (str, int)
        Faults, or :data:`CLEAN`, each with its severity step.
    """
    catalogue = all_injections()
    case = Case(grade, seed)
    return [_row(case, catalogue.get(fault), rung) for fault, rung in asked]


def _row(case: Case, injection: Injection | None, rung: int) -> DiagnosedRecording:
    if injection is None:
        return DiagnosedRecording(CLEAN, case.grade, case.seed, 0, 0.0, _cause(diagnose(case.recording)))
    severity = severity_at(injection, case.grade, rung)
    assert severity is not None
    try:
        recording = injection.recording(case, severity)
    except InputError as error:
        named = error.fault
    else:
        diagnosis = diagnose(recording, injection.options)
        named = _cause(diagnosis)
        if named is None and FAULTS[injection.fault].effect == "note" and diagnosis.findings:
            named = diagnosis.findings[0].fault
    return DiagnosedRecording(injection.fault, case.grade, case.seed, rung, severity, named)


def _cause(diagnosis: Diagnosis) -> str | None:
    return None if diagnosis.first is None else diagnosis.first.fault


class FaultStudy:
    """Detection study and its results so far.

    Parameters
    ----------
    path : path-like
        File of the results, one line of JSON each. Results that it holds are not computed again: delete it after a
        change of the checks.
    faults, grades : sequence of str, optional
        Default all.
    injections, clean : int
        Units of each fault and grade at the stated severity, and clean recordings of each grade.
    seed : int
        First seed.

    Raises
    ------
    InputError
        An unknown fault or grade, or a file that holds something else.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        faults: Sequence[str] = (),
        grades: Sequence[str] = (),
        injections: int = 200,
        clean: int = 200,
        seed: int = 0,
    ) -> None:
        self.path = Path(path)
        self.catalogue = all_injections()
        self.faults = tuple(faults) or tuple(name for name in FAULTS if name in self.catalogue)
        self.grades = tuple(grades) or GRADES
        for name, given, known in (
            ("fault", self.faults, self.catalogue),
            ("grade", self.grades, GRADES),
        ):
            unknown = [value for value in given if value not in known]
            if unknown:
                raise InputError(f"There is no {name} {unknown[0]!r} to inject: choose of {', '.join(known)}.")
        self.injections, self.clean, self.seed = injections, clean, seed
        self._rows: dict[tuple[str, str, int, int], DiagnosedRecording] = {
            row_key(row): row for row in _read(self.path)
        }

    def rows(self, fault: str, grade: str, rung: int, count: int) -> list[DiagnosedRecording]:
        """Results of the first ``count`` units of a fault and grade, at the severity now stated."""
        severity = self._severity(fault, grade, rung)
        rows = (self._rows.get((fault, grade, rung, self.seed + n)) for n in range(count))
        return [row for row in rows if row is not None and row.severity == severity]

    def _severity(self, fault: str, grade: str, rung: int) -> float | None:
        return 0.0 if fault == CLEAN else severity_at(self.catalogue[fault], grade, rung)

    def run(self, *, jobs: int = 1, report: Report | None = None) -> None:
        """Compute missing results, severity step by severity step.

        Parameters
        ----------
        jobs : int
            Processes.
        report : callable, optional
            Called after every unit.
        """
        steps = [
            (0, self.injections),
            *((n, m) for n in range(1, MOST_RUNGS + 1) for m in (_FIRST_UNITS, LADDER_UNITS)),
        ]
        for rung, units in steps:
            missing = self._missing(rung, units)
            if not missing:
                continue
            left = len(missing)
            with self._opened() as file:
                for rows in _computed(missing, jobs):
                    for row in rows:
                        self._rows[row_key(row)] = row
                        file.write(json.dumps(asdict(row)) + "\n")
                    file.flush()
                    left -= 1
                    if report is not None:
                        report(rung, left)

    def _missing(self, rung: int, units: int) -> dict[tuple[str, int], list[tuple[str, int]]]:
        """Missing trials: (fault, rung) by (grade, seed) of the unit."""
        out: dict[tuple[str, int], list[tuple[str, int]]] = {}
        for grade in self.grades:
            asked = [(fault, units) for fault in self._alive(grade, rung)]
            if rung == 0:
                asked.insert(0, (CLEAN, self.clean))
            for fault, count in asked:
                done = {row.seed for row in self.rows(fault, grade, rung, count)}
                for seed in range(self.seed, self.seed + count):
                    if seed not in done:
                        out.setdefault((grade, seed), []).append((fault, rung))
        return out

    def _alive(self, grade: str, rung: int) -> list[str]:
        """Faults with this severity step, detected at the one before, and not missed at this one so far."""
        out = []
        for fault in self.faults:
            injection = self.catalogue[fault]
            if grade not in injection.severity or severity_at(injection, grade, rung) is None:
                continue
            if rung == 0 or (self._seen(fault, grade, rung - 1) and not self._missed(fault, grade, rung)):
                out.append(fault)
        return out

    def _tried(self, fault: str, grade: str) -> bool:
        """True if smaller severities were tried, or if there are none."""
        return severity_at(self.catalogue[fault], grade, 1) is None or bool(self.rows(fault, grade, 1, LADDER_UNITS))

    def _missed(self, fault: str, grade: str, rung: int) -> bool:
        return any(row.named != fault for row in self.rows(fault, grade, rung, LADDER_UNITS))

    def _seen(self, fault: str, grade: str, rung: int) -> bool:
        count = LADDER_UNITS if rung else self.injections
        rows = self.rows(fault, grade, rung, count)
        named = sum(row.named == fault for row in rows)
        return 0 < len(rows) == count and named >= (count if rung else SEEN * count)

    def _opened(self) -> Any:
        """Open the file for appending, after removing an incomplete last line."""
        if self.path.exists():
            content = self.path.read_bytes()
            whole = content.rfind(b"\n") + 1
            if whole < len(content):
                self.path.write_bytes(content[:whole])
        if not self.path.exists() or self.path.stat().st_size == 0:
            self.path.write_text(json.dumps(FORMAT) + "\n", encoding="utf-8")
        return self.path.open("a", encoding="utf-8")

    def detections(self) -> Iterator[FaultDetection]:
        """Detection of every fault in every grade."""
        for fault in self.faults:
            injection = self.catalogue[fault]
            for grade in self.grades:
                if grade not in injection.severity:
                    yield FaultDetection(fault, grade, None, injection.unit, reason=injection.unseen.get(grade, ""))
                    continue
                rows = self.rows(fault, grade, 0, self.injections)
                misnamed = Counter(row.named or "nothing" for row in rows if row.named != fault)
                rung = 0
                while rung <= MOST_RUNGS and self._seen(fault, grade, rung):
                    rung += 1
                yield FaultDetection(
                    fault,
                    grade,
                    injection.severity[grade],
                    injection.unit,
                    len(rows) - misnamed.total(),
                    len(rows),
                    severity_at(injection, grade, rung - 1) if rung and self._tried(fault, grade) else None,
                    dict(misnamed.most_common()),
                )

    def alarms(self, grade: str) -> tuple[int, Counter[str]]:
        """Number of clean recordings of a grade, and the causes named in them."""
        rows = self.rows(CLEAN, grade, 0, self.clean)
        return len(rows), Counter(row.named for row in rows if row.named is not None)


def row_key(row: DiagnosedRecording) -> tuple[str, str, int, int]:
    """Key of a result: fault, grade, severity step and seed."""
    return row.fault, row.grade, row.rung, row.seed


def _read(path: Path) -> list[DiagnosedRecording]:
    """Results of an earlier run; an incomplete last line is ignored."""
    if not path.exists():
        return []
    try:
        content = path.read_text(encoding="utf-8")
        lines = content[: content.rfind("\n") + 1].splitlines()
        values = [json.loads(line) for line in lines]
        rows = [DiagnosedRecording(**value) for value in values[1:]]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path} holds no results of this study ({error}): delete it, or name another file.") from None
    if values and values[0] != FORMAT:
        raise InputError(f"{path} holds no results of this study: delete it, or name another file.")
    return rows


def _computed(
    missing: Mapping[tuple[str, int], list[tuple[str, int]]], jobs: int
) -> Iterator[list[DiagnosedRecording]]:
    if jobs <= 1:
        for (grade, seed), asked in missing.items():
            yield diagnose_unit(grade, seed, asked)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(diagnose_unit, grade, seed, asked) for (grade, seed), asked in missing.items()]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)
