"""KF-GINS (loosely coupled navigation): initial errors of the IMU, their standard deviations and its noise.

KF-GINS corrects increments by ``dtheta = (dtheta − gyrbias dt) / (1 + gyrscale)`` axis by axis, and estimates both from
their initial values on. Units of its file: °/h, mGal, ppm, °/√h and m/s/√h. The section is part of a complete
configuration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, HOUR_S
from srt.exceptions import InputError
from srt.exporters.export_model import comment, known_figures, worst_bias_instability
from srt.exporters.file_format import Exporter, each_sensor, field, from_yaml, heading, to_yaml, whole_lines
from srt.exporters.linear_model import axis_factors
from srt.sensor_errors import GROUP_SLICES

if TYPE_CHECKING:
    from srt.exporters.export_model import ExportModel
    from srt.exporters.file_format import Fields, Texts
    from srt.types import Array

_MGAL: Final = 1e-5
"""m/s² per mGal."""
_PPM: Final = 1e-6
_METRE_PER_SQRT_H: Final = HOUR_S**-0.5
"""m/s/√s per m/s/√h."""

_STATES: Final = {
    "initgyrbias": ("gyro_bias", DEG_PER_H),
    "initaccbias": ("accel_bias", _MGAL),
    "initgyrscale": ("gyro_scale", _PPM),
    "initaccscale": ("accel_scale", _PPM),
}
_SIGMAS: Final = {
    "initgyrbias": "initbgstd",
    "initaccbias": "initbastd",
    "initgyrscale": "initsgstd",
    "initaccscale": "initsastd",
}
_NOISE: Final = {"arw": ("gyro_noise", DEG_PER_SQRT_H), "vrw": ("accel_noise", _METRE_PER_SQRT_H)}
_DRIFTS: Final = {"gbstd": ("gyro", DEG_PER_H), "abstd": ("accel", _MGAL)}


def _values(model: ExportModel) -> dict[str, Array]:
    """Initial states, SI; the scale factors are those with the least error over all directions."""
    scales = {
        f"{sensor}_scale": 1.0 / axis_factors(getattr(model, sensor).matrix) - 1.0 for sensor in ("gyro", "accel")
    }
    if min(float(v.min()) for v in scales.values()) <= -1.0:
        raise InputError("A sensor is turned by more than 90°, which three scale factors cannot state.")
    return {"gyro_bias": model.gyro.bias, "accel_bias": model.accel.bias, **scales}


def _write(model: ExportModel) -> dict[str, str]:
    values = _values(model)
    document: dict[str, Any] = {name: (values[group] / unit).tolist() for name, (group, unit) in _STATES.items()}
    P = model.calibration.covariance
    for name, sigma_name in _SIGMAS.items():
        group, unit = _STATES[name]
        block = P[GROUP_SLICES[group], GROUP_SLICES[group]]
        # The squares of the rotation: scale factors of turned axes mix as the squares of the direction cosines do.
        turned = (
            model.C_FB @ block @ model.C_FB.T if group.endswith("bias") else model.C_FB**2 @ block @ (model.C_FB**2).T
        )
        document[sigma_name] = (np.sqrt(np.maximum(np.diag(turned), 0.0)) / unit).tolist()
    figures = known_figures(model)
    noise: dict[str, Any] = {name: [figures[key] / unit] * 3 for name, (key, unit) in _NOISE.items() if key in figures}
    for name, (sensor, unit) in _DRIFTS.items():
        found = worst_bias_instability(model, sensor)
        if found is not None:
            noise[name] = [found / unit] * 3
    if noise:
        document["imunoise"] = noise
    return {"": to_yaml(document, comment(heading(KF_GINS, model)))}


def _read(texts: Texts) -> Fields:
    document = from_yaml("\n".join(whole_lines(texts[""])))
    for name in _SIGMAS.values():
        field(document, name, (3,))
    for name in _NOISE if "imunoise" in document else ():
        field(document, f"imunoise.{name}", (3,))
    return {group: field(document, name, (3,)) * unit for name, (group, unit) in _STATES.items()}


KF_GINS: Final = Exporter(
    name="kf-gins",
    title="KF-GINS initial IMU errors",
    suffixes=(".yaml", ".yml"),
    formula="v = (y - bias) / (1 + scale), axis by axis",
    losses=(
        "misalignment of gyros and accelerometers: KF-GINS has no states for it",
        "correlations between the errors",
    ),
    advice=(
        "Copy the lines into the configuration; its filter goes on from these values with these standard deviations.",
        "Its IMU axes are forward, right, down: record the test in them, or turn the axes first (--map-gyro).",
        "gbstd and abstd are the bias instability of srt noise, where it was run; corrtime, gsstd and asstd are yours.",
    ),
    write=_write,
    read=_read,
    apply=each_sensor(lambda fields, s, y: (y - fields[f"{s}_bias"]) / (1.0 + fields[f"{s}_scale"])),
    within=None,
    options=frozenset({"inflate"}),
)
