"""Noise densities, random walks and sample rate that visual-inertial formats hold beside the calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from srt.exporters.export_model import ExportModel

OPTIONS: Final = frozenset({"topic", "rate_hz", "gyro_random_walk", "accel_random_walk"})
DEFAULT_TOPIC: Final = "/imu0"


def known_figures(model: ExportModel) -> dict[str, float]:
    """Known values, one number for all axes of a sensor.

    Parameters
    ----------
    model : ExportModel

    Returns
    -------
    dict of str to float
        Any of "gyro_noise", "accel_noise" (white, rad/s/√Hz and m/s²/√Hz, that of the noisiest axis),
        "gyro_random_walk", "accel_random_walk" and "rate_hz". Unknown values are absent: a rotation test
        is too short to determine the random walk of a bias.
    """
    found: dict[str, float] = {}
    for sensor in ("gyro", "accel"):
        white = model.white_noise(sensor)
        if white is not None:
            found[f"{sensor}_noise"] = float(white.max())
    for name in ("gyro_random_walk", "accel_random_walk", "rate_hz"):
        value = getattr(model.settings, name)
        if value is not None:
            found[name] = float(value)
    return found


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
        "gyro_random_walk": "gyro random walk (--gyro-random-walk)",
        "accel_random_walk": "accelerometer random walk (--accel-random-walk)",
        "rate_hz": "sample rate (--rate-hz, or --recording)",
    }
    return tuple(text for key, text in words.items() if key not in figures)
