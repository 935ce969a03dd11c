"""Parameters found from a log replace those that the log was made under, and so are composed with them.

The autopilots here are typed from their sources, with orientations by pymavlink; pyulog and pymavlink write the logs.
"""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import foreign_files as ff
import numpy as np
import pytest

import sims
import srt
from srt.constants import MICRO_G
from srt.exporters import ExportSettings, export
from srt.exporters.applied_file import applied_of
from srt.recording import autopilots
from srt.recording.applied import AppliedCorrection, applied_correction
from srt.sensor_errors import SensorErrors

pytest.importorskip("pyulog")
mavutil = pytest.importorskip("pymavlink.mavutil")


SITE = srt.Site(9.80665, latitude_rad=0.8)
OFFSET = np.array([0.35, -0.52, 0.21])
SCALE = np.array([0.981, 1.027, 1.009])
GYRO_OFFSET = np.array([0.011, -0.017, 0.006])
IDS = {"gyro": 2818058, "accel": 2753036}
AXES = "XYZ"
ASYMMETRIC = np.array(["asymmetry" in name for name in srt.sensor_errors.NAMES])
# Half a unit in the last place of single precision: what each parameter loses.
SINGLE = 2.0**-24


def mavlink_orientation(number):
    """Matrix of an orientation by the name that pymavlink gives it."""
    from pymavlink.rotmat import Matrix3

    name = mavutil.mavlink.enums["MAV_SENSOR_ORIENTATION"][number].name
    angle = {axis: float(degrees) for axis, degrees in re.findall(r"(ROLL|PITCH|YAW)_(\d+)", name)}
    matrix = Matrix3()
    matrix.from_euler(*(np.radians(angle.get(axis, 0.0)) for axis in ("ROLL", "PITCH", "YAW")))
    return np.array([[row.x, row.y, row.z] for row in (matrix.a, matrix.b, matrix.c)])


@pytest.mark.parametrize("number", [n for n in range(41) if n != 38])
def test_orientations_are_those_of_mavlink(number):
    # Sums of two products of sines and cosines, each rounded to 1.1e-16.
    np.testing.assert_allclose(autopilots.orientation(number, "ROT"), mavlink_orientation(number), rtol=0, atol=5e-16)


def test_the_orientation_whose_name_is_rounded():
    # ROLL_90_PITCH_68_YAW_293: the autopilots' sources have 68.8° and 293.3°.
    turn = autopilots.orientation(38, "ROT") @ mavlink_orientation(38).T
    assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) < 1.0
    with pytest.raises(srt.InputError, match="0 to 40"):
        autopilots.orientation(41, "AHRS_ORIENTATION")


class Px4:
    """Accelerometers of the second slot with gyros of the third."""

    name = "px4"
    log = "a.ulg"
    suffix = ".params"
    level = np.array([1.2, -0.7, 2.0])
    C = np.array(mavlink_orientation(10))
    # Matrix of the level adjustment, roll, pitch, yaw about fixed axes in this order.
    cx, cy, cz = np.cos(np.radians(level))
    sx, sy, sz = np.sin(np.radians(level))
    C = (
        np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        @ C
    )
    parameters: ClassVar = {
        "SENS_BOARD_ROT": 10,
        **{f"SENS_BOARD_{axis}_OFF": float(value) for axis, value in zip(AXES, level, strict=True)},
        **{f"CAL_ACC1_{axis}OFF": float(value) for axis, value in zip(AXES, OFFSET, strict=True)},
        **{f"CAL_ACC1_{axis}SCALE": float(value) for axis, value in zip(AXES, SCALE, strict=True)},
        **{f"CAL_GYRO2_{axis}OFF": float(value) for axis, value in zip(AXES, GYRO_OFFSET, strict=True)},
        **{f"CAL_ACC0_{axis}OFF": 9.0 for axis in AXES},
        "CAL_ACC0_ID": 77, "CAL_GYRO0_ID": 78,
        "CAL_ACC1_ID": IDS["accel"], "CAL_GYRO2_ID": IDS["gyro"],
    }  # fmt: skip

    @classmethod
    def write(cls, path, time, values):
        us = np.round(time * 1e6).astype(np.uint64) + np.uint64(10**6)
        selected = {"timestamp": us[:1], "accel_device_id": [IDS["accel"]], "gyro_device_id": [IDS["gyro"]]}
        topics = [
            ("sensor_combined", 0, ff.COMBINED, ff.combined(us, values)),
            ("sensor_selection", 0, ff.SELECTION, selected),
        ]
        ff.write_ulog(path, topics, cls.parameters)

    @staticmethod
    def loaded(text):
        """The parameters of a file as a ground station reads it: type 9 is a float, 6 an integer."""
        rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
        found = {row[2]: (int if row[4] == "6" else np.float32)(row[3]) for row in rows}
        assert (found["CAL_ACC1_ID"], found["CAL_GYRO2_ID"]) == (IDS["accel"], IDS["gyro"])
        return [
            np.array([found[f"CAL_{name.format(axis)}"] for axis in AXES], dtype=float)
            for name in ("GYRO2_{}OFF", "ACC1_{}OFF", "ACC1_{}SCALE")
        ]


