"""Streams of lines to be damaged by the fuzzer, and the answers of ``srt apply`` compared with their lines."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from fuzz_seeds import ACCEL, GYRO, NAMES, TABLE, TIME, Seed

import srt
from srt.recording.import_options import CHANNELS, ImportOptions, parse_columns
from srt.recording.schema import ACCEL_UNITS, GYRO_UNITS
from srt.sensor_errors import SensorErrors
from srt.stacks.stream_correction import StreamCorrector, StreamOptions
from srt.stacks.text_lines import LineCorrector, bounded_lines

if TYPE_CHECKING:
    from pathlib import Path

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""A number as other programs read it."""
CALIBRATION = srt.Calibration(
    "hand", "converged", "Done.", SensorErrors(np.random.default_rng(1).normal(0.0, 0.01, 27)), 1e-8 * np.eye(27)
)


def _text(table: np.ndarray, *names: str) -> str:
    return "".join(f"{line}\n" for line in (*names, *(",".join(map(repr, row)) for row in table.tolist())))


def streams() -> list[Seed]:
    """Lines for ``srt apply``; the options hold their columns and units, by which answers are checked."""
    si, other = ImportOptions(gyro_unit="rad/s", accel_unit="m/s^2"), ImportOptions(gyro_unit="deg/s", accel_unit="g")
    named = "time [ms],accel_x [g],accel_y [g],accel_z [g],gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],note"
    noted = _text(np.column_stack([TIME, ACCEL, GYRO]), named).replace("\n", ",bump\n").replace("note,bump", "note")
    texts = [
        (_text(TABLE[:, :7]), replace(si, columns=parse_columns("time,gyro,accel"))),
        (_text(TABLE), replace(si, columns=parse_columns("time,gyro,accel,temperature"))),
        (_text(TABLE[:, 1:7]), replace(si, columns=parse_columns("gyro,accel"))),
        (_text(TABLE, ",".join(NAMES)), replace(si, columns=parse_columns("time,gyro,accel,temperature"))),
        (noted, replace(other, columns=parse_columns("time,accel,gyro"))),
        ("".join(f"{json.dumps(dict(zip(NAMES, row, strict=True)))}\n" for row in TABLE.tolist()), si),
        ("".join(f'{{"gyro": {row[1:4]}, "accel": {row[4:7]}, "id": 7}}\n' for row in TABLE.tolist()), si),
    ]
    return [Seed({"stream": text.encode()}, "stream", options) for text, options in texts]


STREAMS = {"stream": streams}
"""Seeds of lines that are corrected as they arrive."""


def correct_lines(seed: Seed, path: Path) -> None:
    """Correct lines as ``srt apply`` does. Raises AssertionError for an answer that is not that of its line."""
    told: list[str] = []
    lines = LineCorrector(StreamCorrector(CALIBRATION, "mars", StreamOptions(), told.append))
    with path.open(encoding="utf-8", errors="replace") as file:
        pairs = [(line.strip(), lines.correct(line)) for line in bounded_lines(file)]
    options = seed.options
    layouts = [{name: int(place) - 1 for name, place in options.columns.items()}] if options.columns else []
    # Without names, or with those that are damaged.
    usual = ("time", *CHANNELS[1:7], "temperature")
    plain = [{name: i for i, name in enumerate(names)} for names in (usual, usual[1:])]
    original, names_seen = set(seed.files[seed.target].decode().splitlines()), False
    for number, (line, answer) in enumerate(pairs, start=1):
        if not answer or answer == line:
            numbers = [NUMBER.fullmatch(cell.strip()) for cell in line.split(",")]
            assert not answer or line.startswith("#") or not all(numbers), f"line {number} passed: {line[:200]}"
            names_seen |= bool(answer) and not line.startswith("#")
            if answer and line not in original and not line.startswith("#"):
                return  # names that are damaged, but valid, state other columns or units
            continue
        if any(f"line {number} was damaged, and its answer is wrong" in sentence for sentence in told):
            continue
        units = (options.gyro_unit, options.accel_unit) if names_seen and line[0] != "{" else ("rad/s", "m/s^2")
        scale = np.repeat([GYRO_UNITS["rate"][units[0]], ACCEL_UNITS["rate"][units[1]]], 3)
        found = [_numbers(line, answer, layout) for layout in ([None] if line[0] == "{" else [*layouts, *plain])]
        right = [_is_correction(old, new, scale) for old, new in filter(None, found)]
        assert any(right), f"line {number} is answered wrongly: {line[:200]} {answer[:200]}"


def _is_correction(old: np.ndarray, new: np.ndarray, scale: np.ndarray) -> bool:
    with np.errstate(over="ignore"):
        readings = old * scale
    if not np.isfinite(readings).all():
        return False
    true = np.hstack(CALIBRATION.apply(*np.split(readings, 2))) / scale
    return bool(np.allclose(new, true, rtol=1e-9, atol=1e-12))  # rounding of conversions there and back


def _numbers(line: str, answer: str, layout: dict[str, int] | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Six readings of a line and of its answer; None if they are none, or anything else of the line has changed."""
    if layout is None:
        old, new = json.loads(line), json.loads(answer)
        arrays = "gyro" in old
        values = [
            [*part.pop("gyro"), *part.pop("accel")] if arrays else [part.pop(name) for name in CHANNELS[1:7]]
            for part in (old, new)
        ]
        strict = all(type(each) in (int, float) and math.isfinite(each) for each in values[0])
        return (np.array(values[0], float), np.array(values[1])) if old == new and strict else None
    cells = [line.split(","), answer.split(",")]
    places = [layout[name] for name in CHANNELS[1:7]]
    if len(cells[0]) != len(cells[1]) or max(places) >= len(cells[0]):
        return None
    if any(old != new for i, (old, new) in enumerate(zip(*cells, strict=True)) if i not in places):
        return None
    if not all(NUMBER.fullmatch(part[i].strip()) for part in cells for i in places):
        return None
    read_off = [np.array([float(part[i]) for i in places]) for part in cells]
    return read_off[0], read_off[1]
