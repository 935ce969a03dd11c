"""Calibration of a fleet: every unit alone, on any number of processes, with a test for outliers among the units.

A unit that fails has no calibration in the result; the others are calibrated all the same.
"""

from __future__ import annotations

import csv
import gc
import hashlib
import io
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.comparison.outliers import EXPECTED_FALSE_FLAGS, MINIMUM_UNITS, FleetOutliers, find_outliers
from srt.exceptions import DataError, InputError, SrtError
from srt.model.platform_steps import many_recordings
from srt.recording.atomic_file import atomic_write_text
from srt.result.diagnostics import Diagnostics
from srt.result.json_file import save_json_file
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Alignment, Provenance, StatedSite
from srt.result.verdict import USABLE
from srt.sensor_errors import N_PARAMETERS, NAMES, SYMBOLS, UNITS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from os import PathLike

    from srt.comparison.parallel import Engine
    from srt.estimation.options import Options
    from srt.result.calibration import Calibration

_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")
"""Beginnings of a text that spreadsheets take for a formula."""
FORMAT: Final = "srt-fleet"
VERSION: Final = 1
FAILED: Final = "failed"

COLUMNS: Final = (
    *("unit", "serial", "recording", "status", "message", "parameter", "unit_si", "value", "sigma"),
    *("fleet_median", "fleet_scatter", "others_median", "others_scatter", "z", "limit", "flagged"),
)
"""Columns of the long table: one row per unit and parameter, SI; a unit without a calibration has one row."""


@dataclass(frozen=True, slots=True)
class UnitTask:
    """Task of a worker process: one unit to calibrate; picklable."""

    number: int
    name: str
    recording: str
    estimator: str
    options: Options
    force: bool
    units: int = 1
    """Number of units of the fleet."""


