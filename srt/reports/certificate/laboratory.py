"""Statements of the laboratory on a certificate (ISO/IEC 17025, 7.8): parties, equipment, references, conditions.

The file of the laboratory is TOML. One line of the certificate lists what it does not state; nothing is assumed.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import InputError
from srt.recording.schema import Key, number, read_section, require_sections
from srt.recording.toml_text import read_toml
from srt.reports.tables import Table, plain, table
from srt.sensor_errors import GROUP_SLICES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from srt.result.calibration import Calibration

NOT_STATED: Final = "not stated"
COVERAGE_FACTOR: Final = 2.0
"""Coverage factor of expanded uncertainties, unless the laboratory states another: 95 % of a normal distribution."""
SECTIONS: Final[dict[str, tuple[tuple[str, str], ...]]] = {
    "certificate": (("number", "Certificate number"), ("date_of_issue", "Date of issue")),
    "laboratory": (
        ("name", "Laboratory"), ("address", "Address of the laboratory"), ("accreditation", "Accreditation"),
    ),
    "customer": (("name", "Customer"), ("address", "Address of the customer"), ("order", "Order")),
    "operator": (("name", "Operator"),),
    "approval": (("name", "Approved by"), ("function", "Function")),
    "unit": (("manufacturer", "Manufacturer"), ("model", "Model"), ("received", "Received")),
    "conditions": (
        ("temperature", "Ambient temperature"), ("humidity", "Humidity"), ("pressure", "Air pressure"),
        ("vibration", "Vibration"), ("supply", "Supply of the unit"),
    ),
}  # fmt: skip
"""Sections of the file with their keys and labels, in the order of the certificate."""
_WHOLE: Final = {section: section for section in SECTIONS} | {
    "certificate": "certificate number and date of issue",
    "unit": "make and model of the unit",
    "conditions": "conditions of the laboratory",
}
"""Names of sections of which nothing is stated."""
_EQUIPMENT: Final = ("name", "serial", "calibrated", "traceability")
_REFERENCES: Final = {
    "gravity": "Gravity", "latitude": "Latitude", "heading": "Heading of the fixture", "time_base": "Time base",
}  # fmt: skip
"""References of the test with their labels."""
_LENGTH: Final = 200  # largest number of characters of a text


def _words(value: Any) -> str:
    """Text, number or date as one line."""
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, bool) or not isinstance(value, str | int | float) or value == "":
        raise ValueError
    return plain(value, _LENGTH)


def _keys(names: Iterable[str]) -> tuple[Key, ...]:
    return tuple(Key(name, "a text in quotes", _words) for name in names)


_KEYS: Final = {section: _keys(key for key, _ in keys) for section, keys in SECTIONS.items()} | {
    "references": _keys(_REFERENCES)
}
_KEYS["certificate"] += (number("coverage_factor", "standard uncertainties", low=1.0, high=10.0),)
_EQUIPMENT_KEYS: Final = _keys(_EQUIPMENT)


@dataclass(frozen=True, slots=True)
class Laboratory:
    """Statements of the laboratory."""

    texts: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # by section and key, of what is stated
    equipment: tuple[Mapping[str, str], ...] = ()
    references: Mapping[str, str] = field(default_factory=dict)  # origin of the reference values: traceability
    coverage_factor: float = COVERAGE_FACTOR

    def rows(self) -> Iterator[tuple[str, str]]:
        """Labels and texts of what is stated, in the order of the certificate."""
        for section, keys in SECTIONS.items():
            stated = self.texts.get(section, {})
            yield from ((label, stated[key]) for key, label in keys if key in stated)

    @property
    def missing(self) -> str:
        """Sentence on what is not stated, by section where a whole one is not; empty if all is stated."""
        out = []
        for section, keys in SECTIONS.items():
            stated = self.texts.get(section, {})
            out += [label.lower() for key, label in keys if key not in stated] if stated else [_WHOLE[section]]
        out += [] if self.equipment else ["equipment"]
        unknown = [label.lower() for key, label in _REFERENCES.items() if key not in self.references]
        out += [f"origin of {label}" for label in unknown] if self.references else ["origin of the references"]
        return f"Not stated: {', '.join(out)}." if out else ""


def load_laboratory(path: Path) -> Laboratory:
    """Read the file of a laboratory.

    Raises InputError: a file that cannot be read, an unknown section or key, or a value that is no text.
    """
    name, document = f"The laboratory {path}", read_toml(path)
    require_sections(name, document, (*_KEYS, "equipment"))
    stated = {
        section: read_section(name, section, document[section], keys)
        for section, keys in _KEYS.items()
        if section in document
    }
    rows = document.get("equipment", [])
    if not isinstance(rows, list):
        raise InputError(f"{name}: equipment is no list; write each item as [[equipment]].")
    equipment = tuple(
        read_section(name, f"equipment[{k}]", row, _EQUIPMENT_KEYS) for k, row in enumerate(rows, start=1)
    )
    factor = stated.get("certificate", {}).pop("coverage_factor", COVERAGE_FACTOR)
    return Laboratory(stated, equipment, stated.pop("references", {}), factor)


def references_table(calibration: Calibration, laboratory: Laboratory) -> Table:
    """Table of the reference values of the test with their standard uncertainties, and their origin where stated."""
    site, alignment = calibration.site, calibration.alignment
    # An error of the time base scales the gyros by as much.
    effect = calibration.contributions.get("clock")
    clock = None if effect is None else 1e6 * float(effect[GROUP_SLICES["gyro_scale"]].max())
    tilt = alignment.alignment_sigma_mrad
    origin = "" if site.gravity_sigma_origin is None else f" ({site.gravity_sigma_origin})"
    known = {
        "gravity": (_number(site.gravity_m_s2, "m/s²", 9), _number(site.gravity_sigma_m_s2, "m/s²", 2) + origin),
        "latitude": (_number(site.latitude_deg, "°", 7), NOT_STATED),
        "heading": (_number(alignment.heading_deg, "°", 6), _number(tilt, "mrad", 3)),
        "time_base": ("clock of the recording", _number(clock, "ppm", 2)),
    }
    columns = 4 if laboratory.references else 3
    origins = dict(laboratory.references)
    if origin and "gravity" in origins:
        # The origin that the laboratory states is not that of a sigma which nobody stated.
        origins["gravity"] += " (the value; its uncertainty is assumed, not stated)"
    rows = ((label, *known[key], origins.get(key, NOT_STATED))[:columns] for key, label in _REFERENCES.items())
    return table(
        ("quantity", "value", "standard uncertainty", "origin")[:columns],
        rows,
        "llll"[:columns],
        title="References",
        note="Accelerometer scale factors refer to gravity, gyro scale factors to the time base. Latitude and heading "
        "give the Earth rate.",
    )


def equipment_table(laboratory: Laboratory) -> Table | None:
    """Table of the equipment; None without any."""
    if not laboratory.equipment:
        return None
    rows = ([row.get(key, NOT_STATED) for key in _EQUIPMENT] for row in laboratory.equipment)
    return table(("equipment", "serial", "calibrated", "traceability"), rows, "llll", title="Equipment")


def _number(value: float | None, unit: str, digits: int) -> str:
    if value is None:
        return NOT_STATED
    return f"{value:.{digits}g} {unit}" if unit != "°" else f"{value:.{digits}g}°"
