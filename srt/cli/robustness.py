"""``srt robustness``: campaigns of simulated units, for the size of errors from which calibration converges."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from srt.cli.messages import say, show
from srt.cli.names import Name
from srt.cli.output_paths import check_directory, check_file, check_recording_target
from srt.cli.overwriting import check_replaceable, overwrite_allowed, overwrite_option
from srt.cli.path_type import PATH
from srt.cli.progress import count_progress
from srt.exceptions import InputError

if TYPE_CHECKING:
    from sims.robustness.campaign import Campaign
    from sims.robustness.trial_table import Header

_ALWAYS: Final = ("trials", "converged")
"""Columns of the table that are shown even if they are zero."""


@click.command()
@click.argument("config", metavar="CONFIG", type=Name("campaigns", file=True))
@click.option(
    "-o",
    "--output",
    type=PATH,
    help="Folder of the results, or of the recording with --replay. Default for results: robustness-NAME.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=0),
    default=0,
    show_default="one on each core",
    metavar="N",
    help="Processes on this machine. The numbers do not depend on it.",
)
@click.option("--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler, as tcp://host:8786.")
@click.option("--trials", type=click.IntRange(min=1), metavar="N", help="Trials of every point; default: as in CONFIG.")
@click.option("--fresh", is_flag=True, help="Delete the results of an earlier run in the folder.")
@click.option("--replay", metavar="POINT:TRIAL", help="Repeat one trial and show it; -o keeps its recording.")
@click.option("--markdown", type=PATH, help="Tables of the report: FILE.md.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No progress and no table; warnings and errors only.")
def robustness(
    config: str,
    output: Path | None,
    workers: int,
    scheduler: str | None,
    trials: int | None,
    fresh: bool,
    replay: str | None,
    markdown: Path | None,
    quiet: bool,
) -> int:
    """Run the campaign CONFIG: a TOML file, or the name of a shipped one such as 'quick'.

    Many units are simulated and calibrated by the estimators of the campaign. Each result is compared with the truth:
    converged, wrong minimum, not converged, outside the model. The folder then holds report.html, with maps and the
    first failures, and results.parquet, one row for each trial and estimator. docs/robustness.md has the keys of
    CONFIG; 'srt list campaigns' shows the shipped ones.

    The same command resumes an interrupted campaign. The numbers depend on the seed alone, not on the workers.

    Exit codes: 0 the campaign ran; 1 a worker died; 2 wrong usage or unreadable input.
    """
    from sims.robustness.campaign import load_campaign

    campaign = load_campaign(config)
    if replay is not None:
        return show_trial(campaign, parse_trial(replay, campaign), output)
    if trials is not None:
        campaign = replace(campaign, trials=trials)
    folder = output or Path(f"robustness-{campaign.name}")
    check_directory(folder)
    check_replaceable(folder / "report.html")
    check_file(markdown, (".md",), "The document")
    from sims.robustness.report import html_report, markdown_tables, text_summary
    from sims.robustness.run import run_campaign
    from sims.robustness.summary import summarise
    from sims.robustness.tables import sentences
    from srt.comparison.parallel import Engine
    from srt.recording.atomic_file import atomic_write_text
    from srt.recording.file_marks import write_marked_text
    from srt.reports.tables import wrap

    with count_progress(campaign.name, quiet=quiet) as progress:
        try:
            table = run_campaign(campaign, folder, engine=Engine(workers, scheduler), fresh=fresh, progress=progress)
        except KeyboardInterrupt:
            say(f"Interrupted: finished trials are kept in {folder}, and the same command resumes the campaign.")
            raise
    found = summarise(table, header_of(campaign, config))
    atomic_write_text(folder / "report.html", html_report(found))
    if markdown is not None:
        write_marked_text(markdown, markdown_tables(found))
    if not quiet:
        show(rendered(_narrow(text_summary(found))))
        show("\n".join(line for sentence in sentences(found) for line in wrap(sentence)))
        show(f"\nWritten: {folder / 'report.html'}, {folder / 'results.parquet'}")
    return 0


def header_of(campaign: Campaign, config: str) -> Header:
    """Header of the report of a campaign.

    Parameters
    ----------
    config : str
        Name of the campaign on the command line.
    """
    from sims.robustness.trial_table import Header

    return Header(
        name=campaign.name,
        description=campaign.description,
        seed=campaign.seed,
        trials=campaign.trials,
        grid=campaign.grid,
        random={key: str(table) for key, table in campaign.random.items()},
        estimators=tuple(e.label for e in campaign.estimators),
        noisy=campaign.noisy,
        trials_per_motion=campaign.trials_per_motion,
        replay=f"srt robustness {config} --replay ",
    )


def parse_trial(text: str, campaign: Campaign) -> tuple[int, int]:
    """Point and number of a trial from POINT:TRIAL.

    Raises
    ------
    InputError
        A text of another form, or a point that the grid does not have.
    """
    point, _, number = text.partition(":")
    if not (point.isdecimal() and number.isdecimal()):
        raise InputError(f"--replay {text} is not POINT:TRIAL, two whole numbers as the report lists them.")
    if int(point) >= len(campaign.points):
        raise InputError(f"--replay {text}: the points of {campaign.name} are 0 to {len(campaign.points) - 1}.")
    return int(point), int(number)


def show_trial(campaign: Campaign, task: tuple[int, int], output: Path | None) -> int:
    """Repeat one trial; write its recording if asked to, and print its results."""
    from sims.robustness.tables import NOISE_FREE
    from sims.robustness.trial import run_trial
    from srt.reports.tables import wrap

    scenario, values = campaign.unit(*task)
    show("\n".join(f"{key} = {value}" for key, value in values.items()))
    if output is not None:
        from sims import simulate
        from srt.cli.simulate import write_simulation

        overwrite = overwrite_allowed()
        check_recording_target(output, overwrite=overwrite)
        write_simulation(simulate(scenario), output, samples_format=scenario.recording.format, overwrite=overwrite)
        show(f"Written: {output}; 'srt calibrate {output} --truth {output / 'truth.json'}' tries it again.")
    rows = [("estimator", "outcome", "iterations", "largest error / sigma", "message")]
    for row in run_trial(campaign, task):
        largest = row.get("largest")
        shown = "" if largest is None else f"{largest:.3g}"
        rows.append((row["estimator"], row["outcome"], str(row.get("playbacks", "")), shown, row.get("message", "")))
    show(rendered([row[:-1] for row in rows]))
    for label, *_, message in rows[1:]:
        if message:
            show(f"{label}: {message}")
    if not campaign.noisy:
        show("\n".join(wrap(NOISE_FREE)))
    return 0


def _narrow(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Columns for a terminal: without ranges, and without outcomes that no trial had."""
    shown = [
        k
        for k, column in enumerate(zip(*rows, strict=True))
        if column[0] in _ALWAYS or (set(column[1:]) != {"0"} and "95 %" not in column[0])
    ]
    return [tuple(row[k] for k in shown) for row in rows]


def rendered(rows: list[tuple[str, ...]]) -> str:
    """Format a table; the first row is the heading, the first column left-justified."""
    from srt.reports.tables import text_table

    heads = [head.replace(" ", "\n") for head in rows[0]]
    return text_table(heads, rows[1:], "l" + "r" * (len(heads) - 1))
