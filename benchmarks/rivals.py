"""Our estimators beside imucal's Ferraris calibration, on the same simulated units and fixtures.

``python benchmarks/rivals.py`` calibrates 20 tactical units on fixtures of 0.1, 1 and 5 mrad: by the 17 sequences with
four estimators, and by faces and full turns of the same total time with imucal, which also gets those samples of the 17
sequences that fit its method. Every unit comes with and without asymmetry, which imucal does not know. ``--units N``
takes that many, ``--markdown docs/rivals.md`` writes the page that is committed. It needs
pip install 'strapdown-rotation-test[all,benchmark]'.
"""

import os

# One thread: the matrices are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from accuracy_trials import GRADES, SITE, fixture_errors, normal_errors
from ferraris import (
    TABLE_1_FACES,
    TABLE_1_TURN_RAD,
    TABLE_1_TURNS,
    TURN_RAD,
    TURNS_PER_AXIS,
    Take,
    face_seconds,
    ferraris_motions,
    imucal_errors,
    non_orthogonality,
    signal_regions,
)
from rich.console import Console
from rich.table import Table

import srt
from sims.physics.imu import accel_matrix, read_out
from sims.physics.motion import RateProfile
from sims.physics.table_motion import table1_motion
from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from srt.exceptions import SrtError
from srt.recording.atomic_file import atomic_write_text
from srt.recording.recording import Fixture
from srt.sensor_errors import DISPLAY_FACTORS, GROUP_SLICES, SensorErrors

console = Console(width=180)

GRADE = "tactical"
FIXTURES_RAD = (1e-4, 1e-3, 5e-3)
"""1-sigma errors of the fixtures: a precise one, the paper's, a bench."""
SAMPLE_RATE_HZ = 100.0
DWELL_S = 10.0
"""Length of every stationary window, s, as in the paper."""
FIRST_SEED = 60_000
"""Seed of the first unit: apart from the seeds of the other studies."""
ASYMMETRIES = ("gyro_asymmetry", "accel_asymmetry")
ESTIMATORS: dict[str, tuple[str, dict[str, Any]]] = {
    "closed-form": ("closed-form", {}),
    "least-squares": ("least-squares", {}),
    "ekf": ("ekf", {}),
    "graph": ("graph", {}),
    "graph, asymmetry fixed": ("graph", {"hold": ASYMMETRIES}),
}
"""Our estimators and their options. The last one assumes no asymmetry, as imucal does."""
HELD, IMUCAL, IMUCAL_SAME = "graph, asymmetry fixed", "imucal", "imucal, same samples"
METHODS = (*ESTIMATORS, IMUCAL, IMUCAL_SAME)
ASYMMETRY_NOT_ESTIMATED = (HELD, IMUCAL, IMUCAL_SAME)
POPULATIONS = {
    "no asymmetry": METHODS,
    "asymmetry 1e-3": tuple(m for m in METHODS if m != HELD),  # its assumption is wrong there
}
"""Units, and the methods that calibrate them."""
AXES_APART = slice(27, 30)
"""Rows of the accelerometer non-orthogonality, after the 27 parameters."""
ROWS = {
    "gyro scale, ppm": GROUP_SLICES["gyro_scale"],
    "gyro asymmetry, ppm": GROUP_SLICES["gyro_asymmetry"],
    "gyro orthogonality, µrad": GROUP_SLICES["gyro_orthogonality"],
    "gyro bias, °/h": GROUP_SLICES["gyro_bias"],
    "accelerometer scale, ppm": GROUP_SLICES["accel_scale"],
    "accelerometer asymmetry, ppm": GROUP_SLICES["accel_asymmetry"],
    "accelerometer misalignment, µrad": GROUP_SLICES["accel_misalignment"],
    "accelerometer orthogonality, µrad": AXES_APART,
    "accelerometer bias, µg": GROUP_SLICES["accel_bias"],
}
"""Parameter groups. Orthogonality of the accelerometers is the part of their misalignment that depends on no frame."""
ASYMMETRY_ROWS = ("gyro asymmetry, ppm", "accelerometer asymmetry, ppm")
PROFILE = RateProfile(1.0, 10.0)
"""Rotations of the fixture: 1 rad/s, 10 rad/s²."""


