"""Commands whose help shows the options in groups, and options with earlier names that the help leaves out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class GroupedCommand(click.Command):
    """Command with a help in groups.

    Parameters
    ----------
    groups : mapping of str to sequence of str
        Titles, and the names of the options below them; options of no group come first.
    """

    def __init__(self, *args: Any, groups: Mapping[str, Sequence[str]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.groups = groups

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, group by group."""
        title_of = {name: title for title, names in self.groups.items() for name in names}
        records: dict[str, list[tuple[str, str]]] = {"Options": [], **{title: [] for title in self.groups}}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None:
                records[title_of.get(parameter.name or "", "Options")].append(record)
        for title, rows in records.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


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
