"""Errors over sigmas of hand-turned units without labels, by a generator that shares nothing with the estimators.

Turns of 0.5-30 s with four profiles, units of four grades (``benchmarks/foreign_motion.py``). A cell is the rms of the
normalised errors of one parameter group over all units of a grade and profile; 1 is expected.

No noise is stated, so that the sigmas include the bias instability that rests of a few seconds cannot exclude, although
these units have none; with ``--stated`` the noise is stated as it is. ``--drift`` adds drifts of the biases, from
0.1 mg and 10 °/h to 10 mg and 1000 °/h over six minutes, and prints the mean NEES per parameter, its band, how often
each triad's drift is named, and the largest accelerometer-scale sigma. ``--array`` does so for twelve turns in 500 s
with drifts of 8 mg and 570 °/h, as recordings of a sensor array had them.

``--asymmetry`` compares rules for units of few turns: asymmetries always estimated, as the estimators do, or only where
a test asks for them. It prints errors over sigma of the parameters that asymmetries resemble, and their rms errors.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
from foreign_motion import DRIFT_FORMS, GRADES, PROFILES, drawn_errors, drifting, hand_turns, recording
from joblib import Parallel, delayed
from scipy.stats import chi2

import srt
from srt.sensor_errors import GROUP_SLICES, NAMES

SEED = 20261122
SHORTEST_S, LONGEST_S = 0.5, 30.0


def normalised_errors(
    seed: int, grade: str, profile: str, estimator: str, stated: bool = False
) -> tuple[str, np.ndarray]:
    """Status and normalised errors of one unit, NaN where a parameter is not observed."""
    rng = np.random.default_rng((SEED, seed))
    errors = drawn_errors(GRADES[grade], rng)
    turns = hand_turns(rng, shortest_s=SHORTEST_S, longest_s=LONGEST_S)
    unit = recording(turns, 5.0, errors, GRADES[grade], rng, profile=profile)
    if stated:
        white = GRADES[grade]
        unit = replace(unit, noise=srt.ImuNoise(white.gyro_rad_per_sqrt_s, white.accel_m_s2_sqrt_s, 0.0, 0.0, 0.0, 0.0))
    z = np.full(len(NAMES), np.nan)
    try:
        found = srt.calibrate(unit, estimator, checks=False)
    except srt.SrtError as error:
        return f"refused: {error}", z
    if found.status in ("converged", "partial"):
        truth = np.array([errors.get(name, 0.0) for name in NAMES])
        seen = found.observed
        z[seen] = (found.errors.vector - truth)[seen] / found.sigma[seen]
    return found.status, z


DRIFTS = {
    "none": (0.0, 0.0),
    "small": (0.1, 10.0),
    "middle": (4.0, 300.0),
    "large": (10.0, 1000.0),
    "array": (8.0, 570.0),
}
"""Change of the biases over the recording, mg and °/h."""
TURNS = {"array": (12, 33.0)}
"""Turns, and rest after each, s, if other than 36 and 5 s: repeated recordings of a sensor array last 500 s."""


def drifting_unit(seed: int, grade: str, form: str, size: str, estimator: str) -> tuple:
    """Status, NEES, number of parameters, sensors whose drift is named, and largest sigma of accelerometer scale."""
    rng = np.random.default_rng((SEED, 7, seed))
    errors = drawn_errors(GRADES[grade], rng)
    count, rest_s = TURNS.get(size, (36, 5.0))
    turns = hand_turns(rng, shortest_s=SHORTEST_S, longest_s=12.0, count=count, rest_s=rest_s)
    unit = recording(turns, rest_s, errors, GRADES[grade], rng, profile=PROFILES[seed % len(PROFILES)])
    accel_mg, gyro_deg_h = DRIFTS[size]
    unit = drifting(unit, turns, rest_s, rng, form=form, accel_mg=accel_mg, gyro_deg_h=gyro_deg_h)
    found = srt.calibrate(unit, estimator, checks=False)
    seen = np.flatnonzero(found.observed)
    error = (found.errors.vector - np.array([errors.get(name, 0.0) for name in NAMES]))[seen]
    sigma = found.sigma[seen]
    correlation = found.covariance[np.ix_(seen, seen)] / np.outer(sigma, sigma)
    nees = float(error / sigma @ np.linalg.solve(correlation, error / sigma))
    named = {term.sensor for term in found.diagnostics.drift or ()}
    return found.status, nees, len(seen), named, float(found.sigma[GROUP_SLICES["accel_scale"]].max())


def drift_table(units: int, estimators: list[str], jobs: int, *, array: bool) -> int:
    """Print the table of ``--drift`` or ``--array``; 1 if a mean NEES lies above its band."""
    sizes = [("linear", "none"), *((form, size) for form in DRIFT_FORMS for size in ("small", "middle", "large"))]
    sizes = [(form, "array") for form in DRIFT_FORMS] if array else sizes
    cells = [(e, g, f, s) for e in estimators for g in ("industrial", "consumer") for f, s in sizes]
    tasks = [(u, g, f, s, e) for e, g, f, s in cells for u in range(units)]
    results = Parallel(n_jobs=jobs)(delayed(drifting_unit)(*task) for task in tasks)
    print(f"{units} units a cell, seed {SEED}\n")
    print("| estimator | grade | drift | mg, °/h | status | NEES / n | band | accel. named | gyro named | scale, ppm |")
    print("|---|---|---|---|---|---:|---|---:|---:|---:|")
    beyond = 0
    for i, (estimator, grade, form, size) in enumerate(cells):
        whole = results[i * units : (i + 1) * units]
        part = [r for r in whole if r[0] in ("converged", "partial")]
        freedom = sum(r[2] for r in part)
        mean = sum(r[1] for r in part) / max(freedom, 1)
        high = chi2.isf(0.01 / len(cells), freedom) / freedom if freedom else np.nan
        beyond += not mean <= high
        status = ", ".join(f"{count} {name}" for name, count in Counter(r[0] for r in whole).most_common())
        named = [sum(sensor in r[3] for r in part) for sensor in ("accel", "gyro")]
        print(
            f"| {estimator} | {grade} | {form} | {DRIFTS[size][0]:g}, {DRIFTS[size][1]:g} | {status} | {mean:.2f} |"
            f" ≤ {high:.2f} | {named[0]} | {named[1]} | {max((r[4] for r in part), default=np.nan) * 1e6:.0f} |"
        )
    return int(beyond > 0)


ASYMMETRIES = {"none": 0.0, "a tenth of the scale error": 0.1, "three tenths": 0.3, "as large": 1.0}
"""Asymmetries, 1-sigma, in units of the scale errors."""
RULES = {"estimated": 1.0, "where p < 0.05": 0.05, "where p < 0.001": 1e-3, "never": 0.0}
"""Probability of the test below which a group of asymmetries is estimated."""


def asymmetric_unit(seed: int, grade: str, share: float, turns: int, estimator: str) -> np.ndarray:
    """Errors and sigmas under each rule, shape (rules, groups, 2, 3), of gyro scale, accelerometer bias and scale.

    Groups that are not observed are NaN.
    """
    rng = np.random.default_rng((SEED, 11, seed))
    errors = drawn_errors(GRADES[grade], rng)
    errors |= {name: 10.0 * share * value for name, value in errors.items() if "asymmetry" in name}
    unit = recording(hand_turns(rng, shortest_s=1.0, count=turns), 5.0, errors, GRADES[grade], rng)
    found = srt.calibrate(unit, estimator, checks=False)
    out, tests = np.full((len(RULES), 3, 2, 3), np.nan), found.diagnostics.asymmetry or {}
    if found.status not in ("converged", "partial"):
        return out
    for r, limit in enumerate(RULES.values()):
        for g, group in enumerate(("gyro_scale", "accel_bias", "accel_scale")):
            test = tests.get("gyro_asymmetry" if group == "gyro_scale" else "accel_asymmetry")
            for i, name in enumerate(NAMES[GROUP_SLICES[group]]):
                k = NAMES.index(name)
                if test is None or not found.observed[k]:
                    continue
                other = test.without[name]
                chosen = test.probability <= limit and limit > 0.0
                value, sigma = (found.errors[name], found.sigma[k]) if chosen else (other.value, other.sigma)
                out[r, g, :, i] = value - errors[name], sigma
    return out


def asymmetry_table(units: int, estimators: list[str], turns: int, jobs: int) -> None:
    """Print the table of ``--asymmetry``."""
    cells = [(e, g, a) for e in estimators for g in ("tactical", "consumer") for a in ASYMMETRIES]
    tasks = [(u, g, ASYMMETRIES[a], turns, e) for e, g, a in cells for u in range(units)]
    results = np.array(Parallel(n_jobs=jobs)(delayed(asymmetric_unit)(*task) for task in tasks))
    print(f"{units} units a cell of {turns} turns, seed {SEED}\n")
    print(
        "| estimator | grade | asymmetry | estimated | gyro scale | ppm | acc. bias | µg | acc. scale | ppm | largest |"
    )
    print("|---|---|---|---|---:|---:|---:|---:|---:|---:|---:|")
    for i, (estimator, grade, asymmetry) in enumerate(cells):
        for r, rule in enumerate(RULES):
            error, sigma = np.moveaxis(results[i * units : (i + 1) * units, r], 2, 0)
            z = np.sqrt(np.nanmean((error / sigma) ** 2, axis=(0, 2)))
            size = np.sqrt(np.nanmean(error**2, axis=(0, 2))) * [1e6, 1e6 / 9.80665, 1e6]
            columns = " | ".join(f"{a:.2f} | {b:.3g}" for a, b in zip(z, size, strict=True))
            largest = np.nanmax(np.abs(error / sigma))
            print(f"| {estimator} | {grade} | {asymmetry} | {rule} | {columns} | {largest:.1f} |")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=20, help="of each grade and profile")
    parser.add_argument("--estimators", nargs="+", default=["least-squares"])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--drift", action="store_true", help="drifting biases instead of profiles and grades")
    parser.add_argument("--array", action="store_true", help="twelve turns in 500 s with drifts of 8 mg and 570 °/h")
    parser.add_argument(
        "--stated", action="store_true", help="white noise and no bias instability are stated, as is true"
    )
    parser.add_argument("--asymmetry", action="store_true", help="rules for asymmetries of units of few turns")
    parser.add_argument("--turns", type=int, default=9, help="turns of a unit, with --asymmetry")
    options = parser.parse_args()
    if options.asymmetry:
        asymmetry_table(options.units, options.estimators, options.turns, options.jobs)
        return 0
    if options.drift or options.array:
        return drift_table(options.units, options.estimators, options.jobs, array=options.array)
    cells = [(e, g, p) for e in options.estimators for g in GRADES for p in PROFILES]
    tasks = [
        (1000 * list(GRADES).index(g) + u, g, p, e, options.stated) for e, g, p in cells for u in range(options.units)
    ]
    results = Parallel(n_jobs=options.jobs)(delayed(normalised_errors)(*task) for task in tasks)
    bound = np.sqrt(chi2.isf(0.01 / (2 * len(NAMES) * len(cells)), options.units) / options.units)
    print(f"{options.units} units a cell, seed {SEED}; rms of one parameter may reach {bound:.2f} (family-wise 1 %)\n")
    print("| estimator | grade | profile | status | " + " | ".join(GROUP_SLICES) + " | worst rms | largest |")
    print("|---|---|---|---|" + "---:|" * (len(GROUP_SLICES) + 2))
    beyond = 0
    for i, (estimator, grade, profile) in enumerate(cells):
        part = results[i * options.units : (i + 1) * options.units]
        z = np.array([row for _, row in part])
        worst = float(np.sqrt(np.nanmax(np.nanmean(z**2, axis=0))))
        beyond += worst > bound
        groups = [f"{np.sqrt(np.nanmean(z[:, s] ** 2)):.2f}" for s in GROUP_SLICES.values()]
        status = ", ".join(f"{count} {name}" for name, count in Counter(name for name, _ in part).most_common())
        print(
            f"| {estimator} | {grade} | {profile} | {status} | {' | '.join(groups)} | {worst:.2f} |"
            f" {np.nanmax(np.abs(z)):.1f} |"
        )
    return int(beyond > 0)


if __name__ == "__main__":
    sys.exit(main())