@dataclass(slots=True)
class UnitErrors:
    """Errors by method, each of shape (30,) in the units of the tables; seconds of one core; statuses."""

    errors: dict[str, np.ndarray] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    statuses: Counter[str] = field(default_factory=Counter)

    def add(self, method: str, truth: SensorErrors, calibrate: Callable[[], Any]) -> None:
        began = time.process_time()
        result = calibrate()
        self.seconds[method] = time.process_time() - began
        found = result if isinstance(result, SensorErrors) else result.errors
        if found is not result:
            self.statuses[f"{method} {result.status}"] += 1
        apart = non_orthogonality(accel_matrix(found)) - non_orthogonality(accel_matrix(truth))
        self.errors[method] = np.concatenate([(found.vector - truth.vector) * DISPLAY_FACTORS, 1e6 * apart])


@dataclass(frozen=True, slots=True)
class Durations:
    """Seconds recorded, by the 17 sequences and by Ferraris' method, and of each of its faces."""

    table_1: float
    ferraris: float
    face: float


def unit(seed: int, sigma_rad: float) -> tuple[dict[str, UnitErrors], Durations]:
    """Calibrate one unit, with and without its asymmetry, on a fixture with errors of one sigma.

    A seed is one unit, one gravity and one draw of the fixture's errors, which ``sigma_rad`` makes larger or smaller.
    """
    for_unit, for_fixture, for_ferraris, for_noise = np.random.default_rng(seed).spawn(4)
    drawn = normal_errors(for_unit, 1e-3, 10.0 * DEG_PER_H)
    true_site = replace(SITE, gravity_m_s2=SITE.gravity_m_s2 + for_unit.standard_normal() * SITE.gravity_sigma_m_s2)
    fixture = fixture_errors(for_fixture, sigma_rad)
    motion = table1_motion(
        site=true_site,
        rate_rad_s=PROFILE.rate_rad_s,
        accel_rad_s2=PROFILE.accel_rad_s2,
        dwell_s=DWELL_S,
        sample_rate_hz=SAMPLE_RATE_HZ,
        fixture_draw=fixture,
        stated_fixture=Fixture(0.0, sigma_rad, sigma_rad),
    ).stated_as(site=SITE)
    table_1_s = len(motion.time) / SAMPLE_RATE_HZ
    face_s = math.floor(face_seconds(table_1_s, PROFILE))
    ferraris = ferraris_motions(
        site=true_site,
        face_s=face_s,
        profile=PROFILE,
        sample_rate_hz=SAMPLE_RATE_HZ,
        fixture_draw=fixture,
        rotation_sigma_rad=sigma_rad,
        rng=for_ferraris,
    )
    noise_seeds = for_noise.integers(2**63, size=3)
    outcomes = {}
    for population, methods in POPULATIONS.items():
        truth = without_asymmetry(drawn) if HELD in methods else drawn
        # The same noise for both populations, so that nothing but the asymmetry makes a difference.
        recording, *takes = (
            read_out(m, truth, GRADES[GRADE], np.random.default_rng(s))
            for m, s in zip((motion, *ferraris), noise_seeds, strict=True)
        )
        outcome = outcomes[population] = UnitErrors()
        for method in filter(ESTIMATORS.get, methods):
            name, options = ESTIMATORS[method]
            outcome.add(method, truth, lambda r=recording, n=name, o=options: srt.calibrate(r, n, checks=False, **o))
        own = signal_regions(
            *(Take(r, m.windows) for r, m in zip(takes, ferraris, strict=True)),
            face_s=face_s,
        )
        take = Take(recording, motion.windows)
        same = signal_regions(take, take, face_s=2.0 * DWELL_S, face_picks=TABLE_1_FACES, turn_picks=TABLE_1_TURNS)
        for method, regions, turn_rad in ((IMUCAL, own, TURN_RAD), (IMUCAL_SAME, same, TABLE_1_TURN_RAD)):
            known = {"sample_rate_hz": SAMPLE_RATE_HZ, "gravity_m_s2": SITE.gravity_m_s2, "turn_rad": turn_rad}
            outcome.add(method, truth, lambda r=regions, k=known: imucal_errors(r, **k))
    turning_s = sum(len(own[f"gyr_{axis}_rot"]) for axis in "xyz") / SAMPLE_RATE_HZ
    flips_s = 3.0 * PROFILE.duration_s(math.pi)
    return outcomes, Durations(table_1_s, 6.0 * face_s + turning_s + flips_s, face_s)


