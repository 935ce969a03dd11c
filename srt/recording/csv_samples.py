"""Comma-separated tables of numbers with a header row.

Pyarrow reads large plain files where it is installed; numpy reads all others. If numpy refuses a file, the module
reads it again line by line and names the first wrong line.
"""

from __future__ import annotations

import csv
import math
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from srt.exceptions import InputError, MissingExtraError
from srt.recording.file_guards import load_pyarrow

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from srt.types import Array

_ENCODING = "utf-8-sig"  # with or without a byte order mark

_PYARROW_BYTES = 4 << 20
"""File size from which pyarrow reads, bytes: numpy takes 16 to 26 ms for 1 MB, pyarrow 4 to 6 and 27 for its import."""

_ROWS_PER_WRITE = 4096
"""Rows that one formatting call writes: their text fits into a processor's cache."""

_TAIL_BYTES = 1 << 16
"""End of the file that is searched for a cut-off last line, bytes: several hundred rows."""


def read_csv(path: Path, select: Callable[[Sequence[str]], tuple[str, ...]]) -> tuple[tuple[str, ...], list[Array]]:
    """Read the selected columns of a file.

    Parameters
    ----------
    select : callable
        Function of the names in the header that returns those to read; may raise InputError.

    Returns
    -------
    names : tuple of str
    columns : list of ndarray, shape (n,)

    Raises
    ------
    InputError
        No header or no rows, cells that are not numbers, rows of unequal length, a truncated file.
    """
    try:
        header, skip = _read_header(path)
        names = _select(path, header, select)
        _check_last_line(path)
        columns = _read_with_pyarrow(path, header, names, skip) or _read_with_numpy(path, header, names, skip)
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file in UTF-8: export it again as CSV.") from None
    except csv.Error as error:
        raise InputError(f"{path} is not a table of numbers ({error} characters): export it again as CSV.") from None
    return names, columns


def _read_with_numpy(path: Path, header: list[str], names: Sequence[str], skip: int) -> list[Array]:
    """Columns by numpy's reader, which knows comments and quoted cells. Raises InputError."""
    indices = [header.index(name) for name in names]
    # Without named columns, numpy checks that all rows are equally long; with them, this function has to.
    everything = indices == list(range(len(header)))
    reason = "the rows are not equally long"
    try:
        table = np.loadtxt(
            path,
            delimiter=",",
            comments="#",
            quotechar='"',
            skiprows=skip,
            usecols=None if everything else indices,
            ndmin=2,
            encoding=_ENCODING,
        )
    except UnicodeDecodeError:
        raise
    except ValueError as error:
        reason = str(error)
    else:
        if table.shape[1] == len(names) and (everything or _separators_add_up(path, header, len(table))):
            return list(table.T)
    raise _fault(path, header, names, skip, reason)


def _read_with_pyarrow(path: Path, header: list[str], names: Sequence[str], skip: int) -> list[Array] | None:
    """Columns by pyarrow's reader, three times faster than numpy's.

    None for small files, if pyarrow is not installed or lacks memory, and for files that it would read otherwise or not
    at all: numpy's reader then gives the values or the reason. Both round numbers correctly, so the values are equal.
    """
    if path.stat().st_size < _PYARROW_BYTES or not _is_plain(path):
        return None
    try:
        pa, arrow_csv = load_pyarrow("csv", "A CSV file")
    except (MissingExtraError, MemoryError):
        return None
    # Numbered names, because a file may have several unused columns of one name.
    numbered = [str(i) for i in range(len(header))]
    wanted = [str(header.index(name)) for name in names]
    try:
        table = arrow_csv.read_csv(
            path,
            read_options=arrow_csv.ReadOptions(skip_rows=skip, column_names=numbered),
            parse_options=arrow_csv.ParseOptions(quote_char=False),
            convert_options=arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(wanted, pa.float64()), include_columns=wanted, null_values=[]
            ),
        )
    except pa.ArrowException:
        return None
    # Not to_numpy(), which imports pandas to ask whether it is there: 0.3 s.
    columns = [np.array(np.from_dlpack(table.column(name).combine_chunks())) for name in wanted]
    # Pyarrow also reads words such as "nan(1)"; numpy's reader decides on all that is not finite.
    return columns if all(np.isfinite(column).all() for column in columns) else None


def _is_plain(path: Path) -> bool:
    """True if a file is ASCII without quotation marks and comments."""
    with path.open("rb") as file:
        file.read(3)  # perhaps a byte order mark
        while block := file.read(1 << 20):
            if not block.isascii() or b'"' in block or b"#" in block:
                return False
    return True


