"""``srt plan``: sequences and windows of a test for given targets, with the expected accuracy."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import click

from srt.cli.messages import announce, say, show
from srt.cli.names import Name
from srt.cli.output_paths import RESULT_SUFFIXES, check_file, check_plot
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.cli.progress import status_line
from srt.comparison.parallel import one_thread
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from sims.scenarios.plan_file import PlanFile
    from srt.planning.plan import Plan


class PlanFiles(NamedTuple):
    """Files that a plan is written to; None: not written."""

    schedule: Path | None = None
    sheet: Path | None = None
    document: Path | None = None
    plot: Path | None = None


@click.command()
@click.argument("plan_file", metavar="PLAN", type=Name("plans", file=True))
@click.option("--total-time", type=float, metavar="S", help="Length of the test in s, instead of the file's.")
@click.option("-o", "--output", type=PATH, help="Schedule for srt simulate: FILE.toml.")
@click.option("--sheet", type=PATH, help="Sheet for the operator: FILE.md.")
@click.option("--json", "document", type=PATH, help="Plan as JSON: FILE.json.")
@click.option("--plot", type=PATH, help="Figure of timetable and accuracy: FILE.png, .pdf or .svg.")
@click.option("--table-1", is_flag=True, help="Compare with the 17 sequences of Table 1 in the same time.")
@click.option(
    "--compare",
    multiple=True,
    metavar="PROTOCOL",
    help="Compare with a protocol in the same time: a shipped one (srt list protocols), or FILE.toml.",
)
@click.option(
    "--after",
    type=PATH,
    metavar="CALIBRATION",
    help="Instead of a plan, propose the next sequence after the test so far, from its calibration (JSON).",
)
@click.option(
    "--sequence",
    metavar="TEXT",
    help="Instead of a plan, print the signature of a sequence: 'z/y +180y +180z', or an id of Table 1.",
)
@click.option(
    "--moves",
    type=click.Choice(["recorded", "skipped"]),
    help="Moves between the sequences: recorded for an estimator that uses them (least squares, EKF, graph), or "
    "skipped.",
)
@click.option("--trust", is_flag=True, help="Accept a calibration file that was changed after it was written.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No progress and no tables; warnings and errors only.")
def plan(
    plan_file: str,
    total_time: float | None,
    output: Path | None,
    sheet: Path | None,
    document: Path | None,
    plot: Path | None,
    table_1: bool,
    compare: tuple[str, ...],
    after: Path | None,
    sequence: str | None,
    moves: str | None,
    trust: bool,
    quiet: bool,
) -> int:
    """Plan a rotation test for the fixture, unit and targets of PLAN: a TOML file, or the name of a shipped one.

    With a total time, the plan minimises the worst sigma over target in that time. Without, it is the shortest test
    that meets all targets. A lower bound is printed: with the closed form, no plan of this length can be better.

    Exit codes: 0 all targets are met; 1 some are not, or cannot be; 2 wrong usage or unreadable input.
    """
    import sims.scenarios.plan_file as files
    from srt.recording.protocol import load_protocol

    check_file(output, (".toml",), "The schedule")
    check_file(sheet, (".md",), "The operator's sheet")
    check_file(document, RESULT_SUFFIXES, "The plan")
    check_plot(plot)
    for name in compare:
        load_protocol(name)
    from srt.recording.schema import LARGEST_TIME_S

    if total_time is not None and not 0.0 < total_time <= LARGEST_TIME_S:
        raise InputError(
            f"--total-time is {total_time:g}: give a positive number of seconds of at most {LARGEST_TIME_S:g}."
        )
    chosen = files.load_plan_file(plan_file)
    given = {"total_time_s": total_time, "moves": moves}
    options = chosen.plan.model_copy(update={name: value for name, value in given.items() if value is not None})
    chosen = chosen.model_copy(update={"plan": options})
    if sequence is not None:
        print_signature(chosen, sequence)
        return 0
    if after is not None:
        if any(given is not None for given in (output, sheet, document, plot)) or table_1 or compare:
            raise InputError("--after proposes single sequences and writes no plan: leave the other options out.")
        with one_thread("sims"):
            return propose(chosen, after, trust=trust, quiet=quiet)
    with one_thread("sims"):
        return make(chosen, PlanFiles(output, sheet, document, plot), compare, table_1=table_1, quiet=quiet)


def make(
    chosen: PlanFile, files: PlanFiles, compare: tuple[str, ...] = (), *, table_1: bool = False, quiet: bool
) -> int:
    """Make a plan, write the files that are asked for, and print it."""
    import srt
    from sims.accuracy.expected_accuracy import plan_with_moves, sigma_with_moves
    from sims.scenarios.plan_file import scenario_toml
    from srt.planning.plan_document import operator_sheet, plan_document
    from srt.planning.plan_text import plan_text, table_1_text, unmet_targets_text
    from srt.planning.planner import table_1_plan
    from srt.recording.file_marks import write_marked_text
    from srt.reports.tables import wrap
    from srt.result.json_file import save_json_file

    task = chosen.task()
    moves = chosen.plan.moves == "recorded"
    with _progress(quiet=quiet) as progress:
        found = plan_with_moves(chosen, progress=progress) if moves else srt.plan(task, progress=progress)
    title = f"Rotation test of {chosen.imu.name} on {chosen.fixture.name}"
    if files.schedule is not None:
        head = f"# {title}: a plan, to be run by 'srt simulate'.\n"
        write_marked_text(files.schedule, head + scenario_toml(chosen.scenario(found)))
    if files.sheet is not None:
        write_marked_text(files.sheet, operator_sheet(found, title))
    if files.document is not None:
        save_json_file(files.document, plan_document(found))
    if files.plot is not None:
        from srt.planning.plan_figure import plan_figure
        from srt.reports.figures.style import save_figure

        save_figure(plan_figure(found, title=title), files.plot)
    if not quiet:
        show(plan_text(found, title))
        if table_1:
            try:
                rival = table_1_plan(task.fixture, task.conditions, found.targets, found.total_s, task.limits)
                if moves:
                    rival = replace(rival, with_moves=sigma_with_moves(chosen, rival))
                comparison = table_1_text(found, rival)
            except InputError as error:
                comparison = "\n".join(wrap(f"Table 1 is no alternative: {error}"))
            show(comparison)
        if compare:
            show("\n\n".join(compare_with(name, chosen, found) for name in compare))
    announce(*files, quiet=quiet)
    if found.unmet:
        say(unmet_targets_text(found))
        return 1
    return 0


def compare_with(name: str, chosen: PlanFile, found: Plan) -> str:
    """Sentence on a protocol in the time of a plan."""
    from sims.accuracy.expected_accuracy import protocol_accuracy
    from srt.planning.plan_text import protocol_text

    rival = protocol_accuracy(name, chosen, found.total_s)
    return protocol_text(found, rival.name, rival.sigma, on_fixture=rival.on_fixture)


def print_signature(chosen: PlanFile, text: str) -> None:
    """Print the signature of one sequence."""
    from srt.planning.plan_text import signature_text
    from srt.planning.signature_table import parse_sequence, signature

    fixture = chosen.stand.kinematics()
    candidate = parse_sequence(text, fixture)
    show(signature_text(candidate, fixture, signature(candidate, fixture, chosen.conditions())))


def propose(chosen: PlanFile, after: Path, *, trust: bool, quiet: bool) -> int:
    """Print proposals for the next sequence."""
    import srt
    from srt.planning.next_sequence import known_information, next_sequences
    from srt.planning.plan_text import proposals_text

    calibration = srt.load_calibration(after, trust=trust)
    calibration.require_one_temperature()
    fixture, conditions = chosen.stand.kinematics(), chosen.conditions()
    known = known_information(calibration, conditions)
    with _progress(quiet=quiet) as progress:
        found = next_sequences(
            fixture, conditions, chosen.targets.sigma(), known, limits=chosen.plan.limits(), progress=progress
        )
    if not quiet:
        show(proposals_text(found))
    return 0


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[str, int, float], None] | None]:
    """Yield a progress function of stage, count and gap to the optimum; None unless on a terminal."""
    if quiet:
        yield None
        return
    stages = {"optimum": "optimising the continuous design", "plan": "selecting whole sequences"}
    with status_line("listing the sequences that the fixture can execute") as update:

        def report(stage: str, count: int, gap: float) -> None:
            left = f", round {count}: within {100.0 * gap:.1f} %" if stage == "optimum" else ""
            if update is not None:
                update(stages.get(stage, stage) + left)

        yield None if update is None else report
