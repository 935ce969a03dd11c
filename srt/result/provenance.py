"""Origin of a calibration: recordings, options and software; site, fixture and temperature of the test."""

# Annotations are evaluated: srt.result.document reads files by them.
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from srt.exceptions import InputError
from srt.result.consistency import SequenceResult


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedSite:
    """Site of a test as stated; None where not stated, or where merged recordings differ."""

    latitude_deg: float | None = None
    gravity_m_s2: float | None = None
    gravity_sigma_m_s2: float | None = None
    latitude_sigma_deg: float | None = None
    gravity_sigma_origin: str | None = None  # "assumed": nobody stated gravity_sigma_m_s2
    nulls: tuple[str, ...] = field(
        default=("latitude_deg", "gravity_m_s2", "gravity_sigma_m_s2", "latitude_sigma_deg"), compare=False
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Fixture of a test with its 1-sigmas as stated; None where not stated, or where merged recordings differ.

    Attributes
    ----------
    fixture : bool or None
        False: the unit was turned freely.
    heading_deg : float or None
        Clockwise from north, of the table x axis.
    alignment_sigma_mrad, rotation_sigma_mrad, wobble_sigma_mrad : float or None
    nulls : tuple of str
        Fields that the file gives as null, see ``srt/result/document.py``: unknown, or different in merged recordings.
    """

    fixture: bool | None = None
    heading_deg: float | None = None
    alignment_sigma_mrad: float | None = None
    rotation_sigma_mrad: float | None = None
    wobble_sigma_mrad: float | None = None
    nulls: tuple[str, ...] = field(default=(), compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceTemperature(SequenceResult):
    """Mean and range of the temperature in a sequence, °C."""

    mean_c: float
    range_c: float


@dataclass(frozen=True, slots=True)
class Temperature:
    """Mean and range of the temperature in a test, °C, and by sequence.

    Raises
    ------
    InputError
        A negative range.
    """

    mean_c: float
    range_c: float
    sequences: tuple[SequenceTemperature, ...] = ()

    def __post_init__(self) -> None:
        if self.range_c < 0.0:
            raise InputError(f"temperature.range_c is {self.range_c}: the range must not be negative.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Origin of a calibration.

    Attributes
    ----------
    data_sha256 : str or None
        SHA-256 of the samples.
    software : str or None
        Name and version; early files have versions by name.
    serial, date : str or None
    options : mapping of str to object
        Options of the estimator, as JSON values.
    voided : mapping of str to str
        Reasons by sequence that was not used.
    applied : mapping or None
        Correction that the recording's system had applied, under the names of ``[imu.applied]``.
    recordings : tuple of Provenance, or None
        Recordings of a merged calibration.
    """

    data_sha256: str | None = None
    software: str | Mapping[str, str] | None = None
    serial: str | None = None
    date: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    voided: Mapping[str, str] = field(default_factory=dict)
    applied: Mapping[str, Any] | None = None
    recordings: "tuple[Provenance, ...] | None" = None
    nulls: tuple[str, ...] = field(default=("data_sha256", "software", "serial", "date"), compare=False)
