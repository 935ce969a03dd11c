"""19-position test (Xie Bo 2011) without labels: rms errors, sigmas and time, beside figures of PSINS' Kalman filter.

Recordings by ``benchmarks/foreign_motion.py``: 18 rotations of 90 degrees in 9 s with soft ends, rests of 20 s (60 s at
first), 100 Hz, 0.001 °/√h and 10 µg/√Hz, heading unknown. PSINS' figures are one draw of its own demonstration with the
same noise, under Octave.
"""

from __future__ import annotations

import argparse
import sys
from time import perf_counter

import numpy as np
from foreign_motion import DEG, NINETEEN_START_DEG, Grade, drawn_errors, nineteen_positions, recording

import srt
from srt.sensor_errors import GROUP_SLICES, NAMES

SEED = 20261122
GRADE = Grade(0.001 * DEG / 60.0, 10e-6 * 9.80665, 3e-5, 1.5e-4, 0.2 * DEG / 3600.0, 2e-3)
SHOWN = {  # group, unit, SI to unit, PSINS
    "gyro_scale": ("ppm", 1e6, 1.1),
    "gyro_orthogonality": ("µrad", 1e6, 3.4),
    "accel_scale": ("ppm", 1e6, 0.28),
    "accel_misalignment": ("µrad", 1e6, 2.9),
    "accel_bias": ("µg", 1e6 / 9.80665, 1.6),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--estimators", nargs="+", default=["least-squares", "graph", "ekf"])
    options = parser.parse_args()
    turns, first_rest_s = nineteen_positions()
    print(f"{options.units} units, seed {SEED}; rms error (mean sigma)\n")
    print("| estimator | " + " | ".join(f"{group}, {unit}" for group, (unit, _, _) in SHOWN.items()) + " | s |")
    print("|---|" + "---:|" * (len(SHOWN) + 1))
    for estimator in options.estimators:
        errors, sigmas, seconds = [], [], []
        for unit in range(options.units):
            rng = np.random.default_rng((SEED, unit))
            true = drawn_errors(GRADE, rng, asymmetry=False)
            unlabelled = recording(turns, first_rest_s, true, GRADE, rng, start_deg=NINETEEN_START_DEG)
            started = perf_counter()
            found = srt.calibrate(unlabelled, estimator, hold=("gyro_asymmetry", "accel_asymmetry"), checks=False)
            seconds.append(perf_counter() - started)
            errors.append(found.errors.vector - np.array([true.get(name, 0.0) for name in NAMES]))
            sigmas.append(found.sigma)
        cells = [
            f"{factor * np.sqrt(np.mean(np.array(errors)[:, GROUP_SLICES[group]] ** 2)):.2f} "
            f"({factor * np.mean(np.array(sigmas)[:, GROUP_SLICES[group]]):.2f})"
            for group, (_, factor, _) in SHOWN.items()
        ]
        print(f"| {estimator} | {' | '.join(cells)} | {np.median(seconds):.2f} |")
    print("| PSINS (one draw) | " + " | ".join(f"{psins}" for _, _, psins in SHOWN.values()) + " | 102 |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
