"""Estimators on a fixture that is as stated: errors over the Cramér-Rao bound, NEES, false accusations, disagreements.

``python benchmarks/fixture_study.py --moves recorded --non-orthogonality-mrad 0 1 3 --rotation-mrad 0.05 0.3 1
--units 200`` prints a Markdown table with one row for each grade, angle between the fixture's axes and accuracy of the
rotations. Alignment is known to 1 mrad, the wobble is a hundredth of the rotations. Seeds are consecutive. A second
table has the rms errors by parameter group, and the bound.

Exits with 1 if a figure of the Kalman filter or the factor graph lies beyond its limit by more than chance.
"""

import argparse
import sys
from collections.abc import Iterator
from functools import partial
from itertools import product
from typing import Any, Final, NamedTuple

import accuracy_trials
import numpy as np
from efficiency import ESTIMATORS, bound_si
from scipy.special import ndtri
from scipy.stats import binom, chi2
from studies import markdown

import srt
from srt.comparison.estimator_comparison import compare
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, N_PARAMETERS

EFFICIENT: Final = ("ekf", "graph")
"""Estimators that the limits apply to."""
LARGEST_RATIO: Final = 1.03
"""Largest rms of the errors over the bound, pooled over parameters and units."""
ACCUSED_SHARE: Final = 0.01
"""Largest share of sound units that may be told that a sequence contradicts the others."""
DISAGREEING_SHARE: Final = 0.015
"""Largest share of sound units for which the comparison may find a disagreement."""
CHANCE: Final = 0.01
"""Probability that an estimator within its limits is refused, over the whole table."""
SAMPLE_RATE_HZ: Final = 50.0


class Cell(NamedTuple):
    """Conditions of one row of the table."""

    grade: str
    non_orthogonality_mrad: float
    rotation_mrad: float
    moves: str


class UnitResult(NamedTuple):
    """Errors over the bound (estimators, 27), NEES by estimator, accusations by estimator, and disagreement."""

    ratio: Any
    nees: tuple[float, ...]
    accused: tuple[bool, ...]
    disagree: bool


def bound_of(cell: Cell) -> Any:
    """Cramér-Rao bound of all parameters, SI."""
    return bound_si(cell.grade, 1e-3 * cell.rotation_mrad, cell.moves)


def unit(seed: int, *, cell: Cell) -> UnitResult:
    """Calibrate one unit by all estimators, and compare them."""
    recording, truth = accuracy_trials.fixture_recording(
        seed,
        cell.grade,
        non_orthogonality_rad=1e-3 * cell.non_orthogonality_mrad,
        rotation_sigma_rad=1e-3 * cell.rotation_mrad,
        moves=cell.moves,
        sample_rate_hz=SAMPLE_RATE_HZ,
    )
    found = {name: srt.calibrate(recording, name, checks=False) for name in ESTIMATORS}
    error = np.array([calibration.errors.vector - truth.vector for calibration in found.values()])
    nees = tuple(N_PARAMETERS * accuracy_trials.score(calibration, truth).nees for calibration in found.values())
    accused = tuple(calibration.status == "inconsistent" for calibration in found.values())
    return UnitResult(error / bound_of(cell), nees, accused, not compare(found).agree)