def write_csv(path: Path, names: Sequence[str], columns: Sequence[Array]) -> None:
    """Write columns, each number with the digits that it needs to be read back exactly.

    Parameters
    ----------
    columns : sequence of ndarray, shape (n,)
    """
    row = ",".join(["%r"] * len(columns)) + "\n"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for start in range(0, len(columns[0]), _ROWS_PER_WRITE):
            block = np.column_stack([column[start : start + _ROWS_PER_WRITE] for column in columns])
            # One formatting call per block is twice as fast as one per row.
            file.write(row * len(block) % tuple(block.ravel().tolist()))


def _read_header(path: Path) -> tuple[list[str], int]:
    """Names in the header row, and the number of its line."""
    with path.open(encoding=_ENCODING, newline="") as file:
        for number, line in enumerate(file, start=1):
            text = line.strip()
            if text.startswith("#") and "gyro_x" in text:  # a header may be marked as a comment
                text = text.lstrip("#").lstrip()
            if not text or text.startswith("#"):
                continue
            names = [name.strip() for name in next(csv.reader([text]))]
            if not any(row.strip() and not row.lstrip().startswith("#") for row in file):
                raise InputError(f"{path} ends after its header row: there are no samples in it.")
            return names, number
    raise InputError(f"{path} is empty: a header row with column names, then one row per sample, is expected.")


def _select(path: Path, header: list[str], select: Callable[[Sequence[str]], tuple[str, ...]]) -> tuple[str, ...]:
    if all(_is_number(name) for name in header):
        raise InputError(
            f"{path} starts with a row of numbers, but a header row is expected: put the column names first."
        )
    if len(header) == 1:
        for mark, called in ((";", "semicolons"), ("\t", "tabs"), (" ", "blanks")):
            if mark in header[0]:
                raise InputError(f"{path} is separated by {called}, but commas are expected: export it again.")
    return select(header)


def _check_last_line(path: Path) -> None:
    """Refuse a last line that was cut within a cell, because its number would be plausible and wrong.

    It is taken as cut if it has no line break, and a last cell shorter than those of the 200 rows above.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _TAIL_BYTES))
        tail = file.read()
    if tail.endswith((b"\n", b"\r")):
        return
    lengths = [len(line.rpartition(b",")[2].strip()) for line in tail.splitlines()[-201:]]
    if len(lengths) > 20 and lengths[-1] < min(lengths[1:-1]):
        raise InputError(
            f"{path} seems cut off in its last line, which has no line break and a shorter last cell than "
            "the rows above: copy the file again, or remove that line."
        )


def _separators_add_up(path: Path, header: list[str], rows: int) -> bool:
    """True if the number of commas in the file agrees with its rows and columns."""
    if rows == 0:
        return False
    commas, quotes = 0, 0
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            commas += block.count(b",")
            quotes += block.count(b'"') + block.count(b"#")
    # Quoted text and comments may hold commas of their own.
    return quotes > 0 or commas == (rows + 1) * (len(header) - 1)


def _fault(path: Path, header: list[str], names: Sequence[str], skip: int, reason: str) -> InputError:
    """Find the first wrong line, and make the error that names it."""
    wanted = [(name, header.index(name)) for name in names]
    with path.open(encoding=_ENCODING, newline="") as file:
        numbered = islice(enumerate(file, start=1), skip, None)
        for number, line in numbered:
            text = line.partition("#")[0].strip()
            if not text:
                continue
            cells = next(csv.reader([text]))
            if len(cells) != len(header):
                cut = not any(rest.strip() for _, rest in numbered) and len(cells) < len(header)
                advice = (
                    "the file seems cut off: copy it again, or remove that line"
                    if cut
                    else "write every row alike (with decimal points, not commas)"
                )
                return InputError(
                    f"{path}, line {number}: {len(cells)} cells were found, but the header has {len(header)}: {advice}."
                )
            for name, i in wanted:
                if not _is_number(cells[i]):
                    found = repr(cells[i].strip()[:40]) if cells[i].strip() else "an empty cell"
                    return InputError(
                        f"{path}, line {number}, column {name}: {found} was found, but a number is expected: "
                        "correct it, or remove the line."
                    )
    return InputError(f"{path} is not a table of numbers ({reason}): export it again as CSV.")


def _is_number(cell: str) -> bool:
    try:
        value = float(cell)
    except ValueError:
        return False
    # Python accepts 1_000 as a number; a table does not.
    return "_" not in cell or math.isnan(value)
