"""Parameter files: registers of a VectorNav unit, parameters of autopilots and of ROS 2 nodes, errors for KF-GINS.

VectorNav, registers 84 (gyro) and 25 (accelerometer): ``X = C (A − B)``, on top of the factory's own calibration;
single precision inside the unit.

PX4: ``a = (raw − off) ∘ scale``, ``w = raw − off``; ArduPilot the same. Neither has scale factors for gyros nor
misalignment at all. The three accelerometer factors are the best that factors can be for forces of all directions
alike: row i of Ma being m, ``scale_i = m_i / |m|²``.

ROS 2: no package defines such a file; this one holds all parameters, asymmetry included.

KF-GINS (loosely coupled navigation) corrects increments by ``dtheta = (dtheta − gyrbias dt) / (1 + gyrscale)`` axis by
axis, and estimates both from their initial values on, with the standard deviations and the noise that the file states.
Units: °/h, mGal, ppm, °/√h and m/s/√h. The section is part of a complete configuration.
"""

from __future__ import annotations

import functools
import operator
import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, HOUR_S
from srt.exceptions import InputError
from srt.exporters.export_model import comment, known_figures, worst_bias_instability
from srt.exporters.file_format import (
    SINGLE,
    Exporter,
    each_sensor,
    field,
    from_yaml,
    heading,
    invertible,
    matrix,
    numbers,
    rows,
    single,
    to_yaml,
    whole_lines,
)
from srt.exporters.linear_model import axis_factors
from srt.model.sensor_model import Triad, accel_triad, gyro_triad
from srt.recording import autopilots
from srt.recording.applied import AppliedCorrection
from srt.sensor_errors import GROUP_SLICES

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.exporters.export_model import ExportModel
    from srt.exporters.file_format import Fields, Texts
    from srt.recording.autopilots import Autopilot, Slots
    from srt.types import Array

_REGISTERS: Final = {"gyro": 84, "accel": 25}
_COMMAND: Final = re.compile(r"\$(VN[WR]RG,(\d+),([^*$]*))\*([0-9A-Fa-f]{2}|XX)")


def checksum(text: str) -> str:
    """8-bit checksum of the text between $ and *, as two hexadecimal digits."""
    return f"{functools.reduce(operator.xor, text.encode('ascii'), 0):02X}"


def _write_vectornav(model: ExportModel) -> dict[str, str]:
    lines = []
    for sensor, linear in (("gyro", model.gyro), ("accel", model.accel)):
        values = [*linear.inverse.ravel().tolist(), *linear.bias.tolist()]
        # Twelve decimals are finer than single precision for all but the very smallest biases, and need no exponent.
        body = ",".join(["VNWRG", str(_REGISTERS[sensor]), *(f"{value:.12f}" for value in values)])
        lines.append(f"${body}*{checksum(body)}\r\n")
    return {"": "".join(lines)}


def _read_vectornav(texts: Texts) -> Fields:
    found = {}
    for line in texts[""].split():
        match = _COMMAND.fullmatch(line)
        if match is None:
            raise InputError(
                f"the line {line[:40]!r} is no whole command or answer ($VNWRG, $VNRRG): it was truncated."
            )
        body, register, values, total = match.groups()
        if total.upper() not in ("XX", checksum(body)):
            raise InputError(f"the checksum of register {register} is {total}, not {checksum(body)}: it was edited.")
        found[int(register)] = values.split(",")
    fields = {}
    for sensor, register in _REGISTERS.items():
        values = single(numbers(found.get(register, []), f"register {register}", (12,)))
        fields[f"C_{sensor}"] = invertible(values[:9].reshape(3, 3), f"C of register {register}")
        fields[f"B_{sensor}"] = values[9:]
    return fields


