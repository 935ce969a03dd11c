"""Group of the commands; each is imported when it is run."""

from __future__ import annotations

import importlib
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from srt.cli.border import guarded
from srt.cli.grouped_command import with_help_all
from srt.cli.messages import show
from srt.cli.overwriting import report_replaced

if TYPE_CHECKING:
    from collections.abc import Sequence

SECTIONS: Final = {
    "Everyday": {
        "demo": ("srt.cli.demo:demo", "Simulate a unit, calibrate it, and compare with the truth."),
        "convert": ("srt.cli.convert:convert", "Convert a log in another format to a recording."),
        "inspect": ("srt.cli.inspect:inspect", "Show what a recording holds, and look for faults."),
        "noise": ("srt.cli.noise:noise", "Show the noise terms of a unit at rest."),
        "calibrate": ("srt.cli.calibrate:calibrate", "Calibrate IMUs from their recordings."),
        "thermal": ("srt.cli.thermal:thermal", "Calibrate a unit over temperature."),
        "apply": ("srt.cli.apply:apply", "Correct a recording, or write the correction in C."),
        "export": ("srt.cli.export:export", "Write a calibration in the format of another tool."),
        "certificate": ("srt.cli.certificate:certificate", "Make a certificate of a calibrated unit."),
    },
    "Fixture and planning": {
        "plan": ("srt.cli.plan:plan", "Plan a test: sequences, windows, expected accuracy."),
        "watch": ("srt.cli.watch:watch", "Follow a test while its recording grows."),
        "budget": ("srt.cli.budget:budget", "Predict the accuracy of a test by source of error."),
        "align-mount": ("srt.cli.align_mount:align_mount", "Find the angles between sensor axes and mount."),
    },
    "Expert": {
        "compare": ("srt.cli.compare:compare", "Compare the estimators on one recording."),
        "robustness": ("srt.cli.robustness:robustness", "Run a campaign on simulated units."),
        "simulate": ("srt.cli.simulate:simulate", "Simulate a recording, with its truth, from a scenario."),
        "list": ("srt.cli.catalogue:catalogue", "List scenarios, protocols, plans, campaigns, formats and so on."),
    },
}
"""Sections of the help: for every command its function (module:attribute) and its line of help."""

OPTIONS_AS_COMMANDS: Final = {"merge": "calibrate --merge", "fleet": "calibrate FOLDER"}
"""Words that users type and that are no command, with what does their work."""

COMMANDS: Final = {name: entry for section in SECTIONS.values() for name, entry in section.items()}


class LazyGroup(click.Group):
    """Group that imports a command only to run it, so that the help is fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """Names of the commands in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import a command."""
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name][0].partition(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return with_help_all(command)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; a similar name is suggested for one that does not exist."""
        name = args[0]
        if name not in COMMANDS and not name.startswith("-"):
            from srt.exceptions import did_you_mean

            instead = OPTIONS_AS_COMMANDS.get(name)
            hint = did_you_mean(name, COMMANDS) if instead is None else f" (did you mean {instead}?)"
            raise click.UsageError(f"There is no command {name!r}{hint}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the commands in their sections."""
        with formatter.section("Commands"):
            for title, section in SECTIONS.items():
                with formatter.section(title):
                    formatter.write_dl([(name, text) for name, (_, text) in section.items()])


def _print_version(ctx: click.Context, param: click.Parameter, value: bool) -> None:  # noqa: ARG001
    if not value or ctx.resilient_parsing:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        number = version("strapdown-rotation-test")
    except PackageNotFoundError:
        number = "(not installed)"
    show(f"srt, strapdown-rotation-test {number}")
    ctx.exit()


@click.group(
    cls=LazyGroup,
    # click's own handling of a missing command raises an error that older versions lack
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
@click.pass_context
def app(context: click.Context) -> None:
    """Calibrate inertial measurement units by Savage's improved strapdown rotation test.

    'srt COMMAND --help' explains a command; 'srt demo' runs the whole chain in a few seconds.

    Exit codes: 0 success, 1 the data cannot support a result, 2 wrong usage or unreadable input.
    """
    if context.invoked_subcommand is None:
        with suppress(OSError):
            click.echo(context.get_help(), err=True)
        context.exit(2)


def run(arguments: Sequence[str]) -> int:
    """Run the group; errors become one sentence and an exit code.

    Returns
    -------
    int
        The exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without Greek symbols must not end a run
            stream.reconfigure(errors="replace")
    completion = os.environ.get("_SRT_COMPLETE")
    if completion:
        return guarded(lambda: _complete(completion))
    return guarded(lambda: _invoke(arguments))


def _called() -> str:
    """Name of the command in help and messages."""
    return "strapdown-srt" if Path(sys.argv[0]).stem == "strapdown-srt" else "srt"


def _complete(instruction: str) -> int:
    """Answer the shell's request to complete a command line."""
    from click.shell_completion import shell_complete

    from srt.exceptions import InputError

    try:
        return shell_complete(app, {}, _called(), "_SRT_COMPLETE", instruction)
    except (KeyError, ValueError) as error:
        raise InputError(
            f"The completion of command lines lacks what the shell sets ({error}): unset _SRT_COMPLETE, or read the "
            "page on the command line."
        ) from None


def _invoke(arguments: Sequence[str]) -> int:
    with app.make_context(_called(), list(arguments)) as context:
        value: Any = app.invoke(context)
        report_replaced(context)
    return value if isinstance(value, int) else 0
