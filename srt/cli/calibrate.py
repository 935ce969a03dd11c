"""``srt calibrate``: sensor errors from recordings, each judged and kept on its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from srt.cli.fleet import FLEET_FROM, run_fleet
from srt.cli.jobs import RESULT_SUFFIXES, Display, Job, plan, plan_fleet, plan_merging
from srt.cli.output import make_directory, require_matplotlib, say, warn
from srt.cli.recordings import find_recordings
from srt.exceptions import DataError, InputError, SrtError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.estimation.options import Options
    from srt.model.prior import Prior
    from srt.result.calibration import Calibration

# The option types of srt.estimation.options, written out: importing them here would make help wait for numpy.
CHOICES = {
    "average": ("linear", "overlapping"),
    "down": ("tilt-immune", "paper"),
    "window_attitude": ("held", "integrated"),
    "gyro_bias": ("auto", "pooled", "per-sequence", "g-sensitive"),
    "step": ("jacobian", "coefficients"),
    "start": ("auto", "zero"),
    "loss": ("squared", "huber", "cauchy"),
}


@click.command()
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RECORDING...")
@click.option(
    "--estimator",
    default="auto",
    show_default=True,
    metavar="NAME",
    help="auto, closed-form, least-squares, ekf, graph, or another that is installed.",
)
@click.option("--no-asymmetry", is_flag=True, help="Hold the gyro scale-factor asymmetries.")
@click.option(
    "--hold",
    multiple=True,
    metavar="NAME",
    help="Hold a parameter or a group, as gyro_scale_x or accel_bias; repeatable.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Result: FILE.json, or a folder for several.")
@click.option(
    "--merge",
    is_flag=True,
    help="Several recordings of one unit to one calibration; calibrations (.json) may stand for recordings.",
)
@click.option("--plot", type=click.Path(path_type=Path), help="Figure: FILE.png, .pdf or .svg.")
@click.option("--truth", type=click.Path(path_type=Path), help="truth.json of a simulated recording, to compare with.")
@click.option("--budget", is_flag=True, help="Show all sources of sigma, not the three largest.")
@click.option("--verdict", is_flag=True, help="Show what every parameter rests on, too.")
@click.option("--average", type=click.Choice(CHOICES["average"]), default="linear", show_default=True)
@click.option("--down", type=click.Choice(CHOICES["down"]), default="tilt-immune", show_default=True)
@click.option("--window-attitude", type=click.Choice(CHOICES["window_attitude"]), default="held", show_default=True)
@click.option(
    "--gyro-bias",
    type=click.Choice(CHOICES["gyro_bias"]),
    default="auto",
    show_default=True,
    help="g-sensitive: with what the gyros follow specific force by; closed-form and least-squares.",
)
@click.option("--step", type=click.Choice(CHOICES["step"]), default="jacobian", show_default=True)
@click.option("--start", type=click.Choice(CHOICES["start"]), default="auto", show_default=True)
@click.option("--max-playbacks", type=click.IntRange(min=1), default=20, show_default=True, metavar="N")
@click.option("--loss", type=click.Choice(CHOICES["loss"]), default="squared", show_default=True, help="Of graph.")
@click.option(
    "--prior",
    type=click.Path(path_type=Path),
    metavar="FILE.json",
    help="An earlier calibration of the unit that ekf or graph start from, with its sigmas.",
)
@click.option(
    "--no-fixture-states",
    is_flag=True,
    help="ekf and graph: take north, mounting and gravity as stated instead of estimating them.",
)
@click.option("--live", is_flag=True, help="ekf: as the test would run, all sequences so far after each.")
@click.option(
    "--target",
    multiple=True,
    metavar="NAME=SIGMA",
    help="ekf: sigma wanted of a parameter or group, in the table's unit, as gyro_scale=1; repeatable.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    metavar="N",
    help="Units calibrated at a time; 0 for as many as there are cores.",
)
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers calibrate, as tcp://host:8786.")
@click.option("--force", is_flag=True, help="Calibrate though a fault of the recording speaks against it.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no table; warnings and errors only.")
def calibrate(
    recordings: tuple[Path, ...],
    estimator: str,
    no_asymmetry: bool,
    output: Path | None,
    merge: bool,
    plot: Path | None,
    truth: Path | None,
    budget: bool,
    verdict: bool,
    quiet: bool,
    force: bool,
    prior: Path | None,
    no_fixture_states: bool,
    target: tuple[str, ...],
    workers: int,
    scheduler: str | None,
    **choices: Any,
) -> int:
    """Calibrate the unit of each RECORDING, a folder with recording.toml and samples.

    A folder that holds recordings, however deep, stands for all of them, and so does a pattern in quotes, as
    'lot-7/*'. Those, more than five recordings, and several with --workers or --scheduler, are a fleet: one table of
    all units, with those marked that are outlying against the others; -o FOLDER keeps it as fleet.csv and fleet.json
    beside the results.

    The table goes to standard output; -o keeps the whole result, with its covariance, as JSON. With several
    recordings -o names a folder, --plot gets the recordings' names before its ending, a recording that fails
    does not stop the others, and the exit code is the worst. With --merge they are recordings of one unit: -o gets
    the one calibration merged of them, and how well they repeat is shown.

    Exit codes: 0 converged, or partial (some parameters held, with a warning); 1 not converged or outside the
    model (written all the same, with that status), or data that cannot support a result; 2 wrong usage or
    unreadable input.
    """
    found = find_recordings(recordings, files=RESULT_SUFFIXES if merge else ())
    shared = scheduler is not None or (workers != 1 and len(found.paths) > 1)
    fleet = not merge and (found.searched or shared or len(found.paths) >= FLEET_FROM)
    jobs = (plan_merging if merge else plan_fleet if fleet else plan)(found.paths, output, plot)
    # Everything that can be refused without the samples is refused before they are read.
    refusals = (
        (
            truth and not merge and (fleet or len(jobs) > 1),
            "The option --truth belongs to one recording: calibrate the others apart.",
        ),
        (merge and prior, "--merge and --prior do not go together: the prior would count with every recording."),
        (merge and shared, "--merge goes without --workers and --scheduler: its recordings are calibrated in turn."),
        (
            fleet and (budget or verdict),
            "--budget and --verdict belong to the tables of few recordings: a fleet has one for all.",
        ),
    )
    for refused, sentence in refusals:
        if refused:
            raise InputError(sentence)
    from srt.estimation.options import Options
    from srt.estimation.registry import find_estimator

    options = Options(
        asymmetry=not no_asymmetry,
        fixture_states=not no_fixture_states,
        prior=None if prior is None else load_prior(prior),
        targets=parse_targets(target),
        **choices,
    )
    if estimator != "auto":
        find_estimator(estimator)
    if plot is not None:
        require_matplotlib()
    true_errors = None
    if truth is not None:
        from srt.cli.truth import load_truth

        true_errors = load_truth(truth)
    if fleet:
        return run_fleet(
            jobs,
            estimator,
            options,
            workers=workers,
            scheduler=scheduler,
            output=output,
            quiet=quiet,
            force=force,
        )
    display = Display(true_errors, budget, verdict, quiet, force)
    if merge:
        from srt.cli.merge import run_merging

        return run_merging(jobs, estimator, options, display, output, plot)
    return run_each(jobs, estimator, options, display, output)


def run_each(jobs: Sequence[Job], estimator: str, options: Options, display: Display, output: Path | None) -> int:
    """Calibrate, write and show one recording after the other, and give the worst exit code."""
    if len(jobs) > 1 and output is not None:
        make_directory(output)
    codes = []
    for number, job in enumerate(jobs):
        if number and not display.quiet:
            click.echo()
        try:
            calibration = run_job(job, estimator, options, display)
        except SrtError as error:
            sentence = str(error)
            named = len(jobs) == 1 or str(job.recording) in sentence
            say(sentence if named else f"{job.recording}: {sentence}")
            codes.append(error.exit_code)
        else:
            codes.append(judge(job, calibration))
    if output is None and not display.quiet and min(codes) == 0:
        click.echo("\nNothing was written: -o FILE.json keeps the result.")
    return max(codes)


def load_prior(path: Path) -> Prior:
    """Prior from the file of an earlier calibration.

    Raises
    ------
    InputError
        What :func:`srt.load_calibration` raises, and a calibration that did not converge.
    """
    from srt.model.prior import Prior
    from srt.result.calibration import load_calibration

    calibration = load_calibration(path)
    if calibration.status not in ("converged", "partial"):
        raise InputError(f"The prior {path} has the status {calibration.status}: give a calibration that converged.")
    return Prior.from_calibration(calibration)


def parse_targets(texts: Sequence[str]) -> dict[str, float]:
    """Targets of the command line, NAME=SIGMA in the units of the table, in SI.

    Raises
    ------
    InputError
        A text of another form.
    """
    from srt.sensor_errors import DISPLAY_FACTORS, INDEX, expand_names

    targets = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            sigma = float(number)
        except ValueError:
            raise InputError(f"The target {text!r} is not NAME=SIGMA, as gyro_scale=1 (ppm).") from None
        for parameter in expand_names([name]):
            targets[parameter] = sigma / DISPLAY_FACTORS[INDEX[parameter]]
    return targets


def run_job(job: Job, estimator: str, options: Options, display: Display) -> Calibration:
    """Calibrate one recording; write and show what came out, whatever its status.

    Parameters
    ----------
    job : Job
    estimator : str
    options : Options
    display : Display

    Returns
    -------
    Calibration

    Raises
    ------
    SrtError
        What :func:`srt.load_recording`, :func:`srt.calibrate` and the writing raise.
    """
    import srt
    from srt.cli.progress import playback_progress
    from srt.reports.text.calibration import report

    recording = srt.load_recording(job.recording)
    with playback_progress(job.name, quiet=display.quiet) as progress:
        calibration = srt.calibrate(recording, estimator, options=options, progress=progress, force=display.force)
    if job.output is not None:
        calibration.save(job.output)
    if not display.quiet:
        click.echo(
            report(
                calibration,
                title=str(job.recording),
                truth=display.truth,
                budget=display.budget,
                verdict=display.verdict,
            )
        )
    if job.plot is not None:
        from srt.reports.figures.calibration import calibration_figure, save_figure

        save_figure(calibration_figure(calibration, truth=display.truth, title=job.name), job.plot)
    written = [str(path) for path in (job.output, job.plot) if path is not None]
    if written and not display.quiet:
        click.echo(f"\nWritten: {', '.join(written)}")
    return calibration


def judge(job: Job, calibration: Calibration) -> int:
    """Say what is wrong with a result, and give the exit code of its status."""
    from srt.reports.text.calibration import held_summary

    if calibration.status not in ("converged", "partial"):
        kept = f"; {job.output} holds it with that status" if job.output is not None else ""
        say(f"{job.recording}: {calibration.message.rstrip('.')}{kept}.")
        return DataError.exit_code
    voided = calibration.provenance.get("voided", {})
    clauses = [f"{title} is void ({reason})" for title, reason in voided.items()]
    if calibration.held:
        clauses.append(f"held, not observed: {held_summary(calibration)}")
    if clauses:
        warn(f"{job.recording}: {'; '.join(clauses)}.")
    return 0
