"""Unit, site, data and software of a certificate; application of the calibration; limitations of the test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.estimation.options import Options
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.reports.tables import Cell, Table, plain, table
from srt.result.calibration import VERSION, software
from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.model.sensor_model import Triad
    from srt.reports.certificate.acceptance_limits import AcceptanceLimits
    from srt.reports.certificate.calibration_file import CalibrationFile
    from srt.reports.certificate.recording_history import RecordingHistory
    from srt.result.calibration import Calibration
    from srt.types import Array


SERIAL_LENGTH: Final = 200
"""Largest number of characters of a serial: longer ones are not serials."""


def unit_description(
    source: CalibrationFile, course: RecordingHistory | None, limits: AcceptanceLimits | None
) -> Iterator[tuple[str, str]]:
    """Unit, date, site, data and software, as labels and texts."""
    calibration = source.calibration
    provenance, merged = calibration.provenance, calibration.provenance.recordings or ()
    yield "Serial", plain(source.serial, SERIAL_LENGTH) or "not stated"
    several = any(member.date for member in merged)
    yield "Date of the test", plain(provenance.date) or ("several, below" if several else "not stated")
    yield "Site", _site(calibration)
    yield "Fixture", _fixture(calibration, merged=bool(merged))
    yield "Temperature", temperature(calibration)
    yield "Estimator", plain(calibration.estimator)
    if course is not None:
        samples = f"{course.count} samples, {course.duration_s:.1f} s at {course.rate_hz:.6g} Hz"
        yield "Recording", f"{samples}, rotation rates up to {course.turned_deg_s:.3g} °/s"
    yield "SHA-256 of the samples", provenance.data_sha256 or "not stated"
    yield "SHA-256 of the calibration", source.sha256
    yield "Calibration file", f"{plain(source.name)}, format version {VERSION}"
    yield "Calibrated by", plain(provenance.software) or "not stated"
    yield "Certificate by", software()
    if limits is not None:
        yield "Limits", plain(limits.name)
    usual = Options().as_dict()
    special = {k: v for k, v in provenance.options.items() if k not in usual or usual[k] != v}
    if special:
        yield "Options", plain(", ".join(f"{key} {_option(value)}" for key, value in special.items()), 600)
    if provenance.voided:
        voided = "; ".join(f"{key}: {reason}" for key, reason in provenance.voided.items())
        yield "Left out of the test", plain(voided, 600)


def recordings_table(calibration: Calibration) -> Table | None:
    """Table of the recordings of a merged calibration; None for any other."""
    members = calibration.provenance.recordings
    if not members:
        return None
    rows = (
        (str(k), *(plain(text) or "-" for text in (each.serial, each.date, each.data_sha256, each.software)))
        for k, each in enumerate(members, start=1)
    )
    head = ("", "serial", "date", "SHA-256 of the samples", "software")
    return table(head, rows, "rllll", title="Recordings merged")


def _site(calibration: Calibration) -> str:
    site = calibration.site
    parts = ["latitude not stated" if site.latitude_deg is None else f"latitude {site.latitude_deg:.6g}°"]
    if site.gravity_m_s2 is not None:
        sigma = "" if site.gravity_sigma_m_s2 is None else f" ± {site.gravity_sigma_m_s2:.2g}"
        origin = "" if site.gravity_sigma_origin is None else f" ({site.gravity_sigma_origin})"
        parts.append(f"gravity {site.gravity_m_s2:.9g}{sigma} m/s²{origin}")
    return ", ".join(parts)


def _fixture(calibration: Calibration, *, merged: bool) -> str:
    alignment = calibration.alignment
    if not alignment.fixture:
        return "not the same in all recordings" if merged and alignment.fixture is None else "none (turned freely)"
    parts = {
        "heading": (alignment.heading_deg, "°"),
        "alignment sigma": (alignment.alignment_sigma_mrad, " mrad"),
        "rotation sigma": (alignment.rotation_sigma_mrad, " mrad"),
    }
    # Seldom stated, and only two estimators rely on it.
    if alignment.wobble_sigma_mrad is not None or "wobble_sigma_mrad" in alignment.nulls:
        parts["wobble"] = (alignment.wobble_sigma_mrad, " mrad")
    stated = (f"{words} {'not stated' if x is None else f'{x:g}{unit}'}" for words, (x, unit) in parts.items())
    return f"two axes, {', '.join(stated)}"


def temperature(calibration: Calibration) -> str:
    """Text of the temperature of the test."""
    known = calibration.temperature
    return "not recorded" if known is None else f"{known.mean_c:.1f} °C, range {known.range_c:.1f} °C"


def _option(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def limitations(calibration: Calibration, course: RecordingHistory | None) -> Iterator[str]:
    """Limitations of the test, in sentences; the course of a recording gives the fastest turn."""
    if calibration.fixed:
        count = len(calibration.fixed)
        yield f"{count} parameters were not measured: their values are prior values."
    if not {*NAMES[GROUP_SLICES["accel_asymmetry"]]} <= set(calibration.fixed):
        yield (
            "Accelerometers were tested up to 1 g. There a quadratic error looks like an asymmetry, so that the "
            "correction may be wrong beyond 1 g."
        )
    else:
        yield "Accelerometers were tested up to 1 g: a quadratic term is not known, and grows beyond 1 g."
    fastest = "" if course is None else f" (up to {course.turned_deg_s:.3g} °/s)"
    yield f"Gyros were tested at the rates of the rotations{fastest}: the scale factor at other rates is not known."
    for row in calibration.diagnostics.unseen_errors or ():
        yield f"{plain(row.sentence)} No residual shows such an error."
    known = calibration.temperature
    yield (
        "The temperature of the test was not recorded; the temperature dependence is not known."
        if known is None
        else f"The temperature dependence is not known: the test was made at {known.mean_c:.1f} °C, within "
        f"{known.range_c:.1f} °C."
    )
    followed = calibration.g_sensitivity is not None
    yield (
        f"{'The' if followed else 'Gyro g-sensitivity, and the'} dependence of all sensors on vibration, pressure, "
        f"supply and magnetic field, {'is' if followed else 'are'} not among the parameters; the "
        "values include a part of their effect."
    )
    yield (
        "Delays and bandwidth of the sensors, and the size effect of the accelerometers, are not measured: specific "
        "force is taken from stationary windows."
    )
    yield (
        "Changes from turn-on to turn-on or with age are known only as far as the sigmas of the biases hold them."
        if calibration.provenance.recordings
        else "Changes from turn-on to turn-on or with age are not known: this is one test."
    )
    known_axes = ". C relates them to the axes of the fixture only, as accurately as the unit was mounted on it."
    other = known_axes if calibration.U is not None else "; this test has no reference for it."
    yield f"Orientation of the MARS axes in the housing: not measured{other}"
    if calibration.site.latitude_deg is None:
        yield "The Earth rate is in the gyro biases, as no latitude is stated; their sigmas hold it."
    if calibration.diagnostics.unseen_errors is None:
        yield "Gravity is taken as stated: its error is a common error of all accelerometer scale factors."


FORMULAS: Final = ("y = M v + s ∘ |v| + b", "v = (M + diag(s ∘ sign v))⁻¹ (y − b)")
"""Sensor model and its exact inverse, the compensation."""


@dataclass(frozen=True, slots=True)
class Application:
    """Application of a calibration."""

    formulas: tuple[str, ...]  # sensor model and compensation
    sentences: tuple[str, ...]  # meaning of the symbols
    tables: tuple[Table, ...]  # M, s and b of gyros and accelerometers, and U where it is known


def application_section(calibration: Calibration) -> Application:
    """Application of a calibration: formulas, their symbols and their numbers."""
    sentences = [
        "y: reading; v: true value. Gyros in rad/s, accelerometers in m/s²; each has its own M, s and "
        "b. ∘ multiplies element by element.",
        "Start with v = inverse(M) (y − b). Compute v by the formula with the signs of the last v, until no sign "
        "changes. |v| and sign v are taken element by element.",
        "Readings that are increments of a time step T: divide them by T, correct, multiply by T.",
        "v is in MARS axes, the axes in which the matrix M of the gyros is symmetric; they are close to the gyro axes.",
    ]
    tables = [
        _triad("Gyros: M, s, b (rad/s)", gyro_triad(calibration.errors)),
        _triad("Accelerometers: M, s, b (m/s²)", accel_triad(calibration.errors)),
    ]
    if calibration.g_sensitivity is not None:
        sentences.append("Gyros: y − Γ f in place of y, with f the true specific force in MARS axes.")
        head = ("along x", "along y", "along z")
        tables.append(_matrix("Γ of the gyros (rad/s per m/s²)", head, calibration.g_sensitivity, ("+.6e",) * 3))
    if calibration.U is not None:
        sigma = calibration.U_sigma_rad
        known = "" if sigma is None else f"It is accurate to {1e3 * sigma:.2g} mrad (1-sigma) about each axis. "
        sentences.append(
            f"C transforms components in the axes of the fixture into components in MARS axes. {known}In the "
            "calibration file it is frame.U. In the axes of the fixture, v is transpose(C) v."
        )
        tables.append(_matrix("C, fixture to MARS axes", ("", "", ""), calibration.U, ("+.9f",) * 3))
    sentences.append(
        "'srt apply' compensates a recording; 'srt apply --c-header' writes the compensation in the C language."
    )
    return Application(FORMULAS, tuple(sentences), tuple(tables))


def _triad(title: str, triad: Triad) -> Table:
    numbers = np.column_stack([triad.matrix, triad.asymmetry, triad.bias])
    return _matrix(title, ("M, column 1", "column 2", "column 3", "s", "b"), numbers, (*("+.9f",) * 4, "+.6e"))


def _matrix(title: str, head: tuple[str, ...], numbers: Array, formats: tuple[str, ...]) -> Table:
    """Table of a matrix, with the format of each column."""
    rows = ([Cell(f"{x:{form}}", x) for x, form in zip(row, formats, strict=True)] for row in numbers.tolist())
    return table(head, rows, "r" * len(head), title=title)
