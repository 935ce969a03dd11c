"""Layout of a text table with any separator, with or without a header, from its first row of numbers."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError
from srt.recording.import_options import ImportOptions, option
from srt.recording.text_tables import TableLayout, cells_of, is_number

if TYPE_CHECKING:
    from pathlib import Path

DELIMITERS: Final = {"tab": "\t", "semicolon": ";", "comma": ",", "pipe": "|", "blank": None}
"""Names on the command line; blank stands for any run of blanks and tabs."""

_HEAD_BYTES = 1 << 16  # bytes in which the first row of numbers is searched: titles and notes take a few thousand

_COMMENT_MARKS = ("#", "%", "//")

_FEWEST_NUMBERS = 3  # numbers in the first row; fewer may stand in a line of notes


def find_layout(path: Path, options: ImportOptions) -> TableLayout:
    """Find the layout of a table; ``delimiter``, ``decimal_comma`` and ``skip`` are used without a check.

    Raises InputError: no text, an unknown delimiter, or no row of numbers in the first 64 KiB.
    """
    lines = _first_lines(path)
    candidates = list(DELIMITERS.values()) if options.delimiter is None else [_delimiter(options.delimiter)]
    candidates = [mark for mark in candidates if mark != "," or not options.decimal_comma]
    for number, line in enumerate(lines):
        if number < options.skip or line.lstrip().startswith(_COMMENT_MARKS):
            continue
        rows = [(mark, cells_of(line, mark, decimal_comma=options.decimal_comma)) for mark in candidates]
        if not rows:
            break
        counts = [sum(map(is_number, cells)) for _, cells in rows]
        best = counts.index(max(counts))
        delimiter, cells = rows[best]
        if counts[best] >= _FEWEST_NUMBERS and 2 * counts[best] >= sum(map(bool, cells)):
            above = lines[options.skip : number]
            # NumPy takes one character; heads marked by // are skipped with the lines above.
            marks = (text.lstrip()[0] for text in above if text.lstrip().startswith(_COMMENT_MARKS[:2]))
            comment = next(marks, _COMMENT_MARKS[0])
            header = _header(above, delimiter, len(cells))
            return TableLayout(delimiter, options.decimal_comma, header, number, tuple(cells), comment)
    if not options.decimal_comma:
        # A spreadsheet of a country that writes 1,5 separates by semicolons or tabs.
        with suppress(InputError):
            return find_layout(path, replace(options, decimal_comma=True))
    hint = "" if options.decimal_comma else f", and add {option('decimal_comma')} if it writes 1,5 for 1.5"
    raise InputError(
        f"{path} has no row of numbers near its top, but a table of samples is expected: check that it is one{hint}."
    )


def _first_lines(path: Path) -> list[str]:
    with path.open("rb") as file:
        data = file.read(_HEAD_BYTES)
        more = bool(file.read(1))
    if not data.strip():
        raise InputError(f"{path} is empty: a table of samples is expected.")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in data:
        what = "in UTF-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "not a text"
        raise InputError(f"{path} is {what}, but a table as plain text (UTF-8) is expected: export it so.")
    try:
        text = data.decode("utf-8-sig", errors="ignore" if more else "strict")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # the degree sign as older Windows programs write it
    # Only line feeds count, as for numpy: str.splitlines would also break at form feeds and the like.
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if more and len(lines) > 1 else lines


def _delimiter(given: str) -> str | None:
    if given in DELIMITERS:
        return DELIMITERS[given]
    mark = given.replace("\\t", "\t")
    if len(mark) != 1 or mark.isalnum() or mark in '"#%+-._\r\n':
        raise InputError(
            f"{option('delimiter')} is {given!r}, but one mark, or one of {', '.join(DELIMITERS)}, is expected."
        )
    return None if mark == " " else mark


def _header(above: list[str], delimiter: str | None, width: int) -> tuple[str, ...]:
    """Names in the last line above the numbers, if it has one for each column."""
    for line in reversed(above):
        text = line.strip()
        if not text:
            continue
        # EuRoC and others mark the header as a comment.
        names = cells_of(text.lstrip("#%/").strip(), delimiter)
        return tuple(names) if len(names) == width and not any(map(is_number, names)) else ()
    return ()
