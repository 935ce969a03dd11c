"""``srt calibrate``: sensor errors from recordings, each with its result."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from srt.cli.calibration_jobs import Display, Job, draw, plan, plan_fleet, plan_folder, plan_merging
from srt.cli.convert import GROUPS as LOG_GROUPS
from srt.cli.convert import log_options, log_remedy
from srt.cli.export import writable_targets
from srt.cli.fleet import FLEET_FROM, FleetEngine, run_fleet
from srt.cli.grouped_command import GroupedCommand
from srt.cli.logs import take_log
from srt.cli.merge import run_merging
from srt.cli.messages import announce, is_seen, say, show, warn
from srt.cli.names import Name
from srt.cli.output_paths import RESULT_SUFFIXES, make_directory, require_matplotlib
from srt.cli.overwriting import TOML, is_unchanged, overwrite_option
from srt.cli.path_type import PATH
from srt.cli.recording_arguments import find_recordings
from srt.exceptions import DataError, InputError, SrtError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from click.decorators import FC

    from srt.diagnosis.fitness import Fitness
    from srt.estimation.options import Options
    from srt.model.prior import Prior
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

# Option types of srt.estimation.options, written out: importing them would make the help wait for numpy.
CHOICES = {
    "average": ("linear", "overlapping"),
    "down": ("tilt-immune", "paper"),
    "window_attitude": ("held", "integrated"),
    "gyro_bias": ("auto", "pooled", "per-sequence", "g-sensitive"),
    "step": ("jacobian", "coefficients"),
    "start": ("auto", "zero"),
    "loss": ("squared", "huber", "cauchy"),
    "filter": ("iterated", "per-sequence", "one-pass", "covariance", "unscented"),
}
"""Values of the options of the estimators; the first is the default."""


def choice_option(flag: str, text: str) -> Callable[[FC], FC]:
    """Option of the estimators with its values and its help."""
    values = CHOICES[flag.removeprefix("--").replace("-", "_")]
    return click.option(flag, type=click.Choice(values), default=values[0], show_default=True, help=text)


GROUPS = {
    "Fixture and sensors": ("no_asymmetry", "without_turn", "hold", "gyro_bias", "no_fixture_states", "ignore_moves"),
    "Fleet": ("workers", "scheduler"),
    "Expert": (
        "average", "down", "window_attitude", "step", "start", "max_playbacks", "loss", "filter", "prior", "live",
        "target", "force", "trust",
    ),
    **{f"Log: {title.lower()}": names for title, names in LOG_GROUPS.items()},
}  # fmt: skip
"""Groups of options in the help."""


USUAL = (
    "estimator", "output", "targets", "plot", "details", "merge", "protocol", "no_asymmetry", "workers", "loss",
    "quiet",
)  # fmt: skip
"""Options of the short help."""


@click.command(cls=GroupedCommand, usual=USUAL, groups=GROUPS)
@click.argument("recordings", nargs=-1, required=True, type=PATH, metavar="RECORDING...")
@click.option(
    "--estimator",
    type=Name("estimators", "auto"),
    default="auto",
    show_default=True,
    metavar="NAME",
    help="auto, closed-form, least-squares, ekf, graph, or another that is installed.",
)
@click.option("-o", "--output", type=PATH, help="Result: FILE.json, or a folder for several.")
@click.option(
    "--to",
    "targets",
    multiple=True,
    metavar="TARGET",
    help="Also write for this tool (srt export --list) to the folder -o; repeatable.",
)
@click.option("--plot", type=PATH, help="Figure: FILE.png, .pdf or .svg.")
@click.option("--details", is_flag=True, help="Show sources of sigma, sequences and residuals, too.")
@click.option("--budget", is_flag=True, help="As --details, with all sources of sigma instead of three.")
@click.option("--verdict", is_flag=True, help="As --details, with the observability of every parameter.")
@click.option("--merge", is_flag=True, help="Merge recordings or calibrations (.json) of one unit into one result.")
@click.option(
    "--protocol",
    type=Name("protocols", file=True),
    metavar="NAME",
    help="Protocol of the test in place of labels: a shipped one (srt list protocols), or FILE.toml.",
)
@click.option(
    "--without-turn",
    multiple=True,
    metavar="N",
    help="Leave out a turn or pose by its number, or all runs of a sequence by its id.",
)
@click.option("--truth", type=PATH, help="truth.json of a simulated recording: show errors.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No progress and no table; warnings and errors only.")
@click.option("--no-asymmetry", is_flag=True, help="Fix the gyro scale-factor asymmetries at zero.")
@click.option(
    "--hold", multiple=True, metavar="NAME", help="Fix a parameter or a group, as gyro_scale_x or accel_bias."
)
@choice_option("--gyro-bias", "Model of the gyro bias.")
@click.option("--no-fixture-states", is_flag=True, help="ekf and graph: do not estimate north, mounting and gravity.")
@click.option("--ignore-moves", is_flag=True, help="Use no recorded moves between the sequences.")
@click.option(
    "--workers",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    metavar="N",
    help="Units calibrated in parallel; 0: one on each core.",
)
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, as tcp://host:8786.")
@choice_option("--average", "Average over a stationary window.")
@choice_option("--down", "Form of the down measurement.")
@choice_option("--window-attitude", "Attitude in the stationary windows: constant, or integrated.")
@choice_option("--step", "Step of the closed form: full Jacobian, or the coefficients of the paper.")
@choice_option("--start", "Initial estimate: from the fixture, or zero.")
@click.option(
    "--max-playbacks", type=click.IntRange(min=1), default=40, show_default=True, metavar="N", help="Most iterations."
)
@choice_option("--loss", "Loss function of graph.")
@choice_option("--filter", "Form of ekf, for comparison: iterated or not, covariance form, unscented.")
@click.option(
    "--prior", type=PATH, metavar="FILE.json", help="Earlier calibration of the unit as prior of ekf or graph."
)
@click.option("--live", is_flag=True, help="ekf: estimate after every sequence, as during the test.")
@click.option(
    "--target",
    multiple=True,
    metavar="NAME=SIGMA",
    help="ekf: sigma wanted of a parameter or group in ppm, µrad, µg or °/h, as gyro_scale=1.",
)
@click.option("--force", is_flag=True, help="Calibrate in spite of a fault of the recording.")
@click.option("--trust", is_flag=True, help="Accept a calibration file that was changed after it was written.")
@log_options
def calibrate(
    recordings: tuple[Path, ...],
    estimator: str,
    output: Path | None,
    merge: bool,
    plot: Path | None,
    truth: Path | None,
    details: bool,
    budget: bool,
    verdict: bool,
    quiet: bool,
    workers: int,
    scheduler: str | None,
    force: bool,
    trust: bool,
    protocol: str | None,
    without_turn: tuple[str, ...],
    **choices: Any,
) -> int:
    """Calibrate the unit of each RECORDING, a folder with recording.toml and samples, or a log in another format.

    A log takes the options of 'srt convert', by which units, gravity and site are stated. -o FOLDER then keeps the
    recording made of it, the calibration with its picture, and a file for each tool that --to names; a second run reads
    FOLDER/recording, with what was entered in its recording.toml. -o FILE.json keeps the calibration alone.

    A folder that contains recordings, at any depth, stands for all of them, and so does a pattern in quotes, as
    'lot-7/*'. Those, more than five recordings, and several with --workers or --scheduler, are a fleet: one table shows
    all units and marks outliers; -o FOLDER writes it as fleet.csv and fleet.json beside the results.

    The table goes to standard output; -o writes the whole result, with its covariance, as JSON. With several
    recordings, -o names a folder, --plot inserts the name of each recording before the ending, a recording that fails
    does not stop the others, and the exit code is the worst. --merge takes recordings of one unit and gives one result
    with their repeatability.

    The verdict is sound (the residuals agree with the sensors' own noise), partial (they do, but parameters that such
    a recording should show are not observed), doubtful (they do not agree, and the sigmas were enlarged) or failed (the
    measurements contradict each other, not converged, or outside the model).

    Exit codes: 0 sound, or partial or doubtful with a warning; 1 failed (written with that
    status), or data that cannot support a result; 2 wrong usage or unreadable input.
    """
    found = find_recordings(recordings, files=RESULT_SUFFIXES if merge else ())
    shared = scheduler is not None or (workers != 1 and len(found.paths) > 1)
    fleet = not merge and (found.searched or shared or len(found.paths) >= FLEET_FROM)
    jobs = choose_jobs(found.paths, output, plot, choices, merge=merge, fleet=fleet)
    # Whatever can be refused without the samples is refused before they are read.
    one_truth = merge or not (fleet or len(jobs) > 1)
    tables = details or budget or verdict
    refuse_combinations(
        (bool(truth) and not one_truth, "The option --truth belongs to one recording: calibrate the others apart."),
        (
            merge and choices["prior"] is not None,
            "--merge and --prior do not go together: the prior would count with every recording.",
        ),
        (merge and shared, "--merge goes without --workers and --scheduler: its recordings are calibrated in turn."),
        (
            fleet and protocol is not None,
            "--protocol belongs to few recordings: for a fleet, name it in each recording.toml.",
        ),
        (
            bool(without_turn) and (merge or len(jobs) > 1),
            "--without-turn belongs to one recording: calibrate the others apart.",
        ),
        (
            fleet and tables,
            "--details, --budget and --verdict belong to the tables of few recordings: a fleet has one for all.",
        ),
    )
    options = parse_options(choices, trust=trust)
    check_tools(estimator, plot)
    from srt.cli.truth import load_truth
    from srt.recording.protocol import load_protocol

    known = None if protocol is None else load_protocol(protocol)
    true_errors = None if truth is None else load_truth(truth)
    if fleet:
        engine = FleetEngine(workers, scheduler)
        return run_fleet(jobs, estimator, options, engine=engine, output=output, quiet=quiet, force=force)
    display = Display(true_errors, details, budget, verdict, quiet, force, trust, known, without_turn)
    if merge:
        return run_merging(jobs, estimator, options, display, output, plot)
    return run_each(jobs, estimator, options, display, output)


def choose_jobs(
    paths: Sequence[Path], output: Path | None, plot: Path | None, choices: dict[str, Any], *, merge: bool, fleet: bool
) -> tuple[Job, ...]:
    """Jobs with the paths of their results, which can be written; the options of a log are taken out of the choices.

    Raises
    ------
    InputError
    """
    log, targets = take_log(paths, choices), choices.pop("targets")
    if log is None and not targets:
        return (plan_merging if merge else plan_fleet if fleet else plan)(paths, output, plot)
    if merge or fleet or (log is None and len(paths) > 1):
        what = "--to belongs to one recording" if log is None else f"{log.path} is a log, which is calibrated alone"
        raise InputError(f"{what}: leave out --merge, --scheduler and other recordings.")
    return plan_folder(paths[0], output, plot, log, targets)


def refuse_combinations(*rules: tuple[bool, str]) -> None:
    """Raise InputError with the sentence of the first rule that is broken."""
    for broken, sentence in rules:
        if broken:
            raise InputError(sentence)


def parse_options(choices: dict[str, Any], *, trust: bool) -> Options:
    """Options of the estimators from those of the command line."""
    from srt.estimation.options import Options

    prior, target = choices.pop("prior"), choices.pop("target")
    return Options(
        asymmetry=not choices.pop("no_asymmetry"),
        fixture_states=not choices.pop("no_fixture_states"),
        prior=None if prior is None else load_prior(prior, trust=trust),
        targets=parse_targets(target),
        **choices,
    )


def check_tools(estimator: str, plot: Path | None) -> None:
    """Raise InputError if the estimator, or matplotlib for a plot, is not installed."""
    from srt.estimation.registry import find_estimator

    if estimator != "auto":
        find_estimator(estimator)
    if plot is not None:
        require_matplotlib()


def run_each(jobs: Sequence[Job], estimator: str, options: Options, display: Display, output: Path | None) -> int:
    """Calibrate, write and print one recording after the other; give the worst exit code."""
    if len(jobs) > 1 and output is not None:
        make_directory(output)
    codes = []
    for number, job in enumerate(jobs):
        if number and not display.quiet:
            show()
        try:
            recording = display.load(job)
            if job.log is not None and not display.quiet:
                show(f"{inspected(job, recording)}\n")
            targets, refused = writable_targets(job.targets, recording)
            calibration = run_job(job, estimator, options, display, recording)
        except SrtError as error:
            sentence = reworded(job, str(error))
            named = len(jobs) == 1 or str(job.recording) in sentence
            say(sentence if named else f"{job.recording}: {sentence}")
            codes.append(error.exit_code)
        else:
            seen = is_seen(quiet=display.quiet)
            files = write_files(replace(job, targets=targets), calibration, recording, display)
            codes.append(max(report_problems(job, calibration, seen=seen), files, refused))
    if not display.quiet and min(codes) == 0:
        more = "" if display.complete else "--details shows more. "
        rest = "Nothing was written: -o FILE.json keeps the result." if output is None else ""
        if more or rest:
            # The names of written files follow an empty line already; one more would exceed the 45 lines of a summary.
            named = jobs[-1].output is not None or jobs[-1].plot is not None
            show(("" if named else "\n") + f"{more}{rest}".rstrip())
    return max(codes)


def load_prior(path: Path, *, trust: bool) -> Prior:
    """Prior from the file of an earlier calibration.

    Raises
    ------
    InputError
        A file that cannot be read, or a calibration that did not converge.
    """
    from srt.model.prior import Prior
    from srt.result.calibration import load_calibration
    from srt.result.verdict import FAILED

    calibration = load_calibration(path, trust=trust)
    calibration.require_one_temperature()
    if calibration.judgement.word == FAILED:
        raise InputError(f"The prior {path} has the status {calibration.status}: give a calibration that converged.")
    return Prior.from_calibration(calibration)


def parse_targets(texts: Sequence[str]) -> dict[str, float]:
    """Targets of the command line, NAME=SIGMA in ppm, µrad, µg or °/h, in SI.

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


