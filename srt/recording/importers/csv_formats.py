"""Text tables by the layout of their first row of numbers: EuRoC, Kalibr, the pair of files of imu_tk, and others."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.model.table1 import AXES
from srt.recording.import_options import ImportOptions, option
from srt.recording.imported_samples import (
    ImportedSamples,
    StatedUnits,
    join_streams,
    of_channels,
    samples_in_si,
    seconds_of,
    stamps_without_unit,
)
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.channels import (
    ColumnAssignment,
    assign,
    listed,
    meaning_of,
    unread,
    with_temperature,
)
from srt.recording.samples import TIME
from srt.recording.text_tables import TableLayout, cells_of, is_date, is_number, read_table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.recording.recording import Kind
    from srt.types import Array

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


TEXT_OPTIONS: Final = frozenset({"columns", "time_unit", "delimiter", "decimal_comma", "skip"})

_PUBLISHED: Final[Mapping[Kind, StatedUnits]] = {"rate": StatedUnits("rad/s", "m/s^2", "ns")}
"""Units that EuRoC and Kalibr define."""

_ROUNDED: Final = re.compile(r"\d[.,]\d{1,9}[eE]\+(1\d|9)")
"""Large stamp with ten digits or fewer, as spreadsheets write ns, µs or ms since 1970."""

_DATA_NAME: Final = "data.csv"

_PAIR_COLUMNS: Final = (TIME, *AXES)


def read_csv_table(
    path: Path,
    options: ImportOptions,
    published: Mapping[Kind, StatedUnits] | None = None,
    sample_rate_hz: float | None = None,
) -> ImportedSamples:
    """Read a text table by its header, or by the columns in the options.

    ``published`` are the units that the format defines, by the kind of samples; they override the header.
    ``sample_rate_hz`` is the rate by the format, used where the table has no stamps. Raises InputError.
    """
    layout = find_layout(path, options)
    found = assign(path, layout.header, len(layout.cells), options.columns, kind=options.kind)
    kind: Kind | None = None if options.kind is not None else found.kind
    stated = None
    if published is not None:
        kind = found.kind or "rate"
        stated = published.get(kind)
    if TIME in found.columns:
        rate = options.sample_rate_hz or sample_rate_hz
        found = _usable(path, layout, found, options, stated or found.stated, rate)
    dates = TIME if TIME in found.columns and is_date(layout.cells[found.columns[TIME]]) else None
    table = read_table(path, layout, found.columns, integers=TIME, dates=dates)
    commas = ("Decimal commas were found, and read as points.",) if layout.decimal_comma > options.decimal_comma else ()
    return samples_in_si(
        options,
        **of_channels(table),
        stated=stated or found.stated,
        kind=kind,
        sample_rate_hz=None if TIME in table else sample_rate_hz,
        notes=(*(found.notes if stated is not None else with_temperature(found.notes, table)), *commas),
        unread=unread(layout.header, found.columns),
    )


def read_pair(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read a pair of text tables, one for each sensor, of ``time x y z``.

    ``path`` is that of the accelerometers, unless the name of a file contains "gyr". Raises InputError.
    """
    second = options.second
    if second is None:
        raise InputError(
            f"{path}: this format has one file for each sensor: name both, the file of the accelerometers first."
        )
    # By their names, else in this order.
    named_gyro = ["gyr" in file.stem.lower() for file in (path, second)]
    accel_path, gyro_path = (second, path) if named_gyro == [True, False] else (path, second)
    notes = [f"Accelerometers from {accel_path.name}, gyros from {gyro_path.name}."]
    tables, units = [], []
    for file in (gyro_path, accel_path):
        layout = find_layout(file, options)
        tables.append(_pair_table(file, layout))
        meanings = filter(None, map(meaning_of, layout.header))
        units.append(next((each.unit for each in meanings if each.channel == TIME and each.unit), None))
    (gyro, accel), unit = tables, options.time_unit or units[0]
    if unit is None and options.sample_rate_hz is not None and np.array_equal(gyro[TIME], accel[TIME]):
        notes.append(stamps_without_unit())
        return samples_in_si(
            options, gyro=_triad(gyro), accel=_triad(accel), time=None, stated=StatedUnits(), notes=tuple(notes)
        )
    if unit is None or (options.time_unit is None and units[0] != units[1]):
        raise InputError(
            f"{gyro_path} and {accel_path} do not state in what unit their times are: state it with "
            f"{option('time_unit')}."
        )
    # Both are counted from the same stamp, so that their difference stays exact.
    first = gyro[TIME][:1]
    gyro_time, accel_time = (
        seconds_of(np.concatenate((first, table[TIME])), unit, notes if table is gyro else [])[1:]
        for table in (gyro, accel)
    )
    kept, force = join_streams(gyro_time, accel_time, _triad(accel), notes)
    result = samples_in_si(
        replace(options, time_unit=None),
        gyro=_triad(gyro)[kept],
        accel=force,
        time=gyro_time[kept],
        stated=StatedUnits(time="s"),
        notes=tuple(notes),
    )
    return replace(result, units={**result.units, "time": f"{unit} ({'as given' if options.time_unit else 'header'})"})