def without_asymmetry(errors: SensorErrors) -> SensorErrors:
    vector = errors.vector.copy()
    for group in ASYMMETRIES:
        vector[GROUP_SLICES[group]] = 0.0
    return SensorErrors(vector)


@dataclass(slots=True)
class Study:
    """Outcomes of all units by population and fixture, and how long each of the two tests took."""

    units: int
    fixtures_rad: tuple[float, ...] = FIXTURES_RAD
    outcomes: dict[tuple[str, float], list[UnitErrors]] = field(default_factory=dict)
    durations: Durations | None = None

    def run(self, report: Callable[[str], None]) -> None:
        began = time.monotonic()
        for sigma_rad in self.fixtures_rad:
            for seed in range(FIRST_SEED, FIRST_SEED + self.units):
                found, self.durations = unit(seed, sigma_rad)
                for population, outcome in found.items():
                    self.outcomes.setdefault((population, sigma_rad), []).append(outcome)
            report(f"{1e3 * sigma_rad:g} mrad: {self.units} units, {time.monotonic() - began:.0f} s since the start")

    def rms(self, population: str, sigma_rad: float, method: str, row: str) -> float:
        """Rms error of a group's parameters over all units; NaN for parameters that a method does not estimate."""
        if method in ASYMMETRY_NOT_ESTIMATED and row in ASYMMETRY_ROWS:
            return math.nan
        errors = [o.errors[method][ROWS[row]] for o in self.outcomes[population, sigma_rad]]
        return float(np.sqrt(np.mean(np.square(errors))))

    def ratio(self, population: str, sigma_rad: float, row: str, *, over: str, method: str = IMUCAL) -> float:
        """Rms of one method over that of another."""
        return self.rms(population, sigma_rad, method, row) / self.rms(population, sigma_rad, over, row)

    def milliseconds(self, method: str) -> float:
        """Median time of one calibration."""
        seconds = [o.seconds[method] for some in self.outcomes.values() for o in some if method in o.seconds]
        return 1e3 * float(np.median(seconds))

    def not_converged(self) -> str:
        """Results of our estimators with another status than converged; fixed parameters make it partial."""
        total: Counter[str] = Counter()
        for some in self.outcomes.values():
            for outcome in some:
                total.update(outcome.statuses)
        expected = {f"{m} {'partial' if m == HELD else 'converged'}" for m in ESTIMATORS}
        return ", ".join(f"{name} {n}" for name, n in total.items() if name not in expected) or "none"

    def table(self, population: str) -> Iterator[list[str]]:
        """Rows of a population's table: fixture, group, rms by method."""
        for sigma_rad in self.fixtures_rad:
            for row in ROWS:
                rms = (self.rms(population, sigma_rad, method, row) for method in POPULATIONS[population])
                yield [f"{1e3 * sigma_rad:g} mrad", row, *map(figure, rms)]

    def ratio_columns(self) -> tuple[str, ...]:
        return ("over closed form / over graph", *(f"{1e3 * s:g} mrad" for s in self.fixtures_rad))

    def ratio_table(self, population: str, method: str = IMUCAL) -> Iterator[list[str]]:
        """Rows of a short table: group, then for every fixture the ratio over closed form, and over graph."""
        for row in ROWS:
            if row not in ASYMMETRY_ROWS:
                pairs = (
                    [self.ratio(population, s, row, over=ours, method=method) for ours in ("closed-form", "graph")]
                    for s in self.fixtures_rad
                )
                yield [row.split(",")[0], *(" / ".join(figure(r, digits=2) for r in pair) for pair in pairs)]


