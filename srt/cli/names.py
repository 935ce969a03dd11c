"""Names of what is shipped or installed: as arguments that a shell completes, and as listed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import click
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    from collections.abc import Iterable

FOLDERS: Final = {"scenarios": "scenario", "plans": "plan", "campaigns": "robustness"}
"""Folders of the configurations of each kind."""


def names_of(kind: str) -> Iterable[str]:
    """Names of a kind of 'srt list'."""
    if kind == "estimators":
        from srt.estimation.registry import estimators

        return estimators()
    if kind == "targets":
        from srt.exporters import exporters

        return exporters()
    if kind == "formats":
        from srt.recording.importer_registry import IMPORTERS

        return IMPORTERS
    if kind == "protocols":
        from srt.recording.protocol import protocol_names

        return protocol_names()
    from sims.scenarios.library import names

    return names(FOLDERS[kind])


class Name(click.types.StringParamType):
    """Name of a kind of 'srt list', which a shell completes; EKF stands for ekf.

    Parameters
    ----------
    kind : str
    others : sequence of str, optional
        Names that stand beside those of the kind.
    file : bool
        A path of a file may stand in its place.
    """

    def __init__(self, kind: str, *others: str, file: bool = False) -> None:
        self.kind, self.name, self.others, self.file = kind, kind, others, file

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:  # noqa: ARG002
        """Name of a text; another spelling in capitals is that name."""
        if self.file or value == value.lower():
            return value
        return next((name for name in self._names() if name.lower() == value.lower()), value)

    def shell_complete(self, *request: Any) -> list[CompletionItem]:
        """Names that begin with a text, and files where they are accepted."""
        *_, incomplete = request  # after context and parameter
        files = [CompletionItem(incomplete, type="file")] * self.file
        return [CompletionItem(name) for name in self._names() if name.startswith(incomplete)] + files

    def _names(self) -> tuple[str, ...]:
        return (*self.others, *names_of(self.kind))
