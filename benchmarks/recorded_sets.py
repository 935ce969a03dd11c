"""Four public sets of recorded data: readers, and the results of one beside published ones.

xsens_mti (Tedaldi, Pretto and Menegatti, ICRA 2014), mpu9150 (mikoff/imu-calib), imucal's Ferraris example and an array
of eight units (Carlsson et al., IEEE Sensors J. 2021). The data are not part of the project; the environment variable
:data:`DATA_VARIABLE` names their folder.

``python benchmarks/recorded_sets.py [ESTIMATOR...]`` prints gains, offsets and 1-sigma values of the first beside
published ones. Default estimators: least-squares, ekf, graph.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import harness
import numpy as np
from scipy.linalg import rq
from scipy.spatial.transform import Rotation

import srt
from srt.constants import DEG, STANDARD_GRAVITY_M_S2
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.recording.recording import Recording, Site
from srt.result.calibration import Calibration
from srt.sensor_errors import GROUP_SLICES, SensorErrors

if TYPE_CHECKING:
    from srt.types import Array

DATA_VARIABLE: Final = "SRT_RECORDED_DATA"
"""Environment variable that names the folder of the recorded sets."""

XSENS_GYRO_PER_RAD_S, XSENS_GYRO_OFFSET = 4770.0, 32768.0
"""Nominal gyro gain, counts/(rad/s), and offset, counts."""
XSENS_ACCEL_PER_M_S2, XSENS_ACCEL_OFFSET = 415.0, 33000.0
"""Nominal accelerometer gain, counts/(m/s²), and offset, counts."""
XSENS_LATITUDE_DEG: Final = 45.4
"""Assumed: Padova, the authors' laboratory."""


def data_folder() -> Path | None:
    """Folder of the recorded sets: :data:`DATA_VARIABLE`, else ``../shared/data`` beside the checkout, or None."""
    for place in (os.environ.get(DATA_VARIABLE), Path(__file__).parents[2] / "shared" / "data"):
        if place is not None and Path(place).is_dir():
            return Path(place)
    return None


def xsens_mti(folder: Path) -> Recording:
    """Xsens MTi, raw counts, 100 Hz, 37 turns by hand; nominal gains and offsets make it SI."""
    accel, gyro = (np.loadtxt(folder / "xsens_mti" / f"xsens_{name}.mat") for name in ("acc", "gyro"))
    return from_counts(accel[:, 0], gyro[:, 1:], accel[:, 1:])


def from_counts(time: Array, gyro: Array, accel: Array) -> Recording:
    """Recording from raw counts of the Xsens set."""
    return Recording(
        time,
        (gyro - XSENS_GYRO_OFFSET) / XSENS_GYRO_PER_RAD_S,
        (accel - XSENS_ACCEL_OFFSET) / XSENS_ACCEL_PER_M_S2,
        Site(9.81744, 5e-4, XSENS_LATITUDE_DEG * DEG),
    )


def mpu9150(folder: Path, unit: int) -> Recording:
    """InvenSense MPU-9150, 100 Hz, 21 turns by hand; place unknown, so no latitude and gravity to 5e-3 m/s²."""
    table = np.loadtxt(folder / "mpu9150" / f"imu{unit}.log")
    time = 0.01 * np.arange(1.0, len(table) + 1)
    return Recording(time, table[:, 3:], table[:, :3], Site(9.81, 5e-3), sample_rate_hz=100.0)


def ferraris(folder: Path) -> Recording:
    """Wearable unit, 102.4 Hz: six faces and a full turn about each axis made of four hand turns."""
    table = np.loadtxt(folder / "ferraris" / "example_ferraris_session.csv", delimiter=",", skiprows=1)
    rate = 102.4
    time = np.asarray(np.arange(1, len(table) + 1) / rate, dtype=np.float64)
    return Recording(time, table[:, 1:4] * DEG, table[:, 4:7], Site(9.81, 5e-3), sample_rate_hz=rate)


def array_chip(folder: Path, repeat: int, chip: int) -> Recording:
    """One of eight InvenSense units on a rigid board, 62.5 Hz, turned by hand; place known to some hundred km only."""
    table = np.load(folder / "array" / f"exp_{repeat}.npz")
    gyro, accel = (table[f"{sensor}_counts"][:, chip - 1] for sensor in ("gyro", "accel"))
    return Recording(
        np.asarray(table["time_s"]), gyro / 16.4 * DEG, accel / 2048.0 * STANDARD_GRAVITY_M_S2, Site(9.818, 5e-3)
    )


