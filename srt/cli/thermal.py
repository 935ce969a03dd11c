"""``srt thermal``: one calibration over temperature from tests at several temperatures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from srt.cli.messages import announce, figure_title, is_seen, show, warn
from srt.cli.output_paths import PLOT_SUFFIXES, RESULT_SUFFIXES, check_file
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.exceptions import DataError, InputError

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.argument("tests", metavar="TEST...", nargs=-1, required=True, type=PATH)
@click.option("-o", "--output", type=PATH, metavar="FILE.json", help="Write the result.")
@click.option("--plot", type=PATH, metavar="FILE", help="Draw the curves (.png, .pdf, .svg).")
@click.option("--estimator", default="auto", show_default=True, help="Estimator of recordings.")
@click.option("--at", "temperature_c", type=float, metavar="°C", help="Errors at one temperature, as a calibration.")
@click.option("--clip", is_flag=True, help="With --at outside the range: hold the values at its end.")
@click.option("--force", is_flag=True, help="Calibrate recordings in spite of their faults.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No report; warnings and errors only.")
def thermal(
    tests: tuple[Path, ...],
    output: Path | None,
    plot: Path | None,
    estimator: str,
    temperature_c: float | None,
    clip: bool,
    force: bool,
    quiet: bool,
) -> int:
    """Calibrate a unit over temperature from TESTs of it, each at a temperature of its own (soak points).

    A TEST is a recording, or the calibration (.json) of one. The temperature of each is that of its samples, or
    temperature_c in recording.toml. A recording at rest over 5 K or more is a ramp: it shows how biases change. The
    result has every error as a curve over the range of the tests, with its sigma for a later visit of a temperature:
    'srt apply' corrects recordings with it that have a temperature.

    One TEST that is such a result (.json) is shown; with --at T the calibration at that temperature is written, which
    'srt export' and 'srt certificate' take.

    Exit codes: 0 success; 1 the tests cannot be used, or the verdict is failed; 2 wrong usage or unreadable input.
    """
    import srt
    from srt.cli.progress import iteration_progress
    from srt.cli.recording_arguments import unit_names
    from srt.reports.text.calibration_summary import calibration_summary
    from srt.reports.text.thermal import thermal_text
    from srt.result.verdict import DOUBTFUL, FAILED

    check_file(output, RESULT_SUFFIXES, "The result")
    check_file(plot, PLOT_SUFFIXES, "The figure")
    if clip and temperature_c is None:
        raise InputError("--clip is for --at: add the temperature.")
    found = [srt.load_calibration(p) if p.suffix == ".json" else srt.read(p) for p in tests]
    recordings = [path for path in tests if path.suffix != ".json"]
    named = dict(zip(recordings, unit_names(recordings), strict=True)) if recordings else {}
    names = [named.get(path, path.stem) for path in tests]
    if len(found) == 1 and isinstance(found[0], srt.Calibration) and found[0].thermal is not None:
        result = found[0]
    else:
        with iteration_progress(", ".join(names), quiet=quiet) as progress:
            result = srt.calibrate_thermal(found, estimator, names=names, force=force, progress=progress)
    whole = result
    if temperature_c is not None:
        result = result.at(temperature_c, clip=clip)
    if output is not None:
        result.save(output)
    if not quiet:
        title = str(output) if output is not None else ", ".join(names)
        text = calibration_summary if result.thermal is None else thermal_text
        show(text(result, title=title))
    if plot is not None and whole.thermal is not None:
        from srt.reports.figures.style import save_figure
        from srt.reports.figures.thermal import thermal_figure

        save_figure(thermal_figure(whole, title=figure_title(", ".join(names))), plot)
    announce(output, plot, quiet=quiet)
    seen = is_seen(quiet=quiet)
    for warning in () if seen else whole.warnings:
        warn(warning)
    if whole.judgement.word == DOUBTFUL and not seen:
        warn(str(whole.judgement))
    return DataError.exit_code if whole.judgement.word == FAILED else 0
