"""Offsets over temperature as PX4 (TC_*) and ArduPilot (INS_TCAL*) store them: cubics of each axis, read and written.

PX4 subtracts ``X0 + X1 Δ + X2 Δ² + X3 Δ³``, with Δ the temperature less TREF, clipped to TMIN and TMAX. ArduPilot
subtracts ``P(T − 35) − P(CALTEMP − 35)`` with ``P(Δ) = (c1 Δ + c2 Δ² + c3 Δ³) 1e-6`` and T clipped likewise, then the
offsets, which therefore belong to CALTEMP. Both store no scale factor over temperature, and single precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.exporters.export_model import comment, origin
from srt.exporters.parameter_files import parameter_values
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.recording.file_marks import signed
from srt.sensor_errors import GROUP_SLICES, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from srt.result.calibration import Calibration
    from srt.result.thermal_errors import ThermalErrors
    from srt.types import Array

ARDUPILOT_REFERENCE_C: Final = 35.0
_SENSORS: Final = ("gyro", "accel")
_POINTS: Final = 201
"""Temperatures of a fit, in equal steps over the range."""
_STAIRCASE_K: Final = 1.0
"""Change of temperature from which PX4 takes over another offset."""


@dataclass(frozen=True, slots=True, eq=False)
class OffsetCurves:
    """Biases of both triads as cubics of temperature, constant outside their range.

    Attributes
    ----------
    lowest_c, highest_c, reference_c : float
        Range and the temperature at which the cubics have their constants, °C.
    coefficients : ndarray, shape (2, 4, 3)
        Gyros, accelerometers; constant to cubic; x, y, z: rad/s/K^j and m/s²/K^j.
    """

    lowest_c: float
    highest_c: float
    reference_c: float
    coefficients: Array

    def at(self, temperature_c: float | Array) -> Array:
        """Offsets at temperatures of shape (...), shape (2, ..., 3), rad/s and m/s²."""
        delta = np.clip(temperature_c, self.lowest_c, self.highest_c) - self.reference_c
        powers = np.asarray(delta)[..., None] ** np.arange(4)
        return np.stack([powers @ part for part in self.coefficients])


@dataclass(frozen=True, slots=True, eq=False)
class ThermalFile:
    """Parameter file of offsets over temperature, and what it does not hold.

    Attributes
    ----------
    text : str
    curves : OffsetCurves
        As the file has them, in single precision.
    residual : ndarray, shape (2, 3)
        Largest difference of the cubics from the calibration within the range, rad/s and m/s².
    step : ndarray, shape (2, 3)
        Largest change of an offset over the step in which PX4 takes it over; zero for ArduPilot.
    lost : ndarray, shape (2,)
        Largest error of a rate of 1 rad/s and of a specific force of 1 g by scale factors and misalignments that change
        from the middle of the range, rad/s and m/s².
    """

    text: str
    curves: OffsetCurves
    residual: Array
    step: Array
    lost: Array


def fitted(thermal: ThermalErrors, reference_c: float, *, through_c: float | None = None) -> OffsetCurves:
    """Cubics of the biases by weighted least squares over the range.

    Parameters
    ----------
    thermal : ThermalErrors
    reference_c : float
        °C.
    through_c : float, optional
        Temperature at which they are exact; the constants are then those that this gives.
    """
    T = np.linspace(thermal.lowest_c, thermal.highest_c, _POINTS)
    values = thermal.values(T)
    weight = 1.0 / np.stack([np.sqrt(np.diag(sum(thermal.covariance_at(t).values()))) for t in T.tolist()])
    powers = (T - reference_c)[:, None] ** np.arange(4)
    out = np.zeros((2, 4, 3))
    for s, sensor in enumerate(_SENSORS):
        for axis, k in enumerate(range(*GROUP_SLICES[f"{sensor}_bias"].indices(values.shape[1]))):
            w, b = np.nan_to_num(weight[:, k], posinf=1.0), values[:, k]
            if through_c is None:
                out[s, :, axis] = _solved(w[:, None] * powers, w * b)
                continue
            fixed, at = (through_c - reference_c) ** np.arange(4), float(thermal.values(through_c)[k])
            out[s, 1:, axis] = _solved(w[:, None] * (powers - fixed)[:, 1:], w * (b - at))
            out[s, 0, axis] = at - fixed[1:] @ out[s, 1:, axis]
    return OffsetCurves(thermal.lowest_c, thermal.highest_c, reference_c, out)


def _solved(A: Array, y: Array) -> Array:
    scale = np.linalg.norm(A, axis=0)
    return np.asarray(np.linalg.lstsq(A / scale, y, rcond=None)[0] / scale)


def write_px4(curves: OffsetCurves, instance: int = 0) -> str:
    """Lines of a PX4 parameter file; the constants are in X0, so that CAL_*_OFF are zero."""
    lines: dict[str, tuple[float, int]] = {f"TC_{letter}_ENABLE": (1.0, 6) for letter in "GA"}
    for letter, part in zip("GA", curves.coefficients, strict=True):
        name = f"TC_{letter}{instance}"
        edges = (("TMIN", curves.lowest_c), ("TMAX", curves.highest_c), ("TREF", curves.reference_c))
        lines |= {f"{name}_{key}": (value, 9) for key, value in edges}
        lines |= {f"{name}_X{j}_{axis}": (part[j, axis], 9) for j in range(4) for axis in range(3)}
        lines |= {f"CAL_{'GYRO' if letter == 'G' else 'ACC'}{instance}_{a}OFF": (0.0, 9) for a in "XYZ"}
    return "".join(f"1\t1\t{name}\t{_single(value)}\t{kind}\n" for name, (value, kind) in sorted(lines.items()))


def read_px4(text: str, instance: int = 0) -> OffsetCurves:
    """Curves of a PX4 parameter file. Raises InputError: a parameter that is not there."""
    found = parameter_values(text)
    names = [[[f"TC_{s}{instance}_X{j}_{axis}" for axis in range(3)] for j in range(4)] for s in "GA"]
    low, high, reference = (_of(found, f"TC_A{instance}_{key}") for key in ("TMIN", "TMAX", "TREF"))
    return OffsetCurves(low, high, reference, _numbers(found, names))


def write_ardupilot(curves: OffsetCurves, instance: int = 0) -> str:
    """Lines of an ArduPilot parameter file: coefficients, CALTEMP, and the offsets at it."""
    n, own = instance + 1, "" if instance == 0 else str(instance + 1)
    at = float(np.clip(ARDUPILOT_REFERENCE_C, curves.lowest_c, curves.highest_c))
    values: dict[str, float] = {
        f"INS_TCAL{n}_ENABLE": 1.0,
        f"INS_TCAL{n}_TMIN": curves.lowest_c,
        f"INS_TCAL{n}_TMAX": curves.highest_c,
    }
    for key, part, offset in zip(("GYR", "ACC"), curves.coefficients, curves.at(at), strict=True):
        values |= {f"INS_TCAL{n}_{key}{j}_{axis}": 1e6 * part[j, a] for j in (1, 2, 3) for a, axis in enumerate("XYZ")}
        values[f"INS_{key}{n}_CALTEMP"] = at
        values |= {f"INS_{key}{own}OFFS_{axis}": offset[a] for a, axis in enumerate("XYZ")}
    return "".join(f"{name},{_single(value)}\n" for name, value in values.items())


def read_ardupilot(text: str, instance: int = 0) -> OffsetCurves:
    """Curves of an ArduPilot parameter file, with the offsets at CALTEMP. Raises InputError, as :func:`read_px4`."""
    found = parameter_values(text)
    n, own = instance + 1, "" if instance == 0 else str(instance + 1)
    names = [[[f"INS_TCAL{n}_{key}{j}_{axis}" for axis in "XYZ"] for j in (1, 2, 3)] for key in ("GYR", "ACC")]
    low, high = (_of(found, f"INS_TCAL{n}_{key}") for key in ("TMIN", "TMAX"))
    coefficients = np.concatenate([np.zeros((2, 1, 3)), 1e-6 * _numbers(found, names)], axis=1)
    for s, key in enumerate(("GYR", "ACC")):
        at = float(np.clip(_of(found, f"INS_{key}{n}_CALTEMP"), low, high)) - ARDUPILOT_REFERENCE_C
        offset = _numbers(found, [f"INS_{key}{own}OFFS_{axis}" for axis in "XYZ"])
        coefficients[s, 0] = offset - at ** np.arange(1, 4) @ coefficients[s, 1:]
    return OffsetCurves(low, high, ARDUPILOT_REFERENCE_C, coefficients)


def thermal_file(calibration: Calibration, target: str, instance: int = 0) -> ThermalFile:
    """Parameter file of an autopilot with the biases of a calibration over temperature.

    Raises
    ------
    InputError
        A target that has no parameters over temperature.
    """
    thermal = calibration.thermal
    assert thermal is not None
    if target not in TARGETS:
        raise InputError(
            f"The format {target} holds errors of one temperature: add --temperature T; {', '.join(TARGETS)} hold "
            "offsets over temperature."
        )
    write, read, ends_at = TARGETS[target]
    middle = 0.5 * (thermal.lowest_c + thermal.highest_c)
    if ends_at is None:
        curves = fitted(thermal, middle)
    else:
        curves = fitted(thermal, ends_at, through_c=float(np.clip(ends_at, thermal.lowest_c, thermal.highest_c)))
    text = write(curves, instance)
    kept = read(text, instance)
    T = np.linspace(thermal.lowest_c, thermal.highest_c, _POINTS)
    values = thermal.values(T)
    biases = np.stack([values[:, GROUP_SLICES[f"{sensor}_bias"]] for sensor in _SENSORS])
    slope = np.abs(np.gradient(biases, T, axis=1)).max(axis=1)
    head = ["Offsets over temperature; generated, do not edit.", *origin(calibration), *_FORMULAS[target]]
    return ThermalFile(
        text=signed(comment(head) + text),
        curves=kept,
        residual=np.abs(kept.at(T) - biases).max(axis=1),
        step=slope * (_STAIRCASE_K if target == "px4" else 0.0),
        lost=_lost(values, thermal.values(middle)),
    )


def _lost(values: Array, middle: Array) -> Array:
    """Largest error of 1 rad/s and 1 g by matrices and asymmetries that change with temperature, shape (2,)."""
    out = np.zeros(2)
    for s, (of, size) in enumerate(((gyro_triad, 1.0), (accel_triad, 9.80665))):
        first = of(SensorErrors(middle))
        for vector in values:
            now = of(SensorErrors(vector))
            turned = np.linalg.norm(now.matrix - first.matrix, 2) + np.abs(now.asymmetry - first.asymmetry).max()
            out[s] = max(out[s], size * float(turned))
    return out


def _single(value: float) -> str:
    return f"{float(np.float32(value)):.9g}"


def _of(found: Mapping[str, float], name: str) -> float:
    if name not in found:
        raise InputError(f"There is no {name} in the file: it was truncated, or is of another IMU.")
    return found[name]


def _numbers(found: Mapping[str, float], names: object) -> Array:
    array = np.array(names)
    return np.array([_of(found, name) for name in array.ravel().tolist()]).reshape(array.shape)


TARGETS: Final[
    dict[str, tuple[Callable[[OffsetCurves, int], str], Callable[[str, int], OffsetCurves], float | None]]
] = {
    "px4": (write_px4, read_px4, None),
    "ardupilot": (write_ardupilot, read_ardupilot, ARDUPILOT_REFERENCE_C),
}
"""Formats with offsets over temperature: writer, reader, and the reference temperature where the format fixes it."""
_FORMULAS: Final = {
    "px4": (
        "corrected = raw - (X0 + X1 d + X2 d^2 + X3 d^3), d = clip(T, TMIN, TMAX) - TREF, in the axes of the sensors",
        "set TC_A_ID and TC_G_ID to the ids of the devices: with others nothing is applied",
    ),
    "ardupilot": (
        "corrected = raw - P(clip(T) - 35) + P(CALTEMP - 35) - OFFS, P(d) = (c1 d + c2 d^2 + c3 d^3) 1e-6",
        "with INS_GYR_CAL other than 0 the gyro offsets are measured anew at each start",
    ),
}
