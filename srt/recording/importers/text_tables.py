"""Tables of numbers as text, with any separator, with or without a header; messages name the line.

The layout follows from the first row of numbers and the line above it. NumPy then reads all numbers at once. If it
fails, the file is read again, line by line, to find the fault and its place.
"""

from __future__ import annotations

import csv
import datetime
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.import_options import ImportOptions, option

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

DELIMITERS: Final = {"tab": "\t", "semicolon": ";", "comma": ",", "pipe": "|", "blank": None}
"""Names on the command line; blank stands for any run of blanks and tabs."""

_HEAD_BYTES = 1 << 16
"""Bytes in which the first row of numbers is searched: titles and notes take a few thousand."""

_TAIL_BYTES = 1 << 16
"""Bytes at the end whose rows are compared with the last one: some hundred rows."""

_COMMENT_MARKS = ("#", "%", "//")

_INTEGER = re.compile(r"[+-]?\d{1,19}")

_DATE = re.compile(
    r"(\d{4}-?\d\d-?\d\d[T ]\d\d:?\d\d:?\d\d)(?:[.,](\d{1,9})\d*)? ?(Z|[+-]\d\d(?::?\d\d)?)?", re.IGNORECASE
)
"""Date and time of ISO 8601: seconds, their fraction, and the time zone."""

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)

_FEWEST_NUMBERS = 3
"""Numbers in the first row; fewer may stand in a line of notes."""


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Layout of a text table.

    Attributes
    ----------
    delimiter : str or None
        None: any run of blanks.
    header : tuple of str
        Names of the columns; empty without a header.
    first_row : int
        Lines before the first row of numbers.
    cells : tuple of str
        Cells of that row.
    comment : str
        The mark of lines that are not read.
    """

    delimiter: str | None
    decimal_comma: bool
    header: tuple[str, ...]
    first_row: int
    cells: tuple[str, ...]
    comment: str


def find_layout(path: Path, options: ImportOptions) -> TableLayout:
    """Find the layout of a table.

    Parameters
    ----------
    options : ImportOptions
        ``delimiter``, ``decimal_comma`` and ``skip`` are used without a check.

    Raises
    ------
    InputError
        No text, an unknown delimiter, or no row of numbers in the first 64 KiB.
    """
    lines = _first_lines(path)
    candidates = list(DELIMITERS.values())
    if options.delimiter is not None:
        candidates = [_delimiter(options.delimiter)]
    if options.decimal_comma:
        candidates = [mark for mark in candidates if mark != ","]
    for number, line in enumerate(lines):
        if number < options.skip or line.lstrip().startswith(_COMMENT_MARKS):
            continue
        rows = [(mark, _cells(line, mark, decimal_comma=options.decimal_comma)) for mark in candidates]
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


def read_table(
    path: Path,
    layout: TableLayout,
    columns: Mapping[str, int],
    *,
    integers: str | None = None,
    dates: str | None = None,
) -> dict[str, NDArray[Any]]:
    """Read the chosen columns, without rows of empty cells at the end, as spreadsheets write them.

    Parameters
    ----------
    columns : mapping of str to int
        Name to position, from 0.
    integers : str, optional
        The name of a column whose whole numbers stay integers: nanoseconds since 1970 are no doubles.
    dates : str, optional
        The name of a column of dates by ISO 8601.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Dates are in UTC, of type ``datetime64[ns]``; without a time zone they are taken as UTC.

    Raises
    ------
    InputError
        Cells that are no numbers, rows of unequal length, a file that is cut off; the line is named.
    """
    empty = _empty_rows(path, layout)
    if not empty:
        _check_last_line(path, layout)
    names = list(columns)
    exact = integers in columns and _INTEGER.fullmatch(layout.cells[columns[str(integers)]].strip()) is not None
    attempts = [np.int64, np.float64] if exact else [np.int64] if dates is not None else [np.float64]
    reason = ""
    for kind in attempts:
        dtype = [(f"c{i}", kind if name in (integers, dates) else np.float64) for i, name in enumerate(names)]
        source = _rows(path, layout) if layout.decimal_comma or empty else path
        try:
            table = _load(source, layout, dtype, [columns[name] for name in names], columns.get(str(dates)))
        except (ValueError, OverflowError) as error:
            reason = str(error)
            continue
        except OSError as error:
            raise InputError(f"Cannot read {path} ({error.strerror}): check its permissions.") from None
        if not _rows_add_up(path, layout, table.size, empty):
            reason = "the rows are not equally long"
            break
        found = {name: table[f"c{i}"] for i, name in enumerate(names)}
        return {name: values.astype("M8[ns]") if name == dates else values for name, values in found.items()}
    raise _explanation(path, layout, columns, reason, dates)


def is_number(cell: str) -> bool:
    """True for a cell that holds a number; Python's 1_000 is none."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def is_date(cell: str) -> bool:
    """True for a cell that holds a date and time by ISO 8601."""
    try:
        _nanoseconds(cell)
    except ValueError:
        return False
    return True


