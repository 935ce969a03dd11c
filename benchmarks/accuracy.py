"""Accuracy figures of the README: the claims of the closed form over their full number of draws.

Run all, or name some: ``python benchmarks/accuracy.py exact fixture large sigmas honesty free``. ``--fraction 0.1``
takes a tenth of the draws, ``--workers N`` that many processes.
"""

import argparse
from functools import partial

import accuracy_trials
import numpy as np
from accuracy_trials import GRADES, Trial, normalised, run
from rich.console import Console
from rich.table import Table

from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.sensor_errors import GROUP_SLICES, GROUPS, NAMES

console = Console(width=150)
ERRORS = slice(0, 24)
"""Sensor errors of the test, without the gyro bias."""


def worst(trials: list[Trial], part: slice = ERRORS) -> float:
    return max(float(np.abs(t.error[part]).max()) for t in trials)


def summary(title: str, trials: list[Trial], extra: str = "") -> None:
    states = {s: sum(t.status == s for t in trials) for s in {t.status for t in trials}}
    console.print(
        f"{title}: {len(trials)} draws, worst parameter {worst(trials):.2e}, {states}, "
        f"iterations {min(t.playbacks for t in trials)}-{max(t.playbacks for t in trials)}{extra}"
    )


def exact(n: float, workers: int) -> None:
    """Noise-free, perfect fixture, 24 errors of 1e-3, gyro bias up to 1 °/s."""
    for case in (
        {},
        {"sample_rate_hz": 50.0},
        {"sample_rate_hz": 100.0},
        {"sample_rate_hz": 1000.0},
        {"kind": "increment"},
        {"turned_rad": 0.2},
    ):
        trials = run(partial(accuracy_trials.exact_trial, **case), range(max(2, int(20 * n))), workers=workers)
        summary(f"noise-free, perfect fixture {case or '200 Hz'}", trials)


def fixture(n: float, workers: int) -> None:
    """Noise-free, fixture errors."""
    count = max(2, int(200 * n))
    for label, case in (
        ("1 mrad", {}),
        ("1 mrad, Earth's rate off", {"earth_rate": False}),
        ("3 mrad", {"sigma_rad": 3e-3}),
        ("10 mrad", {"sigma_rad": 1e-2}),
        ("1 mrad, half turns of 150°-210°", {"stretch_rad": 30.0 * DEG}),
    ):
        trials = run(partial(accuracy_trials.fixture_trial, **case), range(count), workers=workers)
        scale = worst(trials, GROUP_SLICES["accel_scale"])
        rms = np.sqrt(np.mean([t.error[ERRORS] ** 2 for t in trials]))
        summary(label, trials, f", rms {rms:.1e}, accelerometer scale {scale:.1e}")


def large(n: float, workers: int) -> None:
    """±50 % scale, ±0.3 rad, ±1 % asymmetry, ±1 °/s, ±1 m/s², fixture 5 mrad."""
    trials = run(accuracy_trials.large_trial, range(max(2, int(1000 * n))), workers=workers)
    distance = max(t.distance for t in trials)
    redrawn = sum(t.redrawn for t in trials)
    summary("large errors", trials, f", largest distance {distance:.2e} of max(1e-8, 0.01 sigma), {redrawn} redrawn")
    counts = np.bincount([t.playbacks for t in trials])
    for playbacks in np.flatnonzero(counts):
        bar = "█" * max(1, round(60 * counts[playbacks] / counts.max()))
        console.print(f"  {playbacks} iterations {counts[playbacks]:5d} {bar}")


def _by_group(ratio: np.ndarray) -> list[str]:
    return [
        f"{np.sqrt(ratio[GROUP_SLICES[g.name]]).min():.2f}-{np.sqrt(ratio[GROUP_SLICES[g.name]]).max():.2f}"
        for g in GROUPS
    ]


def _table(title: str) -> Table:
    table = Table(title=title)
    table.add_column("unit", no_wrap=True)
    for column in (*(g.name.replace("_", " ") for g in GROUPS), "NEES/27"):
        table.add_column(column, min_width=9)
    return table


def sigmas(n: float, workers: int) -> None:
    """Noisy units: rms of error over reported sigma, smallest and largest of each group."""
    count = max(10, int(300 * n))
    table = _table(f"rms of error over reported sigma, {count} draws (1 ± {3.5 * np.sqrt(0.5 / count):.2f} expected)")
    outside = []
    for grade in GRADES:
        for stated in (True, False):
            unit = partial(accuracy_trials.noisy_trial, grade=grade, state_noise=stated)
            trials = run(unit, range(1000, 1000 + count), workers=workers)
            ratio = np.mean(normalised(trials) ** 2, axis=0)
            table.add_row(
                f"{grade}{'' if stated else ', noise estimated'}",
                *_by_group(ratio),
                f"{np.mean([t.nees for t in trials]):.3f}",
            )
            band = 3.5 * np.sqrt(2.0 / count)
            outside += [f"{grade} {NAMES[i]} {ratio[i]:.2f}" for i in np.flatnonzero(np.abs(ratio - 1.0) > band)]
    console.print(table)
    console.print(f"variances outside 1 ± 3.5 standard errors: {outside or 'none'}")


def honesty(n: float, workers: int) -> None:
    """Unmodelled effects: bias instability and g-sensitivity, each switched on alone."""
    count = max(10, int(300 * n))
    table = _table(f"rms of error over reported sigma with one more effect, {count} draws")
    sensitivity = {"navigation": 0.002, "tactical": 0.1, "industrial": 1.0}
    for grade in GRADES:
        g_sensitivity = sensitivity[grade] * DEG_PER_H / STANDARD_GRAVITY_M_S2
        for label, unit in (
            ("bias instability, stated", {"instability": True}),
            ("bias instability, not stated", {"instability": True, "state_noise": False}),
            (f"g-sensitivity {sensitivity[grade]} °/h/g", {"g_sensitivity": g_sensitivity}),
        ):
            trials = run(
                partial(accuracy_trials.noisy_trial, grade=grade, **unit), range(1000, 1000 + count), workers=workers
            )
            ratio = np.mean(normalised(trials) ** 2, axis=0)
            table.add_row(f"{grade}, {label}", *_by_group(ratio), f"{np.mean([t.nees for t in trials]):.2f}")
    console.print(table)


def free(n: float, workers: int) -> None:
    """Free recordings: NEES of simulated hand-turned units."""
    trials = run(accuracy_trials.free_trial, range(3000, 3000 + max(10, int(300 * n))), workers=workers)
    nees = np.array([t.nees for t in trials])
    expected = np.sqrt(2.0 / 27.0 / len(nees))
    summary("free recordings", trials, f", NEES/27 {nees.mean():.3f} ± {expected:.3f} (one standard error)")


STUDIES = {f.__name__: f for f in (exact, fixture, large, sigmas, honesty, free)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", default=list(STUDIES), metavar="study", help=", ".join(STUDIES))
    parser.add_argument("--fraction", type=float, default=1.0)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    for name in arguments.studies:
        console.rule(f"{name}: {(STUDIES[name].__doc__ or '').strip()}")
        STUDIES[name](arguments.fraction, arguments.workers)


if __name__ == "__main__":
    main()
