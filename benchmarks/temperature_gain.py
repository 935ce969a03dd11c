"""Navigation for 60 s at 0 °C: corrected by a calibration of 25 °C, and by one over temperature.

``python benchmarks/temperature_gain.py --units 20`` draws industrial units whose errors depend on temperature
(``soaked_units.py``), tests each at five soak points from -20 to 60 °C with the sigmas of a calibration on the
fixture, moves it for a minute at 0 °C, and integrates its corrected readings from an exact start on an Earth that does
not turn. The errors are differences from the integral of the true readings, so that the integration itself has none.
"""

from __future__ import annotations

import harness
import numpy as np
from scipy.spatial.transform import Rotation
from soaked_units import Unit

import srt
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.sensor_errors import SensorErrors

RATE_HZ = 200.0
SECONDS = 60.0
GRAVITY = np.array([0.0, 0.0, 9.81])


def motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """True rates and specific forces of a vehicle that swings and accelerates, (n, 3) each."""
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)[:, None]
    rate = sum(
        size * np.sin(2.0 * np.pi * frequency * t + rng.uniform(0.0, 2.0 * np.pi, 3))
        for size, frequency in ((0.6, 0.05), (0.3, 0.21), (0.1, 0.9))
    )
    acceleration = sum(
        size * np.sin(2.0 * np.pi * frequency * t + rng.uniform(0.0, 2.0 * np.pi, 3))
        for size, frequency in ((1.5, 0.08), (0.7, 0.5))
    )
    attitude = attitudes(rate)
    return rate, attitude.inv().apply(acceleration - GRAVITY)


def attitudes(rate: np.ndarray) -> Rotation:
    """Attitudes, body to level, at the samples of a rate."""
    steps = Rotation.from_rotvec(rate / RATE_HZ)
    out = [Rotation.identity()]
    for step in steps[:-1]:
        out.append(out[-1] * step)
    return Rotation.concatenate(out)


def navigated(rate: np.ndarray, force: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """Attitude and position at the end."""
    attitude = attitudes(rate)
    velocity = np.cumsum(attitude.apply(force) + GRAVITY, axis=0) / RATE_HZ
    return attitude[-1], velocity.sum(axis=0) / RATE_HZ


def main(*, units: int = 20, seed: int = 20261206) -> None:
    rng = np.random.default_rng(seed)
    errors: dict[str, list[tuple[float, float]]] = {"at 25 °C": [], "over temperature": []}
    for _ in range(units):
        unit = Unit(rng)
        curves = srt.calibrate_thermal(unit.tests(rng))
        true = SensorErrors(unit.errors(0.0, rng.choice([-1, 1])))
        rate, force = motion(rng)
        readings = gyro_triad(true).read(rate), accel_triad(true).read(force)
        corrected = {
            "at 25 °C": curves.at(25.0).apply(*readings),
            "over temperature": curves.at(0.0).apply(*readings),
        }
        attitude, position = navigated(rate, force)
        for name, each in corrected.items():
            found, place = navigated(*each)
            tilt = np.degrees((attitude.inv() * found).magnitude())
            errors[name].append((float(tilt), float(np.linalg.norm(place - position))))
    print(f"{units} units, seed {seed}: median error after {SECONDS:.0f} s at 0 °C\n")
    print("| corrected by a calibration | attitude, ° | position, m |\n|---|---:|---:|")
    for name, values in errors.items():
        tilt, place = np.median(values, axis=0)
        print(f"| {name} | {tilt:.2f} | {place:.1f} |")


if __name__ == "__main__":
    harness.run(main, __doc__)
