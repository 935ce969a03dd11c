"""Repeatability of the parameters over merged recordings."""

# Annotations are evaluated: srt.result.document reads files by them.
from dataclasses import dataclass

from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MergedRecording:
    """Recording that was merged, with the fixed parameters and U of its calibration."""

    name: str
    estimator: str
    status: str
    date: str | None
    temperature_c: float | None
    temperature_range_c: float | None
    data_sha256: str | None
    held: tuple[str, ...]
    U: Array | None
    U_sigma: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class OmittedRecording:
    """Recording that was left out, with the status of its calibration."""

    name: str
    status: str


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupRepeatability:
    """Test of a group of parameters, and its 1-sigma between recordings, SI."""

    group: str
    chi_square: float
    degrees_of_freedom: int
    probability: float | None
    between_sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """Recording with the largest deviation from the mean, in sigmas of the deviation."""

    recording: str
    sigmas: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterRepeatability:
    """Values of a parameter, SI, by recording (None where fixed), with their scatter about the weighted mean."""

    name: str
    values: tuple[float | None, ...]
    sigmas: tuple[float | None, ...]
    weighted_mean: float
    merged: float
    spread: float | None
    chi_square: float
    degrees_of_freedom: int
    probability: float | None
    largest_deviation: Deviation | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Repeatability:
    """Repeatability over the recordings of a unit.

    Chi-square uses the sigmas within recordings, without the errors common to all.
    """

    recordings: tuple[MergedRecording, ...]
    left_out: tuple[OmittedRecording, ...]
    chi_square: float
    degrees_of_freedom: int
    probability: float | None
    groups: tuple[GroupRepeatability, ...]
    parameters: tuple[ParameterRepeatability, ...]
