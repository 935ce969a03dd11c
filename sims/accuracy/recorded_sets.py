"""Readers of three public sets of recorded data, for tests and benchmarks; the data are not part of the project.

xsens_mti (Tedaldi, Pretto and Menegatti, ICRA 2014), mpu9150 (mikoff/imu-calib) and imucal's Ferraris example.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.spatial.transform import Rotation

from srt.constants import DEG
from srt.recording.recording import Recording, Site
from srt.result.calibration import Calibration
from srt.sensor_errors import SensorErrors

if TYPE_CHECKING:
    from srt.types import Array

DATA_VARIABLE: Final = "SRT_RECORDED_DATA"
"""Environment variable that names the folder of the recorded sets."""

XSENS_GYRO_PER_RAD_S, XSENS_GYRO_OFFSET = 4770.0, 32768.0
XSENS_ACCEL_PER_M_S2, XSENS_ACCEL_OFFSET = 415.0, 33000.0
XSENS_LATITUDE_DEG: Final = 45.4
"""Assumed: Padova, the authors' laboratory."""


def data_folder() -> Path | None:
    """Folder of the recorded sets: the environment's, or ``../shared/data`` beside the checkout; None if absent."""
    for place in (os.environ.get(DATA_VARIABLE), Path(__file__).parents[3] / "shared" / "data"):
        if place is not None and Path(place).is_dir():
            return Path(place)
    return None


def xsens_mti(folder: Path) -> Recording:
    """Xsens MTi, raw counts, 100 Hz, 37 turns by hand; nominal gains and offsets make it SI."""
    accel, gyro = (np.loadtxt(folder / "xsens_mti" / f"xsens_{name}.mat") for name in ("acc", "gyro"))
    return from_counts(accel[:, 0], gyro[:, 1:], accel[:, 1:])


def from_counts(time: Array, gyro: Array, accel: Array) -> Recording:
    """Counts of the Xsens set to a recording."""
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


def residuals(recording: Recording, errors: SensorErrors | None) -> dict[str, float]:
    """What gravity and turns of a labelled free recording leave over under given errors, rms.

    Parameters
    ----------
    recording : Recording
        With its turns as labels.
    errors : SensorErrors or None
        None: an uncalibrated unit but for its gyro bias, which is its mean rate at rest.

    Returns
    -------
    dict
        ``gravity_m_s2``: magnitude of the mean specific force of the windows less gravity; ``turn_deg``: angle between
        the vertical after a turn as the accelerometers see it and as the gyros carry it over.
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
