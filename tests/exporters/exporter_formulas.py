"""Formulas of the tools that read exported files, typed from the tools' own statements, and calibrations to export."""

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

from srt import exporters
from srt.exporters import Readings
from srt.model.rotations import rotation_matrix
from srt.result.calibration import Calibration
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Provenance, StatedSite
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

yaml = pytest.importorskip("yaml")

U = rotation_matrix(np.array([0.1, -0.2, 0.15]))
ASYMMETRY = np.zeros(N_PARAMETERS, dtype=bool)
for group in ("gyro_asymmetry", "accel_asymmetry"):
    ASYMMETRY[GROUP_SLICES[group]] = True
NOISE = {
    "gyro_noise_rad_per_sqrt_s": np.array([1e-6, 2e-6, 1.5e-6]),
    "accel_noise_m_s2_sqrt_s": np.array([1e-4, 3e-4, 2e-4]),
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
        "noise": NoiseFigures(**NOISE),
        "site": StatedSite(gravity_m_s2=9.81),
        "provenance": Provenance(serial="SN-7", software="test", applied={"system": "none"}),
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
    # Its reader keeps the lower triangle of a matrix of the model "kalibr".
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
    for sensor, values in (("accel", f), ("gyro", w)):
        M, s, b = np.reshape(p[sensor]["matrix"], (3, 3)), np.array(p[sensor]["asymmetry"]), p[sensor]["bias"]
        if sensor == "gyro":
            values = values - mm(np.reshape(p["g_sensitivity"], (3, 3)), mm(R.T, out[0]))  # noqa: PLW2901
        v = mm(np.linalg.inv(M), values - b)
        if not s.any():
            np.testing.assert_allclose(
                mm(np.reshape(p[sensor]["correction"], (3, 3)), values - b), mm(R, v), atol=EXACT
            )
        for _ in range(60):  # a contraction by |s| / smallest singular value < 0.2
            v = mm(np.linalg.inv(M), values - b - s * np.abs(v))
        out.append(mm(R, v))
    return tuple(out[::-1])


def gtsam(texts, w, f, bias):
    d = json.loads(texts[""])
    return w - d["bias_gyro"], f - d["bias_accel"]


FORMULAS = {f.__name__: f for f in (kalibr, openvins, basalt, imucal, imu_tk, pyins, vectornav, px4, ardupilot, ros2)}
FORMULAS["gtsam"] = gtsam

_C_MAIN = """
#include <stdio.h>
#include "unit.h"
int main(void)
{
    double y[6], v[6];
    while (fread(y, sizeof y, 1, stdin) == 1) {
        imu_correct(y, y + 3, v, v + 3);
        fwrite(v, sizeof v, 1, stdout);
    }
    return 0;
}
"""


def c_header(texts, w, f, bias):
    """The header compiled and run."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "unit.h").write_text(texts[""])
        (place / "main.c").write_text(_C_MAIN)
        subprocess.run([compiler, "-std=c99", "main.c", "-o", "main"], cwd=place, check=True)
        y = np.ascontiguousarray(np.hstack([w, f]))
        done = subprocess.run([str(place / "main")], input=y.tobytes(), check=True, capture_output=True)
    v = np.frombuffer(done.stdout).reshape(-1, 6)
    return v[:, :3], v[:, 3:]


FORMULAS["c-header"] = c_header


def kf_gins(texts, w, f, bias):
    """Its units: °/h, mGal, ppm; increments over dt, the same as rates."""
    d = yaml.safe_load(texts[""])
    gyro = (w - np.radians(d["initgyrbias"]) / 3600.0) / (1.0 + 1e-6 * np.array(d["initgyrscale"]))
    return gyro, (f - 1e-5 * np.array(d["initaccbias"])) / (1.0 + 1e-6 * np.array(d["initaccscale"]))


FORMULAS["kf-gins"] = kf_gins
CASES = [(target, frame) for target in TARGETS for frame in exporters.exporter(target).frames]
IMPORTED = tuple(name for name, item in exporters.exporters().items() if item.imports)


def biases_of(calibration):
    return calibration.errors.group("gyro_bias"), calibration.errors.group("accel_bias")


HOLD_G_SENSITIVITY = tuple(name for name, item in exporters.exporters().items() if item.g_sensitivity)
