"""The facts of a certificate: which unit, when and where, of which data, and by which versions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from srt.certificate.tables import Cell, Table, plain
from srt.estimation.assembly import software
from srt.estimation.options import Options
from srt.result.calibration import VERSION

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.certificate.checked import Source
    from srt.certificate.limits import Limits
    from srt.certificate.replay import Course
    from srt.result.calibration import Calibration

SERIAL_LENGTH: Final = 200
"""Characters of a serial that are shown."""


def facts(source: Source, course: Course | None, limits: Limits | None) -> Iterator[tuple[str, str]]:
    """Give which unit, when, where, of which data, by which software, as labels and texts.

    Parameters
    ----------
    source : Source
    course : Course or None
    limits : Limits or None
    """
    calibration = source.calibration
    provenance, merged = calibration.provenance, calibration.provenance.get("recordings") or ()
    yield "Serial", plain(source.serial, SERIAL_LENGTH) or "not stated"
    several = any(member.get("date") for member in merged)
    yield "Date of the test", plain(provenance.get("date")) or ("several, below" if several else "not stated")
    yield "Site", _site(calibration)
    yield "Fixture", _fixture(calibration, merged=bool(merged))
    yield "Temperature", temperature(calibration)
    yield "Estimator", plain(calibration.estimator)
    if course is not None:
        yield (
            "Recording",
            (
                f"{course.count} samples, {course.duration_s:.1f} s at {course.rate_hz:.6g} Hz, "
                f"turns of up to {course.turned_deg_s:.3g} °/s"
            ),
        )
    yield "SHA-256 of the samples", provenance.get("data_sha256") or "not stated"
    yield "SHA-256 of the calibration", source.sha256
    yield "Calibration file", f"{plain(source.name)}, format version {VERSION}"
    yield "Calibrated by", plain(provenance.get("software")) or "not stated"
    yield "Certificate by", software()
    if limits is not None:
        yield "Limits", plain(limits.name)
    usual = Options().as_dict()
    special = {k: v for k, v in (provenance.get("options") or {}).items() if k not in usual or usual[k] != v}
    if special:
        yield "Options", plain(", ".join(f"{key} {_option(value)}" for key, value in special.items()), 600)
    voided = provenance.get("voided") or {}
    if voided:
        yield "Left out of the test", plain("; ".join(f"{key}: {reason}" for key, reason in voided.items()), 600)


def recordings_table(calibration: Calibration) -> Table | None:
    """Set the recordings of a merged calibration; None for any other."""
    members = calibration.provenance.get("recordings") or ()
    if not members:
        return None
    rows = tuple(
        (
            Cell(str(k + 1)),
            Cell(plain(member.get("serial")) or "-"),
            Cell(plain(member.get("date")) or "-"),
            Cell(member.get("data_sha256") or "-"),
            Cell(plain(member.get("software")) or "-"),
        )
        for k, member in enumerate(members)
    )
    return Table("Recordings merged", ("", "serial", "date", "SHA-256 of the samples", "software"), rows, "rllll")


def _site(calibration: Calibration) -> str:
    site = calibration.site
    latitude, gravity, sigma = (site.get(key) for key in ("latitude_deg", "gravity_m_s2", "gravity_sigma_m_s2"))
    parts = ["latitude not stated" if latitude is None else f"latitude {latitude:.6g}°"]
    if gravity is not None:
        parts.append(f"gravity {gravity:.9g}" + (f" ± {sigma:.2g}" if sigma is not None else "") + " m/s²")
    return ", ".join(parts)


def _fixture(calibration: Calibration, *, merged: bool) -> str:
    alignment = calibration.alignment
    if not alignment.get("fixture"):
        return (
            "not the same in all recordings"
            if merged and alignment.get("fixture", "") is None
            else "none (turned freely)"
        )
    parts = []
    for key, words, unit in (
        ("heading_deg", "heading", "°"),
        ("alignment_sigma_mrad", "alignment sigma", " mrad"),
        ("rotation_sigma_mrad", "rotation sigma", " mrad"),
        ("wobble_sigma_mrad", "wobble", " mrad"),
    ):
        if key == "wobble_sigma_mrad" and key not in alignment:  # seldom stated, and only two estimators rely on it
            continue
        value = alignment.get(key)
        parts.append(f"{words} {f'{value:g}{unit}' if isinstance(value, int | float) else 'not stated'}")
    return "two axes, " + ", ".join(parts)


def temperature(calibration: Calibration) -> str:
    """Say at which temperature the test was made."""
    known = calibration.temperature
    return "not recorded" if known is None else f"{known['mean_c']:.1f} °C, range {known['range_c']:.1f} °C"


def _option(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