COLUMNS = {population: ("fixture", "rms error of", *methods) for population, methods in POPULATIONS.items()}


def figure(value: float, digits: int = 3) -> str:
    """Text of a number with this many digits, without an exponent; a dash for NaN."""
    if math.isnan(value):
        return "–"
    rounded = float(f"{value:.{digits}g}")
    decimals = digits - 1 - (math.floor(math.log10(rounded)) if rounded > 0.0 else 0)
    return f"{rounded:.{max(0, decimals)}f}"


def shown(title: str, columns: tuple[str, ...], rows: Iterator[list[str]], *, text_columns: int = 1) -> Table:
    table = Table(title=title)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < text_columns else "right")
    last = None
    for cells in rows:
        if text_columns > 1 and last not in (None, cells[0]):
            table.add_section()
        last = cells[0]
        table.add_row(*cells)
    return table


def markdown_table(columns: tuple[str, ...], rows: Iterator[list[str]], *, text_columns: int = 1) -> str:
    rule = "|" + "---|" * text_columns + "---:|" * (len(columns) - text_columns)
    return "\n".join(["| " + " | ".join(columns) + " |", rule, *("| " + " | ".join(cells) + " |" for cells in rows)])


def versions() -> str:
    names = ("imucal", "pandas", "numpy", "scipy", "filterpy", "gtsam")
    return ", ".join(f"{name} {version(name)}" for name in names)


def markdown(study: Study) -> str:
    assert study.durations is not None
    imu = GRADES[GRADE]
    tables = {
        f"ratios_{i}": markdown_table(study.ratio_columns(), study.ratio_table(p)) for i, p in enumerate(POPULATIONS)
    }
    tables |= {
        f"rms_{i}": markdown_table(COLUMNS[p], study.table(p), text_columns=2) for i, p in enumerate(POPULATIONS)
    }
    return PAGE.format(
        units=study.units,
        grade=GRADE,
        gyro_noise=imu.gyro_noise / DEG_PER_SQRT_H,
        accel_noise=imu.accel_noise / MICRO_G,
        rate=SAMPLE_RATE_HZ,
        table_1_s=study.durations.table_1,
        dwell_s=DWELL_S,
        face_s=study.durations.face,
        turns=TURNS_PER_AXIS,
        ferraris_s=study.durations.ferraris,
        times="\n".join(f"| {m} | {figure(study.milliseconds(m), digits=2)} |" for m in METHODS),
        standard_error=100.0 / math.sqrt(2.0 * 3.0 * study.units),
        not_converged=study.not_converged(),
        versions=versions(),
        **tables,
    )


