"""``srt compare``: several estimators on one recording, with a test of their agreement."""

from __future__ import annotations

import json
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from srt.cli.calibrate import calibrate as calibrate_command
from srt.cli.messages import announce, figure_title, is_seen, say, show, warn
from srt.cli.names import Name
from srt.cli.output_paths import RESULT_SUFFIXES, check_file, check_plot, recording_folder
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.exceptions import DataError, InputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from srt.comparison.estimator_comparison import Comparison
    from srt.estimation.options import Options
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

SHARED_OPTIONS = ("no_asymmetry", "hold", "ignore_moves", "average", "start", "max_playbacks")
"""Options of ``srt calibrate`` that have the same meaning for every estimator."""

_FOREIGN_TRUTH = 10.0
"""RMS of error over sigma above which estimates that agree suggest that the truth is of another recording."""


@click.command()
@click.argument("arguments", nargs=-1, required=True, type=PATH, metavar="[CALIBRATION] RECORDING")
@click.option(
    "--with",
    "other",
    metavar="FILE",
    help="Compare CALIBRATION with this file of another program, as FILE or FORMAT:FILE.",
)
@click.option(
    "--estimator",
    "names",
    type=Name("estimators"),
    multiple=True,
    metavar="NAME",
    help="closed-form, least-squares, ekf, graph, or another that is installed; repeatable. "
    "Default: all of these that can run here and on this recording.",
)
@click.option(
    "--reference",
    type=Name("estimators"),
    metavar="NAME",
    help="Estimate that the others are compared with. Default: the first of "
    "graph, ekf, least-squares, closed-form that ran.",
)
@click.option("-o", "--output", type=PATH, help="Result: FILE.json.")
@click.option("--plot", type=PATH, help="Figure: FILE.png, .pdf or .svg.")
@click.option("--truth", type=PATH, help="truth.json of a simulated recording: show errors.")
@click.option("--details", is_flag=True, help="Show the estimates and sigmas of all estimators (120 columns).")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No progress and no tables; warnings and errors only.")
def compare(
    arguments: tuple[Path, ...],
    other: str | None,
    names: tuple[str, ...],
    reference: str | None,
    output: Path | None,
    plot: Path | None,
    truth: Path | None,
    details: bool,
    quiet: bool,
    no_asymmetry: bool,
    **choices: Any,
) -> int:
    """Calibrate the unit of RECORDING with several estimators, and test whether they agree.

    Estimates from the same data differ by less than their sigmas. A difference is compared with its expected standard
    deviation, which follows from the two covariances if the reference is efficient. The false-alarm rate is 1 in 100
    recordings.

    With --with, the parameters of CALIBRATION, a JSON file of 'srt calibrate -o', stand beside those of another
    program's file (any that 'srt export' writes and that holds scale factors and misalignment), in sigma and in the
    same axes, with the residuals at rest and over the turns of RECORDING that both leave, and those of raw readings.

    Exit codes: 0 all that ran converged (or partial) and agree; 1 they disagree, some are doubtful and others sound,
    one failed or did not converge, or fewer than two can run; 2 wrong usage or unreadable input. With --with: 0
    compared, whatever the differences; 1 fewer than two rests in RECORDING; 2 wrong usage or unreadable input.
    """
    # Whatever can be refused without the samples is refused before they are read.
    if other is not None:
        refuse_others(arguments)
        return run_other(arguments[0], arguments[1], other, output, quiet=quiet)
    if len(arguments) > 1:
        raise InputError(f"One recording is compared at a time, and {arguments[1]} is another: add --with FILE?")
    recording = arguments[0]
    check_file(output, RESULT_SUFFIXES, "The result")
    check_plot(plot)
    from srt.estimation.options import Options
    from srt.estimation.registry import ESTIMATORS

    names = tuple(dict.fromkeys(names))
    check_names(names, ESTIMATORS, reference)
    options = Options(asymmetry=not no_asymmetry, **choices)
    comparison = run(recording, names, reference, truth, options, quiet=quiet)
    folder = recording_folder(recording)
    if output is not None:
        comparison.save(output)
    if not quiet:
        from srt.reports.text.estimator_comparison import comparison_text

        show(comparison_text(comparison, title=str(recording), details=details))
    if plot is not None and comparison.reference is not None:
        from srt.reports.figures.calibration import save_figure
        from srt.reports.figures.comparison import comparison_figure

        save_figure(comparison_figure(comparison, title=figure_title(folder.resolve().name)), plot)
    announce(output, plot if comparison.reference is not None else None, quiet=quiet)
    return report_problems(comparison, recording, seen=is_seen(quiet=quiet))


# Options of 'srt calibrate' themselves, so that an option has one meaning in both commands.
compare.params += [p for p in calibrate_command.params if p.name in SHARED_OPTIONS]


def refuse_others(arguments: Sequence[Path]) -> None:
    """Raise InputError for a wrong number of arguments beside --with, or an option that belongs to estimators."""
    if len(arguments) != 2:
        raise InputError("--with compares files: give CALIBRATION and RECORDING, as 'compare unit.json recording'.")
    context = click.get_current_context()
    for parameter in context.command.params:
        name = parameter.name or ""
        given = context.get_parameter_source(name) is not ParameterSource.DEFAULT
        if given and name not in ("arguments", "other", "output", "overwrite", "quiet"):
            raise InputError(f"{parameter.opts[0]} belongs to a comparison of estimators: leave it out, or --with.")


