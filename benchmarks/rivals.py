"""Our estimators beside imucal's Ferraris calibration, on the same simulated units and fixtures.

``python benchmarks/rivals.py`` calibrates 20 tactical units on fixtures of 0.1, 1 and 5 mrad: by the 17 sequences with
four estimators, and by faces and full turns of the same total time with imucal, which also gets those samples of the 17
sequences that fit its method. Every unit comes with and without asymmetry, which imucal does not know. ``--units N``
takes that many, ``--markdown FILE`` replaces the tables of docs/rivals.md. It needs
pip install 'strapdown-rotation-test[all,benchmark]'.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
from accuracy_trials import GRADES, SITE, fixture_errors, normal_errors
from ferraris import (
    TABLE_1_FACES,
    TABLE_1_TURN_RAD,
    TABLE_1_TURNS,
    TURN_RAD,
    Take,
    face_seconds,
    ferraris_motions,
    imucal_errors,
    non_orthogonality,
    signal_regions,
)
from studies import figure, markdown, replace_tables

import srt
from sims.physics.fixture import FixtureDraw
from sims.physics.imu import accel_matrix, read_out
from sims.physics.motion import RateProfile
from sims.physics.table_motion import table1_motion
from sims.physics.true_motion import TrueMotion
from srt.constants import DEG_PER_H
from srt.recording.recording import Fixture, Recording, Site
from srt.sensor_errors import DISPLAY_FACTORS, GROUP_SLICES, SensorErrors

IMU = GRADES["tactical"]
FIXTURES_RAD = (1e-4, 1e-3, 5e-3)
"""1-sigma errors of the fixtures: a precise one, the paper's, a bench."""
SAMPLE_RATE_HZ = 100.0
DWELL_S = 10.0
"""Length of every stationary window, s, as in the paper."""
FIRST_SEED = 60_000
"""Seed of the first unit: apart from the seeds of the other studies."""
ASYMMETRIES = ("gyro_asymmetry", "accel_asymmetry")
HELD, IMUCAL, IMUCAL_SAME = "graph, asymmetry fixed", "imucal", "imucal, same samples"
ESTIMATORS: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {}) for name in ("closed-form", "least-squares", "ekf", "graph")},
    HELD: ("graph", {"hold": ASYMMETRIES}),
}
"""Our estimators and their options. The last one assumes no asymmetry, as imucal does."""
METHODS = (*ESTIMATORS, IMUCAL, IMUCAL_SAME)
NO_ASYMMETRY, ASYMMETRIC = "no asymmetry", "asymmetry 1e-3"
POPULATIONS = {NO_ASYMMETRY: METHODS, ASYMMETRIC: tuple(m for m in METHODS if m != HELD)}
"""Units, and the methods that calibrate them: the assumption of no asymmetry is wrong in the second."""
ROWS = {
    "gyro scale, ppm": GROUP_SLICES["gyro_scale"],
    "gyro asymmetry, ppm": GROUP_SLICES["gyro_asymmetry"],
    "gyro orthogonality, µrad": GROUP_SLICES["gyro_orthogonality"],
    "gyro bias, °/h": GROUP_SLICES["gyro_bias"],
    "accelerometer scale, ppm": GROUP_SLICES["accel_scale"],
    "accelerometer asymmetry, ppm": GROUP_SLICES["accel_asymmetry"],
    "accelerometer misalignment, µrad": GROUP_SLICES["accel_misalignment"],
    "accelerometer orthogonality, µrad": slice(27, 30),
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

    def by_imucal(self, truth: SensorErrors, regions: dict, turn_rad: float = TURN_RAD, method: str = IMUCAL) -> None:
        known = {"sample_rate_hz": SAMPLE_RATE_HZ, "gravity_m_s2": SITE.gravity_m_s2, "turn_rad": turn_rad}
        self.add(method, truth, lambda: imucal_errors(regions, **known))

    def by_ours(self, truth: SensorErrors, recording: Recording, names: Iterable[str]) -> None:
        for method in names:
            name, options = ESTIMATORS[method]
            self.add(method, truth, lambda n=name, o=options: srt.calibrate(recording, n, checks=False, **o))


class Durations(NamedTuple):
    """Seconds recorded, by the 17 sequences and by Ferraris' method."""

    table_1: float
    ferraris: float


class Setting(NamedTuple):
    """One unit, one gravity and one draw of the fixture's errors, which ``sigma_rad`` makes larger or smaller."""

    errors: SensorErrors
    site: Site
    fixture: FixtureDraw
    sigma_rad: float
    for_ferraris: np.random.Generator
    for_noise: np.random.Generator

    @classmethod
    def drawn(cls, seed: int, sigma_rad: float) -> "Setting":
        for_unit, for_fixture, *others = np.random.default_rng(seed).spawn(4)
        errors = normal_errors(for_unit, 1e-3, 10.0 * DEG_PER_H)
        gravity = SITE.gravity_m_s2 + for_unit.standard_normal() * SITE.gravity_sigma_m_s2
        site = replace(SITE, gravity_m_s2=gravity)
        return cls(errors, site, fixture_errors(for_fixture, sigma_rad), sigma_rad, *others)

    def ferraris(self, face_s: float) -> tuple[TrueMotion, TrueMotion]:
        """Faces and turns."""
        return ferraris_motions(
            site=self.site, face_s=face_s, profile=PROFILE, sample_rate_hz=SAMPLE_RATE_HZ, fixture_draw=self.fixture,
            rotation_sigma_rad=self.sigma_rad, rng=self.for_ferraris,
        )  # fmt: skip

    def read(self, motions: Iterable[TrueMotion]) -> Iterator[tuple[str, SensorErrors, list[Recording], list[Take]]]:
        """Population, truth, recordings and takes, with the same noise for both populations."""
        motions = list(motions)
        seeds = self.for_noise.integers(2**63, size=len(motions))
        for population in POPULATIONS:
            truth = self.errors if population == ASYMMETRIC else without_asymmetry(self.errors)
            noise = [np.random.default_rng(s) for s in seeds]
            made = [read_out(m, truth, IMU, rng) for m, rng in zip(motions, noise, strict=True)]
            yield population, truth, made, [Take(r, m.windows) for r, m in zip(made, motions, strict=True)]


def unit(seed: int, sigma_rad: float) -> tuple[dict[str, UnitErrors], Durations]:
    """Calibrate one unit, with and without its asymmetry, on a fixture with errors of one sigma."""
    setting = Setting.drawn(seed, sigma_rad)
    motion = table1_motion(
        site=setting.site, rate_rad_s=PROFILE.rate_rad_s, accel_rad_s2=PROFILE.accel_rad_s2, dwell_s=DWELL_S,
        sample_rate_hz=SAMPLE_RATE_HZ, fixture_draw=setting.fixture, stated_fixture=Fixture(0.0, sigma_rad, sigma_rad),
    ).stated_as(site=SITE)  # fmt: skip
    table_1_s = len(motion.time) / SAMPLE_RATE_HZ
    face_s = math.floor(face_seconds(table_1_s, PROFILE))
    outcomes = {}
    for population, truth, (recording, *_), (take, *faces_and_turns) in setting.read(
        (motion, *setting.ferraris(face_s))
    ):
        outcome = outcomes[population] = UnitErrors()
        outcome.by_ours(truth, recording, filter(ESTIMATORS.get, POPULATIONS[population]))
        own = signal_regions(*faces_and_turns, face_s=face_s)
        outcome.by_imucal(truth, own)
        same = signal_regions(take, take, face_s=2.0 * DWELL_S, face_picks=TABLE_1_FACES, turn_picks=TABLE_1_TURNS)
        outcome.by_imucal(truth, same, TABLE_1_TURN_RAD, IMUCAL_SAME)
    turning_s = sum(len(own[f"gyr_{axis}_rot"]) for axis in "xyz") / SAMPLE_RATE_HZ
    return outcomes, Durations(table_1_s, 6.0 * face_s + turning_s + 3.0 * PROFILE.duration_s(math.pi))


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

    def run(self) -> None:
        for sigma_rad in self.fixtures_rad:
            for seed in range(FIRST_SEED, FIRST_SEED + self.units):
                found, self.durations = unit(seed, sigma_rad)
                for population, outcome in found.items():
                    self.outcomes.setdefault((population, sigma_rad), []).append(outcome)

    def rms(self, population: str, sigma_rad: float, method: str, row: str) -> float:
        """Rms error of a group's parameters over all units; NaN for parameters that a method does not estimate."""
        if method in (HELD, IMUCAL, IMUCAL_SAME) and row in ASYMMETRY_ROWS:
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
        expected = {f"{m} {'partial' if m == HELD else 'converged'}" for m in ESTIMATORS}
        statuses = sum((o.statuses for some in self.outcomes.values() for o in some), Counter())
        return ", ".join(f"{name} {n}" for name, n in statuses.items() if name not in expected) or "none"

    def rms_table(self, population: str) -> str:
        """Fixture, group, rms by method."""
        methods = POPULATIONS[population]
        rows = (
            [f"{1e3 * s:g} mrad", row, *(figure(self.rms(population, s, method, row)) for method in methods)]
            for s in self.fixtures_rad
            for row in ROWS
        )
        return "\n".join(markdown(("fixture", "rms error of", *methods), rows, 2))

    def ratio_table(self, population: str, method: str = IMUCAL) -> str:
        """Group, then for every fixture the ratio over closed form, and over graph."""

        def pair(row: str, s: float) -> str:
            ratios = (self.ratio(population, s, row, over=ours, method=method) for ours in ("closed-form", "graph"))
            return " / ".join(figure(r, digits=2) for r in ratios)

        rows = (
            [row.split(",")[0], *(pair(row, s) for s in self.fixtures_rad)] for row in ROWS if row not in ASYMMETRY_ROWS
        )
        return "\n".join(
            markdown(("over closed form / over graph", *(f"{1e3 * s:g} mrad" for s in self.fixtures_rad)), rows)
        )


def versions() -> str:
    names = ("imucal", "pandas", "numpy", "scipy", "filterpy", "gtsam")
    return ", ".join(f"{name} {version(name)}" for name in names)


def tables(study: Study) -> dict[str, str]:
    """Tables of docs/rivals.md by name."""
    times = markdown(("method", "ms"), ([m, figure(study.milliseconds(m), digits=2)] for m in METHODS))
    states = "Results of this package with another status than converged (partial with asymmetries fixed)"
    return {
        **{f"ratios, {p}": study.ratio_table(p) for p in POPULATIONS},
        **{f"errors, {p}": study.rms_table(p) for p in POPULATIONS},
        "times": "\n".join((*times, "", f"{states}: {study.not_converged()}.", "", f"Versions: {versions()}.")),
    }


def main(*, units: int = 20, markdown: Path | None = None) -> None:
    study = Study(units)
    study.run()
    made = tables(study)
    same = {f"{IMUCAL_SAME}, {p}": study.ratio_table(p, IMUCAL_SAME) for p in POPULATIONS}
    print(*(f"{name}\n\n{table}\n" for name, table in (made | same).items()), sep="\n")
    print(study.durations or "")
    if markdown is not None:
        replace_tables(markdown, made)


if __name__ == "__main__":
    harness.run(main, __doc__)