VECTORNAV: Final = Exporter(
    name="vectornav",
    title="VectorNav compensation registers",
    suffixes=(".txt",),
    formula="X = C (A - B)",
    losses=("digits: the unit keeps single precision",),
    advice=(
        "It works on top of the factory calibration, and replaces what the registers held in the test.",
        "Send both lines, then the command that writes settings to flash memory.",
    ),
    write=_write_vectornav,
    read=_read_vectornav,
    apply=each_sensor(lambda fields, sensor, y: rows(fields[f"C_{sensor}"], y - fields[f"B_{sensor}"])),
    within=SINGLE,
    find_applied="send $VNRRG,25*XX and $VNRRG,84*XX to the unit and save its two answers",
)

_OFFSET_LIMIT: Final = 3.5
_SCALE_LIMITS: Final = (0.8, 1.2)
"""ArduPilot's stated ranges of INS_ACCOFFS (m/s²) and INS_ACCSCAL."""


def _chosen_slots(model: ExportModel, autopilot: Autopilot) -> Slots:
    """Instance of the settings, else that of the log. Raises InputError if the two differ or there is none such."""
    of_log = None if model.applied is None else model.applied.instance
    stated = model.settings.instance
    if None not in (stated, of_log) and stated != of_log:
        raise InputError(f"The log is of IMU {of_log}, but instance {stated} is asked for: leave it out.")
    instance = stated if stated is not None else of_log or 0
    if instance >= autopilot.instances:
        raise InputError(
            f"The instance is {instance}, but {autopilot.title} has parameters for 0 to {autopilot.instances - 1}: "
            "give one of these."
        )
    return (instance, instance) if model.applied is None or of_log is None else model.applied.slots


def _ids(model: ExportModel, autopilot: Autopilot) -> dict[str, int]:
    """Parameters that identify the devices, as far as the log states them."""
    if model.applied is None:
        return {}
    names = autopilot.ids(_chosen_slots(model, autopilot))
    values = (model.applied.gyro_id, model.applied.accel_id)
    return {name: value for name, value in zip(names, values, strict=True) if value is not None}


def _parameter_values(model: ExportModel) -> dict[str, Array]:
    values = {
        "accel_offset": single(model.accel.bias),
        "accel_scale": single(axis_factors(model.accel.matrix)),
        "gyro_offset": single(model.gyro.bias),
    }
    if not np.all(values["accel_scale"] > 0.0):
        raise InputError("An accelerometer is turned by more than 90°, which three scale factors cannot state.")
    return values


def _write_px4(model: ExportModel) -> dict[str, str]:
    names, values = autopilots.PX4.names(_chosen_slots(model, autopilots.PX4)), _parameter_values(model)
    # Vehicle, component, name, value, type 9: float, type 6: 32-bit integer.
    lines = [
        f"1\t1\t{name}\t{value:.18f}\t9\n"
        for key in values
        for name, value in zip(names[key], values[key].tolist(), strict=True)
    ]
    for name, number in _ids(model, autopilots.PX4).items():
        lines.append(f"1\t1\t{name}\t{number - (number >> 31 << 32)}\t6\n")
    head = [*heading(PX4, model), "", "Vehicle-Id Component-Id Name Value Type"]
    return {"": comment(head) + "".join(sorted(lines))}


def _write_ardupilot(model: ExportModel) -> dict[str, str]:
    names, values = autopilots.ARDUPILOT.names(_chosen_slots(model, autopilots.ARDUPILOT)), _parameter_values(model)
    for key in ("accel_offset", "gyro_offset"):
        if not values[key].any():
            raise InputError(
                f"The {key.replace('_', ' ')}s are all zero, which ArduPilot takes for a unit never calibrated: leave "
                "its own calibration in place."
            )
    worst = float(np.abs(values["accel_offset"]).max())
    low, high = float(values["accel_scale"].min()), float(values["accel_scale"].max())
    if worst > _OFFSET_LIMIT or low < _SCALE_LIMITS[0] or high > _SCALE_LIMITS[1]:
        raise InputError(
            f"The accelerometer offsets reach {worst:.3g} m/s² and the scales {low:.3g} to {high:.3g}, but ArduPilot's "
            f"parameters go to {_OFFSET_LIMIT} m/s² and from {_SCALE_LIMITS[0]} to {_SCALE_LIMITS[1]}: correct the "
            "readings before they reach it."
        )
    lines = [
        f"{name},{value:.9g}\n" for key in values for name, value in zip(names[key], values[key].tolist(), strict=True)
    ]
    lines += [f"{name},{number}\n" for name, number in _ids(model, autopilots.ARDUPILOT).items()]
    return {"": comment(heading(ARDUPILOT, model)) + "".join(lines)}