def run_job(
    job: Job, estimator: str, options: Options, display: Display, recording: Recording | None = None
) -> Calibration:
    """Calibrate one recording; write and print the result, whatever its status.

    Parameters
    ----------
    recording : Recording, optional
        That of the job, if it was read before.

    Raises
    ------
    SrtError
        Errors of :func:`srt.read`, :func:`srt.calibrate` and of writing.
    """
    import srt
    from srt.cli.progress import iteration_progress

    recording = recording or display.load(job)
    silent = display.quiet or job.log is not None  # the overview of a log tells it
    with iteration_progress(job.name, quiet=display.quiet) as progress:
        calibration = srt.calibrate(
            recording,
            estimator,
            force=display.force,
            without_turns=display.without,
            options=options,
            progress=progress,
            announce=None if silent else _show_fitness,
        )
    if job.output is not None:
        if job.targets:
            make_directory(job.output.parent)
        calibration.save(job.output)
    if not display.quiet:
        show(display.text(calibration, str(job.recording), str(job.recording)))
    draw(calibration, job.plot, job.name, display.truth)
    announce(job.output, job.plot, quiet=display.quiet)
    return calibration


def _show_fitness(fitness: Fitness) -> None:
    """Print the fitness of a recording, in lines of at most 80 characters."""
    from srt.reports.tables import wrap

    # An output that cannot be written is told after the result is saved.
    with suppress(InputError, BrokenPipeError):
        show("\n".join(wrap(str(fitness))))


