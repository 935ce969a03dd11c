"""How near the estimators come to the Cramér-Rao bound, and what the closed form leaves: docs/design/efficiency.md.

``python benchmarks/efficiency.py`` runs 2,000 units of each grade; ``--units N`` that many, ``--grade NAME`` (which may
be repeated) one grade, ``--workers N`` in so many processes. Last comes, for each grade, what the closed form would
gain from the components that it does not read. The exit code is 1 if a criterion is missed.
"""

import os

# One thread for each process, their children included: the matrices are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import argparse
import math
import sys
import time
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from sims.accuracy import efficiency
from sims.accuracy.campaigns import GRADES, IN_G, SITE, run
from sims.accuracy.efficiency import ESTIMATORS, STANDARD_ERRORS, Criterion, Efficiency, Unit
from sims.physics.imu import read_out
from sims.physics.table_motion import table1_motion
from srt.estimation.closed_form_solver import ClosedFormSolver
from srt.estimation.initial_estimates import first_estimate
from srt.estimation.iteration import iterate
from srt.estimation.least_squares_solver import LeastSquaresSolver
from srt.estimation.options import Options
from srt.recording.recording import Fixture
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, SYMBOLS, SensorErrors
from srt.sequences.preparation import open_session

console = Console(width=150)
BATCH = 200
FIRST_SEED = {grade: 10_000 * (1 + i) for i, grade in enumerate(GRADES)}


def study(grade: str, count: int, workers: int) -> list[Unit]:
    """Units in batches, with a line after each."""
    units: list[Unit] = []
    began = time.monotonic()
    while len(units) < count:
        first = FIRST_SEED[grade] + len(units)
        seeds = range(first, first + min(BATCH, count - len(units)))
        units += run(partial(efficiency.unit, grade=grade), seeds, workers=workers)
        found, claims = efficiency.summarise(grade, units)
        spent = time.monotonic() - began
        means = ", ".join(f"{name} {e.mean:.3f}" for name, e in found.items())
        missed = sum(not c.holds for c in claims)
        console.print(
            f"{grade}: {len(units)} of {count} units, {spent:.0f} s, {spent * (count / len(units) - 1.0):.0f} s to go; "
            f"mean rms / bound {means}; {missed} criteria missed"
        )
    return units


def parameters(grade: str, found: dict[str, Efficiency]) -> Table:
    count = next(iter(found.values())).units
    table = Table(
        title=f"{grade}, {count} units: rms of error and own sigma over the bound "
        f"(standard error of an rms {100.0 / (2.0 * count) ** 0.5:.1f} %)"
    )
    table.add_column("parameter")
    table.add_column("bound, 1 sigma", justify="right")
    for name in found:
        table.add_column(f"{name}\nrms", justify="right")
        table.add_column("\nsigma", justify="right")
    bound = efficiency.bound_sigma(grade) * IN_G
    for i, symbol in enumerate(SYMBOLS):
        ratios = (f"{value[i]:.3f}" for e in found.values() for value in (e.rms, e.own))
        table.add_row(symbol, f"{bound[i] * DISPLAY_FACTORS[i]:#.3g} {DISPLAY_UNITS[i]}", *ratios)
    table.add_section()
    means = (f"{value.mean():.3f}" for e in found.values() for value in (e.rms, e.own))
    table.add_row("mean", "", *means)
    return table


def limits(criterion: Criterion) -> str:
    low, high = criterion.low, criterion.high
    if low == high:
        return f"{low:g}"
    if math.isinf(low) or math.isinf(high):
        return f"at most {high:g}" if math.isinf(low) else f"at least {low:g}"
    return f"{low:g} to {high:g}"


def judged(grade: str, claims: list[Criterion]) -> Table:
    table = Table(title=f"{grade}: criteria; a limit may be passed by {STANDARD_ERRORS} standard errors")
    for column in ("criterion", "value", "standard error", "limits", "holds"):
        table.add_column(column, justify="left" if column == "criterion" else "right")
    for c in claims:
        table.add_row(c.name, f"{c.value:.4f}", f"{c.standard_error:.4f}", limits(c), "yes" if c.holds else "NO")
    return table


def by_components(grade: str) -> Table:
    """Sigma over the bound from more and more of the 68 components, about a unit and a fixture without errors."""
    motion = table1_motion(site=SITE, sample_rate_hz=100.0, stated_fixture=Fixture(0.0, 1e-3, 1e-3))
    recording = read_out(motion, SensorErrors(), GRADES[grade], np.random.default_rng(FIRST_SEED[grade]))
    options = Options()
    data = open_session(recording, recording.sequences, options.average)
    solution = iterate(data, options, LeastSquaresSolver(()), *first_estimate(data, options))
    H, R = solution.playback.H, solution.measurement_covariance

    def sigma(read: np.ndarray) -> np.ndarray:
        A = np.linalg.solve(np.linalg.cholesky(R[np.ix_(read, read)]), H[read])
        scale = np.linalg.norm(A, axis=0)
        return np.sqrt(np.diag(np.linalg.inv((A / scale).T @ (A / scale)))) / scale

    # Two horizontal components of every sequence, Down of every window, and the pooled rest rate, which all have.
    place = np.arange(len(R))
    horizontal, rest = place < 2 * data.K, place >= len(R) - 3
    own = ClosedFormSolver(data, options).selection.any(axis=0)
    columns = {
        "closed form's 24": own,
        "and all Down": own | ~horizontal,
        "and all horizontal": own | horizontal | rest,
        "all 68": np.ones_like(own),
    }
    table = Table(title=f"{grade}: sigma over the bound, by components read")
    for column in ("parameter", *columns):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    bound = efficiency.bound_sigma(grade) * IN_G
    ratios = np.array([sigma(np.flatnonzero(read)) / bound for read in columns.values()])
    for symbol, row in zip(SYMBOLS, ratios.T, strict=True):
        table.add_row(symbol, *(f"{ratio:.3f}" for ratio in row))
    return table


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=2000, help="of each grade (default 2000)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--grade", action="append", choices=list(GRADES))
    arguments = parser.parse_args()
    missed = 0
    for grade in arguments.grade or GRADES:
        console.rule(f"{grade}: {', '.join(ESTIMATORS)}")
        found, claims = efficiency.summarise(grade, study(grade, arguments.units, arguments.workers))
        console.print(parameters(grade, found))
        console.print(judged(grade, claims))
        console.print(by_components(grade))
        missed += sum(not c.holds for c in claims)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
