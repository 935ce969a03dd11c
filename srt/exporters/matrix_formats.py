"""Formats that hold the matrices of the sensor model, or of its compensation.

Kalibr, ``measured = M true + b``, writes two files: the result of its model scale-misalignment, and NAME-imu.yaml, a
flat list of noise terms that its option ``--imu`` reads::

    a_m = M_a a_I + b_a        w_m = M_g C_gyro_i w_I + A C_gyro_i a_I + b_g

with M_a, M_g lower-triangular. That defines the axes I: ``Ma = M_a C_IB``, ``Mg C_IBᵀ = M_g C_gyro_i``. A is the gyro
g-sensitivity Γ in these axes, ``A = Γ C_IBᵀ C_gyro_iᵀ``. There is no field for biases: the programs that read the file
estimate them.

pyins: ``x_out = T x + b``, in any axes.

The others state ``true = M (measured − b)`` or ``true = M measured − b``.

OpenVINS: ``w_I = R_GYROtoIMU Dw (w_m − Tg a_I − b_g)``, ``a_I = R_ACCtoIMU Da (a_m − b_a)``; the file holds the
inverses Tw, Ta and the rotations from I. Tw and Ta are triangular; OpenVINS ignores the other entries, the reader here
refuses them. As both rotations are free, the file can state any axes. Tg is the gyro g-sensitivity Γ in the axes I:
Kalibr's A times C_gyro_i.

imucal: ``acc = R_a⁻¹ K_a⁻¹ (U − b_a)``, ``gyr = R_g⁻¹ K_g⁻¹ (U − K_ga acc − b_g)``, K diagonal and the rows of R of
unit length; m/s² and deg/s.

imu_tk: ``X' = T K (X − B)``, K diagonal, T of unit diagonal, upper-triangular for the accelerometers. This choice
decides the axes: ``Ma = (T K)⁻¹ C_IB``.

Basalt: ``cal = (I + S) raw − b``, S lower-triangular for the accelerometers; this choice decides the axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG
from srt.exceptions import InputError
from srt.exporters.export_model import DEFAULT_TOPIC, OPTIONS, comment, named, statement
from srt.exporters.file_format import (
    ABSENT,
    Exporter,
    each_sensor,
    field,
    from_json,
    from_yaml,
    heading,
    invertible,
    matrix,
    numbers,
    rows,
    solved,
    to_json,
    to_yaml,
    triangular,
    whole_lines,
)
from srt.exporters.linear_model import lower_rotation

if TYPE_CHECKING:
    from collections.abc import Collection

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


def _chain_fields(model: ExportModel) -> dict[str, object]:
    """Entries of ``imu0`` that Kalibr and OpenVINS share."""
    return {
        "T_i_b": np.eye(4).tolist(),
        **named(model, NOISE_NAMES),
        "rostopic": model.settings.topic or DEFAULT_TOPIC,
        "time_offset": 0.0,
    }


def _model_of_chain(document: dict[str, Any], known: Collection[str]) -> str:
    imu = document.get("imu0")
    if not isinstance(imu, dict):
        raise InputError(f"{ABSENT} imu0 in it: it was truncated, or is of another format.")
    model = str(imu.get("model"))
    if model not in known:
        expected = f"{'one of ' * (len(known) > 1)}{', '.join(known)}"
        raise InputError(f"the model of imu0 is {model[:40]!r}, but {expected} is expected: export that one.")
    return model


def _write_kalibr(model: ExportModel) -> dict[str, str]:
    M_g, C_gyro_i = lower_rotation(model.gyro.matrix)
    document = {
        "imu0": {
            **_chain_fields(model),
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
    _model_of_chain(document, (_KALIBR_MODEL,))
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
    advice=(
        "pyins has no file of its own: Parameters(**document['gyro']) simulates, EstimationModel.transform and .bias "
        "correct.",
    ),
    write=_write_pyins,
    read=_read_pyins,
    apply=each_sensor(lambda fields, sensor, y: solved(fields[f"{sensor}.transform"], y - fields[f"{sensor}.bias"])),
)


_TRIANGLES: Final = {"kalibr": "lower", "calibrated": "lower", "rpng": "upper"}


def _write_openvins(model: ExportModel) -> dict[str, str]:
    Tw, to_gyro = lower_rotation(model.gyro.matrix)
    Ta, to_accel = lower_rotation(model.accel.matrix)
    document = {
        "imu0": {
            **_chain_fields(model),
            "model": "kalibr",
            "Tw": Tw.tolist(),
            "R_IMUtoGYRO": to_gyro.tolist(),
            "Ta": Ta.tolist(),
            "R_IMUtoACC": to_accel.tolist(),
            "Tg": model.g_sensitivity.tolist(),
        }
    }
    return {"": to_yaml(document, "%YAML:1.0\n" + comment([*heading(OPENVINS, model), *statement(model)]))}


def _read_openvins(texts: Texts) -> Fields:
    document = from_yaml(texts[""])
    model = _model_of_chain(document, _TRIANGLES)
    fields = {"Tg": field(document, "imu0.Tg", (3, 3))}
    fields |= {name: matrix(document, name, "imu0.", triangle=_TRIANGLES[model]) for name in ("Tw", "Ta")}
    return fields | {name: matrix(document, name, "imu0.", turn=True) for name in ("R_IMUtoGYRO", "R_IMUtoACC")}


def _apply_openvins(fields: Fields, gyro: Array, accel: Array) -> tuple[Array, Array]:
    Dw, Da = np.linalg.inv(fields["Tw"]), np.linalg.inv(fields["Ta"])
    a = rows(fields["R_IMUtoACC"].T @ Da, accel)
    return rows(fields["R_IMUtoGYRO"].T @ Dw, gyro - rows(fields["Tg"], a)), a


OPENVINS: Final = Exporter(
    name="openvins",
    title="OpenVINS kalibr_imu_chain.yaml",
    suffixes=(".yaml", ".yml"),
    formula="a = R_IMUtoACC' inv(Ta) (a_m - b_a); w = R_IMUtoGYRO' inv(Tw) (w_m - Tg a - b_g); ' is the transpose",
    losses=(
        "biases: the file has no field for them, the filter estimates them",
        "the uncertainty of the intrinsics: OpenVINS starts each with a sigma of 1e-3 that no file sets",
    ),
    advice=(
        "Extrinsics (T_imu_cam) are those of these axes (line axes: of the file); estimate or turn them in the same.",
        "If it is to estimate the intrinsics (calib_imu_intrinsics), 1e-3 is far from the sigmas of this calibration: "
        "leave that off to keep these values, or set the prior in its source (State.cpp).",
    ),
    frames=("mars", "table", "accel"),
    triangle="lower",
    write=_write_openvins,
    read=_read_openvins,
    apply=_apply_openvins,
    biases=False,
    g_sensitivity=True,
    options=OPTIONS,
)

_IMUCAL_UNITS: Final = {"acc_unit": "m/s^2", "gyr_unit": "deg/s", "from_acc_unit": "m/s^2", "from_gyr_unit": "deg/s"}
_IMUCAL_SHAPES: Final = {
    "K_a": (3, 3), "R_a": (3, 3), "b_a": (3,), "K_g": (3, 3), "R_g": (3, 3), "K_ga": (3, 3), "b_g": (3,),
}  # fmt: skip


def _write_imucal(model: ExportModel) -> dict[str, str]:
    document: dict[str, object] = {**_IMUCAL_UNITS, "comment": "\n".join(heading(IMUCAL, model))}
    for letter, linear, unit in (("a", model.accel, 1.0), ("g", model.gyro, DEG)):
        size = np.linalg.norm(linear.matrix, axis=1)
        document[f"K_{letter}"] = np.diag(size).tolist()
        document[f"R_{letter}"] = (linear.matrix / size[:, None]).tolist()
        document[f"b_{letter}"] = (linear.bias / unit).tolist()
    document |= {"K_ga": (model.g_sensitivity / DEG).tolist(), "cal_type": "Ferraris", "_format_version": "2.0.0"}
    return {"": to_json(document)}


def _read_imucal(texts: Texts) -> Fields:
    document = from_json(texts[""])
    for name, expected in {"cal_type": ("Ferraris", "Turntable"), "_format_version": ("2.0.0", "2.0")}.items():
        if document.get(name) not in expected:
            raise InputError(f"its {name} is {str(document.get(name))[:40]!r}, but {expected[0]!r} is expected.")
    for name, unit in _IMUCAL_UNITS.items():
        if document.get(name) != unit:
            raise InputError(
                f"its {name} is {str(document.get(name))[:40]!r}, but {unit!r} is expected: calibrate it in that unit."
            )
    fields = {name: field(document, name, shape) for name, shape in _IMUCAL_SHAPES.items()}
    for name in ("K_a", "R_a", "K_g", "R_g"):
        invertible(fields[name], name)
    return fields


def _apply_imucal(fields: Fields, gyro: Array, accel: Array) -> tuple[Array, Array]:
    acc = rows(np.linalg.inv(fields["R_a"]) @ np.linalg.inv(fields["K_a"]), accel - fields["b_a"])
    offset = rows(fields["K_ga"], acc) + fields["b_g"]
    gyr = rows(np.linalg.inv(fields["R_g"]) @ np.linalg.inv(fields["K_g"]), gyro / DEG - offset)
    return gyr * DEG, acc


IMUCAL: Final = Exporter(
    name="imucal",
    title="imucal Ferraris calibration",
    suffixes=(".json",),
    formula="acc = inv(R_a) inv(K_a) (acc_m - b_a); gyr = inv(R_g) inv(K_g) (gyr_m - K_ga acc - b_g); m/s^2, deg/s",
    advice=("imucal takes and gives gyro readings in deg/s.",),
    g_sensitivity=True,
    write=_write_imucal,
    read=_read_imucal,
    apply=_apply_imucal,
)

_IMU_TK_PARTS: Final = {"_acc": "accel", "_gyro": "gyro"}


def _write_imu_tk(model: ExportModel) -> dict[str, str]:
    # The inverse of an upper-triangular matrix is upper-triangular too; only rounding is below the diagonal.
    corrections = {"_acc": np.triu(model.accel.inverse), "_gyro": model.gyro.inverse}
    biases = {"_acc": model.accel.bias, "_gyro": model.gyro.bias}
    out = {}
    for part, correction in corrections.items():
        scale = np.diag(correction)
        if not np.all(scale > 0.0):
            raise InputError("A gyro is turned by more than 90° against these axes, which imu_tk's form cannot state.")
        blocks = [correction / scale, np.diag(scale), biases[part][:, None]]
        out[part] = "\n".join("".join(" ".join(f"{v:.17g}" for v in row) + "\n" for row in b.tolist()) for b in blocks)
    return out


def _read_imu_tk(texts: Texts) -> Fields:
    fields: Fields = {}
    for part, name in _IMU_TK_PARTS.items():
        values = numbers(" ".join(whole_lines(texts[part])).split(), f"the file {part}", (21,))
        T, K = values[:9].reshape(3, 3), values[9:18].reshape(3, 3)
        if np.any(np.diag(T) != 1.0) or np.count_nonzero(K) != 3:
            raise InputError(f"the file {part} has not T of unit diagonal, then a diagonal K, then B: it was edited.")
        if part == "_acc":
            triangular(T, "T of the accelerometers", "upper")
        invertible(T @ K, f"T K of the file {part}")
        fields |= {f"T_{name}": T, f"K_{name}": K, f"B_{name}": values[18:]}
    return fields


IMU_TK: Final = Exporter(
    name="imu_tk",
    title="imu_tk pair of calibrations",
    suffixes=(".calib",),
    formula="X' = T K (X - B)",
    advice=("Two files, NAME_acc.calib and NAME_gyro.calib; they hold numbers alone. Readings in rad/s, m/s^2.",),
    frames=("accel",),
    triangle="upper",
    parts=tuple(_IMU_TK_PARTS),
    write=_write_imu_tk,
    read=_read_imu_tk,
    apply=each_sensor(lambda fields, s, y: rows(fields[f"T_{s}"] @ fields[f"K_{s}"], y - fields[f"B_{s}"])),
)

_LOWER_BY_COLUMNS: Final = ((0, 1, 2, 1, 2, 2), (0, 0, 0, 1, 1, 2))
"""Rows and columns of a lower triangle, column after column."""

_BASALT_NOISE: Final = {
    "rate_hz": "imu_update_rate",
    "accel_noise": "accel_noise_std",
    "gyro_noise": "gyro_noise_std",
    "accel_random_walk": "accel_bias_std",
    "gyro_random_walk": "gyro_bias_std",
}


def _write_basalt(model: ExportModel) -> dict[str, str]:
    S_a, S_g = model.accel.inverse - np.eye(3), model.gyro.inverse - np.eye(3)
    noise = named(model, _BASALT_NOISE)
    document = {
        "calib_accel_bias": [*(model.accel.inverse @ model.accel.bias).tolist(), *S_a[_LOWER_BY_COLUMNS].tolist()],
        "calib_gyro_bias": [*(model.gyro.inverse @ model.gyro.bias).tolist(), *S_g.T.ravel().tolist()],
        **{name: value if name == "imu_update_rate" else [value] * 3 for name, value in noise.items()},
    }
    head = [*heading(BASALT, model), *statement(model)]
    return {"": to_json({"comment": head, "value0": document})}


def _read_basalt(texts: Texts) -> Fields:
    document = from_json(texts[""])
    accel = field(document, "value0.calib_accel_bias", (9,))
    gyro = field(document, "value0.calib_gyro_bias", (12,))
    S_a = np.zeros((3, 3))
    S_a[_LOWER_BY_COLUMNS] = accel[3:]
    S_g = gyro[3:].reshape(3, 3).T
    for name, S in (("calib_accel_bias", S_a), ("calib_gyro_bias", S_g)):
        invertible(np.eye(3) + S, name)
    return {"S_accel": S_a, "b_accel": accel[:3], "S_gyro": S_g, "b_gyro": gyro[:3]}


BASALT: Final = Exporter(
    name="basalt",
    title="Basalt calibration, inertial part",
    suffixes=(".json",),
    formula="cal = (I + S) raw - b; 9 numbers b, S lower-triangular by columns; 12 numbers b, S by columns",
    advice=(
        "Copy the fields of value0 into the calibration of the cameras; this file alone is no whole calibration.",
        "Extrinsics change with the axes: T_imu_cam becomes [C 0; 0 1] T_imu_cam.",
    ),
    frames=("accel",),
    triangle="lower",
    write=_write_basalt,
    read=_read_basalt,
    apply=each_sensor(lambda fields, s, y: rows(np.eye(3) + fields[f"S_{s}"], y) - fields[f"b_{s}"]),
    options=OPTIONS - {"topic"},
)
