"""Outcome of every kind of fault at three severities in four grades: named, refused, or in silence.

``python benchmarks/fault_outcomes.py`` injects each kind into one unit of each grade at three severities, of which the
least moves one parameter by 3 to 5 sigma (:mod:`fault_severities`), and compares a calibration that says nothing with
that of the same unit without the fault. Kinds that move no parameter by as much do no harm; they have the stated
severity, its half and its quarter (of a factor the root). Kinds are the faults of the catalogue, their variants in the
forms of foreign loggers and operators, and pairs. Times, places, axes, signs and sizes come from ``--seed``. Each
injection that is not named first is printed, then the table of docs/fault-detection.md. ``--kinds`` and ``--part``
choose a part of them. The exit code is 1 if a calibration is beyond 3 sigma in silence, of a kind that is not on the
list of what cannot be seen.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import harness
from fault_severities import KINDS, Units, severities
from injected_faults.injection import GRADES, Injection
from studies import markdown

import srt
from srt.diagnosis.staged_diagnosis import diagnose
from srt.exceptions import DataError, InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


SIGMAS: Final = 3.0
"""Largest shift in silence, in sigma of the calibration without the fault."""
OUTCOMES: Final = ("named first", "another cause first", "refused without a cause", "doubtful", "within", "beyond")
"""Outcomes: the last three name no cause; the calibration is not sound, or its shift is within or beyond the limit."""
COLUMNS: Final = (
    "grade", "named first, all", "of what does harm", "of that, without what cannot be seen", "another first",
    "refused", "only doubtful", "silent, within 3σ", "silent, beyond 3σ",
)  # fmt: skip
CANNOT_BE_SEEN: Final = {
    "gravity": "within the heights and anomalies of the Earth's surface, it is the scale of the accelerometers",
    "gravity of another country": "as gravity",
    "sample_rate": "within the scale errors of an uncalibrated unit, it is their scale, if no Earth rate is measured",
    "clock fast": "as sample_rate",
    "nominal rate of a chip": "as sample_rate",
    "time_unit": "as sample_rate: a factor near 1 is no unit",
    "rate_contradicts_stamps": "as sample_rate: a factor near 1 is within what stamps tell of a rate",
    "stamps in minutes": "as time_unit",
    "sample_rate and spikes": "as sample_rate, spikes of less than the noise",
    "time_unit and gyro_lsb": "as sample_rate",
}
"""Kinds whose smaller severities no check can tell from a sound unit, in all grades, with the reason."""
AT_THE_LIMIT: Final = {
    ("north", "navigation-rlg"): (0.5, "5 sigma of what the gyros and a fixture of 1 mrad resolve; the limit is 4.5"),
    ("table faces the other way", "navigation-rlg"): (0.5, "as north"),
    ("accel_bias_drift", "navigation-rlg"): (0.05, "named in four of six units: 50 ug against 1 ug of instability"),
    ("earth rate removed", "consumer-mems"): (1.0, "as earth_rate_absent: gyros do not resolve the Earth rate"),
    ("clock_drift", "tactical-fog"): (2.5e-4, "2.2 sigma of all residuals together; the limit is 4.5"),
    ("clock_drift", "industrial-mems"): (
        1.1e-3,
        "a drift of gyro scale that rotations of 1 mrad do not show",
    ),
    ("clock_drift", "consumer-mems"): (1.1e-3, "as on industrial-mems"),
    ("latitude", "tactical-fog"): (11.7, "gyros resolve 2.2 deg, limit 5.3 sigma; else as on industrial-mems"),
    ("latitude", "industrial-mems"): (22.5, "gyros resolve 4 deg; normal gravity follows the latitude, as gravity"),
    ("latitude and accel_stuck", "tactical-fog"): (0.05, "latitude of 2 deg, as latitude; two samples stuck, as noise"),
    ("latitude and accel_stuck", "industrial-mems"): (0.05, "as on tactical-fog"),
    ("gyro_bias_drift", "consumer-mems"): (300.0, "within the flicker of 20 deg/h over the test"),
    ("gyro bias steps", "consumer-mems"): (300.0, "as gyro_bias_drift"),
    ("gyro_factor", "consumer-mems"): (1.25, "as sample_rate"),
    ("gyro_factor", "industrial-mems"): (1.06, "as sample_rate"),
}
"""Largest severities that no check tells safely, by kind and grade, with the reason."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one injection.

    Attributes
    ----------
    kind, grade : str
    rung : int
        0 for the largest severity, 2 for the least.
    severity : float
    outcome : str
        One of :data:`OUTCOMES`.
    named : str
        First cause named; "" for none.
    shift : float
        Largest shift of a parameter, in sigma; 0 where it was not calibrated.
    parameter : str
        Parameter of that shift.
    harmful : bool
        True if the fault moves a parameter by more than 3 sigma, or leaves no result.
    """

    kind: str
    grade: str
    rung: int
    severity: float
    outcome: str
    named: str = ""
    shift: float = 0.0
    parameter: str = ""
    harmful: bool = True


def outcome_of(injection: Injection, units: Units, grade: str, rung: int, severity: float) -> Outcome:
    """Inject a fault and classify what the diagnosis and the calibration say."""
    stated = injection.fault, grade, rung, severity
    try:
        recording = injection.recording(units.case(grade, rung), severity)
    except InputError as error:
        return Outcome(*stated, _naming(injection, error.fault), error.fault or "")
    diagnosis = diagnose(recording, injection.options)
    first = diagnosis.first
    if first is None:
        first = next((f for f in diagnosis.findings if f.fault in injection.causes), None)
    if first is not None:
        return Outcome(*stated, _naming(injection, first.fault), first.fault)
    try:
        found = srt.calibrate(recording, checks=False, options=injection.options)
    except (DataError, InputError) as error:
        return Outcome(*stated, _naming(injection, error.fault), error.fault or "")
    shift, parameter = units.shift(found, injection, grade, rung)
    silent = found.judgement.word == "sound"
    outcome = OUTCOMES[4 if shift <= SIGMAS else 5] if silent else OUTCOMES[3]
    return Outcome(*stated, outcome, "", shift, parameter)


def _naming(injection: Injection, named: str | None) -> str:
    if named is None:
        return OUTCOMES[2]
    return OUTCOMES[0] if named in injection.causes else OUTCOMES[1]


def outcomes(kinds: Sequence[str], grades: Sequence[str], seed: int) -> Iterator[Outcome]:
    """Outcomes of kinds in grades at all severities."""
    units = Units(seed)
    for grade in grades:
        for kind in kinds:
            harms, steps = severities(KINDS[kind], units, grade)
            for rung, severity in enumerate(steps):
                row = outcome_of(KINDS[kind], units, grade, rung, severity)
                yield replace(row, harmful=harms and row.outcome != OUTCOMES[4])


def unseen(row: Outcome) -> bool:
    """True if the lists of what cannot be seen hold the fault in this grade, at this severity."""
    most, _ = AT_THE_LIMIT.get((row.kind, row.grade), (0.0, ""))
    return row.grade in KINDS[row.kind].unseen or row.kind in CANNOT_BE_SEEN or row.severity <= most


def harmful(rows: Sequence[Outcome]) -> tuple[list[Outcome], list[Outcome]]:
    """Injections that do harm, and those of them that are named or are not on the list of what cannot be seen."""
    harm = [row for row in rows if row.harmful]
    return harm, [row for row in harm if not (row.outcome in (OUTCOMES[3], OUTCOMES[5]) and unseen(row))]


def share_named(rows: Sequence[Outcome]) -> str:
    """Number of injections whose cause is named first."""
    first = sum(row.outcome == OUTCOMES[0] for row in rows)
    return f"{first} of {len(rows)} ({100.0 * first / max(1, len(rows)):.0f} %)"


def table(rows: Sequence[Outcome]) -> Iterator[str]:
    """Lines of the table by grade."""

    def cells(grade: str, mine: Sequence[Outcome]) -> list[str]:
        counts = Counter(row.outcome for row in mine)
        shares = (share_named(part) for part in (mine, *harmful(mine)))
        return [grade, *shares, *(str(counts[name]) for name in OUTCOMES[1:])]

    grades = dict.fromkeys(row.grade for row in rows)
    lines = [cells(grade, [row for row in rows if row.grade == grade]) for grade in grades]
    return markdown(COLUMNS, [*lines, cells("all", rows)], len(COLUMNS))


def main(
    *, seed: int = 0, kinds: tuple[str, ...] = tuple(KINDS), grades: tuple[str, ...] = GRADES, part: int = 1
) -> int:
    kinds = kinds[::part]
    began, rows = time.process_time(), []
    for row in outcomes(kinds, grades, seed):
        rows.append(row)
        if row.outcome != OUTCOMES[0]:
            shift = f" {row.shift:.3g} sigma {row.parameter}" if row.parameter else ""
            marks = ("" if row.harmful else " (harmless)") + (" *" if unseen(row) else "")
            print(f"{row.kind}, {row.grade}, {row.severity:.4g}: {row.outcome} {row.named}{shift}{marks}", flush=True)
    print(f"{len(kinds)} kinds, {len(rows)} injections, {time.process_time() - began:.0f} s of CPU time\n")
    print(*table(rows), sep="\n")
    return int(any(row.outcome == OUTCOMES[5] and not unseen(row) for row in rows))


if __name__ == "__main__":
    harness.run(main, __doc__, kinds=KINDS, grades=GRADES)
