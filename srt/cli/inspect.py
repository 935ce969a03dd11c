"""``srt inspect``: what a recording holds, as a table and a picture, before anything is calibrated."""

from __future__ import annotations

import json
from pathlib import Path

import click

from srt.cli.output import check_file, recording_folder, require_matplotlib, say
from srt.exceptions import DataError

PLOT_SUFFIXES = (".png", ".pdf", ".svg")
JSON_SUFFIXES = (".json",)


@click.command()
@click.argument("recording", type=click.Path(path_type=Path), metavar="RECORDING")
@click.option("--deep", is_flag=True, help="Calibrate, too, and look for what only a calibration shows.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), metavar="FILE", help="All of it: FILE.json.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE", help="Picture: FILE.png, .pdf or .svg.")
@click.option("-q", "--quiet", is_flag=True, help="No table; what refuses the recording only.")
def inspect(recording: Path, deep: bool, json_file: Path | None, plot: Path | None, quiet: bool) -> int:
    """Show what RECORDING, a folder with recording.toml and samples, holds.

    Rate and gaps, units, noise at rest (with its Allan deviation where the unit rests for 30 s or more), where it
    stands still, how it was turned, which sequences of the test these turns are, and what is wrong with it.

    Exit codes: 0 nothing stands against a calibration; 1 something does, in one sentence; 2 wrong usage or
    unreadable input.
    """
    if json_file is not None:
        check_file(json_file, JSON_SUFFIXES, "The inspection")
    if plot is not None:
        check_file(plot, PLOT_SUFFIXES, "The plot")
        require_matplotlib()
    import srt
    from srt.diagnosis import inspection
    from srt.recording.atomic_file import atomic_write_text
    from srt.reports.text.inspection import inspection_report

    samples = srt.load_recording(recording)
    found = inspection.inspect(samples, calibrating=deep, units=inspection.declared_units(recording))
    if not quiet:
        click.echo(inspection_report(found, title=str(recording)))
    if json_file is not None:
        document = json.dumps(found.as_dict(), indent=1, ensure_ascii=False, allow_nan=False)
        atomic_write_text(json_file, document + "\n")
    if plot is not None:
        name = recording_folder(recording).resolve().name
        figure = srt.reports.figures.inspection.inspection_figure(samples, found, title=name)
        srt.reports.figures.inspection.save_figure(figure, plot)
    written = [str(path) for path in (json_file, plot) if path is not None]
    if written and not quiet:
        click.echo(f"\nWritten: {', '.join(written)}")
    refusal = found.diagnosis.refusal
    if refusal is not None:
        say(refusal.sentence)
        return DataError.exit_code
    return 0
