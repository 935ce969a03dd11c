"""Figures on the recorded sets: gains, offsets and sigmas beside published ones; residuals before and after.

python benchmarks/recorded_sets.py [ESTIMATOR...]     default: least-squares ekf graph
"""

import sys
import time

import numpy as np
from scipy.linalg import rq

import srt
from sims.accuracy import recorded_sets
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.sensor_errors import GROUP_SLICES

IMU_TK = {
    "accelerometer gain, counts/(m/s²)": (414.46, 412.01, 414.65),
    "accelerometer offset, counts": (33124.2, 33275.2, 32364.4),
    "gyro gain, counts/(rad/s)": (4777.96, 4764.21, 4773.66),
}
CERTIFICATE = {
    "accelerometer gain, counts/(m/s²)": (415.0, 413.0, 415.0),
    "accelerometer offset, counts": (33123.0, 33276.0, 32360.0),
    "gyro gain, counts/(rad/s)": (4778.0, 4758.0, 4766.0),
}


def xsens(recording: srt.Recording, estimator: str, gyro_bias: str) -> None:
    """Gains in imu_tk's frame: the accelerometer matrix upper triangular."""
    started = time.perf_counter()
    result = srt.calibrate(recording, estimator, hold=("gyro_asymmetry", "accel_asymmetry"), gyro_bias=gyro_bias)
    seconds = time.perf_counter() - started
    upper, turn = rq(recorded_sets.XSENS_ACCEL_PER_M_S2 * accel_triad(result.errors).matrix)
    signs = np.diag(np.sign(np.diag(upper)))
    gyro = recorded_sets.XSENS_GYRO_PER_RAD_S * gyro_triad(result.errors).matrix @ (signs @ turn).T
    offset = recorded_sets.XSENS_ACCEL_OFFSET + recorded_sets.XSENS_ACCEL_PER_M_S2 * result.errors.group("accel_bias")
    found = (np.diag(upper @ signs), offset, 1.0 / np.diag(np.linalg.inv(gyro)))
    sigma = (
        recorded_sets.XSENS_ACCEL_PER_M_S2 * result.sigma[GROUP_SLICES["accel_scale"]],
        recorded_sets.XSENS_ACCEL_PER_M_S2 * result.sigma[GROUP_SLICES["accel_bias"]],
        recorded_sets.XSENS_GYRO_PER_RAD_S * result.sigma[GROUP_SLICES["gyro_scale"]],
    )
    print(
        f"xsens_mti, {estimator}, latitude {recorded_sets.XSENS_LATITUDE_DEG}° assumed, gyro bias {gyro_bias}: "
        f"{result.status}, {len(result.corrections)} play-backs, {seconds:.2f} s"
    )
    for (name, published), values, sigmas in zip(IMU_TK.items(), found, sigma, strict=True):
        print(f"  {name}: {np.round(values, 2)} ± {np.round(sigmas, 2)}")
        print(f"    imu_tk {published}, certificate {CERTIFICATE[name]}")
    for warning in result.warnings:
        print(f"  {warning}")


def before_and_after(name: str, recording: srt.Recording, estimator: str) -> None:
    result = srt.calibrate(recording, estimator)
    labelled = recording.with_sequences(srt.find_turns(recording))
    before, after = (recorded_sets.residuals(labelled, errors) for errors in (None, result.errors))
    print(
        f"{name}, {estimator}: {len(labelled.sequences)} turns, "
        f"gravity {before['gravity_m_s2']:.4f} -> {after['gravity_m_s2']:.4f} m/s², "
        f"turns {before['turn_deg']:.2f} -> {after['turn_deg']:.2f}°, {result.status}"
    )


def main() -> None:
    folder = recorded_sets.data_folder()
    if folder is None:
        raise SystemExit(f"recorded sets not found; set {recorded_sets.DATA_VARIABLE} to their folder")
    for estimator in sys.argv[1:] or ("least-squares", "ekf", "graph"):
        for gyro_bias in ("auto", "pooled"):  # imu_tk has one bias for the whole recording
            xsens(recorded_sets.xsens_mti(folder), estimator, gyro_bias)
        before_and_after("xsens_mti", recorded_sets.xsens_mti(folder), estimator)
        for unit in (0, 1):
            before_and_after(f"mpu9150 unit {unit}", recorded_sets.mpu9150(folder, unit), estimator)


if __name__ == "__main__":
    main()
