"""The group of commands, each loaded on use, and the border where errors become sentences and exit codes."""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any, Final

import click

from srt.cli.output import say
from srt.exceptions import SrtError

if TYPE_CHECKING:
    from collections.abc import Sequence

COMMANDS: Final = {
    "simulate": ("srt.cli.simulate:simulate", "Make a recording, and the truth behind it, from a scenario."),
    "convert": ("srt.cli.convert:convert", "Make a recording from a log in another format."),
    "inspect": ("srt.cli.inspect:inspect", "Show what a recording holds, and what is wrong with it."),
    "calibrate": ("srt.cli.calibrate:calibrate", "Calibrate IMUs from their recordings."),
    "align-mount": ("srt.cli.align_mount:align_mount", "Find the angles between the sensor axes and the mount."),
    "apply": ("srt.cli.apply:apply", "Correct a recording, or write the correction in C."),
    "export": ("srt.cli.export:export", "Write a calibration in the format of another tool."),
    "certificate": ("srt.cli.certificate:certificate", "Make a certificate of a calibrated unit."),
    "compare": ("srt.cli.compare:compare", "Set the estimators side by side on one recording."),
    "budget": ("srt.cli.budget:budget", "Predict the accuracy of a test by source of error."),
    "plan": ("srt.cli.plan:plan", "Plan a test: which sequences, for how long, to what accuracy."),
    "robustness": ("srt.cli.robustness:robustness", "Ask simulated units how far from true one may be."),
    "demo": ("srt.cli.demo:demo", "Simulate a unit, calibrate it, and compare with the truth."),
}
"""Where each command is (module:attribute), and its line in the help: all that a new one needs here."""

INTERRUPTED: Final = 130
BROKEN_PIPE: Final = 141
"""What a shell reports of a process that SIGINT, or SIGPIPE, ended."""


class LazyGroup(click.Group):
    """A group that imports a command only to run it; its own help needs none of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """Names in the order of the table, which is the order of work."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import a command."""
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name][0].partition(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command of a line; a name that is nearly right is suggested."""
        name = args[0]
        if name not in COMMANDS and not name.startswith("-"):
            from srt.exceptions import did_you_mean

            raise click.UsageError(f"There is no command {name!r}{did_you_mean(name, COMMANDS)}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the lines of the table."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


def _print_version(ctx: click.Context, param: click.Parameter, value: bool) -> None:  # noqa: ARG001
    if not value or ctx.resilient_parsing:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        number = version("strapdown-rotation-test")
    except PackageNotFoundError:
        number = "(not installed)"
    click.echo(f"srt, strapdown-rotation-test {number}")
    ctx.exit()


@click.group(
    cls=LazyGroup,
    # click's own way of showing the help raises an error of its own that older versions lack
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
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

    'srt COMMAND --help' explains a command; 'srt demo' shows all of it in a few seconds.

    Exit codes: 0 success, 1 the data cannot support a result, 2 wrong usage or unreadable input.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        context.exit(2)


def run(arguments: Sequence[str]) -> int:
    """Run the group and turn what it raises into one sentence and an exit code.

    What is not expected keeps its traceback: it is a defect of this program, not of its input.

    Parameters
    ----------
    arguments : sequence of str

    Returns
    -------
    int
        The exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # Greek symbols shall not end a run on a terminal that has none
            stream.reconfigure(errors="replace")
    completion = os.environ.get("_SRT_COMPLETE")
    if completion:
        from click.shell_completion import shell_complete

        return shell_complete(app, {}, "srt", "_SRT_COMPLETE", completion)
    try:
        code = _invoke(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has gone (srt ... | head): nor must the interpreter fail, flushing once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    return code


def _invoke(arguments: Sequence[str]) -> int:
    try:
        with app.make_context("srt", list(arguments)) as context:
            value: Any = app.invoke(context)
    except click.exceptions.Exit as error:
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo(err=True)  # ends the line on which the terminal shows ^C
        return INTERRUPTED
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx is not None else "srt"
        say(f"{error.format_message().rstrip('.')}: see '{path} --help'.")
        return error.exit_code
    except click.ClickException as error:
        say(error.format_message())
        return error.exit_code
    except SrtError as error:
        say(str(error))
        return error.exit_code
    return value if isinstance(value, int) else 0
