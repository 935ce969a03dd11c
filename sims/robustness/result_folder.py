"""Results of a campaign on disk: every finished trial is saved at once, and all are read back as one table.

A folder holds::

    campaign.toml     the campaign as it was written
    campaign.json     hash of the settings that the numbers depend on, and the software version
    journal.jsonl     trials since the last part, one line each, after the CRC-32 of the line
    parts/            Parquet with page checksums, a thousand rows each
    results.parquet   all rows in the order of trial, point and estimator, once the campaign is complete

A Parquet file is unreadable until it is closed. A trial is therefore written to the journal first: a killed process
leaves it complete except for its last line. Parts are written atomically, and the journal is emptied after that. A
trial that both hold counts once.
"""

from __future__ import annotations

import json
import zlib
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, Self

import pyarrow as pa
import pyarrow.compute as pc
from filelock import FileLock, Timeout
from pyarrow import parquet

from sims.robustness.campaign import AXES
from srt.exceptions import InputError
from srt.recording.atomic_file import atomic_path, atomic_write_text, unwritable
from srt.result.calibration import software
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

    from sims.robustness.campaign import Campaign
    from sims.robustness.trial import Row

_FORMAT: Final = "srt-robustness"
_VERSION: Final = 2
_ROWS: Final = 1000
"""Number of rows of a part: about a megabyte, written after some seconds of work."""
_ROW_GROUP: Final = 100_000
"""Number of rows that are encoded at a time, in 100 MB."""
_ORDER: Final = [("replicate", "ascending"), ("point", "ascending"), ("estimator", "ascending")]


def schema(campaign: Campaign) -> pa.Schema:
    """Columns of a campaign's table.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    pyarrow.Schema
        Columns in SI units; axes in the unit in their name.
    """
    columns = [("point", pa.int32()), ("replicate", pa.int32()), ("seed", pa.int64()), ("estimator", pa.string())]
    columns += [(axis, _axis_type(campaign, axis)) for axis in campaign.axes]
    columns += [(name, pa.string()) for name in ("outcome", "status", "message")]
    columns += [("playbacks", pa.int32()), ("observed", pa.int32())]
    columns += [(name, pa.float64()) for name in ("distance", "nees", "largest", "simulate_s", "calibrate_s")]
    columns += [("nis", pa.list_(pa.float64()))]
    columns += [(f"{stem}_{name}", pa.float64()) for stem in ("truth", "error", "sigma") for name in NAMES]
    return pa.schema(columns)


def _axis_type(campaign: Campaign, axis: str) -> Any:
    table = campaign.random.get(axis)
    values = campaign.grid.get(axis, () if table is None else table.choices or (0.5,))
    if axis in AXES and AXES[axis].kind is int:
        return pa.int32()
    if all(isinstance(v, bool) for v in values):
        return pa.bool_()
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
        return pa.float64()
    return pa.string()


