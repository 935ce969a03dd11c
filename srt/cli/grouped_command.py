"""Commands whose help shows the usual options, or all in groups, and options with earlier names that no help shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import click

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


_HELP_ALL: Final = "help_all"
ARGUMENTS: Final = "arguments"
"""Key of the words after the name of the command in the ``meta`` of its context."""


def with_help_all(command: click.Command) -> click.Command:
    """Command that takes ``--help-all``; where ``--help`` shows all options, it is the same, and not shown."""
    if not any(parameter.name == _HELP_ALL for parameter in command.params):
        command.params.append(
            click.Option(
                ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all, hidden=True
            )
        )
    return command


class GroupedCommand(click.Command):
    """Command whose ``--help`` shows the usual options, and ``--help-all`` all of them in groups.

    Parameters
    ----------
    usual : sequence of str
        Names of the options that ``--help`` shows.
    groups : mapping of str to sequence of str, optional
        Titles, and the names of the options below them; options of no group come first.
    """

    def __init__(
        self, *args: Any, usual: Sequence[str], groups: Mapping[str, Sequence[str]] | None = None, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.usual = (*usual, _HELP_ALL)
        self.groups = groups or {}
        self.params.append(
            click.Option(
                ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all,
                help=f"Show all {len([p for p in self.params if isinstance(p, click.Option)])} options and exit.",
            )
        )  # fmt: skip

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words after the name of the command, and keep them for messages."""
        ctx.meta[ARGUMENTS] = tuple(args)
        return super().parse_args(ctx, args)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the usual options, or all group by group."""
        whole = _HELP_ALL in ctx.meta
        title_of = {name: title for title, names in self.groups.items() for name in names} if whole else {}
        records: dict[str, list[tuple[str, str]]] = {"Options": [], **{title: [] for title in self.groups}}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None and (whole or parameter.name in self.usual or "--help" in parameter.opts):
                records[title_of.get(parameter.name or "", "Options")].append(record)
        for title, rows in records.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _show_all(ctx: click.Context, param: click.Parameter, value: bool) -> None:  # noqa: ARG001 - click's
    if value and not ctx.resilient_parsing:
        ctx.meta[_HELP_ALL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


class RenamedOption(click.Option):
    """Option that its earlier names still set; the help shows the present ones only.

    Parameters
    ----------
    earlier : sequence of str
        Names that are accepted and not shown, as "--json".
    """

    def __init__(self, *args: Any, earlier: Sequence[str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.shown = [*self.opts]
        self.opts = [*self.opts, *earlier]

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Names and help text, without the earlier names."""
        names, self.opts = self.opts, self.shown
        try:
            return super().get_help_record(ctx)
        finally:
            self.opts = names
