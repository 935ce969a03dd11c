"""Formats that state the sensor model: ``measured = M true + b``.

Kalibr writes two files: the result of its model scale-misalignment, and NAME-imu.yaml, a flat list of noise terms that
its option ``--imu`` reads::

    a_m = M_a a_I + b_a        w_m = M_g C_gyro_i w_I + A C_gyro_i a_I + b_g

with M_a, M_g lower-triangular. That defines the axes I: ``Ma = M_a C_IB``, ``Mg C_IBᵀ = M_g C_gyro_i``. A is the gyro
g-sensitivity Γ in these axes, ``A = Γ C_IBᵀ C_gyro_iᵀ``. There is no field for biases: the programs that read the file
estimate them.

pyins: ``x_out = T x + b``, in any axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.exporters.export_model import comment
from srt.exporters.file_format import (
    Exporter,
    each_sensor,
    field,
    from_json,
    from_yaml,
    heading,
    matrix,
    rows,
    solved,
    to_json,
    to_yaml,
)
from srt.exporters.linear_model import lower_rotation
from srt.exporters.noise_fields import DEFAULT_TOPIC, OPTIONS, named, statement

if TYPE_CHECKING:
    from srt.exporters.export_model import ExportModel
    from srt.exporters.file_format import Fields, Texts
    from srt.types import Array


_KALIBR_MODEL: Final = "scale-misalignment"
_KALIBR_INPUT: Final = "-imu"
"""Suffix of the second file, which holds only noise densities, random walks, topic and rate."""

NOISE_NAMES: Final = {
    "accel_noise": "accelerometer_noise_density",
    "accel_random_walk": "accelerometer_random_walk",
    "gyro_noise": "gyroscope_noise_density",
    "gyro_random_walk": "gyroscope_random_walk",
    "rate_hz": "update_rate",
}


def chain_fields(model: ExportModel) -> dict[str, object]:
    """Entries of ``imu0`` that Kalibr and OpenVINS share."""
    return {
        "T_i_b": np.eye(4).tolist(),
        **named(model, NOISE_NAMES),
        "rostopic": model.settings.topic or DEFAULT_TOPIC,
        "time_offset": 0.0,
    }


def _write_kalibr(model: ExportModel) -> dict[str, str]:
    M_g, C_gyro_i = lower_rotation(model.gyro.matrix)
    document = {
        "imu0": {
            **chain_fields(model),
            "model": _KALIBR_MODEL,
            # The axes make it lower-triangular; tril removes what rounding leaves above the diagonal.
            "accelerometers": {"M": np.tril(model.accel.matrix).tolist()},
            "gyroscopes": {
                "M": M_g.tolist(),
                "A": (model.g_sensitivity @ C_gyro_i.T).tolist(),
                "C_gyro_i": C_gyro_i.tolist(),
            },
        }
    }
    flat = {**named(model, NOISE_NAMES), "rostopic": model.settings.topic or DEFAULT_TOPIC}
    head = comment([*heading(KALIBR, model), *statement(model)])
    return {"": to_yaml(document, head), _KALIBR_INPUT: to_yaml(flat, head)}


def _read_kalibr(texts: Texts) -> Fields:
    document = from_yaml(texts[""])
    imu = document.get("imu0")
    model = imu.get("model") if isinstance(imu, dict) else None
    if model != _KALIBR_MODEL:
        raise InputError(f"the model of imu0 is {str(model)[:40]!r}, but {_KALIBR_MODEL!r} is read: export that one.")
    return {
        "M_a": matrix(document, "accelerometers.M", "imu0.", triangle="lower"),
        "M_g": matrix(document, "gyroscopes.M", "imu0.", triangle="lower"),
        "A": field(document, "imu0.gyroscopes.A", (3, 3)),
        "C_gyro_i": matrix(document, "gyroscopes.C_gyro_i", "imu0.", turn=True),
    }


def _apply_kalibr(fields: Fields, gyro: Array, accel: Array) -> tuple[Array, Array]:
    a, C = solved(fields["M_a"], accel), fields["C_gyro_i"]
    in_gyro_axes = solved(fields["M_g"], gyro - rows(fields["A"] @ C, a))
    return rows(C.T, in_gyro_axes), a


KALIBR: Final = Exporter(
    name="kalibr",
    title="Kalibr IMU file (scale-misalignment)",
    suffixes=(".yaml", ".yml"),
    formula="a_m = M_a a + b_a; w_m = M_g C_gyro_i w + A C_gyro_i a + b_g",
    losses=("biases: the file has no field for them; programs that read it estimate them",),
    advice=(
        "Give NAME-imu.yaml to the option --imu; the other file has the form of Kalibr's result.",
        "Extrinsics change with the axes: T_cam_imu becomes T_cam_imu [C' 0; 0 1], C' the transpose of C.",
    ),
    companions=(_KALIBR_INPUT,),
    frames=("accel",),
    triangle="lower",
    write=_write_kalibr,
    read=_read_kalibr,
    apply=_apply_kalibr,
    biases=False,
    g_sensitivity=True,
    options=OPTIONS,
)

_SENSORS: Final = ("gyro", "accel")


def _write_pyins(model: ExportModel) -> dict[str, str]:
    return {
        "": to_json(
            {
                "comment": heading(PYINS, model),
                **{
                    name: {"transform": linear.matrix.tolist(), "bias": linear.bias.tolist()}
                    for name, linear in zip(_SENSORS, (model.gyro, model.accel), strict=True)
                },
            }
        )
    }


def _read_pyins(texts: Texts) -> Fields:
    document = from_json(texts[""])
    fields = {}
    for sensor in _SENSORS:
        fields[f"{sensor}.transform"] = matrix(document, f"{sensor}.transform")
        fields[f"{sensor}.bias"] = field(document, f"{sensor}.bias", (3,))
    return fields


PYINS: Final = Exporter(
    name="pyins",
    title="pyins inertial sensor parameters",
    suffixes=(".json",),
    formula="x_out = transform x + bias",
    losses=(),
    advice=(
        "pyins has no file of its own: Parameters(**document['gyro']) simulates, EstimationModel.transform and .bias "
        "correct.",
    ),
    frames=("mars", "table"),
    write=_write_pyins,
    read=_read_pyins,
    apply=each_sensor(lambda fields, sensor, y: solved(fields[f"{sensor}.transform"], y - fields[f"{sensor}.bias"])),
)
