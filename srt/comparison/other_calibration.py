"""Calibration of another program beside one of this package, on one recording: parameters and residuals.

The residuals need no calibration: at rest the specific force is gravity and the rate is the Earth's, and after a turn
the gyros predict the direction of gravity that the accelerometers measure.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.comparison.estimate_difference import finite
from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis.gravity_rotation import ManoeuvreReadings, recognised_manoeuvres
from srt.exceptions import InputError
from srt.model.analytic_platform import integrate_attitude
from srt.model.gyro_stream import gyro_stream
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES, OMISSIBLE, SensorErrors
from srt.sequences.recognition import recognise

if TYPE_CHECKING:
    from srt.exporters.conversion import ImportedCalibration
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.types import Array, Mask

_SENSED: Final = 0.5
"""Largest median difference of the rate at rest from the Earth's, over the Earth's, at which the gyros measure it."""
_OTHER_UNIT: Final = 2.0
"""Ratio to gravity, or its inverse, of corrected readings at rest from which they are in another unit."""


@dataclass(frozen=True, slots=True)
class Remainder:
    """Root mean square and largest size of a residual."""

    rms: float
    largest: float

    @classmethod
    def of(cls, values: Array) -> Remainder:
        """Statistics of values, at least one."""
        return cls(float(np.sqrt(np.mean(values**2))), float(np.abs(values).max()))


@dataclass(frozen=True, slots=True)
class CorrectedResiduals:
    """Residuals of corrected readings.

    Attributes
    ----------
    force : Remainder, m/s²
        Magnitude of the specific force in the stationary windows, less gravity.
    rate : Remainder, rad/s
        Magnitude of the rate there, less the Earth's.
    turn : Remainder, rad
        Angle between gravity after a turn and its prediction by the gyros; of recordings without turns, zero.
    """

    force: Remainder
    rate: Remainder
    turn: Remainder


@dataclass(frozen=True, slots=True, eq=False)
class OtherCalibration:
    """Comparison of a calibration with that of another program.

    Attributes
    ----------
    held : ndarray of bool, shape (27,)
        Parameters that the other file holds.
    difference : ndarray, shape (27,), SI
        Other less this calibration, both in MARS axes; NaN where not held.
    normalised : ndarray, shape (27,)
        The same over this calibration's sigma, NaN also where it has none; the other file states no sigma.
    absent : tuple of str
        Groups of parameters that the other file does not hold.
    residuals : dict of str to CorrectedResiduals
        "this", "other" (with this calibration's biases where the file holds none) and "none", for raw readings.
    windows, turns : int
        Numbers of stationary windows and turns.
    earth_removed : bool
        True if the Earth's rotation was removed from the turns, by the rate at rest; False where the gyros do not
        measure it.
    same_recording : bool
        True if this calibration was made from this recording.
    """

    calibration: Calibration
    other: SensorErrors
    held: Mask
    difference: Array
    normalised: Array
    absent: tuple[str, ...]
    residuals: dict[str, CorrectedResiduals]
    windows: int
    turns: int
    earth_removed: bool
    same_recording: bool

    def as_dict(self) -> dict[str, Any]:
        """The JSON form, in SI."""
        return {
            "parameters": list(NAMES),
            "held": self.held.tolist(),
            "this": self.calibration.errors.vector.tolist(),
            "sigma": finite(self.calibration.sigma),
            "other": finite(np.where(self.held, self.other.vector, np.nan)),
            "normalised": finite(self.normalised),
            "residuals": {name: asdict(found) for name, found in self.residuals.items()},
            "windows": self.windows,
            "turns": self.turns,
            "same_recording": self.same_recording,
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Correction:
    """Correction of readings by sensor errors and gyro g-sensitivity Γ, ω̃ = Mg ω + s ∘ |ω| + Γ f + b."""

    errors: SensorErrors
    g_sensitivity: Array

    def apply(self, rate: Array, force: Array) -> tuple[Array, Array]:
        """Rates and specific forces of readings, shapes (n, 3)."""
        true = accel_triad(self.errors).compensate(force)
        return gyro_triad(self.errors).compensate(rate - true @ self.g_sensitivity.T), true


def compare_with(calibration: Calibration, other: ImportedCalibration, recording: Recording) -> OtherCalibration:
    """Compare a calibration with that of another program on the raw readings of one recording of the unit.

    Raises
    ------
    DataError
        If fewer than two stationary windows are found.
    InputError
        If the other calibration is for readings in another unit.
    """
    found = recognise(recording)
    readings = recognised_manoeuvres(recording, found)
    missing = np.zeros(N_PARAMETERS, dtype=np.bool_)
    for group in other.absent:
        missing[GROUP_SLICES[group]] = True
    completed = np.where(missing & ~OMISSIBLE, calibration.errors.vector, other.errors.vector)
    own = calibration.g_sensitivity
    corrections = {
        "this": _Correction(calibration.errors, np.zeros((3, 3)) if own is None else own),
        "other": _Correction(SensorErrors(completed), other.g_sensitivity),
        "none": _Correction(SensorErrors(), np.zeros((3, 3))),
    }
    earth = _earth_rate(corrections["this"].apply(readings.rate, readings.force)[0])
    force = np.linalg.norm(corrections["other"].apply(readings.rate, readings.force)[1], axis=1)
    ratio = float(np.median(force)) / recording.site.gravity_m_s2
    if not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        raise InputError(
            f"Corrected by the other calibration, the accelerometers read {ratio:.3g} times gravity at rest: it is for "
            "readings in another unit than those of this recording, as counts."
        )
    difference = np.where(missing, np.nan, other.errors.vector - calibration.errors.vector)
    return OtherCalibration(
        calibration=calibration,
        other=other.errors,
        held=~missing,
        difference=difference,
        normalised=difference / calibration.sigma,
        absent=other.absent,
        residuals={name: _residuals(each, recording, readings, earth) for name, each in corrections.items()},
        windows=len(readings.rate),
        turns=len(readings.spans),
        earth_removed=bool(earth.any()),
        same_recording=calibration.provenance.data_sha256 == recording.data_sha256 is not None,
    )


def _earth_rate(rate: Array) -> Array:
    """Earth's rate in the axes of each window, from the rates of a calibrated unit; zero if it does not measure it."""
    off = np.abs(np.linalg.norm(rate, axis=1) - EARTH_RATE_RAD_S)
    return rate if np.median(off) < _SENSED * EARTH_RATE_RAD_S else np.zeros_like(rate)


def _residuals(
    correction: _Correction, recording: Recording, readings: ManoeuvreReadings, earth: Array
) -> CorrectedResiduals:
    # Means are corrected, not samples: an asymmetry would rectify the noise of these.
    rate, force = correction.apply(readings.rate, readings.force)
    size = np.linalg.norm(force, axis=1)
    turn = np.zeros(1)
    if len(readings.spans):
        gyro = recording.gyro
        if correction.g_sensitivity.any():
            factor = recording.rates_factor
            true = accel_triad(correction.errors).compensate(recording.accel * factor)
            gyro = gyro - true @ correction.g_sensitivity.T / factor
        stream = gyro_stream(gyro, recording.interval_s, readings.spans, readings.spans, rates=recording.kind == "rate")
        start, end = readings.between.T
        integrals, _ = integrate_attitude(stream, gyro_triad(correction.errors), earth[start])
        predicted = np.einsum("kab,kb->ka", integrals.C_end, force[end] / size[end, None])
        measured = force[start] / size[start, None]
        turn = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(predicted - measured, axis=1), 1.0))
    return CorrectedResiduals(
        force=Remainder.of(size - recording.site.gravity_m_s2),
        rate=Remainder.of(np.linalg.norm(rate, axis=1) - EARTH_RATE_RAD_S),
        turn=Remainder.of(turn),
    )
