"""Tables of numbers as text, once their layout is known; messages name the line.

Pyarrow reads large plain files where it is installed; NumPy reads all others at once. If it fails, the file is read
again, line by line, to find the fault and its place.
"""

from __future__ import annotations

import csv
import datetime
import re
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from srt.exceptions import InputError, MissingExtraError
from srt.recording.file_guards import load_pyarrow

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.types import Array

_PYARROW_BYTES = 4 << 20
"""File size from which pyarrow reads, bytes: numpy takes 16 to 26 ms for 1 MB, pyarrow 4 to 6 and 27 for its import."""

_ROWS_PER_WRITE = 4096  # rows that one formatting call writes: their text fits into a processor's cache
_TAIL_BYTES = 1 << 16  # bytes at the end whose rows are compared with the last one: some hundred rows

_INTEGER = re.compile(r"[+-]?\d{1,19}")

_DATE = re.compile(
    r"(\d{4}-?\d\d-?\d\d[T ]\d\d:?\d\d:?\d\d)(?:[.,](\d{1,9})\d*)? ?(Z|[+-]\d\d(?::?\d\d)?)?", re.IGNORECASE
)
"""Date and time of ISO 8601: seconds, their fraction, and the time zone."""

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Layout of a text table."""

    delimiter: str | None  # None: any run of blanks
    decimal_comma: bool
    header: tuple[str, ...]  # names of the columns; empty without a header
    first_row: int  # lines before the first row of numbers
    cells: tuple[str, ...]  # of that row; of a samples file, those of the header
    comment: str  # mark of lines that are not read
    own: bool = False  # samples file: UTF-8, columns known by name, no rows of empty cells at its end

    @property
    def encoding(self) -> str:
        """Digits are the same in all encodings that have them as single bytes, and latin-1 refuses no byte."""
        return "utf-8-sig" if self.own else "latin-1"  # with or without a byte order mark


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

    Raises InputError for cells that are no numbers, rows of unequal length, a file that is cut off; the line is named.
    A samples file raises UnicodeDecodeError if it is not UTF-8, csv.Error for a cell of more than 131072 characters.
    """
    empty = b"" if layout.own else _empty_rows(path, layout)
    if not empty:
        _check_last_line(path, layout)
    exact = integers in columns and _INTEGER.fullmatch(layout.cells[columns[str(integers)]].strip()) is not None
    kinds = [np.int64, np.float64] if exact else [np.int64] if dates is not None else [np.float64]
    reason = ""
    for kind in kinds:
        types = {name: kind if name in (integers, dates) else np.float64 for name in columns}
        if dates is None and not empty:
            table = _read_with_pyarrow(path, layout, columns, types)
            if table is not None:
                return table
        source = _rows(path, layout) if layout.decimal_comma or empty else path
        try:
            found = _load(source, layout, columns, types, columns.get(str(dates)))
        except UnicodeDecodeError:
            raise
        except (ValueError, OverflowError) as error:
            reason = str(error)
            continue
        if not _rows_add_up(path, layout, found.size, empty):
            reason = "the rows are not equally long"
            break
        read = {name: found[f"c{i}"] for i, name in enumerate(columns)}
        return {name: values.astype("M8[ns]") if name == dates else values for name, values in read.items()}
    raise _explanation(path, layout, columns, reason, dates)


def write_csv(path: Path, names: Sequence[str], columns: Sequence[Array]) -> None:
    """Write columns, shape (n,) each, each number with the digits that it needs to be read back exactly."""
    row = ",".join(["%r"] * len(columns)) + "\n"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for start in range(0, len(columns[0]), _ROWS_PER_WRITE):
            block = np.column_stack([column[start : start + _ROWS_PER_WRITE] for column in columns])
            # One formatting call per block is twice as fast as one per row.
            file.write(row * len(block) % tuple(block.ravel().tolist()))


def is_number(cell: str) -> bool:
    """True for a cell that holds a number; Python's 1_000 is none."""
    return "_" not in cell and _is_read(float, cell)


def is_date(cell: str) -> bool:
    """True for a cell that holds a date and time by ISO 8601."""
    return _is_read(_nanoseconds, cell)


def _is_read(read: Callable[[str], float], cell: str) -> bool:
    try:
        read(cell)
    except ValueError:
        return False
    return True


def cells_of(line: str, delimiter: str | None, *, decimal_comma: bool = False) -> list[str]:
    """Cells of a line, stripped; none for one that is no CSV."""
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


