"""Accuracy figures of the README: the claims of the closed form over their full number of draws.

Run all, or name some: ``python benchmarks/accuracy.py exact fixture large sigmas honesty free``. ``--fraction 0.1``
takes a tenth of the draws, ``--workers N`` that many processes. ``defaults`` compares the default options with others.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from functools import partial
from typing import Any

import accuracy_trials
import numpy as np
from accuracy_trials import GRADES, Trial, normalised, run
from studies import markdown, rms

from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.sensor_errors import GROUP_SLICES, GROUPS, NAMES

ERRORS = slice(0, 24)
"""Sensor errors of the test, without the gyro bias."""
ALTERNATIVES: tuple[dict[str, Any], ...] = (
    {}, {"average": "overlapping"}, {"down": "paper"}, {"window_attitude": "integrated"}, {"gyro_bias": "pooled"},
    {"gyro_bias": "per-sequence"}, {"step": "coefficients", "max_playbacks": 20}, {"measured_vertical": False},
    {"measured_vertical": False, "down": "paper"},
)  # fmt: skip
"""Options of the closed form, the default first."""
SHOWN = {
    "κ": "gyro_scale", "υ": "gyro_orthogonality", "λ": "accel_bias", "λii": "accel_scale", "μ": "accel_misalignment",
}  # fmt: skip


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


def ratio_row(name: str, trials: list[Trial], digits: int) -> list[str]:
    """Smallest and largest rms of error over reported sigma by group, and NEES / 27."""
    ratio = np.sqrt(np.mean(normalised(trials) ** 2, axis=0))
    parts = (ratio[GROUP_SLICES[g.name]] for g in GROUPS)
    nees = f"{np.mean([t.nees for t in trials]):.{digits}f}"
    return [name, *(f"{part.min():.2f}-{part.max():.2f}" for part in parts), nees]


RATIO_COLUMNS = ("rms of error over sigma", *(g.name.replace("_", " ") for g in GROUPS), "NEES/27")


def sigmas(draws: Draws) -> None:
    """Noisy units: rms of error over reported sigma, smallest and largest of each group."""
    rows, outside, count = [], [], draws.number(300, 10)
    for grade in GRADES:
        for stated in (True, False):
            unit = {"grade": grade, "state_noise": stated}
            trials = draws(accuracy_trials.noisy_trial, 300, first=1000, least=10, **unit)
            rows.append(ratio_row(f"{grade}{'' if stated else ', noise estimated'}", trials, 3))
            ratio = np.mean(normalised(trials) ** 2, axis=0)
            far = np.flatnonzero(np.abs(ratio - 1.0) > 3.5 * np.sqrt(2.0 / count))
            outside += [f"{grade} {NAMES[i]} {ratio[i]:.2f}" for i in far]
    print(f"{count} draws, 1 ± {3.5 * np.sqrt(0.5 / count):.2f} expected\n", *markdown(RATIO_COLUMNS, rows), sep="\n")
    print(f"\nvariances outside 1 ± 3.5 standard errors: {outside or 'none'}")


def honesty(draws: Draws) -> None:
    """Unmodelled effects: bias instability and g-sensitivity, each switched on alone."""

    def rows() -> Iterator[list[str]]:
        for grade, sensitivity in {"navigation": 0.002, "tactical": 0.1, "industrial": 1.0}.items():
            for label, unit in (
                ("bias instability, stated", {"instability": True}),
                ("bias instability, not stated", {"instability": True, "state_noise": False}),
                (f"g-sensitivity {sensitivity} °/h/g",
                 {"g_sensitivity": sensitivity * DEG_PER_H / STANDARD_GRAVITY_M_S2}),
            ):  # fmt: skip
                trials = draws(accuracy_trials.noisy_trial, 300, first=1000, least=10, grade=grade, **unit)
                yield ratio_row(f"{grade}, {label}", trials, 2)

    print(f"{draws.number(300, 10)} draws\n", *markdown(RATIO_COLUMNS, rows()), sep="\n")


def free(draws: Draws) -> None:
    """Free recordings: NEES of simulated hand-turned units."""
    trials = draws(accuracy_trials.free_trial, 300, first=3000, least=10)
    nees, error = np.mean([t.nees for t in trials]), np.sqrt(2.0 / 27.0 / len(trials))
    summary("free recordings", trials, f", NEES/27 {nees:.3f} ± {error:.3f} (one standard error)")


def defaults(draws: Draws) -> None:
    """Alternatives to the default options: noise-free errors on fixtures of 1 and 10 mrad, and noise sigma."""

    def rows() -> Iterator[list[str]]:
        for choice in ALTERNATIVES:
            one, ten = (draws(accuracy_trials.fixture_trial, 60, sigma_rad=s, **choice) for s in (1e-3, 1e-2))
            noisy = draws(accuracy_trials.noisy_trial, 60, first=1000, grade="navigation", calibration=choice)
            size = np.sqrt(np.mean([t.error**2 for t in noisy], axis=0))
            yield [
                ", ".join(f"{k}={v}" for k, v in choice.items() if k != "max_playbacks") or "default",
                *(f"{worst(trials, part):.1e}" for trials, part in
                  ((one, ERRORS), (ten, ERRORS), (ten, GROUP_SLICES["accel_scale"]))),
                f"{max(t.playbacks for t in one)}",
                *(f"{rms(size[GROUP_SLICES[g]]) * 1e6:.2f}" for g in SHOWN.values()),
                f"{np.mean([t.nees for t in noisy]):.2f}",
            ]  # fmt: skip

    columns = ("option", "1 mrad", "10 mrad", "λii 10 mrad", "iterations", *SHOWN, "NEES/27")
    print(f"{draws.number(60)} draws each\n", *markdown(columns, rows()), sep="\n")


CLAIMS = {f.__name__: f for f in (exact, fixture, large, sigmas, honesty, free)}
STUDIES = CLAIMS | {"defaults": defaults}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", default=list(CLAIMS), metavar="study", help=", ".join(STUDIES))
    parser.add_argument("--fraction", type=float, default=1.0)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    for name in arguments.studies:
        print(f"\n## {name}: {STUDIES[name].__doc__}\n")
        STUDIES[name](Draws(arguments.fraction, arguments.workers))


if __name__ == "__main__":
    main()
