"""Noise densities, random walks and sample rate that visual-inertial formats hold beside the calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.noise.allan import FLAT, TERMS
from srt.noise.stated_figures import stated_term, white_noise

if TYPE_CHECKING:
    from srt.exporters.export_model import ExportModel

OPTIONS: Final = frozenset({"topic", "rate_hz", "gyro_random_walk", "accel_random_walk", "inflate"})
DEFAULT_TOPIC: Final = "/imu0"

_BIAS_WALK: Final = [term.name for term in TERMS].index("bias_random_walk")


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
        found["rate_hz"] = float(model.settings.rate_hz)
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