def _nanoseconds(cell: str) -> int:
    """Nanoseconds since 1970 of a date. Raises ValueError."""
    match = _DATE.fullmatch(cell.strip().strip('"'))
    if match is None:
        raise ValueError(f"{cell} is no date")
    second, fraction, zone = match.groups()
    return _seconds(f"{second}{zone or 'Z'}".upper()) * 10**9 + int((fraction or "0").ljust(9, "0"))


@lru_cache(maxsize=1)
def _seconds(date: str) -> int:
    """Seconds since 1970 of a date; the samples within one second share it. Raises ValueError."""
    return (datetime.datetime.fromisoformat(date) - _EPOCH) // datetime.timedelta(seconds=1)


def _first_lines(path: Path) -> list[str]:
    try:
        with path.open("rb") as file:
            data = file.read(_HEAD_BYTES)
            more = bool(file.read(1))
    except OSError as error:
        raise InputError(f"Cannot read {path} ({error.strerror}): check its permissions.") from None
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


def _cells(line: str, delimiter: str | None, *, decimal_comma: bool = False) -> list[str]:
    if decimal_comma:
        line = line.replace(",", ".")
    if delimiter is None:
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return []


def _header(above: list[str], delimiter: str | None, width: int) -> tuple[str, ...]:
    """Names in the last line above the numbers, if it has one for each column."""
    for line in reversed(above):
        text = line.strip()
        if not text:
            continue
        # EuRoC and others mark the header as a comment.
        names = _cells(text.lstrip("#%/").strip(), delimiter)
        return tuple(names) if len(names) == width and not any(map(is_number, names)) else ()
    return ()


def _load(
    source: Path | Iterator[str], layout: TableLayout, dtype: Any, usecols: list[int], dates: int | None
) -> NDArray[Any]:
    # Naming no columns makes numpy check that all rows are equally long.
    everything = usecols == list(range(len(layout.cells)))
    return np.loadtxt(
        source,
        dtype=np.dtype(dtype),
        delimiter=layout.delimiter,
        comments=layout.comment,
        quotechar='"',
        skiprows=layout.first_row,
        usecols=None if everything else usecols,
        converters=None if dates is None else {dates: _nanoseconds},
        ndmin=1,
        # Digits are the same in all encodings that have them as single bytes, and this one refuses no byte.
        encoding="latin-1",
    )


def _rows(path: Path, layout: TableLayout) -> Iterator[str]:
    """Lines with decimal points, without rows of empty cells at the end."""
    blanks = _blanks(layout)
    held: list[str] = []
    with path.open(encoding="latin-1") as file:
        for line in file:
            held.append(line.replace(",", ".") if layout.decimal_comma else line)
            if line.strip(blanks):
                yield from held
                held.clear()


