"""Text of a recording: samples, rate, unit, site, fixture, stated noise and labels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.recording.schema import FIXTURE_KEYS, IMU_KEYS, SITE_KEYS, in_file_unit
from srt.reports.tables import Table, table

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.recording.schema import Key


def recording_text(recording: Recording) -> str:
    """Table of the properties of a recording."""
    return recording_table(recording).text()


def recording_html(recording: Recording) -> str:
    """Table of the properties of a recording, in HTML."""
    return recording_table(recording).html()


def recording_table(recording: Recording) -> Table:
    """Labels and texts of the properties of a recording."""
    interval = recording.nominal_interval_s
    temperature = recording.temperature
    labels = " ".join(label.id or "-" for label in recording.sequences)
    first, *more = _values(recording.noise, IMU_KEYS) or ["not stated"]
    rows = [
        ["samples", f"{recording.time.size} ({recording.kind}), {recording.time.size * interval:.1f} s"],
        ["rate", f"{1.0 / interval:.6g} Hz, {recording.gaps.size} gaps"],
        ["unit", recording.serial or "serial not stated"],
        ["date", recording.date or "not stated"],
        ["source", recording.source or "arrays"],
        ["site", ", ".join(_values(recording.site, SITE_KEYS))],
        ["fixture", "none" if recording.fixture is None else ", ".join(_values(recording.fixture, FIXTURE_KEYS))],
        ["noise", first],
        *(["", each] for each in more),
        ["sequences", f"{len(recording.sequences)} labelled: {labels}" if labels else "not labelled"],
    ]
    if temperature is not None:
        rows.insert(4, ["temperature", f"{temperature.min():.1f} to {temperature.max():.1f} °C"])
    shown = ([label, text if len(text) < _TEXT else text[: _TEXT - 3] + "..."] for label, text in rows)
    return table(["recording", ""], shown, "ll")


_TEXT = 66  # largest length of a text, characters: the table fits within 80


def _values(part: object, keys: tuple[Key, ...]) -> list[str]:
    """Keys of a section with their values in the units of the file."""
    known = ((key, getattr(part, key.attribute)) for key in keys if key.attribute is not None)
    return [
        f"{key.name} {value if isinstance(value, str) else f'{in_file_unit(value, key.factor):.6g}'}"
        for key, value in known
        if value is not None
    ]