def parameter_values(text: str) -> dict[str, float]:
    """Parameters of an autopilot by name, from lines "NAME,VALUE", "NAME VALUE" or those of QGroundControl.

    Raises InputError: a line that is no parameter.
    """
    found = {}
    for line in whole_lines(text):
        words = line.replace(",", " ").split()
        if line.startswith("#") or not words:
            continue
        name, value = words[2:4] if len(words) == 5 else words if len(words) == 2 else ("", "")
        try:
            found[name] = float(value)
        except ValueError:
            raise InputError(f"the line {line[:40]!r} is no parameter: it was truncated.") from None
    return found


def _reader(autopilot: Autopilot) -> Callable[[Texts], Fields]:
    def read(texts: Texts) -> Fields:
        found = parameter_values(texts[""])
        fields = {}
        for key in autopilot.names((0, 0)):
            groups = [autopilot.names((n, n))[key] for n in range(autopilot.instances)]
            group = next((each for each in groups if each[0] in found), None)
            if group is None:
                raise InputError(f"there is no {groups[0][0]} in it: it was truncated, or is of another format.")
            fields[key] = single(numbers([found.get(name) for name in group], group[0], (3,)))
        return fields

    return read


def _apply_parameters(fields: Fields, gyro: Array, accel: Array) -> tuple[Array, Array]:
    return gyro - fields["gyro_offset"], (accel - fields["accel_offset"]) * fields["accel_scale"]


_DEAD_BAND: Final = 0.01
"""Length of a change of offsets (m/s², rad/s) or scales that some releases of PX4 ignore; others have 0.001."""


def _px4_limits(model: ExportModel, fields: Fields) -> tuple[str, ...]:
    """Groups of parameters that a release with the dead band would not take over."""
    applied = model.applied or AppliedCorrection("px4")
    before = {
        "accel_offset": applied.accel_offset,
        "accel_scale": np.diag(applied.accel_matrix),
        "gyro_offset": applied.gyro_offset,
    }
    defaults = {"accel_offset": 0.0, "accel_scale": 1.0, "gyro_offset": 0.0}
    out = []
    for key, values in fields.items():
        change, total = (float(np.linalg.norm(values - old)) for old in (before[key], defaults[key]))
        if change <= _DEAD_BAND:
            advice = "restart after loading" if total > _DEAD_BAND else "that holds after a restart, too"
            out.append(
                f"The {key.replace('_', ' ')} changes by {change:.2g}: releases of PX4 that skip changes of at most "
                f"{_DEAD_BAND:g} ignore it ({advice})."
            )
    return (*out, *_id_limits(model, autopilots.PX4))


def _id_limits(model: ExportModel, autopilot: Autopilot) -> tuple[str, ...]:
    names = autopilot.ids(_chosen_slots(model, autopilot))
    missing = [name for name in names if name not in _ids(model, autopilot)]
    if not missing:
        return ()
    return (f"{' and '.join(missing)} must be those of the devices: calibrate once with the ground station first.",)


_AUTOPILOT_LOSSES: Final = (
    "gyro scale factors: there are no parameters for them",
    "misalignment of gyros and accelerometers: likewise",
    "digits: parameters are single precision",
)

