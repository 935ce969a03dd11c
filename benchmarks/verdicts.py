"""Verdicts on faulty recordings: a missing sequence, exchanged labels, a ramp, a slip, and unstated noise.

``python benchmarks/verdicts.py --units 10`` prints, for every fault and estimator, the largest error over sigma and the
mean NEES over the number of parameters of all units, and how often each status and verdict was given. Estimators run
without the checks of the recording, so that the table shows what the residuals alone tell; the last column counts the
recordings that the checks of ``srt calibrate`` refuse or warn of.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from joblib import Parallel, delayed

import srt
from sims.faults.execution import labels_exchanged
from sims.faults.injection import GRADES, Case
from sims.physics.disturbances import tilt_step
from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1
from srt.constants import MICRO_G
from srt.diagnosis.staged_diagnosis import diagnose
from srt.recording.recording import ImuNoise

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

SEED = 20261122
ESTIMATORS = ("closed-form", "least-squares", "ekf", "graph")
RAMP_UG_PER_H = 1000.0
SLIP_MRAD = 1.0
LARGEST = 1e4
"""Largest number that the table shows."""


def none(case: Case, _rng: np.random.Generator) -> Recording:
    """Recording without a fault."""
    return case.recording


def unstated(case: Case, _rng: np.random.Generator) -> Recording:
    """Recording without an [imu] table."""
    return replace(case.recording, noise=ImuNoise())


def missing(case: Case, _rng: np.random.Generator) -> Recording:
    """Recording without sequence 6."""
    return case.changed(schedule={"sequences": tuple(name for name in TABLE_1 if name != "6")}).recording


def exchanged(case: Case, rng: np.random.Generator) -> Recording:
    """Recording with the labels of two sequences exchanged."""
    return labels_exchanged(case, 2.0, rng)


def ramp(case: Case, rng: np.random.Generator) -> Recording:
    """Recording with an accelerometer bias that drifts by 1 mg/h on one axis."""
    run, recording = case.simulation, case.recording
    slope = np.zeros(3)
    slope[rng.integers(3)] = RAMP_UG_PER_H * MICRO_G / 3600.0 * rng.choice([-1.0, 1.0])
    time = (recording.time - recording.time.mean())[:, None]
    per_sample = run.motion.interval if recording.kind == "increment" else 1.0
    return replace(recording, accel=recording.accel + slope * time * per_sample, data_sha256=None)


def slip(case: Case, rng: np.random.Generator) -> Recording:
    """Recording with a slip of the unit in its mount between the windows of one sequence."""
    run = case.simulation
    label = run.recording.sequences[rng.integers(len(run.recording.sequences))]
    vector = rng.standard_normal(3)
    middle = 0.5 * (label.start_static_s[1] + label.end_static_s[0])
    motion = tilt_step(run.motion, middle, SLIP_MRAD * 1e-3 * vector / np.linalg.norm(vector))
    again = read_out(motion, run.truth, run.imu, rng, kind=run.recording.kind)
    return replace(run.recording, gyro=again.gyro, accel=again.accel, data_sha256=None)


FAULTS: dict[str, Callable[[Case, np.random.Generator], Recording]] = {
    "none": none,
    "no [imu] table": unstated,
    "sequence 6 missing": missing,
    "labels exchanged": exchanged,
    f"accelerometer ramp, {RAMP_UG_PER_H:g} µg/h": ramp,
    f"slip, {SLIP_MRAD:g} mrad": slip,
}


@dataclass(frozen=True)
class Judged:
    """Outcome of one estimator on one recording."""

    status: str
    word: str
    largest: float
    nees: float


def trial(grade: str, fault: str, seed: int) -> tuple[list[Judged], str]:
    """Outcomes of all estimators on one recording, and the effect of its checks."""
    case = Case(grade, SEED + seed)
    recording = FAULTS[fault](case, np.random.default_rng((SEED, seed)))
    found = diagnose(recording, calibrating=False)
    checks = "refused" if found.refusal else "warned" if found.first else "passed"
    return [judged(recording, case, name) for name in ESTIMATORS], checks


def judged(recording: Recording, case: Case, estimator: str) -> Judged:
    """Outcome of one estimator."""
    try:
        found = srt.calibrate(recording, estimator, checks=False)
    except srt.SrtError:
        return Judged("refused", "refused", np.nan, np.nan)
    return outcome(found, case)


def outcome(found: Calibration, case: Case) -> Judged:
    """Status, verdict and errors of a calibration of a unit with known errors."""
    seen = found.observed
    if not seen.any():
        return Judged(found.status, found.judgement.word, np.nan, np.nan)
    off = (found.errors.vector - case.simulation.truth.vector)[seen] / found.sigma[seen]
    correlation = found.covariance[np.ix_(seen, seen)] / np.outer(found.sigma[seen], found.sigma[seen])
    nees = float(off @ np.linalg.solve(correlation, off)) / len(off)
    return Judged(found.status, found.judgement.word, float(np.abs(off).max()), nees)


def shown(value: float, digits: int) -> str:
    """Number for the table; results that failed may be off by any amount, or have no valid covariance."""
    if not np.isfinite(value) or value < 0.0:
        return "-"
    return f"{value:.{digits}f}" if value < LARGEST else f"> {LARGEST:.0f}"


def counts(words: list[str]) -> str:
    """Words with their number, the most frequent first."""
    return ", ".join(f"{number} {word.replace('_', ' ')}" for word, number in Counter(words).most_common())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=10, help="of each grade and fault")
    parser.add_argument("--grades", nargs="+", default=list(GRADES), choices=GRADES)
    parser.add_argument("--faults", nargs="+", default=list(FAULTS), choices=list(FAULTS))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    print(f"{options.units} units of each grade and fault, seed {SEED}; used: result with a usable status\n")
    print(
        "| grade | fault | estimator | largest error/sigma: all, used | NEES/n: all, used | status | verdict | checks |"
    )
    print("|---|---|---|---:|---:|---|---|---|")
    for grade in options.grades:
        for fault in options.faults:
            done = Parallel(n_jobs=options.jobs)(delayed(trial)(grade, fault, u) for u in range(options.units))
            for number, name in enumerate(ESTIMATORS):
                rows = [row[number] for row, _ in done]
                used = [row for row in rows if row.word in ("sound", "doubtful")]
                parts = [[r for r in part if np.isfinite(r.largest)] for part in (rows, used)]
                sizes = [shown(max((r.largest for r in part), default=np.nan), 1) for part in parts]
                nees = [shown(float(np.mean([r.nees for r in part])) if part else np.nan, 2) for part in parts]
                print(
                    f"| {grade} | {fault} | {name} | {', '.join(sizes)} | {', '.join(nees)} | "
                    f"{counts([r.status for r in rows])} | {counts([r.word for r in rows])} | "
                    f"{counts([checks for _, checks in done])} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