class ResultFolder:
    """Folder of one campaign, locked by one process at a time.

    Parameters
    ----------
    folder : Path
        Folder; created if absent.
    campaign : Campaign
    fresh : bool
        Delete the results of an earlier run.

    Raises
    ------
    InputError
        If the folder is not writable, is in use, or contains another campaign.
    """

    def __init__(self, folder: Path, campaign: Campaign, *, fresh: bool = False) -> None:
        self.folder, self.campaign, self.schema = folder, campaign, schema(campaign)
        self.done: set[tuple[int, int]] = set()
        self._rows: list[Row] = []
        try:
            (folder / "parts").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(unwritable(folder, error)) from None
        self._lock = _locked(folder)
        self._journal = folder / "journal.jsonl"
        try:
            self._check(fresh=fresh)
            self._absorb()
            self._file = self._journal.open("a", encoding="utf-8")
        except OSError as error:
            self._lock.release()
            raise InputError(unwritable(folder, error)) from None
        except InputError:
            self._lock.release()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):
            self._file.close()
        self._lock.release()

    def add(self, rows: list[Row]) -> None:
        """Save the rows of one trial.

        Parameters
        ----------
        rows : list of dict

        Raises
        ------
        InputError
            If they cannot be written.
        """
        self.done.add(_key(rows[0]))
        self._rows += rows
        try:
            text = json.dumps(rows)
            self._file.write(f"{zlib.crc32(text.encode()):08x} {text}\n")
            self._file.flush()
            if len(self._rows) >= _ROWS:
                self._to_part()
        except OSError as error:
            raise InputError(unwritable(self.folder, error)) from None

    def table(self) -> pa.Table:
        """All finished rows, sorted; trials above the campaign's number of trials are omitted.

        Returns
        -------
        pyarrow.Table
        """
        tables = [self._read(path) for path in self._parts()]
        tables.append(pa.Table.from_pylist(self._rows, schema=self.schema))
        columns = pa.concat_tables(tables).columns
        tables.clear()
        keys = pa.table(
            [columns[self.schema.get_field_index(name)] for name, _ in _ORDER], [name for name, _ in _ORDER]
        )
        order = pc.sort_indices(keys, sort_keys=_ORDER)
        order = order.filter(pc.less(keys["replicate"].take(order), self.campaign.trials))
        del keys
        # One column after the other, each in the place of the unsorted one: a second table takes as much memory again.
        for number, column in enumerate(columns):
            columns[number] = column.combine_chunks().take(order)
            del column
        return pa.Table.from_arrays(columns, schema=self.schema)

    def finish(self) -> pa.Table:
        """Write all rows to results.parquet, and return them."""
        self._to_part()
        table = self.table()
        _write(table, self.folder / "results.parquet")
        return table

    def _to_part(self) -> None:
        """Move the rows of the journal into a part."""
        if not self._rows:
            return
        number = 1 + max((int(path.stem.split("-")[1]) for path in self._parts()), default=0)
        _write(
            pa.Table.from_pylist(self._rows, schema=self.schema), self.folder / "parts" / f"part-{number:06d}.parquet"
        )
        self._rows = []
        self._file.close()
        self._file = self._journal.open("w", encoding="utf-8")

    def _absorb(self) -> None:
        """Find the trials that earlier runs finished; the journal of the last one becomes a part."""
        for path in self._parts():
            table = self._read(path, ["point", "replicate"])
            self.done |= set(zip(table["point"].to_pylist(), table["replicate"].to_pylist(), strict=True))
        self._rows = [row for rows in _lines(self._journal) if _key(rows[0]) not in self.done for row in rows]
        self.done |= {_key(row) for row in self._rows}
        self._file = self._journal.open("a", encoding="utf-8")
        self._to_part()
        self._file.close()
        # Its complete lines are in a part now.
        self._journal.write_text("", encoding="utf-8")

    def _check(self, *, fresh: bool) -> None:
        """Refuse the folder of another campaign; write campaign.json into a new one, or into one that is cleared."""
        path = self.folder / "campaign.json"
        found: Any = {}
        with suppress(FileNotFoundError, ValueError):
            found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict) or found.get("format") != _FORMAT:
            held = [path, self._journal, *(self.folder / name for name in ("campaign.toml", "results.parquet"))]
            if self._parts() or any(each.exists() for each in held):
                raise InputError(f"The folder {self.folder} holds results of unknown origin: name another folder.")
        elif fresh:
            self._clear()
        elif (found.get("version"), found.get("digest")) != (_VERSION, self.campaign.digest):
            raise InputError(
                f"The folder {self.folder} holds results of another campaign, or of other settings of this one: "
                "name another folder, or add --fresh to delete them."
            )
        signature = {"format": _FORMAT, "version": _VERSION, "digest": self.campaign.digest, "software": software()}
        atomic_write_text(path, json.dumps(signature, indent=2) + "\n")
        atomic_write_text(self.folder / "campaign.toml", self.campaign.text)

    def _clear(self) -> None:
        for path in (*self._parts(), self.folder / "results.parquet", self._journal):
            path.unlink(missing_ok=True)

    def _parts(self) -> list[Path]:
        return sorted((self.folder / "parts").glob(f"part-{'[0-9]' * 6}.parquet"))

    def _read(self, path: Path, columns: list[str] | None = None) -> pa.Table:
        try:
            table = parquet.read_table(path, columns=columns, page_checksum_verification=True)
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:
            reason = str(error).splitlines()[0].rstrip(".")
        else:
            expected = self.schema if columns is None else pa.schema([self.schema.field(name) for name in columns])
            if table.schema.equals(expected):
                return table
            reason = "its columns are not those of the campaign"
        raise InputError(f"{path} cannot be read ({reason}): remove it, and its trials will be run again.")


def _lines(path: Path) -> Iterator[list[Row]]:
    """Trials of a journal, up to the first line that is incomplete or damaged; later trials are run again."""
    try:
        with path.open("rb") as file:
            for line in file:
                checksum, _, text = line.rstrip(b"\n").partition(b" ")
                if not line.endswith(b"\n") or checksum != b"%08x" % zlib.crc32(text):
                    return
                yield json.loads(text)
    except FileNotFoundError:
        return


def _key(row: Row) -> tuple[int, int]:
    return row["point"], row["replicate"]


def _write(table: pa.Table, path: Path) -> None:
    with atomic_path(path) as temporary:
        parquet.write_table(table, temporary, row_group_size=_ROW_GROUP, write_page_checksum=True)


def _locked(folder: Path) -> Any:
    """File lock, which the operating system releases when the process ends."""
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise InputError(f"Another run is writing to {folder}: wait for it, or name another folder.") from None
    return lock