PX4: Final = Exporter(
    name="px4",
    title="PX4 parameters",
    suffixes=(".params",),
    formula="a = (raw - OFF) SCALE; w = raw - OFF, axis by axis",
    losses=_AUTOPILOT_LOSSES,
    advice=("Temperature compensation (TC_...) works before these offsets: leave it as it was in the test.",),
    write=_write_px4,
    read=_reader(autopilots.PX4),
    apply=_apply_parameters,
    within=None,
    options=frozenset({"instance"}),
    find_applied=autopilots.PX4.advice,
    limits=_px4_limits,
)

ARDUPILOT: Final = Exporter(
    name="ardupilot",
    title="ArduPilot parameters",
    suffixes=(".param", ".parm"),
    formula="a = (raw - ACCOFFS) ACCSCAL; w = raw - GYROFFS, axis by axis",
    losses=_AUTOPILOT_LOSSES,
    advice=(
        "Older versions scaled before they subtracted: see that yours subtracts first.",
        "With INS_GYR_CAL other than 0 the gyro offsets are measured anew at each start.",
    ),
    write=_write_ardupilot,
    read=_reader(autopilots.ARDUPILOT),
    apply=_apply_parameters,
    within=None,
    options=frozenset({"instance"}),
    find_applied=autopilots.ARDUPILOT.advice,
    limits=lambda model, fields: _id_limits(model, autopilots.ARDUPILOT),  # noqa: ARG005
)

_ROS2: Final = "/**"
_SENSORS: Final = {"gyro": gyro_triad, "accel": accel_triad}


def _write_ros2(model: ExportModel) -> dict[str, str]:
    sensors: dict[str, Any] = {}
    for sensor, triad_of in _SENSORS.items():
        triad = triad_of(model.calibration.errors)
        sensors[sensor] = {
            "matrix": triad.matrix.ravel().tolist(),
            "asymmetry": triad.asymmetry.tolist(),
            "bias": triad.bias.tolist(),
            "correction": (model.C_FB @ np.linalg.inv(triad.matrix)).ravel().tolist(),
        }
    document = {
        _ROS2: {
            "ros__parameters": {
                "imu_calibration": {
                    "formula": ROS2.formula,
                    "axes": model.frame,
                    "rotation": model.C_FB.ravel().tolist(),
                    "g_sensitivity": (model.g_sensitivity @ model.C_FB).ravel().tolist(),
                    **sensors,
                }
            }
        }
    }
    return {"": to_yaml(document, comment([*heading(ROS2, model), "Matrices by rows."]))}


def _read_ros2(texts: Texts) -> Fields:
    document = from_yaml(texts[""])
    at = f"{_ROS2}.ros__parameters.imu_calibration"
    fields = {"rotation": matrix(document, "rotation", f"{at}.", turn=True, flat=True)}
    fields["g_sensitivity"] = field(document, f"{at}.g_sensitivity", (9,)).reshape(3, 3)
    for sensor in _SENSORS:
        M = matrix(document, f"{sensor}.matrix", f"{at}.", flat=True)
        correction = field(document, f"{at}.{sensor}.correction", (9,)).reshape(3, 3)
        if np.abs(correction @ M - fields["rotation"]).max() > 1e-9:
            raise InputError(
                f"{sensor}.correction is not rotation times the inverse of {sensor}.matrix: it was edited."
            )
        fields[f"{sensor}.matrix"] = M
        for name in ("asymmetry", "bias"):
            fields[f"{sensor}.{name}"] = field(document, f"{at}.{sensor}.{name}", (3,))
    return fields


def _apply_ros2(fields: Fields, gyro: Array, accel: Array) -> tuple[Array, Array]:
    triads = [Triad(fields[f"{s}.matrix"], fields[f"{s}.asymmetry"], fields[f"{s}.bias"]) for s in _SENSORS]
    force = triads[1].compensate(accel)
    rate = triads[0].compensate(gyro - rows(fields["g_sensitivity"], force))
    return rows(fields["rotation"], rate), rows(fields["rotation"], force)