def inspected(job: Job, recording: Recording) -> str:
    """Overview of a recording that was made of a log, and its faults."""
    from srt.reports.inspection import inspect
    from srt.reports.text.inspection import inspection_summary

    return inspection_summary(inspect(recording), title=str(job.recording), reworded=partial(reworded, job))


def reworded(job: Job, sentence: str) -> str:
    """Sentence on a fault; for a recording that is as it was made of a log, with the option in place of the key."""
    toml = job.recording / TOML
    if job.log is None or (toml.exists() and not is_unchanged(toml)):
        return sentence
    return log_remedy(sentence, job.log.given.get("kind"))


def write_files(job: Job, calibration: Calibration, recording: Recording, display: Display) -> int:
    """Write a calibration for other tools, unless it failed; give the worst exit code."""
    from srt.cli.export import write_targets
    from srt.result.verdict import FAILED

    if not job.targets or job.output is None or (calibration.judgement.word == FAILED and not display.force):
        return 0
    return write_targets(calibration, job.output.parent, job.targets, recording, quiet=display.quiet)


def report_problems(job: Job, calibration: Calibration, *, seen: bool) -> int:
    """Print what is wrong with a result, unless its report was ``seen``; give the exit code of its status."""
    from srt.reports.text.calibration import held_summary
    from srt.result.verdict import DOUBTFUL, FAILED, PARTIAL

    judgement = calibration.judgement
    if judgement.word == FAILED and not seen:
        kept = f"; {job.output} holds it with that status" if job.output is not None else ""
        say(f"{job.recording}: {calibration.message.rstrip('.')}{kept}.")
    if judgement.word == FAILED:
        return DataError.exit_code
    if judgement.word == DOUBTFUL and not seen:
        warn(f"{job.recording}: {judgement}")
    clauses = ["the verdict is partial"] * (judgement.word == PARTIAL and not seen)
    clauses += [f"{title} is void ({reason})" for title, reason in calibration.provenance.voided.items()]
    if calibration.fixed and not seen:
        clauses.append(f"fixed, not observed: {held_summary(calibration)}")
    if clauses:
        warn(f"{job.recording}: {'; '.join(clauses)}.")
    return 0
