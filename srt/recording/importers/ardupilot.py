"""ArduPilot logs (DataFlash, .bin or .log as text): IMU, or GYR with ACC; rad/s and m/s² as ArduPilot defines them.

pymavlink finds the messages and their layout; numpy reads the columns of all samples at once. The messages PARM give
the calibration and orientation that ArduPilot applied.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.autopilots import ARDUPILOT as PARAMETERS
from srt.recording.file_guards import clear_errors
from srt.recording.importer_registry import Importer, head
from srt.recording.importers.child_process import in_child
from srt.recording.importers.log_streams import Stream, choose_topic, join, to_imported
from srt.recording.text_tables import is_number

if TYPE_CHECKING:
    import mmap
    from pathlib import Path

    from numpy.typing import NDArray

    from srt.recording.import_options import ImportOptions
    from srt.recording.imported_samples import ImportedSamples
    from srt.types import Mask

MAGIC: Final = b"\xa3\x95\x80"  # the first message of a log defines the message that defines messages

GYRO_COLUMNS: Final = ("GyrX", "GyrY", "GyrZ")
ACCEL_COLUMNS: Final = ("AccX", "AccY", "AccZ")

TOPICS: Final = {"IMU": ("IMU",), "GYR": ("GYR", "ACC")}
"""Values of the option ``topic``, and the messages that each stands for, in order of preference."""

_COLUMNS: Final = {"IMU": (*GYRO_COLUMNS, *ACCEL_COLUMNS), "GYR": GYRO_COLUMNS, "ACC": ACCEL_COLUMNS}

_TITLE = "ArduPilot log"

_VARIANTS = ("", "1", "2", "3")  # suffixes of message names: old logs state the instance there, and not in a column

_STAMPS = (("SampleUS", 10**6), ("TimeUS", 10**6), ("TimeMS", 10**3))
"""Columns of time, in order of preference, and their ticks in a second."""

_LATEST_STAMP = 2**62  # ticks; larger stamps are damage, and their differences would overflow 64 bits
_HEADER_BYTES = 3  # two fixed bytes and the type, before the fields of a message
_LONGEST_LINE = 1 << 16  # characters of a line in a log as text; ArduPilot's have at most some hundreds


@dataclass(frozen=True, slots=True, eq=False)
class _LogMessages:
    """Messages of a log that hold samples of an IMU."""

    path: Path
    tables: dict[str, dict[str, NDArray[Any]]]  # columns by message, shape (n,)
    parameters: dict[str, list[float]]  # values of each, in their order in the log

    def instances(self, message: str) -> dict[int, tuple[str, Mask | slice]]:
        """Name and rows of the messages of each instance."""
        found: dict[int, tuple[str, Mask | slice]] = {}
        for variant in _VARIANTS:
            table = self.tables.get(message + variant)
            if table is None:
                continue
            if "I" in table:
                for each in np.unique(table["I"]).tolist():
                    found.setdefault(int(each), (message + variant, table["I"] == each))
            else:
                found.setdefault(max(int(variant or 1) - 1, 0), (message + variant, slice(None)))
        return dict(sorted(found.items()))

    def stream(self, message: str, instance: int) -> Stream:
        """Samples of an instance, or of the first one if a message lacks it."""
        there, columns = self.instances(message), _COLUMNS[message]
        instance = instance if instance in there else next(iter(there))
        name, rows = there[instance]
        table = self.tables[name]
        missing = next((column for column in columns if column not in table), None)
        if missing is not None:
            raise InputError(f"{self.path}: the message {name} has no column {missing}: it is not ArduPilot's.")
        stamps = next(((table[key][rows], ticks) for key, ticks in _STAMPS if key in table and table[key].any()), None)
        if stamps is None:
            raise InputError(f"{self.path}: the message {name} has no time stamps: it is not ArduPilot's.")
        time, ticks = stamps
        if time.dtype.kind not in "iu" or (time.size and int(time.max()) >= _LATEST_STAMP):
            raise InputError(f"{self.path}: the time stamps of {name} are no plausible ones: the log is damaged.")
        values = np.stack([np.asarray(table[column][rows], dtype=np.float64) for column in columns], axis=1)
        temperature = np.asarray(table["T"][rows], dtype=np.float64) if "T" in table else None
        return Stream(f"{name} [{instance}]", time.astype(np.int64), ticks, values, temperature)


def read_log(path: Path, options: ImportOptions) -> ImportedSamples:
    """Read the IMU of a log, in this process. Raises InputError."""
    tables, parameters, lost = _tables(path)
    log = _LogMessages(path, tables, parameters)
    notes = [f"The log is damaged: {lost} of its bytes hold no messages; the others were read."] if lost else []
    notes += ["ArduPilot has applied its own calibration: a calibration of this log finds the remaining errors."]
    absent = (
        f"in messages {options.topic or 'IMU, or GYR with ACC'} (found: "
        f"{', '.join(sorted(log.tables)) or 'none of them'}): log the IMU (LOG_BITMASK), or the raw IMU (GYR, ACC)."
    )
    topic, instance = choose_topic(path, TOPICS, log.instances, options, notes, absent)
    streams = [log.stream(message, instance) for message in TOPICS[topic]]
    stream = streams[0] if len(streams) == 1 else join(streams[0], streams[1], notes)
    first = {name: values[0] for name, values in log.parameters.items()}
    changed = {name for name, values in log.parameters.items() if len(set(values)) > 1}
    applied = PARAMETERS.carried(first, changed, (instance, instance), notes)
    return to_imported(stream, options, notes, applied=applied)


def _tables(path: Path) -> tuple[dict[str, dict[str, NDArray[Any]]], dict[str, list[float]], int]:
    """Tables of the messages, parameters, and the number of bytes of a binary log that belong to no message."""
    names = [message + variant for message in _COLUMNS for variant in _VARIANTS]
    take = _from_text if _is_text(path) else _from_binary
    reader = _indexed(path, binary=take is _from_binary)
    tables = {name: take(path, reader, name) for name in names}
    parameters: dict[str, list[float]] = {}
    table = take(path, reader, "PARM", texts=True)
    if {"Name", "Value"} <= set(table):
        for name, value in zip(table["Name"].tolist(), table["Value"].tolist(), strict=True):
            text = name.decode("latin-1") if isinstance(name, bytes) else name
            parameters.setdefault(text.strip(" \0"), []).append(float(value))
    lost = 0
    if take is _from_binary:
        lost = reader.data_len - sum(len(reader.offsets[kind]) * each.len for kind, each in reader.formats.items())
    return {name: table for name, table in tables.items() if table}, parameters, lost


def _from_binary(path: Path, reader: Any, name: str, *, texts: bool = False) -> dict[str, NDArray[Any]]:
    """Columns of a message, those of numbers and, if asked for, of text; empty if there is none."""
    if name not in reader.name_to_id:
        return {}
    kind = reader.name_to_id[name]
    layout = reader.formats[kind]
    columns, codes = layout.columns, re.findall(r"\d*\D", layout.msg_struct.lstrip("<"))
    size = struct.calcsize(layout.msg_struct)
    if len(columns) != len(codes) or len({*columns, ""}) <= len(columns) or size + _HEADER_BYTES != layout.len:
        raise InputError(f"{path}: the definition of the message {name} contradicts itself: the log is damaged.")
    places = np.array(reader.offsets[kind], dtype=np.int64) + _HEADER_BYTES
    raw = np.frombuffer(reader.data_map, dtype=np.uint8)
    places = places[(places >= 0) & (places + size <= raw.size)]
    if not places.size:
        return {}
    # Every window of a message's length is a view; taking those at the messages' places copies once.
    rows = np.lib.stride_tricks.sliding_window_view(raw, size)[places]
    kinds = [f"S{code.removesuffix('s')}" if "s" in code else f"<{code}" for code in codes]
    table = rows.view(np.dtype(list(zip(columns, kinds, strict=True))))[:, 0]
    factors = dict(zip(columns, layout.msg_mults, strict=True))
    return {
        column: table[column] if factors[column] is None else table[column] * factors[column]
        for column in columns
        if table[column].dtype.kind in ("fiuS" if texts else "fiu")
    }


def _from_text(path: Path, reader: Any, name: str, *, texts: bool = False) -> dict[str, NDArray[Any]]:
    """Columns of a message in a log as text, those of numbers and, if asked for, of text."""
    if name not in reader.formats or name not in reader.offsets:
        return {}
    layout = reader.formats[name]
    kinds = dict(zip(layout.columns, layout.format, strict=False))
    wanted = [column for column, code in kinds.items() if texts or code not in "nNZa"]
    lines = [_line(reader.data_map, start) for start in reader.offsets[name]]
    full = [line for line in lines if line.count(",") >= len(layout.columns)]
    if len(full) < len(lines) - 1 or not wanted or len(kinds) != min(len(layout.columns), len(layout.format)):
        raise InputError(f"{path}: messages {name} do not have the columns of their definition: the log is damaged.")
    if not full:
        return {}
    table = {}
    for column in wanted:
        cells = [line.split(",")[layout.columns.index(column) + 1] for line in full]
        if kinds[column] in "nNZa":
            table[column] = np.array(cells)
            continue
        try:
            # Integers of 64 bits do not fit into a double.
            table[column] = np.array(cells).astype(np.int64 if kinds[column] in "QqIiBbHh" else np.float64)
        except (ValueError, OverflowError):
            bad = next((cell for cell in cells if not is_number(cell)), cells[0]).strip()[:40]
            raise InputError(f"{path}: column {column} of {name} holds {bad!r}, which is no number there.") from None
    return table


def _line(data: mmap.mmap, start: int) -> str:
    end = data.find(b"\n", start, start + _LONGEST_LINE)
    return data[start : end if end >= 0 else start + _LONGEST_LINE].decode("latin-1").rstrip()


def _indexed(path: Path, *, binary: bool) -> Any:
    """Let the library find all messages."""
    from pymavlink import DFReader

    base = DFReader.DFReader_binary if binary else DFReader.DFReader_text
    # The search for the satellites' time would parse all messages one by one.
    reader = type("Reader", (base,), {"init_clock": lambda _: None})
    with clear_errors(path, _TITLE):
        return reader(str(path))


def _is_text(path: Path) -> bool:
    return any(line.startswith(b"FMT,") for line in head(path).splitlines()[:20])


def _sniff(path: Path) -> bool:
    return head(path, len(MAGIC)) == MAGIC or _is_text(path)


_READ = in_child(f"{__name__}:{read_log.__name__}", "pymavlink", "An ArduPilot log")
_OPTIONS = frozenset({"topic", "instance"})
# Many other programs use the suffixes .bin and .log.
ARDUPILOT: Final = Importer("ardupilot", "ArduPilot log (.bin or .log)", (), "formats", _sniff, _READ, _OPTIONS)