ROS2: Final = Exporter(
    name="ros2",
    title="ROS 2 parameter file",
    suffixes=(".yaml", ".yml"),
    formula="solve y = matrix v + asymmetry |v| + bias for v (gyros: y - g_sensitivity a), then rotation v",
    advice=(
        "No package defines such parameters: a node of your own declares imu_calibration.gyro.matrix and so on.",
        "The parameters are given to every node (/**).",
    ),
    write=_write_ros2,
    read=_read_ros2,
    apply=_apply_ros2,
    asymmetry=True,
    g_sensitivity=True,
)


_MGAL: Final = 1e-5
"""m/s² per mGal."""
_PPM: Final = 1e-6
_METRE_PER_SQRT_H: Final = HOUR_S**-0.5
"""m/s/√s per m/s/√h."""

_KF_STATES: Final = {
    "initgyrbias": ("initbgstd", "gyro_bias", DEG_PER_H),
    "initaccbias": ("initbastd", "accel_bias", _MGAL),
    "initgyrscale": ("initsgstd", "gyro_scale", _PPM),
    "initaccscale": ("initsastd", "accel_scale", _PPM),
}
"""Initial errors: name of the standard deviations, group of parameters, unit."""
_KF_NOISE: Final = {"arw": ("gyro_noise", DEG_PER_SQRT_H), "vrw": ("accel_noise", _METRE_PER_SQRT_H)}
_KF_DRIFTS: Final = {"gbstd": ("gyro", DEG_PER_H), "abstd": ("accel", _MGAL)}


def _initial_errors(model: ExportModel) -> dict[str, Array]:
    """Initial states, SI; the scale factors are those with the least error over all directions."""
    scales = {
        f"{sensor}_scale": 1.0 / axis_factors(getattr(model, sensor).matrix) - 1.0 for sensor in ("gyro", "accel")
    }
    if min(float(v.min()) for v in scales.values()) <= -1.0:
        raise InputError("A sensor is turned by more than 90°, which three scale factors cannot state.")
    return {"gyro_bias": model.gyro.bias, "accel_bias": model.accel.bias, **scales}


def _write_kf_gins(model: ExportModel) -> dict[str, str]:
    values = _initial_errors(model)
    document: dict[str, Any] = {name: (values[group] / unit).tolist() for name, (_, group, unit) in _KF_STATES.items()}
    P = model.calibration.covariance
    for sigma_name, group, unit in _KF_STATES.values():
        block = P[GROUP_SLICES[group], GROUP_SLICES[group]]
        # The squares of the rotation: scale factors of turned axes mix as the squares of the direction cosines do.
        turned = (
            model.C_FB @ block @ model.C_FB.T if group.endswith("bias") else model.C_FB**2 @ block @ (model.C_FB**2).T
        )
        document[sigma_name] = (np.sqrt(np.maximum(np.diag(turned), 0.0)) / unit).tolist()
    figures = known_figures(model)
    noise: dict[str, Any] = {
        name: [figures[key] / unit] * 3 for name, (key, unit) in _KF_NOISE.items() if key in figures
    }
    for name, (sensor, unit) in _KF_DRIFTS.items():
        found = worst_bias_instability(model, sensor)
        if found is not None:
            noise[name] = [found / unit] * 3
    if noise:
        document["imunoise"] = noise
    return {"": to_yaml(document, comment(heading(KF_GINS, model)))}


def _read_kf_gins(texts: Texts) -> Fields:
    document = from_yaml("\n".join(whole_lines(texts[""])))
    for name, *_ in _KF_STATES.values():
        field(document, name, (3,))
    for name in _KF_NOISE if "imunoise" in document else ():
        field(document, f"imunoise.{name}", (3,))
    return {group: field(document, name, (3,)) * unit for name, (_, group, unit) in _KF_STATES.items()}


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
    write=_write_kf_gins,
    read=_read_kf_gins,
    apply=each_sensor(lambda fields, s, y: (y - fields[f"{s}_bias"]) / (1.0 + fields[f"{s}_scale"])),
    within=None,
    options=frozenset({"inflate"}),
)