def residuals(recording: Recording, errors: SensorErrors | None) -> dict[str, float]:
    """Residuals of gravity and rotations of a labelled free recording under given sensor errors, rms.

    Parameters
    ----------
    recording : Recording
        With its rotations labelled.
    errors : SensorErrors or None
        None: uncalibrated except for the gyro bias, the mean rate at rest.

    Returns
    -------
    dict
        ``gravity_m_s2``: magnitude of the mean specific force of a window minus gravity; ``turn_deg``: angle between
        the vertical measured by the accelerometers after a rotation and the one propagated by the gyros.
    """
    bias = np.zeros(3)
    down, turn = [], []
    for label in recording.sequences:
        windows = [recording.window_indices(*w) for w in (label.start_static_s, label.end_static_s)]
        bias += recording.gyro[windows[0]].mean(axis=0) / len(recording.sequences)
    if errors is None:
        errors = SensorErrors.from_dict({f"gyro_bias_{axis}": b for axis, b in zip("xyz", bias, strict=True)})
    unit = Calibration("given", "converged", "", errors, np.zeros((27, 27)))
    for label in recording.sequences:
        start, end = (recording.window_indices(*w) for w in (label.start_static_s, label.end_static_s))
        mean = np.stack([recording.accel[s].mean(axis=0) for s in (start, end)])
        moving = slice(start.stop, end.start)
        rate, _ = unit.apply(recording.gyro[moving], recording.accel[moving])
        _, force = unit.apply(mean, mean)
        down.append(np.linalg.norm(force[0]) - recording.site.gravity_m_s2)
        attitude = Rotation.identity()
        interval = recording.nominal_interval_s
        for step in Rotation.from_rotvec(rate * interval):
            attitude = attitude * step
        seen, carried = force[0], attitude.apply(force[1])
        turn.append(np.arctan2(np.linalg.norm(np.cross(seen, carried)), seen @ carried))
    return {
        "gravity_m_s2": float(np.sqrt(np.mean(np.square(down)))),
        "turn_deg": float(np.degrees(np.sqrt(np.mean(np.square(turn))))),
    }


IMU_TK: Final = {
    "accelerometer gain, counts/(m/s²)": (414.46, 412.01, 414.65),
    "accelerometer offset, counts": (33124.2, 33275.2, 32364.4),
    "gyro gain, counts/(rad/s)": (4777.96, 4764.21, 4773.66),
}
"""Results that imu_tk's authors publish for the Xsens set."""
CERTIFICATE: Final = {
    "accelerometer gain, counts/(m/s²)": (415.0, 413.0, 415.0),
    "accelerometer offset, counts": (33123.0, 33276.0, 32360.0),
    "gyro gain, counts/(rad/s)": (4778.0, 4758.0, 4766.0),
}
"""Results on the manufacturer's certificate of the same unit."""


def xsens(recording: srt.Recording, estimator: str, gyro_bias: str) -> None:
    """Gains in imu_tk's frame: the accelerometer matrix upper triangular."""
    started = time.perf_counter()
    result = srt.calibrate(recording, estimator, hold=("gyro_asymmetry", "accel_asymmetry"), gyro_bias=gyro_bias)
    seconds = time.perf_counter() - started
    upper, turn = rq(XSENS_ACCEL_PER_M_S2 * accel_triad(result.errors).matrix)
    signs = np.diag(np.sign(np.diag(upper)))
    gyro = XSENS_GYRO_PER_RAD_S * gyro_triad(result.errors).matrix @ (signs @ turn).T
    offset = XSENS_ACCEL_OFFSET + XSENS_ACCEL_PER_M_S2 * result.errors.group("accel_bias")
    found = (np.diag(upper @ signs), offset, 1.0 / np.diag(np.linalg.inv(gyro)))
    sigma = (
        XSENS_ACCEL_PER_M_S2 * result.sigma[GROUP_SLICES["accel_scale"]],
        XSENS_ACCEL_PER_M_S2 * result.sigma[GROUP_SLICES["accel_bias"]],
        XSENS_GYRO_PER_RAD_S * result.sigma[GROUP_SLICES["gyro_scale"]],
    )
    print(
        f"xsens_mti, {estimator}, latitude {XSENS_LATITUDE_DEG}° assumed, gyro bias {gyro_bias}: "
        f"{result.status}, {len(result.corrections)} iterations, {seconds:.2f} s"
    )
    for (name, published), values, sigmas in zip(IMU_TK.items(), found, sigma, strict=True):
        print(f"  {name}: {np.round(values, 2)} ± {np.round(sigmas, 2)}")
        print(f"    imu_tk {published}, certificate {CERTIFICATE[name]}")
    for warning in result.warnings:
        print(f"  {warning}")


def main(estimators: tuple[str, ...] = ("least-squares", "ekf", "graph")) -> None:
    folder = data_folder()
    if folder is None:
        raise SystemExit(f"recorded sets not found; set {DATA_VARIABLE} to their folder")
    for estimator in estimators:
        for gyro_bias in ("auto", "pooled"):  # imu_tk has one bias for the whole recording
            xsens(xsens_mti(folder), estimator, gyro_bias)


if __name__ == "__main__":
    harness.run(main, __doc__)