class ArduPilot:
    name = "ardupilot"
    log = "a.bin"
    suffix = ".param"
    C = np.array(mavlink_orientation(14))
    parameters: ClassVar = {
        "AHRS_ORIENTATION": 14,
        **{f"INS_ACCOFFS_{axis}": float(value) for axis, value in zip(AXES, OFFSET, strict=True)},
        **{f"INS_ACCSCAL_{axis}": float(value) for axis, value in zip(AXES, SCALE, strict=True)},
        **{f"INS_GYROFFS_{axis}": float(value) for axis, value in zip(AXES, GYRO_OFFSET, strict=True)},
        "INS_ACC_ID": IDS["accel"], "INS_GYR_ID": IDS["gyro"],
    }  # fmt: skip

    @classmethod
    def write(cls, path, time, values):
        us = np.round(time * 1e6).astype(np.uint64) + np.uint64(10**6)
        columns = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
        imu = ("IMU", "QBffffff", columns, ff.imu_rows(us, values))
        ff.write_dataflash(path, [ff.parameter_message(cls.parameters), imu])

    @staticmethod
    def loaded(text):
        from pymavlink.mavparm import MAVParmDict

        path = Path(text) if isinstance(text, Path) else None
        found = MAVParmDict()
        assert found.load(str(path)) is not False
        assert (found["INS_ACC_ID"], found["INS_GYR_ID"]) == (IDS["accel"], IDS["gyro"])
        return [np.array([found[f"INS_{name}_{axis}"] for axis in AXES]) for name in ("GYROFFS", "ACCOFFS", "ACCSCAL")]


def logs(pilot, raw_gyro, raw_accel, gyro_offset, offset, scale):
    """Readings that an autopilot logs, body axes."""
    return (raw_gyro - gyro_offset) @ pilot.C.T, ((raw_accel - offset) * scale) @ pilot.C.T


def sensor(pilot):
    """A unit in body axes whose readings the parameters correct to 0.2 % and 6 mm/s²; misalignments of 0.2 mrad."""
    rng = np.random.default_rng(11)
    Ma = np.diag((1.0 + rng.uniform(-0.002, 0.002, 3)) / SCALE) + rng.normal(0.0, 2e-4, (3, 3)) * (1 - np.eye(3))
    off = rng.normal(0.0, 2e-4, (3, 3))
    Mg = np.eye(3) + np.diag(rng.normal(0.0, 2e-4, 3)) + (off + off.T) * (1 - np.eye(3))
    ba, bg = OFFSET + rng.uniform(-0.006, 0.006, 3), GYRO_OFFSET + rng.normal(0.0, 1e-4, 3)
    in_body = SimpleNamespace(
        Mg=pilot.C @ Mg @ pilot.C.T, Ma=pilot.C @ Ma @ pilot.C.T, bg=pilot.C @ bg, ba=pilot.C @ ba
    )
    values = {}
    for i, a in enumerate("xyz"):
        values[f"gyro_scale_{a}"] = in_body.Mg[i, i] - 1.0
        values[f"accel_scale_{a}"] = in_body.Ma[i, i] - 1.0
        values[f"gyro_bias_{a}"], values[f"accel_bias_{a}"] = in_body.bg[i], in_body.ba[i]
        for j, b in enumerate("xyz"):
            if i != j:
                values[f"accel_misalignment_{a}{b}"] = in_body.Ma[i, j]
    for a, b in ("xy", "yz", "zx"):
        values[f"gyro_orthogonality_{a}{b}"] = 2.0 * in_body.Mg["xyz".index(a), "xyz".index(b)]
    return SimpleNamespace(Mg=Mg, Ma=Ma, bg=bg, ba=ba, errors=SensorErrors.from_dict(values))


@pytest.fixture(scope="module")
def motion():
    return sims.table1_motion(site=SITE, sample_rate_hz=50.0, dwell_s=5.0)


