"""Every target's file opened by the target's own loader where it can be installed, and its arithmetic against ours.

``pytest tests/exporters/test_loaders.py -rP`` prints the table of docs/exports.md.
"""

import importlib
import json
from dataclasses import replace

import numpy as np
import pytest
from exporter_formulas import ASYMMETRY, EXACT, FORMULAS, SINGLE, TARGETS, biases_of, calibrated, mm, motion
from g_sensitive import with_g_sensitivity

from srt.exporters import ExportSettings, export, exporter, gtsam_preintegration, save
from srt.result.diagnostics import Diagnostics
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

AXES = "XYZ"
HELD = {
    "px4": ("gyro_bias", "accel_bias", "accel_scale"),
    "ardupilot": ("gyro_bias", "accel_bias", "accel_scale"),
    "gtsam": ("gyro_bias", "accel_bias"),
    "kf-gins": ("gyro_bias", "accel_bias", "gyro_scale", "accel_scale"),
}
"""Errors that a format holds, where it does not hold the whole linear part."""
G_SENSITIVITY = np.array([[2e-4, -5e-5, 1e-4], [3e-5, -1e-4, 8e-5], [-6e-5, 4e-5, 1.5e-4]])


def opencv(paths, w, f, calibration):
    cv2 = pytest.importorskip("cv2")
    storage = cv2.FileStorage(str(paths[0]), cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    node = storage.getNode("imu0")

    def matrix(name):
        rows = node.getNode(name)
        return np.array([[rows.at(i).at(j).real() for j in range(3)] for i in range(3)])

    # OpenVINS inverts Tw and Ta, and keeps the lower triangle of the model "kalibr".
    assert node.getNode("model").string() == "kalibr"
    Dw, Da = (np.tril(np.linalg.inv(matrix(name))) for name in ("Tw", "Ta"))
    bias = biases_of(calibration)
    a = mm(matrix("R_IMUtoACC").T @ Da, f - bias[1])
    return mm(matrix("R_IMUtoGYRO").T @ Dw, w - mm(matrix("Tg"), a) - bias[0]), a


def imucal(paths, w, f, _):
    package = pytest.importorskip("imucal")
    loaded = package.CalibrationInfo.from_json_file(paths[0])
    acc, gyr = loaded.calibrate(f, np.degrees(w), acc_unit="m/s^2", gyr_unit="deg/s")
    return np.radians(gyr), acc


def pyins(paths, w, f, _):
    pytest.importorskip("pyins")
    pandas, sensor = importlib.import_module("pandas"), importlib.import_module("pyins.inertial_sensor")
    document, out, dt = json.loads(paths[0].read_text()), [], 0.01
    for name, raw in (("gyro", w), ("accel", f)):
        model = sensor.EstimationModel()
        model.transform, model.bias = (np.array(document[name][key]) for key in ("transform", "bias"))
        frame = pandas.DataFrame(raw * dt, index=dt * np.arange(1, len(raw) + 1))
        out.append(model.correct_increments(np.full(len(raw), dt), frame).to_numpy() / dt)
        again = sensor.Parameters(**document[name]).apply(pandas.DataFrame(out[-1], index=frame.index), "rate")
        np.testing.assert_allclose(again.to_numpy(), raw, rtol=0, atol=EXACT)
    return tuple(out)


def gtsam(paths, w, f, calibration):
    package = pytest.importorskip("gtsam")
    document = json.loads(paths[0].read_text())
    bias = package.imuBias.ConstantBias(np.array(document["bias_accel"]), np.array(document["bias_gyro"]))
    _, ours = gtsam_preintegration(calibration, readings="raw")
    assert bias.equals(ours, 0.0)
    return np.array([bias.correctGyroscope(v) for v in w]), np.array([bias.correctAccelerometer(v) for v in f])


def ground_station(paths, w, f, _):
    """ArduPilot: pymavlink loads the file as the stations do that are built on it."""
    mavparm = pytest.importorskip("pymavlink.mavparm")
    found = mavparm.MAVParmDict()
    assert found.load(str(paths[0])) is not False
    return corrected(w, f, *([found[f"INS_{name}_{x}"] for x in AXES] for name in ("GYROFFS", "ACCOFFS", "ACCSCAL")))


def parameter_messages(paths, w, f, _):
    """PX4: rows of QGroundControl's format; each goes to the vehicle in a PARAM_SET of pymavlink."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common")
    link, found = mavlink.MAVLink(None), {}
    for line in paths[0].read_text().splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert int(kind) == mavlink.MAV_PARAM_TYPE_REAL32
        sent = link.param_set_encode(int(vehicle), int(component), name.encode(), float(value), int(kind)).pack(link)
        (message,) = mavlink.MAVLink(None).parse_buffer(bytearray(sent))
        found[message.param_id] = message.param_value
    names = ("CAL_GYRO0_{}OFF", "CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE")
    return corrected(w, f, *([found[name.format(x)] for x in AXES] for name in names))


def corrected(w, f, gyro_offset, offset, scale):
    gyro_offset, offset, scale = (np.array(v, dtype=np.float32).astype(float) for v in (gyro_offset, offset, scale))
    return w - gyro_offset, (f - offset) * scale


LOADERS = {
    "kalibr": ("PyYAML, which Kalibr loads with; Kalibr not installable", None),
    "openvins": ("cv2.FileStorage, which OpenVINS loads with; OpenVINS not installable", opencv),
    "basalt": ("JSON; cereal and Basalt not installable", None),
    "imucal": ("imucal", imucal),
    "imu_tk": ("text; imu_tk not installable", None),
    "pyins": ("pyins", pyins),
    "vectornav": ("text and checksum; the unit", None),
    "px4": ("rows of QGroundControl, sent by pymavlink", parameter_messages),
    "ardupilot": ("pymavlink", ground_station),
    "ros2": ("PyYAML; rcl not installable", None),
    "c-header": ("C compiler", None),
    "gtsam": ("gtsam", gtsam),
    "kf-gins": ("PyYAML; yaml-cpp not installable", None),
}
"""Loader by target, and its function; None: by the formula typed from the target's own statement."""


def unit(target, rng):
    """Unit with random errors of every kind that the format holds."""
    holds = exporter(target).g_sensitivity
    diagnostics = with_g_sensitivity(G_SENSITIVITY) if holds else Diagnostics()
    errors = calibrated(rng).errors.vector
    if target in HELD:
        kept = np.zeros(N_PARAMETERS, dtype=bool)
        for group in HELD[target]:
            kept[GROUP_SLICES[group]] = True
        errors = np.where(kept, errors, 0.0)
    assert not errors[ASYMMETRY].any()
    return replace(calibrated(rng, diagnostics=diagnostics), errors=SensorErrors(errors))


@pytest.mark.parametrize("target", TARGETS)
def test_the_loader_of_each_target_and_its_residual(target, tmp_path):
    rng = np.random.default_rng(50)
    title, load = LOADERS[target]
    worst = 0.0
    for _ in range(5):
        calibration, readings = unit(target, rng), motion(rng)
        made = export(calibration, target, readings=readings, settings=ExportSettings())
        paths = save(made, tmp_path / f"unit{made.format.suffixes[0]}")
        if load is None:
            texts = {part: p.read_bytes().decode() for part, p in zip(made.texts, paths, strict=True)}
            found = FORMULAS[target](texts, readings.gyro, readings.accel, biases_of(calibration))
        else:
            found = load(paths, readings.gyro, readings.accel, calibration)
        expected = (mm(made.C_FB, v) for v in calibration.apply(readings.gyro, readings.accel))
        worst = max(worst, *(float(np.abs(a - b).max()) for a, b in zip(found, expected, strict=True)))
    # Single precision: twelve constants of at most 1/0.6, times readings of 33 m/s² on three axes.
    single = target in ("vectornav", "px4", "ardupilot")
    assert worst < (SINGLE * 3.0 * (33.0 / 0.6 + 0.1 / 0.6) if single else EXACT)
    print(f"{target}: {title}: residual {worst:.1e}")
