"""Accuracy of the shipped protocols in equal time: Cramér-Rao bound, and rms error of simulated units.

Every protocol lasts 600 s, its rests scaled to that, without a fixture: a tactical unit with white noise alone, poses
placed to 1°, turns to 0.5°. The bound is computed from the nominal motion (``benchmarks/motion_bound.py``); the units
are simulated and calibrated by least squares, asymmetries fixed at zero, which they are. ``python
benchmarks/protocols.py --units 20 --markdown docs/protocols.md`` writes the tables of the page.
"""

from __future__ import annotations

import math
from pathlib import Path  # noqa: TC003 - the type of an option

import harness
import numpy as np
import studies
from motion_bound import Chain, Conditions, Leg, motion_bound
from scipy.spatial.transform import Rotation

import sims
import srt
from sims.scenarios.scenario import scenario_from_dict
from srt.constants import DEG, DEG_PER_SQRT_H, MICRO_G
from srt.recording.protocol import Protocol, load_protocol
from srt.sensor_errors import DISPLAY_FACTORS, GROUP_SLICES, NAMES

PROTOCOLS = (
    "table-1", "19-positions", "11-positions", "7-positions", "9-positions", "two-axis-table", "hand-turned",
    "ferraris", "rate-table", "24-face-tumble", "six-face-tumble",
)  # fmt: skip
TOTAL_S = 600.0
GYRO_DEG_PER_SQRT_H, ACCEL_UG_PER_SQRT_HZ = 0.05, 50.0
LATITUDE_DEG, GRAVITY_M_S2, GRAVITY_SIGMA_M_S2 = 45.0, 9.80665, 5e-6
FIRST_SEED = 70_000
FIXED = ("gyro_asymmetry", "accel_asymmetry")
GROUPS = {
    "gyro_scale": "gyro scale, ppm",
    "gyro_orthogonality": "gyro orthogonality, µrad",
    "gyro_bias": "gyro bias, °/h",
    "accel_scale": "accelerometer scale, ppm",
    "accel_misalignment": "accelerometer misalignment, µrad",
    "accel_bias": "accelerometer bias, µg",
}
ASYMMETRIES = {"gyro_asymmetry": "gyro asymmetry, ppm", "accel_asymmetry": "accelerometer asymmetry, ppm"}
PRIOR = {"scale": 0.1, "orthogonality": 0.1, "misalignment": 0.1, "asymmetry": 0.01}
NOT_SHOWN = 1.0 / 3.0
"""A bound above this share of the prior means that the protocol does not show the group."""


def prior() -> np.ndarray:
    out = np.array([PRIOR.get(name.split("_")[1], math.inf) for name in NAMES])
    out[GROUP_SLICES["accel_bias"]], out[GROUP_SLICES["gyro_bias"]] = 1.0, 0.02
    return out


def chains(protocol: Protocol) -> list[Chain]:
    """Rests and legs of a protocol, each placed pose in some heading."""
    out: list[Chain] = []
    for step in protocol.steps:
        legs = []
        for (axis, angle), duration in zip(step.rotations, step.durations_s(), strict=True):
            ramps = 0.0 if step.turn_s is not None else 2.0 * step.rate_rad_s / step.acceleration_rad_s2
            legs.append(Leg(axis, angle, duration, 0.0 if step.stated_rate_rad_s is None else duration - ramps))
        if step.down is not None:
            first = np.cross(step.down, np.eye(3)[int(np.argmin(np.abs(step.down)))])
            first /= np.linalg.norm(first)
            level = np.stack([first, np.cross(step.down, first), step.down])
            out.append(Chain(Rotation.from_matrix(level), [step.rest_s[0] if legs else step.rest_s[1]]))
        if legs:
            out[-1].turns.append(legs)
            out[-1].rests_s.append(step.rest_s[1])
    return out


