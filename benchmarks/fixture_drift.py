"""Drift of the biases during a test on a fixture: NEES, and how often it is named, by form and size of the drift.

``python benchmarks/fixture_drift.py --units 10``: units of three grades on the 1 mrad fixture, 17 sequences, bias
instability as specified. Each triad has a drift in a random direction of its channels: linear, a warm-up with a time
constant of 0.1 to 0.5 of the recording, a random walk, or one with a recorded temperature. The courses are those of
``foreign_motion.py``, which shares nothing with the simulator or the estimators. Sizes are 0.1, 1 and 10 times the
stated ones; zero is on average over the stationary windows, where the reported biases are defined.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
from foreign_motion import DRIFT_FORMS, drift_course
from joblib import Parallel, delayed
from scipy.stats import chi2
from verdicts import ESTIMATORS, outcome

import srt
from sims.faults.injection import Case
from srt.constants import DEG_PER_H, MICRO_G

SEED = 20261124
STATED = {"navigation-rlg": (0.2, 0.3), "tactical-fog": (4.0, 30.0), "industrial-mems": (8.0, 60.0)}
"""Change of the accelerometer biases, mg, and of the gyro biases, °/h, over the recording."""
SIZES = (0.1, 1.0, 10.0)
FORMS = (*DRIFT_FORMS, "temperature")
_USABLE = ("converged", "partial")


def temperature_course(share: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Temperature over a test, °C: a warm-up, and one cycle of the air in the room."""
    cycle = np.sin(2.0 * np.pi * (rng.uniform(1.0, 3.0) * share + rng.uniform()))
    return np.asarray(25.0 - 4.0 * np.exp(-share / rng.uniform(0.1, 0.5)) + 2.0 * cycle)


def drifting(case: Case, form: str, size: float, rng: np.random.Generator) -> srt.Recording:
    """Recording of a case with a drift of both triads."""
    recording = case.recording
    rests = [span for label in recording.sequences for span in (label.start_static_s, label.end_static_s)]
    time = recording.time
    temperature = None
    direction = rng.normal(size=(2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if form == "temperature":
        temperature = temperature_course(time / time[-1], rng)
        at_rest = np.any([(time > a) & (time <= b) for a, b in rests], axis=0)
        course = (temperature - temperature[at_rest].mean()) / np.ptp(temperature)
        courses = [course, course]
    else:
        courses = [drift_course(form, time, rests, rng) for _ in range(2)]
    per_sample = case.simulation.motion.interval if recording.kind == "increment" else 1.0
    accel_mg, gyro_deg_h = STATED[case.grade]
    units = size * per_sample * np.array([accel_mg * 1e3 * MICRO_G, gyro_deg_h * DEG_PER_H])
    accel, gyro = (unit * course[:, None] * axis for unit, course, axis in zip(units, courses, direction, strict=True))
    return replace(
        recording,
        accel=recording.accel + accel,
        gyro=recording.gyro + gyro,
        temperature=temperature,
        data_sha256=None,
    )


def trial(grade: str, form: str, size: float, unit: int) -> list[tuple[str, float, int, frozenset[str]]]:
    """Status, NEES over n, n, and the sensors whose drift is named, by estimator."""
    case = Case(grade, SEED + unit)
    recording = drifting(case, form, size, np.random.default_rng((SEED, unit))) if size else case.recording
    out = []
    for estimator in ESTIMATORS:
        found = srt.calibrate(recording, estimator, checks=False)
        named = frozenset(term.sensor for term in found.diagnostics.drift or ())
        out.append((found.status, outcome(found, case).nees, int(found.observed.sum()), named))
    return out


def main() -> int:
    """Print the table; 1 if a mean NEES of results with a usable status lies above its band."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=10, help="of each cell")
    parser.add_argument("--grades", nargs="+", default=list(STATED), choices=list(STATED))
    parser.add_argument("--forms", nargs="+", default=list(FORMS), choices=FORMS)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    drifts = [("none", 0.0), *((form, size) for form in options.forms for size in SIZES)]
    cells = [(grade, *drift) for grade in options.grades for drift in drifts]
    print(f"{options.units} units a cell, seed {SEED}; used: results with the status converged or partial\n")
    print("| grade | drift | mg, °/h | estimator | status | NEES / n, used | band | accel. named | gyro named |")
    print("|---|---|---|---|---|---:|---|---:|---:|")
    beyond = 0
    for grade, form, size in cells:
        done = Parallel(n_jobs=options.jobs)(delayed(trial)(grade, form, size, u) for u in range(options.units))
        sizes = ", ".join(f"{size * x:g}" for x in STATED[grade])
        for number, estimator in enumerate(ESTIMATORS):
            rows = [row[number] for row in done]
            used = [row for row in rows if row[0] in _USABLE]
            freedom = sum(row[2] for row in used)
            mean = sum(row[1] * row[2] for row in used) / freedom if used else np.nan
            high = chi2.isf(0.01 / (len(cells) * len(ESTIMATORS)), freedom) / freedom if used else np.nan
            beyond += bool(mean > high)
            status = ", ".join(f"{count} {name}" for name, count in Counter(row[0] for row in rows).most_common())
            named = [sum(sensor in row[3] for row in rows) for sensor in ("accel", "gyro")]
            print(
                f"| {grade} | {form} | {sizes} | {estimator} | {status} | {mean:.2f} | ≤ {high:.2f} | {named[0]} |"
                f" {named[1]} |",
                flush=True,
            )
    return int(beyond > 0)


if __name__ == "__main__":
    sys.exit(main())
