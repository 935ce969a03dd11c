"""Defects of real recordings, simulated: what a calibration by hand-turned units says of them.

The units and motions are those of ``benchmarks/foreign_motion.py``, which shares nothing with the simulator or the
estimators. Each row puts one defect of a real log into ``--units`` recordings and gives what was said of it: statuses,
first findings, and of what converged the rms of the normalised errors and the largest. The exit code is 1 if a defect
that must be named is not.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from foreign_motion import DEG, GRADES, drawn_errors, hand_turns, recording, windows
from scipy.signal import lfilter

import srt
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Callable

SEED = 20261123
FIRST_REST_S = 5.0
COUNTS = 32767
"""Largest count of a signed word of 16 bits."""


@dataclass(frozen=True)
class Unit:
    """Recording without a defect, the rests in it, and what draws the defect."""

    recording: srt.Recording
    rests: list[tuple[float, float]]
    rng: np.random.Generator


def changed(unit: Unit, **values: np.ndarray) -> srt.Recording:
    return replace(unit.recording, **values)


def rows_of(unit: Unit, interval: tuple[float, float]) -> slice:
    time = unit.recording.time
    return slice(*np.searchsorted(time, interval).tolist())


def clipped_turns(unit: Unit) -> srt.Recording:
    """Two turns exceed the range of the gyros: it is 0.8 of the second largest rate of any turn."""
    gyro = unit.recording.gyro
    turns = [(a[1], b[0]) for a, b in zip(unit.rests, unit.rests[1:], strict=False)]
    peaks = np.sort([np.abs(gyro[rows_of(unit, turn)]).max() for turn in turns])
    limit = 0.8 * peaks[-2]
    return changed(unit, gyro=np.clip(gyro, -limit, limit))


def shake(unit: Unit) -> srt.Recording:
    """A shake between two rests, at the rails of 16 bits: 741 readings."""
    gyro, accel = unit.recording.gyro.copy(), unit.recording.accel.copy()
    a, b = unit.rests[len(unit.rests) // 2]
    middle = int(np.searchsorted(unit.recording.time, 0.5 * (a + b)))
    rows = slice(middle - 65, middle + 65)
    t = np.arange(130) / 100.0
    envelope = np.sin(np.pi * t / t[-1])[:, None]
    gyro[rows] += envelope * 60.0 * np.sin(2.0 * np.pi * 4.0 * t[:, None] + unit.rng.uniform(0.0, 6.0, 3))
    accel[rows] += envelope * 80.0 * np.sin(2.0 * np.pi * 4.0 * t[:, None] + unit.rng.uniform(0.0, 6.0, 3))
    scale = np.array([2000.0 * DEG, 4.0 * 9.80665]) / COUNTS
    gyro, accel = (
        np.clip(np.round(x / s), -COUNTS, COUNTS) * s for x, s in zip((gyro, accel), scale.tolist(), strict=True)
    )
    return changed(unit, gyro=gyro, accel=accel)


def scaled(sensor: str, factor: float) -> Callable[[Unit], srt.Recording]:
    """A wrong value of a count."""
    return lambda unit: changed(unit, **{sensor: factor * getattr(unit.recording, sensor)})


def decimated_increments(unit: Unit) -> srt.Recording:
    """One increment of 4 ms, every 500 ms."""
    every = unit.recording
    step = round(0.5 / every.nominal_interval_s)
    rows = np.arange(step - 1, len(every.time), step)
    return replace(
        every, time=every.time[rows], gyro=0.004 * every.gyro[rows], accel=0.004 * every.accel[rows], kind="increment"
    )


def autopilot_log(unit: Unit) -> srt.Recording:
    """Samples of 5 ms with stamps to 4 ms, one of 400 lost, and a gap of up to half a second in thirty seconds."""
    every, rng = unit.recording, unit.rng
    keep = rng.random(len(every.time)) > 1.0 / 400.0
    for at in rng.uniform(every.time[0], every.time[-1], round(every.time[-1] / 30.0)):
        keep[rows_of(unit, (at, at + rng.uniform(0.05, 0.5)))] = False
    stamps = np.round(every.time / 0.004) * 0.004
    return replace(every, time=stamps[keep], gyro=every.gyro[keep], accel=every.accel[keep])


def low_pass(time_s: float) -> Callable[[Unit], srt.Recording]:
    """Outputs filtered by the sensor, first order."""

    def filtered(unit: Unit) -> srt.Recording:
        share = -np.expm1(-unit.recording.nominal_interval_s / time_s)
        values = {}
        for sensor in ("gyro", "accel"):
            x = getattr(unit.recording, sensor)
            state = (1.0 - share) * x[:1]
            values[sensor] = lfilter([share], [1.0, share - 1.0], x, axis=0, zi=state)[0]
        return changed(unit, **values)

    return filtered


def off_the_grid(unit: Unit) -> srt.Recording:
    """Readings of 16 bits after a correction that leaves them off their grid."""
    scale = {"gyro": 2000.0 * DEG / COUNTS, "accel": 4.0 * 9.80665 / COUNTS}
    grids = {name: np.round(getattr(unit.recording, name) / s) * s for name, s in scale.items()}
    return changed(unit, **{name: x + unit.rng.normal(0.0, 1e-12, x.shape) for name, x in grids.items()})


@dataclass(frozen=True)
class Row:
    """Defect, the findings that name it, and the units it is put into."""

    defect: Callable[[Unit], srt.Recording]
    named: tuple[str, ...] = ()
    grade: str = "consumer"
    turns: int = 24
    hz: float = 100.0


ROWS = {
    "none": Row(lambda unit: unit.recording),
    "none, 9 turns": Row(lambda unit: unit.recording, turns=9),
    "2 of 9 turns clipped": Row(clipped_turns, ("gyro_clipped",), turns=9),
    "shake at ±32767": Row(shake, ("gyro_clipped",)),
    "count of accelerometers a half": Row(scaled("accel", 0.5), ("accel_lsb",)),
    "count of accelerometers a quarter": Row(scaled("accel", 0.25), ("accel_lsb",)),
    "count of gyros twice": Row(scaled("gyro", 2.0), ("gyro_lsb",)),
    "one increment of 4 ms in 500 ms": Row(decimated_increments, ("increments_thinned",), hz=250.0),
    "stamps of 4 ms, samples lost, gaps": Row(autopilot_log, ("gap_in_sequence",), hz=200.0),
    "low-pass filter of 5 ms": Row(low_pass(0.005)),
    "low-pass filter of 50 ms": Row(low_pass(0.05)),
    "corrected readings of 16 bits": Row(off_the_grid),
}


@dataclass(frozen=True)
class Outcome:
    """Status or refusal of one unit, faults named, and normalised errors, NaN where there is none."""

    status: str
    faults: list[str]
    z: np.ndarray


def outcome(row: Row, number: int) -> Outcome:
    """Outcome of one unit, drawn from its number."""
    rng = np.random.default_rng((SEED, number))
    grade = GRADES[row.grade]
    errors = drawn_errors(grade, rng)
    turns = hand_turns(rng, shortest_s=1.5, count=row.turns)
    clean = recording(turns, FIRST_REST_S, errors, grade, rng, hz=row.hz)
    unit = row.defect(Unit(clean, windows(turns, FIRST_REST_S), rng))
    faults, z = [finding.fault for finding in srt.diagnose(unit).findings], np.full(len(NAMES), np.nan)
    try:
        found = srt.calibrate(unit)
    except srt.SrtError:
        return Outcome("refused", faults, z)
    if found.status in ("converged", "partial"):
        truth = np.array([errors.get(parameter, 0.0) for parameter in NAMES])
        seen = found.observed
        z[seen] = (found.errors.vector - truth)[seen] / found.sigma[seen]
    return Outcome(found.status, faults, z)


def counted(values: list[str]) -> str:
    return ", ".join(f"{count} {value}" for value, count in Counter(values).most_common()) or "-"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--rows", nargs="+", choices=tuple(ROWS), default=tuple(ROWS), metavar="DEFECT")
    options = parser.parse_args()
    print(f"{options.units} units a row, seed {SEED}\n")
    print("| defect | status | first finding | rms | largest |")
    print("|---|---|---|---:|---:|")
    silent = 0
    for name in options.rows:
        row = ROWS[name]
        found = [outcome(row, number) for number in range(options.units)]
        z = np.array([one.z for one in found])
        rms, largest = (np.sqrt(np.nanmean(z**2)), np.nanmax(np.abs(z))) if np.isfinite(z).any() else (np.nan, np.nan)
        first = counted([one.faults[0] if one.faults else "none" for one in found])
        print(
            f"| {name} | {counted([one.status for one in found])} | {first} | {rms:.2f} | {largest:.1f} |", flush=True
        )
        silent += sum(bool(row.named) and not set(row.named) & set(one.faults) for one in found)
    return 1 if silent else 0


if __name__ == "__main__":
    sys.exit(main())
