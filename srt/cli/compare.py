"""``srt compare``: the estimators side by side on one recording, and whether they agree."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from srt.cli.calibrate import calibrate as calibrate_command
from srt.cli.jobs import PLOT_SUFFIXES, RESULT_SUFFIXES
from srt.cli.output import check_file, recording_folder, require_matplotlib, say, warn
from srt.exceptions import DataError, InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srt.comparison.estimate_difference import EstimateDifference
    from srt.comparison.estimator_comparison import Comparison
    from srt.estimation.options import Options
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

SHARED_OPTIONS = ("no_asymmetry", "hold", "average", "window_attitude", "start", "max_playbacks")
"""Options of ``srt calibrate`` that mean the same to every estimator."""

_FOREIGN_TRUTH = 10.0
"""Root mean square of error over sigma above which estimates that agree were hardly made of the truth's recording."""


@click.command()
@click.argument("recording", type=click.Path(path_type=Path), metavar="RECORDING")
@click.option(
    "--estimator",
    "names",
    multiple=True,
    metavar="NAME",
    help="closed-form, least-squares, ekf, graph, or another that is installed; repeatable. "
    "Default: all of these that can run here and on this recording.",
)
@click.option(
    "--reference",
    metavar="NAME",
    help="Estimate that the others are set against. Default: the most efficient present, "
    "of graph, ekf, least-squares, closed-form.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Result: FILE.json.")
@click.option("--plot", type=click.Path(path_type=Path), help="Figure: FILE.png, .pdf or .svg.")
@click.option("--truth", type=click.Path(path_type=Path), help="truth.json of a simulated recording: adds errors.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no tables; warnings and errors only.")
def compare(
    recording: Path,
    names: tuple[str, ...],
    reference: str | None,
    output: Path | None,
    plot: Path | None,
    truth: Path | None,
    quiet: bool,
    no_asymmetry: bool,
    **choices: Any,
) -> int:
    """Calibrate the unit of RECORDING with several estimators, and judge whether they agree.

    Estimates of the same data differ less than their sigmas: a difference is judged by the spread that it should
    have, which follows from the two covariances if the reference is efficient. Estimators that differ by chance
    alone are said to disagree in 1 of 100 recordings.

    Exit codes: 0 all that ran converged (or partial) and agree; 1 they disagree, one failed or did not converge, or
    fewer than two can run; 2 wrong usage or unreadable input.
    """
    # Everything that can be refused without the samples is refused before they are read.
    if output is not None:
        check_file(output, RESULT_SUFFIXES, "The result")
    if plot is not None:
        check_file(plot, PLOT_SUFFIXES, "The plot")
    from srt.comparison.estimator_comparison import ESTIMATORS
    from srt.estimation.options import Options

    names = tuple(dict.fromkeys(names))
    check_names(names, ESTIMATORS, reference)
    options = Options(asymmetry=not no_asymmetry, **choices)
    if plot is not None:
        require_matplotlib()
    comparison = run(recording, names, reference, truth, options, quiet=quiet)
    folder = recording_folder(recording)
    if output is not None:
        comparison.save(output)
    if not quiet:
        click.echo(text(comparison, title=str(recording)))
    if plot is not None and comparison.reference is not None:
        from srt.reports.figures.calibration import save_figure
        from srt.reports.figures.comparison import comparison_figure

        save_figure(comparison_figure(comparison, title=folder.resolve().name), plot)
    written = [str(path) for path in (output, plot) if path is not None and path.exists()]
    if written and not quiet:
        click.echo(f"\nWritten: {', '.join(written)}")
    return judge(comparison, recording)


# The definitions of 'srt calibrate' themselves: two commands shall not come to mean different things by one option.
compare.params += [p for p in calibrate_command.params if p.name in SHARED_OPTIONS]


