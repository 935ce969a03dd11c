"""Files for other tools: read by other code than ours, applied by the tools' formulas, and refused when spoiled.

The formulas are typed here a second time, from the tools' own statements, over plain JSON, YAML and text.
"""

from __future__ import annotations

import importlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest

import srt
from srt import exporters
from srt.exporters import ExportSettings, Readings, export, gtsam_preintegration, load, save
from srt.exporters.linear_model import lower_rotation, upper_rotation
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.result.calibration import Calibration
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

yaml = pytest.importorskip("yaml")

U = rotation_matrix(np.array([0.1, -0.2, 0.15]))
ASYMMETRY = np.zeros(N_PARAMETERS, dtype=bool)
for group in ("gyro_asymmetry", "accel_asymmetry"):
    ASYMMETRY[GROUP_SLICES[group]] = True
NOISE = {
    "gyro_noise_rad_per_sqrt_s": [1e-6, 2e-6, 1.5e-6],
    "accel_noise_m_s2_sqrt_s": [1e-4, 3e-4, 2e-4],
}
TARGETS = tuple(exporters.exporters())
# A dozen operations on values below 50 (30 m/s² over a smallest singular value of 0.6), each right to 1.1e-16:
# 12 · 50 · 1.1e-16 = 7e-14.
EXACT = 1e-12
SINGLE = 2.0**-24


def calibrated(rng, *, asymmetry=False, size=0.1, **changes):
    """Give random errors of every kind; ``size`` 0.1 keeps the smallest singular value of both triads above 0.6."""
    vector = rng.uniform(-size, size, N_PARAMETERS)
    vector[ASYMMETRY] *= asymmetry
    given = {
        "U": U,
        "noise": NOISE,
        "site": {"gravity_m_s2": 9.81},
        "provenance": {"serial": "SN-7", "software": "test"},
    }
    covariance = np.diag(rng.uniform(1e-12, 1e-10, N_PARAMETERS))
    return Calibration("closed-form", "converged", "Done.", SensorErrors(vector), covariance, **(given | changes))


def motion(rng, n=200):
    """Readings of up to 3 rad/s and 30 m/s² on each axis."""
    return Readings(rng.uniform(-3.0, 3.0, (n, 3)), rng.uniform(-30.0, 30.0, (n, 3)), "random readings")


def mm(matrix, rows):
    return np.einsum("ij,nj->ni", np.array(matrix, dtype=float), rows)


def kalibr(texts, w, f, bias):
    imu = yaml.safe_load(texts[""])["imu0"]
    M_a, M_g = np.array(imu["accelerometers"]["M"]), np.array(imu["gyroscopes"]["M"])
    A, C = np.array(imu["gyroscopes"]["A"]), np.array(imu["gyroscopes"]["C_gyro_i"])
    assert imu["model"] == "scale-misalignment"
    for M in (M_a, M_g):
        assert M[0, 1] == M[0, 2] == M[1, 2] == 0.0
    a = mm(np.linalg.inv(M_a), f - bias[1])
    return mm(np.linalg.inv(M_g @ C), w - mm(A @ C, a) - bias[0]), a


def openvins(texts, w, f, bias):
    head, rest = texts[""].split("\n", 1)
    assert head == "%YAML:1.0"
    imu = yaml.safe_load(rest)["imu0"]
    Tw, Ta = np.array(imu["Tw"]), np.array(imu["Ta"])
    # What its reader keeps of a matrix of the model "kalibr" is the lower triangle.
    assert imu["model"] == "kalibr"
    Dw, Da = np.tril(np.linalg.inv(Tw)), np.tril(np.linalg.inv(Ta))
    a = mm(np.array(imu["R_IMUtoACC"]).T @ Da, f - bias[1])
    return mm(np.array(imu["R_IMUtoGYRO"]).T @ Dw, w - mm(imu["Tg"], a) - bias[0]), a


def basalt(texts, w, f, bias):
    v = json.loads(texts[""])["value0"]
    bx, by, bz, s1, s2, s3, s4, s5, s6 = v["calib_accel_bias"]
    a = mm([[1 + s1, 0, 0], [s2, 1 + s4, 0], [s3, s5, 1 + s6]], f) - [bx, by, bz]
    g = v["calib_gyro_bias"]
    S = np.array([[g[3], g[6], g[9]], [g[4], g[7], g[10]], [g[5], g[8], g[11]]])
    return mm(np.eye(3) + S, w) - g[:3], a


def imucal(texts, w, f, bias):
    d = {k: np.array(v) if isinstance(v, list) else v for k, v in json.loads(texts[""]).items()}
    for letter in "ag":
        K, R = d[f"K_{letter}"], d[f"R_{letter}"]
        np.testing.assert_array_equal(K, np.diag(np.diag(K)))
        np.testing.assert_allclose(np.linalg.norm(R, axis=1), 1.0, rtol=0, atol=1e-15)
    a = mm(np.linalg.inv(d["K_a"] @ d["R_a"]), f - d["b_a"])
    return np.radians(mm(np.linalg.inv(d["K_g"] @ d["R_g"]), np.degrees(w) - mm(d["K_ga"], a) - d["b_g"])), a


def imu_tk(texts, w, f, bias):
    out = []
    for part, values in (("_gyro", w), ("_acc", f)):
        n = [float(word) for word in texts[part].split()]
        T, K, B = np.reshape(n[:9], (3, 3)), np.reshape(n[9:18], (3, 3)), n[18:]
        np.testing.assert_array_equal(np.diag(T), 1.0)
        assert np.count_nonzero(K) == 3
        if part == "_acc":
            assert T[1, 0] == T[2, 0] == T[2, 1] == 0.0
        out.append(mm(T @ K, values - B))
    return tuple(out)


