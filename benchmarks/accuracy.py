"""Accuracy figures of the README: the claims of the closed form over their full number of draws.

Run all, or name some: ``python benchmarks/accuracy.py exact fixture large``. ``--fraction 0.1``
takes a tenth of the draws, ``--workers N`` that many processes.
"""

from collections import Counter
from functools import partial
from typing import Any

import accuracy_trials
import harness
import numpy as np
from accuracy_trials import Trial, run
from studies import rms

from srt.constants import DEG
from srt.sensor_errors import GROUP_SLICES

ERRORS = slice(0, 24)
"""Sensor errors of the test, without the gyro bias."""


class Draws:
    """Trials of ``n`` times their full number, at least of a smallest one, in some processes."""

    def __init__(self, fraction: float, workers: int) -> None:
        self.fraction, self.workers = fraction, workers

    def number(self, full: int, least: int = 2) -> int:
        return max(least, int(full * self.fraction))

    def __call__(self, trial: Any, full: int, *, first: int = 0, least: int = 2, **case: Any) -> list[Trial]:
        count = self.number(full, least)
        return run(partial(trial, **case), range(first, first + count), workers=self.workers)


def worst(trials: list[Trial], part: slice = ERRORS) -> float:
    return max(float(np.abs(t.error[part]).max()) for t in trials)


def summary(title: str, trials: list[Trial], extra: str = "") -> None:
    states = dict(Counter(t.status for t in trials))
    print(
        f"{title}: {len(trials)} draws, worst parameter {worst(trials):.2e}, {states}, "
        f"iterations {min(t.playbacks for t in trials)}-{max(t.playbacks for t in trials)}{extra}",
        flush=True,
    )


def exact(draws: Draws) -> None:
    """Noise-free, perfect fixture, 24 errors of 1e-3, gyro bias up to 1 °/s."""
    rates = ({"sample_rate_hz": hz} for hz in (50.0, 100.0, 1000.0))
    for case in ({}, *rates, {"kind": "increment"}, {"turned_rad": 0.2}):
        trials = draws(accuracy_trials.exact_trial, 20, **case)
        summary(f"noise-free, perfect fixture {case or '200 Hz'}", trials)


def fixture(draws: Draws) -> None:
    """Noise-free, fixture errors."""
    for label, case in (
        ("1 mrad", {}),
        ("1 mrad, Earth's rate off", {"earth_rate": False}),
        ("3 mrad", {"sigma_rad": 3e-3}),
        ("10 mrad", {"sigma_rad": 1e-2}),
        ("1 mrad, half turns of 150°-210°", {"stretch_rad": 30.0 * DEG}),
    ):
        trials = draws(accuracy_trials.fixture_trial, 200, **case)
        scale = worst(trials, GROUP_SLICES["accel_scale"])
        size = rms(np.array([t.error[ERRORS] for t in trials]))
        summary(label, trials, f", rms {size:.1e}, accelerometer scale {scale:.1e}")


def large(draws: Draws) -> None:
    """±50 % scale, ±0.3 rad, ±1 % asymmetry, ±1 °/s, ±1 m/s², fixture 5 mrad."""
    trials = draws(accuracy_trials.large_trial, 1000)
    distance, redrawn = max(t.distance for t in trials), sum(t.redrawn for t in trials)
    summary("large errors", trials, f", largest distance {distance:.2e} of max(1e-8, 0.01 sigma), {redrawn} redrawn")
    print("iterations of units:", dict(sorted(Counter(t.playbacks for t in trials).items())))


CLAIMS = {f.__name__: f for f in (exact, fixture, large)}


def main(studies: tuple[str, ...] = tuple(CLAIMS), *, fraction: float = 1.0, workers: int = 2) -> None:
    for name in studies:
        print(f"\n## {name}: {CLAIMS[name].__doc__}\n")
        CLAIMS[name](Draws(fraction, workers))


if __name__ == "__main__":
    harness.run(main, __doc__)