def run_other(calibration_file: Path, path: Path, other: str, output: Path | None, *, quiet: bool) -> int:
    """Compare a calibration with another program's file on a recording. Raises SrtError."""
    check_file(output, RESULT_SUFFIXES, "The result")
    from srt.cli.apply import check_match, load_fit
    from srt.comparison.other_calibration import compare_with
    from srt.exporters.conversion import load_any
    from srt.exporters.registry import exporter
    from srt.recording.applied import NOTHING
    from srt.recording.folder import load_recording
    from srt.reports.text.other_calibration import other_calibration_text
    from srt.result.json_file import save_json_file

    calibration = load_fit(calibration_file, force=False, trust=False)
    target, loaded = load_any(other)
    recording = load_recording(path)
    check_match(calibration, recording, calibration_file, path)
    if exporter(target).find_applied and (recording.applied is None or recording.applied.system != NOTHING):
        raise InputError(
            f"A {target} file works on the readings of the sensors themselves, and {path} does not say that its "
            'readings are such: state it by [imu.applied] system = "none" in its recording.toml.'
        )
    found = compare_with(calibration, loaded, recording)
    if output is not None:
        save_json_file(output, found.as_dict())
    if not quiet:
        show(other_calibration_text(found, calibration_file.name, PurePath(other).name, str(path)))
    announce(output, quiet=quiet)
    return 0


def check_names(names: Sequence[str], default: Sequence[str], reference: str | None) -> None:
    """Check the names of the estimators before data are read.

    Parameters
    ----------
    names : sequence of str
        Names asked for; empty: the default.

    Raises
    ------
    InputError
        A single estimator, one that is not installed, or a reference that is not among them.
    """
    from srt.estimation.registry import find_estimator

    for name in names:
        find_estimator(name)
    if len(names) == 1:
        raise InputError(
            f"A comparison needs two estimators at least: name another beside {names[0]}, or none for all."
        )
    if reference is not None and reference not in (names or default):
        raise InputError(
            f"The reference {reference!r} is not among the estimators compared: {', '.join(names or default)}."
        )


def run(
    path: Path, names: Sequence[str], reference: str | None, truth: Path | None, options: Options, *, quiet: bool
) -> Comparison:
    """Load the recording, run the estimators one after the other, and compare them.

    Raises
    ------
    SrtError
        A recording that cannot be read, a truth that is not its own, fewer than two estimators that can run.
    """
    from srt.cli.progress import iteration_progress
    from srt.comparison.comparison_run import runnable_estimators, with_findings
    from srt.comparison.estimator_comparison import compare as compare_calibrations
    from srt.comparison.estimator_comparison import run_estimators
    from srt.recording.folder import load_recording

    true_errors = None
    if truth is not None:
        from srt.cli.truth import load_truth

        true_errors = load_truth(truth)
    recording = load_recording(path)
    if truth is not None:
        check_truth(truth, recording)
    names, left_out = runnable_estimators(recording, names, reference)
    for name, reason in left_out.items():
        warn(f"{path}: {name} is left out: {reason}")
    calibrations: dict[str, Calibration] = {}
    seconds: dict[str, float] = {}
    failures: dict[str, str] = {}
    title = recording_folder(path).resolve().name
    for name in names:
        with iteration_progress(f"{title}, {name}", quiet=quiet) as show:
            progress = None if show is None else lambda _, number, correction, show=show: show(number, correction)
            done, took, failed = run_estimators(recording, [name], options, progress)
        calibrations |= done
        seconds |= took
        failures |= failed
    calibrations = with_findings(recording, options, calibrations)
    return compare_calibrations(
        calibrations, reference=reference, seconds=seconds, failures=failures, left_out=left_out, truth=true_errors
    )


def check_truth(path: Path, recording: Recording) -> None:
    """Refuse a truth whose stationary windows or serial differ from those of the recording.

    Raises
    ------
    InputError
    """
    document = json.loads(path.read_text(encoding="utf-8"))
    try:
        true = [(float(a), float(b)) for pair in document.get("windows", []) for a, b in pair]
        serial = document.get("scenario", {}).get("recording", {}).get("serial")
    except (AttributeError, TypeError, ValueError):
        raise InputError(f"The truth {path} is not as simulate wrote it: let it write the truth again.") from None
    edge = 0.5 * recording.nominal_interval_s
    labelled = [window for s in recording.sequences for window in (s.start_static_s, s.end_static_s)]
    # Labels may have been narrowed by hand: within a true window is near enough.
    outside = [(a, b) for a, b in labelled if not any(low - edge <= a and b <= high + edge for low, high in true)]
    other_serial = None not in (serial, recording.serial) and serial != recording.serial
    if other_serial or (true and 2 * len(outside) > len(labelled)):
        raise InputError(f"The truth {path} is not that of this recording: name the file that lay beside it.")


def report_problems(comparison: Comparison, path: Path, *, seen: bool) -> int:
    """Print failures, and what the report says unless it was ``seen``, on standard error; give the exit code."""
    for name, sentence in comparison.failures.items():
        say(f"{path}: {name} failed: {sentence}")
    for note in comparison.notes:
        warn(f"{path}: {note}")
    if not comparison.agree:
        if not seen:
            say(f"{path}: {comparison.verdict}")
    elif comparison.truth is not None and min(map(comparison.rms_error, comparison.differences)) > _FOREIGN_TRUTH:
        warn(f"{path}: the estimates agree, but not with the truth: is it the truth of another recording?")
    if comparison.verdicts_differ and not seen:
        say(f"{path}: {comparison.verdicts_differ}")
    well = comparison.agree and comparison.complete and not comparison.verdicts_differ
    return 0 if well else DataError.exit_code