def pyins(texts, w, f, bias):
    d = json.loads(texts[""])
    return tuple(
        mm(np.linalg.inv(d[s]["transform"]), values - d[s]["bias"]) for s, values in (("gyro", w), ("accel", f))
    )


def vectornav(texts, w, f, bias):
    lines = texts[""].split("\r\n")
    assert lines.pop() == ""
    out = []
    for line, register, values in zip(lines, ("84", "25"), (w, f), strict=True):
        total = 0
        for c in line[1 : line.index("*")]:
            total ^= ord(c)
        assert line[line.index("*") :] == f"*{total:02X}"
        head, number, *numbers = line[1 : line.index("*")].split(",")
        assert (head, number) == ("VNWRG", register)
        n = np.array(numbers, dtype=np.float32).astype(float)
        out.append(mm(n[:9].reshape(3, 3), values - n[9:]))
    return tuple(out)


def px4(texts, w, f, bias, n=0):
    p = {}
    for line in texts[""].splitlines():
        if not line.startswith("#"):
            vehicle, component, name, value, kind = line.split("\t")
            assert (vehicle, component, kind) == ("1", "1", "9")
            p[name] = float(np.float32(value))
    a = (f - [p[f"CAL_ACC{n}_{x}OFF"] for x in "XYZ"]) * [p[f"CAL_ACC{n}_{x}SCALE"] for x in "XYZ"]
    return w - [p[f"CAL_GYRO{n}_{x}OFF"] for x in "XYZ"], a


def ardupilot(texts, w, f, bias, n=""):
    p = dict(line.split(",") for line in texts[""].splitlines() if not line.startswith("#"))
    p = {name: float(np.float32(value)) for name, value in p.items()}
    a = (f - [p[f"INS_ACC{n}OFFS_{x}"] for x in "XYZ"]) * [p[f"INS_ACC{n}SCAL_{x}"] for x in "XYZ"]
    return w - [p[f"INS_GYR{n}OFFS_{x}"] for x in "XYZ"], a


def ros2(texts, w, f, bias):
    p = yaml.safe_load(texts[""])["/**"]["ros__parameters"]["imu_calibration"]
    R = np.reshape(p["rotation"], (3, 3))
    out = []
    for sensor, values in (("gyro", w), ("accel", f)):
        M, s, b = np.reshape(p[sensor]["matrix"], (3, 3)), np.array(p[sensor]["asymmetry"]), p[sensor]["bias"]
        v = mm(np.linalg.inv(M), values - b)
        if not s.any():
            np.testing.assert_allclose(
                mm(np.reshape(p[sensor]["correction"], (3, 3)), values - b), mm(R, v), atol=EXACT
            )
        for _ in range(60):  # a contraction by |s| / smallest singular value < 0.2
            v = mm(np.linalg.inv(M), values - b - s * np.abs(v))
        out.append(mm(R, v))
    return tuple(out)


def gtsam(texts, w, f, bias):
    d = json.loads(texts[""])
    return w - d["bias_gyro"], f - d["bias_accel"]


FORMULAS = {f.__name__: f for f in (kalibr, openvins, basalt, imucal, imu_tk, pyins, vectornav, px4, ardupilot, ros2)}
FORMULAS["gtsam"] = gtsam
LOSSY = ("px4", "ardupilot", "gtsam")
CASES = [(target, frame) for target in TARGETS for frame in exporters.exporter(target).frames]
IMPORTED = tuple(name for name, item in exporters.exporters().items() if item.imports)


def biases_of(calibration):
    return calibration.errors.group("gyro_bias"), calibration.errors.group("accel_bias")


def ours(calibration, readings, C):
    w, f = calibration.apply(readings.gyro, readings.accel)
    return mm(C, w), mm(C, f)


def lengths(a, b):
    d = np.linalg.norm(a - b, axis=1)
    return d.max(), math.sqrt(np.mean(d**2))


def test_the_formulas_cover_every_target():
    assert set(FORMULAS) == set(TARGETS)


@pytest.mark.parametrize(("target", "frame"), [case for case in CASES if case[0] not in LOSSY])
def test_the_linear_part_comes_back_whole(target, frame):
    """Without asymmetry the tool's formula gives what our own correction gives, in the axes that are reported."""
    rng = np.random.default_rng(5)
    for _ in range(10):
        calibration, readings = calibrated(rng), motion(rng)
        made = export(calibration, target, readings=readings, frame=frame)
        np.testing.assert_allclose(made.C_FB @ made.C_FB.T, np.eye(3), rtol=0, atol=1e-15 * 10)
        assert np.linalg.det(made.C_FB) > 0.0
        np.testing.assert_allclose(rotation_matrix(made.turn_mrad * 1e-3), made.C_FB, rtol=0, atol=1e-14)
        expected = ours(calibration, readings, made.C_FB)
        found = FORMULAS[target](made.texts, readings.gyro, readings.accel, biases_of(calibration))
        within = EXACT
        if target == "vectornav":
            # Twelve constants of at most 1/0.6, each off by half a unit of single precision, times 33 m/s² of reading
            # less bias on three axes; the bias itself adds 0.1 of the same.
            within = SINGLE * 3.0 * (33.0 / 0.6 + 0.1 / 0.6)
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=within)


