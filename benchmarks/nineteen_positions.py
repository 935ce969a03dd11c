"""19-position test (Xie Bo 2011) without labels: rms errors over the Cramér-Rao bound, beside PSINS' Kalman filter.

Recordings by ``benchmarks/foreign_motion.py``: 18 rotations of 90 degrees in 9 s with soft ends, rests of 20 s (60 s at
first), 100 Hz, 0.001 °/√h and 10 µg/√Hz, heading unknown; without and with quadratic terms, lever arms and lag of the
accelerometers. The bound is computed here from the motion alone: its unknowns are the estimated errors, gravity, the
heading and the attitude of every rest; its measurements the mean readings of the rests and the integrated rotations.
PSINS' figures are one draw of its own demonstration with the same noise, under Octave.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from foreign_motion import (
    DEG,
    EARTH_RATE_RAD_S,
    GRAVITY_M_S2,
    NINETEEN_START_DEG,
    PSINS_EXTRAS,
    Grade,
    drawn_errors,
    nineteen_positions,
    recording,
)
from scipy.spatial.transform import Rotation

import srt
from srt.sensor_errors import GROUP_SLICES, INDEX, NAMES

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
    """Cramér-Rao bound of the 27 errors, 1-sigma, zero for those that are fixed; about a unit without errors."""
    turns, first_rest_s = nineteen_positions()
    free = [n for n in NAMES if not n.startswith(fixed)]
    durations = [first_rest_s, *(turn.rest_s for turn in turns)]
    attitude = Rotation.from_euler("ZYX", NINETEEN_START_DEG, degrees=True)
    earth = EARTH_RATE_RAD_S * np.array([np.cos(LATITUDE_RAD), 0.0, -np.sin(LATITUDE_RAD)])
    n_errors, W = len(free), len(durations)
    n = n_errors + 2 + 3 * W  # errors, gravity, heading, attitudes as small rotations in the body
    information = np.zeros((n, n))
    information[n_errors, n_errors] = 1.0 / GRAVITY_SIGMA_M_S2**2

    def add(rows: np.ndarray, sigma: float) -> None:
        nonlocal information
        information += rows.T @ rows / sigma**2

    for w, T in enumerate(durations):
        at = slice(n_errors + 2 + 3 * w, n_errors + 5 + 3 * w)
        down, rate = attitude.inv().apply([0.0, 0.0, 1.0]), attitude.inv().apply(earth)
        force = -GRAVITY_M_S2 * down
        rows = np.zeros((3, n))
        rows[:, :n_errors] = by_errors(free, "accel", force)
        rows[:, n_errors], rows[:, at] = -down, cross(force)
        add(rows, GRADE.accel_m_s2_sqrt_s / np.sqrt(T))
        rows = np.zeros((3, n))
        rows[:, :n_errors] = by_errors(free, "gyro", rate)
        rows[:, n_errors + 1] = attitude.inv().apply(np.cross([0.0, 0.0, 1.0], earth))
        rows[:, at] = cross(rate)
        add(rows, GRADE.gyro_rad_per_sqrt_s / np.sqrt(T))
        if w == len(turns):
            break
        turn = turns[w]
        axis = np.array(turn.axis)
        s = (np.arange(400) + 0.5) / 400
        angle = 0.5 * (1.0 - np.cos(np.pi * s)) * turn.angle_rad
        speed = 0.5 * np.pi * np.sin(np.pi * s) * turn.angle_rad / turn.duration_s
        turned = Rotation.from_rotvec(angle[:, None] * axis)
        C = turned.as_matrix()
        step = turn.duration_s / len(s)
        after = Rotation.from_rotvec(turn.angle_rad * axis)
        rows = np.zeros((3, n))
        for R, v in zip(C, speed, strict=True):
            rate = v * axis + (attitude * Rotation.from_matrix(R)).inv().apply(earth)
            rows[:, :n_errors] += R @ by_errors(free, "gyro", rate) * step
        # Rotation between the rests in start axes: φ = δA_End (carried to the start) − δA_Strt + turned Earth heading.
        rows[:, at] -= np.eye(3)
        rows[:, at.stop : at.stop + 3] = after.as_matrix()
        rows[:, n_errors + 1] += attitude.inv().apply(np.cross([0.0, 0.0, 1.0], earth)) * turn.duration_s
        add(rows, GRADE.gyro_rad_per_sqrt_s * np.sqrt(turn.duration_s))
        attitude = attitude * after
    scale = 1.0 / np.sqrt(np.diag(information))
    # One combination is free: the heading of all attitudes, with that of the Earth rate. It shows no error.
    covariance = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    out = np.zeros(len(NAMES))
    out[[INDEX[name] for name in free]] = (np.sqrt(np.diag(covariance)) * scale)[:n_errors]
    return out


def cross(v: np.ndarray) -> np.ndarray:
    """Derivative of components in the body, Aᵀ v, with respect to a small rotation behind A: v ×."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def by_errors(free: list[str], sensor: str, v: np.ndarray) -> np.ndarray:
    """Derivative of a reading of v with respect to the free errors, shape (3, n)."""
    out = np.zeros((3, len(free)))
    for j, name in enumerate(free):
        group, _, axes = name.rpartition("_")
        if not group.startswith(sensor):
            continue
        i = "xyz".index(axes[0])
        kind = group.removeprefix(sensor + "_")
        if kind == "bias":
            out[i, j] = 1.0
        elif kind == "scale":
            out[i, j] = v[i]
        elif kind == "asymmetry":
            out[i, j] = abs(v[i])
        else:
            k = "xyz".index(axes[1])
            out[i, j] = v[k] if kind == "misalignment" else 0.5 * v[k]
            if kind == "orthogonality":
                out[k, j] = 0.5 * v[i]
    return out


