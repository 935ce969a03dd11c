"""Honesty of the sigmas: NEES, verdicts and what is named, where recordings have errors, drifts, defects, or none.

``python benchmarks/honesty.py STUDY --units N`` prints a Markdown table, a row for each cell and estimator; ``--only
WORD ...`` takes the cells with these words. NEES is over the number of observed parameters, 1 if all sigmas are true;
the band is that of the whole table (family-wise 1 %). The exit code is 1 if a cell lies beyond the limit of its study.

verdicts           faults on the fixture, without the checks; "used": results with the verdict sound or doubtful
silent-errors      errors that gave wrong results without a word
fixture-drift      drift of the biases on the fixture, 0.1, 1 and 10 times what is stated of the grade
false-drift        drift modelled in units without one: at most one recording in 50,000, by design
hand, hand-stated  turned by hand, no labels: rms of the normalised errors; no noise stated, or the white noise
hand-drift, array  turned by hand, with drifts; array: twelve turns in 500 s, as recordings of a sensor array
asymmetry          nine turns: asymmetries estimated, or only where a test asks for them
defects            defects of real logs, through ``srt calibrate``
worse-than-stated  fixture, biases or readings worse than stated, through ``srt calibrate``; what the result names
unstated-noise     nothing stated, of units without and with bias instability, and all stated; on a fixture, by hand
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import studies
from accuracy_trials import noisy_recording
from foreign_motion import DRIFT_FORMS, PROFILES
from foreign_motion import GRADES as HAND_GRADES
from honesty_recordings import (
    DEFECTS,
    FAULTS,
    SILENT_ERRORS,
    STATED,
    asymmetric_unit,
    defective_unit,
    drifting_unit,
    fixture_drift,
    hand_unit,
    truth_of,
)
from injected_faults.injection import GRADES, Case
from scipy.stats import binom, chi2
from studies import ESTIMATORS, Score, counts, pooled_nees, rms, scored
from worse_recordings import CASES, HAND_RESTS_S, STATEMENTS, unit_of, unstated_unit

import srt
from srt.diagnosis.staged_diagnosis import diagnose
from srt.noise.drift_forms import FALSE_ALARM
from srt.result.verdict import OF_FIXTURE
from srt.sensor_errors import GROUP_SLICES, NAMES

Cell = tuple[Any, ...]
Rows = dict[str, Score]
Trial = Callable[[Cell, int, list[str]], Rows]
"""Scores of one unit of a cell, by estimator or by rule."""
SILENT_LIMIT = 1.15
"""Mean NEES over 27 that is allowed where an error is neither named nor inconsistent."""
RULES = {"estimated": 1.0, "where p < 0.05": 0.05, "where p < 0.001": 1e-3, "never": 0.0}
"""Probability of the test below which a group of asymmetries is estimated."""


def calibrated(unit: srt.Recording, truth: np.ndarray, estimators: list[str]) -> Rows:
    """Scores without the checks of the recording."""
    rows = {}
    for name in estimators:
        try:
            rows[name] = scored(srt.calibrate(unit, name, checks=False), truth)
        except srt.SrtError:
            rows[name] = Score("refused")
    return rows


def verdicts(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    grade, fault = cell
    case = Case(grade, 20261122 + unit)
    recording = FAULTS[fault](case, np.random.default_rng((20261122, unit)))
    found = diagnose(recording, calibrating=False)
    checks = "refused" if found.refusal else "warned" if found.first else "passed"
    rows = calibrated(recording, case.simulation.truth.vector, estimators)
    return {name: replace(row, checks=checks) for name, row in rows.items()}


def silent_errors(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    row, case = SILENT_ERRORS[cell[0]], Case("navigation-rlg", 20261130 + unit)
    recording = row.change(case, np.random.default_rng((20261130, unit)))
    found = {finding.fault for finding in diagnose(recording, calibrating=False).findings}
    rows = {}
    for name in estimators:
        result = srt.calibrate(recording, name, checks=False)
        unseen = {e.source for e in result.diagnostics.unseen_errors or () if e.sigma is None}
        score = scored(result, case.simulation.truth.vector)
        named = bool(found & set(row.findings)) or row.unseen in unseen or row.drift in score.drift
        rows[name] = replace(score, named=named)
    return rows


def drift_on_the_fixture(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    case = Case(cell[0], 20261124 + unit)
    recording = fixture_drift(case, *cell[1:], np.random.default_rng((20261124, unit)))
    return calibrated(recording, case.simulation.truth.vector, estimators)


def false_drift(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    grades = [grade for (grade,) in STUDIES["false-drift"].cells]
    seed = 500_000 + len(grades) * unit + grades.index(cell[0])
    recording, truth = noisy_recording(seed, cell[0], sample_rate_hz=20.0, instability=True)
    return calibrated(recording, truth.vector, estimators)


def by_hand(stated: bool) -> Trial:
    def trial(cell: Cell, unit: int, estimators: list[str]) -> Rows:
        seed = 1000 * list(HAND_GRADES).index(cell[0]) + unit
        return calibrated(*hand_unit(seed, *cell, stated=stated), estimators)

    return trial


def drift_by_hand(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    return calibrated(*drifting_unit(unit, *cell), estimators)


def asymmetry(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    """Errors under each rule, of gyro scale, accelerometer bias and accelerometer scale."""
    recording, truth = asymmetric_unit(unit, cell[0], ASYMMETRIES[cell[1]])
    rows = {}
    for estimator in estimators:
        found = srt.calibrate(recording, estimator, checks=False)
        tests = found.diagnostics.asymmetry or {}
        for rule, limit in RULES.items():
            score = Score(found.status, found.judgement.word)
            for group in ("gyro_scale", "accel_bias", "accel_scale"):
                test = tests.get(f"{group.split('_')[0]}_asymmetry")
                for name in NAMES[GROUP_SLICES[group]]:
                    k = NAMES.index(name)
                    if test is None or not score.usable or not found.observed[k]:
                        continue
                    other = test.without[name]
                    own = test.probability <= limit and limit > 0.0
                    value, sigma = (found.errors[name], found.sigma[k]) if own else (other.value, other.sigma)
                    score.error[k] = value - truth[k]
                    score.z[k] = score.error[k] / sigma
            rows[f"{estimator}, {rule}"] = score
    return rows


def defects(cell: Cell, unit: int, _estimators: list[str]) -> Rows:
    """Through ``srt.calibrate`` with its checks, by the default estimator."""
    recording, truth = defective_unit(cell[0], unit)
    faults = tuple(finding.fault for finding in srt.diagnose(recording).findings)
    try:
        score = scored(srt.calibrate(recording), truth)
    except srt.SrtError:
        score = Score("refused")
    named = set(DEFECTS[cell[0]].named)
    return {"default": replace(score, faults=faults, named=not named or bool(named & set(faults)))}


def named_by(found: srt.Calibration) -> tuple[str, ...]:
    """Drift that a result models, findings, and the sequence, the part of the fixture and the moves that it accuses."""
    named = [f"{row.sensor} {row.form}" for row in found.diagnostics.drift or ()]
    named += [finding.fault for finding in found.diagnostics.faults or ()]
    verdict = found.verdict
    if verdict is not None and verdict.contradicting is not None:
        named.append(f"contradicts: {verdict.contradicting.sequence}")
    added = verdict.added_noise if verdict is not None else None
    named += [OF_FIXTURE[kind] for kind in added or () if kind in OF_FIXTURE]
    named += ["move left out" for _ in found.provenance.voided]
    named += ["moves contradict" for text in found.diagnostics.contradicted or () if "recorded moves" in text]
    return *named, *("label" for warning in found.warnings if "check the label" in warning)


def worse_than_stated(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    """Through ``srt.calibrate`` with its checks; the closed form, on the fixture alone."""
    case, rows = CASES[cell[0]], {}
    recording, errors = unit_of(case, unit)
    for name in estimators:
        if name == "closed-form" and case.motion in HAND_RESTS_S:
            continue
        try:
            found = srt.calibrate(recording, name)
        except srt.InputError as error:
            rows[name] = Score("refused", faults=(str(error)[:60],))
            continue
        rows[name] = replace(scored(found, truth_of(errors)), faults=named_by(found))
    return rows


def unstated_noise(cell: Cell, unit: int, estimators: list[str]) -> Rows:
    recording, errors = unstated_unit(unit, *cell)
    able = [name for name in estimators if cell[0] == "fixture" or name != "closed-form"]
    return calibrated(recording, truth_of(errors), able)


Scores = list[Score]


def usable(scores: Scores, what: Callable[[Score], Any] = lambda s: s.z) -> np.ndarray:
    """Normalised errors, or something else, of the usable scores."""
    return np.array([what(s) for s in scores if s.usable])


def largest(values: np.ndarray) -> float:
    return float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else np.nan


def band(scores: Scores, tests: int) -> float:
    """Upper end of the band of the pooled NEES."""
    freedom = sum(s.freedom for s in scores if s.usable)
    return float(chi2.isf(0.01 / tests, freedom) / freedom) if freedom else np.nan


def worst_rms(scores: Scores) -> float:
    z = usable(scores)
    return max((rms(column) for column in z.T if np.isfinite(column).any()), default=np.nan)


def rms_limit(scores: Scores, tests: int) -> float:
    """Largest rms of the normalised errors of one parameter, family-wise 1 %."""
    return float(np.sqrt(chi2.isf(0.01 / (2 * len(NAMES) * tests), len(scores)) / len(scores)))


def all_and_used(show: Callable[[Scores], float], digits: int) -> Callable[[Scores, int], str]:
    """Of all results and of those with a usable verdict; what failed may be off by any amount."""

    def text(value: float) -> str:
        if not np.isfinite(value) or value < 0.0:
            return "-"
        return f"{value:.{digits}f}" if value < 1e4 else "> 10000"

    def column(scores: Scores, _tests: int) -> str:
        shown = [s for s in scores if s.freedom]
        return ", ".join(
            text(show(part)) if part else "-" for part in (shown, [s for s in shown if s.word in ("sound", "doubtful")])
        )

    return column


def of_groups(value: Callable[[Score], np.ndarray], group: str, factor: float = 1.0, form: str = ".2f"):
    return lambda scores, _: (
        f"{factor * rms(np.array([value(s) for s in scores if s.usable])[:, GROUP_SLICES[group]]):{form}}"
    )


COLUMNS: dict[str, Callable[[Scores, int], str]] = {
    "status": lambda scores, _: counts(s.status.replace("_", " ") for s in scores),
    "verdict": lambda scores, _: counts(s.word.replace("_", " ") for s in scores),
    "checks": lambda scores, _: counts(s.checks for s in scores),
    "what is named": lambda scores, _: counts(what for s in scores for what in sorted(set(s.faults))),
    "first finding": lambda scores, _: counts((*s.faults, "none")[0] for s in scores),
    "largest error/sigma: all, used": all_and_used(lambda part: max(largest(s.z) for s in part), 1),
    "NEES/n: all, used": all_and_used(lambda part: float(np.mean([s.nees / s.freedom for s in part])), 2),
    "NEES / n": lambda scores, _: f"{pooled_nees(scores):.2f}",
    "NEES/27": lambda scores, _: f"{np.nanmean([s.nees / s.freedom for s in scores]):.2f}",
    "band": lambda scores, tests: f"≤ {band(scores, tests):.2f}",
    "named": lambda scores, _: f"{np.mean([s.named for s in scores]):.0%}",
    "inconsistent": lambda scores, _: f"{np.mean([s.status == 'inconsistent' for s in scores]):.0%}",
    "accel. named": lambda scores, _: str(sum("accel" in s.drift for s in scores)),
    "gyro named": lambda scores, _: str(sum("gyro" in s.drift for s in scores)),
    "scale, ppm": lambda scores, _: f"{1e6 * max(usable(scores, lambda s: s.scale_sigma), default=np.nan):.0f}",
    "rms": lambda scores, _: f"{rms(usable(scores)):.2f}",
    **{group: of_groups(lambda s: s.z, group) for group in GROUP_SLICES},
    "gyro scale, ppm": of_groups(lambda s: s.error, "gyro_scale", 1e6, ".3g"),
    "acc. bias, µg": of_groups(lambda s: s.error, "accel_bias", 1e6 / 9.80665, ".3g"),
    "acc. scale, ppm": of_groups(lambda s: s.error, "accel_scale", 1e6, ".3g"),
    "worst rms": lambda scores, _: f"{worst_rms(scores):.2f}",
    "allowed": lambda scores, tests: f"{rms_limit(scores, tests):.2f}",
    "largest": lambda scores, _: f"{largest(usable(scores)):.1f}",
}
"""Columns of the tables, from the scores of a cell and the number of tests of the table."""


def silent_and_wrong(scores: Scores, _tests: int) -> bool:
    """True if units that are told nothing have a NEES above the limit by more than chance."""
    silent = [s.nees / s.freedom for s in scores if not s.named and s.status != "inconsistent"]
    # The mean of chi-square / 27 over the silent units scatters by the root.
    limit = SILENT_LIMIT + 3.5 * np.sqrt(2.0 / 27.0 / max(len(silent), 1))
    return len(silent) > 0.05 * len(scores) and bool(np.mean(silent) > limit)


def above_band(scores: Scores, tests: int) -> bool:
    """True if the pooled NEES of the usable results is; where none is usable, nothing wrong is said."""
    return pooled_nees(scores) > band(scores, tests)


def not_in_band(scores: Scores, tests: int) -> bool:
    """The same where results must be usable."""
    return not pooled_nees(scores) <= band(scores, tests)


@dataclass(frozen=True)
class Study:
    """Cells and what is done in each: ``trial`` of a unit, the columns, and when a cell is beyond its limit."""

    head: tuple[str, ...]
    cells: list[Cell]
    trial: Trial
    columns: tuple[str, ...]
    beyond: Callable[[Scores, int], bool] = lambda _scores, _tests: False
    estimators: tuple[str, ...] = ("least-squares",)


NAMED_DRIFT = ("status", "NEES / n", "band", "accel. named", "gyro named")
HAND = ("status", *GROUP_SLICES, "worst rms", "allowed", "largest")
HAND_CELLS: list[Cell] = list(product(HAND_GRADES, PROFILES))
MEMS = ("industrial", "consumer")
ASYMMETRIES = {"none": 0.0, "a tenth of the scale error": 0.1, "three tenths": 0.3, "as large": 1.0}
"""Asymmetries, 1-sigma, in units of the scale errors."""


def far_off(scores: Scores, tests: int) -> bool:
    return not worst_rms(scores) <= rms_limit(scores, tests)


STUDIES = {
    "verdicts": Study(
        ("grade", "fault"), list(product(GRADES, FAULTS)), verdicts,
        ("largest error/sigma: all, used", "NEES/n: all, used", "status", "verdict", "checks"), estimators=ESTIMATORS,
    ),
    "silent-errors": Study(
        ("error",), [(name,) for name in SILENT_ERRORS], silent_errors, ("NEES/27", "named", "inconsistent"),
        silent_and_wrong, ESTIMATORS,
    ),
    "fixture-drift": Study(
        ("grade", "drift", "mg, °/h"),
        [
            (grade, form, f"{size * stated[0]:g}, {size * stated[1]:g}")
            for grade, stated in STATED.items()
            for form, size in (("none", 0.0), *product((*DRIFT_FORMS, "temperature"), (0.1, 1.0, 10.0)))
        ],
        drift_on_the_fixture, NAMED_DRIFT, above_band, ESTIMATORS,
    ),
    "false-drift": Study(
        ("grade",), [(grade,) for grade in ("navigation", "tactical", "industrial")], false_drift, NAMED_DRIFT,
        lambda scores, _: sum(bool(s.drift) for s in scores) > binom.isf(1e-3, len(scores), FALSE_ALARM),
    ),
    "hand": Study(("grade", "profile"), HAND_CELLS, by_hand(stated=False), HAND, far_off),
    "hand-stated": Study(("grade", "profile"), HAND_CELLS, by_hand(stated=True), HAND, far_off),
    "hand-drift": Study(
        ("grade", "drift", "mg, °/h"),
        [
            (grade, *drift)
            for grade in MEMS
            for drift in (("linear", "0, 0"), *product(DRIFT_FORMS, ("0.1, 10", "4, 300", "10, 1000")))
        ],
        drift_by_hand, (*NAMED_DRIFT, "scale, ppm"), not_in_band,
    ),
    "array": Study(
        ("grade", "drift", "mg, °/h"), [(*cell, "8, 570") for cell in product(MEMS, DRIFT_FORMS)], drift_by_hand,
        (*NAMED_DRIFT, "scale, ppm"), not_in_band,
    ),
    "asymmetry": Study(
        ("grade", "asymmetry"), list(product(("tactical", "consumer"), ASYMMETRIES)), asymmetry,
        ("gyro_scale", "gyro scale, ppm", "accel_bias", "acc. bias, µg", "accel_scale", "acc. scale, ppm", "largest"),
    ),
    "defects": Study(
        ("defect",), [(name,) for name in DEFECTS], defects, ("status", "first finding", "rms", "largest"),
        lambda scores, _: not all(s.named for s in scores), ("default",),
    ),
    "worse-than-stated": Study(
        ("case",), [(name,) for name in CASES], worse_than_stated, ("NEES / n", "largest", "verdict", "what is named"),
        estimators=ESTIMATORS,
    ),
    "unstated-noise": Study(
        ("motion", "grade", "stated, unit"), list(product(("fixture", "hand"), HAND_GRADES, STATEMENTS)),
        unstated_noise, ("NEES / n", "verdict"), estimators=ESTIMATORS,
    ),
}  # fmt: skip


def chosen(study: Study, words: list[str]) -> list[Cell]:
    """Cells that have one of the words that are values of their parts, for each part that has such words.

    Raises
    ------
    ValueError
        If a word is no value of any part.
    """
    parts = [{str(cell[i]) for cell in study.cells} for i in range(len(study.head))]
    unknown = set(words).difference(*parts)
    if unknown:
        raise ValueError(
            f"no cell has {', '.join(sorted(unknown))}; there are {', '.join(sorted(set().union(*parts)))}"
        )
    asked = [part & set(words) or part for part in parts]
    return [cell for cell in study.cells if all(str(x) in ask for x, ask in zip(cell, asked, strict=True))]


def trial_of(name: str, cell: Cell, unit: int, estimators: list[str]) -> Rows:
    """Scores of one unit, in a process that has the study by its name."""
    return STUDIES[name].trial(cell, unit, estimators)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--units", type=int, default=20, help="of each cell (default 20)")
    parser.add_argument("--estimators", nargs="+", choices=ESTIMATORS)
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="cells with these words")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    study = STUDIES[options.study]
    try:
        cells = chosen(study, options.only)
    except ValueError as error:
        parser.error(str(error))
    estimators = options.estimators or list(study.estimators)
    tests, beyond = len(cells) * len(estimators), 0
    print(f"{options.units} units a cell\n")
    print(*studies.markdown((*study.head, "by", *study.columns), (), len(study.head) + 1), sep="\n", flush=True)
    for cell in cells:
        tasks = [(options.study, cell, unit, estimators) for unit in range(options.units)]
        done = list(studies.in_processes(options.jobs, trial_of, tasks))
        for name in done[0]:
            scores = [rows[name] for rows in done]
            beyond += study.beyond(scores, tests)
            figures = [COLUMNS[column](scores, tests) for column in study.columns]
            print(f"| {' | '.join(map(str, (*cell, name, *figures)))} |", flush=True)
    return int(beyond > 0)


if __name__ == "__main__":
    sys.exit(main())