def _blanks(layout: TableLayout) -> str:
    """Characters of a row of empty cells."""
    return ' \t\r\n"' + (layout.delimiter or "")


def _empty_rows(path: Path, layout: TableLayout) -> bytes:
    """Rows of empty cells at the end of a file; blank lines alone are none, as they are never read."""
    blanks, mark, length = _blanks(layout).encode(), (layout.delimiter or "").encode(), _TAIL_BYTES
    with path.open("rb") as file:
        size = file.seek(0, 2)
        while True:
            file.seek(max(0, size - length))
            tail = file.read()
            kept = tail.rstrip(blanks)
            if kept or length >= size:
                break
            length *= 4
    # The first line break ends the last row of numbers, which may itself end with empty cells.
    rows = tail[len(kept) :].partition(b"\n")[2]
    return rows if mark and mark in rows else b""


def _check_last_line(path: Path, layout: TableLayout) -> None:
    """Refuse a last line that ends within a cell: its number would be wrong, but plausible.

    Without a line break at the end, a last cell shorter than all the two hundred above it was cut off.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _TAIL_BYTES))
        tail = file.read().decode("latin-1")
    if tail.endswith(("\n", "\r")):
        return
    rows = [_cells(line, layout.delimiter) for line in tail.splitlines()[-201:]]
    lengths = [len(cells[-1]) if cells else 0 for cells in rows]
    if len(lengths) > 20 and lengths[-1] < min(lengths[1:-1]):
        raise InputError(
            f"{path} seems cut off in its last line, which has no line break and a shorter last cell than the rows "
            "above: copy the file again, or remove that line."
        )


def _rows_add_up(path: Path, layout: TableLayout, rows: int, empty: bytes) -> bool:
    """True if the number of separators fits that of rows and columns; blanks cannot be counted."""
    if rows == 0:
        return False
    if layout.delimiter is None:
        return True
    mark, others = layout.delimiter.encode(), 0
    found = -empty.count(mark)
    with path.open(encoding="latin-1") as text:
        # Titles and notes at the top may hold any number of them.
        for line in islice(text, layout.first_row):
            found -= line.count(layout.delimiter)
            others -= line.count('"') + line.count(layout.comment)
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            found += block.count(mark)
            others += block.count(b'"') + block.count(layout.comment.encode())
    # Quoted text and comments may hold separators of their own.
    return others > 0 or found == rows * (len(layout.cells) - 1)


def _explanation(
    path: Path, layout: TableLayout, columns: Mapping[str, int], reason: str, dates: str | None
) -> InputError:
    """Find the first faulty line, and describe its fault."""
    width = len(layout.cells)
    numbered = islice(enumerate(_rows(path, layout), start=1), layout.first_row, None)
    for number, line in numbered:
        text = line.partition(layout.comment)[0].strip("\r\n")
        if not text.strip():
            continue
        cells = _cells(text, layout.delimiter)
        if len(cells) != width:
            cut = not any(rest.strip() for _, rest in numbered) and len(cells) < width
            advice = (
                "the file seems cut off: copy it again, or remove that line"
                if cut
                else "write every row alike, or name the separator with " + option("delimiter")
            )
            return InputError(
                f"{path}, line {number}: {len(cells)} cells were found, but the first row of numbers (line "
                f"{layout.first_row + 1}) has {width}: {advice}."
            )
        for name, i in columns.items():
            right, expected = (is_date, "a date by ISO 8601") if name == dates else (is_number, "a number")
            if not right(cells[i]):
                found = repr(cells[i][:40]) if cells[i] else "an empty cell"
                return InputError(
                    f"{path}, line {number}, column {i + 1} ({name}): {found} was found, but {expected} is "
                    "expected: correct it, or remove the line."
                )
    return InputError(f"{path} is not a table of numbers ({reason.splitlines()[0][:120] if reason else 'no rows'}).")
