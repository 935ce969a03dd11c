"""19-position test (Xie Bo 2011) without labels: rms errors over the Cramér-Rao bound, beside PSINS' Kalman filter.

Recordings by ``benchmarks/foreign_motion.py``: 18 rotations of 90 degrees in 9 s with soft ends, rests of 20 s (60 s at
first), 100 Hz, 0.001 °/√h and 10 µg/√Hz, heading unknown; without and with quadratic terms, lever arms and lag of the
accelerometers. The bound is computed from the motion alone (``benchmarks/motion_bound.py``).
PSINS' figures are one draw of its own demonstration with the same noise, under Octave.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path  # noqa: TC003 - the type of an option
from time import process_time

import harness
import numpy as np
import studies
from foreign_motion import (
    DEG,
    GRAVITY_M_S2,
    NINETEEN_START_DEG,
    PSINS_EXTRAS,
    Grade,
    drawn_errors,
    nineteen_positions,
    recording,
)
from motion_bound import Chain, Conditions, Leg, motion_bound
from scipy.spatial.transform import Rotation
from studies import rms

import srt
from srt.sensor_errors import GROUP_SLICES, NAMES

SEED = 20261122
GRADE = Grade(0.001 * DEG / 60.0, 10e-6 * 9.80665, 3e-5, 1.5e-4, 0.2 * DEG / 3600.0, 2e-3)
LATITUDE_RAD = 34.0 * DEG
GRAVITY_SIGMA_M_S2 = 5e-6
SHOWN = {  # group, unit, SI to unit, PSINS
    "gyro_scale": ("ppm", 1e6, 1.1),
    "gyro_orthogonality": ("µrad", 1e6, 3.4),
    "accel_scale": ("ppm", 1e6, 0.28),
    "accel_misalignment": ("µrad", 1e6, 2.9),
    "accel_bias": ("µg", 1e6 / 9.80665, 1.6),
}
CASES = {  # extras, parameters fixed
    "no extras": (None, ("gyro_asymmetry", "accel_asymmetry")),
    # At 1 g, |f| takes up what a quadratic term adds.
    "quadratic terms, lever arms, lag": (PSINS_EXTRAS, ("gyro_asymmetry",)),
}


def bound(fixed: tuple[str, ...]) -> np.ndarray:
    """Cramér-Rao bound of the 27 errors, 1-sigma, zero for those that are fixed."""
    turns, first_rest_s = nineteen_positions()
    chain = Chain(
        Rotation.from_euler("ZYX", NINETEEN_START_DEG, degrees=True),
        [first_rest_s, *(turn.rest_s for turn in turns)],
        [[Leg(np.array(turn.axis), turn.angle_rad, turn.duration_s)] for turn in turns],
    )
    conditions = Conditions(
        GRADE.gyro_rad_per_sqrt_s, GRADE.accel_m_s2_sqrt_s, GRAVITY_M_S2, GRAVITY_SIGMA_M_S2, LATITUDE_RAD
    )
    return motion_bound([chain], conditions, [n for n in NAMES if not n.startswith(fixed)])


def study(
    case: str, estimators: list[str], units: int, *, noise: bool = True
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Errors (units, 27) and seconds of processor time (units,) by estimator."""
    extras, fixed = CASES[case]
    turns, first_rest_s = nineteen_positions()
    found: dict[str, list[tuple[np.ndarray, float]]] = {estimator: [] for estimator in estimators}
    for unit in range(units):
        rng = np.random.default_rng((SEED, unit))
        true = drawn_errors(GRADE, rng, asymmetry=False)
        unlabelled = recording(
            turns, first_rest_s, true, GRADE if noise else None, rng, start_deg=NINETEEN_START_DEG, extras=extras
        )
        truth = np.array([true.get(name, 0.0) for name in NAMES])
        for estimator, rows in found.items():
            fresh = replace(unlabelled)  # without what an earlier estimator derived
            started = process_time()
            result = srt.calibrate(fresh, estimator, hold=fixed, checks=False)
            rows.append((result.errors.vector - truth, process_time() - started))
    return {name: (np.array([e for e, _ in rows]), np.array([t for _, t in rows])) for name, rows in found.items()}


def main(
    *,
    units: int = 100,
    estimators: tuple[str, ...] = ("least-squares", "graph", "ekf"),
    markdown: Path | None = None,
) -> None:
    head, tables = ("estimator", *(f"{group}, {unit}" for group, (unit, _, _) in SHOWN.items()), "s"), {}
    for case, (_, fixed) in CASES.items():
        limit, rows = bound(fixed), []
        limits = {group: rms(limit[GROUP_SLICES[group]]) for group in SHOWN}
        for estimator, (errors, seconds) in study(case, estimators, units).items():
            sizes = {group: rms(errors[:, GROUP_SLICES[group]]) for group in SHOWN}
            cells = [f"{SHOWN[g][1] * size:.2f} ({size / limits[g]:.2f})" for g, size in sizes.items()]
            rows.append([estimator, *cells, f"{np.median(seconds):.2f}"])
        rows.append(["Cramér-Rao bound", *(f"{SHOWN[g][1] * size:.2f}" for g, size in limits.items()), ""])
        rows.append(["PSINS (one draw)", *(str(psins) for _, _, psins in SHOWN.values()), "102"])
        tables[case] = "\n".join(studies.markdown(head, rows))
        print(f"{case}\n\n{tables[case]}\n", flush=True)
    if markdown is not None:
        studies.replace_tables(markdown, tables)


if __name__ == "__main__":
    harness.run(main, __doc__)