def check_names(names: Sequence[str], default: Sequence[str], reference: str | None) -> None:
    """Refuse estimators that cannot be compared, before any data are read.

    Parameters
    ----------
    names : sequence of str
        Those asked for; none stands for the default.
    default : sequence of str
    reference : str or None

    Raises
    ------
    InputError
        One estimator alone, one that is not installed, or a reference that is not among them.
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
    import srt
    from srt.cli.progress import playback_progress
    from srt.comparison.estimator_comparison import compare as compare_calibrations
    from srt.comparison.estimator_comparison import default_estimators, run_estimators

    true_errors = None
    if truth is not None:
        from srt.cli.truth import load_truth

        true_errors = load_truth(truth)
    recording = srt.load_recording(path)
    if truth is not None:
        check_truth(truth, recording)
    left_out: dict[str, str] = {}
    if not names:
        names, left_out = default_estimators(recording)
    reasons = "; ".join(f"{name} is left out: {reason.rstrip('.')}" for name, reason in left_out.items())
    if reference in left_out:
        raise InputError(f"The reference {reference} cannot run here: {left_out[reference]}")
    if len(names) < 2:
        raise DataError(f"Fewer than two estimators can run on {path}: {reasons}.")
    if reasons:
        warn(f"{path}: {reasons}.")
    calibrations: dict[str, Calibration] = {}
    seconds: dict[str, float] = {}
    failures: dict[str, str] = {}
    title = recording_folder(path).resolve().name
    for name in names:
        with playback_progress(f"{title}, {name}", quiet=quiet) as show:
            progress = None if show is None else lambda _, number, correction, show=show: show(number, correction)
            done, took, failed = run_estimators(recording, [name], options, progress)
        calibrations |= done
        seconds |= took
        failures |= failed
    return compare_calibrations(
        calibrations,
        reference=reference,
        seconds=seconds,
        failures=failures,
        left_out=left_out,
        truth=true_errors,
    )


def check_truth(path: Path, recording: Recording) -> None:
    """Refuse a truth whose windows of stillness are not those of the recording's labels, or of another serial.

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


def judge(comparison: Comparison, path: Path) -> int:
    """Say what is wrong on standard error, and give the exit code."""
    for name, sentence in comparison.failures.items():
        say(f"{path}: {name} failed: {sentence}")
    for note in comparison.notes:
        warn(f"{path}: {note}")
    if not comparison.agree:
        say(f"{path}: {comparison.verdict}")
    elif comparison.truth is not None and min(map(comparison.rms_error, comparison.differences)) > _FOREIGN_TRUTH:
        warn(f"{path}: the estimates agree, but not with the truth: is it the truth of another recording?")
    return 0 if comparison.agree and comparison.complete else DataError.exit_code


def text(comparison: Comparison, *, title: str) -> str:
    """Write the tables and the verdict.

    Parameters
    ----------
    comparison : Comparison
    title : str
        Of the recording.

    Returns
    -------
    str
        Lines of at most 120 characters with four estimators, without a line feed at the end.
    """
    from srt.reports.text.calibration import wrap

    serials = {c.provenance.get("serial") for c in comparison.calibrations.values()} - {None}
    serial = f" (serial {serials.pop()})" if serials else ""
    reasons = [f"{name} failed: {reason}" for name, reason in comparison.failures.items()]
    reasons += [f"{name} is left out: {reason}" for name, reason in comparison.left_out.items()]
    reasons += [f"Note: {note}" for note in comparison.notes]
    parts = [
        [f"{title}{serial}: estimators side by side"],
        [estimator_table(comparison)],
        [line for reason in reasons for line in wrap(reason)],
        [parameter_table(comparison)],
        _legend(comparison),
        [truth_table(comparison)],
        wrap(comparison.verdict),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if any(lines))


def estimator_table(comparison: Comparison) -> str:
    """Set a line for every estimator that ran: its outcome, its cost, and how it compares with the reference."""
    from srt.reports.text.tables import fixed, text_table

    truth = ["error/\nsigma"] if comparison.truth is not None else []
    headers = ["estimator", "status", "play-\nbacks", "seconds", "ob-\nserved", *truth]
    headers += ["sigma\nratio", "largest\ndiff.", "chi-\nsquare", "proba-\nbility", "verdict"]
    rows = []
    for name, calibration in comparison.calibrations.items():
        pair = comparison.differences.get(name)
        rows.append(
            [
                name,
                calibration.status.replace("_", " "),
                str(len(calibration.corrections)),
                fixed(comparison.seconds.get(name, math.nan), 2),
                str(int(calibration.observed.sum())),
                *(fixed(comparison.rms_error(name), 2) for _ in truth),
                *_compared(pair, name == comparison.reference),
            ]
        )
    for name in comparison.failures:
        nothing = ["-"] * (len(headers) - 5)
        rows.append([name, "failed", "-", fixed(comparison.seconds.get(name, math.nan), 2), *nothing, "no result"])
    return text_table(headers, rows, "ll" + "r" * (len(headers) - 3) + "l")