@pytest.mark.parametrize("pilot", [Px4, ArduPilot])
def test_the_whole_way(pilot, motion, tmp_path, shell):
    """Log, convert, calibrate, export, load: the unit ends where the best such parameters would bring it."""
    unit = sensor(pilot)
    noise = sims.ImuModel(gyro_noise=1e-6, accel_noise=5.0 * MICRO_G)
    recording = sims.read_out(motion, unit.errors, noise, np.random.default_rng(12), kind="rate")
    # The simulated readings are in body axes; the sensors stand in theirs.
    y = logs(pilot, recording.gyro @ pilot.C, recording.accel @ pilot.C, GYRO_OFFSET, OFFSET, SCALE)
    pilot.write(tmp_path / pilot.log, recording.time, np.hstack(y))
    srt.write_recording(recording, tmp_path / "labels")
    line = ["convert", tmp_path / pilot.log, "-o", tmp_path / "rec", "--like", tmp_path / "labels"]
    # The log's clock starts 1 s later than the labels.
    labels = (tmp_path / "labels" / "recording.toml").read_text()
    later = re.sub(r"\[(\d+\.\d+), (\d+\.\d+)\]", lambda m: f"[{float(m[1]) + 1.0!r}, {float(m[2]) + 1.0!r}]", labels)
    (tmp_path / "labels" / "recording.toml").write_text(later)
    shell(*line, "-q")
    applied = srt.load_recording(tmp_path / "rec").applied
    assert (applied.system, applied.gyro_id, applied.accel_id) == (pilot.name, IDS["gyro"], IDS["accel"])
    np.testing.assert_allclose(applied.rotation, pilot.C, rtol=0, atol=1e-7)  # angles in single precision
    shell("calibrate", tmp_path / "rec", "-o", tmp_path / "unit.json", "-q")
    out = tmp_path / f"p{pilot.suffix}"
    printed = shell("export", tmp_path / "unit.json", "--to", pilot.name, "-o", out).out
    for part in ("composed with the correction", "readings as logged", "loaded alone, not composed"):
        assert part in printed

    rng = np.random.default_rng(13)
    rate, force = (
        size * v / np.linalg.norm(v, axis=1)[:, None]
        for size, v in zip((1.0, 9.8), rng.normal(size=(2, 500, 3)), strict=True)
    )
    raw = rate @ pilot.C @ unit.Mg.T + unit.bg, force @ pilot.C @ unit.Ma.T + unit.ba

    def worst(*parameters):
        got = logs(pilot, *raw, *parameters)
        return [float(np.linalg.norm(a - b, axis=1).max()) for a, b in zip(got, (rate, force), strict=True)]

    composed = worst(*pilot.loaded(out if pilot is ArduPilot else out.read_text()))
    calibration = srt.load_calibration(tmp_path / "unit.json")
    residual = calibration.errors
    alone = export(
        calibration,
        pilot.name,
        applied=AppliedCorrection("none"),
        settings=ExportSettings(instance=1 if pilot is Px4 else 0),
    )
    fields = alone.format.read(alone.texts)
    loaded_alone = worst(fields["gyro_offset"], fields["accel_offset"], fields["accel_scale"])
    before = worst(GYRO_OFFSET, OFFSET, SCALE)
    best = worst(unit.bg, unit.ba, np.diag(unit.Ma) / np.sum(unit.Ma**2, axis=1))
    # Four sigma of each parameter of the calibration, over the three axes, and the rounding of the parameters.
    sigma = dict(zip(srt.sensor_errors.NAMES, calibration.sigma, strict=True))
    spread = [
        4.0 * np.sqrt(sum(sigma[f"gyro_bias_{a}"] ** 2 for a in "xyz")) + 3 * SINGLE * 0.02,
        4.0 * np.sqrt(sum(sigma[f"accel_bias_{a}"] ** 2 + (9.8 * sigma[f"accel_scale_{a}"]) ** 2 for a in "xyz"))
        + 6 * SINGLE * 9.8,
    ]
    print(f"{pilot.name}: before {before}, loaded alone {loaded_alone}, composed {composed}, best {best}")
    assert residual.vector.any()
    for found, reachable, allowed in zip(composed, best, spread, strict=True):
        assert abs(found - reachable) < allowed
    assert composed[1] < 0.5 * before[1] < 0.5 * loaded_alone[1]


def test_px4_names_the_dead_band_and_the_ids(tmp_path):
    calibration = srt.Calibration(
        "hand",
        "converged",
        "",
        SensorErrors.from_dict({"accel_bias_x": 0.006, "accel_scale_y": 0.002}),
        1e-12 * np.eye(27),
    )
    applied = AppliedCorrection("px4", 0, accel_matrix=np.diag(SCALE), accel_offset=OFFSET, gyro_offset=GYRO_OFFSET)
    made = export(calibration, "px4", applied=applied)
    assert [sentence.split(" changes")[0] for sentence in made.limits[:3]] == [
        "The accel offset", "The accel scale", "The gyro offset",
    ]  # fmt: skip
    assert "restart after loading" in made.limits[0]
    assert "CAL_GYRO0_ID and CAL_ACC0_ID" in made.limits[3]
    with pytest.raises(srt.InputError, match="log is of IMU 0"):
        export(calibration, "px4", applied=applied, settings=ExportSettings(instance=2))
    with pytest.raises(srt.InputError, match=r"ulog_params.*--applied px4:FILE"):
        export(calibration, "px4")
    with pytest.raises(srt.InputError, match="correction of px4, which a file for ardupilot does not replace"):
        export(calibration, "ardupilot", applied=applied)


