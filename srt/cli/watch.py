"""``srt watch``: the rotation test as it runs, from a recording that grows."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from srt.cli.calibration_jobs import Display, Job
from srt.cli.messages import announce, figure_title, is_seen, progress_line, show, warn
from srt.cli.names import Name
from srt.cli.output_paths import PLOT_SUFFIXES, RESULT_SUFFIXES, check_file, recording_folder
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.cli.progress import live_text
from srt.exceptions import DataError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from srt.planning.monitoring.followed_test import FollowedTest
    from srt.planning.monitoring.growing_recording import GrowingRecording


@click.command()
@click.argument("recording", type=PATH, metavar="RECORDING")
@click.option(
    "--estimator",
    type=Name("estimators", "auto"),
    default="auto",
    show_default=True,
    metavar="NAME",
    help="Estimator of the sigmas so far and of the result, as for calibrate.",
)
@click.option("--order", metavar="IDS", help="Sequences in their order, as 1,2,3; default: Table 1.")
@click.option(
    "--target",
    multiple=True,
    metavar="NAME=SIGMA",
    help="Sigma wanted of a parameter or group in ppm, µrad, µg or °/h, as gyro_scale=1.",
)
@click.option(
    "--every", type=click.FloatRange(0.1, 3600.0), default=1.0, show_default=True, help="Time between looks, s."
)
@click.option(
    "--idle",
    type=click.FloatRange(min=0.0),
    default=60.0,
    show_default=True,
    help="Time without new samples after which the test ends, s; 0: look once.",
)
@click.option("-o", "--output", type=PATH, help="Result at the end: FILE.json.")
@click.option("--plot", type=PATH, help="Figure of sigma against sequence: FILE.png, .pdf, .svg.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="Only errors of the test, and warnings of the final result.")
def watch(
    recording: Path,
    estimator: str,
    order: str | None,
    target: tuple[str, ...],
    every: float,
    idle: float,
    output: Path | None,
    plot: Path | None,
    quiet: bool,
) -> int:
    """Follow a rotation test while its recording grows, and calibrate at the end.

    RECORDING is a folder with recording.toml, which names the samples file. The logger appends lines to that file
    without a break, also during the moves between the sequences. The test begins in the start attitude of its first
    sequence. After each sequence, the sigmas so far and the next sequence are shown. An error is reported as soon as it
    is seen: a skipped sequence, a wrong angle or direction, or motion in a stationary window.

    The result at the end is that of 'srt calibrate' on the whole recording, with the same estimator. Ctrl-C ends the
    test, too.

    Exit codes: 0 converged and no error open; 1 an error of the test is open, or the data do not support a result;
    2 wrong usage or unreadable input.
    """
    check_file(output, RESULT_SUFFIXES, "The result")
    check_file(plot, PLOT_SUFFIXES, "The plot")
    from srt.cli.calibrate import check_tools, parse_targets, report_problems, run_job
    from srt.estimation.options import Options
    from srt.planning.monitoring.followed_test import FollowedTest
    from srt.planning.monitoring.growing_recording import GrowingRecording

    check_tools(estimator, plot)
    targets = Options(targets=parse_targets(target)).targets
    followed = FollowedTest(tuple(filter(None, (order or "").replace(" ", "").split(","))), targets, estimator)
    with GrowingRecording(recording) as growing, live_text(quiet=quiet) as update:
        follow(growing.grown, lambda: _look(growing, followed, update, quiet=quiet), every, idle)
        readable = growing.without_unreadable()
    if not followed.history:
        raise DataError(f"{recording}: no sequence of Table 1 was found: check the start attitude and the fixture.")
    if not quiet:
        show(followed.text())
        show()
    if plot is not None:
        from srt.planning.monitoring.sigma_figure import sigma_figure
        from srt.reports.figures.style import save_figure

        title = figure_title(recording_folder(recording).resolve().name)
        save_figure(sigma_figure(followed.history, targets, title=title), plot)
        announce(plot, quiet=quiet)
    job = Job(recording, recording_folder(recording).resolve().name, output, None)
    calibration = run_job(job, estimator, Options(), Display(quiet=quiet), readable)
    code = report_problems(job, calibration, seen=is_seen(quiet=quiet))
    return max(code, DataError.exit_code if followed.open_errors else 0)


def follow(grown: Callable[[], bool], look: Callable[[], None], every_s: float, idle_s: float) -> None:
    """Call ``look`` after each growth of the recording; end after ``idle_s`` without growth, or on Ctrl-C."""
    last = time.monotonic()
    try:
        while True:
            if grown():
                look()
                last = time.monotonic()
            if time.monotonic() - last >= idle_s:
                return
            time.sleep(every_s)
    except KeyboardInterrupt:
        return


def _look(
    growing: GrowingRecording, followed: FollowedTest, update: Callable[[str], None] | None, *, quiet: bool
) -> None:
    """Process the new samples of the recording, and show the state of the test."""
    recording = growing.read()
    if growing.begun_anew:
        followed.begin()
        growing.begun_anew = False
    for note in growing.notes:
        warn(note)
    growing.notes.clear()
    if recording is None:
        return
    news = followed.take(recording)
    if update is not None:
        update(followed.text())
    for line, urgent in news:
        if urgent or (update is None and not quiet):
            progress_line(line)
