"""Jobs of 'srt calibrate': recordings with the paths of their results and figures, and the parts that are printed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from srt.cli.messages import figure_title
from srt.cli.output_paths import PLOT_SUFFIXES, RESULT_SUFFIXES, check_directory, check_file, recording_folder
from srt.cli.recording_arguments import file_name, unit_names
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.recording.protocol import Protocol
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sensor_errors import SensorErrors


@dataclass(frozen=True, slots=True)
class Job:
    """One recording to calibrate.

    Attributes
    ----------
    name : str
        Name of the folder of the recording; the file of the result has it where there are several.
    output, plot : Path or None
    """

    recording: Path
    name: str
    output: Path | None = None
    plot: Path | None = None


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

    def load(self, path: Path) -> Recording:
        """Load a recording, with the protocol that replaces its labels."""
        from srt.recording.folder import load_recording

        recording = load_recording(path)
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
        check_file(output, RESULT_SUFFIXES, "The result")
    check_file(plot, PLOT_SUFFIXES, "The plot")
    if not several:
        file = output / f"{names[0]}.json" if output is not None and into_folder else output
        return (Job(recordings[0], names[0], file, plot),)
    return tuple(_job(path, name, output, plot) for path, name in zip(recordings, names, strict=True))


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
    check_file(plot, PLOT_SUFFIXES, "The plot")
    return tuple(_job(path, name, output, plot) for path, name in zip(recordings, unit_names(recordings), strict=True))


def _job(recording: Path, name: str, folder: Path | None, plot: Path | None) -> Job:
    """One of several recordings: its result in the folder, its figure beside the plot, with its name."""
    file = file_name(name)
    return Job(
        recording,
        name,
        None if folder is None else folder / f"{file}.json",
        None if plot is None else plot.with_name(f"{plot.stem}-{file}{plot.suffix}"),
    )
