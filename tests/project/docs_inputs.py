"""Files that the pages of the documentation speak of as the reader's: a comment ``<!-- given: NAME -->`` makes them.

Recordings of one unit, short and at 50 Hz, and what follows from them. Every name stands for the same content on all
pages.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import foreign_files
import numpy as np

import sims
import srt
from srt.constants import DEG, STANDARD_GRAVITY_M_S2
from srt.exporters import export, save
from srt.recording.applied import AppliedCorrection

SAMPLE_RATE_HZ = 50.0
TABLES = {
    "imu": {"from": "tactical-fog"},
    "site": {"from": "latitude-45"},
    "recording": {"sample_rate_hz": SAMPLE_RATE_HZ},
}
SCHEDULE = {"dwell_s": 3.0, "rate_rad_s": 3.0, "acceleration_rad_s2": 30.0}
COLUMNS = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
GYRO_LSB, ACCEL_LSB = DEG / 131.0, STANDARD_GRAVITY_M_S2 / 16384.0
"""Values of a count in docs/recordings.md, rad/s and m/s²; its offsets are below."""


@cache
def simulated(seed: int = 8, fixture: str = "lab-1mrad", **schedule: object) -> sims.Simulation:
    """Simulate a test of the unit; the seed changes fixture and noise alone."""
    tables = TABLES | {"seed": seed, "fixture": {"from": fixture}, "schedule": SCHEDULE | schedule}
    if seed != 8:
        tables |= {"errors": {"values": dict(zip(srt.NAMES, simulated().truth.vector.tolist(), strict=True))}}
    return sims.simulate(sims.scenario_from_dict(tables))


def recording(path: Path, seed: int = 8, fixture: str = "lab-1mrad") -> None:
    srt.write_recording(simulated(seed, fixture).recording, path, samples_format="npz")


def soaked(path: Path, seed: int, temperature_c: float) -> None:
    """At a temperature that does not change."""
    found = simulated(seed).recording
    warm = replace(found, temperature=np.full(found.time.size, temperature_c), data_sha256=None)
    srt.write_recording(warm, path, samples_format="npz")


def calibration(path: Path, seed: int = 8) -> None:
    srt.calibrate(simulated(seed).recording).save(path)


def nineteen_positions(path: Path) -> None:
    """Without labels, on a fixture of known heading."""
    tables = TABLES | {"seed": 8, "protocol": {"from": "19-positions"}}
    found = sims.simulate(sims.scenario_from_dict(tables)).recording
    srt.write_recording(srt.read(found.with_sequences(()), heading_deg=0.0), path, samples_format="npz")


def at_rest(path: Path) -> None:
    """A minute of white noise."""
    rng, n = np.random.default_rng(8), round(60.0 * SAMPLE_RATE_HZ)
    gyro, accel = 1e-4 * rng.standard_normal((n, 3)), 1e-3 * rng.standard_normal((n, 3))
    time = np.arange(1, n + 1) / SAMPLE_RATE_HZ
    source = (time, gyro, accel - [0.0, 0.0, STANDARD_GRAVITY_M_S2])
    srt.write_recording(srt.read(source, gravity_m_s2=STANDARD_GRAVITY_M_S2), path, samples_format="npz")


def growing(path: Path) -> None:
    """A finished test with its moves, without labels, as text."""
    found = simulated(moves="recorded").recording
    srt.write_recording(found.with_sequences(()), path, samples_format="csv")


def table(
    path: Path, *, time: float = 1.0, gyro: float, accel: float, digits: str, offsets: tuple[float, float]
) -> None:
    """Write a log; the units are given by what one of a column means in SI."""
    found = simulated().recording
    columns = [found.time / time, found.gyro / gyro + offsets[0], found.accel / accel + offsets[1]]
    np.savetxt(path, np.column_stack(columns), fmt=["%.10g", *[digits] * 6], delimiter=",", header=COLUMNS, comments="")


def log(path: Path) -> None:
    table(path, gyro=DEG, accel=STANDARD_GRAVITY_M_S2, digits="%.10g", offsets=(0.0, 0.0))


def counts(path: Path) -> None:
    table(path, time=1e-3, gyro=GYRO_LSB, accel=ACCEL_LSB, digits="%.0f", offsets=(12.0, -30.0))


def autopilot(path: Path) -> None:
    """Parameters of PX4 as they were when the unit logged."""
    unit = srt.calibrate(simulated().recording)
    save(export(unit, "px4", applied=AppliedCorrection("none")), path)


@cache
def turned_by_hand() -> tuple[np.ndarray, np.ndarray]:
    """Time, s, and readings, shape (n, 6), of a unit turned by hand between 25 rests."""
    free = {"turns": 24, "dwell_s": 4.0, "profile": "recorded-hand", "turn_duration_s": [1.5, 4.0]}
    tables = {"seed": 4, "imu": {"from": "industrial-mems"}, "site": TABLES["site"], "free": free}
    found = sims.simulate(sims.scenario_from_dict(tables | {"recording": {"sample_rate_hz": 50.0}})).recording
    return found.time, np.hstack([found.gyro, found.accel])


def robot_log(path: Path) -> None:
    """Table whose header states its units."""
    units = ["s", *["rad/s"] * 3, *["m/s^2"] * 3]
    header = ",".join(f"{name} [{unit}]" for name, unit in zip(COLUMNS.split(","), units, strict=True))
    time, values = turned_by_hand()
    np.savetxt(path, np.column_stack([time, values]), fmt="%.10g", delimiter=",", header=header, comments="")


def bag(path: Path) -> None:
    """ROS 1 bag with the topic /imu/data."""
    time, values = turned_by_hand()
    stamps = foreign_files.EPOCH_NS + np.round(time * 1e9).astype(np.int64)
    foreign_files.write_bag1(path, {"/imu/data": (stamps, values, "")})


def flight_log(path: Path) -> None:
    """PX4 log with the calibration that the autopilot applied."""
    time, values = turned_by_hand()
    stamps = np.round(time * 1e6).astype(np.uint64)
    axes = {"X": 0.35, "Y": -0.52, "Z": 0.21}
    parameters = {"SENS_BOARD_ROT": 0, "CAL_ACC0_ID": 2753036, "CAL_GYRO0_ID": 2818058}
    for axis, offset in axes.items():
        parameters |= {f"CAL_ACC0_{axis}OFF": offset, f"CAL_ACC0_{axis}SCALE": 1.01, f"CAL_GYRO0_{axis}OFF": 0.011}
    selected = {"timestamp": stamps[:1], "accel_device_id": [2753036], "gyro_device_id": [2818058]}
    topics = [
        ("sensor_combined", 0, foreign_files.COMBINED, foreign_files.combined(stamps, values)),
        ("sensor_selection", 0, foreign_files.SELECTION, selected),
    ]
    foreign_files.write_ulog(path, topics, parameters)


def plan_file(path: Path) -> None:
    path.write_text(
        'imu = { from = "tactical-fog" }\nfixture = { from = "lab-1mrad" }\nsite = { from = "latitude-45" }\n'
        "stand = { rate_rad_s = 2.0 }\ntargets = { gyro_scale_ppm = 100.0 }\n"
        "plan = { total_time_s = 120.0, most_legs = 1 }\n"
    )


def campaign(path: Path) -> None:
    path.write_text(
        '[campaign]\nname = "mine"\nseed = 1\ntrials = 1\n[scenario]\nfrom = "robustness"\n'
        "[scenario.schedule]\ndwell_s = 2.0\n[scenario.recording]\nsample_rate_hz = 50.0\n"
        '[grid]\nscale_percent = [5]\n[[estimator]]\nname = "closed-form"\n'
    )


INPUTS = {
    **dict.fromkeys(("recording", "raw", "rec", "unit-42", "monday"), recording),
    "tuesday": lambda path: recording(path, 9),
    "cold": lambda path: soaked(path, 9, -10.0),
    "warm": lambda path: soaked(path, 10, 45.0),
    "poses": lambda path: recording(path, 10, "perfect"),
    "unit.json": calibration,
    "unit-42-last-year.json": lambda path: calibration(path, 9),
    "my-recording": nineteen_positions,
    "night": at_rest,
    "my-test": growing,
    "log.csv": log,
    "counts.csv": counts,
    "vehicle.params": autopilot,
    "imu.bag": bag,
    "robot.csv": robot_log,
    "turned.ulg": flight_log,
    "lab.toml": plan_file,
    "mine.toml": campaign,
}
"""Function that makes each file or folder."""