def test_axes_are_those_that_were_asked_for():
    calibration = calibrated(np.random.default_rng(1))
    Ma = accel_triad(calibration.errors).matrix
    assert np.abs(np.triu(Ma, 1)).max() > 0.01
    np.testing.assert_array_equal(export(calibration, "pyins").C_FB, np.eye(3))
    np.testing.assert_allclose(export(calibration, "pyins", frame="table").C_FB, U.T, rtol=0, atol=1e-15)
    for target, zero in (("kalibr", np.triu), ("openvins", np.triu), ("basalt", np.triu), ("imu_tk", np.tril)):
        C = export(calibration, target, frame="accel").C_FB
        off = zero(Ma @ C.T, 1 if zero is np.triu else -1)
        assert np.abs(off).max() < 1e-15 * 10
        assert np.all(np.diag(Ma @ C.T) > 0.0)


@pytest.mark.parametrize(("factor", "cut"), [(lower_rotation, np.tril), (upper_rotation, np.triu)])
def test_factors(factor, cut):
    rng = np.random.default_rng(2)
    for _ in range(50):
        M = rng.normal(size=(3, 3))
        M *= np.sign(np.linalg.det(M))
        triangle, turn = factor(M)
        np.testing.assert_array_equal(cut(triangle), triangle)
        assert np.all(np.diag(triangle) > 0.0)
        np.testing.assert_allclose(triangle @ turn, M, rtol=0, atol=1e-14)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0, atol=1e-14)
        with pytest.raises(srt.InputError, match="left-handed"):
            factor(-M)


@pytest.mark.parametrize(
    ("target", "frame", "fit"),
    [(*case, fit) for case in CASES for fit in (False, True) if not (fit and case[0] == "ros2")],
)
def test_what_is_said_to_be_lost_is_what_is_lost(target, frame, fit):
    """Residuals are measured here by the formulas of this file, asymmetry and all."""
    rng = np.random.default_rng(6)
    calibration = calibrated(rng, asymmetry=True, size=0.02)
    readings = motion(rng)
    item = exporters.exporter(target)
    made = export(calibration, target, readings=readings, frame=frame, asymmetry="fit" if fit else "leave")
    expected = ours(calibration, readings, made.C_FB)
    rows = {row.title: row for row in made.residuals}
    assert ("biases given beside it" in rows) == (not item.biases)
    assert ("asymmetry alone" in rows) == (not item.asymmetry)
    none = np.zeros(3), np.zeros(3)
    given = {"this file": none}
    if not item.biases and not fit:
        given["biases given beside it"] = biases_of(calibration)
    for title, bias in given.items():
        found = FORMULAS[target](made.texts, readings.gyro, readings.accel, bias)
        row = rows[title]
        for (worst, rms), (said_max, said_rms) in zip(
            map(lengths, found, expected),
            ((row.gyro_max, row.gyro_rms), (row.accel_max, row.accel_rms)),
            strict=True,
        ):
            # Half a unit of the last of twelve digits, and rounding where nothing is lost.
            np.testing.assert_allclose([said_max, said_rms], [worst, rms], rtol=1e-9, atol=EXACT)
    if item.asymmetry:
        assert rows["this file"].accel_max < EXACT
    else:
        assert "scale-factor asymmetry" in made.losses
        # 2 % of at least 20 m/s², which some sample of 200 has on some axis, and no more than 2 % of 30 on three.
        assert 0.01 < rows["asymmetry alone"].accel_max < 3.0


def test_without_a_recording_the_loss_is_that_of_all_directions():
    rng = np.random.default_rng(7)
    calibration = calibrated(rng, size=0.02)
    made = export(calibration, "px4")
    gyro, accel = made.readings.gyro, made.readings.accel
    w, f = calibration.apply(gyro, accel)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(f, axis=1), 9.80665, rtol=0, atol=1e-12)
    for v, size in ((w, 1.0), (f, 9.80665)):
        # Of n points spread by equal areas the mean is below 1/n and the second moments are a third to the same order.
        np.testing.assert_allclose(v.mean(axis=0) / size, 0.0, atol=5e-3)
        np.testing.assert_allclose(v.T @ v / len(v) / size**2, np.eye(3) / 3.0, atol=5e-3)
    assert len(np.unique(f.round(9), axis=0)) == 1000
    found = px4(made.texts, gyro, accel, None)
    worst, rms = lengths(found[0], w)
    assert made.residuals[0].gyro_max == pytest.approx(worst, rel=1e-9)
    assert made.residuals[0].gyro_rms == pytest.approx(rms, rel=1e-9)


def test_the_factors_of_an_autopilot_are_the_best_that_factors_can_be():
    """Least squares of true on measured force over all directions, axis by axis."""
    calibration = calibrated(np.random.default_rng(8))
    Ma = accel_triad(calibration.errors).matrix
    text = export(calibration, "ardupilot").texts[""]
    p = dict(line.split(",") for line in text.splitlines() if not line.startswith("#"))
    directions = np.vstack([np.eye(3), -np.eye(3)])  # second moments as of the sphere
    measured = mm(Ma, directions)
    best = [np.linalg.lstsq(measured[:, [i]], directions[:, i], rcond=None)[0][0] for i in range(3)]
    found = [float(p[f"INS_ACCSCAL_{x}"]) for x in "XYZ"]
    np.testing.assert_allclose(found, best, rtol=1e-7, atol=0.0)  # single precision


