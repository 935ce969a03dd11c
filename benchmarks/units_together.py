"""The closed form of many units as arrays: closed forms a second and core, by the size of the batch.

Units with errors of ±50 % and 0.3 rad go through one motion of 17 sequences (windows of 2 s, 3 rad/s, 50 Hz).
Simulation, preparation and initial estimates are not timed. The columns are closed forms a second of CPU time, the
ratio to single runs in the same process, and the largest difference of an estimate from that of a single run, in
sigmas.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import srt
from sims.physics.imu import ImuModel, read_out
from sims.physics.table_motion import table1_motion
from srt.closed_form.formulas import SelectedFormulas
from srt.closed_form.iteration import iterate_units
from srt.constants import DEG_PER_SQRT_H, MICRO_G
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.options import Options
from srt.model.platform_steps import many_recordings
from srt.model.sensor_model import outside_model
from srt.recording.recording import Fixture, Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.prepared_units import together

LARGEST = {
    "gyro_scale": 0.5, "gyro_asymmetry": 0.01, "gyro_orthogonality": 0.3, "accel_bias": 1.0, "accel_scale": 0.5,
    "accel_asymmetry": 0.01, "accel_misalignment": 0.3, "gyro_bias": 0.02,
}  # fmt: skip
"""Largest errors of each group, SI."""


def prepared_units(count: int, seed: int) -> tuple[list, list]:
    """Prepared recordings and initial estimates; units that are no IMU or have none are drawn again."""
    rng = np.random.default_rng(seed)
    sizes = np.zeros(N_PARAMETERS)
    for group, size in LARGEST.items():
        sizes[GROUP_SLICES[group]] = size
    imu = ImuModel(gyro_noise=0.1 * DEG_PER_SQRT_H, accel_noise=50.0 * MICRO_G)
    motion = table1_motion(
        site=Site(9.80665, 5e-6, 0.8), stated_fixture=Fixture(0.3, 1e-3, 1e-3), heading_rad=0.3,
        sample_rate_hz=50.0, rate_rad_s=3.0, dwell_s=2.0,
    )  # fmt: skip
    data, starts = [], []
    while len(data) < count:
        errors = SensorErrors(rng.uniform(-1.0, 1.0, N_PARAMETERS) * sizes)
        if outside_model(errors) is not None:
            continue
        recording = read_out(motion, errors, imu, rng)
        try:
            unit = prepare_checked(recording, recording.sequences, "linear")
            starts.append(initial_estimate(unit, Options()))
        except srt.SrtError:
            continue
        data.append(unit)
    return data, starts


def main() -> int:
    """Print the table; 1 if a batch differs from single runs by more than 1e-9 sigma."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=20261125)
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 7, 256])
    arguments = parser.parse_args()
    data, starts = prepared_units(arguments.units, arguments.seed)
    formulas = SelectedFormulas(data[0], Options())
    vectors, U = np.stack([errors.vector for errors, _ in starts]), np.stack([U for _, U in starts])
    single: list = []
    base, largest = 0.0, 0.0
    print(f"{arguments.units} units, seed {arguments.seed}\n\n| batch | a second | ratio | converged | sigmas |")
    print("|---:|---:|---:|---:|---:|")
    for batch in arguments.batches:
        found: list = []
        began = time.process_time()
        with many_recordings(len(data)):
            for a in range(0, len(data), batch):
                own = slice(a, a + batch)
                found += iterate_units(together(data[own]), Options(), formulas, vectors[own], U[own])
        took = time.process_time() - began
        single, base = single or found, base or took
        off = max(
            float(np.abs((x.errors.vector - y.errors.vector) / np.sqrt(np.diag(sum(y.covariance.values())))).max())
            for x, y in zip(found, single, strict=True)
            if y.status == "converged"
        )
        largest = max(largest, off)
        converged = sum(x.status == "converged" for x in found)
        print(f"| {batch} | {len(data) / took:.0f} | {base / took:.2f} | {converged} | {off:.1e} |", flush=True)
    return int(largest > 1e-9)


if __name__ == "__main__":
    sys.exit(main())
