"""Jobs of 'srt calibrate': recordings with the paths of their results and figures, and the parts that are printed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from srt.cli.messages import figure_title
from srt.cli.output_paths import (
    PLOT_SUFFIXES,
    RESULT_SUFFIXES,
    check_directory,
    check_file,
    check_place,
    picture_in,
    recording_folder,
)
from srt.cli.overwriting import LOSS, check_replaceable
from srt.cli.recording_arguments import file_name, load_stated, unit_names
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.cli.logs import Log
    from srt.recording.protocol import Protocol
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sensor_errors import SensorErrors

_LOSS: Final = (
    " Options of an earlier 'srt export' (as --inflate, --topic) and terms of 'srt noise --into' are not kept."
)


@dataclass(frozen=True, slots=True)
class Job:
    """One recording to calibrate.

    Attributes
    ----------
    name : str
        Name of the folder of the recording; the file of the result has it where there are several.
    output, plot : Path or None
    log : Log or None
        Log of which the recording is made first; if that is its path, the log is calibrated as it is.
    targets : tuple of str
        Formats in which the calibration is written, too, beside its file.
    """

    recording: Path
    name: str
    output: Path | None = None
    plot: Path | None = None
    log: Log | None = None
    targets: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Display:
    """Parts of a calibration that are printed.

    Beside them, ``force``: calibrate in spite of faults of the recording; ``trust``: accept calibration files that were
    changed after they were written; ``protocol``: of the recordings, in place of their labels; ``without``: turns and
    sequences to leave out.
    """

    truth: SensorErrors | None = None
    details: bool = False
    budget: bool = False
    verdict: bool = False
    quiet: bool = False
    force: bool = False
    trust: bool = False
    protocol: Protocol | None = None
    without: tuple[str, ...] = ()

    def load(self, job: Job) -> Recording:
        """Load a recording, made of its log if it is to be, with the protocol that replaces its labels."""
        log = job.log
        if log is None:
            recording = load_stated(job.recording)
        elif job.recording == log.path:
            recording = log.read(force=self.force, quiet=self.quiet)
        else:
            recording = log.convert(job.recording.parent, force=self.force, quiet=self.quiet)
        return recording if self.protocol is None else replace(recording, protocol=self.protocol, sequences=())

    def text(self, calibration: Calibration, title: str, source: str = "") -> str:
        """Parts of a calibration as text."""
        from srt.reports.text.calibration_summary import calibration_text

        parts = {"details": self.details, "budget": self.budget, "verdict": self.verdict}
        return calibration_text(calibration, title=title, truth=self.truth, source=source, **parts)

    @property
    def complete(self) -> bool:
        """True if the whole report is printed, not the summary alone."""
        return self.details or self.budget or self.verdict


def draw(calibration: Calibration, plot: Path | None, name: str, truth: SensorErrors | None = None) -> None:
    """Write the figure of a calibration, with name, serial and date as its title; nothing for None."""
    if plot is not None:
        from srt.reports.figures.calibration import calibration_figure, save_figure

        serial, date = calibration.provenance.serial, calibration.provenance.date
        title = ", ".join(filter(None, (name, serial and f"serial {serial}", date)))
        save_figure(calibration_figure(calibration, truth=truth, title=figure_title(title)), plot)


def plan(recordings: Sequence[Path], output: Path | None, plot: Path | None) -> tuple[Job, ...]:
    """Choose the path of every result, and check that it can be written.

    Parameters
    ----------
    output : Path or None
        A folder if there are several recordings, or if it exists as one.

    Raises
    ------
    InputError
        A path that cannot be written, or one path for two results.
    """
    names = [recording_folder(path).resolve().name for path in recordings]
    several = len(recordings) > 1
    into_folder = output is not None and (several or output.is_dir())
    if several and (output is not None or plot is not None):
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(
                f"Two recordings are named {twice}, and their results would replace each other: calibrate them apart."
            )
    require_once([recording_folder(path) for path in recordings])
    if output is not None and into_folder:
        check_directory(output)
    else:
        check_place(output, RESULT_SUFFIXES, "The result")
    if several:
        return _jobs(recordings, names, output, plot)
    file = output / f"{names[0]}.json" if output is not None and into_folder else output
    return _replaceable((Job(recordings[0], names[0], file, plot),))


def plan_folder(
    recording: Path, output: Path | None, plot: Path | None, log: Log | None, targets: Sequence[str]
) -> tuple[Job, ...]:
    """Choose the paths of the results of a log, or of a recording that is also written for other tools.

    Parameters
    ----------
    output : Path or None
        A folder; for a log without targets, the file of the calibration.

    Raises
    ------
    InputError
        A path that cannot be written, or a file where a folder is needed.
    """
    from srt.cli.export import target_path
    from srt.exporters.conversion import part_paths
    from srt.exporters.registry import exporter

    formats = {target: exporter(target) for target in targets}
    folder = output is not None and (output.is_dir() or output.suffix.lower() not in RESULT_SUFFIXES)
    if targets and not folder:
        raise InputError("With --to there are several files: name a folder for them, as -o results.")
    if output is None or not folder:
        return tuple(replace(job, log=log) for job in plan([recording], output, plot))
    check_directory(output)
    name = recording_folder(recording).resolve().name if log is None else recording.stem
    place = recording if log is None else output / "recording"
    file, picture = output / "calibration.json", picture_in(output) if plot is None else plot
    written: list[tuple[Path, Sequence[str], str]] = [(file, RESULT_SUFFIXES, "The result")]
    if picture is not None:
        written.append((picture, PLOT_SUFFIXES, "The plot"))
    for target, chosen in formats.items():
        parts = part_paths(chosen, target_path(output, chosen)).values()
        written += [(path, chosen.suffixes, f"The {target} file") for path in parts]
    for path, suffixes, what in written:
        if path.parent.is_dir() or path is plot:
            check_place(path, suffixes, what)
    check_replaceable(*(path for path, _, _ in written))
    click.get_current_context().meta[LOSS] = _LOSS
    return (Job(place, name, file, picture, log, tuple(formats)),)


def require_once(recordings: Sequence[Path]) -> None:
    """Raise InputError for a recording, or a calibration, that is named twice."""
    places = [path.resolve() for path in recordings]
    twice = next((path for n, path in enumerate(recordings) if places[n] in places[:n]), None)
    if twice is not None:
        raise InputError(f"{twice} is named twice, and one recording must not count twice.")


def plan_merging(recordings: Sequence[Path], output: Path | None, plot: Path | None) -> tuple[Job, ...]:
    """Name the recordings to merge, and check that the result can be written.

    Raises
    ------
    InputError
        One recording alone, the same one twice, or a path that cannot be written.
    """
    if len(recordings) < 2:
        raise InputError(f"--merge needs at least two recordings of a unit, and there is only {recordings[0]}.")
    files = [path if path.suffix == ".json" else recording_folder(path) for path in recordings]
    require_once(files)
    stems = [path.stem if path.suffix == ".json" else path.name for path in map(Path.resolve, files)]
    names = [stem if stems.count(stem) == 1 else str(path) for stem, path in zip(stems, recordings, strict=True)]
    check_file(output, RESULT_SUFFIXES, "The merged calibration")
    check_file(plot, PLOT_SUFFIXES, "The plot")
    return tuple(Job(path, name) for path, name in zip(recordings, names, strict=True))


def plan_fleet(recordings: Sequence[Path], output: Path | None, plot: Path | None) -> tuple[Job, ...]:
    """Name the units, choose the path of every result, and check that it can be written.

    Raises
    ------
    InputError
        A recording that is named twice, or a path that cannot be written.
    """
    if output is not None:
        if output.suffix.lower() in (".json", ".csv"):
            raise InputError(
                f"The results of a fleet go to a folder, and {output} is called like a file: name another."
            )
        check_directory(output)
        check_replaceable(*(output / name for name in ("fleet.csv", "fleet.json")))
    return _jobs(recordings, unit_names(recordings), output, plot)


def _jobs(recordings: Sequence[Path], names: Sequence[str], output: Path | None, plot: Path | None) -> tuple[Job, ...]:
    """Jobs of several recordings, whose files can be written."""
    return _replaceable(tuple(_job(path, name, output, plot) for path, name in zip(recordings, names, strict=True)))


def _replaceable(jobs: tuple[Job, ...]) -> tuple[Job, ...]:
    """Jobs, after the check that their files can be written."""
    check_place(jobs[0].plot, PLOT_SUFFIXES, "The plot")
    check_replaceable(*(path for job in jobs for path in (job.output, job.plot) if path is not None))
    return jobs


def _job(recording: Path, name: str, folder: Path | None, plot: Path | None) -> Job:
    """One of several recordings: its result in the folder, its figure beside the plot, with its name."""
    file = file_name(name)
    return Job(
        recording,
        name,
        None if folder is None else folder / f"{file}.json",
        None if plot is None else plot.with_name(f"{plot.stem}-{file}{plot.suffix}"),
    )
