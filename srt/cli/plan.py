"""``srt plan``: which sequences to run on a fixture, for how long, and what accuracy to expect."""

from __future__ import annotations

import json
import math
import sys
import textwrap
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from srt.cli.jobs import PLOT_SUFFIXES, RESULT_SUFFIXES
from srt.cli.output import check_file, require_matplotlib, say
from srt.comparison.parallel import one_thread
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sims.scenarios.plan_file import PlanFile
    from srt.planning.plan import Plan

_SHEET_SUFFIXES: Final = (".md",)
_SCENARIO_SUFFIXES: Final = (".toml",)
_TURNS_WIDTH: Final = 38


@click.command()
@click.argument("plan_file", metavar="PLAN")
@click.option("--total-time", type=float, metavar="S", help="Length of the test in s, instead of the file's.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="The schedule, for srt simulate: FILE.toml.")
@click.option("--sheet", type=click.Path(path_type=Path), help="What the operator has to do: FILE.md.")
@click.option("--json", "document", type=click.Path(path_type=Path), help="The plan for programs: FILE.json.")
@click.option("--plot", type=click.Path(path_type=Path), help="Timetable and accuracy: FILE.png, .pdf or .svg.")
@click.option("--table-1", is_flag=True, help="Compare with the 17 sequences of Table 1 in the same time.")
@click.option(
    "--after",
    type=click.Path(path_type=Path),
    metavar="CALIBRATION",
    help="Instead of a plan, propose the next sequence after the test so far, from its calibration (JSON).",
)
@click.option(
    "--sequence",
    metavar="TEXT",
    help="Instead of a plan, show what one sequence tells: 'z/y +180y +180z', or an id of Table 1.",
)
@click.option("-q", "--quiet", is_flag=True, help="No progress and no tables; warnings and errors only.")
def plan(
    plan_file: str,
    total_time: float | None,
    output: Path | None,
    sheet: Path | None,
    document: Path | None,
    plot: Path | None,
    table_1: bool,
    after: Path | None,
    sequence: str | None,
    quiet: bool,
) -> int:
    """Plan a rotation test for the fixture, unit and targets of PLAN: a TOML file, or the name of a shipped one.

    With a total time, the plan has the smallest worst sigma over target that this time allows; without, it is the
    shortest test that meets all targets. Printed with it is a bound: how good any plan of this length could be.

    Exit codes: 0 all targets are met; 1 some are not, or cannot be; 2 wrong usage or unreadable input.
    """
    import sims.scenarios.plan_file as files

    for path, suffixes, what in (
        (output, _SCENARIO_SUFFIXES, "The schedule"),
        (sheet, _SHEET_SUFFIXES, "The operator's sheet"),
        (document, RESULT_SUFFIXES, "The plan"),
        (plot, PLOT_SUFFIXES, "The plot"),
    ):
        if path is not None:
            check_file(path, suffixes, what)
    if total_time is not None and not (math.isfinite(total_time) and total_time > 0.0):
        raise InputError(f"--total-time is {total_time:g}: give a positive number of seconds.")
    chosen = files.load_plan_file(plan_file)
    if total_time is not None:
        options = chosen.plan.model_copy(update={"total_time_s": total_time})
        chosen = chosen.model_copy(update={"plan": options})
    if sequence is not None:
        show(chosen, sequence)
        return 0
    if after is not None:
        if any(given is not None for given in (output, sheet, document, plot)) or table_1:
            raise InputError("--after proposes single sequences and writes no plan: leave the other options out.")
        with one_thread("sims"):
            return propose(chosen, after, quiet=quiet)
    if plot is not None:
        require_matplotlib()
    with one_thread("sims"):
        return make(chosen, output, sheet, document, plot, table_1=table_1, quiet=quiet)


def make(
    chosen: PlanFile,
    output: Path | None,
    sheet: Path | None,
    document: Path | None,
    plot: Path | None,
    *,
    table_1: bool,
    quiet: bool,
) -> int:
    """Make a plan, write what is asked for, and show it."""
    from sims.scenarios.plan_file import scenario_toml
    from srt.planning.document import operator_sheet, plan_document
    from srt.planning.plan import make_plan, table_1_plan
    from srt.recording.atomic import atomic_write_text

    stand, conditions, targets = chosen.stand.stand(), chosen.conditions(), chosen.targets.sigma()
    limits = chosen.plan.limits()
    with _progress(quiet=quiet) as progress:
        found = make_plan(
            stand, conditions, targets, total_s=chosen.plan.total_time_s, limits=limits, progress=progress
        )
    title = f"Rotation test of {chosen.imu.name} on {chosen.fixture.name}"
    if output is not None:
        head = f"# {title}: a plan, to be run by 'srt simulate'.\n"
        atomic_write_text(output, head + scenario_toml(chosen.scenario(found)))
    if sheet is not None:
        atomic_write_text(sheet, operator_sheet(found, title))
    if document is not None:
        atomic_write_text(document, json.dumps(plan_document(found), indent=2, allow_nan=False) + "\n")
    if plot is not None:
        from srt.planning.figure import plan_figure
        from srt.reports.figures.style import save_figure

        save_figure(plan_figure(found, title=title), plot)
    if not quiet:
        click.echo(text(found, title))
        if table_1:
            click.echo(_against_table_1(found, lambda: table_1_plan(stand, conditions, targets, found.total_s, limits)))
    if found.unmet:
        k = found.worst
        source, share = found.prediction.limiting(_index(k))
        say(
            f"The plan misses {len(found.unmet)} of the targets: {k} stays at {found.ratio:.3g} times its target, "
            f"{100.0 * share:.0f} % of its variance by {source.replace('_', ' ')}; allow more time, or take larger "
            "targets."
        )
        return 1
    return 0


def text(found: Plan, title: str) -> str:
    """A plan as tables."""
    from srt.planning.document import clock, symbols, timetable
    from srt.reports.text.calibration import source_label, wrap
    from srt.reports.text.tables import decimals_for, fixed, text_table
    from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, N_PARAMETERS, SYMBOLS

    lines = [f"{title}: {len(found.candidates)} sequences in {clock(found.total_s)} (min:s),"]
    lines.append(f"{clock(found.moves_s)} of them moves and waits between the sequences\n")
    rows = []
    for number, (c, step, need) in enumerate(
        zip(found.candidates, timetable(found), found.prediction.needed_for, strict=True), start=1
    ):
        (a, b), (e, f) = step.start_static_s, step.end_static_s
        first, *more = textwrap.wrap(c.label, _TURNS_WIDTH, subsequent_indent="  ", break_on_hyphens=False)
        rows.append([str(number), clock(a), first, f"{b - a:.0f}", f"{f - e:.0f}", " ".join(symbols(need))])
        rows += [["", "", line, "", "", ""] for line in more]
    lines.append(
        text_table(["", "clock", "down/outer turns", "stand\ns", "and\ns", "needed for"], rows, "rrlrrl", gap=1)
    )
    lines.append("\nExpected accuracy, one sigma")
    cells = []
    for k in range(N_PARAMETERS):
        sigma, target, factor = found.prediction.sigma[k], found.targets[k], DISPLAY_FACTORS[k]
        if math.isinf(sigma):
            cells.append([SYMBOLS[k], DISPLAY_UNITS[k], "not seen", "", "", ""])
            continue
        decimals = decimals_for(sigma * factor)
        source, share = found.prediction.limiting(k)
        cells.append(
            [
                SYMBOLS[k],
                DISPLAY_UNITS[k],
                fixed(sigma * factor, decimals),
                "" if math.isnan(target) else fixed(target * factor, decimals),
                "" if math.isnan(target) else f"{sigma / target:.2f}",
                f"{source_label(source)} {100.0 * share:.0f} %",
            ]
        )
    lines.append(text_table(["", "unit", "sigma", "target", "ratio", "largest source"], cells, "llrrrl"))
    last = f"Worst: {found.worst} at {found.ratio:.3f} of its target."
    if math.isfinite(found.bound):
        last += (
            f" No plan of this length and of such sequences can be below {found.bound:.3f}, "
            f"{100.0 * (1.0 - found.bound / found.ratio):.0f} % less."
        )
    return "\n".join([*lines, "", *wrap(last)])


def _against_table_1(found: Plan, table_1: Callable[[], Plan]) -> str:
    from srt.reports.text.calibration import wrap

    try:
        other = table_1()
    except InputError as error:
        return "\n".join(wrap(f"Table 1 is no alternative: {error}"))
    better = 100.0 * (1.0 - found.ratio / other.ratio)
    return "\n".join(
        wrap(
            f"Table 1 in the same time, in its best order and with its best windows: {other.worst} at "
            f"{other.ratio:.3f} of its target; this plan is {better:.0f} % better."
        )
    )


def show(chosen: PlanFile, text: str) -> None:
    """Show what one sequence tells, component by component."""
    from srt.planning.signature import parse_sequence, signature

    stand = chosen.stand.stand()
    candidate = parse_sequence(text, stand)
    inner, outer = candidate.start_deg
    click.echo(
        f"{candidate.label}: from inner {inner}, outer {outer} deg, {candidate.turning_s(stand):.1f} s of turning"
    )
    click.echo("Over g; accelerometer biases in g, coefficients of gyro biases in s")
    for row in signature(candidate, stand, chosen.conditions()):
        terms = " ".join(f"{value:+.4g} {symbol}" for symbol, value in row.terms)
        lines = textwrap.wrap(terms, 60, break_on_hyphens=False) or ["nothing"]
        click.echo(f" {row.component:<14} {lines[0]}")
        for more in lines[1:]:
            click.echo(f" {'':<14} {more}")


def propose(chosen: PlanFile, after: Path, *, quiet: bool) -> int:
    """Show what to run next."""
    import srt
    from srt.planning.document import clock, shown
    from srt.planning.next_sequence import known_information, next_sequences
    from srt.reports.text.tables import text_table
    from srt.sensor_errors import INDEX, SYMBOLS

    calibration = srt.load_calibration(after)
    stand, conditions = chosen.stand.stand(), chosen.conditions()
    known = known_information(calibration, conditions)
    with _progress(quiet=quiet) as progress:
        found = next_sequences(
            stand, conditions, chosen.targets.sigma(), known, limits=chosen.plan.limits(), progress=progress
        )
    if quiet:
        return 0
    rows = []
    for proposal in found:
        better = [f"{SYMBOLS[INDEX[n]]} {shown(b, INDEX[n])} to {shown(a, INDEX[n])}" for n, b, a in proposal.improved]
        inner, outer = proposal.candidate.start_deg
        rows.append(
            [
                proposal.candidate.label,
                f"{inner}, {outer}",
                f"{proposal.windows_s[0]:.0f}, {proposal.windows_s[1]:.0f}",
                clock(proposal.time_s),
                "not seen" if math.isinf(proposal.ratio) else f"{proposal.ratio:.2f}",
                better[0] if better else "",
            ]
        )
        rows += [[""] * 5 + [more] for more in better[1:]]
    click.echo("What the best continuation of the test runs, most of its time first")
    heads = ["down/outer turns", "inner,\nouter", "stand\ns", "time\nmin:s", "worst\nratio", "improves"]
    click.echo(text_table(heads, rows, "lrrrrl", gap=1))
    return 0


def _index(name: str) -> int:
    from srt.sensor_errors import INDEX

    return INDEX[name]


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[str, int, float], None] | None]:
    """Lend a function that takes what is done, a count, and the gap to the optimum; a line on a terminal alone."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console

    words = {"optimum": "looking for the optimum", "plan": "choosing whole sequences"}
    with Console(stderr=True).status("reading what the fixture can do") as status:

        def tell(what: str, count: int, gap: float) -> None:
            left = f", round {count}: within {100.0 * gap:.1f} %" if what == "optimum" else ""
            status.update(words.get(what, what) + left)

        yield tell
