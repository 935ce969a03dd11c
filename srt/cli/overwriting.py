"""Policy of overwriting, the same for all commands.

A file that this program wrote, and that is unchanged since, is replaced, and a line at the end says so. Any other file
is replaced with ``--overwrite`` alone. Nothing is written into the folder of a recording, except by the commands that
write recordings.
"""

from __future__ import annotations

import hashlib
import os
from typing import TYPE_CHECKING, Final

import click

from srt.cli.messages import say
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from click.decorators import FC

_KEY: Final = "srt.overwrite"
_OLD: Final = "srt.old"  # files that may be replaced, with their versions
LOSS: Final = "srt.loss"  # sentence on what replaced files may have held that the new ones do not
TOML: Final = "recording.toml"
"""Name of the description of a recording, by which its folder is known."""
_METADATA: Final = {
    ".png": b"Software\0strapdown-rotation-test",
    ".pdf": b"/Creator (strapdown-rotation-test)",
    ".svg": b"<dc:title>strapdown-rotation-test</dc:title>",
    ".html": b'<meta name="generator" content="strapdown-rotation-test">',
}
"""Bytes by which a figure, a PDF or a page names this program, by the ending of the file."""
_EDGE: Final = 1 << 18
"""Bytes at the beginning and at the end of a file that are searched for its metadata."""
_NAMED: Final = 3
"""Most files that one message names."""


def _allow(ctx: click.Context, param: click.Parameter, value: bool) -> bool:  # noqa: ARG001 - click's
    ctx.meta[_KEY] = value
    return value


def overwrite_option(*, folder: bool = False) -> Callable[[FC], FC]:
    """Option --overwrite; to a command that writes a recording into a folder, its value is passed as well."""
    text = "Write to a folder that is not empty." if folder else "Replace files of other origin, and changed ones."
    return click.option("--overwrite", is_flag=True, callback=_allow, expose_value=folder, help=text)


def overwrite_allowed() -> bool:
    """True if the command that runs has the option --overwrite."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_KEY, False))


def check_replaceable(*paths: Path) -> None:
    """Check that the policy allows files to be written, before their content is computed.

    Raises InputError for a file in the folder of a recording, and, without ``--overwrite``, for one that exists and is
    not this program's, or was changed.
    """
    for path in paths:
        refuse_recording(path.parent, path)
    existing = [path for path in paths if path.exists() and not path.is_dir() and not overwrite_allowed()]
    for path in existing:
        unchanged = is_unchanged(path)
        if not unchanged:
            what = "was not written by this program" if unchanged is None else "was changed after it was written"
            raise InputError(f"{path} exists and {what}: name another file, or add --overwrite to replace it.")
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta.setdefault(_OLD, []).extend((path, _version(path)) for path in existing)


def report_replaced(context: click.Context) -> None:
    """Say which files the command replaced; with ``--overwrite`` nothing, as it was asked for."""
    replaced = [path for path, version in context.meta.get(_OLD, ()) if _version(path) not in (version, None)]
    if replaced:
        more = f" and {len(replaced) - _NAMED} more" if len(replaced) > _NAMED else ""
        were = "was" if len(replaced) == 1 else "were"
        loss = context.meta.get(LOSS, "")
        say(f"{', '.join(map(str, replaced[:_NAMED]))}{more} {were} replaced: earlier results, unchanged since.{loss}")


def _version(path: Path) -> tuple[int, int] | None:
    """Numbers that change when a file is written anew; None for no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def refuse_recording(folder: Path, wanted: Path) -> None:
    """Raise InputError if a folder is that of a recording, or is inside one; ``wanted`` is what was to be written."""
    resolved = folder.resolve()
    found = next((place for place in (resolved, *resolved.parents) if (place / TOML).is_file()), None)
    if found is not None:
        shown = folder if found == resolved else found
        raise InputError(
            f"{wanted} cannot be written: {shown} is the folder of a recording, which holds nothing else; name another "
            "place."
        )


def is_unchanged(path: Path) -> bool | None:
    """True for a file as this program wrote it, False for one that was changed since, None for one of other origin."""
    from srt.recording.file_guards import read_bounded
    from srt.recording.file_marks import unchanged_text
    from srt.result.json_file import parse_json, unchanged_document

    mark = _METADATA.get(path.suffix.lower())
    try:
        if mark is not None:
            return mark in _edges(path) or None
        data = read_bounded(path)
        if path.suffix.lower() == ".csv":
            beside = parse_json(read_bounded(path.with_suffix(".json")).decode())
            known = unchanged_document(beside) and beside.get("csv_sha256")
            return hashlib.sha256(data).hexdigest() == known if known else None
        text = data.decode()
        found = unchanged_text(text)
        return unchanged_document(parse_json(text)) if found is None and path.suffix.lower() == ".json" else found
    except (OSError, UnicodeDecodeError, InputError):
        return None


def _edges(path: Path) -> bytes:
    with path.open("rb") as file:
        head = file.read(_EDGE)
        file.seek(max(file.tell(), os.fstat(file.fileno()).st_size - _EDGE))
        return head + file.read(_EDGE)
