"""Errors over sigmas of hand-turned units without labels, by a generator that shares nothing with the estimators.

Turns of 0.5-30 s with four profiles, units of four grades (``benchmarks/foreign_motion.py``). A cell is the rms of the
normalised errors of one parameter group over all units of a grade and profile; 1 is expected.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter

import numpy as np
from foreign_motion import GRADES, PROFILES, drawn_errors, hand_turns, recording
from joblib import Parallel, delayed
from scipy.stats import chi2

import srt
from srt.sensor_errors import GROUP_SLICES, NAMES

SEED = 20261122
SHORTEST_S, LONGEST_S = 0.5, 30.0


def normalised_errors(seed: int, grade: str, profile: str, estimator: str) -> tuple[str, np.ndarray]:
    """Status and normalised errors of one unit, NaN where a parameter is not observed."""
    rng = np.random.default_rng((SEED, seed))
    errors = drawn_errors(GRADES[grade], rng)
    turns = hand_turns(rng, shortest_s=SHORTEST_S, longest_s=LONGEST_S)
    unit = recording(turns, 5.0, errors, GRADES[grade], rng, profile=profile)
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=20, help="of each grade and profile")
    parser.add_argument("--estimators", nargs="+", default=["least-squares"])
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    cells = [(e, g, p) for e in options.estimators for g in GRADES for p in PROFILES]
    tasks = [(1000 * list(GRADES).index(g) + u, g, p, e) for e, g, p in cells for u in range(options.units)]
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