def bound(name: str, fixed: tuple[str, ...]) -> np.ndarray:
    """Bound of the 27 errors in the units of the tables; NaN where the protocol does not show them."""
    protocol = load_protocol(name).lasting(TOTAL_S)
    free = [n for n in NAMES if not n.startswith(fixed)] if fixed else list(NAMES)
    if all(step.pose for step in protocol.steps):  # the axes are those of the accelerometers
        free = [n for n in free if n not in ("accel_misalignment_xy", "accel_misalignment_xz", "accel_misalignment_yz")]
    conditions = Conditions(
        GYRO_DEG_PER_SQRT_H * DEG_PER_SQRT_H, ACCEL_UG_PER_SQRT_HZ * MICRO_G, GRAVITY_M_S2, GRAVITY_SIGMA_M_S2,
        LATITUDE_DEG * DEG, protocol.rate_sigma or 1.0,
    )  # fmt: skip
    sigma = motion_bound(chains(protocol), conditions, free, prior())
    shown = (sigma > 0.0) & (sigma < NOT_SHOWN * prior())
    return np.where(shown, sigma, math.nan) * DISPLAY_FACTORS


def simulated(name: str, seed: int) -> tuple[np.ndarray, str]:
    """Errors of a calibrated unit in the units of the tables, NaN where not observed, and the status."""
    quiet = dict.fromkeys(("gyro_bias_instability_deg_per_h", "accel_bias_instability_ug"), 0.0)
    noise = {"gyro_noise_deg_per_sqrt_h": GYRO_DEG_PER_SQRT_H, "accel_noise_ug_per_sqrt_hz": ACCEL_UG_PER_SQRT_HZ}
    tables = {
        "seed": seed,
        "imu": {
            "from": "tactical-fog",
            "noise": quiet | noise,
            "errors": {"gyro_asymmetry_ppm": 0.0, "accel_asymmetry_ppm": 0.0},
        },
        "site": {
            "latitude_deg": LATITUDE_DEG, "gravity_m_s2": GRAVITY_M_S2, "gravity_sigma_m_s2": GRAVITY_SIGMA_M_S2,
        },
        "protocol": {"from": name, "total_time_s": TOTAL_S, "settle_s": 0.0},
        "recording": {"sample_rate_hz": 50.0},
    }  # fmt: skip
    simulation = sims.simulate(scenario_from_dict(tables))
    found = srt.calibrate(simulation.recording, "least-squares", checks=False, hold=FIXED)
    off = (found.errors.vector - simulation.truth.vector) * DISPLAY_FACTORS
    usable = found.status in ("converged", "partial")
    return np.where(found.observed & usable, off, math.nan), found.status


def rms(values: np.ndarray) -> float:
    """Root mean square of the shown values; NaN if a third of them or more is not shown."""
    shown = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(shown**2))) if 3 * shown.size > 2 * values.size else math.nan


def shown(value: float) -> str:
    """Text of at least two digits; a dash for NaN."""
    digits = 0 if math.isnan(value) else min(max(0, 1 - math.floor(math.log10(max(value, 1e-9)))), 3)
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def main(*, units: int = 20, markdown: Path | None = None) -> None:
    bounds = {name: bound(name, FIXED) for name in PROTOCOLS}
    errors, notes = {}, []
    for name in PROTOCOLS:
        runs = [simulated(name, seed) for seed in range(FIRST_SEED, FIRST_SEED + units)]
        errors[name] = np.array([off for off, _ in runs])
        bad = sum(status not in ("converged", "partial") for _, status in runs)
        if bad:
            notes.append(f"{name}: {bad} of {units} units not converged or inconsistent, and left out")
        print(name, flush=True)

    def column(group: str, name: str) -> str:
        at = GROUP_SLICES[group]
        return f"{shown(rms(errors[name][:, at]))} ({shown(rms(bounds[name][at]))})"

    more = GROUPS | ASYMMETRIES
    limits = {name: bound(name, ()) for name in PROTOCOLS}
    found = ([name, *(column(group, name) for group in GROUPS)] for name in PROTOCOLS)
    lines = [
        *studies.markdown(("protocol", *GROUPS.values()), found),
        "", "The bound where asymmetries are estimated too:", "",
        *studies.markdown(
            ("protocol", *more.values()),
            ([name, *(shown(rms(limit[GROUP_SLICES[g]])) for g in more)] for name, limit in limits.items()),
        ),
        *(["", "; ".join(notes) + "."] if notes else []),
    ]  # fmt: skip
    text = "\n".join(lines)
    print(text)
    if markdown is not None:
        studies.replace_tables(markdown, {"benchmarks/protocols.py": text})


if __name__ == "__main__":
    harness.run(main, __doc__)