@dataclass(frozen=True, slots=True, eq=False)
class FleetUnit:
    """Result of one unit.

    Attributes
    ----------
    name : str
        Unique name in the fleet.
    recording : str
        Its path.
    status : str
        Status of the calibration, or "failed".
    message : str
        One sentence.
    exit_code : int
        Exit code of the command line for this unit alone.
    """

    name: str
    recording: str
    serial: str | None
    status: str
    message: str
    exit_code: int
    calibration: Calibration | None = None

    @property
    def about(self) -> dict[str, str | None]:
        """Serial, recording, status and message by name, as files state them."""
        return {key: getattr(self, key) for key in ("serial", "recording", "status", "message")}

    @property
    def sound(self) -> bool:
        """True if its values count in the fleet statistics."""
        return self.calibration is not None and self.status in USABLE


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Units in the given order, with the outlier test of each.

    Attributes
    ----------
    outliers : FleetOutliers
        One row per unit; NaN for units without a converged calibration.
    """

    units: tuple[FleetUnit, ...]
    outliers: FleetOutliers

    def flagged(self, number: int) -> tuple[int, ...]:
        """Indices of the outlying parameters of a unit, the largest z first."""
        size = np.abs(self.outliers.z[number])
        found = np.flatnonzero(self.outliers.flagged[number])
        return tuple(found[np.argsort(-size[found], kind="stable")].tolist())

    def rows(self) -> Iterator[dict[str, Any]]:
        """Rows of the long table, :data:`COLUMNS`; None for unknown values."""
        judged, flagged = self.outliers, self.outliers.flagged
        for number, unit in enumerate(self.units):
            about = {"unit": unit.name, **unit.about}
            if unit.calibration is None:
                yield dict.fromkeys(COLUMNS) | about
                continue
            values, sigma = unit.calibration.values, unit.calibration.sigma
            for i, name in enumerate(NAMES):
                numbers = {
                    "value": values[i],
                    "sigma": sigma[i],
                    "fleet_median": judged.median[i],
                    "fleet_scatter": judged.scatter[i],
                    "others_median": judged.others_median[number, i],
                    "others_scatter": judged.others_scatter[number, i],
                    "z": judged.z[number, i],
                    "limit": judged.limit[i],
                }
                known = {key: _number(value) for key, value in numbers.items()}
                mark = bool(flagged[number, i]) if known["z"] is not None else None
                yield {**about, "parameter": name, "unit_si": UNITS[i], **known, "flagged": mark}

    def save_csv(self, path: str | PathLike[str]) -> None:
        """Write the long table as CSV, completely or not at all; unknown values are empty cells.

        An apostrophe precedes texts that a spreadsheet would compute as a formula. Raises InputError if it cannot be
        written.
        """
        atomic_write_text(path, self._csv())

    def save_json(self, path: str | PathLike[str]) -> None:
        """Write :meth:`to_dict` as JSON, completely or not at all. Raises InputError if it cannot be written.

        The digest of the CSV goes with it: a table has no place for a mark of its own.
        """
        save_json_file(path, self.to_dict() | {"csv_sha256": hashlib.sha256(self._csv().encode()).hexdigest()})

    def _csv(self) -> str:
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _cell(value) for key, value in row.items()} for row in self.rows())
        return text.getvalue()

    def to_dict(self) -> dict[str, Any]:
        """JSON form: units, parameters and the long table, without NaN."""
        judged = self.outliers
        return {
            "format": FORMAT,
            "version": VERSION,
            "judgement": {
                "method": "each unit against the median and the pairwise scatter of all the others",
                "expected_false_flags": EXPECTED_FALSE_FLAGS,
                "minimum_units": MINIMUM_UNITS,
            },
            "units": [self._unit(number) for number in range(len(self.units))],
            "parameters": [
                {
                    "name": name,
                    "symbol": SYMBOLS[i],
                    "unit": UNITS[i],
                    "median": _number(judged.median[i]),
                    "scatter": _number(judged.scatter[i]),
                    "limit": _number(judged.limit[i]),
                    "flagged": [unit.name for n, unit in enumerate(self.units) if judged.flagged[n, i]],
                }
                for i, name in enumerate(NAMES)
            ],
            "columns": list(COLUMNS),
            "rows": [list(row.values()) for row in self.rows()],
        }

    def _unit(self, number: int) -> dict[str, Any]:
        unit = self.units[number]
        out: dict[str, Any] = {
            "name": unit.name,
            **unit.about,
            "exit_code": unit.exit_code,
            "flagged": [NAMES[i] for i in self.flagged(number)],
        }
        if unit.calibration is not None:
            tests = unit.calibration.consistency
            out |= {key: getattr(tests, key, None) for key in ("chi_square", "degrees_of_freedom", "probability")}
            judgement = unit.calibration.judgement
            out |= {"verdict": judgement.word, "reason": judgement.reason}
            out |= {"estimator": unit.calibration.estimator, "warnings": list(unit.calibration.warnings)}
        return out


def calibrate_fleet(
    recordings: Sequence[str | PathLike[str]] | Mapping[str, str | PathLike[str]],
    estimator: str = "auto",
    *,
    options: Options | None = None,
    engine: Engine | None = None,
    force: bool = False,
    finished: Callable[[FleetUnit], None] | None = None,
    details: bool = True,
) -> Fleet:
    """Calibrate many units and test each against all others.

    Parameters
    ----------
    recordings : sequence of path-like, or mapping of str to path-like
        Folders, or their ``recording.toml``; as a mapping by the units' names, which otherwise are the paths.
    estimator : str
        As for :func:`srt.calibrate`.
    engine : Engine, optional
        Processes to run on; default: this process, one after the other. The results do not depend on it.
    force : bool
        Calibrate in spite of faults.
    finished : callable, optional
        Called with every finished unit, in no particular order. An exception of the function ends the run.
    details : bool
        Keep every calibration as a whole. Without, its residuals, diagnostics and sources of sigma are dropped after
        ``finished``: a large fleet then needs a tenth of the memory.

    Returns
    -------
    Fleet
        In the order of ``recordings``. A unit that failed holds the reason.

    Raises
    ------
    InputError
        A recording or a name given twice, or an engine that cannot start.
    MissingExtraError
        Without the packages that the engine needs.
    """
    from srt.estimation.options import Options as _Options

    if not isinstance(recordings, Mapping):
        paths = Counter(map(str, recordings))
        if len(paths) < len(recordings):
            raise InputError(
                f"The recording {paths.most_common(1)[0][0]} is named twice, and one unit must not count twice."
            )
        recordings = {path: path for path in paths}
    chosen = _Options() if options is None else options
    tasks = [
        UnitTask(n, name, str(path), estimator, chosen, force, len(recordings))
        for n, (name, path) in enumerate(recordings.items())
    ]
    done: dict[int, FleetUnit] = {}
    for number, unit in _run(tasks, engine):
        if finished is not None:
            finished(unit)
        done[number] = unit if details else _without_details(unit)
    return assemble_fleet([done[n] for n in range(len(tasks))])


def _without_details(unit: FleetUnit) -> FleetUnit:
    """Unit with what the tables of a fleet show of its calibration."""
    if unit.calibration is None:
        return unit
    found = unit.calibration
    tests = found.consistency and replace(found.consistency, sequences=(), parameters=(), weakest_combination=None)
    kept = replace(
        unit.calibration,
        corrections=(), contributions={}, residuals=(), site=StatedSite(), alignment=Alignment(), temperature=None,
        provenance=Provenance(),
        # The values that the verdict is made from stay.
        noise=NoiseFigures(sigma_inflation=found.noise.sigma_inflation),
        diagnostics=Diagnostics(faults=found.diagnostics.faults, drift=found.diagnostics.drift), consistency=tests,
    )  # fmt: skip
    return replace(unit, calibration=kept)


def assemble_fleet(units: Sequence[FleetUnit]) -> Fleet:
    """Fleet of calibrated units, with the outlier test."""
    values, sigmas = (np.full((len(units), N_PARAMETERS), np.nan) for _ in range(2))
    for number, unit in enumerate(units):
        if unit.calibration is not None and unit.sound:
            values[number], sigmas[number] = unit.calibration.errors.vector, unit.calibration.sigma
    return Fleet(tuple(units), find_outliers(values, sigmas))


def calibrate_unit(task: UnitTask) -> tuple[int, FleetUnit]:
    """Calibrate one unit; an error, even a defect of the program, becomes its message."""
    from srt.procedure import calibrate
    from srt.recording.folder import load_recording

    # The last recording and its derived values refer to each other: by itself the collector, which counts objects and
    # not bytes, would keep gigabytes of several units.
    gc.collect()
    unit = partial(FleetUnit, task.name, task.recording)
    serial = None
    try:
        recording = load_recording(Path(task.recording))
        serial = recording.serial
        with many_recordings(task.units):
            result = calibrate(recording, task.estimator, options=task.options, force=task.force)
    except SrtError as error:
        return task.number, unit(serial, FAILED, str(error), error.exit_code)
    except Exception as error:  # one unit must not stop the others
        text = " ".join(str(error).split())
        return task.number, unit(
            serial,
            FAILED,
            f"The program failed ({type(error).__name__}: {text}): calibrate this recording alone to see where, and "
            "report it as a defect.",
            DataError.exit_code,
        )
    code = 0 if result.status in USABLE else DataError.exit_code
    return task.number, unit(serial, result.status, result.message, code, result.as_written)


def _run(tasks: Sequence[UnitTask], engine: Engine | None) -> Iterator[tuple[int, FleetUnit]]:
    """Run all tasks. If a worker dies, run the unfinished tasks one by one, so that one unit cannot stop the others."""
    if engine is None:
        yield from map(calibrate_unit, tasks)
        return
    left = {task.number: task for task in tasks}
    try:
        for number, unit in engine.run(calibrate_unit, tasks):
            del left[number]
            yield number, unit
    except DataError:
        pass  # the second run finds the unit that causes it
    for number, task in list(left.items()):
        try:
            yield next(iter(engine.run(calibrate_unit, [task])))
        except DataError as error:
            yield number, FleetUnit(task.name, task.recording, None, FAILED, str(error), error.exit_code)


def _cell(value: Any) -> Any:
    """Value of a CSV cell: a spreadsheet does not compute a text that comes from a file or its name."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
