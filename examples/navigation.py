"""Navigation drift of an aircraft and a car with and without calibration, for units of four grades.

``python examples/navigation.py --out navigation`` draws units as `srt simulate` does, calibrates each by a recorded
rotation test, carries it on two trajectories, and lets an independent navigator (python-ins) integrate its readings
from an exact start. gtsam's preintegration gets the same readings. Set up its environment, and best one of its own, by

    pip install '.[examples]'  # in a clone of the repository

The folder then holds navigation-drift.png and navigation-tables.md. All random numbers follow from ``--seed``.

Readings come in five forms (:data:`FORMS`). Corrected ones are in MARS axes, ``apply(frame="mars")``: these belong to
the gyros themselves, the calibration knows them as well as it knows the gyros, and a navigator that finds its attitude
by its own sensors finds that of these axes. Table axes hang on the fixture's mounting, known to about 1 mrad.
"""

from __future__ import annotations

import os

# One thread: the matrices are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import itertools
import sys
import tempfile
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from preintegration import delta_errors, gtsam_module, preintegrate, segment_starts, true_deltas
from trajectories import START_LLA, VEHICLES, Motion, course_of, motion_of, pyins_modules

import sims
import srt
from sims.physics.true_motion import TrueMotion
from srt.recording.atomic_file import atomic_write_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.types import Array

    Readings = tuple[Array, Array]

