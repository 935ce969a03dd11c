"""Conversion of a calibration to the format of other software and back, with the error of the converted correction."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from srt.exceptions import DataError, InputError, SrtError
from srt.exporters.correction_difference import CorrectionDifference, Readings, compare_corrections
from srt.exporters.export_model import ExportModel, ExportSettings, unknown
from srt.exporters.file_format import ABSENT, further_errors
from srt.exporters.linear_model import ASYMMETRY, FACTORS, LinearModel, linear_part
from srt.exporters.registry import exporter, exporters
from srt.model.sensor_model import Triad, accel_triad, gyro_triad, outside_model, to_mars
from srt.recording.applied import NOTHING, AppliedCorrection, applied_correction
from srt.recording.atomic_file import atomic_paths
from srt.recording.file_marks import signed
from srt.result.applier import Applier
from srt.sensor_errors import FURTHER, GROUPS, SensorErrors

if TYPE_CHECKING:
    from os import PathLike

    from srt.exporters.correction_difference import Correction
    from srt.exporters.file_format import Exporter, Fields
    from srt.result.calibration import Calibration
    from srt.types import Array


_G_SENSITIVITY_WITHIN = 1e-12
"""Largest g-sensitivity, relative to the largest rate, that counts as rounding of zero."""


@dataclass(frozen=True, slots=True, eq=False)
class ExportedCalibration:
    """Calibration in the format of other software, and the error of the conversion.

    Attributes
    ----------
    texts : dict of str to str
        By part of the file's name.
    frame : str
        Axes of the file: "mars", "table" or "accel" (those that the format's accelerometer matrix defines).
    C_FB : ndarray, shape (3, 3)
        From MARS axes to those.
    turn_mrad : ndarray, shape (3,)
        The same as a rotation vector.
    readings : Readings
        Readings on which the differences are measured.
    residuals : tuple of CorrectionDifference
        Differences of the file first; then, where they apply, those with the biases given separately and those of
        asymmetry alone.
    losses : tuple of str
        Parts of this calibration that the format does not hold.
    unknown : tuple of str
        Values that the format requires and the calibration does not hold.
    applied : AppliedCorrection or None
        Correction of the log with which the file is composed; the file replaces it.
    limits : tuple of str
        Sentences on what the target does with these values.
    """

    format: Exporter
    texts: dict[str, str]
    frame: str
    C_FB: Array
    turn_mrad: Array
    readings: Readings
    residuals: tuple[CorrectionDifference, ...]
    losses: tuple[str, ...]
    unknown: tuple[str, ...]
    applied: AppliedCorrection | None = None
    limits: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ImportedCalibration:
    """Pre-calibration read from the format of other software.

    Attributes
    ----------
    errors : SensorErrors
        In MARS axes; asymmetries, and biases where the format has none, are zero.
    U : ndarray, shape (3, 3)
        From the file's axes to MARS axes.
    absent : tuple of str
        Groups of errors that the format does not hold.
    g_sensitivity : ndarray, shape (3, 3), rad/s per m/s²
        Gyro g-sensitivity Γ in MARS axes, ω̃ = Mg ω + Γ f + b; it is not among the 27 errors.
    """

    errors: SensorErrors
    U: Array
    absent: tuple[str, ...]
    g_sensitivity: Array


def export(
    calibration: Calibration,
    target: str,
    *,
    readings: Readings | None = None,
    frame: str | None = None,
    asymmetry: str = "leave",
    settings: ExportSettings | None = None,
    applied: AppliedCorrection | None = None,
) -> ExportedCalibration:
    """Convert a calibration to the format of other software, in memory.

    Parameters
    ----------
    target : str
        Name of the format.
    readings : Readings, optional
        Raw readings of the unit to measure the residuals on; default: the standard motion.
    frame : str, optional
        Axes of the file; default: the first that the format takes.
    asymmetry : "leave" or "fit"
        Choice of the linear part (:mod:`srt.exporters.linear_model`); "fit" needs readings.
    applied : AppliedCorrection, optional
        Correction that the readings had before they were logged; default: that of the calibration's recording. A file
        of the same system replaces it, and is composed with it.

    Raises
    ------
    InputError
        An unknown format, axes or settings that it does not take, a calibration outside the model, values that the
        target would clip or ignore silently, a correction of the log that must be known and is not.
    DataError
        If the written file does not reproduce the linear part.
    """
    chosen = exporter(target)
    settings = settings or ExportSettings()
    extra = sorted(settings.stated - chosen.options)
    if extra:
        raise InputError(f"The format {target} has no place for {', '.join(extra)}: leave it out.")
    if asymmetry not in ASYMMETRY:
        raise InputError(f"asymmetry is {asymmetry!r}; it must be one of {', '.join(ASYMMETRY)}.")
    if asymmetry == "fit" and (readings is None or chosen.asymmetry):
        reason = "holds it" if chosen.asymmetry else "there is no recording to fit to"
        raise InputError(
            f"Asymmetry cannot be fitted for {target}, as {reason}: leave the fit out, or give a recording."
        )
    calibration.require_values()
    reason_outside = outside_model(calibration.errors)
    if reason_outside is not None:
        raise InputError(f"This calibration cannot be exported: {reason_outside}; calibrate the unit again.")
    frame = frame or chosen.frames[0]
    measured_on = readings or Readings.standard(calibration)
    gyro, accel = _linear_parts(calibration, measured_on if asymmetry == "fit" else None)
    known = applied or applied_correction("The calibration", calibration.provenance.applied)
    replaced = replaced_correction(chosen, known)
    C_FB = _axes(calibration, chosen, frame, accel, replaced)
    alone = ExportModel(
        calibration, gyro.turned(C_FB), accel.turned(C_FB), frame, C_FB, settings, _g_sensitivity(calibration, C_FB)
    )
    model = alone if replaced is None else alone.composed(replaced)
    texts = {part: signed(text) for part, text in chosen.write(model).items()}
    fields = chosen.read(texts)
    return ExportedCalibration(
        format=chosen,
        texts=texts,
        frame=frame,
        C_FB=C_FB,
        turn_mrad=model.turn_mrad,
        readings=measured_on,
        residuals=_residuals(chosen, fields, alone, model, measured_on),
        losses=_losses(chosen, calibration),
        unknown=unknown(model) if "rate_hz" in chosen.options else (),
        applied=replaced,
        limits=chosen.limits(model, fields),
    )


def save(exported: ExportedCalibration, path: str | PathLike[str]) -> tuple[Path, ...]:
    """Write the files, read them back from disk, and only then move them to their place.

    Parameters
    ----------
    path : path-like
        Formats of several files append to the stem of its name.

    Returns
    -------
    tuple of Path
        The files written.

    Raises
    ------
    InputError
        If a file cannot be written.
    DataError
        If a file on disk differs from its text.
    """
    places = part_paths(exported.format, path)
    with atomic_paths(*places.values()) as files:
        temporary = dict(zip(places, files, strict=True))
        for part, place in temporary.items():
            place.write_bytes(exported.texts[part].encode("utf-8"))
        found = exported.format.read({part: place.read_bytes().decode("utf-8") for part, place in temporary.items()})
        meant = exported.format.read(exported.texts)
        if any(not np.array_equal(found[name], value) for name, value in meant.items()):
            raise DataError(f"{path} does not read back as it was written: nothing is left of it; try another disk.")
    return tuple(places.values())


def load(path: str | PathLike[str], target: str) -> ImportedCalibration:
    """Read a file of other software as a pre-calibration.

    Parameters
    ----------
    path : path-like
        As it was given to :func:`save`: formats of several files append to the stem of its name.
    target : str
        Name of the format.

    Returns
    -------
    ImportedCalibration
        ``Prior.from_sigma(sigma, loaded.errors)`` makes a prior of it.

    Raises
    ------
    InputError
        A format that does not hold enough, or a file that cannot be read or was edited or truncated.
    """
    chosen = exporter(target)
    if not chosen.imports:
        raise InputError(
            f"A {target} file is not a pre-calibration: it holds too few parameters or a whole calibration."
        )
    texts = read_texts(chosen, path)
    try:
        gyro, accel, g_sensitivity = forward_model(chosen, chosen.read(texts))
        errors, U = to_mars(gyro, accel)
        reason = outside_model(errors)
        if reason is not None:
            raise InputError(f"{reason}; a file for readings in other units than rad/s and m/s², as counts, looks so.")
    except SrtError as error:
        raise InputError(f"{path}, read as {chosen.title}: {error}") from None
    absent = tuple(group.name for group in GROUPS if group.omissible)
    absent += () if chosen.biases else ("gyro_bias", "accel_bias")
    return ImportedCalibration(errors, U, absent, g_sensitivity @ U.T)


def load_any(text: str) -> tuple[str, ImportedCalibration]:
    """Read a file of other software named as "FILE", whose format is recognised, or as "FORMAT:FILE".

    Returns
    -------
    target : str
        Name of the format.
    loaded : ImportedCalibration

    Raises
    ------
    InputError
        A file that no format or more than one can be read from, or the errors of :func:`load`.
    """
    readable = [item for item in exporters().values() if item.imports]
    name, colon, path = text.partition(":")
    if colon and name in exporters():
        return name, load(path, name)
    candidates = [item for item in readable if Path(text).suffix.lower() in item.suffixes]
    if not any(place.exists() for item in candidates or readable for place in part_paths(item, text).values()):
        raise InputError(f"There is no file {text} to read: check the path.")
    found, closest = {}, ""
    for item in candidates:
        try:
            item.read(read_texts(item, text))
        except SrtError as error:
            if not (closest or str(error).startswith((ABSENT, "it ", "The file "))):
                closest = f"; read as {item.title}, {str(error).rstrip('.')}"
        else:
            found[item.name] = item
    if len(found) == 1:
        name = found.popitem()[0]
        return name, load(text, name)
    names = ", ".join(found or [item.name for item in readable])
    which = "may be of more than one format" if found else "is of no format that can be read back"
    reason = "" if found else closest
    raise InputError(f"{text} {which} ({names}){reason}: name it with its format, as {readable[0].name}:{text}.")


def read_texts(chosen: Exporter, path: str | PathLike[str]) -> dict[str, str]:
    """Texts of the files of a format on disk, by part. Raises InputError."""
    texts = {}
    for part, place in part_paths(chosen, path).items():
        if part in chosen.companions:
            continue
        try:
            texts[part] = place.read_bytes().decode("utf-8")
        except OSError as error:
            raise InputError(f"The file {place} cannot be read: {error.strerror}.") from None
        except UnicodeDecodeError:
            raise InputError(f"The file {place} is no text: name a {chosen.title}.") from None
    return texts


def part_paths(chosen: Exporter, path: str | PathLike[str]) -> dict[str, Path]:
    """Paths of the files of a format, by part. Raises InputError for a folder without a name."""
    base = Path(path)
    if not base.name:
        raise InputError(f"{base} is a folder: name a file that ends in {' or '.join(chosen.suffixes)}.")
    return {
        part: base.with_name(base.stem + part + base.suffix) if part else base
        for part in (*chosen.parts, *chosen.companions)
    }


def replaced_correction(chosen: Exporter, known: AppliedCorrection | None) -> AppliedCorrection | None:
    """Correction of the log that the file replaces; None if it works on the readings as they were logged.

    Raises InputError for one that must be known and is not, or that a file of the format does not replace.
    """
    if known is not None and known.system == chosen.name:
        return known
    if not chosen.find_applied or (known is not None and known.system == NOTHING):
        return None
    if known is None:
        raise InputError(
            f"A file for {chosen.name} replaces the correction that the unit applied before it logged, and that one is "
            f"not known: {chosen.find_applied}; then add --applied {chosen.name}:FILE, or --applied none if the log "
            "holds the readings of the sensors themselves."
        )
    raise InputError(
        f"The readings were logged under the correction of {known.system}, which a file for {chosen.name} does not "
        f"replace: export to {known.system}, or to a format for the logged readings."
    )


def _g_sensitivity(calibration: Calibration, C_FB: Array) -> Array:
    # ω̃ = Mg ω + Γ f + b, and f = C_FBᵀ f_F
    matrix = calibration.g_sensitivity
    return np.zeros((3, 3)) if matrix is None else matrix @ C_FB.T


def _axes(
    calibration: Calibration, chosen: Exporter, frame: str, accel: LinearModel, replaced: AppliedCorrection | None
) -> Array:
    if frame not in chosen.frames:
        raise InputError(
            f"The format {chosen.name} cannot be in {frame} axes: it takes {' or '.join(chosen.frames)}"
            + (", those that its accelerometer matrix defines." if chosen.frames == ("accel",) else ".")
        )
    if frame == "accel":
        assert chosen.triangle is not None
        if replaced is None:
            return FACTORS[chosen.triangle](accel.matrix)[1]
        C = replaced.rotation
        composed = accel.before(replaced.accel_matrix, replaced.accel_offset, C)
        return np.asarray(C @ FACTORS[chosen.triangle](composed.matrix)[1] @ C.T)
    if frame == "mars":
        return np.eye(3)
    rotation = Applier(calibration, frame="table").rotation
    assert rotation is not None
    return np.array(rotation).reshape(3, 3)


def _linear_parts(calibration: Calibration, fitted: Readings | None) -> tuple[LinearModel, LinearModel]:
    rate, force = (None, None) if fitted is None else calibration.apply(fitted.gyro, fitted.accel)
    return linear_part(gyro_triad(calibration.errors), rate), linear_part(accel_triad(calibration.errors), force)


def _residuals(
    chosen: Exporter, fields: Fields, alone: ExportModel, model: ExportModel, readings: Readings
) -> tuple[CorrectionDifference, ...]:
    """Differences from the calibration of the file, composed (``model``) or not (``alone``), on logged readings."""
    calibration, C_FB = model.calibration, model.C_FB
    applied = model.applied or AppliedCorrection(NOTHING)

    def corrected_by(calibration: Calibration) -> Correction:
        def corrected(gyro: Array, accel: Array) -> tuple[Array, Array]:
            rate, force = calibration.apply(gyro, accel)
            return rate @ C_FB.T, force @ C_FB.T

        return corrected

    def linear_with(sensitivity: Array) -> Correction:
        def linear(gyro: Array, accel: Array) -> tuple[Array, Array]:
            force = alone.accel.correct(accel)
            return alone.gyro.correct(gyro - force @ sensitivity.T), force

        return linear

    def of(values: Fields, *, biases: bool = False) -> Correction:
        def theirs(gyro: Array, accel: Array) -> tuple[Array, Array]:
            raw_gyro, raw_accel = applied.undo(gyro, accel)
            if biases:
                raw_gyro, raw_accel = raw_gyro - model.gyro.bias, raw_accel - model.accel.bias
            rate, force = chosen.apply(values, raw_gyro, raw_accel)
            return rate @ applied.rotation.T, force @ applied.rotation.T

        return theirs

    ours = corrected_by(calibration)
    held = linear_with(alone.g_sensitivity if chosen.g_sensitivity else np.zeros((3, 3)))
    if chosen.asymmetry:
        without = np.where(FURTHER, 0.0, calibration.errors.vector)
        held = corrected_by(replace(calibration, errors=SensorErrors(without)))
    _check(chosen, readings, held, of(fields, biases=not chosen.biases))
    out = [compare_corrections("this file", readings, ours, of(fields))]
    if model.applied is not None:
        out.append(compare_corrections("readings as logged", readings, ours, lambda gyro, accel: (gyro, accel)))
        with suppress(InputError):  # values that the target does not take
            uncomposed = chosen.read(chosen.write(alone))
            out.append(compare_corrections("loaded alone, not composed", readings, ours, of(uncomposed)))
    if not chosen.biases:
        out.append(compare_corrections("biases given beside it", readings, ours, of(fields, biases=True)))
    if _asymmetric(calibration) and not chosen.asymmetry:
        out.append(compare_corrections("asymmetry alone", readings, ours, linear_with(alone.g_sensitivity)))
    return tuple(out)


def _check(chosen: Exporter, readings: Readings, expected: Correction, found: Correction) -> None:
    """Refuse a file that does not reproduce the exported correction; lossy formats are reported."""
    if chosen.within is None:
        return
    rate, force = expected(readings.gyro[:1000], readings.accel[:1000])
    off = compare_corrections("", Readings(readings.gyro[:1000], readings.accel[:1000], ""), expected, found)
    for name, values, worst in (("gyro", rate, off.gyro_max), ("accelerometer", force, off.accel_max)):
        size = max(float(np.abs(values).max()), 1.0)
        if not worst <= chosen.within * size:
            raise DataError(
                f"The {name} correction of the {chosen.name} file differs by {worst:.3g} from the exported one, "
                f"more than the tolerance {chosen.within * size:.1g}: it is not written; use another format."
            )


def _losses(chosen: Exporter, calibration: Calibration) -> tuple[str, ...]:
    asymmetry = () if chosen.asymmetry or not _asymmetric(calibration) else ("scale-factor asymmetry",)
    sensitivity = ("g-sensitivity",) if calibration.g_sensitivity is not None and not chosen.g_sensitivity else ()
    return (*asymmetry, *sensitivity, *further_errors(calibration), *chosen.losses, "covariance")


def _asymmetric(calibration: Calibration) -> bool:
    return bool(calibration.errors.group("gyro_asymmetry").any() or calibration.errors.group("accel_asymmetry").any())


def forward_model(chosen: Exporter, fields: Fields) -> tuple[Triad, Triad, Array]:
    """Sensor model ``ω̃ = Mg ω + Γ f + b``, ``f̃ = Ma f + b`` of a format and Γ, from its affine correction."""
    probes = np.vstack([np.zeros(3), np.eye(3)])
    zero = np.zeros((4, 3))
    rate, force = chosen.apply(fields, probes, probes)
    rate_of_gyro, _ = chosen.apply(fields, probes, zero)
    rate_of_accel = chosen.apply(fields, zero, probes)[0]
    linears = []
    for values in (rate_of_gyro, force):
        matrix = np.linalg.inv((values[1:] - values[0]).T)
        linears.append(LinearModel(matrix, -matrix @ values[0]))
    gyro, accel = linears
    slope = (rate_of_accel[1:] - rate_of_accel[0]).T
    sensitivity = np.zeros((3, 3))
    if np.abs(slope).max() > _G_SENSITIVITY_WITHIN * max(1.0, np.abs(rate).max()):
        # ∂ω/∂f̃ = −Mg⁻¹ Γ Ma⁻¹, and the bias found at f̃ = 0 includes Γ f(0) = −Γ Ma⁻¹ b_a
        sensitivity = -gyro.matrix @ slope @ accel.matrix
    bias = gyro.bias + sensitivity @ np.linalg.solve(accel.matrix, accel.bias)
    return Triad(gyro.matrix, np.zeros(3), bias), Triad(accel.matrix, np.zeros(3), accel.bias), sensitivity
