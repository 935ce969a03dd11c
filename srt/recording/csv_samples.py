"""Comma-separated tables of numbers with a header row, fast, exact, and with messages that name the line.

The fast reader is numpy's; only when it refuses a file is the file read again, line by line, to say what is
wrong and where.
"""

from __future__ import annotations

import csv
import math
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from srt.types import Array

_ENCODING = "utf-8-sig"  # with or without the mark that Windows programs put first
_ROWS_PER_WRITE = 4096
_TAIL_BYTES = 1 << 16


def read_csv(path: Path, select: Callable[[Sequence[str]], tuple[str, ...]]) -> tuple[tuple[str, ...], Array]:
    """Read the selected columns of a file.

    Parameters
    ----------
    path : Path
    select : callable
        Given the names in the header, returns those to read; may raise InputError.

    Returns
    -------
    names : tuple of str
    table : ndarray, shape (n, len(names))

    Raises
    ------
    InputError
        No header or no rows, cells that are no numbers, rows of unequal length, a file cut off.
    """
    try:
        header, skip = _read_header(path)
        names = _select(path, header, select)
        _check_last_line(path)
        columns = [header.index(name) for name in names]
        # Naming no columns makes numpy check that all rows are equally long; with columns to leave out,
        # that has to be done apart.
        everything = columns == list(range(len(header)))
        table = np.loadtxt(
            path,
            delimiter=",",
            comments="#",
            quotechar='"',
            skiprows=skip,
            usecols=None if everything else columns,
            ndmin=2,
            encoding=_ENCODING,
        )
        if table.shape[1] != len(names) or not (everything or _separators_add_up(path, header, len(table))):
            _explain(path, header, names, skip, "the rows are not equally long")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file in UTF-8: export it again as CSV.") from None
    except ValueError as error:
        _explain(path, header, names, skip, str(error))
    return names, table


def write_csv(path: Path, names: Sequence[str], columns: Sequence[Array]) -> None:
    """Write columns with as many digits as each number needs to be read back exactly.

    Parameters
    ----------
    path : Path
    names : sequence of str
    columns : sequence of ndarray, shape (n,)
    """
    row = ",".join(["%r"] * len(columns)) + "\n"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for start in range(0, len(columns[0]), _ROWS_PER_WRITE):
            block = np.column_stack([column[start : start + _ROWS_PER_WRITE] for column in columns])
            # One formatting call for the whole block: twice as fast as one for each row.
            file.write(row * len(block) % tuple(block.ravel().tolist()))


def _read_header(path: Path) -> tuple[list[str], int]:
    """Names in the header row, and how many lines it ends."""
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
    """Refuse a last line that ends within a cell: its number would be wrong, and look right.

    Without a line break at the end, a last cell shorter than all the two hundred above it was cut off.
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
    """Whether the file holds as many commas as its rows and columns make."""
    if rows == 0:
        return False
    commas, quotes = 0, 0
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            commas += block.count(b",")
            quotes += block.count(b'"') + block.count(b"#")
    # Quoted text and comments may hold commas of their own.
    return quotes > 0 or commas == (rows + 1) * (len(header) - 1)


def _explain(path: Path, header: list[str], names: Sequence[str], skip: int, reason: str) -> None:
    """Find the first line that is wrong, and raise InputError about it."""
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
                raise InputError(
                    f"{path}, line {number}: {len(cells)} cells were found, but the header has {len(header)}: {advice}."
                )
            for name, i in wanted:
                if not _is_number(cells[i]):
                    found = repr(cells[i].strip()[:40]) if cells[i].strip() else "an empty cell"
                    raise InputError(
                        f"{path}, line {number}, column {name}: {found} was found, but a number is expected: "
                        "correct it, or remove the line."
                    )
    raise InputError(f"{path} is not a table of numbers ({reason}): export it again as CSV.")


def _is_number(cell: str) -> bool:
    try:
        value = float(cell)
    except ValueError:
        return False
    # Python reads 1_000 as a number, tables do not mean it.
    return "_" not in cell or math.isnan(value)