def study(
    case: str, estimators: list[str], units: int, *, noise: bool = True
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Errors (units, 27) and seconds (units,) by estimator."""
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
            started = perf_counter()
            result = srt.calibrate(fresh, estimator, hold=fixed, checks=False)
            rows.append((result.errors.vector - truth, perf_counter() - started))
    return {name: (np.array([e for e, _ in rows]), np.array([t for _, t in rows])) for name, rows in found.items()}


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=100)
    parser.add_argument("--estimators", nargs="+", default=["least-squares", "graph", "ekf"])
    parser.add_argument("--markdown", type=Path, help="Page to write.")
    options = parser.parse_args()
    lines = []
    for case, (_, fixed) in CASES.items():
        limit = bound(fixed)
        lines += [
            "",
            f"## {case[0].upper()}{case[1:]}",
            "",
            "| estimator | " + " | ".join(f"{group}, {unit}" for group, (unit, _, _) in SHOWN.items()) + " | s |",
            "|---|" + "---:|" * (len(SHOWN) + 1),
        ]
        for estimator, (errors, seconds) in study(case, options.estimators, options.units).items():
            cells = []
            for group, (_, factor, _) in SHOWN.items():
                at = GROUP_SLICES[group]
                cells.append(f"{factor * rms(errors[:, at]):.2f} ({rms(errors[:, at]) / rms(limit[at]):.2f})")
            lines.append(f"| {estimator} | {' | '.join(cells)} | {np.median(seconds):.2f} |")
            print(lines[-1], flush=True)
        bounds = " | ".join(f"{factor * rms(limit[GROUP_SLICES[g]]):.2f}" for g, (_, factor, _) in SHOWN.items())
        lines += [
            f"| Cramér-Rao bound | {bounds} | |",
            "| PSINS (one draw) | " + " | ".join(f"{psins}" for _, _, psins in SHOWN.values()) + " | 102 |",
        ]
    text = PAGE.format(units=options.units, seed=SEED, tables="\n".join(lines))
    print(text)
    if options.markdown is not None:
        options.markdown.write_text(text, encoding="utf-8")
    return 0


PAGE = """\
# The 19-position test without labels

`python benchmarks/nineteen_positions.py` ({units} units, seed {seed}): 18 rotations of 90° in 9 s with soft
ends, rests of 20 s, 0.001 °/√h and 10 µg/√Hz, heading unknown, no labels. The recordings come from
`benchmarks/foreign_motion.py`, which shares nothing with the estimators, and the bound is computed from the motion
alone. Root mean square error, in parentheses over the Cramér-Rao bound; seconds per calibration.
{tables}

Extras are those of the demonstration of PSINS: quadratic terms of 10, 20 and 30 µg/g², lever arms of 1-6 cm and a lag
of 5 ms of the accelerometers. Lever arms and lag act during the turns, in which the accelerometers are not used.
Quadratic terms are taken up by the accelerometer asymmetries, which are estimated there. The figures of PSINS are one
draw of its own demonstration with the same noise and extras, under Octave. Gravity is taken as known to 5e-6 m/s²,
which is 0.5 ppm of every accelerometer scale, and is exact here; the bound includes its sigma.
"""


if __name__ == "__main__":
    sys.exit(main())