def _compared(pair: EstimateDifference | None, is_reference: bool) -> list[str]:
    """Cells of the comparison with the reference."""
    from srt.reports.text.tables import fixed

    if is_reference:
        return ["1.00", "-", "-", "-", "reference"]
    if pair is None or pair.largest is None:
        return ["-", "-", "-", "-", "not compared"]
    return [
        fixed(pair.efficiency, 2),
        fixed(abs(float(pair.normalised[pair.largest])), 1),
        fixed(pair.chi_square, 0),
        f"{pair.p_value:.2g}",
        "agrees" if pair.agrees else "differs",
    ]


def parameter_table(comparison: Comparison) -> str:
    """Set every parameter: the estimates with their sigmas, then the differences over their expected spreads."""
    from srt.reports.text.tables import text_table
    from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, NAMES

    if not comparison.calibrations:
        return ""
    rows: list[Sequence[str] | None] = []
    for i, name in enumerate(NAMES):
        row = [name, DISPLAY_UNITS[i]]
        for calibration in comparison.calibrations.values():
            factor = DISPLAY_FACTORS[i]
            row.append(_estimate(float(calibration.errors.vector[i]) * factor, float(calibration.sigma[i]) * factor))
        for pair in comparison.differences.values():
            value = float(pair.normalised[i])
            row.append("-" if math.isnan(value) else f"{round(value, 1) + 0.0:+.1f}{'*' if pair.differing[i] else ' '}")
        rows.append(row)
    headers = ["parameter", "unit", *comparison.calibrations, *(_head(name) for name in comparison.differences)]
    alignment = "ll" + "r" * (len(headers) - 2)
    return text_table(headers, _grouped(rows), alignment)


def truth_table(comparison: Comparison) -> str:
    """Set the truth, and the error of every estimate over its sigma; empty without a truth."""
    from srt.reports.text.tables import decimals_for, fixed, text_table
    from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, NAMES

    if comparison.truth is None or not comparison.calibrations:
        return ""
    ratios = {name: comparison.error_over_sigma(name) for name in comparison.calibrations}
    best = comparison.calibrations[comparison.reference or next(iter(ratios))]
    rows: list[Sequence[str] | None] = []
    for i, name in enumerate(NAMES):
        sigma = float(best.sigma[i]) * DISPLAY_FACTORS[i]
        true = fixed(comparison.truth[name] * DISPLAY_FACTORS[i], 2 if math.isnan(sigma) else decimals_for(sigma))
        rows.append([name, DISPLAY_UNITS[i], true, *(fixed(float(ratio[i]), 2) for ratio in ratios.values())])
    table = text_table(["parameter", "unit", "truth", *ratios], _grouped(rows), "llr" + "r" * len(ratios))
    return f"Errors over sigma\n{table}"


def _legend(comparison: Comparison) -> Iterable[str]:
    from srt.comparison.estimate_difference import FALSE_ALARM
    from srt.reports.text.calibration import wrap

    pair = next(iter(comparison.differences.values()), None)
    if pair is None:
        return []
    return wrap(
        f"Last columns: estimate less {pair.reference}, over the spread expected of that difference; beyond "
        f"{pair.limit:.1f} it is marked *. All limits together are exceeded by chance in {FALSE_ALARM:.0%} of "
        "recordings."
    )


def _estimate(value: float, sigma: float) -> str:
    """Write value±sigma in display units, with two digits of sigma."""
    from srt.reports.text.tables import decimals_for, fixed

    if math.isnan(sigma):
        return f"{fixed(value, 2)} held"
    decimals = decimals_for(sigma)
    return f"{fixed(value, decimals)}±{fixed(sigma, decimals)}"


def _head(name: str) -> str:
    """Break a name at its hyphens: the columns of differences are narrow."""
    return name.replace("-", "-\n")


def _grouped(rows: Sequence[Sequence[str] | None]) -> list[Sequence[str] | None]:
    """Part the rows of the 27 parameters by their groups."""
    from srt.sensor_errors import GROUP_SLICES

    out: list[Sequence[str] | None] = []
    for group in GROUP_SLICES.values():
        out += [*([None] if out else []), *rows[group]]
    return out