def test_a_fit_takes_up_the_asymmetry_of_a_channel_of_one_sign():
    rng = np.random.default_rng(9)
    calibration = calibrated(rng, asymmetry=True, size=0.02)
    level = rng.uniform([-1.0, -1.0, 8.0], [1.0, 1.0, 12.0], (500, 3))
    gyro = gyro_triad(calibration.errors).read(rng.uniform(-1.0, 1.0, (500, 3)))
    readings = Readings(gyro, accel_triad(calibration.errors).read(level), "a level unit")
    fitted = export(calibration, "pyins", readings=readings, asymmetry="fit")
    left = export(calibration, "pyins", readings=readings)
    d = json.loads(fitted.texts[""])["accel"]
    s, Ma = calibration.errors.group("accel_asymmetry"), accel_triad(calibration.errors).matrix
    assert d["transform"][2][2] == pytest.approx(Ma[2, 2] + s[2], abs=1e-12)
    assert d["bias"][2] == pytest.approx(calibration.errors.group("accel_bias")[2], abs=1e-11)
    # x and y reach 1 m/s² where z has 10: what is left is a tenth at most.
    assert fitted.residuals[0].accel_rms < 0.2 * left.residuals[0].accel_rms


def test_a_fit_is_the_best_line_through_each_channel():
    rng = np.random.default_rng(29)
    calibration = calibrated(rng, asymmetry=True, size=0.02)
    rate, force = rng.uniform(-1.0, 2.0, (300, 3)), rng.uniform(-5.0, 8.0, (300, 3))
    rate[:, 0] = 0.5  # a channel that does not move but by rounding has no slope
    triads = gyro_triad(calibration.errors), accel_triad(calibration.errors)
    readings = Readings(triads[0].read(rate), triads[1].read(force), "turning mostly one way")
    document = json.loads(export(calibration, "pyins", readings=readings, asymmetry="fit").texts[""])
    for sensor, triad, v in (("gyro", triads[0], rate), ("accel", triads[1], force)):
        lines = [np.polyfit(x, np.abs(x), 1) if np.ptp(x) > 0.0 else (0.0, np.abs(x).mean()) for x in v.T]
        slope, offset = np.transpose(lines)
        found = document[sensor]
        # Rounding of the corrected readings (1e-15 of 8) is all that stands between the two.
        expected = triad.matrix + np.diag(triad.asymmetry * slope)
        np.testing.assert_allclose(found["transform"], expected, rtol=0, atol=EXACT)
        np.testing.assert_allclose(found["bias"], triad.bias + triad.asymmetry * offset, rtol=0, atol=EXACT)


def test_imucal_reads_and_applies_its_file(tmp_path):
    package = pytest.importorskip("imucal")
    rng = np.random.default_rng(10)
    for _ in range(5):
        calibration, readings = calibrated(rng), motion(rng)
        save(export(calibration, "imucal", readings=readings), tmp_path / "unit.json")
        loaded = package.CalibrationInfo.from_json_file(tmp_path / "unit.json")
        acc, gyr = loaded.calibrate(readings.accel, np.degrees(readings.gyro), acc_unit="m/s^2", gyr_unit="deg/s")
        w, f = calibration.apply(readings.gyro, readings.accel)
        np.testing.assert_allclose(acc, f, rtol=0, atol=EXACT)
        np.testing.assert_allclose(np.radians(gyr), w, rtol=0, atol=EXACT)


def test_pyins_takes_its_file(tmp_path):
    pytest.importorskip("pyins")
    pandas = importlib.import_module("pandas")
    sensor = importlib.import_module("pyins.inertial_sensor")
    rng = np.random.default_rng(11)
    calibration, readings = calibrated(rng), motion(rng)
    save(export(calibration, "pyins", readings=readings), tmp_path / "unit.json")
    document = json.loads((tmp_path / "unit.json").read_text())
    w, f = calibration.apply(readings.gyro, readings.accel)
    dt = 0.01
    for name, raw, true in (("gyro", readings.gyro, w), ("accel", readings.accel, f)):
        frame = pandas.DataFrame(raw, index=dt * np.arange(1, len(raw) + 1))
        simulated = sensor.Parameters(**document[name]).apply(pandas.DataFrame(true, index=frame.index), "rate")
        np.testing.assert_allclose(simulated.to_numpy(), raw, rtol=0, atol=EXACT)
        model = sensor.EstimationModel()
        model.transform, model.bias = (np.array(document[name][key]) for key in ("transform", "bias"))
        corrected = model.correct_increments(np.full(len(raw), dt), frame * dt)
        np.testing.assert_allclose(corrected.to_numpy() / dt, true, rtol=0, atol=EXACT)


@pytest.mark.parametrize("target", IMPORTED)
def test_a_file_comes_back_as_a_pre_calibration(tmp_path, target):
    rng = np.random.default_rng(12)
    item = exporters.exporter(target)
    for frame in item.frames:
        calibration = calibrated(rng)
        path = tmp_path / f"unit{item.suffixes[0]}"
        made = export(calibration, target, frame=frame)
        places = save(made, path)
        assert all(place.exists() for place in places)
        found = load(path, target)
        expected = calibration.errors.vector.copy()
        for group in found.absent:
            expected[GROUP_SLICES[group]] = 0.0
        assert ("gyro_bias" in found.absent) == (not item.biases)
        within = 20.0 * SINGLE if target == "vectornav" else EXACT
        np.testing.assert_allclose(found.errors.vector, expected, rtol=0, atol=within)
        np.testing.assert_allclose(found.U, made.C_FB.T, rtol=0, atol=within)
        prior = importlib.import_module("srt.model.prior").Prior.from_sigma(np.full(N_PARAMETERS, 1e-3), found.errors)
        assert prior.mean == found.errors


