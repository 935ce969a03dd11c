"""``srt noise``: noise terms of a unit at rest, for data sheets and navigation filters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from srt.cli.grouped_command import RenamedOption
from srt.cli.messages import announce, figure_title, show
from srt.cli.output_paths import RESULT_SUFFIXES, check_file, check_plot, recording_folder
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH

if TYPE_CHECKING:
    from pathlib import Path

    from srt.recording.recording import Recording


@click.command()
@click.argument("log", type=PATH, metavar="LOG")
@click.option("--into", type=PATH, metavar="UNIT", help="Calibration UNIT.json of the same unit "
              "that the terms are written into, for exports.")  # fmt: skip
@click.option("-o", "--output", "json_file", cls=RenamedOption, earlier=("--json",), type=PATH,
              metavar="FILE", help="Result: FILE.json.")  # fmt: skip
@click.option("--plot", type=PATH, metavar="FILE", help="Figure: FILE.png, .pdf or .svg.")
@click.option("--force", is_flag=True, help="Accept an inconsistent calibration and any serial.")
@click.option("--trust", is_flag=True, help="Accept a calibration file that was changed after it was written.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No table.")
def noise(
    log: Path, into: Path | None, json_file: Path | None, plot: Path | None, force: bool, trust: bool, quiet: bool
) -> int:
    """Show the noise terms in the longest stationary window of LOG: a recording, or a log in a format with units.

    Quantization, random walk, bias instability, bias random walk and rate ramp of the six channels, with 95 %
    intervals: by maximum likelihood, and by a fit of the overlapping Allan deviation. A term that the log does not
    resolve is an upper limit. The record length that each term needs is shown.

    A channel whose readings contradict the fitted terms, or whose noise changes within the window, has no figures; the
    report says why.

    Exit codes: 0 success; 1 no stationary window of 30 s, or figures of no channel; 2 wrong usage or unreadable input.
    """
    import numpy as np

    from srt.cli.apply import check_match, load_fit
    from srt.noise.allan import allan_deviation
    from srt.noise.noise_terms import noise_terms
    from srt.result.document import to_document
    from srt.result.json_file import save_json_file
    from srt.result.noise_figures import LogNoise
    from srt.sequences.rest_detection import undisturbed_rest

    check_file(json_file, RESULT_SUFFIXES, "The result")
    check_plot(plot)
    check_file(into, RESULT_SUFFIXES, "The calibration")
    recording = _samples(log)
    calibration = None if into is None else load_fit(into, force=force, trust=trust)
    if calibration is not None and into is not None and not force:
        check_match(calibration, recording, into, log)
    window = undisturbed_rest(recording)
    terms = noise_terms(recording, window)
    allan = allan_deviation(recording, np.array([window], dtype=np.intp))
    if not quiet:
        from srt.reports.text.noise import noise_report

        show(noise_report(terms, allan, title=str(log)))
    found = LogNoise(length_s=terms.length_s, samples_sha256=recording.data_sha256, channels=terms.figures())
    if json_file is not None:
        save_json_file(json_file, to_document(found))
    if calibration is not None and into is not None:
        from dataclasses import replace

        replace(calibration, noise=replace(calibration.noise, terms=found)).save(into)
    if plot is not None:
        from srt.reports.figures.inspection import noise_figure
        from srt.reports.figures.style import save_figure

        save_figure(noise_figure(terms, allan, title=figure_title(recording_folder(log).resolve().name)), plot)
    announce(json_file, plot, into, quiet=quiet)
    return 0


def _samples(log: Path) -> Recording:
    """Recording, or the samples of a log; noise needs no site."""
    import srt
    from srt.constants import STANDARD_GRAVITY_M_S2

    if log.suffix == ".toml" or (log / "recording.toml").is_file():
        return srt.load_recording(log)
    from srt.recording.imported_samples import to_recording
    from srt.recording.importer_registry import import_file

    return to_recording(import_file(log)[1], srt.Site(STANDARD_GRAVITY_M_S2))
