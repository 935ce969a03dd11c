"""Text of an imported log: samples, rate, units and their origin, sizes of the readings, notes."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG
from srt.recording.schema import COUNTS
from srt.reports.tables import WIDTH, text_table, wrap

if TYPE_CHECKING:
    from pathlib import Path

    from srt.recording.imported_samples import ImportedSamples
    from srt.recording.importer_registry import Importer
    from srt.recording.recording import Recording

_FASTEST_RAD_S: Final = 100.0  # rate beyond that of any gyro sold (4000 °/s), rad/s: a larger one means a wrong unit
_TEXT_WIDTH: Final = WIDTH - 17  # width of the second column in characters, beside the longest label
_NO_FIXTURE: Final = (
    "No fixture is stated, so that attitudes and heading are unknown (a free recording). If the unit was on a fixture, "
    "state it with --heading-deg, --alignment-sigma-mrad and --rotation-sigma-mrad, with --like, or in [fixture] of "
    "recording.toml."
)
"""Note on a recording without a fixture."""
_SAMPLE_RATES_HZ: Final = (5.0, 50e3)
"""Range of the sample rates of IMUs: a rate outside it probably means a wrong unit of time."""


def import_text(recording: Recording, imported: ImportedSamples, importer: Importer, source: Path) -> str:
    """Table of an imported log: samples, rate, units and their origin, sizes of the readings, notes."""
    interval = recording.nominal_interval_s
    per = recording.interval_s if recording.kind == "increment" else 1.0
    rate, force = (np.linalg.norm(values, axis=1) / per for values in (recording.gyro, recording.accel))
    stamps = "stamps" if imported.sample_rate_hz is None else "stated"
    rows: list[list[str] | None] = [
        ["format", f"{importer.title} ({importer.name})"],
        ["samples", f"{recording.time.size} ({recording.kind})"],
        ["rate", f"{1.0 / interval:.6g} Hz ({stamps}), {recording.gaps.size} gaps"],
        ["duration", f"{recording.time.size * interval:.1f} s{_missing(recording)}"],
        ["time", imported.units.get("time", "no stamps, counted from 0")],
        *_rows("gyros", imported.units.get("gyro", "")),
        ["", f"median {np.median(rate) / DEG:.4g} °/s, largest {rate.max() / DEG:.4g} °/s"],
        *_rows("accelerometers", imported.units.get("accel", "")),
        ["", f"median {np.median(force):.5g} m/s², largest {force.max():.5g} m/s²"],
    ]
    temperature = recording.temperature
    if temperature is not None:
        rows.append(["temperature", f"{temperature.min():.1f} to {temperature.max():.1f} °C"])
    rows += [[what, text] for what, text in (("serial", recording.serial), ("date", recording.date)) if text]
    lines = [*wrap(str(source)), text_table(["", "as read"], rows, "ll")]
    notes = list(imported.notes)
    if rate.max() > _FASTEST_RAD_S:
        option = "--gyro-lsb" if imported.units.get("gyro", "").startswith(COUNTS) else "--gyro-unit"
        notes.append(f"The gyros read up to {rate.max() / DEG:.4g} °/s, more than any IMU measures: check {option}.")
    clock_is_stated = "time_unit" not in importer.options
    if (
        imported.sample_rate_hz is None
        and not clock_is_stated
        and not _SAMPLE_RATES_HZ[0] <= 1.0 / interval <= _SAMPLE_RATES_HZ[1]
    ):
        notes.append(f"The stamps give a rate of {1.0 / interval:.4g} Hz, which no IMU has: check --time-unit.")
    if recording.fixture is None:
        notes.append(_NO_FIXTURE)
    for note in notes:
        lines += wrap(f"Note: {note}")
    return "\n".join(lines)


def _rows(label: str, text: str) -> list[list[str]]:
    """Rows of a text that may be longer than the table is wide."""
    return [[label if k == 0 else "", line] for k, line in enumerate(textwrap.wrap(text, _TEXT_WIDTH) or [""])]


def _missing(recording: Recording) -> str:
    """Time that the gaps leave out, as a clause; empty without gaps."""
    if not recording.gaps.size:
        return ""
    span = float(recording.time[-1] - recording.time[0]) + recording.nominal_interval_s
    return f" of samples, {span - recording.time.size * recording.nominal_interval_s:.1f} s of gaps"
