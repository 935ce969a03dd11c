"""``srt calibrate`` of a fleet: one table of many units, with the outliers marked."""

from __future__ import annotations

import importlib.util
from collections import Counter
from typing import TYPE_CHECKING, Final, NamedTuple

from srt.cli.calibration_jobs import draw
from srt.cli.messages import say, show, warn
from srt.cli.output_paths import make_directory
from srt.cli.progress import unit_progress
from srt.exceptions import SrtError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from srt.cli.calibration_jobs import Job
    from srt.comparison.fleet import Fleet, FleetUnit
    from srt.comparison.parallel import Engine
    from srt.estimation.options import Options

FLEET_FROM: Final = 6
"""Number of recordings from which on they are shown as a fleet; outliers are tested from six units on."""


class FleetEngine(NamedTuple):
    """Processes for a fleet: their number (0: one on each core), or the address of a Dask scheduler."""

    workers: int = 1
    scheduler: str | None = None


def run_fleet(
    jobs: Sequence[Job],
    estimator: str,
    options: Options,
    *,
    engine: FleetEngine,
    output: Path | None,
    quiet: bool,
    force: bool,
) -> int:
    """Calibrate all units, write every result when it is ready, and print the fleet.

    Parameters
    ----------
    output : Path or None
        Folder of the results.

    Returns
    -------
    int
        Worst exit code of a unit; an outlier is a warning, not a failure.

    Raises
    ------
    SrtError
        Workers that cannot start, or tables that cannot be written.
    """
    from srt.comparison.fleet import calibrate_fleet

    if output is not None:
        make_directory(output)
    by_name = {job.name: job for job in jobs}
    unwritten: dict[str, SrtError] = {}
    # Workers on other machines have other working directories.
    paths = {job.name: job.recording if engine.scheduler is None else job.recording.absolute() for job in jobs}
    processes = _engine(engine.workers, engine.scheduler)
    with unit_progress(len(jobs), quiet=quiet) as progress:

        def finished(unit: FleetUnit) -> None:
            try:
                _write(unit, by_name[unit.name])
            except SrtError as error:
                unwritten[unit.name] = error
            progress(unit)

        fleet = calibrate_fleet(
            paths, estimator, options=options, engine=processes, force=force, finished=finished, details=False
        )
    if output is not None:
        fleet.save_csv(output / "fleet.csv")
        fleet.save_json(output / "fleet.json")
    if not quiet:
        from srt.reports.text.fleet import fleet_text

        show(fleet_text(fleet))
        show(
            "\nNothing was written: -o FOLDER keeps the results."
            if output is None
            else f"\nWritten to {output}: the units' results, fleet.csv, fleet.json"
        )
    for error in unwritten.values():
        say(str(error))
    return max([_tell(fleet, by_name), *(error.exit_code for error in unwritten.values())])


def _engine(workers: int, scheduler: str | None) -> Engine | None:
    """Engine for the options; None, which is this process as it stands, where nothing else could run anyway."""
    from srt.comparison.parallel import Engine

    engine = Engine(workers, scheduler)
    # An engine keeps even one process to one thread, so that more of them give the same digits. Where that cannot be
    # had there can be no more of them, and a fleet needs no extra package.
    alone = workers == 1 and scheduler is None
    return None if alone and importlib.util.find_spec("threadpoolctl") is None else engine


def _write(unit: FleetUnit, job: Job) -> None:
    if unit.calibration is None:
        return
    if job.output is not None:
        unit.calibration.save(job.output)
    draw(unit.calibration, job.plot, job.name)


def _tell(fleet: Fleet, jobs: Mapping[str, Job]) -> int:
    """Print one sentence for each unit with a problem; give the worst exit code."""
    from srt.result.verdict import DOUBTFUL
    from srt.sensor_errors import NAMES

    partial = [unit.name for unit in fleet.units if unit.status == "partial"]
    if partial:
        warn(f"some parameters are fixed, not observed, in {len(partial)} of {len(fleet.units)}: {', '.join(partial)}.")
    doubtful = [u.name for u in fleet.units if u.calibration is not None and u.calibration.judgement.word == DOUBTFUL]
    if doubtful:
        warn(f"{len(doubtful)} of {len(fleet.units)} are doubtful (each alone says why): {', '.join(doubtful)}.")
    serials = Counter(unit.serial for unit in fleet.units if unit.serial is not None and unit.sound)
    for serial, count in serials.items():
        if count == 1:
            continue
        warn(
            f"{count} recordings have the serial {serial}, and each counts as a unit of the fleet: "
            "--merge makes one calibration of them."
        )
    for number, unit in enumerate(fleet.units):
        found = fleet.flagged(number)
        if found:
            z = fleet.outliers.z[number, found[0]]
            more = f" and {len(found) - 1} more" if len(found) > 1 else ""
            warn(f"{unit.recording} is outlying against the fleet: {NAMES[found[0]]} by z = {z:+.3g}{more}.")
        elif unit.exit_code:
            job = jobs[unit.name]
            kept = f"; {job.output} holds it with that status" if unit.calibration and job.output else ""
            sentence = f"{unit.message.rstrip('.')}{kept}."
            say(sentence if unit.recording in sentence else f"{unit.recording}: {sentence}")
    return max((unit.exit_code for unit in fleet.units), default=0)
