"""Type of the arguments and options of a command that are paths."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

if TYPE_CHECKING:
    from os import PathLike


class NamedPath(click.Path):
    """Path that is not empty; an empty text would stand for the working directory, and mostly is an unset variable."""

    def convert(self, value: str | PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path of a text. An empty text is wrong usage."""
        if value == "":
            self.fail("the path is empty; name a file or folder, or . for the working directory", param, ctx)
        return super().convert(value, param, ctx)


PATH: Final = NamedPath(path_type=Path)
"""Type of an argument or option that is a path."""