PAGE = """\
# Comparison with another calibration method

[imucal](https://github.com/mad-lab-fau/imucal) computes Ferraris' calibration: six stationary faces, and full turns
about three axes. It takes the fixture as exact, so that the errors of the fixture become errors of the result. The
rotation test does not.

Rms error of imucal over that of this package, {units} units without asymmetry on each fixture (below 1, imucal is
more accurate):

{ratios_0}

The same for units with an asymmetry of 1e-3, which imucal does not model:

{ratios_1}

## Set-up

- **Units**: grade `{grade}` of `benchmarks/accuracy_trials.py` (gyros {gyro_noise:.4f} °/√h, accelerometers
  {accel_noise:.0f} µg/√Hz, white noise only), every error drawn with a sigma of 1e-3 (accelerometer biases 1 mg),
  gyro biases within ±10 °/h; {rate:g} Hz. Each unit is simulated with and without its asymmetry, with the same noise.
- **Fixture**: two axes, square to each other; 1-sigma errors in levelling, north, mounting and every rotation and
  start angle. A unit has the same draw on all fixtures, scaled, and the same levelling, north and mounting in both
  tests; the errors of the rotations are drawn separately. Latitude 45°, table x north, gravity known to 5e-6 m/s².
- **Rotation test**: the 17 sequences once, {table_1_s:.0f} s recorded, windows of {dwell_s:g} s; default options, so
  that asymmetries are estimated in both populations. "graph, asymmetry fixed" assumes no asymmetry, as imucal does,
  for the units that have none.
- **imucal**: six faces of {face_s:g} s and {turns} full turns about each axis, {ferraris_s:.0f} s with the half turns
  between faces. It gets the same gravity as the rotation test, the exact samples of every region, and the nominal
  angle.
- **imucal, same samples**: the part of the 17 sequences that suits its method: windows before and after sequences 7
  to 12 as faces (two windows of {dwell_s:g} s each), sequences 2, 1 and 3 as turns of 360°. The estimators of this
  package use these samples too.

imucal's result has the fixture's axes. Its polar decomposition takes it to MARS axes, in which the gyro matrix is
symmetric (`benchmarks/ferraris.py`), so that a rotation of the whole unit on the fixture does not count as an error.
The orthogonality rows do not depend on the axes. On a perfect fixture, without noise and without Earth rate, its
result equals the truth to rounding (`tests/sims/test_rivals.py`).

## Fairness

- imucal is made for quick calibration of low-cost units, by hand or on a turntable. For such a unit 1 mrad is
  negligible. With an exact fixture its result is correct.
- For units without asymmetry, imucal may be more accurate in accelerometer bias and scale factor. Level errors have a
  second-order effect there, it need not separate a bias from an asymmetry, and all its stationary time is in six
  faces. "graph, asymmetry fixed" shows the part of this that follows from the assumption of no asymmetry.
- For units with an asymmetry, imucal's gyro scale factors have an error equal to it, and its accelerometer biases g
  times it.
- imucal omits the Earth rate. The faces and turns are arranged to make its effect small: the outer axis points east,
  faces come in pairs half a turn apart, those of z at two headings; an error of 0.3 µrad remains on a perfect
  fixture. In the samples of the 17 sequences the turn about z has the north component of the Earth rate along it: 52
  ppm of z scale factor.
- imucal's guide turns each axis while it is vertical. This fixture can do so with z only; x and y turn about the
  horizontal outer axis. The method uses only the angle.
- {turns} turns instead of the usual one divide the effect of an angle error on a gyro scale factor by {turns}.
- The accuracy of this package is limited by the unit's noise here, not by the fixture: the ratios are larger for a
  better unit and smaller for a worse one.

## Units without asymmetry

Rms errors:

{rms_0}

## Units with an asymmetry of 1e-3

{rms_1}

The standard error of an rms of three independent parameters is {standard_error:.0f} %; many share a fixture error.

## Time, versions, command

Median time of one calibration on one core, samples in memory:

| method | ms |
|---|---:|
{times}

Results of this package with another status than converged (partial with asymmetries fixed): {not_converged}.

Versions: {versions}.

    pip install 'strapdown-rotation-test[all,benchmark]'
    python benchmarks/rivals.py --units {units} --markdown docs/rivals.md
"""


def positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} units were asked for; ask for at least 1")
    return value


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=positive, default=20, help="on every fixture (default 20)")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables to this file")
    arguments = parser.parse_args()
    study = Study(arguments.units)
    try:
        study.run(console.print)
        for population in POPULATIONS:
            title = f"units with {population}: rms error over {study.units} units"
            console.print(shown(title, COLUMNS[population], study.table(population), text_columns=2))
        for population in POPULATIONS:
            for method in (IMUCAL, IMUCAL_SAME):
                title = f"{method}, over ours: units with {population}"
                console.print(shown(title, study.ratio_columns(), study.ratio_table(population, method)))
        console.print("time of one: " + ", ".join(f"{m} {figure(study.milliseconds(m), digits=2)} ms" for m in METHODS))
        console.print(f"{study.durations}; another status than expected: {study.not_converged()}; {versions()}")
        if arguments.markdown is not None:
            atomic_write_text(arguments.markdown, markdown(study))
    except SrtError as error:
        console.print(str(error))
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
