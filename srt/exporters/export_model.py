"""Input of the writer of a format: linear sensor model in the axes of the format, noise, settings, heading."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.exporters.linear_model import LinearModel
from srt.model.rotations import rotation_vector
from srt.noise.allan import FLAT, TERMS
from srt.noise.stated_figures import stated_term, white_noise
from srt.recording.file_marks import UNSIGNED
from srt.recording.schema import LARGEST_ELEMENT
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.recording.applied import AppliedCorrection
    from srt.result.calibration import Calibration
    from srt.types import Array

_UNSAFE: Final = re.compile(r"[^A-Za-z0-9 ./:,;()+@=_-]")
_TOPIC: Final = re.compile(r"[A-Za-z0-9_/~.-]+")
LAST_INSTANCE: Final = 9
OPTIONS: Final = frozenset({"topic", "rate_hz", "gyro_random_walk", "accel_random_walk", "inflate"})
"""Settings of formats that hold noise."""
DEFAULT_TOPIC: Final = "/imu0"
_BIAS_WALK: Final = [term.name for term in TERMS].index("bias_random_walk")


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """Values that some formats require and a calibration does not hold; None where not stated.

    Attributes
    ----------
    topic : str or None
        ROS topic of the readings; default "/imu0".
    rate_hz : float or None
        Sample rate.
    gyro_random_walk : float or None
        Rate random walk of the gyro bias, rad/s²/√Hz.
    accel_random_walk : float or None
        Random walk of the accelerometer bias, m/s³/√Hz.
    prefix, precision, samples, namespace : str or None
        Form of a C header, see :func:`srt.exporters.c_header.c99_header`.
    inflate : float or None
        Factor on noise densities and random walks; default 1.
    instance : int or None
        Which IMU of the autopilot, from 0; default 0.

    Raises
    ------
    InputError
        Figures that are not positive, a name that is no topic, or an instance that is not 0 to 9.
    """

    topic: str | None = None
    rate_hz: float | None = None
    gyro_random_walk: float | None = None
    accel_random_walk: float | None = None
    instance: int | None = None
    inflate: float | None = None
    prefix: str | None = None
    precision: str | None = None
    samples: str | None = None
    namespace: str | None = None

    def __post_init__(self) -> None:
        for name in ("rate_hz", "gyro_random_walk", "accel_random_walk", "inflate"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= LARGEST_ELEMENT:
                raise InputError(
                    f"The setting {name} is {value:g}: give a positive number of at most {LARGEST_ELEMENT:g}, or leave "
                    "it out."
                )
        if self.topic is not None and not _TOPIC.fullmatch(self.topic):
            raise InputError(f"{self.topic!r} is no topic: use letters, digits and / _ ~ . - as in /imu0.")
        if self.instance is not None and not 0 <= self.instance <= LAST_INSTANCE:
            raise InputError(f"The instance is {self.instance}: give 0 for the first IMU, up to {LAST_INSTANCE}.")

    @property
    def stated(self) -> frozenset[str]:
        """Names of the settings that were given."""
        return frozenset(item.name for item in fields(self) if getattr(self, item.name) is not None)


@dataclass(frozen=True, slots=True, eq=False)
class ExportModel:
    """Calibration prepared for one format."""

    calibration: Calibration
    gyro: LinearModel  # in the format's axes F, as the accelerometers
    accel: LinearModel
    frame: str  # name of F: "mars", "table" or "accel"
    C_FB: Array  # shape (3, 3); from MARS axes to F
    settings: ExportSettings
    # shape (3, 3), rad/s per m/s²; gyro g-sensitivity Γ, rows gyros and columns axes of F; zero where not estimated
    g_sensitivity: Array = field(default_factory=lambda: np.zeros((3, 3)))
    applied: AppliedCorrection | None = None  # correction with which the model is composed

    def composed(self, applied: AppliedCorrection) -> ExportModel:
        """Model of the readings that the sensors had before a correction that was applied to them.

        Returns
        -------
        ExportModel
            In the axes of the sensors, which the rotation of ``applied`` takes to F.
        """
        C = applied.rotation
        gyro = self.gyro.before(applied.gyro_matrix, applied.gyro_offset, C)
        accel = self.accel.before(applied.accel_matrix, applied.accel_offset, C)
        # r = o + G Cᵀ ỹ + A⁻¹ Cᵀ (Mg ω + Γ f + b), with ỹ = Ma f + b
        to_sensor = C.T @ self.accel.matrix @ C
        sensitivity = np.linalg.solve(applied.gyro_matrix, C.T @ self.g_sensitivity @ C)
        gyro = LinearModel(gyro.matrix, gyro.bias + applied.g_sensitivity @ C.T @ self.accel.bias)
        return replace(
            self, gyro=gyro, accel=accel, g_sensitivity=sensitivity + applied.g_sensitivity @ to_sensor, applied=applied
        )

    def applied_lines(self) -> list[str]:
        """ASCII lines on the correction with which the model is composed."""
        applied = self.applied
        if applied is None:
            return []
        which = "" if applied.instance is None else f", IMU {applied.instance}"
        shown = [f"{key} {value}" for key, value in applied.document().items() if isinstance(value, list)]
        return [
            f"replaces the correction of the log ({applied.system}{which}):",
            *(f"  {_UNSAFE.sub(' ', s)}" for s in shown),
        ]

    @property
    def turn_mrad(self) -> Array:
        """Rotation vector from MARS axes to F, shape (3,), mrad."""
        return 1e3 * np.asarray(rotation_vector(self.C_FB[None])[0])


def origin(calibration: Calibration) -> list[str]:
    """ASCII lines on the unit, the test and the software, and the mark of the file.

    Texts keep only characters that cannot end a comment.
    """
    known, source = calibration.temperature, calibration.provenance
    measured = f", {int(calibration.observed.sum())} of {N_PARAMETERS} parameters are measured"
    words = {
        "serial": source.serial,
        "date": source.date,
        "software": source.software,
        "status": f"{calibration.status} ({calibration.estimator}){measured if calibration.fixed else ''}",
        "temperature": known and f"mean {known.mean_c:.1f} degC, range {known.range_c:.1f} degC in the test",
        "SHA-256": source.data_sha256,
    }
    stated = {key: _UNSAFE.sub("_", str(value or "not stated"))[:200] for key, value in words.items()}
    stated["digest"] = UNSIGNED
    return [f"{key + ':':<12} {value}" for key, value in stated.items()]


def comment(lines: Sequence[str], mark: str = "#") -> str:
    """Lines as comments."""
    return "".join(f"{mark} {line}".rstrip() + "\n" for line in lines)


def known_figures(model: ExportModel) -> dict[str, float]:
    """Known values, one number for all axes of a sensor.

    Returns
    -------
    dict of str to float
        Any of "gyro_noise", "accel_noise" (white, rad/s/√Hz and m/s²/√Hz), "gyro_random_walk", "accel_random_walk" and
        "rate_hz", each of the noisiest axis. Settings come first, then the calibration
        (:mod:`srt.noise.stated_figures`); unknown values are absent. All but the rate are multiplied by the inflation
        of the settings.
    """
    found: dict[str, float] = {}
    for sensor in ("gyro", "accel"):
        figures = {
            f"{sensor}_noise": white_noise(model.calibration.noise, sensor),
            f"{sensor}_random_walk": stated_term(model.calibration.noise, sensor, _BIAS_WALK)[0],
        }
        found |= {name: float(np.nanmax(values)) for name, values in figures.items() if not np.isnan(values).all()}
    for name in ("gyro_random_walk", "accel_random_walk"):
        value = getattr(model.settings, name)
        if value is not None:
            found[name] = float(value)
    found = {name: value * (model.settings.inflate or 1.0) for name, value in found.items()}
    if model.settings.rate_hz is not None:
        # The rate of an interval, as 1 / 0.005, without its rounding.
        found["rate_hz"] = float(f"{model.settings.rate_hz:.12g}")
    return found


def statement(model: ExportModel) -> list[str]:
    """Lines on the origin of the noise figures: inflation, and upper limits in place of values."""
    lines = [f"noise densities and random walks: multiplied by {model.settings.inflate or 1.0:g} (--inflate)"]
    for sensor in ("gyro", "accel"):
        term = _worst(model, sensor, _BIAS_WALK)
        if term is not None and term[1] and getattr(model.settings, f"{sensor}_random_walk") is None:
            lines.append(f"{sensor} random walk: upper limit (95 %), as the log of srt noise does not resolve it")
    return lines


def worst_bias_instability(model: ExportModel, sensor: str) -> float | None:
    """Largest bias instability of a sensor by ``srt noise``, SI, inflated; None if it was not run."""
    found = _worst(model, sensor, FLAT)
    return None if found is None else found[0] * (model.settings.inflate or 1.0)


def _worst(model: ExportModel, sensor: str, term: int) -> tuple[float, bool] | None:
    """Largest figure of a term over the three axes, SI, and True if it is an upper limit; None without srt noise."""
    figures, limits = stated_term(model.calibration.noise, sensor, term)
    known = zip(figures.tolist(), limits.tolist(), strict=True)
    return max((each for each in known if not np.isnan(each[0])), default=None)


def named(model: ExportModel, names: dict[str, str]) -> dict[str, Any]:
    """Known values under the names of a format."""
    figures = known_figures(model)
    return {name: figures[key] for key, name in names.items() if key in figures}


def unknown(model: ExportModel) -> tuple[str, ...]:
    """Names of the required values that are unknown."""
    figures = known_figures(model)
    words = {
        "gyro_noise": "gyro noise",
        "accel_noise": "accelerometer noise",
        "gyro_random_walk": "gyro random walk (srt noise LOG --into UNIT.json, or --gyro-random-walk)",
        "accel_random_walk": "accelerometer random walk (likewise, or --accel-random-walk)",
        "rate_hz": "sample rate (--rate-hz, or --recording)",
    }
    return tuple(text for key, text in words.items() if key not in figures)