@pytest.mark.parametrize("target", [name for name in TARGETS if name not in IMPORTED])
def test_what_holds_too_little_is_no_pre_calibration(tmp_path, target):
    with pytest.raises(srt.InputError, match="not a pre-calibration"):
        load(tmp_path / "unit", target)


@pytest.mark.parametrize("target", TARGETS)
def test_a_truncated_file_is_refused(target):
    """Wherever it is cut, short of losing nothing but blanks at its end."""
    item = exporters.exporter(target)
    made = export(calibrated(np.random.default_rng(13)), target)
    for part in item.parts:
        text = made.texts[part]
        body = len(text.rstrip())
        for length in {*range(0, body, max(body // 60, 1)), body - 1}:
            with pytest.raises(srt.InputError) as caught:
                item.read({**made.texts, part: text[:length]})
            assert "\n" not in str(caught.value)


def spoil(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


def rewritten(key, change):
    """Change one field of a YAML file, by its path."""

    def edit(text):
        head, _, body = text.partition("imu0:")
        document = yaml.safe_load("imu0:" + body)
        at = document["imu0"]
        *path, last = key.split(".")
        for step in path:
            at = at[step]
        if change is None:
            del at[last]
        else:
            at[last] = change(at[last])
        return head + yaml.safe_dump(document)

    return edit


def entry(i, j, value):
    def change(matrix):
        matrix[i][j] = value
        return matrix

    return change


@pytest.mark.parametrize(
    ("target", "part", "edit", "fragment"),
    [
        ("kalibr", "", rewritten("accelerometers.M", entry(0, 2, 0.01)), "would be dropped silently"),
        ("kalibr", "", rewritten("gyroscopes.M", entry(0, 1, 1e-6)), "would be dropped silently"),
        ("kalibr", "", rewritten("gyroscopes.C_gyro_i", entry(0, 1, 0.3)), "no rotation"),
        ("kalibr", "", rewritten("gyroscopes.C_gyro_i", lambda C: (-np.array(C)).tolist()), "no rotation"),
        ("kalibr", "", rewritten("gyroscopes.A", entry(1, 1, float("nan"))), "not finite"),
        ("kalibr", "", rewritten("gyroscopes.A", lambda _: [1.0, 2.0]), "shape"),
        ("kalibr", "", rewritten("gyroscopes.A", lambda _: "none"), "3 by 3"),
        ("kalibr", "", rewritten("gyroscopes.M", None), "no imu0.gyroscopes.M"),
        ("kalibr", "", rewritten("accelerometers.M", entry(2, 2, 0.0)), "no inverse"),
        ("kalibr", "", rewritten("model", lambda _: "scale-misalignment-size-effect"), "model"),
        ("kalibr", "", lambda text: "- 1\n- 2\n", "no fields by name"),
        ("openvins", "", rewritten("Tw", entry(0, 1, 0.01)), "would be dropped silently"),
        ("openvins", "", rewritten("Ta", entry(1, 2, 0.01)), "would be dropped silently"),
        ("openvins", "", rewritten("model", lambda _: "rpng"), "not upper-triangular"),
        ("openvins", "", rewritten("model", lambda _: "mine"), "one of kalibr"),
        ("openvins", "", rewritten("R_IMUtoACC", entry(0, 0, 1.1)), "no rotation"),
        ("basalt", "", lambda text: spoil(text, '"calib_accel_bias": [', '"calib_accel_bias": [0.0, '), "shape"),
        ("imucal", "", lambda text: spoil(text, '"from_gyr_unit": "deg/s"', '"from_gyr_unit": "rad/s"'), "deg/s"),
        ("imucal", "", lambda text: spoil(text, '"2.0.0"', '"1.0.0"'), "_format_version"),
        ("imucal", "", lambda text: spoil(text, '"Ferraris"', '"Magnetometer"'), "cal_type"),
        ("imu_tk", "_acc", lambda text: spoil(text, "0 1 ", "0.1 1 "), "upper-triangular"),
        ("imu_tk", "_gyro", lambda text: spoil(text, "1 ", "2 "), "unit diagonal"),
        ("imu_tk", "_gyro", lambda text: text + "7\n", "shape"),
        ("pyins", "", lambda text: "[]", "no fields by name"),
        ("vectornav", "", lambda text: spoil(text, "VNWRG,25,1", "VNWRG,25,2"), "checksum"),
        ("vectornav", "", lambda text: text.split("\r\n")[0] + "\r\n", "register 25"),
        ("px4", "", lambda text: spoil(text, "CAL_ACC0_YSCALE\t0", "CAL_ACC0_YSCALE\tinf0"), "CAL_ACC0_XSCALE"),
        ("ardupilot", "", lambda text: spoil(text, "INS_ACCOFFS_Y", "INS_ACCOFFS_T"), "INS_ACCOFFS_X"),
        ("ros2", "", lambda text: spoil(text, "asymmetry: [", "asymmetry: [1.0, "), "shape"),
        ("ros2", "", lambda text: spoil(text, "correction: [1", "correction: [2"), "was edited"),
    ],
)
def test_an_edited_file_is_refused(target, part, edit, fragment):
    calibration = calibrated(np.random.default_rng(14), size=0.01)
    vector = calibration.errors.vector.copy()
    # Signs that the edits of this table count on.
    vector[GROUP_SLICES["accel_scale"]] = [-0.001, 0.002, -0.003]
    vector[GROUP_SLICES["gyro_scale"]] = [-0.004, -0.002, 0.001]
    texts = export(replace(calibration, errors=SensorErrors(vector)), target).texts
    with pytest.raises(srt.InputError, match=fragment):
        exporters.exporter(target).read({**texts, part: edit(texts[part])})


G_SENSITIVITY = np.array([[2e-4, -5e-5, 1e-4], [3e-5, -1e-4, 8e-5], [-6e-5, 4e-5, 1.5e-4]])
HOLD_G_SENSITIVITY = tuple(name for name, item in exporters.exporters().items() if item.g_sensitivity)


def g_sensitive(rng):
    return calibrated(rng, diagnostics={"g_sensitivity": {"matrix": G_SENSITIVITY.tolist()}})


@pytest.mark.parametrize("target", HOLD_G_SENSITIVITY)
def test_g_sensitivity_is_written_and_read_back(target, tmp_path):
    """Of ω̃ = Mg ω + Γ f + b the formula of the target leaves ω, and the file gives Γ back."""
    rng = np.random.default_rng(16)
    calibration, readings = g_sensitive(rng), motion(rng)
    made = export(calibration, target, readings=readings)
    _, force = calibration.apply(readings.gyro, readings.accel)
    expected, _ = calibration.apply(readings.gyro - mm(G_SENSITIVITY, force), readings.accel)
    found, _ = FORMULAS[target](made.texts, readings.gyro, readings.accel, biases_of(calibration))
    np.testing.assert_allclose(found, mm(made.C_FB, expected), rtol=0, atol=EXACT)
    assert "g-sensitivity" not in made.losses
    assert made.residuals[-1].gyro_max < EXACT
    again = load(save(made, tmp_path / f"unit{made.format.suffixes[0]}")[0], target)
    np.testing.assert_allclose(again.g_sensitivity, G_SENSITIVITY, rtol=0, atol=1e-12)
    size = [*range(*GROUP_SLICES["gyro_scale"].indices(N_PARAMETERS))]
    np.testing.assert_allclose(again.errors.vector[size], calibration.errors.vector[size], rtol=0, atol=1e-12)
    if made.format.biases:
        np.testing.assert_allclose(again.errors.vector, calibration.errors.vector, rtol=0, atol=1e-12)


@pytest.mark.parametrize("target", [name for name in TARGETS if name not in HOLD_G_SENSITIVITY])
def test_g_sensitivity_that_a_format_does_not_hold_is_a_loss(target):
    assert "g-sensitivity" in export(g_sensitive(np.random.default_rng(17)), target).losses


def test_a_format_without_g_sensitivity_reads_as_zero(tmp_path):
    (path,) = save(export(calibrated(np.random.default_rng(15)), "openvins"), tmp_path / "unit.yaml")
    np.testing.assert_array_equal(load(path, "openvins").g_sensitivity, np.zeros((3, 3)))


def test_files_that_are_not_there_or_no_text(tmp_path):
    with pytest.raises(srt.InputError, match="cannot be read"):
        load(tmp_path / "unit.json", "pyins")
    (tmp_path / "unit.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(srt.InputError, match="no text"):
        load(tmp_path / "unit.json", "pyins")


def test_a_flipped_axis_is_no_pre_calibration(tmp_path):
    path = tmp_path / "unit.json"
    save(export(calibrated(np.random.default_rng(16)), "pyins"), path)
    document = json.loads(path.read_text())
    document["gyro"]["transform"][0] = [-v for v in document["gyro"]["transform"][0]]
    path.write_text(json.dumps(document))
    with pytest.raises(srt.SrtError, match="left-handed"):
        load(path, "pyins")


def changed(calibration, **groups):
    vector = calibration.errors.vector.copy()
    for group, values in groups.items():
        vector[GROUP_SLICES[group]] = values
    return replace(calibration, errors=SensorErrors(vector))


@pytest.mark.parametrize(
    ("target", "options", "groups", "fragment"),
    [
        ("kalib", {}, {}, "did you mean kalibr"),
        ("kalibr", {"frame": "mars"}, {}, "takes accel"),
        ("px4", {"frame": "accel"}, {}, "takes mars or table"),
        ("imucal", {"settings": ExportSettings(topic="/imu")}, {}, "no place for topic"),
        ("kalibr", {"settings": ExportSettings(instance=1)}, {}, "no place for instance"),
        ("pyins", {"asymmetry": "fit"}, {}, "no recording to fit to"),
        ("pyins", {"asymmetry": "half"}, {}, "asymmetry is"),
        ("ardupilot", {}, {"accel_bias": 4.0}, "parameters go to 3.5"),
        ("ardupilot", {}, {"accel_scale": -0.3}, "from 0.8 to 1.2"),
        ("ardupilot", {}, {"accel_bias": 0.0}, "never calibrated"),
        ("ardupilot", {}, {"gyro_bias": 0.0}, "never calibrated"),
        ("ardupilot", {"settings": ExportSettings(instance=3)}, {}, "0, 1 and 2"),
        ("pyins", {}, {"gyro_scale": -1.5}, "cannot be exported"),
        ("pyins", {}, {"gyro_asymmetry": 1.5}, "no unique inverse"),
    ],
)
def test_refused(target, options, groups, fragment):
    with pytest.raises(srt.InputError, match=fragment):
        export(changed(calibrated(np.random.default_rng(17), size=0.02), **groups), target, **options)


def test_no_table_axes_without_a_fixture():
    with pytest.raises(srt.InputError, match="no table frame"):
        export(calibrated(np.random.default_rng(18), U=None), "pyins", frame="table")


@pytest.mark.parametrize(
    ("gyro", "accel", "fragment"),
    [
        (np.zeros((4, 2)), np.zeros((4, 3)), "shape"),
        (np.zeros((4, 3)), np.zeros((5, 3)), "as many of both"),
        (np.zeros((0, 3)), np.zeros((0, 3)), "one at least"),
        (np.full((4, 3), np.nan), np.zeros((4, 3)), "finite"),
    ],
)
def test_readings_that_cannot_be_used(gyro, accel, fragment):
    with pytest.raises(srt.InputError, match=fragment):
        Readings(gyro, accel, "bad")


@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 0.0}, {"gyro_random_walk": math.nan}, {"topic": "a b"}, {"topic": ""}, {"instance": -1}]
)
def test_settings_that_cannot_be(wrong):
    with pytest.raises(srt.InputError):
        ExportSettings(**wrong)


def test_increments_are_compared_as_rates():
    rng = np.random.default_rng(19)
    calibration, dt = calibrated(rng), 0.01
    rates = motion(rng)
    time = dt * np.arange(1, len(rates.gyro) + 1)
    recording = srt.Recording(time, rates.gyro * dt, rates.accel * dt, srt.Site(9.8), kind="increment")
    made = export(calibration, "px4", readings=Readings.of(recording))
    expected = export(calibration, "px4", readings=rates)
    # Stamps of 2 s are right to 2e-16, their differences to 4e-14 of 0.01 s.
    assert made.residuals[0].gyro_rms == pytest.approx(expected.residuals[0].gyro_rms, rel=1e-10)


def test_noise_and_rate_go_into_the_file_where_known():
    calibration = calibrated(np.random.default_rng(20))
    stated = ExportSettings(topic="/imu/raw", rate_hz=250.0, gyro_random_walk=1e-5, accel_random_walk=2e-4)
    made = export(calibration, "kalibr", settings=stated)
    imu = yaml.safe_load(made.texts[""])["imu0"]
    assert made.unknown == ()
    found = {key: imu[key] for key in imu if "_" in key or key in ("rostopic",)}
    assert found == {
        "T_i_b": np.eye(4).tolist(),
        "accelerometer_noise_density": 3e-4,
        "accelerometer_random_walk": 2e-4,
        "gyroscope_noise_density": 2e-6,
        "gyroscope_random_walk": 1e-5,
        "update_rate": 250.0,
        "rostopic": "/imu/raw",
        "time_offset": 0.0,
    }
    without = export(replace(calibration, noise={}), "openvins")
    assert len(without.unknown) == 5
    assert "noise_density" not in without.texts[""]
    # A number with an exponent and no point is a word in YAML 1.1.
    assert "1.0e-05" in made.texts[""]


def test_the_instance_of_an_autopilot_is_in_the_names():
    calibration = calibrated(np.random.default_rng(21), size=0.02)
    for target, formula, n in (("px4", px4, 1), ("ardupilot", ardupilot, "2")):
        made = export(calibration, target, settings=ExportSettings(instance=1))
        w, _ = formula(made.texts, np.zeros((1, 3)), np.zeros((1, 3)), None, n)
        np.testing.assert_allclose(w[0], -calibration.errors.group("gyro_bias"), rtol=1e-6)


def test_what_reads_back_otherwise_is_not_left(tmp_path, monkeypatch):
    """A disk that changes one digit of a file which is still a valid one."""
    made = export(calibrated(np.random.default_rng(22)), "imu_tk")
    (tmp_path / "unit_acc.calib").write_text("mine")
    path_type = type(tmp_path)
    whole = path_type.read_bytes
    monkeypatch.setattr(path_type, "read_bytes", lambda self: whole(self)[:-2] + b"1\n")
    with pytest.raises(srt.DataError, match="does not read back"):
        save(made, tmp_path / "unit.calib")
    monkeypatch.undo()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("unit_acc.calib", "mine")]


@pytest.mark.parametrize(("sensor", "name"), [("gyro", "gyro"), ("accel", "accelerometer")])
def test_a_writer_that_is_wrong_is_found_out(monkeypatch, sensor, name):
    """A bias off by 1e-9 (SI), which no message of a reader would show."""
    item = exporters.exporter("pyins")

    def write(model):
        document = json.loads(item.write(model)[""])
        document[sensor]["bias"][1] += 1e-9
        return {"": json.dumps(document)}

    monkeypatch.setattr("srt.exporters.conversion.exporter", lambda _: replace(item, write=write))
    with pytest.raises(srt.DataError, match=f"The {name} correction"):
        export(calibrated(np.random.default_rng(28)), "pyins")


def test_texts_of_a_file_cannot_break_out_of_its_comments():
    made = export(calibrated(np.random.default_rng(23), provenance={"serial": "a\nimu1: [}\u2028"}), "kalibr")
    assert list(yaml.safe_load(made.texts[""])) == ["imu0"]
    made.texts[""].encode("ascii")


def test_gtsam_gets_noise_bias_and_gravity():
    package = pytest.importorskip("gtsam")
    calibration = calibrated(np.random.default_rng(24))
    params, bias = gtsam_preintegration(calibration, readings="raw")
    assert type(params) is package.PreintegrationParams
    np.testing.assert_array_equal(params.n_gravity, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(
        params.getGyroscopeCovariance(), np.diag(np.square(NOISE["gyro_noise_rad_per_sqrt_s"])), rtol=1e-15
    )
    np.testing.assert_allclose(
        params.getAccelerometerCovariance(), np.diag(np.square(NOISE["accel_noise_m_s2_sqrt_s"])), rtol=1e-15
    )
    assert params.getIntegrationCovariance().max() < 1e-6
    np.testing.assert_array_equal(bias.gyroscope(), calibration.errors.group("gyro_bias"))
    np.testing.assert_array_equal(bias.accelerometer(), calibration.errors.group("accel_bias"))

    params, bias = gtsam_preintegration(
        calibration, readings="corrected", up=False, gravity_m_s2=9.8, gyro_random_walk=1e-5, accel_random_walk=1e-4
    )
    assert type(params) is package.PreintegrationCombinedParams
    np.testing.assert_array_equal(params.n_gravity, [0.0, 0.0, 9.8])
    np.testing.assert_array_equal(bias.vector(), np.zeros(6))
    np.testing.assert_allclose(params.getBiasOmegaCovariance(), 1e-10 * np.eye(3), rtol=1e-15)
    np.testing.assert_allclose(params.getBiasAccCovariance(), 1e-8 * np.eye(3), rtol=1e-15)
    # Noise of the corrected readings, from the definition.
    D = np.linalg.inv(gyro_triad(calibration.errors).matrix)
    expected = D @ np.diag(np.square(NOISE["gyro_noise_rad_per_sqrt_s"])) @ D.T
    np.testing.assert_allclose(params.getGyroscopeCovariance(), expected, rtol=1e-12, atol=1e-30)


def test_gtsam_manifold_integrates_full_turns_of_corrected_readings():
    """Two turns, 360° about z and then about x: the attitude ends where it began, and gravity is held up."""
    package = pytest.importorskip("gtsam")
    calibration = calibrated(np.random.default_rng(25), asymmetry=True, size=0.02)
    n, dt = 400, 0.01
    rate = np.zeros((2 * n, 3))
    rate[:n, 2] = rate[n:, 0] = 2.0 * math.pi / (n * dt)
    gyro, _ = calibration.apply(gyro_triad(calibration.errors).read(rate), np.zeros((2 * n, 3)))
    params, bias = gtsam_preintegration(calibration, readings="corrected")
    held = package.PreintegratedImuMeasurementsManifold(params, bias)
    for w in gyro:
        held.integrateMeasurement(np.zeros(3), w, dt)
    # 800 products of rotations, each right to some 1e-16.
    np.testing.assert_allclose(held.deltaRij().matrix(), np.eye(3), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"readings": "both"}, "readings is"),
        ({"gyro_random_walk": 1e-5}, "or neither"),
        ({"gyro_random_walk": -1.0, "accel_random_walk": 1.0}, "random walk"),
        ({"gravity_m_s2": -9.8}, "Gravity is"),
    ],
)
def test_gtsam_refusals(options, fragment):
    pytest.importorskip("gtsam")
    with pytest.raises(srt.InputError, match=fragment):
        gtsam_preintegration(calibrated(np.random.default_rng(26)), **({"readings": "raw"} | options))