@pytest.mark.parametrize("target", ["vectornav", "imucal", "kalibr", "openvins", "pyins"])
def test_files_of_linear_corrections_compose(target, tmp_path):
    """Correct by the file of a unit, calibrate the rest, compose: one file corrects the readings of the sensors."""
    pytest.importorskip("yaml")
    rng = np.random.default_rng(14)
    first, second = (
        srt.Calibration(
            "hand", "converged", "", SensorErrors(rng.uniform(-s, s, 27) * (1 - ASYMMETRIC)), 1e-12 * np.eye(27)
        )
        for s in (0.02, 0.002)
    )
    before = export(first, target, applied=AppliedCorrection("none"))
    path = tmp_path / f"a{before.format.suffixes[0]}"
    for part, text in before.texts.items():
        path.with_name(path.stem + part + path.suffix).write_bytes(text.encode())
    applied = applied_of(f"{target}:{path}")
    document = json.loads(json.dumps(applied.document()))
    applied = applied_correction("unit.json", document)
    made = export(second, target, applied=applied)
    raw = rng.uniform(-1.0, 1.0, (50, 3)), rng.uniform(-10.0, 10.0, (50, 3))
    logged = before.format.apply(before.format.read(before.texts), *raw)
    # Formats without biases leave theirs to the reader, in both files.
    if not made.format.biases:
        second = srt.Calibration(
            "hand",
            "converged",
            "",
            SensorErrors(np.r_[second.errors.vector[:9], np.zeros(3), second.errors.vector[12:24], np.zeros(3)]),
            1e-12 * np.eye(27),
        )
    expected = [v @ made.C_FB.T for v in second.apply(*logged)]
    found = made.format.apply(made.format.read(made.texts), *raw)
    # A dozen operations on values below 12, in single precision for the registers.
    atol = 12 * 12 * (SINGLE if target == "vectornav" else 2.0**-53)
    for ours, theirs in zip(expected, found, strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=0, atol=atol)


def answer(register, values):
    """Answer of a unit to $VNRRG, with its checksum."""
    body = ",".join([f"VNRRG,{register:02d}", *(f"{v:+.6f}" for v in values)])
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}\r\n"


def test_the_command_reads_registers_and_parameters(tmp_path, shell, refused):
    """convert --applied keeps the answers of a unit and the parameters that a ground station saved."""
    rng = np.random.default_rng(16)
    C = np.round(np.eye(3) + 0.01 * rng.normal(size=(3, 3)), 6)
    offsets = np.round(0.1 * rng.normal(size=(2, 3)), 6)
    registers = tmp_path / "registers.txt"
    registers.write_bytes(
        (answer(84, [*C.ravel(), *offsets[0]]) + answer(25, [*np.eye(3).ravel(), *offsets[1]])).encode()
    )
    log = tmp_path / "log.csv"
    table = np.column_stack([0.01 * np.arange(1, 101), rng.normal(size=(100, 3)), rng.normal(size=(100, 3)) * 0.1])
    table[:, 6] += 9.8
    np.savetxt(log, table, delimiter=",", header="time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z", comments="")
    given = "--gyro-unit", "rad/s", "--accel-unit", "m/s^2", "--time-unit", "s", "--gravity-m-s2", "9.8", "-q"
    line = ["convert", str(log), "-o", str(tmp_path / "a"), *given]
    shell(*line, "--applied", f"vectornav:{registers}")
    applied = srt.load_recording(tmp_path / "a").applied
    assert applied.system == "vectornav"
    # Single precision in the unit, and an inverse there and back.
    np.testing.assert_allclose(applied.gyro_matrix, C, rtol=0, atol=4 * SINGLE)
    np.testing.assert_allclose(applied.accel_offset, offsets[1], rtol=0, atol=4 * SINGLE)
    saved = tmp_path / "vehicle.params"
    saved.write_text("".join(f"1\t1\t{name}\t{value}\t9\n" for name, value in Px4.parameters.items()))
    line[3] = str(tmp_path / "b")
    assert "no CAL_ACC0_XSCALE in it" in refused(*line, "--applied", f"px4:{saved}")
    shell(*line, "--applied", f"px4.1.2:{saved}")
    applied = srt.load_recording(tmp_path / "b").applied
    assert (applied.slots, applied.gyro_id) == ((1, 2), IDS["gyro"])
    np.testing.assert_allclose(applied.rotation, Px4.C, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(applied.accel_offset, OFFSET)
    line[3] = str(tmp_path / "c")
    assert "give FORMAT:FILE" in refused(*line, "--applied", "px4")