def _load(
    source: Path | Iterator[str],
    layout: TableLayout,
    columns: Mapping[str, int],
    types: Mapping[str, Any],
    dates: int | None,
) -> NDArray[Any]:
    # Naming no columns makes numpy check that all rows are equally long.
    everything = list(columns.values()) == list(range(len(layout.cells)))
    return np.loadtxt(
        source,
        dtype=np.dtype([(f"c{i}", kind) for i, kind in enumerate(types.values())]),
        delimiter=layout.delimiter,
        comments=layout.comment,
        quotechar='"',
        skiprows=layout.first_row,
        usecols=None if everything else list(columns.values()),
        converters=None if dates is None else {dates: _nanoseconds},
        ndmin=1,
        encoding=layout.encoding,
    )


def _read_with_pyarrow(
    path: Path, layout: TableLayout, columns: Mapping[str, int], types: Mapping[str, Any]
) -> dict[str, NDArray[Any]] | None:
    """Columns by pyarrow's reader, three times faster than numpy's; both round correctly, so the values are equal.

    None for small files, if pyarrow is not installed or lacks memory, and for files that it would read otherwise or not
    at all: numpy's reader then gives the values or the reason.
    """
    if layout.delimiter is None or layout.decimal_comma or path.stat().st_size < _PYARROW_BYTES:
        return None
    if not _is_plain(path, layout):
        return None
    try:
        pa, arrow_csv = load_pyarrow("csv", "A CSV file")
    except (MissingExtraError, MemoryError):
        return None
    # Numbered names, because a file may have several unused columns of one name.
    numbered = [str(i) for i in range(len(layout.cells))]
    wanted = {str(i): pa.from_numpy_dtype(types[name]) for name, i in columns.items()}
    reading = arrow_csv.ReadOptions(skip_rows=layout.first_row, column_names=numbered)
    parsing = arrow_csv.ParseOptions(delimiter=layout.delimiter, quote_char=False)
    converting = arrow_csv.ConvertOptions(column_types=wanted, include_columns=list(wanted), null_values=[])
    try:
        table = arrow_csv.read_csv(path, reading, parsing, converting)
    except pa.ArrowException:
        return None
    # Not to_numpy(), which imports pandas to ask whether it is there: 0.3 s.
    found = {name: np.array(np.from_dlpack(table.column(str(i)).combine_chunks())) for name, i in columns.items()}
    # Pyarrow also reads words such as "nan(1)"; numpy's reader decides on all that is not finite.
    return found if all(np.isfinite(column).all() for column in found.values()) else None


def _is_plain(path: Path, layout: TableLayout) -> bool:
    """True if a file is ASCII without quotation marks and comments."""
    comment = layout.comment.encode()
    with path.open("rb") as file:
        file.read(3)  # perhaps a byte order mark
        while block := file.read(1 << 20):
            if not block.isascii() or b'"' in block or comment in block:
                return False
    return True


def _rows(path: Path, layout: TableLayout) -> Iterator[str]:
    """Lines with decimal points, without rows of empty cells at the end."""
    blanks = "" if layout.own else _blanks(layout)
    held: list[str] = []
    with path.open(encoding=layout.encoding) as file:
        for line in file:
            held.append(line.replace(",", ".") if layout.decimal_comma else line)
            if line.strip(blanks) or layout.own:
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
    rows = [cells_of(line, layout.delimiter) for line in tail.splitlines()[-201:]]
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
    compared, advised = "the header", "write every row alike (with decimal points, not commas)"
    if not layout.own:
        compared = f"the first row of numbers (line {layout.first_row + 1})"
        advised = "write every row alike, or name the separator with --delimiter"
    numbered = islice(enumerate(_rows(path, layout), start=1), layout.first_row, None)
    for number, line in numbered:
        text = line.partition(layout.comment)[0].strip("\r\n")
        if not text.strip():
            continue
        # The reader of CSV refuses cells of more than 131072 characters by name.
        cells = [*map(str.strip, next(csv.reader([text])))] if layout.own else cells_of(text, layout.delimiter)
        if len(cells) != width:
            cut = not any(rest.strip() for _, rest in numbered) and len(cells) < width
            advice = "the file seems cut off: copy it again, or remove that line" if cut else advised
            return InputError(
                f"{path}, line {number}: {len(cells)} cells were found, but {compared} has {width}: {advice}."
            )
        for name, i in columns.items():
            right, expected = (is_date, "a date by ISO 8601") if name == dates else (is_number, "a number")
            if not right(cells[i]):
                found = repr(cells[i][:40]) if cells[i] else "an empty cell"
                column = name if layout.own else f"{i + 1} ({name})"
                return InputError(
                    f"{path}, line {number}, column {column}: {found} was found, but {expected} is expected: correct "
                    "it, or remove the line."
                )
    what = reason.splitlines()[0][:120] if reason else "no rows"
    return InputError(f"{path} is not a table of numbers ({what}): export it again as CSV.")