def test_gtsam_needs_the_noise():
    pytest.importorskip("gtsam")
    with pytest.raises(srt.InputError, match="white noise"):
        gtsam_preintegration(calibrated(np.random.default_rng(27), noise={}), readings="raw")


def test_opencv_opens_the_file_of_openvins(tmp_path):
    """OpenVINS reads by OpenCV's FileStorage, which is stricter than YAML."""
    cv2 = pytest.importorskip("cv2")
    calibration = calibrated(np.random.default_rng(31))
    (path,) = save(export(calibration, "openvins", settings=ExportSettings(rate_hz=200.0)), tmp_path / "imu.yaml")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    node = storage.getNode("imu0")
    expected = yaml.safe_load(path.read_text(encoding="utf-8").split("\n", 1)[1])["imu0"]
    for name in ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC", "Tg"):
        rows = node.getNode(name)
        found = [[rows.at(i).at(j).real() for j in range(3)] for i in range(3)]
        np.testing.assert_array_equal(found, expected[name])
    for name in ("gyroscope_noise_density", "accelerometer_noise_density", "update_rate"):
        assert node.getNode(name).real() == expected[name]
    assert node.getNode("rostopic").string() == expected["rostopic"]


def test_kalibr_gets_the_flat_file_of_its_option_imu(tmp_path):
    """Keys of Kalibr's ImuParameters, at the top level; its parser is not installable here."""
    settings = ExportSettings(topic="/imu/raw", rate_hz=250.0, gyro_random_walk=1e-5, accel_random_walk=2e-4)
    result, flat = save(export(calibrated(np.random.default_rng(32)), "kalibr", settings=settings), tmp_path / "k.yaml")
    assert (result.name, flat.name) == ("k.yaml", "k-imu.yaml")
    found = yaml.safe_load(flat.read_text(encoding="utf-8"))
    noise = {"accelerometer_noise_density", "gyroscope_noise_density"}
    walks = {"accelerometer_random_walk": 2e-4, "gyroscope_random_walk": 1e-5}
    assert set(found) == {*noise, *walks, "rostopic", "update_rate"}
    assert found["rostopic"] == "/imu/raw"
    assert {name: found[name] for name in walks} == walks
    flat.unlink()
    assert load(result, "kalibr").absent


@pytest.mark.parametrize("instance", [4, 7])
def test_px4_has_four_instances(instance):
    with pytest.raises(srt.InputError, match="0 to 3"):
        export(calibrated(np.random.default_rng(33)), "px4", settings=ExportSettings(instance=instance))