class CellResult:
    """Figures of one row of the table."""

    def __init__(self, cell: Cell, units: list[UnitResult]) -> None:
        self.cell, self.units = cell, len(units)
        self.ratio = np.sqrt(np.mean([u.ratio**2 for u in units], axis=(0, 2)))
        self.nees = np.mean([u.nees for u in units], axis=0)
        self.accused = np.sum([u.accused for u in units], axis=0)
        self.disagree = sum(u.disagree for u in units)
        error = np.array([u.ratio for u in units]) * (bound_of(cell) * np.array(DISPLAY_FACTORS))
        self.square = np.mean(error**2, axis=0)

    def row(self) -> list[str]:
        """Cells of the Markdown table."""
        c = self.cell
        figures = [
            f"{r:.3f}, {n / N_PARAMETERS:.3f}, {a}" for r, n, a in zip(self.ratio, self.nees, self.accused, strict=True)
        ]
        return [c.grade, f"{c.non_orthogonality_mrad:g}", f"{c.rotation_mrad:g}", *figures, str(self.disagree)]

    def errors(self) -> Iterator[list[str]]:
        """Rows of the Markdown table of errors: rms by parameter group, of the bound and of every estimator."""
        bound = (bound_of(self.cell) * np.array(DISPLAY_FACTORS)) ** 2
        for name, square in zip(("bound", *ESTIMATORS), (bound, *self.square), strict=True):
            rms = [f"{np.sqrt(np.mean(square[group])):.3g}" for group in GROUP_SLICES.values()]
            yield [*self.row()[:3], name, *rms]

    def failures(self, tests: int) -> Iterator[str]:
        """Limits that are not met, in sentences; ``tests`` is their number over the whole table."""
        chance, n = CHANCE / tests, self.units
        where = " ".join(map(str, self.cell))
        freedom = n * N_PARAMETERS
        band = [float(x) / n for x in chi2.ppf([0.5 * chance, 1.0 - 0.5 * chance], freedom)]
        # The rms of n errors has a relative standard error of 1/√(2 n).
        largest = LARGEST_RATIO * (1.0 - float(ndtri(chance)) / np.sqrt(2.0 * freedom))
        for name in EFFICIENT:
            i = ESTIMATORS.index(name)
            if self.ratio[i] > largest:
                yield f"{where}, {name}: the errors are {self.ratio[i]:.3f} times the bound, above {largest:.3f}"
            if not band[0] < self.nees[i] < band[1]:
                yield f"{where}, {name}: NEES is {self.nees[i]:.1f}, outside {band[0]:.1f} to {band[1]:.1f}"
            if self.accused[i] > binom.isf(chance, n, ACCUSED_SHARE):
                yield f"{where}, {name}: a sequence is accused in {self.accused[i]} of {n} units"
        if self.disagree > binom.isf(chance, n, DISAGREEING_SHARE):
            yield f"{where}: the estimators disagree in {self.disagree} of {n} units"


def study(cells: list[Cell], units: int, seed: int, workers: int) -> Iterator[CellResult]:
    """Results of the cells, one after the other."""
    for cell in cells:
        yield CellResult(
            cell, accuracy_trials.run(partial(unit, cell=cell), range(seed, seed + units), workers=workers)
        )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grades", nargs="+", default=list(accuracy_trials.GRADES))
    parser.add_argument("--non-orthogonality-mrad", nargs="+", type=float, default=[0.0, 1.0, 3.0])
    parser.add_argument("--rotation-mrad", nargs="+", type=float, default=[0.05, 0.3, 1.0])
    parser.add_argument("--moves", choices=("recorded", "skipped"), default="skipped")
    parser.add_argument("--units", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    a = parser.parse_args(arguments)
    cells = [Cell(*c, a.moves) for c in product(a.grades, a.non_orthogonality_mrad, a.rotation_mrad)]
    tests = len(cells) * (3 * len(EFFICIENT) + 1)
    heads = ["grade", "axes, mrad from square", "rotations, mrad", *ESTIMATORS, "disagree"]
    print(f"{a.units} units each, moves {a.moves}, seeds from {a.seed}. Rms over bound, NEES / 27, accused.\n")
    print(*markdown(heads, (), len(heads)), sep="\n")
    failures, errors = [], []
    for result in study(cells, a.units, a.seed, a.workers):
        print("| " + " | ".join(result.row()) + " |", flush=True)
        failures += result.failures(tests)
        errors += result.errors()
    groups = [f"{name}, {DISPLAY_UNITS[part.start]}" for name, part in GROUP_SLICES.items()]
    print("", *markdown((*heads[:3], "estimator", *groups), errors, 4), sep="\n")
    print("\n" + ("\n".join(failures) or "All limits are met."))
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
