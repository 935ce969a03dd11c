"""NEES per observed parameter where no noise is stated, by a generator that shares nothing with the estimators.

Units of four grades on a fixture (``benchmarks/foreign_fixture.py``) or turned by hand
(``benchmarks/foreign_motion.py``): nothing stated, of a unit without bias instability and of one with the instability
of its grade; and all stated. A cell is the mean NEES per observed parameter, 1 if all sigmas are true, with the
verdicts; asked for is 0.70 to 1.15 (closed form, fixture only: from 0.60).

The instability is flicker noise by Fourier transform, from the Nyquist frequency down to a period of 6000 s.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import replace

import numpy as np
from foreign_fixture import LATITUDE_DEG, on_fixture, table_1
from foreign_motion import DEG, GRADES, GRAVITY_M_S2, drawn_errors, hand_turns, recording
from joblib import Parallel, delayed

import srt
from srt.sensor_errors import NAMES

SEED = 20261127
HZ = 50.0
INSTABILITY = {
    "navigation": (0.003 * DEG / 3600.0, 5e-6 * 9.81),
    "tactical": (0.5 * DEG / 3600.0, 20e-6 * 9.81),
    "industrial": (5.0 * DEG / 3600.0, 50e-6 * 9.81),
    "consumer": (15.0 * DEG / 3600.0, 150e-6 * 9.81),
}
"""Allan floor of gyros and accelerometers, rad/s and m/s²."""
STATEMENTS = ("nothing, none", "nothing, instability", "all, instability")
"""Statement of the noise, and bias instability of the unit."""
LONGEST_S = 6000.0


def flicker(floor: float, count: int, rng) -> np.ndarray:
    """Flicker noise with an Allan floor, shape (count, 3): two-sided spectrum floor² / (4 ln 2 |f|)."""
    n = max(count, int(LONGEST_S * HZ))
    f = np.fft.rfftfreq(n, 1.0 / HZ)[1:]
    size = floor * np.sqrt(n * HZ / (8.0 * math.log(2.0) * f))
    part = size * (rng.standard_normal((3, len(f))) + 1j * rng.standard_normal((3, len(f))))
    return np.fft.irfft(np.concatenate([np.zeros((3, 1)), part], axis=1), n)[:, :count].T


def on_the_fixture(seed: int, grade: str) -> tuple[srt.Recording, dict[str, float]]:
    """One unit on a fixture of 1 mrad, and its errors."""
    rng = np.random.default_rng((SEED, 1, seed))
    errors = drawn_errors(GRADES[grade], rng)
    motion = on_fixture(table_1(), rng, rest_s=10.0, rate_rad_s=60.0 * DEG, sigma_rad=1e-3)
    samples = motion.sampled(errors, GRADES[grade], rng, hz=HZ)
    labels = tuple(
        srt.SequenceLabel(tuple(row["start_static_s"]), tuple(row["end_static_s"]), id=row["id"])
        for row in motion.labels(0.1)
    )
    site = srt.Site(GRAVITY_M_S2, latitude_rad=LATITUDE_DEG * DEG)
    fixture = srt.Fixture(0.0, 1e-3, 1e-3)
    made = srt.Recording(samples["time"], samples["gyro"], samples["accel"], site, fixture=fixture, sequences=labels)
    return made, errors


def by_hand(seed: int, grade: str) -> tuple[srt.Recording, dict[str, float]]:
    """One unit turned by hand, and its errors."""
    rng = np.random.default_rng((SEED, 2, seed))
    errors = drawn_errors(GRADES[grade], rng)
    return recording(hand_turns(rng, shortest_s=1.0), 5.0, errors, GRADES[grade], rng), errors


def outcome(seed: int, kind: str, grade: str, statement: str, estimator: str) -> tuple[float, int, str]:
    """NEES, number of observed parameters, and verdict of one unit."""
    unit, errors = (on_the_fixture if kind == "fixture" else by_hand)(seed, grade)
    rng = np.random.default_rng((SEED, 3, seed))
    floors = INSTABILITY[grade]
    if statement != STATEMENTS[0]:
        gyro, accel = (flicker(floor, len(unit.gyro), rng) for floor in floors)
        unit = replace(unit, gyro=unit.gyro + gyro, accel=unit.accel + accel)
    if statement == STATEMENTS[2]:
        white = GRADES[grade]
        noise = srt.ImuNoise(white.gyro_rad_per_sqrt_s, white.accel_m_s2_sqrt_s, 0.0, 0.0, *floors)
        unit = replace(unit, noise=noise)
    found = srt.calibrate(unit, estimator, checks=False)
    seen = found.observed
    if found.status not in ("converged", "partial") or not seen.any():
        return math.nan, 0, found.status
    truth = np.array([errors.get(name, 0.0) for name in NAMES])
    z = (found.errors.vector - truth)[seen] / found.sigma[seen]
    P = found.covariance[np.ix_(seen, seen)] / np.outer(found.sigma[seen], found.sigma[seen])
    return float(z @ np.linalg.solve(P, z)), int(seen.sum()), found.judgement.word


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=60, help="of each cell")
    parser.add_argument("--estimators", nargs="+", default=["closed-form", "least-squares", "ekf", "graph"])
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    cells = [
        (kind, grade, statement, estimator)
        for kind in ("fixture", "hand")
        for grade in GRADES
        for statement in STATEMENTS
        for estimator in options.estimators
        if kind == "fixture" or estimator != "closed-form"
    ]
    print(f"{options.units} units a cell, seed {SEED}\n")
    print("| motion | grade | stated, unit | estimator | NEES / n | verdicts |\n|---|---|---|---|---:|---|", flush=True)
    for cell in cells:
        found = Parallel(n_jobs=options.jobs)(delayed(outcome)(seed, *cell) for seed in range(options.units))
        words = ", ".join(f"{count} {word}" for word, count in Counter(row[2] for row in found).most_common())
        mean = np.nansum([row[0] for row in found]) / max(sum(row[1] for row in found), 1)
        print(f"| {' | '.join(cell)} | {mean:.2f} | {words} |", flush=True)


if __name__ == "__main__":
    main()
