"""``srt calibrate --merge``: several recordings of one unit to one calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from srt.cli.output import warn
from srt.exceptions import DataError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from srt.cli.jobs import Display, Job
    from srt.estimation.options import Options
    from srt.result.calibration import Calibration


def run_merging(
    jobs: Sequence[Job], estimator: str, options: Options, display: Display, output: Path | None, plot: Path | None
) -> int:
    """Calibrate every recording, merge what converged, and write and show the result.

    Parameters
    ----------
    jobs : sequence of Job
        A recording each, or a calibration of one (.json).
    estimator : str
    options : Options
    display : Display
    output, plot : Path or None

    Returns
    -------
    int
        Exit code: 0; what is left out is said as a warning.

    Raises
    ------
    SrtError
        An input that cannot be read, recordings that are not of one unit, or none that can be merged.
    """
    from srt.comparison.merge import merge_calibrations
    from srt.reports.text.calibration import held_summary, report
    from srt.reports.text.repeatability import repeatability_text

    found: dict[str, Calibration] = {}
    for job in jobs:
        try:
            found[job.name] = _calibration(job, estimator, options, display)
        except DataError as error:
            warn(f"{job.recording} is left out: {error}")
    if not found:
        raise DataError("None of the recordings can be calibrated, and there is nothing to merge.")
    if len(found) == 1:
        (name,) = found
        raise DataError(f"Only {name} can be calibrated, and there is nothing to merge it with.")
    merged = merge_calibrations(list(found.values()), list(found))
    for row in merged.diagnostics["repeatability"]["left_out"]:
        warn(f"{row['name']} is {row['status'].replace('_', ' ')}, and was left out: {found[row['name']].message}")
    if output is not None:
        merged.save(output)
    if not display.quiet:
        title = str(output) if output is not None else ", ".join(found)
        click.echo(report(merged, title=title, truth=display.truth, budget=display.budget, verdict=display.verdict))
        click.echo(f"\n{repeatability_text(merged)}")
    if plot is not None:
        from srt.reports.figures.calibration import calibration_figure, save_figure

        save_figure(calibration_figure(merged, truth=display.truth, title="merged"), plot)
    written = [str(path) for path in (output, plot) if path is not None]
    if not display.quiet:
        click.echo(
            f"\nWritten: {', '.join(written)}" if written else "\nNothing was written: -o FILE.json keeps the result."
        )
    if merged.held:
        warn(f"held, not observed: {held_summary(merged)}.")
    return 0


def _calibration(job: Job, estimator: str, options: Options, display: Display) -> Calibration:
    """Read a calibration, or make it from its recording."""
    import srt
    from srt.cli.progress import playback_progress

    if job.recording.suffix == ".json":
        return srt.load_calibration(job.recording)
    recording = srt.load_recording(job.recording)
    with playback_progress(job.name, quiet=display.quiet) as progress:
        calibration = srt.calibrate(recording, estimator, options=options, progress=progress, force=display.force)
    for title, reason in calibration.provenance.get("voided", {}).items():
        warn(f"{job.recording}: {title} is void ({reason}).")
    return calibration
