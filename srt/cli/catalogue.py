"""``srt list``: shipped configurations, installed estimators, and formats that are read and written."""

from __future__ import annotations

import textwrap

import click

from srt.cli.messages import show
from srt.cli.names import FOLDERS, names_of

KINDS = ("scenarios", "protocols", "plans", "campaigns", "estimators", "formats", "targets")


@click.command("list")
@click.argument("kinds", nargs=-1, metavar="[KIND]...", type=click.Choice(KINDS))
def catalogue(kinds: tuple[str, ...]) -> int:
    """List what is shipped or installed, of the KINDs named or of all.

    scenarios (for simulate, budget), protocols (for calibrate, plan, and in scenarios), plans (for plan), campaigns
    (for robustness), estimators (for calibrate, compare),
    formats (for convert), targets (for export).
    """
    for number, kind in enumerate(kinds or KINDS):
        rows = _rows(kind)
        width = max(len(name) for name, _ in rows) + 3
        lines = [kind.capitalize()]
        for name, text in rows:
            head = f" {name}".ljust(width)
            lines += textwrap.wrap(head + text, 80, subsequent_indent=" " * width, break_on_hyphens=False)
        show("\n".join([""] * (number > 0) + lines))
    return 0


def _rows(kind: str) -> list[list[str]]:
    """Name and description of every entry of a kind."""
    if kind == "estimators":
        return [[name, _first_line(name)] for name in names_of(kind)]
    if kind == "formats":
        from srt.recording.importer_registry import importer

        return [[name, importer(name).title] for name in names_of(kind)]
    if kind == "targets":
        from srt.exporters import exporters

        return [[name, exporter.title] for name, exporter in exporters().items()]
    if kind == "protocols":
        from srt.recording.protocol import load_protocol

        protocols = [load_protocol(name) for name in names_of(kind)]
        return [[p.name, f"{p.description} ({p.total_s:.0f} s)"] for p in protocols]
    from sims.scenarios.library import configs_path, read_toml

    folder = configs_path() / FOLDERS[kind]
    tables = {name: read_toml(folder / f"{name}.toml") for name in names_of(kind)}
    return [[name, str((table | table.get("campaign", {})).get("description", ""))] for name, table in tables.items()]


def _first_line(estimator: str) -> str:
    """First line of the documentation of an estimator, or the reason why it cannot be loaded."""
    from srt.estimation.registry import find_estimator
    from srt.exceptions import SrtError

    try:
        return (find_estimator(estimator).__doc__ or "").partition("\n")[0]
    except SrtError as error:
        return str(error)