def _triad(table: dict[str, NDArray[Any]]) -> Array:
    """Columns x, y, z of a table, shape (n, 3)."""
    return np.column_stack([table[name] for name in AXES]).astype(np.float64, copy=False)


def _usable(
    path: Path,
    layout: TableLayout,
    found: ColumnAssignment,
    options: ImportOptions,
    stated: StatedUnits,
    rate: float | None,
) -> ColumnAssignment:
    """Ignore a column of time of unknown unit, empty, or rounded by a spreadsheet, if the rate is known.

    Raises InputError if it is not.
    """
    cell = layout.cells[found.columns[TIME]].strip()
    doubtful = options.time_unit is None and stated.time is None and not is_date(cell)
    if options.sample_rate_hz is not None and doubtful:
        note = stamps_without_unit()
    elif cell and not _ROUNDED.fullmatch(cell):
        return found
    else:
        reason = f"the time stamps were rounded by a spreadsheet ({cell})" if cell else "the column of time is empty"
        if rate is None:
            raise InputError(
                f"{path}: {reason}: export the log again, or state the rate with {option('sample_rate_hz')}."
            )
        note = f"Not used: {reason}."
    columns = {channel: i for channel, i in found.columns.items() if channel != TIME}
    return replace(found, columns=columns, notes=(*found.notes, note))


def _pair_table(path: Path, layout: TableLayout) -> dict[str, NDArray[Any]]:
    columns: dict[str, int] = {}
    for i, name in enumerate(layout.header):
        bare = name.partition("[")[0].partition("(")[0].strip().lower()
        columns.setdefault(TIME if bare in ("time", "timestamp", "t") else re.split(r"[_ ]+", bare)[-1], i)
    if not layout.header and len(layout.cells) == len(_PAIR_COLUMNS):
        columns = {name: i for i, name in enumerate(_PAIR_COLUMNS)}
    missing = [name for name in _PAIR_COLUMNS if name not in columns]
    if missing:
        found = listed(layout.header, f"{len(layout.cells)} columns without names")
        raise InputError(f"{path} has no column {missing[0]} (found: {found}): time, x, y and z are expected.")
    columns = {name: i for name, i in columns.items() if name in _PAIR_COLUMNS}
    return read_table(path, layout, columns, integers=TIME)


def _header_has(*words: str) -> Callable[[Path], bool]:
    def sniff(path: Path) -> bool:
        line = head(path / _DATA_NAME if path.is_dir() else path).split(b"\n", 1)[0]
        return all(word.encode() in line for word in words)

    return sniff


def _is_text_table(path: Path) -> bool:
    try:
        return path.is_file() and bool(find_layout(path, ImportOptions()).cells)
    except (InputError, OSError):
        return False


def _read_published(path: Path, options: ImportOptions) -> ImportedSamples:
    file = path / _DATA_NAME if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"The folder {path} holds no {_DATA_NAME}: name the file of samples.")
    return read_csv_table(file, options, _PUBLISHED)


_OWN_UNITS: Final = TEXT_OPTIONS - {"skip"}

EUROC: Final = Importer(
    "euroc", "EuRoC CSV", (), None, _header_has("timestamp", "w_RS_S_x", "a_RS_S_z"), _read_published, _OWN_UNITS
)
KALIBR: Final = Importer(
    "kalibr", "Kalibr CSV", (), None, _header_has("timestamp", "omega_x", "alpha_z"), _read_published, _OWN_UNITS
)
_PAIR_OPTIONS = TEXT_OPTIONS - {"columns"} | {"second"}
# Each file of a pair is a table like any other.
IMU_TK: Final = Importer(
    "imu-tk", "a pair of text files, one per sensor", (), None, lambda _: False, read_pair, _PAIR_OPTIONS
)
_SUFFIXES: Final = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc")
CSV: Final = Importer("csv", "table as text", _SUFFIXES, None, _is_text_table, read_csv_table, TEXT_OPTIONS)
