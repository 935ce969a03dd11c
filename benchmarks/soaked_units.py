"""A unit whose errors depend on temperature, with hysteresis, and calibrations of tests of it at soak points."""

from dataclasses import replace
from functools import cache

import numpy as np

import sims
import srt
from srt.result.provenance import Provenance, Temperature
from srt.sensor_errors import GROUPS, N_PARAMETERS, SensorErrors

# Change from -20 to 60 °C and a half, SI; sizes of consumer and industrial units.
SIZE = {
    "gyro_scale": 3e-3, "gyro_asymmetry": 1e-4, "gyro_orthogonality": 2e-4, "accel_bias": 0.05, "accel_scale": 3e-3,
    "accel_asymmetry": 1e-4, "accel_misalignment": 2e-4, "gyro_bias": 2e-3,
}  # fmt: skip
SIZES = np.concatenate([np.full(len(g.suffixes), SIZE[g.name]) for g in GROUPS])
SOAKS = (-20.0, 0.0, 20.0, 40.0, 60.0)


@cache
def one_test():
    return srt.calibrate(sims.simulate(sims.load_scenario("industrial-mems")).recording, "least-squares")


class Unit:
    """A unit whose errors are powers of the temperature, and differ between heating and cooling."""

    def __init__(self, rng):
        by_power = SIZES * rng.normal(size=(3, N_PARAMETERS)) * np.array([[0.5], [0.3], [0.2]])
        self.powers = np.concatenate([1e-2 * SIZES * rng.normal(size=(1, N_PARAMETERS)), by_power])
        self.hysteresis = 0.05 * SIZES * rng.normal(size=N_PARAMETERS)

    def errors(self, T, side):
        x = (T - 20.0) / 40.0
        return x ** np.arange(4) @ self.powers + side * (1.0 - x**2) * self.hysteresis

    def tests(self, rng, soaks=SOAKS):
        """Calibrations at soak points, all from one side or each from a random one, with the noise of one test."""
        root = np.linalg.cholesky(one_test().covariance)
        sides = rng.choice([-1, 1], len(soaks)) if rng.random() < 0.5 else np.full(len(soaks), rng.choice([-1, 1]))
        return [
            at(T, self.errors(T, side) + root @ rng.normal(size=N_PARAMETERS))
            for T, side in zip(soaks, sides, strict=True)
        ]


def at(T, vector):
    return replace(one_test(), errors=SensorErrors(vector), temperature=Temperature(T, 0.5), provenance=Provenance())
