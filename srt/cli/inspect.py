"""``srt inspect``: content and faults of a recording, as a table and a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from srt.cli.grouped_command import RenamedOption
from srt.cli.messages import announce, figure_title, is_seen, say, show
from srt.cli.output_paths import RESULT_SUFFIXES, check_file, check_plot, recording_folder
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.cli.recording_arguments import load_stated
from srt.exceptions import DataError

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.argument("recording", type=PATH, metavar="RECORDING")
@click.option("--deep", is_flag=True, help="Also calibrate, and look for faults that only a calibration shows.")
@click.option("-o", "--output", "json_file", cls=RenamedOption, earlier=("--json",), type=PATH,
              metavar="FILE", help="Result: FILE.json.")  # fmt: skip
@click.option("--plot", type=PATH, metavar="FILE", help="Figure: FILE.png, .pdf or .svg.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No table; fatal faults only.")
def inspect(recording: Path, deep: bool, json_file: Path | None, plot: Path | None, quiet: bool) -> int:
    """Show the content of RECORDING, a folder with recording.toml and samples, and look for faults.

    Shown are sample rate and gaps, units, noise at rest (with the Allan deviation of stationary windows of 30 s or
    more), stationary windows, rotations, recognised sequences of the test, and faults.

    Exit codes: 0 no fatal fault; 1 a fatal fault, in one sentence; 2 wrong usage or unreadable input.
    """
    check_file(json_file, RESULT_SUFFIXES, "The inspection")
    check_plot(plot)
    from srt.reports import inspection
    from srt.reports.text.inspection import inspection_report
    from srt.result.json_file import save_json_file

    samples = load_stated(recording)
    found = inspection.inspect(samples, deep=deep)
    if not quiet:
        show(inspection_report(found, title=str(recording)))
    if json_file is not None:
        save_json_file(json_file, found.as_dict())
    if plot is not None:
        from srt.reports.figures.inspection import inspection_figure
        from srt.reports.figures.style import save_figure

        title = figure_title(recording_folder(recording).resolve().name)
        save_figure(inspection_figure(samples, found, title=title), plot)
    announce(json_file, plot, quiet=quiet)
    refusal = found.diagnosis.refusal
    if refusal is not None and not is_seen(quiet=quiet):
        say(refusal.sentence)
    return 0 if refusal is None else DataError.exit_code