GRADES: Final = {
    "navigation": "navigation-rlg",
    "tactical": "tactical-fog",
    "industrial": "industrial-mems",
    "consumer": "consumer-mems",
}
"""Scenario of each grade in the library: the unit, and the fixture on which such a unit is calibrated."""
FORMS: Final = {
    "raw": "as read",
    "raw, zeroed": "as read, minus the mean error of the first 30 s",
    "calibrated": "corrected by the calibration",
    "calibrated, zeroed": "corrected, then zeroed",
    "perfect": "corrected by the unit's true errors: noise and drift remain",
}
MARKS_MIN: Final = (1, 10, 30)
"""Times of the tables, min."""
OUTPUT_S: Final = 20.0
"""Time between two points of a drift curve."""
SEGMENTS_EVERY_S: Final = 60.0
"""Time between the starts of two preintegrated segments, s."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedUnit:
    """Simulated unit and its calibration.

    Attributes
    ----------
    truth : SensorErrors
    imu : sims.ImuModel
        Noise, drift, quantization, range and g-sensitivity.
    calibration : Calibration
        Calibration as loaded from its file.
    """

    truth: srt.SensorErrors
    imu: sims.ImuModel
    calibration: srt.Calibration


@dataclass(slots=True)
class DriftResult:
    """One vehicle and grade: drifts by form, each (times,) per unit; preintegration errors, (segments, 3)."""

    time_s: Array = field(default_factory=lambda: np.zeros(0))
    drifts: dict[str, list[Array]] = field(default_factory=lambda: {form: [] for form in FORMS})
    deltas: dict[str, list[Array]] = field(default_factory=lambda: {form: [] for form in FORMS})

    def at(self, minutes: float, form: str) -> Array:
        """Drift of every unit at a time, m."""
        return np.array([np.interp(60.0 * minutes, self.time_s, drift) for drift in self.drifts[form]])


def calibrated_unit(scenario: str, rng: np.random.Generator, folder: Path) -> CalibratedUnit:
    """Draw a unit, run the rotation test on it, and calibrate it from the recording.

    Parameters
    ----------
    scenario : str
        Name of a scenario of the library.
    rng : numpy.random.Generator
    folder : Path
        Where the calibration is saved and read back, as another program would.

    Raises
    ------
    DataError
        If the calibration does not converge.
    """
    simulation = sims.simulate(sims.load_scenario(scenario), rng)
    calibration = srt.calibrate(simulation.recording)
    if calibration.status != "converged":
        raise srt.DataError(f"A unit of the scenario {scenario} was not calibrated: {calibration.message}")
    calibration.save(folder / "unit.json")
    return CalibratedUnit(simulation.truth, simulation.imu, srt.load_calibration(folder / "unit.json"))


def sensed(motion: Motion, unit: CalibratedUnit, rng: np.random.Generator | None) -> Readings:
    """Increments that a unit reads on a motion, by the simulator's own IMU.

    Parameters
    ----------
    motion : Motion
    unit : CalibratedUnit
    rng : numpy.random.Generator or None
        None suits a unit without noise alone.

    Returns
    -------
    gyro, accel : ndarray, shape (n, 3), rad and m/s

    Notes
    -----
    ∫|ω| dt is taken as |∫ω dt|, which differs in samples with a change of sign only.
    """
    true = TrueMotion(
        motion.time,
        motion.interval_s,
        np.zeros(1, dtype=np.intp),
        motion.angle,
        np.abs(motion.angle),
        motion.velocity,
        np.abs(motion.velocity),
        (),
        np.zeros((0, 2, 3, 3)),
        (),
        srt.Site(9.80665, 5e-6, np.radians(START_LLA[0])),
        None,
        np.eye(3),
        None,
    )
    recording = sims.read_out(true, unit.truth, unit.imu, rng, kind="increment")
    return recording.gyro, recording.accel


def forms_of(motion: Motion, unit: CalibratedUnit, raw: Readings) -> dict[str, Readings]:
    """Readings in every form of :data:`FORMS`."""
    perfect = replace(unit.calibration, errors=unit.truth)
    options: dict[str, Any] = {"kind": "increment", "dt": motion.interval_s, "frame": "mars"}
    calibrated = unit.calibration.apply(*raw, **options)
    return {
        "raw": raw,
        "raw, zeroed": zeroed(motion, raw),
        "calibrated": calibrated,
        "calibrated, zeroed": zeroed(motion, calibrated),
        "perfect": perfect.apply(*raw, **options),
    }


def zeroed(motion: Motion, readings: Readings) -> Readings:
    """Take off the mean error of the standstill, where attitude, Earth rate and gravity tell what should be read."""
    still = motion.still
    gyro, accel = readings
    return (
        gyro - np.mean(gyro[still] - motion.angle[still], axis=0),
        accel - np.mean(accel[still] - motion.velocity[still], axis=0),
    )


def increments_of(motion: Motion, readings: Readings) -> Any:
    """Rotation vectors and velocity changes of python-ins, its frame with columns dt, theta and dv."""
    import pandas as pd

    pyins = pyins_modules()
    rows = np.hstack(readings)
    # python-ins wants the sample before the first one too; at a standstill they are alike.
    imu = pd.DataFrame(
        np.vstack([rows[:1], rows]),
        index=motion.trajectory.index,
        columns=[f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"],
    )
    return pyins.strapdown.compute_increments_from_imu(imu, "increment")


def navigate(motion: Motion, increments: Any, *, held_altitude: bool = True) -> tuple[Array, Array]:
    """Integrate from the exact start, and compare the horizontal position with the true one.

    Parameters
    ----------
    motion : Motion
    increments : pandas.DataFrame
        Of :func:`increments_of`.
    held_altitude : bool
        Set altitude and vertical velocity to the true ones every 20 s, as a barometric altimeter would: the vertical
        channel of inertial navigation is unstable. Nothing else is ever corrected.

    Returns
    -------
    time, drift : ndarray, shape (m,), s and m
        Straight-line distance at the true altitude; infinite where the navigator has lost all bearings.
    """
    pyins = pyins_modules()
    length = round(OUTPUT_S / motion.interval_s)
    marks = np.arange(0, len(increments) + 1, length)
    true = motion.trajectory.iloc[marks]
    pva = motion.trajectory.iloc[0]
    ends = [pva]
    with warnings.catch_warnings():
        # python-ins 1.0.1 passes an argument that pandas 3 has dropped the use of.
        warnings.filterwarnings("ignore", message="The copy keyword is deprecated")
        for a, b in itertools.pairwise(marks):
            part = pyins.strapdown.Integrator(pva).integrate(increments.iloc[a:b])
            pva = part.iloc[-1].copy()
            if held_altitude:
                pva[["alt", "VD"]] = motion.trajectory.iloc[b][["alt", "VD"]]
            ends.append(pva)
    altitude = true["alt"].to_numpy()
    found = np.column_stack([[end["lat"] for end in ends], [end["lon"] for end in ends], altitude])
    apart = pyins.transform.lla_to_ecef(found) - pyins.transform.lla_to_ecef(true[["lat", "lon", "alt"]].to_numpy())
    distance = np.linalg.norm(apart, axis=1)
    return np.asarray(true.index, dtype=np.float64), np.where(np.isfinite(distance), distance, np.inf)


def study(
    motions: Mapping[str, Motion], grade: str, units: int, seed: int, *, gtsam: bool = True, held_altitude: bool = True
) -> dict[str, DriftResult]:
    """Take units of one grade on every trajectory.

    Parameters
    ----------
    motions : mapping of str to Motion
        By vehicle.
    grade : str
        A key of :data:`GRADES`.
    units, seed : int
    gtsam : bool
        Preintegrate too.
    held_altitude : bool
        See :func:`navigate`.
    """
    outcomes = {vehicle: DriftResult() for vehicle in motions}
    with tempfile.TemporaryDirectory() as folder:
        for k in range(units):
            rng = np.random.default_rng([seed, list(GRADES).index(grade), k])
            for_unit, *for_rides = rng.spawn(1 + len(motions))
            unit = calibrated_unit(GRADES[grade], for_unit, Path(folder))
            for (vehicle, motion), ride in zip(motions.items(), for_rides, strict=True):
                outcome = outcomes[vehicle]
                starts = segment_starts(motion, SEGMENTS_EVERY_S)
                true = true_deltas(motion, starts) if gtsam else None
                for form, readings in forms_of(motion, unit, sensed(motion, unit, ride)).items():
                    increments = increments_of(motion, readings)
                    outcome.time_s, drift = navigate(motion, increments, held_altitude=held_altitude)
                    outcome.drifts[form].append(drift)
                    if true is not None:
                        outcome.deltas[form].append(delta_errors(preintegrate(increments, starts), true))
    return outcomes


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the example from the command line; the exit code."""
    parser = argparse.ArgumentParser(description="Drift of raw and calibrated units, by an independent navigator.")
    parser.add_argument("--minutes", type=int, default=30, help="length of the trajectories (default 30)")
    parser.add_argument("--units", type=int, default=5, help="of each grade (default 5)")
    parser.add_argument("--rate", type=int, default=100, help="samples per second on the way (default 100)")
    parser.add_argument("--grades", nargs="+", choices=GRADES, default=list(GRADES))
    parser.add_argument("--vehicles", nargs="+", choices=VEHICLES, default=list(VEHICLES))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("navigation"), help="folder (default navigation)")
    parser.add_argument("--no-gtsam", action="store_true", help="leave out preintegration")
    parser.add_argument("--free-altitude", action="store_true", help="let the unstable vertical channel run free")
    options = parser.parse_args(arguments)
    try:
        run(options)
    except srt.SrtError as error:
        print(f"Error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def run(options: argparse.Namespace) -> None:
    """Study what was asked for, print the tables, and write them and the picture."""
    from drift_report import drift_figure, tables

    from srt.reports.figures.style import save_figure

    if options.units < 1:
        raise srt.InputError(f"--units is {options.units}, but at least one unit of each grade is needed.")
    if options.minutes < 1:
        raise srt.InputError(f"--minutes is {options.minutes}, but at least one is needed.")
    if not 50 <= options.rate <= 1000:
        raise srt.InputError(f"--rate is {options.rate}, but 50 to 1000 samples per second are expected.")
    pyins_modules()
    if not options.no_gtsam:
        gtsam_module()
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise srt.InputError(f"The folder {options.out} cannot be made ({error.strerror}): choose another.") from None
    motions = {name: motion_of(course_of(name, options.minutes, options.rate)) for name in options.vehicles}
    outcomes: dict[tuple[str, str], DriftResult] = {}
    for grade in options.grades:
        found = study(
            motions,
            grade,
            options.units,
            options.seed,
            gtsam=not options.no_gtsam,
            held_altitude=not options.free_altitude,
        )
        outcomes |= {(vehicle, grade): outcome for vehicle, outcome in found.items()}
        print(f"{grade}: {options.units} units done", file=sys.stderr, flush=True)
    marks = [m for m in MARKS_MIN if m < options.minutes] + [options.minutes]
    text = tables(outcomes, marks)
    print(text)
    atomic_write_text(options.out / "navigation-tables.md", text)
    save_figure(drift_figure(outcomes), options.out / "navigation-drift.png")


if __name__ == "__main__":
    sys.exit(main())
